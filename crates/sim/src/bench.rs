//! The judges' bench: hands what happens to the judges that it concerns.

use isocat_subdevice::{Chain, Step, SyncMode};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, AlStatusCode, Command, frame, register};

use crate::judge::{
    Grid, HostPhase, MissedEvents, OutputsDelay, OutputsValid, Sync0Error, SyncMargin,
};
use crate::observation::{Observation, Observed};
use crate::segment::Segment;

/// What the judges are told about the intent of a run: never how it was planned.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Intent {
    /// The SubDevice whose clock leads.
    pub reference: usize,
    /// When cyclic frames are to find the reference clock.
    pub send: Grid,
    /// By SubDevice: when SYNC0 is to come; `None` where no SYNC0 was asked for.
    pub sync0: Vec<Option<Grid>>,
    /// By SubDevice: when the pulse is to come at which its outputs act, SYNC0 or SYNC1.
    pub acting: Vec<Option<Grid>>,
    /// Largest SYNC0 error allowed.
    pub sync0_limit: Picos,
}

/// All judges of a run.
#[derive(Clone, Debug)]
pub struct Bench {
    intent: Option<Intent>,
    devices: Vec<DeviceBench>,
    outputs_valid: OutputsValid,
    host_phase: Option<HostPhase>,
}

/// What the judges made of one event at a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Measured {
    /// How far a SYNC0 edge was off the ideal grid of the reference clock: positive if late.
    pub sync0_error: Option<Picos>,
    /// From ready outputs to the pulse at which they act, by the SubDevice's own oscillator; negative where the pulse came
    /// first.
    pub margin: Option<Nanos>,
}

/// The judges of one SubDevice.
#[derive(Clone, Debug, Default)]
pub struct DeviceBench {
    /// SYNC0 edges; `None` where no SYNC0 was asked for.
    pub sync0: Option<Sync0Error>,
    /// SM2 to SYNC0.
    pub margin: SyncMargin,
    /// SYNC0 to valid outputs.
    pub outputs_delay: OutputsDelay,
    /// Missed SM events.
    pub missed: MissedEvents,
    /// All changes of state, from power-on.
    pub states: Vec<StateChange>,
    /// Cycle to which the next outputs belong.
    cycle: Option<i64>,
}

/// A change of state as it happened at the SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StateChange {
    /// When.
    pub at: Time<True>,
    /// The new state.
    pub state: AlState,
    /// Why.
    pub code: AlStatusCode,
}

impl Bench {
    /// Judges for `devices` SubDevices. Until [`Bench::begin`] only states are watched.
    pub fn new(devices: usize) -> Self {
        Self {
            intent: None,
            devices: vec![DeviceBench::default(); devices],
            outputs_valid: OutputsValid::new(0),
            host_phase: None,
        }
    }

    /// Begins to judge: the segment is said to be in operation.
    pub fn begin(&mut self, intent: Intent) {
        let grids = intent.sync0.iter();
        for (device, grid) in self.devices.iter_mut().zip(grids) {
            device.sync0 = grid.map(|grid| Sync0Error::new(grid, intent.sync0_limit));
            device.margin = SyncMargin::default();
        }
        let synchronized = intent.sync0.iter().flatten().count();
        self.outputs_valid = OutputsValid::new(synchronized);
        self.host_phase = Some(HostPhase::new(intent.send));
        self.intent = Some(intent);
    }

    /// The intent that is judged by; `None` before the judging begins.
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

    /// A frame has passed the segment whose first bit left the MainDevice at `start`.
    pub fn frame(&mut self, segment: &Segment, bytes: &[u8], start: Time<True>) {
        let (Some(intent), Some(judge)) = (&self.intent, &mut self.host_phase) else { return };
        if !is_cyclic(bytes) {
            return;
        }
        let entry = segment.path().entries.iter().find(|entry| entry.device == intent.reference);
        if let Some(entry) = entry {
            let at = start + entry.after;
            judge.frame(segment.devices()[intent.reference].system_time_ps(at));
        }
    }

    /// Something happened at a SubDevice; gives what was measured with it.
    pub fn observe(&mut self, segment: &Segment, observation: &Observation) -> Measured {
        let Observation { device: index, device_at, event } = *observation;
        let true_time = || segment.devices()[index].oscillator().when(device_at);
        let device = &mut self.devices[index];
        if let Observed::State(state, code) = event {
            device.states.push(StateChange { at: true_time(), state, code });
        }
        let mut measured = Measured::default();
        let Some(intent) = &self.intent else { return measured };
        // Who is not asked for SYNC0 has no times to keep.
        if device.sync0.is_none() && !matches!(event, Observed::SmEventMissed(_)) {
            return measured;
        }
        match event {
            Observed::Sm2 => device.margin.sm2(device_at),
            Observed::Finished(Step::MapOutputs) => {
                measured.margin = device.margin.ready(device_at);
            }
            Observed::SmEventMissed(counter) => device.missed.missed(true_time(), counter),
            Observed::Sync0 | Observed::Sync1 => {
                let at = true_time();
                let reference = segment.devices()[intent.reference].system_time_ps(at);
                if let (Observed::Sync0, Some(judge)) = (event, &mut device.sync0) {
                    measured.sync0_error = Some(judge.edge(at, reference));
                }
                let chain = segment.devices()[index].stack.sync().chain();
                if event == acting(&chain) {
                    measured.margin = device.margin.sync0(device_at);
                    device.outputs_delay.sync0(at);
                    device.cycle = intent.acting[index].map(|grid| grid.index(reference));
                }
            }
            Observed::Began(Step::OutputsValid) => {
                // With subordinated cycles the first time counts; later ones act again.
                if let Some(cycle) = device.cycle.take() {
                    let at = true_time();
                    device.outputs_delay.valid(at);
                    self.outputs_valid.valid(cycle, at);
                }
            }
            _ => {}
        }
        measured
    }
}

/// The pulse at which outputs act, by what the SubDevice is bound to.
fn acting(chain: &Chain) -> Observed {
    let at_sync1 = match chain.mode {
        SyncMode::DcSync1 | SyncMode::DcSubordinated => true,
        SyncMode::DcShiftSync1 => chain.outputs_on_sync1 && chain.has_outputs,
        _ => false,
    };
    if at_sync1 { Observed::Sync1 } else { Observed::Sync0 }
}

/// A frame whose first datagram distributes the system time and that brings more, as the cyclic ones do; those that lead
/// a clock that joins are alone.
pub fn is_cyclic(bytes: &[u8]) -> bool {
    let Ok(payload) = frame::payload(bytes) else { return false };
    let mut datagrams = isocat_wire::datagram::datagrams(payload);
    let (Some(Ok(first)), Some(Ok(_))) = (datagrams.next(), datagrams.next()) else { return false };
    let distributes = matches!(first.header.command(), Ok(Command::Frmw | Command::Armw));
    distributes && first.header.ado() == register::SYSTEM_TIME.address
}
