use super::*;
use isocat_wire::AlStatusCode;
use std::string::ToString;

const CYCLE: Cycle = Cycle {
    cycle: Nanos(1_000_000),
    send: Nanos(0),
    jitter: Nanos(20_000),
    hop_jitter: Nanos::ZERO,
    ring_way: Nanos::ZERO,
    clock_error: Nanos(100),
    clock_error_origin: Origin::Computed,
    clock_deviation_ppb: USUAL_DEVIATION_PPB,
    limits: Limits { sync0_error: Nanos(1_000), outputs_spread: Nanos(1_000) },
};

fn drive() -> Device {
    Device {
        mode: SyncMode::DcSync0,
        pulses: Pulses { sync0_cycle: Nanos(1_000_000), ..Pulses::default() },
        sync_signal: SyncSignal::Unknown,
        every: 1,
        frame_spread: Nanos(0),
        ring_spread: Nanos(0),
        outputs_arrival: Some(Nanos(12_345)),
        inputs_fetched: Some(Nanos(1_000)),
        inputs_read: Some(Nanos(12_345)),
        watchdog: None,
        minimum_cycle: Nanos(250_000),
        sync_limits: SyncLimits::default(),
        output_calc_and_copy: Nanos(60_000),
        output_delay: Nanos(30_000),
        output_shift: None,
        input_calc_and_copy: Nanos(40_000),
        input_shift: Nanos(0),
        input_delay: Nanos(700),
        delay: Nanos(300),
        pulse_jitter: Nanos(0),
        outputs_spread: Nanos(0),
        clock_deviation_ppb: USUAL_DEVIATION_PPB,
        origins: Origins::default(),
    }
}

fn slack(cycle: &Cycle, shift: i64, device: &Device, check: Check) -> i64 {
    budget(cycle, Nanos(shift), device).line(check).unwrap().slack().0
}

#[test]
fn outputs_ready_to_the_nanosecond() {
    let ready = 12_345 + 20_000 + 100 + 60_000;
    assert_eq!(slack(&CYCLE, ready, &drive(), Check::OutputsBeforeSync0), 0);
    let late = budget(&CYCLE, Nanos(ready - 1), &drive());
    assert_eq!(late.failure().unwrap().check, Check::OutputsBeforeSync0);
    assert_eq!(late.failure().unwrap().slack(), Nanos(-1));
}

#[test]
fn inputs_before_the_next_frame_to_the_nanosecond() {
    let last = 1_000_000 + 1_000 - 40_000 - 100;
    assert_eq!(slack(&CYCLE, last, &drive(), Check::InputsBeforeFrame), 0);
    assert_eq!(slack(&CYCLE, last + 1, &drive(), Check::InputsBeforeFrame), -1);
    // The difference is the deviation of the timer, a tick, and the shift.
    let shifted = |ns| Device { input_shift: Nanos(ns), ..drive() };
    assert_eq!(slack(&CYCLE, last, &shifted(1), Check::InputsBeforeFrame), -1 - 11);
    assert_eq!(slack(&CYCLE, last - 20_012, &shifted(20_000), Check::InputsBeforeFrame), 0);
}

#[test]
fn minimum_cycle_names_both_figures() {
    let short = Cycle { cycle: Nanos(125_000), ..CYCLE };
    let pulses = Pulses { sync0_cycle: short.cycle, ..drive().pulses };
    let device = Device { pulses, ..drive() };
    let failure = budget(&short, Nanos(100_000), &device).failure().unwrap();
    let text = failure.to_string();
    assert!(text.starts_with("0x1C32:05: minimum cycle time"), "{text}");
    assert!(text.contains("needs 250 us, has 125 us"), "{text}");
    let exact = Device { mode: SyncMode::SmSynchronous, ..drive() };
    let cycle = |ns| Cycle { cycle: Nanos(ns), ..CYCLE };
    assert_eq!(slack(&cycle(270_000), 0, &exact, Check::MinimumCycle), 0);
    assert_eq!(slack(&cycle(269_999), 0, &exact, Check::MinimumCycle), -1);
    // An unstated time is counted by a CPU: 100 ppm of the cycle, and a tick.
    let origins = Origins { minimum_cycle: Origin::Assumed, ..exact.origins };
    let unstated = Device { origins, ..exact };
    assert_eq!(slack(&cycle(270_038), 0, &unstated, Check::MinimumCycle), 0);
    assert_eq!(slack(&cycle(270_037), 0, &unstated, Check::MinimumCycle), -1);
}

#[test]
fn shift_covers_the_delay_and_stays_in_the_cycle() {
    let with = |ns| Device { output_shift: Some(Nanos(ns)), ..drive() };
    assert_eq!(slack(&CYCLE, 500_000, &with(30_000), Check::ShiftCoversDelay), 0);
    assert_eq!(slack(&CYCLE, 500_000, &with(29_999), Check::ShiftCoversDelay), -1);
    let ideal = Cycle { clock_error: Nanos(0), ..CYCLE };
    assert_eq!(slack(&ideal, 500_000, &with(1_000_000), Check::OutputsValidInCycle), 0);
    assert_eq!(slack(&ideal, 500_000, &with(1_000_001), Check::OutputsValidInCycle), -1);
    // The oscillator is within 100 ppm, plus a tick.
    assert_eq!(slack(&CYCLE, 500_000, &with(999_890), Check::OutputsValidInCycle), 0);
    assert_eq!(slack(&CYCLE, 500_000, &with(999_891), Check::OutputsValidInCycle), -1);
    assert_eq!(slack(&CYCLE, 500_000, &with(30_000), Check::OutputsValidInCycle), 969_987);
}

#[test]
fn the_common_shift_shares_the_slack() {
    let slow = Device { output_calc_and_copy: Nanos(300_000), ..drive() };
    let shift = common_shift(&CYCLE, [&drive(), &slow]).unwrap();
    let before = slack(&CYCLE, shift.0, &slow, Check::OutputsBeforeSync0);
    let after = slack(&CYCLE, shift.0, &drive(), Check::InputsBeforeFrame);
    assert!((before - after).abs() <= 2_000, "{before} {after}");
    let free = Device { mode: SyncMode::FreeRun, ..drive() };
    assert_eq!(common_shift(&CYCLE, [&free]), None);
}

/// SYNC0 fetches, SYNC1 acts: both distances are tested to the nanosecond.
#[test]
fn dc_sync1_needs_the_outputs_before_sync0_and_the_copy_time_before_sync1() {
    let distance = |sync1| Device {
        mode: SyncMode::DcSync1,
        pulses: Pulses::new(SyncMode::DcSync1, CYCLE.cycle, Nanos(sync1), Nanos::ZERO, false),
        ..drive()
    };
    let device = distance(60_000);
    let stored = 12_345 + 20_000 + 100;
    let at = |shift, device: &Device, check| slack(&CYCLE, shift, device, check);
    assert_eq!(at(stored + 60_000, &device, Check::OutputsStoredBeforeSync0), 0);
    assert_eq!(at(stored + 59_999, &device, Check::OutputsStoredBeforeSync0), -1);
    // A tick, 100 ppm of the copy time, and 6 % of the clock error.
    assert_eq!(at(500_000, &distance(60_023), Check::Sync1CoversCopy), 0);
    assert_eq!(at(500_000, &distance(60_022), Check::Sync1CoversCopy), -1);
    // A tick; the share of the clock error is below a nanosecond.
    assert_eq!(at(500_000, &distance(999_988), Check::Sync1BeforeNextSync0), 0);
    assert_eq!(at(500_000, &distance(999_989), Check::Sync1BeforeNextSync0), -1);
    // Half a cycle from SYNC1 to SYNC0: half the clock error.
    assert_eq!(at(500_000, &distance(500_000), Check::Sync1BeforeNextSync0), 500_000 - 50 - 11);
    assert_eq!(device.sync0_phase(Nanos(500_000)), Nanos(440_000));
    assert_eq!(device.sync0_phase(Nanos(50_000)), Nanos(990_000));
    // Inputs are latched at SYNC1 itself.
    let last = 1_000_000 + 1_000 - 40_000 - 100;
    assert_eq!(at(last, &device, Check::InputsBeforeFrame), 0);
}

#[test]
fn inputs_at_sync1_come_later_than_the_outputs() {
    let device = Device {
        mode: SyncMode::DcShiftSync1,
        pulses: Pulses::new(
            SyncMode::DcShiftSync1,
            CYCLE.cycle,
            Nanos(200_000),
            Nanos::ZERO,
            false,
        ),
        ..drive()
    };
    let last = 1_000_000 + 1_000 - 200_000 - 700 - 40_000 - 100;
    assert_eq!(slack(&CYCLE, last, &device, Check::InputsBeforeFrame), 0);
    assert_eq!(slack(&CYCLE, last + 1, &device, Check::InputsBeforeFrame), -1);
    let ready = 12_345 + 20_000 + 100 + 60_000;
    assert_eq!(slack(&CYCLE, ready, &device, Check::OutputsBeforeSync0), 0);
    // If outputs act at SYNC1 too, everything counts from there.
    let both = Device { pulses: Pulses { lead: Nanos(200_000), ..device.pulses }, ..device };
    assert_eq!(slack(&CYCLE, ready + 200_000, &both, Check::OutputsBeforeSync0), 0);
    assert_eq!(slack(&CYCLE, last + 200_000, &both, Check::InputsBeforeFrame), 0);
}

#[test]
fn a_subordinated_cycle_is_measured_by_its_own_sync0() {
    let device = |sync0| Device {
        mode: SyncMode::DcSubordinated,
        pulses: Pulses::new(
            SyncMode::DcSubordinated,
            CYCLE.cycle,
            Nanos::ZERO,
            Nanos(sync0),
            false,
        ),
        ..drive()
    };
    assert_eq!(slack(&CYCLE, 500_000, &device(250_000), Check::MinimumCycle), 0);
    assert_eq!(slack(&CYCLE, 500_000, &device(125_000), Check::MinimumCycle), -125_000);
    assert_eq!(device(250_000).sync0_phase(Nanos(500_000)), Nanos(0));
}

#[test]
fn the_inputs_shift_covers_their_delay() {
    let with = |ns| Device { input_shift: Nanos(ns), ..drive() };
    assert_eq!(slack(&CYCLE, 500_000, &with(700), Check::InputShiftCoversDelay), 0);
    assert_eq!(slack(&CYCLE, 500_000, &with(699), Check::InputShiftCoversDelay), -1);
    assert_eq!(budget(&CYCLE, Nanos(500_000), &drive()).line(Check::InputShiftCoversDelay), None);
}

/// A timer behind SM2 latches the inputs: both ends of the distance to the next frame are tested.
#[test]
fn inputs_by_timer_stand_before_the_next_frame() {
    let with = |ns| Device { mode: SyncMode::SmSynchronous, input_shift: Nanos(ns), ..drive() };
    let last = 1_000_000 + 1_000 - 40_000 - (12_345 + 20_000 + 100);
    let own = 93 + 10;
    assert_eq!(slack(&CYCLE, 0, &with(last - own), Check::InputsBeforeFrame), 0);
    assert_eq!(slack(&CYCLE, 0, &with(last - own + 1), Check::InputsBeforeFrame), -1);
}

#[test]
fn frames_fill_the_cycle_to_the_nanosecond() {
    assert_eq!(frames_in_cycle(&CYCLE, Nanos(979_790 - 6_720)).slack(), Nanos(0));
    assert_eq!(frames_in_cycle(&CYCLE, Nanos(979_791 - 6_720)).slack(), Nanos(-1));
}

/// In a ring, frames on the longest way end later, and frames on another way come sooner by the
/// same time. A device that starts with the frames sees two of them closer together by that time.
#[test]
fn ways_through_a_ring_are_counted_to_the_nanosecond() {
    let cycle = Cycle { ring_way: Nanos(700), ..CYCLE };
    let least = 979_790 - 6_720 - 700;
    assert_eq!(frames_in_cycle(&cycle, Nanos(least)).slack(), Nanos(0));
    assert_eq!(frames_in_cycle(&cycle, Nanos(least + 1)).slack(), Nanos(-1));
    for mode in [SyncMode::SmSynchronous, SyncMode::DcSync0] {
        let line = Device { mode, watchdog: Some(Nanos::millis(100)), ..drive() };
        let ring = Device { ring_spread: Nanos(700), ..line };
        let slack = |device, check| slack(&CYCLE, 500_000, device, check);
        let nearer = if mode == SyncMode::SmSynchronous { 700 } else { 0 };
        let check = Check::MinimumCycle;
        assert_eq!(slack(&line, check) - slack(&ring, check), nearer, "{mode}");
        let check = Check::OutputsBeforeWatchdog;
        assert_eq!(slack(&line, check) - slack(&ring, check), 700, "{mode}");
        let stored = |device| moments(&CYCLE, Nanos(500_000), device).outputs_stored.unwrap();
        let (line, ring) = (stored(&line), stored(&ring));
        assert_eq!((line.earliest - ring.earliest, line.latest), (Nanos(700), ring.latest));
    }
}

/// Without outputs, the read of the inputs must not straddle the pulse that counts it.
#[test]
fn inputs_are_read_before_the_pulse_to_the_nanosecond() {
    let device = Device { outputs_arrival: None, watchdog: None, ..drive() };
    let read = 12_345 + 20_000 + 100;
    assert_eq!(slack(&CYCLE, read, &device, Check::InputsReadBeforeSync0), 0);
    assert_eq!(slack(&CYCLE, read - 1, &device, Check::InputsReadBeforeSync0), -1);
    assert_eq!(window(&CYCLE, &device).earliest, Some(Nanos(read)));
    let none = budget(&CYCLE, Nanos(read), &drive()).line(Check::InputsReadBeforeSync0);
    assert_eq!(none, None, "outputs are what counts");
}

/// 100 ms, less the 10 us that a slow oscillator and a tick take away.
#[test]
fn outputs_come_before_the_watchdog_to_the_nanosecond() {
    let device = Device { watchdog: Some(Nanos(100_000_000)), ..drive() };
    let cycle = |ns| Cycle { cycle: Nanos(ns), ..CYCLE };
    let last = 100_000_000 - 20_000 - 10_010;
    assert_eq!(slack(&cycle(last), 0, &device, Check::OutputsBeforeWatchdog), 0);
    assert_eq!(slack(&cycle(last + 1), 0, &device, Check::OutputsBeforeWatchdog), -1);
    let sign = demand(&cycle(last), Nanos(0), &device, Check::OutputsBeforeWatchdog).unwrap();
    assert_eq!(sign.sign(device.mode), Sign::Fall(isocat_wire::AlStatusCode::WATCHDOG));
}

/// The window ends where the two lines of the acting pulse have no slack left, in every mode.
#[test]
fn the_window_ends_where_slack_ends() {
    for mode in SyncMode::ALL.into_iter().filter(|mode| mode.uses_dc()) {
        let pulses = Pulses::new(
            mode,
            CYCLE.cycle,
            Nanos(100_000),
            Nanos(250_000),
            mode == SyncMode::DcSync1,
        );
        let device = Device { mode, pulses, pulse_jitter: Nanos(40), ..drive() };
        let window = window(&CYCLE, &device);
        let (earliest, latest) = (window.earliest.unwrap(), window.latest.unwrap());
        let at = |shift: Nanos, check| slack(&CYCLE, shift.0, &device, check);
        assert_eq!(at(earliest, before_pulse(&device)), 0, "{mode}");
        assert_eq!(at(earliest - Nanos(1), before_pulse(&device)), -1, "{mode}");
        assert_eq!(at(latest, Check::InputsBeforeFrame), 0, "{mode}");
        assert_eq!(at(latest + Nanos(1), Check::InputsBeforeFrame), -1, "{mode}");
        // The moments agree with the lines.
        let moments = moments(&CYCLE, latest, &device);
        let available = moments.inputs_available.unwrap().latest;
        let fetched = CYCLE.cycle + device.inputs_fetched.unwrap();
        assert_eq!(available, fetched, "{mode}");
    }
}

/// Each sum names the origin of every figure and adds up to the line.
#[test]
fn sums_are_made_of_their_figures() {
    let demand = demand(&CYCLE, Nanos(500_000), &drive(), Check::OutputsBeforeSync0).unwrap();
    let terms: std::vec::Vec<_> = demand.needed.terms().map(|t| (t.quantity, t.value.0)).collect();
    let expected = [
        (Quantity::FrameEnd, 12_045),
        (Quantity::Propagation, 300),
        (Quantity::SendJitter, 20_000),
        (Quantity::ClockError, 100),
        (Quantity::OutputCalcAndCopy, 60_000),
    ];
    assert_eq!(terms, expected);
    assert_eq!(demand.needed.total(), Nanos(92_445));
    let last = demand.needed.terms().last().unwrap();
    assert_eq!(last.origin.to_string(), "0x1C32:06");
}

/// If outputs act at SYNC1 it is their shift: a local timer counts in neither mode.
#[test]
fn an_output_that_acts_at_sync1_has_no_shift_by_timer() {
    let device = |mode, on_sync1| Device {
        mode,
        pulses: Pulses::new(
            mode,
            CYCLE.cycle,
            if mode == SyncMode::DcSubordinated { Nanos::ZERO } else { Nanos(250_000) },
            Nanos(250_000),
            on_sync1,
        ),
        output_shift: Some(Nanos(904_000)),
        ..drive()
    };
    let after = |mode, on_sync1| device(mode, on_sync1).outputs_act_after().0;
    assert_eq!(after(SyncMode::DcSync0, false), 904_000);
    assert_eq!(after(SyncMode::DcShiftSync1, false), 904_000);
    assert_eq!(after(SyncMode::DcSubordinated, false), 904_000);
    assert_eq!(after(SyncMode::DcShiftSync1, true), 30_000);
    assert_eq!(after(SyncMode::DcSync1, false), 30_000);
    let sync1 = device(SyncMode::DcSync1, false);
    assert_eq!(budget(&CYCLE, Nanos(500_000), &sync1).line(Check::ShiftCoversDelay), None);
    let valid = moments(&CYCLE, Nanos(500_000), &sync1).outputs_valid.unwrap();
    // Delay, clock error, and 100 ppm of the delay.
    assert_eq!((valid.earliest, valid.latest), (Nanos(529_897), Nanos(530_103)));
}

/// Both limits are tested to the nanosecond: the spread with 100 ppm of it, the clock error with a
/// tick.
#[test]
fn limits_of_the_judges_are_lines() {
    let spread = |spread, limit| {
        let limits = Limits { outputs_spread: Nanos(limit), ..Limits::default() };
        let device = Device { outputs_spread: Nanos(spread), ..drive() };
        let cycle = Cycle { limits, ..CYCLE };
        budget(&cycle, Nanos(500_000), &device).line(Check::OutputsSpreadWithinLimit)
    };
    assert_eq!(spread(0, 0), None);
    assert_eq!(spread(999, 1_000).unwrap().slack(), Nanos(0));
    assert_eq!(spread(1_000, 1_000).unwrap().slack(), Nanos(-1));
    assert_eq!(spread(20_000, 20_002).unwrap().slack(), Nanos(0));
    let sync0 = |limit| {
        let limits = Limits { sync0_error: Nanos(limit), ..Limits::default() };
        slack(&Cycle { limits, ..CYCLE }, 500_000, &drive(), Check::Sync0WithinLimit)
    };
    assert_eq!((sync0(110), sync0(109)), (0, -1));
    let by_frame =
        Device { mode: SyncMode::SmSynchronous, outputs_spread: Nanos(5_000), ..drive() };
    let lines = budget(&CYCLE, Nanos(0), &by_frame);
    assert_eq!(lines.line(Check::Sync0WithinLimit), None);
    assert_eq!(lines.line(Check::OutputsSpreadWithinLimit), None);
}

/// 400 us by an oscillator that is 137 ppm off: 54.8 ns and a tick.
#[test]
fn a_clock_that_is_known_to_deviate_more_counts_with_it() {
    let shifted = |ppb| {
        let shift = Some(Nanos(400_000));
        Device { output_shift: shift, clock_deviation_ppb: ppb, ..drive() }
    };
    let left = |device: &Device| slack(&CYCLE, 500_000, device, Check::OutputsValidInCycle);
    assert_eq!(left(&shifted(100_000)), 1_000_000 - 400_000 - 50);
    assert_eq!(left(&shifted(137_000)), 1_000_000 - 400_000 - 65);
    let demand = demand(&CYCLE, Nanos(0), &shifted(137_000), Check::OutputsValidInCycle).unwrap();
    let stated = demand.needed.terms().find(|term| term.quantity == Quantity::StatedClockSpeed);
    assert_eq!(stated.map(|term| term.value), Some(Nanos(65)));
    let valid = moments(&CYCLE, Nanos(0), &shifted(137_000)).outputs_valid.unwrap();
    assert_eq!((valid.earliest, valid.latest), (Nanos(399_845), Nanos(400_155)));
}

/// A CPU counts its cycle by its own oscillator: 100 ppm of 250 us and a tick. A stated cycle is
/// nominal.
#[test]
fn an_assumed_minimum_cycle_counts_in_the_devices_own_time() {
    let with = |origin| {
        let origins = Origins { minimum_cycle: origin, ..Origins::default() };
        slack(&CYCLE, 500_000, &Device { origins, ..drive() }, Check::MinimumCycle)
    };
    assert_eq!(with(Origins::default().minimum_cycle), 750_000);
    assert_eq!(with(Origin::Assumed), 750_000 - 25 - 10);
}

/// The jitter of the hops is a separate term; host and hops together are the jitter.
#[test]
fn jitter_of_hops_is_not_the_hosts() {
    let cycle = Cycle { jitter: Nanos(20_124), hop_jitter: Nanos(124), ..CYCLE };
    let one = Cycle { hop_jitter: Nanos::ZERO, ..cycle };
    let checks = Check::OF_DEVICE
        .into_iter()
        .filter_map(|check| Some((demand(&cycle, Nanos(500_000), &drive(), check)?, check)));
    for (with, check) in checks {
        let without = demand(&one, Nanos(500_000), &drive(), check).unwrap();
        assert_eq!(with.line(), without.line());
    }
    let demand = demand(&cycle, Nanos(500_000), &drive(), Check::OutputsBeforeSync0).unwrap();
    let of = |quantity| demand.needed.terms().find(|term| term.quantity == quantity).unwrap();
    let (host, hops) = (of(Quantity::SendJitter), of(Quantity::HopJitter));
    assert_eq!((host.value, host.origin), (Nanos(20_000), Origin::Intent));
    assert_eq!((hops.value, hops.origin), (Nanos(124), Origin::Chip));
    assert_eq!(of(Quantity::ClockError).origin, Origin::Computed);
    let frames = frames_in_cycle(&cycle, Nanos(100_000));
    assert_eq!(frames.line(), frames_in_cycle(&one, Nanos(100_000)).line());
}

/// A shift by timer behind a frame that is not sent at phase 0 gives the longest line.
#[test]
fn the_longest_line_has_room_for_its_figures() {
    let cycle = Cycle { send: Nanos(1_000), hop_jitter: Nanos(124), ..CYCLE };
    let device = Device {
        mode: SyncMode::SmSynchronous,
        input_shift: Nanos(100_000),
        output_calc_and_copy: Nanos(60_000),
        ..drive()
    };
    let demand = demand(&cycle, Nanos::ZERO, &device, Check::InputsBeforeFrame).unwrap();
    assert_eq!(demand.needed.terms().count(), 9);
}

/// The rest of a cycle after SYNC0 ends, for ideal clocks, to the nanosecond.
#[test]
fn sync0_falls_before_its_next_pulse() {
    let ideal = Cycle { clock_error: Nanos::ZERO, ..CYCLE };
    let line = |signal, jitter| {
        let device = Device { sync_signal: signal, pulse_jitter: Nanos(jitter), ..drive() };
        demand(&ideal, Nanos(500_000), &device, Check::Sync0FallsInCycle)
    };
    let slack = |signal, jitter| line(signal, jitter).map(|line| line.slack().0);
    use SyncSignal::{Acknowledged, Pulse, Unknown};
    assert_eq!(slack(Acknowledged(Nanos(1_000_000)), 0), Some(0));
    assert_eq!(slack(Acknowledged(Nanos(1_000_001)), 0), Some(-1));
    assert_eq!(slack(Acknowledged(Nanos(999_000)), 1_001), Some(-1));
    assert_eq!(slack(Acknowledged(Nanos::ZERO), 0), Some(1_000_000));
    // The hardware ends a pulse without jitter. A pulse shorter than half the cycle has no line.
    assert_eq!(slack(Pulse(Nanos(1_000_000)), 5_000), Some(0));
    assert_eq!(slack(Pulse(Nanos(500_000)), 0), Some(500_000));
    assert_eq!(slack(Pulse(Nanos(499_999)), 0), None);
    assert_eq!(slack(Unknown, 0), None);
    let sm =
        Device { mode: SyncMode::SmSynchronous, sync_signal: Acknowledged(Nanos(1)), ..drive() };
    assert_eq!(demand(&ideal, Nanos(500_000), &sm, Check::Sync0FallsInCycle), None);
}

/// The terms: 100 ppm of the time until the acknowledge, a tick, and the movement of the controlled
/// clock in a cycle.
#[test]
fn what_acknowledges_counts_by_its_own_clock() {
    let device = Device { sync_signal: SyncSignal::Acknowledged(Nanos(400_000)), ..drive() };
    let demand = demand(&CYCLE, Nanos(500_000), &device, Check::Sync0FallsInCycle).unwrap();
    assert_eq!(demand.needed.total(), Nanos(400_000 + 40 + 10 + 100));
}

/// The longest SYNC0 cycle that a device takes, and a nanosecond more. No line without a limit, and
/// none without SYNC0.
#[test]
fn a_sync_cycle_as_long_as_the_device_takes() {
    let limits = |longest| SyncLimits { longest: Some(Nanos(longest)), step: None };
    let device = |longest| Device { sync_limits: limits(longest), ..drive() };
    let check = Check::LongestSyncCycle;
    assert_eq!(slack(&CYCLE, 500_000, &device(1_000_000), check), 0);
    assert_eq!(slack(&CYCLE, 500_000, &device(999_999), check), -1);
    let refused = demand(&CYCLE, Nanos(500_000), &device(999_999), check).unwrap();
    let sign = refused.sign(SyncMode::DcSync0);
    assert_eq!(sign, Sign::Refusal(AlStatusCode::DC_SYNC0_CYCLE));
    assert_eq!(budget(&CYCLE, Nanos(500_000), &drive()).line(check), None);
    let sm = Device { mode: SyncMode::SmSynchronous, ..device(1) };
    assert_eq!(budget(&CYCLE, Nanos(500_000), &sm).line(check), None);
}

/// SYNC0 is short enough, and the time up to SYNC1 is not.
#[test]
fn a_distance_of_sync1_as_long_as_the_device_takes() {
    let check = Check::LongestSyncCycle;
    let of = |longest| {
        let pulses =
            Pulses { sync0_cycle: Nanos(250_000), sync1: Nanos(750_000), lead: Nanos(750_000) };
        let sync_limits = SyncLimits { longest: Some(Nanos(longest)), step: None };
        let device = Device { mode: SyncMode::DcSubordinated, pulses, sync_limits, ..drive() };
        let demand = demand(&CYCLE, Nanos(800_000), &device, check).unwrap();
        (demand.slack().0, demand.sign(device.mode))
    };
    assert_eq!(of(750_000), (0, Sign::Refusal(AlStatusCode::DC_SYNC1_CYCLE)));
    assert_eq!(of(749_999), (-1, Sign::Refusal(AlStatusCode::DC_SYNC1_CYCLE)));
    assert_eq!(of(249_999), (-1, Sign::Refusal(AlStatusCode::DC_SYNC0_CYCLE)));
}

/// A multiple of the step, and a nanosecond to either side; the line always names the step.
#[test]
fn a_sync0_cycle_in_steps_of_the_device() {
    let check = Check::Sync0InSteps;
    let of = |step, sync0_cycle| {
        let sync_limits = SyncLimits { longest: None, step: Some(Nanos(step)) };
        let pulses = Pulses { sync0_cycle: Nanos(sync0_cycle), ..Pulses::default() };
        let device = Device { sync_limits, pulses, ..drive() };
        let demand = demand(&CYCLE, Nanos(500_000), &device, check).unwrap();
        assert_eq!(demand.step(), Some(Nanos(step)));
        assert_eq!(demand.sign(device.mode), Sign::Refusal(AlStatusCode::DC_INVALID_SYNC_CYCLE));
        (demand.line().needed.0, demand.slack().0)
    };
    assert_eq!(of(500_000, 1_000_000), (1_000_000, 0));
    assert_eq!(of(500_000, 999_999), (1_000_000, -1));
    assert_eq!(of(500_000, 1_000_001), (1_500_000, -499_999));
    assert_eq!(of(1_000_000, 1_000_000), (1_000_000, 0));
    assert_eq!(of(2_000_000, 1_000_000), (2_000_000, -1_000_000));
    // What a device takes is no slack of its cycle.
    let device = Device {
        sync_limits: SyncLimits { longest: None, step: Some(Nanos(1_000_000)) },
        ..drive()
    };
    let lines = budget(&CYCLE, Nanos(500_000), &device);
    assert_eq!(lines.line(check).unwrap().slack(), Nanos::ZERO);
    assert!(lines.slack().unwrap() > Nanos::ZERO && lines.failure().is_none());
}
