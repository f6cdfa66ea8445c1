//! The result of a run as a JUnit file, which every CI reads: each expectation is a test.

use std::fmt::Write;

use isocat_descriptions::markup::escaped;
use isocat_engine::Report;

/// The document. A run of which nothing in particular is expected has one test: that it is in sync.
pub fn document(report: &Report) -> String {
    let suite = escaped(&report.segment_file);
    let cases: Vec<(String, Option<String>)> = match &report.expected[..] {
        [] => vec![("in sync".to_owned(), (!report.in_sync).then(|| report.verdict.clone()))],
        all => {
            let why = |found: &str| format!("{found}. {}", report.verdict);
            all.iter().map(|one| (one.what.clone(), (!one.met).then(|| why(&one.found)))).collect()
        }
    };
    let failures = cases.iter().filter(|(_, failure)| failure.is_some()).count();
    let mut out = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    // Writing to a String cannot fail.
    let _ = writeln!(out, "<testsuites tests=\"{}\" failures=\"{failures}\">", cases.len());
    let _ = writeln!(
        out,
        "  <testsuite name=\"{suite}\" tests=\"{}\" failures=\"{failures}\" errors=\"0\" skipped=\"0\">",
        cases.len()
    );
    let _ = writeln!(
        out,
        "    <properties><property name=\"seed\" value=\"{}\"/></properties>",
        report.seed
    );
    for (name, failure) in &cases {
        let name = escaped(name);
        match failure {
            None => {
                let _ = writeln!(out, "    <testcase classname=\"{suite}\" name=\"{name}\"/>");
            }
            Some(why) => {
                let _ = writeln!(
                    out,
                    "    <testcase classname=\"{suite}\" name=\"{name}\">\n      <failure message=\"{}\"/>\n    \
                     </testcase>",
                    escaped(why)
                );
            }
        }
    }
    let _ = writeln!(out, "    <system-out>{}</system-out>", escaped(&plain(&report.text())));
    out + "  </testsuite>\n</testsuites>\n"
}

fn plain(text: &str) -> String {
    anstream::adapter::strip_str(text).to_string()
}
