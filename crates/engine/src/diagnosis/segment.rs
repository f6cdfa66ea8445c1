//! Causes and remedies of what concerns the whole segment.

use isocat_maindevice::{Segment, SegmentChange};
use isocat_sim::{Judged, Kind};
use isocat_wire::PortNumber;

use super::Diagnosis;
use crate::Report;
use crate::report::Finding;

/// Why a finding of the segment came, and what to do.
pub(super) fn of(finding: &Finding, report: &Report, segment: &Segment) -> Diagnosis {
    let (causes, remedies) = match &finding.kind {
        Kind::Judged(Judged::NothingCameBack { .. }) => silence(report, segment),
        Kind::Judged(Judged::WorkingCounter { .. }) => working_counter(report),
        Kind::Change(SegmentChange::RingCut { primary, secondary, .. }) => {
            ring_cut(report, *primary, *secondary)
        }
        kind => always(kind),
    };
    Diagnosis {
        position: None,
        who: "The segment".into(),
        what: finding.what.clone(),
        causes,
        remedies,
    }
}

/// What is the same in every run.
fn always(kind: &Kind) -> (Vec<String>, Vec<String>) {
    let (causes, remedies): (&[&str], &[&str]) = match kind {
        Kind::Judged(Judged::CyclesSkipped { .. }) => (
            &["The machine that the MainDevice runs on came later than a whole cycle."],
            &["isocat run --preflight tells what on a machine harms punctuality", "a longer cycle"],
        ),
        Kind::Judged(Judged::FramesLost { .. }) => (
            &["Frames were lost on the wire: a bad cable or connector, a SubDevice without power."],
            &[
                "isocat scan counts errors at each port (0x0300 on): the first port that counts is next to the fault",
            ],
        ),
        Kind::Judged(Judged::AnswersLate { .. }) => (
            &[
                "The segment answered, and the answers reached the MainDevice too late: a network card that gathers \
                 frames before it tells them (coalescing), a USB adapter, power saving, or a driver.",
            ],
            &[
                "ethtool -C INTERFACE rx-usecs 0, and no adapter between",
                "isocat run --preflight tells what on a machine harms punctuality",
                "a longer cycle",
            ],
        ),
        _ => (&[], &[]),
    };
    let owned = |all: &[&str]| all.iter().map(|one| (*one).to_owned()).collect();
    (owned(causes), owned(remedies))
}

fn working_counter(report: &Report) -> (Vec<String>, Vec<String>) {
    let first = report.findings.iter().find_map(|finding| finding.position);
    let remedy = match first {
        Some(position) => {
            format!("see what is told of {}, the first one with a finding", named(report, position))
        }
        None => "look for a SubDevice in this report that left OP first".to_owned(),
    };
    let cause = "A SubDevice did not take or give its process data: it left SAFEOP or OP, or was not reached.";
    (vec![cause.to_owned()], vec![remedy])
}

/// A ring goes on when it is cut: where the cable is, and that nothing else is harmed.
fn ring_cut(
    report: &Report,
    primary: Option<usize>,
    secondary: Option<usize>,
) -> (Vec<String>, Vec<String>) {
    let end = |position: Option<usize>, port: &str| match position {
        Some(position) => named(report, position),
        None => format!("the MainDevice's {port} port"),
    };
    let (from, to) = (end(primary, "primary"), end(secondary, "secondary"));
    let cause = format!(
        "The ring is open between {from} and {to}: frames turn there and reach each SubDevice from one of its two ends. Only the \
         redundancy is gone; another cut would take SubDevices away."
    );
    let remedies = [
        format!("Look at the cable between {from} and {to}, and at its connectors."),
        "Bring the ring back before the next cable fails: it is whole again as soon as frames pass there.".to_owned(),
    ];
    (vec![cause], remedies.into())
}

/// Nothing came back: where frames still went, as far as SubDevices show it by their pulses.
fn silence(report: &Report, segment: &Segment) -> (Vec<String>, Vec<String>) {
    let rescue = "isocat scan --interface IF --rescue finds the place port by port: it closes ports until frames come back, and names \
                  the one behind which the line is dead"
        .to_owned();
    let Some((before, port, behind)) = dead_behind(report, segment) else {
        let cause = "Nothing came back at all: the first cable, the MainDevice's port, or the power of the first SubDevice. Or one way \
                     of a cable further on, whose ends kept their links: then frames are lost behind it.";
        let look = "look whether the MainDevice's port has a link, and the lamp at the first SubDevice's port IN";
        return (vec![cause.to_owned()], vec![look.to_owned(), rescue]);
    };
    let (from, to) = (named(report, before), named(report, behind));
    let cause = format!(
        "Nothing came back at all, and the line is dead behind {from}: {from} still had its outputs, {to} had none any more. Port {port} \
         of SubDevice {before} sends frames on, and gets none back."
    );
    let look = format!(
        "look at the cable from port {port} of {from} to {to}, at its connectors and at the ports at both of its ends: one way of it is \
         dead, although its links may be up"
    );
    (vec![cause], vec![look, rescue])
}

/// The SubDevice and its port behind which outputs no longer arrived, and the first SubDevice
/// there. `None` where pulses don't show it: each SubDevice behind must have missed its outputs,
/// and none before it, of which the next one must be able to miss some.
fn dead_behind(report: &Report, segment: &Segment) -> Option<(usize, PortNumber, usize)> {
    let missed = |position: usize| {
        let kind = |kind: &Kind| matches!(kind, Kind::Judged(Judged::MissedEvents { .. }));
        let mut own = report.findings.iter().filter(|found| found.position == Some(position));
        own.any(|finding| kind(&finding.kind))
    };
    let misses = |position: usize| {
        let device = &segment.devices[position];
        device.mode.uses_dc() && device.outputs.length > 0
    };
    let all = 0..segment.devices.len();
    let first = all.clone().find(|position| missed(*position))?;
    let (before, port) = segment.devices[first].parent?;
    let is_behind = |position: usize| {
        let mut at = Some(position);
        while let Some(now) = at.filter(|now| *now != first) {
            at = segment.devices[now].parent.map(|(parent, _)| parent);
        }
        at.is_some()
    };
    let fits = |position: usize| !misses(position) || missed(position) == is_behind(position);
    (misses(before) && all.into_iter().all(fits)).then_some((before, port, first))
}

fn named(report: &Report, position: usize) -> String {
    match report.devices.get(position) {
        Some(device) => format!("SubDevice {position} ({})", device.name),
        None => format!("SubDevice {position}"),
    }
}
