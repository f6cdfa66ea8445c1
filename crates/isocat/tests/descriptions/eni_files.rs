//! Real ENI files, where they are at hand: what is in them, every doubt, and whether they can be
//! run.

use std::path::{Path, PathBuf};

use isocat::eni::{Eni, WarningKind, write};
use isocat::start_up::{Step, Transition};
use isocat_wire::dc::AssignActivate;

/// A file beside the project, or `None` with a word.
fn file(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/eni").join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: no {}", path.display());
    None
}

fn kinds(eni: &Eni) -> Vec<&'static str> {
    let mut kinds: Vec<_> = eni.warnings.iter().map(|warning| warning.kind.name()).collect();
    kinds.sort_unstable();
    kinds.dedup();
    kinds
}

/// What was read, written and read again, is the same.
fn comes_back(eni: &Eni) {
    let again = Eni::from_bytes("again.xml", write(&eni.start_up).as_bytes()).unwrap();
    assert_eq!(again.start_up.devices, eni.start_up.devices);
    assert_eq!(again.start_up.before, eni.start_up.before);
    assert_eq!(again.start_up.frames, eni.start_up.frames);
    assert_eq!(again.start_up.cycle_ns, eni.start_up.cycle_ns);
}

#[test]
fn an_export_without_dc() {
    let Some(path) = file("hpmicro_cia402.eni.xml") else { return };
    let eni = Eni::read(path).unwrap();
    assert_eq!(kinds(&eni), [""; 0]);
    let list = eni.runnable().unwrap();
    assert_eq!((list.cycle_ns, list.devices.len()), (2_000_000, 1));
    let drive = &list.devices[0];
    assert_eq!((drive.station, drive.vendor, drive.product), (1001, 4_739_149, 3));
    assert_eq!(drive.dc, None);
    assert_eq!(drive.assign_activate(), None);
    assert_eq!(drive.outputs.map(|bits| (bits.start, bits.length)), Some((312, 64)));
    let steps = drive.at(Transition::PS);
    assert!(matches!(steps[0], Step::Object(step) if step.object.index == 0x1C12 && step.complete));
    assert_eq!(eni.slaves[0].pdos.len(), 2);
    let bits: u16 = eni.slaves[0].pdos[0].entries.iter().map(|entry| entry.bits).sum();
    assert_eq!(bits, 64);
    comes_back(&eni);
}

#[test]
fn an_export_with_dc_and_words_before_the_declaration() {
    let Some(path) = file("intrinsic_1motor_sgdv.eni") else { return };
    let eni = Eni::read(path).unwrap();
    assert_eq!(kinds(&eni), ["cycle-time-missing", "text-before-declaration"]);
    // Places are those of the file, the words before included.
    let before =
        eni.warnings.iter().find(|w| w.kind == WarningKind::TextBeforeDeclaration).unwrap();
    assert_eq!(before.line, 16);
    let list = eni.runnable().unwrap();
    assert_eq!(list.cycle_ns, 4_000_000);
    let drive = &list.devices[0];
    let dc = drive.dc.unwrap();
    assert_eq!((dc.reference, dc.sync0_ns, dc.sync1_ns), (true, 4_000_000, 0));
    assert_eq!(drive.assign_activate(), Some(AssignActivate::SYNC0));
    assert_eq!(list.frames[0].datagrams.len(), 6);
    assert!(drive.objects.len() > 10 && drive.registers.len() > 30);
    comes_back(&eni);
}

#[test]
fn a_minimum_by_hand() {
    let Some(path) = file("soem_sample.eni.xml") else { return };
    let eni = Eni::read(path).unwrap();
    assert_eq!(kinds(&eni), ["ccs-of-download", "hex-number", "mailbox-receive"]);
    let reasons = eni.runnable().unwrap_err().join("; ");
    assert!(
        reasons.contains("nor cyclic frames") && reasons.contains("no station address"),
        "{reasons}"
    );
    let objects = &eni.start_up.devices[0].objects;
    assert_eq!((objects.len(), objects[1].data.as_slice()), (4, &[0x02, 0x1A][..]));
}

#[test]
fn a_foreign_file_of_the_same_root() {
    let Some(path) = file("beremiz_etherlab_config.xml") else { return };
    let eni = Eni::read(path).unwrap();
    let reasons = eni.runnable().unwrap_err().join("; ");
    assert!(reasons.contains("neither register commands"), "{reasons}");
}

/// The command: exit codes 0, 1 and 2, text and JSON.
#[test]
fn the_command_tells_what_is_in_a_file() {
    let run = |path: &Path, json: bool| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_isocat"));
        command.arg("eni").arg(path).args(json.then_some("--json"));
        command.output().expect("isocat starts")
    };
    let folder = std::env::temp_dir().join(format!("isocat-eni-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("network.xml");
    let slave = "<Slave><Info><Name>Box</Name><PhysAddr>4097</PhysAddr></Info></Slave>";
    let cyclic = "<Cyclic><CycleTime>500</CycleTime><Frame><Cmd><State>OP</State><Cmd>7</Cmd><Ado>304</Ado>\
                  <DataLength>2</DataLength></Cmd></Frame></Cyclic>";
    let file = |parts: &str| format!("<EtherCATConfig><Config>{parts}</Config></EtherCATConfig>");
    std::fs::write(&path, file(&format!("{slave}{cyclic}"))).unwrap();
    let output = run(&path, false);
    assert_eq!(output.status.code(), Some(0));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains("cycle 500 us, 1 SubDevice") && text.contains("0 Box, station 0x1001"),
        "{text}"
    );
    std::fs::write(&path, file(slave)).unwrap();
    let output = run(&path, true);
    assert_eq!(output.status.code(), Some(1));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["start_up"]["devices"][0]["station"], "0x1001");
    assert!(json["not_runnable"][0].as_str().unwrap().contains("neither register commands"));
    std::fs::write(&path, "<EtherCATConfig>").unwrap();
    let output = run(&path, false);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("network.xml:1:"));
    std::fs::remove_dir_all(folder).unwrap();
}
