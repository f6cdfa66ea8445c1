//! The trace of a run, read back: tracks by name, slices that end and nest, pulses a cycle apart,
//! stamps of the run.

use std::collections::HashMap;

use isocat::trace::Trace;
use isocat::trace::schema::{self, TrackEvent, Type};
use isocat::{Nanos, Scenario, SegmentFile};
use prost::Message;

/// Events of each track, by `process/track`.
fn tracks(text: Option<&str>) -> HashMap<String, Vec<(u64, TrackEvent)>> {
    let file = match text {
        Some(text) => SegmentFile::parse("trace.toml", text).expect("it reads"),
        None => SegmentFile::built_in(),
    };
    let mut scenario = Scenario::from(file);
    scenario.duration = Nanos::millis(50);
    let names: Vec<String> = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let mut bytes = Vec::new();
    let trace = Trace::new(&mut bytes, &names).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(trace), &mut |_| {});
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    let trace = schema::Trace::decode(&bytes[..]).expect("a trace");
    let (mut processes, mut names) = (HashMap::new(), HashMap::new());
    let mut tracks: HashMap<String, Vec<_>> = HashMap::new();
    for packet in trace.packet {
        if let Some(described) = packet.track_descriptor {
            let uuid = described.uuid.expect("a number");
            match (described.process.clone(), described.parent_uuid) {
                (Some(process), _) => {
                    processes.insert(uuid, process.process_name.expect("a name"));
                }
                (None, Some(parent)) => {
                    let name = format!("{}/{}", processes[&parent], described.name());
                    assert!(names.insert(uuid, name).is_none(), "each number once");
                }
                (None, None) => panic!("{described:?}"),
            }
        } else if let Some(event) = packet.track_event {
            let name = names[&event.track_uuid.expect("a track")].clone();
            tracks.entry(name).or_default().push((packet.timestamp.expect("a stamp"), event));
        }
    }
    for events in tracks.values_mut() {
        events.sort_by_key(|(at, _)| *at);
    }
    tracks
}

#[test]
fn a_trace_is_that_of_the_run() {
    let tracks = tracks(None);
    let of = |name: &str| tracks.get(name).unwrap_or_else(|| panic!("{name}: {:?}", tracks.keys()));
    for (name, events) in &tracks {
        let mut open = 0;
        for (at, event) in events {
            match event.r#type() {
                Type::SliceBegin => open += 1,
                Type::SliceEnd => open -= 1,
                Type::Instant => assert!(event.name.is_some(), "{name}"),
                Type::Counter => {
                    let value = (event.counter_value, event.double_counter_value);
                    assert!(matches!(value, (Some(_), None) | (None, Some(_))), "{name}");
                }
                Type::Unspecified => panic!("{name}: an event of no type"),
            }
            assert!((0..=1).contains(&open), "{name} at {at}: {open} slices");
        }
        assert_eq!(open, 0, "{name}");
    }
    for device in ["SubDevice 0 (AKD2G axis 1)", "SubDevice 4 (SSC drive axis 3)"] {
        let pulses = of(&format!("{device}/SYNC0"));
        assert!(pulses.len() >= 50);
        for pair in pulses.windows(2) {
            // 1 ms of the reference's clock, in true time, and a tick.
            let cycle = (pair[1].0 - pair[0].0) as i64 - 1_000_000;
            assert!(cycle.abs() < 100, "{device}: {cycle} ns");
        }
        // Each pulse is one of the judged ones from then on, and has its error.
        let errors = of(&format!("{device}/SYNC0 error"));
        assert!(errors.len() >= 50, "{}", errors.len());
        assert!(errors.iter().all(|(at, _)| pulses.iter().any(|pulse| pulse.0 == *at)));
        let worst = errors.iter().filter_map(|(_, event)| event.double_counter_value);
        assert!(worst.map(f64::abs).fold(0.0, f64::max) < 100.0, "ns");
        let states: Vec<&str> = of(&format!("{device}/AL state"))
            .iter()
            .filter_map(|(_, event)| event.name.as_deref())
            .collect();
        assert_eq!(states, ["INIT", "PREOP", "SAFEOP", "OP"]);
        for step in ["copy outputs", "application", "outputs valid", "latch inputs", "copy inputs"]
        {
            assert!(of(&format!("{device}/{step}")).len() >= 100, "{device}: {step}");
        }
    }
    let frames = of("MainDevice/frames");
    assert!(frames.iter().any(|(_, event)| event.name() == "FRMW 0x0910, LRW, BRD 0x0130"));
    assert_eq!(
        of("MainDevice/servo").last().map(|(_, event)| event.r#type()),
        Some(Type::SliceEnd)
    );
    assert!(of("MainDevice/host phase error").len() >= 50);
    assert!(!tracks.contains_key("MainDevice/lost frames"), "none was lost");
    assert!(!tracks.keys().any(|name| name.ends_with("missed")), "nothing was missed");
}

#[test]
fn missed_events_are_instants() {
    let text = r#"
        cycle = "1ms"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        misbehave = ["missed-copy 20"]
    "#;
    let tracks = tracks(Some(text));
    let (_, missed) = tracks.iter().find(|(name, _)| name.ends_with("/SM event missed")).expect("");
    assert!(missed.len() >= 2);
    assert!(missed.iter().all(|(_, event)| event.name().starts_with("0x1C32:0B now ")));
}
