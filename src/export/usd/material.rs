//! Materials as UsdPreviewSurface networks.

use super::layer::{Prim, Value};
use super::{PictureFormat, texture_path};
use crate::scene::{Alpha, Material, ValidScene, Wrap};

const RGB: &[(&str, &str)] = &[("float3", "outputs:rgb")];
const RGBA: &[(&str, &str)] = &[("float", "outputs:a"), ("float3", "outputs:rgb")];
const HEIGHT: &[(&str, &str)] = &[("float", "outputs:r")];
const ORM: &[(&str, &str)] = &[("float", "outputs:g"), ("float", "outputs:r")];

/// A material's own colours, or those of a variant of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Colours {
    base: [f32; 3],
    texture: Option<u32>,
}

impl Colours {
    pub fn of(material: &Material) -> Colours {
        Colours { base: material.base_color, texture: material.base_color_texture }
    }

    /// In the variant of this name; its own where it knows none.
    pub fn in_variant(material: &Material, name: &str) -> Colours {
        let variant = material.variants.iter().find(|v| v.name == name);
        variant.map_or(Colours::of(material), |v| Colours {
            base: v.base_color,
            texture: v.base_color_texture,
        })
    }
}

/// `parent` is the path of the prim that it is put in. A tinted texture is read a second time,
/// untinted, for its alpha: Blender (4.5) takes the tint for the alpha otherwise.
pub(super) fn material<'a>(
    scene: &'a ValidScene,
    material: &'a Material,
    colours: Colours,
    parent: &str,
    textures: &TexturePaths,
) -> Prim<'a> {
    let path = format!("{parent}/{}", material.name);
    let output = |shader: &str, name: &str| format!("{path}/{shader}.outputs:{name}");
    let [r, g, b] = colours.base;
    let is_tinted = colours.base != [1.0; 3];
    let opacity = if is_tinted { "opacity" } else { "base_color" };
    let is_masked = matches!(material.alpha, Alpha::Mask { .. });

    let mut surface = Prim::def("Shader", "surface").uniform(
        "token",
        "info:id",
        Value::token("UsdPreviewSurface"),
    );
    surface = match colours.texture {
        Some(_) => surface.connected("color3f", "inputs:diffuseColor", output("base_color", "rgb")),
        None => {
            let colour = Value::Float3(colours.base);
            surface.attribute("color3f", "inputs:diffuseColor", colour)
        }
    };
    surface = surface.attribute("float", "inputs:metallic", Value::Float(0.0));
    if material.normal_texture.is_some() {
        surface = surface.connected("normal3f", "inputs:normal", output("normal", "rgb"));
    }
    if let Alpha::Mask { cutoff } = material.alpha {
        surface = surface.connected("float", "inputs:opacity", output(opacity, "a")).attribute(
            "float",
            "inputs:opacityThreshold",
            Value::Float(cutoff),
        );
    }
    surface = match material.orm_texture {
        Some(_) => surface.connected("float", "inputs:occlusion", output("orm", "r")).connected(
            "float",
            "inputs:roughness",
            output("orm", "g"),
        ),
        None => surface.attribute("float", "inputs:roughness", Value::Float(material.roughness)),
    };
    if material.specular < 1.0 {
        surface = surface.attribute("float", "inputs:ior", Value::Float(ior(material.specular)));
    }
    if material.relief.is_some() {
        surface = surface.connected("float", "inputs:displacement", output("height", "r"));
    }
    let mut surface = surface.declared("token", "outputs:surface");
    if material.relief.is_some() {
        surface = surface.declared("token", "outputs:displacement");
    }

    let mut prim = Prim::def("Material", material.name.as_str()).connected(
        "token",
        "outputs:surface",
        output("surface", "surface"),
    );
    if material.relief.is_some() {
        prim = prim.connected("token", "outputs:displacement", output("surface", "displacement"));
    }
    prim = prim.child(surface);
    let of_scene = |index: u32| {
        let wrap = match scene.wrap(index) {
            Wrap::Repeat => "repeat",
            Wrap::Clamp => "clamp",
        };
        (scene.textures()[index as usize].name.as_str(), wrap)
    };
    let relief = material.relief();
    let mut shaders = Vec::new();
    if let Some(index) = colours.texture {
        let scale = is_tinted.then_some([r, g, b, 1.0]);
        let outputs = if is_masked && !is_tinted { RGBA } else { RGB };
        let file = of_scene(index);
        let texture =
            Texture { name: "base_color", file, is_raw: false, bias: None, scale, outputs };
        if is_masked && is_tinted {
            let second = Texture { name: opacity, scale: None, outputs: RGBA, ..texture };
            shaders.extend([texture, second]);
        } else {
            shaders.push(texture);
        }
    }
    if let Some(index) = material.normal_texture {
        let (bias, scale) = (Some([-1.0, -1.0, -1.0, 0.0]), Some([2.0, 2.0, 2.0, 1.0]));
        let file = of_scene(index);
        shaders.push(Texture { name: "normal", file, is_raw: true, bias, scale, outputs: RGB });
    }
    if let Some(index) = material.orm_texture {
        let scale = (material.roughness != 1.0).then_some([1.0, material.roughness, 1.0, 1.0]);
        let file = of_scene(index);
        shaders.push(Texture { name: "orm", file, is_raw: true, bias: None, scale, outputs: ORM });
    }
    if let Some((name, relief)) = &relief {
        let [up_m, deep_m] = [0.5, 1.0].map(|share| share * relief.depth_m);
        let (bias, scale) = (Some([-up_m; 4]), Some([deep_m; 4]));
        let file = (name.as_str(), "repeat");
        shaders.push(Texture { name: "height", file, is_raw: true, bias, scale, outputs: HEIGHT });
    }
    if shaders.is_empty() {
        return prim;
    }
    for texture in &shaders {
        prim = prim.child(texture.shader(output("st", "result"), textures));
    }
    let reader = Prim::def("Shader", "st")
        .uniform("token", "info:id", Value::token("UsdPrimvarReader_float2"))
        .attribute("string", "inputs:varname", Value::string("st"))
        .declared("float2", "outputs:result");
    prim.child(reader)
}

/// Where a layer finds the textures of the scene.
pub(super) struct TexturePaths<'a> {
    /// From the layer's folder to that of the files.
    pub folder: &'a str,
    pub stem: &'a str,
}

impl TexturePaths<'_> {
    fn of(&self, name: &str) -> String {
        format!("{}{}", self.folder, texture_path(self.stem, name, PictureFormat::Png))
    }
}

/// A UsdUVTexture.
#[derive(Clone, Copy)]
struct Texture<'t> {
    name: &'static str,
    /// The picture's name, and what is beyond its border.
    file: (&'t str, &'static str),
    is_raw: bool,
    bias: Option<[f32; 4]>,
    scale: Option<[f32; 4]>,
    /// Type and name of what is read of it.
    outputs: &'static [(&'static str, &'static str)],
}

impl Texture<'_> {
    fn shader<'a>(self, st: String, textures: &TexturePaths) -> Prim<'a> {
        let (name, wrap) = self.file;
        let file = textures.of(name);
        let mut shader = Prim::def("Shader", self.name)
            .uniform("token", "info:id", Value::token("UsdUVTexture"))
            .attribute("asset", "inputs:file", Value::Asset(file));
        for (name, value) in [("inputs:bias", self.bias), ("inputs:scale", self.scale)] {
            if let Some(value) = value {
                shader = shader.attribute("float4", name, Value::Float4(value));
            }
        }
        let colorspace = if self.is_raw { "raw" } else { "sRGB" };
        shader = shader
            .attribute("token", "inputs:sourceColorSpace", Value::token(colorspace))
            .connected("float2", "inputs:st", st)
            .attribute("token", "inputs:wrapS", Value::token(wrap))
            .attribute("token", "inputs:wrapT", Value::token(wrap));
        self.outputs.iter().fold(shader, |shader, (kind, name)| shader.declared(kind, name))
    }
}

/// Refraction by which a surface mirrors so many times the 4 % of one of 1.5.
fn ior(specular: f32) -> f32 {
    let root = (0.04 * specular).sqrt();
    (1.0 + root) / (1.0 - root)
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_usual_mirroring_is_that_of_the_usual_refraction() {
        assert!((super::ior(1.0) - 1.5).abs() < 1e-6);
        assert_eq!(super::ior(0.0), 1.0);
    }
}
