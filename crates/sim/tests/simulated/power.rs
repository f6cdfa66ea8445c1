//! SubDevices that are switched off and on during operation.

use crate::support::*;
use PortNumber::*;
use isocat_sim::{Cable, ClockModel, Connection, Lost, Segment};
use isocat_wire::PortNumber;
use isocat_wire::register;
use isocat_wire::time::{Device, Picos, Time, True};
use isocat_wire::{AlState, AlStatus};

/// Time from a cut until the ESCs notice it, and from power-on until they have a link.
const LOSS: Picos = Picos(15_000_000);
const GAIN: Picos = Picos(2_000_000_000);
const ONE: Picos = Picos(1);

fn line_with_quick_links(count: usize) -> Segment {
    let connection = |(number, (parent, port)): (usize, _)| {
        let cable = Cable { link_loss: LOSS, link_gain: GAIN, ..cable(number) };
        let clock = ClockModel::constant(number as i64 * 7_000);
        let device = device(&WIDE, clock, Time::new(number as u64 * 1_000_000_000_000));
        // The position of a frame at a change must be exact to the picosecond.
        Connection { port, hop_jitter: false, ..Connection::new(parent, cable, device) }
    };
    Segment::new(line(count).into_iter().enumerate().map(connection).collect(), 1)
}

/// Link, loop closed, links lost.
fn port(segment: &Segment, device: usize, port: PortNumber) -> (bool, bool, u8) {
    let status = segment.devices()[device].esc.dl_status();
    let lost = counters(segment, device).lost_links[port.index()];
    (status.link(port), status.loop_closed(port), lost)
}

fn al_status(segment: &Segment, device: usize) -> AlStatus {
    segment.devices()[device].esc.al_status()
}

fn live(segment: &mut Segment, until: Time<True>) {
    segment.advance(until, &mut isocat_sim::Watcher::blind());
}

#[test]
fn neighbours_see_it_as_pulled_cables() {
    let mut segment = line_with_quick_links(4);
    let whole = segment.path().clone();
    let (off, on) = (micros(20_003), micros(40_003));
    segment.power_off(2, off);
    segment.power_on(2, on);
    let (mut lost, mut short) = (0, 0);
    for number in 0..3_000u64 {
        let at = micros(20 * number);
        match count(&mut segment, at) {
            Ok(4) => assert!(at < off || at >= on + GAIN, "whole at {at:?}"),
            Ok(left) => {
                assert_eq!(left, 2, "all behind it are away too");
                assert!(at >= off && at < on + GAIN, "cut at {at:?}");
                short += 1;
            }
            Err(reason) => {
                assert_eq!(reason, Lost::Unplugged { cable: 2 });
                assert!(at + Picos(20_000_000) > off && at < off + LOSS, "lost at {at:?}");
                lost += 1;
            }
        }
        if at == micros(30_000) {
            live(&mut segment, at);
            assert!(!segment.devices()[2].is_powered());
            assert_eq!(port(&segment, 1, P1), (false, true, 1));
            assert_eq!(port(&segment, 3, P0), (false, true, 1));
        }
    }
    assert!((1..=2).contains(&lost) && (1_090..=1_101).contains(&short), "{lost}, {short}");
    assert_eq!(port(&segment, 1, P1), (true, false, 1));
    assert_eq!(port(&segment, 3, P0), (true, false, 1));
    assert_eq!(port(&segment, 2, P0), (true, false, 0), "its own counters began anew");
    assert_eq!(port(&segment, 2, P1), (true, false, 0));
    assert_eq!(*segment.path(), whole, "the way is as it was");
}

#[test]
fn it_starts_anew_with_the_eeprom_that_was_written() {
    let mut segment = line_with_quick_links(3);
    write(&mut segment, micros(100), 1, 0x0010, &[0x34, 0x12]);
    write(&mut segment, micros(200), 1, 0x0120, &[0x02, 0x00]);
    // Word 0x50 of the EEPROM, with the write enable in the same frame.
    write(&mut segment, micros(300), 1, 0x0502, &[0x01, 0x02, 0x50, 0, 0, 0, 0xCD, 0xAB]);
    live(&mut segment, micros(20_000));
    let esc = |segment: &Segment| {
        let esc = &segment.devices()[1].esc;
        let eeprom = [esc.eeprom()[0xA0], esc.eeprom()[0xA1]];
        (esc.register(register::STATION_ADDRESS), eeprom)
    };
    assert_eq!(al_status(&segment, 1), AlStatus::new(AlState::PreOp));
    assert_eq!(esc(&segment), (0x1234, [0xCD, 0xAB]));

    let (off, on) = (micros(30_000), micros(50_000));
    segment.power_off(1, off);
    live(&mut segment, off + Picos(-1));
    assert_eq!(al_status(&segment, 1), AlStatus::new(AlState::PreOp), "to the last picosecond");
    live(&mut segment, off);
    assert_eq!(segment.devices()[1].stack.state(), AlState::Init);
    assert_eq!(esc(&segment), (0, [0xCD, 0xAB]));
    segment.power_on(1, on);
    live(&mut segment, on + GAIN);
    assert_eq!(al_status(&segment, 1), AlStatus::new(AlState::Init));
    // Local time begins at 0, with an oscillator 7 ppm fast.
    let clock = segment.devices()[1].oscillator();
    let (from, at): (Time<Device>, Time<Device>) = (clock.read(on), clock.read(on + GAIN));
    assert_eq!((at - from).0, 2_000_014);
    let local = segment.devices()[1].esc.local_time(at);
    // It counts ticks of 10 ns, whose phase is that of the oscillator.
    assert!(local.count().abs_diff(2_000_014) <= 10, "{local:?}");
    // It answers, and can be brought up again.
    assert_eq!(count(&mut segment, micros(60_000)), Ok(3));
    write(&mut segment, micros(60_100), 1, 0x0120, &[0x02, 0x00]);
    live(&mut segment, micros(60_500));
    assert_eq!(al_status(&segment, 1), AlStatus::new(AlState::PreOp));
}

/// Causes of a cut add up: the cable is whole when none remains.
#[test]
fn a_cable_needs_both_ends_and_to_be_plugged() {
    let mut segment = line_with_quick_links(4);
    let ms = |ms: u64| micros(1_000 * ms);
    segment.power_off(1, ms(10));
    segment.unplug(2, ms(20));
    segment.power_off(2, ms(30));
    segment.power_on(1, ms(40));
    segment.plug(2, ms(50));
    segment.power_on(2, ms(60));
    let mut answers = Vec::new();
    for number in 0..7 {
        answers.push(count(&mut segment, ms(10 * number + 5)));
    }
    let one = Ok(1);
    assert_eq!(answers, [Ok(4), one, one, one, Ok(2), Ok(2), Ok(4)]);
    assert_eq!(port(&segment, 3, P0), (true, false, 1), "one link was lost, not three");
}

/// A cable that is pulled so briefly that no ESC notices has no effect; a SubDevice without power
/// for as short a time has lost its links.
#[test]
fn no_power_cycle_is_too_short_to_be_noticed() {
    let mut segment = line_with_quick_links(3);
    let off = micros(1_000);
    segment.power_off(1, off);
    segment.power_on(1, off + ONE);
    assert_eq!(count(&mut segment, micros(2_000)), Ok(1));
    assert_eq!(count(&mut segment, micros(2_990)), Ok(1));
    assert_eq!(count(&mut segment, micros(3_010)), Ok(3));
    assert_eq!(port(&segment, 0, P1), (true, false, 1));
    assert_eq!(port(&segment, 2, P0), (true, false, 1));

    // Off again while the link is still coming back.
    segment.power_off(1, micros(10_000));
    segment.power_on(1, micros(10_001));
    segment.power_off(1, micros(11_000));
    assert_eq!(count(&mut segment, micros(20_000)), Ok(1));
    segment.power_on(1, micros(30_000));
    assert_eq!(count(&mut segment, micros(31_990)), Ok(1));
    assert_eq!(count(&mut segment, micros(32_010)), Ok(3));
    assert_eq!(port(&segment, 2, P0), (true, false, 2));
}

/// The first SubDevice has the MainDevice above it, which always sends.
#[test]
fn without_the_first_nothing_comes_back() {
    let mut segment = line_with_quick_links(2);
    segment.power_off(0, micros(100));
    assert_eq!(count(&mut segment, micros(1_000)), Err(Lost::Unplugged { cable: 0 }));
    segment.power_on(0, micros(2_000));
    assert_eq!(count(&mut segment, micros(10_000)), Ok(2));
}

/// A port that is forced open sends into the pulled cable endlessly.
#[test]
fn a_port_open_by_force_loses_all_frames() {
    for by_power in [false, true] {
        let mut segment = line_with_quick_links(3);
        write(&mut segment, micros(100), 1, 0x0101, &[0b1000]);
        match by_power {
            true => segment.power_off(2, micros(1_000)),
            false => segment.unplug(2, micros(1_000)),
        }
        for ms in 2..5 {
            let fate = count(&mut segment, micros(1_000 * ms));
            assert_eq!(fate, Err(Lost::Unplugged { cable: 2 }), "{by_power}");
        }
        match by_power {
            true => segment.power_on(2, micros(10_000)),
            false => segment.plug(2, micros(10_000)),
        }
        assert_eq!(count(&mut segment, micros(20_000)), Ok(3), "{by_power}");
    }
}

#[test]
#[should_panic(expected = "SubDevice 1 was switched at")]
fn power_comes_and_goes_in_the_order_of_time() {
    let mut segment = line_with_quick_links(2);
    segment.power_off(1, micros(100));
    segment.power_on(1, micros(99));
}
