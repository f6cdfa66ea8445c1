//! Each counter of the sync objects counts its own errors only: both sides of each edge.

use isocat_sync::{Event, Step};
use isocat_wire::{AlState, AlStatus, AlStatusCode, Nanos};

use super::bench::Bench;
use super::device::{Builder, description};
use super::sync::{begin, dc_cycle, dc_op, event, finish};
use crate::description::{LossCodes, MissedEvents};

/// 0x1C32:0B, :0C, :0D, :0E and :20.
fn counters(bench: &mut Bench) -> [u32; 5] {
    let found = [0x0B, 0x0C, 0x0D, 0x0E, 0x20].map(|sub| bench.number(0x1C32, sub));
    let inputs = [0x0B, 0x0C, 0x0D, 0x0E, 0x20].map(|sub| bench.number(0x1C33, sub));
    assert_eq!(found, inputs, "one engine, both objects");
    found
}

/// The SYNC0 pulse at which OP ends, counted from the first one without outputs.
fn falls_at(rule: MissedEvents, limit: u8, lost: impl Fn(usize) -> bool) -> Option<usize> {
    let mut bench = dc_op(|d| {
        d.behaviour.missed_events = rule;
        d.preset(0x10F1, 2, &[limit, 0]);
    });
    (1..=60).find(|pulse| {
        dc_cycle(&mut bench, !lost(*pulse));
        let fell = bench.device.state() != AlState::Op;
        if fell {
            let error = AlStatusCode::SYNCHRONIZATION_ERROR;
            assert_eq!(bench.status(), (AlStatus(0x14), error));
        }
        fell
    })
}

/// One, two, three and four frames are lost in a row; then one of three, repeatedly.
#[test]
fn lost_frames_end_op_at_the_pulse_that_each_rule_names() {
    use MissedEvents::{Balance, Counted, SlaveStackCode};
    for (rule, limit, in_a_row, of_three) in [
        (Counted, 4, [None, Some(2), Some(2), Some(2)], Some(7)),
        // 3 2 1 4 3 2 5 4 3 ... each loss leaves one more, and the eighth is above nine.
        (Counted, 9, [None, None, None, Some(4)], Some(22)),
        (SlaveStackCode, 4, [None, None, Some(3), Some(3)], None),
        (Balance, 2, [None, None, Some(3), Some(3)], Some(7)),
    ] {
        for (lost, expected) in in_a_row.into_iter().enumerate() {
            let found = falls_at(rule, limit, |pulse| pulse <= lost + 1);
            assert_eq!(found, expected, "{rule:?}, limit {limit}, {} lost", lost + 1);
        }
        let found = falls_at(rule, limit, |pulse| pulse % 3 == 1);
        assert_eq!(found, of_three, "{rule:?}, limit {limit}, one of three lost");
    }
}

/// 0B: an event in time, and one that is missing.
#[test]
fn a_missed_event_counts_alone() {
    let mut bench = dc_op(|_| {});
    dc_cycle(&mut bench, true);
    assert_eq!(counters(&mut bench), [0; 5]);
    dc_cycle(&mut bench, false);
    assert_eq!(counters(&mut bench), [3, 0, 0, 0, 0]);
    for left in [2, 1, 0, 0] {
        dc_cycle(&mut bench, true);
        assert_eq!(counters(&mut bench), [left, 0, 0, 0, 0]);
    }
}

/// 0C: the application ends at the instant of the next event, or 1 ns after it. 20 is set with it.
#[test]
fn a_cycle_that_is_too_short_counts_alone() {
    let with_slack = |slack: i64| {
        let mut bench = Bench::in_state(description(|_| {}), AlState::Op);
        bench.write_outputs(&[1; 7]);
        let steps = event(&mut bench, Event::Sm2);
        for (step, _) in steps.iter().filter(|(step, _)| *step != Step::MapInputs) {
            begin(&mut bench, step);
            finish(&mut bench, step);
        }
        begin(&mut bench, Step::MapInputs);
        if slack >= 0 {
            finish(&mut bench, Step::MapInputs);
        }
        bench.write_outputs(&[2; 7]);
        bench.run(Event::Sm2);
        bench.now += Nanos(1);
        finish(&mut bench, Step::MapInputs);
        counters(&mut bench)
    };
    assert_eq!(with_slack(0), [0; 5]);
    assert_eq!(with_slack(-1), [0, 1, 0, 0, 1]);
}

/// 0D: a shift equal to the device's delay (0x1C32:09), and one that is 1 ns shorter.
#[test]
fn a_shift_that_is_too_short_counts_alone() {
    let shifted = |shift: u32| {
        let mut bench = dc_op(|d| d.behaviour.shift_outputs = true);
        bench.download(0x1C32, 3, &shift.to_le_bytes()).unwrap();
        dc_cycle(&mut bench, true);
        counters(&mut bench)
    };
    assert_eq!(shifted(30_000), [0; 5]);
    assert_eq!(shifted(29_999), [0, 0, 1, 0, 0]);
}

/// 0E: the toggle bit changes with all outputs, or not.
#[test]
fn outputs_that_do_not_toggle_count_alone() {
    let with_toggle = |d: &mut Builder| d.behaviour.output_toggle = Some(11);
    let run = |device: fn(&mut Builder), outputs: [u8; 4]| {
        let mut bench = dc_op(device);
        for byte in outputs {
            bench.write_outputs(&[0, byte, 0, 0, 0, 0, 0]);
            bench.run(Event::Sm2);
            bench.pass(Nanos(1_000_000));
            bench.run(Event::Sync0);
        }
        counters(&mut bench)
    };
    // The cycles before OP have bit 11 clear.
    assert_eq!(run(with_toggle, [8, 0, 8, 0]), [0; 5]);
    assert_eq!(run(with_toggle, [8, 0, 0xF7, 8]), [0, 0, 0, 1, 0]);
    assert_eq!(run(with_toggle, [8, 8, 8, 8]), [0, 0, 0, 3, 0]);
    assert_eq!(run(|_| {}, [8, 8, 8, 8]), [0; 5]);
}

/// 20: the missed events are at their limit, or one above it.
#[test]
fn the_sync_error_is_set_above_the_limit_and_not_at_it() {
    let missed = |limit: u8, cycles: &[bool]| {
        let mut bench = dc_op(|d| d.preset(0x10F1, 2, &[limit, 0]));
        for outputs in cycles {
            dc_cycle(&mut bench, *outputs);
        }
        counters(&mut bench)
    };
    assert_eq!(missed(3, &[false]), [3, 0, 0, 0, 0]);
    assert_eq!(missed(2, &[false]), [3, 0, 0, 0, 1]);
}

#[test]
fn sub_index_8_resets_the_counters_and_measures() {
    let mut bench = dc_op(|d| {
        for sub in [5, 6, 9] {
            d.preset(0x1C32, sub, &[]);
            d.preset(0x1C33, sub, &[]);
        }
        d.behaviour.output_toggle = Some(0);
    });
    dc_cycle(&mut bench, false);
    bench.write_outputs(&[5; 7]);
    bench.run(Event::Sm2);
    assert_eq!(counters(&mut bench), [3, 0, 0, 1, 0]);
    bench.download(0x1C33, 8, &[2, 0]).unwrap();
    assert_eq!(counters(&mut bench), [0; 5]);
    assert_eq!(bench.number(0x1C33, 8), 2, "as it was written");

    // With DC the cycle is that of SYNC0; times that are stated as 0 are measured.
    let times = |bench: &mut Bench| [2, 5, 6, 9].map(|sub| bench.number(0x1C32, sub));
    assert_eq!(times(&mut bench), [1_000_000, 0, 0, 0]);
    bench.download(0x1C32, 8, &[1, 0]).unwrap();
    for copy in [700, 900, 800] {
        bench.write_outputs(&[5; 7]);
        event(&mut bench, Event::Sm2);
        begin(&mut bench, Step::MapOutputs);
        bench.now += Nanos(copy);
        finish(&mut bench, Step::MapOutputs);
        bench.pass(Nanos(1_000_000 - copy));
        bench.run(Event::Sync0);
    }
    assert_eq!(times(&mut bench), [1_000_000, 900, 900, 0]);
    bench.download(0x1C32, 8, &[0, 0]).unwrap();
    assert_eq!(times(&mut bench), [1_000_000, 900, 900, 0], "values stay");
    bench.download(0x1C32, 8, &[1, 0]).unwrap();
    assert_eq!(times(&mut bench), [1_000_000, 0, 0, 0]);
}

#[test]
fn distances_are_those_of_events_and_pulses() {
    let mut bench = dc_op(|_| {});
    let distances = |bench: &mut Bench| [15, 16, 17, 18].map(|sub| bench.number(0x1C32, sub));
    assert_eq!(distances(&mut bench), [1_000_000, 1_000_000, 500_000, 500_000]);
    bench.pass(Nanos(400_001));
    bench.write_outputs(&[1; 7]);
    bench.run(Event::Sm2);
    bench.pass(Nanos(599_999));
    bench.run(Event::Sync0);
    assert_eq!(distances(&mut bench), [900_001, 1_000_000, 500_000, 599_999]);
    bench.download(0x1C32, 8, &[1, 0]).unwrap();
    assert_eq!(distances(&mut bench), [0; 4]);
}

#[test]
fn a_drive_tells_lost_synchronization_by_its_own_codes() {
    let drive = |d: &mut Builder| d.behaviour.loss_codes = LossCodes::DRIVE;
    let mut bench = dc_op(drive);
    dc_cycle(&mut bench, false);
    dc_cycle(&mut bench, false);
    assert_eq!(bench.status(), (AlStatus(0x14), AlStatusCode::DC_SYNC_TIMEOUT));
    let mut bench = dc_op(drive);
    bench.pass(Nanos::millis(3));
    assert_eq!(bench.status(), (AlStatus(0x14), AlStatusCode::DC_SYNC_TIMEOUT));
}
