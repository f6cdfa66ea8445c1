//! Built-in profiles compared with the published tables of the devices, entry by entry.

use std::path::PathBuf;

use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use serde_json::Value as Json;

use super::object;
use crate::profile::{Profile, built_in, built_in_ids};

/// Reads the published tables from the folder `ISOCAT_SHARED`, or from `shared` next to the
/// repository.
fn published(id: &str) -> Option<Json> {
    let folder = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let path = folder.join("devices").join(format!("{id}.json"));
    match std::fs::read_to_string(&path) {
        Ok(text) => Some(serde_json::from_str(&text).unwrap()),
        Err(_) => {
            println!("skipped: no published table at {}", path.display());
            None
        }
    }
}

/// Whether the profile lists an entry's value, access or offset as assumed.
fn is_assumed(profile: &Profile, entry: ObjectAddress, property: &str) -> bool {
    profile.assumptions.iter().any(|assumption| {
        let (address, of) = assumption.item.split_once(' ').unwrap_or((&assumption.item, ""));
        let prefix = format!("0x{:04X}:", entry.index);
        let Some(subs) = address.strip_prefix(&prefix) else { return false };
        let (first, last) = subs.split_once('-').unwrap_or((subs, subs));
        let hex = |text| u8::from_str_radix(text, 16).unwrap();
        of == property && (hex(first)..=hex(last)).contains(&entry.sub)
    })
}

#[test]
fn every_published_entry_is_in_the_profile() {
    let mut compared = 0;
    let mut tables = 0;
    for profile in built_in_ids().map(|id| built_in(id).unwrap()) {
        let Some(published) = published(&profile.id) else { continue };
        tables += 1;
        for (index, table) in published["objects"].as_object().unwrap() {
            if table.is_null() {
                continue;
            }
            let index = u16::from_str_radix(index, 16).unwrap();
            let entries = table["entries"].as_array().unwrap();
            for published in entries {
                compare(&profile, index, published);
                compared += 1;
            }
            let known = |sub: u8| entries.iter().any(|entry| entry["si"] == sub);
            for entry in object(&profile, index).entries.iter().filter(|entry| !known(entry.sub)) {
                let address = ObjectAddress::new(index, entry.sub);
                assert!(is_assumed(&profile, address, ""), "{}: {address} is invented", profile.id);
            }
            if let Some(bits) = table["ca_bits"].as_u64() {
                let last = object(&profile, index).entries.last().unwrap();
                let end = last.complete_access_offset + u32::from(last.bits);
                assert_eq!(u64::from(end.next_multiple_of(8)), bits, "{} {index:04X}", profile.id);
            }
        }
        compare_identity(&profile, &published);
        compare_assignment(&profile, &published);
        compare_op_modes(&profile, &published);
    }
    assert!(compared >= 20 * tables, "only {compared} entries of {tables} tables compared");
}

fn compare(profile: &Profile, index: u16, published: &Json) {
    let sub = published["si"].as_u64().unwrap() as u8;
    let address = ObjectAddress::new(index, sub);
    let place = format!("{} {address}", profile.id);
    let found = object(profile, index).entries.iter().find(|entry| entry.sub == sub);
    let entry = found.unwrap_or_else(|| panic!("{place} is missing"));
    assert_eq!(entry.name, published["name"], "{place}");
    assert_eq!(u64::from(entry.bits), published["bits"].as_u64().unwrap(), "{place}");
    let gap = entry.name.starts_with("Gap entry");
    // A gap answers as a gap in SDO information, whatever type its printed row has.
    match gap {
        true => assert_eq!(entry.data_type, DataType::GAP, "{place}"),
        false => assert_eq!(entry.data_type.name().unwrap(), published["type"], "{place}"),
    }
    match published["ca_bit_offset"].as_u64() {
        Some(bit) => assert_eq!(u64::from(entry.complete_access_offset), bit, "{place}"),
        None => assert!(is_assumed(profile, address, "offset"), "{place}: offset"),
    }
    match published["access"].as_str() {
        Some("ro") => assert_eq!(entry.access.0 & 0x3F, 0x07, "{place}"),
        Some("rw") => assert!(entry.access.has(Access::READ), "{place}"),
        Some(other) => panic!("{place}: {other}"),
        None => assert!(is_assumed(profile, address, "access"), "{place}: access"),
    }
    if published["access"] == "rw" {
        let written = Access(entry.access.0 & Access::WRITE.0);
        let states = match published["write_states"].as_array() {
            None => Access::WRITE,
            Some(states) => states.iter().fold(Access::default(), |access, state| {
                access.with(match state.as_str().unwrap() {
                    "PREOP" => Access::WRITE_PREOP,
                    "SAFEOP" => Access::WRITE_SAFEOP,
                    "OP" => Access::WRITE_OP,
                    other => panic!("{place}: {other}"),
                })
            }),
        };
        assert_eq!(written, states, "{place}");
    }
    assert_eq!(entry.access.has(Access::TX_MAPPABLE), published["pdo"] == "T", "{place}");
    match published["value"].as_u64() {
        Some(value) => {
            assert_eq!(profile.value(address), Some(value), "{place}");
            assert!(!is_assumed(profile, address, ""), "{place} is published, not assumed");
        }
        None => assert!(gap || is_assumed(profile, address, ""), "{place}: value"),
    }
}

fn compare_identity(profile: &Profile, published: &Json) {
    for (found, published, key) in [
        (profile.identity.vendor_id, &published["vendor"]["vendor_id"], "vendor_id"),
        (profile.identity.product_code, &published["product"]["product_code"], "product_code"),
        (profile.identity.revision, &published["product"]["revision"], "revision"),
    ] {
        let item = format!("identity.{key}");
        let assumed = profile.assumptions.iter().any(|assumption| assumption.item == item);
        match published.as_u64() {
            Some(value) => assert_eq!(u64::from(found), value, "{} {item}", profile.id),
            None => assert!(assumed, "{} {item}", profile.id),
        }
        assert_ne!(assumed, published.is_u64(), "{} {item}", profile.id);
    }
    assert_eq!(profile.name, published["product"]["name"]);
    assert_eq!(profile.vendor, published["vendor"]["name"]);
}

fn compare_assignment(profile: &Profile, published: &Json) {
    for index in [0x1C12u16, 0x1C13] {
        let published = &published["pdo_assign"][format!("{index:04X}")];
        if published["access"].is_null() {
            let there = profile.description.object(index).is_some();
            let assumed = is_assumed(profile, ObjectAddress::new(index, 0), "access");
            assert_eq!(assumed, there, "{} {index:04X}", profile.id);
            continue;
        }
        let count = object(profile, index).entries[0];
        let expected = match published["access"].as_str().unwrap() {
            "ro" => Access::READ,
            _ => Access::READ.with(Access::WRITE_PREOP),
        };
        assert_eq!(count.access, expected, "{} {index:04X}", profile.id);
        let default = published["default"].as_array().unwrap();
        assert_eq!(usize::from(count.default[0]), default.len());
        for (sub, pdo) in (1..).zip(default) {
            let pdo = pdo.as_str().unwrap().trim_start_matches("0x");
            let found = profile.value(ObjectAddress::new(index, sub)).unwrap();
            assert_eq!(format!("{found:04X}"), pdo, "{} {index:04X}:{sub:02X}", profile.id);
        }
    }
}

fn compare_op_modes(profile: &Profile, published: &Json) {
    let modes = published["dc_opmodes"].as_array().unwrap();
    if modes.is_empty() {
        let assumed = profile.assumptions.iter().any(|assumption| assumption.item == "opmode");
        assert!(profile.op_modes.is_empty() || assumed, "{}", profile.id);
        return;
    }
    assert_eq!(profile.op_modes.len(), modes.len());
    for (mode, published) in profile.op_modes.iter().zip(modes) {
        assert_eq!(mode.name, published["name"]);
        assert_eq!(mode.description, published["desc"].as_str().unwrap_or_default());
        assert_eq!(u64::from(mode.assign_activate), published["assign_activate"].as_u64().unwrap());
        let factor = |key: &str| published[key]["factor"].as_i64().unwrap_or(0);
        assert_eq!(i64::from(mode.sync0_factor), factor("sync0_cycle"));
        assert_eq!(i64::from(mode.sync1_factor), factor("sync1_cycle"));
    }
}
