//! A cloud as LAZ bytes.
//!
//! A system known by its WKT goes into LAS 1.4 (point format 6, or 7 with colour), which asks for
//! WKT. One known by its EPSG code alone goes into LAS 1.2 (format 1 or 3) as GeoTIFF keys, which
//! LAS 1.4's new formats forbid; lidR, PDAL and QGIS read both forms. The same cloud gives the
//! same bytes on every day.

use std::io::Cursor;

use glam::DVec3;
use las::point::Format;
use las::{Builder, PointDataBuilder, Transform, Vector, Vlr, Writer};

use super::PointCloud;
use crate::diagnostic::{Error, Result};
use crate::frame::Crs;

/// World units of one step of the stored integers.
const STEP: f64 = 0.001;
/// Points packed at a time.
const BATCH: usize = 1 << 20;

/// Packs a cloud as LAZ, coordinates rounded to 1/1000 of a world unit, offset the frame's origin.
/// GPS times are 0. In the LAS 1.2 form return numbers and counts above 7 become 7.
///
/// # Errors
/// The cloud breaks its invariants; a point lies farther than 2 147 km from the origin; LAS 1.2
/// is needed and a class is above 31.
pub fn encode_laz(cloud: &PointCloud) -> Result<Vec<u8>> {
    cloud.check().map_err(|what| Error::new(format!("the cloud can't be written: {what}")))?;
    let crs = cloud.frame.crs.as_ref();
    let is_extended = crs.is_none_or(|crs| crs.wkt.is_some());
    if !is_extended && cloud.class.iter().any(|class| *class > 31) {
        return Err(Error::new("classes above 31 can't be written without the WKT of the system")
            .remedy("give the system as WKT, or no system"));
    }
    let header = header(cloud, is_extended).map_err(las_error)?;
    let transforms = *header.transforms();
    let format = *header.point_format();
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).map_err(las_error)?;
    let mut bytes = Vec::new();
    for start in (0..cloud.len()).step_by(BATCH) {
        bytes.clear();
        bytes.reserve(BATCH.min(cloud.len() - start) * usize::from(format.len()));
        for i in start..(start + BATCH).min(cloud.len()) {
            push_record(&mut bytes, cloud, i, is_extended)?;
        }
        let data = PointDataBuilder::new()
            .with_format(format)
            .with_transforms(transforms)
            .build_from_bytes(std::mem::take(&mut bytes))
            .map_err(las_error)?;
        writer.write_points(&data).map_err(las_error)?;
    }
    writer.into_inner().map(Cursor::into_inner).map_err(las_error)
}

fn las_error(error: las::Error) -> Error {
    Error::new(format!("the cloud can't be written as LAZ: {error}"))
}

fn header(cloud: &PointCloud, is_extended: bool) -> std::result::Result<las::Header, las::Error> {
    // A day that does not change, so that the bytes don't.
    let mut builder = Builder::new(las::raw::Header {
        version: if is_extended { (1, 4) } else { (1, 2) }.into(),
        file_creation_year: 2000,
        file_creation_day_of_year: 1,
        ..las::raw::Header::default()
    })?;
    builder.generating_software = "Larix".into();
    builder.system_identifier = "Larix".into();
    let colour = u8::from(cloud.rgb.is_some());
    builder.point_format = Format::new(if is_extended { 6 + colour } else { 1 + 2 * colour })?;
    builder.point_format.is_compressed = true;
    let origin = cloud.frame.origin;
    let axis = |offset| Transform { scale: STEP, offset };
    builder.transforms = Vector { x: axis(origin.x), y: axis(origin.y), z: axis(origin.z) };
    match &cloud.frame.crs {
        Some(Crs { wkt: Some(wkt), .. }) => {
            builder.has_wkt_crs = true;
            let mut data = wkt.clone().into_bytes();
            data.push(0);
            builder.vlrs.push(projection_record(2112, data));
        }
        Some(crs) => builder.vlrs.push(projection_record(34735, geo_keys(crs))),
        None => {}
    }
    builder.into_header()
}

fn projection_record(record_id: u16, data: Vec<u8>) -> Vlr {
    Vlr { user_id: "LASF_Projection".into(), record_id, description: String::new(), data }
}

/// The key directory: projected model, code, and the units.
fn geo_keys(crs: &Crs) -> Vec<u8> {
    let unit = |metres: f64| match metres {
        m if (m - 0.3048).abs() < 1e-9 => 9002,
        m if (m - 1200.0 / 3937.0).abs() < 1e-9 => 9003,
        _ => 9001,
    };
    let mut keys: Vec<[u16; 2]> = vec![[1024, 1], [1025, 1]];
    keys.extend(crs.epsg.and_then(|code| u16::try_from(code).ok()).map(|code| [3072, code]));
    keys.push([3076, unit(crs.horizontal_unit_m)]);
    keys.push([4099, unit(crs.vertical_unit_m)]);
    let mut shorts = vec![1, 1, 0, keys.len() as u16];
    shorts.extend(keys.iter().flat_map(|[key, value]| [*key, 0, 1, *value]));
    shorts.iter().flat_map(|short| short.to_le_bytes()).collect()
}

/// One record of point format 1, 3, 6 or 7.
fn push_record(bytes: &mut Vec<u8>, cloud: &PointCloud, i: usize, is_extended: bool) -> Result<()> {
    let steps: DVec3 = (cloud.position[i].as_dvec3() / cloud.frame.unit_m() / STEP).round();
    if steps.abs().max_element() > f64::from(i32::MAX) {
        return Err(Error::new(format!(
            "point {i} is too far from the origin to be written as LAS"
        ))
        .remedy("write the tiles apart"));
    }
    for step in steps.to_array() {
        bytes.extend((step as i32).to_le_bytes());
    }
    bytes.extend(cloud.intensity[i].to_le_bytes());
    let (number, count) = (cloud.return_number[i], cloud.return_count[i]);
    if is_extended {
        bytes.push(number.min(15) | (count.min(15) << 4));
        // Flags, class, user data, scan angle (2), source (2), GPS time (8).
        bytes.extend([0, cloud.class[i], 0]);
        bytes.extend([0; 12]);
    } else {
        bytes.push(number.min(7) | (count.min(7) << 3));
        // Class, scan angle, user data, source (2), GPS time (8).
        bytes.push(cloud.class[i]);
        bytes.extend([0; 12]);
    }
    if let Some(rgb) = &cloud.rgb {
        bytes.extend(rgb[i].iter().flat_map(|v| v.to_le_bytes()));
    }
    Ok(())
}
