//! Writes frames into a capture file without blocking the loop on the disk.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use isocat_maindevice::FRAME_LEN;
use isocat_wire::time::{Host, Time};

use crate::clock;

/// A file of frames. It is called from its own thread, so its calls may block.
pub trait Sink: Send + 'static {
    /// Writes a frame whose first bit left (`sent`) or came in at `at`, wall time since 1970. The
    /// sink keeps an error until the end.
    fn frame(&mut self, at: Duration, sent: bool, bytes: &[u8]);

    /// There is no frame to write at `now`, wall time since 1970. It is called every few
    /// milliseconds while that is so.
    fn idle(&mut self, _now: Duration) {}

    /// Writes the rest. Returns the first error.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

/// Hands frames to a thread that writes them. A frame that finds the queue full is dropped and
/// counted.
#[derive(Debug)]
pub struct Recorder {
    records: SyncSender<Record>,
    writer: JoinHandle<Box<dyn Sink>>,
    /// Wall time less host time, ns, when the recorder was made.
    wall: i64,
    dropped: u64,
}

/// One frame with room for all its bytes, so that nothing is allocated.
struct Record {
    at: Duration,
    sent: bool,
    len: usize,
    bytes: [u8; FRAME_LEN],
}

impl Recorder {
    /// Starts a thread that writes into `sink`. Call this before the caller asks for real time,
    /// since threads inherit it.
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

    /// Writes the rest. Returns the number of dropped frames, or the first error of the file.
    pub fn finish(self) -> io::Result<u64> {
        drop(self.records);
        let sink = self.writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        sink.finish().map(|()| self.dropped)
    }
}

/// The function of the thread. It polls: the loop would need a system call to wake a waiting
/// thread.
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
