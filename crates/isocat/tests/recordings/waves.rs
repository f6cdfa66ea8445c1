//! The waveforms of a run, read back: each SubDevice has its signals, pulses come a cycle apart,
//! steps follow their causes.

use std::collections::HashMap;

use isocat::waves::Waves;
use isocat::{Nanos, Scenario, SegmentFile};
use vcd::{Command, Parser, ScopeItem, Value};

/// Times of the rising changes of each signal, by `scope.name`, ps.
fn signals() -> HashMap<String, Vec<u64>> {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(50);
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let mut file = Vec::new();
    let outcome = scenario.run().execute(Some(Waves::new(&mut file, names)), &mut |_| {});
    assert!(outcome.in_sync());
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    let mut parser = Parser::new(&file[..]);
    let header = parser.parse_header().expect("a header");
    assert_eq!(header.timescale, Some((1, vcd::TimescaleUnit::PS)));
    let scope = |item: &ScopeItem| match item {
        ScopeItem::Scope(scope) => Some(scope.clone()),
        _ => None,
    };
    let segment = header.items.iter().find_map(scope).expect("one scope for all");
    let mut names = HashMap::new();
    for item in &segment.items {
        let ScopeItem::Scope(device) = item else { continue };
        for item in &device.items {
            let ScopeItem::Var(var) = item else { continue };
            names.insert(var.code, format!("{}.{}", device.identifier, var.reference));
        }
    }
    let mut times: HashMap<String, Vec<u64>> = HashMap::new();
    let (mut now, mut last) = (0, 0);
    for command in parser {
        match command.expect("a command") {
            Command::Timestamp(at) => {
                assert!(at >= last, "time goes on");
                (now, last) = (at, at);
            }
            Command::ChangeScalar(id, Value::V1) => {
                times.entry(names[&id].clone()).or_default().push(now)
            }
            _ => {}
        }
    }
    times
}

#[test]
fn waves_are_those_of_the_run() {
    let signals = signals();
    let of =
        |name: &str| signals.get(name).unwrap_or_else(|| panic!("{name}: {:?}", signals.keys()));
    let scopes: Vec<&str> = signals.keys().filter_map(|name| name.strip_suffix(".sync0")).collect();
    assert_eq!(scopes.len(), 3, "three of four have SYNC0: {scopes:?}");
    for scope in scopes {
        let sync0 = of(&format!("{scope}.sync0"));
        assert!(sync0.len() >= 50, "{scope}");
        for pair in sync0.windows(2) {
            // 1 ms of the reference's clock, in true time, and a tick.
            let cycle = (pair[1] - pair[0]) as i64 - 1_000_000_000;
            assert!(cycle.abs() < 100_000, "{scope}: {cycle} ps");
        }
        // In operation each pulse is followed by Outputs Valid, within the jitter of the program.
        let valid = of(&format!("{scope}.outputs_valid"));
        let late = &valid[valid.len() - 30..];
        for at in late {
            let before = sync0.iter().rev().find(|pulse| *pulse <= at).expect("a pulse before");
            assert!(at - before < 100_000_000, "{scope}: {} ps behind SYNC0", at - before);
        }
        assert!(of(&format!("{scope}.sm2")).len() >= 50);
    }
    assert!(!signals.keys().any(|name| name.ends_with(".sm_missed")), "nothing was missed");
}
