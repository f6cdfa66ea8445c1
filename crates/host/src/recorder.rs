//! Frames into a capture file, without the loop waiting for the disk.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use isocat_maindevice::FRAME_LEN;
use isocat_wire::time::{Host, Time};

use crate::clock;

/// A file of frames. Its calls come from a thread of their own and may take their time.
pub trait Sink: Send + 'static {
    /// Takes a frame whose first bit left (`sent`) or came in at `at`, wall time since 1970. An error is kept until the end.
    fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]);

    /// There is nothing to take, and it is `now`, wall time since 1970: called every few
    /// milliseconds as long as that is so.
    fn idle(&mut self, _now: Duration) {}

    /// Writes what is left; gives the first error.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

/// Hands frames to a thread that writes them. What that thread has no room for is dropped and counted.
#[derive(Debug)]
pub struct Recorder {
    records: SyncSender<Record>,
    writer: JoinHandle<Box<dyn Sink>>,
    /// Wall time less host time, ns, as of the beginning.
    wall: i64,
    dropped: u64,
}

/// One frame; whole, so that none is allocated.
struct Record {
    at: Duration,
    sent: bool,
    len: usize,
    bytes: [u8; FRAME_LEN],
}

impl Recorder {
    /// Begins a thread that writes into `sink`. To be made before the caller asks for real time, which
    /// threads inherit.
    pub fn new(sink: impl Sink) -> Self {
        let (records, incoming) = sync_channel(ROOM);
        let wall = clock::wall_offset();
        let writer = std::thread::spawn(move || write(Box::new(sink), &incoming, wall));
        Self { records, writer, wall, dropped: 0 }
    }

    /// Takes a frame that left or came at `at`. With `patient` it blocks until the queue has room;
    /// without, a frame that finds the queue full is dropped and counted.
    pub fn frame(&mut self, at: Time<Host>, sent: bool, bytes: &[u8], patient: bool) {
        let len = bytes.len().min(FRAME_LEN);
        let at = wall_time(at, self.wall);
        let mut record = Record { at, sent, len, bytes: [0; FRAME_LEN] };
        record.bytes[..len].copy_from_slice(&bytes[..len]);
        let taken = match self.records.try_send(record) {
            Ok(()) => true,
            Err(TrySendError::Full(record)) if patient => self.records.send(record).is_ok(),
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
        };
        self.dropped += u64::from(!taken);
    }

    /// Writes what is left; gives how many frames were dropped, or the first error of the file.
    pub fn finish(self) -> io::Result<u64> {
        drop(self.records);
        let sink = self.writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        sink.finish().map(|()| self.dropped)
    }
}

/// Looks now and then: a thread that waits would have to be woken by the loop, with a system call.
fn write(mut sink: Box<dyn Sink>, incoming: &Receiver<Record>, wall: i64) -> Box<dyn Sink> {
    loop {
        match incoming.try_recv() {
            Ok(record) => sink.frame(record.at, record.sent, &record.bytes[..record.len]),
            Err(TryRecvError::Empty) => {
                std::thread::sleep(PAUSE);
                sink.idle(wall_time(clock::now(), wall));
            }
            Err(TryRecvError::Disconnected) => return sink,
        }
    }
}

/// `wall`: wall time less host time, ns.
fn wall_time(at: Time<Host>, wall: i64) -> Duration {
    Duration::from_nanos(at.count().saturating_add_signed(wall))
}

/// Frames that may wait, 25 MB: a tenth of a second of the densest traffic at 100 Mbit/s.
const ROOM: usize = 16_384;
const PAUSE: Duration = Duration::from_millis(2);
