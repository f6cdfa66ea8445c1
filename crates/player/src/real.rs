//! Plays a list on a real interface: checks identities, goes the way up to the letter, operates
//! with the verdict engine, and goes down.
//!
//! [`Job::run`] does all of it on a real-time thread, and returns an [`Outcome`] like a run of
//! isocat's own MainDevice, so that reports and exit codes are the same. `identity` compares the
//! SubDevices that answer with the list; `segment` collects what is known of them for the judges;
//! `operate` is the time in operation.

mod identity;
mod operate;
mod segment;
mod wire;

use std::sync::atomic::AtomicBool;

use isocat_descriptions::start_up::{StartUp, Transition};
use isocat_engine::live::Outcome;
use isocat_engine::live::job::{End, Machine};
use isocat_engine::plan::Plan;
use isocat_engine::report::quality::Quality;
use isocat_host::preflight::Subject;
use isocat_host::{LinkError, RawSocket, Recorder, Traffic, Waiting, Wish};
use isocat_maindevice::QualityWatch;
use isocat_sim::run::Progress;
use isocat_wire::Command;
use isocat_wire::al::{AlControl, AlState, AlStatus};
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use self::operate::{Operation, Verdicts};
use self::wire::RealWire;
use crate::failure::{Failure, Kind};
use crate::line::SOURCE;
use crate::play::{Done, Player};

/// A list, the interface to play it on, and settings.
pub struct Job<'a> {
    /// The list.
    pub list: &'a StartUp,
    /// isocat's plan of the same segment, as source of the devices' times; `None`: there is none.
    pub plan: Option<&'a Plan>,
    /// Whether the times of a device are only assumed, by position, so that they prove nothing.
    pub assumed: Vec<bool>,
    /// The open interface.
    pub socket: RawSocket,
    /// Its network namespace.
    pub namespace: Option<String>,
    /// How long to run after all SubDevices are in OP.
    pub duration: Nanos,
    /// Largest 0x092C of a synchronized clock.
    pub difference_limit: Nanos,
    /// Lateness of frames that the plan allows for.
    pub jitter: Nanos,
    /// What is read in the background during operation.
    pub quality: QualityWatch,
    /// The requested real-time settings of the machine.
    pub wish: Wish,
    /// The recorder of frames.
    pub recorder: Option<Recorder>,
}

/// The result of playing a list on a real interface.
pub struct PlayedOnWire {
    /// Why it ended early.
    pub failure: Option<Failure>,
    /// What was done of the list.
    pub done: Done,
    /// What the wire showed, like for a run of isocat's own MainDevice.
    pub outcome: Outcome,
}

impl Job<'_> {
    /// Does everything on its own real-time thread. Ends early if `stop` is set. `Err`: the
    /// interface or its namespace failed before anything was sent.
    pub fn run(
        self,
        stop: &AtomicBool,
        progress: &mut (dyn FnMut(Progress) + Send),
    ) -> Result<PlayedOnWire, LinkError> {
        std::thread::scope(|scope| {
            let thread = scope.spawn(|| self.run_here(stop, progress));
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    fn run_here(
        self,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<PlayedOnWire, LinkError> {
        let cycle = Nanos(self.list.cycle_ns);
        let interface = self.socket.interface().to_owned();
        let namespace = self.namespace.as_deref();
        let subject =
            Subject { interface: Some(&interface), namespace, wish: self.wish, keeps_awake: false };
        let (_awake, machine) = Machine::prepare(subject, Some(&self.socket), cycle)?;
        let before = Traffic::of(&interface, namespace);
        let waiting = match self.wish.busy {
            true => Waiting::Busy,
            false => Waiting::sleep(&machine.wake_ups, cycle),
        };
        let link = isocat_host::Link::new(self.socket, waiting, self.recorder, SOURCE, self.jitter);
        let mut wire = RealWire::new(link, cycle);
        let mut player = Player::new(self.list, &mut wire, false);
        player.line.stop = Some(stop);

        let mut notes = Vec::new();
        let mut segment = segment::of_list(self.list, self.plan, &self.assumed, self.jitter);
        let identified = identify(&mut player, &mut segment, &mut notes);
        // A segment that does not match the list is not changed.
        let was_touched = identified.is_ok();
        let brought = identified
            .and_then(|()| player.bring_up())
            .and_then(|()| Ok(segment::complete(&mut player, &mut segment)?));
        let mut statistics = (player.line.tally.statistics, player.line.tally.statistics);
        let (mut verdicts, mut ended) = (Verdicts::default(), Ended::Time);
        let mut failure = None;
        match brought {
            Err(kind) => failure = Some(kind),
            Ok(()) => {
                let mut operation =
                    Operation::begin(&mut player, segment, self.difference_limit, self.quality);
                statistics.0 = operation.statistics();
                ended = operation.run(self.duration, progress);
                statistics.1 = operation.statistics();
                (verdicts, segment) = operation.end(&ended);
            }
        }
        let counts = player.counts();
        let phase = player.line.exchange.as_ref().and_then(|exchange| exchange.phase());
        player.line.stop = None;
        if was_touched && failure.is_some() {
            // SubDevices that do not answer have no state in the report.
            let _silent = segment::read_states(&mut player, &mut segment);
        }
        if was_touched && !matches!(ended, Ended::Broken) {
            notes.extend(go_down(&mut player));
        }
        let total = player.line.tally.statistics;
        if failure.is_some() {
            statistics.1 = total;
        }
        let done = Done { counts, ..player.into_done() };
        let Verdicts { verdict, devices, judged, locks_lost, stall, quality, alarms } = verdicts;
        let broken = wire.broken.take();
        let end = end(ended, failure.as_ref(), broken);
        let carrier = wire.link.socket().has_carrier();
        let after = Traffic::of(&interface, namespace);
        let mut outcome = Outcome {
            machine,
            segment,
            statistics,
            figures: *wire.link.figures(),
            phase: phase.map(|(state, ..)| state),
            locks_lost,
            stall,
            rate_ppb: phase.map(|(_, rate, _)| rate),
            uncertainty: phase.and_then(|(.., uncertainty)| uncertainty),
            axes: Vec::new(),
            devices,
            judged,
            end,
            quality: quality.map(|quality: Quality| quality.with_alarms(&alarms)),
            findings: verdict.findings,
            unknown: verdict.unknown,
            visits: verdict.visits,
            notes,
            recorder: None,
        };
        outcome.conclude(&interface, carrier, self.jitter, total, before.zip(after));
        outcome.recorder = wire.link.into_recorder();
        // A stop by the user is no failure of the list.
        let failure = failure.filter(|failure| !matches!(failure.kind, Kind::Ended));
        Ok(PlayedOnWire { failure, done, outcome })
    }
}

/// Why the time in operation ended.
pub(crate) enum Ended {
    /// The requested time has passed.
    Time,
    /// The user stopped it.
    Asked,
    /// No frame came back any more.
    Silence,
    /// The interface failed.
    Broken,
}

fn end(ended: Ended, failure: Option<&Failure>, broken: Option<LinkError>) -> End {
    let (position, what) = failure.map(Failure::of_device).unwrap_or_default();
    match (failure.map(|failure| &failure.kind), broken, ended) {
        (_, Some(error), _) => End::Link(error),
        (Some(Kind::Ended), ..) | (None, _, Ended::Asked) => End::Asked,
        (None, _, Ended::Silence) => End::Silence,
        (None, ..) => End::Time,
        (Some(kind), ..) => End::List { what, position, refused: kind.is_refused() },
    }
}

/// Compares the SubDevices that answer with the list, before any set-up is written.
fn identify(
    player: &mut Player<'_>,
    segment: &mut isocat_maindevice::Segment,
    notes: &mut Vec<String>,
) -> Result<(), Failure> {
    player.check()?;
    let found = identity::read(&mut player.line, player.list.devices.len())?;
    identity::compare(player.list, &found)?;
    notes.extend(identity::notes(player.list, &found));
    for (device, header) in segment.devices.iter_mut().zip(found) {
        device.identity = isocat_maindevice::segment::Identity {
            vendor: header.vendor_id,
            product: header.product_code,
            revision: header.revision,
            serial: header.serial,
        };
        device.sii.header = header;
    }
    Ok(())
}

/// Executes the list's commands for the way down, state by state; then requests INIT of all
/// SubDevices in any case. Returns what went wrong.
fn go_down(player: &mut Player<'_>) -> Vec<String> {
    let mut notes = Vec::new();
    let (op, safe, pre, init) = (AlState::Op, AlState::SafeOp, AlState::PreOp, AlState::Init);
    let was_up = player.line.exchange.as_ref().is_some_and(|exchange| exchange.state == op);
    let steps = [(op, safe), (safe, pre), (pre, init)];
    for (from, to) in steps.into_iter().filter(|_| was_up) {
        player.enter(to);
        if let Err(failure) = player.transition(Transition { from, to }) {
            notes.push(format!("the way down: {failure}"));
            break;
        }
    }
    player.line.exchange = None;
    match all_to_init(player) {
        Ok(true) => {}
        Ok(false) => {
            notes.push("the way down did not end; SubDevices may still be in OP".to_owned());
        }
        Err(kind) => notes.push(format!("the way down: {kind}")),
    }
    notes
}

/// Requests INIT of all SubDevices until they have reached it.
fn all_to_init(player: &mut Player<'_>) -> Result<bool, Kind> {
    let line = &mut player.line;
    let limit = line.now() + isocat_host::STOP_LIMIT;
    let of = |register| isocat_descriptions::start_up::Address::Physical { device: 0, register };
    // The request also acknowledges the error bit.
    let wish = AlControl::request_and_acknowledge(AlState::Init).to_bytes();
    while line.now() < limit {
        line.datagram(Command::Bwr, of(register::AL_CONTROL.address), &wish)?;
        line.sleep(BETWEEN_LOOKS)?;
        let reply = line.datagram(Command::Brd, of(register::AL_STATUS.address), &[0; 2])?;
        let status = reply.and_then(|reply| reply.data.first_chunk().copied());
        if status.is_some_and(|status| AlStatus::from_bytes(status) == AlStatus::new(AlState::Init))
        {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Time between two readings of AL status on the way down.
const BETWEEN_LOOKS: Nanos = Nanos::millis(2);
