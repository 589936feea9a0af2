//! Where output goes.

use std::path::{Path, PathBuf};

use super::args::{self, Command};
use crate::diagnostic::{Error, Result};

/// Those that a command writes into; what is missing of them is made.
pub(super) fn folders(command: &Command) -> Result<Vec<PathBuf>> {
    use args::SpeciesCommand::{New, Schema, Show};
    let files: Vec<&PathBuf> = match command {
        Command::Demo(a) => return Ok(vec![a.output.clone()]),
        Command::Forest(a) => return Ok(vec![forest_folder(a)]),
        Command::Report(a) => match &a.write_front {
            Some(file) => vec![file],
            None => return Ok(vec![a.output.clone()]),
        },
        Command::Inventory(a) => vec![&a.output],
        Command::Terrain(a) => vec![&a.output],
        Command::Tree(a) => vec![&a.output],
        Command::Landscape(a) => a.output.iter().chain(&a.save).collect(),
        Command::Species(a) => match &a.command {
            New(a) => a.output.iter().collect(),
            Schema(a) => a.output.iter().collect(),
            Show(a) => vec![&a.output],
            _ => Vec::new(),
        },
    };
    let mut folders: Vec<PathBuf> =
        files.into_iter().map(|file| Ok(place(file)?.0)).collect::<Result<_>>()?;
    folders.dedup();
    Ok(folders)
}

pub(super) fn forest_folder(a: &args::Forest) -> PathBuf {
    a.output.clone().unwrap_or_else(|| Path::new("output").join(stem(&a.scan.scans[0])))
}

pub(super) fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "output".into(), |s| s.to_string_lossy().into_owned())
}

/// The folder and the name of an output file.
pub(super) fn place(path: &Path) -> Result<(PathBuf, String)> {
    let Some(name) = path.file_name() else {
        return Err(Error::new("is not a file name").in_file(path).remedy("give -o a file"));
    };
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok((dir.to_path_buf(), name.to_string_lossy().into_owned()))
}

/// The extension of an output file in lower case, one of `known`.
pub(super) fn extension<'a>(path: &Path, known: &[&'a str]) -> Result<&'a str> {
    let typed = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    known.iter().copied().find(|&k| typed.as_deref() == Some(k)).ok_or_else(|| {
        let list: Vec<String> = known.iter().map(|k| format!(".{k}")).collect();
        Error::new("the extension says no format that can be written here")
            .in_file(path)
            .remedy(format!("end the name with {}", list.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extension_chooses_or_refuses() {
        assert_eq!(extension(Path::new("a/B.GLB"), &["glb", "usda"]).unwrap(), "glb");
        let e = extension(Path::new("tree.obj"), &["glb", "usda"]).unwrap_err();
        assert_eq!(e.remedy_text(), Some("end the name with .glb, .usda"));
        assert!(extension(Path::new("tree"), &["glb"]).is_err());
    }

    #[test]
    fn a_bare_file_name_lies_in_the_current_folder() {
        assert_eq!(place(Path::new("x.tif")).unwrap(), (PathBuf::from("."), "x.tif".into()));
        assert!(place(Path::new("/")).is_err());
    }
}
