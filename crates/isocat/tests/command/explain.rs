//! `isocat explain`: what it prints, and that it says the same to a program.

use std::path::Path;
use std::process::Command;

use isocat_sync::table::{Column, SUBS, lookup};

fn explain(arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    let output = command.arg("explain").args(arguments).output().expect("isocat starts");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("isocat prints UTF-8")
}

#[test]
fn modes_as_committed() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/explain_modes.txt");
    let text = explain(&["modes"]);
    let widest = text.lines().map(|line| line.chars().count()).max();
    assert!(widest <= Some(100), "{widest:?} columns:\n{text}");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&golden, &text).expect("the golden file can be written");
    }
    let expected = std::fs::read_to_string(golden).unwrap_or_default();
    assert!(text == expected, "the tables changed: run with UPDATE_GOLDEN=1\n{text}");
}

#[test]
fn modes_for_a_program() {
    let json: serde_json::Value = serde_json::from_str(&explain(&["modes", "--json"])).unwrap();
    let objects = json["objects"].as_array().unwrap();
    for (object, index) in objects.iter().zip([0x1C32u16, 0x1C33]) {
        assert_eq!(object["index"], format!("0x{index:04X}"));
        let rows = object["sub_indices"].as_array().unwrap();
        assert!(rows.iter().map(|row| row["sub"].as_u64()).eq(SUBS.map(|sub| Some(sub.into()))));
        for (row, sub) in rows.iter().zip(SUBS) {
            let columns = row["columns"].as_array().unwrap();
            assert_eq!(columns.len(), 8);
            for (found, column) in columns.iter().zip(Column::ALL) {
                let cell = lookup(index, sub, column).unwrap();
                let place = format!("{index:04X}:{sub:02X} {column}");
                assert_eq!(found["column"], column.name());
                let access = found["access"].as_str().unwrap_or("-");
                assert_eq!(access, cell.rights.to_string(), "{place}");
                let need = found["need"].as_str().unwrap();
                assert_eq!(need == "not used", !cell.is_used(), "{place}");
                assert_eq!(found["condition"].is_string(), need == "conditional", "{place}");
            }
        }
    }
    let delay = &objects[1]["sub_indices"][8]["columns"];
    assert_eq!(delay[4]["need"], "not used", "1C33:09 without SYNC1");
    assert_eq!((&delay[5]["access"], &delay[5]["need"]), (&"R".into(), &"mandatory".into()));
}

/// One of each kind, as printed.
#[test]
fn explanations_as_committed() {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/explain.txt");
    let asked: [&[&str]; 11] = [
        &["0x001A"],
        &["0x06090030"],
        &["0x1C32:0B"],
        &["SI4", "0x0427"],
        &["0x0300"],
        &["0x092C=0x000000FD"],
        &["dc-sync0"],
        &["0xC007"],
        &["input_shift"],
        &["cycle"],
        &["key", "mailbox"],
    ];
    let text: String = asked
        .map(|what| format!("$ isocat explain {}\n{}\n", what.join(" "), explain(what)))
        .concat();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&golden, &text).expect("the golden file can be written");
    }
    let expected = std::fs::read_to_string(golden).unwrap_or_default();
    assert!(text == expected, "explanations changed: run with UPDATE_GOLDEN=1\n{text}");
}

#[test]
fn an_explanation_for_a_program() {
    let json: serde_json::Value = serde_json::from_str(&explain(&["0x0300", "--json"])).unwrap();
    assert_eq!(json["format"], "isocat-explain/1");
    assert_eq!(json["what"], "0x0300");
    let meanings = json["meanings"].as_array().unwrap();
    assert_eq!(meanings[0]["kind"], "AssignActivate");
    assert_eq!(meanings[1]["kind"], "register");
    assert!(meanings[0]["value"][0].as_str().unwrap().starts_with("bit 8"));
}

#[test]
fn what_is_not_known_is_bad_input() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    let output = command.args(["explain", "0x0038"]).output().expect("isocat starts");
    assert_eq!(output.status.code(), Some(2));
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(words.contains("0x0038") && words.contains("understood:"), "{words}");
}

/// What an editor needs is printed as it is committed.
#[test]
fn schemas_for_editors() {
    for name in ["segment-file", "profile"] {
        let path = format!("{}/../../docs/{name}.schema.json", env!("CARGO_MANIFEST_DIR"));
        let committed = std::fs::read_to_string(path).expect("it is committed");
        assert!(explain(&["--schema", name]) == committed, "{name}");
    }
}
