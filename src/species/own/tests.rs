use proptest::prelude::*;

use super::*;
use crate::species::{Species, files, load, load_text};

const TWIG: &str = "mtllib twig.mtl\no twig\nv -1 0 0\nv 1 0 0\nv 1 4 0\nv -1 4 0\n\
                    vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nusemtl leaf\n\
                    f 1/1/1 2/2/1 3/3/1 4/4/1\n";
const MATERIAL: &str = "newmtl leaf\nKd 0.8 0.8 0.8\nmap_Kd leaf.png\n";
const RULE: &str = "extends = 'table3/13'\n[foliage]\nmodel = 'twig.obj'\n";

/// A folder with a rule file, a twig, its material and its picture; each text as given.
fn folder(rule: &str, obj: &str, mtl: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("own.toml", rule.as_bytes());
    write("twig.obj", obj.as_bytes());
    write("twig.mtl", mtl.as_bytes());
    let mut picture = Picture::filled(6, 4, [30, 90, 20, 255]);
    picture.set(0, 0, [0; 4]);
    write("leaf.png", &picture.to_png().unwrap());
    write("opaque.png", &Picture::filled(4, 4, [30, 90, 20, 255]).to_png().unwrap());
    write("grey.png", &Picture::filled(4, 4, [90, 90, 90, 255]).to_png().unwrap());
    write("broken.png", &picture.to_png().unwrap()[..40]);
    write("empty.png", &Picture::filled(4, 4, [30, 90, 20, 0]).to_png().unwrap());
    folder
}

fn rule(folder: &tempfile::TempDir) -> String {
    folder.path().join("own.toml").to_string_lossy().into_owned()
}

#[test]
fn a_twig_is_read_with_its_picture_to_a_height_of_one() {
    let folder = folder(RULE, TWIG, MATERIAL);
    let species = load(&rule(&folder)).unwrap();
    assert_eq!(species.foliage.colour, [30, 90, 20], "that of its leaves");
    let model = species.own_model.unwrap();
    assert_eq!((model.position.len(), model.index.len()), (4, 6));
    let high = model.position.iter().map(|p| p[1]).fold(0.0, f32::max);
    assert_eq!(high, 1.0);
    assert_eq!(model.position[0], [-0.25, 0.0, 0.0]);
    assert!(model.normal.iter().all(|n| *n == [0.0, 0.0, 1.0]));
    assert_eq!(model.uv[2], [1.0, 1.0]);
    assert_eq!((model.picture.width, model.picture.height), (6, 4));
    assert!((0.22..0.2501).contains(&model.shown()), "half of it: {}", model.shown());
    assert!(species.own_picture.is_none());
    let watched = files(Path::new(&rule(&folder)));
    assert!(watched.iter().any(|f| f.ends_with("twig.obj")), "{watched:?}");
}

/// As some exporters write them: a mark before the first line, lines that go on, names of another system or machine.
#[test]
fn what_other_exporters_write_is_read() {
    let model = |obj: &str, mtl: &str| {
        let folder = folder(RULE, obj, mtl);
        std::fs::create_dir(folder.path().join("sub")).unwrap();
        let inner = folder.path().join("sub").join("inner.png");
        std::fs::copy(folder.path().join("leaf.png"), inner).unwrap();
        let model = load(&rule(&folder)).unwrap().own_model.unwrap();
        Model { name: PathBuf::new(), ..(*model).clone() }
    };
    let plain = model(TWIG, MATERIAL);
    let marked = TWIG.strip_prefix("mtllib twig.mtl\no twig\n").unwrap();
    let marked = format!("\u{feff}{marked}").replace("usemtl", "mtllib twig.mtl\nusemtl");
    assert_eq!(model(&marked, &format!("\u{feff}{MATERIAL}")), plain);
    let long = TWIG.replace("2/2/1 ", "2/2/1 \\\n").replace("o twig", "# a name\\\no twig");
    assert_eq!(model(&long, MATERIAL), plain);
    for name in ["sub\\\\inner.png", "C:\\\\tex\\\\leaf.png", "/tex/leaf.png"] {
        let name = name.replace("\\\\", "\\");
        assert_eq!(model(TWIG, &MATERIAL.replace("leaf.png", &name)), plain, "{name}");
    }
}

#[test]
fn colours_that_no_face_shows_are_not_those_of_leaves() {
    let mtl = "newmtl leaf\nKd 0.1 0.3 0.05\nnewmtl other\nKd 0.9 1 0.1\n";
    let species = load(&rule(&folder(RULE, TWIG, mtl))).unwrap();
    assert_eq!(species.foliage.colour, srgb([0.1, 0.3, 0.05]));
}

fn remarked(species: &Species) -> Vec<String> {
    species.remarks.iter().map(|remark| remark.text.clone()).collect()
}

#[test]
fn what_a_material_says_in_vain_is_told() {
    let remarks = |more: &str| {
        let folder = folder(RULE, TWIG, &format!("{MATERIAL}{more}"));
        remarked(&load(&rule(&folder)).unwrap())
    };
    let as_exported = "Ns 250\nKs 0.5 0.5 0.5\nKe 0 0 0\nNi 1.45\nd 1\nillum 2\nmap_d leaf.png\n";
    assert_eq!(remarks(as_exported), [""; 0]);
    let told = remarks("map_Bump -bm 1 grey.png\nd 0.3\nnewmtl other\nmap_Ks a.png\n");
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(
        told[0].contains("twig.obj: d, map_Bump of heights of its materials not used"),
        "{told:?}"
    );
}

#[test]
fn a_model_that_lacks_its_material_or_hangs_in_the_air_is_told_of() {
    let remarks = |obj: &str| {
        let folder = folder(RULE, obj, MATERIAL);
        let remarks = remarked(&load(&rule(&folder)).unwrap());
        let place = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
        remarks.into_iter().map(|r| r.replace(&place, "")).collect::<Vec<_>>()
    };
    assert_eq!(remarks(&format!("{TWIG}usemtl None\nf 1 2 3\n")), [""; 0]);
    assert_eq!(
        remarks(&TWIG.replace("usemtl leaf\n", "")),
        ["twig.obj: no face has a material (usemtl): all are plain green"]
    );
    let lost = remarks(&format!("{TWIG}usemtl stalk\nf 1 2 3\n"));
    assert_eq!(
        lost,
        [
            "twig.obj:14: no material file (mtllib) has the material `stalk`: its faces are plain green"
        ]
    );
    // Of a height of 8: from 4 on, from 0.5 on, and beside its origin.
    let lifted = |low: &str, high: &str| {
        let taller = TWIG.replace("1 4 0\n", &format!("1 {high} 0\n"));
        remarks(&taller.replace("1 0 0\n", &format!("1 {low} 0\n")))
    };
    assert_eq!(lifted("0.5", "8"), [""; 0]);
    let told = "twig.obj: its faces begin 50 % of its height away from its origin, where it joins its \
                shoot: it will hang in the air; move it there";
    assert_eq!(lifted("4", "8"), [told]);
    let beside = TWIG.replace("v -1", "v 3").replace("v 1", "v 5");
    assert_eq!(remarks(&beside), [told.replace("50 %", "75 %")]);
}

#[test]
fn fruit_that_names_no_model_is_told_of() {
    let remarks = |fruit: &str| {
        let folder = folder(&format!("{RULE}\n[fruit]\n{fruit}\n"), TWIG, MATERIAL);
        remarked(&load(&rule(&folder)).unwrap())
    };
    let told = remarks("per_m = 3");
    assert_eq!(told.len(), 1);
    assert!(told[0].contains(": `fruit.per_m` bears nothing without a `fruit.model`"), "{told:?}");
    for said in ["", "per_m = 3\nmodel = \"\"", "per_m = 3\nmodel = \"twig.obj\""] {
        assert_eq!(remarks(said), [""; 0], "{said}");
    }
}

#[test]
fn the_nearest_place_of_a_triangle_is_as_near_as_any_sampled() {
    let mut draws = crate::seed::Seed::new(4).draws();
    for _ in 0..200 {
        let [a, b, c] = [(); 3].map(|()| draws.direction() * draws.between(0.1, 3.0));
        let found = nearest([a, b, c]).length();
        let sampled = (0..=60).flat_map(|i| (0..=60 - i).map(move |k| (i, k)));
        let sampled = sampled.map(|(i, k)| {
            let (u, v) = (i as f32 / 60.0, k as f32 / 60.0);
            (a * (1.0 - u - v) + b * u + c * v).length()
        });
        let least = sampled.fold(f32::INFINITY, f32::min);
        assert!((-1e-4..0.1).contains(&(least - found)), "{found} {least}");
    }
}

#[test]
fn a_cone_is_read_beside_the_leaves_and_errors_name_its_key() {
    let rule_text = "extends = 'table3/13'\n[fruit]\nmodel = 'twig.obj'\nlength_m = 0.1\n";
    let cones = folder(rule_text, TWIG, MATERIAL);
    let species = load(&rule(&cones)).unwrap();
    assert_eq!(species.own_fruit.unwrap().position.len(), 4);
    assert!(species.own_model.is_none());
    let watched = files(Path::new(&rule(&cones)));
    assert!(watched.iter().any(|f| f.ends_with("twig.obj")), "{watched:?}");
    let lost = folder(&rule_text.replace("twig.obj", "cone.obj"), TWIG, MATERIAL);
    let error = load(&rule(&lost)).unwrap_err();
    assert!(error.message().contains("cone.obj"), "{error}");
}

#[test]
fn a_file_that_extends_another_finds_its_model_beside_that() {
    let folder = folder(RULE, TWIG, MATERIAL);
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let top = inner.join("top.toml");
    std::fs::write(&top, "extends = '../own.toml'").unwrap();
    assert!(load(&top.to_string_lossy()).unwrap().own_model.is_some());
    std::fs::write(&top, "extends = '../own.toml'\n[foliage]\nmodel = ''").unwrap();
    assert!(load(&top.to_string_lossy()).unwrap().own_model.is_none());
}

#[test]
fn a_models_one_material_gives_its_name_and_roughness() {
    let of = |obj: &str, mtl: &str| {
        let model = load(&rule(&folder(RULE, obj, mtl))).unwrap().own_model.unwrap();
        (model.material.clone(), model.roughness)
    };
    let [leaf, named] = [TWIG.to_owned(), TWIG.replace("usemtl leaf", "usemtl Waxy leaf")];
    assert_eq!(of(&leaf, MATERIAL), (Some("leaf".into()), None));
    let waxy = MATERIAL.replace("newmtl leaf", "newmtl Waxy leaf\nNs 250");
    assert_eq!(of(&named, &waxy), (Some("Waxy leaf".into()), Some(0.5)));
    let both = waxy.replace("Ns 250", "Ns 250\nPr 0.3");
    assert_eq!(of(&named, &both), (Some("Waxy leaf".into()), Some(0.3)));
    // Two become one.
    let two = format!("{TWIG}usemtl stalk\nf 1/1/1 2/2/1 3/3/1\n");
    let stalk = |ns: u32| format!("{MATERIAL}Ns 250\nnewmtl stalk\nKd 0.2 0.1 0\nNs {ns}\n");
    assert_eq!(of(&two, &stalk(250)), (None, Some(0.5)));
    assert_eq!(of(&two, &stalk(90)), (None, None));
}

#[test]
fn plain_colours_become_swatches_and_faces_get_normals() {
    let obj = "mtllib twig.mtl\nv 0 0 0\nv 1 0 0\nv 0 2 0\nv 1 2 0\nusemtl red\nf 1 2 3\n\
               usemtl blue\nf 2 4 3\n";
    let mtl = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n";
    let folder = folder(RULE, obj, mtl);
    let model = load(&rule(&folder)).unwrap().own_model.unwrap();
    let seen = |k: usize| {
        let x = model.uv[model.index[k] as usize][0] * model.picture.width as f32;
        model.picture.at(x as u32, 4)
    };
    assert_eq!((seen(0), seen(3)), ([255, 0, 0, 255], [0, 0, 255, 255]));
    assert!(model.normal.iter().all(|n| (n[2] - 1.0).abs() < 1e-6));
}

/// Message and remedy of what is wrong, without the folder.
fn refused(rule_text: &str, obj: &str, mtl: &str) -> String {
    let folder = folder(rule_text, obj, mtl);
    let error = load(&rule(&folder)).unwrap_err();
    let place = error.line_and_column().map(|(line, _)| line);
    assert_eq!(place, Some(3), "{error:?}");
    let text = format!("{}; {}", error.message(), error.remedy_text().unwrap());
    text.replace(&format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR), "")
}

#[test]
fn faults_are_told_with_file_line_and_remedy() {
    let spoilt = |from: &str, to: &str| {
        assert!(TWIG.contains(from));
        refused(RULE, &TWIG.replace(from, to), MATERIAL)
    };
    let cases = [
        (
            spoilt("v 1 4 0", "v 1 four 0"),
            "`model`: twig.obj:5: not a list of ordinary numbers; export the model again",
        ),
        (
            spoilt("usemtl leaf", "usemtl"),
            "`model`: twig.obj:12: usemtl names no material; name one, or leave the line out",
        ),
        (
            spoilt("v 1 4 0", "v 1 nan 0"),
            "`model`: twig.obj:5: not a list of ordinary numbers; export the model again",
        ),
        (
            spoilt("v 1 4 0", "v 2000000 4 0"),
            "`model`: twig.obj:5: 2000000 is more than 1000000; move the model to its origin",
        ),
        (
            spoilt("f 1/1/1 2/2/1 3/3/1 4/4/1", "f 1/1/1 1/1/1 3/3/1"),
            "`model`: twig.obj: none of its faces has an area",
        ),
        (
            spoilt(
                "v -1 0 0\nv 1 0 0\nv 1 4 0\nv -1 4 0",
                "v -1e-30 0 0\nv 1e-30 0 0\nv 1e-30 4e-30 0\nv -1e-30 4e-30 0",
            ),
            "`model`: twig.obj: it is 4e-30 large, too small to tell its corners apart; export it larger",
        ),
        (
            spoilt("v 1 4 0", "v 1 4"),
            "`model`: twig.obj:5: 2 numbers, not 3; export the model again",
        ),
        (
            spoilt("4/4/1\n", "9/4/1\n"),
            "`model`: twig.obj:13: vertex 9 of 4 in `9/4/1`; export the model again",
        ),
        (
            spoilt("4/4/1\n", "4//1\n"),
            "`model`: twig.obj: its faces have a picture and no texture coordinates; unwrap",
        ),
        (
            spoilt("f 1/1/1 2/2/1 3/3/1 4/4/1", "f 1/1/1 2/2/1"),
            "`model`: twig.obj:13: a face of 2 corners; give it three or more",
        ),
        (
            spoilt("2/2/1 3/3/1", &"2/2/1 3/3/1 ".repeat(2048)),
            "`model`: twig.obj:13: a face of 4098 corners, more than 4096; export the mesh as triangles",
        ),
        (
            spoilt("f 1/1/1 2/2/1 3/3/1 4/4/1", ""),
            "`model`: twig.obj: it has no faces; export a mesh, as triangles",
        ),
        (spoilt("twig.mtl", "none.mtl"), "none.mtl"),
        (
            refused(RULE, TWIG, "newmtl leaf\nKd 1 1\n"),
            "`model`: twig.mtl:2: not a colour of three numbers; write red, green and blue, 0 to 1",
        ),
        (
            refused(RULE, TWIG, "newmtl leaf\nmap_Kd none.png\n"),
            "; twig.mtl:2 names it: give the path of a PNG or JPEG file",
        ),
        (
            refused(
                RULE,
                TWIG,
                "# broken.png\nnewmtl b\nmap_Kd unbroken.png\nnewmtl leaf\nmap_Kd broken.png\n",
            ),
            "broken.png: not a sound PNG: it is damaged or cut short; twig.mtl:5 names it: open",
        ),
        (refused(RULE, TWIG, "newmtl leaf\nmap_Kd twig.obj\n"), "not a readable picture"),
        (
            refused(RULE, &TWIG.replace(" 4 0", " 0 4"), MATERIAL),
            "it does not reach above its origin along y",
        ),
        (
            refused(&RULE.replace("twig.obj", "none.obj"), TWIG, MATERIAL),
            "give the path of an OBJ file",
        ),
        (
            refused(&RULE.replace("model = 'twig.obj'", "picture = 'opaque.png'"), TWIG, MATERIAL),
            "it has no transparent pixels",
        ),
        (
            refused(&RULE.replace("model = 'twig.obj'", "picture = 'empty.png'"), TWIG, MATERIAL),
            "nothing in it is opaque",
        ),
        (
            refused(&RULE.replace("model = 'twig.obj'", "picture = 'broken.png'"), TWIG, MATERIAL),
            "`picture`: broken.png: not a sound PNG: it is damaged or cut short; open it in an \
             image editor and save it again",
        ),
    ];
    for (said, wanted) in cases {
        assert!(said.contains(wanted), "{said}\n   not {wanted}");
    }
    let both = folder(&format!("{RULE}picture = 'leaf.png'"), TWIG, MATERIAL);
    let error = load(&rule(&both)).unwrap_err();
    assert_eq!(error.message(), "`model` and `picture` are both given");
    let error = load_text("own", RULE).unwrap_err();
    assert_eq!(error.message(), "`model` names a file");
}

/// The pixel that a corner shows.
fn shown(model: &Model, corner: usize) -> [u8; 4] {
    let [u, v] = model.uv[model.index[corner] as usize];
    let side = |x: f32, side: u32| ((x * side as f32) as u32).min(side - 1);
    let (w, h) = (model.picture.width, model.picture.height);
    model.picture.at(side(u, w), side(1.0 - v, h))
}

#[test]
fn pictures_and_plain_colours_are_laid_side_by_side() {
    // A stalk in a plain colour without texture coordinates, as Blender writes it, and another leaf.
    let obj = format!("{TWIG}usemtl stalk\nf 1//1 2//1 3//1\nusemtl other\nf -4/-4 -3/-3 -2/-2\n");
    let mtl = format!("{MATERIAL}newmtl stalk\nKd 1 0 0\nnewmtl other\nmap_Kd opaque.png\n");
    let folder = folder(RULE, &obj, &mtl);
    // Its lower right corner.
    let mut opaque = Picture::filled(4, 4, [30, 90, 20, 255]);
    opaque.set(3, 3, [1, 2, 3, 255]);
    std::fs::write(folder.path().join("opaque.png"), opaque.to_png().unwrap()).unwrap();
    let model = load(&rule(&folder)).unwrap().own_model.unwrap();
    assert_eq!(model.index.len(), 12);
    // The hole of the first picture is at its upper left, that of the second at its lower right.
    assert_eq!(shown(&model, 5)[3], 0);
    assert_eq!(shown(&model, 0), [30, 90, 20, 255]);
    assert!((6..9).all(|k| shown(&model, k) == [255, 0, 0, 255]));
    assert_eq!(shown(&model, 10), [1, 2, 3, 255]);
    assert!(model.normal.iter().all(|n| *n == [0.0, 0.0, 1.0]));
}

/// A mask cuts the picture, by its grey or its alpha, or a plain colour; what it is not there for is told.
#[test]
fn masks_of_their_own_cut_leaves() {
    let with = |material: &str, mask: &Picture| {
        let folder = folder(RULE, TWIG, material);
        std::fs::write(folder.path().join("mask.png"), mask.to_png().unwrap()).unwrap();
        let species = load(&rule(&folder)).unwrap();
        assert!(species.remarks.is_empty(), "{:?}", species.remarks);
        species.own_model.unwrap().picture.clone()
    };
    // Twice as fine as the picture; its lower half is cut.
    let mut grey = Picture::filled(12, 8, [255; 4]);
    let mut alpha = Picture::filled(12, 8, [9, 9, 9, 255]);
    for (x, y) in (0..12).flat_map(|x| (4..8).map(move |y| (x, y))) {
        grey.set(x, y, [0, 0, 0, 255]);
        alpha.set(x, y, [9, 9, 9, 0]);
    }
    for mask in [&grey, &alpha] {
        let cut = with(&format!("{MATERIAL}map_d mask.png\n"), mask);
        assert_eq!((cut.width, cut.height), (6, 4));
        // The picture's own hole stays one.
        assert_eq!([cut.at(5, 1), cut.at(0, 0)].map(|p| p[3]), [255, 0]);
        assert!((0..6).all(|x| cut.at(x, 3)[3] == 0));
    }
    let plain = with("newmtl leaf\nKd 1 0 0\nmap_d mask.png\n", &grey);
    assert_eq!((plain.width, plain.height), (12, 8));
    assert_eq!([plain.at(3, 3), plain.at(3, 4)], [[255, 0, 0, 255], [255, 0, 0, 0]]);
    let lost = folder(RULE, TWIG, &format!("{MATERIAL}map_d mask.png\n"));
    assert!(load(&rule(&lost)).unwrap_err().message().contains("mask.png"));
}

/// Normals lie as their picture does; where others have none, level ones.
#[test]
fn normals_come_with_their_picture() {
    const TILTED: [u8; 4] = [200, 128, 230, 255];
    let read = |obj: &str, mtl: &str| {
        let folder = folder(RULE, obj, mtl);
        let mut normals = Picture::filled(6, 4, TILTED);
        normals.set(0, 0, [128, 128, 255, 255]);
        std::fs::write(folder.path().join("normal.png"), normals.to_png().unwrap()).unwrap();
        let species = load(&rule(&folder)).unwrap();
        assert!(species.remarks.is_empty(), "{:?}", species.remarks);
        let model = species.own_model.clone().unwrap();
        let textures = crate::texture::for_species(&species, 64, crate::seed::Seed::new(1));
        assert_eq!(textures.leaf_normal.as_ref().map(|i| i.picture()), model.normals.as_ref());
        let parts = textures.to_parts().unwrap();
        assert_eq!(crate::texture::TreeTextures::from_parts(parts).unwrap(), textures);
        model
    };
    for line in ["map_Bump -bm 1.0 normal.png", "norm normal.png"] {
        let model = read(TWIG, &format!("{MATERIAL}{line}\n"));
        assert_eq!(model.normals.as_ref().unwrap().at(3, 3), TILTED);
    }
    assert!(read(TWIG, MATERIAL).normals.is_none());
    let obj = format!("{TWIG}usemtl other\nf -4/-4 -3/-3 -2/-2\n");
    let mtl = format!("{MATERIAL}map_Bump normal.png\nnewmtl other\nmap_Kd opaque.png\n");
    let model = read(&obj, &mtl);
    let normals = model.normals.as_ref().unwrap();
    assert_eq!((normals.width, normals.height), (model.picture.width, model.picture.height));
    let of = |corner: usize| {
        let [u, v] = model.uv[model.index[corner] as usize];
        let side = |x: f32, side: u32| ((x * side as f32) as u32).min(side - 1);
        normals.at(side(u, normals.width), side(1.0 - v, normals.height))
    };
    assert_eq!(of(0), TILTED);
    assert_eq!(of(7), [128, 128, 255, 255]);
}

#[test]
fn what_leaves_one_picture_of_several_is_refused() {
    let obj = format!("{TWIG}usemtl other\nf 1//1 2//1 3//1\n").replace("vt 1 1", "vt 1 2.5");
    let plain = format!("{MATERIAL}newmtl other\nKd 1 0 0\n");
    assert!(refused(RULE, &obj, &plain).contains("1, 2.5 leaves the picture leaf.png"));
    // Of one alone it may: it repeats.
    let alone = folder(RULE, &TWIG.replace("vt 1 1", "vt 1 2.5"), MATERIAL);
    assert!(load(&rule(&alone)).is_ok());
}

#[test]
fn a_picture_is_made_square_on_its_foot() {
    let folder =
        folder(&RULE.replace("model = 'twig.obj'", "picture = 'leaf.png'"), TWIG, MATERIAL);
    let picture = load(&rule(&folder)).unwrap().own_picture.unwrap();
    assert_eq!((picture.width, picture.height), (6, 6));
    assert_eq!(picture.at(3, 5), [30, 90, 20, 255]);
    assert_eq!(picture.at(3, 1)[3], 0);
    let error = twig_picture(Path::new("no.png")).unwrap_err();
    assert_eq!(error.remedy_text(), Some("give the path of a PNG file with alpha"));
}

#[test]
fn the_opaque_spot_is_opaque_around() {
    let mut picture = Picture::filled(64, 32, [0; 4]);
    for (x, y) in (0..8).flat_map(|x| (0..8).map(move |y| (40 + x, 8 + y))) {
        picture.set(x, y, [255; 4]);
    }
    picture.set(0, 0, [255; 4]);
    let spot = opaque_spot(&picture) * Vec2::new(64.0, 32.0);
    assert!((41.0..47.0).contains(&spot.x) && (17.0..23.0).contains(&spot.y), "{spot}");
    assert_eq!(opaque_spot(&Picture::filled(3, 1, [0; 4])), Vec2::splat(0.5));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn no_model_panics(
        lines in prop::collection::vec(
            "(v|vt|vn|f|l|o|g|usemtl|mtllib|s|#)( (-?[0-9]{1,2}(/-?[0-9]{0,2}){0,3}|twig.mtl|leaf|nan|1e9)){0,5}",
            0..30),
        tail in "\\PC{0,30}",
        material in prop::collection::vec("(newmtl|Kd|Ka|map_Kd|illum|d|bump|Ns)( [a-z0-9.-]{1,5}){0,4}", 0..6),
    ) {
        let obj = format!("{}\n{tail}", lines.join("\n"));
        let folder = folder(RULE, &obj, &material.join("\n"));
        match load(&rule(&folder)) {
            Ok(species) => {
                let model = species.own_model.unwrap();
                let n = model.position.len();
                prop_assert!(model.normal.len() == n && model.uv.len() == n);
                prop_assert!(model.index.iter().all(|&i| (i as usize) < n));
                prop_assert!(model.position.iter().flatten().all(|x| x.is_finite()));
            }
            Err(error) => prop_assert!(error.labels_lie_within()),
        }
    }
}

/// Before any is decoded: their heads say how large they are.
#[test]
fn pictures_too_wide_for_one_are_refused_by_their_heads() {
    let mtl: String = (0..3).map(|k| format!("newmtl m{k}\nmap_Kd wide{k}.png\n")).collect();
    let faces: String =
        (0..3).map(|k| format!("usemtl m{k}\nf 1/1/1 2/2/1 3/3/1 4/4/1\n")).collect();
    let obj = TWIG.split("usemtl").next().unwrap().to_owned() + &faces;
    let folder = folder(RULE, &obj, &mtl);
    let png = Picture::filled(4000, 2, [30, 90, 20, 255]).to_png().unwrap();
    for k in 0..3 {
        // Nothing but the head.
        std::fs::write(folder.path().join(format!("wide{k}.png")), &png[..60]).unwrap();
    }
    let error = load(&rule(&folder)).unwrap_err().to_string();
    assert!(
        error.contains("its pictures side by side are 12000 pixels wide, more than 8192"),
        "{error}"
    );
    // Finer normals than colours are as they come, within bounds.
    let material = |k: i32| format!("newmtl m{k}\nmap_Kd leaf.png\nnorm wide{k}.png\n");
    let face = |k: i32| format!("usemtl m{k}\nf 1/1/1 2/2/1 3/3/1 4/4/1\n");
    for k in 0..9 {
        std::fs::write(folder.path().join(format!("wide{k}.png")), &png[..60]).unwrap();
    }
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    write("twig.mtl", (0..9).map(material).collect());
    write("twig.obj", obj.replace(&faces, &(0..9).map(face).collect::<String>()));
    let error = load(&rule(&folder)).unwrap_err().to_string();
    let says = "its normal maps side by side are 36000 pixels wide, more than 32768";
    assert!(error.contains(says), "{error}");
}
