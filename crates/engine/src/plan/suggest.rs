//! Suggestions: the phase with the most even slack, and the smallest cycle.

use isocat_maindevice::Config;
use isocat_sync::SyncMode;
use isocat_sync::budget::common_window;
use isocat_sync::object::ShiftBy;
use isocat_wire::frame;
use isocat_wire::time::Nanos;

use super::Plan;
use super::report::Suggestion;
use super::warnings;

/// Computes both. The cycle is searched by repeated planning, with the phase left to the plan.
pub fn suggest(plan: &Plan) -> Suggestion {
    let timing = plan.timing();
    let cycle = timing.cycle;
    let devices = || timing.devices.iter().map(|(device, _)| device);
    let window = common_window(&cycle, devices());
    let ends = window.map(|window| {
        let earliest = window.earliest.unwrap_or(cycle.send);
        // The pulse comes in the bus cycle of the frame, even if all devices are slow.
        let end = cycle.send + cycle.cycle;
        (earliest, window.latest.map_or(end, |latest| latest.min(end)))
    });
    let shift = ends.map(|(earliest, latest)| {
        let middle = (earliest.0 + latest.0).div_euclid(2);
        Nanos(middle.div_euclid(TICK) * TICK)
    });
    // A line that does not depend on the phase may fail at any.
    let helps = |shift: &Nanos| {
        let shift = Nanos(shift.0.rem_euclid(cycle.cycle.0));
        plan.with(Config { shift: Some(shift), ..plan.config.clone() })
            .is_ok_and(|plan| plan.fits())
    };
    let no_shift_helps = shift.is_some_and(|shift| !helps(&shift));
    let slack = ends.zip(shift).map(|((earliest, latest), at)| (at - earliest).min(latest - at));
    let into_cycle = |phase: Nanos| phase.0.rem_euclid(cycle.cycle.0);
    let shiftable: Vec<usize> = (0..timing.devices.len())
        .filter(|position| {
            let object = plan.segment.devices[*position].output_sync.as_ref();
            let local = object.and_then(|object| object.values.supported);
            let device = &timing.devices[*position].0;
            device.mode.uses_dc()
                && device.outputs_arrival.is_some()
                && local.is_some_and(|types| types.shift() == ShiftBy::LocalTimer)
        })
        .collect();
    let acting = devices().filter(|d| d.mode.uses_dc() && d.outputs_arrival.is_some());
    let slowest = acting.map(|device| device.outputs_act_after()).max();
    let step = step(plan);
    Suggestion {
        no_shift_helps,
        shift_ns: shift.map(into_cycle),
        send_phase_ns: shift.map(|shift| into_cycle(-shift)),
        slack_ns: slack.map(|slack| slack.0),
        outputs_shift_ns: slowest.map(|shift| shift.0).filter(|_| !shiftable.is_empty()),
        outputs_shiftable: shiftable,
        smallest_cycle_ns: smallest_cycle(plan, step).map(|cycle| cycle.0),
        cycle_step_ns: step,
    }
}

/// Step of the cycles that are tried: a multiple of a microsecond, and of every SYNC0 cycle that
/// must divide it.
fn step(plan: &Plan) -> i64 {
    let subordinated = |mode| mode == SyncMode::DcSubordinated;
    let own = plan.timing().devices.iter().map(|(device, _)| device);
    let own = own.filter(|device| subordinated(device.mode)).map(|d| d.pulses.sync0_cycle.0);
    own.fold(MICROSECOND, least_common_multiple)
}

/// The smallest cycle, by bisection: a longer cycle has more slack in every line.
fn smallest_cycle(plan: &Plan, step: i64) -> Option<Nanos> {
    let fits = |count: i64| {
        let mut wished = Config { cycle: Nanos(count * step), shift: None, ..plan.config.clone() };
        // Slower devices keep their ratio to the bus cycle.
        for device in &mut wished.devices {
            let times = device.cycle.map(|own| own.0 / plan.config.cycle.0);
            device.cycle = times.map(|times| Nanos(times * wished.cycle.0));
        }
        plan.with(wished).is_ok_and(|plan| plan.fits() && mailboxes_fit(&plan))
    };
    let mut enough = 1;
    while !fits(enough) {
        enough *= 2;
        if enough * step > LONGEST {
            return None;
        }
    }
    let mut short = enough / 2;
    while enough - short > 1 {
        let middle = short + (enough - short) / 2;
        if fits(middle) {
            enough = middle;
        } else {
            short = middle;
        }
    }
    Some(Nanos(enough * step))
}

/// Whether the cycle has time for the longest mailbox message. A cycle that fits only the plan's
/// frames is no help.
fn mailboxes_fit(plan: &Plan) -> bool {
    let longest = plan.segment.devices.iter().filter_map(warnings::mailbox_frame).max();
    let frames = plan.timing().frames_in_cycle().line();
    // The line includes a short frame.
    longest.is_none_or(|longest| longest - SHORT_FRAME <= frames.slack())
}

fn least_common_multiple(a: i64, b: i64) -> i64 {
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    a / x * b
}

/// Time of the shortest frame on the wire, with its gap.
const SHORT_FRAME: Nanos =
    Nanos(((frame::MIN_LEN + frame::WIRE_OVERHEAD) as u64 * frame::BYTE_TIME_NS) as i64);
/// Grid of SYNC pulses, ns.
const TICK: i64 = 10;
const MICROSECOND: i64 = 1_000;
/// Longest cycle that is tried, ns.
const LONGEST: i64 = 1_000_000_000;
