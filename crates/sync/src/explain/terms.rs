//! Words of the field that are no fault: "reference clock", "hot connect", "coalescing".

use super::symptoms::Symptom;
use super::{Entry, entry};

/// The term with this name. Case, and signs between words, are ignored.
pub fn find(words: &str) -> Option<&'static Symptom> {
    TERMS.iter().find(|term| term.is_called(words))
}

const fn term(name: &'static str, aliases: &'static [&'static str], entry: Entry) -> Symptom {
    Symptom { name, aliases, entry }
}

/// All terms: clocks first, then frames, then devices.
pub static TERMS: [Symptom; 28] = [
    term(
        "reference clock",
        &["dc reference clock", "ref clock", "reference device", "dc master", "which clock leads"],
        entry(
            "The device whose clock leads. It is the first device with DC in the order of frames: \
                 its time is read and handed to all behind it by one drift frame (FRMW or ARMW of \
                 0x0910) each cycle.",
            &[
                "none found: no device has DC (0x0008 bit 2), or DC is not switched on for it",
                "devices before it are not reached by FRMW and drift away",
            ],
            &[
                "0x0008 bit 2 of the first devices",
                "0x092C of the others: near 0",
                "0x0910 of all devices in one frame",
            ],
            &[
                "a drift frame of 0x0910 each cycle",
                "the host follows it; if the host must lead, the host writes the reference clock, \
                     with its own jitter",
            ],
        ),
    ),
    term(
        "propagation delay",
        &[
            "delay measurement",
            "propagation delays",
            "transmission delay",
            "cable delay",
            "system time delay",
            "line delay",
        ],
        entry(
            "How long a frame needs from the reference clock to a device, ns. It is measured once \
                 by a write to 0x0900, computed from receive times, and written to 0x0928, so that \
                 all clocks show one time.",
            &[
                "wrong by hundreds of ns: a device on the way without DC, a wrong order of ports, \
                     or an open ring",
                "not written: SYNC0 of each device is late by its cable and the devices before it",
            ],
            &["0x0900 to 0x090F: receive times of the ports", "0x0928: what was written", "0x092C"],
            &[
                "measure again after each change of the topology",
                "`isocat scan` and docs/delays.md: what is measured and what it should be",
            ],
        ),
    ),
    term(
        "system time offset",
        &["clock offset", "dc offset", "offset compensation"],
        entry(
            "What a device adds to its free-running clock to show the system time: 0x0920, 64 bits \
                 ns, written once after the delay was measured.",
            &[
                "not written: clocks differ by seconds, and drift frames take very long",
                "written in operation: SYNC0 jumps",
            ],
            &["0x0920 and 0x0910", "0x092C: near 0 afterwards"],
            &["write it before the drift frames begin, never in operation"],
        ),
    ),
    term(
        "drift compensation",
        &[
            "drift frames",
            "drift frame",
            "continuous drift compensation",
            "static drift compensation",
            "FRMW",
            "ARMW",
        ],
        entry(
            "Clocks run at different speeds, some 10 ppm. A drift frame each cycle hands the \
                 reference clock's time to all (0x0910), and each device steers its own clock to \
                 it.",
            &[
                "left out: clocks run apart by 1 us each second for each ppm",
                "too few at start: SYNC0 begins before clocks agree",
            ],
            &["0x092C: near 0 and not growing", "0x0934 and 0x0935: filter depths"],
            &[
                "one each cycle, in the frame of process data",
                "some 15 000 at once before SYNC0 is started",
            ],
        ),
    ),
    term(
        "distributed clocks",
        &["dc", "distributed clock", "DC mode", "dc synchronization"],
        entry(
            "Clocks in the devices that show one common time: one leads (the reference clock), the \
             others are steered to it. Each makes SYNC0 and SYNC1 from its own clock, so that all \
             act at one instant.",
            &["not in sync: delays or offsets were not written, drift frames are missing, or the \
             host's cycle slides"],
            &[
                "0x0008 bit 2: the device has DC",
                "0x092C, 0x0981, 0x0990",
                "`isocat explain modes`",
            ],
            &["in PREOP: delays, offsets, drift frames; then cycle, start time and 0x0981; then \
                     SAFEOP and OP"],
        ),
    ),
    term(
        "bus shift",
        &[
            "busshift",
            "master shift",
            "mastershift",
            "dcm",
            "bus shift mode",
            "master shift mode",
            "dcx",
            "dcm mode",
        ],
        entry(
            "Which side gives way. Master shift: the host's cycle follows the reference clock. Bus \
             shift: the host writes the reference clock, so that all devices follow the host, with \
             its jitter.",
            &[
                "both at once: two clocks lead, and SYNC0 wanders",
                "bus shift on a host with jitter: clocks of all devices are noisy",
                "DCM not in sync: the control loop has not settled, or jitter exceeds its limit",
            ],
            &[
                "0x0910 of the reference against the host's clock",
                "0x092C of each device",
                "`isocat diagnose` of a capture: who writes 0x0910",
            ],
            &[
                "master shift (the host follows), where the host's timer can be steered",
                "bus shift only with a punctual host; one of both",
            ],
        ),
    ),
    term(
        "shift time",
        &["sync0 shift", "sync shift", "shift", "phase", "sync0 phase", "user shift"],
        entry(
            "How far SYNC0 lies behind the beginning of the cycle, ns. The frame must have come, \
                 and the device must have taken its outputs (0x1C32:06), before SYNC0.",
            &[
                "too small: the frame comes behind SYNC0, with 0x001A or outputs a cycle late",
                "near the frame: jitter leads past it now and then",
            ],
            &[
                "0x1C32:06 and :0B",
                "`isocat plan`: what is needed",
                "`isocat diagnose`: where frames lie",
            ],
            &["arrival + jitter + 0x1C32:06, with room; the same for all that act together"],
        ),
    ),
    term(
        "interpolation",
        &[
            "interpolation time",
            "interpolation time period",
            "interpolation period",
            "interpolation cycle",
            "ip mode",
        ],
        entry(
            "A drive in a cyclic position mode goes from one set point to the next in the \
             interpolation time, object 0x60C2: :01 x 10 to the power of :02 seconds. It must be \
             the time from one set point to the next, which is the cycle of the bus.",
            &[
                "longer or shorter than the cycle: steps, hum, clicking, following error",
                "0x60C2 is refused: the drive takes it from SYNC0's cycle",
            ],
            &["0x60C2:01 and :02", "0x09A0: the cycle of SYNC0"],
            &["write 0x60C2 in PREOP: 1 ms is :01 = 1, :02 = -3; 500 us is :01 = 5, :02 = -4"],
        ),
    ),
    term(
        "PLL",
        &["pll error", "pll not locked", "phase locked loop", "pll lock"],
        entry(
            "The control loop by which a drive locks its own cycle onto SYNC0, or a host its cycle \
             onto the reference clock. AL status code 0x0032 says that a drive's is not locked.",
            &[
                "SYNC0 is uneven: the reference clock is steered with jitter, or clocks have not \
                     settled",
                "a cycle outside of what the drive can lock onto",
                "OP asked for too early",
            ],
            &["0x0134: 0x0032", "0x092C over some seconds", "0x09A0"],
            &[
                "let clocks settle before SYNC0 and OP",
                "the host follows the reference clock, and a cycle that the drive's manual lists",
            ],
        ),
    ),
    term(
        "free run",
        &["freerun", "free running"],
        entry(
            "The device works by its own timer and takes what the last frame brought: 0x1C32:01 = \
                 0. There is no common instant, so neither SYNC0 nor the frame decides when \
                 outputs act.",
            &[
                "not wanted: DC was meant, and 0x0981 was not written before SAFEOP",
                "refused with 0x0027: the device needs SYNC0 or SM events",
            ],
            &["0x1C32:01 and :04", "0x0981"],
            &["`isocat explain modes`: what each mode needs"],
        ),
    ),
    term(
        "coalescing",
        &[
            "interrupt coalescing",
            "rx-usecs",
            "interrupt moderation",
            "interrupt throttling",
            "rx coalescing",
        ],
        entry(
            "The network card collects interrupts for some 10 to 100 us before it reports frames, \
                 so answers reach the program late and unevenly. Throughput gains, a cyclic \
                 program loses.",
            &["the default of most cards and drivers"],
            &[
                "`ethtool -c IF`: rx-usecs, adaptive-rx",
                "`isocat run --interface IF --preflight` names it",
            ],
            &["switch it off: `ethtool -C IF adaptive-rx off rx-usecs 0 tx-usecs 0`, also after \
                     each start of the machine"],
        ),
    ),
    term(
        "switch",
        &["ethernet switch", "router", "hub", "usb adapter", "usb to ethernet"],
        entry(
            "EtherCAT frames do not belong on a switch: it stores each frame, adds its delay with \
             jitter, may drop or copy frames, and lets other traffic in.",
            &[
                "frames late or lost under load",
                "answers of a second program",
                "no device found: the switch does not pass broadcasts of this type",
            ],
            &["a capture: foreign frames, distances of answers"],
            &["a cable from the host directly to IN of the first device; a card of its own"],
        ),
    ),
    term(
        "mailbox polling",
        &["mailbox status", "mbx state", "mailbox state"],
        entry(
            "Whether a device has an answer in SM1: bit 3 of 0x080D. It is read cyclically, or \
                 mapped by an FMMU into the process data, one bit for each device.",
            &["never read: answers and emergencies fill the mailbox, and requests time out"],
            &["0x080D bit 3", "the FMMU that maps it"],
            &["poll it each few ms, or map the bit; fetch what is there"],
        ),
    ),
    term(
        "mailbox counter",
        &["cyclic counter", "mailbox cyclic counter", "counter of the mailbox"],
        entry(
            "A count from 1 to 7 in each mailbox header, by which a device tells a repeated \
                 request from a new one.",
            &[
                "it repeats: the device answers nothing, or with its last answer",
                "it is 0: some devices do not check, others refuse",
            ],
            &["bits 4 to 6 of the header's type byte, in a capture"],
            &["count 1 to 7 in turn, for each device on its own"],
        ),
    ),
    term(
        "emergency",
        &["emcy", "emergency message", "coe emergency", "emergency request"],
        entry(
            "A message by mailbox that a device sends of itself: a 16 bit error code, the error \
             register 0x1001, and five bytes of the maker.",
            &[
                "a fault of the drive or its supply",
                "a refused change of state (0xA0xx), a lost synchronization (0x8700)",
            ],
            &["0x603F, 0x1001, 0x10F3", "0x0134, if the state changed"],
            &["what the maker's manual says of the code; fetch messages, so that the mailbox \
                     stays free"],
        ),
    ),
    term(
        "one buffer",
        &[
            "1-buffer",
            "1 buffer",
            "one-buffer mode",
            "buffered mode",
            "3-buffer",
            "3 buffer",
            "three buffers",
            "mailbox mode",
        ],
        entry(
            "How a SyncManager hands data over. Three buffers (process data): each side always \
                 finds a complete, newest one. One buffer (mailbox): it must be read before it can \
                 be written again, and does not count otherwise.",
            &[
                "inputs in one buffer: the working counter is 1 too low in cycles in which the \
                     device was not ready",
                "0x0029: Free Run needs three buffers",
            ],
            &["0x0804 + 8 n, control byte: bits 1:0 = 10 mailbox, 00 three buffers"],
            &["three buffers for process data, if the description does not ask for one"],
        ),
    ),
    term(
        "process data watchdog",
        &[
            "watchdog",
            "sm watchdog",
            "pdo watchdog",
            "sync manager watchdog time",
            "output watchdog",
        ],
        entry(
            "If no outputs arrive for this time, the device makes its outputs safe and leaves OP \
                 with 0x001B: 0x0400 (divider) times 0x0420.",
            &[
                "the host stood still or stopped",
                "frames lost in a row",
                "a time shorter than some cycles",
            ],
            &["0x0400, 0x0420: 100 ms by default", "0x0134"],
            &["several cycles at least; 0 in 0x0420 switches it off, which leaves outputs as \
                     they are"],
        ),
    ),
    term(
        "hot connect",
        &[
            "hotconnect",
            "hot plug",
            "hot plugging",
            "hot swap",
            "optional device",
            "optional devices",
        ],
        entry(
            "A device is plugged in or taken away while others are in operation. The others stay \
                 in OP; only the newcomer is set up, from INIT.",
            &[
                "the whole segment is searched and set up anew: all leave OP",
                "the newcomer has no alias, so that its place is not known",
                "delays of devices behind it change with the cable",
            ],
            &[
                "0x0012 or 0x0134 with the identification: who it is",
                "0x0110: the port where it arrives",
            ],
            &[
                "`optional = true` of the device in the segment file, and `recovery`: what arrives \
                     is brought up, the others stay",
                "delays are measured anew for the newcomer alone",
            ],
        ),
    ),
    term(
        "redundancy",
        &["cable redundancy", "ring", "redundant ring", "ring redundancy", "line redundancy"],
        entry(
            "A second port of the host closes the line to a ring. Frames leave at both ports; if a \
             cable breaks, each port carries its side, and the working counters of both halves are \
             added.",
            &[
                "one port or one cable is missing: it is a line, and nothing is lost but \
                     redundancy",
                "after a break, delays of devices on the far side are other ones, and clocks must \
                     follow one reference",
                "two breaks at once: devices between them are gone",
            ],
            &["0x0110: where ports are closed", "the frame that comes back at each port"],
            &[
                "two ports of the host, and `ring = true` in the segment file: docs/ring.md",
                "mend a break soon",
            ],
        ),
    ),
    term(
        "topology",
        &["tree", "line topology", "star topology", "port order", "wrong topology"],
        entry(
            "How devices are cabled. Frames pass each device's ports in the order 0, 3, 1, 2 and \
                 come back the same way; a port without a link is closed and passes frames on.",
            &[
                "IN and OUT swapped: order and delays are wrong",
                "a link that comes and goes: frames turn back before devices behind it",
            ],
            &["0x0110: links and loops", "`isocat scan --interface IF`: the tree"],
            &["IN towards the host at each device; measure delays after each change"],
        ),
    ),
    term(
        "process image",
        &["process data image", "io map", "iomap"],
        entry(
            "The cyclic bytes of all devices as one block: FMMUs map them to logical addresses, \
                 and LRW (or LRD and LWR) exchanges them.",
            &[
                "other lengths than the mapped PDOs: SAFEOP is refused (0x001D, 0x001E)",
                "two devices on one address: each overwrites the other",
            ],
            &["0x0600 and on: FMMUs", "0x1C12, 0x1C13"],
            &["`isocat plan my.toml`: who lies where"],
        ),
    ),
    term(
        "sync error limit",
        &["sync error counter limit", "ecat.maxsyncerror", "maxsyncerror", "maximum sync errors"],
        entry(
            "How many missed events a device bears before it leaves OP with 0x001A: object \
                 0x10F1:02. Usually a miss counts 3 and a good cycle takes 1 away.",
            &[
                "too low for the host's jitter: a device falls at a single late frame",
                "0: the supervision is off in many drives",
            ],
            &["0x10F1:02 and 0x1C32:0B"],
            &["first frames that come in time; a higher limit where a missed cycle does no harm"],
        ),
    ),
    term(
        "SYNC0",
        &["sync 0", "sync0 pulse", "sync pulse", "sync signal", "sync0 signal", "sync0 event"],
        entry(
            "A pulse that the DC unit of a device makes by its own clock, each 0x09A0 ns from the \
                 start time on. With it outputs act, or the device begins its cycle, at the same \
                 instant in all devices.",
            &[
                "it does not run: start time in the past, or 0x0981 not written",
                "it does not fit the frame: too close behind it, or frames slide",
            ],
            &["0x0981, 0x0984, 0x0990, 0x09A0", "0x1C32:0B: events that came without a new frame"],
            &[
                "start time in the future, then 0x0981, before SAFEOP",
                "shift it behind the frame: arrival + jitter + 0x1C32:06",
            ],
        ),
    ),
    term(
        "SYNC1",
        &["sync 1", "sync1 pulse", "sync1 signal", "sync1 event"],
        entry(
            "A second pulse, 0x09A4 ns behind SYNC0. By the mode it takes the inputs, lets outputs \
                 act, or marks the bus cycle where SYNC0 runs several times in it.",
            &["0x09A4 is not below 0x09A0, or 0 where the mode needs it"],
            &["0x09A4, 0x0998", "`isocat explain modes`"],
            &["AssignActivate 0x0700 and a distance that the mode asks for"],
        ),
    ),
    term(
        "sync window",
        &["sync window monitoring", "dc sync window", "synchronization window"],
        entry(
            "A limit for 0x092C of all devices: while each clock is closer to the reference than \
                 it, the segment counts as synchronized. It says nothing about frames against \
                 SYNC0.",
            &[
                "clocks have not settled yet",
                "drift frames stopped, or a device lies before the reference clock",
                "a window that is too narrow for a steered reference clock",
            ],
            &["0x092C of each device, or its worst by BRD"],
            &["drift frames each cycle; then a window of some 100 ns to 1 us"],
        ),
    ),
    term(
        "FMMU",
        &["fmmus", "fieldbus memory management unit"],
        entry(
            "It maps bits of the logical address space to memory of a device, for reading or \
                 writing. A datagram to a logical address counts only where an FMMU maps it.",
            &["wrong length or start: the working counter is too low, or bytes are shifted"],
            &["0x0600 + 16 n: the FMMUs", "0x0800 + 8 n: the SyncManager behind it"],
            &["`isocat plan my.toml`: each mapping with its addresses"],
        ),
    ),
    term(
        "SyncManager",
        &["sync manager", "sync managers", "syncmanagers", "SM"],
        entry(
            "It guards an area of memory so that both sides see complete data: SM0 and SM1 the \
                 mailbox, SM2 outputs, SM3 inputs. A write to all of SM2 is the event of \
                 SM-synchronous devices.",
            &[
                "length or start differs from what the device expects: SAFEOP refused with 0x0017, \
                     0x001D, 0x001E",
                "a frame that does not touch its last byte triggers no event",
            ],
            &["0x0800 + 8 n", "0x1C00, 0x1C12, 0x1C13"],
            &["lengths by the mapped PDOs, control bytes by the SII"],
        ),
    ),
    term(
        "alias",
        &["station alias", "configured station alias", "second address", "explicit device id"],
        entry(
            "A number by which a device is known wherever it is plugged in: of the EEPROM (word 4, \
                 register 0x0012), or a switch that the device shows.",
            &[
                "changed in the EEPROM and not loaded yet: the power must go off and on",
                "two devices with one alias",
            ],
            &["0x0012", "SII word 4", "0x0134, where the device shows its identification"],
            &["one alias for each device of one kind, above all for hot connect"],
        ),
    ),
];
