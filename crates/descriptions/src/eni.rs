//! ENI: the output of a configuration tool for a MainDevice (ETG.2100), read into a [`StartUp`]
//! list and written from one.
//!
//! Bytes become a tree (`tree`), and the tree an [`Eni`] (`read`, `slave`): the list, the parts for
//! which the list has no place (PDOs with their entries), and every doubt as a [`Warning`] of a
//! fixed name with its place. A broken file is a [`FileError`] with line and column. A well-formed
//! file may still be impossible for a MainDevice to run: [`Eni::runnable`] gives the reasons.
//! [`write`](fn@write) makes an ENI from a list, with comments for the parts that ENI cannot
//! express.
//!
//! Two things in every ENI are not literal. The start time (0x0990) is a placeholder, which the
//! MainDevice replaces by an instant in the future. Delays and offsets (0x0920, 0x0928) are never
//! included: the MainDevice measures them.

mod read;
mod slave;
mod tree;
mod warning;
mod write;

use std::path::Path;

use serde::Serialize;
pub use warning::{Warning, WarningKind};
pub use write::write;

use crate::document::FileError;
use crate::limits;
use crate::start_up::StartUp;

/// Version of the JSON document.
pub const FORMAT: &str = "isocat-eni/1";

/// The content of an ENI.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Eni {
    /// The name of the file in errors.
    pub path: String,
    /// EtherCATConfig@Version; empty if it is missing.
    pub version: String,
    /// The writes at start and in each cycle. Its cycle is 0 if the file does not state it.
    pub start_up: StartUp,
    /// The parts of each SubDevice for which the list has no place, by position.
    pub slaves: Vec<EniSlave>,
    /// The cycle of each `Cyclic`, ns; `None` if it is missing.
    pub cycles_ns: Vec<Option<i64>>,
    /// Every doubt, in the order of the file.
    pub warnings: Vec<Warning>,
}

/// A SubDevice's data in an ENI besides its part of the list.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EniSlave {
    /// Auto-increment address, as in the file; `None` if it is missing.
    pub auto_increment: Option<u16>,
    /// PDOs with their entries, assigned or not, outputs and inputs in the order of the file.
    pub pdos: Vec<EniPdo>,
    /// Mailbox protocols: `CoE`, `FoE` …
    pub protocols: Vec<String>,
    /// Whether it belongs to a group that may be missing.
    pub hot_connect: bool,
}

/// A PDO of a SubDevice.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EniPdo {
    /// Its index.
    pub index: u16,
    /// Whether the MainDevice writes it (`RxPdo`).
    pub outputs: bool,
    /// Its name.
    pub name: String,
    /// Its entries.
    pub entries: Vec<EniEntry>,
}

/// An entry of a PDO.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EniEntry {
    /// Index of the object; 0 is padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Bits.
    pub bits: u16,
}

impl Eni {
    /// Reads a file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        Self::from_bytes(&name, &limits::read(&name, limits::XML)?)
    }

    /// Reads the bytes of a file; `path` names it in errors.
    pub fn from_bytes(path: &str, bytes: &[u8]) -> Result<Self, FileError> {
        read::read(path, bytes)
    }

    /// The content for programs: the list, the doubts, and the reasons why a MainDevice cannot run
    /// it.
    pub fn json(&self) -> String {
        let document = Document {
            format: FORMAT,
            start_up: &self.start_up,
            warnings: &self.warnings,
            not_runnable: self.runnable().err().unwrap_or_default(),
        };
        let json = serde_json::to_string_pretty(&document);
        json.expect("texts and numbers can be written as JSON") + "\n"
    }

    /// The list, or all reasons why a MainDevice cannot run it.
    pub fn runnable(&self) -> Result<&StartUp, Vec<String>> {
        let mut reasons = Vec::new();
        let list = &self.start_up;
        let registers = |device: &crate::start_up::DeviceStartUp| !device.registers.is_empty();
        if list.devices.is_empty() {
            reasons.push("it names no SubDevice".to_owned());
        } else if !list.devices.iter().any(registers)
            && list.before.is_empty()
            && list.frames.is_empty()
        {
            let why = "it has neither register commands (InitCmds) nor cyclic frames: a list of SubDevices, no more";
            reasons.push(why.to_owned());
        } else if list.frames.iter().all(|frame| frame.datagrams.is_empty()) {
            reasons.push(
                "it has no cyclic frames (Cyclic/Frame/Cmd): no process data would run".into(),
            );
        }
        if list.cycle_ns == 0 {
            let why = "it tells no cycle time: neither Cyclic/CycleTime nor DC/CycleTime0 is there";
            reasons.push(why.to_owned());
        }
        let mut cycles: Vec<i64> = self.cycles_ns.iter().copied().flatten().collect();
        cycles.sort_unstable();
        cycles.dedup();
        if let [shortest, slower @ ..] = &cycles[..] {
            for odd in slower.iter().filter(|cycle| *cycle % shortest != 0) {
                reasons.push(format!(
                    "it has cycle times of {shortest} ns and {odd} ns; expected multiples of the shortest"
                ));
            }
        }
        for (position, device) in list.devices.iter().enumerate() {
            let same =
                list.devices[..position].iter().position(|one| one.station == device.station);
            if device.station == 0 {
                reasons.push(format!("SubDevice {position} has no station address (PhysAddr)"));
            } else if let Some(other) = same {
                let station = device.station;
                reasons.push(format!(
                    "SubDevices {other} and {position} have one station address, 0x{station:04X}"
                ));
            }
        }
        for (position, slave) in self.slaves.iter().enumerate() {
            if slave.hot_connect {
                reasons.push(format!(
                    "SubDevice {position} belongs to a HotConnect group; fixed segments are supported"
                ));
            }
        }
        if reasons.is_empty() { Ok(list) } else { Err(reasons) }
    }
}

#[derive(Serialize)]
struct Document<'a> {
    format: &'static str,
    start_up: &'a StartUp,
    warnings: &'a [Warning],
    not_runnable: Vec<String>,
}

#[cfg(test)]
mod tests;
