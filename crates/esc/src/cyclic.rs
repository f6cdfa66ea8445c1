//! Whole cyclic frames in regular operation: what `regular` does datagram by datagram, at once.
//!
//! First it is found whether all of the frame is regular for this ESC, then it is answered. If it
//! is not, nothing was done, and the general path takes the frame.

use isocat_wire::datagram::Layout;
use isocat_wire::register;
use isocat_wire::time::Device;
use isocat_wire::{Command, Time};

use crate::dc::clock::ceil;
use crate::esc::{ECAT_AL_STATUS, Esc};
use crate::regular::{Areas, Brought, Known, Usual};
use crate::sync_manager::Direction;

/// A frame with the datagrams of regular operation, at most one of each kind: one brings the system
/// time, one exchanges process data or one for each direction, and one collects AL status.
#[derive(Clone, Default, Debug)]
pub struct CyclicFrame {
    time: Option<Timing>,
    outputs: Option<Exchange>,
    inputs: Option<Exchange>,
    /// Whether outputs and inputs share a datagram, LRW.
    both: bool,
    status: Option<Part>,
}

/// A datagram, by its number in the frame and the place of its data in the payload.
#[derive(Clone, Copy, Debug)]
struct Part {
    number: usize,
    at: usize,
    /// The sum of the working counter increments so far.
    count: u16,
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
            let part = Part { number, at: layout.data(), count: 0 };
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

    /// Takes the working counter increments: of each datagram its number and their sum.
    pub fn take_counts(&mut self) -> [(usize, u16); 4] {
        let exchanges = [&mut self.outputs, &mut self.inputs].map(|exchange| exchange.as_mut());
        let [outputs, inputs] = exchanges.map(|exchange| exchange.map(|it| &mut it.part));
        let time = self.time.as_mut().map(|time| &mut time.part);
        [time, outputs, inputs, self.status.as_mut()]
            .map(|part| part.map_or((0, 0), |it| (it.number, core::mem::take(&mut it.count))))
    }
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// Passes a frame whose check sequence is right through the ESC at `place`: that many ESCs
    /// before it have incremented the auto-increment addresses. The frame arrives at `start`, ends
    /// at `end`, and has this [label](Self::label_frame); `payload` has its datagrams. What is left
    /// to the caller of [`begin_frame`](Self::begin_frame) is left to the caller here too.
    ///
    /// `false`: the frame is not regular for this ESC, and nothing was done. Then
    /// [`begin_good_frame`](Self::begin_good_frame) and its followers pass it.
    #[inline]
    pub fn pass_cyclic(
        &mut self,
        (start, end): (Time<Device>, Time<Device>),
        label: u64,
        frame: &mut CyclicFrame,
        place: usize,
        payload: &mut [u8],
    ) -> bool {
        if !matches!(self.areas, Known::Usual(_)) && !self.find_cyclic() {
            return false;
        }
        let Known::Usual(areas) = &self.areas else { return false };
        let is_open = self.flight.end == Time::NEVER && areas.takes_cyclic;
        let is_time_regular = frame.time.is_none_or(|time| time.is_for(areas, place));
        let is_status_regular =
            frame.status.is_none() || self.al.ecat_events() & ECAT_AL_STATUS == 0;
        let outputs = areas.place(Direction::Write, frame.outputs);
        let inputs = areas.place(Direction::Read, frame.inputs);
        let (Ok(outputs), Ok(inputs)) = (outputs, inputs) else { return false };
        if !(is_open && is_time_regular && is_status_regular) {
            return false;
        }
        debug_assert!(self.lane && self.shadow.is_empty());
        self.sync_managers.begin_frame(true);
        let mut brought = Brought::NONE;
        if let Some(time) = &mut frame.time {
            let bytes = &payload[time.part.at..][..time.len.into()];
            match *bytes {
                [a, b, c, d, e, f, g, h] => brought.bytes = [a, b, c, d, e, f, g, h],
                [a, b, c, d] => brought.bytes = [a, b, c, d, 0, 0, 0, 0],
                _ => {}
            }
            brought.len = time.len;
            time.part.count = time.part.count.wrapping_add(1);
        }
        let base = usize::from(register::PROCESS_RAM);
        let ram = self.ram.as_mut();
        // Outputs go first: they are taken as received, before inputs replace them.
        if let (Some(Found { at, len, number }), Some(exchange)) = (outputs, &mut frame.outputs)
            && let Some(place) = self.sync_managers.ecat_whole(Direction::Write, number)
        {
            ram[place - base..][..len].copy_from_slice(&payload[at..][..len]);
            let count = if frame.both { 2 } else { 1 };
            exchange.part.count = exchange.part.count.wrapping_add(count);
        }
        if let (Some(Found { at, len, number }), Some(exchange)) = (inputs, &mut frame.inputs)
            && let Some(place) = self.sync_managers.ecat_whole(Direction::Read, number)
        {
            payload[at..][..len].copy_from_slice(&ram[place - base..][..len]);
            exchange.part.count = exchange.part.count.wrapping_add(1);
        }
        if let Some(status) = &mut frame.status {
            let [low, high] = self.registers.load(register::AL_STATUS).0.to_le_bytes();
            if let [first, second, ..] = &mut payload[status.at..] {
                (*first, *second) = (*first | low, *second | high);
            }
            status.count = status.count.wrapping_add(1);
        }
        let flight = &mut self.flight;
        (flight.start, flight.label, flight.brought) = (start, label, brought);
        (flight.irq, flight.acknowledged, flight.latch_times) = (0, 0, 0);
        (flight.latches, flight.enabled) = (false, [false; 2]);
        if !brought.is_none() || self.sync_managers.is_closing() {
            self.flight.end = ceil(end);
        }
        true
    }

    /// Finds the areas after a change.
    fn find_cyclic(&mut self) -> bool {
        if !matches!(self.areas, Known::Nothing) || self.look_for_areas().is_none() {
            return false;
        }
        // Only a frame that is not regular sets them, and then the areas are looked for again.
        self.forget_write_enables();
        true
    }
}

/// Process data of an ESC in a frame.
struct Found {
    /// The place in the payload, and the number of bytes.
    at: usize,
    len: usize,
    /// Its SyncManager.
    number: usize,
}

/// An area lies partly in a datagram.
struct Cut;

impl Areas {
    /// The place of the outputs ([`Direction::Write`]) or the inputs in the payload, if the
    /// datagram contains them.
    #[inline]
    fn place(&self, way: Direction, exchange: Option<Exchange>) -> Result<Option<Found>, Cut> {
        let (Some(exchange), Some((logical, length, number))) = (exchange, self.area(way)) else {
            return Ok(None);
        };
        let Exchange { part, address, len } = exchange;
        let (first, end) = (u64::from(logical), u64::from(logical) + u64::from(length));
        let (from, to) = (u64::from(address), u64::from(address) + u64::from(len));
        if from <= first && end <= to {
            let at = part.at + (first - from) as usize;
            return Ok(Some(Found { at, len: length.into(), number: number.into() }));
        }
        if end <= from || to <= first { Ok(None) } else { Err(Cut) }
    }
}

impl Timing {
    /// Whether an ESC at this place takes the time, and does not send it.
    #[inline]
    fn is_for(&self, areas: &Areas, place: usize) -> bool {
        self.len <= areas.time_len
            && match self.by_station {
                true => !areas.stations.contains(&Some(self.address)),
                false => self.address.wrapping_add(place as u16) != 0,
            }
    }
}
