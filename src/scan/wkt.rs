//! Well-known text of coordinate reference systems (OGC 01-009 "WKT 1", ISO 19162 "WKT 2"):
//! a reader of the bracket structure, and the few facts a scan needs.
//!
//! Limits: a name is not looked up anywhere, so a text without units in it says nothing of units.

/// `KEYWORD[args…]`, the children in a flat list.
#[derive(Debug)]
struct Node {
    keyword: String,
    parent: Option<usize>,
    /// Strings without quotes, and numbers, in order.
    values: Vec<String>,
}

/// What a text says of a system.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Facts {
    pub kind: Kind,
    /// Of the horizontal system.
    pub epsg: Option<u32>,
    /// Metres per unit, where the text says.
    pub horizontal_unit_m: Option<f64>,
    pub vertical_unit_m: Option<f64>,
    /// EPSG code of the vertical system.
    pub vertical_epsg: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Projected,
    /// Longitude and latitude, or geocentric.
    Geodetic,
    /// An engineering or unknown system.
    Local,
}

const PROJECTED: [&str; 3] = ["PROJCS", "PROJCRS", "PROJECTEDCRS"];
const GEODETIC: [&str; 7] =
    ["GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS", "GEOCCS", "GEOCENTRICCRS"];
const VERTICAL: [&str; 4] = ["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"];

/// Reads `text`; `None` where its brackets or quotes don't close or it holds no keyword.
pub(super) fn facts(text: &str) -> Option<Facts> {
    let nodes = parse(text)?;
    // Compound and bound systems wrap the horizontal one; a projected system also holds its base
    // geographic system, so projected comes first.
    let find = |names: &[&str]| nodes.iter().position(|n| names.contains(&n.keyword.as_str()));
    let (kind, root) = match (find(&PROJECTED), find(&GEODETIC)) {
        (Some(i), _) => (Kind::Projected, i),
        (None, Some(i)) => (Kind::Geodetic, i),
        (None, None) => (Kind::Local, 0),
    };
    let vertical = find(&VERTICAL);
    let horizontal_unit_m = if kind == Kind::Geodetic { None } else { length_unit_m(&nodes, root) };
    Some(Facts {
        kind,
        epsg: if kind == Kind::Local { None } else { epsg(&nodes, root) },
        horizontal_unit_m,
        vertical_unit_m: vertical.and_then(|i| length_unit_m(&nodes, i)),
        vertical_epsg: vertical.and_then(|i| epsg(&nodes, i)),
    })
}

/// The last AUTHORITY or ID directly under `root` that names EPSG.
fn epsg(nodes: &[Node], root: usize) -> Option<u32> {
    nodes
        .iter()
        .filter(|n| n.parent == Some(root) && (n.keyword == "AUTHORITY" || n.keyword == "ID"))
        .filter(|n| n.values.first().is_some_and(|v| v.eq_ignore_ascii_case("EPSG")))
        .filter_map(|n| n.values.get(1)?.parse().ok())
        .next_back()
}

/// The unit directly under `root` (WKT 1; WKT 2 with one unit for all axes), else under an axis.
fn length_unit_m(nodes: &[Node], root: usize) -> Option<f64> {
    let is_unit = |n: &Node| n.keyword == "UNIT" || n.keyword == "LENGTHUNIT";
    let is_axis = |i: usize| {
        nodes.get(i).is_some_and(|axis| axis.keyword == "AXIS" && axis.parent == Some(root))
    };
    let direct = nodes.iter().filter(|n| n.parent == Some(root) && is_unit(n));
    let of_axes = nodes.iter().filter(|n| n.parent.is_some_and(is_axis) && is_unit(n));
    direct
        .chain(of_axes)
        .filter_map(|n| n.values.get(1)?.parse::<f64>().ok())
        .find(|m| m.is_finite() && *m > 0.0)
}

fn parse(text: &str) -> Option<Vec<Node>> {
    let mut nodes: Vec<Node> = Vec::new();
    let mut open: Vec<usize> = Vec::new();
    let mut word = String::new();
    let mut chars = text.trim_end_matches('\0').chars().peekable();
    let store = |nodes: &mut Vec<Node>, open: &[usize], word: &mut String| {
        if word.is_empty() {
            return;
        }
        if let Some(node) = open.last().and_then(|&i| nodes.get_mut(i)) {
            node.values.push(std::mem::take(word));
        }
        word.clear();
    };
    while let Some(c) = chars.next() {
        match c {
            '"' => {
                let mut quoted = String::new();
                loop {
                    match chars.next()? {
                        '"' if chars.peek() == Some(&'"') => {
                            chars.next();
                            quoted.push('"');
                        }
                        '"' => break,
                        other => quoted.push(other),
                    }
                }
                if let Some(node) = open.last().and_then(|&i| nodes.get_mut(i)) {
                    node.values.push(quoted);
                }
            }
            '[' | '(' => {
                let keyword = std::mem::take(&mut word).to_ascii_uppercase();
                nodes.push(Node { keyword, parent: open.last().copied(), values: Vec::new() });
                open.push(nodes.len() - 1);
            }
            ']' | ')' => {
                store(&mut nodes, &open, &mut word);
                open.pop()?;
            }
            ',' => store(&mut nodes, &open, &mut word),
            c if c.is_whitespace() => {}
            c => word.push(c),
        }
    }
    (open.is_empty() && !nodes.is_empty()).then_some(nodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UTM: &str = r#"PROJCS["WGS 84 / UTM zone 17N",GEOGCS["WGS 84",DATUM["WGS_1984",
        SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],
        PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,
        AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]],PROJECTION["Transverse_Mercator"],
        UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AUTHORITY["EPSG","32617"]]"#;

    #[test]
    fn finds_the_code_of_the_root_and_not_of_its_parts() {
        let facts = facts(UTM).unwrap();
        assert_eq!(facts.kind, Kind::Projected);
        assert_eq!(facts.epsg, Some(32617));
        assert_eq!(facts.horizontal_unit_m, Some(1.0));
        assert_eq!(facts.vertical_unit_m, None);
    }

    #[test]
    fn compound_systems_give_both_units() {
        let text = r#"COMPD_CS["a + b",PROJCS["a",GEOGCS["g",UNIT["degree",0.017]],
            UNIT["US survey foot",0.304800609601219],AUTHORITY["EPSG","2229"]],
            VERT_CS["b",VERT_DATUM["d",2005],UNIT["foot",0.3048],AUTHORITY["EPSG","8228"]],
            AUTHORITY["EPSG","9999"]]"#;
        let facts = facts(text).unwrap();
        assert_eq!(facts.epsg, Some(2229));
        assert_eq!(facts.horizontal_unit_m, Some(0.304800609601219));
        assert_eq!((facts.vertical_unit_m, facts.vertical_epsg), (Some(0.3048), Some(8228)));
    }

    #[test]
    fn reads_the_second_edition() {
        let text = r#"PROJCRS["NZTM",BASEGEOGCRS["NZGD2000",ID["EPSG",4167]],CS[Cartesian,2],
            AXIS["n",north,LENGTHUNIT["metre",1]],AXIS["e",east,LENGTHUNIT["metre",1]],
            ID["EPSG",2193]]"#;
        let facts = facts(text).unwrap();
        assert_eq!((facts.kind, facts.epsg), (Kind::Projected, Some(2193)));
        assert_eq!(facts.horizontal_unit_m, Some(1.0));
    }

    #[test]
    fn knows_degrees_and_local_systems() {
        let degrees = r#"GEOGCS["WGS 84",UNIT["degree",0.0174],AUTHORITY["EPSG","4326"]]"#;
        assert_eq!(facts(degrees).unwrap().kind, Kind::Geodetic);
        let local = facts(r#"LOCAL_CS["plot",UNIT["metre",1]]"#).unwrap();
        assert_eq!(
            (local.kind, local.epsg, local.horizontal_unit_m),
            (Kind::Local, None, Some(1.0))
        );
    }

    #[test]
    fn broken_text_is_refused() {
        for text in ["", "PROJCS[\"a\"", "PROJCS[\"a]", "]", "hello"] {
            assert_eq!(facts(text), None, "{text}");
        }
        assert!(facts(&"A[".repeat(100_000)).is_none());
    }
}
