//! The answer to the page: pictures and figures as one JSON text.

use std::cell::RefCell;
use std::collections::BTreeMap;

use isocat::picture::Picture;
use isocat::quantity::time;
use isocat::recording::cycle::Origin;
use isocat::report::FaultNote;
use isocat::timeline::Moment;
use isocat_wire::time::{Nanos, Picos};
use serde::Serialize;

use crate::keys::{KEYS, Key};
use crate::presets::{PRESETS, Preset};
use crate::pulses::{self, RegisterRow};
use crate::run::{self, Ran};
use crate::state::{Problem, State};
use crate::{counter, edges, pictures};

/// The whole answer; parts that do not apply are empty.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Answer {
    /// What is wrong with the page's state; if there is a problem, all else is empty.
    pub problems: Vec<Problem>,
    /// The verdict in one sentence.
    pub verdict: String,
    /// Whether everything is as it should be.
    pub good: bool,
    /// The findings against the run.
    pub findings: Vec<String>,
    /// The beginnings and ends of the faults that were requested.
    pub faults: Vec<Incident>,
    /// The shown cycle, and the first and last cycle that can be shown.
    pub at: [i64; 3],
    /// Pictures, by name.
    pub pictures: Vec<Drawn>,
    /// Figures of each device.
    pub devices: Vec<Figures>,
    /// Registers of the SYNC unit.
    pub registers: Vec<RegisterRow>,
    /// The state as a segment file.
    pub file: String,
}

/// A picture and its place on the page.
#[derive(Clone, Debug, Serialize)]
pub struct Drawn {
    /// The place: `edges`, `cycle`, `counter`, `miss`, `waves`, `clock`, `sync0`, `pulses`.
    pub place: &'static str,
    /// Its title.
    pub title: String,
    /// The SVG element.
    pub svg: String,
}

/// The beginning or end of a fault that was requested.
#[derive(Clone, Debug, Serialize)]
pub struct Incident {
    /// The cycle in which it happened, negative on the way up.
    pub at: i64,
    /// When it happened, and what.
    pub what: String,
}

/// The figures of one device.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Its name.
    pub name: String,
    /// Its synchronization mode.
    pub mode: String,
    /// AL status at the end.
    pub state: String,
    /// Largest error of SYNC0 against the grid, in words; empty without SYNC0.
    pub sync0: String,
    /// Least time from ready outputs to the pulse, in words.
    pub margin: String,
    /// Whether this time is negative.
    pub late: bool,
    /// The spread of Outputs Valid in the bus cycle of the reference clock; empty if it has no
    /// fixed place there.
    pub outputs: String,
    /// Values of 0x1C32:0B, 0C, 0D and 20; `-` if the device does not have the counter.
    pub counters: [String; 4],
    /// Lines of the plan.
    pub plan: Vec<Line>,
}

/// A line of the plan.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// The object that states it.
    pub object: String,
    /// The demand in words.
    pub demand: String,
    /// Needed time, available time, slack.
    pub times: [String; 3],
    /// Whether it fits.
    pub fits: bool,
}

/// What the page is built from.
#[derive(Serialize)]
struct Description {
    keys: &'static [Key],
    presets: &'static [Preset],
    style: &'static str,
    zoom: &'static str,
}

thread_local! {
    /// The last run, so that another cycle of it can be shown without running it again.
    static LAST: RefCell<Option<(State, Ran)>> = const { RefCell::new(None) };
}

/// Answers a JSON object of keys and texts; an empty text requests the keys and presets.
pub fn answer(text: &str) -> String {
    let written = if text.is_empty() {
        let (style, zoom) = (isocat::picture::STYLE, isocat::picture::ZOOM);
        serde_json::to_string(&Description { keys: &KEYS, presets: &PRESETS, style, zoom })
    } else {
        serde_json::to_string(&work(text))
    };
    written.unwrap_or_default()
}

fn work(text: &str) -> Answer {
    let texts: BTreeMap<String, String> = match serde_json::from_str(text) {
        Ok(texts) => texts,
        Err(error) => {
            let message = format!("the state is no JSON object of texts: {error}");
            let problems = vec![Problem { key: String::new(), message }];
            return Answer { problems, ..Answer::default() };
        }
    };
    of(&texts)
}

/// Answers a state.
pub fn of(texts: &BTreeMap<String, String>) -> Answer {
    let refused = |problems| Answer { problems, ..Answer::default() };
    let state = match State::read(texts) {
        Ok(state) => state,
        Err(problems) => return refused(problems),
    };
    if state.word("view") == "pulses" {
        return generation(&state);
    }
    LAST.with_borrow_mut(|last| {
        if last.as_ref().is_none_or(|(of, _)| *of != state) {
            match run::run(&state) {
                Ok(ran) => *last = Some((state, ran)),
                Err(problems) => return refused(problems),
            }
        }
        let Some((_, ran)) = last else { return Answer::default() };
        match look(texts, ran) {
            Ok((at, show)) => {
                let only = texts.get("only").is_some_and(|only| only == "play");
                of_run(ran, at, show, only)
            }
            Err(problem) => refused(vec![problem]),
        }
    })
}

/// The cycle and the device to show.
fn look(texts: &BTreeMap<String, String>, ran: &Ran) -> Result<(i64, usize), Problem> {
    let number = |key: &str, least: i64, most: i64| {
        let Some(text) = texts.get(key) else { return Ok(0.clamp(least, most)) };
        let found = text.trim().parse::<i64>().map_err(|_| Problem {
            key: key.to_owned(),
            message: format!("{key} = \"{text}\"; expected a whole number from {least} to {most}"),
        })?;
        // A run that ended early has fewer cycles: then the last one is shown.
        Ok(found.clamp(least, most))
    };
    let [_, least, most] = cycles(ran);
    let device = number("show", 0, ran.report.devices.len() as i64 - 1)?;
    Ok((number("at", least, most)?, device as usize))
}

/// The default cycle, and the first and last cycle that can be shown; the way up has negative
/// numbers.
fn cycles(ran: &Ran) -> [i64; 3] {
    let recorded = ran.recorded.length.0 / Picos::from(ran.cycle).0.max(1);
    [0, -(edges::way_up(ran) as i64), recorded.max(0)]
}

fn of_run(ran: &Ran, at: i64, show: usize, only_play: bool) -> Answer {
    let report = &ran.report;
    let [_, least, most] = cycles(ran);
    let mut all = Vec::new();
    let mut put = |place, picture: Option<Picture>| {
        if let Some(picture) = picture {
            all.push(Drawn { place, title: picture.title.clone(), svg: picture.svg() });
        }
    };
    put("edges", Some(edges::draw(ran, at)));
    let until = Picos((at.max(-1) + 1) * Picos::from(ran.cycle).0);
    put("counter", counter::draw(ran, until));
    put("waves", Some(pictures::waves(ran, show, at)));
    if only_play {
        return Answer { at: [at, least, most], pictures: all, ..Answer::default() };
    }
    for position in 0..report.devices.len() {
        put("cycle", pictures::cycle(ran, position));
    }
    put("miss", (0..report.devices.len()).find_map(|position| pictures::first_miss(ran, position)));
    for position in 0..report.devices.len() {
        put("clock", pictures::clock(ran, position));
        put("sync0", pictures::sync0(ran, position, SYNC0_LIMIT));
    }
    Answer {
        verdict: report.verdict.clone(),
        good: report.in_sync,
        findings: report.findings.iter().map(|finding| finding.sentence()).collect(),
        faults: report
            .faults
            .iter()
            .take(MOST_INCIDENTS)
            .map(|fault| incident(ran, fault))
            .collect(),
        at: [at, least, most],
        pictures: all,
        devices: (0..report.devices.len()).map(|position| figures(ran, position)).collect(),
        file: ran.file.clone(),
        ..Answer::default()
    }
}

/// Largest number of incidents in the list.
const MOST_INCIDENTS: usize = 24;

fn incident(ran: &Ran, fault: &FaultNote) -> Incident {
    let at = fault.at_ns.div_euclid(ran.cycle.0.max(1));
    Incident { at, what: format!("{}: {}", Nanos(fault.at_ns), fault.what) }
}

/// The same limit as in the command.
const SYNC0_LIMIT: Nanos = Nanos(1_000);

fn figures(ran: &Ran, position: usize) -> Figures {
    let device = &ran.report.devices[position];
    let measured = &device.true_time;
    let counters = &device.registers.output_counters;
    let number = |value: Option<u32>| value.map_or("-".to_owned(), |value| value.to_string());
    let cycle = ran.recorded.devices.get(position).and_then(|device| device.cycle.as_ref());
    let valid = cycle
        .filter(|cycle| cycle.origin == Origin::BusCycle)
        .and_then(|cycle| cycle.of(Moment::OutputsValid))
        .map(|seen| time((seen.largest() - seen.least()) as f64 / 1e3));
    let margin = measured.sync0_margin.map(|margin| margin.min_ns);
    Figures {
        name: device.name.clone(),
        mode: device.mode.to_string(),
        state: device.registers.al_status.to_string(),
        sync0: measured.sync0_error.map_or(String::new(), |error| time(error.worst_ns)),
        margin: margin.map_or(String::new(), time),
        late: margin.is_some_and(|margin| margin < 0.0),
        outputs: valid.unwrap_or_default(),
        counters: [
            number(counters.sm_event_missed),
            number(counters.cycle_time_too_small),
            number(counters.shift_time_too_short),
            number(counters.sync_error),
        ],
        plan: device.plan.iter().map(line).collect(),
    }
}

fn line(line: &isocat::report::PlanLine) -> Line {
    let times = [line.needed_ns, line.available_ns, line.slack_ns].map(|ns| Nanos(ns).to_string());
    let (object, demand) = (line.object.clone(), line.demand.clone());
    Line { object, demand, times, fits: line.slack_ns >= 0 }
}

fn generation(state: &State) -> Answer {
    let generated = pulses::generate(state);
    let picture = generated.draw();
    let pictures =
        vec![Drawn { place: "pulses", title: picture.title.clone(), svg: picture.svg() }];
    let registers = generated.registers.clone();
    Answer { verdict: generated.verdict(), good: true, pictures, registers, ..Answer::default() }
}
