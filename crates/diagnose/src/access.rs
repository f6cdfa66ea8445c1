//! Exchanges taken apart: each datagram with what it carried out and what it brought back.

use isocat_captures::pairing::{Exchange, Seen, Tap};
use isocat_captures::reading::Frame;
use isocat_wire::Command;
use isocat_wire::datagram::{Datagram, Header, datagrams};
use isocat_wire::frame::payload;

/// One datagram of an exchange.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Access<'a> {
    pub command: Command,
    /// As it was first seen.
    pub header: Header,
    /// What it carried when it left; `None`: that frame is not in the capture.
    pub sent: Option<&'a [u8]>,
    /// A device between the MainDevice and the tap has already raised the working counter, so
    /// [`sent`](Self::sent) already holds its answer.
    pub answered_before: bool,
    /// What it carried when it came back, and its working counter; `None`: it did not come back.
    pub back: Option<(&'a [u8], u16)>,
    /// SubDevices that it passed, counted from the MainDevice; `None`: its command does not count
    /// them, or it did not come back.
    pub passed: Option<u16>,
    /// The position that it addresses; `None`: it addresses none, or the capture does not tell
    /// which.
    pub position: Option<u16>,
    /// The last frame in which it was seen.
    pub frame: usize,
}

impl<'a> Access<'a> {
    /// What was read, if any SubDevice answered.
    pub fn read(&self) -> Option<&'a [u8]> {
        let (data, wkc) = self.back?;
        (wkc > 0 && reads(self.command)).then_some(data)
    }

    /// What was written. Whether any SubDevice took it is [`taken`](Self::taken).
    pub fn written(&self) -> Option<&'a [u8]> {
        use Command::*;
        match self.command {
            // No device changes the data of a plain write, so the answer shows what was sent.
            Apwr | Fpwr | Bwr | Lwr => self.sent.or(self.back.map(|(data, _)| data)),
            Aprw | Fprw | Brw | Lrw => self.sent,
            _ => None,
        }
    }

    /// Whether a SubDevice counted; `None`: it was not seen to come back.
    pub fn taken(&self) -> Option<bool> {
        self.back.map(|(_, wkc)| wkc > 0)
    }

    /// The working counter as it came back.
    pub fn wkc(&self) -> Option<u16> {
        self.back.map(|(_, wkc)| wkc)
    }

    /// The first address of memory that it names.
    pub fn ado(&self) -> u16 {
        self.header.ado()
    }

    /// Whether it covers all `len` bytes from `address` on.
    pub fn covers(&self, address: u16, len: usize) -> bool {
        let first = usize::from(self.ado());
        let address = usize::from(address);
        !self.command.is_logical()
            && first <= address
            && address + len <= first + usize::from(self.header.len)
    }
}

/// The value of a register in the data of an access that begins at address `first`; `None`: the
/// data do not cover the register.
pub(crate) fn part<const N: usize>(first: u16, data: &[u8], address: u16) -> Option<[u8; N]> {
    let at = usize::from(address.checked_sub(first)?);
    data.get(at..)?.first_chunk().copied()
}

/// The datagrams of an exchange. `reach`: the number of SubDevices that the latest counting frame
/// passed.
pub(crate) fn accesses<'a>(
    exchange: &'a Exchange,
    tap: Tap,
    reach: Option<u16>,
) -> impl Iterator<Item = Access<'a>> {
    let mut sent = exchange.request.as_ref().map(list);
    let mut back = exchange.answer.as_ref().map(list);
    let frame = exchange.answer.as_ref().or(exchange.request.as_ref()).map_or(0, |f| f.number);
    std::iter::from_fn(move || {
        let sent = sent.as_mut().and_then(Iterator::next);
        let back = back.as_mut().and_then(Iterator::next);
        let first = sent.or(back)?;
        Some((first, sent, back))
    })
    .filter_map(move |(first, sent, back)| {
        let command = first.header.command().ok()?;
        let passed = passed(command, tap, sent, back);
        Some(Access {
            command,
            header: first.header,
            sent: sent.map(|datagram| datagram.data),
            answered_before: tap.behind > 0 && sent.is_some_and(|datagram| datagram.wkc > 0),
            back: back.map(|datagram| (datagram.data, datagram.wkc)),
            passed,
            position: position(command, tap, sent, back, reach),
            frame,
        })
    })
}

fn list(frame: &Frame) -> impl Iterator<Item = Datagram<'_>> + use<'_> {
    datagrams(payload(&frame.bytes).unwrap_or(&[])).map_while(Result::ok)
}

/// The number of SubDevices that a datagram passed, including those before the tap.
fn passed(
    command: Command,
    tap: Tap,
    sent: Option<Datagram<'_>>,
    back: Option<Datagram<'_>>,
) -> Option<u16> {
    let back = back.filter(|_| command.increments_position())?.header.adp();
    match sent {
        Some(sent) => Some(back.wrapping_sub(sent.header.adp()).wrapping_add(tap.behind)),
        // A MainDevice sends broadcasts with position 0.
        None if is_broadcast(command) => Some(back),
        None => None,
    }
}

/// The position that a datagram addresses. It goes out as the negated position, and each SubDevice
/// adds one.
fn position(
    command: Command,
    tap: Tap,
    sent: Option<Datagram<'_>>,
    back: Option<Datagram<'_>>,
    reach: Option<u16>,
) -> Option<u16> {
    if !command.increments_position() || is_broadcast(command) {
        return None;
    }
    match (sent, back) {
        (Some(sent), _) => Some(tap.behind.wrapping_sub(sent.header.adp())),
        (None, Some(back)) => Some(reach?.wrapping_sub(back.header.adp())),
        (None, None) => None,
    }
}

pub(crate) fn is_broadcast(command: Command) -> bool {
    matches!(command, Command::Brd | Command::Bwr | Command::Brw)
}

fn reads(command: Command) -> bool {
    use Command::*;
    matches!(command, Aprd | Aprw | Fprd | Fprw | Brd | Brw | Armw | Frmw | Lrd | Lrw)
}

/// Whether the answers of the devices can be told from a capture of this kind.
pub(crate) fn shows_answers(tap: Tap) -> bool {
    tap.seen != Seen::Out
}
