//! The segment behind the program's packet sockets.

use isocat_segment::Scenario;
use isocat_serve::Setup;
use isocat_serve::server::{Answer, Event, Server, Session};
use isocat_sim::fault::Happened;
use isocat_sim::{Fault, MainPort, Tap};
use isocat_virtual::kernel::MachineFault;
use isocat_virtual::supervisor::START;
use isocat_virtual::{Wire, WireAnswer};
use isocat_wire::time::{Host, Time};

use super::mutate::class::Classes;
use super::mutate::mutant::Mutation;

/// A served segment, and the faults of the program's machine.
pub struct Segment {
    pub server: Server,
    /// Hash (FNV-1a) of all frames that came back, with the times at which they were sent.
    pub hash: u64,
    /// What is done to the program's frames on purpose.
    pub mutation: Option<Mutation>,
    /// The classes of datagrams, if they are wanted.
    pub classes: Option<Classes>,
    machine_faults: Vec<MachineFault>,
}

const PORTS: [MainPort; 2] = [MainPort::Primary, MainPort::Secondary];

impl Segment {
    /// The segment of a scenario, and a tap that records its events.
    pub fn new(scenario: &Scenario, tap: Option<Box<dyn Tap + Send>>) -> Self {
        let server = Server::new(Setup::from(scenario).without_process_data().with_host(), START);
        let server = match tap {
            Some(tap) => server.with_tap(tap),
            None => server,
        };
        let (mutation, classes, machine_faults) = (None, None, Vec::new());
        Self { server, hash: 0xCBF2_9CE4_8422_2325, mutation, classes, machine_faults }
    }

    fn is_in_operation(&self) -> bool {
        let wanted = self.mutation.is_some() || self.classes.is_some();
        wanted && self.server.session().is_some_and(Session::is_judged)
    }

    fn take_in(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.hash = (self.hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3);
        }
    }

    fn hear(&mut self) {
        while let Some(event) = self.server.poll_event() {
            if let Event::Fault(happened) = event {
                self.machine_faults.extend(machine_fault(&self.server, &happened));
            }
        }
    }
}

impl Wire for Segment {
    fn send(
        &mut self,
        interface: usize,
        at: Time<Host>,
        frame: &[u8],
        answers: &mut Vec<WireAnswer>,
    ) {
        let mut bytes = frame.to_vec();
        let in_operation = self.is_in_operation();
        let mut behind = Vec::new();
        if let Some(mutation) = &mut self.mutation {
            behind = mutation.out(&mut bytes, in_operation);
        }
        let answer = self.server.frame_at(PORTS[interface], at, &mut bytes);
        self.take_in(&at.count().to_le_bytes());
        self.take_in(&bytes);
        self.server.after(&bytes);
        for mut frame in behind {
            self.server.frame_at(PORTS[interface], at, &mut frame);
            self.server.after(&frame);
        }
        if let Some(mutation) = &mut self.mutation {
            mutation.back(&mut bytes);
        }
        if let Some(classes) = &mut self.classes {
            classes.take(frame, &bytes, in_operation);
        }
        if let Answer::Back { port, last_bit, .. } = answer {
            answers.push(WireAnswer { at: last_bit, interface: port as usize, bytes });
        }
        while let Some((port, at, bytes)) = self.server.take_copy() {
            answers.push(WireAnswer { at, interface: port as usize, bytes });
        }
        self.hear();
    }

    fn about_to_send(&mut self, has_untaken: bool) {
        self.server.about_to_send(has_untaken);
    }

    fn advance(&mut self, now: Time<Host>) {
        self.server.idle(now);
        self.hear();
    }

    fn next_timeout(&self, now: Time<Host>) -> Option<Time<Host>> {
        let fault = self.server.next_fault();
        self.server.next_timeout(now).into_iter().chain(fault).min()
    }

    fn take_machine_faults(&mut self) -> Vec<MachineFault> {
        std::mem::take(&mut self.machine_faults)
    }
}

/// The effect of a fault on the program's machine, if it has one.
fn machine_fault(server: &Server, happened: &Happened) -> Option<MachineFault> {
    let at = server.served().host_time(happened.at);
    let begins = happened.begins;
    match happened.fault {
        Fault::Stall if begins => {
            let to = happened.lasts.map_or(Time::NEVER, |lasts| at + lasts);
            Some(MachineFault::Stall(at, to))
        }
        Fault::Stall => Some(MachineFault::Stall(at, at)),
        Fault::LateWakeUps(late) => Some(MachineFault::LateWakeUps(begins.then_some(late))),
        Fault::SlowSends(slow) => Some(MachineFault::SlowSends(begins.then_some(slow))),
        Fault::ClockJump { by } if begins => Some(MachineFault::ClockJump(by)),
        _ => None,
    }
}
