//! Has a clock converged to the reference? Judged by measured differences and their slope.
//!
//! A fixed number of drift frames says nothing: a clock may still slide when the frames are through.
//! Here a clock counts as converged when, over a window of readings of register 0x092C, it neither
//! differs nor moves by more than the limits.

use isocat_wire::time::{Host, Nanos, Time};

/// Readings that the judgement looks at.
const WINDOW: usize = 16;

/// When a clock counts as converged.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest difference from the reference in the window, ns.
    pub difference: Nanos,
    /// Largest slope of the differences, ns per second (ppb).
    pub slope_ppb: i64,
}

impl Default for Limits {
    /// 40 ns: twice the tick of both clocks. 1000 ppb: a clock that slides faster would leave those
    /// 40 ns within 40 cycles of 1 ms if the drift frames stopped.
    fn default() -> Self {
        Self { difference: Nanos(40), slope_ppb: 1_000 }
    }
}

/// What the readings of one clock say.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Verdict {
    /// Too few readings for a judgement.
    TooEarly,
    /// Out of the limits.
    Converging {
        /// Largest difference in the window.
        worst: Nanos,
        /// Slope over the window, ns per second.
        slope_ppb: i64,
    },
    /// Within the limits over the whole window.
    Converged {
        /// Largest difference in the window.
        worst: Nanos,
        /// Slope over the window, ns per second.
        slope_ppb: i64,
    },
}

/// The last readings of one clock.
#[derive(Clone, Copy, Debug)]
pub struct Convergence {
    limits: Limits,
    readings: [(Time<Host>, Nanos); WINDOW],
    count: usize,
}

impl Convergence {
    /// No reading yet.
    pub fn new(limits: Limits) -> Self {
        Self { limits, readings: [(Time::ZERO, Nanos::ZERO); WINDOW], count: 0 }
    }

    /// Takes one reading of the system time difference.
    pub fn sample(&mut self, at: Time<Host>, difference: Nanos) {
        self.readings[self.count % WINDOW] = (at, difference);
        self.count += 1;
    }

    /// Judges the window.
    pub fn verdict(&self) -> Verdict {
        if self.count < WINDOW {
            return Verdict::TooEarly;
        }
        let worst = self.readings.iter().map(|(_, d)| d.abs()).max().unwrap_or_default();
        let slope_ppb = self.slope_ppb();
        if worst <= self.limits.difference && slope_ppb.abs() <= self.limits.slope_ppb {
            Verdict::Converged { worst, slope_ppb }
        } else {
            Verdict::Converging { worst, slope_ppb }
        }
    }

    /// Slope of the least-squares line through the window.
    fn slope_ppb(&self) -> i64 {
        let oldest = self.readings[self.count % WINDOW].0;
        let x = |at: Time<Host>| i128::from((at - oldest).0);
        let n = WINDOW as i128;
        let (mut sx, mut sy, mut sxx, mut sxy) = (0i128, 0i128, 0i128, 0i128);
        for (at, difference) in self.readings {
            let (x, y) = (x(at), i128::from(difference.0));
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
        }
        let denominator = n * sxx - sx * sx;
        if denominator == 0 {
            return 0;
        }
        ((n * sxy - sx * sy) * 1_000_000_000 / denominator) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings every millisecond along a line.
    fn line(start: i64, per_ms: i64) -> Convergence {
        let mut convergence = Convergence::new(Limits::default());
        for i in 0..WINDOW as i64 {
            let at = Time::new(7_000_000 + 1_000_000 * i as u64);
            convergence.sample(at, Nanos(start + per_ms * i));
        }
        convergence
    }

    #[test]
    fn both_sides_of_the_difference() {
        assert_eq!(line(40, 0).verdict(), Verdict::Converged { worst: Nanos(40), slope_ppb: 0 });
        assert_eq!(line(-41, 0).verdict(), Verdict::Converging { worst: Nanos(41), slope_ppb: 0 });
    }

    #[test]
    fn both_sides_of_the_slope() {
        assert_eq!(line(-8, 1).verdict(), Verdict::Converged { worst: Nanos(8), slope_ppb: 1_000 });
        let sliding = Verdict::Converging { worst: Nanos(16), slope_ppb: -2_000 };
        assert_eq!(line(16, -2).verdict(), sliding);
    }

    #[test]
    fn one_reading_less_than_the_window_is_too_early() {
        let mut convergence = Convergence::new(Limits::default());
        for i in 0..WINDOW as u64 - 1 {
            convergence.sample(Time::new(i), Nanos::ZERO);
        }
        assert_eq!(convergence.verdict(), Verdict::TooEarly);
        convergence.sample(Time::new(99), Nanos::ZERO);
        assert_ne!(convergence.verdict(), Verdict::TooEarly);
    }

    #[test]
    fn old_readings_are_forgotten() {
        let mut convergence = line(100_000, 0);
        for i in 0..WINDOW as u64 {
            convergence.sample(Time::new(100_000_000 + i * 1_000_000), Nanos(5));
        }
        assert!(matches!(convergence.verdict(), Verdict::Converged { .. }));
    }
}
