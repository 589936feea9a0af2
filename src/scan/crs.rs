//! The coordinate reference system a LAS file states, as WKT (record 2112) or as GeoTIFF keys
//! (records 34735–34737, OGC 19-008r4).
//!
//! A unit that is stated counts; else the EPSG code tells it, else a citation in the keys that
//! speaks of feet; else it is a metre. Heights of no known unit are in the horizontal one.

use glam::DVec3;

use super::epsg::{self, FOOT_M, US_SURVEY_FOOT_M};
use super::wkt;
use crate::diagnostic::{Error, Result};
use crate::frame::Crs;

const USER_DEFINED: u16 = 32767;

/// The records of a LAS file that speak of its system.
#[derive(Debug, Default)]
pub(super) struct Records {
    pub wkt: Option<Vec<u8>>,
    pub geo_keys: Option<Vec<u8>>,
    pub geo_doubles: Option<Vec<u8>>,
    pub geo_ascii: Option<Vec<u8>>,
}

/// What the records say.
#[derive(Debug, Clone, Default)]
pub(super) struct Stated {
    pub crs: Option<Crs>,
    pub in_degrees: bool,
    pub warnings: Vec<String>,
}

/// A half-read system, from either kind of record.
struct Found {
    in_degrees: bool,
    epsg: Option<u32>,
    horizontal_unit_m: Option<f64>,
    vertical_unit_m: Option<f64>,
    /// Of the horizontal system, from words.
    cited_unit_m: Option<f64>,
}

/// The system of a code such as `EPSG:2229` or `2229`, or with that of its heights, `EPSG:2229+5703`.
/// Heights without a code of their own are in its unit.
///
/// # Errors
/// In words: no code, one that is not known, or one that counts degrees.
pub fn system(text: &str) -> std::result::Result<Crs, String> {
    let codes = text.trim().trim_start_matches("EPSG:").trim_start_matches("epsg:");
    let mut codes = codes.split('+').map(|code| code.trim().parse::<u32>());
    let (Some(Ok(code)), heights, None) = (codes.next(), codes.next().transpose(), codes.next())
    else {
        return Err(
            "give an EPSG code: EPSG:2229, or EPSG:2229+5703 with that of the heights".into()
        );
    };
    let Ok(heights) = heights else {
        return Err("give the code of the heights as a number: EPSG:2229+5703".into());
    };
    let known = epsg::system(code)
        .ok_or_else(|| format!("EPSG:{code} is none of the coordinate systems known here"))?;
    if known.is_geodetic {
        return Err(format!("EPSG:{code} counts degrees: reproject the scan to a metric system"));
    }
    let horizontal_unit_m = known.horizontal_unit_m.unwrap_or(1.0);
    let vertical_unit_m = match heights {
        Some(code) => epsg::vertical_unit_m(code)
            .ok_or_else(|| format!("EPSG:{code} is none of the systems of heights known here"))?,
        None => known.vertical_unit_m.unwrap_or(horizontal_unit_m),
    };
    Ok(Crs { epsg: Some(code), wkt: None, horizontal_unit_m, vertical_unit_m })
}

/// What EPSG gives to coordinate systems; greater ones are for private use.
const EPSG_CODES: std::ops::RangeInclusive<u32> = 1024..=32766;

/// Reads the records; `prefers_wkt` is bit 4 of the global encoding.
///
/// # Errors
/// A linear unit whose code is not known.
pub(super) fn parse(records: &Records, prefers_wkt: bool) -> Result<Stated> {
    let mut stated = Stated::default();
    let text = records.wkt.as_deref().map(|bytes| {
        String::from_utf8_lossy(bytes).trim_matches(['\0', ' ', '\n', '\r']).to_owned()
    });
    let text = text.filter(|t| !t.is_empty());
    let from_wkt = text.as_deref().and_then(wkt::facts).map(|f| Found {
        in_degrees: f.kind == wkt::Kind::Geodetic,
        epsg: f.epsg,
        horizontal_unit_m: f.horizontal_unit_m,
        vertical_unit_m: f.vertical_unit_m.or_else(|| epsg::vertical_unit_m(f.vertical_epsg?)),
        cited_unit_m: None,
    });
    if text.is_some() && from_wkt.is_none() {
        stated.warnings.push("the WKT of its coordinate system can't be read".into());
    }
    let from_keys = match &records.geo_keys {
        Some(directory) => GeoKeys::parse(directory, records).found()?,
        None => None,
    };
    let found = match (from_wkt, from_keys, prefers_wkt) {
        (Some(w), None, _) | (Some(w), Some(_), true) => w,
        (None, Some(k), _) => k,
        (Some(w), Some(k), false) => {
            if k.epsg.is_some() || k.in_degrees {
                k
            } else {
                w
            }
        }
        (None, None, _) => return Ok(stated),
    };
    let known = found.epsg.and_then(epsg::system);
    let mut epsg = found.epsg;
    if let (Some(code), None) = (epsg, known) {
        if EPSG_CODES.contains(&code) {
            stated.warnings.push(format!(
                "EPSG:{code} is none of the coordinate systems known here; it is passed on as it is"
            ));
        } else {
            stated.warnings.push(format!("{code} is no EPSG code; it is left out"));
            epsg = None;
        }
    }
    stated.in_degrees = found.in_degrees || known.is_some_and(|known| known.is_geodetic);
    let of_code = known.and_then(|known| known.horizontal_unit_m);
    if let (Some(stated_m), Some(code_m), Some(code)) =
        (found.horizontal_unit_m, of_code, found.epsg)
        && (stated_m - code_m).abs() > 1e-6
    {
        stated.warnings.push(format!(
            "its unit is stated as {stated_m} m, but EPSG:{code} counts in {code_m} m; \
             the stated one is used"
        ));
    }
    let horizontal_unit_m =
        found.horizontal_unit_m.or(of_code).or(found.cited_unit_m).unwrap_or(1.0);
    let of_heights = found.vertical_unit_m.or(known.and_then(|known| known.vertical_unit_m));
    let vertical_unit_m = of_heights.unwrap_or(horizontal_unit_m);
    if of_heights.is_none() && horizontal_unit_m != 1.0 {
        stated.warnings.push(format!(
            "no unit is stated for its heights; taken as the horizontal one, {horizontal_unit_m} m"
        ));
    }
    stated.crs = Some(Crs { epsg, wkt: text, horizontal_unit_m, vertical_unit_m });
    Ok(stated)
}

/// The key directory with the values it points to.
struct GeoKeys {
    short: Vec<(u16, u16)>,
    double: Vec<(u16, f64)>,
    citations: String,
}

fn u16_at(bytes: &[u8], i: usize) -> Option<u16> {
    let pair = bytes.get(2 * i..2 * i + 2)?;
    Some(u16::from_le_bytes([pair[0], pair[1]]))
}

impl GeoKeys {
    fn parse(directory: &[u8], records: &Records) -> GeoKeys {
        let mut keys = GeoKeys { short: Vec::new(), double: Vec::new(), citations: String::new() };
        let count = usize::from(u16_at(directory, 3).unwrap_or(0));
        for entry in 1..=count {
            let Some(fields) = (0..4).map(|f| u16_at(directory, 4 * entry + f)).collect() else {
                break;
            };
            let fields: Vec<u16> = fields;
            let (key, place, length, value) = (fields[0], fields[1], fields[2], fields[3]);
            match place {
                0 => keys.short.push((key, value)),
                34736 => {
                    let at = 8 * usize::from(value);
                    let bytes = records.geo_doubles.as_deref().and_then(|d| d.get(at..at + 8));
                    if let Some(Ok(bytes)) = bytes.map(<[u8; 8]>::try_from) {
                        keys.double.push((key, f64::from_le_bytes(bytes)));
                    }
                }
                34737 => {
                    let (from, to) = (usize::from(value), usize::from(value) + usize::from(length));
                    if let Some(bytes) = records.geo_ascii.as_deref().and_then(|a| a.get(from..to))
                    {
                        keys.citations.push_str(&String::from_utf8_lossy(bytes));
                    }
                }
                _ => {}
            }
        }
        keys
    }

    fn short(&self, key: u16) -> Option<u16> {
        self.short.iter().find(|(k, _)| *k == key).map(|(_, v)| *v)
    }

    fn double(&self, key: u16) -> Option<f64> {
        let value = self.double.iter().find(|(k, _)| *k == key).map(|(_, v)| *v);
        value.filter(|v| v.is_finite() && *v > 0.0)
    }

    fn found(&self) -> Result<Option<Found>> {
        let is_code = |code: &u16| *code != 0 && *code != USER_DEFINED;
        let projected = self.short(3072);
        let epsg = projected.filter(is_code).map(u32::from);
        // 1 projected, 2 geographic, 3 geocentric; some writers leave the model out.
        let in_degrees = match self.short(1024) {
            Some(2 | 3) => true,
            Some(1) => false,
            _ => projected.is_none() && self.short(2048).is_some_and(|c| is_code(&c)),
        };
        if epsg.is_none() && projected.is_none() && !in_degrees && self.short(3076).is_none() {
            return Ok(None);
        }
        let horizontal_unit_m =
            self.short(3076).map(|code| self.unit_m(code, self.double(3077))).transpose()?;
        let vertical_unit_m = match (self.short(4099), self.short(4096)) {
            (Some(code), _) => Some(self.unit_m(code, None)?),
            (None, Some(code)) => epsg::vertical_unit_m(u32::from(code)),
            (None, None) => None,
        };
        let cited_unit_m = self.unit_of_citations_m();
        Ok(Some(Found { in_degrees, epsg, horizontal_unit_m, vertical_unit_m, cited_unit_m }))
    }

    fn unit_m(&self, code: u16, size_m: Option<f64>) -> Result<f64> {
        match code {
            0 | 9001 => Ok(1.0),
            9002 => Ok(FOOT_M),
            9003 => Ok(US_SURVEY_FOOT_M),
            9036 => Ok(1000.0),
            code => size_m.ok_or_else(|| {
                Error::new(format!("its coordinates are in a unit that is not known (code {code})"))
                    .remedy(
                        "reproject it to a metric system, e.g. with PDAL's filters.reprojection",
                    )
            }),
        }
    }

    fn unit_of_citations_m(&self) -> Option<f64> {
        let text = self.citations.to_ascii_lowercase();
        if text.contains("ftus") || text.contains("us survey f") || text.contains("us-ft") {
            Some(US_SURVEY_FOOT_M)
        } else if text.contains("(ft)") || text.contains("foot") || text.contains("feet") {
            Some(FOOT_M)
        } else {
            None
        }
    }
}

/// The refusal of coordinates in degrees, with the UTM zone to reproject to.
pub(super) fn degrees_error(middle: DVec3) -> Error {
    let error = Error::new("its coordinates are degrees, not lengths");
    let (longitude, latitude) = (middle.x, middle.y);
    if !(longitude.abs() <= 180.0 && latitude.abs() <= 90.0) {
        let error = Error::new("its coordinate system is geographic or geocentric");
        return error.remedy(
            "reproject it to a metric system, e.g. a UTM zone, with PDAL's filters.reprojection",
        );
    }
    let zone = (((longitude + 180.0) / 6.0).floor() as i64).clamp(0, 59) + 1;
    let (base, hemisphere) = if latitude < 0.0 { (32700, "south") } else { (32600, "north") };
    let code = base + zone;
    error.remedy(format!(
        "reproject it to UTM zone {zone} {hemisphere}: pdal translate IN OUT reprojection \
         --filters.reprojection.out_srs=EPSG:{code}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directory(keys: &[[u16; 4]]) -> Records {
        let header = [1, 1, 0, keys.len() as u16];
        let shorts = header.iter().chain(keys.iter().flatten());
        Records {
            geo_keys: Some(shorts.flat_map(|v| v.to_le_bytes()).collect()),
            ..Records::default()
        }
    }

    #[test]
    fn codes_that_name_nothing_are_told() {
        let of = |code: u16| {
            let stated = parse(&directory(&[[1024, 0, 1, 1], [3072, 0, 1, code]]), false).unwrap();
            (stated.crs.unwrap().epsg, stated.warnings)
        };
        assert_eq!(of(32617), (Some(32617), vec![]));
        let (code, warnings) = of(1234);
        assert!(code == Some(1234) && warnings[0].starts_with("EPSG:1234 is none of"));
        assert_eq!(of(65535), (None, vec!["65535 is no EPSG code; it is left out".to_owned()]));
    }

    #[test]
    fn keys_give_code_and_units() {
        let records = directory(&[[1024, 0, 1, 1], [3072, 0, 1, 2229], [3076, 0, 1, 9003]]);
        let stated = parse(&records, false).unwrap();
        let crs = stated.crs.unwrap();
        assert_eq!(crs.epsg, Some(2229));
        assert_eq!(crs.horizontal_unit_m, US_SURVEY_FOOT_M);
        assert_eq!(crs.vertical_unit_m, US_SURVEY_FOOT_M);
        assert_eq!(stated.warnings.len(), 1);
        let metric_heights =
            directory(&[[3072, 0, 1, 2229], [3076, 0, 1, 9003], [4099, 0, 1, 9001]]);
        assert_eq!(parse(&metric_heights, false).unwrap().crs.unwrap().vertical_unit_m, 1.0);
    }

    #[test]
    fn user_defined_systems_have_no_code() {
        let mut records = directory(&[
            [1024, 0, 1, 1],
            [3072, 0, 1, 32767],
            [3076, 0, 1, 32767],
            [3077, 34736, 1, 1],
        ]);
        records.geo_doubles = Some([9.0f64, 0.25].iter().flat_map(|v| v.to_le_bytes()).collect());
        let crs = parse(&records, false).unwrap().crs.unwrap();
        assert_eq!((crs.epsg, crs.horizontal_unit_m), (None, 0.25));
        records.geo_doubles = None;
        assert!(parse(&records, false).is_err());
    }

    #[test]
    fn a_citation_tells_feet() {
        let mut records = directory(&[[3072, 0, 1, 2229], [1026, 34737, 32, 0]]);
        records.geo_ascii = Some(b"NAD83 / California zone 5 (ftUS)|".to_vec());
        let crs = parse(&records, false).unwrap().crs.unwrap();
        assert_eq!(crs.horizontal_unit_m, US_SURVEY_FOOT_M);
    }

    #[test]
    fn a_system_is_named_by_its_codes() {
        let units = |text| system(text).map(|crs| (crs.horizontal_unit_m, crs.vertical_unit_m));
        let us = US_SURVEY_FOOT_M;
        assert_eq!(units("EPSG:2229"), Ok((us, us)));
        assert_eq!(units("2229+5703"), Ok((us, 1.0)));
        assert_eq!(units("epsg:32617 + 6360"), Ok((1.0, us)));
        assert_eq!(system("32617").unwrap().epsg, Some(32617));
        for (text, says) in [
            ("feet", "give an EPSG code"),
            ("2229+5703+1", "give an EPSG code"),
            ("2229+x", "give the code of the heights"),
            ("EPSG:4326", "EPSG:4326 counts degrees"),
            ("1", "EPSG:1 is none of"),
        ] {
            let told = system(text).unwrap_err();
            assert!(told.starts_with(says), "{told}");
        }
    }

    #[test]
    fn codes_tell_feet_where_no_key_does() {
        let unit = |keys: &[[u16; 4]]| {
            let crs = parse(&directory(keys), false).unwrap().crs.unwrap();
            (crs.horizontal_unit_m, crs.vertical_unit_m)
        };
        let us = US_SURVEY_FOOT_M;
        assert_eq!(unit(&[[1024, 0, 1, 1], [3072, 0, 1, 2229]]), (us, us));
        assert_eq!(unit(&[[1024, 0, 1, 1], [3072, 0, 1, 2269]]), (FOOT_M, FOOT_M));
        assert_eq!(unit(&[[3072, 0, 1, 2229], [4096, 0, 1, 5703]]), (us, 1.0));
        assert_eq!(unit(&[[3072, 0, 1, 26911], [4096, 0, 1, 6360]]), (1.0, us));
        assert_eq!(unit(&[[3072, 0, 1, 26911], [4096, 0, 1, 8228]]), (1.0, FOOT_M));
        assert_eq!(unit(&[[3072, 0, 1, 7407]]), (us, us));
        let contradicting =
            directory(&[[3072, 0, 1, 2229], [3076, 0, 1, 9001], [4099, 0, 1, 9001]]);
        let stated = parse(&contradicting, false).unwrap();
        assert_eq!(stated.crs.unwrap().horizontal_unit_m, 1.0);
        assert!(stated.warnings[0].contains("EPSG:2229 counts in"), "{:?}", stated.warnings);

        let wkt = |text: &str| {
            let records = Records { wkt: Some(text.into()), ..Records::default() };
            let crs = parse(&records, true).unwrap().crs.unwrap();
            (crs.horizontal_unit_m, crs.vertical_unit_m)
        };
        let text = r#"COMPD_CS["c",PROJCS["a",AUTHORITY["EPSG","2229"]],
            VERT_CS["v",AUTHORITY["EPSG","6360"]]]"#;
        assert_eq!(wkt(text), (us, us));
        let text = r#"COMPOUNDCRS["c",PROJCRS["a",LENGTHUNIT["metre",1],ID["EPSG",26911]],
            VERTCRS["v",VDATUM["d"],CS[vertical,1],AXIS["h",up,LENGTHUNIT["US survey foot",0.304800609601219]],ID["EPSG",6360]]]"#;
        assert_eq!(wkt(text), (1.0, 0.304800609601219));
    }

    #[test]
    fn geographic_models_are_known() {
        assert!(
            parse(&directory(&[[1024, 0, 1, 2], [2048, 0, 1, 4326]]), false).unwrap().in_degrees
        );
        assert!(parse(&directory(&[[2048, 0, 1, 4326]]), false).unwrap().in_degrees);
        // In the wrong key.
        assert!(
            parse(&directory(&[[1024, 0, 1, 1], [3072, 0, 1, 4326]]), false).unwrap().in_degrees
        );
        let projected = directory(&[[1024, 0, 1, 1], [2048, 0, 1, 4326], [3072, 0, 1, 32617]]);
        assert!(!parse(&projected, false).unwrap().in_degrees);
    }

    #[test]
    fn cut_directories_are_read_as_far_as_they_go() {
        let mut records = directory(&[[3072, 0, 1, 32617], [3076, 0, 1, 9001]]);
        records.geo_keys.as_mut().unwrap().truncate(19);
        assert_eq!(parse(&records, false).unwrap().crs.unwrap().epsg, Some(32617));
        records.geo_keys = Some(vec![7]);
        assert!(parse(&records, false).unwrap().crs.is_none());
    }

    #[test]
    fn the_remedy_names_the_zone() {
        let error = degrees_error(DVec3::new(92.9, 56.0, 0.0));
        assert!(error.remedy_text().unwrap().contains("EPSG:32646"));
        let error = degrees_error(DVec3::new(172.6, -43.5, 0.0));
        assert!(error.remedy_text().unwrap().contains("EPSG:32759"));
    }
}
