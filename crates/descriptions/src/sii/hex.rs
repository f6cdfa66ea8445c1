//! Intel HEX, in which some tools store the content of an EEPROM.

use crate::document::{FileError, Source};
use crate::limits;

/// Whether a file is Intel HEX and not an image: its first byte begins a record.
pub(super) fn is_hex(bytes: &[u8]) -> bool {
    bytes.first() == Some(&b':') && bytes.iter().all(u8::is_ascii)
}

/// The bytes of the records; bytes without a record are 0xFF, as in an erased chip.
pub(super) fn decode(path: &str, text: &str) -> Result<Vec<u8>, FileError> {
    let source = Source { path, text };
    let (mut image, mut base, mut at) = (Vec::new(), 0_usize, 0);
    for line in text.split_inclusive('\n') {
        let start = at;
        at += line.len();
        let line = line.trim_end();
        if line.is_empty() {
            continue;
        }
        let record =
            record(line).map_err(|(column, message)| source.error(start + column, message))?;
        let word = |data: &[u8]| match data {
            [high, low] => Ok(usize::from(u16::from_be_bytes([*high, *low]))),
            _ => Err(source.error(start, format!("{} bytes; expected 2", data.len()))),
        };
        match record.kind {
            0 => {
                let end = base + record.address + record.data.len();
                limits::check(path, end, limits::SII)?;
                if image.len() < end {
                    image.resize(end, 0xFF);
                }
                image[base + record.address..end].copy_from_slice(&record.data);
            }
            1 => return Ok(image),
            2 => base = word(&record.data)? << 4,
            4 => base = word(&record.data)? << 16,
            3 | 5 => {}
            kind => {
                let message = format!("a record of type {kind}; expected 0 to 5");
                return Err(source.error(start + 7, message));
            }
        }
    }
    Err(source.error(text.len(), "the file ends; expected the end record :00000001FF"))
}

struct Record {
    address: usize,
    kind: u8,
    data: Vec<u8>,
}

/// Parses a line `:LLAAAATT…CC`; an error has its column.
fn record(line: &str) -> Result<Record, (usize, String)> {
    let digits = line
        .strip_prefix(':')
        .ok_or((0, "expected a record, which begins with \":\"".to_owned()))?;
    let pair =
        |at: usize| digits.get(at..at + 2).and_then(|pair| u8::from_str_radix(pair, 16).ok());
    let mut bytes = Vec::new();
    for at in (0..digits.len()).step_by(2) {
        let byte = pair(at).ok_or((at + 1, "expected two hex digits".to_owned()))?;
        bytes.push(byte);
    }
    let [length, high, low, kind, rest @ ..] = &bytes[..] else {
        return Err((0, format!("a record of {} bytes; expected 5 or more", bytes.len())));
    };
    let [data @ .., _] = rest else {
        return Err((0, "a record of 4 bytes; expected 5 or more".to_owned()));
    };
    if data.len() != usize::from(*length) {
        return Err((1, format!("{} bytes of data; expected {length}", data.len())));
    }
    let sum = bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
    if sum != 0 {
        return Err((line.len() - 2, format!("the bytes add up to 0x{sum:02X}; expected 0x00")));
    }
    let address = usize::from(u16::from_be_bytes([*high, *low]));
    Ok(Record { address, kind: *kind, data: data.to_vec() })
}
