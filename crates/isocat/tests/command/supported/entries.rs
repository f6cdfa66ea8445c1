//! The claims of docs/supported.md, each with what holds it.

/// A segment file, the words behind `isocat` (`my.toml` is that file), the exit code, and a word
/// that must be printed; with `!` in front, one that must not.
pub type Try = (&'static str, &'static str, i32, &'static str);

pub enum Entry {
    /// Commands of the user's try it.
    Tried(&'static [Try]),
    /// This file of tests, or this script, holds it.
    Held(&'static str),
    /// Nothing holds it, because …
    Unchecked(&'static str),
}
use Entry::{Held, Tried, Unchecked};

/// Whether it stands in the column of what is supported.
#[derive(Debug, PartialEq, Eq, Clone, Copy)]
pub enum Side {
    Yes,
    No,
}
use Side::{No, Yes};

const RUN: &str = "run my.toml --for 30ms";
pub const EVERY: &str = "device = \"model_every_mode\"";
pub const IO: &str = "device = \"simple_io16\"";
const UP: &str = "In sync:";
const UNKNOWN: &str = "unknown key";

/// The claims in the order of the page: its column, how it begins, and what holds it. In a segment
/// file `EVERY` and `IO` stand for a `[[subdevice]]` of that kind; the cycle is 1 ms if none is
/// named.
pub const ENTRIES: &[(Side, &str, Entry)] = &[
    (
        Yes,
        "all eight: Free Run, SM-synchronous, DC SYNC0",
        Tried(&[
            ("EVERY mode = \"free-run\"", RUN, 0, "Free Run"),
            ("EVERY mode = \"sm\"", RUN, 0, UP),
            ("EVERY mode = \"sm\"; input_shift = \"300us\"", RUN, 0, UP),
            ("EVERY mode = \"dc-sync0\"", RUN, 0, UP),
            ("EVERY mode = \"dc-sync0\"; shift = \"120us\"", RUN, 0, UP),
        ]),
    ),
    (
        Yes,
        "inputs or both shifted by SYNC1",
        Tried(&[("EVERY mode = \"dc-shift-sync1\"", RUN, 0, UP)]),
    ),
    (Yes, "DC SYNC1", Tried(&[("EVERY mode = \"dc-sync1\"", RUN, 0, UP)])),
    (
        Yes,
        "subordinated cycles",
        Tried(&[("EVERY mode = \"dc-subordinated\"; sync0_cycle = \"250us\"", RUN, 0, UP)]),
    ),
    (Yes, "devices that take no SM2 interrupt", Held("crates/isocat/tests/running/modes.rs")),
    (
        Yes,
        "SYNC pulses that end by themselves or are acknowledged",
        Tried(&[
            ("EVERY pulse = \"5us\"", RUN, 0, UP),
            ("EVERY pulse = \"0ns\"; acknowledge = \"3us\"", RUN, 0, UP),
        ]),
    ),
    (
        No,
        "SYNC in single shot on the way up",
        Tried(&[("EVERY single_shot = true", RUN, 2, UNKNOWN)]),
    ),
    (
        No,
        "a MainDevice that chooses a mode with SYNC1 without being asked",
        Tried(&[("EVERY", RUN, 0, "dc-sync0")]),
    ),
    (
        Yes,
        "trees of any shape, MII and EBUS with couplers between, one swapped cable",
        Tried(&[("EVERY; IO connect = \"0:1\"; port = 1; IO connect = \"0:2\"", RUN, 0, UP)]),
    ),
    (Yes, "cables pulled, broken on one way, loose", Held("crates/isocat/tests/faults/wires.rs")),
    (Yes, "devices switched off and on or replaced", Held("crates/isocat/tests/faults/wires.rs")),
    (Yes, "frames lost, damaged, late, doubled", Held("crates/isocat/tests/faults/frames.rs")),
    (Yes, "a redundancy ring between two ports", Tried(&[("ring = true; IO; IO", RUN, 0, UP)])),
    (
        No,
        "two swapped cables",
        Tried(&[
            (
                "EVERY; IO connect = \"0:1\"; port = 1; IO connect = \"0:2\"; port = 1",
                RUN,
                1,
                "no frame came back",
            ),
            (
                "ring = true; IO; IO",
                "run my.toml --interface lo",
                2,
                "is a ring, which has two ports",
            ),
        ]),
    ),
    (Yes, "virtual segment in virtual time", Tried(&[("IO", RUN, 0, "of virtual time")])),
    (
        Yes,
        "on Linux a real network interface with one port",
        Held("crates/isocat/tests/wire/main.rs"),
    ),
    (
        No,
        "interfaces of other systems, XDP, hardware time stamps",
        Tried(&[
            ("IO", "run my.toml --interface lo --xdp", 2, "unexpected argument '--xdp'"),
            ("host.time_stamps = \"hardware\"; IO", RUN, 2, UNKNOWN),
        ]),
    ),
    (No, "EtherCAT in UDP when serving", Unchecked("no flag and no key asks for it")),
    (Yes, "Linux: all of it. Windows and macOS", Held(".ci/systems")),
    (No, "nobody has run them there", Unchecked("neither system is here")),
    (No, "no binaries, no wheel", Unchecked("nothing is published that could be asked")),
    (Yes, "own profiles in TOML", Tried(&[("[subdevice] device = \"./own.toml\"", RUN, 0, UP)])),
    (Yes, "35 built in", Held("crates/isocat/tests/command/facts.rs")),
    (Yes, "devices of ESI files in each of their OpModes", Held("tests/interop/esi_compare.py")),
    (
        Yes,
        "ENI read into a start-up list and written from one",
        Tried(&[
            ("IO", "plan my.toml --eni network.xml", 0, "Fits"),
            ("IO", "eni network.xml", 0, "PREOP is asked for"),
        ]),
    ),
    (
        No,
        "dictionaries in files of their own",
        Tried(&[("IO dictionary = \"objects.xml\"", RUN, 2, UNKNOWN)]),
    ),
    (No, "windows of outputs", Held("crates/isocat/tests/running/windows.rs")),
    (
        No,
        "the OpModes of a profile stand in its SII",
        Unchecked("what steers the MainDevice is no output"),
    ),
    (Yes, "the stack on a microcontroller", Held(".ci/firmware")),
    (Yes, "over the software ESC or a LAN9252", Held("crates/lan925x/tests/stack.rs")),
    (No, "a trial on a real chip", Unchecked("there is none here")),
    (No, "other ESCs need two methods of a trait", Unchecked("it is work, not behaviour")),
    (
        Yes,
        "power lost and back, branches cut and healed",
        Held("crates/isocat/tests/running/changes.rs"),
    ),
    (No, "groups that hang in between others", Held("crates/isocat/tests/running/hot_connect.rs")),
    (
        No,
        "a replacement of another kind",
        Tried(&[(
            "IO name = \"io\"; fault at = \"in-operation + 50ms\"; what = \"replace io kollmorgen_akd2g 50ms\"",
            "run my.toml --for 500ms",
            1,
            "left OP",
        )]),
    ),
    (
        No,
        "a SubDevice that was cut off for less than its watchdog",
        Unchecked("no report names the states of a way back"),
    ),
    (
        Yes,
        "CoE: SDO expedited, normal, segmented",
        Held("crates/isocat/tests/running/objects_over_the_wire.rs"),
    ),
    (Yes, "SoE: parameters of drives", Held("crates/isocat/tests/descriptions/drives.rs")),
    (Yes, "FoE, EoE, AoE and VoE are answered", Held("tests/interop/drives.py")),
    (No, "files, Ethernet and ADS through the mailbox", Held("tests/interop/drives.py")),
    (No, "SoE notifications and commands", Unchecked("no key and no call asks for them")),
    (Yes, "error counters 0x1C32/33:0B-0E", Held("crates/isocat/tests/running/conformance.rs")),
    (
        Yes,
        "times measured on command (:08)",
        Tried(&[(
            "measure_times = true; [subdevice] device = \"./dynamic.toml\"; mode = \"dc-sync0\"",
            RUN,
            0,
            "measured its times (0x1C32:08)",
        )]),
    ),
    (Yes, "distances :0F-:12", Held("crates/isocat/tests/running/quality.rs")),
    (
        Yes,
        "the MainDevice reads counters and distances",
        Held("crates/isocat/tests/running/quality.rs"),
    ),
    (
        No,
        "a measurement (:08) that the MainDevice starts without",
        Tried(&[(
            "[subdevice] device = \"./dynamic.toml\"; mode = \"dc-sync0\"",
            RUN,
            0,
            "!measured its times",
        )]),
    ),
    (Yes, "82 rules on objects", Held("crates/isocat/tests/command/facts.rs")),
    (Yes, "each has a device that breaks it", Held("crates/isocat/tests/running/conformance.rs")),
    (No, "rules on 0x1C32:0E", Tried(&[("", "conform --list", 0, "!1C32:0E")])),
    (
        Yes,
        "one bus cycle, 10 us to 1 s",
        Tried(&[
            ("cycle = \"9999ns\"; IO", "plan my.toml", 2, "10 us to 1 s"),
            ("cycle = \"10us\"; IO", "plan my.toml", 1, "Does not fit"),
            ("cycle = \"1s\"; watchdog = \"4s\"; IO", "plan my.toml", 0, "Fits"),
            ("cycle = \"1000001us\"; IO", "plan my.toml", 2, "10 us to 1 s"),
        ]),
    ),
    (
        Yes,
        "tried from 250 us to 20 ms",
        Tried(&[
            ("cycle = \"250us\"; IO", RUN, 0, UP),
            ("cycle = \"20ms\"; IO", "run my.toml --for 200ms", 0, UP),
        ]),
    ),
    (
        Yes,
        "groups of devices with a slower cycle of their own",
        Tried(&[
            ("IO; IO cycle = \"2ms\"", RUN, 0, UP),
            (
                "EVERY mode = \"dc-subordinated\"; sync0_cycle = \"250us\"; cycle = \"2ms\"",
                RUN,
                2,
                "any other mode",
            ),
            ("IO cycle = \"1500us\"", RUN, 2, "no whole multiple"),
        ]),
    ),
    (
        Yes,
        "devices with a faster one (`dc-subordinated`)",
        Tried(&[("EVERY mode = \"dc-subordinated\"; sync0_cycle = \"125us\"", RUN, 0, UP)]),
    ),
    (No, "groups spread over the bus cycles", Held("crates/isocat/tests/running/groups.rs")),
    (
        No,
        "a watchdog that follows the cycle",
        Tried(&[
            ("cycle = \"120ms\"; IO", "plan my.toml", 1, "watchdog of the process data"),
            ("cycle = \"120ms\"; watchdog = \"500ms\"; IO", "plan my.toml", 0, "Fits"),
        ]),
    ),
    (Yes, "all modes, trees, several cycles", Held("crates/isocat/tests/planning/plan.rs")),
    (
        Yes,
        "bounds proven in simulation",
        Tried(&[("IO", "plan my.toml --prove --for 50ms", 0, "Fits")]),
    ),
    (
        Yes,
        "phase and smallest cycle suggested",
        Tried(&[("EVERY", "plan my.toml --suggest", 0, "smallest")]),
    ),
    (Yes, "start-up list", Tried(&[("IO", "plan my.toml --start-up", 0, "FPWR")])),
    (
        No,
        "figures of a real segment in the plan",
        Tried(&[("IO", "plan my.toml --interface lo", 2, "unexpected argument '--interface'")]),
    ),
    (
        No,
        "devices without an SM2 interrupt are planned",
        Unchecked("the plan does not say which event it took"),
    ),
    (
        No,
        "mailboxes in cycles with less spare time",
        Held("crates/isocat/tests/planning/plan_edges.rs"),
    ),
    (
        No,
        "`run --force` tells which lines don't fit",
        Tried(&[
            ("shift = \"0us\"; EVERY", RUN, 2, "slack"),
            ("shift = \"0us\"; EVERY", "run my.toml --for 30ms --force", 0, "was run all the same"),
        ]),
    ),
    (Yes, "text, JSON", Tried(&[("IO", "run my.toml --for 30ms --json", 0, "\"in_sync\": true")])),
    (Yes, "HTML in one file", Held("crates/isocat/tests/recordings/pages.rs")),
    (Yes, "pcapng with comments", Held("crates/isocat/tests/recordings/capture.rs")),
    (
        Yes,
        "pulses, SM events, steps and states as VCD",
        Held("crates/isocat/tests/recordings/waves.rs"),
    ),
    (Yes, "a row for each SubDevice and cycle", Held("crates/isocat/tests/recordings/series.rs")),
    (No, "true time on a real interface", Unchecked("no clock of this machine is true")),
    (No, "comments in its captures", Unchecked("it needs a wire")),
    (
        Yes,
        "outputs written on a timeline, two masses",
        Held("crates/isocat/tests/running/plant.rs"),
    ),
    (
        No,
        "models of drives to tune by",
        Tried(&[("EVERY; plant device = 0; gravity = \"9.81\"", RUN, 2, UNKNOWN)]),
    ),
    (No, "machines in `watch` and `serve`", Unchecked("both leave the tables out without a word")),
    (Yes, "a screen, lines, a gate for scripts", Held("tests/interop/watch.sh")),
    (Yes, "metrics for Prometheus, a dashboard", Held("tests/interop/metrics.sh")),
    (
        No,
        "metrics of a virtual `run`",
        Tried(&[("IO", "run my.toml --for 30ms --metrics 9100", 2, "isocat watch --metrics")]),
    ),
    (No, "OpenMetrics, TLS and passwords", Unchecked("no flag asks for them")),
    (
        No,
        "in `watch`, expectations",
        Tried(&[("IO", "watch my.toml --capture x.pcapng", 2, "unexpected argument '--capture'")]),
    ),
    (No, "a trial of the dashboard in Grafana itself", Unchecked("Grafana is not here")),
];
