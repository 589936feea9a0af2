//! The `[rule]` section of a rule file to a [`Rule`], with every mistake at its place.

use std::collections::BTreeMap;
use std::ops::Range;

use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::dialect::{self, Action, Command, Dialect};
use super::expr::{Cursor, Scope, Shape, Slip, is_name_part, is_name_start};
use super::parse::{self, Module, Parsed, Pattern};
use super::text::Text;
use super::{FIRST_SHOOT, OF_TREE, Production, Rule, Symbol, Template, Tropism};
use crate::diagnostic::Error;
use crate::species::near::nearest;
use crate::species::node::{self, Entry, Node, Place, Sources};

/// Iterations beyond this can't end well: the least growing rule has doubled a million times.
const MAX_ITERATIONS: u32 = 64;
/// Symbols of one alphabet: they are kept as bytes.
const MAX_SYMBOLS: usize = 250;
/// Productions, and constants, of one rule.
const MAX_LINES: usize = 1000;

/// The L-system: how a shoot becomes a shoot with laterals, iteration by iteration.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// The turtle that reads the string.
    turtle: Dialect,
    /// The string to begin with.
    axiom: String,
    /// What each symbol becomes in one iteration, such as `F(a) -> F(a)[^F(0.5a)][&F(0.5a)]`.
    productions: Vec<String>,
    /// How often the productions are applied; a tree needs 2 to 8.
    #[schemars(range(max = MAX_ITERATIONS))]
    iterations: u32,
    /// Length of the first shoot, metres; a grown tree is scaled to its size.
    #[schemars(extend("exclusiveMinimum" = 0))]
    a: f64,
    /// Degrees of the turns, by Greek letter (`alpha = 30`) or by symbol (`'^&' = 30`).
    #[serde(default)]
    #[allow(dead_code)]
    #[schemars(with = "BTreeMap<String, f64>", extend("additionalProperties" = {
        "type": "number", "minimum": -360, "maximum": 360
    }))]
    angles: Option<IgnoredAny>,
    /// Numbers by name, for use in productions.
    #[serde(default)]
    #[allow(dead_code)]
    #[schemars(with = "BTreeMap<String, f64>", extend("examples" = [{ "k": 0.5 }]))]
    constants: Option<IgnoredAny>,
    /// How every shoot of the turtle bends towards a pull, such as gravity.
    tropism: Tropism,
    /// Letters that draw beside the dialect's own.
    draws: String,
    /// Letters that stand for nothing and are meant to.
    markers: String,
    /// Symbols that contexts look past.
    ignore: String,
}

/// Compiles the section; `of_tree`: values of [`OF_TREE`]. `None` where there were errors.
pub fn compile(
    rule: &Node,
    of_tree: [f64; OF_TREE.len()],
    defaults: &Node,
    sources: &Sources,
    errors: &mut Vec<Error>,
) -> Option<Rule> {
    let before = errors.len();
    let section: Section = node::typed(rule, defaults, sources, errors)?;
    let mut compiler = Compiler {
        rule,
        sources,
        dialect: section.turtle,
        draws: section.draws,
        markers: section.markers,
        angles: BTreeMap::new(),
        angle_entries: Vec::new(),
        symbols: Vec::new(),
        arity: BTreeMap::new(),
        constants: Vec::new(),
        angles_missed: Vec::new(),
        errors,
    };
    if section.iterations > MAX_ITERATIONS {
        compiler.error(
            &compiler.key("iterations"),
            format!("`iterations` is {}, more than {MAX_ITERATIONS}", section.iterations),
            "a tree needs 2 to 8",
        );
    }
    if !(section.a.is_finite() && section.a > 0.0) {
        compiler.error(
            &compiler.key("a"),
            "`a` must be above 0".into(),
            "give the first shoot's length in metres",
        );
    }
    if section.productions.len() > MAX_LINES {
        compiler.error(
            &compiler.key("productions"),
            format!("more than {MAX_LINES} productions"),
            "join those that differ in a number only by a parameter",
        );
        return None;
    }
    compiler.check_tropism(&section.tropism);
    compiler.read_angles();
    compiler.read_constants(section.a);
    let productions = compiler.parse_productions(&section.productions);
    let (axiom, axiom_text) = compiler.parse_axiom(&section.axiom);
    if compiler.errors.len() > before {
        return None;
    }
    let mut rule =
        compiler.link(&axiom, &axiom_text, productions, section.iterations, &section.ignore);
    rule.tropism = section.tropism;
    for ((_, slot), value) in rule.constants.iter_mut().skip(1).zip(of_tree) {
        *slot = value;
    }
    (errors.len() == before).then_some(rule)
}

/// The name of a Greek letter that a turtle's angle may have.
fn greek_name(key: &str) -> Option<&'static str> {
    Some(match key.trim() {
        "α" => "alpha",
        "β" => "beta",
        "γ" => "gamma",
        "δ" => "delta",
        _ => return None,
    })
}

/// A production as written and its text.
struct Written<'a> {
    text: Text<'a>,
    parsed: Parsed,
}

struct Angle {
    degrees: f64,
    /// Which line of `angles` it comes from.
    entry: usize,
}

struct Compiler<'a> {
    rule: &'a Node,
    sources: &'a Sources,
    dialect: Dialect,
    draws: String,
    markers: String,
    angles: BTreeMap<char, Angle>,
    /// Place, name and whether it was used, of each line of `angles`.
    angle_entries: Vec<(Place, String, bool)>,
    symbols: Vec<Symbol>,
    /// Parameters of each letter.
    arity: BTreeMap<char, usize>,
    constants: Vec<(String, Option<f64>)>,
    /// Greek letters that were said to have no angle.
    angles_missed: Vec<&'static str>,
    errors: &'a mut Vec<Error>,
}

impl Compiler<'_> {
    fn key(&self, key: &str) -> Place {
        self.rule.get(key).map_or_else(|| self.rule.place.clone(), |n| n.place.clone())
    }

    fn error(&mut self, place: &Place, message: String, remedy: &str) {
        self.errors.push(self.sources.error(place, message, "here").remedy(remedy));
    }

    /// Reports a control character that an escape has made: `"[\f(2)F]"` holds a form feed.
    fn has_escapes(&mut self, text: &Text<'_>) -> bool {
        if let Some((span, c)) = text.escaped_control.clone() {
            let message = format!("this became the control character U+{:04X}", u32::from(c));
            let remedy = r"write the text between single quotes, where `\` stands for itself";
            self.slip(text, Slip::new(span, message, remedy));
        }
        text.escaped_control.is_some()
    }

    fn slip(&mut self, text: &Text<'_>, slip: Slip) {
        let place = text.place(slip.span);
        self.errors.push(self.sources.error(&place, slip.message, &slip.label).remedy(slip.remedy));
    }

    fn check_tropism(&mut self, tropism: &Tropism) {
        let Tropism { pull, elasticity } = *tropism;
        let place = self.key("tropism");
        if pull.iter().any(|x| x.abs() > Tropism::MOST) {
            let message = format!("`pull` is {pull:?}, outside -10 to 10");
            self.error(&place, message, "give a vector east, north, up: `[0, 0, -1]` is gravity");
        }
        if elasticity.abs() > Tropism::MOST {
            let message = format!("`elasticity` is {elasticity}, outside -10 to 10");
            self.error(&place, message, "give about 0.1 to 0.4; below 0 turns away from the pull");
        }
    }

    /// The lines of a table such as `angles`, those of the base first.
    fn lines(&mut self, key: &str) -> Vec<Entry> {
        let Some(table) = self.rule.get(key) else { return Vec::new() };
        if !matches!(table.value, node::Value::Table(_)) {
            let place = table.place.clone();
            self.error(
                &place,
                format!("`{key}` must be a table"),
                &format!("write `{key} = {{ name = 30 }}` or a section `[rule.{key}]`"),
            );
            return Vec::new();
        }
        let mut lines = table.entries().to_vec();
        lines.sort_by_key(|e| std::cmp::Reverse(e.key_place.source));
        lines
    }

    /// The angles: in one file a symbol's own beats that of its Greek letter, and a file beats
    /// what it extends.
    fn read_angles(&mut self) {
        let mut lines = self.lines("angles");
        let dialect = self.dialect;
        lines.sort_by_key(|e| {
            let is_symbol = !e.key.starts_with(|c: char| c.is_alphabetic());
            (std::cmp::Reverse(e.key_place.source), is_symbol)
        });
        for line in lines {
            let degrees = match line.node.as_number() {
                Some(x) if x.is_finite() && x.abs() <= 360.0 => x,
                _ => {
                    self.error(
                        &line.node.place,
                        format!("the angle of `{}` must be a number of degrees", line.key),
                        "give a number from -360 to 360",
                    );
                    continue;
                }
            };
            let entry = self.angle_entries.len();
            let mut set = Vec::new();
            if dialect.greek().contains(&line.key.as_str()) {
                set.extend((0u8..128).map(char::from).filter(|c| {
                    matches!(dialect.command(*c),
                        Some(Command::Turn { greek, .. }) if greek == line.key)
                }));
            } else {
                for c in line.key.chars().filter(|c| !c.is_whitespace()).map(dialect::plain) {
                    match dialect.command(c) {
                        Some(Command::Turn { .. }) => set.push(c),
                        _ => {
                            set.clear();
                            break;
                        }
                    }
                }
            }
            if set.is_empty() {
                let remedy = match (greek_name(&line.key), nearest(&line.key, dialect.greek())) {
                    (Some(name), _) => format!("spell it `{name}`"),
                    (None, Some(near)) => format!("did you mean `{near}`?"),
                    (None, None) => format!(
                        "name {} or turning symbols in quotes, such as '&^'",
                        dialect.greek().join(", ")
                    ),
                };
                self.error(
                    &line.key_place,
                    format!("`{}` is not an angle of this turtle", line.key),
                    &remedy,
                );
                continue;
            }
            // An inherited angle may be of no use here: that is no mistake of this file.
            let is_used = line.key_place.source != 0;
            self.angle_entries.push((line.key_place, line.key, is_used));
            for c in set {
                self.angles.insert(c, Angle { degrees, entry });
            }
        }
    }

    fn read_constants(&mut self, first_shoot: f64) {
        self.constants.push((FIRST_SHOOT.into(), Some(first_shoot)));
        self.constants.extend(OF_TREE.map(|name| (name.to_owned(), None)));
        let lines = self.lines("constants");
        if lines.len() > MAX_LINES {
            let place = self.key("constants");
            self.error(&place, format!("more than {MAX_LINES} constants"), "use fewer");
            return;
        }
        for line in lines {
            let name = line.key.as_str();
            if name == FIRST_SHOOT
                || OF_TREE.contains(&name)
                || !name.starts_with(is_name_start)
                || !name.chars().all(is_name_part)
                || super::expr::FUNCTIONS.iter().any(|(f, _)| *f == name)
            {
                let remedy = if name == FIRST_SHOOT {
                    "`a` is the first shoot's length: set it as `a = …` under `[rule]`"
                } else if OF_TREE.contains(&name) {
                    "`height`, `crown` and `age` are those of the tree that grows: set the typical \
                     ones under `[size]`, or take another name"
                } else {
                    "use letters, digits and `_`, and no function's name"
                };
                self.error(&line.key_place, format!("`{name}` can't name a constant"), remedy);
                continue;
            }
            match line.node.as_number() {
                Some(x) if x.is_finite() => self.constants.push((name.to_owned(), Some(x))),
                _ => self.error(
                    &line.node.place,
                    format!("the constant `{name}` must be a number"),
                    "give a finite number",
                ),
            }
        }
    }

    fn texts(&self, key: &str) -> Vec<Place> {
        match self.rule.get(key).map(|n| &n.value) {
            Some(node::Value::Array(items)) => items.iter().map(|n| n.place.clone()).collect(),
            _ => Vec::new(),
        }
    }

    /// Sets an arity on first sight, and refuses another later.
    fn take_arity(&mut self, text: &Text<'_>, symbol: char, span: &Range<usize>, given: usize) {
        let known = match self.dialect.command(symbol) {
            Some(_) if given <= 1 => return,
            Some(_) => 1,
            None => *self.arity.entry(symbol).or_insert(given),
        };
        if known != given {
            let s = if known == 1 { "" } else { "s" };
            let slip = Slip::new(
                span.clone(),
                format!("`{symbol}` takes {known} parameter{s}, {given} given"),
                match given {
                    2 if known == 1 => "write decimals with a point: `F(0.5a)`".to_owned(),
                    _ => format!("write `{symbol}` everywhere with the same number of parameters"),
                },
            );
            self.slip(text, slip);
        }
    }

    fn parse_productions<'t>(&mut self, texts: &'t [String]) -> Vec<Written<'t>> {
        let places = self.texts("productions");
        let mut written = Vec::new();
        for (text, place) in texts.iter().zip(&places) {
            let text = Text::new(text, place, self.sources);
            if self.has_escapes(&text) {
                continue;
            }
            let mut slips = Vec::new();
            let parsed = parse::production(text.text, self.dialect, &self.constants, &mut slips);
            for slip in slips {
                self.slip(&text, slip);
            }
            if let Some(parsed) = parsed {
                written.push(Written { text, parsed });
            }
        }
        for Written { text, parsed } in &written {
            let patterns = parsed.left.iter().chain([&parsed.predecessor]).chain(&parsed.right);
            for p in patterns {
                self.take_arity(text, p.symbol, &p.span, p.factors.len());
            }
        }
        for Written { text, parsed } in &written {
            for m in &parsed.successor {
                self.take_arity(text, m.symbol, &m.span, m.args.len());
            }
        }
        written
    }

    fn parse_axiom<'t>(&mut self, axiom: &'t str) -> (Vec<Module>, Text<'t>) {
        let place = self.key("axiom");
        let text = Text::new(axiom, &place, self.sources);
        if self.has_escapes(&text) {
            return (Vec::new(), text);
        }
        let scope_constants = self.constants.clone();
        let scope = Scope { locals: &[], globals: &scope_constants };
        let mut slips = Vec::new();
        let before = self.errors.len();
        let modules = parse::modules(&mut Cursor::new(axiom), self.dialect, scope, &mut slips);
        for slip in slips {
            self.slip(&text, slip);
        }
        // With other mistakes about, an axiom that is not there may be one misnamed.
        let is_absent = place.is_nowhere() && !self.errors.is_empty();
        if modules.is_empty() && self.errors.len() == before && !is_absent {
            let section = self.rule.place.clone();
            self.error(
                if place.is_nowhere() { &section } else { &place },
                "the axiom is empty".into(),
                "write what growth begins with, for example `axiom = 'F(a)'`",
            );
        }
        for m in &modules {
            self.take_arity(&text, m.symbol, &m.span, m.args.len());
        }
        (modules, text)
    }

    /// The id of a symbol, made on first sight.
    fn symbol(&mut self, text: &Text<'_>, name: char, span: &Range<usize>, given: usize) -> u8 {
        let found =
            self.symbols.iter().position(|s| s.name == name && usize::from(s.parameters) == given);
        if let Some(i) = found {
            return i as u8;
        }
        if self.symbols.len() >= MAX_SYMBOLS {
            let message = format!("more than {MAX_SYMBOLS} symbols");
            self.slip(text, Slip::new(span.clone(), message, "use fewer letters"));
            return 0;
        }
        let action = match self.dialect.command(name) {
            Some(Command::Fixed(action)) => action,
            Some(Command::Turn { axis, sign, greek }) => {
                let degrees = match self.angles.get(&name) {
                    Some(angle) => {
                        if let Some(entry) = self.angle_entries.get_mut(angle.entry) {
                            entry.2 |= given == 0;
                        }
                        angle.degrees
                    }
                    None if given == 0 && !self.angles_missed.contains(&greek) => {
                        self.angles_missed.push(greek);
                        let slip = Slip::new(
                            span.clone(),
                            format!("`{name}` has no angle"),
                            format!(
                                "set it: `angles = {{ {greek} = 30 }}` or `angles = {{ '{name}' = 30 }}`"
                            ),
                        );
                        self.slip(text, slip);
                        0.0
                    }
                    None => 0.0,
                };
                Action::Turn {
                    axis,
                    angle: if given == 0 { sign * degrees.to_radians() } else { sign },
                }
            }
            None => self.dialect.letter(name, given, &self.draws),
        };
        self.symbols.push(Symbol { name, parameters: given as u8, action });
        (self.symbols.len() - 1) as u8
    }

    fn template(&mut self, text: &Text<'_>, modules: &[Module]) -> Template {
        let mut template = Template { symbols: Vec::new(), arguments: Vec::new() };
        for m in modules {
            let id = self.symbol(text, m.symbol, &m.span, m.args.len());
            template.symbols.push(id);
            template.arguments.extend(m.args.iter().cloned());
        }
        template
    }

    fn context(&mut self, text: &Text<'_>, patterns: &[Pattern]) -> Vec<u8> {
        patterns.iter().map(|p| self.symbol(text, p.symbol, &p.span, p.factors.len())).collect()
    }

    /// Gives symbols their ids and checks what only the whole rule shows.
    fn link(
        &mut self,
        axiom: &[Module],
        axiom_text: &Text<'_>,
        written: Vec<Written<'_>>,
        iterations: u32,
        ignore: &str,
    ) -> Rule {
        let axiom_template = self.template(axiom_text, axiom);
        let mut productions = Vec::new();
        for Written { text, parsed } in &written {
            let p = &parsed.predecessor;
            let factors =
                parsed.left.iter().chain([p]).chain(&parsed.right).flat_map(|p| &p.factors);
            let production = Production {
                text: text.text.trim().to_owned(),
                inverse_factors: factors.map(|f| 1.0 / f).collect(),
                predecessor: self.symbol(text, p.symbol, &p.span, p.factors.len()),
                left: self.context(text, &parsed.left),
                right: self.context(text, &parsed.right),
                condition: parsed.condition.as_ref().map(|(code, _)| code.clone()),
                weight: parsed.weight.as_ref().map(|(code, _)| code.clone()),
                successor: self.template(text, &parsed.successor),
            };
            productions.push(production);
        }
        self.check_meaning(axiom, axiom_text, &written);
        self.check_reach(&axiom_template, &written, &productions);
        self.check_use(&axiom_template, &productions);
        let constants = self.constants.iter().map(|(n, v)| (n.clone(), v.unwrap_or(1.0))).collect();
        let is_ignored = |s: &Symbol| ignore.chars().map(dialect::plain).any(|c| c == s.name);
        Rule {
            dialect: self.dialect,
            iterations,
            tropism: Tropism::NONE,
            is_ignored: self.symbols.iter().map(is_ignored).collect(),
            symbols: std::mem::take(&mut self.symbols),
            axiom: axiom_template,
            productions,
            constants,
        }
    }

    /// Letters that neither draw nor are replaced are slips, unless listed as markers.
    fn check_meaning(&mut self, axiom: &[Module], axiom_text: &Text<'_>, written: &[Written<'_>]) {
        let mut known: Vec<char> = written.iter().map(|w| w.parsed.predecessor.symbol).collect();
        known.extend(self.markers.chars());
        for w in written {
            known.extend(w.parsed.left.iter().chain(&w.parsed.right).map(|p| p.symbol));
        }
        let modules = axiom
            .iter()
            .map(|m| (axiom_text, m))
            .chain(written.iter().flat_map(|w| w.parsed.successor.iter().map(|m| (&w.text, m))));
        let mut names_leaf = false;
        for (text, m) in modules {
            // The letter after `~` names a surface in ABOP.
            if std::mem::replace(&mut names_leaf, self.is_leaf(m.symbol)) {
                known.push(m.symbol);
            }
            let is_letter = self.dialect.command(m.symbol).is_none();
            let action = self.dialect.letter(m.symbol, m.args.len(), &self.draws);
            if is_letter && action == Action::Nothing && !known.contains(&m.symbol) {
                known.push(m.symbol);
                let s = m.symbol;
                let remedy = match s.is_ascii_digit() {
                    true => "write parameters in parentheses: `F(0.5a)`".to_owned(),
                    false => format!(
                        "add a production `{s} -> …`, or `draws = '{s}'`, or `markers = '{s}'` if it is meant to do nothing"
                    ),
                };
                let message =
                    format!("unknown symbol `{s}`: it draws nothing and nothing replaces it");
                let slip = Slip::new(m.span.clone(), message, remedy);
                self.slip(text, slip);
            }
        }
    }

    fn is_leaf(&self, symbol: char) -> bool {
        self.dialect.command(symbol) == Some(Command::Fixed(Action::Leaf))
    }

    /// A production whose predecessor or context never comes up, or that another always precedes.
    fn check_reach(
        &mut self,
        axiom: &Template,
        written: &[Written<'_>],
        productions: &[Production],
    ) {
        let mut reached = vec![false; self.symbols.len()];
        let mut fresh: Vec<u8> = axiom.symbols.clone();
        while let Some(id) = fresh.pop() {
            match reached.get_mut(usize::from(id)) {
                Some(r) if !*r => *r = true,
                _ => continue,
            }
            for p in productions.iter().filter(|p| p.predecessor == id) {
                fresh.extend(&p.successor.symbols);
            }
        }
        let globals = parse::values(&self.constants);
        for (i, (p, w)) in productions.iter().zip(written).enumerate() {
            let name = w.parsed.predecessor.symbol;
            let constant = |code: &Option<super::Code>| match code.as_ref()?.shape(&globals) {
                Shape::Constant(x) => Some(x),
                _ => None,
            };
            // One without a weight is taken before any with one, wherever it stands.
            let rivals = if p.weight.is_some() { productions.len() } else { i };
            let rival = productions.iter().take(rivals).position(|q| {
                q.predecessor == p.predecessor
                    && q.condition.is_none()
                    && q.weight.is_none()
                    && (q.left.is_empty() || q.left == p.left)
                    && (q.right.is_empty() || q.right == p.right)
            });
            let comes_up = |id: u8| reached.get(usize::from(id)).is_some_and(|r| *r);
            let absent = p.left.iter().chain(&p.right).position(|&id| !comes_up(id));
            let context = absent.and_then(|i| w.parsed.left.iter().chain(&w.parsed.right).nth(i));
            let mut span = w.parsed.predecessor.span.clone();
            let (reason, remedy) = if !comes_up(p.predecessor) {
                (
                    format!("`{name}` never comes up"),
                    format!("put `{name}` into the axiom or a successor, or remove the production"),
                )
            } else if let Some(context) = context {
                span = context.span.clone();
                (
                    format!("its context `{}` never comes up", context.symbol),
                    "name a symbol of the axiom or of a successor".into(),
                )
            } else if let Some(j) = rival {
                (
                    format!("production {} always replaces `{name}` first", j + 1),
                    "give both a weight, `-> (0.5) …`, or a condition, `: a > 0.1`".into(),
                )
            } else if constant(&p.condition) == Some(0.0) {
                ("its condition is always false".into(), "change the condition".into())
            } else if constant(&p.weight) == Some(0.0) {
                ("its weight is 0".into(), "give it a weight above 0".into())
            } else {
                continue;
            };
            let slip = Slip::new(span, format!("production can never apply: {reason}"), remedy);
            self.slip(&w.text, slip);
        }
    }

    /// Angles and constants this file sets to no effect.
    fn check_use(&mut self, axiom: &Template, productions: &[Production]) {
        let idle: Vec<(Place, String)> = self
            .angle_entries
            .iter()
            .filter(|(_, _, used)| !used)
            .map(|(place, name, _)| (place.clone(), name.clone()))
            .collect();
        for (place, name) in idle {
            self.error(
                &place,
                format!("the angle `{name}` is not used"),
                "remove it, or use one of its symbols in a production",
            );
        }
        let mut is_used = vec![false; self.constants.len()];
        let codes = productions
            .iter()
            .flat_map(|p| p.condition.iter().chain(&p.weight).chain(&p.successor.arguments))
            .chain(&axiom.arguments);
        for code in codes {
            code.globals(|i| {
                if let Some(used) = is_used.get_mut(i) {
                    *used = true;
                }
            });
        }
        for line in self.lines("constants") {
            let at = self.constants.iter().position(|(n, _)| *n == line.key);
            let used = at.and_then(|i| is_used.get(i)).copied().unwrap_or(true);
            if !used && line.key_place.source == 0 {
                self.error(
                    &line.key_place,
                    format!("the constant `{}` is not used", line.key),
                    "remove it, or use it in a production",
                );
            }
        }
    }
}
