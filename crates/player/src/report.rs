//! The results of playing a list, as a document for people and for programs; and its differences
//! from the plan.

mod text;

use isocat_descriptions::eni::{Eni, Warning};
#[cfg(target_os = "linux")]
use isocat_engine::report::interface::InterfaceReport;
use isocat_engine::verdict::Answer;
use isocat_serve::Summary;
use isocat_serve::summary::Outcome;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use crate::differences::Difference;
use crate::failure::{Failure, Target};
use crate::play::{Done, Played};
#[cfg(target_os = "linux")]
use crate::real::PlayedOnWire;
use crate::virtual_segment::VirtualSegment;

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-eni-run/3";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<Report>(FORMAT)
}

/// The whole document. All times are nanoseconds.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Report {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// The ENI.
    pub eni: String,
    /// Its bus cycle.
    pub cycle_ns: i64,
    /// The devices, by position.
    pub devices: Vec<DeviceReport>,
    /// Doubtful places in the file.
    pub doubts: Vec<Doubt>,
    /// The differences between the list and that of isocat's plan.
    pub differences: Vec<Difference>,
    /// Why there is no plan to compare with; null: there is one.
    pub not_planned: Option<String>,
    /// The result of the run; null: the list was only planned.
    pub run: Option<RunReport>,
}

/// A device.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceReport {
    /// Position.
    pub position: usize,
    /// Name in the ENI.
    pub name: String,
    /// Station address in the ENI.
    pub station: u16,
    /// The source of the virtual device, and on a real interface of its times in the plan:
    /// `segment-file`, `esi`, `built-in`, or `eni` for the ENI alone.
    pub made_of: &'static str,
    /// The source in words.
    pub origin: String,
}

/// A doubtful place in the file.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Doubt {
    /// A fixed name.
    pub kind: &'static str,
    /// Line of the file.
    pub line: usize,
    /// Description.
    pub message: String,
}

/// The result of a run.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct RunReport {
    /// Whether all devices reached OP, each working counter was as the list expects, and there is
    /// no finding against any device.
    pub in_sync: bool,
    /// Number of successful commands of the list.
    pub commands: usize,
    /// Why it ended early; null: it did not.
    pub failure: Option<FailureReport>,
    /// The values that replaced the list's placeholders, by position; null: the device has no
    /// clock.
    pub clocks: Vec<Option<ClockReport>>,
    /// Objects that the list writes and the device's description does not have; they were not
    /// written.
    pub unknown_objects: Vec<UnknownObject>,
    /// Number of cycles in OP.
    pub cycles: u64,
    /// Frames in OP that did not come back.
    pub lost_frames: u64,
    /// Datagrams in OP whose working counter was not the one that the list expects.
    pub wrong_counters: u64,
    /// What the virtual segment and its judges saw; null on a real interface.
    pub summary: Option<Summary>,
    /// What the wire showed, and the result of the verdict engine; null on a virtual segment.
    #[cfg(target_os = "linux")]
    pub interface: Option<InterfaceReport>,
}

/// Why a run ended early.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FailureReport {
    /// A fixed name.
    pub kind: &'static str,
    /// The list requires something that is not supported here, so the run says nothing about the
    /// segment.
    pub refused: bool,
    /// Position of the device whose command failed; null: the failure is about no device.
    pub position: Option<usize>,
    /// Transition of the command; null: it was between commands.
    pub transition: Option<String>,
    /// Description, with the place.
    pub message: String,
}

/// The measured values of a clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ClockReport {
    /// Propagation delay (0x0928).
    pub delay_ns: i64,
    /// Whether the receive times gave a delay; else the delay is 0.
    pub is_delay_known: bool,
    /// Magnitude of the last 0x092C while the clocks were led.
    pub difference_ns: i64,
    /// Whether 0x092C stayed within the limit of convergence.
    pub has_converged: bool,
    /// Start time (0x0990); null without SYNC.
    pub start_ns: Option<u64>,
}

/// An object that was not written.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct UnknownObject {
    /// Position of the device.
    pub position: usize,
    /// The object.
    pub object: String,
}

impl Report {
    /// The report of a list that was only planned.
    pub fn planned(
        eni: &Eni,
        segment: &VirtualSegment,
        differences: Result<Vec<Difference>, String>,
    ) -> Self {
        let devices = eni.start_up.devices.iter().zip(&segment.origins).enumerate();
        let (differences, not_planned) = match differences {
            Ok(differences) => (differences, None),
            Err(why) => (Vec::new(), Some(why)),
        };
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            eni: eni.path.clone(),
            cycle_ns: eni.start_up.cycle_ns,
            devices: devices
                .map(|(position, (device, origin))| DeviceReport {
                    position,
                    name: device.name.clone(),
                    station: device.station,
                    made_of: origin.name(),
                    origin: origin.to_string(),
                })
                .collect(),
            doubts: eni.warnings.iter().map(doubt).collect(),
            differences,
            not_planned,
            run: None,
        }
    }

    /// Whether the run was as expected by the segment file; without expectations, whether it was in
    /// sync.
    pub fn as_expected(&self) -> bool {
        self.run.as_ref().is_some_and(|run| match &run.summary {
            Some(summary) if !summary.expected.is_empty() => {
                run.failure.is_none() && summary.outcome() == Outcome::AsExpected
            }
            _ => run.in_sync,
        })
    }

    /// Adds the result of a run on a virtual segment.
    pub fn with_run(mut self, played: &Played) -> Self {
        let all_in_op = || {
            let last = played.summary.sessions.last();
            let judged = last.and_then(|session| session.judged.as_ref());
            judged.is_some_and(|judged| judged.in_op == self.devices.len())
        };
        let in_sync = played.failure.is_none()
            && played.done.counts.wrong == 0
            && played.summary.answer() == Answer::InSync
            && all_in_op();
        let summary = Some(played.summary.clone());
        self.run = Some(run_report(in_sync, played.failure.as_ref(), &played.done, summary));
        self
    }

    /// Adds the result of a run on a real interface.
    #[cfg(target_os = "linux")]
    pub fn with_wire(mut self, played: &PlayedOnWire, interface: InterfaceReport) -> Self {
        let in_sync = played.failure.is_none() && interface.in_sync;
        let failure = played.failure.as_ref();
        let run = run_report(in_sync, failure, &played.done, None);
        self.run = Some(RunReport { interface: Some(interface), ..run });
        self
    }
}

fn run_report(
    in_sync: bool,
    failure: Option<&Failure>,
    done: &Done,
    summary: Option<Summary>,
) -> RunReport {
    let clock = |(unit, start): (&Option<crate::play::Unit>, &Option<u64>)| {
        unit.map(|unit| ClockReport {
            delay_ns: unit.delay.0,
            is_delay_known: unit.is_delay_known,
            difference_ns: unit.difference.0,
            has_converged: unit.has_converged,
            start_ns: *start,
        })
    };
    let unknown = |(position, target): &(usize, Target)| UnknownObject {
        position: *position,
        object: match target {
            Target::Object(object) => object.to_string(),
            other => other.to_string(),
        },
    };
    RunReport {
        in_sync,
        commands: done.commands,
        failure: failure.map(|failure| FailureReport {
            kind: failure.kind.name(),
            refused: failure.kind.is_refused(),
            position: failure.position(),
            transition: failure.place.as_ref().map(|place| place.transition.to_string()),
            message: failure.to_string(),
        }),
        clocks: done.clocks.iter().zip(&done.starts).map(clock).collect(),
        unknown_objects: done.unknown_objects.iter().map(unknown).collect(),
        cycles: done.counts.cycles,
        lost_frames: done.counts.lost,
        wrong_counters: done.counts.wrong,
        summary,
        #[cfg(target_os = "linux")]
        interface: None,
    }
}

fn doubt(warning: &Warning) -> Doubt {
    Doubt { kind: warning.kind.name(), line: warning.line, message: warning.message.clone() }
}
