//! Reports as one HTML file each: no network, light and dark, for screen, phone and paper.
//!
//! A [`Page`] is the frame: style, script and the report as JSON are in the file itself. The
//! content comes from [`run`], [`interface`], [`plan`], [`serve`], [`sweep`], [`conform`] or
//! [`diagnose`]; drawings from [`crate::picture`]. Without its script a page shows the same, but
//! cannot be zoomed.

pub mod conform;
pub mod diagnose;
mod expected;
#[cfg(target_os = "linux")]
pub mod interface;
mod parts;
pub mod plan;
mod plant;
pub mod run;
#[cfg(target_os = "linux")]
pub mod serve;
#[cfg(not(target_family = "wasm"))]
pub mod sweep;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::picture;

/// A report as a page.
#[derive(Clone, Debug)]
pub struct Page {
    /// Title of the tab.
    pub title: String,
    /// The kind of report, above the verdict.
    pub kind: &'static str,
    /// Whether all is well.
    pub good: bool,
    /// The verdict in words.
    pub verdict: String,
    /// The content.
    pub body: Markup,
    /// The command that repeats it; empty if that is not possible.
    pub command: String,
    /// The report for programs.
    pub json: String,
}

const STYLE: &str = include_str!("html/style.css");
const SCRIPT: &str = include_str!("html/script.js");

impl Page {
    /// The HTML file.
    pub fn render(&self) -> String {
        // Only these sequences could end a script element or start a comment in it.
        let json = self.json.replace("</", "<\\/").replace("<!--", "<\\!--");
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    meta name="generator" content={ "isocat " (env!("CARGO_PKG_VERSION")) };
                    title { (self.title) }
                    link rel="icon" href="data:,";
                    // The page's own style comes last, so that it decides: paper is white.
                    style { (PreEscaped(picture::STYLE)) (PreEscaped(STYLE)) }
                }
                body {
                    header {
                        p.kind { (self.kind) " · " span.quiet { "isocat " (env!("CARGO_PKG_VERSION")) } }
                        h1.verdict.good[self.good].bad[!self.good] { (self.verdict) }
                    }
                    p.quiet.swipe { "Drawings and tables are wider than this screen: swipe them." }
                    main { (self.body) }
                    footer {
                        @if !self.command.is_empty() {
                            p { "To repeat it: " code { (self.command) } }
                        }
                        p.quiet {
                            "The report for programs is in this page: "
                            button #save type="button" { "save report.json" }
                        }
                        p.quiet {
                            "EtherCAT is a registered trademark and patented technology, licensed by Beckhoff Automation GmbH, Germany."
                        }
                    }
                    div #tip role="status" hidden {}
                    script #report type="application/json" { (PreEscaped(json)) }
                    script { (PreEscaped(picture::ZOOM)) }
                    script { (PreEscaped(SCRIPT)) }
                }
            }
        }
        .into_string()
    }
}
