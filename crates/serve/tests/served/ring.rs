//! A served ring without sockets: a MainDevice with two ports, in virtual time.

use crate::line::Line;
use isocat_maindevice::{Config, Event, Ring};
use isocat_segment::fault::Order;
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::deed::Deed;
use isocat_serve::{Answer, Server, Summary};
use isocat_sim::MainPort;
use isocat_wire::al::AlState;
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::time::{Nanos, Time};
use isocat_wire::{Command, register};

fn scenario(keys: &str) -> Scenario {
    let text = format!(
        "cycle = \"1ms\"\n{keys}\n[[subdevice]]\ndevice = \"simple_io16\"\nname = \"io\"\ncount = 4\n"
    );
    Scenario::from(SegmentFile::parse("a test", &text).expect("a segment"))
}

fn ring() -> Line {
    let config = Config { ring: Some(Ring::default()), ..Config::new(Nanos::millis(1)) };
    let mut line = Line::with(&scenario("ring = true"), config);
    line.bring_up();
    assert!(!line.run(Nanos::millis(200), |_| false));
    line
}

fn order(line: &mut Line, text: &str) -> Result<(), String> {
    let order = Order::parse(text, line.server.names())?;
    line.server.inject(line.now, order)
}

fn all_in_op(line: &Line) -> bool {
    let devices = line.server.served().segment().devices();
    devices.iter().all(|device| device.stack.state() == AlState::Op)
}

/// Sends one frame from this port that reads the AL status of all. Returns the port at which it
/// comes back, and the number of SubDevices that counted.
fn count(server: &mut Server, from: MainPort, now: i64) -> Option<(MainPort, u16)> {
    let mut buffer = [0; 64];
    let mut frame = FrameWriter::new(&mut buffer, [2, 0, 0, 0, 0, 1]);
    let address = Address::Broadcast(register::AL_STATUS.address);
    frame.push(Command::Brd, 1, address, &[0; 2]).expect("it fits");
    let len = frame.finish();
    let bytes = &mut buffer[..len];
    let answer = server.frame_at(from, Time::new(now as u64), bytes);
    server.after(bytes);
    match answer {
        Answer::Back { port, .. } => Some((port, u16::from_le_bytes([bytes[28], bytes[29]]))),
        Answer::Lost => None,
    }
}

#[test]
fn frames_come_out_at_the_other_end_and_turn_at_a_cut() {
    use MainPort::{Primary, Secondary};
    let mut server = Server::new(&scenario("ring = true"), Time::new(0));
    assert!(server.has_two_ports());
    let ms = 1_000_000;
    assert_eq!(count(&mut server, Primary, ms), Some((Secondary, 4)));
    // Against the processing order no SubDevice processes the frame.
    assert_eq!(count(&mut server, Secondary, 2 * ms), Some((Primary, 0)));
    for (cut, near, far) in
        [("io 0", None, Some(4)), ("io 1", Some(1), Some(3)), ("ring", Some(4), None)]
    {
        let names = server.names().to_vec();
        let mut now = server.served().now().as_nanos() as i64;
        let order = |server: &mut Server, word: &str, now: i64| {
            let order = Order::parse(&format!("{word} {cut}"), &names).expect("it reads");
            server.inject(Time::new(now as u64), order).expect("it is done");
        };
        order(&mut server, "pull", now + ms);
        now += 5 * ms;
        assert_eq!(count(&mut server, Primary, now), near.map(|count| (Primary, count)), "{cut}");
        let found = count(&mut server, Secondary, now + ms);
        assert_eq!(found, far.map(|count| (Secondary, count)), "{cut}");
        order(&mut server, "plug", now + 2 * ms);
        now += 400 * ms;
        assert_eq!(count(&mut server, Primary, now), Some((Secondary, 4)), "{cut}");
    }
    // A port of the MainDevice that is down acts as a cable without signal.
    let now = server.served().now().as_nanos() as i64 + ms;
    server.link(Time::new(now as u64), Secondary, false);
    assert_eq!(count(&mut server, Primary, now + ms), Some((Primary, 4)));
    server.link(Time::new((now + 2 * ms) as u64), Secondary, true);
    assert_eq!(count(&mut server, Primary, now + 400 * ms), Some((Secondary, 4)));
}

#[test]
fn a_main_device_with_two_ports_goes_on_behind_each_cut() {
    for cable in ["io 0", "io 1", "io 2", "io 3", "ring"] {
        let mut line = ring();
        order(&mut line, &format!("pull {cable} for 100ms")).expect("it is done");
        let is_cut = |event: &Event| matches!(event, Event::RingCut { .. });
        assert!(line.run(Nanos::millis(50), is_cut), "{cable}");
        let healed = |event: &Event| matches!(event, Event::RingHealed { .. });
        assert!(line.run(Nanos::millis(600), healed), "{cable}");
        line.run(Nanos::millis(200), |event| panic!("{cable}: {event:?}"));
        assert!(all_in_op(&line), "{cable}");
        assert!(line.main.statistics().working_counter_errors <= 3, "{cable}");
    }
}

/// Each frame is sent twice, yet each deed of the MainDevice counts once, in a whole ring and in a
/// cut one.
#[test]
fn copies_are_no_deeds() {
    let alone = Config::new(Nanos::millis(1));
    let mut straight = Line::with(&scenario(""), alone);
    straight.bring_up();
    straight.run(Nanos::millis(200), |_| false);
    let mut line = ring();
    let deeds = |line: &Line, deed: Deed| {
        line.server.session().and_then(|session| session.conduct.done(deed)).map(|done| done.count)
    };
    for deed in [Deed::Offsets, Deed::Delays, Deed::StationAddresses, Deed::SyncActivate] {
        assert_eq!(deeds(&line, deed), deeds(&straight, deed), "{deed:?}");
    }
    for cut in [false, true] {
        if cut {
            order(&mut line, "pull io 2").expect("it is done");
            line.run(Nanos::millis(20), |_| false);
        }
        let conduct = |line: &Line| line.server.session().expect("it goes on").conduct.clone();
        let before = conduct(&line);
        line.run(Nanos::millis(300), |_| false);
        let after = conduct(&line);
        let count = |deed| {
            let [before, after] = [&before, &after].map(|c| c.done(deed).map_or(0, |d| d.count));
            after - before
        };
        assert!(count(Deed::ProcessData).abs_diff(300) <= 1, "{}", count(Deed::ProcessData));
        assert!(count(Deed::DistributeTime).abs_diff(300) <= 1, "{}", count(Deed::DistributeTime));
        let (frames, copies) =
            (after.frames - before.frames, after.second_port_frames - before.second_port_frames);
        assert!(frames.abs_diff(copies) <= 1, "{frames} and {copies}");
        let intervals = after.cycle.intervals;
        assert!(intervals.largest() < 1_200_000_000, "{} ps", intervals.largest());
        assert!(intervals.least() > 800_000_000, "{} ps", intervals.least());
        assert_eq!(after.sources().len(), 1);
    }
    line.main.stop();
    assert!(line.run(Nanos::millis(5_000), |event| matches!(event, Event::Stopped)));
    line.server.finish(line.now + Nanos::millis(20_000));
    let summary = Summary::new(&line.server, "a test", "nowhere", Nanos::millis(1_000));
    assert_eq!(summary.sessions.len(), 1);
    let session = &summary.sessions[0];
    assert_eq!((session.answer, &session.remarks[..]), ("in-sync", &[][..]), "{}", summary.text());
    assert!(session.second_port_frames > 500);
}

/// If the primary port is silent, frames of the secondary one show what the MainDevice does.
#[test]
fn the_secondary_port_alone_is_heard() {
    let mut server = Server::new(&scenario("ring = true"), Time::new(0));
    for ms in 1..=101 {
        count(&mut server, MainPort::Secondary, ms * 1_000_000);
        let heard = server.session().is_some();
        assert_eq!(heard, ms == 101, "{ms}");
    }
    // It no longer counts when the primary port is heard again.
    count(&mut server, MainPort::Primary, 102_000_000);
    count(&mut server, MainPort::Secondary, 103_000_000);
    let conduct = &server.session().expect("it goes on").conduct;
    assert_eq!((conduct.frames, conduct.second_port_frames), (2, 1));
}

#[test]
fn the_cable_of_a_ring_is_refused_where_there_is_none() {
    let mut line = Line::new(&scenario(""));
    let refused = order(&mut line, "pull ring").unwrap_err();
    assert!(refused.contains("this segment is none"), "{refused}");
    assert!(!line.server.has_two_ports());
}
