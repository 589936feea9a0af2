//! Every message of the rule language, pinned whole: file, line, column, caret and remedy.

use super::load_text;
use crate::diagnostic::render;

/// A sound rule, to be spoiled in one place.
const SOUND: &str = r"[rule]
axiom = 'F(a)'
productions = [
    'F(a) -> F(a)[^F(0.5a)][&F(0.5a)]',
]
angles = { alpha = 30 }
iterations = 3
";

/// Name of the case, what to replace in [`SOUND`], by what.
const CASES: &[(&str, &str, &str)] = &[
    ("not TOML", "axiom = ", "axiom "),
    ("unknown key", "angles =", "angels ="),
    ("unknown section", "[rule]", "[rules]"),
    ("unknown top key", "[rule]", "branchng = 'sympodial'\n[rule]"),
    ("unknown value", "[rule]", "kind = 'conifr'\n[rule]"),
    ("wrong type", "iterations = 3", "iterations = 'three'"),
    ("key in the wrong section", "iterations = 3", "height_m = 12\niterations = 3"),
    ("key of two sections", "iterations = 3", "colour = [1, 2, 3]\niterations = 3"),
    ("top key in a section", "iterations = 3", "iterations = 3\nextends = 'table3/13'"),
    ("key twice", "iterations = 3", "iterations = 3\niterations = 4"),
    (
        "escape in double quotes",
        "'F(a) -> F(a)[^F(0.5a)][&F(0.5a)]'",
        r#""F(a) -> F(a)[\F(0.5a)]""#,
    ),
    (
        "escape that makes a control character",
        "'F(a) -> F(a)[^F(0.5a)][&F(0.5a)]'",
        r#""F(a) -> F(a)[\f(0.5a)][^F(a)]""#,
    ),
    ("curly quotes", "'F(a)'", "‘F(a)’"),
    ("typographic minus", "alpha = 30", "alpha = −30"),
    ("Greek letter", "alpha = 30", "α = 30"),
    ("quoted Greek letter", "alpha = 30", "'α' = 30"),
    ("no axiom", "axiom = 'F(a)'\n", ""),
    ("misspelt axiom", "axiom = ", "axoim = "),
    ("negative count", "iterations = 3", "iterations = -1"),
    ("too many iterations", "iterations = 3", "iterations = 900"),
    ("tropism out of range", "iterations = 3", "iterations = 3\ntropism = { elasticity = 40 }"),
    ("tropism misspelt", "iterations = 3", "iterations = 3\ntropism = { elastic = 0.2 }"),
    ("no arrow between two of one name", "F(a) -> F(a)[^F(0.5a)]", "F(a) F(a)[^F(0.5a)]"),
    ("empty axiom", "'F(a)'", "''"),
    ("bracket never opened", "[&F", "&F"),
    ("bracket never closed", ")][&", ")[&"),
    (
        "bracket in an escaped string",
        "'F(a) -> F(a)[^F(0.5a)][&F(0.5a)]'",
        r#""F(a) -> F(a)[\\F(0.5a)]]""#,
    ),
    ("parenthesis never closed", "F(a)[^F(0.5a)]", "F(a)[^F(0.5a]"),
    ("too many parameters", "[&F(0.5a)]", "[&F(0.5a, 2)]"),
    ("decimal comma", "[&F(0.5a)]", "[&F(0,5a)]"),
    ("no parameter", "[&F(0.5a)]", "[&F]"),
    ("unknown letter", "[&F(0.5a)]", "[&K(0.5a)]"),
    ("unknown command", "[&F", "[+F"),
    ("no angle", "angles = { alpha = 30 }", ""),
    ("digit outside parentheses", "[&F(0.5a)]", "[&F0.5a]"),
    ("multiplication sign between modules", "[&F", "×[&F"),
    ("control character", "[&F", "\u{7f}[&F"),
    ("angle of no use", "alpha = 30", "alpha = 30, beta = 20"),
    ("misspelt angle", "alpha = 30", "alfa = 30"),
    ("angle of another turtle", "alpha = 30", "alpha = 30, '+' = 20"),
    ("angle out of range", "alpha = 30", "alpha = 3000"),
    ("unknown name", "F(0.5a)][&", "F(0.5b)][&"),
    ("unknown function", "F(0.5a)][&", "F(sqr(a))][&"),
    ("function with too few arguments", "F(0.5a)][&", "F(min(a))][&"),
    ("function with too many arguments", "F(0.5a)][&", "F(sqrt(a, 2))][&"),
    ("function without arguments", "F(0.5a)][&", "F(sqrt a)][&"),
    ("parameter as a function", "F(0.5a)][&", "F(a(2))][&"),
    ("dash for a minus", "F(0.5a)][&", "F(a – 1)][&"),
    ("parameter in the axiom", "'F(a)'", "'F(len)'"),
    (
        "nested too deeply",
        "F(0.5a)][&",
        "F((((((((((((((((((((((((((((((((((a))))))))))))))))))))))))))))))))))][&",
    ),
    ("division by zero", "F(0.5a)][&", "F(a/(2-2))][&"),
    ("division by a constant of 0", "F(a)[^F(0.5a)]", "F(a)[^F(a/k)]"),
    ("constant of no use", "iterations = 3", "iterations = 3\nconstants = { k = 2 }"),
    ("constant with a taken name", "iterations = 3", "iterations = 3\nconstants = { a = 2 }"),
    ("no arrow", "F(a) -> F(a)", "F(a) = F(a)"),
    ("arrow of another make", "F(a) -> F(a)", "F(a) => F(a)"),
    ("arrow of two strokes", "F(a) -> F(a)", "F(a) --> F(a)"),
    ("arrow after a condition", "F(a) -> F(a)", "F(a) : a > 1 => F(a)"),
    ("assignment", "F(a) -> F(a)", "F(a) := F(a)"),
    ("constant of the tree", "iterations = 3", "iterations = 3\nconstants = { height = 2 }"),
    ("nothing but a symbol", "F(a) -> F(a)[^F(0.5a)][&F(0.5a)]", "F(a)"),
    ("left context without a symbol", "F(a) -> ", "< F(a) -> "),
    ("right context without a symbol", "F(a) -> ", "F(a) > -> "),
    ("second arrow", "[&F", "-> [&F"),
    ("no successor", "F(a) -> F(a)[^F(0.5a)][&F(0.5a)]", "F(a) ->"),
    ("two predecessors", "F(a) -> ", "F(a)F(b) -> "),
    ("bracket replaced", "F(a) -> ", "[ -> "),
    ("number before the arrow", "F(a) -> ", "F(0.5) -> "),
    ("one name twice", "F(a) -> ", "F(a, a) -> "),
    ("never comes up", "(0.5a)]',", "(0.5a)]',\n    'G(a) -> F(a)',"),
    ("always shadowed", "(0.5a)]',", "(0.5a)]',\n    'F(a) -> F(2a)',"),
    (
        "shadowed by one that follows",
        "'F(a) -> F(a)[^F(0.5a)][&F(0.5a)]'",
        "'F(a) -> (0.5) F(a)[^F(0.5a)][&F(0.5a)]', 'F(a) -> F(a)'",
    ),
    (
        "too many parameters before the arrow",
        "F(a) -> ",
        "A(a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, aa, ab, ac, ad, ae)\
         B(b0, b1, b2, b3, b4, b5, b6, b7, b8, b9, ba, bb, bc, bd, be)\
         C(c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, ca, cb, cc, cd, ce)\
         D(d0, d1, d2) < F(a) -> ",
    ),
    ("left context never comes up", "F(a) -> ", "K < F(a) -> "),
    ("right context never comes up", "F(a) -> ", "F(a) > [F(b)]K -> "),
    ("bracket in a left context", "F(a) -> ", "[F(b)] < F(a) -> "),
    ("right context left open", "F(a) -> ", "F(a) > [F(b) -> "),
    ("weights of 0", "F(a) -> ", "F(a) -> (1 - 1) "),
    ("condition always false", "F(a) -> ", "F(a) : 1 > 2 -> "),
    ("weight below 0", "F(a) -> ", "F(a) -> (-1) "),
    ("unknown base", "[rule]", "extends = 'table3/31'\n[rule]"),
    (
        "profile not rising",
        "iterations = 3",
        "iterations = 3\n[size]\nprofile = [[0.0, 0.5], [0.6, 1.0], [0.4, 0.2]]",
    ),
    (
        "profile point of three",
        "iterations = 3",
        "iterations = 3\n[size]\nprofile = [[0.0, 0.5, 1.0]]",
    ),
    ("age out of range", "iterations = 3", "iterations = 3\n[size]\nage_years = 0"),
    ("size out of range", "iterations = 3", "iterations = 3\n[size]\nheight_m = -4"),
    (
        "thicker than high",
        "iterations = 3",
        "iterations = 3\n[size]\nheight_m = 0.5\nstem_diameter_m = 0.7",
    ),
    (
        "thin as a thread",
        "iterations = 3",
        "iterations = 3\n[size]\nheight_m = 130\nstem_diameter_m = 0.001",
    ),
    ("colour out of range", "iterations = 3", "iterations = 3\n[bark]\ncolour = [300, 0, 0]"),
    ("luminance upside down", "[rule]", "luminance = [190, 160]\n[rule]"),
    ("not finite", "iterations = 3", "iterations = 3\n[size]\nheight_m = nan"),
];

fn message(text: &str) -> String {
    match load_text("birch", text) {
        Ok(_) => "no error\n".into(),
        Err(error) => render(&error),
    }
}

#[test]
fn the_sound_rule_is_sound() {
    load_text("birch", SOUND).unwrap();
}

#[test]
fn every_mistake_has_a_place_and_a_remedy() {
    let mut all = String::new();
    for (name, from, to) in CASES {
        assert!(SOUND.contains(from), "{name}: `{from}` is not in the sound rule");
        let mut spoilt = SOUND.replacen(from, to, 1);
        if *name == "division by a constant of 0" {
            spoilt.push_str("constants = { k = 0 }\n");
        }
        let shown = message(&spoilt);
        assert!(shown.contains("birch.toml"), "{name}: {shown}");
        assert!(shown.contains("help: "), "{name}: {shown}");
        all.push_str(&format!("── {name}\n{shown}\n"));
    }
    insta::assert_snapshot!("mistakes", all);
}

#[test]
fn mistakes_of_the_heading_turtle() {
    let mut all = String::new();
    for (name, body) in [
        ("parameter of a cut", "axiom = 'F[%(2)F]'"),
        ("angle of a cut", "axiom = 'F%'\nangles = { '%' = 30 }"),
        ("Greek letter of the other turtle", "axiom = 'F[+F]'\nangles = { alpha = 30 }"),
        ("polygon never closed", "axiom = 'F[{.F.]'"),
        ("command of the other turtle", "axiom = 'F#'"),
        ("no angle, twice", "axiom = 'F+F-F'"),
        ("weights that make nothing", "axiom = 'A'\nproductions = ['A -> (0) F', 'A -> (0) FF']"),
    ] {
        let text = format!("[rule]\nturtle = 'heading'\n{body}\n");
        let shown = message(&text);
        assert!(shown.contains("help: "), "{name}: {shown}");
        all.push_str(&format!("── {name}\n{shown}\n"));
    }
    insta::assert_snapshot!("heading", all);
}

/// The caret stands under the character, whatever the string's quotes and whatever is wide.
#[test]
fn carets_stand_under_their_characters() {
    let mut all = String::new();
    for text in [
        "productions = ['ёлка', 'F(длина) → F(длина)[&F(ширина)]']",
        "productions = [\"F(a) → F(a)[\\\\F(0.5a)]\\u005d\"]",
        "productions = ['''F(é) ->\n  F(é)\n  [^F(0.5ü)]''']",
        "productions = [\"\"\"\nF(a) -> \\\n   F(a)[^F(0.5b)]\"\"\"]",
        "productions = ['F(木) -> F(木)] # 枝']",
        "\tproductions = ['\tF(a) ->\tF(a)\t]']",
    ] {
        let text =
            format!("# Ель – ель\n[rule]\r\naxiom = 'F(a)'\n{text}\nangles = {{ alpha = 30 }}\n");
        all.push_str(&format!("{}\n", message(&text)));
    }
    insta::assert_snapshot!("carets", all);
}

#[test]
fn several_mistakes_come_in_one_run() {
    let text = r"
colour = 'red'
kind = 'tree'
[rule]
axiom = 'F(a)['
productions = ['F(a) -> F(0.5c)', 'F(a) -> ]', 'G -> ']
iteration = 4
[size]
height_m = 'tall'
crown_base = 2.0
[bark]
relief = 1
";
    let error = load_text("birch", text).unwrap_err();
    assert!(error.count() >= 8, "{}", error.count());
    insta::assert_snapshot!("several", render(&error));
}
