//! `docs/rule-files.md` says what is so: its examples load and grow, every key stands there in its
//! section, with the default and the range that the program has.

use larix::diagnostic::render;
use larix::seed::Seed;
use larix::skeleton::derive::{Inputs, derive};
use larix::skeleton::turtle::draw;
use larix::species::rule::{Dialect, OF_TREE, expr::FUNCTIONS};
use larix::species::{load_text, sections};

const GUIDE: &str = include_str!("../docs/rule-files.md");
const DEFAULTS: &str = include_str!("../src/species/defaults.toml");

/// The part of the guide below the heading of a section.
fn part(section: &str) -> &'static str {
    let heading = match section {
        "" => "\n## The top of the file\n".to_owned(),
        "growth.order" => "\n## [[growth.order]]\n".to_owned(),
        name => format!("\n## [{name}]\n"),
    };
    let (_, rest) = GUIDE.split_once(&heading).unwrap_or_else(|| panic!("no {heading}"));
    rest.split("\n## ").next().unwrap()
}

/// The cells of the table line of a key.
fn line(section: &str, key: &str) -> Option<Vec<&'static str>> {
    let start = format!("| `{key}` |");
    let line = part(section).lines().find(|l| l.starts_with(&start))?;
    Some(line.trim_matches('|').split('|').map(str::trim).collect())
}

const HEADS: [&str; 8] = ["rule", "size", "growth", "young", "foliage", "bark", "fruit", "season"];

#[test]
fn every_key_is_described_and_no_other() {
    for (section, keys) in sections() {
        for key in keys.iter().filter(|k| !(section.is_empty() && HEADS.contains(k))) {
            assert!(line(section, key).is_some(), "the guide lacks `{key}` of [{section}]");
        }
        for line in part(section).lines().filter(|l| l.starts_with("| `")) {
            let key = line.trim_start_matches("| `").split('`').next().unwrap();
            // Tables of symbols and operators stand in [rule] too.
            let is_name = key.len() > 2 && key.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            assert!(!is_name || keys.contains(&key), "[{section}] has no `{key}`");
        }
    }
}

#[test]
fn defaults_are_the_program_s() {
    let defaults: toml::Table = DEFAULTS.parse().unwrap();
    let plain = |value: &toml::Value| match value {
        toml::Value::Float(x) => format!("{x}"),
        // 1.0 is said as 1.
        toml::Value::Array(_) => value.to_string().replace(".0", ""),
        toml::Value::String(s) => format!("`{s}`"),
        other => other.to_string(),
    };
    let mut tables: Vec<(&str, &toml::Table)> = vec![("", &defaults)];
    tables.extend(HEADS.map(|h| (h, defaults[h].as_table().unwrap())));
    tables.push(("growth.decay_by", defaults["growth"]["decay_by"].as_table().unwrap()));
    tables.push(("growth.order", defaults["growth"]["order"][0].as_table().unwrap()));
    let mut checked = 0;
    for (section, table) in tables {
        for (key, value) in table {
            let cells = line(section, key).unwrap_or_default();
            let said = cells.last().copied().unwrap_or("");
            // Said in words: empty texts and lists, tables, the profile.
            let is_empty =
                value.as_str() == Some("") || value.as_array().is_some_and(Vec::is_empty);
            if is_empty || value.is_table() || ["profile", "order"].contains(&key.as_str()) {
                continue;
            }
            assert_eq!(said, plain(value), "default of `{key}` in [{section}]");
            checked += 1;
        }
    }
    assert!(checked > 45, "{checked}");
}

/// The ends of each stated range pass, and what lies beyond is refused.
#[test]
fn ranges_are_the_program_s() {
    let sound = "[rule]\naxiom = 'F(a)'\n";
    let mut checked = 0;
    for (section, keys) in sections() {
        for key in keys {
            let Some(cells) = line(section, key).filter(|c| c.len() == 4) else { continue };
            let (above, range) = match cells[2].strip_prefix("above ") {
                Some(rest) => (true, rest),
                None => (false, cells[2]),
            };
            let Some((low, high)) = range.split_once(" to ") else { continue };
            if section == "growth.order" || cells[2].ends_with("each") {
                continue;
            }
            let (low, high): (f64, f64) = (low.parse().unwrap(), high.parse().unwrap());
            let loads = |value: f64| {
                load_text("range", &format!("{sound}[{section}]\n{key} = {value}\n")).is_ok()
            };
            assert_eq!(loads(low), !above, "`{key}` = {low}");
            assert!(loads(high), "`{key}` = {high}");
            assert!(!loads(low - 1.0) && !loads(high + 1.0), "`{key}` beyond its range");
            checked += 1;
        }
    }
    assert!(checked >= 27, "{checked}");
}

#[test]
fn examples_load_and_grow() {
    let mut count = 0;
    for block in GUIDE.split("```toml\n").skip(1) {
        let text = block.split("```").next().unwrap();
        let rule = match load_text("guide", text) {
            Ok(species) => species.rule,
            Err(error) => panic!("{}", render(&error)),
        };
        let string = derive(&rule, &Inputs::new(Seed::new(1))).unwrap();
        let scaffold = draw(&rule, &string).unwrap();
        scaffold.check().unwrap();
        assert!(scaffold.len() > 10, "{text}");
        count += 1;
    }
    assert_eq!(count, 6);
}

#[test]
fn every_symbol_function_and_name_stands_in_the_guide() {
    for (dialect, heading) in
        [(Dialect::Upright, "### The upright turtle"), (Dialect::Heading, "### The heading turtle")]
    {
        let (_, rest) = GUIDE.split_once(heading).unwrap();
        let table = rest.split("\n#").next().unwrap();
        for symbol in dialect.commands().split_whitespace() {
            let symbol = symbol.replace('|', "\\|");
            assert!(table.contains(&format!("`{symbol}`")), "{heading} lacks {symbol}");
        }
    }
    for name in FUNCTIONS.iter().map(|(name, _)| *name).chain(OF_TREE) {
        assert!(GUIDE.contains(&format!("`{name}")), "the guide lacks {name}");
    }
}
