//! Trees of one model in one square of ground, drawn together (EXT_mesh_gpu_instancing), and when
//! which of their forms is shown (MSFT_lod).

use std::collections::BTreeMap;

use glam::Vec3;

use crate::scene::{Form, PICTURE_ASPECT, PICTURE_LINES, Selection};

/// Side of the squares, metres: small enough to be passed over when out of sight and to change
/// form as one, large enough for many trees.
const CELL_M: f32 = 64.0;
/// The same where trees have but one form.
const CELL_OF_ONE_FORM_M: f32 = 128.0;

/// Never empty.
pub(super) struct Cell {
    /// Column and row from the scene's origin.
    pub at: [i32; 2],
    /// Indices into [`Selection::models`] and [`Selection::trees`].
    pub model: u32,
    pub trees: Vec<u32>,
    /// Instances are placed about it; scene metres.
    pub centre: Vec3,
    /// Diameter of the sphere about all of it, metres.
    pub diameter_m: f32,
}

/// The cells of these trees, by column, row and model.
pub(super) fn cells(selection: &Selection<'_>, trees: &[u32]) -> Vec<Cell> {
    let has_one_form = selection.models.iter().all(|m| m.forms.len() == 1);
    let side_m = if has_one_form { CELL_OF_ONE_FORM_M } else { CELL_M };
    let mut by_place: BTreeMap<([i32; 2], u32), Vec<u32>> = BTreeMap::new();
    for &t in trees {
        let tree = &selection.trees[t as usize];
        // Saturates for places that no forest reaches.
        let at = (tree.instance.position.truncate() / side_m).floor().to_array().map(|c| c as i32);
        by_place.entry((at, tree.model)).or_default().push(t);
    }
    let cells = by_place.into_iter().map(|((at, model), trees)| {
        let (lo, hi) = selection.bounds_of(&trees).unwrap_or_default();
        let centre = (0.5 * lo + 0.5 * hi).round();
        Cell { at, model, trees, centre, diameter_m: lo.distance(hi) }
    });
    cells.collect()
}

/// The share of the picture that a cell covers when the next form takes over, one value a form:
/// each is shown until the silhouette of the next is off by less than a line (root mean square)
/// of a picture of [`PICTURE_LINES`]. The last is 0: the coarsest form never vanishes. Errors grow from the second
/// form on ([`Forms::Drawn`](crate::scene::Forms::Drawn)), so that shares fall. More than 1 is a
/// cell that reaches beyond the picture, as it does where the eye is near.
pub(super) fn screen_coverage(forms: &[Form<'_>], diameter_m: f32) -> Vec<f32> {
    let cover = |next: &Form<'_>| {
        // At the distance where a line is as high as the error, the cell is so many lines high.
        let height = diameter_m / (PICTURE_LINES * next.plain_rms_m().max(1e-6));
        std::f32::consts::FRAC_PI_4 * height * height / PICTURE_ASPECT
    };
    forms[1..].iter().map(cover).chain([0.0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Forms;
    use crate::scene::sample::forest;

    #[test]
    fn every_tree_is_in_one_cell_with_its_model() {
        let scene = forest(&["Larix", "Betula"], 100, 300.0).validate().unwrap();
        let selection = Selection::of(&scene, Forms::All);
        let mut seen = vec![0; selection.trees.len()];
        for group in &selection.groups {
            for cell in cells(&selection, &group.trees) {
                for &t in &cell.trees {
                    seen[t as usize] += 1;
                    let tree = &selection.trees[t as usize];
                    assert_eq!(tree.model, cell.model);
                    let off = (tree.instance.position - cell.centre).truncate().abs();
                    assert!(off.max_element() <= CELL_OF_ONE_FORM_M + 5.0, "{off}");
                }
            }
        }
        assert!(seen.iter().all(|&n| n == 1));
    }

    #[test]
    fn a_form_is_shown_until_the_next_is_good_enough() {
        // 108 m cell, error 1 m: 0.1 of the picture's height when 1 m is a line.
        let covers = screen_coverage(&[Form::off(0.0), Form::off(1.0), Form::off(2.0)], 108.0);
        let disc = std::f32::consts::FRAC_PI_4 * 0.01 * 9.0 / 16.0;
        assert!((covers[0] - disc).abs() < 1e-6 && (covers[1] - disc / 4.0).abs() < 1e-6);
        assert_eq!(covers[2], 0.0);
        let near = screen_coverage(&[Form::off(0.0), Form::off(0.01), Form::off(0.02)], 108.0);
        assert!(near[0] > near[1] && near[1] > 1.0, "{near:?}");
    }
}
