//! A document as one page that needs nothing else: styles and plots within, no scripts. Read on a
//! screen from 400 pixels on, and on paper.

use std::fmt::Write;

use super::document::{
    About, Document, Fact, Finding, Front, Ladder, Omission, Omissions, Scaling, Timing, Truth,
};
use super::plot::{self, Plot};
use super::{grouped, significant};

const STYLE: &str = include_str!("page.css");

/// The page.
pub fn page(document: &Document) -> String {
    let mut out =
        String::from("<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    out.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
    let _ = writeln!(out, "<title>Larix report</title>\n<style>\n{STYLE}</style>\n</head>\n<body>");
    head(&mut out, document);
    facts(&mut out, &document.facts);
    chapter(&mut out, 1, "fronts", "Error against run time", FRONTS);
    document.fronts.iter().for_each(|f| front(&mut out, f));
    chapter(&mut out, 2, "convergence", "Convergence", CONVERGENCE);
    convergence(&mut out, &document.convergence);
    chapter(&mut out, 3, "stability", "Stability", STABILITY);
    stability(&mut out, &document.stability);
    chapter(&mut out, 4, "left-out", "Left out", LEFT_OUT);
    document.left_out.iter().for_each(|o| omissions(&mut out, o));
    chapter(&mut out, 5, "scale", "Scale", SCALE);
    document.scale.iter().for_each(|s| scaling(&mut out, s));
    out.push_str("</body>\n</html>\n");
    out
}

const FRONTS: &str = "Each point is a setting with its error and its seconds: medians of repeated runs, \
    with the least and the most. A ring marks the default. No setting is both quicker and more right \
    than those on the Pareto front.";
const CONVERGENCE: &str = "A step is halved and the error measured. It should fall with the stated \
    power of the step until a floor: e² = (c · h^order)² + floor². Where it does not, the table says so.";
const STABILITY: &str = "Extreme and stiff cases, run for this report. A miss is how far the outcome is \
    from what is expected: 0 is exact, and a case passes up to its limit.";
const LEFT_OUT: &str = "The same scene with and without each thing it can do without. The counts are \
    made where the work is done: a thing is proved to have been left out where its work is counted \
    with it and not once without. A camera leaves out by itself: what comes in its place is what it \
    spares a scene.";
const SCALE: &str = "Seconds and the most heap held at once against the size of the task, with the \
    fitted exponent: 1 is linear.";

fn chapter(out: &mut String, number: usize, id: &str, title: &str, lead: &str) {
    let _ = writeln!(out, "<h2 id=\"{id}\">{number}. {title}</h2>\n<p>{}</p>", escaped(lead));
}

fn head(out: &mut String, document: &Document) {
    let About { larix, subject, machine, is_quick, seed, seconds, warnings } = &document.about;
    let processor = match machine.processor.as_str() {
        "" => machine.system.clone(),
        name => format!("{name}, {}", machine.system),
    };
    let threads = format!("{} of {} cores", machine.threads, machine.cores);
    let build = if machine.has_assertions { " Built with debug assertions: slow." } else { "" };
    let quick = if *is_quick { " Quick: fewer settings, smaller tasks." } else { "" };
    let _ = writeln!(
        out,
        "<h1>Larix report</h1>\n<p class=\"about\">{} Larix {}, {}, {threads}, seed {seed}; measured in \
         {seconds:.0} s.{quick}{build}</p>",
        escaped(subject),
        escaped(larix),
        escaped(&processor),
    );
    let misses = document.stability.iter().filter(|f| !f.passes).count();
    let short = document.convergence.iter().filter(|l| !l.converges).count();
    let unproved: usize =
        document.left_out.iter().flat_map(|o| &o.rows).filter(|r| !r.is_proved).count();
    let tally = |bad: usize, all: usize, [good_text, bad_text]: [&str; 2]| match bad {
        0 => format!("<li>{all} of {all} {good_text}.</li>"),
        n => format!("<li class=\"miss\">{n} of {all} {bad_text}.</li>"),
    };
    let rows = document.left_out.iter().map(|o| o.rows.len()).sum();
    let _ = writeln!(
        out,
        "<ul>{}{}{}</ul>",
        tally(
            misses,
            document.stability.len(),
            [
                "extreme and stiff cases meet what is expected of them",
                "extreme and stiff cases miss what is expected of them",
            ]
        ),
        tally(
            short,
            document.convergence.len(),
            [
                "errors fall at least at their stated order, until a floor",
                "errors do not fall at their stated order"
            ]
        ),
        tally(
            unproved,
            rows,
            [
                "things left out are proved not to have been computed",
                "things left out are not proved not to have been computed",
            ]
        ),
    );
    for warning in warnings {
        let _ = writeln!(out, "<p class=\"warning\">Warning: {}</p>", escaped(warning));
    }
    out.push_str(
        "<nav><a href=\"#fronts\">Error against run time</a> <a href=\"#convergence\">Convergence</a> \
         <a href=\"#stability\">Stability</a> <a href=\"#left-out\">Left out</a> \
         <a href=\"#scale\">Scale</a></nav>\n",
    );
}

/// `numeric`: columns that are set to the right.
fn table(out: &mut String, heads: &[String], numeric: &[usize], rows: &[(Vec<String>, &str)]) {
    out.push_str("<div class=\"table\"><table><thead><tr>");
    let class = |k: usize| if numeric.contains(&k) { " class=\"number\"" } else { "" };
    for (k, head) in heads.iter().enumerate() {
        let _ = write!(out, "<th{}>{}</th>", class(k), escaped(head));
    }
    out.push_str("</tr></thead><tbody>\n");
    for (cells, kind) in rows {
        let kind = if kind.is_empty() { String::new() } else { format!(" class=\"{kind}\"") };
        let _ = write!(out, "<tr{kind}>");
        for (k, cell) in cells.iter().enumerate() {
            let _ = write!(out, "<td{}>{}</td>", class(k), escaped(cell));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn plots<'a>(out: &mut String, plots: impl IntoIterator<Item = &'a Plot>) {
    out.push_str("<div class=\"plots\">");
    for plot in plots {
        let (id, title) = (escaped(&plot.id), escaped(&plot.title));
        let svg =
            plot.svg.replacen("<svg ", &format!("<svg role=\"img\" aria-label=\"{title}\" "), 1);
        let _ = writeln!(out, "<figure id=\"plot-{id}\">{svg}</figure>");
    }
    out.push_str("</div>\n");
}

fn heading(out: &mut String, title: &str, lines: &[&str]) {
    let _ = writeln!(out, "<h3>{}</h3>", escaped(title));
    for line in lines.iter().filter(|l| !l.is_empty()) {
        let _ = writeln!(out, "<p>{}</p>", escaped(line));
    }
}

fn facts(out: &mut String, facts: &[Fact]) {
    if facts.is_empty() {
        return;
    }
    heading(out, "The usual run", &[]);
    let row = |f: &Fact| {
        let against = if f.truth == Truth::Counted { "" } else { f.truth.text() };
        (vec![f.of.label(), number(f.value), against.into()], "")
    };
    let rows: Vec<(Vec<String>, &str)> = facts.iter().map(row).collect();
    table(out, &["figure", "value", ""].map(String::from), &[1], &rows);
}

fn front(out: &mut String, front: &Front) {
    out.push_str("<section>\n");
    let truth = format!("{}, {}.", front.error.name, front.truth.text());
    heading(out, &front.title, &[&sentence(&truth), &front.note, &front.verdict]);
    out.push_str("<div class=\"pair\">\n");
    plots(out, &plot::of_front(front));
    let mut heads = vec!["setting".into(), front.error.label()];
    heads.extend(front.cost.as_ref().map(super::document::Quantity::label));
    let at = heads.len();
    heads.extend(["s, median", "least – most", "runs"].map(String::from));
    let of = front.cost.as_ref().map_or("seconds", |cost| &cost.name);
    heads.push(format!("front of {of}"));
    let rows: Vec<(Vec<String>, &str)> = front
        .points
        .iter()
        .map(|p| {
            let default = if p.is_default { " (default)" } else { "" };
            let mut cells = vec![format!("{}{default}", p.setting), number(p.error)];
            cells.extend(p.cost.map(number));
            cells.extend(timing(&p.time));
            cells.push(if p.is_on_front { "●".into() } else { String::new() });
            (cells, if p.is_default { "default" } else { "" })
        })
        .collect();
    let numeric: Vec<usize> = (1..at + 3).collect();
    table(out, &heads, &numeric, &rows);
    out.push_str("</div></section>\n");
}

fn convergence(out: &mut String, ladders: &[Ladder]) {
    for ladder in ladders {
        out.push_str("<section>\n");
        let truth = format!("{}, {}.", ladder.error.name, ladder.truth.text());
        let stated = format!("Stated order {}: {}.", ladder.stated_order, ladder.verdict);
        heading(out, &ladder.title, &[&sentence(&truth), &ladder.note]);
        let class = if ladder.converges { "met" } else { "miss" };
        let _ = writeln!(out, "<p class=\"{class}\">{}</p>", escaped(&stated));
        out.push_str("<div class=\"pair\">\n");
        plots(out, [&plot::of_ladder(ladder)]);
        let rows: Vec<(Vec<String>, &str)> = ladder
            .rungs
            .iter()
            .zip(ladder.orders())
            .map(|(r, order)| {
                let order = order.map_or(String::new(), |o| format!("{o:.2}"));
                (vec![number(r.step), number(r.error), order], "")
            })
            .collect();
        let heads = [ladder.step.label(), ladder.error.label(), "order from the last".into()];
        table(out, &heads, &[0, 1, 2], &rows);
        out.push_str("</div></section>\n");
    }
}

fn stability(out: &mut String, findings: &[Finding]) {
    let heads = ["stage", "input", "expected", "what happened", "limit", "s"].map(String::from);
    let rows: Vec<(Vec<String>, &str)> = findings
        .iter()
        .map(|f| {
            let happened =
                if f.passes { f.happened.clone() } else { format!("MISSED: {}", f.happened) };
            let cells = vec![
                f.stage.clone(),
                f.input.clone(),
                f.expected.clone(),
                happened,
                number(f.limit),
                number(f.seconds),
            ];
            (cells, if f.passes { "" } else { "miss" })
        })
        .collect();
    table(out, &heads, &[4, 5], &rows);
}

fn omissions(out: &mut String, omissions: &Omissions) {
    out.push_str("<section>\n");
    heading(out, &sentence(&omissions.subject), &[]);
    let heads = [
        "left out",
        "removed",
        "MB saved",
        "s with",
        "s without",
        "peak MB saved",
        "work counted with → without",
        "proved",
    ]
    .map(String::from);
    let row = |o: &Omission| {
        // Without the sign of what rounds to nothing.
        let megabytes = |b: i64| format!("{:.1}", (b as f64 * 1e-5).round() / 10.0 + 0.0);
        let seconds = |t: &Timing| {
            format!("{} ({}–{})", number(t.median_s), number(t.least_s), number(t.most_s))
        };
        let work: Vec<String> = o
            .work
            .iter()
            .map(|w| {
                let [with, without] = [w.with, w.without].map(|n| number(n as f64));
                format!("{}: {with} → {without}", w.of)
            })
            .collect();
        let cells = vec![
            o.what.clone(),
            o.removed.clone(),
            megabytes(o.bytes_saved),
            seconds(&o.with),
            seconds(&o.without),
            megabytes(o.peak_bytes_saved),
            work.join("; "),
            if o.is_proved { "yes" } else { "NO" }.to_owned(),
        ];
        (cells, if o.is_proved { "" } else { "miss" })
    };
    let rows: Vec<(Vec<String>, &str)> = omissions.rows.iter().map(row).collect();
    table(out, &heads, &[2, 3, 4, 5], &rows);
    out.push_str("</section>\n");
}

fn scaling(out: &mut String, scaling: &Scaling) {
    out.push_str("<section>\n");
    heading(out, &scaling.title, &[&scaling.note]);
    out.push_str("<div class=\"pair\">\n");
    plots(out, &plot::of_scaling(scaling));
    let heads = [
        "threads".into(),
        scaling.over.label(),
        "s, median".into(),
        "least – most".into(),
        "runs".into(),
        "peak MB".into(),
    ];
    let mut rows: Vec<(Vec<String>, &str)> = Vec::new();
    for s in &scaling.series {
        for p in &s.points {
            let mut cells = vec![s.threads.to_string(), number(p.count)];
            cells.extend(timing(&p.time));
            cells.push(number(p.peak_bytes as f64 * 1e-6));
            rows.push((cells, ""));
        }
        let power = |e: Option<f64>| e.map_or("–".into(), |e| format!("∝ n^{e:.2}"));
        let fits = [
            ("fitted to all", s.time_exponent, s.memory_exponent),
            ("the last two", s.last_time_exponent, s.last_memory_exponent),
        ];
        for (what, time, memory) in fits {
            let none = String::new;
            let cells =
                [s.threads.to_string(), what.into(), power(time), none(), none(), power(memory)];
            rows.push((cells.to_vec(), "default"));
        }
    }
    table(out, &heads, &[0, 1, 2, 3, 4, 5], &rows);
    out.push_str("</div></section>\n");
}

fn timing(t: &Timing) -> [String; 3] {
    let spread = format!("{} – {}", number(t.least_s), number(t.most_s));
    [number(t.median_s), spread, t.runs.to_string()]
}

/// Three digits; whole numbers in groups of three, tiny ones with a power of ten.
fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        v if v >= 1000.0 => {
            let sign = if value < 0.0 { "-" } else { "" };
            format!("{sign}{}", grouped(v.round() as u64))
        }
        v if v < 1e-4 => format!("{value:.1e}"),
        _ if value == value.trunc() => format!("{value}"),
        _ => significant(value),
    }
}

fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_readable() {
        let shown = [0.0, 0.00001234, 0.123456, 12.0, 1234567.0, -4321.0].map(number);
        let expected = ["0", "1.2e-5", "0.123", "12", "1\u{202f}234\u{202f}567", "-4\u{202f}321"];
        assert_eq!(shown, expected);
    }

    #[test]
    fn what_a_user_named_can_not_break_the_page() {
        assert_eq!(escaped("<b a=\"x\"> & y"), "&lt;b a=&quot;x&quot;&gt; &amp; y");
    }
}
