//! When the last frames came back.

use isocat_wire::time::{Time, True};

/// The last frames that came back to the MainDevice.
#[derive(Debug)]
pub(crate) struct Returns {
    last: Vec<Return>,
    /// The place of the oldest one, once all places are taken.
    oldest: usize,
    /// Whether there was a copy of a frame.
    has_copies: bool,
}

#[derive(Clone, Copy, Debug)]
struct Return {
    /// When its first bit left, or that of the frame of which it is a copy.
    label: Time<True>,
    start: Time<True>,
    last_bit: Time<True>,
}

impl Returns {
    /// No frame has come back.
    pub fn new() -> Self {
        Self { last: Vec::with_capacity(MOST), oldest: 0, has_copies: false }
    }

    /// Takes a frame that left at `start`, or the copy of one that left at `label`.
    #[inline]
    pub fn note(&mut self, label: Time<True>, start: Time<True>, last_bit: Time<True>) {
        let new = Return { label, start, last_bit };
        self.has_copies |= label != start;
        match self.last.get_mut(self.oldest) {
            Some(place) => *place = new,
            None => self.last.push(new),
        }
        self.oldest = (self.oldest + 1) % MOST;
    }

    /// Whether several frames may have the same label.
    pub const fn have_copies(&self) -> bool {
        self.has_copies
    }

    /// When the last bit came back of the frame with this label which passed a SubDevice at `at`.
    /// `None`: it did not come back, or long ago.
    pub fn find(&self, label: Time<True>, at: Time<True>) -> Option<Time<True>> {
        let (newer, older) = self.last.split_at(self.oldest.min(self.last.len()));
        let mut all = newer.iter().rev().chain(older.iter().rev());
        all.find(|it| it.label == label && it.start <= at).map(|it| it.last_bit)
    }
}

/// More than the frames of two long cycles.
const MOST: usize = 256;

#[cfg(test)]
mod tests {
    use super::*;

    /// The last ones are kept, and of copies the one that had left.
    #[test]
    fn the_last_frames_are_found() {
        let mut returns = Returns::new();
        for number in 0..1_000 {
            let start = Time::new(1_000 * number);
            returns.note(start, start, Time::new(1_000 * number + 700));
        }
        let find = |returns: &Returns, label, at| {
            returns.find(Time::new(label), Time::new(at)).map(|it| it.count())
        };
        for number in 0..1_000 {
            let expected = (number >= 1_000 - MOST as u64).then_some(1_000 * number + 700);
            assert_eq!(find(&returns, 1_000 * number, 1_000 * number), expected);
        }
        returns.note(Time::new(999_000), Time::new(999_500), Time::new(1_000_200));
        assert_eq!(find(&returns, 999_000, 999_499), Some(999_700));
        assert_eq!(find(&returns, 999_000, 999_500), Some(1_000_200));
        assert_eq!(find(&returns, 999_001, 2_000_000), None);
    }
}
