//! How long the calls of a MainDevice take on a hostile wire: `cargo run --release -p isocat-host
//! --example hostile_wire [SEEDS] [FIRST]`. The stories are those of the MainDevice's own test.
//! Here they are timed in CPU time of this thread, which includes some 0.2 us for the measurement
//! itself.

use rustix::time::{ClockId, clock_gettime};

#[path = "../../maindevice/tests/hostile/device.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod device;
#[path = "../../maindevice/tests/hostile/lies.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod lies;
#[path = "../../maindevice/tests/hostile/run.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod run;

use run::{Call, End, Meter, Story};

/// The longest call of each kind, ns, and the number of calls by the power of two of their time.
#[derive(Default)]
struct Stopwatch {
    longest: [u64; 3],
    calls: [[u64; 32]; 3],
}

/// CPU time of this thread, ns.
fn now() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

impl Meter for Stopwatch {
    fn call<R>(&mut self, kind: Call, call: impl FnOnce() -> R) -> R {
        let begin = now();
        let result = call();
        let took = now() - begin;
        let kind = kind as usize;
        self.longest[kind] = self.longest[kind].max(took);
        self.calls[kind][took.max(1).ilog2().min(31) as usize] += 1;
        result
    }
}

fn main() {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse().expect("a number"));
    let (seeds, first) = (numbers.next().unwrap_or(1_000), numbers.next().unwrap_or(0));
    let mut all = Stopwatch::default();
    let mut longest = Vec::new();
    let (mut frames, mut endless, mut blamed, mut failed, mut named) = (0, 0, 0, 0, 0);
    let mut slowest = (0, 0);
    for seed in first..first + seeds {
        let story = Story::of_seed(seed);
        let mut watch = Stopwatch::default();
        let outcome = run::run(&story, &mut watch);
        frames += outcome.statistics.frames_sent;
        endless += u64::from(outcome.end == End::Endless);
        if !outcome.wrong_blame.is_empty() {
            blamed += 1;
            println!("seed {seed}: {:?}: {}", story.liars, outcome.wrong_blame[0]);
        }
        if story.author().is_some() && matches!(outcome.end, End::Failed(_)) {
            failed += 1;
            named += u64::from(outcome.named);
        }
        longest.push(watch.longest[Call::Frame as usize]);
        slowest = slowest.max((watch.longest[Call::Frame as usize], seed));
        for (sum, calls) in all.calls.iter_mut().zip(watch.calls) {
            sum.iter_mut().zip(calls).for_each(|(sum, calls)| *sum += calls);
        }
    }
    longest.sort_unstable();
    let at = |permille: usize| longest[(longest.len() - 1) * permille / 1000];
    println!("{seeds} seeds, {frames} frames, {endless} endless, {blamed} with wrong blame");
    println!("one liar ended {failed} runs, and is named in {named} of them");
    println!("longest handle_frame of a seed, us:");
    for (name, permille) in [("median", 500), ("90 %", 900), ("99 %", 990), ("99.9 %", 999)] {
        println!("{name:>8} {:9.1}", at(permille) as f64 / 1e3);
    }
    println!("{:>8} {:9.1} (seed {})", "most", slowest.0 as f64 / 1e3, slowest.1);
    println!("calls by time, from 2^n ns on:  frame  timeout  transmit");
    for power in 0..32 {
        let calls = all.calls.map(|calls| calls[power]);
        if calls.iter().any(|calls| *calls > 0) {
            println!("{power:>4} {:12} {:12} {:12}", calls[0], calls[1], calls[2]);
        }
    }
}
