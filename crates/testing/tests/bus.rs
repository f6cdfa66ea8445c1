//! Tests whole runs: a stack that builds its own frames, what the test observes and changes, and
//! the verdict.

mod stack;

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use isocat_maindevice::{Config, Recovery};
use isocat_testing::{AlState, Application, Nanos, Segment, Verdict, run, seeds};
use stack::ios;

const MS: Duration = Duration::from_millis(1);

/// Runs the built-in segment for a second in operation.
fn built_in(seed: u64, lateness: Duration) -> Verdict {
    // The stack knows nothing of drives: it neither assigns their PDOs nor starts SYNC0 everywhere.
    run(Segment::built_in().as_is().seed(seed).lateness(lateness), async |bus| {
        stack::bring_up(&bus).await;
        bus.sleep(1_000 * MS).await;
    })
}

#[test]
fn a_stack_comes_to_operation_and_is_judged() {
    let verdict = built_in(1, Duration::ZERO);
    assert!(verdict.in_sync() && verdict.as_expected(), "{verdict}");
    let summary = verdict.summary();
    let [session] = &summary.sessions[..] else { panic!("one session: {verdict}") };
    let judged = session.judged.as_ref().expect("judged");
    assert_eq!((judged.in_op, judged.devices.len()), (5, 5));
    assert!(judged.judged_ns >= 900_000_000, "{}", judged.judged_ns);
    assert!(verdict.lasted() > 1_000 * MS && verdict.lasted() < 20_000 * MS, "{verdict}");
    let text = verdict.to_string();
    assert!(text.contains("In sync: 5 of 5") && !text.contains('\u{1b}'), "{text}");
    assert!(text.contains(&format!("seed 1, wire {:016x}", verdict.wire_hash())), "{text}");
}

#[test]
fn two_runs_are_the_same_to_the_byte_and_another_seed_is_another_run() {
    let late = 100 * Duration::from_micros(1);
    assert_eq!(built_in(7, late), built_in(7, late));
    assert_ne!(built_in(7, late).wire_hash(), built_in(8, late).wire_hash());
    assert_ne!(built_in(7, late).wire_hash(), built_in(7, late / 2).wire_hash());
}

#[test]
fn tests_side_by_side_give_what_each_gives_alone() {
    let of = |seed| built_in(seed, 50 * Duration::from_micros(1));
    let alone: Vec<Verdict> = (1..=3).map(of).collect();
    let together: Vec<Verdict> = std::thread::scope(|scope| {
        let threads: Vec<_> = (1..=3).map(|seed| scope.spawn(move || of(seed))).collect();
        threads.into_iter().map(|thread| thread.join().expect("it passes")).collect()
    });
    assert_eq!(alone, together);
}

#[test]
fn the_margin_shrinks_by_the_lateness_of_the_host() {
    let margin = |micros| {
        let verdict = built_in(3, Duration::from_micros(micros));
        verdict.least_margin_ns().expect("SYNC0 runs")
    };
    let [none, some, more] = [0, 100, 200].map(margin);
    assert!(none - some > 60_000.0 && none - some <= 110_000.0, "{none} {some}");
    assert!(some - more > 60_000.0 && some - more <= 120_000.0, "{some} {more}");
}

#[test]
fn process_data_are_seen_and_set_by_the_test() {
    let _ = run(ios(2), async |bus| {
        let device = bus.device(1);
        assert_eq!(device.outputs(), None, "no outputs before OP");
        let main = stack::bring_up(&bus).await;
        main.borrow_mut().outputs_mut(1).fill(0xA5);
        device.set_inputs(&[0x5A]);
        bus.sleep(3 * MS).await;
        assert_eq!(device.outputs(), Some(vec![0xA5; 4]));
        // Bytes that the test does not set come from the profile's application, which copies its
        // outputs.
        assert_eq!(main.borrow().inputs(1)[..4], [0x5A, 0xA5, 0xA5, 0xA5]);
        device.release_inputs();
        bus.sleep(3 * MS).await;
        assert_eq!(main.borrow().inputs(1)[0], 0xA5, "given back");
        assert_eq!((device.position(), device.state()), (1, AlState::Op));
    });
}

/// The machine behind a device: a cylinder that arrives some cycles after its valve was opened.
struct Cylinder {
    valve: bool,
    way: Arc<AtomicU32>,
}

impl Application for Cylinder {
    fn map_outputs(&mut self, outputs: &[u8]) {
        self.valve = outputs[0] & 1 != 0;
    }

    fn application(&mut self, _cycle: Nanos) {
        self.way.fetch_add(u32::from(self.valve), Ordering::Relaxed);
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        inputs[0] = u8::from(self.way.load(Ordering::Relaxed) >= 50);
    }
}

#[test]
fn a_device_has_an_application_of_the_tests_own() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n\
                [[subdevice]]\ndevice = \"simple_io4\"\nname = \"cylinder\"\n";
    let way = Arc::new(AtomicU32::new(0));
    let segment = Segment::parse(text)
        .expect("a segment")
        .application("cylinder", Cylinder { valve: false, way: Arc::clone(&way) });
    let _ = run(segment, async |bus| {
        let main = stack::bring_up(&bus).await;
        main.borrow_mut().outputs_mut(1)[0] = 1;
        let opened = bus.now();
        bus.within(200 * MS, |_| main.borrow().inputs(1)[0] == 1).await;
        let took = bus.now() - opened;
        assert!((50 * MS..56 * MS).contains(&took), "{took:?}");
    });
    assert!(way.load(Ordering::Relaxed) >= 50);
}

#[test]
fn a_cable_is_pulled_and_plugged_and_the_device_comes_back() {
    let recovering = || {
        run(ios(3).seed(5), async |bus| {
            let mut config = Config::new(Nanos::millis(1));
            config.recovery =
                Recovery::BackOff { first: Nanos::millis(20), longest: Nanos::millis(100) };
            stack::start(&bus, config);
            bus.within(20_000 * MS, |bus| bus.all_op()).await;
            let last = bus.device(2);
            bus.fault_after(100 * MS, &format!("pull {} for 200ms", last.name()));
            bus.sleep(100 * MS + MS / 2).await;
            assert!(last.outputs().is_some(), "its watchdog has not expired yet");
            bus.within(200 * MS, |bus| bus.device(2).has_error()).await;
            assert_eq!((last.state(), last.outputs()), (AlState::SafeOp, None));
            assert_eq!(bus.device(1).state(), AlState::Op, "the others stay");
            bus.within(2_000 * MS, |bus| bus.all_op()).await;
            assert!(!bus.verdict().in_sync(), "it has been out of operation");
        })
    };
    let verdict = recovering();
    assert_eq!(verdict.summary().faults.len(), 2, "it began and ended: {verdict}");
    assert!(!verdict.in_sync(), "{verdict}");
    assert_eq!(verdict, recovering());
}

#[test]
fn a_host_that_stands_still_is_seen_by_the_judges_and_the_run_goes_on() {
    let with = |fault: &'static str| {
        run(Segment::built_in().as_is(), async |bus| {
            stack::bring_up(&bus).await;
            bus.sleep(100 * MS).await;
            bus.fault(fault);
            bus.sleep(200 * MS).await;
        })
    };
    let [short, long] = ["stall 50us", "stall 5ms"].map(with);
    assert!(short.in_sync(), "{short}");
    assert!(!long.in_sync(), "{long}");
    let [seldom, always] = ["late-wake-ups 700us 0%", "late-wake-ups 700us"].map(with);
    assert!(seldom.in_sync(), "{seldom}");
    assert!(!always.in_sync(), "{always}");
}

#[test]
fn a_verdict_in_the_middle_is_as_of_then() {
    let end = run(Segment::built_in().as_is(), async |bus| {
        assert!(!bus.verdict().in_sync(), "no frame was received");
        stack::bring_up(&bus).await;
        bus.sleep(100 * MS).await;
        let early = bus.verdict();
        assert!(early.in_sync(), "{early}");
        bus.sleep(100 * MS).await;
        let later = bus.verdict();
        assert_eq!(later.lasted() - early.lasted(), 100 * MS);
        assert!(later.in_sync() && later.wire_hash() != early.wire_hash());
    });
    assert!(end.in_sync(), "{end}");
}

/// A broadcast read of the AL status, which counts the devices.
fn who_is_there() -> Vec<u8> {
    let mut frame = vec![0xFF; 6];
    frame.extend([0x02, 0, 0, 0, 0, 0x01, 0x88, 0xA4]);
    frame.extend([0x0E, 0x10, 0x07, 0, 0, 0, 0x30, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0]);
    frame
}

#[test]
fn frames_by_hand_come_back_when_the_wire_and_the_host_let_them() {
    let took = |latency| {
        let mut took = Duration::ZERO;
        let _ = run(ios(3).latency(latency), async |bus| {
            let socket = bus.socket();
            socket.send(&who_is_there());
            assert_eq!(socket.try_receive(), None, "it is under way");
            let answer = socket.receive().await;
            assert_eq!(answer[28..30], [3, 0], "three devices counted");
            took = bus.now();
        });
        took
    };
    // 60 bytes, preamble and check sequence take 5.76 us on the wire; three devices add their
    // delays.
    let wire = took(Duration::ZERO);
    assert!(wire > Duration::from_nanos(5_760) && wire < Duration::from_micros(15), "{wire:?}");
    assert_eq!(took(MS), wire + MS);
}

#[test]
fn a_frame_that_is_lost_is_not_waited_for_in_vain() {
    let _ = run(ios(1), async |bus| {
        let socket = bus.socket();
        bus.fault("drop 1");
        socket.send(&who_is_there());
        assert_eq!(socket.receive_for(MS).await, None);
        assert_eq!(bus.now(), MS);
        socket.send(&who_is_there());
        assert!(socket.receive_for(MS).await.is_some());
    });
}

#[test]
fn a_ring_has_a_socket_at_each_end() {
    let text = "cycle = \"1ms\"\nring = true\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = 3\n";
    let _ = run(Segment::parse(text).expect("a ring"), async |bus| {
        let (first, second) = (bus.socket(), bus.secondary_socket());
        first.send(&who_is_there());
        assert!(second.receive_for(MS).await.is_some(), "it came out at the other end");
        assert_eq!(first.try_receive(), None);
        bus.fault("pull 1");
        bus.sleep(MS).await;
        first.send(&who_is_there());
        let answer = first.receive_for(MS).await.expect("it turned at the open cable");
        assert_eq!(answer[28..30], [1, 0]);
        assert_eq!(second.try_receive(), None);
    });
}

#[test]
fn seeds_run_in_order() {
    let ran = std::sync::Mutex::new(Vec::new());
    seeds([3, 1, 2], |seed| ran.lock().expect("not poisoned").push(seed));
    assert_eq!(ran.into_inner().expect("not poisoned"), [3, 1, 2]);
}
