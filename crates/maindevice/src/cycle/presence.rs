//! Who takes part in the exchange, and who leads the clocks.

use core::ops::Range;

use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::time::{Dc, Nanos, Time};

use super::CyclicExchange;
use super::frames::{Mark, Part};
use crate::segment::{DcCapability, ProcessImage, SubDevice};

/// One SubDevice in the exchange.
pub(super) struct Place {
    pub(super) chunk: Option<usize>,
    pub(super) inputs: Range<usize>,
    pub(super) writes: bool,
    pub(super) reads: bool,
    pub(super) clock: bool,
    pub(super) present: bool,
    /// The cycle that its inputs were of when it was last lost; 0: none.
    kept: u64,
    /// The cycle that its chunk's inputs were of when it was last admitted: its own are not among them.
    since: u64,
}

pub(super) struct Reference {
    pub(super) station: StationAddress,
    /// Bits of its clock.
    pub(super) wide: bool,
    /// Last system time seen, extended to 64 bits.
    pub(super) last: Time<Dc>,
    /// Working counter of the drift datagram.
    pub(super) clocks: u16,
    /// Working counter that last came back.
    pub(super) counted: u16,
    pub(super) compensate: bool,
    /// The last cycle whose drift datagram all clocks took; 0 before the first.
    pub(super) led: u64,
    /// Working counter of the drift datagram when the way of frames was last known to be as it is.
    pub(super) trusted: u16,
    /// The one that came back since. Frames take another way to the clocks, so what they get is early or late:
    /// until that is set right, the datagram only reads.
    pub(super) doubted: Option<u16>,
    /// The clocks are left to themselves for a while.
    pub(super) held: bool,
    /// The datagram only reads at present.
    pub(super) reading: bool,
    /// A time was taken.
    pub(super) seen: bool,
}

impl CyclicExchange {
    /// A SubDevice takes part in the exchange from now on, or no longer. Expected working counters follow; the
    /// frames stay as they are.
    pub fn set_present(&mut self, position: usize, present: bool) {
        if let Some(place) = self.places.get_mut(position) {
            let taken = place.chunk.map_or(0, |chunk| self.taken.chunks[chunk]);
            place.set_present(present, taken);
        }
        self.take_stock();
    }

    /// Another SubDevice leads the clocks, with the next cycle. The time goes on as it was.
    pub fn set_reference(&mut self, device: &SubDevice) {
        let compensate = self.reference.as_ref().is_none_or(|reference| reference.compensate);
        let before = self.reference.take();
        let mut reference = Reference::new(device, compensate);
        if let Some(before) = before {
            (reference.last, reference.seen) = (before.last, before.seen);
            (reference.counted, reference.trusted) = (before.counted, before.trusted);
            (reference.held, reference.doubted) = (before.held, before.doubted);
            reference.led = before.led;
        }
        self.reference = Some(reference);
        self.stale = true;
        self.take_stock();
    }

    /// Leaves the clocks to themselves, or leads them again, with the next cycle.
    pub fn hold_clocks(&mut self, hold: bool) {
        if let Some(reference) = &mut self.reference {
            reference.held = hold;
        }
    }

    /// Whether frames may take another way to the clocks than they did.
    pub fn doubts_clocks(&self) -> bool {
        self.reference.as_ref().is_some_and(|reference| reference.doubted.is_some())
    }

    /// The clocks have been set right for the way that frames take now.
    pub fn trust_clocks(&mut self) {
        if let Some(reference) = &mut self.reference
            && let Some(counted) = reference.doubted.take()
        {
            reference.trusted = counted;
        }
    }

    /// SubDevices that take part.
    pub fn present(&self) -> u16 {
        self.present
    }

    /// SubDevices that last answered the broadcast.
    pub fn answering(&self) -> u16 {
        self.answering
    }

    /// What must count when all that take part do.
    pub(super) fn take_stock(&mut self) {
        self.admitted.clear();
        self.admitted.resize(self.image.chunks.len(), (0, 0));
        self.present = 0;
        let mut clocks = 0;
        for place in self.places.iter().filter(|place| place.present) {
            self.present += 1;
            clocks += u16::from(place.clock);
            if let Some((writers, readers)) = place.chunk.and_then(|at| self.admitted.get_mut(at)) {
                *writers += u16::from(place.writes);
                *readers += u16::from(place.reads);
            }
        }
        if let Some(reference) = &mut self.reference {
            reference.clocks = if reference.compensate { clocks } else { 1 };
        }
    }

    /// Cycles since all clocks last took the reference's time; `None` without a reference.
    pub fn unled(&self) -> Option<u64> {
        self.reference.as_ref().map(|reference| self.number.saturating_sub(reference.led))
    }

    /// By chunk: cycles in a row that counted wrongly, with LRW or LRD and with LWR.
    pub fn wrong(&self) -> &[[u64; 2]] {
        &self.wrong
    }

    /// How much later than planned a frame found the reference clock at most since this was last asked.
    pub fn take_latest(&mut self) -> Option<Nanos> {
        self.latest.take()
    }

    /// The drift datagram leads the clocks, or only reads.
    pub(super) fn choose_drift(&mut self) {
        let Some(reference) = &mut self.reference else { return };
        let reading = !reference.compensate || reference.doubted.is_some() || reference.held;
        if reading == reference.reading {
            return;
        }
        reference.reading = reading;
        let command = if reading { Command::Fprd } else { Command::Frmw };
        let Some(frame) = self.frames.first_mut() else { return };
        let (Some((Part::Drift, layout)), Some(mark)) =
            (frame.datagrams.first_mut(), frame.marks.first_mut())
        else {
            return;
        };
        frame.bytes[layout.start] = command as u8;
        layout.header.command = command as u8;
        *mark = Mark::of(layout);
    }
}

impl Place {
    pub(super) fn new(device: &SubDevice, image: &ProcessImage) -> Self {
        let (outputs, inputs) = (&device.outputs, &device.inputs);
        let start = inputs.logical as usize;
        let mapped = outputs.length > 0 || inputs.length > 0;
        let chunk = image.chunks.iter().position(|chunk| chunk.holds(device));
        Self {
            chunk: chunk.filter(|_| mapped),
            inputs: start..start + usize::from(inputs.length),
            writes: outputs.length > 0,
            reads: inputs.length > 0,
            clock: device.dc.has_clock(),
            present: device.admitted,
            kept: 0,
            since: 0,
        }
    }

    /// It is there or no longer; the inputs of its chunk are of cycle `taken`.
    fn set_present(&mut self, present: bool, taken: u64) {
        match (self.present, present) {
            (true, false) => self.kept = self.inputs_cycle(taken),
            (false, true) => self.since = taken,
            _ => {}
        }
        self.present = present;
    }

    /// The cycle that its inputs are of, those of its chunk being of cycle `taken`; 0: of none.
    pub(super) fn inputs_cycle(&self, taken: u64) -> u64 {
        if self.present && taken > self.since { taken } else { self.kept }
    }
}

impl Reference {
    pub(super) fn new(device: &SubDevice, compensate: bool) -> Self {
        Self {
            station: device.station,
            wide: device.dc == DcCapability::Clock64,
            last: Time::ZERO,
            clocks: 0,
            counted: 0,
            compensate,
            led: 0,
            trusted: 0,
            doubted: None,
            held: false,
            reading: !compensate,
            seen: false,
        }
    }
}
