//! The arithmetic is tested against figures of real devices, against a walk along the pulses, and
//! with any input.

use proptest::prelude::*;
use std::string::{String, ToString};
use std::vec::Vec;

use super::*;

/// An OpMode in one line: AssignActivate, SYNC0 value and factor, shift, SYNC1 value and factor,
/// shift.
fn op_mode(
    word: u16,
    (value0, factor0): (i64, i32),
    shift0: i64,
    (value1, factor1): (i64, i32),
    shift1: i64,
) -> OpMode {
    let factor = |factor| Some(factor).filter(|factor| *factor != 0);
    OpMode {
        assign_activate: AssignActivate(word),
        sync0: CycleTime { value: value0, factor: factor(factor0) },
        shift0: ShiftTime { value: shift0, ..ShiftTime::default() },
        sync1: CycleTime { value: value1, factor: factor(factor1) },
        shift1,
    }
}

fn names(registers: &Registers) -> Vec<&'static str> {
    registers.warnings.iter().map(|warning| warning.name()).collect()
}

/// Bus cycle; OpMode; 0x09A0, 0x09A4, period of SYNC1; warnings; modes.
type Row =
    (&'static str, i64, OpMode, (u32, u32, i64), &'static [&'static str], &'static [SyncMode]);

fn rows() -> [Row; 12] {
    use SyncMode::{DcShiftSync1, DcSubordinated, DcSync0, DcSync1, FreeRun, SmSynchronous};
    [
        (
            "analog output",
            1_000_000,
            op_mode(0x0700, (0, 1), 0, (0, 1), 100_000),
            (1_000_000, 100_000, 1_000_000),
            &[],
            &[DcShiftSync1, DcSync1],
        ),
        (
            "servo terminal",
            1_000_000,
            op_mode(0x0700, (0, 1), 30_000, (0, -1), 1_000),
            (1_000_000, 1_000, 1_000_000),
            &[],
            &[DcShiftSync1, DcSync1],
        ),
        (
            "oversampling by 4",
            1_000_000,
            op_mode(0x0730, (0, -4), 0, (0, -1), 0),
            (250_000, 750_000, 1_000_000),
            &[],
            &[DcSubordinated],
        ),
        (
            "drive with a fixed SYNC0",
            1_000_000,
            op_mode(0x0730, (250_000, 0), 0, (0, -1), 0),
            (250_000, 750_000, 1_000_000),
            &[],
            &[DcSubordinated],
        ),
        (
            "servo of 62.5 us",
            500_000,
            op_mode(0x0700, (62_500, 0), 0, (0, -1), 0),
            (62_500, 437_500, 500_000),
            &[],
            &[DcSubordinated],
        ),
        (
            "R1 = R0",
            1_000_000,
            op_mode(0x0700, (500_000, 0), 0, (500_000, 0), 0),
            (500_000, 500_000, 1_000_000),
            &[],
            &[DcSubordinated],
        ),
        (
            "R1 = 1.5 R0",
            1_000_000,
            op_mode(0x0700, (500_000, 0), 0, (750_000, 0), 0),
            (500_000, 750_000, 1_000_000),
            &[],
            &[DcSubordinated],
        ),
        (
            "plain drive",
            2_000_000,
            op_mode(0x0300, (0, 1), 0, (0, 0), 0),
            (2_000_000, 0, 2_000_000),
            &[],
            &[DcSync0],
        ),
        (
            "nothing given",
            1_000_000,
            op_mode(0x0300, (0, 0), 0, (0, 0), 0),
            (1_000_000, 0, 1_000_000),
            &["sync0-undefined"],
            &[DcSync0],
        ),
        (
            "at the PDI, SYNC1 given and off",
            4_000_000,
            op_mode(0x0301, (0, 0), 0, (0, 1), 0),
            (4_000_000, 0, 4_000_000),
            &["unit-at-pdi", "sync0-undefined", "sync1-unused"],
            &[DcSync0],
        ),
        (
            "SYNC1 alone",
            1_000_000,
            op_mode(0x0500, (0, 1), 250_000, (0, 0), 0),
            (1_000_000, 0, 1_000_000),
            &["sync1-alone", "sync1-undefined"],
            &[DcSync1],
        ),
        (
            "SM-synchronous",
            1_000_000,
            op_mode(0x0000, (0, 1), 0, (0, 1), 0),
            (0, 0, 0),
            &["sync-off"],
            &[SmSynchronous, FreeRun],
        ),
    ]
}

#[test]
fn figures_of_the_field() {
    for (case, bus, op_mode, expected, warnings, modes) in rows() {
        let found = op_mode.registers(Nanos(bus), &Unit::default()).unwrap();
        let figures = (found.sync0_cycle, found.sync1, found.period().0);
        assert_eq!(figures, expected, "{case}");
        assert_eq!(names(&found), warnings, "{case}");
        assert_eq!(found.modes(), modes, "{case}");
        assert_eq!(found.assign_activate, op_mode.assign_activate, "{case}");
    }
}

/// Each doubt is tested with an OpMode that has it and with a similar one that does not.
#[test]
fn every_doubt_has_its_name() {
    let at =
        |bus, op_mode: OpMode| names(&op_mode.registers(Nanos(bus), &Unit::default()).unwrap());
    let ms = 1_000_000;
    let sync0 = |value, factor| op_mode(0x0300, (value, factor), 0, (0, 0), 0);
    let sync1 = |value, factor, shift| op_mode(0x0700, (0, 1), 0, (value, factor), shift);
    assert_eq!(at(ms, sync0(-1, 0)), ["negative-sync0"]);
    assert_eq!(at(ms, sync0(ms, 1)), ["sync0-value-and-factor"]);
    assert_eq!(at(ms, sync0(10_000, 0)), ["faster-than-bus"]);
    assert_eq!(at(9_990, sync0(0, 1)), ["below-least"]);
    assert_eq!(at(ms, sync0(0, -3)), ["broken-part", "sync0-off-bus", "off-tick"]);
    assert_eq!(at(900_000, sync0(0, -3)), ["faster-than-bus"]);
    // Fixed at 250 us: good for 1 ms, 250 us and 125 us (slower than the bus), not for 300 us.
    assert_eq!(at(300_000, sync0(250_000, 0)), ["fixed-sync0"]);
    assert_eq!(at(250_000, sync0(250_000, 0)), [""; 0]);
    assert_eq!(at(125_000, sync0(250_000, 0)), ["slower-than-bus"]);
    assert_eq!(at(ms, sync0(0, 2)), ["slower-than-bus"]);
    assert_eq!(at(ms, op_mode(0x0702, (0, 1), 0, (0, 1), 10)), ["reserved-bits"]);
    assert_eq!(at(ms, op_mode(0x0600, (0, 1), 0, (0, 1), 10)), ["not-activated"]);
    assert_eq!(at(ms, op_mode(0x0130, (0, 0), 0, (0, 0), 0)), ["no-pulses"]);
    assert_eq!(at(ms, sync1(0, 1, 0)), ["pulses-coincide"]);
    assert_eq!(at(ms, sync1(0, 0, 10)), ["sync1-undefined"]);
    assert_eq!(at(ms, sync1(-5, 0, 10)), ["negative-sync1"]);
    assert_eq!(at(ms, sync1(500, 1, 0)), ["sync1-value-and-factor"]);
    assert_eq!(at(ms, sync1(500, 0, 70)), ["sync1-fixed-and-shift"]);
    assert_eq!(at(ms, sync1(0, 1, -1_000)), ["sync1-before-sync0"]);
    assert_eq!(at(ms, sync1(0, 1, ms - 10)), [""; 0]);
    assert_eq!(at(ms, sync1(0, 1, ms)), ["sync1-period", "slower-than-bus"]);
    let faster_than_sync0 = op_mode(0x0700, (0, 2), 0, (0, -1), 0);
    let expected = ["sync1-before-sync0", "sync1-period", "slower-than-bus"];
    assert_eq!(at(ms, faster_than_sync0), expected);
    let odd = op_mode(0x0700, (400_000, 0), 0, (400_000, 0), 0);
    assert_eq!(at(1_200_000, odd), ["period-off-bus"]);
    assert_eq!(at(ms, op_mode(0x0300, (0, 1), ms, (0, 0), 0)), ["long-shift"]);
    assert_eq!(at(ms, op_mode(0x0300, (0, 1), ms - 1, (0, 0), 0)), [""; 0]);
    let clock = Unit { clock_only: true, ..Unit::default() };
    let found = op_mode(0x0320, (0, 0), 0, (0, 0), 0).registers(Nanos(ms), &clock).unwrap();
    assert_eq!(names(&found), ["clock-only"]);
    assert_eq!(found.assign_activate, AssignActivate::OFF);
}

#[test]
fn a_shift_is_a_time_and_a_part_of_the_cycle() {
    let shifted = |value, factor| {
        let mut mode = op_mode(0x0300, (0, -2), 0, (0, 0), 0);
        mode.shift0 = ShiftTime { value, factor, input: true };
        let registers = mode.registers(Nanos(1_000_000), &Unit::default()).unwrap();
        assert!(registers.input_based);
        (registers.shift.0, registers.phase().0)
    };
    assert_eq!(shifted(-900, None), (-900, 499_100));
    assert_eq!(shifted(-900, Some(0)), (-900, 499_100));
    assert_eq!(shifted(100, Some(1)), (500_100, 100));
    assert_eq!(shifted(100, Some(-4)), (125_100, 125_100));
    assert_eq!(shifted(2_000_200_300_000, None).1, 300_000);
}

#[test]
fn what_no_register_holds_is_refused() {
    let refused = |op_mode: OpMode, bus| op_mode.registers(Nanos(bus), &Unit::default());
    let long = op_mode(0x0300, (0, 5_000), 0, (0, 0), 0);
    let value = 5_000_000_000;
    let problem = Problem::Register { register: 0x09A0, value };
    assert_eq!(refused(long, 1_000_000), Err(problem));
    assert!(problem.to_string().contains("0x09A0"), "{problem}");
    let long = op_mode(0x0700, (0, 1), 0, (0, 5_001), 0);
    assert_eq!(refused(long, 1_000_000), Err(Problem::Register { register: 0x09A4, value }));
    let mut shifted = op_mode(0x0300, (0, 1), i64::MAX, (0, 0), 0);
    shifted.shift0.factor = Some(1);
    assert_eq!(refused(shifted, 1_000_000), Err(Problem::Shift));
    for bus in [0, -1, i64::MIN, 1 << 32] {
        assert_eq!(refused(shifted, bus), Err(Problem::BusCycle(Nanos(bus))));
    }
    // A part below one nanosecond is not a cycle.
    let fine = op_mode(0x0300, (0, -1_000), 0, (0, 0), 0);
    assert_eq!(refused(fine, 999), Err(Problem::Register { register: 0x09A0, value: 0 }));
}

/// Kind of OpMode; OpMode; its bus cycles in words, or none.
fn bus_cycles() -> [(&'static str, OpMode, Option<&'static str>); 22] {
    let sync0 = |value, factor| op_mode(0x0300, (value, factor), 0, (0, 0), 0);
    [
        ("no SYNC", op_mode(0, (2_000_000, 0), 0, (0, 0), 0), Some("any length")),
        ("plain drive", sync0(0, 1), Some("any length")),
        ("nothing given", sync0(0, 0), Some("any length")),
        ("fixed SYNC0", sync0(2_000_000, 0), Some("2 ms")),
        ("fixed SYNC0 and a factor", sync0(2_000_000, 1), Some("2 ms")),
        ("SYNC0 slower than the bus", sync0(0, 2), None),
        ("SYNC0 faster than the bus, without SYNC1", sync0(0, -4), None),
        ("SYNC0 without its register", sync0(5_000_000_000, 0), None),
        (
            "fixed SYNC0, SYNC1 marks the bus cycle",
            op_mode(0x0730, (250_000, 0), 0, (0, -1), 0),
            Some("a multiple of 250 us"),
        ),
        (
            "the same with a distance",
            op_mode(0x0730, (250_000, 0), 0, (0, -1), 20_000),
            Some("a multiple of 250 us"),
        ),
        (
            "the same with a distance of a SYNC0 cycle",
            op_mode(0x0730, (250_000, 0), 0, (0, -1), 250_000),
            None,
        ),
        (
            "fixed SYNC0, SYNC1 once in four",
            op_mode(0x0700, (250_000, 0), 0, (0, 4), 0),
            Some("1 ms"),
        ),
        (
            "fixed SYNC0 and fixed SYNC1",
            op_mode(0x0700, (250_000, 0), 0, (750_000, 0), 0),
            Some("1 ms"),
        ),
        ("oversampling of 4", op_mode(0x0700, (0, -4), 0, (0, 4), 0), Some("a multiple of 4 ns")),
        (
            "oversampling of 4, SYNC1 by the bus cycle",
            op_mode(0x0700, (0, -4), 0, (0, -1), 0),
            Some("a multiple of 4 ns"),
        ),
        ("oversampling of 4, SYNC1 once in two", op_mode(0x0700, (0, -4), 0, (0, 2), 0), None),
        (
            "oversampling of 4, SYNC1 10 us later",
            op_mode(0x0700, (0, -4), 0, (0, 4), 10_000),
            Some("a multiple of 4 ns, 40.004 us or more"),
        ),
        (
            "oversampling of 4, fixed SYNC1",
            op_mode(0x0700, (0, -4), 0, (750_000, 0), 0),
            Some("a multiple of 4 ns, 750.004 us to 1 ms"),
        ),
        (
            "SYNC1 100 us behind SYNC0",
            op_mode(0x0700, (0, 1), 0, (0, 1), 100_000),
            Some("100.001 us or more"),
        ),
        (
            "SYNC1 fixed at 100 us",
            op_mode(0x0700, (0, 1), 0, (100_000, 0), 0),
            Some("100.001 us or more"),
        ),
        (
            "SYNC1 of the third SYNC0 and 100 us before",
            op_mode(0x0700, (0, 1), 0, (0, 3), -100_000),
            Some("99.999 us or less"),
        ),
        ("R1 too long", op_mode(0x0700, (0, 1), 0, (5_000_000_000, 0), 0), None),
    ]
}

#[test]
fn an_op_mode_says_its_bus_cycles() {
    for (what, op_mode, expected) in bus_cycles() {
        let found = op_mode.bus_cycles(&Unit::default());
        assert_eq!(found.map(|cycles| cycles.to_string()).as_deref(), expected, "{what}");
    }
}

/// At both ends and one step beyond them the pulses repeat as the range says.
#[test]
fn the_edges_of_the_bus_cycles_are_those_of_the_pulses() {
    let repeats = |op_mode: &OpMode, bus| {
        let found = op_mode.registers(bus, &Unit::default());
        found.is_ok_and(|found| found.count == 0 || found.period() == bus)
    };
    for (what, op_mode, _) in bus_cycles() {
        let Some(cycles) = op_mode.bus_cycles(&Unit::default()) else { continue };
        let BusCycles { step, least, most } = cycles;
        for bus in [least - step, least, least + step, most - step, most, most + step] {
            assert_eq!(cycles.contains(bus), repeats(&op_mode, bus), "{what} at {bus}");
        }
    }
}

#[test]
fn the_nearest_bus_cycle_is_one_of_them() {
    let cycles =
        |step, least, most| BusCycles { step: Nanos(step), least: Nanos(least), most: Nanos(most) };
    let nearest = |cycles: BusCycles, wished| cycles.nearest(Nanos(wished)).0;
    let multiples = cycles(250, 500, 1_000);
    for (wished, expected) in [
        (i64::MIN, 500),
        (499, 500),
        (624, 500),
        (625, 750),
        (874, 750),
        (1_001, 1_000),
        (i64::MAX, 1_000),
    ] {
        assert_eq!(nearest(multiples, wished), expected, "{wished}");
    }
    assert_eq!(nearest(cycles(2_000, 2_000, 2_000), 1), 2_000);
    assert_eq!(nearest(BusCycles::ANY, 1_000_000), 1_000_000);
}

/// The instants of SYNC1, computed step by step by the ESC's rule alone.
fn walk(sync0: u64, sync1: u64, pulses: usize) -> Vec<u64> {
    let mut instants = Vec::new();
    let mut follows = 0;
    while instants.len() < pulses {
        let instant = follows + sync1;
        instants.push(instant);
        while follows <= instant {
            follows += sync0;
        }
    }
    instants
}

fn any_factor() -> impl Strategy<Value = Option<i32>> {
    prop_oneof![Just(None), (-30..30).prop_map(Some), any::<i32>().prop_map(Some)]
}

fn any_time() -> impl Strategy<Value = i64> {
    prop_oneof![
        Just(0),
        (-40..400i64).prop_map(|units| units * 12_500),
        -3_000_000..3_000_000i64,
        any::<i64>(),
    ]
}

fn any_op_mode() -> impl Strategy<Value = OpMode> {
    let word = prop_oneof![
        proptest::sample::select(std::vec![
            0x0000u16, 0x0100, 0x0300, 0x0301, 0x0500, 0x0700, 0x0730
        ]),
        any::<u16>(),
    ];
    let cycle =
        || (any_time(), any_factor()).prop_map(|(value, factor)| CycleTime { value, factor });
    let shift = (any_time(), any_factor(), any::<bool>());
    (word, cycle(), shift, cycle(), any_time()).prop_map(|(word, sync0, shift, sync1, shift1)| {
        let (value, factor, input) = shift;
        OpMode {
            assign_activate: AssignActivate(word),
            sync0,
            shift0: ShiftTime { value, factor, input },
            sync1,
            shift1,
        }
    })
}

proptest! {
    /// Any file gives registers or a reason, and every warning has words.
    #[test]
    fn no_input_panics(
        op_mode in any_op_mode(),
        bus in prop_oneof![any::<i64>(), 1..20_000_000i64],
        least in any::<i64>(),
        clock_only in any::<bool>(),
    ) {
        let unit = Unit { least_sync0: Nanos(least), clock_only };
        match op_mode.registers(Nanos(bus), &unit) {
            Ok(found) => {
                let words: String = found.warnings.iter().map(|w| w.to_string()).collect();
                prop_assert_eq!(words.is_empty(), found.warnings.is_empty());
                prop_assert!(found.phase().0 >= 0 && found.phase().0 <= found.period().0);
                prop_assert_eq!(found.count == 0, found.sync0_cycle == 0);
                prop_assert!(!found.modes().is_empty());
            }
            Err(problem) => prop_assert!(!problem.to_string().is_empty()),
        }
    }

    /// N, the period and the phase agree with a walk along the pulses.
    #[test]
    fn the_law_of_sync1_holds_along_the_pulses(sync0 in 1..2_000u32, sync1 in 0..20_000u32) {
        let value = i64::from(sync1);
        let mut mode = op_mode(0x0700, (sync0.into(), 0), 0, (value, 0), 0);
        if value == 0 {
            mode.sync1.factor = Some(1);
        }
        let found = mode.registers(Nanos(1_000_000), &Unit::default()).unwrap();
        prop_assert_eq!((found.sync0_cycle, found.sync1), (sync0, sync1));
        let instants = walk(sync0.into(), sync1.into(), 5);
        for pair in instants.windows(2) {
            prop_assert_eq!((pair[1] - pair[0]) as i64, found.period().0);
        }
        prop_assert_eq!((instants[3] % u64::from(sync0)) as i64, found.behind_sync0().0);
        for mode in SyncMode::ALL {
            prop_assert_eq!(found.pulses(mode).sync1_cycle(), found.period());
        }
    }

    /// The bus cycles are those at which the pulses repeat with the bus, and no others.
    #[test]
    fn bus_cycles_are_all_that_repeat(
        word in proptest::sample::select(std::vec![0x0300u16, 0x0500, 0x0700]),
        (value0, factor0) in (0..40i64, -5..5i32),
        (value1, factor1) in (-1..120i64, -5..5i32),
        shift1 in -120..120i64,
        fixed in (any::<bool>(), any::<bool>()),
    ) {
        let value = |fixed, value| if fixed { value } else { 0 };
        let sync0 = (value(fixed.0, value0), factor0);
        let mode = op_mode(word, sync0, 0, (value(fixed.1, value1), factor1), shift1);
        let cycles = mode.bus_cycles(&Unit::default());
        // Shorter ones than the square of the factor may repeat by the rounding of their parts.
        for bus in 25..600 {
            let bus = Nanos(bus);
            let found = mode.registers(bus, &Unit::default()).map(|found| found.period());
            let allowed = cycles.is_some_and(|cycles| cycles.contains(bus));
            prop_assert_eq!(found == Ok(bus), allowed, "{:?} at {}: {:?}", mode, bus, cycles);
        }
        prop_assert_eq!(cycles.is_some_and(|cycles| cycles.least > cycles.most), false);
    }

    /// Whatever a file states, there is an answer, and its ends are bus cycles that repeat.
    #[test]
    fn any_op_mode_has_bus_cycles_or_none(op_mode in any_op_mode()) {
        let Some(cycles) = op_mode.bus_cycles(&Unit::default()) else { return Ok(()) };
        for bus in [cycles.least, cycles.most] {
            prop_assert!(cycles.contains(bus));
            if let Ok(found) = op_mode.registers(bus, &Unit::default()) {
                prop_assert!(found.count == 0 || found.period() == bus, "{op_mode:?} at {bus}");
            }
        }
    }
}
