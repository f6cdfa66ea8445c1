//! Builds the document of a plan.

use isocat_maindevice::segment::{DatagramPlan, FramePlan};
use isocat_segment::Scenario;
use isocat_segment::profile::{Assumption, Profile};
use isocat_sync::SyncSignal;
use isocat_sync::budget::{
    self, Check, Demand, Origin, Quantity, Span, Sum, common_window, window,
};
use isocat_wire::datagram::Address;
use isocat_wire::time::Nanos;

use super::report::*;
use super::{Plan, warnings};
use crate::report::{OpMode, Ring};

impl Plan {
    /// The plan as a document.
    pub fn report(&self, scenario: &Scenario) -> PlanReport {
        let timing = self.timing();
        let devices = || timing.devices.iter().map(|(device, _)| device);
        let common = common_window(&timing.cycle, devices()).unwrap_or_default();
        let (tight_at, tightest) = self.tightest();
        let assumptions = self.assumptions(scenario);
        let ns = |time: Option<Nanos>| time.map(|time| time.0);
        PlanReport {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            segment_file: scenario.source.clone(),
            fits: self.fits(),
            verdict: self.verdict(scenario, tight_at, &tightest, !assumptions.is_empty()),
            assumptions,
            warnings: warnings::all(self, scenario),
            segment: Segment {
                cycle_ns: timing.cycle.cycle.0,
                ring: Ring::of(scenario),
                reference: self.segment.reference,
                send_phase_ns: timing.cycle.send.0,
                send_jitter_ns: timing.cycle.jitter.0,
                clock_error_ns: timing.cycle.clock_error.0,
                acting_phase_ns: ns(timing.sync0),
                output_reference_ns: ns(common.earliest),
                input_reference_ns: ns(common.latest),
                least_slack_ns: tightest.slack().0,
            },
            frames: timing.frames.iter().map(|frame| self.frame(frame)).collect(),
            frames_line: line(&timing.frames_in_cycle(), None),
            devices: (0..timing.devices.len()).map(|at| self.device(scenario, at)).collect(),
            suggestion: None,
            proof: None,
            what_if: None,
        }
    }

    fn verdict(
        &self,
        scenario: &Scenario,
        at: Option<usize>,
        tightest: &Demand,
        assumed: bool,
    ) -> String {
        let place = match at.and_then(|at| Some((at, scenario.devices.get(at)?))) {
            Some((at, device)) => format!("SubDevice {at} ({})", device.name),
            None => "the frames".to_owned(),
        };
        let (line, slack) = (tightest.line(), tightest.slack());
        let words = line.check.words();
        if !line.fits() {
            let more = self.demands().filter(|(_, demand)| !demand.line().fits()).count() - 1;
            let others =
                if more > 0 { format!("; {more} more lines below") } else { String::new() };
            let (needed, has) = (line.needed, line.available);
            // The sum does not tell what goes into it several times.
            let step =
                tightest.step().map_or(String::new(), |step| format!("; its step is {step}"));
            return format!(
                "Does not fit, because {place} needs {needed} and has {has}, slack {slack}: {words}{step}{others}."
            );
        }
        let how = if assumed { "Fits with assumptions" } else { "Fits" };
        format!("{how}: least slack {slack}, {place}: {words}.")
    }

    /// Figures of lines that no source states, each once per device.
    fn assumptions(&self, scenario: &Scenario) -> Vec<String> {
        let mut all: Vec<String> = Vec::new();
        let (mut of, mut first) = (0, 0);
        for (position, demand) in self.demands() {
            let Some(position) = position else { continue };
            if position != of {
                (of, first) = (position, all.len());
            }
            let device = &scenario.devices[position];
            for term in demand.needed.terms().chain(demand.available.terms()) {
                let Some(why) = assumed(&term, &device.profile) else { continue };
                let (what, value) = (term.quantity.words(), term.value);
                let text = format!("SubDevice {position} ({}): {what} {value}: {why}", device.name);
                if !all[first..].contains(&text) {
                    all.push(text);
                }
            }
        }
        all
    }

    fn frame(&self, frame: &FramePlan) -> Frame {
        Frame {
            every: frame.every,
            spread_ns: frame.spread.0,
            begin_ns: frame.begin.0,
            end_ns: frame.end.0,
            bytes: frame.length,
            datagrams: frame.datagrams.iter().map(|part| self.datagram(frame, part)).collect(),
        }
    }

    fn datagram(&self, frame: &FramePlan, part: &DatagramPlan) -> Datagram {
        // The preamble goes before the frame's bytes, the datagram's header before its data.
        let byte = isocat_wire::frame::BYTE_TIME_NS as i64;
        let first = part.offset + PREAMBLE + isocat_wire::datagram::HEADER_LEN;
        let begin = frame.begin.0 + first as i64 * byte;
        let chunk = part.chunk.and_then(|chunk| self.segment.image.chunks.get(chunk));
        Datagram {
            command: part.command.to_string(),
            address: address(part.address),
            bytes: part.length,
            begin_ns: begin,
            end_ns: begin + part.length as i64 * byte,
            devices: chunk.map(|chunk| [chunk.first, chunk.end - 1]),
        }
    }

    fn device(&self, scenario: &Scenario, position: usize) -> Device {
        let timing = self.timing();
        let (planned, found) = (&timing.devices[position].0, &self.segment.devices[position]);
        let file = &scenario.devices[position];
        let window = window(&timing.cycle, planned);
        let ns = |time: Option<Nanos>| time.map(|time| time.0);
        let dc = planned.mode.uses_dc();
        let moments = timing.moments(position).unwrap_or_default();
        let moment = |event: isocat_sync::Moment| {
            let Span { earliest, latest } = moments.of(event)?;
            Some(Moment { event, earliest_ns: earliest.0, latest_ns: latest.0, measured: None })
        };
        Device {
            position,
            name: file.name.clone(),
            profile: file.profile.id.clone(),
            description: file.notes.iter().map(Doubt::from).collect(),
            mode: planned.mode,
            op_mode: OpMode::of(file),
            mode_reason: found.mode_reason.clone(),
            delay_ns: planned.delay.0,
            every: planned.every,
            sync0_cycle_ns: dc.then_some(planned.pulses.sync0_cycle.0),
            sync0_phase_ns: ns(timing.sync0.filter(|_| dc).map(|shift| planned.sync0_phase(shift))),
            sync1_ns: planned.mode.uses_sync1().then_some(planned.pulses.sync1.0),
            acknowledge_ns: match planned.sync_signal {
                SyncSignal::Acknowledged(after) if dc => Some(after.0),
                _ => None,
            },
            earliest_phase_ns: ns(window.earliest),
            latest_phase_ns: ns(window.latest),
            moments: isocat_sync::Moment::PLANNED.into_iter().filter_map(moment).collect(),
            lines: Check::OF_DEVICE
                .into_iter()
                .filter_map(|check| {
                    let demand = timing.demand(position, check)?;
                    let sign = demand.sign(planned.mode).to_string();
                    Some(Line { sign, ..line(&demand, Some(&file.profile)) })
                })
                .collect(),
        }
    }
}

/// An address as text: `0x1001:0910`, `0x0130` for all, `0x00000000` for the process image.
fn address(address: Address) -> String {
    match address {
        Address::Position(position, register) => format!("{}:{register:04X}", position.0),
        Address::Station(station, register) => format!("0x{:04X}:{register:04X}", station.0),
        Address::Broadcast(register) => format!("0x{register:04X}"),
        Address::Logical(logical) => format!("0x{logical:08X}"),
    }
}

fn line(demand: &Demand, profile: Option<&Profile>) -> Line {
    let line = demand.line();
    let check = line.check;
    Line {
        check,
        object: check.source().map(|source| source.to_string()),
        demand: check.words(),
        needed_ns: line.needed.0,
        available_ns: line.available.0,
        slack_ns: line.slack().0,
        needed: terms(&demand.needed, profile),
        available: terms(&demand.available, profile),
        sign: demand.sign(isocat_sync::SyncMode::FreeRun).to_string(),
        measured: None,
    }
}

fn terms(sum: &Sum, profile: Option<&Profile>) -> Vec<Term> {
    sum.terms()
        .map(|term| Term {
            what: term.quantity.words(),
            value_ns: term.value.0,
            origin: origin(&term, profile),
        })
        .collect()
}

/// Origin of a figure before any measurement.
fn origin(term: &budget::Term, profile: Option<&Profile>) -> String {
    let Some(profile) = profile else { return term.origin.to_string() };
    match term.origin {
        // Cables of the file, chips and CPUs of the profile.
        Origin::Measured => Origin::Profile.to_string(),
        Origin::Assumed
            if [Quantity::PulseJitter, Quantity::OutputsSpread, Quantity::Acknowledge]
                .contains(&term.quantity) =>
        {
            Origin::Profile.to_string()
        }
        Origin::Assumed if !profile.has_mailbox() => Origin::Profile.to_string(),
        Origin::Object(object) if assumed(term, profile).is_some() => format!("{object}, assumed"),
        origin => origin.to_string(),
    }
}

/// Why a figure is assumed; `None` if a source states it, or it is a rule of the plan.
fn assumed(term: &budget::Term, profile: &Profile) -> Option<String> {
    let ours = [
        Quantity::PulseJitter,
        Quantity::OutputsSpread,
        Quantity::Acknowledge,
        Quantity::ClockSpeed,
        Quantity::Deviation,
    ];
    let ours = ours.contains(&term.quantity);
    let zero = term.value == Nanos::ZERO;
    match term.origin {
        Origin::Assumed if ours || !profile.has_mailbox() => None,
        Origin::Assumed if zero => Some("the device has no object for it".into()),
        Origin::Assumed if term.quantity == Quantity::MinimumCycle => Some(
            "the device states 0, nothing, or less than copying takes; its profile knows its CPU"
                .into(),
        ),
        Origin::Assumed => Some("the device states 0 or nothing; its profile knows its CPU".into()),
        Origin::Object(object) => {
            let of_maker = profile.assumptions.iter().find(|a| names(a, object));
            let zero = || zero.then(|| format!("{object} states 0"));
            of_maker.map(|a| format!("{object}: {}", a.why)).or_else(zero)
        }
        _ => None,
    }
}

/// Whether an assumption covers this entry: `0x1C32:06`, `0x1C32:0A-0D` or `0x1C32`.
fn names(assumption: &Assumption, object: isocat_wire::ObjectAddress) -> bool {
    let (index, subs) = match assumption.item.split_once(':') {
        Some((index, subs)) => (index, Some(subs)),
        None => (assumption.item.as_str(), None),
    };
    let index = index.strip_prefix("0x").and_then(|digits| u16::from_str_radix(digits, 16).ok());
    if index != Some(object.index) {
        return false;
    }
    let Some(subs) = subs else { return true };
    let number = |text: &str| u8::from_str_radix(text, 16).ok();
    let (first, last) = subs.split_once('-').unwrap_or((subs, subs));
    match (number(first), number(last)) {
        (Some(first), Some(last)) => (first..=last).contains(&object.sub),
        _ => false,
    }
}

/// Bytes of preamble and start delimiter.
const PREAMBLE: usize = 8;
