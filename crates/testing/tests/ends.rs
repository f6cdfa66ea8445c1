//! Tests runs that can't end, and tests that ask for impossible things: each ends with a message,
//! and none hangs.
//!
//! `ISOCAT_SEED` is what a failed run of many seeds names; a test here sets it for itself.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::task::Poll;
use std::time::Duration;

use isocat_testing::{Bus, Kind, Segment, now, run, seeds, try_run};

const MS: Duration = Duration::from_millis(1);

/// The message of a panic.
fn complaint(test: impl FnOnce()) -> String {
    let panic = catch_unwind(AssertUnwindSafe(test)).expect_err("it panics");
    match panic.downcast::<String>() {
        Ok(text) => *text,
        Err(panic) => panic.downcast_ref::<&str>().expect("a message").to_string(),
    }
}

fn failure(test: impl AsyncFnOnce(Bus)) -> (Kind, String) {
    let failure = try_run(Segment::built_in().limit(10_000 * MS), test).expect_err("it fails");
    (failure.kind, failure.to_string())
}

#[test]
fn all_wait_and_nothing_comes() {
    let (kind, text) = failure(async |bus| {
        let _waits = bus.spawn(std::future::pending::<()>());
        bus.sleep(MS).await;
        bus.socket().receive().await;
    });
    assert_eq!(kind, Kind::Deadlock { tasks: 1 });
    assert!(
        text.starts_with("deadlock at 1ms of virtual time: the test and its tasks (1) wait"),
        "{text}"
    );
    assert!(text.contains("devices: AKD2G axis 1 in INIT, "), "{text}");
}

#[test]
fn time_is_over() {
    let (kind, text) = failure(async |bus| {
        loop {
            bus.sleep(MS).await;
        }
    });
    assert_eq!(kind, Kind::OutOfTime { limit: 10_000 * MS });
    assert!(text.starts_with("the test is not over after 10s of virtual time"), "{text}");
    // A year is no special case: time jumps there, but not beyond the limit.
    let (kind, _) = failure(async |bus| bus.sleep(Duration::from_secs(365 * 86_400)).await);
    assert_eq!(kind, Kind::OutOfTime { limit: 10_000 * MS });
    let (kind, _) = failure(async |bus| bus.sleep(Duration::MAX).await);
    assert_eq!(kind, Kind::OutOfTime { limit: 10_000 * MS });
}

#[test]
fn a_test_may_take_all_of_its_time_and_not_a_nanosecond_more() {
    let of =
        |time: Duration| try_run(Segment::built_in().limit(MS), async |bus| bus.sleep(time).await);
    assert_eq!(of(MS).expect("it ends in time").lasted(), MS);
    assert!(of(MS + Duration::from_nanos(1)).is_err());
}

/// A future that always wakes itself and never waits.
fn spin() -> impl Future<Output = ()> {
    std::future::poll_fn(|context| {
        context.waker().wake_by_ref();
        Poll::Pending
    })
}

#[test]
fn a_task_that_never_waits_ends_the_run() {
    let (kind, text) = failure(async |bus| {
        let _spins = bus.spawn(spin());
        bus.sleep(MS).await;
        std::future::pending::<()>().await;
    });
    assert_eq!(kind, Kind::Spins);
    assert!(text.starts_with("endless loop at "), "{text}");
}

#[test]
fn a_task_that_asks_for_the_time_until_it_has_come_sees_it_come() {
    let _ = run(Segment::built_in(), async |_| {
        let end = now() + 10 * MS;
        let mut turns = 0;
        while now() < end {
            turns += 1;
            let mut polled = false;
            std::future::poll_fn(|context| match std::mem::replace(&mut polled, true) {
                true => Poll::Ready(()),
                false => {
                    context.waker().wake_by_ref();
                    Poll::Pending
                }
            })
            .await;
        }
        assert!((10_000..10_200).contains(&turns), "a turn costs 1 us from the 100th on: {turns}");
    });
}

#[test]
fn what_does_not_exist_is_told_with_what_does() {
    let on = |test: fn(&Bus)| complaint(|| drop(run(Segment::built_in(), async |bus| test(&bus))));
    let text = on(|bus| drop(bus.device("AKD2G axis 7")));
    assert!(
        text.starts_with("no device \"AKD2G axis 7\"; did you mean \"AKD2G axis 1\"?"),
        "{text}"
    );
    assert_eq!(on(|bus| drop(bus.device(5))), "no device 5; expected 0 to 4");
    let text = on(|bus| bus.fault("pul 1"));
    assert!(text.starts_with("fault \"pul 1\": unknown fault \"pul\""), "{text}");
    let text = on(|bus| bus.fault("pull ring"));
    assert!(text.contains("this segment is none"), "{text}");
    let text = on(|bus| bus.fault_after(MS, "slow-send 1ms"));
    assert!(text.contains("is not simulated here"), "{text}");
    let text = on(|bus| drop(bus.secondary_socket()));
    assert!(text.contains("the segment is no ring"), "{text}");
    let text = on(|bus| bus.socket().send(&[0; 13]));
    assert!(text.contains("a frame of 13 bytes; expected 14 to 1514"), "{text}");
    let unknown = || drop(Segment::built_in().application("axis", ()));
    assert!(complaint(unknown).starts_with("no device \"axis\""));
    let error = Segment::parse("cycle = 1").err().expect("it is wrong").to_string();
    assert!(error.starts_with("the test's segment:1"), "{error}");
    assert!(Segment::file("nowhere.toml").is_err());
}

#[test]
fn what_does_not_come_in_time_is_told_with_the_place_and_the_states() {
    let text = complaint(|| {
        drop(run(Segment::built_in(), async |bus| {
            bus.within(5 * MS, |bus| bus.all_op()).await;
        }));
    });
    assert!(text.starts_with(file!()), "{text}");
    assert!(text.contains("did not come within 5ms; devices: AKD2G axis 1 in INIT"), "{text}");
}

#[test]
fn virtual_time_is_there_while_a_run_is_and_on_its_thread_alone() {
    assert!(
        complaint(|| {
            let _ = now();
        })
        .contains("outside of a run")
    );
    drop(run(Segment::built_in(), async |_| {
        let elsewhere = std::thread::spawn(|| {
            complaint(|| {
                let _ = now();
            })
        });
        assert!(elsewhere.join().expect("a text").contains("outside of a run"));
        let inner = complaint(|| drop(run(Segment::built_in(), async |_| ())));
        assert!(inner.starts_with("a run inside of a run"), "{inner}");
        assert_eq!(now(), Duration::ZERO, "the run goes on");
    }));
    // A run is possible after a test that panics, too.
    assert_eq!(complaint(|| drop(run(Segment::built_in(), async |_| panic!("oh")))), "oh");
    assert!(
        complaint(|| {
            let _ = now();
        })
        .contains("outside of a run")
    );
}

#[test]
fn a_tasks_panic_is_the_tests() {
    let text = complaint(|| {
        drop(run(Segment::built_in(), async |bus| {
            let _panics = bus.spawn(async { panic!("the application gave up") });
            bus.sleep(MS).await;
        }));
    });
    assert_eq!(text, "the application gave up");
}

#[test]
fn a_task_is_awaited_cancelled_and_dropped_with_the_run() {
    struct Notes(std::rc::Rc<std::cell::RefCell<Vec<&'static str>>>, &'static str);
    impl Drop for Notes {
        fn drop(&mut self) {
            self.0.borrow_mut().push(self.1);
        }
    }
    let dropped = std::rc::Rc::new(std::cell::RefCell::new(Vec::new()));
    let note = |name| Notes(dropped.clone(), name);
    drop(run(Segment::built_in(), async |bus| {
        let (cancelled, left) = (note("cancelled"), note("left over"));
        let task = bus.spawn(async move {
            let _held = cancelled;
            std::future::pending::<()>().await;
        });
        let sleep = bus.sleep(MS);
        let answer = bus.spawn(async move {
            sleep.await;
            42
        });
        let _left = bus.spawn(async move {
            let _held = left;
            std::future::pending::<()>().await;
        });
        assert!(!answer.is_finished());
        assert_eq!(answer.await, 42);
        task.cancel();
        assert_eq!(*dropped.borrow(), ["cancelled"]);
    }));
    assert_eq!(*dropped.borrow(), ["cancelled", "left over"]);
}

#[test]
fn the_seed_that_fails_is_named() {
    let text = complaint(|| seeds(10..20, |seed| assert!(seed < 13, "{seed} is too much")));
    assert!(text.starts_with("seed 13 failed, after 3 that did not."), "{text}");
    let name = std::thread::current().name().expect("a test has a name").to_owned();
    assert!(text.contains(&format!("ISOCAT_SEED=13 cargo test {name}\n13 is too much")), "{text}");
    assert!(complaint(|| seeds([], |_| ())).starts_with("no seed"));
}

/// Runs this test again with a seed in the environment.
#[test]
fn the_seed_of_the_environment_runs_alone() {
    if std::env::var_os("ISOCAT_SEED").is_some() {
        return seeds(10..20, |seed| println!("ran with {seed};"));
    }
    let with = |seed: &str| {
        let mut program = std::process::Command::new(std::env::current_exe().expect("a path"));
        let name = "the_seed_of_the_environment_runs_alone";
        program.args(["--exact", name, "--nocapture"]).env("ISOCAT_SEED", seed);
        let output = program.output().expect("it runs");
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        (text(&output.stdout), text(&output.stderr))
    };
    let ran = with("13").0;
    assert!(ran.contains("ran with 13;") && ran.matches("ran with").count() == 1, "{ran}");
    let error = with("20").1;
    assert!(error.contains("ISOCAT_SEED is 20; expected one of the seeds of this test"), "{error}");
    let error = with("x").1;
    assert!(error.contains("ISOCAT_SEED is \"x\"; expected a seed"), "{error}");
}
