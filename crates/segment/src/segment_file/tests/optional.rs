//! Groups that may be absent.

use super::*;

#[test]
fn a_group_may_be_absent_and_come() {
    let text = r#"
        cycle = "1ms"
        [[subdevice]]
        device = "simple_io16"
        [[subdevice]]
        device = "simple_io16"
        optional = true
        arrives = "3s"
        count = 2
    "#;
    let segment = SegmentFile::parse("s.toml", text).expect("it reads");
    let found: Vec<_> = segment.subdevices.iter().map(|d| (d.optional, d.arrives)).collect();
    let late = Nanos::millis(3_000);
    assert_eq!(found, [(false, Nanos::ZERO), (true, late), (true, late)]);
}

#[test]
fn what_can_not_be_absent() {
    let (error, _) = refused(&one("optional = true"));
    assert!(error.starts_with("4:12 the first device is optional"), "{error}");
    let (error, _) = refused(&one("arrives = \"1s\""));
    assert!(error.starts_with("4:11 arrives is given without optional"), "{error}");
    let behind = one("[[subdevice]]\ndevice = \"simple_io4\"\noptional = true\nname = \"tool\"\n\
                      [[subdevice]]\ndevice = \"simple_io4\"");
    let (error, _) = refused(&behind);
    assert!(error.starts_with("8:1 it is behind \"tool\", which is optional"), "{error}");
    let (error, _) = refused(&one("optional = 1"));
    assert!(error.starts_with("4:12"), "{error}");
}
