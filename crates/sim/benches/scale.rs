//! Cost of a cycle of a line of N SubDevices: for the segment alone, and with a MainDevice.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};

mod line;

use line::{Line, run_cycles, world};

fn segment(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("segment");
    group.sample_size(10);
    for count in [1, 10, 100, 1000, 10_000] {
        let mut line = Line::new(count);
        group.throughput(Throughput::Elements(count as u64));
        group.bench_function(format!("{count} SubDevices"), |bencher| {
            bencher.iter(|| line.cycle());
        });
        line.assert_applications_ran();
    }
    group.finish();
}

fn with_main_device(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("segment and MainDevice");
    group.sample_size(10);
    for count in [1, 10, 100, 1000] {
        let mut world = world(count).expect("the line comes up");
        group.throughput(Throughput::Elements(count as u64));
        group.bench_function(format!("{count} SubDevices"), |bencher| {
            bencher.iter(|| assert_eq!(run_cycles(&mut world, 1), 0, "wrong working counters"));
        });
    }
    group.finish();
}

criterion_group!(benches, segment, with_main_device);
criterion_main!(benches);
