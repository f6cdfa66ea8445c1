//! Which SubDevices take part in the exchange, and which clock is the reference.

use core::ops::Range;

use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::time::{Dc, Nanos, Time};

use super::CyclicExchange;
use super::frames::Part;
use crate::segment::{DcCapability, ProcessImage, SubDevice};

/// One SubDevice in the exchange.
pub(super) struct Place {
    pub(super) chunk: Option<usize>,
    pub(super) inputs: Range<usize>,
    pub(super) writes: bool,
    pub(super) reads: bool,
    pub(super) clock: bool,
    pub(super) present: bool,
    /// The cycle of its inputs when it was last lost; 0: none.
    kept: u64,
    /// The cycle of its chunk's inputs when it was last admitted; they do not include its own
    /// inputs.
    since: u64,
}

pub(super) struct Reference {
    pub(super) station: StationAddress,
    /// Whether its clock has 64 bits.
    pub(super) wide: bool,
    /// Last system time seen, extended to 64 bits.
    pub(super) last: Time<Dc>,
    /// Expected working counter of the drift datagram.
    pub(super) clocks: u16,
    /// Working counter that last came back, as far as reported.
    pub(super) counted: u16,
    pub(super) compensate: bool,
    /// The last cycle whose drift datagram reached all clocks; 0 before the first.
    pub(super) led: u64,
    /// Working counter of the drift datagram on the way of frames for which the delays were set.
    pub(super) trusted: u16,
    /// A different working counter that came back since. Frames take another way to the clocks, so
    /// the time arrives early or late: until the delays are corrected, the datagram only reads.
    pub(super) doubted: Option<u16>,
    /// Whether the clocks are not controlled for a while.
    pub(super) held: bool,
    /// Whether the datagram only reads at present.
    pub(super) reading: bool,
    /// Whether a time was taken.
    pub(super) seen: bool,
}

/// The SubDevices with process data in one chunk that take part.
#[derive(Clone, Copy, Default)]
pub(super) struct Admitted {
    /// Number of them with outputs.
    pub(super) writers: u16,
    /// Number of them with inputs.
    pub(super) readers: u16,
    /// Whether these are all that are planned.
    pub(super) is_whole: bool,
    /// The working counters that they make: of LRW or LRD, and of LWR.
    pub(super) counters: [u16; 2],
}

impl CyclicExchange {
    /// Takes a SubDevice into the exchange or out of it. Expected working counters follow; the
    /// frames stay unchanged.
    pub fn set_present(&mut self, position: usize, present: bool) {
        if let Some(place) = self.places.get_mut(position) {
            let taken = place.chunk.map_or(0, |chunk| self.taken.chunks[chunk]);
            place.set_present(present, taken);
        }
        self.take_stock();
    }

    /// Makes another SubDevice the reference clock, with the next cycle. The time continues.
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

    /// Stops controlling the clocks, or resumes it, with the next cycle.
    pub fn hold_clocks(&mut self, hold: bool) {
        if let Some(reference) = &mut self.reference {
            reference.held = hold;
        }
    }

    /// Whether frames may take another way to the clocks than before.
    pub fn doubts_clocks(&self) -> bool {
        self.reference.as_ref().is_some_and(|reference| reference.doubted.is_some())
    }

    /// Called when the delays have been corrected for the present way of frames.
    pub fn trust_clocks(&mut self) {
        if let Some(reference) = &mut self.reference
            && let Some(counted) = reference.doubted.take()
        {
            reference.trusted = counted;
        }
    }

    /// Number of SubDevices that take part.
    pub fn present(&self) -> u16 {
        self.present
    }

    /// Number of SubDevices that last answered the broadcast.
    pub fn answering(&self) -> u16 {
        self.answering
    }

    /// Computes the expected working counters for all SubDevices that take part.
    pub(super) fn take_stock(&mut self) {
        self.admitted.clear();
        self.admitted.resize(self.image.chunks.len(), Admitted::default());
        self.present = 0;
        let mut clocks = 0;
        for place in self.places.iter().filter(|place| place.present) {
            self.present += 1;
            clocks += u16::from(place.clock);
            if let Some(admitted) = place.chunk.and_then(|at| self.admitted.get_mut(at)) {
                admitted.writers += u16::from(place.writes);
                admitted.readers += u16::from(place.reads);
            }
        }
        for (admitted, chunk) in self.admitted.iter_mut().zip(&self.image.chunks) {
            let Admitted { writers, readers, .. } = *admitted;
            admitted.is_whole = (writers, readers) == (chunk.writers, chunk.readers);
            admitted.counters = self.image.counters(writers, readers);
        }
        if let Some(reference) = &mut self.reference {
            reference.clocks = if reference.compensate { clocks } else { 1 };
        }
    }

    /// Number of cycles since all clocks last took the reference's time; `None` without a
    /// reference.
    pub fn unled(&self) -> Option<u64> {
        self.reference.as_ref().map(|reference| self.number.saturating_sub(reference.led))
    }

    /// By chunk: cycles in a row with a wrong working counter, of LRW or LRD and of LWR.
    pub fn wrong(&self) -> &[[u64; 2]] {
        &self.wrong
    }

    /// The largest lateness of a frame at the reference clock against the plan, since the last
    /// call.
    pub fn take_latest(&mut self) -> Option<Nanos> {
        self.latest.take()
    }

    /// Chooses whether the drift datagram controls the clocks or only reads.
    #[inline]
    pub(super) fn choose_drift(&mut self) {
        let Some(reference) = &mut self.reference else { return };
        let reading = !reference.compensate || reference.doubted.is_some() || reference.held;
        if reading == reference.reading {
            return;
        }
        reference.reading = reading;
        let command = if reading { Command::Fprd } else { Command::Frmw };
        let Some(frame) = self.frames.first_mut() else { return };
        if let Some(datagram) = frame.datagrams.first_mut().filter(|d| d.part == Part::Drift) {
            datagram.set_command(command);
        }
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

    /// Marks it as present or absent; `taken` is the cycle of its chunk's inputs.
    fn set_present(&mut self, present: bool, taken: u64) {
        match (self.present, present) {
            (true, false) => self.kept = self.inputs_cycle(taken),
            (false, true) => self.since = taken,
            _ => {}
        }
        self.present = present;
    }

    /// The cycle of its inputs; `taken` is the cycle of its chunk's inputs. 0: none.
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
