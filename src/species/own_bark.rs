//! A user's own pictures of bark, named by a rule file and read beside it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::model::OwnBark;
use super::node::{Node, Sources};
use crate::diagnostic::{Error, Warned};
use crate::raster::Picture;

/// Bytes of one picture.
const MAX_BYTES: u64 = 64 << 20;
/// Pixels along a side of one.
const SIDES: std::ops::RangeInclusive<u32> = 16..=8192;

/// The pictures that `[bark]` names; `None` where it names none or one is wrong.
pub fn read(bark: &Node, sources: &Sources, errors: &mut Vec<Error>) -> Option<Warned<OwnBark>> {
    let mut remarks = Vec::new();
    if bark.get("picture").is_none() {
        for key in ["normal", "roughness"] {
            if let Some(node) = bark.get(key) {
                let message = format!("`{key}` goes with a `picture`, and there is none");
                let error = sources.error(&node.place, message, "for which bark?");
                errors.push(error.remedy("name the picture of the bark: `picture = \"bark.png\"`"));
            }
        }
        return None;
    }
    let before = errors.len();
    let mut one = |key: &str| {
        let node = bark.get(key)?;
        // A value of another type is told with the rest of the keys.
        let name = node.as_text()?;
        match picture(&beside(node, sources, name)) {
            Ok(picture) => {
                remarks.extend(remark(name, &picture));
                Some(Arc::new(picture))
            }
            Err((message, remedy)) => {
                let message = format!("`{key}`: {message}");
                errors.push(sources.error(&node.place, message, "here").remedy(remedy));
                None
            }
        }
    };
    let (colour, normal, roughness) = (one("picture"), one("normal"), one("roughness"));
    let own = OwnBark { colour: colour?, normal, roughness };
    (errors.len() == before).then_some(Warned { value: own, warnings: remarks })
}

/// A name as the file means it that says it: beside that file.
fn beside(node: &Node, sources: &Sources, name: &str) -> PathBuf {
    let file = sources.0.get(node.place.source).map(|s| Path::new(s.name.as_str()));
    file.and_then(Path::parent).unwrap_or(Path::new("")).join(name)
}

/// The picture, or what is wrong with it and what to do.
fn picture(path: &Path) -> std::result::Result<Picture, (String, String)> {
    let shown = path.display();
    let size = match std::fs::metadata(path) {
        Ok(about) if about.is_file() => about.len(),
        Ok(_) => return Err((format!("{shown} is no file"), "name a PNG or JPEG file".into())),
        Err(e) => {
            let remedy = "names are looked for beside the rule file that says them";
            return Err((format!("no picture {shown} can be read: {e}"), remedy.into()));
        }
    };
    if size > MAX_BYTES {
        let message = format!("{shown} has {} MB, more than {}", size >> 20, MAX_BYTES >> 20);
        return Err((message, "save it smaller, or as JPEG".into()));
    }
    let bytes = std::fs::read(path)
        .map_err(|e| (format!("{shown} can't be read: {e}"), "check the file".to_owned()))?;
    let wrong_size = |w: u32, h: u32| {
        let (least, most) = (SIDES.start(), SIDES.end());
        let remedy = format!("scale it to sides of {least} to {most} pixels");
        (format!("{shown} has {w} × {h} pixels"), remedy)
    };
    // The header first: a small file can announce a picture that fills the memory.
    match Picture::size_of(&bytes) {
        Ok((w, h)) if SIDES.contains(&w) && SIDES.contains(&h) => {}
        Ok((w, h)) => return Err(wrong_size(w, h)),
        Err(e) => return Err((format!("{shown} is {}", e.message()), "give a PNG or JPEG".into())),
    }
    let mut picture = Picture::from_bytes(&bytes)
        .map_err(|e| (format!("{shown} is {}", e.message()), "save it anew".to_owned()))?;
    // Bark is opaque.
    picture.data.iter_mut().for_each(|p| p[3] = 255);
    Ok(picture)
}

/// Sizes that work, and may work better otherwise.
fn remark(name: &str, picture: &Picture) -> Option<String> {
    let (w, h) = (picture.width, picture.height);
    if w != h {
        return Some(format!(
            "{name} is not square: its {w} × {h} pixels are stretched over 1 m × 1 m"
        ));
    }
    let is_power = w.is_power_of_two();
    (!is_power)
        .then(|| format!("{name} has {w} pixels a side; game engines like powers of two better"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::render;
    use crate::species::load;

    fn file(folder: &Path, bark: &str) -> String {
        let path = folder.join("own.toml");
        std::fs::write(&path, format!("extends = 'quercus_robur'\n[bark]\n{bark}")).unwrap();
        path.to_string_lossy().into_owned()
    }

    fn save(path: PathBuf, [w, h]: [u32; 2], colour: [u8; 4]) {
        std::fs::write(path, Picture::filled(w, h, colour).to_png().unwrap()).unwrap();
    }

    #[test]
    fn pictures_are_read_beside_the_file_that_names_them() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("base");
        std::fs::create_dir(&base).unwrap();
        save(base.join("bark.png"), [64, 64], [90, 80, 70, 128]);
        save(base.join("rough.png"), [30, 40], [200, 200, 200, 255]);
        file(&base, "picture = 'bark.png'\nroughness = 'rough.png'");
        let top = folder.path().join("top.toml");
        std::fs::write(&top, "extends = 'base/own.toml'").unwrap();
        let species = load(&top.to_string_lossy()).unwrap();
        let own = species.own_bark.unwrap();
        assert_eq!(own.colour.data[0], [90, 80, 70, 255]);
        assert!(own.normal.is_none() && own.roughness.is_some());
        assert_eq!(species.remarks.len(), 1);
        assert!(species.remarks[0].contains("rough.png is not square"), "{:?}", species.remarks);
    }

    #[test]
    fn what_is_wrong_is_told_at_its_key() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("ok.png"), [64, 64], [9; 4]);
        save(folder.path().join("tiny.png"), [4, 4], [9; 4]);
        std::fs::write(folder.path().join("text.png"), "no picture").unwrap();
        let mut cut = Picture::filled(64, 64, [1, 2, 3, 255]).to_png().unwrap();
        cut.truncate(60);
        std::fs::write(folder.path().join("cut.png"), cut).unwrap();
        for (bark, says) in [
            ("picture = 'gone.png'", "`picture`: no picture"),
            ("picture = '.'", "is no file"),
            ("picture = 'text.png'", "not a readable picture"),
            ("picture = 'cut.png'", "not a readable picture"),
            ("picture = 'tiny.png'", "4 × 4 pixels"),
            ("picture = 'ok.png'\nnormal = 'gone.png'", "`normal`: no picture"),
            ("normal = 'ok.png'", "`normal` goes with a `picture`"),
            ("picture = 3", "picture"),
        ] {
            let shown = render(&load(&file(folder.path(), bark)).unwrap_err());
            assert!(shown.contains(says), "{bark}: {shown}");
            assert!(shown.contains("own.toml:3:") || shown.contains("own.toml:4:"), "{shown}");
        }
    }
}
