//! Where cyclic frames lie against SYNC0, in the time of the reference clock.
//!
//! A drift datagram (FRMW, ARMW) returns the reference's system time at the instant at which its
//! frame reached the reference. SYNC0 comes at the start time and once per cycle after it, in the
//! same time. So the distance from a frame to the next SYNC0 is known to the clock's 10 ns, however
//! inaccurate the stamps of the capture are. A frame without a drift datagram has the time of the
//! last one before it, and by the stamps of the capture what passed since then.
//!
//! A device is measured by the frames with its own process data: others come at another rhythm.

mod distance;

use isocat_rules::evidence::Slide;
use isocat_rules::trail::Trail;
use isocat_wire::frame;
use isocat_wire::time::Picos;

pub(crate) use self::distance::Distance;
use self::distance::{Rate, Sample};
pub(crate) use crate::measured::Grid;

impl Grid {
    /// The grid of a SYNC unit that starts at `start`.
    pub(crate) fn new(cycle: u32, start: u64) -> Option<Self> {
        let cycle = u64::from(cycle);
        Some(Self { cycle, phase: start.checked_rem(cycle)? })
    }

    /// From `at` to the next SYNC0, ns: 0 to `cycle` - 1.
    pub(crate) fn ahead(self, at: u64) -> u64 {
        let since = (at % self.cycle + self.cycle - self.phase) % self.cycle;
        (self.cycle - since) % self.cycle
    }
}

/// What is measured: certain frames against the SYNC0 of some devices.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Feed {
    pub grid: Grid,
    /// Places of the logical datagrams with the process data of these devices. `None`: the capture
    /// does not show which these are, so each frame that begins a cycle counts.
    pub carriers: Option<Vec<usize>>,
}

impl Feed {
    /// Whether it has all frames of `before`, and further ones.
    pub fn continues(&self, before: &Self) -> bool {
        let all = |now: &[usize], before: &[usize]| before.iter().all(|one| now.contains(one));
        let more = match (&self.carriers, &before.carriers) {
            (Some(now), Some(before)) => all(now, before),
            _ => false,
        };
        self.grid == before.grid && more
    }
}

/// A frame with process data.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cyclic<'a> {
    pub number: usize,
    /// By the stamps, ns from the first frame.
    pub at_ns: u64,
    /// Its length without the check sequence, bytes.
    pub len: usize,
    /// The reference's system time when its first bit came there, ns.
    pub time: u64,
    /// The stamps of the capture have a share in that time.
    pub by_stamps: bool,
    /// It begins a cycle.
    pub begins: bool,
    /// The places of its logical datagrams that came back.
    pub logical: &'a [usize],
}

impl Cyclic<'_> {
    fn is_of(&self, feed: &Feed) -> bool {
        match &feed.carriers {
            Some(carriers) => self.logical.iter().any(|place| carriers.contains(place)),
            None => self.begins,
        }
    }
}

/// The frames of one feed since operation began.
#[derive(Clone, Debug)]
struct Phase {
    feed: Feed,
    /// The first frames, before their rate is known.
    early: Vec<Sample>,
    distance: Option<Distance>,
    /// System time of the last one, ns.
    last: u64,
    /// Intervals without pauses since the rate is known, and their sum, ns.
    intervals: u64,
    sum: u64,
    by_stamps: bool,
}

impl Phase {
    fn new(feed: Feed) -> Self {
        Self {
            feed,
            early: Vec::with_capacity(EARLY),
            distance: None,
            last: 0,
            intervals: 0,
            sum: 0,
            by_stamps: false,
        }
    }

    /// Takes the next frame. Calls `told` with each distance that is known from now on.
    fn push(&mut self, sample: Sample, mut told: impl FnMut(Sample, i64)) {
        let interval = sample.end.wrapping_sub(self.last);
        self.last = sample.end;
        if let Some(distance) = &mut self.distance {
            if interval <= distance.interval().saturating_mul(PAUSE) {
                self.intervals += 1;
                self.sum = self.sum.saturating_add(interval);
            }
            return distance.push(sample, told);
        }
        self.early.push(sample);
        if self.early.len() < EARLY {
            return;
        }
        self.distance = self.rate().and_then(|rate| Distance::new(self.feed.grid, rate));
        match &mut self.distance {
            Some(distance) => {
                self.intervals = EARLY as u64 - 1;
                self.sum = self.intervals.saturating_mul(distance.interval());
                self.early.drain(..).for_each(|sample| distance.push(sample, &mut told));
            }
            // Frames may come evenly from some later one on.
            None => drop(self.early.drain(..EARLY / 2)),
        }
    }

    /// The rate of the first frames; `None`: they come neither once in some cycles of SYNC0 nor
    /// several times in each.
    fn rate(&self) -> Option<Rate> {
        let mut intervals: Vec<u64> =
            self.early.windows(2).map(|pair| pair[1].end.wrapping_sub(pair[0].end)).collect();
        intervals.sort_unstable();
        let cycle = self.feed.grid.cycle;
        // Where some are missing the one tells it, and where they are uneven the other.
        let median = intervals[intervals.len() / 2];
        let sum = intervals.iter().fold(0_u64, |sum, interval| sum.saturating_add(*interval));
        let mean = sum / intervals.len() as u64;
        let all = [median, mean].map(|interval| (Rate::of(cycle, interval), interval));
        let fit = all.into_iter().find(|(rate, interval)| rate.fits(cycle, *interval));
        fit.map(|(rate, _)| rate)
    }

    /// The distances, if frames came all the time as often as at first.
    fn distance(&self) -> Option<&Distance> {
        let distance = self.distance.as_ref().filter(|distance| distance.count > 0)?;
        let mean = self.sum.checked_div(self.intervals).unwrap_or(distance.interval());
        let (cycle, rate) = (self.feed.grid.cycle, distance.rate());
        // Some may be lost.
        (Rate::of(cycle, mean) == rate || rate.fits(cycle, mean)).then_some(distance)
    }

    /// Whether none came for some time before `latest`, at which any came last.
    fn has_ended(&self, latest: u64) -> bool {
        let interval = self.distance.as_ref().map_or(0, Distance::interval);
        latest.saturating_sub(self.last) > interval.saturating_mul(STOPPED)
    }
}

/// The distances of one feed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured<'a> {
    pub distance: &'a Distance,
    /// Stamps have a share in them.
    pub by_stamps: bool,
    /// Other frames went on when these had ended.
    pub ended: bool,
}

/// The distances of all feeds since operation began.
#[derive(Clone, Debug, Default)]
pub(crate) struct Phases {
    all: Vec<Phase>,
    /// The course of the distances to the grid with the shortest cycle.
    trail: Trail,
    /// The place of that feed.
    trailed: Option<usize>,
    /// The reference's system time at the end of the first frame and of the last one, ns.
    began: Option<u64>,
    latest: u64,
}

impl Phases {
    /// Takes a frame with process data. Calls `told` with instants by the stamps and distances to
    /// grids, of this frame or earlier ones.
    pub fn cyclic(
        &mut self,
        feeds: &[Feed],
        frame: Cyclic<'_>,
        mut told: impl FnMut(u64, Grid, i64),
    ) {
        let duration = frame::duration_ns(frame.len);
        let sample = Sample {
            number: frame.number,
            at_ns: frame.at_ns,
            end: frame.time.wrapping_add(duration),
            duration: duration as i64,
        };
        self.latest = sample.end;
        let began = *self.began.get_or_insert(sample.end);
        for feed in feeds.iter().filter(|feed| frame.is_of(feed)) {
            let known = self.place(feed);
            if known.is_none() && self.all.len() >= MOST_GRIDS {
                continue;
            }
            let place = known.unwrap_or_else(|| {
                self.all.push(Phase::new(feed.clone()));
                self.all.len() - 1
            });
            let shorter = |trailed: usize| feed.grid.cycle < self.all[trailed].feed.grid.cycle;
            if known.is_none() && self.trailed.is_none_or(shorter) {
                self.trailed = Some(place);
                self.trail = Trail::default();
            }
            // Where two feeds have one grid, the first one is told.
            let first = feeds.iter().find(|other| other.grid == feed.grid);
            let is_told = first == Some(feed);
            let phase = &mut self.all[place];
            phase.by_stamps |= frame.by_stamps;
            phase.push(sample, |sample, ns| {
                if self.trailed == Some(place) {
                    let since = sample.end.wrapping_sub(began);
                    // A frame that comes later is nearer to SYNC0.
                    self.trail.take(since.saturating_mul(1_000), Picos(ns.saturating_mul(-1_000)));
                }
                if is_told {
                    told(sample.at_ns, feed.grid, ns);
                }
            });
        }
    }

    /// The frames of `old` go on as those of `new`: further datagrams have the same process data.
    pub fn rename(&mut self, old: &Feed, new: &Feed) {
        if let Some(place) = self.place(old).filter(|_| self.place(new).is_none()) {
            self.all[place].feed = new.clone();
        }
    }

    /// Operation ends for some time.
    pub fn pause(&mut self) {
        self.all.iter_mut().filter_map(|phase| phase.distance.as_mut()).for_each(Distance::pause);
    }

    fn place(&self, feed: &Feed) -> Option<usize> {
        self.all.iter().position(|phase| phase.feed == *feed)
    }

    /// How frames move against the reference clock. `None`: not known.
    pub fn slide(&self) -> Option<Slide> {
        self.all[self.trailed?].distance()?;
        self.trail.slide()
    }

    /// The distances of a feed; `None`: not known.
    pub fn of(&self, feed: &Feed) -> Option<Measured<'_>> {
        let phase = &self.all[self.place(feed)?];
        Some(Measured {
            distance: phase.distance()?,
            by_stamps: phase.by_stamps,
            ended: phase.has_ended(self.latest),
        })
    }

    /// All that are known.
    pub fn all(&self) -> impl Iterator<Item = &Distance> {
        self.all.iter().filter_map(Phase::distance)
    }
}

/// An interval longer than this many usual ones is a pause, and is left out of the mean.
const PAUSE: u64 = 4;
/// Frames whose interval passed so often without one have ended.
const STOPPED: u64 = 8;
/// Feeds that are kept apart.
pub(crate) const MOST_GRIDS: usize = 64;
/// Frames after which it is known how often they come in a cycle of SYNC0.
const EARLY: usize = 17;

#[cfg(test)]
mod tests {
    use super::*;

    /// The distances of frames of 60 bytes that come to the reference at these instants.
    fn measured(grid: Grid, times: impl Iterator<Item = u64>) -> Option<Distance> {
        let feeds = [Feed { grid, carriers: None }];
        let mut phases = Phases::default();
        for (number, time) in times.enumerate() {
            let (by_stamps, begins) = (false, true);
            let frame =
                Cyclic { number, at_ns: time, len: 60, time, by_stamps, begins, logical: &[] };
            phases.cyclic(&feeds, frame, |_, _, _| {});
        }
        phases.of(&feeds[0]).map(|found| found.distance.clone())
    }

    #[test]
    fn the_next_pulse() {
        let grid = Grid::new(1000, 12_300).expect("a cycle");
        for (at, ahead) in [(300, 0), (299, 1), (301, 999), (1_300, 0), (12_800, 500)] {
            assert_eq!(grid.ahead(at), ahead, "{at}");
        }
        assert_eq!(Grid::new(0, 7), None);
    }

    #[test]
    fn frames_that_wander_past_sync0_go_on() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        // Each cycle 1 us later, from 500 us before SYNC0 on.
        let times = (0..2000_u64).map(|cycle| cycle * 1_001_000 + 500_000);
        let distance = measured(grid, times).expect("measured");
        let duration = frame::duration_ns(60) as i64;
        assert_eq!(distance.first.value, 500_000 - duration);
        assert_eq!(distance.last.value, 500_000 - duration - 1_999_000);
        assert_eq!(distance.first_outside.map(|k| k.frame), Some(495));
        assert_eq!((distance.count, distance.outside), (2000, 1505));
    }

    /// Frames that lie 600 us later from the middle of the time on have jumped once, and do not
    /// slide; those that become later with each cycle do. Both with lateness of up to 100 us.
    #[test]
    fn a_jump_is_no_slide() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let measured = |frames: u64, late: fn(u64, u64) -> u64| {
            let jitter = |cycle| cycle * 7_919 % 100 * 1_000;
            let at = |cycle| cycle * 1_000_000 + 50_000 + jitter(cycle) + late(cycle, frames);
            measured(grid, (0..frames).map(at)).expect("measured")
        };
        for frames in [100, 1_000, 1_023, 1_024, 1_025, 30_000] {
            let jumped = |cycle, frames| if cycle < frames / 2 { 0 } else { 600_000 };
            assert!(!measured(frames, jumped).slides(), "{frames} with a jump");
            let slid = |cycle, frames| cycle * 700_000 / frames;
            assert!(measured(frames, slid).slides(), "{frames} that slide");
        }
    }

    /// Where frames are late by up to 0.4 of a cycle, at times eight in a row by all of it, those
    /// that are punctual again are not taken for later ones still.
    #[test]
    fn late_frames_do_not_move_where_frames_belong() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let late = |cycle| if cycle % 100 < 8 { 400_000 } else { cycle * 104_729 % 400_000 };
        let times = (0..4000_u64).map(|cycle| cycle * 1_000_000 + 480_000 + late(cycle));
        let distance = measured(grid, times).expect("measured");
        assert_eq!(distance.outside, 0, "{:?}", distance.shortest);
    }

    /// Some hundred or thousand frames that are all late by 0.4 of a cycle, between punctual ones.
    #[test]
    fn frames_come_back_to_where_they_were() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let punctual = 1_000_000 - 480_000 - frame::duration_ns(60) as i64;
        for late in [500..700, 100..1_100, 100..5_000] {
            let by = |cycle| if late.contains(&cycle) { 400_000 } else { 0 };
            let times = (0..late.end + 300).map(|cycle| cycle * 1_000_000 + 480_000 + by(cycle));
            let distance = measured(grid, times).expect("measured");
            assert_eq!((distance.outside, distance.slides()), (0, false), "{late:?}: {distance:?}");
            assert_eq!(distance.longest.value, punctual);
            // A course has sixteen parts at most, so a short stretch may be part of a later one.
            assert!(distance.punctual() > punctual - 200_000, "{late:?}");
        }
    }

    #[test]
    fn a_late_frame_alone_is_not_one_of_the_next_cycle() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let late = |cycle| if cycle == 50 { 300_000 } else { 0 };
        let times = (0..100_u64).map(|cycle| cycle * 1_000_000 + 800_000 + late(cycle));
        let distance = measured(grid, times).expect("measured");
        assert_eq!((distance.outside, distance.shortest.frame), (1, 50));
        assert_eq!(distance.shortest.value, -100_000 - frame::duration_ns(60) as i64);
    }

    /// Frames come several times in a cycle of SYNC0, and the last one before it counts.
    #[test]
    fn the_last_frame_before_sync0_counts() {
        for (ratio, late, outside) in
            [(2, 0, 0), (4, 0, 0), (3, 0, 0), (2, 300_000, 1), (4, 300_000, 1)]
        {
            let grid = Grid::new(ratio * 1_000_000, 400_000).expect("a cycle");
            let ratio = u64::from(ratio);
            for whom in 0..ratio {
                // One frame of the hundredth cycle of SYNC0 is late.
                let late = |frame| if frame == 100 * ratio + whom { late } else { 0 };
                let at = |frame| frame * 1_000_000 + 200_000 + late(frame);
                let distance = measured(grid, (0..200 * ratio).map(at)).expect("measured");
                // SYNC0 comes 400 us after the beginning of a whole one.
                let outside = if whom == 0 { outside } else { 0 };
                assert_eq!((distance.count, distance.outside), (200, outside), "{ratio} {whom}");
                let punctual = 200_000 - frame::duration_ns(60) as i64;
                assert_eq!(distance.longest.value, punctual, "{ratio} {whom}");
            }
        }
    }

    /// Frames that come neither once in cycles of SYNC0 nor several times in each, and those that
    /// came at another rhythm at first.
    #[test]
    fn frames_of_another_rhythm_are_not_measured() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        assert!(measured(grid, (0..100).map(|frame| frame * 300_000)).is_none());
        assert!(measured(grid, (0..100).map(|frame| frame * 3_000_000)).is_some());
        let turned = |frame: u64| frame * 500_000 + frame.saturating_sub(20) * 500_000;
        assert!(measured(grid, (0..30).map(turned)).is_some());
        assert!(measured(grid, (0..300).map(turned)).is_none());
        // A pause between two stretches, as long as both.
        let paused = |frame: u64| frame * 1_000_000 + if frame < 50 { 0 } else { 100_000_000 };
        let distance = measured(grid, (0..100).map(paused)).expect("measured");
        assert_eq!((distance.count, distance.outside), (100, 0));
        assert!(measured(grid, (0..16).map(|frame| frame * 1_000_000)).is_none(), "too few");
        assert!(measured(grid, (0..17).map(|frame| frame * 1_000_000)).is_some());
    }

    /// Two devices at one SYNC0, each with frames of its own.
    #[test]
    fn each_frame_is_measured_for_its_devices() {
        let grid = Grid::new(2_000_000, 0).expect("a cycle");
        let feed = |place| Feed { grid, carriers: Some(vec![place]) };
        let feeds = [feed(3), feed(5)];
        let mut phases = Phases::default();
        // The second one ends before the first one.
        for number in (0..200).chain((200..214).step_by(2)) {
            let place = [3, 5][number % 2];
            let time = number as u64 * 1_000_000 + 700_000;
            let by_stamps = place == 5;
            let logical = &[0, place];
            let frame =
                Cyclic { number, at_ns: time, len: 60, time, by_stamps, begins: false, logical };
            phases.cyclic(&feeds, frame, |_, _, _| {});
        }
        let duration = frame::duration_ns(60) as i64;
        let found = feeds.each_ref().map(|feed| phases.of(feed).expect("measured"));
        assert_eq!(found.map(|found| found.distance.count), [107, 100]);
        let values = found.map(|found| found.distance.longest.value + duration);
        assert_eq!(values, [1_300_000, 300_000]);
        assert_eq!(found.map(|found| found.by_stamps), [false, true]);
        // For eight cycles of it there was none.
        let time = 216 * 1_000_000 + 700_000;
        let frame = Cyclic {
            number: 214,
            at_ns: 0,
            len: 60,
            time,
            by_stamps: false,
            begins: false,
            logical: &[3],
        };
        phases.cyclic(&feeds, frame, |_, _, _| {});
        assert_eq!(feeds.each_ref().map(|feed| phases.of(feed).unwrap().ended), [false, true]);
        // Another datagram with the same data goes on where the first one was.
        let more = Feed { grid, carriers: Some(vec![3, 8]) };
        phases.rename(&feeds[0], &more);
        assert!(phases.of(&feeds[0]).is_none());
        assert_eq!(phases.of(&more).map(|found| found.distance.count), Some(107));
    }

    /// How late each of some frames is, in tenths of a cycle; they are sent half a cycle before
    /// SYNC0.
    #[test]
    fn a_frame_that_passes_sync0_leaves_a_gap_behind() {
        let grid = Grid::new(1_000_000, 0).expect("a cycle");
        let outside = |late: &[u64], skipped: u64| {
            // The first one fifty cycles on; behind the last one `skipped` cycles have no frame.
            let at = |frame: u64| {
                let index = usize::try_from(frame - 50).ok();
                let by = index.and_then(|index| late.get(index)).copied().unwrap_or(0);
                let more = if frame >= 50 + late.len() as u64 { skipped } else { 0 };
                (frame + more) * 1_000_000 + 500_000 + by * 100_000
            };
            let times = (0..50).map(|frame| frame * 1_000_000 + 500_000);
            let times = times.chain((50..200).map(at));
            let distance = measured(grid, times).expect("measured");
            (distance.outside, distance.slides())
        };
        let none = (0, false);
        for late in 0..=4 {
            assert_eq!(outside(&[late], 0), none, "{late}");
        }
        for late in 5..=9 {
            assert_eq!(outside(&[late], 0), (1, false), "{late}");
        }
        // Sent together with the next one, or behind it.
        assert_eq!(outside(&[11, 2], 0), (1, false));
        assert_eq!(outside(&[19, 10], 0), (2, false));
        // Frames as uneven as can be that pass nothing.
        assert_eq!(outside(&[4, 0, 4, 0, 3, 4, 0], 0), none);
        // A frame left out is no late one, nor are those behind it.
        for skipped in 1..5 {
            let at = |frame: u64| frame + if frame < 50 { 0 } else { skipped };
            let times = (0..200).map(|frame| at(frame) * 1_000_000 + 500_000);
            let distance = measured(grid, times).expect("measured");
            let gap = (1 + skipped) * 1_000_000;
            assert_eq!((distance.missing, distance.gap.value), (1, gap), "{skipped}");
            assert_eq!(outside(&[], skipped), none, "{skipped}");
            assert_eq!(outside(&[4], skipped), none, "{skipped}");
        }
        // A stall: of three frames one is left out, and the other two come between two pulses.
        assert_eq!(outside(&[22, 13], 1), (1, false));
    }
}
