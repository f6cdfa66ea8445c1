//! Frames that `isocat diagnose` reads in a second, of a healthy capture. Beside `tshark`:
//! `benches/diagnose.sh`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isocat::capture::Capture;
use isocat::diagnose::{Diagnosis, Names};
use isocat::{Nanos, Scenario, SegmentFile};

/// The built-in segment for ten seconds: 20 000 frames and what the way up takes.
fn captured() -> Vec<u8> {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(10_000);
    let tap = Capture::new(Vec::new()).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    assert!(outcome.failure.is_none());
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything")
}

fn frames(criterion: &mut Criterion) {
    let file = captured();
    // Sections of a file may follow one another: so may whole files.
    let read = |times: usize| {
        let mut diagnosis = Diagnosis::new();
        diagnosis.read("made", &file.repeat(times)[..]).expect("a capture");
        diagnosis.report(&Names::default()).expect("EtherCAT")
    };
    let packets = read(1).captures[0].packets;
    let mut group = criterion.benchmark_group("diagnose");
    group.sample_size(10);
    for times in [1, 10] {
        group.throughput(Throughput::Elements(packets as u64 * times as u64));
        group.bench_function(format!("{times} x 10 s"), |bencher| bencher.iter(|| read(times)));
    }
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
