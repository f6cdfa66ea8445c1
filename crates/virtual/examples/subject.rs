//! Programs that run under supervision in `tests/supervised.rs`: `subject NAME`. Each program
//! checks from inside whether time, threads, pipes and frames behave as on a real machine, and
//! fails if they do not.

#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::io::{Read, Write};
use std::sync::{Arc, Condvar, Mutex, mpsc};
use std::time::{Duration, Instant, SystemTime};

use isocat_host::RawSocket;

fn main() {
    let name = std::env::args().nth(1).unwrap_or_default();
    match name.as_str() {
        "sleeps_an_hour" => sleeps_an_hour(),
        "threads" => threads(),
        "spins_by_the_clock" => spins_by_the_clock(),
        "exchanges_frames" => exchanges_frames(),
        "has_a_child" => has_a_child(),
        "has_children_with_threads" => has_children_with_threads(),
        "ends_beside_its_threads" => ends_beside_its_threads(),
        "pipes" => pipes(),
        "deadlocks" => deadlocks(),
        "never_calls" => never_calls(),
        "asks_for_eth0" => drop(RawSocket::open("eth0", None).expect_err("there is none")),
        "five_hundred_threads" => five_hundred_threads(),
        "two_sockets" => two_sockets(),
        other => panic!("there is no subject {other:?}"),
    }
}

fn sleeps_an_hour() {
    let (began, began_by_calendar) = (Instant::now(), SystemTime::now());
    std::thread::sleep(Duration::from_secs(3_600));
    let slept = began.elapsed();
    assert!(slept >= Duration::from_secs(3_600) && slept < Duration::from_millis(3_600_001));
    let by_calendar = began_by_calendar.elapsed().expect("clocks go forward");
    assert!(by_calendar.abs_diff(slept) < Duration::from_millis(1));
}

fn threads() {
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
    // A wait with a timeout that no other thread ends early.
    let (lock, changed) = (Mutex::new(()), Condvar::new());
    let guard = lock.lock().expect("not poisoned");
    let (_guard, waited) =
        changed.wait_timeout(guard, Duration::from_secs(5)).expect("not poisoned");
    assert!(waited.timed_out());
    let all = began.elapsed();
    assert!(all >= Duration::from_millis(5_040) && all < Duration::from_millis(5_045), "{all:?}");
}

fn spins_by_the_clock() {
    let began = Instant::now();
    while began.elapsed() < Duration::from_millis(1) {}
}

fn exchanges_frames() {
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
            took >= Duration::from_nanos(7_000) && took < Duration::from_micros(200),
            "{took:?}"
        );
        std::thread::sleep(Duration::from_millis(1) - took);
    }
}

fn has_a_child() {
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

/// A shell starts processes with threads one after the other. Each process ends while its threads
/// sleep.
fn has_children_with_threads() {
    let this = std::env::current_exe().expect("a program has a path");
    let script = "for i in 1 2 3 4 5 6 7 8 9 10; do \"$0\" ends_beside_its_threads | cat; done";
    let mut shell = std::process::Command::new("/bin/sh");
    assert!(shell.args(["-c", script]).arg(this).status().expect("a shell").success());
}

fn ends_beside_its_threads() {
    for _ in 0..20 {
        std::thread::spawn(|| std::thread::sleep(Duration::from_secs(3_600)));
    }
    std::thread::sleep(Duration::from_millis(1));
    println!("ends");
    std::process::exit(0);
}

fn pipes() {
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

fn deadlocks() {
    let lock = Arc::new(Mutex::new(()));
    let _held = lock.lock().expect("not poisoned");
    let other = Arc::clone(&lock);
    std::thread::spawn(move || drop(other.lock())).join().expect("never");
}

#[inline(never)]
fn never_calls() {
    // Nothing else, so that it is found in this function, however it is compiled.
    #[expect(clippy::empty_loop, reason = "a program that makes no call")]
    loop {}
}

fn five_hundred_threads() {
    let began = Instant::now();
    let sleep = || std::thread::sleep(Duration::from_secs(1));
    let threads: Vec<_> = (0..500).map(|_| std::thread::spawn(sleep)).collect();
    threads.into_iter().for_each(|thread| thread.join().expect("it ends"));
    assert!(began.elapsed() < Duration::from_millis(1_100), "they sleep at the same time");
}

/// Both sockets receive the answer to a frame that one of them sent, as on a real interface.
fn two_sockets() {
    let mut one = RawSocket::open("vt0", None).expect("a packet socket");
    let mut other = RawSocket::open("vt0", None).expect("another one");
    one.send(&frame(7)).expect("it is sent");
    for socket in [&mut one, &mut other] {
        let mut buffer = [0; 1514];
        let received = loop {
            if let Some(received) = socket.receive(&mut buffer).expect("the link is up") {
                break received;
            }
        };
        assert_eq!((received.len, buffer[20]), (60, 8));
    }
}

fn frame(number: u8) -> [u8; 60] {
    let mut frame = [0; 60];
    frame[..6].fill(0xFF);
    (frame[12], frame[13], frame[20]) = (0x88, 0xA4, number);
    frame
}
