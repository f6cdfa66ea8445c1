//! Suggestions: the phase with the most even slack, and the smallest cycle.

use isocat_maindevice::Config;
use isocat_segment::Scenario;
use isocat_sync::SyncMode;
use isocat_sync::budget::{self, SyncLimits, common_window};
use isocat_sync::object::ShiftBy;
use isocat_sync::opmode::BusCycles;
use isocat_wire::frame;
use isocat_wire::time::Nanos;

use super::Plan;
use super::report::{OwnCycle, Suggestion, TriedCycles};
use super::warnings;

/// Computes both for a plan of this scenario. The cycle is searched by repeated planning, with the
/// phase left to the plan.
pub fn suggest(plan: &Plan, scenario: &Scenario) -> Suggestion {
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
    let cycles = cycles(plan, scenario);
    let smallest = cycles.and_then(|cycles| smallest_cycle(plan, scenario, cycles));
    Suggestion {
        no_shift_helps,
        shift_ns: shift.map(into_cycle),
        send_phase_ns: shift.map(|shift| into_cycle(-shift)),
        slack_ns: slack.map(|slack| slack.0),
        outputs_shift_ns: slowest.map(|shift| shift.0).filter(|_| !shiftable.is_empty()),
        outputs_shiftable: shiftable,
        smallest_cycle_ns: smallest.as_ref().map(|scenario| scenario.cycle.0),
        own_cycles: smallest.iter().flat_map(own_cycles).collect(),
        drops_shift: scenario.shift.is_some(),
        cycles: cycles.map(|BusCycles { step, least, most }| TriedCycles {
            step_ns: step.0,
            least_ns: least.0,
            most_ns: most.0,
        }),
    }
}

/// The cycles up to a second that the OpMode and the SYNC unit of every device take, and that every
/// SYNC0 cycle divides which the file or the device fixes. Of those that are nearer to each other
/// than a microsecond, its multiples are tried. `None`: there are none.
fn cycles(plan: &Plan, scenario: &Scenario) -> Option<BusCycles> {
    let all = BusCycles { most: LONGEST, ..BusCycles::ANY };
    let planned = plan.timing().devices.iter().map(|(device, _)| device);
    let mut devices = scenario.devices.iter().zip(planned);
    let taken = devices.try_fold(all, |all, (device, planned)| {
        let times = device.cycle.map_or(1, |own| own.0 / scenario.cycle.0);
        let taken = match &device.op_mode {
            Some(op_mode) => at_bus(op_mode.bus_cycles()?, times),
            None => BusCycles::ANY,
        };
        let fixed = match device.op_mode {
            Some(_) => device.asked.sync0_cycle,
            None => Some(planned.pulses.sync0_cycle)
                .filter(|_| planned.mode == SyncMode::DcSubordinated),
        };
        let own = planned.exchange(&plan.timing().cycle);
        let limited = at_bus(limited(planned, own, fixed)?, times);
        let taken = common(common(all, taken)?, limited)?;
        common(taken, multiples(fixed.unwrap_or(Nanos(1))))
    })?;
    match taken.step < MICROSECOND {
        true => common(taken, multiples(MICROSECOND)).or(Some(taken)),
        false => Some(taken),
    }
}

/// The cycles of its exchange that the limits of its SYNC unit leave a device, whose exchange now
/// has the cycle `own`. `fixed` is a SYNC0 cycle that stays as it is at any other. `None`: there
/// are none.
fn limited(device: &budget::Device, own: Nanos, fixed: Option<Nanos>) -> Option<BusCycles> {
    let SyncLimits { longest, step } = device.sync_limits;
    let (longest, step) = (longest.unwrap_or(BusCycles::ANY.most), step.unwrap_or(Nanos(1)));
    if !device.mode.uses_dc() || device.sync_limits == SyncLimits::default() {
        return Some(BusCycles::ANY);
    }
    let up_to = |most: i64| Nanos(most.min(BusCycles::ANY.most.0));
    if device.mode != SyncMode::DcSubordinated {
        return common(multiples(step), BusCycles { most: up_to(longest.0), ..BusCycles::ANY });
    }
    // SYNC1 counts from the first SYNC0 of the cycle.
    let behind = device.pulses.behind_sync0();
    let of_sync1 = longest - behind;
    match fixed {
        Some(sync0) if sync0 > longest || sync0.0 % step.0 != 0 => None,
        Some(sync0) => Some(BusCycles { most: up_to((of_sync1 + sync0).0), ..BusCycles::ANY }),
        None => {
            let count = own.0.checked_div(device.pulses.sync0_cycle.0).unwrap_or(1).max(2);
            let most = (longest.0 * count).min(of_sync1.0 * count / (count - 1));
            let step = Nanos(step.0.checked_mul(count)?);
            common(multiples(step), BusCycles { most: up_to(most), ..BusCycles::ANY })
        }
    }
}

/// The bus cycles at which a device that takes part in every `times`-th of them has one of these.
fn at_bus(own: BusCycles, times: i64) -> BusCycles {
    let step = own.step.0 / greatest_common_divisor(own.step.0, times);
    BusCycles {
        step: Nanos(step),
        least: Nanos(divide_up(own.least.0, times)),
        most: Nanos(own.most.0 / times),
    }
}

fn multiples(step: Nanos) -> BusCycles {
    BusCycles { step, least: step, ..BusCycles::ANY }
}

/// What is in both; `None` if nothing is.
fn common(a: BusCycles, b: BusCycles) -> Option<BusCycles> {
    let step = a.step.0 / greatest_common_divisor(a.step.0, b.step.0);
    let step = step.checked_mul(b.step.0)?;
    let least = divide_up(a.least.max(b.least).0, step).checked_mul(step)?;
    let most = a.most.min(b.most).0 / step * step;
    let cycles = BusCycles { step: Nanos(step), least: Nanos(least), most: Nanos(most) };
    (least <= most).then_some(cycles)
}

/// The segment at the smallest of these cycles that fits, by bisection: a longer cycle has more
/// slack in every line.
fn smallest_cycle(plan: &Plan, scenario: &Scenario, cycles: BusCycles) -> Option<Scenario> {
    let at = |number: i64| {
        let scenario = scenario.at_cycle(Nanos(cycles.least.0 + cycles.step.0 * number))?;
        let plan = plan.with(scenario.config()).ok()?;
        (plan.fits() && mailboxes_fit(&plan)).then_some(scenario)
    };
    let last = (cycles.most - cycles.least).0 / cycles.step.0;
    // `short` does not fit, or is before the first one.
    let (mut short, mut long) = (-1, 0);
    let mut found = loop {
        if let Some(scenario) = at(long) {
            break scenario;
        }
        if long == last {
            return None;
        }
        (short, long) = (long, (2 * long + 1).min(last));
    };
    while long - short > 1 {
        let middle = short + (long - short) / 2;
        match at(middle) {
            Some(scenario) => (found, long) = (scenario, middle),
            None => short = middle,
        }
    }
    Some(found)
}

/// The cycles of devices that are slower than the bus.
fn own_cycles(scenario: &Scenario) -> impl Iterator<Item = OwnCycle> + '_ {
    let own = |(position, device): (usize, &isocat_segment::segment_file::SubDevice)| {
        Some(OwnCycle { position, cycle_ns: device.cycle?.0 })
    };
    scenario.devices.iter().enumerate().filter_map(own)
}

/// Whether the cycle has time for the longest mailbox message. A cycle that fits only the plan's
/// frames is no help.
fn mailboxes_fit(plan: &Plan) -> bool {
    let longest = plan.segment.devices.iter().filter_map(warnings::mailbox_frame).max();
    let frames = plan.timing().frames_in_cycle().line();
    // The line includes a short frame.
    longest.is_none_or(|longest| longest - SHORT_FRAME <= frames.slack())
}

fn divide_up(a: i64, b: i64) -> i64 {
    -(-a).div_euclid(b)
}

fn greatest_common_divisor(a: i64, b: i64) -> i64 {
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    x
}

/// Time of the shortest frame on the wire, with its gap.
const SHORT_FRAME: Nanos =
    Nanos(((frame::MIN_LEN + frame::WIRE_OVERHEAD) as u64 * frame::BYTE_TIME_NS) as i64);
/// Grid of SYNC pulses, ns.
const TICK: i64 = 10;
const MICROSECOND: Nanos = Nanos::micros(1);
/// Longest cycle that is tried.
pub(super) const LONGEST: Nanos = Nanos::millis(1_000);
