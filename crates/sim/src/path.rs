//! The way of a frame through the segment: which ESC port it reaches how long after it was sent.
//!
//! A frame enters an ESC at port 0, passes its processing unit and leaves through its open ports in
//! the order 3, 1, 2, each time coming back; then it leaves through port 0. Cables cost their length,
//! the processing unit its processing delay, every further port its forwarding delay.

use isocat_wire::address::PortNumber;
use isocat_wire::time::Picos;

/// Signal speed on a cable: 5 ns per metre.
pub const PICOS_PER_MILLIMETRE: i64 = 5;

/// One SubDevice in the tree, as far as frames feel it. Parents stand before their children.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Place {
    /// The SubDevice upstream and its port; `None` hangs on the MainDevice.
    pub parent: Option<(usize, PortNumber)>,
    /// From the port upstream to the arrival at port 0, and back: cable and PHYs.
    pub link: Picos,
    /// From the arrival at port 0 to the departure at the first open port.
    pub processing: Picos,
    /// From the return at a port to the departure at the next one.
    pub forwarding: Picos,
}

/// One arrival of a frame at a port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Arrival {
    /// The SubDevice.
    pub device: usize,
    /// The port. Port 0 means that the frame enters and is processed.
    pub port: PortNumber,
    /// Since the first bit left the MainDevice.
    pub after: Picos,
}

/// All arrivals of one frame, in the order of time, and its way back.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Path {
    /// Arrivals at the processing units, in processing order.
    pub entries: Vec<Arrival>,
    /// Arrivals back at ports 3, 1, 2.
    pub returns: Vec<Arrival>,
    /// From the first bit's departure at the MainDevice to its return.
    pub round_trip: Picos,
}

impl Path {
    /// The way through these SubDevices. A child on a port that does not exist for frames (port 0 of
    /// its parent), or before its parent, is a mistake of the caller and panics.
    pub fn new(places: &[Place]) -> Self {
        for (i, place) in places.iter().enumerate() {
            if let Some((parent, port)) = place.parent {
                assert!(parent < i, "place {i} stands before its parent {parent}");
                assert!(port != PortNumber::P0, "place {i} hangs on the upstream port of {parent}");
            }
        }
        let mut path = Path::default();
        let mut at = Picos::ZERO;
        // The SubDevices on the MainDevice's own port: one at most, but an empty segment is legal.
        if let Some(first) = places.iter().position(|place| place.parent.is_none()) {
            at = path.walk(places, first, places[first].link);
            at += places[first].link;
        }
        path.round_trip = at;
        path
    }

    /// Sends the frame into `device`, which its first bit reaches at `at`; gives the time at which it
    /// leaves through port 0. Walks with a stack of its own: a segment may be 65535 deep.
    fn walk(&mut self, places: &[Place], device: usize, at: Picos) -> Picos {
        struct Visit {
            device: usize,
            next: usize,
            entered_through: PortNumber,
        }
        let mut children = vec![[None; 4]; places.len()];
        for (i, place) in places.iter().enumerate() {
            if let Some((parent, port)) = place.parent {
                children[parent][port.index()] = Some(i);
            }
        }
        let mut at = at;
        self.entries.push(Arrival { device, port: PortNumber::P0, after: at });
        at += places[device].processing;
        let mut stack = vec![Visit { device, next: 1, entered_through: PortNumber::P0 }];
        while let Some(top) = stack.last_mut() {
            let Some(&port) = PortNumber::PROCESSING_ORDER.get(top.next) else {
                let left = stack.pop().expect("the loop looks at the top");
                if let Some(parent) = stack.last() {
                    at += places[left.device].link;
                    let port = left.entered_through;
                    self.returns.push(Arrival { device: parent.device, port, after: at });
                    at += places[parent.device].forwarding;
                }
                continue;
            };
            top.next += 1;
            if let Some(child) = children[top.device][port.index()] {
                at += places[child].link;
                self.entries.push(Arrival { device: child, port: PortNumber::P0, after: at });
                at += places[child].processing;
                stack.push(Visit { device: child, next: 1, entered_through: port });
            }
        }
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use PortNumber::*;

    fn place(parent: Option<(usize, PortNumber)>, metres: i64) -> Place {
        let (processing, forwarding) = (Picos(300_000), Picos(200_000));
        Place { parent, link: Picos(metres * 1000 * PICOS_PER_MILLIMETRE), processing, forwarding }
    }

    fn after(arrivals: &[Arrival]) -> Vec<(usize, PortNumber, i64)> {
        arrivals.iter().map(|a| (a.device, a.port, a.after.0 / 1000)).collect()
    }

    #[test]
    fn a_line_there_and_back() {
        let path = Path::new(&[place(None, 10), place(Some((0, P1)), 20)]);
        assert_eq!(after(&path.entries), [(0, P0, 50), (1, P0, 50 + 300 + 100)]);
        assert_eq!(after(&path.returns), [(0, P1, 450 + 300 + 100)]);
        assert_eq!(path.round_trip, Picos((850 + 200 + 50) * 1000));
    }

    #[test]
    fn a_fork_is_walked_in_port_order_not_in_list_order() {
        let path = Path::new(&[
            place(None, 0),
            place(Some((0, P1)), 0),
            place(Some((0, P3)), 0),
            place(Some((2, P1)), 0),
        ]);
        let visited: Vec<_> = path.entries.iter().map(|a| a.device).collect();
        assert_eq!(visited, [0, 2, 3, 1]);
        // 300 in 0, 300 in 2, 300 in 3, back at 2, 200 there, back at 0, 200 there, 300 in 1.
        assert_eq!(after(&path.returns), [(2, P1, 900), (0, P3, 1100), (0, P1, 1600)],);
        assert_eq!(path.round_trip, Picos(1_800_000));
    }

    #[test]
    fn an_empty_segment_returns_at_once() {
        assert_eq!(Path::new(&[]), Path::default());
    }
}
