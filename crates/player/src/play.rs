//! The procedure: INIT to PREOP, clocks, PREOP to SAFEOP, process data, SAFEOP to OP, and then the
//! exchange.

use isocat_descriptions::start_up::{
    Address, DeviceStartUp, ObjectStep, ParameterStep, RegisterStep, StartUp, Step, Transition,
};
use isocat_segment::Scenario;
use isocat_serve::{Bus, Setup, Summary};
use isocat_sync::start::Grid;
use isocat_wire::al::AlState;
use isocat_wire::mailbox::ErrorDetail;
use isocat_wire::register::{self, Value};
use isocat_wire::soe::ErrorCode;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AbortCode, Command};

pub use crate::clock::Unit;
use crate::clock::{self, Clocks};
use crate::cyclic::{Counts, Exchange, is_lead};
use crate::failure::{Failure, Kind, Place, Target};
use crate::line::Line;
use crate::virtual_segment::assign_activate;
use crate::wire::{VirtualWire, Wire};
use crate::{mailbox, step};

/// Settings of a run.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Settings {
    /// How long the exchange runs after all devices are in OP.
    pub duration: Nanos,
    /// Whether devices may lack objects that the list writes, because their descriptions are
    /// incomplete: such a download is noted and left out. If false, it ends the run, as with any
    /// other device.
    pub tolerates_unknown_objects: bool,
}

/// The result of playing a list on a virtual segment.
pub struct Played {
    /// Why it ended early.
    pub failure: Option<Failure>,
    /// What was done of the list.
    pub done: Done,
    /// What the segment and its judges saw.
    pub summary: Summary,
    /// The segment in its state at the end.
    pub bus: Bus,
}

/// What was done of a list.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Done {
    /// Number of successful commands of the list.
    pub commands: usize,
    /// The measured clocks by position; `None`: the device has no clock. Empty if the list uses no
    /// clocks.
    pub clocks: Vec<Option<Unit>>,
    /// The start time that replaced the list's (0x0990), by position.
    pub starts: Vec<Option<u64>>,
    /// Objects that the list writes and a virtual device does not have, with the position of the
    /// device.
    pub unknown_objects: Vec<(usize, Target)>,
    /// Counts of the cyclic exchange in OP.
    pub counts: Counts,
}

/// Plays a list on the virtual segment of a scenario.
pub fn play(list: &StartUp, scenario: &Scenario, settings: Settings) -> Played {
    play_with(list, scenario, settings, &mut |_, _| {})
}

/// Plays a list like [`play`]; `tap` sees each frame that the player sends.
pub fn play_with(
    list: &StartUp,
    scenario: &Scenario,
    settings: Settings,
    tap: &mut dyn FnMut(Time<Host>, &[u8]),
) -> Played {
    let begin: Time<Host> = Time::new(1_000_000_000);
    let bus = Bus::new(Setup::from(scenario), begin);
    let mut wire = VirtualWire::new(bus, scenario.seed, scenario.host.jitter, tap);
    let mut player = Player::new(list, &mut wire, settings.tolerates_unknown_objects);
    let failure = player.bring_up().and_then(|()| Ok(player.line.sleep(settings.duration)?)).err();
    let done = player.into_done();
    let summary = wire.bus.summary(&scenario.source, "virtual");
    Played { failure, done, summary, bus: wire.bus }
}

/// A MainDevice that plays a list on a wire.
pub(crate) struct Player<'a> {
    pub list: &'a StartUp,
    pub line: Line<'a>,
    commands: usize,
    pub clocks: Option<Clocks>,
    starts: Vec<Option<u64>>,
    /// The latest first pulse of all devices, in host time.
    latest_start: Option<Time<Host>>,
    pub mailbox_counters: Vec<u8>,
    tolerates_unknown_objects: bool,
    unknown_objects: Vec<(usize, Target)>,
}

impl<'a> Player<'a> {
    pub fn new(list: &'a StartUp, wire: &'a mut dyn Wire, tolerates_unknown_objects: bool) -> Self {
        Self {
            list,
            line: Line::new(wire),
            commands: 0,
            clocks: None,
            starts: vec![None; list.devices.len()],
            latest_start: None,
            mailbox_counters: vec![0; list.devices.len()],
            tolerates_unknown_objects,
            unknown_objects: Vec::new(),
        }
    }

    /// The present counts of the cyclic exchange.
    pub fn counts(&self) -> Counts {
        self.line.exchange.as_ref().map(|exchange| exchange.counts).unwrap_or_default()
    }

    /// What was done of the list.
    pub fn into_done(self) -> Done {
        let Self { line, commands, clocks, starts, unknown_objects, .. } = self;
        let counts = line.exchange.map(|exchange| exchange.counts).unwrap_or_default();
        let clocks = clocks.map(|clocks| clocks.units).unwrap_or_default();
        Done { commands, clocks, starts, unknown_objects, counts }
    }
}

impl Player<'_> {
    /// Brings all devices to OP.
    pub fn bring_up(&mut self) -> Result<(), Failure> {
        self.check()?;
        self.line.sleep(SWITCHED_ON)?;
        self.transition(Transition::IP)?;
        self.clocks = clock::set(&mut self.line, self.list)?;
        self.begin_cycle()?;
        self.transition(Transition::PS)?;
        self.enter(AlState::SafeOp);
        self.wait_for_process_data()?;
        self.transition(Transition::SO)?;
        self.enter(AlState::Op);
        self.forget_counts();
        Ok(())
    }

    /// Refuses lists that require what the player does not support, before anything is sent.
    pub fn check(&self) -> Result<(), Failure> {
        let mut cyclic = self.list.frames.iter().flat_map(|frame| &frame.datagrams);
        if cyclic.any(is_lead) {
            return Err(Kind::HostLeads.into());
        }
        let starts = |device: &DeviceStartUp| assign_activate(device).to_bytes()[1] & 1 != 0;
        match self.list.devices.iter().position(starts) {
            Some(position) if clock::reference(self.list).is_none() => {
                Err(Kind::NoDriftDatagram { position }.into())
            }
            _ => Ok(()),
        }
    }

    /// Executes all commands of a transition: the MainDevice's own commands before the devices',
    /// those of each device, and the MainDevice's own commands after them.
    pub fn transition(&mut self, transition: Transition) -> Result<(), Failure> {
        let list = self.list;
        let of_all = |step: &&RegisterStep| step.transitions.contains(&transition);
        for step in list.before.iter().filter(of_all) {
            self.register(None, transition, step)?;
        }
        for (position, device) in list.devices.iter().enumerate() {
            for step in device.at(transition) {
                match step {
                    Step::Register(step) => self.register(Some(position), transition, step)?,
                    Step::Object(step) => self.object(position, device, transition, step)?,
                    Step::Parameter(step) => self.parameter(position, device, transition, step)?,
                }
            }
        }
        for step in list.after.iter().filter(of_all) {
            self.register(None, transition, step)?;
        }
        Ok(())
    }

    fn object(
        &mut self,
        position: usize,
        device: &DeviceStartUp,
        transition: Transition,
        step: &ObjectStep,
    ) -> Result<(), Failure> {
        let way = way(&mut self.mailbox_counters[position], device);
        let done = mailbox::download(&mut self.line, way, step);
        let unknown =
            matches!(done, Err(Kind::Abort(AbortCode::NO_OBJECT | AbortCode::NO_SUBINDEX)));
        let target = Target::Object(step.object);
        self.written(done, unknown, position, transition, target, &step.comment)
    }

    fn parameter(
        &mut self,
        position: usize,
        device: &DeviceStartUp,
        transition: Transition,
        step: &ParameterStep,
    ) -> Result<(), Failure> {
        let way = way(&mut self.mailbox_counters[position], device);
        let done = mailbox::write(&mut self.line, way, step);
        let unknown = matches!(
            done,
            Err(Kind::Drive(ErrorCode::NO_IDN | ErrorCode::DRIVE_NUMBER)
                | Kind::Refused(ErrorDetail::UNSUPPORTED_PROTOCOL))
        );
        let target = Target::Parameter(step.drive, step.idn);
        self.written(done, unknown, position, transition, target, &step.comment)
    }

    /// Handles the result of a write through a mailbox. Objects that the device does not have may
    /// be tolerated.
    fn written(
        &mut self,
        done: Result<(), Kind>,
        unknown: bool,
        position: usize,
        transition: Transition,
        target: Target,
        comment: &str,
    ) -> Result<(), Failure> {
        if unknown && self.tolerates_unknown_objects {
            self.unknown_objects.push((position, target));
            return Ok(());
        }
        self.done(done, Some(position), transition, target, comment)
    }

    fn register(
        &mut self,
        position: Option<usize>,
        transition: Transition,
        step: &RegisterStep,
    ) -> Result<(), Failure> {
        let measured = self.measured(step)?;
        let data = measured.as_deref().unwrap_or(&step.data);
        let done = step::register(&mut self.line, step, data);
        let target = Target::Register(step.command, step.address);
        self.done(done, position, transition, target, &step.comment)
    }

    fn done(
        &mut self,
        done: Result<(), Kind>,
        position: Option<usize>,
        transition: Transition,
        target: Target,
        comment: &str,
    ) -> Result<(), Failure> {
        let Err(kind) = done else {
            self.commands += 1;
            return Ok(());
        };
        let named = |position: usize| (position, self.list.devices[position].name.clone());
        let device = position.map(named);
        let comment = comment.to_owned();
        Err(Failure { place: Some(Box::new(Place { device, transition, target, comment })), kind })
    }

    /// The value that replaces a placeholder of the list: a clock's offset or delay, or the time of
    /// the first pulse.
    fn measured(&mut self, step: &RegisterStep) -> Result<Option<Vec<u8>>, Failure> {
        let Address::Physical { device, register } = step.address else { return Ok(None) };
        let position = match step.command {
            Command::Fpwr => self.list.devices.iter().position(|one| one.station == device),
            Command::Apwr => Some(usize::from(device.wrapping_neg())),
            _ => None,
        };
        let Some(clocks) = self.clocks.clone() else { return Ok(None) };
        let unit = position.and_then(|position| Some((position, (*clocks.units.get(position)?)?)));
        let Some((position, unit)) = unit else { return Ok(None) };
        let mut value = match register {
            _ if register == register::SYSTEM_TIME_OFFSET.address => {
                unit.offset.to_bytes().to_vec()
            }
            _ if register == register::SYSTEM_TIME_DELAY.address => {
                (unit.delay.0 as u32).to_bytes().to_vec()
            }
            _ if register == register::SYNC_START_TIME.address => {
                let start = self.start(&clocks, position)?;
                let start = if unit.is_wide { start } else { start & u64::from(u32::MAX) };
                start.to_bytes().to_vec()
            }
            _ => return Ok(None),
        };
        value.resize(step.data.len(), 0);
        Ok(Some(value))
    }

    /// The first pulse of a device: on the grid of all cycles, after a lead time, with the shift of
    /// the list.
    fn start(&mut self, clocks: &Clocks, position: usize) -> Result<u64, Failure> {
        let cycles = self.list.devices.iter().filter_map(|device| device.dc);
        let cycles = cycles.map(|dc| Nanos(dc.sync0_ns.into())).filter(|cycle| cycle.0 > 0);
        let grid = Grid::of(cycles.chain([Nanos(self.list.cycle_ns)])).map_err(|_| Kind::NoGrid)?;
        let shift = self.list.devices[position].dc.map_or(0, |dc| dc.shift_ns);
        let now = clock::system_time(&mut self.line, clocks)?;
        let start = grid.start(now, LEAD, Nanos(shift.into()));
        let there = self.line.now() + (start - now);
        self.latest_start = Some(self.latest_start.map_or(there, |latest| latest.max(there)));
        self.starts[position] = Some(start.count());
        Ok(start.count())
    }

    /// Begins the exchange in PREOP, and waits until it is locked on the reference clock.
    fn begin_cycle(&mut self) -> Result<(), Failure> {
        let clocks = self.clocks.clone();
        let reference = match &clocks {
            Some(clocks) => Some(clock::system_time(&mut self.line, clocks)?),
            None => None,
        };
        let (cycle, start) = (Nanos(self.list.cycle_ns), self.line.now() + Nanos::micros(100));
        let noise = self.line.wire.traits().stamp_noise;
        self.line.exchange = Some(Exchange::new(&self.list.frames, cycle, start, reference, noise));
        let end = start + LOCKING.max(Nanos(cycle.0.saturating_mul(LOCKING_CYCLES)));
        while !self.exchange().is_locked() {
            if self.line.now() > end {
                return Err(Kind::NotLocked { error: self.exchange().phase_error() }.into());
            }
            self.line.cycle()?;
        }
        Ok(())
    }

    /// Waits for outputs and SYNC, which must be there before OP is requested.
    fn wait_for_process_data(&mut self) -> Result<(), Failure> {
        if let Some(start) = self.latest_start.filter(|start| *start > self.line.now()) {
            let left = start - self.line.now();
            self.line.sleep(left + Nanos(self.list.cycle_ns))?;
        }
        self.see_sync()?;
        self.forget_counts();
        let slowest = self.list.frames.iter().map(|frame| frame.every).max().unwrap_or(1);
        let cycle = Nanos(self.list.cycle_ns);
        let needed = COMPLETE_CYCLES * u64::from(slowest);
        let span = Nanos(cycle.0.saturating_mul(needed as i64));
        let end = self.line.now() + PROCESS_DATA.max(span + span);
        while self.exchange().complete < needed {
            if self.line.now() > end {
                let (expected, found) = self.exchange().counts.first_wrong.unwrap_or_default();
                return Err(Kind::ProcessData { expected, found }.into());
            }
            self.line.cycle()?;
        }
        Ok(())
    }

    /// Checks that the next pulse of each started SYNC unit is in the future: a unit that was
    /// started too late gives no pulse until its clock wraps around.
    fn see_sync(&mut self) -> Result<(), Failure> {
        let Some(clocks) = self.clocks.clone() else { return Ok(()) };
        for position in 0..self.starts.len() {
            let (Some(_), Some(unit)) = (self.starts[position], clocks.units[position]) else {
                continue;
            };
            let register = register::SYNC_START_TIME.address;
            let next = self.line.read(unit.station, register, 8)?;
            let next = next.and_then(|bytes| bytes.first_chunk().copied()).map(u64::from_le_bytes);
            let now = clock::system_time(&mut self.line, &clocks)?;
            let cycle = self.list.devices[position].dc.map_or(0, |dc| i64::from(dc.sync0_ns));
            let ahead = next.map(|next| match unit.is_wide {
                true => next.wrapping_sub(now.count()) as i64,
                false => i64::from((next as u32).wrapping_sub(now.count() as u32) as i32),
            });
            // A pulse may come between the two readings, which are a frame apart.
            let most = 2 * cycle.max(self.list.cycle_ns);
            if !ahead.is_some_and(|ahead| (-most..=most).contains(&ahead)) {
                return Err(Kind::NoPulses { position }.into());
            }
        }
        Ok(())
    }

    /// Sets the state of the MainDevice, which determines the cyclic datagrams.
    pub fn enter(&mut self, state: AlState) {
        if let Some(exchange) = &mut self.line.exchange {
            exchange.state = state;
        }
    }

    fn forget_counts(&mut self) {
        let exchange = self.exchange();
        (exchange.counts, exchange.complete) = (Counts::default(), 0);
    }

    fn exchange(&mut self) -> &mut Exchange {
        self.line.exchange.as_mut().expect("the exchange has begun")
    }
}

/// Time after power-on in which devices load their EEPROMs.
const SWITCHED_ON: Nanos = Nanos::millis(100);
/// Time from the command that writes the first pulse to that pulse. The SDO downloads and changes
/// of state of all devices take place in it.
const LEAD: Nanos = Nanos::millis(100);
/// Longest time for locking on the reference clock, and the least number of cycles for it.
const LOCKING: Nanos = Nanos::millis(20_000);
const LOCKING_CYCLES: i64 = 64;
/// Number of consecutive cycles with right working counters before OP is requested.
const COMPLETE_CYCLES: u64 = 10;
/// How long to wait for these cycles.
const PROCESS_DATA: Nanos = Nanos::millis(5_000);

/// The mailbox settings and counter of a device.
const fn way<'a>(counter: &'a mut u8, device: &DeviceStartUp) -> mailbox::Way<'a> {
    mailbox::Way { station: device.station, areas: device.mailbox, counter }
}
