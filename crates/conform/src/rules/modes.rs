//! MODE: each announced mode is entered, reads back and runs.

use isocat_sync::object::sub;
use isocat_wire::AlState;

use super::{Check, Rule};
use crate::case::{Case, Done, OP_PATIENCE, STATE_PATIENCE, Stop, not_applicable};

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "MODE-01",
        what: "PREOP is entered with the mailbox set as the SII says",
        source: "ETG.1000.6, ESM; 0x0130",
        applies: "always",
        check: Check::Once(preop),
    },
    Rule {
        id: "MODE-02",
        what: "SAFEOP is entered in every announced mode",
        source: "ETG.1020 0x1C32:04; 0x0130",
        applies: "every mode",
        check: Check::EachMode(safe_op),
    },
    Rule {
        id: "MODE-03",
        what: "OP is entered in every announced mode",
        source: "ETG.1020 0x1C32:04; 0x0130",
        applies: "every mode",
        check: Check::EachMode(op),
    },
    Rule {
        id: "MODE-04",
        what: "0x1C32:01 and 0x1C33:01 show the mode in use from SAFEOP on",
        source: "ETG.1020 0x1C32:01, 0x1C33:01",
        applies: "every mode, devices with sync objects",
        check: Check::EachMode(read_back),
    },
    Rule {
        id: "MODE-05",
        what: "with DC, 0x1C32:02 and 0x1C32:0A show the SYNC0 cycle of the register",
        source: "ETG.1020 0x1C32:02, 0x1C32:0A; 0x09A0",
        applies: "modes with SYNC0, devices with sync objects",
        check: Check::EachMode(cycle_time),
    },
    Rule {
        id: "MODE-06",
        what: "a run without faults counts nothing: state, working counters, error counters",
        source: "ETG.1020 0x1C32:0B-0D, 0x1C32:20",
        applies: "every mode",
        check: Check::EachMode(clean),
    },
    Rule {
        id: "MODE-07",
        what: "without a written type the device runs in the mode that the SYNC unit is set to",
        source: "ET9300 9.1.3; 0x0981",
        applies: "devices with DC SYNC0 whose 0x1C32:01 can be written",
        check: Check::Once(follows_sync_unit),
    },
    Rule {
        id: "MODE-08",
        what: "inputs stand in the buffer when SAFEOP is entered",
        source: "ET9300, PREOP to SAFEOP; SM3",
        applies: "devices with inputs",
        check: Check::Once(first_inputs),
    },
    Rule {
        id: "MODE-09",
        what: "INIT is entered from every state, and ends the exchange",
        source: "ETG.1000.6, ESM; 0x0130",
        applies: "every mode",
        check: Check::EachMode(back_to_init),
    },
];

fn preop(c: &mut Case<'_, '_>) -> Done {
    c.t.restart()?;
    let al = c.s.preop(c.t)?;
    c.expect("0x0130", AlState::PreOp, al, al.is(AlState::PreOp));
    Ok(())
}

fn safe_op(c: &mut Case<'_, '_>) -> Done {
    c.prepare(c.mode, c.cycle())?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    c.expect("0x0130", AlState::SafeOp, al, al.is(AlState::SafeOp));
    Ok(())
}

fn op(c: &mut Case<'_, '_>) -> Done {
    c.safe_op(c.mode, c.cycle())?;
    c.t.run(5)?;
    let al = c.t.change(AlState::Op, OP_PATIENCE)?;
    c.expect("0x0130", AlState::Op, al, al.is(AlState::Op));
    Ok(())
}

fn read_back(c: &mut Case<'_, '_>) -> Done {
    if c.s.sync_objects().next().is_none() {
        return Err(not_applicable("it has no sync object"));
    }
    c.safe_op(c.mode, c.cycle())?;
    for state in [AlState::SafeOp, AlState::Op] {
        if state == AlState::Op {
            c.enter_op()?;
        }
        for object in c.s.live_objects() {
            let wanted = u64::from(c.sync_type(object, c.mode));
            let at = object.at(sub::SYNC_TYPE);
            let found = c.t.upload(at)?.map(|data| super::objects::hex(&data));
            let wanted = super::objects::hex(&wanted.to_le_bytes()[..2]);
            let found = found.unwrap_or_else(|code| code.to_string());
            c.expect(format!("{at} in {state}"), &wanted, &found, wanted == found);
        }
    }
    Ok(())
}

fn back_to_init(c: &mut Case<'_, '_>) -> Done {
    for from in [AlState::PreOp, AlState::SafeOp, AlState::Op] {
        match from {
            AlState::PreOp => c.preop()?,
            AlState::SafeOp => c.safe_op(c.mode, c.cycle())?,
            _ => c.op_here()?,
        }
        c.t.exchange = None;
        let al = c.t.change(AlState::Init, STATE_PATIENCE)?;
        c.expect(
            format!("0x0130, INIT asked for in {from}"),
            AlState::Init,
            al,
            al.is(AlState::Init),
        );
    }
    Ok(())
}

fn cycle_time(c: &mut Case<'_, '_>) -> Done {
    if !c.mode.uses_dc() {
        return Err(not_applicable("only modes with SYNC0"));
    }
    c.leading()?;
    let cycle = c.cycle();
    let (sync0, _) = c.mode.pulses(cycle.to_u32().unwrap_or(u32::MAX));
    c.safe_op(c.mode, cycle)?;
    for object in c.s.live_objects() {
        for sub in [sub::CYCLE_TIME, sub::SYNC0_CYCLE_TIME] {
            if object.entry(sub).is_some() {
                let at = object.at(sub);
                let found = c.t.value(at)?.unwrap_or(0);
                c.equal(format!("{at} in SAFEOP"), u64::from(sync0), found);
            }
        }
    }
    Ok(())
}

fn clean(c: &mut Case<'_, '_>) -> Done {
    c.op_here()?;
    c.clean_run(100)
}

fn follows_sync_unit(c: &mut Case<'_, '_>) -> Done {
    let mode = c.sync0_mode()?;
    if !c.s.chooses_type() {
        return Err(not_applicable("0x1C32:01 is read only: every run is such a run"));
    }
    c.preop()?;
    c.assign()?;
    c.process_data()?;
    let cycle = c.cycle().to_u32().unwrap_or(u32::MAX);
    c.t.start_sync(mode.activation, (cycle, 0), crate::case::LEAD_IN)?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    if !al.is(AlState::SafeOp) {
        return Err(Stop::Blocked { by: "MODE-02", why: al.to_string() });
    }
    for object in c.s.live_objects() {
        let at = object.at(sub::SYNC_TYPE);
        let found = c.t.value(at)?.unwrap_or(u64::MAX);
        c.equal(at, u64::from(c.sync_type(object, mode)), found);
    }
    Ok(())
}

fn first_inputs(c: &mut Case<'_, '_>) -> Done {
    if c.s.inputs.len == 0 {
        return Err(not_applicable("it has no inputs"));
    }
    let mode = c.any_mode()?;
    c.prepare(mode, c.cycle())?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    if !al.is(AlState::SafeOp) {
        return Err(Stop::Blocked { by: "MODE-02", why: al.to_string() });
    }
    // A buffer that was never written can't be read.
    let register = isocat_wire::register::sm_status(c.s.inputs.sm);
    let status = c.t.register(register)?;
    let none = isocat_wire::sync_manager::SyncManager::STATUS_BUFFER;
    let found = if status & none == none { "no buffer written" } else { "a buffer written" };
    let place = format!("0x{:04X}", register.address);
    c.expect(place, "a buffer written", found, status & none != none);
    Ok(())
}
