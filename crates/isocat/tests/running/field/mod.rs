//! A segment in operation, judged in true time: what happened at each SubDevice and what the
//! MainDevice said.
#![allow(dead_code, reason = "each test file uses its part")]

use std::cell::RefCell;
use std::rc::Rc;

use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::{Error, Event, Motion};
use isocat_sim::judge::Grid;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Segment, Setup, Tap, World};
use isocat_subdevice::Step;
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{AlState, Command, datagram, frame};

/// What happened at one SubDevice, in true time.
#[derive(Default)]
pub struct Seen {
    /// SYNC0 edges.
    pub edges: Vec<Time<True>>,
    /// Outputs stored.
    pub stored: Vec<Time<True>>,
    /// Outputs applied.
    pub applied: Vec<Time<True>>,
    pub states: Vec<(Time<True>, AlState)>,
    pub missed: Vec<Time<True>>,
}

#[derive(Default)]
pub struct Record {
    pub devices: Vec<Seen>,
    /// Broadcast writes since operation: address.
    pub broadcasts: Vec<u16>,
    pub judging: bool,
    /// When the last frame of the cycle left.
    pub sent: Time<True>,
}

/// Writes it all down.
#[derive(Clone, Default)]
pub struct Witness(pub Rc<RefCell<Record>>);

impl Tap for Witness {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        let mut record = self.0.borrow_mut();
        if !sent || !record.judging {
            return;
        }
        if bytes[frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN] == Command::Frmw as u8 {
            record.sent = at;
        }
        for datagram in datagram::datagrams(frame::payload(bytes).expect("our own frame")) {
            let header = datagram.expect("our own datagram").header;
            if header.command().is_ok_and(|command| command == Command::Bwr) {
                record.broadcasts.push(header.ado());
            }
        }
    }

    fn observed(&mut self, _: &Segment, at: Time<True>, observation: &Observation) {
        let mut record = self.0.borrow_mut();
        if record.devices.len() <= observation.device {
            record.devices.resize_with(observation.device + 1, Seen::default);
        }
        let seen = &mut record.devices[observation.device];
        match observation.event {
            Observed::Sync0 => seen.edges.push(at),
            Observed::Sm2 => seen.stored.push(at),
            Observed::Began(Step::OutputsValid) => seen.applied.push(at),
            Observed::State(state, _) => seen.states.push((at, state)),
            Observed::SmEventMissed(_) => seen.missed.push(at),
            _ => {}
        }
    }
}

/// A run in operation, what was seen of it and what the MainDevice said.
pub struct Field {
    pub world: World<Motion, Witness>,
    pub witness: Witness,
    pub events: Vec<(Time<True>, Event)>,
    pub began: Time<True>,
}

pub const MS: Picos = Picos(1_000_000_000);
pub const CYCLE: i64 = 1_000_000_000;
/// Error of a clock that has just come back, ps: what counts as converged (100 ns), and what it
/// still slides.
pub const FRESH: i64 = 150_000;

impl Field {
    /// Brings a segment up.
    pub fn up(text: &str, change: impl FnOnce(&mut Setup)) -> Self {
        Self::up_wired(text, change, |_| {}).unwrap_or_else(|error| panic!("{error}"))
    }

    /// The same with changes of the wiring; the error if it does not come up.
    pub fn up_wired(
        text: &str,
        change: impl FnOnce(&mut Setup),
        wire: impl FnOnce(&mut Segment),
    ) -> Result<Self, Error> {
        let scenario = Scenario::from(SegmentFile::parse("change.toml", text).expect("it reads"));
        let mut setup = scenario.run().setup;
        change(&mut setup);
        let witness = Witness::default();
        let mut world = World::new(setup, Motion::default(), Some(witness.clone()));
        wire(world.segment_mut());
        let limit = Time::new(30_000_000_000_000);
        loop {
            match world.poll_event() {
                Some(Event::InOperation { .. }) => break,
                Some(Event::Failed(error)) => return Err(error),
                Some(_) => {}
                None => assert!(world.step(limit), "the segment does not come up"),
            }
        }
        witness.0.borrow_mut().judging = true;
        let began = world.now();
        let mut field = Self { world, witness, events: Vec::new(), began };
        field.run(50);
        Ok(field)
    }

    /// Runs for this number of milliseconds.
    pub fn run(&mut self, milliseconds: i64) {
        let end = self.world.now() + Picos(milliseconds * MS.0);
        while self.world.step(end) {
            self.take_events();
        }
        self.take_events();
        self.world.catch_up();
    }

    /// Runs until this happened, at most this number of milliseconds; returns the instant.
    pub fn until(&mut self, milliseconds: i64, is: impl Fn(&Event) -> bool) -> Time<True> {
        let end = self.world.now() + Picos(milliseconds * MS.0);
        loop {
            let more = self.world.step(end);
            let from = self.events.len();
            self.take_events();
            if let Some((at, _)) = self.events[from..].iter().find(|(_, event)| is(event)) {
                return *at;
            }
            assert!(more, "it did not happen: {:#?}", self.told());
        }
    }

    pub fn take_events(&mut self) {
        while let Some(event) = self.world.poll_event() {
            self.events.push((self.world.now(), event));
        }
    }

    /// A while after the next cycle's frames, so that none meets what is done then.
    pub fn soon(&self) -> Time<True> {
        self.world.now() + Picos(300_000_000)
    }

    pub fn told(&self) -> Vec<&Event> {
        self.events.iter().map(|(_, event)| event).collect()
    }

    pub fn count(&self, is: impl Fn(&Event) -> bool) -> usize {
        self.events.iter().filter(|(_, event)| is(event)).count()
    }

    pub fn state(&self, device: usize) -> AlState {
        self.world.segment().devices()[device].stack.state()
    }

    /// Largest distance of SYNC0 edges from the grid asked for, by the oscillator of the SubDevice
    /// that led from the start, in ps; from a point of true time on. And how many edges there were.
    pub fn worst_edge(&self, device: usize, since: Time<True>) -> (i64, usize) {
        let timing = self.world.main().segment().timing.clone().expect("it was planned");
        let phase = timing.devices[device].0.sync0_phase(timing.sync0.expect("SYNC0 is in use"));
        let grid = Grid { cycle: Nanos(1_000_000), phase };
        let record = self.witness.0.borrow();
        let edges = record.devices[device].edges.iter().filter(|at| **at >= since);
        let leader = &self.world.segment().devices()[0];
        let errors: Vec<i64> =
            edges.map(|at| grid.error(leader.system_time_ps(*at)).0.abs()).collect();
        (errors.iter().copied().max().unwrap_or(0), errors.len())
    }

    /// Outputs were stored in every cycle from `since` until now, and no event was missed.
    pub fn is_undisturbed(&self, device: usize, since: Time<True>) {
        let record = self.witness.0.borrow();
        let seen = &record.devices[device];
        let stored: Vec<_> = seen.stored.iter().filter(|at| **at >= since).collect();
        let cycles = (self.world.now() - since).0 / CYCLE;
        assert!(
            stored.len().abs_diff(cycles as usize) <= 1,
            "{device}: {} of {cycles}",
            stored.len()
        );
        let gap = stored.windows(2).map(|pair| (*pair[1] - *pair[0]).0).max().unwrap_or(0);
        assert!(gap < CYCLE + CYCLE / 10, "{device}: {gap} ps without outputs");
        assert!(!seen.missed.iter().any(|at| *at >= since), "{device} missed outputs");
        assert!(!seen.states.iter().any(|(at, _)| *at >= since), "{device} left OP");
    }

    /// Outputs are applied in OP only, and then in every cycle.
    pub fn applies_in_op_only(&self, device: usize) {
        let record = self.witness.0.borrow();
        let seen = &record.devices[device];
        for at in seen.applied.iter().filter(|at| **at >= self.began) {
            let state = seen.states.iter().rev().find(|(changed, _)| changed <= at);
            let state = state.map(|(_, state)| *state);
            assert_eq!(state, Some(AlState::Op), "{device} applies outputs at {at:?}");
        }
    }

    /// Nothing was written to everybody but the latch of receive times.
    pub fn broadcasts_only_latches(&self) {
        let record = self.witness.0.borrow();
        assert!(record.broadcasts.iter().all(|ado| *ado == 0x0900), "{:04X?}", record.broadcasts);
    }
}

/// Four drives in a line with clocks far apart.
pub const LINE: &str = r#"
    cycle = "1ms"
    seed = 5
    [host]
    clock = "+12ppm"
    jitter = "10us"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    name = "first"
    clock = "-35ppm"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    name = "second"
    clock = "+20ppm"
    [[subdevice]]
    device = "simple_io16"
    name = "third"
    [[subdevice]]
    device = "hpmicro_ecat_cia402_ssc"
    name = "fourth"
    clock = "+48ppm"
"#;

pub fn readmitted(wanted: usize) -> impl Fn(&Event) -> bool {
    move |event| matches!(event, Event::Readmitted { position, .. } if *position == wanted)
}

/// Two branches behind a fork, one behind the other in the order of frames.
pub const TREE: &str = r#"
    cycle = "1ms"
    seed = 5
    [host]
    clock = "+12ppm"
    jitter = "10us"
    [[subdevice]]
    name = "fork"
    device = "simple_io16"
    [[subdevice]]
    name = "left"
    device = "kollmorgen_akd2g"
    connect = "fork:1"
    clock = "-35ppm"
    [[subdevice]]
    name = "left end"
    device = "kollmorgen_akd2g"
    connect = "left:1"
    clock = "+20ppm"
    [[subdevice]]
    name = "right"
    device = "kollmorgen_akd2g"
    connect = "fork:2"
    clock = "+48ppm"
    [[subdevice]]
    name = "right end"
    device = "hpmicro_ecat_cia402_ssc"
    connect = "right:1"
    clock = "-10ppm"
"#;
