//! The judges' bench: passes each event to the judges that it concerns.

mod binding;
mod brief;
mod look;

use isocat_subdevice::Step;
use isocat_wire::datagram::Layouts;
use isocat_wire::time::{Device, Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, Command, frame, register};

use crate::device;
use crate::judge::inputs_cycle::{self, Fetched};
use crate::judge::{
    ClockTime, Grid, HostPhase, InputsCycle, LostPulses, MissedEvents, OutputsCycle, OutputsDelay,
    OutputsValid, Points, Samples, Sync0Error, SyncMargin,
};
use crate::observation::{Content, Observation, Observed};
use crate::sampling::{Sample, Sampling};
use crate::segment::Segment;
use crate::watcher::{Watcher, is_judged};
use binding::Binding;
use look::Look;

/// The intent of a run, as the judges know it: never how it was planned.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Intent {
    /// The reference clock's SubDevice. [`Bench::led_by`] tells changes.
    pub reference: usize,
    /// When cyclic frames should find the reference clock.
    pub send: Grid,
    /// By SubDevice: when SYNC0 should come; `None` if SYNC0 is not configured.
    pub sync0: Vec<Option<Grid>>,
    /// By SubDevice: when the pulse should come at which its outputs act, SYNC0 or SYNC1.
    pub acting: Vec<Option<Grid>>,
    /// By SubDevice: when frames with its process data should find the reference clock; `None` if
    /// unknown, as with a foreign MainDevice.
    pub exchange: Vec<Option<Grid>>,
    /// By SubDevice: whether a local timer should shift Input Latch (0x1C33:03). Missing entries
    /// mean no shift.
    pub inputs_shifted: Vec<bool>,
    /// Largest SYNC0 error allowed.
    pub sync0_limit: Picos,
    /// Largest spread allowed of the time from the acting pulse to valid outputs.
    pub outputs_spread: Picos,
}

impl Intent {
    /// Whether SYNC0 is configured at a SubDevice.
    pub(crate) fn is_timed(&self) -> bool {
        self.sync0.iter().any(Option::is_some)
    }
}

/// All judges of a run.
#[derive(Clone, Debug)]
pub struct Bench {
    intent: Option<Intent>,
    /// Whether a clock is the reference. Without one there is no grid to judge by.
    led: bool,
    devices: Vec<DeviceBench>,
    outputs_valid: OutputsValid,
    host_phase: Option<HostPhase>,
}

/// What the judges measured of one event at a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Measured {
    /// Distance of a SYNC0 edge from the ideal grid of the reference clock: positive if late.
    pub sync0_error: Option<Picos>,
    /// Time from ready outputs to the pulse at which they act, by the SubDevice's own oscillator;
    /// negative if the pulse came first.
    pub margin: Option<Nanos>,
}

/// The judges of one SubDevice.
// In this order, and from the beginning of a cache line on: what a regular cycle touches lies
// together in the middle, so that few lines have to be fetched for each SubDevice.
#[derive(Clone, Debug, Default)]
#[repr(C, align(64))]
pub struct DeviceBench {
    /// All changes of state, from power-on.
    pub states: Vec<StateChange>,
    /// Missed SM events.
    pub missed: MissedEvents,
    /// Pulses of SYNC0 and SYNC1 that made no edge.
    pub lost_pulses: LostPulses,
    /// Samples of inputs; nothing where the device does not oversample.
    pub input_samples: Samples,
    /// Samples of outputs.
    pub output_samples: Samples,
    /// The points at which its outputs should act; `None` if they act at no pulse.
    acting: Option<Points>,
    /// Whether outputs act in their cycle.
    pub outputs_cycle: OutputsCycle,
    /// The times from SM2 to SYNC0, and from ready outputs to the pulse at which they act.
    pub margin: SyncMargin,
    /// The time from the acting pulse to valid outputs.
    pub outputs_delay: OutputsDelay,
    /// Whether inputs arrive in their cycle.
    pub inputs_cycle: InputsCycle,
    /// Cycle of the next outputs; `None` too without SYNC0.
    cycle: Option<i64>,
    /// Whether SYNC0 is configured.
    is_timed: bool,
    /// Whether the points at which outputs should act are those of SYNC0.
    acts_on_sync0_grid: bool,
    /// Whether SYNC0 is configured and is the pulse of all process data, as at most SubDevices.
    is_plain: bool,
    /// The events to which its process data are bound.
    binding: Binding,
    /// SYNC0 edges; `None` if SYNC0 is not configured.
    pub sync0: Option<Sync0Error>,
}

/// A change of state as it happened at the SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StateChange {
    /// When.
    pub at: Time<True>,
    /// The new state.
    pub state: AlState,
    /// The AL status code.
    pub code: AlStatusCode,
}

impl Bench {
    /// Judges for `devices` SubDevices. They only record states until [`Bench::begin`].
    pub fn new(devices: usize) -> Self {
        Self {
            intent: None,
            led: true,
            devices: (0..devices).map(|_| DeviceBench::default()).collect(),
            outputs_valid: OutputsValid::new(0),
            host_phase: None,
        }
    }

    /// Begins to judge: the segment is reported as in operation.
    pub fn begin(&mut self, intent: Intent) {
        for (position, device) in self.devices.iter_mut().enumerate() {
            let of = |grids: &[Option<Grid>]| grids.get(position).copied().flatten();
            let sync0 = of(&intent.sync0);
            device.sync0 = sync0.map(|grid| Sync0Error::new(grid, intent.sync0_limit));
            device.is_timed = sync0.is_some();
            device.cycle = device.cycle.filter(|_| device.is_timed);
            device.lost_pulses = LostPulses::default();
            device.margin = SyncMargin::default();
            device.outputs_delay = OutputsDelay::new(intent.outputs_spread);
            device.outputs_cycle = OutputsCycle::default();
            device.inputs_cycle = InputsCycle::default();
            (device.input_samples, device.output_samples) = Default::default();
            let acting = of(&intent.acting);
            (device.acting, device.acts_on_sync0_grid) = (acting.map(Points::new), acting == sync0);
            (device.binding, device.is_plain) = (Binding::default(), false);
        }
        let synchronized = intent.sync0.iter().flatten().count();
        self.outputs_valid = OutputsValid::new(synchronized);
        self.host_phase = Some(HostPhase::new(intent.send));
        (self.intent, self.led) = (Some(intent), true);
    }

    /// Changes the reference clock, or removes it; system time is that of the reference clock.
    pub fn led_by(&mut self, reference: Option<usize>) {
        self.led = reference.is_some();
        if let (Some(intent), Some(reference)) = (&mut self.intent, reference) {
            intent.reference = reference;
        }
    }

    /// The SubDevice of the reference clock; `None` without one, and before judging begins.
    pub fn leader(&self) -> Option<usize> {
        self.intent.as_ref().filter(|_| self.led).map(|intent| intent.reference)
    }

    /// The intent by which the bench judges; `None` before judging begins.
    pub fn intent(&self) -> Option<&Intent> {
        self.intent.as_ref()
    }
    /// Judges of each SubDevice.
    pub fn devices(&self) -> &[DeviceBench] {
        &self.devices
    }
    /// When outputs became valid.
    pub fn outputs_valid(&self) -> &OutputsValid {
        &self.outputs_valid
    }
    /// When cyclic frames were sent; `None` before the judging begins.
    pub fn host_phase(&self) -> Option<&HostPhase> {
        self.host_phase.as_ref()
    }

    /// Takes a frame that passed the segment; its first bit left the MainDevice at `start`.
    pub fn frame(&mut self, segment: &Segment, bytes: &[u8], start: Time<True>) {
        let Some(intent) = self.intent.as_ref().filter(|_| is_cyclic(bytes)) else { return };
        let entry = segment.path().entries.iter().find(|entry| entry.device == intent.reference);
        if let Some(entry) = entry {
            self.arrived(segment, start + entry.after);
        }
    }

    /// The same for a frame that arrived at the reference clock at `at`.
    pub(crate) fn frame_at(&mut self, segment: &Segment, bytes: &[u8], at: Time<True>) {
        if self.intent.is_some() && is_cyclic(bytes) {
            self.arrived(segment, at);
        }
    }

    /// A cyclic frame arrived at the reference clock.
    fn arrived(&mut self, segment: &Segment, at: Time<True>) {
        if let (Some(intent), Some(judge)) = (&self.intent, &mut self.host_phase)
            && let Some(leader) = leader(self.led, intent, segment)
        {
            judge.meet(leader.system_time(at));
        }
    }

    /// Takes an event at a SubDevice; returns what was measured of it.
    pub fn observe(&mut self, segment: &Segment, observation: &Observation) -> Measured {
        if !is_judged(observation.event) {
            return Measured::default();
        }
        self.observe_all(segment, std::slice::from_ref(observation))
    }

    /// Takes events at SubDevices, in their order; returns what was measured of the last one of
    /// each kind. As a rule several of one SubDevice follow each other.
    pub fn observe_all(&mut self, segment: &Segment, observations: &[Observation]) -> Measured {
        self.observe_and(segment, observations, None)
    }

    /// The same; `tell` gets each event after it was judged, and what was measured of it.
    pub fn observe_each(
        &mut self,
        segment: &Segment,
        observations: &[Observation],
        tell: &mut Tell<'_>,
    ) {
        self.observe_and(segment, observations, Some(tell));
    }

    fn observe_and(
        &mut self,
        segment: &Segment,
        observations: &[Observation],
        mut tell: Option<&mut Tell<'_>>,
    ) -> Measured {
        let Self { intent, devices, outputs_valid, led, .. } = self;
        let Some(intent) = intent else {
            for observation in observations {
                let subject = &segment.devices()[observation.device];
                devices[observation.device].note_state(subject, observation);
                if let Some(tell) = &mut tell {
                    tell(observation, &Measured::default());
                }
            }
            return Measured::default();
        };
        // The segment stays as it is during this call, so what is found in it is kept.
        let mut look = Look::new(segment, leader(*led, intent, segment));
        judge_all(devices, outputs_valid, intent, &mut look, observations, tell)
    }

    /// Takes all that a watcher has seen: regular events as they were noted briefly, and all others
    /// between them.
    pub(crate) fn observe_seen(&mut self, segment: &Segment, watcher: &Watcher) {
        let (briefs, changed) = watcher.briefs();
        if briefs.is_empty() {
            self.observe_all(segment, watcher.seen());
            return;
        }
        let Self { intent: Some(intent), devices, outputs_valid, led, .. } = self else { return };
        if changed {
            // Each event is judged by the last state of its SubDevice.
            for index in briefs.iter().map(|brief| brief.device as usize) {
                devices[index].bind(&segment.devices()[index], intent, index);
            }
        }
        let mut look = Look::new(segment, leader(*led, intent, segment));
        let (mut taken, mut left) = (0, watcher.seen());
        for brief in briefs {
            if brief.before > taken {
                let (before, rest) = left.split_at((brief.before - taken) as usize);
                judge_all(devices, outputs_valid, intent, &mut look, before, None);
                (taken, left) = (brief.before, rest);
            }
            let index = brief.device as usize;
            let device = &mut devices[index];
            if !device.binding.is_for(brief.version) {
                device.bind(&segment.devices()[index], intent, index);
            }
            device.judge_brief(&mut look, brief, outputs_valid);
        }
        judge_all(devices, outputs_valid, intent, &mut look, left, None);
    }
}

/// What gets an event after it was judged.
pub type Tell<'a> = dyn FnMut(&Observation, &Measured) + 'a;

/// Passes events to the judges of their SubDevices; returns what was measured of the last one of
/// each kind, or `tell`s each.
fn judge_all(
    devices: &mut [DeviceBench],
    outputs_valid: &mut OutputsValid,
    intent: &Intent,
    look: &mut Look<'_>,
    observations: &[Observation],
    mut tell: Option<&mut Tell<'_>>,
) -> Measured {
    let mut measured = Measured::default();
    let mut left = observations;
    while let [first, ..] = left {
        let index = first.device;
        let (subject, device) = (&look.devices[index], &mut devices[index]);
        if let Some(sampling) = subject.sampling() {
            let all = left.iter().take_while(|it| it.device == index);
            all.for_each(|it| device.follow_samples(subject, it, sampling));
        }
        let mut is_bound = false;
        while let [observation, more @ ..] = left
            && observation.device == index
        {
            left = more;
            // A tap that observes gets events that no judge needs, too.
            if is_judged(observation.event) {
                if !is_bound {
                    device.bind(subject, intent, index);
                    is_bound = true;
                }
                device.judge(look, subject, observation, outputs_valid, &mut measured);
            }
            if let Some(tell) = &mut tell {
                tell(observation, &std::mem::take(&mut measured));
            }
        }
    }
    measured
}

impl DeviceBench {
    /// Finds the events again to which its process data are bound, if the mode may have changed.
    #[inline]
    fn bind(&mut self, subject: &device::Device, intent: &Intent, index: usize) {
        if !self.binding.is_for(subject.state_version()) {
            self.binding = Binding::new(subject, intent, index);
            let acts_on_sync0 = self.acting.is_some() && self.acts_on_sync0_grid;
            self.is_plain = self.sync0.is_some() && acts_on_sync0 && self.binding.is_plain();
        }
    }

    /// Notes a change of state, at any time.
    fn note_state(&mut self, subject: &device::Device, observation: &Observation) {
        if let Observed::State(state, code) = observation.event {
            let at = subject.oscillator().when(observation.device_at);
            self.states.push(StateChange { at, state, code });
        }
    }

    /// Passes an event to the judges that it concerns.
    #[inline(always)]
    fn judge(
        &mut self,
        look: &mut Look<'_>,
        subject: &device::Device,
        observation: &Observation,
        outputs_valid: &mut OutputsValid,
        measured: &mut Measured,
    ) {
        let Observation { device: index, device_at, ref event, ref content } = *observation;
        let true_time = || subject.oscillator().when(device_at);
        // A SubDevice without SYNC0 has no timing to judge, but its process data are followed.
        match *event {
            Observed::Sm2 => {
                if self.binding.follows_stored {
                    self.outputs_cycle.stored(content.frame);
                }
                if self.binding.latches_at_sm2 {
                    self.inputs_cycle.event(content.frame);
                }
                if self.is_timed {
                    self.margin.sm2(device_at);
                }
            }
            Observed::Began(Step::MapOutputs) => {
                if self.is_timed {
                    self.margin.begins();
                }
            }
            Observed::Finished(Step::MapOutputs) => {
                if self.is_timed {
                    measured.margin = self.margin.ready(device_at);
                }
            }
            Observed::Began(Step::OutputsValid) => {
                self.valid(content.frame, true_time, outputs_valid);
            }
            Observed::Began(Step::LatchInputs) => {
                self.inputs_cycle.latched(device_at, true_time());
            }
            Observed::Sm3 => {
                let (at, bound) = ((index, device_at), &self.binding.inputs);
                take_fetched(&mut self.inputs_cycle, bound, look, at, content);
                if self.binding.latches_at_sm3 {
                    self.inputs_cycle.event(content.frame);
                }
            }
            Observed::Sync0 | Observed::Sync1 => {
                if self.is_timed {
                    let (at, is_sync1) = (true_time(), matches!(event, Observed::Sync1));
                    self.pulse(look.system_time(at), is_sync1, (device_at, at), measured);
                }
            }
            Observed::SmEventMissed(counter) => {
                self.missed.missed(true_time(), counter);
            }
            Observed::StillActive(signal) => {
                if self.is_timed {
                    self.lost_pulses.lost(true_time(), signal);
                }
            }
            Observed::State(..) => self.note_state(subject, observation),
            Observed::Began(_)
            | Observed::Finished(_)
            | Observed::Acknowledged(_)
            | Observed::OutputsSafe
            | Observed::Sampled(_) => {}
        }
    }

    /// Takes outputs that became valid; those of `frame`, if they are new.
    #[inline(always)]
    fn valid(
        &mut self,
        frame: Time<True>,
        at: impl FnOnce() -> Time<True>,
        outputs_valid: &mut OutputsValid,
    ) {
        let is_new = frame != Time::ZERO;
        // With subordinated cycles only the first time counts; later ones act again.
        let cycle = self.cycle.take();
        if !is_new && cycle.is_none() {
            return;
        }
        let at = at();
        if is_new {
            self.outputs_cycle.acted(frame, at, &self.binding.outputs);
        }
        if let Some(cycle) = cycle {
            self.outputs_delay.valid(at);
            outputs_valid.valid(cycle, at);
        }
    }

    /// Takes a pulse of SYNC0 or SYNC1 for the judges; `reference` is the system time of the
    /// reference clock.
    #[inline(always)]
    fn pulse(
        &mut self,
        reference: Option<ClockTime>,
        is_sync1: bool,
        (device_at, at): (Time<Device>, Time<True>),
        measured: &mut Measured,
    ) {
        let mut number = None;
        if !is_sync1 {
            self.margin.sync0(device_at);
            if let (Some(judge), Some(reference)) = (&mut self.sync0, reference) {
                let (met, error) = judge.meet(at, reference);
                number = Some(met);
                measured.sync0_error = Some(error);
            }
        }
        let roles = self.binding.pulses[usize::from(is_sync1)];
        if roles.takes_outputs {
            self.outputs_cycle.pulse(at);
        }
        if roles.latches {
            self.inputs_cycle.event(at);
        }
        if roles.acts {
            measured.margin = self.margin.acts(device_at);
            self.outputs_delay.sync0(at);
            self.cycle = match (&mut self.acting, reference) {
                (Some(_), _) if self.acts_on_sync0_grid && number.is_some() => number,
                (Some(points), Some(reference)) => Some(points.meet(reference).0),
                _ => None,
            };
        }
    }

    /// The same for a device that oversamples. The first channel of a direction stands for all:
    /// they are sampled together.
    fn follow_samples(
        &mut self,
        device: &device::Device,
        observation: &Observation,
        sampling: &Sampling,
    ) {
        let at = || device.oscillator().when(observation.device_at);
        let samples = sampling.samples.into();
        match observation.event {
            Observed::Sync0 if !sampling.outputs.is_empty() => self.output_samples.pulse(at()),
            Observed::Sampled(Sample { channel: 0, is_output: false, .. }) => {
                self.input_samples.sample(at());
                self.input_samples.pulse(at());
                self.input_samples.waits(at(), samples);
            }
            Observed::Sampled(Sample { channel: 0, number, .. }) => {
                if number == 0 {
                    self.output_samples.begins(at(), samples);
                }
                self.output_samples.sample(at());
            }
            Observed::Began(Step::LatchInputs) if !sampling.inputs.is_empty() => {
                self.input_samples.handed_over(at(), samples);
            }
            Observed::Began(Step::OutputsValid)
                if !sampling.outputs.is_empty() && observation.content.frame != Time::ZERO =>
            {
                self.output_samples.valid(at());
            }
            Observed::State(..) => {
                self.input_samples.interrupted();
                self.output_samples.interrupted();
            }
            _ => {}
        }
    }
}

/// Takes inputs that a frame fetched, which ended at a SubDevice at this time of its own
/// oscillator. Those of unknown origin are not judged, nor those without a way back.
#[inline(always)]
fn take_fetched(
    judge: &mut InputsCycle,
    bound: &inputs_cycle::Bound,
    look: &mut Look<'_>,
    (device, at): (usize, Time<Device>),
    content: &Content,
) {
    if content.latched != Time::ZERO
        && let Some(arrive) = look.back(content.frame, device, at)
    {
        let fetched = Fetched { frame: content.frame, latched: content.latched, arrive };
        let true_time = |at| look.devices[device].oscillator().when(at);
        judge.fetched(&fetched, bound, true_time);
    }
}

/// The SubDevice of the reference clock, if there is one with power.
fn leader<'a>(led: bool, intent: &Intent, segment: &'a Segment) -> Option<&'a device::Device> {
    let leader = &segment.devices()[intent.reference];
    (led && leader.is_powered()).then_some(leader)
}

/// Whether a frame is cyclic: its first datagram distributes the system time, and it has further
/// datagrams. Frames that control a joining clock have only one.
pub fn is_cyclic(bytes: &[u8]) -> bool {
    let Ok(payload) = frame::payload(bytes) else { return false };
    let mut layouts = Layouts::new();
    let Some(Ok(first)) = layouts.next(payload) else { return false };
    let distributes = matches!(first.header.command(), Ok(Command::Frmw | Command::Armw));
    distributes
        && first.header.ado() == register::SYSTEM_TIME.address
        && matches!(layouts.next(payload), Some(Ok(_)))
}
