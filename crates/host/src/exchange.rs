//! The loop: a MainDevice, its interface, and the host's clock.
//!
//! A cycle of one frame takes four system calls: sleep, send, poll, receive. Nothing is allocated
//! once the segment is in operation. All frames of a cycle are sent back to back before any is
//! received.

use isocat_maindevice::{Application, Config, Event, FRAME_LEN, MainDevice, Port, Runner};
use isocat_wire::time::{Host, Nanos, Time};

use crate::{Figures, Link, LinkError, RawSocket, Recorder, Waiting, clock};

/// A MainDevice on an interface, and its application.
pub struct Exchange<A> {
    runner: Runner<A>,
    link: Link,
    outgoing: Box<[u8; FRAME_LEN]>,
    /// Number of cycles begun when the last frame was sent.
    begun: u64,
    /// The instant at which the last own frame came back, and the number of cycles begun by then.
    heard: (Time<Host>, u64),
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
        Self {
            runner: Runner::new(MainDevice::new(config, now), application),
            link: Link::new(socket, waiting, recorder, source, jitter),
            outgoing: Box::new([0; FRAME_LEN]),
            begun: 0,
            heard: (now, 0),
            asked: true,
        }
    }

    /// Waits for the next event: a frame arrives, frames leave, or `limit` is reached. Returns
    /// false if the MainDevice has nothing more to do. Take the events after each step.
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

    /// Starts or ends the measurement of punctuality.
    pub fn measure(&mut self, on: bool) {
        self.link.measure(on);
    }

    /// The MainDevice, for requests to it.
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
        self.link.socket()
    }

    /// The application.
    pub fn application(&self) -> &A {
        self.runner.application()
    }

    /// Figures so far.
    pub fn figures(&self) -> &Figures {
        self.link.figures()
    }

    /// Whether frames of several cycles have left since the last frame came back, and that was
    /// longer ago than `span`. A program that was itself stopped has not received anything either,
    /// but it has sent nothing.
    pub fn is_silent(&self, span: Nanos) -> bool {
        let (at, cycle) = self.heard;
        clock::now() - at > span && self.begun >= cycle + SILENT_CYCLES
    }

    /// Ends the loop and returns the application and the recorder.
    pub fn into_parts(self) -> (A, Option<Recorder>) {
        (self.runner.into_parts().1, self.link.into_recorder())
    }

    /// Waits until an instant or a frame. Returns whether a frame may have arrived.
    fn wait(&mut self, until: Time<Host>) -> Result<bool, LinkError> {
        let expects = self.main().frames_in_flight() > 0;
        let is_cycle = self.main().next_cycle() == Some(until);
        self.link.wait(until, expects, is_cycle)
    }

    /// Takes the frames that have arrived, until no more are expected.
    fn receive(&mut self) -> Result<(), LinkError> {
        for _ in 0..MOST_AT_ONCE {
            // Before the cycle starts, frames are sent as fast as they return.
            let patient = self.main().next_cycle().is_none();
            let Some(arrival) = self.link.receive(patient)? else { break };
            if arrival.is_too_late {
                continue;
            }
            let before = self.main().statistics();
            let now = clock::now();
            self.runner.handle_frame(Port::Primary, now, self.link.frame(arrival));
            let after = self.main().statistics();
            if after.frames_received == before.frames_received {
                // The frame does not belong to the MainDevice, or came too late.
                self.link.foreign(arrival, after.frames_echoed > before.frames_echoed);
            } else {
                self.heard = (now, self.begun);
                self.link.answered(arrival);
            }
            if self.main().frames_in_flight() == 0 {
                break;
            }
        }
        Ok(())
    }

    /// Sends everything that is due now.
    fn transmit(&mut self) -> Result<(), LinkError> {
        loop {
            let due = self.main().next_cycle();
            let now = clock::now();
            let Some(len) = self.runner.poll_transmit(now, &mut self.outgoing[..]) else {
                return Ok(());
            };
            self.link.send(now, &self.outgoing[..len], due.is_none())?;
            let begun = self.main().statistics().cycles;
            if begun != self.begun {
                self.begun = begun;
                if let Some(due) = due {
                    self.link.begin_cycle(now, due);
                }
            }
        }
    }
}

/// Longest wait between two checks: a signal may be delivered to another thread.
const LONGEST_WAIT: Nanos = Nanos::millis(50);
/// Largest number of frames taken before the loop sends again, so that a flood cannot block
/// sending.
const MOST_AT_ONCE: usize = 64;
/// This many cycles without an answer are not an accident.
const SILENT_CYCLES: u64 = 5;
