//! The loop: a MainDevice, its interface, and the host's clock.
//!
//! A cycle of one frame takes four system calls: sleep, send, poll, receive. Nothing is allocated
//! once the segment is in operation. All frames of a cycle are sent back to back before any is
//! received.
//!
//! The clock is read where an instant matters: before each frame that is sent, when a frame has
//! come in, and after waiting. In between the last reading serves; anything that becomes due
//! meanwhile is seen in the next step.

use isocat_maindevice::{Application, Config, Event, FRAME_LEN, MainDevice};
use isocat_wire::time::{Host, Nanos, Time};

use crate::{Figures, Link, LinkError, RawSocket, Recorder, Waiting, clock};

/// A MainDevice on an interface, and its application.
pub struct Exchange<A> {
    work: Work,
    application: A,
}

/// All but the application: code that is the same for every application.
struct Work {
    main: MainDevice,
    link: Link,
    outgoing: Box<[u8; FRAME_LEN]>,
    /// The last reading of the clock.
    now: Time<Host>,
    /// Number of cycles begun when the last frame was sent.
    begun: u64,
    /// The instant at which the last own frame came back, and the number of cycles begun by then.
    heard: (Time<Host>, u64),
    /// When the MainDevice wants its next input, as of the end of the last step.
    wanted: Option<Time<Host>>,
    /// A caller may have asked something of the MainDevice since the last step.
    asked: bool,
}

impl<A: Application> Exchange<A> {
    /// Begins the start-up of the segment.
    pub fn new(
        config: Config,
        socket: RawSocket,
        waiting: Waiting,
        recorder: Option<Recorder>,
        application: A,
    ) -> Self {
        let (source, jitter) = (config.source, config.host_jitter);
        let now = clock::now();
        let work = Work {
            main: MainDevice::new(config, now),
            link: Link::new(socket, waiting, recorder, source, jitter),
            outgoing: Box::new([0; FRAME_LEN]),
            now,
            begun: 0,
            heard: (now, 0),
            wanted: None,
            asked: true,
        };
        Self { work, application }
    }

    /// Waits for the next event: a frame arrives, frames leave, a cycle is complete, or `limit` is
    /// reached. In operation it goes on to the end of the cycle unless there is an event for the
    /// caller. Returns false if the MainDevice has nothing more to do. Take the events
    /// after each step.
    pub fn step(&mut self, limit: Time<Host>) -> Result<bool, LinkError> {
        self.work.step(limit, &mut self.application)
    }

    /// Takes the next event of the MainDevice.
    #[inline]
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.work.main.poll_event()?;
        self.application.event(&event);
        Some(event)
    }

    /// Whether the MainDevice has an event.
    #[inline]
    pub fn has_event(&self) -> bool {
        self.work.main.has_event()
    }

    /// Starts or ends the measurement of punctuality.
    pub fn measure(&mut self, on: bool) {
        self.work.link.measure(on);
    }

    /// The MainDevice, for requests to it.
    pub fn main_mut(&mut self) -> &mut MainDevice {
        self.work.asked = true;
        &mut self.work.main
    }

    /// The MainDevice.
    #[inline]
    pub fn main(&self) -> &MainDevice {
        &self.work.main
    }

    /// The last reading of the clock: the end of the last step, or an instant in it.
    #[inline]
    pub fn now(&self) -> Time<Host> {
        self.work.now
    }

    /// The interface.
    pub fn socket(&self) -> &RawSocket {
        self.work.link.socket()
    }

    /// The application.
    pub fn application(&self) -> &A {
        &self.application
    }

    /// Figures so far.
    pub fn figures(&self) -> &Figures {
        self.work.link.figures()
    }

    /// Whether frames of several cycles have left since the last frame came back, and that was
    /// longer ago than `span`. A program that was itself stopped has not received anything either,
    /// but it has sent nothing.
    #[inline]
    pub fn is_silent(&self, span: Nanos) -> bool {
        let (at, cycle) = self.work.heard;
        self.work.now - at > span && self.work.begun >= cycle + SILENT_CYCLES
    }

    /// Ends the loop and returns the application and the recorder.
    pub fn into_parts(self) -> (A, Option<Recorder>) {
        (self.application, self.work.link.into_recorder())
    }
}

impl Work {
    /// See [`Exchange::step`].
    fn step(
        &mut self,
        limit: Time<Host>,
        application: &mut dyn Application,
    ) -> Result<bool, LinkError> {
        if std::mem::take(&mut self.asked) {
            self.now = clock::now();
            self.transmit()?;
            self.wanted = self.main.next_timeout();
        } else if self.main.frames_in_flight() > 0 {
            self.now = clock::now();
        }
        let Some(mut wanted) = self.wanted else { return Ok(false) };
        loop {
            // The caller may have taken long, so `now` may be early, and the wait then too short.
            let until = wanted.min(limit).min(self.now + LONGEST_WAIT);
            let expects = self.main.frames_in_flight() > 0;
            let is_cycle = self.main.next_cycle() == Some(until);
            let (arrived, now) = self.link.wait_from(self.now, until, expects, is_cycle)?;
            self.now = now;
            let mut is_complete = false;
            if arrived {
                is_complete = self.receive(application)?;
                self.transmit()?;
                self.wanted = self.main.next_timeout();
                let Some(next) = self.wanted else { return Ok(true) };
                wanted = next;
            }
            if wanted <= self.now {
                self.main.handle_timeout(self.now);
                is_complete |= self.main.poll_cycle(application).is_some();
                self.transmit()?;
                self.wanted = self.main.next_timeout();
                let Some(next) = self.wanted else { return Ok(true) };
                wanted = next;
            }
            if is_complete || !self.is_under_way(limit) {
                return Ok(true);
            }
        }
    }

    /// Whether frames are under way in operation and the caller has nothing to do before they are
    /// back.
    #[inline]
    fn is_under_way(&self, limit: Time<Host>) -> bool {
        self.main.is_operating()
            && self.main.frames_in_flight() > 0
            && !self.main.has_event()
            && self.now < limit
    }

    /// Takes the frames that have arrived, until no more are expected; in operation only the first
    /// one. Returns whether a cycle is complete.
    fn receive(&mut self, application: &mut dyn Application) -> Result<bool, LinkError> {
        let mut is_complete = false;
        for _ in 0..MOST_AT_ONCE {
            // Before the cycle starts, frames are sent as fast as they return.
            let patient = self.main.next_cycle().is_none();
            let Some(arrival) = self.link.receive(patient)? else {
                self.now = clock::now();
                break;
            };
            self.now = arrival.taken;
            if arrival.is_too_late {
                continue;
            }
            let counts = self.main.counts();
            let (received, echoed) = (counts.frames_received, counts.frames_echoed);
            self.main.handle_frame(self.now, self.link.frame(arrival));
            is_complete |= self.main.poll_cycle(application).is_some();
            let counts = self.main.counts();
            if counts.frames_received == received {
                // The frame does not belong to the MainDevice, or came too late.
                let untouched = counts.frames_echoed > echoed;
                self.link.foreign(arrival, untouched);
            } else {
                self.heard = (self.now, self.begun);
                self.link.answered(arrival);
            }
            // The frames of a cycle come one by one: to look for the next one at once would nearly
            // always be in vain. On the way up all answers that are there make fuller frames.
            if self.main.is_operating() || self.main.frames_in_flight() == 0 {
                break;
            }
        }
        Ok(is_complete)
    }

    /// Sends everything that is due. Often that is nothing, so the check alone is a part of the
    /// caller.
    #[inline(always)]
    fn transmit(&mut self) -> Result<(), LinkError> {
        while self.main.has_frame(self.now) {
            if !self.send()? {
                break;
            }
        }
        Ok(())
    }

    /// Sends a frame; `false` if there is none.
    #[inline(never)]
    fn send(&mut self) -> Result<bool, LinkError> {
        let due = self.main.next_cycle();
        self.now = clock::now();
        let Some(len) = self.main.poll_transmit(self.now, &mut self.outgoing[..]) else {
            return Ok(false);
        };
        self.link.send(self.now, &self.outgoing[..len], due.is_none())?;
        let begun = self.main.counts().cycles;
        if begun != self.begun {
            self.begun = begun;
            if let Some(due) = due {
                self.link.begin_cycle(self.now, due);
            }
        }
        Ok(true)
    }
}

/// Longest wait between two checks: a signal may be delivered to another thread.
const LONGEST_WAIT: Nanos = Nanos::millis(50);
/// Largest number of frames taken before the loop sends again, so that a flood cannot block
/// sending.
const MOST_AT_ONCE: usize = 64;
/// This many cycles without an answer are not an accident.
const SILENT_CYCLES: u64 = 5;
