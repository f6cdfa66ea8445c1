//! AL status codes (register 0x0134): why a SubDevice refused a state or left it.

use isocat_wire::AlStatusCode;

use super::{Entry, entry};

/// The meaning of a code; `None` for a code that no published list contains. Codes from 0x8000 on
/// belong to the device's maker: [`VENDOR`].
pub fn explain(code: AlStatusCode) -> Option<&'static Entry> {
    if code.0 >= FIRST_OF_VENDOR {
        return Some(&VENDOR);
    }
    let at = CODES.binary_search_by_key(&code.0, |(code, _)| *code).ok()?;
    Some(&CODES[at].1)
}

/// The first code that makers may define themselves.
pub const FIRST_OF_VENDOR: u16 = 0x8000;

/// The explanation that is valid for every maker-specific code.
pub static VENDOR: Entry = entry(
    "A code of the device's maker: no standard says what it means, and two makers may mean \
     different things by one number. Nobody but the maker's manual can tell.",
    &[
        "an error of the application: drive fault, parameter out of range, missing supply",
        "the maker's finer form of a standard code, synchronization included",
    ],
    &[
        "the maker's manual, chapter on AL status codes or on EtherCAT errors",
        "0x1018:01: the vendor",
        "0x10F3 (diagnosis history), 0x603F (error code) and 0x1001 where they are there",
        "0x1C32:0B, :0C, :20 and 0x1C33: whether it happened together with a lost synchronization",
    ],
    &["what the maker's manual says; acknowledge (0x0120, bit 4), then ask for the state again"],
);

/// Standard codes, in ascending order.
pub static CODES: [(u16, Entry); 63] = [
    (
        0x0000,
        entry(
            "No error. It also stands there after an error was acknowledged.",
            &["with the error bit set: a device that mirrors AL control (device emulation)"],
            &["0x0130: state and error bit", "0x0141 bit 0: device emulation"],
            &["nothing; to a device with emulation don't write the acknowledge bit"],
        ),
    ),
    (
        0x0001,
        entry(
            "An error that the device does not tell in more detail.",
            &["a fault of the application", "a check of the stack without a code of its own"],
            &[
                "0x10F3, 0x1001, 0x603F",
                "which transition was asked for: its checks are what failed",
            ],
            &["compare SyncManagers, mapping and DC settings with the device description"],
        ),
    ),
    (
        0x0002,
        entry(
            "The device ran out of memory.",
            &["more process data are mapped than it has room for", "larger mailboxes than it has"],
            &["0x1C12 and 0x1C13: what is mapped", "SII words 0x18 to 0x1B: mailbox sizes"],
            &["map less", "use the mailbox sizes of the SII"],
        ),
    ),
    (
        0x0003,
        entry(
            "The device's setup does not allow the state.",
            &[
                "modules are missing or in another order than configured",
                "a local switch forbids it",
            ],
            &["0xF030 against 0xF050: modules configured and found", "the maker's manual"],
            &["bring modules and configuration together"],
        ),
    ),
    (
        0x0004,
        entry(
            "Output or input data of another revision than the device has.",
            &["a configuration made for another firmware or hardware"],
            &["0x1018:03 and SII words 0x0C, 0x0D: the revision"],
            &["use the description of this revision"],
        ),
    ),
    (
        0x0006,
        entry(
            "The SII does not match the firmware.",
            &["the SII was written for another firmware", "an update of one without the other"],
            &["SII words 0x08 to 0x0F against 0x1018"],
            &["write the SII that belongs to the firmware, then switch the power off and on"],
        ),
    ),
    (
        0x0007,
        entry(
            "The firmware could not be updated; the old one still runs.",
            &["a damaged or foreign file", "the transfer was cut short"],
            &["the FoE error of the transfer"],
            &["repeat the update in BOOT with the right file"],
        ),
    ),
    (
        0x000E,
        entry(
            "A licence that the device or a function of it needs is missing.",
            &["the licence was never loaded or belongs to other hardware"],
            &["the maker's manual"],
            &["load the licence"],
        ),
    ),
    (
        0x0011,
        entry(
            "The requested change of state is not allowed from where the device is.",
            &[
                "a state was skipped: INIT to SAFEOP, PREOP to OP",
                "the device fell back by itself before the request, and its error was not \
                 acknowledged",
                "from BOOT only INIT is allowed",
            ],
            &["0x0130 before the request: state and error bit"],
            &["one step at a time: INIT, PREOP, SAFEOP, OP; acknowledge first (0x0120, bit 4)"],
        ),
    ),
    (
        0x0012,
        entry(
            "The requested state is none of INIT, PREOP, BOOT, SAFEOP, OP.",
            &["AL control was written with a wrong value, width or byte order"],
            &["0x0120 as it now reads"],
            &["write two bytes: 1, 2, 3, 4 or 8, and 0x10 to acknowledge"],
        ),
    ),
    (
        0x0013,
        entry(
            "The device has no BOOT state.",
            &["it takes firmware in PREOP, or not over EtherCAT"],
            &["SII words 0x14 to 0x17: 0 without boot mailbox"],
            &["follow the maker's way of updating"],
        ),
    ),
    (
        0x0014,
        entry(
            "There is no valid firmware: only the boot loader runs.",
            &["an update that was cut short"],
            &["0x100A, if the mailbox still answers"],
            &["go to BOOT and load the firmware again"],
        ),
    ),
    (
        0x0015,
        entry(
            "SM0 or SM1 is not as BOOT needs it.",
            &["the mailbox of PREOP was left: BOOT has addresses and sizes of its own"],
            &["0x0800 to 0x080F against SII words 0x14 to 0x17"],
            &["write the boot mailbox into SM0 and SM1 before BOOT is asked for"],
        ),
    ),
    (
        0x0016,
        entry(
            "SM0 or SM1 is not as the mailbox of PREOP needs it.",
            &[
                "address or length differ from the SII",
                "control byte is not 0x26 (SM0) and 0x22 (SM1), or bit 0 of 0x0806, 0x080E is off",
                "the boot mailbox was left in the SyncManagers",
                "in operation: a mailbox SyncManager was switched off or written anew",
            ],
            &["0x0800 to 0x080F against SII words 0x18 to 0x1B"],
            &["write SM0 and SM1 from the SII in INIT"],
        ),
    ),
    (
        0x0017,
        entry(
            "A SyncManager is not as the device needs it.",
            &[
                "length or address out of what the device allows",
                "SyncManagers overlap: three buffers take three times the length",
                "a SyncManager that must be off is on",
            ],
            &["0x0800 to 0x081F", "0x1C00: what each SyncManager is for"],
            &["write SyncManagers in INIT or PREOP from the SII and the assigned PDOs"],
        ),
    ),
    (
        0x0018,
        entry(
            "The device has no valid inputs to give.",
            &["its application or a module behind it has not started", "a sensor is missing"],
            &["0x10F3 and the maker's diagnosis objects"],
            &["wait and ask again", "see to what hangs behind the device"],
        ),
    ),
    (
        0x0019,
        entry(
            "No valid outputs came before OP.",
            &[
                "cyclic frames did not run before OP was asked for",
                "the outputs' datagram comes back with a wrong working counter",
                "an output is outside of what the device accepts",
            ],
            &["the working counter of LRW or LWR", "0x0440: the watchdog, which outputs feed"],
            &["send process data in SAFEOP for some cycles, then ask for OP"],
        ),
    ),
    (
        0x001A,
        entry(
            "The device lost synchronization, or did not find it: SM2 events and SYNC0 came in \
             wrong order too often, so it fell to SAFEOP or did not leave it.",
            &[
                "the frame's phase moves against SYNC0: the MainDevice's cycle is not locked onto \
                 the reference clock",
                "frames come too late: SYNC0 falls on the arrival of the frame or before it",
                "the host wakes up late now and then; the device allows few misses (0x10F1:02)",
                "lost frames",
                "clocks had not converged when SYNC0 was started",
                "OP was asked for before frames ran in phase: each SYNC0 needs a frame before it",
            ],
            &[
                "0x1C32:0B and :0C, 0x1C33:0B: which event was missed",
                "0x10F1:02: how many misses are allowed",
                "0x092C: whether its clock follows",
                "0x0990 against the time of the frame: how far SYNC0 lies behind it",
                "0x0300 to 0x0313: link errors",
            ],
            &[
                "lock the host onto the reference clock before OP",
                "shift SYNC0 away from the frame: at least calc and copy time (0x1C32:06) plus \
                 the host's jitter behind it",
                "raise 0x10F1:02 if the process allows it",
                "a longer cycle, or a quieter host",
            ],
        ),
    ),
    (
        0x001B,
        entry(
            "The process data watchdog expired: no outputs came for its time.",
            &[
                "cyclic frames stopped, or the MainDevice stalled for longer than the watchdog",
                "the outputs' SyncManager or FMMU was written anew in operation",
                "OP was asked for before outputs were sent",
                "a cycle that is longer than the watchdog time",
            ],
            &[
                "0x0440 bit 0, 0x0442: state and number of expiries",
                "0x0400 and 0x0420: the watchdog's time, (0x0400 + 2) x 40 ns x 0x0420",
                "the working counter of the outputs",
            ],
            &[
                "send outputs in each cycle before OP is asked for, and as long as it lasts",
                "a watchdog time of several cycles",
            ],
        ),
    ),
    (
        0x001C,
        entry(
            "The use of a SyncManager is not what the device has it for.",
            &["SyncManager types differ from 0x1C00: outputs and inputs exchanged"],
            &["0x1C00", "0x0804 + 8 n: control bytes"],
            &["give each SyncManager the control byte of its use"],
        ),
    ),
    (
        0x001D,
        entry(
            "SM2, the outputs' SyncManager, is not as the device needs it.",
            &[
                "its length is not the sum of the PDOs assigned in 0x1C12",
                "0x1C12 was written after the length was computed, or the write was refused",
                "address or control byte differ from the SII",
                "it is off though there are outputs, or on though there are none",
                "three times its length runs into the next SyncManager",
            ],
            &["0x0810 to 0x0817", "0x1C12 and the mapping objects 0x16xx it names"],
            &["assign PDOs first, read them back, then compute the length and write SM2"],
        ),
    ),
    (
        0x001E,
        entry(
            "SM3, the inputs' SyncManager, is not as the device needs it.",
            &[
                "its length is not the sum of the PDOs assigned in 0x1C13",
                "0x1C13 was written after the length was computed, or the write was refused",
                "address or control byte differ from the SII",
                "it is off though there are inputs, or on though there are none",
                "it lies in the three buffers of SM2 or in the mailbox",
            ],
            &["0x0818 to 0x081F", "0x1C13 and the mapping objects 0x1Axx it names"],
            &["assign PDOs first, read them back, then compute the length and write SM3"],
        ),
    ),
    (
        0x001F,
        entry(
            "Watchdog settings contradict each other or what the device allows.",
            &[
                "SM2's watchdog trigger (control bit 6) is off and the watchdog has a time, or \
                 the other way",
                "a time that the device does not allow",
            ],
            &["0x0400, 0x0420", "0x0814 bit 6"],
            &["set 0x0420 to 0 where SM2 does not trigger the watchdog, else to some cycles"],
        ),
    ),
    (
        0x0020,
        entry(
            "What was changed takes effect after the power was off.",
            &["a parameter, an address or a firmware was written"],
            &["the maker's manual"],
            &["switch the device off and on"],
        ),
    ),
    (
        0x0021,
        entry(
            "The device wants to go through INIT first.",
            &["a setting was changed that is taken over in INIT"],
            &["0x10F3"],
            &["ask for INIT, then go up again"],
        ),
    ),
    (
        0x0022,
        entry(
            "The device wants to go through PREOP first.",
            &["a setting was changed that is taken over in PREOP: PDOs, synchronization type"],
            &["0x10F3"],
            &["ask for PREOP, then go up again"],
        ),
    ),
    (
        0x0023,
        entry(
            "The device wants to go through SAFEOP first.",
            &["a fault of the application that is cleared there"],
            &["0x10F3"],
            &["ask for SAFEOP, then for OP"],
        ),
    ),
    (
        0x0024,
        entry(
            "The inputs' PDO mapping can't be used.",
            &[
                "0x1C13 or a 0x1Axx object names what does not exist or can't be mapped",
                "too many or too long PDOs",
                "PDOs that exclude each other are assigned together",
            ],
            &["0x1C13, then each 0x1Axx it names"],
            &["write sub-index 0 as 0, the entries, then their number; one SDO at a time, read \
                 back"],
        ),
    ),
    (
        0x0025,
        entry(
            "The outputs' PDO mapping can't be used.",
            &[
                "0x1C12 or a 0x16xx object names what does not exist or can't be mapped",
                "too many or too long PDOs",
                "PDOs that exclude each other are assigned together",
            ],
            &["0x1C12, then each 0x16xx it names"],
            &["write sub-index 0 as 0, the entries, then their number; one SDO at a time, read \
                 back"],
        ),
    ),
    (
        0x0026,
        entry(
            "Settings do not go together.",
            &[
                "0x1C32:01 and 0x1C33:01 name types that can't be combined, such as SYNC0 and SM3",
                "the type that was written does not fit the SYNC unit",
            ],
            &["0x1C32:01, 0x1C33:01", "0x0981"],
            &["one mode for both: `isocat explain modes` lists the types of each"],
        ),
    ),
    (
        0x0027,
        entry(
            "The device can't run free: it wants to be synchronized.",
            &[
                "no SYNC unit was programmed and 0x1C32:01 is 0",
                "0x1C32:01 was never written and the device starts in Free Run",
            ],
            &["0x1C32:04, 0x1C33:04: what it can do", "0x0981: whether SYNC is on"],
            &["choose a mode that :04 names; for DC write 0x0981 before SAFEOP is asked for"],
        ),
    ),
    (
        0x0028,
        entry(
            "The device can't be synchronized as asked.",
            &[
                "0x1C32:01 or 0x1C33:01 name SM-synchronous, and :04 has no bit 1",
                "DC was asked for from a device that has only Free Run",
            ],
            &["0x1C32:04, 0x1C33:04"],
            &["choose a mode that :04 names"],
        ),
    ),
    (
        0x0029,
        entry(
            "In Free Run the process data need three buffers, and a SyncManager has one.",
            &["control byte of SM2 or SM3 with mode 2 (0x22, 0x26) instead of 0 (0x20, 0x64)"],
            &["0x0814, 0x081C: bits 1:0"],
            &["set bits 1:0 to 0", "synchronize the device instead"],
        ),
    ),
    (
        0x002A,
        entry(
            "The device's own watchdog over its tasks expired.",
            &[
                "its processor is overloaded: the cycle is too short for it",
                "a fault of its firmware",
            ],
            &["0x1C32:0C", "0x1C32:05 against the cycle"],
            &["a longer cycle", "ask the maker"],
        ),
    ),
    (
        0x002B,
        entry(
            "Neither inputs nor outputs are valid.",
            &["process data do not run", "the application or a module behind it has not started"],
            &["working counters", "0x10F3"],
            &["send process data before OP is asked for"],
        ),
    ),
    (
        0x002C,
        entry(
            "SYNC0 or SYNC1 was there and is no longer seen.",
            &[
                "0x0981 or the SYNC cycle was written in operation",
                "the offset 0x0920 was written: the next pulse lies far away",
                "the ESC was reset or lost its supply",
                "SYNC is not mapped to the processor (0x0151), or its interrupt is blocked",
                "the pulse is not acknowledged before the next (0x0982 is 0), or is as long as the \
                 cycle",
            ],
            &[
                "0x0981: still on",
                "0x0982, 0x098E",
                "0x0990 less 0x0910: the next pulse must lie within one cycle",
                "0x09A0, 0x09A4",
            ],
            &[
                "leave the SYNC unit and 0x0920 alone in SAFEOP and OP",
                "to change them: PREOP, 0x0981 = 0, new values, new start time, 0x0981",
            ],
        ),
    ),
    (
        0x002D,
        entry(
            "No SYNC was seen on the way to OP (the code's short name means: no sync).",
            &[
                "the start time (0x0990) lay in the past or was 0: the first pulse comes after \
                 the clock has wrapped",
                "SYNC is activated after SAFEOP was asked for, or not at all",
                "the cycle (0x09A0) was overwritten, or is 0",
                "SYNC is not mapped to the processor (SII word 1, 0x0151 bits 3 and 7)",
                "the pulse is too short for the processor, or 0 without acknowledgement (0x0982)",
            ],
            &[
                "0x0984 bit 0: the first pulse is still pending",
                "0x0990 less 0x0910: more than a cycle means a start in the past",
                "0x0981, 0x09A0, 0x0982, 0x0151",
            ],
            &[
                "start time = system time of the reference clock + 100 ms, rounded up to the cycle",
                "order: 0x0981 = 0, 0x09A0, 0x0990, 0x0981; all before SAFEOP is asked for",
            ],
        ),
    ),
    (
        0x002E,
        entry(
            "The cycle is too short for the device. Older lists give this number to an invalid \
             FMMU of the inputs.",
            &["cycle time below 0x1C32:05", "a device of the older list: an FMMU is wrong"],
            &["0x1C32:05 and :02", "0x0600 and on: the FMMUs"],
            &["a longer cycle", "write the FMMUs anew"],
        ),
    ),
    (
        0x0030,
        entry(
            "The SYNC unit is not set as the device can use it.",
            &[
                "0x0981 makes a signal that 0x1C32:04 or 0x1C33:04 do not name, SYNC1 most often",
                "0x0981 is on and makes neither SYNC0 nor SYNC1, or SYNC1 without SYNC0",
                "0x1C32:01 asks for SYNC0 or SYNC1 and the unit is off",
                "SYNC1 comes a SYNC0 cycle or more after SYNC0 (subordinated cycles), and bit 4 \
                 of :04 is off",
                "another OpMode of the device description was meant",
            ],
            &[
                "0x0980, 0x0981, 0x09A0, 0x09A4",
                "0x1C32:04, 0x1C33:04: bits 2 (SYNC0), 3 (SYNC1), 4 (subordinated)",
                "0x1C32:01, 0x1C33:01",
            ],
            &[
                "write the AssignActivate word of the device description: 0x0300 for SYNC0",
                "let 0x1C32:01 and 0x0981 say the same before SAFEOP is asked for",
            ],
        ),
    ),
    (
        0x0031,
        entry(
            "The latch units are not set as the device can use them.",
            &["AssignActivate without the latch bits (0x0010, 0x0020) that the device needs"],
            &["0x0980 bits 4 and 5, 0x09A8, 0x09A9"],
            &["write the AssignActivate word of the device description"],
        ),
    ),
    (
        0x0032,
        entry(
            "SYNC is seen, but the device's own PLL could not lock onto it, or lost it.",
            &[
                "the reference clock is steered by a jittery host: each correction reaches every \
                 device",
                "clocks had not converged when SYNC0 was started",
                "the SYNC0 cycle is none that the drive knows (often 62.5, 125, 250 us, n x 500 us)",
                "the SYNC0 cycle does not agree with the cycle set in the drive (0x60C2)",
                "frames come too close to SYNC0, or jitter",
            ],
            &["0x092C over some seconds", "0x09A0 against 0x1C32:05 and 0x60C2", "0x1C32:0B"],
            &[
                "let the host follow the reference clock, not the other way",
                "wait until 0x092C stays below some 100 ns before SYNC is started",
                "a cycle of the maker's list, the same in 0x60C2",
                "acknowledge and ask for OP again: some drives need seconds to lock",
            ],
        ),
    ),
    (
        0x0033,
        entry(
            "Inputs and outputs are no longer synchronous to SYNC.",
            &["the same as for 0x001A, seen by the device's hardware", "a fault of its modules"],
            &["0x1C32:0B, :0C, 0x1C33:0B", "0x10F3"],
            &["as for 0x001A"],
        ),
    ),
    (
        0x0034,
        entry(
            "Too many SM events or SYNC events were missed in operation.",
            &[
                "frames late or lost; the host is not locked onto the reference clock",
                "frame and SYNC0 too close to each other",
            ],
            &["0x1C32:0B, 0x1C33:0B", "0x10F1:02", "0x0300 to 0x0313"],
            &["as for 0x001A"],
        ),
    ),
    (
        0x0035,
        entry(
            "The SYNC cycle is none that the device can use.",
            &[
                "it is no multiple of the device's own step, 62.5, 125 or 250 us as a rule",
                "it contradicts the cycle in 0x1C32:02 or 0x60C2",
            ],
            &["0x09A0", "0x1C32:02, :05", "0x60C2"],
            &[
                "a multiple of the device's step, or a cycle of the maker's list; the same in all places",
            ],
        ),
    ),
    (
        0x0036,
        entry(
            "SYNC0's cycle is not what the device allows.",
            &[
                "below the minimum cycle time 0x1C32:05",
                "above the longest cycle that its timers hold; no object states it",
                "0: a single pulse instead of a cycle",
                "the device has a fixed SYNC0 (subordinated cycles, 0x1C32:0A), and the bus cycle \
                 was written",
            ],
            &["0x09A0", "0x1C32:05, :0A"],
            &[
                "a cycle of at least 0x1C32:05, and at most what its manual states",
                "where its manual states steps: a multiple of them, or a cycle of its list (0x0035)",
                "with subordinated cycles: 0x09A0 = 0x1C32:0A",
            ],
        ),
    ),
    (
        0x0037,
        entry(
            "SYNC1's cycle is not what the device allows.",
            &[
                "0x09A4 was taken for a period: it is the distance from a SYNC0 to SYNC1, period \
                 less SYNC0's cycle",
                "a distance below the calc and copy time 0x1C32:06",
            ],
            &["0x09A4 and 0x09A0", "0x1C32:06"],
            &["0x09A4 = period of SYNC1 - 0x09A0 + shift"],
        ),
    ),
    (
        0x0041,
        entry(
            "The AoE service in the mailbox failed fatally.",
            &["a protocol that the device does not fully have", "a fault of its firmware"],
            &["SII word 0x1C: which protocols it has"],
            &["go to INIT and up again"],
        ),
    ),
    (
        0x0042,
        entry(
            "The EoE service in the mailbox failed fatally.",
            &["no IP address was set, or one twice", "a fault of its firmware"],
            &["SII word 0x1C: which protocols it has"],
            &["set the IP parameters in PREOP", "go to INIT and up again"],
        ),
    ),
    (
        0x0043,
        entry(
            "The CoE service in the mailbox failed fatally.",
            &["a start-up SDO was refused that the device insists on", "a fault of its firmware"],
            &["the abort codes of the last downloads"],
            &["correct the start-up list", "go to INIT and up again"],
        ),
    ),
    (
        0x0044,
        entry(
            "The FoE service in the mailbox failed fatally.",
            &["a file transfer was cut short"],
            &["the FoE error of the transfer"],
            &["go to INIT, then repeat the transfer"],
        ),
    ),
    (
        0x0045,
        entry(
            "The SoE service in the mailbox failed fatally.",
            &["an IDN that the drive insists on was refused: telegram, cycle time IDN 1 and 2"],
            &["the SoE errors of the last writes"],
            &["correct the start-up list", "go to INIT and up again"],
        ),
    ),
    (
        0x004F,
        entry(
            "The maker's own mailbox protocol (VoE) failed fatally.",
            &["known to the maker only"],
            &["the maker's manual"],
            &["go to INIT and up again"],
        ),
    ),
    (
        0x0050,
        entry(
            "The device has no access to its EEPROM.",
            &["the MainDevice kept it: 0x0500 was not given to the PDI"],
            &["0x0500 bit 0, 0x0501"],
            &["write 1 to 0x0500 once the SII has been read"],
        ),
    ),
    (
        0x0051,
        entry(
            "The device could not read or write its EEPROM.",
            &["a damaged EEPROM or wiring", "two sides wrote at once"],
            &["0x0502: error bits"],
            &["write the SII anew; replace the device"],
        ),
    ),
    (
        0x0052,
        entry(
            "Hardware outside of the device is not ready.",
            &["a supply is missing", "a module or motor is not plugged in"],
            &["0x10F3 and the maker's diagnosis objects"],
            &["see to supply and wiring, then ask for the state again"],
        ),
    ),
    (
        0x0060,
        entry(
            "The device restarted by itself.",
            &["its supply dipped", "its own watchdog reset it", "a local reset was asked for"],
            &["0x10F3", "0x0310 to 0x0313: lost links of its neighbours"],
            &["bring it up from INIT: clock, delay, SYNC unit and mapping are gone"],
        ),
    ),
    (
        0x0061,
        entry(
            "The identification that the device shows was changed: no fault.",
            &["a selector switch was turned", "the identification was asked for (0x0120, bit 5)"],
            &["0x0134 then holds the identification, and 0x0130 bit 5 is set"],
            &["nothing"],
        ),
    ),
    (
        0x0070,
        entry(
            "The modules that were found are not those that were configured.",
            &["a module is missing, was added, or stands in another slot"],
            &["0xF030 (configured) against 0xF050 (found)"],
            &["bring modules and configuration together"],
        ),
    ),
    (
        0x0080,
        entry(
            "The supply voltage is too low.",
            &["supply off or overloaded", "long supply lines"],
            &["the maker's diagnosis objects"],
            &["see to the supply"],
        ),
    ),
    (
        0x0081,
        entry(
            "The supply voltage is too high.",
            &["wrong supply", "a drive that brakes without a brake resistor"],
            &["the maker's diagnosis objects"],
            &["see to the supply"],
        ),
    ),
    (
        0x0082,
        entry(
            "The temperature is too low.",
            &["the surroundings are colder than allowed"],
            &["the maker's diagnosis objects"],
            &["let it warm up"],
        ),
    ),
    (
        0x0083,
        entry(
            "The temperature is too high.",
            &["a fan or the airflow is blocked", "overload"],
            &["the maker's diagnosis objects"],
            &["see to cooling and load"],
        ),
    ),
    (
        0x00F0,
        entry(
            "The application's processor has become available: a note, no fault.",
            &["it started after the ESC"],
            &["0x0130"],
            &["go on as usual"],
        ),
    ),
];
