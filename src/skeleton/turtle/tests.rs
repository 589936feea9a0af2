use super::*;
use crate::seed::Seed;
use crate::skeleton::derive::{Inputs, derive};
use crate::species;

fn drawn(section: &str) -> Scaffold {
    let rule = species::load_text("test", &format!("[rule]\n{section}")).unwrap().rule;
    let string = derive(&rule, &Inputs::new(Seed::new(1))).unwrap();
    let scaffold = draw(&rule, &string).unwrap();
    scaffold.check().unwrap();
    scaffold
}

fn table3(number: u32) -> Scaffold {
    let rule = species::load(&format!("table3/{number:02}")).unwrap().rule;
    draw(&rule, &derive(&rule, &Inputs::new(Seed::new(1))).unwrap()).unwrap()
}

fn heading(axiom: &str, more: &str) -> Scaffold {
    drawn(&format!("turtle = 'heading'\naxiom = '''{axiom}'''\niterations = 0\n{more}"))
}

fn near(p: Vec3, q: [f32; 3]) -> bool {
    (p - Vec3::from_array(q)).abs().max_element() < 1e-6
}

/// Method, §6: along U, 86 of the 126 nodes of rule 13 are distinct.
#[test]
fn rule_13_has_86_distinct_nodes() {
    let scaffold = table3(13);
    assert_eq!(scaffold.len(), 126);
    assert_eq!(scaffold.distinct_positions(1e-4), 86);
}

/// One iteration of rule 13 in closed form: the stem, and shoots of half its length at 30°.
#[test]
fn first_shoots_lean_to_four_sides() {
    let scaffold = drawn(
        r"axiom = 'F(a)'
        iterations = 1
        angles = { alpha = 30 }
        productions = ['F(a) -> F(a)[^F(0.5a)][&F(0.5a)][/F(0.5a)][\F(0.5a)]']",
    );
    let (side, up) = (0.25, 1.0 + 0.5 * 0.75f32.sqrt());
    let expected = [
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [side, 0.0, up],
        [-side, 0.0, up],
        [0.0, side, up],
        [0.0, -side, up],
    ];
    for (p, q) in scaffold.position.iter().zip(expected) {
        assert!(near(*p, q), "{p} is not {q:?}");
    }
    assert_eq!(scaffold.parent, [NO_PARENT, 0, 1, 1, 1, 1]);
    assert_eq!(scaffold.axis, [0, 0, 1, 2, 3, 4]);
    assert_eq!(scaffold.order, [0, 0, 1, 1, 1, 1]);
}

/// R_U, R_L, R_H as printed.
#[test]
fn turns_are_the_printed_matrices() {
    let a = 0.3f64;
    let (s, c) = a.sin_cos();
    let printed_rows = [
        (Axis::U, [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]),
        (Axis::L, [[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]),
        (Axis::H, [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]),
    ];
    for (axis, rows) in printed_rows {
        for dialect in [Dialect::Upright, Dialect::Heading] {
            let start = Pose::new(dialect);
            let mut turned = start;
            turned.turn(axis, a);
            let expected = start.frame() * DMat3::from_cols_array_2d(&rows).transpose();
            assert!(turned.frame().abs_diff_eq(expected, 1e-12), "{axis:?} {dialect:?}");
        }
    }
}

#[test]
fn the_frame_stays_orthonormal_over_a_million_turns() {
    let mut pose = Pose::new(Dialect::Upright);
    let axes = [Axis::H, Axis::L, Axis::U];
    let mut draws = Seed::new(3).draws();
    for i in 0..1_000_000usize {
        pose.turn(axes[i % 3], f64::from(draws.between(-3.0, 3.0)));
    }
    let frame = pose.frame();
    let error = (frame.transpose() * frame - DMat3::IDENTITY)
        .to_cols_array()
        .iter()
        .fold(0.0f64, |m, x| m.max(x.abs()));
    assert!(error < 1e-12, "{error}");
    assert!((frame.determinant() - 1.0).abs() < 1e-12);
    // A full turn in a million steps comes home.
    let mut pose = Pose::new(Dialect::Upright);
    for _ in 0..1_000_000 {
        pose.turn(Axis::L, std::f64::consts::TAU / 1e6);
    }
    assert!(pose.frame().abs_diff_eq(DMat3::IDENTITY, 1e-9));
}

#[test]
fn brackets_nest_a_hundred_thousand_deep() {
    let deep = 100_000;
    let axiom = format!("F{}{}", "[+F".repeat(deep), "]".repeat(deep));
    let scaffold = heading(&axiom, "angles = { delta = 90 }");
    assert_eq!(scaffold.len(), deep + 2);
    assert_eq!(scaffold.order[100], 99);
    assert_eq!(scaffold.order.last(), Some(&u16::MAX));
    // Quarter turns walk a square: after any four segments the turtle is back.
    assert!(near(scaffold.position[deep / 4 * 4], [0.0, 0.0, 0.0]));
}

#[test]
fn special_angles_are_exact_enough() {
    for (degrees, end) in [
        (0.0, [0.0, 0.0, 2.0]),
        (90.0, [-1.0, 0.0, 1.0]),
        (180.0, [0.0, 0.0, 0.0]),
        (360.0, [0.0, 0.0, 2.0]),
    ] {
        let scaffold = drawn(&format!(
            "axiom = 'F(a)&F(a)'\niterations = 0\nangles = {{ alpha = {degrees} }}"
        ));
        assert!(near(scaffold.position[2], end), "{degrees}: {}", scaffold.position[2]);
    }
}

#[test]
fn shoots_without_length_are_not_grown() {
    let scaffold = drawn("axiom = 'F(0)F(-1)F(a)F(1e-6)F(1e6)'\niterations = 0");
    assert_eq!(scaffold.len(), 4);
    assert_eq!(scaffold.position[3].z, 1_000_001.0);
}

#[test]
fn stems_of_a_stool_have_order_0() {
    let scaffold = table3(7);
    let from_origin = (1..scaffold.len()).filter(|&i| scaffold.parent[i] == 0);
    let stems: Vec<(u32, u16)> =
        from_origin.map(|i| (scaffold.axis[i], scaffold.order[i])).collect();
    assert_eq!(stems.len(), 2);
    assert!(stems.iter().all(|(_, order)| *order == 0));
    assert_ne!(stems[0].0, stems[1].0);
}

/// ABOP, §1.5 in words: + turns left, & pitches down, \ rolls left, | turns about.
#[test]
fn heading_turtle_turns_as_in_the_book() {
    let angles = "angles = { delta = 90 }";
    // H up, L west, U towards the viewer in the south.
    for (axiom, end) in [
        ("+F", [-1.0, 0.0, 0.0]),
        ("-F", [1.0, 0.0, 0.0]),
        ("&F", [0.0, 1.0, 0.0]),
        ("^F", [0.0, -1.0, 0.0]),
        ("\\+F", [0.0, 1.0, 0.0]),
        ("/+F", [0.0, -1.0, 0.0]),
    ] {
        let scaffold = heading(axiom, angles);
        assert!(near(scaffold.position[1], end), "{axiom}: {}", scaffold.position[1]);
    }
    assert!(near(heading("|F", "").position[1], [0.0, 0.0, -1.0]));
    assert!(near(heading("+(180)F", "").position[1], [0.0, 0.0, -1.0]));
}

#[test]
fn level_puts_l_in_the_horizontal() {
    let mut pose = Pose::new(Dialect::Heading);
    pose.turn(Axis::U, 0.7);
    pose.turn(Axis::H, 1.1);
    let before = pose.frame().x_axis;
    pose.level();
    let frame = pose.frame();
    assert!((frame.x_axis - before).length() < 1e-12);
    assert!(frame.y_axis.z.abs() < 1e-12);
    assert!(frame.z_axis.z >= 0.0);
}

/// The leaf of ABOP, Figure 1.25: a hexagon.
#[test]
fn polygons_are_leaves() {
    let scaffold = heading("F[{-f+f+f-|-f+f+f}]", "angles = { delta = 22.5 }");
    assert_eq!(scaffold.len(), 2);
    assert_eq!(scaffold.polygon_end, [6]);
    assert_eq!(scaffold.polygon_node, [1]);
    // The sixth step comes back to the start.
    assert!(near(scaffold.polygon[5], [0.0, 0.0, 1.0]));
}

#[test]
fn widths_follow_the_brackets() {
    let scaffold = heading("!(0.5)F[!F]F", "");
    assert_eq!(scaffold.width_m, [0.0, 0.5, 0.35, 0.5]);
}

/// A diamond in the plane of H and L.
#[test]
fn a_leaf_is_a_diamond() {
    let scaffold = heading("F[+~(2)L]", "angles = { delta = 90 }");
    assert_eq!(scaffold.len(), 2);
    assert_eq!(
        (scaffold.polygon_end.as_slice(), scaffold.polygon_node.as_slice()),
        (&[4][..], &[1][..])
    );
    // The branch heads west; its left is down.
    let corners = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.5], [-2.0, 0.0, 1.0], [-1.0, 0.0, 1.5]];
    for (p, q) in scaffold.polygon.iter().zip(corners) {
        assert!(near(*p, q), "{p} is not {q:?}");
    }
    assert!(heading("F~(0)~(-1)", "").polygon.is_empty());
    assert_eq!(heading("F~", "").polygon[2].z, 2.0);
}

/// ABOP, App. C: `G` draws as `F` does, but makes no corner; wood is drawn outside polygons alone.
#[test]
fn edges_make_no_corners() {
    let scaffold = heading("G{.F+G+F.}G", "angles = { delta = 90 }");
    assert_eq!(scaffold.len(), 3);
    let corners = [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]];
    assert_eq!(scaffold.polygon.len(), 4);
    for (p, q) in scaffold.polygon.iter().zip(corners) {
        assert!(near(*p, q), "{p} is not {q:?}");
    }
}

/// ABOP, §5.1: a leaf whose polygons begin in one bracket and end in the next.
#[test]
fn polygons_reach_across_brackets() {
    let leaf = |n: u32| {
        drawn(&format!(
            "turtle = 'heading'\naxiom = '[A][B]'\niterations = {n}\nangles = {{ delta = 16 }}
            productions = ['A -> [+A{{.].C.}}', 'B -> [-B{{.].C.}}', 'C -> GC']\nmarkers = 'C'"
        ))
    };
    let scaffold = leaf(12);
    assert_eq!((scaffold.polygon_end.len(), scaffold.polygon.len()), (24, 72));
    assert_eq!(scaffold.len(), 1);
}

/// In the plane of pull and shoot the angle between them falls by e·sin of it a segment.
#[test]
fn tropism_bends_each_segment_towards_its_pull() {
    let bent = |elasticity: f64, pull: &str| {
        let text = format!(
            "[rule]\nturtle = 'heading'\naxiom = '&(60)F(1)F(1)F(1)F(1)'\niterations = 0\n\
             tropism = {{ pull = {pull}, elasticity = {elasticity} }}"
        );
        let rule = crate::species::load_text("bent", &text).unwrap().rule;
        let string = derive(&rule, &Inputs::new(Seed::new(1))).unwrap();
        draw(&rule, &string).unwrap().position
    };
    for e in [0.0, 0.22, -0.3, 0.9] {
        let position = bent(e, "[0, 0, -1]");
        let (mut angle, mut z) = (120f64.to_radians(), 0.0);
        for p in &position[1..] {
            z -= angle.cos();
            assert!((f64::from(p.z) - z).abs() < 1e-5, "{e}: {p} is not at {z}");
            angle -= e * angle.sin();
        }
    }
    // However elastic, it hangs straight in the end and does not swing.
    let position = bent(10.0, "[0, 0, -10]");
    for pair in position[1..].windows(2) {
        assert!((pair[1] - pair[0] + Vec3::Z).length() < 1e-5, "{pair:?}");
    }
}
