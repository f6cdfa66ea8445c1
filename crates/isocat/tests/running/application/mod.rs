//! The application's door: it is called once a cycle, when the last frame of the cycle is back or
//! given up, and is told which inputs are fresh. Held against the frames on the wire and what the
//! devices count themselves.

#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod interface;
mod line;
mod witness;

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use isocat_maindevice::{Event, MainDevice, Ring};
use isocat_sim::{BitError, Cable, Direction, HostModel, Segment, Setup, Tap, World};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{Command, PortNumber, datagram, frame, register};

use line::IN_A_FRAME;
use witness::Witness;

const CYCLE: Nanos = Nanos::millis(2);

/// What left and came back of the present cycle, and when it was told to be over.
#[derive(Clone, Default)]
struct Order(Rc<RefCell<Seen>>);

#[derive(Default)]
struct Seen {
    called: Rc<Cell<u64>>,
    /// Frames of the present cycle that left and that came back, and when the first left.
    sent: usize,
    back: usize,
    begun: Time<True>,
    cycles: u64,
    /// Cycles that were told, and how many of these were given up.
    told: u64,
    given_up: u64,
    /// Most frames of a cycle, and acyclic frames.
    most: usize,
    acyclic: u64,
    wrong: Vec<String>,
}

impl Tap for Order {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        let mut seen = self.0.borrow_mut();
        let payload = frame::payload(bytes).expect("our own frame");
        let first = datagram::datagrams(payload).next().expect("a datagram").expect("whole");
        // Frames of the cycle have the upper half of the indices.
        if payload[1] < 0x80 {
            seen.acyclic += u64::from(sent);
            return;
        }
        if !sent {
            seen.back += 1;
            return;
        }
        let command = first.header.command();
        let leads = matches!(command, Ok(Command::Frmw | Command::Fprd));
        if leads && first.header.ado() == register::SYSTEM_TIME.address {
            if seen.told != seen.cycles {
                let (told, cycles) = (seen.told, seen.cycles);
                seen.wrong.push(format!("{cycles} cycles begun, {told} told, and the next leaves"));
            }
            (seen.sent, seen.back, seen.begun) = (0, 0, at);
            seen.cycles += 1;
        }
        seen.sent += 1;
        seen.most = seen.most.max(seen.sent);
    }

    fn secondary_frame(&mut self, _: Time<True>, sent: bool, bytes: &[u8]) {
        // In a whole ring the answers come in here.
        let cyclic = frame::payload(bytes).is_ok_and(|payload| payload[1] >= 0x80);
        self.0.borrow_mut().back += usize::from(!sent && cyclic);
    }

    fn cycle(&mut self, at: Time<True>, main: &MainDevice, _: &Segment) {
        let mut seen = self.0.borrow_mut();
        seen.told += 1;
        let number = main.statistics().cycles;
        let missing = seen.sent.saturating_sub(seen.back);
        let waited = at - seen.begun;
        if seen.told != seen.cycles || number != seen.cycles {
            seen.wrong.push(format!("cycle {number} is told {waited:?} behind its begin"));
        }
        if missing > 0 {
            seen.given_up += 1;
            // Not before the next one is due; this one may have left late.
            if waited < Picos::from(CYCLE) + Picos::from(Nanos(-50_000)) {
                seen.wrong.push(format!("cycle {number}: told with {missing} frames under way"));
            }
        }
        if missing == 0 && seen.sent == 0 {
            seen.wrong.push(format!("cycle {number} has no frames"));
        }
    }
}

struct Run {
    world: World<Witness, Order>,
    seen: Order,
}

impl Run {
    /// A line that has just come into operation.
    fn new(devices: usize, slow: usize, every: i64, change: impl FnOnce(&mut Setup)) -> Self {
        let config = line::config(CYCLE, devices, slow, every);
        let (host, segment) = (HostModel::default(), line::connections(devices));
        let mut setup = Setup::new(1, config, host, segment);
        change(&mut setup);
        let ring = setup.config.ring.is_some();
        let (witness, seen) = (Witness::default(), Order::default());
        seen.0.borrow_mut().called = witness.called.clone();
        let mut world = World::new(setup, witness, Some(seen.clone()));
        if ring {
            let segment = world.segment_mut();
            let cable = Cable::of_length(1_000);
            segment.close_ring(devices - 1, PortNumber::P1, cable).expect("the port is free");
        }
        loop {
            assert!(world.step(Time::new(60_000_000_000_000)), "it does not come up");
            match world.poll_event() {
                Some(Event::InOperation { .. }) => break,
                Some(Event::Failed(error)) => panic!("{error}"),
                _ => {}
            }
        }
        Self { world, seen }
    }

    /// Lets this number of milliseconds pass; every 7 ms `disturb` is called.
    fn run(&mut self, ms: i64, disturb: impl Fn(&mut Segment, Time<True>, i64)) {
        let begin = self.world.now();
        for at in (0..ms).step_by(7) {
            let end = begin + Picos::from(Nanos::millis(at));
            disturb(self.world.segment_mut(), end, at);
            while self.world.step(end) {
                while self.world.poll_event().is_some() {}
            }
        }
    }

    /// Everything was as it must be; gives the application.
    fn judge(&self, frames: usize) -> &Witness {
        let (seen, witness) = (self.seen.0.borrow(), self.world.application());
        assert_eq!(seen.wrong, [""; 0]);
        assert_eq!(witness.wrong, [""; 0]);
        assert_eq!(witness.unpunctual, 0);
        assert_eq!(seen.most, frames, "frames a cycle");
        assert!(seen.cycles - seen.told <= 1);
        assert_eq!(seen.called.get(), seen.told, "the last call was for the last cycle told");
        assert!(witness.requests.0 > 100, "{:?}", witness.requests);
        assert!(witness.requests.0 - witness.requests.1 < 10, "{:?}", witness.requests);
        assert!(seen.acyclic > witness.requests.1);
        witness
    }
}

/// Hits a frame on the first cable: on the way out, or on the way back.
fn lose(segment: &mut Segment, now: Time<True>, number: i64) {
    let directions = [Direction::Out, Direction::Back];
    let direction = directions[number as usize % 2];
    // Somewhere in the cycle, so that each of its frames is hit now and then.
    let at = now + Picos::from(Nanos(number * 37_000 % 2_000_000));
    segment.disturb(BitError { cable: 0, direction, at, bit: 300 });
}

fn nothing(_: &mut Segment, _: Time<True>, _: i64) {}

#[test]
fn it_is_called_once_a_cycle_behind_its_last_frame() {
    for frames in [1, 2, 3, 5] {
        let devices = frames * IN_A_FRAME - 1;
        let mut run = Run::new(devices, 0, 1, |_| {});
        run.world.application_mut().forget_loops();
        run.run(1_000, nothing);
        let witness = run.judge(frames);
        assert_eq!(run.seen.0.borrow().given_up, 0);
        for position in 0..devices {
            assert_eq!((witness.stale[position], witness.apart[position]), (0, 0));
            assert!(witness.fresh[position] >= 495, "{:?}", witness.fresh);
        }
        // What is written reaches every device in the next cycle, and is back in the same one after
        // it.
        let (least, most) = witness.loops.expect("it was measured");
        println!("{frames} frames a cycle: {} calls, back after {least} cycles", witness.calls);
        assert_eq!((least, most), (2, 2));
    }
}

#[test]
fn lost_frames_leave_stale_inputs_and_nobody_waits_for_them() {
    for frames in [1, 2, 3, 5] {
        let devices = frames * IN_A_FRAME - 1;
        let mut run = Run::new(devices, 0, 1, |_| {});
        run.run(7_000, lose);
        let given_up = run.seen.0.borrow().given_up;
        let witness = run.judge(frames);
        let stale = &witness.stale;
        println!("{frames} frames a cycle: {given_up} cycles given up, stale {stale:?}");
        assert!(given_up > 20, "{given_up}");
        // The devices of a frame are stale together, and of each frame now and then.
        for group in stale.chunks(IN_A_FRAME) {
            assert!(group[0] > 0 && group.iter().all(|count| *count == group[0]), "{stale:?}");
        }
        let lost: u64 = stale.chunks(IN_A_FRAME).map(|group| group[0]).sum();
        assert!(lost >= given_up, "{lost} chunks in {given_up} cycles");
        assert!(witness.fresh.iter().zip(stale).all(|(fresh, stale)| fresh + stale >= 3_490));
    }
}

#[test]
fn a_group_with_a_longer_cycle_is_fresh_in_its_own_cycles() {
    for disturb in [nothing as fn(&mut Segment, Time<True>, i64), lose] {
        let mut run = Run::new(9, 4, 5, |_| {});
        run.run(7_000, disturb);
        let witness = run.judge(2);
        println!("fresh {:?}, stale {:?}, apart {:?}", witness.fresh, witness.stale, witness.apart);
        assert!(witness.apart[..5].iter().all(|count| *count == 0));
        for position in 5..9 {
            let took_part = witness.fresh[position] + witness.stale[position];
            assert!(took_part.abs_diff(witness.apart[position] / 4) <= 2);
        }
    }
}

#[test]
fn in_a_ring_it_makes_no_difference_where_frames_come_back() {
    let ring = |setup: &mut Setup| {
        setup.config.ring = Some(Ring::default());
        setup.config.readmission = Some(isocat_maindevice::Readmission::default());
    };
    let mut run = Run::new(9, 0, 1, ring);
    run.run(1_000, nothing);
    let witness = run.judge(2);
    assert!(witness.stale.iter().all(|count| *count == 0), "{:?}", witness.stale);
    assert!(witness.fresh.iter().all(|count| *count >= 495), "{:?}", witness.fresh);
}

/// Process data do not run before SAFEOP, nor after it: no call there, and none missing in between.
#[test]
fn cycles_without_process_data_call_nobody() {
    let mut run = Run::new(4, 0, 1, |_| {});
    let before = {
        let seen = run.seen.0.borrow();
        let witness = run.world.application();
        assert!(witness.calls >= 10 && witness.calls < seen.told, "{}", witness.calls);
        seen.told - witness.calls
    };
    run.run(200, nothing);
    assert_eq!(run.seen.0.borrow().told - run.world.application().calls, before);
    run.world.main_mut().stop();
    run.run(2_000, nothing);
    assert_eq!(run.world.main().next_cycle(), None, "it has ended");
    let (seen, witness) = (run.seen.0.borrow(), run.world.application());
    // Frames on the way from SAFEOP to INIT do not call the application either.
    assert!(seen.told - witness.calls >= before);
    assert_eq!((&seen.wrong[..], &witness.wrong[..]), (&[][..], &[][..]));
}
