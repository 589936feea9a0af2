//! The turtle: a derived string to a scaffold of nodes.
//!
//! Frame [H L U] and its turns R_U, R_L, R_H as printed in T15 and ABOP, §1.5: the new frame is
//! [H L U]·R. The upright dialect grows along U, which begins upwards (H east, L north), so that
//! & ^ \ / lean a shoot to four different sides. The heading dialect grows along H, which begins
//! upwards, L to the west.
//!
//! The frame is a unit quaternion in f64, drawn back to unit length at every turn, so that it
//! stays orthonormal however long the string. Brackets use a stack on the heap: nesting is limited
//! by memory alone. Most brackets of a tree are its last shoots, `[^F]`: one turn and one shoot.
//! Those are drawn from the frame they spring from, which is neither copied nor turned.
//!
//! With tropism each drawn segment bends the frame after it (ABOP, §2.1), by at most the way that is
//! left to the pull, so that no elasticity makes a shoot swing about it.
//!
//! A shoot of length ≤ 0 is not grown: no node, no move. `f` moves without drawing; the next
//! segment then spans the gap. The decay of lengths with distance from the apex is left to the
//! growth stage, which knows the axes.

use glam::{DMat3, DQuat, DVec3, Vec3};

use super::NO_PARENT;
use super::derive::ModuleString;
use crate::diagnostic::{Error, Result};
use crate::species::rule::{Action, Axis, Dialect, Rule, Symbol, Tropism};

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
        if self.polygon_node.iter().any(|&node| node as usize >= n) {
            return Err("a polygon hangs from no node".into());
        }
        if !self.polygon.iter().all(|p| p.is_finite()) {
            return Err("a polygon is not finite".into());
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

    /// A direction of the frame in world terms.
    fn world(&self, v: DVec3) -> DVec3 {
        let axis = DVec3::new(self.rotation.x, self.rotation.y, self.rotation.z);
        let t = 2.0 * axis.cross(v);
        v + self.rotation.w * t + axis.cross(t)
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

    /// Rolls about H until L lies level (ABOP, p. 57): L = V×H/|V×H|, U = H×L, V upwards. Stays
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
    /// A turn by a fixed angle, and where it takes the direction of growth.
    Turn(DQuat, DVec3),
    /// A shoot of the first shoot's length.
    First,
    /// A shoot of the length its one parameter gives.
    Shoot,
    Push,
    Pop,
    Else(Action, usize),
}

impl Step {
    fn new(symbol: &Symbol, dialect: Dialect) -> Step {
        match (symbol.action, usize::from(symbol.parameters)) {
            (Action::Turn { axis, angle }, 0) => {
                let turn = quaternion(axis, angle);
                Step::Turn(turn, Pose { rotation: turn }.growth(dialect))
            }
            (Action::Draw, 0) => Step::First,
            (Action::Draw, 1) => Step::Shoot,
            (Action::Push, 0) => Step::Push,
            (Action::Pop, 0) => Step::Pop,
            (action, parameters) => Step::Else(action, parameters),
        }
    }
}

/// Runs the turtle over a derived string. `rule` must be the one it was derived from.
///
/// # Errors
/// A position that is not finite, or brackets that do not match.
pub fn draw(rule: &Rule, string: &ModuleString) -> Result<Scaffold> {
    // A step for every byte, so that none is out of range.
    let mut steps = [Step::Else(Action::Nothing, 0); 256];
    for (step, symbol) in steps.iter_mut().zip(&rule.symbols) {
        *step = Step::new(symbol, rule.dialect);
    }
    let draws = steps.map(|s| match s {
        Step::First | Step::Shoot => 1,
        Step::Else(action, _) => usize::from(action.draws()),
        _ => 0,
    });
    let nodes = string.symbols.iter().map(|&id| draws[usize::from(id)]).sum::<usize>() + 1;
    let mut turtle = Turtle::new(rule, nodes);
    let mut parameters = string.parameters.as_slice();
    let mut symbols = string.symbols.as_slice();
    while let [id, rest @ ..] = symbols {
        let id = *id;
        symbols = rest;
        match steps[usize::from(id)] {
            Step::Turn(turn, _) => turtle.state.pose.apply(turn),
            Step::First => turtle.shoot(id, string.first_shoot_m),
            Step::Shoot => turtle.shoot(id, next(&mut parameters, 1).unwrap_or(0.0)),
            Step::Push => {
                if let [turn, shoot, pop, beyond @ ..] = rest
                    && let Step::Turn(_, growth) = steps[usize::from(*turn)]
                    && let drawn @ (Step::First | Step::Shoot) = steps[usize::from(*shoot)]
                    && let Step::Pop = steps[usize::from(*pop)]
                    && turtle.open.is_empty()
                {
                    let length_m = match drawn {
                        Step::First => string.first_shoot_m,
                        _ => next(&mut parameters, 1).unwrap_or(0.0),
                    };
                    turtle.side_shoot(*shoot, growth, length_m);
                    symbols = beyond;
                } else {
                    turtle.stack.push(turtle.state);
                    turtle.state.axis = PENDING;
                }
            }
            Step::Pop => match turtle.stack.pop() {
                Some(state) => turtle.state = state,
                None => {
                    return Err(Error::new("the derived string closes a bracket too many")
                        .remedy("balance the brackets of every production"));
                }
            },
            Step::Else(action, count) => {
                turtle.act(id, action, next(&mut parameters, count), string.first_shoot_m);
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

/// The first of the next `count` parameters, which are taken.
fn next(parameters: &mut &[f64], count: usize) -> Option<f64> {
    let (own, rest) = parameters.split_at_checked(count)?;
    *parameters = rest;
    own.first().copied()
}

struct Turtle {
    dialect: Dialect,
    state: State,
    stack: Vec<State>,
    /// Corners of polygons that are open, innermost last.
    open: Vec<Vec<Vec3>>,
    next_axis: u32,
    has_width: bool,
    tropism: Tropism,
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
            tropism: rule.tropism,
            max_reach: 0.0,
            out,
        }
    }

    fn act(&mut self, id: u8, action: Action, own: Option<f64>, first_shoot_m: f64) {
        match action {
            // Brackets take no parameters, and are steps of their own; a cut is the derivation's.
            Action::Nothing | Action::Push | Action::Pop | Action::Cut => {}
            Action::Draw => self.shoot(id, own.unwrap_or(first_shoot_m)),
            Action::Edge | Action::Move => {
                let has_moved = self.advance(own.unwrap_or(first_shoot_m));
                match (action, self.open.is_empty()) {
                    (Action::Edge, true) if has_moved => self.drawn(id),
                    (Action::Move, false) if has_moved => self.corner(),
                    _ => {}
                }
            }
            Action::Turn { axis, angle } => {
                let angle = own.map_or(angle, |degrees| angle * degrees.to_radians());
                self.state.pose.turn(axis, angle);
            }
            Action::Level => self.state.pose.level(),
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
            Action::Leaf => self.leaf(own.unwrap_or(first_shoot_m)),
        }
    }

    /// Moves and draws; inside a polygon a shoot is an edge of it.
    fn shoot(&mut self, id: u8, length_m: f64) {
        if self.advance(length_m) {
            match self.open.is_empty() {
                true => self.drawn(id),
                false => self.corner(),
            }
        }
    }

    /// A node where the turtle has come to.
    fn drawn(&mut self, id: u8) {
        if self.state.axis == PENDING {
            self.state.axis = self.next_axis;
            self.state.order = self.next_order();
            self.next_axis += 1;
        }
        let State { position, axis, order, .. } = self.state;
        self.node(position, axis, order, id);
        self.state.node = (self.out.position.len() - 1) as u32;
        if self.tropism.elasticity != 0.0 {
            self.bend();
        }
    }

    /// A bracket with one turn, which takes growth to `growth` of the frame, and one shoot.
    fn side_shoot(&mut self, id: u8, growth: DVec3, length_m: f64) {
        if length_m > 0.0 {
            let position = self.state.position + self.state.pose.world(growth) * length_m;
            self.max_reach = self.max_reach.max(position.abs().max_element());
            let (axis, order) = (self.next_axis, self.next_order());
            self.next_axis += 1;
            self.node(position, axis, order, id);
        }
    }

    /// The order of an axis that begins here: one more than the node's; at the origin stems stand
    /// side by side.
    fn next_order(&self) -> u16 {
        match self.state.node {
            0 => 0,
            _ => self.state.order.saturating_add(1),
        }
    }

    /// Bends the frame towards the pull, as a segment that has been drawn does.
    fn bend(&mut self) {
        let ahead = self.state.pose.growth(self.dialect);
        let pull = DVec3::from_array(self.tropism.pull);
        let across = ahead.cross(pull);
        let Some(axis) = across.try_normalize() else { return };
        let rest = across.length().atan2(ahead.dot(pull));
        let turn =
            (self.tropism.elasticity * across.length()).clamp(rest - std::f64::consts::PI, rest);
        self.state.pose.rotation =
            (DQuat::from_axis_angle(axis, turn) * self.state.pose.rotation).normalize();
    }

    /// Moves along the axis of growth; false for a length ≤ 0.
    fn advance(&mut self, length_m: f64) -> bool {
        if length_m > 0.0 {
            self.state.position += self.state.pose.growth(self.dialect) * length_m;
            self.max_reach = self.max_reach.max(self.state.position.abs().max_element());
            return true;
        }
        false
    }

    fn leaf(&mut self, length_m: f64) {
        if length_m > 0.0 {
            let frame = self.state.pose.frame();
            let (base, along) = (self.state.position, frame.x_axis * length_m);
            let (middle, aside) = (base + 0.5 * along, frame.y_axis * (0.25 * length_m));
            let corners = [base, middle + aside, base + along, middle - aside];
            let reach = corners[2].abs().max_element();
            self.max_reach = self.max_reach.max(reach).max(length_m);
            self.out.polygon.extend(corners.map(|c| c.as_vec3()));
            self.out.polygon_end.push(self.out.polygon.len() as u32);
            self.out.polygon_node.push(self.state.node);
        }
    }

    fn corner(&mut self) {
        if let Some(corners) = self.open.last_mut() {
            corners.push(self.state.position.as_vec3());
        }
    }

    /// A node on the last one.
    fn node(&mut self, position: DVec3, axis: u32, order: u16, symbol: u8) {
        let out = &mut self.out;
        out.position.push(position.as_vec3());
        out.parent.push(self.state.node);
        out.axis.push(axis);
        out.order.push(order);
        out.symbol.push(symbol);
        if self.has_width {
            out.width_m.push(self.state.width);
        }
    }
}

#[cfg(test)]
mod tests;
