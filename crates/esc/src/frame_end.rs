//! The end of a good frame: SyncManager buffers change hands, registers come into force.

use core::ops::Range;

use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, al_event};
use isocat_wire::time::Device;
use isocat_wire::{AlStatus, Time};

use crate::dl::{self, ALL_PORTS};
use crate::esc::{ECAT_AL_STATUS, ECAT_DL_STATUS, Esc, EscEvent, Flight};
use crate::led;
use crate::mii::Mii;
use crate::reach::PAGES;
use crate::regular::Known;
use crate::sync_manager::{SM_LEN, Side};

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// Ends the frame in flight, which was good: buffers change hands, registers come into force.
    pub(crate) fn end_frame(&mut self) -> EscEvent {
        if let Some(al_events) = self.end_regular_frame() {
            return EscEvent::FrameEnd { al_events };
        }
        self.put_brought_aside();
        let flight = core::mem::replace(&mut self.flight, Flight::NONE);
        let now = flight.end;
        let before = self.lasting_al_events();
        let state = self.al.is_emulated().then(|| self.al_status());
        let exchanged = self.sync_managers.end_good_frame(flight.label);
        if exchanged.watchdog {
            self.trigger_watchdog(now);
        }
        if exchanged.latch {
            self.latch_buffer_time(register::ECAT_BUFFER_CHANGE_TIME, flight.start);
        }
        self.acknowledge_ecat(flight.acknowledged);
        self.dc.latch.acknowledge(Side::Ecat, flight.latch_times, &self.registers);
        let mut written = flight.pdi_control_written;
        while written != 0 {
            let number = written.trailing_zeros() as usize;
            written &= written - 1;
            let value = flight.pdi_control[number];
            self.sync_managers.write_pdi_control(number, value, &mut self.registers);
            self.areas = Known::Nothing;
        }
        if !self.shadow.is_empty() {
            self.commit(flight.start, now);
        }
        let mut al_events = self.lasting_al_events() & !before;
        if let Some(state) = state {
            al_events |= self.seen_without_cpu(exchanged.units, state);
        }
        self.note_rest();
        EscEvent::FrameEnd { al_events }
    }

    /// The AL events that the circuit of a device without CPU sees after a frame. Digital I/O
    /// follows AL status and takes each exchange directly from the SyncManagers, even where their
    /// interrupt is off.
    fn seen_without_cpu(&self, exchanged: u16, before: AlStatus) -> u32 {
        let exchanged = u32::from(exchanged) * al_event::sync_manager(0);
        let state = if self.al_status() == before { 0 } else { al_event::AL_CONTROL };
        exchanged | state
    }

    /// The AL events that stay set until they are acknowledged.
    fn lasting_al_events(&self) -> u32 {
        self.own_al_events() | self.dc.latch.al_events(&self.registers)
    }

    /// Puts into force what the frame wrote to registers.
    fn commit(&mut self, start: Time<Device>, now: Time<Device>) {
        if let Some(value) = self.shadow.byte(register::ESC_RESET_ECAT.address)
            && self.advance_reset(0, value, now)
        {
            return;
        }
        self.areas = Known::Nothing;
        let Self { shadow, registers, .. } = self;
        let loops_before = registers.byte(register::DL_CONTROL.address + 1);
        for (address, value) in shadow.written() {
            if !has_own_effect(address) {
                registers.set_byte(address, value);
            }
        }
        if shadow.touches_page(0x0100) {
            if shadow.touches(AL_CONTROL) {
                self.al.request(registers);
                self.eeprom.note_state(registers);
            }
            if shadow.touches(DL_CONTROL) {
                let loops = shadow.byte(DL_CONTROL.start + 1).is_some();
                if loops || shadow.byte(DL_CONTROL.start).is_some() {
                    self.ports.control(loops_before, now, registers);
                }
                let reopen = if loops { ALL_PORTS } else { 0 };
                if self.ports.update(&self.chip, registers, reopen) {
                    self.dl_changed = true;
                    self.overdue = Some((now, EscEvent::Ports));
                }
            }
            for led in [register::RUN_LED.address, register::ERR_LED.address] {
                if let Some(value) = shadow.byte(led) {
                    led::write(led, value, registers);
                }
            }
        }
        if shadow.touches_page(0x0300) {
            for (range, group) in ERROR_COUNTERS {
                if shadow.touches(range) {
                    registers.clear(group);
                }
            }
        }
        if shadow.touches_page(0x0400) {
            if shadow.touches(WATCHDOG_COUNTERS) {
                registers.clear(WATCHDOG_COUNTERS);
            }
            self.watchdog.configure(now, registers);
            self.pdi_watchdog.configure(now, registers);
            if self.pdi_watchdog.is_off() {
                dl::set_status(registers, DlStatus::PDI_WATCHDOG, true);
            }
        }
        if shadow.touches_page(0x0500) {
            let configuration = registers.load(register::EEPROM_CONFIGURATION);
            if shadow.byte(register::EEPROM_CONFIGURATION.address).is_some()
                && configuration & EEPROM_FORCED != 0
            {
                registers.store(register::EEPROM_PDI_ACCESS, 0);
            }
            let control = [EEPROM_CONTROL.start, EEPROM_CONTROL.start + 1]
                .map(|address| shadow.byte(address));
            if control != [None; 2] {
                let control = u16::from_le_bytes(control.map(|byte| byte.unwrap_or(0)));
                self.eeprom.command(Side::Ecat, control, now, &self.chip);
            }
            self.eeprom.show(registers);
            if shadow.touches(MII) {
                if let Some(value) = shadow.byte(register::MII_PDI_ACCESS.address) {
                    Mii::force(value, registers);
                }
                let control = [MII.start, MII.start + 1].map(|address| shadow.byte(address));
                if control != [None; 2] {
                    let control = u16::from_le_bytes(control.map(|byte| byte.unwrap_or(0)));
                    self.mii.command(Side::Ecat, control, now);
                }
                self.mii.show(&self.chip, self.ports.links(), registers);
            }
        }
        if shadow.touches_page(0x0600) {
            self.fmmus.configure(registers);
        }
        if shadow.touches_page(0x0800) {
            for number in 0..16 {
                let first = register::sync_manager(number).address;
                if shadow.touches(first..first + SM_LEN) {
                    let activation = shadow.byte(register::sm_activate(number).address).is_some();
                    self.sync_managers.configure(number, registers, activation);
                }
            }
        }
        if shadow.touches_page(0x0900) {
            self.dc.end_frame((start, now), shadow, registers);
        }
        if PAGES.iter().any(|page| shadow.touches_page(*page)) {
            self.reach_version = self.reach_version.wrapping_add(1);
        }
        shadow.clear();
    }

    /// Clears the ECAT events that ECAT has acknowledged by reading.
    fn acknowledge_ecat(&mut self, events: u16) {
        self.dl_changed &= events & ECAT_DL_STATUS == 0;
        if events & ECAT_AL_STATUS != 0 {
            self.al.acknowledge_status();
        }
    }
}

/// Registers for which a write has another effect than to store the value.
fn has_own_effect(address: u16) -> bool {
    matches!(
        address,
        0x0040 // the sequence it belongs to
            | 0x0138 | 0x0139
            | 0x0300..0x0314
            | 0x0442..0x0444 // clear
            | 0x0502..0x0504 | 0x0510..0x0512 // a command
            | 0x0517..0x051C // taken by force; set by the links
            | 0x0900..0x0904
            | 0x0910..0x0918 // the clock keeps its own time
    )
}

const AL_CONTROL: Range<u16> = 0x0120..0x0122;
const DL_CONTROL: Range<u16> = 0x0100..0x0104;
const WATCHDOG_COUNTERS: Range<u16> = 0x0442..0x0444;
const MII: Range<u16> = 0x0510..0x0518;
const EEPROM_CONTROL: Range<u16> = 0x0502..0x0504;
/// Register 0x0500 bit 1: ECAT takes the EEPROM from the PDI by force.
const EEPROM_FORCED: u8 = 1 << 1;
/// A write to the first range clears the second.
const ERROR_COUNTERS: [(Range<u16>, Range<u16>); 4] = [
    (0x0300..0x030C, 0x0300..0x030C),
    (0x030C..0x030D, 0x030C..0x030D),
    (0x030D..0x030E, 0x030D..0x030F),
    (0x0310..0x0314, 0x0310..0x0314),
];
