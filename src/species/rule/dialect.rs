//! What the turtle makes of a symbol, in the two dialects a rule file may choose.
//!
//! `upright` is Table 2 of T15: growth along U, angles α, β, γ. `heading` is the turtle of
//! ABOP, ch. 1: growth along H, one angle δ. There the printed matrices and the words beside
//! them disagree: R_U(δ) turns H away from L, and + is to turn left. The words are followed (+ to
//! the left, & down, \ rolls left), which is R transposed; the upright dialect keeps the matrices.

use schemars::JsonSchema;
use serde::Deserialize;

/// The turtle that reads a rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Dialect {
    /// Grows along U; angles alpha, beta, gamma (T15).
    Upright,
    /// Grows along H; one angle delta (ABOP).
    Heading,
}

/// A symbol as it is known: a typographic minus is a minus.
pub fn plain(symbol: char) -> char {
    if symbol == '−' { '-' } else { symbol }
}

/// An axis of the turtle's own frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    H,
    L,
    U,
}

/// What the turtle does at a module. Lengths in metres, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Stands for growth to come; nothing is drawn.
    Nothing,
    /// Moves by the first parameter, or by `a` without one, and draws a segment.
    Draw,
    /// As [`Action::Draw`], but inside a polygon its end is no corner.
    Edge,
    /// Moves likewise and draws nothing.
    Move,
    /// Turns about an axis of the frame by `angle`; with a parameter, by that many degrees with
    /// the sign of `angle`.
    Turn {
        axis: Axis,
        angle: f64,
    },
    /// Rolls about H until L lies level (ABOP, p. 57).
    Level,
    Push,
    Pop,
    /// Begins a polygon.
    Open,
    /// Adds the position to the polygon.
    Corner,
    /// Ends a polygon.
    Close,
    /// Sets the line width to the parameter, in metres; without one, multiplies it by 0.7.
    Width,
    /// A leaf as a polygon: a diamond along H in the plane of H and L, as long as the parameter
    /// (`a` without one) and half as wide.
    Leaf,
    /// Removes the rest of its branch from the string, itself included; the turtle never sees it.
    Cut,
}

impl Action {
    /// Whether the module makes a segment of wood.
    pub fn draws(self) -> bool {
        matches!(self, Action::Draw | Action::Edge)
    }
}

/// Where the angle of a turning symbol comes from, with its sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    Turn { axis: Axis, sign: f64, greek: &'static str },
    Fixed(Action),
}

impl Dialect {
    /// The command a character stands for, `None` for a letter or an unknown character.
    pub fn command(self, symbol: char) -> Option<Command> {
        use Axis::{H, L, U};
        let turn = |axis, sign, greek| Some(Command::Turn { axis, sign, greek });
        match (self, plain(symbol)) {
            (_, '[') => Some(Command::Fixed(Action::Push)),
            (_, ']') => Some(Command::Fixed(Action::Pop)),
            (Dialect::Upright, '&') => turn(L, 1.0, "alpha"),
            (Dialect::Upright, '^') => turn(L, -1.0, "alpha"),
            (Dialect::Upright, '\\') => turn(H, 1.0, "alpha"),
            (Dialect::Upright, '/') => turn(H, -1.0, "alpha"),
            (Dialect::Upright, '*') => turn(L, 1.0, "beta"),
            (Dialect::Upright, '%') => turn(L, -1.0, "beta"),
            (Dialect::Upright, '~') => turn(H, 1.0, "beta"),
            (Dialect::Upright, '?') => turn(H, -1.0, "beta"),
            (Dialect::Upright, '$') => turn(L, 1.0, "gamma"),
            (Dialect::Upright, '@') => turn(L, -1.0, "gamma"),
            (Dialect::Upright, '!') => turn(H, 1.0, "gamma"),
            (Dialect::Upright, '#') => turn(H, -1.0, "gamma"),
            (Dialect::Heading, '+') => turn(U, -1.0, "delta"),
            (Dialect::Heading, '-') => turn(U, 1.0, "delta"),
            (Dialect::Heading, '&') => turn(L, -1.0, "delta"),
            (Dialect::Heading, '^') => turn(L, 1.0, "delta"),
            (Dialect::Heading, '\\') => turn(H, -1.0, "delta"),
            (Dialect::Heading, '/') => turn(H, 1.0, "delta"),
            (Dialect::Heading, '|') => {
                Some(Command::Fixed(Action::Turn { axis: U, angle: std::f64::consts::PI }))
            }
            (Dialect::Heading, '$') => Some(Command::Fixed(Action::Level)),
            (Dialect::Heading, '!') => Some(Command::Fixed(Action::Width)),
            (Dialect::Heading, '\'') => Some(Command::Fixed(Action::Nothing)),
            (Dialect::Heading, '{') => Some(Command::Fixed(Action::Open)),
            (Dialect::Heading, '.') => Some(Command::Fixed(Action::Corner)),
            (Dialect::Heading, '}') => Some(Command::Fixed(Action::Close)),
            (Dialect::Heading, '~') => Some(Command::Fixed(Action::Leaf)),
            (Dialect::Heading, '%') => Some(Command::Fixed(Action::Cut)),
            _ => None,
        }
    }

    /// The names that set the angle of several symbols at once.
    pub fn greek(self) -> &'static [&'static str] {
        match self {
            Dialect::Upright => &["alpha", "beta", "gamma"],
            Dialect::Heading => &["delta"],
        }
    }

    /// What a letter does with this many parameters; `also` lists further letters that draw.
    pub fn letter(self, symbol: char, parameters: usize, also: &str) -> Action {
        match (self, symbol) {
            (_, 'F') => Action::Draw,
            (Dialect::Upright, 'A' | 'B' | 'C' | 'D' | 'G' | 'S') if parameters > 0 => Action::Draw,
            (_, _) if also.contains(symbol) => Action::Draw,
            (Dialect::Heading, 'G') => Action::Edge,
            (Dialect::Heading, 'f') => Action::Move,
            _ => Action::Nothing,
        }
    }

    /// As a rule file writes it.
    pub fn name(self) -> &'static str {
        match self {
            Dialect::Upright => "upright",
            Dialect::Heading => "heading",
        }
    }

    /// Every command, for messages.
    pub fn commands(self) -> &'static str {
        match self {
            Dialect::Upright => r"[ ] & ^ \ / * % ~ ? $ @ ! #",
            Dialect::Heading => r"[ ] + - & ^ \ / | $ ! ' { . } ~ %",
        }
    }
}
