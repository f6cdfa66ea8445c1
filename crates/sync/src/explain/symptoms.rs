//! Symptoms that users see or hear before they have a code: "lost sync", "wkc", "clicking".
//! Words of the field that are no fault are [`terms`](super::terms).

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

impl Symptom {
    /// Whether this is one of its names. Case, and signs between words, are ignored.
    pub fn is_called(&self, words: &str) -> bool {
        let same = |name: &str| letters(words).eq(letters(name));
        same(self.name) || self.aliases.iter().any(|alias| same(alias))
    }
}

/// The symptom with this name. Case, and signs between words, are ignored.
pub fn find(words: &str) -> Option<&'static Symptom> {
    SYMPTOMS.iter().find(|symptom| symptom.is_called(words))
}

fn letters(words: &str) -> impl Iterator<Item = char> {
    words.chars().filter(char::is_ascii_alphanumeric).map(|letter| letter.to_ascii_lowercase())
}

/// All symptoms, the most frequent first.
pub static SYMPTOMS: [Symptom; 22] = [
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
            "A device left OP, or stays in OP and acts on outputs of the wrong cycle. The AL \
                 status code says which of its checks failed; a device without a code may still be \
                 late.",
            &[
                "SYNC0 too close behind the frame, or inside it: outputs are not ready when it \
                     comes",
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
            "Fewer devices took part in a datagram than expected: each read counts 1, each write \
                 1, LRW 3 for both (1 for the read, 2 for the write). Inputs of that datagram are \
                 not to be used.",
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
            "latency",
            "realtime latency",
            "realtime delay",
            "host late",
            "overrun",
            "cycle overrun",
            "late frame",
        ],
        entry: entry(
            "Frames do not leave at even distances. With DC SYNC0 that does no harm until a frame \
                 is later than the room between its arrival and SYNC0; without SYNC it moves the \
                 outputs.",
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
            "The device left OP by itself, or refused it: AL status has 4 (SAFEOP) and the error \
                 bit 0x10. Its outputs are in their safe state. It stays there until the error is \
                 acknowledged.",
            &["the check that the AL status code names"],
            &["0x0134: the code; `isocat explain` of it", "0x1C32:0B, :0C, :20"],
            &["remove the cause, write 0x14 to 0x0120 (SAFEOP and acknowledge), then ask for OP \
                     again"],
        ),
    },
    Symptom {
        name: "stuck in SAFEOP",
        aliases: &[
            "no op",
            "cannot reach op",
            "can not reach op",
            "can t reach op",
            "safeop no error",
            "safeop without error",
            "hangs in safeop",
            "does not reach op",
            "op refused",
            "refuses op",
            "stays in safeop",
            "safeop",
        ],
        entry: entry(
            "The device refuses OP, or waits for something before it gives it.",
            &[
                "no valid outputs yet: OP needs a frame with outputs before and while it is asked \
                     for",
                "SYNC0 does not run, or frames and SYNC0 do not fit together (0x001A, 0x002C, \
                     0x002D)",
                "the device waits until SYNC has settled, some 100 ms",
                "the watchdog of outputs has expired (0x001B)",
            ],
            &[
                "0x0134",
                "0x0984 and 0x0990: whether SYNC runs",
                "the working counter of the outputs",
            ],
            &["begin the cyclic exchange and the drift frames before asking for OP, and keep \
                     them going"],
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
            "The device refuses SAFEOP: something that is checked before process data begin is \
                 wrong.",
            &[
                "length of SM2 or SM3 differs from the mapped PDOs (0x001D, 0x001E)",
                "mode in 0x1C32:01 and 0x1C33:01, and AssignActivate in 0x0980, do not belong \
                     together (0x0030)",
                "a cycle time that the device can't keep (0x0035, 0x0036)",
                "SYNC was activated with a start time in the past",
            ],
            &["0x0134", "0x1C12, 0x1C13 and the PDOs in them", "0x1C32:04: the modes it has"],
            &["compare with `isocat plan my.toml --start-up`, which lists each write in its order"],
        ),
    },
    Symptom {
        name: "stuck in INIT",
        aliases: &[
            "stays in init",
            "does not reach preop",
            "preop refused",
            "hangs in init",
            "no preop",
        ],
        entry: entry(
            "The device refuses PREOP, or never answers the request: what is checked there is the \
                 mailbox.",
            &[
                "SM0 and SM1 are not those of the SII (0x0016), or not set at all",
                "its program does not run: the EEPROM is blank or wrong, or firmware is missing",
                "the error bit was not acknowledged (0x0120 bit 4)",
                "the request reaches another device: station addresses were not set",
            ],
            &[
                "0x0130 and 0x0134",
                "0x0800 to 0x080F against SII words 0x18 to 0x1B",
                "0x0502: EEPROM errors",
            ],
            &[
                "mailbox SyncManagers by the SII, acknowledge, then PREOP",
                "`isocat sii` of its EEPROM",
            ],
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
            "Frames do not come back, or come back damaged: a device that finds a wrong checksum \
                 destroys the frame for all that follow.",
            &[
                "a cable, a connector or its shield",
                "disturbance by a drive's cable",
                "a device that restarts",
            ],
            &[
                "0x0300 to 0x0307: the first port with a count, in processing order, is behind the \
                     cable at fault",
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
            "The clocks of the devices run apart, by 1 us each second for each ppm, where no drift \
                 frame leads them.",
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
            "sync pulse missing",
            "sync0 lost",
            "sync0 is lost",
            "missing sync0",
            "no sync pulse",
            "no sync0 pulse",
            "sync0 does not run",
            "sync not running",
        ],
        entry: entry(
            "SYNC0 was activated and no pulse comes.",
            &[
                "the start time lay in the past when 0x0981 was written: the first pulse is then \
                     up to 584 years away",
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
            "sm event missed",
            "sm missed",
            "missed event",
        ],
        entry: entry(
            "Outputs act one cycle later than meant, though everything is in OP: the frame or the \
                 device's copy was not ready at SYNC0, and the device took what it had.",
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
        aliases: &["device missing", "fewer devices", "devices missing", "device not found"],
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
        aliases: &[
            "sdo timeout",
            "mailbox error",
            "no mailbox answer",
            "sdo no answer",
            "mailbox full",
            "mailbox stuck",
            "mailbox",
        ],
        entry: entry(
            "A request by mailbox (SDO, FoE, EoE) is not answered in time.",
            &[
                "the state has no mailbox: it begins with PREOP",
                "the mailbox still holds an older answer that was not fetched",
                "the counter of the mailbox header repeats, so the device takes the request for an \
                     old one",
                "the device is busy, as while it saves parameters: some need seconds",
            ],
            &["0x0805 and 0x080D: whether SM0 and SM1 are full", "0x0130: the state"],
            &["fetch what lies in SM1, count 1 to 7 and never 0, wait as long as the device's \
                     description says"],
        ),
    },
    Symptom {
        name: "clicking",
        aliases: &[
            "clicks",
            "click",
            "ticking",
            "ticks",
            "cracking",
            "crackling",
            "knocking",
            "popping",
            "motor clicks",
            "drive clicks",
            "motor jerks",
            "jerks",
            "jerking",
            "jerky motion",
            "stutter",
            "jump",
            "jumps",
            "jumping",
            "position jumps",
            "motor jumps",
            "twitch",
            "twitching",
            "twitches",
            "bumps",
            "stuttering",
        ],
        entry: entry(
            "A motor that clicks or jerks gets a set point twice, or misses one: set points do not \
                 come evenly with SYNC0. A rhythm of seconds is a frame that slides through SYNC0.",
            &[
                "the host is not locked onto the reference clock: its frames slide against SYNC0, \
                     and each passage clicks",
                "the frame comes too close to SYNC0: with the host's jitter some set points are a \
                     cycle late",
                "frames are lost: a set point is missing",
                "the interpolation time (0x60C2) is not the cycle of the bus",
                "the application computes set points from a clock of its own instead of one step a \
                     cycle",
            ],
            &[
                "0x1C32:0B: it grows at each click",
                "0x60C2:01 and :02 against the cycle",
                "`isocat diagnose` of a capture: the position of each frame against SYNC0, and how \
                     it moves",
            ],
            &[
                "let the host follow the reference clock",
                "shift SYNC0 away from the frame: arrival + jitter + 0x1C32:06 behind it",
                "0x60C2 = the cycle, and one set point a cycle",
            ],
        ),
    },
    Symptom {
        name: "vibration",
        aliases: &[
            "motor vibration",
            "vibrating",
            "vibrates",
            "shaking",
            "shakes",
            "grinding",
            "gravel",
            "rough motion",
            "rough",
            "rattling",
            "rattles",
            "hum",
            "humming",
            "hums",
            "buzzing",
            "buzz",
            "buzzes",
            "motor noise",
            "noisy motor",
            "modem noise",
            "noise",
            "whining",
            "oscillation",
            "oscillating",
            "velocity ripple",
            "whistling",
            "squealing",
            "screeching",
            "rumbling",
            "rumble",
            "speed ripple",
        ],
        entry: entry(
            "A motor that hums, grinds or vibrates follows set points that are not smooth: steps \
                 in each cycle, or cycles that are uneven.",
            &[
                "the interpolation time (0x60C2) is not the cycle of the bus: the drive runs each \
                     step too fast and waits, with a hum at the cycle's frequency",
                "the drive is not in the DC mode that was meant: it takes set points when the \
                     frame comes, with all its jitter (0x1C32:01 = 1)",
                "the host is not locked onto the reference clock, or jitter leads past SYNC0 again \
                     and again",
                "set points are not one step a cycle: the application's clock, or rounding of \
                     positions",
                "gains of the drive: then it vibrates without the bus, too",
            ],
            &[
                "0x60C2:01 and :02 against the cycle",
                "0x1C32:01 and 0x0981: whether it runs by SYNC0",
                "0x1C32:0B: missed events; `isocat diagnose` of a capture",
            ],
            &[
                "0x60C2:01 x 10 to the power of :02 seconds = the cycle",
                "SYNC0 on, with its cycle that of the bus, and the host following the reference \
                     clock",
                "then the drive's gains",
            ],
        ),
    },
    Symptom {
        name: "following error",
        aliases: &["position lag", "position error", "lag error", "following error too large"],
        entry: entry(
            "A drive is not where its set point is. Where motion is smooth otherwise, set points \
                 act later than thought, or unevenly.",
            &[
                "outputs act one or more cycles late: SYNC0 before the frame, or a frame that \
                     comes late",
                "inputs are a cycle older than set points",
                "the interpolation time (0x60C2) is not the cycle",
                "lost frames, or a host that is not locked onto the reference clock",
                "the drive's gains or limits",
            ],
            &["0x60C2:01 and :02", "0x1C32:0B", "`isocat run`: which cycle's outputs act"],
            &[
                "SYNC0 behind the frame by arrival + jitter + 0x1C32:06",
                "0x60C2 = the cycle; compare with the set point of the cycle that acts",
            ],
        ),
    },
    Symptom {
        name: "no devices found",
        aliases: &[
            "no slaves found",
            "no slave found",
            "no slave responds",
            "no slaves respond",
            "no slaves responding",
            "no devices",
            "nothing answers",
            "no slaves",
            "no response",
            "slave not responding",
        ],
        entry: entry(
            "No device answered the first broadcast: nothing answers on this interface.",
            &[
                "the wrong interface is named, or its link is down",
                "no power at the first device, or the cable is in its OUT instead of its IN",
                "a switch, a router or a USB adapter lies between",
                "missing rights to send raw frames, or a firewall or virtual machine that drops \
                     them",
            ],
            &[
                "the link light at both ends; `ethtool IF`: link detected",
                "`isocat scan --interface IF`, and `--rescue` if frames go and none come back",
                "a capture: whether frames of type 0x88A4 leave, and whether any come back",
            ],
            &[
                "the right interface and the rights for raw sockets",
                "the cable directly into the IN port of the first device; power on",
            ],
        ),
    },
    Symptom {
        name: "device lost",
        aliases: &[
            "slave lost",
            "lost slave",
            "slave disappeared",
            "device disappeared",
            "device gone",
            "slave gone",
            "slave offline",
            "device offline",
            "no communication",
            "no comm",
        ],
        entry: entry(
            "A device does not answer any more, and with it all behind it, unless a ring closes \
                 the way.",
            &[
                "it lost power, or its supply dipped",
                "the cable or connector before it",
                "several frames lost in a row, which its program takes for a lost device",
            ],
            &[
                "0x0110 of the last device that answers: links and loops of its ports",
                "0x0310 to 0x0313: lost links",
                "the working counter of a broadcast of 0x0130: how many answer",
            ],
            &[
                "power and cable of this device and of the one before it",
                "when it answers again, bring it up from INIT: it lost addresses, FMMUs and DC \
                     with power. `recovery` of a segment file does it",
            ],
        ),
    },
    Symptom {
        name: "WKC -1",
        aliases: &["wkc minus one", "wkc 1 negative", "ec noframe", "noframe", "no frame"],
        entry: entry(
            "SOEM gives back -1 where no frame came back within the time-out. It is no count of \
                 devices: the frame was lost, or its answer was late.",
            &[
                "the answer came late: card, driver, interrupt coalescing, a machine that was late",
                "the frame was lost: a cable, a device without power, the link",
                "receive was called without a send before it, or another thread took the answer",
            ],
            &[
                "a capture: `isocat diagnose FILE` tells lost frames from late answers",
                "0x0300 to 0x0313",
            ],
            &[
                "late: coalescing off (`ethtool -C IF rx-usecs 0`), priority, a longer time-out",
                "lost: the cable before the first port that counts",
            ],
        ),
    },
    Symptom {
        name: "link down",
        aliases: &["link lost", "no link", "link is down", "carrier lost", "cable unplugged"],
        entry: entry(
            "A port has no link: frames turn back there, and all devices behind are gone.",
            &[
                "a cable or connector",
                "the device at the other end has no power or restarts",
                "energy saving of the link (EEE)",
            ],
            &[
                "0x0110: link and loop of each port",
                "0x0310 to 0x0313: lost links",
                "`ethtool IF` at the host",
            ],
            &[
                "cable and power at both ends",
                "energy saving of the link off; 100 Mbit/s full duplex",
            ],
        ),
    },
    Symptom {
        name: "answers late",
        aliases: &[
            "late answers",
            "late answer",
            "answer late",
            "slow answers",
            "unmatched datagrams",
            "unmatched",
            "timed out",
            "frame timeout",
            "timeout",
            "datagrams timed out",
        ],
        entry: entry(
            "Frames come back, and later than the program waits for them. A program counts them as \
                 lost.",
            &[
                "interrupt coalescing of the network card",
                "a driver that passes frames through the kernel, or a USB adapter",
                "a machine that looks for answers too late",
                "a time-out or cycle that is too short; or frames that are really lost",
            ],
            &[
                "`isocat diagnose` of a capture: how long answers took (`answers-late`)",
                "`isocat run --interface IF --preflight`",
            ],
            &["coalescing off (`ethtool -C IF rx-usecs 0`), priority, a longer time-out or cycle"],
        ),
    },
    Symptom {
        name: "time jump",
        aliases: &[
            "dc time jump",
            "dc time jumps",
            "system time jumps",
            "clock jump",
            "clock jumps",
            "time jumps",
            "32 bit",
            "32 bit overflow",
            "32 bit system time",
            "system time overflow",
        ],
        entry: entry(
            "The DC system time jumps: by an offset that was written in operation, at a change of \
                 the reference clock, or every 4.29 s where it is read with 32 bits.",
            &[
                "a clock of 32 bits, or a program that reads only the low half: it wraps at 2^32 \
                     ns = 4.29 s",
                "offset 0x0920 was written in operation",
                "the reference clock restarted or was replaced",
            ],
            &["0x0008 bit 3: 64 bit clock", "0x0910 and 0x0920 over time"],
            &[
                "compare 32 bit times by their difference",
                "no write of 0x0920 in operation; DC anew after a loss of the reference clock",
            ],
        ),
    },
];
