//! A gate for scripts: waits until a segment has been good for long enough.
//!
//! A stretch is good while every requested SubDevice is in OP, the error of every one with SYNC is
//! within the limit at each edge or reading, no counter increases, no frame is lost, no cycle is
//! skipped, and no alarm is active. The gate opens as soon as a stretch is long enough.

use isocat_engine::status::{Device, Kind, Status};
use isocat_wire::Nanos;

/// Waits for a good stretch.
#[derive(Clone, Debug)]
pub struct Gate {
    limit: Nanos,
    hold: Nanos,
    within: Option<Nanos>,
    /// Origin of the time limit.
    origin: Option<i64>,
    /// Time up to which all statuses were seen without a gap.
    seen_to: i64,
    clean_since: Option<i64>,
    /// By position: time of the last measured error.
    measured: Vec<Option<i64>>,
    counts: Option<Counts>,
    worst: Option<(f64, i64, String)>,
    /// The last broken stretch: its length, its end, and the reason.
    broken: Option<(i64, i64, String)>,
    /// The reason why no stretch can begin at present.
    breach: String,
}

/// Counters that must not increase.
#[derive(Clone, PartialEq, Debug)]
struct Counts {
    devices: Vec<u64>,
    host: [u64; 3],
}

/// The result of the gate.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// The stretch was long enough; the text describes it.
    Opened(String),
    /// It cannot open any more; the text is the reason.
    Closed(String),
}

/// Without an edge or a reading for this time, the error is not known.
const SILENT: i64 = 1_000_000_000;

impl Gate {
    /// A gate that opens after `hold` with no error beyond `limit`, unless `within` has passed
    /// before.
    pub fn new(limit: Nanos, hold: Nanos, within: Option<Nanos>) -> Self {
        Self {
            limit,
            hold,
            within,
            origin: None,
            seen_to: 0,
            clean_since: None,
            measured: Vec::new(),
            counts: None,
            worst: None,
            broken: None,
            breach: "nothing was seen".to_owned(),
        }
    }

    /// Takes a status; `None` means that the gate waits further.
    pub fn take(&mut self, status: &Status) -> Option<Outcome> {
        let first = if status.kind == Kind::Served { status.at_ns } else { 0 };
        let origin = *self.origin.get_or_insert(first);
        if status.has_ended() {
            let why = status.failure.as_deref().unwrap_or("it ended");
            return Some(Outcome::Closed(format!("{}; {why}", self.account())));
        }
        self.note_worst(status);
        self.note_measured(status);
        let breach = self.breach(status);
        self.counts = Some(Counts::of(status));
        let gap = status.since_ns > self.seen_to;
        self.seen_to = status.at_ns;
        match breach {
            Some(what) => {
                if let Some(since) = self.clean_since.take() {
                    let at = status.at_ns;
                    self.broken = Some(((status.since_ns - since).max(0), at, what.clone()));
                }
                self.breach = what;
            }
            None => {
                let began = status.at_ns - status.operation_ns.unwrap_or(0);
                let since = status.since_ns.max(began);
                if gap && let Some(before) = self.clean_since.take() {
                    let what = "nothing was seen for a while".to_owned();
                    self.broken = Some((status.since_ns - before, status.at_ns, what));
                }
                let since = *self.clean_since.get_or_insert(since);
                // The limit is compared with the instant at which it opens, though the status may
                // be later.
                let in_time = self.within.is_none_or(|w| since + self.hold.0 - origin <= w.0);
                let long_enough = status.at_ns - since >= self.hold.0;
                if long_enough && in_time && self.all_measured(status, since) {
                    return Some(Outcome::Opened(self.praise(status)));
                }
            }
        }
        let over = self.within.filter(|within| status.at_ns - origin >= within.0)?;
        Some(Outcome::Closed(format!("{} in {over}", self.account())))
    }

    /// The state of the gate in words, if the user ends it early.
    pub fn account(&self) -> String {
        let mut text = format!("not within {} for {}", self.limit, self.hold);
        match &self.worst {
            Some((error, at, place)) => {
                text += &format!("; worst: {place} with {error:.1} ns at {}", seconds(*at));
            }
            None => text += "; no SYNC error was ever measured",
        }
        if let Some((length, at, what)) = &self.broken {
            let (length, at) = (seconds(*length), seconds(*at));
            text += &format!("; the last stretch, of {length}, was broken at {at}: {what}");
        } else if self.clean_since.is_none() {
            text += &format!("; no stretch began: {}", self.breach);
        }
        text
    }

    fn praise(&self, status: &Status) -> String {
        let all = status.devices.iter().filter(|device| device.asked && device.has_sync).count();
        let devices = if all == 1 { "1 SubDevice".to_owned() } else { format!("{all} SubDevices") };
        // The error of the reference clock is 0 by definition, so it proves nothing.
        let only = match gated(status).count() {
            0 => ", the reference clock alone",
            _ => "",
        };
        let (limit, hold) = (self.limit, self.hold);
        let source = status.kind.source();
        let at = seconds(status.at_ns);
        format!("{devices} with SYNC{only} within {limit} for {hold}, at {at} [{source}]")
    }

    fn breach(&self, status: &Status) -> Option<String> {
        if !status.in_operation() {
            return Some(format!("not in operation: {}", status.stage));
        }
        if !status.devices.iter().any(|device| device.asked && device.has_sync) {
            return Some("no SubDevice works by SYNC".to_owned());
        }
        if let Some(device) = status.devices.iter().find(|device| !device.is_in_op()) {
            return Some(format!("{} is in {}", place(device), device.state()));
        }
        if let Some(cycles) = status.host.unled_cycles {
            return Some(format!("clocks are not led for {cycles} cycles"));
        }
        for device in gated(status) {
            let recent = device.error.and_then(|error| error.recent_ns);
            if let Some(error) = recent.filter(|error| *error > self.limit.0 as f64) {
                return Some(format!("{}: SYNC error {error:.1} ns", place(device)));
            }
            if let Some(last) = self.measured.get(device.position).copied().flatten()
                && status.at_ns - last > SILENT.max(4 * status.cycle_ns)
            {
                return Some(format!(
                    "{}: nothing measured since {}",
                    place(device),
                    seconds(last)
                ));
            }
        }
        let alarmed = status.devices.iter().find(|device| !device.alarms.is_empty());
        if let Some(device) = alarmed {
            return Some(format!("{}: {}", place(device), device.alarms.join(", ")));
        }
        self.counts.as_ref().and_then(|before| before.growth(status))
    }

    fn note_worst(&mut self, status: &Status) {
        for device in gated(status) {
            let Some(error) = device.error.and_then(|error| error.recent_ns) else { continue };
            if self.worst.as_ref().is_none_or(|(worst, ..)| error > *worst) {
                self.worst = Some((error, status.at_ns, place(device)));
            }
        }
    }

    fn note_measured(&mut self, status: &Status) {
        self.measured.resize(status.devices.len(), None);
        for (device, last) in status.devices.iter().zip(&mut self.measured) {
            if device.error.is_some_and(|error| error.recent_ns.is_some()) {
                *last = Some(status.at_ns);
            }
        }
    }

    fn all_measured(&self, status: &Status, since: i64) -> bool {
        gated(status).all(|device| {
            let last = self.measured.get(device.position).copied().flatten();
            last.is_some_and(|last| last > since)
        })
    }
}

impl Counts {
    fn of(status: &Status) -> Self {
        let host = &status.host;
        Self {
            devices: status.devices.iter().map(Device::risen).collect(),
            host: [host.working_counter_errors, host.frames_lost, host.cycles_skipped],
        }
    }

    fn growth(&self, status: &Status) -> Option<String> {
        let now = Counts::of(status);
        let grown = |(device, before): (&Device, &u64)| {
            let by = device.risen().saturating_sub(*before);
            (by > 0).then(|| format!("{}: counters grew by {by}", place(device)))
        };
        let device = status.devices.iter().zip(&self.devices).find_map(grown);
        let of_host = now.host.into_iter().zip(self.host).zip(HOST);
        device.or_else(|| {
            of_host.into_iter().find_map(|((now, before), what)| {
                (now > before).then(|| format!("{} {what}", now - before))
            })
        })
    }
}

const HOST: [&str; 3] = ["wrong working counters", "frames lost", "cycles skipped"];

/// The SubDevices whose error counts. On a wire the reference clock has none: its 0x092C is
/// relative to itself.
fn gated(status: &Status) -> impl Iterator<Item = &Device> {
    let wire = status.kind == Kind::Wire;
    status.devices.iter().filter(move |d| d.asked && d.has_sync && !(wire && d.is_reference))
}

fn place(device: &Device) -> String {
    isocat_engine::status::place(device)
}

/// A time such as `12.345 s`.
fn seconds(ns: i64) -> String {
    format!("{:.3} s", ns as f64 / 1e9)
}
