//! Pipes, and socket pairs, which consist of two pipes.

use std::collections::VecDeque;

/// The number of a pipe.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PipeId(pub u32);

/// The ends of pipes of a file description: the pipe it reads from, and the pipe it writes to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct End {
    /// The pipe that it reads from.
    pub reads: Option<PipeId>,
    /// The pipe that it writes to.
    pub writes: Option<PipeId>,
}

/// Bytes on their way from writers to readers.
#[derive(Debug)]
pub struct Pipe {
    /// The messages in order; a stream has a single one that grows.
    messages: VecDeque<Vec<u8>>,
    /// Whether messages keep their boundaries.
    datagrams: bool,
    bytes: usize,
    /// Number of descriptions that read.
    pub readers: u32,
    /// Number of descriptions that write.
    pub writers: u32,
}

/// Capacity of a pipe in bytes, as in the kernel.
const CAPACITY: usize = 65_536;
/// Writes of up to this many bytes are done as a whole or not at all.
const ATOMIC: usize = 4_096;

impl Pipe {
    /// An empty pipe. `datagrams`: a read returns the bytes of one write.
    pub fn new(datagrams: bool) -> Self {
        Self { messages: VecDeque::new(), datagrams, bytes: 0, readers: 1, writers: 1 }
    }

    /// Takes up to `most` bytes. `None`: there are none yet. Empty: no more will come.
    pub fn read(&mut self, most: usize) -> Option<Vec<u8>> {
        let Some(first) = self.messages.front_mut() else {
            return (self.writers == 0).then(Vec::new);
        };
        let taken: Vec<u8> = first.drain(..most.min(first.len())).collect();
        self.bytes -= taken.len();
        if first.is_empty() || self.datagrams {
            self.bytes -= first.len();
            self.messages.pop_front();
        }
        Some(taken)
    }

    /// Writes bytes and returns their number. `None`: the pipe is full.
    pub fn write(&mut self, bytes: &[u8]) -> Option<usize> {
        let room = CAPACITY - self.bytes;
        let whole = self.datagrams || bytes.len() <= ATOMIC;
        if room == 0 || whole && room < bytes.len() {
            return None;
        }
        let taken = &bytes[..bytes.len().min(room)];
        match self.messages.back_mut().filter(|_| !self.datagrams) {
            Some(last) => last.extend_from_slice(taken),
            None => self.messages.push_back(taken.to_vec()),
        }
        self.bytes += taken.len();
        Some(taken.len())
    }

    /// The start of the next read, up to the end of the message.
    pub fn peek(&self) -> Option<&[u8]> {
        self.messages.front().map(Vec::as_slice)
    }

    /// Whether a read would not wait.
    pub fn is_readable(&self) -> bool {
        !self.messages.is_empty()
    }

    /// Whether a short write would not wait.
    pub fn is_writable(&self) -> bool {
        CAPACITY - self.bytes >= ATOMIC
    }

    /// Number of bytes that wait for a reader.
    pub fn len(&self) -> usize {
        self.bytes
    }

    /// Whether no bytes wait for a reader.
    pub fn is_empty(&self) -> bool {
        self.bytes == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_has_no_borders_and_datagrams_have() {
        let mut stream = Pipe::new(false);
        assert_eq!((stream.write(b"ab"), stream.write(b"cd")), (Some(2), Some(2)));
        assert_eq!(stream.read(3), Some(b"abc".to_vec()));
        assert_eq!((stream.read(9), stream.read(9)), (Some(b"d".to_vec()), None));
        let mut datagrams = Pipe::new(true);
        assert_eq!((datagrams.write(b"ab"), datagrams.write(b"cd")), (Some(2), Some(2)));
        // Bytes of a message beyond the reader's buffer are lost.
        assert_eq!(datagrams.read(1), Some(b"a".to_vec()));
        assert_eq!(datagrams.read(9), Some(b"cd".to_vec()));
        assert!(datagrams.is_empty());
    }

    #[test]
    fn without_writers_it_ends_behind_the_last_byte() {
        let mut pipe = Pipe::new(false);
        pipe.write(b"x");
        pipe.writers = 0;
        assert_eq!((pipe.read(9), pipe.read(9)), (Some(b"x".to_vec()), Some(Vec::new())));
    }

    #[test]
    fn short_writes_are_whole_and_long_ones_fill_it() {
        let mut pipe = Pipe::new(false);
        assert_eq!(pipe.write(&vec![0; CAPACITY - 10]), Some(CAPACITY - 10));
        assert_eq!(pipe.write(&[0; 11]), None);
        assert_eq!(pipe.write(&[0; ATOMIC + 1]), Some(10));
        assert_eq!(pipe.write(&[0; ATOMIC + 1]), None);
    }
}
