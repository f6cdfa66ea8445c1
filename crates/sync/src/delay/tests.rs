//! Trees made by hand: the delays, their errors, and the reasons for unknown ones.

use std::vec;
use std::vec::Vec;

use PortNumber::*;

use super::*;

mod peers;

/// Equal stays: the way out takes as long as the way back.
const EVEN: Stay = Stay::exact(1, Picos(155_000), Picos(155_000));
/// As captured: 155 ns out, 135 ns back.
const UNEVEN: Stay = Stay::exact(2, Picos(155_000), Picos(135_000));

type Parent = Option<(usize, PortNumber)>;

fn node(parent: Parent, ports: &[usize], times: Option<[u32; 4]>) -> Node {
    let open = core::array::from_fn(|port| ports.contains(&port));
    Node { parent, entry: P0, open, receive_times: times, stay: EVEN }
}

fn leaf(parent: usize, port: PortNumber) -> Node {
    node(Some((parent, port)), &[0], Some([0x1234_5678, 0, 0, 0]))
}

/// The result of one latch, with the first SubDevice that has receive times as reference.
fn results(nodes: &[Node]) -> Vec<Delay> {
    let reference = nodes.iter().position(|node| node.receive_times.is_some()).unwrap_or(0);
    results_from(nodes, reference)
}

fn results_from(nodes: &[Node], reference: usize) -> Vec<Delay> {
    let mut found = vec![Found::default(); nodes.len()];
    propagation_delays(nodes, reference, 0, &mut found);
    let means: Vec<Mean> = found
        .iter()
        .map(|found| {
            let mut mean = Mean::default();
            mean.add(found);
            mean
        })
        .collect();
    let averaging = Averaging::of(&means);
    means.iter().map(|mean| mean.delay(averaging)).collect()
}

fn delays(nodes: &[Node]) -> Vec<Option<i64>> {
    results(nodes).iter().map(|delay| delay.nanos().map(|d| d.0)).collect()
}

fn whys(nodes: &[Node]) -> Vec<Option<Why>> {
    let why = |delay| match delay {
        Delay::Known { .. } => None,
        Delay::Indeterminate { why, .. } => Some(why),
    };
    results(nodes).into_iter().map(why).collect()
}

fn errors(nodes: &[Node]) -> Vec<i64> {
    let error = |delay| match delay {
        Delay::Known { standard_error, .. } => standard_error.0,
        Delay::Indeterminate { .. } => -1,
    };
    results(nodes).into_iter().map(error).collect()
}

/// Two LAN9252 as captured: a loop of 1440 ns, 720 ns written to the second.
#[test]
fn a_leaf_is_half_the_round_trip_away() {
    let first = node(None, &[0, 1], Some([0x1553_D022, 0x1553_D5C2, 7, 7]));
    assert_eq!(delays(&[first, leaf(0, P1)]), [Some(0), Some(720)]);
}

/// EK1100 and E-bus neighbours as captured: the delays are 0, 145 and 300 ns.
#[test]
fn a_line_takes_off_what_lies_behind() {
    let nodes = [
        node(None, &[0, 1], Some([0x3C62_0F52, 0x3C62_11AA, 0, 0])),
        node(Some((0, P1)), &[0, 1], Some([0x3D0B_D6AE, 0x3D0B_D7E4, 0, 0])),
        leaf(1, P1),
    ];
    assert_eq!(delays(&nodes), [Some(0), Some(145), Some(300)]);
}

/// Processing takes 155 ns on the way out, forwarding 135 ns on the way back, a cable 100 ns. If
/// the difference is known, the delays are the true ones.
#[test]
fn the_difference_of_the_directions_counts_unless_the_child_is_a_leaf() {
    let mut nodes = [
        // A round trip through the middle one: its own loop of 510 ns, its forwarding, two cables.
        node(None, &[0, 1], Some([0, 155 + 100 + 510 + 135 + 100, 0, 0])),
        node(Some((0, P1)), &[0, 1], Some([0, 155 + 100 + 155 + 100, 0, 0])),
        leaf(1, P1),
    ];
    assert_eq!(delays(&nodes), [Some(0), Some(245), Some(245 + 255)]);
    for node in &mut nodes {
        node.stay = UNEVEN;
    }
    assert_eq!(delays(&nodes), [Some(0), Some(255), Some(255 + 255)]);
}

/// A leaf is behind port 3 (round trip 1000) and another behind port 1 (round trip 600). To the
/// second the frame continues 135 ns after its return, and it is turned round there in 155 ns.
#[test]
fn the_second_branch_of_a_fork_begins_with_forwarding() {
    let mut nodes = [node(None, &[0, 1, 3], Some([100, 1700, 0, 1100])), leaf(0, P3), leaf(0, P1)];
    assert_eq!(delays(&nodes), [Some(0), Some(500), Some(1000 + 300)]);
    for node in &mut nodes {
        node.stay = UNEVEN;
    }
    assert_eq!(delays(&nodes), [Some(0), Some(500), Some(1000 + 290)]);
    // Another kind of chip turns frames round in 255 ns: 120 ns more than their stay above.
    nodes[2].stay.processing = Picos(255_000);
    assert_eq!(delays(&nodes)[2], Some(1000 + 240));
}

#[test]
fn devices_without_clocks_are_cable_unless_they_branch() {
    let first = node(None, &[0, 1], Some([0, 2000, 0, 0]));
    let plain = node(Some((0, P1)), &[0, 1], None);
    assert_eq!(delays(&[first, plain, leaf(1, P1)]), [Some(0), None, Some(1000)]);
    assert_eq!(whys(&[first, plain, leaf(1, P1)])[1], Some(Why::NoReceiveTimes));
    // The cable is slower on the way out.
    let uneven = Node { stay: UNEVEN, ..plain };
    assert_eq!(delays(&[first, uneven, leaf(1, P1)])[2], Some(1010));
    let branching = node(Some((0, P1)), &[0, 1, 2], None);
    let nodes = [first, branching, leaf(1, P1)];
    assert_eq!(delays(&nodes), [Some(0), None, None]);
    assert_eq!(whys(&nodes)[2], Some(Why::BranchWithoutTimes { at: 1 }));
}

/// Behind an unknown delay all others are unknown by the same amount and name the SubDevice above.
#[test]
fn an_unknown_delay_has_bounds_and_hands_them_down() {
    let nodes = [
        node(None, &[0, 1], Some([0, 2000, 0, 0])),
        node(Some((0, P1)), &[0, 1, 2], None),
        node(Some((1, P1)), &[0, 1], Some([0, 400, 0, 0])),
        leaf(2, P1),
    ];
    let between = |least, most| Some((Picos(least), Picos(most)));
    let found = results(&nodes);
    let why = Why::BranchWithoutTimes { at: 1 };
    let expected = Delay::Indeterminate { why, between: between(0, 1_600_000) };
    assert_eq!((found[2], found[2].or_middle()), (expected, Nanos(800)));
    let why = Why::Above { at: 2 };
    let expected = Delay::Indeterminate { why, between: between(200_000, 1_800_000) };
    assert_eq!((found[3], found[3].or_middle()), (expected, Nanos(1000)));
}

#[test]
fn two_branches_of_a_first_device_without_times_have_nothing_in_common() {
    let nodes = [node(None, &[0, 1, 3], None), leaf(0, P3), leaf(0, P1)];
    assert_eq!(delays(&nodes), [None, Some(0), None]);
    assert_eq!(whys(&nodes)[2], Some(Why::NothingInCommon));
    assert_eq!(results(&nodes)[2].or_middle(), Nanos::ZERO);
}

#[test]
fn counters_may_wrap_between_the_ports() {
    for before in [u32::MAX - 99, i32::MAX as u32 - 99] {
        let first = node(None, &[0, 1], Some([before, before.wrapping_add(1440), 0, 0]));
        assert_eq!(delays(&[first, leaf(0, P1)]), [Some(0), Some(720)]);
    }
}

/// Two differences of two times each have an error below 20 ns.
#[test]
fn a_child_slower_than_its_branch_is_a_contradiction_beyond_noise() {
    let first = node(None, &[0, 1], Some([0, 500, 0, 0]));
    let middle = |kept| node(Some((0, P1)), &[0, 1], Some([0, kept, 0, 0]));
    let nodes = |kept| [first, middle(kept), leaf(1, P1)];
    // Within the noise the delay is the least possible one, and never before the reference.
    assert_eq!(delays(&nodes(520))[1], Some(0));
    assert_eq!(whys(&nodes(521))[1], Some(Why::ShorterThanLoop { above: 0, by: Nanos(1) }));
    assert_eq!(whys(&nodes(521))[2], Some(Why::Above { at: 1 }));
    assert_eq!(results(&nodes(521))[1].or_middle(), Nanos(250), "somewhere in the branch");
    // Clocks of different speeds allow a larger error.
    let mut found = vec![Found::default(); 3];
    propagation_delays(&nodes(521), 0, 2_000_000, &mut found);
    assert_eq!(found[1].why(), None);
}

/// A port has an earlier time than the port visited before it, or no time at all.
#[test]
fn times_out_of_order_are_no_times() {
    let first = node(None, &[0, 1], Some([0, 2000, 0, 0]));
    let middle = |t1| node(Some((0, P1)), &[0, 1], Some([5000, t1, 0, 0]));
    assert_eq!(delays(&[first, middle(5900), leaf(1, P1)]), [Some(0), Some(550), Some(1000)]);
    for wrong in [4999, 4_000_000_000] {
        let nodes = [first, middle(wrong), leaf(1, P1)];
        assert_eq!(delays(&nodes), [Some(0), None, Some(1000)], "it is cable");
        assert_eq!(whys(&nodes)[1], Some(Why::TimesContradict));
        assert_eq!(results(&nodes)[1].or_middle(), Nanos(1000));
    }
    let wrong = node(None, &[0, 1], Some([0, 4_000_000_000, 0, 0]));
    assert_eq!(whys(&[wrong, leaf(0, P1)]), [Some(Why::NoReference); 2]);
}

/// The cable is plugged into port 1: frames enter there, continue 2 → 0, and pass the processing
/// unit on their way back.
#[test]
fn the_entry_port_may_be_another() {
    let swapped = Node { entry: P1, ..node(Some((0, P1)), &[0, 1], Some([1500, 500, 0, 0])) };
    let first = node(None, &[0, 1], Some([0, 3000, 0, 0]));
    let nodes = [first, swapped, leaf(1, P0)];
    // The entry is 1000 ns away, and the frame is back from the leaf 1000 ns later.
    assert_eq!(delays(&nodes), [Some(0), Some(2000), Some(1500)]);
    // A frame leaves the swapped one by forwarding and returns into it through processing.
    let nodes = nodes.map(|node| Node { stay: UNEVEN, ..node });
    assert_eq!(delays(&nodes), [Some(0), Some(2000), Some(1490)]);
}

/// In processing order a child at port 0 comes first. It may be the reference, so ways also lead
/// up.
#[test]
fn parents_may_follow_and_the_reference_may_hang_below() {
    let swapped = |parent| Node { parent: Some((parent, P1)), entry: P1, ..leaf(0, P0) };
    let root = Node { entry: P1, ..node(None, &[0, 1, 3], Some([2000, 1000, 0, 2600])) };
    let nodes = [Node { parent: Some((2, P0)), ..leaf(0, P0) }, leaf(2, P3), root];
    let expected = [Some(0), Some(1000 + 300 - 500), Some(500)];
    assert_eq!(delays(&nodes), expected);
    // Without a leaf at its port 0 the frame is turned round there.
    let root = node(None, &[0, 1], Some([0, 900, 0, 0]));
    let end = Node { open: [false, true, false, false], ..swapped(0) };
    assert_eq!(delays(&[root, end]), [Some(0), Some(450)]);
}

/// The error of one latch is 10 ns / sqrt(12) = 2.887 ns for each time, weighted by the
/// coefficients.
#[test]
fn quantization_along_a_line_does_not_accumulate() {
    const COUNT: usize = 300;
    let times = |i: usize| {
        let round = 1_000 * (COUNT - 1 - i) as u32;
        let start = (i as u32).wrapping_mul(0x1234_5679);
        Some([start, start.wrapping_add(round), 0, 0])
    };
    let parent = |i: usize| i.checked_sub(1).map(|parent| (parent, P1));
    let ports = |i| if i + 1 < COUNT { &[0, 1][..] } else { &[0][..] };
    let mut nodes: Vec<Node> = (0..COUNT).map(|i| node(parent(i), ports(i), times(i))).collect();
    let (delays, errors) = (delays(&nodes), errors(&nodes));
    assert_eq!(delays[COUNT - 1], Some(500 * 299));
    // The reference contributes two halves; a SubDevice in the middle adds two halves of its own.
    assert_eq!((errors[0], errors[COUNT - 1]), (0, 2_042));
    assert!(errors[1..COUNT - 1].iter().all(|error| *error == 2_887));

    // A wrong difference of 1 ns adds half a ns for each hop that does not end in a leaf.
    for node in &mut nodes {
        node.stay.difference_bound = Picos(1_000);
    }
    let last = results(&nodes)[COUNT - 1];
    assert_eq!(last.bar(), Some(Picos(2_042 * 196 / 100 + 149_000)));
    for node in &mut nodes {
        node.stay.processing += Picos(1_000);
    }
    let Delay::Known { delay, .. } = results(&nodes)[COUNT - 1] else { panic!("it is known") };
    assert_eq!(delay, Picos(500_000 * 299 + 149_000));
}

/// A fork that is left through its second branch contributes both times of its first one.
#[test]
fn forks_add_their_part() {
    let fork = |parent: Parent| node(parent, &[0, 1, 3], Some([0, 1600, 0, 1000]));
    let nodes = [fork(None), leaf(0, P3), leaf(0, P1)];
    // a/2 - e/2; then a/2 + p/2 - e.
    assert_eq!(errors(&nodes), [0, 2_042, 3_536]);
    let root = node(None, &[0, 1], Some([0, 3000, 0, 0]));
    let nodes = [root, fork(Some((0, P1))), leaf(1, P3), leaf(1, P1)];
    // (a - e)/2 of the root and (a - l)/2 or (p - e)/2 of the fork.
    assert_eq!(errors(&nodes), [0, 2_887, 2_887, 2_887]);
}

#[test]
fn bounds_of_stays_and_speeds() {
    let other = Stay { kind: 7, kind_bound: Picos(30_000), ..EVEN };
    let first = node(None, &[0, 1], Some([0, 2000, 0, 0]));
    let middle = node(Some((0, P1)), &[0, 1], Some([0, 1000, 0, 0]));
    let systematic = |nodes: &[Node], rate| {
        let mut found = vec![Found::default(); nodes.len()];
        propagation_delays(nodes, 0, rate, &mut found);
        found.iter().map(|found| found.systematic.0).collect::<Vec<_>>()
    };
    let same = [first, middle, leaf(1, P1)];
    assert_eq!(systematic(&same, 0), [0, 0, 0], "exactly known");
    // This is 100 ppm of the 500 ns that the middle one's counter gives; it contributes nothing to
    // the last one.
    assert_eq!(systematic(&same, 100_000), [0, 50, 0]);
    let mixed = [first, Node { stay: other, ..middle }, leaf(1, P1)];
    assert_eq!(systematic(&mixed, 0), [0, 15_000, 30_000]);
}

#[test]
fn nonsense_is_survived() {
    let lost = node(Some((9, P1)), &[0], Some([0; 4]));
    let circle = [node(Some((1, P1)), &[0, 1], Some([0; 4])), node(Some((0, P1)), &[0, 1], None)];
    let closed = node(Some((0, P2)), &[0], Some([0; 4]));
    for nodes in [&[lost, lost][..], &circle, &[leaf(0, P1), closed], &[]] {
        for reference in [0, 1, 7] {
            assert_eq!(results_from(nodes, reference).len(), nodes.len());
        }
    }
}

/// A line of three, seen from its other end, has the same ways.
#[test]
fn the_other_direction() {
    let mut nodes = [
        Node { open: [false, true, false, false], ..node(None, &[], Some([0, 77, 0, 0])) },
        node(Some((0, P1)), &[0, 1], Some([2000, 900, 0, 0])),
        node(Some((1, P1)), &[0, 1], Some([5000, 3000, 0, 0])),
    ];
    turn(&mut nodes, 2, P1);
    let ways = nodes.map(|node| (node.parent, node.entry));
    assert_eq!(ways, [(Some((1, P0)), P1), (Some((2, P0)), P1), (None, P1)]);
    // The nearest one is processed last; the frame reaches its unit 2000 ns after its entry.
    let delay = |i: usize| results_from(&nodes, 0)[i].nanos().unwrap().0;
    assert_eq!([delay(0), delay(1), delay(2)], [0, 550, 1000]);
}
