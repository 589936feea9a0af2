//! Places on light maps for every model of a scene, each form a map of its own; and its terrain.

use rayon::prelude::*;

use crate::diagnostic::Result;
use crate::mesh::Surface;
use crate::mesh::lightmap::{self, Size};
use crate::report::Outcome;
use crate::scene::{Part, Scene};

/// Gives all surfaces their places on light maps of at most `side_px` texels a side.
///
/// # Errors
/// Those of [`lightmap::unwrap`].
pub fn add(scene: &mut Scene, side_px: u32, warnings: &mut Vec<String>) -> Result<Outcome> {
    let forms = scene.prototypes.par_iter_mut().flat_map_iter(|p| {
        let coarser = p.levels.iter_mut().map(|l| &mut l.parts);
        [&mut p.parts].into_iter().chain(coarser)
    });
    let sizes: Vec<Size> = forms.map(|parts| unwrap(parts, side_px)).collect::<Result<_>>()?;
    if let Some(terrain) = &mut scene.terrain {
        lightmap::lay_flat(&mut terrain.surface);
    }
    let side = sizes.iter().map(|s| s.width.max(s.height)).max().unwrap_or(0);
    if side > side_px {
        warnings.push(format!(
            "light maps are up to {side} texels a side, not {side_px}: charts and what is between them take \
             as many"
        ));
    }
    Ok(Outcome::items(sizes.len(), "forms", sizes.len(), "light maps").note(format!(
        "charts are {} texels apart in maps of up to {side} texels a side",
        lightmap::PADDING_TEXELS
    )))
}

fn unwrap(parts: &mut [Part], side_px: u32) -> Result<Size> {
    let mut surfaces: Vec<&mut Surface> = parts.iter_mut().map(|p| &mut p.surface).collect();
    lightmap::unwrap(&mut surfaces, side_px)
}
