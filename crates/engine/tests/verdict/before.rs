//! The rules that look at registers once, when all is over: what a verdict without a memory finds in the same runs.

use isocat_engine::verdict::Readings;
use isocat_maindevice::{Event, MainDevice, SegmentChange};
use isocat_sim::run::Counters;
use isocat_sync::phase;
use isocat_wire::al::{AlState, AlStatus};
use isocat_wire::time::Nanos;

/// What the MainDevice told, as far as such a verdict takes it.
#[derive(Default)]
pub struct LastLook {
    told: Vec<&'static str>,
}

impl LastLook {
    pub fn event(&mut self, event: &Event) {
        if SegmentChange::of(event).is_some() {
            self.told.push("change");
        }
        match event {
            Event::StateChanged { .. } => self.told.push("state"),
            Event::CountChanged { expected, found, .. } if expected != found => {
                self.told.push("count");
            }
            _ => {}
        }
    }

    /// What speaks against the segment at the end; empty: "in sync".
    pub fn end(
        mut self,
        main: &MainDevice,
        readings: &[Readings],
        limit: Nanos,
        skipped: u64,
    ) -> Vec<&'static str> {
        let grew = |before: Option<u32>, after: Option<u32>| {
            let (before, after) = (before.unwrap_or(0), after.unwrap_or(0));
            after.checked_sub(before).unwrap_or(after) > 0
        };
        let counted = |before: &Counters, after: &Counters| {
            grew(before.sm_event_missed, after.sm_event_missed)
                || grew(before.cycle_time_too_small, after.cycle_time_too_small)
                || grew(before.shift_time_too_short, after.shift_time_too_short)
                || after.sync_error.is_some_and(|error| error > 0)
        };
        let segment = main.segment();
        for (device, said) in segment.devices.iter().zip(readings) {
            if said.status.is_none_or(|(status, _)| status != AlStatus::new(AlState::Op)) {
                self.told.push("state at the end");
            }
            if counted(&said.outputs_before, &said.outputs)
                || counted(&said.inputs_before, &said.inputs)
            {
                self.told.push("counter at the end");
            }
            let steered = device.mode.uses_dc() && segment.reference != Some(device.position);
            if steered && said.difference.is_some_and(|difference| difference.abs() > limit) {
                self.told.push("clock at the end");
            }
        }
        if skipped > 0 && segment.devices.iter().any(|device| device.mode.uses_dc()) {
            self.told.push("skipped");
        }
        if segment.reference.is_some() && main.phase() != Some(phase::State::Locked) {
            self.told.push("not locked");
        }
        self.told
    }
}
