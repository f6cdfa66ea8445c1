//! Outputs are ready before SYNC0 acts on them.

use isocat_wire::time::{Device, Time};

use crate::statistics::Statistics;

/// Watches one SubDevice: from the SM2 event, and from the end of copying, to SYNC0. All spans are
/// counted by the SubDevice's own oscillator, as its times in 0x1C32 are.
#[derive(Clone, Debug, Default)]
pub struct SyncMargin {
    sm2: Option<Time<Device>>,
    ready: Option<Time<Device>>,
    distance: Statistics,
    margin: Statistics,
    unready: u64,
}

impl SyncMargin {
    /// Outputs were stored.
    pub fn sm2(&mut self, at: Time<Device>) {
        self.sm2 = Some(at);
    }

    /// Outputs are copied and calculated.
    pub fn ready(&mut self, at: Time<Device>) {
        self.ready = Some(at);
    }

    /// SYNC0 acts.
    pub fn sync0(&mut self, at: Time<Device>) {
        if let Some(sm2) = self.sm2.take() {
            self.distance.push((at - sm2).0 * 1000);
        }
        match self.ready.take() {
            Some(ready) => self.margin.push((at - ready).0 * 1000),
            None => self.unready += 1,
        }
    }

    /// From SM2 to SYNC0.
    pub fn distance(&self) -> &Statistics {
        &self.distance
    }
    /// From the end of calc and copy to SYNC0: the slack that was left, never negative.
    pub fn margin(&self) -> &Statistics {
        &self.margin
    }
    /// SYNC0 edges that found no outputs ready.
    pub fn unready(&self) -> u64 {
        self.unready
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sync0_without_ready_outputs_is_counted_not_measured() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        judge.ready(Time::new(160));
        judge.sync0(Time::new(160));
        judge.sm2(Time::new(1100));
        judge.sync0(Time::new(1160));
        assert_eq!((judge.margin().count(), judge.margin().least()), (1, 0));
        assert_eq!((judge.distance().count(), judge.distance().least()), (2, 60_000));
        assert_eq!(judge.unready(), 1);
    }
}
