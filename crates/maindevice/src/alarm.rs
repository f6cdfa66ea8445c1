//! Alarms: reports that a value left its limits, and that it is back.

use core::fmt;

use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

/// What is wrong with a SubDevice, or with the timing of its frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Alarm {
    /// 0x092C stays beyond the limit.
    Difference,
    /// 0x092C stays beyond the limit, and its slope does not lead back to it.
    NotConverging,
    /// The clock drifts: the slope of 0x092C over the last readings is larger than a working drift
    /// loop leaves.
    Sliding,
    /// The first SYNC pulse is still pending (0x0984): the clock makes no pulses.
    SyncPending,
    /// The clock's registers cannot be read.
    Silent,
    /// Frames come so late that less time is left before SYNC0 than configured.
    Margin,
    /// A counter of 0x1C32 or 0x1C33 rises, or its sync error (:20) is set.
    Counter,
    /// The mailbox does not answer.
    MailboxSilent,
}

impl Alarm {
    /// The alarms of clocks.
    pub const OF_CLOCKS: [Alarm; 5] =
        [Self::Difference, Self::NotConverging, Self::Sliding, Self::SyncPending, Self::Silent];
}

/// An alarm that comes or goes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Change {
    /// Position of the SubDevice.
    pub position: usize,
    /// The alarm.
    pub alarm: Alarm,
    /// True if the alarm came, false if it is over.
    pub raised: bool,
    /// The values that raised or ended it.
    pub found: Found,
}

/// The values that raised or ended an alarm.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Found {
    /// Of a clock.
    Clock {
        /// 0x092C as last read.
        difference: Nanos,
        /// Slope of 0x092C over the last readings, ns per second; 0 while there are too few.
        slope_ppb: i64,
    },
    /// Of the time before SYNC0.
    Margin {
        /// Time that the latest frame left.
        left: Nanos,
        /// Time that is configured.
        limit: Nanos,
    },
    /// Of an object.
    Counter {
        /// The object.
        object: ObjectAddress,
        /// Its value as last read.
        value: u32,
        /// Increase since the first reading.
        risen: u64,
    },
    /// Of the mailbox.
    Mailbox {
        /// Services without an answer so far.
        unanswered: u32,
    },
}

impl Change {
    /// The alarm without the place: `the clock is off: 0x092C is 340 ns, slope +3000 ns/s, away`.
    pub const fn what(&self) -> What {
        What(*self)
    }
}

/// Displays an alarm without its place, see [`Change::what`].
#[derive(Clone, Copy, Debug)]
pub struct What(Change);

/// `SubDevice 2: the clock does not converge: 0x092C is 340 ns, slope +3000 ns/s, away`
impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SubDevice {}: {}", self.position, self.what())
    }
}

impl fmt::Display for What {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(change) = self;
        let what = match change.alarm {
            Alarm::Difference => "the clock is off",
            Alarm::NotConverging => "the clock does not converge",
            Alarm::Sliding => "the clock slides",
            Alarm::SyncPending => "the first SYNC pulse is pending (0x0984)",
            Alarm::Silent => "the clock's registers do not answer",
            Alarm::Margin => "frames come too near to SYNC0",
            Alarm::Counter => "a counter rises",
            Alarm::MailboxSilent => "the mailbox does not answer",
        };
        let over = if change.raised { "" } else { "over: " };
        write!(f, "{over}{what}: {}", change.found)
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Found::Clock { difference, slope_ppb } => {
                let way = match slope_ppb * difference.0.signum() {
                    1.. => ", away",
                    0 => "",
                    _ => ", back",
                };
                write!(f, "0x092C is {difference}, slope {slope_ppb:+} ns/s{way}")
            }
            Found::Margin { left, limit } => write!(f, "{left} left, {limit} wanted"),
            Found::Counter { object, value, risen } => {
                write!(f, "{object} is {value}, has risen by {risen}")
            }
            Found::Mailbox { unanswered } => write!(f, "{unanswered} services without an answer"),
        }
    }
}

/// A state that several bad readings in a row raise, and several good ones end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Hysteresis {
    up: bool,
    count: u8,
    raise: u8,
    let_go: u8,
}

impl Hysteresis {
    /// Numbers of readings in a row that raise it and end it; at least one each.
    pub const fn new(raise: u8, let_go: u8) -> Self {
        Self { up: false, count: 0, raise, let_go }
    }

    /// Takes a reading. `bad`: beyond the limit, `good`: well within. Returns the new state if it
    /// changed.
    pub fn sample(&mut self, bad: bool, good: bool) -> Option<bool> {
        let (counts, needed) = if self.up { (good, self.let_go) } else { (bad, self.raise) };
        self.count = if counts { self.count + 1 } else { 0 };
        if self.count < needed {
            return None;
        }
        *self = Self { up: !self.up, count: 0, ..*self };
        Some(self.up)
    }

    pub const fn is_up(&self) -> bool {
        self.up
    }
}

/// Readings in a row that raise an alarm.
pub(crate) const RAISE: u8 = 3;
/// Readings in a row that end an alarm.
pub(crate) const LET_GO: u8 = 8;

#[cfg(test)]
mod tests {
    use alloc::string::ToString;

    use super::*;

    /// Tests both sides of each number of readings. A reading that is neither bad nor good ends a
    /// row.
    #[test]
    fn rows_raise_and_let_go() {
        let mut alarm = Hysteresis::new(2, 3);
        let (bad, good, neither) = ((true, false), (false, true), (false, false));
        let steps = [
            (bad, None),
            (neither, None),
            (bad, None),
            (bad, Some(true)),
            (good, None),
            (good, None),
            (neither, None),
            (good, None),
            (good, None),
            (good, Some(false)),
            (bad, None),
        ];
        for (at, ((bad, good), expected)) in steps.into_iter().enumerate() {
            assert_eq!(alarm.sample(bad, good), expected, "step {at}");
        }
    }

    #[test]
    fn alarms_in_words() {
        let found = Found::Clock { difference: Nanos(-340), slope_ppb: -3_000 };
        let mut change = Change { position: 2, alarm: Alarm::NotConverging, raised: true, found };
        let away =
            "SubDevice 2: the clock does not converge: 0x092C is -340 ns, slope -3000 ns/s, away";
        assert_eq!(change.to_string(), away);
        (change.raised, change.alarm) = (false, Alarm::Counter);
        let object = ObjectAddress::new(0x1C32, 0x0B);
        change.found = Found::Counter { object, value: 3, risen: 6 };
        let over = "SubDevice 2: over: a counter rises: 0x1C32:0B is 3, has risen by 6";
        assert_eq!(change.to_string(), over);
    }
}
