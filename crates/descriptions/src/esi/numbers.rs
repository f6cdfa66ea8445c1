//! Numbers and flags in the notation of descriptions.

/// A number and whether its prefix was doubled (`#x0x6041`).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Number {
    pub value: i64,
    pub doubled_prefix: bool,
}

/// Reads `#x`, `#X`, `0x`, `0X` or signed decimal with leading zeros; `None` for other texts.
pub(super) fn number(text: &str) -> Option<Number> {
    let text = text.trim();
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (value, doubled_prefix) = match after_prefix(digits) {
        Some(hex) => match after_prefix(hex) {
            Some(hex) => (from_digits(hex, 16)?, true),
            None => (from_digits(hex, 16)?, false),
        },
        None => (from_digits(digits, 10)?, false),
    };
    Some(Number { value: if negative { -value } else { value }, doubled_prefix })
}

fn after_prefix(text: &str) -> Option<&str> {
    ["#x", "#X", "0x", "0X"].iter().find_map(|prefix| text.strip_prefix(prefix))
}

/// Reads digits only: the library would accept a second sign.
fn from_digits(digits: &str, radix: u32) -> Option<i64> {
    let right = !digits.is_empty() && digits.bytes().all(|byte| char::from(byte).is_digit(radix));
    if right { i64::from_str_radix(digits, radix).ok() } else { None }
}

/// `1`, `0`, `true` or `false`.
pub(super) fn flag(text: &str) -> Option<bool> {
    match text.trim() {
        "1" | "true" => Some(true),
        "0" | "false" => Some(false),
        _ => None,
    }
}

/// Hex bytes with or without white space; `None` for other texts.
pub(super) fn hex_bytes(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 2);
    let mut high = None;
    for character in text.bytes().filter(|byte| !byte.is_ascii_whitespace()) {
        let digit = char::from(character).to_digit(16)? as u8;
        match high.take() {
            None => high = Some(digit << 4),
            Some(high) => bytes.push(high | digit),
        }
    }
    high.is_none().then_some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> Option<i64> {
        number(text).map(|number| number.value)
    }

    #[test]
    fn forms_of_numbers() {
        for (text, expected) in [
            ("#x0CAFE", 0xCAFE),
            ("#X1b9", 0x1B9),
            ("0xF3F", 0xF3F),
            ("0X10", 16),
            (" 3502166480\n", 3_502_166_480),
            ("-900", -900),
            ("+7", 7),
            ("0010", 10),
            ("#xE000059D", 0xE000_059D),
            ("-#x10", -16),
        ] {
            assert_eq!(value(text), Some(expected), "{text}");
            assert!(!number(text).unwrap().doubled_prefix, "{text}");
        }
        assert_eq!(number("#x0x6041"), Some(Number { value: 0x6041, doubled_prefix: true }));
        for text in
            ["", "#x", "#x0x", "#x0x0x1", "1.5", "--1", "1 2", "#xG", "x10", "99999999999999999999"]
        {
            assert_eq!(value(text), None, "{text}");
        }
    }

    #[test]
    fn flags_and_bytes() {
        assert_eq!(
            ["1", "true", "0", "false"].map(flag),
            [Some(true), Some(true), Some(false), Some(false)]
        );
        assert_eq!(["9", "", "yes", "TRUE"].map(flag), [None; 4]);
        assert_eq!(hex_bytes("90d0 03\n00"), Some(vec![0x90, 0xD0, 3, 0]));
        assert_eq!(hex_bytes(""), Some(Vec::new()));
        assert_eq!(hex_bytes("123"), None);
        assert_eq!(hex_bytes("1g"), None);
    }
}
