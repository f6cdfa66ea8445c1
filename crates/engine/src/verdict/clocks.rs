//! Follows 0x092C of each clock over the whole time.

use isocat_sim::{Judged, Place};
use isocat_wire::time::{Host, Nanos, Time};

use super::{Gap, Readings, Verdict, Witness};

/// All clocks that make SYNC pulses, except the reference clock.
pub(super) struct Clocks {
    limit: Nanos,
    /// By index among [`Witness::clocks`].
    followed: Vec<Followed>,
    /// Whether anything is read in the background.
    background: bool,
}

#[derive(Clone, Copy, Default)]
struct Followed {
    /// Time of the last reading that was used.
    seen: Option<Time<Host>>,
    /// Time of the first reading beyond the limit, and the worst of all.
    beyond: Option<Nanos>,
    worst: Nanos,
    /// The largest bound of those that may reach beyond the limit.
    bound: Option<Nanos>,
}

impl Clocks {
    pub fn new(main: &impl Witness, limit: Nanos) -> Self {
        let followed = vec![Followed::default(); main.clocks().len()];
        Self { limit, followed, background: main.objects().is_some() }
    }

    /// Takes the readings of one clock: in each cycle another one.
    pub fn look(&mut self, at: Nanos, main: &impl Witness, cycle: u64) {
        let count = self.followed.len() as u64;
        if count > 0 {
            self.look_at((cycle % count) as usize, at, main);
        }
    }

    fn look_at(&mut self, index: usize, at: Nanos, main: &impl Witness) {
        let (limit, quality) = (self.limit, main.clocks());
        let (Some(followed), Some(clock)) = (self.followed.get_mut(index), quality.get(index))
        else {
            return;
        };
        let last = clock.last_read();
        if last.is_none() || last == followed.seen {
            return;
        }
        // The worst of all that are kept says most times that no new one is worse.
        let known = followed.worst.abs().min(limit);
        if clock.worst() > known
            && let Some(worst) = clock.worst_since(followed.seen)
        {
            if worst.abs() > followed.worst.abs() {
                followed.worst = worst;
            }
            if worst.abs() > limit {
                followed.beyond.get_or_insert(at);
            }
        }
        // A smaller one has no effect, see `end`.
        let known = followed.bound.unwrap_or(Nanos(limit.0 / BETWEEN_FRAMES));
        followed.bound = clock.larger_bound(known).or(followed.bound);
        followed.seen = last;
    }

    /// Adds the results; `readings` are those of each SubDevice at the end.
    pub fn end(
        &mut self,
        at: Nanos,
        main: &impl Witness,
        readings: &[Readings],
        verdict: &mut Verdict,
    ) {
        for index in 0..self.followed.len() {
            self.look_at(index, at, main);
        }
        let segment = main.segment();
        let limit = self.limit;
        for device in &segment.devices {
            let position = device.position;
            if !device.mode.uses_dc() || segment.reference == Some(position) || !device.admitted {
                continue;
            }
            let index = main.clocks().iter().position(|clock| clock.position == position);
            let followed = index.map_or(Followed::default(), |index| self.followed[index]);
            let at_end = readings.get(position).and_then(|readings| readings.difference);
            let mut add = |since, difference| {
                let kind = Judged::ClockOff { difference, limit };
                verdict.add(Place::device(position), since, kind);
            };
            match (followed.beyond, at_end) {
                (Some(since), _) => add(Some(since), followed.worst),
                // This is a single reading while frames took another way: no clock moves this far
                // between two readings.
                (None, Some(difference)) if difference.abs() > limit && followed.seen.is_some() => {
                    let bound = difference.abs();
                    verdict.doubt(Place::device(position), Gap::ClockNearLimit { bound, limit });
                }
                (None, Some(difference)) if difference.abs() > limit => add(None, difference),
                _ if !self.background => {}
                _ if followed.seen.is_none() => {
                    verdict.doubt(Place::device(position), Gap::ClockNotRead);
                }
                _ => {
                    let bound = followed.bound.map(|bound| Nanos(bound.0 * BETWEEN_FRAMES));
                    if let Some(bound) = bound.filter(|bound| *bound > limit) {
                        verdict
                            .doubt(Place::device(position), Gap::ClockNearLimit { bound, limit });
                    }
                }
            }
        }
        let reads = |device: &isocat_maindevice::SubDevice| device.mode.uses_dc();
        if !self.background && segment.devices.iter().any(reads) {
            verdict.doubt(Place::SEGMENT, Gap::BackgroundOff);
        }
    }
}

/// 0x092C is a mean over drift frames, and a clock that drifts is farther off just before each of
/// them: up to 1.45 times as far was observed.
const BETWEEN_FRAMES: i64 = 2;
