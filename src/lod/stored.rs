//! An impostor as bytes, and what decides it and the silhouettes of forms: for a store that outlives the run.

use std::borrow::Cow;

use bytes::Bytes;
use glam::Vec3;

use super::impostor::{Impostor, Kind};
use crate::diagnostic::Result;
use crate::mesh::Surface;
use crate::raster::Image;
use crate::scene::{Material, Octahedral, Part, Texture};

/// The program that bakes and looks: with another, the pictures are others. All that draws, and what turns pixels
/// into PNG.
const SOURCES: &[(&str, &str)] = &[
    ("impostor.rs", include_str!("impostor.rs")),
    ("light.rs", include_str!("light.rs")),
    ("silhouette.rs", include_str!("silhouette.rs")),
    ("stored.rs", include_str!("stored.rs")),
    ("../render/camera.rs", include_str!("../render/camera.rs")),
    ("../render/capture.rs", include_str!("../render/capture.rs")),
    ("../render/draw.rs", include_str!("../render/draw.rs")),
    ("../render/label.rs", include_str!("../render/label.rs")),
    ("../render/light.rs", include_str!("../render/light.rs")),
    ("../render/mod.rs", include_str!("../render/mod.rs")),
    ("../render/model.rs", include_str!("../render/model.rs")),
    ("../render/raster.rs", include_str!("../render/raster.rs")),
    ("../render/seen.rs", include_str!("../render/seen.rs")),
    ("../render/sky.rs", include_str!("../render/sky.rs")),
    ("../render/texture.rs", include_str!("../render/texture.rs")),
    ("../raster/cutout.rs", include_str!("../raster/cutout.rs")),
    ("../raster/encoded.rs", include_str!("../raster/encoded.rs")),
    ("../raster/mod.rs", include_str!("../raster/mod.rs")),
    ("../raster/pad.rs", include_str!("../raster/pad.rs")),
    ("../raster/picture.rs", include_str!("../raster/picture.rs")),
    ("../raster/png.rs", include_str!("../raster/png.rs")),
    ("../raster/srgb.rs", include_str!("../raster/srgb.rs")),
    ("../seed.rs", include_str!("../seed.rs")),
];

/// Everything that decides the impostor of a model, or what is seen of several forms.
pub struct Decides<'a>(Vec<Cow<'a, [u8]>>);

impl<'a> Decides<'a> {
    /// `size_px` as [`super::impostor::bake`] has it; of the materials and textures those count that the
    /// model shows, in all their looks.
    ///
    /// # Errors
    /// A picture whose size and pixels disagree.
    pub fn new(
        model: &'a [Part],
        materials: &'a [Material],
        textures: &'a [Texture],
        kind: Kind,
        size_px: u32,
    ) -> Result<Decides<'a>> {
        let mut all = Decides::by_program();
        all.0.push(format!("{kind:?} {size_px}").into_bytes().into());
        all.add(model, materials, textures)?;
        Ok(all)
    }

    /// The same of what is seen of forms of a model, and of impostors that turn.
    ///
    /// # Errors
    /// A picture whose size and pixels disagree.
    pub fn of_forms(
        forms: impl Iterator<Item = (&'a [Part], Option<Octahedral>)>,
        materials: &'a [Material],
        textures: &'a [Texture],
    ) -> Result<Decides<'a>> {
        let mut all = Decides::by_program();
        for (form, octahedral) in forms {
            all.0.push(format!("a form {octahedral:?}").into_bytes().into());
            all.add(form, materials, textures)?;
        }
        Ok(all)
    }

    fn by_program() -> Self {
        let mut all: Vec<Cow<[u8]>> = vec![env!("CARGO_PKG_VERSION").as_bytes().into()];
        all.extend(SOURCES.iter().map(|(_, text)| Cow::Borrowed(text.as_bytes())));
        Decides(all)
    }

    fn add(
        &mut self,
        model: &'a [Part],
        materials: &'a [Material],
        textures: &'a [Texture],
    ) -> Result<()> {
        let Decides(all) = self;
        for Part { name, surface, material } in model {
            let Surface { position, normal, uv, index, .. } = surface;
            all.push(bytemuck::cast_slice(position).into());
            all.push(bytemuck::cast_slice(normal).into());
            all.push(bytemuck::cast_slice(uv).into());
            all.push(bytemuck::cast_slice(index).into());
            let Some(m) = materials.get(*material as usize) else { continue };
            let looks = m.variants.iter().map(|v| (v.base_color, v.base_color_texture));
            let looks = [(m.base_color, m.base_color_texture)].into_iter().chain(looks);
            let about = |texture: Option<u32>| texture.and_then(|t| textures.get(t as usize));
            let pictures = looks.clone().map(|look| look.1);
            let pictures = pictures.chain([m.normal_texture, m.orm_texture]).map(about);
            let colours: Vec<[f32; 3]> = looks.map(|look| look.0).collect();
            // Floats print so that they read back as the same bits.
            let told = format!("{name:?} {:?} {:?} {colours:?}", m.alpha, m.double_sided);
            all.push(told.into_bytes().into());
            for texture in pictures {
                let space = texture.map(|t| t.colorspace);
                all.push(format!("{space:?}").into_bytes().into());
                texture.map(|t| t.image.png()).transpose()?;
                let png = texture.and_then(|t| t.image.known_png());
                all.extend(png.map(|png| Cow::Borrowed(&png[..])));
            }
        }
        Ok(())
    }

    pub fn parts(&self) -> impl Iterator<Item = &[u8]> {
        self.0.iter().map(Cow::as_ref)
    }
}

/// An [`Impostor`] whose pictures are coded or not, as they came.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    pub surface: Surface,
    pub colour: Image,
    pub normal: Image,
    pub octahedral: Option<Octahedral>,
    pub tinted: Vec<Image>,
}

impl From<Impostor> for Stored {
    fn from(baked: Impostor) -> Stored {
        let Impostor { surface, colour, normal, octahedral, tinted } = baked;
        Stored {
            surface,
            colour: colour.into(),
            normal: normal.into(),
            octahedral,
            tinted: tinted.into_iter().map(Image::from).collect(),
        }
    }
}

impl Stored {
    /// Parts that [`Stored::from_parts`] reads.
    ///
    /// # Errors
    /// A picture whose size and pixels disagree.
    pub fn to_parts(&self) -> Result<Vec<Bytes>> {
        let Surface { position, normal, uv, index, .. } = &self.surface;
        let head = self.octahedral.map_or(Vec::new(), |o| {
            let [x, y, z] = o.centre.to_array().map(f32::to_bits);
            vec![o.frames, x, y, z, o.radius_m.to_bits(), o.sheet_rms_m.to_bits()]
        });
        let bytes = |of: &[u8]| Bytes::copy_from_slice(of);
        let mut parts = vec![
            bytes(bytemuck::cast_slice(&head)),
            bytes(bytemuck::cast_slice(position)),
            bytes(bytemuck::cast_slice(normal)),
            bytes(bytemuck::cast_slice(uv)),
            bytes(bytemuck::cast_slice(index)),
        ];
        for picture in [&self.colour, &self.normal].into_iter().chain(&self.tinted) {
            parts.push(picture.png()?);
        }
        Ok(parts)
    }

    /// `None` unless the parts are those of [`Stored::to_parts`].
    pub fn from_parts(parts: Vec<Bytes>) -> Option<Stored> {
        let mut parts = parts.into_iter();
        let octahedral = match column::<u32>(&parts.next()?)[..] {
            [] => None,
            [frames, x, y, z, radius, rms] => {
                let centre = Vec3::from_array([x, y, z].map(f32::from_bits));
                let [radius_m, sheet_rms_m] = [radius, rms].map(f32::from_bits);
                Some(Octahedral { frames, centre, radius_m, sheet_rms_m })
            }
            _ => return None,
        };
        let surface = Surface {
            position: column(&parts.next()?),
            normal: column(&parts.next()?),
            uv: column(&parts.next()?),
            index: column(&parts.next()?),
            ..Surface::default()
        };
        surface.check().ok()?;
        let mut pictures = parts.map(|png| Image::from_png(png).ok());
        let (colour, normal) = (pictures.next()??, pictures.next()??);
        Some(Stored {
            surface,
            colour,
            normal,
            octahedral,
            tinted: pictures.collect::<Option<_>>()?,
        })
    }
}

fn column<T: bytemuck::Pod>(bytes: &[u8]) -> Vec<T> {
    bytemuck::pod_collect_to_vec(bytes)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::raster::Picture;
    use crate::scene::{Alpha, Colorspace, Scene, Variant, sample};

    /// Whatever is changed of what a model shows is told; what it does not show is not.
    #[test]
    fn everything_that_decides_is_named() {
        let mut scene = sample::forest(&["Betula pendula"], 4, 60.0);
        let wood = scene.prototypes[0].parts[0].material as usize;
        let grey = |value| Texture {
            name: format!("grey_{value}"),
            image: Picture::filled(8, 8, [value, 90, 90, 255]).into(),
            colorspace: Colorspace::Srgb,
        };
        let first = scene.textures.len() as u32;
        scene.textures.extend([grey(1), grey(2), grey(3), grey(4), grey(5)]);
        let m = &mut scene.materials[wood];
        m.base_color_texture = Some(first);
        (m.normal_texture, m.orm_texture) = (Some(first + 1), Some(first + 2));
        let look = Variant {
            name: "autumn".into(),
            base_color: [0.5; 3],
            base_color_texture: Some(first + 3),
        };
        m.variants = vec![look];
        let told = |scene: &Scene, kind: Kind, size_px: u32| -> Vec<Vec<u8>> {
            let (materials, textures) = (&scene.materials, &scene.textures);
            let model = &scene.prototypes[0].parts;
            let decides = Decides::new(model, materials, textures, kind, size_px).unwrap();
            decides.parts().map(<[u8]>::to_vec).collect()
        };
        let own = told(&scene, Kind::Cross, 64);
        assert_eq!(own, told(&scene, Kind::Cross, 64));
        let mut all = BTreeSet::from([
            own.clone(),
            told(&scene, Kind::Cross, 65),
            told(&scene, Kind::Octahedral { views: 4 }, 64),
            told(&scene, Kind::Octahedral { views: 5 }, 64),
        ]);
        let picture = |scene: &mut Scene, k: u32| {
            scene.textures[(first + k) as usize].image = Picture::filled(8, 8, [7; 4]).into();
        };
        let changes: [&dyn Fn(&mut Scene); 12] = [
            &|s| s.prototypes[0].parts[0].surface.position[0].x += 1e-6,
            &|s| s.prototypes[0].parts[0].surface.normal[0] = Vec3::ONE.normalize(),
            &|s| s.prototypes[0].parts[0].surface.uv[0].x += 1e-6,
            &|s| s.prototypes[0].parts[0].surface.index.swap(0, 1),
            &|s| s.materials[wood].base_color[1] += 1e-6,
            &|s| s.materials[wood].alpha = Alpha::Mask { cutoff: 0.3 },
            &|s| s.materials[wood].double_sided ^= true,
            &|s| s.materials[wood].variants[0].base_color[0] += 1e-6,
            &|s| picture(s, 0),
            &|s| picture(s, 1),
            &|s| picture(s, 2),
            &|s| picture(s, 3),
        ];
        let count = all.len() + changes.len();
        for change in changes {
            let mut other = scene.clone();
            change(&mut other);
            all.insert(told(&other, Kind::Cross, 64));
        }
        assert_eq!(all.len(), count);
        picture(&mut scene, 4);
        assert_eq!(told(&scene, Kind::Cross, 64), own, "a picture that it does not show");
    }

    #[test]
    fn every_source_of_what_draws_is_listed() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/render");
        for entry in std::fs::read_dir(folder).unwrap() {
            let name = entry.unwrap().file_name().to_string_lossy().into_owned();
            let is_listed = SOURCES.iter().any(|(n, _)| *n == format!("../render/{name}"));
            let is_source = name.ends_with(".rs") && name != "tests.rs";
            assert!(is_listed || !is_source, "{name} is not in SOURCES");
        }
    }
}
