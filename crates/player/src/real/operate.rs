//! The time in operation: the list's cycle continues, registers and objects are read between its
//! frames, and the verdict engine judges all of it.

use isocat_engine::report::quality::Quality;
use isocat_engine::verdict::{Engine, Readings, Verdict, Witness};
use isocat_maindevice::quality::{
    Background, Change, ClockQuality, ObjectQuality, Registers, wire_time,
};
use isocat_maindevice::segment::Segment;
use isocat_maindevice::statistics::Statistics;
use isocat_maindevice::{Event, QualityWatch, SdoError};
use isocat_sim::run::{Counters, Progress};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::phase;
use isocat_wire::ObjectAddress;
use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::dc::{ActivationStatus, SystemTimeDifference};
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};

use super::Ended;
use crate::failure::Kind;
use crate::mailbox;
use crate::play::Player;

/// A list in operation.
pub(super) struct Operation<'p, 'a> {
    player: &'p mut Player<'a>,
    seen: Seen,
    engine: Engine,
    began: Time<Host>,
    /// The time that was judged, after it has ended.
    judged: Nanos,
    before: Vec<Readings>,
    quality: QualityWatch,
    alarms: Vec<(Nanos, Change)>,
    /// When the next AL status is read, and the position of the SubDevice.
    look: (Time<Host>, usize),
}

/// The view of the engine.
struct Seen {
    segment: Segment,
    background: Background,
    statistics: Statistics,
    phase: Option<phase::State>,
}

/// The results of the time in operation.
#[derive(Default)]
pub(super) struct Verdicts {
    pub verdict: Verdict,
    pub devices: Vec<Readings>,
    pub judged: Option<Nanos>,
    pub locks_lost: u64,
    pub stall: Option<(Nanos, Nanos)>,
    pub quality: Option<Quality>,
    pub alarms: Vec<(Nanos, Change)>,
}

impl Witness for Seen {
    fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    fn segment(&self) -> &Segment {
        &self.segment
    }

    fn phase(&self) -> Option<phase::State> {
        self.phase
    }

    fn clocks(&self) -> &[ClockQuality] {
        self.background.clocks()
    }

    fn objects(&self) -> Option<&[ObjectQuality]> {
        Some(self.background.objects())
    }

    fn watches_delays(&self) -> bool {
        false
    }
}

impl<'p, 'a> Operation<'p, 'a> {
    /// Begins when all SubDevices are in OP; `limit` is the largest 0x092C of a synchronized clock.
    pub fn begin(
        player: &'p mut Player<'a>,
        mut segment: Segment,
        limit: Nanos,
        quality: QualityWatch,
    ) -> Self {
        let now = player.line.now();
        // Events of the way up do not belong to operation.
        while player.line.tally.poll_event(now).is_some() {}
        for device in &mut segment.devices {
            device.al_status = AlStatus::new(AlState::Op);
        }
        let background = Background::new(&quality, &segment, now, &[]);
        let statistics = player.line.tally.statistics;
        let counts = &mut player.line.tally.statistics;
        counts.bring_up_frames = counts.frames_sent;
        let phase = player.line.exchange.as_ref().and_then(|exchange| exchange.phase());
        let seen = Seen { segment, background, statistics, phase: phase.map(|(state, ..)| state) };
        let engine = Engine::begin(&seen, limit, Vec::new());
        let count = seen.segment.devices.len();
        Self {
            player,
            seen,
            engine,
            began: now,
            judged: Nanos::ZERO,
            before: vec![Readings::default(); count],
            quality,
            alarms: Vec::new(),
            look: (now, 0),
        }
    }

    /// The present counts.
    pub fn statistics(&self) -> Statistics {
        self.player.line.tally.statistics
    }

    /// Runs the segment.
    pub fn run(&mut self, duration: Nanos, progress: &mut dyn FnMut(Progress)) -> Ended {
        self.player.line.wire.measure(true);
        let result = self.go_on(duration, progress);
        self.player.line.wire.measure(false);
        self.take_events();
        self.judged = self.player.line.now() - self.began;
        match result {
            Ok(ended) => ended,
            Err(Kind::Ended) => Ended::Asked,
            Err(_) => Ended::Broken,
        }
    }

    fn go_on(
        &mut self,
        duration: Nanos,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Ended, Kind> {
        // Only the increase of the counters in operation is judged, so their values at the
        // beginning are read.
        let mut before = std::mem::take(&mut self.before);
        let read = self.read_counters(&mut before, |readings| {
            (&mut readings.outputs_before, &mut readings.inputs_before)
        });
        self.before = before;
        read?;
        let (end, mut told) = (self.player.line.now() + duration, self.began);
        loop {
            self.player.line.cycle()?;
            self.take_events();
            let now = self.player.line.now();
            if now >= end {
                return Ok(Ended::Time);
            }
            if self.player.line.is_silent(SILENCE) {
                return Ok(Ended::Silence);
            }
            if now - told >= PROGRESS {
                told = now;
                progress(Progress::Judged(now - self.began));
            }
            self.read_in_background(now)?;
        }
    }

    /// Ends operation: reads the final values from the SubDevices, and makes the verdict.
    pub fn end(mut self, ended: &Ended) -> (Verdicts, Segment) {
        let mut devices = std::mem::take(&mut self.before);
        let mut answered = false;
        if matches!(ended, Ended::Time | Ended::Asked) {
            // The first stop signal must not prevent these readings; a second one ends the program
            // at once.
            self.player.line.stop = None;
            answered = self.read_at_end(&mut devices).is_ok();
        }
        self.take_events();
        let now = self.player.line.now();
        let (locks_lost, stall) = (self.engine.locks_lost(), self.engine.stall());
        let readings = if answered { &devices[..] } else { &[] };
        let verdict = self.engine.end(now - self.began, &self.seen, &[], readings);
        let Seen { segment, background, .. } = self.seen;
        let time = (self.began, now - self.began);
        let quality = Quality::of_background(&background, &segment.devices, self.quality, time);
        let verdicts = Verdicts {
            verdict,
            devices: if answered { devices } else { Vec::new() },
            judged: Some(self.judged),
            locks_lost,
            stall,
            quality: Some(quality),
            alarms: self.alarms,
        };
        (verdicts, segment)
    }

    /// Passes events and counts to the engine.
    fn take_events(&mut self) {
        let line = &mut self.player.line;
        let now = line.now();
        while let Some((at, event)) = line.tally.poll_event(now) {
            self.engine.event(at - self.began, &event);
        }
        self.seen.statistics = line.tally.statistics;
        let phase = line.exchange.as_ref().and_then(|exchange| exchange.phase());
        self.seen.phase = phase.map(|(state, ..)| state);
        self.engine.cycle(now - self.began, &self.seen);
    }

    /// Makes one background reading, if it is due: states, clocks or objects.
    fn read_in_background(&mut self, now: Time<Host>) -> Result<(), Kind> {
        let is_op = |status: u16| AlStatus(status) == AlStatus::new(AlState::Op);
        let watch = self.player.line.exchange.as_ref().and_then(|exchange| exchange.al_status);
        if watch.is_some_and(|status| !is_op(status)) {
            for position in 0..self.seen.segment.devices.len() {
                self.look_at(position)?;
            }
        } else if now >= self.look.0 {
            let position = self.look.1 % self.seen.segment.devices.len().max(1);
            self.look = (now + LOOK, position + 1);
            self.look_at(position)?;
        }
        for (index, station, has_status) in self.seen.background.clocks_to_read(now) {
            let found = self.clock(station.0, has_status)?;
            let changes = self.seen.background.take_clock(index, found);
            self.take_changes(changes);
        }
        if let Some(wanted) = self.seen.background.entry_to_read(now, |_| true) {
            let (answer, cost) = match self.upload(wanted.0, wanted.1)? {
                Some(answer) => (answer, self.mailbox_cost(wanted.0)),
                None => return Ok(()),
            };
            let now = self.player.line.now();
            let changes = self.seen.background.take_entry(wanted, now, &answer, cost, true);
            self.take_changes(changes);
        }
        Ok(())
    }

    /// Reads the state of one SubDevice, and reports a change.
    fn look_at(&mut self, position: usize) -> Result<(), Kind> {
        let found = self.status(position)?;
        let cycle = self.player.line.tally.statistics.cycles;
        let now = self.player.line.now();
        let device = &mut self.seen.segment.devices[position];
        let Some((status, code)) = found else {
            if std::mem::take(&mut device.admitted) {
                self.player.line.tally.tell(now, Event::Lost { position, cycle });
            }
            return Ok(());
        };
        if device.al_status == status {
            return Ok(());
        }
        (device.al_status, device.al_code) = (status, code);
        self.player.line.tally.tell(now, Event::StateChanged { position, status, code, cycle });
        Ok(())
    }

    /// Reads registers 0x0130 and 0x0134.
    fn status(&mut self, position: usize) -> Result<Option<(AlStatus, AlStatusCode)>, Kind> {
        let station = self.player.list.devices[position].station;
        let bytes = self.player.line.read(station, register::AL_STATUS.address, 6)?;
        let word = |bytes: &[u8], at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        Ok(bytes.map(|bytes| (AlStatus(word(&bytes, 0)), AlStatusCode(word(&bytes, 4)))))
    }

    fn clock(&mut self, station: u16, has_status: bool) -> Result<Option<Registers>, Kind> {
        let line = &mut self.player.line;
        let at = line.now();
        let bytes = line.read(station, register::SYSTEM_TIME_DIFFERENCE.address, 8)?;
        let activation = match has_status {
            true => line.read(station, register::ACTIVATION_STATUS.address, 1)?,
            false => None,
        };
        let activation = activation.map(|bytes| ActivationStatus(bytes[0]));
        let bytes = bytes.and_then(|bytes| bytes.first_chunk().copied());
        Ok(bytes.map(|bytes| Registers { at, bytes, activation }))
    }

    /// Reads an entry; `None`: the SubDevice has no such mailbox.
    fn upload(
        &mut self,
        position: usize,
        object: ObjectAddress,
    ) -> Result<Option<Result<Vec<u8>, SdoError>>, Kind> {
        let device = &self.player.list.devices[position];
        let Some(mailbox) = device.mailbox else { return Ok(None) };
        let counter = &mut self.player.mailbox_counters[position];
        mailbox::upload(&mut self.player.line, device.station, mailbox, counter, object).map(Some)
    }

    /// Time of a service on the wire: writing the mailbox, a look at its status, and reading the
    /// mailbox.
    fn mailbox_cost(&self, position: usize) -> Nanos {
        let Some(mailbox) = self.player.list.devices[position].mailbox else { return Nanos::ZERO };
        let lengths = [mailbox.out.length, 1, mailbox.back.length].map(usize::from);
        lengths
            .into_iter()
            .map(|length| wire_time(std::iter::once(length)))
            .fold(Nanos::ZERO, |all, one| all + one)
    }

    fn take_changes(&mut self, changes: Vec<Change>) {
        let at = self.player.line.now() - self.began;
        for change in changes {
            self.engine.event(at, &Event::Alarm(change));
            if self.alarms.len() < MOST_ALARMS {
                self.alarms.push((at, change));
            }
        }
    }

    /// Reads counters, states and clocks at the end.
    fn read_at_end(&mut self, devices: &mut [Readings]) -> Result<(), Kind> {
        self.read_counters(devices, |readings| (&mut readings.outputs, &mut readings.inputs))?;
        for (position, readings) in devices.iter_mut().enumerate() {
            readings.status = self.status(position)?;
            let device = &self.seen.segment.devices[position];
            if !device.dc.has_clock() {
                continue;
            }
            let (station, polarity) = (device.station.0, device.difference_polarity);
            let address = register::SYSTEM_TIME_DIFFERENCE.address;
            let bytes = self.player.line.read(station, address, 4)?;
            let bytes = bytes.and_then(|bytes| bytes.first_chunk().copied());
            readings.difference =
                bytes.map(|bytes| SystemTimeDifference::from_bytes(bytes).nanos(polarity));
        }
        Ok(())
    }

    /// Reads the existing counters into the places for 0x1C32 and 0x1C33 that `place` returns.
    fn read_counters(
        &mut self,
        devices: &mut [Readings],
        place: impl Fn(&mut Readings) -> (&mut Counters, &mut Counters),
    ) -> Result<(), Kind> {
        for (position, readings) in devices.iter_mut().enumerate() {
            let (outputs, inputs) = place(readings);
            for (index, counters) in [(OUTPUT_PARAMETER, outputs), (INPUT_PARAMETER, inputs)] {
                self.read_object(position, index, counters)?;
            }
        }
        Ok(())
    }

    fn read_object(
        &mut self,
        position: usize,
        index: u16,
        counters: &mut Counters,
    ) -> Result<(), Kind> {
        let places = [
            (sub::SM_EVENT_MISSED, &mut counters.sm_event_missed),
            (sub::CYCLE_TIME_TOO_SMALL, &mut counters.cycle_time_too_small),
            (sub::SHIFT_TIME_TOO_SHORT, &mut counters.shift_time_too_short),
            (sub::SYNC_ERROR, &mut counters.sync_error),
        ];
        for (sub, counter) in places {
            let device = &self.seen.segment.devices[position];
            let object = match index {
                OUTPUT_PARAMETER => &device.output_sync,
                _ => &device.input_sync,
            };
            if object.as_ref().is_none_or(|object| object.entry(sub).is_none()) {
                continue;
            }
            let answer = self.upload(position, ObjectAddress::new(index, sub))?;
            if let Some(Ok(bytes)) = answer {
                let number =
                    bytes.iter().rev().fold(0, |all: u32, byte| all << 8 | u32::from(*byte));
                *counter = Some(number);
            }
            self.take_events();
        }
        Ok(())
    }
}

/// Longest time without an answer.
const SILENCE: Nanos = Nanos::millis(1_000);
/// Time between two reports of progress.
const PROGRESS: Nanos = Nanos::millis(100);
/// Time between two readings of an AL status.
const LOOK: Nanos = Nanos::millis(20);
/// Largest number of alarms that are kept.
const MOST_ALARMS: usize = 1_000;
