//! The core of the served segment without sockets, with a MainDevice that is none of the
//! simulation's, in virtual time.
#![allow(dead_code, reason = "each test uses its part")]

use std::collections::VecDeque;

use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
use isocat_serve::{Answer, Server, Setup};
use isocat_sim::bench::is_cyclic;
use isocat_wire::time::{Host, Nanos, Time};

/// Somebody's MainDevice and the segment, in a time that moves only when both wait.
pub struct Line {
    pub server: Server,
    pub main: MainDevice,
    pub now: Time<Host>,
    /// The cyclic frame that was sent last.
    pub cyclic: Vec<u8>,
    /// Answers under way: when their last bit is back.
    back: VecDeque<(Time<Host>, Vec<u8>)>,
}

impl Line {
    pub fn new(setup: impl Into<Setup>) -> Self {
        Self::with(setup, Config::new(Nanos::millis(1)))
    }

    /// With a MainDevice that is set up so.
    pub fn with(setup: impl Into<Setup>, config: Config) -> Self {
        let now = Time::new(5_000_000_000);
        let (server, main) = (Server::new(setup, now), MainDevice::new(config, now));
        Self { server, main, now, cyclic: Vec::new(), back: VecDeque::new() }
    }

    /// Until `done` or for `span`; whether it was done.
    pub fn run(&mut self, span: Nanos, mut done: impl FnMut(&Event) -> bool) -> bool {
        let end = self.now + span;
        loop {
            let mut buffer = [0; FRAME_LEN];
            while let Some(len) = self.main.poll_transmit(self.now, &mut buffer) {
                let mut bytes = buffer[..len].to_vec();
                if is_cyclic(&bytes) {
                    self.cyclic.clone_from(&bytes);
                }
                if let Answer::Back { last_bit, .. } = self.server.frame(self.now, &mut bytes) {
                    assert!(last_bit > self.now, "no wire is faster than light");
                    let behind = self.back.back().is_none_or(|(before, _)| *before < last_bit);
                    assert!(behind, "answers come back in the order of their frames");
                    self.back.push_back((last_bit, bytes.clone()));
                }
                self.server.after(&bytes);
            }
            while let Some(event) = self.main.poll_event() {
                if done(&event) {
                    return true;
                }
            }
            let wanted = self.main.next_timeout().unwrap_or(Time::NEVER);
            match self.back.front() {
                Some((at, _)) if *at <= wanted => {
                    let (at, bytes) = self.back.pop_front().expect("it is there");
                    self.now = self.now.max(at);
                    self.main.handle_frame(self.now, &bytes);
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

    pub fn bring_up(&mut self) {
        let up = self.run(Nanos::millis(20_000), |event| {
            assert!(!matches!(event, Event::Failed(_)), "{event:?}");
            matches!(event, Event::InOperation { .. })
        });
        assert!(up, "it comes into operation");
    }
}
