//! The sync engine: which event starts which steps, and what is counted when one comes too late.

use isocat_sync::object::{ERROR_SETTINGS, INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::{Event, Step, SyncMode};
use isocat_wire::time::{Device, Time};
use isocat_wire::{Nanos, ObjectAddress};

use crate::description::{Behaviour, MissedEvents};
use crate::dictionary::Dictionary;
use crate::missed::MissedCounter;
use crate::steps::Steps;

/// The synchronization of a SubDevice: mode, counters and what is under way in the present cycle.
#[derive(Clone, Copy, Debug)]
pub struct SyncEngine {
    setup: Setup,
    settings: Settings,
    missed: MissedCounter,
    missed_total: u64,
    cycle_time_too_small: u16,
    shift_time_too_short: u16,
    /// One bit a step: started by an event and not yet finished.
    running: u8,
    /// Since the last SYNC0: the outputs are ready, or (without outputs) the inputs were read.
    updated: bool,
    /// A SYNC0 came while the outputs were still being mapped: they missed their cycle.
    late: bool,
    /// Outputs came since SAFEOP was entered; without outputs: the inputs were read.
    received: bool,
    last_sync0: Option<Time<Device>>,
    timer: Option<Time<Device>>,
}

/// How the device is synchronized, as found at PREOP to SAFEOP.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Setup {
    /// The mode.
    pub mode: SyncMode,
    /// SYNC0 cycle with DC, else the cycle that the MainDevice stated; zero if unknown.
    pub cycle: Nanos,
    /// Outputs are transmitted.
    pub has_outputs: bool,
    /// Inputs are transmitted.
    pub has_inputs: bool,
    /// SYNC0 stays active until its status is read.
    pub acknowledge_sync0: bool,
}

/// Which entries of the sync objects the MainDevice wrote since PREOP was entered.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct Chosen {
    /// 0x1C32:01.
    pub output_type: bool,
    /// 0x1C33:01.
    pub input_type: bool,
    /// 0x1C32:02 or 0x1C33:02.
    pub cycle: bool,
}

impl Chosen {
    /// Neither type was written: it follows the SYNC unit.
    pub const fn nothing(self) -> bool {
        !self.output_type && !self.input_type
    }
}

/// What the engine takes from the dictionary. All times in ns.
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
    /// Period of the local timer.
    period: Nanos,
    /// Limit of the missed events.
    limit: u16,
    /// Rule of the missed events.
    rule: MissedEvents,
}

/// What an event asks of the stack.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Reaction {
    /// These steps start.
    Start(Steps),
    /// Outputs came while the last ones are still in work: they are acknowledged and dropped.
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
            running: 0,
            updated: false,
            late: false,
            received: false,
            last_sync0: None,
            timer: None,
        }
    }

    /// SAFEOP is entered: the cycle begins, all counters at 0.
    pub(crate) fn start(&mut self, now: Time<Device>, setup: Setup) {
        let total = self.missed_total;
        let settings = self.settings;
        *self = Self { setup, settings, missed_total: total, ..Self::new() };
        if setup.mode == SyncMode::FreeRun {
            self.timer = Some(now + self.period());
        }
    }

    /// SAFEOP is left downwards: nothing runs, all counters at 0.
    pub(crate) fn stop(&mut self) {
        *self = Self {
            setup: self.setup,
            settings: self.settings,
            missed_total: self.missed_total,
            ..Self::new()
        };
    }

    /// OP is asked for: the missed events so far do not count.
    pub(crate) fn clear_missed(&mut self) {
        self.missed.clear();
    }

    /// Command of sub-index 08, bit 1: all error counters at 0.
    pub(crate) fn reset_counters(&mut self) {
        self.missed.clear();
        self.cycle_time_too_small = 0;
        self.shift_time_too_short = 0;
    }

    /// Takes the settings from the dictionary: after power-on and whenever one may have changed.
    pub(crate) fn load_settings<S: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        dictionary: &Dictionary<S>,
    ) {
        let behaviour = &dictionary.description().behaviour;
        let time = |index, sub| Nanos::from_u32(dictionary.value(index, sub).unwrap_or_default());
        let shift = |index, able| if able { time(index, sub::SHIFT_TIME) } else { Nanos::ZERO };
        let stated =
            time(OUTPUT_PARAMETER, sub::CYCLE_TIME).max(time(INPUT_PARAMETER, sub::CYCLE_TIME));
        let period = if stated > Nanos::ZERO { stated } else { behaviour.free_run_period };
        self.settings = Settings {
            output_delay: time(OUTPUT_PARAMETER, sub::DELAY_TIME),
            output_shift: shift(OUTPUT_PARAMETER, behaviour.shift_outputs),
            input_delay: time(INPUT_PARAMETER, sub::DELAY_TIME),
            input_shift: shift(INPUT_PARAMETER, behaviour.shift_inputs),
            period: period.max(SHORTEST_PERIOD),
            limit: error_limit(dictionary, behaviour),
            rule: behaviour.missed_events,
        };
        if self.timer.is_some() {
            self.setup.cycle = self.settings.period;
        }
    }

    /// An event came. `new_outputs`: the SM2 buffer holds outputs not yet fetched; `op`: outputs act.
    pub(crate) fn react(
        &mut self,
        now: Time<Device>,
        event: Event,
        new_outputs: bool,
        op: bool,
    ) -> Reaction {
        match event {
            Event::Timer => {
                match self.timer {
                    Some(due) if due <= now => self.timer = Some(self.next_tick(due, now)),
                    _ => return Reaction::Start(Steps::EMPTY),
                }
                if self.running != 0 {
                    // Not bound to the bus: the present pass ends, this tick is left out.
                    return Reaction::Start(Steps::EMPTY);
                }
            }
            Event::Sync0 if self.setup.mode.uses_dc() => self.sync0(now, op),
            Event::Sm3 if !self.setup.has_outputs => {
                self.received = true;
                self.updated = true;
                if self.setup.mode.uses_dc() {
                    self.missed.restart();
                }
            }
            _ => {}
        }
        let steps = self.setup.mode.steps(event, self.setup.has_outputs);
        if steps.iter().any(|&step| self.running & bit(step) != 0) {
            increment(&mut self.cycle_time_too_small);
            return if event == Event::Sm2 {
                Reaction::Drop
            } else {
                Reaction::Start(Steps::EMPTY)
            };
        }
        Reaction::Start(self.start_steps(event, steps, new_outputs, op))
    }

    /// The steps that the last SYNC0 started are not done; outputs in work are.
    pub(crate) fn abandon(&mut self) {
        self.running &= bit(Step::MapOutputs);
    }

    /// A step has ended. `false` if it was not under way.
    pub(crate) fn finish(&mut self, step: Step) -> bool {
        let was_running = self.is_running(step);
        self.running &= !bit(step);
        was_running
    }

    /// The outputs are mapped. `false` if they missed the SYNC0 they were for.
    pub(crate) fn outputs_ready(&mut self) -> bool {
        let in_time = !core::mem::take(&mut self.late);
        self.updated |= in_time;
        in_time
    }

    /// Outputs were fetched from the SM2 buffer.
    pub(crate) fn outputs_fetched(&mut self) {
        self.received = true;
    }

    /// Whether a step was started by an event and has not ended.
    pub(crate) fn is_running(&self, step: Step) -> bool {
        self.running & bit(step) != 0
    }

    /// Whether outputs came since SAFEOP was entered (without outputs: the inputs were read).
    pub(crate) fn received(&self) -> bool {
        self.received
    }

    /// Whether the order of SM2 and SYNC0 was wrong too often.
    pub(crate) fn sequence_lost(&self) -> bool {
        self.setup.mode.uses_dc() && self.missed.exceeded(self.settings.rule, self.settings.limit)
    }

    /// Whether a SYNC0 was ever seen since SAFEOP was entered.
    pub(crate) fn sync0_seen(&self) -> bool {
        self.last_sync0.is_some()
    }

    /// Until when the next SYNC0 must come; `None` before the first and without supervision.
    pub(crate) fn sync0_deadline(&self) -> Option<Time<Device>> {
        let allowed = supervision_time(self.setup.cycle)?;
        if !self.setup.mode.uses_dc() {
            return None;
        }
        self.last_sync0.map(|last| last + allowed)
    }

    /// When the local timer is due; Free Run in SAFEOP and OP only.
    pub(crate) fn timer(&self) -> Option<Time<Device>> {
        self.timer
    }

    /// Whether each SYNC0 must be acknowledged by reading its status.
    pub(crate) fn acknowledges_sync0(&self) -> bool {
        self.setup.acknowledge_sync0
    }

    /// The mode in use, or last used.
    pub fn mode(&self) -> SyncMode {
        self.setup.mode
    }

    /// Cycle time, ns: of SYNC0 with DC, of the local timer in Free Run; zero if unknown.
    pub fn cycle(&self) -> Nanos {
        self.setup.cycle
    }

    /// Whether outputs are transmitted.
    pub fn has_outputs(&self) -> bool {
        self.setup.has_outputs
    }

    /// Whether inputs are transmitted.
    pub fn has_inputs(&self) -> bool {
        self.setup.has_inputs
    }

    /// 0x1C32:0B, the leaky counter of missed SM events. The same in 0x1C33.
    pub fn sm_event_missed(&self) -> u16 {
        self.missed.count()
    }

    /// 0x1C32:0C: a cycle was not finished when the next began. The same in 0x1C33. Saturates.
    pub fn cycle_time_too_small(&self) -> u16 {
        self.cycle_time_too_small
    }

    /// 0x1C32:0D: the shift is shorter than the hardware's delay. The same in 0x1C33. Saturates.
    pub fn shift_time_too_short(&self) -> u16 {
        self.shift_time_too_short
    }

    /// 0x1C32:20: too many events missed, or a cycle not finished. The same in 0x1C33.
    pub fn sync_error(&self) -> bool {
        self.missed.count() > self.settings.limit || self.cycle_time_too_small > 0
    }

    /// SYNC0 pulses in OP that came without their event, since power-on; nothing resets it.
    pub fn missed_events_total(&self) -> u64 {
        self.missed_total
    }

    /// The value of a sub-index of 0x1C32 or 0x1C33 that the engine counts itself.
    pub(crate) fn counter(&self, address: ObjectAddress) -> Option<u32> {
        if address.index != OUTPUT_PARAMETER && address.index != INPUT_PARAMETER {
            return None;
        }
        Some(match address.sub {
            sub::SM_EVENT_MISSED => u32::from(self.sm_event_missed()),
            sub::CYCLE_TIME_TOO_SMALL => u32::from(self.cycle_time_too_small),
            sub::SHIFT_TIME_TOO_SHORT => u32::from(self.shift_time_too_short),
            sub::SYNC_ERROR => u32::from(self.sync_error()),
            _ => return None,
        })
    }

    fn sync0(&mut self, now: Time<Device>, op: bool) {
        self.last_sync0 = Some(now);
        // Outputs that are still being mapped, or wait for it, have missed this pulse.
        self.late = self.is_running(Step::MapOutputs);
        let updated = core::mem::take(&mut self.updated);
        self.missed.sync0(updated, self.settings.rule, self.settings.limit);
        if op && !updated {
            self.missed_total += 1;
        }
    }

    fn start_steps(&mut self, event: Event, steps: &[Step], new_outputs: bool, op: bool) -> Steps {
        let mut started = Steps::EMPTY;
        let with_sync = self.setup.mode.uses_dc();
        let settings = self.settings;
        let mut too_short = false;
        for &step in steps {
            let delay = match step {
                Step::MapOutputs if event == Event::Timer && !new_outputs => continue,
                Step::OutputsValid if !op => continue,
                Step::LatchInputs | Step::MapInputs if !self.setup.has_inputs => continue,
                Step::OutputsValid if with_sync => {
                    let shifted = settings.output_shift > Nanos::ZERO;
                    too_short |= shifted && settings.output_shift < settings.output_delay;
                    // The hardware can't act before its delay is over.
                    settings.output_shift.max(settings.output_delay)
                }
                Step::LatchInputs if settings.input_shift > Nanos::ZERO => {
                    too_short |= settings.input_shift < settings.input_delay;
                    settings.input_shift
                }
                Step::MapInputs => settings.input_shift,
                _ => Nanos::ZERO,
            };
            self.running |= bit(step);
            started.push(step, delay);
        }
        if too_short {
            increment(&mut self.shift_time_too_short);
        }
        started
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

/// How long SYNC0 may stay away: counted by a tick of 1 ms, 1 tick below 500 us, else a fifth of the
/// cycle in 100 us; the tick in which the last pulse came is not counted. `None`: no supervision.
fn supervision_time(cycle: Nanos) -> Option<Nanos> {
    let ticks = match cycle.0 {
        ..=0 => return None,
        1..500_000 => 1,
        _ => cycle.0 / 100_000 * 2 / 10,
    };
    Some(Nanos::millis(ticks + 1))
}

/// 0x10F1:02, or the device's own limit.
fn error_limit<S: AsRef<[u8]> + AsMut<[u8]>>(
    dictionary: &Dictionary<S>,
    behaviour: &Behaviour,
) -> u16 {
    let set = dictionary.value(ERROR_SETTINGS, SYNC_ERROR_LIMIT);
    set.map_or(behaviour.sync_error_limit, |limit| limit.min(u32::from(u16::MAX)) as u16)
}

fn bit(step: Step) -> u8 {
    1 << step as u8
}

fn increment(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}

/// Shortest period of the local timer: a stated cycle of a few ns would leave no time for anything.
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
        let size = core::mem::size_of::<crate::SubDevice<(), [u8; 0]>>();
        assert!((3_500..4_096).contains(&size), "{size} bytes without the values");
    }
}
