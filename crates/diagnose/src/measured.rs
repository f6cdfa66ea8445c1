//! What is measured of each cycle, for programs that keep or draw it while a capture is read.

/// A figure of one cycle. Times are ns from the first frame of EtherCAT, by the stamps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Measured {
    /// Operation begins: what was measured before is none of it.
    Restart,
    /// From one cycle to the next, ns, by the stamps of the capture.
    Interval {
        /// When the second one began.
        at_ns: u64,
        /// The interval.
        ns: u64,
    },
    /// The same by the clock of the reference.
    IntervalByClock {
        /// When the second one began.
        at_ns: u64,
        /// The interval.
        ns: u64,
    },
    /// From the end of a cyclic frame at the reference to the next SYNC0 of some devices, ns. It
    /// goes on below 0 and beyond the cycle where frames wander past SYNC0.
    Distance {
        /// When the frame was seen.
        at_ns: u64,
        /// Which devices: those whose [`Distance`](crate::report::Distance) has this grid.
        grid: Grid,
        /// The distance. At a device it is shorter by its propagation delay.
        ns: i64,
    },
}

/// Devices whose SYNC0 comes at the same instants.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Grid {
    /// From one SYNC0 to the next, ns; not 0.
    pub cycle: u64,
    /// A SYNC0 came at this system time, ns, less whole cycles.
    pub phase: u64,
}

/// What looks on while a capture is read.
pub type Onlooker<'a> = dyn FnMut(Measured) + 'a;
