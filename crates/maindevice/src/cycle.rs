//! The cyclic exchange: frames built once, sent at the planned phase, without allocation.
//!
//! All frames of a cycle are in flight together. The first begins with the drift datagram (FRMW of
//! 0x0910): it distributes the reference time and brings it back for the servo. If the reference
//! clock is controlled (see `Config::direction`), a write of its 0x0910 follows (FPWR; NOP in a
//! cycle with nothing to write). Then come the chunks of process data and, last, a broadcast read
//! of AL status, which shows in the same cycle that a SubDevice left its state. Inputs are taken
//! only from a chunk with the right working counter, so the inputs of one SubDevice are always of
//! one cycle. A lost frame is counted and never stops the exchange.
//!
//! A cycle is complete when all of its frames are back, at the latest when the next one is due
//! (`complete`). The next one does not begin earlier, so that the application is called in between.
//!
//! SubDevices with a cycle of k bus cycles have separate frames, which leave only in every k-th bus
//! cycle: those whose number by system time is a multiple of k, as for the SYNC pulses. Frames of
//! every cycle go first.

use alloc::vec;
use alloc::vec::Vec;

use isocat_sync::phase::external::Stamps;
use isocat_sync::phase::{Direction, Drive, Servo, Settings, State};
use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::segment::{ProcessImage, Segment};

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
use presence::{Admitted, Place, Reference};

/// The cyclic exchange and its state.
pub(crate) struct CyclicExchange {
    cycle: Nanos,
    /// Half of the cycle.
    half: Nanos,
    send_phase: Nanos,
    /// From the moment at which a frame finds the reference clock back to the begin of its cycle.
    to_phase: Nanos,
    servo: Servo,
    /// Number of cycles that the servo needs to lock.
    samples_to_lock: u32,
    last_state: State,
    reference: Option<Reference>,
    /// Controls the reference clock; `None`: it runs freely.
    drive: Option<Drive>,
    /// The time written to the reference clock, by parity of the cycle.
    written: [Option<Time<Dc>>; 2],
    count: u16,
    image: ProcessImage,
    /// Whether process data run; before that only the drift datagram and AL status are sent.
    exchanging: bool,
    /// The value of `exchanging` from the next cycle on.
    wanted: bool,
    source: [u8; 6],
    frames: Vec<CyclicFrame>,
    /// Bits for the number of a frame in the index. At least one bit remains for the cycle's
    /// number, since the mapping has at most 64 frames.
    frame_bits: u32,
    /// Number of flights of all frames.
    in_flight: usize,
    /// Whether some of the frames do not leave in every cycle.
    grouped: bool,
    /// The number of the present bus cycle by system time, if `grouped`.
    slot: u64,
    outputs: Vec<u8>,
    inputs: Vec<u8>,
    /// Number of cycles with a wrong working counter, by chunk: of LRW or LRD, and of LWR.
    wrong: Vec<[u64; 2]>,
    /// By position: the place of its process data, and whether it takes part.
    places: Vec<Place>,
    /// By chunk: what takes part of it.
    admitted: Vec<Admitted>,
    /// Number of SubDevices that take part.
    present: u16,
    /// Whether the frames must be rebuilt with the next cycle.
    stale: bool,
    number: u64,
    /// When the next frame is due, or the cycle being sent.
    due: Time<Host>,
    /// The system time that this frame finds at the reference clock.
    grid: Time<Dc>,
    /// Whether the due cycle was postponed because the caller had slept.
    put_off: bool,
    /// When the port will have sent the frames of this cycle so far, including the gap after them.
    through: Time<Host>,
    /// Next frame of this cycle to send; 0: all are sent.
    next_frame: usize,
    closing: Closing,
    taken: Taken,
    /// Positions in the order of the process image.
    order: Vec<usize>,
    /// Number of SubDevices that last answered.
    answering: u16,
    /// Indices of frames that were given up, one bit each, until the index is used again.
    given_up: u128,
    /// Whether there is a ring. In a ring, frames reach all clocks in one order even if it is cut.
    in_ring: bool,
    /// Last OR of all AL status.
    pub al_status: u16,
    /// Whether phase errors are counted.
    pub measuring: bool,
    /// The largest phase error since it was last taken.
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
        order.sort_by_cached_key(|position| u64::from(segment.devices[*position].every));
        let send_phase = segment.timing.as_ref().map_or(Nanos::ZERO, |timing| timing.cycle.send);
        let mut cycle = Self {
            cycle: config.cycle,
            half: Nanos(config.cycle.0 / 2),
            send_phase,
            to_phase: -send_phase,
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
            in_flight: 0,
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

    /// How long locking may take, at least `patience`.
    pub fn lock_patience(&self, patience: Nanos) -> Nanos {
        patience.max(Nanos(self.cycle.0 * 4 * i64::from(self.samples_to_lock)))
    }

    /// Begins or ends the exchange of process data, with the next cycle.
    pub fn exchange_process_data(&mut self, on: bool) {
        self.wanted = on;
    }

    /// Whether the host is locked onto the reference clock; always true without a reference clock.
    pub fn is_locked(&self) -> bool {
        self.reference.is_none() || self.servo.state() == State::Locked
    }

    /// The servo.
    pub fn servo(&self) -> &Servo {
        &self.servo
    }

    /// The control of the reference clock, if it is controlled.
    pub fn drive(&self) -> Option<&Drive> {
        self.drive.as_ref()
    }

    /// Takes stamps of an external time.
    pub fn external_stamps(&mut self, stamps: Stamps) {
        if let Some(drive) = &mut self.drive {
            drive.stamps(stamps, &self.servo);
        }
    }

    /// Number of cycles begun.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// When the next cycle is due.
    pub fn due(&self) -> Time<Host> {
        self.due
    }

    /// The system time at which the next cycle finds the reference clock.
    pub fn grid(&self) -> Time<Dc> {
        self.grid
    }

    /// Whether all frames of the cycle are sent.
    pub fn is_sent(&self) -> bool {
        self.next_frame == 0
    }

    /// When the port will have sent the frames of this cycle so far, including the gap after them.
    pub fn through(&self) -> Time<Host> {
        self.through
    }

    /// The wire time that the frames of the emptiest cycle leave free, less the gaps.
    pub fn spare(&self) -> Nanos {
        let wire = |frame: &CyclicFrame| frame.wire.0;
        let always = self.frames.iter().filter(|frame| frame.every == 1);
        self.cycle - Nanos(always.map(wire).sum())
    }

    /// Number of frames in flight.
    pub fn in_flight(&self) -> usize {
        self.in_flight
    }

    /// The outputs of the process image.
    pub fn outputs_mut(&mut self) -> &mut [u8] {
        &mut self.outputs
    }

    /// The inputs of the process image.
    pub fn inputs(&self) -> &[u8] {
        &self.inputs
    }
}

/// The control of the reference clock, by the configuration.
fn drive(config: &crate::Config) -> Option<Drive> {
    match config.direction {
        Direction::FollowReference => None,
        Direction::DriveReference { limits } => Some(Drive::after_host(limits)),
        Direction::External { limits, source } => Some(Drive::after_external(limits, source)),
    }
}
