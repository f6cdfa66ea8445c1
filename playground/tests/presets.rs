//! Each preset shows what it promises.

use std::collections::BTreeMap;

use isocat_playground::answer::{Answer, of};
use isocat_playground::presets::PRESETS;

fn texts(state: &str) -> BTreeMap<String, String> {
    let pairs = state.split('&').filter_map(|pair| pair.split_once('='));
    pairs.map(|(key, text)| (key.to_owned(), text.to_owned())).collect()
}

fn preset(id: &str) -> Answer {
    let preset = PRESETS.iter().find(|preset| preset.id == id).expect("there is such a preset");
    of(&texts(preset.state))
}

#[test]
fn print() {
    for p in PRESETS {
        let t = std::time::Instant::now();
        let a = preset(p.id);
        println!(
            "{}: {:?} {} {:?} at {:?} {} pictures {} bytes, {:?}",
            p.id,
            a.problems,
            a.verdict,
            a.findings,
            a.at,
            a.pictures.len(),
            a.pictures.iter().map(|p| p.svg.len()).sum::<usize>(),
            t.elapsed()
        );
        for d in &a.devices {
            println!(
                "   {} {} {} sync0 {} margin {} outputs {} {:?}",
                d.name, d.mode, d.state, d.sync0, d.margin, d.outputs, d.counters
            );
        }
    }
}
