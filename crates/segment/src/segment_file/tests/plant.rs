//! `[[output]]` and `[[plant]]`: their results, and every contradiction with its place.

use isocat_maindevice::written::{Bits, Shape, Start};
use isocat_sim::plant::Control;

use super::*;

fn parse(more: &str) -> SegmentFile {
    SegmentFile::parse("s.toml", &one(more)).unwrap_or_else(|error| panic!("{error}\n{more}"))
}

/// An output of the target position; line 4 is its head.
fn output(lines: &str) -> String {
    format!("[[output]]\nat = \"in-operation\"\ndevice = \"0\"\n{lines}\n")
}

/// A plant on it; line 9 is its head.
fn plant(lines: &str) -> String {
    let target = output("place = \"0x607A:00\"\nvalue = 1");
    format!("{target}[[plant]]\ndevice = \"0\"\n{lines}\n")
}

const INERTIAS: &str = "motor_inertia = \"3kgcm2\"\nload_inertia = \"7kgcm2\"";

#[test]
fn places_are_found_by_object_and_by_byte() {
    let place = |lines: &str| parse(&output(lines)).outputs[0].place;
    let target = Bits { at: 16, len: 32, signed: true };
    assert_eq!(place("place = \"0x607A:00\"\nvalue = 1"), target);
    assert_eq!(place("place = \"0x607a\"\nvalue = 1"), target);
    assert_eq!(place("place = \"byte 2\"\nvalue = 1"), target);
    let byte = Bits { at: 48, len: 8, signed: false };
    assert_eq!(place("place = \"byte 6\"\ntype = \"u8\"\nvalue = 255"), byte);
    // A device without CoE has its mapping in the SII.
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n";
    let text = format!("{text}{}", output("place = \"byte 0\"\ntype = \"u8\"\nvalue = 5"));
    let file = SegmentFile::parse("s.toml", &text).unwrap();
    assert_eq!(file.outputs[0].place, Bits { at: 0, len: 8, signed: false });
}

#[test]
fn shapes_and_instants() {
    let file = parse(
        "[[output]]\nat = \"2s\"\ndevice = \"0\"\nplace = \"0x607A\"\nvalue = -5\nover = \"10ms\"\n\
         [[output]]\nat = \"cycle 7 + 1ms\"\ndevice = \"0\"\nplace = \"0x607A\"\namplitude = 9\nperiod = \"1s\"\nlasts = \"2s\"\n",
    );
    let of = |at: usize| (file.outputs[at].start, file.outputs[at].shape);
    let ramp = Shape::Value { value: -5, over: Nanos::millis(10) };
    assert_eq!(of(0), (Start::At(Nanos::millis(2_000)), ramp));
    let (period, lasts) = (Nanos::millis(1_000), Some(Nanos::millis(2_000)));
    let sine = Shape::Sine { amplitude: 9, period, lasts };
    assert_eq!(of(1), (Start::Cycle(7, Nanos::millis(1)), sine));
}

#[test]
fn outputs_that_cannot_be() {
    let message = |lines: &str| refused(&one(&output(lines))).0;
    assert_eq!(
        message("place = \"0x6071:00\"\nvalue = 1"),
        "7:9 0x6071:00 is not mapped in the outputs; expected one of 0x6040:00, 0x607A:00, 0x6060:00"
    );
    assert_eq!(
        message("place = \"byte 4\"\nvalue = 1"),
        "7:9 32 bits from byte 4 on end behind the outputs; expected a place in 7 bytes"
    );
    assert!(message("place = \"byte 536870912\"\nvalue = 1").contains("end behind the outputs"));
    assert_eq!(
        message("place = \"the target\"\nvalue = 1"),
        "7:9 \"the target\" is no place; expected an object such as \"0x607A:00\", or a byte such as \"byte 2\""
    );
    assert_eq!(
        message("place = \"0x6060\"\nvalue = 128"),
        "8:9 128 does not fit there; expected -128 to 127"
    );
    parse(&output("place = \"0x6060\"\nvalue = 127"));
    assert_eq!(
        message("place = \"0x6060\"\ntype = \"i16\"\nvalue = 1"),
        "7:9 it is mapped with 8 bits, and the type has 16; expected a type of as many, or none"
    );
    assert!(message("place = \"0x6060\"").contains("nothing is written; expected a number"));
    assert!(
        refused(&one("[[output]]\nat = \"1s\"\ndevice = \"z\"\nplace = \"byte 0\"\nvalue = 1"))
            .0
            .contains("no device \"z\"; expected a name, or a position from 0 to 0")
    );
}

#[test]
fn outputs_that_contradict_each_other() {
    let two = |first: &str, second: &str| {
        let text = one(&(output(first) + &output(second)));
        SegmentFile::parse("s.toml", &text).map(drop).map_err(|error| error.message.clone())
    };
    let target = "place = \"0x607A:00\"\nvalue = 1";
    assert_eq!(
        two(target, "place = \"byte 2\"\nvalue = 2").unwrap_err(),
        "another output begins at the same instant in the same place; expected another instant"
    );
    assert_eq!(
        two(target, "place = \"byte 1\"\ntype = \"u16\"\nvalue = 2").unwrap_err(),
        "bits 8 to 23 are written here, and bits 16 to 47 by another output; expected the same bits, or none in common"
    );
    // The next bits on either side are free.
    two(target, "place = \"byte 0\"\ntype = \"u16\"\nvalue = 2").unwrap();
    two(target, "place = \"byte 6\"\ntype = \"u8\"\nvalue = 2").unwrap();
}

#[test]
fn a_plant_has_defaults_of_a_drive() {
    let file = parse(&plant(INERTIAS));
    let plant = file.plants[0];
    assert_eq!((plant.device, plant.command), (0, file.outputs[0].place));
    assert_eq!(plant.actual, Some(Bits { at: 16, len: 32, signed: true }));
    assert_eq!(plant.control, Control::Position { gain: 50.0, speed_gain: 300.0 });
    assert_eq!((plant.increments, plant.travel_um), (1_048_576.0, 10_000.0));
    assert!((plant.masses.motor - 3e-4).abs() < 1e-18, "{:?}", plant.masses);
}

#[test]
fn plants_that_cannot_be() {
    let message = |lines: &str| refused(&one(&plant(lines))).0;
    let with = |line: &str| message(&format!("{INERTIAS}\n{line}"));
    assert_eq!(
        message("motor_inertia = \"-3kgcm2\"\nload_inertia = \"7kgcm2\""),
        "11:17 motor_inertia = \"-3kgcm2\" is out of range; expected 0.0001kgcm2 to 10000000kgcm2"
    );
    assert!(message("motor_inertia = 3\nload_inertia = \"7kgcm2\"").contains(
        "expected a number with its unit from \"0.0001kgcm2\" to \"10000000kgcm2\", found the number 3"
    ));
    for wrong in ["3", "3 kg", "inf kgcm2", "3e1kgcm2", "--3kgcm2", "kgcm2"] {
        let text = message(&format!("motor_inertia = \"{wrong}\"\nload_inertia = \"7kgcm2\""));
        assert!(text.contains("expected a number with its unit"), "{text}");
    }
    assert_eq!(
        with("speed_gain = \"1000.1/s\""),
        "13:14 speed_gain = \"1000.1/s\" is more than one to a cycle of 1 ms, and the loop would not be stable; expected at \
         most 1000/s"
    );
    parse(&plant(&format!("{INERTIAS}\nspeed_gain = \"1000/s\"")));
    assert!(
        with("position_gain = \"301/s\"").contains("more than speed_gain; expected at most 300/s")
    );
    assert!(with("stiffness = \"900000Nm/rad\"").contains("expected at most 10000 Hz"));
    assert!(
        with("damping = \"1Nms/rad\"").contains("is more than critical; expected at most 0.5796")
    );
    assert!(with("friction = \"50Nms/rad\"").contains("expected at most 43.98"));
    assert!(
        with("command = \"0x6060\"").contains("nothing is written to the command of this plant")
    );
    assert!(with("torque = \"1Nm\"").contains("expected commands = \"torque\" beside it"));
    let torque = with("commands = \"torque\"\nspeed_gain = \"1/s\"");
    assert!(torque.contains("expected commands = \"position\" beside it"), "{torque}");
    let twice = plant(&format!("{INERTIAS}\n[[plant]]\ndevice = \"0\"\n{INERTIAS}"));
    assert!(refused(&one(&twice)).0.contains("moves another plant already; expected one at most"));
    assert_eq!(
        refused(&one("[[expect]]\nplant_deviation = \"1um\"")).0,
        "5:19 there is no such plant; expected a [[plant]]"
    );
}

/// If outputs act several times per cycle, a loop that runs once would not behave like the device.
#[test]
fn a_position_loop_runs_once_a_cycle() {
    let text = |mode: &str, commands: &str| {
        format!(
            "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"{mode}\"\n{}\
             [[plant]]\ndevice = \"0\"\ncommand = \"0x7000:01\"\ncommands = \"{commands}\"\n{INERTIAS}\n",
            output("place = \"0x7000:01\"\nvalue = 1")
        )
    };
    let parse = |mode, commands| SegmentFile::parse("s.toml", &text(mode, commands));
    parse("dc-sync0", "position").unwrap();
    parse("dc-subordinated", "torque").unwrap();
    let error = parse("dc-subordinated", "position").unwrap_err();
    assert!(error.message.contains("expected commands = \"torque\", or another mode"), "{error}");
}
