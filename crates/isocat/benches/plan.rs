//! The plan of a thousand devices, from the scenario to its document.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isocat::plan::{Plan, suggest};
use isocat::{Scenario, SegmentFile};

const DEVICES: u64 = 1_000;

fn plan(criterion: &mut Criterion) {
    let text = format!(
        "cycle = \"4ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\ncount = {DEVICES}\n"
    );
    let file = SegmentFile::parse("thousand", &text).expect("a segment file");
    let scenario = Scenario::from(file);
    let mut group = criterion.benchmark_group("plan of 1000 devices");
    group.sample_size(10).throughput(Throughput::Elements(DEVICES));
    group.bench_function("plan and document", |bencher| {
        bencher.iter(|| {
            let report = Plan::of(&scenario).expect("a plan").report(&scenario);
            assert!(report.fits, "{}", report.verdict);
            report
        });
    });
    let plan = Plan::of(&scenario).expect("a plan");
    group.bench_function("suggestion", |bencher| {
        bencher.iter(|| suggest::suggest(&plan, &scenario))
    });
    group.finish();
}

criterion_group!(benches, plan);
criterion_main!(benches);
