//! Published examples of *The Algorithmic Beauty of Plants* (Prusinkiewicz & Lindenmayer 1990),
//! written as rule files: their strings where the book prints them, and else what their
//! productions give in closed form.

use larix::seed::Seed;
use larix::skeleton::derive::{Inputs, ModuleString, derive};
use larix::skeleton::turtle::{Scaffold, draw};
use larix::species::{self, Rule};

fn rule(section: &str) -> Rule {
    let text = format!("[rule]\nturtle = 'heading'\n{section}");
    match species::load_text("abop", &text) {
        Ok(species) => species.rule,
        Err(error) => panic!("{}", larix::diagnostic::render(&error)),
    }
}

fn derived(rule: &Rule, iterations: u32, seed: u64) -> ModuleString {
    let inputs = Inputs { iterations: Some(iterations), ..Inputs::new(Seed::new(seed)) };
    derive(rule, &inputs).unwrap()
}

fn text(rule: &Rule, iterations: u32) -> String {
    derived(rule, iterations, 1).to_text(rule)
}

fn drawn(rule: &Rule, iterations: u32) -> Scaffold {
    let scaffold = draw(rule, &derived(rule, iterations, 1)).unwrap();
    scaffold.check().unwrap();
    scaffold
}

fn counts(text: &str, symbol: char) -> usize {
    text.matches(symbol).count()
}

/// §1.2, Anabaena catenula: A, a are long cells that face right and left, B, b short ones.
#[test]
fn anabaena_grows_by_fibonacci() {
    let rule = rule(
        "axiom = 'A'\niterations = 4\nproductions = ['A -> aB', 'a -> bA', 'B -> A', 'b -> a']",
    );
    let printed = ["A", "aB", "bAA", "aaBaB", "bAbAAbAA"];
    for (n, expected) in printed.into_iter().enumerate() {
        assert_eq!(text(&rule, n as u32), expected);
    }
    let lengths: Vec<usize> = (0..20).map(|n| text(&rule, n).len()).collect();
    assert!(lengths.windows(3).all(|w| w[2] == w[0] + w[1]));
}

/// §1.8: a signal passes along a string of a's, to the right by left context and back by right.
#[test]
fn signals_run_both_ways() {
    let to_right = rule("axiom = 'baaaaaaaa'\nproductions = ['b < a -> b', 'b -> a']");
    let to_left = rule("axiom = 'aaaaaaaab'\nproductions = ['a > b -> b', 'b -> a']");
    for n in 0..9 {
        let mut expected = ['a'; 9];
        expected[n] = 'b';
        assert_eq!(text(&to_right, n as u32), expected.iter().collect::<String>());
        expected.reverse();
        assert_eq!(text(&to_left, n as u32), expected.iter().collect::<String>());
    }
    // Over the end nothing is left of it.
    assert_eq!(text(&to_right, 9), "aaaaaaaaa");
}

#[test]
fn signals_pass_ignored_symbols_and_stop_at_others() {
    let section = |ignore: &str| {
        rule(&format!(
            "axiom = 'b+a-a+a'\nignore = '{ignore}'\nangles = {{ delta = 30 }}
            productions = ['b < a -> b']"
        ))
    };
    assert_eq!(text(&section("+-"), 3), "b+b-b+b");
    assert_eq!(text(&section("+"), 3), "b+b-a+a");
    assert_eq!(text(&section(""), 3), "b+a-a+a");
}

/// §1.8, p. 32: BC < S > G[H]M holds for S in ABC[DE][SG[HI[JK]L]MNO]: the branch [DE] is passed
/// over on the left, I[JK]L on the right.
#[test]
fn contexts_go_into_branches() {
    let holds = |context: &str, axiom: &str| {
        let rule = rule(&format!(
            "axiom = '{axiom}'\nmarkers = 'ABCDEGHIJKLMNOX'\nproductions = ['{context} -> X']"
        ));
        text(&rule, 1).contains('X')
    };
    let axiom = "ABC[DE][SG[HI[JK]L]MNO]";
    assert!(holds("BC < S > G[H]M", axiom));
    assert!(holds("S > G[HI[J]L]M", axiom));
    assert!(holds("S > G[HIL]MNO", axiom));
    assert!(holds("S > GM", axiom));
    for (context, axiom) in [
        ("AC < S", axiom),
        ("DE < S", axiom),
        ("S > G[I]M", axiom),
        ("S > G[H]N", axiom),
        ("S > G[H][M]", axiom),
        // The context goes no further than its own branch.
        ("S > GMNOA", "ABC[DE][SG[H]MNO]A"),
    ] {
        assert!(!holds(context, axiom), "{context} holds in {axiom}");
    }
    assert!(holds("S > [A][B]C", "S[AD][BE]C"));
    assert!(!holds("S > [B]C", "S[AD][BE]C"));
}

/// §1.7, Figure 1.31 (a), after Hogeweg & Hesper: digits as symbols, contexts on both sides, and
/// turns that are replaced themselves.
#[test]
fn binary_signals_grow_a_plant() {
    let rule = rule(
        "axiom = 'F1F1F1'\nignore = '+-F'\nangles = { delta = 22.5 }
        productions = ['0 < 0 > 0 -> 0', '0 < 0 > 1 -> 1[+F1F1]', '0 < 1 > 0 -> 1',
            '0 < 1 > 1 -> 1', '1 < 0 > 0 -> 0', '1 < 0 > 1 -> 1F1', '1 < 1 > 0 -> 0',
            '1 < 1 > 1 -> 0', '+ -> -', '- -> +']",
    );
    let by_hand =
        ["F1F1F1", "F1F0F1", "F1F1F1F1", "F1F0F0F1", "F1F0F1[+F1F1]F1", "F1F1F1F1[-F0F1]F1"];
    for (n, expected) in by_hand.into_iter().enumerate() {
        assert_eq!(text(&rule, n as u32), expected, "step {n}");
    }
}

/// §1.10, p. 42: the parametric example with conditions, its first steps as printed.
#[test]
fn parameters_and_conditions() {
    let rule = rule(
        "markers = 'C'\naxiom = 'B(2)A(4,4)'
        productions = ['A(x,y) : y <= 3 -> A(x*2, x+y)', 'A(x,y) : y > 3 -> B(x)A(x/y, 0)',
            'B(x) : x < 1 -> C', 'B(x) : x >= 1 -> B(x-1)']",
    );
    let printed = ["B(2)A(4,4)", "B(1)B(4)A(1,0)", "B(0)B(3)A(2,1)", "CB(2)A(4,3)", "CB(1)A(8,7)"];
    for (n, expected) in printed.into_iter().enumerate() {
        assert_eq!(text(&rule, n as u32), expected);
    }
}

/// Figure 1.24: bracketed plants (a)–(f): segments, branches and stems in closed form.
#[test]
fn bracketed_plants_have_their_counts() {
    let edge = |production: &str, delta: f64| {
        rule(&format!(
            "axiom = 'F'\nangles = {{ delta = {delta} }}\nproductions = ['F -> {production}']"
        ))
    };
    let node = |production: &str, delta: f64| {
        rule(&format!(
            "axiom = 'X'\nangles = {{ delta = {delta} }}
            productions = ['X -> {production}', 'F -> FF']"
        ))
    };
    let check = |rule: &Rule, n: u32, segments: usize, brackets: usize, ends: usize| {
        let string = derived(rule, n, 1);
        let stats = string.stats(rule);
        assert_eq!((stats.draws, stats.brackets), (segments, brackets));
        let text = string.to_text(rule);
        assert_eq!(counts(&text, 'X'), ends);
        assert_eq!(drawn(rule, n).len(), segments + 1);
        text
    };
    let (a, b) = (edge("F[+F]F[-F]F", 25.7), edge("F[+F]F[-F][F]", 20.0));
    let c = edge("FF-[-F+F+F]+[+F-F-F]", 22.5);
    let (d, e) = (node("F[+X]F[-X]+X", 20.0), node("F[+X][-X]FX", 25.7));
    let f = node("F-[[X]+X]+F[+FX]-X", 22.5);
    let mut texts = vec![
        check(&a, 5, 5usize.pow(5), 2 * (5usize.pow(5) - 1) / 4, 0),
        check(&b, 5, 5usize.pow(5), 3 * (5usize.pow(5) - 1) / 4, 0),
        check(&c, 4, 8usize.pow(4), 2 * (8usize.pow(4) - 1) / 7, 0),
        check(&d, 7, 2 * (3usize.pow(7) - 128), 3usize.pow(7) - 1, 3usize.pow(7)),
        check(&e, 7, 2 * (3usize.pow(7) - 128), 3usize.pow(7) - 1, 3usize.pow(7)),
        check(&f, 5, 3 * (4usize.pow(5) - 32) / 2, 4usize.pow(5) - 1, 4usize.pow(5)),
    ];
    texts.sort();
    texts.dedup();
    assert_eq!(texts.len(), 6);
    // The stems of (a) and (e) are straight: 3⁵ and 2⁸ − 2 segments.
    for (rule, n, height) in [(&a, 5, 243.0), (&e, 7, 254.0)] {
        let scaffold = drawn(rule, n);
        let stem = scaffold.axis.iter().rposition(|&axis| axis == 0).unwrap();
        let tip = scaffold.position[stem];
        assert!((tip - glam::Vec3::new(0.0, 0.0, height)).length() < 1e-3, "{tip}");
    }
}

/// Figure 1.26: the bush with leaves. Its counts follow the productions one by one.
#[test]
fn the_bush_bears_its_leaves() {
    let rule = rule(
        r#"axiom = 'A'
        angles = { delta = 22.5 }
        productions = ["A -> [&FL!A]/////'[&FL!A]///////'[&FL!A]", 'F -> S/////F', 'S -> FL',
            """L -> ['''^^{-f+f+f-|-f+f+f}]"""]"#,
    );
    let (mut a, mut f, mut s, mut l, mut leaves) = (1, 0, 0, 0, 0);
    for n in 0..=7 {
        let string = derived(&rule, n, 1);
        let shown = string.to_text(&rule);
        let found = ['A', 'F', 'S', 'L', '{'].map(|c| counts(&shown, c));
        assert_eq!(found, [a, f, s, l, leaves], "step {n}");
        let scaffold = draw(&rule, &string).unwrap();
        scaffold.check().unwrap();
        assert_eq!(scaffold.polygon_end.len(), leaves);
        assert_eq!(scaffold.polygon.len(), 6 * leaves);
        (a, f, s, l, leaves) = (3 * a, 3 * a + f + s, f, 3 * a + s, leaves + l);
    }
}

/// Figure 1.27: a plant of chance. One production in three by its weight, and 3.66 segments for
/// each on average.
#[test]
fn stochastic_plants_follow_their_weights() {
    let rule = rule(
        "axiom = 'F'\nangles = { delta = 30 }
        productions = ['F -> (0.33) F[+F]F[-F]F', 'F -> (0.33) F[+F]F', 'F -> (0.34) F[-F]F']",
    );
    let seeds = 6000u64;
    let mut taken = [0u32; 3];
    for seed in 0..seeds {
        let text = derived(&rule, 1, seed).to_text(&rule);
        let which = ["F[+F]F[-F]F", "F[+F]F", "F[-F]F"].iter().position(|t| *t == text);
        taken[which.unwrap()] += 1;
    }
    for (count, weight) in taken.into_iter().zip([0.33, 0.33, 0.34]) {
        let deviation = (f64::from(count) - seeds as f64 * weight).abs();
        // Five standard deviations.
        assert!(deviation < 5.0 * (seeds as f64 * weight * (1.0 - weight)).sqrt(), "{taken:?}");
    }
    let mean =
        (0..400).map(|s| derived(&rule, 5, s).stats(&rule).draws as f64).sum::<f64>() / 400.0;
    // A branching process: 3.66⁵, standard deviation of one 197.8.
    assert!((mean - 3.66f64.powi(5)).abs() < 5.0 * 197.8 / 20.0, "{mean}");
}

/// Lengths of the segments that end at a node, and the angle to the segment before, degrees.
struct Segments<'a>(&'a Scaffold);

impl Segments<'_> {
    fn way(&self, node: usize) -> glam::DVec3 {
        let s = self.0;
        s.position[node].as_dvec3() - s.position[s.parent[node] as usize].as_dvec3()
    }

    fn mother(&self, node: usize) -> Option<usize> {
        Some(self.0.parent[node] as usize).filter(|&p| p != 0)
    }

    /// Length over the mother's, width over the mother's, angle between both, whether it goes on
    /// on the same axis.
    fn beside_mother(&self, node: usize) -> Option<(f64, f64, f64, bool)> {
        let mother = self.mother(node)?;
        let (own, hers) = (self.way(node), self.way(mother));
        let s = self.0;
        Some((
            own.length() / hers.length(),
            f64::from(s.width_m[node]) / f64::from(s.width_m[mother]),
            own.angle_between(hers).to_degrees(),
            s.axis[node] == s.axis[mother],
        ))
    }

    fn length(&self) -> f64 {
        (1..self.0.len()).map(|i| self.way(i).length()).sum()
    }
}

fn near(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance * b.abs().max(1.0)
}

/// Sum of the geometric series 1 + q + … + qⁿ⁻¹.
fn series(q: f64, n: i32) -> f64 {
    (q.powi(n) - 1.0) / (q - 1.0)
}

/// Figure 2.6: monopodial trees after Honda, parameters (a)–(d).
#[test]
fn monopodial_trees_of_honda() {
    for (r1, r2, a0, a2) in [
        (0.9, 0.6, 45.0, 45.0),
        (0.9, 0.9, 45.0, 45.0),
        (0.9, 0.8, 45.0, 45.0),
        (0.9, 0.7, 30.0, -30.0),
    ] {
        let rule = rule(&format!(
            "axiom = 'A(1,10)'
            constants = {{ r1 = {r1}, r2 = {r2}, a0 = {a0}, a2 = {a2}, d = 137.5, wr = 0.707 }}
            productions = [
                'A(l,w) -> !(w)F(l)[&(a0)B(l*r2,w*wr)]/(d)A(l*r1,w*wr)',
                'B(l,w) -> !(w)F(l)[-(a2)$C(l*r2,w*wr)]C(l*r1,w*wr)',
                'C(l,w) -> !(w)F(l)[+(a2)$B(l*r2,w*wr)]B(l*r1,w*wr)']"
        ));
        for n in 1..=10 {
            let stats = derived(&rule, n, 1).stats(&rule);
            assert_eq!(stats.draws, (1 << n) - 1);
            assert!(near(stats.length, series(r1 + r2, n as i32), 1e-12), "{}", stats.length);
        }
        let scaffold = drawn(&rule, 10);
        let segments = Segments(&scaffold);
        assert!(near(segments.length(), series(r1 + r2, 10), 1e-4));
        let mut azimuths = Vec::new();
        for node in 1..scaffold.len() {
            let Some((ratio, width, angle, goes_on)) = segments.beside_mother(node) else {
                continue;
            };
            assert!(near(width, 0.707, 1e-5));
            assert!(near(ratio, if goes_on { r1 } else { r2 }, 1e-3), "{ratio}");
            let from_trunk = scaffold.axis[scaffold.parent[node] as usize] == 0;
            let expected = match (goes_on, from_trunk) {
                (true, _) => 0.0,
                (false, true) => a0,
                (false, false) => f64::abs(a2),
            };
            assert!((angle - expected).abs() < 0.1, "{angle} is not {expected}");
            if from_trunk && !goes_on {
                let way = segments.way(node);
                azimuths.push(way.y.atan2(way.x).to_degrees());
            }
        }
        assert_eq!(azimuths.len(), 9);
        for pair in azimuths.windows(2) {
            let turn = (pair[1] - pair[0]).rem_euclid(360.0);
            assert!((turn.min(360.0 - turn) - 137.5).abs() < 0.05, "{turn}");
        }
    }
}

/// Figure 2.7: sympodial trees after Aono & Kunii, parameters (a)–(d).
#[test]
fn sympodial_trees_of_aono_and_kunii() {
    for (r1, r2, a1, a2) in [
        (0.9, 0.7, 10.0, 60.0),
        (0.9, 0.7, 5.0, 65.0),
        (0.9, 0.8, 20.0, 50.0),
        (0.9, 0.8, 35.0, 35.0),
    ] {
        let rule = rule(&format!(
            "axiom = 'A(1,10)'
            constants = {{ r1 = {r1}, r2 = {r2}, a1 = {a1}, a2 = {a2}, wr = 0.707 }}
            productions = [
                'A(l,w) -> !(w)F(l)[&(a1)B(l*r1,w*wr)]/(180)[&(a2)B(l*r2,w*wr)]',
                'B(l,w) -> !(w)F(l)[+(a1)$B(l*r1,w*wr)][-(a2)$B(l*r2,w*wr)]']"
        ));
        let stats = derived(&rule, 10, 1).stats(&rule);
        assert_eq!((stats.draws, stats.brackets), (1023, 2046));
        assert!(near(stats.length, series(r1 + r2, 10), 1e-12));
        let scaffold = drawn(&rule, 10);
        let segments = Segments(&scaffold);
        let mut daughters = vec![Vec::new(); scaffold.len()];
        for node in 2..scaffold.len() {
            let (ratio, width, angle, goes_on) = segments.beside_mother(node).unwrap();
            let is_first = (ratio - r1).abs() < 1e-3;
            assert!(is_first || (ratio - r2).abs() < 1e-3, "{ratio}");
            assert!((angle - if is_first { a1 } else { a2 }).abs() < 0.1, "{angle}");
            assert!(near(width, 0.707, 1e-5));
            assert!(!goes_on, "the leader must give way");
            daughters[scaffold.parent[node] as usize].push(segments.way(node));
        }
        // Of the trunk: one on each side, in one plane.
        let pair = &daughters[1];
        assert_eq!(pair.len(), 2);
        assert!((pair[0].angle_between(pair[1]).to_degrees() - a1 - a2).abs() < 0.01);
    }
}

/// Figure 2.8: trees with ternary branching, parameters (a)–(d), without their tropism. `F` and
/// `!` are replaced themselves.
#[test]
fn ternary_trees() {
    let n = 6;
    for (d1, d2, a, lr) in [
        (94.74f64, 132.63f64, 18.95f64, 1.109f64),
        (137.5, 137.5, 18.95, 1.109),
        (112.5, 157.5, 22.5, 1.79),
        (180.0, 252.0, 36.0, 1.07),
    ] {
        let vr = 1.732f64;
        let rule = rule(&format!(
            "axiom = '!(1)F(200)/(45)A'
            constants = {{ d1 = {d1}, d2 = {d2}, s = {a}, lr = {lr}, vr = {vr} }}
            productions = [
                'A -> !(vr)F(50)[&(s)F(50)A]/(d1)[&(s)F(50)A]/(d2)[&(s)F(50)A]',
                'F(l) -> F(l*lr)', '!(w) -> !(w*vr)']"
        ));
        let string = derived(&rule, n, 1);
        let stats = string.stats(&rule);
        let made = |step: u32| 3usize.pow(step - 1);
        assert_eq!(stats.draws, 1 + (1..=n).map(|k| 4 * made(k)).sum::<usize>());
        assert_eq!(counts(&string.to_text(&rule), 'A'), 3usize.pow(n));
        let grown = |step: u32| lr.powi((n - step) as i32);
        let length = 200.0 * lr.powi(n as i32)
            + (1..=n).map(|k| 4.0 * made(k) as f64 * 50.0 * grown(k)).sum::<f64>();
        assert!(near(stats.length, length, 1e-12));

        let scaffold = drawn(&rule, n);
        let segments = Segments(&scaffold);
        assert!(near(f64::from(scaffold.width_m[1]), vr.powi(n as i32), 1e-5));
        let mut forks = 0;
        for mother in 1..scaffold.len() {
            let daughters: Vec<usize> =
                (1..scaffold.len()).filter(|&i| scaffold.parent[i] as usize == mother).collect();
            let [x, y, z] = daughters.as_slice() else {
                assert!(daughters.len() < 2);
                continue;
            };
            forks += 1;
            let hers = segments.way(mother).normalize();
            let sides: Vec<glam::DVec3> = [x, y, z]
                .map(|&d| {
                    let own = segments.way(d);
                    assert!((own.angle_between(hers).to_degrees() - a).abs() < 0.2);
                    own.reject_from_normalized(hers)
                })
                .to_vec();
            let turn = |i: usize, j: usize| {
                let (p, q) = (sides[i], sides[j]);
                hers.dot(p.cross(q)).atan2(p.dot(q)).to_degrees().abs()
            };
            let folded = |d: f64| (d % 360.0).min(360.0 - d % 360.0);
            assert!((turn(0, 1) - folded(d1)).abs() < 0.5, "{} {d1}", turn(0, 1));
            assert!((turn(1, 2) - folded(d2)).abs() < 0.5, "{} {d2}", turn(1, 2));
        }
        assert_eq!(forks, (3usize.pow(n) - 1) / 2);
    }
}

/// `%`: branches are shed three steps after they came, and leave a scar.
#[test]
fn branches_are_shed() {
    let rule = rule(
        "axiom = 'A'\nangles = { delta = 45 }
        productions = ['A -> F(1)[-X(3)B][+X(3)B]A', 'B -> F(1)B', 'X(d) : d > 0 -> X(d-1)',
            'X(d) : d == 0 -> U%', 'U -> F(0.3)']",
    );
    assert_eq!(text(&rule, 2), "F(1)[-X(2)F(1)B][+X(2)F(1)B]F(1)[-X(3)B][+X(3)B]A");
    assert!(text(&rule, 5).starts_with("F(1)[-U][+U]F(1)[-X(0)F(1)F(1)F(1)B][+X(0)"));
    for n in 5..12 {
        let text = text(&rule, n);
        // A stem, four pairs of living branches, one pair just shed, and scars.
        assert_eq!(counts(&text, 'B'), 8);
        assert_eq!(counts(&text, 'U'), 2);
        assert_eq!(text.matches("F(1)").count(), n as usize + 2 * (1 + 2 + 3));
        assert_eq!(text.matches("F(0.3)").count(), 2 * (n as usize - 5));
        assert_eq!(counts(&text, '%'), 0);
    }
}
