//! Checks the delays while the segment runs.
//!
//! The machine asks [`DelayWatch::due`] when to latch, and passes the times to
//! [`DelayWatch::sample`]. A complete estimate is compared with the delays in force, and a
//! difference beyond the errors of both is returned as a [`Change`]. The stays of chips are the
//! same in both measurements, so only other errors count: quantization, noise and the speed of
//! clocks, which ran free at start.

use alloc::vec::Vec;

use isocat_sync::delay::Delay;
use isocat_wire::time::{Host, Nanos, Picos, Time};

use crate::config;
use crate::delay::{Estimator, STEERED_PPB, Times};
use crate::segment::{Segment, SubDevice};

/// Watches the delays. It is made when the segment is in operation.
pub(crate) struct DelayWatch {
    config: config::DelayWatch,
    next: Time<Host>,
    estimator: Estimator,
    devices: Vec<Watched>,
}

/// One SubDevice.
#[derive(Clone, Copy, Debug)]
struct Watched {
    /// The value of 0x0928; `None`: nothing to compare with.
    written: Option<Nanos>,
    /// Standard error of that, ps.
    error: i64,
    /// Its systematic part, ps.
    systematic: i64,
    /// Whether the change was reported.
    told: bool,
}

/// The result of an estimate for one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Change {
    pub position: usize,
    pub written: Nanos,
    /// `None`: the delay in force is right again.
    pub found: Option<Delay>,
}

/// Largest difference of the two, in standard errors. In a segment of 300, chance exceeds it in one
/// of ten thousand estimates.
const SIGMAS: i64 = 5;

impl DelayWatch {
    /// Watches the delays of a segment as they are in force; `None` without a reference clock.
    /// `jitters`: [`Config::hop_jitter`](crate::Config::hop_jitter).
    pub fn new(
        config: config::DelayWatch,
        segment: &Segment,
        now: Time<Host>,
        jitters: bool,
    ) -> Option<Self> {
        let watched = |device: &SubDevice| Watched::new(device.delay, device.measured_delay);
        Some(Self {
            config,
            next: now + config.every,
            estimator: Estimator::new(segment, segment.reference?, STEERED_PPB, jitters),
            devices: segment.devices.iter().map(watched).collect(),
        })
    }

    /// Whether a latch is due.
    pub fn due(&self, now: Time<Host>) -> bool {
        now >= self.next
    }

    /// Takes the times of a latch, or `None` if it did not come back complete. Returns the changes
    /// if the latch completes an estimate.
    pub fn sample(&mut self, now: Time<Host>, times: Option<&Times>) -> Vec<Change> {
        self.next = now + self.config.every;
        if let Some(times) = times {
            self.estimator.sample(times);
        }
        if self.estimator.latches() < self.config.latches {
            return Vec::new();
        }
        let delays = self.estimator.delays();
        self.estimator.restart();
        let all = self.devices.iter_mut().zip(delays).enumerate();
        all.filter_map(|(position, (device, delay))| device.judge(position, delay)).collect()
    }

    /// Called after 0x0928 was written with this delay.
    pub fn rewritten(&mut self, position: usize, delay: Delay) {
        if let (Some(device), Some(nanos)) = (self.devices.get_mut(position), delay.nanos()) {
            *device = Watched::new(Some(nanos), Some(delay));
        }
    }
}

impl Watched {
    fn new(written: Option<Nanos>, measured: Option<Delay>) -> Self {
        let (error, systematic) = match measured {
            Some(Delay::Known { standard_error, systematic, .. }) => {
                (standard_error.0, systematic.0)
            }
            _ => (0, 0),
        };
        Self { written, error, systematic, told: false }
    }

    fn judge(&mut self, position: usize, found: Delay) -> Option<Change> {
        let written = self.written?;
        let Delay::Known { delay, standard_error, systematic } = found else { return None };
        let apart = (delay - Picos::from(written)).0.abs();
        let square = |error: i64| u128::from(error.unsigned_abs()).pow(2);
        let error = (square(self.error) + square(standard_error.0)).isqrt() as i64;
        // The share of the free-running clocks' speeds at start is the part by which the systematic
        // error became smaller. Clocks in a drift loop have a hundredth of it. The register holds
        // whole ns.
        let speed = (self.systematic - systematic.0).max(0) * 102 / 100;
        let changed = apart > SIGMAS * error + speed + 1_000;
        match (changed, self.told) {
            (true, false) => {
                self.told = true;
                Some(Change { position, written, found: Some(found) })
            }
            (false, true) => {
                self.told = false;
                Some(Change { position, written, found: None })
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use isocat_wire::dl::DlStatus;
    use isocat_wire::{PortNumber, StationAddress};

    use super::*;
    use crate::delay::Latch;
    use crate::segment::DcCapability;

    const EVERY: Nanos = Nanos::millis(10);

    /// Two SubDevices, 720 ns of delay written to the second.
    fn segment() -> Segment {
        let device = |position: usize| {
            let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
            let ports = [PortNumber::P0, PortNumber::P1];
            let open =
                |status: DlStatus, port: &PortNumber| status.with_port(*port, true, false, true);
            device.dl_status = ports[..2 - position].iter().fold(DlStatus::default(), open);
            device.parent = position.checked_sub(1).map(|above| (above, PortNumber::P1));
            device.dc = DcCapability::Clock64;
            let delay = Picos(720_000 * position as i64);
            let (standard_error, systematic) = (Picos(600), Picos(100));
            device.measured_delay = Some(Delay::Known { delay, standard_error, systematic });
            device.delay = Some(Nanos(720 * position as i64));
            device
        };
        Segment { devices: (0..2).map(device).collect(), reference: Some(0), ..Segment::default() }
    }

    fn watch() -> DelayWatch {
        let config = config::DelayWatch { every: EVERY, latches: 4, rewrite: false };
        DelayWatch::new(config, &segment(), Time::ZERO, false).expect("it has a clock")
    }

    /// Takes four latches with this loop and returns the changes.
    fn estimate(watch: &mut DelayWatch, away: u32) -> Vec<Change> {
        let mut changes = Vec::new();
        for _ in 0..4 {
            assert!(changes.is_empty(), "only a whole estimate tells");
            let now = watch.next;
            assert!(!watch.due(now + Nanos(-1)) && watch.due(now));
            let at = now.count() as u32;
            let ports = |away: u32| Latch { ports: Some([at, at + away, 0, 0]), entry: 0 };
            changes = watch.sample(now, Some(&[ports(away), ports(0)].into()));
        }
        changes
    }

    /// The latches are at one place in the tick, so the error is 2.042 ns; with 0.6 ns of the first
    /// measurement it is 2.129 ns, times five.
    #[test]
    fn both_sides_of_the_error() {
        let mut watch = watch();
        assert_eq!(estimate(&mut watch, 1440), []);
        assert_eq!(estimate(&mut watch, 1440 + 22), [], "11 ns");
        let changes = estimate(&mut watch, 1440 + 24);
        assert_eq!((changes.len(), changes[0].position, changes[0].written), (1, 1, Nanos(720)));
        let found = changes[0].found.expect("it changed");
        assert_eq!(found.nanos(), Some(Nanos(732)));
        assert_eq!(estimate(&mut watch, 1440 + 24), [], "told once");
        let restored = Change { position: 1, written: Nanos(720), found: None };
        assert_eq!(estimate(&mut watch, 1440), [restored]);
        estimate(&mut watch, 1440 + 24);
        watch.rewritten(1, found);
        assert_eq!(estimate(&mut watch, 1440 + 24), [], "it is what is in force");
        assert_eq!(
            estimate(&mut watch, 1440 - 8).len(),
            1,
            "two errors of 2.042 ns: beyond 15.4 ns"
        );
    }

    #[test]
    fn lost_latches_do_not_count() {
        let mut watch = watch();
        for _ in 0..10 {
            let now = watch.next;
            assert_eq!(watch.sample(now, None), []);
            assert!(!watch.due(now), "the next one comes in its time");
        }
        assert_eq!(estimate(&mut watch, 2000).len(), 1);
    }

    #[test]
    fn without_a_reference_there_is_nothing_to_watch() {
        let none = Segment { reference: None, ..segment() };
        assert!(DelayWatch::new(config::DelayWatch::default(), &none, Time::ZERO, false).is_none());
    }
}
