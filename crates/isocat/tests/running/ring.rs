//! A redundancy ring: whole, cut at every edge while it runs, healed, cut twice. Judged in true
//! time.

use crate::field::*;
use isocat::{Nanos, NoTap, Scenario, SegmentFile};
use isocat_maindevice::error::RingProblem;
use isocat_maindevice::{Cause, Error, Event, Motion, Recovery, Ring};
use isocat_sim::host::Delay;
use isocat_sim::random::Stream;
use isocat_sim::{BitError, Cable, Direction, Segment, Setup, World};
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{AlState, PortNumber, register};

/// The four of the line; cable 4 closes the ring.
const CLOSING: usize = 4;

fn with_ring(setup: &mut Setup) {
    setup.config.ring = Some(Ring::default());
}

fn close(segment: &mut Segment) {
    let number = segment.close_ring(3, PortNumber::P1, Cable::default());
    assert_eq!(number, Ok(CLOSING));
}

fn ring() -> Field {
    ring_of(LINE)
}

fn ring_of(text: &str) -> Field {
    Field::up_wired(text, with_ring, close).unwrap_or_else(|error| panic!("{error}"))
}

/// Outputs from `since` on were stored once a cycle, but in so many cycles at most in a row not at
/// all, and nobody left OP. Gives how many cycles had none.
fn loses_at_most(field: &Field, device: usize, since: Time<True>, most: i64) -> i64 {
    let record = field.witness.0.borrow();
    let seen = &record.devices[device];
    // With what came before, so that the first gap has a begin.
    let since = since + Picos(-2 * CYCLE);
    let stored: Vec<_> = seen.stored.iter().filter(|at| **at >= since).collect();
    let gaps: Vec<i64> = stored.windows(2).map(|pair| (*pair[1] - *pair[0]).0).collect();
    let least = gaps.iter().copied().min().unwrap_or(0);
    let longest = gaps.iter().copied().max().unwrap_or(0);
    assert!(least > CYCLE - CYCLE / 10, "{device}: outputs {least} ps apart: twice in a cycle");
    assert!(longest < (most + 1) * CYCLE + CYCLE / 10, "{device}: {longest} ps without outputs");
    assert!(!seen.states.iter().any(|(at, _)| *at >= since), "{device} left OP");
    let lost: i64 = gaps.iter().map(|gap| (gap + CYCLE / 2) / CYCLE - 1).sum();
    let cycles = (field.world.now() - since).0 / CYCLE;
    let found = stored.len() as i64 + lost;
    assert!((found - cycles).abs() <= 1, "{device}: {found} of {cycles}");
    let missed = seen.missed.iter().filter(|at| **at >= since).count() as i64;
    assert!(missed <= lost, "{device}: {missed} events missed, {lost} cycles lost");
    lost
}

#[test]
fn a_whole_ring_runs_as_a_line_does() {
    let mut worst = Vec::new();
    let line = Field::up(LINE, |_| {});
    for mut field in [line, ring()] {
        let since = field.world.now();
        field.run(1_000);
        let mut errors = Vec::new();
        for device in 0..4 {
            assert_eq!(loses_at_most(&field, device, since, 0), 0);
            if device != 2 {
                let (error, edges) = field.worst_edge(device, since);
                assert!(edges.abs_diff(1_000) <= 1, "{edges} edges");
                errors.push(error);
            }
        }
        let statistics = field.world.main().statistics();
        assert_eq!(statistics.working_counter_errors, 0);
        assert_eq!(
            (statistics.frames_lost, statistics.frames_late, statistics.copies_lost),
            (0, 0, 0)
        );
        assert_eq!(field.told(), Vec::<&Event>::new());
        println!("{errors:?} ps");
        worst.push(errors);
    }
    for (line, ring) in worst[0].iter().zip(&worst[1]) {
        assert!((line - ring).abs() < 40_000 && *ring < 100_000, "{worst:?}");
    }
}

/// The ring cut at one edge for a number of milliseconds, and healed.
struct Cut {
    field: Field,
    cut: Time<True>,
    healed: Time<True>,
}

fn cut_at(cable: usize, milliseconds: i64) -> Cut {
    let mut field = ring();
    let cut = field.soon();
    field.world.segment_mut().unplug(cable, cut);
    field.run(milliseconds);
    Cut { field, cut, healed: cut }
}

impl Cut {
    fn heal(&mut self, cable: usize) {
        let at = self.field.soon();
        self.field.world.segment_mut().plug(cable, at);
        let healed = |event: &Event| matches!(event, Event::RingHealed { .. });
        self.healed = self.field.until(1_000, healed);
        assert!(self.healed - at < Picos(305 * MS.0), "300 ms for the link");
    }
}

/// Most that clocks behind a cut slide in a second, ps: their first one keeps what its drift loop
/// did for the last tick of 10 ns, 4 ppm.
const SLIDE: i64 = 5_000_000;
/// The clocks of [`LINE`].
const CLOCKS: [usize; 3] = [0, 1, 3];

/// Where the ring was last told to be cut.
fn told_cut(field: &Field) -> Option<(Option<usize>, Option<usize>)> {
    field.told().into_iter().rev().find_map(|event| match event {
        Event::RingCut { between, .. } => Some(*between),
        _ => None,
    })
}

fn is_lost(event: &Event) -> bool {
    matches!(event, Event::Lost { .. })
}

/// The clocks behind the cut slide with the rate that their first one has: a few ppm at most,
/// together. When the ring is whole again the drift loops pull them back.
#[test]
fn a_cut_at_any_edge_stops_nobody() {
    for cable in 0..=CLOSING {
        let mut ring = cut_at(cable, 1_000);
        let field = &ring.field;
        println!("cable {cable}: {:?}", field.told());
        let between = (cable.checked_sub(1), (cable < CLOSING).then_some(cable));
        assert_eq!(told_cut(field), Some(between));
        let split = |event: &Event| matches!(event, Event::ClocksSplit { position, .. } if *position == cable);
        assert_eq!(field.count(split), usize::from((1..CLOSING).contains(&cable)));
        for device in 0..4 {
            assert_eq!(loses_at_most(field, device, ring.cut, 1), 0, "the cut met no frame");
        }
        let mut far = Vec::new();
        for device in CLOCKS {
            let (worst, edges) = field.worst_edge(device, ring.cut);
            println!("  {device}: {worst} ps in {edges} edges");
            assert!(edges.abs_diff(1_000) <= 1, "{edges} edges");
            // Without a clock of the near part the reference is in the far one, and leads it.
            match cable == 0 || device < cable {
                true => assert!(worst < 100_000, "{device}: {worst} ps"),
                false => far.push(worst),
            }
        }
        let spread = far.iter().max().zip(far.iter().min());
        if let Some((most, least)) = spread {
            assert!((10_000..SLIDE).contains(most), "{far:?} ps in a second");
            assert!(most - least < 100_000, "they slide together: {far:?} ps");
        }
        assert_eq!(field.count(is_lost), 0);
        let statistics = field.world.main().statistics();
        // In the cycle in which the cut is found out, and while a port is waited for.
        assert!(statistics.working_counter_errors <= 3, "{statistics:?}");
        assert_eq!((statistics.frames_lost, statistics.frames_late), (0, 0));

        let wrong = statistics.working_counter_errors;
        ring.heal(cable);
        let mut field = ring.field;
        field.run(1_000);
        for device in 0..4 {
            assert_eq!(loses_at_most(&field, device, ring.cut, 1), 0);
        }
        for device in CLOCKS {
            let (worst, _) = field.worst_edge(device, ring.healed);
            let (after, _) = field.worst_edge(device, ring.healed + Picos(500 * MS.0));
            println!("  {device}: {worst} ps when healed, {after} ps 0.5 s later");
            let bound = if cable == 0 || device < cable { 50_000 } else { 2 * SLIDE };
            assert!(worst < bound && after < 50_000, "{device}: {worst} ps, then {after} ps");
        }
        assert_eq!(field.world.main().statistics().working_counter_errors, wrong);
        assert_eq!(field.count(is_lost), 0);
        field.broadcasts_only_latches();
        for device in 0..4 {
            field.applies_in_op_only(device);
        }
    }
}

/// How fast the clocks behind a cut slide, and how soon they are back: whatever their first one's
/// loop did last.
#[test]
fn clocks_behind_a_cut_slide_by_a_few_ppm_at_most() {
    let (mut fastest, mut slowest) = (0, i64::MAX);
    for seed in 1..=12 {
        let mut field = ring_of(&LINE.replace("seed = 5", &format!("seed = {seed}")));
        let at = field.soon();
        field.world.segment_mut().unplug(1, at);
        field.run(500);
        let (half, _) = field.worst_edge(1, at);
        field.run(500);
        let (whole, _) = field.worst_edge(1, at);
        let mut ring = Cut { field, cut: at, healed: at };
        ring.heal(1);
        let Cut { mut field, healed, .. } = ring;
        field.run(1_000);
        let (most, _) = field.worst_edge(1, healed);
        let (after, _) = field.worst_edge(1, healed + Picos(500 * MS.0));
        println!(
            "seed {seed}: {half} ps in 0.5 s, {whole} ps in 1 s; healed: {most} ps, {after} ps after 0.5 s"
        );
        assert!(after < 50_000, "{after} ps");
        // It does not turn round on the way back by more than it was off.
        assert!(most < whole + whole / 2 + 100_000, "{most} ps");
        (fastest, slowest) = (fastest.max(whole), slowest.min(whole));
        for device in 0..4 {
            assert_eq!(loses_at_most(&field, device, at, 1), 0);
        }
    }
    assert!((5_000..SLIDE).contains(&fastest) && slowest < 1_000_000, "{fastest} ps in a second");
}

/// The cable breaks while frames are on their way: one cycle is lost at most.
#[test]
fn a_cut_under_way_costs_a_cycle() {
    let mut lost_in_all = 0;
    for cable in [0, 2, CLOSING] {
        for microseconds in (-12..30).step_by(2) {
            let mut field = ring();
            let sent = field.witness.0.borrow().sent;
            let cut = sent + Picos(2 * CYCLE + 1_000_000 * microseconds);
            field.world.segment_mut().unplug(cable, cut);
            field.run(50);
            assert_eq!(field.count(is_lost), 0, "{:#?}", field.told());
            for device in 0..4 {
                lost_in_all += loses_at_most(&field, device, cut, 1);
            }
        }
    }
    println!("{lost_in_all} cycles of a SubDevice lost in 63 cuts");
    assert!(lost_in_all > 0, "some cuts must meet a frame");
}

/// A copy in which a bit tips over on its way against the order of the whole ring is missed by
/// nobody. The other one carries everything: without it the frame is lost, as in a line.
#[test]
fn a_damaged_copy() {
    let mut field = ring();
    let since = field.world.now();
    for number in 0..100 {
        let at = field.soon() + Picos(number * 3 * MS.0);
        let cable = number as usize % 5;
        field.world.segment_mut().disturb(BitError {
            cable,
            direction: Direction::Back,
            at,
            bit: 300,
        });
    }
    field.run(400);
    let statistics = field.world.main().statistics();
    assert_eq!((statistics.copies_lost, statistics.frames_lost), (100, 0));
    assert_eq!(statistics.working_counter_errors, 0);
    assert_eq!(field.told(), Vec::<&Event>::new());
    for device in 0..4 {
        assert_eq!(loses_at_most(&field, device, since, 0), 0);
    }
    let at = field.soon();
    field.world.segment_mut().disturb(BitError {
        cable: 2,
        direction: Direction::Out,
        at,
        bit: 300,
    });
    field.run(50);
    assert!(matches!(field.told()[..], [Event::FrameLost { .. }]), "{:#?}", field.told());
    for device in 0..4 {
        assert_eq!(loses_at_most(&field, device, at, 1), i64::from(device >= 2));
    }
}

/// Behind a cut as well, a copy may be lost: its part misses a cycle, and nobody is taken for gone.
#[test]
fn a_copy_lost_behind_a_cut() {
    let Cut { mut field, .. } = cut_at(2, 100);
    let since = field.world.now();
    for number in 0..20 {
        let at = field.soon() + Picos(number * 10 * MS.0);
        // To one part and to the other.
        let (cable, direction) =
            if number % 2 == 0 { (1, Direction::Out) } else { (3, Direction::Back) };
        field.world.segment_mut().disturb(BitError { cable, direction, at, bit: 300 });
    }
    field.run(300);
    assert_eq!(field.count(is_lost), 0);
    assert_eq!(told_cut(&field), Some((Some(1), Some(2))));
    for device in 0..4 {
        let lost = loses_at_most(&field, device, since, 1);
        assert!((0..=10).contains(&lost), "{device}: {lost}");
    }
    assert_eq!(field.world.main().statistics().frames_lost, 0);
}

/// The two ports send and hand over at their own times, up to 150 us apart: the other copy is
/// waited for.
#[test]
fn ports_that_are_apart() {
    let apart = |setup: &mut Setup| {
        with_ring(setup);
        setup.config.host_jitter = Nanos(200_000);
        setup.config.stamp_noise = Nanos(20_000);
        let more = (Nanos(50_000), Nanos(150_000));
        setup.host.hold_ups = Some(Delay { mean: Nanos(5_000), one_of: 20, more });
    };
    let mut field = Field::up_wired(LINE, apart, close).expect("it comes up");
    let cut = field.soon();
    field.world.segment_mut().unplug(2, cut);
    field.run(500);
    assert_eq!(told_cut(&field), Some((Some(1), Some(2))));
    let statistics = field.world.main().statistics();
    assert!(statistics.working_counter_errors <= 2, "{statistics:?}");
    // An acyclic one may have been where the cable broke.
    assert!(statistics.frames_lost <= 1 && statistics.frames_late == 0, "{statistics:?}");
    assert_eq!(field.count(is_lost), 0);
    for device in 0..4 {
        let record = field.witness.0.borrow();
        let stored = record.devices[device].stored.iter().filter(|at| **at >= cut).count();
        assert!(stored.abs_diff(500) <= 2, "{device}: {stored} of 500");
    }
}

/// One part behind the second cut is lost; when both are healed it is taken up again.
#[test]
fn between_two_cuts_is_lost() {
    let Cut { mut field, cut, .. } = cut_at(1, 100);
    let second = field.soon();
    field.world.segment_mut().unplug(3, second);
    field.run(400);
    let lost: Vec<_> = field.told().into_iter().filter(|event| is_lost(event)).collect();
    assert!(
        matches!(lost[..], [Event::Lost { position: 1, .. }, Event::Lost { position: 2, .. }]),
        "{lost:?}"
    );
    assert_eq!(told_cut(&field), Some((Some(0), Some(3))));
    for device in [0, 3] {
        loses_at_most(&field, device, cut, 1);
        assert_eq!(field.state(device), AlState::Op);
    }
    let (worst, _) = field.worst_edge(0, cut);
    assert!(worst < 50_000, "{worst} ps");
    let wrong = field.world.main().statistics().working_counter_errors;
    field.run(200);
    assert_eq!(field.world.main().statistics().working_counter_errors, wrong);

    // One cut remains: they answer again, and wait for the whole ring.
    let at = field.soon();
    field.world.segment_mut().plug(3, at);
    field.run(3_000);
    assert_eq!(field.count(|event| matches!(event, Event::Found { .. })), 0);
    let at = field.soon();
    field.world.segment_mut().plug(1, at);
    for position in [1, 2] {
        if field.count(readmitted(position)) == 0 {
            field.until(60_000, readmitted(position));
        }
    }
    let back = field.world.now();
    println!("all back {} ms after the cable", (back - at).0 / MS.0);
    field.run(500);
    for device in [0, 3] {
        loses_at_most(&field, device, cut, 1);
    }
    for device in CLOCKS {
        let (worst, edges) = field.worst_edge(device, back);
        println!("{device}: {worst} ps in {edges} edges");
        assert!(worst < FRESH && edges > 400, "{device}: {worst} ps");
        assert_eq!(field.state(device), AlState::Op);
        field.applies_in_op_only(device);
    }
    field.broadcasts_only_latches();
}

/// Cables pulled and plugged anyhow. Who is lost was cut off on both sides, who was not never left
/// OP, and in the end all are back.
#[test]
fn cables_pulled_and_plugged_anyhow() {
    for seed in 1..=8 {
        let text = LINE.replace("seed = 5", &format!("seed = {seed}"));
        let recovering = |setup: &mut Setup| {
            with_ring(setup);
            // Where nothing comes through for longer than a watchdog, no device counts as lost.
            let (first, longest) = (Nanos::millis(100), Nanos::millis(1_600));
            setup.config.recovery = Recovery::BackOff { first, longest };
        };
        let mut field = Field::up_wired(&text, recovering, close).expect("it comes up");
        let begin = field.world.now();
        let mut chance = Stream::new(seed, "cables", 0);
        // When each cable carries frames again; never, while it is pulled.
        let mut carries = [Time::ZERO; CLOSING + 1];
        let mut cut_off = [false; 4];
        for _ in 0..20 {
            // Seldom more than one at a time, or all are lost soon.
            let pulled = carries.iter().position(|since| *since == Time::NEVER);
            let any = chance.up_to(CLOSING as u64) as usize;
            let cable = pulled.filter(|_| chance.up_to(7) > 0).unwrap_or(any);
            let at = field.soon();
            match carries[cable] == Time::NEVER {
                true => {
                    field.world.segment_mut().plug(cable, at);
                    carries[cable] = at + Picos(301 * MS.0);
                }
                false => {
                    field.world.segment_mut().unplug(cable, at);
                    carries[cable] = Time::NEVER;
                    // Frames come to it from neither side, over whatever lies between.
                    for device in 0..4 {
                        let reaches =
                            |cables: &[Time<True>]| cables.iter().all(|since| *since < at);
                        cut_off[device] |=
                            !reaches(&carries[..=device]) && !reaches(&carries[device + 1..]);
                    }
                }
            }
            field.run(5 + chance.up_to(400) as i64);
        }
        let at = field.soon();
        for cable in (0..=CLOSING).filter(|cable| carries[*cable] == Time::NEVER) {
            field.world.segment_mut().plug(cable, at);
        }
        let all_in_op = |field: &Field| (0..4).all(|device| field.state(device) == AlState::Op);
        field.run(500);
        for _ in 0..60 {
            field.run(500);
            if all_in_op(&field) {
                break;
            }
        }
        assert!(all_in_op(&field), "seed {seed}: {:#?}", field.told());
        println!("seed {seed}: {} lost, {cut_off:?}", field.count(is_lost));
        for (device, cut_off) in cut_off.into_iter().enumerate() {
            let lost = |event: &Event| matches!(event, Event::Lost { position, .. } if *position == device);
            assert!(cut_off || field.count(lost) == 0, "seed {seed}: {device} is lost");
            if !cut_off {
                loses_at_most(&field, device, begin, 1);
            }
            field.applies_in_op_only(device);
        }
        // The MainDevice sees it as well.
        field.run(500);
        let since = field.world.now();
        let wrong = field.world.main().statistics().working_counter_errors;
        field.run(300);
        for device in 0..4 {
            assert_eq!(loses_at_most(&field, device, since, 0), 0, "seed {seed}");
        }
        assert_eq!(field.world.main().statistics().working_counter_errors, wrong);
    }
}

/// Whoever loses its power cuts the ring on both sides, and is alone lost.
#[test]
fn one_without_power_is_lost_alone() {
    for off in 0..4 {
        let mut field = ring();
        let at = field.soon();
        field.world.segment_mut().power_off(off, at);
        field.world.segment_mut().power_on(off, at + Picos(200 * MS.0));
        field.run(190);
        let lost: Vec<_> = field.told().into_iter().filter(|event| is_lost(event)).collect();
        assert!(matches!(lost[..], [Event::Lost { position, .. }] if *position == off), "{lost:?}");
        assert_eq!(told_cut(&field), Some((off.checked_sub(1), (off < 3).then_some(off + 1))));
        // With a port that hears nothing any more it takes longer to be sure.
        let (lost, _) = field.events.iter().find(|(_, event)| is_lost(event)).expect("one is");
        println!("{off}: lost after {} us", (*lost - at).0 / 1_000_000);
        assert!(*lost - at < Picos(20 * MS.0));
        field.until(60_000, readmitted(off));
        let back = field.world.now();
        println!("{off}: back {} ms after its power", (back - at).0 / MS.0 - 200);
        field.run(500);
        assert_eq!(field.count(is_lost), 1);
        for device in (0..4).filter(|device| *device != off) {
            loses_at_most(&field, device, at, 1);
        }
        for device in CLOCKS {
            assert_eq!(field.state(device), AlState::Op);
            let (worst, edges) = field.worst_edge(device, back);
            println!("  {device}: {worst} ps in {edges} edges");
            assert!(worst < FRESH && edges > 400, "{device}: {worst} ps");
            field.applies_in_op_only(device);
        }
    }
}

fn failure(change: impl FnOnce(&mut Setup), wire: impl FnOnce(&mut Segment)) -> Error {
    match Field::up_wired(LINE, change, wire) {
        Err(error) => error,
        Ok(field) => panic!("it comes up: {:#?}", field.told()),
    }
}

/// A ring that is cut when it is to come up: what lies behind the cut is named by number; without
/// the last cable it is a line.
#[test]
fn a_ring_that_is_cut_from_the_start() {
    for cable in 0..CLOSING {
        let error = failure(with_ring, |segment| {
            close(segment);
            segment.unplug(cable, Time::ZERO);
        });
        println!("{error}");
        let (near, far) = (cable as u16, (CLOSING - cable) as u16);
        assert_eq!(error.cause, Cause::Ring(RingProblem::Cut { near, far }));
    }
    for never in [false, true] {
        let wire = |segment: &mut Segment| {
            if !never {
                close(segment);
                segment.unplug(CLOSING, Time::ZERO);
            }
        };
        let mut field = Field::up_wired(LINE, with_ring, wire).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(told_cut(&field), Some((Some(3), None)));
        let since = field.world.now();
        field.run(100);
        for device in 0..4 {
            assert_eq!(loses_at_most(&field, device, since, 0), 0);
        }
        if !never {
            let at = field.soon();
            field.world.segment_mut().plug(CLOSING, at);
            field.until(400, |event| matches!(event, Event::RingHealed { .. }));
            field.run(100);
            assert_eq!(field.world.main().statistics().working_counter_errors, 0);
        }
    }
}

/// A branch at a port that comes before the way on is a part of the ring's order; one behind it is
/// refused, as frames from the primary port would never come there.
#[test]
fn a_branch_beside_the_ring() {
    let wire = |last: usize| {
        move |segment: &mut Segment| {
            segment.close_ring(last, PortNumber::P1, Cable::default()).expect("the port is free");
        }
    };
    let right_end = 4;
    let mut field = Field::up_wired(TREE, with_ring, wire(right_end)).expect("it comes up");
    let cut = field.soon();
    field.world.segment_mut().unplug(3, cut);
    field.run(300);
    assert_eq!(told_cut(&field), Some((Some(2), Some(3))));
    let plugged = field.soon();
    field.world.segment_mut().plug(3, plugged);
    field.until(400, |event| matches!(event, Event::RingHealed { .. }));
    field.run(500);
    let later = field.world.now();
    field.run(200);
    for device in 1..5 {
        loses_at_most(&field, device, cut, 0);
        let (worst, edges) = field.worst_edge(device, later);
        assert!(worst < 50_000 && edges > 190, "{device}: {worst} ps in {edges} edges");
    }
    assert_eq!(field.count(is_lost), 0);

    let left_end = 2;
    match Field::up_wired(TREE, with_ring, wire(left_end)) {
        Ok(field) => panic!("it comes up: {:#?}", field.told()),
        Err(Error { cause: Cause::Ring(problem), .. }) => println!("{problem}"),
        Err(error) => panic!("{error}"),
    }
}

/// Port 1 is open again whatever the way up or down ends with.
#[test]
fn the_last_port_is_not_left_closed() {
    let loops = |segment: &Segment| {
        segment.devices().iter().map(|d| d.esc.register(register::DL_CONTROL) >> 8 & 0xFF).collect()
    };
    type Change = fn(&mut Setup);
    let unwell: [(&str, Change); 3] = [
        ("SII", |setup| setup.config.devices[2].identity = Some((1, 2))),
        ("plan", |setup| setup.config.shift = Some(Nanos::ZERO)),
        // Between two pieces of the way.
        ("phase", |setup| {
            let more = (Nanos(100_000), Nanos(900_000));
            setup.config.timeouts.phase = Nanos::millis(1_000);
            setup.host.hold_ups = Some(Delay { mean: Nanos(200_000), one_of: 2, more });
        }),
    ];
    for (name, break_it) in unwell {
        let scenario = Scenario::from(SegmentFile::parse("ring.toml", LINE).expect("it reads"));
        let mut setup = scenario.run().setup;
        with_ring(&mut setup);
        break_it(&mut setup);
        let mut world = World::new(setup, Motion::default(), None::<NoTap>);
        close(world.segment_mut());
        let mut was_closed = false;
        let error = loop {
            match world.poll_event() {
                Some(Event::Failed(error)) => break error,
                Some(_) => {}
                None => assert!(world.step(Time::new(90_000_000_000_000)), "{name} does not fail"),
            }
            let loops: Vec<u32> = loops(world.segment());
            was_closed |= loops == [0, 0, 0, 0b1100];
        };
        println!("{error}");
        assert_eq!(error.stage.name(), name);
        assert!(was_closed, "it was a line before {error}");
        // Until the last frame is through.
        while world.step(world.now() + MS) {}
        let loops: Vec<u32> = loops(world.segment());
        assert_eq!(loops, [0; 4], "{error}");
    }
    // And in operation, whole or cut, and when it ends.
    for cut in [false, true] {
        let mut field = ring();
        let all: Vec<u32> = loops(field.world.segment());
        assert_eq!(all, [0; 4]);
        if cut {
            let at = field.soon();
            field.world.segment_mut().unplug(2, at);
            field.run(20);
        }
        field.world.main_mut().stop();
        field.until(5_000, |event| matches!(event, Event::Stopped));
        for device in 0..4 {
            assert_eq!(field.state(device), AlState::Init);
        }
    }
}

#[test]
fn after_start_up_a_whole_ring_allocates_nothing() {
    let scenario = Scenario::from(SegmentFile::parse("ring.toml", LINE).expect("it reads"));
    let mut setup = scenario.run().setup;
    with_ring(&mut setup);
    let mut world = World::new(setup, Motion::default(), None::<NoTap>);
    close(world.segment_mut());
    while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
        assert!(world.step(Time::new(20_000_000_000_000)), "the ring does not come up");
    }
    let run = |world: &mut World<Motion, NoTap>, milliseconds: i64| {
        let end = world.now() + Picos(milliseconds * MS.0);
        while world.step(end) {
            while world.poll_event().is_some() {}
        }
    };
    run(&mut world, 50);
    let cycles = world.main().statistics().cycles;
    let allocations = allocation_counter::measure(|| run(&mut world, 100));
    assert_eq!(world.main().statistics().cycles - cycles, 100);
    assert_eq!(allocations.count_total, 0, "{allocations:?}");
}
