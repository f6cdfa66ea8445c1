//! The cyclic exchange: frames built once, sent at the phase planned, allocation-free.
//!
//! All frames of a cycle are in flight together. The first begins with the drift datagram (FRMW of
//! 0x0910): it distributes the reference time and brings it back for the servo. Where the reference
//! clock is led (see `Config::direction`), a write of its 0x0910 follows (FPWR; NOP in a cycle with nothing to
//! write). Then come the chunks of process data and, last, a broadcast read of AL status, by which a SubDevice that
//! leaves its state is noticed in the same cycle. Inputs are taken only from a chunk that counts
//! right, so inputs of one SubDevice are always of one moment; a lost frame is counted and never
//! stops the exchange.
//!
//! A cycle is over when all of its frames are back, at the latest when the next one is due (`complete`). The next one
//! does not begin before that, so that the application has its turn in between.
//!
//! SubDevices whose cycle is k bus cycles have frames of their own, which leave in every k-th bus cycle only: in
//! those whose number by system time is a multiple of k, as their SYNC pulses come. Frames of every cycle go first.

use alloc::vec;
use alloc::vec::Vec;

use isocat_sync::phase::external::Stamps;
use isocat_sync::phase::{Direction, Drive, Servo, Settings, State};
use isocat_wire::frame::duration_ns;
use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::segment::{GAP, ProcessImage, Segment};

mod complete;
mod frames;
mod layout;
mod presence;
mod receive;
mod send;

pub(crate) use complete::Exchanged;
use complete::{Closing, Taken};
use frames::CyclicFrame;
pub(crate) use layout::{MOST_CHUNK, chunk_times, frames};
use presence::{Place, Reference};
pub(crate) use receive::extend;

/// The exchange and its state.
pub(crate) struct CyclicExchange {
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
    /// What `exchanging` becomes with the next cycle.
    wanted: bool,
    source: [u8; 6],
    frames: Vec<CyclicFrame>,
    /// Bits that the number of a frame needs; one is left for the cycle's at least, as the mapping has at most 64.
    frame_bits: u32,
    /// Some of the frames do not leave in every cycle.
    grouped: bool,
    /// The number of the present bus cycle by system time, if some do not.
    slot: u64,
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
    /// The system time that this frame finds at the reference clock.
    grid: Time<Dc>,
    /// The cycle that is due was put off after the caller had slept.
    put_off: bool,
    /// When the port has sent this cycle's frames so far, and the gap behind them.
    through: Time<Host>,
    /// Next frame of this cycle to send; all are sent if it is the number of frames.
    next_frame: usize,
    closing: Closing,
    taken: Taken,
    /// Positions in the order of the image.
    order: Vec<usize>,
    /// The count of SubDevices that last answered.
    answering: u16,
    /// Indices of frames that were given up, a bit for each, until the index is used again.
    given_up: u128,
    /// In a ring, frames reach all clocks in one order however it is cut.
    in_ring: bool,
    /// Last OR of all AL status.
    pub al_status: u16,
    /// Phase errors are counted.
    pub measuring: bool,
    /// The largest of them since it was last taken.
    latest: Option<Nanos>,
}

impl CyclicExchange {
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
        let taken = Taken { chunks: vec![0; image.chunks.len()], ..Taken::default() };
        // Within a group the image follows positions.
        let mut order: Vec<_> = (0..segment.devices.len()).collect();
        order.sort_unstable_by_key(|position| (segment.devices[*position].every, *position));
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
            frame_bits: 0,
            grouped: false,
            slot: 0,
            outputs: vec![0; bytes],
            inputs: vec![0; bytes],
            number: 0,
            due: start,
            grid: Time::ZERO,
            put_off: false,
            through: Time::ZERO,
            next_frame: 0,
            closing: Closing::default(),
            taken,
            order,
            answering: segment.devices.len() as u16,
            given_up: 0,
            in_ring: config.ring.is_some(),
            al_status: 0,
            measuring: false,
            latest: None,
        };
        cycle.take_stock();
        if let Some(reference) = &mut cycle.reference {
            reference.counted = reference.clocks;
            reference.trusted = reference.clocks;
        }
        cycle.build();
        cycle
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

    /// The system time that the next cycle finds at the reference clock.
    pub fn grid(&self) -> Time<Dc> {
        self.grid
    }

    /// Whether all frames of the cycle are out.
    pub fn is_sent(&self) -> bool {
        self.next_frame >= self.frames.len() || self.next_frame == 0
    }

    /// When the port has sent the frames of this cycle that are out, and the gap behind them.
    pub fn through(&self) -> Time<Host> {
        self.through
    }

    /// What the frames of the emptiest cycle leave of it, the gaps taken off.
    pub fn spare(&self) -> Nanos {
        let wire = |frame: &CyclicFrame| duration_ns(frame.bytes.len()) as i64 + GAP.0;
        let always = self.frames.iter().filter(|frame| frame.every == 1);
        self.cycle - Nanos(always.map(wire).sum())
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
}

/// What leads the reference clock, as the configuration has it.
fn drive(config: &crate::Config) -> Option<Drive> {
    match config.direction {
        Direction::FollowReference => None,
        Direction::DriveReference { limits } => Some(Drive::after_host(limits)),
        Direction::External { limits, source } => Some(Drive::after_external(limits, source)),
    }
}
