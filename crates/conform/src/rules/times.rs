//! TIME: the device keeps the times that it states.

use isocat_sim::observation::Observed;
use isocat_subdevice::Step;
use isocat_sync::SyncMode;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, ShiftBy, sub};
use isocat_wire::AlState;
use isocat_wire::time::{Nanos, Picos};

use super::{Check, Rule};
use crate::case::{Case, Done, OP_PATIENCE, Stop, not_applicable};
use crate::subject::SyncObject;

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "TIME-01",
        what: "it runs at a SYNC0 cycle of 0x1C32:05",
        source: "ETG.1020 0x1C32:05",
        applies: "modes with SYNC0, devices with 0x1C32:05 that is not 0",
        check: Check::EachMode(shortest_cycle),
    },
    Rule {
        id: "TIME-02",
        what: "outputs are valid 0x1C32:09 after SYNC0",
        source: "ETG.1020 0x1C32:09; true time",
        applies: "DC SYNC0, in simulation",
        check: Check::EachMode(outputs_valid),
    },
    Rule {
        id: "TIME-03",
        what: "outputs are valid within 0x1C32:05 after the frame",
        source: "ETG.1020 0x1C32:05; true time",
        applies: "SM-synchronous mode, in simulation",
        check: Check::EachMode(valid_after_frame),
    },
    Rule {
        id: "TIME-04",
        what: "outputs that come 0x1C32:06 before SYNC0 are in time",
        source: "ETG.1020 0x1C32:06; true time",
        applies: "DC SYNC0, devices with 0x1C32:06, in simulation",
        check: Check::EachMode(copy_time),
    },
    Rule {
        id: "TIME-05",
        what: "outputs are valid 0x1C32:03 after SYNC0, once a shift is set",
        source: "ETG.1020 0x1C32:03; true time",
        applies: "DC SYNC0, devices with shift by local timer, in simulation",
        check: Check::EachMode(shift),
    },
    Rule {
        id: "TIME-06",
        what: "the mailbox answers within 1 s",
        source: "ETG.1000.6, mailbox; 0x1000:00",
        applies: "devices with CoE",
        check: Check::Once(mailbox),
    },
    Rule {
        id: "TIME-07",
        what: "inputs stand in the buffer within 0x1C33:06 after Input Latch",
        source: "ETG.1020 0x1C33:06; true time",
        applies: "modes with SYNC0, devices with inputs that state it, in simulation",
        check: Check::EachMode(input_time),
    },
];

fn outputs(c: &Case<'_, '_>, needed: u8) -> Result<SyncObject, Stop> {
    let object = c.s.sync_objects().find(|object| object.index == OUTPUT_PARAMETER);
    let object = object.filter(|_| c.s.outputs.len > 0);
    let object = object.ok_or_else(|| not_applicable("it has no 0x1C32, or no outputs"))?;
    match object.value(needed) {
        Some(_) => Ok(object.clone()),
        None => Err(not_applicable(format!("it has no {}", object.at(needed)))),
    }
}

fn dc_only(c: &Case<'_, '_>) -> Done {
    if c.mode.uses_dc() { Ok(()) } else { Err(not_applicable("only modes with SYNC0")) }
}

/// Checks of exact instants apply to SYNC0 alone: with SYNC1 other instants hold.
fn sync0_only(c: &Case<'_, '_>) -> Done {
    if c.mode.is_sync0() { Ok(()) } else { Err(not_applicable("only DC SYNC0")) }
}

/// The outputs of a real device can't be observed.
fn simulated(c: &mut Case<'_, '_>) -> Done {
    match c.t.seen() {
        Some(_) => Ok(()),
        None => Err(not_applicable("only a simulation sees the instant")),
    }
}

fn shortest_cycle(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    let cycle = c.least_cycle();
    if cycle == Nanos::ZERO {
        return Err(not_applicable("it states no minimum cycle"));
    }
    if cycle < LEAST_FOR_FRAMES + c.t.lateness() {
        return Err(not_applicable(format!("no frames can be sent every {cycle} here")));
    }
    c.safe_op(c.mode, cycle)?;
    c.t.run(20)?;
    let al = c.t.change(AlState::Op, OP_PATIENCE)?;
    c.expect(format!("0x0130 at a cycle of {cycle}"), AlState::Op, al, al.is(AlState::Op));
    if al.is(AlState::Op) { c.clean_run(200) } else { Ok(()) }
}

/// The time from an event to valid outputs, over the cycles of a run: shortest and longest.
fn delays(c: &mut Case<'_, '_>, from: Observed) -> Result<Option<(Picos, Picos)>, Stop> {
    c.t.seen();
    c.t.run(20)?;
    let seen = c.t.seen().unwrap_or_default();
    let mut last = None;
    let mut range: Option<(Picos, Picos)> = None;
    for event in seen {
        if event.event == from {
            last = Some(event.at);
        }
        if let (Observed::Began(Step::OutputsValid), Some(last)) = (event.event, last) {
            let after = event.at - last;
            let (least, most) = range.unwrap_or((after, after));
            range = Some((least.min(after), most.max(after)));
        }
    }
    Ok(range)
}

/// Requires that the shortest and the longest time are near the stated one.
fn near(c: &mut Case<'_, '_>, place: String, stated: Nanos, range: Option<(Picos, Picos)>) {
    let expected = format!("{stated} after the pulse");
    let Some((least, most)) = range else {
        c.expect(place, expected, "outputs are never valid", false);
        return;
    };
    let stated = Picos::from(stated);
    let right = least >= stated - Picos::from(EARLY) && most <= stated + Picos::from(LATE);
    let us = |span: Picos| span.0 as f64 / 1e6;
    c.expect(place, expected, format!("{:.3} to {:.3} us", us(least), us(most)), right);
}

/// The pulse at which outputs act.
fn acting(c: &Case<'_, '_>, object: &SyncObject) -> Observed {
    let shifted = c.mode.mode == SyncMode::DcShiftSync1 && object.types().shift() == ShiftBy::Sync1;
    // In subordinated cycles outputs act at every SYNC0.
    let sync1 = c.mode.output_type == 3 && c.mode.subordinated_cycles() == 1;
    if sync1 || shifted { Observed::Sync1 } else { Observed::Sync0 }
}

fn outputs_valid(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    simulated(c)?;
    let object = outputs(c, sub::DELAY_TIME)?;
    c.op_here()?;
    let delay = object.value(sub::DELAY_TIME).unwrap_or(0);
    // A device does not apply a shift that 04 does not announce.
    let shift = match object.types().shift() {
        ShiftBy::LocalTimer => c.t.value(object.at(sub::SHIFT_TIME))?.unwrap_or(0),
        _ => 0,
    };
    let range = delays(c, acting(c, &object))?;
    near(c, object.at(sub::DELAY_TIME).to_string(), Nanos(delay.max(shift) as i64), range);
    Ok(())
}

fn input_time(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    simulated(c)?;
    let object = c.s.live_objects().find(|object| object.index == INPUT_PARAMETER);
    let stated = object.and_then(|object| object.value(sub::CALC_AND_COPY_TIME)).unwrap_or(0);
    if stated == 0 {
        return Err(not_applicable("it has no 0x1C33:06 that is not 0"));
    }
    c.op_here()?;
    c.t.seen();
    c.t.run(20)?;
    let mut latched = None;
    let mut most: Option<Picos> = None;
    for event in c.t.seen().unwrap_or_default() {
        match event.event {
            Observed::Began(Step::LatchInputs) => latched = Some(event.at),
            Observed::Finished(Step::MapInputs) => {
                let took = latched.take().map(|latched| event.at - latched);
                most = most.max(took);
            }
            _ => {}
        }
    }
    let stated = Nanos(stated as i64);
    let right = most.is_some_and(|most| most <= Picos::from(stated + EDGE));
    let found = most.map_or("inputs are never there".to_owned(), |most| {
        format!("{:.3} us at most", most.0 as f64 / 1e6)
    });
    c.expect("0x1C33:06", format!("within {stated} of Input Latch"), found, right);
    Ok(())
}

fn valid_after_frame(c: &mut Case<'_, '_>) -> Done {
    if c.mode.mode != SyncMode::SmSynchronous {
        return Err(not_applicable("only SM-synchronous mode"));
    }
    simulated(c)?;
    let object = outputs(c, sub::MINIMUM_CYCLE_TIME)?;
    let least = object.value(sub::MINIMUM_CYCLE_TIME).unwrap_or(0);
    if least == 0 {
        return Err(not_applicable("it states no minimum cycle"));
    }
    c.op_here()?;
    let range = delays(c, Observed::Sm2)?;
    let most = range.map(|(_, most)| most);
    let right = most.is_some_and(|most| most <= Picos::from(Nanos(least as i64)));
    let found = most.map_or("outputs are never valid".to_owned(), |most| {
        format!("{:.3} us at most", most.0 as f64 / 1e6)
    });
    let place = object.at(sub::MINIMUM_CYCLE_TIME);
    c.expect(place, format!("within {} of SM2", Nanos(least as i64)), found, right);
    Ok(())
}

fn copy_time(c: &mut Case<'_, '_>) -> Done {
    sync0_only(c)?;
    simulated(c)?;
    let object = outputs(c, sub::CALC_AND_COPY_TIME)?;
    let stated = Nanos(object.value(sub::CALC_AND_COPY_TIME).unwrap_or(0) as i64);
    if stated == Nanos::ZERO || object.entry(sub::SM_EVENT_MISSED).is_none() {
        return Err(not_applicable("it states no time, or counts nothing"));
    }
    c.op_here()?;
    // Measures the present time from SM2 to SYNC0.
    c.t.seen();
    c.t.run(3)?;
    let mut sm2 = None;
    let mut ahead = None;
    for event in c.t.seen().unwrap_or_default() {
        match event.event {
            Observed::Sm2 => sm2 = Some(event.at),
            Observed::Sync0 => ahead = sm2.map(|sm2| event.at - sm2),
            _ => {}
        }
    }
    let Some(ahead) = ahead else { return Err(not_applicable("no SYNC0 is seen")) };
    let too_early = Nanos(ahead.0 / 1000) - stated - EDGE;
    if let Some(grid) = c.t.exchange.as_mut().and_then(|exchange| exchange.grid.as_mut()) {
        grid.lead -= too_early;
    }
    c.t.run(30)?;
    let al = c.t.al()?;
    c.expect("state", AlState::Op, al, al.is(AlState::Op));
    let missed = c.counters(OUTPUT_PARAMETER)?.missed.unwrap_or(0);
    let place = format!("{} with outputs {stated} before SYNC0", object.at(sub::SM_EVENT_MISSED));
    c.equal(place, 0, missed);
    Ok(())
}

/// Brings a device whose outputs are shifted by a local timer to OP, with this shift.
pub(super) fn shifted(c: &mut Case<'_, '_>, shift: u32) -> Done {
    let mode = c.mode;
    let cycle = c.cycle();
    let object = outputs(c, sub::SHIFT_TIME)?;
    if object.types().shift() != ShiftBy::LocalTimer || !object.writable(sub::SHIFT_TIME) {
        return Err(not_applicable("its outputs can't be shifted"));
    }
    let grid = c.prepare(mode, cycle)?;
    let at = object.at(sub::SHIFT_TIME);
    c.must_write(at, &shift.to_le_bytes())?;
    let found = c.t.value(at)?.unwrap_or(0);
    if found != u64::from(shift) {
        c.equal(format!("{at} after it was written"), u64::from(shift), found);
    }
    let al = c.t.change(AlState::SafeOp, crate::case::STATE_PATIENCE)?;
    if !al.is(AlState::SafeOp) {
        return Err(Stop::Blocked { by: "MODE-02", why: al.to_string() });
    }
    // The set-up took time: the SYNC unit may already run.
    c.exchange(cycle, grid);
    c.enter_op()
}

fn shift(c: &mut Case<'_, '_>) -> Done {
    sync0_only(c)?;
    simulated(c)?;
    let object = outputs(c, sub::DELAY_TIME)?;
    let wanted = object.value(sub::DELAY_TIME).unwrap_or(0) + 70_000;
    shifted(c, wanted as u32)?;
    let range = delays(c, Observed::Sync0)?;
    near(c, object.at(sub::SHIFT_TIME).to_string(), Nanos(wanted as i64), range);
    restore_shift(c, &object)
}

/// Restores the shift time in PREOP, where every device accepts it, because a real device keeps it.
pub(super) fn restore_shift(c: &mut Case<'_, '_>, object: &SyncObject) -> Done {
    c.preop()?;
    let before = object.value(sub::SHIFT_TIME).unwrap_or(0) as u32;
    c.t.download(object.at(sub::SHIFT_TIME), &before.to_le_bytes())?.ok();
    Ok(())
}

fn mailbox(c: &mut Case<'_, '_>) -> Done {
    c.preop_with_objects()?;
    let at = isocat_wire::ObjectAddress::new(0x1000, 0);
    let begin = c.t.now();
    let _any = c.t.upload(at)?;
    let took = c.t.now() - begin;
    c.expect(at, "an answer within 1 s", format!("after {took}"), took <= Nanos::millis(1_000));
    Ok(())
}

/// How much earlier than stated outputs may be valid: rounding, and a SYNC unit that counts in 10
/// ns.
const EARLY: Nanos = Nanos(100);
/// How much later than stated outputs may be valid: the difference of the shortest and the longest
/// delay.
const LATE: Nanos = Nanos(1_000);
/// Tolerance for the clocks: work that ends exactly at SYNC0 is in time.
const EDGE: Nanos = Nanos(200);
/// A frame and its answer have to fit between two cycles.
const LEAST_FOR_FRAMES: Nanos = Nanos::micros(30);
