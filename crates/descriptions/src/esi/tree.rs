//! From text to a tree of elements, with limits on the effort for a file.
//!
//! The parser is a library. Before it gets the text, [`guard`] refuses everything that would cost
//! more than a description is worth: document types (with their entities), deep nesting, elements
//! with thousands of attributes. The guard checks nothing else; the parser decides whether the text
//! is well-formed.

use std::borrow::Cow;

use roxmltree::{Document, Node, ParsingOptions};

use crate::limits::{ATTRIBUTES, DEPTH, NAMESPACES, NODES};

/// A problem and its byte offset in the text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Problem {
    pub at: usize,
    pub message: String,
}

impl Problem {
    pub fn new(at: usize, message: impl Into<String>) -> Self {
        Self { at, message: message.into() }
    }
}

/// The parser's error, with its own place.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Malformed {
    At(Problem),
    /// Line and column, both from 1; column in characters.
    Place(usize, usize, String),
}

/// The tree of a text.
pub(super) fn parse(text: &str) -> Result<Document<'_>, Malformed> {
    guard(text).map_err(Malformed::At)?;
    let options = ParsingOptions { nodes_limit: NODES, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).map_err(|error| match error {
        roxmltree::Error::NodesLimitReached => Malformed::At(Problem::new(
            text.len(),
            format!("more than {NODES} elements and texts; expected fewer"),
        )),
        error => {
            let place = error.pos();
            let message = error.to_string();
            // The library's message ends with the place, which the caller prints first.
            let message = message.rsplit_once(" at ").map_or(&*message, |(words, _)| words);
            let message = format!("not well-formed XML: {message}");
            Malformed::Place(place.row as usize, place.col as usize, message)
        }
    })
}

/// Refuses expensive constructs, in one pass over the text.
pub(crate) fn guard(text: &str) -> Result<(), Problem> {
    let bytes = text.as_bytes();
    let (mut at, mut depth, mut namespaces) = (0, 0_usize, 0_usize);
    while let Some(next) = find(bytes, at, b'<') {
        let rest = &bytes[next..];
        let skipped = |mark: &str| text[next..].find(mark).map(|found| next + found + mark.len());
        let end = match rest {
            [b'<', b'!', b'-', b'-', ..] => skipped("-->"),
            [b'<', b'!', b'[', ..] => skipped("]]>"),
            [b'<', b'!', ..] => {
                return Err(Problem::new(
                    next,
                    "a document type with entities; expected a description without <!DOCTYPE>",
                ));
            }
            [b'<', b'?', ..] => skipped("?>"),
            [b'<', b'/', ..] => {
                depth = depth.saturating_sub(1);
                find(bytes, next, b'>').map(|end| end + 1)
            }
            _ => {
                let Some(tag) = tag(bytes, next) else { return Ok(()) };
                if tag.attributes > ATTRIBUTES {
                    let message =
                        format!("{} attributes; expected at most {ATTRIBUTES}", tag.attributes);
                    return Err(Problem::new(next, message));
                }
                namespaces += tag.namespaces;
                if namespaces > NAMESPACES {
                    let message = format!("more than {NAMESPACES} declarations of namespaces");
                    return Err(Problem::new(next, message));
                }
                if bytes[tag.end - 2] != b'/' {
                    depth += 1;
                }
                if depth > DEPTH {
                    let message =
                        format!("elements are nested {depth} deep; expected at most {DEPTH}");
                    return Err(Problem::new(next, message));
                }
                Some(tag.end)
            }
        };
        match end {
            Some(end) => at = end,
            // The construct does not end; the parser has a message for that.
            None => return Ok(()),
        }
    }
    Ok(())
}

struct Tag {
    end: usize,
    attributes: usize,
    namespaces: usize,
}

/// Parses a start tag from its `<` on; `None` if it does not end.
fn tag(bytes: &[u8], start: usize) -> Option<Tag> {
    let mut found = Tag { end: 0, attributes: 0, namespaces: 0 };
    let mut at = start + 1;
    loop {
        match *bytes.get(at)? {
            b'>' => {
                found.end = at + 1;
                return Some(found);
            }
            quote @ (b'"' | b'\'') => at = find(bytes, at + 1, quote)?,
            b'=' => found.attributes += 1,
            b'x' if bytes[at..].starts_with(b"xmlns") => found.namespaces += 1,
            _ => {}
        }
        at += 1;
    }
}

fn find(bytes: &[u8], from: usize, byte: u8) -> Option<usize> {
    bytes.get(from..)?.iter().position(|found| *found == byte).map(|found| from + found)
}

/// An element.
#[derive(Clone, Copy, Debug)]
pub(super) struct Element<'a>(Node<'a, 'a>);

impl<'a> Element<'a> {
    pub fn root(document: &'a Document<'a>) -> Self {
        Self(document.root_element())
    }

    /// Name without prefix.
    pub fn name(self) -> &'a str {
        self.0.tag_name().name()
    }

    /// Byte offset of its begin.
    pub fn at(self) -> usize {
        self.0.range().start
    }

    /// All child elements, in order.
    pub fn elements(self) -> impl Iterator<Item = Element<'a>> {
        self.0.children().filter(Node::is_element).map(Element)
    }

    /// The children with this name.
    pub fn children(self, name: &'a str) -> impl Iterator<Item = Element<'a>> {
        self.elements().filter(move |child| child.name() == name)
    }

    /// The first child with this name.
    pub fn child(self, name: &'a str) -> Option<Element<'a>> {
        self.children(name).next()
    }

    /// Its text without blanks at both ends and without comments.
    pub fn text(self) -> Cow<'a, str> {
        self.written().map_or(Cow::Borrowed(""), |text| match text {
            Cow::Borrowed(text) => Cow::Borrowed(text.trim()),
            Cow::Owned(text) => Cow::Owned(text.trim().to_owned()),
        })
    }

    /// The text of a child; empty if there is none.
    pub fn child_text(self, name: &'a str) -> Cow<'a, str> {
        self.child(name).map_or(Cow::Borrowed(""), Element::text)
    }

    /// An attribute.
    pub fn attribute(self, name: &str) -> Option<&'a str> {
        self.0.attributes().find(|attribute| attribute.name() == name).map(|found| found.value())
    }

    fn written(self) -> Option<Cow<'a, str>> {
        let mut texts = self.0.children().filter(Node::is_text).filter_map(|node| node.text());
        let first = texts.next()?;
        match texts.next() {
            None => Some(Cow::Borrowed(first)),
            Some(second) => {
                Some(Cow::Owned([first, second].into_iter().chain(texts).collect::<String>()))
            }
        }
    }
}
