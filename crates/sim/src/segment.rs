//! The segment: SubDevices in their tree, and frames passing through them.

use isocat_esc::Passing;
use isocat_wire::address::PortNumber;
use isocat_wire::frame;
use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};

use crate::audience::{self, Audience, Item};
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
    audience: Audience,
    /// The datagrams of the frame under way.
    items: Vec<Item>,
    /// By SubDevice: the frame under way latches receive times.
    latched: Vec<bool>,
    any_latched: bool,
    last_frame: Option<Time<True>>,
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
        let audience = Audience::new(path.entries.len());
        let items = Vec::with_capacity(128);
        Self { devices, path, audience, items, latched, any_latched: false, last_frame: None }
    }

    /// The SubDevices, in the order of the connections.
    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    /// One SubDevice.
    pub fn device_mut(&mut self, index: usize) -> &mut Device {
        // Whatever is done to it, the next frame looks.
        let place = self.path.entries.iter().position(|entry| entry.device == index);
        if let Some(place) = place {
            self.audience.disturb(place);
        }
        &mut self.devices[index]
    }

    /// The way of frames.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Sends a frame past all SubDevices, whose first bit leaves the MainDevice at `start`. They
    /// answer in place. Gives the time at which its last bit is back.
    ///
    /// SubDevices that it does not concern are not looked at; what they do by themselves until it
    /// passes happens at their next visit, or with [`Self::catch_up`]. (Should one reset itself from its
    /// own side, the marks that it leaves on frames for others change with that visit.)
    pub fn pass(
        &mut self,
        bytes: &mut [u8],
        start: Time<True>,
        watch: &mut impl FnMut(Observation),
    ) -> Time<True> {
        let duration = Picos(frame::duration_ns(bytes.len()) as i64 * 1000);
        self.last_frame = Some(start);
        if let Ok(offset) = frame::payload_offset(bytes) {
            let mut items = std::mem::take(&mut self.items);
            audience::items(&bytes[offset..], &mut items);
            self.settle(start, watch);
            let one_by_one = self.audience.stops_circulating();
            let visits = self.audience.gather(&items);
            let end = start + duration;
            for number in 0..visits.unwrap_or(self.path.entries.len()) {
                let place = visits.map_or(number, |_| self.audience.visit(number));
                if one_by_one {
                    self.visit_alone(place, bytes, (start, end), watch);
                } else {
                    self.visit(place, &mut items, &mut bytes[offset..], (start, end), watch);
                }
            }
            if !one_by_one {
                self.finish(&items, bytes, offset);
            }
            self.items = items;
        }
        self.latch_returns(start);
        start + self.path.round_trip + duration
    }

    /// Before a frame that leaves at `start`: what may have changed its reach is brought to the frame's
    /// arrival, so that the audience is right.
    fn settle(&mut self, start: Time<True>, watch: &mut impl FnMut(Observation)) {
        for number in (0..self.audience.restless()).rev() {
            let place = self.audience.restless_place(number);
            let entry = self.path.entries[place];
            let device = &mut self.devices[entry.device];
            let begin = device.oscillator().read(start + entry.after);
            device.disturbed();
            device.advance(begin, watch);
            let esc = &mut device.esc;
            esc.begin_frame(begin);
            self.audience.update(place, esc.reach_version(), || esc.reach());
            if !esc.reach_is_changing() {
                self.audience.calm(number);
            }
        }
    }

    /// A frame that was parsed passes a SubDevice.
    fn visit(
        &mut self,
        place: usize,
        items: &mut [Item],
        payload: &mut [u8],
        (start, end): (Time<True>, Time<True>),
        watch: &mut impl FnMut(Observation),
    ) {
        let entry = self.path.entries[place];
        let device = &mut self.devices[entry.device];
        let clock = device.oscillator();
        let begin: Time<DeviceClock> = clock.read(start + entry.after);
        device.advance(begin, watch);
        let esc = &mut device.esc;
        // Only a reset from the device's own side can have come since the audience was gathered.
        self.audience.update(place, esc.reach_version(), || esc.reach());
        esc.begin_frame(begin);
        let mut latch = false;
        for item in items {
            if !self.audience.concerns(place, item) {
                continue;
            }
            let mut passing = Passing {
                command: item.command,
                address: item.address_at(place),
                irq: item.irq,
                wkc: item.wkc,
                data: &mut payload[item.layout.data()..item.layout.wkc()],
            };
            latch |= esc.datagram(&mut passing);
            (item.irq, item.wkc) = (passing.irq, passing.wkc);
        }
        esc.close_frame(clock.read(end + entry.after), true);
        if esc.reach_is_changing() {
            self.audience.disturb(place);
        }
        device.touched();
        if latch {
            device.esc.receive_at_port(entry.port, begin);
            self.latched[entry.device] = true;
            self.any_latched = true;
        }
    }

    /// A frame passes a SubDevice in a segment in which each one has to see all of it.
    fn visit_alone(
        &mut self,
        place: usize,
        bytes: &mut [u8],
        (start, end): (Time<True>, Time<True>),
        watch: &mut impl FnMut(Observation),
    ) {
        let entry = self.path.entries[place];
        let device = &mut self.devices[entry.device];
        let clock = device.oscillator();
        let begin: Time<DeviceClock> = clock.read(start + entry.after);
        device.advance(begin, watch);
        let esc = &mut device.esc;
        let processed = esc.process(bytes, begin, clock.read(end + entry.after), true);
        if esc.reach_is_changing() {
            self.audience.disturb(place);
        }
        device.touched();
        if processed.latch_ports {
            device.esc.receive_at_port(entry.port, begin);
            self.latched[entry.device] = true;
            self.any_latched = true;
        }
    }

    /// Writes what was counted beside the frame into it.
    fn finish(&self, items: &[Item], bytes: &mut [u8], offset: usize) {
        if self.audience.marks_frames() {
            bytes[6] |= frame::LOCALLY_ADMINISTERED;
        }
        let payload = &mut bytes[offset..];
        for item in items {
            let (at, wkc) = (item.layout.start, item.layout.wkc());
            let address = item.address_at(self.path.entries.len());
            payload[at + 2..at + 6].copy_from_slice(&address.to_le_bytes());
            payload[at + 8..at + 10].copy_from_slice(&item.irq.to_le_bytes());
            payload[wkc..wkc + 2].copy_from_slice(&item.wkc.to_le_bytes());
        }
    }

    /// The frame comes back at the ports of those that latch its times.
    fn latch_returns(&mut self, start: Time<True>) {
        if !std::mem::take(&mut self.any_latched) {
            return;
        }
        for back in &self.path.returns {
            if self.latched[back.device] {
                let device = &mut self.devices[back.device];
                let at = device.oscillator().read(start + back.after);
                device.esc.receive_at_port(back.port, at);
            }
        }
        self.latched.fill(false);
    }

    /// Brings every SubDevice to the instant at which the last frame passed it.
    pub fn catch_up(&mut self, watch: &mut impl FnMut(Observation)) {
        let Some(start) = self.last_frame else { return };
        for entry in &self.path.entries {
            let device = &mut self.devices[entry.device];
            device.advance(device.oscillator().read(start + entry.after), watch);
        }
    }

    /// Lets everything happen that happens up to `at` by itself.
    pub fn advance(&mut self, at: Time<True>, watch: &mut impl FnMut(Observation)) {
        for device in &mut self.devices {
            device.disturbed();
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
