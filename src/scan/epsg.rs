//! Units of coordinate systems by their EPSG code.
//!
//! Horizontal systems come from the table of the `crs-definitions` crate, in PROJ's words; what
//! that lacks is added here, as are the vertical systems that EPSG does not count in metres.

pub(super) const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;
pub(super) const FOOT_M: f64 = 0.3048;

/// What a code says of a system.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    /// Longitude and latitude, or geocentric.
    pub is_geodetic: bool,
    /// Metres per unit.
    pub horizontal_unit_m: Option<f64>,
    /// Metres per unit, of a compound system.
    pub vertical_unit_m: Option<f64>,
}

/// The horizontal or compound system of a code.
pub(super) fn system(code: u32) -> Option<Known> {
    let projected = |unit_m| Known {
        is_geodetic: false,
        horizontal_unit_m: Some(unit_m),
        vertical_unit_m: None,
    };
    match code {
        20050 => return Some(projected(FOOT_M)),
        9748 | 9749 | 10481 | 10516 | 10622 | 23301..=23333 => {
            return Some(projected(US_SURVEY_FOOT_M));
        }
        _ => {}
    }
    let definition = crs_definitions::from_code(u16::try_from(code).ok()?)?.proj4;
    let value = |key: &str| {
        definition
            .split_ascii_whitespace()
            .find_map(|word| word.strip_prefix(key)?.strip_prefix('='))
    };
    let projection = value("+proj")?;
    Some(Known {
        is_geodetic: matches!(projection, "longlat" | "latlong" | "geocent"),
        horizontal_unit_m: value("+units")
            .and_then(unit_m)
            .or_else(|| value("+to_meter")?.parse().ok()),
        vertical_unit_m: value("+vunits")
            .and_then(unit_m)
            .or_else(|| value("+vto_meter")?.parse().ok()),
    })
}

/// Metres per unit of PROJ's name for it.
fn unit_m(name: &str) -> Option<f64> {
    match name {
        "m" => Some(1.0),
        "km" => Some(1000.0),
        "ft" => Some(FOOT_M),
        "us-ft" => Some(US_SURVEY_FOOT_M),
        "link" => Some(0.201_168),
        _ => None,
    }
}

/// Metres per unit of a vertical system, as far as the code tells; most count metres.
pub(super) fn vertical_unit_m(code: u32) -> Option<f64> {
    match code {
        5702 | 6358 | 6359 | 6360 | 8052 | 8053 => Some(US_SURVEY_FOOT_M),
        5614 | 6130 | 6131 | 6132 | 8050 | 8051 | 8228 => Some(FOOT_M),
        5754 => Some(0.304_800_749_1),
        // Names of data in the first GeoTIFF; their unit stands elsewhere.
        5000..=5199 => None,
        3000..=32766 => Some(1.0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_tell_units() {
        let unit = |code| system(code).unwrap().horizontal_unit_m;
        assert_eq!(unit(32617), Some(1.0));
        assert_eq!(unit(2229), Some(US_SURVEY_FOOT_M));
        // Oregon North, international feet.
        assert_eq!(unit(2269), Some(FOOT_M));
        // Texas Central, NAD83(2011), US survey feet.
        assert_eq!(unit(6578), Some(US_SURVEY_FOOT_M));
        assert_eq!(unit(23304), Some(US_SURVEY_FOOT_M));
        // Clarke's foot, Trinidad.
        assert_eq!(unit(2314), Some(0.304_797_265_4));
        assert!(system(4326).unwrap().is_geodetic && system(4978).unwrap().is_geodetic);
        assert_eq!(system(7407).unwrap().vertical_unit_m, Some(US_SURVEY_FOOT_M));
        assert_eq!(system(1), None);
        assert_eq!(system(u32::MAX), None);
        assert_eq!(vertical_unit_m(6360), Some(US_SURVEY_FOOT_M));
        assert_eq!(vertical_unit_m(8228), Some(FOOT_M));
        assert_eq!(vertical_unit_m(5703), Some(1.0));
        assert_eq!((vertical_unit_m(5103), vertical_unit_m(32767)), (None, None));
    }
}
