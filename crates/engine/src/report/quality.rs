//! Results of the reads in the background while the segment ran, if the segment file asked for them
//! (`[quality]`).

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, cut, plain, wrap};
use isocat_maindevice::quality::{Background, ClockQuality, EntryQuality, Margin, ObjectQuality};
use isocat_maindevice::{MainDevice, QualityWatch};
use isocat_sync::object::{OUTPUT_PARAMETER, sub};
use isocat_wire::time::{Host, Nanos, Time};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use super::settling::Settling;
use super::text::{MOST_DEVICES, QUIET};

/// Results of the background reads: registers and objects were read from the SubDevices, the rest
/// was counted or measured by the MainDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Quality {
    /// Share of the wire that the reads may use, permille.
    pub share_asked_permille: u16,
    /// Share that they used, permille: the time of their frames on the wire, with each mailbox
    /// datagram counted as a separate frame.
    pub share_taken_permille: f64,
    /// Largest lateness of a frame of the cycle at the reference clock, in the moments that are
    /// kept; null without clocks.
    pub latest_frame_ns: Option<i64>,
    /// Number of cycles in which no drift frame reached all clocks, if it exceeds the limit; then
    /// the clocks have no figures, since 0x092C is meaningless.
    pub unled_cycles: Option<u64>,
    /// What was left of the clocks' phase when operation was reached, and how it went: readings of
    /// 0x092C; null without clocks.
    pub settling: Option<Settling>,
    /// Each SubDevice, by position.
    pub devices: Vec<DeviceQuality>,
    /// Alarms that were raised or cleared in the judged time.
    pub alarms: Vec<AlarmLine>,
}

/// One SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceQuality {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Name.
    pub name: String,
    /// Its clock; null without one, at the reference itself, and before the first reading.
    pub clock: Option<ClockFigures>,
    /// Time between frames and SYNC0; null without SYNC0.
    pub margin: Option<MarginFigures>,
    /// Entries of 0x1C32 and 0x1C33 that were read.
    pub entries: Vec<EntryFigures>,
    /// Mailbox services without an answer.
    pub unanswered: u32,
}

/// One clock against the reference.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ClockFigures {
    /// Number of kept readings, from which the other figures are.
    pub readings: usize,
    /// Largest absolute value of 0x092C.
    pub worst_difference_ns: i64,
    /// Largest distance of the clock from the reference's, as far as registers tell. It includes
    /// the worst difference, the movement between two readings, the ticks of both clocks and the
    /// error of the measured delay.
    pub bound_ns: i64,
    /// Slope of the last differences, ns per second.
    pub slope_ppb: i64,
    /// Mean correction of the clock's speed by the drift loop, from 0x0930 and 0x0932 (positive:
    /// faster).
    pub correction_ppm: f64,
}

/// Time left before SYNC0 once outputs are ready, from the times that the device states.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct MarginFigures {
    /// For a frame in time.
    pub planned_ns: i64,
    /// For the latest frame.
    pub least_ns: i64,
}

/// One entry of a sync object.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct EntryFigures {
    /// The entry, such as 0x1C32:0B.
    pub object: String,
    /// Its name in ETG.1020.
    pub name: String,
    /// Last value: a count, or ns for distances; null before the first reading.
    pub value: Option<u32>,
    /// Sum of a counter's increases from reading to reading.
    pub risen: u64,
}

/// An alarm that was raised or cleared.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct AlarmLine {
    /// Time from the beginning of the judged time.
    pub since_ns: i64,
    /// Position of the SubDevice.
    pub position: usize,
    /// Whether it was raised; otherwise it was cleared.
    pub raised: bool,
    /// Description, with the figures.
    pub what: String,
}

impl Quality {
    /// The MainDevice's present results; `None` if it was not asked to read, or does not run.
    pub(crate) fn new(main: &MainDevice, asked: Option<QualityWatch>) -> Option<Self> {
        let snapshot = main.snapshot()?;
        let (spent, since) = main.quality_wire_time()?;
        let elapsed = (snapshot.at - since).0.max(1);
        let segment = main.segment();
        let asked = asked?;
        let device = |(position, device): (usize, &isocat_maindevice::SubDevice)| {
            let margin = snapshot.devices.get(position).and_then(|device| device.margin);
            figures((snapshot.clocks, snapshot.objects), margin, position, device.name.clone())
        };
        Some(Self {
            share_asked_permille: asked.share_permille,
            share_taken_permille: round(spent.0 as f64 / elapsed as f64 * 1e3, 3),
            latest_frame_ns: snapshot
                .moments()
                .filter_map(|moment| moment.latest)
                .max()
                .map(|n| n.0),
            unled_cycles: snapshot.unled.filter(|cycles| *cycles >= asked.unled_cycles),
            settling: settling(snapshot.clocks, since),
            devices: segment.devices.iter().enumerate().map(device).collect(),
            alarms: Vec::new(),
        })
    }

    /// The results of another MainDevice that read in the background since `began`,
    /// for `elapsed`; it does not measure the time before SYNC0.
    pub fn of_background(
        background: &Background,
        devices: &[isocat_maindevice::SubDevice],
        asked: QualityWatch,
        (began, elapsed): (Time<Host>, Nanos),
    ) -> Self {
        let read = (background.clocks(), background.objects());
        let device = |device: &isocat_maindevice::SubDevice| {
            figures(read, None, device.position, device.name.clone())
        };
        let taken = background.spent().0 as f64 / elapsed.0.max(1) as f64;
        Self {
            share_asked_permille: asked.share_permille,
            share_taken_permille: round(taken * 1e3, 3),
            latest_frame_ns: None,
            unled_cycles: None,
            settling: settling(background.clocks(), began),
            devices: devices.iter().map(device).collect(),
            alarms: Vec::new(),
        }
    }

    /// Adds the alarms of the judged time.
    pub fn with_alarms(mut self, alarms: &[(Nanos, isocat_maindevice::quality::Change)]) -> Self {
        let line = |(since, change): &(Nanos, isocat_maindevice::quality::Change)| AlarmLine {
            since_ns: since.0,
            position: change.position,
            raised: change.raised,
            what: change.to_string(),
        };
        self.alarms = alarms.iter().map(line).collect();
        self
    }

    /// A table of the SubDevices, and the last alarms, as text without styles.
    pub fn plain(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        plain(&text)
    }

    pub(super) fn write(&self, out: &mut String) -> fmt::Result {
        let (asked, taken) = (self.share_asked_permille, self.share_taken_permille);
        let share = format!("{asked} permille of the wire asked for, {taken:.2} taken");
        writeln!(out, "\n {:<36} {share} {QUIET}[m]{QUIET:#}", "read in the background")?;
        for (what, figure) in self.settling.iter().flat_map(|all| all.lines("readings")) {
            writeln!(out, " {what:<36} {figure} {QUIET}[r]{QUIET:#}")?;
        }
        writeln!(
            out,
            " {:<2} {:<19} {:>9} {:>9} {:>12} {:>12}  0x1C32, 0x1C33 [r]",
            "#", "device", "0x092C", "bound", "0x0932", "margin [m]"
        )?;
        for device in self.devices.iter().take(MOST_DEVICES) {
            let clock = |figure: fn(&ClockFigures) -> String| {
                device.clock.as_ref().map_or_else(|| "-".to_owned(), figure)
            };
            let objects = wrap(&device.objects(), WIDTH - INDENT);
            writeln!(
                out,
                " {:<2} {:<19} {:>9} {:>9} {:>12} {:>12}  {}",
                device.position,
                cut(&device.name, 19),
                clock(|clock| format!("{} ns", clock.worst_difference_ns)),
                clock(|clock| format!("{} ns", clock.bound_ns)),
                clock(|clock| format!("{:+.2} ppm", clock.correction_ppm)),
                device.margin.map_or("-".into(), |margin| us(margin.least_ns)),
                objects[0],
            )?;
            for line in &objects[1..] {
                writeln!(out, "{:INDENT$}{line}", "")?;
            }
        }
        if self.devices.len() > MOST_DEVICES {
            let more = self.devices.len() - MOST_DEVICES;
            writeln!(out, " …  and {more} more; --json lists them all")?;
        }
        if let Some(cycles) = self.unled_cycles {
            writeln!(
                out,
                " - no drift frame reached all clocks for {cycles} cycles: 0x092C tells nothing"
            )?;
        }
        let first = self.alarms.len().saturating_sub(MOST_ALARMS);
        if first > 0 {
            writeln!(out, " - {first} alarms before these; --json lists them all")?;
        }
        for alarm in &self.alarms[first..] {
            let at = alarm.since_ns as f64 / 1e6;
            for (i, line) in wrap(&alarm.what, WIDTH - 17).iter().enumerate() {
                match i {
                    0 => writeln!(out, " - {at:>10.1} ms  {line}")?,
                    _ => writeln!(out, "{:17}{line}", "")?,
                }
            }
        }
        Ok(())
    }
}

impl DeviceQuality {
    /// The objects as text: `7 counters, none rose; SM2 to SYNC0 430.1 to 450.2 us`.
    fn objects(&self) -> String {
        let distance = |wanted| {
            let object = format!("0x{OUTPUT_PARAMETER:04X}:{wanted:02X}");
            self.entries.iter().find(|entry| entry.object == object)?.value
        };
        let is_distance =
            |entry: &&EntryFigures| DISTANCES.iter().any(|sub| entry.object.ends_with(sub));
        let counters = self.entries.iter().filter(|entry| !is_distance(entry));
        let rose: Vec<_> = counters
            .clone()
            .filter(|entry| entry.risen > 0)
            .map(|entry| format!("{} by {}", entry.object, entry.risen))
            .collect();
        let mut text = match (counters.count(), rose.is_empty()) {
            (0, _) => return "-".to_owned(),
            (count, true) => format!("{count} counters, none rose"),
            (_, false) => format!("rose: {}", rose.join(", ")),
        };
        if let (Some(least), Some(most)) =
            (distance(sub::MINIMUM_SM_SYNC_DISTANCE), distance(sub::MAXIMUM_SM_SYNC_DISTANCE))
        {
            let us = |ns: u32| f64::from(ns) / 1e3;
            text += &format!("; SM2 to SYNC0 {:.1} to {:.1} us", us(least), us(most));
        }
        text
    }
}

/// How 0x092C went, by the readings since `began`.
fn settling(clocks: &[ClockQuality], began: Time<Host>) -> Option<Settling> {
    let clocks = clocks.iter().map(|clock| (clock.position, clock.settling()));
    Settling::new(clocks, |at| at - began)
}

fn figures(
    (clocks, objects): (&[ClockQuality], &[ObjectQuality]),
    margin: Option<Margin>,
    position: usize,
    name: String,
) -> DeviceQuality {
    let clock = clocks.iter().find(|clock| clock.position == position);
    let objects = objects.get(position);
    DeviceQuality {
        position,
        name,
        clock: clock.and_then(clock_figures),
        margin: margin.map(|margin: Margin| MarginFigures {
            planned_ns: margin.planned.0,
            least_ns: margin.least.0,
        }),
        entries: objects.map_or(Vec::new(), |o| o.entries.iter().map(entry_figures).collect()),
        unanswered: objects.map_or(0, |objects| objects.unanswered),
    }
}

fn clock_figures(clock: &ClockQuality) -> Option<ClockFigures> {
    let readings = clock.readings().count();
    let corrections = clock.readings().map(|reading| reading.correction_ppb).sum::<i64>();
    Some(ClockFigures {
        readings,
        worst_difference_ns: clock.worst().0,
        bound_ns: clock.bound()?.0,
        slope_ppb: clock.slope_ppb(),
        correction_ppm: round(corrections as f64 / readings as f64 / 1e3, 3),
    })
}

fn entry_figures(entry: &EntryQuality) -> EntryFigures {
    EntryFigures {
        object: entry.object.to_string(),
        name: isocat_sync::object::name(entry.object.sub).unwrap_or_default().to_owned(),
        value: entry.last.map(|(_, value)| value),
        risen: entry.risen,
    }
}

fn us(ns: i64) -> String {
    format!("{:.3} us", ns as f64 / 1e3)
}

fn round(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (value * scale).round() / scale
}

/// Columns before the results of objects.
const INDENT: usize = 72;
/// Largest number of alarms in the text.
const MOST_ALARMS: usize = 12;
/// Entries that are no counters.
const DISTANCES: [&str; 4] = [":0F", ":10", ":11", ":12"];
