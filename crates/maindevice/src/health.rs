//! Finds SubDevices that left their state or are lost: it reads AL status and code of every
//! SubDevice when the cyclic broadcast shows a fault. If more SubDevices answer than take part, it
//! also reads the place of each.

use alloc::vec::Vec;

use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::dl::DlStatus;
use isocat_wire::register::{self, Value};
use isocat_wire::{AutoIncrementAddress, StationAddress};

use crate::esm::{STATUS_LEN, status_of};
use crate::link::{Exchange, Link, Travel};

/// The answer of one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Answer {
    /// AL status and its code.
    Status(AlStatus, AlStatusCode),
    /// The frame came back, but no SubDevice has this station address.
    Nobody,
    /// Frames were lost, or more than one SubDevice answered: the state is unknown.
    Unknown,
}

/// A SubDevice that answers at a place of the processing order, known or not.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Found {
    /// Register 0x0010.
    pub station: StationAddress,
    /// Register 0x0110.
    pub dl_status: DlStatus,
}

/// The result of a look at the segment.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Look {
    /// Answers by position, of the SubDevices that were asked.
    pub answers: Vec<(usize, Answer)>,
    /// Other SubDevices that answer.
    pub others: Others,
}

/// Whether more SubDevices answer than were asked.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Others {
    /// No others answer, or they are not known.
    None,
    /// Others answer; these are all SubDevices in processing order.
    Everybody(Vec<Found>),
    /// This number answers in all, which is more than have a place in the segment. They are not
    /// read one by one, since the number comes from a single working counter and need not be true.
    TooMany(u16),
}

/// Reads the state of SubDevices. If one does not answer, the others are still read. `planned` is
/// the number of places in the segment, including those of absent SubDevices.
pub(crate) async fn look(
    link: Link,
    stations: Vec<(usize, StationAddress)>,
    planned: usize,
) -> Look {
    let address = register::AL_STATUS.address;
    let count = link.brd(register::TYPE.address, 1);
    let reads: Vec<_> =
        stations.iter().map(|(_, station)| link.fprd(*station, address, STATUS_LEN)).collect();
    let mut answers = Vec::with_capacity(stations.len());
    for ((position, _), read) in stations.iter().zip(reads) {
        let answer = match read.reply().await {
            Ok(reply) if reply.wkc == 1 => {
                let (status, code) = status_of(&reply.data);
                Answer::Status(status, code)
            }
            Ok(reply) if reply.wkc == 0 => Answer::Nobody,
            _ => Answer::Unknown,
        };
        answers.push((*position, answer));
    }
    let count = count.reply().await.map_or(0, |reply| usize::from(reply.wkc));
    let known = answers.iter().filter(|(_, answer)| *answer != Answer::Nobody).count();
    let others = match count {
        count if count <= known => Others::None,
        count if count > planned => Others::TooMany(count as u16),
        count => everybody(&link, count).await.map_or(Others::None, Others::Everybody),
    };
    Look { answers, others }
}

/// Station address and DL status of `count` SubDevices in processing order; `None` if not all
/// answer.
async fn everybody(link: &Link, count: usize) -> Option<Vec<Found>> {
    let read = |position: usize, ado: u16| -> Exchange {
        let place = AutoIncrementAddress::of_position(position as u16);
        let data = alloc::vec![0; 2];
        link.exchange(Command::Aprd, Address::Position(place, ado), data, Travel::default())
    };
    let reads: Vec<_> = (0..count)
        .map(|at| {
            (read(at, register::STATION_ADDRESS.address), read(at, register::DL_STATUS.address))
        })
        .collect();
    let mut all = Vec::with_capacity(count);
    for (station, status) in reads {
        let bytes = |data: Vec<u8>| data.first_chunk().copied().unwrap_or_default();
        let station = bytes(station.expect(1).await.ok()?.data);
        let status = bytes(status.expect(1).await.ok()?.data);
        all.push(Found {
            station: StationAddress(u16::from_le_bytes(station)),
            dl_status: DlStatus::from_bytes(status),
        });
    }
    Some(all)
}
