//! Times that the device measures: sub-indices 02, 03, 05, 06 and 09 on command of sub-index 08,
//! and the distances of SM events and SYNC0, 0x1C32:0F to :12.

use isocat_sync::Step;
use isocat_sync::object::{OUTPUT_PARAMETER, sub};
use isocat_wire::time::{Device, Time};
use isocat_wire::{Nanos, ObjectAddress};

/// The measured times. All in ns, and 0 before the first sample.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Measurement {
    on: bool,
    /// Whether any measurement was started since power-on.
    begun: bool,
    /// Start of the present step, by step, if it began while measuring; for the mapping of the
    /// outputs, the event that started it.
    step_began: [Option<Time<Device>>; Step::ALL.len()],
    /// The event from which Outputs Valid and Input Latch are counted.
    trigger: Time<Device>,
    last_cycle: Option<Time<Device>>,
    /// Work of the present cycle so far.
    work: Nanos,
    shortest_cycle: Option<Nanos>,
    longest_work: Nanos,
    /// Longest mapping and longest time to the action: outputs, inputs.
    longest_mapping: [Nanos; 2],
    longest_delay: [Nanos; 2],
    last_sm_event: Option<Time<Device>>,
    cycle_distance: Option<(Nanos, Nanos)>,
    sm_sync_distance: Option<(Nanos, Nanos)>,
}

impl Measurement {
    /// Sub-index 08 bit 0: starts a new measurement, or stops it; the values are kept.
    pub fn switch(&mut self, on: bool) {
        if on {
            *self = Self { on, begun: true, trigger: self.trigger, ..Self::default() };
        }
        self.on = on;
    }

    /// Whether a measurement runs.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Starts a new cyclic operation: distances belong to it alone.
    pub fn forget_distances(&mut self) {
        self.last_sm_event = None;
        self.last_cycle = None;
        self.cycle_distance = None;
        self.sm_sync_distance = None;
    }

    /// Takes an event of outputs; `begins_cycle`: whether it also begins the cycle.
    #[inline(always)]
    pub fn sm_event(&mut self, now: Time<Device>, begins_cycle: bool) {
        if let Some(last) = self.last_sm_event.replace(now) {
            widen(&mut self.cycle_distance, now - last);
        }
        if begins_cycle {
            self.cycle_begins(now);
        }
    }

    /// Takes the event that begins a cycle without DC.
    #[inline]
    pub fn cycle_begins(&mut self, now: Time<Device>) {
        self.trigger = now;
        if let Some(last) = self.last_cycle.replace(now).filter(|_| self.on) {
            let cycle = now - last;
            self.shortest_cycle = Some(self.shortest_cycle.map_or(cycle, |c| c.min(cycle)));
        }
    }

    /// Takes a SYNC0 pulse.
    #[inline]
    pub fn sync0(&mut self, now: Time<Device>) {
        self.trigger = now;
        if let Some(last) = self.last_sm_event {
            widen(&mut self.sm_sync_distance, now - last);
        }
    }

    /// Takes a SYNC1 pulse.
    #[inline]
    pub fn sync1(&mut self, now: Time<Device>) {
        self.trigger = now;
    }

    /// Takes the event that starts the mapping of outputs.
    #[inline]
    pub fn maps_outputs(&mut self, now: Time<Device>) {
        if self.on {
            self.step_began[Step::MapOutputs as usize] = Some(now);
        }
    }

    /// Takes the start of a step.
    #[inline]
    pub fn begins(&mut self, now: Time<Device>, step: Step) {
        if !self.on {
            return;
        }
        if step != Step::MapOutputs {
            self.step_began[step as usize] = Some(now);
        }
        let direction = match step {
            Step::OutputsValid => 0,
            Step::LatchInputs => 1,
            _ => return,
        };
        let delay = now - self.trigger;
        self.longest_delay[direction] = self.longest_delay[direction].max(delay);
    }

    /// Takes the end of a step.
    #[inline]
    pub fn ends(&mut self, now: Time<Device>, step: Step) {
        if !self.on {
            return;
        }
        // The measurement may have been started during the step.
        let Some(began) = self.step_began[step as usize] else { return };
        let took = now - began;
        // The meaning of 0x1C32:06 and 0x1C33:06: from the event, and from Input Latch.
        match step {
            Step::MapOutputs => self.mapped(0, took),
            Step::MapInputs => {
                if let Some(latched) = self.step_began[Step::LatchInputs as usize] {
                    self.mapped(1, now - latched);
                }
            }
            Step::Application => {}
            Step::OutputsValid | Step::LatchInputs => return,
        }
        self.work += took;
        self.longest_work = self.longest_work.max(self.work);
        if step == Step::MapInputs {
            self.work = Nanos::ZERO;
        }
    }

    /// The measured value of a sub-index; `None` for others and before the first measurement.
    pub fn value(&self, address: ObjectAddress) -> Option<u32> {
        let direction = usize::from(address.index != OUTPUT_PARAMETER);
        let value = match address.sub {
            sub::CYCLE_TIME => self.shortest_cycle.unwrap_or(Nanos::ZERO),
            sub::MINIMUM_CYCLE_TIME => self.longest_work,
            sub::CALC_AND_COPY_TIME => self.longest_mapping[direction],
            sub::SHIFT_TIME | sub::DELAY_TIME => self.longest_delay[direction],
            _ => return None,
        };
        self.begun.then(|| saturated(value))
    }

    /// Value of 0x1C32:0F to :12; `None` for other sub-indices.
    pub fn distance(&self, sub: u8) -> Option<u32> {
        let (least, most) = (|d: (Nanos, Nanos)| d.0, |d: (Nanos, Nanos)| d.1);
        let value = match sub {
            sub::MINIMUM_CYCLE_DISTANCE => self.cycle_distance.map(least),
            sub::MAXIMUM_CYCLE_DISTANCE => self.cycle_distance.map(most),
            sub::MINIMUM_SM_SYNC_DISTANCE => self.sm_sync_distance.map(least),
            sub::MAXIMUM_SM_SYNC_DISTANCE => self.sm_sync_distance.map(most),
            _ => return None,
        };
        Some(saturated(value.unwrap_or(Nanos::ZERO)))
    }

    fn mapped(&mut self, direction: usize, took: Nanos) {
        self.longest_mapping[direction] = self.longest_mapping[direction].max(took);
    }
}

#[inline]
fn widen(range: &mut Option<(Nanos, Nanos)>, value: Nanos) {
    // As a rule the value lies within.
    if range.is_none_or(|(least, most)| value < least || value > most) {
        widen_more(range, value);
    }
}

#[cold]
fn widen_more(range: &mut Option<(Nanos, Nanos)>, value: Nanos) {
    let (least, most) = range.unwrap_or((value, value));
    *range = Some((least.min(value), most.max(value)));
}

fn saturated(value: Nanos) -> u32 {
    value.to_u32().unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Started in the middle of a cycle, it measures no step that began before, and the others from
    /// the event before it.
    #[test]
    fn a_measurement_may_begin_during_a_step() {
        let at = |us: u64| Time::new(us * 1_000);
        let value = |measurement: &Measurement, sub| {
            measurement.value(ObjectAddress { index: OUTPUT_PARAMETER, sub })
        };
        let mut measurement = Measurement::default();
        measurement.sync0(at(1_000));
        measurement.begins(at(1_005), Step::Application);
        measurement.switch(true);
        measurement.ends(at(1_030), Step::Application);
        measurement.begins(at(1_030), Step::OutputsValid);
        measurement.ends(at(1_030), Step::OutputsValid);
        assert_eq!(value(&measurement, sub::MINIMUM_CYCLE_TIME), Some(0));
        assert_eq!(value(&measurement, sub::DELAY_TIME), Some(30_000));
        measurement.begins(at(2_005), Step::Application);
        measurement.ends(at(2_030), Step::Application);
        assert_eq!(value(&measurement, sub::MINIMUM_CYCLE_TIME), Some(25_000));
    }

    fn at(ns: u64) -> Time<Device> {
        Time::new(ns)
    }

    #[test]
    fn distances_count_from_the_second_event_and_saturate() {
        let mut measured = Measurement::default();
        let all = |m: &Measurement| [0x0F, 0x10, 0x11, 0x12].map(|sub| m.distance(sub).unwrap());
        assert_eq!(all(&measured), [0; 4]);
        measured.sync0(at(50));
        measured.sm_event(at(100), false);
        assert_eq!(all(&measured), [0; 4], "one event has no distance, no SYNC0 came behind it");
        for (sm, sync0) in [(1_100, 1_500), (2_099, 2_500), (3_101, 3_500)] {
            measured.sm_event(at(sm), false);
            measured.sync0(at(sync0));
        }
        assert_eq!(all(&measured), [999, 1_002, 399, 401]);
        measured.sm_event(at(3_101 + (1 << 32)), false);
        assert_eq!(measured.distance(0x10), Some(u32::MAX));
        assert_eq!(measured.distance(0x0B), None);
        measured.forget_distances();
        assert_eq!(all(&measured), [0; 4]);
    }

    #[test]
    fn work_is_measured_only_on_command() {
        let mut measured = Measurement::default();
        let outputs = |sub| ObjectAddress::new(OUTPUT_PARAMETER, sub);
        let cycle = |m: &mut Measurement, start: u64, map: u64| {
            m.cycle_begins(at(start));
            m.maps_outputs(at(start));
            // An interrupt latency of 2 ns is included.
            m.begins(at(start + 2), Step::MapOutputs);
            m.ends(at(start + map), Step::MapOutputs);
            m.begins(at(start + map), Step::Application);
            m.ends(at(start + map + 7), Step::Application);
            m.begins(at(start + map + 7), Step::OutputsValid);
            m.begins(at(start + map + 8), Step::LatchInputs);
            m.begins(at(start + map + 9), Step::MapInputs);
            m.ends(at(start + map + 12), Step::MapInputs);
        };
        cycle(&mut measured, 0, 5);
        assert_eq!(measured.value(outputs(sub::CALC_AND_COPY_TIME)), None);
        measured.switch(true);
        cycle(&mut measured, 1_000, 20);
        cycle(&mut measured, 1_900, 5);
        let values = [0x02, 0x05, 0x06, 0x09].map(|sub| measured.value(outputs(sub)));
        assert_eq!(values, [Some(900), Some(30), Some(20), Some(27)]);
        let inputs = ObjectAddress::new(0x1C33, sub::CALC_AND_COPY_TIME);
        assert_eq!(measured.value(inputs), Some(4), "from Input Latch");
        measured.switch(false);
        cycle(&mut measured, 2_000, 90);
        assert_eq!(measured.value(outputs(sub::CALC_AND_COPY_TIME)), Some(20), "values stay");
        measured.switch(true);
        assert_eq!(measured.value(outputs(sub::CALC_AND_COPY_TIME)), Some(0), "anew");
    }
}
