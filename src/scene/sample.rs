//! Small scenes for tests: cone trees with textures on bumpy ground.

use glam::{DVec3, Vec2, Vec3};

use super::*;
use crate::frame::Crs;
use crate::mesh::Surface;
use crate::raster::Picture;
use crate::seed::Seed;

/// Height of the ground.
pub fn ground(x: f32, y: f32) -> f32 {
    3.0 * (x * 0.08).sin() + 2.0 * (y * 0.11).cos()
}

/// `per_species` trees of each of `species`, two prototypes a species, on a square of `side_m`.
pub fn forest(species: &[&str], per_species: usize, side_m: f32) -> Scene {
    let mut scene = Scene {
        name: "forest".into(),
        frame: Frame {
            origin: DVec3::new(512_000.0, 6_780_000.0, 240.0),
            crs: Some(Crs { wkt: Some("PROJCS[\"zone 47\"]".into()), ..Crs::from_epsg(32647) }),
        },
        textures: Vec::new(),
        materials: Vec::new(),
        terrain: None,
        prototypes: Vec::new(),
        instances: Vec::new(),
    };
    let photo = texture(&mut scene, "photo", Colorspace::Srgb, |x, y| {
        let shade = 70 + ((x / 4 + y / 4) % 2) as u8 * 30;
        [shade, shade + 30, 40, 255]
    });
    let material = push(&mut scene.materials, plain("ground", photo));
    let surface = terrain(side_m, (side_m / 2.0) as usize);
    scene.terrain = Some(Part { name: "terrain".into(), surface, material });
    for (number, species) in species.iter().enumerate() {
        add_species(&mut scene, species, number, per_species, side_m);
    }
    scene
}

/// The least closed body: three edges of a metre at a corner in the origin.
pub fn tetrahedron() -> Surface {
    Surface {
        position: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
        index: vec![0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3],
        ..Surface::default()
    }
}

fn add_species(scene: &mut Scene, species: &str, number: usize, trees: usize, side_m: f32) {
    let name = identifier(species);
    let hue = 60 * number as u8;
    let bark = texture(scene, &format!("{name}_bark"), Colorspace::Srgb, |x, y| {
        let light = 90 + ((x * 7 + y * 3) % 50) as u8;
        [light, light - 20, light - 40, 255]
    });
    let bumps = texture(scene, &format!("{name}_bark_normal"), Colorspace::Raw, |x, _| {
        [(96 + (x % 2) * 64) as u8, 128, 245, 255]
    });
    let leaves = texture(scene, &format!("{name}_leaf"), Colorspace::Srgb, |x, y| {
        let inside = (x as i32 - 16).pow(2) + (y as i32 - 16).pow(2) < 200;
        [30 + hue, 140 - hue / 2, 40, if inside { 255 } else { 0 }]
    });
    let rough = texture(scene, &format!("{name}_bark_orm"), Colorspace::Raw, |x, y| {
        [255 - (x % 4) as u8 * 20, 200 + (y % 4) as u8 * 10, 0, 255]
    });
    let wood = Material {
        normal_texture: Some(bumps),
        orm_texture: Some(rough),
        roughness: 1.0,
        ..plain(&format!("{name}_bark"), bark)
    };
    let wood = push(&mut scene.materials, wood);
    let foliage = Material {
        alpha: Alpha::Mask { cutoff: 0.5 },
        double_sided: true,
        specular: 0.5,
        translucency: 0.25,
        base_color: [1.0, 0.9, 0.8],
        ..plain(&format!("{name}_leaf"), leaves)
    };
    let foliage = push(&mut scene.materials, foliage);
    let first = scene.prototypes.len() as u32;
    for model in 0..2u32 {
        let height_m = 12.0 + 4.0 * model as f32;
        scene.prototypes.push(Prototype {
            name: format!("{name}_{model:02}"),
            species: species.into(),
            parts: vec![
                Part { name: "wood".into(), surface: stem(0.2, height_m, 7), material: wood },
                Part {
                    name: "foliage".into(),
                    surface: cards(2.5, height_m, 24),
                    material: foliage,
                },
            ],
            scattered: Vec::new(),
            levels: Vec::new(),
            colliders: Vec::new(),
            silhouette: None,
            octahedral: None,
        });
    }
    for tree in 0..trees {
        let mut draws = Seed::new(number as u64).derive("sample", tree as u64).draws();
        let (x, y) = (draws.between(1.0, side_m - 1.0), draws.between(1.0, side_m - 1.0));
        let size = draws.between(0.6, 1.3);
        scene.instances.push(Instance {
            name: format!("{name}_{tree:04}"),
            prototype: first + (tree % 2) as u32,
            position: Vec3::new(x, y, ground(x, y)),
            yaw_rad: draws.between(0.0, std::f32::consts::TAU),
            scale: Vec3::new(size, size, size * 1.1),
            facts: TreeFacts {
                id: format!("{number}-{tree}"),
                species: species.into(),
                height_m: (12.0 + 4.0 * (tree % 2) as f32) * size * 1.1,
                crown_diameter_m: 5.0 * size,
                crown_base_height_m: 3.0,
                stem_diameter_m: 0.4 * size,
                condition: "I",
                confidence: draws.unit(),
            },
        });
    }
}

fn push<T>(items: &mut Vec<T>, item: T) -> u32 {
    items.push(item);
    items.len() as u32 - 1
}

fn texture(
    scene: &mut Scene,
    name: &str,
    colorspace: Colorspace,
    colour: impl Fn(u32, u32) -> [u8; 4],
) -> u32 {
    let mut picture = Picture::filled(32, 32, [0; 4]);
    for y in 0..32 {
        for x in 0..32 {
            picture.set(x, y, colour(x, y));
        }
    }
    push(&mut scene.textures, Texture { name: name.into(), image: picture.into(), colorspace })
}

fn plain(name: &str, texture: u32) -> Material {
    Material {
        base_color_texture: Some(texture),
        roughness: 0.9,
        ..Material::plain(name, [1.0; 3])
    }
}

fn terrain(side_m: f32, cells: usize) -> Surface {
    let mut surface = Surface::default();
    for row in 0..=cells {
        for col in 0..=cells {
            let uv = Vec2::new(col as f32, row as f32) / cells as f32;
            let (x, y) = (uv.x * side_m, uv.y * side_m);
            surface.position.push(Vec3::new(x, y, ground(x, y)));
            let slope = Vec2::new(0.24 * (x * 0.08).cos(), -0.22 * (y * 0.11).sin());
            surface.normal.push((-slope).extend(1.0).normalize());
            surface.uv.push(uv);
        }
    }
    let at = |col: usize, row: usize| (row * (cells + 1) + col) as u32;
    for row in 0..cells {
        for col in 0..cells {
            let (a, b) = (at(col, row), at(col + 1, row));
            let (c, d) = (at(col + 1, row + 1), at(col, row + 1));
            surface.index.extend([a, b, c, a, c, d]);
        }
    }
    surface
}

/// An open cone whose bark repeats upwards.
fn stem(radius_m: f32, height_m: f32, sides: u32) -> Surface {
    let mut surface = Surface::default();
    for k in 0..=sides {
        let around = k as f32 / sides as f32;
        let out = Vec2::from_angle(around * std::f32::consts::TAU);
        for (level, radius) in [(0.0, radius_m), (1.0, 0.02)] {
            surface.position.push((out * radius).extend(level * height_m));
            surface.normal.push(out.extend(0.01).normalize());
            surface.uv.push(Vec2::new(around, level * height_m));
        }
    }
    for k in 0..sides {
        let a = 2 * k;
        surface.index.extend([a, a + 2, a + 3, a, a + 3, a + 1]);
    }
    surface
}

/// Upright leaf cards in a spiral within a cone.
fn cards(radius_m: f32, height_m: f32, count: u32) -> Surface {
    let mut surface = Surface::default();
    for k in 0..count {
        let level = (k as f32 + 0.5) / count as f32;
        let out = Vec2::from_angle(k as f32 * 2.4);
        let side = out.perp().extend(0.0) * 0.6;
        let centre =
            (out * radius_m * (1.0 - level) * 0.8).extend(height_m * (0.25 + 0.75 * level));
        let first = surface.position.len() as u32;
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            let p = centre + side * (2.0 * u - 1.0) + Vec3::Z * 0.8 * (2.0 * v - 1.0);
            surface.position.push(p);
            surface.normal.push(out.extend(0.0));
            surface.uv.push(Vec2::new(u, v));
        }
        surface.index.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
    }
    surface
}
