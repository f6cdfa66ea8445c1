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

use std::sync::LazyLock;

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
    /// The printed texts, in the notation of [`Pattern`].
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

/// A pattern, its text, and where it stands.
struct Known {
    pattern: Pattern,
    print: &'static str,
    program: &'static Program,
    line: &'static Line,
}

/// Every pattern, in the order of the tables.
static PATTERNS: LazyLock<Vec<Known>> = LazyLock::new(|| {
    let mut patterns = Vec::new();
    for program in PROGRAMS {
        for line in program.lines {
            for print in line.prints {
                patterns.push(Known { pattern: Pattern::new(print), print, program, line });
            }
        }
    }
    patterns
});

/// The meanings of a line, the one that decides first; empty if nothing in it is known.
pub(super) fn meanings(text: &str) -> Vec<Meaning> {
    let mut all = numbers::meanings(text);
    all.extend(makers::within(text));
    let Some(known) = known(text) else {
        if all.is_empty() {
            return word(text)
                .map(|word| Meaning { found: Found::Word, ..word })
                .into_iter()
                .collect();
        }
        for meaning in &mut all {
            meaning.found = Found::Number;
        }
        return all;
    };
    let at = if known.line.introduces { all.len() } else { 0 };
    let name = format!("printed by {}", known.program.name);
    all.insert(at, of("line", format!("\"{}\"", known.print), name, known.line.entry));
    for meaning in &mut all {
        meaning.found = Found::Line;
    }
    all
}

/// The pattern that fits best.
fn known(text: &str) -> Option<&'static Known> {
    let tokens = tokens(text);
    let mut best: Option<(usize, &Known)> = None;
    for known in PATTERNS.iter() {
        let letters = known.pattern.fits(&tokens).unwrap_or_default();
        if letters > best.map_or(0, |(most, _)| most) {
            best = Some((letters, known));
        }
    }
    best.map(|(_, known)| known)
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
const NO_SYMPTOM_WITHIN_A_LINE: [&str; 24] = [
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
    "safe op error",
    "safeop error",
    "safeop err",
    "safeop with error",
];

#[cfg(test)]
mod tests;
