//! A fast path for the datagrams of every cycle in regular operation.
//!
//! A cyclic frame has three uses for an ESC: it brings the system time (FRMW or ARMW of 0x0910), it
//! exchanges process data (LRW, LRD, LWR), and it collects AL status (BRD of 0x0130). This file
//! recognizes each of them and answers at once; anything unusual takes the slow path through
//! `process`. Both paths have the same effects to the last register. A caller may switch the fast
//! path off at any time ([`Esc::set_lane`]) and sees no difference except in speed.

use core::ops::Range;

use isocat_wire::fmmu::Fmmu;
use isocat_wire::register::{self, PROCESS_RAM, features};
use isocat_wire::time::Device;
use isocat_wire::{Command, Time};

use crate::cyclic::Lane;
use crate::esc::{ECAT_AL_STATUS, Esc, EscEvent, Flight};
use crate::fmmu::Single;
use crate::pdi::{Buffers, EscPdi};
use crate::sync_manager::{Direction, Simple};

/// Process data with a usual setup: one FMMU and one SyncManager for each direction, of equal
/// length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Areas {
    pub outputs: Option<Area>,
    pub inputs: Option<Area>,
    /// Its station address and its alias; the same twice if it answers to no alias.
    pub stations: [u16; 2],
    /// Most bytes of the system time that it takes: 8, 4, or none.
    pub time_len: u8,
}

/// One direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Area {
    pub logical: u32,
    physical: u16,
    pub length: u16,
    sync_manager: u8,
}

impl Area {
    /// Whether an access of the PDI covers all of it.
    fn is(&self, address: u16, len: usize) -> bool {
        address == self.physical && len == usize::from(self.length)
    }

    /// Its place in a datagram, if the datagram contains all of it.
    fn place(&self, address: u32, len: usize) -> Option<Range<usize>> {
        let from = self.logical.checked_sub(address)? as usize;
        let end = from + usize::from(self.length);
        (end <= len).then_some(from..end)
    }
}

/// A kind of datagrams that most cyclic frames consist of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Usual {
    /// The system time of a station, for all behind it: FRMW of 0x0910.
    TimeOf,
    /// The same by position: ARMW.
    TimeAt,
    /// Process data: LRW, LRD or LWR.
    Exchange {
        /// Outputs are written.
        writes: bool,
        /// Inputs are read.
        reads: bool,
    },
    /// AL status of all: BRD of 0x0130, two bytes.
    Status,
}

impl Usual {
    /// The kind of a datagram with `len` data bytes; `None` for all others.
    pub fn of(command: Command, address: u32, len: usize) -> Option<Self> {
        let ado = (address >> 16) as u16;
        match command {
            Command::Lrw => Some(Self::Exchange { writes: true, reads: true }),
            Command::Lrd => Some(Self::Exchange { writes: false, reads: true }),
            Command::Lwr => Some(Self::Exchange { writes: true, reads: false }),
            Command::Frmw if ado == TIME => Some(Self::TimeOf),
            Command::Armw if ado == TIME => Some(Self::TimeAt),
            Command::Brd if ado == register::AL_STATUS.address && len == 2 => Some(Self::Status),
            _ => None,
        }
    }
}

/// What is known about the [`Areas`].
#[derive(Clone, Copy, Debug)]
pub(crate) enum Known {
    /// Registers have changed since the last search.
    Nothing,
    /// The setup is not usual.
    Unusual,
    /// The setup is usual: all of the process RAM that SyncManagers use is there, and may be
    /// accessed and written.
    Usual(Areas),
}

/// The system time that the frame in flight brought, if the frame wrote no other registers.
#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct Brought {
    pub bytes: [u8; 8],
    /// 4 or 8 bytes; 0 if the frame brought no time.
    pub len: u8,
}

impl Brought {
    /// No time.
    pub const NONE: Self = Self { bytes: [0; 8], len: 0 };

    /// Whether the frame brought no time.
    pub const fn is_none(&self) -> bool {
        self.len == 0
    }
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// Sets whether cyclic datagrams may take the fast path; the default is yes. Only the computing
    /// time of the simulation depends on it.
    pub fn set_lane(&mut self, on: bool) {
        self.lane = on;
        self.areas = Known::Nothing;
    }

    /// Answers a datagram of regular operation and returns its working counter increment. `None`:
    /// the datagram needs the slow path, nothing was done.
    #[inline]
    pub(crate) fn regular(
        &mut self,
        command: Command,
        address: u32,
        data: &mut [u8],
    ) -> Option<u16> {
        self.answer(Usual::of(command, address, data.len())?, address, data)
    }

    /// Answers a datagram of one of the usual kinds, as far as it is regular; returns its working
    /// counter increment. `None`: nothing was done, and [`datagram`](Self::datagram) must answer.
    #[inline]
    pub fn answer(&mut self, usual: Usual, address: u32, data: &mut [u8]) -> Option<u16> {
        if !self.lane {
            return None;
        }
        let adp = address as u16;
        match usual {
            Usual::Exchange { writes, reads } => self.exchange_areas(writes, reads, address, data),
            Usual::TimeOf if !self.is_addressed(adp) => self.bring_time(data),
            Usual::TimeAt if adp != 0 => self.bring_time(data),
            Usual::TimeOf | Usual::TimeAt => None,
            Usual::Status => {
                let data: &mut [u8; 2] = data.try_into().ok()?;
                // Without an event there is nothing to acknowledge.
                self.flight.acknowledged |= self.al.ecat_events() & ECAT_AL_STATUS;
                let status = self.registers.load(register::AL_STATUS).0.to_le_bytes();
                (data[0], data[1]) = (data[0] | status[0], data[1] | status[1]);
                Some(1)
            }
        }
    }

    /// The events that every datagram of the frame in flight shows in its IRQ field.
    #[inline]
    pub const fn irq(&self) -> u16 {
        self.flight.irq
    }

    /// Stores the system time of the reference clock, which every ESC behind it receives in
    /// passing.
    fn bring_time(&mut self, data: &[u8]) -> Option<u16> {
        let bytes = match *data {
            [a, b, c, d] => [a, b, c, d, 0, 0, 0, 0],
            [a, b, c, d, e, f, g, h] if self.units.takes_wide_time() => [a, b, c, d, e, f, g, h],
            _ => return None,
        };
        if !self.units.takes_time() || !self.shadow.is_empty() || self.is_protected(TIME) {
            return None;
        }
        self.flight.brought = Brought { bytes, len: data.len() as u8 };
        Some(1)
    }

    /// The same frame writes other registers: moves the time that it brought into the shadow.
    pub(crate) fn put_brought_aside(&mut self) {
        let Brought { bytes, len } = core::mem::replace(&mut self.flight.brought, Brought::NONE);
        if len > 0 {
            let put = self.shadow.put_in_line(TIME, &bytes[..usize::from(len)]);
            debug_assert!(put, "the system time is one line, and open");
        }
    }

    /// Exchanges process data of both directions, or of one.
    #[inline]
    fn exchange_areas(
        &mut self,
        writes: bool,
        reads: bool,
        address: u32,
        data: &mut [u8],
    ) -> Option<u16> {
        if matches!(self.areas, Known::Nothing) {
            self.look_for_areas();
        }
        let Known::Usual(areas) = &self.areas else { return None };
        let place = |area: Option<Area>, wanted: bool| match area.filter(|_| wanted) {
            None => Some(None),
            Some(area) => Some(Some((area.place(address, data.len())?, area.sync_manager))),
        };
        let outputs = place(areas.outputs, writes)?;
        let inputs = place(areas.inputs, reads)?;
        let mut count = 0;
        let Self { sync_managers, ram, .. } = self;
        let ram = ram.as_mut();
        let base = usize::from(PROCESS_RAM);
        // Outputs go first: they are taken as received, before inputs replace them.
        if let Some((at, number)) = outputs
            && let Some(place) = sync_managers.ecat_whole(Direction::Write, number.into())
        {
            ram[place - base..][..at.len()].copy_from_slice(&data[at]);
            count += if reads { 2 } else { 1 };
        }
        if let Some((at, number)) = inputs
            && let Some(place) = sync_managers.ecat_whole(Direction::Read, number.into())
        {
            let len = at.len();
            data[at].copy_from_slice(&ram[place - base..][..len]);
            count += 1;
        }
        Some(count)
    }

    /// Finds the areas after a change of registers, as far as they can be known.
    #[inline(never)]
    pub(crate) fn look_for_areas(&mut self) {
        if !self.is_regular_ram() {
            return;
        }
        self.areas = self.find_areas().map_or(Known::Unusual, Known::Usual);
        self.cyclic.close();
        let Known::Usual(areas) = &self.areas else { return };
        let simple = |area: Option<Area>, written: bool| match area {
            None => Some(Simple::NONE),
            Some(area) => self.sync_managers.simple(area.sync_manager.into(), written),
        };
        let shows_events = self.registers.load(register::ECAT_EVENT_MASK) != 0;
        if let (Some(outputs), Some(inputs)) =
            (simple(areas.outputs, true), simple(areas.inputs, false))
            && !self.al.is_emulated()
            && !shows_events
        {
            self.cyclic.open(outputs, inputs);
        }
    }

    /// Returns the areas if FMMUs and SyncManagers of process data have the usual setup.
    fn find_areas(&self) -> Option<Areas> {
        if self.chip.has(features::NO_LRW) {
            return None;
        }
        let area = |kind| -> Option<Option<Area>> {
            let Some(Single { logical, length, physical }) = self.fmmus.single(kind).ok()? else {
                return Some(None);
            };
            let number = self.sync_managers.three_buffers(physical, length)?;
            Some(Some(Area { logical, physical, length, sync_manager: number as u8 }))
        };
        let (outputs, inputs) = (area(Fmmu::WRITE)?, area(Fmmu::READ)?);
        let (station, control) = (register::STATION_ADDRESS, register::DL_CONTROL);
        let has_alias = self.registers.byte(control.address + 3) & 1 != 0;
        let station = self.registers.load(station);
        let alias = if has_alias { self.registers.load(register::STATION_ALIAS) } else { station };
        let is_protected = self.registers.load(register::REGISTER_WRITE_PROTECTION) & 1 != 0;
        let time_len = match () {
            () if is_protected || !self.units.takes_time() => 0,
            () if self.units.takes_wide_time() => 8,
            () => 4,
        };
        let areas = Areas { outputs, inputs, stations: [station, alias], time_len };
        // A SyncManager serves one direction: if both FMMUs lead to the same one, the slow path
        // decides.
        let number = |area: Option<Area>| area.map(|area| area.sync_manager);
        let apart = areas.outputs.is_none() || number(areas.outputs) != number(areas.inputs);
        apart.then_some(areas)
    }

    /// Handles a PDI read of all outputs. `false`: nothing was done.
    #[inline(always)]
    pub(crate) fn read_regular_outputs(&mut self, address: u16, data: &mut [u8]) -> bool {
        let Known::Usual(Areas { outputs: Some(area), .. }) = self.areas else { return false };
        if !area.is(address, data.len()) {
            return false;
        }
        let Self { sync_managers, ram, .. } = self;
        let number = usize::from(area.sync_manager);
        let way = Direction::Read;
        let Some((place, _)) = sync_managers.pdi_whole(way, number) else {
            return false;
        };
        let from = place - usize::from(PROCESS_RAM);
        data.copy_from_slice(&ram.as_ref()[from..from + data.len()]);
        true
    }

    /// Handles a PDI write of all inputs. Returns whether that triggers the watchdog; `None`:
    /// nothing was done.
    #[inline(always)]
    pub(crate) fn write_regular_inputs(&mut self, address: u16, data: &[u8]) -> Option<bool> {
        let Known::Usual(Areas { inputs: Some(area), .. }) = self.areas else { return None };
        if !area.is(address, data.len()) {
            return None;
        }
        let Self { sync_managers, ram, .. } = self;
        let number = usize::from(area.sync_manager);
        let way = Direction::Write;
        let (place, watchdog) = sync_managers.pdi_whole(way, number)?;
        let from = place - usize::from(PROCESS_RAM);
        ram.as_mut()[from..from + data.len()].copy_from_slice(data);
        Some(watchdog)
    }

    /// Whether process RAM can be accessed and written, and contains every buffer that SyncManagers
    /// use.
    fn is_regular_ram(&self) -> bool {
        let reserved = self.sync_managers.reserved_end().wrapping_sub(PROCESS_RAM.into());
        let end = self.ram_len.min(self.ram.as_ref().len());
        let protected = self.registers.load(register::ESC_WRITE_PROTECTION) & 1 != 0;
        self.lane && reserved <= end && self.is_operational() && !protected
    }

    /// The end of the frame in flight, and when the SYNC unit is due; `None` if another event has
    /// already happened. For a caller that handles both by itself.
    #[inline]
    pub fn cyclic_dues(&self) -> Option<(Time<Device>, Time<Device>)> {
        self.overdue.is_none().then_some((self.flight.end, self.dc.sync.due()))
    }

    /// Handles the SYNC unit's due time, which must have come. Returns the edge, if there is one.
    #[inline]
    pub fn step_sync(&mut self) -> Option<EscEvent> {
        self.fire()
    }

    /// The PDI for a caller that does not look at the PDI watchdog, and calls
    /// [`Esc::note_pdi`] after its last access.
    #[inline]
    pub fn pdi_in_lane(&mut self, now: Time<Device>) -> EscPdi<'_, M> {
        EscPdi::without_watchdog(self, now)
    }

    /// The same for a caller that reads and writes only whole buffers of process data.
    #[inline]
    pub fn buffers(&mut self, now: Time<Device>) -> Buffers<'_, M> {
        Buffers { esc: self, now }
    }

    /// Ends a frame that brought only process data and the system time; returns the bits of the AL
    /// event request that it newly set. `None`: the frame brought more, and nothing was done.
    #[inline]
    pub fn end_regular_frame(&mut self) -> Option<u32> {
        if !self.flight.is_cyclic {
            return self.end_answered_frame();
        }
        if !matches!(self.areas, Known::Usual(_)) {
            return None;
        }
        let Flight { start, end: now, label, brought, .. } = self.flight;
        let Lane { outputs, inputs, .. } = &self.cyclic;
        let managers = &mut self.sync_managers;
        let closed = managers.take_closed();
        let (mut al_events, mut watchdog) = (0, false);
        if outputs.is_in(closed) {
            al_events |= managers.end_write(outputs, label);
            watchdog = outputs.watchdog;
        }
        if inputs.is_in(closed) {
            al_events |= managers.end_read(inputs);
        }
        // The rest of the flight is as without a frame.
        (self.flight.start, self.flight.end) = (Time::ZERO, Time::NEVER);
        self.flight.brought.len = 0;
        if watchdog {
            self.trigger_watchdog(now);
        }
        if !brought.is_none() {
            let [a, b, c, d, ..] = brought.bytes;
            self.dc.follow_whole((start, now), [a, b, c, d], &mut self.registers);
        }
        Some(al_events)
    }

    /// The same for a frame that was answered datagram by datagram.
    #[inline(never)]
    fn end_answered_frame(&mut self) -> Option<u32> {
        let Flight { start, end: now, label, brought, acknowledged, .. } = self.flight;
        let more = acknowledged != 0
            || self.flight.latch_times != 0
            || self.flight.pdi_control_written != 0
            || !self.shadow.is_empty();
        if more || !self.lane || self.al.is_emulated() {
            return None;
        }
        self.flight = Flight::NONE;
        let exchanged = self.sync_managers.end_good_frame(label);
        if exchanged.watchdog {
            self.trigger_watchdog(now);
        }
        if exchanged.latch {
            self.latch_buffer_time(register::ECAT_BUFFER_CHANGE_TIME, start);
        }
        if !brought.is_none() {
            let [a, b, c, d, ..] = brought.bytes;
            self.dc.follow_whole((start, now), [a, b, c, d], &mut self.registers);
        }
        Some(exchanged.al_events)
    }
}

pub(crate) const TIME: u16 = register::SYSTEM_TIME.address;
