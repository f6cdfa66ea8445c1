//! Points in time on clocks that do not mix, and the spans between them.
//!
//! A point is a [`Time`] marked with the clock from which it was read. Points wrap, as the counters
//! do; spans are signed. Two points of different clocks can be neither compared nor subtracted:
//!
//! ```compile_fail
//! use isocat_wire::time::{Dc, Host, Time};
//! let system = Time::<Dc>::new(1_000);
//! let host = Time::<Host>::new(400);
//! let difference = system - host; // a host clock is no system time
//! ```
//!
//! ```
//! use isocat_wire::time::{Dc, Nanos, Time};
//! let system = Time::<Dc>::new(1_000);
//! assert_eq!(system + Nanos(500) - system, Nanos(500));
//! ```

use core::fmt;
use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Neg, Sub, SubAssign};

/// A clock that gives points of time.
pub trait Scale: Copy + Eq + Ord + 'static {
    /// The signed difference of two points of this clock.
    type Span: Copy + Into<i64> + From<i64>;
    /// The clock's name in messages.
    const NAME: &'static str;
}

/// The simulator's physical time, in picoseconds since the run began.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum True {}
/// The oscillator of one SubDevice, in ns since power-on as that oscillator counts them. The ESC
/// counts it in 10 ns ticks, and the CPU runs on it. The drift loop does not change it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Device {}
/// The local time of one ESC, in ns: the counter that registers 0x0900 and 0x0918 show. The drift
/// loop corrects its speed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Local {}
/// System time: ns since 2000-01-01 00:00 UTC, the common time of a segment (register 0x0910).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Dc {}
/// The MainDevice's own monotonic clock, in ns.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Host {}
/// A time from outside the segment, in ns since 2000-01-01 00:00: that of another segment or of a
/// network.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum External {}

macro_rules! scale {
    ($($scale:ident $span:ident $name:literal;)*) => {$(
        impl Scale for $scale { type Span = $span; const NAME: &'static str = $name; }
    )*};
}
scale! {
    True Picos "true time";
    Device Nanos "device oscillator";
    Local Nanos "local time";
    Dc Nanos "system time";
    Host Nanos "host time";
    External Nanos "external time";
}

/// A point on the clock `S`. It wraps at 2^64 of its unit (ns; ps for [`True`]).
pub struct Time<S: Scale>(u64, PhantomData<S>);

impl<S: Scale> Time<S> {
    /// The clock's zero.
    pub const ZERO: Self = Self::new(0);
    /// A point that no run reaches; it stands for "never" in a minimum of due times.
    pub const NEVER: Self = Self::new(u64::MAX);

    /// The point at `count` units of the clock.
    pub const fn new(count: u64) -> Self {
        Self(count, PhantomData)
    }

    /// The clock's count: ns, or ps for [`True`].
    pub const fn count(self) -> u64 {
        self.0
    }

    /// The signed span from `earlier` to this point; correct if they are within half the range.
    pub fn since(self, earlier: Self) -> S::Span {
        S::Span::from(self.0.wrapping_sub(earlier.0) as i64)
    }
}

impl Time<Dc> {
    /// Position in a cycle of `cycle` ns, counted from system time zero. A cycle of 0 gives 0.
    pub fn phase(self, cycle: u64) -> u64 {
        if cycle == 0 { 0 } else { self.0 % cycle }
    }

    /// The time nearest to this one whose lower half is `low`: what a clock of 32 bits shows, at
    /// most 2.147 s before or after this time.
    pub fn nearest(self, low: u32) -> Self {
        Self::new(self.0.wrapping_add_signed(i64::from(low.wrapping_sub(self.0 as u32) as i32)))
    }
}

impl Time<True> {
    /// This point in whole ns, rounded down, for printing.
    pub const fn as_nanos(self) -> u64 {
        self.0 / 1000
    }
}

impl<S: Scale> Clone for Time<S> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<S: Scale> Copy for Time<S> {}
impl<S: Scale> PartialEq for Time<S> {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}
impl<S: Scale> Eq for Time<S> {}
/// Ordered by count, which is correct for clocks that do not wrap within a run (all 64-bit ones).
impl<S: Scale> Ord for Time<S> {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.0.cmp(&other.0)
    }
}
impl<S: Scale> PartialOrd for Time<S> {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<S: Scale> Default for Time<S> {
    fn default() -> Self {
        Self::ZERO
    }
}
impl<S: Scale> fmt::Debug for Time<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.0, S::NAME)
    }
}

impl<S: Scale> Sub for Time<S> {
    type Output = S::Span;
    fn sub(self, earlier: Self) -> S::Span {
        self.since(earlier)
    }
}
impl<S: Scale> Add<S::Span> for Time<S> {
    type Output = Self;
    fn add(self, span: S::Span) -> Self {
        Self::new(self.0.wrapping_add_signed(span.into()))
    }
}
impl<S: Scale> AddAssign<S::Span> for Time<S> {
    fn add_assign(&mut self, span: S::Span) {
        *self = *self + span;
    }
}

macro_rules! span {
    ($(#[$doc:meta])* $span:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
        pub struct $span(pub i64);

        impl $span {
            /// A span of zero.
            pub const ZERO: Self = Self(0);
            /// The absolute value.
            pub const fn abs(self) -> Self {
                Self(self.0.saturating_abs())
            }
        }
        impl From<i64> for $span {
            fn from(count: i64) -> Self {
                Self(count)
            }
        }
        impl From<$span> for i64 {
            fn from(span: $span) -> i64 {
                span.0
            }
        }
        impl Add for $span {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0.saturating_add(other.0))
            }
        }
        impl AddAssign for $span {
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl Sub for $span {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0.saturating_sub(other.0))
            }
        }
        impl SubAssign for $span {
            fn sub_assign(&mut self, other: Self) {
                *self = *self - other;
            }
        }
        impl Neg for $span {
            type Output = Self;
            fn neg(self) -> Self {
                Self(self.0.saturating_neg())
            }
        }
    };
}

span! {
    /// A signed span in nanoseconds. Arithmetic saturates.
    Nanos
}
span! {
    /// A signed span of true time in picoseconds. Arithmetic saturates.
    Picos
}

impl Nanos {
    /// Converts a register or object field of 32 bits, ns.
    pub const fn from_u32(ns: u32) -> Self {
        Self(ns as i64)
    }
    /// A span of whole microseconds.
    pub const fn micros(us: i64) -> Self {
        Self(us * 1_000)
    }
    /// A span of whole milliseconds.
    pub const fn millis(ms: i64) -> Self {
        Self(ms * 1_000_000)
    }
    /// The value as an unsigned 32-bit field, if it fits.
    pub fn to_u32(self) -> Option<u32> {
        u32::try_from(self.0).ok()
    }
}

impl From<Nanos> for Picos {
    fn from(ns: Nanos) -> Self {
        Picos(ns.0.saturating_mul(1000))
    }
}

/// Prints in the most readable unit: `12 ns`, `3.5 us`, `1 ms`, `10 s`.
impl fmt::Display for Nanos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let magnitude = self.0.unsigned_abs();
        let (unit, name) = match magnitude {
            0..1_000 => (1, "ns"),
            1_000..1_000_000 => (1_000, "us"),
            1_000_000..1_000_000_000 => (1_000_000, "ms"),
            _ => (1_000_000_000, "s"),
        };
        if self.0 < 0 {
            f.write_str("-")?;
        }
        write!(f, "{}", magnitude / unit)?;
        let mut fraction = magnitude % unit;
        if fraction > 0 {
            f.write_str(".")?;
            let mut place = unit / 10;
            while fraction > 0 {
                write!(f, "{}", fraction / place)?;
                fraction %= place;
                place /= 10;
            }
        }
        write!(f, " {name}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn points_wrap_and_spans_saturate() {
        let before = Time::<Dc>::new(u64::MAX - 4);
        let after = before + Nanos(10);
        assert_eq!(after.count(), 5);
        assert_eq!(after - before, Nanos(10));
        assert_eq!(before - after, Nanos(-10));
        assert_eq!(Nanos(i64::MAX) + Nanos(1), Nanos(i64::MAX));
    }

    #[test]
    fn a_clock_of_32_bits_is_read_near_a_time() {
        let near = Time::<Dc>::new(7 << 32 | 0xFFFF_FFF0);
        assert_eq!(near.nearest(0xFFFF_FF00), Time::new(7 << 32 | 0xFFFF_FF00));
        assert_eq!(near.nearest(0x10), Time::new(8 << 32 | 0x10));
        // Half of its range is the edge.
        assert_eq!(near.nearest(0x7FFF_FFEF), Time::new(8 << 32 | 0x7FFF_FFEF));
        assert_eq!(near.nearest(0x7FFF_FFF0), Time::new(7 << 32 | 0x7FFF_FFF0));
        assert_eq!(Time::<Dc>::new(5).nearest(0xFFFF_FFFF), Time::new(u64::MAX));
    }

    #[test]
    fn spans_read_well() {
        let shown = |ns| Nanos(ns).to_string();
        assert_eq!(shown(0), "0 ns");
        assert_eq!(shown(-999), "-999 ns");
        assert_eq!(shown(62_500), "62.5 us");
        assert_eq!(shown(1_000_000), "1 ms");
        assert_eq!(shown(1_000_001), "1.000001 ms");
        assert_eq!(shown(10_000_000_000), "10 s");
    }
}
