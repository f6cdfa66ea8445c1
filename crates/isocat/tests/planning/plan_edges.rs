//! Each kind of line of the plan at its edge: slack 0 ns runs clean, -1 ns raises exactly the sign
//! that the line predicts, and nothing else.
//!
//! All clocks are ideal and the host is never late, so that each cycle is like the other. What is
//! then left between plan and truth are ticks of 10 ns; the first run measures it, and the plan
//! gets it as its clock error.

use isocat::plan::{Plan, proof, suggest};
use isocat::profile::{Overrides, Profile};
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_sim::HostModel;
use isocat_sync::budget::{Check, Sign};

/// One device that has every mode, with `changes` in its profile.
fn scenario(keys: &str, changes: &[(&str, String)]) -> Scenario {
    let text = format!(
        "cycle = \"1ms\"\nclocks = \"0ppm\"\n[[subdevice]]\ndevice = \"model_every_mode\"\n{keys}"
    );
    let mut scenario = Scenario::from(SegmentFile::parse("edge", &text).expect("a segment file"));
    let mut profile = isocat::profile::built_in_text("model_every_mode").unwrap().to_owned();
    for (from, to) in changes {
        assert!(profile.contains(from), "{from} is in the profile");
        profile = profile.replacen(from, to, 1);
    }
    scenario.devices[0].profile = Profile::from_toml("changed", &profile).expect("a profile");
    scenario.host = HostModel { clock_ppb: 0, jitter: Nanos::ZERO, ..HostModel::default() };
    scenario.duration = Nanos::millis(60);
    scenario.clock_error = Some(Nanos::ZERO);
    scenario.hop_jitter = false;
    scenario.shift = Some(Nanos::micros(300));
    scenario
}

struct Seen {
    /// Slack of the plan.
    planned: i64,
    /// Least slack in true time; `None` if nothing is to be seen.
    measured: Option<i64>,
    /// Lines that were late in true time.
    late: Vec<Check>,
    /// 0x1C32 and 0x1C33: 0B, 0C, 0D.
    counters: [[u32; 3]; 2],
    status: u16,
    in_sync: bool,
    findings: String,
}

fn look(scenario: &Scenario, check: Check) -> Seen {
    let plan = Plan::of(scenario).expect("a plan");
    let demand = plan.timing().demand(0, check).expect("the mode has this line");
    let proof = proof::prove(&plan, scenario);
    let device = &proof.run.devices[0];
    let registers = &device.registers;
    let counters = [&registers.output_counters, &registers.input_counters].map(|c| {
        [c.sm_event_missed, c.cycle_time_too_small, c.shift_time_too_short].map(|v| v.unwrap_or(0))
    });
    Seen {
        planned: demand.slack().0,
        measured: proof.slack(Some(0), check).map(|(ns, _)| {
            assert_eq!(ns, ns.round(), "ideal clocks: whole ns");
            ns as i64
        }),
        late: Check::OF_DEVICE
            .into_iter()
            .filter(|check| proof.slack(Some(0), *check).is_some_and(|(ns, _)| ns < 0.0))
            .collect(),
        counters,
        status: registers.al_status_code,
        in_sync: proof.run.in_sync,
        findings: proof.run.findings.iter().map(|finding| finding.sentence() + "\n").collect(),
    }
}

/// `at(0)` has slack 0 in the line, `at(1)` the smallest step less.
fn edge(check: Check, step: i64, at: impl Fn(i64) -> Scenario) {
    let exact = look(&at(0), check);
    let found = |seen: &Seen| {
        let Seen { planned, measured, late, counters, status, findings, .. } = seen;
        format!(
            "{check:?}: planned {planned}, seen {measured:?}, late {late:?}, {counters:?}, {status:#x}\n{findings}"
        )
    };
    assert!((0..step).contains(&exact.planned), "{}", found(&exact));
    // The time that a device with DC states for its cycle is its own, and more than what can be
    // seen.
    let own = check == Check::MinimumCycle && exact.measured > Some(0);
    assert!(exact.measured.is_none_or(|seen| seen == exact.planned || own), "{}", found(&exact));
    assert!(exact.in_sync && exact.late.is_empty(), "{}", found(&exact));
    assert_eq!(exact.counters, [[0; 3]; 2], "{}", found(&exact));

    let short = look(&at(1), check);
    let plan = Plan::of(&at(1)).expect("a plan");
    let mode = plan.timing().devices[0].0.mode;
    let demand = plan.timing().demand(0, check).expect("the line");
    assert!((-step..0).contains(&short.planned), "{}", found(&short));
    let plain = run_as_planned(&at(1));
    assert!(plain.contains(check.words()) && plain.contains("slack -"), "refused: {plain}");
    match demand.sign(mode) {
        Sign::Counter(object) => {
            let number = usize::from(object.sub - 0x0B);
            for counters in short.counters {
                for (at, counted) in counters.into_iter().enumerate() {
                    assert_eq!(counted > 0, at == number, "{object}: {}", found(&short));
                }
            }
            assert!(!short.in_sync, "{}", found(&short));
        }
        Sign::Refusal(code) | Sign::Fall(code) => {
            assert_eq!(short.status, code.0, "{}", found(&short))
        }
        Sign::Judge(_) => {
            assert_eq!(short.late, [check], "{}", found(&short));
            assert_eq!(short.measured, Some(short.planned), "{}", found(&short));
            assert_eq!(short.counters, [[0; 3]; 2], "{}", found(&short));
        }
    }
}

/// What a run says that keeps to its plan.
fn run_as_planned(scenario: &Scenario) -> String {
    let report = isocat::run(scenario);
    assert!(!report.in_sync);
    report.findings.iter().map(|finding| finding.sentence()).collect()
}

/// The slack of a line where nothing is changed.
fn slack(keys: &str, check: Check) -> i64 {
    look(&scenario(keys, &[]), check).planned
}

fn copy(ns: i64) -> (&'static str, String) {
    ("\"20us\",   \"Calc and copy time\"", format!("\"{ns}ns\",   \"Calc and copy time\""))
}

fn input_copy(ns: i64) -> (&'static str, String) {
    ("\"12us\",   \"Calc and copy time\"", format!("\"{ns}ns\",   \"Calc and copy time\""))
}

fn minimum(ns: i64) -> (&'static str, String) {
    ("\"60us\",   \"Minimum cycle time\"", format!("\"{ns}ns\",   \"Minimum cycle time\""))
}

/// The proof sees a frame's begin by its end, which the ESC takes on its next tick; and the host
/// sends on its own ns. Closer to the edge the inputs of some cycles are really late, and the
/// judges see them.
const FRAMES_WANDER: i64 = 10;

const SYNC0: &str = "mode = \"dc-sync0\"\n";
const SHIFT_SYNC1: &str = "mode = \"dc-shift-sync1\"\nsync1 = \"100us\"\n";
const SYNC1: &str = "mode = \"dc-sync1\"\nsync1 = \"50us\"\n";
const SUBORDINATED: &str = "mode = \"dc-subordinated\"\nsync0_cycle = \"500us\"\n";

#[test]
fn outputs_ready_at_the_pulse() {
    for keys in [SYNC0, SHIFT_SYNC1, SUBORDINATED] {
        let slack = slack(keys, Check::OutputsBeforeSync0);
        let room = if keys == SUBORDINATED { 500_000 } else { 1_000_000 };
        edge(Check::OutputsBeforeSync0, 1, |more| {
            scenario(keys, &[copy(20_000 + slack + more), minimum(room), minimum(room)])
        });
    }
}

/// Pulses come on ticks of 10 ns: the frame's last bit on a tick, and a tick later.
#[test]
fn outputs_stored_at_the_pulse_that_fetches_them() {
    let slack = slack(SYNC1, Check::OutputsStoredBeforeSync0);
    edge(Check::OutputsStoredBeforeSync0, 10, |more| {
        let mut scenario = scenario(SYNC1, &[]);
        scenario.shift = Some(Nanos(300_000 - slack - 10 * more));
        scenario
    });
}

#[test]
fn outputs_calculated_at_sync1() {
    edge(Check::Sync1CoversCopy, 1, |more| {
        scenario(SYNC1, &[copy(50_000 + more), minimum(100_000), minimum(100_000)])
    });
}

/// Register 0x09A4 in ticks of 10 ns. With SYNC1 so late the inputs miss the next frame, as their
/// line says; the device does not mind.
#[test]
fn sync1_before_the_next_sync0() {
    let with = |sync1| {
        let only_sync1 = || ("0x003F,", "0x000F,".to_owned());
        let mut scenario = scenario(SHIFT_SYNC1, &[only_sync1(), only_sync1()]);
        scenario.devices[0].sync1 = Some(Nanos(sync1));
        look(&scenario, Check::Sync1BeforeNextSync0)
    };
    let exact = with(999_990);
    assert_eq!((exact.planned, exact.measured), (9, Some(9)), "{}", exact.findings);
    assert_eq!((exact.counters, exact.status), ([[0; 3]; 2], 0), "{}", exact.findings);
    let short = with(1_000_000);
    assert_eq!((short.planned, short.status), (-1, 0x0030), "{}", short.findings);
}

#[test]
fn inputs_there_when_the_frame_begins() {
    let by_timer = "mode = \"sm\"\ninput_shift = \"400us\"\n";
    for keys in [SYNC0, SHIFT_SYNC1, SYNC1, SUBORDINATED, by_timer] {
        let late = |mut scenario: Scenario| {
            scenario.shift = Some(Nanos::micros(700));
            scenario
        };
        let slack = look(&late(scenario(keys, &[])), Check::InputsBeforeFrame).planned;
        let room = if keys == SUBORDINATED { 500_000 } else { 1_000_000 };
        edge(Check::InputsBeforeFrame, FRAMES_WANDER, |more| {
            let copy = 12_001 + slack - FRAMES_WANDER * (1 - more);
            let times = [input_copy(copy), minimum(room), minimum(room)];
            late(scenario(keys, &times))
        });
    }
}

/// Without outputs the reads are counted: one between two pulses. A host that is either in time or
/// as late as was planned puts them on both sides of the pulse. Pulses come on ticks of 10 ns.
#[test]
fn inputs_read_at_the_pulse_that_counts_the_reads() {
    for keys in [SYNC0, SHIFT_SYNC1, SYNC1, SUBORDINATED] {
        let inputs_only = |shift: i64| {
            let mut scenario = scenario(keys, &[("default = [0x1600]", "default = []".to_owned())]);
            scenario.host.jitter = Nanos::micros(20);
            scenario.shift = Some(Nanos(shift));
            scenario
        };
        let slack = look(&inputs_only(300_000), Check::InputsReadBeforeSync0).planned;
        edge(Check::InputsReadBeforeSync0, 10, |more| inputs_only(300_000 - slack - 10 * more));
    }
}

/// The watchdog counts ticks of 100 us; the cycle is what is set to the nanosecond.
#[test]
fn outputs_come_again_before_the_watchdog() {
    for keys in [SYNC0, "mode = \"sm\"\n"] {
        edge(Check::OutputsBeforeWatchdog, 1, |more| {
            let mut scenario = scenario(keys, &[]);
            scenario.watchdog = Some(Nanos::millis(2));
            scenario.cycle = Nanos(2_000_000 + more);
            scenario
        });
    }
}

/// A slow device gets its outputs in its own cycle.
#[test]
fn outputs_of_a_slow_device_come_again_before_the_watchdog() {
    for keys in [SYNC0, "mode = \"sm\"\n"] {
        edge(Check::OutputsBeforeWatchdog, 5, |more| {
            let mut scenario = scenario(keys, &[]);
            scenario.watchdog = Some(Nanos::millis(2));
            scenario.cycle = Nanos(400_000 + more);
            scenario.devices[0].cycle = Some(Nanos(5 * (400_000 + more)));
            scenario
        });
    }
}

/// Its inputs have until the next frame of its own.
#[test]
fn inputs_of_a_slow_device_are_there_when_its_frame_begins() {
    let by_timer = "mode = \"sm\"\ninput_shift = \"400us\"\n";
    for keys in [SYNC0, SHIFT_SYNC1, SYNC1, by_timer] {
        let slow = |times: &[(&str, String)]| {
            let mut scenario = scenario(keys, times);
            scenario.devices[0].cycle = Some(Nanos::millis(3));
            scenario
        };
        let slack = look(&slow(&[]), Check::InputsBeforeFrame).planned;
        assert!(slack > 2_000_000, "{slack}");
        edge(Check::InputsBeforeFrame, FRAMES_WANDER, |more| {
            let all = 3_000_000;
            let copy = 12_001 + slack - FRAMES_WANDER * (1 - more);
            slow(&[input_copy(copy), minimum(all), minimum(all)])
        });
    }
}

#[test]
fn shifts_cover_the_delays() {
    edge(Check::ShiftCoversDelay, 1, |less| {
        let keys = format!("{SYNC0}shift = \"{}ns\"\n", 30_000 - less);
        scenario(&keys, &[])
    });
    edge(Check::InputShiftCoversDelay, 1, |less| {
        let keys = format!("{SYNC0}input_shift = \"{}ns\"\n", 2_000 - less);
        scenario(&keys, &[])
    });
}

#[test]
fn outputs_valid_before_the_next_pulse() {
    edge(Check::OutputsValidInCycle, 1, |more| {
        let mut scenario = scenario(SYNC0, &[]);
        scenario.devices[0].shift = Some(Nanos(1_000_000 + more));
        scenario
    });
}

/// A program that ends the pulse as late as the next one is due, and a tick later.
#[test]
fn sync0_acknowledged_before_the_next_pulse() {
    for (keys, cycle) in [(SYNC0, 1_000_000), (SHIFT_SYNC1, 1_000_000), (SUBORDINATED, 500_000)] {
        edge(Check::Sync0FallsInCycle, 10, |more| {
            let mut scenario = scenario(keys, &[]);
            let (pulse, acknowledge) = (Some(Nanos::ZERO), Some(Nanos(cycle + 10 * more)));
            let signal = Overrides { pulse, acknowledge, ..Overrides::default() };
            scenario.devices[0].profile = scenario.devices[0].profile.with(signal).unwrap();
            scenario
        });
    }
}

/// All that it does takes what it states. With a host in time that is the whole cycle; else the
/// cycle is longer by what the host may be late.
#[test]
fn a_local_cycle_as_long_as_the_bus_cycle() {
    for jitter in [0, 20_000] {
        edge(Check::MinimumCycle, 1, |more| {
            let own = 50_000 + more;
            let times = [copy(own - 12_000 - 7_000), minimum(own), minimum(own)];
            let mut scenario = scenario("mode = \"sm\"\n", &times);
            (scenario.cycle, scenario.shift) = (Nanos(50_000 + jitter), None);
            scenario.host.jitter = Nanos(jitter);
            scenario
        });
    }
}

#[test]
fn a_sync0_cycle_as_short_as_the_device_can() {
    edge(Check::MinimumCycle, 1, |more| {
        let own = 1_000_000 + more;
        scenario(SYNC0, &[minimum(own), minimum(own)])
    });
}

/// The device refuses by its own limits, of which the plan knows the same keys and no formula. With
/// subordinated cycles SYNC0 is short enough, and the time up to SYNC1 is not.
#[test]
fn a_sync_cycle_as_long_as_the_device_takes() {
    let quarter = "mode = \"dc-subordinated\"\nsync0_cycle = \"250us\"\n";
    for (keys, longest) in [(SYNC0, 1_000_000), (SHIFT_SYNC1, 1_000_000), (quarter, 750_000)] {
        edge(Check::LongestSyncCycle, 1, |more| {
            scenario(keys, &[behaviour("maximum_cycle_time", longest - more)])
        });
    }
}

/// A SYNC0 cycle of one step and of four, and steps that are a nanosecond longer.
#[test]
fn a_sync0_cycle_in_steps_of_the_device() {
    for step in [1_000_000, 250_000] {
        let at = |more| scenario(SYNC0, &[behaviour("cycle_granularity", step + more)]);
        let plan = |more| {
            let plan = Plan::of(&at(more)).expect("a plan");
            let demand = plan.timing().demand(0, Check::Sync0InSteps).expect("a line");
            (demand.slack().0, plan.report(&at(more)).verdict)
        };
        assert_eq!(plan(0).0, 0);
        let (slack, verdict) = plan(1);
        assert!(slack < 0 && verdict.contains(&format!("its step is {}", Nanos(step + 1))));
        let (exact, short) = (look(&at(0), Check::Sync0InSteps), look(&at(1), Check::Sync0InSteps));
        assert!(exact.in_sync && !short.in_sync, "{}", exact.findings);
        assert_eq!(short.status, 0x0035, "{}", short.findings);
    }
}

/// Cycles that are tried: step and longest; and the smallest that fits.
#[test]
fn a_suggestion_keeps_to_what_the_sync_unit_takes() {
    let found = |keys, key, ns| {
        let scenario = scenario(keys, &[behaviour(key, ns)]);
        let found = suggest::suggest(&Plan::of(&scenario).expect("a plan"), &scenario);
        let tried = found.cycles.as_ref().expect("cycles");
        (found.smallest_cycle_ns, tried.step_ns, tried.most_ns)
    };
    let (smallest, step, _) = found(SYNC0, "cycle_granularity", 750_000);
    assert_eq!((smallest, step), (Some(750_000), 750_000));
    let (smallest, step, most) = found(SYNC0, "maximum_cycle_time", 900_999);
    assert!(smallest.is_some_and(|smallest| smallest <= 900_000));
    assert_eq!((step, most), (1_000, 900_000));
    // SYNC1 comes a SYNC0 cycle less than the bus cycle behind its SYNC0.
    let (_, step, most) = found(SUBORDINATED, "maximum_cycle_time", 1_000_000);
    assert_eq!((step, most), (500_000, 1_500_000));
    let (_, _, most) = found(SUBORDINATED, "maximum_cycle_time", 999_999);
    assert_eq!(most, 1_000_000);
    // What the fixed SYNC0 is no multiple of helps at no bus cycle.
    let never = scenario(SUBORDINATED, &[behaviour("cycle_granularity", 300_000)]);
    let found = suggest::suggest(&Plan::of(&never).expect("a plan"), &never);
    assert!(found.cycles.is_none() && found.smallest_cycle_ns.is_none());
}

fn behaviour(key: &str, ns: i64) -> (&'static str, String) {
    ("[behaviour]\n", format!("[behaviour]\n{key} = \"{ns}ns\"\n"))
}

/// Frames that fill the cycle but for one acyclic frame. A nanosecond less, and the acyclic ones of
/// the way up push the next cycle.
#[test]
fn frames_that_fill_the_cycle() {
    let full = |less: i64| {
        let text = "cycle = \"1ms\"\nclocks = \"0ppm\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncable = \"10cm\"\ncount = 80\n";
        let file = SegmentFile::parse("edge", text).expect("a segment file");
        let mut scenario = Scenario::from(file);
        scenario.host = HostModel { clock_ppb: 0, jitter: Nanos::ZERO, ..HostModel::default() };
        scenario.duration = Nanos::millis(60);
        scenario.clock_error = Some(Nanos::ZERO);
        let frames = Plan::of(&scenario).expect("a plan").timing().frames_in_cycle();
        scenario.cycle = frames.line().needed - Nanos(less);
        let plan = Plan::of(&scenario).expect("a plan");
        let proof = proof::prove(&plan, &scenario);
        let planned = plan.timing().frames_in_cycle().slack().0;
        (planned, proof.slack(None, Check::FramesInCycle).map(|(ns, _)| ns), proof.run, scenario)
    };
    let (planned, measured, run, _) = full(0);
    assert_eq!(planned, 0);
    assert!(measured >= Some(0.0), "{measured:?}");
    assert!(run.in_sync, "{:?}", run.findings);
    let (planned, measured, _, scenario) = full(1);
    // What is seen is shorter where no acyclic frame met the fullest cycle.
    assert!(planned == -1 && measured >= Some(-1.0), "{measured:?}");
    let refused = run_as_planned(&scenario);
    assert!(refused.contains("all frames of a cycle") && refused.contains("slack -1"), "{refused}");
}
