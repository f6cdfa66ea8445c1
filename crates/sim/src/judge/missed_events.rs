//! Counts missed SM events, and records the first one.

use isocat_wire::time::{Time, True};

/// Counts the missed SM events of one SubDevice. The SubDevice's own counter (0x1C32:0B) also
/// decreases and is reset; this one only increases.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct MissedEvents {
    count: u64,
    first: Option<Time<True>>,
    highest: u16,
}

impl MissedEvents {
    /// Takes a missed event, with the new value of the SubDevice's counter.
    pub fn missed(&mut self, at: Time<True>, counter: u16) {
        self.count += 1;
        self.first.get_or_insert(at);
        self.highest = self.highest.max(counter);
    }

    /// Number of missed events.
    pub fn count(&self) -> u64 {
        self.count
    }
    /// When the first was missed.
    pub fn first(&self) -> Option<Time<True>> {
        self.first
    }
    /// Highest value that the SubDevice's counter reached.
    pub fn highest(&self) -> u16 {
        self.highest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_and_the_highest_are_kept() {
        let mut judge = MissedEvents::default();
        judge.missed(Time::new(5), 3);
        judge.missed(Time::new(6), 6);
        judge.missed(Time::new(9), 3);
        assert_eq!((judge.count(), judge.first(), judge.highest()), (3, Some(Time::new(5)), 6));
    }
}
