//! `ring`: where the cable to the MainDevice's secondary port is plugged in, and what does not go with a ring.
//!
//! Frames pass the devices in the order of their positions and leave the last one for the secondary port. On the way
//! back up from the last device they come to the free ports that no other device is behind: the first of these that is
//! copper takes the cable.

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::{Keys, Scalar};
use isocat_descriptions::quantity::Length;
use isocat_esc::chip::PortKind;
use isocat_sync::phase::Direction;
use isocat_wire::PortNumber;

use super::{Operation, SubDevice, keys};

/// The cable that makes a ring of the segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Ring {
    /// The device that it leads from, by position.
    pub device: usize,
    /// Its port.
    pub port: PortNumber,
    /// How long the cable is.
    pub cable: Length,
}

/// What faults call the cable that closes the ring.
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

/// What the MainDevice does not do in a ring.
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

/// The port at which frames leave for the secondary port once all devices are passed.
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

/// The ports of a device that frames come to behind this one, without the one upstream: ports are passed in the order 0,
/// 3, 1, 2.
fn later(port: PortNumber) -> &'static [PortNumber] {
    match port {
        PortNumber::P0 => &[PortNumber::P3, PortNumber::P1, PortNumber::P2],
        PortNumber::P3 => &[PortNumber::P1, PortNumber::P2],
        PortNumber::P1 => &[PortNumber::P2],
        PortNumber::P2 => &[],
    }
}

/// As long as the other cables where nothing is said.
const USUAL: Length = Length(10_000);
