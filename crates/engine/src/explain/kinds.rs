//! Kinds of findings, notes and doubts: the names that reports print before their sentences.
//!
//! What a kind means comes from its declaration, so that no kind is without. What to do about it is
//! an exhaustive `match` here: a new kind does not compile until it has an answer.

mod descriptions;
mod notes;

use isocat_descriptions::{eni, esi, sii};
use isocat_maindevice::SegmentChange;
use isocat_maindevice::kind::Description;
use isocat_rules::Breach;
use isocat_rules::book::{RULES, Rule};
use isocat_segment::profile::{DoubtKind, Obstacle};
use isocat_sim::Judged;
use isocat_sync::opmode;

use super::{Found, Meaning};
use crate::report::NoteKind;
use crate::{replay, verdict};

/// The meanings of a name, one for each list that has it.
pub(super) fn meanings(name: &str) -> Vec<Meaning> {
    let name = name.to_lowercase();
    all().into_iter().filter(|meaning| meaning.what == name).collect()
}

/// All names.
pub(super) fn names() -> Vec<String> {
    all().into_iter().map(|meaning| meaning.what).collect()
}

/// Every kind of every list.
pub fn all() -> Vec<Meaning> {
    let mut all = Vec::new();
    for kind in Judged::DESCRIPTIONS.iter().chain(SegmentChange::DESCRIPTIONS) {
        all.push(described("finding", "of run, serve, watch and virtual", kind, &[OF_A_RUN]));
    }
    for rule in RULES {
        let kinds = Breach::DESCRIPTIONS.iter();
        for kind in kinds.filter(|kind| kind.name == rule.finds) {
            let mut meaning = described("finding", &of_a_rule(rule), kind, &[OF_A_CLAIM]);
            meaning.read = std::slice::from_ref(&rule.needs);
            all.push(meaning);
        }
    }
    for (name, means) in isocat_diagnose::MEANINGS {
        all.push(meaning("finding", "of diagnose and record", name, means, &[OF_A_CAPTURE]));
    }
    for (kind, description) in NoteKind::ALL.iter().zip(NoteKind::DESCRIPTIONS) {
        all.push(described("note", "of plan and scan", description, notes::change(*kind)));
    }
    for gap in verdict::Gap::DESCRIPTIONS {
        all.push(described("gap", "what a run on an interface can't know", gap, &[]));
    }
    for kind in replay::Kind::DESCRIPTIONS {
        all.push(described("difference", "between a capture and the model, of replay", kind, &[]));
    }
    for kind in esi::WarningKind::ALL {
        let change = descriptions::esi(*kind);
        all.push(meaning("doubt", OF_A_DESCRIPTION, kind.name(), kind.means(), change));
    }
    for kind in DoubtKind::OWN {
        let (name, change) =
            ("how a device was made of its description", descriptions::doubt(*kind));
        all.push(meaning("doubt", name, kind.name(), kind.means(), change));
    }
    for kind in opmode::WarningKind::ALL {
        let (name, change) = ("about the pulses of an OpMode", descriptions::pulses(*kind));
        all.push(meaning("doubt", name, kind.name(), kind.means(), change));
    }
    for kind in Obstacle::ALL {
        let change = descriptions::obstacle(kind);
        let name = "why a device or an OpMode can't be simulated";
        all.push(meaning("obstacle", name, kind.name(), kind.means(), change));
    }
    for kind in sii::DoubtKind::ALL {
        let change = kind.remedies();
        all.push(meaning("doubt", "about an EEPROM (SII)", kind.name(), kind.means(), change));
    }
    for kind in eni::WarningKind::ALL {
        all.push(meaning("doubt", "about an ENI", kind.name(), kind.means(), &[OF_AN_ENI]));
    }
    all
}

/// Which rule it is, and the doors at which it can speak: each fills the same evidence.
fn of_a_rule(rule: &Rule) -> String {
    format!(
        "of the rule `{}`: {}. Doors: virtual, serve and the libraries; diagnose and record with --segment, as far \
         as frames show it",
        rule.name, rule.claims
    )
}

fn described(
    kind: &'static str,
    name: &str,
    of: &Description,
    change: &'static [&'static str],
) -> Meaning {
    let mut meaning = meaning(kind, name, of.name, of.means, change);
    for figure in of.figures {
        meaning.value.push(format!("{}{}: {}", figure.name, figure.unit, figure.means.trim()));
    }
    meaning
}

fn meaning(
    kind: &'static str,
    name: &str,
    what: &str,
    means: &'static str,
    change: &'static [&'static str],
) -> Meaning {
    Meaning {
        kind,
        what: what.to_owned(),
        name: name.to_owned(),
        means: means.trim_start(),
        value: Vec::new(),
        causes: &[],
        read: &[],
        change,
        found: Found::Asked,
    }
}

const OF_A_DESCRIPTION: &str = "about a description (ESI)";
const OF_A_RUN: &str =
    "what the report of the run says beside it: cause and remedy (`diagnoses` in --json)";
const OF_A_CLAIM: &str = "the MainDevice, if the file says what was meant; else the file. What is meant to differ: \
     `--as-is`, or leave the key out. docs/rules.md has the rules and the keys that are claims";
const OF_A_CAPTURE: &str = "what the diagnosis says below it, with the figures of this capture";
const OF_AN_ENI: &str = "the export of the tool that wrote the file, if what was left out or assumed matters: the sentence \
     beside it says how the place was read";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_stand_in_the_order_of_their_descriptions() {
        for (kind, description) in NoteKind::ALL.iter().zip(NoteKind::DESCRIPTIONS) {
            assert_eq!(kind.name(), description.name);
        }
    }

    #[test]
    fn every_kind_has_a_sentence() {
        for kind in all() {
            let Meaning { what, means, .. } = &kind;
            assert!(means.ends_with('.') && means.len() > 10, "{what}: {means:?}");
            assert!(!means.contains("[`"), "{what}: a link for the documentation: {means:?}");
            let lower = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
            assert!(what.chars().all(lower), "{what}");
        }
    }

    #[test]
    fn names_are_found_as_they_are_printed() {
        for name in names() {
            let found =
                crate::explain::explain(&name).unwrap_or_else(|unknown| panic!("{unknown}"));
            assert!(found.iter().any(|meaning| meaning.what == name), "{name}: {found:?}");
        }
    }
}
