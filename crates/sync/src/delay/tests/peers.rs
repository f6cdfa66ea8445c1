//! Trees for which other MainDevices measured wrong delays: each hop is 500 ns, ports 0 → 3 → 1 →
//! 2.

use super::*;

/// A tree without times; the flag tells whether the SubDevice has receive times.
type Shape<'a> = &'a [(Parent, bool)];

/// Gives every SubDevice the times of hops of 500 ns, with its counter starting at `start`, and
/// computes the delays.
fn measured(shape: Shape<'_>, start: u32) -> (Vec<Option<i64>>, Vec<i64>) {
    let count = shape.len();
    let child = |at: usize, port: PortNumber| {
        shape.iter().position(|(parent, _)| *parent == Some((at, port)))
    };
    let mut arrivals = vec![[0u32; 4]; count];
    fn walk(
        at: usize,
        mut now: u32,
        child: &dyn Fn(usize, PortNumber) -> Option<usize>,
        arrivals: &mut [[u32; 4]],
    ) -> u32 {
        arrivals[at][0] = now;
        for port in [P3, P1, P2] {
            if let Some(below) = child(at, port) {
                now = walk(below, now + 500, child, arrivals) + 500;
                arrivals[at][port.index()] = now;
            }
        }
        now
    }
    walk(0, 0, &child, &mut arrivals);
    let truth = arrivals.iter().map(|arrival| i64::from(arrival[0])).collect();
    let nodes: Vec<Node> = (0..count)
        .map(|i| {
            let below = [P1, P2, P3].into_iter().filter(|port| child(i, *port).is_some());
            let ports: Vec<usize> = core::iter::once(0).chain(below.map(|p| p.index())).collect();
            let (parent, timed) = shape[i];
            let times = arrivals[i].map(|at| start.wrapping_add(at));
            node(parent, &ports, timed.then_some(times))
        })
        .collect();
    (delays(&nodes), truth)
}

fn below(parent: usize, port: PortNumber) -> (Parent, bool) {
    (Some((parent, port)), true)
}

fn plain(parent: usize, port: PortNumber) -> (Parent, bool) {
    (Some((parent, port)), false)
}

const FIRST: (Parent, bool) = (None, true);

/// Checks that the delays follow the way of the frame, wherever the counters start.
fn expect(name: &str, shape: Shape<'_>, delays: &[Option<i64>]) {
    for start in [0, 5_000, u32::MAX - 700, i32::MAX as u32 - 700] {
        let (found, truth) = measured(shape, start);
        assert_eq!(found, delays, "{name}, counters from {start}");
        let known = found.iter().zip(&truth).filter_map(|(found, truth)| Some(((*found)?, *truth)));
        assert!(known.into_iter().all(|(found, truth)| found == truth), "{name}: {truth:?}");
    }
}

#[test]
fn a_line_of_three() {
    let line = [FIRST, below(0, P1), below(1, P1)];
    expect("line", &line, &[Some(0), Some(500), Some(1000)]);
}

#[test]
fn one_fork() {
    let fork = [FIRST, below(0, P3), below(0, P1)];
    expect("fork", &fork, &[Some(0), Some(500), Some(1500)]);
}

const NESTED: [(Parent, bool); 5] = [
    FIRST,
    (Some((0, P3)), true),
    (Some((1, P1)), true),
    (Some((1, P2)), true),
    (Some((0, P1)), true),
];

#[test]
fn a_fork_whose_first_branch_is_a_fork() {
    let expected = [0, 500, 1000, 2000, 3500].map(Some);
    expect("nested fork", &NESTED, &expected);
}

#[test]
fn the_same_with_one_more_branch() {
    let mut shape = NESTED.to_vec();
    shape.push(below(0, P2));
    expect("nested fork and one", &shape, &[0, 500, 1000, 2000, 3500, 4500].map(Some));
}

#[test]
fn a_cross_with_a_deep_branch() {
    let shape = [FIRST, below(0, P1), below(1, P3), below(2, P1), below(1, P1), below(1, P2)];
    expect("cross", &shape, &[0, 500, 1000, 1500, 3000, 4000].map(Some));
}

#[test]
fn a_line_with_one_without_times() {
    let shape = [FIRST, plain(0, P1), below(1, P1), below(2, P1)];
    expect("line", &shape, &[Some(0), None, Some(1000), Some(1500)]);
}

#[test]
fn a_junction_without_times() {
    let shape = [FIRST, plain(0, P1), below(1, P1), below(1, P2)];
    expect("junction", &shape, &[Some(0), None, None, None]);
}
