//! Plots of a report as SVG, on logarithmic axes. What is 0 lies on the lower edge.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::document::{Document, Front, Ladder, Scaling, Timing};
use super::significant;
use super::stats;

/// Pixels of a plot; small, so that its words can be read on a telephone.
const WIDTH: u32 = 520;
const HEIGHT: u32 = 340;
/// Of one row of the legend.
const ROW: u32 = 20;
const FONT: (&str, i32) = ("sans-serif", 15);

/// Told apart by any eye (Okabe & Ito 2008); marks differ too.
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(130, 100, 0),
    RGBColor(60, 60, 60),
];
const FRONT: RGBColor = RGBColor(90, 90, 90);

/// A plot with a name for its file and its place on the page.
pub struct Plot {
    pub id: String,
    pub title: String,
    pub svg: String,
}

struct Chart {
    title: String,
    x: String,
    y: String,
    groups: Vec<Group>,
    /// Lines beneath all others, and what they are.
    line: Option<(String, Vec<Vec<[f64; 2]>>)>,
}

struct Group {
    name: String,
    marks: Vec<Mark>,
    is_joined: bool,
}

struct Mark {
    at: [f64; 2],
    /// Least and most along x, along y.
    spread: [Option<[f64; 2]>; 2],
    is_default: bool,
}

/// Every plot of a document, in its order.
pub fn all(document: &Document) -> Vec<Plot> {
    let fronts = document.fronts.iter().flat_map(of_front);
    let ladders = document.convergence.iter().map(of_ladder);
    let scales = document.scale.iter().flat_map(of_scaling);
    fronts.chain(ladders).chain(scales).collect()
}

/// Error against seconds, and against the other cost where there is one.
pub fn of_front(front: &Front) -> Vec<Plot> {
    let against_time = front_chart(front, "seconds", |p| Some(p.time.median_s), true);
    let mut plots = vec![against_time.drawn(&front.id)];
    if let Some(cost) = &front.cost {
        let chart = front_chart(front, &cost.label(), |p| p.cost, false);
        plots.push(chart.drawn(&format!("{}-cost", front.id)));
    }
    plots
}

fn front_chart(
    front: &Front,
    x: &str,
    cost: impl Fn(&super::document::Point) -> Option<f64>,
    has_spread: bool,
) -> Chart {
    let mut groups: Vec<Group> = Vec::new();
    let at = |p: &super::document::Point| {
        let x = cost(p).filter(|x| x.is_finite() && p.error.is_finite())?;
        Some([x, p.error])
    };
    for p in &front.points {
        let Some(at) = at(p) else { continue };
        let spread = [has_spread.then_some([p.time.least_s, p.time.most_s]), None];
        let mark = Mark { at, spread, is_default: p.is_default };
        match groups.iter_mut().find(|g| g.name == p.group) {
            Some(group) => group.marks.push(mark),
            None => {
                groups.push(Group { name: p.group.clone(), marks: vec![mark], is_joined: false })
            }
        }
    }
    let subjects = front.subjects();
    let lines = subjects.iter().map(|s| stairs(s.iter().filter_map(|p| at(p)).collect()));
    Chart {
        title: front.title.clone(),
        x: x.to_owned(),
        y: front.error.label(),
        groups,
        line: Some(("Pareto front".into(), lines.collect())),
    }
}

/// The front of some pairs, as steps.
fn stairs(pairs: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let is_on = stats::pareto(&pairs);
    let mut on: Vec<[f64; 2]> =
        pairs.into_iter().zip(is_on).filter(|(_, on)| *on).map(|(p, _)| p).collect();
    on.sort_by(|a, b| a[0].total_cmp(&b[0]));
    on.windows(2).flat_map(|w| [w[0], [w[1][0], w[0][1]]]).chain(on.last().copied()).collect()
}

/// Error against step, with the fit.
pub fn of_ladder(ladder: &Ladder) -> Plot {
    let mark = |r: &super::document::Rung| Mark {
        at: [r.step, r.error],
        spread: [None, None],
        is_default: false,
    };
    let marks: Vec<Mark> = ladder.rungs.iter().map(mark).collect();
    let line = ladder.fit.map(|f| {
        let at = |step: f64| (f.factor * step.powf(f.order)).hypot(f.floor);
        let line = ladder.rungs.iter().map(|r| [r.step, at(r.step)]).collect();
        (format!("order {:.2}", f.order), vec![line])
    });
    let group = Group { name: "measured".into(), marks, is_joined: false };
    Chart {
        title: ladder.title.clone(),
        x: ladder.step.label(),
        y: ladder.error.label(),
        groups: vec![group],
        line,
    }
    .drawn(&ladder.id)
}

/// Seconds, and megabytes, against the count.
pub fn of_scaling(scaling: &Scaling) -> [Plot; 2] {
    let chart = |what: &str, of: &dyn Fn(&super::document::Scaled) -> (f64, Option<Timing>)| {
        let group = |s: &super::document::Series| {
            let mark = |p: &super::document::Scaled| {
                let (y, time) = of(p);
                let spread = [None, time.map(|t| [t.least_s, t.most_s])];
                Mark { at: [p.count, y], spread, is_default: false }
            };
            let name = match s.threads {
                1 => "1 thread".to_owned(),
                n => format!("{n} threads"),
            };
            Group { name, marks: s.points.iter().map(mark).collect(), is_joined: true }
        };
        Chart {
            title: format!("{}: {what}", scaling.title),
            x: scaling.over.label(),
            y: what.to_owned(),
            groups: scaling.series.iter().map(group).collect(),
            line: None,
        }
    };
    let seconds = chart("seconds", &|p| (p.time.median_s, Some(p.time)));
    let memory = chart("peak MB", &|p| (p.peak_bytes as f64 * 1e-6, None));
    [seconds.drawn(&scaling.id), memory.drawn(&format!("{}-memory", scaling.id))]
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

impl Chart {
    /// Without marks, or where it can't be drawn, an empty picture that says so.
    fn drawn(&self, id: &str) -> Plot {
        let size = (WIDTH, HEIGHT + ROW * self.legend_rows());
        let mut svg = String::new();
        let marks = self.groups.iter().map(|g| g.marks.len()).sum::<usize>();
        if marks == 0 || self.draw(SVGBackend::with_string(&mut svg, size)).is_err() {
            svg = format!(
                "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"60\" \
                 viewBox=\"0 0 {WIDTH} 60\"><text x=\"10\" y=\"30\">nothing was measured</text></svg>"
            );
        }
        Plot { id: id.to_owned(), title: self.title.clone(), svg }
    }

    fn legend_rows(&self) -> u32 {
        self.legend().chunks(PER_ROW).count() as u32
    }

    /// What is drawn how.
    fn legend(&self) -> Vec<(&str, Sign)> {
        let marks = self
            .groups
            .iter()
            .enumerate()
            .map(|(k, g)| (g.name.as_str(), Sign::Mark(k, g.is_joined)));
        let is_default = self.groups.iter().flat_map(|g| &g.marks).any(|m| m.is_default);
        let ring = is_default.then_some(("default", Sign::Ring));
        let line = self.line.iter().map(|l| (l.0.as_str(), Sign::Line));
        marks.chain(ring).chain(line).collect()
    }

    fn draw(&self, backend: SVGBackend<'_>) -> Drawn {
        let root = backend.into_drawing_area();
        root.fill(&WHITE)?;
        let (upper, lower) = root.split_vertically(HEIGHT);
        self.draw_chart(&upper)?;
        for (k, (name, sign)) in self.legend().into_iter().enumerate() {
            let x = 12 + (k % PER_ROW) as i32 * (WIDTH as i32 / PER_ROW as i32);
            let y = 8 + (k / PER_ROW) as i32 * ROW as i32;
            let way = [(x, y), (x + 18, y)];
            match sign {
                Sign::Mark(k, is_joined) => {
                    if is_joined {
                        lower.draw(&PathElement::new(way, colour(k).stroke_width(2)))?;
                    }
                    draw_mark(&lower, k, (x + 9, y))?;
                }
                Sign::Ring => lower.draw(&Circle::new((x + 9, y), 7, BLACK.stroke_width(2)))?,
                Sign::Line => lower.draw(&PathElement::new(way, FRONT.stroke_width(1)))?,
            }
            lower.draw(&Text::new(name.to_owned(), (x + 26, y - 8), FONT))?;
        }
        root.present()
    }

    fn draw_chart(&self, area: &Area<'_>) -> Drawn {
        let line = self.line.iter().flat_map(|l| l.1.iter().flatten().copied());
        let marks = self.groups.iter().flat_map(|g| &g.marks);
        let at = marks.clone().map(|m| m.at).chain(line);
        let spread = |k: usize| marks.clone().filter_map(move |m| m.spread[k]).flatten();
        let x = decades(at.clone().map(|p| p[0]).chain(spread(0)));
        let y = decades(at.map(|p| p[1]).chain(spread(1)));
        let place = |[px, py]: [f64; 2]| (px.max(x.start), py.max(y.start));
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, ("sans-serif", 17))
            .margin(10)
            .margin_right(24)
            .x_label_area_size(44)
            .y_label_area_size(70)
            .build_cartesian_2d(
                x.clone().log_scale().with_key_points(ticks(&x)),
                y.clone().log_scale().with_key_points(ticks(&y)),
            )?;
        chart
            .configure_mesh()
            .x_desc(&self.x)
            .y_desc(&self.y)
            .label_style(FONT)
            .axis_desc_style(FONT)
            .light_line_style(WHITE.mix(0.0))
            .bold_line_style(RGBColor(222, 222, 222))
            .x_label_formatter(&|v| number(*v))
            .y_label_formatter(&|v| number(*v))
            .draw()?;
        for line in self.line.iter().flat_map(|l| &l.1) {
            let line = line.iter().map(|p| place(*p));
            chart.draw_series(LineSeries::new(line, FRONT.stroke_width(1)))?;
        }
        for (k, group) in self.groups.iter().enumerate() {
            let colour = colour(k);
            if group.is_joined {
                let line = group.marks.iter().map(|m| place(m.at));
                chart.draw_series(LineSeries::new(line, colour.stroke_width(2)))?;
            }
            for mark in &group.marks {
                let [mx, my] = mark.at;
                let along = mark.spread[0].map(|[a, b]| [place([a, my]), place([b, my])]);
                let up = mark.spread[1].map(|[a, b]| [place([mx, a]), place([mx, b])]);
                for way in along.into_iter().chain(up) {
                    chart.draw_series([PathElement::new(way, colour.mix(0.6).stroke_width(1))])?;
                }
                draw_mark(area, k, chart.backend_coord(&place(mark.at)))?;
            }
        }
        // Over all marks, that none hides them.
        for mark in self.groups.iter().flat_map(|g| &g.marks).filter(|m| m.is_default) {
            let pixel = chart.backend_coord(&place(mark.at));
            area.draw(&Circle::new(pixel, 7, BLACK.stroke_width(2)))?;
        }
        Ok(())
    }
}

/// Entries of the legend beside each other.
const PER_ROW: usize = 3;

enum Sign {
    /// Of a group, and whether a line joins its marks.
    Mark(usize, bool),
    Ring,
    Line,
}

fn colour(group: usize) -> RGBColor {
    COLOURS[group % COLOURS.len()]
}

fn draw_mark(area: &Area<'_>, group: usize, at: (i32, i32)) -> Drawn {
    let style = colour(group).filled();
    let (x, y) = at;
    match group % 4 {
        0 => area.draw(&Circle::new(at, 4, style)),
        1 => area.draw(&TriangleMarker::new(at, 5, style)),
        2 => area.draw(&Rectangle::new([(x - 4, y - 4), (x + 4, y + 4)], style)),
        _ => area.draw(&Cross::new(at, 4, colour(group).stroke_width(3))),
    }
}

/// A range that holds the positive values with room at both ends.
fn decades(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (mut least, mut most, mut has_zero) = (f64::INFINITY, 0.0f64, false);
    for v in values.filter(|v| v.is_finite()) {
        has_zero |= v <= 0.0;
        if v > 0.0 {
            least = least.min(v);
            most = most.max(v);
        }
    }
    if most <= 0.0 {
        return 0.1..1.0;
    }
    // A step of its own for zeros.
    let below = if has_zero { 4.0 } else { 1.4 };
    let (low, high) = (least / below, most * 1.4);
    if high / low < 4.0 { low / 2.0..high * 2.0 } else { low..high }
}

/// 1, 2 and 5 times powers of ten within a range; powers alone where those are many.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    const MANY: usize = 8;
    let (low, high) = (range.start.log10().floor() as i32, range.end.log10().ceil() as i32);
    let of = |parts: &[f64]| -> Vec<f64> {
        let all = (low..=high).flat_map(|k| parts.iter().map(move |p| p * 10f64.powi(k)));
        all.filter(|t| range.contains(t)).collect()
    };
    let fine = of(&[1.0, 2.0, 5.0]);
    if fine.len() > MANY { of(&[1.0]) } else { fine }
}

/// Plain where it is short, else with a power of ten.
fn number(value: f64) -> String {
    match value.abs() {
        v if (1e-3..1e4).contains(&v) => {
            let text = significant(value);
            match text.contains('.') {
                true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
                false => text,
            }
        }
        _ => format!("{value:.0e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_hold_all_and_zeros_have_room_below() {
        let r = decades([2.0, 50.0].into_iter());
        assert!(r.start < 2.0 && r.end > 50.0);
        let r = decades([0.0, 2.0, 2.0].into_iter());
        assert!(r.start <= 0.5 && r.end > 2.0);
        assert!(decades(std::iter::empty()).start > 0.0);
    }

    #[test]
    fn there_are_ticks_in_every_range_and_not_too_many() {
        assert_eq!(ticks(&(0.9..6.0)), [1.0, 2.0, 5.0]);
        assert_eq!(ticks(&(0.5..5e3)), [1.0, 10.0, 100.0, 1000.0]);
        for k in 0..40 {
            let low = 1e-3 * 1.7f64.powi(k);
            assert!((1..=8).contains(&ticks(&(low..4.1 * low)).len()), "{low}");
        }
    }

    #[test]
    fn labels_are_short() {
        assert_eq!([0.5, 100.0, 1e6, 2e-4].map(number), ["0.5", "100", "1e6", "2e-4"]);
    }
}
