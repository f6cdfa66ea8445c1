//! The SYNC unit: SYNC0 and SYNC1 pulses at system times.
//!
//! Times in this file are local time plus offset in 64 bits, whatever the width of the counter. On
//! a 32-bit ESC a start time is extended to 64 bits at activation, so that one kind of arithmetic
//! is enough afterwards.

use isocat_wire::Time;
use isocat_wire::dc::{ActivationStatus, SyncActivation};
use isocat_wire::register::{self, al_event};
use isocat_wire::time::{Dc, Device};

use super::clock::{TICK, ceil};
use crate::memory::Registers;

/// An edge of a SYNC signal.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Output {
    /// SYNC0 became active.
    Sync0,
    /// SYNC1 became active.
    Sync1,
}

/// Where an activation happens, in time and on which kind of ESC.
pub(crate) struct Start {
    /// The instant.
    pub now: Time<Device>,
    /// The system time at `now`, in 64 bits.
    pub system: u64,
    /// The ESC has a 64-bit counter.
    pub wide: bool,
    /// Bits 7:3 of 0x0981 exist.
    pub enhanced: bool,
}

/// Which of the bytes that complete a start time were written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct StartWritten {
    /// Byte 0x0993, the last one of 32 bits.
    pub lower: bool,
    /// Byte 0x0997, the last one of 64 bits.
    pub upper: bool,
}

/// The state of the unit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SyncUnit {
    active: bool,
    sync0: Train,
    sync1: Train,
    /// The start time as written; while the unit runs, its register shows the next pulse.
    start: u64,
    implausible: bool,
    /// Register 0x0981 when it was last applied.
    enabled: u8,
    /// Debug pulses that wait, and the instant since which they wait.
    debug: u8,
    debug_at: Time<Device>,
    /// See [`SyncUnit::without_edge`].
    without_edge: [u32; 2],
    /// The due time of SYNC0 may be earlier than its pulse; it is never later.
    rough: bool,
    /// The earliest due time, kept since it is asked for more often than it changes.
    due: Time<Device>,
    /// A SYNC0 pulse is planned and nothing else.
    only_sync0: bool,
}

/// One of the two signals.
#[derive(Clone, Copy, Debug)]
struct Train {
    /// System time of the next pulse, if one is planned.
    next: Option<u64>,
    /// The instant of it.
    due: Time<Device>,
    /// The system time at that instant, if it is known.
    reached: Option<u64>,
    /// System time of the last pulse, whether or not it made an edge.
    last: Option<u64>,
    /// The first pulse of an enabled output is still to come.
    pending: bool,
    /// When the signal falls: never, until acknowledged.
    until: Time<Device>,
}

impl Train {
    const REST: Self = Self {
        next: None,
        due: Time::NEVER,
        reached: None,
        last: None,
        pending: false,
        until: Time::ZERO,
    };

    /// Begins a pulse and returns whether that is an edge. With length 0 the signal stays active
    /// until it is acknowledged.
    #[inline]
    fn raise(&mut self, now: Time<Device>, length: u16) -> bool {
        let edge = now >= self.until;
        self.until = match length {
            0 => Time::NEVER,
            ticks => Time::new(now.count().saturating_add(u64::from(ticks) * TICK)),
        };
        edge
    }

    fn plan(&mut self, instant: &impl Fn(u64) -> (Time<Device>, Option<u64>)) {
        (self.due, self.reached) = self.next.map_or((Time::NEVER, None), instant);
    }
}

impl SyncUnit {
    /// A unit at rest.
    pub const fn new() -> Self {
        Self {
            active: false,
            sync0: Train::REST,
            sync1: Train::REST,
            start: 0,
            implausible: false,
            enabled: 0,
            debug: 0,
            debug_at: Time::NEVER,
            without_edge: [0; 2],
            rough: false,
            due: Time::NEVER,
            only_sync0: false,
        }
    }

    /// Handles a write to the activation register or the start time; both are already in force in
    /// `registers`.
    pub fn activate(&mut self, at: Start, written: StartWritten, registers: &mut Registers) {
        let mut bits = registers.load(register::SYNC_ACTIVATION).0;
        if !at.enhanced {
            bits &= 0x07;
        }
        // A start time of 64 bits is complete with its last byte. One of 32 bits, or one that is
        // extended, is complete with its fourth.
        let extends = at.wide && bits & SyncActivation::EXTEND != 0;
        let whole = if at.wide && !extends { written.upper } else { written.lower };
        if extends && written.lower && !self.active {
            let start = extended(registers.load(register::SYNC_START_TIME) as u32, at.system);
            registers.store(register::SYNC_START_TIME, start);
        }
        if whole && bits & SyncActivation::AUTO != 0 {
            bits |= SyncActivation::ACTIVE;
        }
        if bits & SyncActivation::DEBUG_PULSE != 0 {
            bits &= !SyncActivation::DEBUG_PULSE;
            self.debug = bits & (SyncActivation::SYNC0 | SyncActivation::SYNC1);
            self.debug_at = if self.debug == 0 { Time::NEVER } else { ceil(at.now) };
        }
        registers.store(register::SYNC_ACTIVATION, SyncActivation(bits));
        let active = bits & SyncActivation::ACTIVE != 0;
        if active && !self.active {
            self.start(&at, bits, registers);
        } else if active {
            // An output that is enabled later also waits for its first pulse.
            let enabled = bits & !self.enabled;
            self.sync0.pending |= enabled & SyncActivation::SYNC0 != 0;
            self.sync1.pending |= enabled & SyncActivation::SYNC1 != 0;
        } else if self.active {
            (self.sync0, self.sync1) = (Train::REST, Train::REST);
            self.implausible = false;
            registers.store(register::SYNC_START_TIME, self.start);
        }
        (self.active, self.enabled) = (active, bits);
    }

    fn start(&mut self, at: &Start, bits: u8, registers: &Registers) {
        let written = registers.load(register::SYNC_START_TIME);
        self.start = written;
        // How far ahead the start lies, in the width of the counter.
        let ahead = written.wrapping_sub(at.system);
        let ahead = if at.wide { ahead } else { u64::from(ahead as u32) };
        let near =
            if !at.wide || bits & SyncActivation::NEAR_FUTURE != 0 { 1 << 31 } else { 1 << 63 };
        self.implausible = ahead >= near;
        let at_once = self.implausible && bits & SyncActivation::PLAUSIBILITY != 0;
        let first = match ahead {
            _ if at_once => Some(at.system),
            // For a 64-bit counter the start lies in the past: it comes again in centuries.
            ahead if ahead >= 1 << 63 => None,
            ahead => Some(at.system.wrapping_add(ahead)),
        };
        let pending = |bit: u8| bits & bit != 0;
        self.sync0 = Train { next: first, pending: pending(SyncActivation::SYNC0), ..Train::REST };
        self.sync1 = Train { pending: pending(SyncActivation::SYNC1), ..Train::REST };
    }

    /// Handles a change of the offset by which the system time jumped to `system`. Pulses that it
    /// jumped over are missed.
    pub fn jump(&mut self, now: Time<Device>, cycle: u64, system: u64, wide: bool) {
        if let Some(next) = self.sync0.next {
            let behind = system.wrapping_sub(next) as i64;
            if behind > 0 && self.sync0.due > now {
                // A start that was jumped over comes again when the counter has wrapped.
                let round = if wide { 0 } else { 1 << 32 };
                let step = if self.sync0.last.is_some() && cycle > 0 { cycle } else { round };
                self.sync0.next = (step > 0)
                    .then(|| next.wrapping_add((behind as u64).div_ceil(step).wrapping_mul(step)));
            }
        }
        if let Some(next) = self.sync1.next
            && system.wrapping_sub(next) as i64 > 0
            && self.sync1.due > now
        {
            self.sync1.next = None;
        }
    }

    /// Places the due times. `instant` returns the first instant at which the system time has
    /// reached its argument, and the system time then if that is known at once.
    pub fn schedule(&mut self, instant: impl Fn(u64) -> (Time<Device>, Option<u64>)) {
        self.rough = false;
        if self.active {
            self.sync0.plan(&instant);
            self.sync1.plan(&instant);
        }
        self.note_due();
    }

    /// The system time of the next SYNC0 pulse, if that is all that can be due next.
    #[inline(always)]
    pub fn only_sync0(&self) -> Option<u64> {
        self.sync0.next.filter(|_| self.only_sync0)
    }

    /// Places the next SYNC0 pulse, with the system time at that instant. The caller knows from
    /// [`Self::only_sync0`] that nothing else is due.
    #[inline(always)]
    pub fn place_sync0(&mut self, due: Time<Device>, reached: u64) {
        (self.sync0.due, self.sync0.reached) = (due, Some(reached));
        (self.due, self.rough) = (due, false);
    }

    /// Handles the earliest due time, if it is a SYNC0 pulse as in regular operation: nothing else
    /// is planned, the pulse makes an edge, and the next one is not near. Otherwise does nothing.
    #[inline(always)]
    pub fn fire_sync0(&mut self, registers: &Registers) -> bool {
        let (bits, cycle) = (registers.load(register::SYNC_ACTIVATION), sync0_cycle(registers));
        let (Some(target), Some(system)) = (self.sync0.next, self.sync0.reached) else {
            return false;
        };
        let next = target.wrapping_add(cycle);
        let now = self.due;
        let only_sync0 = SyncActivation::SYNC0 | SyncActivation::SYNC1;
        let is_usual = bits.0 & only_sync0 == SyncActivation::SYNC0 && now >= self.sync0.until;
        let is_far = (NEAR..FAR).contains(&next.wrapping_sub(system));
        if self.rough || !(self.only_sync0 && is_usual && is_far && cycle > 0) {
            return false;
        }
        (self.sync0.pending, self.sync0.last, self.sync0.next) = (false, Some(target), Some(next));
        self.sync0.raise(now, registers.load(register::SYNC_PULSE_LENGTH));
        self.place_roughly(now, next.wrapping_sub(system));
        true
    }

    /// Finds the earliest due time.
    #[inline]
    fn note_due(&mut self) {
        let planned = self.active && self.sync0.next.is_some();
        self.only_sync0 = planned && self.sync1.next.is_none() && self.debug_at == Time::NEVER;
        self.due = self.sync0.due.min(self.sync1.due).min(self.debug_at);
    }

    /// Places the due time behind a SYNC0 pulse at `now`, when the system time is `system`, only
    /// roughly: the exact search waits until the next pulse is near. As a rule a drift frame comes
    /// first and moves the pulse. `false`: the due time must be placed exactly now.
    #[inline]
    pub fn schedule_roughly(&mut self, now: Time<Device>, system: u64) -> bool {
        let Some(next) = self.sync0.next.filter(|_| self.active && self.sync1.next.is_none())
        else {
            return false;
        };
        let ahead = next.wrapping_sub(system);
        let is_near = !(NEAR..FAR).contains(&ahead);
        if !is_near {
            self.place_roughly(now, ahead);
            self.note_due();
        }
        !is_near
    }

    /// Places the next SYNC0 pulse, which is `ahead` ns of local time after `now`, roughly.
    #[inline(always)]
    fn place_roughly(&mut self, now: Time<Device>, ahead: u64) {
        // A tick of 10 ns adds 11 ns at most to the local time.
        let least = ahead * TICK / (TICK + 1) - 2 * TICK;
        self.sync0.due = Time::new(now.count() + least);
        (self.due, self.rough) = (self.sync0.due, true);
    }

    /// The system time at the due time, if it is known and the due time is that of SYNC0.
    #[inline]
    pub fn reached(&self) -> Option<u64> {
        self.sync0.reached.filter(|_| self.sync0.due == self.due)
    }

    /// Whether the due time is rough, so that [`Self::schedule`] must place the next pulse exactly.
    #[inline]
    pub const fn is_rough(&self) -> bool {
        self.rough
    }

    /// When [`Self::fire`] is due.
    #[inline]
    pub const fn due(&self) -> Time<Device> {
        self.due
    }

    /// Handles the earliest due time, at which the system time is `system`. Returns the edge, if
    /// there is one: an output may be off, or its signal may still be active from the pulse before.
    pub fn fire(&mut self, system: u64, registers: &Registers) -> Option<Output> {
        let bits = registers.load(register::SYNC_ACTIVATION);
        let length = registers.load(register::SYNC_PULSE_LENGTH);
        let now = self.due();
        if self.debug_at == now {
            return self.fire_debug(now, length);
        }
        let (next0, next1) = (self.sync0.next, self.sync1.next);
        // If both are due on one tick, the earlier target goes first. At one target SYNC0 goes
        // first, since a SYNC0 that coincides with SYNC1 must not arm it again.
        let sync0_first = self.sync0.due == now
            && (self.sync1.due > now
                || match (next0, next1) {
                    (Some(next0), Some(next1)) => next1.wrapping_sub(next0) as i64 >= 0,
                    _ => true,
                });
        if !sync0_first {
            self.sync1.last = self.sync1.next.take();
            self.sync1.pending = false;
            return self.pulse(Output::Sync1, now, registers);
        }
        let target = next0?;
        (self.sync0.pending, self.sync0.last) = (false, Some(target));
        if self.sync1.next.is_none() && bits.sync1() {
            let delay = registers.load(register::SYNC1_CYCLE);
            self.sync1.next = Some(target.wrapping_add(u64::from(delay)));
        }
        let cycle = sync0_cycle(registers);
        self.sync0.next = (cycle > 0).then(|| {
            let next = target.wrapping_add(cycle);
            let behind = system.wrapping_sub(next) as i64;
            // Pulses that a step of the clock jumped over are missed.
            if behind < 0 {
                next
            } else {
                next.wrapping_add((behind as u64 / cycle + 1).wrapping_mul(cycle))
            }
        });
        self.pulse(Output::Sync0, now, registers)
    }

    /// Handles a cyclic pulse. There is no edge if the output is off or still active from the pulse
    /// before.
    fn pulse(
        &mut self,
        output: Output,
        now: Time<Device>,
        registers: &Registers,
    ) -> Option<Output> {
        let bits = registers.load(register::SYNC_ACTIVATION);
        let (train, on) = match output {
            Output::Sync0 => (&mut self.sync0, bits.sync0()),
            Output::Sync1 => (&mut self.sync1, bits.sync1()),
        };
        if !on {
            return None;
        }
        if train.raise(now, registers.load(register::SYNC_PULSE_LENGTH)) {
            return Some(output);
        }
        let count = &mut self.without_edge[output as usize];
        *count = count.wrapping_add(1);
        None
    }

    /// Number of SYNC0 and SYNC1 pulses since power-on or reset that made no edge, because the
    /// signal was still active from the pulse before: it was not acknowledged yet, or is longer
    /// than the cycle. The counters wrap.
    #[inline]
    pub const fn without_edge(&self) -> [u32; 2] {
        self.without_edge
    }

    fn fire_debug(&mut self, now: Time<Device>, length: u16) -> Option<Output> {
        let sync0 = self.debug & SyncActivation::SYNC0 != 0;
        self.debug &= if sync0 { !SyncActivation::SYNC0 } else { 0 };
        if self.debug == 0 {
            self.debug_at = Time::NEVER;
        }
        if sync0 {
            self.sync0.raise(now, length).then_some(Output::Sync0)
        } else {
            self.sync1.raise(now, length).then_some(Output::Sync1)
        }
    }

    /// The PDI has read 0x098E (SYNC0) or 0x098F (SYNC1): in acknowledge mode the signal falls.
    pub fn acknowledge(&mut self, output: Output) {
        let train = match output {
            Output::Sync0 => &mut self.sync0,
            Output::Sync1 => &mut self.sync1,
        };
        if train.until == Time::NEVER {
            train.until = Time::ZERO;
        }
    }

    /// The SYNC bits of the AL event request: the signals that 0x0151 maps there, if they are
    /// active.
    pub fn al_events(&self, now: Time<Device>, registers: &Registers) -> u32 {
        let mapping = registers.load(register::SYNC_LATCH_CONFIGURATION);
        let mut events = 0;
        if mapping & 0x08 != 0 && now < self.sync0.until {
            events |= al_event::SYNC0;
        }
        if mapping & 0x80 != 0 && now < self.sync1.until {
            events |= al_event::SYNC1;
        }
        events
    }

    /// Updates the status registers.
    pub fn show(&self, now: Time<Device>, registers: &mut Registers) {
        let status = u8::from(self.sync0.pending)
            | u8::from(self.sync1.pending) << 1
            | u8::from(self.implausible) << 2;
        registers.store(register::ACTIVATION_STATUS, ActivationStatus(status));
        let acknowledge_mode = registers.load(register::SYNC_PULSE_LENGTH) == 0;
        let state = |train: &Train| u8::from(acknowledge_mode && now < train.until);
        registers.store(register::SYNC0_STATUS, state(&self.sync0));
        registers.store(register::SYNC1_STATUS, state(&self.sync1));
    }

    /// System times of the next pulses, in 64 bits, which 0x0990 and 0x0998 show. If no more pulses
    /// will come, they show the last ones.
    pub fn next_pulses(&self, registers: &Registers) -> (Option<u64>, Option<u64>) {
        if !self.active {
            return (None, None);
        }
        let sync0 = self.sync0.next.or(self.sync0.last);
        let sync1_on = registers.load(register::SYNC_ACTIVATION).sync1();
        let delay = u64::from(registers.load(register::SYNC1_CYCLE));
        // The next SYNC0 arms SYNC1, unless a SYNC1 is already pending.
        let armed = self.sync0.next.filter(|_| sync1_on).map(|next| next.wrapping_add(delay));
        (sync0, self.sync1.next.or(armed).or(self.sync1.last))
    }

    /// System time of the next pulse of SYNC0.
    pub fn next_sync0(&self) -> Option<Time<Dc>> {
        self.sync0.next.map(Time::new)
    }

    /// Levels of the signals SYNC0 and SYNC1.
    pub fn levels(&self, now: Time<Device>) -> [bool; 2] {
        [now < self.sync0.until, now < self.sync1.until]
    }

    /// Whether 0x0981 bit 0 is in force.
    pub const fn is_active(&self) -> bool {
        self.active
    }
}

/// The next system time with these lower 32 bits, from `system` on.
fn extended(lower: u32, system: u64) -> u64 {
    system.wrapping_add(u64::from(lower.wrapping_sub(system as u32)))
}

/// Register 0x09A0 as the generator uses it, ns. 0 means a single pulse; a cycle is at least
/// [`CYCLE_MIN`].
pub(crate) fn sync0_cycle(registers: &Registers) -> u64 {
    match registers.load(register::SYNC0_CYCLE) {
        0 => 0,
        cycle => u64::from(cycle.max(CYCLE_MIN)),
    }
}

/// Pulses nearer than this are placed exactly at once, ns; so are those farther than any run lasts.
const NEAR: u64 = 10_000;
const FAR: u64 = 1 << 48;
/// Shortest SYNC0 cycle, ns. The register text gives the limit but not the effect of a shorter
/// value. Here a shorter cycle runs as this one and reads back as it was written.
const CYCLE_MIN: u32 = 60;
