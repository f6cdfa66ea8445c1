//! Alarm numbers of drive makers, as a display shows them.
//!
//! Two makers may mean different things by one number, so that every answer names the maker, and
//! says that the manual decides. Only numbers that public manuals explain are here.

use isocat_sync::explain::Entry;

use super::super::{Meaning, of};
use super::causes::entry;

/// A number that public documents explain.
struct Alarm {
    /// Ways to write it, in lower case and without signs, blanks and a leading "err" or "er".
    codes: &'static [&'static str],
    maker: &'static str,
    entry: &'static Entry,
}

/// The meanings of a number that stands alone: what public manuals say, or else that it is the
/// maker's. Empty if it does not look like an alarm number.
pub(in super::super) fn alone(text: &str) -> Vec<Meaning> {
    if !is_alarm(text) {
        return Vec::new();
    }
    let mut all = known(text);
    if all.is_empty() {
        all.push(of("number of a maker", text.to_owned(), "of a drive's maker", &UNKNOWN));
    }
    all
}

/// A bare number that no table has: a drive's number too, rather than nothing.
pub(in super::super) fn bare(text: &str) -> Option<Meaning> {
    let digits = text.chars().all(|c| c.is_ascii_digit());
    let looks = digits && text.len() == 4;
    looks.then(|| of("number of a maker", text.to_owned(), "of a drive's maker", &UNKNOWN))
}

/// The alarm numbers within a line: those that follow a word such as "fault", and numbers with a
/// letter that public manuals explain, where the line speaks of a drive.
pub(super) fn within(line: &str) -> Vec<Meaning> {
    let lower = line.to_lowercase();
    let speaks_of_drives = DRIVES.iter().any(|word| lower.contains(word));
    let words = line.split([' ', ',', ';', '(', ')', '"', '\'', '[', ']', '=', ':']);
    let words: Vec<&str> = words
        .map(|word| word.trim_matches(|c: char| !c.is_alphanumeric()))
        .filter(|word| !word.is_empty())
        .collect();
    let mut all = Vec::new();
    for (i, word) in words.iter().enumerate() {
        let last = i.checked_sub(1).map(|last| words[last].to_lowercase()).unwrap_or_default();
        let has_letter = word.starts_with(|c: char| c.is_ascii_alphabetic());
        // "error 50000 ns" is no alarm.
        let follows = BEFORE_AN_ALARM.contains(&last.as_str())
            && (has_letter || !["error", "code"].contains(&last.as_str()));
        let certain = || has_letter && !known(word).is_empty();
        if is_alarm(word) && (follows || certain() && (speaks_of_drives || word.len() > 4)) {
            all.extend(alone(word));
        }
    }
    all
}

/// Words of a line that speaks of a drive.
const DRIVES: [&str; 7] = ["alarm", "fault", "display", "drive", "servo", "axis", "antrieb"];

/// Words after which an alarm number follows.
const BEFORE_AN_ALARM: [&str; 13] = [
    "alarm", "fault", "error", "err", "display", "displays", "shows", "warning", "code", "fehler",
    "störung", "zeigt", "says",
];

/// What public manuals say of a number; empty if none does.
pub(super) fn known(text: &str) -> Vec<Meaning> {
    let plain = plain(text);
    let same = |alarm: &&Alarm| alarm.codes.contains(&plain.as_str());
    let found = ALARMS.iter().filter(same);
    found.map(|alarm| of("number of a maker", text.to_owned(), alarm.maker, alarm.entry)).collect()
}

/// The number in lower case, without signs and without "err".
fn plain(text: &str) -> String {
    let lower = text.to_lowercase();
    let letters: String = lower.chars().filter(|c| c.is_ascii_alphanumeric()).collect();
    let stem =
        ["error", "err", "alarm", "fault"].iter().find_map(|stem| letters.strip_prefix(stem));
    let stem = stem
        .or_else(|| (lower.starts_with("er.") || lower.starts_with("er ")).then(|| &letters[2..]));
    stem.unwrap_or(&letters).to_owned()
}

/// Whether it is written as an alarm number is: a letter and digits (`F414`, `Er.E08`, `A.A12`),
/// two groups of digits (`88.0`), five digits, or four hex digits in the makers' range (`8303`).
fn is_alarm(text: &str) -> bool {
    let digits = |text: &str, most: usize| {
        !text.is_empty() && text.len() <= most && text.chars().all(|c| c.is_ascii_digit())
    };
    let counts = text.chars().any(|c| c.is_ascii_digit());
    if text.len() == 4 && counts && text.chars().all(|c| c.is_ascii_hexdigit()) {
        return u16::from_str_radix(text, 16).is_ok_and(|value| value >= 0x8000);
    }
    if digits(text, 5) && text.len() == 5 {
        return true;
    }
    if let Some((group, rest)) = text.split_once('.')
        && digits(group, 3)
        && group.len() >= 2
    {
        return digits(rest, 2);
    }
    let lower = text.to_lowercase();
    let body = PREFIXES.iter().find_map(|prefix| lower.strip_prefix(prefix)).unwrap_or(&lower);
    let body = body.trim_start_matches(['.', '-', '_', ' ']);
    let letters = body.chars().take_while(char::is_ascii_alphabetic).count();
    let marked = body.len() < lower.len();
    let (head, tail) = body.split_at(letters);
    let (number, point) = tail.split_once(['.', '-']).unwrap_or((tail, "0"));
    let hexadecimal = number.chars().all(|c| c.is_ascii_hexdigit());
    let counted =
        (2..=5).contains(&number.len()) && number.starts_with(|c: char| c.is_ascii_digit());
    let is_prefix = marked && head.len() <= 1 || !marked && head.len() == 1 || head == "ee";
    is_prefix && head != "x" && counted && hexadecimal && digits(point, 2)
}

/// What may stand before the number on a display.
const PREFIXES: [&str; 9] = ["error", "err", "er.", "er ", "al.", "alm", "al", "a.", "e."];

static UNKNOWN: Entry = entry(
    "A drive's own alarm number: it is no AL status code, and no standard says what it means. Two \
     makers may mean different things by it. The drive's manual has it in the list of alarms.",
    &[
        "a fault of the drive itself: supply, motor, encoder, limits",
        "what the drive makes of a lost synchronization, a lost link or an expired watchdog",
    ],
    &[
        "the drive's manual: which maker, and what the number says",
        "0x0134: the AL status code that belongs to it, then `isocat explain AL 0x001A`",
        "0x603F: the drive's error code by CiA 402; 0x10F3: its history of diagnosis messages",
        "0x1C32:0B, :0C and :20: whether synchronization was lost with it",
    ],
    &[
        "what the maker's manual says; if the alarm is one of communication, treat 0x0134 first",
        "to ask for an AL status code write AL or 0x before it",
    ],
);

static LOST_SYNC: Entry = entry(
    "The drive lost synchronization: outputs did not come in step with SYNC0, more often than it \
     bears.",
    &[
        "jitter of the host: frames come later than the room before SYNC0",
        "the host is not locked onto the reference clock: frames slide through SYNC0",
        "SYNC0 too close behind the frame",
        "frames are lost on a cable",
    ],
    &[
        "0x0134: usually 0x001A, 0x002C or 0x0034",
        "0x1C32:0B and 0x10F1:02: misses, and how many the drive bears",
        "`isocat diagnose` of a capture: the position of each frame against SYNC0",
    ],
    &[
        "let the host follow the reference clock, and lower its jitter",
        "shift SYNC0 further behind the frame: arrival + jitter + 0x1C32:06",
        "a higher 0x10F1:02 only where a missed cycle does no harm",
    ],
);

static FRAME_AT_WRONG_TIME: Entry = entry(
    "The drive's supervision of synchronization: frames come at the wrong time against SYNC0, or \
     with too much jitter. Older firmware warns (W7011), newer stops (F7011).",
    &[
        "jitter of the host",
        "the frame comes too close to SYNC0, so that some cycles are a cycle late",
        "the interpolation time (0x60C2) is not the cycle of the bus",
    ],
    &[
        "0x1C32:0B, and 0x10F1:02: the limit of the supervision",
        "0x60C2:01 and :02 against the cycle",
        "`isocat diagnose` of a capture: where each frame lies against SYNC0",
    ],
    &[
        "shift SYNC0 away from the frame, at the MainDevice first",
        "less jitter: let the host follow the reference clock",
        "don't switch the supervision off (0x10F1:02 = 0): the motion stays wrong",
    ],
);

static SYNC_CYCLE: Entry = entry(
    "The drive does not take the synchronization cycle that was set, or measured another one.",
    &[
        "SYNC0's cycle is no multiple of what the drive can do",
        "the interpolation time (0x60C2) differs from the cycle of SYNC0",
        "frames come at another cycle than SYNC0, or unevenly",
    ],
    &["0x09A0: SYNC0's cycle", "0x1C32:02 and :05: cycle, and the shortest one", "0x60C2"],
    &["a cycle that the drive's manual lists, the same in 0x09A0 and 0x60C2"],
);

static NETWORK: Entry = entry(
    "The drive could not begin or keep communication: its state, its link or its description.",
    &[
        "the MainDevice stopped, or went down a state while the drive was enabled",
        "a cable or the link was lost",
        "the EEPROM (SII) or its ESI file does not belong to this firmware",
    ],
    &[
        "0x0130 and 0x0134: state and AL status code",
        "0x0110 and 0x0300 to 0x0313: links and errors",
    ],
    &[
        "disable the drive before OP is left",
        "the cable before this drive",
        "`isocat sii` of its EEPROM",
    ],
);

static WATCHDOG: Entry = entry(
    "The drive got no process data within its watchdog time.",
    &[
        "the MainDevice stood still or stopped sending outputs",
        "frames are lost",
        "the watchdog is shorter than a stall of the host",
    ],
    &["0x0134: usually 0x001B", "0x0400 and 0x0420: the watchdog time", "lost frames of the host"],
    &["send outputs in each cycle", "a watchdog longer than the longest stall that is to be borne"],
);

static MAILBOX: Entry = entry(
    "The drive refuses its mailbox or process data configuration.",
    &[
        "SyncManagers or PDO assignment are not those of the drive's description",
        "objects were written in the wrong state",
    ],
    &["0x0134", "0x1C12 and 0x1C13", "0x0800 and on: SyncManagers"],
    &["compare with `isocat plan my.toml --start-up`, which lists each write in its order"],
);

/// What public manuals say.
static ALARMS: [Alarm; 16] = [
    Alarm {
        codes: &["f7011", "w7011"],
        maker: "of Kollmorgen AKD2G: EtherCAT synchronization error",
        entry: &FRAME_AT_WRONG_TIME,
    },
    Alarm {
        codes: &["e08", "e080", "ee08", "ee080", "ee082", "ee085", "ee086", "e085"],
        maker: "of Inovance IS620N and SV660N (other makers use it otherwise): loss of \
             synchronization",
        entry: &LOST_SYNC,
    },
    Alarm {
        codes: &["e13", "e130", "ee13", "ee130", "e15", "e150", "ee15", "ee150"],
        maker: "of Inovance IS620N and SV660N (other makers use it otherwise): synchronization \
             cycle",
        entry: &SYNC_CYCLE,
    },
    Alarm {
        codes: &["e11", "e12", "ee11", "ee12", "ee110", "ee120", "ee081", "ee083", "ee084"],
        maker: "of Inovance IS620N and SV660N (other makers use it otherwise): communication",
        entry: &NETWORK,
    },
    Alarm {
        codes: &["aa10", "a10"],
        maker: "of Yaskawa Sigma (other makers use it otherwise): EtherCAT DC synchronization \
             error",
        entry: &LOST_SYNC,
    },
    Alarm {
        codes: &["aa12", "a12"],
        maker: "of Yaskawa Sigma (other makers use it otherwise): EtherCAT output data \
             synchronization error",
        entry: &LOST_SYNC,
    },
    Alarm {
        codes: &["aa11", "a11"],
        maker: "of Yaskawa Sigma (other makers use it otherwise): EtherCAT state error, OP was \
             left while the drive was enabled",
        entry: &NETWORK,
    },
    Alarm {
        codes: &["803", "806", "807", "815"],
        maker: "of Panasonic MINAS (other makers use it otherwise): PLL or synchronization signal",
        entry: &LOST_SYNC,
    },
    Alarm {
        codes: &["810"],
        maker: "of Panasonic MINAS (other makers use it otherwise): synchronization cycle",
        entry: &SYNC_CYCLE,
    },
    Alarm {
        codes: &["804", "814"],
        maker: "of Panasonic MINAS (other makers use it otherwise): PDO watchdog",
        entry: &WATCHDOG,
    },
    Alarm {
        codes: &["800", "801", "802", "852", "853", "882"],
        maker: "of Panasonic MINAS (other makers use it otherwise): state change, link or EEPROM",
        entry: &NETWORK,
    },
    Alarm {
        codes: &["811", "816", "817", "850", "851"],
        maker: "of Panasonic MINAS (other makers use it otherwise): mailbox, SyncManager or PDO \
             assignment",
        entry: &MAILBOX,
    },
    Alarm {
        codes: &["8303", "8304", "833", "834"],
        maker: "of Omron G5 and 1S (83.03, 83.04; other makers use it otherwise): synchronization",
        entry: &LOST_SYNC,
    },
    Alarm {
        codes: &["8305", "835"],
        maker: "of Omron G5 and 1S (83.05; other makers use it otherwise): SyncManager watchdog",
        entry: &WATCHDOG,
    },
    Alarm {
        codes: &["8301", "8302", "831", "832"],
        maker: "of Omron G5 and 1S (83.01, 83.02; other makers use it otherwise): state change",
        entry: &NETWORK,
    },
    Alarm {
        codes: &["8700"],
        maker: "by CiA 301 and CiA 402 (object 0x603F, emergency): sync controller",
        entry: &LOST_SYNC,
    },
];
