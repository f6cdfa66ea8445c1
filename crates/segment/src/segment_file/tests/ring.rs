//! The key `ring`: the port of the cable, its length, and the settings that it excludes.

use isocat_wire::PortNumber::{self, P1, P2};

use super::*;

/// A file with these keys at the root and these devices, each with more lines.
fn file(root: &str, devices: &[(&str, &str)]) -> String {
    let devices =
        devices.iter().map(|(id, more)| format!("[[subdevice]]\ndevice = \"{id}\"\n{more}\n"));
    format!("cycle = \"1ms\"\n{root}\n{}", devices.collect::<String>())
}

fn closed(devices: &[(&str, &str)]) -> (usize, PortNumber) {
    let text = file("ring = true", devices);
    let file =
        SegmentFile::parse("s.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let ring = file.ring.expect("it is a ring");
    assert_eq!(ring.cable, Length(10_000));
    (ring.device, ring.port)
}

const DRIVE: (&str, &str) = ("kollmorgen_akd2g", "");
const COUPLER: (&str, &str) = ("beckhoff_ek1100", "name = \"coupler\"");
const TERMINAL: (&str, &str) = ("beckhoff_el2502-0010", "");
const EXTENSION: (&str, &str) = ("beckhoff_ek1110", "");

#[test]
fn the_cable_leads_from_the_last_free_port_of_copper() {
    assert_eq!(closed(&[DRIVE]), (0, P1));
    assert_eq!(closed(&[DRIVE, DRIVE, ("simple_io4", "")]), (2, P1));
    assert_eq!(closed(&[DRIVE, ("simple_io4", "count = 3")]), (3, P1));
    // Port 2 of a coupler comes after its terminals.
    assert_eq!(closed(&[DRIVE, COUPLER, TERMINAL, TERMINAL]), (1, P2));
    assert_eq!(closed(&[COUPLER, TERMINAL, EXTENSION]), (2, P1));
    // A branch gives the same result in any order of the file.
    let branch = ("kollmorgen_akd2g", "connect = \"fork:1\"");
    let way_on = ("kollmorgen_akd2g", "connect = \"fork:2\"\nname = \"on\"");
    let fork = ("simple_io4", "name = \"fork\"");
    assert_eq!(closed(&[fork, branch, way_on]), (2, P1));
    assert_eq!(closed(&[fork, way_on, branch]), (2, P1));
}

#[test]
fn it_is_as_long_as_it_is_said() {
    let length = |value: &str| {
        let text = file(&format!("ring = {value}"), &[DRIVE]);
        SegmentFile::parse("s.toml", &text).unwrap().ring.map(|ring| ring.cable)
    };
    assert_eq!(length("true"), Some(Length(10_000)));
    assert_eq!(length("false"), None);
    assert_eq!(length("\"10mm\""), Some(Length(10)));
    assert_eq!(length("\"2000m\""), Some(Length(2_000_000)));
    let wrong = |value: &str| refused(&file(&format!("ring = {value}"), &[DRIVE])).0;
    for value in ["\"9mm\"", "\"2000001mm\""] {
        assert!(wrong(value).contains("out of range"), "{}", wrong(value));
    }
    let expected = "true, false, or the length of a cable such as \"20m\"";
    assert_eq!(wrong("3"), format!("2:8 ring: expected {expected}, found the number 3"));
}

#[test]
fn what_does_not_go_with_a_ring_is_named() {
    for (root, devices, expected) in [
        ("delay_watch = {}", &[DRIVE][..], "beside [delay_watch]"),
        ("direction = \"drive-reference\"", &[DRIVE], "beside direction"),
        ("", &[DRIVE, ("simple_io4", "name = \"x\"\noptional = true")], "\"x\" is optional"),
        (
            "",
            &[DRIVE, ("simple_io4", "name = \"x\"\nport = 1")],
            "\"x\" is plugged in at its port 1",
        ),
        ("", &[DRIVE, ("simple_io4", "name = \"ring\"")], "the name \"ring\""),
        ("host = { port = \"ebus\" }", &[TERMINAL], "no free copper port"),
    ] {
        let text = file(&format!("{root}\nring = \"20m\""), devices);
        let (message, _) = refused(&text);
        assert!(message.starts_with("3:8 ") && message.contains(expected), "{message}");
        assert!(message.contains("expected"), "{message}");
        // Without the ring the file is valid.
        SegmentFile::parse("s.toml", &file(root, devices))
            .unwrap_or_else(|error| panic!("{error}"));
    }
}

#[test]
fn faults_call_the_cable_by_its_name_where_there_is_one() {
    use isocat_sim::fault::RING_CABLE;
    let pull = "fault = [{ at = \"1s\", what = \"pull ring for 5ms\" }]";
    let text = file(&format!("{pull}\nring = true"), &[DRIVE]);
    let planned = SegmentFile::parse("s.toml", &text).unwrap().faults.planned;
    assert_eq!(planned[0].fault.cable(), Some(RING_CABLE));
    let (message, _) = refused(&file(pull, &[DRIVE]));
    assert!(message.contains("expected ring = true"), "{message}");
    // Without a ring, a device may have this name.
    let text = file(pull, &[DRIVE, ("simple_io4", "name = \"ring\"")]);
    let planned = SegmentFile::parse("s.toml", &text).unwrap().faults.planned;
    assert_eq!(planned[0].fault.cable(), Some(1));
}

/// A replacement for the last device must have the port that closes the ring.
#[test]
fn who_replaces_the_last_device_has_its_port() {
    let replace = |with: &str| {
        let fault =
            format!("fault = [{{ at = \"1s\", what = \"replace 0 {with}\" }}]\nring = true");
        SegmentFile::parse("s.toml", &file(&fault, &[("simple_io16", "")]))
    };
    assert!(replace("simple_io4").is_ok());
    let error = replace("beckhoff_ek1100").unwrap_err().to_string();
    assert!(error.contains("its port 1 is Ebus, expected Mii"), "{error}");
}
