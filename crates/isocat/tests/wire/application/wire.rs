//! The same application on a real interface: one end of a veth pair, the line behind a raw socket
//! on the other.
//!
//! Needs root and the command `ip`; without them the test says so and passes. A machine that stalls
//! throws devices out of OP with good reason: such a run says so and is tried again.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use isocat::host::{Exchange, Waiting};
use isocat::host::{LinkError, RawSocket, RealTime, Veth, Wish, clock};
use isocat_maindevice::Event;
use isocat_sim::Segment;
use isocat_wire::frame::{self, duration_ns};
use isocat_wire::time::{Host, Nanos, Picos, Time, True};

use super::line::{self, IN_A_FRAME};
use super::witness::Witness;

const CYCLE: Nanos = Nanos::millis(10);
/// Once all are in OP, one of this number of returning frames is dropped.
const DROPPED: u64 = 23;

/// The line at the far end of a wire, in a thread; it ends when this is dropped.
struct Responder {
    stop: Arc<AtomicBool>,
    /// From now on one of this number of frames is dropped; 0 means none.
    drop_one_of: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Responder {
    fn begin(wire: &Veth, devices: usize) -> Self {
        let begin = clock::now();
        let end = wire.segment_end();
        let socket = RawSocket::open(&end, Some(wire.namespace())).expect("our own interface");
        let (stop, drop_one_of) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (stopped, one_of) = (stop.clone(), drop_one_of.clone());
        let thread = std::thread::spawn(move || {
            let _real_time = RealTime::ask(Wish::default());
            let segment = Segment::new(line::connections(devices), 1);
            respond(socket, segment, begin, &stopped, &one_of);
        });
        Self { stop, drop_one_of, thread: Some(thread) }
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(matches!(ended, Some(Ok(()))), "the segment panicked");
    }
}

/// True time runs with host time. Frames enter when the kernel had them, one behind the other.
fn respond(
    mut socket: RawSocket,
    mut segment: Segment,
    begin: Time<Host>,
    stop: &AtomicBool,
    drop_one_of: &AtomicU64,
) {
    let mut bytes = [0; 2048];
    let mut free: Time<True> = Time::ZERO;
    let mut cyclic = 0;
    while !stop.load(Ordering::Relaxed) {
        if !socket.wait(Some(clock::now() + Nanos::millis(50))).unwrap_or(false) {
            continue;
        }
        while let Ok(Some(received)) = socket.receive(&mut bytes) {
            let bytes = &mut bytes[..received.len];
            let start = (Time::ZERO + Picos::from(received.at - begin)).max(free);
            free = start + Picos::from(Nanos(duration_ns(bytes.len()) as i64 + 960));
            let good = segment
                .pass(bytes, start, &mut isocat_sim::Watcher::blind())
                .is_ok_and(|returned| returned.good);
            let one_of = drop_one_of.load(Ordering::Relaxed);
            let is_cyclic = frame::payload(bytes).is_ok_and(|payload| payload[1] >= 0x80);
            cyclic += u64::from(is_cyclic && one_of > 0);
            if good && !(is_cyclic && one_of > 0 && u64::is_multiple_of(cyclic, one_of)) {
                let _ = socket.send(bytes);
            }
        }
    }
}

/// Runs it; `None`, with a word, where it can't be had or the machine stalled.
fn attempt(name: &str, frames: usize, slow: usize) -> Option<Witness> {
    let wire = match Veth::create(name) {
        Ok(wire) => wire,
        Err(error @ (LinkError::Permission { .. } | LinkError::Ip { .. })) => {
            eprintln!("skipped, needs root and ip: {error}");
            return None;
        }
        Err(error) => panic!("{error}"),
    };
    let devices = frames * IN_A_FRAME - 1;
    let segment = Responder::begin(&wire, devices);
    let mut config = line::config(CYCLE, devices, slow, 4);
    config.timeouts.frame = Nanos::millis(40);
    config.stamp_noise = Nanos::micros(200);
    config.host_jitter = Nanos::micros(500);
    config.drift_threshold = Nanos::micros(100);
    let socket = RawSocket::open(&wire.main_end(), Some(wire.namespace())).expect("our own");
    let waiting = Waiting::Sleep { lead: Nanos::ZERO };
    let mut exchange = Exchange::new(config, socket, waiting, None, Witness::default());
    let limit = clock::now() + Nanos::millis(90_000);
    let mut end = limit;
    let mut losing = false;
    while clock::now() < end {
        assert!(exchange.step(end).expect("our own interface"), "nothing more to do");
        while let Some(event) = exchange.poll_event() {
            match event {
                Event::InOperation { .. } => end = clock::now() + Nanos::millis(6_000),
                Event::Failed(error) => {
                    eprintln!("{error}");
                    return None;
                }
                _ => {}
            }
        }
        // Half of it undisturbed.
        if end != limit && !losing && end - clock::now() < Nanos::millis(3_000) {
            losing = true;
            segment.drop_one_of.store(DROPPED, Ordering::Relaxed);
        }
    }
    assert!(end != limit, "the segment does not come up");
    Some(exchange.into_parts().0)
}

#[test]
fn the_same_application_runs_on_an_interface() {
    let _alone = crate::alone::alone();
    for (name, frames, slow) in [("ap-one", 1, 0), ("ap-three", 3, 0), ("ap-group", 2, 4)] {
        let mut tried = 0;
        let witness = loop {
            tried += 1;
            match attempt(name, frames, slow) {
                None if tried == 1 && !can_run() => return,
                None if tried < 4 => continue,
                None => {
                    eprintln!("skipped: this machine stalls");
                    return;
                }
                // Where half of the cycles were late, or a stall threw the devices out of OP,
                // nothing was seen.
                Some(witness) if !witness.saw_enough() && tried < 4 => continue,
                Some(witness) if !witness.saw_enough() => {
                    eprintln!("skipped: this machine stalls");
                    return;
                }
                Some(witness) => break witness,
            }
        };
        println!(
            "{frames} frames a cycle: {} calls, {} unpunctual, fresh {:?}, stale {:?}, apart {:?}",
            witness.calls, witness.unpunctual, witness.fresh, witness.stale, witness.apart
        );
        // What the machine's lateness can't do.
        let wrong = |what: &&String| NEVER.iter().any(|never| what.contains(never));
        let wrong: Vec<_> = witness.wrong.iter().filter(wrong).collect();
        assert!(wrong.is_empty(), "{wrong:#?}");
        assert!(witness.calls > 500, "{}", witness.calls);
        assert!(witness.stale.iter().all(|count| *count > 0), "frames were dropped");
        assert!(witness.requests.1 > 100, "{:?}", witness.requests);
    }
}

impl Witness {
    /// Whether the machine was punctual in half of the cycles at least, the first device was in OP
    /// for 300, all were when frames began to be dropped, and a frame was held up between two of
    /// one cycle seldom.
    fn saw_enough(&self) -> bool {
        let counts = self.fresh.first().zip(self.stale.first());
        let in_operation = counts.is_some_and(|(a, b)| a + b >= 300 && *a > 10 * b);
        let dropped = self.stale.iter().all(|count| *count > 0);
        self.unpunctual * 2 <= self.calls && in_operation && dropped && self.wrong.len() < 10
    }
}

/// What a witness says of a MainDevice that is wrong, however late the machine is.
const NEVER: [&str; 3] = ["behind cycle", "two moments", "can't be fresh"];

/// Whether this process may make wires at all.
fn can_run() -> bool {
    Veth::create("ap-may").is_ok()
}
