use super::*;
use crate::skeleton::turtle;
use crate::species;

fn table3(number: u32) -> Rule {
    species::load(&format!("table3/{number:02}")).unwrap().rule
}

/// Method, §6: modules, draws, bracket pairs, length.
const TABLE: [(usize, usize, usize, f64); 13] = [
    (818, 216, 215, 42.875),
    (818, 216, 215, 42.875),
    (818, 216, 215, 22.4258),
    (337, 85, 84, 11.5),
    (337, 85, 84, 19.6),
    (337, 85, 84, 22.66),
    (998, 250, 250, 54.0),
    (1996, 500, 500, 108.0),
    (497, 125, 124, 27.0),
    (401, 101, 100, 38.0),
    (97, 25, 24, 5.3824),
    (97, 25, 24, 9.0),
    (497, 125, 124, 27.0),
];

#[test]
fn table_3_gives_its_exact_counts_and_lengths() {
    for (i, (modules, draws, brackets, length)) in TABLE.into_iter().enumerate() {
        let rule = table3(i as u32 + 1);
        let string = derive(&rule, &Inputs::new(Seed::new(1))).unwrap();
        let stats = string.stats(&rule);
        let counts = (stats.modules, stats.draws, stats.brackets, stats.nodes);
        assert_eq!(counts, (modules, draws, brackets, draws + 1), "rule {}", i + 1);
        assert!((stats.length - length).abs() < 5e-5, "rule {}: {}", i + 1, stats.length);
        let scaffold = turtle::draw(&rule, &string).unwrap();
        scaffold.check().unwrap();
        assert_eq!(scaffold.len(), draws + 1);
    }
}

fn rule(section: &str) -> Rule {
    species::load_text("test", &format!("[rule]\n{section}")).unwrap().rule
}

fn strings(rule: &Rule, iterations: u32) -> Vec<String> {
    (0..=iterations)
        .map(|n| {
            let mut inputs = Inputs::new(Seed::new(1));
            inputs.iterations = Some(n);
            derive(rule, &inputs).unwrap().to_text(rule)
        })
        .collect()
}

#[test]
fn lengths_scale_with_the_first_shoot() {
    for number in 1..=13 {
        let rule = table3(number);
        let length = |a: f64| {
            let mut inputs = Inputs::new(Seed::new(1));
            inputs.first_shoot_m = Some(a);
            derive(&rule, &inputs).unwrap().stats(&rule).length
        };
        for a in [1e-6, 0.3, 1e6] {
            assert!((length(a) / (a * length(1.0)) - 1.0).abs() < 1e-12, "rule {number}");
        }
    }
}

/// ABOP, p. 42, Figure 1.37.
#[test]
fn several_parameters_and_conditions() {
    let rule = rule(
        "turtle = 'heading'\nmarkers = 'C'\naxiom = 'B(2)A(4,4)'
        productions = ['A(x,y) : y <= 3 -> A(x*2, x+y)', 'A(x,y) : y > 3 -> B(x)A(x/y, 0)',
            'B(x) : x < 1 -> C', 'B(x) : x >= 1 -> B(x-1)']",
    );
    assert_eq!(
        strings(&rule, 4),
        ["B(2)A(4,4)", "B(1)B(4)A(1,0)", "B(0)B(3)A(2,1)", "CB(2)A(4,3)", "CB(1)A(8,7)"]
    );
}

/// ABOP, §1.8, p. 30: a signal runs along a string.
#[test]
fn left_context_carries_a_signal() {
    let rule = rule(
        "turtle = 'heading'\naxiom = 'baaaa'
        productions = ['b < a -> b', 'b -> a']",
    );
    assert_eq!(strings(&rule, 4), ["baaaa", "abaaa", "aabaa", "aaaba", "aaaab"]);
}

/// ABOP, §1.8, Figure 1.31: a signal climbs into every branch; another comes down the axis.
#[test]
fn contexts_see_past_branches_and_ignored_symbols() {
    let section = |productions: &str, axiom: &str| {
        rule(&format!(
            "turtle = 'heading'\nignore = '+-'\nmarkers = 'aeb'\nangles = {{ delta = 45 }}
            axiom = '{axiom}'\nproductions = ['{productions}']"
        ))
    };
    let up = section("b < a -> b", "b[+a]a[-a]a[+a]a");
    assert_eq!(
        strings(&up, 3),
        ["b[+a]a[-a]a[+a]a", "b[+b]b[-a]a[+a]a", "b[+b]b[-b]b[+a]a", "b[+b]b[-b]b[+b]b"]
    );
    let down = section("a > e -> e", "a[+a]a[-a]a[+a]e");
    assert_eq!(
        strings(&down, 3),
        ["a[+a]a[-a]a[+a]e", "a[+a]a[-a]e[+a]e", "a[+a]e[-a]e[+a]e", "e[+a]e[-a]e[+a]e"]
    );
}

#[test]
fn contexts_bind_their_parameters() {
    let rule = rule(
        "turtle = 'heading'\naxiom = 'A(1)B(10)C(100)'\nmarkers = 'AC'
        productions = ['A(x) < B(y) > C(z) -> B(x + y + 2z)']",
    );
    assert_eq!(strings(&rule, 1)[1], "A(1)B(211)C(100)");
}

#[test]
fn weights_are_frequencies_and_seeds_repeat() {
    let rule = rule(
        "turtle = 'heading'\nmarkers = 'BC'\naxiom = 'A'\niterations = 15
        productions = ['A -> (many) B', 'A -> (1) C']\nconstants = { many = 3 }",
    );
    let mut long = rule.clone();
    let id = long.axiom.symbols[0];
    long.axiom.symbols = vec![id; 40_000];
    let count = |seed| {
        let string = derive(&long, &Inputs::new(Seed::new(seed))).unwrap();
        let text = string.to_text(&long);
        (text.matches('B').count(), text)
    };
    let (b, text) = count(1);
    // Binomial: 30,000 ± 87; five standard deviations.
    assert!((29_567..30_433).contains(&b), "{b}");
    assert_eq!(text, count(1).1);
    assert_ne!(text, count(2).1);
}

#[test]
fn a_growing_rule_stops_at_the_limit_by_name() {
    for production in ["F(a) -> F(a)F(a)", "F(a) : a > 0 -> F(a)F(a)"] {
        let rule =
            rule(&format!("axiom = 'F(a)'\niterations = 64\nproductions = ['{production}']"));
        let mut inputs = Inputs::new(Seed::new(1));
        inputs.module_limit = 100_000;
        let error = derive(&rule, &inputs).unwrap_err();
        assert_eq!(
            error.message(),
            format!(
                "iteration 17 makes more than 100000 modules, most of them from `{production}`"
            )
        );
        assert!(error.remedy_text().is_some());
    }
}

#[test]
fn parameters_that_leave_the_numbers_are_refused() {
    let overflow = rule("axiom = 'F(a)'\niterations = 64\nproductions = ['F(a) -> F(a*1e300)']");
    assert!(derive(&overflow, &Inputs::new(Seed::new(1))).is_err());
    let root = rule("axiom = 'F(a)'\nproductions = ['F(x) -> F(sqrt(x - 2))']");
    let error = derive(&root, &Inputs::new(Seed::new(1))).unwrap_err();
    assert!(error.message().contains("F(sqrt(x - 2))"), "{error}");
}

/// A condition that is not a number does not hold, nor does what is built on it.
#[test]
fn what_is_not_a_number_does_not_hold() {
    for condition in ["sqrt(x - 2)", "sqrt(x - 2) && 1", "sqrt(x - 2) || 0"] {
        let rule =
            rule(&format!("axiom = 'F(a)'\nproductions = ['F(x) : {condition} -> F(x)F(x)']"));
        let string = derive(&rule, &Inputs::new(Seed::new(1))).unwrap();
        assert_eq!(string.stats(&rule).draws, 1, "{condition}");
    }
}

/// A typographic minus is a minus wherever a rule may name it.
#[test]
fn a_typographic_minus_turns_and_is_looked_past() {
    let with = |minus: &str| {
        let rule = rule(&format!(
            "turtle = 'heading'\naxiom = 'A{minus}B'\nproductions = ['A < B -> F(1){minus}F(1)']\n\
             iterations = 1\nignore = '+{minus}'\nangles = {{ '+{minus}' = 30 }}\nmarkers = 'AB'"
        ));
        let string = derive(&rule, &Inputs::new(Seed::new(1))).unwrap();
        (string.to_text(&rule), turtle::draw(&rule, &string).unwrap().position)
    };
    let plain = with("-");
    assert_eq!(plain.0, "A-F(1)-F(1)");
    assert_eq!(with("−"), plain);
}
