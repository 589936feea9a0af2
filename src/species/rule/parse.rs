//! The text of an axiom or a production to modules with their expressions, each with its span.
//!
//! ```text
//! production := [modules `<`] module [`>` modules] [`:` condition] (`->` | `→`) [`(`weight`)`] modules
//! module     := symbol [`(` expression {`,` expression} `)`]
//! ```
//!
//! A predecessor's parameters are names (`F(a)`), or multiples of names (`G(0.5a)`), as Table 3 of
//! T15 writes them: the name then stands for the module's parameter over that factor, so that
//! every successor is relative to what it replaces. The contexts' parameters are names too and
//! come first and last among the locals.

use std::ops::Range;

use super::dialect::Dialect;
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

/// Constants in scope; the first is `a`.
pub type Globals = [(String, Option<f64>)];

/// Parses modules up to the end of the text, reporting every mistake it can go on after.
pub fn modules(
    cursor: &mut Cursor<'_>,
    dialect: Dialect,
    scope: Scope<'_>,
    slips: &mut Vec<Slip>,
) -> Vec<Module> {
    let mut out = Vec::new();
    let mut open: Vec<(char, usize)> = Vec::new();
    loop {
        cursor.skip_space();
        let span = cursor.here();
        let Some(symbol) = cursor.peek() else { break };
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
            '[' | '{' if dialect.command(symbol).is_some() => open.push((symbol, span.start)),
            ']' | '}' if dialect.command(symbol).is_some() => {
                let opening = if symbol == ']' { '[' } else { '{' };
                match open.last() {
                    Some((c, _)) if *c == opening => {
                        open.pop();
                    }
                    Some((c, at)) => {
                        slips.push(
                            Slip::new(
                                span.clone(),
                                format!("`{symbol}` closes `{c}`"),
                                format!("close the `{c}` at column {} first", at + 1),
                            )
                            .label("does not match"),
                        );
                        open.pop();
                    }
                    None => slips.push(Slip::new(
                        span.clone(),
                        format!("`{symbol}` without `{opening}`"),
                        format!("remove it, or open a `{opening}` before it"),
                    )),
                }
            }
            c if c.is_alphabetic() || dialect.command(c).is_some() => {}
            c => {
                slips.push(
                    Slip::new(
                        span.clone(),
                        format!("unknown symbol `{c}`"),
                        format!("use letters and the turtle's commands {}", dialect.commands()),
                    )
                    .label("no such command"),
                );
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
        if matches!(symbol, '[' | ']' | '{' | '}' | '.') && !args.is_empty() {
            slips.push(Slip::new(
                span.start..cursor.at,
                format!("`{symbol}` takes no parameter"),
                "remove the parentheses",
            ));
        }
        out.push(Module { symbol, span: span.start..cursor.at, args });
    }
    for (c, at) in open {
        let close = if c == '[' { ']' } else { '}' };
        slips.push(
            Slip::new(at..at + 1, format!("`{c}` without `{close}`"), format!("add the `{close}`"))
                .label("opened here"),
        );
    }
    out
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

/// Parses one production.
pub fn production(
    text: &str,
    dialect: Dialect,
    globals: &Globals,
    slips: &mut Vec<Slip>,
) -> Option<Parsed> {
    let mut cursor = Cursor::new(text);
    let head = match head(&mut cursor) {
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

fn head(cursor: &mut Cursor<'_>) -> Result<Head, Slip> {
    let mut locals = Vec::new();
    let mut groups: [Vec<Pattern>; 3] = Default::default();
    // 0: before `<`; 1: the predecessor; 2: after `>`.
    let mut group = 0;
    loop {
        cursor.skip_space();
        let span = cursor.here();
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
            Some(c) if c.is_alphabetic() => {
                let pattern = pattern(cursor, &mut locals)?;
                if let Some(list) = groups.get_mut(group) {
                    list.push(pattern);
                }
            }
            Some(c) => {
                return Err(Slip::new(
                    span,
                    format!("`{c}` can't stand before the arrow"),
                    "write a production as `F(a) -> …`: a letter is replaced, commands stay",
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

fn pattern(cursor: &mut Cursor<'_>, locals: &mut Vec<String>) -> Result<Pattern, Slip> {
    let start = cursor.at;
    let symbol = cursor.bump().unwrap_or('?');
    let mut factors = Vec::new();
    let open = cursor.here();
    if cursor.take("(") {
        loop {
            cursor.skip_space();
            let at = cursor.at;
            let (name, factor) = parameter(cursor)?;
            if locals.contains(&name) {
                return Err(Slip::new(
                    at..cursor.at,
                    format!("`{name}` names two parameters"),
                    "give each parameter a name of its own",
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

/// The constants' values as written, `a` being 1.
pub fn values(globals: &Globals) -> Vec<f64> {
    globals.iter().map(|(_, value)| value.unwrap_or(1.0)).collect()
}
