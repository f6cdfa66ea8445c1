//! The judges' bench: passes each event to the judges that it concerns.

use isocat_subdevice::{Chain, Step, SyncMode};
use isocat_wire::time::{Device, Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, Command, frame, register};

use crate::device;
use crate::judge::inputs_cycle::{self, Fetched};
use crate::judge::{
    Grid, HostPhase, InputsCycle, LostPulses, MissedEvents, Opportunity, OutputsCycle,
    OutputsDelay, OutputsValid, Samples, Sync0Error, SyncMargin, outputs_cycle,
};
use crate::observation::{Content, Observation, Observed};
use crate::sampling::{Sample, Sampling};
use crate::segment::Segment;
use crate::wiring::MainPort;

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
#[derive(Clone, Debug, Default)]
pub struct DeviceBench {
    /// SYNC0 edges; `None` if SYNC0 is not configured.
    pub sync0: Option<Sync0Error>,
    /// Pulses of SYNC0 and SYNC1 that made no edge.
    pub lost_pulses: LostPulses,
    /// The times from SM2 to SYNC0, and from ready outputs to the pulse at which they act.
    pub margin: SyncMargin,
    /// The time from the acting pulse to valid outputs.
    pub outputs_delay: OutputsDelay,
    /// Whether outputs act in their cycle.
    pub outputs_cycle: OutputsCycle,
    /// Whether inputs arrive in their cycle.
    pub inputs_cycle: InputsCycle,
    /// Samples of inputs; nothing where the device does not oversample.
    pub input_samples: Samples,
    /// Samples of outputs.
    pub output_samples: Samples,
    /// Missed SM events.
    pub missed: MissedEvents,
    /// All changes of state, from power-on.
    pub states: Vec<StateChange>,
    /// Cycle of the next outputs.
    cycle: Option<i64>,
    /// The pulses to which its process data are bound.
    bounds: Bounds,
}

/// The first opportunities of a SubDevice's process data, at SYNC0 and SYNC1; `None` if unknown.
#[derive(Clone, Copy, Debug, Default)]
struct Bounds {
    outputs: [Option<Opportunity>; 2],
    inputs: [Option<Opportunity>; 2],
}

impl Bounds {
    fn new(sync0: Option<Grid>, acting: Option<Grid>, exchange: Option<Grid>) -> Self {
        let Some(frames) = exchange else { return Self::default() };
        // A SYNC1 at which outputs act comes once for each exchange.
        let sync1 = acting.map(|acting| Grid { cycle: frames.cycle, ..acting });
        let pulses = [sync0, sync1];
        Self {
            outputs: pulses.map(|pulse| Opportunity::new(frames, pulse?)),
            inputs: pulses.map(|pulse| Opportunity::new(pulse?, frames)),
        }
    }
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
            device.lost_pulses = LostPulses::default();
            device.margin = SyncMargin::default();
            device.outputs_delay = OutputsDelay::new(intent.outputs_spread);
            device.outputs_cycle = OutputsCycle::default();
            device.inputs_cycle = InputsCycle::default();
            (device.input_samples, device.output_samples) = Default::default();
            device.bounds = Bounds::new(sync0, of(&intent.acting), of(&intent.exchange));
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
        let (Some(intent), Some(judge)) = (&self.intent, &mut self.host_phase) else { return };
        if !is_cyclic(bytes) {
            return;
        }
        let Some(leader) = leader(self.led, intent, segment) else { return };
        let entry = segment.path().entries.iter().find(|entry| entry.device == intent.reference);
        if let Some(entry) = entry {
            let at = start + entry.after;
            judge.frame(leader.system_time_ps(at));
        }
    }

    /// Takes an event at a SubDevice; returns what was measured of it.
    pub fn observe(&mut self, segment: &Segment, observation: &Observation) -> Measured {
        let index = observation.device;
        let subject = &segment.devices()[index];
        let device = &mut self.devices[index];
        device.note_state(subject, observation);
        let Some(intent) = &self.intent else { return Measured::default() };
        if let Some(sampling) = subject.sampling() {
            device.follow_samples(subject, observation, sampling);
        }
        let look = Look { segment, subject, leader: leader(self.led, intent, segment), intent };
        device.judge(&look, observation, &mut self.outputs_valid)
    }

    /// Takes events at SubDevices, in their order. As a rule several of one SubDevice follow each
    /// other.
    pub fn observe_all(&mut self, segment: &Segment, observations: &[Observation]) {
        let leader = self.intent.as_ref().and_then(|intent| leader(self.led, intent, segment));
        for observations in observations.chunk_by(|one, next| one.device == next.device) {
            let index = observations[0].device;
            let subject = &segment.devices()[index];
            let device = &mut self.devices[index];
            let Some(intent) = &self.intent else {
                observations.iter().for_each(|it| device.note_state(subject, it));
                continue;
            };
            let look = Look { segment, subject, leader, intent };
            let sampling = subject.sampling();
            for observation in observations {
                device.note_state(subject, observation);
                if let Some(sampling) = sampling {
                    device.follow_samples(subject, observation, sampling);
                }
                device.judge(&look, observation, &mut self.outputs_valid);
            }
        }
    }
}

/// What the judges of a SubDevice look at.
struct Look<'a> {
    segment: &'a Segment,
    subject: &'a device::Device,
    /// The SubDevice of the reference clock, if it has power: without power it shows a meaningless
    /// time.
    leader: Option<&'a device::Device>,
    intent: &'a Intent,
}

impl DeviceBench {
    /// Notes a change of state, at any time.
    #[inline]
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
        look: &Look<'_>,
        observation: &Observation,
        outputs_valid: &mut OutputsValid,
    ) -> Measured {
        let &Look { segment, subject, leader, intent } = look;
        let (index, device_at) = (observation.device, observation.device_at);
        let content = &observation.content;
        let true_time = || subject.oscillator().when(device_at);
        let device = self;
        let mut measured = Measured::default();
        // A SubDevice without SYNC0 has no timing to judge, but its process data are followed.
        let is_timed = device.sync0.is_some();
        let chain = || subject.stack.sync().chain();
        let exchange = || intent.exchange.get(index).copied().flatten().unwrap_or(intent.send);
        match observation.event {
            Observed::Sm2 => {
                device.outputs_cycle.stored(content.frame);
                if chain().mode == SyncMode::SmSynchronous {
                    device.inputs_cycle.event(content.frame);
                }
                if is_timed {
                    device.margin.sm2(device_at);
                }
            }
            Observed::Began(Step::MapOutputs) if is_timed => device.margin.begins(),
            Observed::Finished(Step::MapOutputs) if is_timed => {
                measured.margin = device.margin.ready(device_at);
            }
            Observed::Began(Step::OutputsValid) => {
                let acted = (content.frame != Time::ZERO).then(true_time);
                if let Some(at) = acted {
                    let bound = device.outputs_bound(&chain(), intent, index, exchange().cycle);
                    device.outputs_cycle.acted(content.frame, at, bound);
                }
                // With subordinated cycles only the first time counts; later ones act again.
                if is_timed && let Some(cycle) = device.cycle.take() {
                    let at = acted.unwrap_or_else(true_time);
                    device.outputs_delay.valid(at);
                    outputs_valid.valid(cycle, at);
                }
            }
            Observed::Began(Step::LatchInputs) => device.inputs_cycle.latched(device_at),
            Observed::Sm3 => {
                let chain = chain();
                if let Some(fetched) = fetched(segment, index, device_at, *content) {
                    let shifted = intent.inputs_shifted.get(index).copied().unwrap_or(false);
                    let bound = device.inputs_bound(&chain, exchange().cycle, shifted);
                    device.inputs_cycle.fetched(fetched, bound);
                }
                if chain.mode == SyncMode::SmSynchronous && !chain.has_outputs {
                    device.inputs_cycle.event(content.frame);
                }
            }
            Observed::SmEventMissed(counter) => device.missed.missed(true_time(), counter),
            Observed::StillActive(signal) if is_timed => {
                device.lost_pulses.lost(true_time(), signal);
            }
            ref pulse @ (Observed::Sync0 | Observed::Sync1) if is_timed => {
                let second = matches!(pulse, Observed::Sync1);
                let at = true_time();
                let reference = leader.map(|leader| leader.system_time_ps(at));
                if !second {
                    device.margin.sync0(device_at);
                    if let (Some(judge), Some(reference)) = (&mut device.sync0, reference) {
                        measured.sync0_error = Some(judge.edge(at, reference));
                    }
                }
                let chain = chain();
                if second == outputs_at_sync1(&chain) {
                    device.outputs_cycle.pulse(at);
                }
                if second == inputs_at_sync1(&chain) {
                    device.inputs_cycle.event(at);
                }
                if second == acts_at_sync1(&chain) {
                    measured.margin = device.margin.acts(device_at);
                    device.outputs_delay.sync0(at);
                    let number = |grid: Grid| Some(grid.index(reference?));
                    device.cycle = intent.acting[index].and_then(number);
                }
            }
            _ => {}
        }
        measured
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

    fn outputs_bound(
        &self,
        chain: &Chain,
        intent: &Intent,
        index: usize,
        frame: Nanos,
    ) -> outputs_cycle::Bound {
        use outputs_cycle::Bound;
        match chain.mode {
            SyncMode::FreeRun => Bound::Free,
            SyncMode::SmSynchronous => Bound::Sm2(frame),
            _ => {
                let second = outputs_at_sync1(chain);
                let pulses = if second { &intent.acting } else { &intent.sync0 };
                let pulse = pulses.get(index).copied().flatten();
                match (self.bounds.outputs[usize::from(second)], pulse) {
                    (Some(opportunity), _) => Bound::Pulse(opportunity),
                    (None, Some(pulse)) => Bound::NextPulse { pulse: pulse.cycle, frame },
                    (None, None) => Bound::Free,
                }
            }
        }
    }

    fn inputs_bound(&self, chain: &Chain, cycle: Nanos, shifted: bool) -> inputs_cycle::Bound {
        use inputs_cycle::Bound;
        match chain.mode {
            SyncMode::FreeRun => Bound::Free,
            SyncMode::SmSynchronous => Bound::Frame { cycle, shifted },
            _ => {
                let second = inputs_at_sync1(chain);
                self.bounds.inputs[usize::from(second)].map_or(Bound::Free, Bound::Pulse)
            }
        }
    }
}

/// The inputs that were fetched by a frame whose last bit passed a SubDevice at `device_at`. `None`
/// if they are unknown, or if the frame has no way back.
fn fetched(
    segment: &Segment,
    index: usize,
    device_at: Time<Device>,
    content: Content,
) -> Option<Fetched> {
    if content.latched == Time::ZERO {
        return None;
    }
    let way = [MainPort::Primary, MainPort::Secondary].into_iter().find_map(|port| {
        let path = segment.path_from(port);
        // Most segments are lines, in which places are positions.
        let entry = path.entries.get(index).filter(|entry| entry.device == index);
        let entry = entry.or_else(|| path.entries.iter().find(|entry| entry.device == index))?;
        Some(path.round_trip - entry.after)
    })?;
    let oscillator = segment.devices()[index].oscillator();
    Some(Fetched {
        frame: content.frame,
        latched: (content.latched, oscillator.when(content.latched)),
        arrive: oscillator.when(device_at) + way,
    })
}

/// The SubDevice of the reference clock, if there is one with power.
fn leader<'a>(led: bool, intent: &Intent, segment: &'a Segment) -> Option<&'a device::Device> {
    let leader = &segment.devices()[intent.reference];
    (led && leader.is_powered()).then_some(leader)
}

/// Whether SYNC1 is the first occasion of outputs, and not SYNC0. With subordinated cycles each
/// SYNC0 is one, if the application runs at each.
fn outputs_at_sync1(chain: &Chain) -> bool {
    let at_each = chain.mode == SyncMode::DcSubordinated && !chain.application_on_sync1;
    !at_each && acts_at_sync1(chain)
}

/// Whether inputs belong to SYNC1, and not to SYNC0. With subordinated cycles they belong to the
/// last SYNC0 before SYNC1. If SYNC1 is a shift of Input Latch after SYNC0, they belong to that
/// SYNC0.
fn inputs_at_sync1(chain: &Chain) -> bool {
    chain.mode != SyncMode::DcSubordinated && acts_at_sync1(chain)
}

/// Whether outputs act at SYNC1, and not at SYNC0, by the SubDevice's mode.
fn acts_at_sync1(chain: &Chain) -> bool {
    match chain.mode {
        SyncMode::DcSync1 | SyncMode::DcSubordinated => true,
        SyncMode::DcShiftSync1 => chain.outputs_on_sync1 && chain.has_outputs,
        _ => false,
    }
}

/// Whether a frame is cyclic: its first datagram distributes the system time, and it has further
/// datagrams. Frames that control a joining clock have only one.
pub fn is_cyclic(bytes: &[u8]) -> bool {
    let Ok(payload) = frame::payload(bytes) else { return false };
    let mut datagrams = isocat_wire::datagram::datagrams(payload);
    let (Some(Ok(first)), Some(Ok(_))) = (datagrams.next(), datagrams.next()) else { return false };
    let distributes = matches!(first.header.command(), Ok(Command::Frmw | Command::Armw));
    distributes && first.header.ado() == register::SYSTEM_TIME.address
}
