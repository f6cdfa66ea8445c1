//! Checks that each pulse of SYNC0 and SYNC1 makes an edge.

use isocat_subdevice::Event;
use isocat_wire::time::{Time, True};

/// Counts the pulses of one SubDevice that were due while their signal was still active from the
/// previous pulse. They make no edge, and the SubDevice's program does not notice them.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct LostPulses {
    sync0: u64,
    sync1: u64,
    first: Option<Time<True>>,
}

impl LostPulses {
    /// Takes a pulse of this signal that was due at true time `at` and made no edge.
    pub fn lost(&mut self, at: Time<True>, signal: Event) {
        match signal {
            Event::Sync1 => self.sync1 += 1,
            _ => self.sync0 += 1,
        }
        self.first.get_or_insert(at);
    }

    /// Number of lost pulses of SYNC0.
    pub fn sync0(&self) -> u64 {
        self.sync0
    }
    /// Number of lost pulses of SYNC1.
    pub fn sync1(&self) -> u64 {
        self.sync1
    }
    /// When the first was lost.
    pub fn first(&self) -> Option<Time<True>> {
        self.first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_signals_are_counted_apart_and_the_first_is_kept() {
        let mut judge = LostPulses::default();
        assert_eq!(judge.first(), None);
        judge.lost(Time::new(5), Event::Sync1);
        judge.lost(Time::new(6), Event::Sync0);
        judge.lost(Time::new(9), Event::Sync0);
        assert_eq!((judge.sync0(), judge.sync1(), judge.first()), (2, 1, Some(Time::new(5))));
    }
}
