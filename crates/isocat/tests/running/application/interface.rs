//! The same application on the loop of a real interface, over a packet socket in virtual time: what
//! it is told of each device agrees with the frames that the wire has lost.

use std::collections::BTreeMap;
use std::path::Path;

use isocat::host::{Exchange, RawSocket, Waiting};
use isocat_maindevice::Event;
use isocat_sim::Segment;
use isocat_virtual::supervisor::START;
use isocat_wire::time::{Host, Nanos, Time};
use serde_json::{Value, json};

use super::line::{self, IN_A_FRAME};
use super::witness::Witness;
use crate::application::CYCLE;
use crate::supervised::{Line, again, writes_to};

/// All devices are in OP by then, undisturbed, and frames begin to be lost.
const LOSES_FROM: Time<Host> = Time::new(START.count() + 6_000_000_000);
const LOSES_UNTIL: Time<Host> = Time::new(START.count() + 9_000_000_000);
/// The end; all that was lost is given up by then.
const END: Time<Host> = Time::new(START.count() + 9_100_000_000);
/// One of this number of frames is lost.
const LOST: u64 = 23;

#[test]
fn one_frame_a_cycle() {
    agrees_with_the_wire("one_frame_a_cycle", 1, 0);
}

#[test]
fn three_frames_a_cycle() {
    agrees_with_the_wire("three_frames_a_cycle", 3, 0);
}

#[test]
fn a_group_with_a_longer_cycle() {
    agrees_with_the_wire("a_group_with_a_longer_cycle", 2, 4);
}

/// Runs a line of devices with this number of frames a cycle. The last `slow` devices take part in
/// one cycle of four.
fn agrees_with_the_wire(test: &str, frames: usize, slow: usize) {
    let devices = frames * IN_A_FRAME - 1;
    if let Some(path) = writes_to() {
        return run(devices, slow, &path);
    }
    let mut line = Line::new(Segment::new(line::connections(devices), 1));
    line.loses = Some((LOSES_FROM..LOSES_UNTIL, LOST));
    let test = format!("application::interface::{test}");
    let Some(saw) = again(&test, &mut line) else { return };
    let saw: Value = serde_json::from_str(&saw).expect("JSON");
    println!("{saw}");
    assert_eq!(saw["wrong"], json!([]));
    assert_eq!(saw["unpunctual"], 0);
    // Each frame that the wire has lost is one that the MainDevice gave up, and no other.
    assert_eq!(saw["frames_lost"], line.lost.len());
    // The devices of a frame are stale as often as that frame was lost.
    let mut lost: BTreeMap<u32, u64> = BTreeMap::new();
    line.lost.iter().for_each(|address| *lost.entry(*address).or_default() += 1);
    assert_eq!(lost.len(), frames, "each frame of a cycle was lost: {lost:?}");
    let lost: Vec<u64> = lost.into_values().collect();
    let counts = |key: &str| -> Vec<u64> {
        serde_json::from_value(saw[key].clone()).expect("a count of each device")
    };
    let (fresh, stale, apart) = (counts("fresh"), counts("stale"), counts("apart"));
    for (position, stale) in stale.iter().enumerate() {
        assert_eq!(*stale, lost[position / IN_A_FRAME], "device {position}: {lost:?}");
    }
    // In operation each call counts for each device, but the group takes part in one of four.
    let in_operation = saw["in_operation"].as_u64().expect("a count");
    let called = |at: usize| fresh[at] + stale[at] + apart[at];
    assert!((0..devices).all(|at| called(at) >= in_operation), "{in_operation}: {saw}");
    assert!((0..devices).all(|at| called(at) <= saw["calls"].as_u64().expect("a count")), "{saw}");
    for at in 0..devices {
        let takes_part = if at >= devices - slow { called(at).div_ceil(4) } else { called(at) };
        assert!((fresh[at] + stale[at]).abs_diff(takes_part) <= 1, "device {at}: {saw}");
    }
    // All requests of the application but the last ones are answered.
    let requests = [0, 1].map(|at| saw["requests"][at].as_u64().expect("a count"));
    assert!(requests[1] > 1_000 && requests[0] - requests[1] < 10, "{requests:?}");
}

/// The program under supervision: the loop of a real interface. Writes what the application saw.
fn run(devices: usize, slow: usize, path: &Path) {
    let socket = RawSocket::open("vt0", None).expect("the end of the line");
    let config = line::config(CYCLE, devices, slow, 4);
    let waiting = Waiting::Sleep { lead: Nanos::ZERO };
    let mut exchange = Exchange::new(config, socket, waiting, None, Witness::default());
    let mut begun = None;
    while exchange.now() < END {
        assert!(exchange.step(END).expect("an interface that is up"), "nothing more to do");
        while let Some(event) = exchange.poll_event() {
            match event {
                Event::InOperation { .. } => {
                    assert!(exchange.now() < LOSES_FROM, "it is too late to be undisturbed");
                    begun = Some(exchange.main().statistics().cycles);
                }
                Event::Failed(error) => panic!("{error}"),
                _ => {}
            }
        }
    }
    let statistics = exchange.main().statistics();
    let begun = begun.expect("the segment comes up");
    let (cycles, frames_lost) = (statistics.cycles, statistics.frames_lost);
    let (witness, _) = exchange.into_parts();
    let saw = json!({
        "in_operation": cycles - begun - 1, "frames_lost": frames_lost, "calls": witness.calls,
        "unpunctual": witness.unpunctual, "wrong": witness.wrong, "fresh": witness.fresh,
        "stale": witness.stale, "apart": witness.apart, "requests": witness.requests,
    });
    std::fs::write(path, saw.to_string()).expect("the folder for temporary files is writable");
}
