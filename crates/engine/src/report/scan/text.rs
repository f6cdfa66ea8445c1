//! A scan for people: a hundred columns, verdict first, then the tree, then SubDevice by SubDevice.

mod device;

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, cut, cut_front, wrap};

use super::{Delay, Device, Note, ScanReport};
use crate::fold::{fold, range};
use crate::report::{BAD, GOOD, QUIET};

/// Above this number of SubDevices, the details of each are shown only on request.
const MOST_IN_FULL: usize = 6;
/// Largest number of rows of a table, and of notes.
const MOST_ROWS: usize = 64;
const MOST_NOTES: usize = 16;
/// Columns for tree and name.
const TREE: usize = 46;
/// Columns by which a branch is indented at most: what branches off a deeper one stands in the same
/// column.
const DEEPEST: usize = 21;

impl ScanReport {
    /// The report as text, with ANSI styles; print it through a stream that strips them if needed.
    /// With `only`, all details of that SubDevice and nothing else.
    pub fn text(&self, only: Option<usize>) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text, only);
        text
    }

    fn write(&self, out: &mut String, only: Option<usize>) -> fmt::Result {
        if let Some(device) = only.and_then(|only| self.devices.get(only)) {
            self.write_device(out, device, true)?;
            return self.write_notes(out, only);
        }
        let style = if self.consistent { GOOD } else { BAD };
        for line in wrap(&self.verdict, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        let objects = if self.objects_read { "objects read by SDO" } else { "objects not read" };
        let run =
            format!(": {objects}, {} frames sent, {} lost", self.frames_sent, self.frames_lost);
        let place = self.segment_file.as_ref().or(self.interface.as_ref());
        let place = cut_front(place.map_or("", |place| place), WIDTH - run.chars().count());
        writeln!(out, "{QUIET}{place}{run}{QUIET:#}")?;
        self.write_notes(out, None)?;
        if self.devices.is_empty() {
            return Ok(());
        }
        self.write_tree(out)?;
        self.write_table(out)?;
        if self.devices.len() <= MOST_IN_FULL {
            for device in &self.devices {
                writeln!(out)?;
                self.write_device(out, device, false)?;
            }
        }
        writeln!(out, "\n {QUIET}--device N tells all of one SubDevice, --json of all{QUIET:#}")
    }

    fn write_notes(&self, out: &mut String, only: Option<usize>) -> fmt::Result {
        let parts = [("Faults", &self.findings, true), ("Open questions", &self.doubts, false)];
        for (title, notes, in_verdict) in parts {
            let of = |note: &&Note| only.is_none_or(|only| note.position == Some(only));
            let notes: Vec<&Note> = notes.iter().filter(of).collect();
            let sentences = Note::sentences(notes.iter().copied());
            // The verdict has told a single fault.
            let told = in_verdict && only.is_none() && notes.len() == 1;
            if notes.is_empty() || told {
                continue;
            }
            writeln!(out, "\n{title}")?;
            let shown = if only.is_some() { sentences.len() } else { MOST_NOTES };
            for sentence in sentences.iter().take(shown) {
                for (i, line) in wrap(sentence, WIDTH - 4).iter().enumerate() {
                    writeln!(out, " {} {line}", if i == 0 { "-" } else { " " })?;
                }
            }
            if sentences.len() > shown {
                writeln!(out, " - and {} more; --json lists them all", sentences.len() - shown)?;
            }
        }
        Ok(())
    }

    fn write_tree(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\n {:<TREE$} {:>18} {:>10} {:>9} {:>8}",
            "topology", "delay, ns", "from above", "ppm", "0x092C"
        )?;
        writeln!(out, " MainDevice")?;
        let mut rows = Vec::new();
        match self.devices.iter().position(|device| device.parent.is_none()) {
            Some(first) if self.tree_known => self.line(first, "", false, &mut rows),
            _ => rows.extend((0..self.devices.len()).map(|at| ("? ".to_owned(), at))),
        }
        for (lead, at) in rows.iter().take(MOST_ROWS) {
            let device = &self.devices[*at];
            let name = format!("{lead}{at} {}", device.name);
            let clock = &device.clock;
            let reference = self.reference == Some(*at);
            writeln!(
                out,
                " {:<TREE$} {:>18} {:>10} {:>9} {:>8}",
                cut(&name, TREE),
                if reference { "reference".to_owned() } else { short_delay(&device.delay) },
                device.delay.from_parent_ns.map_or("-".to_owned(), |ns| format!("{ns:+.1}")),
                match clock.speed_ppm {
                    Some(_) if reference => "0".to_owned(),
                    Some(ppm) => format!("{ppm:+.2}"),
                    None => "-".to_owned(),
                },
                clock.system_time_difference_ns.map_or("-".to_owned(), |ns| format!("{ns} ns")),
            )?;
        }
        if rows.len() > MOST_ROWS {
            writeln!(out, " … and {} more; --json lists them all", rows.len() - MOST_ROWS)?;
        }
        let legend = match self.tree_known {
            true => {
                "\u{2193} hangs on the nearest SubDevice above in its own column, so a line stays flat; \u{251c}\u{2500} and \
                 \u{2514}\u{2500} hang on the nearest above in the next column to the left. [1>0]: from port 1 of that SubDevice \
                 into port 0. Delays from the reference clock, \u{b1} with a \
                 confidence of 95 %, from above with the branches that frames visit before. ppm: speed of the clock \
                 when nobody leads it, against the reference clock, by two latches of 0x0900"
            }
            false => "Who hangs on whom is not known: SubDevices stand in processing order",
        };
        for line in wrap(legend, WIDTH - 1) {
            writeln!(out, " {QUIET}{line}{QUIET:#}")?;
        }
        Ok(())
    }

    /// The rows of a SubDevice and all behind it. The last that hangs on a SubDevice goes on in the
    /// same column, so that a long line stays within the columns; the others are branches,
    /// indented. `lead` stands before these rows; with `more` another branch of the same SubDevice
    /// comes behind this one.
    fn line(&self, first: usize, lead: &str, more: bool, rows: &mut Vec<(String, usize)>) {
        let mut at = Some(first);
        while let Some(here) = at {
            let device = &self.devices[here];
            let sign = match (here == first, more) {
                (true, true) => "├─",
                (true, false) => "└─",
                (false, true) => "│↓",
                (false, false) => " ↓",
            };
            let above = device.parent_port.map_or(String::new(), |port| port.to_string());
            let entry = device.ports.iter().find(|port| port.entry).map_or(0, |port| port.port);
            // Where columns do not tell any more, the SubDevice above is named.
            let named = match device.parent.filter(|_| lead.chars().count() >= DEEPEST) {
                Some(parent) => format!("{parent}:"),
                None => String::new(),
            };
            rows.push((format!("{lead}{sign}[{named}{above}>{entry}] "), here));
            let mut branches = self.below(device);
            at = branches.pop();
            let deeper = match lead.chars().count() < DEEPEST {
                true => {
                    let goes_on = |goes_on: bool| if goes_on { '│' } else { ' ' };
                    format!("{lead}{}{} ", goes_on(more), goes_on(at.is_some()))
                }
                false => lead.to_owned(),
            };
            let last = branches.len().saturating_sub(1);
            for (number, branch) in branches.into_iter().enumerate() {
                self.line(branch, &deeper, number < last, rows);
            }
        }
    }

    /// The children of a SubDevice, in the order in which frames visit its ports.
    fn below(&self, device: &Device) -> Vec<usize> {
        let entry = device.ports.iter().find(|port| port.entry).map_or(0, |port| port.port);
        let first = ORDER.iter().position(|port| *port == entry).unwrap_or(0);
        let round = (1..4).map(|i| ORDER[(first + i) % 4]);
        round.filter_map(|port| device.ports.get(port)?.leads_to).collect()
    }

    fn write_table(&self, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "\n {:<3} {:<7} {:<32} {:<8} {:<9} {:<13} {:<6} state",
            "#", "address", "vendor:product revision", "alias", "ESC", "FMMU/SM/RAM", "DC"
        )?;
        let rows = fold(&self.devices, same_kind);
        for row in rows.iter().take(MOST_ROWS) {
            let device = &row[0];
            let esc = &device.esc;
            let resources = format!("{}/{}/{} KiB", esc.fmmus, esc.sync_managers, esc.ram_kib);
            let identity = format!(
                "{:#010x}:{:#010x} {:#010x}",
                device.vendor_id, device.product_code, device.revision
            );
            let place = match row.len() {
                1 => format!("{:<3} {:#06x}", device.position, device.station_address),
                _ => range(device.position, row[row.len() - 1].position),
            };
            writeln!(
                out,
                " {place:<11} {identity:<32} {:<8} {:<9} {resources:<13} {:<6} {}",
                device.alias.map_or("-".to_owned(), |alias| alias.to_string()),
                cut(&esc.kind_name, 9),
                match esc.dc.as_str() {
                    "receive-times" => "times",
                    other => other,
                },
                device.state.al_status,
            )?;
        }
        let more = rows.iter().skip(MOST_ROWS).map(|row| row.len()).sum::<usize>();
        if more > 0 {
            writeln!(out, " … and {more} more; --json lists them all")?;
        }
        if rows.len() < self.devices.len() {
            writeln!(
                out,
                "  {QUIET}equal devices side by side are one row; --json has each{QUIET:#}"
            )?;
        }
        Ok(())
    }
}

/// Whether two neighbours are the same in all that the table shows but their addresses.
fn same_kind(a: &Device, b: &Device) -> bool {
    let identity =
        |device: &Device| (device.vendor_id, device.product_code, device.revision, device.alias);
    identity(a) == identity(b)
        && a.esc == b.esc
        && a.state == b.state
        && a.station_address.wrapping_sub(b.station_address)
            == (a.position as u16).wrapping_sub(b.position as u16)
}

fn short_delay(delay: &Delay) -> String {
    match (delay.ns, delay.error_ns, delay.least_ns, delay.most_ns) {
        (Some(ns), Some(error), ..) => format!("{ns:.1} \u{b1}{error:.1}"),
        (_, _, Some(least), Some(most)) => format!("{least:.0} to {most:.0} ?"),
        _ if delay.unknown.is_some() => "unknown".to_owned(),
        _ => "-".to_owned(),
    }
}

/// Order in which frames pass the ports.
const ORDER: [usize; 4] = [0, 3, 1, 2];
