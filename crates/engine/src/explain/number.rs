//! Numbers as people type them.

/// A number and how it was written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Number {
    /// Its value.
    pub value: u32,
    /// It was written with more than four hex digits, as 32-bit numbers are.
    pub long: bool,
}

impl Number {
    /// As the field writes it.
    pub fn hex(self) -> String {
        match self.long || self.value > 0xFFFF {
            true => format!("0x{:08X}", self.value),
            false => format!("0x{:04X}", self.value),
        }
    }
}

/// Parses `0x001A`, `#x001A`, `001A`, `06090030` as hexadecimal; fewer than four digits without a
/// prefix are decimal. Underscores and blanks between digits are allowed: `0x0609_0030`.
pub(super) fn number(text: &str) -> Option<Number> {
    let text: String = text.chars().filter(|c| *c != '_' && *c != ' ').collect();
    let prefix = ["0x", "0X", "#x", "#X"].into_iter().find_map(|prefix| text.strip_prefix(prefix));
    let digits = prefix.unwrap_or(&text);
    if digits.is_empty() || !digits.chars().all(|c| c.is_ascii_hexdigit()) {
        return None;
    }
    let decimal = prefix.is_none() && !matches!(digits.len(), 4 | 8);
    let value = u32::from_str_radix(digits, if decimal { 10 } else { 16 }).ok()?;
    Some(Number { value, long: !decimal && digits.len() > 4 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_people_type_them() {
        let value = |text| number(text).map(|number| number.value);
        for text in ["0x1A", "0X001a", "001A", "#x1A", "26", "026"] {
            assert_eq!(value(text), Some(0x1A), "{text}");
        }
        for text in ["0x06090030", "06090030", "0x0609_0030", "0x0609 0030"] {
            assert_eq!(value(text), Some(0x0609_0030), "{text}");
        }
        for text in ["", "0x", "-1", "1A", "0x123456789", "+5", "sync"] {
            assert_eq!(value(text), None, "{text}");
        }
        assert_eq!(number("0x0000").unwrap().hex(), "0x0000");
        assert_eq!(number("0x00000001").unwrap().hex(), "0x00000001");
    }
}
