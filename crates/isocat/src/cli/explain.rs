//! `isocat explain`: the meaning of a code, an object, a register, a mode, a line of a log or a key
//! of a file, from the data that the stack and the parsers use; and the schemas of files for
//! editors.

use std::fmt::Write;

use clap::Args;
use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_engine::explain;
use isocat_segment::keys;
use isocat_sync::object::{self, INPUT_PARAMETER, OUTPUT_PARAMETER};
use isocat_sync::table::{Aspect, Column, Condition, DOUBTS, Doubt, Need, Rights, SUBS, lookup};
use serde::Serialize;

use super::{fail, print};

const EXAMPLES: &str = "\
Examples:
  isocat explain 0x001A               an AL status code
  isocat explain 0x06090030           an SDO abort code
  isocat explain SoE 0x7005           an error code of SoE, which reads and writes the parameters of drives
  isocat explain 0x1C32:0B            an entry of an object
  isocat explain 0x1C32:04=0x0427     a value of it, taken apart; the same: SI4 0x0427
  isocat explain 0x0990               a register of the ESC
  isocat explain AssignActivate 0x0730
  isocat explain dc-sync0             a synchronization mode
  isocat explain lost sync            a symptom: lost sync, wkc, jitter, stuck in SAFEOP, no SYNC0, ...
  isocat explain reference clock      a word of the field: reference clock, hot connect, coalescing, ...
  isocat explain 'EtherCAT WARNING 0: 21 datagrams UNMATCHED!'        a line of a log, as a MainDevice prints it
  isocat explain F7011                an alarm number of a drive's maker
  isocat explain modes                what each mode needs of 0x1C32 and 0x1C33
  isocat explain input_shift          a key of a segment file or a profile, in each place where it may stand
  isocat explain subdevice.cycle      a key in one place
  isocat explain object-left-out      a kind of a finding, a note or a doubt, as reports print it
  isocat explain --schema segment-file > segment-file.schema.json     for editors: completion and checks

A number that may be several things is explained as each, the likeliest first; AL, abort, SoE, object,
register, AssignActivate or SI4 before it says which one is meant, and key before a word that is a key of a file.
A number of a drive's display, such as F414, is its maker's: an AL status code from 0x8000 on has AL or 0x before it.
Of a line of a log that is not known as such, its numbers or words are explained, and it says so.
Exit code: 0 explained, 2 not known.";

/// Arguments of `isocat explain`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// A code, an object, a register, a mode, a symptom, a line of a log, a maker's alarm number, a
    /// key of a file, a kind of a finding or a doubt, or "modes"
    #[arg(required_unless_present = "schema", value_name = "WHAT")]
    what: Vec<String>,
    /// Print the JSON schema of a kind of file, for editors
    #[arg(long, value_name = "FILE", value_parser = ["segment-file", "profile"], conflicts_with_all = ["what", "json"])]
    schema: Option<String>,
    /// Print for a program
    #[arg(long)]
    json: bool,
}

/// Runs the verb; returns the exit code.
pub(super) fn run(arguments: &Arguments) -> u8 {
    if let Some(name) = &arguments.schema {
        let file = keys::FILES.iter().find(|file| file.name == name);
        return print(&keys::schema(file.expect("the argument is one of these names")));
    }
    let what = arguments.what.join(" ");
    if what == "modes" {
        return print(&if arguments.json { modes_json() } else { modes() });
    }
    match explain::explain(&what) {
        Ok(meanings) if arguments.json => print(&explain::json(&what, &meanings)),
        Ok(meanings) => print(&explain::text(&meanings)),
        Err(unknown) => fail(&unknown.to_string()),
    }
}

/// Both objects as tables with lines of at most 100 columns.
fn modes() -> String {
    let mut text = String::from(
        "Sub-indices of 0x1C32 and 0x1C33 by synchronization mode (ETG.1020).\n\
         In each cell: who may write it, and whether it must be there.\n",
    );
    for (index, title) in OBJECTS {
        let _ = writeln!(text, "\n0x{index:04X} {title}");
        for line in HEADINGS {
            let cells: String = line.iter().map(|word| format!(" {word:<7}")).collect();
            let _ = writeln!(text, "{}", format!("{:NAME$}{cells}", "").trim_end());
        }
        for sub in SUBS {
            let name = format!("{sub:02X} {}", name(index, sub));
            let cells: String = Column::ALL
                .iter()
                .filter_map(|column| lookup(index, sub, *column))
                .map(|cell| match cell.is_used() {
                    true => format!(" {:<4} {:<2}", cell.rights, cell.need),
                    false => format!(" {:<7}", "-"),
                })
                .collect();
            let _ = writeln!(text, "{}", format!("{name:NAME$}{cells}").trim_end());
        }
    }
    text += "\nR read only, RW writable, R/RW either, - not used in this mode\n\
             M mandatory, O optional, C mandatory on a condition:\n";
    for condition in Condition::ALL {
        let _ = writeln!(text, "   {} if {}", condition.mark(), condition.in_words());
    }
    text += "Sub-index 00, the highest sub-index, is read only and always there.\n";
    text += "\nWhere a published copy of these tables differs, and why it is not followed:\n";
    for doubt in &DOUBTS {
        let what = format!("{}: {}", doubt_place(doubt), doubt_words(doubt));
        for (i, line) in wrap(&what, WIDTH - 4).iter().enumerate() {
            let _ = writeln!(text, "{} {line}", if i == 0 { "  -" } else { "   " });
        }
    }
    text
}

/// The place of a doubt: `0x1C33:0F to 12, need, DC shift SYNC1 and DC subordinated`.
fn doubt_place(doubt: &Doubt) -> String {
    let (first, last) = (doubt.subs.first(), doubt.subs.last());
    let mut place = format!("0x{:04X}:{:02X}", doubt.object, first.copied().unwrap_or_default());
    if let Some(last) = last.filter(|last| Some(*last) != first) {
        let _ = write!(place, " to {last:02X}");
    }
    let columns: Vec<_> = doubt.columns.iter().map(|column| column.name()).collect();
    let columns = match columns.len() == Column::ALL.len() {
        true => "all modes".into(),
        false => columns.join(" and "),
    };
    format!("{place}, {}, {columns}", doubt.aspect.name())
}

/// A doubt in words: `printed O, taken -: reason`; for a whole row no single cell is named.
fn doubt_words(doubt: &Doubt) -> String {
    let Doubt { printed, reason, .. } = doubt;
    match taken(doubt) {
        Some(taken) => format!("printed {printed}, taken {taken}: {reason}"),
        None => format!("{printed} printed: {reason}"),
    }
}

/// The content of our tables in the cells of a doubt, which is the same in all; `None` for a whole
/// row.
fn taken(doubt: &Doubt) -> Option<String> {
    let cell = lookup(doubt.object, *doubt.subs.first()?, *doubt.columns.first()?)?;
    let text = match doubt.aspect {
        Aspect::Rights => cell.rights.to_string(),
        Aspect::Need => cell.need.to_string(),
    };
    (doubt.columns.len() < Column::ALL.len()).then_some(text)
}

/// The same as JSON.
fn modes_json() -> String {
    let cell = |index, sub, column: &Column| {
        let cell = lookup(index, sub, *column)?;
        Some(Cell {
            column: column.name(),
            access: match cell.rights {
                Rights::None => None,
                Rights::Read => Some("R"),
                Rights::ReadWrite => Some("RW"),
                Rights::Either => Some("R/RW"),
            },
            need: match cell.need {
                Need::None => "not used",
                Need::Mandatory => "mandatory",
                Need::Optional => "optional",
                Need::Conditional(_) => "conditional",
            },
            condition: match cell.need {
                Need::Conditional(condition) => Some(condition.in_words()),
                _ => None,
            },
        })
    };
    let row = |index, sub| Row {
        sub,
        name: name(index, sub),
        columns: Column::ALL.iter().filter_map(|column| cell(index, sub, column)).collect(),
    };
    let objects = OBJECTS.map(|(index, title)| Object {
        index: format!("0x{index:04X}"),
        name: title,
        sub_indices: SUBS.iter().map(|sub| row(index, *sub)).collect(),
    });
    let differences = DOUBTS.iter().map(|doubt| Difference {
        object: format!("0x{:04X}", doubt.object),
        subs: doubt.subs,
        columns: doubt.columns.iter().map(|column| column.name()).collect(),
        aspect: doubt.aspect.name(),
        printed: doubt.printed,
        taken: taken(doubt),
        reason: doubt.reason,
    });
    let differences = differences.collect();
    let json = serde_json::to_string_pretty(&Modes { objects, differences });
    json.expect("texts and numbers can be written as JSON") + "\n"
}

#[derive(Serialize)]
struct Modes {
    objects: [Object; 2],
    /// Differences of a published copy of the tables.
    differences: Vec<Difference>,
}

#[derive(Serialize)]
struct Difference {
    object: String,
    subs: &'static [u8],
    columns: Vec<&'static str>,
    aspect: &'static str,
    printed: &'static str,
    taken: Option<String>,
    reason: &'static str,
}

#[derive(Serialize)]
struct Object {
    index: String,
    name: &'static str,
    sub_indices: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    sub: u8,
    name: &'static str,
    columns: Vec<Cell>,
}

#[derive(Serialize)]
struct Cell {
    column: &'static str,
    /// Missing if the sub-index is not used.
    #[serde(skip_serializing_if = "Option::is_none")]
    access: Option<&'static str>,
    need: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    condition: Option<&'static str>,
}

/// The name of the sub-index in this object.
fn name(index: u16, sub: u8) -> &'static str {
    match (index, sub) {
        (INPUT_PARAMETER, object::sub::MINIMUM_DELAY_TIME | 0x0F..=0x12) => "reserved",
        _ => object::name(sub).unwrap_or("reserved"),
    }
}

const OBJECTS: [(u16, &str); 2] =
    [(OUTPUT_PARAMETER, "SM output parameter"), (INPUT_PARAMETER, "SM input parameter")];
/// The names of the columns, in lines.
const HEADINGS: [[&str; 8]; 3] = [
    ["Free", "SM", "SM 2/3", "DC", "DC", "DC", "DC", "DC"],
    ["Run", "2/3", "shift", "", "shift", "shift", "SYNC1", "subor-"],
    ["", "", "", "", "", "SYNC1", "", "dinated"],
];
/// Width of sub-index and name.
const NAME: usize = 34;
