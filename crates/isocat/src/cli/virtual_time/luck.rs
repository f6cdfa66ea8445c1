//! Delays of the program's machine, from the command line and measured files.

use std::path::Path;

use isocat_descriptions::{limits, quantity};
use isocat_wire::time::Nanos;

use crate::cli::run::duration;

/// Largest lateness of wake-ups; 0 is allowed, since the file's host may have jitter.
pub fn lateness(text: &str) -> Result<Nanos, String> {
    let none = quantity::parse_duration(text).is_ok_and(|time| time == Nanos::ZERO);
    if none { Ok(Nanos::ZERO) } else { duration(text) }
}

/// `1000:300us`: one call in a thousand, up to 300 us.
pub fn preemption(text: &str) -> Result<(u64, Nanos), String> {
    let expected = "expected a number of calls and the longest time, such as 1000:300us";
    let (one_of, time) = text.split_once(':').ok_or(expected)?;
    let one_of = one_of.parse().ok().filter(|one_of| *one_of > 0).ok_or(expected)?;
    let time = duration(time).map_err(|_| expected)?;
    Ok((one_of, time))
}

/// Largest number of values in a histogram, one for each microsecond of a cyclictest with -h.
const MOST_VALUES: usize = 1_000_000;

/// Reads a histogram of latencies: each line is a number of microseconds and its count, for one or
/// several threads; `#` begins a comment.
pub fn histogram(path: &Path) -> Result<Vec<(Nanos, u64)>, String> {
    let at = |line: usize, what: &str| {
        format!(
            "{}: line {}: {what}; expected microseconds and counts, as of cyclictest -q -h 400",
            path.display(),
            line + 1
        )
    };
    let text = limits::read_text(&path.display().to_string(), limits::TOML);
    let text = text.map_err(|error| error.to_string())?;
    let mut values = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        let mut fields = line.split_whitespace();
        let Some(first) = fields.next() else { continue };
        let micros: u32 = first.parse().map_err(|_| at(number, &format!("found {first:?}")))?;
        let mut times = 0u64;
        for field in fields {
            let count: u64 = field.parse().map_err(|_| at(number, &format!("found {field:?}")))?;
            times = times.saturating_add(count);
        }
        if values.len() >= MOST_VALUES {
            return Err(at(number, "more than a million values"));
        }
        values.push((Nanos(i64::from(micros) * 1_000), times));
    }
    match values.iter().any(|(_, times)| *times > 0) {
        true => Ok(values),
        false => Err(format!(
            "{}: no latency was ever seen; expected microseconds and counts, as of cyclictest -q -h 400",
            path.display()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<(Nanos, u64)>, String> {
        let file = std::env::temp_dir().join(format!("isocat-histogram-{}", std::process::id()));
        std::fs::write(&file, text).expect("a temporary file");
        let histogram = histogram(&file);
        std::fs::remove_file(&file).expect("it is there");
        histogram
    }

    #[test]
    fn a_histogram_of_two_threads_is_their_sum_and_a_broken_one_is_told_by_its_line() {
        let read_one =
            read("# Histogram\n000003 000010\t000002\n000250 000001 000000\n# Total: 13\n");
        assert_eq!(read_one, Ok(vec![(Nanos(3_000), 12), (Nanos(250_000), 1)]));
        let broken = read("3 10\nfour 1\n").expect_err("a word");
        assert!(broken.contains("line 2") && broken.contains("four"), "{broken}");
        assert!(read("3 0\n").is_err());
    }

    #[test]
    fn a_preemption_names_how_often_and_how_long() {
        assert_eq!(preemption("1000:300us"), Ok((1_000, Nanos(300_000))));
        for wrong in ["1000", "0:1us", "x:1us", "10:", "10:long"] {
            assert!(preemption(wrong).is_err(), "{wrong}");
        }
    }
}
