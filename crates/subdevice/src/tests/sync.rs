use std::vec;
use std::vec::Vec;

use isocat_sync::{Event, Step, SyncMode};
use isocat_wire::register::{self, al_event};
use isocat_wire::{AlState, AlStatus, AlStatusCode, Nanos};

use super::bench::{Bench, Call};
use super::device::{Builder, description};
use crate::description::MissedEvents;
use crate::steps::Steps;

use Step::{Application, LatchInputs, MapInputs, MapOutputs, OutputsValid};

const CYCLE: Nanos = Nanos(1_000_000);

/// A device in SAFEOP with SYNC0 every millisecond.
pub(super) fn dc_safe_op(device: impl FnOnce(&mut Builder)) -> Bench {
    let mut bench = Bench::in_state(description(device), AlState::PreOp);
    bench.set_process_data(7, 7);
    bench.set_sync0(1_000_000);
    assert_eq!(bench.ask(AlState::SafeOp).0, AlStatus(4));
    assert_eq!(bench.device.sync().mode(), SyncMode::DcSync0);
    bench
}

/// Runs one cycle: outputs half a cycle before SYNC0, if they come.
pub(super) fn dc_cycle(bench: &mut Bench, with_outputs: bool) {
    bench.pass(Nanos(500_000));
    if with_outputs {
        bench.write_outputs(&[5; 7]);
        bench.run(Event::Sm2);
    }
    bench.pass(Nanos(500_000));
    bench.run(Event::Sync0);
}

/// A device in OP with SYNC0 every millisecond.
pub(super) fn dc_op(device: impl FnOnce(&mut Builder)) -> Bench {
    let mut bench = dc_safe_op(device);
    dc_cycle(&mut bench, true);
    assert_eq!(bench.ask(AlState::Op).0, AlStatus(4));
    for _ in 0..201 {
        dc_cycle(&mut bench, true);
    }
    assert_eq!(bench.status(), (AlStatus(8), AlStatusCode(0)));
    assert_eq!(bench.device.sync().sm_event_missed(), 0);
    bench.calls();
    bench
}

pub(super) fn begin(bench: &mut Bench, step: Step) {
    bench.device.begin(bench.now, step, &mut bench.esc);
}

pub(super) fn finish(bench: &mut Bench, step: Step) {
    bench.device.finish(bench.now, step, &mut bench.esc);
}

pub(super) fn event(bench: &mut Bench, event: Event) -> Steps {
    bench.device.handle_event(bench.now, event, &mut bench.esc)
}

#[test]
fn sm_synchronous_does_everything_at_sm2() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::Op);
    bench.calls();
    bench.write_outputs(&[9; 7]);
    let steps = bench.run(Event::Sm2);
    let all = [MapOutputs, Application, OutputsValid, LatchInputs, MapInputs];
    assert_eq!(steps, all.map(|step| (step, 0)));
    let expected = [
        Call::Map(vec![9; 7]),
        Call::Application(Nanos(0)),
        Call::Valid,
        Call::Latch,
        Call::Inputs,
    ];
    assert_eq!(bench.calls(), expected);
    assert_eq!(bench.esc.events & al_event::sync_manager(2), 0);
    for other in [Event::Sync0, Event::Sync1, Event::Timer, Event::Sm3] {
        assert_eq!(bench.run(other), [], "{other:?}");
    }
}

#[test]
fn in_safeop_outputs_are_fetched_but_do_not_act() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::SafeOp);
    bench.calls();
    bench.write_outputs(&[9; 7]);
    bench.run(Event::Sm2);
    assert_eq!(bench.calls(), [Call::Application(Nanos(0)), Call::Latch, Call::Inputs]);
    assert_eq!(bench.esc.events & al_event::sync_manager(2), 0);
}

#[test]
fn below_safeop_no_event_starts_anything() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::PreOp);
    for other in [Event::Sm2, Event::Sm3, Event::Sync0, Event::Timer] {
        assert_eq!(bench.run(other), []);
    }
}

#[test]
fn without_outputs_the_read_of_the_inputs_starts() {
    let mut bench = Bench::in_state(description(|d| d.preset(0x1C12, 0, &[0])), AlState::PreOp);
    bench.set_process_data(0, 7);
    bench.ask(AlState::SafeOp);
    assert_eq!((bench.number(0x1C33, 1), bench.device.sync().mode()), (1, SyncMode::SmSynchronous));
    bench.ask(AlState::Op);
    let steps = bench.run(Event::Sm3);
    assert_eq!(steps, [Application, LatchInputs, MapInputs].map(|step| (step, 0)));
    assert_eq!(bench.run(Event::Sm2), []);
}

#[test]
fn free_run_follows_its_timer() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::PreOp);
    bench.download(0x1C32, 1, &[0, 0]).unwrap();
    bench.download(0x1C32, 2, &500_000u32.to_le_bytes()).unwrap();
    assert_eq!(bench.number(0x1C33, 2), 500_000, "one cycle for both");
    bench.set_process_data(7, 7);
    let start = bench.now;
    bench.ask(AlState::SafeOp);
    assert_eq!(bench.device.timer(), Some(start + Nanos(500_000)));
    bench.calls();
    bench.pass(Nanos(499_999));
    assert_eq!(bench.calls(), []);
    bench.pass(Nanos(1));
    assert_eq!(bench.calls(), [Call::Application(Nanos(500_000)), Call::Latch, Call::Inputs]);
    assert_eq!(bench.device.timer(), Some(start + Nanos(1_000_000)));

    bench.write_outputs(&[3; 7]);
    assert_eq!(bench.run(Event::Sm2), [], "the bus starts nothing");
    bench.ask(AlState::Op);
    bench.pass(Nanos(500_000));
    assert_eq!(bench.status().0, AlStatus(8), "the outputs were found at the tick");
    bench.calls();
    bench.write_outputs(&[4; 7]);
    bench.pass(Nanos(500_000));
    let cycle = Call::Application(Nanos(500_000));
    let expected = [Call::Map(vec![4; 7]), cycle.clone(), Call::Valid, Call::Latch, Call::Inputs];
    assert_eq!(bench.calls(), expected);
    bench.pass(Nanos(500_000));
    assert_eq!(bench.calls(), [cycle, Call::Valid, Call::Latch, Call::Inputs], "no news");

    // A tick at which the last pass is still in work is skipped, and not counted.
    bench.now += Nanos(500_000);
    assert_eq!(event(&mut bench, Event::Timer).len(), 4);
    bench.now += Nanos(500_000);
    assert_eq!(event(&mut bench, Event::Timer), Steps::EMPTY);
    assert_eq!(bench.device.sync().cycle_time_too_small(), 0);
    // Missed ticks are not repeated.
    bench.now += Nanos(5_250_000);
    event(&mut bench, Event::Timer);
    assert_eq!(bench.device.timer(), Some(bench.now + Nanos(250_000)));

    let too_short = bench.download(0x1C32, 2, &249_999u32.to_le_bytes());
    assert_eq!(too_short, Err(isocat_wire::AbortCode::TOO_LOW));
    assert_eq!(bench.download(0x1C32, 2, &250_000u32.to_le_bytes()), Ok(()));
}

#[test]
fn sync0_makes_act_what_sm2_began() {
    let mut bench = dc_op(|_| {});
    bench.write_outputs(&[1; 7]);
    assert_eq!(bench.run(Event::Sm2), [(MapOutputs, 0)]);
    assert_eq!(bench.calls(), [Call::Map(vec![1; 7])]);
    let steps = bench.run(Event::Sync0);
    let delay = 30_000;
    let expected = [(LatchInputs, 0), (Application, 0), (MapInputs, 0), (OutputsValid, delay)];
    assert_eq!(steps, expected);
    assert!(bench.calls().contains(&Call::Application(CYCLE)));
}

#[test]
fn shifts_move_what_the_device_can_shift() {
    let able = |d: &mut Builder| {
        d.behaviour.shift_outputs = true;
        d.behaviour.shift_inputs = true;
    };
    let shift = |able: fn(&mut Builder), outputs: u32, inputs: u32| {
        let mut bench = dc_op(able);
        bench.download(0x1C32, 3, &outputs.to_le_bytes()).unwrap();
        bench.download(0x1C33, 3, &inputs.to_le_bytes()).unwrap();
        dc_cycle(&mut bench, true);
        bench.write_outputs(&[1; 7]);
        bench.run(Event::Sm2);
        (bench.run(Event::Sync0), bench.device.sync().shift_time_too_short())
    };
    let shifted =
        [(Application, 0), (LatchInputs, 200_000), (MapInputs, 200_000), (OutputsValid, 300_000)];
    assert_eq!(shift(able, 300_000, 200_000), (shifted.to_vec(), 0));
    assert_eq!(shift(able, 30_000, 0).1, 0, "0x1C32:09 exactly");
    let (steps, too_short) = shift(able, 29_999, 0);
    assert_eq!(too_short, 2, "both cycles");
    assert_eq!(steps[3], (OutputsValid, 30_000), "the hardware takes its time");
    assert_eq!(shift(able, 0, 29_999).1, 2);
    let (steps, too_short) = shift(|_| {}, 29_999, 29_999);
    assert_eq!((steps[0], steps[3], too_short), ((LatchInputs, 0), (OutputsValid, 30_000), 0));
}

/// Slack 0 ns is accepted, -1 ns is a missed event.
#[test]
fn outputs_must_be_ready_before_sync0() {
    let with_slack = |slack: i64| {
        let mut bench = dc_op(|_| {});
        bench.write_outputs(&[7; 7]);
        assert_eq!(event(&mut bench, Event::Sm2).as_slice(), [(MapOutputs, Nanos(0))]);
        begin(&mut bench, MapOutputs);
        bench.now += Nanos(60_000);
        let sync0 = bench.now + Nanos(slack);
        if sync0 >= bench.now {
            finish(&mut bench, MapOutputs);
        }
        let end = bench.now;
        bench.now = sync0;
        bench.run(Event::Sync0);
        if sync0 < end {
            bench.now = end;
            finish(&mut bench, MapOutputs);
        }
        let sync = bench.device.sync();
        let counts = (sync.sm_event_missed(), sync.missed_events_total());
        (counts, bench.calls().contains(&Call::Map(vec![7; 7])), bench)
    };
    let (counts, mapped, _) = with_slack(0);
    assert_eq!((counts, mapped), ((0, 0), true));
    let (counts, mapped, mut late) = with_slack(-1);
    assert_eq!((counts, mapped), ((3, 1), false), "too late is not used at all");
    // Late outputs do not count for the next cycle.
    late.now += CYCLE;
    late.run(Event::Sync0);
    assert_eq!(late.device.sync().missed_events_total(), 2);
    assert_eq!(late.status(), (AlStatus(0x14), AlStatusCode::SYNCHRONIZATION_ERROR));
}

#[test]
fn an_event_that_came_but_was_not_begun_is_late() {
    let mut bench = dc_op(|_| {});
    bench.write_outputs(&[7; 7]);
    event(&mut bench, Event::Sm2);
    bench.run(Event::Sync0);
    begin(&mut bench, MapOutputs);
    finish(&mut bench, MapOutputs);
    assert_eq!(bench.device.sync().sm_event_missed(), 3);
    // The next outputs are in time again.
    dc_cycle(&mut bench, true);
    assert_eq!(bench.device.sync().sm_event_missed(), 2);
    assert_eq!(bench.device.state(), AlState::Op);
}

/// Returns the number of SYNC0 pulses until OP is left, and the code.
fn until_error(bench: &mut Bench, outputs: impl Fn(usize) -> bool) -> (usize, AlStatusCode) {
    for cycle in 0..1000 {
        dc_cycle(bench, outputs(cycle));
        if bench.device.state() != AlState::Op {
            assert_eq!(bench.status().0, AlStatus(0x14));
            return (cycle + 1, bench.device.status_code());
        }
    }
    (0, AlStatusCode::NO_ERROR)
}

#[test]
fn missing_outputs_end_op_by_the_rule() {
    let error = AlStatusCode::SYNCHRONIZATION_ERROR;
    let run = |rule, limit: u8, outputs: fn(usize) -> bool| {
        let mut bench = dc_op(|d| {
            d.behaviour.missed_events = rule;
            d.preset(0x10F1, 2, &[limit, 0]);
        });
        until_error(&mut bench, outputs)
    };
    use MissedEvents::{Counted, SlaveStackCode};
    assert_eq!(run(Counted, 4, |_| false), (2, error));
    assert_eq!(run(Counted, 9, |_| false), (4, error));
    assert_eq!(run(SlaveStackCode, 4, |_| false), (3, error));
    assert_eq!(run(Counted, 4, |cycle| cycle % 4 != 0), (0, AlStatusCode::NO_ERROR));
    assert_eq!(run(Counted, 4, |cycle| cycle % 3 != 0), (7, error), "3 2 1 4 3 2 5");
    assert_eq!(run(SlaveStackCode, 4, |cycle| cycle % 2 != 0), (0, AlStatusCode::NO_ERROR));
}

#[test]
fn without_error_settings_the_behaviour_has_the_limit() {
    let mut bench = dc_op(|d| {
        d.objects.retain(|object| object.index != 0x10F1);
        d.behaviour.sync_error_limit = 12;
    });
    assert_eq!(until_error(&mut bench, |_| false).0, 5);
}

#[test]
fn a_sync_error_closes_the_outputs_until_acknowledged() {
    let mut bench = dc_op(|_| {});
    until_error(&mut bench, |_| false);
    assert!(bench.calls().contains(&Call::Safe));
    assert_eq!(bench.esc.sm(2).pdi_control & 1, 1);
    let shown = [11, 12, 13, 32].map(|sub| bench.number(0x1C32, sub));
    assert_eq!(shown, [6, 0, 0, 1]);
    assert_eq!([11, 12, 13, 32].map(|sub| bench.number(0x1C33, sub)), shown, "mirrored");
    assert_eq!(bench.acknowledge(AlState::SafeOp), (AlStatus(4), AlStatusCode(0)));
    assert_eq!(bench.esc.sm(2).pdi_control & 1, 0);
    bench.ask(AlState::Op);
    assert_eq!([11, 32].map(|sub| bench.number(0x1C32, sub)), [0, 0], "cleared by the request");
    for _ in 0..201 {
        dc_cycle(&mut bench, true);
    }
    assert_eq!(bench.device.state(), AlState::Op);
    assert_eq!(bench.device.sync().missed_events_total(), 2, "nothing clears the total");
}

#[test]
fn op_needs_sync_for_200_ms_without_a_break() {
    let mut bench = dc_safe_op(|_| {});
    dc_cycle(&mut bench, true);
    let asked = bench.now;
    bench.ask(AlState::Op);
    while bench.device.state() != AlState::Op {
        dc_cycle(&mut bench, true);
    }
    assert_eq!(bench.now - asked, Nanos::millis(200));

    let mut bench = dc_safe_op(|_| {});
    dc_cycle(&mut bench, true);
    bench.ask(AlState::Op);
    for _ in 0..150 {
        dc_cycle(&mut bench, true);
    }
    // Two missing outputs break the sequence. Two good ones bring the counter to its limit again.
    dc_cycle(&mut bench, false);
    dc_cycle(&mut bench, false);
    let broken = bench.now;
    while bench.device.state() != AlState::Op {
        dc_cycle(&mut bench, true);
    }
    assert_eq!(bench.now - broken, Nanos::millis(202));
}

#[test]
fn op_is_given_up_with_the_reason() {
    let give_up = |sync0: bool, outputs: bool| {
        let mut bench = dc_safe_op(|_| {});
        bench.ask(AlState::Op);
        for _ in 0..8_999 {
            if sync0 {
                dc_cycle(&mut bench, false);
            } else {
                if outputs {
                    bench.write_outputs(&[1; 7]);
                    bench.run(Event::Sm2);
                }
                bench.pass(CYCLE);
            }
        }
        if sync0 && outputs {
            // Outputs came only once.
            bench.write_outputs(&[1; 7]);
            bench.run(Event::Sm2);
        }
        bench.pass(Nanos(999_999));
        assert_eq!(bench.status(), (AlStatus(4), AlStatusCode(0)));
        bench.pass(Nanos(1));
        assert_eq!(bench.status().0, AlStatus(0x14));
        bench.status().1
    };
    assert_eq!(give_up(false, false), AlStatusCode::NO_SYNC);
    assert_eq!(give_up(false, true), AlStatusCode::NO_SYNC);
    assert_eq!(give_up(true, false), AlStatusCode::WATCHDOG);
    assert_eq!(give_up(true, true), AlStatusCode::SYNCHRONIZATION_ERROR);
}

#[test]
fn sync0_that_stays_away_ends_op() {
    let mut bench = dc_op(|_| {});
    let last = bench.now;
    // 1 ms gives two ticks of 1 ms, and the present one.
    assert_eq!(bench.device.next_timeout(), Some(last + Nanos::millis(3)));
    bench.pass(Nanos(2_999_999));
    assert_eq!(bench.device.state(), AlState::Op);
    bench.pass(Nanos(1));
    assert_eq!(bench.status(), (AlStatus(0x14), AlStatusCode::FATAL_SYNC_ERROR));
    assert_eq!(bench.device.next_timeout(), None);
}

#[test]
fn a_late_sync0_does_not_hide_that_it_was_late() {
    let mut bench = dc_op(|_| {});
    // The stack was not called at the timeout.
    bench.now += Nanos::millis(5);
    bench.run(Event::Sync0);
    assert_eq!(bench.device.status_code(), AlStatusCode::FATAL_SYNC_ERROR);
}

#[test]
fn a_cycle_that_is_not_finished_is_counted() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::Op);
    bench.calls();
    bench.write_outputs(&[1; 7]);
    let steps = event(&mut bench, Event::Sm2);
    begin(&mut bench, MapOutputs);
    bench.write_outputs(&[2; 7]);
    assert_eq!(event(&mut bench, Event::Sm2), Steps::EMPTY);
    assert_eq!(bench.esc.events & al_event::sync_manager(2), 0, "acknowledged");
    assert_eq!([11, 12, 32].map(|sub| bench.number(0x1C32, sub)), [0, 1, 1]);
    finish(&mut bench, MapOutputs);
    for (step, _) in steps.into_iter().skip(1) {
        begin(&mut bench, step);
        finish(&mut bench, step);
    }
    assert_eq!(bench.calls()[0], Call::Map(vec![1; 7]), "and dropped");
    bench.write_outputs(&[3; 7]);
    assert_eq!(bench.run(Event::Sm2).len(), 5);
    assert_eq!(bench.number(0x1C32, 12), 1);

    // With SYNC0 the application is the step that may not be finished.
    let mut bench = dc_op(|_| {});
    dc_cycle(&mut bench, true);
    let steps = event(&mut bench, Event::Sync0);
    for (step, _) in steps.into_iter().filter(|(step, _)| *step != MapInputs) {
        begin(&mut bench, step);
        finish(&mut bench, step);
    }
    bench.now += CYCLE;
    assert_eq!(event(&mut bench, Event::Sync0), Steps::EMPTY);
    assert_eq!(bench.device.sync().cycle_time_too_small(), 1);
}

#[test]
fn counters_are_reset_by_the_rules() {
    let mut bench = dc_op(|d| {
        d.behaviour.shift_outputs = true;
        d.preset(0x1C32, 3, &[1, 0, 0, 0]);
    });
    let counters = |bench: &mut Bench| [11, 12, 13, 32].map(|sub| bench.number(0x1C32, sub));
    let provoke = |bench: &mut Bench| {
        bench.write_outputs(&[1; 7]);
        event(bench, Event::Sm2);
        event(bench, Event::Sm2);
        dc_cycle(bench, false);
        finish(bench, MapOutputs);
        let [missed, too_small, too_short, error] = counters(bench);
        assert!(missed > 0 && too_small > 0 && too_short > 0 && error == 1);
    };
    provoke(&mut bench);
    bench.download(0x1C33, 8, &[1, 0]).unwrap();
    assert_ne!(counters(&mut bench), [0; 4], "the other bit");
    bench.download(0x1C33, 8, &[2, 0]).unwrap();
    assert_eq!(counters(&mut bench), [0; 4]);
    assert_eq!(bench.number(0x1C33, 8), 2, "the command stays readable");

    provoke(&mut bench);
    bench.ask(AlState::SafeOp);
    assert_ne!(counters(&mut bench)[0], 0);
    bench.ask(AlState::Op);
    let [missed, too_small, too_short, error] = counters(&mut bench);
    assert!(missed == 0 && too_small > 0 && too_short > 0 && error == 1);
    bench.ask(AlState::PreOp);
    assert_eq!(counters(&mut bench), [0; 4]);
}

#[test]
fn sync0_is_acknowledged_only_if_the_chip_waits_for_it() {
    struct Watch<'a>(&'a mut super::bench::FakeEsc, Vec<u16>);
    impl isocat_esc::Pdi for Watch<'_> {
        fn read(&mut self, address: u16, data: &mut [u8]) {
            self.1.push(address);
            self.0.read(address, data);
        }
        fn write(&mut self, address: u16, data: &[u8]) {
            self.0.write(address, data);
        }
    }
    // This also holds below SAFEOP: without an acknowledge there is no further pulse. A device may
    // also acknowledge later.
    for (pulse_length, late, expected) in [(100, false, 0), (0, false, 1), (0, true, 0)] {
        let device = description(|builder| builder.behaviour.late_acknowledge = late);
        let mut bench = Bench::in_state(device, AlState::PreOp);
        bench.set_process_data(7, 7);
        bench.set_sync0(1_000_000);
        bench.set(register::SYNC_PULSE_LENGTH, pulse_length);
        for state in [AlState::PreOp, AlState::SafeOp] {
            bench.ask(state);
            assert_eq!(bench.status().0.state(), Ok(state));
            let mut watch = Watch(&mut bench.esc, vec![]);
            let reads = |watch: &Watch<'_>| watch.1.iter().filter(|at| **at == 0x098E).count();
            bench.device.handle_event(bench.now, Event::Sync0, &mut watch);
            assert_eq!(reads(&watch), expected, "{pulse_length}, {late}, {state}");
            assert_eq!(bench.device.take_unacknowledged(), late);
            assert!(!bench.device.take_unacknowledged(), "asked once");
            bench.device.acknowledge_sync(Event::Sync0, &mut watch);
            assert_eq!(reads(&watch), expected + 1);
        }
    }
}

#[test]
fn steps_of_a_state_that_was_left_are_ignored() {
    let mut bench = Bench::in_state(description(|_| {}), AlState::Op);
    bench.write_outputs(&[1; 7]);
    let steps = event(&mut bench, Event::Sm2);
    bench.ask(AlState::PreOp);
    bench.calls();
    for (step, _) in steps {
        begin(&mut bench, step);
        finish(&mut bench, step);
    }
    assert_eq!(bench.calls(), []);
}

#[test]
fn without_outputs_dc_counts_the_reads_of_the_inputs() {
    let device = description(|d| d.preset(0x1C12, 0, &[0]));
    let mut bench = Bench::in_state(device, AlState::PreOp);
    bench.set_process_data(0, 7);
    bench.set_sync0(1_000_000);
    bench.ask(AlState::SafeOp);
    let cycle = |bench: &mut Bench, read: bool| {
        bench.pass(CYCLE);
        if read {
            assert_eq!(bench.run(Event::Sm3), []);
        }
        let steps = bench.run(Event::Sync0);
        if bench.status().0.error() {
            return;
        }
        assert_eq!(steps, [LatchInputs, Application, MapInputs].map(|step| (step, 0)));
    };
    cycle(&mut bench, true);
    bench.ask(AlState::Op);
    for _ in 0..200 {
        cycle(&mut bench, true);
    }
    assert_eq!(bench.device.state(), AlState::Op);
    cycle(&mut bench, false);
    assert_eq!(bench.number(0x1C33, 11), 3);
    cycle(&mut bench, true);
    assert_eq!(bench.number(0x1C33, 11), 0, "a read starts the count anew");
    cycle(&mut bench, false);
    cycle(&mut bench, false);
    assert_eq!(bench.status(), (AlStatus(0x14), AlStatusCode::SYNCHRONIZATION_ERROR));
    assert_eq!(bench.esc.sm(3).pdi_control & 1, 1, "the inputs are closed");
}
