//! The lines of OBJ and MTL files, before a library reads them: that stops at a fault without saying where, and
//! trusts some numbers.

use std::path::Path;

use crate::diagnostic::{Error, Result};

/// What a model may have.
const MAX_TRIANGLES: usize = 200_000;
const MAX_CORNERS: usize = 4_096;
/// No number of a model is as large.
const FARTHEST: f32 = 1e6;
/// The texture coordinate of corners that have none, where others do.
pub const NO_UV: f32 = 2e30;

/// With lines that a backslash continues as one; as many lines as before.
pub fn joined(text: String) -> String {
    let is_open = |line: &str| line.ends_with('\\') && !line.trim_start().starts_with('#');
    if !text.lines().any(is_open) {
        return text;
    }
    let mut out = String::with_capacity(text.len() + 1);
    let mut left = 0;
    for line in text.lines() {
        if is_open(line) {
            out.extend([&line[..line.len() - 1], " "]);
            left += 1;
            continue;
        }
        out.push_str(line);
        out.extend(std::iter::repeat_n('\n', left + 1));
        left = 0;
    }
    out
}

/// What is known of a model's faces.
#[derive(Debug, Default)]
pub struct Faces {
    pub triangles: usize,
    /// Some corners have parts that others lack.
    pub is_mixed: bool,
}

/// A vetted model whose corners all have a texture coordinate and a normal: those that lack one get
/// [`NO_UV`], or a normal of no length.
pub fn alike(text: &str) -> String {
    let mut out = format!("vt {NO_UV} {NO_UV}\nvn 0 0 0\n");
    for line in text.lines() {
        let mut words = line.split_whitespace();
        if words.next() != Some("f") {
            out.extend([line, "\n"]);
            continue;
        }
        out.push('f');
        for word in words {
            let mut parts = word.split('/');
            let vertex = parts.next().unwrap_or_default();
            // The first of each is ours; from the end they count as they did.
            let [uv, normal] = [(); 2].map(|()| {
                let number = parts.next().and_then(|part| part.parse::<i64>().ok());
                number.map_or(1, |n| if n > 0 { n + 1 } else { n })
            });
            out.push_str(&format!(" {vertex}/{uv}/{normal}"));
        }
        out.push('\n');
    }
    out
}

/// Looks at every line of an OBJ file: numbers finite, faces of corners that exist.
pub fn vet_obj(path: &Path, text: &str) -> Result<Faces> {
    let (mut counts, mut faces) = ([0usize; 3], Faces::default());
    let mut kind: Option<[bool; 3]> = None;
    for (k, line) in text.lines().enumerate() {
        let fail = |what: String, remedy: &str| {
            Err(Error::new(what).in_file(format!("{}:{}", path.display(), k + 1)).remedy(remedy))
        };
        let mut words = line.split_whitespace();
        let (slot, least) = match words.next() {
            Some("v") => (0, 3),
            Some("vt") => (1, 2),
            Some("vn") => (2, 3),
            Some("f") => {
                let mut corners = 0usize;
                for word in words {
                    corners += 1;
                    match corner(word, counts) {
                        Err(what) => return fail(what, "export the model again"),
                        Ok(own) => faces.is_mixed |= *kind.get_or_insert(own) != own,
                    }
                }
                if corners < 3 {
                    return fail(format!("a face of {corners} corners"), "give it three or more");
                }
                if corners > MAX_CORNERS {
                    let what = format!("a face of {corners} corners, more than {MAX_CORNERS}");
                    return fail(what, "export the mesh as triangles");
                }
                faces.triangles += corners - 2;
                if faces.triangles > MAX_TRIANGLES {
                    let what = format!("more than {MAX_TRIANGLES} triangles");
                    return fail(what, "a twig is set thousands of times: give it fewer");
                }
                continue;
            }
            Some("usemtl") if words.next().is_none() => {
                return fail("usemtl names no material".into(), "name one, or leave the line out");
            }
            _ => continue,
        };
        let numbers: Option<Vec<f32>> =
            words.map(|w| w.parse().ok().filter(|x: &f32| x.is_finite())).collect();
        if let Some(far) = numbers.iter().flatten().find(|x| x.abs() >= FARTHEST) {
            let what = format!("{far} is more than {FARTHEST}");
            return fail(what, "move the model to its origin, where it joins its shoot");
        }
        match numbers {
            Some(numbers) if numbers.len() >= least => counts[slot] += 1,
            Some(numbers) => {
                let what = format!("{} numbers, not {least}", numbers.len());
                return fail(what, "export the model again");
            }
            None => return fail("not a list of ordinary numbers".into(), "export the model again"),
        }
    }
    Ok(faces)
}

/// Which of position, texture coordinate and normal a face's corner has; what is wrong with it.
fn corner(word: &str, counts: [usize; 3]) -> std::result::Result<[bool; 3], String> {
    const KINDS: [&str; 3] = ["vertex", "texture coordinate", "normal"];
    let mut has = [false; 3];
    let parts: Vec<&str> = word.split('/').collect();
    if parts.len() > 3 {
        return Err(format!("`{word}` is no corner of a face"));
    }
    for (slot, part) in parts.iter().enumerate().filter(|(slot, p)| *slot == 0 || !p.is_empty()) {
        let number: i64 = part.parse().map_err(|_| format!("`{word}` is no corner of a face"))?;
        let count = counts[slot] as i64;
        // Backwards from the last, or from the first; either must stand above.
        let is_known = (1..=count).contains(&number) || (-count..=-1).contains(&number);
        if !is_known {
            return Err(format!("{} {number} of {count} in `{word}`", KINDS[slot]));
        }
        has[slot] = true;
    }
    Ok(has)
}

/// Colours are three ordinary numbers.
pub fn vet_mtl(path: &Path, text: &str) -> Result<()> {
    for (k, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        if !matches!(words.next(), Some("Ka" | "Kd" | "Ks" | "Ke")) {
            continue;
        }
        let numbers = words.take(3).filter_map(|w| w.parse::<f32>().ok());
        if numbers.filter(|x| x.is_finite()).count() != 3 {
            let error = Error::new("not a colour of three numbers");
            let place = format!("{}:{}", path.display(), k + 1);
            return Err(error.in_file(place).remedy("write red, green and blue, 0 to 1"));
        }
    }
    Ok(())
}
