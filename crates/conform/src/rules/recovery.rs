//! REC: after each fault, acknowledge the error, remove its cause, and run clean again.

use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;
use isocat_wire::{AlControl, AlState};

use super::{Check, Rule, states};
use crate::case::{Case, Done, LEAD_IN, OP_PATIENCE, STATE_PATIENCE, Stop, not_applicable};
use crate::tester::{Al, Grid, Turn};

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "REC-01",
        what: "a request without acknowledgement is ignored while an error shows",
        source: "ETG.1000.6, ESM; 0x0120 bit 4",
        applies: "always",
        check: Check::Once(not_acknowledged),
    },
    Rule {
        id: "REC-02",
        what: "after a refused SAFEOP: acknowledged, set right, SAFEOP",
        source: "ETG.1000.6, ESM; 0x0120 bit 4",
        applies: "devices with outputs or inputs",
        check: Check::Once(after_refusal),
    },
    Rule {
        id: "REC-03",
        what: "after the watchdog: acknowledged, OP, a clean run",
        source: "ETG.1000.6, ESM; 0x0134 = 0x001B",
        applies: "as AL-20",
        check: Check::EachMode(after_watchdog),
    },
    Rule {
        id: "REC-04",
        what: "after a lost order: acknowledged, OP, a clean run",
        source: "ETG.1000.6, ESM; 0x0134 = 0x001A",
        applies: "as AL-21",
        check: Check::EachMode(after_lost_order),
    },
    Rule {
        id: "REC-05",
        what: "after a lost SYNC0: acknowledged, SYNC0 set up anew from PREOP, OP, a clean run",
        source: "ETG.1000.6, ESM; 0x0134 = 0x002C",
        applies: "as AL-22",
        check: Check::EachMode(after_lost_sync0),
    },
];

fn not_acknowledged(c: &mut Case<'_, '_>) -> Done {
    c.preop()?;
    // Requests a state that does not exist, which is an error for every device.
    c.t.request(AlControl(0x0006))?;
    let al = c.t.await_state(AlState::Op, Nanos::millis(200))?;
    if !al.status.error() {
        return Err(Stop::Blocked { by: "AL-03", why: al.to_string() });
    }
    c.t.request(AlControl::request(AlState::PreOp))?;
    c.t.pause(Nanos::millis(100))?;
    let al = c.t.al()?;
    c.expect("0x0130 after a request", "PREOP+ERR", al, al.status.error());
    Ok(())
}

/// Acknowledges the error. It must disappear and the state must remain; returns whether they did.
fn acknowledge(c: &mut Case<'_, '_>, state: AlState) -> Result<bool, Stop> {
    let al = c.t.acknowledge()?;
    c.expect("0x0130 after the acknowledgement", state, al, al.is(state));
    Ok(al.is(state))
}

fn after_refusal(c: &mut Case<'_, '_>) -> Done {
    let mode = c.any_mode()?;
    c.prepare(mode, c.cycle())?;
    let is_output = c.s.outputs.len > 0;
    let number = if is_output { c.s.outputs.sm } else { c.s.inputs.sm };
    let right = c.s.sync_manager(number);
    let wrong = SyncManager { length: right.length + 1, ..right };
    c.t.set_sync_manager(number, wrong)?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    if !al.status.error() {
        return Err(Stop::Blocked {
            by: if is_output { "AL-04" } else { "AL-05" },
            why: al.to_string(),
        });
    }
    if !acknowledge(c, AlState::PreOp)? {
        return Ok(());
    }
    c.t.set_sync_manager(number, right)?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    c.expect("0x0130 with all set right", AlState::SafeOp, al, al.is(AlState::SafeOp));
    Ok(())
}

/// Acknowledges the error in SAFEOP, and requires a clean run in OP afterwards.
fn back(c: &mut Case<'_, '_>, fell: Al, rule: &'static str) -> Done {
    if !fell.status.error() {
        return Err(Stop::Blocked { by: rule, why: fell.to_string() });
    }
    if !acknowledge(c, AlState::SafeOp)? {
        return Ok(());
    }
    c.t.run(10)?;
    let al = c.t.change(AlState::Op, OP_PATIENCE)?;
    c.expect("0x0130", AlState::Op, al, al.is(AlState::Op));
    if !al.is(AlState::Op) {
        return Ok(());
    }
    c.t.run(20)?;
    c.clean_run(50)
}

fn after_watchdog(c: &mut Case<'_, '_>) -> Done {
    if c.mode.uses_dc() || c.s.outputs.len == 0 {
        return Err(not_applicable("only outputs without SYNC0"));
    }
    if c.s.sync_manager(c.s.outputs.sm).control & SyncManager::CONTROL_WATCHDOG == 0 {
        return Err(not_applicable("its SII asks for no watchdog"));
    }
    c.op_here()?;
    let fell = states::starve(c)?;
    back(c, fell, "AL-20")
}

fn after_lost_order(c: &mut Case<'_, '_>) -> Done {
    if !c.mode.uses_dc() || c.s.outputs.len == 0 {
        return Err(not_applicable("only outputs with SYNC0"));
    }
    c.op_here()?;
    for _ in 0..20 {
        c.t.turn(Turn::Skip)?;
    }
    let fell = c.t.al()?;
    back(c, fell, "AL-21")
}

fn after_lost_sync0(c: &mut Case<'_, '_>) -> Done {
    if !c.mode.uses_dc() {
        return Err(not_applicable("only modes with SYNC0"));
    }
    c.op_here()?;
    let fell = states::stop_sync0(c)?;
    if !fell.status.error() {
        return Err(Stop::Blocked { by: "AL-22", why: fell.to_string() });
    }
    if !acknowledge(c, AlState::SafeOp)? {
        return Ok(());
    }
    c.t.exchange = None;
    let al = c.t.change(AlState::PreOp, STATE_PATIENCE)?;
    c.expect("0x0130", AlState::PreOp, al, al.is(AlState::PreOp));
    if c.s.chooses_type() {
        c.choose(c.mode)?;
    }
    let cycle = c.cycle();
    let ns = cycle.to_u32().unwrap_or(u32::MAX);
    let start = c.t.start_sync(c.mode.activation, c.mode.pulses(ns), LEAD_IN)?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    c.expect("0x0130", AlState::SafeOp, al, al.is(AlState::SafeOp));
    c.exchange(cycle, Some(Grid { start, lead: c.lead(cycle) }));
    c.t.run(10)?;
    let al = c.t.change(AlState::Op, OP_PATIENCE)?;
    c.expect("0x0130", AlState::Op, al, al.is(AlState::Op));
    if al.is(AlState::Op) { c.clean_run(50) } else { Ok(()) }
}
