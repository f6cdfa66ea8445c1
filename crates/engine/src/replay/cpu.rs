//! The actions of the CPUs, which no capture shows: before each frame they do at the PDI what its
//! answer shows that they had done.
//!
//! Forced are the AL status of devices with a CPU, contents and instants of mailboxes, inputs, and
//! the owner of the EEPROM. Everything else belongs to the ESC and is never changed here.

use std::collections::BTreeSet;

use isocat_esc::{Pdi, PdiExt};
use isocat_wire::eeprom::EepromStatus;
use isocat_wire::register::{self, PROCESS_RAM};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{Command, PortNumber};

use super::chain::{Chain, has_cpu};
use super::exchange::Exchange;
use super::parts::{Pair, Whom, pairs, writes};
use super::sight::{Sights, sights, stations};

/// The CPUs of all SubDevices.
pub(crate) struct Cpus {
    /// RAM that ECAT has written, by position: the CPUs do not write it.
    written: Vec<BTreeSet<u16>>,
}

impl Cpus {
    /// The CPUs of `devices` SubDevices.
    pub fn new(devices: usize) -> Self {
        Self { written: vec![BTreeSet::new(); devices] }
    }

    /// Acts before the first of these exchanges; the others follow later.
    pub fn act(&mut self, chain: &mut Chain, ahead: &[Exchange]) {
        let Some(exchange) = ahead.first() else { return };
        let all = sights(exchange, chain);
        let list = pairs(exchange);
        al_by_broadcast(chain, &list, ahead);
        al_by_event(chain, &list, ahead);
        for (position, sights) in all.iter().enumerate() {
            cables(chain, position, sights);
            al_control(chain, position, &list);
            if has_cpu(&chain.escs[position]) {
                al_status(chain, position, sights);
            }
            eeprom(chain, position, sights);
            for number in 0..usize::from(chain.escs[position].chip().sm_count.min(16)) {
                let manager = Manager { position, number };
                manager.pdi_control(chain, sights);
                manager.act(chain, sights, &list, ahead);
            }
            self.free_ram(chain, position, sights);
        }
        self.note_writes(chain, &list);
    }

    /// Writes RAM that no SyncManager guards and that ECAT has not written: inputs without buffers,
    /// or older contents.
    fn free_ram(&self, chain: &mut Chain, position: usize, sights: &Sights) {
        let guarded = areas(chain, position);
        let mut writes = Vec::new();
        for (address, value, known) in sights.range(u32::from(PROCESS_RAM)..0x1_0000) {
            let inside = guarded.iter().any(|area| area.contains(&usize::from(address)));
            let ram = chain.escs[position].ram();
            let present = ram.get(usize::from(address - PROCESS_RAM)).copied();
            let Some(present) = present.filter(|_| !inside) else { continue };
            let wanted = present & !known | value & known;
            if wanted != present && !self.written[position].contains(&address) {
                writes.push((address, wanted));
            }
        }
        for (address, value) in writes {
            chain.pdi(position).write(address, &[value]);
        }
    }

    fn note_writes(&mut self, chain: &Chain, list: &[Pair<'_>]) {
        let stations = stations(chain);
        for pair in list.iter().filter(|pair| writes(pair.command) && pair.count() > 0) {
            let ram = pair.addresses().filter(|address| *address >= u32::from(PROCESS_RAM));
            let ram: Vec<u16> = ram.filter_map(|address| u16::try_from(address).ok()).collect();
            match stations.whom(pair) {
                Whom::One(position) => self.written[position].extend(ram),
                Whom::All => self.written.iter_mut().for_each(|set| set.extend(ram.iter())),
                Whom::Unknown => {}
            }
        }
    }
}

/// Plugs or unplugs a cable: DL status bits 7:4.
fn cables(chain: &mut Chain, position: usize, sights: &Sights) {
    for port in PortNumber::ALL {
        let bit = 1 << (4 + port.index());
        let Some(link) = sights.bit(0x0110, bit) else { continue };
        let esc = &mut chain.escs[position];
        if esc.dl_status().link(port) != link {
            esc.set_port(port, link);
        }
    }
}

/// Reads AL control if the next request is accepted, since the CPU must have read the last one.
fn al_control(chain: &mut Chain, position: usize, list: &[Pair<'_>]) {
    let waits = chain.escs[position].al_events(isocat_wire::Time::ZERO)
        & register::al_event::AL_CONTROL
        != 0;
    if !waits {
        return;
    }
    let stations = stations(chain);
    let waiting = chain.escs.iter().filter(|esc| has_cpu(esc)).count();
    let taken = list.iter().any(|pair| {
        let requests = writes(pair.command) && pair.names(0x0120) && pair.count() > 0;
        requests
            && match stations.whom(pair) {
                Whom::One(one) => one == position,
                // It is not known which devices refuse, only how many have read: the number that
                // counted.
                Whom::All => usize::from(pair.count()) > chain.escs.len() - waiting,
                Whom::Unknown => false,
            }
    });
    if taken {
        chain.pdi(position).load(register::AL_CONTROL);
    }
}

fn al_status(chain: &mut Chain, position: usize, sights: &Sights) {
    let esc = &chain.escs[position];
    let present = esc.register(register::AL_STATUS).0.to_le_bytes();
    let code = esc.register(register::AL_STATUS_CODE).0.to_le_bytes();
    let wanted = [sights.whole(0x0130), sights.whole(0x0131)];
    let wanted = [wanted[0].unwrap_or(present[0]), wanted[1].unwrap_or(present[1])];
    let said = [sights.whole(0x0134), sights.whole(0x0135)];
    let said = [said[0].unwrap_or(code[0]), said[1].unwrap_or(code[1])];
    if said != code {
        chain.pdi(position).write(register::AL_STATUS_CODE.address, &said);
    }
    if wanted != present {
        set_al_status(chain, position, wanted);
    }
}

fn set_al_status(chain: &mut Chain, position: usize, status: [u8; 2]) {
    let mut pdi = chain.pdi(position);
    pdi.load(register::AL_CONTROL);
    pdi.write(register::AL_STATUS.address, &status);
}

/// A broadcast read of AL status shows the states of all OR-ed. Changes the devices whose AL
/// control explains that value.
fn al_by_broadcast(chain: &mut Chain, list: &[Pair<'_>], ahead: &[Exchange]) {
    if chain.escs.len() < 2 {
        return;
    }
    for pair in list {
        if !matches!(pair.command, Command::Brd | Command::Brw) || pair.count() == 0 {
            continue;
        }
        let Some(found) = pair.back_at(0x0130) else { continue };
        let or = |chain: &Chain| chain.escs.iter().fold(0, |or, esc| or | esc.al_status().0 as u8);
        if or(chain) == found {
            continue;
        }
        let movable: Vec<usize> =
            (0..chain.escs.len()).filter(|position| has_cpu(&chain.escs[*position])).collect();
        // Each device first goes to the state in which it is seen next, then to the one it was
        // asked for.
        for position in &movable {
            let next = next_status(chain, *position, ahead).map(|next| next[0]);
            let asked = chain.escs[*position].register(register::AL_CONTROL).0 as u8 & 0x0F;
            for wanted in [next, Some(asked)].into_iter().flatten() {
                if or(chain) != found && wanted & !found == 0 {
                    set_al_status(chain, *position, [wanted, 0]);
                }
            }
        }
        // State bits that no device shows any more are obsolete.
        for position in movable {
            if chain.escs[position].al_status().0 as u8 & !found != 0 {
                set_al_status(chain, position, [found, 0]);
            }
        }
    }
}

/// Changes an AL status before it is read, if the IRQ field shows the change.
fn al_by_event(chain: &mut Chain, list: &[Pair<'_>], ahead: &[Exchange]) {
    let shown = list.iter().any(|pair| pair.back.header.irq & AL_STATUS_EVENT != 0);
    let masked = |chain: &Chain| {
        chain.escs.iter().any(|esc| {
            let requested = esc.ecat_event_request() & AL_STATUS_EVENT;
            esc.register(register::ECAT_EVENT_MASK) & requested != 0
        })
    };
    if !shown || masked(chain) {
        return;
    }
    for position in 0..chain.escs.len() {
        let esc = &chain.escs[position];
        let listens = esc.register(register::ECAT_EVENT_MASK) & AL_STATUS_EVENT != 0;
        if !has_cpu(esc) || !listens {
            continue;
        }
        let present = esc.al_status().0.to_le_bytes();
        if let Some(next) = next_status(chain, position, ahead).filter(|next| *next != present) {
            return set_al_status(chain, position, next);
        }
    }
}

/// The next read of AL status from this SubDevice alone, if no request comes before it.
fn next_status(chain: &Chain, position: usize, ahead: &[Exchange]) -> Option<[u8; 2]> {
    let stations = stations(chain);
    for exchange in ahead.iter().take(FAR_AHEAD) {
        for pair in pairs(exchange) {
            let whom = stations.whom(&pair);
            let mine = whom == Whom::One(position) || whom == Whom::All && chain.escs.len() == 1;
            if (mine || whom == Whom::All) && writes(pair.command) && pair.names(0x0120) {
                return None;
            }
            if mine
                && pair.count() > 0
                && super::parts::reads(pair.command)
                && let Some(low) = pair.back_at(0x0130)
            {
                return Some([low, pair.back_at(0x0131).unwrap_or(0)]);
            }
        }
    }
    None
}

/// Sets the owner of the EEPROM, and the memory itself if the CPU emulates it.
fn eeprom(chain: &mut Chain, position: usize, sights: &Sights) {
    if let Some(holds) = sights.bit(0x0501, 1) {
        let esc = &chain.escs[position];
        if esc.register(register::EEPROM_PDI_ACCESS) & 1 != u8::from(holds) {
            chain.pdi(position).write(0x0501, &[u8::from(holds)]);
        }
    }
    let esc = &chain.escs[position];
    let status = esc.register(register::EEPROM_STATUS).0;
    let seen = sights.bit(0x0503, 0x80).map(|busy| !busy);
    let done = seen.unwrap_or_else(|| sights.byte(0x0508).is_some());
    if status & EepromStatus::EMULATED == 0 || !EepromStatus(status).busy() || !done {
        return;
    }
    let word = esc.register(register::EEPROM_ADDRESS) as usize;
    let command = status & EepromStatus::COMMAND;
    let data = esc.register(register::EEPROM_DATA).to_le_bytes();
    let len = EepromStatus(status).read_len();
    let cells = 2 * word.min(0x1_0000)..;
    let read: Vec<u8> = (cells.start..cells.start + len)
        .map(|at| chain.escs[position].eeprom().get(at).copied().unwrap_or(0xFF))
        .collect();
    match command {
        EepromStatus::READ => chain.pdi(position).write(0x0508, &read),
        EepromStatus::WRITE => {
            let memory = chain.escs[position].eeprom_mut();
            if let Some(cells) = memory.get_mut(cells.start..cells.start + 2) {
                cells.copy_from_slice(&data[..2]);
            }
        }
        _ => {}
    }
    chain.pdi(position).write(0x0502, &command.to_le_bytes());
}

/// The areas that SyncManagers guard, with all their buffers.
fn areas(chain: &Chain, position: usize) -> Vec<std::ops::Range<usize>> {
    let esc = &chain.escs[position];
    let managers = 0..usize::from(esc.chip().sm_count.min(16));
    let config = managers.map(|number| esc.register(register::sync_manager(number)));
    config
        .filter(|config| config.is_enabled() && config.length > 1)
        .map(|config| {
            let buffers = if config.is_mailbox() { 1 } else { 3 };
            let start = usize::from(config.start);
            start..start + buffers * usize::from(config.length)
        })
        .collect()
}

/// One SyncManager of one SubDevice.
#[derive(Clone, Copy)]
struct Manager {
    position: usize,
    number: usize,
}

impl Manager {
    fn config(self, chain: &Chain) -> SyncManager {
        chain.escs[self.position].register(register::sync_manager(self.number))
    }

    /// Writes the byte that belongs to the CPU.
    fn pdi_control(self, chain: &mut Chain, sights: &Sights) {
        let address = register::sm_pdi_control(self.number).address;
        if let Some(value) = sights.whole(address)
            && value & 0x03 != self.config(chain).pdi_control & 0x03
        {
            chain.pdi(self.position).write(address, &[value]);
        }
    }

    fn act(self, chain: &mut Chain, sights: &Sights, list: &[Pair<'_>], ahead: &[Exchange]) {
        let config = self.config(chain);
        if !config.is_enabled() || config.length < 2 || config.start < PROCESS_RAM {
            return;
        }
        match (config.is_mailbox(), config.is_ecat_write()) {
            (true, true) => self.take_mail(chain, &config, sights, list),
            (true, false) => self.give_mail(chain, &config, sights, list, ahead),
            (false, true) => self.take_outputs(chain, &config, sights),
            (false, false) => self.give_inputs(chain, &config, sights),
        }
    }

    /// Reads the mailbox if the capture shows it empty, or full again; reads its first byte if that
    /// was read.
    fn take_mail(
        self,
        chain: &mut Chain,
        config: &SyncManager,
        sights: &Sights,
        list: &[Pair<'_>],
    ) {
        if config.status & SyncManager::STATUS_FULL == 0 {
            return;
        }
        let status = register::sm_status(self.number).address;
        let empty = sights.bit(status, SyncManager::STATUS_FULL) == Some(false);
        let written = self.accessed(chain, config, list, writes);
        if empty || written {
            let mut mail = vec![0; usize::from(config.length)];
            chain.pdi(self.position).read(config.start, &mut mail);
        } else if sights.bit(status, SyncManager::STATUS_WRITTEN) == Some(false)
            && config.status & SyncManager::STATUS_WRITTEN != 0
        {
            chain.pdi(self.position).read(config.start, &mut [0]);
        }
    }

    /// Writes the mailbox if the capture shows it full, or read; writes its first byte if the
    /// status shows that writing began.
    fn give_mail(
        self,
        chain: &mut Chain,
        config: &SyncManager,
        sights: &Sights,
        list: &[Pair<'_>],
        ahead: &[Exchange],
    ) {
        if config.status & SyncManager::STATUS_FULL != 0 {
            return;
        }
        let status = register::sm_status(self.number).address;
        let full = sights.bit(status, SyncManager::STATUS_FULL);
        let read = self.accessed(chain, config, list, super::parts::reads);
        if full == Some(true) || read {
            let mail = self.mail(chain, config, ahead);
            chain.pdi(self.position).write(config.start, &mail);
        } else if full == Some(false) {
            let begun = sights.bit(status, SyncManager::STATUS_WRITING) == Some(true)
                && config.status & SyncManager::STATUS_WRITING == 0;
            let gone = sights.bit(status, SyncManager::STATUS_READ) == Some(false)
                && config.status & SyncManager::STATUS_READ != 0;
            if begun || gone {
                let mail = self.mail(chain, config, ahead);
                chain.pdi(self.position).write(config.start, &mail[..1]);
            }
        }
    }

    /// The content of the mailbox: all that answers show of it until its last byte is read.
    fn mail(self, chain: &Chain, config: &SyncManager, ahead: &[Exchange]) -> Vec<u8> {
        let mut mail = vec![0; usize::from(config.length)];
        let last = config.start + (config.length - 1);
        for exchange in ahead.iter().take(FAR_AHEAD) {
            let sights = &sights(exchange, chain)[self.position];
            let area = u32::from(config.start)..u32::from(last) + 1;
            for (address, value, _) in sights.range(area) {
                mail[usize::from(address - config.start)] = value;
            }
            if sights.byte(last).is_some() {
                break;
            }
        }
        mail
    }

    /// Whether ECAT accesses the area of this SyncManager from its first byte on, with success.
    fn accessed(
        self,
        chain: &Chain,
        config: &SyncManager,
        list: &[Pair<'_>],
        way: fn(Command) -> bool,
    ) -> bool {
        let stations = stations(chain);
        list.iter().any(|pair| {
            let mine = match stations.whom(pair) {
                Whom::One(position) => position == self.position,
                Whom::All => true,
                Whom::Unknown => false,
            };
            mine && way(pair.command) && pair.names(config.start) && pair.count() > 0
        })
    }

    fn take_outputs(self, chain: &mut Chain, config: &SyncManager, sights: &Sights) {
        let status = register::sm_status(self.number).address;
        let read = sights.bit(status, SyncManager::STATUS_WRITTEN) == Some(false);
        if read && config.status & SyncManager::STATUS_WRITTEN != 0 {
            let mut outputs = vec![0; usize::from(config.length)];
            chain.pdi(self.position).read(config.start, &mut outputs);
        }
    }

    /// Writes the bytes of the inputs that answers show; other bytes stay.
    fn give_inputs(self, chain: &mut Chain, config: &SyncManager, sights: &Sights) {
        let end = u32::from(config.start) + u32::from(config.length);
        let seen: Vec<_> = sights.range(u32::from(config.start)..end).collect();
        if seen.is_empty() {
            return;
        }
        let from = usize::from(config.start - PROCESS_RAM);
        let ram = chain.escs[self.position].ram();
        let Some(present) = ram.get(from..from + usize::from(config.length)) else { return };
        let mut inputs = present.to_vec();
        for (address, value, known) in seen {
            let byte = &mut inputs[usize::from(address - config.start)];
            *byte = *byte & !known | value & known;
        }
        chain.pdi(self.position).write(config.start, &inputs);
    }
}

/// Bit 3 of the ECAT event request.
const AL_STATUS_EVENT: u16 = 1 << 3;
/// Number of frames that are searched for the next action of a CPU.
const FAR_AHEAD: usize = 4096;
