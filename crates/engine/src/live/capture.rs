//! A capture file as the recorder of the real-time loop writes it.

use std::io;
use std::time::Duration;

use isocat_host::recorder::Sink;
use isocat_recorders::capture::Capture;

/// Frames of a real interface, in a capture file.
pub struct CaptureSink(pub Capture);

impl Sink for CaptureSink {
    fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]) {
        self.0.write(at, sent, bytes);
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        self.0.finish().map(|_| ())
    }
}
