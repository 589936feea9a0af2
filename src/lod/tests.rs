use glam::{Vec2, Vec3};

use super::*;
use crate::mesh::Surface;
use crate::raster::Picture;
use crate::render::capture::{Sitter, Window};
use crate::scene::{Alpha, Colorspace, Material, Part, Texture};

/// An upright box with its foot at the origin.
fn block(half: f32, height_m: f32) -> Surface {
    let mut out = Surface::default();
    let mut side = |at: Vec3, right: Vec3, up: Vec3| {
        let first = out.position.len() as u32;
        for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            out.position.push(at + right * s + up * t);
            out.normal.push(right.cross(up).normalize());
            out.uv.push(Vec2::new(s, t));
        }
        out.index.extend([0, 1, 2, 0, 2, 3].map(|k| first + k));
    };
    let (middle, up) = (Vec3::Z * height_m * 0.5, Vec3::Z * height_m * 0.5);
    for (out, right) in
        [(Vec3::X, Vec3::Y), (Vec3::Y, -Vec3::X), (-Vec3::X, -Vec3::Y), (-Vec3::Y, Vec3::X)]
    {
        side(middle + out * half, right * half, up);
    }
    side(Vec3::Z * height_m, Vec3::X * half, Vec3::Y * half);
    side(Vec3::ZERO, Vec3::X * half, -Vec3::Y * half);
    out
}

fn part(surface: Surface) -> Vec<Part> {
    vec![Part { name: "wood".into(), surface, material: 0 }]
}

fn red() -> Vec<Material> {
    vec![Material::plain("red", [0.5, 0.1, 0.1])]
}

const OCTAHEDRAL: Kind = Kind::Octahedral { views: impostor::USUAL_VIEWS };

#[test]
fn silhouettes_are_as_far_apart_as_the_blocks() {
    let (thin, wide, tall) =
        (part(block(1.0, 10.0)), part(block(1.5, 10.0)), part(block(1.0, 12.0)));
    let materials = red();
    let sitter = Sitter::new(&[&thin, &wide, &tall], &materials, &[]);
    let all = (Vec3::new(-1.5, -1.5, 0.0), Vec3::new(1.5, 1.5, 12.0));
    let of = |model| Silhouettes::of(&sitter, model, all, Views::All).unwrap();
    let finest = of(0);
    let same = finest.apart(&of(0));
    assert_eq!((same.worst_m, same.rms_m), (0.0, 0.0));
    // From above a corner of the wider block is 0.5 √2 away, the top of the taller one 2 m.
    let sample_m = finest.sample_m;
    for (model, wanted) in [(1, 0.5 * 2f32.sqrt()), (2, 2.0)] {
        let got = finest.apart(&of(model));
        assert!((got.worst_m - wanted).abs() <= 2.0 * sample_m, "{} {wanted}", got.worst_m);
        assert!(got.rms_m > 0.0 && got.rms_m < got.worst_m);
        assert_eq!(of(model).apart(&finest), got, "both ways the same");
    }
}

/// Upright strips in a row 4 m wide and 8 m high, each so wide.
fn strips(count: u32, width_m: f32) -> Surface {
    let mut out = Surface::default();
    for k in 0..count {
        let left = 4.0 * k as f32 / count as f32 - 2.0;
        let first = out.position.len() as u32;
        for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            out.position.push(Vec3::new(left + s * width_m, 0.0, 8.0 * t));
            out.normal.push(-Vec3::Y);
            out.uv.push(Vec2::new(s, t));
        }
        out.index.extend([0, 1, 2, 0, 2, 3].map(|k| first + k));
    }
    out
}

#[test]
fn pictured_twigs_are_as_far_from_a_pole_as_meshed_ones() {
    let mut look = red();
    look[0].double_sided = true;
    let (meshed, pole) = (part(strips(32, 4.0 / 512.0)), part(block(0.1, 8.0)));
    let all = (Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 8.0));
    let of =
        |sitter: &Sitter<'_>, model| Silhouettes::of(sitter, model, all, Views::Sides).unwrap();
    let sitter = Sitter::covers(&[&pole, &meshed], &look, &[]);
    let wanted = of(&sitter, 0).apart(&of(&sitter, 1));
    // The same strips as a sixteenth of one half of a picture, of fine texels and of coarse ones, whose other
    // half is mostly opaque: smaller versions of it would keep nothing else.
    for side in [32, 64, 256] {
        let mut picture = Picture::filled(side, side, [20, 160, 30, 0]);
        let opaque = |x: u32| x < side / 32 || x >= side / 2 && !x.is_multiple_of(8);
        for (x, y) in (0..side).flat_map(|y| (0..side).filter(|x| opaque(*x)).map(move |x| (x, y)))
        {
            picture.set(x, y, [90, 60, 30, 255]);
        }
        let image = picture.into();
        let textures = [Texture { name: "twigs".into(), image, colorspace: Colorspace::Srgb }];
        let mut masked = look.clone();
        masked[0].base_color_texture = Some(0);
        masked[0].alpha = Alpha::Mask { cutoff: 0.5 };
        let mut strips = strips(32, 4.0 / 32.0);
        strips.uv.iter_mut().for_each(|uv| uv.x *= 0.5);
        let pictured = part(strips);
        let sitter = Sitter::covers(&[&pictured], &masked, &textures);
        let got = of(&Sitter::covers(&[&pole], &look, &[]), 0).apart(&of(&sitter, 0));
        let near = |got: f32, wanted: f32| (got / wanted - 1.0).abs() < 0.05;
        assert!(near(got.rms_m, wanted.rms_m), "{side}: {got:?} {wanted:?}");
        assert!(near(got.worst_m, wanted.worst_m), "{side}: {got:?} {wanted:?}");
    }
}

#[test]
fn a_window_shows_the_block_where_it_is() {
    let (parts, materials) = (part(block(1.0, 10.0)), red());
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let window = Window { centre: Vec3::Z * 5.0, forward: Vec3::Y, sample_m: 0.25, size: [16, 48] };
    let whole =
        |window, rows| sitter.portrait(0, &window, rows, |first, texels| (first, texels.to_vec()));
    let bands = whole(window, 7).unwrap();
    assert_eq!(bands.iter().map(|b| b.0).collect::<Vec<_>>(), [0, 7, 14, 21, 28, 35, 42]);
    let texels = bands.into_iter().map(|b| b.1).collect::<Vec<_>>().concat();
    assert_eq!(texels, whole(window, 1_000).unwrap()[0].1, "however many rows at a time");
    let seen = texels.iter().filter(|t| t.is_seen()).count();
    assert_eq!(seen, 8 * 40, "2 m by 10 m");
    for t in texels.iter().filter(|t| t.is_seen()) {
        assert!((t.before_m - 1.0).abs() < 1e-4, "its face is 1 m before the middle");
        assert!((t.normal + Vec3::Y).length() < 1e-5);
        assert_eq!(t.albedo, [0.5, 0.1, 0.1]);
    }
    assert!(whole(Window { size: [0, 8], ..window }, 7).is_err());
    assert!(whole(Window { forward: Vec3::ZERO, ..window }, 7).is_err());
}

#[test]
fn an_impostor_covers_what_the_model_covers_in_its_colour() {
    let (parts, materials) = (part(block(1.0, 10.0)), red());
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let bounds = (Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 10.0));
    for kind in [Kind::Cross, OCTAHEDRAL] {
        let got = impostor::bake(&sitter, 0, bounds, kind, 256, &[]).unwrap();
        assert_eq!(got.octahedral.is_some(), kind == OCTAHEDRAL);
        let seen = got.colour.data.iter().filter(|p| p[3] >= 128).count();
        if kind == Kind::Cross {
            // Lit, it is as bright as the face that it shows; under what is transparent too, for
            // mip levels.
            // A sheet that is seen from the south, and one from the east.
            let sheets = [(-Vec3::Y, Vec3::X), (Vec3::X, Vec3::Y)];
            let linear = |c: u8| ((f32::from(c) / 255.0 + 0.055) / 1.055).powf(2.4);
            let mut mean = Vec3::ZERO;
            for (x, y) in (0..got.normal.height)
                .flat_map(|y| (0..got.normal.width).map(move |x| (2 * x, 2 * y)))
            {
                let part = |c: u8| f32::from(c) / 127.5 - 1.0;
                let [nx, ny, nz, _] = got.normal.at(x / 2, y / 2).map(part);
                let (front, right) = sheets[usize::from(2 * x >= got.colour.width)];
                let normal = (right * nx + Vec3::Z * ny + front * nz).normalize();
                let [r, g, ..] = got.colour.at(x, y).map(linear);
                let before = light::before(front);
                let lit = light::on_sheet(normal, &before) / light::on_sheet(front, &before);
                assert!((r * lit - 0.5).abs() < 0.06 && (g * lit - 0.1).abs() < 0.02, "{r} {lit}");
                mean += Vec3::new(r * lit, g * lit, 1.0);
            }
            assert!((mean / mean.z - Vec3::new(0.5, 0.1, 1.0)).length() < 0.01, "{mean}");
            assert_eq!(got.surface.triangles(), 8);
            // Sheets for either side, each before what it stands for, as their normals say.
            for t in got.surface.index.as_chunks::<3>().0 {
                let [a, b, c] = t.map(|i| got.surface.position[i as usize]);
                let normal = got.surface.normal[t[0] as usize];
                assert!((b - a).cross(c - a).normalize().dot(normal) > 0.999);
                assert!(a.dot(normal) > 0.0, "{a} {normal}");
            }
            let sides = [got.colour.width, got.colour.height];
            assert!(sides.iter().all(|s| s.is_power_of_two()) && sides[1] == 256, "{sides:?}");
            // The gutters take 8 texels.
            let texel_m = 10.0 / 248.0;
            let area = seen as f32 * texel_m * texel_m;
            assert!((area - 2.0 * 20.0).abs() < 1.0, "two views of 2 m by 10 m: {area}");
            // Round: each half leans to its own side, more so at its edge, and up. The stem of the first
            // sheet is in the middle of its view.
            let stem = (4.0 + 1.0 / texel_m) as u32 / 2;
            let half = (1.0 / texel_m) as u32 / 2;
            let [left, right] = [stem - half / 2, stem + half / 2].map(|x| got.normal.at(x, 64));
            let [edge, near] = [stem + half - 2, stem + 2].map(|x| got.normal.at(x, 64));
            assert!((i32::from(left[0]) + i32::from(right[0]) - 255).abs() < 8);
            assert!(
                right[0] > near[0] + 20 && edge[0] > right[0] + 6,
                "{near:?} {right:?} {edge:?}"
            );
            assert!(got.normal.data.iter().all(|p| p[1] > 150));
        }
        let window =
            Window { centre: Vec3::Z * 5.0, forward: Vec3::Y, sample_m: 0.1, size: [40, 120] };
        let share = shown(got.surface, got.colour, &window, &sitter);
        assert!((share - 1.0).abs() < 0.1, "{kind:?}: {share}");
    }
}

/// Leaves strewn about a crown, much smaller than a texel of its pictures.
fn strewn(count: u32) -> Surface {
    let mut leaves = Surface::default();
    let mut draws = crate::seed::Seed::new(1).draws();
    for _ in 0..count {
        let at =
            Vec3::new(draws.between(-2.0, 2.0), draws.between(-2.0, 2.0), draws.between(0.0, 8.0));
        let first = leaves.position.len() as u32;
        for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            leaves.position.push(at + Vec3::new(0.04 * s, 0.0, 0.04 * t));
            leaves.normal.push(-Vec3::Y);
            leaves.uv.push(Vec2::ZERO);
        }
        leaves.index.extend([0, 1, 2, 0, 2, 3].map(|k| first + k));
    }
    leaves
}

/// Views are blended before they are cut: what one covers wholly is to count wholly.
#[test]
fn alphas_of_octahedral_views_say_what_is_covered() {
    let (parts, materials) = (part(strewn(6_000)), red());
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let bounds = (Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 8.0));
    let got = impostor::bake(&sitter, 0, bounds, OCTAHEDRAL, 512, &[]).unwrap();
    let octahedral = got.octahedral.unwrap();
    let side = octahedral.frames as usize;
    let px = got.colour.width as usize / side;
    let texel_m = 2.0 * octahedral.radius_m / px as f32;
    // The view from the south: in the corner where e = (-1, 1).
    let (col, row) = (0, side - 1);
    let rows = got.colour.data.chunks(px * side).skip((side - 1 - row) * px).take(px);
    let alphas = rows.flat_map(|line| &line[col * px..(col + 1) * px]);
    let sum: f32 = alphas.map(|p| f32::from(p[3]) / 255.0).sum();
    let window =
        Window { centre: Vec3::Z * 4.0, forward: Vec3::Y, sample_m: 0.02, size: [240, 440] };
    let seen = sitter.silhouette(0, &window).unwrap().iter().filter(|c| **c).count();
    let share = sum * texel_m * texel_m / (seen as f32 * 0.02 * 0.02);
    assert!((0.88..1.12).contains(&share), "alphas come to {share} of what is covered");
}

/// What a surface with a picture, cut as impostors are, shows in a window over what a model does.
fn shown(surface: Surface, colour: Picture, window: &Window, model: &Sitter<'_>) -> f32 {
    let parts = part(surface);
    let image = colour.into();
    let textures = [Texture { name: "colour".into(), image, colorspace: Colorspace::Srgb }];
    let mut look = red();
    look[0].base_color_texture = Some(0);
    look[0].alpha = Alpha::Mask { cutoff: impostor::CUTOFF };
    look[0].double_sided = true;
    let shown = Sitter::covers(&[&parts], &look, &textures);
    let of = |s: &Sitter<'_>| s.silhouette(0, window).unwrap().iter().filter(|c| **c).count();
    of(&shown) as f32 / of(model) as f32
}

/// The same of one sheet of an impostor, squarely from the south.
fn sheet_shown(got: impostor::Impostor, model: &Sitter<'_>) -> f32 {
    let mut sheet = got.surface;
    sheet.index.truncate(6);
    let window =
        Window { centre: Vec3::Z * 4.0, forward: Vec3::Y, sample_m: 0.02, size: [240, 440] };
    shown(sheet, got.colour, &window, model)
}

#[test]
fn an_impostor_of_a_thin_crown_covers_as_much() {
    let (parts, materials) = (part(strewn(900)), red());
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let bounds = (Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 8.0));
    for (kind, size_px) in [(Kind::Cross, 128), (OCTAHEDRAL, 512)] {
        let got = impostor::bake(&sitter, 0, bounds, kind, size_px, &[]).unwrap();
        let share = sheet_shown(got, &sitter);
        assert!((share - 1.0).abs() < 0.15, "{kind:?}: {share}");
    }
}

/// Whatever a tree's height, its picture is no larger than asked for.
#[test]
fn a_cross_fills_no_larger_picture_than_asked_for() {
    let materials = red();
    for k in 0..40 {
        let height_m = 3.0 + 0.737 * k as f32;
        let parts = part(block(1.0, height_m));
        let sitter = Sitter::new(&[&parts], &materials, &[]);
        let bounds = (Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, height_m));
        let got = impostor::bake(&sitter, 0, bounds, Kind::Cross, 128, &[]).unwrap();
        assert_eq!(got.colour.height, 128, "{height_m} m");
    }
}

/// Files keep some alpha where a mask hides, so that smaller versions do not thin out.
#[test]
fn an_impostor_of_masked_twigs_covers_as_much() {
    let mut picture = Picture::filled(64, 64, [20, 160, 30, 110]);
    for (x, y) in (0..64).flat_map(|y| (0..8).map(move |x| (x, y))) {
        picture.set(x, y, [90, 60, 30, 255]);
    }
    let image = picture.into();
    let textures = [Texture { name: "twigs".into(), image, colorspace: Colorspace::Srgb }];
    let mut look = red();
    look[0].base_color_texture = Some(0);
    look[0].alpha = Alpha::Mask { cutoff: 0.5 };
    // Lines 3 cm wide, an eighth of all, in texels of some 7 cm.
    let mut cards = block(1.0, 8.0);
    cards.uv.iter_mut().for_each(|uv| *uv *= 4.0);
    let parts = part(cards);
    let baked_from = Sitter::new(&[&parts], &look, &textures);
    let bounds = (Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 8.0));
    let got = impostor::bake(&baked_from, 0, bounds, Kind::Cross, 128, &[]).unwrap();
    let share = sheet_shown(got, &Sitter::covers(&[&parts], &look, &textures));
    assert!((share - 1.0).abs() < 0.15, "{share}");
}

#[test]
fn an_octahedral_impostor_turns_to_the_eye() {
    let (parts, materials) = (part(block(1.0, 10.0)), red());
    let bounds = (Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 10.0));
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let baked = impostor::bake(&sitter, 0, bounds, OCTAHEDRAL, 2048, &[]).unwrap();
    let octahedral = baked.octahedral.unwrap();
    let turned = looks().map(|look| part(impostor::sheet_towards(&octahedral, -look)));
    let models: Vec<Vec<Part>> = std::iter::once(part(baked.surface)).chain(turned).collect();
    let models: Vec<&[Part]> = models.iter().map(|m| &m[..]).collect();
    let textures = [Texture {
        name: "colour".into(),
        image: baked.colour.into(),
        colorspace: Colorspace::Srgb,
    }];
    let mut look = red();
    look[0].base_color_texture = Some(0);
    look[0].alpha = Alpha::Mask { cutoff: impostor::CUTOFF };
    look[0].double_sided = true;
    let shown = Sitter::covers(&models, &look, &textures);
    // The view nearest to the zenith is 9.5° off it: 5 m lean 0.82 m aside.
    let aside_m = looks().map(|look| impostor::aside_m(&octahedral, -look)).fold(0.0, f32::max);
    assert!((aside_m - 0.165 * octahedral.radius_m).abs() < 0.01, "{aside_m}");
    let wider = Vec3::new(aside_m, aside_m, 0.0);
    let around = (bounds.0 - wider, bounds.1 + wider);
    let finest = Silhouettes::of(&sitter, 0, around, Views::All).unwrap();
    let turning = Silhouettes::turning(&shown, |k| 1 + k as u32, around, Views::All).unwrap();
    let worst_m = finest.apart(&turning).worst_m;
    assert!((worst_m - 0.82).abs() < 0.1, "{worst_m}");
    // The lone sheet is thin from the side.
    let lone = Silhouettes::of(&shown, 0, around, Views::Sides).unwrap();
    let alone = finest.apart(&lone);
    let turned_rms_m = finest.apart(&turning).rms_m;
    assert!(alone.rms_m > 2.0 * turned_rms_m, "{} {turned_rms_m}", alone.rms_m);
}

/// A round crown fills its views: they are about the ball that holds it, with a margin, not about its box.
#[test]
fn octahedral_views_are_about_a_ball() {
    let mut crown = Surface::default();
    let corners = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
    crown.position.extend(corners.map(|c| 5.0 * c + 6.0 * Vec3::Z));
    crown.normal.extend(corners);
    crown.uv.extend([Vec2::ZERO; 6]);
    for [a, b] in [[0, 1], [1, 3], [3, 4], [4, 0]] {
        crown.index.extend([a, b, 2, b, a, 5]);
    }
    let bounds = crown.bounds();
    let (parts, materials) = (part(crown), red());
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let got = impostor::bake(&sitter, 0, bounds, OCTAHEDRAL, 512, &[]).unwrap();
    let of = got.octahedral.unwrap();
    assert_eq!((of.centre, of.radius_m), (6.0 * Vec3::Z, 5.0 * (1.0 + impostor::MARGIN)));
}

/// More views are nearer to any eye, at the same picture's cost of texels.
#[test]
fn more_octahedral_views_are_nearer_to_the_eye() {
    let (parts, materials) = (part(block(1.0, 10.0)), red());
    let bounds = (Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 10.0));
    let sitter = Sitter::new(&[&parts], &materials, &[]);
    let of = |views: u32| {
        let kind = Kind::Octahedral { views };
        let got = impostor::bake(&sitter, 0, bounds, kind, 1024, &[]).unwrap();
        let octahedral = got.octahedral.unwrap();
        assert_eq!(octahedral.frames, views);
        assert_eq!(got.colour.width % views, 0);
        let off = looks().map(|look| impostor::aside_m(&octahedral, -look));
        (got.colour.width, off.fold(0.0, f32::max))
    };
    let [eight, nine, sixteen] = [8, 9, 16].map(of);
    assert_eq!((eight.0, sixteen.0), (1024, 1024));
    assert!(sixteen.1 < 0.6 * eight.1, "{sixteen:?} {eight:?}");
    assert!(nine.1 < 0.9 * eight.1, "{nine:?} {eight:?}");
    assert_eq!(impostor::direction(4, 4, 9), Vec3::Z);
}

#[test]
fn octahedral_views_cover_the_upper_half_of_the_sky() {
    // Any direction of the upper half has a view within 18.5°.
    let views: Vec<Vec3> = (0..impostor::USUAL_VIEWS)
        .flat_map(|row| {
            (0..impostor::USUAL_VIEWS)
                .map(move |col| impostor::direction(col, row, impostor::USUAL_VIEWS))
        })
        .collect();
    for k in 0..400 {
        let (turn, z) = (k as f32 * 2.399_963, (k as f32 + 0.5) / 400.0);
        let flat = (1.0 - z * z).sqrt();
        let d = Vec3::new(flat * turn.cos(), flat * turn.sin(), z);
        let near = views.iter().map(|v| v.dot(d)).fold(-1.0, f32::max);
        assert!(near > 18.5f32.to_radians().cos(), "{d}: {near}");
        // And it is the one that the formula of `Octahedral` leads to.
        let p = d.truncate() / (d.x.abs() + d.y.abs() + d.z);
        let e = Vec2::new(p.x + p.y, p.x - p.y);
        let cell = (e + 1.0) * 0.5 * (impostor::USUAL_VIEWS - 1) as f32;
        let found = impostor::direction(
            cell.x.round() as u32,
            cell.y.round() as u32,
            impostor::USUAL_VIEWS,
        );
        assert!(found.dot(d) > 19.5f32.to_radians().cos());
    }
}
