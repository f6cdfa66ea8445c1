use super::*;
use crate::cable::{Cable, PICOS_PER_MILLIMETRE, Phy};
use crate::wiring::Stay;
use MainPort::{Primary, Secondary};
use PortNumber::*;

const STAY: Stay = Stay {
    processing: Picos(300_000),
    forwarding: Picos(200_000),
    phys: [Phy { transmit: Picos(0), receive: Picos(0) }; 4],
    hop_jitter: false,
};

/// Cables by their ends and metres. A port with a cable is open unless it is in `closed`.
fn path(
    devices: usize,
    cables: &[(End, End, u64)],
    closed: &[(usize, PortNumber)],
    from: MainPort,
) -> Path {
    let mut wiring = Wiring::new(vec![STAY; devices]);
    for (a, b, metres) in cables {
        wiring.connect(*a, *b, Cable::of_length(metres * 1000)).unwrap();
    }
    let loops = |device| {
        let open: Vec<_> = PortNumber::ALL
            .into_iter()
            .filter(|port| wiring.hop(End::Port(device, *port)).is_some())
            .filter(|port| !closed.contains(&(device, *port)))
            .collect();
        Loops::open(&open)
    };
    Path::new(&wiring, loops, from)
}

const MAIN: End = End::Main(Primary);

fn port(device: usize, port: PortNumber) -> End {
    End::Port(device, port)
}

fn after(arrivals: &[Arrival]) -> Vec<(usize, PortNumber, i64)> {
    arrivals.iter().map(|a| (a.device, a.port, a.after.0 / 1000)).collect()
}

/// A frame waits until the one before is through, by the smallest step; one that was held up does
/// not delay others.
#[test]
fn frames_do_not_overlap_at_a_port() {
    let mut ports = Ports::new(2);
    let at = |ps: u64| Time::new(1_000_000_000 + ps);
    let long = Picos(7_000_000);
    assert_eq!(ports.take(Ports::place(1, P0), at(0), long), at(0));
    assert_eq!(ports.take(Ports::place(1, P0), at(7_039_999), long), at(7_040_000));
    assert_eq!(ports.take(Ports::place(1, P0), at(14_080_000), long), at(14_080_000));
    assert_eq!(ports.take(Ports::place(1, P1), at(1), long), at(1), "another port");
    assert_eq!(ports.take(Ports::place(0, P0), at(2), long), at(2), "another SubDevice");
    assert_eq!(ports.take(Ports::place(1, P0), at(20_120_000), long), at(21_120_000));
    assert_eq!(ports.take(Ports::place(1, P0), at(27_159_999), long), at(27_159_999));
}

/// The whole order 0 → EPU → 3 → 1 → 2 → 0, from each port, with all ports open, with one closed,
/// with one open.
#[test]
fn the_way_round_the_ports() {
    let turn = |open: &[PortNumber], from| {
        let Turn { processed, exit } = Loops::open(open).turn(from);
        (processed, exit)
    };
    let all = [P0, P1, P2, P3];
    assert_eq!(turn(&all, P0), (true, P3));
    assert_eq!(turn(&all, P3), (false, P1));
    assert_eq!(turn(&all, P1), (false, P2));
    assert_eq!(turn(&all, P2), (false, P0));
    // Closed ports are skipped; a closed port 0 turns into the EPU.
    assert_eq!(turn(&[P0, P1], P0), (true, P1));
    assert_eq!(turn(&[P0, P1], P1), (false, P0));
    assert_eq!(turn(&[P1, P2], P2), (true, P1));
    assert_eq!(turn(&[P1, P2], P1), (false, P2));
    assert_eq!(turn(&[P1, P3], P1), (true, P3));
    assert_eq!(turn(&[P2], P2), (true, P2));
    assert_eq!(turn(&[P0], P0), (true, P0));
    // All closed: port 0 is treated as open.
    assert!(!Loops::open(&[]).closed(P0));
    assert_eq!(turn(&[], P0), (true, P0));
}

#[test]
fn a_line_there_and_back() {
    let path = path(2, &[(MAIN, port(0, P0), 10), (port(0, P1), port(1, P0), 20)], &[], Primary);
    assert_eq!(after(&path.entries), [(0, P0, 50), (1, P0, 50 + 300 + 100)]);
    assert_eq!(after(&path.returns), [(0, P1, 450 + 300 + 100)]);
    assert_eq!(path.round_trip, Picos((850 + 200 + 50) * 1000));
    assert_eq!((path.end, path.processed_first), (Some(Primary), true));
    assert_eq!(PICOS_PER_MILLIMETRE * 10_000, 50_000);
}

#[test]
fn a_fork_is_walked_in_port_order_not_in_list_order() {
    let cables = [
        (MAIN, port(0, P0), 0),
        (port(0, P1), port(1, P0), 0),
        (port(0, P3), port(2, P0), 0),
        (port(2, P1), port(3, P0), 0),
    ];
    let path = path(4, &cables, &[], Primary);
    let visited: Vec<_> = path.entries.iter().map(|a| a.device).collect();
    assert_eq!(visited, [0, 2, 3, 1]);
    // 300 in 0, 300 in 2, 300 in 3, back at 2, 200 there, back at 0, 200 there, 300 in 1.
    assert_eq!(after(&path.returns), [(2, P1, 900), (0, P3, 1100), (0, P1, 1600)],);
    assert_eq!(path.round_trip, Picos(1_800_000));
}

/// The cable from above is in port 1 of the middle SubDevice: it processes the frame only when it
/// comes back from below, at port 0.
#[test]
fn swapped_cables_are_passed_in_reverse() {
    let cables =
        [(MAIN, port(0, P0), 0), (port(0, P1), port(1, P1), 0), (port(1, P0), port(2, P0), 0)];
    let path = path(3, &cables, &[], Primary);
    // 0: 300. 1: past the EPU, 200. 2: 300, back at 1, now through the EPU: 300, and out at port 1.
    assert_eq!(after(&path.entries), [(0, P0, 0), (2, P0, 500), (1, P0, 800)]);
    assert_eq!(after(&path.returns), [(1, P1, 300), (0, P1, 1100)]);
    assert_eq!((path.round_trip, path.processed_first), (Picos(1_300_000), false));
}

/// The last SubDevice of a line is swapped: its closed port 0 sends the frame into the EPU.
#[test]
fn a_swapped_end_processes_at_its_closed_port_0() {
    let cables = [(MAIN, port(0, P0), 0), (port(0, P1), port(1, P1), 0)];
    let path = path(2, &cables, &[], Primary);
    assert_eq!(after(&path.entries), [(0, P0, 0), (1, P1, 300)]);
    assert_eq!(after(&path.returns), [(0, P1, 600)]);
    assert!(path.processed_first);
}

#[test]
fn a_ring_is_processed_from_one_end_only() {
    let ring = [
        (MAIN, port(0, P0), 0),
        (port(0, P1), port(1, P0), 0),
        (port(1, P1), End::Main(Secondary), 0),
    ];
    let primary = path(2, &ring, &[], Primary);
    assert_eq!(after(&primary.entries), [(0, P0, 0), (1, P0, 300)]);
    assert_eq!((primary.end, primary.round_trip), (Some(Secondary), Picos(600_000)));
    let secondary = path(2, &ring, &[], Secondary);
    assert_eq!(after(&secondary.entries), []);
    assert_eq!(after(&secondary.returns), [(1, P1, 0), (0, P1, 200)]);
    assert_eq!((secondary.end, secondary.processed_first), (Some(Primary), false));
    // Cut in the middle: each end has its half.
    let cut = [(0, P1), (1, P0)];
    let primary = path(2, &ring, &cut, Primary);
    assert_eq!((after(&primary.entries), primary.end), (vec![(0, P0, 0)], Some(Primary)));
    let secondary = path(2, &ring, &cut, Secondary);
    assert_eq!((after(&secondary.entries), secondary.end), (vec![(1, P1, 0)], Some(Secondary)));
}

#[test]
fn ways_that_do_not_come_back() {
    let nowhere = path(0, &[], &[], Primary);
    assert_eq!((nowhere.end, nowhere.round_trip), (None, Picos::ZERO));
    // Port 0 does not accept the frame: it is closed although another port is open.
    let cables = [(MAIN, port(0, P0), 0), (port(0, P1), port(1, P0), 0)];
    let refused = path(2, &cables, &[(0, P0)], Primary);
    assert_eq!((refused.end, refused.entries.len()), (None, 0));
    // A port that is forced open without a cable has no receiver.
    let mut wiring = Wiring::new(vec![STAY]);
    wiring.connect(MAIN, port(0, P0), Cable::of_length(0)).unwrap();
    let lost = Path::new(&wiring, |_| Loops::open(&[P0, P1]), Primary);
    assert_eq!((lost.end, lost.entries.len()), (None, 1));
    // Two SubDevices whose ports 1 and 2 are cross-connected in a circle still return the frame:
    // every way in has one way out.
    let circle =
        [(MAIN, port(0, P0), 0), (port(0, P1), port(1, P1), 0), (port(0, P2), port(1, P2), 0)];
    let circle = path(2, &circle, &[], Primary);
    assert_eq!(circle.end, Some(Primary));
}
