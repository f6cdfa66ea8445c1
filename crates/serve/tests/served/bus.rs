//! The bus in virtual time, with a real MainDevice instead of the simulation's.

use std::hash::{DefaultHasher, Hash, Hasher};

use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
use isocat_segment::fault::Order;
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::bus::{Bus, LENGTHS, LONGEST, LONGEST_STEP, MOST_WAITING, Refused};
use isocat_serve::{Answer, Summary};
use isocat_sim::MainPort;
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlState, Command, register};

const BEGIN: Time<Host> = Time::new(7_000_000_000);

fn scenario(keys: &str) -> Scenario {
    let text =
        format!("cycle = \"1ms\"\n{keys}\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = 3\n");
    Scenario::from(SegmentFile::parse("a test", &text).expect("a segment"))
}

fn bus(keys: &str) -> Bus {
    Bus::new(&scenario(keys), BEGIN)
}

/// A frame that counts all SubDevices.
fn count() -> Vec<u8> {
    let mut buffer = [0; 64];
    let mut frame = FrameWriter::new(&mut buffer, [2, 0, 0, 0, 0, 1]);
    let address = Address::Broadcast(register::AL_STATUS.address);
    frame.push(Command::Brd, 1, address, &[0; 2]).expect("it fits");
    let len = frame.finish();
    buffer[..len].to_vec()
}

/// Drives a MainDevice for `span`. While it waits, time moves in steps of `look`, or in one step.
/// Returns a hash of all answers.
fn run(bus: &mut Bus, main: &mut MainDevice, span: Nanos, look: Option<Nanos>) -> u64 {
    let end = bus.now() + span;
    let mut wire = DefaultHasher::new();
    while bus.now() < end {
        let mut buffer = [0; FRAME_LEN];
        while let Some(len) = main.poll_transmit(bus.now(), &mut buffer) {
            bus.send(MainPort::Primary, bus.now(), &buffer[..len]).expect("a frame");
        }
        while let Some(event) = main.poll_event() {
            assert!(!matches!(event, Event::Failed(_)), "{event:?}");
        }
        let wanted = main.next_timeout().unwrap_or(end).min(end);
        let due = bus.next_arrival().map_or(wanted, |at| at.min(wanted)).max(bus.now());
        if let Some(look) = look {
            while bus.now() + look < due {
                bus.advance(bus.now() + look).expect("time goes on");
            }
        }
        bus.advance(due).expect("time goes on");
        match bus.receive() {
            Some(arrival) => {
                (arrival.at.count(), &arrival.frame).hash(&mut wire);
                main.handle_frame(arrival.at, &arrival.frame);
            }
            None => main.handle_timeout(bus.now()),
        }
    }
    wire.finish()
}

fn session(look: Option<Nanos>) -> Summary {
    let mut bus = bus("");
    let mut main = MainDevice::new(Config::new(Nanos::millis(1)), BEGIN);
    run(&mut bus, &mut main, Nanos::millis(700), look);
    bus.finish();
    bus.summary("a test", "virtual time")
}

#[test]
fn a_main_device_comes_up_and_steps_of_time_change_nothing() {
    let summary = session(None);
    assert_eq!(summary.sessions.len(), 1);
    let judged = summary.sessions[0].judged.as_ref().expect("in operation");
    assert!(judged.in_sync && judged.in_op == 3, "{}", summary.text());
    assert_eq!(session(None), summary, "the same again");
    assert_eq!(session(Some(Nanos::micros(77))), summary, "in small steps");
}

#[test]
fn a_look_at_states_changes_nothing_on_the_wire() {
    let wire = |asks: bool| {
        let mut bus = bus("");
        let mut main = MainDevice::new(Config::new(Nanos::millis(1)), BEGIN);
        let mut wire = Vec::new();
        for _ in 0..500 {
            wire.push(run(&mut bus, &mut main, Nanos::micros(777), None));
            if asks {
                bus.state(0);
                bus.outputs(1);
                bus.summary("a test", "virtual time");
            }
        }
        assert_eq!(bus.state(2).map(|(state, _)| state), Some(AlState::Op));
        wire
    };
    assert_eq!(wire(false), wire(true));
}

#[test]
fn a_summary_in_the_middle_is_as_of_then_and_the_session_goes_on() {
    let mut bus = bus("");
    let mut main = MainDevice::new(Config::new(Nanos::millis(1)), BEGIN);
    let judged = |bus: &mut Bus| {
        let summary = bus.summary("a test", "virtual time");
        assert_eq!(summary.sessions.len(), 1);
        summary.sessions[0].judged.as_ref().expect("in operation").judged_ns
    };
    run(&mut bus, &mut main, Nanos::millis(700), None);
    let before = judged(&mut bus);
    run(&mut bus, &mut main, Nanos::millis(100), None);
    let later = judged(&mut bus);
    assert!((99_000_000..=101_000_000).contains(&(later - before)), "{before} {later}");
}

#[test]
fn process_data_and_states_are_as_of_now() {
    let mut bus = bus("");
    assert_eq!(bus.state(0).map(|(state, _)| state), Some(AlState::Init));
    assert_eq!((bus.state(3), bus.outputs(3), bus.outputs(0)), (None, None, None));
    let mut main = MainDevice::new(Config::new(Nanos::millis(1)), BEGIN);
    run(&mut bus, &mut main, Nanos::millis(700), None);
    assert_eq!(bus.state(2).map(|(state, _)| state), Some(AlState::Op));
    main.outputs_mut(1).fill(0xA5);
    bus.set_inputs(1, Some(&[0x5A]));
    run(&mut bus, &mut main, Nanos::millis(5), None);
    assert_eq!(bus.outputs(1), Some(vec![0xA5; 4]));
    assert_eq!(main.inputs(1)[0], 0x5A);
    bus.set_inputs(1, None);
    run(&mut bus, &mut main, Nanos::millis(5), None);
    assert_eq!(main.inputs(1)[0], 0xA5, "its application's");
}

#[test]
fn faults_happen_at_their_instants() {
    let mut bus = bus("");
    let mut order = |text: &str, after: i64| {
        let order = Order::parse(text, bus.server().names()).expect("an order");
        bus.inject_at(BEGIN + Nanos::micros(after), order)
    };
    order("drop 1", 1_000).expect("planned");
    order("double 1 back", 2_000).expect("planned");
    assert!(order("pull ring", 10).is_err_and(|error| error.contains("ring")));
    assert!(order("drop 1", -1).is_err_and(|error| error.contains("passed")));
    let frame = count();
    let mut send = |micros: i64| {
        let at = BEGIN + Nanos::micros(micros);
        let answer = bus.send(MainPort::Primary, at, &frame).expect("a frame");
        bus.advance(at + Nanos::micros(100)).expect("time goes on");
        (answer, std::iter::from_fn(|| bus.receive()).count())
    };
    let back = |answer: Answer| matches!(answer, Answer::Back { .. });
    assert!(matches!(send(800), (answer, 1) if back(answer)), "before the first fault");
    assert!(matches!(send(1_000), (Answer::Lost, 0)), "at its very instant");
    assert!(matches!(send(1_800), (answer, 1) if back(answer)), "it was one frame");
    assert!(matches!(send(2_000), (answer, 2) if back(answer)), "doubled");
    assert_eq!(bus.summary("a test", "virtual time").faults.len(), 2);
}

#[test]
fn answers_wait_for_their_last_bit() {
    let mut bus = bus("");
    let answer = bus.send(MainPort::Primary, BEGIN, &count()).expect("a frame");
    let Answer::Back { last_bit, port, .. } = answer else { panic!("{answer:?}") };
    // The time of 84 bytes on a wire of 100 Mbit/s, and of three devices.
    assert!((Nanos(6_720)..Nanos(12_000)).contains(&(last_bit - BEGIN)), "{:?}", last_bit - BEGIN);
    assert_eq!((bus.next_arrival(), port), (Some(last_bit), MainPort::Primary));
    bus.advance(last_bit + Nanos(-1)).expect("time goes on");
    assert_eq!(bus.receive(), None, "a nanosecond too early");
    bus.advance(last_bit).expect("time goes on");
    assert_eq!(bus.receive_at(MainPort::Secondary), None, "not there");
    let arrival = bus.receive().expect("it is back");
    assert_eq!((arrival.at, arrival.frame[28]), (last_bit, 3), "three counted");
    assert_eq!((bus.receive(), bus.next_arrival()), (None, None));
}

#[test]
fn what_can_not_be_is_refused_and_changes_nothing() {
    let mut bus = bus("");
    let frame = count();
    bus.advance(BEGIN + Nanos(5)).expect("time goes on");
    let now = bus.now();
    let earlier = Time::new(now.count() - 1);
    assert_eq!(bus.advance(earlier), Err(Refused::Backwards { at: earlier, now }));
    assert!(bus.send(MainPort::Primary, earlier, &frame).is_err());
    assert_eq!(bus.advance(now), Ok(()));
    let latest = now + LONGEST_STEP;
    assert_eq!(
        bus.advance(latest + Nanos(1)),
        Err(Refused::TooFar { at: latest + Nanos(1), latest })
    );
    assert!(bus.advance(Time::NEVER).is_err());
    for length in [0, LENGTHS.start() - 1, LENGTHS.end() + 1, 1 << 20] {
        let sent = bus.send(MainPort::Primary, now, &vec![0; length]);
        assert_eq!(sent, Err(Refused::Length(length)));
    }
    for length in [*LENGTHS.start(), *LENGTHS.end()] {
        assert!(bus.send(MainPort::Primary, now, &vec![0; length]).is_ok(), "{length}");
    }
    assert_eq!(bus.send(MainPort::Secondary, now, &frame), Err(Refused::NoSuchPort));
    assert_eq!(bus.link(MainPort::Secondary, false), Err(Refused::NoSuchPort));
    assert_eq!(bus.now(), now, "time stands where it stood");
}

#[test]
fn a_bus_ends_after_a_month() {
    let mut bus = bus("");
    let end = BEGIN + LONGEST;
    bus.advance(BEGIN + LONGEST_STEP).expect("time goes on");
    let mut plan = |at: Time<Host>| {
        let order = Order::parse("drop 1", bus.server().names()).expect("an order");
        bus.inject_at(at, order)
    };
    assert_eq!(plan(end), Ok(()), "in its last instant");
    assert!(plan(end + Nanos(1)).is_err_and(|error| error.contains("too far ahead")));
    assert!(plan(Time::NEVER).is_err());
}

#[test]
fn answers_that_are_not_taken_do_not_fill_memory() {
    let mut bus = bus("");
    let frame = count();
    for number in 0..MOST_WAITING as i64 + 3 {
        bus.send(MainPort::Primary, BEGIN + Nanos::micros(10 * number), &frame).expect("a frame");
    }
    assert_eq!(bus.overrun(), 3);
    bus.advance(bus.now() + Nanos::millis(1)).expect("time goes on");
    assert_eq!(std::iter::from_fn(|| bus.receive()).count(), MOST_WAITING);
}

#[test]
fn a_ring_has_two_ports() {
    let mut bus = bus("ring = true");
    let answer = bus.send(MainPort::Primary, BEGIN, &count()).expect("a frame");
    assert!(matches!(answer, Answer::Back { port: MainPort::Secondary, .. }), "{answer:?}");
    bus.advance(BEGIN + Nanos::micros(100)).expect("time goes on");
    assert_eq!(bus.receive_at(MainPort::Primary), None);
    assert!(bus.receive_at(MainPort::Secondary).is_some());
    bus.link(MainPort::Secondary, false).expect("it has one");
    bus.advance(bus.now() + Nanos::millis(20)).expect("time goes on");
    let answer = bus.send(MainPort::Primary, bus.now(), &count()).expect("a frame");
    assert!(matches!(answer, Answer::Back { port: MainPort::Primary, .. }), "it turns: {answer:?}");
}
