//! `--bisect`: the limit of a value.

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::sync::atomic::AtomicBool;

use isocat_engine::sweep::{Bisection, Sweep, Tried};

use crate::cli::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, print};

/// Looks for the limit and prints it; returns the exit code.
pub(super) fn run(
    sweep: &Sweep,
    range: &str,
    threads: usize,
    stop: &AtomicBool,
    json: bool,
) -> Result<u8, String> {
    let shows = std::io::stderr().is_terminal();
    let found = sweep.bisect(range, threads, stop, |tried| {
        if shows {
            eprintln!("{}: {}", tried.value, outcome(tried));
        }
    });
    let found = found.map_err(|error| format!("--bisect {error}"))?;
    let text = match json {
        true => crate::cli::run::json(&document(&found)),
        false => text(&found),
    };
    let all = found.tried.iter().all(|tried| tried.failed.is_none());
    Ok(match print(&text) {
        IN_SYNC if all => IN_SYNC,
        BAD_INPUT => BAD_INPUT,
        _ => NOT_IN_SYNC,
    })
}

fn text(found: &Bisection) -> String {
    let mut out = format!("{}\n\n", verdict(found));
    let _ = writeln!(out, " {:<20} as expected", found.key);
    for tried in &found.tried {
        let _ = writeln!(out, "   {:<18} {}", tried.value, outcome(tried));
    }
    out
}

/// Both sides of the limit, or why there is none.
fn verdict(found: &Bisection) -> String {
    let (key, runs) = (&found.key, found.runs);
    let [first, .., last] = &found.tried[..] else {
        return match &found.tried[..] {
            [only] => format!("{key} = {}: {}.", only.value, outcome(only)),
            _ => "Nothing was run.".to_owned(),
        };
    };
    let side = |place: usize| {
        let tried = &found.tried[place];
        format!("{}: {}", tried.value, outcome(tried))
    };
    match &found.edges()[..] {
        [] => {
            let (from, to) = (&first.value, &last.value);
            let all = first.failed.is_none();
            let alike = if all { "as expected" } else { "not as expected" };
            format!(
                "No edge: with {key} from {from} to {to} all values that were tried are {alike}, {runs} runs each."
            )
        }
        [(low, high)] => format!(
            "The edge of {key}, with {runs} runs at each value:\n  {}\n  {}",
            side(*low),
            side(*high)
        ),
        [(low, high), more @ ..] => format!(
            "{key} is not monotonic: there are {} edges. The first one, with {runs} runs at each value:\n  {}\n  {}",
            more.len() + 1,
            side(*low),
            side(*high)
        ),
    }
}

fn outcome(tried: &Tried) -> String {
    match &tried.failed {
        None => "all".to_owned(),
        Some((seed, outcome)) => {
            format!("not with seed {seed}: {}", outcome.name())
        }
    }
}

fn document(found: &Bisection) -> serde_json::Value {
    let tried = |tried: &Tried| {
        let failed = tried.failed.as_ref();
        serde_json::json!({
            "value": tried.value,
            "as_expected": failed.is_none(),
            "seed": failed.map(|(seed, _)| seed),
            "verdict": failed.map(|(_, outcome)| outcome.verdict),
            "finding": failed.and_then(|(_, outcome)| outcome.finding.clone()),
        })
    };
    let edge = |(low, high): &(usize, usize)| [*low, *high].map(|at| found.tried[at].value.clone());
    serde_json::json!({
        "format": "isocat-sweep-bisect/1",
        "key": found.key,
        "runs_at_each_value": found.runs,
        "edges": found.edges().iter().map(edge).collect::<Vec<_>>(),
        "tried": found.tried.iter().map(tried).collect::<Vec<_>>(),
    })
}
