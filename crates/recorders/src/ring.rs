//! The last frames of a wire, in bounded memory.
//!
//! Frames are stored one after the other in one buffer, each with a short header. The buffer grows
//! until it holds the span that is kept, and never beyond its limit. From then on, pushing a frame
//! allocates nothing.

use std::collections::VecDeque;
use std::time::Duration;

/// The frames of the last span of time.
#[derive(Debug)]
pub struct Ring {
    span: Duration,
    most: usize,
    bytes: VecDeque<u8>,
    /// Frames that were pushed so far; this is the number of the last one.
    pushed: u64,
    /// Frames in the buffer.
    held: u64,
    /// Stamp of the last frame that was dropped before its time, because the memory limit was
    /// reached.
    crowded_out: Option<Duration>,
}

/// A frame of a ring.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct RingFrame<'a> {
    /// Its number over all pushed frames, from 1.
    pub number: u64,
    /// When it was seen.
    pub at: Duration,
    /// Whether it left (`true`) or came in.
    pub sent: bool,
    /// The frame from the destination address on.
    pub bytes: &'a [u8],
}

/// Frames that were copied out of a ring.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Stretch {
    first: u64,
    bytes: Vec<u8>,
}

/// The header of a frame in the buffer.
struct Header {
    at: u64,
    sent: bool,
    len: usize,
}

impl Ring {
    /// Keeps frames that are at most `span` old, in at most `most` bytes of memory.
    pub fn new(span: Duration, most: usize) -> Self {
        Self { span, most, bytes: VecDeque::new(), pushed: 0, held: 0, crowded_out: None }
    }

    /// Takes the next frame; returns its number, from 1. Frames must come in the order of time. A
    /// frame that is longer than the whole memory, or than 64 kB, is counted and not kept.
    pub fn push(&mut self, at: Duration, sent: bool, bytes: &[u8]) -> u64 {
        self.pushed += 1;
        self.forget_before(at.saturating_sub(self.span));
        let needed = HEADER_LEN + bytes.len();
        if needed > self.most || bytes.len() > usize::from(u16::MAX) {
            // The frames that are kept must have consecutive numbers, so all earlier ones are
            // dropped.
            self.bytes.clear();
            self.held = 0;
            self.crowded_out = Some(at);
            return self.pushed;
        }
        while self.bytes.len() + needed > self.most {
            self.crowded_out = self.pop();
        }
        self.make_room(needed);
        let header = Header { at: nanos(at), sent, len: bytes.len() };
        self.bytes.extend(header.emit());
        self.bytes.extend(bytes);
        self.held += 1;
        self.pushed
    }

    /// Number of the last frame that was pushed; 0 before the first.
    pub fn last(&self) -> u64 {
        self.pushed
    }

    /// Number of frames in the buffer.
    pub fn len(&self) -> u64 {
        self.held
    }

    /// Whether the buffer has no frame.
    pub fn is_empty(&self) -> bool {
        self.held == 0
    }

    /// Whether a frame from `from` or later was dropped before its time, because the memory limit
    /// was reached.
    pub fn lacks_since(&self, from: Duration) -> bool {
        self.crowded_out.is_some_and(|at| at >= from)
    }

    /// When the frame with this number was seen; `None`: it is no longer kept, or did not come yet.
    pub fn at(&self, number: u64) -> Option<Duration> {
        let mut place = 0;
        for held in self.first()..=self.pushed {
            let header = self.header(place)?;
            if held == number {
                return Some(Duration::from_nanos(header.at));
            }
            place += HEADER_LEN + header.len;
        }
        None
    }

    /// Copies the frames that were seen from `from` to `to`, both included.
    pub fn copy(&self, from: Duration, to: Duration) -> Stretch {
        let (mut first, mut range) = (0, None::<std::ops::Range<usize>>);
        let mut place = 0;
        for number in self.first()..=self.pushed {
            let Some(header) = self.header(place) else { break };
            let end = place + HEADER_LEN + header.len;
            if (nanos(from)..=nanos(to)).contains(&header.at) {
                if range.is_none() {
                    first = number;
                }
                range = Some(range.map_or(place, |range| range.start)..end);
            }
            place = end;
        }
        let mut bytes = Vec::new();
        if let Some(range) = range {
            bytes.reserve_exact(range.len());
            let (head, tail) = self.bytes.as_slices();
            let middle = head.len();
            bytes.extend(&head[range.start.min(middle)..range.end.min(middle)]);
            bytes.extend(&tail[range.start.max(middle) - middle..range.end.max(middle) - middle]);
        }
        Stretch { first, bytes }
    }

    /// Number of the oldest frame in the buffer.
    fn first(&self) -> u64 {
        self.pushed + 1 - self.held
    }

    fn forget_before(&mut self, limit: Duration) {
        while self.header(0).is_some_and(|oldest| oldest.at < nanos(limit)) {
            self.pop();
        }
    }

    /// Removes the oldest frame; returns its stamp.
    fn pop(&mut self) -> Option<Duration> {
        let oldest = self.header(0)?;
        self.bytes.drain(..HEADER_LEN + oldest.len);
        self.held -= 1;
        Some(Duration::from_nanos(oldest.at))
    }

    /// Doubles the memory if needed, but not beyond its limit.
    fn make_room(&mut self, needed: usize) {
        let wanted = self.bytes.len() + needed;
        if wanted > self.bytes.capacity() {
            let room = (2 * self.bytes.capacity()).max(LEAST_ROOM).max(wanted).min(self.most);
            self.bytes.reserve_exact(room - self.bytes.len());
        }
    }

    fn header(&self, place: usize) -> Option<Header> {
        let mut bytes = [0; HEADER_LEN];
        for (at, byte) in bytes.iter_mut().enumerate() {
            *byte = *self.bytes.get(place + at)?;
        }
        Some(Header::parse(bytes))
    }
}

impl Stretch {
    /// Whether it has no frame.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The frames, in the order in which they came.
    pub fn frames(&self) -> impl Iterator<Item = RingFrame<'_>> {
        let mut rest = &self.bytes[..];
        (self.first..).map_while(move |number| {
            let (header, behind) = rest.split_first_chunk::<HEADER_LEN>()?;
            let Header { at, sent, len } = Header::parse(*header);
            let (bytes, behind) = behind.split_at_checked(len)?;
            rest = behind;
            Some(RingFrame { number, at: Duration::from_nanos(at), sent, bytes })
        })
    }
}

impl Header {
    fn emit(&self) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        bytes[..8].copy_from_slice(&self.at.to_le_bytes());
        bytes[8..10].copy_from_slice(&(self.len as u16).to_le_bytes());
        bytes[10] = u8::from(self.sent);
        bytes
    }

    fn parse(bytes: [u8; HEADER_LEN]) -> Self {
        let [a, b, c, d, e, f, g, h, low, high, sent] = bytes;
        Self {
            at: u64::from_le_bytes([a, b, c, d, e, f, g, h]),
            sent: sent != 0,
            len: usize::from(u16::from_le_bytes([low, high])),
        }
    }
}

fn nanos(at: Duration) -> u64 {
    u64::try_from(at.as_nanos()).unwrap_or(u64::MAX)
}

/// Bytes of stamp, length and direction.
const HEADER_LEN: usize = 11;
/// First size of the memory, bytes.
const LEAST_ROOM: usize = 64 << 10;

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);
    const NANOSECOND: Duration = Duration::from_nanos(1);

    fn numbers(ring: &Ring) -> Vec<u64> {
        ring.copy(Duration::ZERO, Duration::MAX).frames().map(|frame| frame.number).collect()
    }

    #[test]
    fn frames_are_kept_for_the_span_and_not_a_nanosecond_longer() {
        let mut ring = Ring::new(SECOND, 1 << 20);
        assert_eq!((ring.last(), ring.at(1), numbers(&ring)), (0, None, vec![]));
        let at = 5 * SECOND;
        assert_eq!(ring.push(at, true, &[1; 60]), 1);
        assert_eq!(ring.push(at + SECOND, false, &[2; 60]), 2);
        assert_eq!(numbers(&ring), [1, 2], "just as old as the span");
        ring.push(at + SECOND + NANOSECOND, true, &[3; 60]);
        assert_eq!(numbers(&ring), [2, 3], "a nanosecond older");
        assert_eq!((ring.at(1), ring.at(2), ring.at(4)), (None, Some(at + SECOND), None));
        assert_eq!((ring.len(), ring.lacks_since(Duration::ZERO)), (2, false));
    }

    #[test]
    fn memory_is_bounded_to_the_byte() {
        let room = 3 * (HEADER_LEN + 60);
        let mut ring = Ring::new(SECOND, room);
        let at = |number: u32| SECOND + number * NANOSECOND;
        for number in 1..=3 {
            ring.push(at(number), false, &[0; 60]);
        }
        assert_eq!(numbers(&ring), [1, 2, 3], "they fit exactly");
        assert!(!ring.lacks_since(Duration::ZERO));
        ring.push(at(4), false, &[0; 60]);
        assert_eq!(numbers(&ring), [2, 3, 4]);
        assert_eq!((ring.lacks_since(at(1)), ring.lacks_since(at(2))), (true, false));
        // The new frame needs one byte more than one old frame gives: two are dropped.
        ring.push(at(5), false, &[0; 61]);
        assert_eq!(numbers(&ring), [4, 5]);
        assert_eq!((ring.lacks_since(at(3)), ring.lacks_since(at(4))), (true, false));
        assert!(ring.bytes.capacity() <= room, "{}", ring.bytes.capacity());
    }

    #[test]
    fn what_is_too_long_for_it_is_counted() {
        let mut ring = Ring::new(SECOND, HEADER_LEN + 60);
        ring.push(SECOND, true, &[1; 60]);
        assert_eq!(numbers(&ring), [1]);
        assert_eq!(ring.push(SECOND, true, &[2; 61]), 2);
        assert_eq!((numbers(&ring), ring.lacks_since(SECOND)), (vec![], true));
        assert_eq!(ring.push(SECOND, true, &[3; 60]), 3);
        assert_eq!(numbers(&ring), [3], "numbers go on");
    }

    #[test]
    fn a_copy_has_what_was_pushed_around_the_seam_too() {
        // Frames have many lengths, so that the end of the ring lies at different places in them.
        let mut ring = Ring::new(100 * NANOSECOND, 1000);
        let frame = |number: u64| vec![number as u8; 14 + (number * 7 % 90) as usize];
        for number in 1..=5000_u64 {
            ring.push(Duration::from_nanos(number), number % 3 == 0, &frame(number));
            let copy = ring.copy(Duration::ZERO, Duration::MAX);
            let held: Vec<_> = copy.frames().collect();
            assert_eq!(held.len() as u64, ring.len());
            assert_eq!(held.last().map(|frame| frame.number), Some(number));
            for one in held {
                assert_eq!(one.bytes, frame(one.number), "frame {}", one.number);
                assert_eq!(one.at, Duration::from_nanos(one.number));
                assert_eq!(one.sent, one.number % 3 == 0);
            }
        }
        assert!(ring.lacks_since(Duration::ZERO));
    }

    #[test]
    fn a_stretch_has_both_its_ends() {
        let mut ring = Ring::new(SECOND, 1 << 20);
        for at in 1..=9 {
            ring.push(Duration::from_nanos(at), true, &[0; 20]);
        }
        let of = |from, to| {
            let stretch = ring.copy(Duration::from_nanos(from), Duration::from_nanos(to));
            stretch.frames().map(|frame| frame.number).collect::<Vec<_>>()
        };
        assert_eq!(of(3, 5), [3, 4, 5]);
        assert_eq!(of(9, 99), [9]);
        assert_eq!(of(10, 99), [] as [u64; 0]);
        assert_eq!(of(5, 3), [] as [u64; 0]);
    }

    #[test]
    fn stamps_that_go_back_harm_nothing() {
        let mut ring = Ring::new(SECOND, 1 << 20);
        ring.push(100 * SECOND, true, &[1; 20]);
        ring.push(SECOND, true, &[2; 20]);
        assert_eq!(numbers(&ring), [1, 2]);
        ring.push(101 * SECOND, true, &[3; 20]);
        ring.push(102 * SECOND + NANOSECOND, true, &[4; 20]);
        assert_eq!(numbers(&ring), [4]);
    }

    #[test]
    fn after_warm_up_nothing_is_allocated() {
        let mut ring = Ring::new(SECOND, 1 << 20);
        let mut push = |milliseconds: std::ops::Range<u64>| {
            for at in milliseconds {
                ring.push(Duration::from_millis(at), at % 2 == 0, &[0xA4; 300]);
            }
        };
        let warm_up = allocation_counter::measure(|| push(0..1100));
        assert!(warm_up.count_total > 0, "the counter counts");
        let later = allocation_counter::measure(|| push(1100..100_000));
        assert_eq!(later.count_total, 0, "{later:?}");
    }
}
