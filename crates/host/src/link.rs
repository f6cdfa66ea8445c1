//! An interface as a real-time loop uses it: it sends, receives, waits and records frames, and
//! measures its punctuality.

use isocat_maindevice::FRAME_LEN;
use isocat_wire::frame::{self, LOCALLY_ADMINISTERED};
use isocat_wire::time::{Host, Nanos, Time};

use crate::{Histogram, LinkError, RawSocket, Received, Recorder, clock};

/// How to wait for the beginning of a cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Waiting {
    /// Sleep, and spin on the clock for this long before the instant. The lead should be the time
    /// that the machine takes to wake.
    Sleep {
        /// Time to spin; 0 if wake-ups are punctual.
        lead: Nanos,
    },
    /// Never sleep.
    Busy,
}

impl Waiting {
    /// Sleeps with a lead that covers 99 % of these wake-ups. The lead is at most a tenth of the
    /// cycle, since other programs need the CPU too.
    pub fn sleep(wake_ups: &Histogram, cycle: Nanos) -> Self {
        Self::Sleep { lead: wake_ups.percentile(99).min(Nanos(cycle.0 / 10)).min(MOST_LEAD) }
    }
}

/// Punctuality of the machine, and other senders on the interface.
#[derive(Clone, Copy, Debug, Default)]
pub struct Figures {
    /// The instant at which the first frame of a cycle was handed to the kernel, less its due time.
    pub lateness: Histogram,
    /// Number of cycles whose lateness exceeds the plan's jitter.
    pub beyond_jitter: u64,
    /// Time from handing a frame to the kernel until the kernel received it from the driver.
    pub round_trip: Histogram,
    /// Frames that came back after the next frame with the same index had left.
    pub too_late: u64,
    /// EtherCAT frames with another source address than our own.
    pub other_talkers: u64,
    /// The source address of the first of them.
    pub other_talker: Option<[u8; 6]>,
    /// Own frames that came back without having passed a SubDevice.
    pub unprocessed: u64,
}

/// An open interface in a real-time loop.
///
/// - [`wait`](Self::wait) for an instant or a frame.
/// - [`send`](Self::send); [`begin_cycle`](Self::begin_cycle) with the first frame of a cycle.
/// - [`receive`](Self::receive), then [`answered`](Self::answered) for an answer, or
///   [`foreign`](Self::foreign) for any other frame.
#[derive(Debug)]
pub struct Link {
    socket: RawSocket,
    recorder: Option<Recorder>,
    waiting: Waiting,
    /// Source address of our own frames.
    source: [u8; 6],
    /// Lateness that the plan allows.
    jitter: Nanos,
    figures: Figures,
    /// Whether punctuality is being measured.
    measuring: bool,
    /// The instant at which the frame with each index was sent; the first datagram of a frame names
    /// the index.
    sent: [Option<Time<Host>>; 256],
    incoming: Box<[u8; FRAME_LEN]>,
}

/// A frame that came in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Arrival {
    /// The instant at which the kernel took it from the driver.
    pub at: Time<Host>,
    /// The instant at which it was taken from the kernel.
    pub taken: Time<Host>,
    /// It arrived before the frame with the same index was sent. It is an answer of an earlier
    /// cycle and must not be taken for the present one's.
    pub is_too_late: bool,
    len: usize,
    index: Option<u8>,
}

impl Link {
    /// Uses an open interface. `source` is the address of our own frames, `jitter` the lateness
    /// that the plan allows.
    pub fn new(
        socket: RawSocket,
        waiting: Waiting,
        recorder: Option<Recorder>,
        source: [u8; 6],
        jitter: Nanos,
    ) -> Self {
        Self {
            socket,
            recorder,
            waiting,
            source,
            jitter,
            figures: Figures::default(),
            measuring: false,
            sent: [None; 256],
            incoming: Box::new([0; FRAME_LEN]),
        }
    }

    /// Starts or ends the measurement of punctuality.
    pub fn measure(&mut self, on: bool) {
        self.measuring = on;
    }

    /// The interface.
    pub fn socket(&self) -> &RawSocket {
        &self.socket
    }

    /// Figures so far.
    pub fn figures(&self) -> &Figures {
        &self.figures
    }

    /// The recorder, to be finished.
    pub fn into_recorder(self) -> Option<Recorder> {
        self.recorder
    }

    /// Waits until an instant or a frame. Returns whether a frame may have arrived. `expects`: a
    /// frame is under way; otherwise none is awaited. `is_cycle`: the instant is the start of a
    /// cycle.
    pub fn wait(
        &mut self,
        until: Time<Host>,
        expects: bool,
        is_cycle: bool,
    ) -> Result<bool, LinkError> {
        self.wait_from(clock::now(), until, expects, is_cycle).map(|(arrived, _)| arrived)
    }

    /// The same for a caller that has read the clock at `now`, less than 100 us ago. Returns also
    /// the last reading; it is not new if a frame may have arrived.
    pub fn wait_from(
        &mut self,
        now: Time<Host>,
        until: Time<Host>,
        expects: bool,
        is_cycle: bool,
    ) -> Result<(bool, Time<Host>), LinkError> {
        let lead = match self.waiting {
            // With frames under way `receive` itself polls the socket.
            Waiting::Busy if expects => return Ok((true, now)),
            Waiting::Busy => return Ok((false, spin(now, until))),
            Waiting::Sleep { lead } if is_cycle => lead,
            Waiting::Sleep { .. } => Nanos::ZERO,
        };
        let asleep = until + Nanos(-lead.0);
        let mut now = now;
        if now < asleep {
            if !expects {
                clock::sleep_until(asleep);
            } else if self.wait_for_frame(now, asleep)? {
                return Ok((true, now));
            }
            // A signal may have ended the sleep early.
            now = clock::now();
            if now < asleep {
                return Ok((false, now));
            }
        }
        // Frames that arrived meanwhile are taken after those that are due now are sent.
        Ok((false, spin(now, until)))
    }

    /// Waits for a frame; returns whether one may have arrived.
    #[inline]
    fn wait_for_frame(&self, now: Time<Host>, until: Time<Host>) -> Result<bool, LinkError> {
        let span = until - now;
        // The clock shows more than `now` by the time that it took to send frames. A wait that
        // ends too early by more than that needs no other reading, and nearly always a frame ends
        // it.
        let is_long = span.0 > 2 * EARLIER.0;
        if is_long && self.socket.wait_for(Some(span - EARLIER))? {
            return Ok(true);
        }
        self.socket.wait(Some(until))
    }

    /// Sends a frame at `now`. `patient`: there is no cycle yet, so the recorder may block.
    pub fn send(&mut self, now: Time<Host>, bytes: &[u8], patient: bool) -> Result<(), LinkError> {
        self.socket.send(bytes)?;
        if let Some(recorder) = &mut self.recorder {
            recorder.frame(now, true, bytes, patient);
        }
        if let Some(index) = index_of_own(bytes) {
            self.sent[usize::from(index)] = Some(now);
        }
        Ok(())
    }

    /// Notes that the first frame of a cycle that was due at `due` was sent at `now`.
    pub fn begin_cycle(&mut self, now: Time<Host>, due: Time<Host>) {
        if self.measuring {
            self.figures.lateness.add(now - due);
            self.figures.beyond_jitter += u64::from(now - due > self.jitter);
        }
    }

    /// Takes a frame if one has arrived; [`frame`](Self::frame) has its bytes until the next one.
    pub fn receive(&mut self, patient: bool) -> Result<Option<Arrival>, LinkError> {
        let Some(received) = self.socket.receive(&mut self.incoming[..])? else { return Ok(None) };
        let len = received.len.min(FRAME_LEN);
        if let Some(recorder) = &mut self.recorder {
            recorder.frame(received.at, false, &self.incoming[..len], patient);
        }
        let index = index(&self.incoming[..len]);
        let sent = index.and_then(|index| self.sent[usize::from(index)]);
        let is_too_late = sent.is_some_and(|sent| received.at < sent);
        self.figures.too_late += u64::from(is_too_late);
        let Received { at, taken, .. } = received;
        Ok(Some(Arrival { at, taken, is_too_late, len, index }))
    }

    /// The bytes of the last frame that came in.
    pub fn frame(&self, arrival: Arrival) -> &[u8] {
        &self.incoming[..arrival.len]
    }

    /// Notes that the frame is the answer to one of ours.
    pub fn answered(&mut self, arrival: Arrival) {
        let Some(index) = arrival.index else { return };
        if let Some(sent) = self.sent[usize::from(index)].take()
            && self.measuring
        {
            self.figures.round_trip.add(arrival.at - sent);
        }
    }

    /// Notes that the frame is not an answer, and checks who sent it. `untouched`: it is one of
    /// ours, unchanged.
    pub fn foreign(&mut self, arrival: Arrival, untouched: bool) {
        let Some(address) = self.source_of(arrival) else { return };
        if unmarked(address) != unmarked(self.source) {
            self.figures.other_talkers += 1;
            self.figures.other_talker.get_or_insert(address);
        } else {
            self.figures.unprocessed += u64::from(untouched);
        }
    }

    /// The source address of the last frame that came in. The first ESC that a frame passes marks
    /// it as locally administered.
    pub fn source_of(&self, arrival: Arrival) -> Option<[u8; 6]> {
        self.frame(arrival).get(6..).and_then(|rest| rest.first_chunk::<6>()).copied()
    }
}

/// The index that a frame's first datagram carries.
fn index(bytes: &[u8]) -> Option<u8> {
    frame::payload(bytes).ok()?.get(1).copied()
}

/// The same of a frame that is whole.
#[inline]
fn index_of_own(bytes: &[u8]) -> Option<u8> {
    bytes.get(frame::payload_offset(bytes).ok()? + 1).copied()
}

/// The address as it was when the frame left the MainDevice.
pub fn unmarked(mut address: [u8; 6]) -> [u8; 6] {
    address[0] &= !LOCALLY_ADMINISTERED;
    address
}

/// Spins from `now` until an instant; returns the last reading of the clock. It is never inlined,
/// so that a profile separates it from work.
#[inline(never)]
fn spin(mut now: Time<Host>, until: Time<Host>) -> Time<Host> {
    while now < until {
        std::hint::spin_loop();
        now = clock::now();
    }
    now
}

/// How much earlier a long wait for a frame ends than it must.
const EARLIER: Nanos = Nanos::micros(100);
/// The longest lead: a machine that needs a longer one is sometimes late.
const MOST_LEAD: Nanos = Nanos::micros(200);
