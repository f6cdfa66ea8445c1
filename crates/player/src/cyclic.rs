//! The cyclic exchange: sends the frames of the list unchanged, in the states that they name. It
//! allocates nothing while it runs.

use isocat_descriptions::start_up::{Address, CyclicDatagram, CyclicFrame};
use isocat_maindevice::Event;
use isocat_sync::phase::{Servo, Settings, State, Uncertainty};
use isocat_wire::Command;
use isocat_wire::al::AlState;
use isocat_wire::datagram::Layouts;
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::failure::Kind;
use crate::line::{SOURCE, wire_address};
use crate::tally::Tally;
use crate::wire::{Buffer, Sent, Wire};

/// The exchange, with its state.
pub(crate) struct Exchange {
    frames: Vec<CyclicFrame>,
    cycle: Nanos,
    /// The state of the MainDevice, which determines the datagrams to send.
    pub state: AlState,
    /// Follows the reference clock; `None` without one.
    servo: Option<Servo>,
    /// The state of the servo that was last reported.
    told: State,
    /// The last system time of the reference, to extend readings of 32 bits.
    last: Time<Dc>,
    due: Time<Host>,
    /// The system time at which the next cycle is due at the reference.
    grid: Time<Dc>,
    number: u64,
    longest: Nanos,
    /// Frames in flight.
    flights: Vec<Flight>,
    /// The last cycle with a fault.
    broken: Option<u64>,
    /// For each cyclic datagram of the list: whether its last working counter was wrong.
    wrong: Vec<bool>,
    /// The last cycle with a right drift datagram, and whether missing ones were reported.
    led: (u64, bool),
    /// The last AL status that the list's own broadcast read.
    pub al_status: Option<u16>,
    /// Number of consecutive cycles in which all working counters were right.
    pub complete: u64,
    pub counts: Counts,
    zeros: Box<Buffer>,
    outgoing: Box<Buffer>,
}

/// Counts of the exchange.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Cycles.
    pub cycles: u64,
    /// Frames that did not come back.
    pub lost: u64,
    /// Datagrams whose working counter was not the one that the list expects.
    pub wrong: u64,
    /// The expected and the found working counter of the first of them.
    pub first_wrong: Option<(u16, u16)>,
}

/// A frame in flight.
#[derive(Clone, Copy)]
struct Flight {
    index: u8,
    frame: usize,
    cycle: u64,
    at: Time<Host>,
    /// The system time at which it is due at the reference.
    grid: Time<Dc>,
    /// The state of the MainDevice when it was sent.
    state: AlState,
}

impl Exchange {
    /// An exchange that begins at `start`. `reference`: present system time of the reference clock;
    /// `None`: there is none. `stamp_noise`: how much too early time stamps usually are.
    pub fn new(
        frames: &[CyclicFrame],
        cycle: Nanos,
        start: Time<Host>,
        reference: Option<Time<Dc>>,
        stamp_noise: Nanos,
    ) -> Self {
        let datagrams = frames.iter().map(|frame| frame.datagrams.len()).sum();
        Self {
            frames: frames.to_vec(),
            cycle,
            state: AlState::PreOp,
            servo: reference.map(|_| Servo::new(Settings::new(cycle, stamp_noise))),
            told: State::Free,
            last: reference.unwrap_or(Time::ZERO),
            due: start,
            grid: Time::ZERO,
            number: 0,
            longest: Nanos::ZERO,
            flights: Vec::with_capacity(MOST_FLIGHTS),
            broken: None,
            wrong: vec![false; datagrams],
            led: (0, false),
            al_status: None,
            complete: 0,
            counts: Counts::default(),
            zeros: Box::new([0; frame::MAX_LEN]),
            outgoing: Box::new([0; frame::MAX_LEN]),
        }
    }

    /// When the next cycle is due.
    pub fn due(&self) -> Time<Host> {
        self.due
    }

    /// The longest time from the first bit of a frame until its last bit is back at the port. It is
    /// limited to a quarter of the cycle, because a stalled host would count as a long wire.
    pub fn longest_way(&self) -> Nanos {
        self.longest.min(Nanos(self.cycle.0 / 4))
    }

    /// How long a cycle waits for its own frames; later frames are still accepted.
    pub fn collecting(&self) -> Nanos {
        Nanos(self.cycle.0 / 4 * 3)
    }

    /// Whether frames of the present cycle are in flight.
    pub fn is_waiting(&self) -> bool {
        self.flights.iter().any(|flight| flight.cycle == self.number)
    }

    /// Whether the cycle is locked on the reference clock; true without a reference clock.
    pub fn is_locked(&self) -> bool {
        self.servo.as_ref().is_none_or(|servo| servo.state() == State::Locked)
    }

    /// The state of the servo, how much faster than the host's clock the reference runs (ppb), and
    /// the uncertainty of that. `None`: there is no reference clock.
    pub fn phase(&self) -> Option<(State, i64, Option<Uncertainty>)> {
        self.servo.as_ref().map(|servo| (servo.state(), servo.rate_ppb(), servo.uncertainty()))
    }

    /// The last phase error.
    pub fn phase_error(&self) -> Nanos {
        self.servo.as_ref().map_or(Nanos::ZERO, Servo::last_error)
    }

    /// Sends the frames of one cycle, which begins at `at`.
    pub fn begin(
        &mut self,
        wire: &mut dyn Wire,
        tally: &mut Tally,
        at: Time<Host>,
    ) -> Result<(), Kind> {
        self.number += 1;
        self.counts.cycles += 1;
        tally.statistics.cycles += 1;
        if let Some(servo) = &mut self.servo {
            servo.handle_timeout(at);
        }
        self.tell_of_clocks(at, tally);
        let slot = self.slot();
        let mut back = None;
        for number in 0..self.frames.len() {
            if slot.is_multiple_of(u64::from(self.frames[number].every.max(1)))
                && let Some(sent) = self.send(wire, tally, at, number)?
            {
                back = back.max(sent.back);
            }
        }
        if let Some(took) = back.map(|back| back - at).filter(|took| *took >= self.cycle) {
            return Err(Kind::CycleTooShort { took, cycle: self.cycle });
        }
        if !self.is_waiting() {
            self.complete += 1;
        }
        Ok(())
    }

    /// Reports changes of the lock on the reference clock, and clocks that no drift datagram leads.
    fn tell_of_clocks(&mut self, at: Time<Host>, tally: &mut Tally) {
        let Some(servo) = &self.servo else { return };
        let (state, cycle) = (servo.state(), self.number);
        if state != self.told {
            self.told = state;
            tally.tell(at, Event::Phase { cycle, state });
        }
        let (led, told) = self.led;
        let unled = cycle.saturating_sub(led);
        if (unled > UNLED_CYCLES) != told {
            self.led.1 = !told;
            tally.tell(at, Event::ClocksUnled { cycles: if told { 0 } else { unled } });
        }
    }

    /// The number of the bus cycle: by system time, like SYNC pulses; without a reference, the
    /// count of cycles.
    fn slot(&self) -> u64 {
        match &self.servo {
            Some(servo) => {
                (servo.dc_at(self.due).count() + self.cycle.0 as u64 / 2) / self.cycle.0 as u64
            }
            None => self.number,
        }
    }

    /// Sends the datagrams of a frame that belong to the present state; `None`: there are none.
    fn send(
        &mut self,
        wire: &mut dyn Wire,
        tally: &mut Tally,
        at: Time<Host>,
        number: usize,
    ) -> Result<Option<Sent>, Kind> {
        let state = self.state;
        if !self.frames[number].datagrams.iter().any(|one| is_sent(one, state)) {
            return Ok(None);
        }
        let index = tally.index();
        let guess = self.servo.as_ref().map_or(0, |servo| servo.dc_at(at).count()).to_le_bytes();
        let mut writer = FrameWriter::new(&mut self.outgoing[..], SOURCE);
        for datagram in self.frames[number].datagrams.iter().filter(|one| is_sent(one, state)) {
            let length = usize::from(datagram.length);
            // The reference replaces this time by its own.
            let data = match is_drift(datagram) && length <= guess.len() {
                true => &guess[..length],
                false => &self.zeros[..length.min(frame::MAX_LEN)],
            };
            let address = wire_address(datagram.command, datagram.address);
            let pushed = writer.push(datagram.command, index, address, data);
            pushed.map_err(|_| Kind::FrameTooLong { frame: number })?;
            tally.statistics.datagrams += 1;
            tally.statistics.drift_frames += u64::from(is_drift(datagram));
        }
        let length = writer.finish();
        let sent = wire.send(at, &self.outgoing[..length])?;
        tally.statistics.frames_sent += 1;
        if self.flights.len() == MOST_FLIGHTS {
            let oldest = self.flights.remove(0);
            self.lose(oldest, at, tally);
        }
        let (cycle, grid) = (self.number, self.grid);
        self.flights.push(Flight { index, frame: number, cycle, at: sent.at, grid, state });
        Ok(Some(sent))
    }

    /// Takes a frame that came in; returns whether it belongs to the exchange.
    pub fn take(&mut self, index: u8, bytes: &[u8], now: Time<Host>, tally: &mut Tally) -> bool {
        let Some(place) = self.flights.iter().position(|flight| flight.index == index) else {
            return false;
        };
        let flight = self.flights.remove(place);
        let Ok(payload) = frame::payload(bytes) else { return false };
        let before: usize =
            self.frames[..flight.frame].iter().map(|frame| frame.datagrams.len()).sum();
        let mut layouts = Layouts::new();
        for which in 0..self.frames[flight.frame].datagrams.len() {
            if !is_sent(&self.frames[flight.frame].datagrams[which], flight.state) {
                continue;
            }
            let found = layouts.next(payload).and_then(Result::ok);
            let found = found.map(|layout| {
                let counter = payload[layout.wkc()..].first_chunk().copied();
                (
                    &payload[layout.data()..layout.wkc()],
                    u16::from_le_bytes(counter.unwrap_or_default()),
                )
            });
            self.look(flight, (which, before + which), found, now, tally);
        }
        let is_last = !self.flights.iter().any(|other| other.cycle == flight.cycle);
        if is_last && self.broken != Some(flight.cycle) {
            self.complete += 1;
        }
        true
    }

    /// Checks a datagram that came back, by data and working counter. `number`: in its frame, and
    /// in the list.
    fn look(
        &mut self,
        flight: Flight,
        (number, of_all): (usize, usize),
        found: Option<(&[u8], u16)>,
        now: Time<Host>,
        tally: &mut Tally,
    ) {
        let datagram = &self.frames[flight.frame].datagrams[number];
        let (data, counter) = found.unwrap_or((&[], 0));
        let (cycle, is_drift) = (flight.cycle, is_drift(datagram));
        let expected = datagram.working_counter.filter(|expected| *expected != counter);
        if is_state_watch(datagram) && counter > 0 {
            self.al_status = data.first_chunk().map(|bytes| u16::from_le_bytes(*bytes));
        }
        if let Some(expected) = expected {
            self.broken = Some(cycle);
            self.complete = 0;
            self.counts.wrong += 1;
            self.counts.first_wrong.get_or_insert((expected, counter));
            tally.statistics.working_counter_errors += 1;
            if !self.wrong[of_all] {
                let found = counter;
                tally.tell(
                    now,
                    match is_drift {
                        true => Event::Drift { cycle, expected, found },
                        false => Event::WorkingCounter { cycle, chunk: of_all, expected, found },
                    },
                );
            }
        }
        self.wrong[of_all] = expected.is_some();
        if !is_drift || counter == 0 {
            return;
        }
        if expected.is_none() {
            self.led.0 = self.led.0.max(cycle);
        }
        if let (Some(servo), Some(low)) = (&mut self.servo, data.first_chunk()) {
            let found = extend(u32::from_le_bytes(*low), self.last);
            self.last = found;
            servo.sample(flight.at, found);
            if flight.state == AlState::Op {
                tally.statistics.phase_error.add(found - flight.grid);
            }
        }
    }

    /// Ends the cycle that began at `at` and plans the next one. Frames in flight for `patience` or
    /// longer are lost.
    pub fn end(&mut self, at: Time<Host>, now: Time<Host>, patience: Nanos, tally: &mut Tally) {
        if !self.is_waiting() {
            self.longest = self.longest.max(now - at);
        }
        while let Some(place) = self.flights.iter().position(|one| now - one.at >= patience) {
            let lost = self.flights.remove(place);
            self.lose(lost, now, tally);
        }
        let (before, was_due) = (self.grid, self.due);
        let skipped = match &self.servo {
            Some(servo) => {
                let earliest = at + Nanos(self.cycle.0 / 2);
                self.grid += self.cycle;
                self.due = servo.host_at(self.grid);
                // The next cycle is due when its frame finds the reference clock at phase 0.
                if !(0..self.cycle.0).contains(&(self.due - earliest).0) {
                    self.grid = servo.next_grid(earliest, self.cycle, Nanos::ZERO);
                    self.due = servo.host_at(self.grid).max(earliest);
                }
                ((self.grid - before).0 - self.cycle.0 / 2) / self.cycle.0
            }
            None => {
                self.due += self.cycle;
                let skipped = ((now - self.due).0 / self.cycle.0).max(0);
                self.due += Nanos(self.cycle.0 * skipped);
                skipped
            }
        };
        if skipped > 0 && self.state == AlState::Op {
            let (late, skipped) = (now.max(at) - was_due, skipped as u64);
            tally.statistics.cycles_skipped += skipped;
            tally.tell(now, Event::CyclesSkipped { cycle: self.number + 1, late, skipped });
        }
    }

    fn lose(&mut self, flight: Flight, now: Time<Host>, tally: &mut Tally) {
        let Flight { cycle, frame, .. } = flight;
        self.broken = Some(cycle);
        self.complete = 0;
        self.counts.lost += 1;
        tally.statistics.frames_lost += 1;
        tally.tell(now, Event::FrameLost { cycle, frame });
    }
}

/// Whether a datagram is sent in this state of the MainDevice.
fn is_sent(datagram: &CyclicDatagram, state: AlState) -> bool {
    datagram.states.is_empty() || datagram.states.contains(&state)
}

/// Whether a datagram reads the AL status of all devices.
fn is_state_watch(datagram: &CyclicDatagram) -> bool {
    let at = matches!(datagram.address, Address::Physical { register, .. } if register == register::AL_STATUS.address);
    datagram.command == Command::Brd && at
}

/// Whether a datagram reads the system time of one clock and writes it to those after it.
pub(crate) fn is_drift(datagram: &CyclicDatagram) -> bool {
    matches!(datagram.command, Command::Armw | Command::Frmw) && is_system_time(datagram.address)
}

/// Whether a datagram writes the host's time to a clock.
pub(crate) fn is_lead(datagram: &CyclicDatagram) -> bool {
    let writes = matches!(datagram.command, Command::Apwr | Command::Fpwr | Command::Bwr);
    writes && is_system_time(datagram.address)
}

fn is_system_time(address: Address) -> bool {
    matches!(address, Address::Physical { register, .. } if register == register::SYSTEM_TIME.address)
}

/// The time with these low bits that is nearest to `last`.
pub(crate) fn extend(low: u32, last: Time<Dc>) -> Time<Dc> {
    last + Nanos(i64::from(low.wrapping_sub(last.count() as u32) as i32))
}

/// Largest number of frames in flight: their indices have one byte.
const MOST_FLIGHTS: usize = 200;
/// Cycles without a drift datagram that reached all clocks, after which 0x092C is no longer
/// meaningful.
const UNLED_CYCLES: u64 = 100;
