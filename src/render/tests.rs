use super::*;
use crate::raster::Picture;
use crate::scene::Colorspace;
use crate::seed::Seed;

fn material(name: &str, base_color: [f32; 3], texture: Option<u32>, alpha: Alpha) -> Material {
    Material {
        base_color_texture: texture,
        alpha,
        double_sided: alpha != Alpha::Opaque,
        ..Material::plain(name, base_color)
    }
}

fn square(middle: Vec3, right: Vec3, up: Vec3) -> Surface {
    let normal = right.cross(up).normalize();
    Surface {
        position: vec![
            middle - right - up,
            middle + right - up,
            middle + right + up,
            middle - right + up,
        ],
        normal: vec![normal; 4],
        uv: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        index: vec![0, 1, 2, 0, 2, 3],
        ..Surface::default()
    }
}

fn part(surface: Surface, material: u32) -> Part {
    Part { name: "part".into(), surface, material }
}

/// Looks north from 10 m south of the origin; a metre at the origin is 4 pixels of 80.
fn north() -> (Camera, RenderOptions) {
    let camera = Camera {
        eye: Vec3::new(0.0, -10.0, 0.0),
        target: Vec3::ZERO,
        fov_y_rad: std::f32::consts::FRAC_PI_2,
    };
    let options = RenderOptions {
        width: 80,
        height: 80,
        supersample: 1,
        sun: Vec3::NEG_Y,
        shadow_size: 256,
        haze_per_m: 0.0,
        ..RenderOptions::default()
    };
    (camera, options)
}

fn is_red(p: [u8; 4]) -> bool {
    p[0] / 2 > p[1].max(p[2])
}

fn is_green(p: [u8; 4]) -> bool {
    p[1] / 2 > p[0].max(p[2])
}

/// A model shown without ground.
fn draw_models(models: Vec<&[Part]>, materials: &[Material], textures: &[Texture]) -> Picture {
    let placements = (0..models.len() as u32)
        .map(|model| Placement {
            model,
            position: Vec3::ZERO,
            turn: Mat3::IDENTITY,
            scale: Vec3::ONE,
        })
        .collect();
    let far = part(square(Vec3::new(0.0, 0.0, -500.0), Vec3::X, Vec3::Y), 0);
    let view = View { textures, materials, terrain: Some(&far), models, placements };
    let (camera, options) = north();
    picture(&view, &camera, &options)
}

const RED: [f32; 3] = [0.8, 0.02, 0.02];
const GREEN: [f32; 3] = [0.02, 0.8, 0.02];

#[test]
fn a_square_covers_exactly_its_pixels() {
    // 5 m each way at 10 m and 45°: half of the picture.
    let model = [part(square(Vec3::ZERO, Vec3::X * 5.0, Vec3::Z * 5.0), 0)];
    let p = draw_models(vec![&model], &[material("red", RED, None, Alpha::Opaque)], &[]);
    for y in 0..80 {
        for x in 0..80 {
            let inside = (20..60).contains(&x) && (20..60).contains(&y);
            assert_eq!(is_red(p.at(x, y)), inside, "at {x}, {y}: {:?}", p.at(x, y));
        }
    }
}

#[test]
fn the_nearer_surface_hides_the_farther_in_any_order() {
    let materials =
        [material("red", RED, None, Alpha::Opaque), material("green", GREEN, None, Alpha::Opaque)];
    let far = part(square(Vec3::ZERO, Vec3::X * 5.0, Vec3::Z * 5.0), 0);
    let near = part(square(Vec3::Y * -1.0, Vec3::X, Vec3::Z), 1);
    for model in [[far.clone(), near.clone()], [near, far]] {
        let p = draw_models(vec![&model], &materials, &[]);
        assert!(is_green(p.at(40, 40)));
        assert!(is_red(p.at(22, 40)));
    }
}

#[test]
fn far_needles_hide_their_share_and_sheets_behind_them_a_share_of_the_rest() {
    // Needles of four texels of ten: sixteen texels a sample from afar.
    let mut needles = Picture::filled(640, 640, [255, 255, 255, 0]);
    for (x, y) in (0..640).flat_map(|x| (0..640).map(move |y| (x, y))) {
        if x % 10 < 4 {
            needles.set(x, y, [255; 4]);
        }
    }
    let textures =
        [Texture { name: "needles".into(), image: needles.into(), colorspace: Colorspace::Srgb }];
    let materials = [
        material("needles", RED, Some(0), Alpha::Mask { cutoff: 0.5 }),
        material("behind", GREEN, Some(0), Alpha::Mask { cutoff: 0.5 }),
    ];
    let sheet =
        |y: f32, material: u32| part(square(Vec3::Y * y, Vec3::X * 5.0, Vec3::Z * 5.0), material);
    let (mut in_front, mut behind) = (0, 0);
    for k in 0..16 {
        let model = [sheet(0.0, 0), sheet(0.01 + 0.002 * k as f32, 1)];
        let p = draw_models(vec![&model], &materials, &textures);
        for (x, y) in (22..58).flat_map(|x| (22..58).map(move |y| (x, y))) {
            in_front += u32::from(is_red(p.at(x, y)));
            behind += u32::from(is_green(p.at(x, y)));
        }
    }
    let share = |count: u32| count as f32 / (16.0 * 36.0 * 36.0);
    assert!((share(in_front) - 0.4).abs() < 0.03, "{}", share(in_front));
    assert!((share(behind) - 0.4 * 0.6).abs() < 0.05, "{}", share(behind));
}

#[test]
fn masked_texels_are_holes_and_backs_of_closed_surfaces_are_not_drawn() {
    let mut leaf = Picture::filled(64, 64, [255; 4]);
    for y in 0..64 {
        for x in 0..32 {
            leaf.set(x, y, [255, 255, 255, 0]);
        }
    }
    let textures =
        [Texture { name: "leaf".into(), image: leaf.into(), colorspace: Colorspace::Srgb }];
    let mask = Alpha::Mask { cutoff: 0.5 };
    let materials =
        [material("leaf", GREEN, Some(0), mask), material("red", RED, None, Alpha::Opaque)];
    let front = square(Vec3::ZERO, Vec3::X * 5.0, Vec3::Z * 5.0);
    let p = draw_models(vec![&[part(front, 0)]], &materials, &textures);
    assert!(!is_green(p.at(25, 40)) && is_green(p.at(55, 40)));
    // Seen from behind a leaf is there, a closed surface is not.
    let back = square(Vec3::ZERO, Vec3::X * -5.0, Vec3::Z * 5.0);
    let p = draw_models(vec![&[part(back.clone(), 0)]], &materials, &textures);
    assert!(is_green(p.at(25, 40)) && !is_green(p.at(55, 40)));
    let p = draw_models(vec![&[part(back, 1)]], &materials, &textures);
    assert!(!is_red(p.at(40, 40)));
}

#[test]
fn a_roof_casts_a_shadow_below_it_and_nowhere_else() {
    let materials = [material("grey", [0.5; 3], None, Alpha::Opaque)];
    let ground = part(square(Vec3::ZERO, Vec3::X * 20.0, Vec3::Y * 20.0), 0);
    let roof = [part(square(Vec3::Z * 6.0, Vec3::X * 4.0, Vec3::Y * 4.0), 0)];
    let placement =
        Placement { model: 0, position: Vec3::ZERO, turn: Mat3::IDENTITY, scale: Vec3::ONE };
    let mut view = View {
        textures: &[],
        materials: &materials,
        terrain: Some(&ground),
        models: vec![&roof],
        placements: vec![placement],
    };
    let camera = Camera { eye: Vec3::new(0.0, -14.0, 3.0), target: Vec3::ZERO, fov_y_rad: 1.2 };
    let options = RenderOptions { sun: Vec3::Z, width: 100, height: 60, ..Default::default() };
    let shaded = picture(&view, &camera, &options);
    view.placements.clear();
    let open = picture(&view, &camera, &options);
    let brightness =
        |p: &Picture, x, y| p.at(x, y).iter().take(3).map(|&c| u32::from(c)).sum::<u32>();
    assert!(brightness(&shaded, 50, 30) * 3 < brightness(&open, 50, 30) * 2);
    assert!(brightness(&shaded, 50, 55) + 30 > brightness(&open, 50, 55));
}

#[test]
fn nothing_is_a_sky() {
    let view =
        View { textures: &[], materials: &[], terrain: None, models: vec![], placements: vec![] };
    let camera = Camera::overview(&view, 1.5);
    let options = RenderOptions { width: 30, height: 20, ..Default::default() };
    let p = picture(&view, &camera, &options);
    assert_eq!(p.data.len(), 600);
    assert!(p.data.iter().all(|c| c[2] > 60 && c[3] == 255));
}

/// Cones of cards on stems over rolling ground.
pub(super) struct Wood {
    pub textures: Vec<Texture>,
    pub materials: Vec<Material>,
    pub terrain: Part,
    pub models: Vec<Vec<Part>>,
    pub placements: Vec<Placement>,
}

impl Wood {
    pub fn new(trees: usize, cards: usize, side_m: f32) -> Wood {
        let mut draws = Seed::new(11).draws();
        let mut leaf = Picture::filled(64, 64, [40, 70, 25, 0]);
        for _ in 0..60 {
            let (x0, y0) = (draws.index(50) as u32, draws.index(50) as u32);
            let shade = draws.index(50) as u8;
            for i in 0..14 {
                for j in 0..3 {
                    leaf.set(x0 + i, y0 + i / 2 + j, [70 + shade, 105 + shade, 40, 255]);
                }
            }
        }
        let textures =
            vec![Texture { name: "leaf".into(), image: leaf.into(), colorspace: Colorspace::Srgb }];
        let materials = vec![
            material("ground", [0.12, 0.14, 0.06], None, Alpha::Opaque),
            material("bark", [0.16, 0.11, 0.08], None, Alpha::Opaque),
            material("leaf", [1.0; 3], Some(0), Alpha::Mask { cutoff: 0.5 }),
        ];
        let height = |x: f32, y: f32| 4.0 * (x * 0.05).sin() + 5.0 * (y * 0.04).cos() + 0.05 * x;
        let n = 100;
        let mut ground = Surface::default();
        for j in 0..=n {
            for i in 0..=n {
                let (x, y) = (i as f32 / n as f32 * side_m, j as f32 / n as f32 * side_m);
                let z = height(x, y);
                let (dx, dy) = (height(x + 0.1, y) - z, height(x, y + 0.1) - z);
                ground.position.push(Vec3::new(x, y, z));
                ground.normal.push(Vec3::new(-dx, -dy, 0.1).normalize());
                ground.uv.push(Vec2::new(x, y) / side_m);
                if i < n && j < n {
                    let a = (j * (n + 1) + i) as u32;
                    let b = a + n as u32 + 1;
                    ground.index.extend([a, a + 1, b + 1, a, b + 1, b]);
                }
            }
        }
        let models = (0..3)
            .map(|kind| {
                let mut wood = Surface::default();
                let sides = 8;
                for k in 0..=sides {
                    let (s, c) = (k as f32 / sides as f32 * std::f32::consts::TAU).sin_cos();
                    for (z, r) in [(0.0, 0.2), (18.0, 0.02)] {
                        wood.position.push(Vec3::new(c * r, s * r, z));
                        wood.normal.push(Vec3::new(c, s, 0.0));
                        wood.uv.push(Vec2::new(k as f32, z));
                    }
                    if k < sides {
                        wood.index.extend([0, 2, 3, 0, 3, 1].map(|i| i + 2 * k as u32));
                    }
                }
                let mut foliage = Surface::default();
                for _ in 0..cards {
                    let z = 1.0 - draws.unit().sqrt();
                    let phi = draws.between(0.0, std::f32::consts::TAU);
                    let r = draws.unit().sqrt();
                    let (radius, base) = if kind == 1 {
                        (3.2 * (1.0 - (2.0 * z - 1.0).powi(2)).max(0.0).sqrt(), 6.0)
                    } else {
                        (2.6 * (1.0 - z), 2.0)
                    };
                    let p =
                        Vec3::new(phi.cos() * r * radius, phi.sin() * r * radius, base + z * 16.0);
                    let right = draws.direction();
                    let up = right.cross(draws.direction()).normalize_or(Vec3::Z);
                    let card = square(p, right * 0.3, up * 0.3);
                    let first = foliage.position.len() as u32;
                    foliage.index.extend(card.index.iter().map(|i| i + first));
                    foliage.position.extend(card.position);
                    foliage.normal.extend(card.normal);
                    foliage.uv.extend(card.uv);
                }
                vec![part(wood, 1), part(foliage, 2)]
            })
            .collect();
        let placements = (0..trees)
            .map(|i| {
                let (x, y) = (draws.between(2.0, side_m - 2.0), draws.between(2.0, side_m - 2.0));
                Placement {
                    model: i as u32 % 3,
                    position: Vec3::new(x, y, height(x, y)),
                    turn: Mat3::from_rotation_z(draws.between(0.0, std::f32::consts::TAU)),
                    scale: Vec3::splat(draws.between(0.6, 1.2)),
                }
            })
            .collect();
        Wood { textures, materials, terrain: part(ground, 0), models, placements }
    }

    pub fn view(&self) -> View<'_> {
        View {
            textures: &self.textures,
            materials: &self.materials,
            terrain: Some(&self.terrain),
            models: self.models.iter().map(Vec::as_slice).collect(),
            placements: self.placements.clone(),
        }
    }
}

#[test]
fn one_thread_and_two_give_the_same_bytes() {
    let wood = Wood::new(30, 300, 40.0);
    let view = wood.view();
    let camera = Camera::overview(&view, 1.6);
    let options = RenderOptions { width: 160, height: 100, shadow_size: 512, ..Default::default() };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| picture(&view, &camera, &options))
    };
    let one = on(1);
    assert!(one == on(2), "pictures differ");
    // It shows something: not all sky, not all dark.
    assert!(one.data.iter().filter(|p| p[1] > p[2]).count() > 4000);
}

#[test]
fn a_far_wood_keeps_its_brightness_when_thinned() {
    let wood = Wood::new(60, 1500, 40.0);
    let view = wood.view();
    let camera = Camera::overview(&view, 1.6);
    let mean = |triangle_budget| {
        let options = RenderOptions {
            width: 320,
            height: 200,
            shadow_size: 1024,
            triangle_budget,
            ..Default::default()
        };
        let p = picture(&view, &camera, &options);
        p.data.iter().map(|c| f64::from(c[1])).sum::<f64>() / p.data.len() as f64
    };
    let (full, thin) = (mean(10_000_000), mean(30_000));
    assert!((full - thin).abs() < 0.06 * full, "{full} and {thin}");
}

#[test]
fn extreme_scenes_do_not_panic() {
    let mut wood = Wood::new(6, 40, 20.0);
    wood.placements[0].scale = Vec3::splat(1e6);
    wood.placements[1].scale = Vec3::splat(1e-9);
    wood.placements[2].position = Vec3::new(1e9, -1e9, 1e9);
    wood.placements[3].model = 77;
    wood.placements[4].scale = Vec3::new(-1.0, 1.0, f32::NAN);
    wood.placements[5].scale = Vec3::new(-1.0, 1.0, 0.5);
    wood.materials[0].base_color_texture = Some(9);
    wood.models[0][0].material = 1000;
    wood.models[1][1].surface.index.extend([5, 1_000_000, 7, 1]);
    let view = wood.view();
    let options = RenderOptions { width: 40, height: 30, shadow_size: 0, ..Default::default() };
    let eyes = [Vec3::new(10.0, 10.0, 5.0), Vec3::new(10.0, 10.0, 1e7), Vec3::splat(-1e-3)];
    for eye in eyes {
        for target in [Vec3::ZERO, eye, Vec3::new(0.0, 0.0, -1e8), eye - Vec3::X] {
            let camera = Camera { eye, target, fov_y_rad: 1.0 };
            assert_eq!(picture(&view, &camera, &options).data.len(), 1200);
        }
    }
    let camera = Camera::portrait(&view, 1.0);
    let tiny = RenderOptions { width: 0, height: 1, supersample: 99, ..options };
    assert_eq!(picture(&view, &camera, &tiny).data.len(), 1);
}
