//! The plan of one segment at several bus cycles, side by side.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_descriptions::document::FileError;
use isocat_segment::{Scenario, SegmentFile};
use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::{Plan, report};
use crate::fold::{fold, label, positions};
use crate::report::{BAD, GOOD, QUIET, typed};
use crate::sweep;

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-plan-cycles/1";
/// Most cycles of one table.
pub const MOST: usize = 32;

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<Cycles>(FORMAT)
}

/// A segment at several bus cycles. All times are nanoseconds.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Cycles {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Where the segment was described.
    pub segment_file: String,
    /// The plans, in the order in which their cycles were asked for.
    pub plans: Vec<AtCycle>,
}

/// The segment at one bus cycle.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct AtCycle {
    /// Bus cycle.
    pub cycle_ns: i64,
    /// Whether every line has slack of 0 or more; false if there is no plan at all.
    pub fits: bool,
    /// What the plan says, in one sentence; why there is none, if there is none.
    pub verdict: String,
    /// Least slack of all lines of the cycle; of all lines where one does not fit. Null if there is
    /// no plan.
    pub least_slack_ns: Option<i64>,
    /// The SubDevices, by position; empty if there is no plan.
    pub devices: Vec<DeviceAt>,
}

/// A SubDevice at one bus cycle.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceAt {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name in the segment file.
    pub name: String,
    /// Profile.
    pub profile: String,
    /// Synchronization mode.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub mode: SyncMode,
    /// Why not a higher mode; empty if this is the one asked for or the highest.
    pub mode_reason: String,
    /// Its process data are exchanged in every n-th bus cycle.
    pub every: u32,
    /// Least slack of its lines of the cycle; of all its lines where one does not fit. Null without
    /// lines.
    pub least_slack_ns: Option<i64>,
    /// The object of that line; null where none states it.
    pub object: Option<String>,
}

/// Plans a segment file once for each cycle. `path` names it in errors, and files that it names are
/// relative to its folder. The cycles are written as in the file, such as `250us`. What the file
/// itself has wrong is an error; a cycle at which there is no plan is part of the table.
pub fn at_cycles(path: &str, text: &str, cycles: &[String]) -> Result<Cycles, FileError> {
    SegmentFile::parse(path, text)?;
    // What the segment file's own reader took is TOML.
    let base = text.parse::<toml::Table>().unwrap_or_default();
    let plans = cycles.iter().map(|cycle| {
        let value = isocat_descriptions::quantity::parse_duration(cycle);
        let cycle_ns = value.map_or(0, |value| value.0);
        let mut table = base.clone();
        let planned = sweep::set(&mut table, "cycle", cycle)
            .and_then(|()| {
                let file = SegmentFile::parse(path, &table.to_string());
                file.map_err(|error| error.message.clone())
            })
            .and_then(|file| {
                let scenario = Scenario::from(file);
                let plan = Plan::of(&scenario).map_err(|error| error.to_string())?;
                Ok(plan.report(&scenario))
            });
        match planned {
            Ok(report) => AtCycle::of(cycle_ns, &report),
            Err(verdict) => AtCycle {
                cycle_ns,
                fits: false,
                verdict: format!("No plan: {verdict}"),
                least_slack_ns: None,
                devices: Vec::new(),
            },
        }
    });
    Ok(Cycles {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION"),
        segment_file: path.to_owned(),
        plans: plans.collect(),
    })
}

impl AtCycle {
    fn of(cycle_ns: i64, report: &report::PlanReport) -> Self {
        let device = |device: &report::Device| {
            let tightest = device.tightest();
            DeviceAt {
                position: device.position,
                name: device.name.clone(),
                profile: device.profile.clone(),
                mode: device.mode,
                mode_reason: device.mode_reason.clone(),
                every: device.every,
                least_slack_ns: tightest.map(|line| line.slack_ns),
                object: tightest.and_then(|line| line.object.clone()),
            }
        };
        Self {
            cycle_ns,
            fits: report.fits,
            verdict: report.verdict.clone(),
            least_slack_ns: Some(report.segment.least_slack_ns),
            devices: report.devices.iter().map(device).collect(),
        }
    }
}

/// A SubDevice at each cycle; `None` where there is no plan.
struct Row<'a> {
    position: usize,
    of: &'a DeviceAt,
    at: Vec<Option<&'a DeviceAt>>,
}

impl Row<'_> {
    /// Whether both are one row of the table: equal devices that get equal modes.
    fn is_like(&self, other: &Self) -> bool {
        let modes = |row: &Self| row.at.iter().map(|at| at.map(|at| at.mode)).collect::<Vec<_>>();
        self.of.profile == other.of.profile && modes(self) == modes(other)
    }
}

impl Cycles {
    /// Whether every cycle has a plan that fits.
    pub fn all_fit(&self) -> bool {
        self.plans.iter().all(|plan| plan.fits)
    }

    /// The table as text, with ANSI styles, a hundred columns wide.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        writeln!(out, "{QUIET}{}{QUIET:#}", self.segment_file)?;
        for plan in &self.plans {
            let style = if plan.fits { GOOD } else { BAD };
            let mut lines = wrap(&plan.verdict, WIDTH - 14).into_iter();
            let cycle = Nanos(plan.cycle_ns).to_string();
            let first = lines.next().unwrap_or_default();
            writeln!(out, " {cycle:>11}  {style}{first}{style:#}")?;
            for line in lines {
                writeln!(out, "{:14}{line}", "")?;
            }
        }
        let rows = self.rows();
        let stretches = fold(&rows, Row::is_like);
        for block in (0..self.plans.len()).collect::<Vec<_>>().chunks(COLUMNS) {
            write!(out, "\n {:<9} {:<22}", "#", "device")?;
            for at in block {
                write!(out, " {:<21}", Nanos(self.plans[*at].cycle_ns).to_string())?;
            }
            trim_end(out);
            writeln!(out)?;
            for stretch in &stretches {
                let names: Vec<_> =
                    stretch.iter().map(|row| (row.position, row.of.name.as_str())).collect();
                write!(out, " {}", label(&names, 9, 22))?;
                for at in block {
                    write!(out, " {:<21}", cell(stretch.iter().filter_map(|row| row.at[*at])))?;
                }
                trim_end(out);
                writeln!(out)?;
            }
        }
        self.write_reasons(out)
    }

    /// Each reason once, with the SubDevices and cycles that it is for.
    fn write_reasons(&self, out: &mut String) -> fmt::Result {
        let mut reasons: Vec<(String, Vec<usize>)> = Vec::new();
        for device in self.plans.iter().flat_map(|plan| &plan.devices) {
            if device.mode_reason.is_empty() {
                continue;
            }
            let reason = format!("{}: {}", device.mode, device.mode_reason);
            match reasons.iter_mut().find(|(known, _)| *known == reason) {
                Some((_, positions)) if positions.contains(&device.position) => {}
                Some((_, positions)) => positions.push(device.position),
                None => reasons.push((reason, vec![device.position])),
            }
        }
        if !reasons.is_empty() {
            writeln!(out, "\nWhy not a higher mode")?;
        }
        for (reason, all) in reasons {
            let plural = if all.len() > 1 { "s" } else { "" };
            let text = format!("SubDevice{plural} {}, {reason}", positions(&all));
            for (i, line) in wrap(&text, WIDTH - 3).into_iter().enumerate() {
                writeln!(out, "{}{line}", if i == 0 { " " } else { "   " })?;
            }
        }
        Ok(())
    }

    fn rows(&self) -> Vec<Row<'_>> {
        let most = self.plans.iter().map(|plan| plan.devices.len()).max().unwrap_or(0);
        let row = |position: usize| {
            let at: Vec<_> = self.plans.iter().map(|plan| plan.devices.get(position)).collect();
            let of = *at.iter().flatten().next()?;
            Some(Row { position, of, at })
        };
        (0..most).filter_map(row).collect()
    }
}

/// Cycles beside each other in a hundred columns.
const COLUMNS: usize = 3;

/// Mode and least slack of one device or of several equal ones.
fn cell<'a>(devices: impl Iterator<Item = &'a DeviceAt> + Clone) -> String {
    let Some(first) = devices.clone().next() else { return "-".to_owned() };
    let least = devices.filter_map(|device| device.least_slack_ns).min();
    format!("{} {}", first.mode, least.map_or("-".to_owned(), |ns| Nanos(ns).to_string()))
}

fn trim_end(text: &mut String) {
    text.truncate(text.trim_end_matches(' ').len());
}
