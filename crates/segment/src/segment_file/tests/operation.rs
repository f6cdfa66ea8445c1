//! Activities of the MainDevice besides the exchange.

use isocat_maindevice::{DelayWatch, QualityWatch, Recovery};
use isocat_sync::phase::Direction;

use super::*;

const DEVICE: &str = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";

fn read(root: &str, tables: &str) -> Operation {
    let text = format!("cycle = \"1ms\"\n{root}{DEVICE}{tables}");
    SegmentFile::parse("s.toml", &text).unwrap().operation
}

fn fails(root: &str, tables: &str) -> String {
    refused(&format!("cycle = \"1ms\"\n{root}{DEVICE}{tables}")).0
}

#[test]
fn nothing_unless_it_is_asked_for() {
    assert_eq!(read("", ""), Operation::default());
    let Operation { quality, delay_watch, recovery, direction, measure_times } = read("", "");
    assert_eq!((quality, delay_watch, measure_times), (None, None, false));
    assert_eq!((recovery, direction), (Recovery::Never, Direction::FollowReference));
}

#[test]
fn every_key() {
    assert!(read("measure_times = true\n", "").measure_times);
    assert_eq!(read("", "[quality]\n").quality, Some(QualityWatch::default()));
    let keys = "[quality]\nshare_permille = 200\nhistory = 16\nunled_cycles = 1\ndifference_limit = \"150ns\"\n\
                margin_limit = \"-5us\"\nobjects = false\n";
    let expected = QualityWatch {
        share_permille: 200,
        history: 16,
        unled_cycles: 1,
        difference_limit: Nanos(150),
        margin_limit: Some(Nanos::micros(-5)),
        objects: false,
    };
    assert_eq!(read("", keys).quality, Some(expected));
    let off = read("", "[quality]\nmargin_limit = \"off\"\n").quality;
    assert_eq!(off.unwrap().margin_limit, None);
    assert_eq!(read("", "[delay_watch]\n").delay_watch, Some(DelayWatch::default()));
    let keys = "[delay_watch]\nevery = \"1ms\"\nlatches = 2\nrewrite = true\n";
    let expected = DelayWatch { every: Nanos::millis(1), latches: 2, rewrite: true };
    assert_eq!(read("", keys).delay_watch, Some(expected));
    assert_eq!(read("recovery = \"once\"\n", "").recovery, Recovery::Once);
    assert_eq!(read("recovery = \"never\"\n", "").recovery, Recovery::Never);
    let (first, longest) = (Nanos::millis(1_000), Nanos::millis(1_000));
    let text = "recovery = { first = \"1s\", longest = \"1s\" }\n";
    assert_eq!(read(text, "").recovery, Recovery::BackOff { first, longest });
    let direction = read("direction = \"drive-reference\"\n", "").direction;
    assert!(matches!(direction, Direction::DriveReference { .. }));
}

/// Values one step beyond each range, and invalid values.
#[test]
fn mistakes() {
    let quality = |key: &str| fails("", &format!("[quality]\n{key}\n"));
    assert_eq!(
        quality("share_permille = 0"),
        "5:18 share_permille = 0 is out of range; expected an integer from 1 to 200"
    );
    for wrong in [
        "share_permille = 201",
        "history = 15",
        "unled_cycles = 0",
        "difference_limit = \"0ns\"",
        "margin_limit = \"none\"",
        "objects = 1",
        "shares = 1",
    ] {
        assert!(quality(wrong).starts_with("5:"), "{wrong}: {}", quality(wrong));
    }
    for wrong in ["every = \"999us\"", "latches = 1", "rewrite = \"yes\""] {
        let message = fails("", &format!("[delay_watch]\n{wrong}\n"));
        assert!(message.starts_with("5:"), "{wrong}: {message}");
    }
    assert_eq!(
        fails("recovery = \"twice\"\n", ""),
        "2:12 recovery = \"twice\"; expected \"never\", \"once\", or { first = \"1s\", longest = \"30s\" }"
    );
    for wrong in [
        "recovery = 1\n",
        "recovery = { first = \"1s\" }\n",
        "recovery = { first = \"1s\", longest = \"999ms\" }\n",
        "direction = \"external\"\n",
    ] {
        assert!(fails(wrong, "").starts_with("2:"), "{wrong}: {}", fails(wrong, ""));
    }
}
