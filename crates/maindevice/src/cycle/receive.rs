//! Takes the data of returned frames whose working counters are right.

use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::CyclicExchange;
use super::frames::Part;
use super::presence::{Place, Reference};
use crate::board::Board;
use crate::event::Event;
use crate::link::CYCLIC_INDEX;

impl CyclicExchange {
    /// Takes a returned frame of the cycle, whose datagrams begin at `start`; `false` if it is not
    /// a frame of the cycle.
    pub fn receive(
        &mut self,
        now: Time<Host>,
        bytes: &[u8],
        start: usize,
        board: &mut Board,
    ) -> bool {
        let Some(&index) = bytes.get(start + 1) else { return false };
        if index < CYCLIC_INDEX {
            return false;
        }
        let (sequence, at) = self.sequence(index);
        let parity = usize::from(sequence & 1);
        let bits = self.frame_bits;
        let Some(frame) = self.frames.get_mut(at) else { return false };
        let Some(sent) = frame.flights[parity] else { return false };
        let (cycle, planned) = (frame.cycles[parity], frame.planned[parity]);
        // An answer that is some cycles late must not count for a later cycle.
        if super::send::index(cycle, at, bits) != index || bytes.len() < frame.used {
            return false;
        }
        if !frame.datagrams.iter().all(|datagram| datagram.mark.is_at(bytes, datagram.start)) {
            return false;
        }
        frame.flights[parity] = None;
        // The list is moved out because `self` is needed while its datagrams are evaluated.
        let datagrams = core::mem::take(&mut frame.datagrams);
        self.in_flight -= 1;
        self.closing.out -= usize::from(cycle == self.number);
        if cycle != self.number {
            board.statistics.frames_behind += 1;
            // A long line may have frames under way for longer than its cycle.
            let way = Nanos(frame.used as i64 * 80 + i64::from(self.count) * MOST_HOP.0);
            board.statistics.frames_slow += u64::from(now - sent >= self.cycle + way);
        }
        board.statistics.frames_received += 1;
        let mut complete = true;
        let mut reference_time = None;
        for datagram in &datagrams {
            let Some((data, wkc)) = datagram.found_in(bytes) else { continue };
            match datagram.part {
                Part::Drift => {
                    reference_time = self.take_time((sent, planned), data, wkc, cycle, board);
                    if reference_time.is_none() && self.in_ring {
                        reference_time = self.take_time_alone(sent, data, cycle, board);
                    }
                    // The next cycle was planned when the frame left; the time that it brought back
                    // improves the plan.
                    if cycle == self.number && self.is_sent() {
                        self.plan_next(sent + self.half, self.grid);
                    }
                }
                Part::Lead => {
                    let Some(written) = self.written[parity].take() else { continue };
                    // The write addresses one SubDevice; with another working counter nothing was
                    // written.
                    board.statistics.working_counter_errors += u64::from(wkc != 1);
                    if let (Some(drive), Some(found), 1) = (&mut self.drive, reference_time, wkc) {
                        drive.came_back(written, found);
                    }
                }
                Part::AlStatus => {
                    self.al_status = data.first_chunk().map_or(0, |data| u16::from_le_bytes(*data));
                    if wkc != self.answering {
                        self.take_count(wkc, cycle, board);
                    }
                }
                Part::ReadWrite(chunk) | Part::Read(chunk) => {
                    let chunk = (chunk, false);
                    complete &= self.take_chunk(chunk, datagram.image, data, wkc, cycle, board);
                }
                Part::Write(chunk) => {
                    let chunk = (chunk, true);
                    complete &= self.take_chunk(chunk, datagram.image, data, wkc, cycle, board);
                }
            }
        }
        if let Some(frame) = self.frames.get_mut(at) {
            frame.datagrams = datagrams;
        }
        // A chunk whose frame did not come back is incomplete too, see `begin`.
        if !complete {
            board.complete_cycles = 0;
        }
        self.servo.handle_timeout(now);
        true
    }

    /// Feeds the servo with the reference time that came back, and returns it. The frame left at
    /// `sent`, and was to find the clock at `planned`.
    #[inline(always)]
    pub(super) fn take_time(
        &mut self,
        (sent, planned): (Time<Host>, Time<Dc>),
        data: &[u8],
        wkc: u16,
        cycle: u64,
        board: &mut Board,
    ) -> Option<Time<Dc>> {
        let reference = self.reference.as_mut()?;
        let as_ever = (wkc, wkc, wkc) == (reference.clocks, reference.counted, reference.trusted);
        if (reference.reading || !as_ever) && !self.take_drift_counter(wkc, cycle, board) {
            return None;
        }
        // Borrowed again, since the working counter may have needed all of `self`.
        let reference = self.reference.as_mut()?;
        let raw = data.first_chunk().map(|raw| u64::from_le_bytes(*raw))?;
        if raw == 0 {
            // The data is unchanged: other clocks answered, but not the reference.
            return None;
        }
        let dc = reference.extend(raw);
        board.reference_time = (sent, dc);
        self.taken.time = (cycle, dc);
        if !reference.reading {
            reference.led = cycle;
        }
        self.servo.sample(sent, dc);
        if self.measuring {
            let error = self.lateness(dc, planned);
            board.statistics.phase_error.add(error);
            self.latest = self.latest.max(Some(error));
        }
        Some(dc)
    }

    /// How much later than planned a frame found the reference clock. The frame is known, so that
    /// one that is almost a cycle late is not taken for an early one.
    #[inline(always)]
    fn lateness(&self, found: Time<Dc>, planned: Time<Dc>) -> Nanos {
        let late = found - planned;
        if late.0.unsigned_abs() <= (MOST_LATE * self.cycle.0).unsigned_abs() {
            return late;
        }
        // No frame is that late: the clock was set, and only the phase is comparable.
        let phase = (found + self.to_phase).phase(self.cycle.0 as u64) as i64;
        Nanos(if phase > self.half.0 { phase - self.cycle.0 } else { phase })
    }

    /// Takes another number of SubDevices that answer.
    #[cold]
    fn take_count(&mut self, found: u16, cycle: u64, board: &mut Board) {
        self.answering = found;
        board.report(Event::CountChanged { cycle, expected: self.count, found });
    }

    /// Takes a working counter of the drift datagram that is not the usual one; returns whether its
    /// data may be used.
    #[cold]
    fn take_drift_counter(&mut self, wkc: u16, cycle: u64, board: &mut Board) -> bool {
        let Some(reference) = &mut self.reference else { return false };
        let expected = if reference.reading { 1 } else { reference.clocks };
        // SubDevices that are about to be admitted answer too.
        let more = wkc > expected && !reference.reading;
        let counted = if more { expected } else { wkc };
        let told = if reference.reading && reference.compensate && wkc == 1 {
            reference.counted
        } else {
            counted
        };
        if told != reference.counted {
            reference.counted = told;
            board.report(Event::Drift { cycle, expected, found: told });
        }
        if !reference.reading && wkc != reference.trusted && !self.in_ring {
            board.way_changes += u64::from(reference.doubted != Some(wkc));
            reference.doubted = Some(wkc);
        }
        if counted != expected {
            board.statistics.working_counter_errors += 1;
            // Without the reference's own access the data is what we sent. With it but without all
            // others, one clock is no longer controlled and the time would still be right, but the
            // working counter cannot tell these cases apart. In a ring it can, see
            // `take_time_alone`.
            return false;
        }
        true
    }

    /// Takes the time in a ring if some clocks did not answer: the time is that of the reference,
    /// or none.
    #[cold]
    fn take_time_alone(
        &mut self,
        sent: Time<Host>,
        data: &[u8],
        cycle: u64,
        board: &mut Board,
    ) -> Option<Time<Dc>> {
        let reference = self.reference.as_mut()?;
        let raw = data.first_chunk().map(|raw| u64::from_le_bytes(*raw)).filter(|raw| *raw > 0)?;
        let dc = reference.extend(raw);
        board.reference_time = (sent, dc);
        self.taken.time = (cycle, dc);
        self.servo.sample(sent, dc);
        Some(dc)
    }

    /// Takes the inputs of a chunk with the right working counter; returns whether it is right.
    #[inline]
    pub(super) fn take_chunk(
        &mut self,
        (at, is_write): (usize, bool),
        image: usize,
        data: &[u8],
        wkc: u16,
        cycle: u64,
        board: &mut Board,
    ) -> bool {
        if let Some(admitted) = self.admitted.get(at)
            && let Some(wrong) = self.wrong.get(at)
            && let Some(taken) = self.taken.chunks.get_mut(at)
            && admitted.is_whole
            && wkc == admitted.counters[usize::from(is_write)]
            && wrong[usize::from(is_write)] == 0
            && let Some(inputs) = self.inputs.get_mut(image..)
            && let Some((inputs, _)) = inputs.split_at_mut_checked(data.len())
        {
            // Inputs that come after those of a later cycle are too late.
            if !is_write && cycle > *taken {
                *taken = cycle;
                inputs.copy_from_slice(data);
            }
            return true;
        }
        self.take_other_chunk((at, is_write), data, wkc, cycle, board)
    }

    /// The same for a chunk with absent SubDevices or with a wrong working counter, now or before.
    #[cold]
    fn take_other_chunk(
        &mut self,
        (at, is_write): (usize, bool),
        data: &[u8],
        wkc: u16,
        cycle: u64,
        board: &mut Board,
    ) -> bool {
        let (chunk, admitted) = (&self.image.chunks[at], self.admitted[at]);
        let expected = admitted.counters[usize::from(is_write)];
        let planned = self.image.counters(chunk.writers, chunk.readers)[usize::from(is_write)];
        // SubDevices that are about to be admitted count as soon as they are mapped.
        let more = self.answering > self.present && (expected..=planned).contains(&wkc);
        let wrong = &mut self.wrong[at][usize::from(is_write)];
        if wkc != expected && !more {
            board.statistics.working_counter_errors += 1;
            board.incomplete = (expected, wkc);
            if *wrong == 0 {
                board.report(Event::WorkingCounter { cycle, chunk: at, expected, found: wkc });
            }
            *wrong += 1;
            return false;
        }
        if !is_write && cycle > self.taken.chunks[at] {
            self.taken.chunks[at] = cycle;
            let from = chunk.logical as usize;
            if admitted.is_whole {
                self.inputs[from..from + usize::from(chunk.length)].copy_from_slice(data);
            } else {
                // For an absent SubDevice our own outputs come back.
                let own = |place: &&Place| place.present && place.chunk == Some(at);
                for Place { inputs, .. } in self.places.iter().filter(own) {
                    let data = &data[inputs.start - from..inputs.end - from];
                    self.inputs[inputs.clone()].copy_from_slice(data);
                }
            }
        }
        let cycles = core::mem::take(wrong);
        if cycles > 0 {
            board.report(Event::WorkingCounterRestored { cycle, chunk: at, cycles });
        }
        true
    }
}

impl Reference {
    /// The time that the data shows, extended to 64 bits.
    #[inline]
    fn extend(&mut self, raw: u64) -> Time<Dc> {
        let dc = match (self.wide, self.seen) {
            (true, _) => Time::new(raw),
            (false, true) => self.last.nearest(raw as u32),
            (false, false) => Time::new(raw & u64::from(u32::MAX)),
        };
        (self.last, self.seen) = (dc, true);
        dc
    }
}

/// The longest way through a SubDevice and the cable before it, there and back: 2 x 1.3 us in the
/// chips and 2 x 0.5 us in 100 m of cable.
const MOST_HOP: Nanos = Nanos(3_600);
/// Cycles by which a frame can be late. After two cycles it is given up, and its time with it.
const MOST_LATE: i64 = 4;
