//! The loop: a MainDevice, its interface, and the host's clock.
//!
//! In a cycle of one frame there are four system calls: sleep, send, poll, receive. Nothing is allocated once
//! the segment is in operation. Frames of a cycle are sent back to back before anything is received.

use isocat_maindevice::{Application, Config, Event, FRAME_LEN, MainDevice, Port, Runner};
use isocat_wire::frame::{self, LOCALLY_ADMINISTERED};
use isocat_wire::time::{Host, Nanos, Time};

use crate::{Histogram, LinkError, RawSocket, Recorder, clock};

/// A MainDevice on an interface, and its application.
pub struct Exchange<A> {
    runner: Runner<A>,
    socket: RawSocket,
    recorder: Option<Recorder>,
    waiting: Waiting,
    source: [u8; 6],
    jitter: Nanos,
    figures: Figures,
    /// Figures of punctuality are taken.
    measuring: bool,
    /// When the frame that carries an index was sent; a frame's first datagram names it.
    sent: [Option<Time<Host>>; 256],
    outgoing: Box<[u8; FRAME_LEN]>,
    incoming: Box<[u8; FRAME_LEN]>,
    /// Cycles begun, as of the last frame sent.
    begun: u64,
    /// When the last frame of ours came back, and how many cycles had begun then.
    heard: (Time<Host>, u64),
    /// Somebody may have asked something of the MainDevice since the last step.
    asked: bool,
}

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

impl<A: Application> Exchange<A> {
    /// Begins the way up.
    pub fn new(
        config: Config,
        socket: RawSocket,
        waiting: Waiting,
        recorder: Option<Recorder>,
        application: A,
    ) -> Self {
        let (source, jitter) = (config.source, config.host_jitter);
        let now = clock::now();
        Self {
            runner: Runner::new(MainDevice::new(config, now), application),
            socket,
            recorder,
            waiting,
            source,
            jitter,
            figures: Figures::default(),
            measuring: false,
            sent: [None; 256],
            outgoing: Box::new([0; FRAME_LEN]),
            incoming: Box::new([0; FRAME_LEN]),
            begun: 0,
            heard: (now, 0),
            asked: true,
        }
    }

    /// Lets the next thing happen: a frame comes, frames leave, or `limit` is reached. False if the
    /// MainDevice has nothing more to do; events are to be taken after each step.
    pub fn step(&mut self, limit: Time<Host>) -> Result<bool, LinkError> {
        if std::mem::take(&mut self.asked) {
            self.transmit()?;
        }
        let until = match self.runner.next_timeout() {
            Some(wanted) => wanted.min(limit).min(clock::now() + LONGEST_WAIT),
            None => return Ok(false),
        };
        if self.wait(until)? {
            self.receive()?;
            self.transmit()?;
        }
        let now = clock::now();
        if self.runner.next_timeout().is_some_and(|wanted| wanted <= now) {
            self.runner.handle_timeout(now);
            self.transmit()?;
        }
        Ok(true)
    }

    /// Takes the next event of the MainDevice.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.runner.poll_event()
    }

    /// Begins or ends the time in which punctuality is measured.
    pub fn measure(&mut self, on: bool) {
        self.measuring = on;
    }

    /// The MainDevice, to ask something of it.
    pub fn main_mut(&mut self) -> &mut MainDevice {
        self.asked = true;
        self.runner.main_mut()
    }

    /// The MainDevice.
    pub fn main(&self) -> &MainDevice {
        self.runner.main()
    }

    /// The interface.
    pub fn socket(&self) -> &RawSocket {
        &self.socket
    }

    /// The application.
    pub fn application(&self) -> &A {
        self.runner.application()
    }

    /// Figures so far.
    pub fn figures(&self) -> &Figures {
        &self.figures
    }

    /// Whether frames of some cycles left since the last one came back, and that was longer ago than
    /// `span`. A program that was stopped itself has heard nothing either, but sent nothing.
    pub fn is_silent(&self, span: Nanos) -> bool {
        let (at, cycle) = self.heard;
        clock::now() - at > span && self.begun >= cycle + SILENT_CYCLES
    }

    /// The end: the application and the recorder are given back.
    pub fn into_parts(self) -> (A, Option<Recorder>) {
        (self.runner.into_parts().1, self.recorder)
    }

    /// Waits until an instant or a frame; tells whether a frame may be there.
    fn wait(&mut self, until: Time<Host>) -> Result<bool, LinkError> {
        let expects = self.main().frames_in_flight() > 0;
        let lead = match self.waiting {
            // With frames under way the socket is asked again and again, by `receive` itself.
            Waiting::Busy if expects => return Ok(true),
            Waiting::Busy => {
                spin(until);
                return Ok(false);
            }
            Waiting::Sleep { lead } if self.main().next_cycle() == Some(until) => lead,
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

    /// Takes what is there, until nothing more is expected.
    fn receive(&mut self) -> Result<(), LinkError> {
        for _ in 0..MOST_AT_ONCE {
            let Some(received) = self.socket.receive(&mut self.incoming[..])? else { break };
            let len = received.len.min(FRAME_LEN);
            if let Some(recorder) = &mut self.recorder {
                // Before there is a cycle to keep, the frames come as fast as they go.
                let patient = self.runner.main().next_cycle().is_none();
                recorder.frame(received.at, false, &self.incoming[..len], patient);
            }
            let index = frame::payload(&self.incoming[..len]).ok().and_then(|p| p.get(1)).copied();
            let sent = index.and_then(|index| self.sent[usize::from(index)]);
            if sent.is_some_and(|sent| received.at < sent) {
                // It was there before the frame whose index it carries: an answer of two cycles ago, which
                // must not be taken for that of this one.
                self.figures.too_late += 1;
                continue;
            }
            let before = self.main().statistics();
            let now = clock::now();
            self.runner.handle_frame(Port::Primary, now, &self.incoming[..len]);
            if self.main().statistics().frames_received == before.frames_received {
                self.take_foreign(len, before.frames_echoed);
            } else {
                self.heard = (now, self.begun);
                if let (Some(index), Some(sent)) = (index, sent) {
                    self.sent[usize::from(index)] = None;
                    if self.measuring {
                        self.figures.round_trip.add(received.at - sent);
                    }
                }
            }
            if self.main().frames_in_flight() == 0 {
                break;
            }
        }
        Ok(())
    }

    /// Sends everything that is to leave now.
    fn transmit(&mut self) -> Result<(), LinkError> {
        loop {
            let due = self.main().next_cycle();
            let now = clock::now();
            let Some(len) = self.runner.poll_transmit(now, &mut self.outgoing[..]) else {
                return Ok(());
            };
            let bytes = &self.outgoing[..len];
            self.socket.send(bytes)?;
            if let Some(recorder) = &mut self.recorder {
                recorder.frame(now, true, bytes, due.is_none());
            }
            if let Some(index) = frame::payload(bytes).ok().and_then(|payload| payload.get(1)) {
                self.sent[usize::from(*index)] = Some(now);
            }
            let begun = self.main().statistics().cycles;
            if begun != self.begun {
                self.begun = begun;
                if let Some(due) = due.filter(|_| self.measuring) {
                    self.figures.lateness.add(now - due);
                    self.figures.beyond_jitter += u64::from(now - due > self.jitter);
                }
            }
        }
    }

    /// Looks at who sent a frame that is none of the MainDevice's, or came too late. `echoed`: the count of frames that
    /// came back untouched, before this one.
    fn take_foreign(&mut self, len: usize, echoed: u64) {
        let Some(&address) = self.incoming[..len].get(6..).and_then(|rest| rest.first_chunk::<6>())
        else {
            return;
        };
        let unmarked = |mut address: [u8; 6]| {
            address[0] &= !LOCALLY_ADMINISTERED;
            address
        };
        if unmarked(address) != unmarked(self.source) {
            self.figures.other_talkers += 1;
            self.figures.other_talker.get_or_insert(address);
        } else {
            self.figures.unprocessed += self.main().statistics().frames_echoed - echoed;
        }
    }
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
/// A signal may come to another thread; so often the loop looks.
const LONGEST_WAIT: Nanos = Nanos::millis(50);
/// Frames taken before it is time to look whether some are to leave: nobody can talk us down.
const MOST_AT_ONCE: usize = 64;
/// So many cycles without an answer are no accident.
const SILENT_CYCLES: u64 = 5;
