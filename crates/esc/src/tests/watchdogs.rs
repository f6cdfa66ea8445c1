//! What changes of divider and time do to the watchdogs.

use super::*;
use crate::ET1100;
use isocat_wire::dl::DlStatus;

/// SM0, one byte, triggers the process data watchdog.
fn bench() -> Bench {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0800, &[0x00, 0x10, 1, 0, 0x44, 0, 1, 0]);
    bench
}

fn is_fine(bench: &mut Bench) -> bool {
    bench.read(register::WATCHDOG_STATUS) & 1 != 0
}

/// The instant at which it expires, if within a second.
fn expiry(bench: &mut Bench) -> Option<u64> {
    bench.take_events();
    bench.run_to(bench.now + 1_000_000_000);
    let mut found = bench.take_events();
    found.retain(|(_, event)| *event == EscEvent::WatchdogExpired);
    assert!(found.len() <= 1);
    found.pop().map(|(at, _)| at)
}

#[test]
fn a_shorter_time_counts_from_the_last_restart() {
    let mut bench = bench();
    bench.fpwr(0x1000, &[1]);
    let restarted = bench.now;
    bench.run_to(restarted + 10_000_000);
    bench.write(register::WATCHDOG_TIME_PROCESS_DATA, 200);
    assert_eq!(expiry(&mut bench), Some(restarted + 20_000_000));
    // The divider: (48 + 2) * 40 ns * 200.
    bench.write(register::WATCHDOG_DIVIDER, 48);
    bench.fpwr(0x1000, &[1]);
    let restarted = bench.now;
    assert_eq!(expiry(&mut bench), Some(restarted + 400_000));
}

#[test]
fn a_time_that_is_over_expires_at_once() {
    for (late, expected) in [(0, 0), (1, 1), (-1, 0)] {
        let mut bench = bench();
        bench.fpwr(0x1000, &[1]);
        let due = bench.now + 20_000_000;
        // The new time comes into force at the end of its frame.
        bench.run_to((due as i64 + 10 * late) as u64 - duration_ns(60));
        bench.take_events();
        bench.write(register::WATCHDOG_TIME_PROCESS_DATA, 200);
        let at = bench.now;
        bench.run_to(due.max(at));
        let mut events = bench.take_events();
        events.retain(|(_, event)| *event == EscEvent::WatchdogExpired);
        assert_eq!(events, [(due + 10 * expected, EscEvent::WatchdogExpired)], "{late}");
    }
}

#[test]
fn zero_switches_off_and_forgets_an_expiry() {
    let mut bench = bench();
    assert!(!is_fine(&mut bench), "nothing was ever written");
    bench.fpwr(0x1000, &[1]);
    assert!(is_fine(&mut bench));
    assert!(expiry(&mut bench).is_some());
    assert!(!is_fine(&mut bench));
    bench.write(register::WATCHDOG_TIME_PROCESS_DATA, 1);
    assert!(!is_fine(&mut bench), "another time restarts nothing");
    bench.write(register::WATCHDOG_TIME_PROCESS_DATA, 0);
    assert!(is_fine(&mut bench));
    assert_eq!(expiry(&mut bench), None);
    // Restarts while it is off are forgotten: switched on again, it runs from that instant.
    bench.fpwr(0x1000, &[1]);
    bench.run_to(bench.now + 500_000_000);
    bench.write(register::WATCHDOG_TIME_PROCESS_DATA, 1000);
    let on = bench.now;
    assert!(is_fine(&mut bench));
    assert_eq!(expiry(&mut bench), Some(on + 100_000_000));
    assert_eq!(bench.read(register::WATCHDOG_COUNTER_PROCESS_DATA), 2);
}

#[test]
fn a_buffer_without_the_trigger_restarts_nothing() {
    let mut bench = Bench::new(&ET1100);
    bench.fpwr(0x0800, &[0x00, 0x10, 1, 0, 0x04, 0, 1, 0]);
    bench.fpwr(0x1000, &[1]);
    assert!(!is_fine(&mut bench));
    assert_eq!(expiry(&mut bench), None);
}

/// Both counters clear by a write to either.
#[test]
fn counters() {
    for address in [0x0442, 0x0443] {
        let mut bench = bench();
        bench.pdi().events();
        bench.fpwr(0x1000, &[1]);
        bench.run_to(bench.now + 200_000_000);
        assert_eq!(bench.fprd(0x0442, 2).0, [1, 1]);
        assert_eq!(bench.bwr(address, &[7]), 1);
        assert_eq!(bench.fprd(0x0442, 2).0, [0, 0]);
    }
}

/// DL status bit 1.
#[test]
fn the_pdi_watchdog_is_fine_when_off() {
    let mut bench = Bench::new(&ET1100);
    let fine = |bench: &Bench| bench.esc.dl_status().0 & DlStatus::PDI_WATCHDOG != 0;
    assert!(!fine(&bench), "the PDI has not come yet");
    bench.pdi().events();
    bench.run_to(bench.now + 100_000_000);
    assert!(!fine(&bench));
    bench.write(register::WATCHDOG_TIME_PDI, 0);
    assert!(fine(&bench));
    bench.write(register::WATCHDOG_TIME_PDI, 10);
    assert!(fine(&bench));
    let on = bench.now;
    bench.run_to(on + 999_999);
    assert!(fine(&bench));
    bench.run_to(on + 1_000_000);
    assert!(!fine(&bench));
    assert_eq!(bench.esc.register(register::WATCHDOG_COUNTER_PDI), 2);
}
