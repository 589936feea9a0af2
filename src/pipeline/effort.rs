//! How much time a run may take for how small an error: one word that sets the options of every
//! stage. `docs/effort.md` holds what each buys.

use crate::crown::CrownOptions;
use crate::terrain::TerrainOptions;

/// Time against error.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Effort {
    /// Coarser terrain, no lower storey.
    Fast,
    #[default]
    Normal,
    /// Finer terrain; the canopy as the mean of shifted grids.
    Best,
}

impl Effort {
    pub const ALL: [(&str, Effort); 3] =
        [("fast", Effort::Fast), ("normal", Effort::Normal), ("best", Effort::Best)];

    /// A given cell stands.
    pub fn terrain(self, cell_m: Option<f32>) -> TerrainOptions {
        let cell_in_spacings = match self {
            Effort::Fast => 2.0,
            Effort::Normal => TerrainOptions::default().cell_in_spacings,
            Effort::Best => 0.5,
        };
        TerrainOptions { cell_m, cell_in_spacings }
    }

    pub fn crown(self, min_height_m: f32) -> CrownOptions {
        let normal = CrownOptions { min_height_m, ..CrownOptions::default() };
        match self {
            Effort::Fast => CrownOptions { has_understory: false, ..normal },
            Effort::Normal => normal,
            Effort::Best => CrownOptions { grids: 2, ..normal },
        }
    }
}
