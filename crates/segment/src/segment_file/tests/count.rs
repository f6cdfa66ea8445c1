//! The key `count`.

use super::*;

const GROUP: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "model_every_mode"
    [[subdevice]]
    device = "simple_io16"
    name = "io"
    count = 3
    connect = "0:2"
    cable = "3m"
    clock = "+7ppm"
    [[subdevice]]
    device = "simple_io4"
    count = 2
    connect = "io 1:2"
"#;

fn names(segment: &SegmentFile) -> Vec<(&str, Option<(usize, u8)>)> {
    let upstream =
        |d: &SubDevice| d.place.upstream.map(|(above, port)| (above, port.index() as u8));
    segment.subdevices.iter().map(|d| (d.name.as_str(), upstream(d))).collect()
}

#[test]
fn equal_devices_stand_one_behind_the_other() {
    let segment = SegmentFile::parse("s.toml", GROUP).unwrap();
    // The order is by position: devices at port 1 of "io 1" come before those at its port 2.
    assert_eq!(
        names(&segment),
        [
            ("model_every_mode 0", None),
            ("io 0", Some((0, 2))),
            ("io 1", Some((1, 1))),
            ("io 2", Some((2, 1))),
            ("simple_io4 4", Some((2, 2))),
            ("simple_io4 5", Some((4, 1))),
        ]
    );
    for device in segment.subdevices.iter().filter(|device| device.name.starts_with("io")) {
        assert_eq!(
            (device.cable, device.clock, device.line),
            (Length::metres(3), Clock::Given(Ppb::ppm(7)), 5)
        );
    }
}

#[test]
fn a_count_of_one_changes_nothing() {
    let (one, without) = (GROUP.replace("count = 3", "count = 1"), GROUP.replace("count = 3", ""));
    let read = |text: String| {
        let text = text.replace("io 1:2", "io:2");
        let segment = SegmentFile::parse("s.toml", &text).unwrap();
        names(&segment).iter().map(|(name, place)| (name.to_string(), *place)).collect::<Vec<_>>()
    };
    assert_eq!(read(one), read(without));
}

#[test]
fn counts_that_make_no_sense() {
    let with = |count: &str| refused(&one(&format!("count = {count}"))).0;
    let range = "expected an integer from 1 to 65535";
    assert_eq!(with("0"), format!("4:9 count = 0 is out of range; {range}"));
    assert_eq!(with("-1"), format!("4:9 count = -1 is out of range; {range}"));
    assert_eq!(with("65536"), format!("4:9 count = 65536 is out of range; {range}"));
    assert_eq!(with("\"2\""), format!("4:9 count: {range}, found the text \"2\""));
    assert_eq!(with("2.0"), format!("4:9 count: {range}, found the number 2.0"));
    // The devices of a table must all fit.
    let two = |first: usize, second: &str| {
        let device = "device = \"kollmorgen_akd2g\"";
        one(&format!("count = {first}\n[[subdevice]]\n{device}\n{second}"))
    };
    assert_eq!(refused(&two(65_534, "count = 2")).0, "7:9 65536 devices; expected at most 65535");
    assert_eq!(refused(&two(65_535, "")).0, "5:1 65536 devices; expected at most 65535");
    let most = SegmentFile::parse("s.toml", &two(65_534, "count = 1")).unwrap();
    assert_eq!(most.subdevices.len(), 65_535);
}

#[test]
fn names_and_places_within_a_group() {
    let connected = |to: &str| refused(&GROUP.replace("io 1:2", to));
    assert_eq!(
        connected("io:2").0,
        "15:15 connect: \"io\" are several devices; expected one of them, such as \"io 0:1\""
    );
    let (message, hint) = connected("io 3:2");
    assert!(message.starts_with("15:15 connect: no device \"io 3\" above"), "{message}");
    assert!(hint.is_some_and(|hint| hint.contains("io ")));
    // The position of the middle one, whose port 1 is in use.
    assert_eq!(connected("2:1").0, "15:15 port 1 of \"io 1\" is taken by \"io 2\"");
    // Another device has the name of a numbered one, before and after.
    let before = GROUP.replacen("[[subdevice]]", "[[subdevice]]\nname = \"io 2\"", 1);
    assert_eq!(
        refused(&before).0,
        "8:12 the name \"io 2\" is already taken in line 3; expected another"
    );
    let behind = GROUP.replace("connect = \"io 1:2\"", "name = \"io\"");
    assert_eq!(
        refused(&behind).0,
        "15:12 the name \"io 0\" is already taken in line 5; expected another"
    );
}
