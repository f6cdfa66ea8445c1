//! Outputs are ready before SYNC0 acts on them.

use isocat_wire::time::{Device, Nanos, Time};

use crate::statistics::Statistics;

/// Watches one SubDevice: from the SM2 event, and from the end of copying, to SYNC0. All spans are
/// counted by the SubDevice's own oscillator, as its times in 0x1C32 are.
#[derive(Clone, Debug, Default)]
pub struct SyncMargin {
    sm2: Option<Time<Device>>,
    ready: Option<Time<Device>>,
    /// A SYNC0 that found copying under way.
    overtaken: Option<Time<Device>>,
    distance: Statistics,
    margin: Statistics,
    unready: u64,
}

impl SyncMargin {
    /// Outputs were stored.
    pub fn sm2(&mut self, at: Time<Device>) {
        self.sm2 = Some(at);
    }

    /// Outputs are copied and calculated; gives the margin if SYNC0 came first.
    pub fn ready(&mut self, at: Time<Device>) -> Option<Nanos> {
        let Some(sync0) = self.overtaken.take() else {
            self.ready = Some(at);
            return None;
        };
        Some(self.left(sync0 - at))
    }

    /// SYNC0 acts; gives the margin if the outputs are ready.
    pub fn sync0(&mut self, at: Time<Device>) -> Option<Nanos> {
        let sm2 = self.sm2.take();
        if let Some(sm2) = sm2 {
            self.distance.push((at - sm2).0 * 1000);
        }
        let Some(ready) = self.ready.take() else {
            self.unready += 1;
            self.overtaken = sm2.map(|_| at);
            return None;
        };
        Some(self.left(at - ready))
    }

    fn left(&mut self, margin: Nanos) -> Nanos {
        self.margin.push(margin.0 * 1000);
        margin
    }

    /// From SM2 to SYNC0.
    pub fn distance(&self) -> &Statistics {
        &self.distance
    }
    /// From the end of calc and copy to SYNC0: the slack that was left; negative where SYNC0 came first.
    /// A SYNC0 without any SM2 event is in [`SyncMargin::unready`] only.
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
    fn a_sync0_that_overtakes_the_copying_has_a_negative_margin() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        judge.sync0(Time::new(160));
        judge.ready(Time::new(161));
        assert_eq!((judge.margin().count(), judge.margin().least()), (1, -1_000));
        judge.sync0(Time::new(1160));
        assert_eq!((judge.margin().count(), judge.unready()), (1, 2));
    }

    #[test]
    fn a_sync0_without_ready_outputs_is_counted() {
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
