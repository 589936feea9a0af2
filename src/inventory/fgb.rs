//! FlatGeobuf: one polygon a tree, with a spatial index, columns typed.
//!
//! The index orders the trees along a Hilbert curve; the same trees give the same bytes.

use flatgeobuf::{
    ColumnType, FgbCrs, FgbWriter, FgbWriterOptions, GeometryType, geozero::ColumnValue,
    geozero::GeomProcessor, geozero::GeozeroGeometry, geozero::PropertyProcessor,
};
use serde_json::Value;

use super::{COLUMNS, Tree, Values, ring, value};
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
                    COLUMNS.iter().enumerate().try_fold(
                        false,
                        |_, (i, (name, values))| match value(values, tree, frame) {
                            Value::String(text) => {
                                feature.property(i, name, &ColumnValue::String(&text))
                            }
                            Value::Bool(flag) => {
                                feature.property(i, name, &ColumnValue::Bool(flag))
                            }
                            Value::Number(n) => match (values, n.as_i64(), n.as_f64()) {
                                (Values::Count(_), Some(n), _) => {
                                    feature.property(i, name, &ColumnValue::Long(n))
                                }
                                (_, _, Some(x)) => {
                                    feature.property(i, name, &ColumnValue::Double(x))
                                }
                                _ => Ok(false),
                            },
                            _ => Ok(false),
                        },
                    );
            })
            .map_err(|e| fail(&e))?;
        outcome.map_err(|e| fail(&e))?;
    }
    let mut bytes = Vec::new();
    writer.write(&mut bytes).map_err(|e| fail(&e))?;
    Ok(bytes)
}
