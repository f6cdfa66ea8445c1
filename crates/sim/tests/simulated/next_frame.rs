//! Receive times of an ET1200, whose ports stamp the next frame: they are right if no frame is in
//! flight behind it, and those of an earlier frame otherwise.

use crate::support::{WIDE, arrival, count, latch, micros, receive_times, segment, send_from};
use isocat_esc::{Chip, ET1200, LAN9252};
use isocat_maindevice::{DelayWatch, Event};
use isocat_sim::{MainPort, Segment};
use isocat_wire::time::{Picos, Time};
use isocat_wire::{Nanos, PortNumber};

/// An ET1200 with the ports of the other chips.
static NEXT: Chip = Chip { name: "next", stamps_next_frame: true, ..WIDE };

/// So many SubDevices that a frame is back long after the next one may have left.
const COUNT: usize = 40;
/// A frame of 60 bytes with its gap lasts 6.72 us.
const SPACING: u64 = 7;

/// A line in which the first SubDevice stamps the next frame.
fn one_of(chip: &'static Chip) -> Segment {
    segment(&crate::support::line(COUNT), |device| if device == 0 { chip } else { &WIDE })
}

/// Time from port 0 to port 1, ns.
fn round_trip(segment: &Segment, device: usize) -> i64 {
    let [port_0, port_1, ..] = receive_times(segment, device);
    i64::from(port_1.wrapping_sub(port_0) as i32)
}

/// The same by the path of frames.
fn true_round_trip(segment: &Segment, device: usize) -> i64 {
    let at = |port| arrival(segment, MainPort::Primary, device, port);
    (at(PortNumber::P1) - at(PortNumber::P0)).0 / 1_000
}

/// Two ticks may be missing.
fn assert_about(found: i64, expected: i64) {
    assert!((found - expected).abs() <= 10, "{found} ns, not {expected} ns");
}

#[test]
fn an_et1200_does() {
    assert!(ET1200.stamps_next_frame && !WIDE.stamps_next_frame);
}

/// Without other frames in flight a chip of this kind has the same times as any other.
#[test]
fn with_an_empty_segment_it_is_right() {
    for chip in [&WIDE, &NEXT] {
        let mut segment = one_of(chip);
        let mut at = 10_000;
        for pause in [1_000, 300, 100] {
            count(&mut segment, micros(at)).expect("it comes back");
            at += pause;
            assert_eq!(latch(&mut segment, MainPort::Primary, micros(at)), COUNT as u16);
            let expected = true_round_trip(&segment, 0);
            assert!((40_000..80_000).contains(&expected), "{expected} ns");
            assert_about(round_trip(&segment, 0), expected);
            at += 1_000;
        }
    }
}

/// The trap: the previous frame is still in flight, and its return is taken for that of the latch.
/// The round trip is then too short by the time between the frames.
#[test]
fn a_frame_under_way_spoils_it() {
    for (chip, frames) in [(&NEXT, 1), (&NEXT, 3), (&WIDE, 3)] {
        let mut segment = one_of(chip);
        count(&mut segment, micros(1_000)).expect("it comes back");
        for number in 0..frames {
            count(&mut segment, micros(2_000 + number * SPACING)).expect("it comes back");
        }
        latch(&mut segment, MainPort::Primary, micros(2_000 + frames * SPACING));
        let early = match chip.stamps_next_frame {
            // The oldest of them comes back first.
            true => frames as i64 * SPACING as i64 * 1_000,
            false => 0,
        };
        let expected = true_round_trip(&segment, 0);
        assert_about(round_trip(&segment, 0), expected - early);
        // The SubDevice behind it recognizes the frame.
        assert_about(round_trip(&segment, 1), true_round_trip(&segment, 1));
    }
}

/// The edge: a frame that begins at port 1 just when the latch begins at port 0 is stamped; one
/// that began a ns earlier is not, and the times are right.
#[test]
fn a_frame_that_is_coming_back_already_does_no_harm() {
    let mut reference = one_of(&NEXT);
    count(&mut reference, micros(1_000)).expect("it comes back");
    let whole = arrival(&reference, MainPort::Primary, 0, PortNumber::P1)
        - arrival(&reference, MainPort::Primary, 0, PortNumber::P0);
    for (apart, spoilt) in [(whole, true), (whole + Picos(1_000), false)] {
        let mut segment = one_of(&NEXT);
        count(&mut segment, micros(1_000)).expect("it comes back");
        count(&mut segment, micros(2_000)).expect("it comes back");
        latch(&mut segment, MainPort::Primary, micros(2_000) + apart);
        let early = if spoilt { apart.0 / 1_000 } else { 0 };
        assert_about(round_trip(&segment, 0), true_round_trip(&segment, 0) - early);
    }
}

/// A port that no frame reached waits: the first frame behind a new cable is stamped, whatever its
/// content.
#[test]
fn a_port_waits_for_a_frame() {
    let mut segment = segment(&crate::support::line(3), |_| &NEXT);
    segment.unplug(2, micros(1_000));
    count(&mut segment, micros(10_000)).expect("it comes back");
    latch(&mut segment, MainPort::Primary, micros(11_000));
    let [_, before, ..] = receive_times(&segment, 1);
    segment.plug(2, micros(12_000));
    for at in [3_000_000, 3_000_100] {
        let read =
            (isocat_wire::Command::Brd, isocat_wire::datagram::Address::Broadcast(0), &[0][..]);
        assert_eq!(send_from(&mut segment, MainPort::Primary, micros(at), read).0, 3);
        let [_, after, ..] = receive_times(&segment, 1);
        assert_ne!(after, before);
        let waited = i64::from(after.wrapping_sub(receive_times(&segment, 1)[0]));
        assert!(
            (2_989_000_000..2_989_010_000).contains(&waited),
            "{waited} ns after the latch, at {at} us"
        );
    }
}

/// Latches of a MainDevice `every` so often during the cycle of a line whose first chip stamps the
/// next frame: returns the number of latches, and the largest error of that chip's round trip, ns.
fn latch_while_it_runs(chip: &'static Chip, every: Nanos) -> (u64, i64) {
    let mut segment = crate::line::connections(LINE);
    // The remaining error is the chip's.
    segment.iter_mut().for_each(|connection| connection.hop_jitter = false);
    segment[0].device.chip = *chip;
    let watch = DelayWatch { every, latches: 16, rewrite: false };
    let world = crate::line::world_of(segment, |config| config.delay_watch = Some(watch));
    let mut world = world.expect("the line comes up");
    let before = world.main().statistics();
    let (mut latches, mut worst) = (0, 0);
    while world.main().statistics().cycles < before.cycles + 200 && world.step(Time::NEVER) {
        while let Some(event) = world.poll_event() {
            assert!(!matches!(event, Event::DelayChanged { .. }), "{event:?}");
        }
        let now = world.main().statistics().delay_latches - before.delay_latches;
        if now > latches {
            latches = now;
            let found = round_trip(world.segment(), 0);
            worst = worst.max((found - true_round_trip(world.segment(), 0)).abs());
        }
    }
    let after = world.main().statistics();
    assert_eq!(after.delay_latches_lost, before.delay_latches_lost);
    assert_eq!(after.working_counter_errors, before.working_counter_errors);
    (latches, worst)
}

/// Number of SubDevices of the line: the frames of its cycle are still in flight when the acyclic
/// ones leave.
const LINE: usize = 100;

/// During the cycle, the MainDevice latches when no other frame is in flight: it recognizes an
/// ET1200 by its type. If the same chip has another type, the MainDevice does not recognize it and
/// latches behind the frames of the cycle, whose return is then stamped.
#[test]
fn a_main_device_latches_into_an_empty_segment() {
    static KNOWN: Chip = Chip { kind: ET1200.kind, stamps_next_frame: true, ..LAN9252 };
    static UNKNOWN: Chip = Chip { stamps_next_frame: true, ..LAN9252 };
    for (chip, errors) in [(&KNOWN, 0..=20), (&LAN9252, 0..=20), (&UNKNOWN, 10_000..=150_000)] {
        // A latch ends with a cycle, so one that follows keeps its phase. These times are so far
        // apart that some latches meet the frames of a cycle of 1.3 ms.
        let all = (0..7).map(|step| {
            let every = Nanos(4_300_000 + 200_000 * step);
            let (latches, worst) = latch_while_it_runs(chip, every);
            assert!((25..=45).contains(&latches), "{latches} latches");
            worst
        });
        let worst = all.max().expect("seven of them");
        assert!(errors.contains(&worst), "{worst} ns, where {errors:?} are expected");
    }
}
