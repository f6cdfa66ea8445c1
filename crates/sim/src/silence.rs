//! Times in which frames left and none came back, as when the first cable is out.

use isocat_maindevice::Statistics;
use isocat_wire::time::{Picos, Time, True};

/// Watches that frames come back.
#[derive(Clone, Debug, Default)]
pub(crate) struct Silences {
    /// When a frame came back last, and the counts then.
    last: Option<(Time<True>, Counts)>,
    /// The longest one so far.
    longest: Option<Silence>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Counts {
    sent: u64,
    received: u64,
}

impl Counts {
    fn of(counts: &Statistics) -> Self {
        // Answers that come too late are answers.
        let received = counts.frames_received + counts.frames_late;
        Self { sent: counts.frames_sent, received }
    }
}

/// A time in which no frame came back.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Silence {
    pub since: Time<True>,
    pub lasted: Picos,
    /// Frames that left meanwhile.
    pub frames: u64,
}

impl Silence {
    pub fn contains(&self, at: Time<True>) -> bool {
        self.since <= at && at <= self.since + self.lasted
    }
}

impl Silences {
    /// Looks at the counts of the MainDevice.
    pub fn look(&mut self, now: Time<True>, counts: &Statistics) {
        let now_counts = Counts::of(counts);
        let (at, then) = *self.last.get_or_insert((now, now_counts));
        if now_counts.received != then.received {
            self.ends(at, then, now, now_counts);
            self.last = Some((now, now_counts));
        }
    }

    /// The longest one up to now.
    pub fn longest(mut self, now: Time<True>, counts: &Statistics) -> Option<Silence> {
        let now_counts = Counts::of(counts);
        if let Some((at, then)) = self.last {
            self.ends(at, then, now, now_counts);
        }
        self.longest
    }

    fn ends(&mut self, since: Time<True>, then: Counts, now: Time<True>, counts: Counts) {
        let silence = Silence { since, lasted: now - since, frames: counts.sent - then.sent };
        let counts = silence.frames >= LEAST_FRAMES && silence.lasted >= LEAST;
        if counts && self.longest.is_none_or(|longest| longest.lasted < silence.lasted) {
            self.longest = Some(silence);
        }
    }
}

/// Frames without an answer, and the time, below which single frames are lost. So many may be under
/// way at a time, and a segment is never as long.
const LEAST_FRAMES: u64 = 16;
const LEAST: Picos = Picos(20_000_000_000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_a_time_and_frames_make_a_silence() {
        let longest = |frames: u64, ms: i64| {
            let at = |ms: i64| Time::ZERO + Picos(ms * 1_000_000_000);
            let counts = |frames_sent, frames_received| Statistics {
                frames_sent,
                frames_received,
                ..Statistics::default()
            };
            let mut silences = Silences::default();
            silences.look(at(0), &counts(1, 1));
            silences.look(at(1), &counts(2, 2));
            silences.look(at(ms), &counts(1 + frames, 2));
            let ended = silences.clone();
            silences.look(at(1 + ms), &counts(2 + frames, 3));
            silences.look(at(100 + ms), &counts(3 + frames, 4));
            let goes_on = ended.longest(at(1 + ms), &counts(2 + frames, 2));
            let longest = silences.longest(at(101 + ms), &counts(3 + frames, 4));
            assert_eq!(longest, goes_on);
            longest.map(|one| (one.lasted.0 / 1_000_000_000, one.frames))
        };
        assert_eq!(longest(16, 20), Some((20, 16)));
        assert_eq!(longest(15, 20), None);
        assert_eq!(longest(16, 19), None);
        assert_eq!(longest(900, 500), Some((500, 900)));
        // Answers that were given up and came after all.
        let mut silences = Silences::default();
        let late =
            |count| Statistics { frames_sent: count, frames_late: count, ..Statistics::default() };
        for ms in 0..100 {
            silences.look(Time::ZERO + Picos(ms * 1_000_000_000), &late(ms as u64));
        }
        assert_eq!(silences.longest(Time::ZERO + Picos(100_000_000_000), &late(100)), None);
    }
}
