//! Every fault that `validate` knows, with its words.

use glam::Vec2;

use super::*;
use crate::scene::sample::forest;

fn sample() -> Scene {
    forest(&["Larix sibirica", "Betula pendula"], 3, 20.0)
}

/// The faults of the sample after a change, without what they all have in common.
fn faults(change: impl FnOnce(&mut Scene)) -> Vec<String> {
    let mut scene = sample();
    change(&mut scene);
    let Err(error) = scene.validate() else { return Vec::new() };
    let count = error.count();
    let shown = format!("{error:?}");
    let told: Vec<String> = shown
        .split("; scene ")
        .map(|text| {
            let text = text.split_once("is not sound: ").unwrap().1;
            text.split_once(" (remedy: this is a defect of the stage").unwrap().0.to_owned()
        })
        .collect();
    assert_eq!(told.len(), count, "{shown}");
    told
}

#[test]
fn a_sound_scene_passes_and_is_grouped_by_species() {
    let scene = sample().validate().unwrap();
    let [larch, birch] = scene.groups() else { panic!("{:?}", scene.groups()) };
    assert_eq!((larch.name.as_str(), larch.species.as_str()), ("Larix_sibirica", "Larix sibirica"));
    assert_eq!((&larch.prototypes[..], &larch.instances[..]), (&[0, 1][..], &[0, 1, 2][..]));
    assert_eq!((&birch.prototypes[..], &birch.instances[..]), (&[2, 3][..], &[3, 4, 5][..]));
    let wrap = |name| {
        let at = scene.textures().iter().position(|t| t.name == name).unwrap();
        scene.wrap(at as u32)
    };
    assert_eq!(wrap("photo"), Wrap::Clamp);
    assert_eq!(wrap("Larix_sibirica_leaf"), Wrap::Clamp);
    assert_eq!(wrap("Larix_sibirica_bark"), Wrap::Repeat);
    assert_eq!(wrap("Larix_sibirica_bark_normal"), Wrap::Repeat);
}

#[test]
fn parts_at_many_places_are_sound() {
    use glam::Quat;
    let with = |places: Vec<Place>, change: &dyn Fn(&mut Prototype)| {
        faults(|scene| {
            let one = &mut scene.prototypes[0];
            let part = Part { name: "twig_01".into(), ..one.parts[1].clone() };
            one.scattered.push(Scattered { part, places });
            change(one);
        })
    };
    let place = Place { position: Vec3::Z, turn: Quat::IDENTITY, scale: 1.0 };
    let name = "Larix_sibirica_00";
    assert!(with(vec![place], &|_| {}).is_empty());
    let told = with(Vec::new(), &|_| {});
    assert_eq!(told, [format!("prototype `{name}`, part `twig_01`: it stands nowhere")]);
    for wrong in [
        Place { scale: 0.0, ..place },
        Place { position: Vec3::NAN, ..place },
        Place { turn: Quat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..place },
    ] {
        let told = with(vec![place, wrong], &|_| {});
        assert!(told[0].starts_with(&format!("prototype `{name}`, part `twig_01`, place 1: ")));
    }
    let told = with(vec![place], &|one| {
        let count = one.scattered[0].part.surface.position.len();
        one.scattered[0].part.surface.wind = vec![[0; 4]; count];
    });
    let says = format!(
        "prototype `{name}`, part `twig_01`: wind and light maps differ from place to place"
    );
    assert_eq!(told, [says]);
    let told = with(vec![place], &|one| one.scattered[0].part.name = "foliage".into());
    assert_eq!(told.len(), 1);
    assert!(told[0].contains("`foliage` is taken"), "{told:?}");
}

#[test]
fn a_scene_is_as_large_as_what_is_scattered_reaches() {
    let mut scene = sample();
    let one = &mut scene.prototypes[0];
    let part = Part { name: "twig_01".into(), ..one.parts[1].clone() };
    let high = part.surface.bounds().1.z;
    let turn = glam::Quat::from_rotation_x(0.0);
    one.scattered.push(Scattered {
        part,
        places: vec![Place { position: Vec3::Z * 100.0, turn, scale: 2.0 }],
    });
    scene.terrain = None;
    scene.instances.truncate(1);
    scene.prune();
    let before = scene.prototypes[0].triangles();
    let scene = scene.validate().unwrap();
    let tree = &scene.instances()[0];
    let top = tree.position.z + tree.scale.z * (100.0 + 2.0 * high);
    assert!((scene.bounds().1.z - top).abs() < 1e-2, "{} {top}", scene.bounds().1.z);
    assert_eq!(before[0], before[1]);
    let of = crate::scene::statistics(&scene);
    assert_eq!([of.unique_triangles, of.instanced_triangles], before);
}

#[test]
fn terrain_alone_and_a_tree_alone_are_scenes_and_nothing_is_none() {
    let mut bare = sample();
    bare.instances.clear();
    bare.prune();
    assert!(bare.validate().unwrap().groups().is_empty());

    let mut floating = sample();
    floating.terrain = None;
    floating.instances.truncate(1);
    floating.prune();
    let scene = floating.validate().unwrap();
    assert!(scene.terrain().is_none() && scene.instances().len() == 1);

    let nothing = faults(|s| {
        s.instances.clear();
        s.terrain = None;
        s.prune();
    });
    assert_eq!(nothing, ["has neither terrain nor trees"]);
}

#[test]
fn each_fault_is_told_in_its_own_words() {
    type Change = Box<dyn Fn(&mut Scene)>;
    let larch = |change: fn(&mut Surface)| -> Change {
        Box::new(move |s: &mut Scene| change(&mut s.prototypes[0].parts[0].surface))
    };
    let tree = |change: fn(&mut Instance)| -> Change {
        Box::new(move |s: &mut Scene| change(&mut s.instances[0]))
    };
    let bark = |change: fn(&mut Material)| -> Change {
        Box::new(move |s: &mut Scene| change(&mut s.materials[1]))
    };
    let wood = "prototype `Larix_sibirica_00`, part `wood`: ";
    let first = "instance `Larix_sibirica_0000`: ";
    let stem = "material `Larix_sibirica_bark`: ";
    let cases: Vec<(Change, String)> = vec![
        (
            Box::new(|s| s.name = "3 trees".into()),
            "the scene: the name `3 trees` is not made of letters, digits and `_` alone".into(),
        ),
        (
            Box::new(|s| s.textures[1].name = "PHOTO".into()),
            "texture 1: the name `photo` is taken".into(),
        ),
        (
            Box::new(|s| s.materials[2].name = "ground".into()),
            "material 2: the name `ground` is taken".into(),
        ),
        (
            Box::new(|s| s.prototypes[1].name = "a-b".into()),
            "prototype 1: the name `a-b` is not made of letters, digits and `_` alone".into(),
        ),
        (
            Box::new(|s| s.prototypes[0].parts[1].name = "wood".into()),
            "part of prototype `Larix_sibirica_00` 1: the name `wood` is taken".into(),
        ),
        (
            Box::new(|s| s.instances[1].name = "Larix_sibirica_0000".into()),
            "instance 1: the name `Larix_sibirica_0000` is taken".into(),
        ),
        (
            Box::new(|s| s.instances[1].facts.id = "0-0".into()),
            "instance 1 `Larix_sibirica_0001`: its id `0-0` is taken".into(),
        ),
        (
            Box::new(|s| s.terrain.as_mut().unwrap().name = "trees".into()),
            "the terrain is named `trees`, not `terrain`".into(),
        ),
        (
            Box::new(|s| s.frame.origin.x = f64::INFINITY),
            "the origin [inf, 6780000, 240] is not finite".into(),
        ),
        (
            Box::new(|s| s.frame.crs.as_mut().unwrap().vertical_unit_m = 0.0),
            "the units of the coordinate system, [1, 1, 0] m, are not lengths".into(),
        ),
        (
            Box::new(|s| {
                let mut picture = s.textures[0].image.picture().clone();
                picture.width = 33;
                s.textures[0].image = picture.into();
            }),
            "texture `photo`: 33 × 32 pixels announced, 1024 held".into(),
        ),
        (
            bark(|m| m.base_color[1] = 1.5),
            format!("{stem}base colour [1.0, 1.5, 1.0] is not within 0…1"),
        ),
        (bark(|m| m.roughness = f32::NAN), format!("{stem}roughness NaN is not within 0…1")),
        (
            bark(|m| m.alpha = Alpha::Mask { cutoff: 2.0 }),
            format!("{stem}alpha cutoff 2 is not within 0…1"),
        ),
        (
            bark(|m| m.normal_texture = Some(77)),
            format!("{stem}normal texture 77 of 9 does not exist"),
        ),
        (
            bark(|m| m.normal_texture = Some(0)),
            format!("{stem}normal texture `photo` is Srgb, not Raw"),
        ),
        (
            bark(|m| m.orm_texture = Some(0)),
            format!("{stem}occlusion and roughness texture `photo` is Srgb, not Raw"),
        ),
        (
            larch(|s| s.uv.truncate(15)),
            format!("{wood}16 positions, 16 normals and 15 texture coordinates"),
        ),
        (larch(|s| s.index.clear()), format!("{wood}no triangles")),
        (larch(|s| s.index.truncate(41)), format!("{wood}41 indices are not whole triangles")),
        (
            larch(|s| s.position[3] = Vec3::splat(f32::NAN)),
            format!("{wood}vertex 3: position [NaN, NaN, NaN] is not finite"),
        ),
        (
            larch(|s| s.normal[5] = Vec3::ZERO),
            format!("{wood}vertex 5: normal [0, 0, 0] has length 0, not 1"),
        ),
        (
            larch(|s| s.uv[2] = Vec2::splat(f32::INFINITY)),
            format!("{wood}vertex 2: texture coordinate [inf, inf] is not finite"),
        ),
        (larch(|s| s.index[4] = 16), format!("{wood}triangle 1: vertex 16 of 16 does not exist")),
        (larch(|s| s.index[4] = s.index[3]), format!("{wood}triangle 1 [0, 0, 1] has no area")),
        (
            larch(|s| s.position[3] = 2.0 * s.position[2] - s.position[0]),
            format!("{wood}triangle 0 [0, 2, 3] has no area"),
        ),
        (
            Box::new(|s| s.prototypes[0].parts[0].material = 70),
            format!("{wood}material 70 of 5 does not exist"),
        ),
        (
            Box::new(|s| s.prototypes[0].parts.clear()),
            "prototype `Larix_sibirica_00` has no parts".into(),
        ),
        (
            Box::new(|s| {
                s.prototypes[2].species = "Larix_sibirica".into();
                s.instances[3].facts.species = "Larix_sibirica".into();
                s.instances[5].facts.species = "Larix_sibirica".into();
            }),
            "species 1: the name `Larix_sibirica` is taken".into(),
        ),
        (tree(|i| i.prototype = 50), format!("{first}prototype 50 of 4 does not exist")),
        (
            tree(|i| i.facts.species = "Abies".into()),
            format!("{first}is a Abies but shows prototype `Larix_sibirica_00`, a Larix sibirica"),
        ),
        (tree(|i| i.yaw_rad = f32::NAN), format!("{first}its yaw NaN is not finite")),
        (tree(|i| i.scale.x = 0.0), format!("{first}its scale [0, ")),
        (tree(|i| i.facts.height_m = f32::NAN), format!("{first}its height NaN is not a length")),
        (
            tree(|i| i.facts.confidence = 1.1),
            format!("{first}its confidence 1.1 is not within 0…1"),
        ),
        (tree(|i| i.position.z -= 0.6), format!("{first}its root is 0.6")),
        (
            tree(|i| i.position.x = -50.0),
            format!("{first}its root is off the terrain by more than 2 m"),
        ),
        (
            Box::new(|s| s.instances.retain(|i| i.prototype != 3)),
            "prototype `Betula_pendula_01` is not used: prune the scene".into(),
        ),
    ];
    for (change, expected) in cases {
        let told = faults(change);
        assert!(
            told.iter().any(|text| text.starts_with(&expected)),
            "expected: {expected}\ntold: {told:#?}"
        );
    }
}

#[test]
fn many_faults_are_counted() {
    let told = faults(|s| {
        for part in &mut s.prototypes {
            for name in 0..10 {
                let copy = Part { name: format!("a b {name}"), ..part.parts[0].clone() };
                part.parts.push(copy);
            }
        }
    });
    assert_eq!(told.len(), 21);
    assert_eq!(told.last().unwrap(), "and 20 more faults");
}
