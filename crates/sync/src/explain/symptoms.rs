//! Symptoms that users see before they have a code: "lost sync", "wkc", "stuck in SAFEOP".

use super::{Entry, entry};

/// A symptom with its name and its other names. All are in lower case, with one space between
/// words.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Symptom {
    /// The name of the symptom in this project.
    pub name: &'static str,
    /// Other names for it.
    pub aliases: &'static [&'static str],
    /// The explanation.
    pub entry: Entry,
}

/// The symptom with this name. Case, and signs between words, are ignored.
pub fn find(words: &str) -> Option<&'static Symptom> {
    let same = |name: &str| letters(words).eq(letters(name));
    SYMPTOMS
        .iter()
        .find(|symptom| same(symptom.name) || symptom.aliases.iter().any(|alias| same(alias)))
}

fn letters(words: &str) -> impl Iterator<Item = char> {
    words.chars().filter(char::is_ascii_alphanumeric).map(|letter| letter.to_ascii_lowercase())
}

/// All symptoms, the most frequent first.
pub static SYMPTOMS: [Symptom; 12] = [
    Symptom {
        name: "lost sync",
        aliases: &[
            "sync lost",
            "loses sync",
            "lost synchronization",
            "out of sync",
            "not in sync",
            "sync error",
            "fell out of op",
            "falls out of op",
            "drops out of op",
            "left op",
        ],
        entry: entry(
            "A device left OP, or stays in OP and acts on outputs of the wrong cycle. The AL status \
             code says which of its checks failed; a device without a code may still be late.",
            &[
                "SYNC0 too close behind the frame, or inside it: outputs are not ready when it comes",
                "the host stalled, or its cycle slides against SYNC0: it is not locked onto the \
                 reference clock",
                "frames lost on a cable or connector",
                "clocks that run apart: drift frames stopped, or never led this device",
                "the cycle is shorter than what the device needs",
            ],
            &[
                "0x0130 and 0x0134: state and AL status code, then `isocat explain` of that code",
                "0x1C32:0B, :0C, :0D, :20: which of its events the device missed",
                "0x092C of each device: whether the clocks agree",
                "0x0300 to 0x0313: errors of each port",
                "a capture: `isocat diagnose FILE` names the first cause and its frame",
            ],
            &[
                "what the first cause asks for; later ones often follow from it",
                "`isocat plan` of the segment: the slack of each demand on the cycle",
            ],
        ),
    },
    Symptom {
        name: "working counter",
        aliases: &[
            "wkc",
            "wrong working counter",
            "working counter error",
            "working counter mismatch",
            "wkc error",
            "wkc mismatch",
            "wkc too low",
            "low wkc",
        ],
        entry: entry(
            "Fewer devices took part in a datagram than expected: each read counts 1, each write 1, \
             LRW 3 for both (1 for the read, 2 for the write). Inputs of that datagram are not to be used.",
            &[
                "a device is not in SAFEOP or OP, so its SyncManagers are off",
                "a device lost power, or a cable was pulled",
                "an FMMU or a SyncManager does not lie where the datagram reads or writes",
                "a device did not refresh its inputs yet: only with a mailbox or a one-buffer area",
                "the expected count is wrong: LRW counts otherwise than LRD and LWR",
            ],
            &[
                "0x0130 of each device by FPRD: which one does not answer, or is not in OP",
                "0x0110: links and loops of each port",
                "0x0600 and on, 0x0800 and on: FMMUs and SyncManagers against the plan",
            ],
            &[
                "bring the device back to OP; the outputs of others are valid all the same",
                "use the inputs of a cycle only if its count is right",
            ],
        ),
    },
    Symptom {
        name: "jitter",
        aliases: &[
            "frame jitter",
            "host jitter",
            "cycle jitter",
            "send jitter",
            "late frames",
            "late frame",
        ],
        entry: entry(
            "Frames do not leave at even distances. With DC SYNC0 that does no harm until a frame is \
             later than the room between its arrival and SYNC0; without SYNC it moves the outputs.",
            &[
                "no real-time priority, or no processor of its own",
                "power saving of the processor, or frequency scaling",
                "interrupt coalescing of the network card",
                "a virtual machine, or firmware that stops the processor",
            ],
            &[
                "`isocat run --interface IF --preflight`: what on this machine harms punctuality",
                "0x1C32:0F to :12 where the device has them: distances that it saw",
                "`isocat diagnose` of a capture: the position of each frame against SYNC0",
            ],
            &[
                "`[host] jitter` of the segment file to what was measured: the plan keeps it free",
                "SYNC0 later in the cycle, as long as inputs are ready for the next frame",
                "priority, isolated processor, coalescing off",
            ],
        ),
    },
    Symptom {
        name: "SAFEOP+ERR",
        aliases: &[
            "safeop err",
            "safeop error",
            "safe op error",
            "safeop with error",
            "error safeop",
        ],
        entry: entry(
            "The device left OP by itself, or refused it: AL status has 4 (SAFEOP) and the error bit \
             0x10. Its outputs are in their safe state. It stays there until the error is acknowledged.",
            &["the check that the AL status code names"],
            &["0x0134: the code; `isocat explain` of it", "0x1C32:0B, :0C, :20"],
            &[
                "remove the cause, write 0x14 to 0x0120 (SAFEOP and acknowledge), then ask for OP again",
            ],
        ),
    },
    Symptom {
        name: "stuck in SAFEOP",
        aliases: &[
            "no op",
            "does not reach op",
            "op refused",
            "refuses op",
            "stays in safeop",
            "safeop",
        ],
        entry: entry(
            "The device refuses OP, or waits for something before it gives it.",
            &[
                "no valid outputs yet: OP needs a frame with outputs before and while it is asked for",
                "SYNC0 does not run, or frames and SYNC0 do not fit together (0x001A, 0x002C, 0x002D)",
                "the device waits until SYNC has settled, some 100 ms",
                "the watchdog of outputs has expired (0x001B)",
            ],
            &[
                "0x0134",
                "0x0984 and 0x0990: whether SYNC runs",
                "the working counter of the outputs",
            ],
            &[
                "begin the cyclic exchange and the drift frames before asking for OP, and keep them going",
            ],
        ),
    },
    Symptom {
        name: "stuck in PREOP",
        aliases: &[
            "does not reach safeop",
            "safeop refused",
            "refuses safeop",
            "stays in preop",
            "preop",
        ],
        entry: entry(
            "The device refuses SAFEOP: something that is checked before process data begin is wrong.",
            &[
                "length of SM2 or SM3 differs from the mapped PDOs (0x001D, 0x001E)",
                "mode in 0x1C32:01 and 0x1C33:01, and AssignActivate in 0x0980, do not belong together (0x0030)",
                "a cycle time that the device can't keep (0x0035, 0x0036)",
                "SYNC was activated with a start time in the past",
            ],
            &["0x0134", "0x1C12, 0x1C13 and the PDOs in them", "0x1C32:04: the modes it has"],
            &["compare with `isocat plan my.toml --start-up`, which lists each write in its order"],
        ),
    },
    Symptom {
        name: "lost frames",
        aliases: &[
            "frame loss",
            "lost frame",
            "packet loss",
            "crc errors",
            "crc error",
            "link errors",
            "lost link",
        ],
        entry: entry(
            "Frames do not come back, or come back damaged: a device that finds a wrong checksum destroys \
             the frame for all that follow.",
            &[
                "a cable, a connector or its shield",
                "disturbance by a drive's cable",
                "a device that restarts",
            ],
            &[
                "0x0300 to 0x0307: the first port with a count, in processing order, is behind the cable at fault",
                "0x0308 to 0x030B: errors that an earlier device had already marked",
                "0x0310 to 0x0313: lost links",
            ],
            &[
                "the cable before the first port that counts",
                "reset the counters by a write, and watch which one grows",
            ],
        ),
    },
    Symptom {
        name: "drift",
        aliases: &[
            "clock drift",
            "clocks drift",
            "clocks run apart",
            "clocks not converged",
            "not converged",
        ],
        entry: entry(
            "The clocks of the devices run apart, by 1 us each second for each ppm, where no drift frame leads them.",
            &[
                "no drift frames (FRMW or ARMW of 0x0910), or too few of them",
                "the device lies before the reference clock, where FRMW does not reach it",
                "the offset 0x0920 or the delay 0x0928 was not written",
            ],
            &[
                "0x092C: near 0 and not growing",
                "0x0910 of all devices in one frame",
                "0x0930 to 0x0935",
            ],
            &["a drift frame in each cycle; some 15 000 at once before SYNC is started"],
        ),
    },
    Symptom {
        name: "no SYNC0",
        aliases: &[
            "sync0 missing",
            "no sync pulse",
            "no sync0 pulse",
            "sync0 does not run",
            "sync not running",
        ],
        entry: entry(
            "SYNC0 was activated and no pulse comes.",
            &[
                "the start time lay in the past when 0x0981 was written: the first pulse is then up to 584 years away",
                "only the low half of a 64 bit start time was written, or the other way round",
                "the unit belongs to the PDI (0x0980)",
                "the pulse length is 0 (acknowledge mode), and the device never acknowledges",
            ],
            &[
                "0x0984: whether it waits for its start",
                "0x0990 against 0x0910: the next pulse must lie ahead and move on",
            ],
            &["read 0x0910, add some cycles, write 0x0990, then 0x0981; read both back"],
        ),
    },
    Symptom {
        name: "late outputs",
        aliases: &[
            "old outputs",
            "outputs late",
            "a cycle late",
            "outputs a cycle late",
            "missed events",
            "missed event",
        ],
        entry: entry(
            "Outputs act one cycle later than meant, though everything is in OP: the frame or the device's \
             copy was not ready at SYNC0, and the device took what it had.",
            &[
                "SYNC0 lies too early in the cycle",
                "the frame was late",
                "0x1C32:06 states less than the device needs",
            ],
            &[
                "0x1C32:0B: it counts up and down, so read it often",
                "`isocat run`: margins, and which cycle's outputs act",
            ],
            &["SYNC0 further behind the frame: arrival + jitter + 0x1C32:06"],
        ),
    },
    Symptom {
        name: "missing device",
        aliases: &[
            "device missing",
            "fewer devices",
            "devices missing",
            "device not found",
            "device lost",
        ],
        entry: entry(
            "Fewer devices answer than expected.",
            &[
                "no power at it, or at the one before it",
                "a cable, or IN and OUT swapped",
                "a port that is closed by a register",
            ],
            &[
                "0x0110 of the last one that answers: links and loops of its ports",
                "0x0100: forced loops",
            ],
            &["`isocat scan`: the tree with ports, and where it ends"],
        ),
    },
    Symptom {
        name: "mailbox timeout",
        aliases: &["sdo timeout", "mailbox error", "no mailbox answer", "sdo no answer", "mailbox"],
        entry: entry(
            "A request by mailbox (SDO, FoE, EoE) is not answered in time.",
            &[
                "the state has no mailbox: it begins with PREOP",
                "the mailbox still holds an older answer that was not fetched",
                "the counter of the mailbox header repeats, so the device takes the request for an old one",
                "the device is busy, as while it saves parameters: some need seconds",
            ],
            &["0x0805 and 0x080D: whether SM0 and SM1 are full", "0x0130: the state"],
            &[
                "fetch what lies in SM1, count 1 to 7 and never 0, wait as long as the device's description says",
            ],
        ),
    },
];
