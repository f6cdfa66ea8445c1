//! The SubDevice: everything that runs on the local CPU behind the ESC's PDI.

use isocat_esc::{Pdi, PdiExt};
use isocat_sync::object::INTERPOLATION_TIME;
use isocat_sync::{Event, Step, interpolation};
use isocat_wire::register::{self, al_event};
use isocat_wire::time::{Device, Time};
use isocat_wire::{AlState, AlStatusCode, Nanos, ObjectAddress};

use crate::application::Application;
use crate::description::Description;
use crate::dictionary::Dictionary;
use crate::esm::Esm;
use crate::mailbox::Mailbox;
use crate::misbehaviour::{self, Misbehaviour, Misbehaviours};
use crate::objects::Objects;
use crate::prepared::{Place, Prepared};
use crate::process_data::ProcessData;
use crate::services::Services;
use crate::steps::Steps;
use crate::sync_engine::{Chosen, Prompt, Reaction, SyncEngine};

/// A SubDevice: state machine, mailbox, dictionary, process data and sync engine, with an
/// application.
///
/// It reads no clock and is called in four ways, each with the present time of the device's
/// oscillator:
///
/// 1. [`poll`](Self::poll) is the main loop: AL control, SyncManager changes, mailbox, watchdog,
///    timeouts. Call it when the AL event request is not zero, and at
///    [`next_timeout`](Self::next_timeout).
/// 2. [`handle_event`](Self::handle_event) is the interrupt. It decides which steps start and
///    counts late ones; it returns the steps with their delays but does not run them.
/// 3. [`begin`](Self::begin) and [`finish`](Self::finish) enclose each of those steps. On a real
///    device both follow at once; a model of a CPU gives each a separate instant. A step that ends
///    at the instant of an event must be finished before the event.
/// 4. [`state`](Self::state), [`status_code`](Self::status_code), [`sync`](Self::sync) return its
///    state.
///
/// [`power_off`](Self::power_off) resets it to its initial state.
///
/// The values of dictionary and parameters, the images of the process data and the messages of the
/// mailbox are in `S`, which has at least [`Description::store_len`] bytes.
pub struct SubDevice<A, S> {
    pub(crate) application: A,
    pub(crate) dictionary: Dictionary<S>,
    pub(crate) esm: Esm,
    pub(crate) mailbox: Mailbox,
    pub(crate) services: Services,
    pub(crate) process_data: ProcessData,
    pub(crate) sync: SyncEngine,
    pub(crate) chosen: Chosen,
    pub(crate) station: u16,
    /// When to read the ESC again for changes that it makes at the end of a frame.
    retry: Option<Time<Device>>,
    /// Until when a slow mailbox does not answer.
    answered_late: Option<Time<Device>>,
    /// Number of SM2 events so far, for a device that ignores some.
    sm2_events: u32,
    /// See [`Self::take_unacknowledged`].
    unacknowledged: bool,
}

impl<A: Application, S: AsRef<[u8]> + AsMut<[u8]>> SubDevice<A, S> {
    /// A SubDevice after power-on. Its values and messages are in `store`, which belongs to the
    /// device and must be long enough. The description is copied, except for its objects.
    pub fn new(description: &Description, store: S, application: A) -> Self {
        let mut dictionary = Dictionary::new(description, store);
        let mut sync = SyncEngine::new();
        sync.load_settings(&dictionary.values());
        Self {
            application,
            dictionary,
            esm: Esm::new(),
            mailbox: Mailbox::new(description.mailbox),
            services: Services::new(),
            process_data: ProcessData::new(),
            sync,
            chosen: Chosen::default(),
            station: 0,
            retry: None,
            answered_late: None,
            sm2_events: 0,
            unacknowledged: false,
        }
    }

    /// Switches the device off: it is then in the state after [`new`](Self::new). When it has power
    /// again, call the main loop again.
    pub fn power_off(&mut self) {
        self.application.power_off();
        self.dictionary.reset();
        self.esm = Esm::new();
        self.mailbox.stop();
        self.services.reset();
        self.process_data = ProcessData::new();
        self.sync = self.sync.renewed();
        self.sync.load_settings(&self.dictionary.values());
        self.chosen = Chosen::default();
        self.station = 0;
        self.retry = None;
        self.answered_late = None;
        self.sm2_events = 0;
        self.unacknowledged = false;
    }

    /// The misbehaviours of the device from now on. Without the feature `misbehaviour` there are
    /// none.
    pub fn misbehaviour_mut(&mut self) -> &mut Misbehaviours {
        self.dictionary.misbehaviour_mut()
    }

    /// Reports that the application cannot continue. The device goes from OP to SAFEOP, or stays in
    /// a lower state, and shows the error with this code until it is acknowledged (registers 0x0130
    /// and 0x0134). Outputs are then in their safe state. Without effect while the device shows
    /// another error, and on a device with device emulation, which has no program.
    pub fn fail(&mut self, code: AlStatusCode, pdi: &mut impl Pdi) {
        if self.esm.error.is_some() || self.is_emulated() {
            return;
        }
        match self.esm.state {
            AlState::Op => self.fall(AlState::SafeOp, code, pdi),
            _ => self.show_error(code, pdi),
        }
    }

    /// Runs the main loop: does all waiting work outside the cycle. It is fast if there is none.
    pub fn poll(&mut self, now: Time<Device>, pdi: &mut impl Pdi) {
        if self.is_emulated() {
            return self.follow(now, pdi);
        }
        let mut events = pdi.events();
        if events & al_event::AL_CONTROL != 0 {
            // Reading AL control unlocks it for the next request.
            let control = pdi.load(register::AL_CONTROL);
            self.request(now, control, pdi);
        }
        if events & al_event::SM_ACTIVATION != 0 {
            self.sync_managers_changed(pdi);
        }
        let repeats = events & al_event::SM_ACTIVATION != 0 || self.mailbox.is_repeating();
        if repeats && let Some((_, room)) = self.dictionary.values_and_room() {
            self.mailbox.check_repeat(&room, pdi);
        }
        if events & al_event::WATCHDOG != 0 {
            self.watchdog_expired(pdi);
        }
        let others = al_event::AL_CONTROL | al_event::WATCHDOG;
        if repeats || events & others != 0 {
            // A repetition may have filled the read mailbox, and a request may have switched it.
            events = pdi.events();
        }
        let held = self.mailbox.wants(events) && self.holds_mailbox(now);
        if self.mailbox.wants(events)
            && !held
            && let Some((dictionary, mut room)) = self.dictionary.values_and_room()
        {
            self.answered_late = None;
            let mut objects = Objects {
                dictionary,
                application: &mut self.application,
                sync: &mut self.sync,
                chosen: &mut self.chosen,
                state: self.esm.state,
            };
            self.mailbox.poll(events, &mut self.services, &mut objects, &mut room, pdi);
        }
        self.continue_opening(now, pdi);
        self.supervise(now, pdi);
        let waits_for_esc = self.esm.is_opening() || self.mailbox.is_repeating();
        self.retry = waits_for_esc.then(|| now + RETRY).or(self.answered_late.filter(|_| held));
    }

    /// Handles an interrupt: returns the steps that start now, with their delays, and counts late
    /// ones.
    pub fn handle_event(&mut self, now: Time<Device>, event: Event, pdi: &mut impl Pdi) -> Steps {
        if self.description().behaviour.faults().is_empty() {
            return self.react(now, event, pdi);
        }
        if self.overlooks(event, pdi) {
            return Steps::EMPTY;
        }
        let steps = self.react(now, event, pdi);
        self.delayed(steps)
    }

    /// As [`handle_event`](Self::handle_event), for a caller with enough memory: the steps of an
    /// event are kept in `prepared`, and reused as long as they do not change.
    #[inline]
    pub fn handle_event_prepared<T>(
        &mut self,
        now: Time<Device>,
        event: Event,
        pdi: &mut impl Pdi,
        prepared: &mut Prepared<T>,
    ) -> Steps {
        if !self.description().behaviour.faults().is_empty() {
            return self.handle_event(now, event, pdi);
        }
        match self.handle_event_in_place(now, event, pdi, prepared) {
            Some(place) => *prepared.steps(place),
            None => Steps::EMPTY,
        }
    }

    /// The same for a device that does not misbehave; returns where `prepared` has the steps that
    /// start. `None`: none start.
    #[inline(never)]
    pub fn handle_event_in_place<T>(
        &mut self,
        now: Time<Device>,
        event: Event,
        pdi: &mut impl Pdi,
        prepared: &mut Prepared<T>,
    ) -> Option<Place> {
        let new_outputs = self.meet(now, event, pdi)?;
        let op = self.esm.state == AlState::Op;
        let prompt = self.sync.react_prepared(now, event, (new_outputs, op), prepared);
        if prompt == Prompt::Drop {
            self.process_data.drop_outputs(pdi);
            return None;
        }
        let stays = self.stays(now, event, op, pdi);
        match prompt {
            Prompt::Start(place) if stays => Some(place),
            _ => None,
        }
    }

    /// Acknowledges a SYNC pulse. In acknowledge mode (0x0982 is 0) the signal stays active until
    /// then, and pulses that are due before make no edge. [`handle_event`](Self::handle_event) does
    /// this itself, unless the behaviour says
    /// [later](crate::description::Behaviour::late_acknowledge).
    pub fn acknowledge_sync(&mut self, event: Event, pdi: &mut impl Pdi) {
        let first = event == Event::Sync0;
        let status = if first { register::SYNC0_STATUS } else { register::SYNC1_STATUS };
        let _status = pdi.load(status);
    }

    /// Whether the last event is a SYNC pulse that the caller must
    /// [acknowledge](Self::acknowledge_sync). The call resets it.
    #[inline]
    pub fn take_unacknowledged(&mut self) -> bool {
        core::mem::take(&mut self.unacknowledged)
    }

    fn react(&mut self, now: Time<Device>, event: Event, pdi: &mut impl Pdi) -> Steps {
        let Some(new_outputs) = self.meet(now, event, pdi) else { return Steps::EMPTY };
        let op = self.esm.state == AlState::Op;
        match self.sync.react(now, event, new_outputs, op) {
            Reaction::Start(steps) if self.stays(now, event, op, pdi) => steps,
            Reaction::Start(_) => Steps::EMPTY,
            Reaction::Drop => {
                self.process_data.drop_outputs(pdi);
                Steps::EMPTY
            }
        }
    }

    /// Prepares for an event before its steps start; returns whether outputs wait that the event
    /// fetches. `None`: it starts no steps.
    #[inline(always)]
    fn meet(&mut self, now: Time<Device>, event: Event, pdi: &mut impl Pdi) -> Option<bool> {
        let sync = matches!(event, Event::Sync0 | Event::Sync1);
        // This also holds below SAFEOP: without an acknowledge there is no further pulse.
        if sync && self.must_acknowledge(pdi) {
            match self.description().behaviour.late_acknowledge {
                true => self.unacknowledged = true,
                false => self.acknowledge_sync(event, pdi),
            }
        }
        if !self.esm.is_cyclic() {
            return None;
        }
        if sync {
            // A late pulse must not hide that it was late.
            self.supervise(now, pdi);
        }
        self.application.event(event);
        let looks = self.sync.looks_for_outputs(event) && self.sync.has_outputs();
        Some(looks && pdi.events() & self.output_event() != 0)
    }

    /// Whether the steps of a counted event start. A pulse that ends OP starts no outputs any more;
    /// the next one starts the cycle again.
    #[inline(always)]
    pub(crate) fn stays(
        &mut self,
        now: Time<Device>,
        event: Event,
        op: bool,
        pdi: &mut impl Pdi,
    ) -> bool {
        if !matches!(event, Event::Sync0 | Event::Sync1) {
            return true;
        }
        self.supervise(now, pdi);
        let fell = op && self.esm.state != AlState::Op;
        if fell {
            self.sync.abandon();
        }
        !fell
    }

    /// Whether SYNC is in acknowledge mode. In the cycle the register is not read again, to save
    /// time.
    #[inline(always)]
    fn must_acknowledge(&self, pdi: &mut impl Pdi) -> bool {
        match self.esm.is_cyclic() && self.sync.mode().uses_dc() {
            true => self.sync.acknowledges_sync(),
            false => pdi.load(register::SYNC_PULSE_LENGTH) == 0,
        }
    }

    /// Begins a step: outputs are fetched from the ESC, outputs act, or inputs are latched. A step
    /// that no event started, or that a change of state ended, is ignored.
    #[inline(always)]
    pub fn begin(&mut self, now: Time<Device>, step: Step, pdi: &mut impl Pdi) {
        if !self.sync.begin(now, step) {
            return;
        }
        match step {
            Step::MapOutputs => {
                self.process_data.fetch_outputs(self.dictionary.outputs_mut(), pdi);
                let toggle = self.description().behaviour.output_toggle;
                let toggle = toggle.filter(|_| self.esm.state == AlState::Op);
                self.sync.outputs_fetched(toggle.and_then(|at| {
                    self.process_data.output_bit(self.dictionary.output_image(), at)
                }));
            }
            Step::OutputsValid if self.esm.state == AlState::Op => self.application.outputs_valid(),
            Step::LatchInputs => self.application.latch_inputs(),
            _ => {}
        }
    }

    /// Finishes a step: outputs are ready, the application's work is done, or inputs are in the
    /// ESC. A step that no event started, or that a change of state ended, is ignored.
    ///
    /// Outputs that are ready only after their SYNC0 are dropped: the application does not get
    /// them, so that the outputs of one cycle never act in the next.
    #[inline(always)]
    pub fn finish(&mut self, now: Time<Device>, step: Step, pdi: &mut impl Pdi) {
        if !self.sync.finish(now, step) {
            return;
        }
        match step {
            Step::MapOutputs => {
                let in_time = self.sync.outputs_ready();
                if in_time && self.esm.state == AlState::Op {
                    let image = self.dictionary.output_image();
                    self.application.map_outputs(self.process_data.outputs(image));
                }
                self.supervise(now, pdi);
            }
            Step::Application => self.application.application(self.sync.application_cycle()),
            Step::MapInputs => {
                self.hand_over_inputs(pdi);
            }
            Step::OutputsValid | Step::LatchInputs => {}
        }
    }

    /// The application.
    pub fn application_mut(&mut self) -> &mut A {
        &mut self.application
    }

    /// When the stack must be called without an event: the earliest of the local timer of Free Run,
    /// the timeouts of the state machine, and changes that the ESC makes only at the end of a
    /// frame. At that instant call [`handle_event`](Self::handle_event) with [`Event::Timer`] and
    /// then [`poll`](Self::poll): each does only what is due. The instant changes with every call
    /// of the other methods.
    #[inline(always)]
    pub fn next_timeout(&self) -> Option<Time<Device>> {
        let earliest = |one: Option<Time<Device>>, other: Option<Time<Device>>| match (one, other) {
            (Some(one), Some(other)) => Some(one.min(other)),
            (one, other) => one.or(other),
        };
        earliest(earliest(self.timer(), self.supervision_due()), self.retry)
    }

    /// Whether it is in OP and waits for nothing but the next events: then its only timeout is the
    /// [`sync_deadline`](Self::sync_deadline), and its state changes only with a call.
    #[inline]
    pub fn is_settled(&self) -> bool {
        self.stays_in_op() && self.sync.timer().is_none()
    }

    /// Whether it is in OP, and neither changes its state nor waits for the ESC.
    #[inline]
    fn stays_in_op(&self) -> bool {
        self.esm.state == AlState::Op
            && self.esm.error.is_none()
            && self.esm.pending.is_none()
            && self.retry.is_none()
            && !self.is_emulated()
    }

    /// Whether it is [settled](Self::is_settled) but for the timer of Free Run, does not misbehave,
    /// and its cycle runs as it should: then an event accesses only the process data, and only a
    /// SYNC pulse can end OP.
    /// Where missed events are the balance of events and pulses, an SM event could end it too:
    /// such a device is never regular.
    #[inline]
    pub fn is_regular(&self) -> bool {
        self.stays_in_op()
            && !self.sync.sequence_lost()
            && !self.sync.acknowledges_sync()
            && !self.sync.balances()
            && self.description().behaviour.faults().is_empty()
    }

    /// When the next SYNC pulse must have come in OP; `None` without supervision.
    #[inline]
    pub fn sync_deadline(&self) -> Option<Time<Device>> {
        self.sync.sync_deadline()
    }

    /// When the local timer of Free Run is due; `None` in other modes and below SAFEOP.
    pub fn timer(&self) -> Option<Time<Device>> {
        self.sync.timer()
    }

    /// State in the EtherCAT State Machine.
    pub fn state(&self) -> AlState {
        self.esm.state
    }

    /// AL status code of the error indication, or no error.
    pub fn status_code(&self) -> AlStatusCode {
        self.esm.error.unwrap_or(AlStatusCode::NO_ERROR)
    }

    /// The synchronization: mode, cycle, counters.
    pub fn sync(&self) -> &SyncEngine {
        &self.sync
    }

    /// The application.
    pub fn application(&self) -> &A {
        &self.application
    }

    /// The fixed properties of the device.
    pub fn description(&self) -> &Description {
        self.dictionary.description()
    }

    /// The station address that the device read at INIT to PREOP, for its own use.
    pub fn station_address(&self) -> u16 {
        self.station
    }

    /// The interpolation time (0x60C2) of a drive, if the MainDevice wrote it since PREOP was
    /// entered.
    pub fn interpolation_time(&self) -> Option<Nanos> {
        let part = |sub| self.dictionary.byte(ObjectAddress::new(INTERPOLATION_TIME, sub));
        let units = part(1).filter(|_| self.chosen.interpolation)?;
        interpolation::time(units, part(2)?.cast_signed())
    }

    /// AL event of waiting outputs.
    pub(crate) fn output_event(&self) -> u32 {
        al_event::sync_manager(self.description().outputs.sync_manager.into())
    }

    #[inline(always)]
    pub(crate) fn hand_over_inputs(&mut self, pdi: &mut impl Pdi) {
        let inputs = self.process_data.inputs(self.dictionary.inputs_mut());
        self.application.map_inputs(inputs);
        self.process_data.store_inputs(inputs, pdi);
    }

    /// Prepares for SAFEOP: inputs are in the buffer before the first frame fetches them, and
    /// outputs that waited before are acknowledged.
    pub(crate) fn first_exchange(&mut self, pdi: &mut impl Pdi) {
        let faults = self.description().behaviour.faults();
        if self.sync.has_inputs() && !faults.contains(&Misbehaviour::NoFirstInputs) {
            self.application.latch_inputs();
            self.hand_over_inputs(pdi);
        }
        if self.sync.has_outputs() && pdi.events() & self.output_event() != 0 {
            self.process_data.drop_outputs(pdi);
        }
    }
}

/// The effects of misbehaviours.
impl<A: Application, S: AsRef<[u8]> + AsMut<[u8]>> SubDevice<A, S> {
    /// Whether an event is ignored.
    fn overlooks(&mut self, event: Event, pdi: &mut impl Pdi) -> bool {
        let mut every = 0;
        for fault in self.description().behaviour.faults() {
            match *fault {
                Misbehaviour::DeadSync0 if event == Event::Sync0 => return true,
                Misbehaviour::MissedCopy(n) if event == Event::Sm2 => every = n.max(1),
                Misbehaviour::ShortOfTime(least) if event == Event::Sm2 => {
                    let cycle = self.sync.cycle();
                    if self.sync.mode().uses_dc() && cycle < least {
                        every = 2;
                    }
                }
                _ => {}
            }
        }
        if every == 0 || !self.esm.is_cyclic() {
            return false;
        }
        self.sm2_events = self.sm2_events.wrapping_add(1);
        let missed = self.sm2_events.is_multiple_of(every);
        if missed {
            self.process_data.drop_outputs(pdi);
        }
        missed
    }

    /// The steps of an event, with the delays of a late device.
    fn delayed(&self, steps: Steps) -> Steps {
        let (mut copy, mut rest) = (Nanos::ZERO, Nanos::ZERO);
        for fault in self.description().behaviour.faults() {
            match *fault {
                Misbehaviour::LateCopy(by) => copy = by,
                Misbehaviour::LateApplication(by) => rest = by,
                _ => {}
            }
        }
        let mut delayed = Steps::EMPTY;
        for (step, delay) in steps {
            let by = if step == Step::MapOutputs { copy } else { rest };
            delayed.push(step, delay + by);
        }
        delayed
    }

    /// Whether requests in the mailbox must wait longer.
    fn holds_mailbox(&mut self, now: Time<Device>) -> bool {
        let late =
            misbehaviour::number(self.description().behaviour.faults(), |fault| match *fault {
                Misbehaviour::SlowMailbox(by) => Some(by),
                _ => None,
            });
        let Some(by) = late else { return false };
        now < *self.answered_late.get_or_insert(now + by)
    }
}

/// Time until the ESC is read again: a long frame takes 120 us, a short one 7 us.
const RETRY: Nanos = Nanos::micros(10);
