//! Connections between ports: MII, EBUS, and couplers between both.

use isocat_wire::PortNumber::{P0, P3};

use super::*;
use crate::offline;

const DRIVE: &str = "kollmorgen_akd2g";
const COUPLER: &str = "beckhoff_ek1100";
const TERMINAL: &str = "beckhoff_el2502-0010";
const EXTENSION: &str = "beckhoff_ek1110";

/// Devices in a line, each with more lines; their names are a, b, c, …
fn text(head: &str, devices: &[(&str, &str)]) -> String {
    let mut text = format!("cycle = \"1ms\"\n{head}\n");
    for ((device, lines), name) in devices.iter().zip('a'..) {
        text += &format!("[[subdevice]]\ndevice = \"{device}\"\nname = \"{name}\"\n{lines}\n");
    }
    text
}

fn segment(devices: &[(&str, &str)]) -> SegmentFile {
    let text = text("", devices);
    SegmentFile::parse("s.toml", &text).unwrap_or_else(|error| panic!("{error}"))
}

/// Delays from the first device, ps, and lengths of the cables, mm.
fn delays(devices: &[(&str, &str)]) -> (Vec<i64>, Vec<i64>) {
    let devices = segment(devices).subdevices;
    let ways = offline::ways(&devices);
    let cables = devices.iter().map(|device| device.cable.0).collect();
    (ways.iter().map(|way| way.delay.0 - ways[0].delay.0).collect(), cables)
}

/// A hop of copper is the ESC, two PHYs and the cable: 155 + 2 x 280 + 50 ns. A hop of EBUS is the
/// ESC alone.
#[test]
fn each_kind_of_hop_has_its_own_delay() {
    assert_eq!(delays(&[(DRIVE, ""), (DRIVE, "")]), (vec![0, 765_000], vec![10_000; 2]));
    let rail = [(COUPLER, ""), (TERMINAL, ""), (TERMINAL, "")];
    assert_eq!(delays(&rail), (vec![0, 155_000, 310_000], vec![10_000, 0, 0]));
    // After the terminals the frame comes back through the coupler and leaves it by copper.
    let both = [(COUPLER, ""), (TERMINAL, ""), (DRIVE, "connect = \"a:2\"")];
    let back = 155_000 + 155_000;
    let forward = 135_000;
    let copper = 2 * 280_000 + 50_000;
    assert_eq!(delays(&both).0, [0, 155_000, back + forward + copper]);
    // Terminals, an extension, and copper again.
    let extended = [(COUPLER, ""), (TERMINAL, ""), (EXTENSION, ""), (DRIVE, "")];
    assert_eq!(delays(&extended).0, [0, 155_000, 310_000, 465_000 + copper]);
}

#[test]
fn ports_of_different_kinds_are_refused() {
    let cannot = |port: usize, name: &str, kind: &str, above: &str, other: &str| {
        format!("port {port} of \"{name}\" is {kind}, but {above} is {other}: they can't be joined")
    };
    let (copper, ebus) = ("MII (copper)", "EBUS");
    let main = "the port of the MainDevice ([host] port)";
    for (head, devices, place, message, hint) in [
        (
            "",
            vec![(TERMINAL, "")],
            "3:1",
            cannot(0, "a", ebus, main, copper),
            "device = \"beckhoff_ek1100\", before it, or [host] port = \"ebus\"",
        ),
        (
            "host = { port = \"ebus\" }",
            vec![(DRIVE, "")],
            "3:1",
            cannot(0, "a", copper, main, ebus),
            "expected a terminal first",
        ),
        (
            "",
            vec![(DRIVE, ""), (TERMINAL, "")],
            "7:1",
            cannot(0, "b", ebus, "port 1 of \"a\"", copper),
            "expected a coupler, such as device = \"beckhoff_ek1100\", before it",
        ),
        (
            "",
            vec![(COUPLER, ""), (TERMINAL, ""), (DRIVE, "")],
            "11:1",
            cannot(0, "c", copper, "port 1 of \"b\"", ebus),
            "connect = \"a:2\"",
        ),
        (
            "",
            vec![(COUPLER, ""), (DRIVE, "connect = \"a:2\""), (TERMINAL, "connect = \"b:1\"")],
            "14:11",
            cannot(0, "c", ebus, "port 1 of \"b\"", copper),
            "connect = \"a:1\"",
        ),
        (
            "",
            vec![
                (COUPLER, "port = 2"),
                (DRIVE, "connect = \"a:0\""),
                (TERMINAL, "connect = \"a:1\""),
                (DRIVE, "connect = \"c:1\""),
            ],
            "18:11",
            cannot(0, "d", copper, "port 1 of \"c\"", ebus),
            "connect = \"b:1\"",
        ),
        (
            "host = { port = \"ebus\" }",
            vec![(TERMINAL, ""), (DRIVE, "")],
            "7:1",
            cannot(0, "b", copper, "port 1 of \"a\"", ebus),
            "expected an EtherCAT extension, such as device = \"beckhoff_ek1110\", before it",
        ),
        // A copper device may be swapped, but a coupler may not be entered by its contacts.
        (
            "",
            vec![(DRIVE, ""), (COUPLER, "port = 1")],
            "7:1",
            cannot(1, "b", ebus, "port 1 of \"a\"", copper),
            "",
        ),
    ] {
        let (found, found_hint) = refused(&text(head, &devices));
        assert_eq!(found, format!("{place} {message}"));
        let found_hint = found_hint.unwrap_or_default();
        assert!(found_hint.contains(hint), "{message}: {found_hint}");
    }
}

#[test]
fn an_embedded_pc_has_its_terminals_at_its_side() {
    let text =
        text("host = { port = \"ebus\" }", &[(TERMINAL, ""), (TERMINAL, ""), (EXTENSION, "")]);
    let segment = SegmentFile::parse("s.toml", &text).unwrap();
    assert_eq!(segment.host.port, PortKind::Ebus);
    assert!(segment.subdevices.iter().all(|device| device.cable == Length(0)));
}

#[test]
fn contacts_are_no_cable() {
    for (key, value) in [("cable", "1m"), ("cable_delay", "5ns/m"), ("cable_asymmetry", "0ns")] {
        let lines = format!("{key} = \"{value}\"");
        let (message, _) = refused(&text("", &[(COUPLER, "cable = \"1m\""), (TERMINAL, &lines)]));
        let column = key.len() + 4;
        assert_eq!(
            message,
            format!(
                "10:{column} {key} is given, but \"b\" is joined by EBUS, whose contacts are no cable; expected \
                 no {key} here"
            )
        );
    }
}

/// Terminals have EBUS on both sides, drives and boxes have copper, couplers have both.
#[test]
fn built_in_devices_have_the_ports_of_their_makers() {
    let kinds = |profile: &Profile| {
        [P0, P1, P2, P3].map(|port| match profile.esc().port(port) {
            PortKind::Mii => 'Y',
            PortKind::Ebus => 'K',
            PortKind::None | PortKind::NotConfigured => ' ',
        })
    };
    let mut terminals = 0;
    for profile in profile::built_in_ids().map(|id| profile::built_in(id).unwrap()) {
        let found: String = kinds(&profile).into_iter().collect();
        let is_terminal = ["EL", "EJ"].iter().any(|family| profile.name.starts_with(family));
        let expected = match profile.id.as_str() {
            COUPLER => "YKY",
            EXTENSION => "KY",
            "simple_io4" | "simple_io16" | "model_every_mode" => "YYY",
            _ if is_terminal => "KK",
            _ => "YY",
        };
        terminals += usize::from(is_terminal);
        assert_eq!(found.trim_end(), expected, "{}", profile.id);
    }
    assert_eq!(terminals, 10);
}
