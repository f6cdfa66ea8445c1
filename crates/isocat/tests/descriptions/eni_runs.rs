//! `isocat run`, `plan` and `scan` with an ENI in the place of a segment file: exit codes, texts,
//! the document and its schema.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use isocat::player::report;

fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.args(arguments).output().expect("isocat starts")
}

/// A folder of this test's own.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("eni-runs-{name}"));
    std::fs::create_dir_all(&folder).expect("a folder");
    folder
}

/// Our own export of two drives, as a file, and the segment file beside it.
fn export(name: &str) -> (String, String) {
    let folder = folder(name);
    let (segment, eni) = (folder.join("two.toml"), folder.join("network.xml"));
    let text = "cycle = \"1ms\"\nfor = \"200ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";
    std::fs::write(&segment, text).unwrap();
    let (segment, eni) = (segment.display().to_string(), eni.display().to_string());
    assert_eq!(isocat(&["plan", &segment, "--eni", &eni]).status.code(), Some(0));
    (segment, eni)
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn our_own_export_runs_and_is_planned_and_scanned() {
    let (segment, eni) = export("good");
    let output = isocat(&["run", &eni, "--for", "200ms"]);
    assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
    assert!(stdout(&output).starts_with("In sync: the ENI was executed to the letter."));
    assert!(stdout(&output).contains("no differences from what our plan would write"));
    let output = isocat(&["plan", &eni]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).contains("built-in profile kollmorgen_akd2g"));
    assert_eq!(isocat(&["scan", &eni]).status.code(), Some(0));
    let output = isocat(&["run", &eni, "--segment", &segment]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).contains("as the segment file has it"));
}

/// The document has the keys of its schema, and the schema is the one in docs.
#[test]
fn the_document_follows_its_schema() {
    let (_, eni) = export("json");
    // Another watchdog: one difference.
    let path = folder("json").join("other.xml").display().to_string();
    let text = std::fs::read_to_string(&eni).unwrap().replace("<ShiftTime>", "<ShiftTime>1");
    std::fs::write(&path, text).unwrap();
    for verb in ["run", "plan"] {
        let output = isocat(&[verb, &path, "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let keys = report::schema()["properties"].as_object().expect("keys").clone();
        let found = json.as_object().expect("a document");
        assert!(found.keys().eq(keys.keys()), "{found:?}");
        assert_eq!(json["differences"][0]["kind"], "shift");
        assert_eq!(json["run"].is_null(), verb == "plan");
    }
    let schemas = [("eni-run", report::schema()), ("eni-scan", isocat::player::found::schema())];
    for (name, schema) in schemas {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
        let path = path.join(format!("{name}.schema.json"));
        let now = serde_json::to_string_pretty(&schema).expect("JSON") + "\n";
        if std::env::var_os("UPDATE_SCHEMA").is_some() {
            std::fs::write(&path, &now).expect("docs/ is writable");
        }
        let committed = std::fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(now, committed, "{name} changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
    }
}

#[test]
fn bad_input_is_told_with_its_place() {
    let (segment, eni) = export("bad");
    let refused = |arguments: &[&str], expected: &[&str]| {
        let output = isocat(arguments);
        let told = stderr(&output).split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {told}");
        for words in expected {
            assert!(told.contains(words), "{arguments:?}: {told}");
        }
    };
    let broken = folder("bad").join("broken.xml").display().to_string();
    let text = std::fs::read_to_string(&eni).unwrap();
    let line = text[..text.find("<PhysAddr>").unwrap()].lines().count();
    std::fs::write(&broken, text.replacen("<PhysAddr>", "<PhysAddr>x", 1)).unwrap();
    refused(&["run", &broken], &[&format!("broken.xml:{line}:"), "expected"]);
    std::fs::write(&broken, &text[..text.len() / 2]).unwrap();
    refused(&["plan", &broken], &["broken.xml:"]);
    std::fs::write(&broken, "<EtherCATConfig><Config/></EtherCATConfig>").unwrap();
    refused(&["run", &broken], &["can't be run", "it names no SubDevice"]);
    refused(&["run", "/no/such/network.xml"], &["/no/such/network.xml", "can't be read"]);
    refused(&["run", &eni, "--esi", "/no/such/folder"], &["/no/such/folder", "can't be read"]);
    refused(
        &["run", &eni, "--capture", "run.pcapng"],
        &["--capture without --interface is beside an ENI", "expected"],
    );
    refused(&["plan", &eni, "--prove"], &["--prove is beside an ENI", "expected"]);
    refused(&["run", &segment, "--esi", "esi"], &["--esi goes with an ENI"]);
    let other = folder("bad").join("other.toml").display().to_string();
    std::fs::write(&other, "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n").unwrap();
    refused(&["run", &eni, "--segment", &other], &["other.toml", "1 devices; expected 2"]);
}

/// A list that the segment does not bear is not in sync, and says at which command.
#[test]
fn what_fails_is_told_with_its_command() {
    let (_, eni) = export("fails");
    let path = folder("fails").join("other.xml").display().to_string();
    let text = std::fs::read_to_string(&eni).unwrap();
    std::fs::write(&path, text.replace("<Cnt>6</Cnt>", "<Cnt>7</Cnt>")).unwrap();
    let output = isocat(&["run", &path, "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["run"]["failure"]["kind"], "process-data");
    assert_eq!(json["run"]["in_sync"], false);
}
