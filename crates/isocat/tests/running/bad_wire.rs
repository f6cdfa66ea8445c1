//! A MainDevice on an ordinary machine and a wire that loses: frames lost on the way up, nobody
//! there, somebody else there, a cable pulled, a host that stamps too early and sleeps too long.

use std::collections::VecDeque;

use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::{Cause, Config, Event, FRAME_LEN, MainDevice, SdoError, Stage};
use isocat_sim::Segment;
use isocat_wire::datagram::Address;
use isocat_wire::frame::{self, LOCALLY_ADMINISTERED};
use isocat_wire::time::{Host, Picos, Time};
use isocat_wire::{AutoIncrementAddress, Command, ObjectAddress, register};

/// What becomes of a frame.
enum Fate {
    /// It passes the segment, so long after its stamp.
    Passes(i64),
    /// It passes the segment, and the program has it so much later than it might.
    ComesLate(i64),
    /// It does not reach the segment.
    LostOut,
    /// It passes the segment and does not come back.
    LostBack,
    /// It comes back as if an ESC had touched it and no SubDevice answered.
    Untouched,
    /// It comes back as it left.
    Echoed,
    /// It passes the segment, and comes back with the source address that it left with.
    Unmarked,
}

/// A MainDevice, a segment, and what lies between.
struct Bench<F> {
    main: MainDevice,
    segment: Segment,
    /// Host time, which is true time here.
    now: Time<Host>,
    sent: u64,
    wire_free: i64,
    returning: VecDeque<(i64, Vec<u8>)>,
    /// By the number of the frame, its stamp and the machine's stage.
    fate: F,
    /// How much later than asked for the program wakes, by the number of the wake-up.
    late: fn(u64) -> i64,
    wake_ups: u64,
    events: Vec<Event>,
}

impl<F: FnMut(u64) -> Fate> Bench<F> {
    fn new(change: impl FnOnce(&mut Config), fate: F) -> Self {
        let mut setup = Scenario::from(SegmentFile::built_in()).run().setup;
        change(&mut setup.config);
        Self {
            main: MainDevice::new(setup.config, Time::new(0)),
            segment: Segment::new(setup.segment, setup.seed),
            now: Time::new(0),
            sent: 0,
            wire_free: 0,
            returning: VecDeque::new(),
            fate,
            late: |_| 0,
            wake_ups: 0,
            events: Vec::new(),
        }
    }

    /// Runs until an event is of this kind; the event, or none by then.
    fn until(&mut self, within: Nanos, is: impl Fn(&Event) -> bool) -> Option<Event> {
        let end = self.now + within;
        let mut buffer = [0; FRAME_LEN];
        loop {
            while let Some(len) = self.main.poll_transmit(self.now, &mut buffer) {
                let number = self.sent;
                self.sent += 1;
                let fate = (self.fate)(number);
                self.pass(&buffer[..len], fate);
            }
            while let Some(event) = self.main.poll_event() {
                self.events.push(event.clone());
                if is(&event) {
                    return Some(event);
                }
            }
            let wanted = self.main.next_timeout().map_or(i64::MAX, |at| at.count() as i64);
            let back = self.returning.front().map_or(i64::MAX, |(at, _)| *at);
            let now = self.now.count() as i64;
            if wanted.min(back) > end.count() as i64 {
                self.now = end;
                return None;
            }
            if back <= wanted.max(now) {
                self.now = Time::new(back.max(now) as u64);
                let (_, bytes) = self.returning.pop_front().expect("a frame is back");
                self.main.handle_frame(self.now, &bytes);
            } else {
                self.wake_ups += 1;
                self.now = Time::new((wanted.max(now) + (self.late)(self.wake_ups)) as u64);
                self.main.handle_timeout(self.now);
            }
        }
    }

    fn pass(&mut self, bytes: &[u8], fate: Fate) {
        let mut bytes = bytes.to_vec();
        let held_up = if let Fate::Passes(held_up) = fate { held_up } else { 0 };
        let start = (self.now.count() as i64 + held_up).max(self.wire_free);
        self.wire_free = start + frame::duration_ns(bytes.len()) as i64 + 960;
        let back = match fate {
            Fate::LostOut => return,
            Fate::Passes(_) | Fate::ComesLate(_) | Fate::LostBack | Fate::Unmarked => {
                let returned = self.segment.pass(
                    &mut bytes,
                    Time::ZERO + Picos(start * 1000),
                    &mut isocat_sim::Watcher::blind(),
                );
                if matches!(fate, Fate::LostBack) {
                    return;
                }
                if matches!(fate, Fate::Unmarked) {
                    bytes[6] &= !LOCALLY_ADMINISTERED;
                }
                returned.expect("no cable is disturbed").last_bit.as_nanos() as i64
            }
            Fate::Untouched => {
                bytes[6] |= LOCALLY_ADMINISTERED;
                self.wire_free
            }
            Fate::Echoed => self.wire_free,
        };
        let late = if let Fate::ComesLate(late) = fate { late } else { 0 };
        self.returning.push_back((back + 20_000 + late, bytes));
    }

    /// Writes to registers without the MainDevice, as another sender would.
    fn write(&mut self, command: Command, address: Address, data: &[u8]) {
        let mut buffer = [0; FRAME_LEN];
        let mut frame = frame::FrameWriter::new(&mut buffer, [2, 0, 0, 0, 0, 1]);
        frame.push(command, 0, address, data).expect("it is short");
        let len = frame.finish();
        self.pass(&buffer[..len], Fate::LostBack);
    }

    /// Up into operation.
    fn up(&mut self, what: &str) {
        let end = |event: &Event| matches!(event, Event::InOperation { .. } | Event::Failed(_));
        match self.until(Nanos::millis(60_000), end) {
            Some(Event::InOperation { .. }) => {}
            other => {
                panic!("{what}: {other:?} at {}, {:?}", self.main.stage(), self.main.statistics())
            }
        }
    }
}

fn over(event: &Event) -> bool {
    matches!(event, Event::Failed(_) | Event::Stopped)
}

/// Answers that come when their cycle is given up are late, each of them, and not those of a later
/// cycle.
#[test]
fn an_answer_cycles_late_is_not_taken_for_that_of_another_cycle() {
    use std::cell::Cell;
    let late = Cell::new(0);
    let mut bench = Bench::new(|_| {}, |_| Fate::ComesLate(late.get()));
    bench.up("a calm wire");
    bench.until(Nanos::millis(20), over);
    let before = bench.main.statistics();
    assert_eq!((before.frames_late, before.frames_lost), (0, 0));
    late.set(2_100_000);
    bench.until(Nanos::millis(50), over);
    let after = bench.main.statistics();
    assert!(after.frames_received <= before.frames_received + 1, "{before:?} {after:?}");
    // Lost or late, never both: but for the last two or three, all that were given up have come
    // since.
    assert!((45..=51).contains(&after.frames_late), "{after:?}");
    assert!(after.frames_lost <= 1, "{after:?}");
    assert_eq!(after.frames_missed(), after.frames_late + after.frames_lost);
    assert_eq!(after.cyclic_late, after.frames_late);
    let all = after.frames_received + after.frames_missed() + bench.main.frames_in_flight() as u64;
    assert_eq!(after.frames_sent, all);
    assert_eq!(after.frames_unexpected, 0);
}

/// The source address is a hint and no more: a segment works whose ESCs do not mark it, whichever
/// of them they are, and so does one whose frames never show a mark. Nothing of it is called an
/// echo.
#[test]
fn a_segment_that_does_not_mark_frames_comes_up() {
    let devices = SegmentFile::built_in().subdevices.len() as u16;
    let broadcast = |ado| Address::Broadcast(ado);
    let at = |position: u16| {
        move |ado| Address::Position(AutoIncrementAddress::of_position(position), ado)
    };
    let (every, first, middle) = (broadcast, at(0), at(devices / 2));
    type Place<'a> = &'a dyn Fn(u16) -> Address;
    let cases: [(&str, Command, Place<'_>); 3] = [
        ("at every device", Command::Bwr, &every),
        ("at the first", Command::Apwr, &first),
        ("at one in the middle", Command::Apwr, &middle),
    ];
    for (what, command, place) in cases {
        let mut bench = Bench::new(|_| {}, |_| Fate::Passes(0));
        bench.write(command, place(register::DL_CONTROL.address), &[0]);
        bench.up(what);
        let counts = bench.main.statistics();
        assert_eq!((counts.frames_echoed, counts.frames_missed()), (0, 0), "{what}");
        // It is written at start, so that echoes can be told from answers again.
        for device in bench.segment.devices() {
            assert_eq!(device.esc.register(register::DL_CONTROL) & 1, 1, "{what}");
        }
        // And cleared from outside while it runs.
        bench.write(command, place(register::DL_CONTROL.address), &[0]);
        assert_eq!(bench.until(Nanos::millis(50), over), None, "{what}");
        let after = bench.main.statistics();
        assert_eq!((after.frames_echoed, after.frames_missed()), (0, 0), "{what}");
        assert_eq!(after.working_counter_errors, counts.working_counter_errors, "{what}");
    }
    let mut bench = Bench::new(|_| {}, |_| Fate::Unmarked);
    bench.up("a stack that never marks");
    bench.until(Nanos::millis(50), over);
    let counts = bench.main.statistics();
    assert_eq!((counts.frames_echoed, counts.frames_missed()), (0, 0));
    bench.main.stop();
    assert_eq!(bench.until(Nanos::millis(5_000), over), Some(Event::Stopped));
}

/// Every k-th frame of the way up is lost, out or back in turn: it comes up all the same. (Not
/// where k is so small that a datagram loses all its four tries, which come at fixed distances
/// too.)
#[test]
fn single_losses_do_not_end_the_way_up() {
    for k in [6, 7, 8, 10, 64] {
        for first in [0, 1] {
            let lose = move |number: u64| match number % k {
                0 if number / k % 2 == first => Fate::LostOut,
                0 => Fate::LostBack,
                _ => Fate::Passes(0),
            };
            let mut bench = Bench::new(|_| {}, lose);
            bench.up(&format!("every {k}-th, {first}"));
            let lost = bench.main.statistics().frames_lost;
            assert!(lost + 8 >= bench.sent / k, "{lost} of {}", bench.sent);
        }
    }
}

/// Any one frame of the way up, be it the worst one.
#[test]
fn one_loss_anywhere_does_not_end_the_way_up() {
    let mut bench = Bench::new(|_| {}, |_| Fate::Passes(0));
    bench.up("nothing lost");
    let frames = bench.sent;
    // A prime step through all of them, dense at the start where each frame is another.
    let numbers = (0..60).chain((60..frames).step_by(1_009));
    for lost in numbers {
        for back in [false, true] {
            let lose = move |number| match (number == lost, back) {
                (true, true) => Fate::LostBack,
                (true, false) => Fate::LostOut,
                _ => Fate::Passes(0),
            };
            Bench::new(|_| {}, lose).up(&format!("frame {lost}"));
        }
    }
}

#[test]
fn nothing_behind_the_port_and_a_loop_back_are_told_apart() {
    let cause = |fate: fn(u64) -> Fate| {
        let mut bench = Bench::new(|_| {}, fate);
        let Some(Event::Failed(error)) = bench.until(Nanos::millis(2_000), over) else {
            panic!("it does not end")
        };
        assert_eq!(error.stage, Stage::Scan);
        assert_eq!(bench.main.next_timeout(), None);
        let text = error.to_string();
        (error.cause, text)
    };
    let (silent, text) = cause(|_| Fate::LostOut);
    assert!(matches!(silent, Cause::Silent { sent, foreign: None, .. } if sent > 40), "{text}");
    assert!(text.contains("no frame came back in 1.0") && text.contains("0 received"), "{text}");
    for fate in [|_| Fate::Untouched, |_| Fate::Echoed] as [fn(u64) -> Fate; 2] {
        let (empty, text) = cause(fate);
        assert_eq!(empty, Cause::Empty);
        assert!(text.contains("working counter 0, expected at least 1"), "{text}");
    }
}

/// Frames of another MainDevice are counted with its address, and never taken for answers, however
/// much they are like ours; late ones of our own are told apart.
#[test]
fn another_maindevice_on_the_wire_is_named() {
    let mut bench = Bench::new(|_| {}, |_| Fate::Passes(0));
    bench.up("nothing lost");
    let other = [0xAA, 0xBB, 0xCC, 1, 2, 3];
    let mut buffer = [0; FRAME_LEN];
    bench.until(Nanos(700_000), |_| false);
    let due = bench.main.next_timeout().expect("it runs");
    bench.main.handle_timeout(due);
    let len = bench.main.poll_transmit(due, &mut buffer).expect("a frame of the cycle");
    let mut answer = buffer[..len].to_vec();
    bench
        .segment
        .pass(&mut answer, Time::new(due.count() * 1000), &mut isocat_sim::Watcher::blind())
        .expect("it comes back");
    let (mut foreign, mut plain) = (answer.clone(), answer.clone());
    foreign[6..12].copy_from_slice(&other);
    plain[12..14].copy_from_slice(&[0x08, 0x06]);
    let before = bench.main.statistics();
    for frame in [&foreign, &plain, &buffer[..len].to_vec(), &answer, &answer] {
        bench.main.handle_frame(due + Nanos(50_000), frame);
    }
    let after = bench.main.statistics();
    assert_eq!(after.frames_received - before.frames_received, 1);
    assert_eq!((after.frames_foreign, after.foreign_source), (1, Some(other)));
    assert_eq!(after.frames_other - before.frames_other, 1);
    assert_eq!(after.frames_echoed - before.frames_echoed, 1);
    assert_eq!(after.frames_unexpected - before.frames_unexpected, 1);
    assert_eq!((after.frames_lost, after.frames_late), (before.frames_lost, before.frames_late));
}

/// The cable is pulled in operation: requests end with an error, and so does the way down.
#[test]
fn a_pulled_cable_ends_requests_and_does_not_hold_up_the_stop() {
    for gone in [|| Fate::LostOut, || Fate::Untouched] as [fn() -> Fate; 2] {
        let pulled = std::cell::Cell::new(false);
        let fate = |_| if pulled.get() { gone() } else { Fate::Passes(0) };
        let mut bench = Bench::new(|_| {}, fate);
        bench.up("nothing lost");
        let identity = ObjectAddress::new(0x1018, 1);
        bench.main.upload(0, identity);
        pulled.set(true);
        bench.main.upload(1, identity);
        bench.main.download(0, ObjectAddress::new(0x6060, 0), &[8]);
        let ended =
            |event: &Event| matches!(event, Event::Uploaded { .. } | Event::Downloaded { .. });
        for _ in 0..3 {
            let event = bench.until(Nanos::millis(2_500), ended).expect("an end in time");
            let error = match event {
                Event::Uploaded { result, .. } => result.expect_err("nobody answers"),
                Event::Downloaded { result, .. } => result.expect_err("nobody answers"),
                _ => unreachable!("no other event is an end"),
            };
            assert!(matches!(error, SdoError::Mailbox(_)), "{error}");
        }
        bench.main.upload(1, identity);
        bench.main.stop();
        let event = bench.until(Nanos::millis(500), over);
        let Some(Event::Failed(error)) = event else { panic!("{event:?}") };
        assert_eq!(error.stage, Stage::Stop);
        assert_eq!(bench.main.next_timeout(), None);
    }
}

/// And on the way up: whenever the wire goes dead, the end comes.
#[test]
fn stop_ends_the_way_up_on_a_dead_wire() {
    for after in [0, 1, 5, 20, 100, 1_000, 3_000] {
        let mut bench = Bench::new(
            |_| {},
            move |number| if number < after { Fate::Passes(0) } else { Fate::LostOut },
        );
        while bench.sent < after.max(1) {
            bench.until(Nanos(10_000), |_| false);
        }
        bench.main.stop();
        assert!(bench.until(Nanos::millis(500), over).is_some(), "after {after} frames");
    }
}

/// Random numbers of one's own, for the host below.
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    state.wrapping_mul(0x2545_F491_4F6C_DD1D)
}

/// An ordinary machine: stamps some 8 us early, one of 50 by up to a millisecond, now and then 40
/// ms of sleep. It comes up, stays locked and its frames find the reference near their phase. (40
/// cycles without outputs are more than the drives allow, so they leave OP; that is another
/// matter.)
#[test]
fn an_ordinary_host_comes_up_and_stays_locked() {
    for seed in 1..=3 {
        let mut state = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(seed);
        let held_up = move |_| {
            let uniform = (random(&mut state) >> 11) as f64 / (1u64 << 53) as f64;
            let outlier = random(&mut state) % 50 < 1;
            let more = if outlier { random(&mut state) % 1_000_000 } else { 0 };
            Fate::Passes((-(1.0 - uniform).ln() * 8_000.0) as i64 + more as i64)
        };
        let mut bench = Bench::new(
            |config| {
                config.stamp_noise = Nanos::micros(8);
                config.host_jitter = Nanos::micros(150);
                // A stall while SYNC is programmed must not make the start time pass.
                config.timeouts.sync_lead = Nanos::millis(200);
            },
            held_up,
        );
        bench.late = |number| match number % 1_000 {
            999 => 40_200_000,
            n if n % 50 == 7 => 300_000,
            n => (n % 13) as i64 * 3_000,
        };
        bench.up(&format!("seed {seed}"));
        bench.events.clear();
        let before = bench.main.statistics();
        bench.until(Nanos::millis(5_000), over);
        let after = bench.main.statistics();
        let (cycles, skipped) =
            (after.cycles - before.cycles, after.cycles_skipped - before.cycles_skipped);
        // One sleep of 40 cycles may lie across the begin, another across the end.
        assert!((4_957..=5_043).contains(&(cycles + skipped)), "{cycles} and {skipped}");
        assert!(skipped > 40, "{skipped}");
        let told: u64 = bench
            .events
            .iter()
            .map(
                |event| if let Event::CyclesSkipped { skipped, .. } = event { *skipped } else { 0 },
            )
            .sum();
        assert_eq!(told, skipped);
        let unlocked = bench.events.iter().any(|event| matches!(event, Event::Phase { .. }));
        assert!(!unlocked, "seed {seed}: {:?}", bench.events);
        let host = bench.now;
        let error =
            bench.main.system_time(host).expect("it runs") - reference(&bench.segment, host);
        assert!((-2_000..15_000).contains(&error.0), "seed {seed}: {error}");
    }
}

/// System time at the reference clock when a frame sent at `host` without delay gets there.
fn reference(segment: &Segment, host: Time<Host>) -> Time<isocat_wire::time::Dc> {
    let device = &segment.devices()[0];
    device.esc.system_time(device.oscillator().read(Time::new(host.count() * 1000)))
}
