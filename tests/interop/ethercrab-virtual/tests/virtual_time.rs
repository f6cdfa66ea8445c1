//! ethercrab as it comes from the registry, on isocat's segment, in virtual time: it comes to OP,
//! is judged, and all of it repeats.
//!
//! `ISOCAT_SEEDS=20 cargo test --release -- --nocapture lateness_table` here prints the table of
//! docs/testing-rust.md.
#![cfg(not(feature = "std"))]

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Duration;

use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use interop_ethercrab_virtual::{Group, Job, Response, operate};
use isocat_testing::{
    AlState, Bus, Segment, Task, Verdict, ethercat_now, ethercrab_tx_rx_task, run, seeds,
};

const MS: Duration = Duration::from_millis(1);
const US: Duration = Duration::from_micros(1);

/// As in production, but for the interface.
fn main_device(bus: &Bus) -> MainDevice<'static> {
    // ethercrab's types want memory that lives as long as the process.
    let storage: &'static PduStorage<16, { PduStorage::element_size(1472) }> =
        Box::leak(Box::new(PduStorage::new()));
    let (tx, rx, pdu_loop) = storage.try_split().expect("it is split once");
    let frames = ethercrab_tx_rx_task!(bus, tx, rx);
    let _runs_on = bus.spawn(async { frames.await.expect("frames are sent and received") });
    let timeouts = Timeouts {
        state_transition: 10_000 * MS,
        pdu: 30 * MS,
        eeprom: 500 * MS,
        wait_loop_delay: MS,
        mailbox_echo: 1_000 * MS,
        mailbox_response: 2_000 * MS,
    };
    MainDevice::new(pdu_loop, timeouts, MainDeviceConfig::default())
}

/// Clocks this near to the reference let the application go on, ns.
const NEAR: Option<u32> = Some(500);

/// Starts the application at a cycle of 1 ms.
fn start(
    bus: &Bus,
    each_cycle: impl FnMut(&Group, &MainDevice<'static>, Option<&Response>) -> bool + 'static,
) -> Task<()> {
    start_with(bus, NEAR, each_cycle)
}

fn start_with(
    bus: &Bus,
    clocks_within: Option<u32>,
    each_cycle: impl FnMut(&Group, &MainDevice<'static>, Option<&Response>) -> bool + 'static,
) -> Task<()> {
    let (main_device, host) = (main_device(bus), bus.clone());
    let sleep = async move |time| host.host_sleep(time).await;
    let job = Job { cycle: MS, clocks_within, sleep, each_cycle, now: ethercat_now };
    bus.spawn(async move {
        operate(&main_device, job).await.expect("the application goes on");
    })
}

/// The application until it has had so many cycles in which all devices were in OP.
fn cycles(segment: Segment, count: u32) -> Verdict {
    cycles_with(segment, NEAR, count)
}

fn cycles_with(segment: Segment, clocks_within: Option<u32>, count: u32) -> Verdict {
    run(segment, async |bus| {
        let mut left = count;
        let application = start_with(&bus, clocks_within, move |_, _, response| {
            left -= u32::from(response.is_some_and(|response| response.all_op()));
            left > 0
        });
        application.await;
    })
}

#[test]
fn ten_thousand_cycles_are_judged_in_true_time_and_repeat_to_the_byte() {
    let judged = || cycles(Segment::built_in().seed(1), 10_000);
    let verdict = judged();
    println!("{verdict}");
    assert!(verdict.in_sync(), "{verdict}");
    assert!(verdict.lasted() > 10_000 * MS, "{:?}", verdict.lasted());
    let session = &verdict.summary().sessions[0];
    let judged_devices = &session.judged.as_ref().expect("in OP").devices;
    assert!(judged_devices.iter().all(|device| device.state == "OP"));
    assert_eq!(judged_devices.iter().filter(|device| device.sync0_error.is_some()).count(), 3);
    assert_eq!(verdict, judged());
}

/// The 10 000 drift frames that ethercrab sends by itself end before the clocks of this segment's
/// law have converged, and nothing that it can read says so: all are in OP, and no device counts
/// anything.
#[test]
fn clocks_that_have_not_converged_are_seen_by_the_judges_alone() {
    let verdict = cycles_with(Segment::built_in(), None, 500);
    assert!(!verdict.in_sync(), "{verdict}");
    let judged = verdict.summary().sessions[0].judged.as_ref().expect("in OP");
    for device in &judged.devices {
        assert_eq!(device.state, "OP");
        let counters = [device.sm_event_missed, device.cycle_time_too_small];
        assert_eq!((counters, device.shift_time_too_short, device.sync_error), ([0, 0], 0, 0));
    }
    let errors = judged.devices.iter().filter_map(|device| device.sync0_error.as_ref());
    let worst = errors.map(|error| error.worst_ns).fold(0.0, f64::max);
    assert!(worst > 10_000.0, "{worst} ns");
    assert!(cycles(Segment::built_in(), 500).in_sync(), "with patience");
}

#[test]
fn lateness_of_the_host_takes_from_the_margin_by_the_seed() {
    let least = |seed, late: u32| {
        let verdict = cycles(Segment::built_in().seed(seed).lateness(late * US), 500);
        (verdict.in_sync(), verdict.least_margin_ns().expect("SYNC0 runs"))
    };
    let margins: Vec<_> = [0, 50, 100, 200].map(|late| least(1, late)).to_vec();
    assert!(margins.iter().all(|(in_sync, _)| *in_sync), "{margins:?}");
    assert!(margins.windows(2).all(|pair| pair[1].1 < pair[0].1 - 10_000.0), "{margins:?}");
    assert_eq!(least(2, 100), least(2, 100));
    assert_ne!(least(2, 100), least(3, 100));
}

/// `cargo test -- --nocapture lateness_table` with `ISOCAT_SEEDS=20` prints the table of
/// docs/testing-rust.md.
#[test]
fn lateness_table() {
    let count: u64 =
        std::env::var("ISOCAT_SEEDS").map_or(1, |text| text.parse().expect("a number"));
    println!("{:>9}  {:>5}  {:>7}  {:>16}", "late, us", "in OP", "in sync", "least margin, us");
    for late in [0, 50, 100, 200, 300, 400, 500] {
        let (mut up, mut in_sync, mut margin) = (0, 0, f64::INFINITY);
        for seed in 1..=count {
            let segment = Segment::built_in().seed(seed).lateness(late * US);
            let verdict = run(segment, async |bus| {
                let _runs_on = start(&bus, |_, _, _| true);
                bus.sleep(60_000 * MS).await;
            });
            up += u64::from(verdict.summary().sessions.iter().any(|one| one.judged.is_some()));
            in_sync += u64::from(verdict.in_sync());
            margin = margin.min(verdict.least_margin_ns().unwrap_or(f64::INFINITY) / 1000.0);
        }
        println!("{late:>9}  {up:>5}  {in_sync:>7}  {margin:>16.1}");
        assert!(late > 100 || in_sync == count, "{late} us late");
    }
}

#[test]
fn a_cable_is_pulled_and_plugged_and_the_application_brings_its_devices_back() {
    let recovered = || {
        run(Segment::built_in(), async |bus| {
            // What the application sees: the working counter of a cycle that all devices took part
            // in, the last one, and the states.
            let counters = Rc::new(Cell::new((0, 0)));
            let (seen, all_op) = (Rc::clone(&counters), Rc::new(Cell::new(false)));
            let says = Rc::clone(&all_op);
            let _runs_on = start(&bus, move |_, _, response| {
                let counter = response.map_or(0, |response| response.working_counter);
                seen.set((counter.max(seen.get().0), counter));
                says.set(response.is_some_and(|response| response.all_op()));
                true
            });
            bus.within(120_000 * MS, |bus| bus.all_op()).await;
            bus.sleep(100 * MS).await;
            assert_eq!(counters.get().0, counters.get().1);
            bus.fault("pull SSC drive axis 3 for 1s");
            let axis = bus.device("SSC drive axis 3");
            bus.within(400 * MS, |bus| bus.device("SSC drive axis 3").has_error()).await;
            assert_eq!(axis.state(), AlState::SafeOp);
            bus.sleep(100 * MS).await;
            let (whole, last) = counters.get();
            assert!(
                last < whole && !all_op.get(),
                "{last} of {whole}, all in OP: {}",
                all_op.get()
            );
            bus.within(5_000 * MS, |bus| bus.all_op()).await;
            bus.sleep(100 * MS).await;
            assert_eq!(counters.get().0, counters.get().1);
        })
    };
    let verdict = recovered();
    assert!(!verdict.in_sync(), "an axis left OP: {verdict}");
    assert_eq!(verdict, recovered());
}

#[test]
fn what_the_machine_does_is_read_by_the_application_and_its_outputs_by_the_test() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                [[subdevice]]\ndevice = \"simple_io4\"\nname = \"doors\"\n";
    let verdict = run(Segment::parse(text).expect("a segment"), async |bus| {
        let seen = Rc::new(RefCell::new(Vec::new()));
        let inputs = Rc::clone(&seen);
        let _runs_on = start(&bus, move |group, main_device, _| {
            let doors = group.subdevice(main_device, 1).expect("it is there");
            let door = doors.inputs_raw()[0];
            if inputs.borrow().last() != Some(&door) {
                inputs.borrow_mut().push(door);
            }
            // A lamp burns while the door is open.
            doors.outputs_raw_mut()[0] = door << 1;
            true
        });
        bus.within(120_000 * MS, |bus| bus.all_op()).await;
        let doors = bus.device("doors");
        for door in [1, 0, 1] {
            doors.set_inputs(&[door]);
            bus.within(10 * MS, |bus| {
                bus.device("doors").outputs().expect("in OP")[0] == door << 1
            })
            .await;
        }
        assert_eq!(*seen.borrow(), [0, 1, 0, 1]);
    });
    assert!(verdict.in_sync(), "{verdict}");
}

#[test]
fn tests_side_by_side_give_what_each_gives_alone() {
    let of = |seed| cycles(Segment::built_in().seed(seed).lateness(50 * US), 200);
    let alone: Vec<Verdict> = (1..=2).map(of).collect();
    let together: Vec<Verdict> = std::thread::scope(|scope| {
        let threads: Vec<_> = (1..=2).map(|seed| scope.spawn(move || of(seed))).collect();
        threads.into_iter().map(|thread| thread.join().expect("it passes")).collect()
    });
    assert_eq!(alone, together);
}

#[test]
fn ten_hosts_with_bad_luck() {
    seeds(0..10, |seed| {
        let verdict = cycles(Segment::built_in().seed(seed).lateness(100 * US), 200);
        assert!(verdict.in_sync(), "{verdict}");
    });
}
