//! What is measured of each cycle, for programs that store or draw it while a capture is read.

/// A figure of one cycle. Times are ns from the first frame of EtherCAT, by the stamps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Measured {
    /// Operation begins: earlier values do not belong to it.
    Restart,
    /// The time between the beginnings of two cycles, ns, by the stamps of the capture.
    Interval {
        /// When the second cycle began.
        at_ns: u64,
        /// The interval.
        ns: u64,
    },
    /// The time between the beginnings of two cycles, ns, by the reference clock.
    IntervalByClock {
        /// When the second cycle began.
        at_ns: u64,
        /// The interval.
        ns: u64,
    },
    /// From the end of a cyclic frame at the reference to the next SYNC0 of some devices, ns. It
    /// continues below 0 and beyond the cycle where frames move past SYNC0.
    Distance {
        /// When the frame was seen.
        at_ns: u64,
        /// The devices whose [`Distance`](crate::report::Distance) has this grid.
        grid: Grid,
        /// The distance. At a device it is shorter by the device's propagation delay.
        ns: i64,
    },
}

/// The instants of SYNC0 that some devices share.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Grid {
    /// From one SYNC0 to the next, ns; not 0.
    pub cycle: u64,
    /// System time of a SYNC0, ns, modulo `cycle`.
    pub phase: u64,
}

/// A callback that receives each measured value while a capture is read.
pub type Onlooker<'a> = dyn FnMut(Measured) + 'a;
