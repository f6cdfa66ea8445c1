//! What a capture shows of each SubDevice, before anything is modelled: identity, EEPROM, and the
//! units that answer.

use std::collections::{BTreeMap, BTreeSet};

use isocat_wire::Command;
use isocat_wire::eeprom::EepromStatus;

use super::exchange::Exchange;
use super::parts::{Pair, Stations, Whom, is_register, pairs, reads, writes};

/// All that the capture shows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Evidence {
    /// By position.
    pub devices: Vec<Device>,
    /// Number of answers to the broadcasts that distinguish units.
    pub broadcasts: BTreeMap<Access, Broadcast>,
    /// No SubDevice has a change of its DL status to announce at the begin of the capture.
    pub no_dl_event: bool,
}

/// An access to memory, which increments the working counter or not.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub(crate) struct Access {
    /// Whether it writes; otherwise it reads.
    pub writes: bool,
    /// The first address.
    pub address: u16,
    /// Number of bytes.
    pub len: u16,
}

/// The answer to a broadcast.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Broadcast {
    /// Number of SubDevices that incremented the working counter.
    pub count: u16,
    /// For a read: the bytes of all of them, OR-ed.
    pub data: Vec<u8>,
}

/// What the capture shows of one SubDevice.
#[derive(Clone, Debug, Default)]
pub(crate) struct Device {
    /// Station address from before the capture.
    pub station: Option<u16>,
    /// Registers at their first read, before anything was written to them.
    pub first: BTreeMap<u16, u8>,
    /// Whether accesses increment the working counter.
    pub accesses: BTreeMap<Access, bool>,
    /// EEPROM words at their first read, before anything was written to them.
    pub words: BTreeMap<u32, u16>,
    /// All bits that register 0x0502 ever showed.
    pub eeprom_bits: u16,
    /// Whether status 0x0502 was read.
    pub eeprom_seen: bool,
    /// Time from an EEPROM write to the last command that was not acknowledged, and to the first
    /// one that was, ns.
    pub burn: (Option<u64>, Option<u64>),
    /// Whether SyncManagers are set up as a mailbox.
    pub mailbox: bool,
    /// Whether AL status equalled AL control with its bit 4, as device emulation copies it.
    pub al_copied: bool,
    /// Whether AL status ever differed from what AL control asks for.
    pub al_differs: bool,
}

impl Evidence {
    /// Collects the evidence of all exchanges; `positions` is the number of SubDevices, `stations`
    /// their addresses from before.
    pub fn of(list: &[Exchange], stations: Vec<Option<u16>>) -> Self {
        let mut evidence = Self::default();
        for station in &stations {
            evidence.devices.push(Device { station: *station, ..Device::default() });
        }
        evidence.no_dl_event = no_dl_event(list);
        let mut trackers = vec![Tracker::default(); stations.len()];
        let mut stations = Stations::new(stations);
        for exchange in list {
            for pair in pairs(exchange) {
                evidence.distributed(&pair);
                match stations.whom(&pair) {
                    Whom::One(position) => {
                        let device = &mut evidence.devices[position];
                        trackers[position].take(device, &pair, exchange.at, true);
                    }
                    Whom::All => {
                        evidence.broadcast(&pair);
                        let alone = trackers.len() == 1;
                        for (tracker, device) in trackers.iter_mut().zip(&mut evidence.devices) {
                            tracker.take(device, &pair, exchange.at, alone);
                        }
                    }
                    Whom::Unknown => {}
                }
                stations.note(&pair);
            }
        }
        evidence
    }

    /// A command that reads one SubDevice and writes all others counts at each that has the
    /// register.
    fn distributed(&mut self, pair: &Pair<'_>) {
        if !matches!(pair.command, Command::Armw | Command::Frmw) {
            return;
        }
        let (address, len) = (pair.sent.header.ado(), pair.sent.data.len() as u16);
        let access = Access { writes: true, address, len };
        let count = pair.count();
        self.broadcasts.entry(access).or_insert(Broadcast { count, data: Vec::new() });
    }

    fn broadcast(&mut self, pair: &Pair<'_>) {
        let Some(access) = tells_units(pair) else { return };
        let data = pair.back.data.to_vec();
        self.broadcasts.entry(access).or_insert(Broadcast { count: pair.count(), data });
    }
}

/// Whether the IRQ field lacks the DL event although it would show: the mask was written with its
/// bit, and DL status has not been read yet.
fn no_dl_event(list: &[Exchange]) -> bool {
    let mut shows = false;
    for pair in list.iter().flat_map(pairs) {
        if shows && pair.back.header.irq & DL_STATUS_EVENT == 0 {
            return true;
        }
        let reads_status = pair.names(0x0110) || pair.names(0x0111);
        if reads_status && reads(pair.command) && pair.count() > 0 {
            return false;
        }
        if writes(pair.command) && pair.count() > 0 {
            shows |=
                pair.sent_at(0x0200).is_some_and(|mask| u16::from(mask) & DL_STATUS_EVENT != 0);
        }
    }
    false
}

/// Number of SubDevices that answer, from the increments of positions; without such commands, from
/// stations.
pub(crate) fn devices(list: &[Exchange]) -> usize {
    let mut seen: BTreeMap<usize, usize> = BTreeMap::new();
    for pair in list.iter().flat_map(pairs) {
        if let Some(passed) = pair.passed() {
            *seen.entry(passed).or_default() += 1;
        }
    }
    // A number that occurs only once among many frames may be a damaged frame.
    let often = seen.iter().rev().find(|(_, times)| **times > 1);
    let most = often.or_else(|| seen.iter().next_back()).map_or(0, |(passed, _)| *passed);
    match seen.is_empty() {
        true => answering_stations(list).len(),
        false => most,
    }
}

/// Station addresses from before the capture, by position.
pub(crate) fn stations_before(list: &[Exchange], devices: usize) -> Vec<Option<u16>> {
    let before: Vec<u16> = answering_stations(list).into_iter().collect();
    let mut addresses = vec![None; devices];
    let Some(lowest) = before.first().copied() else { return addresses };
    // MainDevices count stations up from an address of their own. If one is missing here, its place
    // follows from the others only if the first address is a usual one.
    let base = USUAL_FIRST.into_iter().rev().find(|base| *base <= lowest).unwrap_or(lowest);
    let last = before.last().copied().unwrap_or(lowest);
    let base = if usize::from(last - base) < devices { base } else { lowest };
    for address in before {
        if let Some(place) = addresses.get_mut(usize::from(address - base)) {
            *place = Some(address);
        }
    }
    addresses
}

/// Stations that answered before a write assigned their address.
fn answering_stations(list: &[Exchange]) -> BTreeSet<u16> {
    let mut given = BTreeSet::new();
    let mut found = BTreeSet::new();
    let mut cleared = false;
    for pair in list.iter().flat_map(pairs).filter(|pair| pair.count() > 0) {
        let station = (pair.sent_at(0x0010), pair.sent_at(0x0011));
        match (pair.command, station) {
            (command, (Some(low), Some(high))) if writes(command) => {
                given.insert(u16::from_le_bytes([low, high]));
                cleared |= pair.command == Command::Bwr;
            }
            (Command::Fprd | Command::Fpwr | Command::Fprw, _) if !cleared => {
                let adp = pair.sent.header.adp();
                if !given.contains(&adp) {
                    found.insert(adp);
                }
            }
            _ => {}
        }
    }
    found
}

/// Operations in progress at one SubDevice.
#[derive(Clone, Default)]
struct Tracker {
    written: BTreeSet<u16>,
    eeprom_written: BTreeSet<u32>,
    /// EEPROM command, its word address and its time.
    command: u16,
    address: u32,
    given: u64,
    /// Whether the status since then is known to be not busy (`false`: busy); `None`: not read.
    done: Option<bool>,
    burning: Option<u64>,
    requested: Option<u8>,
}

impl Tracker {
    /// Takes a datagram. `alone` means that the answer is only this SubDevice's.
    fn take(&mut self, device: &mut Device, pair: &Pair<'_>, at: u64, alone: bool) {
        if alone && let Some(access) = tells_units(pair) {
            device.accesses.entry(access).or_insert(pair.count() > 0);
        }
        if pair.count() == 0 {
            return;
        }
        if alone && reads(pair.command) {
            self.read(device, pair);
        } else if reads(pair.command) {
            self.state_of_all(device, pair);
        }
        if writes(pair.command) {
            self.write(device, pair, at);
        }
    }

    fn read(&mut self, device: &mut Device, pair: &Pair<'_>) {
        for address in pair.addresses().filter(|address| is_register(*address)) {
            let address = address as u16;
            if let (false, Some(value)) = (self.written.contains(&address), pair.back_at(address)) {
                device.first.entry(address).or_insert(value);
            }
        }
        if let (Some(status), Some(requested)) = (pair.back_at(0x0130), self.requested) {
            device.al_copied |= requested & 0x10 != 0 && status & 0x1F == requested & 0x1F;
            device.al_differs |= status & 0x1F != requested & 0x1F;
        }
        for status in [0x0805, 0x080D] {
            device.mailbox |= pair.back_at(status).is_some_and(|status| status & 0x08 != 0);
        }
        self.eeprom_status(device, pair);
        self.eeprom_data(device, pair);
    }

    /// AL status of all, OR-ed: if it lacks a bit that was asked of this SubDevice, the device is
    /// not in that state.
    fn state_of_all(&mut self, device: &mut Device, pair: &Pair<'_>) {
        if let (Some(status), Some(requested)) = (pair.back_at(0x0130), self.requested) {
            device.al_differs |= requested & 0x1F & !status != 0;
        }
    }

    fn eeprom_status(&mut self, device: &mut Device, pair: &Pair<'_>) {
        let Some(status) = pair.back_word(0x0502) else { return };
        device.eeprom_seen = true;
        device.eeprom_bits |= status;
        let busy = EepromStatus(status).busy();
        let first = self.done != Some(true);
        self.done = Some(!busy);
        let Some(written) = self.burning.filter(|_| !busy && first) else { return };
        let after = self.given.saturating_sub(written);
        if after == 0 {
            return;
        }
        if status & EepromStatus::COMMAND_ERROR != 0 {
            device.burn.0 = device.burn.0.max(Some(after));
            self.done = Some(false);
        } else {
            device.burn.1 = Some(device.burn.1.map_or(after, |first| first.min(after)));
            self.burning = None;
        }
    }

    fn eeprom_data(&mut self, device: &mut Device, pair: &Pair<'_>) {
        if self.command != EepromStatus::READ || self.done == Some(false) {
            return;
        }
        let most = EepromStatus(device.eeprom_bits).read_len() as u16;
        for word in 0..most / 2 {
            let Some(value) = pair.back_word(0x0508 + 2 * word) else { break };
            let address = self.address.wrapping_add(u32::from(word));
            if !self.eeprom_written.contains(&address) {
                device.words.entry(address).or_insert(value);
            }
        }
    }

    fn write(&mut self, device: &mut Device, pair: &Pair<'_>, at: u64) {
        for address in pair.addresses().filter(|address| is_register(*address)) {
            self.written.insert(address as u16);
        }
        if let Some(control) = pair.sent_at(0x0120) {
            self.requested = Some(control);
        }
        for first in [0x0800, 0x0808] {
            let control = pair.sent_at(first + 4);
            let enabled = pair.sent_at(first + 6);
            device.mailbox |= control.is_some_and(|control| control & 0x03 == 0x02)
                && enabled.is_some_and(|enabled| enabled & 1 != 0);
        }
        for byte in 0..4 {
            if let Some(value) = pair.sent_at(0x0504 + byte) {
                let shift = 8 * u32::from(byte);
                self.address = self.address & !(0xFF << shift) | u32::from(value) << shift;
            }
        }
        let control = (pair.sent_at(0x0502), pair.sent_at(0x0503));
        if let (Some(low), Some(high)) = control {
            self.command = u16::from_le_bytes([low, high]) & EepromStatus::COMMAND;
            if self.command != 0 {
                (self.given, self.done) = (at, None);
            }
            if self.command == EepromStatus::WRITE {
                self.eeprom_written.insert(self.address);
                self.burning.get_or_insert(at);
            }
        }
    }
}

/// The access, if its answer depends only on the units of an ESC and not on its activity: type,
/// FMMUs, SyncManagers, clocks.
fn tells_units(pair: &Pair<'_>) -> Option<Access> {
    use Command::*;
    let address = pair.sent.header.ado();
    let len = u16::try_from(pair.sent.data.len()).ok()?;
    let zeros = pair.sent.data.iter().all(|byte| *byte == 0);
    let (writing, reading) =
        (matches!(pair.command, Apwr | Fpwr | Bwr), matches!(pair.command, Aprd | Fprd | Brd));
    let tells = match address {
        0x0000..0x0010 => reading,
        0x0600..0x0700 => reading || writing,
        0x0800..0x0880 => reading || writing && zeros,
        0x0900..0x0980 => reading || writing,
        0x0980..0x0A00 => reading,
        _ => false,
    };
    (tells && (reading || writing)).then_some(Access { writes: writing, address, len })
}

/// Bit 2 of the ECAT event request.
const DL_STATUS_EVENT: u16 = 1 << 2;
/// Addresses that MainDevices give to the first SubDevice, ascending: IgH, TwinCAT, ethercrab,
/// SOEM.
const USUAL_FIRST: [u16; 4] = [1, 1001, 0x1000, 0x1001];
