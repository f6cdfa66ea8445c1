//! Propagation delays from the receive times of the ports, and how well they are known.
//!
//! A write to register 0x0900 latches, at each port of each ESC, when that frame arrived there.
//! Only differences within one ESC have a meaning, since each ESC counts its own time. Frames pass
//! the ports in the order 0 → 3 → 1 → 2, so the time at a port less the time at the port before it
//! is the round trip through the branch behind that port (ESC data sheet section I, "propagation
//! delay measurement"). Let A be above B, `a` the port of A towards B, and `p` the port visited
//! before `a`:
//!
//! ```text
//! t(A→B) = ((tA_a - tA_p) - (tB_last - tB_entry) + tDiff) / 2
//! ```
//!
//! Here `tDiff` is the time that A adds on the way out less the time that B adds on the way back.
//!
//! - [`Node`] is a SubDevice in the tree with the times of one latch, [`Stay`] the time its ESC
//!   adds.
//! - [`propagation_delays`] evaluates one latch; its results go into one [`Mean`] for each
//!   SubDevice.
//! - [`Averaging`] evaluates all of them, and with it [`Mean::delay`] gives the [`Delay`].
//! - [`hop_jitter()`] is the jitter that the ports add to frames; a mean may
//!   [expect](Mean::expecting) it.
//! - [`turn()`] turns the tree for frames that come from the other end of a ring.
//!
//! Errors. Each counter counts ticks of 10 ns and shows the last one, so a receive time is early by
//! a value in 0..10 ns. Along a line the times of the SubDevices in between cancel. What remains is
//! ±5 ns at either end, and 5 to 10 ns at each fork; the coefficients of the times give the exact
//! amount. Latches at different places within the tick average the error out, and the spread over
//! all SubDevices shows how far they did. Errors that no latch shows are kept apart as
//! [`Delay::Known::systematic`]: stays that are not known well, and clocks that run at different
//! speeds. A cable or a PHY that is slower in one direction is in neither part: half the difference
//! is an error that this measurement cannot see.

mod jitter;
mod mean;
mod path;
#[cfg(test)]
mod tests;
mod turn;

use core::fmt;

use isocat_wire::address::PortNumber;
use isocat_wire::time::{Nanos, Picos};

pub use jitter::{Hop, HopJitter, hop_jitter};
pub use mean::{Averaging, Mean};
pub use path::{Found, propagation_delays};
pub use turn::turn;

/// One SubDevice as the delay measurement sees it. Nodes may stand in any order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Node {
    /// Index of its parent in the tree, and the parent's port. `None`: frames meet this SubDevice
    /// first.
    pub parent: Option<(usize, PortNumber)>,
    /// The port through which frames come in; 0 unless the cables are swapped.
    pub entry: PortNumber,
    /// Ports through which frames leave, including the entry.
    pub open: [bool; 4],
    /// Receive times of the ports, ns of its own counter, wrapping; `None` without distributed
    /// clocks.
    pub receive_times: Option<[u32; 4]>,
    /// The time that its ESC adds.
    pub stay: Stay,
}

/// How long an ESC keeps a frame between one port and the next, and how well that is known.
///
/// Only differences count: between the processing delay and the forwarding delay of one kind of
/// ESC, and between two kinds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Stay {
    /// Kind of ESC (register 0x0000). ESCs of the same kind have the same unknown error.
    pub kind: u8,
    /// A stay through the processing unit.
    pub processing: Picos,
    /// A stay past the processing unit.
    pub forwarding: Picos,
    /// Bound of the error of `processing - forwarding`.
    pub difference_bound: Picos,
    /// Bound of the error of either stay against that of another kind.
    pub kind_bound: Picos,
}

impl Stay {
    /// How long an ESC keeps frames, by its type (register 0x0000). Captured receive times of a
    /// line of ET1100 and ET1200 (loops of 600 and 310 ns) give 155 ns out and 135 ns back, to a
    /// tick. Other types contain the same core and use the same figures. An unknown type counts as
    /// equal in both directions, with the average of the known stays.
    pub fn of_esc(kind: u8) -> Self {
        let nanos = |ns: i64| Picos(1_000 * ns);
        match kind {
            0x04 | 0x11 | 0x12 | 0x98 | 0xC0 => Self {
                kind,
                processing: nanos(155),
                forwarding: nanos(135),
                difference_bound: nanos(10),
                kind_bound: nanos(20),
            },
            _ => Self {
                kind,
                processing: nanos(145),
                forwarding: nanos(145),
                difference_bound: nanos(40),
                kind_bound: nanos(150),
            },
        }
    }
}

/// The delay of one SubDevice: from the instant at which a frame reaches the processing unit of the
/// reference clock until it reaches that of this SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Delay {
    /// It was measured.
    Known {
        /// The delay, 0 or more.
        delay: Picos,
        /// Standard deviation (1 sigma) of the quantization and noise that remain in the mean.
        standard_error: Picos,
        /// A bound of the errors that averaging does not reduce: stays not known well, and speeds
        /// of clocks.
        systematic: Picos,
    },
    /// The receive times do not determine it.
    Indeterminate {
        /// The reason.
        why: Why,
        /// The least and the largest value that the times allow, if they limit it.
        between: Option<(Picos, Picos)>,
    },
}

/// Why a delay cannot be known. SubDevices are named by their index among the nodes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Why {
    /// The SubDevice has no receive times (no register 0x0900).
    NoReceiveTimes,
    /// A SubDevice without usable receive times branches between this SubDevice and the next clock
    /// above it, so it is not known how the round trip divides among the branches.
    BranchWithoutTimes {
        /// The SubDevice that branches.
        at: usize,
    },
    /// Its own receive times contradict each other: an open port has an earlier time than the port
    /// visited before it, or none.
    TimesContradict,
    /// The parent measured a round trip into the branch that is shorter than the SubDevice's own
    /// loop.
    ShorterThanLoop {
        /// The SubDevice above, which measured the branch.
        above: usize,
        /// The difference, less the noise.
        by: Nanos,
    },
    /// The delay of the SubDevice above it cannot be known.
    Above {
        /// The SubDevice above.
        at: usize,
    },
    /// No SubDevice with receive times stands above both it and the reference clock.
    NothingInCommon,
    /// The reference clock has no usable receive times.
    NoReference,
    /// No latch came back.
    NoLatch,
}

impl Delay {
    /// The delay for register 0x0928, in whole ns; `None` if it was not measured.
    pub fn nanos(&self) -> Option<Nanos> {
        match self {
            Self::Known { delay, .. } => Some(rounded(*delay)),
            Self::Indeterminate { .. } => None,
        }
    }

    /// Half the width of the interval that holds the true delay with a confidence of 95 %: 1.96
    /// standard errors plus the whole systematic part.
    pub fn bar(&self) -> Option<Picos> {
        match self {
            Self::Known { standard_error, systematic, .. } => {
                Some(Picos(standard_error.0.saturating_mul(196) / 100 + systematic.0))
            }
            Self::Indeterminate { .. } => None,
        }
    }

    /// A value to use: the delay, or the middle of the range that the times allow, or 0 ns without
    /// such a range. The middle is wrong by at most half the width of the range.
    pub fn or_middle(&self) -> Nanos {
        match self {
            Self::Known { delay, .. } => rounded(*delay),
            Self::Indeterminate { between: Some((least, most)), .. } => {
                rounded(Picos(least.0 + (most.0 - least.0) / 2))
            }
            Self::Indeterminate { between: None, .. } => Nanos::ZERO,
        }
    }
}

/// Rounds to the nearest ns.
fn rounded(span: Picos) -> Nanos {
    Nanos((span.0 + 500).div_euclid(1_000))
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoReceiveTimes => f.write_str("it has no receive times (0x0900)"),
            Self::BranchWithoutTimes { at } => {
                write!(f, "SubDevice {at}, which branches above it, has no usable receive times")
            }
            Self::TimesContradict => f.write_str(
                "its receive times contradict each other, expected them to grow in the order of the ports 0, \
                 3, 1, 2",
            ),
            Self::ShorterThanLoop { above, by } => write!(
                f,
                "frames are away from SubDevice {above} for {by} less than it keeps them by its own times"
            ),
            Self::Above { at } => write!(f, "that of SubDevice {at} above it can't be known"),
            Self::NothingInCommon => {
                f.write_str("no SubDevice with receive times stands above both it and the reference clock")
            }
            Self::NoReference => {
                f.write_str("the reference clock gave no usable receive times (0x0900)")
            }
            Self::NoLatch => f.write_str("no latch of the receive times (0x0900) was complete"),
        }
    }
}

impl Node {
    /// The open ports in the order in which a frame that entered at [`Node::entry`] visits them.
    fn visited(&self) -> impl DoubleEndedIterator<Item = PortNumber> + '_ {
        let order = PortNumber::PROCESSING_ORDER;
        let first = order.iter().position(|port| *port == self.entry).unwrap_or(0);
        (0..4)
            .map(move |i| order[(first + i) % 4])
            .filter(|port| self.open[port.index()] || *port == self.entry)
    }

    fn visited_ports(&self) -> usize {
        self.visited().count()
    }

    /// The last port at which a frame comes back, or the entry of a leaf.
    fn last(&self) -> PortNumber {
        self.visited().last().unwrap_or(self.entry)
    }

    /// The port that a frame visits before `port`.
    fn before(&self, port: PortNumber) -> PortNumber {
        self.visited().take_while(|other| *other != port).last().unwrap_or(self.entry)
    }

    /// The arrival port from which a frame goes on through the processing unit, which is behind
    /// port 0: port 0, or else the next open port after it in processing order.
    fn unit(&self) -> PortNumber {
        use PortNumber::{P0, P1, P2, P3};
        let open = |port: &PortNumber| self.open[port.index()] || *port == self.entry;
        [P0, P2, P1, P3].into_iter().find(open).unwrap_or(self.entry)
    }

    /// Whether a frame that arrives at `port` passes the processing unit before it leaves.
    fn processes(&self, port: PortNumber) -> bool {
        port == self.unit()
    }

    /// ns between two receive times. They wrap; no frame is away for 2^31 ns.
    fn between(&self, from: PortNumber, to: PortNumber) -> i64 {
        let times = self.receive_times.unwrap_or_default();
        i64::from(times[to.index()].wrapping_sub(times[from.index()]) as i32)
    }
}

impl Stay {
    /// An ESC whose stays are known exactly.
    pub const fn exact(kind: u8, processing: Picos, forwarding: Picos) -> Self {
        Self {
            kind,
            processing,
            forwarding,
            difference_bound: Picos::ZERO,
            kind_bound: Picos::ZERO,
        }
    }

    fn of(&self, processed: bool) -> Picos {
        if processed { self.processing } else { self.forwarding }
    }

    /// The stay of one ESC less that of the other, and the bound of its error. The flags tell
    /// whether each is passed through the processing unit.
    fn difference(out: (&Self, bool), back: (&Self, bool)) -> (Picos, Picos) {
        let difference = out.0.of(out.1) - back.0.of(back.1);
        let bound = if out.0.kind != back.0.kind {
            out.0.kind_bound + back.0.kind_bound
        } else if out.1 != back.1 {
            Picos(out.0.difference_bound.0.max(back.0.difference_bound.0))
        } else {
            Picos::ZERO
        };
        (difference, bound)
    }
}
