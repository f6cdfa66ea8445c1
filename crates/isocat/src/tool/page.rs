//! A text with comments in the syntax of its language.

use isocat_descriptions::columns::{WIDTH, wrap};

use super::{Device, Sheet};

/// A text under construction.
pub(super) struct Page {
    text: String,
    /// Marks before and after a line of comment.
    marks: [&'static str; 2],
}

impl Page {
    /// A page of a language whose comments go to the end of the line.
    pub fn new(mark: &'static str) -> Self {
        Self::between(mark, "")
    }

    /// A page of a language whose comments end with a mark.
    pub fn between(begin: &'static str, end: &'static str) -> Self {
        Self { text: String::new(), marks: [begin, end] }
    }

    /// Adds a line unchanged.
    pub fn line(&mut self, line: impl AsRef<str>) {
        self.text.push_str(line.as_ref());
        self.text.push('\n');
    }

    /// Adds a comment, in as many lines as needed.
    pub fn note(&mut self, indent: usize, words: impl AsRef<str>) {
        let [begin, end] = self.marks;
        let room = WIDTH - indent - begin.len() - end.len();
        for line in wrap(words.as_ref(), room) {
            // The user may choose names: `--` would end an XML comment, and a `\` at the end would
            // join two lines of C.
            let line = if end.is_empty() { line } else { line.replace("--", "- -") };
            let line = line.strip_suffix('\\').unwrap_or(&line);
            self.line(format!("{:indent$}{begin}{line}{end}", ""));
        }
    }

    /// Adds the head of every file: its source, whether the plan fits, and the assumptions.
    pub fn head(&mut self, sheet: &Sheet, what: &str) {
        self.note(0, format!("{what} Made of {} by isocat plan.", sheet.source));
        self.note(0, &sheet.verdict);
        for assumption in &sheet.assumptions {
            self.note(0, format!("Assumed: {assumption}"));
        }
        for note in &sheet.notes {
            self.note(0, format!("Note: {note}"));
        }
    }

    /// Adds the description of a SubDevice, before its part.
    pub fn device(&mut self, indent: usize, device: &Device) {
        self.note(
            indent,
            format!("SubDevice {} ({}): {}.", device.position, device.name, device.why_mode),
        );
        for note in &device.notes {
            self.note(indent, format!("Note: {note}"));
        }
        if let Some(limit) = device.drives_left_out() {
            self.note(indent, format!("LIMIT: {limit}"));
        }
    }

    /// Adds the limits of the tool, with alternatives.
    pub fn limits(&mut self, indent: usize, limits: &[String]) {
        for limit in limits {
            self.note(indent, format!("LIMIT: {limit}"));
        }
    }

    /// The whole text.
    pub fn end(self) -> String {
        self.text
    }
}
