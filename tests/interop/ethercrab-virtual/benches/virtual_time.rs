//! What a second of virtual time costs with ethercrab at 1 ms on the built-in segment. The
//! throughput is in seconds of virtual time, so that `elem/s` is the ratio of virtual to real time,
//! on a machine that does nothing else.

use std::cell::Cell;
use std::time::{Duration, Instant};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use interop_ethercrab_virtual::{Job, operate};
use isocat_testing::{Segment, ethercat_now, ethercrab_tx_rx_task, run};

/// Virtual time of one measurement.
const SPAN: Duration = Duration::from_secs(1);

fn operation(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("ethercrab in virtual time");
    group.sample_size(10).throughput(Throughput::Elements(SPAN.as_secs()));
    group.bench_function("built-in segment, 1 ms", |bencher| {
        bencher.iter_custom(|count| {
            let spent = Cell::new(Duration::ZERO);
            let span = SPAN * u32::try_from(count).unwrap_or(u32::MAX);
            let verdict = run(Segment::built_in().limit(10_000 * SPAN), async |bus| {
                let storage: &'static PduStorage<16, { PduStorage::element_size(1472) }> =
                    Box::leak(Box::new(PduStorage::new()));
                let (tx, rx, pdu_loop) = storage.try_split().expect("it is split once");
                let frames = ethercrab_tx_rx_task!(bus, tx, rx);
                let _runs_on =
                    bus.spawn(async { frames.await.expect("frames are sent and received") });
                let main_device =
                    MainDevice::new(pdu_loop, Timeouts::default(), MainDeviceConfig::default());
                let host = bus.clone();
                let sleep = async move |time| host.host_sleep(time).await;
                let cycle = Duration::from_millis(1);
                let job = Job {
                    cycle,
                    clocks_within: Some(500),
                    sleep,
                    each_cycle: |_: &_, _: &_, _: Option<&_>| true,
                    now: ethercat_now,
                };
                let _runs_on = bus.spawn(async move {
                    operate(&main_device, job).await.expect("the application goes on");
                });
                bus.within(120 * SPAN, |bus| bus.all_op()).await;
                let began = Instant::now();
                bus.sleep(span).await;
                spent.set(began.elapsed());
            });
            assert!(verdict.in_sync(), "{verdict}");
            spent.get()
        });
    });
    group.finish();
}

criterion_group!(benches, operation);
criterion_main!(benches);
