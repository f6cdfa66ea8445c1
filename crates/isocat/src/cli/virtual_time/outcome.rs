//! The outcome of a program: in words, as JSON, as an exit code.

use isocat_engine::verdict::Answer;
use isocat_serve::Summary;
use isocat_serve::summary::Outcome;
use isocat_virtual::supervisor::{Ended, Ending, How};
use serde_json::{Value, json};

use crate::cli::{IN_SYNC, NOT_IN_SYNC, NOT_KNOWN};

/// Synchronization has no fault, but the program itself failed.
pub const PROGRAM_FAILED: u8 = 4;

/// The exit code: by the expectations of the segment, or without any by its last session, and then
/// by the program.
pub fn exit_code(summary: &Summary, ended: &Ended) -> u8 {
    let judged = match (summary.outcome(), summary.answer()) {
        (Outcome::NotAsExpected, _) => NOT_IN_SYNC,
        (Outcome::NotJudged, _) => NOT_KNOWN,
        (Outcome::AsExpected, _) if !summary.expected.is_empty() => IN_SYNC,
        (Outcome::AsExpected, Answer::InSync) => IN_SYNC,
        (Outcome::AsExpected, Answer::Except) => NOT_IN_SYNC,
        (Outcome::AsExpected, Answer::NotKnown) => NOT_KNOWN,
    };
    let failed = match &ended.how {
        How::Deadlock(_) | How::Spins(_) => true,
        How::Itself(ending) => *ending != Ending::Exited(0),
        How::Limit | How::Stopped => false,
    };
    // Where nothing was ever in OP a program that failed is the reason, whatever was expected.
    let in_op = summary.sessions.iter().any(|session| session.judged.is_some());
    match judged {
        NOT_IN_SYNC if in_op || !failed => NOT_IN_SYNC,
        _ if failed => PROGRAM_FAILED,
        judged => judged,
    }
}

/// The end of the program, and its counts.
pub fn words(ended: &Ended, hash: u64) -> String {
    let how = match &ended.how {
        How::Itself(Ending::Exited(code)) => format!("ended with exit code {code}"),
        How::Itself(Ending::Killed(signal)) => format!("was ended by signal {signal}"),
        How::Limit => "was ended, as its time (--for) was over".into(),
        How::Stopped => "was ended, as asked".into(),
        How::Deadlock(waits) => format!(
            "was ended, as all its threads wait for something that will not come: {}",
            waits.join("; ")
        ),
        How::Spins(threads) => {
            format!("was ended, as it ran for 2 s without any system call: {}", threads.join("; "))
        }
    };
    let figures = &ended.figures;
    let mut text = format!(
        "The program {how}, after {:.6} s of virtual time.\n{} frames sent, {} received; {} calls stopped it, {} readings of the clock did not; {} threads, {} processes; wire {hash:016x}\n",
        ended.lasted.0 as f64 / 1e9,
        figures.sent,
        figures.received,
        figures.stops,
        figures.readings,
        figures.threads,
        figures.processes,
    );
    for (note, count) in &ended.notes {
        text += &format!("note: {note} ({count} times)\n");
    }
    text
}

/// The summary of the segment, with the program.
pub fn document(summary: &Summary, seed: u64, ended: &Ended, hash: u64) -> Value {
    let mut document = serde_json::to_value(summary).unwrap_or_default();
    document["seed"] = json!(seed);
    document["program"] = program(ended, hash);
    document
}

fn program(ended: &Ended, hash: u64) -> Value {
    let figures = &ended.figures;
    let (how, code, who) = match &ended.how {
        How::Itself(Ending::Exited(code)) => ("exited", Some(*code), &[][..]),
        How::Itself(Ending::Killed(signal)) => ("killed", Some(*signal), &[][..]),
        How::Limit => ("limit", None, &[][..]),
        How::Stopped => ("stopped", None, &[][..]),
        How::Deadlock(who) => ("deadlock", None, &who[..]),
        How::Spins(who) => ("spins", None, &who[..]),
    };
    json!({
        "how": how, "code": code, "threads_at_end": who, "lasted_ns": ended.lasted.0,
        "wire_hash": format!("{hash:016x}"),
        "stops": figures.stops, "clock_readings": figures.readings, "switches": figures.switches,
        "frames_sent": figures.sent, "frames_received": figures.received,
        "threads": figures.threads, "processes": figures.processes, "notes": ended.notes,
    })
}
