//! A frame on its way through the EtherCAT processing unit.

use core::ops::Range;

use isocat_wire::datagram::Layouts;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{FrameError, LOCALLY_ADMINISTERED, envelope};
use isocat_wire::register::{self, PROCESS_RAM, SHADOW_END, features};
use isocat_wire::time::Device;
use isocat_wire::{Command, Time};

use crate::access::{ECAT_WRITABLE, Gate, READABLE};
use crate::dc::clock::ceil;
use crate::dc::latch;
use crate::esc::{ECAT_AL_STATUS, ECAT_DL_STATUS, Esc, SYNC_MANAGERS, count};
use crate::fmmu::Target;
use crate::regular::Brought;
use crate::sync_manager::{Direction, Side};

/// What the caller must do about a frame that was processed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Processed {
    /// The frame wrote 0x0900: report its arrival at each port by [`Esc::receive_at_port`].
    pub latch_ports: bool,
    /// The frame ends here and is not sent on: it circulated behind a broken ring, or it is not an
    /// EtherCAT frame and DL control bit 0 forbids other frames.
    pub destroyed: bool,
}

/// A datagram as it passes an ESC, parsed by the caller.
#[derive(PartialEq, Eq, Debug)]
pub struct Passing<'a> {
    /// The command of the datagram.
    pub command: Command,
    /// The address as it arrives: ADP in the low half and ADO in the high half, or a logical
    /// address.
    pub address: u32,
    /// The IRQ field; the ESC adds its events.
    pub irq: u16,
    /// The working counter; the ESC increments it.
    pub wkc: u16,
    /// The data; the ESC answers in place.
    pub data: &'a mut [u8],
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// Passes a frame (without its check sequence) through the EPU. Its first preamble bit arrives
    /// at `start`, the last bit of its check sequence at `end`; `good` tells whether the sequence
    /// is correct.
    ///
    /// All datagrams are answered in place. Bytes written to RAM are stored at once. Writes to
    /// registers and SyncManager buffers come into force at `end`, if the frame is good: see
    /// [`Esc::step`]. EtherCAT frames without datagrams pass unchanged.
    ///
    /// A bad frame leaves registers and SyncManagers as they were. The EPU counts it (0x030C), and
    /// also counts a chain of datagrams that is cut off. The caller knows where the fault came from
    /// and counts it at the ports: [`Esc::count_error`].
    pub fn process(
        &mut self,
        frame: &mut [u8],
        start: Time<Device>,
        end: Time<Device>,
        good: bool,
    ) -> Processed {
        // Frames pass one after the other, so the last one is over, whatever end was stated for it.
        self.settle(Time::NEVER);
        let marks = self.marks_frames();
        let envelope = match envelope(frame) {
            Ok(envelope) => envelope,
            Err(error) => {
                self.forget_write_enables();
                let foreign = !matches!(error, FrameError::Kind(_));
                return Processed { destroyed: foreign && marks, ..Processed::default() };
            }
        };
        let offset = envelope.datagrams;
        if self.stops_circulating() && mark_circulating(&mut frame[offset..]) {
            self.forget_write_enables();
            return Processed { destroyed: true, ..Processed::default() };
        }
        if marks {
            frame[6] |= LOCALLY_ADMINISTERED;
        }
        if let Some(at) = envelope.udp_checksum {
            frame[at..at + 2].fill(0);
        }
        self.begin(start, false);
        let mut latch_ports = false;
        let payload = &mut frame[offset..];
        let mut layouts = Layouts::new();
        while let Some(layout) = layouts.next(payload) {
            let Ok(layout) = layout else {
                if good {
                    count(&mut self.registers, register::EPU_ERRORS.address);
                }
                break;
            };
            let header = layout.header;
            let Ok(command) = header.command() else { continue };
            if command == Command::Nop {
                continue;
            }
            let start = layout.start;
            let (data, wkc) =
                payload[layout.data()..layout.end()].split_at_mut(layout.wkc() - layout.data());
            let mut passing = Passing {
                command,
                address: header.address,
                irq: header.irq,
                wkc: u16::from_le_bytes([wkc[0], wkc[1]]),
                data,
            };
            latch_ports |= self.datagram(&mut passing);
            let (irq, count) = (passing.irq, passing.wkc);
            wkc.copy_from_slice(&count.to_le_bytes());
            if command.increments_position() {
                let adp = header.adp().wrapping_add(1);
                payload[start + 2..start + 4].copy_from_slice(&adp.to_le_bytes());
            }
            payload[start + 8..start + 10].copy_from_slice(&irq.to_le_bytes());
        }
        self.close_frame(end, good);
        Processed { latch_ports: latch_ports && good, destroyed: false }
    }

    /// Begins a frame that arrives at `start`. This splits [`process`](Self::process) for a caller
    /// that parses the frame once for many ESCs: call `begin_frame`, then
    /// [`datagram`](Self::datagram) for each datagram in order, then
    /// [`close_frame`](Self::close_frame). Datagrams that [`Reach`](crate::Reach) excludes may be
    /// left out. The caller increments auto-increment addresses and handles `marks_frames` and
    /// `stops_circulating` of [`Reach`](crate::Reach). A frame with a chain of datagrams that is
    /// cut off needs `process`.
    #[inline]
    pub fn begin_frame(&mut self, start: Time<Device>) {
        self.begin(start, false);
    }

    /// The same for a frame whose check sequence is right, as the caller knows before its end.
    #[inline]
    pub fn begin_good_frame(&mut self, start: Time<Device>) {
        self.begin(start, true);
    }

    #[inline(always)]
    fn begin(&mut self, start: Time<Device>, good: bool) {
        // Frames pass one after the other, so the last one is over, whatever end was stated for it.
        self.settle(Time::NEVER);
        self.forget_write_enables();
        self.sync_managers.begin_frame(good);
        // All datagrams of a frame show the events that were set when it arrived.
        let irq = match self.registers.load(register::ECAT_EVENT_MASK) {
            0 => 0,
            mask => mask & self.ecat_events(),
        };
        self.flight.start = start;
        self.flight.irq = irq;
        self.flight.latches = false;
        self.flight.brought = Brought::NONE;
        self.flight.label = 0;
        self.flight.is_cyclic = false;
        self.flight.acknowledged = 0;
        self.flight.latch_times = 0;
        self.flight.enabled = [false; 2];
    }

    /// Answers a datagram of the frame that has begun, in place. Returns whether the datagram
    /// latches the ports' receive times, if the frame is good: see [`Processed::latch_ports`].
    pub fn datagram(&mut self, passing: &mut Passing<'_>) -> bool {
        let Passing { command, address, .. } = *passing;
        if command == Command::Nop {
            return false;
        }
        passing.irq |= self.flight.irq;
        let data = &mut *passing.data;
        if let Some(count) = self.regular(command, address, data) {
            passing.wkc = passing.wkc.wrapping_add(count);
            return false;
        }
        let (adp, ado) = (address as u16, (address >> 16) as u16);
        let count = if command.is_logical() {
            self.logical(command, address, data)
        } else {
            self.physical(command, adp, ado, data)
        };
        passing.wkc = passing.wkc.wrapping_add(count);
        let receive_time = usize::from(register::RECEIVE_TIME_0.address);
        let first = usize::from(ado);
        let latches = count > 0
            && matches!(command, Command::Bwr | Command::Fpwr)
            && first < receive_time + 4
            && first + data.len() > receive_time;
        self.flight.latches |= latches;
        latches
    }

    /// Ends the frame: the last bit of its check sequence, which is `good` or not, arrives at
    /// `end`. What the frame wrote comes into force then.
    #[inline]
    pub fn close_frame(&mut self, end: Time<Device>, good: bool) {
        if !good {
            self.shadow.clear();
            self.flight.brought = Brought::NONE;
            self.sync_managers.end_bad_frame();
            count(&mut self.registers, register::EPU_ERRORS.address);
            return;
        }
        let mut events = self.flight.acknowledged;
        if events != 0 {
            events &= self.ecat_events();
        }
        let latch_read = self.flight.latch_times != 0;
        let written = !self.shadow.is_empty() || !self.flight.brought.is_none();
        if written || self.sync_managers.is_closing() || events != 0 || latch_read {
            self.flight.acknowledged = events;
            // The effects of a frame's end happen on a tick.
            self.flight.end = ceil(end);
        }
        if self.flight.latches {
            self.dc.latch_ports(self.flight.start, &mut self.registers);
        }
    }

    /// Answers a datagram addressed by position, by station or to all. Returns its working counter
    /// increment.
    fn physical(&mut self, command: Command, adp: u16, ado: u16, data: &mut [u8]) -> u16 {
        use Command::*;
        let mine = match command {
            Brd | Bwr | Brw => true,
            Aprd | Apwr | Aprw | Armw => adp == 0,
            _ => self.is_addressed(adp),
        };
        match command {
            Aprd | Fprd if mine => u16::from(self.read_into(ado, data)),
            Apwr | Fpwr | Bwr if mine => u16::from(self.ecat_write(ado, data, 0xFF)),
            Aprw | Fprw if mine => self.exchange(ado, data, |data, memory| *data = memory),
            Brd => u16::from(self.ecat_read(ado, data.len(), |memory, at| {
                for (byte, memory) in data[at].iter_mut().zip(memory) {
                    *byte |= *memory;
                }
            })),
            Brw => self.exchange(ado, data, |data, memory| *data |= memory),
            Armw | Frmw if mine => u16::from(self.read_into(ado, data)),
            Armw | Frmw => u16::from(self.ecat_write(ado, data, 0xFF)),
            _ => 0,
        }
    }

    /// Whether this is the ESC's station address or its alias.
    pub(crate) fn is_addressed(&self, adp: u16) -> bool {
        adp == self.registers.load(register::STATION_ADDRESS)
            || adp == self.registers.load(register::STATION_ALIAS)
                && self.registers.byte(register::DL_CONTROL.address + 3) & 1 != 0
    }

    /// Answers a logical datagram and returns its working counter increment. Writes go first: they
    /// use the data as received, before this ESC replaces it by its own.
    fn logical(&mut self, command: Command, address: u32, data: &mut [u8]) -> u16 {
        if command == Command::Lrw && self.chip.has(features::NO_LRW) {
            return 0;
        }
        let mut count = 0;
        let len = data.len();
        if command != Command::Lrd {
            let found = match self.fmmus.alone(Fmmu::WRITE, address, len) {
                Ok(target) => {
                    let any = target.is_some_and(|(to, at)| self.write_mapped(to, &data[at]));
                    count += u16::from(any) << u16::from(command == Command::Lrw);
                    None
                }
                Err(_) => self.fmmus.hits(&self.registers, Fmmu::WRITE, address, len),
            };
            if let Some(hits) = found {
                let mut any = false;
                hits.targets(address, len, |target| any |= self.write_target(&target, data));
                count += if !any {
                    0
                } else if command == Command::Lrw {
                    2
                } else {
                    1
                };
            }
        }
        if command != Command::Lwr {
            let found = match self.fmmus.alone(Fmmu::READ, address, len) {
                Ok(target) => {
                    let any =
                        target.is_some_and(|(from, at)| self.read_mapped(from, &mut data[at]));
                    count += u16::from(any);
                    None
                }
                Err(_) => self.fmmus.hits(&self.registers, Fmmu::READ, address, len),
            };
            if let Some(hits) = found {
                let mut any = false;
                hits.targets(address, len, |target| any |= self.read_target(&target, data));
                count += u16::from(any);
            }
        }
        count
    }

    /// Writes where one FMMU alone decides; as a rule this is a whole buffer.
    fn write_mapped(&mut self, address: u16, data: &[u8]) -> bool {
        match address {
            PROCESS_RAM.. => self.write_ram(address, data, 0xFF),
            _ => self.ecat_write(address, data, 0xFF),
        }
    }

    /// Reads where one FMMU alone decides.
    fn read_mapped(&mut self, address: u16, data: &mut [u8]) -> bool {
        match address {
            PROCESS_RAM.. => {
                let len = data.len();
                self.read_ram(address, len, |memory, at| data[at].copy_from_slice(memory))
            }
            _ => self.read_into(address, data),
        }
    }

    fn write_target(&mut self, target: &Target, data: &[u8]) -> bool {
        match *target {
            Target::Bytes { address, data: ref at } => {
                self.ecat_write(address, &data[at.clone()], 0xFF)
            }
            Target::Bits { address, mask, data_bit } => {
                let mut value = 0;
                for (bit, at) in bits_of(mask, data_bit) {
                    value |= (data[at / 8] >> (at % 8) & 1) << bit;
                }
                self.ecat_write(address, &[value], mask)
            }
        }
    }

    fn read_target(&mut self, target: &Target, data: &mut [u8]) -> bool {
        match *target {
            Target::Bytes { address, data: ref at } => {
                self.read_into(address, &mut data[at.clone()])
            }
            Target::Bits { address, mask, data_bit } => {
                let mut value = 0;
                let any = self.ecat_read(address, 1, |memory, _| value = memory[0]);
                if any {
                    for (bit, at) in bits_of(mask, data_bit) {
                        data[at / 8] =
                            data[at / 8] & !(1 << (at % 8)) | (value >> bit & 1) << (at % 8);
                    }
                }
                any
            }
        }
    }

    /// Reads the bytes that exist; other bytes of the data stay as they are.
    fn read_into(&mut self, address: u16, data: &mut [u8]) -> bool {
        self.ecat_read(address, data.len(), |memory, at| data[at].copy_from_slice(memory))
    }

    /// Reads the old content and writes the data as received. If the chip has register 0x0108, the
    /// write goes that many bytes further on. The same datagram may then read what it has written,
    /// byte by byte.
    fn exchange(&mut self, address: u16, data: &mut [u8], merge: impl Fn(&mut u8, u8)) -> u16 {
        if self.chip.has(features::NO_READ_WRITE) {
            return 0;
        }
        let (mut read, mut written) = (false, false);
        let further = match self.units.physical_offset {
            true => self.registers.load(register::PHYSICAL_OFFSET),
            false => 0,
        };
        let mut received = [0; 32];
        let step = if further == 0 { received.len() } else { 1 };
        for (number, chunk) in data.chunks_mut(step).enumerate() {
            let Ok(address) = u16::try_from(usize::from(address) + number * step) else {
                break;
            };
            let received = &mut received[..chunk.len()];
            received.copy_from_slice(chunk);
            read |= self.ecat_read(address, chunk.len(), |memory, at| {
                for (byte, memory) in chunk[at].iter_mut().zip(memory) {
                    merge(byte, *memory);
                }
            });
            written |= self.ecat_write(address.wrapping_add(further), received, 0xFF);
        }
        u16::from(read) + 2 * u16::from(written)
    }

    /// Reads memory from the wire. `each` gets every run that can be read, and its place in the
    /// data.
    fn ecat_read(
        &mut self,
        address: u16,
        len: usize,
        mut each: impl FnMut(&mut [u8], Range<usize>),
    ) -> bool {
        let mut any = false;
        let (registers, ram) = split(address, len);
        if registers > 0 {
            let end = address + registers as u16;
            self.show_to_ecat(address..end);
            let mut at = address;
            while at < end {
                let (stop, gate) = self.units.run(&READABLE, at);
                let stop = stop.min(end);
                if gate.is_some() {
                    let place = usize::from(at - address)..usize::from(stop - address);
                    each(self.registers.bytes_mut(at..stop), place);
                    any = true;
                }
                at = stop;
            }
        }
        if ram > 0 {
            any |= self.read_ram(address.max(PROCESS_RAM), ram, |memory, at| {
                each(memory, at.start + registers..at.end + registers);
            });
        }
        any
    }

    fn read_ram(
        &mut self,
        address: u16,
        len: usize,
        each: impl FnMut(&mut [u8], Range<usize>),
    ) -> bool {
        if !self.is_operational() {
            return false;
        }
        self.reach_ram(address, len);
        let end = self.ram_len.min(self.ram.as_ref().len());
        let memory = &mut self.ram.as_mut()[..end];
        self.sync_managers.access((Side::Ecat, Direction::Read), memory, address, len, each).any
    }

    /// Writes the bits of `mask` of each byte from the wire.
    fn ecat_write(&mut self, address: u16, data: &[u8], mask: u8) -> bool {
        let mut any = false;
        let (registers, ram) = split(address, data.len());
        if registers > 0 {
            any = self.write_registers(address, &data[..registers], mask);
        }
        if ram > 0 {
            let data = &data[registers..registers + ram];
            any |= self.write_ram(address.max(PROCESS_RAM), data, mask);
        }
        any
    }

    fn write_ram(&mut self, address: u16, data: &[u8], mask: u8) -> bool {
        if !self.is_operational() || self.is_protected(PROCESS_RAM) {
            return false;
        }
        self.reach_ram(address, data.len());
        let end = self.ram_len.min(self.ram.as_ref().len());
        let memory = &mut self.ram.as_mut()[..end];
        let way = (Side::Ecat, Direction::Write);
        let access = self.sync_managers.access(way, memory, address, data.len(), |memory, at| {
            if mask == 0xFF {
                memory.copy_from_slice(&data[at]);
            } else {
                for (byte, data) in memory.iter_mut().zip(&data[at]) {
                    *byte = *byte & !mask | *data & mask;
                }
            }
        });
        access.any
    }

    fn write_registers(&mut self, address: u16, data: &[u8], mask: u8) -> bool {
        self.put_brought_aside();
        // This is usually the drift frame: none of its bytes depends on the state of the chip.
        if mask == 0xFF
            && (WRITE_ENABLES..DIGITAL_OUTPUTS).contains(&address)
            && !self.is_protected(address)
            && self.shadow.put_in_line(address, data)
        {
            return true;
        }
        let mut any = false;
        let end = address + data.len() as u16;
        let mut at = address;
        while at < end {
            let (stop, gate) = self.units.run(&ECAT_WRITABLE, at);
            let stop = stop.min(end);
            if let Some(gate) = gate {
                for address_of_byte in at..stop {
                    if !self.ecat_may_write(gate, address_of_byte) {
                        continue;
                    }
                    let value = data[usize::from(address_of_byte - address)];
                    any = true;
                    match address_of_byte {
                        0x0020 => self.flight.enabled[0] = true,
                        0x0030 => self.flight.enabled[1] = true,
                        _ => {}
                    }
                    if address_of_byte >= SHADOW_END {
                        let old = self.registers.byte(address_of_byte);
                        self.registers.set_byte(address_of_byte, old & !mask | value & mask);
                    } else {
                        self.shadow.put(&self.registers, address_of_byte, value, mask);
                    }
                }
            }
            at = stop;
        }
        if any && end > DIGITAL_OUTPUTS {
            self.sync_managers.write_registers(address, data.len());
        }
        any
    }

    fn ecat_may_write(&self, gate: Gate, address: u16) -> bool {
        let owner_is_ecat =
            |bit: u8| self.registers.load(register::CYCLIC_UNIT_CONTROL) & 1 << bit == 0;
        !self.is_protected(address)
            && match gate {
                Gate::Open => true,
                Gate::AlControl => self.al.may_request(),
                Gate::Eeprom => self.eeprom.may_write(Side::Ecat, &self.registers),
                Gate::SyncManager => match address % 8 {
                    6 => true,
                    5 | 7 => false,
                    _ => {
                        let number = usize::from(address - register::SM_0.address) / 8;
                        !self.sync_managers.is_enabled(number)
                    }
                },
                Gate::SyncOwner => owner_is_ecat(0),
                Gate::SyncStart => owner_is_ecat(0) && !self.dc.sync.is_active(),
                Gate::Latch => owner_is_ecat(if address & 1 == 0 { 4 } else { 5 }),
                Gate::Mii => self.mii.may_write(Side::Ecat, &self.registers),
                Gate::MiiTake => true,
                Gate::AlStatus | Gate::EepromTake => false,
            }
    }

    /// The write enables of the last frame end with the arrival of this one.
    pub(crate) fn forget_write_enables(&mut self) {
        for enable in [register::REGISTER_WRITE_ENABLE, register::ESC_WRITE_ENABLE] {
            self.registers.store(enable, 0);
        }
    }

    /// Write protection, registers 0x0020-0x0031.
    pub(crate) fn is_protected(&self, address: u16) -> bool {
        let on = |register: register::Register<u8>| self.registers.load(register) & 1 != 0;
        let [registers, esc] = self.flight.enabled;
        if address == register::ESC_WRITE_ENABLE.address {
            return false;
        }
        on(register::ESC_WRITE_PROTECTION) && !esc
            || on(register::REGISTER_WRITE_PROTECTION)
                && !registers
                && address < SHADOW_END
                && address != register::REGISTER_WRITE_ENABLE.address
    }

    /// Updates the registers that change by themselves before ECAT reads them, and notes which ECAT
    /// events the read acknowledges.
    #[inline]
    fn show_to_ecat(&mut self, range: Range<u16>) {
        if range.start >= LIVE_END {
            return;
        }
        let overlaps = |first: u16, end: u16| range.start < end && range.end > first;
        if overlaps(0x0110, 0x0112) {
            self.flight.acknowledged |= ECAT_DL_STATUS;
        }
        if overlaps(0x0130, 0x0132) {
            self.flight.acknowledged |= ECAT_AL_STATUS;
        }
        let start = self.flight.start;
        if overlaps(0x0210, 0x0224) {
            self.show_events(Side::Ecat, &range, start);
        }
        if overlaps(0x0440, 0x0442) {
            self.show_watchdog();
        }
        if overlaps(SYNC_MANAGERS.start, SYNC_MANAGERS.end) {
            self.sync_managers.show(&range, &mut self.registers);
        }
        if overlaps(0x0910, 0x09D0) && self.units.system_time {
            self.dc.show(Side::Ecat, &range, start, &mut self.registers);
            self.flight.latch_times |= latch::times(&range);
        }
    }

    /// Updates the event request registers. The upper bytes of 0x0220 belong to the moment at which
    /// the same side read its first byte: a read without that byte shows them as they were then.
    pub(crate) fn show_events(&mut self, side: Side, range: &Range<u16>, now: Time<Device>) {
        self.registers.store(register::ECAT_EVENT_REQUEST, self.ecat_events());
        if range.contains(&register::AL_EVENT_REQUEST.address) {
            self.held_al_events[side as usize] = self.al_events(now);
        }
        self.registers.store(register::AL_EVENT_REQUEST, self.held_al_events[side as usize]);
    }
}

/// Splits an access into bytes of registers and bytes of RAM; bytes beyond 64 KiB do not exist.
pub(crate) fn split(address: u16, len: usize) -> (usize, usize) {
    let first = usize::from(address);
    let ram = usize::from(PROCESS_RAM);
    let end = (first + len).min(0x1_0000);
    (end.min(ram).saturating_sub(first), end.saturating_sub(first.max(ram)))
}

/// Handles a frame at an automatically closed port 0. On its first pass the frame is marked; a
/// marked frame is on its second pass.
fn mark_circulating(payload: &mut [u8]) -> bool {
    let mut layouts = Layouts::new();
    let mut second_time = false;
    while let Some(Ok(layout)) = layouts.next(payload) {
        second_time |= layout.header.circulating;
        payload[layout.start + 7] |= 0x40;
    }
    second_time
}

/// Bits of a byte in memory, with the bits of the datagram that they belong to.
fn bits_of(mask: u8, data_bit: i64) -> impl Iterator<Item = (u8, usize)> {
    (0..8)
        .filter(move |bit| mask & 1 << bit != 0)
        .filter_map(move |bit| usize::try_from(data_bit + i64::from(bit)).ok().map(|at| (bit, at)))
}

/// First address behind the write enable registers, which act within the frame.
const WRITE_ENABLES: u16 = 0x0040;
/// First address behind the registers that change by themselves.
const LIVE_END: u16 = 0x09D0;
/// First register that a SyncManager of a device without CPU may guard.
const DIGITAL_OUTPUTS: u16 = 0x0F00;
