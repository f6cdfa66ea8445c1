//! What several programs print in their own words.

use isocat_sync::explain::Entry;

pub(super) const fn entry(
    means: &'static str,
    causes: &'static [&'static str],
    read: &'static [&'static str],
    change: &'static [&'static str],
) -> Entry {
    Entry { means, causes, read, change }
}

pub(super) static NO_ANSWER: Entry = entry(
    "A frame was sent and did not come back within the time-out: no answer, so the program gave it \
         up. In operation that is a cycle without inputs, and without new outputs if the frame was \
         lost on its way out.",
    &[
        "a cable, a connector or a device without power: the frame is lost on its way",
        "the answer comes late, after the time-out: interrupt coalescing of the network card, a \
             driver without real time, a host that stood still",
        "the network card: link down, or its queue is full",
        "at start: nothing is connected to this interface",
    ],
    &[
        "0x0110, 0x0300 to 0x0313 of each device: links, damaged frames and lost links",
        "a capture at the host: `isocat diagnose FILE` tells lost frames from late answers",
        "`isocat run --interface IF --preflight`: what on this machine harms punctuality",
    ],
    &[
        "if frames are lost: the cable before the first port that counts",
        "if answers are late: coalescing off (`ethtool -C IF rx-usecs 0`), real-time priority, a \
             longer time-out",
    ],
);

pub(super) static LATE_ANSWER: Entry = entry(
    "An answer arrived that the program no longer waits for: it came late, after the time-out, or \
         its request had been given up. Nothing is wrong with the segment itself.",
    &[
        "the network card or its driver delivers frames late: interrupt coalescing, a driver \
             without real time",
        "the machine was late: the loop did not look for answers in time",
        "the cycle or the time-out is too short for this card",
        "a second program sends on the same interface",
    ],
    &[
        "a capture: `isocat diagnose FILE` tells how long answers took (`answers-late`)",
        "`isocat run --interface IF --preflight`: coalescing, priority, power saving",
    ],
    &[
        "coalescing off (`ethtool -C IF rx-usecs 0`), the program's native driver for the card, \
             real-time priority",
        "a longer cycle or time-out",
    ],
);

pub(super) static SKIPPED: Entry = entry(
    "A datagram was to be sent again before its answer had come, so it was left out: cycles in \
         which this datagram had no frame. The loop runs faster than answers are received, or it \
         is late.",
    &[
        "answers are taken late: the realtime task that receives them was late, or receives after \
             it sends",
        "a frame was lost, so that its datagram is still waited for",
        "the cycle is too short for the card and its driver: a generic driver passes frames \
             through the kernel",
    ],
    &[
        "lines beside it: TIMED OUT speaks of lost frames, UNMATCHED of late answers",
        "`isocat run --interface IF --preflight`: what on this machine harms punctuality",
        "a capture: `isocat diagnose FILE`",
    ],
    &[
        "receive first in each cycle, then send; one realtime task with priority and a processor \
             of its own",
        "the native driver of the card, coalescing off, or a longer cycle",
    ],
);

pub(super) static CORRUPTED: Entry = entry(
    "A frame came back that is no valid EtherCAT answer: cut short, with unknown contents, or of \
         somebody else.",
    &[
        "other traffic on the interface: a switch, a network manager, a second program",
        "the card or its driver cuts or pads frames",
        "a device that damages frames (with a right checksum)",
    ],
    &[
        "a capture at the host: whose frames they are",
        "0x0300 to 0x0307: damaged frames, 0x030C: errors of the processing unit",
    ],
    &[
        "an interface of its own, without a switch and without IP configuration",
        "checksum and segmentation offload of the card off",
    ],
);

pub(super) static LOW_WORKING_COUNTER: Entry = entry(
    "The working counter of the process data is not what it should be: some device did not take \
         part in this cycle, or none. Each device counts 1 for a read and 1 for a write, in LRW 1 \
         for the read and 2 for the write. Inputs of this datagram are not to be used.",
    &[
        "a device is not in SAFEOP or OP, so that its SyncManagers are off: at start that is \
             normal until all have come up",
        "a device left OP, lost power, or a cable was pulled",
        "0 of all: the frame was lost or nobody is configured; 1 too few: inputs of one device \
             were not given, 2 too few in LRW: its outputs",
        "a device has not refreshed a one-buffer (mailbox type) area of inputs yet",
        "the expected count is wrong: LRW counts otherwise than LRD and LWR",
    ],
    &[
        "0x0130 and 0x0134 of each device: state (AL status) and AL status code",
        "the host's count of lost and late frames in the same cycle",
        "0x0110: links and loops of each port",
        "a capture: `isocat diagnose FILE` names the device that did not count",
    ],
    &[
        "bring the device back to OP by its AL status code; use inputs of a cycle only if the \
             count is right",
        "if frames are lost or late: cable, card, cycle",
    ],
);

pub(super) static COUNTER_CHANGES: Entry = entry(
    "The working counter of the process data changed, once or several times within a second: \
         devices begin or cease to take part. At start it counts up to the expected value and \
         stays. In operation it means cycles without data of some device.",
    &[
        "a change up to the full count: devices came to SAFEOP and OP; nothing is wrong",
        "back and forth: frames are lost or too late, so that whole cycles count 0",
        "lasting below: a device left OP, or lost power or link",
        "the cycle is too short for the machine: the domain is read before its frame is back",
    ],
    &[
        "0x0130 and 0x0134 of each device: state (AL status) and AL status code",
        "lines beside it: TIMED OUT, UNMATCHED, SKIPPED tell of frames",
        "`isocat diagnose` of a capture: which cycles, and which device",
    ],
    &[
        "bring the devices that left OP back by their AL status code",
        "frames lost: the cable; frames late: the realtime task, the card, a longer cycle",
    ],
);

pub(super) static CLOCK_NOT_SETTLED: Entry = entry(
    "The clock of a device did not come to the reference clock within the wait: 0x092C (system \
         time difference) stayed large. SYNC0 started now does not fit that of the others.",
    &[
        "no time of the reference clock is sent each cycle (drift frames, FRMW of 0x0910), or the \
             realtime loop does not run yet while the program waits",
        "the application time is not set, or jumps: it must be in steps of the cycle",
        "offset 0x0920 or delay 0x0928 was written wrongly",
        "the reference clock itself is being steered by the host with jitter",
        "the device's filter reacts slowly, and the wait is short",
    ],
    &[
        "0x092C of the device: near 0 and not growing",
        "0x0910 of all devices in one frame; 0x0920, 0x0928",
        "a capture: whether a frame carries 0x0910 each cycle",
    ],
    &[
        "send the drift frame of 0x0910 each cycle before OP is asked for; some 15 000 at once \
             settle clocks",
        "one clock leads: the first device with DC as reference clock, and the host follows it",
        "an application time that advances by exactly one cycle",
    ],
);

pub(super) static NO_APPLICATION_TIME: Entry = entry(
    "The program was given no application time, so that it cannot set the offsets of clocks or a \
         start time of SYNC0.",
    &[
        "the application does not call the function that sets the time before each send",
        "the realtime loop had not begun when devices were configured",
        "the time is set to 0 or to another clock in between",
    ],
    &["0x0920: the offset that was written", "0x0990: the start time of SYNC0"],
    &[
        "set the application time in each cycle before sending, from the first cycle on, in steps \
             of the cycle",
        "synchronize the reference clock and the slave clocks (drift frames of 0x0910) in each \
             cycle, too",
    ],
);

pub(super) static STATE_REFUSED: Entry = entry(
    "A device refused a change of state and says why in its AL status code (0x0134). It stays \
         where it was, with the error bit of AL status set, until that is acknowledged.",
    &[
        "PREOP refused: mailbox SyncManagers do not match the SII (0x0016)",
        "SAFEOP refused: lengths of SM2 or SM3 against the mapped PDOs (0x001D, 0x001E), mode or \
             cycle of DC (0x0030, 0x0035)",
        "OP refused: no valid outputs yet (0x001B), SYNC0 and frames do not fit (0x001A, 0x002C, \
             0x002D)",
    ],
    &[
        "0x0134, which the next line often tells: `isocat explain 0x001A` explains a code",
        "0x0130: the state, and bit 4 for the error",
    ],
    &[
        "remove the cause that the code names, acknowledge (0x0120 bit 4), ask again",
        "`isocat plan my.toml --start-up` lists each write in its order, to compare with",
    ],
);

pub(super) static STATE_LATE: Entry = entry(
    "A device was asked for a state and did not reach it within the time-out. It neither refused \
         it nor reported an error, so its program still works or waits.",
    &[
        "OP: no valid outputs arrive, or process data are not sent while the program waits",
        "SAFEOP with DC: the device waits for SYNC0, which was never started or started in the \
             past",
        "the device is slow: its description tells a longer time-out",
        "the device does not answer at all",
    ],
    &[
        "0x0130 and 0x0134: state and AL status code",
        "0x0990 against 0x0910, and 0x0981: whether SYNC0 runs",
        "the working counter of its outputs",
    ],
    &[
        "send process data and drift frames each cycle while OP is asked for, in a thread if need \
             be",
        "check power and cable if nothing answers; a longer time-out if the description asks for \
             it",
    ],
);

pub(super) static ERROR_BIT: Entry = entry(
    "The error bit of AL status (0x0130 bit 4) is set: the device left a state by itself or \
         refused one, SAFEOP+ERR above all. 0x0134 says why. Outputs are in their safe state until \
         OP is reached again.",
    &[
        "synchronization was lost: 0x001A, 0x002C, 0x0032, 0x0034",
        "the watchdog of outputs expired: 0x001B",
        "lost frames or a host that stood still, which leads to both",
    ],
    &[
        "0x0134: the AL status code; `isocat explain` of it",
        "0x1C32:0B, :0C and :20",
        "0x0300 to 0x0313",
    ],
    &["remove the cause that the code names, write 0x14 to 0x0120 (SAFEOP and acknowledge), then \
             ask for OP again"],
);

pub(super) static NO_DEVICES: Entry = entry(
    "No device answered the first broadcast (BRD): nothing answers on this interface.",
    &[
        "the wrong interface is named, or its link is down",
        "no power at the first device, or the cable is in its OUT instead of its IN",
        "a switch, a router or a USB adapter lies between",
        "missing rights to send raw frames, or a firewall, a VPN filter or a virtual machine that \
             drops them",
        "on Windows: the name of the interface is not the one that the capture driver lists",
    ],
    &[
        "the link light at both ends; `ip link` or `ethtool IF`: link detected",
        "`isocat scan --interface IF`: what answers, and `--rescue` if frames go and none come \
             back",
        "a capture at the interface: whether frames of type 0x88A4 leave, and whether any come \
             back",
    ],
    &[
        "name the right interface, start with the rights for raw sockets",
        "cable directly into the IN port of the first device, without a switch; power on",
    ],
);

pub(super) static DEVICE_LOST: Entry = entry(
    "A device does not answer any more: frames pass and it does not count, or frames end before \
         it. All behind it are gone, too, unless a ring closes the way.",
    &[
        "it lost power, or its supply dipped",
        "the cable or connector before it: link lost",
        "a device before it closed its port or was switched off",
        "frames were lost several times in a row, and the program took the device for lost",
    ],
    &[
        "0x0110 of the last device that answers: links and loops of its ports",
        "0x0310 to 0x0313: lost links; 0x0300 to 0x0307: damaged frames",
        "the working counter of a broadcast (BRD of 0x0130): how many answer",
    ],
    &[
        "power and cable of this device and of the one before it",
        "when it answers again: bring it up from INIT, with station address, SyncManagers, FMMUs \
             and DC anew; it lost them with power",
    ],
);

pub(super) static DEVICE_BACK: Entry = entry(
    "A device that was lost answers again, and the program sets it up or has done so. It was gone \
         for some cycles: its outputs were safe and its clock has to come to the reference anew.",
    &[
        "power or link came back",
        "frames had been lost in a row, and the device had never been gone",
    ],
    &[
        "0x0310 to 0x0313 of the device before it: lost links",
        "0x092C: whether its clock agrees again",
    ],
    &[
        "find out why it was lost: cable, connector, power",
        "after its return the way is INIT, PREOP with DC, SAFEOP, OP; SYNC0 needs a new start time",
    ],
);

pub(super) static LINK: Entry = entry(
    "The link of the host's own port changed: the cable at the host, its card, or the first \
         device.",
    &[
        "the cable at the host was pulled or is damaged",
        "the first device was switched off or restarts",
        "the card's driver was restarted: settings changed, power saving, another program",
    ],
    &[
        "`ethtool IF`: link, speed 100 Mbit/s full duplex",
        "0x0310 of the first device: lost links at port 0",
    ],
    &[
        "cable and plug at the host; power of the first device",
        "keep network managers off this interface, power saving of the link (EEE) off",
    ],
);

pub(super) static TOPOLOGY: Entry = entry(
    "The number or the order of devices is not what was expected, so that the program searches \
         anew or does not know where a device lies.",
    &[
        "a device was added, removed, or has no power",
        "IN and OUT of a device are swapped, so that the order of frames is another one",
        "a link comes and goes: a bad cable or connector",
        "some devices were still starting when the search was done",
    ],
    &[
        "`isocat scan --interface IF`: the tree with ports",
        "0x0110 of each device: links and loops",
    ],
    &[
        "cables and power until the tree is the planned one",
        "wait until all devices are up before searching",
    ],
);

pub(super) static NO_REFERENCE: Entry = entry(
    "No device with distributed clocks was found that could lead, so no clock is synchronized and \
         no SYNC0 is possible.",
    &[
        "no device on this segment has DC (0x0008 bit 2)",
        "the device that has DC is missing or is not configured for it",
        "DC is not switched on in the configuration: AssignActivate is 0",
    ],
    &["0x0008 bit 2 of each device", "AssignActivate in the device's description"],
    &[
        "the first device with DC becomes reference clock: switch DC on for it",
        "without DC: SM-synchronous or Free Run, if the devices allow it",
    ],
);

pub(super) static REFERENCE_CHOSEN: Entry = entry(
    "Which device leads: its clock is the reference clock. Its time (0x0910) is read and handed to \
         all behind it in each drift frame (FRMW). Usually it is the first device with DC.",
    &["nothing is wrong: it is a notice"],
    &["0x092C of the others: near 0", "0x0910 of all in one frame"],
    &["devices before the reference clock are not reached by FRMW: let the first device with DC \
         lead"],
);

pub(super) static OUT_OF_STEP: Entry = entry(
    "Host and clocks are not within the limit: frames do not keep their place in the cycle of the \
         reference clock. If a frame comes to lie on SYNC0, devices lose synchronization.",
    &[
        "jitter of the host: the cyclic task starts late or unevenly",
        "the host is not steered by the reference clock, or its control loop has not settled yet",
        "another clock leads at the same time: a reference clock that the host writes, and a host \
             that follows",
        "a device's clock has not come to the reference (0x092C), or the first device with DC is a \
             poor clock",
    ],
    &[
        "0x092C of each device: whether the device clocks agree with each other",
        "0x0910 of the reference against the host's clock over some seconds: drift and jumps",
        "`isocat diagnose` of a capture: the position of each frame against SYNC0",
    ],
    &[
        "let the host follow the reference clock, and wait until the loop has settled before OP",
        "less jitter: real-time priority, a processor of its own, power saving and coalescing off",
        "if the limit is too tight for this machine: widen it, and shift SYNC0 by the jitter",
    ],
);

pub(super) static HOST_LATE: Entry = entry(
    "The machine was late: the realtime task did not start or finish within its period. The \
         segment has no part in it; frames then leave late or are left out.",
    &[
        "latency of kernel, firmware (SMI) or graphics driver",
        "power saving and frequency scaling of the processor",
        "no real-time kernel, no priority, or no processor of its own",
        "the task computes longer than its period, or prints and allocates in it",
        "the network driver works in the same task",
    ],
    &[
        "`isocat run --interface IF --preflight`: what on this machine harms punctuality",
        "`isocat calibrate`, or a latency test of the system over hours, under load",
    ],
    &[
        "a real-time kernel, isolated processor, priority, power saving and hyperthreading off",
        "a longer cycle until the machine keeps it; `[host] jitter` of the segment file to what \
             was measured",
    ],
);

pub(super) static MAILBOX_SILENT: Entry = entry(
    "A request by mailbox (SDO and the like) had no answer in time.",
    &[
        "the state has no mailbox: it begins with PREOP",
        "the device is busy, as while it saves parameters, or its program hangs",
        "an older answer was never fetched from SM1, or the mailbox counter repeats",
        "frames are lost, or nothing sends them: some programs need their cyclic call for it",
    ],
    &["0x0805 and 0x080D: whether SM0 and SM1 are full", "0x0130: the state"],
    &[
        "PREOP or higher before asking; keep the cyclic call running meanwhile",
        "a longer time-out; fetch what lies in SM1; count 1 to 7 and never 0",
    ],
);

pub(super) static MAILBOX_BROKEN: Entry = entry(
    "An answer by mailbox came that does not fit the request: another protocol, another object, a \
         wrong length or an error of the mailbox itself.",
    &[
        "an older answer was fetched: after a time-out, or of another program",
        "two parts of the program use the mailbox of one device at once",
        "the mailbox sizes set are not those of the SII",
        "the device's stack builds wrong answers",
    ],
    &["0x0800 and 0x0808: SM0 and SM1 against SII words 0x18 to 0x1B", "a capture of the exchange"],
    &["one request at a time to a device; empty SM1 after a time-out", "mailbox sizes of the SII"],
);

pub(super) static SDO_FAILED: Entry = entry(
    "Reading or writing an object failed. The abort code in this line or beside it says why.",
    &[
        "the object or sub-index does not exist in this device or firmware (0x06020000, \
             0x06090011)",
        "it may not be written, or not in this state (0x06010002, 0x08000022)",
        "the value or its length does not fit (0x06090030, 0x06070010)",
        "no answer by mailbox, if there is no abort code",
    ],
    &[
        "the abort code: `isocat explain 0x06020000`",
        "the object in the device's description or dictionary",
        "0x0130: the state",
    ],
    &[
        "write objects that the device has, in PREOP, in the order of its description",
        "`isocat plan my.toml --start-up` lists the writes of a start",
    ],
);

pub(super) static EMERGENCY: Entry = entry(
    "The device sent an emergency message: an error of its application, by a 16 bit code of CiA \
         301 and CiA 402 or of the maker, and the error register 0x1001.",
    &[
        "a fault of the drive or its supply",
        "codes 0x8xxx: communication and monitoring, 0x8700 the sync controller",
        "codes 0xA0xx: a refused change of state; its bytes hold details",
    ],
    &[
        "0x603F and 0x1001",
        "0x10F3: the history of diagnosis messages",
        "0x0134, if the state changed with it",
    ],
    &["what the maker's manual says of the code; fetch emergencies, so that the mailbox does not \
         fill"],
);

pub(super) static CONFIGURATION: Entry = entry(
    "The configuration of process data does not fit the device: SyncManagers, PDOs or their \
         entries are other ones than it has.",
    &[
        "a PDO or entry that this device or firmware does not have",
        "PDO assignment or mapping is fixed, and other PDOs were asked for",
        "the length that was computed is not that of the mapped PDOs",
        "the description used is of another revision",
    ],
    &["0x1C12 and 0x1C13, and the PDOs in them", "0x1018: revision", "0x0800 + 8 n: SyncManagers"],
    &[
        "read assignment and mapping back from the device, and compare with the description",
        "`isocat plan my.toml --start-up` lists each write in its order",
    ],
);

pub(super) static INIT_COMMAND: Entry = entry(
    "A command of the start-up list was not carried out: a register write that nobody counted, or \
         an SDO that was refused.",
    &[
        "an SDO of the list that this device refuses: see its abort code",
        "the device does not answer, or is not in the state of the command",
        "a DC command, such as set DC cycle time, to a device without DC or with a cycle it does \
             not take",
        "the configured device is not the one that is there",
    ],
    &["the command's name: which register or object", "0x0130 and 0x0134", "0x1018: identity"],
    &[
        "correct or remove this entry of the start-up list; the cycle in it must be the bus cycle",
        "the description that belongs to this device",
    ],
);

pub(super) static EEPROM: Entry = entry(
    "The EEPROM (SII) of a device could not be read or does not hold what it must.",
    &[
        "the EEPROM is blank, damaged or of another device",
        "the device's program holds access to it (0x0500), or loads it still",
        "frames are lost while it is read",
    ],
    &["0x0502: busy, error bits 11 to 14", "0x0500: who has access", "`isocat sii` of the image"],
    &[
        "give access back to the EtherCAT side (0x0500 = 0)",
        "write the image of this device, then power off and on",
    ],
);

pub(super) static WRONG_DEVICE: Entry = entry(
    "The device at this place is not the configured one: vendor, product code or revision differ.",
    &[
        "another device, or the same in another order",
        "another revision or firmware than the configuration was made for",
        "an EEPROM that was written for another device",
    ],
    &["0x1018:01 to :04, and SII words 0x08 to 0x0F", "`isocat scan --interface IF`"],
    &["swap the device or cables, or configure for what is there"],
);

pub(super) static NO_SOCKET: Entry = entry(
    "The program could not open the network interface for raw frames; nothing was sent.",
    &[
        "missing rights: raw sockets need root or CAP_NET_RAW",
        "the interface's name is wrong, or it is down",
        "the capture driver is not installed (Windows), or the card is held by another driver",
    ],
    &["`ip link`: names and state of interfaces"],
    &[
        "start with the rights, or give the program CAP_NET_RAW",
        "the name as the system lists it; the link up",
    ],
);

pub(super) static NOT_SUPPORTED: Entry = entry(
    "The device, or the way the program sees it, does not have what was asked for: a mailbox, a \
         protocol, DC, or a setting.",
    &[
        "a simple device without mailbox: it has no objects",
        "the EEPROM does not state the protocol, so the program believes that it is missing",
        "the device has no DC (0x0008 bit 2)",
    ],
    &["SII words 0x18 to 0x1C: mailbox sizes and protocols", "0x0008: features of the ESC"],
    &["leave it out for this device, or correct the EEPROM"],
);

pub(super) static IN_OPERATION: Entry = entry(
    "All devices reached the state; nothing is wrong. OP alone does not say that outputs act in \
         the right cycle.",
    &["nothing is wrong: it is a notice"],
    &["the working counter: full in each cycle", "0x1C32:0B and :20; 0x092C"],
    &["`isocat diagnose` of a capture, or `isocat run`: whether it is in sync, too"],
);

pub(super) static LEFT_OP: Entry = entry(
    "A device left OP by itself: it makes its outputs safe, and its AL status code (0x0134) says why.",
    &[
        "it lost synchronization: frames late, early or missing against SYNC0 (0x001A, 0x002C)",
        "no outputs came for the time of its watchdog (0x001B)",
        "a fault of its own, which an emergency message or its display tells",
        "after hours: clocks that drift apart, or a host that is held up now and then",
    ],
    &[
        "0x0130 and 0x0134 of the device: `isocat explain 0x001A` explains a code",
        "0x1C32:0B to :0D and :20, its counters",
    ],
    &[
        "`isocat diagnose` of a capture that holds the moment says which frame was first",
        "`isocat record` keeps the last seconds before it, however long that takes",
        "remove the cause that the code names, acknowledge, ask for OP again",
    ],
);

pub(super) static NOT_ALL_IN_STATE: Entry = entry(
    "At least one device did not reach the state. The list of states and AL status codes that \
         usually follows tells which one, and why.",
    &[
        "OP: no valid process data while OP is asked for, SYNC0 and frames that do not fit \
             (0x001A, 0x002D), watchdog (0x001B)",
        "SAFEOP: lengths of SM2 or SM3 (0x001D, 0x001E), DC settings (0x0030)",
        "a device does not answer",
        "too short a wait",
    ],
    &[
        "0x0130 and 0x0134 of each device: `isocat explain 0x001A` explains a code",
        "the working counter",
    ],
    &[
        "send process data in each cycle while OP is asked for",
        "remove the cause that the code names, acknowledge, ask again",
    ],
);

pub(super) static REDUNDANCY_USED: Entry = entry(
    "The ring is open: frames no longer go all the way round, and the second port of the host \
         carries the devices behind the break. Operation goes on without redundancy.",
    &["a cable of the ring was pulled or broke", "a device of the ring lost power"],
    &[
        "0x0110: the two devices at whose ports the loop is closed lie at the break",
        "0x0310 to 0x0313",
    ],
    &[
        "mend the ring soon: a second break takes devices away",
        "`ring = true` in the segment file: what it means for delays and DC",
    ],
);

pub(super) static CAPACITY: Entry = entry(
    "Something is larger than the program has room for: frames, process data, devices or a queue.",
    &[
        "more devices or process data than its constants allow",
        "too many datagrams wait at once: answers are slow, or several tasks send",
    ],
    &["the program's constants or generic parameters"],
    &["raise them, or map fewer PDOs"],
);

pub(super) static CRC: Entry = entry(
    "Damaged frames were counted at a port: a frame with a wrong checksum is destroyed for all \
         devices behind, so the working counter of that cycle is wrong.",
    &[
        "the cable, connector or shield before the first port that counts",
        "disturbance by a drive's motor cable or a missing ground",
        "counts after switching on and plugging: harmless if they do not grow",
    ],
    &[
        "0x0300 to 0x0307: the first port with a count, in the order of frames",
        "0x0308 to 0x030B: errors that an earlier device had marked; 0x0310 to 0x0313: lost links",
    ],
    &[
        "the cable before the first port that counts",
        "reset the counters by a write, and watch which grows",
    ],
);

pub(super) static BUSY_MASTER: Entry = entry(
    "The program is not in the phase that the call needs: it is used by another one, not \
         activated, or activated already.",
    &[
        "another process holds the master",
        "calls in the wrong order: configure, activate, then exchange",
        "the module has no network device yet: MAC address or driver in its configuration",
    ],
    &["the processes that use it; the kernel log"],
    &["one owner; configuration before activation; the right MAC address of the card"],
);

pub(super) static NOTICE: Entry = entry(
    "A notice of progress; by itself it tells no fault.",
    &["nothing is wrong: it is a notice"],
    &["lines beside it with WARNING or ERROR"],
    &["nothing"],
);

pub(super) static SCAN_AGAIN: Entry = entry(
    "The number of devices that answer, or their states, changed; the program looks at the segment \
         anew. In operation that means devices or links come and go.",
    &[
        "at start: devices come up one after the other; nothing is wrong",
        "in operation: power or link of a device lost and back",
        "frames lost: a broadcast (BRD) that came back with fewer answers",
    ],
    &[
        "0x0310 to 0x0313 of each device: lost links",
        "`isocat scan --interface IF`: what answers now",
    ],
    &["cables and power before the first device that is missing"],
);

pub(super) static PHASE: Entry = entry(
    "The times that are set for SYNC pulses or for cycles do not fit together: start, shift, \
         SYNC1, or the cycle of the program.",
    &[
        "a shift that is larger than the cycle, or a negative SYNC1 cycle",
        "a cycle of SYNC0 that is no whole part or multiple of the bus cycle",
        "two parts of the configuration state different cycles",
    ],
    &[
        "0x09A0 and 0x09A4: cycles of SYNC0 and SYNC1",
        "0x0990: the start time",
        "`isocat plan my.toml`",
    ],
    &["one cycle for program, SYNC0 and 0x60C2; shifts below the cycle"],
);
