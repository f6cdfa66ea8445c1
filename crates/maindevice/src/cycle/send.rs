//! Sends the frames of a cycle and plans their times.

use isocat_wire::command::Command;
use isocat_wire::datagram::WKC_LEN;
use isocat_wire::time::{Dc, Host, Time};

use super::CyclicExchange;
use super::frames::Part;
use super::presence::Reference;
use crate::board::Board;
use crate::event::Event;
use crate::link::CYCLIC_INDEX;

impl CyclicExchange {
    /// Whether a frame of the cycle that has begun is left, or the next cycle is due.
    #[inline]
    pub fn has_frame(&self, now: Time<Host>) -> bool {
        !self.is_sent() || now >= self.due && !self.is_open()
    }

    /// The next frame of the cycle, if one is due.
    #[cfg(test)]
    pub fn transmit(
        &mut self,
        now: Time<Host>,
        buffer: &mut [u8],
        board: &mut Board,
    ) -> Option<usize> {
        self.has_frame(now).then(|| self.transmit_due(now, buffer, board)).flatten()
    }

    /// The next frame of the cycle, if [`Self::has_frame`]; `None` if the cycle is postponed.
    pub fn transmit_due(
        &mut self,
        now: Time<Host>,
        buffer: &mut [u8],
        board: &mut Board,
    ) -> Option<usize> {
        if self.next_frame == 0 {
            if self.wait_for_grid(now, board) {
                return None;
            }
            self.begin(now, board);
        }
        let at = self.next_frame;
        let parity = (self.number & 1) as usize;
        let index = self.index(self.number, at);
        let frame = &mut self.frames[at];
        let len = frame.len;
        // The bytes are written in their order: a frame is long, so none is written twice.
        let (head, mut rest) = buffer.get_mut(..len)?.split_first_chunk_mut()?;
        *head = frame.head;
        for datagram in &frame.datagrams {
            let (header, more) = rest.split_first_chunk_mut()?;
            let (data, more) = more.split_at_mut_checked(datagram.len)?;
            let (counter, more) = more.split_first_chunk_mut()?;
            *header = datagram.header;
            header[1] = index;
            *counter = [0; WKC_LEN];
            rest = more;
            match datagram.part {
                Part::ReadWrite(_) | Part::Write(_) => {
                    data.copy_from_slice(&self.outputs[datagram.image..][..datagram.len]);
                }
                Part::Read(_) => data.fill(0),
                Part::AlStatus => write(data, [0; 2]),
                // The reference overwrites it. If the reference is absent, the clocks behind it use
                // the time that was sent: the host's estimate is near, zeros would pull them away.
                Part::Drift => {
                    let leads = |reference: &&Reference| reference.seen && !reference.reading;
                    let guess = match self.reference.as_ref().filter(leads) {
                        Some(_) => self.servo.dc_at(now),
                        None => Time::ZERO,
                    };
                    write(data, guess.count().to_le_bytes());
                }
                Part::Lead => {
                    let drive = self.drive.as_mut();
                    let value = drive.and_then(|drive| drive.value(now, &self.servo));
                    self.written[parity] = value;
                    let command = if value.is_some() { Command::Fpwr } else { Command::Nop };
                    header[0] = command as u8;
                    write(data, value.unwrap_or(Time::ZERO).count().to_le_bytes());
                }
            }
        }
        if !rest.is_empty() {
            rest.fill(0);
        }
        frame.flights[parity] = Some(now);
        frame.cycles[parity] = self.number;
        frame.planned[parity] = self.grid;
        self.in_flight += 1;
        self.closing.out += 1;
        self.through = now.max(self.through) + frame.wire;
        board.statistics.frames_sent += 1;
        board.statistics.datagrams += frame.datagrams.len() as u64;
        self.next_frame = self.following(at);
        if self.next_frame >= self.frames.len() {
            self.next_frame = 0;
            let earliest = now.max(self.due) + self.half;
            self.plan_next(earliest, self.grid + self.cycle);
            board.lead_due = self.due;
        }
        Some(len)
    }

    /// The next frame that leaves in this cycle too; the number of frames if there is none.
    fn following(&self, at: usize) -> usize {
        let mut next = at + 1;
        if !self.grouped {
            return next;
        }
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
        if self.put_off || late < self.half {
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
        let skipped = if late < self.cycle { 0 } else { late.0 / self.cycle.0 };
        self.put_off = false;
        self.number += 1;
        self.closing.out = 0;
        board.cycle = self.number;
        board.statistics.cycles += 1;
        if skipped > 0 {
            let skipped = skipped as u64;
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
        if self.given_up != 0 {
            self.forget_given_up();
        }
        if self.exchanging {
            // It is increased here, and any fault resets it.
            board.complete_cycles += 1;
        }
        if self.in_flight > 0 {
            self.lose_flights(board);
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

    /// Gives up the flights whose places this cycle takes.
    #[cold]
    fn lose_flights(&mut self, board: &mut Board) {
        let parity = (self.number & 1) as usize;
        let bits = self.frame_bits;
        for (at, frame) in self.frames.iter_mut().enumerate() {
            if frame.flights[parity].take().is_some() {
                self.in_flight -= 1;
                board.statistics.frames_lost += 1;
                self.given_up |= bit(index(frame.cycles[parity], at, bits));
                // A lost frame tells nothing about the SubDevices: it neither counts nor resets the
                // count.
                board.complete_cycles = board.complete_cycles.saturating_sub(1);
                board.report(Event::FrameLost { cycle: frame.cycles[parity], frame: at });
            }
        }
    }

    /// Plans the next cycle at the first instant from `earliest` on at which its frame finds the
    /// reference at its phase. That is nearly always `grid`, which saves a division.
    #[inline(always)]
    pub(super) fn plan_next(&mut self, earliest: Time<Host>, grid: Time<Dc>) {
        (self.due, self.grid) = (self.servo.host_at(grid), grid);
        if !(0..self.cycle.0).contains(&(self.due - earliest).0) {
            self.plan_anew(earliest);
        }
    }

    #[cold]
    fn plan_anew(&mut self, earliest: Time<Host>) {
        self.grid = self.servo.next_grid(earliest, self.cycle, self.send_phase);
        self.due = self.servo.host_at(self.grid).max(earliest);
    }
}

/// Writes the data of a datagram whose length is known.
#[inline]
fn write<const LEN: usize>(data: &mut [u8], value: [u8; LEN]) {
    if let Some(data) = data.first_chunk_mut() {
        *data = value;
    }
}

/// Index of the datagrams of a frame; `bits` is the width of the frame's number.
#[inline]
pub(super) fn index(cycle: u64, frame: usize, bits: u32) -> u8 {
    CYCLIC_INDEX | ((cycle as u8) << bits) & !CYCLIC_INDEX | frame as u8
}

/// The bit of an index in the set of those given up.
fn bit(index: u8) -> u128 {
    1 << (index & !CYCLIC_INDEX)
}
