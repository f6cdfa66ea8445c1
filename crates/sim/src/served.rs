//! A segment in host time: frames come from a MainDevice that is not part of the simulation.
//!
//! True time is the host's clock, counted from the instant at which the segment is switched on. A
//! frame meets the segment at its time of reception, even if it is handled late: the SubDevices see
//! the wire, not the load of the program. Frames that come faster than 100 Mbit/s follow one
//! another as on a cable.
//!
//! The judges work as in a [`World`](crate::world), but do not know the intent: the grid of SYNC0
//! is the one that the MainDevice wrote into each SYNC unit.

use isocat_wire::al::AlState;
use isocat_wire::time::{Dc, Host, Nanos, Picos, Time, True};
use isocat_wire::{frame, register};

use crate::bench::{Bench, Intent, Measured};
use crate::device::{Device, DeviceSetup};
use crate::disturbance::BitError;
use crate::fault::frames::FrameFaults;
use crate::fault::happen::Scene;
use crate::fault::{Fault, Happened, Timeline};
use crate::judge::Grid;
use crate::observation::{Observation, Observed};
use crate::sampling::Sampling;
use crate::segment::{Closing, Connection, Lost, Returned, Segment};
use crate::watcher::Watcher;
use crate::wiring::{End, Hop, MainPort};

/// A segment for frames of any MainDevice.
///
/// - Input: [`frame`](Self::frame) for every frame, [`frame_at`](Self::frame_at) in a ring;
///   [`advance`](Self::advance) from time to time, so that internal events of SubDevices are not
///   seen late.
/// - Observations: [`settle`](Self::settle), best after an answer was sent.
/// - Judging: [`begin_judging`](Self::begin_judging), then [`bench`](Self::bench).
///
/// Host time never goes backwards from call to call; an earlier time counts as the last one.
pub struct Served {
    segment: Segment,
    bench: Bench,
    origin: Time<Host>,
    /// No event happens before this time any more.
    now: Time<True>,
    /// By port: when the last bit of the last frame, and the gap after it, have left the
    /// MainDevice.
    wire_free: [Time<True>; 2],
    /// The events for [`Self::settle`].
    watcher: Watcher,
    /// The last frames with process data: first bit and last bit at the MainDevice's port, and the
    /// port.
    passed: [(Time<True>, Time<True>, MainPort); KEPT],
    passed_next: usize,
    /// Number of SYNC0 edges of each SubDevice while process data passed it.
    clashes: Vec<u64>,
    timeline: Timeline,
    /// The faults of frames at the port.
    port_faults: FrameFaults,
    /// Additional answers: port, when their last bit is back, and the frame.
    copies: Vec<(MainPort, Time<True>, Vec<u8>)>,
}

/// The result of passing a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Passage {
    /// The port of the MainDevice from which it came.
    pub from: MainPort,
    /// When its first bit left the MainDevice.
    pub start: Time<True>,
    /// Whether and when it comes back.
    pub fate: Result<Returned, Lost>,
    /// The part of the delay that a fault caused.
    pub late: Nanos,
}

/// Index of the bit that is flipped in a damaged frame: in its first datagram.
const DAMAGED_BIT: usize = 8 * 20;
/// Number of frames with process data that a SYNC0 edge may meet: more than a cycle has at a time.
const KEPT: usize = 16;

impl Served {
    /// Switches all SubDevices on at `origin`.
    pub fn new(connections: Vec<Connection>, seed: u64, origin: Time<Host>) -> Self {
        let segment = Segment::new(connections, seed);
        let devices = segment.devices().len();
        let mut watcher = Watcher::for_served();
        if segment.devices().iter().any(|device| samples_inputs(device.sampling())) {
            watcher.keep_samples();
        }
        Self {
            bench: Bench::new(devices),
            segment,
            origin,
            now: Time::ZERO,
            wire_free: [Time::ZERO; 2],
            watcher,
            passed: [(Time::ZERO, Time::ZERO, MainPort::Primary); KEPT],
            passed_next: 0,
            clashes: vec![0; devices],
            timeline: Timeline::new(Vec::new(), seed),
            port_faults: FrameFaults::default(),
            copies: Vec::new(),
        }
    }

    /// Adds planned faults. Faults of a host have no effect here: the news report them at their
    /// instants, for programs that simulate the MainDevice's host.
    pub fn with_faults(mut self, timeline: Timeline) -> Self {
        if timeline.spares().any(|spare| samples_inputs(spare.sampling.as_ref())) {
            self.watcher.keep_samples();
        }
        self.timeline = timeline;
        self
    }

    /// Makes it a ring, if there is a closing cable. Panics if a port is not free.
    pub fn in_ring(self, closing: Option<Closing>) -> Self {
        Self { segment: self.segment.in_ring(closing), ..self }
    }

    /// The faults: planned, in force, happened.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// The faults, to report moments and to take news.
    pub fn timeline_mut(&mut self) -> &mut Timeline {
        &mut self.timeline
    }

    /// Lets a fault begin at the instant `at`, or now if that is over, with a duration if one is
    /// given. A [`Fault::Replace`] needs the new SubDevice.
    pub fn inject(
        &mut self,
        at: Time<Host>,
        fault: Fault,
        lasts: Option<Nanos>,
        spare: Option<DeviceSetup>,
    ) {
        if spare.as_ref().is_some_and(|spare| samples_inputs(spare.sampling.as_ref())) {
            self.watcher.keep_samples();
        }
        let fault = match (fault, spare) {
            (Fault::Replace { device, takes, .. }, Some(setup)) => {
                Fault::Replace { device, takes, spare: self.timeline.add_spare(setup) }
            }
            (fault, _) => fault,
        };
        self.timeline.order(self.true_time(at).max(self.now), fault, lasts);
        self.let_faults_happen(self.now);
    }

    /// Takes the link at a port of the MainDevice away now, or restores it, at the MainDevice's end
    /// of the cable.
    pub fn link(&mut self, port: MainPort, up: bool) {
        let Some(Hop { cable, .. }) = self.segment.wiring().hop(End::Main(port)) else { return };
        let at = self.now.max(self.segment.disturbances.latest_change());
        match up {
            true => self.segment.restore_link(cable, at),
            false => self.segment.take_link(cable, at),
        }
    }

    /// Takes the faults that began or ended since the last call.
    pub fn take_news(&mut self) -> Vec<Happened> {
        self.timeline.take_news()
    }

    /// Takes an additional answer, that of a doubled frame: the port, when its last bit is back,
    /// and the frame.
    pub fn take_copy(&mut self) -> Option<(MainPort, Time<True>, Vec<u8>)> {
        self.copies.pop()
    }

    /// Applies all faults up to `to`, each at its instant.
    fn let_faults_happen(&mut self, to: Time<True>) {
        while self.timeline.is_due(to) {
            let due = self.timeline.next().unwrap_or(to).min(to).max(self.now);
            self.now = due;
            let Self { segment, timeline, port_faults, watcher, .. } = self;
            if timeline.next().is_some_and(|at| at <= due) {
                segment.live(due, watcher);
            }
            let mut scene = Scene { segment, host: None, port: port_faults };
            timeline.happen(due, &mut scene, watcher);
            if self.timeline.next().is_none_or(|next| next > to) {
                break;
            }
        }
    }

    /// The point of true time that the host's clock shows; true time zero for earlier times.
    pub fn true_time(&self, at: Time<Host>) -> Time<True> {
        Time::ZERO + Picos::from((at - self.origin).max(Nanos::ZERO))
    }

    /// The host's clock at a point of true time.
    pub fn host_time(&self, at: Time<True>) -> Time<Host> {
        self.origin + Nanos((at.count() / 1000) as i64)
    }

    /// Passes a frame that was received at `arrived` through the segment; the SubDevices answer in
    /// place.
    pub fn frame(&mut self, arrived: Time<Host>, bytes: &mut [u8]) -> Passage {
        self.frame_at(MainPort::Primary, arrived, bytes)
    }

    /// The same for a frame from one of the ports of a ring. Frames of the secondary port have
    /// faults on cables only.
    pub fn frame_at(&mut self, from: MainPort, arrived: Time<Host>, bytes: &mut [u8]) -> Passage {
        let start = self.true_time(arrived).max(self.now).max(self.wire_free[from as usize]);
        self.let_faults_happen(start);
        let [out, back] = match from == MainPort::Primary && self.port_faults.are_any() {
            true => self.port_faults.at_port(),
            false => Default::default(),
        };
        let start = start + Picos::from(out.late);
        let on_wire = bytes.len().max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
        let on_wire = Picos(on_wire as i64 * frame::BYTE_TIME_NS as i64 * 1000);
        self.wire_free[from as usize] = start + on_wire;
        self.now = start;
        let late = out.late + back.late;
        if out.lost {
            return Passage { from, start, fate: Err(Lost::AtThePort), late };
        }
        if out.damaged
            && let Some(Hop { cable, direction, .. }) = self.segment.wiring().hop(End::Main(from))
        {
            self.segment.disturb(BitError { cable, direction, at: start, bit: DAMAGED_BIT });
        }
        let copy = out.doubled.then(|| bytes.to_vec());
        let fate = self.pass(from, bytes, start, start);
        let hurt = |fate: Result<Returned, Lost>| match fate {
            _ if back.lost => Err(Lost::AtThePort),
            Ok(returned) => Ok(Returned {
                first_bit: returned.first_bit + back.late.into(),
                last_bit: returned.last_bit + back.late.into(),
                good: returned.good && !back.damaged,
                ..returned
            }),
            lost => lost,
        };
        let fate = hurt(fate);
        if let (true, Ok(Returned { port, last_bit, good: true, .. })) = (back.doubled, fate) {
            self.copies.push((port, last_bit, bytes.to_vec()));
        }
        if let Some(mut copy) = copy {
            let (first, start) = (start, start.max(self.wire_free[from as usize]));
            self.wire_free[from as usize] = start + on_wire;
            self.now = start;
            let again = self.pass(from, &mut copy, first, start);
            if let Ok(Returned { port, last_bit, good: true, .. }) = hurt(again) {
                self.copies.push((port, last_bit, copy));
            }
        }
        Passage { from, start, fate, late }
    }

    /// Passes a frame, or a copy of the one that left at `first`.
    fn pass(
        &mut self,
        from: MainPort,
        bytes: &mut [u8],
        first: Time<True>,
        start: Time<True>,
    ) -> Result<Returned, Lost> {
        self.segment.pass_copy(from, bytes, (first, start), &mut self.watcher)
    }

    /// Reports that the last frame carried process data: SYNC0 should not meet it.
    pub fn carried_process_data(&mut self, passage: &Passage, len: usize) {
        let end = passage.start + Picos(frame::duration_ns(len) as i64 * 1000);
        self.passed[self.passed_next] = (passage.start, end, passage.from);
        self.passed_next = (self.passed_next + 1) % KEPT;
    }

    /// From now on [`Served::settle`] shows all steps and edges.
    pub fn show_everything(&mut self) {
        self.watcher.keep_everything();
    }

    /// Processes all internal events up to `to`.
    pub fn advance(&mut self, to: Time<Host>) {
        let to = self.true_time(to);
        if to > self.now {
            self.let_faults_happen(to);
            self.now = to;
            self.segment.live(to, &mut self.watcher);
        }
    }

    /// Shows the new events to the judges and to `see`, which also gets the judges' measurements.
    pub fn settle(&mut self, see: &mut impl FnMut(&Segment, &Observation, &Measured)) {
        let mut watcher = std::mem::replace(&mut self.watcher, Watcher::blind());
        let edges = watcher.seen().iter().filter(|it| it.event == Observed::Sync0);
        edges.for_each(|edge| self.look_for_clash(edge));
        let Self { bench, segment, .. } = self;
        bench.observe_each(segment, watcher.seen(), &mut |observation, measured| {
            see(segment, observation, measured);
        });
        watcher.clear();
        self.watcher = watcher;
    }

    /// Begins to judge now: SYNC0 of each SubDevice should keep the grid in its SYNC unit, seen by
    /// the clock of `reference`. The limits are the largest SYNC0 error, and the largest spread of
    /// outputs after their pulse.
    pub fn begin_judging(
        &mut self,
        reference: usize,
        cycle: Nanos,
        (sync0_limit, outputs_spread): (Picos, Picos),
    ) {
        let device = &self.segment.devices()[reference];
        let reference_time = device.esc.system_time(device.oscillator().read(self.now));
        // A clock of 32 bits tells the lower half.
        let whole = |device: &Device, told: u64| -> Time<Dc> {
            let wide = device.esc.register(register::FEATURES) & register::features::DC_64_BIT != 0;
            if wide { Time::new(told) } else { reference_time.nearest(told as u32) }
        };
        let sync0 = self.segment.devices().iter().map(|device| {
            let esc = &device.esc;
            let cycle = esc.register(register::SYNC0_CYCLE);
            let next = esc.register(register::SYNC_START_TIME);
            let in_op = esc.al_status().state() == Ok(AlState::Op);
            if !esc.sync_active() || cycle == 0 || !in_op {
                return None;
            }
            let phase = Nanos(whole(device, next).phase(cycle.into()) as i64);
            Some(Grid { cycle: Nanos::from_u32(cycle), phase })
        });
        let sync0: Vec<Option<Grid>> = sync0.collect();
        let acting = self.segment.devices().iter().zip(&sync0).map(|(device, grid)| {
            let grid = (*grid)?;
            let chain = device.stack.sync().chain();
            if !chain.mode.uses_sync1() {
                return Some(grid);
            }
            // SYNC1 follows the first SYNC0 after the last SYNC1 by its distance.
            let distance = i64::from(device.esc.register(register::SYNC1_CYCLE));
            let cycles = distance.checked_div(grid.cycle.0).unwrap_or(0) + 1;
            let next = whole(device, device.esc.register(register::SYNC1_NEXT));
            let cycle = Nanos(grid.cycle.0 * cycles);
            Some(Grid { cycle, phase: Nanos(next.phase(cycle.0 as u64) as i64) })
        });
        let acting = acting.collect();
        self.segment.device_mut(reference).count_on(self.now, reference_time);
        self.bench.begin(Intent {
            reference,
            send: Grid { cycle, phase: Nanos::ZERO },
            sync0,
            acting,
            exchange: vec![None; self.segment.devices().len()],
            inputs_shifted: Vec::new(),
            sync0_limit,
            outputs_spread,
        });
        self.clashes.fill(0);
    }

    /// The judges.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }
    /// Number of SYNC0 edges of each SubDevice that came while a frame with process data passed it,
    /// since judging began.
    pub fn sync0_in_frame(&self) -> &[u64] {
        &self.clashes
    }
    /// The segment.
    pub fn segment(&self) -> &Segment {
        &self.segment
    }
    /// The segment, to pull its cables and switch off its SubDevices at [`now`](Self::now) or
    /// later.
    pub fn segment_mut(&mut self) -> &mut Segment {
        &mut self.segment
    }
    /// All events up to this time have happened. It may be ahead of the host's clock by the wire
    /// time of frames.
    pub fn now(&self) -> Time<True> {
        self.now
    }

    /// The system time of a SubDevice at a point of true time, ps.
    pub fn system_time_ps(&self, device: usize, at: Time<True>) -> i128 {
        self.segment.devices()[device].system_time_ps(at)
    }

    fn look_for_clash(&mut self, edge: &Observation) {
        // The times that frames from each port take to the SubDevice, if they reach it.
        let after = [MainPort::Primary, MainPort::Secondary].map(|port| {
            let entries = &self.segment.path_from(port).entries;
            // Most segments are lines, where places are positions.
            let entry = entries.get(edge.device).filter(|entry| entry.device == edge.device);
            let entry = entry.or_else(|| entries.iter().find(|entry| entry.device == edge.device));
            entry.map(|entry| entry.after)
        });
        let at = self.segment.devices()[edge.device].oscillator().when(edge.device_at);
        let meets = |(start, end, from): &(Time<True>, Time<True>, MainPort)| {
            let Some(after) = after[*from as usize] else { return false };
            *end > Time::ZERO && *start + after <= at && at <= *end + after
        };
        self.clashes[edge.device] += u64::from(self.passed.iter().any(meets));
    }
}

/// Whether a SubDevice oversamples inputs.
fn samples_inputs(sampling: Option<&Sampling>) -> bool {
    sampling.is_some_and(|sampling| !sampling.inputs.is_empty())
}
