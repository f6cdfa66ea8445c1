//! The connections of the segment: the MainDevice's ports, the ESCs' ports, and the cables between
//! them.

use isocat_esc::Chip;
use isocat_maindevice::Port;
use isocat_wire::PortNumber;
use isocat_wire::time::Picos;

use crate::cable::{Cable, Direction, Phy};

/// A network port of the MainDevice.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum MainPort {
    /// The port that every MainDevice has.
    Primary,
    /// The port at the other end of a redundancy ring.
    Secondary,
}

impl From<MainPort> for Port {
    fn from(port: MainPort) -> Self {
        match port {
            MainPort::Primary => Self::Primary,
            MainPort::Secondary => Self::Secondary,
        }
    }
}

/// One end of a cable.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// A port of the MainDevice.
    Main(MainPort),
    /// A port of a SubDevice.
    Port(usize, PortNumber),
}

/// How long a SubDevice keeps a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Stay {
    /// Time from the arrival at a port through the processing unit to the departure at the next
    /// open port.
    pub processing: Picos,
    /// The same without the processing unit.
    pub forwarding: Picos,
    /// The PHYs by port; arrivals count after them, departures before them.
    pub phys: [Phy; 4],
    /// Whether each hop to it jitters, because its ports transfer frames into its own clock,
    /// depending on the size of their FIFOs. Without it, every frame takes the same time.
    pub hop_jitter: bool,
}

impl Stay {
    /// The stay by the chip's profile; hops jitter.
    pub fn of(chip: &Chip) -> Self {
        Self {
            processing: chip.processing_delay,
            forwarding: chip.forwarding_delay,
            phys: PortNumber::ALL.map(|port| Phy::symmetric(chip.port_delay(port))),
            hop_jitter: true,
        }
    }
}

/// A cable in its place: `from` is nearer to the MainDevice's primary port.
#[derive(Clone, Copy, Debug)]
struct Laid {
    cable: Cable,
    from: End,
    to: End,
}

/// The way from one end of a cable to the other.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Hop {
    /// The cable.
    pub cable: usize,
    /// The direction along it.
    pub direction: Direction,
    /// The end that it leads to.
    pub to: End,
    /// Delay of PHY, cable and PHY.
    pub delay: Picos,
}

/// All cables of a segment. The MainDevice's network controller belongs to its host, so it has no
/// PHY here.
#[derive(Clone, Debug)]
pub struct Wiring {
    stays: Vec<Stay>,
    cables: Vec<Laid>,
    /// The cable at each port of each SubDevice.
    ports: Vec<[Option<usize>; 4]>,
    main: [Option<usize>; 2],
}

/// Error: two cables at one port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PortTaken(pub End);

impl Wiring {
    /// SubDevices without any cable.
    pub fn new(stays: Vec<Stay>) -> Self {
        let ports = vec![[None; 4]; stays.len()];
        Self { stays, cables: Vec::new(), ports, main: [None; 2] }
    }

    /// Lays a cable and returns its number. Panics if a SubDevice does not exist.
    pub fn connect(&mut self, from: End, to: End, cable: Cable) -> Result<usize, PortTaken> {
        let taken = [from, to].into_iter().find(|end| self.at(*end).is_some());
        if let Some(end) = taken.or((from == to).then_some(from)) {
            return Err(PortTaken(end));
        }
        let number = self.cables.len();
        self.cables.push(Laid { cable, from, to });
        for end in [from, to] {
            *self.slot(end) = Some(number);
        }
        Ok(number)
    }

    /// Replaces a cable. Panics if there is none with this number.
    pub fn replace(&mut self, number: usize, cable: Cable) {
        self.cables[number].cable = cable;
    }

    /// Replaces the chip of a SubDevice.
    pub(crate) fn replace_stay(&mut self, device: usize, chip: &Chip) {
        let hop_jitter = self.stays[device].hop_jitter;
        self.stays[device] = Stay { hop_jitter, ..Stay::of(chip) };
    }

    /// Number of SubDevices.
    pub fn devices(&self) -> usize {
        self.stays.len()
    }

    /// Number of cables.
    pub fn cables(&self) -> usize {
        self.cables.len()
    }

    /// A cable and its ends. Panics if there is none with this number.
    pub fn cable(&self, number: usize) -> (&Cable, [End; 2]) {
        let laid = &self.cables[number];
        (&laid.cable, [laid.from, laid.to])
    }

    /// How long a SubDevice keeps frames.
    pub fn stay(&self, device: usize) -> &Stay {
        &self.stays[device]
    }

    /// The hop over the cable at this end, if there is one.
    pub fn hop(&self, from: End) -> Option<Hop> {
        let cable = self.at(from)?;
        let laid = &self.cables[cable];
        let (direction, to) = if laid.from == from {
            (Direction::Out, laid.to)
        } else {
            (Direction::Back, laid.from)
        };
        let delay = self.phy(from).transmit + laid.cable.delay(direction) + self.phy(to).receive;
        Some(Hop { cable, direction, to, delay })
    }

    fn phy(&self, end: End) -> Phy {
        match end {
            End::Main(_) => Phy::default(),
            End::Port(device, port) => self.stays[device].phys[port.index()],
        }
    }

    fn at(&self, end: End) -> Option<usize> {
        match end {
            End::Main(port) => self.main[port as usize],
            End::Port(device, port) => self.ports[device][port.index()],
        }
    }

    fn slot(&mut self, end: End) -> &mut Option<usize> {
        match end {
            End::Main(port) => &mut self.main[port as usize],
            End::Port(device, port) => &mut self.ports[device][port.index()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    #[test]
    fn a_hop_is_phy_cable_phy_and_knows_its_direction() {
        let phy = |transmit, receive| Phy { transmit: Picos(transmit), receive: Picos(receive) };
        let phys = [phy(1, 20), phy(300, 4_000), phy(0, 0), phy(0, 0)];
        let stay = Stay { processing: Picos(0), forwarding: Picos(0), phys, hop_jitter: false };
        let mut wiring = Wiring::new(vec![stay; 2]);
        let cable = Cable::of_length(10_000).with_asymmetry(Picos(200_000 - 100_000));
        let (a, b) = (End::Port(0, P1), End::Port(1, P0));
        assert_eq!(wiring.connect(a, b, cable), Ok(0));
        let out = wiring.hop(a).unwrap();
        assert_eq!(
            (out.to, out.direction, out.delay),
            (b, Direction::Out, Picos(300 + 100_000 + 20))
        );
        let back = wiring.hop(b).unwrap();
        assert_eq!((back.to, back.direction, back.delay), (a, Direction::Back, Picos(1 + 4_000)));
        assert_eq!(wiring.hop(End::Port(1, P1)), None);
        assert_eq!(wiring.connect(End::Main(MainPort::Primary), b, cable), Err(PortTaken(b)));
        let loose = End::Port(1, P1);
        assert_eq!(wiring.connect(loose, loose, cable), Err(PortTaken(loose)));
        assert_eq!((wiring.cables(), wiring.hop(End::Main(MainPort::Primary))), (1, None));
    }
}
