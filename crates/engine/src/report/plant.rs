//! Effects of late outputs on the machines behind devices.

use std::fmt::{self, Write};

use isocat_descriptions::columns::cut;
use isocat_segment::Scenario;
use isocat_sim::judge::plant::{PlantJudge, Spread};
use isocat_sim::plant::Control;
use isocat_sim::{Outcome, Tap};
use isocat_wire::time::{Nanos, Time, True};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::QUIET;

/// The machines of a run.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Plants {
    /// Each machine.
    pub each: Vec<Plant>,
    /// Difference of the least and the largest deviation of all machines at an instant, um: the
    /// distortion of a contour that they make together. Null for a single machine.
    pub apart_um: Option<Size>,
    /// Time of its largest value, from the beginning of the judged time.
    pub apart_at_ns: Option<i64>,
}

/// A machine, compared with one that gets the same commands on the grid. Distances are those of the
/// load.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Plant {
    /// Position of the SubDevice that moves it.
    pub position: usize,
    /// Its name.
    pub device: String,
    /// The commanded quantity: "position" or "torque".
    pub commands: &'static str,
    /// Number of samples of both machines; 0 if no command came in the judged time, or no clock
    /// leads.
    pub looks: u64,
    /// The constant time from a frame's due time at the reference clock until its outputs act, as
    /// used for the machine on the grid; null if it is not known.
    pub delay_ns: Option<i64>,
    /// Position of the load, less its position on the grid, um; null without samples, and if the
    /// loop is not stable.
    pub deviation_um: Option<Size>,
    /// Time of its largest value, from the beginning of the judged time.
    pub deviation_at_ns: Option<i64>,
    /// Position of the load, less the commanded position in force on the grid, um; null if torques
    /// are commanded.
    pub following_um: Option<Size>,
    /// The same for the machine on the grid.
    pub ideal_following_um: Option<Size>,
    /// Torque between motor and load, Nm.
    pub coupling_nm: Option<Size>,
    /// The same for the machine on the grid.
    pub ideal_coupling_nm: Option<Size>,
    /// The difference of both, which is the ripple due to lateness, Nm.
    pub ripple_nm: Option<Size>,
}

/// Size of a figure that varies.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Size {
    /// Largest value without its sign.
    pub largest: f64,
    /// Root of the mean square.
    pub rms: f64,
}

impl Plants {
    /// The machines of a run; `None` if there are none.
    pub(super) fn new<T: Tap>(scenario: &Scenario, outcome: &Outcome<T>) -> Option<Self> {
        if scenario.plants.is_empty() {
            return None;
        }
        let zero = outcome.began.unwrap_or(Time::ZERO);
        let judges = outcome.plants.as_ref().map(|plants| plants.judges()).unwrap_or_default();
        let each = scenario.plants.iter().map(|setup| {
            let judge = judges.iter().find(|judge| judge.setup() == setup);
            let unseen = PlantJudge::new(*setup, scenario.cycle.into());
            plant(scenario, judge.unwrap_or(&unseen), zero)
        });
        let apart = outcome.plants.as_ref().map(|plants| *plants.apart()).unwrap_or_default();
        let apart_um = size(&apart.distance, NANOMETRES);
        let apart_at_ns = apart_um.map(|_| since(apart.worst_at, zero));
        Some(Self { each: each.collect(), apart_um, apart_at_ns })
    }

    pub(super) fn write(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\n{:32}{:^17} {:^21} {:^15} {:^10}",
            "Machines [t]", "deviation, um", "following, um", "coupling, Nm", "ripple, Nm"
        )?;
        writeln!(
            out,
            " {:<2} {:<19} {:<8} {:>8} {:>8} {:>10} {:>10} {:>7} {:>7} {:>10}",
            "#",
            "device",
            "command",
            "largest",
            "rms",
            "largest",
            "on grid",
            "largest",
            "on grid",
            "largest"
        )?;
        for plant in &self.each {
            let [largest, rms] = [|size: Size| size.largest, |size: Size| size.rms];
            writeln!(
                out,
                " {:<2} {:<19} {:<8} {:>8} {:>8} {:>10} {:>10} {:>7} {:>7} {:>10}",
                plant.position,
                cut(&plant.device, 19),
                plant.commands,
                figure(plant.deviation_um.map(largest)),
                figure(plant.deviation_um.map(rms)),
                figure(plant.following_um.map(largest)),
                figure(plant.ideal_following_um.map(largest)),
                figure(plant.coupling_nm.map(largest)),
                figure(plant.ideal_coupling_nm.map(largest)),
                figure(plant.ripple_nm.map(largest)),
            )?;
        }
        if let (Some(apart), Some(at)) = (self.apart_um, self.apart_at_ns) {
            let (largest, at) = (figure(Some(apart.largest)), Nanos(at / 1_000 * 1_000));
            writeln!(out, " deviations of axes: {largest} um apart at most, {at} into the run")?;
        }
        writeln!(
            out,
            "{QUIET} deviation: from where the load would be if the same commands had acted on the grid{QUIET:#}"
        )
    }
}

fn plant(scenario: &Scenario, judge: &PlantJudge, zero: Time<True>) -> Plant {
    let (setup, figures) = (judge.setup(), judge.figures());
    let deviation_um = size(&figures.deviation, NANOMETRES);
    Plant {
        position: setup.device,
        device: scenario.devices[setup.device].name.clone(),
        commands: match setup.control {
            Control::Position { .. } => "position",
            Control::Torque { .. } => "torque",
        },
        looks: figures.looks,
        delay_ns: judge.delay().map(|delay| delay.0 / 1_000),
        deviation_um,
        deviation_at_ns: deviation_um.map(|_| since(figures.worst_at, zero)),
        following_um: size(&figures.following, NANOMETRES),
        ideal_following_um: size(&figures.ideal_following, NANOMETRES),
        coupling_nm: size(&figures.coupling, MICRONEWTONMETRES),
        ideal_coupling_nm: size(&figures.ideal_coupling, MICRONEWTONMETRES),
        ripple_nm: size(&figures.ripple, MICRONEWTONMETRES),
    }
}

fn since(at: Time<True>, zero: Time<True>) -> i64 {
    (at - zero).0 / 1_000
}

/// Fractions of 1 um and of 1 Nm to which figures are rounded.
const NANOMETRES: f64 = 1e3;
const MICRONEWTONMETRES: f64 = 1e6;

/// The size of a spread; `None` if it is empty or not finite.
fn size(spread: &Spread, parts: f64) -> Option<Size> {
    let (largest, rms) = (spread.largest, spread.rms());
    let round = |value: f64| (value * parts).round() / parts;
    (spread.count() > 0 && largest.is_finite() && rms.is_finite())
        .then(|| Size { largest: round(largest), rms: round(rms) })
}

/// A figure to three digits or more.
fn figure(value: Option<f64>) -> String {
    match value {
        None => "-".into(),
        Some(value) if value >= 1e6 => format!("{value:.1e}"),
        Some(value) if value >= 100.0 => format!("{value:.0}"),
        Some(value) if value >= 10.0 => format!("{value:.1}"),
        Some(value) if value >= 1.0 => format!("{value:.2}"),
        Some(value) => format!("{value:.3}"),
    }
}
