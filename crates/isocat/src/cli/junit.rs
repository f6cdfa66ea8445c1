//! The result of a run or of a service as a JUnit file, which every CI system reads: each
//! expectation is a test.

use std::fmt::Write;

use isocat_descriptions::markup::escaped;
use isocat_engine::Report;
#[cfg(target_os = "linux")]
use isocat_serve::Summary;

/// The result of one test.
enum Fate {
    Passed,
    /// It failed, with the reason.
    Failed(String),
    /// It could not be judged, with the reason. A CI system counts it as an error, not as passed.
    NotJudged(String),
}

/// The document of a run. Without expectations it has one test: that the run is in sync.
pub fn document(report: &Report) -> String {
    let tests = match &report.expected[..] {
        [] => vec![("in sync".to_owned(), fate(report.in_sync, || report.verdict.clone()))],
        all => {
            let why = |found: &str| format!("{found}. {}", report.verdict);
            all.iter().map(|one| (one.what.clone(), fate(one.met, || why(&one.found)))).collect()
        }
    };
    write(&report.segment_file, report.seed, &tests, &report.text())
}

/// The document of a served segment. Without expectations it has one test: that there was a session
/// in operation, and that every such session was in sync.
#[cfg(target_os = "linux")]
pub fn of_service(summary: &Summary, seed: u64) -> String {
    let judged: Vec<_> =
        summary.sessions.iter().filter_map(|session| session.judged.as_ref()).collect();
    let in_sync = !judged.is_empty() && judged.iter().all(|judged| judged.in_sync);
    let tests = match &summary.expected[..] {
        [] => {
            let why = match judged.len() {
                0 => "no SubDevice came to operation",
                _ => "something speaks against a session",
            };
            vec![("in sync".to_owned(), fate(in_sync, || why.to_owned()))]
        }
        all => {
            let of = |met: Option<bool>, found: &String| match met {
                Some(met) => fate(met, || found.clone()),
                None => Fate::NotJudged(found.clone()),
            };
            all.iter().map(|one| (one.what.clone(), of(one.met, &one.found))).collect()
        }
    };
    write(&summary.segment_file, seed, &tests, &summary.text())
}

fn fate(passed: bool, why: impl FnOnce() -> String) -> Fate {
    if passed { Fate::Passed } else { Fate::Failed(why()) }
}

fn write(segment_file: &str, seed: u64, tests: &[(String, Fate)], text: &str) -> String {
    let suite = escaped(segment_file);
    let count = |is: fn(&Fate) -> bool| tests.iter().filter(|(_, fate)| is(fate)).count();
    let failures = count(|fate| matches!(fate, Fate::Failed(_)));
    let errors = count(|fate| matches!(fate, Fate::NotJudged(_)));
    let counts = format!("tests=\"{}\" failures=\"{failures}\" errors=\"{errors}\"", tests.len());
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites {counts}>\n  \
         <testsuite name=\"{suite}\" {counts} skipped=\"0\">\n    \
         <properties><property name=\"seed\" value=\"{seed}\"/></properties>\n"
    );
    for (name, fate) in tests {
        let test = format!("    <testcase classname=\"{suite}\" name=\"{}\"", escaped(name));
        let (element, why) = match fate {
            Fate::Passed => {
                // Writing to a String cannot fail, here and below.
                let _ = writeln!(out, "{test}/>");
                continue;
            }
            Fate::Failed(why) => ("failure", why.clone()),
            Fate::NotJudged(why) => ("error", format!("not judged: {why}")),
        };
        let why = escaped(&why);
        let _ = writeln!(out, "{test}>\n      <{element} message=\"{why}\"/>\n    </testcase>");
    }
    let plain = anstream::adapter::strip_str(text).to_string();
    let _ = writeln!(out, "    <system-out>{}</system-out>", escaped(&plain));
    out + "  </testsuite>\n</testsuites>\n"
}
