//! Trees as a table in the scan's own coordinates: GeoJSON, FlatGeobuf and CSV, all with the
//! columns of one list. Knows nothing of scenes.

mod fgb;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::{Serialize, Serializer};
use serde_json::json;

use crate::crown::Crown;
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;

pub use fgb::to_fgb;

/// One tree of the inventory.
#[derive(Debug, Clone)]
pub struct Tree {
    /// Stable from run to run and tile to tile: the crown's key in hexadecimal.
    pub id: String,
    pub crown: Crown,
    /// Scientific name.
    pub species: String,
    /// `named`, `luminance`, `shape and photo`, `shape`.
    pub species_from: String,
    /// How likely the species' kind (conifer, broadleaf) is, 0…1; where shape decided between them.
    pub kind_chance: Option<f32>,
    /// Mean luminance of the crown in the photo, 0…255.
    pub luminance: Option<f32>,
    /// How far that lies outside the species' range, 0 inside; where luminance decided.
    pub luminance_distance: Option<f32>,
    /// At 1.3 m, by allometry from height and crown.
    pub stem_diameter_m: f32,
    /// Dry, above ground, by allometry.
    pub biomass_kg: f32,
}

/// The id of a crown.
pub fn id(crown: &Crown) -> String {
    format!("{:016x}", crown.key)
}

/// Three decimals: a millimetre, enough and short in text.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0 + 0.0
}

/// How a column's values are had from a tree.
enum Values {
    Text(fn(&Tree) -> &str),
    Count(fn(&Tree) -> u64),
    Flag(fn(&Tree) -> bool),
    /// Rounded to three decimals; `None` stays empty.
    Number(fn(&Tree, &Frame) -> Option<f64>),
}

use Values::{Count, Flag, Number, Text};

/// Columns beside the geometry, in order.
const COLUMNS: &[(&str, Values)] = &[
    ("id", Text(|t| &t.id)),
    ("species", Text(|t| &t.species)),
    ("species_from", Text(|t| &t.species_from)),
    ("kind_chance", Number(|t, _| t.kind_chance.map(f64::from))),
    ("x", Number(|t, f| Some(root(t, f).x))),
    ("y", Number(|t, f| Some(root(t, f).y))),
    ("z", Number(|t, f| Some(root(t, f).z))),
    ("height_m", Number(|t, _| Some(t.crown.height_m.into()))),
    ("crown_diameter_m", Number(|t, _| Some(t.crown.diameter_m.into()))),
    ("crown_spread_m", Number(|t, _| Some(t.crown.spread_m.into()))),
    ("crown_volume_m3", Number(|t, _| Some(t.crown.volume_cu_m.into()))),
    ("crown_surface_m2", Number(|t, _| Some(t.crown.surface_sq_m.into()))),
    ("crown_base_height_m", Number(|t, _| Some(t.crown.base_height_m.into()))),
    ("stem_diameter_m", Number(|t, _| Some(t.stem_diameter_m.into()))),
    ("biomass_kg", Number(|t, _| Some(t.biomass_kg.into()))),
    ("points", Count(|t| t.crown.point_count.into())),
    ("is_understory", Flag(|t| t.crown.is_understory)),
    ("confidence", Number(|t, _| Some(t.crown.confidence.into()))),
    ("luminance", Number(|t, _| t.luminance.map(f64::from))),
    ("luminance_distance", Number(|t, _| t.luminance_distance.map(f64::from))),
];

fn root(tree: &Tree, frame: &Frame) -> DVec3 {
    frame.world_from_local(tree.crown.root)
}

/// What a column holds of one tree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
enum Field<'a> {
    Text(&'a str),
    Count(u64),
    Flag(bool),
    Number(f64),
    Empty,
}

/// A number that is not finite is empty.
fn field<'a>(values: &Values, tree: &'a Tree, frame: &Frame) -> Field<'a> {
    match values {
        Text(text) => Field::Text(text(tree)),
        Count(count) => Field::Count(count(tree)),
        Flag(flag) => Field::Flag(flag(tree)),
        Number(number) => match number(tree, frame).filter(|v| v.is_finite()) {
            Some(number) => Field::Number(rounded(number)),
            None => Field::Empty,
        },
    }
}

fn fields<'a>(tree: &'a Tree, frame: &Frame) -> impl Iterator<Item = (&'static str, Field<'a>)> {
    COLUMNS.iter().map(move |(name, values)| (*name, field(values, tree, frame)))
}

/// The outline in world coordinates, closed (first corner repeated), counter-clockwise.
fn ring(tree: &Tree, frame: &Frame) -> Vec<[f64; 2]> {
    let outline = &tree.crown.outline;
    let mut ring: Vec<[f64; 2]> = outline
        .iter()
        .map(|p| {
            let w = frame.world_from_local(Vec3::new(p.x, p.y, 0.0));
            [rounded(w.x), rounded(w.y)]
        })
        .collect();
    ring.extend(ring.first().copied());
    ring
}

#[derive(Serialize)]
struct Feature<'a> {
    #[serde(rename = "type")]
    kind: &'static str,
    id: &'a str,
    properties: Properties<'a>,
    geometry: Polygon,
}

#[derive(Serialize)]
struct Polygon {
    #[serde(rename = "type")]
    kind: &'static str,
    coordinates: [Vec<[f64; 2]>; 1],
}

struct Properties<'a> {
    tree: &'a Tree,
    frame: &'a Frame,
}

impl Serialize for Properties<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_map(fields(self.tree, self.frame))
    }
}

/// What a user should know of a coordinate system that GeoJSON can't name.
pub fn unnamed_crs(frame: &Frame) -> Option<String> {
    let is_unnamed = frame.crs.as_ref().is_some_and(|crs| crs.epsg.is_none());
    is_unnamed.then(|| {
        "GeoJSON names a coordinate system by its EPSG code, which that of the scan has not: readers \
         will ask for it or take degrees; a .fgb file holds it as WKT"
            .to_owned()
    })
}

/// A GeoJSON FeatureCollection, one polygon a tree. Coordinates are the scan's own; the `crs`
/// member names their system, as GDAL and QGIS read it.
pub fn to_geojson(trees: &[Tree], frame: &Frame) -> Vec<u8> {
    let mut out = String::from("{\"type\":\"FeatureCollection\",\"name\":\"trees\",");
    if let Some(code) = frame.crs.as_ref().and_then(|c| c.epsg) {
        let name = format!("urn:ogc:def:crs:EPSG::{code}");
        let crs = json!({"type": "name", "properties": {"name": name}});
        out += &format!("\"crs\":{crs},");
    }
    out += "\"features\":[";
    let feature = |tree: &Tree| {
        let feature = Feature {
            kind: "Feature",
            id: &tree.id,
            properties: Properties { tree, frame },
            geometry: Polygon { kind: "Polygon", coordinates: [ring(tree, frame)] },
        };
        // Text and finite numbers, into memory: nothing can fail.
        format!("\n{}", serde_json::to_string(&feature).unwrap_or_default())
    };
    let features: Vec<String> = trees.par_iter().map(feature).collect();
    out += &features.join(",");
    out += "\n]}\n";
    out.into_bytes()
}

/// CSV with a header, the outline as WKT in the last column.
///
/// # Errors
/// None that input can cause.
pub fn to_csv(trees: &[Tree], frame: &Frame) -> Result<Vec<u8>> {
    let fail = |e: &dyn std::fmt::Display| Error::new(format!("the table cannot be written: {e}"));
    let mut out = csv::Writer::from_writer(Vec::new());
    let header = COLUMNS.iter().map(|(name, _)| *name).chain(["outline_wkt"]);
    out.write_record(header).map_err(|e| fail(&e))?;
    for tree in trees {
        let text = |(_, field): (&str, Field<'_>)| match field {
            Field::Empty => String::new(),
            Field::Text(text) => text.to_owned(),
            Field::Count(count) => count.to_string(),
            Field::Flag(flag) => flag.to_string(),
            Field::Number(number) => json!(number).to_string(),
        };
        let mut row: Vec<String> = fields(tree, frame).map(text).collect();
        let corners: Vec<String> =
            ring(tree, frame).iter().map(|[x, y]| format!("{x} {y}")).collect();
        row.push(format!("POLYGON (({}))", corners.join(", ")));
        out.write_record(&row).map_err(|e| fail(&e))?;
    }
    out.into_inner().map_err(|e| fail(&e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Crs;
    use glam::{DVec3, Vec2};
    use serde_json::Value;

    fn example() -> (Vec<Tree>, Frame) {
        let origin = DVec3::new(500_000.0, 6_200_000.0, 100.0);
        let frame = Frame { origin, crs: Some(Crs::from_epsg(32646)) };
        let crown = Crown {
            key: 0xabc,
            root: Vec3::new(10.0, 20.0, 5.0),
            apex: Vec3::new(10.0, 20.0, 25.0),
            height_m: 20.0,
            base_height_m: 6.0,
            diameter_m: 5.0,
            spread_m: 5.0,
            volume_cu_m: 60.0,
            surface_sq_m: 90.0,
            is_understory: false,
            outline: vec![Vec2::new(8.0, 18.0), Vec2::new(12.0, 18.0), Vec2::new(10.0, 22.5)],
            attractors: Vec::new(),
            point_count: 42,
            confidence: 0.5,
        };
        let tree = Tree {
            id: id(&crown),
            crown,
            species: "Larix sibirica".into(),
            species_from: "shape".into(),
            kind_chance: Some(0.75),
            luminance: None,
            luminance_distance: None,
            stem_diameter_m: 0.24,
            biomass_kg: 180.0,
        };
        (vec![tree], frame)
    }

    #[test]
    fn geojson_is_in_world_coordinates_and_closed() {
        let (trees, frame) = example();
        let v: Value = serde_json::from_slice(&to_geojson(&trees, &frame)).unwrap();
        assert_eq!(v["crs"]["properties"]["name"], "urn:ogc:def:crs:EPSG::32646");
        let f = &v["features"][0];
        assert_eq!(f["properties"]["x"], 500_010.0);
        assert_eq!(f["properties"]["z"], 105.0);
        assert_eq!(f["id"], "0000000000000abc");
        let ring = f["geometry"]["coordinates"][0].as_array().unwrap();
        assert_eq!(ring.len(), 4);
        assert_eq!(ring[0], ring[3]);
    }

    #[test]
    fn csv_has_a_column_for_every_value() {
        let (trees, frame) = example();
        let text = to_csv(&trees, &frame).unwrap();
        let mut reader = csv::Reader::from_reader(&text[..]);
        let row = reader.records().next().unwrap().unwrap();
        assert_eq!(row.len(), COLUMNS.len() + 1);
        assert_eq!(&row[0], "0000000000000abc");
        let headers = reader.headers().unwrap();
        let of = |name| headers.iter().position(|h| h == name).unwrap();
        let outline = &row[of("outline_wkt")];
        assert!(outline.starts_with("POLYGON ((500008 6200018, "), "{outline}");
        assert_eq!(&row[of("luminance")], "");
    }

    #[test]
    fn no_trees_is_an_empty_collection() {
        let (_, frame) = example();
        let v: Value = serde_json::from_slice(&to_geojson(&[], &frame)).unwrap();
        assert_eq!(v["features"].as_array().unwrap().len(), 0);
        assert_eq!(to_csv(&[], &frame).unwrap().iter().filter(|&&b| b == b'\n').count(), 1);
        assert!(to_fgb(&[], &frame).unwrap().starts_with(b"fgb"));
    }

    #[test]
    fn flatgeobuf_holds_what_geojson_holds() {
        use flatgeobuf::{FallibleStreamingIterator, FeatureProperties, FgbReader};
        let (mut trees, frame) = example();
        trees.push(Tree {
            luminance: Some(90.25),
            id: "0000000000000def".into(),
            ..trees[0].clone()
        });
        let bytes = to_fgb(&trees, &frame).unwrap();
        assert_eq!(bytes, to_fgb(&trees, &frame).unwrap());
        let reader = FgbReader::open(std::io::Cursor::new(bytes)).unwrap();
        let header = reader.header();
        assert_eq!((header.features_count(), header.crs().unwrap().code()), (2, 32646));
        let names: Vec<&str> = header.columns().unwrap().iter().map(|c| c.name()).collect();
        assert_eq!(names, COLUMNS.iter().map(|(name, _)| *name).collect::<Vec<_>>());
        let mut features = reader.select_all().unwrap();
        let mut seen = 0;
        while let Some(feature) = features.next().unwrap() {
            let id: String = feature.property("id").unwrap();
            let tree = trees.iter().find(|t| t.id == id).unwrap();
            let height: f64 = feature.property("height_m").unwrap();
            assert_eq!(height, 20.0);
            let luminance: Option<f64> = feature.property("luminance").ok();
            assert_eq!(luminance, tree.luminance.map(f64::from));
            seen += 1;
        }
        assert_eq!(seen, 2);
    }
}
