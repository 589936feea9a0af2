//! The text of an axiom or a production to modules with their expressions, each with its span.
//!
//! ```text
//! production := [modules `<`] module [`>` modules] [`:` condition] (`->` | `→`) [`(`weight`)`] modules
//! module     := symbol [`(` expression {`,` expression} `)`]
//! ```
//!
//! A symbol is a letter, a digit or a command of the turtle. Brackets are never replaced; in a
//! right context they stand around what begins a side branch. `{` and `}` may stand on either side
//! of a bracket, as in ABOP's leaves.
//!
//! A predecessor's parameters are names (`F(a)`), or multiples of names (`G(0.5a)`), as Table 3 of
//! T15 writes them: the name then stands for the module's parameter over that factor, so that
//! every successor is relative to what it replaces. The contexts' parameters are names too and
//! come first and last among the locals.

use std::ops::Range;

use super::dialect::{self, Dialect};
use super::expr::{self, Code, Cursor, Scope, Shape, Slip, is_name_start};

/// A module as written.
#[derive(Debug, Clone)]
pub struct Module {
    pub symbol: char,
    pub span: Range<usize>,
    pub args: Vec<Code>,
}

/// A module of a predecessor or context: formal parameters, each with the factor it is written
/// with.
#[derive(Debug, Clone)]
pub struct Pattern {
    pub symbol: char,
    pub span: Range<usize>,
    pub factors: Vec<f64>,
}

/// A production as written.
#[derive(Debug, Clone)]
pub struct Parsed {
    pub left: Vec<Pattern>,
    pub predecessor: Pattern,
    pub right: Vec<Pattern>,
    pub condition: Option<(Code, Range<usize>)>,
    pub weight: Option<(Code, Range<usize>)>,
    pub successor: Vec<Module>,
}

/// Constants in scope; `None` for the values that the tree sets.
pub type Globals = [(String, Option<f64>)];

/// Parses modules up to the end of the text, reporting every mistake it can go on after.
pub fn modules(
    cursor: &mut Cursor<'_>,
    dialect: Dialect,
    scope: Scope<'_>,
    slips: &mut Vec<Slip>,
) -> Vec<Module> {
    let mut out = Vec::new();
    let mut brackets: Vec<usize> = Vec::new();
    let mut braces: Vec<usize> = Vec::new();
    let most = slips.len() + MAX_SLIPS;
    loop {
        cursor.skip_space();
        let span = cursor.here();
        let Some(symbol) = cursor.peek().map(dialect::plain) else { break };
        if slips.len() >= most {
            return out;
        }
        if cursor.is_at_arrow() {
            slips.push(Slip::new(
                span,
                "a second arrow",
                "write each production as a text of its own",
            ));
            break;
        }
        cursor.bump();
        match symbol {
            'ε' => continue,
            '[' => brackets.push(span.start),
            '{' if dialect.command(symbol).is_some() => braces.push(span.start),
            ']' | '}' if dialect.command(symbol).is_some() => {
                let (open, opening) = match symbol {
                    ']' => (&mut brackets, '['),
                    _ => (&mut braces, '{'),
                };
                if open.pop().is_none() {
                    slips.push(Slip::new(
                        span.clone(),
                        format!("`{symbol}` without `{opening}`"),
                        format!("remove it, or open a `{opening}` before it"),
                    ));
                }
            }
            c if is_letter(c) || dialect.command(c).is_some() => {}
            c => {
                let before = cursor.text.get(..span.start).and_then(|t| t.chars().next_back());
                slips.push(stranger(c, before, span, dialect));
                continue;
            }
        }
        let args = match arguments(cursor, scope) {
            Ok(args) => args,
            Err(slip) => {
                slips.push(slip);
                // What follows can't be told apart from the broken expression.
                return out;
            }
        };
        if is_bare(symbol, dialect) && !args.is_empty() {
            slips.push(Slip::new(
                span.start..cursor.at,
                format!("`{symbol}` takes no parameter"),
                "remove the parentheses",
            ));
        }
        out.push(Module { symbol, span: span.start..cursor.at, args });
    }
    for (open, c, close) in [(brackets, '[', ']'), (braces, '{', '}')] {
        for at in open.into_iter().take(MAX_SLIPS) {
            let message = format!("`{c}` without `{close}`");
            let slip = Slip::new(at..at + 1, message, format!("add the `{close}`"));
            slips.push(slip.label("opened here"));
        }
    }
    out
}

/// Mistakes reported of one text.
const MAX_SLIPS: usize = 20;

/// What may be replaced and needs no command's meaning.
fn is_letter(c: char) -> bool {
    c.is_alphabetic() || c.is_ascii_digit()
}

/// Whether a command never carries a parameter.
fn is_bare(symbol: char, dialect: Dialect) -> bool {
    use super::dialect::{Action, Command};
    matches!(
        dialect.command(symbol),
        Some(Command::Fixed(
            Action::Push
                | Action::Pop
                | Action::Open
                | Action::Close
                | Action::Corner
                | Action::Cut
        ))
    )
}

fn stranger(c: char, before: Option<char>, span: Range<usize>, dialect: Dialect) -> Slip {
    let other = match dialect {
        Dialect::Upright => Dialect::Heading,
        Dialect::Heading => Dialect::Upright,
    };
    let mut remedy = format!("use letters and the turtle's commands {}", dialect.commands());
    if other.command(c).is_some() {
        remedy = format!("`turtle = '{}'` knows it; otherwise {remedy}", other.name());
    }
    if c == '.' && before.is_some_and(|b| b.is_ascii_digit()) {
        remedy = "write parameters in parentheses: `F(0.5a)`".into();
    }
    let shown = if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    Slip::new(span, format!("unknown symbol `{shown}`"), remedy).label("no such command")
}

fn arguments(cursor: &mut Cursor<'_>, scope: Scope<'_>) -> Result<Vec<Code>, Slip> {
    let mut args = Vec::new();
    let open = cursor.here();
    if !cursor.take("(") {
        return Ok(args);
    }
    loop {
        args.push(expr::parse(cursor, scope)?);
        cursor.skip_space();
        if cursor.take(",") {
            if args.len() >= MAX_PARAMETERS {
                return Err(Slip::new(
                    cursor.here(),
                    format!("more than {MAX_PARAMETERS} parameters"),
                    "keep what a module carries to fewer values",
                ));
            }
            continue;
        }
        if cursor.take(")") {
            return Ok(args);
        }
        return Err(match cursor.peek() {
            None | Some('[' | ']') => {
                Slip::new(open, "`(` without `)`", "close the parenthesis").label("opened here")
            }
            Some(c @ ('–' | '—')) => Slip::new(
                cursor.here(),
                format!("`{c}` is a dash"),
                "type the keyboard's minus sign, `-`",
            ),
            Some('(') => Slip::new(
                cursor.here(),
                "expected `,` or `)`, found `(`",
                "only functions take parentheses: multiply with `*`",
            ),
            Some(c) => Slip::new(
                cursor.here(),
                format!("expected `,` or `)`, found `{c}`"),
                "separate parameters with commas and close them with `)`",
            ),
        });
    }
}

/// Parameters a module may carry.
pub const MAX_PARAMETERS: usize = 16;
/// Parameters that a production may name before its arrow, with those of its contexts.
pub const MAX_LOCALS: usize = 48;

/// Parses one production.
pub fn production(
    text: &str,
    dialect: Dialect,
    globals: &Globals,
    slips: &mut Vec<Slip>,
) -> Option<Parsed> {
    let mut cursor = Cursor::new(text);
    let head = match head(&mut cursor, dialect) {
        Ok(head) => head,
        Err(slip) => {
            slips.push(slip);
            return None;
        }
    };
    let locals = head.locals.clone();
    let scope = Scope { locals: &locals, globals };
    let (condition, weight) = match guards(&mut cursor, scope) {
        Ok(guards) => guards,
        Err(slip) => {
            slips.push(slip);
            return None;
        }
    };
    cursor.skip_space();
    if cursor.peek().is_none() {
        slips.push(Slip::new(
            0..text.len(),
            "production without a successor",
            "write what replaces the module after `->`; `ε` for nothing",
        ));
        return None;
    }
    let before = slips.len();
    let successor = modules(&mut cursor, dialect, scope, slips);
    let Head { left, predecessor, right, .. } = head;
    (slips.len() == before).then_some(Parsed {
        left,
        predecessor,
        right,
        condition,
        weight,
        successor,
    })
}

struct Head {
    left: Vec<Pattern>,
    predecessor: Pattern,
    right: Vec<Pattern>,
    locals: Vec<String>,
}

fn head(cursor: &mut Cursor<'_>, dialect: Dialect) -> Result<Head, Slip> {
    let mut locals = Vec::new();
    let mut groups: [Vec<Pattern>; 3] = Default::default();
    // 0: before `<`; 1: the predecessor; 2: after `>`.
    let mut group = 0;
    let mut open: Vec<usize> = Vec::new();
    loop {
        cursor.skip_space();
        let span = cursor.here();
        wrong_arrow(cursor)?;
        if cursor.is_at_arrow() || cursor.rest().starts_with(':') {
            break;
        }
        match cursor.peek() {
            Some('<') if group == 0 => {
                cursor.bump();
                if groups[0].is_empty() {
                    return Err(Slip::new(
                        span,
                        "`<` without a left context",
                        "write the symbol it needs to the left of it",
                    ));
                }
                group = 1;
            }
            Some('>') if group < 2 => {
                cursor.bump();
                if group == 0 {
                    groups.swap(0, 1);
                }
                group = 2;
            }
            Some(c @ ('[' | ']')) if group == 2 => {
                cursor.bump();
                if c == '[' {
                    open.push(span.start);
                } else if open.pop().is_none() {
                    return Err(Slip::new(span, "`]` without `[`", "open a `[` before it"));
                }
                groups[2].push(Pattern { symbol: c, span, factors: Vec::new() });
            }
            Some(c) if is_letter(c) || (dialect.command(c).is_some() && !is_bare(c, dialect)) => {
                let pattern = pattern(cursor, &mut locals)?;
                if let Some(list) = groups.get_mut(group) {
                    list.push(pattern);
                }
            }
            Some(c) => {
                return Err(Slip::new(
                    span,
                    format!("`{c}` can't stand before the arrow"),
                    match c {
                        '[' | ']' => {
                            "brackets stay as they are; only a right context may have them"
                        }
                        _ => "write a production as `F(a) -> …`: what is replaced, then what by",
                    },
                ));
            }
            None => {
                return Err(Slip::new(
                    span,
                    "production without an arrow",
                    "write it as `F(a) -> F(a)[^F(0.5a)]`",
                ));
            }
        }
    }
    if let Some(at) = open.pop() {
        let slip = Slip::new(at..at + 1, "`[` without `]`", "add the `]`").label("opened here");
        return Err(slip);
    }
    if group == 0 {
        groups.swap(0, 1);
    }
    let [left, mut middle, right] = groups;
    if group == 2 && right.is_empty() {
        return Err(Slip::new(
            cursor.here(),
            "`>` without a right context",
            "write the symbol it needs to the right of it",
        ));
    }
    if middle.len() > 1 {
        let span = middle.get(1).map_or(0..0, |p| p.span.clone());
        return Err(Slip::new(
            span,
            "a production replaces one module",
            "name the neighbours it needs with `<` and `>`",
        )
        .label("one too many"));
    }
    match middle.pop() {
        Some(predecessor) => Ok(Head { left, predecessor, right, locals }),
        None => Err(Slip::new(
            cursor.here(),
            "production without a predecessor",
            "write the symbol to be replaced before the arrow",
        )),
    }
}

/// What looks like an arrow and is none.
fn wrong_arrow(cursor: &Cursor<'_>) -> Result<(), Slip> {
    const WRONG: [&str; 11] = ["=>", ":=", "-->", "==>", "−>", "–>", "—>", "⇒", "⟶", "⟹", "="];
    match WRONG.iter().find(|w| cursor.rest().starts_with(**w)) {
        Some(w) => Err(Slip::new(
            cursor.at..cursor.at + w.len(),
            format!("`{w}` is not the arrow"),
            "write `->` between what is replaced and what replaces it",
        )),
        None => Ok(()),
    }
}

fn pattern(cursor: &mut Cursor<'_>, locals: &mut Vec<String>) -> Result<Pattern, Slip> {
    let start = cursor.at;
    let symbol = dialect::plain(cursor.bump().unwrap_or('?'));
    let mut factors = Vec::new();
    let open = cursor.here();
    if cursor.take("(") {
        loop {
            cursor.skip_space();
            let at = cursor.at;
            let (name, factor) = parameter(cursor)?;
            if locals.contains(&name) {
                if !(cursor.text.contains("->") || cursor.text.contains('→')) {
                    return Err(Slip::new(
                        cursor.here(),
                        "production without an arrow",
                        "write it as `F(a) -> F(a)[^F(0.5a)]`",
                    ));
                }
                return Err(Slip::new(
                    at..cursor.at,
                    format!("`{name}` names two parameters"),
                    "give each parameter a name of its own",
                ));
            }
            if locals.len() >= MAX_LOCALS {
                return Err(Slip::new(
                    at..cursor.at,
                    format!("more than {MAX_LOCALS} parameters before the arrow"),
                    "name fewer symbols of the context, or give them fewer values",
                ));
            }
            locals.push(name);
            factors.push(factor);
            cursor.skip_space();
            if cursor.take(")") {
                break;
            }
            if factors.len() >= MAX_PARAMETERS {
                return Err(Slip::new(
                    at..cursor.at,
                    format!("more than {MAX_PARAMETERS} parameters"),
                    "keep what a module carries to fewer values",
                ));
            }
            if !cursor.take(",") {
                return Err(match cursor.peek() {
                    Some(c) if !cursor.is_at_arrow() => Slip::new(
                        cursor.here(),
                        format!("expected `,` or `)`, found `{c}`"),
                        "before the arrow a parameter is a name, or a number times a name",
                    ),
                    _ => Slip::new(open, "`(` without `)`", "close the parenthesis")
                        .label("opened here"),
                });
            }
        }
    }
    Ok(Pattern { symbol, span: start..cursor.at, factors })
}

/// A formal parameter: a name, or a number times a name.
fn parameter(cursor: &mut Cursor<'_>) -> Result<(String, f64), Slip> {
    let start = cursor.at;
    let wrong = |span| {
        Slip::new(
            span,
            "a parameter before the arrow must be a name",
            "write a name, or a number times a name: `F(a)`, `G(0.5a)`; compare values after `:`",
        )
    };
    let mut factor = 1.0;
    if cursor.peek().is_some_and(|c| c.is_ascii_digit() || c == '.') {
        let digits = cursor.rest();
        let width = digits.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(digits.len());
        cursor.at += width;
        factor = digits.get(..width).and_then(|t| t.parse().ok()).unwrap_or(0.0);
        if !(factor > 0.0 && f64::is_finite(factor)) {
            return Err(wrong(start..cursor.at));
        }
        cursor.skip_space();
        if cursor.take("*") {
            cursor.skip_space();
        }
    }
    let name_start = cursor.at;
    if !cursor.peek().is_some_and(is_name_start) {
        return Err(wrong(start..cursor.here().end));
    }
    while cursor.peek().is_some_and(expr::is_name_part) {
        cursor.bump();
    }
    let name = cursor.text.get(name_start..cursor.at).unwrap_or("");
    if expr::FUNCTIONS.iter().any(|(f, _)| *f == name) {
        return Err(Slip::new(
            name_start..cursor.at,
            format!("`{name}` is a function"),
            "give the parameter another name",
        ));
    }
    Ok((name.to_owned(), factor))
}

type Guard = Option<(Code, Range<usize>)>;

/// The condition and the weight around the arrow.
fn guards(cursor: &mut Cursor<'_>, scope: Scope<'_>) -> Result<(Guard, Guard), Slip> {
    let mut condition = None;
    if cursor.take(":") {
        cursor.skip_space();
        let start = cursor.at;
        // ABOP writes `*` for "always".
        if !cursor.take("*") {
            let code = expr::parse(cursor, scope)?;
            condition = Some((code, start..cursor.at));
        }
        cursor.skip_space();
    }
    wrong_arrow(cursor)?;
    if !(cursor.take("->") || cursor.take("→")) {
        return Err(match cursor.peek() {
            Some(c) => Slip::new(
                cursor.here(),
                format!("expected `->`, found `{c}`"),
                "end the condition with `->` and the successor",
            ),
            None => Slip::new(
                cursor.here(),
                "production without an arrow",
                "write it as `F(a) -> F(a)[^F(0.5a)]`",
            ),
        });
    }
    cursor.skip_space();
    let open = cursor.here();
    if !cursor.take("(") {
        return Ok((condition, None));
    }
    let start = cursor.at;
    let code = expr::parse(cursor, scope)?;
    let span = start..cursor.at;
    cursor.skip_space();
    if !cursor.take(")") {
        return Err(Slip::new(open, "`(` without `)`", "close the weight").label("opened here"));
    }
    if matches!(code.shape(&values(scope.globals)), Shape::Constant(w) if w < 0.0 || w.is_nan()) {
        return Err(Slip::new(span, "a weight below 0", "give a weight of 0 or more"));
    }
    Ok((condition, Some((code, span))))
}

/// The constants' values as written; NaN for those that the tree sets.
pub fn values(globals: &Globals) -> Vec<f64> {
    globals.iter().map(|(_, value)| value.unwrap_or(f64::NAN)).collect()
}
