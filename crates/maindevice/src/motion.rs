//! A ready-made application: drives move, other outputs count.
//!
//! A device that maps a control word (0x6040) and a target position (0x607A) is taken for a CiA 402
//! drive: it is brought to "operation enabled" in cyclic synchronous position mode and follows a
//! slow triangle. Outputs of all other devices carry a counter. [`Written`] outputs on a timeline
//! have priority: a drive whose target is written stays in place until the first output begins.

use alloc::vec::Vec;

use crate::application::{Application, Cycle, Device};
use crate::event::Event;
use crate::segment::{ProcessData, Segment, SubDevice};
use crate::written::{Bits, Written};

const CONTROL_WORD: u16 = 0x6040;
const STATUS_WORD: u16 = 0x6041;
const MODE: u16 = 0x6060;
const POSITION: u16 = 0x6064;
const TARGET: u16 = 0x607A;

/// Mode of operation: cyclic synchronous position.
const CYCLIC_SYNCHRONOUS_POSITION: u8 = 8;
/// Increments that the target moves in a cycle.
const SPEED: i32 = 10;
/// Cycles from one turn of the triangle to the next.
const TURN: u64 = 1000;

/// Moves all drives and other outputs.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    axes: Vec<Axis>,
    /// Positions of the drives.
    drives: Vec<usize>,
    /// Where the other outputs are.
    counting: Vec<Run>,
    written: Written,
}

/// Outputs of one length, one after the other in the process image.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Run {
    start: usize,
    end: usize,
    /// Bytes of each device.
    each: usize,
}

/// One device of the segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Axis {
    /// A drive.
    Drive(Drive),
    /// A device with outputs that is no drive.
    Outputs,
    /// A device without outputs.
    Nothing,
}

/// A drive's process data and its motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Drive {
    control_word: usize,
    mode: Option<usize>,
    target: usize,
    status_word: usize,
    position: usize,
    commanded: Option<i32>,
    /// Whether its target is written on a timeline, so that nothing else moves it.
    is_written: bool,
    /// Cycles in "operation enabled".
    pub enabled_cycles: u64,
    /// Largest distance of target and actual position while enabled, increments.
    pub worst_lag: u32,
    /// Distance that the drive has moved, by its actual position.
    pub travelled: u64,
    last: i32,
}

impl Motion {
    /// A motion with outputs on a timeline.
    pub fn writing(written: Written) -> Self {
        Self { written, ..Self::default() }
    }

    /// The outputs on a timeline.
    pub fn written(&self) -> &Written {
        &self.written
    }

    /// The kind and state of each device, by position; empty before the first cycle.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    fn find(segment: &Segment, written: &Written) -> Vec<Axis> {
        let axis = |device: &SubDevice| {
            if let Some(drive) = Drive::find(&device.outputs, &device.inputs) {
                let is_written = written.takes(device.position, drive.target_bits());
                Axis::Drive(Drive { is_written, ..drive })
            } else if device.outputs.length > 0 {
                Axis::Outputs
            } else {
                Axis::Nothing
            }
        };
        segment.devices.iter().map(axis).collect()
    }
}

impl Application for Motion {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        if self.axes.is_empty() {
            let segment = cycle.main().segment();
            self.axes = Self::find(segment, &self.written);
            let is_drive = |at: &usize| matches!(self.axes[*at], Axis::Drive(_));
            self.drives = (0..self.axes.len()).filter(is_drive).collect();
            self.counting = Run::find(segment, &self.axes);
        }
        self.written.begin(cycle);
        let number = cycle.number();
        let ramp = core::array::from_fn(|at| (number as u8).wrapping_add(at as u8));
        let image = cycle.image_mut();
        for run in &self.counting {
            if let Some(outputs) = image.get_mut(run.start..run.end) {
                count(outputs, run.each, &ramp);
            }
        }
        for &position in &self.drives {
            if let (Axis::Drive(drive), Some(mut device)) =
                (&mut self.axes[position], cycle.device(position))
            {
                drive.cycle(&mut device, number);
            }
        }
        let Some(grid) = cycle.next_grid().filter(|_| !self.written.is_empty()) else { return };
        for mut device in cycle.devices() {
            self.written.write(&mut device, grid);
            if let Some(Axis::Drive(drive)) = self.axes.get_mut(device.position()) {
                drive.commanded =
                    bytes_at(device.outputs_mut(), drive.target).map(i32::from_le_bytes);
            }
        }
    }

    fn event(&mut self, event: &Event) {
        self.written.event(event);
    }
}

impl Run {
    /// The outputs of all devices that are no drives.
    fn find(segment: &Segment, axes: &[Axis]) -> Vec<Self> {
        let outputs = segment.devices.iter().zip(axes).filter(|(_, axis)| **axis == Axis::Outputs);
        let mut ranges: Vec<_> = outputs.map(|(device, _)| device.outputs.range()).collect();
        ranges.sort_unstable_by_key(|range| range.start);
        let mut runs: Vec<Self> = Vec::new();
        for range in ranges {
            match runs.last_mut() {
                Some(run) if (run.end, run.each) == (range.start, range.len()) => {
                    run.end = range.end;
                }
                _ => runs.push(Self { start: range.start, end: range.end, each: range.len() }),
            }
        }
        runs
    }
}

/// Writes a count into the outputs of devices of `each` bytes: each byte is one more than the one
/// before. `ramp` is its first 16 bytes; 16 at a time are written as one vector.
fn count(outputs: &mut [u8], each: usize, ramp: &[u8; 16]) {
    match each {
        1 => return fill(outputs, &[ramp[0]; 16]),
        16 => return fill(outputs, ramp),
        _ => {}
    }
    let len = outputs.len();
    let mut written = each.min(len);
    for (at, bytes) in outputs[..written].chunks_mut(ramp.len()).enumerate() {
        let value = ramp.map(|value| value.wrapping_add((ramp.len() * at) as u8));
        match bytes.first_chunk_mut() {
            Some(bytes) => *bytes = value,
            None => bytes.copy_from_slice(&value[..bytes.len()]),
        }
    }
    // The other devices get the same: what is written is copied behind itself.
    while (1..len).contains(&written) {
        let more = written.min(len - written);
        outputs.copy_within(..more, written);
        written += more;
    }
}

/// Repeats these bytes: eight times in each step, since a loop costs as much as the bytes.
fn fill(outputs: &mut [u8], bytes: &[u8; 16]) {
    let mut blocks = outputs.chunks_exact_mut(8 * bytes.len());
    for block in &mut blocks {
        for place in block.chunks_exact_mut(bytes.len()) {
            place.copy_from_slice(bytes);
        }
    }
    let mut places = blocks.into_remainder().chunks_exact_mut(bytes.len());
    for place in &mut places {
        place.copy_from_slice(bytes);
    }
    for (place, byte) in places.into_remainder().iter_mut().zip(bytes) {
        *place = *byte;
    }
}

impl Drive {
    fn find(outputs: &ProcessData, inputs: &ProcessData) -> Option<Self> {
        Some(Self {
            control_word: byte_of(outputs, CONTROL_WORD, 16)?,
            mode: byte_of(outputs, MODE, 8),
            target: byte_of(outputs, TARGET, 32)?,
            status_word: byte_of(inputs, STATUS_WORD, 16)?,
            position: byte_of(inputs, POSITION, 32)?,
            commanded: None,
            is_written: false,
            enabled_cycles: 0,
            worst_lag: 0,
            travelled: 0,
            last: 0,
        })
    }

    fn target_bits(&self) -> Bits {
        Bits { at: 8 * self.target as u32, len: 32, signed: true }
    }

    fn cycle(&mut self, device: &mut Device<'_>, cycle: u64) {
        let inputs = device.inputs();
        let (Some(status), Some(actual)) =
            (bytes_at::<2>(inputs, self.status_word), bytes_at::<4>(inputs, self.position))
        else {
            return;
        };
        let (status, actual) = (u16::from_le_bytes(status), i32::from_le_bytes(actual));
        // A device that left OP no longer updates its inputs, so its last status word is out of
        // date.
        let enabled = device.is_in_operation() && status & 0x6F == 0x27;
        let mut target = self.commanded.unwrap_or(actual);
        if enabled {
            if self.enabled_cycles > 0 {
                self.travelled += u64::from(actual.abs_diff(self.last));
                self.worst_lag = self.worst_lag.max(actual.abs_diff(target));
            }
            self.enabled_cycles += 1;
            if !self.is_written {
                let forward = (cycle / TURN).is_multiple_of(2);
                target = target.wrapping_add(if forward { SPEED } else { -SPEED });
            }
        } else {
            target = actual;
        }
        self.commanded = Some(target);
        self.last = actual;
        let outputs = device.outputs_mut();
        put(outputs, self.control_word, &next_control_word(status).to_le_bytes());
        put(outputs, self.target, &target.to_le_bytes());
        if let Some(mode) = self.mode {
            put(outputs, mode, &[CYCLIC_SYNCHRONOUS_POSITION]);
        }
    }
}

/// The control word for the next step from the state in this status word (CiA 402 drive state
/// machine).
fn next_control_word(status: u16) -> u16 {
    match status & 0x6F {
        0x08 | 0x0F | 0x28 | 0x2F => 0x80, // fault: reset it
        0x21 => 0x07,                      // ready to switch on: switch on
        0x23 | 0x27 => 0x0F,               // switched on, operation enabled: enable operation
        _ => 0x06,                         // switch on disabled: shut down
    }
}

/// Byte of an object in the process data; `None` if it is not mapped to a whole byte with this
/// length.
fn byte_of(data: &ProcessData, index: u16, bits: u8) -> Option<usize> {
    let mut bit = 0usize;
    for (_, pdos) in data.assigned() {
        // Each SyncManager begins with a whole byte.
        bit = bit.next_multiple_of(8);
        for entry in pdos.iter().flat_map(|pdo| &pdo.entries) {
            if entry.index == index && entry.sub == 0 {
                return (bit.is_multiple_of(8) && entry.bits == bits).then_some(bit / 8);
            }
            bit += usize::from(entry.bits);
        }
    }
    None
}

fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    if let Some(place) = bytes.get_mut(at..at + value.len()) {
        place.copy_from_slice(value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_count_of_any_length() {
        let ramp = core::array::from_fn(|at| 250_u8.wrapping_add(at as u8));
        for len in [0, 1, 15, 16, 17, 40, 300] {
            let mut outputs = alloc::vec![0; len];
            count(&mut outputs, len, &ramp);
            let expected = (0..len).map(|at| (250 + at) as u8);
            assert!(outputs.into_iter().eq(expected), "{len}");
        }
    }

    #[test]
    fn a_count_for_each_of_many() {
        for (each, devices) in [(1, 7), (2, 100), (16, 100), (17, 3), (300, 5)] {
            let mut outputs = alloc::vec![0; each * devices];
            count(&mut outputs, each, &core::array::from_fn(|at| at as u8));
            let expected = (0..each * devices).map(|at| (at % each) as u8);
            assert!(outputs.into_iter().eq(expected), "{each} {devices}");
        }
    }

    #[test]
    fn the_way_to_operation_enabled() {
        let mut words = Vec::new();
        for status in [0x0040, 0x0021, 0x0023, 0x0027, 0x0008] {
            words.push(next_control_word(status));
        }
        assert_eq!(words, [0x06, 0x07, 0x0F, 0x0F, 0x80]);
    }
}
