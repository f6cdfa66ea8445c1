//! A run with faults, and what can be seen of it in true time.

use isocat::{Report, Scenario, SegmentFile};
use isocat_maindevice::{MainDevice, Port};
use isocat_sim::fault::Happened;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Lost, Outcome, Segment, Tap};
use isocat_wire::time::{Nanos, Time, True};
use isocat_wire::{AlState, AlStatusCode};

/// What was seen; times in ns of true time.
#[derive(Default)]
pub struct Seen {
    /// Frames that left the primary port, and those that came back.
    pub sent: Vec<u64>,
    pub back: Vec<u64>,
    /// Frames that did not: when they left, and why; `None` came back damaged.
    pub lost: Vec<(u64, Option<Lost>)>,
    /// Frames that left or came back with a source address that is not the MainDevice's.
    pub foreign: Vec<u64>,
    /// SYNC0 edges of each device.
    pub sync0: Vec<(usize, u64)>,
    /// SM2 events of each device.
    pub sm2: Vec<(usize, u64)>,
    pub states: Vec<(usize, u64, AlState, AlStatusCode)>,
    pub faults: Vec<Happened>,
    /// When all were in OP.
    pub began: u64,
    /// Cycles that were over, and when.
    pub cycles: Vec<u64>,
}

impl Tap for Seen {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        match sent {
            true => self.sent.push(at.as_nanos()),
            false => self.back.push(at.as_nanos()),
        }
        // The first device marks it.
        if bytes[6..12] == [0x02, 0x00, 0x5E, 0x00, 0x53, 0x01] {
            self.foreign.push(at.as_nanos());
        }
    }
    fn lost(&mut self, at: Time<True>, _port: Port, why: Option<Lost>) {
        self.lost.push((at.as_nanos(), why));
    }
    fn observed(&mut self, _segment: &Segment, at: Time<True>, observation: &Observation) {
        let (device, at) = (observation.device, at.as_nanos());
        match observation.event {
            Observed::Sync0 => self.sync0.push((device, at)),
            Observed::Sm2 => self.sm2.push((device, at)),
            Observed::State(state, code) => self.states.push((device, at, state, code)),
            _ => {}
        }
    }
    fn fault(&mut self, happened: &Happened) {
        self.faults.push(happened.clone());
    }
    fn judging_begins(&mut self, at: Time<True>, _intent: &isocat_sim::bench::Intent) {
        self.began = at.as_nanos();
    }
    fn cycle(&mut self, at: Time<True>, _main: &MainDevice, _segment: &Segment) {
        self.cycles.push(at.as_nanos());
    }
}

/// The segment of these tests: three devices, the second of them a drive; no jitter, so that what
/// is seen is the fault's.
pub const SEGMENT: &str = "cycle = \"1ms\"\nfor = \"2s\"\nrecovery = { first = \"20ms\", longest = \"100ms\" }\n\
    [host]\njitter = \"0ns\"\n[[subdevice]]\ndevice = \"simple_io16\"\nname = \"first\"\n\
    [[subdevice]]\ndevice = \"model_every_mode\"\nname = \"axis\"\nmode = \"dc-sync0\"\nclock = \"10ppm\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"last\"\nclock = \"-20ppm\"\n";

/// Runs it with a fault, `after` ms in operation.
pub fn with(after: u64, what: &str) -> (Seen, Report) {
    run(&format!("{SEGMENT}[[fault]]\nat = \"in-operation + {after}ms\"\nwhat = \"{what}\"\n"))
}

pub fn run(text: &str) -> (Seen, Report) {
    let (seen, report, _) = outcome(text);
    (seen, report)
}

pub fn outcome(text: &str) -> (Seen, Report, Outcome<Watching>) {
    let file = SegmentFile::parse("faults.toml", text).unwrap_or_else(|error| panic!("{error}"));
    let scenario = Scenario::from(file);
    let seen = Watching::default();
    let outcome = scenario.run().execute(Some(seen.clone()), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    let seen = std::mem::take(&mut *seen.0.borrow_mut());
    (seen, report, outcome)
}

/// The onlooker, shared with the test, which reads it afterwards.
#[derive(Clone, Default)]
pub struct Watching(std::rc::Rc<std::cell::RefCell<Seen>>);

impl Tap for Watching {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.0.borrow_mut().frame(at, sent, bytes);
    }
    fn lost(&mut self, at: Time<True>, port: Port, why: Option<Lost>) {
        self.0.borrow_mut().lost(at, port, why);
    }
    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        self.0.borrow_mut().observed(segment, at, observation);
    }
    fn fault(&mut self, happened: &Happened) {
        self.0.borrow_mut().fault(happened);
    }
    fn judging_begins(&mut self, at: Time<True>, intent: &isocat_sim::bench::Intent) {
        self.0.borrow_mut().judging_begins(at, intent);
    }
    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        self.0.borrow_mut().cycle(at, main, segment);
    }
}

impl Seen {
    /// The instant of something `ms` in operation.
    pub fn at(&self, ms: u64) -> u64 {
        self.began + ms * 1_000_000
    }

    /// How often something came between two points of operation, in ms.
    pub fn between(&self, all: &[u64], from: u64, to: u64) -> usize {
        let span = self.at(from)..self.at(to);
        all.iter().filter(|at| span.contains(at)).count()
    }

    /// SYNC0 edges of a device between two points of operation, in ms.
    pub fn edges(&self, device: usize, from: u64, to: u64) -> usize {
        let of: Vec<u64> =
            self.sync0.iter().filter(|(of, _)| *of == device).map(|(_, at)| *at).collect();
        self.between(&of, from, to)
    }

    /// SM2 events of a device between two points of operation, in ms.
    pub fn outputs(&self, device: usize, from: u64, to: u64) -> usize {
        let of: Vec<u64> =
            self.sm2.iter().filter(|(of, _)| *of == device).map(|(_, at)| *at).collect();
        self.between(&of, from, to)
    }

    /// Changes of the state of a device in operation: ms, state, code.
    pub fn moves(&self, device: usize) -> Vec<(u64, AlState, u16)> {
        let moves = self.states.iter().filter(|(of, at, ..)| *of == device && *at > self.began);
        moves
            .map(|(_, at, state, code)| ((at + 1_000 - self.began) / 1_000_000, *state, code.0))
            .collect()
    }

    /// When faults began and ended, in ns of operation.
    pub fn instants(&self) -> Vec<(i64, bool)> {
        let since = |at: Time<True>| at.as_nanos() as i64 - self.began as i64;
        self.faults.iter().map(|happened| (since(happened.at), happened.begins)).collect()
    }
}

/// In ns.
pub fn ms(ms: i64) -> i64 {
    Nanos::millis(ms).0
}
