//! Sends the frames of a cycle and plans their times.

use isocat_wire::command::Command;
use isocat_wire::frame::duration_ns;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::CyclicExchange;
use super::frames::Part;
use crate::board::Board;
use crate::event::Event;
use crate::link::CYCLIC_INDEX;
use crate::segment::GAP;

impl CyclicExchange {
    /// The next frame of the cycle, if one is due.
    pub fn transmit(
        &mut self,
        now: Time<Host>,
        buffer: &mut [u8],
        board: &mut Board,
    ) -> Option<usize> {
        if self.next_frame >= self.frames.len() {
            self.next_frame = 0;
        }
        if self.next_frame == 0 {
            if now < self.due || self.is_open() || self.wait_for_grid(now, board) {
                return None;
            }
            self.begin(now, board);
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
            if *part == Part::Drift
                && let Some(reference) = &self.reference
                && reference.seen
                && !reference.reading
            {
                // The reference overwrites it. If the reference is absent, the clocks behind it use
                // the time that was sent: the host's estimate is near, zeros would pull them away.
                let guess = self.servo.dc_at(now).count().to_le_bytes();
                bytes[layout.data()..layout.wkc()].copy_from_slice(&guess);
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
        self.closing.out += 1;
        self.through = now.max(self.through) + Nanos(duration_ns(frame.bytes.len()) as i64) + GAP;
        board.statistics.frames_sent += 1;
        board.statistics.datagrams += frame.datagrams.len() as u64;
        self.next_frame = self.following(at);
        if self.next_frame >= self.frames.len() {
            let earliest = now.max(self.due) + Nanos(self.cycle.0 / 2);
            self.plan_next(earliest, self.grid + self.cycle);
            board.lead_due = self.due;
        }
        Some(self.frames[at].bytes.len())
    }

    /// The next frame that leaves in this cycle too; the number of frames if there is none.
    fn following(&self, at: usize) -> usize {
        let mut next = at + 1;
        while self.frames.get(next).is_some_and(|frame| {
            frame.every > 1 && !self.slot.is_multiple_of(u64::from(frame.every))
        }) {
            next += 1;
        }
        next
    }

    /// The number of the bus cycle that begins, by the system time at which its frame finds the
    /// reference clock. SYNC pulses count the same number, even if cycles were skipped. Without a
    /// reference it is the count of cycles.
    fn number_by_time(&self, now: Time<Host>) -> u64 {
        if self.reference.is_none() {
            return self.number;
        }
        let into_first = self.servo.dc_at(now.max(self.due)) + -self.send_phase;
        // A frame half a cycle late still belongs to the due cycle, since the next one comes on the
        // grid.
        let cycle = self.cycle.0 as u64;
        into_first.count().saturating_add((cycle - 1) / 2) / cycle
    }

    /// Postpones the cycle if the caller slept past half a cycle or more. The frame then leaves on
    /// the grid again: between grid points it would meet SYNC0 at any phase. Returns true if the
    /// cycle is postponed. That never happens twice in a row, so that a host which is always late
    /// still sends.
    pub(super) fn wait_for_grid(&mut self, now: Time<Host>, board: &mut Board) -> bool {
        let late = now - self.due;
        if self.put_off || late.0 < self.cycle.0 / 2 {
            return false;
        }
        let grid = self.servo.next_grid(now, self.cycle, self.send_phase);
        let due = self.servo.host_at(grid).max(now);
        let skipped = ((due - self.due).0 + self.cycle.0 / 2) / self.cycle.0;
        if due <= now {
            return false;
        }
        self.put_off = true;
        (self.due, self.grid) = (due, grid);
        let skipped = skipped.max(0) as u64;
        board.statistics.cycles_skipped += skipped;
        board.report(Event::CyclesSkipped { cycle: self.number + 1, late, skipped });
        true
    }

    /// Index of the datagrams of a frame: its number in the low bits, above it the low bits of the
    /// cycle's number.
    pub(super) fn index(&self, cycle: u64, frame: usize) -> u8 {
        index(cycle, frame, self.frame_bits)
    }

    /// Whether a frame with this index was given up and is not back yet; it counts as back from now
    /// on.
    pub fn take_given_up(&mut self, index: u8) -> bool {
        let was = self.given_up & bit(index) != 0;
        self.given_up &= !bit(index);
        was
    }

    /// Frames whose indices this cycle reuses are lost for good.
    #[cold]
    fn forget_given_up(&mut self) {
        for at in 0..self.frames.len() {
            self.given_up &= !bit(self.index(self.number, at));
        }
    }

    /// The lowest bits of the cycle's number and the frame's number, from an index.
    pub(super) fn sequence(&self, index: u8) -> (u8, usize) {
        let bits = self.frame_bits;
        ((index & !CYCLIC_INDEX) >> bits, usize::from(index & ((1 << bits) - 1)))
    }

    /// Begins a cycle. Frames that were sent two cycles ago and are not back are lost.
    pub(super) fn begin(&mut self, now: Time<Host>, board: &mut Board) {
        let late = now - self.due;
        // Cycles are only skipped if the cycle was already postponed; otherwise it waits for the
        // grid.
        let skipped = (late.0 / self.cycle.0).max(0) as u64;
        self.put_off = false;
        self.number += 1;
        self.closing.out = 0;
        board.cycle = self.number;
        board.statistics.cycles += 1;
        if skipped > 0 {
            board.statistics.cycles_skipped += skipped;
            board.report(Event::CyclesSkipped { cycle: self.number, late, skipped });
        }
        if self.wanted != self.exchanging || self.stale {
            self.exchanging = self.wanted;
            self.stale = false;
            self.build();
        }
        if self.grouped {
            self.slot = self.number_by_time(now);
        }
        self.choose_drift();
        board.leading = self.reference.as_ref().is_some_and(|reference| !reference.reading);
        if board.leading {
            board.led_at = now;
        }
        let parity = (self.number & 1) as usize;
        if self.given_up != 0 {
            self.forget_given_up();
        }
        if self.exchanging {
            // It is increased here, and any fault resets it.
            board.complete_cycles += 1;
        }
        let bits = self.frame_bits;
        for (at, frame) in self.frames.iter_mut().enumerate() {
            if frame.flights[parity].take().is_some() {
                board.statistics.frames_lost += 1;
                self.given_up |= bit(index(frame.cycles[parity], at, bits));
                // A lost frame tells nothing about the SubDevices: it neither counts nor resets the
                // count.
                board.complete_cycles = board.complete_cycles.saturating_sub(1);
                board.report(Event::FrameLost { cycle: frame.cycles[parity], frame: at });
            }
        }
        if self.reference.as_ref().is_some_and(|reference| reference.compensate) {
            board.statistics.drift_frames += 1;
        }
        self.servo.handle_timeout(now);
        let state = self.servo.state();
        if state != self.last_state {
            self.last_state = state;
            board.report(Event::Phase { cycle: self.number, state });
        }
    }

    /// Plans the next cycle at the first instant from `earliest` on at which its frame finds the
    /// reference at its phase. That is nearly always `grid`, which saves a division.
    pub(super) fn plan_next(&mut self, earliest: Time<Host>, grid: Time<Dc>) {
        (self.due, self.grid) = (self.servo.host_at(grid), grid);
        if !(0..self.cycle.0).contains(&(self.due - earliest).0) {
            self.grid = self.servo.next_grid(earliest, self.cycle, self.send_phase);
            self.due = self.servo.host_at(self.grid).max(earliest);
        }
    }
}

/// Index of the datagrams of a frame; `bits` is the width of the frame's number.
fn index(cycle: u64, frame: usize, bits: u32) -> u8 {
    CYCLIC_INDEX | ((cycle as u8) << bits) & !CYCLIC_INDEX | frame as u8
}

/// The bit of an index in the set of those given up.
fn bit(index: u8) -> u128 {
    1 << (index & !CYCLIC_INDEX)
}
