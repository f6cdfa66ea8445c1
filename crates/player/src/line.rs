//! Sends the player's frames, and accounts for their time.

use std::sync::atomic::{AtomicBool, Ordering};

use isocat_descriptions::start_up::Address;
use isocat_wire::address::{AutoIncrementAddress, StationAddress};
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{Command, datagram};

use crate::cyclic::Exchange;
use crate::failure::Kind;
use crate::tally::Tally;
use crate::wire::{Buffer, Wire};

/// The wire, with the cyclic exchange that continues while single commands are sent.
pub(crate) struct Line<'w> {
    pub wire: &'w mut dyn Wire,
    /// The exchange; `None` before it begins.
    pub exchange: Option<Exchange>,
    pub tally: Tally,
    /// The index of the pending single datagram, and its answer.
    single: Option<u8>,
    answer: Option<Vec<u8>>,
    /// When the last answer came back, and the number of cycles at that time.
    heard: (Time<Host>, u64),
    /// If it is set, everything that waits ends with [`Kind::Ended`].
    pub stop: Option<&'w AtomicBool>,
    incoming: Box<Buffer>,
    outgoing: Box<Buffer>,
}

/// The answer to a datagram.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Reply {
    pub data: Vec<u8>,
    pub counter: u16,
    /// When its frame was sent.
    pub sent: Time<Host>,
}

impl<'w> Line<'w> {
    pub fn new(wire: &'w mut dyn Wire) -> Self {
        let now = wire.now();
        Self {
            wire,
            exchange: None,
            tally: Tally::default(),
            single: None,
            answer: None,
            heard: (now, 0),
            stop: None,
            incoming: Box::new([0; frame::MAX_LEN]),
            outgoing: Box::new([0; frame::MAX_LEN]),
        }
    }
}

impl Line<'_> {
    pub fn now(&self) -> Time<Host> {
        self.wire.now()
    }

    /// Waits, and sends the cycles that are due meanwhile.
    pub fn sleep(&mut self, span: Nanos) -> Result<(), Kind> {
        let end = self.now() + span;
        while let Some(due) = self.exchange.as_ref().map(Exchange::due).filter(|due| *due <= end) {
            self.run_cycle(due)?;
        }
        self.wire.wait(end)
    }

    /// Waits for the end of the next cycle.
    pub fn cycle(&mut self) -> Result<(), Kind> {
        match self.exchange.as_ref().map(Exchange::due) {
            Some(due) => self.run_cycle(due),
            None => Ok(()),
        }
    }

    /// Whether no frame has come back for more than `span`, while several cycles began.
    pub fn is_silent(&self, span: Nanos) -> bool {
        let (at, cycle) = self.heard;
        let cycles = self.tally.statistics.cycles;
        self.now() - at > span && cycles >= cycle + SILENT_CYCLES
    }

    /// Sends one datagram in its own frame, between the frames of two cycles; `None`: it did not
    /// come back.
    pub fn datagram(
        &mut self,
        command: Command,
        address: Address,
        data: &[u8],
    ) -> Result<Option<Reply>, Kind> {
        self.heed_stop()?;
        let needed = data.len() + datagram::HEADER_LEN + datagram::WKC_LEN;
        self.wait_for_room(frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN + needed)?;
        let index = self.tally.index();
        let mut writer = FrameWriter::new(&mut self.outgoing[..], SOURCE);
        let at = writer.push(command, index, wire_address(command, address), data);
        let at = at.map_err(|_| Kind::FrameTooLong { frame: 0 })?;
        let length = writer.finish();
        (self.single, self.answer) = (Some(index), None);
        let sent = self.wire.send(self.wire.now(), &self.outgoing[..length])?.at;
        self.tally.statistics.frames_sent += 1;
        self.tally.statistics.datagrams += 1;
        let answer = self.await_answer(sent + self.wire.traits().patience);
        self.single = None;
        let Some(frame) = answer? else {
            self.tally.statistics.frames_lost += 1;
            return Ok(None);
        };
        let end = at + data.len();
        let counter = frame.get(end..).and_then(|rest| rest.first_chunk()).copied();
        Ok(counter.map(|counter| Reply {
            data: frame[at..end].to_vec(),
            counter: u16::from_le_bytes(counter),
            sent,
        }))
    }

    /// Waits for the answer to the single datagram; cycles continue meanwhile.
    fn await_answer(&mut self, deadline: Time<Host>) -> Result<Option<Vec<u8>>, Kind> {
        loop {
            if let Some(frame) = self.answer.take() {
                return Ok(Some(frame));
            }
            let due = self.exchange.as_ref().map(Exchange::due);
            let until = due.map_or(deadline, |due| due.min(deadline));
            match self.wire.receive(until, &mut self.incoming)? {
                Some(length) => self.dispatch(length),
                None => match due.filter(|due| *due <= self.now()) {
                    _ if self.now() >= deadline => return Ok(None),
                    Some(due) => self.run_cycle(due)?,
                    None => {}
                },
            }
        }
    }

    /// Reads by station address; `None`: it did not come back from exactly one device.
    pub fn read(
        &mut self,
        station: u16,
        register: u16,
        length: usize,
    ) -> Result<Option<Vec<u8>>, Kind> {
        let address = Address::Physical { device: station, register };
        for _ in 0..TRIES {
            let reply = self.datagram(Command::Fprd, address, &vec![0; length])?;
            if let Some(reply) = reply.filter(|reply| reply.counter == 1) {
                return Ok(Some(reply.data));
            }
        }
        Ok(None)
    }

    /// Writes by station address; returns whether exactly one device took it.
    pub fn write(&mut self, station: u16, register: u16, data: &[u8]) -> Result<bool, Kind> {
        let address = Address::Physical { device: station, register };
        for _ in 0..TRIES {
            let reply = self.datagram(Command::Fpwr, address, data)?;
            if reply.is_some_and(|reply| reply.counter == 1) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Waits until a single frame can be back before the cycle's frames are due.
    fn wait_for_room(&mut self, length: usize) -> Result<(), Kind> {
        let Some(exchange) = &self.exchange else { return Ok(()) };
        // The way there and back is estimated by the longest one of the cycle's frames.
        let needed = Nanos(frame::duration_ns(length) as i64) + exchange.longest_way() + GUARD;
        let due = exchange.due();
        if self.now() + needed > due { self.run_cycle(due) } else { Ok(()) }
    }

    fn heed_stop(&self) -> Result<(), Kind> {
        match self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
            true => Err(Kind::Ended),
            false => Ok(()),
        }
    }

    fn run_cycle(&mut self, due: Time<Host>) -> Result<(), Kind> {
        self.heed_stop()?;
        let at = self.wire.wake_up(due)?;
        let Some(exchange) = &mut self.exchange else { return Ok(()) };
        exchange.begin(self.wire, &mut self.tally, at)?;
        let patience = self.wire.traits().patience;
        let end = at + patience.min(exchange.collecting());
        while self.exchange.as_ref().is_some_and(Exchange::is_waiting) {
            let Some(length) = self.wire.receive(end, &mut self.incoming)? else { break };
            self.dispatch(length);
        }
        let now = self.now();
        if let Some(exchange) = &mut self.exchange {
            exchange.end(at, now, patience, &mut self.tally);
        }
        Ok(())
    }

    /// Passes a frame that came in to its receiver.
    fn dispatch(&mut self, length: usize) {
        let (bytes, now) = (&self.incoming[..length], self.wire.now());
        let index = frame::payload(bytes).ok().and_then(|payload| payload.get(1)).copied();
        let is_ours = match (index, &mut self.exchange) {
            (Some(index), _) if self.single == Some(index) => {
                self.answer = Some(bytes.to_vec());
                true
            }
            (Some(index), Some(exchange)) => exchange.take(index, bytes, now, &mut self.tally),
            _ => false,
        };
        let counts = &mut self.tally.statistics;
        if is_ours {
            counts.frames_received += 1;
            self.heard = (now, counts.cycles);
        } else {
            counts.frames_unexpected += 1;
        }
    }
}

/// The address in the form of the wire.
pub(crate) fn wire_address(command: Command, address: Address) -> datagram::Address {
    match address {
        Address::Logical(address) => datagram::Address::Logical(address),
        Address::Physical { device, register } => match command {
            Command::Fprd | Command::Fpwr | Command::Fprw | Command::Frmw => {
                datagram::Address::Station(StationAddress(device), register)
            }
            _ => datagram::Address::Position(AutoIncrementAddress(device), register),
        },
    }
}

/// Source address of the player's frames: bit 1 of the first octet is the one that SubDevices set.
pub(crate) const SOURCE: [u8; 6] = [0x10, 0, 0, 0, 0, 0x45];
/// Number of attempts of the player's own reads and writes.
const TRIES: usize = 4;
/// Guard time between a single frame and the cycle's frames.
const GUARD: Nanos = Nanos::micros(2);
/// Number of cycles without an answer from which on it is no accident.
const SILENT_CYCLES: u64 = 5;
