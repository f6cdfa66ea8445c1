//! The sync engine: the steps that each event starts, and the counters of late ones.

use isocat_sync::object::{ERROR_SETTINGS, INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::{Chain, Event, Step, SyncMode};
use isocat_wire::time::{Device, Time};
use isocat_wire::{Nanos, ObjectAddress};

use crate::description::{Behaviour, MissedEvents};
use crate::dictionary::Values;
use crate::measurement::Measurement;
use crate::misbehaviour::{self, Misbehaviour};
use crate::missed::MissedCounter;
use crate::prepared::{Begins, Occasion, Place, Prepared};
use crate::steps::Steps;

/// The synchronization of a SubDevice: mode, counters and the steps of the present cycle.
#[derive(Clone, Copy, Debug)]
pub struct SyncEngine {
    setup: Setup,
    settings: Settings,
    missed: MissedCounter,
    missed_total: u64,
    cycle_time_too_small: u16,
    shift_time_too_short: u16,
    toggle_failed: u16,
    /// The toggle bit of the outputs that were last fetched.
    toggle: Option<bool>,
    measurement: Measurement,
    /// One bit for each step that an event started and that has not ended.
    running: u8,
    /// Whether outputs became ready (or, without outputs, inputs were read) since the last pulse at
    /// which they must be.
    updated: bool,
    /// Whether outputs were still being mapped at their pulse: they missed their cycle.
    late: bool,
    /// Whether outputs came (or, without outputs, inputs were read) since SAFEOP was entered.
    received: bool,
    last_sync0: Option<Time<Device>>,
    last_sync1: Option<Time<Device>>,
    /// Number of SYNC0 pulses since the last SYNC1.
    sub_cycle: u32,
    timer: Option<Time<Device>>,
    /// When the next SYNC pulses must have come: see [`Self::sync_deadline`].
    deadline: Option<Time<Device>>,
    /// Changes whenever the steps of an event may have changed; it wraps.
    version: u32,
    /// One bit for each event that starts steps.
    starting: u8,
    /// How long the pulses of SYNC0 and SYNC1 may be missing; `None`: no supervision.
    supervision: [Option<Nanos>; 2],
    /// Number of SYNC0 pulses in the cycle of SYNC1.
    sub_cycles: u32,
    /// Whether SYNC0 checks for outputs, and whether it is the pulse at which they must be ready.
    looks_at_sync0: bool,
    expects_at_sync0: bool,
}

/// How the device is synchronized, as found at PREOP to SAFEOP.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Setup {
    /// The steps of each event, the mode, and whether outputs are transmitted.
    pub chain: Chain,
    /// SYNC0 cycle with DC, otherwise the cycle that the MainDevice stated; zero if unknown.
    pub cycle: Nanos,
    /// Register 0x09A4, time from a SYNC0 to SYNC1. Zero if SYNC1 is not used.
    pub sync1: Nanos,
    /// Whether inputs are transmitted.
    pub has_inputs: bool,
    /// Whether SYNC pulses stay active until their status is read.
    pub acknowledge_sync: bool,
}

impl Setup {
    /// Number of SYNC0 pulses in the cycle of SYNC1.
    fn sub_cycles(&self) -> u32 {
        let count = self.sync1.0.checked_div(self.cycle.0).unwrap_or(0) + 1;
        u32::try_from(count).unwrap_or(u32::MAX)
    }

    /// Whether outputs must be ready for SYNC1, and not for each SYNC0.
    fn outputs_are_for_sync1(&self) -> bool {
        self.chain.mode == SyncMode::DcSubordinated
    }
}

/// The entries of the sync objects that the MainDevice wrote since PREOP was entered.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Chosen {
    /// 0x1C32:01.
    pub output_type: bool,
    /// 0x1C33:01.
    pub input_type: bool,
    /// 0x1C32:02 or 0x1C33:02.
    pub cycle: bool,
    /// 0x60C2.
    pub interpolation: bool,
}

impl Chosen {
    /// Whether neither type was written, so that it follows the SYNC unit.
    pub const fn nothing(self) -> bool {
        !self.output_type && !self.input_type
    }
}

/// The engine's settings from the dictionary. All times in ns.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Settings {
    /// 0x1C32:09.
    output_delay: Nanos,
    /// 0x1C32:03, zero if outputs are not shifted.
    output_shift: Nanos,
    /// 0x1C33:09.
    input_delay: Nanos,
    /// 0x1C33:03, zero if inputs are not shifted.
    input_shift: Nanos,
    /// 0x1C32:06.
    calc_and_copy: Nanos,
    /// Period of the local timer.
    period: Nanos,
    /// Limit of the missed events.
    limit: u16,
    /// Rule of the missed events.
    rule: MissedEvents,
}

/// The stack's task after an event.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Reaction {
    /// Start these steps.
    Start(Steps),
    /// Acknowledge and drop outputs that came while the last ones were still in work.
    Drop,
}

/// The same, if the steps are prepared.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Prompt {
    /// Start the steps at this place.
    Start(Place),
    /// Start nothing.
    Nothing,
    /// Acknowledge and drop outputs that came while the last ones were still in work.
    Drop,
}

impl SyncEngine {
    /// An engine that is not in a cycle.
    pub(crate) fn new() -> Self {
        Self {
            setup: Setup::default(),
            settings: Settings::default(),
            missed: MissedCounter::default(),
            missed_total: 0,
            cycle_time_too_small: 0,
            shift_time_too_short: 0,
            toggle_failed: 0,
            toggle: None,
            measurement: Measurement::default(),
            running: 0,
            updated: false,
            late: false,
            received: false,
            last_sync0: None,
            last_sync1: None,
            sub_cycle: 0,
            timer: None,
            deadline: None,
            version: 0,
            starting: 0,
            supervision: [None; 2],
            sub_cycles: 1,
            looks_at_sync0: false,
            expects_at_sync0: false,
        }
    }

    /// The engine after power-off: the steps that were prepared for this one are no longer valid.
    pub(crate) fn renewed(&self) -> Self {
        Self { version: self.version.wrapping_add(1), ..Self::new() }
    }

    /// Starts the cycle at SAFEOP, with all counters at 0.
    pub(crate) fn start(&mut self, now: Time<Device>, setup: Setup) {
        self.clear();
        self.setup = setup;
        self.version = self.version.wrapping_add(1);
        let starts = |event: &Event| !setup.chain.steps(*event).is_empty();
        let starting = Event::ALL.into_iter().filter(starts);
        self.starting = starting.fold(0, |all, event| all | 1 << event as u8);
        let Setup { cycle, sync1, .. } = setup;
        self.supervision = [supervision_time(cycle), supervision_time_sync1(cycle, sync1)];
        self.sub_cycles = setup.sub_cycles();
        self.looks_at_sync0 = setup.chain.looks_for_outputs(Event::Sync0);
        self.note_expectation();
        self.measurement.forget_distances();
        if setup.chain.mode == SyncMode::FreeRun {
            self.timer = Some(now + self.period());
        }
    }

    /// With subordinated cycles outputs must be ready for SYNC1, but the Slave Stack Code counts
    /// each SYNC0.
    fn note_expectation(&mut self) {
        let by_pulse = self.settings.rule == MissedEvents::SlaveStackCode;
        self.expects_at_sync0 = !self.setup.outputs_are_for_sync1() || by_pulse;
    }

    /// Stops the cycle below SAFEOP, with all counters at 0.
    pub(crate) fn stop(&mut self) {
        self.clear();
    }

    /// Stops everything and clears all counters; measured times are kept.
    fn clear(&mut self) {
        *self = Self {
            setup: self.setup,
            settings: self.settings,
            missed_total: self.missed_total,
            measurement: self.measurement,
            version: self.version,
            starting: self.starting,
            supervision: self.supervision,
            sub_cycles: self.sub_cycles,
            looks_at_sync0: self.looks_at_sync0,
            expects_at_sync0: self.expects_at_sync0,
            ..Self::new()
        };
    }

    /// Restores the counters, for a device that does not clear them.
    pub(crate) fn keep_counters(&mut self, before: &Self) {
        self.missed = before.missed;
        self.cycle_time_too_small = before.cycle_time_too_small;
        self.shift_time_too_short = before.shift_time_too_short;
        self.toggle_failed = before.toggle_failed;
    }

    /// Called when OP is requested: earlier missed events do not count.
    pub(crate) fn clear_missed(&mut self) {
        self.missed.clear();
    }

    /// Command of sub-index 08, bit 1: clears all error counters.
    pub(crate) fn reset_counters(&mut self) {
        self.missed.clear();
        self.cycle_time_too_small = 0;
        self.shift_time_too_short = 0;
        self.toggle_failed = 0;
    }

    /// Command of sub-index 08, bit 0: starts a new measurement, or stops it.
    pub(crate) fn measure(&mut self, on: bool) {
        self.measurement.switch(on);
        // How the steps are done depends on it.
        self.version = self.version.wrapping_add(1);
    }

    /// Takes the settings from the dictionary: after power-on and whenever one may have changed.
    pub(crate) fn load_settings(&mut self, dictionary: &Values<'_>) {
        let behaviour = &dictionary.description().behaviour;
        let time = |index, sub| Nanos::from_u32(dictionary.value(index, sub).unwrap_or_default());
        let ignores = behaviour.faults().contains(&Misbehaviour::IgnoresShift);
        let shift = |index, able: bool| {
            if able && !ignores { time(index, sub::SHIFT_TIME) } else { Nanos::ZERO }
        };
        let stated =
            time(OUTPUT_PARAMETER, sub::CYCLE_TIME).max(time(INPUT_PARAMETER, sub::CYCLE_TIME));
        let period = if stated > Nanos::ZERO { stated } else { behaviour.free_run_period };
        self.settings = Settings {
            output_delay: time(OUTPUT_PARAMETER, sub::DELAY_TIME),
            output_shift: shift(OUTPUT_PARAMETER, behaviour.shift_outputs),
            input_delay: time(INPUT_PARAMETER, sub::DELAY_TIME),
            input_shift: shift(INPUT_PARAMETER, behaviour.shift_inputs),
            calc_and_copy: time(OUTPUT_PARAMETER, sub::CALC_AND_COPY_TIME),
            period: period.max(SHORTEST_PERIOD),
            limit: error_limit(dictionary, behaviour),
            rule: behaviour.missed_events,
        };
        if self.timer.is_some() {
            self.setup.cycle = self.settings.period;
        }
        self.note_expectation();
        self.version = self.version.wrapping_add(1);
    }

    /// Handles an event. `new_outputs`: whether the SM2 buffer has outputs that were not fetched;
    /// `op`: whether outputs act.
    pub(crate) fn react(
        &mut self,
        now: Time<Device>,
        event: Event,
        new_outputs: bool,
        op: bool,
    ) -> Reaction {
        let Some(last_sync0) = self.note(now, event, new_outputs, op) else {
            return Reaction::Start(Steps::EMPTY);
        };
        let begins = self.begins(event, last_sync0, new_outputs, op);
        if self.take_up(now, &begins) {
            Reaction::Start(begins.steps)
        } else if event == Event::Sm2 {
            Reaction::Drop
        } else {
            Reaction::Start(Steps::EMPTY)
        }
    }

    /// The same with steps that may be known from an earlier cycle; `prepared` has them at the
    /// place.
    #[inline(always)]
    pub(crate) fn react_prepared<T>(
        &mut self,
        now: Time<Device>,
        event: Event,
        (new_outputs, op): (bool, bool),
        prepared: &mut Prepared<T>,
    ) -> Prompt {
        let Some(last_sync0) = self.note(now, event, new_outputs, op) else {
            return Prompt::Nothing;
        };
        if !last_sync0 && self.starting & 1 << event as u8 == 0 {
            return Prompt::Nothing;
        }
        let occasion = Occasion { event, last_sync0, new_outputs, op };
        let (begins, place) =
            prepared.of(occasion, self.version, || self.begins(event, last_sync0, new_outputs, op));
        if self.take_up(now, begins) {
            if begins.starts == 0 { Prompt::Nothing } else { Prompt::Start(place) }
        } else if event == Event::Sm2 {
            Prompt::Drop
        } else {
            Prompt::Nothing
        }
    }

    /// Counts and measures an event; returns whether it is the last SYNC0 before SYNC1. `None`: it
    /// starts no steps.
    #[inline(always)]
    fn note(
        &mut self,
        now: Time<Device>,
        event: Event,
        new_outputs: bool,
        op: bool,
    ) -> Option<bool> {
        let chain = self.setup.chain;
        let mut last_sync0 = false;
        match event {
            Event::Timer => {
                match self.timer {
                    Some(due) if due <= now => self.timer = Some(self.next_tick(due, now)),
                    _ => return None,
                }
                if self.running != 0 {
                    // Free Run is not bound to the bus: the present pass ends, and this tick is
                    // skipped.
                    return None;
                }
                self.measurement.cycle_begins(now);
            }
            Event::Sync0 if chain.mode.uses_dc() => {
                last_sync0 = self.sync0(now, new_outputs, op);
            }
            Event::Sync1 if chain.mode.uses_sync1() => self.sync1(now, op),
            Event::Sm2 if chain.has_outputs => {
                self.measurement.sm_event(now, chain.mode == SyncMode::SmSynchronous);
                if op {
                    self.missed.event(self.settings.rule);
                }
            }
            Event::Sm3 if !chain.has_outputs => {
                self.received = true;
                self.updated = true;
                if chain.mode.uses_dc() {
                    self.missed.restart();
                } else if chain.mode == SyncMode::SmSynchronous {
                    self.measurement.cycle_begins(now);
                }
                if op {
                    self.missed.event(self.settings.rule);
                }
            }
            _ => {}
        }
        Some(last_sync0)
    }

    /// Starts the steps of an event, unless one of them has not ended since its last start.
    #[inline(always)]
    fn take_up(&mut self, now: Time<Device>, begins: &Begins) -> bool {
        if self.running & begins.wants != 0 {
            increment(&mut self.cycle_time_too_small);
            return false;
        }
        self.running |= begins.starts;
        if begins.too_short {
            increment(&mut self.shift_time_too_short);
        }
        if begins.starts & bit(Step::MapOutputs) != 0 {
            self.measurement.maps_outputs(now);
        }
        true
    }

    /// Drops the steps that the last SYNC0 started, except the mapping of outputs.
    pub(crate) fn abandon(&mut self) {
        self.running &= bit(Step::MapOutputs);
    }

    /// Begins a step. Returns `false` if no event started it.
    #[inline(always)]
    pub(crate) fn begin(&mut self, now: Time<Device>, step: Step) -> bool {
        if !self.is_running(step) {
            return false;
        }
        self.measurement.begins(now, step);
        // If SYNC0 fetches them, outputs have a fixed time to become ready, and act at its end. If
        // they act at SYNC1, that pulse has already checked them, and outputs in work are the next
        // ones.
        let polled =
            self.setup.chain.looks_for_outputs(Event::Sync0) && self.mode() != SyncMode::DcSync1;
        if step == Step::OutputsValid && polled && self.is_running(Step::MapOutputs) && !self.late {
            self.late = true;
            increment(&mut self.shift_time_too_short);
        }
        true
    }

    /// Finishes a step. Returns `false` if it was not started.
    #[inline(always)]
    pub(crate) fn finish(&mut self, now: Time<Device>, step: Step) -> bool {
        let was_running = self.is_running(step);
        self.running &= !bit(step);
        if was_running {
            self.measurement.ends(now, step);
        }
        was_running
    }

    /// Whether missed events are the balance of events and pulses.
    #[inline]
    pub(crate) fn balances(&self) -> bool {
        self.settings.rule == MissedEvents::Balance
    }

    /// Whether times are measured.
    #[inline]
    pub(crate) fn measures(&self) -> bool {
        self.measurement.is_on()
    }

    /// A step that an event started was done as a whole. Its times are not measured.
    #[inline(always)]
    pub(crate) fn ran(&mut self, step: Step) {
        self.running &= !bit(step);
    }

    /// Called when the outputs are mapped. Returns `false` if they missed their SYNC0.
    #[inline(always)]
    pub(crate) fn outputs_ready(&mut self) -> bool {
        let in_time = !core::mem::take(&mut self.late);
        self.updated |= in_time;
        in_time
    }

    /// Called when outputs were fetched from the SM2 buffer; `toggle`: the bit in them that should
    /// change each time.
    #[inline(always)]
    pub(crate) fn outputs_fetched(&mut self, toggle: Option<bool>) {
        self.received = true;
        if toggle.is_some() && self.toggle == toggle {
            increment(&mut self.toggle_failed);
        }
        self.toggle = toggle;
    }

    /// Whether a step was started by an event and has not ended.
    #[inline]
    pub(crate) fn is_running(&self, step: Step) -> bool {
        self.running & bit(step) != 0
    }

    /// Whether outputs came (or, without outputs, inputs were read) since SAFEOP was entered.
    pub(crate) fn received(&self) -> bool {
        self.received
    }

    /// Whether the order of SM2 and SYNC was wrong too often.
    #[inline]
    pub(crate) fn sequence_lost(&self) -> bool {
        self.mode().uses_dc() && self.missed.exceeded(self.settings.rule, self.settings.limit)
    }

    /// Whether a SYNC0 pulse for which outputs are missing leaves the device in OP.
    #[inline]
    pub(crate) fn bears_a_miss(&self) -> bool {
        !self.mode().uses_sync1() && self.missed.bears_a_miss(self.settings.limit)
    }

    /// Whether each used SYNC signal has come since SAFEOP was entered.
    pub(crate) fn sync_seen(&self) -> bool {
        self.last_sync0.is_some() && (self.last_sync1.is_some() || !self.mode().uses_sync1())
    }

    /// When the next pulse of each SYNC signal must have come; `None` before the first pulse and
    /// without supervision.
    #[inline]
    pub(crate) fn sync_deadline(&self) -> Option<Time<Device>> {
        self.deadline
    }

    /// Sets the time of the next pulses, after a SYNC pulse.
    #[inline(always)]
    fn expect_sync(&mut self) {
        let sync0 = self.last_sync0.zip(self.supervision[0]).map(|(last, allowed)| last + allowed);
        self.deadline = match self.last_sync1 {
            None => sync0,
            Some(last) => self.earlier(sync0, last),
        };
    }

    #[inline(never)]
    fn earlier(
        &self,
        sync0: Option<Time<Device>>,
        last_sync1: Time<Device>,
    ) -> Option<Time<Device>> {
        let sync1 = self.supervision[1].map(|allowed| last_sync1 + allowed);
        sync0.zip(sync1).map(|(one, other)| one.min(other)).or(sync0).or(sync1)
    }

    /// When the local timer is due; only with Free Run in SAFEOP and OP.
    #[inline]
    pub(crate) fn timer(&self) -> Option<Time<Device>> {
        self.timer
    }

    /// Whether each SYNC pulse must be acknowledged by reading its status.
    #[inline]
    pub(crate) fn acknowledges_sync(&self) -> bool {
        self.setup.acknowledge_sync
    }

    /// Whether this event checks for outputs.
    #[inline(always)]
    pub(crate) fn looks_for_outputs(&self, event: Event) -> bool {
        match event {
            Event::Sync0 => self.looks_at_sync0,
            _ => self.setup.chain.looks_for_outputs(event),
        }
    }

    /// The present mode, or the last one.
    #[inline]
    pub fn mode(&self) -> SyncMode {
        self.setup.chain.mode
    }

    /// The steps of each event, present or last.
    #[inline]
    pub fn chain(&self) -> Chain {
        self.setup.chain
    }

    /// Time from one run of the application to the next, ns: [`Self::cycle`], or if the application
    /// runs once in several SYNC0 cycles, the cycle of SYNC1.
    #[inline]
    pub(crate) fn application_cycle(&self) -> Nanos {
        let setup = &self.setup;
        if setup.chain.mode == SyncMode::DcSubordinated && setup.chain.application_on_sync1 {
            Nanos(setup.cycle.0.saturating_mul(i64::from(self.sub_cycles)))
        } else {
            setup.cycle
        }
    }

    /// Cycle time, ns: of SYNC0 with DC, of the local timer in Free Run; zero if unknown.
    pub fn cycle(&self) -> Nanos {
        self.setup.cycle
    }

    /// Whether outputs are transmitted.
    #[inline]
    pub fn has_outputs(&self) -> bool {
        self.setup.chain.has_outputs
    }

    /// Whether inputs are transmitted.
    #[inline]
    pub fn has_inputs(&self) -> bool {
        self.setup.has_inputs
    }

    /// 0x1C32:0B, the leaky counter of missed SM events. The same in 0x1C33.
    #[inline]
    pub fn sm_event_missed(&self) -> u16 {
        self.missed.count()
    }

    /// 0x1C32:0C: number of cycles that were not finished when the next began. The same in 0x1C33.
    /// Saturates.
    pub fn cycle_time_too_small(&self) -> u16 {
        self.cycle_time_too_small
    }

    /// 0x1C32:0D: number of cycles with a shift shorter than the hardware's delay. The same in
    /// 0x1C33. Saturates.
    pub fn shift_time_too_short(&self) -> u16 {
        self.shift_time_too_short
    }

    /// 0x1C32:0E: number of outputs whose toggle bit had not changed. The same in 0x1C33.
    /// Saturates.
    pub fn toggle_failed(&self) -> u16 {
        self.toggle_failed
    }

    /// 0x1C32:20: whether too many events were missed, or a cycle was not finished. The same in
    /// 0x1C33.
    pub fn sync_error(&self) -> bool {
        self.missed.count() > self.settings.limit || self.cycle_time_too_small > 0
    }

    /// Number of SYNC0 pulses in OP without their event, since power-on; it is never reset.
    #[inline]
    pub fn missed_events_total(&self) -> u64 {
        self.missed_total
    }

    /// The value of a sub-index of 0x1C32 or 0x1C33 that the engine counts.
    pub(crate) fn counter(&self, address: ObjectAddress) -> Option<u32> {
        if address.index != OUTPUT_PARAMETER && address.index != INPUT_PARAMETER {
            return None;
        }
        Some(match address.sub {
            sub::SM_EVENT_MISSED => u32::from(self.sm_event_missed()),
            sub::CYCLE_TIME_TOO_SMALL => u32::from(self.cycle_time_too_small),
            sub::SHIFT_TIME_TOO_SHORT => u32::from(self.shift_time_too_short),
            sub::TOGGLE_FAILED => u32::from(self.toggle_failed),
            sub::SYNC_ERROR => u32::from(self.sync_error()),
            sub if address.index == OUTPUT_PARAMETER => return self.measurement.distance(sub),
            _ => return None,
        })
    }

    /// The measured value of a time that the device states as 0.
    pub(crate) fn measured(&self, address: ObjectAddress) -> Option<u32> {
        // The cycle is only measured without DC.
        let own = address.sub != sub::CYCLE_TIME || !self.mode().uses_dc();
        // A time that a timer extends is not that of the hardware.
        let shift = match address.index {
            OUTPUT_PARAMETER => self.settings.output_shift,
            _ => self.settings.input_shift,
        };
        let shifted = address.sub == sub::DELAY_TIME && shift > Nanos::ZERO;
        self.measurement.value(address).filter(|_| own && !shifted)
    }

    /// Takes a SYNC0 pulse; returns whether it is the last one before SYNC1.
    #[inline(always)]
    fn sync0(&mut self, now: Time<Device>, new_outputs: bool, op: bool) -> bool {
        self.last_sync0 = Some(now);
        self.expect_sync();
        self.measurement.sync0(now);
        self.sub_cycle = self.sub_cycle.saturating_add(1);
        let last = self.sub_cycle == self.sub_cycles;
        if !self.expects_at_sync0 {
            return last;
        }
        if self.looks_at_sync0 {
            // Only the outputs of this SYNC0 count, not those before it.
            self.updated = new_outputs;
        }
        self.expect_outputs(op);
        last
    }

    #[inline(always)]
    fn sync1(&mut self, now: Time<Device>, op: bool) {
        self.last_sync1 = Some(now);
        self.expect_sync();
        self.measurement.sync1(now);
        self.sub_cycle = 0;
        if self.mode() == SyncMode::DcSync1 && self.is_running(Step::MapOutputs) {
            // SYNC1 comes too soon after the SYNC0 at which they were fetched.
            self.late = true;
            increment(&mut self.shift_time_too_short);
        }
        if !self.expects_at_sync0 {
            self.expect_outputs(op);
        }
    }

    /// Takes the pulse at which outputs must be ready.
    #[inline(always)]
    fn expect_outputs(&mut self, op: bool) {
        // Outputs that are still being mapped, or wait for it, have missed this pulse.
        self.late = self.is_running(Step::MapOutputs)
            && (!self.setup.outputs_are_for_sync1() || self.sub_cycle == 0);
        let updated = core::mem::take(&mut self.updated);
        if updated && self.settings.rule == MissedEvents::Counted {
            self.missed.in_time();
        } else {
            self.count_pulse(updated, op);
        }
    }

    #[inline(never)]
    fn count_pulse(&mut self, updated: bool, op: bool) {
        let grace = if self.setup.outputs_are_for_sync1() { self.sub_cycles } else { 1 };
        self.missed.pulse(updated, op, self.settings.rule, self.settings.limit, grace);
        if op && !updated {
            self.missed_total += 1;
        }
    }

    /// The steps that an event starts if none of them is running.
    fn begins(&self, event: Event, last_sync0: bool, new_outputs: bool, op: bool) -> Begins {
        let chain = self.setup.chain;
        let steps = chain.steps(event);
        let besides = if last_sync0 { chain.steps_of_last_sync0() } else { &[] };
        let wants = steps.iter().chain(besides).fold(0, |all, step| all | bit(*step));
        let mut starts = 0;
        let mut started = Steps::EMPTY;
        let looks = self.setup.chain.looks_for_outputs(event);
        let mut too_short = false;
        // The latch comes before the steps of the same pulse, the mapping of inputs after them.
        let (latch, mapping) = besides.split_at(besides.len().min(1));
        for &step in latch.iter().chain(steps).chain(mapping) {
            let delay = match step {
                Step::MapOutputs if looks && !new_outputs => continue,
                Step::OutputsValid if !op => continue,
                Step::LatchInputs | Step::MapInputs if !self.setup.has_inputs => continue,
                Step::OutputsValid if self.mode().uses_dc() => {
                    let (delay, short) = self.output_delay(event);
                    too_short |= short;
                    delay
                }
                Step::LatchInputs => {
                    let (delay, short) = self.latch_delay(event);
                    too_short |= short;
                    delay
                }
                Step::MapInputs => self.latch_delay(event).0,
                _ => Nanos::ZERO,
            };
            starts |= bit(step);
            started.push(step, delay);
        }
        Begins { steps: started, wants, starts, too_short }
    }

    /// Time from a SYNC pulse to Outputs Valid, and whether the written shift is too short for the
    /// device. The hardware cannot act before its delay is over.
    fn output_delay(&self, event: Event) -> (Nanos, bool) {
        let settings = &self.settings;
        let polled = self.setup.chain.looks_for_outputs(event);
        let copy = if polled { settings.calc_and_copy } else { Nanos::ZERO };
        let least = copy + settings.output_delay;
        // If outputs act at SYNC1, SYNC1 is the shift; with subordinated cycles it is the pulse of
        // the cycle.
        let by_sync1 = event == Event::Sync1 && self.mode() != SyncMode::DcSubordinated;
        let shift = if by_sync1 { Nanos::ZERO } else { settings.output_shift };
        (shift.max(least), shift > Nanos::ZERO && shift < least)
    }

    /// Time from an event to Input Latch, and whether the shift is too short for the device.
    fn latch_delay(&self, event: Event) -> (Nanos, bool) {
        let settings = &self.settings;
        match (self.mode(), event) {
            (SyncMode::DcShiftSync1, _) => (settings.input_delay, false),
            (SyncMode::DcSync1 | SyncMode::FreeRun, _) => (Nanos::ZERO, false),
            _ => {
                let shift = settings.input_shift;
                (shift, shift > Nanos::ZERO && shift < settings.input_delay)
            }
        }
    }

    fn period(&mut self) -> Nanos {
        self.setup.cycle = self.settings.period;
        self.settings.period
    }

    /// The first tick after `now` on the grid of `due`.
    fn next_tick(&mut self, due: Time<Device>, now: Time<Device>) -> Time<Device> {
        let period = self.period().0;
        let passed = (now - due).0 / period + 1;
        due + Nanos(passed.saturating_mul(period))
    }
}

/// How long SYNC0 may be missing, in ticks of 1 ms: 1 tick below 500 us, otherwise a fifth of the
/// cycle in 100 us; the tick of the last pulse is not counted. `None`: no supervision.
fn supervision_time(cycle: Nanos) -> Option<Nanos> {
    let ticks = match cycle.0 {
        ..=0 => return None,
        1..500_000 => 1,
        _ => cycle.0 / 100_000 * 2 / 10,
    };
    Some(Nanos(TICK.0 * (ticks + 1)))
}

/// The same for SYNC1, which comes more rarely than SYNC0 with subordinated cycles.
fn supervision_time_sync1(sync0: Nanos, sync1: Nanos) -> Option<Nanos> {
    let of_sync0 = supervision_time(sync0)?;
    if sync1 < sync0 {
        return Some(of_sync0);
    }
    let half = (of_sync0.0 / TICK.0 - 1) / 2;
    supervision_time(sync0 + sync1).map(|time| time + Nanos(half * TICK.0))
}

/// 0x10F1:02, or the device's own limit.
fn error_limit(dictionary: &Values<'_>, behaviour: &Behaviour) -> u16 {
    let set = dictionary.value(ERROR_SETTINGS, SYNC_ERROR_LIMIT);
    let more = misbehaviour::number(behaviour.faults(), |fault| match *fault {
        Misbehaviour::WrongLimit(more) => Some(more),
        _ => None,
    });
    set.map_or(behaviour.sync_error_limit, |limit| limit.min(u32::from(u16::MAX)) as u16)
        .saturating_add(more.unwrap_or(0))
}

fn bit(step: Step) -> u8 {
    1 << step as u8
}

fn increment(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

/// The tick by which the Slave Stack Code supervises SYNC.
const TICK: Nanos = Nanos::millis(1);
/// Shortest period of the local timer: a stated cycle of a few ns would leave no time for other
/// work.
const SHORTEST_PERIOD: Nanos = Nanos::micros(1);
/// Sub-index of 0x10F1 with the limit of the sync error counter.
const SYNC_ERROR_LIMIT: u8 = 2;

#[cfg(test)]
mod tests {
    use super::*;

    /// Ticks of the Slave Stack Code: 1 below 500 us, 2 for 1 ms, 4 for 2 ms.
    #[test]
    fn supervision_allows_two_pulses_to_be_late() {
        let ticks =
            |us: i64| supervision_time(Nanos::micros(us)).map(|time| time.0 / 1_000_000 - 1);
        assert_eq!(ticks(0), None);
        assert_eq!([62, 499, 500, 900, 999].map(ticks), [Some(1); 5]);
        assert_eq!([1_000, 1_499, 1_500, 2_000].map(ticks), [Some(2), Some(2), Some(3), Some(4)]);
        assert_eq!(ticks(10_000), Some(20));
    }

    #[test]
    fn a_device_of_the_stack_stays_small() {
        use core::mem::size_of;
        // A microcontroller needs no list of misbehaviours.
        let size = size_of::<crate::SubDevice<(), [u8; 0]>>() - size_of::<crate::Misbehaviours>();
        assert!((600..1_200).contains(&size), "{size} bytes without the store");
    }
}
