//! Arithmetic of rule files: parameters, conditions and weights, parsed to a short stack program.
//!
//! Grammar, loosest first: `||`, `&&`, comparisons (`< <= > >= == !=`; `=` is `==`), `+ −`, `* /`,
//! sign and `!`, a number before a name or parenthesis (`0.5a`, so `1/2a` is `1/(2a)`), `^`.
//! Functions: [`FUNCTIONS`]; sines and cosines take degrees, as every angle of a rule file.
//! Truth is 1, falsehood 0; anything but 0 is true.

use std::ops::Range;

use crate::species::near::{nearest, suggest};

/// Values on the stack of one expression.
const STACK: usize = 24;
/// Nested parentheses and operators waiting for their right side.
const DEPTH: usize = 32;

/// A mistake inside a production, in bytes of its text.
#[derive(Debug, Clone, PartialEq)]
pub struct Slip {
    pub span: Range<usize>,
    pub message: String,
    pub label: String,
    pub remedy: String,
}

impl Slip {
    pub fn new(span: Range<usize>, message: impl Into<String>, remedy: impl Into<String>) -> Self {
        Slip { span, message: message.into(), label: "here".into(), remedy: remedy.into() }
    }

    pub fn label(mut self, label: &str) -> Self {
        self.label = label.into();
        self
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Op {
    Number(f64),
    /// Parameter of the predecessor (context included).
    Local(u8),
    /// Constant of the rule file, or `a`.
    Global(u16),
    One(One),
    Two(Two),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum One {
    Negate,
    Not,
    Sqrt,
    Sin,
    Cos,
    Tan,
    Exp,
    Ln,
    Abs,
    Floor,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Two {
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    Min,
    Max,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    Equal,
    NotEqual,
    And,
    Or,
}

/// Names of the functions, with the number of their arguments.
pub const FUNCTIONS: [(&str, usize); 10] = [
    ("min", 2),
    ("max", 2),
    ("sqrt", 1),
    ("sin", 1),
    ("cos", 1),
    ("tan", 1),
    ("exp", 1),
    ("ln", 1),
    ("abs", 1),
    ("floor", 1),
];

impl One {
    fn named(name: &str) -> Option<One> {
        Some(match name {
            "sqrt" => One::Sqrt,
            "sin" => One::Sin,
            "cos" => One::Cos,
            "tan" => One::Tan,
            "exp" => One::Exp,
            "ln" => One::Ln,
            "abs" => One::Abs,
            "floor" => One::Floor,
            _ => return None,
        })
    }

    fn of(self, x: f64) -> f64 {
        match self {
            One::Negate => -x,
            One::Not => f64::from(!holds(x)),
            One::Sqrt => x.sqrt(),
            One::Sin => x.to_radians().sin(),
            One::Cos => x.to_radians().cos(),
            One::Tan => x.to_radians().tan(),
            One::Exp => x.exp(),
            One::Ln => x.ln(),
            One::Abs => x.abs(),
            One::Floor => x.floor(),
        }
    }
}

/// Whether a condition of this value holds: one that is not a number does not.
pub fn holds(value: f64) -> bool {
    !(value == 0.0 || value.is_nan())
}

impl Two {
    fn of(self, x: f64, y: f64) -> f64 {
        match self {
            Two::Add => x + y,
            Two::Subtract => x - y,
            Two::Multiply => x * y,
            Two::Divide => x / y,
            Two::Power => x.powf(y),
            Two::Min => x.min(y),
            Two::Max => x.max(y),
            Two::Less => f64::from(x < y),
            Two::LessOrEqual => f64::from(x <= y),
            Two::Greater => f64::from(x > y),
            Two::GreaterOrEqual => f64::from(x >= y),
            Two::Equal => f64::from(x == y),
            Two::NotEqual => f64::from(x != y),
            Two::And => f64::from(holds(x) && holds(y)),
            Two::Or => f64::from(holds(x) || holds(y)),
        }
    }

    /// Strength of binding; left-associative but for `^`.
    fn strength(self) -> u8 {
        match self {
            Two::Or => 1,
            Two::And => 2,
            Two::Less
            | Two::LessOrEqual
            | Two::Greater
            | Two::GreaterOrEqual
            | Two::Equal
            | Two::NotEqual => 3,
            Two::Add | Two::Subtract => 4,
            Two::Multiply | Two::Divide => 5,
            Two::Power => IMPLICIT + 1,
            Two::Min | Two::Max => u8::MAX,
        }
    }
}

const SIGN: u8 = 6;
const IMPLICIT: u8 = 7;

/// A stack program for one value; it needs at most `STACK` places.
#[derive(Debug, Clone, PartialEq)]
pub struct Code {
    ops: Vec<Op>,
}

/// What an expression amounts to once the constants are known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    Constant(f64),
    /// `factor` times one parameter.
    Scaled {
        local: u8,
        factor: f64,
    },
    Other,
}

impl Code {
    /// The value with these parameters and constants; NaN for a name out of range.
    pub fn value(&self, locals: &[f64], globals: &[f64]) -> f64 {
        let mut stack = [0.0f64; STACK];
        let mut top = 0usize;
        for op in &self.ops {
            let value = match *op {
                Op::Number(x) => x,
                Op::Local(i) => locals.get(usize::from(i)).copied().unwrap_or(f64::NAN),
                Op::Global(i) => globals.get(usize::from(i)).copied().unwrap_or(f64::NAN),
                Op::One(f) => {
                    top = top.saturating_sub(1);
                    f.of(stack[top])
                }
                Op::Two(f) => {
                    top = top.saturating_sub(2);
                    f.of(stack[top], stack[top + 1])
                }
            };
            // The parser has refused anything deeper.
            if top + 1 >= STACK {
                return f64::NAN;
            }
            stack[top] = value;
            top += 1;
        }
        stack[0]
    }

    /// Whether this is a constant or a multiple of one parameter, given the constants; NaN stands
    /// for one not known yet.
    pub fn shape(&self, globals: &[f64]) -> Shape {
        let mut stack: Vec<Shape> = Vec::with_capacity(STACK);
        for op in &self.ops {
            let shape = match *op {
                Op::Number(x) => Shape::Constant(x),
                Op::Local(local) => Shape::Scaled { local, factor: 1.0 },
                Op::Global(i) => match globals.get(usize::from(i)) {
                    Some(x) if !x.is_nan() => Shape::Constant(*x),
                    _ => Shape::Other,
                },
                Op::One(f) => match (f, stack.pop()) {
                    (_, Some(Shape::Constant(x))) => Shape::Constant(f.of(x)),
                    (One::Negate, Some(Shape::Scaled { local, factor })) => {
                        Shape::Scaled { local, factor: -factor }
                    }
                    _ => Shape::Other,
                },
                Op::Two(f) => {
                    let right = stack.pop();
                    match (f, stack.pop(), right) {
                        (_, Some(Shape::Constant(x)), Some(Shape::Constant(y))) => {
                            Shape::Constant(f.of(x, y))
                        }
                        (
                            Two::Multiply,
                            Some(Shape::Constant(x)),
                            Some(Shape::Scaled { local, factor }),
                        )
                        | (
                            Two::Multiply,
                            Some(Shape::Scaled { local, factor }),
                            Some(Shape::Constant(x)),
                        ) => Shape::Scaled { local, factor: factor * x },
                        (
                            Two::Divide,
                            Some(Shape::Scaled { local, factor }),
                            Some(Shape::Constant(x)),
                        ) => Shape::Scaled { local, factor: factor / x },
                        _ => Shape::Other,
                    }
                }
            };
            stack.push(shape);
        }
        stack.pop().unwrap_or(Shape::Other)
    }

    /// Calls `mark` with each constant the expression reads.
    pub fn globals(&self, mut mark: impl FnMut(usize)) {
        for op in &self.ops {
            if let Op::Global(i) = op {
                mark(usize::from(*i));
            }
        }
    }

    fn height(&self) -> usize {
        let (mut now, mut most) = (0usize, 0usize);
        for op in &self.ops {
            match op {
                Op::Number(_) | Op::Local(_) | Op::Global(_) => now += 1,
                Op::One(_) => {}
                Op::Two(_) => now = now.saturating_sub(1),
            }
            most = most.max(now);
        }
        most
    }
}

/// A position in a text, moved forward only.
#[derive(Debug, Clone)]
pub struct Cursor<'a> {
    pub text: &'a str,
    pub at: usize,
}

impl<'a> Cursor<'a> {
    pub fn new(text: &'a str) -> Self {
        Cursor { text, at: 0 }
    }

    pub fn rest(&self) -> &'a str {
        self.text.get(self.at..).unwrap_or("")
    }

    pub fn peek(&self) -> Option<char> {
        self.rest().chars().next()
    }

    pub fn bump(&mut self) -> Option<char> {
        let c = self.peek()?;
        self.at += c.len_utf8();
        Some(c)
    }

    pub fn skip_space(&mut self) {
        while self.peek().is_some_and(char::is_whitespace) {
            self.bump();
        }
    }

    pub fn take(&mut self, word: &str) -> bool {
        let taken = self.rest().starts_with(word);
        if taken {
            self.at += word.len();
        }
        taken
    }

    /// The bytes of the next character, empty at the end.
    pub fn here(&self) -> Range<usize> {
        self.at..self.at + self.peek().map_or(0, char::len_utf8)
    }

    pub fn is_at_arrow(&self) -> bool {
        self.rest().starts_with("->") || self.rest().starts_with('→')
    }
}

/// The names an expression may use, and the values of those that are constant.
#[derive(Debug, Clone, Copy)]
pub struct Scope<'a> {
    /// Parameters of the predecessor, in order; they hide constants of the same name.
    pub locals: &'a [String],
    /// Constants in order; `None` for a value that the tree sets.
    pub globals: &'a [(String, Option<f64>)],
}

/// Parses an expression that starts at the cursor and leaves the cursor behind it.
pub fn parse(cursor: &mut Cursor<'_>, scope: Scope<'_>) -> Result<Code, Slip> {
    let start = cursor.at;
    let mut parser = Parser { cursor, scope, ops: Vec::new(), depth: 0 };
    parser.binary(0)?;
    let code = Code { ops: parser.ops };
    if code.height() >= STACK {
        return Err(too_deep(start..cursor.at));
    }
    Ok(code)
}

fn too_deep(span: Range<usize>) -> Slip {
    Slip::new(span, "expression nested too deeply", "name a part of it under `[rule.constants]`")
}

struct Parser<'c, 'a, 's> {
    cursor: &'c mut Cursor<'a>,
    scope: Scope<'s>,
    ops: Vec<Op>,
    depth: usize,
}

impl Parser<'_, '_, '_> {
    fn operator(&mut self) -> Option<(Two, usize)> {
        self.cursor.skip_space();
        if self.cursor.is_at_arrow() || self.cursor.rest().starts_with("=>") {
            return None;
        }
        let table = [
            ("||", Two::Or),
            ("&&", Two::And),
            ("<=", Two::LessOrEqual),
            (">=", Two::GreaterOrEqual),
            ("==", Two::Equal),
            ("!=", Two::NotEqual),
            ("<", Two::Less),
            (">", Two::Greater),
            ("=", Two::Equal),
            ("|", Two::Or),
            ("&", Two::And),
            ("+", Two::Add),
            ("-", Two::Subtract),
            ("−", Two::Subtract),
            ("*", Two::Multiply),
            ("·", Two::Multiply),
            ("×", Two::Multiply),
            ("/", Two::Divide),
            ("^", Two::Power),
        ];
        table
            .iter()
            .find(|(word, _)| self.cursor.rest().starts_with(word))
            .map(|(word, two)| (*two, word.len()))
    }

    /// An operand and every operator after it that binds at least as strongly as `least`. The
    /// value comes back where it depends on nothing but constants.
    fn binary(&mut self, least: u8) -> Result<Option<f64>, Slip> {
        self.depth += 1;
        if self.depth > DEPTH {
            return Err(too_deep(self.cursor.here()));
        }
        let mut left = self.operand()?;
        while let Some((two, width)) = self.operator() {
            if two.strength() < least {
                break;
            }
            let operator = self.cursor.at..self.cursor.at + width;
            self.cursor.at += width;
            let right_start = self.cursor.at;
            let next = if two == Two::Power { two.strength() } else { two.strength() + 1 };
            let right = self.binary(next)?;
            if two == Two::Divide && right == Some(0.0) {
                return Err(Slip::new(
                    right_start..self.cursor.at,
                    "division by zero",
                    "divide by something that is not 0",
                )
                .label("this is 0"));
            }
            self.ops.push(Op::Two(two));
            left = match (left, right) {
                (Some(x), Some(y)) => Some(self.finite(two.of(x, y), operator)?),
                _ => None,
            };
        }
        self.depth -= 1;
        Ok(left)
    }

    fn finite(&self, value: f64, span: Range<usize>) -> Result<f64, Slip> {
        if value.is_finite() {
            return Ok(value);
        }
        Err(Slip::new(span, "this has no finite value", "check the numbers on both sides"))
    }

    fn operand(&mut self) -> Result<Option<f64>, Slip> {
        self.cursor.skip_space();
        let start = self.cursor.at;
        match self.cursor.peek() {
            Some('-' | '−' | '+') if !self.cursor.is_at_arrow() => {
                let negative = self.cursor.bump() != Some('+');
                let value = self.binary(SIGN)?;
                if negative {
                    self.ops.push(Op::One(One::Negate));
                }
                Ok(value.map(|x| if negative { -x } else { x }))
            }
            Some('!') => {
                self.cursor.bump();
                let value = self.binary(SIGN)?;
                self.ops.push(Op::One(One::Not));
                Ok(value.map(|x| One::Not.of(x)))
            }
            Some('(') => self.group(),
            Some(c) if c.is_ascii_digit() || c == '.' => {
                let number = self.number()?;
                self.ops.push(Op::Number(number));
                let next = self.cursor.peek();
                if next.is_some_and(|c| c == '(' || is_name_start(c)) {
                    let value = self.binary(IMPLICIT)?;
                    self.ops.push(Op::Two(Two::Multiply));
                    return Ok(value.map(|x| x * number));
                }
                Ok(Some(number))
            }
            Some(c) if is_name_start(c) => self.name(),
            found => {
                let what = match found {
                    Some(c) => format!("expected a value, found `{c}`"),
                    None => "expected a value, found the end".into(),
                };
                Err(Slip::new(
                    start..self.cursor.here().end,
                    what,
                    "write a number, a parameter, a constant or a function, for example `0.5a`",
                ))
            }
        }
    }

    fn group(&mut self) -> Result<Option<f64>, Slip> {
        let open = self.cursor.here();
        self.cursor.bump();
        let value = self.binary(0)?;
        self.close(open)?;
        Ok(value)
    }

    fn close(&mut self, open: Range<usize>) -> Result<(), Slip> {
        self.cursor.skip_space();
        if self.cursor.take(")") {
            return Ok(());
        }
        Err(Slip::new(open, "`(` without `)`", "close the parenthesis").label("opened here"))
    }

    fn number(&mut self) -> Result<f64, Slip> {
        let start = self.cursor.at;
        let digits = |cursor: &mut Cursor<'_>| {
            while cursor.peek().is_some_and(|c| c.is_ascii_digit()) {
                cursor.bump();
            }
        };
        digits(self.cursor);
        if self.cursor.take(".") {
            digits(self.cursor);
        }
        // `2e3` is a number, `2e` is twice e.
        let mut ahead = self.cursor.clone();
        if ahead.take("e") || ahead.take("E") {
            let _ = ahead.take("-") || ahead.take("+");
            if ahead.peek().is_some_and(|c| c.is_ascii_digit()) {
                digits(&mut ahead);
                self.cursor.at = ahead.at;
            }
        }
        let span = start..self.cursor.at;
        let text = self.cursor.text.get(span.clone()).unwrap_or("");
        match text.parse::<f64>() {
            Ok(x) if x.is_finite() => Ok(x),
            _ => Err(Slip::new(
                span,
                format!("`{text}` is not a number"),
                "write numbers like 2, 0.5 or 1e-3",
            )),
        }
    }

    fn name(&mut self) -> Result<Option<f64>, Slip> {
        let start = self.cursor.at;
        while self.cursor.peek().is_some_and(is_name_part) {
            self.cursor.bump();
        }
        let span = start..self.cursor.at;
        let name = self.cursor.text.get(span.clone()).unwrap_or("");
        if let Some(i) = self.scope.locals.iter().position(|n| n == name) {
            self.ops.push(Op::Local(i.min(255) as u8));
            return Ok(None);
        }
        if let Some(i) = self.scope.globals.iter().position(|(n, _)| n == name) {
            self.ops.push(Op::Global(i.min(usize::from(u16::MAX)) as u16));
            return Ok(self.scope.globals.get(i).and_then(|(_, value)| *value));
        }
        if let Some((_, count)) = FUNCTIONS.iter().find(|(n, _)| *n == name) {
            return self.call(name, *count, span);
        }
        let functions = FUNCTIONS.map(|(n, _)| n);
        if self.cursor.rest().starts_with('(') {
            let message = format!("unknown function `{name}`");
            return Err(Slip::new(span, message, suggest(name, &functions)));
        }
        let mut known: Vec<&str> = self.scope.locals.iter().map(String::as_str).collect();
        let globals = self.scope.globals.iter().map(|(n, _)| n.as_str());
        known.extend(globals.filter(|n| !self.scope.locals.iter().any(|l| l == n)));
        let remedy = match nearest(name, &known) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!(
                "define it under `[rule.constants]`, or use one of {}, or a function: {}",
                known.get(..known.len().min(16)).unwrap_or(&[]).join(", "),
                functions.join(", ")
            ),
        };
        Err(Slip::new(span, format!("unknown name `{name}`"), remedy))
    }

    fn call(&mut self, name: &str, count: usize, span: Range<usize>) -> Result<Option<f64>, Slip> {
        self.cursor.skip_space();
        let open = self.cursor.here();
        if !self.cursor.take("(") {
            return Err(Slip::new(
                span,
                format!("`{name}` is a function"),
                format!("give its arguments in parentheses: `{name}(…)`"),
            ));
        }
        let mut values = Vec::new();
        loop {
            values.push(self.binary(0)?);
            self.cursor.skip_space();
            if !self.cursor.take(",") {
                break;
            }
            // Further arguments pass the stack test only if they are too many.
            if values.len() > 8 {
                break;
            }
        }
        self.close(open)?;
        if values.len() != count {
            let s = if count == 1 { "" } else { "s" };
            return Err(Slip::new(
                span.start..self.cursor.at,
                format!("`{name}` takes {count} argument{s}, {} given", values.len()),
                format!("give {count} argument{s}"),
            ));
        }
        let value = match (One::named(name), values.as_slice()) {
            (Some(one), [x]) => {
                self.ops.push(Op::One(one));
                x.map(|x| one.of(x))
            }
            (_, [x, y]) => {
                let two = if name == "min" { Two::Min } else { Two::Max };
                self.ops.push(Op::Two(two));
                x.zip(*y).map(|(x, y)| two.of(x, y))
            }
            _ => None,
        };
        match value {
            Some(value) => Ok(Some(self.finite(value, span.start..self.cursor.at)?)),
            None => Ok(None),
        }
    }
}

pub fn is_name_start(c: char) -> bool {
    c.is_alphabetic() || c == '_'
}

pub fn is_name_part(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

#[cfg(test)]
mod tests;
