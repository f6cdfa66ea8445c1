//! A segment that changes while it runs: power lost and back, cables pulled and plugged, another
//! device in the place of one, a reference clock that is gone. Judged in true time: those that go
//! on are not disturbed, those that come back are on the grid that they had.

use crate::field::*;
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::segment::DcCapability;
use isocat_maindevice::{Cause, Event, Recovery};
use isocat_sim::device::Device;
use isocat_sim::judge::Grid;
use isocat_sim::{BitError, Direction, Setup};
use isocat_sync::phase::{self, drive};
use isocat_wire::register::features;
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, sii};

#[test]
fn a_device_that_loses_its_power_is_back_on_its_grid() {
    let mut field = Field::up(LINE, |_| {});
    let off = field.soon();
    let on = off + Picos(200 * MS.0);
    field.world.segment_mut().power_off(3, off);
    field.world.segment_mut().power_on(3, on);
    field.run(250);
    assert_eq!(field.count(|event| matches!(event, Event::Lost { position: 3, .. })), 1);
    assert_eq!(field.count(|event| matches!(event, Event::Lost { .. })), 1);
    let lost = field.events.iter().find(|(_, event)| matches!(event, Event::Lost { .. }));
    let lost = lost.expect("it was lost").0;
    assert!(lost - off < Picos(5 * MS.0), "{:?} until it was noticed", lost - off);
    // From then on everything counts as it must.
    let wrong = field.world.main().statistics().working_counter_errors;
    field.run(100);
    assert_eq!(field.world.main().statistics().working_counter_errors, wrong);

    let back = field.until(60_000, readmitted(3));
    println!("lost after {} us", (lost - off).0 / 1_000_000);
    println!("in OP {} ms after its power was back", (back - on).0 / MS.0);
    assert!((back - on).0 / MS.0 < 3_000, "300 ms for the link, then the drift loop");
    field.run(500);
    assert_eq!(field.state(3), AlState::Op);
    let since = field.began;
    for device in [0, 1] {
        field.is_undisturbed(device, off);
        let (worst, edges) = field.worst_edge(device, since);
        println!("{device}: {worst} ps in {edges} edges");
        assert!(worst < 100_000 && edges > 500, "{device}: {worst} ps in {edges} edges");
    }
    field.is_undisturbed(2, off);
    let (worst, edges) = field.worst_edge(3, back);
    println!("3: {worst} ps in {edges} edges");
    assert!(worst < FRESH && edges > 400, "{worst} ps in {edges} edges");
    field.applies_in_op_only(3);
    field.broadcasts_only_latches();
    let kept = field.world.main().segment().devices[3].offset;
    assert_ne!(kept, 0, "another counter value needs another offset");
}

/// The cable between the first and the second is pulled: three devices are gone, all with their
/// power on.
#[test]
fn a_branch_that_is_cut_comes_back_whole() {
    let mut field = Field::up(LINE, |_| {});
    let pulled = field.soon();
    field.world.segment_mut().unplug(1, pulled);
    field.world.segment_mut().plug(1, pulled + Picos(700 * MS.0));
    field.run(900);
    let lost = |event: &Event| matches!(event, Event::Lost { .. });
    assert_eq!(field.count(lost), 3);
    // Their watchdog has taken them down.
    assert_ne!(field.state(1), AlState::Op);
    for position in 1..4 {
        if field.count(readmitted(position)) == 0 {
            field.until(60_000, readmitted(position));
        }
    }
    let back = field.world.now();
    println!("all back {} ms after the cable", (back - pulled).0 / MS.0 - 700);
    field.run(500);
    field.is_undisturbed(0, pulled);
    let (worst, _) = field.worst_edge(0, field.began);
    assert!(worst < 100_000, "{worst} ps");
    for device in [1, 3] {
        let (worst, edges) = field.worst_edge(device, back);
        println!("{device}: {worst} ps in {edges} edges");
        assert!(worst < FRESH && edges > 400, "{device}: {worst} ps in {edges} edges");
    }
    for device in 1..4 {
        assert_eq!(field.state(device), AlState::Op);
        field.applies_in_op_only(device);
    }
    assert_eq!(field.count(lost), 3, "nobody else");
    field.broadcasts_only_latches();
}

/// The way of frames to the other branch becomes shorter by 1.9 us, and longer again: its clocks
/// must not follow.
#[test]
fn the_other_branch_of_a_tree_goes_on() {
    let mut field = Field::up(TREE, |_| {});
    let names: Vec<_> =
        field.world.main().segment().devices.iter().map(|device| device.name.clone()).collect();
    let at = |name: &str| names.iter().position(|other| other == name).expect("it is there");
    let (left, right) = (at("left"), at("right"));
    let (first, second) = if left < right { (left, right) } else { (right, left) };
    let pulled = field.soon();
    field.world.segment_mut().unplug(first, pulled);
    field.world.segment_mut().plug(first, pulled + Picos(50 * MS.0));
    field.run(100);
    assert_eq!(field.count(|event| matches!(event, Event::Lost { .. })), 2);
    for position in [first, first + 1] {
        if field.count(readmitted(position)) == 0 {
            field.until(60_000, readmitted(position));
        }
    }
    let back = field.world.now();
    field.run(300);
    for device in [0, second, second + 1] {
        field.is_undisturbed(device, pulled);
    }
    for device in [second, second + 1] {
        let (worst, edges) = field.worst_edge(device, field.began);
        println!("{device}: {worst} ps in {edges} edges");
        assert!(worst < 100_000 && edges > 300, "{device}: {worst} ps");
    }
    for device in [first, first + 1] {
        let (worst, edges) = field.worst_edge(device, back);
        println!("{device}: {worst} ps in {edges} edges");
        assert!(worst < FRESH && edges > 200, "{device}: {worst} ps");
        field.applies_in_op_only(device);
    }
    field.broadcasts_only_latches();
}

/// Somebody puts another device in the place of one that was switched off; later the right one.
#[test]
fn another_device_is_named_and_left_alone() {
    let mut field = Field::up(LINE, |_| {});
    let other = |text: &str| {
        let scenario = Scenario::from(SegmentFile::parse("other.toml", text).expect("it reads"));
        let setup = scenario.run().setup.segment.remove(0).device;
        Device::new(3, setup, 99)
    };
    let off = field.soon();
    field.world.segment_mut().power_off(3, off);
    field.run(20);
    let io4 = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n";
    *field.world.segment_mut().device_mut(3) = other(io4);
    let on = field.soon();
    field.world.segment_mut().power_on(3, on);
    let refused = |event: &Event| matches!(event, Event::NotReadmitted { position: 3, .. });
    field.until(5_000, refused);
    let cause = field.told().into_iter().find_map(|event| match event {
        Event::NotReadmitted {
            cause: Cause::Identity { place, found, .. }, again: None, ..
        } => Some((place.name.clone(), *found)),
        _ => None,
    });
    let (name, found) = cause.unwrap_or_else(|| panic!("{:#?}", field.told()));
    println!("{name} {found:X?}");
    assert_eq!(found.0, 0x6973_6F63);
    field.run(5_000);
    assert_eq!(field.count(refused), 1, "it is asked once");
    let stranger = &field.world.segment().devices()[3];
    assert_eq!(stranger.stack.state(), AlState::Init);
    assert_eq!(stranger.esc.register(isocat_wire::register::STATION_ADDRESS), 0);
    for device in [0, 1, 2] {
        field.is_undisturbed(device, off);
    }
    // The right one again.
    let off = field.soon();
    field.world.segment_mut().power_off(3, off);
    field.run(20);
    let drive = LINE.replace("kollmorgen_akd2g", "hpmicro_ecat_cia402_ssc");
    *field.world.segment_mut().device_mut(3) = other(&drive);
    let on = field.soon();
    field.world.segment_mut().power_on(3, on);
    let back = field.until(60_000, readmitted(3));
    field.run(300);
    let (worst, edges) = field.worst_edge(3, back);
    assert!(worst < FRESH && edges > 200, "{worst} ps in {edges} edges");
}

/// A fork without a clock: the reference is the first of one branch.
fn without_clock_at_the_fork(setup: &mut Setup) {
    let mut image = setup.segment[0].device.sii.to_vec();
    image[1] = 0;
    let configuration = image[..14].first_chunk().expect("an EEPROM is longer");
    image[14] = sii::checksum(configuration);
    setup.segment[0].device.sii = image.into();
}

#[test]
fn another_clock_leads_when_the_reference_is_gone() {
    reference_lost(without_clock_at_the_fork, true);
}

/// The same with clocks of 32 bits, whose upper half only the MainDevice knows.
#[test]
fn another_clock_of_32_bits_leads_when_the_reference_is_gone() {
    let narrow = |setup: &mut Setup| {
        without_clock_at_the_fork(setup);
        for connection in &mut setup.segment[1..] {
            connection.device.chip.features &= !features::DC_64_BIT;
        }
    };
    let field = reference_lost(narrow, true);
    let clocks = field.world.main().segment().devices.iter().map(|device| device.dc);
    assert!(clocks.skip(1).all(|dc| dc == DcCapability::Clock32));
}

/// The same where the host leads the reference clock: whichever that is, and the SYNC grid is that
/// of the time as written.
#[test]
fn the_host_goes_on_to_lead_when_the_reference_is_gone() {
    let limits = drive::Limits::default();
    let led = |setup: &mut Setup| {
        without_clock_at_the_fork(setup);
        setup.config.direction = phase::Direction::DriveReference { limits };
    };
    let field = reference_lost(led, false);
    assert!(field.world.main().drive().is_some());
}

/// The reference of [`TREE`] loses its power, and gets it back. `by_leader`: the grid is judged in
/// the time of the oscillator that led.
fn reference_lost(change: impl FnOnce(&mut Setup), by_leader: bool) -> Field {
    let mut field = Field::up(TREE, change);
    let reference = field.world.main().segment().reference.expect("there are clocks");
    assert_eq!(reference, 1);
    // The time as it was, by the oscillator that led.
    let off = field.soon();
    let timing = field.world.main().segment().timing.clone().expect("it was planned");
    field.run(1);
    let segment = field.world.segment();
    let leader = segment.devices()[reference].oscillator().clone();
    let known = (off, segment.devices()[reference].system_time_ps(off));
    let sync0 = timing.sync0.expect("SYNC0 is in use");
    let error = |device: usize, at: Time<True>| {
        let count = |at| leader.read::<isocat_wire::time::Device>(at);
        let since = i128::from((count(at) - count(known.0)).0) * 1000;
        let phase = timing.devices[device].0.sync0_phase(sync0);
        Grid { cycle: Nanos(1_000_000), phase }.error(known.1 + since).0
    };
    let off = field.soon();
    field.world.segment_mut().power_off(reference, off);
    field.world.segment_mut().power_on(reference, off + Picos(3_000 * MS.0));
    field.run(2_000);
    let led = |event: &Event| matches!(event, Event::ReferenceElected { position: 3, .. });
    assert_eq!(
        (field.count(led), field.count(|e| matches!(e, Event::ReferenceLost { .. }))),
        (1, 1)
    );
    // Earliest and latest edge against the grid of the time that was.
    let spread = |field: &Field, device: usize, since: Time<True>| {
        let record = field.witness.0.borrow();
        let edges = record.devices[device].edges.iter().filter(|at| **at >= since);
        let errors: Vec<i64> = edges.map(|at| error(device, *at)).collect();
        let least = errors.iter().copied().min().expect("there are edges");
        (least, errors.iter().copied().max().expect("there are edges"), errors.len())
    };
    for device in [3, 4] {
        field.is_undisturbed(device, off);
        let (least, most, edges) = spread(&field, device, off);
        println!("{device} alone: {least} to {most} ps in {edges} edges");
        // Nothing but the rate that the new one has: what its drift loop did for the last tick of
        // 10 ns and the last frame's jitter of some 20 ns stays, up to 10 ppm.
        let near = least > -20_000_000 && most < 20_000_000;
        assert!(near || !by_leader, "{device}: {least} to {most} ps");
        assert!(edges.abs_diff(2_000) <= 2, "{device}: {edges} edges");
    }
    for position in [1, 2] {
        if field.count(readmitted(position)) == 0 {
            field.until(90_000, readmitted(position));
        }
    }
    let back = field.world.now();
    println!("all back {} ms after the power", (back - off).0 / MS.0 - 3_000);
    // What lies before the present reference can't be led by it: the old one leads again.
    assert_eq!(field.world.main().segment().reference, Some(reference));
    field.run(1_000);
    for device in [3, 4] {
        field.is_undisturbed(device, off);
        let (least, most, _) = spread(&field, device, off);
        let near = least > -20_000_000 && most < 20_000_000;
        assert!(near || !by_leader, "{device}: {least} to {most} ps");
    }
    let (mut least, mut most) = (i64::MAX, i64::MIN);
    for device in 1..5 {
        let (from, to, edges) = spread(&field, device, back);
        println!("{device} after: {from} to {to} ps in {edges} edges");
        (least, most) = (least.min(from), most.max(to));
        assert!(edges.abs_diff(1_000) <= 2, "{device}: {edges} edges");
        assert_eq!(field.state(device), AlState::Op);
        field.applies_in_op_only(device);
    }
    let together = most - least < 200_000;
    assert!(together || !by_leader, "all of them together: {} ps", most - least);
    // Those of one cycle, whatever time leads.
    assert!(apart(&field, back) < 200_000, "{} ps apart", apart(&field, back));
    field.broadcasts_only_latches();
    field
}

/// Farthest that the edges of one cycle lie apart, ps.
fn apart(field: &Field, since: Time<True>) -> i64 {
    let record = field.witness.0.borrow();
    let edges = |device: usize| {
        let all = record.devices[device].edges.iter().filter(move |at| **at >= since + MS);
        all.map(|at| at.count() as i64).collect::<Vec<_>>()
    };
    let first = edges(1);
    let nearest = |at: i64| first.iter().map(|one| at - one).min_by_key(|apart| apart.abs());
    let all = (2..5).flat_map(edges).filter_map(nearest);
    let near = all.filter(|apart| apart.abs() < CYCLE / 2);
    let (least, most) = near.fold((0, 0), |(a, b), apart| (apart.min(a), apart.max(b)));
    most - least
}

/// Frames do not reach the last three for longer than their watchdog.
fn starved(recovery: Recovery) -> (Field, Time<True>) {
    let text = LINE.replace("seed = 5", "seed = 5\nwatchdog = \"10ms\"");
    let mut field = Field::up(&text, |setup| setup.config.recovery = recovery);
    let from = field.soon();
    for number in 0..15 {
        let at = from + Picos(number * MS.0);
        let error = BitError { cable: 1, direction: Direction::Out, at, bit: 200 };
        field.world.segment_mut().disturb(error);
    }
    field.run(20);
    (field, from)
}

#[test]
fn a_device_that_fell_is_brought_back_by_policy() {
    let (mut field, _) = starved(Recovery::Never);
    field.run(2_000);
    for device in 1..4 {
        assert_eq!(field.state(device), AlState::SafeOp, "{:#?}", field.told());
    }
    assert_eq!(field.state(0), AlState::Op);
    assert_eq!(field.count(|event| matches!(event, Event::Recovering { .. })), 0);

    let back_off = Recovery::BackOff { first: Nanos::millis(100), longest: Nanos::millis(1_600) };
    for recovery in [Recovery::Once, back_off] {
        let (mut field, from) = starved(recovery);
        field.run(2_000);
        for device in 1..4 {
            assert_eq!(field.state(device), AlState::Op, "{device}, {recovery:?}");
            let code = field.told().into_iter().find_map(|event| match event {
                Event::Recovering { position, code, attempt: 1, .. } if *position == device => {
                    Some(*code)
                }
                _ => None,
            });
            assert!(code.is_some_and(|code| code != AlStatusCode::NO_ERROR), "{code:?}");
            let recovered = |event: &Event| matches!(event, Event::Recovered { position, .. } if *position == device);
            assert_eq!(field.count(recovered), 1);
            field.applies_in_op_only(device);
        }
        for device in [0, 1, 3] {
            let (worst, _) = field.worst_edge(device, from);
            assert!(worst < 100_000, "{device}: {worst} ps");
        }
        assert_eq!(field.count(|event| matches!(event, Event::Lost { .. })), 0);
        // It falls once more.
        let again = field.soon();
        for number in 0..15 {
            let at = again + Picos(number * MS.0);
            let error = BitError { cable: 3, direction: Direction::Out, at, bit: 200 };
            field.world.segment_mut().disturb(error);
        }
        field.run(4_000);
        let expected = if recovery == Recovery::Once { AlState::SafeOp } else { AlState::Op };
        assert_eq!(field.state(3), expected, "{recovery:?}");
        assert_eq!(field.state(0), AlState::Op);
    }
}

/// The pauses of the policy are times: they pass at every cycle, also where a hundred cycles last
/// longer than both.
#[test]
fn a_device_that_fell_is_brought_back_at_every_cycle() {
    let (first, longest) = (Nanos::millis(50), Nanos::millis(500));
    for cycle in [1, 2, 4, 10, 20] {
        let head = format!("cycle = \"{cycle}ms\"\nwatchdog = \"{}ms\"", 10 * cycle);
        let text = LINE.replace("cycle = \"1ms\"", &head);
        let mut field = Field::up(&text, |setup| {
            setup.config.recovery = Recovery::BackOff { first, longest };
        });
        let from = field.soon();
        for number in 0..15 {
            let at = from + Picos(number * cycle * MS.0);
            let error = BitError { cable: 1, direction: Direction::Out, at, bit: 200 };
            field.world.segment_mut().disturb(error);
        }
        field.run(20 * cycle + 2_000);
        for device in 1..4 {
            let at = |is: &dyn Fn(&Event) -> bool| {
                field.events.iter().find(|(_, event)| is(event)).map(|(at, _)| *at)
            };
            let fell = at(&|event| {
                matches!(event, Event::StateChanged { position, status, .. }
                    if *position == device && status.error())
            });
            let tried = at(
                &|event| matches!(event, Event::Recovering { position, .. } if *position == device),
            );
            let (Some(fell), Some(tried)) = (fell, tried) else {
                panic!("{cycle} ms: SubDevice {device} is not brought back: {:#?}", field.told());
            };
            let pause = (tried - fell).0 / 1_000_000;
            println!("{cycle} ms: SubDevice {device} tried {pause} us after its fall was seen");
            // The states are read in the share of the cycle that is left.
            let most = (first.0 + 3 * cycle * 1_000_000) / 1_000;
            assert!((first.0 / 1_000..most).contains(&pause), "{cycle} ms: {pause} us");
            assert_eq!(field.state(device), AlState::Op, "{cycle} ms: SubDevice {device}");
        }
        assert_eq!(field.state(0), AlState::Op);
        let lost = |event: &Event| matches!(event, Event::Lost { .. });
        assert_eq!(field.count(lost), 0, "{cycle} ms");
    }
}

/// One in the middle loses its power, and those behind it their cable; then the first of all, and
/// with it everything.
#[test]
fn whatever_is_behind_it_comes_back_with_it() {
    for (off_at, front) in [(1, 1), (0, 0)] {
        for seed in ["seed = 5", "seed = 11"] {
            let mut field = Field::up(&LINE.replace("seed = 5", seed), |_| {});
            let off = field.soon();
            field.world.segment_mut().power_off(off_at, off);
            field.world.segment_mut().power_on(off_at, off + Picos(100 * MS.0));
            field.run(500);
            for position in off_at..4 {
                if field.count(readmitted(position)) == 0 {
                    field.until(60_000, readmitted(position));
                }
            }
            println!("{off_at}: all back {} ms later", (field.world.now() - off).0 / MS.0);
            let back = field.world.now();
            field.run(500);
            for device in 0..front {
                field.is_undisturbed(device, off);
            }
            for device in [0, 1, 3] {
                let (worst, edges) = field.worst_edge(device, back);
                println!("{device}: {worst} ps in {edges} edges");
                assert!(worst < FRESH && edges > 400, "{worst} ps in {edges} edges");
            }
            for device in off_at..4 {
                assert_eq!(field.state(device), AlState::Op);
                field.applies_in_op_only(device);
            }
            field.broadcasts_only_latches();
        }
    }
}

/// The last two of [`LINE`] may be absent, and are at first.
fn with_a_group(arrives: &str) -> String {
    let optional = format!("optional = true\n    arrives = \"{arrives}\"\n    name = ");
    LINE.replace("name = \"third\"", &format!("{optional}\"third\""))
        .replace("name = \"fourth\"", &format!("{optional}\"fourth\""))
}

/// Hot connect: the segment runs without a group that it was planned with, and takes it up when it
/// comes, as often as it does.
#[test]
fn a_group_that_was_absent_is_taken_up_when_it_comes() {
    let mut field = Field::up(&with_a_group("20s"), |_| {});
    let found = field.world.main().segment();
    assert_eq!(
        found.devices.iter().map(|d| d.admitted).collect::<Vec<_>>(),
        [true, true, false, false]
    );
    let coming = Time::<True>::ZERO + Picos(20_000 * MS.0);
    assert!(field.world.now() < coming, "it is in operation before they come");
    assert_eq!(field.world.main().statistics().working_counter_errors, 0);
    field.run(1_000);
    assert_eq!(field.told(), Vec::<&Event>::new());
    for position in [2, 3] {
        if field.count(readmitted(position)) == 0 {
            field.until(60_000, readmitted(position));
        }
    }
    let back = field.world.now();
    println!("in OP {} ms after their power came", (back - coming).0 / MS.0);
    assert!((back - coming).0 / MS.0 < 3_000);
    field.run(500);
    assert_eq!(field.count(|event| matches!(event, Event::Lost { .. })), 0);
    for device in [0, 1] {
        field.is_undisturbed(device, field.began);
        let (worst, edges) = field.worst_edge(device, field.began);
        println!("{device}: {worst} ps in {edges} edges");
        assert!(worst < 100_000 && edges > 500, "{device}: {worst} ps in {edges} edges");
    }
    for device in [2, 3] {
        assert_eq!(field.state(device), AlState::Op);
        field.applies_in_op_only(device);
    }
    let (worst, edges) = field.worst_edge(3, back);
    println!("3: {worst} ps in {edges} edges");
    assert!(worst < FRESH && edges > 400, "{worst} ps in {edges} edges");
    field.broadcasts_only_latches();
    // Gone and back once more.
    let pulled = field.soon();
    field.world.segment_mut().unplug(2, pulled);
    field.world.segment_mut().plug(2, pulled + Picos(300 * MS.0));
    let before = field.count(readmitted(3));
    field.run(400);
    while field.count(readmitted(3)) == before {
        field.until(60_000, readmitted(3));
    }
    field.run(100);
    field.is_undisturbed(1, pulled);
    assert_eq!((field.state(2), field.state(3)), (AlState::Op, AlState::Op));
}

/// Planned with what its description says, and another comes; then one whose times do not fit the
/// plan.
#[test]
fn a_group_that_is_not_as_known_is_refused_by_name() {
    let slow = "calc_copy = \"400us\"\n    name = \"fourth\"";
    let text = with_a_group("5s").replace("name = \"fourth\"", slow);
    let mut field = Field::up(&text, |setup| {
        setup.config.shift = Some(Nanos::micros(200));
        let known = setup.config.devices[3].hot_connect.as_mut().expect("it is optional");
        let sync = known.output_sync.as_mut().expect("a drive has 0x1C32");
        // Less than it needs: the plan is made for a faster device.
        sync.values.set(6, 1_000);
        known.input_sync.as_mut().expect("and 0x1C33").values.set(6, 1_000);
    });
    let refused = |event: &Event| matches!(event, Event::NotReadmitted { position: 3, .. });
    field.until(60_000, refused);
    let cause = field.events.iter().rev().find_map(|(_, event)| match event {
        Event::NotReadmitted { position: 3, cause, .. } => Some(cause.clone()),
        _ => None,
    });
    let cause = cause.expect("it was refused");
    assert!(matches!(cause, Cause::Plan { .. }), "{cause}");
    println!("{cause}");
    assert_ne!(field.state(3), AlState::Op);
    if field.count(readmitted(2)) == 0 {
        field.until(60_000, readmitted(2));
    }
    field.run(50);
    field.is_undisturbed(1, field.began);
}
