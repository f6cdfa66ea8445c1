//! Words for the host and for others on the wire: stall, late-wake-ups, slow-send, second-master.

use isocat_wire::AlState;

use crate::onlooker::{SEGMENT, ms, run, with};

#[test]
fn no_program_runs_while_the_host_stands_still() {
    let (seen, _) = with(100, "stall 20ms");
    assert_eq!(seen.instants(), [(ms(100), true), (ms(120), false)]);
    assert_eq!(seen.between(&seen.sent, 100, 120), 0);
    assert_eq!(seen.between(&seen.cycles, 100, 120), 0);
    assert!(seen.between(&seen.sent, 120, 121) >= 1);
    assert!(seen.between(&seen.sent, 90, 100) >= 9);
}

/// How late frames leave behind the cycle's beginning, which no jitter moves in this segment.
fn lateness(what: &str) -> (Vec<i64>, Vec<i64>) {
    let text = format!("{SEGMENT}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"{what}\"\n");
    let (seen, _) = run(&text);
    let phase = |from: u64, to: u64| {
        let span = seen.at(from)..seen.at(to);
        let first = seen.at(90);
        let of: Vec<u64> = seen.sent.iter().filter(|at| span.contains(at)).copied().collect();
        // Cyclic frames alone: the first of each cycle.
        of.chunk_by(|one, next| next - one < 300_000)
            .map(|cycle| (cycle[0] - first) as i64 % 1_000_000)
            .collect::<Vec<i64>>()
    };
    let base = phase(90, 99)[0];
    // A little earlier than the base is a little less than a whole cycle late.
    let behind = |at: i64| (at - base + 1_000_000 + 100_000) % 1_000_000 - 100_000;
    let late = |from, to| phase(from, to).into_iter().map(behind).collect();
    (late(101, 199), late(210, 900))
}

#[test]
fn timers_wake_the_host_late_for_a_time() {
    let (during, behind) = lateness("late-wake-ups 50us 90us for 100ms");
    let inside = during.iter().filter(|late| (50_000..=93_000).contains(*late)).count();
    assert!(inside * 10 >= during.len() * 9, "{during:?}");
    assert!(behind.iter().all(|late| *late < 5_000), "{behind:?}");
}

#[test]
fn frames_leave_behind_their_time_stamp() {
    let (during, behind) = lateness("slow-send 30us 60us 50% for 100ms");
    let slow = during.iter().filter(|late| (30_000..=63_000).contains(*late)).count();
    assert!((during.len() / 4..during.len() * 3 / 4).contains(&slow), "{during:?}");
    assert!(behind.iter().all(|late| *late < 5_000), "{behind:?}");
}

#[test]
fn another_maindevice_sends_at_the_same_end() {
    let (seen, report) = with(100, "second-master count 10ms for 495ms");
    assert_eq!(seen.between(&seen.foreign, 100, 2_000), 50);
    // It asks and changes nothing.
    assert!(report.devices.iter().all(|device| device.registers.al_status.is_op()));

    let (seen, _) = with(100, "second-master init 10s");
    assert_eq!(seen.between(&seen.foreign, 100, 1_100), 1);
    for device in 0..3 {
        let moves = seen.moves(device);
        assert_eq!((moves[0].0, moves[0].1), (100, AlState::Init), "SubDevice {device}");
    }
}
