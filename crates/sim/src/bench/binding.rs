//! What a SubDevice's mode and the intent bind its process data to.

use isocat_subdevice::{Chain, SyncMode};
use isocat_wire::Nanos;

use super::Intent;
use crate::device::Device;
use crate::judge::{Grid, Opportunity, inputs_cycle, outputs_cycle};

/// The events to which the process data of a SubDevice are bound. They stay the same from cycle to
/// cycle, so they are found only once for each mode.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct Binding {
    /// The state of the SubDevice for which they were found, see [`Device::state_version`]; 0:
    /// they were not.
    version: u32,
    /// Whether the frames that store outputs matter: with an opportunity at a pulse, only the frame
    /// of the outputs that act does.
    pub follows_stored: bool,
    /// Whether SM2 and SM3 are the event of inputs.
    pub latches_at_sm2: bool,
    pub latches_at_sm3: bool,
    /// What SYNC0 and SYNC1 are for.
    pub pulses: [Roles; 2],
    pub outputs: outputs_cycle::Bound,
    pub inputs: inputs_cycle::Bound,
}

/// What a pulse is for.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Roles {
    /// It is the first occasion of outputs.
    pub takes_outputs: bool,
    /// It is the event of inputs.
    pub latches: bool,
    /// Outputs act at it.
    pub acts: bool,
}

impl Binding {
    /// Whether they were found for this state of the SubDevice.
    #[inline]
    pub const fn is_for(&self, version: u32) -> bool {
        self.version == version
    }

    /// Whether SYNC0 is the only event.
    pub fn is_plain(&self) -> bool {
        let Roles { takes_outputs, latches, acts } = self.pulses[0];
        let at_frames = self.follows_stored || self.latches_at_sm2 || self.latches_at_sm3;
        takes_outputs && latches && acts && !at_frames
    }

    /// Finds them.
    #[cold]
    pub fn new(subject: &Device, intent: &Intent, index: usize) -> Self {
        let chain = subject.stack.sync().chain();
        let is_sm_synchronous = chain.mode == SyncMode::SmSynchronous;
        let [takes, latches, acts] =
            [outputs_at_sync1(&chain), inputs_at_sync1(&chain), acts_at_sync1(&chain)];
        let roles = |is_sync1| Roles {
            takes_outputs: is_sync1 == takes,
            latches: is_sync1 == latches,
            acts: is_sync1 == acts,
        };
        let grids = Grids::new(intent, index);
        let outputs = grids.outputs(&chain);
        Self {
            version: subject.state_version(),
            outputs,
            follows_stored: !matches!(outputs, outputs_cycle::Bound::Pulse(_)),
            inputs: grids.inputs(&chain),
            latches_at_sm2: is_sm_synchronous,
            latches_at_sm3: is_sm_synchronous && !chain.has_outputs,
            pulses: [roles(false), roles(true)],
        }
    }
}

/// The intent for one SubDevice.
struct Grids {
    /// Frames with its process data; `None` if unknown.
    exchange: Option<Grid>,
    /// Time from one of these frames to the next.
    cycle: Nanos,
    /// SYNC0, and the pulse at which outputs act.
    pulses: [Option<Grid>; 2],
    inputs_shifted: bool,
}

impl Grids {
    fn new(intent: &Intent, index: usize) -> Self {
        let of = |grids: &[Option<Grid>]| grids.get(index).copied().flatten();
        let exchange = of(&intent.exchange);
        Self {
            exchange,
            cycle: exchange.unwrap_or(intent.send).cycle,
            pulses: [of(&intent.sync0), of(&intent.acting)],
            inputs_shifted: intent.inputs_shifted.get(index).copied().unwrap_or(false),
        }
    }

    fn outputs(&self, chain: &Chain) -> outputs_cycle::Bound {
        use outputs_cycle::Bound;
        match chain.mode {
            SyncMode::FreeRun => Bound::Free,
            SyncMode::SmSynchronous => Bound::Sm2(self.cycle.into()),
            _ => {
                let second = outputs_at_sync1(chain);
                let opportunity = |(frames, pulse): (Grid, Grid)| Opportunity::new(frames, pulse);
                let next = |pulse: Grid| Bound::NextPulse { pulse: pulse.cycle, frame: self.cycle };
                match self.frames_and(second).and_then(opportunity) {
                    Some(opportunity) => Bound::Pulse(opportunity),
                    None => self.pulses[usize::from(second)].map_or(Bound::Free, next),
                }
            }
        }
    }

    fn inputs(&self, chain: &Chain) -> inputs_cycle::Bound {
        use inputs_cycle::{Bound, FrameBound};
        match chain.mode {
            SyncMode::FreeRun => Bound::Free,
            // Whose frames are not known to come in a grid, as at a served segment, has inputs of
            // any age: there the beginning of their step is seen only if somebody records it.
            SyncMode::SmSynchronous if self.exchange.is_none() => Bound::Free,
            SyncMode::SmSynchronous => {
                Bound::Frame(FrameBound::new(self.cycle.into(), self.inputs_shifted))
            }
            _ => {
                let grids = self.frames_and(inputs_at_sync1(chain));
                let opportunity = grids.and_then(|(frames, pulse)| Opportunity::new(pulse, frames));
                opportunity.map_or(Bound::Free, Bound::Pulse)
            }
        }
    }

    /// The frames, and the pulses of SYNC0 or SYNC1 (`second`); `None` if one of them is unknown.
    fn frames_and(&self, second: bool) -> Option<(Grid, Grid)> {
        let frames = self.exchange?;
        let [sync0, acting] = self.pulses;
        // A SYNC1 at which outputs act comes once for each exchange.
        let sync1 = acting.map(|acting| Grid { cycle: frames.cycle, ..acting });
        Some((frames, if second { sync1? } else { sync0? }))
    }
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
