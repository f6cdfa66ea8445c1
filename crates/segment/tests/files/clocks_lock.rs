//! Clocks lock with some thousand drift frames, whatever the cycle.

use isocat_maindevice::Stage;
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::Tap;
use isocat_wire::time::{Time, True};

/// A tap that keeps nothing.
struct NoTap;

impl Tap for NoTap {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
}

/// The plan refuses the longest of these cycles, but only when clocks have locked. Without jitter
/// of hops nothing widens the limits that a clock must keep.
#[test]
fn clocks_lock_at_short_and_long_cycles() {
    for cycle in ["250us", "1ms", "10ms", "50ms", "200ms"] {
        for law in ["hold", "block"] {
            let text = format!(
                "cycle = \"{cycle}\"\nhop_jitter = false\ndrift_law = \"{law}\"\nfor = \"1s\"\n\
                 [[subdevice]]\ndevice = \"microchip_samd51_lan9252_ssc\"\ncount = 5\n"
            );
            let file = SegmentFile::parse("line.toml", &text).expect("a segment file");
            let outcome = Scenario::from(file).run().execute(None::<NoTap>, &mut |_| {});
            let stage = outcome.failure.as_ref().map(|failure| failure.stage);
            assert!(matches!(stage, None | Some(Stage::Plan)), "{cycle}, {law}: {stage:?}");
            let frames = outcome.world.main().statistics().drift_burst;
            assert!((500..6_000).contains(&frames), "{cycle}, {law}: {frames} drift frames");
        }
    }
}

/// A clock 25 ppm off gains 80 ns while its loop learns the speed, and would need another 2000
/// frames to lose them by the phase of the drift law. It begins as far behind, so it does not.
#[test]
fn clocks_begin_as_far_behind_as_they_gain() {
    for law in ["hold", "block"] {
        let text = format!(
            "cycle = \"1ms\"\nhop_jitter = false\ndrift_law = \"{law}\"\nfor = \"1s\"\n\
             [[subdevice]]\ndevice = \"microchip_samd51_lan9252_ssc\"\nclock = \"0ppm\"\n\
             [[subdevice]]\ndevice = \"microchip_samd51_lan9252_ssc\"\nclock = \"25ppm\"\n\
             [[subdevice]]\ndevice = \"microchip_samd51_lan9252_ssc\"\nclock = \"-45ppm\"\n"
        );
        let file = SegmentFile::parse("line.toml", &text).expect("a segment file");
        let outcome = Scenario::from(file).run().execute(None::<NoTap>, &mut |_| {});
        assert!(outcome.in_sync(), "{law}");
        let frames = outcome.world.main().statistics().drift_burst;
        assert!((400..1_000).contains(&frames), "{law}: {frames} drift frames");
        for device in &outcome.bench.devices()[1..] {
            let first = device.sync0.as_ref().and_then(|judge| judge.settling().first());
            let distance = first.expect("edges for a second").difference.abs().0 / 1_000;
            assert!(distance <= 60, "{law}: {distance} ns at OP");
        }
    }
}
