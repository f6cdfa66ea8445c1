//! Whole cyclic frames in regular operation: what `regular` does datagram by datagram, at once.
//!
//! First it is found whether all of the frame is regular for this ESC, then it is answered. If it
//! is not, nothing was done, and the general path takes the frame. What all ESCs count or add is
//! collected in the frame, and written into it at the end.

use isocat_wire::datagram::Layout;
use isocat_wire::register;
use isocat_wire::time::{Device, Nanos};
use isocat_wire::{Command, Time};

use crate::dc::clock::ceil;
use crate::dc::sync::sync0_cycle;
use crate::esc::{ECAT_AL_STATUS, Esc};
use crate::memory::copy;
use crate::regular::{Area, Areas, Brought, Known, TIME, Usual};
use crate::sync_manager::{Side, Simple};

/// A frame with the datagrams of regular operation, at most one of each kind: one brings the system
/// time, one exchanges process data or one for each direction, and one collects AL status.
///
/// [`read_time`](Self::read_time) comes before the first ESC, and after each ESC that took the
/// frame in another way than [`Esc::pass_cyclic`]. [`finish`](Self::finish) comes after the last.
#[derive(Clone, Default, Debug)]
pub struct CyclicFrame {
    time: Option<Timing>,
    outputs: Option<Exchange>,
    inputs: Option<Exchange>,
    /// Whether outputs and inputs share a datagram, LRW.
    both: bool,
    status: Option<Part>,
    /// See [`numbered`](Self::numbered); 0 without a number.
    number: u64,
    /// The time that it brings now.
    brought: Brought,
    /// The ESCs that took it at once so far, and those of them that took outputs or gave inputs.
    taken: u16,
    written: u16,
    read: u16,
    /// AL status of all of them.
    states: u16,
}

/// A datagram, by its number in the frame and the place of its data in the payload.
#[derive(Clone, Copy, Debug)]
struct Part {
    number: usize,
    at: usize,
}

#[derive(Clone, Copy, Debug)]
struct Timing {
    part: Part,
    /// The station that sends it, or its position as the frame left the MainDevice.
    address: u16,
    by_station: bool,
    len: u8,
}

#[derive(Clone, Copy, Debug)]
struct Exchange {
    part: Part,
    address: u32,
    len: u32,
}

impl CyclicFrame {
    /// The frame of these datagrams; `None` if it has others, or more of a kind.
    pub fn of(datagrams: impl Iterator<Item = (Command, Layout)>) -> Option<Self> {
        let mut frame = Self::default();
        for (number, (command, layout)) in datagrams.enumerate() {
            let (address, len) = (layout.header.address, layout.header.len);
            let part = Part { number, at: layout.data() };
            let exchange = Some(Exchange { part, address, len: len.into() });
            let is_new = match Usual::of(command, address, len.into())? {
                kind @ (Usual::TimeOf | Usual::TimeAt) if matches!(len, 4 | 8) => {
                    let by_station = kind == Usual::TimeOf;
                    let (address, len) = (address as u16, len as u8);
                    frame.time.replace(Timing { part, address, by_station, len }).is_none()
                }
                Usual::TimeOf | Usual::TimeAt => false,
                Usual::Exchange { writes, reads } => {
                    let before =
                        (writes && frame.outputs.is_some(), reads && frame.inputs.is_some());
                    frame.outputs = if writes { exchange } else { frame.outputs };
                    frame.inputs = if reads { exchange } else { frame.inputs };
                    frame.both |= writes && reads;
                    before == (false, false)
                }
                Usual::Status => frame.status.replace(part).is_none(),
            };
            if !is_new {
                return None;
            }
        }
        Some(frame)
    }

    /// The same frame with a number above zero, by which ESCs remember what they found out about
    /// it. Frames with the same number have the same datagrams, and find the ESCs at the same
    /// places.
    pub const fn numbered(self, number: u64) -> Self {
        Self { number, ..self }
    }

    /// See [`numbered`](Self::numbered); 0 without a number.
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Whether it brings the system time, which each ESC takes.
    pub const fn brings_time(&self) -> bool {
        self.time.is_some()
    }

    /// Passes an ESC that only shows it this AL status: see [`Esc::lasting_status`].
    #[inline]
    pub const fn collect(&mut self, status: u16) {
        self.states |= status;
        self.taken = self.taken.wrapping_add(1);
    }

    /// Looks at the time that it brings to the next ESC; `payload` has its datagrams.
    #[inline]
    pub fn read_time(&mut self, payload: &[u8]) {
        let Some(Timing { part, len, .. }) = self.time else { return };
        let len = usize::from(len);
        self.brought = Brought { len: len as u8, ..Brought::NONE };
        self.brought.bytes[..len].copy_from_slice(&payload[part.at..][..len]);
    }

    /// Its part in a cycle: the first frame brings the time, some exchange process data, and the
    /// last one collects AL status.
    #[inline]
    const fn role(&self) -> usize {
        match (self.time.is_some(), self.status.is_some()) {
            (true, false) => 0,
            (false, true) => 1,
            (true, true) => 2,
            (false, false) => 3,
        }
    }

    /// Puts AL status of the ESCs that took it at once into the payload, and returns their working
    /// counter increments: of each datagram its number and their sum. Then it is as before the
    /// first ESC.
    pub fn finish(&mut self, payload: &mut [u8]) -> [(usize, u16); 4] {
        let states = core::mem::take(&mut self.states).to_le_bytes();
        if let Some(status) = self.status {
            for (byte, state) in payload[status.at..].iter_mut().zip(states) {
                *byte |= state;
            }
        }
        let [taken, written, read] =
            [&mut self.taken, &mut self.written, &mut self.read].map(core::mem::take);
        let each = if self.both { 2 } else { 1 };
        [
            self.time.map(|time| (time.part, taken)),
            self.outputs.map(|outputs| (outputs.part, written.wrapping_mul(each))),
            self.inputs.map(|inputs| (inputs.part, read)),
            self.status.map(|status| (status, taken)),
        ]
        .map(|part| part.map_or((0, 0), |(part, count)| (part.number, count)))
    }
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// Passes a frame whose check sequence is right through the ESC at `place`: that many ESCs
    /// before it have incremented the auto-increment addresses. The frame arrives at `start`, ends
    /// at `end`, and has this [label](Self::label_frame); `payload` has its datagrams. What is left
    /// to the caller of [`begin_frame`](Self::begin_frame) is left to the caller here too.
    ///
    /// Returns when the frame's effects come into force, never if it has none. `None`: the frame is
    /// not regular for this ESC, and nothing was done. Then
    /// [`begin_good_frame`](Self::begin_good_frame) and its followers pass it.
    #[inline(always)]
    pub fn pass_cyclic(
        &mut self,
        start: Time<Device>,
        end: impl FnOnce() -> Time<Device>,
        label: u64,
        frame: &mut CyclicFrame,
        place: usize,
        payload: &mut [u8],
    ) -> Option<Time<Device>> {
        if !matches!(self.areas, Known::Usual(_)) && !self.find_cyclic() {
            return None;
        }
        let Known::Usual(areas) = &self.areas else { return None };
        let has_news = self.al.ecat_events() & ECAT_AL_STATUS != 0 && frame.status.is_some();
        if self.flight.end != Time::NEVER || has_news {
            return None;
        }
        let mut seen = self.cyclic.seen[frame.role()];
        if seen.number != frame.number {
            seen = self.cyclic.look_at(areas, frame, place)?;
        }
        debug_assert!(self.lane && self.shadow.is_empty());
        let managers = &mut self.sync_managers;
        managers.begin_frame(true);
        let ram = self.ram.as_mut();
        // Outputs go first: they are taken as received, before inputs replace them.
        if seen.outputs != Seen::NOWHERE {
            let (to, len) = managers.write_whole(&self.cyclic.outputs);
            let at = usize::from(seen.outputs);
            copy(&payload[at..at + len], &mut ram[to..to + len]);
            frame.written = frame.written.wrapping_add(1);
        }
        if seen.inputs != Seen::NOWHERE
            && let Some((from, len)) = managers.read_whole(&self.cyclic.inputs)
        {
            let at = usize::from(seen.inputs);
            copy(&ram[from..from + len], &mut payload[at..at + len]);
            frame.read = frame.read.wrapping_add(1);
        }
        frame.states |= self.registers.load(register::AL_STATUS).0;
        frame.taken = frame.taken.wrapping_add(1);
        let flight = &mut self.flight;
        (flight.start, flight.label, flight.brought) = (start, label, frame.brought);
        (flight.irq, flight.acknowledged, flight.latch_times) = (0, 0, 0);
        (flight.latches, flight.enabled) = (false, [false; 2]);
        flight.is_cyclic = true;
        if seen.sends_time {
            self.send_time(frame, payload);
        }
        if !self.flight.brought.is_none() || self.sync_managers.is_closing() {
            self.flight.end = ceil(end());
        }
        Some(self.flight.end)
    }

    /// What a cyclic frame collects that arrives at `at` and only takes AL status from the ESC. It
    /// changes nothing there, so it need not be [passed](Self::pass_cyclic). `None`: this is not
    /// known, because more comes before it than the end of the frame in flight and, if the device
    /// `bears` it, one SYNC0 pulse.
    #[inline]
    pub fn lasting_status(&self, at: Time<Device>, bears: bool) -> Option<u16> {
        let is_regular = matches!(self.areas, Known::Usual(_)) && self.cyclic.is_open;
        let has_news = self.al.ecat_events() & ECAT_AL_STATUS != 0;
        let rests = self.overdue.is_none() && self.rest_until() > at;
        if !is_regular || has_news || !rests {
            return None;
        }
        let is_alone = self.dc.sync.due() > at || bears && self.second_pulse() > at;
        is_alone.then(|| self.registers.load(register::AL_STATUS).0)
    }

    /// An instant before the second pulse from now on, if SYNC0 alone has pulses.
    fn second_pulse(&self) -> Time<Device> {
        if self.dc.sync.only_sync0().is_none() {
            return Time::ZERO;
        }
        // The clock may get slower on the way there.
        let cycle = sync0_cycle(&self.registers);
        self.dc.sync.due() + Nanos((cycle - cycle / 16) as i64)
    }

    /// Whether it is this ESC that sends the time of the frame, `place` ESCs behind the MainDevice.
    pub fn sends_time_of(&self, frame: &CyclicFrame, place: usize) -> bool {
        let Known::Usual(areas) = &self.areas else { return false };
        frame.time.is_some_and(|time| time.is_sent_by(areas, place))
    }

    /// Puts its time into the frame in flight, for the ESCs behind it.
    #[cold]
    fn send_time(&mut self, frame: &mut CyclicFrame, payload: &mut [u8]) {
        let Some(time) = frame.time else { return };
        self.flight.brought = Brought::NONE;
        let range = TIME..TIME + u16::from(time.len);
        self.dc.show(Side::Ecat, &range, self.flight.start, &mut self.registers);
        let data = &mut payload[time.part.at..][..time.len.into()];
        data.copy_from_slice(self.registers.bytes(range));
        frame.read_time(payload);
    }

    /// Finds the areas after a change.
    #[cold]
    fn find_cyclic(&mut self) -> bool {
        if matches!(self.areas, Known::Nothing) {
            self.look_for_areas();
        }
        if !matches!(self.areas, Known::Usual(_)) {
            return false;
        }
        // Only a frame that is not regular sets them, and then the areas are looked for again.
        self.forget_write_enables();
        true
    }
}

/// How an ESC takes cyclic frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lane {
    /// Whether it takes them at all.
    is_open: bool,
    pub outputs: Simple,
    pub inputs: Simple,
    /// What it found out about the last frames, by the end of their number.
    seen: [Seen; SEEN],
}

impl Lane {
    /// It takes none.
    pub const CLOSED: Self = Self {
        is_open: false,
        outputs: Simple::NONE,
        inputs: Simple::NONE,
        seen: [Seen::NONE; SEEN],
    };

    /// From now on it takes none.
    pub const fn close(&mut self) {
        *self = Self::CLOSED;
    }

    /// From now on it takes them, with these SyncManagers of its areas.
    pub const fn open(&mut self, outputs: Simple, inputs: Simple) {
        (self.is_open, self.outputs, self.inputs) = (true, outputs, inputs);
    }

    /// Looks how an ESC with these areas takes a frame at this place. `None`: it does not.
    #[inline(never)]
    fn look_at(&mut self, areas: &Areas, frame: &CyclicFrame, place: usize) -> Option<Seen> {
        if !self.is_open || frame.time.is_some_and(|time| time.len > areas.time_len) {
            return None;
        }
        let seen = Seen {
            number: frame.number,
            outputs: found(areas.outputs, frame.outputs)?,
            inputs: found(areas.inputs, frame.inputs)?,
            sends_time: frame.time.is_some_and(|time| time.is_sent_by(areas, place)),
        };
        if frame.number > 0 {
            self.seen[frame.role()] = seen;
        }
        Some(seen)
    }
}

/// One for each role of a frame.
const SEEN: usize = 4;

/// What an ESC found out about a frame that it takes.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// The number of the frame.
    number: u64,
    /// Where its outputs and its inputs lie in the payload.
    outputs: u16,
    inputs: u16,
    /// The ESC sends the time, and does not take it.
    sends_time: bool,
}

impl Seen {
    /// No frame has this number.
    const NONE: Self = Self { number: u64::MAX, outputs: 0, inputs: 0, sends_time: false };
    /// It has no such process data in the frame.
    const NOWHERE: u16 = u16::MAX;
}

/// Where an area lies in the payload, if the datagram contains it. `None`: it contains a part only.
fn found(area: Option<Area>, exchange: Option<Exchange>) -> Option<u16> {
    let (Some(area), Some(exchange)) = (area, exchange) else { return Some(Seen::NOWHERE) };
    let Exchange { part, address, len } = exchange;
    let (first, end) = (u64::from(area.logical), u64::from(area.logical) + u64::from(area.length));
    let (from, to) = (u64::from(address), u64::from(address) + u64::from(len));
    if from <= first && end <= to {
        let at = u16::try_from(part.at + (first - from) as usize).ok();
        return at.filter(|at| *at != Seen::NOWHERE);
    }
    (end <= from || to <= first).then_some(Seen::NOWHERE)
}

impl Timing {
    /// Whether an ESC at this place sends the time.
    fn is_sent_by(&self, areas: &Areas, place: usize) -> bool {
        match self.by_station {
            true => areas.stations.contains(&self.address),
            false => self.address.wrapping_add(place as u16) == 0,
        }
    }
}
