//! Cables pulled, plugged and disturbed during operation, and loops that are set over the wire.

use crate::support::*;
use PortNumber::*;
use isocat_esc::Chip;
use isocat_sim::segment::processing_order;
use isocat_sim::{
    BitError, Cable, ClockModel, Connection, Direction, Lost, MainPort, Returned, Segment,
};
use isocat_wire::Command;
use isocat_wire::PortNumber;
use isocat_wire::datagram::Address;
use isocat_wire::dl::DlStatus;
use isocat_wire::frame::duration_ns;
use isocat_wire::time::{Picos, Time, True};

/// Time from a cable's cut until the ESCs notice it, and from plugging in until they have a link.
const LOSS: Picos = Picos(15_000_000);
const GAIN: Picos = Picos(2_000_000_000);

fn line_with_quick_links(count: usize, chip: &'static Chip) -> Segment {
    let connection = |(number, (parent, port)): (usize, _)| {
        let cable = Cable { link_loss: LOSS, link_gain: GAIN, ..cable(number) };
        let device = device(chip, ClockModel::constant(number as i64 * 7_000), Time::ZERO);
        // The position of a frame at a change must be exact to the picosecond.
        Connection { port, hop_jitter: false, ..Connection::new(parent, cable, device) }
    };
    Segment::new(line(count).into_iter().enumerate().map(connection).collect(), 1)
}

fn status(segment: &Segment, device: usize) -> DlStatus {
    segment.devices()[device].esc.dl_status()
}

/// Link, loop closed, communication.
fn port_status(segment: &Segment, device: usize, port: PortNumber) -> (bool, bool, bool) {
    let status = status(segment, device);
    (status.link(port), status.loop_closed(port), status.communication(port))
}

const UP: (bool, bool, bool) = (true, false, true);
const DOWN: (bool, bool, bool) = (false, true, false);

#[test]
fn a_cable_pulled_and_plugged_in_the_middle_of_cyclic_traffic() {
    for cut in 0..4usize {
        let mut segment = line_with_quick_links(4, &WIDE);
        let whole = segment.path().clone();
        let (pulled, plugged) = (micros(20_003), micros(40_003));
        segment.unplug(cut, pulled);
        segment.plug(cut, plugged);
        // A frame every 20 us: one or more fall between the cut and its notice.
        let mut lost = 0;
        for number in 0..3_000u64 {
            let at = micros(20 * number);
            let fate = count(&mut segment, at);
            let linked = at >= plugged + GAIN;
            match fate {
                Ok(4) => assert!(at < pulled || linked, "{cut}: whole at {at:?}"),
                Ok(left) => {
                    assert_eq!(usize::from(left), cut);
                    assert!(at >= pulled && !linked, "{cut}: cut at {at:?}");
                }
                Err(reason) => {
                    // Until the ESC above the cut notices it, it sends without effect. The
                    // MainDevice always does, and when the cable is plugged again, port 0 has no
                    // link yet.
                    let unnoticed = at + Picos(20_000_000) > pulled && at < pulled + LOSS;
                    let without_link = cut == 0 && at >= pulled && !linked;
                    assert!(unnoticed || without_link, "{cut}: lost at {at:?}");
                    let expected = match at < plugged {
                        true => Lost::Unplugged { cable: cut },
                        false => Lost::Closed { device: 0, port: P0 },
                    };
                    assert_eq!(reason, expected);
                    lost += 1;
                    continue;
                }
            }
            // The status of the ESCs follows, as soon as frames meet the change.
            if cut > 0 && at >= pulled + LOSS {
                let (state, losses) = if linked { (UP, 1) } else { (DOWN, 1) };
                assert_eq!(port_status(&segment, cut - 1, P1), state);
                assert_eq!(counters(&segment, cut - 1).lost_links, [0, losses, 0, 0]);
            }
        }
        assert!(if cut == 0 { lost > 900 } else { (1..=2).contains(&lost) }, "{cut}: {lost} lost");
        assert_eq!(port_status(&segment, cut, P0), UP);
        assert_eq!(counters(&segment, cut).lost_links, [1, 0, 0, 0]);
        assert_eq!(*segment.path(), whole, "the way is as it was");
    }
}

/// The last bit of a frame on the cable decides, to the picosecond.
#[test]
fn a_frame_in_flight_over_a_broken_cable_is_lost() {
    let through = |pulled: Time<True>| {
        let mut segment = line_with_quick_links(2, &WIDE);
        segment.unplug(1, pulled);
        count(&mut segment, micros(100))
    };
    let segment = line_with_quick_links(2, &WIDE);
    let (out, back) =
        (arrival(&segment, MainPort::Primary, 1, P0), arrival(&segment, MainPort::Primary, 0, P1));
    let duration = Picos(duration_ns(60) as i64 * 1000);
    let over = micros(100) + back + duration;
    assert_eq!(through(over), Ok(2));
    let lost = Err(Lost::Unplugged { cable: 1 });
    assert_eq!(through(over + Picos(-1)), lost);
    assert_eq!(through(micros(100) + out + duration), lost, "lost on the way back");
    assert_eq!(through(micros(100)), lost);
    // The cut was noticed before: the frame turns around above it.
    assert_eq!(through(micros(100) + Picos(-LOSS.0)), Ok(1));
}

#[test]
fn a_break_too_short_to_be_noticed_costs_only_the_frames_in_it() {
    let mut segment = line_with_quick_links(2, &WIDE);
    segment.unplug(1, micros(100));
    segment.plug(1, micros(110));
    assert_eq!(count(&mut segment, micros(102)), Err(Lost::Unplugged { cable: 1 }));
    assert_eq!(count(&mut segment, micros(110)), Ok(2));
    assert_eq!(count(&mut segment, micros(5_000)), Ok(2));
    assert_eq!(counters(&segment, 0).lost_links, [0; 4]);
}

/// Frames beyond a break when it is noticed come back to a port 0 that has closed automatically:
/// they are marked, pass once more and are destroyed.
#[test]
fn a_frame_behind_the_break_circulates_once_and_is_destroyed() {
    const COUNT: usize = 60;
    let mut segment = line_with_quick_links(COUNT, &WIDE);
    let out = arrival(&segment, MainPort::Primary, COUNT / 2, P0);
    // It is halfway when the first cable breaks, and its way back is longer than the time to the
    // notice.
    let broken = micros(100) + out;
    assert!(arrival(&segment, MainPort::Primary, 1, P1) - out > LOSS);
    segment.unplug(1, broken);
    let mut bytes = frame(Command::Brd, Address::Broadcast(0), &[0]);
    let fate = segment.pass(&mut bytes, micros(100), &mut isocat_sim::Watcher::blind());
    assert_eq!(fate, Err(Lost::Destroyed { device: 1 }));
    // All count once, and those behind the break once more.
    assert_eq!(usize::from(answer(&bytes).1), COUNT + COUNT - 1);
    assert_eq!(count(&mut segment, micros(2_000)), Ok(1));
}

#[test]
fn a_ring_survives_one_cut() {
    let mut segment = segment(&line(4), |_| &WIDE);
    let ring = segment.close_ring(3, P1, cable(4)).unwrap();
    assert_eq!(ring, 4);
    let brd = (Command::Brd, Address::Broadcast(0), &[0][..]);
    let both = |segment: &mut Segment, us| {
        [MainPort::Primary, MainPort::Secondary].map(|port| {
            let (wkc, fate) = send_from(segment, port, micros(us), brd);
            (wkc, fate.map(|returned| returned.port))
        })
    };
    // Whole: one frame is processed and comes out at the other end, the other one only passes.
    let whole = [(4, Ok(MainPort::Secondary)), (0, Ok(MainPort::Primary))];
    assert_eq!(both(&mut segment, 100), whole);
    segment.unplug(2, micros(1_000));
    let cut = [(2, Ok(MainPort::Primary)), (2, Ok(MainPort::Secondary))];
    assert_eq!(both(&mut segment, 2_000), cut);
    assert_eq!(both(&mut segment, 3_000), cut, "the circulating bit is each frame's own");
    segment.plug(2, micros(4_000));
    assert_eq!(both(&mut segment, 5_000), cut, "no link yet");
    assert_eq!(both(&mut segment, 400_000), whole);
}

#[test]
fn bit_errors_count_where_they_are_seen() {
    let damaged = |direction| {
        let mut segment = line_with_quick_links(4, &WIDE);
        segment.disturb(BitError { cable: 2, direction, at: micros(50), bit: 8 * 26 });
        assert_eq!(count(&mut segment, micros(40)), Ok(4), "not yet");
        let write = (Command::Bwr, Address::Broadcast(0x0010), &[0x34, 0x12][..]);
        let (_, fate) = send_from(&mut segment, MainPort::Primary, micros(100), write);
        assert!(matches!(fate, Ok(Returned { good: false, .. })), "{fate:?}");
        assert_eq!(count(&mut segment, micros(200)), Ok(4), "only one frame");
        segment
    };
    let all = |segment: &Segment| {
        (0..4)
            .map(|d| (counters(segment, d).invalid, counters(segment, d).forwarded))
            .collect::<Vec<_>>()
    };
    let none = ([0; 4], [0; 4]);
    // On the way out, over the cable to 2: port 0 of 2 sees it, then all others see it as marked.
    let segment = damaged(Direction::Out);
    let (first, later) = (([1, 0, 0, 0], [0, 1, 0, 0]), ([0; 4], [1, 0, 0, 0]));
    let back = ([0; 4], [0, 1, 0, 0]);
    assert_eq!(all(&segment), [back, back, first, later]);
    let station = |segment: &Segment, device: usize| {
        segment.devices()[device].esc.register(isocat_wire::register::STATION_ADDRESS)
    };
    // A register only takes effect where the frame was still good.
    assert_eq!([0, 1, 2, 3].map(|d| station(&segment, d)), [0x1234, 0x1234, 0, 0]);
    // On the way back over it: port 1 of 1 sees it first.
    let segment = damaged(Direction::Back);
    assert_eq!(all(&segment), [back, ([0, 1, 0, 0], [0; 4]), none, none]);
    assert_eq!([0, 1, 2, 3].map(|d| station(&segment, d)), [0x1234; 4]);
}

/// DL control decides, not only the cables.
#[test]
fn a_closed_loop_cuts_the_segment_and_opens_again() {
    let mut segment = line_with_quick_links(4, &WIDE);
    // Port 1 of the second: always closed.
    write(&mut segment, micros(100), 1, 0x0101, &[0b1100]);
    assert_eq!(count(&mut segment, micros(200)), Ok(2));
    assert_eq!(port_status(&segment, 1, P1), (true, true, true));
    write(&mut segment, micros(300), 1, 0x0101, &[0]);
    assert_eq!(count(&mut segment, micros(400)), Ok(4));
    // Closed for a second only.
    write(&mut segment, micros(500), 1, 0x0100, &[0b11, 0b1100]);
    assert_eq!(count(&mut segment, micros(600)), Ok(2));
    assert_eq!(count(&mut segment, micros(990_000)), Ok(2));
    assert_eq!(count(&mut segment, micros(1_010_000)), Ok(4));
    // Open without a cable: frames to it are lost, until a frame that still reaches it closes it
    // again.
    write(&mut segment, micros(1_020_000), 3, 0x0101, &[0b1000]);
    let nowhere = isocat_sim::wiring::End::Port(3, P1);
    assert_eq!(count(&mut segment, micros(1_030_000)), Err(Lost::NoCable(nowhere)));
}

/// Auto close: a new link is not enough; writing 0x0101 opens the port, and so does a good frame
/// from outside.
#[test]
fn an_auto_closed_port_waits() {
    let mut segment = line_with_quick_links(3, &WIDE);
    write(&mut segment, micros(100), 0, 0x0101, &[0b0100]);
    assert_eq!(count(&mut segment, micros(200)), Ok(3));
    segment.unplug(1, micros(300));
    segment.plug(1, micros(1_000));
    assert_eq!(count(&mut segment, micros(10_000)), Ok(1));
    assert_eq!(port_status(&segment, 0, P1), (true, true, true));
    write(&mut segment, micros(10_100), 0, 0x0101, &[0b0100]);
    assert_eq!(count(&mut segment, micros(10_200)), Ok(3));

    // In a ring a frame from the other end arrives at the waiting port: it is not accepted, but the
    // next one is.
    let mut segment = line_with_quick_links(3, &WIDE);
    segment.close_ring(2, P1, cable(3)).unwrap();
    let wkc = |segment: &mut Segment, port, us| {
        let (wkc, fate) =
            send_from(segment, port, micros(us), (Command::Brd, Address::Broadcast(0), &[0]));
        fate.map(|returned| (wkc, returned.port))
    };
    let write = (Command::Bwr, Address::Broadcast(0x0101), &[0b0100][..]);
    send_from(&mut segment, MainPort::Primary, micros(100), write).1.unwrap();
    segment.unplug(1, micros(300));
    segment.plug(1, micros(1_000));
    let primary = wkc(&mut segment, MainPort::Primary, 10_000);
    assert_eq!(primary, Ok((1, MainPort::Primary)));
    let secondary = wkc(&mut segment, MainPort::Secondary, 10_100);
    assert_eq!(secondary, Err(Lost::Closed { device: 0, port: P1 }));
    let primary = wkc(&mut segment, MainPort::Primary, 10_200);
    assert_eq!(primary, Ok((3, MainPort::Secondary)));
}

/// A segment with all features: positions follow the processing order, and each SubDevice answers
/// at its own.
#[test]
fn every_position_answers_in_a_tree_with_swapped_cables() {
    let links = [
        (None, P0),
        (Some((0, P1)), P1),
        (Some((1, P0)), P0),
        (Some((0, P3)), P2),
        (Some((3, P1)), P0),
        (Some((3, P3)), P0),
    ];
    let order = processing_order(&links);
    let mut segment = segment(&links, |_| &WIDE);
    let entries: Vec<_> = segment.path().entries.iter().map(|entry| entry.device).collect();
    assert_eq!(entries, order);
    for (position, device) in order.iter().enumerate() {
        let at = micros(100 + 100 * position as u64);
        write(&mut segment, at, position as u16, 0x0010, &[position as u8 + 1, 0]);
        segment.advance(at + Picos(50_000_000), &mut isocat_sim::Watcher::blind());
        let esc = &segment.devices()[*device].esc;
        let station = esc.register(isocat_wire::register::STATION_ADDRESS);
        assert_eq!(usize::from(station), position + 1, "SubDevice {device}");
    }
}
