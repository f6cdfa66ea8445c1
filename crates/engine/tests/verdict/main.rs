//! The verdict of a wire against true time: random segments, with and without faults, each judged by what registers and
//! frames show and, beside it, by the judges of the simulation.
//!
//! A few are always tried. `ISOCAT_SEEDS=3000 cargo test -p isocat-engine --test verdict -- --nocapture` tries as many as one
//! likes and prints the table of docs/verdict.md; `ISOCAT_SEEDS_FROM` says with which to begin.

mod before;
mod campaign;
mod draw;
mod truth;

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use campaign::{Fate, Ran};
use isocat_engine::verdict::Answer;

/// What the runs came to.
#[derive(Default)]
struct Table {
    counts: BTreeMap<&'static str, u64>,
    /// By kind of fault: runs, with a loss, silent.
    faults: BTreeMap<&'static str, [u64; 4]>,
    silent: Vec<String>,
    false_alarms: Vec<String>,
    open: Vec<String>,
}

impl Table {
    fn count(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }

    fn of(&self, what: &str) -> u64 {
        self.counts.get(what).copied().unwrap_or(0)
    }

    fn add(&mut self, seed: u64, fate: Fate) {
        let ran = match fate {
            Fate::Refused => return self.count("refused"),
            Fate::NotUp => return self.count("did not come up"),
            Fate::Ran(ran) => ran,
        };
        let Ran { fault, losses, answer, hidden, told, before, .. } = &ran;
        let line = format!("seed {seed}, {fault}: lost {losses:?}, told {}", told.join("; "));
        self.count("ran");
        let of_fault = self.faults.entry(fault).or_default();
        of_fault[0] += 1;
        of_fault[1] += u64::from(!losses.is_empty());
        of_fault[2] += u64::from(*answer != Answer::InSync);
        match (losses.is_empty(), answer) {
            (false, Answer::Except) => self.count("loss: except"),
            (false, Answer::NotKnown) => self.count("loss: not known"),
            (false, Answer::InSync) => {
                self.faults.entry(fault).or_default()[3] += 1;
                match hidden {
                    Some(why) => self.count(why),
                    None => {
                        self.count("loss: silent");
                        println!("SILENT {line}");
                        self.silent.push(line);
                    }
                }
            }
            (true, Answer::InSync) => self.count("no loss: in sync"),
            (true, answer) if *fault == draw::NONE => {
                let (name, list) = match answer {
                    // At long cycles the clocks of some segments are near their limit indeed.
                    _ if ran.near_limit => return self.count("no fault: a clock near its limit"),
                    Answer::NotKnown => ("no fault: not known", &mut self.open),
                    _ => ("no fault: false alarm", &mut self.false_alarms),
                };
                println!("{name} {line}");
                list.push(line);
                self.count(name);
            }
            (true, Answer::Except) => self.count("fault without a loss: except"),
            (true, Answer::NotKnown) => self.count("fault without a loss: not known"),
        }
        if !losses.is_empty() && before.is_empty() {
            self.count("loss: silent by the last look");
        }
    }

    fn losses(&self) -> u64 {
        self.faults.values().map(|[_, losses, ..]| losses).sum()
    }
}

fn try_all(seeds: std::ops::Range<u64>) -> Table {
    let next = AtomicU64::new(seeds.start);
    let table = Mutex::new(Table::default());
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= seeds.end {
                return;
            }
            let fate = campaign::run(seed);
            table.lock().expect("no thread panicked").add(seed, fate);
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(work);
        scope.spawn(work);
    });
    table.into_inner().expect("no thread panicked")
}

/// No loss that anything on the wire can show is silent, and a segment without faults is in sync.
#[test]
fn the_wire_misses_no_loss_that_it_can_show() {
    let number = |name: &str, otherwise: u64| {
        let text = std::env::var(name).ok();
        text.map_or(otherwise, |text| text.parse().expect("a number of seeds"))
    };
    let from = number("ISOCAT_SEEDS_FROM", 0);
    let seeds = number("ISOCAT_SEEDS", FEW);
    let table = try_all(from..from + seeds);
    for (what, count) in &table.counts {
        println!("{what}: {count}");
    }
    println!("true losses: {}", table.losses());
    for (fault, [runs, losses, told, silent]) in &table.faults {
        println!("| {fault} | {runs} | {losses} | {told} | {silent} |");
    }
    let why = [&table.silent, &table.false_alarms, &table.open].map(|list| list.join("\n"));
    assert!(table.silent.is_empty(), "silent:\n{}", why[0]);
    assert!(table.false_alarms.is_empty(), "false alarms:\n{}", why[1]);
    assert!(table.open.is_empty(), "not known though nothing was wrong:\n{}", why[2]);
    // A campaign without losses, or one in which nothing runs well, shows nothing.
    assert!(table.losses() * 10 >= seeds, "{} losses in {seeds} runs", table.losses());
    assert!(table.of("no loss: in sync") * 20 >= seeds);
}

/// Seeds that are tried where nobody asks for more.
const FEW: u64 = 150;
