//! What does not end, nests without end or has no measure is refused at every door, within bounds
//! of memory and time, and segment files cost what their length is.

use std::fmt::Write as _;

use isocat::eni::Eni;
use isocat::esi::EsiFile;
use isocat::{SegmentFile, profile};
use isocat_descriptions::limits;

#[cfg(unix)]
#[test]
fn a_device_without_end_is_left() {
    let zero = "/dev/zero";
    for error in [
        SegmentFile::read(zero).expect_err("no segment"),
        EsiFile::read(zero).expect_err("no description"),
        Eni::read(zero).expect_err("no network"),
    ] {
        let text = error.to_string();
        assert!(text.contains("too long: expected at most") && text.contains(zero), "{text}");
    }
}

#[test]
fn at_the_limit_of_length_and_one_byte_beyond() {
    let padded = |length: usize| {
        let mut text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\n#".to_owned();
        text.extend(std::iter::repeat_n(' ', length - text.len()));
        SegmentFile::parse("long.toml", &text)
    };
    assert_eq!(padded(limits::TOML).expect("as long as it may be").subdevices.len(), 1);
    let error = padded(limits::TOML + 1).expect_err("one byte too long").to_string();
    assert!(error.starts_with("long.toml:1:1: too long"), "{error}");
}

#[test]
fn at_the_limit_of_depth_and_one_beyond() {
    let nested = |depth: usize| {
        let inner = depth - 1;
        format!("<EtherCATConfig>{}{}</EtherCATConfig>", "<a>".repeat(inner), "</a>".repeat(inner))
    };
    let depth = |text: &str| Eni::from_bytes("deep.xml", text.as_bytes()).expect_err("no Config");
    let error = depth(&nested(limits::DEPTH)).to_string();
    assert!(error.contains("has no Config"), "{error}");
    for deep in [limits::DEPTH + 1, 300_000] {
        let error = depth(&nested(deep)).to_string();
        assert!(error.contains("nested 65 deep; expected at most 64"), "{error}");
    }
}

#[test]
fn toml_that_nests_without_end_is_refused() {
    const DEEP: usize = 300_000;
    let dotted = format!("{}b = 1", "a.".repeat(DEEP));
    let tables = format!("[{}b]", "a.".repeat(DEEP));
    let arrays = format!("a = {}{}", "[".repeat(DEEP), "]".repeat(DEEP));
    let inline = format!("a = {}1{}", "{b=".repeat(DEEP), "}".repeat(DEEP));
    for text in [dotted, tables, arrays, inline] {
        for error in [
            SegmentFile::parse("deep.toml", &text).expect_err("no segment"),
            profile::Profile::from_toml("deep.toml", &text).expect_err("no profile"),
        ] {
            assert!(error.line == 1 && error.message.chars().count() <= limits::MESSAGE + 1);
        }
    }
}

#[test]
fn a_long_name_costs_its_length_and_is_not_repeated() {
    let name = "k".repeat(8 << 20);
    for text in [format!("{name} = 1\n"), format!("cycle = \"{name}\"\n")] {
        let error = SegmentFile::parse("long.toml", &text).expect_err("no segment");
        assert!(error.message.chars().count() <= limits::MESSAGE + 1);
        assert!(error.to_string().len() < 4_000, "{} bytes", error.to_string().len());
    }
}

/// Tables one below the other, each hanging on the one before by its name.
fn tables(count: usize) -> String {
    let mut text = "cycle = \"100ms\"\n".to_owned();
    for number in 0..count {
        let _ = write!(text, "[[subdevice]]\nname = \"d{number}\"\ndevice = \"simple_io16\"\n");
        if number > 0 {
            let _ = writeln!(text, "connect = \"d{}:1\"", number - 1);
        }
    }
    text
}

/// What this costs, and that it grows with the length and not with its square, stands in
/// benches/instructions.txt.
#[test]
fn a_segment_file_has_room_for_many_tables() {
    for count in [4_000, 16_000] {
        let file = SegmentFile::parse("many.toml", &tables(count)).expect("a segment");
        assert_eq!(file.subdevices.len(), count);
        let last = file.subdevices.last().expect("devices");
        assert_eq!(last.line, 2 + 3 + (count - 2) * 4);
    }
}
