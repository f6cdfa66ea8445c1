//! What was expected of a run, and what went wrong in it on purpose.

use isocat_engine::Report;
use isocat_wire::time::Nanos;
use maud::{Markup, html};

/// Both lists; nothing where there is neither.
pub fn sections(report: &Report) -> Markup {
    html! {
        @if !report.expected.is_empty() {
            section #expected {
                h2 { "What was expected" }
                table {
                    thead { tr { th { "came so" } th { "expected" } th { "found" } } }
                    tbody {
                        @for one in &report.expected {
                            tr.bad[!one.met] {
                                td { (if one.met { "yes" } else { "no" }) }
                                td { (one.what) }
                                td { (one.found) }
                            }
                        }
                    }
                }
            }
        }
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
