//! Every published device as its profile: what the stack answers by SDO against the makers' tables,
//! and that each comes to OP in every mode that it announces.

use std::path::PathBuf;

use crate::bench::Bench;
use isocat::profile::{self, Profile};
use isocat::{Nanos, Scenario, SegmentFile, run};
use isocat_sync::SyncMode;
use isocat_wire::AbortCode;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use serde_json::Value as Json;

/// The published tables: `ISOCAT_SHARED`, else `shared` beside the repository. Empty if they are
/// not there.
fn published() -> Vec<Json> {
    let folder = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let Ok(files) = std::fs::read_dir(folder.join("devices")) else {
        println!("skipped: no published tables at {}", folder.display());
        return Vec::new();
    };
    let paths = files.map(|file| file.expect("a file").path());
    let json = paths.filter(|path| path.extension().is_some_and(|end| end == "json"));
    let tables = json.map(|path| std::fs::read_to_string(path).expect("a table"));
    let tables = tables.map(|text| serde_json::from_str::<Json>(&text).expect("JSON"));
    tables.filter(|table| table["schema"] == "ecat-sync-profile/1").collect()
}

fn is_assumed(profile: &Profile, item: &str) -> bool {
    profile.assumptions.iter().any(|assumption| assumption.item == item)
}

#[test]
fn each_published_object_is_answered_as_published() {
    let mut compared = 0;
    for table in published() {
        let id = table["id"].as_str().expect("an id");
        let profile = profile::built_in(id).unwrap_or_else(|| panic!("{id} has no profile"));
        let mut bench = Bench::new(&profile);
        for (index, object) in table["objects"].as_object().expect("objects") {
            let index = u16::from_str_radix(index, 16).expect("an index");
            if object.is_null() {
                let there = is_assumed(&profile, &format!("0x{index:04X}"));
                let answer = bench.read(index, 0, false);
                assert_eq!(answer.is_ok(), there, "{id} {index:04X}: {answer:?}");
                assert!(there || answer == Err(AbortCode::NO_OBJECT), "{id} {index:04X}");
                continue;
            }
            compared += compare(&mut bench, &profile, index, object);
        }
        for index in [0x1C12u16, 0x1C13] {
            compared += assignment(&mut bench, &profile, index, &table["pdo_assign"]);
        }
    }
    println!("{compared} entries compared");
}

/// One object: single reads, SDO information, complete access, and that what is read-only stays.
fn compare(bench: &mut Bench, profile: &Profile, index: u16, object: &Json) -> usize {
    let entries = object["entries"].as_array().expect("entries");
    let place = format!("{} {index:04X}", profile.id);
    let whole = bench.read(index, 0, true).unwrap_or_else(|code| panic!("{place}: {code:?}"));
    if let Some(bits) = object["ca_bits"].as_u64() {
        assert_eq!(whole.len() as u64, bits.div_ceil(8), "{place}: complete access");
    }
    if let Some(count) = object["si0"].as_u64() {
        assert_eq!(bench.read(index, 0, false), Ok(vec![count as u8]), "{place}: sub-index 00");
    }
    for entry in entries {
        let sub = entry["si"].as_u64().expect("a sub-index") as u8;
        let place = format!("{place}:{sub:02X}");
        let (description, name) =
            bench.describe(index, sub).unwrap_or_else(|code| panic!("{place}: {code:?}"));
        let bits = entry["bits"].as_u64().expect("bits");
        assert_eq!(
            (u64::from(description.bits), name.as_str()),
            (bits, entry["name"].as_str().unwrap())
        );
        if name.starts_with("Gap entry") {
            assert_eq!(description.data_type, 0, "{place}");
            assert_eq!(
                bench.read(index, sub, false),
                Err(AbortCode::UNSUPPORTED_ACCESS),
                "{place}"
            );
            continue;
        }
        let kind = DataType(description.data_type).name();
        assert_eq!(kind, entry["type"].as_str(), "{place}");
        let writable = description.access.has_any(Access::WRITE);
        match entry["access"].as_str() {
            Some(access) => assert_eq!(writable, access == "rw", "{place}: {access}"),
            None => {
                assert!(is_assumed(profile, &format!("0x{index:04X}:{sub:02X} access")), "{place}")
            }
        }
        assert_eq!(description.access.has(Access::TX_MAPPABLE), entry["pdo"] == "T", "{place}");
        let value =
            bench.read(index, sub, false).unwrap_or_else(|code| panic!("{place}: {code:?}"));
        assert_eq!(value.len() as u64, bits.div_ceil(8), "{place}");
        if let Some(published) = entry["value"].as_i64() {
            assert_eq!(value, published.to_le_bytes()[..value.len()], "{place}");
        }
        let at = entry["ca_bit_offset"].as_u64().unwrap_or(if sub == 32 { 480 } else { 0 });
        for bit in 0..bits {
            let inside = whole[((at + bit) / 8) as usize] >> ((at + bit) % 8) & 1;
            let alone = value[(bit / 8) as usize] >> (bit % 8) & 1;
            assert_eq!(inside, alone, "{place}: bit {bit} of complete access");
        }
        if !writable {
            let refused = bench.write(index, sub, &value);
            assert_eq!(refused, Err(AbortCode::READ_ONLY), "{place}");
        }
    }
    for sub in 1..=40u8 {
        let listed = entries.iter().any(|entry| entry["si"] == sub);
        // 0x1C00 is published by its count alone.
        if !listed && index != 0x1C00 {
            let place = format!("{place}:{sub:02X}");
            assert_eq!(bench.read(index, sub, false), Err(AbortCode::NO_SUBINDEX), "{place}");
            assert_eq!(bench.describe(index, sub).err(), Some(AbortCode::NO_SUBINDEX), "{place}");
        }
    }
    entries.len()
}

/// 0x1C12 and 0x1C13: in which states they can be written, and what is assigned at power-on.
fn assignment(bench: &mut Bench, profile: &Profile, index: u16, assign: &Json) -> usize {
    let published = &assign[format!("{index:04X}")];
    let Some(access) = published["access"].as_str() else { return 0 };
    let place = format!("{} {index:04X}", profile.id);
    let (description, _) = bench.describe(index, 0).expect("a count");
    let writable = description.access.has_any(Access::WRITE);
    assert_eq!(writable, access == "rw", "{place}");
    let default = published["default"].as_array().expect("PDOs");
    assert_eq!(bench.read(index, 0, false), Ok(vec![default.len() as u8]), "{place}");
    for (sub, pdo) in (1..).zip(default) {
        let pdo = pdo.as_str().and_then(|pdo| u16::from_str_radix(&pdo[2..], 16).ok());
        let pdo = pdo.expect("an index").to_le_bytes().to_vec();
        assert_eq!(bench.read(index, sub, false), Ok(pdo), "{place}:{sub:02X}");
    }
    // The stack carries 256 of the 384 bytes of an EL1258.
    if let Some(bits) = published["bits_default"].as_u64().filter(|bits| *bits <= 8 * 256) {
        let mut mapped = 0;
        for pdo in default {
            let pdo = u16::from_str_radix(&pdo.as_str().expect("an index")[2..], 16).expect("hex");
            let count = bench.read(pdo, 0, false).expect("a mapping")[0];
            mapped += (1..=count)
                .map(|sub| u64::from(bench.read(pdo, sub, false).expect("an entry")[0]))
                .sum::<u64>();
        }
        assert_eq!(mapped, bits, "{place}: bits of what is assigned");
    }
    if !writable {
        let refused = bench.write(index, 0, &[default.len() as u8]);
        assert_eq!(refused, Err(AbortCode::READ_ONLY), "{place}");
    }
    1 + default.len()
}

#[test]
fn each_device_comes_to_op_in_each_mode_that_it_announces() {
    let mut failures = Vec::new();
    let mut booted = 0;
    for id in profile::built_in_ids() {
        let profile = profile::built_in(id).expect("a profile");
        // Terminals stand at the side of the MainDevice, as those of an embedded PC.
        let port = if profile.is_on_ebus() { "ebus" } else { "mii" };
        let device = format!(
            "cycle = \"2ms\"\nhost = {{ port = \"{port}\" }}\n[[subdevice]]\ndevice = \"{id}\"\n"
        );
        let mut runs: Vec<_> = profile
            .modes()
            .map(|mode| {
                let mut text = format!("{device}mode = \"{}\"\n", mode.name());
                // A choice of its maker's, which 0x1C32 does not state.
                text += match mode {
                    SyncMode::DcSubordinated => "sync0_cycle = \"500us\"\n",
                    SyncMode::DcSync1 => "sync1 = \"100us\"\n",
                    _ => "",
                };
                (mode, text)
            })
            .collect();
        if runs.is_empty() {
            // It announces nothing, so nothing can be asked of it.
            runs.push((SyncMode::FreeRun, device));
        }
        for (mode, text) in runs {
            let file = SegmentFile::parse("profile.toml", &text)
                .unwrap_or_else(|error| panic!("{id} {}: {error}", mode.name()));
            let mut scenario = Scenario::from(file);
            scenario.duration = Nanos::millis(50);
            let report = run(&scenario);
            let device = &report.devices[0];
            let found = (device.mode, device.registers.al_status);
            if found.0 == mode && found.1.is_op() && report.in_sync {
                booted += 1;
            } else {
                failures.push(format!("{id} {}: {found:?} {}", mode.name(), report.verdict));
            }
        }
    }
    assert!(failures.is_empty(), "{booted} came to OP, but\n{}", failures.join("\n"));
    assert!(booted >= 60, "{booted}");
}
