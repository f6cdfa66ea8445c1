//! Frames of the player on the virtual bus, and the time that they take.

use isocat_descriptions::start_up::Address;
use isocat_serve::{Answer, Bus};
use isocat_sim::MainPort;
use isocat_sim::random::Stream;
use isocat_wire::address::{AutoIncrementAddress, StationAddress};
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{Command, datagram};

use crate::cyclic::Exchange;
use crate::failure::Kind;

/// The bus, with the cyclic exchange that goes on while single commands are sent.
pub(crate) struct Line {
    pub bus: Bus,
    /// The exchange; `None` before it begins.
    pub exchange: Option<Exchange>,
    seed: u64,
    /// Worst lateness of the host's wake-ups.
    jitter: Nanos,
    wake_ups: u64,
}

/// What came back of a datagram.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Reply {
    pub data: Vec<u8>,
    pub counter: u16,
    /// When its frame was sent.
    pub sent: Time<Host>,
}

impl Line {
    pub fn new(bus: Bus, seed: u64, jitter: Nanos) -> Self {
        Self { bus, exchange: None, seed, jitter, wake_ups: 0 }
    }

    pub fn now(&self) -> Time<Host> {
        self.bus.now()
    }

    /// Waits; cycles that are due meanwhile are sent.
    pub fn sleep(&mut self, span: Nanos) -> Result<(), Kind> {
        let end = self.now() + span;
        while let Some(due) = self.exchange.as_ref().map(Exchange::due).filter(|due| *due <= end) {
            self.run_cycle(due)?;
        }
        if end > self.now() {
            self.bus.advance(end)?;
        }
        Ok(())
    }

    /// Waits for the end of the next cycle.
    pub fn cycle(&mut self) -> Result<(), Kind> {
        match self.exchange.as_ref().map(Exchange::due) {
            Some(due) => self.run_cycle(due),
            None => Ok(()),
        }
    }

    /// One datagram in a frame of its own, between the frames of two cycles; `None` if it did not come back.
    pub fn datagram(
        &mut self,
        command: Command,
        address: Address,
        data: &[u8],
    ) -> Result<Option<Reply>, Kind> {
        let mut bytes = [0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut bytes, SOURCE);
        let at = writer.push(command, SINGLE, wire_address(command, address), data);
        let at = at.map_err(|_| Kind::FrameTooLong { frame: 0 })?;
        let length = writer.finish();
        self.wait_for_room(length)?;
        let sent = self.now();
        let answer = self.send(sent, &bytes[..length])?;
        let Some(back) = answer else {
            self.sleep(PATIENCE)?;
            return Ok(None);
        };
        self.bus.advance(back.max(self.now()))?;
        let Some(frame) = self.take(SINGLE) else { return Ok(None) };
        let end = at + data.len();
        let counter = frame.get(end..).and_then(|rest| rest.first_chunk()).copied();
        Ok(counter.map(|counter| Reply {
            data: frame[at..end].to_vec(),
            counter: u16::from_le_bytes(counter),
            sent,
        }))
    }

    /// A read by station address; `None` if it did not come back from one device.
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

    /// A write by station address; whether one device took it.
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

    /// Sends a frame whose first bit leaves at `at`; gives when it is back.
    pub fn send(&mut self, at: Time<Host>, frame: &[u8]) -> Result<Option<Time<Host>>, Kind> {
        match self.bus.send(MainPort::Primary, at, frame)? {
            Answer::Back { last_bit, .. } => Ok(Some(last_bit)),
            Answer::Lost => Ok(None),
        }
    }

    /// Takes the frame that is back and whose datagrams have this index; older ones are dropped.
    pub fn take(&mut self, index: u8) -> Option<Vec<u8>> {
        while let Some(arrival) = self.bus.receive() {
            let start = frame::payload_offset(&arrival.frame).ok()?;
            if arrival.frame.get(start + 1) == Some(&index) {
                return Some(arrival.frame);
            }
        }
        None
    }

    /// A single frame must not be on the wire when the cycle's frames are due.
    fn wait_for_room(&mut self, length: usize) -> Result<(), Kind> {
        let Some(exchange) = &self.exchange else { return Ok(()) };
        // There and back, by the longest way that a frame of the cycle was seen to take.
        let needed = Nanos(frame::duration_ns(length) as i64) + exchange.longest_way() + GUARD;
        let due = exchange.due();
        if self.now() + needed > due { self.run_cycle(due) } else { Ok(()) }
    }

    fn run_cycle(&mut self, due: Time<Host>) -> Result<(), Kind> {
        self.wake_ups += 1;
        let worst = u64::try_from(self.jitter.0).unwrap_or(0);
        let late = match worst {
            0 => 0,
            worst => Stream::new(self.seed, "wake-up of the player", self.wake_ups).lateness(worst),
        };
        let at = (due + Nanos(late as i64)).max(self.now());
        let Some(mut exchange) = self.exchange.take() else { return Ok(()) };
        let result = exchange.run(self, at);
        self.exchange = Some(exchange);
        result
    }
}

/// The address as it goes on the wire.
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

/// Source address of the player's frames.
pub(crate) const SOURCE: [u8; 6] = [0x02, 0, 0, 0, 0, 0x45];
/// Index of single datagrams; frames of the cycle have their number.
const SINGLE: u8 = 0xFF;
/// How long a frame is waited for that does not come.
const PATIENCE: Nanos = Nanos::millis(1);
/// How often the player's own reads and writes are tried.
const TRIES: usize = 4;
/// Room between a single frame and the cycle's frames.
const GUARD: Nanos = Nanos::micros(2);
