//! Numbers with a unit in files and options: durations, lengths, cable delays, rates.
//!
//! Each is an exact integer of its smallest unit (ns, mm, ps/m, ppb). Decimals are allowed if the
//! result is an integer: `62.5us` is 62 500 ns, `0.3ns` is refused.

use std::fmt;
use std::str::FromStr;

use isocat_wire::time::Nanos;

/// Reads a duration such as `500ns`, `62.5us`, `1 ms`, `10s`, `2min`, `1h`.
pub fn parse_duration(text: &str) -> Result<Nanos, QuantityError> {
    parse(text, &DURATION).map(Nanos)
}

/// The notation of a duration as a regular expression of ECMA 262; `signed` allows negative ones.
pub fn duration_pattern(signed: bool) -> String {
    pattern(&DURATION, signed)
}

/// A length of cable, in mm. Written `10m`, `30cm`, `250mm`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Length(pub i64);

impl Length {
    /// A length of whole metres.
    pub const fn metres(m: i64) -> Self {
        Self(m * 1_000)
    }
}

impl Length {
    /// Its notation as a regular expression of ECMA 262.
    pub fn pattern() -> String {
        pattern(&LENGTH, false)
    }
}

impl FromStr for Length {
    type Err = QuantityError;
    fn from_str(text: &str) -> Result<Self, QuantityError> {
        parse(text, &LENGTH).map(Self)
    }
}

/// In metres: `10 m`, `0.25 m`.
impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&decimal(self.0, 1_000, "m"))
    }
}

/// Signal delay of a cable, in ps per metre. Written `5ns/m`, `5.3ns/m`, `4950ps/m`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct DelayPerMetre(pub i64);

impl DelayPerMetre {
    /// Its notation as a regular expression of ECMA 262.
    pub fn pattern() -> String {
        pattern(&DELAY_PER_METRE, false)
    }
}

impl FromStr for DelayPerMetre {
    type Err = QuantityError;
    fn from_str(text: &str) -> Result<Self, QuantityError> {
        parse(text, &DELAY_PER_METRE).map(Self)
    }
}

/// In ns per metre: `5 ns/m`, `5.3 ns/m`.
impl fmt::Display for DelayPerMetre {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&decimal(self.0, 1_000, "ns/m"))
    }
}

/// Frequency deviation of a clock from true time, in parts per billion (positive: faster). Written
/// `-35ppm`, `+12ppm`, `500ppb`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Ppb(pub i64);

impl Ppb {
    /// A rate of whole parts per million.
    pub const fn ppm(ppm: i64) -> Self {
        Self(ppm * 1_000)
    }
}

impl Ppb {
    /// Its notation as a regular expression of ECMA 262; `signed` allows negative ones.
    pub fn pattern(signed: bool) -> String {
        pattern(&RATE, signed)
    }
}

impl std::ops::Neg for Ppb {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl FromStr for Ppb {
    type Err = QuantityError;
    fn from_str(text: &str) -> Result<Self, QuantityError> {
        parse(text, &RATE).map(Self)
    }
}

/// In ppm with its sign: `-35 ppm`, `+12.5 ppm`, `0 ppm`.
impl fmt::Display for Ppb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 > 0 { "+" } else { "" };
        f.pad(&format!("{sign}{}", decimal(self.0, 1_000, "ppm")))
    }
}

/// Why a text is no quantity. It prints as a sentence with the expected form.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct QuantityError {
    /// The text.
    pub text: String,
    /// The problem.
    pub problem: Problem,
    kind: &'static Kind,
}

/// A problem with the text of a quantity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Problem {
    /// It has no number in front.
    NoNumber,
    /// It has a number, but no unit.
    NoUnit,
    /// This kind of quantity does not have the unit.
    UnknownUnit,
    /// It is not a whole number of the smallest unit.
    TooFine,
    /// It exceeds 64 bits of the smallest unit.
    TooLarge,
}

impl fmt::Display for QuantityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Kind { noun, example, units } = self.kind;
        let text = &self.text;
        match self.problem {
            Problem::NoNumber => write!(f, "\"{text}\" is no {noun}")?,
            Problem::NoUnit => write!(f, "{noun} \"{text}\" has no unit")?,
            Problem::UnknownUnit => write!(f, "{noun} \"{text}\" has an unknown unit")?,
            Problem::TooFine => write!(f, "{noun} \"{text}\" is finer than 1 {}", units[0].0)?,
            Problem::TooLarge => write!(f, "{noun} \"{text}\" is too large")?,
        }
        write!(f, "; expected a number with one of the units ")?;
        for (i, (unit, _)) in units.iter().filter(|(unit, _)| unit.is_ascii()).enumerate() {
            write!(f, "{}{unit}", if i == 0 { "" } else { ", " })?;
        }
        write!(f, ", such as \"{example}\"")
    }
}

impl std::error::Error for QuantityError {}

/// The name of a quantity and its units; the first unit counts 1.
#[derive(PartialEq, Eq, Debug)]
struct Kind {
    noun: &'static str,
    example: &'static str,
    units: &'static [(&'static str, i64)],
}

fn parse(text: &str, kind: &'static Kind) -> Result<i64, QuantityError> {
    let fail = |problem| QuantityError { text: text.to_owned(), problem, kind };
    let trimmed = text.trim();
    let (negative, unsigned) = match trimmed.as_bytes().first() {
        Some(b'-') => (true, &trimmed[1..]),
        Some(b'+') => (false, &trimmed[1..]),
        _ => (false, trimmed),
    };
    let number_end =
        unsigned.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(unsigned.len());
    let (number, unit) = unsigned.split_at(number_end);
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    let digits = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if whole.is_empty() || !digits(fraction) || number.ends_with('.') {
        return Err(fail(Problem::NoNumber));
    }
    let unit = unit.trim();
    if unit.is_empty() {
        return Err(fail(Problem::NoUnit));
    }
    let Some(&(_, factor)) = kind.units.iter().find(|(name, _)| *name == unit) else {
        return Err(fail(Problem::UnknownUnit));
    };

    // The value is exact: (whole + fraction / 10^n) * factor in integers. No factor divides more
    // than nine decimals, so a longer fraction is always too fine.
    let fraction = fraction.trim_end_matches('0');
    if fraction.len() > 9 {
        return Err(fail(Problem::TooFine));
    }
    let too_large = |_| fail(Problem::TooLarge);
    let whole: i64 = whole.parse().map_err(too_large)?;
    let scale = 10i128.pow(fraction.len() as u32);
    let part = fraction.bytes().fold(0i128, |sum, digit| 10 * sum + i128::from(digit - b'0'));
    let scaled_part = part * i128::from(factor);
    if scaled_part % scale != 0 {
        return Err(fail(Problem::TooFine));
    }
    let total = i128::from(whole) * i128::from(factor) + scaled_part / scale;
    i64::try_from(if negative { -total } else { total }).map_err(|_| fail(Problem::TooLarge))
}

/// The input of [`parse`] as a regular expression: a number, a unit, and blanks around them.
fn pattern(kind: &Kind, signed: bool) -> String {
    let units: Vec<_> = kind.units.iter().map(|(unit, _)| *unit).collect();
    let units = units.join("|");
    match signed {
        true => format!(r"^\s*[+-]?[0-9]+(\.[0-9]+)?\s*({units})\s*$"),
        // Zero may have any sign.
        false => format!(r"^\s*(\+?[0-9]+(\.[0-9]+)?|-0+(\.0+)?)\s*({units})\s*$"),
    }
}

/// `value` in units of `scale`, with as many decimals as needed.
fn decimal(value: i64, scale: u64, unit: &str) -> String {
    let sign = if value < 0 { "-" } else { "" };
    let (whole, part) = (value.unsigned_abs() / scale, value.unsigned_abs() % scale);
    if part == 0 {
        return format!("{sign}{whole} {unit}");
    }
    let width = scale.ilog10() as usize;
    let digits = format!("{part:0width$}");
    format!("{sign}{whole}.{} {unit}", digits.trim_end_matches('0'))
}

const DURATION: Kind = Kind {
    noun: "duration",
    example: "1ms",
    units: &[
        ("ns", 1),
        ("us", 1_000),
        ("µs", 1_000),
        ("μs", 1_000),
        ("ms", 1_000_000),
        ("s", 1_000_000_000),
        ("min", 60_000_000_000),
        ("h", 3_600_000_000_000),
    ],
};
const LENGTH: Kind =
    Kind { noun: "length", example: "10m", units: &[("mm", 1), ("cm", 10), ("m", 1_000)] };
const DELAY_PER_METRE: Kind =
    Kind { noun: "cable delay", example: "5ns/m", units: &[("ps/m", 1), ("ns/m", 1_000)] };
const RATE: Kind =
    Kind { noun: "clock rate", example: "-35ppm", units: &[("ppb", 1), ("ppm", 1_000)] };

/// A span in ns with the appropriate unit and all its digits: `438.24 us`, `-12.5 ns`, `1 ms`.
pub fn time(ns: f64) -> String {
    let (value, unit) = match ns.abs() {
        size if size < 1e3 => (ns, "ns"),
        size if size < 1e6 => (ns / 1e3, "us"),
        size if size < 1e9 => (ns / 1e6, "ms"),
        _ => (ns / 1e9, "s"),
    };
    // Up to us it is shown to the picosecond, above to the nanosecond.
    let digits = match unit {
        "ns" => 3,
        "us" => 3,
        _ => 6,
    };
    let mut text = format!("{value:.digits$}");
    if text.contains('.') {
        text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
    }
    // A value that rounds to zero has no sign.
    if text == "-0" {
        text = "0".into();
    }
    format!("{text} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(text: &str) -> Problem {
        parse_duration(text).unwrap_err().problem
    }

    #[test]
    fn durations_are_exact() {
        for (text, ns) in [
            ("1ns", 1),
            ("0ns", 0),
            ("62.5us", 62_500),
            ("1.5min", 90_000_000_000),
            ("2h", 7_200_000_000_000),
            ("62.500us", 62_500),
            ("31.25 µs", 31_250),
            (" 1 ms ", 1_000_000),
            ("0.000000001s", 1),
            ("10s", 10_000_000_000),
            ("-2us", -2_000),
            ("+2us", 2_000),
            ("9223372036854775807ns", i64::MAX),
        ] {
            assert_eq!(parse_duration(text), Ok(Nanos(ns)), "{text}");
        }
    }

    #[test]
    fn what_is_no_duration() {
        for text in ["", "ms", "-", ".5us", "1.us", "1.2.3us", "--1us", "fast", "1..0us"] {
            assert_eq!(problem(text), Problem::NoNumber, "{text}");
        }
        for text in ["1", "1.5", "-3 "] {
            assert_eq!(problem(text), Problem::NoUnit, "{text}");
        }
        for text in ["1m", "1 US", "1e3us", "1mn", "10msx", "1,5us"] {
            assert_eq!(problem(text), Problem::UnknownUnit, "{text}");
        }
        for text in ["0.5ns", "1.0001us", "0.0000000001s", "0.00000000000000000000000000000000001s"]
        {
            assert_eq!(problem(text), Problem::TooFine, "{text}");
        }
        for text in ["9223372036854775808ns", "9223372036855s", "99999999999999999999999ns"] {
            assert_eq!(problem(text), Problem::TooLarge, "{text}");
        }
    }

    #[test]
    fn errors_say_what_was_expected() {
        assert_eq!(
            parse_duration("1").unwrap_err().to_string(),
            "duration \"1\" has no unit; expected a number with one of the units ns, us, ms, s, min, h, such \
             as \"1ms\""
        );
        assert_eq!(
            "10ft".parse::<Length>().unwrap_err().to_string(),
            "length \"10ft\" has an unknown unit; expected a number with one of the units mm, cm, m, \
             such as \"10m\""
        );
    }

    #[test]
    fn lengths_and_rates_both_ways() {
        for (text, mm, printed) in
            [("10m", 10_000, "10 m"), ("25cm", 250, "0.25 m"), ("1.001m", 1_001, "1.001 m")]
        {
            let length: Length = text.parse().unwrap();
            assert_eq!((length, length.to_string()), (Length(mm), printed.to_owned()));
            assert_eq!(printed.parse(), Ok(length));
        }
        for (text, ps, printed) in [("5ns/m", 5_000, "5 ns/m"), ("4950ps/m", 4_950, "4.95 ns/m")] {
            let delay: DelayPerMetre = text.parse().unwrap();
            assert_eq!((delay, delay.to_string()), (DelayPerMetre(ps), printed.to_owned()));
            assert_eq!(printed.parse(), Ok(delay));
        }
        for (text, ppb, printed) in [
            ("-35ppm", -35_000, "-35 ppm"),
            ("+12ppm", 12_000, "+12 ppm"),
            ("0ppm", 0, "0 ppm"),
            ("-500ppb", -500, "-0.5 ppm"),
            ("0.001ppm", 1, "+0.001 ppm"),
        ] {
            let rate: Ppb = text.parse().unwrap();
            assert_eq!((rate, rate.to_string()), (Ppb(ppb), printed.to_owned()));
            assert_eq!(printed.parse(), Ok(rate));
        }
    }
}
