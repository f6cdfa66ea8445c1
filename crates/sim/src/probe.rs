//! Probes at SubDevices and taps in cables: they record frames on their way through the segment.

use isocat_wire::time::{Time, True};

/// The place at which a frame was seen.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sight {
    /// It enters the processing unit of a SubDevice.
    Enters,
    /// It leaves the processing unit of a SubDevice.
    Leaves,
    /// It arrives at port 0 of a SubDevice, over the cable there.
    Outbound,
    /// It leaves port 0 of a SubDevice, into the cable there.
    Inbound,
}

/// A frame at a probe or a tap.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Probed {
    /// Position of the SubDevice.
    pub device: usize,
    /// When its first bit passed.
    pub at: Time<True>,
    /// The place.
    pub sight: Sight,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// The probes and taps of a segment, and the frames they recorded.
#[derive(Default)]
pub(crate) struct Probes {
    /// Positions with a probe, ascending.
    devices: Vec<usize>,
    /// Positions with a tap in the cable at port 0, ascending.
    cables: Vec<usize>,
    seen: Vec<Probed>,
}

impl Probes {
    /// Adds a probe to a SubDevice.
    pub fn watch(&mut self, device: usize) {
        if let Err(at) = self.devices.binary_search(&device) {
            self.devices.insert(at, device);
        }
    }

    /// Adds a tap to the cable at port 0 of a SubDevice.
    pub fn tap(&mut self, device: usize) {
        if let Err(at) = self.cables.binary_search(&device) {
            self.cables.insert(at, device);
        }
    }

    /// Whether any cable has a tap, so that frames must be followed from port to port.
    pub fn are_in_cables(&self) -> bool {
        !self.cables.is_empty()
    }

    /// Whether the cable at port 0 of a SubDevice has a tap.
    pub fn tap_at(&self, device: usize) -> bool {
        self.cables.binary_search(&device).is_ok()
    }

    /// Whether no SubDevice has a probe.
    pub fn are_none(&self) -> bool {
        self.devices.is_empty()
    }

    /// Whether a SubDevice has a probe.
    pub fn sees(&self, device: usize) -> bool {
        self.devices.binary_search(&device).is_ok()
    }

    /// Records a frame at a probe.
    pub fn see(&mut self, frame: Probed) {
        self.seen.push(frame);
    }

    /// Takes the recorded frames.
    pub fn take(&mut self) -> impl Iterator<Item = Probed> + '_ {
        self.seen.drain(..)
    }
}
