//! Counts of the frames that an interface has carried for any program.

use super::namespace::inside_or_here;

/// Counts of an interface since it was created.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Traffic {
    /// Frames that came in.
    pub received: u64,
    /// Frames that left.
    pub sent: u64,
}

impl Traffic {
    /// Counts of an interface in a network namespace; `None` if they cannot be read.
    pub fn of(interface: &str, namespace: Option<&str>) -> Option<Self> {
        let read = || std::fs::read_to_string("/proc/thread-self/net/dev").ok();
        Self::parse(&inside_or_here(namespace, read).ok()??, interface)
    }

    /// Reads the counts in the table of `/proc/net/dev`.
    fn parse(table: &str, interface: &str) -> Option<Self> {
        let columns = table.lines().filter_map(|line| line.split_once(':'));
        let (_, figures) = columns.into_iter().find(|(name, _)| name.trim() == interface)?;
        let figures: Vec<u64> = figures.split_whitespace().flat_map(str::parse).collect();
        Some(Self { received: *figures.get(1)?, sent: *figures.get(9)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_table() {
        let table = "\
Inter-|   Receive                                                |  Transmit
 face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls carrier compressed
    lo:  211800    1765    0    0    0     0          0         0   211800    1766    0    0    0     0       0          0
  eth0: 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16
";
        assert_eq!(Traffic::parse(table, "lo"), Some(Traffic { received: 1765, sent: 1766 }));
        assert_eq!(Traffic::parse(table, "eth0"), Some(Traffic { received: 2, sent: 10 }));
        assert_eq!(Traffic::parse(table, "eth"), None);
    }
}
