//! OBJ: the objects exist, have their types, and complete access agrees with single reads.

use isocat_sync::object::{
    INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, SM_COMMUNICATION_TYPE,
    sub,
};
use isocat_sync::table::{self, Condition, Need, Rights};
use isocat_sync::{SupportedTypes, object::ERROR_SETTINGS};
use isocat_wire::{AbortCode, AlState, ObjectAddress};

use super::{Check, Rule};
use crate::case::{Case, Done, STATE_PATIENCE, not_applicable};
use crate::subject::{Entry, SyncObject};
use crate::tester::number;

pub(super) const RULES: &[Rule] = &[
    Rule {
        id: "OBJ-01",
        what: "0x1C00 says what each SyncManager is for: 1, 2, 3, 4, or 0 if nothing goes through it",
        source: "ETG.1020 0x1C00",
        applies: "devices with CoE",
        check: Check::Once(communication_type),
    },
    Rule {
        id: "OBJ-02",
        what: "0x1C12 and 0x1C13 are lists of UNSIGNED16, with a count of UNSIGNED8",
        source: "ETG.1020 0x1C12, 0x1C13",
        applies: "devices with CoE",
        check: Check::Once(assignments),
    },
    Rule {
        id: "OBJ-03",
        what: "0x1C32 and 0x1C33 exist, each sub-index with its type",
        source: "ETG.1020 0x1C32, 0x1C33",
        applies: "devices with CoE",
        check: Check::Once(types),
    },
    Rule {
        id: "OBJ-04",
        what: "each announced mode has the sub-indices that are mandatory in it",
        source: "ETG.1020, table of the sync objects per mode",
        applies: "every mode, devices with sync objects",
        check: Check::EachMode(mandatory),
    },
    Rule {
        id: "OBJ-05",
        what: "sub-index 20 exists where 0B, 0C or 0D does",
        source: "ETG.1020 0x1C32:20, 0x1C33:20",
        applies: "devices with counters",
        check: Check::Once(sync_error_exists),
    },
    Rule {
        id: "OBJ-06",
        what: "sub-index 08 exists where 04 announces dynamic times",
        source: "ETG.1020 0x1C32:08, 0x1C32:04 bit 14",
        applies: "devices with dynamic times",
        check: Check::Once(command_exists),
    },
    Rule {
        id: "OBJ-07",
        what: "complete access gives what single reads give, in the places of SDO information or ETG.1020",
        source: "ETG.1020 0x1C32, 0x1C33; ETG.1000.6 complete access",
        applies: "devices with sync objects and complete access",
        check: Check::Once(complete_access),
    },
    Rule {
        id: "OBJ-08",
        what: "sub-index 00 tells a highest sub-index while the object is in use",
        source: "ETG.1020 0x1C32:00, 0x1C33:00",
        applies: "devices with sync objects",
        check: Check::Once(highest),
    },
    Rule {
        id: "OBJ-09",
        what: "0x1C33:05 has the value of 0x1C32:05",
        source: "ETG.1020 0x1C33:05",
        applies: "devices with both",
        check: Check::Once(same_minimum),
    },
    Rule {
        id: "OBJ-10",
        what: "04 announces some mode, and no reserved bits or shift",
        source: "ETG.1020 0x1C32:04",
        applies: "devices with sync objects",
        check: Check::Once(supported),
    },
    Rule {
        id: "OBJ-11",
        what: "what an announced mode needs writable can be written, what all leave read only can't",
        source: "ETG.1020, table of access per mode",
        applies: "every mode, devices with sync objects",
        check: Check::EachMode(rights),
    },
    Rule {
        id: "OBJ-12",
        what: "the minimum delay 07 is no longer than 09, and less than 1 us shorter",
        source: "ETG.1020 0x1C32:07, 0x1C32:09",
        applies: "devices with 0x1C32:07 that is not 0",
        check: Check::Once(delays),
    },
    Rule {
        id: "OBJ-13",
        what: "0x10F1 has its types: 01 UNSIGNED32, 02 UNSIGNED16 (older: UNSIGNED32)",
        source: "ETG.1020 0x10F1",
        applies: "devices with 0x10F1",
        check: Check::Once(error_settings),
    },
    Rule {
        id: "OBJ-14",
        what: "a sub-index that does not exist is refused",
        source: "ETG.1000.6, SDO abort 0x06090011; 0x1C32:1F",
        applies: "devices with sync objects",
        check: Check::Once(no_sub_index),
    },
    Rule {
        id: "OBJ-15",
        what: "an object that does not exist is refused",
        source: "ETG.1000.6, SDO abort 0x06020000",
        applies: "devices with CoE",
        check: Check::Once(no_object),
    },
    Rule {
        id: "OBJ-16",
        what: "a direction that is not transmitted is hidden as a whole, or not at all",
        source: "ETG.1020 0x1C32:00, 0x1C33:00",
        applies: "devices whose 0x1C12 can be emptied",
        check: Check::Once(hidden),
    },
];

/// Data type codes of the sub-indices.
const U8: u16 = 0x05;
const U16: u16 = 0x06;
const U32: u16 = 0x07;
const BOOLEAN: u16 = 0x01;

fn type_of(sub_index: u8) -> Option<&'static [u16]> {
    Some(match sub_index {
        0 => &[U8],
        sub::SYNC_TYPE | sub::SUPPORTED_TYPES | sub::GET_CYCLE_TIME => &[U16],
        sub::SM_EVENT_MISSED..=sub::TOGGLE_FAILED => &[U16],
        sub::SYNC0_CYCLE_TIME => &[U32],
        1..=sub::MAXIMUM_SM_SYNC_DISTANCE => &[U32],
        // Some devices state UNSIGNED8.
        sub::SYNC_ERROR => &[BOOLEAN, U8],
        _ => return None,
    })
}

fn communication_type(c: &mut Case<'_, '_>) -> Done {
    c.preop_with_objects()?;
    let at = |sub| ObjectAddress::new(SM_COMMUNICATION_TYPE, sub);
    let count = c.t.value(at(0))?.unwrap_or(0);
    c.expect(at(0), "4 or more", count, count >= 4);
    let unused = |sub| sub == 3 && c.s.outputs.len == 0 || sub == 4 && c.s.inputs.len == 0;
    for (sub, unused) in (1..=4).map(|sub| (sub, unused(sub))) {
        let found = c.t.upload(at(sub))?.map_or_else(|code| code.to_string(), |data| hex(&data));
        let right = hex(&[sub]);
        if unused {
            let none = hex(&[0]);
            let fits = found == right || found == none;
            c.expect(at(sub), format!("{right} or {none}"), &found, fits);
        } else {
            c.expect(at(sub), &right, &found, right == found);
        }
    }
    Ok(())
}

fn assignments(c: &mut Case<'_, '_>) -> Done {
    c.preop_with_objects()?;
    for (index, used) in
        [(OUTPUT_ASSIGNMENT, c.s.outputs.len > 0), (INPUT_ASSIGNMENT, c.s.inputs.len > 0)]
    {
        if !used {
            continue;
        }
        for (sub, wanted) in [(0, U8), (1, U16)] {
            has_type(c, ObjectAddress::new(index, sub), &[wanted])?;
        }
    }
    Ok(())
}

fn has_type(c: &mut Case<'_, '_>, at: ObjectAddress, wanted: &[u16]) -> Done {
    let names: Vec<_> = wanted.iter().map(|code| type_name(*code)).collect();
    let (found, right) = match c.t.describe_entry(at)? {
        Ok(entry) => {
            let bits = isocat_wire::coe::DataType(entry.data_type).bits();
            let fits = bits.is_none_or(|bits| bits == entry.bits);
            let found = format!("{} of {} bits", type_name(entry.data_type), entry.bits);
            (found, fits && wanted.contains(&entry.data_type))
        }
        Err(code) => (code.to_string(), false),
    };
    c.expect(at, names.join(" or "), found, right);
    Ok(())
}

fn type_name(code: u16) -> String {
    isocat_wire::coe::DataType(code).name().map_or(format!("type 0x{code:04X}"), str::to_owned)
}

fn types(c: &mut Case<'_, '_>) -> Done {
    c.preop_with_objects()?;
    for (index, used) in
        [(OUTPUT_PARAMETER, c.s.outputs.len > 0), (INPUT_PARAMETER, c.s.inputs.len > 0)]
    {
        let object = c.s.sync_objects().find(|object| object.index == index);
        let Some(object) = object else {
            if used {
                c.expect(format!("0x{index:04X}"), "the object", "nothing", false);
            }
            continue;
        };
        for entry in &object.entries {
            if entry.description.data_type == 0 {
                continue;
            }
            if let Some(wanted) = type_of(entry.sub) {
                has_type(c, object.at(entry.sub), wanted)?;
            }
        }
    }
    Ok(())
}

fn mandatory(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    c.preop_with_objects()?;
    let more_modes = c.s.modes.len() > 1;
    if c.mode.bit == 0 && !more_modes {
        return Err(not_applicable("Free Run alone asks for no sub-index"));
    }
    for object in c.s.live_objects() {
        for sub in table::SUBS {
            let Some(cell) = table::lookup(object.index, sub, c.column(object)) else { continue };
            let wanted = match cell.need {
                Need::Mandatory => true,
                Need::Conditional(Condition::MoreThanFreeRun) => more_modes,
                // OBJ-05 and OBJ-06 check these.
                Need::Conditional(_) | Need::Optional | Need::None => false,
            };
            if wanted {
                let found = c.t.upload(object.at(sub))?;
                let text = found.as_ref().map_or_else(ToString::to_string, |_| "there".to_owned());
                c.expect(object.at(sub), "there", text, found.is_ok());
            }
        }
    }
    Ok(())
}

fn sync_error_exists(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    for object in c.s.sync_objects() {
        let counters = [sub::SM_EVENT_MISSED, sub::CYCLE_TIME_TOO_SMALL, sub::SHIFT_TIME_TOO_SHORT];
        if counters.iter().any(|sub| object.entry(*sub).is_some()) {
            exists(c, object, sub::SYNC_ERROR);
        }
    }
    if c.evidence.is_empty() { Err(not_applicable("it has no counters")) } else { Ok(()) }
}

fn command_exists(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    for object in c.s.sync_objects() {
        if object.types().dynamic_times() {
            exists(c, object, sub::GET_CYCLE_TIME);
        }
    }
    if c.evidence.is_empty() { Err(not_applicable("its times are not dynamic")) } else { Ok(()) }
}

fn exists(c: &mut Case<'_, '_>, object: &SyncObject, sub: u8) {
    let there = object.entry(sub).is_some();
    c.expect(object.at(sub), "there", if there { "there" } else { "not there" }, there);
}

/// The bit offset of a sub-index in 0x1C32 and 0x1C33 by ETG.1020.
fn usual_place(sub_index: u8) -> Option<usize> {
    const PLACES: [usize; 19] =
        [0, 16, 32, 64, 96, 112, 144, 176, 208, 224, 256, 288, 304, 320, 336, 352, 384, 416, 448];
    PLACES.get(usize::from(sub_index)).copied()
}

/// The bit offsets of entries with gaps between them: those of ETG.1020 for the sub-indices that it
/// has. For later ones (20, and those that makers add), the first byte from which on the value is
/// found. `None`: it is not found.
fn places_with_gaps(whole: &[u8], entries: &[Entry]) -> Vec<Option<usize>> {
    let mut end = 0;
    let mut places = Vec::new();
    for entry in entries {
        let bits = usize::from(entry.description.bits);
        let place = match (usual_place(entry.sub), &entry.value) {
            (Some(place), _) => Some(place),
            (None, Some(value)) => (end..whole.len() * 8)
                .step_by(8)
                .find(|place| bits_at(whole, *place, bits) == Some(number(value))),
            (None, None) => None,
        };
        end = place.map_or(end, |place| place + bits.next_multiple_of(8));
        places.push(place);
    }
    places
}

fn complete_access(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    c.preop_with_objects()?;
    for object in c.s.sync_objects() {
        let whole = match c.t.upload_complete(object.index, 0)? {
            Ok(whole) => whole,
            Err(AbortCode::UNSUPPORTED_ACCESS | AbortCode::NO_COMPLETE_ACCESS) => {
                return Err(not_applicable("it has no complete access"));
            }
            Err(code) => {
                c.expect(format!("0x{:04X}", object.index), "its bytes", code, false);
                continue;
            }
        };
        // The places without gaps: one entry after another, with sub-index 0 in 16 bits.
        let mut at = 0;
        let mut places = Vec::new();
        for entry in &object.entries {
            places.push(Some(at));
            at += if entry.sub == 0 { 16 } else { usize::from(entry.description.bits) };
        }
        let in_order = at.div_ceil(8) == whole.len();
        if !in_order {
            places = places_with_gaps(&whole, &object.entries);
        }
        let mut wrong = Vec::new();
        for (entry, place) in object.entries.iter().zip(places) {
            let Some(value) = &entry.value else { continue };
            let bits = usize::from(entry.description.bits);
            let found = place.and_then(|place| bits_at(&whole, place, bits));
            if found != Some(number(value)) && bits <= 64 {
                wrong.push(format!("{:02X}", entry.sub));
            }
        }
        let found = match wrong.is_empty() {
            true => "all equal".to_owned(),
            false => format!("{} bytes; others at {}", whole.len(), wrong.join(", ")),
        };
        let place = format!("0x{:04X} complete", object.index);
        c.expect(place, "every sub-index as read alone", found, wrong.is_empty());
        c.notes.push(format!(
            "0x{:04X}: {} bytes, {}",
            object.index,
            whole.len(),
            if in_order {
                "as SDO information describes"
            } else {
                "the places of ETG.1020, with gaps"
            }
        ));
        // Complete access from sub-index 1 on must give the same without the first two bytes.
        let rest = c.t.upload_complete(object.index, 1)?;
        let same = rest.as_ref().is_ok_and(|rest| Some(&rest[..]) == whole.get(2..));
        let found = if same { "the same" } else { "something else" };
        c.expect(format!("0x{:04X} complete from 01", object.index), "the same", found, same);
    }
    Ok(())
}

fn bits_at(bytes: &[u8], place: usize, bits: usize) -> Option<u64> {
    let mut value = 0;
    for bit in 0..bits.min(64) {
        let at = place.checked_add(bit)?;
        value |= u64::from(bytes.get(at / 8)? >> (at % 8) & 1) << bit;
    }
    Some(value)
}

fn highest(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    for object in c.s.sync_objects() {
        let found = object.value(0).unwrap_or(0);
        c.expect(object.at(0), "1 or more", found, found >= 1);
        c.notes.push(format!("{} = {found}", object.at(0)));
    }
    Ok(())
}

fn same_minimum(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    let values: Vec<_> = (c.s.sync_objects())
        .filter_map(|object| Some((object, object.value(sub::MINIMUM_CYCLE_TIME)?)))
        .collect();
    let [(_, first), (second, found)] = values[..] else {
        return Err(not_applicable("it does not have both"));
    };
    c.equal(second.at(sub::MINIMUM_CYCLE_TIME), first, found);
    Ok(())
}

fn supported(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    for object in c.s.sync_objects() {
        let Some(value) = object.value(sub::SUPPORTED_TYPES) else { continue };
        let types = SupportedTypes(value as u16);
        // Bit 9 is an old hint that delays are measured, bit 15 one of old stacks.
        let right = value & 0x1F != 0
            && value & 0x3180 == 0
            && types.shift() != isocat_sync::object::ShiftBy::Reserved;
        c.expect(object.at(sub::SUPPORTED_TYPES), "modes, no reserved bit", types, right);
    }
    Ok(())
}

fn rights(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    for object in c.s.live_objects() {
        for sub in table::SUBS.into_iter().filter(|sub| object.entry(*sub).is_some()) {
            let Some(cell) = table::lookup(object.index, sub, c.column(object)) else { continue };
            let dynamic = object.types().dynamic_times();
            if cell.need == Need::Conditional(Condition::DynamicTimes) && !dynamic {
                // Some devices have the entry and measure nothing.
                continue;
            }
            let found = object.writable(sub);
            let words = |writable| if writable { "writable" } else { "read only" };
            let others = c.s.modes.len() > 1;
            match cell.rights {
                // In another mode the entry may still be writable.
                Rights::Read if !others => {
                    c.expect(object.at(sub), words(false), words(found), !found)
                }
                Rights::ReadWrite => c.expect(object.at(sub), words(true), words(found), found),
                Rights::Read | Rights::Either | Rights::None => {}
            }
        }
    }
    match c.evidence.is_empty() {
        true => Err(not_applicable("it leaves either open")),
        false => Ok(()),
    }
}

fn delays(c: &mut Case<'_, '_>) -> Done {
    c.leading()?;
    let object = c.s.sync_objects().find(|object| object.index == OUTPUT_PARAMETER);
    let Some(object) = object else { return Err(not_applicable("it has no 0x1C32")) };
    let value = |sub| object.value(sub).filter(|value| *value > 0);
    let (Some(least), Some(most)) = (value(sub::MINIMUM_DELAY_TIME), value(sub::DELAY_TIME)) else {
        return Err(not_applicable("it does not state both"));
    };
    let right = least <= most && most - least < 1_000;
    let expected = format!("{} to {most} ns", most.saturating_sub(999));
    c.expect(object.at(sub::MINIMUM_DELAY_TIME), expected, format!("{least} ns"), right);
    Ok(())
}

fn error_settings(c: &mut Case<'_, '_>) -> Done {
    if c.s.coe.as_ref().is_none_or(|coe| coe.error_limit.is_none()) {
        return Err(not_applicable("it has no 0x10F1"));
    }
    c.preop_with_objects()?;
    has_type(c, ObjectAddress::new(ERROR_SETTINGS, 1), &[U32])?;
    has_type(c, ObjectAddress::new(ERROR_SETTINGS, 2), &[U16, U32])
}

fn no_sub_index(c: &mut Case<'_, '_>) -> Done {
    let object = c.leading()?.clone();
    c.preop_with_objects()?;
    // A sub-index beyond those of all known devices.
    let at = object.at(0xF0);
    let found = c.t.upload(at)?;
    c.aborts(at, &found, &[AbortCode::NO_SUBINDEX]);
    // A gap may have a description.
    let gap = object.at(0x1F);
    let found = c.t.upload(gap)?;
    if object.entry(0x1F).is_none() {
        c.aborts(gap, &found, &[AbortCode::NO_SUBINDEX, AbortCode::UNSUPPORTED_ACCESS]);
    }
    Ok(())
}

fn no_object(c: &mut Case<'_, '_>) -> Done {
    c.preop_with_objects()?;
    // The parameter object of SM15.
    let at = ObjectAddress::new(0x1C3F, 1);
    let found = c.t.upload(at)?;
    c.aborts(at, &found, &[AbortCode::NO_OBJECT]);
    Ok(())
}

fn hidden(c: &mut Case<'_, '_>) -> Done {
    if !c.s.outputs.writable || c.s.inputs.len == 0 {
        return Err(not_applicable("its outputs can't be left out"));
    }
    let Some(object) = c.s.sync_objects().find(|object| object.index == OUTPUT_PARAMETER) else {
        return Err(not_applicable("it has no 0x1C32"));
    };
    c.preop_with_objects()?;
    c.assign()?;
    c.write_assignment(OUTPUT_ASSIGNMENT, &[])?;
    let mut without = c.s.clone();
    without.outputs.len = 0;
    c.process_data_of(&without)?;
    let al = c.t.change(AlState::SafeOp, STATE_PATIENCE)?;
    if !al.is(AlState::SafeOp) {
        return Err(not_applicable(format!("it needs its outputs: {al}")));
    }
    let count = c.t.value(object.at(0))?;
    let first = c.t.upload(object.at(sub::SYNC_TYPE))?;
    let place = format!("{} and 01 in SAFEOP without outputs", object.at(0));
    let expected = "0 and abort 0x06090011, or both as ever";
    match count {
        Some(0) => {
            let gone = first == Err(AbortCode::NO_SUBINDEX);
            let found = first.map_or_else(|code| code.to_string(), |_| "a value".to_owned());
            c.expect(place, expected, format!("0 and {found}"), gone);
            c.notes.push("it hides the object".to_owned());
        }
        _ => {
            let same = count == object.value(0) && first.is_ok();
            c.expect(place, expected, if same { "both as ever" } else { "neither" }, same);
            c.notes.push("it keeps the object".to_owned());
        }
    }
    Ok(())
}

/// A value as hexadecimal number; it came with the low byte first.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().rev().fold("0x".to_owned(), |text, byte| text + &format!("{byte:02X}"))
}
