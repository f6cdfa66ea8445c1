//! One ESC: its parts, its events in the order of time, and the end of a frame.

use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, CHIP_SPECIFIC, Register, Value, al_event};
use isocat_wire::time::{Dc, Device, Local};
use isocat_wire::{AlStatus, Nanos, PortNumber, Time};

use crate::access::Units;
use crate::al::Al;
use crate::chip::Chip;
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
use crate::sync_manager::SyncManagers;
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
/// - labels beside the bytes, for who watches: [`label_frame`](Self::label_frame),
///   [`label_pdi`](Self::label_pdi), [`label`](Self::label);
/// - looking in from outside, without any side effect: [`register`](Self::register),
///   [`dl_status`](Self::dl_status), [`local_time`](Self::local_time), [`system_time`](Self::system_time),
///   [`first_reaching`](Self::first_reaching), [`registers`](Self::registers), [`ram`](Self::ram),
///   [`interrupt`](Self::interrupt).
///
/// **Time** is an argument everywhere and must not go back. Before anything is done at an instant,
/// `step` has to be called with it until it returns `None`, so that what fell due before has happened.
pub struct Esc<M> {
    pub(crate) chip: Chip,
    pub(crate) registers: Registers,
    pub(crate) shadow: Shadow,
    pub(crate) ram: M,
    /// Bytes of process RAM that exist for both sides.
    pub(crate) ram_len: usize,
    /// Makes `ram` longer, where it grows with its use.
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
    /// The AL event request as each side last read its first byte.
    pub(crate) held_al_events: [u32; 2],
    /// DL status changed and ECAT has not read it since.
    pub(crate) dl_changed: bool,
    /// What happened beside the event just reported.
    pub(crate) overdue: Option<(Time<Device>, EscEvent)>,
    /// Counts what may have changed [`Esc::reach`].
    pub(crate) reach_version: u32,
    /// The memory acknowledges nothing.
    eeprom_is_dead: bool,
    /// See [`Esc::set_lane`].
    pub(crate) lane: bool,
    /// Where process data lies, as far as it is known.
    pub(crate) areas: Known,
}

/// The frame in flight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flight {
    pub start: Time<Device>,
    /// When its effects come into force; never if it has none.
    pub end: Time<Device>,
    /// ECAT events that it acknowledged by reading.
    pub acknowledged: u16,
    /// Latch times that it read, see `dc::latch::times`.
    pub latch_times: u8,
    /// It wrote a write enable register: 0x0020, 0x0030.
    pub enabled: [bool; 2],
    /// What every datagram shows in its IRQ field.
    pub irq: u16,
    /// It latches receive times.
    pub latches: bool,
    /// The system time that it brought, as long as it wrote nothing else to registers.
    pub brought: Brought,
    /// What its sender calls it.
    pub label: u64,
    /// PDI control bytes that the PDI wrote meanwhile, and for which SyncManagers.
    pub pdi_control: [u8; 16],
    pub pdi_control_written: u16,
}

impl Flight {
    /// No frame.
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
        pdi_control: [0; 16],
        pdi_control_written: 0,
    };
}

/// Something that an ESC does by itself at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EscEvent {
    /// A good frame has ended and its effects came into force.
    FrameEnd {
        /// Bits of the AL event request (0x0220) that it newly set, whatever their mask.
        al_events: u32,
    },
    /// A loop opened or closed: see [`Esc::dl_status`].
    Ports,
    /// SYNC0 became active.
    Sync0,
    /// SYNC1 became active.
    Sync1,
    /// The latch unit stored the time of an edge.
    Latched {
        /// It newly set bit 1 of the AL event request (0x0220), whatever its mask.
        al_event: bool,
    },
    /// The process data watchdog expired.
    WatchdogExpired,
    /// The PDI watchdog expired.
    PdiWatchdogExpired,
    /// An EEPROM command is done.
    EepromDone,
    /// A reset sequence was written: the ESC starts anew. Its links stay as they are.
    Reset,
}

/// A fault that a port saw, by the counter that counts it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PortError {
    /// Registers 0x0300, 0x0302...: a frame with a wrong check sequence.
    InvalidFrame,
    /// Registers 0x0301, 0x0303...: the PHY reported an error.
    RxError,
    /// Registers 0x0308...: a frame that an ESC before this one had marked as wrong.
    Forwarded,
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// Power-on at device time zero, with the local time at zero too. The configuration area is loaded
    /// from `eeprom`; `ram` is the process RAM from 0x1000 on (what the chip has beyond it does not
    /// exist, what `ram` has beyond the chip is not used).
    pub fn new(chip: &Chip, eeprom: M, ram: M) -> Self {
        let mut registers = Registers::new();
        let mut esc = Self {
            chip: *chip,
            sync_managers: SyncManagers::new(chip, &mut registers),
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
            reach_version: 0,
            eeprom_is_dead: false,
            lane: true,
            areas: Known::Nothing,
        };
        esc.start(Time::ZERO, 0);
        esc
    }

    /// The same ESC with all the RAM of its chip, of which only what is used takes memory: `grow` makes the
    /// `ram` given so far at least so many bytes long, with zeros. It is called when an access first reaches
    /// beyond.
    pub fn with_growing_ram(mut self, grow: fn(&mut M, usize)) -> Self {
        self.ram_len = usize::from(self.chip.ram_kib) * 1024;
        self.registers.store(register::RAM_SIZE, self.chip.ram_kib);
        self.grow = Some(grow);
        self
    }

    /// Before an access to `len` bytes of process RAM from `address` on: RAM is there as far as it goes.
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
        self
    }

    /// The same ESC with another law of the drift loop than its chip's.
    pub fn with_drift_law(mut self, law: DriftLaw) -> Self {
        self.dc.set_drift_law(law);
        self
    }

    /// Power goes away, or comes back: everything is as after [`new`](Self::new), with the local time at
    /// `local`, but the EEPROM holds what was written to it. No port has a link. What was set by
    /// [`with_drift_law`](Self::with_drift_law) and the pins of the latch inputs stay as they are.
    pub fn power_on(&mut self, now: Time<Device>, local: Time<Local>) {
        self.ports = Ports::new();
        self.overdue = None;
        self.ram.as_mut().fill(0);
        self.start(now, local.count());
    }

    /// Everything from the beginning, but links and RAM.
    fn start(&mut self, now: Time<Device>, local: u64) {
        let chip = &{ self.chip };
        self.reach_version = self.reach_version.wrapping_add(1);
        self.areas = Known::Nothing;
        self.registers = Registers::new();
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
        self.sync_managers = SyncManagers::new(chip, registers);
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
    }

    /// Loads the EEPROM's configuration area into the registers.
    fn load_configuration(&mut self) {
        let image: &[u8] = if self.eeprom_is_dead { &[] } else { self.image.as_ref() };
        let registers = &mut self.registers;
        let loaded = self.eeprom.load(image, registers);
        dl::set_status(registers, DlStatus::PDI_OPERATIONAL, loaded);
        if registers.load(register::PDI_CONTROL) == PDI_DIGITAL_IO {
            dl::set_status(registers, DlStatus::PDI_WATCHDOG, true);
        }
        let mut information = if loaded { PDI_INFORMATION_LOADED } else { 0 };
        if self.chip.acknowledge_by_write {
            information |= PDI_INFORMATION_ACKNOWLEDGE_BY_WRITE;
        }
        registers.store(register::PDI_INFORMATION, information);
        self.units = Units::new(&self.chip, registers.load(register::ESC_CONFIGURATION));
        self.shadow.open(&self.units);
        self.al.set_emulation(registers);
    }

    /// A frame that wrote 0x0900 (see [`Processed::latch_ports`](crate::Processed)) arrived, with its
    /// first preamble bit, at this port: on its way in, or coming back from the branch behind the port.
    ///
    /// On an ESC in reverse mode (0x0936) ports 1-3 show what arrived there before the frame reached the
    /// EPU; arrivals of earlier frames may then be reported too, and are kept for the next such frame.
    ///
    /// On one that [stamps the next frame](Chip::stamps_next_frame) whatever arrives at ports 1-3
    /// may be reported, in order of time: the first that begins there no earlier than the writing
    /// frame at the EPU is kept, and the others are not. It must be reported while
    /// [`awaits_frame`](Self::awaits_frame) says so.
    pub fn receive_at_port(&mut self, port: PortNumber, at: Time<Device>) {
        self.dc.receive_at_port(port, at, &mut self.registers);
    }

    /// Whether this port stamps the next frame that arrives there, of whatever content: 0x0900 was
    /// written on an ESC that [does so](Chip::stamps_next_frame), and none has been reported since.
    pub fn awaits_frame(&self, port: PortNumber) -> bool {
        self.dc.awaits_frame(port)
    }

    /// The pin of a latch input has this level from `at` on; pins are low at first. The unit samples it
    /// at the first tick at or after `at`: see [`EscEvent::Latched`]. An ESC without latch unit ignores
    /// it.
    pub fn set_latch_input(&mut self, input: LatchInput, level: bool, at: Time<Device>) {
        if self.units.latch {
            self.settle(at);
            self.dc.set_latch_input(input, level, at, &self.registers);
        }
    }

    /// A cable was plugged or unplugged. A port that the chip has not is ignored.
    pub fn set_port(&mut self, port: PortNumber, link: bool) {
        if self.ports.set_link(port, link, &self.registers) {
            count(&mut self.registers, 0x0310 + port.index() as u16);
        }
        self.dl_changed |= self.ports.update(&self.chip, &mut self.registers, 0);
        self.mii.show(&self.chip, self.ports.links(), &mut self.registers);
        self.reach_version = self.reach_version.wrapping_add(1);
    }

    /// A good frame arrived at a port whose loop may be closed: one that closed by itself and is set to
    /// stay so ("auto-close") opens for the frames that follow. Returns whether it did.
    pub fn hear_frame(&mut self, port: PortNumber) -> bool {
        let waits = self.ports.waits_for_frame(port, &self.registers);
        if waits {
            self.dl_changed |=
                self.ports.update(&self.chip, &mut self.registers, 1 << port.index());
            self.reach_version = self.reach_version.wrapping_add(1);
        }
        waits
    }

    /// Whether loops are going to change: by the end of the frame in flight or of a temporary setting.
    pub fn loops_pending(&self) -> bool {
        let written = [0x0040..0x0041, 0x0100..0x0104];
        self.ports.due() != Time::NEVER
            || self.flight.end != Time::NEVER
                && written.into_iter().any(|range| self.shadow.touches(range))
    }

    /// A port saw a fault. The EPU counts by itself what it gets to process (0x030C).
    pub fn count_error(&mut self, port: PortNumber, error: PortError) {
        let port = port.index() as u16;
        let counter = match error {
            PortError::InvalidFrame => 0x0300 + 2 * port,
            PortError::RxError => 0x0301 + 2 * port,
            PortError::Forwarded => 0x0308 + port,
        };
        count(&mut self.registers, counter);
    }

    /// Labels the frame in flight: what it writes into buffers of SyncManagers keeps the label.
    /// Call it once the frame is through and before it ends; a frame without a label has 0. No
    /// register shows labels, and they change nothing.
    pub fn label_frame(&mut self, label: u64) {
        self.flight.label = label;
    }

    /// Labels what the PDI writes into buffers of SyncManagers from now on.
    pub fn label_pdi(&mut self, label: u64) {
        self.sync_managers.pdi_label = label;
    }

    /// The label of what was last read, or is being read, from the buffer of a SyncManager (0 to
    /// 15), by whichever side reads it; 0 if nothing was, or if it has none.
    pub fn label(&self, sync_manager: u8) -> u64 {
        self.sync_managers.label(usize::from(sync_manager))
    }

    /// When the next own event is due, or an instant before: [`step`](Self::step) lets it happen then, or finds out when it really
    /// is due. Never, if nothing is.
    #[inline]
    pub fn next_event(&self) -> Time<Device> {
        match self.overdue {
            Some((at, _)) => at,
            // The time of `earliest`, which is asked for much more often than what is due then.
            None => {
                let next = (self.flight.end.min(self.dc.sync.due()))
                    .min(self.watchdog.due().min(self.pdi_watchdog.due()))
                    .min(self.eeprom.due().min(self.ports.due()))
                    .min(self.dc.latch.due().min(self.mii.due()));
                debug_assert_eq!(next, self.earliest().0, "the same units are asked");
                next
            }
        }
    }

    /// Handles the earliest own event at or before `limit` and names it; `None` when none is left.
    pub fn step(&mut self, limit: Time<Device>) -> Option<(Time<Device>, EscEvent)> {
        loop {
            if self.overdue.is_some_and(|(at, _)| at <= limit) {
                return self.overdue.take();
            }
            let at = self.next_event();
            if at > limit || at == Time::NEVER {
                return None;
            }
            // What comes in every cycle is asked for first.
            let due = match at {
                _ if at == self.flight.end => Due::FrameEnd,
                _ if at == self.dc.sync.due() => Due::Sync,
                _ => self.earliest().1,
            };
            if let Some(event) = self.handle(due) {
                return Some((at, event));
            }
        }
    }

    /// The local CPU is at work at `now` and accesses nothing: what [`pdi`](Self::pdi) does by itself.
    #[inline]
    pub fn note_pdi(&mut self, now: Time<Device>) {
        self.pdi(now);
    }

    /// The local CPU's access at `now`.
    #[inline]
    pub fn pdi(&mut self, now: Time<Device>) -> EscPdi<'_, M> {
        self.settle(now);
        EscPdi::new(self, now)
    }

    /// SYNC0 and SYNC1 pulses since power-on or reset that made no edge, because the signal was still active from the
    /// pulse before: not acknowledged yet (0x0982 is 0), or longer than its cycle. Wraps.
    pub const fn sync_pulses_without_edge(&self) -> [u32; 2] {
        self.dc.sync.without_edge()
    }

    /// The AL event request (0x0220) at `now`.
    pub fn al_events(&self, now: Time<Device>) -> u32 {
        self.own_al_events()
            | self.dc.sync.al_events(now, &self.registers)
            | self.dc.latch.al_events(&self.registers)
    }

    /// Whether the interrupt line to the local CPU is active: an AL event that its mask (0x0204) lets
    /// through. The mask does not touch the request.
    pub fn interrupt(&self, now: Time<Device>) -> bool {
        self.al_events(now) & self.register(register::AL_EVENT_MASK) != 0
    }

    /// The AL events that frames and the PDI cause, the latch unit's apart.
    pub(crate) fn own_al_events(&self) -> u32 {
        self.al.events() | self.sync_managers.al_events() | self.eeprom.al_events()
    }

    /// The ECAT event request (0x0210), whatever its mask.
    pub fn ecat_event_request(&self) -> u16 {
        self.ecat_events()
    }

    /// A register's value in force, without the side effects of a read. Times that run (0x0910,
    /// 0x0990...) are as the last access left them.
    pub fn register<T: Value>(&self, register: Register<T>) -> T {
        self.registers.load(register)
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

    /// Registers and user RAM, 0x0000-0x0FFF, as they are in force; see [`Self::register`].
    pub fn registers(&self) -> [u8; register::PROCESS_RAM as usize] {
        core::array::from_fn(|address| self.registers.byte(address as u16))
    }

    /// Process RAM from 0x1000 on, all buffers of SyncManagers included; where it grows with its use, as far as it was used.
    pub fn ram(&self) -> &[u8] {
        let ram = self.ram.as_ref();
        &ram[..self.ram_len.min(ram.len())]
    }

    /// The EEPROM image with everything written to it.
    pub fn eeprom(&self) -> &[u8] {
        self.image.as_ref()
    }

    /// The same for somebody who programs the memory past the ESC. What the ESC has loaded from it
    /// stays.
    pub fn eeprom_mut(&mut self) -> &mut [u8] {
        self.image.as_mut()
    }

    /// When the last frame is over: when its effects come into force, if they have not yet, else when it arrived.
    pub fn last_frame(&self) -> Time<Device> {
        let Flight { start, end, .. } = self.flight;
        if end == Time::NEVER { start } else { end }
    }

    /// The memory behind the ESC acknowledges nothing from now on (broken, or without supply), or does so again. Each
    /// command ends with the missing acknowledge of register 0x0502 bit 13; at a reset or power-on nothing is loaded.
    pub fn set_eeprom_dead(&mut self, dead: bool) {
        self.eeprom_is_dead = dead;
    }

    /// The image, as far as the memory can be read.
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

    /// The first instant at or after `from`, on its tick, at which the system time has reached
    /// `system`; half the counter's range back counts as reached.
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

    /// Applies the end of the frame in flight if it is over, whoever forgot to `step` to it.
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

    /// Starts a reset sequence or goes on with it; `side` 0 is ECAT, 1 the PDI.
    /// Returns whether it is complete and everything is at its beginning.
    pub(crate) fn advance_reset(&mut self, side: usize, written: u8, now: Time<Device>) -> bool {
        let progress = usize::from(self.reset_progress[side]);
        self.reset_progress[side] = if RESET_SEQUENCE[progress] == written {
            progress as u8 + 1
        } else {
            u8::from(RESET_SEQUENCE[0] == written)
        };
        // Frames or accesses in between that leave the register alone do not break the sequence.
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

    fn handle(&mut self, due: Due) -> Option<EscEvent> {
        match due {
            Due::FrameEnd => Some(self.end_frame()),
            Due::Sync => self.dc.fire(&self.registers).map(|output| match output {
                Output::Sync0 => EscEvent::Sync0,
                Output::Sync1 => EscEvent::Sync1,
            }),
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

    /// Notes the local time of something that happened to a buffer, in 0x09F0, 0x09F8 or 0x09FC.
    pub(crate) fn latch_buffer_time(&mut self, time: Register<u32>, at: Time<Device>) {
        let local = self.dc.local_time(at).count();
        self.registers.store(time, local as u32);
    }

    /// Whether process RAM answers: the EEPROM was loaded.
    pub(crate) fn is_operational(&self) -> bool {
        self.dl_status().0 & DlStatus::PDI_OPERATIONAL != 0
    }

    /// Whether a circulating frame is to be stopped here.
    pub(crate) fn stops_circulating(&self) -> bool {
        self.ports.stops_circulating(&self.registers)
    }

    /// A buffer that triggers the watchdog was completed.
    pub(crate) fn trigger_watchdog(&mut self, now: Time<Device>) {
        self.watchdog.restart(now);
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

/// RAM grows by this many bytes.
const RAM_GRAIN: usize = 256;

/// Adds one to a counter that stays at 0xFF.
pub(crate) fn count(registers: &mut Registers, address: u16) {
    let value = registers.byte(address).saturating_add(1);
    registers.set_byte(address, value);
}

/// ECAT event request bits.
pub(crate) const ECAT_DL_STATUS: u16 = 1 << 2;
pub(crate) const ECAT_AL_STATUS: u16 = 1 << 3;
/// Written one after the other to 0x0040 or 0x0041, these reset the ESC.
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
/// Register 0x0140: digital I/O. No CPU has to show that it lives: DL status bit 1 reads 1
/// (captured on three kinds of terminals).
pub(crate) const PDI_DIGITAL_IO: u8 = 0x04;
/// Register 0x014E: the configuration area is loaded, the PDI is active.
const PDI_INFORMATION_LOADED: u16 = 0x0006;
/// Register 0x014E: see [`Chip::acknowledge_by_write`].
const PDI_INFORMATION_ACKNOWLEDGE_BY_WRITE: u16 = 0x0001;
