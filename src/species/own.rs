//! A user's own foliage: a twig, leaf or cone as Wavefront OBJ with the picture of its material,
//! or a picture of a twig alone. Read once, when the rule file is; what leaves here is sound.
//!
//! Every line is looked at first (see `lines`). Several pictures (`map_Kd`, cut by `map_d`) and plain colours are laid
//! side by side in one; then no texture coordinate may leave its picture. Polygons are cut into triangles (see `faces`).

mod faces;
mod lines;
mod turn;

use std::collections::BTreeSet;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use glam::{Vec2, Vec3};
use lines::{NO_UV, alike, joined, vet_mtl, vet_obj};
pub use turn::{leaf_colour, turned};

use crate::diagnostic::{Error, Result};
use crate::raster::{Picture, pad_transparent, srgb_from_linear};

/// Bytes of a model or of its material file, and of a picture.
const MAX_TEXT_BYTES: u64 = 32 << 20;
const MAX_PICTURE_BYTES: u64 = 64 << 20;
/// Side of a picture, pixels.
const MAX_SIDE_PX: u32 = 4096;
const MAX_MATERIALS: usize = 256;
/// Side of a swatch of plain colour, and pixels between pictures that are laid side by side.
const SWATCH_PX: u32 = 8;
const GUTTER_PX: u32 = 8;
/// Longest side of pictures laid side by side, and how far off a picture a coordinate may be.
const MAX_SHEET_PX: u32 = 8192;
const OFF: f32 = 1e-3;

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
    /// Tangent-space normals for it, x along u and y along v (up); `None` where no material has any.
    pub normals: Option<Picture>,
    /// What its material is called; `None` where it has none or several, which become one.
    pub material: Option<String>,
    /// That of its materials, 0…1; `None` where they tell none, or not the same.
    pub roughness: Option<f32>,
    /// What of it may not be as meant, one sentence each.
    pub remarks: Vec<String>,
}

impl Model {
    /// How much of the square over its height it hides, seen from any side: half of what is opaque of
    /// its faces, by places on each. Faces before each other count for themselves.
    pub fn shown(&self) -> f32 {
        const PLACES: u32 = 4;
        let (w, h) = (self.picture.width.max(1) as f32, self.picture.height.max(1) as f32);
        let is_opaque = |uv: Vec2| {
            let at = Vec2::new(uv.x, 1.0 - uv.y);
            let at = (at - at.floor()) * Vec2::new(w, h);
            let [x, y] = [at.x.min(w - 1.0), at.y.min(h - 1.0)].map(|c| c as u32);
            self.picture.at(x, y)[3] >= 128
        };
        let of_face = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| Vec3::from(self.position[i as usize]));
            let [p, q, r] = t.map(|i| Vec2::from(self.uv[i as usize]));
            let part = |k: u32| (k as f32 + 1.0 / 3.0) / PLACES as f32;
            let places = (0..PLACES).flat_map(|j| (0..PLACES - j).map(move |k| (part(j), part(k))));
            let opaque = |(s, t): (f32, f32)| is_opaque(p + (q - p) * s + (r - p) * t);
            let (seen, all) =
                places.fold((0, 0), |(seen, all), at| (seen + usize::from(opaque(at)), all + 1));
            0.5 * (b - a).cross(c - a).length() * seen as f32 / all as f32
        };
        0.5 * self.index.as_chunks::<3>().0.iter().map(of_face).sum::<f32>()
    }
}

/// Reads an OBJ file and, through its material file, its picture.
///
/// # Errors
/// A file that can't be read or is no OBJ; a line with a fault; nothing to draw; more than the
/// limits; a picture without texture coordinates, or one of several that they leave.
pub fn model(path: &Path) -> Result<Model> {
    let text = joined(read_text(path, "give the path of an OBJ file")?);
    let faces = vet_obj(path, &text)?;
    if faces.triangles == 0 {
        return Err(Error::new("it has no faces")
            .in_file(path)
            .remedy("export a mesh, as triangles"));
    }
    let materials = materials(path, &text)?;
    let nameless = nameless(path, &text, &materials);
    let text = if faces.is_mixed { alike(&text) } else { text };
    let options = tobj::LoadOptions {
        single_index: true,
        triangulate: false,
        ignore_points: true,
        ignore_lines: true,
    };
    let ids = || materials.iter().enumerate().map(|(i, m)| (m.name.clone(), i)).collect();
    let (meshes, _) = tobj::load_obj_buf(&mut BufReader::new(text.as_bytes()), &options, |_| {
        Ok((materials.clone(), ids()))
    })
    .map_err(|e| Error::new(format!("not a sound OBJ file: {e}")).in_file(path).remedy(REMEDY))?;
    let mut model = assemble(path, &meshes, &materials)?;
    model.remarks.extend(nameless);
    model.remarks.extend(hanging(path, &model));
    Ok(model)
}

/// How much finer normal maps may be than colours.
const FINER: u64 = 4;
const SHEET_REMEDY: &str = "bake them into one picture (map_Kd), or give smaller ones";
const REMEDY: &str = "export the model again, with normals and texture coordinates, as triangles";

fn assemble(path: &Path, meshes: &[tobj::Model], materials: &[tobj::Material]) -> Result<Model> {
    let fail = |what: String, remedy: &str| Err(Error::new(what).in_file(path).remedy(remedy));
    let used = |id: usize| meshes.iter().any(|m| m.mesh.material_id == Some(id));
    let mut skins: Vec<Skin> = (0..materials.len())
        .filter(|&id| used(id))
        .filter_map(|id| Skin::of(&materials[id]))
        .collect();
    skins.sort_unstable();
    skins.dedup();
    // By their heads, before any is decoded; normals may be finer than colours.
    let colours_px: u64 = skins.iter().map(|skin| wide_px(path, skin.name())).sum();
    let bumps_px = skins.iter().filter_map(|skin| skin.bumps).map(|name| wide_px(path, name)).sum();
    let most_px = u64::from(MAX_SHEET_PX);
    for (what, all_px, most_px) in
        [("pictures", colours_px, most_px), ("normal maps", bumps_px, FINER * most_px)]
    {
        if skins.len() > 1 && all_px > most_px {
            let error =
                format!("its {what} side by side are {all_px} pixels wide, more than {most_px}");
            return fail(error, SHEET_REMEDY);
        }
    }
    let pictures: Vec<Picture> =
        skins.iter().map(|skin| skin.picture(path)).collect::<Result<_>>()?;
    let bumps: Vec<Option<Picture>> =
        skins.iter().map(|skin| skin.bumps(path)).collect::<Result<_>>()?;
    let has_heights = bumps.iter().flatten().any(is_grey);
    let normals: Vec<Option<Picture>> =
        bumps.into_iter().map(|bump| bump.filter(|picture| !is_grey(picture))).collect();
    let shows = |m: &tobj::Mesh| {
        let skin = m.material_id.and_then(|id| Skin::of(&materials[id]))?;
        skins.binary_search(&skin).ok()
    };
    let is_whole = skins.len() == 1 && meshes.iter().all(|m| shows(&m.mesh).is_some());
    let sheet = if is_whole {
        None
    } else {
        Some(Sheet::new(&pictures, materials, &|id| {
            meshes.iter().any(|m| m.mesh.material_id == id && shows(&m.mesh).is_none())
        }))
    };
    if let Some(Sheet { picture, .. }) = &sheet
        && picture.width.max(picture.height) > MAX_SHEET_PX
    {
        return fail(
            format!(
                "its pictures side by side have {} by {} pixels, more than {MAX_SHEET_PX} along a side",
                picture.width, picture.height
            ),
            SHEET_REMEDY,
        );
    }
    let of_faces = || meshes.iter().map(|m| m.mesh.material_id.map(|id| &materials[id]));
    let mut model = Model {
        name: path.to_path_buf(),
        position: Vec::new(),
        normal: Vec::new(),
        uv: Vec::new(),
        index: Vec::new(),
        picture: Picture::filled(0, 0, [0; 4]),
        normals: None,
        material: same(of_faces().map(|m| Some(m?.name.clone()))),
        roughness: same(of_faces().map(|m| roughness(m?))),
        remarks: unused(
            path,
            materials.iter().enumerate().filter(|m| used(m.0)).map(|m| m.1),
            has_heights,
        )
        .into_iter()
        .collect(),
    };
    for tobj::Model { mesh, .. } in meshes {
        let first = model.position.len() as u32;
        let n = mesh.positions.len() / 3;
        model.position.extend_from_slice(mesh.positions.as_chunks().0);
        model.index.extend(faces::triangles(mesh).iter().map(|i| i + first));
        if mesh.normals.len() == 3 * n {
            model.normal.extend_from_slice(mesh.normals.as_chunks().0);
        }
        model.normal.resize(first as usize + n, [0.0; 3]);
        let Some(shown) = shows(mesh) else {
            let middle = sheet.as_ref().map_or(Vec2::ZERO, |s| s.colour(mesh.material_id));
            model.uv.resize(first as usize + n, middle.to_array());
            continue;
        };
        let uv = mesh.texcoords.as_chunks().0;
        if uv.len() != n || uv.iter().any(|uv: &[f32; 2]| uv[0] >= NO_UV) {
            return fail(
                "its faces have a picture and no texture coordinates".into(),
                "unwrap the model, and export it with texture coordinates",
            );
        }
        let Some(sheet) = &sheet else {
            model.uv.extend_from_slice(uv);
            continue;
        };
        let is_off = |x: &f32| !(-OFF..=1.0 + OFF).contains(x);
        if let Some([u, v]) = uv.iter().find(|uv| uv.iter().any(is_off)) {
            return fail(
                format!(
                    "the texture coordinate {u}, {v} leaves the picture {}, which is not its only colour",
                    skins[shown].name()
                ),
                "lay all of them within 0 to 1, or bake its colours into one picture (map_Kd)",
            );
        }
        model.uv.extend(uv.iter().map(|uv| sheet.place(shown, (*uv).into()).to_array()));
    }
    (model.normals, model.picture) = match sheet {
        Some(sheet) => (sheet.normals(&normals), sheet.picture),
        None => {
            let own = pictures.into_iter().next().unwrap_or(model.picture);
            (normals.into_iter().next().flatten(), own)
        }
    };
    settle(path, model)
}

/// Moves and scales the model to a height of 1, drops triangles without area and fills in normals.
fn settle(path: &Path, mut model: Model) -> Result<Model> {
    let high = model.position.iter().map(|p| p[1]).fold(0.0, f32::max);
    let far = model.position.iter().flatten().map(|x| x.abs()).fold(0.0, f32::max);
    let at = |i: u32| model.position[i as usize];
    let is_flat = |t: &[u32; 3]| {
        let [a, b, c] = t.map(at);
        a == b || b == c || c == a
    };
    if model.index.as_chunks::<3>().0.iter().all(is_flat) {
        let error = Error::new("none of its faces has an area").in_file(path);
        return Err(error.remedy(REMEDY));
    }
    if far < 1e-6 {
        let error = Error::new(format!("it is {far:e} large, too small to tell its corners apart"));
        return Err(error
            .in_file(path)
            .remedy("export it larger: it is scaled to its twig's length"));
    }
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

/// What all of them are.
fn same<T: PartialEq>(mut all: impl Iterator<Item = Option<T>>) -> Option<T> {
    let first = all.next()??;
    all.all(|other| other.as_ref() == Some(&first)).then_some(first)
}

/// `Pr`, or else what Blender makes of `Ns`, and writes it for.
fn roughness(material: &tobj::Material) -> Option<f32> {
    const MOST_NS: f32 = 1000.0;
    let own = material.unknown_param.get("Pr").and_then(|text| text.trim().parse().ok());
    let of_ns = |ns: f32| 1.0 - (ns / MOST_NS).clamp(0.0, 1.0).sqrt();
    own.or(material.shininess.map(of_ns)).filter(|r| r.is_finite()).map(|r| r.clamp(0.0, 1.0))
}

/// What faces of a material show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Skin<'a> {
    /// Its picture, and where there is none its colour.
    colour: std::result::Result<&'a str, [u8; 3]>,
    /// The picture of what is opaque, where it is another.
    mask: Option<&'a str>,
    /// That of its normals, or of heights.
    bumps: Option<&'a str>,
}

impl<'a> Skin<'a> {
    /// `None` for a plain colour.
    fn of(material: &'a tobj::Material) -> Option<Skin<'a>> {
        let own = material.diffuse_texture.as_deref();
        let mask = material.dissolve_texture.as_deref().filter(|mask| Some(*mask) != own);
        let plain = material.diffuse.map_or(PLAIN, srgb);
        let norm = material.unknown_param.get("norm").map(String::as_str);
        let bumps = norm.or(material.normal_texture.as_deref());
        (own.is_some() || mask.is_some()).then_some(Skin { colour: own.ok_or(plain), mask, bumps })
    }

    fn name(&self) -> &'a str {
        self.colour.ok().or(self.mask).unwrap_or_default()
    }

    fn bumps(&self, path: &Path) -> Result<Option<Picture>> {
        self.bumps.map(|name| picture_beside(path, name)).transpose()
    }

    /// In the size of its colours.
    fn picture(&self, path: &Path) -> Result<Picture> {
        let mask = self.mask.map(|name| picture_beside(path, name)).transpose()?;
        let mut picture = match (self.colour, &mask) {
            (Ok(name), _) => picture_beside(path, name)?,
            (Err([r, g, b]), Some(mask)) => {
                Picture::filled(mask.width, mask.height, [r, g, b, 255])
            }
            (Err([r, g, b]), None) => Picture::filled(SWATCH_PX, SWATCH_PX, [r, g, b, 255]),
        };
        let Some(mask) = mask else { return Ok(picture) };
        // By its alpha, as exporters that keep one name it; else by its grey.
        let has_alpha = mask.data.iter().any(|p| p[3] < 255);
        let opacity = |[r, g, b, a]: [u8; 4]| {
            if has_alpha { u32::from(a) } else { (u32::from(r) + u32::from(g) + u32::from(b)) / 3 }
        };
        let (width, height) = (picture.width, picture.height);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let [r, g, b, a] = picture.at(x, y);
            let at = mask.at(x * mask.width / width, y * mask.height / height);
            picture.set(x, y, [r, g, b, (u32::from(a) * opacity(at) / 255) as u8]);
        }
        pad_transparent(&mut picture);
        Ok(picture)
    }
}

/// Heights rather than normals.
fn is_grey(picture: &Picture) -> bool {
    picture.data.iter().all(|p| p[0].abs_diff(p[1]).max(p[1].abs_diff(p[2])) <= 2)
}

/// Pictures side by side, and after them a square for each material, the first for faces without any:
/// of its colour where faces show it.
struct Sheet {
    picture: Picture,
    /// Of each picture: its left edge and its size, pixels; all begin at the top.
    at: Vec<(u32, [u32; 2])>,
    /// Squares in a column, and the left edge of the first.
    rows: u32,
    left: u32,
}

impl Sheet {
    fn new(
        pictures: &[Picture],
        materials: &[tobj::Material],
        is_plain: &dyn Fn(Option<usize>) -> bool,
    ) -> Sheet {
        let count = materials.len() as u32 + 1;
        let tallest = pictures.iter().map(|p| p.height).fold(SWATCH_PX, u32::max);
        let rows = (tallest / SWATCH_PX).clamp(1, count);
        let mut at = Vec::new();
        let mut left = 0;
        for p in pictures {
            at.push((left, [p.width, p.height]));
            left += p.width + GUTTER_PX;
        }
        let width = left + count.div_ceil(rows) * SWATCH_PX;
        let mut sheet = Sheet { picture: Picture::filled(0, 0, [0; 4]), at, rows, left };
        if width.max(tallest) > MAX_SHEET_PX {
            (sheet.picture.width, sheet.picture.height) = (width, tallest);
            return sheet;
        }
        sheet.picture = Picture::filled(width, tallest, [0; 4]);
        for (p, &(left, _)) in pictures.iter().zip(&sheet.at) {
            for (x, y) in (0..p.height).flat_map(|y| (0..p.width).map(move |x| (x, y))) {
                sheet.picture.set(left + x, y, p.at(x, y));
            }
        }
        let colours = materials.iter().map(|m| m.diffuse.map_or(PLAIN, srgb));
        let ids = std::iter::once(None).chain((0..materials.len()).map(Some));
        for (k, (id, [r, g, b])) in (0..).zip(ids.zip(std::iter::once(PLAIN).chain(colours))) {
            if !is_plain(id) {
                continue;
            }
            let (x, y) = sheet.square(k);
            for (i, j) in (0..SWATCH_PX).flat_map(|j| (0..SWATCH_PX).map(move |i| (i, j))) {
                sheet.picture.set(x + i, y + j, [r, g, b, 255]);
            }
        }
        pad_transparent(&mut sheet.picture);
        // What lies between makes nothing transparent that is not.
        if pictures.iter().flat_map(|p| &p.data).all(|p| p[3] == 255) {
            sheet.picture.data.iter_mut().for_each(|p| p[3] = 255);
        }
        sheet
    }

    /// Normals for the pictures, laid as they are; level elsewhere. `None` for none at all.
    fn normals(&self, of: &[Option<Picture>]) -> Option<Picture> {
        const LEVEL: [u8; 4] = [128, 128, 255, 255];
        of.iter().any(Option::is_some).then(|| {
            let mut out = Picture::filled(self.picture.width, self.picture.height, LEVEL);
            for (normals, &(left, [width, height])) in of.iter().zip(&self.at) {
                let Some(normals) = normals else { continue };
                for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                    let at = normals.at(x * normals.width / width, y * normals.height / height);
                    out.set(left + x, y, at);
                }
            }
            out
        })
    }

    /// Left and upper edge of a square.
    fn square(&self, k: u32) -> (u32, u32) {
        (self.left + k / self.rows * SWATCH_PX, k % self.rows * SWATCH_PX)
    }

    /// Texture coordinate of a material's colour.
    fn colour(&self, material: Option<usize>) -> Vec2 {
        let (x, y) = self.square(material.map_or(0, |id| id as u32 + 1));
        let middle = Vec2::new(x as f32, y as f32) + 0.5 * SWATCH_PX as f32;
        self.coordinate(middle)
    }

    /// Texture coordinate of a picture's own.
    fn place(&self, picture: usize, uv: Vec2) -> Vec2 {
        let (left, [w, h]) = self.at[picture];
        let size = Vec2::new(w as f32, h as f32);
        // Half a pixel from the edge, past which another picture may be.
        let at = (Vec2::new(uv.x, 1.0 - uv.y) * size).clamp(Vec2::splat(0.5), size - 0.5);
        self.coordinate(Vec2::new(left as f32, 0.0) + at)
    }

    /// `at`: pixels from the left and from the top.
    fn coordinate(&self, at: Vec2) -> Vec2 {
        let part = at / Vec2::new(self.picture.width as f32, self.picture.height as f32);
        Vec2::new(part.x, 1.0 - part.y)
    }
}

/// The colour of faces without any.
const PLAIN: [u8; 3] = [120, 140, 80];

/// Of linear light, as most programs write it.
fn srgb(linear: [f32; 3]) -> [u8; 3] {
    linear.map(|c| srgb_from_linear(c).round() as u8)
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

/// Of faces without a material, or whose material no file has, but for the names that exporters give to
/// none.
fn nameless(path: &Path, text: &str, materials: &[tobj::Material]) -> Option<String> {
    const NONE: [&str; 3] = ["none", "(null)", "default"];
    if !text.lines().any(|line| line.trim_start().starts_with("usemtl")) {
        let model = path.display();
        return Some(format!("{model}: no face has a material (usemtl): all are plain green"));
    }
    let (line, name) = text.lines().enumerate().find_map(|(k, line)| {
        let name = line.trim_start().strip_prefix("usemtl")?.trim();
        let is_none = NONE.iter().any(|none| name.eq_ignore_ascii_case(none));
        (!is_none && materials.iter().all(|m| m.name != name)).then_some((k + 1, name))
    })?;
    Some(format!(
        "{}:{line}: no material file (mtllib) has the material `{name}`: its faces are plain green",
        path.display()
    ))
}

/// How far from where it joins its shoot a model may begin, of its height.
const FAR: f32 = 0.1;

/// Of a model that would hang in the air.
fn hanging(path: &Path, model: &Model) -> Option<String> {
    let at = |i: u32| Vec3::from(model.position[i as usize]);
    let triangles = model.index.as_chunks::<3>().0.iter();
    let gap = triangles.map(|t| nearest(t.map(at)).length()).fold(f32::INFINITY, f32::min);
    (gap > FAR).then(|| {
        format!(
            "{}: its faces begin {:.0} % of its height away from its origin, where it joins its shoot: it \
             will hang in the air; move it there",
            path.display(),
            100.0 * gap
        )
    })
}

/// The place of a triangle that is nearest to the origin.
fn nearest([a, b, c]: [Vec3; 3]) -> Vec3 {
    let normal = (b - a).cross(c - a);
    let within = |p: Vec3, q: Vec3| (q - p).cross(-p).dot(normal) >= 0.0;
    if within(a, b) && within(b, c) && within(c, a) {
        return normal * (a.dot(normal) / normal.length_squared().max(f32::MIN_POSITIVE));
    }
    let on_edge = |p: Vec3, q: Vec3| {
        let along = q - p;
        p + along * (-p.dot(along) / along.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
    };
    let edges = [on_edge(a, b), on_edge(b, c), on_edge(c, a)];
    edges.into_iter().min_by(|p, q| p.length_squared().total_cmp(&q.length_squared())).unwrap_or(a)
}

/// Of what would change the look, and is not what every exporter writes.
fn unused<'a>(
    path: &Path,
    materials: impl Iterator<Item = &'a tobj::Material>,
    has_heights: bool,
) -> Option<String> {
    let mut unused = BTreeSet::new();
    if has_heights {
        unused.insert("map_Bump of heights");
    }
    for m in materials {
        let mut note = |is_there: bool, name| is_there.then(|| unused.insert(name));
        note(m.specular_texture.is_some(), "map_Ks");
        note(m.shininess_texture.is_some(), "map_Ns");
        note(m.dissolve.is_some_and(|d| d < 1.0), "d");
        for name in ["map_Pr", "map_Pm", "map_Ke", "disp"] {
            note(m.unknown_param.contains_key(name), name);
        }
    }
    let names: Vec<&str> = unused.into_iter().collect();
    (!names.is_empty()).then(|| {
        format!(
            "{}: {} of its materials not used: leaves have the colour of map_Kd, or Kd, its alpha times map_d, and normals of map_Bump",
            path.display(),
            names.join(", ")
        )
    })
}

/// The file of a name in another: with the separators of another system, or beside that where it was written to lie
/// in a folder of another machine, if it is there.
fn beside(path: &Path, name: &str) -> PathBuf {
    let folder = path.parent().unwrap_or(Path::new(""));
    let whole = folder.join(name);
    let slashed = name.replace('\\', "/");
    let is_rooted = slashed.starts_with('/') || slashed.get(1..2) == Some(":");
    let last = slashed.rsplit('/').next().filter(|_| is_rooted);
    let others = [Some(slashed.as_str()), last].into_iter().flatten().map(|name| folder.join(name));
    let is_there = whole.is_file();
    others.into_iter().find(|other| !is_there && other.is_file()).unwrap_or(whole)
}

/// The file of a picture of a material of a model: its name may follow options.
fn picture_file(model: &Path, name: &str) -> PathBuf {
    let whole = beside(model, name);
    let last = name.split_whitespace().next_back().map(|last| beside(model, last));
    match last {
        Some(last) if !whole.is_file() && (last.is_file() || name.starts_with('-')) => last,
        _ => whole,
    }
}

/// How wide it is; 0 for what can't be read, which is an error later.
fn wide_px(model: &Path, name: &str) -> u64 {
    let bytes = read(&picture_file(model, name), MAX_PICTURE_BYTES, "");
    let size = bytes.and_then(|bytes| Picture::size_of(&bytes));
    size.map_or(0, |(width, _)| u64::from(width))
}

fn picture_beside(model: &Path, name: &str) -> Result<Picture> {
    read_picture(&picture_file(model, name), "give the path of a PNG or JPEG file").map_err(|e| {
        match (named_at(model, name), e.remedy_text()) {
            (Some(place), Some(remedy)) => {
                let remedy = format!("{place} names it: {remedy}");
                e.remedy(remedy)
            }
            _ => e,
        }
    })
}

/// The line of a material file of the model that names a picture.
fn named_at(model: &Path, name: &str) -> Option<String> {
    let text = read_text(model, "").ok()?;
    let files = text.lines().filter_map(|line| line.trim_start().strip_prefix("mtllib "));
    files.map(|file| beside(model, file.trim())).find_map(|file| {
        let text = read_text(&file, "").ok()?;
        let is_it = |line: &str| {
            let mut words = line.split_whitespace();
            let key = words.next().is_some_and(|key| !key.starts_with('#'));
            key && words.eq(name.split_whitespace())
        };
        let line = text.lines().position(is_it)?;
        Some(format!("{}:{}", file.display(), line + 1))
    })
}

/// Reads a picture of a twig that grows up from the middle of the bottom edge; made square with
/// transparent pixels.
///
/// # Errors
/// A file that can't be read; no PNG or JPEG; no transparency, or nothing else.
pub fn twig_picture(path: &Path) -> Result<Picture> {
    let picture = read_picture(path, "give the path of a PNG file with alpha")?;
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

/// `remedy`: for a file that can't be read.
fn read_picture(path: &Path, remedy: &str) -> Result<Picture> {
    let bytes = read(path, MAX_PICTURE_BYTES, remedy)?;
    let picture = Picture::from_bytes_within(&bytes, MAX_SIDE_PX).map_err(|e| e.in_file(path))?;
    if picture.data.is_empty() {
        return Err(Error::new("it has no pixels").in_file(path).remedy("give another picture"));
    }
    Ok(picture)
}

fn read_text(path: &Path, remedy: &str) -> Result<String> {
    let bytes = read(path, MAX_TEXT_BYTES, remedy)?;
    // Names in other alphabets are of no matter to the geometry.
    let text = String::from_utf8_lossy(&bytes);
    Ok(text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned())
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
