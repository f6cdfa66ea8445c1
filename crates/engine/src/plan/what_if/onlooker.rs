//! Observes a case, and keeps the effects on each SubDevice.

use std::cell::RefCell;
use std::rc::Rc;

use isocat_maindevice::{Event, SegmentChange};
use isocat_sim::bench::{Intent, Measured};
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Segment, Tap};
use isocat_wire::time::{Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode};

/// Observations of a case.
#[derive(Clone, Default, Debug)]
pub(super) struct Seen {
    pub devices: Vec<Device>,
    /// The clock that led before; `None` without clocks.
    pub reference: Option<usize>,
    /// The first clock that the MainDevice elected in its place.
    pub elected: Option<usize>,
}

/// Observations of one SubDevice since the begin of the fault.
#[derive(Clone, Default, Debug)]
pub(super) struct Device {
    /// Whether it was in OP before.
    pub takes_part: bool,
    pub has_outputs: bool,
    /// Whether it has process data. For one without, the frames that come back to the MainDevice
    /// count.
    pub exchanges: bool,
    in_op: bool,
    /// How it first left OP by itself: with a code, since it was neither asked to nor switched off.
    pub left: Option<Left>,
    /// Largest SYNC0 error.
    pub sync0_worst: Option<Picos>,
    /// The longest time in OP without process data.
    pub pause: Picos,
    /// End of that time, if process data ended it.
    pub exchanged_again: Option<Time<True>>,
    exchanged: Option<Time<True>>,
    /// How long it had held outputs in OP when it first made them safe by itself.
    pub held: Option<Picos>,
    /// When the MainDevice first gave it up, and when it last re-admitted it.
    pub lost: Option<(Time<True>, Option<Time<True>>)>,
    /// Why the MainDevice could not re-admit it; cleared when it succeeds.
    pub refused: Option<String>,
}

/// How a SubDevice left OP.
#[derive(Clone, Copy, Debug)]
pub(super) struct Left {
    pub at: Time<True>,
    pub state: AlState,
    pub code: AlStatusCode,
}

#[derive(Debug)]
pub(super) struct Onlooker {
    seen: Seen,
    /// Begin of the fault; unknown before judging begins.
    from: Option<Time<True>>,
    last_change: Time<True>,
}

impl Onlooker {
    pub fn new(devices: usize) -> Self {
        let seen = Seen { devices: vec![Device::default(); devices], ..Seen::default() };
        Self { seen, from: None, last_change: Time::ZERO }
    }
}

/// The observer, shared with the case that queries it afterwards.
#[derive(Clone)]
pub(super) struct Shared(Rc<RefCell<Onlooker>>);

impl Shared {
    pub fn new(onlooker: Onlooker) -> Self {
        Self(Rc::new(RefCell::new(onlooker)))
    }

    pub fn watch_from(&self, gone: Time<True>) {
        self.0.borrow_mut().from = Some(gone);
    }

    /// Time of the last state change of any SubDevice.
    pub fn last_change(&self) -> Time<True> {
        self.0.borrow().last_change
    }

    /// Whether the MainDevice has given up a SubDevice, which may stay in OP and show no sign of
    /// it.
    pub fn is_one_given_up(&self) -> bool {
        let given_up = |device: &Device| device.lost.is_some_and(|(_, again)| again.is_none());
        self.0.borrow().seen.devices.iter().any(given_up)
    }

    pub fn seen(&self) -> Seen {
        self.0.borrow().seen.clone()
    }
}

impl Tap for Shared {
    fn frame(&mut self, at: Time<True>, sent: bool, _: &[u8]) {
        let mut onlooker = self.0.borrow_mut();
        let from = onlooker.from.unwrap_or(Time::NEVER);
        let idle = |device: &&mut Device| device.in_op && !device.exchanges && !sent;
        for device in onlooker.seen.devices.iter_mut().filter(idle) {
            device.exchange(at, from);
        }
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        self.0.borrow_mut().observed(segment, at, observation);
    }

    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        let mut onlooker = self.0.borrow_mut();
        let counts = onlooker.from.is_some_and(|from| at >= from);
        if let (Some(error), true) = (measured.sync0_error, counts) {
            let worst = &mut onlooker.seen.devices[device].sync0_worst;
            *worst = Some(worst.unwrap_or_default().max(Picos(error.0.abs())));
        }
    }

    fn event(&mut self, at: Time<True>, event: &Event) {
        self.0.borrow_mut().event(at, event);
    }

    fn judging_begins(&mut self, at: Time<True>, intent: &Intent) {
        let mut onlooker = self.0.borrow_mut();
        let has_clocks = intent.sync0.iter().any(Option::is_some);
        onlooker.seen.reference = has_clocks.then_some(intent.reference);
        for device in onlooker.seen.devices.iter_mut().filter(|device| device.in_op) {
            (device.takes_part, device.exchanged) = (true, None);
        }
        onlooker.last_change = at;
    }

    fn judging_ends(&mut self, at: Time<True>, _: &isocat_maindevice::MainDevice, _: &Segment) {
        let mut onlooker = self.0.borrow_mut();
        let Some(from) = onlooker.from else { return };
        for device in onlooker.seen.devices.iter_mut().filter(|device| device.in_op) {
            device.pauses(at, from);
        }
    }
}

impl Onlooker {
    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        let device = &mut self.seen.devices[observation.device];
        let from = self.from.unwrap_or(Time::NEVER);
        match observation.event {
            Observed::Sm2 | Observed::Sm3 => {
                device.exchanges = true;
                if device.in_op {
                    device.exchange(at, from);
                }
            }
            Observed::OutputsSafe if at >= from => {
                device.held = device.held.or(device.exchanged.map(|since| at - since));
            }
            Observed::State(state, code) => {
                self.last_change = self.last_change.max(at);
                let stack = &segment.devices()[observation.device].stack;
                device.has_outputs |= stack.sync().has_outputs();
                let was_in_op = std::mem::replace(&mut device.in_op, state == AlState::Op);
                if was_in_op && !device.in_op {
                    device.pauses(at, from);
                    device.exchanged = None;
                    if at >= from && code != AlStatusCode::NO_ERROR {
                        device.left.get_or_insert(Left { at, state, code });
                    }
                }
            }
            _ => {}
        }
    }

    fn event(&mut self, at: Time<True>, event: &Event) {
        if self.from.is_none() {
            return;
        }
        if let Event::ReferenceElected { position, .. } = event {
            self.seen.elected.get_or_insert(*position);
        }
        let Some((Some(position), change)) = SegmentChange::of(event) else { return };
        let device = &mut self.seen.devices[position];
        match change {
            SegmentChange::Lost { .. } => {
                let (first, _) = device.lost.unwrap_or((at, None));
                device.lost = Some((first, None));
            }
            SegmentChange::Admitted { .. } => {
                device.refused = None;
                device.lost = device.lost.map(|(first, _)| (first, Some(at)));
            }
            SegmentChange::Recovered { .. } => device.refused = None,
            SegmentChange::NotAdmitted { cause } | SegmentChange::NotRecovered { cause } => {
                device.refused = Some(cause.to_string());
            }
            _ => {}
        }
    }
}

impl Device {
    fn exchange(&mut self, at: Time<True>, from: Time<True>) {
        if self.pauses(at, from) {
            self.exchanged_again = Some(at);
        }
        self.exchanged = Some(at);
    }

    /// Takes the time since the last process data. Returns whether it is the longest so far.
    fn pauses(&mut self, at: Time<True>, from: Time<True>) -> bool {
        let Some(since) = self.exchanged.filter(|_| at >= from) else { return false };
        let is_longest = at - since > self.pause;
        self.pause = self.pause.max(at - since);
        is_longest
    }
}
