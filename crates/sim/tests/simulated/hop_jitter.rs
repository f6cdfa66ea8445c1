//! The jitter of hops: both ways of computing a frame give the same times, the jitter is within the
//! bounds of the ports, and it can be switched off.

#[path = "../../examples/hop_jitter/spread.rs"]
mod spread;

use crate::support::*;
use PortNumber::*;
use isocat_esc::{Chip, ET1100, ET1200};
use isocat_sim::{BitError, Cable, ClockModel, Connection, Direction, MainPort, Segment};
use isocat_wire::datagram::Address;
use isocat_wire::register;
use isocat_wire::time::{Picos, Time};
use isocat_wire::{Command, PortNumber, StationAddress};
use spread::{Course, Spread, spread};

/// EBUS at every port.
static EBUS: Chip = Chip { port_descriptor: 0xAA, dl_control: 0x0007_0001, ..ET1100 };

/// A tree: a line of three, a branch at the second, the fourth swapped; clocks deviate by some ppm.
const TREE: [Link; 6] = [
    (None, P0),
    (Some((0, P1)), P0),
    (Some((1, P1)), P0),
    (Some((1, P2)), P0),
    (Some((3, P3)), P1),
    (Some((4, P0)), P0),
];

fn jittering(links: &[Link], chip: &'static Chip, hop_jitter: bool, seed: u64) -> Segment {
    let connection = |(number, (parent, port)): (usize, &Link)| {
        let clock = ClockModel::constant([0, 13_300, -7_100, 21_900, -17_700, 4_400][number % 6]);
        let local = Time::new(number as u64 * 0x1234_5677);
        let device = device(chip, clock, local);
        Connection { port: *port, hop_jitter, ..Connection::new(*parent, cable(number), device) }
    };
    Segment::new(links.iter().enumerate().map(connection).collect(), seed)
}

/// Frames that meet a change are followed port by port, with the same results as on the computed
/// way.
#[test]
fn both_ways_of_a_frame_give_the_same_times() {
    let mut computed = jittering(&TREE, &WIDE, true, 5);
    let mut followed = jittering(&TREE, &WIDE, true, 5);
    // An error on a cable that does not exist is never used up.
    followed.disturb(BitError { cable: 99, direction: Direction::Out, at: micros(1), bit: 0 });
    let mut seen = Vec::new();
    for number in 0..300 {
        let at = Time::new(2_000_000_000 + number * 331_234_567);
        let write = (Command::Bwr, Address::Broadcast(0x0900), &[0; 4][..]);
        let fates = [&mut computed, &mut followed]
            .map(|segment| send_from(segment, MainPort::Primary, at, write));
        assert_eq!(fates[0], fates[1], "frame {number}");
        for device in 0..TREE.len() {
            let times = [&computed, &followed].map(|segment| receive_times(segment, device));
            assert_eq!(times[0], times[1], "frame {number}, SubDevice {device}");
        }
        seen.push(fates[0].1.unwrap().last_bit - at);
    }
    let spread = *seen.iter().max().unwrap() - *seen.iter().min().unwrap();
    assert!((40_000..400_000).contains(&spread.0), "ten hops there and back: {spread:?}");
}

/// Spread of the round trips to the second SubDevice, ns.
fn spread_of_rounds(chip: &'static Chip, dl_control: Option<u32>) -> (u32, u32) {
    let mut segment = jittering(&TREE[..2], chip, true, 3);
    if let Some(control) = dl_control {
        for position in 0..2 {
            let bytes = control.to_le_bytes();
            write(&mut segment, micros(100 + u64::from(position) * 100), position, 0x0100, &bytes);
        }
    }
    let rounds = (0..400).map(|number| {
        latch(&mut segment, MainPort::Primary, Time::new(2_000_000_000 + number * 331_234_567));
        let times = receive_times(&segment, 0);
        times[1].wrapping_sub(times[0])
    });
    let rounds: Vec<u32> = rounds.collect();
    (*rounds.iter().min().unwrap(), *rounds.iter().max().unwrap())
}

/// Both stamps are on the edges of one clock: a loop is one of two multiples of its period, to a
/// tick.
#[test]
fn a_loop_varies_by_a_period_of_its_ports() {
    let (least, most) = spread_of_rounds(&WIDE, None);
    assert!((40..=50).contains(&(most - least)), "MII: {least} to {most}");
    let (least, most) = spread_of_rounds(&EBUS, None);
    assert!((10..=20).contains(&(most - least)), "EBUS: {least} to {most}");
    let (least, most) = spread_of_rounds(&EBUS, Some(EBUS.dl_control | 1 << 19));
    assert!(most - least <= 10, "low jitter: {least} to {most}");
}

/// 0x0100 bits 18:16: the loop becomes shorter by the reduction of the FIFOs at both of its ends.
#[test]
fn smaller_fifos_make_loops_shorter() {
    let middle = |chip, size: u32| {
        let (least, most) = spread_of_rounds(chip, Some(0x0000_0001 | size << 16));
        (least + most) / 2
    };
    let [whole, none] = [7, 0].map(|size| middle(&WIDE, size));
    assert!((whole - none).abs_diff(80) <= 20, "MII: {whole} and {none}");
    assert!(middle(&WIDE, 4).abs_diff(whole) <= 20);
    let [whole, small, none] = [7, 2, 0].map(|size| middle(&EBUS, size));
    assert!((whole - none).abs_diff(100) <= 10, "EBUS: {whole} and {none}");
    assert!((whole - small).abs_diff(60) <= 10, "EBUS: {whole} and {small}");
}

/// Without jitter every frame takes the same time, with any setting of the FIFOs; with jitter this
/// is the mean.
#[test]
fn without_jitter_nothing_varies() {
    let mut still = jittering(&TREE, &WIDE, false, 5);
    let mut moving = jittering(&TREE, &WIDE, true, 5);
    let trip = |segment: &mut Segment, number: u64| {
        let at = Time::new(3_000_000_000 + number * 331_234_567);
        let write = (Command::Bwr, Address::Broadcast(0x0900), &[0; 4][..]);
        (send_from(segment, MainPort::Primary, at, write).1.unwrap().first_bit - at).0
    };
    let first = trip(&mut still, 0);
    assert!((1..100).all(|number| trip(&mut still, number) == first));
    let control = (WIDE.dl_control & !(7 << 16)).to_le_bytes();
    write(&mut still, micros(50_000_000), 1, 0x0100, &control);
    assert_eq!(trip(&mut still, 200_000), first);
    let trips: Vec<i64> = (0..2_000).map(|number| trip(&mut moving, number)).collect();
    let mean = trips.iter().sum::<i64>() / 2_000;
    assert!((mean - first).abs() < 6_000, "{mean} and {first} ps");
    let other = jittering(&TREE, &WIDE, true, 6);
    let mut again = jittering(&TREE, &WIDE, true, 5);
    assert!((0..50).all(|number| trip(&mut again, number) == trips[number as usize]), "one seed");
    let mut other = other;
    assert!((0..50).any(|number| trip(&mut other, number) != trips[number as usize]));
}

/// An ET1200 at the end of a line is behind an MII port of an ET1100: the kind of each port
/// decides, not the chip.
#[test]
fn each_port_has_its_own_period() {
    let links = line(2);
    let chips = [&ET1100, &ET1200];
    let connections = links.iter().zip(chips).enumerate().map(|(number, ((parent, _), chip))| {
        let clock = ClockModel::constant([0, 13_300][number]);
        let device = device(chip, clock, Time::ZERO);
        Connection::new(*parent, Cable::of_length(300), device)
    });
    let mut segment = Segment::new(connections.collect(), 1);
    let mut delays = Vec::new();
    for number in 0..200 {
        latch(&mut segment, MainPort::Primary, Time::new(1_000_000_000 + number * 331_234_567));
        let arrivals = [0, 1].map(|device| arrival(&segment, MainPort::Primary, device, P0));
        delays.push(arrivals);
    }
    let spread = |of: &dyn Fn(&[Picos; 2]) -> Picos| {
        let all = delays.iter().map(of);
        all.clone().max().unwrap() - all.min().unwrap()
    };
    assert!((37_000..=40_000).contains(&spread(&|two| two[0]).0), "by MII from the MainDevice");
    assert!((9_000..=10_000).contains(&spread(&|two| two[1] - two[0]).0), "by EBUS");
}

const SHORT: Course =
    Course { devices: 51, hop_jitter: true, settling: [15_000, 4_000], cycles: 2_000 };

/// 0x092C shows the sum of the waits on the way, 40 ns / sqrt(12) each, after its filter, and SYNC0
/// little of it; a smaller value would be too good.
fn check(found: &[Spread]) {
    for one in found {
        let expected = 11.5 * (one.hops as f64).sqrt();
        let [_, deviation, worst] = one.difference_ns();
        // A mean of first order over 16.
        let shown = expected / 31f64.sqrt();
        assert!((0.4 * shown..4.0 * shown + 3.0).contains(&deviation), "{one:?}");
        assert!((1.5 * deviation..8.0 * deviation).contains(&worst), "{one:?}");
        assert!(one.sync0.count() > 0);
        let [mean, deviation, worst] = one.sync0_ns();
        assert!(mean.abs() < 10.0 + 0.5 * expected, "{one:?}");
        assert!((2.5..3.0 + 0.5 * expected).contains(&deviation), "{one:?}");
        assert!((10.0..40.0 + 2.0 * expected).contains(&worst), "{one:?}");
    }
}

#[test]
fn sync0_and_092c_along_a_line_of_50() {
    let hops = [1, 10, 50];
    let jittering = spread(&SHORT, &hops);
    check(&jittering);
    for (still, jittering) in
        spread(&Course { hop_jitter: false, ..SHORT }, &hops).iter().zip(&jittering)
    {
        let [_, deviation, worst] = still.difference_ns();
        assert!((0.3..3.0).contains(&deviation) && worst < 20.0, "only ticks: {still:?}");
        assert!(deviation < jittering.difference_ns()[1]);
    }
}

#[test]
fn sync0_and_092c_along_a_line_of_300() {
    let course = Course { devices: 301, settling: [15_000, 5_000], cycles: 1_000, ..SHORT };
    check(&spread(&course, &[1, 10, 50, 300]));
}

/// A receive time of the fifth SubDevice does not depend on the other addressed SubDevices.
#[test]
fn frames_for_one_are_in_time_as_frames_for_all() {
    let links = line(6);
    let [mut one, mut all] = [(); 2].map(|()| jittering(&links, &WIDE, true, 8));
    let device = 4;
    for segment in [&mut one, &mut all] {
        write(segment, micros(100), device as u16, 0x0010, &[0x05, 0x10]);
    }
    for number in 0..50 {
        let at = Time::new(1_000_000_000 + number * 331_234_567);
        let alone = (Command::Fpwr, Address::Station(StationAddress(0x1005), 0x0900), &[0; 4][..]);
        assert_eq!(send_from(&mut one, MainPort::Primary, at, alone).0, 1);
        latch(&mut all, MainPort::Primary, at);
        assert_eq!(receive_times(&one, device), receive_times(&all, device));
        let entry =
            |segment: &Segment| segment.devices()[device].esc.register(register::RECEIVE_TIME_EPU);
        assert_eq!(entry(&one), entry(&all));
    }
}
