use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::datagram::{Address, HEADER_LEN, Header};

use super::*;

/// Frames at given times, to four devices without mailbox.
struct Bench {
    server: Server,
    now: Time<Host>,
}

impl Bench {
    fn new() -> Self {
        let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 4\n";
        let file = SegmentFile::parse("four.toml", text).expect("it reads");
        let now = Time::new(1_000_000_000);
        Self { server: Server::new(&Scenario::from(file), now), now }
    }

    /// Sends one datagram, `ms` after the one before.
    fn send(&mut self, ms: i64, command: Command, address: Address, data: &[u8]) {
        self.now += Nanos::millis(ms);
        let mut bytes = [[0xFF; 6], [0x10; 6]].concat();
        bytes.extend([0x88, 0xA4]);
        bytes.extend(((HEADER_LEN + data.len() + 2) as u16 | 0x1000).to_le_bytes());
        bytes.extend(Header::new(command, 0, address, data.len() as u16).emit());
        bytes.extend(data);
        bytes.extend([0, 0]);
        bytes.resize(bytes.len().max(60), 0);
        self.server.frame(self.now, &mut bytes);
        self.server.after(&bytes);
    }

    fn exchange(&mut self, ms: i64) {
        self.send(ms, Command::Lrw, Address::Logical(0), &[0; 8]);
    }

    fn request(&mut self, ms: i64, state: u8) {
        self.send(ms, Command::Bwr, Address::Broadcast(0x0120), &[state, 0]);
    }

    /// The ends of the sessions so far.
    fn ends(&self) -> Vec<End> {
        self.server.sessions().iter().map(|session| session.end).collect()
    }
}

#[test]
fn a_session_after_a_kill_begins_behind_frames_that_say_nothing() {
    let mut bench = Bench::new();
    bench.request(0, 1);
    bench.request(1, 8);
    bench.exchange(1);
    // SOEM first writes 0 to the alias bit of all SubDevices.
    bench.send(500, Command::Bwr, Address::Broadcast(0x0103), &[0]);
    assert_eq!(bench.ends(), []);
    bench.request(1, 1);
    assert_eq!(bench.ends(), [End::Abrupt], "it was asked to be in OP");
    let session = bench.server.session().expect("the next one");
    assert_eq!(session.conduct.frames, 1);
}

#[test]
fn a_pause_alone_ends_no_session() {
    let mut bench = Bench::new();
    bench.request(0, 8);
    bench.exchange(1);
    bench.exchange(500);
    bench.request(1, 1);
    assert_eq!(bench.ends(), [], "the exchange went on: this is the way down");
    bench.request(1, 8);
    bench.send(500, Command::Brd, Address::Broadcast(0x0130), &[0, 0]);
    bench.exchange(1);
    bench.send(1, Command::Brd, Address::Broadcast(0x0000), &[0]);
    assert_eq!(bench.ends(), []);
    bench.server.finish(bench.now + Nanos::millis(1_000));
    assert_eq!(bench.ends(), [End::Abrupt]);
}

#[test]
fn the_oldest_sessions_are_forgotten_and_counted() {
    let mut bench = Bench::new();
    for _ in 0..5 {
        bench.request(500, 1);
        bench.request(1, 8);
        bench.exchange(1);
    }
    bench.request(500, 1);
    assert_eq!(bench.ends().len(), 5);
    let began: Vec<_> = bench.server.sessions().iter().map(|s| s.conduct.began).collect();
    let records: usize = bench.server.sessions().iter().map(Session::records).sum();
    bench.server.forget_oldest(records);
    assert_eq!((bench.ends().len(), bench.server.left_out().sessions), (5, 0));
    bench.server.forget_oldest(records - 1);
    assert_eq!((bench.ends().len(), bench.server.left_out().sessions), (4, 1));
    assert_eq!(bench.server.sessions()[0].conduct.began, began[1]);
    bench.server.forget_oldest(0);
    assert_eq!((bench.ends().len(), bench.server.left_out().sessions), (1, 4));
    assert_eq!(bench.server.sessions()[0].conduct.began, began[4]);
}

#[test]
fn of_too_many_stretches_those_that_were_not_in_sync_stay() {
    let stretch = |number: u64, devices_in_op| {
        let at = Time::new(number);
        Judged {
            began: at,
            ended: at,
            devices_in_op,
            devices: Vec::new(),
            findings: Vec::new(),
            ruling: <_>::default(),
            evidence: Default::default(),
        }
    };
    let mut session = Session::new(Time::ZERO);
    for number in 0..MOST_STRETCHES as u64 {
        session.remember(stretch(number, 1));
    }
    session.remember(stretch(1_000, 1));
    assert_eq!((session.earlier.len(), session.earlier_left_out), (MOST_STRETCHES, 1));
    assert!(session.earlier.iter().all(Judged::in_sync));
    session.remember(stretch(1_001, 0));
    assert_eq!((session.earlier.len(), session.earlier_left_out), (MOST_STRETCHES, 2));
    let not: Vec<_> = session.earlier.iter().filter(|stretch| !stretch.in_sync()).collect();
    assert_eq!(
        (not.len(), not[0].began, session.earlier[0].began),
        (1, Time::new(1_001), Time::new(1))
    );
}

#[test]
fn the_oldest_faults_are_forgotten_and_counted() {
    let mut bench = Bench::new();
    for _ in 0..=1_000 {
        let order = Order::parse("drop 1", bench.server.names()).expect("it reads");
        bench.server.inject(bench.now, order).expect("it is taken");
    }
    assert_eq!((bench.server.faults().len(), bench.server.left_out().faults), (1_000, 1));
}

/// The effects of a line of `control`, and its refusals: the MainDevice's machine is not simulated.
#[test]
fn faults_that_are_ordered_happen_and_end() {
    let mut bench = Bench::new();
    let order = |bench: &mut Bench, text: &str| {
        let order = Order::parse(text, bench.server.names()).expect("it reads");
        bench.server.inject(bench.now, order)
    };
    let count = |bench: &mut Bench| {
        let before = bench.server.counts();
        bench.send(1, Command::Brd, Address::Broadcast(0x0130), &[0, 0]);
        let after = bench.server.counts();
        let copies = std::iter::from_fn(|| bench.server.take_copy()).count();
        (after.answered - before.answered, after.lost - before.lost, copies)
    };
    assert_eq!(count(&mut bench), (1, 0, 0));
    order(&mut bench, "double 1 back").expect("it is taken");
    assert_eq!([count(&mut bench), count(&mut bench)], [(1, 0, 1), (1, 0, 0)]);
    order(&mut bench, "double 1 out").expect("it is taken");
    assert_eq!([count(&mut bench), count(&mut bench)], [(1, 0, 1), (1, 0, 0)]);
    order(&mut bench, "drop 1 back at 2").expect("it is taken");
    assert_eq!([count(&mut bench), count(&mut bench)], [(0, 1, 0), (1, 0, 0)]);
    order(&mut bench, "loss 100% for 3ms").expect("it is taken");
    let lost = [(); 4].map(|()| count(&mut bench).1);
    assert_eq!(lost, [1, 1, 0, 0], "the one at its end is not lost");
    let refused = order(&mut bench, "stall 5ms").expect_err("nobody knows its machine");
    assert!(refused.contains("not simulated"), "{refused}");
    let words: Vec<String> = bench.server.faults().map(ToString::to_string).collect();
    assert_eq!(words.len(), 5, "{words:?}");
    assert_eq!(words[4], "over: 100 % of all frames are lost");
}
