//! Places of devices in the tree: the keys `connect` and `port`, and whether both ends are of one
//! kind.
//!
//! A file lists devices in any order in which the upstream one comes first. Everything after uses
//! the order of positions, in which frames are processed: see [`sort`].

use std::collections::HashMap;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Value, name_hint};
use isocat_esc::chip::PortKind;
use isocat_sim::segment::processing_order;
use isocat_wire::PortNumber;

use super::SubDevice;
use crate::profile::Profile;

/// Place of a device in the tree.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Place {
    /// The device upstream, by its index in the file's list of devices, and its port; `None`: the
    /// MainDevice. Key `connect`, such as `connect = "axis 1:3"`: the name of a device above, or
    /// its place in the file counted from 0 (each of a `count` counts), and the port there.
    /// Default: the device above, port 1 (port 0 if its port 1 leads upstream).
    pub upstream: Option<(usize, PortNumber)>,
    /// The device's own port for the cable upstream. Key `port`; default 0, any other is a swapped
    /// cable.
    pub port: PortNumber,
}

/// The ports in use of the devices so far.
pub(super) struct Ports {
    /// The port for the first device.
    main: PortKind,
    taken: Vec<[bool; 4]>,
}

/// The devices so far, and their names with their places; the name of the next one may be included.
#[derive(Clone, Copy)]
pub(super) struct Earlier<'a> {
    pub devices: &'a [SubDevice],
    pub names: &'a HashMap<String, usize>,
}

impl Earlier<'_> {
    fn find(self, name: &str) -> Option<usize> {
        self.names.get(name).copied().filter(|place| *place < self.devices.len())
    }
}

/// The end of a device that leads upstream.
#[derive(Clone, Copy)]
pub(super) struct Plug<'a> {
    pub name: &'a str,
    pub profile: &'a Profile,
    pub port: PortNumber,
}

impl Plug<'_> {
    fn kind(self) -> PortKind {
        self.profile.esc().port(self.port)
    }

    /// The error for this end at a port of another kind.
    fn misfit(self, above: &str, kind: PortKind) -> String {
        let Self { name, port, .. } = self;
        format!(
            "port {port} of \"{name}\" is {}, but {above} is {}: they can't be joined",
            word(self.kind()),
            word(kind)
        )
    }
}

impl Ports {
    /// No devices yet, behind a MainDevice with this port.
    pub fn of(main: PortKind) -> Self {
        Self { main, taken: Vec::new() }
    }

    /// Reads the place of the next device, below the `earlier` ones: as `connect` says, or behind
    /// the last.
    pub fn place<'a>(
        &mut self,
        keys: &Keys<'a>,
        plug: Plug<'_>,
        connect: Option<Value<'a>>,
        above: Earlier<'_>,
    ) -> Result<Place, FileError> {
        let earlier = above.devices;
        let upstream = match (&connect, earlier.last()) {
            (Some(value), None) => {
                return Err(value.error(
                    "the first device hangs on the MainDevice; expected no \"connect\" here",
                ));
            }
            (Some(value), Some(_)) => Some(upstream(value, above)?),
            (None, None) => {
                self.fits_main_device(keys, plug)?;
                None
            }
            (None, Some(last)) => {
                let port =
                    if last.place.port == PortNumber::P1 { PortNumber::P0 } else { PortNumber::P1 };
                Some((earlier.len() - 1, port))
            }
        };
        let mut own = [false; 4];
        own[plug.port.index()] = true;
        if let Some((above, port)) = upstream {
            let fail = |message: String| match &connect {
                Some(value) => value.error(message),
                None => keys.error(message + "; expected \"connect\" to say where it hangs"),
            };
            let device = &earlier[above];
            if !device.profile.esc().has_port(port) {
                let (name, chip) = (&device.name, chip(&device.profile));
                let ports = ports(&device.profile);
                return Err(fail(format!(
                    "\"{name}\" ({chip}) has no port {port}; it has {ports}"
                )));
            }
            if device.profile.esc().port(port) != plug.kind() {
                let above = format!("port {port} of \"{}\"", device.name);
                let message = plug.misfit(&above, device.profile.esc().port(port));
                let error = connect
                    .as_ref()
                    .map_or_else(|| keys.error(&message), |value| value.error(&message));
                return Err(error.with_hint(self.remedy(plug, earlier)));
            }
            if std::mem::replace(&mut self.taken[above][port.index()], true) {
                let other = (earlier.iter()).find(|d| d.place.upstream == Some((above, port)));
                let what =
                    other.map_or("its own cable upstream".into(), |d| format!("\"{}\"", d.name));
                return Err(fail(format!("port {port} of \"{}\" is taken by {what}", device.name)));
            }
        }
        self.taken.push(own);
        Ok(Place { upstream, port: plug.port })
    }

    /// Checks that the first device fits the MainDevice's port.
    fn fits_main_device(&self, keys: &Keys<'_>, plug: Plug<'_>) -> Result<(), FileError> {
        if plug.kind() == self.main {
            return Ok(());
        }
        let hint = match plug.kind() {
            PortKind::Ebus => format!(
                "expected {COUPLER} before it, or [host] port = \"ebus\" for an embedded PC with \
                 terminals at its side"
            ),
            _ => "expected a terminal first, or [host] without port = \"ebus\"".to_owned(),
        };
        let message = plug.misfit("the port of the MainDevice ([host] port)", self.main);
        Err(keys.error(message).with_hint(hint))
    }

    /// A free place for a device that does not fit at its place.
    fn remedy(&self, plug: Plug<'_>, earlier: &[SubDevice]) -> String {
        let free = |(device, port): &(&SubDevice, PortNumber), taken: &[bool; 4]| {
            device.profile.esc().port(*port) == plug.kind() && !taken[port.index()]
        };
        let mut ends = earlier.iter().zip(&self.taken).rev().flat_map(|(device, taken)| {
            PortNumber::ALL.map(|port| ((device, port), taken)).into_iter()
        });
        if let Some(((device, port), _)) = ends.find(|(end, taken)| free(end, taken)) {
            return format!(
                "expected a free port of its kind: connect = \"{}:{port}\"",
                device.name
            );
        }
        match plug.kind() {
            PortKind::Ebus => format!("expected {COUPLER} before it"),
            _ => format!("expected {EXTENSION} before it"),
        }
    }
}

/// Devices that connect copper to terminals, and back.
const COUPLER: &str = "a coupler, such as device = \"beckhoff_ek1100\",";
const EXTENSION: &str = "an EtherCAT extension, such as device = \"beckhoff_ek1110\",";

/// Sorts devices by their positions.
pub(super) fn sort(devices: Vec<SubDevice>) -> Vec<SubDevice> {
    let links: Vec<_> = devices.iter().map(|d| (d.place.upstream, d.place.port)).collect();
    let order = processing_order(&links);
    let mut position = vec![0; order.len()];
    for (new, old) in order.iter().enumerate() {
        position[*old] = new;
    }
    let mut devices: Vec<_> = devices.into_iter().zip(&position).collect();
    devices.sort_by_cached_key(|(_, position)| **position as u64);
    let moved = |(mut device, _): (SubDevice, _)| {
        device.place.upstream = device.place.upstream.map(|(above, port)| (position[above], port));
        device
    };
    devices.into_iter().map(moved).collect()
}

/// Reads the device's own port.
pub(super) fn own_port(keys: &Keys<'_>, profile: &Profile) -> Result<PortNumber, FileError> {
    let port = port_number(keys.get("port")?);
    match keys.value("port") {
        Some(value) if !profile.esc().has_port(port) => {
            let (name, chip, ports) = (&profile.name, chip(profile), ports(profile));
            Err(value.error(format!("{name} ({chip}) has no port {port}; it has {ports}")))
        }
        _ => Ok(port),
    }
}

fn upstream(value: &Value<'_>, above: Earlier<'_>) -> Result<(usize, PortNumber), FileError> {
    let earlier = above.devices;
    let expected = "a device above and its port, such as \"axis 1:3\"";
    let text = value.name(expected)?;
    let (name, port) = text.rsplit_once(':').ok_or_else(|| {
        value.error(format!("connect = \"{text}\" names no port; expected {expected}"))
    })?;
    let (name, port) = (name.trim(), port.trim());
    let port = match port.parse() {
        Ok(number @ 0..=3) => port_number(number),
        _ => {
            let message = format!("connect: \"{port}\" is no port; expected 0 to 3");
            return Err(value.error(message));
        }
    };
    let by_place = || {
        let place: usize = name.parse().ok()?;
        (place < earlier.len()).then_some(place)
    };
    let found = above.find(name).or_else(by_place);
    let found = found.ok_or_else(|| {
        let first = format!("{name} 0");
        if above.find(&first).is_some() {
            let message = format!(
                "connect: \"{name}\" are several devices; expected one of them, such as \"{first}:1\""
            );
            return value.error(message);
        }
        value
            .error(format!("connect: no device \"{name}\" above; expected {expected}"))
            .with_hint(name_hint(name, earlier.iter().map(|device| device.name.as_str())))
    })?;
    Ok((found, port))
}

/// A kind of port in words.
fn word(kind: PortKind) -> &'static str {
    match kind {
        PortKind::Mii => "MII (copper)",
        PortKind::Ebus => "EBUS",
        PortKind::None | PortKind::NotConfigured => "not there",
    }
}

fn port_number(number: i64) -> PortNumber {
    PortNumber::ALL[number as usize & 3]
}

fn chip(profile: &Profile) -> &'static str {
    profile.esc().name
}

/// The ports of a device as text, such as `0, 1`. A chip may have more of them than its device
/// uses.
fn ports(profile: &Profile) -> String {
    let has = PortNumber::ALL.into_iter().filter(|port| profile.esc().has_port(*port));
    has.map(|port| port.to_string()).collect::<Vec<_>>().join(", ")
}
