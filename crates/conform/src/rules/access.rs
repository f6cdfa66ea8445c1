//! ACC and REF: which entries may be read and written in which state, and which values are refused.

use isocat_sync::object::{
    INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, sub,
};
use isocat_wire::coe::info::Access;
use isocat_wire::{AbortCode, AlState, ObjectAddress};

use super::{Check, Rule};
use crate::case::{Case, Done, not_applicable};
use crate::subject::SyncObject;
use crate::tester::number;

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "ACC-01",
        what: "what the access word calls readable can be read in PREOP, SAFEOP and OP",
        source: "ETG.1020 0x1C32, 0x1C33; SDO information, access",
        applies: "devices with sync objects",
        check: Check::Once(readable),
    },
    Rule {
        id: "ACC-02",
        what: "what the access word calls read only refuses a write and keeps its value",
        source: "ETG.1020 0x1C32, 0x1C33; SDO abort 0x06010002",
        applies: "devices with sync objects",
        check: Check::Once(read_only),
    },
    Rule {
        id: "ACC-03",
        what: "what the access word calls writable in PREOP takes its own value back",
        source: "ETG.1020 0x1C32, 0x1C33; SDO information, access",
        applies: "devices with sync objects",
        check: Check::Once(writable),
    },
    Rule {
        id: "ACC-04",
        what: "another type in OP is refused, or the SubDevice switches to it",
        source: "ETG.1020 0x1C32:01; SDO abort 0x08000022",
        applies: "devices whose 0x1C32:01 can be written",
        check: Check::Once(type_in_op),
    },
    Rule {
        id: "ACC-05",
        what: "the PDO assignment can't be changed in SAFEOP",
        source: "ETG.1020 0x1C12, 0x1C13; SDO abort 0x08000022",
        applies: "devices whose assignment can be written",
        check: Check::Once(assignment_in_safe_op),
    },
    Rule {
        id: "ACC-06",
        what: "the command 08 can be written in OP",
        source: "ETG.1020 0x1C32:08",
        applies: "devices with dynamic times, or whose 08 is writable",
        check: Check::Once(command_in_op),
    },
    Rule {
        id: "REF-01",
        what: "an unknown type is refused, and the old one stays",
        source: "ETG.1020 0x1C32:01, 0x1C33:01; SDO abort 0x06090030",
        applies: "devices whose 0x1C32:01 can be written",
        check: Check::Once(unknown_type),
    },
    Rule {
        id: "REF-02",
        what: "a type that 04 does not announce is refused, the old one stays",
        source: "ETG.1020 0x1C32:01, 0x1C32:04; SDO abort 0x06090030",
        applies: "devices whose 0x1C32:01 can be written",
        check: Check::Once(unsupported_type),
    },
    Rule {
        id: "REF-03",
        what: "0x22 stands in 0x1C33:01 only, and 1 only without outputs",
        source: "ETG.1020 0x1C33:01; SDO abort 0x06090030",
        applies: "devices with outputs whose types can be written",
        check: Check::Once(types_of_inputs),
    },
    Rule {
        id: "REF-04",
        what: "too many bytes are refused",
        source: "ETG.1000.6, SDO abort 0x06070012 or 0x06070010; 0x1C32:08",
        applies: "devices with 0x1C32:08",
        check: Check::Once(too_long),
    },
    Rule {
        id: "REF-05",
        what: "0x1C12 and 0x1C13 refuse what is no PDO of their direction",
        source: "ETG.1020 0x1C12, 0x1C13; SDO abort 0x06090030",
        applies: "devices whose assignment can be written",
        check: Check::Once(no_pdo),
    },
    Rule {
        id: "REF-06",
        what: "an assigned PDO can't be changed while sub-index 0 is not 0",
        source: "ETG.1020 0x1C12, 0x1C13; SDO abort 0x06010003",
        applies: "devices whose assignment can be written",
        check: Check::Once(count_not_zero),
    },
    Rule {
        id: "REF-07",
        what: "sub-index 0 of the assignment refuses more than there are slots",
        source: "ETG.1020 0x1C12, 0x1C13; SDO abort 0x06090031 or 0x06090030",
        applies: "devices whose assignment can be written",
        check: Check::Once(too_many),
    },
    Rule {
        id: "REF-08",
        what: "a slot of the assignment that does not exist is refused",
        source: "ETG.1020 0x1C12, 0x1C13; SDO abort 0x06090011",
        applies: "devices whose assignment can be written",
        check: Check::Once(no_slot),
    },
];

const STATES: [AlState; 3] = [AlState::PreOp, AlState::SafeOp, AlState::Op];

/// Goes to a state, in the first mode that the SubDevice has.
fn in_state(c: &mut Case<'_, '_>, state: AlState) -> Done {
    match state {
        AlState::PreOp => c.preop_with_objects(),
        AlState::SafeOp => {
            let mode = c.any_mode()?;
            c.safe_op(mode, c.cycle())
        }
        _ => c.enter_op(),
    }
}

fn readable(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    for (step, state) in STATES.into_iter().enumerate() {
        in_state(c, state)?;
        for object in c.s.sync_objects() {
            for entry in object.entries.iter().filter(|entry| entry.description.data_type != 0) {
                if entry.description.access.0 >> step & 1 == 0 {
                    continue;
                }
                let at = object.at(entry.sub);
                let found = c.t.upload(at)?;
                let text = found.as_ref().map_or_else(ToString::to_string, |_| "a value".into());
                c.expect(format!("{at} in {state}"), "a value", text, found.is_ok());
            }
        }
    }
    Ok(())
}

fn read_only(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    c.preop_with_objects()?;
    for object in c.s.sync_objects() {
        for entry in &object.entries {
            if entry.value.is_none() || entry.description.access.has_any(Access::WRITE) {
                continue;
            }
            let at = object.at(entry.sub);
            let Ok(value) = c.t.upload(at)? else { continue };
            let mut other = value.clone();
            let Some(first) = other.first_mut() else { continue };
            *first ^= 1;
            let found = c.t.download(at, &other)?;
            c.aborts(at, &found, &[AbortCode::READ_ONLY]);
            let after = c.t.value(at)?;
            let same = after == Some(number(&value));
            c.expect(at, "unchanged", if same { "unchanged" } else { "changed" }, same);
        }
    }
    Ok(())
}

fn writable(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    c.preop_with_objects()?;
    for object in c.s.sync_objects() {
        for entry in &object.entries {
            let Some(value) = &entry.value else { continue };
            // The default type may not fit the default assignment.
            if !entry.description.access.has_any(Access::WRITE_PREOP) || entry.sub == sub::SYNC_TYPE
            {
                continue;
            }
            let at = object.at(entry.sub);
            let found = c.t.download(at, value)?;
            let text = found.map_or_else(|code| code.to_string(), |()| "accepted".to_owned());
            c.expect(at, "accepted", text, found.is_ok());
        }
    }
    match c.evidence.is_empty() {
        true => Err(not_applicable("nothing can be written")),
        false => Ok(()),
    }
}

fn chooses(c: &Case<'_, '_>) -> Done {
    c.leading()?;
    match c.s.chooses_type() {
        true => Ok(()),
        false => Err(not_applicable("0x1C32:01 is read only")),
    }
}

fn type_in_op(c: &mut Case<'_, '_>) -> Done {
    chooses(c)?;
    let mode = c.any_mode()?;
    c.op(mode, c.cycle())?;
    let object = c.leading()?.clone();
    let at = object.at(sub::SYNC_TYPE);
    let before = c.t.value(at)?;
    // Any other type that the SubDevice announces; without one, a type that it does not announce.
    let others = c.s.modes.iter().map(|mode| c.sync_type(&object, *mode));
    let other = others.map(u64::from).find(|t| Some(*t) != before).unwrap_or(2);
    let found = c.t.download(at, &(other as u16).to_le_bytes())?;
    let after = c.t.value(at)?;
    if found.is_ok() {
        let text = after.map_or("nothing".to_owned(), |after| after.to_string());
        c.expect(format!("{at} in OP, accepted"), other, text, after == Some(other));
        c.notes.push("it takes another type in OP".to_owned());
    } else {
        c.aborts(format!("{at} in OP"), &found, &[AbortCode::WRONG_STATE, AbortCode::VALUE_RANGE]);
        let same = after == before;
        c.expect(at, "unchanged", if same { "unchanged" } else { "changed" }, same);
        c.notes.push("it refuses another type in OP".to_owned());
    }
    Ok(())
}

/// The assignment objects that can be written, each with its slots and one PDO of its direction.
fn assignments(c: &mut Case<'_, '_>) -> Result<Vec<(u16, u8, u16)>, crate::case::Stop> {
    if c.s.coe.is_none() {
        return Err(not_applicable("it has no CoE mailbox"));
    }
    let s = c.s;
    let all = [(OUTPUT_ASSIGNMENT, &s.outputs), (INPUT_ASSIGNMENT, &s.inputs)];
    let writable = all.into_iter().filter(|(_, direction)| direction.writable);
    let found: Vec<_> =
        writable.filter_map(|(index, d)| Some((index, d.slots, *d.pdos.first()?))).collect();
    if found.is_empty() {
        return Err(not_applicable("its assignment is fixed"));
    }
    Ok(found)
}

fn assignment_in_safe_op(c: &mut Case<'_, '_>) -> Done {
    let all = assignments(c)?;
    let mode = c.any_mode()?;
    c.safe_op(mode, c.cycle())?;
    for (index, ..) in all {
        let at = ObjectAddress::new(index, 0);
        let before = c.t.value(at)?;
        let found = c.t.download(at, &[0])?;
        c.aborts(format!("{at} in SAFEOP"), &found, &[AbortCode::WRONG_STATE]);
        let same = c.t.value(at)? == before;
        c.expect(at, "unchanged", if same { "unchanged" } else { "changed" }, same);
    }
    Ok(())
}

fn command_in_op(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    // Some devices have 08 as read only and measure nothing.
    let with = |object: &&SyncObject| {
        let dynamic = object.types().dynamic_times();
        object.entry(sub::GET_CYCLE_TIME).is_some()
            && (dynamic || object.writable(sub::GET_CYCLE_TIME))
    };
    if c.s.sync_objects().find(with).is_none() {
        return Err(not_applicable("it has no sub-index 08 that measures"));
    }
    let mode = c.any_mode()?;
    c.op(mode, c.cycle())?;
    for object in c.s.sync_objects().filter(with) {
        let at = object.at(sub::GET_CYCLE_TIME);
        let found = c.t.download(at, &[0, 0])?;
        let text = found.map_or_else(|code| code.to_string(), |()| "accepted".to_owned());
        c.expect(format!("{at} in OP"), "accepted", text, found.is_ok());
    }
    Ok(())
}

/// Writes a type that the device must refuse.
fn refuses_type(c: &mut Case<'_, '_>, at: ObjectAddress, wrong: u16) -> Done {
    let before = c.t.value(at)?;
    let found = c.t.download(at, &wrong.to_le_bytes())?;
    c.aborts(format!("{at} = {wrong:#x}"), &found, &[AbortCode::VALUE_RANGE]);
    let same = c.t.value(at)? == before;
    c.expect(at, "unchanged", if same { "unchanged" } else { "changed" }, same);
    Ok(())
}

fn unknown_type(c: &mut Case<'_, '_>) -> Done {
    chooses(c)?;
    c.preop_with_objects()?;
    c.assign()?;
    for object in c.s.sync_objects() {
        for wrong in [0x7F, 0xFFFF] {
            refuses_type(c, object.at(sub::SYNC_TYPE), wrong)?;
        }
    }
    Ok(())
}

fn unsupported_type(c: &mut Case<'_, '_>) -> Done {
    chooses(c)?;
    c.preop_with_objects()?;
    c.assign()?;
    for object in c.s.sync_objects() {
        // A device that announces no types does not say which ones it refuses.
        let Some(types) = object.value(sub::SUPPORTED_TYPES).filter(|types| types & 0x1F != 0)
        else {
            continue;
        };
        let sm = if object.index == OUTPUT_PARAMETER { 1 } else { 0x22 };
        for (bit, wrong) in [(1, sm), (2, 2), (3, 3)] {
            if types >> bit & 1 == 0 {
                refuses_type(c, object.at(sub::SYNC_TYPE), wrong)?;
            }
        }
    }
    match c.evidence.is_empty() {
        true => Err(not_applicable("it announces all types, or none")),
        false => Ok(()),
    }
}

fn types_of_inputs(c: &mut Case<'_, '_>) -> Done {
    chooses(c)?;
    if c.s.outputs.len == 0 || c.s.types() & 2 == 0 {
        return Err(not_applicable("it has no outputs, or is not SM-synchronous"));
    }
    c.preop_with_objects()?;
    c.assign()?;
    refuses_type(c, ObjectAddress::new(OUTPUT_PARAMETER, sub::SYNC_TYPE), 0x22)?;
    if c.s.inputs.len > 0 {
        refuses_type(c, ObjectAddress::new(INPUT_PARAMETER, sub::SYNC_TYPE), 1)?;
    }
    Ok(())
}

fn too_long(c: &mut Case<'_, '_>) -> Done {
    let object = c.leading()?.clone();
    if !object.writable(sub::GET_CYCLE_TIME) {
        return Err(not_applicable("it has no sub-index 08"));
    }
    c.preop_with_objects()?;
    let at = object.at(sub::GET_CYCLE_TIME);
    let found = c.t.download(at, &[0; 4])?;
    c.aborts(at, &found, &[AbortCode::TOO_LONG, AbortCode::LENGTH_MISMATCH]);
    Ok(())
}

fn no_pdo(c: &mut Case<'_, '_>) -> Done {
    let all = assignments(c)?;
    c.preop_with_objects()?;
    for (index, ..) in all {
        let at = |sub| ObjectAddress::new(index, sub);
        c.must_write(at(0), &[0])?;
        let other = if index == OUTPUT_ASSIGNMENT { 0x1A00u16 } else { 0x1600 };
        for wrong in [0x2000u16, other] {
            let found = c.t.download(at(1), &wrong.to_le_bytes())?;
            c.aborts(format!("{} = 0x{wrong:04X}", at(1)), &found, &[AbortCode::VALUE_RANGE]);
        }
    }
    Ok(())
}

fn count_not_zero(c: &mut Case<'_, '_>) -> Done {
    let all = assignments(c)?;
    c.preop_with_objects()?;
    c.assign()?;
    for (index, _, pdo) in all {
        let at = ObjectAddress::new(index, 1);
        let other = pdo ^ 1;
        let found = c.t.download(at, &other.to_le_bytes())?;
        c.aborts(at, &found, &[AbortCode::SUB0_NOT_ZERO]);
        let same = c.t.value(at)? == Some(u64::from(pdo));
        c.expect(at, "unchanged", if same { "unchanged" } else { "changed" }, same);
    }
    Ok(())
}

fn too_many(c: &mut Case<'_, '_>) -> Done {
    let all = assignments(c)?;
    c.preop_with_objects()?;
    for (index, slots, _) in all {
        let at = ObjectAddress::new(index, 0);
        if slots == u8::MAX {
            continue;
        }
        let found = c.t.download(at, &[slots + 1])?;
        c.aborts(at, &found, &[AbortCode::TOO_HIGH, AbortCode::VALUE_RANGE]);
    }
    Ok(())
}

fn no_slot(c: &mut Case<'_, '_>) -> Done {
    let all = assignments(c)?;
    c.preop_with_objects()?;
    for (index, slots, pdo) in all {
        if slots == u8::MAX {
            continue;
        }
        let at = ObjectAddress::new(index, slots + 1);
        c.must_write(ObjectAddress::new(index, 0), &[0])?;
        let found = c.t.download(at, &pdo.to_le_bytes())?;
        c.aborts(at, &found, &[AbortCode::NO_SUBINDEX]);
    }
    Ok(())
}
