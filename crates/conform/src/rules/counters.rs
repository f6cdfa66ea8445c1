//! CNT: the counters count what they are for, and nothing else.

use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, AlStatusCode, ObjectAddress};

use super::{Check, Rule, times};
use crate::case::{Case, Done, STATE_PATIENCE, Stop, not_applicable};
use crate::subject::{SyncObject, refused};
use crate::tester::Turn;

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "CNT-01",
        what: "0B counts outputs that stay away, by one of the three known ways of counting",
        source: "ETG.1020 0x1C32:0B",
        applies: "DC SYNC0, devices with 0B and outputs",
        check: Check::EachMode(missed),
    },
    Rule {
        id: "CNT-02",
        what: "as many missing outputs in a row as the limit allows keep OP, one more ends it",
        source: "ETG.1020 0x1C32:0B, 0x10F1:02",
        applies: "DC SYNC0, devices with 0x10F1:02 and outputs",
        check: Check::EachMode(limit),
    },
    Rule {
        id: "CNT-03",
        what: "0C counts an event that comes while the last is still in work, once",
        source: "ETG.1020 0x1C32:0C",
        applies: "modes with SM2, devices with 0C that need longer than a frame",
        check: Check::EachMode(too_small),
    },
    Rule {
        id: "CNT-04",
        what: "0D counts cycles whose shift is below the delay, and none at the delay",
        source: "ETG.1020 0x1C32:0D, 0x1C32:03, 0x1C32:09",
        applies: "DC SYNC0, devices with shift by local timer",
        check: Check::EachMode(too_short),
    },
    Rule {
        id: "CNT-05",
        what: "20 shows an error while 0C tells one",
        source: "ETG.1020 0x1C32:20",
        applies: "as CNT-03, devices with 20, once 0C counts",
        check: Check::EachMode(sync_error),
    },
    Rule {
        id: "CNT-06",
        what: "08 bit 1 clears 0B, 0C, 0D and 20",
        source: "ETG.1020 0x1C32:08",
        applies: "as CNT-03, devices with 08",
        check: Check::EachMode(reset),
    },
    Rule {
        id: "CNT-07",
        what: "with outputs, 0x1C33 counts as 0x1C32 does",
        source: "ETG.1020 0x1C33:0B-0D, 0x1C33:20",
        applies: "as CNT-03, devices with counters in both",
        check: Check::EachMode(mirrored),
    },
    Rule {
        id: "CNT-08",
        what: "the counters are cleared on the way back to PREOP, and at the next SAFEOP",
        source: "ETG.1020 0x1C32:0B-0D",
        applies: "as CNT-03",
        check: Check::EachMode(cleared),
    },
    Rule {
        id: "CNT-09",
        what: "0F to 12 have the distances of the frames from each other and from SYNC0",
        source: "ETG.1020 0x1C32:0F-12",
        applies: "devices with 0x1C32:0F and 10, in modes with frames as events",
        check: Check::EachMode(distances),
    },
];

/// A way to count missing outputs. Its input tells for each cycle whether outputs came before
/// SYNC0.
#[derive(Clone, Copy)]
struct Way {
    name: &'static str,
    /// The counter's value after a sequence of cycles that follows a long clean run.
    count: fn(&[bool]) -> i64,
    /// How many missing outputs in a row end OP, for a limit.
    ends: fn(u64) -> u64,
}

const WAYS: [Way; 3] = [
    Way {
        name: "three more for each that is missing, one less for each that came",
        count: |came| {
            came.iter().fold(0, |n: i64, came| if *came { (n - 1).max(0) } else { n + 3 })
        },
        ends: |limit| limit / 3 + 1,
    },
    Way {
        name: "the same, but the first that is missing is let pass",
        count: |came| {
            let mut row = 0;
            came.iter().fold(0, |n: i64, came| {
                row = if *came { 0 } else { row + 1 };
                match (came, row) {
                    (true, _) => (n - 1).max(0),
                    (false, 1) => n,
                    (false, _) => n + 3,
                }
            })
        },
        ends: |limit| limit.max(1).div_ceil(3) + 1,
    },
    Way {
        name: "one for each that is missing, less what comes in excess",
        count: |came| came.iter().filter(|came| !**came).count() as i64,
        ends: |limit| limit + 1,
    },
];

/// The object whose counters are looked at, if it has this counter.
fn with(c: &Case<'_, '_>, sub: u8) -> Result<SyncObject, Stop> {
    let object = c.leading()?;
    match object.entry(sub) {
        Some(_) => Ok(object.clone()),
        None => Err(not_applicable(format!("it has no {}", object.at(sub)))),
    }
}

fn dc_with_outputs(c: &Case<'_, '_>) -> Done {
    match (c.mode.is_sync0(), c.s.outputs.len) {
        (false, _) => Err(not_applicable("only DC SYNC0")),
        (_, 0) => Err(not_applicable("it has no outputs")),
        _ => Ok(()),
    }
}

/// Leaves frames out, and returns after the SubDevice has certainly missed the last of them.
fn leave_out(c: &mut Case<'_, '_>, frames: u64) -> Result<(), Stop> {
    for _ in 0..frames {
        c.t.turn(Turn::Skip)?;
    }
    let cycle = c.cycle();
    let behind = c.lead(cycle) + Nanos::micros(20) + c.t.lateness();
    c.t.silence(behind)?;
    Ok(())
}

/// The value of 0B after `n` frames were left out, and the number of cycles with frames until it
/// was read.
fn count_missed(c: &mut Case<'_, '_>, object: &SyncObject, n: u64) -> Result<(u64, u64), Stop> {
    leave_out(c, n)?;
    let from = c.t.exchange.as_ref().map_or(0, |exchange| exchange.cycles);
    let count = c.t.value(object.at(sub::SM_EVENT_MISSED))?.unwrap_or(0);
    let to = c.t.exchange.as_ref().map_or(0, |exchange| exchange.cycles);
    Ok((count, to - from))
}

fn in_op(c: &mut Case<'_, '_>) -> Result<bool, Stop> {
    Ok(c.t.al()?.is(AlState::Op))
}

/// Finds the way of counting: reads 0B after one missing frame, and after two in a row.
fn way(c: &mut Case<'_, '_>, object: &SyncObject) -> Result<Option<Way>, Stop> {
    c.op_here()?;
    c.t.run(20)?;
    let mut seen = Vec::new();
    for n in [1, 2] {
        let (count, good) = count_missed(c, object, n)?;
        let ended = !in_op(c)?;
        seen.push((n, count, good, ended));
        if ended {
            break;
        }
        // Waits until a counter that counts down has reached 0.
        c.t.run(20)?;
    }
    let fits = |way: &Way| {
        seen.iter().all(|(n, count, good, ended)| {
            // At the time of reading, the last of the good cycles may or may not have had its
            // SYNC0.
            *ended && *n > 1
                || (0..=*good).any(|good| {
                    let mut came = vec![false; *n as usize];
                    came.extend(vec![true; good as usize]);
                    (way.count)(&came) == *count as i64
                })
        })
    };
    let first = seen.first().is_some_and(|(_, _, _, ended)| *ended);
    // A SubDevice that leaves OP must have counted something.
    let never = seen.iter().all(|(_, count, _, _)| *count == 0);
    let found = WAYS.into_iter().find(fits).filter(|_| !first && !never);
    let text: Vec<_> = seen
        .iter()
        .map(|(n, count, _, ended)| match ended {
            true => format!("{n} left out: {count}, and OP is left"),
            false => format!("{n} left out: {count}"),
        })
        .collect();
    let text = text.join("; ");
    c.expect(object.at(sub::SM_EVENT_MISSED), "a known way of counting", text, found.is_some());
    if let Some(way) = &found {
        c.notes.push(format!("it counts {}", way.name));
    }
    Ok(found)
}

fn missed(c: &mut Case<'_, '_>) -> Done {
    dc_with_outputs(c)?;
    let object = with(c, sub::SM_EVENT_MISSED)?;
    way(c, &object)?;
    let others = c.counters(object.index)?;
    for (name, found) in [("0C", others.too_small), ("0D", others.too_short)] {
        if let Some(found) = found {
            c.equal(format!("0x{:04X}:{name}", object.index), 0, found);
        }
    }
    Ok(())
}

fn limit(c: &mut Case<'_, '_>) -> Done {
    dc_with_outputs(c)?;
    let object = with(c, sub::SM_EVENT_MISSED)?;
    let Some(limit) = c.s.coe.as_ref().and_then(|coe| coe.error_limit) else {
        return Err(not_applicable("it has no 0x10F1:02 that tells the limit"));
    };
    let Some(way) = way(c, &object)? else {
        return Err(Stop::Blocked { by: "CNT-01", why: "its way of counting is not known".into() });
    };
    c.evidence.clear();
    let ends = (way.ends)(limit);
    for (n, kept) in [(ends - 1, true), (ends, false)] {
        c.op_here()?;
        c.t.run(20)?;
        leave_out(c, n)?;
        let al = c.t.al()?;
        let place = format!("{n} frames left out, 0x10F1:02 = {limit}");
        if kept {
            c.expect(place, AlState::Op, al, al.is(AlState::Op));
        } else {
            let code = AlStatusCode::SYNCHRONIZATION_ERROR;
            let right = refused(&al, AlState::SafeOp, &[code]);
            c.expect(place, "SAFEOP+ERR, code 0x001A", al, right);
        }
    }
    Ok(())
}

fn too_short(c: &mut Case<'_, '_>) -> Done {
    dc_with_outputs(c)?;
    let object = with(c, sub::SHIFT_TIME_TOO_SHORT)?;
    let delay = object.value(sub::DELAY_TIME).unwrap_or(0) as u32;
    if delay < 2 {
        return Err(not_applicable("it states no delay"));
    }
    for (shift, counts) in [(delay, false), (delay - 1, true)] {
        times::shifted(c, shift)?;
        let from = c.t.exchange.as_ref().map_or(0, |exchange| exchange.cycles);
        c.t.run(10)?;
        let cycles = |c: &Case<'_, '_>| c.t.exchange.as_ref().map_or(0, |exchange| exchange.cycles);
        let found = c.counters(object.index)?.too_short.unwrap_or(0);
        // Some devices begin to count in the last cycles before OP.
        let most = cycles(c) - from + 20;
        let place = format!("{} at a shift of {shift} ns", object.at(sub::SHIFT_TIME_TOO_SHORT));
        if counts {
            let right = (10..=most).contains(&found);
            c.expect(place, format!("10 to {most}, one a cycle"), found, right);
        } else {
            c.equal(place, 0, found);
        }
        times::restore_shift(c, &object)?;
    }
    Ok(())
}

/// Brings the SubDevice to OP and sends one event while it still works on the previous one.
fn hurried(c: &mut Case<'_, '_>) -> Result<SyncObject, Stop> {
    if c.mode.bit == 0 {
        return Err(not_applicable("Free Run does not count events"));
    }
    if c.s.outputs.len == 0 || c.mode.uses_dc() && !c.mode.is_sync0() {
        return Err(not_applicable("it has no outputs, or SYNC1 starts its work"));
    }
    let object = with(c, sub::CYCLE_TIME_TOO_SMALL)?;
    let busy = match c.mode.uses_dc() {
        true => object.value(sub::CALC_AND_COPY_TIME).unwrap_or(0),
        false => c.s.minimum_cycle().0 as u64,
    };
    if busy < SURELY_BUSY {
        return Err(not_applicable("it states no time that is longer than a frame"));
    }
    c.op_here()?;
    c.t.run(10)?;
    c.t.turn(Turn::Twice)?;
    Ok(object)
}

/// Does the same as [`hurried`], and requires that 0C counted it: a counter at 0 can't be cleared.
fn counted(c: &mut Case<'_, '_>) -> Result<SyncObject, Stop> {
    let object = hurried(c)?;
    let at = object.at(sub::CYCLE_TIME_TOO_SMALL);
    match c.t.value(at)?.unwrap_or(0) {
        0 => Err(Stop::Blocked { by: "CNT-03", why: format!("{at} did not count") }),
        _ => Ok(object),
    }
}

fn too_small(c: &mut Case<'_, '_>) -> Done {
    let object = hurried(c)?;
    c.t.run(5)?;
    let counters = c.counters(object.index)?;
    let place = object.at(sub::CYCLE_TIME_TOO_SMALL);
    c.equal(format!("{place} after two frames at once"), 1, counters.too_small.unwrap_or(0));
    for (sub, found) in
        [(sub::SM_EVENT_MISSED, counters.missed), (sub::SHIFT_TIME_TOO_SHORT, counters.too_short)]
    {
        if let Some(found) = found {
            c.equal(object.at(sub), 0, found);
        }
    }
    let in_op = in_op(c)?;
    c.expect("state", AlState::Op, if in_op { "OP" } else { "another" }, in_op);
    Ok(())
}

fn sync_error(c: &mut Case<'_, '_>) -> Done {
    let object = counted(c)?;
    if object.entry(sub::SYNC_ERROR).is_none() {
        return Err(not_applicable("it has no sub-index 20"));
    }
    let found = c.t.value(object.at(sub::SYNC_ERROR))?.unwrap_or(0);
    c.equal(format!("{} after two frames at once", object.at(sub::SYNC_ERROR)), 1, found);
    Ok(())
}

fn reset(c: &mut Case<'_, '_>) -> Done {
    let object = counted(c)?;
    if !object.writable(sub::GET_CYCLE_TIME) {
        return Err(not_applicable("it has no sub-index 08"));
    }
    c.must_write(object.at(sub::GET_CYCLE_TIME), &[2, 0])?;
    for (sub, found) in c.counters(object.index)?.each().collect::<Vec<_>>() {
        c.equal(format!("{} after the reset", object.at(sub)), 0, found);
    }
    if c.mode.uses_dc() && object.entry(sub::SM_EVENT_MISSED).is_some() {
        // Some devices ignore the first missing frame.
        let at = object.at(sub::SM_EVENT_MISSED);
        c.t.run(20)?;
        let (mut count, _) = count_missed(c, &object, 1)?;
        if count == 0 {
            c.t.run(20)?;
            (count, _) = count_missed(c, &object, 2)?;
        }
        // Outside OP the counter would go on counting.
        if count > 0 && in_op(c)? {
            c.must_write(object.at(sub::GET_CYCLE_TIME), &[2, 0])?;
            let found = c.t.value(at)?.unwrap_or(0);
            c.equal(format!("{at} after the reset, {count} before"), 0, found);
        }
    }
    let read = c.t.value(object.at(sub::GET_CYCLE_TIME))?.unwrap_or(0);
    c.notes.push(format!("{} reads {read} afterwards", object.at(sub::GET_CYCLE_TIME)));
    c.t.download(object.at(sub::GET_CYCLE_TIME), &[0, 0])?.ok();
    Ok(())
}

fn mirrored(c: &mut Case<'_, '_>) -> Done {
    let object = counted(c)?;
    if object.index != OUTPUT_PARAMETER {
        return Err(not_applicable("it has no outputs"));
    }
    if c.mode.uses_dc() && object.entry(sub::SM_EVENT_MISSED).is_some() {
        // Two frames, because some devices ignore the first one.
        leave_out(c, 2)?;
    }
    // Reads between two frames, so that nothing is counted meanwhile.
    let outputs: Vec<_> = c.counters(OUTPUT_PARAMETER)?.each().collect();
    let inputs: Vec<_> = c.counters(INPUT_PARAMETER)?.each().collect();
    let again: Vec<_> = c.counters(OUTPUT_PARAMETER)?.each().collect();
    for (sub, found) in inputs {
        let of = |all: &[(u8, u64)]| all.iter().find(|one| one.0 == sub).map(|one| one.1);
        if let (Some(before), Some(after)) = (of(&outputs), of(&again)) {
            // A counter that counts down may do so while it is read.
            let (least, most) = (before.min(after), before.max(after));
            let place = ObjectAddress::new(INPUT_PARAMETER, sub);
            let right = (least..=most).contains(&found);
            c.expect(place, format!("{least} to {most}, as 0x1C32 has it"), found, right);
        }
    }
    match c.evidence.is_empty() {
        true => Err(not_applicable("0x1C33 has no counters")),
        false => Ok(()),
    }
}

fn cleared(c: &mut Case<'_, '_>) -> Done {
    let object = counted(c)?;
    c.t.exchange = None;
    let al = c.t.change(AlState::PreOp, STATE_PATIENCE)?;
    c.expect("0x0130", AlState::PreOp, al, al.is(AlState::PreOp));
    let at = object.at(sub::CYCLE_TIME_TOO_SMALL);
    let found = c.t.value(at)?.unwrap_or(0);
    c.equal(format!("{at} in PREOP"), 0, found);
    if c.s.chooses_type() {
        c.choose(c.mode)?;
    }
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    if !al.is(AlState::SafeOp) {
        return Err(Stop::Blocked { by: "MODE-02", why: al.to_string() });
    }
    let found = c.t.value(at)?.unwrap_or(0);
    c.equal(format!("{at} in SAFEOP"), 0, found);
    Ok(())
}

fn distances(c: &mut Case<'_, '_>) -> Done {
    if c.mode.bit == 0 || c.s.outputs.len == 0 {
        return Err(not_applicable("without outputs, or in Free Run, no frame is an event"));
    }
    let object = with(c, sub::MINIMUM_CYCLE_DISTANCE)?;
    c.op_here()?;
    c.t.run(50)?;
    let cycle = c.cycle();
    let mut wanted =
        vec![(sub::MINIMUM_CYCLE_DISTANCE, cycle), (sub::MAXIMUM_CYCLE_DISTANCE, cycle)];
    // In subordinated cycles the frame is further away from the last SYNC0 than from the first.
    if c.mode.uses_dc() && c.mode.subordinated_cycles() == 1 {
        let lead = c.lead(cycle);
        wanted
            .extend([(sub::MINIMUM_SM_SYNC_DISTANCE, lead), (sub::MAXIMUM_SM_SYNC_DISTANCE, lead)]);
    }
    wanted.retain(|(sub, _)| object.entry(*sub).is_some());
    let mut found = Vec::with_capacity(wanted.len());
    for (sub, _) in &wanted {
        found.push(Nanos(c.t.value(object.at(*sub))?.unwrap_or(0) as i64));
    }
    // The lateness is known only now: the entries include frames that were late while they were
    // read.
    let slack = UNEVEN + c.t.lateness() + c.t.lateness();
    for ((sub, at), found) in wanted.into_iter().zip(found) {
        let right = found >= at - slack && found <= at + slack;
        c.expect(object.at(sub), format!("{at}, {slack} more or less"), found, right);
    }
    Ok(())
}

/// Deviation of the distances by the frame's own length and by the clocks.
const UNEVEN: Nanos = Nanos::micros(10);
/// Two frames in a row are less than this apart, ns.
const SURELY_BUSY: u64 = 12_000;
