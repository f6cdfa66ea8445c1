//! The interface of an ESC to its local CPU.

use core::ops::Range;

use isocat_wire::Time;
use isocat_wire::dl::DlStatus;
use isocat_wire::register;
use isocat_wire::time::Device;

use crate::access::{Gate, PDI_WRITABLE, READABLE};
use crate::chip::ActivationEvent;
use crate::dc::latch;
use crate::dc::sync::{Output, StartWritten};
use crate::dl;
use crate::eeprom::Eeprom;
use crate::esc::{Esc, PDI_DIGITAL_IO, SYNC_MANAGERS};
use crate::led;
use crate::mii::Mii;
use crate::process::split;
use crate::regular::Known;
use crate::sync_manager::{Access, Direction, Side};

/// The ESC as the local CPU sees it: the software ESC, or a driver of a chip.
///
/// An access has the side effects of the chip: reading AL control permits the next request, reading
/// the first byte of a SyncManager's buffer opens it, and reading or writing its last byte closes
/// it. Access whole buffers with one call where possible. A chip that acknowledges by writing
/// (0x014E bit 0) needs a write of any value instead: to the register, or to the last byte of the
/// buffer that was read.
///
/// A driver whose bus can fail keeps the fault and reports it by a method of its own. The stack
/// then sees a failed read as zeros, which is not a valid state of an ESC.
pub trait Pdi {
    /// Reads `data.len()` bytes from `address` on.
    fn read(&mut self, address: u16, data: &mut [u8]);

    /// Writes `data` from `address` on. Bytes that the PDI may not write stay as they are.
    fn write(&mut self, address: u16, data: &[u8]);

    /// The AL event request (0x0220), without any side effect; see
    /// [`isocat_wire::register::al_event`].
    fn events(&mut self) -> u32 {
        let mut bytes = [0; 4];
        self.read(isocat_wire::register::AL_EVENT_REQUEST.address, &mut bytes);
        u32::from_le_bytes(bytes)
    }
}

/// Typed access on top of [`Pdi`].
pub trait PdiExt: Pdi {
    /// Reads a register.
    fn load<T: isocat_wire::register::Value>(&mut self, register: isocat_wire::Register<T>) -> T {
        let mut bytes = T::Bytes::default();
        self.read(register.address, bytes.as_mut());
        T::from_bytes(bytes)
    }

    /// Writes a register.
    fn store<T: isocat_wire::register::Value>(
        &mut self,
        register: isocat_wire::Register<T>,
        value: T,
    ) {
        self.write(register.address, value.to_bytes().as_ref());
    }
}

impl<P: Pdi + ?Sized> PdiExt for P {}

/// The PDI of a software ESC at an instant; see [`Esc::pdi`].
pub struct EscPdi<'a, M> {
    esc: &'a mut Esc<M>,
    now: Time<Device>,
}

impl<'a, M: AsRef<[u8]> + AsMut<[u8]>> EscPdi<'a, M> {
    #[inline]
    pub(crate) fn new(esc: &'a mut Esc<M>, now: Time<Device>) -> Self {
        if esc.registers.load(register::PDI_CONTROL) != PDI_DIGITAL_IO {
            esc.trigger_pdi_watchdog(now);
        }
        if esc.dl_status().0 & DlStatus::PDI_WATCHDOG == 0 {
            dl::set_status(&mut esc.registers, DlStatus::PDI_WATCHDOG, true);
        }
        Self { esc, now }
    }

    /// The same, without a restart of the PDI watchdog.
    #[inline]
    pub(crate) fn without_watchdog(esc: &'a mut Esc<M>, now: Time<Device>) -> Self {
        Self { esc, now }
    }

    fn may_write(&self, gate: Gate, address: u16) -> bool {
        let registers = &self.esc.registers;
        let owner_is_pdi = |bit: u8| registers.load(register::CYCLIC_UNIT_CONTROL) & 1 << bit != 0;
        match gate {
            Gate::Open => true,
            Gate::AlStatus => self.esc.al.may_write_status(),
            Gate::Eeprom => self.esc.eeprom.may_write(Side::Pdi, registers),
            Gate::EepromTake => true,
            Gate::SyncManager => address % 8 == 7,
            Gate::SyncOwner => owner_is_pdi(0),
            Gate::SyncStart => owner_is_pdi(0) && !self.esc.dc.sync.is_active(),
            Gate::Latch => owner_is_pdi(if address & 1 == 0 { 4 } else { 5 }),
            Gate::Mii => self.esc.mii.may_write(Side::Pdi, registers),
            Gate::MiiTake => true,
            Gate::AlControl => false,
        }
    }

    /// Updates the registers that change by themselves.
    fn show(&mut self, range: &Range<u16>) {
        let overlaps = |first: u16, end: u16| range.start < end && range.end > first;
        let (esc, now) = (&mut *self.esc, self.now);
        if overlaps(0x0210, 0x0224) {
            esc.show_events(Side::Pdi, range, now);
        }
        if overlaps(0x0440, 0x0442) {
            esc.show_watchdog();
        }
        if overlaps(SYNC_MANAGERS.start, SYNC_MANAGERS.end) {
            esc.sync_managers.show(range, &mut esc.registers);
        }
        if overlaps(0x0910, 0x09D0) && esc.units.system_time {
            esc.dc.show(Side::Pdi, range, now, &mut esc.registers);
        }
    }

    /// Acknowledges what a read of these registers acknowledges, or a write to them if the chip
    /// works so.
    fn acknowledge(&mut self, range: &Range<u16>) {
        let overlaps = |first: u16, end: u16| range.start < end && range.end > first;
        let esc = &mut *self.esc;
        if overlaps(0x0120, 0x0122) {
            esc.al.acknowledge_request();
        }
        if overlaps(0x0440, 0x0442) {
            esc.al.set_watchdog_event(false);
        }
        if overlaps(0x0800, 0x0880) {
            let is_read = |number: &usize| range.contains(&register::sm_activate(*number).address);
            let any =
                esc.chip.activation_event == ActivationEvent::Any && (0..16).any(|at| is_read(&at));
            for number in (0..16).filter(|number| any || is_read(number)) {
                esc.sync_managers.acknowledge_activation(number);
            }
        }
        esc.dc.latch.acknowledge(Side::Pdi, latch::times(range), &esc.registers);
        if range.contains(&register::SYNC0_STATUS.address) {
            esc.dc.sync.acknowledge(Output::Sync0);
        }
        if range.contains(&register::SYNC1_STATUS.address) {
            esc.dc.sync.acknowledge(Output::Sync1);
        }
    }

    /// Writes one register byte that the PDI may write.
    fn write_byte(&mut self, address: u16, value: u8) {
        let esc = &mut *self.esc;
        match address {
            0x0012 | 0x0013 => {
                // The station alias changes which datagrams are addressed to this ESC.
                esc.registers.set_byte(address, value);
                esc.reach_version = esc.reach_version.wrapping_add(1);
                esc.areas = Known::Nothing;
            }
            0x0041 => {
                esc.advance_reset(1, value, self.now);
            }
            0x0130 | 0x0131 => {
                let before = esc.al_status();
                esc.registers.set_byte(address, value);
                esc.al.change_status(before, &mut esc.registers);
                esc.eeprom.note_state(&mut esc.registers);
            }
            0x0138 | 0x0139 => led::write(address, value, &mut esc.registers),
            0x0501 => {
                let take = value & 1;
                if take == 0 || Eeprom::may_take(&esc.registers) {
                    esc.registers.set_byte(address, take);
                    esc.eeprom.show(&mut esc.registers);
                }
            }
            // These are commands, or the running clock, which keeps its own time.
            0x0502 | 0x0503 | 0x0510 | 0x0511 | 0x0910..0x0918 => {}
            0x0517 => {
                let take = value & 1;
                if take == 0 || Mii::may_take(&esc.registers) {
                    let kept = esc.registers.byte(address) & !1;
                    esc.registers.set_byte(address, kept | take);
                    esc.mii.show(&esc.chip, esc.ports.links(), &mut esc.registers);
                }
            }
            0x0800..0x0880 => {
                let number = usize::from(address - 0x0800) / 8;
                if esc.flight.end == Time::NEVER {
                    esc.sync_managers.write_pdi_control(number, value, &mut esc.registers);
                    esc.areas = Known::Nothing;
                } else {
                    esc.flight.pdi_control[number] = value;
                    esc.flight.pdi_control_written |= 1 << number;
                    esc.flight.is_cyclic = false;
                }
            }
            _ => esc.registers.set_byte(address, value),
        }
    }

    /// Updates registers 0x09F8 and 0x09FC.
    fn latch_buffer_times(&mut self, outcome: Access) {
        if outcome.started {
            self.esc.latch_buffer_time(register::PDI_BUFFER_START_TIME, self.now);
        }
        if outcome.changed {
            self.esc.latch_buffer_time(register::PDI_BUFFER_CHANGE_TIME, self.now);
        }
    }

    fn write_registers(&mut self, address: u16, data: &[u8]) {
        let end = address + data.len() as u16;
        let mut at = address;
        let (mut control, mut mii) = (None, None);
        let (mut activated, mut started, mut latches) = (false, None, false);
        let (mut time, mut clock) = ([None; 4], 0x0920..0x0920);
        if self.esc.chip.acknowledge_by_write {
            self.acknowledge(&(address..end));
        }
        while at < end {
            let (stop, gate) = self.esc.units.run(&PDI_WRITABLE, at);
            let stop = stop.min(end);
            for byte in at..stop {
                let value = data[usize::from(byte - address)];
                if gate.is_none_or(|gate| !self.may_write(gate, byte)) {
                    continue;
                }
                match byte {
                    0x0502 => control = Some(u16::from(value)),
                    0x0503 => control = Some(control.unwrap_or(0) | u16::from(value) << 8),
                    0x0510 => mii = Some(u16::from(value)),
                    0x0511 => mii = Some(mii.unwrap_or(0) | u16::from(value) << 8),
                    0x0981 => activated = true,
                    0x0910..0x0914 => time[usize::from(byte - 0x0910)] = Some(value),
                    0x0920..0x0936 => {
                        let from = if clock.is_empty() { byte } else { clock.start };
                        clock = from..byte + 1;
                    }
                    0x0990..0x0998 => {
                        let started = started.get_or_insert(StartWritten::default());
                        started.lower |= byte == 0x0993;
                        started.upper |= byte == 0x0997;
                    }
                    0x09A8 | 0x09A9 => latches = true,
                    _ => {}
                }
                self.write_byte(byte, value);
            }
            at = stop;
        }
        let esc = &mut *self.esc;
        if let Some(control) = control {
            if esc.eeprom.is_waiting() {
                esc.eeprom.answer(control);
            } else {
                esc.eeprom.command(Side::Pdi, control, self.now, &esc.chip);
            }
            esc.eeprom.show(&mut esc.registers);
        }
        if latches {
            esc.dc.latch.configure(&esc.registers);
        }
        if let Some(control) = mii {
            esc.mii.command(Side::Pdi, control, self.now);
            esc.mii.show(&esc.chip, esc.ports.links(), &mut esc.registers);
        }
        if time[3].is_some() {
            esc.dc.follow_latch(self.now, time, &mut esc.registers);
        }
        if !clock.is_empty() {
            let touched = |range: Range<u16>| range.start < clock.end && range.end > clock.start;
            esc.dc.set_time_unit(self.now, touched, &mut esc.registers);
        }
        if activated || started.is_some() {
            let started = started.unwrap_or_default();
            esc.dc.activate(self.now, started, &mut esc.registers);
        }
    }
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Pdi for EscPdi<'_, M> {
    /// Bytes that do not exist or may not be read read 0.
    #[inline]
    fn read(&mut self, address: u16, data: &mut [u8]) {
        if self.esc.read_regular_outputs(address, data) {
            return;
        }
        self.read_any(address, data);
    }

    #[inline]
    fn write(&mut self, address: u16, data: &[u8]) {
        match self.esc.write_regular_inputs(address, data) {
            Some(false) => {}
            Some(true) => self.esc.trigger_watchdog(self.now),
            None => self.write_any(address, data),
        }
    }

    fn events(&mut self) -> u32 {
        self.esc.al_events(self.now)
    }
}

/// The PDI for whole buffers of process data in regular operation; see [`Esc::buffers`]. It has the
/// effects of [`EscPdi`], and the access to a buffer is part of the caller.
pub struct Buffers<'a, M> {
    pub(crate) esc: &'a mut Esc<M>,
    pub(crate) now: Time<Device>,
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Pdi for Buffers<'_, M> {
    #[inline(always)]
    fn read(&mut self, address: u16, data: &mut [u8]) {
        if !self.esc.read_regular_outputs(address, data) {
            EscPdi::without_watchdog(self.esc, self.now).read_any(address, data);
        }
    }

    #[inline(always)]
    fn write(&mut self, address: u16, data: &[u8]) {
        match self.esc.write_regular_inputs(address, data) {
            Some(false) => {}
            Some(true) => self.esc.trigger_watchdog(self.now),
            None => EscPdi::without_watchdog(self.esc, self.now).write_any(address, data),
        }
    }
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> EscPdi<'_, M> {
    #[inline(never)]
    fn read_any(&mut self, address: u16, data: &mut [u8]) {
        data.fill(0);
        let (registers, ram) = split(address, data.len());
        if registers > 0 {
            let range = address..address + registers as u16;
            self.show(&range);
            let mut at = range.start;
            while at < range.end {
                let (stop, gate) = self.esc.units.run(&READABLE, at);
                let stop = stop.min(range.end);
                if gate.is_some() {
                    let place = usize::from(at - address)..usize::from(stop - address);
                    data[place].copy_from_slice(self.esc.registers.bytes(at..stop));
                }
                at = stop;
            }
            if !self.esc.chip.acknowledge_by_write {
                self.acknowledge(&range);
            }
        }
        if ram > 0 && self.esc.is_operational() {
            let data = &mut data[registers..registers + ram];
            let first = address.max(register::PROCESS_RAM);
            let way = (Side::Pdi, Direction::Read);
            self.esc.reach_ram(first, ram);
            let end = self.esc.ram_len.min(self.esc.ram.as_ref().len());
            let memory = &mut self.esc.ram.as_mut()[..end];
            let outcome = self.esc.sync_managers.access(way, memory, first, ram, |memory, at| {
                data[at].copy_from_slice(memory);
            });
            self.latch_buffer_times(outcome);
        }
        self.esc.note_rest();
    }

    #[inline(never)]
    fn write_any(&mut self, address: u16, data: &[u8]) {
        let (registers, ram) = split(address, data.len());
        if registers > 0 {
            self.write_registers(address, &data[..registers]);
        }
        if ram > 0 && self.esc.is_operational() {
            let data = &data[registers..registers + ram];
            let first = address.max(register::PROCESS_RAM);
            let way = (Side::Pdi, Direction::Write);
            self.esc.reach_ram(first, ram);
            let end = self.esc.ram_len.min(self.esc.ram.as_ref().len());
            let memory = &mut self.esc.ram.as_mut()[..end];
            let outcome = self.esc.sync_managers.access(way, memory, first, ram, |memory, at| {
                memory.copy_from_slice(&data[at]);
            });
            if outcome.watchdog {
                self.esc.trigger_watchdog(self.now);
            }
            self.latch_buffer_times(outcome);
            if self.esc.chip.acknowledge_by_write {
                let outcome = self.esc.sync_managers.release_by_write(first, ram);
                self.latch_buffer_times(outcome);
            }
        }
        self.esc.note_rest();
    }
}
