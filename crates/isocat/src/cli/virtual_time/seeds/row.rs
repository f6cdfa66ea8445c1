//! One run among many, and the results of all of them.

use std::collections::BTreeMap;
use std::fmt::Write;

use isocat_engine::sweep::{Case, Sweep};
use serde::Serialize;
use serde_json::{Value, json};

use crate::cli::virtual_time::outcome::PROGRAM_FAILED;
use crate::cli::{IN_SYNC, NOT_KNOWN};

/// Largest number of runs with a separate line in the table.
const MOST_SHOWN: usize = 20;

/// The outcome of one run.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Place in the sweep.
    pub number: u64,
    pub seed: u64,
    /// The value of each axis.
    pub values: Vec<String>,
    /// The exit code of the run.
    pub code: i32,
    /// Answer of the last session: `in-sync`, `except`, `not-known`.
    pub answer: String,
    /// Kind of the first finding; empty without findings.
    pub first_finding: String,
    /// Least time from the end of copying and calculating to SYNC0, over all SubDevices; negative
    /// if SYNC0 came first.
    pub margin_ns: Option<f64>,
    /// Worst SYNC0 error of all SubDevices.
    pub sync0_error_ns: Option<f64>,
    /// End of the program: `exited`, `killed`, `limit`, `stopped`, `deadlock`, `spins`.
    pub program: String,
    /// Its exit code or signal.
    pub program_code: Option<i64>,
    /// Virtual time.
    pub lasted_ns: i64,
    pub frames: u64,
    /// Hash of all frames that came back.
    pub wire: String,
}

impl Row {
    /// A row of a run's report.
    pub fn new(number: u64, case: Case, code: i32, report: &str) -> Result<Self, String> {
        let report: Value = serde_json::from_str(report)
            .map_err(|error| format!("run {number}: its report can't be read: {error}"))?;
        let (session, program) = (last_session(&report), &report["program"]);
        let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
        let devices = session["judged"]["devices"].as_array().map_or(&[][..], Vec::as_slice);
        let margins = devices.iter().filter_map(|device| device["sync0_margin"]["min_ns"].as_f64());
        let errors = devices.iter().filter_map(|device| device["sync0_error"]["worst_ns"].as_f64());
        Ok(Self {
            number,
            seed: case.seed,
            values: case.values,
            code,
            answer: text(&session["answer"]),
            first_finding: first_finding(session).unwrap_or_default(),
            margin_ns: margins.min_by(f64::total_cmp),
            sync0_error_ns: errors.max_by(f64::total_cmp),
            program: text(&program["how"]),
            program_code: program["code"].as_i64(),
            lasted_ns: program["lasted_ns"].as_i64().unwrap_or_default(),
            frames: program["frames_sent"].as_u64().unwrap_or_default(),
            wire: text(&program["wire_hash"]),
        })
    }
}

fn last_session(report: &Value) -> &Value {
    report["sessions"].as_array().and_then(|sessions| sessions.last()).unwrap_or(&Value::Null)
}

/// The kind of the first finding of a session: the earliest one in its first stretch of operation
/// with findings.
fn first_finding(session: &Value) -> Option<String> {
    let judged = &session["judged"];
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let earlier = list(&judged["earlier"]).into_iter().map(|stretch| list(&stretch["kinds"]));
    let last = list(&judged["devices"]).iter().flat_map(|device| list(&device["kinds"])).collect();
    let stretches = earlier.chain([last]);
    let kinds: Vec<Value> = stretches.into_iter().find(|kinds: &Vec<Value>| !kinds.is_empty())?;
    // Those without a time of their own are told at the end.
    let first = kinds.iter().min_by_key(|kind| kind["since_ns"].as_i64().unwrap_or(i64::MAX))?;
    first["kind"].as_str().map(str::to_owned)
}

/// All rows as CSV.
pub fn csv(sweep: &Sweep, rows: &[Row]) -> String {
    let quoted = |text: &str| match text.contains([',', '"', '\n']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    };
    let mut out = "number,seed".to_owned();
    for axis in sweep.axes() {
        out += &format!(",{}", quoted(&axis.key));
    }
    out += ",exit_code,answer,first_finding,margin_ns,sync0_error_ns,program,program_code,lasted_ns,frames,wire\n";
    for row in rows {
        out += &format!("{},{}", row.number, row.seed);
        row.values.iter().for_each(|value| out += &format!(",{}", quoted(value)));
        let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        let code = row.program_code.map_or(String::new(), |code| code.to_string());
        // Writing to a String cannot fail, here and below.
        let _ = writeln!(
            out,
            ",{},{},{},{},{},{},{code},{},{},{}",
            row.code,
            row.answer,
            row.first_finding,
            number(row.margin_ns),
            number(row.sync0_error_ns),
            row.program,
            row.lasted_ns,
            row.frames,
            row.wire
        );
    }
    out
}

/// All rows as one JSON document.
pub fn document(sweep: &Sweep, rows: &[Row]) -> Value {
    let axes: Vec<&str> = sweep.axes().iter().map(|axis| axis.key.as_str()).collect();
    json!({
        "runs": sweep.runs(), "axes": axes, "answers": counts(rows.iter().map(|row| &row.answer[..])),
        "first_findings": first_findings(rows), "rows": rows,
    })
}

fn counts<'a>(of: impl Iterator<Item = &'a str>) -> BTreeMap<&'a str, u64> {
    let mut counts = BTreeMap::new();
    for name in of {
        *counts.entry(name).or_default() += 1;
    }
    counts
}

fn first_findings(rows: &[Row]) -> BTreeMap<&str, u64> {
    counts(rows.iter().map(|row| &row.first_finding[..]).filter(|kind| !kind.is_empty()))
}

/// The results of all runs, in words.
pub fn table(sweep: &Sweep, rows: &[Row]) -> String {
    let with = |code: u8| rows.iter().filter(|row| row.code == i32::from(code)).count();
    let [in_sync, not_known, failed] = [IN_SYNC, NOT_KNOWN, PROGRAM_FAILED].map(with);
    let other = rows.len() - in_sync - not_known - failed;
    let mut out = format!(
        "{} of {} runs: {in_sync} in sync or as expected, {other} not, {not_known} never in OP, {failed} in which the program failed\n",
        rows.len(),
        sweep.runs()
    );
    for (kind, count) in first_findings(rows) {
        let first = rows.iter().find(|row| row.first_finding == kind).map_or(0, |row| row.seed);
        let _ = writeln!(out, "  {count:>6} began with {kind}; the first is seed {first}");
    }
    let margins: Vec<f64> = rows.iter().filter_map(|row| row.margin_ns).collect();
    let closest = rows.iter().filter(|row| row.margin_ns.is_some());
    if let Some(row) =
        closest.min_by(|a, b| a.margin_ns.unwrap_or(0.0).total_cmp(&b.margin_ns.unwrap_or(0.0)))
    {
        let mean = margins.iter().sum::<f64>() / margins.len() as f64;
        let _ = writeln!(
            out,
            "  least margin before SYNC0: {:.3} us with seed {}, {:.3} us in the mean",
            row.margin_ns.unwrap_or(0.0) / 1e3,
            row.seed,
            mean / 1e3
        );
    }
    let shown: Vec<&Row> = rows.iter().filter(|row| row.code != i32::from(IN_SYNC)).collect();
    if !shown.is_empty() {
        out += "    seed  answer     program        margin us  first finding\n";
    }
    for row in shown.iter().take(MOST_SHOWN) {
        let margin = row.margin_ns.map_or("-".into(), |margin| format!("{:.3}", margin / 1e3));
        let code = row.program_code.map_or(String::new(), |code| format!(" {code}"));
        let program = format!("{}{code}", row.program);
        let values = row.values.join(" ");
        let line = format!(
            "{:>8}  {:<9}  {program:<13}  {margin:>9}  {:<30} {values}",
            row.seed, row.answer, row.first_finding
        );
        out += line.trim_end();
        out.push('\n');
    }
    if shown.len() > MOST_SHOWN {
        let _ = writeln!(out, "    and {} more", shown.len() - MOST_SHOWN);
    }
    out
}
