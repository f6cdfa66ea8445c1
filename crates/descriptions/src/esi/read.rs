//! Typed values from elements: every function returns the value or a problem with its place.

use std::ops::RangeInclusive;

use super::numbers::{self, number};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

pub(super) const U8: RangeInclusive<i64> = 0..=0xFF;
pub(super) const U16: RangeInclusive<i64> = 0..=0xFFFF;
pub(super) const U32: RangeInclusive<i64> = 0..=0xFFFF_FFFF;

/// A number within a range. `what` names it in the error.
pub(super) fn integer(
    text: &str,
    at: usize,
    what: &str,
    range: RangeInclusive<i64>,
    warnings: &mut Warnings,
) -> Result<i64, Problem> {
    let Some(found) = number(text) else {
        let message = format!("{what}: \"{}\" is no number; expected e.g. #x1A00 or 26", cut(text));
        return Err(Problem::new(at, message));
    };
    if found.doubled_prefix {
        warnings.add(WarningKind::NumberDoubledPrefix, at, || {
            format!("{what}: \"{}\" is read as {:#x}", cut(text), found.value)
        });
    }
    if range.contains(&found.value) {
        return Ok(found.value);
    }
    let (least, most) = (range.start(), range.end());
    let message = format!("{what} = {} is out of range; expected {least} to {most}", cut(text));
    Err(Problem::new(at, message))
}

/// The number in a child element; `None` if there is no such child or it is empty.
pub(super) fn child<'a>(
    element: Element<'a>,
    name: &'a str,
    range: RangeInclusive<i64>,
    warnings: &mut Warnings,
) -> Result<Option<i64>, Problem> {
    let Some(child) = element.child(name) else { return Ok(None) };
    let text = child.text();
    if text.is_empty() {
        return Ok(None);
    }
    integer(&text, child.at(), name, range, warnings).map(Some)
}

/// The number in a required child.
pub(super) fn required<'a>(
    element: Element<'a>,
    name: &'a str,
    range: RangeInclusive<i64>,
    warnings: &mut Warnings,
) -> Result<i64, Problem> {
    child(element, name, range, warnings)?.ok_or_else(|| {
        Problem::new(element.at(), format!("{} lacks {name}; expected a number", element.name()))
    })
}

/// The number in an attribute; `None` if it is absent or empty.
pub(super) fn attribute(
    element: Element<'_>,
    name: &str,
    range: RangeInclusive<i64>,
    warnings: &mut Warnings,
) -> Result<Option<i64>, Problem> {
    match element.attribute(name).map(str::trim) {
        None | Some("") => Ok(None),
        Some(text) => integer(text, element.at(), name, range, warnings).map(Some),
    }
}

/// A flag in an attribute; false if it is absent.
pub(super) fn flag(element: Element<'_>, name: &str) -> Result<bool, Problem> {
    let Some(text) = element.attribute(name) else { return Ok(false) };
    numbers::flag(text).ok_or_else(|| {
        let message = format!("{name} = \"{}\": expected 1, 0, true or false", cut(text));
        Problem::new(element.at(), message)
    })
}

/// Hex bytes in a child element; `None` if there is none.
pub(super) fn bytes<'a>(element: Element<'a>, name: &'a str) -> Result<Option<Vec<u8>>, Problem> {
    let Some(child) = element.child(name) else { return Ok(None) };
    let text = child.text();
    numbers::hex_bytes(&text).map(Some).ok_or_else(|| {
        let message = format!("{name}: \"{}\" is no row of hex bytes", cut(&text));
        Problem::new(child.at(), message)
    })
}

/// The name of an element in English, or else one without a language, or else the first.
pub(super) fn name(element: Element<'_>) -> String {
    let of = |wanted: Option<&str>| {
        element.children("Name").find(|name| name.attribute("LcId").map(str::trim) == wanted)
    };
    let found = of(Some("1033")).or_else(|| of(None)).or_else(|| element.child("Name"));
    found.map_or_else(String::new, |name| name.text().into_owned())
}

/// A text for a message; a long one is cut.
pub(super) fn cut(text: &str) -> String {
    let text = text.trim();
    match text.char_indices().nth(MOST_SHOWN) {
        Some((at, _)) => format!("{}…", &text[..at]),
        None => text.to_owned(),
    }
}

const MOST_SHOWN: usize = 40;
