//! A SubDevice: ESC, stack, application and CPU on one oscillator.

mod application;
mod brief;
mod present;
mod regular;

use std::sync::Arc;

use isocat_esc::{Chip, CyclicFrame, Esc, EscEvent, Passing, Pdi};
use isocat_subdevice::description::ProcessDataArea;
use isocat_subdevice::{Application, Description, Event, Misbehaviour, Prepared, Step, SubDevice};
use isocat_wire::datagram::Address;
use isocat_wire::register::{self, al_event};
use isocat_wire::time::{Dc, Device as DeviceClock, Local, Time, True};
use isocat_wire::{AlStatusCode, Command};

use crate::cpu::{Action, Cpu, CpuModel, Sequence};
use crate::judge::ClockTime;
use crate::observation::{Content, Observation, Observed};
use crate::oscillator::{Bend, ClockModel, Oscillator};
use crate::plant::{Acted, Plant, PlantSetup};
use crate::random::Stream;
use crate::sampling::{Sampler, Sampling};
use crate::storage::Storage;
use crate::watcher::Watcher;
pub use application::BoxedApplication;
use present::Present;
use regular::Kept;

/// The parts of a SubDevice of a run.
pub struct DeviceSetup {
    /// Its ESC.
    pub chip: Chip,
    /// Image of its EEPROM. Devices of one kind share it; a device that writes gets its own copy.
    pub sii: Arc<[u8]>,
    /// The description for its stack.
    pub description: Description,
    /// Its application.
    pub application: Box<dyn Application + Send>,
    /// How fast its CPU is.
    pub cpu: CpuModel,
    /// Deviation of its oscillator from true time.
    pub clock: ClockModel,
    /// Its local time at power-on.
    pub local_time: Time<Local>,
    /// Where its samples lie, if it oversamples. The samples of its inputs stand in the image
    /// before its application maps the rest.
    pub sampling: Option<Sampling>,
}

/// A SubDevice in true time. It processes its own events up to the instants at which the segment
/// calls it; between two frames no other part can affect it.
pub struct Device {
    /// Nothing happens by itself before this time: see [`Self::touched`].
    quiet_until: Time<DeviceClock>,
    /// When the stack must be called.
    timeout: Time<DeviceClock>,
    /// When the last frame arrived that was not [passed](Self::look_ahead).
    looked_at: Time<DeviceClock>,
    /// Its ESC.
    pub esc: Esc<Storage>,
    /// Its stack.
    pub stack: SubDevice<BoxedApplication, Vec<u8>>,
    oscillator: Oscillator,
    cpu: Cpu,
    position: usize,
    state: (isocat_wire::AlState, isocat_wire::AlStatusCode),
    /// See [`Self::state_version`].
    state_version: u32,
    /// The last frame that passed.
    frame: Time<True>,
    /// The frame that brought the outputs fetched last, and the frame of the outputs that the
    /// application has.
    fetched: Time<True>,
    mapped: Time<True>,
    missed: u64,
    /// Number of SYNC pulses of its ESC that made no edge.
    without_edge: [u32; 2],
    ports_changed: bool,
    powered: bool,
    /// See [`Self::set_lane`].
    lane: bool,
    /// See [`Self::count_on`].
    beyond: Option<u64>,
    /// The steps of each event.
    prepared: Prepared<Kept>,
    /// The times that were drawn last for such steps.
    drawn: Sequence,
    /// The AL events of the first SyncManagers of outputs and inputs.
    sm_events: [u32; 2],
    /// What the last event has started, as long as nothing is on the CPU's agenda.
    present: Present,
    /// The device was found regular ([`SubDevice::is_regular`]), and nothing but regular events
    /// has happened since.
    regular: bool,
}

impl Device {
    /// Switches a SubDevice on at true time zero.
    pub fn new(position: usize, setup: DeviceSetup, seed: u64) -> Self {
        let esc = Esc::new(&setup.chip, Storage::shared(setup.sii), Storage::empty())
            .with_growing_ram(Storage::grow)
            .with_local_time(setup.local_time);
        let store = vec![0; setup.description.store_len()];
        let application = BoxedApplication::new(setup.application, setup.sampling);
        let mut description = setup.description;
        // When it acknowledges SYNC is the CPU's.
        description.behaviour.late_acknowledge = true;
        let stack = SubDevice::new(&description, store, application);
        let mut cpu = Cpu::new(setup.cpu, Stream::new(seed, "cpu", position as u64));
        cpu.wake(Time::ZERO);
        let state = (stack.state(), stack.status_code());
        let oscillator =
            Oscillator::of(&setup.clock, &mut Stream::new(seed, "clock walk", position as u64));
        let timeout = stack.next_timeout().unwrap_or(Time::NEVER);
        let sm_events = [description.outputs, description.inputs]
            .map(|area| al_event::sync_manager(area.sync_manager.into()));
        Self {
            quiet_until: Time::ZERO,
            timeout,
            looked_at: Time::ZERO,
            esc,
            stack,
            oscillator,
            cpu,
            position,
            state,
            state_version: 1,
            frame: Time::ZERO,
            fetched: Time::ZERO,
            mapped: Time::ZERO,
            missed: 0,
            without_edge: [0; 2],
            ports_changed: false,
            powered: true,
            lane: true,
            beyond: None,
            prepared: Prepared::new(),
            drawn: Sequence::NONE,
            sm_events,
            present: Present::none(),
            regular: false,
        }
    }

    /// Sets whether regular operation takes the fast lane: the steps of an event are done one after
    /// another if nothing comes between them; see also [`Esc::set_lane`]. Only the duration of the
    /// simulation depends on it.
    pub(crate) fn set_lane(&mut self, on: bool) {
        self.lane = on;
        self.regular = false;
        self.esc.set_lane(on);
    }

    /// Attaches a plant to it.
    pub(crate) fn attach(&mut self, setup: PlantSetup) {
        self.regular = false;
        self.application().take_plant(Some(Plant::new(setup)));
    }

    /// Moves its plant to the SubDevice that replaces it.
    pub(crate) fn hand_over_plant(&mut self, to: &mut Self) {
        (self.regular, to.regular) = (false, false);
        let plant = self.application().plant().and_then(Option::take);
        to.application().take_plant(plant);
    }

    /// Takes the actions on its plant since the last call, in order; empty without a plant.
    pub(crate) fn take_acted(&mut self) -> impl Iterator<Item = Acted> + '_ {
        self.application().plant().into_iter().flatten().flat_map(|plant| plant.take_acted())
    }

    /// Where its samples lie, if it oversamples.
    pub fn sampling(&self) -> Option<&Sampling> {
        self.stack.application().sampler().map(Sampler::sampling)
    }

    /// Tells its plant the time of the next action.
    #[inline]
    fn tell_time(&mut self, at: Time<DeviceClock>) {
        if let Some(Some(plant)) = self.stack.application_mut().plant() {
            plant.tell_time(self.oscillator.when(at));
        }
    }

    /// Whether it has power. Without power, ESC and stack show their initial state.
    pub fn is_powered(&self) -> bool {
        self.powered
    }

    /// Differs from before when its state may have changed, and with it its mode; never 0.
    #[inline]
    pub(crate) fn state_version(&self) -> u32 {
        self.state_version
    }

    fn next_state_version(&mut self, watch: &mut Watcher) {
        watch.note_change();
        self.state_version = self.state_version.wrapping_add(1).max(1);
    }

    /// Switches it off. Everything but its EEPROM is lost; its oscillator continues invisibly.
    pub(crate) fn power_off(&mut self, at: Time<DeviceClock>, watch: &mut Watcher) {
        self.powered = false;
        self.next_state_version(watch);
        self.tell_time(at);
        self.esc.power_on(at, Time::ZERO);
        self.stack.power_off();
        self.cpu.power_off();
        self.present.clear();
        self.regular = false;
        self.missed = 0;
        self.without_edge = [0; 2];
        self.look(at, watch);
        self.quiet_until = Time::NEVER;
    }

    /// Switches it on again: the local time begins at 0, as in a real chip.
    pub(crate) fn power_on(&mut self, at: Time<DeviceClock>) {
        self.powered = true;
        self.esc.power_on(at, Time::ZERO);
        self.cpu.wake(at);
        self.disturbed();
    }

    /// Changes the speed of its oscillator, from instants on that it has not processed.
    pub(crate) fn bend_clock(&mut self, bends: &[Bend]) {
        self.oscillator.bend(bends);
    }

    /// Sets whether its EEPROM acknowledges no access.
    pub(crate) fn set_eeprom_dead(&mut self, dead: bool) {
        self.esc.set_eeprom_dead(dead);
    }

    /// Begins or ends a misbehaviour.
    pub(crate) fn misbehave(&mut self, at: Time<DeviceClock>, how: Misbehaviour, begins: bool) {
        let at = self.behind_frame(at);
        let all = self.stack.misbehaviour_mut();
        if begins {
            all.begin(how)
        } else {
            all.end(how)
        }
        if self.powered {
            // What it did not look at may wait for it.
            self.put_present();
            self.cpu.wake(at);
        }
        self.disturbed();
    }

    /// Lets its application fail.
    pub(crate) fn fail(&mut self, at: Time<DeviceClock>, code: AlStatusCode, watch: &mut Watcher) {
        if !self.powered {
            return;
        }
        let at = self.behind_frame(at);
        self.advance(at, watch);
        self.tell_time(at);
        self.stack.fail(code, &mut self.esc.pdi(at));
        self.look(at, watch);
        self.disturbed();
    }

    /// An instant that is not before the end of the last frame, up to which it has processed all
    /// events. It is not much later either, since the next frame could come before it.
    fn behind_frame(&self, at: Time<DeviceClock>) -> Time<DeviceClock> {
        self.esc.last_frame().max(self.looked_at).max(at)
    }

    /// Writes a register like a frame that only this SubDevice sees.
    pub(crate) fn write_register(
        &mut self,
        at: Time<DeviceClock>,
        address: u16,
        data: &[u8],
        watch: &mut Watcher,
    ) {
        if !self.powered {
            return;
        }
        let at = self.behind_frame(at);
        self.advance(at, watch);
        self.esc.begin_frame(at);
        let address = Address::Broadcast(address).raw();
        let mut data = data.to_vec();
        let (command, irq, wkc) = (Command::Bwr, 0, 0);
        self.esc.datagram(&mut Passing { command, address, irq, wkc, data: &mut data });
        self.esc.close_frame(at, true);
        self.disturbed();
    }

    /// Its oscillator.
    pub fn oscillator(&self) -> &Oscillator {
        &self.oscillator
    }

    /// Whether loops of its ESC may have changed by themselves since the last
    /// [`clear_ports_changed`](Self::clear_ports_changed).
    pub(crate) fn ports_changed(&self) -> bool {
        self.ports_changed
    }

    /// Called after the loops of its ESC have been checked.
    pub(crate) fn clear_ports_changed(&mut self) {
        self.ports_changed = false;
    }

    /// The ESC's system time at a point of true time, in ps: the counter's value at its last tick,
    /// and what has passed since.
    pub fn system_time_ps(&self, at: Time<True>) -> i128 {
        self.system_time(at).ps()
    }

    /// The same, as a reading and what has passed since.
    pub(crate) fn system_time(&self, at: Time<True>) -> ClockTime {
        self.tick(self.tick_at(at)).system_time(at)
    }

    /// Number of the last tick of the ESC's clock at a point of true time.
    #[inline]
    pub(crate) fn tick_at(&self, at: Time<True>) -> u64 {
        self.oscillator.read::<DeviceClock>(at).count() / TICK_NS
    }

    /// The tick of this number, as long as nothing happens at the ESC.
    pub(crate) fn tick(&self, number: u64) -> Tick {
        let at = Time::new(number * TICK_NS);
        let system = match self.beyond {
            Some(beyond) => Time::new(self.esc.system_count(at).wrapping_add(beyond)),
            None => self.esc.system_time(at),
        };
        Tick { number, begin: self.oscillator.when(at), system }
    }

    /// From now on its system time is told in 64 bits, though its counter may have 32: a grid goes
    /// on where the counter begins again. `near` is about that time now, to 2.147 s; what lies
    /// beyond the counter is taken from it.
    pub(crate) fn count_on(&mut self, at: Time<True>, near: Time<Dc>) {
        if self.esc.register(register::FEATURES) & register::features::DC_64_BIT != 0 {
            return;
        }
        let at = Time::new(self.tick_at(at) * TICK_NS);
        let now = near.nearest(self.esc.system_time(at).count() as u32);
        self.beyond = Some(now.count().wrapping_sub(self.esc.system_count(at)));
    }

    /// Processes all events up to and including `limit`.
    #[inline]
    pub fn advance(&mut self, limit: Time<DeviceClock>, watch: &mut Watcher) {
        if self.quiet_until <= limit && !self.regular(limit, watch) {
            self.live(limit, watch);
        }
    }

    /// Whether nothing will happen by itself, even without any further frame.
    pub fn is_quiet(&self) -> bool {
        let timeout = self.stack.next_timeout().unwrap_or(Time::NEVER);
        let cpu = self.cpu.next().min(self.present.due());
        cpu.min(self.esc.next_event()).min(timeout) == Time::NEVER
    }

    /// Called after its ESC has processed a frame whose first bit left the MainDevice at `frame`:
    /// an event may be due earlier than before.
    pub(crate) fn touched(&mut self, frame: Time<True>) {
        debug_assert!(self.powered, "no frame gets to a SubDevice without power");
        self.frame = frame;
        self.esc.label_frame(frame.count());
        self.quiet_until = self.quiet_until.min(self.esc.quiet_until());
    }

    /// Passes a cyclic frame whose first bit left the MainDevice at `sent`, and that lasts from
    /// `begin` to `end` here. `false`: nothing was done, see [`Esc::pass_cyclic`].
    #[inline(always)]
    pub(crate) fn pass_cyclic(
        &mut self,
        begin: Time<DeviceClock>,
        end: Time<True>,
        sent: Time<True>,
        frame: &mut CyclicFrame,
        place: usize,
        payload: &mut [u8],
    ) -> bool {
        let Self { esc, oscillator, .. } = self;
        let end = || oscillator.read(end);
        let Some(due) = esc.pass_cyclic(begin, end, sent.count(), frame, place, payload) else {
            return false;
        };
        self.frame = sent;
        self.quiet_until = self.quiet_until.min(due);
        debug_assert!(self.quiet_until <= self.esc.quiet_until());
        true
    }

    /// What a cyclic frame collects that arrives at `begin` and only takes AL status from it, if
    /// that is known: see [`Esc::lasting_status`]. Events up to then can wait for the next frame.
    #[inline]
    pub(crate) fn look_ahead(&mut self, begin: Time<DeviceClock>) -> Option<u16> {
        if !self.regular || self.timeout <= begin {
            return None;
        }
        let status = self.esc.lasting_status(begin, self.stack.bears_a_miss())?;
        self.looked_at = begin;
        Some(status)
    }

    /// `at`, or when the last frame arrived that was not [passed](Self::look_ahead), if that is
    /// later: its events up to then count as processed.
    pub(crate) fn behind_looks(&self, at: Time<DeviceClock>) -> Time<DeviceClock> {
        self.looked_at.max(at)
    }

    /// Called after ESC or stack may have been changed from outside: all due times are computed
    /// again.
    pub fn disturbed(&mut self) {
        self.regular = false;
        if !self.powered {
            return;
        }
        self.timeout = self.stack.next_timeout().unwrap_or(Time::NEVER);
        self.quiet_until = Time::ZERO;
    }

    /// The same in the long way, after [`Self::regular`] could not go on.
    #[inline(never)]
    fn live(&mut self, limit: Time<DeviceClock>, watch: &mut Watcher) {
        self.regular = false;
        // Whatever comes now, it stands behind what was started before.
        self.put_present();
        loop {
            let (cpu, esc) = (self.cpu.next(), self.esc.quiet_until());
            let at = cpu.min(esc).min(self.timeout);
            if at > limit {
                self.quiet_until = at;
                return;
            }
            // What ends at an instant has ended before SYNC0 of that instant looks.
            if cpu == at {
                self.act(watch);
                // With nothing left on the agenda, what follows may be regular again.
                if self.cpu.is_idle() {
                    if self.regular(limit, watch) {
                        return;
                    }
                    self.regular = false;
                    self.put_present();
                }
                continue;
            }
            let event = if esc == at { self.esc.step(at) } else { None };
            self.look_for_lost_pulses(at, watch);
            if let Some((at, event)) = event {
                self.esc_event(at, event, watch);
            } else if self.timeout == at {
                self.call_back(at, watch);
            }
        }
    }

    /// Checks whether SYNC pulses were due while their signal was still active. No event of the ESC
    /// shows this, since there is no edge.
    fn look_for_lost_pulses(&mut self, at: Time<DeviceClock>, watch: &mut Watcher) {
        let now = self.esc.sync_pulses_without_edge();
        let before = std::mem::replace(&mut self.without_edge, now);
        for (signal, event) in [Event::Sync0, Event::Sync1].into_iter().enumerate() {
            // After a reset it counts from 0.
            if now[signal] > before[signal] {
                self.report(at, Observed::StillActive(event), Content::default(), watch);
            }
        }
    }

    fn act(&mut self, watch: &mut Watcher) {
        let Some((at, action)) = self.cpu.pop() else { return };
        self.tell_time(at);
        match action {
            Action::Begin(step) => self.begin(at, step, watch),
            Action::Finish(step) => self.finish(at, step, watch),
            Action::Acknowledge(pulse) => {
                self.stack.acknowledge_sync(pulse, &mut self.esc.pdi(at));
                self.report(at, Observed::Acknowledged(pulse), Content::default(), watch);
            }
            Action::Poll => {
                self.stack.poll(at, &mut self.esc.pdi(at));
                self.look(at, watch);
            }
        }
    }

    #[inline(always)]
    fn begin(&mut self, at: Time<DeviceClock>, step: Step, watch: &mut Watcher) {
        self.stack.begin(at, step, &mut self.esc.pdi(at));
        let frame = self.began(at, step);
        let content = Content { frame, ..Content::default() };
        self.report(at, Observed::Began(step), content, watch);
    }

    #[inline(always)]
    fn finish(&mut self, at: Time<DeviceClock>, step: Step, watch: &mut Watcher) {
        self.stack.finish(at, step, &mut self.esc.pdi(at));
        let frame = self.finished(step);
        let content = Content { frame, ..Content::default() };
        self.report(at, Observed::Finished(step), content, watch);
    }

    /// Puts what the last event has started onto the agenda.
    fn put_present(&mut self) {
        self.present.put_onto(&mut self.cpu);
    }

    /// Handles the start of a step; returns the frame that brought its outputs.
    #[inline(always)]
    fn began(&mut self, at: Time<DeviceClock>, step: Step) -> Time<True> {
        match step {
            Step::MapOutputs => {
                let label = self.esc.label(self.stack.description().outputs.sync_manager);
                self.fetched = Time::new(label);
                self.fetched
            }
            Step::OutputsValid if self.application().take_acted() => {
                let frame = self.mapped;
                if let Some(Some(plant)) = self.application().plant() {
                    plant.brought_by(frame);
                }
                frame
            }
            Step::LatchInputs => {
                self.esc.label_pdi(at.count());
                Time::ZERO
            }
            _ => Time::ZERO,
        }
    }

    /// Handles the end of a step; returns the frame that brought its outputs.
    #[inline(always)]
    fn finished(&mut self, step: Step) -> Time<True> {
        if step != Step::MapOutputs {
            return Time::ZERO;
        }
        // The only step whose end may move what the stack waits for.
        self.note_timeout();
        self.outputs_mapped()
    }

    /// Outputs were mapped, or dropped if they were late; returns the frame that brought them.
    #[inline]
    fn outputs_mapped(&mut self) -> Time<True> {
        if self.application().take_mapped() {
            self.mapped = self.fetched;
        }
        self.fetched
    }

    /// Whether neither a plant nor converters look at its application.
    #[inline]
    fn is_bare(&self) -> bool {
        self.stack.application().is_bare()
    }

    fn application(&mut self) -> &mut BoxedApplication {
        self.stack.application_mut()
    }

    fn esc_event(&mut self, at: Time<DeviceClock>, event: EscEvent, watch: &mut Watcher) {
        match event {
            EscEvent::FrameEnd { al_events } => {
                let description = self.stack.description();
                let sm = |area: ProcessDataArea| al_event::sync_manager(area.sync_manager.into());
                let (outputs, input_area) = (sm(description.outputs), description.inputs);
                let inputs = sm(input_area);
                // Further SyncManagers are exchanged with the first one of their direction, and are
                // no event of their own.
                let further = description.further_outputs.iter().chain(description.further_inputs);
                let further = further.fold(0, |events, area| events | sm(*area));
                let content = Content { frame: self.frame, ..Content::default() };
                if al_events & outputs != 0 {
                    self.event(at, Event::Sm2, (Observed::Sm2, content), watch);
                }
                if al_events & inputs != 0 {
                    let latched = Time::new(self.esc.label(input_area.sync_manager));
                    let content = Content { latched, ..content };
                    self.event(at, Event::Sm3, (Observed::Sm3, content), watch);
                }
                if al_events & !(outputs | inputs | further) != 0 {
                    self.cpu.wake(at);
                }
            }
            EscEvent::Sync0 => {
                self.event(at, Event::Sync0, (Observed::Sync0, Content::default()), watch);
            }
            EscEvent::Sync1 => {
                self.event(at, Event::Sync1, (Observed::Sync1, Content::default()), watch);
            }
            event => {
                self.ports_changed |= matches!(event, EscEvent::Ports | EscEvent::Reset);
                self.cpu.wake(at);
            }
        }
    }

    #[inline(always)]
    fn event(
        &mut self,
        at: Time<DeviceClock>,
        event: Event,
        (observed, content): (Observed, Content),
        watch: &mut Watcher,
    ) {
        self.report(at, observed, content, watch);
        self.tell_time(at);
        let samples = self.stack.application().sampler().is_some();
        if samples {
            self.begin_sampling(at);
        }
        let pdi = &mut self.esc.pdi(at);
        let steps = self.stack.handle_event_prepared(at, event, pdi, &mut self.prepared);
        let pulse = self.stack.take_unacknowledged().then_some(event);
        self.cpu.start(at, &steps, pulse);
        if samples {
            self.tell_samples(at, watch);
        }
        self.look(at, watch);
    }

    /// What the converters do at the event that follows, they do at this instant.
    fn begin_sampling(&mut self, at: Time<DeviceClock>) {
        let now = self.oscillator.when(at);
        if let Some(sampler) = self.application().sampler_mut() {
            sampler.tell_time(now);
            sampler.clear_seen();
        }
    }

    fn tell_samples(&self, at: Time<DeviceClock>, watch: &mut Watcher) {
        let sampler = self.stack.application().sampler();
        for sample in sampler.map(Sampler::seen).unwrap_or_default() {
            self.report(at, Observed::Sampled(*sample), Content::default(), watch);
        }
    }

    fn call_back(&mut self, at: Time<DeviceClock>, watch: &mut Watcher) {
        self.tell_time(at);
        let mut pdi = self.esc.pdi(at);
        let steps = self.stack.handle_event(at, Event::Timer, &mut pdi);
        self.stack.poll(at, &mut pdi);
        self.cpu.start(at, &steps, None);
        self.look(at, watch);
    }

    /// Finds out when the stack must be called.
    #[inline]
    fn note_timeout(&mut self) {
        let timeout = match self.stack.is_settled() {
            true => self.stack.sync_deadline(),
            false => self.stack.next_timeout(),
        };
        debug_assert_eq!(timeout, self.stack.next_timeout());
        self.timeout = timeout.unwrap_or(Time::NEVER);
    }

    /// The same after a pulse in regular operation.
    #[inline]
    fn look_in_lane(&mut self, at: Time<DeviceClock>, watch: &mut Watcher) {
        let timeout = self.stack.sync_deadline();
        let missed = self.stack.sync().missed_events_total();
        let is_in_op = self.stack.state() == isocat_wire::AlState::Op;
        // A device with a local timer may have SYNC pulses, too.
        if !is_in_op || missed != self.missed || self.stack.timer().is_some() {
            return self.look(at, watch);
        }
        debug_assert_eq!(timeout, self.stack.next_timeout());
        self.timeout = timeout.unwrap_or(Time::NEVER);
    }

    /// Finds changes of the stack, and reports them.
    #[inline(never)]
    fn look(&mut self, at: Time<DeviceClock>, watch: &mut Watcher) {
        self.note_timeout();
        let missed = self.stack.sync().missed_events_total();
        if missed != self.missed {
            self.missed = missed;
            let counter = self.stack.sync().sm_event_missed();
            self.report(at, Observed::SmEventMissed(counter), Content::default(), watch);
        }
        let state = (self.stack.state(), self.stack.status_code());
        let made_safe = self.stack.application_mut().take_made_safe();
        if made_safe && state == self.state && state.0 == isocat_wire::AlState::Op {
            self.report(at, Observed::OutputsSafe, Content::default(), watch);
        }
        if state != self.state {
            self.state = state;
            self.next_state_version(watch);
            if state.0 != isocat_wire::AlState::Op {
                // What it had is forgotten: nothing of it acts when OP is entered again.
                (self.fetched, self.mapped) = (Time::ZERO, Time::ZERO);
            }
            self.report(at, Observed::State(state.0, state.1), Content::default(), watch);
        }
    }

    #[inline(always)]
    fn report(
        &self,
        device_at: Time<DeviceClock>,
        event: Observed,
        content: Content,
        watch: &mut Watcher,
    ) {
        watch.see(Observation { device: self.position, device_at, event, content });
    }
}

/// A tick of an ESC's clock.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tick {
    /// Its number since the clock began to count.
    pub number: u64,
    /// When it begins.
    begin: Time<True>,
    /// The system time from then on.
    system: Time<Dc>,
}

impl Tick {
    /// No tick has its number.
    pub const NONE: Self = Self { number: u64::MAX, begin: Time::NEVER, system: Time::NEVER };

    /// The system time at a point of true time in it.
    #[inline]
    pub fn system_time(&self, at: Time<True>) -> ClockTime {
        ClockTime { shown: self.system.count(), since: at - self.begin }
    }
}

/// Length of a tick by the oscillator.
const TICK_NS: u64 = 10;

/// An ESC interface for a stack that must not access the ESC.
struct Nowhere;

impl Pdi for Nowhere {
    fn read(&mut self, address: u16, _: &mut [u8]) {
        unreachable!("a step that accesses nothing reads {address:#06x}");
    }
    fn write(&mut self, address: u16, _: &[u8]) {
        unreachable!("a step that accesses nothing writes {address:#06x}");
    }
}
