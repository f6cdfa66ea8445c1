//! The results of a sweep, for people and for programs.

use std::fmt::Write as _;

use isocat_descriptions::columns::cut;
use isocat_engine::sweep::summary::{Counts, Frontier, MEASURES, Measure, Summary};
use isocat_engine::sweep::{Sweep, Totals};

/// The totals for people.
pub(super) fn table(
    sweep: &Sweep,
    totals: &Totals,
    summary: &Summary,
    stopped: Option<u64>,
) -> String {
    let mut out = String::new();
    let share = |good: u64, all: u64| 100.0 * good as f64 / all.max(1) as f64;
    let (runs, good) = (totals.runs, totals.as_expected);
    let _ = writeln!(out, "As expected: {good} of {runs} runs ({:.2} %).", share(good, runs));
    if let Some(next) = stopped {
        let _ =
            writeln!(out, "Stopped before run {next} of {}; --resume goes on there.", sweep.runs());
    }
    let verdicts: Vec<_> =
        totals.verdicts.iter().map(|(name, count)| format!("{count} {name}")).collect();
    let _ = writeln!(out, "{}\n", verdicts.join(", "));
    for (number, axis) in sweep.axes().iter().enumerate() {
        if axis.values() == 1 {
            continue;
        }
        let _ = writeln!(out, " {:<40} {:>10} {:>12}", cut(&axis.key, 40), "runs", "as expected");
        for (value, (runs, good)) in totals.of_axis(number, axis) {
            let _ = writeln!(
                out,
                "   {:<38} {runs:>10} {:>10.2} %",
                cut(value, 38),
                share(*good, *runs)
            );
        }
        out.push('\n');
    }
    if let Some(frontier) = &summary.frontier {
        write_frontier(&mut out, frontier);
    }
    if !totals.findings.is_empty() {
        let _ = writeln!(out, " {:<40} {:>10}", "first finding, where not as expected", "runs");
        let mut findings: Vec<_> = totals.findings.iter().collect();
        findings.sort_by_key(|(name, count)| (std::cmp::Reverse(**count), name.as_str()));
        for (name, count) in findings {
            let _ = writeln!(out, "   {name:<38} {count:>10}");
        }
        let first: Vec<_> =
            totals.failed.iter().map(|(number, seed)| format!("{number} (seed {seed})")).collect();
        let _ = writeln!(out, "\n runs that were not as expected: {}", first.join(", "));
    }
    out
}

/// Writes where all runs of the grid were as expected, point by point and in words.
fn write_frontier(out: &mut String, frontier: &Frontier) {
    let (sought, given) = (&frontier.sought, &frontier.given);
    let _ = writeln!(out, " as expected [%]: {} down, {} across", given.key, sought.key);
    let shown = sought.values.len().min(MOST_COLUMNS);
    let heads: String =
        sought.values[..shown].iter().map(|v| format!("{:>10}", cut(v, 9))).collect();
    let _ = writeln!(out, "   {:<14}{heads}", "");
    for (place, value) in given.values.iter().enumerate() {
        let cell = |sought| match frontier.at(sought, place) {
            (0, _) => format!("{:>10}", "-"),
            (runs, good) => format!("{:>10.2}", 100.0 * good as f64 / runs as f64),
        };
        let cells: String = (0..shown).map(cell).collect();
        let _ = writeln!(out, "   {:<14}{cells}", cut(value, 13));
    }
    if shown < sought.values.len() {
        let _ = writeln!(
            out,
            "   {} more values of {}: see --page",
            sought.values.len() - shown,
            sought.key
        );
    }
    let _ = writeln!(out, "\n {} at which every run was as expected", sought.key);
    for (place, value) in given.values.iter().enumerate() {
        let words = crate::html::sweep::holds(frontier, place);
        let _ = writeln!(out, "   {} {:<13} {words}", given.key, cut(value, 13));
    }
    out.push('\n');
}

/// Largest number of columns of a frontier on a terminal.
const MOST_COLUMNS: usize = 8;

/// The totals for programs.
pub(super) fn document(sweep: &Sweep, totals: &Totals, summary: &Summary) -> serde_json::Value {
    let value = |((axis, value), (runs, good)): (&(usize, String), &(u64, u64))| {
        serde_json::json!({
            "key": sweep.axes()[*axis].key,
            "value": value,
            "runs": runs,
            "as_expected": good,
        })
    };
    let grid = |entry: &(&(usize, String), &(u64, u64))| sweep.axes()[entry.0.0].values() > 1;
    let counts = |counts: &Counts| {
        serde_json::json!({
            "count": counts.count(),
            "least": counts.ends().map(|(least, _)| least),
            "largest": counts.ends().map(|(_, most)| most),
            "bins": counts.bins().collect::<Vec<_>>(),
        })
    };
    let measure = |(measure, (good, bad)): (&Measure, &(Counts, Counts))| {
        let both =
            serde_json::json!({ "as_expected": counts(good), "not_as_expected": counts(bad) });
        (measure.name.to_owned(), both)
    };
    let frontier = summary.frontier.as_ref().map(|frontier| {
        let points = (0..frontier.given.values.len())
            .flat_map(|given| (0..frontier.sought.values.len()).map(move |sought| (sought, given)));
        let point = |(sought, given)| {
            let (runs, good) = frontier.at(sought, given);
            serde_json::json!({
                "sought": frontier.sought.values[sought], "given": frontier.given.values[given],
                "runs": runs, "as_expected": good,
            })
        };
        serde_json::json!({
            "sought": frontier.sought.key,
            "given": frontier.given.key,
            "points": points.map(point).collect::<Vec<_>>(),
        })
    });
    serde_json::json!({
        "format": "isocat-sweep/1",
        "measures": MEASURES.iter().zip(&summary.measures).map(measure).collect::<serde_json::Map<_, _>>(),
        "frontier": frontier,
        "runs": totals.runs,
        "planned": sweep.runs(),
        "as_expected": totals.as_expected,
        "verdicts": totals.verdicts,
        "findings": totals.findings,
        "values": totals.values.iter().filter(grid).map(value).collect::<Vec<_>>(),
        "failed": totals.failed.iter().map(|(number, seed)| serde_json::json!({ "number": number, "seed": seed })).collect::<Vec<_>>(),
    })
}
