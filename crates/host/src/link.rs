//! An interface as a real-time loop uses it: frames out and in, waiting, the recorder, and how punctual all that was.

use isocat_maindevice::FRAME_LEN;
use isocat_wire::frame::{self, LOCALLY_ADMINISTERED};
use isocat_wire::time::{Host, Nanos, Time};

use crate::{Histogram, LinkError, RawSocket, Recorder, clock};

/// How to wait for the beginning of a cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Waiting {
    /// Sleep, and spin on the clock for this long before the instant: as long as the machine takes to wake.
    Sleep {
        /// Time to spin; 0 is right where wake-ups are.
        lead: Nanos,
    },
    /// Never sleep.
    Busy,
}

impl Waiting {
    /// Sleeps with a lead in which 99 % of these wake-ups have come, though no longer than a tenth of the
    /// cycle, which other programs want to have too.
    pub fn sleep(wake_ups: &Histogram, cycle: Nanos) -> Self {
        Self::Sleep { lead: wake_ups.percentile(99).min(Nanos(cycle.0 / 10)).min(MOST_LEAD) }
    }
}

/// How punctual the machine was, and whom it heard.
#[derive(Clone, Copy, Debug, Default)]
pub struct Figures {
    /// When the first frame of a cycle was handed to the kernel, less when it should have been.
    pub lateness: Histogram,
    /// How many of these are beyond what the plan keeps free for them.
    pub beyond_jitter: u64,
    /// From handing a frame to the kernel until the kernel had it back from the driver.
    pub round_trip: Histogram,
    /// Frames that came back after the next of their index had left.
    pub too_late: u64,
    /// EtherCAT frames with another source address than ours.
    pub other_talkers: u64,
    /// The source address of the first of them.
    pub other_talker: Option<[u8; 6]>,
    /// Frames of ours that came back without having passed a SubDevice.
    pub unprocessed: u64,
}

/// An open interface in a loop.
///
/// - [`wait`](Self::wait) for an instant or a frame.
/// - [`send`](Self::send); [`begin_cycle`](Self::begin_cycle) with the first frame of a cycle.
/// - [`receive`](Self::receive), then [`answered`](Self::answered) for what was an answer, or
///   [`foreign`](Self::foreign) for what was none.
#[derive(Debug)]
pub struct Link {
    socket: RawSocket,
    recorder: Option<Recorder>,
    waiting: Waiting,
    /// Source address of our frames.
    source: [u8; 6],
    /// Lateness that the plan keeps free.
    jitter: Nanos,
    figures: Figures,
    /// Figures of punctuality are taken.
    measuring: bool,
    /// When the frame that carries an index was sent; a frame's first datagram names it.
    sent: [Option<Time<Host>>; 256],
    incoming: Box<[u8; FRAME_LEN]>,
}

/// A frame that came in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Arrival {
    /// When the kernel took it from the driver.
    pub at: Time<Host>,
    /// It was there before the frame whose index it carries was sent: an answer of two cycles ago, which must not be
    /// taken for that of this one.
    pub is_too_late: bool,
    len: usize,
    index: Option<u8>,
}

impl Link {
    /// Takes an open interface. `source` is the address that our frames come from, `jitter` the lateness that the plan
    /// keeps free.
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

    /// Begins or ends the time in which punctuality is measured.
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

    /// Waits until an instant or a frame; tells whether a frame may be there. `expects`: a frame is under way, else none is
    /// waited for. `is_cycle`: the instant is the beginning of a cycle.
    pub fn wait(
        &mut self,
        until: Time<Host>,
        expects: bool,
        is_cycle: bool,
    ) -> Result<bool, LinkError> {
        let lead = match self.waiting {
            // With frames under way the socket is asked again and again, by `receive` itself.
            Waiting::Busy if expects => return Ok(true),
            Waiting::Busy => {
                spin(until);
                return Ok(false);
            }
            Waiting::Sleep { lead } if is_cycle => lead,
            Waiting::Sleep { .. } => Nanos::ZERO,
        };
        let asleep = until + Nanos(-lead.0);
        if clock::now() < asleep {
            if !expects {
                clock::sleep_until(asleep);
            } else if self.socket.wait(Some(asleep))? {
                return Ok(true);
            }
            // A signal may have ended it early.
            if clock::now() < asleep {
                return Ok(false);
            }
        }
        spin(until);
        // What came meanwhile is taken behind the frames that are due now.
        Ok(false)
    }

    /// Sends a frame at `now`. `patient`: there is no cycle to keep, and the recorder may take its time.
    pub fn send(&mut self, now: Time<Host>, bytes: &[u8], patient: bool) -> Result<(), LinkError> {
        self.socket.send(bytes)?;
        if let Some(recorder) = &mut self.recorder {
            recorder.frame(now, true, bytes, patient);
        }
        if let Some(index) = index(bytes) {
            self.sent[usize::from(index)] = Some(now);
        }
        Ok(())
    }

    /// The first frame of a cycle that was due at `due` was sent at `now`.
    pub fn begin_cycle(&mut self, now: Time<Host>, due: Time<Host>) {
        if self.measuring {
            self.figures.lateness.add(now - due);
            self.figures.beyond_jitter += u64::from(now - due > self.jitter);
        }
    }

    /// Takes a frame, if one is there; [`frame`](Self::frame) has its bytes until the next one.
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
        Ok(Some(Arrival { at: received.at, is_too_late, len, index }))
    }

    /// The bytes of the last frame that came in.
    pub fn frame(&self, arrival: Arrival) -> &[u8] {
        &self.incoming[..arrival.len]
    }

    /// The frame was the answer to one of ours.
    pub fn answered(&mut self, arrival: Arrival) {
        let Some(index) = arrival.index else { return };
        if let Some(sent) = self.sent[usize::from(index)].take()
            && self.measuring
        {
            self.figures.round_trip.add(arrival.at - sent);
        }
    }

    /// The frame was no answer: looks at who sent it. `untouched`: it is one of ours as it had left.
    pub fn foreign(&mut self, arrival: Arrival, untouched: bool) {
        let Some(address) = self.source_of(arrival) else { return };
        if unmarked(address) != unmarked(self.source) {
            self.figures.other_talkers += 1;
            self.figures.other_talker.get_or_insert(address);
        } else {
            self.figures.unprocessed += u64::from(untouched);
        }
    }

    /// The source address of the last frame that came in. The first ESC that a frame passes marks it as locally
    /// administered.
    pub fn source_of(&self, arrival: Arrival) -> Option<[u8; 6]> {
        self.frame(arrival).get(6..).and_then(|rest| rest.first_chunk::<6>()).copied()
    }
}

/// The index that a frame's first datagram carries.
fn index(bytes: &[u8]) -> Option<u8> {
    frame::payload(bytes).ok()?.get(1).copied()
}

/// The address as it left the MainDevice.
pub fn unmarked(mut address: [u8; 6]) -> [u8; 6] {
    address[0] &= !LOCALLY_ADMINISTERED;
    address
}

/// Never inlined, so that a profile tells this from work.
#[inline(never)]
fn spin(until: Time<Host>) {
    while clock::now() < until {
        std::hint::spin_loop();
    }
}

/// The longest lead: a machine that needs more is late now and then.
const MOST_LEAD: Nanos = Nanos::micros(200);
