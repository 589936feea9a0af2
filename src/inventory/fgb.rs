//! FlatGeobuf: one polygon a tree, with a spatial index, columns typed.
//!
//! The index orders the trees along a Hilbert curve; the same trees give the same bytes.

use flatgeobuf::{
    ColumnType, FgbCrs, FgbWriter, FgbWriterOptions, GeometryType, geozero::ColumnValue,
    geozero::GeomProcessor, geozero::GeozeroGeometry, geozero::PropertyProcessor,
};

use super::{COLUMNS, Field, Tree, Values, fields, ring};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;

struct Polygon(Vec<[f64; 2]>);

impl GeozeroGeometry for Polygon {
    fn process_geom<P: GeomProcessor>(
        &self,
        processor: &mut P,
    ) -> flatgeobuf::geozero::error::Result<()> {
        processor.polygon_begin(true, 1, 0)?;
        processor.linestring_begin(false, self.0.len(), 0)?;
        for (i, [x, y]) in self.0.iter().enumerate() {
            processor.xy(*x, *y, i)?;
        }
        processor.linestring_end(false, 0)?;
        processor.polygon_end(true, 0)
    }
}

/// FlatGeobuf bytes. Coordinates are the scan's own, in the system its EPSG code or WKT names.
///
/// # Errors
/// The writer's temporary file can't be made.
pub fn to_fgb(trees: &[Tree], frame: &Frame) -> Result<Vec<u8>> {
    let fail = |e: &dyn std::fmt::Display| {
        Error::new(format!("the trees can't be written as FlatGeobuf: {e}"))
            .remedy("set TMPDIR to a folder with room")
    };
    let crs = frame.crs.as_ref();
    let options = FgbWriterOptions {
        detect_type: false,
        promote_to_multi: false,
        // An index of nothing can't be made.
        write_index: !trees.is_empty(),
        crs: FgbCrs {
            code: crs.and_then(|c| i32::try_from(c.epsg?).ok()).unwrap_or(0),
            wkt: crs.and_then(|c| c.wkt.as_deref()),
            ..FgbCrs::default()
        },
        ..FgbWriterOptions::default()
    };
    let mut writer = FgbWriter::create_with_options("trees", GeometryType::Polygon, options)
        .map_err(|e| fail(&e))?;
    for (name, values) in COLUMNS {
        let kind = match values {
            Values::Text(_) => ColumnType::String,
            Values::Count(_) => ColumnType::Long,
            Values::Flag(_) => ColumnType::Bool,
            Values::Number(_) => ColumnType::Double,
        };
        writer.add_column(name, kind, |_, _| {});
    }
    for tree in trees {
        let mut outcome = Ok(false);
        writer
            .add_feature_geom(Polygon(ring(tree, frame)), |feature| {
                outcome =
                    fields(tree, frame).enumerate().try_fold(false, |_, (i, (name, field))| {
                        let value = match field {
                            Field::Text(text) => ColumnValue::String(text),
                            Field::Flag(flag) => ColumnValue::Bool(flag),
                            Field::Count(count) => ColumnValue::Long(count as i64),
                            Field::Number(number) => ColumnValue::Double(number),
                            Field::Empty => return Ok(false),
                        };
                        feature.property(i, name, &value)
                    });
            })
            .map_err(|e| fail(&e))?;
        outcome.map_err(|e| fail(&e))?;
    }
    let mut bytes = Vec::new();
    writer.write(&mut bytes).map_err(|e| fail(&e))?;
    Ok(bytes)
}
