//! Derivation of an L-system (ABOP, §1.10 parametric, §1.7 stochastic, §1.8 context-sensitive;
//! T15, Table 3): every module of the string is replaced at once, iteration by iteration.
//!
//! The string is two flat columns: a byte a module, and the parameters of those modules that have
//! any, one after another (so a module of rule 13 takes 3 bytes on average, and never more than
//! 9 with one parameter). Two strings take turns as source and target. A successor whose
//! parameters are all multiples of the predecessor's only one is a copy of bytes and a multiply;
//! anything else runs the compiled expressions. Where no chance and no condition is involved, the
//! length of the next string is known before it is made, and memory is taken once.
//!
//! Limits: the string stops at a stated number of modules with an error that names the production.
//! Contexts look past ignored symbols and past side branches, along the path from the root (left)
//! and along the axis (right); each `[…]` of a right context must match the beginning of the next
//! side branch.

use crate::diagnostic::{Error, Result};
use crate::seed::Seed;
use crate::species::rule::expr::{self, Code, Shape};
use crate::species::rule::parse::MAX_LOCALS;
use crate::species::rule::{Action, Production, Rule, Template};

/// Modules at which a derivation stops unless told otherwise: about 1 GB.
pub const MODULE_LIMIT: usize = 100_000_000;

/// What a derivation may vary from the rule file.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Length of the first shoot, metres; the rule's `a` where `None`.
    pub first_shoot_m: Option<f64>,
    /// Other values for constants of the rule, by name.
    pub constants: Vec<(String, f64)>,
    /// The rule's own number where `None`.
    pub iterations: Option<u32>,
    pub seed: Seed,
    pub module_limit: usize,
}

impl Inputs {
    /// The rule as its file has it.
    pub fn new(seed: Seed) -> Self {
        Inputs {
            first_shoot_m: None,
            constants: Vec::new(),
            iterations: None,
            seed,
            module_limit: MODULE_LIMIT,
        }
    }
}

/// A derived string: modules in order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModuleString {
    /// Ids of [`Rule::symbols`].
    pub symbols: Vec<u8>,
    /// The parameters of the modules in order; a symbol tells how many its modules have.
    pub parameters: Vec<f64>,
    /// The first shoot's length it was derived with, metres.
    pub first_shoot_m: f64,
}

/// Measures of a derived string.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Stats {
    /// Every symbol: letters, commands and both brackets.
    pub modules: usize,
    /// Modules that draw.
    pub draws: usize,
    /// Bracket pairs.
    pub brackets: usize,
    /// Sum of the lengths drawn, metres.
    pub length: f64,
    /// Turtle nodes: one a draw, and the origin.
    pub nodes: usize,
}

/// How one symbol's modules are rewritten.
enum Plan {
    /// Stays, with this many parameters.
    Keep(usize),
    /// One production, always, its parameters multiples of the only one (or constants).
    Copy { production: usize, symbols: Vec<u8>, factors: Vec<f64> },
    /// Everything else: productions in order.
    General(Vec<usize>),
}

struct Engine<'a> {
    rule: &'a Rule,
    constants: Vec<f64>,
    plans: Vec<Plan>,
    has_context: bool,
    has_cut: bool,
    limit: usize,
    seed: Seed,
}

/// Derives the rule's string.
///
/// # Errors
/// An unknown constant, a string past the module limit (the production that made it is named), a
/// parameter that is not finite.
pub fn derive(rule: &Rule, inputs: &Inputs) -> Result<ModuleString> {
    let engine = Engine::new(rule, inputs)?;
    let first_shoot_m = engine.constants.first().copied().unwrap_or(1.0);
    let mut now = ModuleString { first_shoot_m, ..ModuleString::default() };
    engine.axiom(&mut now)?;
    let mut next = ModuleString { first_shoot_m, ..ModuleString::default() };
    for iteration in 0..inputs.iterations.unwrap_or(rule.iterations) {
        if !engine.step(&now, &mut next, iteration)? {
            break;
        }
        std::mem::swap(&mut now, &mut next);
    }
    if now.parameters.iter().any(|p| !p.is_finite()) {
        return Err(Error::new("a parameter of the derived string is not finite")
            .remedy("lower `iterations`, or the factors of the productions"));
    }
    Ok(now)
}

impl<'a> Engine<'a> {
    fn new(rule: &'a Rule, inputs: &Inputs) -> Result<Self> {
        let mut constants: Vec<f64> = rule.constants.iter().map(|(_, value)| *value).collect();
        if let (Some(a), Some(slot)) = (inputs.first_shoot_m, constants.first_mut()) {
            if !(a.is_finite() && a > 0.0) {
                return Err(Error::new(format!("the first shoot's length is {a} m"))
                    .remedy("give a length above 0"));
            }
            *slot = a;
        }
        for (name, value) in &inputs.constants {
            let slot = rule.constants.iter().position(|(n, _)| n == name);
            match slot.and_then(|i| constants.get_mut(i)) {
                Some(slot) => *slot = *value,
                None => {
                    return Err(Error::new(format!("the rule has no constant `{name}`"))
                        .remedy("add it under `[rule.constants]`"));
                }
            }
        }
        let plans = (0..rule.symbols.len()).map(|id| plan(rule, id as u8, &constants)).collect();
        let has_context =
            rule.productions.iter().any(|p| !p.left.is_empty() || !p.right.is_empty());
        Ok(Engine {
            rule,
            constants,
            plans,
            has_context,
            has_cut: rule.symbols.iter().any(|s| s.action == Action::Cut),
            limit: inputs.module_limit.min(u32::MAX as usize - 1),
            seed: inputs.seed,
        })
    }

    fn axiom(&self, out: &mut ModuleString) -> Result<()> {
        let Template { symbols, arguments } = &self.rule.axiom;
        out.symbols.extend_from_slice(symbols);
        for code in arguments {
            let value = code.value(&[], &self.constants);
            if !value.is_finite() {
                return Err(Error::new("a parameter of the axiom is not finite")
                    .remedy("check the constants it uses"));
            }
            out.parameters.push(value);
        }
        self.cut(out);
        Ok(())
    }

    /// Carries out every `%`: the rest of its branch goes, up to the `]` that ends it (ABOP,
    /// App. C). A `}` stays whose polygon was begun before.
    fn cut(&self, string: &mut ModuleString) {
        if !self.has_cut {
            return;
        }
        let ModuleString { symbols, parameters, .. } = string;
        let (mut kept, mut kept_parameters, mut parameter) = (0, 0, 0);
        // Brackets and polygons opened since the cut.
        let mut cutting: Option<(usize, usize)> = None;
        for i in 0..symbols.len() {
            let id = symbols[i];
            let Some(symbol) = self.rule.symbol(id) else { continue };
            let own = parameter..parameter + usize::from(symbol.parameters);
            parameter = own.end;
            match (&mut cutting, symbol.action) {
                (None, Action::Cut) => {
                    cutting = Some((0, 0));
                    continue;
                }
                (None, _) => {}
                (Some((0, _)), Action::Pop) => cutting = None,
                (Some((_, 0)), Action::Close) => {}
                (Some((brackets, polygons)), action) => {
                    match action {
                        Action::Push => *brackets += 1,
                        Action::Pop => *brackets -= 1,
                        Action::Open => *polygons += 1,
                        Action::Close => *polygons -= 1,
                        _ => {}
                    }
                    continue;
                }
            }
            symbols[kept] = id;
            kept += 1;
            let count = own.len();
            parameters.copy_within(own, kept_parameters);
            kept_parameters += count;
        }
        symbols.truncate(kept);
        parameters.truncate(kept_parameters);
    }

    /// One iteration; false where nothing was left to replace.
    fn step(&self, now: &ModuleString, next: &mut ModuleString, iteration: u32) -> Result<bool> {
        next.symbols.clear();
        next.parameters.clear();
        if !self.reserve(now, next, iteration)? {
            return Ok(false);
        }
        let neighbours = self.has_context.then(|| Neighbours::new(self.rule, now));
        let chance = self.seed.derive("production", u64::from(iteration));
        // Modules without parameters that stay are copied in runs.
        let mut run = 0;
        let mut parameter = 0;
        for (at, &id) in now.symbols.iter().enumerate() {
            let Some(plan) = self.plans.get(usize::from(id)) else { continue };
            match plan {
                Plan::Keep(0) => continue,
                Plan::Keep(count) => {
                    let own = now.parameters.get(parameter..parameter + count).unwrap_or(&[]);
                    next.parameters.extend_from_slice(own);
                    parameter += count;
                    continue;
                }
                _ => {}
            }
            next.symbols.extend_from_slice(now.symbols.get(run..at).unwrap_or(&[]));
            run = at + 1;
            match plan {
                Plan::Keep(_) => {}
                Plan::Copy { symbols, factors, .. } => {
                    let scale = now.parameters.get(parameter).copied().unwrap_or(0.0);
                    parameter += 1;
                    next.symbols.extend_from_slice(symbols);
                    next.parameters.extend(factors.iter().map(|f| f * scale));
                }
                Plan::General(list) => {
                    let count = self.rule.symbols.get(usize::from(id)).map_or(0, |s| s.parameters);
                    let count = usize::from(count);
                    let own = now.parameters.get(parameter..parameter + count).unwrap_or(&[]);
                    parameter += count;
                    let place = Place { at, own, neighbours: neighbours.as_ref(), string: now };
                    match self.choose(list, &place, chance)? {
                        Some((production, locals)) => self.replace(production, &locals, next)?,
                        None => {
                            next.symbols.push(id);
                            next.parameters.extend_from_slice(own);
                        }
                    }
                    if next.symbols.len() > self.limit {
                        return Err(self.too_long(list.first().copied(), iteration));
                    }
                }
            }
        }
        next.symbols.extend_from_slice(now.symbols.get(run..).unwrap_or(&[]));
        if next.symbols.len() > self.limit {
            return Err(self.too_long(None, iteration));
        }
        self.cut(next);
        Ok(true)
    }

    /// Takes the memory the next string needs, as far as that is certain, and refuses one past the
    /// limit. False where no module will be replaced.
    fn reserve(&self, now: &ModuleString, next: &mut ModuleString, iteration: u32) -> Result<bool> {
        let mut counts = [0usize; 256];
        for &id in &now.symbols {
            counts[usize::from(id)] += 1;
        }
        let (mut symbols, mut parameters, mut is_rewriting) = (0usize, 0usize, false);
        let mut greatest = (0usize, None);
        for (plan, &count) in self.plans.iter().zip(&counts) {
            let (s, p) = match plan {
                Plan::Keep(own) => (1, *own),
                Plan::Copy { symbols, factors, production } => {
                    let made = count.saturating_mul(symbols.len());
                    if made > greatest.0 {
                        greatest = (made, Some(*production));
                    }
                    (symbols.len(), factors.len())
                }
                // Unknown; at least nothing.
                Plan::General(_) => (0, 0),
            };
            is_rewriting |= count > 0 && !matches!(plan, Plan::Keep(_));
            symbols = symbols.saturating_add(count.saturating_mul(s));
            parameters = parameters.saturating_add(count.saturating_mul(p));
        }
        if symbols > self.limit {
            return Err(self.too_long(greatest.1, iteration));
        }
        next.symbols.reserve_exact(symbols);
        next.parameters.reserve_exact(parameters);
        Ok(is_rewriting)
    }

    fn too_long(&self, production: Option<usize>, iteration: u32) -> Error {
        let blame = match production.and_then(|i| self.rule.productions.get(i)) {
            Some(p) => format!(", most of them from `{}`", p.text),
            None => String::new(),
        };
        Error::new(format!(
            "iteration {} makes more than {} modules{blame}",
            iteration + 1,
            self.limit
        ))
        .remedy("lower `iterations`, or end the growth with a condition such as `: a > 0.05`")
    }

    /// The production that applies, with the values of its parameters.
    fn choose(
        &self,
        list: &[usize],
        place: &Place<'_>,
        chance: Seed,
    ) -> Result<Option<(&'a Production, Locals)>> {
        let mut weighted: Vec<(f64, &Production, Locals)> = Vec::new();
        for production in list.iter().filter_map(|&i| self.rule.productions.get(i)) {
            let Some(locals) = place.locals(self.rule, production) else { continue };
            let holds = match &production.condition {
                Some(code) => expr::holds(code.value(locals.values(), &self.constants)),
                None => true,
            };
            if !holds {
                continue;
            }
            match &production.weight {
                None => return Ok(Some((production, locals))),
                Some(code) => {
                    let weight = code.value(locals.values(), &self.constants);
                    if !(weight.is_finite() && weight >= 0.0) {
                        return Err(Error::new(format!(
                            "the weight of `{}` became {weight}",
                            production.text
                        ))
                        .remedy("keep weights at 0 or above"));
                    }
                    weighted.push((weight, production, locals));
                }
            }
        }
        let total: f64 = weighted.iter().map(|(w, _, _)| w).sum();
        if weighted.is_empty() || total <= 0.0 {
            return Ok(None);
        }
        let draw = f64::from(chance.derive("module", place.at as u64).draws().unit());
        let mut left = draw * total;
        let last = weighted.len() - 1;
        for (i, (weight, production, locals)) in weighted.into_iter().enumerate() {
            if left < weight || i == last {
                return Ok(Some((production, locals)));
            }
            left -= weight;
        }
        Ok(None)
    }

    fn replace(
        &self,
        production: &Production,
        locals: &Locals,
        next: &mut ModuleString,
    ) -> Result<()> {
        next.symbols.extend_from_slice(&production.successor.symbols);
        for code in &production.successor.arguments {
            let value = code.value(locals.values(), &self.constants);
            if !value.is_finite() {
                return Err(Error::new(format!(
                    "a parameter became {value} in `{}`",
                    production.text
                ))
                .remedy("keep divisors, logarithms and powers in range with a condition"));
            }
            next.parameters.push(value);
        }
        Ok(())
    }
}

fn plan(rule: &Rule, id: u8, constants: &[f64]) -> Plan {
    let list: Vec<usize> = rule
        .productions
        .iter()
        .enumerate()
        .filter(|(_, p)| p.predecessor == id)
        .map(|(i, _)| i)
        .collect();
    let parameters = rule.symbol(id).map_or(0, |s| usize::from(s.parameters));
    let Some(&first) = list.first() else { return Plan::Keep(parameters) };
    match rule.productions.get(first) {
        Some(p)
            if p.condition.is_none()
                && p.weight.is_none()
                && p.left.is_empty()
                && p.right.is_empty()
                && parameters == 1 =>
        {
            let inverse = p.inverse_factors.first().copied().unwrap_or(1.0);
            let factor = |code: &Code| match code.shape(constants) {
                Shape::Scaled { local: 0, factor } => Some(factor * inverse),
                _ => None,
            };
            let factors: Option<Vec<f64>> = p.successor.arguments.iter().map(factor).collect();
            match factors {
                Some(factors) => {
                    Plan::Copy { production: first, symbols: p.successor.symbols.clone(), factors }
                }
                None => Plan::General(list),
            }
        }
        _ => Plan::General(list),
    }
}

/// Parameters of contexts and predecessor at one place.
struct Locals {
    values: [f64; MAX_LOCALS],
    count: usize,
}

impl Locals {
    fn values(&self) -> &[f64] {
        self.values.get(..self.count).unwrap_or(&[])
    }

    fn extend(&mut self, more: &[f64]) {
        for &x in more {
            if let Some(slot) = self.values.get_mut(self.count) {
                *slot = x;
                self.count += 1;
            }
        }
    }
}

/// One module to be replaced.
struct Place<'a> {
    at: usize,
    own: &'a [f64],
    neighbours: Option<&'a Neighbours>,
    string: &'a ModuleString,
}

impl Place<'_> {
    /// The values of the production's parameters, `None` where its contexts do not match.
    fn locals(&self, rule: &Rule, production: &Production) -> Option<Locals> {
        let mut locals = Locals { values: [f64::NAN; MAX_LOCALS], count: 0 };
        if !production.left.is_empty() {
            let neighbours = self.neighbours?;
            let mut path = Vec::with_capacity(production.left.len());
            let mut at = self.at;
            for &symbol in production.left.iter().rev() {
                at = neighbours.before.get(at).copied()? as usize;
                if *self.string.symbols.get(at)? != symbol {
                    return None;
                }
                path.push(at);
            }
            for &at in path.iter().rev() {
                locals.extend(neighbours.parameters(rule, self.string, at));
            }
        }
        locals.extend(self.own);
        let mut at = self.at;
        // Where the branches end that the context has gone into.
        let mut ends = Vec::new();
        for &symbol in &production.right {
            let neighbours = self.neighbours?;
            match rule.symbol(symbol)?.action {
                Action::Push => {
                    at = neighbours.branch(rule, self.string, at)?;
                    ends.push(neighbours.end.get(at).copied()? as usize);
                }
                Action::Pop => at = ends.pop()?,
                _ => {
                    at = neighbours.after.get(at).copied()? as usize;
                    if *self.string.symbols.get(at)? != symbol {
                        return None;
                    }
                    locals.extend(neighbours.parameters(rule, self.string, at));
                }
            }
        }
        for (value, inverse) in locals.values.iter_mut().zip(&production.inverse_factors) {
            *value *= inverse;
        }
        Some(locals)
    }
}

const NONE: u32 = u32::MAX;

/// For each module, what stands before it on the path from the root and after it on its axis.
struct Neighbours {
    before: Vec<u32>,
    after: Vec<u32>,
    /// For each `[`, its `]`.
    end: Vec<u32>,
    /// Where a module's parameters begin.
    start: Vec<u32>,
}

impl Neighbours {
    fn new(rule: &Rule, string: &ModuleString) -> Self {
        let count = string.symbols.len();
        let action = |id: u8| rule.symbol(id).map_or(Action::Nothing, |s| s.action);
        let is_ignored = |id: u8| rule.is_ignored.get(usize::from(id)).copied().unwrap_or_default();
        let mut start = Vec::with_capacity(count);
        let mut before = Vec::with_capacity(count);
        let (mut parameter, mut last, mut stack) = (0u32, NONE, Vec::new());
        for (i, &id) in string.symbols.iter().enumerate() {
            start.push(parameter);
            parameter += rule.symbol(id).map_or(0, |s| u32::from(s.parameters));
            before.push(last);
            match action(id) {
                Action::Push => stack.push(last),
                Action::Pop => last = stack.pop().unwrap_or(NONE),
                _ if is_ignored(id) => {}
                _ => last = i as u32,
            }
        }
        let (mut after, mut end) = (vec![NONE; count], vec![NONE; count]);
        let (mut next, mut stack) = (NONE, Vec::new());
        for (i, &id) in string.symbols.iter().enumerate().rev() {
            if let Some(slot) = after.get_mut(i) {
                *slot = next;
            }
            match action(id) {
                Action::Pop => {
                    stack.push((next, i as u32));
                    next = NONE;
                }
                Action::Push => {
                    let (outer, close) = stack.pop().unwrap_or((NONE, NONE));
                    next = outer;
                    if let Some(slot) = end.get_mut(i) {
                        *slot = close;
                    }
                }
                _ if is_ignored(id) => {}
                _ => next = i as u32,
            }
        }
        Neighbours { before, after, end, start }
    }

    /// The `[` that follows `at` with nothing but ignored symbols between.
    fn branch(&self, rule: &Rule, string: &ModuleString, at: usize) -> Option<usize> {
        let following = string.symbols.iter().enumerate().skip(at + 1);
        for (i, &id) in following {
            if rule.symbol(id)?.action == Action::Push {
                return Some(i);
            }
            if !rule.is_ignored.get(usize::from(id)).copied().unwrap_or_default() {
                return None;
            }
        }
        None
    }

    fn parameters<'s>(&self, rule: &Rule, string: &'s ModuleString, at: usize) -> &'s [f64] {
        let count =
            string.symbols.get(at).and_then(|&id| rule.symbol(id)).map_or(0, |s| s.parameters);
        let start = self.start.get(at).map_or(0, |&s| s as usize);
        string.parameters.get(start..start + usize::from(count)).unwrap_or(&[])
    }
}

impl ModuleString {
    /// Counts and sums, in one pass. `rule` must be the one it was derived from.
    pub fn stats(&self, rule: &Rule) -> Stats {
        let (mut draws, mut brackets, mut length, mut parameter) = (0, 0, 0.0f64, 0usize);
        for &id in &self.symbols {
            let Some(symbol) = rule.symbol(id) else { continue };
            match symbol.action {
                Action::Draw => {
                    draws += 1;
                    length += match symbol.parameters {
                        0 => self.first_shoot_m,
                        _ => self.parameters.get(parameter).copied().unwrap_or(0.0).max(0.0),
                    };
                }
                Action::Push => brackets += 1,
                _ => {}
            }
            parameter += usize::from(symbol.parameters);
        }
        Stats { modules: self.symbols.len(), draws, brackets, length, nodes: draws + 1 }
    }

    /// The string as text, parameters with up to six decimals.
    pub fn to_text(&self, rule: &Rule) -> String {
        let mut text = String::with_capacity(self.symbols.len() * 2);
        let mut parameters = self.parameters.iter();
        for symbol in self.symbols.iter().filter_map(|&id| rule.symbol(id)) {
            text.push(symbol.name);
            for i in 0..symbol.parameters {
                text.push(if i == 0 { '(' } else { ',' });
                let value = parameters.next().copied().unwrap_or(0.0);
                text.push_str(&format!("{}", (value * 1e6).round() / 1e6));
            }
            if symbol.parameters > 0 {
                text.push(')');
            }
        }
        text
    }
}

#[cfg(test)]
mod tests;
