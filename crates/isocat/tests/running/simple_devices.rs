//! Devices without mailbox: `isocat run` takes them to OP by what their SII tells.

use std::process::Command;

use isocat::{Nanos, Report, Scenario, SegmentFile, run};

fn judged(text: &str) -> Report {
    let mut scenario = Scenario::from(SegmentFile::parse("simple.toml", text).expect("it reads"));
    scenario.duration = Nanos::millis(200);
    run(&scenario)
}

fn of_simple(count: usize) -> String {
    format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = {count}\n")
}

/// Every one is in OP, with its delay measured and its time the reference clock's.
fn assert_simple(report: &Report) {
    for device in report.devices.iter().filter(|device| device.profile.starts_with("simple_io")) {
        let registers = &device.registers;
        assert_eq!((device.mode.name(), registers.al_status.is_op()), ("sm", true));
        assert_eq!(registers.output_sync_type, None, "{}: no objects", device.name);
        assert_eq!(device.cycle_ns, Some(1_000_000));
        let difference = registers.system_time_difference_ns;
        assert_eq!(difference.is_some(), device.position > 0, "the first one is the reference");
        // Behind fifty hops that jitter by 12 ns each.
        assert!(difference.is_none_or(|ns| ns.abs() < 200), "{}: {difference:?}", device.name);
        assert!(registers.delay_ns.is_some_and(|delay| (delay > 0) == (device.position > 0)));
        assert_eq!(device.true_time.sync0_error, None);
    }
    let delays: Vec<_> = report.devices.iter().map(|device| device.registers.delay_ns).collect();
    assert!(delays.is_sorted(), "each is further away: {delays:?}");
    assert_eq!(report.segment.main_device.working_counter_errors, 0);
}

#[test]
fn four_simple_devices_come_to_op() {
    let report = judged(&of_simple(4));
    assert!(report.in_sync, "{}", report.verdict);
    assert_eq!(report.verdict, "In sync: 4 of 4 SubDevices.");
    assert_simple(&report);
}

#[test]
fn fifty_simple_devices_come_to_op() {
    let report = judged(&of_simple(50));
    assert!(report.in_sync, "{}", report.verdict);
    assert_eq!(report.devices.len(), 50);
    assert_simple(&report);
}

/// Simple devices before, between and behind the drives of the built-in segment.
#[test]
fn fifty_among_the_drives_of_the_built_in_segment() {
    let simple = |count| format!("[[subdevice]]\ndevice = \"simple_io16\"\ncount = {count}\n");
    let mut parts = SegmentFile::built_in_text().split("[[subdevice]]");
    let mut text = parts.next().expect("its head").to_owned();
    // None between the coupler and its terminal.
    for (part, count) in parts.zip([10, 20, 15, 0, 0]) {
        if count > 0 {
            text += &simple(count);
        }
        text += "[[subdevice]]";
        text += part;
        text += "\n";
    }
    text += &simple(5);
    let report = judged(&text);
    assert!(report.in_sync, "{}", report.verdict);
    assert_eq!(
        report.verdict,
        "In sync: 53 of 55 SubDevices, 2 in Free Run as announced or asked for."
    );
    assert_simple(&report);
    let drives = report.devices.iter().filter_map(|device| device.true_time.sync0_error);
    assert_eq!(drives.inspect(|error| assert!(error.worst_ns < 200.0, "{error:?}")).count(), 3);
}

#[test]
fn the_command_says_so_with_its_exit_code() {
    let path = std::env::temp_dir().join(format!("isocat-simple-{}.toml", std::process::id()));
    for count in [4, 50] {
        std::fs::write(&path, of_simple(count)).expect("a file");
        let command = env!("CARGO_BIN_EXE_isocat");
        let output = Command::new(command).args(["run", "--for", "100ms"]).arg(&path).output();
        let output = output.expect("it runs");
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(0), "{text}");
        assert!(text.starts_with(&format!("In sync: {count} of {count} SubDevices.")), "{text}");
    }
    std::fs::remove_file(&path).expect("it was written");
}

#[test]
fn a_mode_that_the_profile_does_not_list_is_refused() {
    let text = of_simple(1) + "mode = \"dc-sync0\"\n";
    let error = SegmentFile::parse("simple.toml", &text).expect_err("it has no such mode");
    assert_eq!(
        error.message,
        "mode \"dc-sync0\" is not possible with Simple IO 16: it has no mailbox, and its profile does \
         not list it"
    );
    assert_eq!(error.hint.as_deref(), Some("it announces: sm"));
}

/// Valve terminals have four SyncManagers of outputs and no inputs: SM3 is then no event of inputs.
#[test]
fn outputs_in_sm3_are_not_taken_for_inputs() {
    let manager = |number: u16| {
        let at = 0x1000 + 0x100 * number;
        format!("<Sm StartAddress=\"{at}\" ControlByte=\"#x44\" Enable=\"1\">Outputs</Sm>")
    };
    let pdo = |number: u16| {
        let index = 0x1600 + number;
        format!(
            "<RxPdo Sm=\"{number}\"><Index>{index}</Index><Name>V</Name><Entry><Index>{}</Index>\
             <SubIndex>1</SubIndex><BitLen>8</BitLen><Name>V</Name><DataType>USINT</DataType></Entry></RxPdo>",
            0x7000 + number
        )
    };
    let of_all = |part: &dyn Fn(u16) -> String| (0..4).map(part).collect::<String>();
    let description = format!(
        "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups><Group>\
         <Type>G</Type></Group></Groups><Devices><Device Physics=\"YY\"><Type ProductCode=\"2\" \
         RevisionNo=\"3\">Valves</Type><GroupType>G</GroupType>{}{}<Eeprom/></Device></Devices>\
         </Descriptions></EtherCATInfo>",
        of_all(&manager),
        of_all(&pdo)
    );
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("valves.xml");
    std::fs::write(&path, description).expect("a description");
    let report = judged(&format!(
        "cycle = \"1ms\"\n[[subdevice]]\nesi = {:?}\n",
        path.display().to_string()
    ));
    assert!(report.in_sync, "{}", report.verdict);
    let seen = &report.devices[0].true_time;
    assert!(seen.inputs_age.is_none() && seen.outputs_age.is_some(), "{seen:?}");
}
