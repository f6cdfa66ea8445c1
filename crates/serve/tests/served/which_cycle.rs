//! Outputs that act a whole cycle late are found with any MainDevice: by their content, without a
//! plan and with no intent but the SYNC units.

use crate::line::Line;
use isocat_segment::{Scenario, SegmentFile};
use isocat_wire::frame;
use isocat_wire::register;
use isocat_wire::time::{Nanos, Picos, Time, True};

/// SYNC1 comes 657 us behind the frame, and SYNC0 `sync1` before it.
fn scenario(sync1: &str) -> Scenario {
    let text = format!(
        "cycle = \"1ms\"\nhop_jitter = false\nclocks = \"0ppm\"\ndrift_law = \"proportional\"\nshift = \"657us\"\n[[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync1\"\nsync1 = \"{sync1}\"\n"
    );
    let file = SegmentFile::parse("a test", &text).expect("a segment");
    Scenario { force: true, ..Scenario::from(file) }
}

fn line(scenario: &Scenario) -> Line {
    let mut line = Line::with(scenario, scenario.run().setup.config);
    line.bring_up();
    line
}

fn kinds(line: &Line) -> Vec<&'static str> {
    let judged = line.server.judged().expect("judged");
    judged.devices[0].findings.iter().map(|finding| finding.kind.name()).collect()
}

#[test]
fn frames_behind_the_sync0_that_fetches_them_are_a_cycle_late() {
    let mut late = line(&scenario("800us"));
    late.run(Nanos::millis(200), |_| false);
    assert_eq!(kinds(&late), ["outputs-late"]);
    let judged = late.server.judged().expect("judged");
    assert!(!judged.in_sync());
    let [outputs, inputs] = judged.devices[0].ages;
    // 657 us to SYNC1, one cycle more, and 30 us from there, within the phase error of the frames.
    assert!((outputs.mean() / 1e6 - 1_687.0).abs() < 1.0, "{outputs:?}");
    // From SYNC1 to the next frame, which takes some 8 us.
    assert!((inputs.mean() / 1e6 - 350.0).abs() < 3.0, "{inputs:?}");

    let mut mended = line(&scenario("500us"));
    mended.run(Nanos::millis(200), |_| false);
    assert_eq!(kinds(&mended), [""; 0]);
    let outputs = mended.server.judged().expect("judged").devices[0].ages[0];
    assert!((outputs.mean() / 1e6 - 687.0).abs() < 1.0, "{outputs:?}");
}

/// The MainDevice sends one frame each cycle, whose last bit is stored `behind` ns after SYNC1.
/// Returns the number of outputs that acted, and of those that were late.
fn stored_behind_sync1(behind: i64) -> (u64, u64) {
    let mut line = line(&scenario("500us"));
    line.run(Nanos::millis(20), |_| false);
    let frame = line.cyclic.clone();
    let before = counts(&line);
    let len = Picos(frame::duration_ns(frame.len()) as i64 * 1000);
    for _ in 0..50 {
        let now = line.server.served().now();
        let segment = line.server.served().segment();
        let device = &segment.devices()[0];
        let way = segment.path().entries[0].after + len;
        // The register has the value of its last read; the pulse has the same phase in each cycle.
        let pulse = i128::from(device.esc.register(register::SYNC1_NEXT)) * 1000;
        let until = (pulse - device.system_time_ps(now)).rem_euclid(CYCLE_PS);
        let stored: Time<True> = now + Picos(until as i64) + Picos(behind * 1000);
        let start = line.server.served().host_time(stored + Picos(-way.0));
        let mut bytes = frame.clone();
        line.server.idle(start);
        line.server.frame(start, &mut bytes);
        line.server.after(&bytes);
        line.server.idle(start + Nanos::micros(300));
    }
    let after = counts(&line);
    (after.0 - before.0, after.1 - before.1)
}

const CYCLE_PS: i128 = 1_000_000_000;

fn counts(line: &Line) -> (u64, u64) {
    let judge = &line.server.served().bench().devices()[0].outputs_cycle;
    (judge.age().count(), judge.late().count())
}

/// A pulse comes with the first 10 ns tick at or behind the time in its register. It passes over
/// outputs that are stored up to that nanosecond, so they act late; outputs stored later do not.
#[test]
fn both_sides_of_the_acting_pulse() {
    let late: Vec<_> = (-1..=10)
        .map(|behind| {
            let (acted, late) = stored_behind_sync1(behind);
            // The first frame replaces one that was sent at another phase.
            assert!(acted == 50 && (late <= 1 || late >= 49), "{behind} ns: {late} of {acted}");
            late >= 49
        })
        .collect();
    assert!(late[0] && !late[late.len() - 1], "{late:?}");
    assert!(late.is_sorted_by(|before, after| before >= after), "one edge: {late:?}");
}
