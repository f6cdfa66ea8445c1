//! Counts of a run.

use isocat_wire::time::Nanos;

/// Counts of frames, datagrams and cycles, and the phase errors of the host.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Statistics {
    /// Frames sent.
    pub frames_sent: u64,
    /// Frames that came back and were ours.
    pub frames_received: u64,
    /// Frames that were given up and have not come back. A frame is lost or late, never both: a
    /// frame that comes back after its timeout moves to [`Self::frames_late`]. So this count may
    /// decrease; [`Self::frames_missed`] never does.
    pub frames_lost: u64,
    /// Frames that came back after they had been given up.
    pub frames_late: u64,
    /// Those of them that belonged to a cycle.
    pub cyclic_late: u64,
    /// Cyclic frames that came back when the next cycle had begun. The host may have held them up
    /// before they left, so that outputs came a cycle late; or the wire after that.
    pub frames_behind: u64,
    /// Those of them that came back later than a cycle and the longest way through the segment
    /// after they had left: each cycle then has the inputs of the one before.
    pub frames_slow: u64,
    /// Frames of ours that came in unexpectedly for another reason: a second time, damaged so that
    /// they do not match what was sent, or so late that their index was in use again.
    pub frames_unexpected: u64,
    /// Frames of ours that came in unchanged, without processing by an ESC (working counters 0,
    /// positions as sent): the interface shows the frames it sends, or there is a loop-back. Only
    /// detected if [`Config::source`] has bit 1 of its first octet clear.
    ///
    /// [`Config::source`]: crate::Config::source
    pub frames_echoed: u64,
    /// Copies of frames that did not come back in a ring ([`Config::ring`](crate::Config::ring)),
    /// of both ports.
    pub copies_lost: u64,
    /// EtherCAT frames of another source: another MainDevice sends on this wire.
    pub frames_foreign: u64,
    /// Source address of the last foreign frame. The first ESC that a frame passes sets bit 1 of
    /// the first octet.
    pub foreign_source: Option<[u8; 6]>,
    /// Frames that are not EtherCAT.
    pub frames_other: u64,
    /// Datagrams sent.
    pub datagrams: u64,
    /// Frames sent until all SubDevices were in OP; 0 before.
    pub bring_up_frames: u64,
    /// Drift frames (FRMW of 0x0910) sent at start and in the cycle.
    pub drift_frames: u64,
    /// Drift frames that were sent before the clocks had converged.
    pub drift_burst: u64,
    /// Latches of the receive times (0x0900), from which delays are measured.
    pub delay_latches: u64,
    /// Latches that were not used: the frame was lost, or not every SubDevice
    /// took it.
    pub delay_latches_lost: u64,
    /// Cycles begun.
    pub cycles: u64,
    /// Send instants that the caller missed.
    pub cycles_skipped: u64,
    /// Cyclic datagrams with a wrong working counter: process data and drift.
    pub working_counter_errors: u64,
    /// Host time from the first frame until the clocks had converged; `None` before, or without
    /// clocks.
    pub time_to_converged: Option<Nanos>,
    /// Host time from the first frame until all SubDevices were in OP; `None` before.
    pub time_to_operation: Option<Nanos>,
    /// How much later than planned frames of the cycle found the reference clock, by the number of
    /// each frame: one that is a cycle late is not in time for the next one. Counted while all
    /// SubDevices are to be in OP.
    pub phase_error: Summary,
}

impl Statistics {
    /// Frames that did not come back in time, lost or late. It never decreases.
    pub fn frames_missed(&self) -> u64 {
        self.frames_lost + self.frames_late
    }
}

/// Least, largest and mean of samples, ns.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Summary {
    /// Number of samples.
    pub count: u64,
    /// Least; 0 without samples.
    pub min: Nanos,
    /// Largest; 0 without samples.
    pub max: Nanos,
    /// The latest; 0 without samples.
    pub last: Nanos,
    sum: i128,
    squares: u128,
}

impl Summary {
    /// Takes one sample.
    #[inline(always)]
    pub fn add(&mut self, sample: Nanos) {
        if self.count == 0 {
            (self.min, self.max) = (sample, sample);
        }
        self.count += 1;
        self.last = sample;
        self.min = self.min.min(sample);
        self.max = self.max.max(sample);
        self.sum += i128::from(sample.0);
        self.squares += u128::from(sample.0.unsigned_abs()).pow(2);
    }

    /// Mean, rounded towards zero; `None` without samples.
    pub fn mean(&self) -> Option<Nanos> {
        (self.count > 0).then(|| Nanos((self.sum / i128::from(self.count)) as i64))
    }

    /// Standard deviation, rounded down; `None` without samples.
    pub fn deviation(&self) -> Option<Nanos> {
        let mean = self.mean()?.0;
        let variance = (self.squares / u128::from(self.count))
            .saturating_sub(u128::from(mean.unsigned_abs()).pow(2));
        Some(Nanos(variance.isqrt() as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_of_known_samples() {
        let mut summary = Summary::default();
        assert_eq!((summary.mean(), summary.deviation()), (None, None));
        for sample in [2, 4, 4, 4, 5, 5, 7, 9] {
            summary.add(Nanos(sample));
        }
        assert_eq!((summary.min, summary.max, summary.last), (Nanos(2), Nanos(9), Nanos(9)));
        assert_eq!((summary.mean(), summary.deviation()), (Some(Nanos(5)), Some(Nanos(2))));
    }
}
