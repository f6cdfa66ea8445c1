//! Programs under supervision: those of `examples/subject.rs`.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::ffi::OsString;
use std::path::Path;
use std::sync::Arc;

use isocat_virtual::kernel::{Costs, Luck, MachineFault};
use isocat_virtual::supervisor::{self, Ended, Ending, How, Options, Program};
use isocat_virtual::{Wire, WireAnswer};
use isocat_wire::time::{Host, Nanos, Time};

/// Each frame comes back after this time, with byte 20 incremented.
const ROUND_TRIP: Nanos = Nanos(7_000);

#[derive(Default)]
struct Echo {
    sent: Vec<u64>,
}

impl Wire for Echo {
    fn send(
        &mut self,
        interface: usize,
        at: Time<Host>,
        frame: &[u8],
        answers: &mut Vec<WireAnswer>,
    ) {
        self.sent.push(at.count());
        let mut bytes = frame.to_vec();
        bytes[20] = bytes[20].wrapping_add(1);
        answers.push(WireAnswer { at: at + ROUND_TRIP, interface, bytes });
    }

    fn advance(&mut self, _: Time<Host>) {}

    fn next_timeout(&self, _: Time<Host>) -> Option<Time<Host>> {
        None
    }

    fn take_machine_faults(&mut self) -> Vec<MachineFault> {
        Vec::new()
    }
}

fn options() -> Options {
    Options {
        interfaces: vec!["vt0".into()],
        costs: Costs::default(),
        luck: Luck::default(),
        limit: None,
        stop: Arc::default(),
    }
}

/// Runs a subject of `examples/subject.rs`, which is built with the tests. Returns its result and
/// the instants at which its frames were sent. `None`: this machine does not allow supervision, and
/// the test reports that.
fn run(subject: &str, options: &Options) -> Option<(Ended, Vec<u64>)> {
    let test = std::env::current_exe().expect("a test has a binary");
    let path = test.parent().and_then(Path::parent).expect("folders").join("examples/subject");
    let arguments = [OsString::from(subject)];
    let program = Program::find(path.as_os_str(), &arguments).expect("this binary runs here");
    let mut wire = Echo::default();
    match supervisor::run(&program, options, &mut wire) {
        Ok(ended) => Some((ended, wire.sent)),
        Err(error) => {
            println!("skipped: {error}");
            None
        }
    }
}

fn ends_well(subject: &str) -> Option<(Ended, Vec<u64>)> {
    let (ended, sent) = run(subject, &options())?;
    assert_eq!(ended.how, How::Itself(Ending::Exited(0)), "{subject}: {:?}", ended.notes);
    Some((ended, sent))
}

#[test]
fn sleeps_take_virtual_time_alone() {
    // A supervisor that really slept would take the hour.
    let Some((ended, _)) = ends_well("sleeps_an_hour") else { return };
    assert!(ended.lasted >= Nanos::millis(3_600_000), "{}", ended.lasted);
    assert!(ended.lasted < Nanos::millis(3_601_000), "{}", ended.lasted);
}

#[test]
fn threads_meet_in_virtual_time_and_the_same_way_each_time() {
    let Some((first, _)) = ends_well("threads") else { return };
    let Some((second, _)) = ends_well("threads") else { return };
    assert_eq!((first.lasted, first.figures), (second.lasted, second.figures));
    assert!(first.figures.threads >= 5);
}

/// The watchdog of a machine that stands still for a while cuts the supervisor's own calls short.
/// What it asked for has to be asked again, or a program's clock stops at each reading in one run
/// and counts by itself in the next.
#[test]
fn signals_to_the_supervisor_change_no_run() {
    let subject = "spins_by_the_clock";
    let Some((undisturbed, _)) = ends_well(subject) else { return };
    // SAFETY: the thread is this one, which outlives the other.
    let this = unsafe { libc::pthread_self() };
    let over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(std::sync::atomic::Ordering::SeqCst) {
                // SAFETY: as above.
                unsafe { libc::pthread_kill(this, libc::SIGURG) };
            }
        });
        let runs: Vec<_> = (0..10).map(|_| run(subject, &options())).collect();
        over.store(true, std::sync::atomic::Ordering::SeqCst);
        for (ended, _) in runs.into_iter().flatten() {
            assert_eq!((ended.lasted, ended.figures), (undisturbed.lasted, undisturbed.figures));
        }
    });
}

#[test]
fn a_loop_that_asks_for_the_time_ends() {
    let Some((ended, _)) = ends_well("spins_by_the_clock") else { return };
    // A reading costs 200 ns, and stops no thread where the clock can count by itself.
    let asked = ended.figures.readings + ended.figures.stops;
    assert!((4_900..7_000).contains(&asked), "{:?}", ended.figures);
}

#[test]
fn frames_go_to_the_wire_and_come_back_in_time() {
    let Some((ended, sent)) = ends_well("exchanges_frames") else { return };
    assert_eq!((ended.figures.sent, ended.figures.received), (100, 100));
    let distances: Vec<u64> = sent.windows(2).map(|two| two[1] - two[0]).collect();
    let even = distances.iter().all(|distance| distance.abs_diff(1_000_000) < 20_000);
    assert!(even, "a frame each millisecond: {distances:?}");
}

#[test]
fn children_run_in_the_same_time() {
    let Some((ended, _)) = ends_well("has_a_child") else { return };
    // The processes are this one, the shell, and `sleep`.
    assert_eq!(ended.figures.processes, 3);
    assert!(ended.lasted >= Nanos::millis(2_000) && ended.lasted < Nanos::millis(2_100));
}

#[test]
fn a_parent_learns_at_the_same_instant_each_time_that_a_child_with_threads_has_ended() {
    let mut runs = (0..4).map_while(|_| ends_well("has_children_with_threads"));
    let Some((first, _)) = runs.next() else { return };
    for (other, _) in runs {
        assert_eq!((other.lasted, other.figures), (first.lasted, first.figures));
    }
}

#[test]
fn pipes_join_threads() {
    ends_well("pipes");
}

#[test]
fn threads_that_wait_for_ever_are_named() {
    let Some((ended, _)) = run("deadlocks", &options()) else { return };
    let How::Deadlock(who) = ended.how else { panic!("{:?}", ended.how) };
    assert!(who.len() >= 2 && who.iter().all(|who| who.contains("futex")), "{who:?}");
}

#[test]
fn a_wait_for_a_signal_that_none_can_send_is_a_deadlock() {
    let program = Program::find("sleep".as_ref(), &["infinity".into()]).expect("a program");
    // Some versions sleep for a very long time instead.
    let options = Options { limit: Some(Nanos::millis(3_600_000)), ..options() };
    match supervisor::run(&program, &options, &mut Echo::default()) {
        Ok(Ended { how: How::Limit, lasted, .. }) => assert_eq!(lasted, Nanos::millis(3_600_000)),
        Ok(Ended { how: How::Deadlock(who), .. }) => {
            assert!(who[0].contains("in pause"), "{who:?}")
        }
        Ok(ended) => panic!("{:?}", ended.how),
        Err(error) => println!("skipped: {error}"),
    }
}

#[test]
fn an_interface_of_another_name_is_told() {
    let Some((ended, _)) = ends_well("asks_for_eth0") else { return };
    let told = |note: &String| note.contains("interface eth0") && note.ends_with("is vt0");
    assert!(ended.notes.keys().any(told), "{:?}", ended.notes);
}

#[test]
fn a_deadlock_is_told_as_one_though_time_is_limited() {
    let options = Options { limit: Some(Nanos::millis(1_500)), ..options() };
    let Some((ended, _)) = run("deadlocks", &options) else { return };
    assert!(matches!(ended.how, How::Deadlock(_)), "{:?}", ended.how);
}

#[test]
fn a_program_without_calls_is_ended_and_told_where_it_is() {
    let Some((ended, _)) = run("never_calls", &options()) else { return };
    let How::Spins(who) = ended.how else { panic!("{:?}", ended.how) };
    assert!(who.len() == 1 && who[0].contains("never_calls"), "{who:?}");
}

#[test]
fn five_hundred_threads_sleep_at_the_same_time() {
    let Some((ended, _)) = ends_well("five_hundred_threads") else { return };
    assert_eq!(ended.figures.threads, 501);
}

#[test]
fn two_sockets_hear_the_same_answer() {
    let Some((ended, sent)) = ends_well("two_sockets") else { return };
    assert_eq!((sent.len(), ended.figures.received), (1, 1));
}

#[test]
fn a_program_that_ignores_signals_is_ended_all_the_same() {
    let script = "trap '' TERM INT HUP; while :; do sleep 60; done";
    let arguments = ["-c".into(), script.into()];
    let program = Program::find("sh".as_ref(), &arguments).expect("a shell");
    let options = Options { limit: Some(Nanos::millis(600_000)), ..options() };
    match supervisor::run(&program, &options, &mut Echo::default()) {
        Ok(ended) => assert_eq!((ended.how, ended.figures.processes), (How::Limit, 11)),
        Err(error) => println!("skipped: {error}"),
    }
    // The program is asked to stop before it starts.
    options.stop.store(true, std::sync::atomic::Ordering::SeqCst);
    match supervisor::run(&program, &options, &mut Echo::default()) {
        Ok(ended) => assert_eq!(ended.how, How::Stopped),
        Err(error) => println!("skipped: {error}"),
    }
}

#[test]
fn its_time_can_be_limited() {
    let options = Options { limit: Some(Nanos::millis(1_500)), ..options() };
    let Some((ended, _)) = run("sleeps_an_hour", &options) else { return };
    assert_eq!((ended.how, ended.lasted), (How::Limit, Nanos::millis(1_500)));
}

#[test]
fn late_wake_ups_repeat_by_their_seed() {
    let with_seed = |seed| {
        let luck = Luck { lateness: Nanos(50_000), seed, ..Luck::default() };
        run("exchanges_frames", &Options { luck, ..options() })
    };
    let (Some(one), Some(same), Some(other)) = (with_seed(1), with_seed(1), with_seed(2)) else {
        return;
    };
    assert_eq!(one.1, same.1);
    assert_ne!(one.1, other.1);
}

#[test]
fn what_is_no_program_is_refused() {
    let refuse = |name: &str| Program::find(name.as_ref(), &[]).expect_err(name).to_string();
    assert!(refuse("no-such-program-anywhere").contains("PATH"));
    assert!(refuse("/no/such/file").contains("no such file"));
    assert!(refuse("/usr").contains("a folder"));
    assert!(refuse("/etc/passwd").contains("may not be executed"));
}
