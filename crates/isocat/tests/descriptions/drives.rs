//! Drives behind SoE: what a description wants written is written at its transition, listed and
//! exported; what is refused says which drive, which parameter and why.

use std::path::PathBuf;

use isocat::eni::{self, Eni};
use isocat::plan::Plan;
use isocat::start_up::{DeviceStartUp, Transition};
use isocat::tool::Tool;
use isocat::{NoTap, Scenario, SegmentFile, run};
use isocat_maindevice::{Cause, SoeError, StartupParameter};
use isocat_wire::soe::{ErrorCode, Idn};

const DRIVES: &str = include_str!("../esi/drives.xml");

/// A segment of the device of that file, changed; and what its name adds to the file's.
fn scenario(name: &str, change: impl FnOnce(String) -> String, cycle: &str) -> Scenario {
    let file = format!("isocat-drives-{}-{name}.xml", std::process::id());
    let path: PathBuf = std::env::temp_dir().join(file);
    std::fs::write(&path, change(DRIVES.to_owned())).expect("a folder for temporary files");
    let text = format!("cycle = {cycle:?}\nfor = \"20ms\"\n[[subdevice]]\nesi = {path:?}\n");
    let scenario = SegmentFile::parse("s.toml", &text).map(Scenario::from);
    let _ = std::fs::remove_file(&path);
    scenario.unwrap_or_else(|error| panic!("{error}"))
}

/// Transition, drive, parameter and bytes.
fn written(device: &DeviceStartUp) -> Vec<(Vec<Transition>, u8, String, Vec<u8>)> {
    let steps = device.parameters.iter();
    let step = |one: &isocat::start_up::ParameterStep| {
        (one.transitions.clone(), one.drive, one.idn.to_string(), one.data.clone())
    };
    steps.map(step).collect()
}

fn start_up(scenario: &Scenario) -> isocat::StartUp {
    Plan::of(scenario).expect("it fits").start_up(scenario)
}

#[test]
fn parameters_are_written_at_their_transition() {
    let scenario = scenario("list", |text| text, "1ms");
    let list = start_up(&scenario);
    let device = &list.devices[0];
    let (ip, ps) = (vec![Transition::IP], vec![Transition::PS]);
    let mut table = vec![0x3C, 0, 0x40, 0];
    table.extend(0..0x3C);
    let expected = [
        (ip, 0, "P-0-0010".to_owned(), vec![0xFE, 0x7F, 0, 0, 0, 0, 0, 0]),
        // The bus cycle in us, not what the file has.
        (ps.clone(), 0, "S-0-0001".to_owned(), vec![0xE8, 0x03]),
        (ps.clone(), 1, "S-0-0032".to_owned(), vec![0x0B, 0]),
        (ps, 0, "P-0-0232".to_owned(), table),
    ];
    assert_eq!(written(device), expected);
    let read = Eni::from_bytes("out.xml", eni::write(&list).as_bytes()).expect("our own file");
    assert_eq!(written(&read.start_up.devices[0]), expected);
    assert!(read.start_up.devices[0].mailbox.is_some_and(|mailbox| mailbox.soe && !mailbox.coe));
    let line = list.text().lines().find(|line| line.contains("S-0-0032")).map(str::to_owned);
    assert!(line.is_some_and(|line| line.starts_with("  PS  SoE  1 S-0-0032 0b00")));
    for words in ["S-0-0047 of drive 0 (SO) is left out", "S-0-0099 of drive 0 is left out"] {
        assert!(device.notes.iter().any(|note| note.contains(words)), "{:?}", device.notes);
    }
    let report = run(&scenario);
    assert!(report.in_sync, "{}", report.text());
}

/// A cycle that is no whole number of us leaves the description's value.
#[test]
fn a_cycle_that_has_no_number_stays() {
    for (cycle, expected) in [("1ms", [0xE8, 0x03]), ("999.5us", [0xD0, 0x07])] {
        let list = start_up(&scenario("cycle", |text| text, cycle));
        assert_eq!(written(&list.devices[0])[1].3, expected, "{cycle}");
    }
}

#[test]
fn a_refusal_names_drive_parameter_and_reason() {
    let ask = |drive, idn, data: &[u8]| {
        let scenario = scenario("refused", |text| text, "1ms");
        let mut run = scenario.run();
        let parameters = &mut run.setup.config.devices[0].parameters;
        parameters.push(StartupParameter { drive, idn: Idn(idn), data: data.to_vec() });
        let outcome = run.execute(None::<NoTap>, &mut |_| {});
        let error = outcome.failure.expect("it is refused");
        let Cause::Soe { drive: at, idn: which, error: reason, .. } = error.cause else {
            panic!("{error}");
        };
        assert_eq!((at, which), (drive, Idn(idn)));
        (reason, error.to_string())
    };
    let refused = |drive, idn, data: &[u8]| match ask(drive, idn, data) {
        (SoeError::Code(code), _) => code,
        (other, _) => panic!("{other}"),
    };
    assert_eq!(refused(0, 33, &[0, 0]), ErrorCode::NO_IDN);
    assert_eq!(refused(2, 1, &[0, 0]), ErrorCode::DRIVE_NUMBER);
    assert_eq!(refused(0, 1, &[0]), ErrorCode::VALUE_TOO_SHORT);
    assert_eq!(refused(0, 1, &[0; 3]), ErrorCode::VALUE_TOO_LONG);
    assert_eq!(refused(1, 36, &[0; 4]), ErrorCode::VALUE_READ_ONLY);
    assert_eq!(refused(0, 15, &[6, 0]), ErrorCode::VALUE_INVALID);
    // Longer than the mailbox, so in three messages: refused as a whole, at the end.
    assert_eq!(refused(0, 33_000, &[0; 150]), ErrorCode::VALUE_TOO_LONG);
    let (_, words) = ask(0, 33, &[0, 0]);
    let expected = "drive 0, S-0-0033: SoE error 0x1001 (the drive does not have this IDN)";
    assert!(words.contains(expected), "{words}");
}

#[test]
fn a_device_without_soe_is_not_brought_up_with_parameters() {
    let scenario =
        scenario("other", |text| text.replace("<SoE Ch", "<!--").replace("</SoE>", "-->"), "1ms");
    let mut run = scenario.run();
    let parameters = &mut run.setup.config.devices[0].parameters;
    assert!(parameters.is_empty());
    parameters.push(StartupParameter { drive: 0, idn: Idn(1), data: vec![0, 0] });
    let outcome = run.execute(None::<NoTap>, &mut |_| {});
    let error = outcome.failure.expect("there is nothing to write to");
    assert!(matches!(error.cause, Cause::Soe { error: SoeError::Mailbox(_), .. }), "{error}");
}

/// No other tool is told the parameters; each output says so, with their values.
#[test]
fn outputs_for_other_tools_name_what_they_leave_out() {
    let scenario = scenario("tools", |text| text, "1ms");
    let plan = Plan::of(&scenario).expect("it fits");
    for tool in Tool::ALL {
        let files = tool.files(&plan, &scenario);
        let text: String = files.iter().map(|file| file.text.as_str()).collect();
        // Long notes are broken into lines, each with the mark of a comment.
        let words: String = text.chars().filter(char::is_ascii_alphanumeric).collect();
        assert!(words.contains("S00032ofdrive10b00"), "{}: {text}", tool.name());
    }
}
