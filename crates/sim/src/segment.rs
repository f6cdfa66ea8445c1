//! The segment: SubDevices in their tree, and frames passing through them.

mod changes;
mod passing;

use isocat_wire::address::PortNumber;
use isocat_wire::register;
use isocat_wire::time::{Picos, Time, True};

use crate::audience::Audience;
use crate::burst::Burst;
use crate::cable::{Cable, Phy};
use crate::datagrams::Datagrams;
use crate::device::{Device, DeviceSetup};
use crate::disturbance::{Change, Disturbances, Notice};
use crate::fault::RING_CABLE;
use crate::jitter::{self, Edges};
use crate::next_frame::NextFrame;
use crate::oscillator::Bend;
use crate::path::{Arrival, Loops, Path, Ports, Reception};
use crate::plant::{Acted, PlantSetup};
use crate::probe::{Probed, Probes};
use crate::returns::Returns;
use crate::watcher::Watcher;
use crate::wiring::{End, MainPort, PortTaken, Stay, Wiring};
pub(crate) use passing::answer;

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
