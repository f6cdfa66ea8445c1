//! Two things at one instant: the same with the lane and without, at each tick of a cycle.

use isocat_sim::Watcher;
use isocat_wire::time::Picos;

use crate::line::Line;

/// Frames come a tick earlier in each cycle than in the one before, until they have come at each
/// place of a cycle: their ends meet SYNC pulses, and beginnings and ends of all steps.
#[test]
fn a_frame_may_end_when_a_step_does() {
    let mut both = [true, false].map(|lane| {
        let mut line = Line::with_constant_hops(1);
        line.segment.set_lane(lane);
        (line, Watcher::of_everything())
    });
    let tick = Picos(-10_000);
    for number in 0..=crate::line::cycle_of(1).0 / 10 {
        let [one, other] = both.each_mut().map(|(line, watcher)| {
            let bytes = line.moved_cycle(tick, watcher).to_vec();
            let seen: Vec<_> = watcher.take().collect();
            let device = &line.segment.devices()[0];
            let (esc, sync) = (&device.esc, device.stack.sync());
            // The engine as a whole, with all that is not visible from outside.
            let stack = (device.stack.state(), device.stack.next_timeout(), format!("{sync:?}"));
            (bytes, seen, esc.label(2), esc.label(3), esc.ram().to_vec(), stack)
        });
        assert_eq!(one, other, "{number} ticks earlier");
    }
    let [one, other] = both.each_ref().map(|(line, _)| {
        let device = &line.segment.devices()[0];
        (device.esc.registers(), device.esc.ram().to_vec(), format!("{:?}", device.stack.sync()))
    });
    assert_eq!(one, other);
}
