//! Measures the cost of a second of virtual time: isocat's own MainDevice is the application, at 1
//! ms, on the built-in segment. The throughput counts seconds of virtual time, so `elem/s` is the
//! ratio of virtual to real time on an idle machine.

use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput};
use isocat_maindevice::Config;
use isocat_testing::{Nanos, Segment, run};

#[path = "../tests/stack/mod.rs"]
mod stack;

/// Virtual time of one measurement.
const SPAN: Duration = Duration::from_secs(1);

fn operation(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("virtual time");
    group.sample_size(10).throughput(Throughput::Elements(SPAN.as_secs()));
    group.bench_function("built-in segment, 1 ms", |bencher| {
        bencher.iter_custom(|count| {
            let mut spent = Duration::ZERO;
            let span = SPAN * u32::try_from(count).unwrap_or(u32::MAX);
            let verdict = run(Segment::built_in().limit(span + 60 * SPAN), async |bus| {
                stack::start(&bus, Config::new(Nanos::millis(1)));
                bus.within(20 * SPAN, |bus| bus.all_op()).await;
                let began = Instant::now();
                bus.sleep(span).await;
                spent = began.elapsed();
            });
            assert!(verdict.in_sync(), "{verdict}");
            spent
        });
    });
    group.finish();
}

criterion::criterion_group!(benches, operation);
criterion::criterion_main!(benches);
