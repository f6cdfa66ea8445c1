//! The last values of a series.

use alloc::vec::Vec;

/// Keeps the last values, in memory that is allocated once.
#[derive(Clone, Debug)]
pub(super) struct Ring<T> {
    values: Vec<T>,
    length: usize,
    /// Index of the oldest value, which the next one replaces when the ring is full.
    next: usize,
}

impl<T: Copy> Ring<T> {
    /// Keeps `length` values, at least one.
    pub fn new(length: usize) -> Self {
        let length = length.max(1);
        Self { values: Vec::with_capacity(length), length, next: 0 }
    }

    /// Adds a value; returns the one that it replaces.
    pub fn push(&mut self, value: T) -> Option<T> {
        let gone = match self.values.get_mut(self.next) {
            Some(place) => Some(core::mem::replace(place, value)),
            None => {
                self.values.push(value);
                None
            }
        };
        self.next += 1;
        if self.next == self.length {
            self.next = 0;
        }
        gone
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// The oldest value.
    #[inline]
    pub fn first(&self) -> Option<T> {
        self.values.get(self.next).or(self.values.first()).copied()
    }

    /// The newest value.
    #[inline]
    pub fn last(&self) -> Option<T> {
        let at = self.next.checked_sub(1).unwrap_or(self.length - 1);
        self.values.get(at).copied()
    }

    /// The values in place, in no order.
    #[inline]
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// The values, newest first, in place.
    #[inline]
    pub fn newest(&self) -> impl Iterator<Item = &T> + '_ {
        let (new, old) = self.values.split_at(self.next.min(self.values.len()));
        new.iter().rev().chain(old.iter().rev())
    }

    /// The values, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = T> + '_ {
        let (new, old) = self.values.split_at(self.next.min(self.values.len()));
        old.iter().chain(new).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_go() {
        let mut ring = Ring::new(3);
        let kept = |ring: &Ring<u8>| ring.iter().collect::<Vec<_>>();
        assert_eq!((ring.first(), ring.last()), (None, None));
        let expected: [&[u8]; 5] = [&[1], &[1, 2], &[1, 2, 3], &[2, 3, 4], &[3, 4, 5]];
        for (value, expected) in (1..).zip(expected) {
            ring.push(value);
            assert_eq!(kept(&ring), expected);
            assert_eq!(ring.iter().next_back(), Some(value));
            assert_eq!((ring.last(), ring.first()), (Some(value), expected.first().copied()));
            assert!(ring.newest().eq(expected.iter().rev()));
        }
        assert_eq!(ring.values.capacity(), 3);
    }
}
