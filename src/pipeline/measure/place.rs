//! What a report is measured on: a scan as read, and the truth where it is known.

use std::path::PathBuf;

use super::super::survey::{self, Survey};
use super::super::{ForestJob, SurveyJob, demo};
use super::ReportJob;
use crate::diagnostic::{Error, Result};
use crate::export::{OutputFile, write_all};
use crate::frame::Frame;
use crate::ground::{self, Classified, Method};
use crate::report::{Recorder, Silent};
use crate::scan::{self, PointCloud};
use crate::seed::Seed;
use crate::simulate::{Comparison, Stand, StandOptions};
use crate::species::assign::SpeciesBy;
use crate::terrain::Terrain;

/// Trees of the simulated stand, in full and quick.
const TREES: [usize; 2] = [240, 60];

pub(super) struct Place {
    /// In a sentence.
    pub subject: String,
    pub scans: Vec<PathBuf>,
    pub photo: Option<PathBuf>,
    pub cloud: PointCloud,
    pub density_per_m2: f32,
    /// The truth of a simulated survey.
    pub stand: Option<Stand>,
    /// By the default method.
    pub classified: Classified,
    /// By the default settings.
    pub survey: Survey,
}

impl Place {
    pub fn of(job: &ReportJob, warnings: &mut Vec<String>) -> Result<Place> {
        match job.scans[..] {
            [] => Place::simulated(job, warnings),
            _ => {
                // A report says nothing of the folders of the machine.
                let name = |p: &PathBuf| {
                    p.file_name()
                        .map_or("a file".into(), |name| name.to_string_lossy().into_owned())
                };
                let names: Vec<String> = job.scans.iter().map(name).collect();
                let photo = job
                    .photo
                    .as_ref()
                    .map_or(String::new(), |p| format!(" with the photo {}", name(p)));
                let subject = format!("Measured on {}{photo}.", names.join(", "));
                Place::read(job, subject, job.scans.clone(), job.photo.clone(), None, warnings)
            }
        }
    }

    /// The stand of the demo, surveyed, in files of the scratch folder.
    pub fn simulated(job: &ReportJob, warnings: &mut Vec<String>) -> Result<Place> {
        let trees = TREES[usize::from(job.is_quick)];
        let options = StandOptions { trees, ..StandOptions::default() };
        let mut run = Recorder::new(&Silent);
        let made = demo::survey_of_stand(&options, &job.species, Seed::new(job.seed), &mut run)?;
        let files =
            vec![OutputFile::new("scan.laz", made.scan), OutputFile::new("photo.tif", made.photo)];
        write_all(&job.scratch, files)?;
        let at = |name: &str| job.scratch.join(name);
        let subject = format!("Measured on a simulated survey of {trees} trees with known truth.");
        let scans = vec![at("scan.laz")];
        Place::read(job, subject, scans, Some(at("photo.tif")), Some(made.stand), warnings)
    }

    fn read(
        job: &ReportJob,
        subject: String,
        scans: Vec<PathBuf>,
        photo: Option<PathBuf>,
        stand: Option<Stand>,
        warnings: &mut Vec<String>,
    ) -> Result<Place> {
        let mut run = Recorder::new(&Silent);
        let survey_job = survey_job(job, &scans, photo.clone());
        let survey = survey::inventory(&survey_job, &mut run)?;
        warnings.append(&mut run.warnings);
        let scan = scan::read(&scans, &survey::READ)?.into_value(&mut Vec::new());
        const MOST_POINTS: usize = 30_000_000;
        if scan.cloud.len() > MOST_POINTS {
            return Err(Error::new(format!(
                "{} points are too many to measure on",
                scan.cloud.len()
            ))
            .in_file(&scans[0])
            .remedy("give a part of the scan of at most 30 million points"));
        }
        let classified =
            ground::classify(scan.cloud.clone(), Method::Smrf)?.into_value(&mut Vec::new());
        Ok(Place {
            subject,
            scans,
            photo,
            cloud: scan.cloud,
            density_per_m2: scan.density_per_m2,
            stand,
            classified,
            survey,
        })
    }

    /// What was found beside what is there; `None` where that is not known.
    pub fn truth_of(
        &self,
        terrain: &Terrain,
        frame: &Frame,
        crowns: &[crate::crown::Crown],
    ) -> Option<Comparison> {
        let stand = self.stand.as_ref()?;
        Some(demo::compare_crowns(stand, frame, terrain, crowns.iter().map(|c| (c, ""))))
    }

    pub fn forest_job(&self, job: &ReportJob) -> ForestJob {
        ForestJob::new(survey_job(job, &self.scans, self.photo.clone()))
    }
}

pub(super) fn survey_job(job: &ReportJob, scans: &[PathBuf], photo: Option<PathBuf>) -> SurveyJob {
    SurveyJob {
        scans: scans.into(),
        ground: Method::Smrf,
        cell_m: None,
        tile_m: None,
        photo,
        species: job.species.clone(),
        species_by: SpeciesBy::Auto,
        voxel_m: None,
        min_height_m: 2.0,
        effort: super::super::Effort::Normal,
        seed: Seed::new(job.seed),
    }
}
