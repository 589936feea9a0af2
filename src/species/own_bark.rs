//! A user's own pictures of bark, named by a rule file and read beside it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::model::OwnBark;
use super::node::{Node, Sources, Value};
use crate::diagnostic::{Error, Warned};
use crate::raster::Picture;

/// Bytes of one picture.
const MAX_BYTES: u64 = 64 << 20;
/// Pixels along a side of one.
const SIDES: std::ops::RangeInclusive<u32> = 16..=8192;

/// Keys that name the bark towards the top and on branches.
const UPPER: [&str; 2] = ["upper", "upper_style"];

/// A picture covers stem and branches: a drawn upper bark from below it goes. One that the same
/// file names, or one that extends it, stays.
pub fn cover(bark: &mut Node) {
    let Some(file) = named(bark, "picture").map(|n| n.place.source) else { return };
    // Sources are counted from the nearest; defaults come last.
    let is_meant = |key: &&str| bark.get(key).is_some_and(|n| n.place.source <= file);
    if UPPER.iter().any(is_meant) {
        return;
    }
    if let Value::Table(entries) = &mut bark.value {
        // `upper_from` has a default, and says nothing alone.
        entries.retain(|e| !UPPER.contains(&e.key.as_str()));
    }
}

/// The pictures that `[bark]` names; `None` where it names none or one is wrong.
pub fn read(bark: &Node, sources: &Sources, errors: &mut Vec<Error>) -> Option<Warned<OwnBark>> {
    let mut remarks = Vec::new();
    if named(bark, "picture").is_none() {
        // `''` takes away the pictures that go with it, too.
        let is_taken = bark.get("picture").is_some();
        for key in ["normal", "roughness"].into_iter().filter(|_| !is_taken) {
            if let Some(node) = named(bark, key) {
                let message = format!("`{key}` goes with a `picture`, and there is none");
                let error = sources.error(&node.place, message, "for which bark?");
                errors.push(error.remedy("name the picture of the bark: `picture = \"bark.png\"`"));
            }
        }
        return None;
    }
    let before = errors.len();
    let mut one = |key: &str| {
        let node = named(bark, key)?;
        // A value of another type is told with the rest of the keys.
        let name = node.as_text()?;
        match picture(&beside(node, sources, name)) {
            Ok(picture) => {
                remarks.extend(remark(name, &picture));
                remarks.extend((key == "normal").then(|| no_normals(name, &picture)).flatten());
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

/// What a key says but for `''`, which takes away what an extended file says.
fn named<'a>(bark: &'a Node, key: &str) -> Option<&'a Node> {
    bark.get(key).filter(|node| node.as_text() != Some(""))
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
        Err(e) => return Err(refused(path, &e)),
    }
    let mut picture = Picture::from_bytes(&bytes).map_err(|e| refused(path, &e))?;
    if picture.data.iter().all(|p| p[3] == 0) {
        let remedy = "give a picture that shows bark, opaque";
        return Err((format!("{shown} is wholly transparent"), remedy.into()));
    }
    // Bark is opaque.
    picture.data.iter_mut().for_each(|p| p[3] = 255);
    Ok(picture)
}

/// The file with what its decoder refused it for.
fn refused(path: &Path, e: &Error) -> (String, String) {
    let remedy = e.remedy_text().unwrap_or("save it again as PNG or JPEG");
    (format!("{} is {}", path.display(), e.message()), remedy.to_owned())
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

/// What is told of a picture that can hardly be of normals, the mean of which looks out of the bark.
fn no_normals(name: &str, picture: &Picture) -> Option<String> {
    /// Of 255: most that the mean leans along the bark, and least that it looks out of it.
    const MOST: f64 = 40.0;
    const LEAST: f64 = 40.0;
    let sum = |k: usize| picture.data.iter().map(|p| f64::from(p[k])).sum::<f64>();
    let mean = [0, 1, 2].map(|k| sum(k) / picture.data.len().max(1) as f64);
    let [x, y, z] = mean.map(|c| c - 127.5);
    (x.abs().max(y.abs()) > MOST || z < LEAST).then(|| {
        let [r, g, b] = mean.map(|c| c.round() as u8);
        format!(
            "{name} hardly holds normals: its mean colour is #{r:02x}{g:02x}{b:02x}, and that of normals \
             is about #8080ff; a picture of heights is to be turned into normals first"
        )
    })
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
        assert!(
            species.remarks[0].text.contains("rough.png is not square"),
            "{:?}",
            species.remarks
        );
    }

    #[test]
    fn a_picture_that_holds_no_normals_is_told_of() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("bark.png"), [64, 64], [90, 80, 70, 255]);
        for (colour, is_told) in
            [([128, 128, 255, 255], false), ([150, 110, 220, 255], false), ([120; 4], true)]
        {
            save(folder.path().join("n.png"), [64, 64], colour);
            let path = file(folder.path(), "picture = 'bark.png'\nnormal = 'n.png'");
            let remarks = load(&path).unwrap().remarks;
            assert_eq!(remarks.len(), usize::from(is_told), "{remarks:?}");
            assert!(
                !is_told || remarks[0].text.contains("n.png hardly holds normals"),
                "{remarks:?}"
            );
        }
    }

    #[test]
    fn a_picture_covers_stem_and_branches() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("bark.png"), [64, 64], [90, 80, 70, 255]);
        let of = |name: &str, base: &str, bark: &str| {
            let path = folder.path().join(name);
            let text = format!("extends = '{base}'\n[bark]\n{bark}");
            std::fs::write(&path, text).unwrap();
            load(&path.to_string_lossy()).unwrap()
        };
        let birch = load("betula_pendula").unwrap().bark;
        assert!(birch.upper.is_some() && birch.twig.is_some());

        let own = of("own.toml", "betula_pendula", "picture = 'bark.png'");
        assert_eq!((own.bark.upper, own.bark.upper_style), (None, None));
        assert_eq!(own.bark.twig, birch.twig);
        let drawn = crate::texture::for_species(&own, 64, crate::seed::Seed::new(1));
        assert!(drawn.bark_upper.is_none() && drawn.bark_twig.is_some());

        // Whoever names an upper bark beside the picture, or over it, wants it.
        for upper in ["upper = [9, 8, 7]", "upper_style = 'scales'"] {
            let bark = format!("picture = 'bark.png'\n{upper}");
            let kept = of("kept.toml", "betula_pendula", &bark).bark;
            assert!(kept.upper.is_some() && kept.upper_style.is_some(), "{upper}");
        }
        let over = of("over.toml", "own.toml", "upper = [9, 8, 7]").bark;
        assert_eq!(over.upper, Some([9, 8, 7]));
        let under = of("under.toml", "own.toml", "relief_m = 0.01").bark;
        assert_eq!(under.upper, None);
        let again = of("again.toml", "over.toml", "picture = 'bark.png'").bark;
        assert_eq!(again.upper, None);
    }

    #[test]
    fn an_empty_name_takes_a_picture_away_with_its_normals() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("bark.png"), [64, 64], [90, 80, 70, 255]);
        file(folder.path(), "picture = 'bark.png'\nnormal = 'bark.png'");
        let top = folder.path().join("top.toml");
        std::fs::write(&top, "extends = 'own.toml'\n[bark]\npicture = ''").unwrap();
        assert!(load(&top.to_string_lossy()).unwrap().own_bark.is_none());
        std::fs::write(&top, "extends = 'own.toml'\n[bark]\nnormal = ''").unwrap();
        assert!(load(&top.to_string_lossy()).unwrap().own_bark.unwrap().normal.is_none());
    }

    #[test]
    fn grey_wood_shows_where_a_user_s_bark_has_fallen_off() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("bark.png"), [64, 64], [40, 80, 30, 255]);
        let species = load(&file(folder.path(), "picture = 'bark.png'\nlost = 0.6")).unwrap();
        let drawn = crate::texture::for_species(&species, 64, crate::seed::Seed::new(1));
        assert!(drawn.bark.normal.is_some() && drawn.bark.height.is_none());
        let pixels = &drawn.bark.colour.picture().data;
        let bark = pixels.iter().filter(|p| p[..3] == [40, 80, 30]).count();
        let share = bark as f32 / pixels.len() as f32;
        assert!((0.2..0.5).contains(&share), "{share}");
        let wood = |p: &&[u8; 4]| p[0] >= p[1] && p[0] > 60;
        assert!(pixels.iter().filter(wood).count() > pixels.len() / 3);
    }

    /// A rule file begun from one with a picture holds every key, and is the same tree.
    #[test]
    fn a_picture_goes_over_into_an_upper_bark_that_is_named_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("bark.png"), [96, 200], [90, 80, 70, 255]);
        let text = "extends = 'betula_pendula'\n[bark]\npicture = 'bark.png'\nupper = [9, 200, 7]";
        let path = folder.path().join("own.toml");
        std::fs::write(&path, text).unwrap();
        let species = load(&path.to_string_lossy()).unwrap();
        let drawn = crate::texture::for_species(&species, 64, crate::seed::Seed::new(1));
        let between = drawn.bark_transition.unwrap();
        let picture = between.colour.picture();
        assert_eq!(picture.at(5, 63), [90, 80, 70, 255]);
        let [r, g, b, _] = picture.at(5, 0);
        assert!(r < 20 && g > 150 && b < 20, "{r} {g} {b}: that of the upper bark");
    }

    #[test]
    fn a_template_of_a_picture_has_no_upper_bark_either() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("bark.png"), [64, 64], [90, 80, 70, 255]);
        let base = folder.path().join("base.toml");
        std::fs::write(&base, "extends = 'betula_pendula'\n[bark]\npicture = 'bark.png'").unwrap();
        let text = crate::species::template("begun", &base.to_string_lossy()).unwrap();
        let begun = folder.path().join("begun.toml");
        std::fs::write(&begun, text).unwrap();
        let bark = load(&begun.to_string_lossy()).unwrap().bark;
        assert_eq!(bark, load(&base.to_string_lossy()).unwrap().bark);
    }

    #[test]
    fn what_is_wrong_is_told_at_its_key() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path().join("ok.png"), [64, 64], [9; 4]);
        save(folder.path().join("tiny.png"), [4, 4], [9; 4]);
        save(folder.path().join("clear.png"), [64, 64], [9, 9, 9, 0]);
        std::fs::write(folder.path().join("text.png"), "no picture").unwrap();
        let mut cut = Picture::filled(64, 64, [1, 2, 3, 255]).to_png().unwrap();
        cut.truncate(60);
        std::fs::write(folder.path().join("cut.png"), cut).unwrap();
        for (bark, says) in [
            ("picture = 'gone.png'", "`picture`: no picture"),
            ("picture = '.'", "is no file"),
            ("picture = 'text.png'", "not a readable picture"),
            ("picture = 'cut.png'", "cut.png is not a sound PNG"),
            ("picture = 'cut.png'", "save it again as PNG or JPEG"),
            ("picture = 'tiny.png'", "4 × 4 pixels"),
            ("picture = 'clear.png'", "clear.png is wholly transparent"),
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
