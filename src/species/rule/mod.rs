//! L-system rules (T15, Tables 2 and 3; ABOP) as compiled from the `[rule]` section of a rule
//! file: symbols as bytes, successors as templates, expressions as short stack programs.
//!
//! G = (V, T, S, ω, P). A production `F(a) -> F(a)[^F(0.5a)]` replaces every F by its successor,
//! all modules of a string at once; a module that no production matches stays. Where several
//! productions match, the first without a weight is taken, and otherwise one by chance in
//! proportion to the weights. A parameter of a successor is an expression in those of the
//! predecessor; `G(0.5a) -> …` binds a to twice G's parameter, so that each shoot is relative to
//! the shoot it replaces. In a production without parameters, and in the axiom, `a` is the length
//! of the first shoot.

mod compile;
pub mod dialect;
pub mod expr;
pub mod parse;
mod text;

pub use compile::{Section, compile};
pub use dialect::{Action, Axis, Dialect};
use expr::Code;

/// The constant that every rule has: the first shoot's length, metres.
pub const FIRST_SHOOT: &str = "a";

/// The constants that tell the tree that grows: its height and crown diameter in metres, its age
/// in years. Their values in a [`Rule`] are those of the species' typical tree.
pub const OF_TREE: [&str; 3] = ["height", "crown", "age"];

/// A symbol of the alphabet with the number of parameters it carries.
#[derive(Debug, Clone, PartialEq)]
pub struct Symbol {
    pub name: char,
    pub parameters: u8,
    pub action: Action,
}

/// Modules with expressions for their parameters: an axiom or a successor.
#[derive(Debug, Clone, PartialEq)]
pub struct Template {
    /// Indices into [`Rule::symbols`].
    pub symbols: Vec<u8>,
    /// The parameters of all modules, one after another.
    pub arguments: Vec<Code>,
}

/// One production.
#[derive(Debug, Clone, PartialEq)]
pub struct Production {
    /// As written.
    pub text: String,
    pub predecessor: u8,
    /// The symbol on the path before the module, nearest last, as written.
    pub left: Vec<u8>,
    /// What follows the module on its axis, nearest first; `[`, `]` around what begins a side
    /// branch.
    pub right: Vec<u8>,
    /// One a local (left context, predecessor, right context, in order): what a module's
    /// parameter is multiplied by to give the local's value.
    pub inverse_factors: Vec<f64>,
    pub condition: Option<Code>,
    pub weight: Option<Code>,
    pub successor: Template,
}

/// Bending of shoots in the turtle (ABOP, §2.1): after each segment with heading H the frame turns
/// towards the pull T by e·|H × T| radians, never past it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tropism {
    /// T: east, north, up. Its length counts.
    #[schemars(inner(range(min = -Tropism::MOST, max = Tropism::MOST)))]
    pub pull: [f64; 3],
    /// e; 0 is stiff, below 0 turns away.
    #[schemars(range(min = -Tropism::MOST, max = Tropism::MOST))]
    pub elasticity: f64,
}

impl Tropism {
    pub const NONE: Tropism = Tropism { pull: [0.0; 3], elasticity: 0.0 };
    /// Bound of every number of it.
    pub const MOST: f64 = 10.0;
}

/// A compiled rule.
#[derive(Debug, Clone, PartialEq)]
pub struct Rule {
    pub dialect: Dialect,
    pub iterations: u32,
    pub tropism: Tropism,
    pub symbols: Vec<Symbol>,
    pub axiom: Template,
    pub productions: Vec<Production>,
    /// Names and values of the constants: [`FIRST_SHOOT`], those of [`OF_TREE`], the file's own.
    pub constants: Vec<(String, f64)>,
    /// One a symbol: contexts look past it.
    pub is_ignored: Vec<bool>,
}

impl Rule {
    /// The first shoot's length as the file gives it, metres.
    pub fn first_shoot_m(&self) -> f64 {
        self.constants.first().map_or(1.0, |(_, value)| *value)
    }

    /// The symbol of a byte of a module string.
    pub fn symbol(&self, id: u8) -> Option<&Symbol> {
        self.symbols.get(usize::from(id))
    }
}
