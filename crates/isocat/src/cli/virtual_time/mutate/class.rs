//! Classes of datagrams: those that say the same to the same place, on the way up or in operation.

use std::collections::BTreeMap;
use std::fmt;

use isocat_wire::Command;
use isocat_wire::datagram::{Header, Layout, Layouts};
use isocat_wire::frame::ETHERTYPE;
use serde::{Deserialize, Serialize};

/// A class of datagrams.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
pub struct Class {
    /// Whether SubDevices were in operation.
    pub in_operation: bool,
    pub command: u8,
    /// The address as it was sent: ADP and ADO, or a logical one.
    pub address: u32,
    pub len: u16,
    /// Index and sub-index of an object that is written by SDO; 0: none is.
    pub object: u32,
}

/// What a good run showed of a class.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Shown {
    /// Number of datagrams.
    pub count: u64,
    /// The last working counter that came back.
    pub wkc: u16,
}

/// The classes of a run.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Classes(BTreeMap<Class, Shown>);

impl Class {
    /// The class of a datagram, as a MainDevice sends it.
    pub fn of(header: &Header, data: &[u8], in_operation: bool) -> Self {
        let Header { command, address, len, .. } = *header;
        Self { in_operation, command, address, len, object: written_object(data).unwrap_or(0) }
    }

    fn command(&self) -> Option<Command> {
        Command::try_from(self.command).ok()
    }

    /// Whether it writes to one SubDevice or to all, and not to the logical process image.
    pub fn writes_registers(&self) -> bool {
        use Command::*;
        matches!(self.command(), Some(Apwr | Aprw | Fpwr | Fprw | Bwr | Brw))
    }

    /// Whether it changes anything at a SubDevice: a register, an object, process data, its clock.
    pub fn changes_something(&self) -> bool {
        use Command::*;
        match self.command() {
            Some(Lwr | Lrw | Armw | Frmw) => true,
            // A mailbox message that only asks changes nothing.
            Some(_) if self.is_mailbox() => self.object != 0,
            Some(_) => self.writes_registers(),
            None => false,
        }
    }

    /// Whether it goes to memory behind the registers: a mailbox, or process data.
    pub fn is_mailbox(&self) -> bool {
        self.writes_registers() && (self.address >> 16) as u16 >= PROCESS_RAM
    }

    /// Bytes of what it writes to registers or to an object, the first of them.
    pub fn written_bytes(&self) -> u16 {
        match self.object {
            0 if self.writes_registers() && !self.is_mailbox() => self.len.min(MOST_BYTES),
            0 => 0,
            _ => self.len.saturating_sub(SDO_VALUE as u16).min(4),
        }
    }

    /// Whether it addresses one SubDevice.
    pub fn is_of_one(&self) -> bool {
        use Command::*;
        matches!(self.command(), Some(Apwr | Aprw | Fpwr | Fprw))
    }

    /// The station address of the SubDevice, or its position.
    pub fn whom(&self) -> Option<Whom> {
        use Command::*;
        let adp = self.address as u16;
        match self.command()? {
            Fpwr | Fprw => Some(Whom::Station(adp)),
            Apwr | Aprw => Some(Whom::Position(0_u16.wrapping_sub(adp))),
            _ => None,
        }
    }
}

/// How a datagram names a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Whom {
    Station(u16),
    Position(u16),
}

impl fmt::Display for Class {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let when = if self.in_operation { "in operation" } else { "on the way up" };
        match self.command() {
            Some(command) if command.is_logical() => {
                write!(f, "{command} {:#010x}, {} bytes", self.address, self.len)?;
            }
            Some(command) => {
                let (adp, ado) = (self.address as u16, (self.address >> 16) as u16);
                write!(f, "{command} {adp:#06x}:{ado:#06x}, {} bytes", self.len)?;
            }
            None => write!(f, "command {:#04x}", self.command)?,
        }
        if self.object != 0 {
            write!(f, ", SDO {:#06x}:{:02x}", self.object >> 8, self.object & 0xFF)?;
        }
        write!(f, " {when}")
    }
}

impl Classes {
    /// Takes a frame as it was sent, and as it came back.
    pub fn take(&mut self, sent: &[u8], back: &[u8], in_operation: bool) {
        let (Some(sent), Some(back)) = (payload(sent), payload(back)) else { return };
        let mut layouts = Layouts::new();
        while let Some(Ok(layout)) = layouts.next(sent) {
            let data = &sent[layout.data()..layout.wkc()];
            let class = Class::of(&layout.header, data, in_operation);
            let known = self.0.len() < MOST_CLASSES || self.0.contains_key(&class);
            if class.changes_something() && known {
                let shown = self.0.entry(class).or_default();
                shown.count += 1;
                shown.wkc = wkc(back, &layout);
            }
        }
    }

    /// As a list, for a file.
    pub fn list(&self) -> Vec<(Class, Shown)> {
        self.0.iter().map(|(class, shown)| (*class, *shown)).collect()
    }
}

fn wkc(bytes: &[u8], layout: &Layout) -> u16 {
    let at = layout.wkc();
    bytes.get(at..at + 2).map_or(0, |wkc| u16::from_le_bytes([wkc[0], wkc[1]]))
}

/// The datagrams of an Ethernet frame; `None`: it is none of EtherCAT.
pub fn payload(frame: &[u8]) -> Option<&[u8]> {
    let kind = frame.get(12..14)?;
    (kind == ETHERTYPE.to_be_bytes()).then(|| frame.get(HEADERS..))?
}

/// Index and sub-index of the object that a mailbox message downloads by SDO.
fn written_object(data: &[u8]) -> Option<u32> {
    let coe = data.get(5)? & 0x0F == 3;
    let request = data.get(7)? >> 4 == 2;
    let download = data.get(8)? >> 5 == 1;
    let index = u32::from(u16::from_le_bytes([*data.get(9)?, *data.get(10)?]));
    (coe && request && download).then_some(index << 8 | u32::from(*data.get(11)?))
}

/// Bytes before the first datagram.
pub const HEADERS: usize = 16;
/// Where the value of an expedited SDO lies in its datagram.
pub const SDO_VALUE: usize = 12;
const PROCESS_RAM: u16 = 0x1000;
/// Bytes of a datagram of which each bit is turned over.
const MOST_BYTES: u16 = 64;
/// Classes that are kept.
const MOST_CLASSES: usize = 4096;
