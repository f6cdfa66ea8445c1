//! Programs under supervision: this test's own binary, run once more for one of its `subject_…` tests, as any program is.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::ffi::OsString;
use std::io::{Read, Write};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, mpsc};
use std::time::{Duration, Instant, SystemTime};

use isocat_host::RawSocket;
use isocat_virtual::kernel::{Costs, Luck, MachineFault};
use isocat_virtual::supervisor::{self, Ended, Ending, How, Options, Program};
use isocat_virtual::{Wire, WireAnswer};
use isocat_wire::time::{Host, Nanos, Time};

/// Each frame is back after this long, with one more in byte 20.
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

/// Runs a subject of this file; gives its end and when its frames set out. `None`: this machine does not let programs be
/// supervised, and says so.
fn run(subject: &str, options: &Options) -> Option<(Ended, Vec<u64>)> {
    let path = std::env::current_exe().expect("a test has a binary");
    let arguments = ["--exact", subject, "--ignored", "--test-threads=1"].map(OsString::from);
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
    let began = Instant::now();
    let Some((ended, _)) = ends_well("subject_sleeps_an_hour") else { return };
    assert!(ended.lasted >= Nanos::millis(3_600_000), "{}", ended.lasted);
    assert!(ended.lasted < Nanos::millis(3_601_000), "{}", ended.lasted);
    assert!(began.elapsed() < Duration::from_secs(600), "an hour of virtual time");
}

#[test]
#[ignore = "a subject"]
fn subject_sleeps_an_hour() {
    let (began, began_by_calendar) = (Instant::now(), SystemTime::now());
    std::thread::sleep(Duration::from_secs(3_600));
    let slept = began.elapsed();
    assert!(slept >= Duration::from_secs(3_600) && slept < Duration::from_millis(3_600_001));
    let by_calendar = began_by_calendar.elapsed().expect("clocks go forward");
    assert!(by_calendar.abs_diff(slept) < Duration::from_millis(1));
}

#[test]
fn threads_meet_in_virtual_time_and_the_same_way_each_time() {
    let Some((first, _)) = ends_well("subject_threads") else { return };
    let Some((second, _)) = ends_well("subject_threads") else { return };
    assert_eq!((first.lasted, first.figures), (second.lasted, second.figures));
    assert!(first.figures.threads >= 5);
}

#[test]
#[ignore = "a subject"]
fn subject_threads() {
    let began = Instant::now();
    let (sender, receiver) = mpsc::channel();
    let threads: Vec<_> = (0..4u64)
        .map(|number| {
            let sender = sender.clone();
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(10 * (4 - number)));
                sender.send(number).expect("somebody listens");
            })
        })
        .collect();
    drop(sender);
    assert_eq!(receiver.iter().collect::<Vec<_>>(), [3, 2, 1, 0], "the shortest sleep first");
    threads.into_iter().for_each(|thread| thread.join().expect("it ends"));
    // A wait with an end that nobody shortens.
    let (lock, changed) = (Mutex::new(()), Condvar::new());
    let guard = lock.lock().expect("not poisoned");
    let (_guard, waited) =
        changed.wait_timeout(guard, Duration::from_secs(5)).expect("not poisoned");
    assert!(waited.timed_out());
    let all = began.elapsed();
    assert!(all >= Duration::from_millis(5_040) && all < Duration::from_millis(5_045), "{all:?}");
}

#[test]
fn a_loop_that_asks_for_the_time_ends() {
    let Some((ended, _)) = ends_well("subject_spins_by_the_clock") else { return };
    // A reading costs 200 ns, and stops nobody where the clock can count by itself.
    let asked = ended.figures.readings + ended.figures.stops;
    assert!((4_900..7_000).contains(&asked), "{:?}", ended.figures);
}

#[test]
#[ignore = "a subject"]
fn subject_spins_by_the_clock() {
    let began = Instant::now();
    while began.elapsed() < Duration::from_millis(1) {}
}

fn frame(number: u8) -> [u8; 60] {
    let mut frame = [0; 60];
    frame[..6].fill(0xFF);
    (frame[12], frame[13], frame[20]) = (0x88, 0xA4, number);
    frame
}

#[test]
fn frames_go_to_the_wire_and_come_back_in_time() {
    let Some((ended, sent)) = ends_well("subject_exchanges_frames") else { return };
    assert_eq!((ended.figures.sent, ended.figures.received), (100, 100));
    let distances: Vec<u64> = sent.windows(2).map(|two| two[1] - two[0]).collect();
    let even = distances.iter().all(|distance| distance.abs_diff(1_000_000) < 20_000);
    assert!(even, "a frame each millisecond: {distances:?}");
}

#[test]
#[ignore = "a subject"]
fn subject_exchanges_frames() {
    assert!(RawSocket::open("lo", None).is_err(), "no real interface is to be had");
    let mut socket = RawSocket::open("vt0", None).expect("a packet socket without any rights");
    for number in 0..100 {
        let began = Instant::now();
        socket.send(&frame(number)).expect("it is sent");
        let mut buffer = [0; 1514];
        let received = loop {
            if let Some(received) = socket.receive(&mut buffer).expect("the link is up") {
                break received;
            }
        };
        assert_eq!((received.len, buffer[20]), (60, number + 1));
        let took = began.elapsed();
        assert!(
            took >= Duration::from_nanos(7_000) && took < Duration::from_micros(30),
            "{took:?}"
        );
        std::thread::sleep(Duration::from_millis(1) - took);
    }
}

#[test]
fn children_run_in_the_same_time() {
    let Some((ended, _)) = ends_well("subject_has_a_child") else { return };
    // This one, the shell, and what sleeps.
    assert_eq!(ended.figures.processes, 3);
    assert!(ended.lasted >= Nanos::millis(2_000) && ended.lasted < Nanos::millis(2_100));
}

#[test]
#[ignore = "a subject"]
fn subject_has_a_child() {
    let began = Instant::now();
    let output = std::process::Command::new("/bin/sh")
        .args(["-c", "echo begun; sleep 2; echo over; exit 7"])
        .output()
        .expect("a shell");
    assert_eq!(output.stdout, b"begun\nover\n");
    assert_eq!(output.status.code(), Some(7));
    assert!(began.elapsed() >= Duration::from_secs(2));
    assert!(began.elapsed() < Duration::from_millis(2_100));
}

#[test]
fn pipes_join_threads() {
    ends_well("subject_pipes");
}

#[test]
#[ignore = "a subject"]
fn subject_pipes() {
    let (mut reader, mut writer) = std::io::pipe().expect("a pipe");
    let thread = std::thread::spawn(move || {
        for _ in 0..3 {
            std::thread::sleep(Duration::from_secs(1));
            writer.write_all(b"x").expect("somebody reads");
        }
    });
    let mut all = Vec::new();
    let began = Instant::now();
    reader.read_to_end(&mut all).expect("it ends with its writer");
    assert_eq!(all, b"xxx");
    assert!(began.elapsed() >= Duration::from_secs(3));
    thread.join().expect("it ends");
}

#[test]
fn threads_that_wait_for_ever_are_named() {
    let Some((ended, _)) = run("subject_deadlocks", &options()) else { return };
    let How::Deadlock(who) = ended.how else { panic!("{:?}", ended.how) };
    assert!(who.len() >= 2 && who.iter().all(|who| who.contains("futex")), "{who:?}");
}

#[test]
#[ignore = "a subject"]
fn subject_deadlocks() {
    let lock = Arc::new(Mutex::new(()));
    let _held = lock.lock().expect("not poisoned");
    let other = Arc::clone(&lock);
    std::thread::spawn(move || drop(other.lock())).join().expect("never");
}

#[test]
fn a_program_without_calls_is_ended() {
    let Some((ended, _)) = run("subject_never_calls", &options()) else { return };
    assert!(matches!(ended.how, How::Spins(_)), "{:?}", ended.how);
}

#[test]
#[ignore = "a subject"]
fn subject_never_calls() {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    loop {
        COUNT.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn its_time_can_be_limited() {
    let options = Options { limit: Some(Nanos::millis(1_500)), ..options() };
    let Some((ended, _)) = run("subject_sleeps_an_hour", &options) else { return };
    assert_eq!((ended.how, ended.lasted), (How::Limit, Nanos::millis(1_500)));
}

#[test]
fn late_wake_ups_repeat_by_their_seed() {
    let with_seed = |seed| {
        let luck = Luck { lateness: Nanos(50_000), seed, ..Luck::default() };
        run("subject_exchanges_frames", &Options { luck, ..options() })
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
