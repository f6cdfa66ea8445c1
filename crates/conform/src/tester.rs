//! Access to one SubDevice under test: registers, states and the cyclic exchange, call by call.
//!
//! While an exchange runs, all other frames are sent between two cycles.

use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register::{self, Register, Value};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{
    AlControl, AlState, AlStatus, AlStatusCode, AutoIncrementAddress, Command, StationAddress,
};

use isocat_segment::profile::Origin;

use super::mailbox::Mailbox;
use super::report::Examined;
use super::subject::Hints;
use super::wire::{Seen, Wire};

/// What went wrong, in words that name the place.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Trouble {
    /// The description.
    pub what: String,
    /// The cause.
    pub fault: Fault,
}

/// The cause of a [`Trouble`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fault {
    /// The SubDevice answers wrongly or not at all.
    SubDevice,
    /// Frames were lost on a real wire: either end may be the cause.
    Frames,
    /// This machine can't send or receive: nothing more can be tried.
    Machine,
    /// The user stopped the suite: nothing more is to be tried.
    Stopped,
}

impl Trouble {
    /// Trouble with the SubDevice.
    pub fn new(what: impl Into<String>) -> Self {
        Self { what: what.into(), fault: Fault::SubDevice }
    }

    /// Whether no further rule can be tried.
    pub fn ends_all(&self) -> bool {
        matches!(self.fault, Fault::Machine | Fault::Stopped)
    }
}

/// Faults of frames that are not the SubDevice's.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Disturbance {
    /// The largest lateness of a frame of the exchange, if it is above the allowed one; else 0.
    pub late: Nanos,
    /// Frames that did not come back in time.
    pub lost: u32,
}

impl std::fmt::Display for Disturbance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let frames = if self.lost == 1 { "frame was" } else { "frames were" };
        match (self.lost, self.late) {
            (0, late) => write!(f, "this machine sent frames up to {late} late"),
            (lost, Nanos::ZERO) => write!(f, "{lost} {frames} lost or came back too late"),
            (lost, late) => write!(
                f,
                "{lost} {frames} lost or came back too late, and this machine sent frames up to {late} late"
            ),
        }
    }
}

/// The state that the SubDevice reports.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Al {
    /// The state and the error indication.
    pub status: AlStatus,
    /// The reason of the error indication.
    pub code: AlStatusCode,
}

impl Al {
    /// Whether it is in this state without an error.
    pub fn is(&self, state: AlState) -> bool {
        self.status.state() == Ok(state) && !self.status.error()
    }
}

impl std::fmt::Display for Al {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.status.error() || self.code != AlStatusCode::NO_ERROR {
            true => write!(f, "{}, code {}", self.status, self.code),
            false => write!(f, "{}", self.status),
        }
    }
}

/// A SubDevice and the connection to it.
pub struct Tester<'w> {
    wire: &'w mut dyn Wire,
    position: u16,
    index: u8,
    /// The running exchange of process data.
    pub exchange: Option<Exchange>,
    /// Its mailbox, after PREOP was requested.
    pub mailbox: Mailbox,
    no_lrw: bool,
    wide_clock: bool,
    /// Faults of frames since they were last asked for.
    disturbance: Disturbance,
    /// Whether the SubDevice has registers 0x0980 and following, by the last
    /// [`restart`](Self::restart).
    pub has_sync_unit: bool,
    /// Frames are sent although the user stopped the suite, to leave the SubDevice in INIT.
    leaving: bool,
}

/// The cyclic exchange of process data.
#[derive(Clone, Debug)]
pub struct Exchange {
    /// Its cycle.
    pub cycle: Nanos,
    /// Outputs that each frame carries.
    pub outputs: Vec<u8>,
    /// Inputs of the last frame that came back.
    pub inputs: Vec<u8>,
    /// Number of bytes of inputs.
    pub input_len: usize,
    /// With DC: the instants of SYNC0, and how long before them frames pass.
    pub grid: Option<Grid>,
    /// Cycles so far, including those without a frame.
    pub cycles: u64,
    /// Frames that came back with a wrong working counter.
    pub wrong_counters: u64,
    /// The last wrong working counter, and the right one.
    pub wrong_counter: Option<(u16, u16)>,
    /// State at the last frame.
    pub al: Al,
    /// When cycle 0 is due, without DC.
    origin: Time<Host>,
    /// A host time and the system time at the same instant.
    pair: Option<(Time<Host>, u64)>,
}

/// The instants of SYNC0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Grid {
    /// System time of the first SYNC0, ns.
    pub start: u64,
    /// How long before each SYNC0 its frame passes the SubDevice.
    pub lead: Nanos,
}

/// The frames of one cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Turn {
    /// One frame, when it is due.
    Send,
    /// No frame.
    Skip,
    /// Two frames: the second one right after the first.
    Twice,
}

impl<'w> Tester<'w> {
    /// Connects to the SubDevice at this position, without changing it.
    pub fn new(wire: &'w mut dyn Wire, position: u16) -> Self {
        Self {
            wire,
            position,
            index: 0,
            exchange: None,
            mailbox: Mailbox::default(),
            no_lrw: false,
            wide_clock: true,
            disturbance: Disturbance::default(),
            has_sync_unit: false,
            leaving: false,
        }
    }

    /// Whether the ESC answers AL control itself. Addresses by position, because this comes before
    /// all else.
    pub fn has_device_emulation(&mut self) -> Result<bool, Trouble> {
        let at = AutoIncrementAddress::of_position(self.position);
        let address = Address::Position(at, register::ESC_CONFIGURATION.address);
        Ok(self.one(Command::Aprd, address, &[0], 1)?[0] & 1 != 0)
    }

    /// Restarts the SubDevice. It is as after power-on if the wire can do that; else in INIT, with
    /// its SYNC unit off and its SyncManagers and FMMUs closed.
    pub fn restart(&mut self) -> Result<(), Trouble> {
        self.wire.restart();
        self.exchange = None;
        self.mailbox = Mailbox::default();
        self.set_broadcast(
            register::AL_CONTROL,
            AlControl::request_and_acknowledge(AlState::Init),
        )?;
        let at = AutoIncrementAddress::of_position(self.position);
        let address = Address::Position(at, register::STATION_ADDRESS.address);
        self.one(Command::Apwr, address, &STATION.0.to_le_bytes(), 1)?;
        let end = self.now() + STATE_PATIENCE;
        while !self.al()?.is(AlState::Init) {
            if self.now() > end {
                return Err(Trouble::new(format!("INIT is not reached: {}", self.al()?)));
            }
            self.pause(Nanos::millis(1))?;
        }
        let features = self.register(register::FEATURES)?;
        self.no_lrw = features & register::features::NO_LRW != 0;
        self.wide_clock = features & register::features::DC_64_BIT != 0;
        // An ESC with a clock need not have a SYNC unit: bit 10 of word 0 of its EEPROM switches it
        // on.
        self.has_sync_unit = features & register::features::DC != 0
            && self.offer(register::CYCLIC_UNIT_CONTROL.address, &[0, 0])?;
        let (fmmus, sms) =
            (self.register(register::FMMU_COUNT)?, self.register(register::SM_COUNT)?);
        for number in 0..usize::from(fmmus.min(16)) {
            self.write(register::fmmu(number).address, &[0; 16])?;
        }
        for number in 0..usize::from(sms.min(16)) {
            self.write(register::sync_manager(number).address, &[0; 8])?;
        }
        Ok(())
    }

    /// Returns to INIT at the end, even if the user stopped the suite.
    pub fn leave(&mut self) -> Result<(), Trouble> {
        self.leaving = true;
        self.restart()
    }

    /// The number of SubDevices that answer.
    pub fn count(&mut self) -> Result<u16, Trouble> {
        let address = Address::Broadcast(register::AL_STATUS.address);
        let mut list = [(Command::Brd, address, vec![0; 2], 0)];
        self.transact(&mut list)?;
        Ok(list[0].3)
    }

    /// The host's clock.
    pub fn now(&self) -> Time<Host> {
        self.wire.now()
    }

    /// Events in the SubDevice since the last call; `None` on a real wire.
    pub fn seen(&mut self) -> Option<Vec<Seen>> {
        self.wire.seen(usize::from(self.position))
    }

    /// How late frames may leave.
    pub fn lateness(&self) -> Nanos {
        self.wire.lateness()
    }

    /// Faults of frames since the last call; `None`: there were none, or time is virtual, where
    /// losses belong to the segment.
    pub fn disturbance(&mut self) -> Option<Disturbance> {
        let mut found = std::mem::take(&mut self.disturbance);
        let allowed = self.lateness();
        if found.late <= allowed {
            found.late = Nanos::ZERO;
        }
        (!self.is_virtual() && found != Disturbance::default()).then_some(found)
    }

    /// What the suite examines, by what is known of it.
    pub fn examined(&self, hints: &Hints) -> Examined {
        match hints.stand_in {
            _ if !self.is_virtual() => Examined::Interface,
            Some(Origin::Description) => Examined::SimulatedDescription,
            Some(Origin::Profile) | None => Examined::SimulatedProfile,
        }
    }

    /// Whether every frame leaves and arrives exactly at its instant.
    fn is_virtual(&self) -> bool {
        self.lateness() == Nanos::ZERO
    }

    /// Waits; if it takes longer, the lateness is this machine's fault.
    fn wait_until(&mut self, at: Time<Host>) {
        self.wire.wait_until(at);
        self.note_late(self.now() - at);
    }

    fn note_late(&mut self, late: Nanos) {
        self.disturbance.late = self.disturbance.late.max(late);
    }

    /// Reads bytes of the ESC's memory.
    pub fn read(&mut self, address: u16, len: usize) -> Result<Vec<u8>, Trouble> {
        self.one(Command::Fprd, Address::Station(STATION, address), &vec![0; len], 1)
    }

    /// Writes bytes of the ESC's memory.
    pub fn write(&mut self, address: u16, data: &[u8]) -> Result<(), Trouble> {
        self.one(Command::Fpwr, Address::Station(STATION, address), data, 1).map(|_| ())
    }

    /// Writes bytes that the SubDevice may refuse; returns whether it accepted them.
    pub fn offer(&mut self, address: u16, data: &[u8]) -> Result<bool, Trouble> {
        let mut list = [(Command::Fpwr, Address::Station(STATION, address), data.to_vec(), 0)];
        self.transact(&mut list)?;
        Ok(list[0].3 == 1)
    }

    /// Reads a register.
    pub fn register<T: Value>(&mut self, register: Register<T>) -> Result<T, Trouble> {
        let bytes = self.read(register.address, T::LEN)?;
        let mut value = T::Bytes::default();
        value.as_mut().copy_from_slice(&bytes);
        Ok(T::from_bytes(value))
    }

    /// Writes a register.
    pub fn set<T: Value>(&mut self, register: Register<T>, value: T) -> Result<(), Trouble> {
        self.write(register.address, value.to_bytes().as_ref())
    }

    /// Sets up a SyncManager; switches it off first, because it takes no other settings while it is
    /// on.
    pub fn set_sync_manager(&mut self, number: usize, sm: SyncManager) -> Result<(), Trouble> {
        self.set(register::sm_activate(number), 0)?;
        self.set(register::sync_manager(number), sm)
    }

    fn set_broadcast<T: Value>(&mut self, register: Register<T>, value: T) -> Result<(), Trouble> {
        let address = Address::Broadcast(register.address);
        let mut list = [(Command::Bwr, address, value.to_bytes().as_ref().to_vec(), 0)];
        self.transact(&mut list)
    }

    /// Reads the state that it reports.
    pub fn al(&mut self) -> Result<Al, Trouble> {
        Ok(al(&self.read(register::AL_STATUS.address, AL_LEN)?))
    }

    /// Requests a state, without waiting for it.
    pub fn request(&mut self, control: AlControl) -> Result<(), Trouble> {
        self.set(register::AL_CONTROL, control)
    }

    /// Requests a state and waits until it is reached, refused, or `patience` is over.
    pub fn change(&mut self, state: AlState, patience: Nanos) -> Result<Al, Trouble> {
        self.request(AlControl::request(state))?;
        self.await_state(state, patience)
    }

    /// Waits until a state is reached, an error shows, or `patience` is over.
    pub fn await_state(&mut self, state: AlState, patience: Nanos) -> Result<Al, Trouble> {
        let end = self.now() + patience;
        loop {
            let al = self.al()?;
            if al.is(state) || al.status.error() || self.now() > end {
                return Ok(al);
            }
            self.pause(Nanos::micros(500))?;
        }
    }

    /// Acknowledges the error in the present state of the SubDevice.
    pub fn acknowledge(&mut self) -> Result<Al, Trouble> {
        let al = self.al()?;
        let state = al.status.state().map_err(|e| Trouble::new(format!("AL status: {e}")))?;
        self.request(AlControl::request_and_acknowledge(state))?;
        let end = self.now() + Nanos::millis(100);
        loop {
            let al = self.al()?;
            if al.is(state) || self.now() > end {
                return Ok(al);
            }
            self.pause(Nanos::micros(500))?;
        }
    }

    /// Its system time, ns; of a 32-bit clock, the low 32 bits.
    pub fn system_time(&mut self) -> Result<u64, Trouble> {
        let len = if self.wide_clock { 8 } else { 4 };
        Ok(number(&self.read(register::SYSTEM_TIME.address, len)?))
    }

    /// Sets up the SYNC unit and switches it on, so that the first SYNC0 comes `lead_in` from now
    /// or slightly later. Returns the system time of that SYNC0.
    pub fn start_sync(
        &mut self,
        activation: u8,
        cycles: (u32, u32),
        lead_in: Nanos,
    ) -> Result<u64, Trouble> {
        self.write(register::CYCLIC_UNIT_CONTROL.address, &[0, 0])?;
        let registers = [cycles.0.to_le_bytes(), cycles.1.to_le_bytes()].concat();
        self.write(register::SYNC0_CYCLE.address, &registers)?;
        let begun = self.now();
        let start = self.system_time()? + lead_in.0 as u64;
        let start = if self.wide_clock { start } else { start & u64::from(u32::MAX) };
        let len = if self.wide_clock { 8 } else { 4 };
        self.write(register::SYNC_START_TIME.address, &start.to_le_bytes()[..len])?;
        self.write(register::CYCLIC_UNIT_CONTROL.address, &[0, activation])?;
        // A start time that has passed before the unit is on is not what was requested.
        let took = self.now() - begun;
        if took >= lead_in {
            self.note_late(took);
        }
        Ok(start)
    }

    /// Begins a cyclic exchange; its first frame leaves at the next cycle.
    pub fn begin_exchange(&mut self, cycle: Nanos, lens: (usize, usize), grid: Option<Grid>) {
        let al = Al { status: AlStatus(0), code: AlStatusCode::NO_ERROR };
        self.exchange = Some(Exchange {
            cycle,
            outputs: vec![0; lens.0],
            inputs: vec![0; lens.1],
            input_len: lens.1,
            grid,
            cycles: 0,
            wrong_counters: 0,
            wrong_counter: None,
            al,
            origin: self.now() + cycle,
            pair: None,
        });
    }

    /// Lets `n` cycles pass.
    pub fn run(&mut self, n: u64) -> Result<(), Trouble> {
        (0..n).try_for_each(|_| self.turn(Turn::Send))
    }

    /// Lets one cycle pass.
    pub fn turn(&mut self, turn: Turn) -> Result<(), Trouble> {
        let Some(mut exchange) = self.exchange.take() else {
            return Err(Trouble::new("no exchange goes on"));
        };
        let result = self.pass(&mut exchange, turn);
        exchange.cycles += 1;
        self.exchange = Some(exchange);
        result
    }

    /// Lets time pass, with the exchange running.
    pub fn pause(&mut self, span: Nanos) -> Result<(), Trouble> {
        let end = self.now() + span;
        while self.due()?.is_some_and(|due| due <= end) {
            self.turn(Turn::Send)?;
        }
        self.wire.wait_until(end);
        Ok(())
    }

    /// Lets time pass without any frame; the exchange continues afterwards, at its own instants.
    pub fn silence(&mut self, span: Nanos) -> Result<(), Trouble> {
        let end = self.now() + span;
        while self.due()?.is_some_and(|due| due <= end) {
            self.turn(Turn::Skip)?;
        }
        // If it takes longer than wanted, more frames are left out.
        match self.exchange {
            Some(_) => self.wait_until(end),
            None => self.wire.wait_until(end),
        }
        Ok(())
    }

    /// When the next frame of the exchange is due.
    fn due(&mut self) -> Result<Option<Time<Host>>, Trouble> {
        let Some(mut exchange) = self.exchange.take() else { return Ok(None) };
        let due = self.instant(&mut exchange);
        self.exchange = Some(exchange);
        due.map(Some)
    }

    fn instant(&mut self, exchange: &mut Exchange) -> Result<Time<Host>, Trouble> {
        let cycles = exchange.cycles as i64;
        let Some(grid) = exchange.grid else {
            return Ok(exchange.origin + Nanos(cycles * exchange.cycle.0));
        };
        let (host, system) = match exchange.pair {
            Some(pair) => pair,
            None => {
                let host = self.now();
                let address = Address::Station(STATION, register::SYSTEM_TIME.address);
                let mut list = [(Command::Fprd, address, vec![0; self.clock_len()], 0)];
                self.send_list(&mut list)?;
                *exchange.pair.insert((host, number(&list[0].2)))
            }
        };
        let due = grid.start.wrapping_add((cycles * exchange.cycle.0 - grid.lead.0) as u64);
        let ahead = if self.wide_clock {
            due.wrapping_sub(system) as i64
        } else {
            i64::from((due as u32).wrapping_sub(system as u32) as i32)
        };
        let due = host + Nanos(ahead);
        // The grid began before the exchange: skips the cycles in the past.
        if exchange.cycles == 0 && due < self.now() {
            let late = self.now() - due;
            exchange.cycles = (late.0 / exchange.cycle.0 + 1) as u64;
            return self.instant(exchange);
        }
        Ok(due)
    }

    fn clock_len(&self) -> usize {
        if self.wide_clock { 8 } else { 4 }
    }

    fn pass(&mut self, exchange: &mut Exchange, turn: Turn) -> Result<(), Trouble> {
        let due = self.instant(exchange)?;
        self.wait_until(due);
        if turn == Turn::Skip {
            return Ok(());
        }
        let mut image = exchange.outputs.clone();
        image.resize(exchange.outputs.len().max(exchange.input_len), 0);
        let (out, inp) = (!exchange.outputs.is_empty(), exchange.input_len > 0);
        let mut list = Vec::new();
        let mut right = u16::from(inp);
        if out && inp && !self.no_lrw {
            list.push((Command::Lrw, Address::Logical(LOGICAL), image, 0));
            right += 2;
        } else {
            if out {
                let outputs = exchange.outputs.clone();
                list.push((Command::Lwr, Address::Logical(LOGICAL), outputs, 0));
                right += 1;
            }
            if inp {
                let inputs = vec![0; exchange.input_len];
                list.push((Command::Lrd, Address::Logical(LOGICAL), inputs, 0));
            }
        }
        let process_data = list.len();
        for (address, len) in [
            (register::SYSTEM_TIME.address, self.clock_len()),
            (register::AL_STATUS.address, AL_LEN),
        ] {
            list.push((Command::Fprd, Address::Station(STATION, address), vec![0; len], 0));
        }
        let sent = self.now();
        if turn == Turn::Twice {
            let second = list[..process_data].to_vec();
            self.send_lists(&mut [&mut list[..], &mut second.clone()[..]])?;
        } else {
            self.send_list(&mut list)?;
        }
        // Shows if this thread lost its processor between reading the clock and sending.
        if let Some(left) = self.wire.last_left() {
            self.note_late(left - due);
        }
        let found = list[..process_data].iter().map(|datagram| datagram.3).sum();
        if found != right && process_data > 0 {
            exchange.wrong_counters += 1;
            exchange.wrong_counter = Some((found, right));
        }
        if let Some(last) = list[..process_data].last().filter(|_| inp) {
            exchange.inputs = last.2[..exchange.input_len].to_vec();
        }
        exchange.pair = Some((sent, number(&list[process_data].2)));
        exchange.al = al(&list[process_data + 1].2);
        Ok(())
    }

    /// Sends one datagram, which `expected` SubDevices must take.
    fn one(
        &mut self,
        command: Command,
        address: Address,
        data: &[u8],
        expected: u16,
    ) -> Result<Vec<u8>, Trouble> {
        let mut list = [(command, address, data.to_vec(), 0)];
        self.transact(&mut list)?;
        let [(_, _, data, found)] = list;
        if found == expected {
            return Ok(data);
        }
        let place = match address {
            Address::Position(_, ado) | Address::Station(_, ado) | Address::Broadcast(ado) => {
                format!("register 0x{ado:04X}")
            }
            Address::Logical(at) => format!("logical address 0x{at:08X}"),
        };
        Err(Trouble::new(format!("{place}: working counter {found}, expected {expected}")))
    }

    /// Sends a frame between two cycles.
    fn transact(&mut self, list: &mut [Datagram]) -> Result<(), Trouble> {
        let bytes: usize = list.iter().map(|datagram| datagram.2.len() + 12).sum();
        let needs = Nanos(frame::duration_ns(bytes + 16) as i64) + TURNAROUND + self.lateness();
        let mut tries = 0;
        while let Some(due) = self.due()? {
            if due - self.now() >= needs || tries == MOST_CYCLES_WAITED {
                break;
            }
            tries += 1;
            self.turn(Turn::Send)?;
        }
        self.send_list(list)
    }

    fn send_list(&mut self, list: &mut [Datagram]) -> Result<(), Trouble> {
        self.send_lists(&mut [list])
    }

    /// Sends one frame for each list, one right after the other.
    fn send_lists(&mut self, lists: &mut [&mut [Datagram]]) -> Result<(), Trouble> {
        for attempt in 1.. {
            if self.wire.is_stopped() && !self.leaving {
                let what = "interrupted".to_owned();
                return Err(Trouble { what, fault: Fault::Stopped });
            }
            let mut frames = Vec::with_capacity(lists.len());
            for list in lists.iter() {
                frames.push(self.frame(list)?);
            }
            let own = |what| Trouble { what, fault: Fault::Machine };
            let back = self.wire.exchange(&mut frames).map_err(own)?;
            let lost = back.iter().filter(|came| !**came).count() as u32;
            if lost > 0 {
                self.disturbance.lost = self.disturbance.lost.saturating_add(lost);
                if attempt == MOST_ATTEMPTS {
                    let what = format!("{attempt} frames did not come back");
                    let fault = if self.is_virtual() { Fault::SubDevice } else { Fault::Frames };
                    return Err(Trouble { what, fault });
                }
                continue;
            }
            for (frame, list) in frames.iter().zip(lists.iter_mut()) {
                let payload = frame::payload(frame).map_err(|e| Trouble::new(e.to_string()))?;
                for (found, asked) in datagrams(payload).zip(list.iter_mut()) {
                    let found = found.map_err(|e| Trouble::new(e.to_string()))?;
                    asked.2.clear();
                    asked.2.extend_from_slice(found.data);
                    asked.3 = found.wkc;
                }
            }
            return Ok(());
        }
        Ok(())
    }

    fn frame(&mut self, list: &[Datagram]) -> Result<Vec<u8>, Trouble> {
        let mut frame = vec![0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut frame, SOURCE);
        for (command, address, data, _) in list {
            self.index = self.index.wrapping_add(1);
            writer.push(*command, self.index, *address, data).map_err(|_| {
                Trouble::new(format!("{} bytes do not fit into a frame", data.len()))
            })?;
        }
        let len = writer.finish();
        frame.truncate(len);
        Ok(frame)
    }
}

/// Command, address, data, working counter.
type Datagram = (Command, Address, Vec<u8>, u16);

fn al(bytes: &[u8]) -> Al {
    let word = |at: usize| number(bytes.get(at..at + 2).unwrap_or(&[])) as u16;
    Al { status: AlStatus(word(0)), code: AlStatusCode(word(4)) }
}

/// A little-endian number of up to eight bytes.
pub fn number(bytes: &[u8]) -> u64 {
    bytes.iter().take(8).rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

/// Station address of the SubDevice under test; no other one has it.
const STATION: StationAddress = StationAddress(0x7C0F);
/// Logical address of its process data.
pub const LOGICAL: u32 = 0x0001_0000;
/// Source address of the frames.
const SOURCE: [u8; 6] = [frame::LOCALLY_ADMINISTERED, 0, 0, 0, 0, 0xC0];
/// AL status, two reserved bytes, AL status code.
const AL_LEN: usize = 6;
/// Time from the last bit sent to the next frame, for cables and the SubDevices behind.
const TURNAROUND: Nanos = Nanos::micros(2);
/// Cycles after which a frame that does not fit between two cycles is sent anyway.
const MOST_CYCLES_WAITED: u32 = 3;
/// Attempts to send a frame: an occasional loss says nothing about the SubDevice.
const MOST_ATTEMPTS: u32 = 3;
const STATE_PATIENCE: Nanos = Nanos::millis(3_000);
