//! A stand with known truth, surveyed, and the rebuilt forest beside it.

use glam::{DVec3, Vec2};

use super::survey::Survey;
use super::view::Clip;
use crate::crown::Crown;
use crate::diagnostic::Result;
use crate::frame::Frame;
use crate::raster::geotiff;
use crate::report::{Outcome, Recorder, significant};
use crate::scan;
use crate::seed::Seed;
use crate::simulate::{
    self, Comparison, FoundTree, PhotoOptions, ScannerOptions, Stand, StandOptions, Window,
};
use crate::species::Species;
use crate::terrain::Terrain;

/// A stand and the files of its survey.
pub struct Simulated {
    pub stand: Stand,
    /// LAZ.
    pub scan: Vec<u8>,
    /// GeoTIFF.
    pub photo: Vec<u8>,
}

/// Plants a stand of these species and flies a scanner and a camera over it.
///
/// # Errors
/// A stand without species or trees.
pub fn survey_of_stand(
    options: &StandOptions,
    species: &[Species],
    seed: Seed,
    run: &mut Recorder,
) -> Result<Simulated> {
    run.stage("simulate", |_| {
        let stand = simulate::stand(species, options, seed)?;
        let cloud = simulate::scan(&stand, &ScannerOptions::default(), seed);
        let photo = simulate::photo(&stand, &PhotoOptions::default(), seed);
        let points = cloud.len();
        let scan = scan::encode_laz(&cloud)?;
        let photo = geotiff::encode(&photo)?;
        let planted = stand.trees.len();
        Ok((Simulated { stand, scan, photo }, Outcome::items(planted, "trees", points, "points")))
    })
}

/// The survey beside the stand it was made of, or the part that both were cut to.
pub fn compare(stand: &Stand, survey: &Survey, clip: Option<&Clip>) -> Comparison {
    let trees = survey.trees.iter().map(|t| (&t.crown, t.species.as_str()));
    let local = |x, y| stand.frame.local_from_world(stand.frame.origin.with_x(x).with_y(y));
    let window = |c: &Clip| Window {
        low: local(c.west, c.south).truncate().as_dvec2(),
        high: local(c.east, c.north).truncate().as_dvec2(),
    };
    let within = clip.map_or(Window::ALL, window);
    compare_within(stand, &survey.frame, &survey.terrain, trees, &within)
}

/// Crowns, each with its species, and terrain in a frame beside the stand that they were found in.
pub fn compare_crowns<'a>(
    stand: &Stand,
    frame: &Frame,
    terrain: &Terrain,
    crowns: impl IntoIterator<Item = (&'a Crown, &'a str)>,
) -> Comparison {
    compare_within(stand, frame, terrain, crowns, &Window::ALL)
}

fn compare_within<'a>(
    stand: &Stand,
    frame: &Frame,
    terrain: &Terrain,
    crowns: impl IntoIterator<Item = (&'a Crown, &'a str)>,
    within: &Window,
) -> Comparison {
    let found = |(crown, species): (&Crown, &str)| {
        let p = stand.frame.local_from_world(frame.world_from_local(crown.root));
        FoundTree {
            x: p.x.into(),
            y: p.y.into(),
            height_m: crown.height_m,
            crown_diameter_m: crown.diameter_m,
            species: species.to_owned(),
        }
    };
    let found: Vec<FoundTree> = crowns.into_iter().map(found).collect();
    let shift = frame.origin - stand.frame.origin;
    simulate::compare(stand, &found, within, |x, y| {
        let p = DVec3::new(x, y, 0.0) - shift;
        f64::from(terrain.height_at(Vec2::new(p.x as f32, p.y as f32))) + shift.z
    })
}

/// The comparison for a person.
pub fn lines(c: &Comparison) -> Vec<String> {
    let m = |v: f64| significant(v);
    vec![
        format!(
            "found {} of {} trees: {} matched, {} missed, {} invented (F1 {:.2})",
            c.found, c.trees, c.matched, c.missed, c.invented, c.f1
        ),
        format!(
            "RMSE: position {} m, height {} m (bias {:+.2}), crown diameter {} m (bias {:+.2}), \
             terrain {} m (bias {:+.2})",
            m(c.position_rmse_m),
            m(c.height.rmse_m),
            c.height.bias_m,
            m(c.crown_diameter.rmse_m),
            c.crown_diameter.bias_m,
            m(c.terrain.rmse_m),
            c.terrain.bias_m
        ),
        format!("species right for {:.0} % of the matched trees", 100.0 * c.species_accuracy),
    ]
}
