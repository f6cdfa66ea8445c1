//! The cyclic exchange: frames that were lost, working counters that fell, cycles without a frame.

use isocat_wire::fmmu::Fmmu;
use isocat_wire::{Command, register};

use super::MOST_FRAMES;
use crate::cycle::{Logical, Rhythm, SILENT};
use crate::device::{Device, Silence};
use crate::finding::{Finding, Kind, Which};
use crate::observer::Observer;
use crate::phase::Measured;

pub(super) fn judge(observer: &Observer, both_ways: bool, all: &mut Vec<Finding>) {
    for logical in &observer.cycle.logical {
        working_counter(logical, observer, all);
    }
    if both_ways {
        stopped(observer, all);
        lost(observer, all);
        silent(observer, all);
        late(observer, all);
    }
    doubled(observer, all);
    skipped(observer, both_ways, all);
    vanished(observer, all);
}

/// Finds frames that pass fewer devices than before, with the devices that do not answer from then
/// on; and devices that do not answer where no frame counts SubDevices.
fn vanished(observer: &Observer, all: &mut Vec<Finding>) {
    let changes = &observer.reach.kept;
    let mut told = Vec::new();
    for (place, reach) in changes.iter().enumerate() {
        let Some(from) = reach.from.filter(|from| reach.operating && reach.to < *from) else {
            continue;
        };
        let again = changes[place + 1..].iter().find(|later| later.to > reach.to);
        let span = reach.frame..again.map_or(usize::MAX, |again| again.frame);
        let silent: Vec<(usize, usize)> = silences(observer)
            .filter(|(_, silence)| span.contains(&silence.frame))
            .map(|(device, silence)| (device, silence.frame))
            .collect();
        let devices: Vec<usize> = silent.iter().map(|(device, _)| *device).collect();
        let first = devices.first().copied();
        let kind = Kind::DevicesVanished { from, to: reach.to, silent: devices };
        let frames = silent.iter().map(|(_, frame)| *frame).take(MOST_FRAMES);
        let finding = Finding::new(kind, first, reach.frame).at(reach.at).with(frames);
        let finding = finding.with([reach.before]);
        // Without positions the order is only known from the stations.
        let placed = first.is_none_or(|first| observer.devices.list[first].position.is_some());
        all.push(if placed { finding } else { finding.likely() });
        told.extend(silent);
    }
    let mut silent: Vec<(usize, Silence)> = silences(observer)
        .filter(|(device, silence)| {
            let op = observer.devices.list[*device].states.op;
            op.is_some_and(|op| op.frame < silence.frame)
                && !told.contains(&(*device, silence.frame))
        })
        .collect();
    // A device that comes back and is gone again is reported once.
    silent.dedup_by_key(|(device, _)| *device);
    for (device, silence) in silent {
        let finding = Finding::new(Kind::DeviceSilent {}, Some(device), silence.frame);
        all.push(finding.at(silence.at).with([silence.before]));
    }
}

/// Each time a device stopped answering, sorted by position, or by station where positions are not
/// known.
fn silences(observer: &Observer) -> impl Iterator<Item = (usize, Silence)> + '_ {
    let mut order: Vec<usize> = (0..observer.devices.list.len()).collect();
    order.sort_by_key(|place| {
        let device = &observer.devices.list[*place];
        (device.position, device.station.map(|station| station.value))
    });
    order.into_iter().flat_map(|place| {
        let silences = observer.devices.list[place].silences.kept.iter();
        silences.map(move |silence| (place, *silence))
    })
}

fn working_counter(logical: &Logical, observer: &Observer, all: &mut Vec<Finding>) {
    let Some(usual) = logical.usual() else { return };
    let lower = || logical.counts.range(..usual);
    let Some(lowest) = lower().next().map(|(count, _)| *count) else { return };
    let frames = lower().map(|(_, times)| times).sum();
    let mut falls = logical.changes.kept.iter().filter(|change| change.to < usual);
    let Some(first) = falls.next() else { return };
    let which = Which { command: logical.command, address: logical.address };
    // If all clocks are still counted, no device is gone: some devices no longer take outputs.
    let missing = match observer.drift.fewer(first.frame) {
        Some(false) if logical.command == Command::Lrw => Vec::new(),
        _ => missing(logical, usual, first.to, observer),
    };
    // After a cable break or a loss of power, all devices behind the first one are missing too.
    let device = missing.iter().copied().min_by_key(|place| observer.devices.list[*place].position);
    let kind = Kind::WorkingCounter { which, usual, lowest, frames, missing };
    let more = falls.map(|change| change.frame).take(MOST_FRAMES);
    let finding = Finding::new(kind, device, first.frame).at(first.at);
    all.push(finding.with([first.before]).with(more));
}

/// The devices whose share is exactly what is missing, if all shares are known and add up to the
/// usual working counter.
fn missing(logical: &Logical, usual: u16, found: u16, observer: &Observer) -> Vec<usize> {
    let shares: Vec<(usize, u16)> = observer
        .devices
        .list
        .iter()
        .enumerate()
        .map(|(place, device)| (place, share(logical, device)))
        .filter(|(_, share)| *share > 0)
        .collect();
    if shares.iter().map(|(_, share)| share).sum::<u16>() != usual {
        return Vec::new();
    }
    let missing = usual - found;
    // Either all devices from one on are missing, or one device alone.
    let mut sum = 0;
    let behind = shares.iter().rev().take_while(|(_, share)| {
        let more = sum < missing;
        sum += if more { share } else { &0 };
        more
    });
    let behind: Vec<usize> = behind.map(|(place, _)| *place).collect();
    let alone: Vec<usize> =
        shares.iter().filter(|(_, share)| *share == missing).map(|(place, _)| *place).collect();
    match (alone.len(), sum == missing && behind.len() > 1) {
        (0, true) => behind,
        (1, false) => alone,
        (0, false) => Vec::new(),
        // More than one explanation fits: none is given.
        _ => Vec::new(),
    }
}

/// What a device adds to the working counter of a logical datagram, by the FMMUs that the capture
/// shows.
pub(crate) fn share(logical: &Logical, device: &Device) -> u16 {
    let window = u64::from(logical.address)..u64::from(logical.address) + u64::from(logical.len);
    let mut kinds = 0;
    for number in 0..16 {
        let Some(fmmu) = device.image.latest(register::fmmu(number)) else { continue };
        let fmmu = fmmu.value;
        let start = u64::from(fmmu.logical_start);
        let end = start + u64::from(fmmu.length);
        if fmmu.is_active() && start < window.end && window.start < end {
            kinds |= fmmu.kind;
        }
    }
    let reads = u16::from(kinds & Fmmu::READ != 0);
    let writes = u16::from(kinds & Fmmu::WRITE != 0);
    match logical.command {
        Command::Lrd => reads,
        Command::Lwr => writes,
        _ => reads + 2 * writes,
    }
}

/// Frames that did not come back one by one: not in an outage, and not at the end.
fn single(observer: &Observer) -> u64 {
    let cycle = &observer.cycle;
    let silent = cycle.silence.map_or(0, |(_, frames)| frames);
    cycle.unanswered.saturating_sub(cycle.outage_frames + silent)
}

/// Whether outages took most of the frames that did not come back: single losses may lie in a row
/// by chance.
fn has_outages(observer: &Observer) -> bool {
    observer.cycle.outage_frames > single(observer)
}

/// Finds stretches in which nothing came back, though it did before and behind.
fn stopped(observer: &Observer, all: &mut Vec<Finding>) {
    let cycle = &observer.cycle;
    let Some(longest) = cycle.longest_outage.filter(|_| has_outages(observer)) else { return };
    let first = cycle.outages.first().unwrap_or(&longest).since;
    let for_ns = u64::try_from(longest.lasted.as_nanos()).unwrap_or(u64::MAX);
    let (times, frames) = (cycle.outage_times, longest.frames);
    let kind = Kind::NothingCameBack { times, frames, for_ns };
    let more = cycle.outages.iter().flat_map(|outage| [outage.since.frame, outage.last]);
    let more = more.filter(|frame| *frame != first.frame).take(MOST_FRAMES);
    all.push(Finding::new(kind, None, first.frame).at(first.value).with(more));
}

/// Finds cyclic frames without an answer: with process data or the reference's time. Frames of an
/// outage are another finding, and frames after the last answer do not count: theirs may come after
/// the end of the capture.
fn lost(observer: &Observer, all: &mut Vec<Finding>) {
    let outages = if has_outages(observer) { &observer.cycle.outages[..] } else { &[] };
    let outage =
        |frame: usize| outages.iter().any(|one| (one.since.frame..=one.last).contains(&frame));
    let mut frames: Vec<_> = observer
        .cycle
        .logical
        .iter()
        .flat_map(|logical| &logical.lost.kept)
        .chain(&observer.drift_lost.kept)
        .filter(|lost| lost.frame < observer.cycle.last_answered && !outage(lost.frame))
        .map(|lost| (lost.frame, lost.value))
        .collect();
    frames.sort_unstable();
    frames.dedup();
    let Some((first, at)) = frames.first().copied() else { return };
    let logs = observer.cycle.logical.iter().map(|logical| &logical.lost);
    let left_off = logs.chain([&observer.drift_lost]).any(|log| log.left_off() > 0);
    // Where they are no outages, frames in a row are lost one by one, too.
    let (times, in_row) = match has_outages(observer) {
        true => (observer.cycle.outage_times, 0),
        false => (0, observer.cycle.outage_frames),
    };
    let count = match left_off || outages.len() as u64 != times {
        true => single(observer) + in_row,
        false => frames.len() as u64,
    };
    if count == 0 {
        return;
    }
    let kind = Kind::FramesLost { count };
    let more = frames.iter().map(|(frame, _)| *frame).take(MOST_FRAMES);
    all.push(Finding::new(kind, None, first).at(at).with(more).likely());
}

/// Finds answers that came when the next cycle had begun. What each answer takes is the segment's,
/// and a MainDevice may have cycles that are shorter than that: half a cycle more is not.
fn late(observer: &Observer, all: &mut Vec<Finding>) {
    let cycle = &observer.cycle;
    let (Some(cycle_ns), Some(least)) = (cycle.rhythm.median(), cycle.round_trip.shortest()) else {
        return;
    };
    let most = least.value.saturating_add(cycle_ns / 2);
    let late = cycle.overtaken.longest.iter().filter(|one| one.ns > most);
    let Some(first) = late.clone().min_by_key(|one| one.frame) else { return };
    let count = cycle.overtaken.longer_than(most).max(1);
    let longest_ns = late.clone().map(|one| one.ns).max().unwrap_or(first.ns);
    let kind = Kind::AnswersLate { count, longest_ns, cycle_ns };
    let more = late.map(|one| one.frame).take(MOST_FRAMES);
    all.push(Finding::new(kind, None, first.frame).at(first.at).with(more));
}

/// Finds frames that did not come back any more, to the end of the capture. The last ones may only
/// be under way.
fn silent(observer: &Observer, all: &mut Vec<Finding>) {
    let Some((since, frames)) = observer.cycle.silence else { return };
    let span = observer.last.saturating_sub(since.value);
    if frames < SILENT || span.as_nanos() < u128::from(UNDER_WAY_NS) {
        return;
    }
    let for_ns = u64::try_from(span.as_nanos()).unwrap_or(u64::MAX);
    let kind = Kind::SilentToTheEnd { frames, for_ns };
    let finding = Finding::new(kind, None, since.frame).at(since.value);
    all.push(finding.with([observer.cycle.last_answered].into_iter().filter(|frame| *frame > 0)));
}

fn doubled(observer: &Observer, all: &mut Vec<Finding>) {
    let Some(first) = observer.doubled.kept.first() else { return };
    let kind = Kind::FramesDoubled { count: observer.doubled.count };
    let more = observer.doubled.kept.iter().map(|known| known.frame).take(MOST_FRAMES);
    all.push(Finding::new(kind, None, first.frame).at(first.value).with(more).likely());
}

/// Finds intervals that are too long by half a cycle or more, in the time of the reference clock if
/// that is known.
fn skipped(observer: &Observer, both_ways: bool, all: &mut Vec<Finding>) {
    let cycle = &observer.cycle;
    let by_clock = cycle.by_clock.count >= LEAST;
    let rhythm = if by_clock { &cycle.by_clock } else { &cycle.rhythm };
    let Some(cycle_ns) = rhythm.median().filter(|_| rhythm.count >= LEAST) else { return };
    let limit = cycle_ns + cycle_ns / 2;
    let mut gaps: Vec<_> = rhythm.longest.iter().filter(|gap| gap.ns > limit).collect();
    gaps.sort_by_key(|gap| gap.frame);
    let Some(first) = gaps.first() else { return left_out(observer, both_ways, all) };
    let longest_ns = rhythm.longest.first().map_or(0, |gap| gap.ns);
    let count = count_of(rhythm, limit, gaps.len());
    let kind = match by_clock {
        true if both_ways => Kind::CyclesSkipped { count, longest_ns, cycle_ns },
        true => Kind::CyclesMissing { count, longest_ns, cycle_ns },
        false => Kind::GapSeen { count, longest_ns, cycle_ns },
    };
    let more = gaps.iter().map(|gap| gap.frame).take(MOST_FRAMES);
    all.push(Finding::new(kind, None, first.frame).at(first.at).with(more));
}

/// Finds devices whose own frames were not sent at times, while those that begin a cycle were. Lost
/// ones are a finding already.
fn left_out(observer: &Observer, both_ways: bool, all: &mut Vec<Finding>) {
    let lost = |kind: &Kind| matches!(kind, Kind::FramesLost { .. } | Kind::NothingCameBack { .. });
    if all.iter().any(|found| lost(&found.kind)) {
        return;
    }
    for place in 0..observer.devices.list.len() {
        let Some((Measured { distance, .. }, _)) = observer.distance(place) else { continue };
        let (count, longest_ns) = (distance.missing, distance.gap.value);
        if count > 0 {
            let cycle_ns = distance.interval();
            let kind = match both_ways {
                true => Kind::CyclesSkipped { count, longest_ns, cycle_ns },
                false => Kind::CyclesMissing { count, longest_ns, cycle_ns },
            };
            all.push(Finding::new(kind, Some(place), distance.gap.frame).likely());
        }
    }
}

/// The number of intervals above `limit`. If all of the kept ones are above it, there may be more,
/// which are counted to three digits.
fn count_of(rhythm: &Rhythm, limit: u64, kept: usize) -> u64 {
    match kept == rhythm.longest.len() {
        true => rhythm.longer_than(limit).max(kept as u64),
        false => kept as u64,
    }
}

/// Time for which frames may be under way, ns.
const UNDER_WAY_NS: u64 = 1_000_000;
/// Intervals below which the cycle is not known.
const LEAST: u64 = 20;
