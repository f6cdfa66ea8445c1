//! A capture file, written by the recorder of the real-time loop.

use std::io;
use std::time::Duration;

use isocat_host::recorder::Sink;
use isocat_recorders::capture::Capture;

/// A sink that passes frames to two sinks.
pub struct BothSinks(pub Box<dyn Sink>, pub Box<dyn Sink>);

impl Sink for BothSinks {
    fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]) {
        self.0.frame(at, sent, bytes);
        self.1.frame(at, sent, bytes);
    }

    fn idle(&mut self, now: Duration) {
        self.0.idle(now);
        self.1.idle(now);
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        let Self(one, other) = *self;
        let first = one.finish();
        other.finish().and(first)
    }
}

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
