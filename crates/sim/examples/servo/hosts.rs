//! The hosts for the laws.

use isocat_sim::HostModel;
use isocat_sim::host::{Delay, Stall};
use isocat_sim::oscillator::Step;
use isocat_wire::time::Nanos;

/// A host, and its disturbance.
#[derive(Clone, Copy)]
pub struct Course {
    /// Name in the table.
    pub name: &'static str,
    /// The host, without its clock's deviation.
    pub host: HostModel,
    /// Mean time from stamp to wire in addition to the constant part: the setting of a MainDevice
    /// on this host.
    pub stamp_noise: Nanos,
    /// True time of the disturbance, if there is one.
    pub disturbance: Option<Nanos>,
}

/// True time at which the clock steps or the program stalls: laws have settled by then.
const DISTURBANCE: Nanos = Nanos(4_000_000_000);

const QUIET: HostModel = HostModel {
    clock_ppb: 0,
    jitter: Nanos::ZERO,
    latency: Nanos(2_000),
    extremes: false,
    clock_step: None,
    wake_ups: None,
    hold_ups: None,
    stall: None,
};

/// Wake-ups are about 5 us late, one of a thousand 50 to 150 us more. The time from stamp to wire
/// is 0.5 us, one of two thousand 10 to 50 us more.
const REAL_TIME: HostModel = HostModel {
    wake_ups: Some(Delay {
        mean: Nanos(5_000),
        one_of: 1_000,
        more: (Nanos(50_000), Nanos(150_000)),
    }),
    hold_ups: Some(Delay { mean: Nanos(500), one_of: 2_000, more: (Nanos(10_000), Nanos(50_000)) }),
    ..QUIET
};

/// Wake-ups are about 30 us late, one of 500 stalls for 1 to 5 ms. The time from stamp to wire is
/// 10 us, one of a thousand 0.1 to 1 ms more.
const DESKTOP: HostModel = HostModel {
    wake_ups: Some(Delay {
        mean: Nanos(30_000),
        one_of: 500,
        more: (Nanos(1_000_000), Nanos(5_000_000)),
    }),
    hold_ups: Some(Delay {
        mean: Nanos(10_000),
        one_of: 1_000,
        more: (Nanos(100_000), Nanos(1_000_000)),
    }),
    ..QUIET
};

const STEP: Option<Step> = Some(Step { by_ppb: -50_000, at: DISTURBANCE });
const STALL: Option<Stall> = Some(Stall { at: DISTURBANCE, length: Nanos(1_000_000) });

/// All hosts.
pub const COURSES: [Course; 7] = [
    course("ideal", QUIET, 0),
    course("real-time", REAL_TIME, 500),
    course("desktop", DESKTOP, 10_000),
    course("ideal, 50 ppm step", HostModel { clock_step: STEP, ..QUIET }, 0),
    course("ideal, 1 ms stall", HostModel { stall: STALL, ..QUIET }, 0),
    course("real-time, 50 ppm step", HostModel { clock_step: STEP, ..REAL_TIME }, 500),
    course("real-time, 1 ms stall", HostModel { stall: STALL, ..REAL_TIME }, 500),
];

const fn course(name: &'static str, host: HostModel, stamp_noise: i64) -> Course {
    let happens = host.clock_step.is_some() || host.stall.is_some();
    let disturbance = if happens { Some(DISTURBANCE) } else { None };
    Course { name, host, stamp_noise: Nanos(stamp_noise), disturbance }
}
