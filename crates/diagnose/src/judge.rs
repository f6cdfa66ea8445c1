//! What went wrong in a segment, by what the observer kept. What the capture does not show is not
//! judged.

use std::time::Duration;

use isocat_captures::pairing::{Seen, Tap};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, SyncType, sub};
use isocat_wire::al::AlState;
use isocat_wire::{ObjectAddress, PortNumber, register};

use crate::clock::Reference;
use crate::device::Device;
use crate::finding::{Finding, Kind};
use crate::judge::claims::Held;
use crate::known::Known;
use crate::observer::Observer;
use crate::state::{Asked, StateSeen};
use crate::talker::Talker;

pub(crate) mod claims;
pub(crate) mod cyclic;
pub(crate) mod sync;

/// All findings, gravest first, and each weight in the order of time. `rulings`: what the
/// rulebook says.
pub(crate) fn findings(observer: &Observer, tap: Tap, rulings: &[Held]) -> Vec<Finding> {
    let mut all = Vec::new();
    cyclic::judge(observer, tap.seen == Seen::Both, &mut all);
    sync::judge(observer, &mut all);
    for (place, device) in observer.devices.list.iter().enumerate() {
        // In a ring each end may be where frames enter.
        if tap.ring.is_none() {
            ports(place, device, &mut all);
        }
        states(place, device, observer, &mut all);
        counters(place, device, &mut all);
        mailbox(place, device, observer, &mut all);
        sync_counters(place, device, &mut all);
    }
    asked_down(observer, &mut all);
    talkers(observer, &mut all);
    claims::judge(observer, rulings, &mut all);
    consequences(observer.devices.at(0), &mut all);
    all.sort_by_key(|finding| {
        let place = finding.order.unwrap_or(finding.frame);
        // A device that is gone comes before the frames that were lost with it.
        let explains = match finding.kind {
            _ if finding.order.is_none() => 2,
            Kind::DevicesVanished { .. } | Kind::DeviceSilent {} | Kind::SyncPassed { .. } => 0,
            Kind::WorkingCounter { .. } => 1,
            _ => 2,
        };
        (finding.kind.weight(), place, explains, finding.kind.rank())
    });
    all
}

/// Sorts a device before the effects it caused. When a device leaves OP or is gone, working
/// counters fall and frames are lost at once, but the frame that shows the device itself comes some
/// cycles later. Frames are also lost while a device restarts, whose share of the working counters
/// is missing from then on. `first`: the device at the first position.
fn consequences(first: Option<usize>, all: &mut [Finding]) {
    let frames = |is: fn(&Kind) -> bool| -> Vec<usize> {
        all.iter().filter(|finding| is(&finding.kind)).map(|finding| finding.frame).collect()
    };
    let lost = frames(|kind| matches!(kind, Kind::FramesLost { .. }));
    let none = frames(|kind| matches!(kind, Kind::NothingCameBack { .. }));
    let fell = frames(|kind| matches!(kind, Kind::WorkingCounter { .. }));
    let unnamed = all.iter().filter(|finding| finding.device.is_none());
    let unnamed = unnamed.filter(|finding| matches!(finding.kind, Kind::WorkingCounter { .. }));
    let unnamed: Vec<usize> = unnamed.map(|finding| finding.frame).collect();
    for finding in all.iter_mut().filter(|finding| finding.device.is_some()) {
        let effects = match finding.kind {
            // Where the first device is gone, nothing comes back, and that is the cause.
            Kind::DevicesVanished { to: 1.., .. } if finding.device != first => {
                vec![&lost, &fell, &none]
            }
            Kind::LeftOp { .. } | Kind::DevicesVanished { .. } | Kind::DeviceSilent {} => {
                vec![&lost, &fell]
            }
            Kind::WorkingCounter { .. } => vec![&lost],
            // Copying came too late before the first frame lay on the other side.
            Kind::SyncPassed { .. } => vec![&fell],
            // Its state was read for the first time since OP was requested.
            Kind::AlError { .. } => vec![&unnamed],
            _ => continue,
        };
        // The last frame in which the device was in order is one of the further frames.
        let earlier = finding.frames.iter().copied().filter(|frame| *frame < finding.frame);
        let before = earlier.max().unwrap_or(0);
        let caused = effects.into_iter().flatten();
        let caused = caused.filter(|effect| (before..finding.frame).contains(effect));
        finding.order = caused.min().copied();
    }
}

fn states(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let mut was_op = false;
    // If the capture begins in operation and a working counter fell, a device with an error has
    // left OP since then.
    let fell = observer.cycle.logical.iter().filter_map(|logical| {
        let usual = logical.usual()?;
        logical.changes.kept.iter().find(|change| change.to < usual).map(|change| change.frame)
    });
    let fell = fell.min().filter(|_| observer.began_inside_once);
    let changes = &device.states.changes.kept;
    for (at, seen) in changes.iter().enumerate() {
        let asked = seen.asked.and_then(|asked| asked.value.state().ok());
        let (status, code) = (seen.status, seen.code.filter(|code| code.0 != 0));
        let in_op = status.state() == Ok(AlState::Op) && !seen.error();
        let finding = if was_op && !in_op && asked.is_none_or(|state| state == AlState::Op) {
            Some(Kind::LeftOp { to: status, code })
        } else if seen.error() && seen.asked.is_none() {
            let left = at == 0 && fell.is_some_and(|fell| fell < seen.frame);
            let kind = match left {
                true => Kind::LeftOp { to: status, code },
                false => Kind::ErrorFromBefore { status, code },
            };
            (at == 0).then_some(kind)
        } else if seen.error() {
            let later = &changes[at + 1..];
            let came_up = later.iter().any(|later| Some(later.status.0) == asked.map(|s| s as u16));
            let refuses_op = asked == Some(AlState::Op) && !came_up;
            Some(match without_data(seen, device, observer).filter(|_| refuses_op) {
                Some(for_ns) => Kind::OpWithoutData { status, code, for_ns },
                None => Kind::AlError { asked, status, code, came_up },
            })
        } else {
            None
        };
        if let Some(kind) = finding {
            let frames = seen.before.into_iter().chain(seen.asked.map(|asked| asked.frame));
            let finding = Finding::new(kind, Some(place), seen.frame).at(seen.at).with(frames);
            all.push(if seen.before.is_none() { finding.likely() } else { finding });
        }
        was_op = in_op;
    }
    stayed_below(place, device, observer, all);
}

/// For how long, ns, no process data came between the request and the error that answered it;
/// `None`: they came, or another thing than missing outputs or SYNC events is the error.
fn without_data(seen: &StateSeen, device: &Device, observer: &Observer) -> Option<u64> {
    seen.code.filter(|code| AWAITS_DATA.contains(&code.0))?;
    let asked = seen.asked?.frame;
    let asked = device.states.requests.kept.iter().rfind(|request| request.frame <= asked)?.at;
    let cycle = &observer.cycle;
    // Without any datagram in logical memory, process data may go by address.
    let rest = (cycle.last_at?, observer.last);
    let pauses = cycle.pauses.iter().copied().chain([rest]);
    let without = pauses.filter_map(|(from, to)| {
        let without = to.min(seen.at).saturating_sub(from.max(asked));
        let starts = from.saturating_sub(asked);
        (without >= PATIENCE).then_some((without, starts))
    });
    let without: Vec<_> = without.collect();
    // Several are a slow cycle, and what stops later than on the way to OP is another thing.
    let [(without, starts)] = without[..] else { return None };
    let without = Some(without).filter(|_| !device.by_address && starts <= WAY_UP)?;
    u64::try_from(without.as_nanos()).ok()
}

/// A device that was asked for OP some time before the end, was looked at since, and never was
/// there. One that shows an error is a finding already.
fn stayed_below(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let states = &device.states;
    let asks = |request: &Asked| request.control.state() == Ok(AlState::Op);
    if states.requests.left_off() > 0 {
        return;
    }
    let requests = &states.requests.kept;
    let Some(at) = requests.iter().position(asks).filter(|_| states.op.is_none()) else { return };
    // Until it was asked for something else, as on the way down.
    let first = requests[at];
    let next = requests[at..].iter().find(|request| !asks(request));
    let end = next.map_or(observer.last, |next| next.at);
    let changes = &states.changes;
    let mut after = changes.kept.iter().filter(|seen| next.is_some_and(|n| n.frame < seen.frame));
    let seen = match after.next() {
        // The last frame that showed the status before.
        Some(change) => {
            let held = changes.kept.iter().rfind(|held| held.frame < change.frame);
            // A look right behind the request says nothing.
            let late = |at: &Duration| at.saturating_sub(first.at) >= PATIENCE;
            let before = change.before.filter(|_| change.before_at.as_ref().is_some_and(late));
            held.zip(before).map(|(held, before)| (held.status, before))
        }
        None => states.last_seen(),
    };
    let seen = seen.filter(|_| changes.left_off() == 0);
    let Some((status, seen)) =
        seen.filter(|(status, seen)| !status.error() && *seen >= first.frame)
    else {
        return;
    };
    if end.saturating_sub(first.at) >= PATIENCE {
        let finding = Finding::new(Kind::StayedBelow { status }, Some(place), first.frame);
        all.push(finding.at(first.at).with([seen]));
    }
}

/// All devices that had been in OP were asked to leave it and not to come back, and process data
/// went on without them, as after a second scan by the same program.
fn asked_down(observer: &Observer, all: &mut Vec<Finding>) {
    let mut operated =
        observer.devices.list.iter().filter(|device| device.states.op.is_some()).peekable();
    if operated.peek().is_none() {
        return;
    }
    let below = |device: &Device| {
        let requests = &device.states.requests;
        let asked = requests.kept.last().filter(|_| requests.left_off() == 0)?;
        let op = |request: &Asked| request.control.state() == Ok(AlState::Op);
        // The first request below SAFEOP since it was last asked for OP: in SAFEOP inputs may still
        // be fetched. If later requests rise again, another way up has begun.
        let up = requests.kept.iter().rposition(op)?;
        // States have numbers that rise on the way up.
        let state = |request: &Asked| request.control.state().map_or(0, |state| state as u16);
        let after = &requests.kept[up + 1..];
        let is_down = after.windows(2).all(|two| state(&two[1]) <= state(&two[0]));
        let first = after.iter().find(|asked| state(asked) < AlState::SafeOp as u16);
        first.copied().filter(|_| is_down && !op(asked))
    };
    let Some(down) = operated.map(below).collect::<Option<Vec<_>>>() else { return };
    let Some(first) = down.iter().min_by_key(|asked| asked.frame) else { return };
    let last = observer.cycle.logical.iter().map(|logical| logical.last_at).max();
    let went_on = last.map_or(Duration::ZERO, |last| last.saturating_sub(first.at));
    if let (true, Ok(state)) = (went_on >= WAY_DOWN, first.control.state()) {
        let kind = Kind::AskedDown {
            state,
            for_ns: u64::try_from(went_on.as_nanos()).unwrap_or(u64::MAX),
        };
        all.push(Finding::new(kind, None, first.frame).at(first.at));
    }
}

/// A device that answers has a link. If it has none at port 0, IN and OUT are swapped.
fn ports(place: usize, device: &Device, all: &mut Vec<Finding>) {
    let Some(status) = device.image.read(register::DL_STATUS) else { return };
    let linked = PortNumber::ALL.into_iter().any(|port| status.value.link(port));
    if linked && !status.value.link(PortNumber::P0) {
        all.push(Finding::new(Kind::PortsSwapped {}, Some(place), status.frame));
    }
}

fn counters(place: usize, device: &Device, all: &mut Vec<Finding>) {
    let mut addresses: Vec<u16> =
        device.errors.grown.kept.iter().map(|grown| grown.address).collect();
    addresses.sort_unstable();
    addresses.dedup();
    for address in addresses {
        let grown = device.errors.grown.kept.iter().filter(|grown| grown.address == address);
        let grown: Vec<_> = grown.collect();
        let by = grown.iter().map(|grown| u64::from(grown.to - grown.from)).sum();
        let operating = device.states.op.is_some_and(|op| grown[0].before >= op.frame);
        let frames = grown.iter().flat_map(|grown| [grown.before, grown.frame]).take(MOST_FRAMES);
        let kind = Kind::ErrorsCounted { address, by, operating };
        all.push(Finding::new(kind, Some(place), grown[0].frame).with(frames));
    }
    if let Some((_, first)) = device.errors.before.first() {
        let count = device.errors.before.len() as u64;
        let frames = device.errors.before.iter().map(|(_, known)| known.frame).take(MOST_FRAMES);
        let kind = Kind::CountersFromBefore { count };
        all.push(Finding::new(kind, Some(place), first.frame).with(frames));
    }
    if let Some((count, frame)) = device.sii.silent() {
        all.push(Finding::new(Kind::EepromSilent { count }, Some(place), frame));
    }
    if let Some(frame) = device.sii.first_write {
        let kind = Kind::EepromWritten { count: device.sii.writes };
        all.push(Finding::new(kind, Some(place), frame));
    }
}

fn mailbox(place: usize, device: &Device, observer: &Observer, all: &mut Vec<Finding>) {
    let mailbox = &device.mailbox;
    if let Some(first) = mailbox.aborts.kept.first() {
        let kind = Kind::SdoAborted {
            object: first.object,
            code: first.code,
            written: first.way == crate::mailbox::Way::Written,
            count: mailbox.aborts.count,
        };
        let frames = mailbox.aborts.kept.iter().map(|abort| abort.frame).take(MOST_FRAMES);
        let frames = first.request.into_iter().chain(frames);
        all.push(Finding::new(kind, Some(place), first.frame).with(frames));
    }
    if let Some(first) = mailbox.unanswered.kept.first() {
        let kind = Kind::MailboxSilent { object: first.value, count: mailbox.unanswered.count };
        all.push(Finding::new(kind, Some(place), first.frame).likely());
    }
    if let Some(first) = mailbox.early.kept.first() {
        let kind = Kind::MailboxEarly { object: first.value, count: mailbox.early.count };
        all.push(Finding::new(kind, Some(place), first.frame).likely());
    }
    if let Some(stalled) = mailbox.stalled(observer.last) {
        let for_ns = u64::try_from(stalled.took.as_nanos()).unwrap_or(u64::MAX);
        let kind = Kind::MailboxStalled { object: stalled.object, for_ns };
        all.push(Finding::new(kind, Some(place), stalled.frame));
    }
    if let Some(first) = mailbox.errors.kept.first() {
        let kind = Kind::MailboxError { detail: first.value, count: mailbox.errors.count };
        all.push(Finding::new(kind, Some(place), first.frame));
    }
    if let Some(first) = mailbox.emergencies.kept.first() {
        let kind = Kind::Emergency { code: first.code, count: mailbox.emergencies.count };
        all.push(Finding::new(kind, Some(place), first.frame));
    }
}

/// The counters of 0x1C32 and 0x1C33, as they were last read.
fn sync_counters(place: usize, device: &Device, all: &mut Vec<Finding>) {
    for (index, sub) in [OUTPUT_PARAMETER, INPUT_PARAMETER].into_iter().flat_map(|index| {
        [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT]
            .map(|sub| (index, sub))
    }) {
        let object = ObjectAddress::new(index, sub);
        let known = device.mailbox.number(object).filter(|known| known.value > 0);
        if let Some(known) = known {
            let kind = Kind::SyncCounted { object, count: known.value };
            all.push(Finding::new(kind, Some(place), known.frame));
        }
    }
}

/// More than one MainDevice at a time. It is no fault if one begins after another has ended.
fn talkers(observer: &Observer, all: &mut Vec<Finding>) {
    let talkers: Vec<_> = turns(observer).collect();
    let [first, other, ..] = talkers[..] else { return };
    let kind =
        Kind::AnotherTalker { first: first.address, other: other.address, frames: other.frames };
    all.push(Finding::new(kind, None, other.first).with([other.last]));
}

/// Talkers that took turns, the one with the most frames first; and those that asked SubDevices for
/// a state while that one went on.
pub(crate) fn turns(observer: &Observer) -> impl Iterator<Item = &Talker> {
    let mut talkers: Vec<&Talker> = observer.talkers.list.iter().collect();
    talkers.sort_by_key(|talker| std::cmp::Reverse(talker.frames));
    let first = talkers.first().copied();
    let counts = move |one: &Talker| {
        first.is_some_and(|first| {
            let while_it_talks = first.first < one.first && one.last < first.last;
            first.address == one.address || one.asking > 0 && while_it_talks
        })
    };
    talkers.retain(|one| one.turns >= LEAST_TURNS || counts(one));
    talkers.into_iter()
}

/// A device's synchronization type, by 0x1C32 or, without a type there, by 0x1C33.
pub(crate) fn mode(device: &Device) -> Option<(ObjectAddress, Known<SyncType>)> {
    [OUTPUT_PARAMETER, INPUT_PARAMETER].into_iter().find_map(|index| {
        let object = ObjectAddress::new(index, sub::SYNC_TYPE);
        let known = device.mailbox.number(object)?;
        Some((object, known.map(|value| SyncType(value as u16))))
    })
}

/// The propagation delay from the reference clock to a device, ns, as the MainDevice wrote it to
/// both.
pub(crate) fn delay(observer: &Observer, device: &Device) -> Option<i64> {
    let reference = &observer.devices.list[reference(observer)?];
    if std::ptr::eq(reference, device) {
        return Some(0);
    }
    // What was not written of a delay is 0 since power-on.
    let of = |device: &Device| device.image.latest_or_zero(register::SYSTEM_TIME_DELAY);
    let first = of(reference).map_or(0, |known| known.value);
    Some(i64::from(of(device)?.value) - i64::from(first))
}

/// The place of the device whose clock leads.
pub(crate) fn reference(observer: &Observer) -> Option<usize> {
    match observer.drift.reference?.value {
        Reference::Station(station) => observer.devices.named(station),
        Reference::Position(position) => observer.devices.at(position),
    }
}

/// Time within which a device that was asked for OP must have been seen there: a program may look
/// seldom.
pub(crate) const PATIENCE: Duration = Duration::from_millis(500);
/// AL status codes of a device that missed outputs or the events with them: synchronization error,
/// watchdog, fatal synchronization error, no synchronization error.
const AWAITS_DATA: [u16; 4] = [0x001A, 0x001B, 0x002C, 0x002D];
/// Time after the request of OP in which process data stop that were to lead a device there.
const WAY_UP: Duration = Duration::from_millis(100);
/// How long process data may go on when all devices were asked to leave OP, as programs end.
const WAY_DOWN: Duration = Duration::from_secs(1);
/// How often the source of frames must change to a talker before it counts as talking at the same
/// time as another.
const LEAST_TURNS: u64 = 8;
/// Further frames that a finding names at most.
const MOST_FRAMES: usize = 8;
