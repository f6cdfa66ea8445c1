//! Whole lines of a log, as MainDevices and drives print them.
//!
//! A line is answered in three steps. The tables of [`PROGRAMS`] know what a program prints: each
//! pattern is the printed text with holes. The numbers of the line ([`numbers`]) are explained as
//! if each had been asked for. Where neither knows anything, the words of the field that the line
//! holds are. Of several patterns that fit, the one with most letters is meant.

mod acontis;
mod causes;
mod codesys;
mod ethercrab;
mod igh;
mod kickcat;
mod linuxcnc;
pub(super) mod makers;
mod names;
mod numbers;
mod pysoem;
mod ros;
mod soem;
mod spoken;
mod twincat;
mod words;

use isocat_sync::explain::{Entry, symptoms, terms};

use super::{Found, Meaning, of, symptom_meaning, term_meaning};
use words::{Pattern, tokens};

/// A program and the lines that it prints.
struct Program {
    /// The program, as it is told to the user.
    name: &'static str,
    lines: &'static [Line],
}

/// Lines that mean the same.
struct Line {
    /// The printed texts, in the notation of [`Pattern`]; the first one names the line.
    prints: &'static [&'static str],
    /// A number in the line says more than the line does, so that it comes first.
    introduces: bool,
    entry: &'static Entry,
}

const fn line(prints: &'static [&'static str], entry: &'static Entry) -> Line {
    Line { prints, introduces: false, entry }
}

/// A line whose number says more than the line itself.
const fn introduction(prints: &'static [&'static str], entry: &'static Entry) -> Line {
    Line { prints, introduces: true, entry }
}

/// The programs. Of two that print the same, the earlier one is named.
static PROGRAMS: [&Program; 12] = [
    &igh::PROGRAM,
    &soem::PROGRAM,
    &pysoem::PROGRAM,
    &ethercrab::PROGRAM,
    &kickcat::PROGRAM,
    &twincat::PROGRAM,
    &twincat::GERMAN,
    &codesys::PROGRAM,
    &acontis::PROGRAM,
    &linuxcnc::PROGRAM,
    &ros::PROGRAM,
    &spoken::PROGRAM,
];

/// The meanings of a line, the one that decides first; empty if nothing in it is known.
pub(super) fn meanings(text: &str) -> Vec<Meaning> {
    let printed = known(text);
    let mut numbers = numbers::meanings(text);
    numbers.extend(makers::within(text));
    let (known_line, introduces) = match printed {
        Some((meaning, introduces)) => (Some(meaning), introduces),
        None => (None, false),
    };
    let found = if known_line.is_some() { Found::Line } else { Found::Number };
    let mut all: Vec<Meaning> = numbers;
    for meaning in &mut all {
        meaning.found = found;
    }
    match known_line {
        Some(meaning) if introduces => all.push(meaning),
        Some(meaning) => all.insert(0, meaning),
        None => {}
    }
    if all.is_empty() {
        all.extend(word(text).map(|meaning| Meaning { found: Found::Word, ..meaning }));
    }
    all
}

/// The line of a program that fits best, and whether a number in it says more.
fn known(text: &str) -> Option<(Meaning, bool)> {
    let tokens = tokens(text);
    let mut best: Option<(usize, &Program, &Line)> = None;
    for program in PROGRAMS {
        for line in program.lines {
            for print in line.prints {
                let letters = Pattern::new(print).fits(&tokens).unwrap_or_default();
                if letters > best.map_or(0, |(most, ..)| most) {
                    best = Some((letters, program, line));
                }
            }
        }
    }
    let (_, program, line) = best?;
    let name = format!("printed by {}", program.name);
    let mut meaning = of("line", format!("\"{}\"", line.prints[0]), name, line.entry);
    meaning.found = Found::Line;
    Some((meaning, line.introduces))
}

/// The word of the field that the line holds: the longest name of a symptom or term.
fn word(text: &str) -> Option<Meaning> {
    let tokens = tokens(text);
    let symptoms = symptoms::SYMPTOMS.iter().map(|symptom| (symptom, true));
    let terms = terms::TERMS.iter().map(|term| (term, false));
    let mut best: Option<(usize, &symptoms::Symptom, bool)> = None;
    for (symptom, is_symptom) in symptoms.chain(terms) {
        for name in symptom.aliases.iter().chain([&symptom.name]) {
            if NO_SYMPTOM_WITHIN_A_LINE.contains(name) {
                continue;
            }
            let letters = Pattern::new(name).fits(&tokens).unwrap_or_default();
            if letters > best.map_or(0, |(most, ..)| most) {
                best = Some((letters, symptom, is_symptom));
            }
        }
    }
    best.map(|(_, symptom, is_symptom)| match is_symptom {
        true => symptom_meaning(symptom),
        false => term_meaning(symptom),
    })
}

/// Names that are nothing but a state or a common word where they stand within a line.
const NO_SYMPTOM_WITHIN_A_LINE: [&str; 20] = [
    "safeop",
    "preop",
    "switch",
    "shift",
    "phase",
    "dc",
    "tree",
    "ring",
    "hub",
    "noise",
    "rough",
    "timeout",
    "no response",
    "mailbox",
    "router",
    "timed out",
    "32 bit",
    "emergency",
    "watchdog",
    "no frame",
];

#[cfg(test)]
mod tests;
