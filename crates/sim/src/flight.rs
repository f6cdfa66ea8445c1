//! The flight of a single frame, port by port: for frames that meet a change or an error on their
//! way.
//!
//! Most frames find the segment unchanged and take the way that was computed once
//! ([`Path`](crate::path::Path)). A frame that is sent while a cable is pulled or plugged, that is
//! hit by a bit error, that comes from the other end of a ring, or that finds loops changed, is
//! followed here: at each port the ESC decides where it goes next.
//!
//! Frames are followed one after the other, each to its end. If a link is lost while several frames
//! are in flight, the later ones may meet the change too early, by the lead of the first one.

use isocat_esc::PortError;
use isocat_wire::PortNumber;
use isocat_wire::frame;
use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};

use crate::path::{Arrival, Loops};
use crate::probe::{Probed, Sight};
use crate::segment::{Lost, Returned, Segment};
use crate::watcher::Watcher;
use crate::wiring::{End, Hop, MainPort};

/// A frame in flight.
pub(crate) struct Flight<'a> {
    bytes: &'a mut [u8],
    /// When its first bit left the MainDevice.
    start: Time<True>,
    /// Time from the first bit to the last.
    duration: Picos,
    good: bool,
    /// Whether an ESC has marked it as bad.
    marked: bool,
}

impl<'a> Flight<'a> {
    /// A frame whose first bit leaves at `start`.
    pub fn new(bytes: &'a mut [u8], start: Time<True>) -> Self {
        let duration = duration(bytes.len());
        Self { bytes, start, duration, good: true, marked: false }
    }
}

impl Segment {
    /// Sends a frame from a port of the MainDevice and follows it to its end.
    pub(crate) fn fly(
        &mut self,
        mut flight: Flight<'_>,
        from: MainPort,
        watch: &mut Watcher,
    ) -> Result<Returned, Lost> {
        self.begin_trail();
        let fate = match self.leave(&mut flight, End::Main(from), Picos::ZERO) {
            Ok((hop, after)) => self.follow(&mut flight, hop.to, after, watch),
            Err(lost) => Err(lost),
        };
        self.latch_trail(flight.start);
        fate
    }

    fn follow(
        &mut self,
        flight: &mut Flight<'_>,
        mut end: End,
        mut after: Picos,
        watch: &mut Watcher,
    ) -> Result<Returned, Lost> {
        // This is as many rounds as the circulating bit needs; a longer way exists only if port 0
        // was closed by a write.
        for _ in 0..3 * (4 * self.devices().len() + 1) {
            let (device, port) = match end {
                End::Main(port) => {
                    let first_bit = flight.start + after;
                    let last_bit = first_bit + flight.duration;
                    return Ok(Returned { port, first_bit, last_bit, good: flight.good });
                }
                End::Port(device, port) => (device, port),
            };
            after = self.visit(flight, Arrival { device, port, after }, watch)?;
            let exit = self.loops(device).turn(port).exit;
            let (hop, arrives) = self.leave(flight, End::Port(device, exit), after)?;
            (end, after) = (hop.to, arrives);
        }
        Err(Lost::Circulates)
    }

    /// Handles the arrival of a frame at a port, by the delays of the wiring; returns the time of
    /// its departure.
    fn visit(
        &mut self,
        flight: &mut Flight<'_>,
        arrival: Arrival,
        watch: &mut Watcher,
    ) -> Result<Picos, Lost> {
        let Arrival { device: number, port, after } = arrival;
        let at = flight.start + after;
        if port == PortNumber::P0 {
            self.tapped(number, at, Sight::Outbound, flight);
        }
        let first = !std::mem::replace(&mut self.met[number], true);
        while let Some(notice) = self.disturbances.take_notice(at, Some(number)) {
            self.notice(notice, first, watch);
        }
        debug_assert!(self.devices[number].is_powered(), "its cables carry nothing");
        let device = &mut self.devices[number];
        if first {
            // A write of the previous frame may change the reception of this one.
            device.advance(device.oscillator().read(at + Picos(-EARLIEST.0)), watch);
        }
        let at = self.received((number, port), at, flight.duration);
        let (after, arrival) = (at - flight.start, Arrival { after: at - flight.start, ..arrival });
        let device = &mut self.devices[number];
        let begin: Time<DeviceClock> = device.oscillator().read(at);
        if first {
            device.advance(begin, watch);
            self.stale |= device.ports_changed();
        }
        if !flight.good {
            let error = if flight.marked { PortError::Forwarded } else { PortError::InvalidFrame };
            device.esc.count_error(port, error);
            flight.marked = true;
        }
        let loops = Loops::of(device.esc.dl_status());
        if loops.closed(port) {
            if flight.good {
                device.esc.hear_frame(port);
                self.stale = true;
            }
            return Err(Lost::Closed { device: number, port });
        }
        self.trail.push(arrival);
        let turn = loops.turn(port);
        let stay = self.wiring.stay(number);
        if !turn.processed {
            return Ok(after + stay.forwarding);
        }
        let departure = after + stay.processing;
        let end = device.oscillator().read(at + flight.duration);
        device.advance(begin, watch);
        let before = self.probes.sees(number).then(|| flight.bytes.to_vec());
        let processed = device.esc.process(flight.bytes, begin, end, flight.good);
        device.touched(self.copy_of.unwrap_or(flight.start));
        self.latched[number] |= processed.latch_ports;
        if let Some(before) = before {
            self.show(flight.start, arrival, false, before);
            if !processed.destroyed {
                self.show(flight.start, arrival, true, flight.bytes.to_vec());
            }
        }
        if processed.destroyed { Err(Lost::Destroyed { device: number }) } else { Ok(departure) }
    }

    /// Sends a frame into one end of a cable; returns the hop and the time of its arrival.
    fn leave(
        &mut self,
        flight: &mut Flight<'_>,
        end: End,
        after: Picos,
    ) -> Result<(Hop, Picos), Lost> {
        let hop = self.wiring.hop(end).ok_or(Lost::NoCable(end))?;
        if let End::Port(device, PortNumber::P0) = end {
            self.tapped(device, flight.start + after, Sight::Inbound, flight);
        }
        let harms = self.disturbances.frames.on_cable(hop.cable, hop.direction);
        if harms.lost {
            return Err(Lost::OnTheWay { cable: hop.cable });
        }
        let after = after + Picos::from(harms.late);
        if harms.damaged {
            flight.good = false;
        }
        let (from, arrives) = (flight.start + after, after + hop.delay);
        let last_bit = flight.start + arrives + flight.duration;
        if !self.disturbances.carries((hop.cable, hop.direction), from, last_bit) {
            return Err(Lost::Unplugged { cable: hop.cable });
        }
        if let Some(error) = self.disturbances.take_error(hop.cable, hop.direction, from) {
            let bit = error.bit % (8 * flight.bytes.len().max(1));
            if let Some(byte) = flight.bytes.get_mut(bit / 8) {
                *byte ^= 1 << (bit % 8);
            }
            flight.good = false;
        }
        Ok((hop, arrives))
    }

    /// Shows a frame at port 0 of a SubDevice to a tap in the cable there, if the frame is good.
    fn tapped(&mut self, device: usize, at: Time<True>, sight: Sight, flight: &Flight<'_>) {
        if flight.good && self.probes.tap_at(device) {
            self.probes.see(Probed { device, at, sight, bytes: flight.bytes.to_vec() });
        }
    }

    fn begin_trail(&mut self) {
        self.trail.clear();
        self.met.fill(false);
    }

    /// Keeps the arrivals of this frame for ESCs whose receive times were written.
    fn latch_trail(&mut self, start: Time<True>) {
        if self.trail.iter().any(|arrival| self.latched[arrival.device]) {
            let trail = std::mem::take(&mut self.trail);
            self.stamp_next_frames(start, &trail);
            self.trail = trail;
        }
        for arrival in &self.trail {
            if self.latched[arrival.device] {
                let device = &mut self.devices[arrival.device];
                let at = device.oscillator().read(start + arrival.after);
                device.esc.receive_at_port(arrival.port, at);
            }
        }
        for arrival in &self.trail {
            self.latched[arrival.device] = false;
        }
    }

    fn loops(&self, device: usize) -> Loops {
        Loops::of(self.devices[device].esc.dl_status())
    }
}

/// Largest time by which a port forwards a frame earlier than the wiring says: half a period, and
/// the effect of smaller FIFOs.
const EARLIEST: Picos = Picos(200_000);

/// How long a frame of `len` bytes lasts, from its first preamble bit to its last FCS bit.
pub(crate) fn duration(len: usize) -> Picos {
    Picos(frame::duration_ns(len) as i64 * 1000)
}

impl std::fmt::Display for Lost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let place = |port: PortNumber, device: usize| format!("port {port} of SubDevice {device}");
        match *self {
            Lost::NoCable(End::Main(port)) => write!(f, "no cable at the {port:?} port"),
            Lost::NoCable(End::Port(device, port)) => {
                write!(f, "no cable at {}, which is open", place(port, device))
            }
            Lost::Unplugged { cable } => write!(f, "cable {cable} is pulled"),
            Lost::AtThePort => f.write_str("it was lost at the MainDevice's port"),
            Lost::OnTheWay { cable } => write!(f, "it was lost on cable {cable}"),
            Lost::Closed { device, port } => write!(f, "{} is closed", place(port, device)),
            Lost::Destroyed { device } => write!(f, "SubDevice {device} destroyed it"),
            Lost::Circulates => write!(f, "it circulates for ever"),
        }
    }
}

impl std::error::Error for Lost {}
