//! The EtherCAT State Machine: requests, refusals, errors, acknowledgement.

use isocat_esc::{Pdi, PdiExt};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{AlControl, AlState, AlStatus, AlStatusCode, register};

use crate::application::Application;
use crate::checks;
use crate::description::ProcessDataArea;
use crate::misbehaviour::{self, Faults, Misbehaviour};
use crate::stack::SubDevice;

/// State, error and the present transition.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Esm {
    /// Present state.
    pub state: AlState,
    /// The code of the error indication; `None` while there is no error.
    pub error: Option<AlStatusCode>,
    /// OP was requested and is not reached yet.
    pub pending: Option<Pending>,
    /// Whether a SyncManager of outputs triggers the process data watchdog.
    pub watchdog: bool,
    /// Whether the identification value is in the status code register.
    identification: bool,
    /// Whether the SyncManagers of the device's cyclic event are closed until the error is
    /// acknowledged.
    closed: bool,
    /// Whether the SyncManagers of inputs are being opened again: their buffers are empty.
    reopening: bool,
    /// SAFEOP is entered as soon as the ESC has opened the process data SyncManagers.
    opening: Option<checks::SafeOp>,
}

/// SAFEOP to OP, which waits for outputs or for DC.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Pending {
    /// When the transition is given up.
    pub deadline: Time<Device>,
    /// Since when SYNC has run with the right order of events.
    pub valid_since: Option<Time<Device>>,
}

impl Esm {
    /// The state after power-on.
    pub const fn new() -> Self {
        Self {
            state: AlState::Init,
            error: None,
            pending: None,
            watchdog: false,
            identification: false,
            closed: false,
            reopening: false,
            opening: None,
        }
    }

    /// Whether SAFEOP waits for the ESC.
    pub fn is_opening(&self) -> bool {
        self.opening.is_some() || self.reopening
    }

    /// Whether process data are exchanged.
    #[inline]
    pub fn is_cyclic(&self) -> bool {
        matches!(self.state, AlState::SafeOp | AlState::Op)
    }
}

impl<A: Application, S: AsRef<[u8]> + AsMut<[u8]>> SubDevice<A, S> {
    /// Handles a write of AL control.
    pub(crate) fn request(&mut self, now: Time<Device>, control: AlControl, pdi: &mut impl Pdi) {
        let asked = control.state();
        if self.esm.error.is_some() {
            // INIT is possible even for a MainDevice that does not acknowledge.
            let faults = self.faults();
            let forgets = faults.contains(&Misbehaviour::ForgetsError);
            let keeps = self.esm.error.is_some_and(|error| {
                control.acknowledge() && faults.contains(&Misbehaviour::KeepsError(error))
            });
            let way_out = asked == Ok(AlState::Init);
            if !way_out && (keeps || !control.acknowledge() && !forgets) {
                return;
            }
            self.esm.error = None;
            if core::mem::take(&mut self.esm.closed) {
                self.set_event_managers_closed(false, pdi);
                self.esm.reopening = !self.sync.has_outputs();
            }
        }
        self.esm.identification =
            control.identification() && self.description().behaviour.identification != 0;
        match asked {
            Ok(asked) => self.change(now, asked, pdi),
            Err(_) => self.refuse(AlStatusCode::UNKNOWN_STATE, pdi),
        }
        self.publish(pdi);
    }

    /// Handles a write of the activation of some SyncManager.
    pub(crate) fn sync_managers_changed(&mut self, pdi: &mut impl Pdi) {
        // Reading the activation registers of all SyncManagers releases the event.
        let mut all = [0; 16 * 8];
        pdi.read(register::SM_0.address, &mut all);
        if self.esm.state == AlState::Init {
            return;
        }
        if let Err(code) = checks::mailbox(pdi, self.description().mailbox.as_ref())
            && !misbehaviour::accepts(self.faults(), code, 0)
        {
            self.fall(AlState::Init, code, pdi);
        } else if self.esm.is_cyclic() {
            let (outputs, inputs) = self.process_data.lengths();
            if let Err(code) = checks::process_data(pdi, self.description(), &outputs, &inputs) {
                self.fall(AlState::PreOp, code, pdi);
            }
        }
    }

    /// Handles the expired process data watchdog.
    pub(crate) fn watchdog_expired(&mut self, pdi: &mut impl Pdi) {
        // Reading the status releases the event.
        let _status = pdi.load(register::WATCHDOG_STATUS);
        if self.esm.state == AlState::Op && self.esm.watchdog {
            self.fall(AlState::SafeOp, AlStatusCode::WATCHDOG, pdi);
        }
    }

    /// Supervises times: the requested OP, and SYNC0 in OP.
    #[inline(always)]
    pub(crate) fn supervise(&mut self, now: Time<Device>, pdi: &mut impl Pdi) {
        let sync_lost = self.sync.sync_deadline().is_some_and(|deadline| now >= deadline);
        let as_usual = match self.esm.state {
            AlState::Op => !sync_lost && !self.sync.sequence_lost(),
            _ => self.esm.pending.is_none(),
        };
        if !as_usual && !self.is_emulated() {
            self.judge_sync(now, sync_lost, pdi);
        }
    }

    /// Reacts to lost SYNC, and to the requested OP.
    #[cold]
    fn judge_sync(&mut self, now: Time<Device>, sync_lost: bool, pdi: &mut impl Pdi) {
        let codes = self.description().behaviour.loss_codes;
        if self.esm.state == AlState::Op {
            if sync_lost {
                self.fall(AlState::SafeOp, codes.sync_lost, pdi);
            } else if self.sync.sequence_lost() {
                self.fall(AlState::SafeOp, codes.sequence, pdi);
            }
            return;
        }
        let Some(mut pending) = self.esm.pending else { return };
        let with_dc = self.sync.mode().uses_dc();
        let valid = if with_dc {
            self.sync.sync_seen()
                && !sync_lost
                && self.sync.received()
                && !self.sync.sequence_lost()
        } else {
            self.sync.received() || !self.sync.has_outputs()
        };
        pending.valid_since = if valid { pending.valid_since.or(Some(now)) } else { None };
        self.esm.pending = Some(pending);
        let settling = self.description().behaviour.sync_settling;
        if pending.valid_since.is_some_and(|since| !with_dc || now >= since + settling) {
            self.esm.pending = None;
            self.esm.state = AlState::Op;
            self.publish(pdi);
        } else if now >= pending.deadline {
            let code = if with_dc && !self.sync.sync_seen() {
                codes.no_sync
            } else if !with_dc || !self.sync.received() {
                AlStatusCode::WATCHDOG
            } else {
                codes.sequence
            };
            self.fall(AlState::SafeOp, code, pdi);
        }
    }

    /// When [`Self::supervise`] must be called without an event.
    #[inline]
    pub(crate) fn supervision_due(&self) -> Option<Time<Device>> {
        if self.is_emulated() {
            return None;
        }
        let sync_lost = match (self.esm.state, self.esm.pending) {
            (AlState::Op, _) | (_, Some(_)) => self.sync.sync_deadline(),
            _ => None,
        };
        let Some(pending) = self.esm.pending else { return sync_lost };
        let settled =
            pending.valid_since.map(|since| since + self.description().behaviour.sync_settling);
        // A missing SYNC0 matters only once: it ends the valid time.
        let broken = sync_lost.filter(|_| settled.is_some());
        [settled, broken].into_iter().flatten().chain([pending.deadline]).min()
    }

    /// Continues the opening of SyncManagers. The ESC opens them at the end of the present frame;
    /// inputs can be written, and SAFEOP entered, only after that.
    pub(crate) fn continue_opening(&mut self, now: Time<Device>, pdi: &mut impl Pdi) {
        let mut inputs = self.description().input_areas();
        if self.esm.reopening && inputs.all(|area| is_open(pdi, area.sync_manager.into())) {
            self.esm.reopening = false;
            if self.esm.is_cyclic() {
                // If the inputs follow the frames that fetch them, no other step would fill the
                // buffer.
                self.first_exchange(pdi);
            }
        }
        if self.esm.opening.is_some() && self.try_enter_safe_op(now, pdi) {
            self.publish(pdi);
        }
    }

    fn change(&mut self, now: Time<Device>, asked: AlState, pdi: &mut impl Pdi) {
        use AlState::{Boot, Init, Op, PreOp, SafeOp};
        match (self.esm.state, asked) {
            (Op, Op) => {}
            (SafeOp, Op) if self.esm.pending.is_some() => {}
            (Init, Boot) => self.refuse(AlStatusCode::BOOTSTRAP_NOT_SUPPORTED, pdi),
            (Init, PreOp) => match checks::mailbox(pdi, self.description().mailbox.as_ref()) {
                Err(code) if !misbehaviour::accepts(self.faults(), code, 0) => {
                    self.refuse(code, pdi);
                }
                _ if self.never_enters(PreOp) => self.refuse(AlStatusCode::UNSPECIFIED, pdi),
                _ => {
                    self.station = pdi.load(register::STATION_ADDRESS);
                    self.mailbox.start(pdi);
                    self.services.reset();
                    self.esm.state = PreOp;
                }
            },
            (PreOp, SafeOp) => self.prepare_safe_op(now, pdi),
            (SafeOp, Op) if self.never_enters(Op) => {
                self.refuse(AlStatusCode::UNSPECIFIED, pdi);
            }
            (SafeOp, Op) => {
                self.sync.clear_missed();
                let timeout = self.description().behaviour.safeop_to_op_timeout;
                self.esm.pending = Some(Pending { deadline: now + timeout, valid_since: None });
                self.supervise(now, pdi);
            }
            (SafeOp | Op, Init) if self.never_enters(Init) => {
                self.refuse(AlStatusCode::UNSPECIFIED, pdi);
            }
            (Init, Init) | (PreOp, Init | PreOp) | (SafeOp | Op, Init | PreOp | SafeOp) => {
                self.leave_to(asked, pdi);
            }
            _ => self.refuse(AlStatusCode::INVALID_STATE_CHANGE, pdi),
        }
    }

    fn prepare_safe_op(&mut self, now: Time<Device>, pdi: &mut impl Pdi) {
        let found = match checks::safe_op(pdi, &self.dictionary.values(), self.chosen) {
            Ok(_) if self.never_enters(AlState::SafeOp) => {
                return self.refuse(AlStatusCode::UNSPECIFIED, pdi);
            }
            Ok(found) => found,
            Err(code) if self.accepts(code, pdi) => checks::SafeOp::default(),
            Err(code) => {
                self.set_process_data_closed(true, pdi);
                return self.refuse(code, pdi);
            }
        };
        self.set_process_data_closed(false, pdi);
        self.esm.opening = Some(found);
        self.try_enter_safe_op(now, pdi);
    }

    /// Whether the device accepts a set-up that must be refused with this code.
    fn accepts(&self, code: AlStatusCode, pdi: &mut impl Pdi) -> bool {
        let faults = self.faults();
        !faults.is_empty()
            && misbehaviour::accepts(faults, code, pdi.load(register::SYNC_ACTIVATION).0)
    }

    fn never_enters(&self, state: AlState) -> bool {
        self.faults().contains(&Misbehaviour::RefusedState(state))
    }

    /// The misbehaviours of the device.
    fn faults(&self) -> &Faults {
        self.description().behaviour.faults()
    }

    fn try_enter_safe_op(&mut self, now: Time<Device>, pdi: &mut impl Pdi) -> bool {
        let mut areas = self.description().output_areas().chain(self.description().input_areas());
        let open = areas.all(|area| is_open(pdi, area.sync_manager.into()));
        let Some(found) = self.esm.opening.take_if(|_| open) else { return false };
        let chain = found.sync.chain;
        let mode = chain.mode;
        let cycle = found.sync.cycle.to_u32().unwrap_or(u32::MAX);
        let types = [
            (OUTPUT_PARAMETER, mode.output_type()),
            (INPUT_PARAMETER, mode.input_type(chain.has_outputs)),
        ];
        let mut values = self.dictionary.values();
        for (index, sync_type) in types {
            values.set(index, sub::SYNC_TYPE, u32::from(sync_type.0));
            if mode.uses_dc() {
                values.set(index, sub::CYCLE_TIME, cycle);
                values.set(index, sub::SYNC0_CYCLE_TIME, cycle);
            } else if self.sync.mode().uses_dc() {
                // Values that the last run with DC left are no longer valid.
                if !self.chosen.cycle {
                    values.set(index, sub::CYCLE_TIME, 0);
                }
                values.set(index, sub::SYNC0_CYCLE_TIME, 0);
            }
        }
        self.sync.load_settings(&values);
        let before = self.sync;
        self.sync.start(now, found.sync);
        if self.faults().contains(&Misbehaviour::KeepsCounters) {
            self.sync.keep_counters(&before);
        }
        self.esm.watchdog = found.watchdog;
        let images = self.dictionary.images_mut();
        self.process_data.start(found.outputs, found.inputs, images);
        self.first_exchange(pdi);
        self.esm.state = AlState::SafeOp;
        true
    }

    /// Goes down to `asked`, or stays in the state.
    fn leave_to(&mut self, asked: AlState, pdi: &mut impl Pdi) {
        self.esm.pending = None;
        self.esm.opening = None;
        if self.esm.state == AlState::Op && asked != AlState::Op {
            self.application.safe_outputs();
        }
        if self.esm.is_cyclic() && matches!(asked, AlState::Init | AlState::PreOp) {
            let before = self.sync;
            self.sync.stop();
            if self.faults().contains(&Misbehaviour::KeepsCounters) {
                self.sync.keep_counters(&before);
            }
            self.chosen = Default::default();
            self.esm.watchdog = false;
            self.process_data.stop();
            self.set_process_data_closed(true, pdi);
        }
        if asked == AlState::Init {
            self.mailbox.stop();
            self.services.reset();
            self.chosen = Default::default();
        }
        self.esm.state = asked;
    }

    /// Refuses a request. From OP the device goes to SAFEOP, otherwise it stays in its state.
    fn refuse(&mut self, code: AlStatusCode, pdi: &mut impl Pdi) {
        let code = misbehaviour::al_code(self.faults(), self.esm.state, code);
        let state = if self.esm.state == AlState::Op { AlState::SafeOp } else { self.esm.state };
        self.leave_to(state, pdi);
        self.esm.error = Some(code);
    }

    /// Lets the device leave its state by itself.
    pub(crate) fn fall(&mut self, state: AlState, code: AlStatusCode, pdi: &mut impl Pdi) {
        let code = misbehaviour::al_code(self.faults(), self.esm.state, code);
        self.leave_to(state, pdi);
        if state == AlState::SafeOp {
            self.set_event_managers_closed(true, pdi);
            self.esm.closed = true;
        }
        self.esm.error = Some(code);
        self.publish(pdi);
    }

    /// Shows an error in the present state.
    pub(crate) fn show_error(&mut self, code: AlStatusCode, pdi: &mut impl Pdi) {
        self.refuse(code, pdi);
        self.publish(pdi);
    }

    /// Closes or opens all SyncManagers of the direction of the cyclic event: with an open one the
    /// working counter would stay complete.
    fn set_event_managers_closed(&self, closed: bool, pdi: &mut impl Pdi) {
        let description = self.description();
        if self.sync.has_outputs() {
            set_closed(pdi, description.output_areas(), closed);
        } else {
            set_closed(pdi, description.input_areas(), closed);
        }
    }

    fn set_process_data_closed(&self, closed: bool, pdi: &mut impl Pdi) {
        set_closed(pdi, self.description().output_areas(), closed);
        set_closed(pdi, self.description().input_areas(), closed);
    }

    /// Writes state and error. The code is written first, so that the error is never visible with
    /// an old code.
    fn publish(&mut self, pdi: &mut impl Pdi) {
        let identification = self.esm.identification && self.esm.error.is_none();
        let code = if identification {
            AlStatusCode(self.description().behaviour.identification)
        } else {
            self.esm.error.unwrap_or(AlStatusCode::NO_ERROR)
        };
        pdi.store(register::AL_STATUS_CODE, code);
        let status = AlStatus::new(self.esm.state)
            .with_error(self.esm.error.is_some())
            .with_identification(identification);
        pdi.store(register::AL_STATUS, status);
    }
}

/// Closes or opens SyncManagers of process data from the PDI side. The repeat bit is kept.
fn set_closed(pdi: &mut impl Pdi, areas: impl Iterator<Item = ProcessDataArea>, closed: bool) {
    for area in areas {
        let control = register::sm_pdi_control(area.sync_manager.into());
        let kept = pdi.load(control) & SyncManager::REPEAT;
        pdi.store(control, kept | u8::from(closed));
    }
}

fn is_open(pdi: &mut impl Pdi, number: usize) -> bool {
    pdi.load(register::sm_pdi_control(number)) & 1 == 0
}
