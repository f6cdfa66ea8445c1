//! Times of the events in the cycle of one SubDevice: phases in the bus cycle by the reference
//! clock.

use isocat_maindevice::segment::Timing;
use isocat_sim::Statistics;
use isocat_sync::budget::{Device, Span};
use isocat_sync::{Moment, SyncMode};
use isocat_wire::time::{Device as Oscillator, Nanos, Time, True};

/// The observed cycle of one SubDevice.
#[derive(Clone, PartialEq, Debug)]
pub struct CycleSeen {
    /// Origin of its phases.
    pub origin: Origin,
    /// Each observed event, in the order of its mean.
    pub moments: Vec<(Moment, Statistics)>,
    /// Duration of copying and calculating outputs, ps. Durations are counted by the SubDevice's
    /// own oscillator, as the judges and its objects 0x1C32 and 0x1C33 count them.
    pub outputs_took: Statistics,
    /// Duration of copying and calculating inputs, ps.
    pub inputs_took: Statistics,
    /// Time from ready outputs to the pulse at which they act, ps; negative if the pulse came
    /// first.
    pub outputs_left: Statistics,
}

/// Origin of phases.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Origin {
    /// The begin of a bus cycle, by the reference clock.
    BusCycle,
    /// The first step of the SubDevice's own cycle, in true time: in Free Run, and without a
    /// reference clock.
    OwnCycle,
}

impl CycleSeen {
    /// Statistics of an event, ps.
    pub fn of(&self, moment: Moment) -> Option<&Statistics> {
        self.moments.iter().find(|(of, _)| *of == moment).map(|(_, seen)| seen)
    }
}

/// Collects phases.
#[derive(Clone, Debug)]
pub(super) struct Phases {
    mode: SyncMode,
    /// Time from one exchange of its process data to the next.
    cycle: i128,
    /// Time from SYNC0 to SYNC0.
    pulse_cycle: i128,
    /// The phase around which an event lies: that of the plan, or else of its first occurrence.
    around: [Option<i128>; MOMENTS],
    seen: [Statistics; MOMENTS],
    /// The last event: its time by the clock in use, and its phase.
    last: Option<(i128, i128)>,
    /// The step that begins a cycle of the device's own.
    first_step: Option<Moment>,
    /// The pulse at which outputs act.
    acting: Option<Moment>,
    /// Times when outputs were fetched, were ready, were required before they were ready, and when
    /// inputs were begun.
    fetched: Option<Time<Oscillator>>,
    ready: Option<Time<Oscillator>>,
    overtaken: Option<Time<Oscillator>>,
    begun: Option<Time<Oscillator>>,
    outputs_took: Statistics,
    inputs_took: Statistics,
    outputs_left: Statistics,
}

const MOMENTS: usize = Moment::ALL.len();

impl Phases {
    pub fn new(timing: &Timing, position: usize) -> Self {
        let device = &timing.devices[position].0;
        let moments = timing.moments(position).unwrap_or_default();
        let mut around = [None; MOMENTS];
        for moment in Moment::ALL {
            let middle = |span: Span| i128::from(span.earliest.0 + span.latest.0) * 500;
            around[moment as usize] = moments.of(moment).map(middle);
        }
        Self {
            mode: device.mode,
            cycle: i128::from(device.exchange(&timing.cycle).0) * 1_000,
            pulse_cycle: i128::from(device.pulses.sync0_cycle.0) * 1_000,
            around,
            seen: [Statistics::default(); MOMENTS],
            last: None,
            first_step: None,
            acting: acting(device),
            fetched: None,
            ready: None,
            overtaken: None,
            begun: None,
            outputs_took: Statistics::default(),
            inputs_took: Statistics::default(),
            outputs_left: Statistics::default(),
        }
    }

    /// Notes an event; `system_ps` is the time of the reference clock, if there is one. Returns
    /// true for a pulse that came while outputs were in work.
    pub fn happened(
        &mut self,
        at: Time<True>,
        device_at: Time<Oscillator>,
        system_ps: Option<i128>,
        moment: Moment,
    ) -> bool {
        self.spans(device_at, moment);
        self.place(at, system_ps, moment);
        self.overtaken == Some(device_at)
    }

    fn place(&mut self, at: Time<True>, system_ps: Option<i128>, moment: Moment) {
        let number = moment as usize;
        if self.mode == SyncMode::FreeRun || system_ps.is_none() {
            return self.in_own_cycle(i128::from(at.count()), moment);
        }
        let Some(now) = system_ps else { return };
        // An event without a planned phase has that of its first occurrence, after the event before
        // it.
        let around = match (self.around[number], self.last) {
            (Some(around), _) => around,
            (None, Some((before, phase))) => *self.around[number].insert(phase + now - before),
            (None, None) => return,
        };
        let often = self.mode == SyncMode::DcSubordinated && moment.is_of_each_pulse();
        let cycle = (if often { self.pulse_cycle } else { self.cycle }).max(1);
        let into = (now - around).rem_euclid(cycle);
        let phase = around + if into > cycle / 2 { into - cycle } else { into };
        // The frame that fetches inputs belongs to the next cycle, and several pulses within a
        // cycle cannot be told apart.
        if moment != Moment::Sm3 && !often {
            self.last = Some((now, phase));
        }
        self.seen[number].push(phase as i64);
    }

    fn in_own_cycle(&mut self, now: i128, moment: Moment) {
        let begins = matches!(
            moment,
            Moment::OutputsFetched | Moment::ApplicationBegins | Moment::InputLatch
        );
        if begins && *self.first_step.get_or_insert(moment) == moment {
            self.last = Some((now, 0));
        }
        // Frames are independent of the device's own cycle.
        if !matches!(moment, Moment::Sm2 | Moment::Sm3)
            && let Some((began, _)) = self.last
        {
            self.seen[moment as usize].push((now - began) as i64);
        }
    }

    /// Notes the duration of work, and the time left before its deadline.
    fn spans(&mut self, at: Time<Oscillator>, moment: Moment) {
        match moment {
            Moment::OutputsFetched => {
                self.fetched = Some(at);
                // Outputs that no pulse has used until now are obsolete.
                self.ready = None;
            }
            Moment::OutputsReady => {
                if let Some(fetched) = self.fetched.take() {
                    self.outputs_took.push(ps(at - fetched));
                }
                match self.overtaken.take() {
                    Some(pulse) => self.outputs_left.push(ps(pulse - at)),
                    None => self.ready = Some(at),
                }
            }
            Moment::InputsBegin => self.begun = Some(at),
            Moment::InputsAvailable => {
                if let Some(begun) = self.begun.take() {
                    self.inputs_took.push(ps(at - begun));
                }
            }
            _ => {}
        }
        if self.acting == Some(moment) {
            match (self.ready.take(), self.fetched) {
                (Some(ready), _) => self.outputs_left.push(ps(at - ready)),
                (None, Some(_)) => self.overtaken = Some(at),
                (None, None) => {}
            }
        }
    }

    pub fn finish(self) -> Option<CycleSeen> {
        let mut moments: Vec<(Moment, Statistics)> = Moment::ALL
            .into_iter()
            .map(|moment| (moment, self.seen[moment as usize]))
            .filter(|(_, seen)| seen.count() > 0)
            .collect();
        moments.sort_by(|a, b| a.1.mean().total_cmp(&b.1.mean()));
        let own = self.first_step.is_some() || self.mode == SyncMode::FreeRun;
        let origin = if own { Origin::OwnCycle } else { Origin::BusCycle };
        let Self { outputs_took, inputs_took, outputs_left, .. } = self;
        let seen = CycleSeen { origin, moments, outputs_took, inputs_took, outputs_left };
        (!seen.moments.is_empty()).then_some(seen)
    }
}

fn ps(span: Nanos) -> i64 {
    span.0 * 1_000
}

/// The pulse at which the outputs of a SubDevice act, if one does.
pub fn acting(device: &Device) -> Option<Moment> {
    match device.mode {
        SyncMode::FreeRun | SyncMode::SmSynchronous => None,
        SyncMode::DcSync0 => Some(Moment::Sync0),
        SyncMode::DcShiftSync1 if device.pulses.lead == Nanos::ZERO => Some(Moment::Sync0),
        _ => Some(Moment::Sync1),
    }
}
