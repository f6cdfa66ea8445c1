//! Probes in front of SubDevices: what a frame holds where only the simulation can look.

use isocat_wire::time::{Time, True};

/// A frame at a probe.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Probed {
    /// Position of the SubDevice.
    pub device: usize,
    /// When its first bit passed.
    pub at: Time<True>,
    /// It enters the SubDevice; else it leaves it, processed.
    pub entered: bool,
    /// What it holds.
    pub bytes: Vec<u8>,
}

/// The probes of a segment, and what they have seen.
#[derive(Default)]
pub(crate) struct Probes {
    /// Positions, ascending.
    devices: Vec<usize>,
    seen: Vec<Probed>,
}

impl Probes {
    /// Looks at a SubDevice from now on.
    pub fn watch(&mut self, device: usize) {
        if let Err(at) = self.devices.binary_search(&device) {
            self.devices.insert(at, device);
        }
    }

    /// Nobody looks anywhere.
    pub fn are_none(&self) -> bool {
        self.devices.is_empty()
    }

    /// Whether somebody looks at a SubDevice.
    pub fn sees(&self, device: usize) -> bool {
        self.devices.binary_search(&device).is_ok()
    }

    /// A frame passed a probe.
    pub fn see(&mut self, frame: Probed) {
        self.seen.push(frame);
    }

    /// Gives away what was seen.
    pub fn take(&mut self) -> impl Iterator<Item = Probed> + '_ {
        self.seen.drain(..)
    }
}
