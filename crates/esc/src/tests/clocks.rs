//! Local and system time, receive times, the drift loop.

use super::*;
use crate::chip::ET1100_MII;
use crate::{DriftLaw, ET1100, ET1200, IP_CORE_32, LAN9252};
use isocat_wire::dc::{DifferencePolarity, SystemTimeDifference};
use isocat_wire::time::{Dc, Local};

#[test]
fn local_time_counts_ticks() {
    let esc = Esc::new(&ET1100, image(SII), vec![0; 8192]).with_local_time(Time::new(5_000));
    let local = |at| esc.local_time(device(at)).count();
    assert_eq!([local(0), local(9), local(10), local(19)], [5_000, 5_000, 5_010, 5_010]);
    // Without correction both dividers pulse together.
    assert_eq!(local(1_000_000_000_000), 1_000_000_005_000);
    let wrapping = Esc::new(&IP_CORE_32, image(SII), vec![0; 4096]);
    assert_eq!(wrapping.local_time(device((1 << 32) + 25)), Time::<Local>::new(24));
}

#[test]
fn system_time_by_both_sides() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, 0u64.wrapping_sub(400));
    bench.write(register::SYSTEM_TIME_DELAY, 70);
    bench.run_to(100_007);
    // The value is that of the frame's start, less the delay, for every datagram of the frame.
    let list = [
        (Command::Fprd, station(0x0910), &[0; 8][..]),
        (Command::Fprd, station(0x0000), &[0; 600][..]),
        (Command::Fprd, station(0x0910), &[0; 8][..]),
    ];
    let answers = bench.frame(true, &list);
    assert_eq!(answers[0].0, (100_000u64 - 470).to_le_bytes());
    assert_eq!(answers[0].0, answers[2].0);
    bench.run_to(200_000);
    assert_eq!(bench.pdi_read(register::SYSTEM_TIME), 199_600);
    assert_eq!(bench.esc.system_time(device(200_000)), Time::<Dc>::new(199_600));
    // Upper bytes belong to the moment in which byte 0 was read.
    assert_eq!(bench.pdi_bytes(0x0910, 1), [(199_600u64 & 0xFF) as u8]);
    bench.run_to(300_000);
    assert_eq!(bench.pdi_bytes(0x0911, 3), 199_600u64.to_le_bytes()[1..4]);
}

#[test]
fn first_reaching_is_exact() {
    let mut bench = Bench::new(&LAN9252);
    bench.write(register::SYSTEM_TIME_OFFSET, 7);
    let from = device(bench.now);
    let reach = |system| bench.esc.first_reaching(Time::new(system), from).count();
    assert_eq!([reach(1_000_007), reach(1_000_008)], [1_000_000, 1_000_010]);
    assert_eq!(reach(0), bench.now.next_multiple_of(10));
    assert_eq!(reach(1 << 62), Time::<Device>::NEVER.count());
}

/// Vectors 4, 5: receive times of the ports and of the EPU.
#[test]
fn receive_times() {
    let mut bench = Bench::new(&LAN9252);
    bench.run_to(50_000);
    let arrived = bench.now;
    assert_eq!(bench.bwr(0x0900, &[0]), 1);
    assert!(bench.processed.latch_ports);
    bench.esc.receive_at_port(PortNumber::P0, device(arrived));
    bench.esc.receive_at_port(PortNumber::P1, device(arrived + 1_440));
    let times = bench.fprd(0x0900, 16).0;
    assert_eq!(times[..4], (arrived as u32).to_le_bytes());
    assert_eq!(times[4..8], (arrived as u32 + 1_440).to_le_bytes());
    assert_eq!(bench.read(register::RECEIVE_TIME_EPU), arrived);
    // APWR increments and latches only the EPU's time; a bad frame latches nothing.
    let position = Address::Position(AutoIncrementAddress(0), 0x0900);
    assert_eq!(bench.send(Command::Apwr, position, &[0; 4]).1, 1);
    assert!(!bench.processed.latch_ports);
    assert_ne!(bench.read(register::RECEIVE_TIME_EPU), arrived);
    bench.frame(false, &[(Command::Bwr, Address::Broadcast(0x0900), &[0])]);
    assert!(!bench.processed.latch_ports);
    assert!({
        bench.fprd(0x0900, 4);
        !bench.processed.latch_ports
    });
    // A long write that ends in the register latches; one that ends before it does not.
    bench.bwr(0x08FF, &[0; 2]);
    assert!(bench.processed.latch_ports);
}

/// Feeds the loop with a reference that runs `ppm` faster than this clock. Returns the difference
/// of the clocks (positive if this one is ahead) after each quarter of `frames` frames.
fn follow(law: DriftLaw, depths: [u8; 2], ppm: i64, interval: u64, frames: u64) -> [i64; 4] {
    let mut bench = Bench::new(&ET1100);
    bench.esc = bench.esc.with_drift_law(law);
    bench.fpwr(0x0934, &depths);
    bench.fpwr(0x0930, &0x1000u16.to_le_bytes());
    let begin = bench.now;
    let reference = |at: u64| at.wrapping_add_signed((at - begin) as i64 * ppm / 1_000_000);
    let mut quarters = [0; 4];
    let other = Address::Station(StationAddress(1), 0x0910);
    for frame in 0..frames {
        bench.run_to(begin + frame * interval);
        // The reference counts in its own ticks.
        let received = reference(bench.now) / 10 * 10;
        bench.send(Command::Frmw, other, &(received as u32).to_le_bytes());
        let ahead =
            bench.esc.system_time(device(bench.now)).count() as i64 - reference(bench.now) as i64;
        quarters[(4 * frame / frames) as usize] = ahead;
    }
    bench.events.clear();
    let shown = bench.esc.system_time_difference().0;
    assert!((shown - quarters[3]).abs() <= 30, "0x092C shows {shown} at {}", quarters[3]);
    quarters
}

#[test]
fn the_loop_follows_from_both_sides() {
    for (_, law) in DriftLaw::NAMED {
        for (ppm, interval) in
            [(83, 10_000), (-83, 10_000), (-100, 10_000), (100, 10_000), (-35, 10_000)]
        {
            let quarters = follow(law, [0, 12], ppm, interval, 40_000);
            assert!(quarters[3].abs() <= 20, "{law}, {ppm} ppm: {quarters:?}");
            // The mean of a block is right at once; the other laws take longer.
            if law != DriftLaw::BLOCK {
                assert!(quarters[0].abs() > 20, "{law}, {ppm} ppm: it takes time: {quarters:?}");
                assert_eq!(quarters[0] > 0, ppm < 0, "a slower reference leaves us ahead");
            }
        }
    }
}

/// The difference that remains after 15000 received times, the number that MainDevices are advised
/// to send, at the reset values of the filters. Sent back to back, some ns to some hundred ns
/// remain. At one per millisecond microseconds remain if the mean of the speed is exponential.
#[test]
fn the_recommended_number_of_frames() {
    for (law, burst, slow) in [
        (DriftLaw::HOLD, 150..400, 3_000..6_000),
        (DriftLaw::BLOCK, 0..30, 0..60),
        (DriftLaw::PROPORTIONAL, 0..60, 100..400),
    ] {
        for ppm in [100, -100] {
            for (interval, left) in [(60_000, &burst), (1_000_000, &slow)] {
                let quarters = follow(law, [4, 12], ppm, interval, 15_000);
                assert!(
                    left.contains(&quarters[3].abs()),
                    "{law}, {ppm} ppm, {interval} ns: {quarters:?}"
                );
            }
        }
    }
}

/// The filters that the MainDevice sets lock with every law, and sooner.
#[test]
fn a_small_depth_locks() {
    for (_, law) in DriftLaw::NAMED {
        for (ppm, interval) in [(83, 1_000_000), (-100, 1_000_000), (0, 125_000), (100, 60_000)] {
            let quarters = follow(law, [4, 6], ppm, interval, 20_000);
            assert!(quarters[3].abs() <= 20, "{law}, {ppm} ppm, {interval} ns: {quarters:?}");
        }
    }
}

/// The speed is the published one: 100 units are 1.19 ppm, and the whole range is 763 ppm.
#[test]
fn the_deviation_formula() {
    use crate::dc::clock::Clock;
    for difference in [0i16, 100, -100, 1_000, 3_066, 3_969, -3_969] {
        let mut clock = Clock::new(0, Time::ZERO);
        clock.adjust(Time::ZERO, 0x1000, difference, 0);
        let long = 10_000_000_000_000u64;
        let gained = clock.local(device(long)) as i128 - i128::from(long);
        let (s, d) = (4096 + 2, i128::from(difference));
        let expected = i128::from(long) * d / (5 * (s + d) * (s - d));
        assert!((gained - expected).abs() <= 1_000, "{difference}: {gained}, not {expected}");
    }
}

#[test]
fn the_clock_and_its_inverse_agree_over_changes() {
    use crate::dc::clock::Clock;
    let mut clock = Clock::new(123, Time::ZERO);
    let mut now = 0;
    for step in 0..2_000u64 {
        now += 10 * (1 + step * 7_919 % 5_003);
        let difference = (step * 104_729 % 7_939) as i16 - 3_969;
        let before = clock.local(device(now));
        clock.adjust(device(now), 0x1000, difference, 0);
        assert_eq!(clock.local(device(now)), before, "a new speed is no jump");
        for ticks in [1, 2, 129, 130, 4_096] {
            let at = now + 10 * ticks;
            let (one, next) = (clock.local(device(at - 10)), clock.local(device(at)));
            assert!((9..=11).contains(&(next - one)));
            // The inverse finds this tick exactly, not the one before.
            assert_eq!(clock.after(device(now), (next - before) as i64), device(at));
            assert_eq!(clock.after(device(now), (one - before) as i64 + 1), device(at));
        }
    }
}

/// A clock that is counted from later on shows the same, after short and long cycles, and so does
/// its inverse.
#[test]
fn it_does_not_matter_from_where_a_clock_is_counted() {
    use crate::dc::clock::Clock;
    for (start, difference) in
        [(0x1000, 0), (0x1000, 1_650), (0x1000, -3_969), (0x80, 1), (0x3FFF, 7)]
    {
        for cycle in [20_000u64, 1_000_000, 10_000_000, 200_000_000, 50_000_000_000] {
            let mut clock = Clock::new(u64::MAX - 12_345, device(30));
            clock.adjust(device(1_000), start, difference, -100);
            let mut later = clock;
            for now in (1..100).map(|number| number * (cycle + 10 * number)) {
                later.adjust(device(now), start, difference, 0);
                for ahead in [0, 5, 40_980, cycle / 3, 1 << 31, 1 << 45] {
                    let at = device(now + ahead);
                    assert_eq!(later.local(at), clock.local(at), "{now} + {ahead} ns");
                    let span = clock.local(at).wrapping_sub(clock.local(device(now)));
                    let (found, passed) = later.passed(device(now), span as i64);
                    assert_eq!(found, clock.after(device(now), span as i64));
                    let shown = clock.local(found).wrapping_sub(clock.local(device(now)));
                    assert!(passed.is_none_or(|passed| passed == shown));
                }
            }
        }
    }
}

/// A received time of 0 is compared like any other. A clock with the same distance from it shows
/// the same difference and is steered in the same way. Only one law makes an exception.
#[test]
fn zero_is_a_time_like_any_other() {
    let led = |law: DriftLaw, received: u32| {
        let mut bench = Bench::new(&ET1100);
        bench.esc = bench.esc.with_drift_law(law);
        bench.fpwr(0x0934, &[0, 0]);
        bench.write(register::SYSTEM_TIME_OFFSET, u64::from(received));
        bench.fpwr(0x0930, &[0x00, 0x10]);
        let other = Address::Station(StationAddress(1), 0x0910);
        for _ in 0..40 {
            bench.run_to(bench.now + 100_000);
            bench.send(Command::Frmw, other, &received.to_le_bytes());
        }
        let speed = bench.read(register::SPEED_COUNTER_DIFFERENCE);
        (
            bench.read(register::SYSTEM_TIME_DIFFERENCE),
            speed,
            bench.esc.local_time(device(bench.now)),
        )
    };
    for (law, same) in
        [(DriftLaw::HOLD, true), (DriftLaw::BLOCK, true), (DriftLaw::PROPORTIONAL, false)]
    {
        let (zero, other) = (led(law, 0), led(law, 1_000_000));
        assert_eq!(zero == other, same, "{law}: {zero:?}, {other:?}");
        assert_ne!((other.1, other.2), (0, Time::new(0)));
        assert_ne!(zero.0.magnitude(), 0, "{law}");
    }
}

/// MainDevices write zeros to 0x0910 before they reset the loop by 0x0930. A law that does not
/// follow the zeros still shows them. Their effect under the other laws ends with the reset.
#[test]
fn zeros_are_shown() {
    let mut bench = Bench::new(&ET1100);
    bench.esc = bench.esc.with_drift_law(DriftLaw::PROPORTIONAL);
    bench.write(register::SYSTEM_TIME_OFFSET, 700_000_000_123_456_789);
    let free =
        |bench: &Bench| bench.esc.local_time(device(bench.now)).count() as i64 - bench.now as i64;
    let before = free(&bench);
    for _ in 0..10 {
        bench.bwr(0x0910, &[0; 32]);
        bench.run_to(bench.now + 1_000_000);
    }
    bench.bwr(0x0910, &[0; 4]);
    assert!((free(&bench) - before).abs() <= 10);
    assert_eq!(bench.read(register::SPEED_COUNTER_DIFFERENCE), 0);
    assert_ne!(bench.read(register::SYSTEM_TIME_DIFFERENCE).magnitude(), 0, "but it is shown");
    bench.fpwr(0x0930, &[0x00, 0x10]);
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
}

/// The reference clock is read by FRMW: its own loop receives nothing.
#[test]
fn the_reference_does_not_follow_itself() {
    let mut bench = Bench::new(&ET1100);
    for _ in 0..100 {
        let (data, wkc) = bench.send(Command::Frmw, station(0x0910), &[0; 8]);
        assert_eq!(wkc, 1);
        assert_ne!(data, [0; 8]);
    }
    assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(0));
}

/// The sign of 0x092C is a property of the chip: as on a captured ET1100, or inverted.
#[test]
fn the_sign_of_the_difference() {
    static NEWER: Chip =
        Chip { difference_polarity: DifferencePolarity::NegativeAhead, ..ET1100_MII };
    for (chip, behind, ahead) in [(&ET1100, 0x8000_012C, 300), (&NEWER, 300, 0x8000_012C)] {
        for (lead, shown) in [(300, behind), (-300, ahead)] {
            let mut bench = Bench::new(chip);
            bench.write(register::TIME_FILTER_DEPTH, 0);
            bench.run_to(bench.now.next_multiple_of(10) + 100);
            let received = (bench.now as i64 + lead) as u32;
            let other = Address::Station(StationAddress(1), 0x0910);
            bench.send(Command::Frmw, other, &received.to_le_bytes());
            assert_eq!(bench.read(register::SYSTEM_TIME_DIFFERENCE), SystemTimeDifference(shown));
            assert_eq!(bench.esc.system_time_difference().0, -lead);
        }
    }
}

/// Receive time and system time are read in halves, consistently for each side.
#[test]
fn halves_of_a_running_time_belong_together() {
    let mut bench = Bench::new(&LAN9252);
    bench.run_to((5 << 32) - 10_000);
    let before = bench.now.to_le_bytes();
    bench.bwr(0x0900, &[0]);
    assert_eq!(bench.fprd(0x0918, 4).0, before[..4]);
    assert_eq!(bench.pdi_bytes(0x0918, 4), before[..4]);
    bench.run_to(5 << 32);
    let after = bench.now.next_multiple_of(10).to_le_bytes();
    bench.run_to(u64::from_le_bytes(after));
    bench.bwr(0x0900, &[0]);
    assert_eq!(bench.pdi_bytes(0x091C, 4), before[4..]);
    assert_eq!(bench.fprd(0x091C, 4).0, before[4..]);
    assert_eq!(bench.fprd(0x0918, 8).0, after);
    assert_eq!(bench.pdi_bytes(0x091C, 4), before[4..], "one side's read is not the other's");
    assert_eq!(bench.pdi_bytes(0x0918, 8), after);
    // On the wire a frame's system time is that of its start, whatever was read before.
    let at = bench.now / 10 * 10;
    assert_eq!(bench.fprd(0x0914, 4).0, at.to_le_bytes()[4..]);
}

/// In reverse mode ports 1-3 show what arrived before the frame reached the EPU. The file
/// `next_frame` tests the forward mode of this chip.
#[test]
fn receive_times_in_reverse_mode() {
    let times = |bench: &mut Bench| {
        let data = bench.fprd(0x0900, 8).0;
        [0, 4].map(|at| u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]))
    };
    static EARLIER: Chip = Chip { stamps_next_frame: false, ..ET1200 };
    for (chip, mode) in [(&EARLIER, 0), (&EARLIER, 1), (&ET1200, 1)] {
        let mut bench = Bench::new(chip);
        bench.write(register::RECEIVE_TIME_LATCH_MODE, mode);
        // This frame enters at port 1, returns at port 0 and passes the EPU then.
        bench.run_to(50_000);
        bench.esc.receive_at_port(PortNumber::P1, device(49_000));
        bench.bwr(0x0900, &[0]);
        bench.esc.receive_at_port(PortNumber::P0, device(50_000));
        assert_eq!(times(&mut bench), [50_000, 49_000], "mode {mode}");
        // In reverse mode a later arrival belongs to the next frame.
        bench.run_to(100_000);
        bench.bwr(0x0900, &[0]);
        bench.esc.receive_at_port(PortNumber::P0, device(100_000));
        bench.esc.receive_at_port(PortNumber::P1, device(100_010));
        let shown = if mode == 0 { 100_010 } else { 49_000 };
        assert_eq!(times(&mut bench), [100_000, shown], "mode {mode}");
        bench.run_to(200_000);
        bench.bwr(0x0900, &[0]);
        assert_eq!(times(&mut bench)[1], 100_010, "mode {mode}");
        // The arrival is at the instant of the EPU, and 1 ns after it.
        for (after, shown) in [(0, 300_000), (1, if mode == 0 { 400_000 } else { 300_000 })] {
            bench.run_to(300_000 + after * 100_000);
            bench.bwr(0x0900, &[0]);
            let at = 300_000 + after * 100_001;
            bench.esc.receive_at_port(PortNumber::P1, device(at));
            assert_eq!(times(&mut bench)[1], shown, "mode {mode}");
        }
    }
    // These chips do not have the register.
    assert_eq!(Bench::new(&LAN9252).fprd(0x0936, 1).1, 0);
    assert_eq!(Bench::new(&LAN9252).fpwr(0x0936, &[1]), 0);
}
