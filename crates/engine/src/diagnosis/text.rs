//! Causes and remedies for people: behind the verdict, before any table.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, wrap};

use super::{Diagnosis, place};
use crate::report::{BAD, GOOD, Report};

/// SubDevices whose causes are told; what stands behind them mostly follows from theirs.
const MOST: usize = 3;
/// Where the words of causes and remedies begin.
const INDENT: usize = 10;

impl Report {
    /// Why it is not in sync, and what to do; nothing where it is.
    pub(crate) fn write_why(&self, out: &mut String) -> fmt::Result {
        let told: Vec<&Diagnosis> = self.diagnoses.iter().filter(|one| one.says_more()).collect();
        for diagnosis in told.iter().take(MOST) {
            writeln!(out, "\n{}", diagnosis.who)?;
            items(out, ("Cause:", BAD), &diagnosis.causes, false)?;
            items(out, ("Remedy:", GOOD), &diagnosis.remedies, true)?;
        }
        if told.len() > MOST {
            let more = told.len() - MOST;
            writeln!(out, "\n… and {more} more with a cause or a remedy; --json has them all")?;
        }
        if self.diagnoses.is_empty() {
            return Ok(());
        }
        let command = format!("isocat run{}", place::argument(self));
        let words = match told.is_empty() {
            true => "The figures of this run show no cause. To look closer: ",
            false => "To look closer: ",
        };
        writeln!(out)?;
        let text = format!(
            "{words}{command} --report run.html draws the cycles, --capture run.pcapng has the frames with a comment where something \
             happened."
        );
        wrap(&text, WIDTH).iter().try_for_each(|line| writeln!(out, "{line}"))
    }
}

impl Diagnosis {
    /// Whether it says more than its finding.
    fn says_more(&self) -> bool {
        !self.causes.is_empty() || !self.remedies.is_empty()
    }
}

/// One item to each line, numbered where there is an order.
fn items(
    out: &mut String,
    (head, style): (&str, anstyle::Style),
    all: &[String],
    numbered: bool,
) -> fmt::Result {
    for (number, item) in all.iter().enumerate() {
        let sign = match (numbered, all.len()) {
            (_, 1) => String::new(),
            (true, _) => format!("{}. ", number + 1),
            (false, _) => "- ".to_owned(),
        };
        let deeper = INDENT + sign.chars().count();
        for (i, line) in wrap(item, WIDTH - deeper).iter().enumerate() {
            match (number, i) {
                (0, 0) => {
                    let room = INDENT - 2 - head.chars().count();
                    writeln!(out, "  {style}{head}{style:#}{:room$}{sign}{line}", "")?;
                }
                (_, 0) => writeln!(out, "{:INDENT$}{sign}{line}", "")?,
                _ => writeln!(out, "{:deeper$}{line}", "")?,
            }
        }
    }
    Ok(())
}
