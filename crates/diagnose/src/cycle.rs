//! The cyclic exchange: which logical datagrams there are, their rhythm, their working counters.

use std::collections::BTreeMap;
use std::time::Duration;

use isocat_wire::Command;

use crate::access::Access;
use crate::known::{Known, Log};

/// A logical datagram that is sent again and again.
#[derive(Clone, Debug)]
pub(crate) struct Logical {
    pub command: Command,
    pub address: u32,
    pub len: u16,
    /// Frames with it, in the whole capture.
    pub frames: u64,
    /// Frames with it since operation began.
    pub recent: u64,
    /// The first of them.
    pub first: usize,
    /// When the last one of all came.
    pub last_at: Duration,
    /// How often each working counter came back while the segment was in operation.
    pub counts: BTreeMap<u16, u64>,
    /// Changes of the working counter while the segment was in operation.
    pub changes: Log<Change>,
    /// Frames that did not come back while the segment was in operation.
    pub lost: Log<Known<Duration>>,
    last: Option<(u16, usize)>,
    /// Events before some instant were forgotten: see [`Cycle::forget`].
    forgot: bool,
}

/// A working counter that differs from the one before.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Change {
    pub frame: usize,
    pub at: Duration,
    /// The last frame with the working counter `from`.
    pub before: usize,
    pub from: u16,
    pub to: u16,
}

impl Logical {
    /// The working counter of the segment in operation. It is the highest one that came back at
    /// least [`LEAST_USUAL`] times, because a device that was lost early may never have come back.
    /// A listener that runs for days takes the most frequent one instead: a device may have been
    /// removed for good.
    pub fn usual(&self) -> Option<u16> {
        let highest = self.counts.iter().rev().find(|(_, times)| **times >= LEAST_USUAL);
        let most_often = || self.counts.iter().max_by_key(|(_, times)| **times);
        let usual = highest.filter(|_| !self.forgot).or_else(most_often);
        usual.map(|(count, _)| *count)
    }
}

/// From one cycle to the next.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rhythm {
    pub count: u64,
    last: Option<Duration>,
    sum: u128,
    shortest: Option<Known<u64>>,
    /// The longest intervals, ns, longest first.
    pub longest: Vec<Gap>,
    /// How often intervals came, by their length rounded to three digits.
    bins: BTreeMap<u64, u64>,
}

/// An interval between two cyclic frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Gap {
    /// The frame at its end.
    pub frame: usize,
    /// When it ended, by the stamps of the capture.
    pub at: Duration,
    pub ns: u64,
}

impl Rhythm {
    /// Notes that a cycle began at `instant` of some clock, which was `at` by the stamps of the
    /// capture. Returns the time since the previous cycle, ns.
    fn cycle(&mut self, instant: Duration, at: Duration, frame: usize) -> Option<u64> {
        let last = self.last.replace(instant)?;
        let ns = u64::try_from(instant.saturating_sub(last).as_nanos()).unwrap_or(u64::MAX);
        self.interval(ns, at, frame);
        Some(ns)
    }

    /// Notes an interval that ended at `at`.
    pub fn interval(&mut self, ns: u64, at: Duration, frame: usize) {
        self.count += 1;
        self.sum += u128::from(ns);
        *self.bins.entry(three_digits(ns)).or_default() += 1;
        if self.shortest.is_none_or(|shortest| ns < shortest.value) {
            self.shortest = Some(Known { value: ns, frame });
        }
        let place = self.longest.partition_point(|gap| gap.ns >= ns);
        if place < MOST_GAPS {
            self.longest.insert(place, Gap { frame, at, ns });
            self.longest.truncate(MOST_GAPS);
        }
    }

    /// Ends the present interval: it does not lie in operation.
    pub fn pause(&mut self) {
        self.last = None;
    }

    /// The length that half of the intervals do not exceed, ns.
    pub fn median(&self) -> Option<u64> {
        self.share(2)
    }

    /// The length that all but one in `one_of` intervals do not exceed, ns, to three digits.
    pub fn share(&self, one_of: u64) -> Option<u64> {
        let wanted = self.count - self.count / one_of;
        let mut sum = 0;
        self.bins.iter().find_map(|(ns, times)| {
            sum += times;
            (sum >= wanted).then_some(*ns)
        })
    }

    /// The mean, ns.
    pub fn mean(&self) -> Option<u64> {
        (self.count > 0).then(|| (self.sum / u128::from(self.count)) as u64)
    }

    /// The number of intervals longer than `ns`, up to the rounding to three digits.
    pub fn longer_than(&self, ns: u64) -> u64 {
        self.bins.range(three_digits(ns) + 1..).map(|(_, times)| times).sum()
    }

    pub fn shortest(&self) -> Option<Known<u64>> {
        self.shortest
    }
}

/// Rounds to three digits, so that the number of bins is bounded.
fn three_digits(ns: u64) -> u64 {
    let digits = ns.checked_ilog10().unwrap_or(0);
    let unit = 10_u64.pow(digits.saturating_sub(2));
    ns.saturating_add(unit / 2) / unit * unit
}

/// The cyclic exchange of a capture.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cycle {
    pub logical: Vec<Logical>,
    /// Accesses to logical datagrams beyond the `MOST_LOGICAL` that are kept apart.
    pub left_out: u64,
    /// The logical datagram that begins a cycle: the first one that was exchanged, unless another
    /// is far more frequent.
    pub marker: Option<usize>,
    /// Since operation began, by the stamps of the capture.
    pub rhythm: Rhythm,
    /// The same in the time of the reference clock.
    pub by_clock: Rhythm,
    /// Some of these times were told by the stamps.
    pub estimated: bool,
    /// From a frame that begins a cycle to its answer, by the stamps of the capture.
    pub round_trip: Rhythm,
    /// The same of those answers that came when the frame of the next cycle had left.
    pub overtaken: Rhythm,
    /// What the wire and the devices take of it at most, ns, computed of the longest frame that
    /// begins a cycle; 0: not known how many devices there are.
    pub on_wire_ns: u64,
    /// The last answer.
    answer: Option<Gap>,
    /// The last frame with a logical datagram that came back.
    pub last_answered: usize,
    /// Since when none came back in operation, and the number of frames since.
    pub silence: Option<(Known<Duration>, u64)>,
    /// The last frame of that silence, and when it left.
    last_silent: usize,
    last_silent_at: Duration,
    /// Stretches of operation in which [`SILENT`] frames or more in a row did not come back, before
    /// some did again.
    pub outages: Vec<Outage>,
    /// All of them, their frames, and the longest one.
    pub outage_times: u64,
    pub outage_frames: u64,
    pub longest_outage: Option<Outage>,
    /// Frames with process data that did not come back in operation.
    pub unanswered: u64,
    /// When the last frame with process data left, and each time that [`PAUSE`] or more passed
    /// until the next one: from when to when.
    pub last_at: Option<Duration>,
    pub pauses: Vec<(Duration, Duration)>,
    /// Indexes of the datagrams that began the last cycle and the one before it.
    indexes: [Option<u8>; 2],
}

/// Frames in a row that did not come back, before others did.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Outage {
    /// The first one.
    pub since: Known<Duration>,
    /// The last one.
    pub last: usize,
    pub frames: u64,
    /// From the first one to the end of the last one's cycle.
    pub lasted: Duration,
}

impl Cycle {
    /// Takes a logical datagram; returns its place, and whether it begins a cycle. `None`: there
    /// are too many to be kept apart.
    pub fn access(
        &mut self,
        access: &Access<'_>,
        at: Duration,
        operating: bool,
    ) -> Option<(usize, bool)> {
        if let Some(last) =
            self.last_at.replace(at).filter(|last| at.saturating_sub(*last) >= PAUSE)
        {
            // The last ones are those before an error.
            if self.pauses.len() == MOST_STRETCHES {
                self.pauses.remove(0);
            }
            self.pauses.push((last, at));
        }
        let place = self.place(access)?;
        let logical = &mut self.logical[place];
        logical.frames += 1;
        logical.recent += 1;
        logical.last_at = at;
        let recent = logical.recent;
        let marker = *self.marker.get_or_insert(place);
        // A rare datagram, such as the data of a slow group, which may come each other time, or of
        // the way up, does not begin a cycle.
        if recent > self.logical[marker].recent / 2 * 3 + 16 {
            self.marker = Some(place);
            self.rhythm = Rhythm::default();
            self.by_clock = Rhythm::default();
            self.estimated = false;
            self.round_trip = Rhythm::default();
            self.overtaken = Rhythm::default();
            self.on_wire_ns = 0;
        }
        let begins = self.marker == Some(place);
        if access.wkc().is_some() {
            self.last_answered = access.frame;
        } else if operating && self.last_silent != access.frame {
            (self.last_silent, self.last_silent_at) = (access.frame, at);
            self.unanswered += 1;
            let since = Known { value: at, frame: access.frame };
            self.silence.get_or_insert((since, 0)).1 += 1;
        }
        if operating {
            let logical = &mut self.logical[place];
            match access.wkc() {
                Some(wkc) => logical.count(wkc, at, access.frame),
                None => logical.lost.push(Known { value: at, frame: access.frame }),
            }
        }
        Some((place, begins))
    }

    /// A frame came back, whatever it had.
    pub fn end_silence(&mut self) {
        let ended = self.silence.take().filter(|(_, frames)| *frames >= SILENT);
        let Some((since, frames)) = ended else { return };
        // The last of these frames has its cycle, too.
        let between = self.last_silent_at.saturating_sub(since.value).as_nanos();
        let lasted = between + between / u128::from(frames - 1);
        let lasted = Duration::from_nanos(u64::try_from(lasted).unwrap_or(u64::MAX));
        let outage = Outage { since, last: self.last_silent, frames, lasted };
        self.outage_times += 1;
        self.outage_frames += frames;
        if self.longest_outage.is_none_or(|longest| longest.lasted < lasted) {
            self.longest_outage = Some(outage);
        }
        if self.outages.len() < MOST_STRETCHES {
            self.outages.push(outage);
        }
    }

    fn forget_outages(&mut self) {
        self.outages.clear();
        (self.outage_times, self.outage_frames, self.longest_outage) = (0, 0, None);
        self.unanswered = 0;
        self.on_wire_ns = 0;
    }

    /// Notes the beginning of a cycle by the frame that was just taken apart. `time`: the
    /// reference's system time when the frame arrived there, ns; `is_back`: it came back. Returns
    /// the time since the previous cycle, ns: by the stamps and by the reference's clock.
    pub fn begins(
        &mut self,
        at: Duration,
        time: Option<u64>,
        frame: usize,
        is_back: bool,
    ) -> [Option<u64>; 2] {
        let by_stamps = self.rhythm.cycle(at, at, frame);
        let by_clock = match time {
            Some(time) => self.by_clock.cycle(Duration::from_nanos(time), at, frame),
            // It came back, and only the last reading is too long ago: the next one tells.
            None if self.estimated && is_back => None,
            // Without a time, the next frame has no interval by the clock either.
            None => {
                self.by_clock.pause();
                None
            }
        };
        [by_stamps, by_clock]
    }

    /// Notes that stamps are too inaccurate to tell the reference's time.
    pub fn distrust_stamps(&mut self) {
        if std::mem::take(&mut self.estimated) {
            self.by_clock = Rhythm::default();
        }
    }

    /// Notes that the frame `request` that began a cycle came back `ns` later, at `at` in the frame
    /// `answer`.
    pub fn answered(&mut self, request: usize, answer: usize, at: Duration, ns: u64) {
        self.round_trip.interval(ns, at, answer);
        // Stamps may jump between two frames, but not a frame between them.
        if let Some(last) = self.answer.filter(|last| last.frame > request) {
            self.overtaken.interval(last.ns, last.at, last.frame);
        }
        self.answer = Some(Gap { frame: answer, at, ns });
    }

    /// Whether the frame that began the last cycle came a second time: it has the same index within
    /// a quarter of a cycle, though the MainDevice gives each cycle another index. `time`: as in
    /// [`begins`](Self::begins). Must be called for each frame that begins a cycle.
    pub fn is_same_again(&mut self, at: Duration, time: Option<u64>, index: u8) -> bool {
        let [last, before] = self.indexes;
        let by_clock = time.zip(self.by_clock.last).map(|(time, last)| {
            let cycle = self.by_clock.median();
            (Duration::from_nanos(time).saturating_sub(last), cycle)
        });
        let by_stamps =
            self.rhythm.last.map(|last| (at.saturating_sub(last), self.rhythm.median()));
        let same = last == Some(index) && before.is_some_and(|before| before != index);
        if same
            && let Some((distance, Some(cycle))) = by_clock.or(by_stamps)
            && distance.as_nanos() < u128::from(cycle / 4)
        {
            return true;
        }
        self.indexes = [Some(index), last];
        false
    }

    /// Operation begins: forgets the cycles and events before it.
    pub fn restart(&mut self) {
        self.silence = None;
        self.forget_outages();
        self.rhythm = Rhythm::default();
        self.by_clock = Rhythm::default();
        self.estimated = false;
        self.round_trip = Rhythm::default();
        self.overtaken = Rhythm::default();
        self.answer = None;
        self.marker = None;
        for logical in &mut self.logical {
            logical.counts.clear();
            logical.changes = Log::new(MOST_CHANGES);
            logical.lost = Log::new(MOST_CHANGES);
            logical.last = None;
            logical.recent = 0;
        }
    }

    /// Another stretch of operation begins: counts each datagram from zero.
    pub fn recount(&mut self) {
        self.logical.iter_mut().for_each(|logical| logical.recent = 0);
    }

    /// Forgets the events so far. The usual working counter stays known, with a limited weight, so
    /// that another one may become usual.
    pub fn forget(&mut self) {
        self.rhythm = Rhythm::default();
        self.by_clock = Rhythm::default();
        self.estimated = false;
        self.round_trip = Rhythm::default();
        self.overtaken = Rhythm::default();
        self.answer = None;
        self.forget_outages();
        self.pauses.clear();
        for logical in &mut self.logical {
            let usual = logical.usual();
            logical.counts.retain(|count, _| Some(*count) == usual);
            logical.counts.values_mut().for_each(|times| *times = (*times).min(USUAL_WEIGHT));
            logical.changes = Log::new(MOST_CHANGES);
            logical.lost = Log::new(MOST_CHANGES);
            logical.forgot = true;
        }
    }

    fn place(&mut self, access: &Access<'_>) -> Option<usize> {
        let (command, address, len) = (access.command, access.header.address, access.header.len);
        let same = |one: &Logical| (one.command, one.address, one.len) == (command, address, len);
        if let Some(place) = self.logical.iter().position(same) {
            return Some(place);
        }
        if self.logical.len() >= MOST_LOGICAL {
            self.left_out += 1;
            return None;
        }
        self.logical.push(Logical {
            command,
            address,
            len,
            frames: 0,
            recent: 0,
            first: access.frame,
            last_at: Duration::ZERO,
            counts: BTreeMap::new(),
            changes: Log::new(MOST_CHANGES),
            lost: Log::new(MOST_CHANGES),
            last: None,
            forgot: false,
        });
        Some(self.logical.len() - 1)
    }
}

impl Logical {
    fn count(&mut self, wkc: u16, at: Duration, frame: usize) {
        if self.counts.len() < MOST_COUNTS || self.counts.contains_key(&wkc) {
            *self.counts.entry(wkc).or_default() += 1;
        }
        let last = self.last.replace((wkc, frame)).filter(|(last, _)| *last != wkc);
        if let Some((from, before)) = last {
            self.changes.push(Change { frame, at, before, from, to: wkc });
        }
    }
}

/// Frames in a row without an answer that are no single losses any more.
pub(crate) const SILENT: u64 = 8;
/// Time without process data that is a pause: a device that waits for them may give up.
const PAUSE: Duration = Duration::from_millis(500);
/// Outages, and pauses, that are kept.
const MOST_STRETCHES: usize = 64;
/// Logical datagrams that are kept apart.
const MOST_LOGICAL: usize = 256;
/// Working counters of one datagram that are kept apart.
const MOST_COUNTS: usize = 256;
/// Changes and losses of one datagram that are kept.
const MOST_CHANGES: usize = 512;
/// Frames with the same working counter from which on it may be the usual one.
const LEAST_USUAL: u64 = 8;
/// Largest number of frames that the usual working counter keeps as its weight in `forget`.
const USUAL_WEIGHT: u64 = 1000;
/// Long intervals that are kept.
const MOST_GAPS: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;

    /// By stamps the time is known near a drift frame only. What passed meanwhile counts, unless
    /// frames were lost.
    #[test]
    fn a_pause_without_readings_counts() {
        for (is_back, longest) in [(true, 52_000_000), (false, 1_000_000)] {
            let mut cycle = Cycle { estimated: true, ..Cycle::default() };
            let mut begins = |ms: u64, known: bool, is_back| {
                let at = Duration::from_millis(ms);
                cycle.begins(at, known.then_some(ms * 1_000_000), ms as usize, is_back);
            };
            (0..30).for_each(|ms| begins(ms, true, true));
            begins(80, false, is_back);
            (81..90).for_each(|ms| begins(ms, true, true));
            assert_eq!(cycle.by_clock.longest[0].ns, longest);
        }
    }

    #[test]
    fn intervals_in_three_digits() {
        for (ns, rounded) in [
            (0, 0),
            (7, 7),
            (999, 999),
            (1_234, 1_230),
            (1_235, 1_240),
            (999_499, 999_000),
            (999_500, 1_000_000),
        ] {
            assert_eq!(three_digits(ns), rounded);
        }
    }

    #[test]
    fn the_longest_intervals_are_kept() {
        let mut rhythm = Rhythm::default();
        let mut at = Duration::ZERO;
        for cycle in 0..100 {
            at += Duration::from_micros(if cycle == 40 { 7_000 } else { 1_000 + cycle % 3 });
            rhythm.cycle(at, at, cycle as usize);
        }
        assert_eq!((rhythm.count, rhythm.median()), (99, Some(1_000_000)));
        let first = rhythm.longest[0];
        assert_eq!((first.frame, first.ns), (40, 7_000_000));
        assert_eq!(rhythm.shortest().map(|known| known.value), Some(1_000_000));
        assert_eq!(rhythm.longest.len(), MOST_GAPS);
    }
}
