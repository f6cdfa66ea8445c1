//! Differences between the answer of silicon and that of the model.

use isocat_wire::frame::ETHERNET_HEADER_LEN;

use super::chain::Chain;
use super::exchange::Exchange;
use super::parts::{Pair, Stations, Whom, list, pairs, reads};

/// One difference, without its reason.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Raw {
    /// Datagram of the frame, from 0.
    pub datagram: usize,
    /// The part that differs.
    pub part: Part,
    /// Position of the SubDevice, if it is known.
    pub device: Option<usize>,
    /// Address of the first byte in the memory of the SubDevice, if known.
    pub address: Option<u16>,
    /// Answer of the silicon; a number is little-endian.
    pub silicon: Vec<u8>,
    /// Answer of the model.
    pub model: Vec<u8>,
}

/// Parts of a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Part {
    Source,
    Position,
    EventField,
    Data,
    WorkingCounter,
}

/// Compares the answer of an exchange with the frame that the model sends back.
pub(crate) fn compare(
    exchange: &Exchange,
    model: &[u8],
    chain: &Chain,
    stations: &Stations,
) -> (Vec<Raw>, usize) {
    let mut found = Vec::new();
    let Some((_, answer)) = &exchange.answer else { return (found, 0) };
    let source = 6..ETHERNET_HEADER_LEN - 2;
    if answer[source.clone()] != model[source.clone()] {
        found.push(Raw {
            datagram: 0,
            part: Part::Source,
            device: None,
            address: None,
            silicon: answer[source.clone()].to_vec(),
            model: model[source].to_vec(),
        });
    }
    let mut compared = 0;
    let modelled = list(model);
    let modelled = modelled.iter().filter(|datagram| datagram.header.command().is_ok());
    for (number, (pair, modelled)) in pairs(exchange).iter().zip(modelled).enumerate() {
        let device = match stations.whom(pair) {
            Whom::One(position) => Some(position),
            Whom::All if chain.escs.len() == 1 => Some(0),
            _ => None,
        };
        let address = (!pair.command.is_logical()).then(|| pair.sent.header.ado());
        let mut part = |part: Part, silicon: u16, model: u16| {
            if silicon != model {
                let (silicon, model) = (silicon.to_le_bytes(), model.to_le_bytes());
                let (silicon, model) = (silicon.to_vec(), model.to_vec());
                found.push(Raw { datagram: number, part, device, address, silicon, model });
            }
        };
        if !pair.command.is_logical() {
            part(Part::Position, pair.back.header.adp(), modelled.header.adp());
        }
        part(Part::EventField, pair.back.header.irq, modelled.header.irq);
        part(Part::WorkingCounter, pair.back.wkc, modelled.wkc);
        let places = places(pair, chain, device);
        for (place, (silicon, model)) in places.iter().zip(pair.back.data.iter().zip(modelled.data))
        {
            if place.left_out {
                continue;
            }
            compared += 1;
            if silicon == model {
                continue;
            }
            let (device, address) = (place.device, place.address);
            let (silicon, model) = (*silicon, *model);
            match found.last_mut().filter(|last| goes_on(last, number, device, address)) {
                Some(last) => {
                    last.silicon.push(silicon);
                    last.model.push(model);
                }
                None => found.push(Raw {
                    datagram: number,
                    part: Part::Data,
                    device,
                    address,
                    silicon: vec![silicon],
                    model: vec![model],
                }),
            }
        }
    }
    (found, compared)
}

/// Whether a byte belongs to the difference before it: the next byte of the same register.
fn goes_on(last: &Raw, datagram: usize, device: Option<usize>, address: Option<u16>) -> bool {
    let Some((first, next)) = last.address.zip(address) else { return false };
    let len = last.silicon.len();
    last.part == Part::Data
        && last.datagram == datagram
        && last.device == device
        && usize::from(next) == usize::from(first) + len
        && super::names::name(first) == super::names::name(next)
}

/// Origin of a data byte of a datagram.
#[derive(Clone, Copy, Default)]
struct Place {
    device: Option<usize>,
    address: Option<u16>,
    left_out: bool,
}

fn places(pair: &Pair<'_>, chain: &Chain, device: Option<usize>) -> Vec<Place> {
    let len = pair.back.data.len();
    let mut places = vec![Place::default(); len];
    if pair.command.is_logical() {
        for position in 0..chain.escs.len() {
            for (at, _, address, _) in chain.mapped(position, pair.sent.header.address, len) {
                places[at].device = Some(position);
                places[at].address = Some(address);
                places[at].left_out |= runs_by_itself(address);
            }
        }
        return places;
    }
    // While silicon's EEPROM is busy, its progress depends on its speed.
    let busy = pair.back_at(0x0503).is_some_and(|status| status & 0x80 != 0);
    let first = usize::from(pair.sent.header.ado());
    for (at, place) in places.iter_mut().enumerate() {
        let address = u16::try_from(first + at).ok();
        *place = Place { device, address, left_out: false };
        // Data that are only written come back unchanged, whatever register they are for.
        if let Some(address) = address.filter(|_| reads(pair.command)) {
            place.left_out = runs_by_itself(address) || busy && (0x0500..0x0510).contains(&address);
        }
    }
    places
}

/// Whether a register depends on clocks or pins, which no capture holds: receive times, system time
/// and what is computed from it, times of SYNC and latch units and of buffers.
fn runs_by_itself(address: u16) -> bool {
    matches!(
        address,
        0x0900..0x0920
            | 0x092C..0x0930
            | 0x0932..0x0934
            | 0x0984
            | 0x098E..0x0998
            | 0x0998..0x09A0
            | 0x09AE..0x09D0
            | 0x09F0..0x0A00
    )
}
