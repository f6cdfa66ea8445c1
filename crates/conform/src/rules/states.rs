//! AL: wrong set-ups are refused and faults in OP are reported, each by its status code.

use isocat_sync::object::{INPUT_ASSIGNMENT, OUTPUT_ASSIGNMENT};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;
use isocat_wire::{AlControl, AlState, AlStatusCode, ObjectAddress, register};

use super::{Check, Rule};
use crate::case::{Case, Done, LEAD_IN, OP_PATIENCE, STATE_PATIENCE, Stop, not_applicable};
use crate::subject::refused;
use crate::tester::{Al, Turn};

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "AL-01",
        what: "a wrong mailbox is refused",
        source: "0x0134 = 0x0016; SM0",
        applies: "devices with a mailbox",
        check: Check::Once(mailbox),
    },
    Rule {
        id: "AL-02",
        what: "OP is not given from INIT, nor from PREOP",
        source: "0x0134 = 0x0011",
        applies: "always",
        check: Check::Once(skipped_state),
    },
    Rule {
        id: "AL-03",
        what: "a state that does not exist is refused",
        source: "0x0134 = 0x0012",
        applies: "always",
        check: Check::Once(unknown_state),
    },
    Rule {
        id: "AL-04",
        what: "SM2 of wrong length, place or direction is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0134 = 0x001D",
        applies: "devices with outputs",
        check: Check::Once(wrong_sm2),
    },
    Rule {
        id: "AL-05",
        what: "SM3 of wrong length, place or direction is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0134 = 0x001E",
        applies: "devices with inputs",
        check: Check::Once(wrong_sm3),
    },
    Rule {
        id: "AL-06",
        what: "an assignment of outputs that can't be computed is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0134 = 0x0025",
        applies: "devices whose 0x1C12 can be written",
        check: Check::Once(wrong_output_mapping),
    },
    Rule {
        id: "AL-07",
        what: "an assignment of inputs that can't be computed is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0134 = 0x0024",
        applies: "devices whose 0x1C13 can be written",
        check: Check::Once(wrong_input_mapping),
    },
    Rule {
        id: "AL-08",
        what: "a SYNC unit without any signal is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0981 = 0x01, 0x0134 = 0x0030",
        applies: "devices with DC SYNC0",
        check: Check::Once(no_signal),
    },
    Rule {
        id: "AL-09",
        what: "SYNC1 without SYNC0 is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0981 = 0x05, 0x0134 = 0x0030",
        applies: "devices with DC SYNC0",
        check: Check::Once(sync1_alone),
    },
    Rule {
        id: "AL-10",
        what: "SYNC1 is refused where 04 does not announce it",
        source: "ET9300, PREOP to SAFEOP; 0x0981 = 0x07, 0x0134 = 0x0030",
        applies: "devices with DC SYNC0 and without DC SYNC1",
        check: Check::Once(sync1_unsupported),
    },
    Rule {
        id: "AL-11",
        what: "SYNC0 is refused where 04 does not announce it",
        source: "ET9300, PREOP to SAFEOP; 0x0981 = 0x03, 0x0134 = 0x0030",
        applies: "devices with clock and sync objects, without DC SYNC0",
        check: Check::Once(sync0_unsupported),
    },
    Rule {
        id: "AL-12",
        what: "a SYNC0 cycle below 0x1C32:05 is refused, one equal to it is not",
        source: "ETG.1020 0x1C32:05; 0x09A0, 0x0134 = 0x0036",
        applies: "devices with DC SYNC0 and 0x1C32:05 that is not 0",
        check: Check::Once(short_cycle),
    },
    Rule {
        id: "AL-13",
        what: "subordinated cycles are refused where 04 does not announce them",
        source: "ET9300, PREOP to SAFEOP; 0x09A4, 0x0134 = 0x0030",
        applies: "devices with DC SYNC1 and without subordinated cycles",
        check: Check::Once(subordinated_unsupported),
    },
    Rule {
        id: "AL-14",
        what: "a type with SYNC0 is refused while the SYNC unit is off",
        source: "ET9300, PREOP to SAFEOP; 0x1C32:01, 0x0981 = 0x00, 0x0134 = 0x0030",
        applies: "devices with DC SYNC0 whose 0x1C32:01 can be written",
        check: Check::Once(type_without_unit),
    },
    Rule {
        id: "AL-15",
        what: "Free Run with a process data buffer of handshake type is refused",
        source: "ET9300, PREOP to SAFEOP; 0x0134 = 0x0029",
        applies: "devices with Free Run that can be asked for, and process data",
        check: Check::Once(one_buffer),
    },
    Rule {
        id: "AL-16",
        what: "watchdog trigger of SM2 and watchdog time 0 together are refused",
        source: "ET9300, PREOP to SAFEOP; 0x0420, 0x0134 = 0x001F",
        applies: "devices with CoE and outputs",
        check: Check::Once(watchdog_disagrees),
    },
    Rule {
        id: "AL-17",
        what: "OP is given up when SYNC0 never comes",
        source: "ET9300, SAFEOP to OP; 0x0134 = 0x002D",
        applies: "modes with SYNC0",
        check: Check::EachMode(no_sync0),
    },
    Rule {
        id: "AL-18",
        what: "OP is given up when outputs never come",
        source: "ET9300, SAFEOP to OP; 0x0134 = 0x001B",
        applies: "every mode, devices with outputs",
        check: Check::EachMode(no_outputs),
    },
    Rule {
        id: "AL-19",
        what: "OP is given up when outputs and SYNC0 do not find their order",
        source: "ET9300, SAFEOP to OP; 0x0134 = 0x001A",
        applies: "modes with SYNC0, devices with outputs",
        check: Check::EachMode(no_order),
    },
    Rule {
        id: "AL-20",
        what: "outputs that stay away end OP without SYNC0: the watchdog",
        source: "ET9300, OP; 0x0420, 0x0134 = 0x001B",
        applies: "modes without SYNC0, devices with outputs and watchdog",
        check: Check::EachMode(watchdog),
    },
    Rule {
        id: "AL-21",
        what: "outputs that stay away end OP with SYNC0: the order is lost",
        source: "ET9300, OP; 0x10F1:02, 0x0134 = 0x001A",
        applies: "modes with SYNC0, devices with outputs",
        check: Check::EachMode(order_lost),
    },
    Rule {
        id: "AL-22",
        what: "SYNC0 that stays away ends OP",
        source: "ET9300, OP; 0x0981, 0x0134 = 0x002C",
        applies: "modes with SYNC0",
        check: Check::EachMode(sync0_lost),
    },
];

/// Notes a refusal. Drives report some refusals by other codes.
fn must_refuse(c: &mut Case<'_, '_>, place: &str, al: Al, state: AlState, codes: &[AlStatusCode]) {
    let list: Vec<_> = codes.iter().map(|code| format!("0x{:04X}", code.0)).collect();
    let expected = format!("{state}+ERR, code {}", list.join(" or "));
    c.expect(place, expected, al, refused(&al, state, codes));
}

/// Requests SAFEOP, which must be refused with this code.
fn refuses_safe_op(c: &mut Case<'_, '_>, place: &str, code: AlStatusCode) -> Done {
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    must_refuse(c, place, al, AlState::PreOp, &[code]);
    Ok(())
}

fn mailbox(c: &mut Case<'_, '_>) -> Done {
    if !c.s.has_mailbox() {
        return Err(not_applicable("it has no mailbox"));
    }
    c.t.restart()?;
    let mut wrong = c.s.clone();
    wrong.header.receive.length += 2;
    let al = wrong.preop(c.t)?;
    must_refuse(c, "SM0 two bytes longer", al, AlState::Init, &[AlStatusCode::INVALID_MAILBOX]);
    Ok(())
}

fn skipped_state(c: &mut Case<'_, '_>) -> Done {
    let code = AlStatusCode::INVALID_STATE_CHANGE;
    c.t.restart()?;
    for state in [AlState::SafeOp, AlState::Op] {
        let al = c.t.change(state, STATE_PATIENCE)?;
        must_refuse(c, &format!("INIT to {state}"), al, AlState::Init, &[code]);
        c.t.acknowledge()?;
    }
    c.preop()?;
    let al = c.t.change(AlState::Op, STATE_PATIENCE)?;
    must_refuse(c, "PREOP to OP", al, AlState::PreOp, &[code]);
    Ok(())
}

fn unknown_state(c: &mut Case<'_, '_>) -> Done {
    c.preop()?;
    c.t.request(AlControl(0x0006))?;
    let al = c.t.await_state(AlState::Op, Nanos::millis(200))?;
    let code = AlStatusCode::UNKNOWN_STATE;
    must_refuse(c, "request of state 6", al, AlState::PreOp, &[code]);
    Ok(())
}

/// Tries the three ways to set up a process data SyncManager wrongly.
fn wrong_sync_manager(c: &mut Case<'_, '_>, number: usize, code: AlStatusCode) -> Done {
    let mode = c.any_mode()?;
    let right = c.s.sync_manager(number);
    let wrong = [
        ("one byte longer", SyncManager { length: right.length + 1, ..right }),
        ("four bytes further", SyncManager { start: right.start + 4, ..right }),
        ("in the other direction", SyncManager { control: right.control ^ 0x04, ..right }),
        ("off", SyncManager { activate: 0, ..right }),
    ];
    for (what, sm) in wrong {
        c.prepare(mode, c.cycle())?;
        c.t.set_sync_manager(number, sm)?;
        refuses_safe_op(c, &format!("SM{number} {what}"), code)?;
    }
    Ok(())
}

fn wrong_sm2(c: &mut Case<'_, '_>) -> Done {
    match c.s.outputs.len {
        0 => Err(not_applicable("it has no outputs")),
        _ => wrong_sync_manager(c, c.s.outputs.sm, AlStatusCode::INVALID_OUTPUT_CONFIGURATION),
    }
}

fn wrong_sm3(c: &mut Case<'_, '_>) -> Done {
    match c.s.inputs.len {
        0 => Err(not_applicable("it has no inputs")),
        _ => wrong_sync_manager(c, c.s.inputs.sm, AlStatusCode::INVALID_INPUT_CONFIGURATION),
    }
}

fn wrong_mapping(
    c: &mut Case<'_, '_>,
    index: u16,
    writable: bool,
    pdo: u16,
    code: AlStatusCode,
) -> Done {
    if !writable {
        return Err(not_applicable(format!("0x{index:04X} is fixed")));
    }
    let mode = c.any_mode()?;
    c.prepare(mode, c.cycle())?;
    let at = |sub| ObjectAddress::new(index, sub);
    c.must_write(at(0), &[0])?;
    for object in [at(1), at(0)] {
        let data = if object.sub == 0 { vec![1] } else { pdo.to_le_bytes().to_vec() };
        if let Err(code) = c.t.download(object, &data)? {
            // A device that refuses the write needs no status code.
            c.expect(object, "refused here or in SAFEOP", format!("refused: {code}"), true);
            return Ok(());
        }
    }
    refuses_safe_op(c, &format!("0x{index:04X} assigns 0x{pdo:04X}, which is not there"), code)
}

fn wrong_output_mapping(c: &mut Case<'_, '_>) -> Done {
    let writable = c.s.outputs.writable;
    wrong_mapping(c, OUTPUT_ASSIGNMENT, writable, 0x17FE, AlStatusCode::INVALID_OUTPUT_MAPPING)
}

fn wrong_input_mapping(c: &mut Case<'_, '_>) -> Done {
    let writable = c.s.inputs.writable;
    wrong_mapping(c, INPUT_ASSIGNMENT, writable, 0x1BFE, AlStatusCode::INVALID_INPUT_MAPPING)
}

/// Sets up everything for SAFEOP except the type, and the SYNC unit with these values.
fn with_unit(c: &mut Case<'_, '_>, activation: u8, cycles: (u32, u32)) -> Done {
    c.preop()?;
    c.assign()?;
    c.process_data()?;
    c.t.start_sync(activation, cycles, LEAD_IN)?;
    Ok(())
}

fn usual(c: &Case<'_, '_>) -> u32 {
    c.cycle().to_u32().unwrap_or(u32::MAX)
}

fn refuses_unit(c: &mut Case<'_, '_>, activation: u8, cycles: (u32, u32), what: &str) -> Done {
    with_unit(c, activation, cycles)?;
    refuses_safe_op(c, what, AlStatusCode::INVALID_DC_SYNC_CONFIGURATION)
}

fn no_signal(c: &mut Case<'_, '_>) -> Done {
    c.sync0_mode()?;
    refuses_unit(c, 0x01, (usual(c), 0), "0x0981 = 0x01")
}

fn sync1_alone(c: &mut Case<'_, '_>) -> Done {
    c.sync0_mode()?;
    refuses_unit(c, 0x05, (usual(c), 0), "0x0981 = 0x05")
}

fn sync1_unsupported(c: &mut Case<'_, '_>) -> Done {
    c.sync0_mode()?;
    if c.s.types() & 0x08 != 0 {
        return Err(not_applicable("it announces SYNC1"));
    }
    refuses_unit(c, 0x07, (usual(c), usual(c) / 10), "0x0981 = 0x07")
}

fn sync0_unsupported(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    let types = c.s.types();
    // A device that announces no types does not say which ones it refuses.
    if types & 0x04 != 0 || types & 0x1F == 0 || !c.s.has_dc {
        return Err(not_applicable("it announces SYNC0 or nothing, or has no clock"));
    }
    refuses_unit(c, 0x03, (usual(c), 0), "0x0981 = 0x03")
}

fn short_cycle(c: &mut Case<'_, '_>) -> Done {
    let mode = c.sync0_mode()?;
    let least = c.s.minimum_cycle();
    if least <= Nanos(10) {
        return Err(not_applicable("it states no minimum cycle"));
    }
    // 10 ns is the smallest step of its clock.
    for (cycle, right) in [(least - Nanos(10), false), (least, true)] {
        c.prepare(mode, cycle)?;
        let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
        let place = format!("0x09A0 = {} ns, 0x1C32:05 = {} ns", cycle.0, least.0);
        if right {
            c.expect(place, AlState::SafeOp, al, al.is(AlState::SafeOp));
        } else {
            must_refuse(c, &place, al, AlState::PreOp, &[AlStatusCode::DC_SYNC0_CYCLE]);
        }
    }
    Ok(())
}

fn subordinated_unsupported(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    let types = c.s.types();
    if types & 0x08 == 0 || types & 0x10 != 0 {
        return Err(not_applicable("it has no SYNC1, or subordinated cycles too"));
    }
    refuses_unit(c, 0x07, (usual(c), usual(c)), "0x09A4 = 0x09A0")
}

fn type_without_unit(c: &mut Case<'_, '_>) -> Done {
    let mode = c.sync0_mode()?;
    if !c.s.chooses_type() {
        return Err(not_applicable("0x1C32:01 is read only"));
    }
    c.preop()?;
    c.assign()?;
    c.choose(mode)?;
    c.process_data()?;
    refuses_safe_op(c, "type 2 chosen, 0x0981 = 0x00", AlStatusCode::INVALID_DC_SYNC_CONFIGURATION)
}

fn one_buffer(c: &mut Case<'_, '_>) -> Done {
    let mut modes = c.s.modes.iter().copied();
    let Some(mode) = modes.find(|mode| mode.bit == 0) else {
        return Err(not_applicable("it announces no Free Run"));
    };
    if c.s.outputs.len == 0 && c.s.inputs.len == 0 {
        return Err(not_applicable("it has no process data, so no buffers"));
    }
    c.prepare(mode, c.cycle())?;
    let number = if c.s.outputs.len > 0 { c.s.outputs.sm } else { c.s.inputs.sm };
    let right = c.s.sync_manager(number);
    let control = right.control & !0x03 | SyncManager::CONTROL_MAILBOX;
    c.t.set_sync_manager(number, SyncManager { control, ..right })?;
    refuses_safe_op(c, &format!("SM{number} as a mailbox"), AlStatusCode::FREE_RUN_NEEDS_3_BUFFERS)
}

fn watchdog_disagrees(c: &mut Case<'_, '_>) -> Done {
    if c.s.outputs.len == 0 || c.s.coe.is_none() {
        return Err(not_applicable("it has no outputs, or is too simple to look"));
    }
    let mode = c.any_mode()?;
    c.prepare(mode, c.cycle())?;
    let right = c.s.sync_manager(c.s.outputs.sm);
    let control = right.control | SyncManager::CONTROL_WATCHDOG;
    c.t.set_sync_manager(c.s.outputs.sm, SyncManager { control, ..right })?;
    let time = c.t.register(register::WATCHDOG_TIME_PROCESS_DATA)?;
    c.t.set(register::WATCHDOG_TIME_PROCESS_DATA, 0)?;
    refuses_safe_op(c, "0x0420 = 0", AlStatusCode::INVALID_WATCHDOG_CONFIGURATION)?;
    Ok(c.t.set(register::WATCHDOG_TIME_PROCESS_DATA, time)?)
}

fn dc_only(c: &Case<'_, '_>) -> Done {
    if c.mode.uses_dc() { Ok(()) } else { Err(not_applicable("only modes with SYNC0")) }
}

fn with_outputs(c: &Case<'_, '_>) -> Done {
    if c.s.outputs.len > 0 { Ok(()) } else { Err(not_applicable("it has no outputs")) }
}

fn needs(al: Al, state: AlState, by: &'static str) -> Done {
    if al.is(state) {
        Ok(())
    } else {
        Err(Stop::Blocked { by, why: format!("{state} is not reached: {al}") })
    }
}

fn no_sync0(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    let cycle = c.cycle();
    c.prepare(c.mode, cycle)?;
    // SYNC0 is armed, but starts only after the request for OP has timed out.
    let far = Nanos::millis(30_000);
    let cycles = c.mode.pulses(usual(c));
    c.t.start_sync(c.mode.activation, cycles, far)?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    needs(al, AlState::SafeOp, "MODE-02")?;
    c.exchange(cycle, None);
    c.t.run(5)?;
    let al = c.t.change(AlState::Op, OP_PATIENCE)?;
    let codes = [AlStatusCode::NO_SYNC, AlStatusCode::PLL_ERROR, AlStatusCode::DC_SYNC_TIMEOUT];
    must_refuse(c, "OP without SYNC0", al, AlState::SafeOp, &codes);
    Ok(())
}

fn no_outputs(c: &mut Case<'_, '_>) -> Done {
    with_outputs(c)?;
    c.prepare(c.mode, c.cycle())?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    needs(al, AlState::SafeOp, "MODE-02")?;
    c.t.pause(LEAD_IN)?;
    let al = c.t.change(AlState::Op, OP_PATIENCE)?;
    must_refuse(c, "OP without outputs", al, AlState::SafeOp, &[AlStatusCode::WATCHDOG]);
    Ok(())
}

fn no_order(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    with_outputs(c)?;
    c.safe_op(c.mode, c.cycle())?;
    c.t.run(20)?;
    c.t.request(AlControl::request(AlState::Op))?;
    let end = c.t.now() + OP_PATIENCE;
    // Only every third frame is sent, which is too few for every way of counting.
    let al = loop {
        c.t.turn(Turn::Send)?;
        c.t.turn(Turn::Skip)?;
        c.t.turn(Turn::Skip)?;
        let Some(exchange) = &c.t.exchange else { return Ok(()) };
        let al = exchange.al;
        if al.status.error() || al.is(AlState::Op) || c.t.now() > end {
            break al;
        }
    };
    let codes = [AlStatusCode::SYNCHRONIZATION_ERROR, AlStatusCode::DC_SYNC_TIMEOUT];
    must_refuse(c, "OP with every third frame", al, AlState::SafeOp, &codes);
    Ok(())
}

fn watchdog(c: &mut Case<'_, '_>) -> Done {
    with_outputs(c)?;
    if c.mode.uses_dc() {
        return Err(not_applicable("with SYNC0 the order is lost before"));
    }
    if c.s.sync_manager(c.s.outputs.sm).control & SyncManager::CONTROL_WATCHDOG == 0 {
        return Err(not_applicable("its SII asks for no watchdog"));
    }
    c.op_here()?;
    let al = starve(c)?;
    must_refuse(c, "200 ms without outputs", al, AlState::SafeOp, &[AlStatusCode::WATCHDOG]);
    Ok(())
}

/// Sends no process data for twice the usual watchdog time.
pub(super) fn starve(c: &mut Case<'_, '_>) -> Result<Al, Stop> {
    c.t.silence(Nanos::millis(200))?;
    Ok(c.t.al()?)
}

fn order_lost(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    with_outputs(c)?;
    c.op_here()?;
    // These frames are left out for a shorter time than the watchdog's.
    for _ in 0..MOST_MISSED {
        c.t.turn(Turn::Skip)?;
    }
    let al = c.t.al()?;
    let codes = [AlStatusCode::SYNCHRONIZATION_ERROR, AlStatusCode::DC_SYNC_TIMEOUT];
    must_refuse(c, "20 cycles without outputs", al, AlState::SafeOp, &codes);
    Ok(())
}

fn sync0_lost(c: &mut Case<'_, '_>) -> Done {
    dc_only(c)?;
    c.op_here()?;
    let al = stop_sync0(c)?;
    let codes = [
        AlStatusCode::FATAL_SYNC_ERROR,
        AlStatusCode::PLL_ERROR,
        AlStatusCode::DC_SYNC_IO_ERROR,
        AlStatusCode::DC_SYNC_TIMEOUT,
    ];
    must_refuse(c, "0x0981 = 0 in OP", al, AlState::SafeOp, &codes);
    Ok(())
}

/// Switches SYNC0 off while frames continue.
pub(super) fn stop_sync0(c: &mut Case<'_, '_>) -> Result<Al, Stop> {
    c.t.write(register::CYCLIC_UNIT_CONTROL.address, &[0, 0])?;
    c.t.run(50)?;
    Ok(c.t.al()?)
}

const MOST_MISSED: usize = 20;
