//! Errors and warnings as a person reads them: what is wrong, in which file, where, and what to
//! do about it. With source text at hand, a caret under the character.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use miette::{LabeledSpan, MietteError, MietteSpanContents, SourceCode, SourceSpan, SpanContents};

pub type Result<T> = std::result::Result<T, Error>;

/// One or several things that are wrong, each with its place and remedy.
pub struct Error(Box<Inner>);

#[derive(Default)]
struct Inner {
    message: String,
    file: Option<PathBuf>,
    remedy: Option<String>,
    source: Option<Source>,
    labels: Vec<LabeledSpan>,
    others: Vec<Error>,
    warnings: Vec<String>,
}

impl Error {
    /// `message`: one line that says what is wrong, naming the place inside the file if known.
    pub fn new(message: impl Into<String>) -> Self {
        Error(Box::new(Inner { message: message.into(), ..Inner::default() }))
    }

    /// Names the file; shown before the message.
    pub fn in_file(mut self, path: impl AsRef<Path>) -> Self {
        self.0.file = Some(path.as_ref().to_path_buf());
        self
    }

    /// Says what the user can do.
    pub fn remedy(mut self, text: impl Into<String>) -> Self {
        self.0.remedy = Some(text.into());
        self
    }

    /// Says what was noticed before, which may be why; shown above the message.
    pub fn noticed(mut self, warnings: Vec<String>) -> Self {
        self.0.warnings.extend(warnings);
        self
    }

    /// Shows `text` of the source called `name` with a caret under the bytes `span`. Where lines
    /// are too long to show, line and column stand behind the name instead.
    pub fn at(
        mut self,
        name: &str,
        text: impl Into<Arc<str>>,
        span: Range<usize>,
        label: &str,
    ) -> Self {
        let text: Arc<str> = text.into();
        if !is_shown(&text, &span) {
            let before = text.get(..span.start).unwrap_or("");
            let line = before.matches('\n').count() + 1;
            let column = column(&text, span.start) + 1;
            return self.in_file(format!("{name}:{line}:{column}"));
        }
        self.0.source = Some(Source { name: name.to_owned(), text });
        let span = SourceSpan::new(span.start.into(), span.end.saturating_sub(span.start));
        self.0.labels.push(LabeledSpan::new_with_span(Some(label.to_owned()), span));
        self
    }

    /// Several errors found in one pass, as one flat list; `errors` must not be empty.
    pub fn several(errors: Vec<Error>) -> Self {
        let mut flat = errors.into_iter().flat_map(|mut e| {
            let others = std::mem::take(&mut e.0.others);
            std::iter::once(e).chain(others)
        });
        let mut first = flat.next().unwrap_or_else(|| Error::new("unknown error"));
        first.0.others.extend(flat);
        first
    }

    /// The message without file, remedy or source.
    pub fn message(&self) -> &str {
        &self.0.message
    }

    pub fn remedy_text(&self) -> Option<&str> {
        self.0.remedy.as_deref()
    }

    /// Line and column of the first caret, from 1.
    pub fn line_and_column(&self) -> Option<(usize, usize)> {
        let text = &self.0.source.as_ref()?.text;
        let before = text.get(..self.0.labels.first()?.offset())?;
        let line = before.rfind('\n').map_or(before, |i| &before[i + 1..]);
        Some((before.matches('\n').count() + 1, line.chars().count() + 1))
    }

    /// Each thing wrong, this one first.
    pub fn each(&self) -> impl Iterator<Item = &Error> {
        std::iter::once(self).chain(&self.0.others)
    }

    /// Whether every caret stands under whole characters of its source.
    pub fn labels_lie_within(&self) -> bool {
        let lies = |label: &LabeledSpan| {
            let span = label.offset()..label.offset() + label.len();
            self.0.source.as_ref().is_some_and(|s| s.text.get(span).is_some())
        };
        self.0.labels.iter().all(lies) && self.0.others.iter().all(Error::labels_lie_within)
    }

    /// The number of things wrong.
    pub fn count(&self) -> usize {
        1 + self.0.others.iter().map(Error::count).sum::<usize>()
    }
}

/// A named text whose columns count characters, as editors do.
struct Source {
    name: String,
    text: Arc<str>,
}

impl SourceCode for Source {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        lines_before: usize,
        lines_after: usize,
    ) -> std::result::Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let shown = self.text.read_span(span, lines_before, lines_after)?;
        Ok(Box::new(MietteSpanContents::new_named(
            self.name.clone(),
            shown.data(),
            *shown.span(),
            shown.line(),
            column(&self.text, span.offset()),
            shown.line_count(),
        )))
    }
}

/// Characters between the start of the line and byte `at`.
fn column(text: &str, at: usize) -> usize {
    text.get(..at).unwrap_or("").rsplit('\n').next().unwrap_or("").chars().count()
}

/// Whether the lines of `span` and those beside it are short enough to be shown.
fn is_shown(text: &str, span: &Range<usize>) -> bool {
    const LONGEST: usize = 4000;
    let before = text.get(..span.start).unwrap_or("").rsplit('\n').take(2);
    let after = text.get(span.end.max(span.start)..).unwrap_or("").split('\n').take(2);
    span.len() <= LONGEST && before.chain(after).map(str::len).max().unwrap_or(0) <= LONGEST
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0.file {
            Some(file) => write!(f, "{}: {}", file.display(), self.0.message),
            None => f.write_str(&self.0.message),
        }
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")?;
        if let Some(remedy) = &self.0.remedy {
            write!(f, " (remedy: {remedy})")?;
        }
        for other in &self.0.others {
            write!(f, "; {other:?}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Error {}

impl miette::Diagnostic for Error {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.0.remedy.as_ref().map(|r| Box::new(r) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn miette::SourceCode> {
        self.0.source.as_ref().map(|s| s as &dyn miette::SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        (!self.0.labels.is_empty()).then(|| Box::new(self.0.labels.iter().cloned()) as Box<_>)
    }
}

/// Renders an error as shown on a terminal, without colour, 100 columns wide.
pub fn render(error: &Error) -> String {
    let warnings = error.each().flat_map(|e| &e.0.warnings);
    let before: String = warnings.map(|warning| format!("warning: {warning}\n")).collect();
    let handler =
        miette::GraphicalReportHandler::new_themed(miette::GraphicalTheme::unicode_nocolor())
            .with_width(100);
    let shown = error.each().map(|error| {
        let mut out = String::new();
        match handler.render_report(&mut out, error) {
            Ok(()) => out,
            Err(_) => format!("{error:?}\n"),
        }
    });
    before + &shown.collect::<Vec<_>>().join("\n")
}

/// A value together with what the user should know about it.
#[derive(Debug, Clone)]
pub struct Warned<T> {
    pub value: T,
    /// One sentence each.
    pub warnings: Vec<String>,
}

impl<T> Warned<T> {
    pub fn new(value: T) -> Self {
        Warned { value, warnings: Vec::new() }
    }

    pub fn with(value: T, warnings: Vec<String>) -> Self {
        Warned { value, warnings }
    }

    /// Moves the warnings into `sink` and gives the value.
    pub fn into_value(self, sink: &mut Vec<String>) -> T {
        sink.extend(self.warnings);
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shows_file_remedy_and_caret() {
        let text = "angle = 30\nangel = 40\n";
        let error = Error::new("unknown key `angel`")
            .in_file("birch.toml")
            .at("birch.toml", text, 11..16, "here")
            .remedy("did you mean `angle`?");
        let shown = render(&error);
        assert!(shown.contains("birch.toml: unknown key `angel`"), "{shown}");
        assert!(shown.contains("birch.toml:2:1"), "{shown}");
        assert_eq!(error.line_and_column(), Some((2, 1)));
        assert!(shown.contains("did you mean `angle`?"), "{shown}");
    }

    #[test]
    fn what_was_noticed_stands_above_the_message() {
        let error = Error::new("no trees").noticed(vec!["one point".into(), "no ground".into()]);
        let shown = render(&error.in_file("a.laz"));
        assert!(shown.starts_with("warning: one point\nwarning: no ground\n"), "{shown}");
        assert!(shown.contains("a.laz: no trees"), "{shown}");
    }

    #[test]
    fn lines_too_long_to_show_are_named() {
        let text = format!("a = 1\nb = '{}", "é".repeat(70_000));
        let shown = render(&Error::new("no end").at("birch.toml", text.as_str(), 6..7, "here"));
        assert!(shown.contains("birch.toml:2:1: no end"), "{shown}");
        let last = text.len() - 2..text.len();
        let shown = render(&Error::new("no end").at("birch.toml", text, last, "here"));
        assert!(shown.contains("birch.toml:2:70005: no end"), "{shown}");
    }

    #[test]
    fn several_errors_are_counted_and_all_shown() {
        let error = Error::several(vec![Error::new("one"), Error::new("two"), Error::new("three")]);
        assert_eq!(error.count(), 3);
        let nested = Error::several(vec![Error::new("zero"), error]);
        let messages: Vec<&str> = nested.each().map(Error::message).collect();
        assert_eq!(messages, ["zero", "one", "two", "three"]);
        let error = nested;
        let shown = render(&error);
        assert_eq!(
            shown.lines().collect::<Vec<_>>(),
            ["  × zero", "", "  × one", "", "  × two", "", "  × three",]
        );
    }
}
