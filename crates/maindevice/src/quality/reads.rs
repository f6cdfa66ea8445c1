//! Registers of several clocks, read together in memory that is used again.

use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, HEADER_LEN, Header, WKC_LEN};
use isocat_wire::dc::ActivationStatus;
use isocat_wire::register;

use super::clocks::{Registers, Wanted};
use crate::link::Port;

/// A batch of reads: datagrams that leave in one frame, and what they ask for.
#[derive(Debug, Default)]
pub(crate) struct Reads {
    /// The clocks that are read.
    wanted: Vec<Wanted>,
    /// The datagrams, while none are under way; their memory is used again.
    datagrams: Vec<u8>,
    slot: Option<usize>,
}

impl Reads {
    /// Lists that are empty, of the clocks to read and of their datagrams, while none are under
    /// way. Fill them, then call [`Self::start`].
    pub fn clear(&mut self) -> (&mut Vec<Wanted>, &mut Vec<u8>) {
        self.wanted.clear();
        self.datagrams.clear();
        (&mut self.wanted, &mut self.datagrams)
    }

    /// Queues the reads of all that is wanted.
    pub fn start(&mut self, port: &mut Port) {
        let datagrams = core::mem::take(&mut self.datagrams);
        // Each clock has a datagram of its difference, and some have another one of their status.
        let states = datagrams.len().saturating_sub(DIFFERENCE * self.wanted.len()) / STATUS;
        if !self.wanted.is_empty() {
            self.slot = Some(port.enqueue_batch(datagrams, (self.wanted.len() + states) as u16));
        }
    }

    /// Whether reads are under way.
    pub fn are_under_way(&self) -> bool {
        self.slot.is_some()
    }

    /// Whether they are back or lost.
    #[inline]
    pub fn are_back(&self, port: &Port) -> bool {
        self.slot.is_some_and(|slot| port.has_batch(slot))
    }

    /// Gives the answers of reads that are back or lost to `tell`, by index among the clocks, and
    /// the clocks without an answer to `miss`; both get `context`.
    #[inline(always)]
    pub fn take<C>(
        &mut self,
        port: &mut Port,
        context: &mut C,
        mut tell: impl FnMut(&mut C, usize, Registers),
        mut miss: impl FnMut(&mut C, usize),
    ) {
        let Some(slot) = self.slot.take_if(|slot| port.has_batch(*slot)) else { return };
        let (sent, datagrams) = port.take_batch(slot);
        let mut rest = &datagrams[..];
        for &(index, _, has_status) in &self.wanted {
            let Some((difference, more)) = rest.split_first_chunk::<DIFFERENCE>() else { break };
            rest = more;
            let mut activation = None;
            if has_status {
                let Some((status, more)) = rest.split_first_chunk::<STATUS>() else { break };
                rest = more;
                activation = answer(status).map(|[status]| ActivationStatus(status));
            }
            // Each is called in one place alone, so that it becomes a part of this loop.
            match (sent, answer(difference)) {
                (Some(at), Some(bytes)) => {
                    tell(context, index, Registers { at, bytes, activation })
                }
                _ => miss(context, index),
            }
        }
        self.datagrams = datagrams;
    }

    /// Drops reads that are under way.
    pub fn end(&mut self, port: &mut Port) {
        if let Some(slot) = self.slot.take() {
            port.release(slot);
        }
    }
}

/// Bytes of the datagram that reads these registers of a clock.
pub(super) fn octets_of(has_status: bool) -> usize {
    DIFFERENCE + if has_status { STATUS } else { 0 }
}

/// Adds the datagrams that read a clock.
pub(crate) fn ask((_, station, has_status): Wanted, datagrams: &mut Vec<u8>) {
    let mut both = [0; DIFFERENCE + STATUS];
    let (difference, status) = both.split_at_mut(DIFFERENCE);
    read(difference, station, register::SYSTEM_TIME_DIFFERENCE.address);
    read(status, station, register::ACTIVATION_STATUS.address);
    datagrams.extend_from_slice(&both[..octets_of(has_status)]);
}

/// Makes a datagram that reads what it has room for. It says that another one follows.
fn read(datagram: &mut [u8], station: StationAddress, ado: u16) {
    let len = datagram.len().saturating_sub(HEADER_LEN + WKC_LEN) as u16;
    let header = Header::new(Command::Fprd, 0, Address::Station(station, ado), len);
    let header = Header { more: true, ..header };
    if let Some(place) = datagram.first_chunk_mut() {
        *place = header.emit();
    }
}

/// The data of a datagram, if its working counter is 1.
#[inline(always)]
fn answer<const LEN: usize>(datagram: &[u8]) -> Option<[u8; LEN]> {
    let (_, rest) = datagram.split_first_chunk::<HEADER_LEN>()?;
    let (data, rest) = rest.split_first_chunk::<LEN>()?;
    (u16::from_le_bytes(*rest.first_chunk()?) == 1).then_some(*data)
}

/// Bytes of a datagram that reads 0x092C to 0x0933.
const DIFFERENCE: usize = HEADER_LEN + 8 + WKC_LEN;
/// Bytes of a datagram that reads 0x0984.
const STATUS: usize = HEADER_LEN + 1 + WKC_LEN;
