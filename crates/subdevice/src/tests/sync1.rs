//! The modes with SYNC1: which steps start, what is in time, and what ends OP.

use isocat_sync::{Event, Step, SyncMode};
use isocat_wire::dc::SyncActivation;
use isocat_wire::register;
use isocat_wire::{AbortCode, AlState, AlStatus, AlStatusCode, Nanos};

use super::bench::{Bench, Call};
use super::device::{Builder, description};
use super::sync::{begin, event, finish};

use Step::{Application, LatchInputs, MapInputs, MapOutputs, OutputsValid};

/// A device in PREOP that announces all types.
fn preop(device: impl FnOnce(&mut Builder)) -> Bench {
    let all = |d: &mut Builder| {
        d.preset(0x1C32, 4, &[0x3F, 0]);
        d.preset(0x1C33, 4, &[0x3F, 0]);
        device(d);
    };
    let mut bench = Bench::in_state(description(all), AlState::PreOp);
    bench.set_process_data(7, 7);
    bench
}

/// Switches both SYNC signals on.
fn set_sync(bench: &mut Bench, sync0: u32, sync1: u32) {
    bench.set_sync0(sync0);
    bench.set(register::SYNC1_CYCLE, sync1);
    bench.set(register::SYNC_ACTIVATION, SyncActivation(7));
}

fn types(bench: &mut Bench) -> (u32, u32) {
    (bench.number(0x1C32, 1), bench.number(0x1C33, 1))
}

/// The mode that follows from SYNC0 every ms, these registers and these types.
fn entered(sync1: u32, output: Option<u8>, input: Option<u8>) -> Result<SyncMode, AlStatusCode> {
    let mut bench = preop(|_| {});
    for (index, kind) in [(0x1C32, output), (0x1C33, input)] {
        if let Some(kind) = kind {
            bench.download(index, 1, &[kind, 0]).unwrap();
        }
    }
    set_sync(&mut bench, 1_000_000, sync1);
    match bench.ask(AlState::SafeOp) {
        (AlStatus(4), _) => Ok(bench.device.sync().mode()),
        (_, code) => Err(code),
    }
}

#[test]
fn registers_and_types_name_the_mode_together() {
    use SyncMode::{DcShiftSync1, DcSubordinated, DcSync0, DcSync1};
    assert_eq!(entered(100_000, None, None), Ok(DcShiftSync1));
    assert_eq!(entered(100_000, Some(3), Some(3)), Ok(DcSync1));
    assert_eq!(entered(100_000, None, Some(3)), Ok(DcShiftSync1));
    assert_eq!(entered(100_000, Some(3), None), Ok(DcSync1));
    assert_eq!(entered(100_000, Some(2), Some(2)), Ok(DcSync0), "SYNC1 pulses go nowhere");
    assert_eq!(entered(999_999, None, None), Ok(DcShiftSync1));
    assert_eq!(entered(1_000_000, None, None), Ok(DcSubordinated));
    assert_eq!(entered(3_000_000, Some(3), Some(3)), Ok(DcSubordinated));
    let inconsistent = AlStatusCode::INCONSISTENT_SETTINGS;
    assert_eq!(entered(100_000, Some(3), Some(2)), Err(inconsistent));
    assert_eq!(entered(100_000, Some(2), Some(0)), Err(inconsistent));
}

#[test]
fn what_is_not_announced_is_refused() {
    let refused = |word: u8, sync1| {
        let mut bench = preop(|d| {
            d.preset(0x1C32, 4, &[word, 0]);
            d.preset(0x1C33, 4, &[word, 0]);
        });
        let abort = bench.download(0x1C33, 1, &[3, 0]);
        set_sync(&mut bench, 1_000_000, sync1);
        (abort, bench.ask(AlState::SafeOp))
    };
    let invalid = (AlStatus(0x12), AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
    assert_eq!(refused(0x07, 100_000), (Err(AbortCode::VALUE_RANGE), invalid));
    assert_eq!(refused(0x0F, 100_000).1.0, AlStatus(4));
    assert_eq!(refused(0x0F, 1_000_000), (Ok(()), invalid), "subordinated cycles need bit 4");
    assert_eq!(refused(0x1F, 1_000_000).1.0, AlStatus(4));

    // Type 3 without SYNC1.
    let mut bench = preop(|_| {});
    bench.download(0x1C33, 1, &[3, 0]).unwrap();
    bench.set_sync0(1_000_000);
    assert_eq!(bench.ask(AlState::SafeOp), invalid);
    // SYNC1 without SYNC0.
    bench.set(register::SYNC_ACTIVATION, SyncActivation(5));
    assert_eq!(bench.acknowledge(AlState::SafeOp), invalid);

    // A device whose subordinated cycles need a certain SYNC0 cycle.
    let with = |sync0: u32| {
        let mut bench = preop(|d| d.behaviour.subordinated_sync0_cycle = Nanos(250_000));
        set_sync(&mut bench, sync0, 750_000);
        bench.ask(AlState::SafeOp)
    };
    assert_eq!(with(250_000).0, AlStatus(4));
    assert_eq!(with(375_000), (AlStatus(0x12), AlStatusCode::DC_SYNC0_CYCLE));
}

/// Terminals announce SYNC1 without SYNC0, and use both.
#[test]
fn sync1_brings_the_sync0_that_it_follows() {
    let with = |activation: u8, kind: Option<u8>| {
        let mut bench = preop(|d| {
            d.preset(0x1C32, 4, &[0x0B, 0x44]);
            d.preset(0x1C33, 4, &[0x0B, 0x44]);
        });
        for (index, kind) in [(0x1C32, kind), (0x1C33, kind)] {
            if let Some(kind) = kind {
                bench.download(index, 1, &[kind, 0]).unwrap();
            }
        }
        set_sync(&mut bench, 1_000_000, 25_000);
        bench.set(register::SYNC_ACTIVATION, SyncActivation(activation));
        let status = bench.ask(AlState::SafeOp);
        (status, bench.device.sync().mode())
    };
    let ok = (AlStatus(4), AlStatusCode::NO_ERROR);
    assert_eq!(with(7, Some(3)), (ok, SyncMode::DcSync1));
    assert_eq!(with(7, None), (ok, SyncMode::DcSync1), "as the registers have it");
    let invalid = (AlStatus(0x12), AlStatusCode::INVALID_DC_SYNC_CONFIGURATION);
    assert_eq!(with(3, None).0, invalid, "SYNC0 alone is not among the types");
}

/// Runs one ms: outputs 400 us before SYNC0, then SYNC0 and the pulses after it.
fn cycle(bench: &mut Bench, outputs: bool, pulses: &[(i64, Event)]) {
    if outputs {
        bench.write_outputs(&[5; 7]);
        bench.run(Event::Sm2);
    }
    let mut at = 0;
    for (due, pulse) in pulses {
        bench.pass(Nanos(due - at));
        at = *due;
        bench.run(*pulse);
    }
    bench.pass(Nanos(1_000_000 - at));
}

const SHIFTED: [(i64, Event); 2] = [(400_000, Event::Sync0), (500_000, Event::Sync1)];

/// SYNC0 every 250 us; SYNC1 with the last of four.
const SUBORDINATED: [(i64, Event); 5] = [
    (150_000, Event::Sync0),
    (400_000, Event::Sync0),
    (650_000, Event::Sync0),
    (900_000, Event::Sync0),
    (900_000, Event::Sync1),
];

fn in_op(
    device: impl FnOnce(&mut Builder),
    types: [u8; 2],
    sync: (u32, u32),
    pulses: &[(i64, Event)],
) -> Bench {
    let mut bench = preop(device);
    bench.download(0x1C32, 1, &[types[0], 0]).unwrap();
    bench.download(0x1C33, 1, &[types[1], 0]).unwrap();
    set_sync(&mut bench, sync.0, sync.1);
    assert_eq!(bench.ask(AlState::SafeOp).0, AlStatus(4));
    cycle(&mut bench, true, pulses);
    assert_eq!(bench.ask(AlState::Op).0, AlStatus(4));
    for _ in 0..202 {
        cycle(&mut bench, true, pulses);
    }
    assert_eq!(bench.status(), (AlStatus(8), AlStatusCode(0)));
    bench.calls();
    bench
}

fn counts(bench: &Bench) -> [u16; 3] {
    let sync = bench.device.sync();
    [sync.sm_event_missed(), sync.cycle_time_too_small(), sync.shift_time_too_short()]
}

#[test]
fn sync1_takes_the_inputs_behind_the_outputs() {
    let mut bench = in_op(|_| {}, [2, 3], (1_000_000, 100_000), &SHIFTED);
    assert_eq!(types(&mut bench), (2, 3));
    bench.write_outputs(&[1; 7]);
    assert_eq!(bench.run(Event::Sm2), [(MapOutputs, 0)]);
    assert_eq!(bench.run(Event::Sync0), [(Application, 0), (OutputsValid, 30_000)]);
    // 0x1C33:09 counts from SYNC1.
    assert_eq!(bench.run(Event::Sync1), [(LatchInputs, 30_000), (MapInputs, 30_000)]);
    assert_eq!(counts(&bench), [0; 3]);
}

#[test]
fn outputs_can_be_shifted_by_sync1_too() {
    let on_sync1 = |d: &mut Builder| d.behaviour.outputs_on_sync1 = true;
    let mut bench = in_op(on_sync1, [2, 3], (1_000_000, 100_000), &SHIFTED);
    bench.write_outputs(&[1; 7]);
    bench.run(Event::Sm2);
    assert_eq!(bench.run(Event::Sync0), [(Application, 0)]);
    let steps = [(OutputsValid, 30_000), (LatchInputs, 30_000), (MapInputs, 30_000)];
    assert_eq!(bench.run(Event::Sync1), steps);
}

/// SYNC0 fetches and SYNC1 acts; their distance is as long as copying takes, or 1 ns shorter.
#[test]
fn sync1_must_leave_the_time_to_copy() {
    let with_slack = |slack: i64| {
        let mut bench = in_op(|_| {}, [3, 3], (1_000_000, 100_000), &SHIFTED);
        bench.write_outputs(&[9; 7]);
        assert_eq!(bench.run(Event::Sm2), [], "it is only noted that they came");
        bench.pass(Nanos(400_000));
        assert_eq!(event(&mut bench, Event::Sync0).as_slice(), [(MapOutputs, Nanos(0))]);
        begin(&mut bench, MapOutputs);
        bench.now += Nanos(100_000);
        if slack >= 0 {
            finish(&mut bench, MapOutputs);
        }
        let steps = [(LatchInputs, 0), (Application, 0), (MapInputs, 0), (OutputsValid, 30_000)];
        assert_eq!(bench.run(Event::Sync1), steps);
        if slack < 0 {
            bench.now += Nanos(1);
            finish(&mut bench, MapOutputs);
        }
        (counts(&bench), bench.calls().contains(&Call::Map(std::vec![9; 7])))
    };
    assert_eq!(with_slack(0), ([0, 0, 0], true));
    assert_eq!(with_slack(-1), ([0, 0, 1], false), "too late is not used");
}

#[test]
fn outputs_that_do_not_come_are_missed_at_sync0() {
    for types in [[2, 3], [3, 3]] {
        let mut bench = in_op(|_| {}, types, (1_000_000, 100_000), &SHIFTED);
        cycle(&mut bench, false, &SHIFTED);
        assert_eq!(counts(&bench), [3, 0, 0], "{types:?}");
        cycle(&mut bench, true, &SHIFTED);
        assert_eq!(counts(&bench), [2, 0, 0], "{types:?}");
        cycle(&mut bench, false, &SHIFTED);
        let error = AlStatusCode::SYNCHRONIZATION_ERROR;
        assert_eq!(bench.status(), (AlStatus(0x14), error), "{types:?}");
    }
}

#[test]
fn subordinated_cycles_expect_outputs_once_and_take_inputs_once() {
    let mut bench = in_op(|_| {}, [3, 3], (250_000, 750_000), &SUBORDINATED);
    assert_eq!(bench.number(0x1C32, 2), 250_000);
    bench.write_outputs(&[1; 7]);
    assert_eq!(bench.run(Event::Sm2), [(MapOutputs, 0)]);
    let each = [(Application, 0), (OutputsValid, 30_000)];
    for _ in 0..3 {
        assert_eq!(bench.run(Event::Sync0), each);
    }
    let last = [(LatchInputs, 0), (Application, 0), (MapInputs, 0), (OutputsValid, 30_000)];
    assert_eq!(bench.run(Event::Sync0), last);
    assert_eq!(bench.run(Event::Sync1), []);
    assert_eq!(counts(&bench), [0; 3]);
    cycle(&mut bench, false, &SUBORDINATED);
    assert_eq!(counts(&bench), [3, 0, 0], "once a cycle of SYNC1");
    let calls = bench.calls();
    let applied = calls.iter().filter(|call| **call == Call::Application(Nanos(250_000))).count();
    assert_eq!(applied, 8);
}

#[test]
fn the_application_can_wait_for_sync1() {
    let at_sync1 = |d: &mut Builder| d.behaviour.application_on_sync1 = true;
    let mut bench = in_op(at_sync1, [3, 3], (250_000, 750_000), &SUBORDINATED);
    cycle(&mut bench, true, &SUBORDINATED);
    let calls = bench.calls();
    let applied = calls.iter().filter(|call| **call == Call::Application(Nanos(1_000_000))).count();
    assert_eq!((applied, calls.contains(&Call::Application(Nanos(250_000)))), (1, false));
}

/// The next SYNC0 fetches the next outputs before the hardware's delay after SYNC1 is over.
#[test]
fn outputs_of_the_next_cycle_in_work_are_not_late_for_this_one() {
    let mut bench = in_op(
        |_| {},
        [3, 3],
        (1_000_000, 980_000),
        &[(10_000, Event::Sync0), (990_000, Event::Sync1)],
    );
    bench.write_outputs(&[9; 7]);
    bench.run(Event::Sm2);
    bench.pass(Nanos(10_000));
    bench.run(Event::Sync0);
    bench.pass(Nanos(980_000));
    let steps = event(&mut bench, Event::Sync1);
    assert!(steps.as_slice().contains(&(OutputsValid, Nanos(30_000))));
    bench.write_outputs(&[8; 7]);
    bench.pass(Nanos(20_000));
    event(&mut bench, Event::Sync0);
    begin(&mut bench, MapOutputs);
    bench.now += Nanos(10_000);
    begin(&mut bench, OutputsValid);
    assert_eq!(counts(&bench), [0; 3]);
    finish(&mut bench, OutputsValid);
    bench.now += Nanos(10_000);
    finish(&mut bench, MapOutputs);
    assert!(bench.calls().contains(&Call::Map(std::vec![8; 7])), "they are not too late either");
}

/// 0x1C32:03 shifts outputs after SYNC1 of subordinated cycles, but not after a SYNC1 that is the
/// shift itself.
#[test]
fn a_local_timer_shifts_behind_the_pulse_of_the_cycle_only() {
    let valid_after = |types, sync: (u32, u32), cycle: &[(i64, Event)]| {
        let shifts = |d: &mut Builder| {
            (d.behaviour.application_on_sync1, d.behaviour.shift_outputs) = (true, true);
            d.preset(0x1C32, 3, &45_000u32.to_le_bytes());
        };
        let mut bench = in_op(shifts, types, sync, cycle);
        bench.write_outputs(&[1; 7]);
        bench.run(Event::Sm2);
        bench.run(Event::Sync0);
        let steps = bench.run(Event::Sync1);
        steps.into_iter().find(|(step, _)| *step == OutputsValid).map(|(_, delay)| delay)
    };
    assert_eq!(valid_after([3, 3], (250_000, 750_000), &SUBORDINATED), Some(45_000));
    assert_eq!(valid_after([3, 3], (1_000_000, 100_000), &SHIFTED), Some(30_000));
}

#[test]
fn a_sync_signal_that_stays_away_ends_op() {
    for missing in [Event::Sync0, Event::Sync1] {
        let mut bench = in_op(|_| {}, [2, 3], (1_000_000, 100_000), &SHIFTED);
        let rest: std::vec::Vec<_> =
            SHIFTED.into_iter().filter(|(_, event)| *event != missing).collect();
        let fell = (1..10).find(|_| {
            cycle(&mut bench, true, &rest);
            bench.device.state() != AlState::Op
        });
        assert!(fell.is_some(), "{missing:?}");
        assert_eq!(bench.status(), (AlStatus(0x14), AlStatusCode::FATAL_SYNC_ERROR));
    }
}

#[test]
fn op_waits_for_sync1_as_for_sync0() {
    let mut bench = preop(|_| {});
    set_sync(&mut bench, 1_000_000, 100_000);
    bench.ask(AlState::SafeOp);
    assert_eq!(bench.ask(AlState::Op).0, AlStatus(4));
    for _ in 0..9_000 {
        cycle(&mut bench, true, &SHIFTED[..1]);
    }
    assert_eq!(bench.status(), (AlStatus(0x14), AlStatusCode::NO_SYNC));
}

/// If SYNC0 fetches the outputs, SM2 only marks the buffer as new.
#[test]
fn a_program_without_sm2_looks_at_sync0() {
    let polls = |d: &mut Builder| d.behaviour.polls_outputs = true;
    let mut bench = in_op(polls, [2, 2], (1_000_000, 100_000), &SHIFTED);
    bench.write_outputs(&[1; 7]);
    assert_eq!(bench.run(Event::Sm2), []);
    // 0x1C32:06 and :09 from SYNC0 on.
    let steps = [
        (LatchInputs, 0),
        (MapOutputs, 0),
        (Application, 0),
        (MapInputs, 0),
        (OutputsValid, 90_000),
    ];
    assert_eq!(bench.run(Event::Sync0), steps);
    assert_eq!(counts(&bench), [0; 3]);
    let steps = [(LatchInputs, 0), (Application, 0), (MapInputs, 0), (OutputsValid, 90_000)];
    assert_eq!(bench.run(Event::Sync0), steps, "nothing came");
    assert_eq!(counts(&bench), [3, 0, 0]);
}
