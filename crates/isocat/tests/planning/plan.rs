//! The plan: what it says of known segments, that it holds in true time, and that it is what a run
//! does.

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;

use isocat::plan::{Plan, PlanReport, proof, suggest};
use isocat::report::NoteKind;
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::plan::Target;
use isocat_sim::observation::Observation;
use isocat_sim::{Segment, Tap};
use isocat_sync::SyncMode;
use isocat_wire::coe::sdo::Initiate;
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{Command, register};

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("plan.toml", text).expect("a segment file"))
}

fn built_in() -> Scenario {
    Scenario::from(SegmentFile::built_in())
}

fn report(scenario: &Scenario) -> PlanReport {
    Plan::of(scenario).expect("a plan").report(scenario)
}

const TREE: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    name = "root"
    device = "model_every_mode"
    mode = "dc-sync0"
    clock_walk = { step = "0.02ppm", every = "1ms", within = "1ppm" }
    [[subdevice]]
    name = "late"
    device = "kollmorgen_akd2g"
    connect = "root:2"
    clock = "-35ppm"
    [[subdevice]]
    name = "early"
    device = "kollmorgen_akd2g"
    connect = "0:1"
    clock = "+20ppm"
    cable_asymmetry = "3ns"
    [[subdevice]]
    name = "end of early"
    device = "hpmicro_ecat_cia402_ssc"
    port = 1
"#;

const LINE: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    count = 50
    name = "left"
    clock = "+30ppm"
    [[subdevice]]
    device = "hpmicro_ecat_cia402_ssc"
    count = 50
    name = "right"
    clock = "-20ppm"
"#;

/// Every mode with and without shifts, all in one segment.
const MODES: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync0"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync0"
    shift = "150us"
    input_shift = "120us"
    clock = "+43ppm"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-shift-sync1"
    sync1 = "100us"
    clock = "-37ppm"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync1"
    clock = "+15ppm"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-subordinated"
    sync0_cycle = "250us"
    [[subdevice]]
    device = "model_every_mode"
    mode = "sm"
    clock = "-50ppm"
    [[subdevice]]
    device = "model_every_mode"
    mode = "sm"
    input_shift = "400us"
    [[subdevice]]
    device = "model_every_mode"
    mode = "free-run"
"#;

/// No line and no event beyond its bound, and each bound within its factor; MinimumCycle alone may
/// be loose: a device states what it needs at most, whatever it does.
fn holds(mut scenario: Scenario, milliseconds: i64) -> PlanReport {
    scenario.duration = Nanos::millis(milliseconds);
    let plan = Plan::of(&scenario).expect("a plan");
    let mut report = plan.report(&scenario);
    proof::prove(&plan, &scenario).fill(&mut report);
    let proof = report.proof.as_ref().expect("it was proven");
    assert!(report.fits && proof.holds, "{:#?}", proof.findings);
    let clock = report.segment.clock_error_ns as f64;
    for device in &report.devices {
        let own_cycle = device.mode == SyncMode::FreeRun;
        for line in &device.lines {
            let stated =
                ["shift-covers-delay", "input-shift-covers-delay"].contains(&line.check.name());
            // Nobody sees when a device in Free Run has fetched its outputs.
            let unseen = own_cycle && line.check.name() == "outputs-before-watchdog";
            let Some(seen) = line.measured else {
                assert!(stated || unseen, "{}: {} was never seen", device.name, line.check.name());
                continue;
            };
            assert!(seen.of_bound <= 1.0, "{}: {line:?}", device.name);
            let tight = (seen.needed_ns + 2.0 * clock) * proof::FACTOR >= line.needed_ns as f64;
            assert!(tight || line.check.name() == "minimum-cycle", "{}: {line:#?}", device.name);
        }
        for moment in &device.moments {
            let seen = moment.measured;
            let seen =
                seen.unwrap_or_else(|| panic!("{}: {} was never seen", device.name, moment.event));
            assert!(seen.count > 20 || own_cycle, "{}: {moment:?}", device.name);
        }
    }
    report
}

#[test]
fn the_plan_of_the_built_in_segment_holds_in_true_time() {
    let report = holds(built_in(), 3_000);
    assert_eq!(report.devices.len(), 5);
    assert!(report.verdict.starts_with("Fits with assumptions"), "{}", report.verdict);
}

#[test]
fn the_plan_of_a_line_of_a_hundred_holds() {
    let report = holds(scenario(LINE), 100);
    assert_eq!(report.devices.len(), 100);
}

#[test]
fn the_plan_of_a_tree_holds() {
    let report = holds(scenario(TREE), 1_000);
    let names: Vec<_> = report.devices.iter().map(|device| device.name.as_str()).collect();
    assert_eq!(names, ["root", "early", "end of early", "late"]);
}

#[test]
fn the_plan_of_every_mode_holds() {
    let report = holds(scenario(MODES), 500);
    let modes: Vec<_> = report.devices.iter().map(|device| device.mode.name()).collect();
    assert!(SyncMode::ALL.iter().all(|mode| modes.contains(&mode.name())), "{modes:?}");
}

/// Devices slower than the bus: every second and every fifth cycle, in phase with the others.
#[test]
fn the_plan_of_several_cycle_times_holds() {
    let text = r#"
        cycle = "1ms"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        mode = "dc-sync0"
        [[subdevice]]
        device = "hpmicro_ecat_cia402_ssc"
        mode = "dc-sync0"
        cycle = "2ms"
        clock = "+37ppm"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-sync1"
        cycle = "5ms"
        clock = "-23ppm"
    "#;
    let report = holds(scenario(text), 1_000);
    let cycles: Vec<_> = report.devices.iter().map(|device| device.sync0_cycle_ns).collect();
    assert_eq!(cycles, [Some(1_000_000), Some(2_000_000), Some(5_000_000)]);
    let frames: Vec<_> = report.frames.iter().map(|f| (f.every, f.spread_ns > 0)).collect();
    assert_eq!(frames, [(1, false), (2, false), (5, true)]);
    // What is as slow as 2 ms may be is too slow for its 1 ms.
    let slow = text.replace("cycle = \"2ms\"", "cycle = \"1500us\"");
    let error = SegmentFile::parse("slow.toml", &slow).expect_err("no multiple").to_string();
    assert!(error.contains("no whole multiple of the bus cycle of 1 ms"), "{error}");
    let other = text.replace("mode = \"dc-sync1\"", "mode = \"dc-subordinated\"");
    let error = SegmentFile::parse("other.toml", &other).expect_err("faster").to_string();
    assert!(error.contains("any other mode than \"dc-subordinated\""), "{error}");
    // Whoever follows the frames, and has a timer behind them, in a group of its own and together
    // with others.
    for cycle in ["2ms", "3ms", "5ms"] {
        let keys = format!("mode = \"sm\"\n cycle = \"{cycle}\"");
        let sm = text.replace("mode = \"dc-sync1\"\n        cycle = \"5ms\"", &keys);
        assert_ne!(sm, text);
        let by_timer =
            sm.replace("\n        clock = \"-23", "\ninput_shift = \"400us\"\nclock = \"-23");
        assert_ne!(by_timer, sm);
        for text in [sm, by_timer] {
            let report = holds(scenario(&text), 500);
            assert_eq!(report.devices[2].mode, SyncMode::SmSynchronous);
        }
    }
}

/// Delays from cables and chips are those that the simulation's own way of frames has.
#[test]
fn delays_are_those_of_the_wire() {
    for text in [TREE, LINE, SegmentFile::built_in_text()] {
        let scenario = scenario(text);
        let segment = Segment::new(scenario.run().setup.segment, 1);
        let first = segment.path().entries[0].after;
        for (device, entry) in report(&scenario).devices.iter().zip(&segment.path().entries) {
            let after: Picos = entry.after - first;
            let expected = (after.0 + 500).div_euclid(1_000);
            assert_eq!((device.position, device.delay_ns), (entry.device, expected));
        }
    }
}

/// The run plans with the same code: what it measures of the delays is all that may differ.
#[test]
fn a_run_plans_the_same() {
    for text in [TREE, MODES, SegmentFile::built_in_text()] {
        let mut scenario = scenario(text);
        scenario.duration = Nanos::millis(20);
        let planned = report(&scenario);
        let run = isocat::run(&scenario);
        for (planned, run) in planned.devices.iter().zip(&run.devices) {
            let lines = |object: &str, demand: &str| {
                let mut all = planned.lines.iter();
                all.find(|line| line.object.as_deref() == Some(object) && line.demand == demand)
            };
            // Limits of the judges that are kept stand with what the judges saw.
            let of_cycle = planned.lines.iter().filter(|line| line.check.is_of_cycle());
            assert_eq!(of_cycle.count(), run.plan.len(), "{}", run.name);
            for line in &run.plan {
                let planned = lines(&line.object, &line.demand).expect("the same lines");
                let off = (planned.slack_ns - line.slack_ns).abs();
                assert!(off <= 2_000, "{}: {line:?}, planned {}", run.name, planned.slack_ns);
            }
        }
    }
}

#[test]
fn a_line_that_does_not_fit_is_named() {
    let mut scenario = built_in();
    scenario.shift = Some(Nanos::micros(80));
    let report = report(&scenario);
    assert!(!report.fits);
    assert!(
        report.verdict.contains("Does not fit, because SubDevice 1 (AKD2G axis 2)"),
        "{}",
        report.verdict
    );
    let short: Vec<_> =
        report.devices.iter().flat_map(|d| &d.lines).filter(|l| l.slack_ns < 0).collect();
    assert_eq!(short.len(), 2, "{short:#?}");
    assert!(short.iter().all(|line| line.sign == "0x1C32:0B counts"));
    // SYNC0 behind the frame, but the second drive's copying is not done.
    assert!(!report.warnings.iter().any(|note| note.kind == NoteKind::Sync0InFrame));
}

#[test]
fn what_the_field_falls_into() {
    let kinds = |scenario: &Scenario| -> Vec<(usize, &str)> {
        let notes = report(scenario).warnings;
        notes.iter().map(|note| (note.position.expect("a device"), note.kind.name())).collect()
    };
    let mut scenario = built_in();
    scenario.hop_jitter = false;
    let expected = [(0, "type-read-only"), (1, "type-read-only"), (4, "first-opmode-dc-off")];
    assert_eq!(kinds(&scenario), expected);
    scenario.shift = Some(Nanos::micros(10));
    for position in [0, 1, 4] {
        assert!(kinds(&scenario).contains(&(position, "sync0-in-frame")), "{position}");
    }
    // The last bit of the last frame, and a nanosecond behind it, jitter included. Its frame has
    // gone out to the terminal and back: 3 hops of copper, the terminal's, and the coupler past its
    // unit.
    let delay = 3 * 765 + 155 + 155 - 20;
    let end = |more: i64| 8_080 + delay + 20_000 + more;
    for (more, inside) in [(0, true), (1, false)] {
        scenario.shift = Some(Nanos(end(more)));
        assert_eq!(kinds(&scenario).contains(&(4, "sync0-in-frame")), inside);
    }
}

#[test]
fn a_base_cycle_of_two_pulses_has_two_phases() {
    let mut scenario = scenario(MODES);
    let profile = isocat::profile::built_in_text("model_every_mode").expect("built in");
    let stated =
        profile.replacen("\"0ns\",    \"SYNC0 cycle time\"", "\"2ms\",    \"SYNC0 cycle time\"", 1);
    assert_ne!(stated, profile);
    scenario.devices.truncate(1);
    scenario.devices[0].profile =
        isocat::profile::Profile::from_toml("two", &stated).expect("a profile");
    let notes = report(&scenario).warnings;
    let note = notes.iter().find(|note| note.kind == NoteKind::TwoPhases).expect("a warning");
    assert!(note.what.contains("2 phases"), "{}", note.what);
}

/// The phase that is suggested leaves the same on both sides, and the cycle is the smallest: one
/// step less does not fit.
#[test]
fn the_suggestion_is_the_best_there_is() {
    for text in [SegmentFile::built_in_text(), TREE, LINE, MODES] {
        let mut scenario = scenario(text);
        let plan = Plan::of(&scenario).expect("a plan");
        let found = suggest::suggest(&plan, &scenario);
        let (shift, slack) = (found.shift_ns.expect("DC"), found.slack_ns.expect("DC"));
        scenario.shift = Some(Nanos(shift));
        let report = report(&scenario);
        let before = shift - report.segment.output_reference_ns.expect("outputs");
        let after = report.segment.input_reference_ns.expect("inputs") - shift;
        assert!((before - after).abs() <= 20, "{before} {after}");
        assert_eq!(before.min(after), slack);
        assert_eq!(found.send_phase_ns, Some(1_000_000 - shift));

        let smallest = found.smallest_cycle_ns.expect("1 ms fits, so something does");
        let at = |cycle| {
            let wished = isocat_maindevice::Config {
                cycle: Nanos(cycle),
                shift: None,
                ..plan.config.clone()
            };
            plan.with(wished).is_ok_and(|plan| plan.fits())
        };
        assert!(
            at(smallest) && !at(smallest - found.cycles.as_ref().expect("cycles").step_ns),
            "{smallest}"
        );
    }
}

/// What the list says is what is seen on the wire, device by device, in this order.
#[test]
fn the_start_up_list_is_what_the_run_writes() {
    for text in [SegmentFile::built_in_text(), MODES] {
        let mut scenario = scenario(text);
        scenario.duration = Nanos::millis(1);
        let plan = Plan::of(&scenario).expect("a plan");
        let wire = Rc::new(RefCell::new(Wire::default()));
        let outcome = scenario.run().execute(Some(wire_tap(&wire)), &mut |_| {});
        assert!(outcome.failure.is_none());
        for position in 0..scenario.devices.len() {
            let writes = plan.writes(&scenario, position);
            let expected: Vec<_> = writes.to_preop.into_iter().chain(writes.to_safeop).collect();
            let station = plan.segment.devices[position].station.0;
            let wire = wire.borrow();
            let mut seen: Vec<_> = wire.0.iter().filter(|(to, ..)| *to == station).collect();
            // Offset and delay are written twice: first to try what the sign of 0x092C means. Then
            // the offset is written once more, behind the first drift frame.
            let is_clock = |target: &Target| matches!(target, Target::Register(0x0920 | 0x0928));
            if let Some(tried) = seen.iter().position(|(_, target, _)| is_clock(target)) {
                let clock: Vec<_> =
                    seen.drain(tried..tried + 3).map(|(_, target, _)| *target).collect();
                assert!(clock.iter().all(is_clock), "{clock:x?}");
                assert_eq!(seen[tried].1, Target::Register(0x0928));
                assert_eq!(seen[tried + 1].1, Target::Register(0x0920));
                seen.swap(tried, tried + 1);
            }
            let names = |targets: Vec<Target>| -> String {
                targets.iter().map(|target| format!("{target:x?}\n")).collect()
            };
            assert_eq!(
                names(seen.iter().map(|(_, target, _)| *target).collect()),
                names(expected.iter().map(|write| write.target).collect()),
                "device {position}"
            );
            for ((_, target, data), write) in seen.iter().zip(&expected) {
                if let Some(expected) = &write.data {
                    assert_eq!(data, expected, "device {position}: {target:x?}");
                }
            }
            // A coupler has nothing to map.
            let least = if plan.segment.devices[position].outputs.length > 0 { 3 } else { 0 };
            assert!(expected.len() > least, "device {position}");
        }
    }
}

/// Writes to single SubDevices on the wire: station, where to, what.
#[derive(Default)]
struct Wire(Vec<(u16, Target, Vec<u8>)>);

struct WireTap(Rc<RefCell<Wire>>);

fn wire_tap(wire: &Rc<RefCell<Wire>>) -> WireTap {
    WireTap(wire.clone())
}

impl Tap for WireTap {
    fn frame(&mut self, _: Time<True>, sent: bool, bytes: &[u8]) {
        let Ok(payload) = isocat_wire::frame::payload(bytes) else { return };
        for datagram in isocat_wire::datagram::datagrams(payload).flatten().filter(|_| sent) {
            if datagram.header.command() != Ok(Command::Fpwr) {
                continue;
            }
            let (station, at) = (datagram.header.adp(), datagram.header.ado());
            let target = match at {
                // Requests of states and the EEPROM are no settings.
                0x0120..0x0140 | 0x0500..0x0510 => continue,
                0x1000.. => match download(datagram.data) {
                    Some((object, data)) => (Target::Object(object), data),
                    None => continue,
                },
                at => (Target::Register(at), datagram.data.to_vec()),
            };
            // Nothing is set any more behind the last of these but process data.
            assert!(at != register::AL_CONTROL.address);
            self.0.borrow_mut().0.push((station, target.0, target.1));
        }
    }
    fn observed(&mut self, _: &Segment, _: Time<True>, _: &Observation) {}
}

/// The entry and the bytes of an expedited SDO download in a mailbox message.
fn download(message: &[u8]) -> Option<(isocat_wire::ObjectAddress, Vec<u8>)> {
    let coe = message.get(6..)?;
    let service = u16::from_le_bytes([*coe.first()?, *coe.get(1)?]) >> 12;
    let initiate = Initiate::parse(coe.get(2..)?.first_chunk()?);
    let expedited =
        service == 2 && initiate.command.specifier() == 1 && initiate.command.expedited();
    let len = initiate.command.expedited_len();
    expedited.then(|| (initiate.object, initiate.data[..len].to_vec()))
}

#[test]
fn the_schemas_of_the_plan_are_committed() {
    schema_is_committed("plan", &isocat::plan::report::schema());
    schema_is_committed("plan-cycles", &isocat::plan::cycles::schema());
}

fn schema_is_committed(name: &str, schema: &serde_json::Value) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../docs/{name}.schema.json"));
    let now = serde_json::to_string_pretty(schema).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(now, committed, "the plan changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
    let schema: serde_json::Value = serde_json::from_str(&committed).expect("JSON");
    for part in schema["$defs"].as_object().expect("parts").values().chain([&schema]) {
        assert_eq!(part["additionalProperties"], false, "{part}");
        let keys = part["properties"].as_object().expect("keys");
        assert_eq!(part["required"].as_array().map_or(0, Vec::len), keys.len(), "{part}");
        assert!(keys.values().all(|key| key["description"].is_string()), "{part}");
    }
}

/// Three cycles of one segment: one that is no cycle, one that devices can't keep, one that fits.
#[test]
fn several_cycles_are_planned_in_one_table() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis\"\n\
                [[subdevice]]\ndevice = \"simple_io16\"\nname = \"io\"\ncount = 30\n\
                [[subdevice]]\ndevice = \"simple_io4\"\nname = \"last\"\n";
    let cycles = ["1us", "200us", "1ms"].map(str::to_owned);
    let found = isocat::plan::cycles::at_cycles("here.toml", text, &cycles).unwrap();
    let [none, short, long] = &found.plans[..] else { panic!("three plans: {found:?}") };
    assert!(!none.fits && none.least_slack_ns.is_none() && none.devices.is_empty());
    assert!(none.verdict.contains("expected 10 us"), "{}", none.verdict);
    assert!(!short.fits && short.least_slack_ns == Some(-50_000), "{:?}", short.least_slack_ns);
    assert!(long.fits && !found.all_fit());
    // As `plan` says it of the same segment.
    let plan =
        isocat::plan::Plan::of(&Scenario::from(SegmentFile::parse("here.toml", text).unwrap()));
    let (_, tightest) = plan.as_ref().unwrap().tightest();
    assert_eq!(long.least_slack_ns, Some(tightest.slack().0));
    let text = isocat_descriptions::columns::plain(&found.text());
    let rows = text.lines().filter(|line| line.contains("sm ")).collect::<Vec<_>>();
    assert!(
        rows.iter().any(|row| row.starts_with(" 1 to 30 ")),
        "equal devices are one row\n{text}"
    );
    assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
    golden("cycles", &text);
}

fn golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/plan/{name}.txt"));
    let text = anstream::adapter::strip_str(text).to_string();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).expect("a folder");
        std::fs::write(&path, &text).expect("the golden files are writable");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(text, committed, "{}: UPDATE_GOLDEN=1 rewrites it", path.display());
    let long = text.lines().find(|line| line.chars().count() > 100);
    assert_eq!(long, None, "a hundred columns");
}

#[test]
fn the_plan_in_words() {
    let built_in = built_in();
    let mut plan = report(&built_in);
    plan.suggestion = Some(suggest::suggest(&Plan::of(&built_in).expect("a plan"), &built_in));
    golden("built_in", &plan.text());
    golden("modes", &report(&scenario(MODES)).text());
    golden("line", &report(&scenario(LINE)).text());
    let list = Plan::of(&built_in).expect("a plan").start_up(&built_in);
    golden("start_up", &list.text());
}

/// What it costs stands in benches/instructions.txt.
#[test]
fn a_thousand_devices_are_planned() {
    let text = "cycle = \"4ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 1000\n";
    let report = report(&scenario(text));
    assert_eq!(report.devices.len(), 1000);
    assert!(report.fits, "{}", report.text());
}
