//! Checks that outputs are ready before SYNC0 acts on them.

use isocat_wire::time::{Device, Nanos, Time};

use super::Mark;
use crate::statistics::Statistics;

/// Watches one SubDevice: the time from the SM2 event to the next SYNC0, and from the end of
/// copying to the pulse at which the outputs act, SYNC0 or SYNC1. All times are counted by the
/// SubDevice's own oscillator, like its times in 0x1C32.
#[derive(Clone, Debug, Default)]
// In this order: all that a regular cycle touches lies together.
#[repr(C)]
pub struct SyncMargin {
    sm2: Mark<Device>,
    /// An SM2 event that no SYNC0 has followed yet.
    stored: Mark<Device>,
    ready: Mark<Device>,
    /// Whether copying is in progress.
    copying: bool,
    /// An acting pulse that came after outputs were stored and before they were ready.
    overtaken: Mark<Device>,
    distance: Statistics,
    margin: Statistics,
    unready: u64,
}

impl SyncMargin {
    /// Takes the instant at which outputs were stored.
    pub fn sm2(&mut self, at: Time<Device>) {
        self.sm2.set(at);
        self.stored.set(at);
        // Outputs that were not copied were missed, so the next ready outputs are not late for that
        // pulse.
        if !self.copying {
            self.overtaken.clear();
        }
    }

    /// Takes the start of copying.
    pub fn begins(&mut self) {
        self.copying = true;
    }

    /// Takes the end of copying and calculation; returns the margin if the acting pulse came first.
    pub fn ready(&mut self, at: Time<Device>) -> Option<Nanos> {
        self.copying = false;
        let Some(pulse) = self.overtaken.take() else {
            self.ready.set(at);
            return None;
        };
        Some(self.left(pulse - at))
    }

    /// Whether copying is in progress.
    #[inline]
    pub(crate) fn is_copying(&self) -> bool {
        self.copying
    }

    /// Takes a whole cycle, while no copying is in progress: outputs are stored, copied, and act at
    /// a SYNC0. It does what these calls do one after the other.
    #[inline]
    pub(crate) fn cycle(&mut self, stored: Time<Device>, ready: Time<Device>, at: Time<Device>) {
        let none = Mark::default();
        (self.sm2, self.stored, self.ready, self.overtaken) = (none, none, none, none);
        self.distance.push((at - stored).0 * 1000);
        self.left(at - ready);
    }

    /// Takes a SYNC0. If it is the acting pulse, [`acts`](Self::acts) follows.
    pub fn sync0(&mut self, at: Time<Device>) {
        if let Some(sm2) = self.stored.take() {
            self.distance.push((at - sm2).0 * 1000);
        }
    }

    /// Takes the pulse at which outputs act; returns the margin if the outputs are ready.
    pub fn acts(&mut self, at: Time<Device>) -> Option<Nanos> {
        let sm2 = self.sm2.take();
        let Some(ready) = self.ready.take() else {
            self.unready += 1;
            self.overtaken = sm2.map(|_| at).into();
            return None;
        };
        Some(self.left(at - ready))
    }

    fn left(&mut self, margin: Nanos) -> Nanos {
        self.margin.push(margin.0 * 1000);
        margin
    }

    /// Time from SM2 to the next SYNC0.
    pub fn distance(&self) -> &Statistics {
        &self.distance
    }
    /// Time from the end of calc and copy to the acting pulse; negative if the pulse came first. A
    /// pulse without any SM2 event is only counted in [`SyncMargin::unready`].
    pub fn margin(&self) -> &Statistics {
        &self.margin
    }
    /// Number of acting pulses without ready outputs.
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

    /// SYNC0 fetches and SYNC1 acts: the distance ends at SYNC0, the margin at SYNC1.
    #[test]
    fn the_distance_to_sync0_is_not_the_one_to_sync1() {
        let mut judge = SyncMargin::default();
        judge.sm2(Time::new(100));
        judge.sync0(Time::new(300));
        judge.ready(Time::new(350));
        judge.acts(Time::new(400));
        // With subordinated cycles several SYNC0 follow an SM2 event, and the first counts.
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

    /// Outputs that are never copied do not affect the margins of later ones; copying that takes
    /// longer than to the next SM2 event does.
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

    #[test]
    fn a_whole_cycle_is_the_same_as_its_parts() {
        for before in [0, 1, 2, 3, 4] {
            let mut judge = SyncMargin::default();
            let parts = |judge: &mut SyncMargin, count: usize, at: u64| {
                let all: [fn(&mut SyncMargin, u64); 4] = [
                    |judge, at| judge.sm2(Time::new(at)),
                    |judge, _| judge.begins(),
                    |judge, at| assert_eq!(judge.ready(Time::new(at + 20)), None),
                    |judge, at| pulse(judge, at + 50),
                ];
                all[..count].iter().for_each(|part| part(judge, at));
            };
            parts(&mut judge, before, 100);
            if judge.is_copying() {
                continue;
            }
            let mut whole = judge.clone();
            parts(&mut judge, 4, 1_000);
            whole.cycle(Time::new(1_000), Time::new(1_020), Time::new(1_050));
            assert_eq!(format!("{judge:?}"), format!("{whole:?}"), "{before}");
        }
    }
}
