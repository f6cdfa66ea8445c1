//! Groups of SubDevices with different cycles in one segment: what travels in which bus cycle, seen
//! on the wire.

use std::cell::RefCell;
use std::rc::Rc;

use isocat::plan::Plan;
use isocat::{Nanos, NoTap, Report, Scenario, SegmentFile};
use isocat_maindevice::{Event, Motion};
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Segment, Tap, World};
use isocat_sync::SyncMode;
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{datagram, frame};

/// One fast, many of 2 ms, one of 5 ms, and a slow one that follows its frames.
const GROUPS: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    mode = "dc-sync0"
    [[subdevice]]
    device = "model_every_mode"
    mode = "dc-sync1"
    cycle = "5ms"
    clock = "-23ppm"
    [[subdevice]]
    device = "hpmicro_ecat_cia402_ssc"
    mode = "dc-sync0"
    cycle = "2ms"
    clock = "+37ppm"
    count = 12
    [[subdevice]]
    device = "model_every_mode"
    mode = "sm"
    cycle = "4ms"
    clock = "+11ppm"
"#;
const MS: i64 = 1_000_000_000;

fn scenario(text: &str) -> Scenario {
    Scenario::from(SegmentFile::parse("groups.toml", text).expect("a segment file"))
}

/// Frames of process data as they leave, and the acting pulses.
#[derive(Clone, Default)]
struct Wire(Rc<RefCell<Seen>>);

#[derive(Default)]
struct Seen {
    /// When, and the first logical address in it.
    frames: Vec<(Time<True>, u32)>,
    /// When, and which SubDevice.
    pulses: Vec<(Time<True>, usize)>,
    /// Time on the wire of frames of process data.
    busy: Picos,
}

impl Tap for Wire {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        let payload = frame::payload(bytes).expect("our own frame");
        let mut all = datagram::datagrams(payload).flatten();
        let data = all.find(|d| d.header.command().is_ok_and(|command| command.is_logical()));
        let Some(data) = data.filter(|_| sent) else { return };
        let mut seen = self.0.borrow_mut();
        seen.frames.push((at, data.header.address));
        let on_wire = bytes.len().max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
        seen.busy += Picos((on_wire as u64 * frame::BYTE_TIME_NS * 1_000) as i64);
    }
    fn observed(&mut self, _: &Segment, at: Time<True>, observation: &Observation) {
        // The one with DC SYNC1 acts at SYNC1, those with SYNC0 at that.
        let acts = match observation.event {
            Observed::Sync0 => observation.device != 1,
            Observed::Sync1 => true,
            _ => false,
        };
        if acts {
            self.0.borrow_mut().pulses.push((at, observation.device));
        }
    }
}

impl Seen {
    fn of(&self, logical: u32, from: Time<True>) -> Vec<Time<True>> {
        let mine = self.frames.iter().filter(|(at, address)| *address == logical && *at >= from);
        mine.map(|(at, _)| *at).collect()
    }

    /// The first acting pulse of a SubDevice behind an instant.
    fn pulse_after(&self, device: usize, at: Time<True>) -> Option<Time<True>> {
        self.pulses.iter().find(|(pulse, of)| *of == device && *pulse > at).map(|(pulse, _)| *pulse)
    }
}

#[test]
fn each_group_travels_in_its_own_cycles_and_in_that_of_its_pulse() {
    let mut scenario = scenario(GROUPS);
    scenario.duration = Nanos::millis(1_000);
    let plan = Plan::of(&scenario).expect("a plan");
    let chunks = &plan.segment.image.chunks;
    let every: Vec<_> = chunks.iter().map(|chunk| chunk.every).collect();
    assert_eq!(every, [1, 2, 4, 5]);
    let wire = Wire::default();
    let outcome = scenario.run().execute(Some(wire.clone()), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    assert!(report.in_sync, "{:?}", report.findings);
    let cycles: Vec<_> = [0, 1, 2, 13, 14].map(|at| report.devices[at].cycle_ns).to_vec();
    assert_eq!(cycles, [1, 5, 2, 2, 4].map(|ms| Some(ms * 1_000_000)));

    let (seen, from) = (wire.0.borrow(), outcome.began.expect("it was judged"));
    let to = from + Picos(1_000 * MS);
    for (chunk, device) in chunks.iter().zip([0, 2, 14, 1]) {
        let frames: Vec<_> =
            seen.of(chunk.logical, from).into_iter().filter(|at| *at < to).collect();
        let expected = 1_000 / i64::from(chunk.every);
        assert!((frames.len() as i64 - expected).abs() <= 1, "{} of {expected}", frames.len());
        for pair in frames.windows(2) {
            let off = (pair[1] - pair[0]).0 - i64::from(chunk.every) * MS;
            assert!(off.abs() < MS / 10, "{}: off by {off} ps", chunk.every);
        }
        // The pulse comes in the same bus cycle: no frame of 1 ms lies between.
        if device != 14 {
            for at in &frames[..frames.len() - 1] {
                let pulse = seen.pulse_after(device, *at).expect("pulses go on");
                assert!((pulse - *at).0 < MS, "{device}: {:?} before its pulse", pulse - *at);
            }
        }
    }
}

/// Many slow ones beside a fast one.
const MANY: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    mode = "dc-sync0"
    [[subdevice]]
    device = "hpmicro_ecat_cia402_ssc"
    mode = "dc-sync0"
    cycle = "5ms"
    count = 80
"#;

/// The wire is busy for what the plan says of each frame, divided by how seldom it goes. Groups of
/// little data may take more than one frame for all would; one of much data takes its part.
#[test]
fn slow_groups_take_their_share_of_the_wire() {
    let busy = |text: &str| {
        let mut scenario = scenario(text);
        scenario.duration = Nanos::millis(500);
        let plan = Plan::of(&scenario).expect("a plan");
        let frames = plan.timing().frames.iter();
        let gap = 12 * frame::BYTE_TIME_NS as i64;
        let planned: f64 =
            frames.map(|f| ((f.end - f.begin).0 + gap) as f64 / f64::from(f.every)).sum();
        let setup = scenario.run().setup;
        let wire = Wire::default();
        let mut world = World::new(setup, Motion::default(), Some(wire.clone()));
        operate(&mut world);
        let (before, cycles) = (wire.0.borrow().busy, world.main().statistics().cycles);
        let end = world.now() + Picos(500 * MS);
        while world.step(end) {}
        let cycles = world.main().statistics().cycles - cycles;
        let measured = (wire.0.borrow().busy.0 - before.0) as f64 / 1e3 / cycles as f64;
        assert!(
            (measured / planned - 1.0).abs() < 0.01,
            "{measured} ns a cycle, {planned} planned"
        );
        measured
    };
    busy(GROUPS);
    let grouped = busy(MANY);
    let alone = busy(&MANY.replace("cycle = \"5ms\"", ""));
    println!("{grouped:.0} ns of a cycle on the wire in groups, {alone:.0} ns without");
    assert!(grouped < 0.35 * alone, "{grouped} {alone}");
}

fn operate<T: Tap>(world: &mut World<Motion, T>) {
    let limit = Time::new(20_000 * MS as u64);
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(limit), "the segment does not come up");
    }
}

#[test]
fn groups_allocate_nothing() {
    let mut world = World::new(scenario(GROUPS).run().setup, Motion::default(), None::<NoTap>);
    operate(&mut world);
    let mut run = |milliseconds| {
        let end = world.now() + Picos(milliseconds * MS);
        while world.step(end) {}
        world.main().statistics().cycles
    };
    let cycles = run(50);
    // The reference clock's milliseconds are not quite true time's.
    let allocations = allocation_counter::measure(|| assert!(run(100).abs_diff(cycles + 100) <= 1));
    assert_eq!(allocations.count_total, 0, "{allocations:?}");
}

/// A host that stands still for some cycles sends each group in its cycles again, as its pulses
/// went on. The group whose cycle it slept through waits for the next one.
#[test]
fn a_stall_keeps_groups_and_pulses_together() {
    for stalled in [3_300, 5_700, 11_200] {
        // How many cycles a stall takes hangs on when it begins.
        let scenario = Scenario { hop_jitter: false, ..scenario(GROUPS) };
        let chunks = Plan::of(&scenario).expect("a plan").segment.image.chunks;
        let wire = Wire::default();
        let mut world = World::new(scenario.run().setup, Motion::default(), Some(wire.clone()));
        operate(&mut world);
        let run = |world: &mut World<Motion, Wire>| {
            let end = world.now() + Picos(100 * MS);
            while world.step(end) {}
            end
        };
        let before = run(&mut world);
        world.host_mut().oversleep(Nanos::micros(stalled));
        run(&mut world);
        assert!(world.main().statistics().cycles_skipped >= stalled as u64 / 1_000);
        let seen = wire.0.borrow();
        for (chunk, device) in [(&chunks[1], 2), (&chunks[3], 1)] {
            let frames = seen.of(chunk.logical, before);
            assert!(frames.len() > 15, "{}", frames.len());
            for at in &frames[..frames.len() - 1] {
                let pulse = seen.pulse_after(device, *at).expect("pulses go on");
                assert!((pulse - *at).0 < MS, "{stalled}: {:?}", pulse - *at);
            }
        }
    }
}

/// Groups without any SubDevice of the bus cycle, and without a mode that has pulses.
#[test]
fn slow_groups_alone() {
    let slow = r#"
        cycle = "1ms"
        [[subdevice]]
        device = "model_every_mode"
        mode = "dc-sync0"
        cycle = "3ms"
        [[subdevice]]
        device = "model_every_mode"
        mode = "free-run"
        cycle = "7ms"
    "#;
    let mut scenario = scenario(slow);
    scenario.duration = Nanos::millis(300);
    let report = isocat::run(&scenario);
    assert!(report.in_sync, "{:?}", report.findings);
    let modes = [SyncMode::DcSync0, SyncMode::FreeRun].map(|mode| mode.name().to_owned());
    assert_eq!([0, 1].map(|at| report.devices[at].mode.name()), modes);
}
