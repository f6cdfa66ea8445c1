//! Reasons for the differences between silicon and model: what the capture has written so far, and
//! what it cannot show.

use std::collections::BTreeSet;

use isocat_esc::{Pdi, PortError};
use isocat_wire::PortNumber;
use isocat_wire::eeprom::EepromStatus;
use isocat_wire::register;

use super::chain::{Chain, has_cpu};
use super::compare::{Part, Raw};
use super::exchange::Exchange;
use super::kind::Kind;
use super::parts::{Stations, Whom, pairs, reads, writes};

/// What ECAT has written in this capture, by position.
pub(crate) struct Ledger {
    written: Vec<BTreeSet<u16>>,
    /// Time of the last EEPROM write command.
    eeprom_write: Vec<Option<u64>>,
    /// Whether an EEPROM command was given.
    eeprom_used: Vec<bool>,
    /// Whether SAFEOP or OP was requested.
    went_on: Vec<bool>,
    /// ECAT events that the model was given because silicon showed them.
    raised: u16,
    /// Whether DL status and AL status of one SubDevice were read.
    status_read: [bool; 2],
    /// Number of frames for which a request without an answer may still be the reason; 0 after an
    /// exact frame.
    lost: usize,
}

impl Ledger {
    /// An empty ledger of `devices` SubDevices.
    pub fn new(devices: usize) -> Self {
        Self {
            written: vec![BTreeSet::new(); devices],
            eeprom_write: vec![None; devices],
            eeprom_used: vec![false; devices],
            went_on: vec![false; devices],
            raised: 0,
            status_read: [false; 2],
            lost: 0,
        }
    }

    /// Notes a request without an answer.
    pub fn lost(&mut self) {
        self.lost = AFTER_LOSS;
    }

    /// Notes the writes of an exchange.
    pub fn note(&mut self, exchange: &Exchange, stations: &Stations) {
        for pair in pairs(exchange) {
            if pair.count() == 0 {
                continue;
            }
            if let Whom::One(_) = stations.whom(&pair) {
                for (read, status) in self.status_read.iter_mut().zip([0x0110, 0x0130]) {
                    *read |= reads(pair.command) && (pair.names(status) || pair.names(status + 1));
                }
            }
            if !writes(pair.command) {
                continue;
            }
            let devices = match stations.whom(&pair) {
                Whom::One(position) => position..position + 1,
                Whom::All => 0..self.written.len(),
                Whom::Unknown => continue,
            };
            let command = pair.sent_at(0x0503).map_or(0, |high| u16::from(high) << 8);
            for position in devices {
                let registers = pair.addresses().filter_map(|address| u16::try_from(address).ok());
                self.written[position].extend(registers.filter(|a| *a < register::PROCESS_RAM));
                self.eeprom_used[position] |= command & EepromStatus::COMMAND != 0;
                if command & EepromStatus::COMMAND == EepromStatus::WRITE {
                    self.eeprom_write[position] = Some(exchange.at);
                }
                self.went_on[position] |=
                    pair.sent_at(0x0120).is_some_and(|state| state & 0x0C != 0);
            }
        }
    }

    /// The kind of a difference.
    pub fn kind(&self, raw: &Raw, exchange: &Exchange, chain: &Chain) -> Kind {
        let kind = self.plain_kind(raw, exchange, chain);
        match self.lost > 0 && !kind.is_explained() {
            true => Kind::LostFrame,
            false => kind,
        }
    }

    /// Notes that a frame was compared. If it is exact, the lost request made no difference.
    pub fn compared(&mut self, exact: bool) {
        self.lost = if exact { 0 } else { self.lost.saturating_sub(1) };
    }

    fn plain_kind(&self, raw: &Raw, exchange: &Exchange, chain: &Chain) -> Kind {
        match raw.part {
            Part::Source if self.nowhere(&[0x0100]) => Kind::EarlierSession,
            Part::Source => Kind::SourceAddress,
            Part::Position => Kind::Position,
            Part::EventField => self.event_kind(raw),
            Part::WorkingCounter => self.counter_kind(raw, exchange),
            Part::Data => self.data_kind(raw, exchange, chain),
        }
    }

    /// An older event, or one that a cable causes, cannot be known from the frames.
    fn event_kind(&self, raw: &Raw) -> Kind {
        let (silicon, model) = (word(&raw.silicon), word(&raw.model));
        let [dl_read, al_read] = self.status_read;
        match silicon ^ model {
            // No mask adds other events to the model, and none of these remains from before.
            changed if changed & !(DL_STATUS_EVENT | AL_STATUS_EVENT) != 0 => Kind::EventField,
            _ if self.nowhere(&[0x0200, 0x0201]) => Kind::EarlierSession,
            DL_STATUS_EVENT if silicon & DL_STATUS_EVENT != 0 => Kind::SegmentChange,
            DL_STATUS_EVENT if self.raised & DL_STATUS_EVENT != 0 => Kind::SegmentChange,
            DL_STATUS_EVENT if !dl_read => Kind::EarlierSession,
            AL_STATUS_EVENT if !al_read || self.raised & AL_STATUS_EVENT != 0 => {
                Kind::EarlierSession
            }
            _ => Kind::EventField,
        }
    }

    /// RAM is answered by SyncManagers and FMMUs, which an earlier session may have set up.
    fn counter_kind(&self, raw: &Raw, exchange: &Exchange) -> Kind {
        let in_ram = raw.address.is_none_or(|address| address >= register::PROCESS_RAM);
        let set_up = |written: &BTreeSet<u16>| written.range(0x0600..0x0880).next().is_some();
        let unknown = match raw.device {
            Some(position) => !set_up(&self.written[position]),
            None => !self.written.iter().all(set_up),
        };
        if in_ram && unknown {
            return Kind::EarlierSession;
        }
        if raw.address.is_some_and(|address| (0x0500..0x0510).contains(&address))
            && self.may_burn(raw.device, exchange)
        {
            return Kind::BurnTime;
        }
        Kind::WorkingCounter
    }

    fn data_kind(&self, raw: &Raw, exchange: &Exchange, chain: &Chain) -> Kind {
        let Some(address) = raw.address else { return Kind::Memory };
        // Data that are only written, or that no SubDevice processes, come back unchanged.
        if !pairs(exchange).get(raw.datagram).is_some_and(|p| reads(p.command) && p.count() > 0) {
            return Kind::of(address);
        }
        let end = address.saturating_add(raw.silicon.len() as u16);
        let untouched = |first: u16, end: u16| match raw.device {
            Some(position) => self.written[position].range(first..end).next().is_none(),
            None => self.written.iter().all(|set| set.range(first..end).next().is_none()),
        };
        let explained = match address {
            0x0010..0x0140
            | 0x0200..0x0202
            | 0x0400..0x0430
            | 0x0600..0x0880
            | 0x0920..0x09AA
            | 0x0F00..0x1000 => {
                let state = (0x0130..0x0136).contains(&address) && self.has_old_state(raw.device);
                let status = (0x0110..0x0112).contains(&address);
                let own =
                    !(0x0130..0x0136).contains(&address) && !status && untouched(address, end);
                (own || state).then_some(Kind::EarlierSession)
            }
            0x0300..0x0314 | 0x0442..0x0444 => Some(Kind::ErrorCounter),
            0x0500..0x0510 => self.eeprom_kind(raw, exchange, address),
            0x1000.. => {
                let used = raw.device.is_some_and(|position| !has_cpu(&chain.escs[position]));
                (!used && untouched(0x0600, 0x0880)).then_some(Kind::EarlierSession)
            }
            _ => None,
        };
        explained.unwrap_or(Kind::of(address))
    }

    /// Whether the SubDevice, or one of them all, has not been asked for a state yet.
    fn has_old_state(&self, device: Option<usize>) -> bool {
        match device {
            Some(position) => !self.written[position].contains(&0x0120),
            None => self.written.iter().any(|written| !written.contains(&0x0120)),
        }
    }

    fn eeprom_kind(&self, raw: &Raw, exchange: &Exchange, address: u16) -> Option<Kind> {
        let position = raw.device?;
        if self.may_burn(Some(position), exchange) {
            return Some(Kind::BurnTime);
        }
        let changed = raw.silicon.iter().zip(&raw.model).map(|(a, b)| a ^ b);
        let changed: Vec<u8> = changed.collect();
        let reserved =
            address == 0x0502 && changed[0] & !0x1E == 0 && changed[1..].iter().all(|b| *b == 0);
        let before = reserved && !self.went_on[position]
            || !self.eeprom_used[position]
            || address == 0x0500 && !self.written[position].contains(&0x0500);
        before.then_some(Kind::EarlierSession)
    }

    /// Whether an EEPROM write was commanded so recently that it may still be in progress.
    fn may_burn(&self, device: Option<usize>, exchange: &Exchange) -> bool {
        let written = device.and_then(|position| self.eeprom_write[position]);
        written.is_some_and(|at| exchange.at.saturating_sub(at) < BURNS_NS)
    }

    /// Whether none of these registers was written at any SubDevice.
    fn nowhere(&self, registers: &[u16]) -> bool {
        let untouched =
            |set: &BTreeSet<u16>| registers.iter().all(|register| !set.contains(register));
        self.written.iter().all(untouched)
    }

    /// Adopts what the model could not know, so that it is reported once.
    pub fn adopt(&mut self, raw: &Raw, kind: Kind, chain: &mut Chain) {
        match (kind, raw.part) {
            (Kind::EarlierSession | Kind::SegmentChange, Part::EventField) => {
                if self.nowhere(&[0x0200, 0x0201]) {
                    adopt_mask(raw, chain);
                }
                self.adopt_events(raw, chain);
            }
            (Kind::EarlierSession, Part::Source) => {
                let marks = raw.silicon[0] & 2;
                let control =
                    chain.escs.first().map(|esc| esc.register(register::DL_CONTROL) as u8);
                if let Some(control) = control {
                    chain.write(0, 0x0100, &[control & !1 | marks >> 1]);
                }
            }
            (Kind::EarlierSession, Part::Data) => self.adopt_data(raw, chain),
            (Kind::ErrorCounter, Part::Data) => adopt_counters(raw, chain),
            _ => {}
        }
    }

    /// Raises events that silicon shows and the model does not; reads those that silicon does not
    /// show.
    fn adopt_events(&mut self, raw: &Raw, chain: &mut Chain) {
        let (silicon, model) = (word(&raw.silicon), word(&raw.model));
        let present = |chain: &Chain, event: u16| {
            chain.escs.iter().any(|esc| esc.ecat_event_request() & event != 0)
        };
        for (event, status) in [(DL_STATUS_EVENT, 0x0110), (AL_STATUS_EVENT, 0x0130)] {
            let wanted = silicon & event != 0;
            for position in 0..chain.escs.len() {
                if !wanted && model & event != 0 {
                    chain.read(position, status);
                }
            }
            if !wanted || present(chain, event) {
                continue;
            }
            self.raised |= event;
            for position in 0..chain.escs.len() {
                match event {
                    DL_STATUS_EVENT => flap(chain, position),
                    _ => change_state(chain, position),
                }
            }
        }
    }

    fn adopt_data(&mut self, raw: &Raw, chain: &mut Chain) {
        let Some(address) = raw.address else { return };
        let positions = match raw.device {
            Some(position) => position..position + 1,
            None if (0x0130..0x0132).contains(&address) => 0..chain.escs.len(),
            None => return,
        };
        for position in positions {
            match address {
                0x0130..0x0132 if !self.has_old_state(Some(position)) => {}
                0x0130..0x0132 if !has_cpu(&chain.escs[position]) => {
                    chain.write(position, 0x0120, &raw.silicon);
                }
                0x0502 => {
                    let before = chain.escs[position].ecat_event_request() & AL_STATUS_EVENT;
                    visit(chain, position, 0x04);
                    if before == 0 {
                        chain.read(position, 0x0130);
                    }
                }
                0x0010..0x0130 | 0x0200..=0x0500 | 0x0600..0x1000 => {
                    chain.write(position, address, &raw.silicon);
                }
                _ => {}
            }
        }
    }
}

/// Sets the mask of all SubDevices, since the frame does not tell which of them raised the event.
fn adopt_mask(raw: &Raw, chain: &mut Chain) {
    let (silicon, model) = (word(&raw.silicon), word(&raw.model));
    for position in 0..chain.escs.len() {
        let mask = chain.escs[position].register(register::ECAT_EVENT_MASK);
        let wanted = (mask | silicon) & !(model & !silicon);
        if wanted != mask {
            chain.write(position, register::ECAT_EVENT_MASK.address, &wanted.to_le_bytes());
        }
    }
}

/// Takes a link down and up again.
fn flap(chain: &mut Chain, position: usize) {
    let esc = &mut chain.escs[position];
    let status = esc.dl_status();
    if let Some(port) = PortNumber::ALL.into_iter().rev().find(|port| status.link(*port)) {
        esc.set_port(port, false);
        esc.set_port(port, true);
    }
}

/// Changes AL status and restores it.
fn change_state(chain: &mut Chain, position: usize) {
    let other = if chain.escs[position].al_status().0 as u8 == 0x02 { 0x01 } else { 0x02 };
    visit(chain, position, other);
}

/// Sets another AL status for a moment.
fn visit(chain: &mut Chain, position: usize, state: u8) {
    let present = chain.escs[position].al_status().0.to_le_bytes();
    for status in [[state, 0], present] {
        match has_cpu(&chain.escs[position]) {
            true => chain.pdi(position).write(register::AL_STATUS.address, &status),
            false => chain.write(position, register::AL_CONTROL.address, &status),
        }
    }
}

fn word(bytes: &[u8]) -> u16 {
    u16::from_le_bytes([bytes[0], bytes[1]])
}

fn adopt_counters(raw: &Raw, chain: &mut Chain) {
    let (Some(position), Some(first)) = (raw.device, raw.address) else { return };
    let esc = &mut chain.escs[position];
    for (address, (silicon, model)) in (first..).zip(raw.silicon.iter().zip(&raw.model)) {
        let port = |offset: u16| PortNumber::ALL[usize::from(offset) & 3];
        let (port, error) = match address {
            0x0300..0x0308 if address & 1 == 0 => {
                (port((address - 0x0300) / 2), PortError::InvalidFrame)
            }
            0x0300..0x0308 => (port((address - 0x0300) / 2), PortError::RxError),
            0x0308..0x030C => (port(address - 0x0308), PortError::Forwarded),
            _ => continue,
        };
        for _ in *model..*silicon {
            esc.count_error(port, error);
        }
    }
}

/// Bits 2 and 3 of the ECAT event request.
const DL_STATUS_EVENT: u16 = 1 << 2;
const AL_STATUS_EVENT: u16 = 1 << 3;
/// Number of frames after a lost one to which its effects are attributed.
const AFTER_LOSS: usize = 64;
/// Longest time of an EEPROM write of any part.
const BURNS_NS: u64 = 20_000_000;
