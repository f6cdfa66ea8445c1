//! Findings in sentences: what was found, and what to do about it.

use isocat_descriptions::quantity::time;
use isocat_sync::explain::{aborts, al_codes, objects};
use isocat_sync::object;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::register;

use crate::counters;
use crate::finding::Kind;

/// The sentence of a finding: `subject` is the device or the segment, `of` returns the name of a
/// device by its place.
pub(crate) fn what(kind: &Kind, subject: &str, of: impl Fn(usize) -> String) -> String {
    match kind {
        Kind::Breached(breach) => format!("{subject}: {breach}"),
        Kind::ClockSet { address, by_ns } => {
            let by = by_ns.map_or(String::new(), |by| format!(" by {}", signed(by)));
            format!("{} was changed{by} in operation", of_clock(*address, subject))
        }
        Kind::ClockSetEarly { address, by_ns } => format!(
            "{} was changed by {} more than that of the reference while SYNC0 was still on from before, and SYNC0 was not set up anew: it moved with the clock",
            of_clock(*address, subject),
            signed(*by_ns)
        ),
        Kind::LeftOp { to, code } => {
            format!("{subject} left OP for {} without a request", with_code(*to, *code))
        }
        Kind::AlError { asked, status, code, came_up } => {
            let asked = asked.map_or("another state".to_owned(), |state| state.to_string());
            let later = if *came_up { "; later it got there" } else { "" };
            format!(
                "{subject} was asked for {asked} and is in {}{later}",
                with_code(*status, *code)
            )
        }
        Kind::WorkingCounter { which, usual, lowest, frames, missing } => {
            let missing = match missing[..] {
                [] => String::new(),
                [one] => format!("; {} alone counts what is missing", of(one)),
                ref all => {
                    let names: Vec<String> = all.iter().rev().map(|place| of(*place)).collect();
                    format!("; together these count what is missing: {}", names.join(", "))
                }
            };
            format!(
                "the working counter of {} {:#010x} was down to {lowest} in {frames} frames, {usual} is usual{missing}",
                which.command, which.address
            )
        }
        Kind::DevicesVanished { from, to, silent } => {
            let silent: Vec<String> = silent.iter().map(|place| of(*place)).collect();
            let silent = match &silent[..] {
                [] => format!("; in a line SubDevice {to} is the first that is missing"),
                [one] => format!("; {one} does not answer any more"),
                all => format!("; these do not answer any more: {}", all.join(", ")),
            };
            format!("frames passed {}, before they passed {from}{silent}", subdevices(*to))
        }
        Kind::SilentToTheEnd { frames, for_ns } => format!(
            "nothing came back any more: {frames} cyclic frames in the last {} of the capture have no answer",
            ns(*for_ns)
        ),
        Kind::NothingCameBack { times, frames, for_ns } => {
            let again = match times {
                1 => String::new(),
                _ => format!("; so {times} times in all, this was the longest"),
            };
            format!(
                "no frame came back for {}: {frames} cyclic frames in a row have no answer{again}",
                ns(*for_ns)
            )
        }
        Kind::AskedDown { state, for_ns } => format!(
            "the MainDevice asked all SubDevices for {state}, and its process data went on for {} without them",
            ns(*for_ns)
        ),
        Kind::OpWithoutData { status, code, for_ns } => format!(
            "{subject} was asked for OP and is in {}: no process data came for {} meanwhile",
            with_code(*status, *code),
            ns(*for_ns)
        ),
        Kind::StayedBelow { status } => {
            format!("{subject} was asked for OP and stayed in {status}")
        }
        Kind::DeviceSilent {} => format!("{subject} does not answer any more"),
        Kind::FramesLost { count } => match count {
            1 => "1 cyclic frame has no answer in the capture".to_owned(),
            _ => format!("{count} cyclic frames have no answer in the capture"),
        },
        Kind::AnswersLate { count, longest_ns, cycle_ns } => format!(
            "{count} answers of cyclic frames came when the next cycle of {} had begun, up to {} after their frame: it began without these \
             inputs",
            ns(*cycle_ns),
            ns(*longest_ns)
        ),
        Kind::FramesDoubled { count } => {
            format!(
                "{count} answers of cyclic frames have no request in the capture: devices may have taken frames twice"
            )
        }
        Kind::SyncCounted { object, count } => format!(
            "{subject} counted {count} in {object} ({})",
            object::name(object.sub).unwrap_or("a counter")
        ),
        Kind::CyclesSkipped { count, longest_ns, cycle_ns } => format!(
            "{} longer than 1.5 cycles of {}, the longest {}, by the reference clock",
            intervals(*count, "cyclic frames"),
            ns(*cycle_ns),
            ns(*longest_ns)
        ),
        Kind::CyclesMissing { count, longest_ns, cycle_ns } => format!(
            "{} longer than 1.5 cycles of {}, the longest {}, by the reference clock: frames were lost or never sent",
            intervals(*count, "answers of cyclic frames"),
            ns(*cycle_ns),
            ns(*longest_ns)
        ),
        Kind::GapSeen { count, longest_ns, cycle_ns } => format!(
            "{} longer than 1.5 cycles of {}, the longest {}, by the stamps of the capture",
            intervals(*count, "cyclic frames"),
            ns(*cycle_ns),
            ns(*longest_ns)
        ),
        Kind::SyncPassed { frames, of, worst_ns } => format!(
            "{subject}: {frames} of {of} cyclic frames lay on the other side of SYNC0 than usual; the worst one ended {} {} SYNC0",
            time(worst_ns.unsigned_abs() as f64),
            if *worst_ns < 0 { "behind its" } else { "before the" }
        ),
        Kind::HostSlides { turns, ppm } => format!(
            "cyclic frames slide against SYNC0 by {:.1} us each second, through {} cycles in all: the MainDevice does not follow the reference clock",
            ppm.abs(),
            turns.abs()
        ),
        Kind::CopyTimeNotKept { least_ns, needed_ns } => format!(
            "{subject} needs {} to copy outputs (0x1C32:06) and had {} from the end of a frame to SYNC0",
            ns(*needed_ns),
            time(*least_ns as f64)
        ),
        Kind::CycleBelowMinimum { object, minimum_ns, cycle_ns } => format!(
            "{subject} needs a cycle of {} at least ({object}), and its SYNC unit gives it {}",
            ns(*minimum_ns),
            ns(*cycle_ns)
        ),
        Kind::StartInPast { late_ns } => format!(
            "{subject}: the start time (0x0990) had passed by {} when SYNC was switched on (0x0981)",
            ns(*late_ns)
        ),
        Kind::ClockFar { ahead_ns } => format!(
            "{subject}: its clock was {} {} the reference when SYNC was switched on: by that clock the start time (0x0990) is to come, \
             by the reference's it has passed; its offset (0x0920) is wrong",
            ns(ahead_ns.unsigned_abs()),
            if *ahead_ns < 0 { "behind" } else { "ahead of" }
        ),
        Kind::OtherDelay { written_ns, measured_ns } => format!(
            "{subject}: its propagation delay (0x0928) was written as {}, and by the receive times (0x0900) it is {}: its clock, and \
             SYNC0 with it, is off by the difference",
            ns(u64::from(*written_ns)),
            time(*measured_ns as f64)
        ),
        Kind::NoDriftFrames {} => {
            "SYNC0 runs, and no frame leads the clocks (FRMW or ARMW of 0x0910)".to_owned()
        }
        Kind::DriftFramesStopped { gap_ns } => {
            format!("for {} no frame led the clocks (FRMW or ARMW of 0x0910)", ns(*gap_ns))
        }
        Kind::ClocksApart { ns: apart } => format!(
            "{subject}: its clock was read {} from the reference (0x092C) in operation",
            ns(u64::from(*apart))
        ),
        Kind::ClocksNotConverged { ns: apart } => format!(
            "{subject}: its clock was {} from the reference (0x092C) when SYNC was switched on",
            ns(u64::from(*apart))
        ),
        Kind::ModeWithoutSync { object, mode } => {
            format!(
                "{subject}: {object} was written {mode}, and that SYNC signal is not switched on (0x0981)"
            )
        }
        Kind::SyncWithoutMode { object, mode } => {
            format!("{subject}: SYNC0 is switched on (0x0981), and {object} was written {mode}")
        }
        Kind::Sync0SwitchedOff {} => format!(
            "{subject}: SYNC0 was switched off (0x0981) while it was to stay in OP: its outputs act at no certain time, or it leaves OP"
        ),
        Kind::Sync0LeftOut { like } => format!(
            "{subject}: SYNC0 is off (0x0981), and runs at {}, which is the same device: outputs act at another time here",
            of(*like)
        ),
        Kind::WatchdogBelowCycle { watchdog_ns, cycle_ns } => format!(
            "{subject}: the process data watchdog of {} is not longer than the cycle of {}",
            ns(*watchdog_ns),
            ns(*cycle_ns)
        ),
        Kind::ErrorsCounted { address, by, operating } => format!(
            "{subject}: {} ({address:#06x}) grew by {by}{}{}",
            counters::name(*address).unwrap_or("a counter"),
            counters::port(*address).map_or(String::new(), |port| format!(" at port {port}")),
            if *operating { " in operation" } else { "" }
        ),
        Kind::AnotherTalker { first, other, frames } => {
            format!("{frames} frames are of {}, the others of {}", mac(*other), mac(*first))
        }
        Kind::CycleMismatch { frames_ns, cycle_ns } => format!(
            "{subject}: its SYNC unit has a cycle of {}, and frames come each {} by the reference clock",
            ns(*cycle_ns),
            ns(*frames_ns)
        ),
        Kind::SyncAfterSafeOp { state } => format!(
            "{subject}: SYNC was switched on in {state}; many devices decide on their mode on the way to SAFEOP"
        ),
        Kind::OffsetNotWritten {} => format!(
            "{subject}: SYNC was switched on, and its system time offset (0x0920) was not written on the way up"
        ),
        Kind::DelayNotWritten {} => format!(
            "{subject}: SYNC was switched on, and its propagation delay (0x0928) was not written on the way up"
        ),
        Kind::PortsSwapped {} => {
            format!("{subject} has no link at port 0 (0x0110), so frames come in at another one")
        }
        Kind::SyncNotLookedAt {} => format!(
            "{subject}: SYNC was switched on, and nothing looked whether it runs (0x0984, 0x0990)"
        ),
        Kind::SdoAborted { object, code, written, count } => format!(
            "{subject} refused to {} {object}: {code}{}",
            if *written { "take" } else { "tell" },
            more(*count, "aborts")
        ),
        Kind::MailboxSilent { object, count } => format!(
            "{subject}: the request for {object} has no answer before the next one{}",
            more(*count, "of these")
        ),
        Kind::MailboxEarly { object, count } => format!(
            "{subject}: the request for {object} was sent before PREOP was read (INIT was the last state), and had no answer in time{}",
            more(*count, "of these")
        ),
        Kind::MailboxStalled { object, for_ns } => format!(
            "{subject}: its mailbox does not answer any more: the request for {object} had no answer for {} in which it was looked for",
            ns(*for_ns)
        ),
        Kind::MailboxError { detail, count } => format!(
            "{subject} refused a mailbox message: {detail}{}",
            more(*count, "mailbox errors")
        ),
        Kind::Emergency { code, count } => {
            format!("{subject} sent emergency {code:#06x}{}", more(*count, "emergencies"))
        }
        Kind::ErrorFromBefore { status, code } => {
            format!(
                "{subject} was in an error state when it was first seen: {}",
                with_code(*status, *code)
            )
        }
        Kind::CountersFromBefore { count } => {
            format!("{subject}: {count} error counters were not zero when they were first read")
        }
        Kind::EepromSilent { count } => format!(
            "{subject}: no EEPROM answers: {count} reads in a row without an acknowledge (0x0502 bit 13), the last of the \
             capture"
        ),
        Kind::EepromWritten { count } => {
            format!("{subject}: its EEPROM was written, {count} words")
        }
    }
}

/// Remedies, likeliest first. Those for a code are what `isocat explain` says of it.
pub(crate) fn remedies(kind: &Kind) -> Vec<String> {
    let of_code = |code: &Option<AlStatusCode>| {
        let entry = code.and_then(al_codes::explain);
        entry.map(|entry| entry.change.iter().map(|one| (*one).to_owned()).collect::<Vec<_>>())
    };
    let own: &[&str] = match kind {
        Kind::Breached(breach) => breach.remedies(),
        Kind::LeftOp { code, .. }
        | Kind::AlError { code, .. }
        | Kind::ErrorFromBefore { code, .. } => match of_code(code) {
            Some(entry) if !entry.is_empty() => return entry,
            _ => {
                &["read 0x0134 (AL status code) when AL status shows an error, and acknowledge it"]
            }
        },
        Kind::SdoAborted { code, .. } => match aborts::explain(*code) {
            Some(entry) => return entry.change.iter().map(|one| (*one).to_owned()).collect(),
            None => &["the maker's manual says what this abort code means"],
        },
        Kind::WorkingCounter { .. } => &[
            "look at the devices that are named: their AL status, their power, the cable before them",
            "take inputs of a frame with a low working counter as old",
        ],
        Kind::SilentToTheEnd { .. } => &[
            "look at the power of the first device, and at the cable between the MainDevice and it",
            "isocat scan --interface IF --rescue finds the place port by port: it closes ports until frames come back, and names \
             the one behind which the line is dead",
            "look whether the capture's own interface has a link",
        ],
        Kind::NothingCameBack { .. } => &[
            "look at the link of the MainDevice's port, the first cable and the power of the first device; or one way of a cable further on is dead while both ends keep their links",
            "isocat scan --interface IF --rescue names the port behind which the line is dead",
        ],
        Kind::AskedDown { .. } => &[
            "do not scan or set up anew while the segment operates: that asks all SubDevices for INIT",
            "bring them up again before process data go on, or end the exchange",
        ],
        Kind::OpWithoutData { .. } => &[
            "send process data in every cycle before OP is asked for, and go on with them while AL status is read: on the way to OP a device waits \
             for outputs and gives up after some seconds",
        ],
        Kind::StayedBelow { .. } => &[
            "read 0x0134 (AL status code): a device that waits for SYNC0 or for outputs says so after some seconds",
            "compare start time (0x0990), cycle (0x09A0) and shift of its SYNC0 with the cycle of the frames",
        ],
        Kind::DevicesVanished { .. } | Kind::DeviceSilent {} => &[
            "look at the power of the device that is named and at the cable before it",
            "read lost links (0x0310) and DL status (0x0110) of the last device that still answers",
        ],
        Kind::FramesLost { .. } => &[
            "read the error counters (0x0300 to 0x0313): the first port that counts is behind the place",
            "if they stay 0, the capture or the network card lost them: compare its counters",
        ],
        Kind::AnswersLate { .. } => &[
            "look at the network card of the MainDevice: coalescing (ethtool -C INTERFACE rx-usecs 0), power saving, a USB adapter",
            "isocat run --interface IF --preflight names what harms punctuality on a Linux machine",
        ],
        Kind::FramesDoubled { .. } => &["look for a switch or a loop-back that repeats frames"],
        Kind::SyncCounted { object, .. } => {
            let entry = objects::sub_index(*object).map(|(_, entry)| entry.change);
            return entry.unwrap_or(&[]).iter().map(|one| (*one).to_owned()).collect();
        }
        Kind::CyclesSkipped { .. } => &[
            "look at what held the MainDevice's cyclic task: priority, other tasks, power management",
            "isocat run --interface IF --preflight names what harms punctuality on a Linux machine",
        ],
        Kind::CyclesMissing { .. } => &[
            "take the capture where both directions pass: it tells lost frames from such that were never sent",
        ],
        Kind::GapSeen { .. } => &[
            "take the drift datagram (FRMW of 0x0910) into the cyclic frame: its time tells what stamps can't",
            "capture with hardware stamps",
        ],
        Kind::SyncPassed { .. } => &[
            "move SYNC0 (the start time, 0x0990) away from the frames, or send the frames earlier",
            "let the MainDevice's cycle follow the reference clock",
        ],
        Kind::HostSlides { .. } => &[
            "let the MainDevice's cycle follow the reference clock: correct its timer by the time that FRMW brings",
        ],
        Kind::CopyTimeNotKept { .. } => &[
            "move SYNC0 (the start time, 0x0990) later, or send the frames earlier",
            "make frames shorter, or the cycle longer",
        ],
        Kind::CycleBelowMinimum { .. } => {
            &["take a longer cycle", "let the device have a slower cycle of its own"]
        }
        Kind::ClockSet { .. } => {
            &["leave offset and delay alone while SYNC0 runs: drift frames keep the clock"]
        }
        Kind::StartInPast { .. } => &[
            "read the reference's system time just before, and take a start time 100 ms later",
            "write the start time after the offsets (0x0920) have taken effect",
        ],
        Kind::ClockSetEarly { .. } => &[
            "switch SYNC off (0x0981 = 0, by broadcast) before devices are set up anew, and write start time and cycle again behind the offset",
        ],
        Kind::ClockFar { .. } => &[
            "write 0x0920 of each device from its receive time (0x0918) and the time there should be, before SYNC is switched on",
            "leave offsets alone from then on until SYNC is off",
        ],
        Kind::OtherDelay { .. } => &[
            "measure the delays anew: latch receive times (write 0x0900), compute, and write 0x0928 of each device before SYNC is switched on",
            "look whether the MainDevice takes the ports in their order (0, 3, 1, 2)",
        ],
        Kind::NoDriftFrames {} | Kind::DriftFramesStopped { .. } => {
            &["send FRMW of 0x0910 to the reference in each cycle"]
        }
        Kind::ClocksApart { .. } => &[
            "send drift frames in each cycle, and check the delays (0x0928)",
            "wait until 0x092C is small before SYNC is switched on",
        ],
        Kind::ClocksNotConverged { .. } => {
            &["wait until 0x092C of each device is small before SYNC is switched on"]
        }
        Kind::ModeWithoutSync { .. } => &[
            "write 0x0980/0x0981 (AssignActivate) as the device's description says, before SAFEOP",
        ],
        Kind::SyncWithoutMode { .. } => {
            &["write 0x1C32:01 and 0x1C33:01 as the mode needs, or leave SYNC off"]
        }
        Kind::Sync0SwitchedOff {} => &[
            "leave 0x0981 as it is until the device is asked for PREOP, and look for who writes it",
        ],
        Kind::Sync0LeftOut { .. } => &[
            "write 0x09A0, 0x0990, then 0x0980 and 0x0981 in PREOP, as at the other one, if both are to act at one instant",
        ],
        Kind::WatchdogBelowCycle { .. } => {
            &["make the watchdog (0x0400, 0x0420) longer than some cycles"]
        }
        Kind::ErrorsCounted { .. } => &[
            "look at the cable and the plugs at that port, and at what is at its other end",
            "read all counters twice: the first device in line that counts invalid frames is behind the place",
        ],
        Kind::AnotherTalker { .. } => {
            &["one MainDevice alone may talk on a segment: find the other one"]
        }
        Kind::CycleMismatch { .. } => &[
            "let the cycle of the frames be that of SYNC0 (0x09A0), a whole multiple or a whole part of it",
            "let the MainDevice's cycle follow the reference clock",
        ],
        Kind::SyncAfterSafeOp { .. } => {
            &["write 0x09A0, 0x0990 and 0x0981 in PREOP, then ask for SAFEOP"]
        }
        Kind::OffsetNotWritten {} => &[
            "write 0x0920 of each device from its receive time (0x0918) and the time there should be",
        ],
        Kind::DelayNotWritten {} => {
            &["latch receive times (write 0x0900) and write 0x0928 of each device"]
        }
        Kind::PortsSwapped {} => &[
            "plug the cable that comes from the MainDevice into the port that is marked IN",
            "delays that a MainDevice computes for the order of ports 0, 3, 1, 2 are wrong until then",
        ],
        Kind::SyncNotLookedAt {} => {
            &["read 0x0984 after the start time: bit 0 is clear once the first pulse has come"]
        }
        Kind::MailboxSilent { .. } => &["poll the mailbox (SM1) until the answer is there"],
        Kind::MailboxEarly { .. } => {
            &["wait until AL status (0x0130) says PREOP before the mailbox is used, not for a time"]
        }
        Kind::MailboxStalled { .. } => &[
            "switch its power off and on: a mailbox that stalled in the device's program seldom comes back by itself",
            "ask its maker for a firmware that serves the mailbox, if it stalls again",
        ],
        Kind::MailboxError { .. } => {
            &["compare the message with what the device's mailbox can take"]
        }
        Kind::Emergency { .. } => &["the maker's manual says what the emergency code means"],
        Kind::CountersFromBefore { .. } => &["clear them (write 0x0300) and read them again later"],
        Kind::EepromSilent { .. } => &[
            "the EEPROM is missing or dead, or its bus is held low: look at its supply, SCL and SDA on the board",
            "replace the device, or write the maker's image (`isocat sii --from FILE --type TYPE --out OUT`) to a new EEPROM",
        ],
        Kind::EepromWritten { .. } => &[],
    };
    own.iter().map(|one| (*one).to_owned()).collect()
}

/// `the offset of the clock of SubDevice 1 (0x0920)`.
fn of_clock(address: u16, subject: &str) -> String {
    let what = if address == register::SYSTEM_TIME_DELAY.address { "delay" } else { "offset" };
    format!("the {what} of the clock of {subject} ({address:#06x})")
}

fn signed(by_ns: i64) -> String {
    format!("{}{}", if by_ns < 0 { "-" } else { "" }, ns(by_ns.unsigned_abs()))
}

fn with_code(status: AlStatus, code: Option<AlStatusCode>) -> String {
    match code {
        Some(code) => format!("{status}, AL status code {code}"),
        None if status.error() => format!("{status}; its AL status code is not in the capture"),
        None => status.to_string(),
    }
}

/// `1 SubDevice`, `3 SubDevices`.
pub(crate) fn subdevices(count: u16) -> String {
    format!("{count} SubDevice{}", if count == 1 { "" } else { "s" })
}

/// `1 interval between cyclic frames is`.
fn intervals(count: u64, between: &str) -> String {
    match count {
        1 => format!("1 interval between {between} is"),
        _ => format!("{count} intervals between {between} are"),
    }
}

fn more(count: u64, what: &str) -> String {
    match count {
        0 | 1 => String::new(),
        count => format!(" ({count} {what} in all)"),
    }
}

/// A span of time.
pub(crate) fn ns(ns: u64) -> String {
    time(ns as f64)
}

/// An address of the data link.
pub(crate) fn mac(address: [u8; 6]) -> String {
    address.map(|octet| format!("{octet:02x}")).join(":")
}
