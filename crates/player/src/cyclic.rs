//! The cyclic exchange: the frames of the list as they stand, in the states that they name.

use isocat_descriptions::start_up::{Address, CyclicDatagram, CyclicFrame};
use isocat_sync::phase::{Servo, Settings, State};
use isocat_wire::Command;
use isocat_wire::al::AlState;
use isocat_wire::datagram::WKC_LEN;
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::failure::Kind;
use crate::line::{Line, SOURCE, wire_address};

/// The exchange and its state.
pub(crate) struct Exchange {
    frames: Vec<CyclicFrame>,
    cycle: Nanos,
    /// The state of the MainDevice: it says which datagrams are sent.
    pub state: AlState,
    /// Follows the reference clock; `None` without one.
    servo: Option<Servo>,
    /// The last system time of the reference, to extend readings of 32 bits.
    last: Time<Dc>,
    due: Time<Host>,
    /// The system time that the next cycle is to find at the reference.
    grid: Time<Dc>,
    number: u64,
    longest: Nanos,
    /// Cycles in a row in which all datagrams counted right.
    pub complete: u64,
    pub counts: Counts,
}

/// What was counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Cycles.
    pub cycles: u64,
    /// Frames that did not come back.
    pub lost: u64,
    /// Datagrams that did not count as the list expects.
    pub wrong: u64,
    /// What the first of those expected, and what was found.
    pub first_wrong: Option<(u16, u16)>,
}

/// A frame under way.
struct Sent {
    frame: usize,
    /// Datagrams of the list, by number, with the place of their data in the frame.
    datagrams: Vec<(usize, usize)>,
    back: Option<Time<Host>>,
}

impl Exchange {
    /// An exchange that begins at `start`. `reference`: its system time now; `None` without a reference clock.
    pub fn new(
        frames: &[CyclicFrame],
        cycle: Nanos,
        start: Time<Host>,
        reference: Option<Time<Dc>>,
    ) -> Self {
        Self {
            frames: frames.to_vec(),
            cycle,
            state: AlState::PreOp,
            servo: reference.map(|_| Servo::new(Settings::new(cycle, Nanos::ZERO))),
            last: reference.unwrap_or(Time::ZERO),
            due: start,
            grid: Time::ZERO,
            number: 0,
            longest: Nanos::ZERO,
            complete: 0,
            counts: Counts::default(),
        }
    }

    /// When the next cycle is due.
    pub fn due(&self) -> Time<Host> {
        self.due
    }

    /// The longest time from the first bit of a frame to its last bit back at the port.
    pub fn longest_way(&self) -> Nanos {
        self.longest
    }

    /// Whether the cycle is in step with the reference clock; without one there is nothing to be in step with.
    pub fn is_locked(&self) -> bool {
        self.servo.as_ref().is_none_or(|servo| servo.state() == State::Locked)
    }

    /// The last phase error.
    pub fn phase_error(&self) -> Nanos {
        self.servo.as_ref().map_or(Nanos::ZERO, Servo::last_error)
    }

    /// Sends the frames of one cycle from `at` on, and takes what comes back.
    pub fn run(&mut self, line: &mut Line, at: Time<Host>) -> Result<(), Kind> {
        self.number += 1;
        self.counts.cycles += 1;
        let slot = self.slot();
        let mut sent = Vec::new();
        for number in 0..self.frames.len() {
            if slot.is_multiple_of(u64::from(self.frames[number].every.max(1))) {
                sent.extend(self.send(line, at, number)?);
            }
        }
        let end = sent.iter().filter_map(|one| one.back).max().unwrap_or(at).max(line.now());
        line.bus.advance(end)?;
        if end - at >= self.cycle {
            return Err(Kind::CycleTooShort { took: end - at, cycle: self.cycle });
        }
        self.longest = self.longest.max(end - at);
        let mut right = true;
        for one in &sent {
            right &= self.receive(line, one, at);
        }
        self.complete = if right { self.complete + 1 } else { 0 };
        self.plan_next(at);
        Ok(())
    }

    /// The number of the bus cycle: by system time, as SYNC pulses come; without a reference it is the count.
    fn slot(&self) -> u64 {
        match &self.servo {
            Some(servo) => {
                (servo.dc_at(self.due).count() + self.cycle.0 as u64 / 2) / self.cycle.0 as u64
            }
            None => self.number,
        }
    }

    /// Sends the datagrams of a frame that are sent in this state; `None` if none is.
    fn send(&self, line: &mut Line, at: Time<Host>, number: usize) -> Result<Option<Sent>, Kind> {
        let mut bytes = [0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut bytes, SOURCE);
        let mut datagrams = Vec::new();
        for (which, datagram) in self.frames[number].datagrams.iter().enumerate() {
            if !datagram.states.is_empty() && !datagram.states.contains(&self.state) {
                continue;
            }
            let mut data = vec![0; usize::from(datagram.length)];
            if let (true, Some(servo)) = (is_drift(datagram), &self.servo) {
                // The reference puts its own time in their place.
                let guess = servo.dc_at(at).count().to_le_bytes();
                data.iter_mut().zip(guess).for_each(|(byte, guess)| *byte = guess);
            }
            let address = wire_address(datagram.command, datagram.address);
            let place = writer.push(datagram.command, number as u8, address, &data);
            datagrams.push((which, place.map_err(|_| Kind::FrameTooLong { frame: number })?));
        }
        if datagrams.is_empty() {
            return Ok(None);
        }
        let length = writer.finish();
        let back = line.send(at, &bytes[..length])?;
        Ok(Some(Sent { frame: number, datagrams, back }))
    }

    /// Takes a frame; whether all of it counted right.
    fn receive(&mut self, line: &mut Line, sent: &Sent, at: Time<Host>) -> bool {
        let bytes = sent.back.and_then(|_| line.take(sent.frame as u8));
        let Some(bytes) = bytes else {
            self.counts.lost += 1;
            return false;
        };
        let mut right = true;
        for (which, place) in &sent.datagrams {
            let datagram = &self.frames[sent.frame].datagrams[*which];
            let end = place + usize::from(datagram.length);
            let counter =
                bytes.get(end..end + WKC_LEN).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
            if let Some(expected) = datagram.working_counter.filter(|expected| *expected != counter)
            {
                right = false;
                self.counts.wrong += 1;
                self.counts.first_wrong.get_or_insert((expected, counter));
            }
            if is_drift(datagram)
                && counter > 0
                && let (Some(servo), Some(low)) = (
                    &mut self.servo,
                    bytes[*place..end].first_chunk().map(|b| u32::from_le_bytes(*b)),
                )
            {
                self.last = extend(low, self.last);
                servo.sample(at, self.last);
            }
        }
        right
    }

    /// Plans the next cycle at the first instant at which its frame finds the reference clock at phase 0.
    fn plan_next(&mut self, at: Time<Host>) {
        let Some(servo) = &self.servo else {
            self.due += self.cycle;
            return;
        };
        let earliest = at + Nanos(self.cycle.0 / 2);
        self.grid += self.cycle;
        self.due = servo.host_at(self.grid);
        if !(0..self.cycle.0).contains(&(self.due - earliest).0) {
            self.grid = servo.next_grid(earliest, self.cycle, Nanos::ZERO);
            self.due = servo.host_at(self.grid).max(earliest);
        }
    }
}

/// Whether a datagram reads the system time of one clock and writes it to those behind.
pub(crate) fn is_drift(datagram: &CyclicDatagram) -> bool {
    matches!(datagram.command, Command::Armw | Command::Frmw) && is_system_time(datagram.address)
}

/// Whether a datagram writes the host's time into a clock.
pub(crate) fn is_lead(datagram: &CyclicDatagram) -> bool {
    let writes = matches!(datagram.command, Command::Apwr | Command::Fpwr | Command::Bwr);
    writes && is_system_time(datagram.address)
}

fn is_system_time(address: Address) -> bool {
    matches!(address, Address::Physical { register, .. } if register == register::SYSTEM_TIME.address)
}

/// The time nearest to `last` with these low bits.
pub(crate) fn extend(low: u32, last: Time<Dc>) -> Time<Dc> {
    last + Nanos(i64::from(low.wrapping_sub(last.count() as u32) as i32))
}
