//! The effect of clocks on a plan: how far the clocks of drift loops differ, and the error of a
//! time span counted by a free-running oscillator.

use isocat_wire::time::Nanos;

use super::Cycle;

/// Largest deviation of an oscillator if nothing else is stated, ppb: 100 ppm, the tolerance that
/// EtherCAT allows.
pub const USUAL_DEVIATION_PPB: i64 = 100_000;

/// The figures that determine the error of a clock under a drift loop.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Tracking {
    /// Time from one distributed system time to the next.
    pub cycle: Nanos,
    /// Deviation of its oscillator from that of the reference clock, ppb.
    pub deviation_ppb: i64,
    /// Register 0x0934.
    pub time_filter_depth: u8,
    /// Register 0x0935.
    pub speed_filter_depth: u8,
}

/// Largest distance of a clock from the reference clock while the drift loop controls it.
///
/// Fitted to both laws of the drift loop that the public record admits (`docs/dc.md`), for clocks
/// just after start-up. What a burst of drift frames has taught the loop about the speed is partly
/// wrong. The loop takes a number of cycles to correct it, and the clock drifts meanwhile; so the
/// error is proportional to the cycle. A speed filter shallower than the fitted one learns sooner,
/// but this is not used.
pub fn clock_error(tracking: &Tracking) -> Nanos {
    let Tracking { cycle, deviation_ppb, time_filter_depth, speed_filter_depth } = *tracking;
    let late = 1i128 << time_filter_depth.clamp(FITTED_TIME_DEPTH, 15) >> FITTED_TIME_DEPTH;
    let depth = speed_filter_depth.clamp(FITTED_SPEED_DEPTH, SLOWEST_SPEED_DEPTH);
    let slow = 1i128 << depth >> FITTED_SPEED_DEPTH;
    let wrong = MISLEARNED_PPB + i128::from(deviation_ppb) / MISLEARNED_PART;
    let away = i128::from(cycle.0) * wrong * late * slow;
    let left = ceiling(away, 1_000_000_000) + LEFT;
    Nanos(i64::try_from(left).unwrap_or(i64::MAX))
}

/// Largest difference of two counts of a span that no loop keeps together: their speeds, and a tick
/// of 10 ns on which pulses come. It is zero for clocks without error.
pub(super) fn speed_error(cycle: &Cycle, deviation_ppb: i64, span: Nanos) -> Nanos {
    match cycle.clock_error {
        Nanos::ZERO => Nanos::ZERO,
        _ => speed_part(cycle, deviation_ppb, span) + Nanos(TICK),
    }
}

/// The difference without the tick, for spans that begin at a pulse as it came.
pub(super) fn speed_part(cycle: &Cycle, deviation_ppb: i64, span: Nanos) -> Nanos {
    if cycle.clock_error == Nanos::ZERO {
        return Nanos::ZERO;
    }
    let error = ceiling(i128::from(span.0.max(0)) * i128::from(deviation_ppb), 1_000_000_000);
    Nanos(i64::try_from(error).unwrap_or(i64::MAX))
}

/// Largest movement of a clock against the reference clock in a span, while the loop controls it.
/// From one received time to the next it is at most the clock error.
pub(super) fn moved(cycle: &Cycle, span: Nanos) -> Nanos {
    let Cycle { cycle, clock_error, .. } = *cycle;
    let moved =
        ceiling(i128::from(clock_error.0) * i128::from(span.0.max(0)), i128::from(cycle.0.max(1)));
    Nanos(i64::try_from(moved).unwrap_or(i64::MAX)).min(clock_error + clock_error)
}

/// Division rounded up: a bound is rounded away from the value that it bounds.
const fn ceiling(value: i128, divisor: i128) -> i128 {
    value / divisor + (value % divisor > 0) as i128
}

/// Clocks and pulses move in ticks of 10 ns.
const TICK: i64 = 10;
/// Largest rest of a phase when a clock counts as converged, ns: the mean of its last readings,
/// their noise, and the ticks of both clocks.
const LEFT: i128 = 140;
/// Constant part of the speed error that a loop may have at the end of start-up, ppb.
const MISLEARNED_PPB: i128 = 28_000;
/// The part of the speed error that grows with the deviation is the deviation divided by this.
/// Fitted: 50 to 300 ppm, cycles of 1 to 20 ms.
const MISLEARNED_PART: i128 = 10;
/// The depth of 0x0935 for which the error was fitted.
const FITTED_SPEED_DEPTH: u8 = 6;
/// Deeper filters count as this one: they have no time to learn a wrong speed while a clock starts
/// up.
const SLOWEST_SPEED_DEPTH: u8 = 10;
/// The largest depth of 0x0934 that has no effect.
const FITTED_TIME_DEPTH: u8 = 8;

#[cfg(test)]
mod tests {
    use super::*;

    const fn led(cycle_ms: i64, ppm: i64) -> Tracking {
        Tracking {
            cycle: Nanos::millis(cycle_ms),
            deviation_ppb: ppm * 1_000,
            time_filter_depth: 4,
            speed_filter_depth: 6,
        }
    }

    /// Largest SYNC0 error that runs of a pair of clocks showed with either law, ns. The bound
    /// holds, and is at most four times the error plus the possible rest.
    #[test]
    fn the_bound_holds_what_was_seen_and_not_much_more() {
        for (cycle, ppm, seen) in [
            (1, 150, 22),
            (1, 300, 43),
            (4, 50, 64),
            (4, 150, 63),
            (4, 300, 153),
            (10, 50, 134),
            (10, 150, 127),
            (10, 300, 373),
            (20, 50, 274),
            (20, 150, 262),
            (20, 300, 743),
        ] {
            let bound = clock_error(&led(cycle, ppm)).0;
            assert!((seen..=4 * seen + 100).contains(&bound), "{cycle} ms, {ppm} ppm: {bound}");
        }
        // With the reset value of 0x0935, 4 ms and 300 ppm: 1797 ns with law block, 433 with hold.
        let slow = clock_error(&Tracking { speed_filter_depth: 12, ..led(4, 300) }).0;
        assert!((1_797..4_000).contains(&slow), "{slow}");
    }

    #[test]
    fn deeper_filters_are_slower() {
        let filtered = |time_filter_depth, speed_filter_depth| {
            let tracking = Tracking { time_filter_depth, speed_filter_depth, ..led(1, 140) };
            clock_error(&tracking).0
        };
        assert_eq!(
            [(4, 6), (0, 6), (8, 4), (9, 6), (4, 7), (4, 10), (4, 12)].map(|(t, s)| filtered(t, s)),
            [182, 182, 182, 224, 224, 812, 812]
        );
    }

    #[test]
    fn a_part_of_a_nanosecond_counts_as_one() {
        let cycle = Cycle {
            cycle: Nanos::millis(1),
            send: Nanos::ZERO,
            jitter: Nanos::ZERO,
            hop_jitter: Nanos::ZERO,
            ring_way: Nanos::ZERO,
            clock_error: Nanos(200),
            clock_error_origin: super::super::Origin::Computed,
            clock_deviation_ppb: USUAL_DEVIATION_PPB,
            limits: super::super::Limits::default(),
        };
        let error = |ppb, span| speed_error(&cycle, ppb, Nanos(span)).0;
        assert_eq!([0, 1, 10_000, 10_001].map(|span| error(100_000, span)), [10, 11, 11, 12]);
        // The profile states 137 ppm: 54.8 ns in 400 us.
        assert_eq!((error(100_000, 400_000), error(137_000, 400_000)), (50, 65));
        let ideal = Cycle { clock_error: Nanos::ZERO, ..cycle };
        assert_eq!(speed_error(&ideal, 100_000, Nanos(10_001)), Nanos::ZERO);
    }
}
