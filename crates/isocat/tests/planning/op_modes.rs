//! The OpModes of several hundred published device revisions, at four bus cycles: every one has its
//! registers or its reason, and the doubts are counted.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use isocat_sync::opmode::{CycleTime, OpMode, ShiftTime, Unit};
use isocat_wire::Nanos;
use isocat_wire::dc::AssignActivate;
use serde_json::Value;

/// A list of OpModes beside the project, if it is there.
const CATALOG: &str = "../../../shared/devices/opmodes_catalog.json";

fn op_mode(row: &Value) -> Option<OpMode> {
    let word = row["assign_activate"].as_str()?;
    let word = u16::from_str_radix(word.trim_start_matches("0x"), 16).expect("a hex word");
    let time = |key: &str| row[key].as_i64().unwrap_or(0);
    let factor = |key: &str| row[key].as_i64().map(|factor| i32::try_from(factor).expect("an i32"));
    Some(OpMode {
        assign_activate: AssignActivate(word),
        sync0: CycleTime { value: time("sync0_cycle_ns"), factor: factor("sync0_factor") },
        shift0: ShiftTime { value: time("sync0_shift_ns"), ..ShiftTime::default() },
        sync1: CycleTime { value: time("sync1_cycle_ns"), factor: factor("sync1_factor") },
        shift1: time("sync1_shift_ns"),
    })
}

#[test]
fn published_op_modes_at_four_bus_cycles() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let Ok(text) = std::fs::read_to_string(folder.join(CATALOG)) else {
        println!("skipped: no {CATALOG}");
        return;
    };
    let catalog: Value = serde_json::from_str(&text).expect("the catalog is JSON");
    let rows = catalog["rows"].as_array().expect("rows");
    let with_dc: Vec<OpMode> = rows.iter().filter_map(op_mode).collect();
    let mut summary = format!("{} OpModes, {} with DC\n", rows.len(), with_dc.len());
    for bus in [250_000, 1_000_000, 2_000_000, 4_000_000].map(Nanos) {
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for op_mode in &with_dc {
            match op_mode.registers(bus, &Unit::default()) {
                Ok(registers) => {
                    let doubts = registers.warnings.iter().map(|doubt| doubt.name().to_owned());
                    let mode = registers.modes()[0].to_string();
                    for name in doubts.chain([format!("mode {mode}")]) {
                        *counts.entry(name).or_default() += 1;
                    }
                    if registers.warnings.is_empty() {
                        *counts.entry("without a doubt".into()).or_default() += 1;
                    }
                    // What needs no doubt repeats with the bus.
                    assert!(!registers.warnings.is_empty() || registers.period() == bus);
                }
                Err(_) => *counts.entry("refused".into()).or_default() += 1,
            }
        }
        let _ = writeln!(summary, "\nbus cycle {bus}");
        for (name, count) in counts {
            let _ = writeln!(summary, "{count:>4} {name}");
        }
    }
    let golden = folder.join("tests/golden/op_modes.txt");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&golden, &summary).expect("the golden file can be written");
    }
    let expected = std::fs::read_to_string(golden).unwrap_or_default();
    assert!(summary == expected, "the counts changed: run with UPDATE_GOLDEN=1\n{summary}");
}
