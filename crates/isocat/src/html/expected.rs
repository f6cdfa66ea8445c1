//! The expectations of a run, and its injected faults.

use isocat_engine::Report;
use isocat_wire::time::Nanos;
use maud::{Markup, html};

/// A row for each expectation: whether it was met (`None`: that could not be judged), the
/// expectation and the observation. Empty without expectations.
pub fn table(expected: &[(Option<bool>, &str, &str)]) -> Markup {
    html! {
        @if !expected.is_empty() {
            section #expected {
                h2 { "What was expected" }
                table {
                    thead { tr { th { "came so" } th { "expected" } th { "found" } } }
                    tbody {
                        @for (met, what, found) in expected {
                            tr.bad[*met != Some(true)] {
                                td { (met.map_or("not judged", |met| if met { "yes" } else { "no" })) }
                                td { (what) }
                                td { (found) }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Both lists; empty if there are none.
pub fn sections(report: &Report) -> Markup {
    let expected = report.expected.iter().map(|one| (Some(one.met), &*one.what, &*one.found));
    html! {
        (table(&expected.collect::<Vec<_>>()))
        @if !report.faults.is_empty() {
            section #faults {
                h2 { "What went wrong, as the segment file asks" }
                details open[report.faults.len() <= 16] {
                    summary { (report.faults.len()) " beginnings and ends, from the beginning of operation" }
                    table {
                        tbody {
                            @for fault in &report.faults {
                                tr { td { (Nanos(fault.at_ns)) } td { (fault.what) } }
                            }
                        }
                    }
                }
            }
        }
    }
}
