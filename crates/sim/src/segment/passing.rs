//! How one frame passes the segment.

use isocat_esc::Passing;
use isocat_wire::datagram::datagrams;
use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};
use isocat_wire::{Command, frame};

use super::{Lost, Returned, Segment};
use crate::audience::Audience;
use crate::datagrams::List;
use crate::device::Device;
use crate::flight::{Flight, duration};
use crate::path::Arrival;
use crate::probe::{Probed, Sight};
use crate::watcher::Watcher;
use crate::wiring::MainPort;

impl Segment {
    /// Passes a frame through the SubDevices from the primary port; see [`Segment::pass_from`].
    pub fn pass(
        &mut self,
        bytes: &mut [u8],
        start: Time<True>,
        watch: &mut Watcher,
    ) -> Result<Returned, Lost> {
        self.pass_from(MainPort::Primary, bytes, start, watch)
    }

    /// Passes a frame as [`pass_from`](Self::pass_from) does, or a copy of the frame that left at
    /// `first`: the data of a copy counts as that of the original.
    pub(crate) fn pass_copy(
        &mut self,
        from: MainPort,
        bytes: &mut [u8],
        (first, start): (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) -> Result<Returned, Lost> {
        self.copy_of = Some(first);
        let fate = self.pass_from(from, bytes, start, watch);
        self.copy_of = None;
        fate
    }

    /// Passes a frame through the SubDevices; its first bit leaves a port of the MainDevice at
    /// `start`. The SubDevices answer in place. Returns where and when it comes back.
    pub fn pass_from(
        &mut self,
        from: MainPort,
        bytes: &mut [u8],
        start: Time<True>,
        watch: &mut Watcher,
    ) -> Result<Returned, Lost> {
        let fate = self.pass_alone(from, bytes, start, watch);
        if let Ok(returned) = fate {
            self.returns.note(self.copy_of.unwrap_or(start), start, returned.last_bit);
        }
        fate
    }

    fn pass_alone(
        &mut self,
        from: MainPort,
        bytes: &mut [u8],
        start: Time<True>,
        watch: &mut Watcher,
    ) -> Result<Returned, Lost> {
        self.settle(start, watch);
        self.datagrams.read(from, bytes);
        self.unsettled |= self.datagrams.present().cyclic.is_none() && may_change_loops(bytes);
        let duration = duration(bytes.len());
        let (path, devices) = (&mut self.paths[from as usize], &self.devices);
        path.time((start, duration), &mut self.ports, |device| devices[device].oscillator());
        let round_trip = path.round_trip;
        let last_bit = start + round_trip + duration;
        let quiet = !self.unsettled && self.disturbances.are_quiet(start, last_bit);
        let quiet = quiet && !self.probes.are_in_cables();
        let port = match path.end {
            // Against the order of a whole ring no SubDevice processes it.
            Some(port) if quiet && path.entries.is_empty() => {
                self.remember_frame(from, start);
                return Ok(Returned { port, first_bit: start + round_trip, last_bit, good: true });
            }
            Some(port) if quiet && path.processed_first => port,
            _ => {
                let fate = self.fly(Flight::new(bytes, start), from, watch);
                self.forget_audiences();
                self.latched.fill(false);
                if fate.is_ok() {
                    self.remember_frame(from, start);
                }
                return fate;
            }
        };
        self.last_frame = Some((from, start));
        let times = (start, start + duration);
        self.settle_audience(from, start, watch);
        let fate = match self.datagrams.present().offset {
            Some(offset) if !self.audiences[from as usize].stops_circulating() => {
                self.pass_to_audience(from, (bytes, offset), times, watch);
                Ok(())
            }
            _ => self.pass_to_all(from, bytes, times, watch),
        };
        self.latch_returns(from, start);
        fate?;
        self.remember_frame(from, start);
        Ok(Returned { port, first_bit: start + round_trip, last_bit, good: true })
    }

    /// Passes a frame to the SubDevices that its datagrams may concern.
    ///
    /// The other SubDevices are not visited; their internal events until then are processed at
    /// their next visit, or with [`Self::catch_up`]. (If one of them resets itself or opens a loop,
    /// the way of frames changes with that visit.)
    fn pass_to_audience(
        &mut self,
        from: MainPort,
        (bytes, offset): (&mut [u8], usize),
        times: (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) {
        let visits = self.audiences[from as usize].gather(&self.datagrams.present().items);
        let places = self.paths[from as usize].entries.len();
        if self.pass_cyclic((from, visits), &mut bytes[offset..], times, watch) {
            return self.finish(from, bytes, offset, places);
        }
        let mut watched = self.watched_places(from).into_iter().peekable();
        for number in 0..visits.unwrap_or(places) {
            let place = visits.map_or(number, |_| self.audiences[from as usize].visit(number));
            while let Some(passed) = watched.next_if(|at| *at < place) {
                self.look((from, passed), false, (bytes, offset), times.0);
                self.look((from, passed), true, (bytes, offset), times.0);
            }
            let is_watched = watched.next_if_eq(&place).is_some();
            if is_watched {
                self.look((from, place), false, (bytes, offset), times.0);
            }
            self.offer((from, place), &mut bytes[offset..], times, watch);
            if is_watched {
                self.look((from, place), true, (bytes, offset), times.0);
            }
        }
        for passed in watched {
            self.look((from, passed), false, (bytes, offset), times.0);
            self.look((from, passed), true, (bytes, offset), times.0);
        }
        self.finish(from, bytes, offset, places);
    }

    /// Places with a probe on the way from a port, in processing order.
    fn watched_places(&self, from: MainPort) -> Vec<usize> {
        if self.probes.are_none() {
            return Vec::new();
        }
        let entries = self.paths[from as usize].entries.iter().enumerate();
        entries.filter(|(_, entry)| self.probes.sees(entry.device)).map(|(at, _)| at).collect()
    }

    /// Shows a probe the frame as it enters or (`processed`) leaves its place. Values that were
    /// counted separately are written into a copy.
    #[inline(never)]
    fn look(
        &mut self,
        (from, place): (MainPort, usize),
        processed: bool,
        (bytes, offset): (&[u8], usize),
        start: Time<True>,
    ) {
        let mut seen = bytes.to_vec();
        self.finish(from, &mut seen, offset, place + usize::from(processed));
        let entry = self.paths[from as usize].entries[place];
        self.show(start, entry, processed, seen);
    }

    /// Shows a probe a frame that arrived at its SubDevice.
    pub(crate) fn show(
        &mut self,
        start: Time<True>,
        arrival: Arrival,
        processed: bool,
        bytes: Vec<u8>,
    ) {
        let device = arrival.device;
        let stay = if processed { self.wiring.stay(device).processing } else { Picos::ZERO };
        let at = start + arrival.after + stay;
        let sight = if processed { Sight::Leaves } else { Sight::Enters };
        self.probes.see(Probed { device, at, sight, bytes });
    }

    /// Passes a frame to all SubDevices, if each must process all of it.
    fn pass_to_all(
        &mut self,
        from: MainPort,
        bytes: &mut [u8],
        times: (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) -> Result<(), Lost> {
        for place in 0..self.paths[from as usize].entries.len() {
            let device = self.offer_whole((from, place), bytes, times, watch);
            if let Some(device) = device {
                return Err(Lost::Destroyed { device });
            }
        }
        Ok(())
    }

    /// Prepares a frame that leaves at `start`: SubDevices whose reach may have changed are
    /// advanced to the frame's arrival, so that the audience is right.
    fn settle_audience(&mut self, from: MainPort, start: Time<True>, watch: &mut Watcher) {
        let audience = &mut self.audiences[from as usize];
        for number in (0..audience.restless()).rev() {
            let place = audience.restless_place(number);
            let entry = self.paths[from as usize].entries[place];
            let device = &mut self.devices[entry.device];
            let begin = device.oscillator().read(start + entry.after);
            device.disturbed();
            device.advance(begin, watch);
            self.stale |= device.ports_changed();
            let esc = &mut device.esc;
            esc.begin_frame(begin);
            audience.update(place, esc.reach_version(), || esc.reach());
            if !esc.reach_is_changing() {
                audience.calm(number);
            }
        }
    }

    /// Passes a parsed frame to a SubDevice.
    fn offer(
        &mut self,
        (from, place): (MainPort, usize),
        payload: &mut [u8],
        (start, end): (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) {
        let audience = &mut self.audiences[from as usize];
        let entry = self.paths[from as usize].entries[place];
        let device = &mut self.devices[entry.device];
        let begin: Time<DeviceClock> = device.oscillator().read(start + entry.after);
        device.advance(begin, watch);
        self.stale |= device.ports_changed();
        // Since the audience was gathered, only a reset by the device itself is possible.
        audience.update(place, device.esc.reach_version(), || device.esc.reach());
        self.answer((from, place), begin, payload, (start, end));
    }

    /// Lets a SubDevice answer the present frame, which arrives there at `begin`.
    pub(crate) fn answer(
        &mut self,
        (from, place): (MainPort, usize),
        begin: Time<DeviceClock>,
        payload: &mut [u8],
        (start, end): (Time<True>, Time<True>),
    ) {
        let entry = self.paths[from as usize].entries[place];
        let sent = self.copy_of.unwrap_or(start);
        let device = &mut self.devices[entry.device];
        let audience = &mut self.audiences[from as usize];
        let list = self.datagrams.present_mut();
        if answer((device, audience, place), begin, (list, payload), (sent, end + entry.after)) {
            self.devices[entry.device].esc.receive_at_port(entry.port, begin);
            self.latched[entry.device] = true;
            self.any_latched = true;
        }
    }

    /// Passes a frame to a SubDevice that must process all of it; returns the SubDevice if it
    /// destroys the frame.
    fn offer_whole(
        &mut self,
        (from, place): (MainPort, usize),
        bytes: &mut [u8],
        (start, end): (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) -> Option<usize> {
        let entry = self.paths[from as usize].entries[place];
        let device = &mut self.devices[entry.device];
        let begin: Time<DeviceClock> = device.oscillator().read(start + entry.after);
        device.advance(begin, watch);
        self.stale |= device.ports_changed();
        let end = device.oscillator().read(end + entry.after);
        let before = self.probes.sees(entry.device).then(|| bytes.to_vec());
        let processed = device.esc.process(bytes, begin, end, true);
        if device.esc.reach_is_changing() {
            self.audiences[from as usize].disturb(place);
        }
        device.touched(self.copy_of.unwrap_or(start));
        if processed.latch_ports {
            device.esc.receive_at_port(entry.port, begin);
            self.latched[entry.device] = true;
            self.any_latched = true;
        }
        if let Some(before) = before {
            self.show(start, entry, false, before);
            if !processed.destroyed {
                self.show(start, entry, true, bytes.to_vec());
            }
        }
        processed.destroyed.then_some(entry.device)
    }

    /// Writes the values that were counted separately into the frame: those of this number of
    /// places.
    fn finish(&self, from: MainPort, bytes: &mut [u8], offset: usize, places: usize) {
        if self.audiences[from as usize].marks_frames(places) {
            bytes[6] |= frame::LOCALLY_ADMINISTERED;
        }
        self.datagrams.present().write_counts(&mut bytes[offset..], places);
    }

    /// Latches the return of the frame at the ports of SubDevices that latch its times.
    fn latch_returns(&mut self, from: MainPort, start: Time<True>) {
        if !std::mem::take(&mut self.any_latched) {
            return;
        }
        if self.next_frame.exists() {
            let own = self.paths[from as usize].returns.clone();
            self.stamp_next_frames(start, &own);
        }
        for back in &self.paths[from as usize].returns {
            if self.latched[back.device] {
                let device = &mut self.devices[back.device];
                let at = device.oscillator().read(start + back.after);
                device.esc.receive_at_port(back.port, at);
            }
        }
        self.latched.fill(false);
    }
}

/// Lets the SubDevice at a place answer a frame that arrives there at `begin`; `sent`: when its
/// first bit left the MainDevice. Returns whether it latches the receive times of the frame.
pub(crate) fn answer(
    (device, audience, place): (&mut Device, &mut Audience, usize),
    begin: Time<DeviceClock>,
    (list, payload): (&mut List, &mut [u8]),
    (sent, end): (Time<True>, Time<True>),
) -> bool {
    let esc = &mut device.esc;
    esc.begin_good_frame(begin);
    let mut latch = false;
    for item in &mut list.items {
        if !audience.concerns(place, item) {
            continue;
        }
        if let Some(usual) = item.usual {
            let data = &mut payload[item.layout.data()..item.layout.wkc()];
            if let Some(count) = esc.answer(usual, item.address_at(place), data) {
                item.wkc = item.wkc.wrapping_add(count);
                item.irq |= esc.irq();
                continue;
            }
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
    let end = device.oscillator().read(end);
    device.esc.close_frame(end, true);
    if device.esc.reach_is_changing() {
        audience.disturb(place);
    }
    device.touched(sent);
    latch
}

/// Whether a frame writes DL control or resets ESCs. Frames are then followed port by port until
/// all loops have settled; a write through an FMMU is found at the next visit.
fn may_change_loops(bytes: &[u8]) -> bool {
    let Ok(payload) = frame::payload(bytes) else { return false };
    datagrams(payload).map_while(Result::ok).any(|datagram| {
        let header = datagram.header;
        let writes = header.command().is_ok_and(|command| {
            use Command::*;
            matches!(command, Apwr | Aprw | Fpwr | Fprw | Bwr | Brw | Armw | Frmw)
        });
        let first = usize::from(header.ado());
        let written = first..first + datagram.data.len();
        writes && LOOPS.iter().any(|range| range.start < written.end && written.start < range.end)
    })
}

/// Registers that change loops: ESC reset, DL control.
const LOOPS: [std::ops::Range<usize>; 2] = [0x0040..0x0041, 0x0100..0x0104];
