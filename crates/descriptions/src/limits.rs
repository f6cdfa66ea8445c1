//! Limits of all external input: files, and data from sockets.
//!
//! All limits are defined here. Input that is longer, deeper or more is refused with the place, the
//! expected and the found value, before it costs memory or time. So the effort of reading is
//! bounded, whatever a file or a peer sends.

use std::fs::File;
use std::io::{self, Read};

use crate::document::{FileError, Wrong};

/// Longest XML file (ESI, ENI), bytes. The longest published one has 60 MB.
pub const XML: usize = 64 << 20;
/// Longest TOML file (segment files, profiles), bytes: 256 for each of 65 535 devices. In memory it
/// takes some fifty times its size.
pub const TOML: usize = 16 << 20;
/// Longest EEPROM image (SII), bytes: the largest EEPROM that an ESC addresses, 4 Mbit.
pub const SII: usize = 512 << 10;
/// Longest capture, bytes. It is held in memory twice.
pub const CAPTURE: usize = 1 << 30;

/// Depth of elements in XML. The schema of ESI files nests 15 deep.
pub const DEPTH: usize = 64;
/// Attributes of an XML element. The richest one of the schema has 15.
pub const ATTRIBUTES: usize = 64;
/// Declarations of namespaces in an XML file.
pub const NAMESPACES: usize = 64;
/// Elements and texts of an XML file. A description of 4 MB has 200 000, and a network of 10 000
/// SubDevices a tenth of the limit. The limit takes some 800 MB.
pub const NODES: u32 = 10_000_000;

/// Characters of a name that is compared with the known ones for a hint; the time grows with the
/// square.
pub const NAME: usize = 64;
/// Characters of an error's message, which may quote the file.
pub const MESSAGE: usize = 1_000;

/// Longest request over a control socket, bytes.
pub const CONTROL_REQUEST: usize = 4 << 10;
/// Longest answer over a control socket, bytes. A status of 65 535 SubDevices is half as long.
pub const CONTROL_ANSWER: usize = 64 << 20;
/// Clients of a control socket at a time.
pub const CONTROL_CLIENTS: usize = 64;

/// Longest HTTP request, bytes.
pub const HTTP_REQUEST: usize = 8 << 10;
/// Header fields of an HTTP request.
pub const HTTP_FIELDS: usize = 64;
/// HTTP clients at a time.
pub const HTTP_CLIENTS: usize = 16;

/// The bytes of a file with at most `most` bytes. Reading stops after that even if the file has no
/// end, such as a device.
pub fn read(path: &str, most: usize) -> Result<Vec<u8>, FileError> {
    let unreadable = |error: io::Error| FileError::unreadable(path, &error);
    let file = File::open(path).map_err(unreadable)?;
    let mut bytes = Vec::new();
    file.take(most as u64 + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    check(path, bytes.len(), most).map_err(|error| hinted(error, path, &bytes))?;
    Ok(bytes)
}

/// The error, with what to do if the file is a capture.
fn hinted(error: FileError, path: &str, bytes: &[u8]) -> FileError {
    let is_capture = CAPTURES.iter().any(|magic| bytes.starts_with(magic));
    match is_capture {
        true => {
            error.with_hint(format!("this is a capture; for what is in it: isocat diagnose {path}"))
        }
        false => error,
    }
}

/// How captures begin: pcapng; pcap of either byte order, with stamps in us or ns.
const CAPTURES: [[u8; 4]; 5] = [
    [0x0A, 0x0D, 0x0D, 0x0A],
    [0xD4, 0xC3, 0xB2, 0xA1],
    [0xA1, 0xB2, 0xC3, 0xD4],
    [0x4D, 0x3C, 0xB2, 0xA1],
    [0xA1, 0xB2, 0x3C, 0x4D],
];

/// The same for a text in UTF-8.
pub fn read_text(path: &str, most: usize) -> Result<String, FileError> {
    String::from_utf8(read(path, most)?).map_err(|error| {
        let error_bytes = error.as_bytes();
        let at = error.utf8_error().valid_up_to();
        let before = String::from_utf8_lossy(&error_bytes[..at]).into_owned();
        let byte = error_bytes.get(at).copied().unwrap_or_default();
        let message = format!("byte 0x{byte:02X} is no UTF-8; expected a text in UTF-8");
        let error = crate::document::Source { path, text: &before }.error(before.len(), message);
        hinted(error, path, error_bytes)
    })
}

/// Refuses a `length` above `most`.
pub fn check(path: &str, length: usize, most: usize) -> Result<(), FileError> {
    if length <= most {
        return Ok(());
    }
    // Reading stops one byte after the limit.
    let found = if length == most + 1 { format!("more than {most}") } else { length.to_string() };
    let message = format!("too long: expected at most {most} bytes, found {found}");
    Err(FileError::new(Wrong { path: path.to_owned(), line: 1, column: 1, message, hint: None }))
}

/// The first `most` characters of a text, with an ellipsis if it is longer.
pub fn cut(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((at, _)) => format!("{}…", &text[..at]),
        None => text.to_owned(),
    }
}
