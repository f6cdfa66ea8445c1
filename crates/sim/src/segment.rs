//! The segment: SubDevices in their tree, and frames passing through them.

use isocat_esc::{Chip, Passing};
use isocat_subdevice::Misbehaviour;
use isocat_wire::address::PortNumber;
use isocat_wire::datagram::datagrams;
use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};
use isocat_wire::{AlStatusCode, Command, frame, register};

use crate::audience::Audience;
use crate::burst::Burst;
use crate::cable::{Cable, Direction, Phy};
use crate::datagrams::{Datagrams, List};
use crate::device::{Device, DeviceSetup};
use crate::disturbance::{BitError, Cause, Change, Disturbances, Notice, lines};
use crate::fault::RING_CABLE;
use crate::flight::{Flight, duration};
use crate::jitter::{self, Edges};
use crate::next_frame::NextFrame;
use crate::oscillator::Bend;
use crate::path::{Arrival, Loops, Path, Ports, Reception};
use crate::plant::{Acted, PlantSetup};
use crate::probe::{Probed, Probes, Sight};
use crate::returns::Returns;
use crate::watcher::Watcher;
use crate::wiring::{End, MainPort, PortTaken, Stay, Wiring};

/// The place and the parts of a SubDevice.
pub struct Connection {
    /// The SubDevice upstream (its index in the list) and its port; `None`: the MainDevice's
    /// primary port.
    pub parent: Option<(usize, PortNumber)>,
    /// The SubDevice's own port for the cable upstream. Port 0 is correct; any other port is a
    /// swapped cable, which frames pass in reverse.
    pub port: PortNumber,
    /// The cable upstream.
    pub cable: Cable,
    /// The PHYs of its ports; `None`: those of its chip.
    pub phys: Option<[Phy; 4]>,
    /// Whether each hop to it takes a different time for every frame, since its receive FIFOs
    /// transfer frames into its clock ([`isocat_esc::rx_fifo`]). Default yes. Without it, the time
    /// of a hop is constant, and the size of FIFOs (0x0100 bits 18:16) has no effect.
    pub hop_jitter: bool,
    /// The SubDevice.
    pub device: DeviceSetup,
    /// When it gets its power; zero: from the start.
    pub power_on: Time<True>,
}

impl Connection {
    /// A SubDevice behind a port of another one (or of the MainDevice), connected by its port 0;
    /// hops to it jitter.
    pub fn new(parent: Option<(usize, PortNumber)>, cable: Cable, device: DeviceSetup) -> Self {
        let (port, power_on) = (PortNumber::P0, Time::ZERO);
        Self { parent, port, cable, phys: None, hop_jitter: true, device, power_on }
    }
}

/// The cable that makes a segment a ring: it leads from a SubDevice to the MainDevice's secondary
/// port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Closing {
    /// The SubDevice, by its index in the list; usually the last one that frames from the primary
    /// port pass.
    pub device: usize,
    /// Its port; it must be free.
    pub port: PortNumber,
    /// The cable.
    pub cable: Cable,
}

/// All SubDevices behind one MainDevice port, or in a ring between two ports.
///
/// Cables have the numbers of the SubDevices to which they lead; cables laid later
/// ([`Segment::close_ring`]) follow.
///
/// - Frames: [`pass`](Self::pass), [`pass_from`](Self::pass_from), [`pass_all`](Self::pass_all);
/// - changes of cables: [`unplug`](Self::unplug), [`plug`](Self::plug), [`disturb`](Self::disturb),
///   and of SubDevices: [`power_off`](Self::power_off), [`power_on`](Self::power_on), each at a
///   point of true time that no frame has passed yet;
/// - internal events of SubDevices: [`advance`](Self::advance).
pub struct Segment {
    pub(crate) devices: Vec<Device>,
    pub(crate) wiring: Wiring,
    /// By SubDevice: phase of the clock that takes frames from the wire.
    receive_phases: Vec<u64>,
    pub(crate) ports: Ports,
    pub(crate) disturbances: Disturbances,
    /// The way of frames from each MainDevice port, as last computed from the loops.
    pub(crate) paths: [Path; 2],
    /// Whether loops have changed since then.
    pub(crate) stale: bool,
    /// Whether a frame may have changed loops, some of which may still be about to change.
    pub(crate) unsettled: bool,
    /// The audiences of frames from each MainDevice port.
    pub(crate) audiences: [Audience; 2],
    /// The datagrams of the present frame.
    pub(crate) datagrams: Datagrams,
    /// By SubDevice: whether the present frame latches receive times.
    pub(crate) latched: Vec<bool>,
    any_latched: bool,
    pub(crate) next_frame: NextFrame,
    pub(crate) last_frame: Option<(MainPort, Time<True>)>,
    /// When the last frames came back.
    pub(crate) returns: Returns,
    /// Send time of the frame of which the present one is a copy.
    pub(crate) copy_of: Option<Time<True>>,
    /// The SubDevices that the followed frame has met, and its arrivals.
    pub(crate) met: Vec<bool>,
    pub(crate) trail: Vec<Arrival>,
    pub(crate) probes: Probes,
    /// See [`Segment::set_lane`].
    pub(crate) lane: bool,
    /// Frames that pass together.
    pub(crate) burst: Burst,
}

/// A frame that has come back.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Returned {
    /// The port.
    pub port: MainPort,
    /// When its first bit arrives.
    pub first_bit: Time<True>,
    /// When its last bit arrives.
    pub last_bit: Time<True>,
    /// Whether its check sequence is right.
    pub good: bool,
}

/// Why a frame does not come back.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Lost {
    /// An open port has no cable.
    NoCable(End),
    /// A cable was pulled before the last bit had passed.
    Unplugged {
        /// The cable.
        cable: usize,
    },
    /// It was lost between the MainDevice and its port.
    AtThePort,
    /// It was lost at random, on a cable that is whole.
    OnTheWay {
        /// The cable.
        cable: usize,
    },
    /// A closed port does not accept it.
    Closed {
        /// The SubDevice.
        device: usize,
        /// The port.
        port: PortNumber,
    },
    /// An ESC destroyed it: it came for the second time, or is not EtherCAT.
    Destroyed {
        /// The SubDevice.
        device: usize,
    },
    /// It circulates endlessly.
    Circulates,
}

impl Segment {
    /// Switches all SubDevices on, at true time zero or at their own time, with connected cables.
    /// Panics if two cables share a port, or a chip does not have a port with a cable.
    pub fn new(connections: Vec<Connection>, seed: u64) -> Self {
        let wiring = wire(&connections);
        let exists = connections.iter().any(|it| it.device.chip.stamps_next_frame);
        let later: Vec<_> = connections.iter().map(|connection| connection.power_on).collect();
        let devices: Vec<Device> = connections
            .into_iter()
            .enumerate()
            .map(|(position, connection)| Device::new(position, connection.device, seed))
            .collect();
        let count = devices.len();
        let mut segment = Self {
            devices,
            disturbances: Disturbances::default(),
            paths: [Path::default(), Path::default()],
            stale: true,
            unsettled: false,
            audiences: [Audience::new(0), Audience::new(0)],
            datagrams: Datagrams::new(),
            latched: vec![false; count],
            any_latched: false,
            next_frame: NextFrame::new(exists),
            last_frame: None,
            returns: Returns::new(),
            copy_of: None,
            met: vec![false; count],
            trail: Vec::new(),
            probes: Probes::default(),
            lane: true,
            burst: Burst::default(),
            receive_phases: (0..count).map(|position| jitter::phase(seed, position)).collect(),
            ports: Ports::new(count),
            wiring,
        };
        for cable in 0..segment.wiring.cables() {
            segment.link_up(cable);
        }
        segment.refresh(Time::ZERO);
        let mut later: Vec<_> =
            later.into_iter().enumerate().filter(|(_, at)| *at > Time::ZERO).collect();
        later.sort_by_cached_key(|(_, at)| at.count());
        for (device, _) in &later {
            segment.power_off(*device, Time::ZERO);
        }
        for (device, at) in later {
            segment.power_on(device, at);
        }
        segment
    }

    /// Connects a free port of a SubDevice, usually the last one, with the MainDevice's secondary
    /// port. Returns the number of the cable.
    pub fn close_ring(
        &mut self,
        device: usize,
        port: PortNumber,
        cable: Cable,
    ) -> Result<usize, PortTaken> {
        let (from, to) = (End::Port(device, port), End::Main(MainPort::Secondary));
        let number = self.wiring.connect(from, to, cable)?;
        self.link_up(number);
        self.refresh(Time::ZERO);
        Ok(number)
    }

    /// Lays the cable that closes the ring, if there is one. Panics if a port is not free.
    pub fn in_ring(mut self, closing: Option<Closing>) -> Self {
        if let Some(Closing { device, port, cable }) = closing
            && let Err(PortTaken(end)) = self.close_ring(device, port, cable)
        {
            panic!(
                "the ring is closed at port {port} of SubDevice {device}, but {end:?} has a cable already"
            );
        }
        self
    }

    /// Sets whether regular operation takes the fast lane, which is the default. All events are
    /// bit-identical with and without it: only the duration of the simulation depends on it.
    pub fn set_lane(&mut self, on: bool) {
        self.lane = on;
        for device in &mut self.devices {
            device.set_lane(on);
        }
    }

    /// Records frames that enter and leave a SubDevice that processes them; without effect if there
    /// is none.
    pub fn probe(&mut self, device: usize) {
        if device < self.devices.len() {
            self.probes.watch(device);
        }
    }

    /// Records frames on the cable at port 0 of a SubDevice, in both directions; without effect if
    /// there is none. All frames are then followed from port to port.
    pub fn tap(&mut self, device: usize) {
        if device < self.devices.len() {
            self.probes.tap(device);
        }
    }

    /// Takes the frames that probes and taps recorded since the last call.
    pub(crate) fn take_probed(&mut self) -> impl Iterator<Item = Probed> + '_ {
        self.probes.take()
    }

    /// The number of the cable that a fault names: [`RING_CABLE`](crate::fault::RING_CABLE) is the
    /// one that closes the ring. Panics if it is named but does not exist.
    pub(crate) fn cable_number(&self, meant: usize) -> usize {
        match meant {
            RING_CABLE => {
                let closing = self.wiring.hop(End::Main(MainPort::Secondary));
                closing
                    .expect("a fault of the cable that closes a ring, where there is no ring")
                    .cable
            }
            number => number,
        }
    }

    /// The SubDevices, in the order of the connections.
    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    /// One SubDevice.
    pub fn device_mut(&mut self, index: usize) -> &mut Device {
        // The device may be changed in any way, so the next frame rebuilds the audiences.
        self.forget_audiences();
        self.devices[index].disturbed();
        &mut self.devices[index]
    }

    /// Changes the speed of a SubDevice's oscillator; see [`Device::bend_clock`]. Its ports forward
    /// frames by this oscillator.
    pub(crate) fn bend_clock(&mut self, index: usize, bends: &[Bend]) {
        self.device_mut(index).bend_clock(bends);
        self.stale = true;
    }

    /// The cables and delays.
    pub fn wiring(&self) -> &Wiring {
        &self.wiring
    }

    /// The way of frames from the primary port, with the times of the last frame sent.
    pub fn path(&self) -> &Path {
        self.path_from(MainPort::Primary)
    }

    /// The way of frames from a port, with the times of the last frame sent.
    pub fn path_from(&self, port: MainPort) -> &Path {
        &self.paths[port as usize]
    }

    /// Pulls a cable; the number of a SubDevice names the cable upstream of it. Panics if it was
    /// changed later than `at`, or does not exist.
    pub fn unplug(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.cut(&self.wiring, line, at, Cause::Pulled);
        }
    }

    /// Plugs a cable in again. Panics if it was changed later than `at`, or does not exist.
    pub fn plug(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.restore(&self.wiring, line, at, Cause::Pulled);
        }
    }

    /// Breaks one direction of a cable: the ESC at the receiving end loses its link, the other one
    /// keeps it and sends without effect. Panics as [`unplug`](Self::unplug) does.
    pub fn break_way(&mut self, cable: usize, direction: Direction, at: Time<True>) {
        self.disturbances.cut(&self.wiring, (cable, direction), at, Cause::Broken);
    }

    /// Repairs one direction of a cable. Panics as [`unplug`](Self::unplug) does.
    pub fn mend_way(&mut self, cable: usize, direction: Direction, at: Time<True>) {
        self.disturbances.restore(&self.wiring, (cable, direction), at, Cause::Broken);
    }

    /// Takes the link of the MainDevice's port at a cable away: the cable is cut as if it was
    /// pulled, independent of other changes.
    pub(crate) fn take_link(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.cut(&self.wiring, line, at, Cause::NoPort);
        }
    }

    /// Restores the link of the port.
    pub(crate) fn restore_link(&mut self, cable: usize, at: Time<True>) {
        for line in lines(cable) {
            self.disturbances.restore(&self.wiring, line, at, Cause::NoPort);
        }
    }

    /// Replaces a cable so fast that no link is lost. Takes effect with the next frame. Panics if
    /// there is no cable with this number.
    pub fn replace_cable(&mut self, number: usize, cable: Cable) {
        self.wiring.replace(number, cable);
        self.stale = true;
    }

    /// The same with a cable of another length, mm, with an equal signal speed.
    pub(crate) fn relay(&mut self, number: usize, millimetres: u64) {
        let old = *self.wiring.cable(number).0;
        let new = Cable {
            link_loss: old.link_loss,
            link_gain: old.link_gain,
            ..Cable::of_length(millimetres)
        };
        self.replace_cable(number, new);
    }

    /// Switches a SubDevice off. From `at` on it does nothing, and its neighbours lose their links
    /// to it as if all its cables were pulled. Panics if it, or one of its cables, was changed
    /// later than `at`.
    pub fn power_off(&mut self, device: usize, at: Time<True>) {
        self.disturbances.power(&self.wiring, device, at, false);
    }

    /// Switches a SubDevice on again: it starts in INIT with the reset values of all registers, but
    /// keeps the content of its EEPROM. Its local time begins at 0. Links come back as after
    /// plugging in, over cables that are not pulled and whose other end has power. Panics if it, or
    /// one of its cables, was changed later than `at`.
    pub fn power_on(&mut self, device: usize, at: Time<True>) {
        self.disturbances.power(&self.wiring, device, at, true);
    }

    /// Checks that a SubDevice with this chip can replace another: it needs ports of the same kind
    /// at all cables. Otherwise returns the first port that is missing.
    pub fn takes(&self, position: usize, chip: &Chip) -> Result<(), PortNumber> {
        let old = self.devices[position].esc.chip();
        let wired = |port: &PortNumber| self.wiring.hop(End::Port(position, *port)).is_some();
        let missing = |port: &PortNumber| chip.port(*port) != old.port(*port);
        PortNumber::ALL.into_iter().filter(wired).find(missing).map_or(Ok(()), Err)
    }

    /// Replaces a SubDevice by another one. It has no power yet, and the old one must have none;
    /// its chip must have the ports at which there are cables. Panics otherwise.
    pub(crate) fn replace_device(&mut self, position: usize, setup: DeviceSetup, seed: u64) {
        assert!(!self.devices[position].is_powered(), "SubDevice {position} has its power still");
        if let Err(port) = self.takes(position, &setup.chip) {
            panic!("the other SubDevice {position} has no such port {port}");
        }
        self.wiring.replace_stay(position, &setup.chip);
        self.next_frame.note_chip(&setup.chip);
        let mut device = Device::new(position, setup, seed);
        device.set_lane(self.lane);
        device.power_off(Time::ZERO, &mut Watcher::blind());
        self.devices[position].hand_over_plant(&mut device);
        self.devices[position] = device;
        self.stale = true;
        self.forget_audiences();
    }

    /// The first instant without any frame in flight: `at`, or after the last frame.
    pub(crate) fn behind_frames(&self, at: Time<True>) -> Time<True> {
        let Some((from, start)) = self.last_frame else { return at };
        at.max(start + self.paths[from as usize].round_trip + duration(frame::MAX_LEN))
    }

    /// Writes a register of one SubDevice like a frame that only it sees.
    pub(crate) fn write_register(
        &mut self,
        device: usize,
        at: Time<True>,
        address: u16,
        data: &[u8],
        watch: &mut Watcher,
    ) {
        let device = self.device_mut(device);
        device.write_register(device.oscillator().read(at), address, data, watch);
    }

    /// Begins or ends a misbehaviour of a SubDevice.
    pub(crate) fn misbehave(
        &mut self,
        device: usize,
        at: Time<True>,
        how: Misbehaviour,
        begins: bool,
    ) {
        let device = self.device_mut(device);
        device.misbehave(device.oscillator().read(at), how, begins);
    }

    /// Lets the application of a SubDevice fail.
    pub(crate) fn fail_device(
        &mut self,
        device: usize,
        at: Time<True>,
        code: AlStatusCode,
        watch: &mut Watcher,
    ) {
        let device = self.device_mut(device);
        device.fail(device.oscillator().read(at), code, watch);
    }

    /// Flips a bit on a cable.
    pub fn disturb(&mut self, error: BitError) {
        self.disturbances.disturb(error);
    }

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

    /// Attaches a plant to the SubDevice that it names.
    pub(crate) fn attach(&mut self, plant: PlantSetup) {
        self.devices[plant.device].attach(plant);
    }

    /// Takes the actions on the plant of a SubDevice since the last call, in order; empty without a
    /// plant.
    pub(crate) fn take_acted(&mut self, device: usize) -> impl Iterator<Item = Acted> + '_ {
        self.devices[device].take_acted()
    }

    /// Advances every SubDevice to the instant at which the last frame passed it.
    pub fn catch_up(&mut self, watch: &mut Watcher) {
        let Some((from, start)) = self.last_frame else { return };
        for entry in &self.paths[from as usize].entries {
            let device = &mut self.devices[entry.device];
            let at = device.oscillator().read(start + entry.after);
            device.advance(device.behind_looks(at), watch);
        }
    }

    /// Called after a change that the audiences do not know: the next frame rebuilds them.
    pub(crate) fn forget_audiences(&mut self) {
        self.burst.forget();
        self.audiences = [MainPort::Primary, MainPort::Secondary]
            .map(|port| Audience::new(self.paths[port as usize].entries.len()));
    }

    /// Processes all internal events up to `at`. Only valid if SubDevices were changed by frames
    /// and cables alone; no later frame may come earlier. It is cheaper than
    /// [`advance`](Self::advance).
    pub fn live(&mut self, at: Time<True>, watch: &mut Watcher) {
        while let Some(notice) = self.disturbances.take_notice(at, None) {
            self.notice(notice, true, watch);
        }
        for device in &mut self.devices {
            let limit = device.oscillator().read(at);
            device.advance(device.behind_looks(limit), watch);
            self.stale |= device.ports_changed();
        }
    }

    /// Processes all internal events up to `at`.
    pub fn advance(&mut self, at: Time<True>, watch: &mut Watcher) {
        while let Some(notice) = self.disturbances.take_notice(at, None) {
            self.notice(notice, true, watch);
        }
        for device in &mut self.devices {
            device.disturbed();
            let limit = device.oscillator().read(at);
            device.advance(device.behind_looks(limit), watch);
        }
    }

    /// Prepares a frame: applies the links that have changed by then, and computes the new ways.
    pub(crate) fn settle(&mut self, start: Time<True>, watch: &mut Watcher) {
        while let Some(notice) = self.disturbances.take_notice(start, None) {
            self.notice(notice, true, watch);
        }
        if self.unsettled && !self.devices.iter().any(|device| device.esc.loops_pending()) {
            self.unsettled = false;
            self.stale = true;
        }
        if self.stale {
            self.refresh(start);
        }
    }

    /// Applies a change of a SubDevice's power or link. With `advance`, its events before the
    /// change are processed first; no frame may then come earlier.
    pub(crate) fn notice(&mut self, notice: Notice, advance: bool, watch: &mut Watcher) {
        let device = &mut self.devices[notice.device];
        let at = device.oscillator().read(notice.at);
        if advance {
            device.advance(device.behind_looks(at), watch);
        }
        match notice.change {
            Change::Link { port, link, .. } if device.is_powered() => {
                device.esc.set_port(port, link);
                device.disturbed();
            }
            Change::Link { .. } | Change::Way => {}
            Change::Power(false) => device.power_off(at, watch),
            Change::Power(true) => device.power_on(at),
        }
        self.stale = true;
    }

    /// Gives both ends of a cable a link from the start.
    fn link_up(&mut self, cable: usize) {
        for end in self.wiring.cable(cable).1 {
            if let End::Port(device, port) = end {
                let esc = &mut self.devices[device].esc;
                let name = esc.chip().name;
                assert!(
                    esc.chip().has_port(port),
                    "{name} (SubDevice {device}) has no port {port}"
                );
                esc.set_port(port, true);
            }
        }
    }

    /// The additional time at a port of a SubDevice for received frames, by its present DL control.
    fn reception(&self, device: usize, port: PortNumber) -> Reception {
        if !self.wiring.stay(device).hop_jitter {
            return Reception::default();
        }
        let esc = &self.devices[device].esc;
        let receiver = esc.chip().receiver(port, esc.register(register::DL_CONTROL));
        let oscillator = self.devices[device].oscillator();
        let edges = Edges::new(receiver.period, self.receive_phases[device], oscillator);
        Reception { edges, sooner: receiver.reduction }
    }

    /// When a port of a SubDevice forwards a frame that arrives at `at` by the delays of the
    /// wiring.
    pub(crate) fn received(
        &mut self,
        (device, port): (usize, PortNumber),
        at: Time<True>,
        duration: Picos,
    ) -> Time<True> {
        let Reception { edges, sooner } = self.reception(device, port);
        let at = at + Picos(-sooner.0);
        let at = edges.forward(at, || self.devices[device].oscillator());
        // Without jitter gaps stay as they are.
        if edges.are_there() {
            self.ports.take(Ports::place(device, port), at, duration)
        } else {
            at
        }
    }

    /// Computes the ways of frames at `at` again.
    fn refresh(&mut self, at: Time<True>) {
        for device in &mut self.devices {
            device.clear_ports_changed();
        }
        let devices = &self.devices;
        let loops = |device: usize| Loops::of(devices[device].esc.dl_status());
        let carries = |line| self.disturbances.carries(line, at, at);
        self.paths = [MainPort::Primary, MainPort::Secondary].map(|port| {
            let reception = |device, port| self.reception(device, port);
            Path::over(&self.wiring, loops, carries, reception, port)
        });
        self.stale = false;
        self.datagrams.forget();
        self.find_waiting_ports();
        self.forget_audiences();
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

/// The order in which SubDevices with these connections process frames: for each its parent and the
/// parent's port, and its own port upstream. It is the order of their positions.
pub fn processing_order(links: &[(Option<(usize, PortNumber)>, PortNumber)]) -> Vec<usize> {
    let phys = [Phy::default(); 4];
    let stay = Stay { processing: Picos(1), forwarding: Picos(1), phys, hop_jitter: false };
    let mut wiring = Wiring::new(vec![stay; links.len()]);
    for (device, (parent, port)) in links.iter().enumerate() {
        lay(&mut wiring, *parent, (device, *port), Cable::default());
    }
    let loops = |device| {
        let wired = |port: &PortNumber| wiring.hop(End::Port(device, *port)).is_some();
        let open: Vec<_> = PortNumber::ALL.into_iter().filter(wired).collect();
        Loops::open(&open)
    };
    let path = Path::new(&wiring, loops, MainPort::Primary);
    path.entries.iter().map(|entry| entry.device).collect()
}

fn wire(connections: &[Connection]) -> Wiring {
    let stay = |connection: &Connection| {
        let stay = Stay::of(&connection.device.chip);
        let phys = connection.phys.unwrap_or(stay.phys);
        Stay { phys, hop_jitter: connection.hop_jitter, ..stay }
    };
    let mut wiring = Wiring::new(connections.iter().map(stay).collect());
    for (device, connection) in connections.iter().enumerate() {
        lay(&mut wiring, connection.parent, (device, connection.port), connection.cable);
    }
    wiring
}

fn lay(
    wiring: &mut Wiring,
    parent: Option<(usize, PortNumber)>,
    (device, port): (usize, PortNumber),
    cable: Cable,
) {
    let from = match parent {
        Some((parent, port)) => {
            assert!(
                parent < wiring.devices(),
                "SubDevice {device} hangs on {parent}, which is none"
            );
            End::Port(parent, port)
        }
        None => End::Main(MainPort::Primary),
    };
    if let Err(PortTaken(end)) = wiring.connect(from, End::Port(device, port), cable) {
        panic!("SubDevice {device} hangs on {from:?}, but {end:?} has a cable already");
    }
}
