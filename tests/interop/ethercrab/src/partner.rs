//! What is expected of the segment, and the other side of its applications: as
//! `tests/interop/peer.py` does it.

use std::error::Error;
use std::fmt::Write;

use serde::Deserialize;

/// The task file.
#[derive(Deserialize)]
pub struct Task {
    pub cycle_us: u64,
    pub cycles: u32,
    pub watchdog_ms: u16,
    /// Frames with the reference's time before SYNC is switched on, 1 ms apart; 0: those that
    /// ethercrab sends by itself.
    pub drift_frames: u32,
    pub devices: Vec<Device>,
}

/// A SubDevice as it should be.
#[derive(Deserialize)]
pub struct Device {
    pub name: String,
    pub vendor: u32,
    pub product: u32,
    pub revision: u32,
    pub outputs: usize,
    pub inputs: usize,
    pub mailbox: bool,
    pub sync0: bool,
    pub application: String,
    /// Index, sub-index, bytes, and the value if it never changes.
    pub entries: Vec<(u16, u8, u8, Option<u32>)>,
    /// Index, sub-index, bytes, value.
    pub startup: Vec<(u16, u8, u8, u32)>,
}

impl Task {
    pub fn read(path: &str) -> Result<Self, Box<dyn Error>> {
        Ok(serde_json::from_str(&std::fs::read_to_string(path)?)?)
    }

    /// With LRW a SubDevice counts 1 for its inputs and 2 for its outputs.
    pub fn working_counter(&self) -> u16 {
        let each =
            |device: &Device| u16::from(device.inputs > 0) + 2 * u16::from(device.outputs > 0);
        self.devices.iter().map(each).sum()
    }
}

/// Gives outputs and looks at inputs.
pub struct Partner<'a> {
    devices: Vec<(&'a Device, Watch)>,
}

#[derive(Default)]
struct Watch {
    /// Inputs that are no pattern of ours.
    torn: u32,
    /// Different patterns seen.
    moved: u32,
    last: Option<u8>,
    lag: u8,
    status: u16,
    target: i32,
    actual: i32,
    enabled: u32,
}

/// Bytes of a pattern differ by place and device.
fn pattern(number: u8, device: usize, place: usize) -> u8 {
    number.wrapping_add((device * 37 + place * 11) as u8)
}

/// Cycles from an output to its coming back, at most; stalls of the machine are far longer than
/// cycles.
const LAG: u8 = 100;
/// A drive's way in a cycle.
const STEP: i32 = 10;

impl<'a> Partner<'a> {
    pub fn new(task: &'a Task) -> Self {
        Self { devices: task.devices.iter().map(|device| (device, Watch::default())).collect() }
    }

    pub fn outputs(&mut self, number: u32, at: usize, outputs: &mut [u8]) {
        let (device, watch) = &mut self.devices[at];
        if device.application == "io" {
            for (place, byte) in outputs.iter_mut().enumerate() {
                *byte = pattern(number as u8, at, place);
            }
            return;
        }
        let control: u16 = match watch.status & 0x6F {
            status if status & 0x08 != 0 => 0x80,
            0x21 => 0x07,
            0x23 => 0x0F,
            0x27 => {
                watch.target += STEP;
                0x0F
            }
            _ => 0x06,
        };
        outputs[0..2].copy_from_slice(&control.to_le_bytes());
        outputs[2..6].copy_from_slice(&watch.target.to_le_bytes());
        outputs[6] = 8;
    }

    pub fn inputs(&mut self, number: u32, at: usize, inputs: &[u8]) {
        let (device, watch) = &mut self.devices[at];
        if device.application == "io" {
            let len = device.outputs.min(inputs.len());
            let Some(&first) = inputs.first() else { return };
            let came = first.wrapping_sub(pattern(0, at, 0));
            let whole = (0..len).all(|place| inputs[place] == pattern(came, at, place));
            let nothing = inputs.iter().all(|byte| *byte == 0);
            if !whole && !nothing {
                watch.torn += 1;
            } else if whole && !nothing {
                watch.moved += u32::from(watch.last != Some(came));
                watch.last = Some(came);
                watch.lag = watch.lag.max((number as u8).wrapping_sub(came));
            }
            return;
        }
        watch.status = u16::from_le_bytes([inputs[0], inputs[1]]);
        watch.actual = i32::from_le_bytes([inputs[2], inputs[3], inputs[4], inputs[5]]);
        if watch.status & 0x6F == 0x27 {
            watch.enabled += 1;
        } else {
            watch.target = watch.actual;
        }
    }

    /// What was not as it should be, after so many cycles.
    pub fn complaints(&self, cycles: u32) -> String {
        let mut text = String::new();
        for (device, watch) in &self.devices {
            // A coupler has no outputs that could come back.
            if device.application == "io" && device.outputs.min(device.inputs) == 0 {
                continue;
            }
            // Writing to a String cannot fail.
            let _ = if device.application == "io" {
                if watch.torn == 0 && watch.moved * 10 >= cycles * 9 && watch.lag <= LAG {
                    continue;
                }
                let Watch { torn, moved, lag, .. } = watch;
                write!(text, "{}: torn {torn}, moved {moved}, lag {lag}; ", device.name)
            } else {
                let behind = watch.target - watch.actual;
                if watch.enabled * 10 >= cycles * 6 && (0..=STEP * i32::from(LAG)).contains(&behind)
                {
                    continue;
                }
                let Watch { enabled, status, .. } = watch;
                let name = &device.name;
                write!(text, "{name}: enabled {enabled}, behind {behind}, status 0x{status:04X}; ")
            };
        }
        text
    }
}
