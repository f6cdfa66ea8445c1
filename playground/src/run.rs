//! A run of the whole segment: the state as a segment file, the simulation as in the command, and a
//! tap.

use isocat::profile;
use isocat::quantity::{Length, Ppb};
use isocat::recording::{Recorded, Recording};
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_maindevice::MainDevice;
use isocat_maindevice::segment::Timing;
use isocat_sim::bench::Intent;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Segment, Tap};
use isocat_wire::time::{Picos, Time, True};
use std::fmt::Write;

use crate::keys::{AGAIN, FAULTS, KEYS, Kind, in_file};
use crate::state::{Problem, State};

/// A finished run.
#[derive(Clone, Debug)]
pub struct Ran {
    /// The segment file, with which the command runs the same.
    pub file: String,
    /// The report.
    pub report: Report,
    /// What the recording kept.
    pub recorded: Recorded,
    /// The plan, if the MainDevice reached it.
    pub timing: Option<Timing>,
    /// Bus cycle.
    pub cycle: Nanos,
    /// Length of SYNC pulses by position, ns; 0: until acknowledged.
    pub pulses: Vec<Nanos>,
    /// Events of SubDevices: time since the recording began, position, event.
    pub events: Vec<(Picos, usize, Observed)>,
    /// 0x1C32:0B of all SubDevices at each change: time since the recording began, values by
    /// position.
    pub counters: Vec<(Picos, Vec<u16>)>,
    /// Differences of the clocks from the reference clock on the way up: time since all were first
    /// near it, ps by position.
    pub way_up: Vec<(Picos, Vec<Option<i64>>)>,
}

/// Runs a state. An error of the segment file is reported at the key of the page.
pub fn run(state: &State) -> Result<Ran, Vec<Problem>> {
    let file = segment_file(state)?;
    let parsed = SegmentFile::parse(FILE, &file).map_err(|error| {
        let key = key_in_line(&file, error.line).unwrap_or_default();
        let mut message = error.message.clone();
        if let Some(hint) = &error.hint {
            let _ = write!(message, " ({hint})");
        }
        vec![Problem { key, message }]
    })?;
    let mut scenario = Scenario::from(parsed);
    scenario.force = state.word("force") == "on";
    let cycles = state.number("cycles").unwrap_or(300);
    scenario.duration = Nanos(scenario.cycle.0 * cycles);
    let spans = 2 * cycles as usize * MOST_PULSES;
    let onlooker = Onlooker {
        recording: Recording::new(scenario.duration, scenario.sync0_limit, spans),
        began: None,
        events: Vec::new(),
        counters: Vec::new(),
        frames: 0,
        clocks: Vec::new(),
    };
    let outcome = scenario.run().execute(Some(onlooker), &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    let segment = outcome.world.main().segment();
    let (timing, reference) = (segment.timing.clone(), segment.reference);
    let clocks: Vec<bool> = segment.devices.iter().map(|device| device.dc.has_clock()).collect();
    let pulse = isocat_wire::register::SYNC_PULSE_LENGTH;
    let chips = outcome.world.segment().devices();
    let pulses = chips.iter().map(|d| Nanos(i64::from(d.esc.register(pulse)) * 10)).collect();
    let Some(onlooker) = outcome.world.into_tap() else { unreachable!("it was given one") };
    Ok(Ran {
        file,
        report,
        way_up: onlooker.way_up(reference, &clocks),
        events: onlooker.events,
        counters: onlooker.counters,
        recorded: onlooker.recording.finish(),
        timing,
        cycle: scenario.cycle,
        pulses,
    })
}

/// The name of the file in problems.
const FILE: &str = "segment.toml";
/// Largest number of SYNC0 pulses in a cycle that are recorded separately.
const MOST_PULSES: usize = 8;
/// Percentage of the clock deviation for each device, so that neighbours differ.
const SHARES: [i64; 8] = [20, -100, 100, -40, 70, -80, 50, -10];

/// Writes the state as a segment file. An incomplete line of faults is an error.
pub fn segment_file(state: &State) -> Result<String, Vec<Problem>> {
    let time = |key: &str| state.time(key).map(quoted);
    let mut text = format!(
        "# From the playground.\ncycle = {}\n",
        quoted(state.time("cycle").unwrap_or_default())
    );
    let cycles = state.number("cycles").unwrap_or(300);
    let length = Nanos(state.number("cycle").unwrap_or(0) * cycles);
    let _ =
        write!(text, "for = {}\nseed = {}\n", quoted(length), state.number("seed").unwrap_or(1));
    if let Some(phase) = time("phase") {
        let _ = writeln!(text, "shift = {phase}");
    }
    match state.word("recovery") {
        "never" => {}
        "again" => {
            let _ = writeln!(text, "recovery = {AGAIN}");
        }
        once => {
            let _ = writeln!(text, "recovery = \"{once}\"");
        }
    }
    let clock = Ppb(state.number("host-clock").unwrap_or(0));
    let jitter = state.time("host-jitter").unwrap_or_default();
    let _ = write!(text, "\n[host]\nclock = \"{}\"\njitter = {}\n", plain(clock), quoted(jitter));
    if state.word("drift-compensation") == "off" {
        text += "drift_compensation = false\n";
    }
    let cable = Length(state.number("cable").unwrap_or(10_000));
    let on_ebus =
        profile::built_in(state.word("device")).is_some_and(|profile| profile.is_on_ebus());
    if on_ebus {
        // Terminals are connected to the MainDevice by EBUS, without a cable.
        text += "port = \"ebus\"\n";
    }
    for number in 0..state.number("devices").unwrap_or(1) as usize {
        let share = state.number("clocks").unwrap_or(0) * SHARES[number % SHARES.len()] / 100;
        let _ = write!(
            text,
            "\n[[subdevice]]\ndevice = \"{}\"\nname = \"device {number}\"\nmode = \"{}\"\nclock = \"{}\"\n",
            state.word("device"),
            state.word("mode"),
            plain(Ppb(share)),
        );
        if !on_ebus {
            let _ = writeln!(text, "cable = \"{}\"", cable.to_string().replace(' ', ""));
            // Copper does not reach so far.
            if cable > Length::metres(100) {
                text.push_str("fibre = true\n");
            }
        }
        for key in KEYS.iter().filter(|key| matches!(key.kind, Kind::Duration { .. })) {
            let in_device = key.of.filter(|path| path.starts_with("subdevice."));
            if let (Some(path), Some(value)) = (in_device, time(key.name)) {
                let _ = writeln!(text, "{} = {value}", in_file(path).key.name);
            }
        }
    }
    for line in state.lines(FAULTS) {
        text += &fault(line)?;
    }
    Ok(text)
}

/// Makes a `[[fault]]` table from a line such as `in-operation + 50ms: pull 1`.
fn fault(line: &str) -> Result<String, Vec<Problem>> {
    let Some((at, what)) = line.split_once(':') else {
        let message = format!(
            "{FAULTS}: {line:?} has no colon; expected when and what, such as \"in-operation + 50ms: pull 1 for 20ms\""
        );
        return Err(vec![Problem { key: FAULTS.to_owned(), message }]);
    };
    // A JSON string is a TOML string, except for this character.
    let json = |words: &str| serde_json::Value::from(words.trim()).to_string();
    let text = |words: &str| json(words).replace('\u{7f}', "\\u007F");
    Ok(format!("\n[[fault]]\nat = {}\nwhat = {}\n", text(at), text(what)))
}

fn quoted(time: Nanos) -> String {
    format!("\"{}\"", time.to_string().replace(' ', ""))
}

fn plain(rate: Ppb) -> String {
    rate.to_string().replace(' ', "")
}

/// The page's key for a line of the file.
fn key_in_line(file: &str, line: usize) -> Option<String> {
    let text = file.lines().nth(line.checked_sub(1)?)?;
    let name = text.split('=').next()?.trim();
    let heads = file.lines().take(line).filter(|line| line.starts_with('['));
    let table = heads.last().map(|head| head.trim_matches(['[', ']']));
    if table == Some("fault") {
        return Some(FAULTS.to_owned());
    }
    let path = match table {
        Some(table) => format!("{table}.{name}"),
        None => name.to_owned(),
    };
    let key = KEYS.iter().find(|key| key.of == Some(path.as_str()));
    Some(key.map_or(name, |key| key.name).to_owned())
}

/// A tap for the run, which also keeps data that would be too much for long runs.
struct Onlooker {
    recording: Recording,
    began: Option<Time<True>>,
    events: Vec<(Picos, usize, Observed)>,
    counters: Vec<(Picos, Vec<u16>)>,
    frames: usize,
    /// System times of all SubDevices on the way up, ps.
    clocks: Vec<(Time<True>, Vec<i128>)>,
}

/// Number of frames between two samples of the clocks on the way up.
const SAMPLE: usize = 8;
/// Largest number of events that are kept.
const MOST_EVENTS: usize = 400_000;
/// Clocks that differ by more are not set yet, ps.
const NEAR: i128 = 200_000_000;

impl Onlooker {
    /// Notes a missed event. For a SubDevice that no frame reaches it is reported late, so later
    /// entries are corrected.
    fn missed(&mut self, at: Picos, device: usize, value: u16) {
        let behind = self.counters.partition_point(|(of, _)| *of <= at);
        let Some(mut now) = behind.checked_sub(1).map(|last| self.counters[last].1.clone()) else {
            return;
        };
        now[device] = value;
        for (_, later) in &mut self.counters[behind..] {
            later[device] = value;
        }
        self.counters.insert(behind, (at, now));
    }

    fn way_up(&self, reference: Option<usize>, clocks: &[bool]) -> Vec<(Picos, Vec<Option<i64>>)> {
        let Some(reference) = reference else { return Vec::new() };
        let mut way = Vec::new();
        let mut first = None;
        for (at, times) in &self.clocks {
            let off = |(position, time): (usize, &i128)| {
                let difference = time - times.get(reference)?;
                let is_near = difference.abs() < NEAR && clocks.get(position) == Some(&true);
                is_near.then_some(difference as i64)
            };
            let differences: Vec<_> = times.iter().enumerate().map(off).collect();
            // Samples before all clocks are set are left out.
            let near = differences.iter().zip(clocks).all(|(off, clock)| off.is_some() || !clock);
            if near {
                way.push((*at - *first.get_or_insert(*at), differences));
            }
        }
        way
    }
}

impl Tap for Onlooker {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.recording.frame(at, sent, bytes);
    }

    fn passed(&mut self, at: Time<True>, segment: &Segment) {
        self.frames += 1;
        if self.began.is_none() && self.frames.is_multiple_of(SAMPLE) {
            let time = |device: &isocat_sim::device::Device| device.system_time_ps(at);
            self.clocks.push((at, segment.devices().iter().map(time).collect()));
        }
    }

    fn judging_begins(&mut self, at: Time<True>, intent: &Intent) {
        // The recording restarts when all devices are in operation.
        self.began = Some(at);
        self.events.clear();
        self.counters.clear();
        self.recording.judging_begins(at, intent);
    }

    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        self.began.get_or_insert(at);
        if let Some(began) = self.began {
            let counter =
                |device: &isocat_sim::device::Device| device.stack.sync().sm_event_missed();
            let now: Vec<u16> = segment.devices().iter().map(counter).collect();
            if self.counters.last().is_none_or(|(_, last)| *last != now) {
                self.counters.push((at - began, now));
            }
        }
        self.recording.cycle(at, main, segment);
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        if let (Observed::SmEventMissed(value), Some(began)) = (observation.event, self.began) {
            self.missed(at - began, observation.device, value);
        }
        if let Some(began) = self.began.filter(|_| self.events.len() < MOST_EVENTS) {
            self.events.push((at - began, observation.device, observation.event));
        }
        self.recording.observed(segment, at, observation);
    }
}
