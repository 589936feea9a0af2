//! A user's own foliage: a twig, leaf or cone as Wavefront OBJ with the picture of its material,
//! or a picture of a twig alone. Read once, when the rule file is; what leaves here is sound.
//!
//! The library that reads OBJ stops at a fault without saying where and trusts some numbers, so
//! every line is looked at first. Limits: one picture a model (`map_Kd`); models of several plain
//! colours get a picture of swatches; polygons are cut into fans.

use std::io::BufReader;
use std::path::{Path, PathBuf};

use glam::{Vec2, Vec3};

use crate::diagnostic::{Error, Result};
use crate::raster::Picture;

/// Bytes of a model or of its material file, and of a picture.
const MAX_TEXT_BYTES: u64 = 32 << 20;
const MAX_PICTURE_BYTES: u64 = 64 << 20;
/// Side of a picture, pixels.
const MAX_SIDE_PX: u32 = 4096;
const MAX_TRIANGLES: usize = 200_000;
const MAX_MATERIALS: usize = 256;
/// Side of a swatch of plain colour, pixels.
const SWATCH_PX: u32 = 8;

/// A model to be set where twigs stand: y from 0 to 1 along the twig, z to the light, the origin
/// where it joins its shoot.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The file it came from.
    pub name: PathBuf,
    pub position: Vec<[f32; 3]>,
    /// Unit length.
    pub normal: Vec<[f32; 3]>,
    /// v = 0 at the bottom of the picture.
    pub uv: Vec<[f32; 2]>,
    /// Three a triangle.
    pub index: Vec<u32>,
    pub picture: Picture,
}

/// Reads an OBJ file and, through its material file, its picture.
///
/// # Errors
/// A file that can't be read or is no OBJ; a line with a fault; nothing to draw; more than the
/// limits; several pictures.
pub fn model(path: &Path) -> Result<Model> {
    let text = read_text(path, "give the path of an OBJ file")?;
    let count = vet_obj(path, &text)?;
    if count == 0 {
        return Err(Error::new("it has no faces")
            .in_file(path)
            .remedy("export a mesh, as triangles"));
    }
    let materials = materials(path, &text)?;
    let options = tobj::LoadOptions {
        single_index: true,
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
    };
    let ids = || materials.iter().enumerate().map(|(i, m)| (m.name.clone(), i)).collect();
    let (meshes, _) = tobj::load_obj_buf(&mut BufReader::new(text.as_bytes()), &options, |_| {
        Ok((materials.clone(), ids()))
    })
    .map_err(|e| Error::new(format!("not a sound OBJ file: {e}")).in_file(path).remedy(REMEDY))?;
    assemble(path, &meshes, &materials)
}

const REMEDY: &str = "export the model again, with normals and texture coordinates, as triangles";

fn assemble(path: &Path, meshes: &[tobj::Model], materials: &[tobj::Material]) -> Result<Model> {
    let fail = |what: String, remedy: &str| Err(Error::new(what).in_file(path).remedy(remedy));
    let used = |id: usize| meshes.iter().any(|m| m.mesh.material_id == Some(id));
    let mut pictures: Vec<&str> = (0..materials.len())
        .filter(|&id| used(id))
        .filter_map(|id| materials[id].diffuse_texture.as_deref())
        .collect();
    pictures.sort_unstable();
    pictures.dedup();
    let is_plain = |m: &tobj::Model| {
        m.mesh.material_id.and_then(|id| materials[id].diffuse_texture.as_ref()).is_none()
    };
    let picture = match pictures[..] {
        [] => swatches(materials),
        [name] if !meshes.iter().any(is_plain) => picture_beside(path, name)?,
        [name] => {
            return fail(
                format!("some of its materials have the picture {name}, others a plain colour"),
                "give every material the same picture (map_Kd)",
            );
        }
        [a, b, ..] => {
            return fail(
                format!("it has several pictures: {a}, {b}"),
                "bake them into one picture (map_Kd)",
            );
        }
    };
    let mut model = Model {
        name: path.to_path_buf(),
        position: Vec::new(),
        normal: Vec::new(),
        uv: Vec::new(),
        index: Vec::new(),
        picture,
    };
    for tobj::Model { mesh, .. } in meshes {
        let first = model.position.len() as u32;
        let n = mesh.positions.len() / 3;
        model.position.extend_from_slice(mesh.positions.as_chunks().0);
        model.index.extend(mesh.indices.iter().map(|i| i + first));
        if mesh.normals.len() == 3 * n {
            model.normal.extend_from_slice(mesh.normals.as_chunks().0);
        }
        model.normal.resize(first as usize + n, [0.0; 3]);
        if pictures.is_empty() {
            // The middle of the material's swatch.
            let id = mesh.material_id.map_or(0, |id| id + 1);
            let s = (id as f32 + 0.5) / (materials.len() + 1) as f32;
            model.uv.resize(first as usize + n, [s, 0.5]);
        } else if mesh.texcoords.len() == 2 * n {
            model.uv.extend_from_slice(mesh.texcoords.as_chunks().0);
        } else {
            return fail(
                "its faces have a picture and no texture coordinates".into(),
                "unwrap the model, and export it with texture coordinates",
            );
        }
    }
    settle(path, model)
}

/// Moves and scales the model to a height of 1, drops triangles without area and fills in normals.
fn settle(path: &Path, mut model: Model) -> Result<Model> {
    let high = model.position.iter().map(|p| p[1]).fold(0.0, f32::max);
    let far = model.position.iter().flatten().map(|x| x.abs()).fold(0.0, f32::max);
    if high <= 1e-4 * far || high < 1e-6 {
        let error = Error::new("it does not reach above its origin along y");
        return Err(error.in_file(path).remedy(
            "let the twig grow from the origin along y, its upper side to z, and export with y up",
        ));
    }
    for p in model.position.iter_mut().flatten() {
        *p /= high;
    }
    let at = |i: u32| Vec3::from(model.position[i as usize]);
    let mut summed = vec![Vec3::ZERO; model.position.len()];
    let mut index = Vec::with_capacity(model.index.len());
    for t in model.index.as_chunks::<3>().0 {
        let [a, b, c] = t.map(at);
        let area = (b - a).cross(c - a);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        // Thinner than this, a triangle has no area left where a tree puts it.
        if area.length() > 1e-4 * longest * longest.max(1e-3) {
            index.extend(t);
            t.iter().for_each(|&i| summed[i as usize] += area);
        }
    }
    model.index = index;
    for (n, s) in model.normal.iter_mut().zip(summed) {
        let own = Vec3::from(*n).normalize_or_zero();
        *n = if own == Vec3::ZERO { s.normalize_or(Vec3::Z) } else { own }.to_array();
    }
    if model.index.is_empty() {
        let error = Error::new("none of its faces has an area").in_file(path);
        return Err(error.remedy(REMEDY));
    }
    Ok(model)
}

/// One square of colour a material, the first for faces without any.
fn swatches(materials: &[tobj::Material]) -> Picture {
    let mut picture =
        Picture::filled(SWATCH_PX * (materials.len() as u32 + 1), SWATCH_PX, [120, 140, 80, 255]);
    for (k, material) in materials.iter().enumerate() {
        // Linear light, as most programs write it.
        let [r, g, b] = material.diffuse.unwrap_or([0.2, 0.26, 0.08]).map(|c| {
            let c = c.clamp(0.0, 1.0);
            let s = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
            (s * 255.0).round() as u8
        });
        for y in 0..SWATCH_PX {
            for x in 0..SWATCH_PX {
                picture.set((k as u32 + 1) * SWATCH_PX + x, y, [r, g, b, 255]);
            }
        }
    }
    picture
}

/// Looks at every line of an OBJ file: numbers finite, faces of corners that exist and all of one
/// kind. Gives the number of triangles.
fn vet_obj(path: &Path, text: &str) -> Result<usize> {
    let (mut counts, mut triangles) = ([0usize; 3], 0usize);
    let mut kind: Option<(usize, [bool; 3])> = None;
    for (k, line) in text.lines().enumerate() {
        let fail = |what: String, remedy: &str| {
            Err(Error::new(what).in_file(format!("{}:{}", path.display(), k + 1)).remedy(remedy))
        };
        let mut words = line.split_whitespace();
        let (slot, least) = match words.next() {
            Some("v") => (0, 3),
            Some("vt") => (1, 2),
            Some("vn") => (2, 3),
            Some("f") => {
                let mut corners = 0usize;
                for word in words {
                    corners += 1;
                    match corner(word, counts) {
                        Err(what) => return fail(what, "export the model again"),
                        Ok(own) => {
                            let (line, first) = *kind.get_or_insert((k + 1, own));
                            if first != own {
                                let what = format!(
                                    "the corner `{word}` has other parts than those of line {line}"
                                );
                                return fail(what, "give every corner the same: v/vt/vn");
                            }
                        }
                    }
                }
                if corners < 3 {
                    return fail(format!("a face of {corners} corners"), "give it three or more");
                }
                triangles += corners - 2;
                if triangles > MAX_TRIANGLES {
                    let what = format!("more than {MAX_TRIANGLES} triangles");
                    return fail(what, "a twig is set thousands of times: give it fewer");
                }
                continue;
            }
            _ => continue,
        };
        let numbers: Option<Vec<f32>> =
            words.map(|w| w.parse().ok().filter(|x: &f32| x.abs() < 1e6)).collect();
        match numbers {
            Some(numbers) if numbers.len() >= least => counts[slot] += 1,
            Some(numbers) => {
                let what = format!("{} numbers, not {least}", numbers.len());
                return fail(what, "export the model again");
            }
            None => return fail("not a list of ordinary numbers".into(), "export the model again"),
        }
    }
    Ok(triangles)
}

/// Which of position, texture coordinate and normal a face's corner has; what is wrong with it.
fn corner(word: &str, counts: [usize; 3]) -> std::result::Result<[bool; 3], String> {
    const KINDS: [&str; 3] = ["vertex", "texture coordinate", "normal"];
    let mut has = [false; 3];
    let parts: Vec<&str> = word.split('/').collect();
    if parts.len() > 3 {
        return Err(format!("`{word}` is no corner of a face"));
    }
    for (slot, part) in parts.iter().enumerate().filter(|(slot, p)| *slot == 0 || !p.is_empty()) {
        let number: i64 = part.parse().map_err(|_| format!("`{word}` is no corner of a face"))?;
        let count = counts[slot] as i64;
        // Backwards from the last, or from the first; either must stand above.
        let is_known = (1..=count).contains(&number) || (-count..=-1).contains(&number);
        if !is_known {
            return Err(format!("{} {number} of {count} in `{word}`", KINDS[slot]));
        }
        has[slot] = true;
    }
    Ok(has)
}

/// The materials of all material files that the model names, in their order.
fn materials(path: &Path, text: &str) -> Result<Vec<tobj::Material>> {
    let mut all = Vec::new();
    let mut read: Vec<&str> = Vec::new();
    for (k, line) in text.lines().enumerate() {
        let Some(name) = line.trim_start().strip_prefix("mtllib ").map(str::trim) else { continue };
        if name.is_empty() || read.contains(&name) {
            continue;
        }
        read.push(name);
        let file = beside(path, name);
        let place = format!("{}:{}", path.display(), k + 1);
        let text =
            read_text(&file, &format!("put it where {place} says, or export the model again"))?;
        vet_mtl(&file, &text)?;
        let (own, _) = tobj::load_mtl_buf(&mut BufReader::new(text.as_bytes())).map_err(|e| {
            Error::new(format!("not a sound material file: {e}")).in_file(&file).remedy(REMEDY)
        })?;
        all.extend(own);
        if all.len() > MAX_MATERIALS {
            let error = Error::new(format!("more than {MAX_MATERIALS} materials"));
            return Err(error.in_file(path).remedy("join materials of one colour"));
        }
    }
    Ok(all)
}

/// Colours are three ordinary numbers.
fn vet_mtl(path: &Path, text: &str) -> Result<()> {
    for (k, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        if !matches!(words.next(), Some("Ka" | "Kd" | "Ks" | "Ke")) {
            continue;
        }
        let numbers = words.take(3).filter_map(|w| w.parse::<f32>().ok());
        if numbers.filter(|x| x.is_finite()).count() != 3 {
            let error = Error::new("not a colour of three numbers");
            let place = format!("{}:{}", path.display(), k + 1);
            return Err(error.in_file(place).remedy("write red, green and blue, 0 to 1"));
        }
    }
    Ok(())
}

fn beside(path: &Path, name: &str) -> PathBuf {
    path.parent().unwrap_or(Path::new("")).join(name)
}

/// The picture of a material: its name may follow options.
fn picture_beside(path: &Path, name: &str) -> Result<Picture> {
    let whole = beside(path, name);
    let last = name.split_whitespace().next_back().map(|last| beside(path, last));
    match last {
        Some(last) if !whole.is_file() && (last.is_file() || name.starts_with('-')) => {
            read_picture(&last)
        }
        _ => read_picture(&whole),
    }
}

/// Reads a picture of a twig that grows up from the middle of the bottom edge; made square with
/// transparent pixels.
///
/// # Errors
/// A file that can't be read; no PNG or JPEG; no transparency, or nothing else.
pub fn twig_picture(path: &Path) -> Result<Picture> {
    let picture = read_picture(path)?;
    let opaque = picture.data.iter().filter(|p| p[3] >= 128).count();
    let fail = |what: &str, remedy: &str| Err(Error::new(what).in_file(path).remedy(remedy));
    if opaque == 0 {
        return fail("nothing in it is opaque", "give a picture that shows a twig");
    }
    if opaque == picture.data.len() {
        return fail(
            "it has no transparent pixels, so whole squares would be seen",
            "cut the twig out and save a PNG with alpha",
        );
    }
    let side = picture.width.max(picture.height);
    let left = (side - picture.width) / 2;
    let top = side - picture.height;
    let mut square = Picture::filled(side, side, [0; 4]);
    for y in 0..picture.height {
        for x in 0..picture.width {
            square.set(left + x, top + y, picture.at(x, y));
        }
    }
    Ok(square)
}

fn read_picture(path: &Path) -> Result<Picture> {
    let bytes = read(path, MAX_PICTURE_BYTES, "give the path of a PNG or JPEG file")?;
    let picture = Picture::from_bytes_within(&bytes, MAX_SIDE_PX).map_err(|e| e.in_file(path))?;
    if picture.data.is_empty() {
        return Err(Error::new("it has no pixels").in_file(path).remedy("give another picture"));
    }
    Ok(picture)
}

fn read_text(path: &Path, remedy: &str) -> Result<String> {
    let bytes = read(path, MAX_TEXT_BYTES, remedy)?;
    // Names in other alphabets are of no matter to the geometry.
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn read(path: &Path, most: u64, remedy: &str) -> Result<Vec<u8>> {
    use std::io::Read;
    let fail = |what: String| Error::new(what).in_file(path).remedy(remedy);
    let file = std::fs::File::open(path).map_err(|e| fail(format!("can't be read: {e}")))?;
    let mut bytes = Vec::new();
    let mut limited = file.take(most + 1);
    limited.read_to_end(&mut bytes).map_err(|e| fail(format!("can't be read: {e}")))?;
    if bytes.len() as u64 > most {
        return Err(fail(format!("more than {} MiB", most >> 20)));
    }
    Ok(bytes)
}

/// The largest square of opaque pixels, near enough: its middle, v = 0 at the bottom; the middle of
/// the picture where nothing is opaque.
pub fn opaque_spot(picture: &Picture) -> Vec2 {
    let (mut w, mut h) = (picture.width as usize, picture.height as usize);
    let mut level: Vec<bool> = picture.data.iter().map(|p| p[3] >= 250).collect();
    let mut best = Vec2::splat(0.5);
    while let Some(k) = level.iter().position(|&b| b) {
        let at = Vec2::new((k % w) as f32 + 0.5, (k / w) as f32 + 0.5);
        best = Vec2::new(at.x / w as f32, 1.0 - at.y / h as f32);
        let (nw, nh) = (w / 2, h / 2);
        if nw == 0 || nh == 0 {
            break;
        }
        let four = |x: usize, y: usize| {
            let i = 2 * y * w + 2 * x;
            level[i] && level[i + 1] && level[i + w] && level[i + w + 1]
        };
        level = (0..nw * nh).map(|i| four(i % nw, i / nw)).collect();
        (w, h) = (nw, nh);
    }
    best
}

#[cfg(test)]
mod tests;
