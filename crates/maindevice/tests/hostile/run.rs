//! One run in virtual time: a MainDevice, a line of SubDevices that may lie, and a wire with
//! faults.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use isocat_maindevice::{
    Cause, Config, DelayWatch, Event, FRAME_LEN, MainDevice, QualityWatch, Recovery, Statistics,
    Survey,
};
use isocat_wire::al::AlState;
use isocat_wire::datagram::{Address, Layouts};
use isocat_wire::frame::{self, LOCALLY_ADMINISTERED, payload_offset};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{ObjectAddress, StationAddress};

use super::device::{Line, Make};
use super::lies::{Liar, Lie, Random, Wire};

/// The description of one run.
#[derive(Clone, Debug)]
pub struct Story {
    pub makes: Vec<Make>,
    /// Position, lie, and the datagrams between which it is told.
    pub liars: Vec<(usize, Lie, u64, u64)>,
    pub wire: Wire,
    pub wishes: Wishes,
    pub seed: u64,
}

/// Tasks of the MainDevice in addition to the bring-up.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Wishes {
    /// Whether the number of SubDevices is not configured.
    pub unplanned: bool,
    pub survey: bool,
    pub quality: bool,
    pub delay_watch: bool,
    pub recovery: bool,
    /// Whether objects are read in operation.
    pub requests: bool,
    /// Whether the timeouts and latches are those of a real segment: some lies then take half a
    /// minute.
    pub patient: bool,
    /// Whether the SII of each SubDevice is read, even of equal ones.
    pub each_sii: bool,
}

impl Story {
    /// The run of a seed. In two of three runs, one device lies on a faultless wire, so that the
    /// liar can be identified.
    pub fn of_seed(seed: u64) -> Self {
        let mut random = Random(seed.wrapping_mul(0x2545_F491_4F6C_DD1D));
        let count = 1 + random.below(6) as usize;
        let clocks = !random.one_in(3);
        let make = |random: &mut Random| Make {
            clock: clocks && !random.one_in(4),
            mailbox: random.one_in(2),
        };
        let mut makes: Vec<_> = (0..count).map(|_| make(&mut random)).collect();
        let mut wire = Wire::default();
        let mut several = 1;
        if random.one_in(3) {
            wire = Wire::draw(&mut random);
            several = random.below(4);
        }
        let liars = (0..several)
            .map(|_| {
                let position = random.below(count as u64) as usize;
                let lie = Lie::ALL[random.below(Lie::ALL.len() as u64) as usize];
                let from = if random.one_in(2) { 0 } else { random.below(2_000) };
                let until = if random.one_in(2) { u64::MAX } else { from + random.below(500) };
                // A SubDevice without a mailbox cannot lie with it.
                makes[position].mailbox |= lie.is_of_the_mailbox();
                makes[position].clock |= matches!(lie, Lie::Times | Lie::Difference);
                (position, lie, from, until)
            })
            .collect();
        let mut wish = |chance| random.one_in(chance);
        let wishes = Wishes {
            unplanned: wish(4),
            survey: wish(10),
            quality: wish(3),
            delay_watch: wish(3),
            recovery: wish(3),
            requests: wish(2),
            patient: wish(40),
            each_sii: false,
        };
        Self { makes, liars, wire, wishes, seed }
    }

    /// The only liar, if its answers identify it.
    pub fn author(&self) -> Option<usize> {
        match self.liars[..] {
            [(position, lie, ..)] if self.wire.is_honest() && lie.has_an_author() => Some(position),
            _ => None,
        }
    }
}

/// Calls of the machine, as a meter distinguishes them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Call {
    Frame,
    Timeout,
    Transmit,
}

/// Measures each call.
pub trait Meter {
    fn call<R>(&mut self, kind: Call, call: impl FnOnce() -> R) -> R;
}

/// How a run ended.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum End {
    /// It was in operation, and was stopped.
    Stopped,
    Failed(Cause),
    /// It exceeded [`LONGEST`] or [`MOST_FRAMES`].
    Endless,
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub end: End,
    pub was_up: bool,
    /// Virtual time, ns.
    pub took: u64,
    pub statistics: Statistics,
    /// Faults reported of honest SubDevices, if only one lied.
    pub wrong_blame: Vec<String>,
    /// Whether the liar was named, if there is a single one that can be identified.
    pub named: bool,
    /// Number of lies told.
    pub told: u64,
}

/// Longest run, virtual time in ns.
pub const LONGEST: u64 = 100_000_000_000;
/// Most frames of a run.
pub const MOST_FRAMES: u64 = 400_000;
/// Time in operation, ns.
const IN_OPERATION: u64 = 150_000_000;
/// Time from the last bit until the program has the frame, ns.
const LATENCY: u64 = 20_000;
/// Number of frames that are kept to be replayed.
const MOST_OLD: usize = 8;

/// Timeouts that suffice for an honest segment, and short ones, since each seed waits for its liar.
fn config(story: &Story) -> Config {
    let mut config = Config::new(Nanos::millis(2));
    let wishes = story.wishes;
    config.survey = wishes.survey.then(Survey::default);
    let watches = !wishes.survey;
    config.quality = (wishes.quality && watches).then(QualityWatch::default);
    let watch = DelayWatch { every: Nanos::millis(20), ..DelayWatch::default() };
    config.delay_watch = (wishes.delay_watch && watches).then_some(watch);
    if wishes.recovery {
        let (first, longest) = (Nanos::millis(5), Nanos::millis(50));
        config.recovery = Recovery::BackOff { first, longest };
    }
    let devices = if wishes.unplanned { 0 } else { story.makes.len() };
    config.share_sii = !wishes.each_sii;
    config.source = [0x10, 0, 0, 0, 0, 1];
    config.devices = vec![Default::default(); devices];
    if wishes.patient {
        return config;
    }
    config.hop_jitter = false;
    config.delay_latches = 2;
    let times = &mut config.timeouts;
    times.eeprom = Nanos::millis(20);
    times.mailbox = Nanos::millis(100);
    (times.init, times.preop) = (Nanos::millis(200), Nanos::millis(200));
    (times.safeop, times.op) = (Nanos::millis(300), Nanos::millis(300));
    (times.drift, times.phase) = (Nanos::millis(1_000), Nanos::millis(1_000));
    times.sync_lead = Nanos::millis(20);
    config
}

/// Runs two SubDevices whose answers a script changes, see [`Script`]; the first byte selects the
/// tasks.
pub fn follow(bytes: &[u8]) {
    struct Nothing;
    impl Meter for Nothing {
        fn call<R>(&mut self, _: Call, call: impl FnOnce() -> R) -> R {
            call()
        }
    }
    let (&first, script) = bytes.split_first().unwrap_or((&0, &[]));
    let bit = |number: u8| first >> number & 1 != 0;
    let wishes = Wishes {
        unplanned: bit(0),
        survey: first & 0x0E == 0x0E,
        quality: bit(1),
        delay_watch: bit(2),
        recovery: bit(3),
        requests: bit(4),
        patient: false,
        each_sii: bit(5),
    };
    let makes = vec![Make { clock: bit(5), mailbox: true }, Make { clock: true, mailbox: bit(6) }];
    let (liars, wire, seed) = (Vec::new(), Wire::default(), first.into());
    let story = Story { makes, liars, wire, wishes, seed };
    let outcome =
        begin(&story, Script { bytes: script.to_vec(), ..Script::default() }).finish(&mut Nothing);
    assert_ne!(outcome.end, End::Endless, "{:?}", outcome.statistics);
}

/// The changes of answers, in order: the first byte of each tells the kind, and the next ones the
/// details. After the end of the script answers are true.
#[derive(Default)]
struct Script {
    bytes: Vec<u8>,
    at: usize,
    /// Number of answers that stay unchanged before the next change.
    skip: usize,
}

impl Script {
    fn byte(&mut self) -> u8 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        byte
    }

    /// Changes an answer; false: it is lost.
    fn change(&mut self, frame: &mut Vec<u8>) -> bool {
        if self.skip > 0 || self.at >= self.bytes.len() {
            self.skip = self.skip.saturating_sub(1);
            return true;
        }
        match self.byte() {
            // Most bytes skip answers, so that a script reaches far.
            few @ 0..=0x7F => self.skip = few.into(),
            0x80 => return false,
            0x81 => frame.truncate(usize::from(self.byte())),
            0x82..=0x8F => {
                let at = usize::from(u16::from_le_bytes([self.byte(), self.byte() & 7]));
                let value = self.byte();
                let from = at.min(frame.len());
                frame.iter_mut().skip(from).take(1).for_each(|byte| *byte = value);
            }
            0x90..=0xAF => {
                // The data of the first datagram is the most important, so it is changed often.
                let at = 26 + usize::from(self.byte() & 0x1F);
                let value = self.byte();
                frame.iter_mut().skip(at).take(1).for_each(|byte| *byte = value);
            }
            many => {
                // The place of a working counter of a short datagram.
                let at = 26 + usize::from(many & 0x0F);
                let value = [self.byte(), self.byte()];
                let counter = frame.iter_mut().skip(at).zip(value);
                counter.for_each(|(byte, value)| *byte = value);
            }
        }
        true
    }
}

/// Runs a story to its end.
pub fn run(story: &Story, meter: &mut impl Meter) -> Outcome {
    begin(story, Script::default()).finish(meter)
}

fn begin(story: &Story, script: Script) -> Run {
    let mut line = Line::new(&story.makes);
    for (position, lie, from, until) in &story.liars {
        line.devices[*position].liar = Some(Liar::new(*lie, *from, *until));
    }
    let machine = MainDevice::new(config(story), Time::new(0));
    Run {
        machine,
        line,
        script,
        random: Random(story.seed),
        wire: story.wire,
        now: 0,
        wire_free: 0,
        returning: BinaryHeap::new(),
        number: 0,
        old: Vec::new(),
        author: story.author(),
        requests: story.wishes.requests,
        wrong_blame: Vec::new(),
        named: false,
    }
}

struct Run {
    machine: MainDevice,
    line: Line,
    script: Script,
    random: Random,
    wire: Wire,
    now: u64,
    wire_free: u64,
    /// Due time, order and bytes.
    returning: BinaryHeap<Reverse<(u64, u64, Vec<u8>)>>,
    number: u64,
    old: Vec<Vec<u8>>,
    author: Option<usize>,
    requests: bool,
    wrong_blame: Vec<String>,
    named: bool,
}

impl Run {
    fn finish(mut self, meter: &mut impl Meter) -> Outcome {
        let mut buffer = [0; FRAME_LEN];
        let mut stop_at = None;
        let (mut stopping, mut end) = (false, None);
        while end.is_none() {
            while let Some(event) = self.machine.poll_event() {
                self.judge(&event);
                match event {
                    Event::InOperation { .. } => stop_at = Some(self.now + IN_OPERATION),
                    Event::Surveyed | Event::Stopped => end = Some(End::Stopped),
                    Event::Failed(error) => end = Some(End::Failed(error.cause)),
                    _ => {}
                }
            }
            while let Some(len) = {
                let (machine, now) = (&mut self.machine, Time::<Host>::new(self.now));
                meter.call(Call::Transmit, || machine.poll_transmit(now, &mut buffer))
            } {
                self.send(&buffer[..len]);
            }
            if stop_at.is_some_and(|at| self.now >= at) && !stopping {
                stopping = true;
                self.machine.stop();
                continue;
            }
            if self.requests && self.machine.is_operating() && self.random.one_in(20) {
                self.ask();
            }
            let Some(wanted) = self.machine.next_timeout() else { continue };
            let wanted = wanted.count().max(self.now);
            let wanted = stop_at.filter(|_| !stopping).map_or(wanted, |at| wanted.min(at));
            let sent = self.machine.statistics().frames_sent;
            if self.now > LONGEST || sent > MOST_FRAMES {
                end = end.or(Some(End::Endless));
            }
            let machine = &mut self.machine;
            match self.returning.peek() {
                Some(Reverse((at, ..))) if *at <= wanted => {
                    let Reverse((at, _, bytes)) = self.returning.pop().expect("it was just seen");
                    self.now = self.now.max(at);
                    let now = Time::new(self.now);
                    meter.call(Call::Frame, || machine.handle_frame(now, &bytes));
                }
                _ => {
                    self.now = wanted;
                    let now = Time::new(self.now);
                    meter.call(Call::Timeout, || machine.handle_timeout(now));
                }
            }
        }
        let told = self.line.devices.iter().flat_map(|device| &device.liar).map(|liar| liar.told);
        Outcome {
            end: end.expect("the loop ends with one"),
            was_up: stop_at.is_some(),
            took: self.now,
            statistics: self.machine.statistics(),
            wrong_blame: self.wrong_blame,
            named: self.named,
            told: told.sum(),
        }
    }

    /// Reads an object of a random SubDevice.
    fn ask(&mut self) {
        let position = self.random.below(self.line.devices.len() as u64) as usize;
        let index = [0x1C12, 0x1C00, 0x1018][self.random.below(3) as usize];
        self.machine.upload(position, ObjectAddress::new(index, 0));
    }

    fn send(&mut self, bytes: &[u8]) {
        let mut bytes = bytes.to_vec();
        let start = self.wire_free.max(self.now);
        self.wire_free = start + frame::duration_ns(bytes.len()) + 960;
        let hit = |random: &mut Random, chance: u64| chance > 0 && random.one_in(chance);
        let (wire, random) = (self.wire, &mut self.random);
        if hit(random, wire.lost) {
            return;
        }
        self.line.pass(start, &mut bytes, random);
        if !self.script.change(&mut bytes) {
            return;
        }
        let mut back = self.wire_free + LATENCY;
        if hit(random, wire.unmarked) {
            bytes[6] &= !LOCALLY_ADMINISTERED;
        }
        if hit(random, wire.counts) {
            change_counts(&mut bytes, random);
        }
        if hit(random, wire.flipped) {
            let at = random.below(bytes.len() as u64) as usize;
            bytes[at] ^= 1 << random.below(8);
        }
        if hit(random, wire.cut) {
            bytes.truncate(random.below(bytes.len() as u64) as usize);
        }
        if hit(random, wire.late) {
            back += random.below(20_000_000);
        }
        let mut all = vec![(back, bytes.clone())];
        if hit(random, wire.twice) {
            all.push((back + random.below(3_000_000), bytes.clone()));
        }
        if hit(random, wire.replayed)
            && let Some(old) = self.old.get(random.below(MOST_OLD as u64) as usize)
        {
            all.push((back + 1, old.clone()));
        }
        if hit(random, wire.random) {
            let mut noise = bytes.clone();
            for byte in noise.iter_mut().skip(16) {
                *byte = random.extreme() as u8;
            }
            all.push((back + 2, noise));
        }
        if !self.wire.is_honest() {
            if self.old.len() == MOST_OLD {
                self.old.remove(0);
            }
            self.old.push(bytes);
        }
        for (at, bytes) in all {
            self.number += 1;
            self.returning.push(Reverse((at, self.number, bytes)));
        }
    }

    /// Compares faults reported of SubDevices with the real liar.
    fn judge(&mut self, event: &Event) {
        let Some(author) = self.author else { return };
        let named = match event {
            // During bring-up and shutdown this is reported of all SubDevices.
            Event::StateChanged { position, status, .. }
                if self.machine.is_operating() && status.state() != Ok(AlState::Op) =>
            {
                Some(*position)
            }
            Event::Lost { position, .. }
            | Event::NotReadmitted { position, .. }
            | Event::Recovering { position, .. }
            | Event::NotRecovered { position, .. }
            | Event::ReferenceLost { position, .. }
            | Event::DelayUnknown { position, .. }
            | Event::Emergency { position, .. } => Some(*position),
            Event::Failed(error) => place(&error.cause),
            _ => None,
        };
        match named {
            Some(position) if position == author => self.named = true,
            Some(_) => self.wrong_blame.push(format!("{event:?}")),
            None => {}
        }
    }
}

/// The SubDevice that a failure names.
fn place(cause: &Cause) -> Option<usize> {
    if let Cause::Access(error) = cause {
        return match error.address {
            Address::Station(StationAddress(station), _) => Some(usize::from(station - FIRST)),
            Address::Position(adp, _) => Some(usize::from(adp.0.wrapping_neg())),
            _ => None,
        };
    }
    cause.place().map(|place| place.position)
}

/// Station address of the first SubDevice.
const FIRST: u16 = 0x1001;

/// Changes the working counters of a frame.
fn change_counts(frame: &mut [u8], random: &mut Random) {
    let Ok(start) = payload_offset(frame) else { return };
    let payload = &mut frame[start..];
    let mut layouts = Layouts::new();
    while let Some(Ok(layout)) = layouts.next(payload) {
        let lie = (random.extreme() as u16).to_le_bytes();
        payload[layout.wkc()..layout.end()].copy_from_slice(&lie);
    }
}
