//! The rule files that travel inside the program.

/// One line a file of `species/`, by its name without `.toml`.
macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../species/", $name, ".toml")))),*]
    };
}

/// Name and text of each built-in rule file, in the order `species list` shows them.
pub const FILES: &[(&str, &str)] = files![
    "larix_sibirica",
    "larix_decidua",
    "picea_obovata",
    "picea_abies",
    "abies_sibirica",
    "pinus_sylvestris",
    "pinus_sibirica",
    "betula_pendula",
    "populus_tremula",
    "quercus_robur",
    "tilia_cordata",
    "sorbus_aucuparia",
    "salix_caprea",
    "corylus_avellana",
    "table3/01",
    "table3/02",
    "table3/03",
    "table3/04",
    "table3/05",
    "table3/06",
    "table3/07",
    "table3/08",
    "table3/09",
    "table3/10",
    "table3/11",
    "table3/12",
    "table3/13",
];

/// Text of the built-in file of this name.
pub fn text(name: &str) -> Option<&'static str> {
    FILES.iter().find(|(n, _)| *n == name).map(|(_, text)| *text)
}
