//! The document as text: the verdict first, then what went wrong in the segment, then what is known
//! of it.

use std::fmt::{self, Write};

use anstyle::{AnsiColor, Style};
use isocat_descriptions::columns::{WIDTH, cut, wrap};
use isocat_descriptions::quantity::time;
use isocat_sync::object::sub;

use super::device::mode;
use super::{
    DeviceReport, DiagnoseReport, FindingReport, RhythmReport, SeenKind, SureKind, SyncSwitch,
    VerdictKind, WeightKind,
};
use crate::words;

const GOOD: Style = AnsiColor::Green.on_default().bold();
const BAD: Style = AnsiColor::Red.on_default().bold();
const DOUBT: Style = AnsiColor::Yellow.on_default().bold();
const QUIET: Style = Style::new().dimmed();

impl DiagnoseReport {
    /// The report as text with ANSI styles.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let style = match self.verdict.kind {
            VerdictKind::InSync | VerdictKind::InOperation => GOOD,
            VerdictKind::NothingFound => DOUBT,
            VerdictKind::Found => BAD,
        };
        for line in wrap(&self.verdict.sentence, WIDTH) {
            writeln!(out, "{style}{line}{style:#}")?;
        }
        self.write_claims(out)?;
        self.write_captures(out)?;
        self.write_findings(out)?;
        self.write_around(out)?;
        self.write_devices(out)?;
        self.write_states(out)?;
        self.write_clock(out)?;
        self.write_cycle(out)?;
        self.write_mailboxes(out)?;
        if !self.unknown.is_empty() {
            writeln!(out, "\nNot known")?;
            for what in &self.unknown {
                paragraph(out, "  ", what)?;
            }
        }
        Ok(())
    }

    fn write_claims(&self, out: &mut String) -> fmt::Result {
        let Some(claims) = &self.claims else { return Ok(()) };
        let not = claims.not_checked.len();
        let rest = if not == 0 { String::new() } else { format!(", {not} could not be") };
        let what = format!("{} claims about the segment were checked{rest}", claims.checked);
        writeln!(out, "{QUIET}{what}{QUIET:#}")
    }

    fn write_captures(&self, out: &mut String) -> fmt::Result {
        for capture in &self.captures {
            writeln!(out, "{QUIET}{}: {} packets{QUIET:#}", capture.name, capture.packets)?;
            if let Some(why) = &capture.ended {
                paragraph(out, "  ", &format!("not read to its end: {why}"))?;
            }
        }
        let cut: usize = self.captures.iter().map(|one| one.cut + one.other_links).sum();
        let frames = &self.frames;
        let others = [
            (frames.unanswered, "requests without answer"),
            (frames.answers_alone, "answers without request"),
            (frames.duplicates, "there twice"),
            (frames.elsewhere, "of other interfaces"),
            (frames.foreign, "of other protocols"),
            (frames.broken + cut, "cut off or broken"),
            (
                usize::try_from(frames.backwards).unwrap_or(usize::MAX),
                "stamped before an earlier one",
            ),
        ];
        let others = others.iter().filter(|(count, _)| *count > 0);
        let others: String = others.map(|(count, what)| format!(", {count} {what}")).collect();
        let span = time(frames.span_ns as f64);
        paragraph(out, "", &format!("{} frames out and back{others}, in {span}", frames.pairs))?;
        let Some(tap) = &self.tap else { return Ok(()) };
        let place = match tap.behind {
            0 => "at the MainDevice's port".to_owned(),
            1 => "behind the first SubDevice".to_owned(),
            behind => format!("behind {behind} SubDevices"),
        };
        let seen = match tap.seen {
            SeenKind::Both => "both directions",
            SeenKind::Out => "frames on their way out alone",
            SeenKind::Back => "frames on their way back alone",
        };
        let mark = match tap.marked {
            true => "",
            false => "; answers were told by their datagrams, not by the source address",
        };
        let ring = match tap.ring {
            true => " It has both ends of a ring; frames of the second port are left out.",
            false => "",
        };
        let reach = match &self.reach[..] {
            [] => String::new(),
            [all @ .., last] => {
                let changes = match all.len() {
                    0 => String::new(),
                    times => format!(", after {times} changes"),
                };
                format!(" Frames passed {}{changes}.", words::subdevices(last.subdevices))
            }
        };
        paragraph(
            out,
            "",
            &format!("The capture was taken {place} and has {seen}{mark}.{ring}{reach}"),
        )
    }

    fn write_findings(&self, out: &mut String) -> fmt::Result {
        for (weight, head) in [
            (WeightKind::Fault, "Faults"),
            (WeightKind::Warning, "Warnings"),
            (WeightKind::Note, "Notes"),
        ] {
            let of_weight: Vec<&FindingReport> =
                self.findings.iter().filter(|one| one.weight == weight).collect();
            if of_weight.is_empty() {
                continue;
            }
            writeln!(out, "\n{head}")?;
            for finding in of_weight {
                self.write_finding(out, finding)?;
            }
        }
        Ok(())
    }

    fn write_finding(&self, out: &mut String, finding: &FindingReport) -> fmt::Result {
        let style = match finding.weight {
            WeightKind::Fault => BAD,
            WeightKind::Warning => DOUBT,
            WeightKind::Note => QUIET,
        };
        let at = finding.at_ns.map_or(String::new(), |at| format!(" at {}", seconds(at)));
        let sure = match finding.sure {
            SureKind::Shown => "",
            SureKind::Likely => ", likely",
        };
        writeln!(
            out,
            "  {style}{}{style:#} {QUIET}{}{at}{sure}{QUIET:#}",
            finding.kind,
            self.frame(finding.frame)
        )?;
        paragraph(out, "    ", &finding.what)?;
        if !finding.evidence.is_empty() {
            let frames: Vec<String> =
                finding.evidence.iter().map(|frame| self.frame(*frame)).collect();
            paragraph(out, "    see also ", &frames.join(", "))?;
        }
        if finding.weight == WeightKind::Fault {
            for remedy in &finding.remedies {
                paragraph(out, "    -> ", remedy)?;
            }
        }
        Ok(())
    }

    /// Writes frames, times and descriptions of the moments around the first fault.
    fn write_around(&self, out: &mut String) -> fmt::Result {
        let Some(around) = &self.around else { return Ok(()) };
        writeln!(out, "\nAround the first fault (frames, ms by the stamps, what they say)")?;
        for moment in &around.moments {
            let first = moment.request.or(moment.answer).unwrap_or(moment.last);
            let frames = match first.frame == moment.last.frame {
                true => first.frame.to_string(),
                false => format!("{}-{}", first.frame, moment.last.frame),
            };
            let times = match moment.times {
                1 => String::new(),
                times => format!("{times} times "),
            };
            let found = match &moment.findings[..] {
                [] => String::new(),
                kinds => format!("  <- {}", kinds.join(", ")),
            };
            let at = moment.at_ns as f64 / 1e6;
            let head = format!("  {frames:<13} {at:>9.3}  ");
            let lines = wrap(&format!("{times}{}{found}", moment.what), WIDTH - head.len());
            let style = if moment.at_ns == 0 && !found.is_empty() { BAD } else { Style::new() };
            for (number, line) in lines.iter().enumerate() {
                let head = if number == 0 { head.clone() } else { " ".repeat(head.len()) };
                writeln!(out, "{head}{style}{line}{style:#}")?;
            }
        }
        Ok(())
    }

    fn write_devices(&self, out: &mut String) -> fmt::Result {
        if self.devices.is_empty() {
            return writeln!(out, "\nNo SubDevice answered.");
        }
        writeln!(
            out,
            "\n  # station name                     vendor     product    ESC      state       offset delay"
        )?;
        for device in &self.devices {
            let position = device.position.map_or("?".to_owned(), |at| at.to_string());
            let station = device.station.as_ref().map(|at| format!("{:#06x}", at.value));
            let hex = |known: &Option<super::Shown<u32>>| {
                known.as_ref().map_or("?".to_owned(), |known| format!("{:#010x}", known.value))
            };
            let esc = device.esc.name.map(str::to_owned);
            let esc = esc.or(device.esc.kind.as_ref().map(|kind| format!("{:#04x}", kind.value)));
            let delay = device.delay_ns.as_ref().map(|delay| time(f64::from(delay.value)));
            writeln!(
                out,
                "{position:>3} {:<7} {:<24} {:<10} {:<10} {:<8} {:<11} {:<6} {}",
                station.unwrap_or("?".to_owned()),
                device.name.as_deref().map_or("?".to_owned(), |name| cut(name, 24)),
                hex(&device.identity.vendor),
                hex(&device.identity.product),
                esc.unwrap_or("?".to_owned()),
                device.state.as_deref().unwrap_or("?"),
                if device.offset_ns.is_some() { "set" } else { "?" },
                delay.unwrap_or("?".to_owned()),
            )?;
        }
        Ok(())
    }

    fn write_states(&self, out: &mut String) -> fmt::Result {
        if self.devices.iter().all(|device| device.states.is_empty()) {
            return Ok(());
        }
        writeln!(out, "\nStates, as they were read")?;
        for device in &self.devices {
            let list: Vec<String> = device
                .states
                .iter()
                .take(MOST_STATES)
                .map(|seen| {
                    let code = seen.code.filter(|code| *code != 0);
                    let code = code.map_or(String::new(), |code| format!(" {code:#06x}"));
                    format!("{}{code} (frame {})", seen.status, seen.frame.frame)
                })
                .collect();
            let more = device.states.len().saturating_sub(MOST_STATES);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            if !list.is_empty() {
                paragraph(out, &format!("  {}: ", device.title()), &(list.join(", ") + &more))?;
            }
        }
        Ok(())
    }

    fn write_clock(&self, out: &mut String) -> fmt::Result {
        if let Some(clock) = &self.clock {
            let reference = clock.reference.and_then(|place| self.devices.get(place));
            let leader = reference.map_or(format!("address {:#06x}", clock.address), |d| d.title());
            let gap = clock.longest_gap_ns.map_or(String::new(), |gap| {
                format!("; {} without one at most in operation", time(gap as f64))
            });
            writeln!(out, "\nClocks")?;
            let drift = format!(
                "{leader} leads: {} {} of 0x0910, {} bytes, frames {} to {}{gap}",
                clock.frames, clock.command, clock.bytes, clock.first.frame, clock.last.frame
            );
            paragraph(out, "  ", &drift)?;
        }
        for device in &self.devices {
            for sync in &device.sync {
                let what = format!("{} ({})", switched(sync), self.frame(sync.frame));
                paragraph(out, &format!("  {}: ", device.title()), &what)?;
            }
            if let Some(distance) = &device.distance {
                let what = format!(
                    "{} cyclic frames ended {} to {} before SYNC0 ({} on average), by {}",
                    distance.frames,
                    time(distance.shortest_ns.value as f64),
                    time(distance.longest_ns.value as f64),
                    time(distance.mean_ns as f64),
                    match distance.within_ns {
                        0 => "the reference's time".to_owned(),
                        within => format!(
                            "the reference's time in other frames and the stamps since then, which are within {}",
                            time(within as f64)
                        ),
                    },
                );
                paragraph(out, &format!("  {}: ", device.title()), &what)?;
            }
            if let Some(last) = &device.difference_ns {
                let worst = device.worst_difference_ns.as_ref().map_or(String::new(), |worst| {
                    format!(", {} at most in operation", time(f64::from(worst.value)))
                });
                let what = format!(
                    "0x092C read {} times, {} at last (frame {}){worst}",
                    device.differences,
                    time(f64::from(last.value)),
                    last.frame.frame
                );
                paragraph(out, &format!("  {}: ", device.title()), &what)?;
            }
        }
        Ok(())
    }

    fn write_cycle(&self, out: &mut String) -> fmt::Result {
        let Some(cycle) = &self.cycle else { return Ok(()) };
        writeln!(out, "\nCyclic exchange")?;
        for (rhythm, by) in
            [(&cycle.by_clock, "by the reference clock"), (&cycle.by_stamps, "by the stamps")]
        {
            if let Some(rhythm) = rhythm {
                paragraph(out, "  ", &self.rhythm(rhythm, by))?;
            }
        }
        if let Some(took) = &cycle.round_trip {
            // Stamps lie about where a capture begins or ends to hold a frame.
            let machine = cycle.on_wire_ns.filter(|on_wire| took.median_ns > MACHINE * on_wire);
            let machine = machine.map_or(String::new(), |on_wire| {
                format!(
                    "; the wire takes {} of that at most, the rest is the machine's: its network driver, coalescing (ethtool -C \
                     INTERFACE rx-usecs 0), power saving, or a switch between",
                    time(on_wire as f64)
                )
            });
            let text = format!(
                "answers came {} after their frame, 99 % below {}, the last {} ({}){machine}",
                time(took.median_ns as f64),
                time(took.most_99_ns as f64),
                time(took.longest_ns.value as f64),
                self.frame(took.longest_ns.frame)
            );
            paragraph(out, "  ", &text)?;
        }
        for one in cycle.transmissions.iter().take(MOST_TRANSMISSIONS) {
            let usual = one.usual_working_counter.map_or("not seen".to_owned(), |n| n.to_string());
            let computed = match (one.usual_working_counter, one.computed_working_counter) {
                (Some(usual), Some(computed)) if usual != computed => {
                    format!(" (by the FMMUs {computed})")
                }
                _ => String::new(),
            };
            let mut text = format!(
                "{} {:#010x}, {} bytes: {} frames from frame {} on, working counter {usual}{computed}",
                one.command, one.address, one.bytes, one.frames, one.first.frame
            );
            if one.low > 0 {
                let _ = write!(text, ", lower in {}", one.low);
            }
            if one.lost > 0 {
                let _ = write!(text, ", {} without answer", one.lost);
            }
            paragraph(out, "  ", &text)?;
        }
        let more = cycle.transmissions.len().saturating_sub(MOST_TRANSMISSIONS);
        if more > 0 {
            writeln!(out, "  and {more} more; --json has them")?;
        }
        Ok(())
    }

    fn rhythm(&self, rhythm: &RhythmReport, by: &str) -> String {
        format!(
            "{} cycles of {}, {by}: {} to {} ({}, {}), 99 % below {}",
            rhythm.count,
            time(rhythm.median_ns as f64),
            time(rhythm.shortest_ns.value as f64),
            time(rhythm.longest_ns.value as f64),
            self.frame(rhythm.shortest_ns.frame),
            self.frame(rhythm.longest_ns.frame),
            time(rhythm.most_99_ns as f64)
        )
    }

    fn write_mailboxes(&self, out: &mut String) -> fmt::Result {
        if self.devices.iter().all(|device| device.mailbox.is_none()) {
            return Ok(());
        }
        writeln!(out, "\nMailboxes")?;
        for device in &self.devices {
            let Some(mailbox) = &device.mailbox else { continue };
            let [to, from] = mailbox.messages;
            let aborts: usize = mailbox.aborts.iter().map(|abort| abort.count).sum();
            let how = if mailbox.by_content { ", known by their content" } else { "" };
            let slowest = mailbox.slowest.as_ref().map_or(String::new(), |slowest| {
                let took = time(slowest.took_ns as f64);
                format!(", the slowest answer after {took} ({})", slowest.object)
            });
            let what = format!(
                "{to} messages to it, {from} from it{how}: {} SDO transfers{slowest}, {aborts} aborts{}",
                mailbox.transfers,
                sync_objects(device)
            );
            paragraph(out, &format!("  {}: ", device.title()), &what)?;
        }
        Ok(())
    }
}

/// The effect of a switch of a SYNC unit.
pub(super) fn switched(sync: &SyncSwitch) -> String {
    let word = sync.assign_activate;
    if word & 0xFF00 == 0 {
        return format!("SYNC off, {word:#06x}");
    }
    let mut text = format!("SYNC {word:#06x}: {}", sync.words.join(", "));
    if let Some(cycle) = &sync.sync0_cycle_ns {
        let _ = write!(text, "; SYNC0 each {}", time(f64::from(cycle.value)));
    }
    if let Some(cycle) = sync.sync1_cycle_ns.as_ref().filter(|_| word & 0x0400 != 0) {
        let _ = write!(text, ", SYNC1 {} behind it", time(f64::from(cycle.value)));
    }
    if let Some(start) = &sync.start_ns {
        let bits = sync.start_bytes.map_or(0, |bytes| bytes * 8);
        let _ = write!(text, "; start {} ({bits} bits)", start.value);
    }
    match sync.ahead_ns {
        Some(ahead @ 0..) => {
            let _ = write!(text, ", {} ahead", time(ahead as f64));
        }
        Some(passed) => {
            let _ = write!(text, ", passed by {}", time(-passed as f64));
        }
        None => {}
    }
    text
}

/// The synchronization type and the times that the device reported.
fn sync_objects(device: &DeviceReport) -> String {
    let mut text = String::new();
    if let Some(mode) = mode(device) {
        let _ = write!(text, "; 0x1C32:01 is {mode}");
    }
    let objects = device.mailbox.iter().flat_map(|mailbox| &mailbox.sync_objects);
    for object in objects.filter(|object| !object.written && is_time(object.sub)) {
        let name = object.name.unwrap_or("");
        let _ = write!(text, ", {} ({name}) {}", object.object, time(object.value as f64));
    }
    text
}

/// Whether the entry is a time that the cycle has to fit.
fn is_time(sub: u8) -> bool {
    matches!(sub, sub::MINIMUM_CYCLE_TIME | sub::CALC_AND_COPY_TIME | sub::DELAY_TIME)
}

/// Writes a text after its head; further lines are indented by two columns more than the head, if
/// the head has words.
fn paragraph(out: &mut String, head: &str, text: &str) -> fmt::Result {
    let words = head.trim_start();
    let indent = head.len() - words.len();
    let hang = if words.is_empty() { indent } else { indent + 2 };
    let lines = wrap(&format!("{words}{text}"), WIDTH - hang);
    for (number, line) in lines.iter().enumerate() {
        let indent = if number == 0 { indent } else { hang };
        writeln!(out, "{:indent$}{line}", "")?;
    }
    Ok(())
}

/// An instant of the capture, in seconds.
fn seconds(ns: u64) -> String {
    format!("{}.{:06} s", ns / 1_000_000_000, ns / 1000 % 1_000_000)
}

/// Statuses of a device that the text shows.
const MOST_STATES: usize = 12;
/// How many times as long as what the wire takes answers may take before the machine is named.
const MACHINE: u64 = 5;
/// Logical datagrams that the text shows.
const MOST_TRANSMISSIONS: usize = 16;
