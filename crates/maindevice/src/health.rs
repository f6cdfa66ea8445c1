//! Who left its state: AL status and code of every SubDevice, read when the cyclic broadcast looks
//! wrong.

use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::register;

use crate::esm::{STATUS_LEN, status_of};
use crate::link::Link;

/// What one SubDevice answered; `None`: nothing.
pub(crate) type Status = Option<(AlStatus, AlStatusCode)>;

/// AL status and code of all SubDevices, by position. One that does not answer is no reason to give
/// up the others.
pub(crate) async fn check(link: Link, stations: Vec<StationAddress>) -> Vec<Status> {
    let address = register::AL_STATUS.address;
    let reads: Vec<_> =
        stations.iter().map(|station| link.fprd(*station, address, STATUS_LEN)).collect();
    let mut all = Vec::with_capacity(stations.len());
    for read in reads {
        all.push(match read.reply().await {
            Ok(reply) if reply.wkc == 1 => Some(status_of(&reply.data)),
            _ => None,
        });
    }
    all
}
