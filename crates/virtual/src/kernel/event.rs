//! Event counters as `eventfd` creates them.

/// A counter that writes increase and reads empty.
#[derive(Debug, Default)]
pub struct EventCounter {
    count: u64,
    /// A read takes one from the counter, not all.
    semaphore: bool,
}

/// The largest value of the counter.
const MOST: u64 = u64::MAX - 1;

impl EventCounter {
    /// A counter with this value.
    pub fn new(count: u64, semaphore: bool) -> Self {
        Self { count, semaphore }
    }

    /// Adds to the counter. `false`: the sum would be too large, and nothing was added.
    pub fn add(&mut self, value: u64) -> bool {
        match self.count.checked_add(value).filter(|sum| *sum <= MOST) {
            Some(sum) => {
                self.count = sum;
                true
            }
            None => false,
        }
    }

    /// The result of a read; `None` while the counter is 0.
    pub fn take(&mut self) -> Option<u64> {
        let taken = if self.semaphore { 1.min(self.count) } else { self.count };
        self.count -= taken;
        (taken > 0).then_some(taken)
    }

    /// Whether a read would return a value.
    pub fn is_readable(&self) -> bool {
        self.count > 0
    }

    /// Whether 1 can be added.
    pub fn is_writable(&self) -> bool {
        self.count < MOST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_takes_all_and_of_a_semaphore_one() {
        let mut counter = EventCounter::new(3, false);
        assert_eq!((counter.take(), counter.take()), (Some(3), None));
        let mut semaphore = EventCounter::new(2, true);
        assert_eq!(
            (semaphore.take(), semaphore.take(), semaphore.take()),
            (Some(1), Some(1), None)
        );
    }

    #[test]
    fn it_is_full_one_below_the_largest_number() {
        let mut counter = EventCounter::new(0, false);
        assert!(counter.add(MOST - 1) && counter.is_writable());
        assert!(counter.add(1) && !counter.is_writable());
        assert!(!counter.add(1));
        assert_eq!(counter.take(), Some(MOST));
    }
}
