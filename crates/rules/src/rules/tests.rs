//! Each rule: the mistake that it catches, the right case beside it, and missing evidence.

use core::ops::Range;
use std::vec;
use std::vec::Vec;

use isocat_sync::SyncMode;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, AlStatusCode};

use crate::breach::Breach;
use crate::evidence::Slide;
use crate::{Breached, Claims, DeviceClaims, DeviceEvidence, Evidence, Ruling, judge};

const CYCLE: Nanos = Nanos::millis(4);
const SHIFT: Nanos = Nanos::millis(2);

/// Two drives with SYNC0 of 4 ms, 2 ms behind the frame, and an I/O.
fn claims() -> Claims {
    let drive = DeviceClaims {
        operates: true,
        mode: Some(SyncMode::DcSync0),
        sync0_cycle: Some(CYCLE),
        shift: Some(SHIFT),
        in_phase: true,
        has_data: true,
        cycle: Some(CYCLE),
        interpolation: Some(CYCLE),
        guarded: true,
        watchdog: Some(Nanos::millis(100)),
    };
    let io = DeviceClaims { operates: true, has_data: true, ..<_>::default() };
    let devices = vec![drive.clone(), drive, io];
    Claims { cycle: Some(CYCLE), sync0_limit: Nanos(1_000), devices }
}

/// The logical bits of one FMMU.
fn one(bits: Range<u64>) -> Vec<Range<u64>> {
    Vec::from_iter(Some(bits))
}

/// The same segment as it runs if all is right.
fn evidence() -> Evidence {
    let drive = |at: u64| DeviceEvidence {
        state: Some((AlState::Op, AlStatusCode(0))),
        operated: true,
        mode: Some(SyncMode::DcSync0),
        activation: Some(3),
        sync0_cycle: Some(CYCLE),
        sync0_phase: Some(SHIFT),
        sync0_overdue: Some(Nanos::ZERO),
        frame_to_sync0: Some(Picos::from(SHIFT)),
        lengths: Some([6, 6]),
        exchanged: [Some(true); 2],
        carried_each: [Some(CYCLE); 2],
        interpolation: Some(CYCLE),
        logical: Some([one(at..at + 48), one(at..at + 48)]),
        guarded: Some(true),
        watchdog: Some(Nanos::millis(100)),
        clock_set: Some(Nanos::ZERO),
    };
    let io = DeviceEvidence {
        state: Some((AlState::Op, AlStatusCode(0))),
        operated: true,
        mode: Some(SyncMode::SmSynchronous),
        activation: Some(0),
        lengths: Some([1, 0]),
        exchanged: [Some(true), None],
        logical: Some([one(96..104), Vec::new()]),
        guarded: Some(true),
        clock_set: Some(Nanos::ZERO),
        ..DeviceEvidence::default()
    };
    Evidence {
        cycle: Some(CYCLE),
        longest_drift_gap: Some(CYCLE),
        slide: Some(Slide { per_second: Nanos(0), uncertainty: Nanos(100) }),
        talkers: Some(vec![4_000]),
        untaken: Some([0, 1_000]),
        devices: vec![drive(0), drive(48), io],
    }
}

/// The judgement of a segment in which one thing is otherwise.
fn with(change: impl FnOnce(&mut Evidence)) -> Ruling {
    let mut evidence = evidence();
    change(&mut evidence);
    judge(&claims(), &evidence)
}

fn breaches(change: impl FnOnce(&mut Evidence)) -> Vec<Breached> {
    with(change).breached
}

fn of(device: impl Into<Option<usize>>, breach: Breach) -> Vec<Breached> {
    vec![Breached { device: device.into(), breach }]
}

#[test]
fn a_segment_as_it_was_meant_keeps_every_claim() {
    let ruling = with(|_| {});
    assert_eq!((ruling.breached, ruling.unchecked), (vec![], vec![]));
    // Three states, two modes, two starts, two cycles, two shifts, one pair in phase, cycle, phase,
    // sender and answers of the frames, time, three times data, five directions, those of two
    // drives in each cycle and over which time they interpolate, five ranges, two watchdogs and
    // their times, three clocks that are kept.
    assert_eq!(ruling.checked, 3 + 2 + 2 + 2 + 2 + 1 + 4 + 1 + 3 + 5 + 4 + 2 + 5 + 2 + 2 + 3);
}

#[test]
fn without_evidence_nothing_is_checked_and_each_claim_says_so() {
    let device = DeviceEvidence { operated: true, ..DeviceEvidence::default() };
    let nothing = Evidence { devices: vec![device; 3], ..Evidence::default() };
    let ruling = judge(&claims(), &nothing);
    assert_eq!((ruling.breached, ruling.checked), (vec![], 0));
    let rules: std::collections::BTreeSet<_> =
        ruling.unchecked.iter().map(|one| one.rule).collect();
    // Some rules claim nothing here: those about SYNC0, its clocks and the phase and time of frames
    // need a SYNC0 that is known to run, the one about interpolation a time that was written, and
    // the one about answers a program whose sockets can be seen.
    let all = crate::book::RULES.iter().map(|rule| rule.name);
    let expected = all.filter(|name| {
        let no_claims = ["starts", "clock-kept", "steady", "taken", "time", "interpolation"];
        !no_claims.contains(name)
    });
    assert_eq!(rules, expected.collect());
}

#[test]
fn without_claims_only_what_is_never_right_is_judged() {
    let devices = vec![<_>::default(); 3];
    let nothing = Claims { cycle: None, sync0_limit: Nanos(1_000), devices };
    let mut evidence = evidence();
    evidence.devices[1].state = Some((AlState::SafeOp, AlStatusCode(0x1B)));
    evidence.devices[0].mode = Some(SyncMode::FreeRun);
    evidence.cycle = Some(Nanos(1));
    assert_eq!(judge(&nothing, &evidence).breached, []);
    evidence.devices[0].exchanged[1] = Some(false);
    let expected = of(0, Breach::NotCarried { outputs: false });
    assert_eq!(judge(&nothing, &evidence).breached, expected);
}

#[test]
fn a_clock_is_kept_by_drift_frames_alone() {
    let set = |by: Nanos| breaches(|evidence| evidence.devices[1].clock_set = Some(by));
    assert_eq!(set(Nanos(1_000)), []);
    assert_eq!(set(Nanos(1_001)), of(1, Breach::ClockSet { by: Nanos(1_001) }));
    // Without SYNC0 nothing jumps with it.
    let without = |evidence: &mut Evidence| {
        evidence.devices[2].clock_set = Some(Nanos::millis(1));
        evidence.devices[..2].iter_mut().for_each(|device| device.sync0_cycle = None);
    };
    assert!(breaches(without).iter().all(|one| !matches!(one.breach, Breach::ClockSet { .. })));
}

#[test]
fn a_watchdog_has_the_time_that_was_asked_for() {
    let wanted = Nanos::millis(100);
    let has = |found: Nanos| breaches(|evidence| evidence.devices[0].watchdog = Some(found));
    for found in [Nanos::millis(90), Nanos::millis(110)] {
        assert_eq!(has(found), []);
    }
    for found in [Nanos(89_999_999), Nanos(110_000_001)] {
        assert_eq!(has(found), of(0, Breach::OtherWatchdog { wanted, found }));
    }
    // Where it is off, that is said alone.
    let off = breaches(|evidence| {
        let device = &mut evidence.devices[0];
        (device.watchdog, device.guarded) = (Some(Nanos::ZERO), Some(false));
    });
    assert_eq!(off, of(0, Breach::WatchdogOff));
}

#[test]
fn frames_that_slide_have_no_distance_to_sync0() {
    let ruling = with(|evidence| {
        evidence.slide = Some(Slide { per_second: Nanos(27_000), uncertainty: Nanos(100) });
        evidence.devices[0].frame_to_sync0 = Some(Picos::ZERO);
    });
    let kinds: Vec<_> = ruling.breached.iter().map(|one| one.breach.name()).collect();
    assert_eq!(kinds, ["frames-slide"]);
    assert!(ruling.unchecked.iter().all(|one| one.rule == "shift") && ruling.unchecked.len() == 2);
}

#[test]
fn each_device_operates() {
    let (state, code) = (AlState::SafeOp, AlStatusCode(0x1B));
    let below = |operated: bool| {
        breaches(|evidence| {
            let device = &mut evidence.devices[2];
            (device.state, device.operated) = (Some((state, code)), operated);
            device.exchanged = [Some(false); 2];
        })
    };
    // What it does below OP is no further finding, but what it did in OP is.
    assert_eq!(below(false), of(2, Breach::NotOperated { state, code }));
    assert_eq!(below(true).len(), 2);
}

#[test]
fn a_device_runs_in_its_mode() {
    let sm = SyncMode::SmSynchronous;
    let other = |evidence: &mut Evidence| {
        let device = &mut evidence.devices[1];
        (device.mode, device.activation) = (Some(sm), Some(0));
        (device.sync0_cycle, device.sync0_phase, device.frame_to_sync0) = (None, None, None);
    };
    let breach = Breach::OtherMode { wanted: SyncMode::DcSync0, found: sm, activation: Some(0) };
    // The mode explains that there is no SYNC0.
    assert_eq!((breaches(other), with(other).unchecked), (of(1, breach), vec![]));
}

#[test]
fn sync0_starts() {
    let overdue = |ago: i64| breaches(|all| all.devices[1].sync0_overdue = Some(Nanos(ago)));
    assert_eq!((overdue(0), overdue(1)), (vec![], of(1, Breach::StartPassed { ago: Nanos(1) })));
}

#[test]
fn sync0_has_its_cycle() {
    let double = |evidence: &mut Evidence| {
        evidence.devices[1].sync0_cycle = Some(Nanos(CYCLE.0 + 1));
    };
    let breach = Breach::OtherSync0Cycle { wanted: CYCLE, found: Nanos(CYCLE.0 + 1) };
    assert_eq!(breaches(double), of(1, breach.clone()));
    // It may be why a device did not come to OP, and then it is said beside its state.
    let below = |cycle| {
        with(|evidence| {
            let device = &mut evidence.devices[1];
            (device.state, device.operated) = (None, false);
            device.sync0_cycle = cycle;
        })
    };
    assert_eq!(below(Some(Nanos(CYCLE.0 + 1))).breached, of(1, breach));
    for right in [Some(CYCLE), None] {
        let ruling = below(right);
        assert!(ruling.breached.is_empty() && ruling.unchecked.len() == 1, "{ruling:?}");
    }
}

/// With half the frames missing, or twice as many, the distance follows from the cycle.
#[test]
fn frames_of_another_cycle_have_no_distance_to_sync0() {
    let half = Nanos(CYCLE.0 / 2);
    let found = breaches(|evidence| {
        evidence.cycle = Some(half);
        evidence.devices[0].frame_to_sync0 = Some(Picos::ZERO);
    });
    let breach = Breach::OtherCycle { wanted: CYCLE, found: half };
    assert_eq!(found, [Breached { device: None, breach }]);
}

#[test]
fn sync0_comes_where_it_was_asked_for() {
    let at = |ps: i64| breaches(|evidence| evidence.devices[0].frame_to_sync0 = Some(Picos(ps)));
    let (shift, quarter) = (Picos::from(SHIFT).0, Picos::from(CYCLE).0 / 4);
    for inside in [shift - quarter, shift + quarter, shift + 4 * quarter, shift - 4 * quarter] {
        assert_eq!(at(inside), [], "{inside}");
    }
    for outside in [shift - quarter - 1, shift + quarter + 1, 0, 41_000_000] {
        let breach = Breach::OtherShift { wanted: SHIFT, found: Picos(outside) };
        assert_eq!(at(outside), of(0, breach), "{outside}");
    }
}

#[test]
fn pulses_come_at_one_instant() {
    let at = |phase: i64| breaches(|evidence| evidence.devices[1].sync0_phase = Some(Nanos(phase)));
    let limit = Nanos(1_000);
    for by in [-1_000, 0, 1_000, CYCLE.0] {
        assert_eq!(at(SHIFT.0 + by), [], "{by}");
    }
    for by in [-1_001, 1_001, 300_000] {
        let breach = Breach::Sync0Apart { from: 0, by: Nanos(by), limit };
        assert_eq!(at(SHIFT.0 + by), of(1, breach), "{by}");
    }
    // Phases may lie on both sides of where the cycle begins.
    let around = |evidence: &mut Evidence| {
        evidence.devices[0].sync0_phase = Some(Nanos(CYCLE.0 - 400));
        evidence.devices[1].sync0_phase = Some(Nanos(600));
    };
    assert_eq!(breaches(around), []);
}

#[test]
fn a_slower_device_is_in_phase_where_both_have_a_pulse() {
    let mut claims = claims();
    claims.devices[1].sync0_cycle = Some(Nanos(2 * CYCLE.0));
    let slower = |phase: i64| {
        let mut evidence = evidence();
        evidence.devices[1].sync0_cycle = Some(Nanos(2 * CYCLE.0));
        evidence.devices[1].sync0_phase = Some(Nanos(phase));
        judge(&claims, &evidence).breached
    };
    assert_eq!(slower(SHIFT.0), []);
    assert_eq!(slower(SHIFT.0 + CYCLE.0), []);
    assert_eq!(slower(SHIFT.0 + CYCLE.0 + 5_000).len(), 1);
}

#[test]
fn frames_have_the_bus_cycle() {
    let at = |ns: i64| breaches(|evidence| evidence.cycle = Some(Nanos(ns)));
    let part = CYCLE.0 / 50;
    assert_eq!((at(CYCLE.0 - part), at(CYCLE.0 + part)), (vec![], vec![]));
    for ns in [CYCLE.0 - part - 1, CYCLE.0 + part + 1, CYCLE.0 / 2] {
        assert_eq!(at(ns), of(None, Breach::OtherCycle { wanted: CYCLE, found: Nanos(ns) }));
    }
}

#[test]
fn frames_do_not_slide() {
    let at = |per_second: i64, uncertainty: i64| {
        let slide = Slide { per_second: Nanos(per_second), uncertainty: Nanos(uncertainty) };
        breaches(|evidence| evidence.slide = Some(slide))
    };
    assert_eq!((at(1_000, 0), at(-35_000, 8_750)), (vec![], vec![]));
    let slides = |per_second: i64, half_cycle_after| {
        let per_second = Nanos(per_second);
        of(None, Breach::FramesSlide { per_second, half_cycle_after })
    };
    assert_eq!(at(1_001, 0), slides(1_001, Nanos(1_998_001_998_001)));
    // 2 ms at 35 us each second.
    assert_eq!(at(-35_000, 8_749), slides(-35_000, Nanos(57_142_857_142)));
    // Without SYNC0 it does not matter.
    let free = |evidence: &mut Evidence| {
        evidence.slide = Some(Slide { per_second: Nanos(35_000), uncertainty: Nanos(0) });
        evidence.devices.iter_mut().for_each(|device| device.sync0_cycle = None);
    };
    assert!(with(free).breached.is_empty());
}

#[test]
fn one_main_device_sends() {
    let two = |other: u64| breaches(|evidence| evidence.talkers = Some(vec![other, 4_000]));
    assert_eq!((two(7), two(8)), (vec![], of(None, Breach::SeveralTalkers { frames: 8 })));
}

#[test]
fn answers_are_taken() {
    let untaken = |frames, sent| breaches(|evidence| evidence.untaken = Some([frames, sent]));
    let breach = |frames, sent| of(None, Breach::AnswersUntaken { frames, of: sent });
    assert_eq!((untaken(7, 500), untaken(8, 500)), (vec![], breach(8, 500)));
    assert_eq!((untaken(19, 2_000), untaken(20, 2_000)), (vec![], breach(20, 2_000)));
    // A program that always sends first knows how old its inputs are.
    assert_eq!((untaken(493, 500), untaken(492, 500)), (vec![], breach(492, 500)));
}

#[test]
fn the_reference_time_comes_often_enough() {
    let at = |gap: i64| breaches(|evidence| evidence.longest_drift_gap = Some(Nanos(gap)));
    let limit = Nanos::millis(200);
    assert_eq!(at(limit.0), []);
    let breach = Breach::TimeNotDistributed { gap: Nanos(limit.0 + 1), limit };
    assert_eq!(at(limit.0 + 1), of(None, breach));
    // One clock alone can't run apart from another.
    let alone = |evidence: &mut Evidence| {
        evidence.longest_drift_gap = Some(Nanos::millis(9_000));
        evidence.devices[1].sync0_cycle = None;
    };
    assert!(with(alone).breached.is_empty());
}

#[test]
fn a_device_has_its_process_data() {
    let none = |evidence: &mut Evidence| {
        evidence.devices[0].lengths = Some([0, 0]);
        evidence.devices[0].exchanged = [Some(false); 2];
    };
    assert_eq!(breaches(none), of(0, Breach::NoProcessData));
    // One direction is enough.
    let inputs = |evidence: &mut Evidence| evidence.devices[0].lengths = Some([0, 6]);
    assert_eq!(breaches(inputs), []);
}

#[test]
fn process_data_are_carried() {
    let lost = |evidence: &mut Evidence| evidence.devices[1].exchanged[1] = Some(false);
    assert_eq!(breaches(lost), of(1, Breach::NotCarried { outputs: false }));
}

#[test]
fn process_data_are_carried_in_each_cycle() {
    let each = |found: i64, bus: i64| {
        breaches(|evidence| {
            evidence.devices[1].carried_each[0] = Some(Nanos(found));
            evidence.cycle = Some(Nanos(bus));
        })
    };
    let most = CYCLE.0 * 5 / 4;
    assert_eq!((each(most, CYCLE.0), each(CYCLE.0 / 2, CYCLE.0)), (vec![], vec![]));
    let breach =
        |found| Breach::CarriedSeldom { outputs: true, wanted: CYCLE, found: Nanos(found) };
    for found in [most + 1, 2 * CYCLE.0] {
        assert_eq!(each(found, CYCLE.0), of(1, breach(found)));
    }
    // If all frames come each 8 ms, that is one mistake; each 16 ms is another one.
    let twice = 2 * CYCLE.0;
    let other = of(None, Breach::OtherCycle { wanted: CYCLE, found: Nanos(twice) });
    assert_eq!(each(twice, twice), other);
    assert_eq!(each(2 * twice, twice), [other, of(1, breach(2 * twice))].concat());
}

#[test]
fn a_drive_interpolates_over_its_cycle() {
    let over = |found: i64| breaches(|all| all.devices[1].interpolation = Some(Nanos(found)));
    let breach = |found| Breach::OtherInterpolation { wanted: CYCLE, found: Nanos(found) };
    let most = CYCLE.0 / 16;
    for (found, right) in [(0, true), (most, true), (most + 1, false), (CYCLE.0 / 2, false)] {
        for found in [CYCLE.0 + found, CYCLE.0 - found] {
            let expected = if right { vec![] } else { of(1, breach(found)) };
            assert_eq!(over(found), expected);
        }
    }
}

#[test]
fn logical_addresses_belong_to_one_device() {
    let shared = |from: u64| {
        breaches(|evidence| {
            let Some([outputs, _]) = &mut evidence.devices[2].logical else { return };
            outputs[0] = from..from + 8;
        })
    };
    assert_eq!(shared(96), []);
    let breach = Breach::SharedAddress { with: 1, outputs: true, logical: 11 };
    assert_eq!(shared(95), of(2, breach));
    // A range within another one of a device that is not the one before.
    let breach = Breach::SharedAddress { with: 0, outputs: true, logical: 1 };
    assert_eq!(shared(8), of(2, breach));
}

#[test]
fn outputs_are_guarded() {
    let off = |evidence: &mut Evidence| evidence.devices[0].guarded = Some(false);
    assert_eq!(breaches(off), of(0, Breach::WatchdogOff));
}

#[test]
fn each_kind_has_one_rule_and_each_rule_a_name() {
    let rules = crate::book::RULES;
    let mut names: Vec<_> = rules.iter().map(|rule| rule.name).collect();
    let all = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), all);
    let mut found: Vec<_> = rules.iter().map(|rule| rule.finds).collect();
    let mut kinds: Vec<_> = Breach::DESCRIPTIONS.iter().map(|kind| kind.name).collect();
    found.sort_unstable();
    kinds.sort_unstable();
    assert_eq!(found, kinds);
}

#[test]
fn a_mode_that_was_left_open_may_be_any() {
    let mut claims = claims();
    claims.devices[1].mode = None;
    let in_mode = |mode, sync0_cycle| {
        let mut evidence = evidence();
        let device = &mut evidence.devices[1];
        (device.mode, device.sync0_cycle) = (Some(mode), sync0_cycle);
        (device.sync0_phase, device.frame_to_sync0) = (sync0_cycle, sync0_cycle.map(Picos::from));
        judge(&claims, &evidence)
    };
    let sm = in_mode(SyncMode::SmSynchronous, None);
    assert_eq!((sm.breached, sm.unchecked), (vec![], vec![]));
    let short = in_mode(SyncMode::DcSubordinated, Some(Nanos::millis(1)));
    assert_eq!(short.breached, []);
    // With SYNC0, it is the one that belongs to the bus cycle.
    let double = Nanos(2 * CYCLE.0);
    let breach = Breach::OtherSync0Cycle { wanted: CYCLE, found: double };
    assert!(in_mode(SyncMode::DcSync0, Some(double)).breached.contains(&of(1, breach)[0]));
}
