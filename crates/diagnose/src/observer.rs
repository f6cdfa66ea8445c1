//! The observer: takes exchanges one by one and keeps what each says, in bounded memory.

use std::ops::Range;
use std::time::Duration;

use isocat_captures::pairing::{Exchange, Seen, Tap};
use isocat_rules::Claims;
use isocat_wire::al::{AlControl, AlState, AlStatus, AlStatusCode};
use isocat_wire::register::PROCESS_RAM;
use isocat_wire::{Command, register};

use crate::access::{Access, accesses, part, shows_answers};
use crate::clock::Drift;
use crate::cycle::Cycle;
use crate::device::{Devices, Whom};
use crate::evidence;
use crate::judge::claims::{self, Held};
use crate::known::{Known, Log};
use crate::measured::{Measured, Onlooker};
use crate::phase::{self, Cyclic, Feed, MOST_GRIDS, Phases};
use crate::talker::Talkers;

/// A change of the number of SubDevices that frames pass.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Reach {
    pub frame: usize,
    pub at: Duration,
    /// The last frame that passed `from` SubDevices.
    pub before: usize,
    /// SubDevices before; `None`: no frame counted them before.
    pub from: Option<u16>,
    pub to: u16,
    /// Whether the segment was in operation.
    pub operating: bool,
}

/// All that the exchanges of a capture showed.
#[derive(Debug)]
pub(crate) struct Observer {
    pub devices: Devices,
    pub drift: Drift,
    pub cycle: Cycle,
    pub phases: Phases,
    pub talkers: Talkers,
    /// Answers of cyclic frames without a request, in operation.
    pub doubled: Log<Known<Duration>>,
    /// Drift frames that did not come back, in operation.
    pub drift_lost: Log<Known<Duration>>,
    /// Changes of the number of SubDevices that frames passed.
    pub reach: Log<Reach>,
    reach_now: Option<u16>,
    /// The last frame that counted SubDevices.
    reached_in: usize,
    /// Operation since this frame; `None`: no state of operation was seen.
    pub operation: Option<Known<Duration>>,
    /// The last frame at which operation ended, because all devices were asked to leave it.
    pub left: Option<Known<Duration>>,
    /// What the segment was meant to do.
    pub claims: Option<Claims>,
    /// The stretches of operation that have ended, held against that: the first ones.
    pub held: Vec<Held>,
    /// The present stretch of operation since this frame, or the last one.
    pub stretch: Option<Known<Duration>>,
    /// Some device was seen in OP and not asked to leave it, or operation is assumed.
    operating: bool,
    /// Cycles since OP was requested, while no state was read.
    unwatched: Option<u64>,
    /// Operation was assumed after some cycles, because the MainDevice reads no states.
    assumed: bool,
    /// Any AL status or AL control was seen.
    pub states_seen: bool,
    /// Process data were exchanged before any state was seen: the capture begins in operation.
    began_inside: bool,
    /// A broadcast reading showed all devices in OP, without a request for it in the capture.
    all_in_op: bool,
    /// Like `began_inside`, but stays true after all devices have left operation.
    pub began_inside_once: bool,
    /// What is measured against which SYNC0, and for each device its place there.
    feeds: Vec<Feed>,
    fed: Vec<Option<usize>>,
    feeds_are_old: bool,
    /// When the wire at the reference is free after the last frame, by its clock, ns.
    wire_free: Option<u64>,
    /// Exchanges that were taken.
    pub exchanges: u64,
    /// The first frame of the last exchange.
    pub frame: usize,
    /// The first stamp, and the latest one.
    pub first: Option<Duration>,
    pub last: Duration,
    /// The stamp of the last exchange, which is below `last` after stamps jumped back.
    pub now: Duration,
    /// Exchanges whose stamp is earlier than the latest one before.
    pub backwards: u64,
}

impl Observer {
    pub fn new() -> Self {
        Self {
            devices: Devices::default(),
            drift: Drift::default(),
            cycle: Cycle::default(),
            phases: Phases::default(),
            talkers: Talkers::default(),
            doubled: Log::new(MOST_EVENTS),
            drift_lost: Log::new(MOST_EVENTS),
            reach: Log::new(MOST_EVENTS),
            reach_now: None,
            reached_in: 0,
            operation: None,
            left: None,
            claims: None,
            held: Vec::new(),
            stretch: None,
            operating: false,
            unwatched: None,
            assumed: false,
            states_seen: false,
            began_inside: false,
            all_in_op: false,
            began_inside_once: false,
            feeds: Vec::new(),
            fed: Vec::new(),
            feeds_are_old: true,
            wire_free: None,
            exchanges: 0,
            frame: 0,
            first: None,
            last: Duration::ZERO,
            now: Duration::ZERO,
            backwards: 0,
        }
    }

    /// Takes the next exchange.
    pub fn exchange(&mut self, tap: Tap, exchange: &Exchange, onlooker: &mut Onlooker<'_>) {
        let Some(first) = exchange.request.as_ref().or(exchange.answer.as_ref()) else { return };
        let at = first.at;
        self.exchanges += 1;
        self.frame = first.number;
        self.first.get_or_insert(at);
        self.backwards += u64::from(at < self.last);
        self.last = self.last.max(at);
        self.now = at;
        self.talkers.frame(first, at, self.is_operating());
        let judged = self.is_judged();
        // The index of the datagram that begins a cycle.
        let mut begins = None;
        let mut time = None;
        // The frame has process data, and which they are; it has a drift datagram; it came back.
        let (mut is_cyclic, mut logical) = (false, Vec::new());
        let (mut has_drift, mut is_back) = (false, false);
        let operation = self.operation;
        if exchange.answer.is_some() {
            self.cycle.end_silence();
        }
        for access in accesses(exchange, tap, self.reach_now) {
            if let Some(passed) = access.passed {
                self.reached(passed, access.frame, at);
            }
            time = self.drift.access(&access, at).or(time);
            let leads = matches!(access.command, Command::Frmw | Command::Armw);
            if leads && access.back.is_none() && judged {
                self.drift_lost.push(Known { value: at, frame: access.frame });
            }
            has_drift |= leads;
            is_back |= access.back.is_some();
            if access.command.is_logical() {
                is_cyclic = true;
                let known = self.cycle.logical.len();
                if let Some((place, marks)) = self.cycle.access(&access, at, judged) {
                    logical.push(place);
                    if marks {
                        begins.get_or_insert(access.header.index);
                    }
                }
                self.feeds_are_old |= known < self.cycle.logical.len();
            } else {
                self.access(&access, at, tap);
            }
        }
        if self.operation != operation {
            onlooker(Measured::Restart);
        }
        if begins.is_some() {
            self.assume_operation(at);
        }
        if begins.is_some() && !judged {
            // The next interval that is judged begins after this frame.
            self.cycle.rhythm.pause();
            self.cycle.by_clock.pause();
        }
        // The request of the first answer may be before the beginning of the capture.
        let alone = exchange.request.is_none() && self.cycle.rhythm.count > 0;
        let alone = alone && tap.seen == Seen::Both;
        if alone && is_cyclic && judged {
            self.doubled.push(Known { value: at, frame: first.number });
            return;
        }
        let frame = exchange.answer.as_ref().map_or(first.number, |answer| answer.number);
        let at_ns = at.saturating_sub(self.first.unwrap_or_default()).as_nanos() as u64;
        if self.drift.stamps_within().is_none() {
            self.cycle.distrust_stamps();
        }
        let estimate = || self.drift.estimate(at).filter(|_| !has_drift);
        let first_bit = time.or_else(|| Some(self.queued(estimate()?)));
        let duration = isocat_wire::frame::duration_ns(first.bytes.len());
        self.wire_free = first_bit.map(|begin| begin.wrapping_add(duration + GAP_NS));
        let known = first_bit.filter(|_| time.is_some() || is_back);
        if let Some(index) = begins.filter(|_| judged) {
            if self.cycle.is_same_again(at, known, index) {
                self.doubled.push(Known { value: at, frame: first.number });
                return;
            }
            self.cycle.estimated |= known.is_some() && time.is_none();
            let [by_stamps, by_clock] = self.cycle.begins(at, known, frame, is_back);
            if let Some((request, answer)) = exchange.request.as_ref().zip(exchange.answer.as_ref())
            {
                let took = answer.at.saturating_sub(at).as_nanos() as u64;
                self.cycle.answered(request.number, answer.number, answer.at, took);
                let passed =
                    self.reach_now.map(|devices| u64::from(devices) * PASSED_NS + duration);
                self.cycle.on_wire_ns = self.cycle.on_wire_ns.max(passed.unwrap_or(0));
            }
            if let Some(ns) = by_stamps {
                onlooker(Measured::Interval { at_ns, ns });
            }
            if let Some(ns) = by_clock {
                onlooker(Measured::IntervalByClock { at_ns, ns });
            }
        }
        if judged
            && !logical.is_empty()
            && let Some(known) = known
        {
            if std::mem::take(&mut self.feeds_are_old) {
                self.find_feeds();
            }
            let cyclic = Cyclic {
                number: frame,
                at_ns,
                len: first.bytes.len(),
                time: known,
                by_stamps: time.is_none(),
                begins: begins.is_some(),
                logical: &logical,
            };
            let told = |at_ns, grid, ns| onlooker(Measured::Distance { at_ns, grid, ns });
            self.phases.cyclic(&self.feeds, cyclic, told);
        }
    }

    /// When a frame that was sent at a time of the reference clock comes there: not before the last
    /// bit of the one before it.
    fn queued(&self, sent: u64) -> u64 {
        let free = self.wire_free.filter(|free| free.wrapping_sub(sent) < MOST_QUEUED_NS);
        free.unwrap_or(sent)
    }

    /// Collects which frames are measured against which SYNC0.
    fn find_feeds(&mut self) {
        let old = std::mem::take(&mut self.feeds);
        let fed = std::mem::take(&mut self.fed);
        for device in &self.devices.list {
            let feed = device.sync.grid().map(|grid| Feed {
                grid,
                carriers: evidence::carriers(&self.cycle.logical, device),
            });
            let known = feed.as_ref().and_then(|feed| self.feeds.iter().position(|f| f == feed));
            let place = known.or_else(|| {
                let feed = feed.filter(|_| self.feeds.len() < MOST_GRIDS)?;
                self.feeds.push(feed);
                Some(self.feeds.len() - 1)
            });
            self.fed.push(place);
        }
        // More datagrams have the process data of a device, and it goes on with them.
        for (before, now) in fed.into_iter().zip(&self.fed) {
            let (Some(before), Some(now)) = (before, *now) else { continue };
            let (before, now) = (&old[before], &self.feeds[now]);
            if now.continues(before) && !self.feeds.contains(before) {
                self.phases.rename(before, now);
            }
        }
    }

    /// The distances from the frames of a device to its SYNC0 in operation, and how inaccurate they
    /// are where stamps have a share in them, ns; `None`: not known.
    pub fn distance(&self, place: usize) -> Option<(phase::Measured<'_>, u64)> {
        let measured = self.phases.of(&self.feeds[(*self.fed.get(place)?)?])?;
        Some((measured, if measured.by_stamps { self.drift.stamps_within()? } else { 0 }))
    }

    /// Forgets the events so far, to bound memory. What devices are and how they were set up stays
    /// known.
    pub fn forget(&mut self) {
        self.cycle.forget();
        self.phases = Phases::default();
        self.doubled = Log::new(MOST_EVENTS);
        self.drift_lost = Log::new(MOST_EVENTS);
        self.reach = Log::new(MOST_EVENTS);
        self.drift.forget();
        let now = self.last;
        self.devices.list.iter_mut().for_each(|device| device.forget(now));
    }

    /// Whether the present exchanges are judged as operation: some device is in OP, or the capture
    /// shows no states.
    fn is_judged(&self) -> bool {
        self.operating || self.began_inside || !self.states_seen
    }

    /// Whether the segment is in operation at present.
    pub fn is_operating(&self) -> bool {
        self.operating || self.began_inside
    }

    /// A cycle began. Some MainDevices request OP and read no state afterwards: after enough
    /// cycles, the exchange counts as operation.
    fn assume_operation(&mut self, at: Duration) {
        let Some(cycles) = self.unwatched.as_mut() else { return };
        *cycles += 1;
        if *cycles == LEAST_UNWATCHED && self.operation.is_none() {
            self.assumed = true;
            self.entered(self.frame, at);
            self.operation_changed(self.frame, at);
        }
    }

    /// A state was requested before any device was seen in OP or with an error: the exchange so far
    /// was not operation.
    fn on_the_way_up(&mut self) {
        let known = |device: &crate::device::Device| {
            let mut seen = device.states.changes.kept.iter();
            seen.any(|seen| seen.error() || seen.status.state() == Ok(AlState::Op))
        };
        if !self.all_in_op && !self.devices.list.iter().any(known) {
            self.began_inside = false;
            self.began_inside_once = false;
        }
    }

    /// A frame shows states of devices. `in_op`: all devices are in OP, and the capture holds no
    /// request that asked any of them for a state.
    fn see_states(&mut self, in_op: bool) {
        let exchanged = !self.states_seen && self.cycle.rhythm.count >= LEAST_INSIDE;
        if (exchanged || in_op && self.operation.is_none()) && !self.began_inside_once {
            self.began_inside = true;
            self.began_inside_once = true;
        }
        self.all_in_op |= in_op;
        self.states_seen = true;
    }

    fn reached(&mut self, passed: u16, frame: usize, at: Duration) {
        let from = self.reach_now.replace(passed);
        let before = std::mem::replace(&mut self.reached_in, frame);
        if from != Some(passed) {
            let operating = self.is_judged();
            self.reach.push(Reach { frame, at, before, from, to: passed, operating });
        }
    }

    fn access(&mut self, access: &Access<'_>, at: Duration, tap: Tap) {
        match self.devices.whom(access, shows_answers(tap)) {
            Whom::One(place) => self.of_device(place, access, at, true),
            Whom::All => {
                self.asked_all(access);
                for place in 0..self.devices.list.len() {
                    self.of_device(place, access, at, false);
                }
                self.states_of_all(access, at);
            }
            Whom::Unknown => {
                let last = self.reach.kept.last().filter(|reach| reach.operating);
                if let Some(&Reach { from: Some(from), to, before, .. }) = last
                    && to < from
                {
                    self.devices.find_vanished(access, at, (from, to), before);
                }
            }
        }
        let taken = access.taken() != Some(false);
        let control = access.written().filter(|_| taken);
        if let Some(data) = control
            && let Some(control) = low_and_high(access.ado(), data, register::AL_CONTROL.address)
        {
            let op = AlControl(control).state() == Ok(AlState::Op);
            self.unwatched = op.then_some(0);
            self.see_states(false);
            self.on_the_way_up();
            self.operation_changed(access.frame, at);
        }
    }

    fn asked_all(&mut self, access: &Access<'_>) {
        let written = access.written().filter(|_| access.taken() != Some(false));
        let address = register::AL_CONTROL.address;
        let control = written.and_then(|data| low_and_high(access.ado(), data, address));
        if let Some(control) = control {
            let value = AlControl(control);
            self.devices.asked_all = Some(Known { value, frame: access.frame });
        }
    }

    /// Takes a datagram at one device; `alone`: no other device answers it.
    fn of_device(&mut self, place: usize, access: &Access<'_>, at: Duration, alone: bool) {
        let operating = self.operating;
        let now = self.drift.time;
        let device = &mut self.devices.list[place];
        let first = access.ado();
        if alone {
            device.last = access.frame;
            device.heard(access, at);
            if operating && !device.by_address && first >= PROCESS_RAM {
                device.by_address = evidence::is_process_data(device, first);
            }
        }
        let written = access.written().filter(|_| access.taken() != Some(false));
        if let Some(data) = written {
            let led = self.drift.last.map(|last| at.saturating_sub(last.value));
            device.write(first, data, access.frame, at, led);
            if access.covers(register::SYSTEM_TIME_OFFSET.address, 4) {
                self.drift.set();
            }
            let clock = [register::SYSTEM_TIME_OFFSET.address, register::SYSTEM_TIME_DELAY.address];
            if clock.into_iter().any(|address| access.covers(address, 4)) {
                device.own_time = None;
            }
            if let Some(control) = low_and_high(first, data, register::AL_CONTROL.address) {
                device.states.ask(access.frame, at, AlControl(control));
                if AlControl(control).state() == Ok(AlState::Init) {
                    device.mailbox.close();
                }
            }
        }
        // The answer of several devices is the OR of all of them.
        let read = access.read().filter(|_| alone);
        if let Some(data) = read
            && first != register::SYSTEM_TIME.address
        {
            device.image.note(first, data, access.frame);
        }
        if let Some(data) = read.filter(|_| alone)
            && let Some(bytes) = part::<8>(first, data, register::SYSTEM_TIME.address)
        {
            let value = u64::from_le_bytes(bytes);
            device.own_time = Some((value, at));
        }
        if written.is_some() || read.is_some() {
            device.sii.access(access);
            device.errors.access(access);
            device.sync.access(access, at, &device.image, now, device.own_time);
        }
        if alone {
            let in_init = device.states.now().is_some_and(|now| now.state() == Ok(AlState::Init));
            device.mailbox.access(access, &device.image, at, in_init);
            device.differences.access(access, operating, device.sync.is_on());
        }
        if written.is_some() {
            self.station_written(place, access);
        }
        if written.is_some() || read.is_some() && access.ado() < FMMUS_END {
            self.mapping_seen(access);
        }
        if let Some(data) = read {
            self.state_read(place, first, data, access.frame, at);
        }
    }

    fn station_written(&mut self, place: usize, access: &Access<'_>) {
        let address = register::STATION_ADDRESS.address;
        let data = access.written().unwrap_or(&[]);
        let Some(bytes) = part::<2>(access.ado(), data, address) else { return };
        match (access.command, u16::from_le_bytes(bytes)) {
            (Command::Bwr | Command::Brw, _) => self.devices.forget_names(),
            (_, station) => self.devices.name(place, station, access.frame),
        }
    }

    /// Notes that what is measured may be another: SYNC units, FMMUs or SyncManagers changed.
    fn mapping_seen(&mut self, access: &Access<'_>) {
        let first = access.ado();
        let end = first.saturating_add(access.header.len);
        self.feeds_are_old |= access.covers(register::SYNC_ACTIVATION.address, 1)
            || first < MAPPING.end && MAPPING.start < end;
    }

    fn state_read(&mut self, place: usize, first: u16, data: &[u8], frame: usize, at: Duration) {
        let status = low_and_high(first, data, register::AL_STATUS.address).map(AlStatus);
        let code = part::<2>(first, data, register::AL_STATUS_CODE.address);
        let code = code.map(|bytes| AlStatusCode(u16::from_le_bytes(bytes)));
        match (status, code) {
            (Some(status), code) => self.saw(place, status, code, frame, at),
            (None, Some(code)) => self.devices.list[place].states.see_code(code),
            (None, None) => {}
        }
    }

    /// Takes a broadcast reading of AL status, which is the OR of all devices. If it has the bit of
    /// one state alone, and all devices answered, each of them is in that state.
    fn states_of_all(&mut self, access: &Access<'_>, at: Duration) {
        let Some(data) = access.read().filter(|_| access.command == Command::Brd) else { return };
        let status = low_and_high(access.ado(), data, register::AL_STATUS.address).map(AlStatus);
        let Some(status) = status else { return };
        let is_op = status.0 == AlState::Op as u16;
        let all = access.passed.is_some() && access.passed == access.wkc();
        let asked = self.devices.list.iter().any(|device| device.states.asked.is_some());
        self.see_states(is_op && all && !asked && self.devices.asked_all.is_none());
        if all && matches!(status.0, 1 | 2 | 4 | 8) {
            for place in 0..self.devices.list.len() {
                self.saw(place, status, None, access.frame, at);
            }
        }
    }

    fn saw(
        &mut self,
        place: usize,
        status: AlStatus,
        code: Option<AlStatusCode>,
        frame: usize,
        at: Duration,
    ) {
        self.see_states(false);
        self.unwatched = None;
        let states = &mut self.devices.list[place].states;
        let before = states.now();
        states.see(frame, at, status, code);
        if before == Some(status) {
            return;
        }
        let enters = status.state() == Ok(AlState::Op);
        if enters && states.op.is_none() {
            states.op = Some(Known { value: at, frame });
            self.entered(frame, at);
        }
        self.operation_changed(frame, at);
    }

    /// One more device is in OP for the first time. Operation is judged from the last such device
    /// on.
    fn entered(&mut self, frame: usize, at: Duration) {
        if self.began_inside || self.assumed && self.operation.is_some() {
            return;
        }
        self.operation = Some(Known { value: at, frame });
        self.cycle.restart();
        self.phases = Phases::default();
        self.doubled = Log::new(MOST_EVENTS);
        self.drift_lost = Log::new(MOST_EVENTS);
        self.drift.restart();
    }

    fn operation_changed(&mut self, frame: usize, at: Duration) {
        let operates = self.devices.list.iter().any(|device| {
            let asked = device.states.asked.map(|asked| asked.value.state() == Ok(AlState::Op));
            match device.states.op {
                Some(_) => asked != Some(false),
                None => self.assumed && asked == Some(true),
            }
        });
        let leave = |device: &crate::device::Device| {
            device.states.asked.is_some_and(|asked| asked.value.state() != Ok(AlState::Op))
        };
        if self.devices.list.iter().all(leave) {
            self.began_inside = false;
        }
        if !self.operating && operates {
            self.stretch = Some(Known { value: at, frame });
            self.cycle.recount();
            self.devices.list.iter_mut().for_each(|device| device.sync.entered_operation());
        }
        if self.operating && !operates {
            // As things are before the way down changes them.
            if self.held.len() < MOST_STRETCHES {
                self.held.push(claims::hold(self));
            }
            self.phases.pause();
            self.left = Some(Known { value: at, frame });
            self.devices.list.iter_mut().for_each(|device| device.sync.left_operation());
            self.cycle.rhythm.pause();
            self.cycle.by_clock.pause();
        }
        self.operating = operates;
    }
}

/// Stretches of operation that are held against the claims.
const MOST_STRETCHES: usize = 64;
/// FMMUs and SyncManagers. What is read behind the FMMUs is often the state of a SyncManager.
const MAPPING: Range<u16> = 0x0600..0x0900;
const FMMUS_END: u16 = 0x0700;
/// From the end of a frame to the next one's first bit behind its preamble, ns.
const GAP_NS: u64 = 1_600;
/// What a device and the cable to it take of a frame at most, out and back, ns: some 600 ns, and
/// 100 m of copper.
const PASSED_NS: u64 = 2_000;
/// Frames that would wait for the wire for longer were not sent together, ns.
const MOST_QUEUED_NS: u64 = 5_000_000;
/// Cycles without a reading of any state, after which a requested OP counts as reached.
const LEAST_UNWATCHED: u64 = 100;
/// Events of one kind that are kept.
const MOST_EVENTS: usize = 256;
/// Cycles before the first state, from which on a capture is taken to begin in operation.
const LEAST_INSIDE: u64 = 20;

/// A register of two bytes, of which some devices write or read the lower one alone.
fn low_and_high(first: u16, data: &[u8], address: u16) -> Option<u16> {
    let [low] = part::<1>(first, data, address)?;
    let high = part::<1>(first, data, address + 1).map_or(0, |[high]| high);
    Some(u16::from_le_bytes([low, high]))
}
