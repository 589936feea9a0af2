//! The turtle: a derived string to a scaffold of nodes.
//!
//! Frame [H L U] and its turns R_U, R_L, R_H as printed in [T15] and [ABOP, §1.5]: the new frame is
//! [H L U]·R. The upright dialect grows along U, which begins upwards (H east, L north), so that
//! & ^ \ / lean a shoot to four different sides. The heading dialect grows along H, which begins
//! upwards, L to the west.
//!
//! The frame is a unit quaternion in f64, drawn back to unit length at every turn, so that it
//! stays orthonormal however long the string. Brackets use a stack on the heap: nesting is limited
//! by memory alone.
//!
//! A shoot of length ≤ 0 is not grown: no node, no move. `f` moves without drawing; the next
//! segment then spans the gap. The decay of lengths with distance from the apex is left to the
//! growth stage, which knows the axes.

use glam::{DMat3, DQuat, DVec3, Vec3};

use super::NO_PARENT;
use super::derive::ModuleString;
use crate::diagnostic::{Error, Result};
use crate::species::rule::{Action, Axis, Dialect, Rule};

/// What the turtle drew, as flat columns; a node and its parent span one segment. Metres, the
/// origin is node 0, parents come before children.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scaffold {
    pub position: Vec<Vec3>,
    /// [`NO_PARENT`] for node 0.
    pub parent: Vec<u32>,
    /// Axis of the segment that ends here; 0 is the first drawn (the stem). Segments drawn one
    /// after another at one bracket level share an axis.
    pub axis: Vec<u32>,
    /// Branching order of the axis: 0 for every axis that begins at the origin, else that of the
    /// node it begins at, plus one. Stays at 65,535 beyond.
    pub order: Vec<u16>,
    /// Symbol that drew the segment: an id of [`Rule::symbols`]; `u8::MAX` for node 0.
    pub symbol: Vec<u8>,
    /// Line width at the node, metres, as `!` set it; empty unless the rule does.
    pub width_m: Vec<f32>,
    /// Corners of all polygons, one after another.
    pub polygon: Vec<Vec3>,
    /// For each polygon, where its corners end in `polygon`.
    pub polygon_end: Vec<u32>,
    /// For each polygon, the node it hangs from.
    pub polygon_node: Vec<u32>,
}

impl Scaffold {
    pub fn len(&self) -> usize {
        self.position.len()
    }

    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// The number of places that differ by more than `tolerance_m` along some axis, on a grid of
    /// that pitch.
    pub fn distinct_positions(&self, tolerance_m: f32) -> usize {
        let mut places: Vec<[i64; 3]> = self
            .position
            .iter()
            .map(|p| (*p / tolerance_m).round().to_array().map(|x| x as i64))
            .collect();
        places.sort_unstable();
        places.dedup();
        places.len()
    }

    /// Checks the invariants: columns of equal length, one root, parents first, all finite.
    pub fn check(&self) -> std::result::Result<(), String> {
        let n = self.len();
        if [self.parent.len(), self.axis.len(), self.order.len(), self.symbol.len()] != [n; 4] {
            return Err("columns differ in length".into());
        }
        if !(self.width_m.is_empty() || self.width_m.len() == n) {
            return Err("the width column has another length".into());
        }
        if self.parent.first() != Some(&NO_PARENT) {
            return Err("node 0 is not the root".into());
        }
        for (i, (&parent, position)) in self.parent.iter().zip(&self.position).enumerate() {
            if i > 0 && parent as usize >= i {
                return Err(format!("node {i} comes before its parent {parent}"));
            }
            if !position.is_finite() {
                return Err(format!("node {i} is not finite"));
            }
        }
        if self.polygon_end.len() != self.polygon_node.len()
            || !self.polygon_end.is_sorted()
            || self.polygon_end.last().map_or(0, |&e| e as usize) != self.polygon.len()
        {
            return Err("the polygons do not cover their corners".into());
        }
        Ok(())
    }
}

/// The turtle's axes in world terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Takes x, y, z to H, L, U.
    rotation: DQuat,
}

impl Pose {
    /// The pose a dialect begins with.
    pub fn new(dialect: Dialect) -> Self {
        let rotation = match dialect {
            Dialect::Upright => DQuat::IDENTITY,
            Dialect::Heading => {
                DQuat::from_mat3(&DMat3::from_cols(DVec3::Z, -DVec3::X, -DVec3::Y)).normalize()
            }
        };
        Pose { rotation }
    }

    /// H, L and U.
    pub fn frame(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// Direction of growth.
    fn growth(&self, dialect: Dialect) -> DVec3 {
        let DQuat { x, y, z, w } = self.rotation;
        match dialect {
            Dialect::Upright => DVec3::new(
                2.0 * (x * z + w * y),
                2.0 * (y * z - w * x),
                1.0 - 2.0 * (x * x + y * y),
            ),
            Dialect::Heading => DVec3::new(
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y + w * z),
                2.0 * (x * z - w * y),
            ),
        }
    }

    /// Turns about an axis of the frame as R_H, R_L, R_U do.
    pub fn turn(&mut self, axis: Axis, angle_rad: f64) {
        self.apply(quaternion(axis, angle_rad));
    }

    fn apply(&mut self, turn: DQuat) {
        let q = self.rotation * turn;
        // One Newton step towards unit length: the error left is the square of rounding.
        self.rotation = q * (1.5 - 0.5 * q.length_squared());
    }

    /// Rolls about H until L lies level ([ABOP, p. 57]): L = V×H/|V×H|, U = H×L, V upwards. Stays
    /// where H is vertical.
    fn level(&mut self) {
        let h = self.frame().x_axis;
        if let Some(l) = DVec3::Z.cross(h).try_normalize() {
            self.rotation = DQuat::from_mat3(&DMat3::from_cols(h, l, h.cross(l))).normalize();
        }
    }
}

/// The turn as a quaternion. As printed, R_U and R_L turn against the right-hand rule, R_H with it.
fn quaternion(axis: Axis, angle_rad: f64) -> DQuat {
    match axis {
        Axis::H => DQuat::from_rotation_x(angle_rad),
        Axis::L => DQuat::from_rotation_y(-angle_rad),
        Axis::U => DQuat::from_rotation_z(-angle_rad),
    }
}

/// The axis of a state that has not drawn since its bracket opened.
const PENDING: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct State {
    position: DVec3,
    pose: Pose,
    node: u32,
    axis: u32,
    order: u16,
    width: f32,
}

/// What a symbol makes the turtle do, with everything that is fixed worked out.
#[derive(Clone, Copy)]
enum Step {
    Do(Action),
    Turn(DQuat),
}

/// Runs the turtle over a derived string. `rule` must be the one it was derived from.
///
/// # Errors
/// A position that is not finite, or brackets that do not match.
pub fn draw(rule: &Rule, string: &ModuleString) -> Result<Scaffold> {
    let steps: Vec<(Step, usize)> = rule
        .symbols
        .iter()
        .map(|s| {
            let step = match s.action {
                Action::Turn { axis, angle } if s.parameters == 0 => {
                    Step::Turn(quaternion(axis, angle))
                }
                action => Step::Do(action),
            };
            (step, usize::from(s.parameters))
        })
        .collect();
    let draws =
        |id: &&u8| matches!(steps.get(usize::from(**id)), Some((Step::Do(a), _)) if a.draws());
    let mut turtle = Turtle::new(rule, string.symbols.iter().filter(draws).count() + 1);
    let mut parameters = string.parameters.as_slice();
    for &id in &string.symbols {
        let Some(&(step, count)) = steps.get(usize::from(id)) else { continue };
        let (own, rest) = parameters.split_at_checked(count).unwrap_or((&[], &[]));
        parameters = rest;
        match step {
            Step::Turn(turn) => turtle.state.pose.apply(turn),
            Step::Do(action) => {
                turtle.act(id, action, own.first().copied(), string.first_shoot_m)?;
            }
        }
    }
    let mut scaffold = turtle.out;
    if turtle.max_reach > f64::from(f32::MAX) / 4.0 || !turtle.max_reach.is_finite() {
        return Err(Error::new("the turtle ran out of bounds")
            .remedy("lower `iterations`, or the factors of the productions"));
    }
    if !scaffold.width_m.is_empty() {
        scaffold.width_m.resize(scaffold.position.len(), 0.0);
    }
    Ok(scaffold)
}

struct Turtle {
    dialect: Dialect,
    state: State,
    stack: Vec<State>,
    /// Corners of polygons that are open, innermost last.
    open: Vec<Vec<Vec3>>,
    next_axis: u32,
    has_width: bool,
    max_reach: f64,
    out: Scaffold,
}

impl Turtle {
    fn new(rule: &Rule, nodes: usize) -> Self {
        let has_width = rule.symbols.iter().any(|s| s.action == Action::Width);
        let mut out = Scaffold {
            position: Vec::with_capacity(nodes),
            parent: Vec::with_capacity(nodes),
            axis: Vec::with_capacity(nodes),
            order: Vec::with_capacity(nodes),
            symbol: Vec::with_capacity(nodes),
            ..Scaffold::default()
        };
        out.position.push(Vec3::ZERO);
        out.parent.push(NO_PARENT);
        out.axis.push(0);
        out.order.push(0);
        out.symbol.push(u8::MAX);
        if has_width {
            out.width_m.push(0.0);
        }
        let state = State {
            position: DVec3::ZERO,
            pose: Pose::new(rule.dialect),
            node: 0,
            axis: PENDING,
            order: 0,
            width: 0.0,
        };
        Turtle {
            dialect: rule.dialect,
            state,
            stack: Vec::new(),
            open: Vec::new(),
            next_axis: 0,
            has_width,
            max_reach: 0.0,
            out,
        }
    }

    fn act(&mut self, id: u8, action: Action, own: Option<f64>, first_shoot_m: f64) -> Result<()> {
        match action {
            Action::Nothing => {}
            Action::Draw => {
                if self.advance(own.unwrap_or(first_shoot_m)) && self.open.is_empty() {
                    self.node(id);
                }
            }
            Action::Move => {
                self.advance(own.unwrap_or(first_shoot_m));
            }
            Action::Turn { axis, angle } => {
                let angle = own.map_or(angle, |degrees| angle * degrees.to_radians());
                self.state.pose.turn(axis, angle);
            }
            Action::Level => self.state.pose.level(),
            Action::Push => {
                self.stack.push(self.state);
                self.state.axis = PENDING;
            }
            Action::Pop => match self.stack.pop() {
                Some(state) => self.state = state,
                None => {
                    return Err(Error::new("the derived string closes a bracket too many")
                        .remedy("balance the brackets of every production"));
                }
            },
            Action::Open => self.open.push(Vec::new()),
            Action::Corner => self.corner(),
            Action::Close => {
                let corners = self.open.pop().unwrap_or_default();
                if corners.len() >= 3 {
                    self.out.polygon.extend(corners);
                    self.out.polygon_end.push(self.out.polygon.len() as u32);
                    self.out.polygon_node.push(self.state.node);
                }
            }
            Action::Width => {
                self.state.width = match own {
                    Some(width) => (width.max(0.0)) as f32,
                    None => self.state.width * 0.7,
                };
            }
        }
        Ok(())
    }

    /// Moves along the axis of growth; false for a length ≤ 0. Inside a polygon the new position
    /// is a corner.
    fn advance(&mut self, length_m: f64) -> bool {
        if length_m > 0.0 {
            self.state.position += self.state.pose.growth(self.dialect) * length_m;
            self.max_reach = self.max_reach.max(self.state.position.abs().max_element());
            if !self.open.is_empty() {
                self.corner();
            }
            return true;
        }
        false
    }

    fn corner(&mut self) {
        if let Some(corners) = self.open.last_mut() {
            corners.push(self.state.position.as_vec3());
        }
    }

    fn node(&mut self, symbol: u8) {
        let state = &mut self.state;
        if state.axis == PENDING {
            state.axis = self.next_axis;
            self.next_axis += 1;
            // The order of the node it begins at; at the origin stems stand side by side.
            state.order = match state.node {
                0 => 0,
                _ => state.order.saturating_add(1),
            };
        }
        let out = &mut self.out;
        out.position.push(state.position.as_vec3());
        out.parent.push(state.node);
        out.axis.push(state.axis);
        out.order.push(state.order);
        out.symbol.push(symbol);
        if self.has_width {
            out.width_m.push(state.width);
        }
        state.node = (out.position.len() - 1) as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::super::derive::{Inputs, derive};
    use super::*;
    use crate::seed::Seed;
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

    /// [ABOP, §1.5] in words: + turns left, & pitches down, \ rolls left, | turns about.
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

    /// The leaf of [ABOP, Figure 1.25]: a hexagon.
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
}
