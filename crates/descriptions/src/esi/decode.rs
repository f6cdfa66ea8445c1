//! From bytes to text: byte order marks, declared encodings, UTF-16.
//!
//! Evidence is used in this order: a byte order mark, then the pattern of an ASCII `<` in UTF-16,
//! then the declaration, then UTF-8. Bytes that are invalid in the encoding are an error with their
//! place; nothing is replaced.

use std::borrow::Cow;

/// Encoding of a file's bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Encoding {
    /// UTF-8, which includes ASCII.
    Utf8,
    /// UTF-16, low byte first.
    Utf16Le,
    /// UTF-16, high byte first.
    Utf16Be,
    /// ISO 8859-1.
    Latin1,
    /// Windows code page 1252.
    Windows1252,
}

impl Encoding {
    /// The preferred name in the registry of character sets.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Utf8 => "UTF-8",
            Self::Utf16Le => "UTF-16LE",
            Self::Utf16Be => "UTF-16BE",
            Self::Latin1 => "ISO-8859-1",
            Self::Windows1252 => "windows-1252",
        }
    }
}

/// The text of a file.
#[derive(Debug)]
pub(super) struct Decoded<'a> {
    pub text: Cow<'a, str>,
    pub encoding: Encoding,
    /// Doubt about the declaration; its place is the file's beginning.
    pub doubt: Option<Doubt>,
}

/// A doubt about a declaration.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Doubt {
    /// The name is not registered, but known in practice.
    Name(String),
    /// Bytes and declaration disagree; the bytes are used.
    Contradiction(String),
}

/// Bytes that cannot be decoded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Undecodable {
    pub line: usize,
    pub column: usize,
    pub message: String,
}

/// Decodes bytes.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded<'_>, Undecodable> {
    if let Some(rest) = bytes.strip_prefix(&[0xEF, 0xBB, 0xBF]) {
        let declared = declaration(rest).filter(|name| by_name(name) != Some(Encoding::Utf8));
        let doubt = declared.map(|name| {
            Doubt::Contradiction(format!("\"{name}\" is declared, but there is a mark of UTF-8"))
        });
        return Ok(Decoded { doubt, ..utf8(rest)? });
    }
    for (mark, encoding) in [([0xFF, 0xFE], Encoding::Utf16Le), ([0xFE, 0xFF], Encoding::Utf16Be)] {
        if let Some(rest) = bytes.strip_prefix(&mark) {
            return utf16(rest, encoding);
        }
    }
    match bytes {
        [b'<', 0, _, 0, ..] => return utf16(bytes, Encoding::Utf16Le),
        [0, b'<', 0, _, ..] => return utf16(bytes, Encoding::Utf16Be),
        _ => {}
    }
    let Some(name) = declaration(bytes) else { return utf8(bytes) };
    match by_name(&name) {
        Some(Encoding::Utf16Le | Encoding::Utf16Be) => {
            let doubt = format!("\"{name}\" is declared, but the characters have 8 bits");
            Ok(Decoded { doubt: Some(Doubt::Contradiction(doubt)), ..utf8(bytes)? })
        }
        Some(encoding @ (Encoding::Latin1 | Encoding::Windows1252)) => {
            let registered = !name.eq_ignore_ascii_case("iso8859-1");
            let doubt = (!registered).then_some(Doubt::Name(name));
            Ok(Decoded { doubt, ..single_bytes(bytes, encoding)? })
        }
        Some(Encoding::Utf8) => utf8(bytes),
        None => Err(Undecodable {
            line: 1,
            column: 1,
            message: format!(
                "the encoding \"{name}\" is not known; expected UTF-8, UTF-16, US-ASCII, ISO-8859-1 or \
                 windows-1252"
            ),
        }),
    }
}

fn by_name(name: &str) -> Option<Encoding> {
    Some(match name.to_ascii_lowercase().as_str() {
        "utf-8" | "utf8" | "us-ascii" | "ascii" => Encoding::Utf8,
        "utf-16" | "utf-16le" => Encoding::Utf16Le,
        "utf-16be" => Encoding::Utf16Be,
        "iso-8859-1" | "iso8859-1" | "iso_8859-1" | "latin1" => Encoding::Latin1,
        "windows-1252" | "cp1252" => Encoding::Windows1252,
        _ => return None,
    })
}

/// The name in `<?xml … encoding="name"?>`.
fn declaration(bytes: &[u8]) -> Option<String> {
    let head = bytes.strip_prefix(b"<?xml")?;
    let end = head.windows(2).take(LONGEST_DECLARATION).position(|pair| pair == b"?>")?;
    let head = String::from_utf8_lossy(&head[..end]).into_owned();
    let (_, rest) = head.split_once("encoding")?;
    let rest = rest.trim_start().strip_prefix('=')?.trim_start();
    let quote = rest.chars().next().filter(|quote| matches!(quote, '"' | '\''))?;
    let name = rest[1..].split(quote).next()?.trim();
    Some(name.to_owned())
}

fn utf8(bytes: &[u8]) -> Result<Decoded<'_>, Undecodable> {
    match std::str::from_utf8(bytes) {
        Ok(text) => {
            Ok(Decoded { text: Cow::Borrowed(text), encoding: Encoding::Utf8, doubt: None })
        }
        Err(error) => {
            let at = error.valid_up_to();
            let before = String::from_utf8_lossy(&bytes[..at]);
            Err(undecodable(&before, at, &format!("byte 0x{:02X}", bytes[at]), Encoding::Utf8))
        }
    }
}

fn utf16(bytes: &[u8], encoding: Encoding) -> Result<Decoded<'static>, Undecodable> {
    let mut text = String::with_capacity(bytes.len() / 2);
    let (units, rest) = bytes.split_at(bytes.len() / 2 * 2);
    let unit = |pair: &[u8]| match encoding {
        Encoding::Utf16Le => u16::from_le_bytes([pair[0], pair[1]]),
        _ => u16::from_be_bytes([pair[0], pair[1]]),
    };
    let mut at = 0;
    for character in char::decode_utf16(units.chunks_exact(2).map(unit)) {
        match character {
            Ok(character) => {
                text.push(character);
                at += 2 * character.len_utf16();
            }
            Err(error) => {
                let what = format!("unit 0x{:04X}", error.unpaired_surrogate());
                return Err(undecodable(&text, at, &what, encoding));
            }
        }
    }
    if let [odd] = rest {
        return Err(undecodable(&text, at, &format!("single byte 0x{odd:02X}"), encoding));
    }
    Ok(Decoded { text: Cow::Owned(text), encoding, doubt: None })
}

fn single_bytes(bytes: &[u8], encoding: Encoding) -> Result<Decoded<'_>, Undecodable> {
    if bytes.is_ascii() {
        return Ok(Decoded { encoding, ..utf8(bytes)? });
    }
    let mut text = String::with_capacity(bytes.len() + bytes.len() / 16);
    for (at, byte) in bytes.iter().enumerate() {
        let character = match (encoding, byte) {
            (Encoding::Windows1252, 0x80..=0x9F) => HIGH_CONTROLS[usize::from(byte - 0x80)],
            _ => char::from(*byte),
        };
        if character == '\0' && *byte != 0 {
            return Err(undecodable(&text, at, &format!("byte 0x{byte:02X}"), encoding));
        }
        text.push(character);
    }
    Ok(Decoded { text: Cow::Owned(text), encoding, doubt: None })
}

fn undecodable(before: &str, at: usize, what: &str, encoding: Encoding) -> Undecodable {
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    Undecodable {
        line: before.matches('\n').count() + 1,
        column: before[line_start..].chars().count() + 1,
        message: format!(
            "{what} at offset {at} is no {name}; expected the encoding that the file declares, or \
             {name}",
            name = encoding.name()
        ),
    }
}

/// A declaration is short; a file without one is not searched to its end.
const LONGEST_DECLARATION: usize = 200;
/// Bytes 0x80 to 0x9F of code page 1252; NUL if undefined.
const HIGH_CONTROLS: [char; 32] = [
    '\u{20AC}', '\0', '\u{201A}', '\u{0192}', '\u{201E}', '\u{2026}', '\u{2020}', '\u{2021}',
    '\u{02C6}', '\u{2030}', '\u{0160}', '\u{2039}', '\u{0152}', '\0', '\u{017D}', '\0', '\0',
    '\u{2018}', '\u{2019}', '\u{201C}', '\u{201D}', '\u{2022}', '\u{2013}', '\u{2014}', '\u{02DC}',
    '\u{2122}', '\u{0161}', '\u{203A}', '\u{0153}', '\0', '\u{017E}', '\u{0178}',
];
