//! `ring`: the port for the cable to the MainDevice's secondary port, and the settings that a ring
//! excludes.
//!
//! Frames pass the devices in the order of their positions and leave the last one for the secondary
//! port. On the way back from the last device they meet the free ports without a device behind: the
//! first of these that is copper takes the cable.

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::{Keys, Scalar};
use isocat_descriptions::quantity::Length;
use isocat_esc::chip::PortKind;
use isocat_sync::phase::Direction;
use isocat_wire::PortNumber;

use super::{Operation, SubDevice, keys};

/// The cable that closes a ring.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ring {
    /// Position of the device at its end.
    pub device: usize,
    /// Its port.
    pub port: PortNumber,
    /// Length of the cable.
    pub cable: Length,
}

/// Name of the ring's cable in faults.
pub(crate) const NAME: &str = "ring";

pub(super) fn ring(
    root: &Keys<'_>,
    devices: &[SubDevice],
    operation: &Operation,
) -> Result<Option<Ring>, FileError> {
    let Some(value) = root.value("ring") else { return Ok(None) };
    let cable = match value.as_string() {
        Some(_) => Length::read(&value, &keys::CABLE_LENGTH, 0)?,
        None if value.boolean().map_err(|_| value.unexpected(keys::RING_EXPECTED))? => USUAL,
        None => return Ok(None),
    };
    if let Some(message) = refused(devices, operation) {
        return Err(value.error(message));
    }
    match end(devices) {
        Some((device, port)) => Ok(Some(Ring { device, port, cable })),
        None => Err(value
            .error("ring: no free copper port is behind the last device; expected one for the cable to the second port of the MainDevice")
            .with_hint("expected an EtherCAT extension, such as device = \"beckhoff_ek1110\", at the end")),
    }
}

/// Functions that the MainDevice does not support in a ring.
fn refused(devices: &[SubDevice], operation: &Operation) -> Option<String> {
    if operation.delay_watch.is_some() {
        return Some(
            "ring is given beside [delay_watch], but no delay can be measured where frames do not come back the way \
             they went; expected one of both"
                .into(),
        );
    }
    if operation.direction != Direction::FollowReference {
        return Some(
            "ring is given beside direction, but in a ring the reference clock leads; expected \"follow-reference\""
                .into(),
        );
    }
    devices.iter().find_map(|device| {
        let SubDevice { name, optional, place, .. } = device;
        if *optional {
            return Some(format!(
                "ring is given, but \"{name}\" is optional, and in a ring no device may be absent; expected no optional device"
            ));
        }
        if place.port != PortNumber::P0 {
            return Some(format!(
                "ring is given, but \"{name}\" is plugged in at its port {}, where frames from the first port of the \
                 MainDevice pass it without being processed; expected port 0",
                place.port
            ));
        }
        (name == NAME).then(|| {
            format!("the name \"{name}\" is that of the cable that closes the ring; expected another")
        })
    })
}

/// The port at which frames leave for the secondary port after all devices.
fn end(devices: &[SubDevice]) -> Option<(usize, PortNumber)> {
    let mut device = devices.len().checked_sub(1)?;
    let mut behind: &[PortNumber] = &[PortNumber::P1, PortNumber::P2, PortNumber::P3];
    loop {
        let esc = devices[device].profile.esc();
        let port = behind.iter().find(|port| esc.port(**port) == PortKind::Mii);
        if let Some(port) = port {
            return Some((device, *port));
        }
        let (above, taken) = devices[device].place.upstream?;
        device = above;
        behind = later(taken);
    }
}

/// The ports of a device that frames visit after this one, without the one upstream: ports are
/// passed in the order 0, 3, 1, 2.
fn later(port: PortNumber) -> &'static [PortNumber] {
    match port {
        PortNumber::P0 => &[PortNumber::P3, PortNumber::P1, PortNumber::P2],
        PortNumber::P3 => &[PortNumber::P1, PortNumber::P2],
        PortNumber::P1 => &[PortNumber::P2],
        PortNumber::P2 => &[],
    }
}

/// Default length, like that of the other cables.
const USUAL: Length = Length(10_000);
