//! Trees, cables and clocks.

use isocat_descriptions::quantity::DelayPerMetre;
use isocat_sim::oscillator::{Ramp, Step, Walk};
use isocat_wire::PortNumber::{self, *};

use super::*;

/// A file of devices with these lines; all have the ports 0, 1 and 2.
fn file(devices: &[&str]) -> String {
    let device = |lines: &&str| format!("[[subdevice]]\ndevice = \"model_every_mode\"\n{lines}\n");
    format!("cycle = \"1ms\"\n{}", devices.iter().map(device).collect::<String>())
}

/// Name, port upstream and own port.
type Hanging = (String, Option<(usize, PortNumber)>, PortNumber);

fn names(devices: &[&str]) -> Vec<Hanging> {
    let segment = SegmentFile::parse("s.toml", &file(devices)).unwrap();
    let place = |d: SubDevice| (d.name, d.place.upstream, d.place.port);
    segment.subdevices.into_iter().map(place).collect()
}

#[test]
fn a_line_unless_they_say_otherwise() {
    let found = names(&["name = \"a\"", "name = \"b\"", "name = \"c\""]);
    let line = [("a", None), ("b", Some((0, P1))), ("c", Some((1, P1)))];
    assert_eq!(found, line.map(|(name, upstream)| (name.to_owned(), upstream, P0)));
}

/// The file may name branches in any order: positions follow the frame.
#[test]
fn a_tree_comes_in_the_order_of_positions() {
    let found = names(&[
        "name = \"root\"",
        "name = \"late: 2\"\nconnect = \"root:2\"",
        "name = \"behind late\"",
        "name = \"early\"\nconnect = \"0:1\"",
        "name = \"last\"\nconnect = \"late: 2:2\"",
    ]);
    let tree = [
        ("root", None),
        ("early", Some((0, P1))),
        ("late: 2", Some((0, P2))),
        ("behind late", Some((2, P1))),
        ("last", Some((2, P2))),
    ];
    assert_eq!(found, tree.map(|(name, upstream)| (name.to_owned(), upstream, P0)));
}

/// Frames pass a swapped device in reverse: it is processed after the devices on its port 0.
#[test]
fn a_swapped_device_leads_on_at_port_0() {
    let found = names(&["name = \"a\"", "name = \"b\"\nport = 1", "name = \"c\""]);
    let expected = [("a", None, P0), ("c", Some((2, P0)), P0), ("b", Some((0, P1)), P1)];
    assert_eq!(found, expected.map(|(name, upstream, port)| (name.to_owned(), upstream, port)));
}

#[test]
fn places_that_do_not_exist() {
    let a = "name = \"axis a\"";
    for (devices, expected, hint) in [
        (
            vec![a, "connect = \"axes a:1\""],
            "7:11 connect: no device \"axes a\" above; expected a device above and its port, such as \
             \"axis 1:3\"",
            Some("did you mean \"axis a\"?"),
        ),
        (
            vec![a, "connect = \"2:1\""],
            "7:11 connect: no device \"2\" above; expected a device above and its port, such as \
             \"axis 1:3\"",
            None,
        ),
        (
            vec![a, "connect = \"axis a\""],
            "7:11 connect = \"axis a\" names no port; expected a device above and its port, such as \
             \"axis 1:3\"",
            None,
        ),
        (
            vec![a, "connect = \"axis a:4\""],
            "7:11 connect: \"4\" is no port; expected 0 to 3",
            None,
        ),
        (
            vec![a, "connect = \"axis a:3\""],
            "7:11 \"axis a\" (ET1100) has no port 3; it has 0, 1",
            None,
        ),
        (
            vec![a, "connect = \"axis a:0\""],
            "7:11 port 0 of \"axis a\" is taken by its own cable upstream",
            None,
        ),
        (
            vec![a, "name = \"b\"", "connect = \"axis a:1\""],
            "10:11 port 1 of \"axis a\" is taken by \"b\"",
            None,
        ),
        (
            vec![
                a,
                "name = \"b\"\nport = 2\nconnect = \"0:2\"",
                "connect = \"b:1\"",
                "connect = \"b:2\"",
            ],
            "15:11 port 2 of \"b\" is taken by its own cable upstream",
            None,
        ),
        (
            vec!["connect = \"0:1\""],
            "4:11 the first device hangs on the MainDevice; expected no \"connect\" here",
            None,
        ),
        (vec!["port = 3"], "4:8 Every mode", None),
        (vec!["port = 4"], "4:8 port = 4 is out of range; expected an integer from 0 to 3", None),
    ] {
        let (message, found_hint) = refused(&file(&devices));
        assert!(message.starts_with(expected) || message == expected, "{message}");
        if let Some(hint) = hint {
            assert!(found_hint.unwrap_or_default().contains(hint), "{message}");
        }
    }
}

#[test]
fn cables_have_speed_and_asymmetry() {
    let plain = subdevice("");
    assert_eq!((plain.cable_delay, plain.cable_asymmetry), (DelayPerMetre(5_000), Nanos::ZERO));
    let cable = subdevice("cable = \"2m\"\ncable_delay = \"4.9ns/m\"\ncable_asymmetry = \"-19ns\"");
    assert_eq!((cable.cable_delay, cable.cable_asymmetry), (DelayPerMetre(4_900), Nanos(-19)));
    // Copper reaches 100 m, fibre further.
    assert_eq!(subdevice("cable = \"100m\"").cable, Length::metres(100));
    assert_eq!(subdevice("cable = \"2000m\"\nfibre = true").cable, Length::metres(2_000));
    assert_eq!(
        refused(&one("cable = \"100.001m\"")).0,
        "4:9 cable = 100.001 m, and copper reaches 100 m; expected 100 m at most, or fibre = true beside it"
    );
    // The difference between out and back cannot exceed their sum.
    assert_eq!(
        refused(&one("cable = \"2m\"\ncable_delay = \"4.9ns/m\"\ncable_asymmetry = \"20ns\"")).0,
        "6:19 cable_asymmetry = \"20ns\" is out of range; expected -19 ns to 19 ns"
    );
    assert_eq!(subdevice("cable_delay = \"3.3ns/m\"").cable_delay, DelayPerMetre(3_300));
    assert_eq!(
        refused(&one("cable_delay = \"3299ps/m\"")).0,
        "4:15 cable_delay = \"3299ps/m\" is out of range; expected 3.3 ns/m to 10 ns/m"
    );
    assert_eq!(
        refused(&one("cable_delay = \"5ns\"")).0,
        "4:15 cable_delay: cable delay \"5ns\" has an unknown unit; expected a number with one of the \
         units ps/m, ns/m, such as \"5ns/m\""
    );
}

#[test]
fn clocks_have_shapes() {
    let shape = |lines| subdevice(lines).clock_shape;
    assert_eq!(shape("clock = \"5ppm\""), ClockModel::constant(0), "the constant part is apart");
    let ramp = Ramp { by_ppb: -5_000, from: Nanos::ZERO, over: Nanos::millis(60_000) };
    assert_eq!(shape("clock_ramp = { by = \"-5ppm\", over = \"60s\" }").ramp, Some(ramp));
    let ramp = Ramp { from: Nanos::millis(2_000), ..ramp };
    let text = "clock_ramp = { by = \"-5ppm\", from = \"2s\", over = \"60s\" }";
    assert_eq!(shape(text).ramp, Some(ramp));
    let step = Step { by_ppb: 500, at: Nanos::millis(3_000) };
    assert_eq!(shape("clock_step = { by = \"0.5ppm\", at = \"3s\" }").step, Some(step));
    let walk = Walk { step_ppb: 50, every: Nanos::millis(100), bound_ppb: 2_000 };
    let text = "clock_walk = { step = \"0.05ppm\", every = \"100ms\", within = \"2ppm\" }";
    assert_eq!(shape(text).walk, Some(walk));
    // All values at their limits still give a valid clock.
    let text = "clock_ramp = { by = \"1000ppm\", over = \"1us\" }\n\
                clock_step = { by = \"-1000ppm\", at = \"0s\" }\n\
                clock_walk = { step = \"1000ppm\", every = \"1us\", within = \"1000ppm\" }";
    let most = ClockModel { deviation_ppb: 1_000_000, ..shape(text) }.most_deviation_ppb();
    assert!(most <= isocat_sim::oscillator::MOST_DEVIATION_PPB);
}

#[test]
fn shapes_that_are_none() {
    for (lines, expected) in [
        (
            "clock_ramp = { by = \"1ppm\" }",
            "4:14 clock_ramp lacks the key \"over\"; expected a duration, such as \"10s\"",
        ),
        (
            "clock_ramp = { by = \"1ppm\", over = \"0s\" }",
            "4:36 over = \"0s\" is out of range; expected 1 us to 86400 s",
        ),
        (
            "clock_step = { by = \"1001ppm\", at = \"0s\" }",
            "4:21 by = \"1001ppm\" is out of range; expected -1000 ppm to +1000 ppm",
        ),
        (
            "clock_walk = { step = \"-1ppm\", every = \"1s\", within = \"1ppm\" }",
            "4:23 step = \"-1ppm\" is out of range; expected 0 ppm to +1000 ppm",
        ),
        (
            "clock_walk = { steps = \"1ppm\", every = \"1s\", within = \"1ppm\" }",
            "4:16 unknown key \"steps\" in clock_walk",
        ),
        ("clock_step = \"1ppm\"", "4:14 clock_step: expected a table, found the text \"1ppm\""),
    ] {
        assert_eq!(refused(&one(lines)).0, expected);
    }
}
