//! An application that holds what it is told against what the devices count: the same in a
//! simulation and on the loop of a real interface.
//!
//! Each device counts its SYNC0 pulses into its inputs, and the time at which the cycle's frame
//! passed the reference clock says how many pulses there have been. So the inputs themselves say of
//! which cycle they are.

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;

use isocat_maindevice::{Application, Cycle, Event};
use isocat_wire::register;
use isocat_wire::time::Nanos;

/// What it saw.
#[derive(Default)]
pub struct Witness {
    /// The number of the last call; shared with the observer of the frames.
    pub called: Rc<Cell<u64>>,
    /// Calls so far.
    pub calls: u64,
    /// By position: calls in OP in which its group took part, and its inputs were fresh or not.
    pub fresh: Vec<u64>,
    pub stale: Vec<u64>,
    /// By position: calls in OP in which its group did not take part.
    pub apart: Vec<u64>,
    /// Cycles since what was written came back: least and most, by a group of every cycle.
    pub loops: Option<(u64, u64)>,
    /// Requests made, and answers.
    pub requests: (u64, u64),
    /// Calls whose frames came too late for what the devices count to tell their cycle.
    pub unpunctual: u64,
    /// What was not as it must be.
    pub wrong: Vec<String>,
    /// Cycles and their numbers by system time.
    slots: VecDeque<(u64, u64)>,
    /// Send instants that the host let pass so far.
    skipped: u64,
    /// By position: what it counts, less the number of its own cycle by system time.
    bases: Vec<Option<u64>>,
}

impl Application for Witness {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        let number = cycle.number();
        let before = self.called.replace(number);
        if self.calls > 0 && number != before + 1 {
            self.wrong.push(format!("cycle {number} behind cycle {before}"));
        }
        self.calls += 1;
        for counts in [&mut self.fresh, &mut self.stale, &mut self.apart] {
            counts.resize(cycle.len(), 0);
        }
        self.bases.resize(cycle.len(), None);
        let judged = self.take_time(cycle);
        self.unpunctual += u64::from(!judged);
        if number.is_multiple_of(3) {
            let position = number as usize / 3 % cycle.len();
            cycle.read_memory(position, register::AL_STATUS.address, 6);
            self.requests.0 += 1;
        }
        let slot = self.slots.back().map_or(0, |(_, slot)| *slot);
        for mut device in cycle.devices() {
            device.outputs_mut()[..8].copy_from_slice(&number.to_le_bytes());
            if !device.is_in_operation() {
                continue;
            }
            let (position, every) = (device.position(), u64::from(device.subdevice().every));
            let takes_part = device.takes_part();
            let inputs = device.inputs();
            let number_at = |at| u64::from_le_bytes(*inputs[at..].first_chunk().expect("8 bytes"));
            let (latched, back) = (number_at(0), number_at(8));
            let (is_fresh, of) = (device.is_fresh(), device.inputs_cycle());
            let counts = match (takes_part, is_fresh) {
                (true, true) => &mut self.fresh,
                (true, false) => &mut self.stale,
                (false, _) => &mut self.apart,
            };
            counts[position] += 1;
            let mut wrong = |what: &str| {
                if self.wrong.len() < 20 {
                    self.wrong.push(format!("cycle {number}, device {position}: {what}"));
                }
            };
            if inputs[255] != latched as u8 {
                wrong("its inputs are of two moments");
            }
            if is_fresh != (of == Some(number)) || is_fresh && !takes_part {
                wrong("it can't be fresh");
            }
            if !judged {
                continue;
            }
            if takes_part != slot.is_multiple_of(every) {
                wrong("its group takes part in other cycles");
            }
            let known = of.and_then(|of| self.slots.iter().find(|(number, _)| *number == of));
            let Some(&(_, of_slot)) = known else { continue };
            let base = match self.bases[position] {
                Some(base) => base,
                None if is_fresh => latched.wrapping_sub(slot / every),
                None => continue,
            };
            self.bases[position] = Some(base);
            if latched != base.wrapping_add(of_slot / every) {
                wrong("its inputs are of another cycle than is said");
            }
            let is_new = latched == base.wrapping_add(slot / every);
            if takes_part && is_fresh != is_new {
                wrong("its inputs are fresh and it is not said, or the other way round");
            }
            if every == 1 && is_fresh && back > 0 {
                let (least, most) = self.loops.unwrap_or((u64::MAX, 0));
                let ago = number - back;
                self.loops = Some((least.min(ago), most.max(ago)));
            }
        }
    }

    fn event(&mut self, event: &Event) {
        if let Event::Read { result, .. } = event {
            self.requests.1 += u64::from(result.is_ok());
        }
    }
}

impl Witness {
    /// Forgets how long what was written took to come back: it was lost at times.
    pub fn forget_loops(&mut self) {
        self.loops = None;
    }

    /// Takes the cycle's number by system time; whether its frames were punctual.
    fn take_time(&mut self, cycle: &Cycle<'_>) -> bool {
        let timing = cycle.main().segment().timing.as_ref().expect("the cycle is planned");
        let (period, send) = (timing.cycle.cycle.0, timing.cycle.send);
        let skipped = cycle.main().statistics().cycles_skipped;
        let in_step = std::mem::replace(&mut self.skipped, skipped) == skipped;
        let last = self.slots.back().filter(|(last, _)| in_step && last + 1 == cycle.number());
        let (slot, error) = match (cycle.reference_time(), last) {
            (Some(time), _) => {
                let time = (time + Nanos(period / 2 - send.0)).count();
                let period = period as u64;
                (time / period, (time % period) as i64 - period as i64 / 2)
            }
            // Its frame is not back: the one behind the last one, if the host was in step.
            (None, Some((_, last))) => (last + 1, 0),
            (None, None) => return false,
        };
        if self.slots.len() >= 64 {
            self.slots.pop_front();
        }
        self.slots.push_back((cycle.number(), slot));
        error.abs() < period / 10
    }
}
