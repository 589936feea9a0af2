//! Trees as a table in the scan's own coordinates: GeoJSON and CSV. Knows nothing of scenes.

use glam::Vec3;
use serde_json::{Map, Value, json};

use crate::crown::Crown;
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;

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
fn rounded(value: f64) -> Value {
    let r = (value * 1000.0).round() / 1000.0;
    json!(if r == 0.0 { 0.0 } else { r })
}

fn optional(value: Option<f32>) -> Value {
    value.map_or(Value::Null, |v| rounded(v.into()))
}

/// Columns beside the geometry, in order.
fn columns(tree: &Tree, frame: &Frame) -> Map<String, Value> {
    let c = &tree.crown;
    let root = frame.world_from_local(c.root);
    let mut m = Map::new();
    m.insert("id".into(), json!(tree.id));
    m.insert("species".into(), json!(tree.species));
    m.insert("species_from".into(), json!(tree.species_from));
    m.insert("kind_chance".into(), optional(tree.kind_chance));
    m.insert("x".into(), rounded(root.x));
    m.insert("y".into(), rounded(root.y));
    m.insert("z".into(), rounded(root.z));
    m.insert("height_m".into(), rounded(c.height_m.into()));
    m.insert("crown_diameter_m".into(), rounded(c.diameter_m.into()));
    m.insert("crown_base_height_m".into(), rounded(c.base_height_m.into()));
    m.insert("stem_diameter_m".into(), rounded(tree.stem_diameter_m.into()));
    m.insert("biomass_kg".into(), rounded(tree.biomass_kg.into()));
    m.insert("points".into(), json!(c.point_count));
    m.insert("confidence".into(), rounded(c.confidence.into()));
    m.insert("luminance".into(), optional(tree.luminance));
    m.insert("luminance_distance".into(), optional(tree.luminance_distance));
    m
}

/// The outline in world coordinates, closed (first corner repeated), counter-clockwise.
fn ring(tree: &Tree, frame: &Frame) -> Vec<[f64; 2]> {
    let outline = &tree.crown.outline;
    let mut ring: Vec<[f64; 2]> = outline
        .iter()
        .map(|p| {
            let w = frame.world_from_local(Vec3::new(p.x, p.y, 0.0));
            [(w.x * 1000.0).round() / 1000.0, (w.y * 1000.0).round() / 1000.0]
        })
        .collect();
    ring.extend(ring.first().copied());
    ring
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
    for (i, tree) in trees.iter().enumerate() {
        let feature = json!({
            "type": "Feature",
            "id": tree.id,
            "properties": columns(tree, frame),
            "geometry": {"type": "Polygon", "coordinates": [ring(tree, frame)]},
        });
        out += if i == 0 { "\n" } else { ",\n" };
        out += &feature.to_string();
    }
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
    let header = "id,species,species_from,kind_chance,x,y,z,height_m,crown_diameter_m,\
                  crown_base_height_m,stem_diameter_m,biomass_kg,points,confidence,luminance,luminance_distance,outline_wkt";
    out.write_record(header.split(',')).map_err(|e| fail(&e))?;
    for tree in trees {
        let mut row: Vec<String> = columns(tree, frame)
            .values()
            .map(|v| match v {
                Value::Null => String::new(),
                Value::String(s) => s.clone(),
                other => other.to_string(),
            })
            .collect();
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
        assert_eq!(row.len(), reader.headers().unwrap().len());
        assert_eq!(&row[0], "0000000000000abc");
        assert!(row[16].starts_with("POLYGON ((500008 6200018, "), "{}", &row[16]);
        assert_eq!(&row[14], "");
    }

    #[test]
    fn no_trees_is_an_empty_collection() {
        let (_, frame) = example();
        let v: Value = serde_json::from_slice(&to_geojson(&[], &frame)).unwrap();
        assert_eq!(v["features"].as_array().unwrap().len(), 0);
        assert_eq!(to_csv(&[], &frame).unwrap().iter().filter(|&&b| b == b'\n').count(), 1);
    }
}
