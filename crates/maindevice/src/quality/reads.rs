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
    /// The clocks that are read. Fill it, then call [`Self::start`].
    pub wanted: Vec<Wanted>,
    /// Memory for the datagrams, while none are under way.
    memory: Vec<u8>,
    slot: Option<usize>,
}

impl Reads {
    /// Queues the reads of all that is wanted.
    pub fn start(&mut self, port: &mut Port) {
        let mut datagrams = core::mem::take(&mut self.memory);
        datagrams.clear();
        let mut count = 0;
        for &(_, station, has_status) in &self.wanted {
            let mut both = [0; DIFFERENCE + STATUS];
            let (difference, status) = both.split_at_mut(DIFFERENCE);
            read(difference, station, register::SYSTEM_TIME_DIFFERENCE.address);
            read(status, station, register::ACTIVATION_STATUS.address);
            datagrams.extend_from_slice(&both[..octets_of(has_status)]);
            count += 1 + u16::from(has_status);
        }
        if count > 0 {
            self.slot = Some(port.enqueue_batch(datagrams, count));
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

    /// Gives the answers of reads that are back or lost to `tell`, by index among the clocks.
    pub fn take(&mut self, port: &mut Port, mut tell: impl FnMut(usize, Option<Registers>)) {
        let Some(slot) = self.slot.take_if(|slot| port.has_batch(*slot)) else { return };
        let (sent, datagrams) = port.take_batch(slot);
        let mut rest = &datagrams[..];
        for &(index, _, has_status) in &self.wanted {
            let difference = answer::<8>(&mut rest);
            let status = if has_status { answer::<1>(&mut rest) } else { None };
            let activation = status.map(|[status]| ActivationStatus(status));
            let registers = |(at, bytes)| Registers { at, bytes, activation };
            tell(index, sent.zip(difference).map(registers));
        }
        self.memory = datagrams;
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

/// Makes a datagram that reads what it has room for.
#[inline(always)]
fn read(datagram: &mut [u8], station: StationAddress, ado: u16) {
    let len = datagram.len().saturating_sub(HEADER_LEN + WKC_LEN) as u16;
    let header = Header::new(Command::Fprd, 0, Address::Station(station, ado), len);
    if let Some(place) = datagram.first_chunk_mut() {
        *place = header.emit();
    }
}

/// The data of the first datagram, if its working counter is 1; the rest follows.
fn answer<const LEN: usize>(rest: &mut &[u8]) -> Option<[u8; LEN]> {
    let (_, more) = rest.split_first_chunk::<HEADER_LEN>()?;
    let (data, more) = more.split_first_chunk::<LEN>()?;
    let (counter, more) = more.split_first_chunk::<WKC_LEN>()?;
    *rest = more;
    (u16::from_le_bytes(*counter) == 1).then_some(*data)
}

/// Bytes of a datagram that reads 0x092C to 0x0933.
const DIFFERENCE: usize = HEADER_LEN + 8 + WKC_LEN;
/// Bytes of a datagram that reads 0x0984.
const STATUS: usize = HEADER_LEN + 1 + WKC_LEN;
