//! embassy-time's clock and timers in a run.
#![cfg(feature = "embassy-time")]

use std::cell::RefCell;
use std::rc::Rc;
use std::task::Poll;
use std::time::Duration;

use embassy_time_driver::{TICK_HZ, schedule_wake};
use isocat_testing::{Bus, Segment, now, run};

const MS: Duration = Duration::from_millis(1);

/// A timer like that of embassy-time, which asks again each time it is polled.
async fn timer(at: u64) {
    std::future::poll_fn(|context| match embassy_time_driver::now() >= at {
        true => Poll::Ready(()),
        false => {
            schedule_wake(at, context.waker());
            Poll::Pending
        }
    })
    .await;
}

fn ticks(time: Duration) -> u64 {
    (time.as_nanos() * u128::from(TICK_HZ) / 1_000_000_000) as u64
}

#[test]
fn timers_come_at_their_tick_in_order() {
    let order = Rc::new(RefCell::new(Vec::new()));
    drop(run(Segment::built_in(), async |bus| {
        assert_eq!(embassy_time_driver::now(), 0);
        for millis in [3, 1, 2, 1] {
            let order = Rc::clone(&order);
            let _runs_on = bus.spawn(async move {
                timer(ticks(millis * MS)).await;
                order.borrow_mut().push((millis, now()));
            });
        }
        timer(ticks(10 * MS)).await;
        assert_eq!(now(), 10 * MS);
    }));
    assert_eq!(*order.borrow(), [(1, MS), (1, MS), (2, 2 * MS), (3, 3 * MS)]);
}

#[test]
fn a_timer_that_was_dropped_costs_no_time() {
    let verdict = run(Segment::built_in(), async |bus| {
        let mut long = Box::pin(timer(ticks(1_000 * MS)));
        let mut short = Box::pin(timer(ticks(MS)));
        std::future::poll_fn(|context| {
            assert!(long.as_mut().poll(context).is_pending());
            short.as_mut().poll(context)
        })
        .await;
        drop(long);
        bus.sleep(MS).await;
    });
    assert_eq!(verdict.lasted(), 2 * MS);
}

/// The lateness of timers that are due each millisecond, ns.
fn lateness(seed: u64, worst: Duration, more: impl Fn(&Bus)) -> Vec<u128> {
    let mut late = Vec::new();
    let segment = Segment::built_in().seed(seed).lateness(worst);
    drop(run(segment, async |bus| {
        more(&bus);
        for number in 1..=200 {
            timer(ticks(number * MS)).await;
            late.push((now() - number * MS).as_nanos());
        }
    }));
    late
}

#[test]
fn an_applications_timers_are_late_by_the_seed_whatever_else_waits() {
    let worst = Duration::from_micros(100);
    let alone = lateness(7, worst, |_| ());
    assert!(alone.iter().all(|late| *late <= worst.as_nanos()));
    assert!(alone.iter().any(|late| *late >= worst.as_nanos() / 2));
    assert_ne!(alone, lateness(8, worst, |_| ()));
    assert!(lateness(7, Duration::ZERO, |_| ()).iter().all(|late| *late == 0));
    // The test's own timers are exact, and do not affect the application.
    let beside = lateness(7, worst, |bus| {
        let sleeper = bus.clone();
        let _runs_on = bus.spawn(async move {
            loop {
                let before = sleeper.now();
                sleeper.sleep(Duration::from_micros(137)).await;
                assert_eq!(sleeper.now() - before, Duration::from_micros(137));
            }
        });
    });
    assert_eq!(alone, beside);
}

#[test]
fn a_host_that_stands_still_sees_no_timer() {
    let late = lateness(1, Duration::ZERO, |bus| bus.fault_after(9 * MS + MS / 2, "stall 5ms"));
    assert_eq!(late[8..15], [0, 4_500_000, 3_500_000, 2_500_000, 1_500_000, 500_000, 0]);
}
