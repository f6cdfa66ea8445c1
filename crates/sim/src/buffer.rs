//! Room for a frame.

use isocat_wire::frame;

/// A buffer for the longest frame, with a frame.
#[derive(Clone, Debug)]
pub struct Buffer {
    bytes: Box<[u8]>,
    len: usize,
}

impl Buffer {
    /// A buffer with an empty frame.
    pub fn new() -> Self {
        Self { bytes: vec![0; frame::MAX_LEN].into(), len: 0 }
    }

    /// All of the room, for a frame whose length is [set](Self::set_len) then.
    pub fn room(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    /// Sets the length of the frame, at most that of the room.
    pub fn set_len(&mut self, len: usize) {
        self.len = len.min(self.bytes.len());
    }

    /// The frame.
    pub fn frame(&self) -> &[u8] {
        &self.bytes[..self.len]
    }

    /// The frame.
    pub fn frame_mut(&mut self) -> &mut [u8] {
        &mut self.bytes[..self.len]
    }
}

impl Default for Buffer {
    fn default() -> Self {
        Self::new()
    }
}
