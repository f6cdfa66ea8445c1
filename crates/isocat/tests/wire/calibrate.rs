//! `isocat calibrate --interface` on a veth pair, with a served segment on the other end: it tells
//! the drift law that was set and never another one, whatever the jitter of the host.
//!
//! Needs root and the command `ip`; without them the test says so.

use serde_json::Value;

use crate::alone::not_shown;
use crate::service::{Service, isocat, text};

#[test]
fn a_served_segment_shows_what_was_set() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate-wire");
    std::fs::create_dir_all(&folder).expect("a folder");
    let [path, chips, bare] = ["served.toml", "chips.toml", "bare.toml"]
        .map(|name| folder.join(name).display().to_string());
    let drive = |clock: &str| {
        format!(
            "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nclock = \"{clock}\"\ncable = \"3m\"\n"
        )
    };
    let devices = format!("cycle = \"1ms\"\n{}{}", drive("5ppm"), drive("-12ppm"));
    std::fs::write(&bare, &devices).expect("a segment file");
    let law = "drift_law = \"block\"\ndrift_phase = 10\n";
    std::fs::write(&path, format!("{law}{devices}")).expect("a segment file");
    let Some(service) = Service::start("isct-cal", &[&path]) else { return };
    let mut told = String::new();
    for _ in 0..3 {
        let output = service.run(&["calibrate", "--json", "--chips", &chips]);
        let Ok(value) = serde_json::from_slice::<Value>(&output.stdout) else {
            told = text(&output.stderr);
            continue;
        };
        assert_eq!(value["left_changed"], Value::Array(Vec::new()));
        let follower = &value["devices"][1];
        // Whatever the host's jitter: another law than the one that was set is never told.
        if follower["law"]["verdict"] == "told" {
            assert_eq!(follower["law"]["name"], "block", "{follower:#}");
            assert_eq!(follower["law"]["phase"], 10, "{follower:#}");
            assert_eq!(follower["difference_polarity"], "positive-ahead");
            let crystal = follower["crystal_ppb"]["value"].as_f64().expect("a figure");
            assert!((crystal + 17_000.0).abs() < 50.0, "{crystal}");
            // What was measured on a wire is taken by a plan of the same devices.
            let prove = ["plan", &bare, "--chips", &chips, "--prove", "--for", "1s", "--json"];
            let output = isocat(&prove);
            assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
            let plan: Value = serde_json::from_slice(&output.stdout).expect("JSON");
            assert_eq!(plan["fits"], true);
            return;
        }
        told = format!("{follower}");
    }
    // The host's jitter made it impossible, and the command said so each time.
    not_shown("calibrate::a_served_segment_shows_what_was_set", &told);
}
