use super::*;

fn code(text: &str) -> Result<Code, Slip> {
    let locals = ["a".to_owned(), "w".to_owned()];
    let globals = [("k".to_owned(), Some(2.0)), ("zero".to_owned(), Some(0.0))];
    let mut cursor = Cursor::new(text);
    parse(&mut cursor, Scope { locals: &locals, globals: &globals })
}

fn value(text: &str) -> f64 {
    code(text).unwrap().value(&[3.0, 5.0], &[2.0, 0.0])
}

#[test]
fn precedence_is_that_of_mathematics() {
    for (text, expected) in [
        ("0.5a", 1.5),
        ("1/2a", 1.0 / 6.0),
        ("2a^2", 18.0),
        ("-2^2", -4.0),
        ("2^3^2", 512.0),
        ("2^-1", 0.5),
        ("1+2*3-4/8", 6.5),
        ("10-3-2", 5.0),
        ("2(a+1)", 8.0),
        ("a*w/k", 7.5),
        ("min(a,w)+max(a,w)", 8.0),
        ("sin(30)+cos(60)", 1.0),
        ("sqrt(16)+abs(-2)+floor(2.9)", 8.0),
        ("exp(ln(7))", 7.0),
        ("a > 2 && w <= 5", 1.0),
        ("a = 3 | w = 0", 1.0),
        ("!(a < w)", 0.0),
        ("1e-2 * 2e3", 20.0),
        ("a - -w", 8.0),
    ] {
        assert!((value(text) - expected).abs() < 1e-12, "{text} = {}", value(text));
    }
}

#[test]
fn multiples_are_seen_through_constants() {
    let shape = |t: &str| code(t).unwrap().shape(&[2.0, 0.0]);
    assert_eq!(shape("0.5a"), Shape::Scaled { local: 0, factor: 0.5 });
    assert_eq!(shape("-w*k/8"), Shape::Scaled { local: 1, factor: -0.25 });
    assert_eq!(shape("k^3"), Shape::Constant(8.0));
    assert_eq!(shape("a+1"), Shape::Other);
}

#[test]
fn mistakes_point_at_themselves() {
    for (text, span, message) in [
        ("b", 0..1, "unknown name `b`"),
        ("1/(k-2)", 2..7, "division by zero"),
        ("1/zero", 2..6, "division by zero"),
        ("(a", 0..1, "`(` without `)`"),
        ("a+", 2..2, "expected a value, found the end"),
        ("min(a)", 0..6, "`min` takes 2 arguments, 1 given"),
        ("sqrt a", 0..4, "`sqrt` is a function"),
        ("sqrt(-1)", 0..8, "this has no finite value"),
        ("1.5.a", 3..4, "expected"),
    ] {
        match code(text) {
            Err(slip) => {
                assert_eq!(slip.span, span, "{text}: {}", slip.message);
                assert!(slip.message.contains(message), "{text}: {}", slip.message);
            }
            // What follows a whole expression is the caller's to judge.
            Ok(_) => assert_eq!(text, "1.5.a"),
        }
    }
    assert!(code(&"(".repeat(100_000)).is_err());
    assert!(code(&"-".repeat(100_000)).is_err());
    assert!(code(&"a^".repeat(100_000)).is_err());
}
