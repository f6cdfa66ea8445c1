//! Cost of a cycle of the built-in segment: MainDevice, wire, five ESCs with stacks, judges.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isocat::{Nanos, Scenario, SegmentFile, run};

fn cycles(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("built-in segment");
    group.sample_size(10);
    let mut scenario = Scenario::from(SegmentFile::built_in());
    // Two lengths: their difference is free of the bring-up.
    for milliseconds in [100, 1_100] {
        scenario.duration = Nanos::millis(milliseconds);
        group.throughput(Throughput::Elements(milliseconds as u64));
        group.bench_function(format!("{milliseconds} cycles"), |bencher| {
            bencher.iter(|| {
                let report = run(&scenario);
                assert!(report.in_sync, "{}", report.verdict);
                report
            });
        });
    }
    group.finish();
}

criterion_group!(benches, cycles);
criterion_main!(benches);
