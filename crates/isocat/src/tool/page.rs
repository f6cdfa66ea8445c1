//! A text with comments in the marks of its language.

use isocat_descriptions::columns::{WIDTH, wrap};

use super::{Device, Sheet};

/// A text in the making.
pub(super) struct Page {
    text: String,
    /// What stands before and behind a line of comment.
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

    /// A line as it is.
    pub fn line(&mut self, line: impl AsRef<str>) {
        self.text.push_str(line.as_ref());
        self.text.push('\n');
    }

    /// A comment, in as many lines as it takes.
    pub fn note(&mut self, indent: usize, words: impl AsRef<str>) {
        let [begin, end] = self.marks;
        let room = WIDTH - indent - begin.len() - end.len();
        for line in wrap(words.as_ref(), room) {
            // Of names that a user chose: `--` ends a comment of XML, and a last `\` joins two
            // lines of C.
            let line = if end.is_empty() { line } else { line.replace("--", "- -") };
            let line = line.strip_suffix('\\').unwrap_or(&line);
            self.line(format!("{:indent$}{begin}{line}{end}", ""));
        }
    }

    /// The head of every file: of what it is made, whether that fits, what is not sure.
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

    /// What a SubDevice is and how it works, before its part.
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

    /// What the tool can't do, and what to do instead.
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
