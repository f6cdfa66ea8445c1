//! The cyclic exchange: frames built once, sent at the phase planned, allocation-free.
//!
//! All frames of a cycle are in flight together. The first begins with the drift datagram (FRMW of
//! 0x0910): it distributes the reference time and brings it back for the servo. Where the reference
//! clock is led (see `Config::direction`), a write of its 0x0910 follows (FPWR; NOP in a cycle with nothing to
//! write). Then come the chunks of process data and, last, a broadcast read of AL status, by which a SubDevice that
//! leaves its state is noticed in the same cycle. Inputs are taken only from a chunk that counts
//! right, so inputs of one SubDevice are always of one moment; a lost frame is counted and never
//! stops the exchange.

use alloc::vec;
use alloc::vec::Vec;
use core::ops::Range;

use isocat_sync::phase::external::Stamps;
use isocat_sync::phase::{Direction, Drive, Servo, Settings, State};
use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, HEADER_LEN, Layout};
use isocat_wire::frame::{FrameWriter, MAX_LEN, MIN_LEN, duration_ns};
use isocat_wire::register;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::event::Event;
use crate::link::{CYCLIC_INDEX, Inner};
use crate::segment::{
    Chunk, DatagramPlan, DcCapability, FramePlan, GAP, ProcessImage, Segment, SubDevice,
};

/// The exchange and its state.
pub(crate) struct Cycle {
    cycle: Nanos,
    send_phase: Nanos,
    servo: Servo,
    /// Cycles that the servo takes to lock.
    samples_to_lock: u32,
    last_state: State,
    reference: Option<Reference>,
    /// Leads the reference clock; `None`: nobody does.
    drive: Option<Drive>,
    /// What was written to the reference clock, by parity of the cycle.
    written: [Option<Time<Dc>>; 2],
    count: u16,
    image: ProcessImage,
    /// Process data run; before that only the drift datagram and AL status.
    exchanging: bool,
    /// What [`Cycle::exchanging`] becomes with the next cycle.
    wanted: bool,
    source: [u8; 6],
    frames: Vec<CyclicFrame>,
    outputs: Vec<u8>,
    inputs: Vec<u8>,
    /// Cycles for which each chunk has counted wrongly: with LRW or LRD, with LWR.
    wrong: Vec<[u64; 2]>,
    /// By position: where its process data are, and whether they take part.
    places: Vec<Place>,
    /// By chunk: writers and readers that take part.
    admitted: Vec<(u16, u16)>,
    /// SubDevices that take part.
    present: u16,
    /// The frames are built anew with the next cycle.
    stale: bool,
    number: u64,
    /// Instant for the next frame, or of the cycle being sent.
    due: Time<Host>,
    /// The cycle that is due was put off after the caller had slept.
    put_off: bool,
    /// When the port has sent this cycle's frames so far, and the gap behind them.
    through: Time<Host>,
    /// Next frame of this cycle to send; all are sent if it is the number of frames.
    next_frame: usize,
    /// The count of SubDevices that last answered.
    answering: u16,
    /// Last OR of all AL status.
    pub al_status: u16,
    /// Phase errors are counted.
    pub measuring: bool,
}

/// One SubDevice in the exchange.
struct Place {
    chunk: Option<usize>,
    inputs: Range<usize>,
    writes: bool,
    reads: bool,
    clock: bool,
    present: bool,
}

struct Reference {
    station: StationAddress,
    /// Bits of its clock.
    wide: bool,
    /// Last system time seen, extended to 64 bits.
    last: Time<Dc>,
    /// Working counter of the drift datagram.
    clocks: u16,
    /// Working counter that last came back.
    counted: u16,
    compensate: bool,
    /// The last cycle whose drift datagram all clocks took; 0 before the first.
    led: u64,
    /// Working counter of the drift datagram when the way of frames was last known to be as it is.
    trusted: u16,
    /// The one that came back since. Frames take another way to the clocks, so what they get is early or late:
    /// until that is set right, the datagram only reads.
    doubted: Option<u16>,
    /// The clocks are left to themselves for a while.
    held: bool,
    /// The datagram only reads at present.
    reading: bool,
    /// A time was taken.
    seen: bool,
}

/// One frame of the cycle and where its datagrams are.
struct CyclicFrame {
    bytes: Vec<u8>,
    /// Offsets are from the start of the frame.
    datagrams: Vec<(Part, Layout)>,
    marks: Vec<Mark>,
    /// The frame's two places in flight, by parity of the cycle.
    flights: [Option<Time<Host>>; 2],
    cycles: [u64; 2],
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Drift,
    /// Leads the reference clock.
    Lead,
    /// Chunk and what its working counter must be.
    ReadWrite(usize),
    Write(usize),
    Read(usize),
    AlStatus,
}

impl Cycle {
    /// An exchange that begins at `start` without process data.
    pub fn new(
        config: &crate::Config,
        segment: &Segment,
        start: Time<Host>,
        source: [u8; 6],
    ) -> Self {
        let reference = segment
            .reference
            .map(|position| Reference::new(&segment.devices[position], config.drift_compensation));
        let image = segment.image.clone();
        let bytes = image.chunks.iter().map(|c| c.logical as usize + usize::from(c.length)).max();
        let bytes = bytes.unwrap_or(0);
        let settings = Settings::new(config.cycle, config.stamp_noise);
        let places: Vec<_> =
            segment.devices.iter().map(|device| Place::new(device, &image)).collect();
        let mut cycle = Self {
            cycle: config.cycle,
            send_phase: segment.timing.as_ref().map_or(Nanos::ZERO, |timing| timing.cycle.send),
            servo: Servo::new(settings),
            samples_to_lock: settings.samples_to_lock(),
            last_state: State::Free,
            drive: reference.as_ref().and(drive(config)),
            written: [None; 2],
            reference,
            count: segment.devices.len() as u16,
            wrong: vec![[0; 2]; image.chunks.len()],
            admitted: Vec::with_capacity(image.chunks.len()),
            present: 0,
            places,
            stale: false,
            image,
            exchanging: false,
            wanted: false,
            source,
            frames: Vec::new(),
            outputs: vec![0; bytes],
            inputs: vec![0; bytes],
            number: 0,
            due: start,
            put_off: false,
            through: Time::ZERO,
            next_frame: 0,
            answering: segment.devices.len() as u16,
            al_status: 0,
            measuring: false,
        };
        cycle.take_stock();
        if let Some(reference) = &mut cycle.reference {
            reference.counted = reference.clocks;
            reference.trusted = reference.clocks;
        }
        cycle.build();
        cycle
    }

    /// A SubDevice takes part in the exchange from now on, or no longer. Expected working counters follow; the
    /// frames stay as they are.
    pub fn set_present(&mut self, position: usize, present: bool) {
        if let Some(place) = self.places.get_mut(position) {
            place.present = present;
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
    fn take_stock(&mut self) {
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

    /// How long locking may take, being asked to wait `patience` at least.
    pub fn lock_patience(&self, patience: Nanos) -> Nanos {
        patience.max(Nanos(self.cycle.0 * 4 * i64::from(self.samples_to_lock)))
    }

    /// Begins or ends the exchange of process data, with the next cycle.
    pub fn exchange_process_data(&mut self, on: bool) {
        self.wanted = on;
    }

    /// Whether the host is locked onto the reference clock; without one there is nothing to lock
    /// to.
    pub fn is_locked(&self) -> bool {
        self.reference.is_none() || self.servo.state() == State::Locked
    }

    /// The servo.
    pub fn servo(&self) -> &Servo {
        &self.servo
    }

    /// What leads the reference clock, if something does.
    pub fn drive(&self) -> Option<&Drive> {
        self.drive.as_ref()
    }

    /// Takes stamps of an external time.
    pub fn external_stamps(&mut self, stamps: Stamps) {
        if let Some(drive) = &mut self.drive {
            drive.stamps(stamps, &self.servo);
        }
    }

    /// Cycles begun.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// When the next cycle is due.
    pub fn due(&self) -> Time<Host> {
        self.due
    }

    /// Whether all frames of the cycle are out.
    pub fn is_sent(&self) -> bool {
        self.next_frame >= self.frames.len() || self.next_frame == 0
    }

    /// Cycles since all clocks last took the reference's time; `None` without a reference.
    pub fn unled(&self) -> Option<u64> {
        self.reference.as_ref().map(|reference| self.number.saturating_sub(reference.led))
    }

    /// When the port has sent the frames of this cycle that are out, and the gap behind them.
    pub fn through(&self) -> Time<Host> {
        self.through
    }

    /// What the frames of a cycle leave of it, the gaps taken off.
    pub fn spare(&self) -> Nanos {
        let wire = |frame: &CyclicFrame| duration_ns(frame.bytes.len()) as i64 + GAP.0;
        self.cycle - Nanos(self.frames.iter().map(wire).sum())
    }

    /// Frames that are under way.
    pub fn in_flight(&self) -> usize {
        self.frames.iter().flat_map(|frame| frame.flights).flatten().count()
    }

    /// The outputs of the image.
    pub fn outputs_mut(&mut self) -> &mut [u8] {
        &mut self.outputs
    }

    /// The inputs of the image.
    pub fn inputs(&self) -> &[u8] {
        &self.inputs
    }

    /// The next frame of the cycle, if one is due.
    pub fn transmit(
        &mut self,
        now: Time<Host>,
        buffer: &mut [u8],
        inner: &mut Inner,
    ) -> Option<usize> {
        if self.next_frame >= self.frames.len() {
            self.next_frame = 0;
        }
        if self.next_frame == 0 {
            if now < self.due || self.wait_for_grid(now, inner) {
                return None;
            }
            self.begin(now, inner);
        }
        let at = self.next_frame;
        let parity = (self.number & 1) as usize;
        let index = self.index(self.number, at);
        let frame = &mut self.frames[at];
        let bytes = buffer.get_mut(..frame.bytes.len())?;
        bytes.copy_from_slice(&frame.bytes);
        for (part, layout) in &frame.datagrams {
            bytes[layout.start + 1] = index;
            if let Part::ReadWrite(chunk) | Part::Write(chunk) = *part {
                let chunk = &self.image.chunks[chunk];
                let from = chunk.logical as usize;
                let outputs = &self.outputs[from..from + usize::from(chunk.length)];
                bytes[layout.data()..layout.wkc()].copy_from_slice(outputs);
            }
            if *part == Part::Lead {
                let drive = self.drive.as_mut();
                let value = drive.and_then(|drive| drive.value(now, &self.servo));
                self.written[parity] = value;
                let command = if value.is_some() { Command::Fpwr } else { Command::Nop };
                bytes[layout.start] = command as u8;
                let value = value.unwrap_or(Time::ZERO).count().to_le_bytes();
                bytes[layout.data()..layout.wkc()].copy_from_slice(&value);
            }
        }
        frame.flights[parity] = Some(now);
        frame.cycles[parity] = self.number;
        self.through = now.max(self.through) + Nanos(duration_ns(frame.bytes.len()) as i64) + GAP;
        inner.statistics.frames_sent += 1;
        inner.statistics.datagrams += frame.datagrams.len() as u64;
        self.next_frame += 1;
        if self.next_frame >= self.frames.len() {
            let earliest = now.max(self.due) + Nanos(self.cycle.0 / 2);
            self.due = self.next_send(earliest);
        }
        Some(self.frames[at].bytes.len())
    }

    /// Takes a frame of the cycle that came back, whose datagrams begin at `start`; `false` if it is
    /// none.
    pub fn receive(
        &mut self,
        now: Time<Host>,
        bytes: &[u8],
        start: usize,
        inner: &mut Inner,
    ) -> bool {
        let Some(&index) = bytes.get(start + 1) else { return false };
        if index < CYCLIC_INDEX {
            return false;
        }
        let (sequence, at) = self.sequence(index);
        let parity = usize::from(sequence & 1);
        let Some(frame) = self.frames.get(at) else { return false };
        let known = frame.datagrams.last().map_or(0, |(_, layout)| layout.end());
        let Some(sent) = frame.flights[parity] else { return false };
        // An answer that comes cycles late must not be taken for that of a later cycle.
        if self.index(frame.cycles[parity], at) != index {
            return false;
        }
        let frame = &mut self.frames[at];
        let mut marks = frame.marks.iter().zip(&frame.datagrams);
        if bytes.len() < known || !marks.all(|(mark, (_, d))| mark.is_at(bytes, d.start)) {
            return false;
        }
        frame.flights[parity] = None;
        let cycle = frame.cycles[parity];
        inner.statistics.frames_received += 1;
        let mut complete = true;
        let mut reference_time = None;
        for i in 0..self.frames[at].datagrams.len() {
            let (part, layout) = self.frames[at].datagrams[i];
            let data = &bytes[layout.data()..layout.wkc()];
            let wkc = u16::from_le_bytes([bytes[layout.wkc()], bytes[layout.wkc() + 1]]);
            match part {
                Part::Drift => {
                    reference_time = self.take_time(sent, data, wkc, cycle, inner);
                    // Planned when the frame left; planned better with what it brought back.
                    if cycle == self.number && self.is_sent() {
                        self.due = self.next_send(sent + Nanos(self.cycle.0 / 2));
                    }
                }
                Part::Lead => {
                    let Some(written) = self.written[parity].take() else { continue };
                    // Of one SubDevice; without its access nothing was written.
                    inner.statistics.working_counter_errors += u64::from(wkc != 1);
                    if let (Some(drive), Some(found), 1) = (&mut self.drive, reference_time, wkc) {
                        drive.came_back(written, found);
                    }
                }
                Part::AlStatus => {
                    self.al_status = u16::from_le_bytes([data[0], data[1]]);
                    if wkc != self.answering {
                        self.answering = wkc;
                        let expected = self.count;
                        inner.report(Event::CountChanged { cycle, expected, found: wkc });
                    }
                }
                Part::ReadWrite(chunk) | Part::Read(chunk) | Part::Write(chunk) => {
                    complete &= self.take_chunk(part, chunk, data, wkc, cycle, inner);
                }
            }
        }
        // A chunk whose frame did not come back is not complete either, see `begin`.
        if !complete {
            inner.complete_cycles = 0;
        }
        self.servo.handle_timeout(now);
        true
    }

    /// A caller who slept over half a cycle or more sends on the grid again, not somewhere in between:
    /// a frame there would meet SYNC0 at any phase. True if the cycle is put off. That never happens
    /// twice in a row, so that a host which is always late still sends.
    fn wait_for_grid(&mut self, now: Time<Host>, inner: &mut Inner) -> bool {
        let late = now - self.due;
        if self.put_off || late.0 < self.cycle.0 / 2 {
            return false;
        }
        let due = self.next_send(now);
        let skipped = ((due - self.due).0 + self.cycle.0 / 2) / self.cycle.0;
        if due <= now {
            return false;
        }
        self.put_off = true;
        self.due = due;
        let skipped = skipped.max(0) as u64;
        inner.statistics.cycles_skipped += skipped;
        inner.report(Event::CyclesSkipped { cycle: self.number + 1, late, skipped });
        true
    }

    /// Index of the datagrams of a frame: its number, and above it as much of the cycle's as has room.
    fn index(&self, cycle: u64, frame: usize) -> u8 {
        let bits = self.frame_bits();
        CYCLIC_INDEX | ((cycle as u8) << bits) & !CYCLIC_INDEX | frame as u8
    }

    /// The lowest bits of the cycle's number, and the frame's, from an index.
    fn sequence(&self, index: u8) -> (u8, usize) {
        let bits = self.frame_bits();
        ((index & !CYCLIC_INDEX) >> bits, usize::from(index & ((1 << bits) - 1)))
    }

    /// Bits that the number of a frame needs; one is left for the cycle's at least, as the mapping has at most 64.
    fn frame_bits(&self) -> u32 {
        self.frames.len().saturating_sub(1).checked_ilog2().map_or(0, |log| log + 1)
    }

    /// Begins a cycle: what was sent two cycles ago and is not back is lost.
    fn begin(&mut self, now: Time<Host>, inner: &mut Inner) {
        let late = now - self.due;
        // Only of a cycle that was put off already; others wait for the grid.
        let skipped = (late.0 / self.cycle.0).max(0) as u64;
        self.put_off = false;
        self.number += 1;
        inner.cycle = self.number;
        inner.statistics.cycles += 1;
        if skipped > 0 {
            inner.statistics.cycles_skipped += skipped;
            inner.report(Event::CyclesSkipped { cycle: self.number, late, skipped });
        }
        if self.wanted != self.exchanging || self.stale {
            self.exchanging = self.wanted;
            self.stale = false;
            self.build();
        }
        self.choose_drift();
        let parity = (self.number & 1) as usize;
        if self.exchanging {
            // Counted up here and set back by whatever goes wrong.
            inner.complete_cycles += 1;
        }
        for (at, frame) in self.frames.iter_mut().enumerate() {
            if frame.flights[parity].take().is_some() {
                inner.statistics.frames_lost += 1;
                // Says nothing of the SubDevices: neither counts nor begins the count anew.
                inner.complete_cycles = inner.complete_cycles.saturating_sub(1);
                inner.report(Event::FrameLost { cycle: frame.cycles[parity], frame: at });
            }
        }
        if self.reference.as_ref().is_some_and(|reference| reference.compensate) {
            inner.statistics.drift_frames += 1;
        }
        self.servo.handle_timeout(now);
        let state = self.servo.state();
        if state != self.last_state {
            self.last_state = state;
            inner.report(Event::Phase { cycle: self.number, state });
        }
    }

    /// The drift datagram leads the clocks, or only reads.
    fn choose_drift(&mut self) {
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

    /// The first instant from `earliest` on at which the frame finds the reference at its phase.
    fn next_send(&self, earliest: Time<Host>) -> Time<Host> {
        self.servo.next_send(earliest, self.cycle, self.send_phase)
    }

    /// Feeds the servo with the reference time that came back, and gives it.
    fn take_time(
        &mut self,
        sent: Time<Host>,
        data: &[u8],
        wkc: u16,
        cycle: u64,
        inner: &mut Inner,
    ) -> Option<Time<Dc>> {
        let reference = self.reference.as_mut()?;
        let expected = if reference.reading { 1 } else { reference.clocks };
        // Clocks that are about to be admitted answer as well.
        let more = wkc > expected && !reference.reading;
        let counted = if more { expected } else { wkc };
        let told = if reference.reading && reference.compensate && wkc == 1 {
            reference.counted
        } else {
            counted
        };
        if told != reference.counted {
            reference.counted = told;
            inner.report(Event::Drift { cycle, expected, found: told });
        }
        if !reference.reading && wkc != reference.trusted {
            reference.doubted = Some(wkc);
        }
        if counted != expected {
            inner.statistics.working_counter_errors += 1;
            // Without the reference's own access the data are ours; with it but not all others, a
            // clock is no longer led, and the time would still be right: but which of both it is
            // can't be told.
            return None;
        }
        let raw = data.first_chunk().map(|raw| u64::from_le_bytes(*raw))?;
        if raw == 0 {
            // As it was sent: others answered in the place of the reference.
            return None;
        }
        let dc = match (reference.wide, reference.seen) {
            (true, _) => Time::new(raw),
            (false, true) => extend(raw as u32, reference.last),
            (false, false) => Time::new(raw & u64::from(u32::MAX)),
        };
        (reference.last, reference.seen) = (dc, true);
        inner.reference_time = (sent, dc);
        if !reference.reading {
            reference.led = cycle;
        }
        self.servo.sample(sent, dc);
        if self.measuring {
            let cycle = self.cycle.0;
            let phase = (dc + -self.send_phase).phase(cycle as u64) as i64;
            let error = if phase > cycle / 2 { phase - cycle } else { phase };
            inner.statistics.phase_error.add(Nanos(error));
        }
        Some(dc)
    }

    /// Takes the inputs of a chunk that counts right.
    fn take_chunk(
        &mut self,
        part: Part,
        at: usize,
        data: &[u8],
        wkc: u16,
        cycle: u64,
        inner: &mut Inner,
    ) -> bool {
        let chunk = &self.image.chunks[at];
        let count = |(writers, readers): (u16, u16)| match part {
            Part::ReadWrite(_) => 2 * writers + readers,
            Part::Write(_) => writers,
            _ => readers,
        };
        let (expected, planned) = (count(self.admitted[at]), count((chunk.writers, chunk.readers)));
        // Those that are about to be admitted count from the moment at which they are mapped.
        let more = self.answering > self.present && (expected..=planned).contains(&wkc);
        let wkc = if more { expected } else { wkc };
        let wrong = &mut self.wrong[at][usize::from(part == Part::Write(at))];
        if wkc != expected {
            inner.statistics.working_counter_errors += 1;
            inner.incomplete = (expected, wkc);
            if *wrong == 0 {
                inner.report(Event::WorkingCounter { cycle, chunk: at, expected, found: wkc });
            }
            *wrong += 1;
            return false;
        }
        if part != Part::Write(at) {
            let from = chunk.logical as usize;
            if self.admitted[at] == (chunk.writers, chunk.readers) {
                self.inputs[from..from + usize::from(chunk.length)].copy_from_slice(data);
            } else {
                // In the place of one that is not there our own outputs come back.
                let own = |place: &&Place| place.present && place.chunk == Some(at);
                for Place { inputs, .. } in self.places.iter().filter(own) {
                    let data = &data[inputs.start - from..inputs.end - from];
                    self.inputs[inputs.clone()].copy_from_slice(data);
                }
            }
        }
        let cycles = core::mem::take(wrong);
        if cycles > 0 {
            inner.report(Event::WorkingCounterRestored { cycle, chunk: at, cycles });
        }
        true
    }

    /// Builds the frames of a cycle.
    fn build(&mut self) {
        self.frames.clear();
        let reference = self.reference.as_ref();
        let clock = (reference.is_some(), self.drive.is_some());
        for plan in plan_frames(&self.image, clock, self.exchanging) {
            let mut bytes = vec![0; MAX_LEN];
            let mut writer = FrameWriter::new(&mut bytes, self.source);
            let mut datagrams = Vec::new();
            for part in plan {
                let (command, address, len) = match part {
                    Part::Drift => {
                        let Some(reference) = reference else { continue };
                        let address =
                            Address::Station(reference.station, register::SYSTEM_TIME.address);
                        let command = if reference.reading { Command::Fprd } else { Command::Frmw };
                        (command, address, TIME_LEN)
                    }
                    Part::Lead => {
                        let Some(reference) = reference else { continue };
                        let address = register::SYSTEM_TIME.address;
                        (Command::Fpwr, Address::Station(reference.station, address), TIME_LEN)
                    }
                    Part::AlStatus => {
                        (Command::Brd, Address::Broadcast(register::AL_STATUS.address), 2)
                    }
                    Part::ReadWrite(chunk) => self.logical(Command::Lrw, chunk),
                    Part::Write(chunk) => self.logical(Command::Lwr, chunk),
                    Part::Read(chunk) => self.logical(Command::Lrd, chunk),
                };
                let pushed = writer.push(command, 0, address, &ZEROS[..len]);
                let data = pushed.expect("the plan of the frames keeps their length");
                datagrams.push((part, data - HEADER_LEN));
            }
            let len = writer.finish();
            bytes.truncate(len);
            let datagrams: Vec<_> = datagrams
                .into_iter()
                .map(|(part, start)| {
                    let layout = Layout::at(&bytes, start);
                    (part, layout.expect("the datagram was just written"))
                })
                .collect();
            let mark = |(part, layout): &(Part, Layout)| {
                let mark = Mark::of(layout);
                if *part == Part::Lead { mark.of_any_command() } else { mark }
            };
            let marks = datagrams.iter().map(mark).collect();
            let (flights, cycles) = ([None; 2], [0; 2]);
            self.frames.push(CyclicFrame { bytes, datagrams, marks, flights, cycles });
        }
    }

    fn logical(&self, command: Command, chunk: usize) -> (Command, Address, usize) {
        let chunk = &self.image.chunks[chunk];
        (command, Address::Logical(chunk.logical), usize::from(chunk.length))
    }
}

impl Place {
    fn new(device: &SubDevice, image: &ProcessImage) -> Self {
        let (outputs, inputs) = (&device.outputs, &device.inputs);
        let start = inputs.logical as usize;
        let mapped = outputs.length > 0 || inputs.length > 0;
        let of = |chunk: &Chunk| (chunk.first..chunk.end).contains(&device.position);
        Self {
            chunk: image.chunks.iter().position(of).filter(|_| mapped),
            inputs: start..start + usize::from(inputs.length),
            writes: outputs.length > 0,
            reads: inputs.length > 0,
            clock: device.dc.has_clock(),
            present: device.admitted,
        }
    }
}

impl Reference {
    fn new(device: &SubDevice, compensate: bool) -> Self {
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

/// How a datagram is known again: the first eight bytes of its header, less what changes on the way.
#[derive(Clone, Copy)]
struct Mark {
    mask: u64,
    value: u64,
}

impl Mark {
    fn of(layout: &Layout) -> Self {
        // Command, address and length; not the index, which says which cycle it was, nor the flags.
        let mut mask = 0x07FF_FFFF_FFFF_00FF;
        if layout.header.command().is_ok_and(|command| command.increments_position()) {
            mask &= !0xFFFF_0000;
        }
        let [bytes @ .., _, _] = layout.header.emit();
        Self { mask, value: u64::from_le_bytes(bytes) & mask }
    }

    /// The same whatever the command.
    fn of_any_command(self) -> Self {
        let mask = self.mask & !0xFF;
        Self { mask, value: self.value & mask }
    }

    /// Whether the datagram is at `start` of a frame.
    fn is_at(self, bytes: &[u8], start: usize) -> bool {
        let found = bytes.get(start..).and_then(|rest| rest.first_chunk());
        found.is_some_and(|found| u64::from_le_bytes(*found) & self.mask == self.value)
    }
}

/// The time of a 32-bit clock, extended to the one nearest to `near`.
pub(crate) fn extend(low: u32, near: Time<Dc>) -> Time<Dc> {
    let ahead = low.wrapping_sub(near.count() as u32) as i32;
    near + Nanos(i64::from(ahead))
}

/// What leads the reference clock, as the configuration has it.
fn drive(config: &crate::Config) -> Option<Drive> {
    match config.direction {
        Direction::FollowReference => None,
        Direction::DriveReference { limits } => Some(Drive::after_host(limits)),
        Direction::External { limits, source } => Some(Drive::after_external(limits, source)),
    }
}

/// Which parts go into which frame of a cycle. No chunk is cut, so no SubDevice is. `clock`: there is a reference
/// clock; it is led.
fn plan_frames(image: &ProcessImage, clock: (bool, bool), exchanging: bool) -> Vec<Vec<Part>> {
    let mut frames: Vec<Vec<Part>> = vec![Vec::new()];
    let mut room = ROOM;
    let mut put = |part: Part, len: usize| {
        let len = len + DATAGRAM_OVERHEAD;
        if len > room {
            frames.push(Vec::new());
            room = ROOM;
        }
        room -= len;
        if let Some(frame) = frames.last_mut() {
            frame.push(part);
        }
    };
    if clock.0 {
        put(Part::Drift, TIME_LEN);
        if clock.1 {
            put(Part::Lead, TIME_LEN);
        }
    }
    if exchanging {
        for (at, chunk) in image.chunks.iter().enumerate() {
            let len = usize::from(chunk.length);
            match image.read_write {
                true => put(Part::ReadWrite(at), len),
                false => {
                    put(Part::Write(at), len);
                    put(Part::Read(at), len);
                }
            }
        }
    }
    put(Part::AlStatus, 2);
    frames
}

/// The frames of a cycle with process data, as they will be sent: what is in them, and when they are on the
/// wire, counted from the first bit of the first.
pub(crate) fn frames(segment: &Segment, compensate: bool, leads: bool) -> Vec<FramePlan> {
    let image = &segment.image;
    let mut start = 0;
    let mut frames = Vec::new();
    let clock = (segment.reference.is_some(), leads);
    for parts in plan_frames(image, clock, true) {
        let mut at = HEADERS;
        let mut datagrams = Vec::new();
        for part in parts {
            let chunk = |chunk: usize| {
                let of = &image.chunks[chunk];
                (Address::Logical(of.logical), usize::from(of.length), Some(chunk))
            };
            let (command, (address, length, chunk)) = match part {
                Part::Drift | Part::Lead => {
                    let station = segment.reference.map(|at| segment.devices[at].station);
                    let station = station.unwrap_or(StationAddress(0));
                    let address = Address::Station(station, register::SYSTEM_TIME.address);
                    let command = match (part, compensate) {
                        (Part::Lead, _) => Command::Fpwr,
                        (_, true) => Command::Frmw,
                        (_, false) => Command::Fprd,
                    };
                    (command, (address, TIME_LEN, None))
                }
                Part::AlStatus => {
                    let address = Address::Broadcast(register::AL_STATUS.address);
                    (Command::Brd, (address, 2, None))
                }
                Part::ReadWrite(at) => (Command::Lrw, chunk(at)),
                Part::Write(at) => (Command::Lwr, chunk(at)),
                Part::Read(at) => (Command::Lrd, chunk(at)),
            };
            datagrams.push(DatagramPlan { command, address, length, offset: at, chunk });
            at += DATAGRAM_OVERHEAD + length;
        }
        let end = start + duration_ns(at);
        let (begin, end_of) = (Nanos(start as i64), Nanos(end as i64));
        frames.push(FramePlan { begin, end: end_of, length: at.max(MIN_LEN), datagrams });
        start = end + GAP.0 as u64;
    }
    frames
}

/// When the frames of a chunk are on the wire, counted from the first bit of the cycle's first frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct ChunkTimes {
    /// Begin of the frame that fetches its inputs.
    pub fetched: Nanos,
    /// End of that frame: a SyncManager is read when the check sequence was found good.
    pub read: Nanos,
    /// End of the frame that brings its outputs: a SyncManager passes them on when the check sequence was
    /// found good.
    pub stored: Nanos,
}

/// The times of each chunk.
pub(crate) fn chunk_times(frames: &[FramePlan], chunks: usize) -> Vec<ChunkTimes> {
    let mut times = vec![ChunkTimes::default(); chunks];
    for frame in frames {
        for datagram in &frame.datagrams {
            let Some(times) = datagram.chunk.and_then(|chunk| times.get_mut(chunk)) else {
                continue;
            };
            if datagram.command != Command::Lwr {
                (times.fetched, times.read) = (frame.begin, frame.end);
            }
            if datagram.command != Command::Lrd {
                times.stored = frame.end;
            }
        }
    }
    times
}

/// Most bytes of a chunk: what fits beside the drift datagram and AL status in one frame.
pub(crate) const MOST_CHUNK: usize =
    ROOM - 3 * DATAGRAM_OVERHEAD - TIME_LEN - isocat_wire::register::Register::<u16>::LEN;

/// Ethernet and EtherCAT headers.
const HEADERS: usize =
    isocat_wire::frame::ETHERNET_HEADER_LEN + isocat_wire::frame::ETHERCAT_HEADER_LEN;
/// Bytes for datagrams in a frame.
const ROOM: usize = MAX_LEN - HEADERS;
const DATAGRAM_OVERHEAD: usize = HEADER_LEN + isocat_wire::datagram::WKC_LEN;
/// Bytes of the system time.
const TIME_LEN: usize = 8;
const ZEROS: [u8; MAX_LEN] = [0; MAX_LEN];
