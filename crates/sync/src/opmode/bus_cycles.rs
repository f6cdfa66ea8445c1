//! The bus cycles at which an OpMode repeats once per bus cycle.

use core::cmp::Ordering;
use core::fmt;

use isocat_wire::time::Nanos;

use super::{OpMode, Problem, Unit, Warnings};

/// The bus cycles that an OpMode allows: the multiples of a step within a range.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct BusCycles {
    /// Every one is a multiple of this; 1 ns or more.
    pub step: Nanos,
    /// The shortest, a multiple of the step.
    pub least: Nanos,
    /// The longest, a multiple of the step; at most [`BusCycles::ANY`]'s.
    pub most: Nanos,
}

impl BusCycles {
    /// Every bus cycle that a register of 32 bits holds.
    pub const ANY: Self = Self { step: Nanos(1), least: Nanos(1), most: Nanos(LONGEST) };

    /// Whether a bus cycle is one of them.
    pub const fn contains(&self, bus: Nanos) -> bool {
        bus.0 >= self.least.0 && bus.0 <= self.most.0 && bus.0 % self.step.0 == 0
    }

    /// The one that is nearest to a wished bus cycle; of two, the longer.
    pub const fn nearest(&self, wished: Nanos) -> Nanos {
        // Half a step more before the division rounds to the nearest multiple.
        let steps = wished.0.saturating_add(self.step.0 / 2) / self.step.0;
        let multiple = steps.saturating_mul(self.step.0);
        if multiple < self.least.0 {
            self.least
        } else if multiple > self.most.0 {
            self.most
        } else {
            Nanos(multiple)
        }
    }
}

/// Completes "a cycle of": `2 ms`, `a multiple of 250 us`, `100 us or more`, `any length`.
impl fmt::Display for BusCycles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { step, least, most } = *self;
        if least == most {
            return write!(f, "{least}");
        }
        // Without a limit of the OpMode there is no room for a further step.
        let (short, long) = (least > step, most.0 <= LONGEST - step.0);
        match (step.0, short || long) {
            (1, false) => return f.write_str("any length"),
            (1, true) => {}
            (_, false) => return write!(f, "a multiple of {step}"),
            (_, true) => write!(f, "a multiple of {step}, ")?,
        }
        match (short, long) {
            (true, true) => write!(f, "{least} to {most}"),
            (true, false) => write!(f, "{least} or more"),
            (false, _) => write!(f, "{most} or less"),
        }
    }
}

impl OpMode {
    /// The bus cycles at which the pulses repeat exactly once per bus cycle; every one if there are
    /// no pulses, `None` if there is no such bus cycle.
    ///
    /// A fixed SYNC0 allows its own cycle, or its multiples where SYNC1 marks the bus cycle. SYNC0
    /// by factor allows whatever the distance of SYNC1 leaves.
    pub fn bus_cycles(&self, unit: &Unit) -> Option<BusCycles> {
        if self.why_no_pulses(unit).is_some() {
            return Some(BusCycles::ANY);
        }
        let step = match (self.sync0.value, self.sync0.factor) {
            (value @ 1.., _) => value,
            // A bus cycle that these parts do not divide drifts against its own pulses.
            (0, Some(factor @ ..0)) => i64::from(factor.unsigned_abs()),
            _ => 1,
        };
        let count = LONGEST / step;
        if count == 0 {
            return None;
        }
        // The period less the bus cycle only falls or only rises with the bus cycle, because the
        // bus cycle enters both in no more than one linear term. So those without a difference lie
        // side by side.
        let ordering = |steps: i64| self.period_against(Nanos(steps * step));
        let at_first = ordering(1);
        let first = match at_first {
            Ordering::Equal => 1,
            _ => first_with(1, count, |steps| ordering(steps) != at_first)?,
        };
        if ordering(first) != Ordering::Equal {
            return None;
        }
        let behind = first_with(first, count, |steps| ordering(steps) != Ordering::Equal);
        let last = behind.map_or(count, |behind| behind - 1);
        Some(BusCycles { step: Nanos(step), least: Nanos(first * step), most: Nanos(last * step) })
    }

    /// The period of the pulses, compared with the bus cycle.
    fn period_against(&self, bus: Nanos) -> Ordering {
        match self.period(bus) {
            Ok(period) => period.cmp(&bus),
            // A value that no register holds is longer than any bus cycle, and a part below 1 ns
            // is shorter.
            Err(Problem::Register { value: ..=0, .. }) => Ordering::Less,
            Err(_) => Ordering::Greater,
        }
    }

    fn period(&self, bus: Nanos) -> Result<Nanos, Problem> {
        // The doubts are those of `registers`.
        let mut doubts = Warnings::default();
        let sync0 = self.sync0_cycle(bus, &Unit::default(), &mut doubts)?;
        let sync1 = self.sync1(bus, sync0, &mut doubts)?;
        Ok(Nanos(i64::from(sync0) * i64::from(self.count(sync0, sync1))))
    }
}

/// The first number after `from`, up to `to`, at which the condition holds. It does not hold at
/// `from`, and once it holds, it holds up to `to`.
fn first_with(from: i64, to: i64, holds: impl Fn(i64) -> bool) -> Option<i64> {
    let (mut without, mut with) = (from, to);
    if from >= to || !holds(to) {
        return None;
    }
    while with - without > 1 {
        let middle = without + (with - without) / 2;
        if holds(middle) {
            with = middle;
        } else {
            without = middle;
        }
    }
    Some(with)
}

/// The longest bus cycle, ns.
const LONGEST: i64 = u32::MAX as i64;
