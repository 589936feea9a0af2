//! Rule files under examination: what a rule derives to, and whether a file grows a tree.

use std::path::Path;

use super::detail::detail;
use crate::diagnostic::Result;
use crate::mesh::FoliageLevel;
use crate::seed::Seed;
use crate::skeleton::derive::{self, Inputs, ModuleString, Stats};
use crate::skeleton::{self, Target};
use crate::species::{self, Species};

/// Faces, vertices and edges of the thirteen rules (T15, Table 4). They describe its author's
/// mesh, not the productions: shown beside this project's counts, never aimed at.
pub const TABLE_4: [[u32; 3]; 13] = [
    [110, 64, 172],
    [212, 125, 335],
    [244, 125, 367],
    [98, 64, 160],
    [110, 64, 172],
    [102, 64, 164],
    [222, 128, 348],
    [474, 256, 728],
    [106, 64, 168],
    [102, 64, 164],
    [36, 25, 59],
    [22, 16, 36],
    [98, 64, 160],
];

/// The column of [`TABLE_4`] of a built-in rule such as `table3/05`.
pub fn of_table_4(id: &str) -> Option<[u32; 3]> {
    let number: usize = id.strip_prefix("table3/")?.parse().ok()?;
    TABLE_4.get(number.checked_sub(1)?).copied()
}

/// Modules past which a check gives up: a tree has thousands.
const CHECK_MODULES: usize = 10_000_000;
/// Triangles of the tree a check grows, as a forest would have it.
const CHECK_TRIANGLES: usize = 5_000;

/// The string of a species' rule, with its measures.
///
/// # Errors
/// A rule that grows beyond its limits.
pub fn derive(
    species: &Species,
    iterations: Option<u32>,
    seed: Seed,
) -> Result<(ModuleString, Stats)> {
    derive_within(species, Inputs { iterations, ..Inputs::new(seed) })
}

fn derive_within(species: &Species, inputs: Inputs) -> Result<(ModuleString, Stats)> {
    let string = derive::derive(&species.rule, &inputs)?;
    let stats = string.stats(&species.rule);
    Ok((string, stats))
}

/// What a sound file makes.
pub struct Sound {
    pub species: Species,
    pub stats: Stats,
    /// Nodes and height of the tree it grows.
    pub nodes: usize,
    pub height_m: f32,
}

/// Checks a rule file as far as a tree: it reads, derives, and grows a sound skeleton.
///
/// # Errors
/// Everything wrong with the file, or what stops its growth.
pub fn check(path: &Path, seed: Seed) -> Result<Sound> {
    let species = species::load(&path.to_string_lossy())?;
    let limits = Inputs { module_limit: CHECK_MODULES, ..Inputs::new(seed) };
    let (_, stats) = derive_within(&species, limits).map_err(|e| e.in_file(path))?;
    let target = Target::FromSpecies { height_m: None };
    let skeleton =
        skeleton::grow(&species, target, detail(CHECK_TRIANGLES, FoliageLevel::Cards), seed)
            .and_then(|s| s.check().map(|()| s))
            .map_err(|e| e.in_file(path))?;
    let (nodes, height_m) = (skeleton.len(), skeleton.height_m());
    Ok(Sound { species, stats, nodes, height_m })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Euler's formula holds in every column, as the source's reader may check.
    #[test]
    fn table_4_is_as_printed() {
        for [faces, vertices, edges] in TABLE_4 {
            assert_eq!(faces + vertices, edges + 2);
        }
        assert_eq!(of_table_4("table3/08"), Some([474, 256, 728]));
        assert_eq!(of_table_4("table3/00"), None);
        assert_eq!(of_table_4("table3/14"), None);
        assert_eq!(of_table_4("larix_sibirica"), None);
    }
}
