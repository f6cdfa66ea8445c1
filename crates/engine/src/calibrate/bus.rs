//! Single datagrams at instants of the caller's choice. They are addressed by position, so that no
//! station address is written.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

use isocat_conform::wire::Wire;
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register::{Register, Value};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AutoIncrementAddress, Command};

/// Why a calibration ended before its end.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Trouble {
    /// This machine is at fault.
    Own(String),
    /// No frame came back, several times.
    Lost {
        /// Register or memory address of the frame.
        address: u16,
    },
    /// A device did not process a datagram that it must process.
    Count {
        /// Position of the device; `None` if all were addressed.
        position: Option<usize>,
        /// Register.
        address: u16,
        /// Working counter that was expected.
        expected: u16,
        /// Working counter that came back.
        found: u16,
    },
    /// No SubDevice answers.
    Empty,
    /// Fewer than two system clocks: there is nothing to compare.
    NoClocks {
        /// System clocks that were found.
        found: usize,
    },
    /// A device is in operation; nothing was written.
    InOperation {
        /// Position of the device.
        position: usize,
        /// Its activity.
        what: Operating,
    },
    /// The caller asked to stop.
    Stopped,
    /// The calibration ended early, and a device could not be restored.
    NotPutBack {
        /// Position of the first such device.
        position: usize,
        /// Why it was not restored.
        why: Box<Trouble>,
        /// Why the calibration ended.
        first: Box<Trouble>,
    },
}

/// An activity of a device that a calibration must not disturb.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Operating {
    /// Its state, register 0x0130.
    State(isocat_wire::AlStatus),
    /// Its SYNC unit is active, register 0x0981.
    Sync,
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Own(what) => f.write_str(what),
            Self::Lost { address } => {
                write!(f, "register 0x{address:04X}: {ATTEMPTS} frames did not come back")
            }
            Self::Count { position, address, expected, found } => {
                match position {
                    Some(position) => write!(f, "position {position}, ")?,
                    None => f.write_str("all positions, ")?,
                }
                write!(f, "register 0x{address:04X}: working counter {found}, expected {expected}")
            }
            Self::Empty => f.write_str("no SubDevice answers, expected 2 or more"),
            Self::NoClocks { found } => write!(
                f,
                "{found} devices have a system clock (register 0x0910), expected 2 or more: clocks are compared \
                 with each other"
            ),
            Self::InOperation { position, what } => {
                match what {
                    Operating::State(status) => write!(f, "position {position} is in {status}")?,
                    Operating::Sync => write!(f, "the SYNC unit of position {position} is active")?,
                }
                f.write_str(
                    "; expected all devices in INIT or PREOP without SYNC. Nothing was written. End what operates \
                     the segment first",
                )
            }
            Self::Stopped => f.write_str("ended by a signal"),
            Self::NotPutBack { position, why, first } => {
                write!(f, "{first}; position {position} was not put back as it was found: {why}")
            }
        }
    }
}

impl std::error::Error for Trouble {}

/// Command, address, data.
pub(crate) type Ask = (Command, Address, Vec<u8>);

/// The answer to an [`Ask`].
#[derive(Clone, Debug)]
pub(crate) struct Answer {
    pub data: Vec<u8>,
    pub wkc: u16,
}

/// Access to a segment.
pub(crate) struct Bus<'w> {
    wire: &'w mut dyn Wire,
    stop: &'w AtomicBool,
    index: u8,
    /// Frames sent.
    pub sent: u64,
    /// Of these, frames that did not come back.
    pub lost: u64,
    /// Changed settings are being restored: a request to stop is ignored.
    pub putting_back: bool,
}

impl<'w> Bus<'w> {
    pub fn new(wire: &'w mut dyn Wire, stop: &'w AtomicBool) -> Self {
        Self { wire, stop, index: 0, sent: 0, lost: 0, putting_back: false }
    }

    pub fn now(&self) -> Time<Host> {
        self.wire.now()
    }

    pub fn wait_until(&mut self, at: Time<Host>) -> Result<(), Trouble> {
        // It waits in pieces, so that a request to stop is noticed soon.
        while at - self.now() > PIECE {
            self.check()?;
            let next = self.now() + PIECE;
            self.wire.wait_until(next);
        }
        self.wire.wait_until(at);
        self.check()
    }

    pub fn wait(&mut self, span: Nanos) -> Result<(), Trouble> {
        let end = self.now() + span;
        self.wait_until(end)
    }

    /// Sends one frame once; `None` if it does not come back.
    pub fn once(&mut self, asks: &[Ask]) -> Result<Option<Vec<Answer>>, Trouble> {
        self.check()?;
        let mut frames = [self.frame(asks)];
        let back = self.wire.exchange(&mut frames).map_err(Trouble::Own)?;
        self.sent += 1;
        let answers = back.first().is_some_and(|back| *back).then(|| answers(&frames[0], asks));
        let Some(Some(answers)) = answers else {
            self.lost += 1;
            return Ok(None);
        };
        Ok(Some(answers))
    }

    /// Sends one frame that may be repeated: repeated datagrams have the same effect.
    pub fn ask(&mut self, asks: &[Ask]) -> Result<Vec<Answer>, Trouble> {
        for _ in 0..ATTEMPTS {
            if let Some(answers) = self.once(asks)? {
                return Ok(answers);
            }
        }
        Err(Trouble::Lost { address: asks.first().map_or(0, |ask| ado(ask.1)) })
    }

    /// Reads the same memory of several devices; `None` for one that does not have it.
    pub fn try_read_each(
        &mut self,
        positions: &[usize],
        address: u16,
        len: usize,
    ) -> Result<Vec<Option<Vec<u8>>>, Trouble> {
        let mut all = Vec::with_capacity(positions.len());
        for some in positions.chunks(room(len)) {
            let asks: Vec<Ask> = some.iter().map(|at| read(*at, address, len)).collect();
            let answers = self.ask(&asks)?;
            all.extend(answers.into_iter().map(|answer| (answer.wkc == 1).then_some(answer.data)));
        }
        Ok(all)
    }

    /// Reads the same memory of several devices that all have it.
    pub fn read_each(
        &mut self,
        positions: &[usize],
        address: u16,
        len: usize,
    ) -> Result<Vec<Vec<u8>>, Trouble> {
        let all = self.try_read_each(positions, address, len)?;
        let each = all.into_iter().zip(positions);
        each.map(|(data, position)| data.ok_or_else(|| not_taken(*position, address))).collect()
    }

    /// Writes memory of several devices.
    pub fn write_each(&mut self, writes: &[(usize, Vec<u8>)], address: u16) -> Result<(), Trouble> {
        let longest = writes.iter().map(|(_, data)| data.len()).max().unwrap_or(0);
        for some in writes.chunks(room(longest)) {
            let asks: Vec<Ask> =
                some.iter().map(|(at, data)| write(*at, address, data.clone())).collect();
            for (answer, (position, _)) in self.ask(&asks)?.iter().zip(some) {
                if answer.wkc != 1 {
                    return Err(not_taken(*position, address));
                }
            }
        }
        Ok(())
    }

    /// Reads a register of one device.
    pub fn read<T: Value>(&mut self, at: usize, register: Register<T>) -> Result<T, Trouble> {
        let data = self.read_each(&[at], register.address, T::LEN)?;
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&data[0]);
        Ok(register.decode(&bytes))
    }

    /// Writes one device.
    pub fn write(&mut self, at: usize, address: u16, data: &[u8]) -> Result<(), Trouble> {
        self.write_each(&[(at, data.to_vec())], address)
    }

    /// Counts the devices that answer.
    pub fn count(&mut self) -> Result<usize, Trouble> {
        let address = isocat_wire::register::TYPE.address;
        let asks = [(Command::Brd, Address::Broadcast(address), vec![0])];
        Ok(usize::from(self.ask(&asks)?[0].wkc))
    }

    fn check(&self) -> Result<(), Trouble> {
        match !self.putting_back && self.stop.load(Ordering::Relaxed) {
            true => Err(Trouble::Stopped),
            false => Ok(()),
        }
    }

    fn frame(&mut self, asks: &[Ask]) -> Vec<u8> {
        let mut frame = vec![0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut frame, SOURCE);
        for (command, address, data) in asks {
            self.index = self.index.wrapping_add(1);
            let pushed = writer.push(*command, self.index, *address, data);
            assert!(pushed.is_ok(), "no more datagrams are asked for at once than fit");
        }
        let len = writer.finish();
        frame.truncate(len);
        frame
    }
}

/// The datagrams that came back, if they match those that were sent.
fn answers(frame: &[u8], asks: &[Ask]) -> Option<Vec<Answer>> {
    let payload = frame::payload(frame).ok()?;
    let found: Vec<_> = datagrams(payload).collect::<Result<_, _>>().ok()?;
    let same = found.len() == asks.len()
        && found.iter().zip(asks).all(|(found, ask)| found.data.len() == ask.2.len());
    let answer = |found: &isocat_wire::datagram::Datagram<'_>| Answer {
        data: found.data.to_vec(),
        wkc: found.wkc,
    };
    same.then(|| found.iter().map(answer).collect())
}

/// A read of one device's memory.
pub(super) fn read(position: usize, address: u16, len: usize) -> Ask {
    (Command::Aprd, at(position, address), vec![0; len])
}

/// A write to one device's memory.
pub(crate) fn write(position: usize, address: u16, data: Vec<u8>) -> Ask {
    (Command::Apwr, at(position, address), data)
}

/// A device by its position.
pub(super) fn at(position: usize, address: u16) -> Address {
    Address::Position(AutoIncrementAddress::of_position(position as u16), address)
}

/// Up to eight bytes, little-endian.
pub(super) fn number(bytes: &[u8]) -> u64 {
    bytes.iter().take(8).rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

fn ado(address: Address) -> u16 {
    match address {
        Address::Position(_, ado) | Address::Station(_, ado) | Address::Broadcast(ado) => ado,
        Address::Logical(_) => 0,
    }
}

fn not_taken(position: usize, address: u16) -> Trouble {
    Trouble::Count { position: Some(position), address, expected: 1, found: 0 }
}

/// Number of datagrams of `len` bytes that fit into one frame: header and working counter take 12
/// bytes each.
fn room(len: usize) -> usize {
    (1_400 / (len + 12)).max(1)
}

/// Source address of the frames.
const SOURCE: [u8; 6] = [frame::LOCALLY_ADMINISTERED, 0, 0, 0, 0, 0xCA];
/// How often a frame that may be repeated is sent before it counts as lost.
const ATTEMPTS: usize = 8;
/// Longest wait without a check for a request to stop.
const PIECE: Nanos = Nanos::millis(50);
