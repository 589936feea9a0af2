//! OpenUSD text (.usda).
//!
//! `/SCENE` holds `materials`, `terrain`, and under `trees` one PointInstancer a species, whose
//! children are its prototypes. Z up, metres, as the scene. Materials are UsdPreviewSurface.
//!
//! Orientations are written twice: as `orientations` (half floats, which every reader knows and
//! which are off by up to 0.03°) and as `orientationsf` (exact, preferred by readers that know it).

mod text;

use glam::Vec3;

use self::text::{Text, quoted};
use super::pictures::texture_path;
use super::{GENERATOR, OutputFile, PictureFormat};
use crate::frame::Frame;
use crate::scene::{
    Alpha, Collider, Instance, Material, Part, SpeciesGroup, TreeFacts, ValidScene, Wrap, bounds_of,
};

/// `STEM.usda`; the textures are [`super::Pictures::into_files`].
pub fn usda<'a>(scene: &ValidScene, stem: &str) -> OutputFile<'a> {
    let mut text = Text::new();
    layer_metadata(&mut text, scene);
    text.blank();
    let schemas = "prepend apiSchemas = [\"GeomModelAPI\"]";
    text.open(&format!("def Xform \"{}\"", scene.name()), &["kind = \"assembly\"", schemas]);
    extent(&mut text, "extentsHint", scene.bounds());
    text.blank();
    text.open("def Scope \"materials\"", &[]);
    for (at, material) in scene.materials().iter().enumerate() {
        if at > 0 {
            text.blank();
        }
        write_material(&mut text, scene, material, stem);
    }
    text.close();
    if let Some(terrain) = scene.terrain() {
        text.blank();
        mesh(&mut text, scene, terrain, Some("kind = \"component\""));
    }
    if !scene.groups().is_empty() {
        text.blank();
        text.open("def Xform \"trees\"", &["kind = \"group\""]);
        for (at, group) in scene.groups().iter().enumerate() {
            if at > 0 {
                text.blank();
            }
            instancer(&mut text, scene, group);
        }
        text.close();
    }
    text.close();
    OutputFile::new(format!("{stem}.usda"), text.into_bytes())
}

fn layer_metadata(text: &mut Text, scene: &ValidScene) {
    let Frame { origin, crs } = scene.frame();
    let unit_m = scene.frame().unit_m();
    text.line("#usda 1.0");
    text.open_with("(");
    text.open_with("customLayerData = {");
    text.open_with("dictionary larix = {");
    if let Some(epsg) = crs.as_ref().and_then(|crs| crs.epsg) {
        text.line(&format!("int epsg = {epsg}"));
    }
    text.line(&format!("string generator = \"{GENERATOR}\""));
    text.line(
        "string note = \"east = origin[0] + x / unit_m[0], north = origin[1] + y / unit_m[1], \
         up = origin[2] + z / unit_m[2]\"",
    );
    text.line(&format!("double3 origin = ({}, {}, {})", origin.x, origin.y, origin.z));
    text.line(&format!("double3 unit_m = ({}, {}, {})", unit_m.x, unit_m.y, unit_m.z));
    if let Some(wkt) = crs.as_ref().and_then(|crs| crs.wkt.as_deref()) {
        text.line(&format!("string wkt = {}", quoted(wkt)));
    }
    text.close_with("}");
    text.close_with("}");
    text.line(&format!("defaultPrim = \"{}\"", scene.name()));
    text.line("metersPerUnit = 1");
    text.line("upAxis = \"Z\"");
    text.close_with(")");
}

/// A UsdPreviewSurface network. A tinted texture is read a second time, untinted, for its alpha:
/// Blender (4.5) takes the tint for the alpha otherwise.
fn write_material(text: &mut Text, scene: &ValidScene, material: &Material, stem: &str) {
    let path = material_path(scene, material);
    let [r, g, b] = material.base_color;
    let tinted = material.base_color != [1.0; 3];
    let opacity = if tinted { "opacity" } else { "base_color" };
    let masked = matches!(material.alpha, Alpha::Mask { .. });
    text.open(&format!("def Material \"{}\"", material.name), &[]);
    text.line(&format!("token outputs:surface.connect = <{path}/surface.outputs:surface>"));

    text.blank();
    text.open("def Shader \"surface\"", &[]);
    text.line("uniform token info:id = \"UsdPreviewSurface\"");
    text.line(&match material.base_color_texture {
        Some(_) => {
            format!("color3f inputs:diffuseColor.connect = <{path}/base_color.outputs:rgb>")
        }
        None => format!("color3f inputs:diffuseColor = ({r}, {g}, {b})"),
    });
    text.line("float inputs:metallic = 0");
    if material.normal_texture.is_some() {
        text.line(&format!("normal3f inputs:normal.connect = <{path}/normal.outputs:rgb>"));
    }
    if let Alpha::Mask { cutoff } = material.alpha {
        text.line(&format!("float inputs:opacity.connect = <{path}/{opacity}.outputs:a>"));
        text.line(&format!("float inputs:opacityThreshold = {cutoff}"));
    }
    if material.orm_texture.is_some() {
        text.line(&format!("float inputs:occlusion.connect = <{path}/orm.outputs:r>"));
        text.line(&format!("float inputs:roughness.connect = <{path}/orm.outputs:g>"));
    } else {
        text.line(&format!("float inputs:roughness = {}", material.roughness));
    }
    text.line("token outputs:surface");
    text.close();

    let mut textures = Vec::new();
    if let Some(index) = material.base_color_texture {
        let mut numbers = Vec::new();
        if tinted {
            numbers.push(format!("float4 inputs:scale = ({r}, {g}, {b}, 1)"));
        }
        let outputs = if masked && !tinted { &["float a", "float3 rgb"][..] } else { RGB };
        textures.push(TextureShader { name: "base_color", index, raw: false, numbers, outputs });
        if masked && tinted {
            let (numbers, outputs) = (Vec::new(), &["float a", "float3 rgb"][..]);
            textures.push(TextureShader { name: opacity, index, raw: false, numbers, outputs });
        }
    }
    if let Some(index) = material.normal_texture {
        let numbers = vec![
            "float4 inputs:bias = (-1, -1, -1, 0)".to_owned(),
            "float4 inputs:scale = (2, 2, 2, 1)".to_owned(),
        ];
        textures.push(TextureShader { name: "normal", index, raw: true, numbers, outputs: RGB });
    }
    if let Some(index) = material.orm_texture {
        let mut numbers = Vec::new();
        if material.roughness != 1.0 {
            numbers.push(format!("float4 inputs:scale = (1, {}, 1, 1)", material.roughness));
        }
        let outputs = &["float g", "float r"][..];
        textures.push(TextureShader { name: "orm", index, raw: true, numbers, outputs });
    }
    for texture in &textures {
        text.blank();
        write_texture(text, scene, stem, &path, texture);
    }
    if !textures.is_empty() {
        text.blank();
        text.open("def Shader \"st\"", &[]);
        text.line("uniform token info:id = \"UsdPrimvarReader_float2\"");
        text.line("string inputs:varname = \"st\"");
        text.line("float2 outputs:result");
        text.close();
    }
    text.close();
}

/// A UsdUVTexture.
struct TextureShader {
    name: &'static str,
    /// Into the scene's textures.
    index: u32,
    raw: bool,
    /// Bias and scale, a line each.
    numbers: Vec<String>,
    /// Type and name of what is read of it.
    outputs: &'static [&'static str],
}

const RGB: &[&str] = &["float3 rgb"];

fn write_texture(
    text: &mut Text,
    scene: &ValidScene,
    stem: &str,
    material_path: &str,
    shader: &TextureShader,
) {
    let file =
        texture_path(stem, &scene.textures()[shader.index as usize].name, PictureFormat::Png);
    let colorspace = if shader.raw { "raw" } else { "sRGB" };
    let wrap = match scene.wrap(shader.index) {
        Wrap::Repeat => "repeat",
        Wrap::Clamp => "clamp",
    };
    text.open(&format!("def Shader \"{}\"", shader.name), &[]);
    text.line("uniform token info:id = \"UsdUVTexture\"");
    text.line(&format!("asset inputs:file = @{file}@"));
    for line in &shader.numbers {
        text.line(line);
    }
    text.line(&format!("token inputs:sourceColorSpace = \"{colorspace}\""));
    text.line(&format!("float2 inputs:st.connect = <{material_path}/st.outputs:result>"));
    text.line(&format!("token inputs:wrapS = \"{wrap}\""));
    text.line(&format!("token inputs:wrapT = \"{wrap}\""));
    for output in shader.outputs {
        text.line(&output.replace(' ', " outputs:"));
    }
    text.close();
}

fn material_path(scene: &ValidScene, material: &Material) -> String {
    format!("/{}/materials/{}", scene.name(), material.name)
}

fn mesh(text: &mut Text, scene: &ValidScene, part: &Part, kind: Option<&str>) {
    let surface = &part.surface;
    let material = &scene.materials()[part.material as usize];
    let mut metadata: Vec<&str> = kind.into_iter().collect();
    metadata.push("prepend apiSchemas = [\"MaterialBindingAPI\"]");
    text.open(&format!("def Mesh \"{}\"", part.name), &metadata);
    if material.double_sided {
        text.line("uniform bool doubleSided = 1");
    }
    extent(text, "extent", surface.bounds());
    text.repeated("int[] faceVertexCounts", "3", surface.triangles());
    text.array("int[] faceVertexIndices", &surface.index, Text::int, None);
    text.line(&format!("rel material:binding = <{}>", material_path(scene, material)));
    text.array("normal3f[] normals", &surface.normal, Text::vec3, Some("vertex"));
    text.array("point3f[] points", &surface.position, Text::vec3, None);
    text.array("texCoord2f[] primvars:st", &surface.uv, Text::vec2, Some("vertex"));
    if !surface.lightmap_uv.is_empty() {
        text.array("texCoord2f[] primvars:st1", &surface.lightmap_uv, Text::vec2, Some("vertex"));
    }
    if !surface.wind.is_empty() {
        let write = |out: &mut Vec<u8>, c: &[u8; 4]| {
            Text::floats(out, &c.map(|v| f32::from(v) / 255.0));
        };
        text.array("float4[] primvars:wind", &surface.wind, write, Some("vertex"));
    }
    text.line("uniform token subdivisionScheme = \"none\"");
    text.close();
}

fn instancer(text: &mut Text, scene: &ValidScene, group: &SpeciesGroup) {
    let trees: Vec<&Instance> =
        group.instances.iter().map(|&i| &scene.instances()[i as usize]).collect();
    let path = format!("/{}/trees/{}", scene.name(), group.name);
    text.open(&format!("def PointInstancer \"{}\"", group.name), &["kind = \"group\""]);
    if let Some(bounds) = bounds_of(scene.prototypes(), trees.iter().copied()) {
        extent(text, "extent", bounds);
    }
    text.array("int64[] ids", &group.instances, Text::int, None);
    let turn = |out: &mut Vec<u8>, tree: &&Instance| {
        let (sin, cos) = (tree.yaw_rad * 0.5).sin_cos();
        Text::floats(out, &[cos, 0.0, 0.0, sin]);
    };
    text.array("quath[] orientations", &trees, turn, None);
    text.array("quatf[] orientationsf", &trees, turn, None);
    text.array("point3f[] positions", &trees, |out, t| Text::vec3(out, &t.position), None);

    let mut fact = |name: &str, fact: fn(&TreeFacts) -> f32| {
        let write = |out: &mut Vec<u8>, tree: &&Instance| Text::float(out, &fact(&tree.facts));
        text.array(&format!("float[] primvars:{name}"), &trees, write, Some("vertex"));
    };
    fact("confidence", |f| f.confidence);
    fact("crown_base_height_m", |f| f.crown_base_height_m);
    fact("crown_diameter_m", |f| f.crown_diameter_m);
    fact("height_m", |f| f.height_m);
    fact("stem_diameter_m", |f| f.stem_diameter_m);
    text.line(&format!("string primvars:species = {}", quoted(&group.species)));
    let id = |out: &mut Vec<u8>, tree: &&Instance| out.extend(quoted(&tree.facts.id).as_bytes());
    text.array("string[] primvars:tree_id", &trees, id, Some("vertex"));

    let mut number = vec![0u32; scene.prototypes().len()];
    for (at, &prototype) in (0u32..).zip(&group.prototypes) {
        number[prototype as usize] = at;
    }
    let index = |out: &mut Vec<u8>, t: &&Instance| Text::int(out, &number[t.prototype as usize]);
    text.array("int[] protoIndices", &trees, index, None);
    let prototypes = group.prototypes.iter().map(|&p| &scene.prototypes()[p as usize]);
    let target = |out: &mut Vec<u8>, name: &String| {
        out.extend(format!("<{path}/{name}>").as_bytes());
    };
    let names: Vec<String> = prototypes.clone().map(|p| p.name.clone()).collect();
    text.array("rel prototypes", &names, target, None);
    text.array("float3[] scales", &trees, |out, t| Text::vec3(out, &t.scale), None);
    for prototype in prototypes {
        text.blank();
        let octahedral = prototype.octahedral.map(|o| {
            let [x, y, z] = o.centre.to_array();
            format!(
                "customData = {{ dictionary octahedral = {{ float3 centre = ({x}, {y}, {z}); \
                 int frames = {}; float radius_m = {} }} }}",
                o.frames, o.radius_m
            )
        });
        let metadata: Vec<&str> =
            octahedral.as_deref().into_iter().chain(["kind = \"component\""]).collect();
        text.open(&format!("def Xform \"{}\"", prototype.name), &metadata);
        for (at, part) in prototype.parts.iter().enumerate() {
            if at > 0 {
                text.blank();
            }
            mesh(text, scene, part, None);
        }
        for (k, collider) in prototype.colliders.iter().enumerate() {
            text.blank();
            collider_mesh(text, collider, &collider.name(&prototype.name, k));
        }
        text.close();
    }
    text.close();
}

/// A body that physics sees and renderers do not.
fn collider_mesh(text: &mut Text, collider: &Collider, name: &str) {
    let body = &collider.body;
    let schemas = "prepend apiSchemas = [\"PhysicsCollisionAPI\", \"PhysicsMeshCollisionAPI\"]";
    text.open(&format!("def Mesh \"{name}\""), &[schemas]);
    extent(text, "extent", body.bounds());
    text.repeated("int[] faceVertexCounts", "3", body.triangles());
    text.array("int[] faceVertexIndices", &body.index, Text::int, None);
    text.line("uniform token physics:approximation = \"convexHull\"");
    text.array("point3f[] points", &body.position, Text::vec3, None);
    text.line("uniform token purpose = \"guide\"");
    text.line("uniform token subdivisionScheme = \"none\"");
    text.close();
}

fn extent(text: &mut Text, name: &str, (lo, hi): (Vec3, Vec3)) {
    text.array(&format!("float3[] {name}"), &[lo, hi], Text::vec3, None);
}
