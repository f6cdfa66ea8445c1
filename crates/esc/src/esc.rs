//! One ESC: its parts, its events in the order of time, and the end of a frame.

use core::ops::Range;

use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, CHIP_SPECIFIC, Register, Value, al_event};
use isocat_wire::time::{Dc, Device, Local};
use isocat_wire::{AlStatus, Nanos, PortNumber, Time};

use crate::access::Units;
use crate::al::Al;
use crate::chip::Chip;
use crate::cyclic::Lane;
use crate::dc::DcUnit;
use crate::dc::drift_law::DriftLaw;
use crate::dc::latch::LatchInput;
use crate::dc::sync::Output;
use crate::dl::{self, ALL_PORTS, Ports};
use crate::eeprom::{self, Eeprom};
use crate::fmmu::Fmmus;
use crate::led;
use crate::memory::{Registers, Shadow};
use crate::mii::Mii;
use crate::pdi::EscPdi;
use crate::regular::{Brought, Known};
use crate::sync_manager::{SM_LEN, SyncManagers};
use crate::watchdog::Watchdog;

/// An EtherCAT SubDevice Controller.
///
/// `M` holds the EEPROM image and the process RAM: a `Vec<u8>`, a boxed slice, a `&mut [u8]`.
///
/// - ECAT side: [`process`](Self::process), [`receive_at_port`](Self::receive_at_port),
///   [`hear_frame`](Self::hear_frame), [`set_port`](Self::set_port),
///   [`count_error`](Self::count_error);
/// - pins: [`set_latch_input`](Self::set_latch_input), [`sync_signals`](Self::sync_signals);
/// - power: [`power_on`](Self::power_on);
/// - own events: [`next_event`](Self::next_event), [`step`](Self::step);
/// - PDI side: [`pdi`](Self::pdi);
/// - labels of the bytes, for an observer: [`label_frame`](Self::label_frame),
///   [`label_pdi`](Self::label_pdi), [`label`](Self::label);
/// - inspection from outside, without any side effect: [`register`](Self::register),
///   [`dl_status`](Self::dl_status), [`local_time`](Self::local_time),
///   [`system_time`](Self::system_time), [`first_reaching`](Self::first_reaching),
///   [`registers`](Self::registers), [`ram`](Self::ram), [`interrupt`](Self::interrupt).
///
/// **Time** is an argument of each call and must not go back. Before any other call at an instant,
/// call `step` with that instant until it returns `None`, so that all events due before it have
/// been handled.
pub struct Esc<M> {
    pub(crate) chip: Chip,
    pub(crate) registers: Registers,
    pub(crate) shadow: Shadow,
    pub(crate) ram: M,
    /// Bytes of process RAM that both sides can access.
    pub(crate) ram_len: usize,
    /// Makes `ram` longer, if it grows with its use.
    grow: Option<fn(&mut M, usize)>,
    pub(crate) image: M,
    pub(crate) units: Units,
    pub(crate) sync_managers: SyncManagers,
    pub(crate) fmmus: Fmmus,
    pub(crate) al: Al,
    pub(crate) eeprom: Eeprom,
    pub(crate) mii: Mii,
    pub(crate) dc: DcUnit,
    pub(crate) flight: Flight,
    /// Progress of the reset sequence from ECAT and from the PDI.
    pub(crate) reset_progress: [u8; 2],
    pub(crate) pdi_watchdog: Watchdog,
    pub(crate) ports: Ports,
    pub(crate) watchdog: Watchdog,
    /// The AL event request when each side last read its first byte.
    pub(crate) held_al_events: [u32; 2],
    /// DL status changed, and ECAT has not read it since.
    pub(crate) dl_changed: bool,
    /// An event that has happened and is still to be reported.
    pub(crate) overdue: Option<(Time<Device>, EscEvent)>,
    /// No unit but the frame in flight and the SYNC unit is due before this. Kept since it is asked
    /// for several times a cycle.
    rest: Time<Device>,
    /// Counts changes that may affect [`Esc::reach`].
    pub(crate) reach_version: u32,
    /// The EEPROM acknowledges nothing.
    eeprom_is_dead: bool,
    /// See [`Esc::set_lane`].
    pub(crate) lane: bool,
    /// Where process data lies, if that is known.
    pub(crate) areas: Known,
    /// How it takes cyclic frames as a whole, if its areas are known.
    pub(crate) cyclic: Lane,
}

/// The frame in flight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flight {
    pub start: Time<Device>,
    /// The instant at which its effects come into force; never if it has none.
    pub end: Time<Device>,
    /// ECAT events that the frame acknowledged by reading.
    pub acknowledged: u16,
    /// Latch times that the frame read, see `dc::latch::times`.
    pub latch_times: u8,
    /// The frame wrote a write enable register: 0x0020, 0x0030.
    pub enabled: [bool; 2],
    /// The value that every datagram shows in its IRQ field.
    pub irq: u16,
    /// The frame latches receive times.
    pub latches: bool,
    /// The system time that the frame brought, as long as it wrote no other registers.
    pub brought: Brought,
    /// The sender's label for the frame.
    pub label: u64,
    /// It was passed as a whole, and everything that it does at its end is known.
    pub is_cyclic: bool,
    /// PDI control bytes that the PDI wrote during the frame, and their SyncManagers.
    pub pdi_control: [u8; 16],
    pub pdi_control_written: u16,
}

impl Flight {
    /// The value for no frame in flight.
    pub const NONE: Self = Self {
        start: Time::ZERO,
        end: Time::NEVER,
        acknowledged: 0,
        latch_times: 0,
        enabled: [false; 2],
        irq: 0,
        latches: false,
        brought: Brought::NONE,
        label: 0,
        is_cyclic: false,
        pdi_control: [0; 16],
        pdi_control_written: 0,
    };
}

/// An event that an ESC causes by itself at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EscEvent {
    /// A good frame has ended and its effects came into force.
    FrameEnd {
        /// Bits of the AL event request (0x0220) that the frame newly set, before the mask.
        al_events: u32,
    },
    /// A loop opened or closed; see [`Esc::dl_status`].
    Ports,
    /// SYNC0 became active.
    Sync0,
    /// SYNC1 became active.
    Sync1,
    /// The latch unit stored the time of an edge.
    Latched {
        /// The edge newly set bit 1 of the AL event request (0x0220), before the mask.
        al_event: bool,
    },
    /// The process data watchdog expired.
    WatchdogExpired,
    /// The PDI watchdog expired.
    PdiWatchdogExpired,
    /// An EEPROM command is done.
    EepromDone,
    /// A reset sequence was written: the ESC restarts. Its links stay as they are.
    Reset,
}

/// A fault that a port detected, named by the counter that counts it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PortError {
    /// Registers 0x0300, 0x0302...: a frame with a wrong check sequence.
    InvalidFrame,
    /// Registers 0x0301, 0x0303...: the PHY reported an error.
    RxError,
    /// Registers 0x0308...: a frame that an earlier ESC had marked as wrong.
    Forwarded,
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// An ESC at power-on, at device time zero and with the local time zero. The configuration area
    /// is loaded from `eeprom`. `ram` is the process RAM from 0x1000 on: RAM of the chip beyond the
    /// end of `ram` does not exist, and bytes of `ram` beyond the chip's RAM are not used.
    pub fn new(chip: &Chip, eeprom: M, ram: M) -> Self {
        let registers = Registers::new(chip);
        let mut esc = Self {
            chip: *chip,
            sync_managers: SyncManagers::new(chip),
            registers,
            shadow: Shadow::new(),
            units: Units::new(chip, 0),
            fmmus: Fmmus::new(chip.fmmu_count),
            al: Al::new(),
            eeprom: Eeprom::new(chip, eeprom.as_ref().len()),
            mii: Mii::new(chip),
            dc: DcUnit::new(chip, 0, Time::ZERO),
            ram_len: ram.as_ref().len().min(usize::from(chip.ram_kib) * 1024),
            grow: None,
            ram,
            image: eeprom,
            flight: Flight::NONE,
            reset_progress: [0; 2],
            pdi_watchdog: Watchdog::new(register::WATCHDOG_TIME_PDI),
            ports: Ports::new(),
            watchdog: Watchdog::new(register::WATCHDOG_TIME_PROCESS_DATA),
            held_al_events: [0; 2],
            dl_changed: false,
            overdue: None,
            rest: Time::ZERO,
            reach_version: 0,
            eeprom_is_dead: false,
            lane: true,
            areas: Known::Nothing,
            cyclic: Lane::CLOSED,
        };
        esc.start(Time::ZERO, 0);
        esc
    }

    /// The same ESC with all the RAM of its chip, of which only the used part takes memory. `grow`
    /// extends `ram` with zeros to at least the given length. It is called when an access first
    /// reaches beyond the present end.
    pub fn with_growing_ram(mut self, grow: fn(&mut M, usize)) -> Self {
        self.ram_len = usize::from(self.chip.ram_kib) * 1024;
        self.registers.store(register::RAM_SIZE, self.chip.ram_kib);
        self.grow = Some(grow);
        self
    }

    /// Makes RAM long enough before an access to `len` bytes of process RAM from `address` on.
    pub(crate) fn reach_ram(&mut self, address: u16, len: usize) {
        let Some(grow) = self.grow else { return };
        let end = (usize::from(address) + len).max(self.sync_managers.reserved_end());
        let needed = end.saturating_sub(usize::from(register::PROCESS_RAM)).min(self.ram_len);
        if self.ram.as_ref().len() < needed {
            grow(&mut self.ram, needed.next_multiple_of(RAM_GRAIN).min(self.ram_len));
        }
    }

    /// The same ESC with its local time at `local` at device time zero.
    pub fn with_local_time(mut self, local: Time<Local>) -> Self {
        self.dc.restart(&self.chip, local.count(), Time::ZERO);
        self.note_rest();
        self
    }

    /// The same ESC with another drift law than that of its chip.
    pub fn with_drift_law(mut self, law: DriftLaw) -> Self {
        self.dc.set_drift_law(law);
        self
    }

    /// Power goes away or comes back: the ESC is as after [`new`](Self::new), with the local time
    /// at `local`, but the EEPROM keeps what was written to it. No port has a link. The law set by
    /// [`with_drift_law`](Self::with_drift_law) and the pins of the latch inputs stay as they are.
    pub fn power_on(&mut self, now: Time<Device>, local: Time<Local>) {
        self.ports = Ports::new();
        self.overdue = None;
        self.ram.as_mut().fill(0);
        self.start(now, local.count());
    }

    /// Restarts everything except links and RAM.
    fn start(&mut self, now: Time<Device>, local: u64) {
        let chip = &{ self.chip };
        self.reach_version = self.reach_version.wrapping_add(1);
        self.areas = Known::Nothing;
        self.registers = Registers::new(chip);
        let registers = &mut self.registers;
        registers.store(register::TYPE, chip.kind);
        registers.store(register::REVISION, chip.revision);
        registers.store(register::BUILD, chip.build);
        registers.store(register::FMMU_COUNT, chip.fmmu_count);
        registers.store(register::SM_COUNT, chip.sm_count);
        registers.store(register::RAM_SIZE, (self.ram_len / 1024) as u8);
        registers.store(register::PORT_DESCRIPTOR, chip.port_descriptor);
        registers.store(register::FEATURES, chip.features);
        registers.store(register::DL_CONTROL, chip.dl_control);
        registers.store(register::AL_EVENT_MASK, AL_EVENT_MASK);
        registers.store(register::WATCHDOG_DIVIDER, WATCHDOG_DIVIDER);
        registers.store(register::WATCHDOG_TIME_PDI, WATCHDOG_TIME);
        registers.store(register::WATCHDOG_TIME_PROCESS_DATA, WATCHDOG_TIME);
        self.al = Al::new();
        self.al.reset_registers(registers);
        self.sync_managers = SyncManagers::new(chip);
        self.fmmus = Fmmus::new(chip.fmmu_count);
        self.shadow.clear();
        self.flight = Flight::NONE;
        self.reset_progress = [0; 2];
        self.held_al_events = [0; 2];
        self.watchdog = Watchdog::new(register::WATCHDOG_TIME_PROCESS_DATA);
        self.pdi_watchdog = Watchdog::new(register::WATCHDOG_TIME_PDI);
        self.watchdog.configure(now, registers);
        self.pdi_watchdog.configure(now, registers);
        self.dc.restart(chip, local, now);
        self.dc.reset_registers(registers);
        self.eeprom = Eeprom::new(chip, self.image.as_ref().len());
        self.load_configuration();
        if let Some(area) = eeprom::configuration(self.answering_image()) {
            let area = *area;
            let registers = &mut self.registers;
            let alias = 2 * ALIAS_WORD;
            registers
                .store(register::STATION_ALIAS, u16::from_le_bytes([area[alias], area[alias + 1]]));
            dl::set_status(registers, DlStatus::ENHANCED_LINK, area[1] & 0xF2 != 0);
        }
        self.eeprom.show(&mut self.registers);
        let own = chip.chip_specific;
        let end = CHIP_SPECIFIC + own.len().min(256) as u16;
        self.registers.bytes_mut(CHIP_SPECIFIC..end).copy_from_slice(&own[..own.len().min(256)]);
        self.ports.update(chip, &mut self.registers, ALL_PORTS);
        self.mii = Mii::new(chip);
        self.mii.show(chip, self.ports.links(), &mut self.registers);
        self.dl_changed = false;
        self.note_rest();
    }

    /// Loads the EEPROM's configuration area into the registers.
    fn load_configuration(&mut self) {
        let registers = &mut self.registers;
        let loaded = match self.eeprom_is_dead {
            true => self.eeprom.miss(),
            false => self.eeprom.load(self.image.as_ref(), registers),
        };
        dl::set_status(registers, DlStatus::PDI_OPERATIONAL, loaded);
        if registers.load(register::PDI_CONTROL) == PDI_DIGITAL_IO {
            dl::set_status(registers, DlStatus::PDI_WATCHDOG, true);
        }
        let mut information = if loaded { PDI_INFORMATION_LOADED } else { 0 };
        if self.chip.acknowledge_by_write {
            information |= PDI_INFORMATION_ACKNOWLEDGE_BY_WRITE;
        }
        registers.store(register::PDI_INFORMATION, information);
        self.areas = Known::Nothing;
        self.units = Units::new(&self.chip, registers.load(register::ESC_CONFIGURATION));
        self.shadow.open(&self.units);
        self.al.set_emulation(registers);
    }

    /// Reports that a frame that wrote 0x0900 (see [`Processed::latch_ports`](crate::Processed))
    /// arrived, with its first preamble bit, at this port: on its way in, or on its way back from
    /// the branch behind the port.
    ///
    /// An ESC in reverse mode (0x0936) shows for ports 1-3 what arrived there before the frame
    /// reached the EPU. Arrivals of earlier frames may then be reported too; they are kept for the
    /// next such frame.
    ///
    /// On an ESC that [stamps the next frame](Chip::stamps_next_frame), any arrival at ports 1-3
    /// may be reported, in order of time. The first that begins there no earlier than the writing
    /// frame began at the EPU is kept; the others are not. It must be reported while
    /// [`awaits_frame`](Self::awaits_frame) returns true.
    pub fn receive_at_port(&mut self, port: PortNumber, at: Time<Device>) {
        self.dc.receive_at_port(port, at, &mut self.registers);
    }

    /// Whether this port stamps the next frame that arrives there, whatever its content. This is so
    /// after 0x0900 was written on an ESC that [does so](Chip::stamps_next_frame), until an arrival
    /// is reported.
    pub fn awaits_frame(&self, port: PortNumber) -> bool {
        self.dc.awaits_frame(port)
    }

    /// Sets the pin of a latch input to this level from `at` on; pins are low at first. The unit
    /// samples the pin at the first tick at or after `at`: see [`EscEvent::Latched`]. An ESC
    /// without latch unit ignores the call.
    pub fn set_latch_input(&mut self, input: LatchInput, level: bool, at: Time<Device>) {
        if self.units.latch {
            self.settle(at);
            self.dc.set_latch_input(input, level, at, &self.registers);
            self.note_rest();
        }
    }

    /// A cable was plugged or unplugged. A port that the chip does not have is ignored.
    pub fn set_port(&mut self, port: PortNumber, link: bool) {
        if self.ports.set_link(port, link, &self.registers) {
            count(&mut self.registers, 0x0310 + port.index() as u16);
        }
        self.dl_changed |= self.ports.update(&self.chip, &mut self.registers, 0);
        self.mii.show(&self.chip, self.ports.links(), &mut self.registers);
        self.reach_version = self.reach_version.wrapping_add(1);
        self.note_rest();
    }

    /// A good frame arrived at a port whose loop may be closed. A loop that closed by itself and
    /// waits for a frame ("auto-close") opens for the frames that follow. Returns whether it
    /// opened.
    pub fn hear_frame(&mut self, port: PortNumber) -> bool {
        let waits = self.ports.waits_for_frame(port, &self.registers);
        if waits {
            self.dl_changed |=
                self.ports.update(&self.chip, &mut self.registers, 1 << port.index());
            self.reach_version = self.reach_version.wrapping_add(1);
            self.note_rest();
        }
        waits
    }

    /// Whether loops are about to change, at the end of the frame in flight or of a temporary
    /// setting.
    pub fn loops_pending(&self) -> bool {
        let written = [0x0040..0x0041, 0x0100..0x0104];
        self.ports.due() != Time::NEVER
            || self.flight.end != Time::NEVER
                && written.into_iter().any(|range| self.shadow.touches(range))
    }

    /// Counts a fault that a port detected. Faults of frames that reach the EPU it counts itself
    /// (0x030C).
    pub fn count_error(&mut self, port: PortNumber, error: PortError) {
        let port = port.index() as u16;
        let counter = match error {
            PortError::InvalidFrame => 0x0300 + 2 * port,
            PortError::RxError => 0x0301 + 2 * port,
            PortError::Forwarded => 0x0308 + port,
        };
        count(&mut self.registers, counter);
    }

    /// Labels the frame in flight: the bytes that it writes into buffers of SyncManagers keep the
    /// label. Call this after the frame has passed and before it ends. A frame without a label has
    /// the label 0. No register shows labels, and they change nothing.
    pub fn label_frame(&mut self, label: u64) {
        self.flight.label = label;
    }

    /// Labels the bytes that the PDI writes into buffers of SyncManagers from now on.
    pub fn label_pdi(&mut self, label: u64) {
        self.sync_managers.pdi_label = label;
    }

    /// The label of the bytes that either side last read, or is reading, from the buffer of a
    /// SyncManager (0 to 15). It is 0 if nothing was read or the bytes have no label.
    pub fn label(&self, sync_manager: u8) -> u64 {
        self.sync_managers.label(usize::from(sync_manager))
    }

    /// An instant at or before the next own event. [`step`](Self::step) then handles the event, or
    /// finds its exact time. It is never if no event is due.
    pub fn next_event(&self) -> Time<Device> {
        match self.overdue {
            Some((at, _)) => at,
            None => self.earliest().0,
        }
    }

    /// The same, faster and perhaps earlier.
    #[inline]
    pub fn quiet_until(&self) -> Time<Device> {
        debug_assert!(self.rest <= self.rest_due(), "a unit is due earlier than was noted");
        match self.overdue {
            Some((at, _)) => at,
            None => self.flight.end.min(self.dc.sync.due()).min(self.rest),
        }
    }

    /// An instant before which no unit is due but the frame in flight and the SYNC unit.
    #[inline]
    pub const fn rest_until(&self) -> Time<Device> {
        self.rest
    }

    /// The same, found out again: a watchdog may have been restarted since.
    #[inline(never)]
    pub fn find_rest(&mut self) -> Time<Device> {
        self.note_rest();
        self.rest
    }

    /// The earliest due time of the units that are seldom due.
    fn rest_due(&self) -> Time<Device> {
        (self.watchdog.due().min(self.pdi_watchdog.due()))
            .min(self.eeprom.due().min(self.ports.due()))
            .min(self.dc.latch.due().min(self.mii.due()))
    }

    /// Called after any of these units may have become due earlier.
    pub(crate) fn note_rest(&mut self) {
        self.rest = self.rest_due();
    }

    /// Handles the earliest own event at or before `limit` and names it; `None` when none is left.
    pub fn step(&mut self, limit: Time<Device>) -> Option<(Time<Device>, EscEvent)> {
        loop {
            if self.overdue.is_some_and(|(at, _)| at <= limit) {
                return self.overdue.take();
            }
            let at = self.quiet_until();
            if at > limit || at == Time::NEVER {
                return None;
            }
            // Events of every cycle are tested first.
            let event = match at {
                _ if at == self.flight.end => Some(self.end_frame()),
                _ if at == self.dc.sync.due() => self.fire(),
                // As a rule a watchdog was restarted since it was noted.
                _ if self.rest_due() > at => None,
                _ => self.handle(self.earliest().1),
            };
            if at == self.rest {
                self.note_rest();
            }
            if let Some(event) = event {
                return Some((at, event));
            }
        }
    }

    /// The local CPU works at `now` without an access: this has the side effect of
    /// [`pdi`](Self::pdi) only. The frame in flight must not have ended by then.
    #[inline]
    pub fn note_pdi(&mut self, now: Time<Device>) {
        debug_assert!(now < self.flight.end, "the frame ends first");
        EscPdi::new(self, now);
    }

    /// Opens the local CPU's access to the ESC at `now`.
    #[inline]
    pub fn pdi(&mut self, now: Time<Device>) -> EscPdi<'_, M> {
        self.settle(now);
        EscPdi::new(self, now)
    }

    /// Number of SYNC0 and SYNC1 pulses since power-on or reset that made no edge, because the
    /// signal was still active from the pulse before: it was not acknowledged yet (0x0982 is 0), or
    /// is longer than the cycle. The counters wrap.
    pub const fn sync_pulses_without_edge(&self) -> [u32; 2] {
        self.dc.sync.without_edge()
    }

    /// The AL event request (0x0220) at `now`.
    pub fn al_events(&self, now: Time<Device>) -> u32 {
        self.own_al_events()
            | self.dc.sync.al_events(now, &self.registers)
            | self.dc.latch.al_events(&self.registers)
    }

    /// Whether the interrupt line to the local CPU is active: an AL event passes the mask (0x0204).
    /// The mask does not change the request.
    pub fn interrupt(&self, now: Time<Device>) -> bool {
        self.al_events(now) & self.register(register::AL_EVENT_MASK) != 0
    }

    /// The AL events that frames and the PDI cause, without those of the latch unit.
    pub(crate) fn own_al_events(&self) -> u32 {
        self.al.events() | self.sync_managers.al_events() | self.eeprom.al_events()
    }

    /// The ECAT event request (0x0210), before the mask.
    pub fn ecat_event_request(&self) -> u16 {
        self.ecat_events()
    }

    /// The value of a register in force, without the side effects of a read. Running times (0x0910,
    /// 0x0990...) are as the last access left them.
    pub fn register<T: Value>(&self, register: Register<T>) -> T {
        if !(SYNC_MANAGERS.start..SYNC_MANAGERS.end).contains(&register.address) {
            return self.registers.load(register);
        }
        let mut bytes = T::Bytes::default();
        for (address, byte) in (register.address..).zip(bytes.as_mut()) {
            *byte = self.byte(address);
        }
        T::from_bytes(bytes)
    }

    fn byte(&self, address: u16) -> u8 {
        match address {
            _ if SYNC_MANAGERS.contains(&address) && address % SM_LEN == 5 => {
                self.sync_managers.status(usize::from((address - SYNC_MANAGERS.start) / SM_LEN))
            }
            _ => self.registers.byte(address),
        }
    }

    /// Register 0x0110: which ports frames leave through.
    pub fn dl_status(&self) -> DlStatus {
        self.registers.load(register::DL_STATUS)
    }

    /// Register 0x0130.
    pub fn al_status(&self) -> AlStatus {
        self.registers.load(register::AL_STATUS)
    }

    /// Register 0x092C as a number: local time less received time, positive when the local clock is
    /// ahead.
    pub fn system_time_difference(&self) -> Nanos {
        let polarity = self.chip.difference_polarity;
        self.register(register::SYSTEM_TIME_DIFFERENCE).nanos(polarity)
    }

    /// What kind of ESC it is.
    pub fn chip(&self) -> &Chip {
        &self.chip
    }

    /// Registers and user RAM in force, 0x0000-0x0FFF; see [`Self::register`].
    pub fn registers(&self) -> [u8; register::PROCESS_RAM as usize] {
        core::array::from_fn(|address| self.byte(address as u16))
    }

    /// Process RAM from 0x1000 on, including all buffers of SyncManagers. RAM that grows with its
    /// use ends behind the last byte used.
    pub fn ram(&self) -> &[u8] {
        let ram = self.ram.as_ref();
        &ram[..self.ram_len.min(ram.len())]
    }

    /// The EEPROM image with everything written to it.
    pub fn eeprom(&self) -> &[u8] {
        self.image.as_ref()
    }

    /// The EEPROM image, for a program that writes the memory past the ESC. What the ESC has
    /// already loaded from it stays.
    pub fn eeprom_mut(&mut self) -> &mut [u8] {
        self.image.as_mut()
    }

    /// The end of the last frame: when its effects come into force, if that is still to come;
    /// otherwise when it arrived.
    pub fn last_frame(&self) -> Time<Device> {
        let Flight { start, end, .. } = self.flight;
        if end == Time::NEVER { start } else { end }
    }

    /// Sets whether the EEPROM acknowledges nothing (it is broken or has no supply). While it is
    /// dead each command ends with the missing acknowledge of register 0x0502 bit 13, and nothing
    /// is loaded at a reset or power-on.
    pub fn set_eeprom_dead(&mut self, dead: bool) {
        self.eeprom_is_dead = dead;
    }

    /// The EEPROM image, or an empty one if the memory does not answer.
    fn answering_image(&self) -> &[u8] {
        if self.eeprom_is_dead { &[] } else { self.image.as_ref() }
    }

    /// Local time (0x0900), in the width of this ESC's counter.
    pub fn local_time(&self, at: Time<Device>) -> Time<Local> {
        self.dc.local_time(at)
    }

    /// Local time plus offset, in the width of this ESC's counter.
    pub fn system_time(&self, at: Time<Device>) -> Time<Dc> {
        self.dc.system_time(at)
    }

    /// The same in 64 bits, whatever the width of its counter: a count that goes on where a counter
    /// of 32 bits begins again.
    pub fn system_count(&self, at: Time<Device>) -> u64 {
        self.dc.system(at)
    }

    /// The first instant at or after `from`, on its tick, at which the system time has reached
    /// `system`. A `system` up to half the counter's range in the past counts as reached.
    pub fn first_reaching(&self, system: Time<Dc>, from: Time<Device>) -> Time<Device> {
        self.dc.first_reaching(system, from)
    }

    /// Whether the signals SYNC0 and SYNC1 are active at `now`.
    pub fn sync_signals(&self, now: Time<Device>) -> [bool; 2] {
        self.dc.sync.levels(now)
    }

    /// Whether the SYNC unit is active (0x0981 bit 0).
    pub fn sync_active(&self) -> bool {
        self.dc.sync.is_active()
    }

    /// System time of the next pulse of SYNC0, which 0x0990 shows; `None` if none is to come. A
    /// time that has passed comes again when the counter of the system time has gone round.
    pub fn next_sync0(&self) -> Option<Time<Dc>> {
        self.dc.sync.next_sync0()
    }

    /// Applies the end of the frame in flight if it is over, in case the caller did not `step` to
    /// it.
    #[inline]
    pub(crate) fn settle(&mut self, now: Time<Device>) {
        if self.flight.end <= now && self.flight.end != Time::NEVER {
            let end = self.flight.end;
            let event = self.end_frame();
            self.overdue = self.overdue.or(Some((end, event)));
        }
    }

    /// The ECAT event request (0x0210).
    pub(crate) fn ecat_events(&self) -> u16 {
        u16::from(self.dl_changed) << 2
            | self.al.ecat_events()
            | self.sync_managers.ecat_events()
            | self.dc.latch.ecat_events(&self.registers)
    }

    /// Advances a reset sequence by a written byte; `side` 0 is ECAT, 1 the PDI. Returns whether
    /// the sequence is complete and the ESC was reset.
    pub(crate) fn advance_reset(&mut self, side: usize, written: u8, now: Time<Device>) -> bool {
        let progress = usize::from(self.reset_progress[side]);
        self.reset_progress[side] = if RESET_SEQUENCE[progress] == written {
            progress as u8 + 1
        } else {
            u8::from(RESET_SEQUENCE[0] == written)
        };
        // Frames or accesses in between that do not touch the register do not break the sequence.
        let complete = usize::from(self.reset_progress[side]) == RESET_SEQUENCE.len();
        if complete {
            self.start(now, 0);
            self.overdue = Some((now, EscEvent::Reset));
        }
        let address = register::ESC_RESET_ECAT.address + side as u16;
        self.registers.set_byte(address, self.reset_progress[side]);
        complete
    }

    fn earliest(&self) -> (Time<Device>, Due) {
        let mut earliest = (self.flight.end, Due::FrameEnd);
        for other in [
            (self.dc.sync.due(), Due::Sync),
            (self.dc.latch.due(), Due::Latch),
            (self.watchdog.due(), Due::Watchdog),
            (self.pdi_watchdog.due(), Due::PdiWatchdog),
            (self.eeprom.due(), Due::Eeprom),
            (self.mii.due(), Due::Mii),
            (self.ports.due(), Due::Loops),
        ] {
            if other.0 < earliest.0 {
                earliest = other;
            }
        }
        earliest
    }

    pub(crate) fn fire(&mut self) -> Option<EscEvent> {
        self.dc.fire(&self.registers).map(|output| match output {
            Output::Sync0 => EscEvent::Sync0,
            Output::Sync1 => EscEvent::Sync1,
        })
    }

    fn handle(&mut self, due: Due) -> Option<EscEvent> {
        match due {
            Due::FrameEnd => Some(self.end_frame()),
            Due::Sync => self.fire(),
            Due::Latch => {
                let before = self.dc.latch.al_events(&self.registers);
                let stored = self.dc.sample_latches(&self.registers);
                let al_event = self.dc.latch.al_events(&self.registers) != before;
                stored.then_some(EscEvent::Latched { al_event })
            }
            Due::Watchdog => {
                self.watchdog.expire();
                self.al.set_watchdog_event(true);
                led::take_error_led_back(&mut self.registers);
                count(&mut self.registers, register::WATCHDOG_COUNTER_PROCESS_DATA.address);
                Some(EscEvent::WatchdogExpired)
            }
            Due::PdiWatchdog => {
                self.pdi_watchdog.expire();
                dl::set_status(&mut self.registers, DlStatus::PDI_WATCHDOG, false);
                led::take_error_led_back(&mut self.registers);
                count(&mut self.registers, register::WATCHDOG_COUNTER_PDI.address);
                Some(EscEvent::PdiWatchdogExpired)
            }
            Due::Eeprom => {
                let image = &mut self.image;
                if self.eeprom_is_dead {
                    self.eeprom.get_no_acknowledge();
                } else if self.eeprom.finish(image, &self.chip, &mut self.registers) {
                    self.load_configuration();
                }
                self.eeprom.show(&mut self.registers);
                Some(EscEvent::EepromDone)
            }
            Due::Mii => {
                let links = self.ports.links();
                self.mii.finish(&self.chip, links, &mut self.registers);
                self.mii.show(&self.chip, links, &mut self.registers);
                None
            }
            Due::Loops => {
                self.ports.end_temporary(&mut self.registers);
                let changed = self.ports.update(&self.chip, &mut self.registers, ALL_PORTS);
                self.dl_changed |= changed;
                self.reach_version = self.reach_version.wrapping_add(1);
                changed.then_some(EscEvent::Ports)
            }
        }
    }

    /// The process data watchdog's status register, 0x0440.
    pub(crate) fn show_watchdog(&mut self) {
        let fine = self.watchdog.is_fine();
        self.registers.store(register::WATCHDOG_STATUS, u16::from(fine));
    }

    /// Stores the local time of an event at a buffer in 0x09F0, 0x09F8 or 0x09FC.
    pub(crate) fn latch_buffer_time(&mut self, time: Register<u32>, at: Time<Device>) {
        let local = self.dc.local_time(at).count();
        self.registers.store(time, local as u32);
    }

    /// Whether process RAM can be accessed, which needs a loaded EEPROM.
    pub(crate) fn is_operational(&self) -> bool {
        self.dl_status().0 & DlStatus::PDI_OPERATIONAL != 0
    }

    /// Whether a circulating frame must be stopped here.
    pub(crate) fn stops_circulating(&self) -> bool {
        self.ports.stops_circulating(&self.registers)
    }

    /// A buffer that triggers the watchdog was completed.
    pub(crate) fn trigger_watchdog(&mut self, now: Time<Device>) {
        self.watchdog.restart(now);
        self.rest = self.rest.min(self.watchdog.due());
    }

    /// The local CPU accesses the ESC.
    #[inline]
    pub(crate) fn trigger_pdi_watchdog(&mut self, now: Time<Device>) {
        self.pdi_watchdog.restart(now);
        self.rest = self.rest.min(self.pdi_watchdog.due());
    }
}

/// The kinds of own events, in the order in which they happen at one instant.
#[derive(Clone, Copy, Debug)]
enum Due {
    /// When the frame in flight ends.
    FrameEnd,
    /// When a SYNC pulse is due.
    Sync,
    /// When a latch input is sampled with a new level.
    Latch,
    /// When the process data watchdog expires.
    Watchdog,
    /// When the PDI watchdog expires.
    PdiWatchdog,
    /// When the EEPROM command is done.
    Eeprom,
    /// When the command to a PHY is done.
    Mii,
    /// When temporary loop settings end.
    Loops,
}

/// Registers of the SyncManagers.
pub(crate) const SYNC_MANAGERS: Range<u16> = 0x0800..0x0880;
/// RAM grows in steps of this many bytes.
const RAM_GRAIN: usize = 256;

/// Adds one to a counter that stays at 0xFF.
pub(crate) fn count(registers: &mut Registers, address: u16) {
    let value = registers.byte(address).saturating_add(1);
    registers.set_byte(address, value);
}

/// ECAT event request bits.
pub(crate) const ECAT_DL_STATUS: u16 = 1 << 2;
pub(crate) const ECAT_AL_STATUS: u16 = 1 << 3;
/// These bytes, written one after the other to 0x0040 or 0x0041, reset the ESC.
const RESET_SEQUENCE: [u8; 3] = *b"RES";
/// Reset value of register 0x0204.
const AL_EVENT_MASK: u32 =
    0x00FF_FF00 | al_event::AL_CONTROL | al_event::LATCH | al_event::SYNC0 | al_event::SYNC1;
/// Reset value of register 0x0400: 100 us.
const WATCHDOG_DIVIDER: u16 = 2498;
/// Reset value of registers 0x0410 and 0x0420: 100 ms.
const WATCHDOG_TIME: u16 = 1000;
/// SII word of the station alias.
const ALIAS_WORD: usize = 4;
/// Register 0x0140: digital I/O. There is no CPU that could signal that it is alive, so DL status
/// bit 1 reads 1 (captured on three kinds of terminals).
pub(crate) const PDI_DIGITAL_IO: u8 = 0x04;
/// Register 0x014E: the configuration area is loaded, the PDI is active.
const PDI_INFORMATION_LOADED: u16 = 0x0006;
/// Register 0x014E: see [`Chip::acknowledge_by_write`].
const PDI_INFORMATION_ACKNOWLEDGE_BY_WRITE: u16 = 0x0001;
