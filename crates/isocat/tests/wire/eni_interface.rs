//! `isocat run NETWORK.xml --interface` on a veth pair, with `isocat serve` on the other end: the
//! list of a configuration tool is executed over sockets of the kernel, in real time.
//!
//! Needs root and the command `ip`; without them the test says so. Each further statement on such a
//! list is made in virtual time, in `tests/command/eni_interface.rs`.

use serde_json::Value;

use crate::alone::not_shown;
use crate::service::{Service, isocat, text};

/// Slow, for a machine that has other things to do.
const TWO_DRIVES: &str =
    "cycle = \"10ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = 2\n";

#[test]
fn our_own_export_runs_on_a_wire() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("eni-wire");
    std::fs::create_dir_all(&folder).expect("a folder");
    let [segment, eni] =
        ["served.toml", "network.xml"].map(|name| folder.join(name).display().to_string());
    std::fs::write(&segment, TWO_DRIVES).expect("the folder is ours");
    let output = isocat(&["plan", &segment, "--eni", &eni]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let Some(service) = Service::start("isct-en-run", &[&segment]) else { return };
    for _ in 0..5 {
        let output = service.run(&["run", &eni, "--for", "1s", "--json"]);
        let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let (run, interface) = (&report["run"], &report["run"]["interface"]);
        if run["in_sync"] != true {
            // A machine that stalls throws devices out of sync with good reason.
            eprintln!("the machine stalls: {}", interface["verdict"]);
            continue;
        }
        assert_eq!(output.status.code(), Some(0), "{report:#}");
        assert_eq!((&run["failure"], &interface["ended_by"]), (&Value::Null, &"time".into()));
        assert_eq!(report["differences"], Value::Array(Vec::new()));
        for device in interface["devices"].as_array().expect("devices") {
            assert_eq!(device["registers"]["al_status"], "OP", "{device:#}");
        }
        // The served segment knows true time, and its devices were left in INIT.
        service.done(&["stop"]);
        let (summary, _) = service.finish();
        assert!(summary.contains("In sync") && summary.contains(": INIT"), "{summary}");
        return;
    }
    not_shown("eni_interface::our_own_export_runs_on_a_wire", "out of sync in each of five runs");
}
