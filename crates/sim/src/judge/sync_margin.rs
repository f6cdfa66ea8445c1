//! Outputs are ready before SYNC0 acts on them.

use isocat_wire::time::{Device, Nanos, Time};

use crate::statistics::Statistics;

/// Watches one SubDevice: from the SM2 event to the next SYNC0, and from the end of copying to the
/// pulse at which the outputs act, SYNC0 or SYNC1. All spans are counted by the SubDevice's own
/// oscillator, as its times in 0x1C32 are.
#[derive(Clone, Debug, Default)]
pub struct SyncMargin {
    sm2: Option<Time<Device>>,
    /// An SM2 event that no SYNC0 has followed yet.
    stored: Option<Time<Device>>,
    ready: Option<Time<Device>>,
    /// Copying is under way.
    copying: bool,
    /// An acting pulse that came after outputs were stored and before they were ready.
    overtaken: Option<Time<Device>>,
    distance: Statistics,
    margin: Statistics,
    unready: u64,
}

impl SyncMargin {
    /// Outputs were stored.
    pub fn sm2(&mut self, at: Time<Device>) {
        self.sm2 = Some(at);
        self.stored = Some(at);
        // Outputs that nobody began to copy were missed: what is ready next is not late for that pulse.
        if !self.copying {
            self.overtaken = None;
        }
    }

    /// Copying of outputs began.
    pub fn begins(&mut self) {
        self.copying = true;
    }

    /// Outputs are copied and calculated; gives the margin if the acting pulse came first.
    pub fn ready(&mut self, at: Time<Device>) -> Option<Nanos> {
        self.copying = false;
        let Some(pulse) = self.overtaken.take() else {
            self.ready = Some(at);
            return None;
        };
        Some(self.left(pulse - at))
    }

    /// SYNC0 came. Where it is the acting pulse, [`acts`](Self::acts) follows.
    pub fn sync0(&mut self, at: Time<Device>) {
        if let Some(sm2) = self.stored.take() {
            self.distance.push((at - sm2).0 * 1000);
        }
    }

    /// The pulse came at which outputs act; gives the margin if the outputs are ready.
    pub fn acts(&mut self, at: Time<Device>) -> Option<Nanos> {
        let sm2 = self.sm2.take();
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

    /// From SM2 to the next SYNC0.
    pub fn distance(&self) -> &Statistics {
        &self.distance
    }
    /// From the end of calc and copy to the acting pulse: the slack that was left; negative where
    /// the pulse came first. A pulse without any SM2 event is in [`SyncMargin::unready`] only.
    pub fn margin(&self) -> &Statistics {
        &self.margin
    }
    /// Acting pulses that found no outputs ready.
    pub fn unready(&self) -> u64 {
        self.unready
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A SYNC0 at which outputs act.
    fn pulse(judge: &mut SyncMargin, at: u64) {
        judge.sync0(Time::new(at));
        judge.acts(Time::new(at));
    }

    /// SYNC0 fetches, SYNC1 acts: the distance ends at the first, the margin at the second.
    #[test]
    fn the_distance_to_sync0_is_not_the_one_to_sync1() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        judge.sync0(Time::new(300));
        judge.ready(Time::new(350));
        judge.acts(Time::new(400));
        // With subordinated cycles several SYNC0 follow an SM2 event: the first counts.
        judge.sync0(Time::new(500));
        assert_eq!((judge.distance().count(), judge.distance().least()), (1, 200_000));
        assert_eq!((judge.margin().count(), judge.margin().least()), (1, 50_000));
    }

    #[test]
    fn a_sync0_that_overtakes_the_copying_has_a_negative_margin() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        pulse(&mut judge, 160);
        judge.ready(Time::new(161));
        assert_eq!((judge.margin().count(), judge.margin().least()), (1, -1_000));
        pulse(&mut judge, 1160);
        assert_eq!((judge.margin().count(), judge.unready()), (1, 2));
    }

    /// Outputs that are never copied leave the margins of those after them alone; copying that takes longer than to the next
    /// SM2 event does not.
    #[test]
    fn a_missed_copy_is_not_a_late_one() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        pulse(&mut judge, 160);
        judge.sm2(Time::new(1_100));
        judge.begins();
        assert_eq!(judge.ready(Time::new(1_150)), None);
        pulse(&mut judge, 1_160);
        assert_eq!((judge.margin().count(), judge.margin().least()), (1, 10_000));

        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        judge.begins();
        pulse(&mut judge, 160);
        judge.sm2(Time::new(1_100));
        assert_eq!(judge.ready(Time::new(1_150)), Some(Nanos(-990)));
    }

    #[test]
    fn a_sync0_without_ready_outputs_is_counted() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        judge.ready(Time::new(160));
        pulse(&mut judge, 160);
        judge.sm2(Time::new(1100));
        pulse(&mut judge, 1160);
        assert_eq!((judge.margin().count(), judge.margin().least()), (1, 0));
        assert_eq!((judge.distance().count(), judge.distance().least()), (2, 60_000));
        assert_eq!(judge.unready(), 1);
    }
}
