//! The segment: SubDevices in their tree, and frames passing through them.

use isocat_wire::address::PortNumber;
use isocat_wire::frame;
use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};

use crate::device::{Device, DeviceSetup};
use crate::observation::Observation;
use crate::path::{PICOS_PER_MILLIMETRE, Path, Place};

/// Where a SubDevice hangs, and what it is.
pub struct Connection {
    /// The SubDevice upstream (its index in the list) and its port; `None` hangs on the MainDevice.
    pub parent: Option<(usize, PortNumber)>,
    /// Length of the cable upstream, mm.
    pub cable_mm: u64,
    /// The SubDevice.
    pub device: DeviceSetup,
}

/// All SubDevices behind one MainDevice port.
pub struct Segment {
    devices: Vec<Device>,
    path: Path,
    latched: Vec<bool>,
}

impl Segment {
    /// Switches all SubDevices on at true time zero, cables connected.
    pub fn new(connections: Vec<Connection>, seed: u64) -> Self {
        let places: Vec<Place> = connections.iter().map(|c| place(&connections, c)).collect();
        let path = Path::new(&places);
        let mut devices: Vec<Device> = connections
            .into_iter()
            .enumerate()
            .map(|(position, connection)| Device::new(position, connection.device, seed))
            .collect();
        for (i, place) in places.iter().enumerate() {
            devices[i].esc.set_port(PortNumber::P0, true);
            if let Some((parent, port)) = place.parent {
                devices[parent].esc.set_port(port, true);
            }
        }
        let latched = vec![false; devices.len()];
        Self { devices, path, latched }
    }

    /// The SubDevices, in the order of the connections.
    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    /// One SubDevice.
    pub fn device_mut(&mut self, index: usize) -> &mut Device {
        &mut self.devices[index]
    }

    /// The way of frames.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Sends a frame through all SubDevices, whose first bit leaves the MainDevice at `start`. They
    /// answer in place. Gives the time at which its last bit is back.
    pub fn pass(
        &mut self,
        bytes: &mut [u8],
        start: Time<True>,
        watch: &mut impl FnMut(Observation),
    ) -> Time<True> {
        let duration = Picos(frame::duration_ns(bytes.len()) as i64 * 1000);
        let mut any_latched = false;
        for entry in &self.path.entries {
            let device = &mut self.devices[entry.device];
            let at = start + entry.after;
            let clock = device.oscillator();
            let (begin, end): (Time<DeviceClock>, _) = (clock.read(at), clock.read(at + duration));
            device.advance(begin, watch);
            let processed = device.esc.process(bytes, begin, end, true);
            self.latched[entry.device] = processed.latch_ports;
            if processed.latch_ports {
                any_latched = true;
                device.esc.receive_at_port(entry.port, begin);
            }
        }
        if any_latched {
            for back in &self.path.returns {
                if self.latched[back.device] {
                    let device = &mut self.devices[back.device];
                    let at = device.oscillator().read(start + back.after);
                    device.esc.receive_at_port(back.port, at);
                }
            }
        }
        start + self.path.round_trip + duration
    }

    /// Lets everything happen that happens up to `at` by itself.
    pub fn advance(&mut self, at: Time<True>, watch: &mut impl FnMut(Observation)) {
        for device in &mut self.devices {
            let limit = device.oscillator().read(at);
            device.advance(limit, watch);
        }
    }
}

/// How frames feel a connection: cable, the PHYs at its ends, and the ESC.
fn place(all: &[Connection], connection: &Connection) -> Place {
    let chip = connection.device.chip;
    let upstream = match connection.parent {
        Some((parent, port)) => all[parent].device.chip.port_delay(port),
        // The MainDevice's own controller belongs to its host.
        None => Picos::ZERO,
    };
    let cable = Picos(connection.cable_mm as i64 * PICOS_PER_MILLIMETRE);
    Place {
        parent: connection.parent,
        link: upstream + cable + chip.port_delay(PortNumber::P0),
        processing: chip.processing_delay,
        forwarding: chip.forwarding_delay,
    }
}
