//! From bytes to elements: encodings, places, numbers.
//!
//! The parser is a library. Encodings are UTF-8, and Latin-1 if the file declares it; configuration
//! tools write no others.

use std::borrow::Cow;

use roxmltree::{Document, Node, ParsingOptions};

use super::warning::{Warning, WarningKind};
use crate::document::{FileError, Source, Wrong};
use crate::esi::guard;
use crate::limits;

/// The text of a file, and whether text comes before its declaration.
pub(super) fn decode<'a>(path: &str, bytes: &'a [u8]) -> Result<(Cow<'a, str>, bool)> {
    let error = |at: usize, message: String| {
        let before = String::from_utf8_lossy(&bytes[..at]);
        Source { path, text: &before }.error(before.len(), message)
    };
    limits::check(path, bytes.len(), limits::XML)?;
    let bytes = bytes.strip_prefix(&[0xEF, 0xBB, 0xBF]).unwrap_or(bytes);
    if bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) {
        return Err(error(0, "UTF-16; expected UTF-8 or ISO-8859-1".into()));
    }
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]).to_lowercase();
    let declaration = head.split_once("<?xml").and_then(|(_, rest)| Some(rest.split_once("?>")?.0));
    let latin1 =
        declaration.is_some_and(|words| words.contains("8859-1") || words.contains("1252"));
    let text: Cow<'a, str> = match std::str::from_utf8(bytes) {
        Ok(text) => text.into(),
        Err(_) if latin1 => bytes.iter().map(|byte| char::from(*byte)).collect::<String>().into(),
        Err(at) => {
            let at = at.valid_up_to();
            let message =
                format!("byte 0x{:02X} is no UTF-8, and no other encoding is declared", bytes[at]);
            return Err(error(at, message));
        }
    };
    match text.find("<?xml") {
        // It is replaced by blanks, so that places stay those of the file.
        Some(at) if !text[..at].trim().is_empty() => {
            let blank = |c: char| if c == '\n' { '\n' } else { ' ' };
            let before: String = text[..at].chars().map(blank).collect();
            Ok((format!("{before}{}", &text[at..]).into(), true))
        }
        _ => Ok((text, false)),
    }
}

/// The tree of a text. A declaration that is not at its beginning is accepted.
pub(super) fn parse<'a>(path: &str, text: &'a str) -> Result<(Document<'a>, usize)> {
    let start = text.len() - text.trim_start().len();
    guard(&text[start..])
        .map_err(|problem| Source { path, text }.error(start + problem.at, problem.message))?;
    let options = ParsingOptions { nodes_limit: limits::NODES, ..ParsingOptions::default() };
    match Document::parse_with_options(&text[start..], options) {
        Ok(document) => Ok((document, start)),
        Err(error) => {
            let place = error.pos();
            let message = error.to_string();
            let message = message.rsplit_once(" at ").map_or(&*message, |(words, _)| words);
            let above = text[..start].matches('\n').count();
            Err(FileError::new(Wrong {
                path: path.to_owned(),
                line: above + place.row as usize,
                column: place.col as usize,
                message: format!("not well-formed XML: {message}"),
                hint: None,
            }))
        }
    }
}

/// The common data of all readers: the text for places, and the warnings.
pub(super) struct Reader<'t> {
    pub source: Source<'t>,
    /// Bytes before the parsed text.
    pub start: usize,
    pub warnings: Vec<Warning>,
}

pub(super) type Result<T> = std::result::Result<T, FileError>;

impl Reader<'_> {
    /// An error at an element.
    pub fn error(&self, at: Node, message: impl Into<String>) -> FileError {
        self.source.error(self.start + at.range().start, message)
    }

    /// Notes a doubt.
    pub fn warn(&mut self, kind: WarningKind, at: Node, message: impl Into<String>) {
        let error = self.error(at, message);
        let (line, column, message) = (error.line, error.column, error.message.clone());
        self.warnings.push(Warning { kind, line, column, message });
    }

    /// The number in a child; `None` without the child.
    pub fn number<T: TryFrom<i64>>(&mut self, of: Node, name: &str) -> Result<Option<T>> {
        child(of, name).map(|node| self.number_of(node)).transpose()
    }

    /// The number in an element.
    pub fn number_of<T: TryFrom<i64>>(&mut self, node: Node) -> Result<T> {
        let text = text(node);
        let name = node.tag_name().name();
        let prefix =
            ["#x", "#X", "0x", "0X"].into_iter().find_map(|prefix| text.strip_prefix(prefix));
        let value = match prefix {
            Some(hex) if hex.chars().all(|c| c.is_ascii_hexdigit()) => i64::from_str_radix(hex, 16),
            _ => text.parse::<i64>(),
        };
        let value = value.map_err(|_| {
            self.error(node, format!("{name} \"{text}\" is no number; expected decimal digits"))
        })?;
        // PDOs keep the `#x` of the device description; elsewhere numbers are decimal.
        if prefix.is_some() && !text.starts_with('#') {
            let message = format!("{name} {text} is hexadecimal where ENI has decimal numbers");
            self.warn(WarningKind::HexNumber, node, message);
        }
        T::try_from(value)
            .map_err(|_| self.error(node, format!("{name} {text} is out of range for its place")))
    }

    /// The flag in a child; false without the child.
    pub fn flag(&self, of: Node, name: &str) -> Result<bool> {
        let Some(node) = child(of, name) else { return Ok(false) };
        self.flag_of(node, &text(node))
    }

    /// The flag in an attribute; false without it.
    pub fn attribute(&self, of: Node, name: &str) -> Result<bool> {
        of.attribute(name).map_or(Ok(false), |text| self.flag_of(of, text.trim()))
    }

    fn flag_of(&self, node: Node, text: &str) -> Result<bool> {
        match text {
            "1" | "true" => Ok(true),
            "0" | "false" => Ok(false),
            _ => {
                Err(self
                    .error(node, format!("\"{text}\" is no flag; expected 1, 0, true or false")))
            }
        }
    }

    /// Hex bytes of an element.
    pub fn bytes(&self, node: Node) -> Result<Vec<u8>> {
        let text: String = text(node).split_whitespace().collect();
        let digit = |byte: &u8| char::from(*byte).to_digit(16);
        let byte = |pair: &[u8]| match pair {
            [high, low] => Some((digit(high)? << 4 | digit(low)?) as u8),
            _ => None,
        };
        let bytes: Option<Vec<u8>> = text.as_bytes().chunks(2).map(byte).collect();
        bytes.ok_or_else(|| {
            let name = node.tag_name().name();
            let message =
                format!("{name} \"{text}\" is no row of bytes; expected two hex digits each");
            self.error(node, message)
        })
    }
}

/// The first child element of this name.
pub(super) fn child<'a, 'i>(of: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    children(of).find(|node| node.has_tag_name(name))
}

/// All child elements of this name.
pub(super) fn named<'a, 'i: 'a>(
    of: Node<'a, 'i>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    children(of).filter(move |node| node.has_tag_name(name))
}

/// All child elements.
pub(super) fn children<'a, 'i: 'a>(of: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    of.children().filter(Node::is_element)
}

/// The commands of `InitCmds`.
pub(super) fn commands<'a, 'i: 'a>(of: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    named(of, "InitCmds").flat_map(|list| named(list, "InitCmd"))
}

/// An element's own text, without the blanks around it.
pub(super) fn text(node: Node) -> String {
    let all: String = node.children().filter_map(|child| child.text()).collect();
    all.trim().to_owned()
}

/// The text of a child; empty without the child.
pub(super) fn text_of(of: Node, name: &str) -> String {
    child(of, name).map(text).unwrap_or_default()
}
