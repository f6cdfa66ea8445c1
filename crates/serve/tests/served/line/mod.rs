//! The core of the served segment without sockets, with an external MainDevice, in virtual time.
#![allow(dead_code, reason = "each test uses its part")]

use std::collections::VecDeque;

use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice, Port};
use isocat_serve::{Answer, Server, Setup};
use isocat_sim::MainPort;
use isocat_sim::bench::is_cyclic;
use isocat_wire::time::{Host, Nanos, Time};

/// An external MainDevice and the segment, in a time that moves only when both wait.
pub struct Line {
    pub server: Server,
    pub main: MainDevice,
    pub now: Time<Host>,
    /// The last cyclic frame that was sent.
    pub cyclic: Vec<u8>,
    /// Answers under way: the instant at which the last bit is back, and the port.
    back: VecDeque<(Time<Host>, Port, Vec<u8>)>,
}

impl Line {
    pub fn new(setup: impl Into<Setup>) -> Self {
        Self::with(setup, Config::new(Nanos::millis(1)))
    }

    /// With a MainDevice of this config.
    pub fn with(setup: impl Into<Setup>, config: Config) -> Self {
        let now = Time::new(5_000_000_000);
        let (server, main) = (Server::new(setup, now), MainDevice::new(config, now));
        Self { server, main, now, cyclic: Vec::new(), back: VecDeque::new() }
    }

    /// Runs until `done` or for `span`. Returns whether `done` was met.
    pub fn run(&mut self, span: Nanos, mut done: impl FnMut(&Event) -> bool) -> bool {
        let end = self.now + span;
        loop {
            let mut buffer = [0; FRAME_LEN];
            while let Some(len) = self.main.poll_transmit(self.now, &mut buffer) {
                let bytes = buffer[..len].to_vec();
                if is_cyclic(&bytes) {
                    self.cyclic.clone_from(&bytes);
                }
                self.send(MainPort::Primary, bytes);
                while let Some(len) = self.main.poll_secondary(&mut buffer) {
                    self.send(MainPort::Secondary, buffer[..len].to_vec());
                }
            }
            while let Some(event) = self.main.poll_event() {
                if done(&event) {
                    return true;
                }
            }
            let wanted = self.main.next_timeout().unwrap_or(Time::NEVER);
            match self.back.front() {
                Some((at, ..)) if *at <= wanted => {
                    let (at, port, bytes) = self.back.pop_front().expect("it is there");
                    self.now = self.now.max(at);
                    self.main.handle_frame_at(port, self.now, &bytes);
                }
                _ if wanted > end => {
                    self.now = end;
                    self.server.idle(end);
                    return false;
                }
                _ => {
                    self.now = self.now.max(wanted);
                    self.main.handle_timeout(self.now);
                }
            }
        }
    }

    fn send(&mut self, from: MainPort, mut bytes: Vec<u8>) {
        let answer = self.server.frame_at(from, self.now, &mut bytes);
        if let Answer::Back { port, last_bit, .. } = answer {
            assert!(last_bit > self.now, "no wire is faster than light");
            let port = match port {
                MainPort::Primary => Port::Primary,
                MainPort::Secondary => Port::Secondary,
            };
            // Answers at the two ports of a ring may overtake each other.
            let place = self.back.partition_point(|(other, ..)| *other <= last_bit);
            let overtaken = self.back.iter().skip(place).all(|(_, other, _)| *other != port);
            assert!(overtaken, "answers come back in the order of their frames");
            self.back.insert(place, (last_bit, port, bytes.clone()));
        }
        self.server.after(&bytes);
    }

    pub fn bring_up(&mut self) {
        let up = self.run(Nanos::millis(20_000), |event| {
            assert!(!matches!(event, Event::Failed(_)), "{event:?}");
            matches!(event, Event::InOperation { .. })
        });
        assert!(up, "it comes into operation");
    }
}
