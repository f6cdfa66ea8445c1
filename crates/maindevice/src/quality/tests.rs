use alloc::vec;

use isocat_sync::delay::Delay;
use isocat_wire::StationAddress;
use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::register::Value;
use isocat_wire::time::Picos;

use super::*;
use crate::segment::{DcCapability, SubDevice, SyncEntry, SyncObject};

const LIMIT: Nanos = Nanos(100);

fn config() -> QualityWatch {
    QualityWatch {
        share_permille: 10,
        history: 20,
        unled_cycles: 3,
        difference_limit: LIMIT,
        ..QualityWatch::default()
    }
}

fn monitor(clocks: usize) -> Monitor {
    let device = |position: usize| {
        let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
        device.dc = DcCapability::Clock64;
        let (standard_error, systematic) = (Picos(1_000), Picos(5_000));
        device.measured_delay = Some(Delay::Known { delay: Picos(0), standard_error, systematic });
        device
    };
    let devices = (0..=clocks).map(device).collect();
    let segment = Segment { devices, reference: Some(0), ..Segment::default() };
    Monitor::new(config(), &segment, Time::ZERO, 0, &Statistics::default(), &[])
}

fn clocks_to_read(monitor: &mut Monitor, now: Time<Host>) -> Vec<Wanted> {
    let mut wanted = Vec::new();
    let cycle = now.count() / 100_000;
    if monitor.has_clocks_to_read(now, cycle) {
        monitor.clocks_to_read(now, cycle, usize::MAX, &mut wanted, &mut Vec::new());
    }
    wanted
}

fn registers(at: u64, difference: i64) -> Option<Registers> {
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(
        &SystemTimeDifference::from_nanos(Nanos(difference), DifferencePolarity::default())
            .to_bytes(),
    );
    bytes[4..6].copy_from_slice(&0x1000_u16.to_le_bytes());
    Some(Registers { at: Time::new(at), bytes, activation: None })
}

/// Tests both sides of the limit, of the number of readings, and of the limit that ends the alarm.
#[test]
fn alarms_come_and_go_late() {
    let mut monitor = monitor(1);
    let mut at = 0;
    let mut read = |monitor: &mut Monitor, difference| {
        at += 1_000_000_000;
        monitor.take_clock(0, registers(at, difference))
    };
    for _ in 0..10 {
        assert_eq!(read(&mut monitor, 100), [], "at the limit");
    }
    assert_eq!(read(&mut monitor, -101), []);
    assert_eq!(read(&mut monitor, -101), []);
    assert_eq!(read(&mut monitor, 100), [], "the row is broken");
    assert_eq!(read(&mut monitor, -101), []);
    assert_eq!(read(&mut monitor, -101), []);
    let raised = read(&mut monitor, -101);
    assert_eq!((raised.len(), raised[0].alarm, raised[0].raised), (1, Alarm::Difference, true));
    let Found::Clock { difference, .. } = raised[0].found else { panic!("{raised:?}") };
    assert_eq!((raised[0].position, difference), (1, Nanos(-101)));
    for _ in 0..20 {
        assert_eq!(read(&mut monitor, 51), [], "not well within");
    }
    for _ in 0..7 {
        assert_eq!(read(&mut monitor, 50), []);
    }
    let gone = read(&mut monitor, 50);
    assert_eq!((gone.len(), gone[0].alarm, gone[0].raised), (1, Alarm::Difference, false));
    assert!(!monitor.clocks()[0].has(Alarm::Difference));
}

#[test]
fn clocks_without_guidance() {
    let mut monitor = monitor(1);
    assert_eq!([0, 1, 2].map(|cycles| monitor.guidance(cycles)), [None; 3]);
    assert_eq!([3, 4, 500].map(|cycles| monitor.guidance(cycles)), [Some(3), None, None]);
    assert_eq!([0, 1].map(|cycles| monitor.guidance(cycles)), [Some(0), None]);
}

#[test]
fn a_clock_that_slides_and_one_that_is_silent() {
    let mut monitor = monitor(1);
    let mut changes = Vec::new();
    // 3 ns every millisecond: 3000 ppb.
    for i in 0..20 {
        changes.extend(monitor.take_clock(0, registers(i * 1_000_000, i as i64 * 3 - 30)));
    }
    assert_eq!((changes.len(), changes[0].alarm), (1, Alarm::Sliding), "{changes:?}");
    let Found::Clock { slope_ppb, .. } = changes[0].found else { panic!("{changes:?}") };
    assert!((slope_ppb - 3_000).abs() < 10, "{changes:?}");
    assert_eq!(monitor.take_clock(0, None), []);
    assert_eq!(monitor.take_clock(0, None), []);
    assert_eq!(monitor.take_clock(0, None)[0].alarm, Alarm::Silent);
}

/// The oldest readings are dropped, and the bound uses the remaining ones.
#[test]
fn the_last_readings_and_their_bound() {
    let mut monitor = monitor(1);
    assert_eq!(monitor.clocks()[0].bound(), None);
    monitor.take_clock(0, registers(0, 77));
    // The tick of either clock; 5 ns and 1.96 times 1 ns for the delay.
    assert_eq!(monitor.clocks()[0].bound(), Some(Nanos(77 + 20 + 7)));
    for i in 1..=20 {
        monitor.take_clock(0, registers(i * 1_000_000, 30));
    }
    let clock = &monitor.clocks()[0];
    let at: Vec<u64> = clock.readings().map(|reading| reading.at.count()).collect();
    assert_eq!((at.len(), at[0], at[19]), (20, 1_000_000, 20_000_000));
    assert_eq!((clock.worst(), clock.slope_ppb()), (Nanos(30), 0));
    assert_eq!(clock.bound(), Some(Nanos(30 + 20 + 7)));
}

/// 20 clocks are read in turn, and never take more of the wire than the share.
#[test]
fn reads_within_its_share() {
    let mut monitor = monitor(20);
    let (mut now, mut seen) = (Time::new(0), [0; 20]);
    let end = 100_000_000;
    while now.count() < end {
        // Cycles of 100 us.
        if monitor.is_due(now, now.count() / 100_000, None) {
            for (at, station, _) in clocks_to_read(&mut monitor, now) {
                assert_eq!(station, StationAddress(0x1002 + at as u16));
                seen[at] += 1;
            }
        }
        now += Nanos(1_000);
    }
    let share = monitor.spent().0 as f64 / end as f64;
    assert!((0.0097..=0.0103).contains(&share), "{share}");
    assert!(seen.iter().max().unwrap() - seen.iter().min().unwrap() <= 1, "{seen:?}");
}

/// On a long line a frame holds at most 32 clocks, or as many as it has room for. However long the
/// cycle is, eight of them are read in it on average, and never fewer than the others.
#[test]
fn reads_of_a_long_line() {
    let batches = |clocks: usize, octets: usize| {
        let mut monitor = monitor(clocks);
        let mut seen = vec![0; clocks];
        let mut batches = Vec::new();
        for cycle in 0..1_000 {
            let (now, mut wanted) = (Time::new(cycle * 4_000_000), Vec::new());
            if monitor.has_clocks_to_read(now, cycle) {
                monitor.clocks_to_read(now, cycle, octets, &mut wanted, &mut Vec::new());
            }
            wanted.iter().for_each(|(at, ..)| seen[*at] += 1);
            batches.extend((!wanted.is_empty()).then_some((cycle, wanted.len())));
        }
        assert!(seen.iter().max().unwrap() - seen.iter().min().unwrap() <= 1, "{seen:?}");
        (batches, seen.iter().sum::<usize>())
    };
    let (all, count) = batches(100, usize::MAX);
    assert_eq!(all[..3], [(0, 32), (4, 32), (8, 32)]);
    assert_eq!(count, 8_000);
    let (all, count) = batches(20, usize::MAX);
    assert_eq!(all[..4], [(0, 20), (3, 20), (5, 20), (8, 20)]);
    assert!((7_980..=8_020).contains(&count), "{count}");
    // Eight and fewer are read in each cycle.
    assert_eq!(batches(7, usize::MAX).1, 7_000);
    // Headers of 16 bytes, and 20 for each clock.
    assert_eq!(batches(100, 16 + 5 * 20 + 19).0[..2], [(0, 5), (1, 5)]);
    assert_eq!(batches(100, 0).0[..2], [(0, 1), (1, 1)], "one always");
}

/// The difference is three times the limit: a clock that approaches converges, one at rest or
/// moving away does not. The border is tested by one ppb.
#[test]
fn a_clock_that_stays_off() {
    let alarms = |slope_ppb: i64| {
        let mut monitor = monitor(1);
        let mut changes = Vec::new();
        for i in 0..25_i64 {
            // With a reading each second the slope in ppb is exact.
            let difference = -(1_000_000 + slope_ppb * i);
            changes.extend(monitor.take_clock(0, registers(i as u64 * 1_000_000_000, difference)));
        }
        changes.retain(|change| change.alarm == Alarm::NotConverging);
        changes
    };
    for slope_ppb in [3_000, 0, -1_000] {
        let changes = alarms(slope_ppb);
        assert!(matches!(changes[..], [Change { raised: true, .. }]), "{slope_ppb}: {changes:?}");
        assert_eq!(
            changes[0].found,
            Found::Clock { difference: Nanos(-1_000_000 - 17 * slope_ppb), slope_ppb: -slope_ppb }
        );
    }
    assert_eq!(alarms(-1_001), []);
    assert_eq!(alarms(-30_000), []);
}

/// Clocks and objects have half of the share each; a single kind has all of it.
#[test]
fn halves_of_the_share() {
    let device = |position: usize, with_objects: bool| {
        let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
        device.dc = DcCapability::Clock64;
        if with_objects {
            let header = &mut device.sii.header;
            header.protocols = isocat_wire::sii::Header::COE;
            (header.receive.length, header.send.length) = (128, 128);
            let entry = |sub| SyncEntry { sub, description: None, value: Ok(vec![0, 0]) };
            let entries = vec![entry(0x0B), entry(0x0C)];
            device.output_sync = Some(SyncObject { entries, ..SyncObject::default() });
        }
        device
    };
    let cost = Nanos(50_000);
    let shares = |clocks: bool, objects: bool| {
        let devices = (0..3).map(|position| device(position, objects)).collect();
        let reference = clocks.then_some(0);
        let segment = Segment { devices, reference, ..Segment::default() };
        let mut monitor =
            Monitor::new(config(), &segment, Time::ZERO, 0, &Statistics::default(), &[]);
        let (mut now, mut asked) = (Time::new(0), 0);
        while now.count() < 1_000_000_000 {
            clocks_to_read(&mut monitor, now);
            if let Some(wanted) = monitor.entry_to_read(now, |_| true) {
                asked += 1;
                monitor.take_entry(wanted, now, &Ok(vec![0, 0]), cost, true);
            }
            now += Nanos(10_000);
        }
        let objects = cost.0 * asked;
        [monitor.spent().0 - objects, objects].map(|spent| spent as f64 / 1e9 * 1e3)
    };
    let near = |found: [f64; 2], expected: [f64; 2]| {
        let off = found.iter().zip(expected).map(|(found, expected)| (found - expected).abs());
        assert!(off.fold(0.0, f64::max) < 0.1, "{found:?}, expected {expected:?}");
    };
    near(shares(true, true), [5.0, 5.0]);
    near(shares(true, false), [10.0, 0.0]);
    near(shares(false, true), [0.0, 10.0]);
}

/// A SubDevice that is absent at the start is not asked until it comes.
#[test]
fn one_that_is_awaited() {
    let device = |position: usize| {
        let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
        device.dc = DcCapability::Clock64;
        device
    };
    let mut segment =
        Segment { devices: (0..4).map(device).collect(), reference: Some(0), ..Segment::default() };
    segment.devices[2].admitted = false;
    let mut monitor = Monitor::new(config(), &segment, Time::ZERO, 0, &Statistics::default(), &[]);
    let asked = |monitor: &mut Monitor, at: u64| {
        let wanted = clocks_to_read(monitor, Time::new(at));
        wanted.iter().map(|(_, station, _)| station.0 - 0x1001).collect::<Vec<_>>()
    };
    assert_eq!(asked(&mut monitor, 0), [1, 3]);
    assert_eq!(asked(&mut monitor, 1_000_000_000), [1, 3]);
    segment.devices[2].admitted = true;
    segment.devices[2].station = StationAddress(0x1001 + 7);
    segment.devices[2].al_status = isocat_wire::al::AlStatus(8);
    monitor.states_changed();
    monitor.record.take_states(Time::new(5), &segment, |device| monitor.background.meet(device));
    assert_eq!(monitor.record.devices[2].since, Time::new(5));
    assert_eq!(asked(&mut monitor, 2_000_000_000), [1, 7, 3]);
}
