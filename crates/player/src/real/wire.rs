//! A real interface in the host's time.

use isocat_host::{Arrival, FRAME_TIMEOUT, Link, LinkError, clock, unmarked};
use isocat_wire::datagram::Layouts;
use isocat_wire::frame;
use isocat_wire::time::{Host, Nanos, Time};

use crate::failure::Kind;
use crate::line::SOURCE;
use crate::wire::{Buffer, Sent, Traits, Wire};

/// A real interface.
pub(super) struct RealWire {
    pub link: Link,
    /// The error of the interface, if it failed.
    pub broken: Option<LinkError>,
    /// When the cycle was due whose first frame is the next one to send.
    due: Option<Time<Host>>,
    /// Whether there is a cycle to keep.
    has_cycle: bool,
    stamp_noise: Nanos,
}

impl RealWire {
    pub fn new(link: Link, cycle: Nanos) -> Self {
        let config = isocat_host::on_a_socket(isocat_maindevice::Config::new(cycle));
        let stamp_noise = config.stamp_noise;
        Self { link, broken: None, due: None, has_cycle: false, stamp_noise }
    }

    fn broken<T>(&mut self, result: Result<T, LinkError>) -> Result<T, Kind> {
        result.map_err(|error| {
            let kind = Kind::Interface(error.to_string().replace('\n', "; "));
            self.broken = Some(error);
            kind
        })
    }

    /// Whether a frame is the segment's answer to one of the player's frames. If not, its sender is
    /// counted.
    fn is_ours(&mut self, arrival: Arrival) -> bool {
        let source = self.link.source_of(arrival);
        let ours = source.map(unmarked) == Some(SOURCE);
        let untouched = source == Some(SOURCE) && is_unprocessed(self.link.frame(arrival));
        if ours && !untouched {
            self.link.answered(arrival);
            return true;
        }
        self.link.foreign(arrival, untouched);
        false
    }
}

impl Wire for RealWire {
    fn now(&self) -> Time<Host> {
        clock::now()
    }

    fn wait(&mut self, until: Time<Host>) -> Result<(), Kind> {
        while clock::now() < until {
            let waited = self.link.wait(until, false, false);
            self.broken(waited)?;
        }
        Ok(())
    }

    fn wake_up(&mut self, due: Time<Host>) -> Result<Time<Host>, Kind> {
        self.has_cycle = true;
        while clock::now() < due {
            let waited = self.link.wait(due, false, true);
            self.broken(waited)?;
        }
        self.due = Some(due);
        Ok(clock::now())
    }

    fn send(&mut self, _at: Time<Host>, frame: &[u8]) -> Result<Sent, Kind> {
        let now = clock::now();
        let sent = self.link.send(now, frame, !self.has_cycle);
        self.broken(sent)?;
        if let Some(due) = self.due.take() {
            self.link.begin_cycle(now, due);
        }
        Ok(Sent { at: now, back: None })
    }

    fn receive(&mut self, until: Time<Host>, buffer: &mut Buffer) -> Result<Option<usize>, Kind> {
        loop {
            let arrival = self.link.receive(!self.has_cycle);
            match self.broken(arrival)? {
                Some(arrival) if arrival.is_too_late || !self.is_ours(arrival) => {}
                Some(arrival) => {
                    let bytes = self.link.frame(arrival);
                    let length = bytes.len().min(buffer.len());
                    buffer[..length].copy_from_slice(&bytes[..length]);
                    return Ok(Some(length));
                }
                None if clock::now() >= until => return Ok(None),
                None => {
                    let waited = self.link.wait(until, true, false);
                    self.broken(waited)?;
                }
            }
        }
    }

    fn traits(&self) -> Traits {
        Traits { patience: FRAME_TIMEOUT, stamp_noise: self.stamp_noise }
    }

    fn measure(&mut self, on: bool) {
        self.link.measure(on);
    }
}

/// Whether no SubDevice took part in any datagram of a frame.
fn is_unprocessed(bytes: &[u8]) -> bool {
    let Ok(payload) = frame::payload(bytes) else { return true };
    let mut layouts = Layouts::new();
    while let Some(Ok(layout)) = layouts.next(payload) {
        if payload[layout.wkc()..layout.end()] != [0, 0] {
            return false;
        }
    }
    true
}
