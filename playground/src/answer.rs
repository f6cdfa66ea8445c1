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

/// The whole answer; what does not apply is empty.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Answer {
    /// What can't be as the page says it; then nothing else is there.
    pub problems: Vec<Problem>,
    /// One sentence.
    pub verdict: String,
    /// Whether all is as it ought to be.
    pub good: bool,
    /// What is wrong beside it.
    pub findings: Vec<String>,
    /// What went wrong on purpose, and its end.
    pub faults: Vec<Incident>,
    /// The cycle that is looked at, and between which it can be.
    pub at: [i64; 3],
    /// Pictures, by name.
    pub pictures: Vec<Drawn>,
    /// Figures of each device.
    pub devices: Vec<Figures>,
    /// Registers of the SYNC unit.
    pub registers: Vec<RegisterRow>,
    /// The same as a segment file.
    pub file: String,
}

/// A picture and its place on the page.
#[derive(Clone, Debug, Serialize)]
pub struct Drawn {
    /// The place: `edges`, `cycle`, `counter`, `miss`, `waves`, `clock`, `sync0`, `pulses`.
    pub place: &'static str,
    /// What it is called.
    pub title: String,
    /// The element.
    pub svg: String,
}

/// Something that went wrong on purpose.
#[derive(Clone, Debug, Serialize)]
pub struct Incident {
    /// The cycle in which it began or ended, below zero on the way up.
    pub at: i64,
    /// When and what.
    pub what: String,
}

/// What is known of one device.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Its name.
    pub name: String,
    /// How it is synchronized.
    pub mode: String,
    /// AL status at the end.
    pub state: String,
    /// SYNC0 off the grid at worst, in words; empty without SYNC0.
    pub sync0: String,
    /// Least time from outputs ready to the pulse.
    pub margin: String,
    /// That is negative.
    pub late: bool,
    /// How far Outputs Valid spreads in the bus cycle of the reference clock; empty where it has no place in it.
    pub outputs: String,
    /// 0x1C32:0B, 0C, 0D and 20; `-` where it does not have them.
    pub counters: [String; 4],
    /// Lines of the plan.
    pub plan: Vec<Line>,
}

/// A line of the plan.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Object that states it.
    pub object: String,
    /// What is asked for.
    pub demand: String,
    /// Needed, available, left.
    pub times: [String; 3],
    /// It fits.
    pub fits: bool,
}

/// What the page is made of.
#[derive(Serialize)]
struct Description {
    keys: &'static [Key],
    presets: &'static [Preset],
    style: &'static str,
    zoom: &'static str,
}

thread_local! {
    /// The last run: who looks at another cycle of it does not wait for it again.
    static LAST: RefCell<Option<(State, Ran)>> = const { RefCell::new(None) };
}

/// Answers a JSON object of keys and texts; an empty text asks what keys and presets there are.
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

/// Which cycle and which device are looked at.
fn look(texts: &BTreeMap<String, String>, ran: &Ran) -> Result<(i64, usize), Problem> {
    let number = |key: &str, least: i64, most: i64| {
        let Some(text) = texts.get(key) else { return Ok(0.clamp(least, most)) };
        let found = text.trim().parse::<i64>().map_err(|_| Problem {
            key: key.to_owned(),
            message: format!("{key} = \"{text}\"; expected a whole number from {least} to {most}"),
        })?;
        // A run that ended early has fewer cycles: the last one is looked at.
        Ok(found.clamp(least, most))
    };
    let [_, least, most] = cycles(ran);
    let device = number("show", 0, ran.report.devices.len() as i64 - 1)?;
    Ok((number("at", least, most)?, device as usize))
}

/// Cycles that can be looked at, the way up below zero.
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

/// Incidents that are listed.
const MOST_INCIDENTS: usize = 24;

fn incident(ran: &Ran, fault: &FaultNote) -> Incident {
    let at = fault.at_ns.div_euclid(ran.cycle.0.max(1));
    Incident { at, what: format!("{}: {}", Nanos(fault.at_ns), fault.what) }
}

/// As the command has it.
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
