//! Frames as lists of datagrams, and the SubDevices that a datagram addresses.

use std::ops::Range;

use isocat_wire::Command;
use isocat_wire::datagram::{Datagram, datagrams};
use isocat_wire::frame::payload;
use isocat_wire::register::{self, STATION_ADDRESS};

use super::exchange::Exchange;

/// One datagram of a request, and the same datagram in the answer of the silicon.
pub(crate) struct Pair<'a> {
    /// Its command.
    pub command: Command,
    /// The datagram as sent.
    pub sent: Datagram<'a>,
    /// The datagram as it came back.
    pub back: Datagram<'a>,
}

/// The datagrams of a frame; empty if it is not an EtherCAT frame.
pub(crate) fn list(frame: &[u8]) -> Vec<Datagram<'_>> {
    let payload = payload(frame).unwrap_or(&[]);
    datagrams(payload).map_while(Result::ok).collect()
}

/// The datagrams of an exchange without those of unknown commands; empty without an answer.
pub(crate) fn pairs(exchange: &Exchange) -> Vec<Pair<'_>> {
    let Some((_, answer)) = &exchange.answer else { return Vec::new() };
    let both = list(&exchange.request).into_iter().zip(list(answer));
    both.filter_map(|(sent, back)| {
        let command = sent.header.command().ok()?;
        (sent.data.len() == back.data.len()).then_some(Pair { command, sent, back })
    })
    .collect()
}

impl Pair<'_> {
    /// The increment of the working counter.
    pub fn count(&self) -> u16 {
        self.back.wkc.wrapping_sub(self.sent.wkc)
    }

    /// Number of SubDevices that incremented the position; `None` if the command has no position.
    pub fn passed(&self) -> Option<usize> {
        let passed = self.back.header.adp().wrapping_sub(self.sent.header.adp());
        self.command.increments_position().then_some(usize::from(passed))
    }

    /// The memory addresses of the datagram; empty for a logical address.
    pub fn addresses(&self) -> Range<u32> {
        let first = u32::from(self.sent.header.ado());
        match self.command.is_logical() {
            true => 0..0,
            false => first..first + self.sent.data.len() as u32,
        }
    }

    /// Whether its addresses include this register's first byte.
    pub fn names(&self, address: u16) -> bool {
        self.addresses().contains(&u32::from(address))
    }

    /// The byte at this address as it came back.
    pub fn back_at(&self, address: u16) -> Option<u8> {
        byte_at(self.sent.header.ado(), self.back.data, address)
            .filter(|_| !self.command.is_logical())
    }

    /// The byte at this address as it was sent.
    pub fn sent_at(&self, address: u16) -> Option<u8> {
        byte_at(self.sent.header.ado(), self.sent.data, address)
            .filter(|_| !self.command.is_logical())
    }

    /// Two bytes from this address on, as they came back.
    pub fn back_word(&self, address: u16) -> Option<u16> {
        Some(u16::from_le_bytes([self.back_at(address)?, self.back_at(address + 1)?]))
    }
}

fn byte_at(first: u16, data: &[u8], address: u16) -> Option<u8> {
    data.get(usize::from(address.checked_sub(first)?)).copied()
}

/// Whether a command reads from the SubDevice that it addresses.
pub(crate) fn reads(command: Command) -> bool {
    use Command::*;
    matches!(command, Aprd | Aprw | Fprd | Fprw | Brd | Brw | Armw | Frmw | Lrd | Lrw)
}

/// Whether a command writes to the SubDevice that it addresses.
pub(crate) fn writes(command: Command) -> bool {
    use Command::*;
    matches!(command, Apwr | Aprw | Fpwr | Fprw | Bwr | Brw | Lwr | Lrw)
}

/// The target of a datagram.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Whom {
    /// The SubDevice at this position.
    One(usize),
    /// All SubDevices.
    All,
    /// An unknown SubDevice, or a logical address.
    Unknown,
}

/// The station address of each SubDevice, from the writes to 0x0010.
#[derive(Clone, Debug)]
pub(crate) struct Stations {
    addresses: Vec<Option<u16>>,
}

impl Stations {
    /// The stations before the capture: `addresses`, as far as known.
    pub fn new(addresses: Vec<Option<u16>>) -> Self {
        Self { addresses }
    }

    /// The target of the datagram.
    pub fn whom(&self, pair: &Pair<'_>) -> Whom {
        use Command::*;
        let adp = pair.sent.header.adp();
        match pair.command {
            Aprd | Apwr | Aprw | Armw => match usize::from(0_u16.wrapping_sub(adp)) {
                position if position < self.addresses.len() => Whom::One(position),
                _ => Whom::Unknown,
            },
            Fprd | Fpwr | Fprw | Frmw => {
                let found = self.addresses.iter().position(|address| *address == Some(adp));
                found.map_or(Whom::Unknown, Whom::One)
            }
            Brd | Bwr | Brw => Whom::All,
            _ => Whom::Unknown,
        }
    }

    /// Notes the station address that a datagram writes.
    pub fn note(&mut self, pair: &Pair<'_>) {
        let first = STATION_ADDRESS.address;
        let (Some(low), Some(high)) = (pair.sent_at(first), pair.sent_at(first + 1)) else {
            return;
        };
        if !writes(pair.command) || pair.count() == 0 {
            return;
        }
        let address = Some(u16::from_le_bytes([low, high]));
        match self.whom(pair) {
            Whom::One(position) => self.addresses[position] = address,
            Whom::All => self.addresses.fill(address),
            Whom::Unknown => {}
        }
    }
}

/// Whether the address is that of a register, not of process RAM.
pub(crate) fn is_register(address: u32) -> bool {
    address < u32::from(register::PROCESS_RAM)
}
