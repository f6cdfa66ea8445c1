//! The modelled SubDevices in a chain, in the time of the capture.

use isocat_esc::{Chip, Esc, EscPdi, Pdi};
use isocat_wire::datagram::Address;
use isocat_wire::dl::DlStatus;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{FrameWriter, MAX_LEN, duration_ns};
use isocat_wire::register;
use isocat_wire::{AutoIncrementAddress, Command, PortNumber, Time};

use super::evidence::{Device, Evidence};
use super::guess::{Build, image};

/// The ESCs, in the order in which frames pass them.
pub(crate) struct Chain {
    /// By position.
    pub escs: Vec<Esc<Vec<u8>>>,
    /// The present instant, ns.
    now: u64,
    /// Time of the last access of the CPUs to their ESCs, or earlier.
    alive: u64,
}

impl Chain {
    /// The chain after power-on, with the cables and the station addresses at the begin of the
    /// capture.
    pub fn new(evidence: &Evidence, builds: Vec<Build>) -> Self {
        let last = evidence.devices.len().saturating_sub(1);
        let devices = evidence.devices.iter().zip(builds).enumerate();
        let escs = devices
            .map(|(position, (device, build))| esc(device, build, position < last))
            .collect();
        let mut chain = Self { escs, now: START_NS, alive: START_NS };
        for (position, device) in evidence.devices.iter().enumerate() {
            if has_cpu(&chain.escs[position]) {
                chain.pdi(position).events();
            }
            if evidence.no_dl_event {
                chain.read(position, register::DL_STATUS.address);
            }
            if let Some(station) = device.station {
                chain.write(position, register::STATION_ADDRESS.address, &station.to_le_bytes());
            }
        }
        chain
    }

    /// Advances to `at`, ns from the first frame; never backwards. CPUs behind a PDI show meanwhile
    /// that they are alive.
    pub fn advance(&mut self, at: u64) {
        let to = START_NS.saturating_add(at).max(self.now);
        while to.saturating_sub(self.alive) > ALIVE_NS {
            self.alive = (self.alive + ALIVE_NS).max(self.now);
            for esc in self.escs.iter_mut().filter(|esc| has_cpu(esc)) {
                step(esc, self.alive);
                esc.pdi(Time::new(self.alive)).events();
            }
        }
        self.escs.iter_mut().for_each(|esc| step(esc, to));
        self.now = to;
    }

    /// Passes a frame through the first `reached` SubDevices and ends it.
    pub fn pass(&mut self, frame: &mut [u8], reached: usize) {
        let duration = duration_ns(frame.len());
        for (position, esc) in self.escs.iter_mut().take(reached).enumerate() {
            let start = self.now + HOP_NS * (position as u64 + 1);
            step(esc, start);
            let processed = esc.process(frame, Time::new(start), Time::new(start + duration), true);
            if processed.latch_ports {
                for port in PortNumber::ALL {
                    if esc.dl_status().open(port) {
                        esc.receive_at_port(port, Time::new(start));
                    }
                }
            }
        }
        self.now += duration + HOP_NS * (self.escs.len() as u64 + 2);
        let now = self.now;
        self.escs.iter_mut().for_each(|esc| step(esc, now));
    }

    /// Writes to a single SubDevice, as ECAT did before the capture began.
    pub fn write(&mut self, position: usize, address: u16, data: &[u8]) {
        self.send(position, Command::Apwr, address, data);
    }

    /// Reads two bytes from a single SubDevice, as ECAT did before the capture began.
    pub fn read(&mut self, position: usize, address: u16) {
        self.send(position, Command::Aprd, address, &[0; 2]);
    }

    fn send(&mut self, position: usize, command: Command, address: u16, data: &[u8]) {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        let to = Address::Position(AutoIncrementAddress(0), address);
        if writer.push(command, 0, to, data).is_err() {
            return;
        }
        let len = writer.finish();
        let (start, end) = (self.now, self.now + duration_ns(len));
        let esc = &mut self.escs[position];
        step(esc, start);
        esc.process(&mut buffer[..len], Time::new(start), Time::new(end), true);
        self.now = end + HOP_NS;
        let now = self.now;
        self.escs.iter_mut().for_each(|esc| step(esc, now));
    }

    /// Access of the CPU to one SubDevice, at the present instant.
    pub fn pdi(&mut self, position: usize) -> EscPdi<'_, Vec<u8>> {
        self.escs[position].pdi(Time::new(self.now))
    }

    /// The source of each bit of a logical datagram at this SubDevice: offset in the data, bit
    /// there, address, bit there.
    pub fn mapped(&self, position: usize, first: u32, len: usize) -> Vec<(usize, u8, u16, u8)> {
        let esc = &self.escs[position];
        let mut bits = Vec::new();
        for number in 0..usize::from(esc.chip().fmmu_count.min(16)) {
            let fmmu = esc.register(register::fmmu(number));
            if !fmmu.is_active() || fmmu.kind & Fmmu::READ == 0 {
                continue;
            }
            let logical = u64::from(fmmu.logical_start) * 8 + u64::from(fmmu.logical_start_bit & 7);
            let physical =
                u64::from(fmmu.physical_start) * 8 + u64::from(fmmu.physical_start_bit & 7);
            let window = u64::from(first) * 8..(u64::from(first) + len as u64) * 8;
            let begin = logical.max(window.start);
            let end = (logical + u64::from(fmmu.bits())).min(window.end);
            for bit in begin..end.max(begin) {
                let (data, memory) = (bit - window.start, physical + (bit - logical));
                let Ok(address) = u16::try_from(memory / 8) else { continue };
                bits.push(((data / 8) as usize, (data % 8) as u8, address, (memory % 8) as u8));
            }
        }
        bits
    }
}

/// Whether a CPU is behind its PDI: the ESC does not use device emulation.
pub(crate) fn has_cpu(esc: &Esc<Vec<u8>>) -> bool {
    esc.register(register::ESC_CONFIGURATION) & 1 == 0
}

fn step(esc: &mut Esc<Vec<u8>>, at: u64) {
    while esc.step(Time::new(at)).is_some() {}
}

fn esc(device: &Device, build: Build, goes_on: bool) -> Esc<Vec<u8>> {
    let chip = &build.chip;
    let long = device.eeprom_bits & isocat_wire::eeprom::EepromStatus::TWO_ADDRESS_BYTES != 0;
    let words = device.words.keys().next_back().map_or(0, |last| *last as usize + 1);
    let least = if long { 4096 } else { 128 };
    let most = if long { 0x2_0000 } else { 2048 };
    let memory = image(&build.configuration, build.loads, (2 * words).clamp(least, most));
    let ram = vec![0; usize::from(chip.ram_kib) * 1024];
    let mut esc = Esc::new(chip, memory, ram);
    for (word, value) in &device.words {
        if let Some(cells) = esc.eeprom_mut().get_mut(2 * *word as usize..2 * *word as usize + 2) {
            cells.copy_from_slice(&value.to_le_bytes());
        }
    }
    for (port, link) in PortNumber::ALL.into_iter().zip(links(device, chip, goes_on)) {
        esc.set_port(port, link);
    }
    esc
}

/// The ports with a cable, as DL status first shows them; otherwise those of a line.
fn links(device: &Device, chip: &Chip, goes_on: bool) -> [bool; 4] {
    let low = device.first.get(&0x0110);
    let high = device.first.get(&0x0111);
    match (low, high) {
        (Some(low), _) => PortNumber::ALL.map(|port| DlStatus(u16::from(*low)).link(port)),
        (None, Some(high)) => {
            PortNumber::ALL.map(|port| DlStatus(u16::from(*high) << 8).communication(port))
        }
        (None, None) => {
            let mut links = [true, false, false, false];
            let onward = [PortNumber::P1, PortNumber::P3, PortNumber::P2];
            let next = onward.into_iter().find(|port| chip.has_port(*port));
            if let Some(port) = next.filter(|_| goes_on) {
                links[port.index()] = true;
            }
            links
        }
    }
}

/// The first frame of a capture is at this instant of the ESCs' oscillators.
const START_NS: u64 = 1_000_000;
/// Time from one SubDevice to the next. No compared value depends on it.
const HOP_NS: u64 = 100;
/// Longest time between two accesses of a CPU to its ESC: half of the PDI watchdog's usual time.
const ALIVE_NS: u64 = 50_000_000;
