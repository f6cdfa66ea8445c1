//! The ESC's registers that matter to synchronization.

use super::{Entry, entry};

/// One register, or an array of equal ones.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct RegisterEntry {
    /// First address.
    pub address: u16,
    /// Length in bytes.
    pub length: u16,
    /// The name of the register.
    pub name: &'static str,
    /// The explanation.
    pub entry: Entry,
}

/// The register that holds this address.
pub fn explain(address: u16) -> Option<&'static RegisterEntry> {
    let after = REGISTERS.partition_point(|register| register.address <= address);
    let register = REGISTERS.get(after.checked_sub(1)?)?;
    (address - register.address < register.length).then_some(register)
}

const fn register(
    address: u16,
    length: u16,
    name: &'static str,
    means: &'static str,
    causes: &'static [&'static str],
    read: &'static [&'static str],
    change: &'static [&'static str],
) -> RegisterEntry {
    RegisterEntry { address, length, name, entry: entry(means, causes, read, change) }
}

/// The registers by ascending address.
pub(crate) static REGISTERS: [RegisterEntry; 30] = [
    register(
        0x0008,
        2,
        "ESC features",
        "What the chip has: bit 2 distributed clocks, bit 3 of 64 bits, bit 8 enhanced SYNC \
         activation (0x0984 exists).",
        &[],
        &["bit 2 clear: no system time, the device can't be a DC device"],
        &["nothing: it is fixed"],
    ),
    register(
        0x0120,
        2,
        "AL control",
        "The state that the MainDevice asks for: 1 INIT, 2 PREOP, 3 BOOT, 4 SAFEOP, 8 OP; bit 4 \
         acknowledges an error.",
        &[],
        &["0x0130: where the device is", "0x0134: why not"],
        &["one step at a time; after an error with bit 4"],
    ),
    register(
        0x0130,
        2,
        "AL status",
        "The state that the device is in; bit 4: it refused or left a state, 0x0134 says why.",
        &[],
        &["0x0134"],
        &["acknowledge by 0x0120 bit 4, then ask again"],
    ),
    register(
        0x0134,
        2,
        "AL status code",
        "Why a state was refused or left: `isocat explain 0x001A` explains a code.",
        &[],
        &["0x0130 bit 4: whether it still holds"],
        &["what the code's explanation says"],
    ),
    register(
        0x0140,
        2,
        "PDI control and ESC configuration",
        "0x0141 bit 0: device emulation (AL status mirrors AL control), bit 2: SYNC unit on, bit \
         3: latch unit on.",
        &["bit 2 of 0x0141 clear: no SYNC pins and no pulses, whatever 0x0981 says"],
        &["SII word 0, which it is loaded from"],
        &["write the SII, then switch off and on"],
    ),
    register(
        0x0150,
        2,
        "PDI and SYNC/LATCH configuration",
        "0x0151 bits 3 and 7: SYNC0 and SYNC1 are mapped to AL events (0x0220 bits 2, 3); bits 2 \
         and 6: pins are outputs.",
        &["bit 3 clear: the device's processor never sees SYNC0 by its interrupt, 0x002D follows"],
        &["SII word 1, which it is loaded from"],
        &["write the SII, then switch off and on"],
    ),
    register(
        0x0300,
        20,
        "error counters",
        "0x0300 to 0x0307: invalid frames and RX errors at ports 0 to 3; 0x0308: errors \
         forwarded; 0x0310: lost links.",
        &[
            "cable, connector or supply at the first port that counts",
            "EMC: errors come with a load switching",
        ],
        &["the same at the neighbours: the first device that counts is next to the fault"],
        &["replace the cable between it and the one before; write 0x0300 to reset"],
    ),
    register(
        0x0400,
        2,
        "watchdog divider",
        "The watchdog's unit is (this + 2) times 40 ns; 0x09C2 gives 100 us.",
        &[],
        &["0x0420"],
        &["leave it; change 0x0420"],
    ),
    register(
        0x0420,
        2,
        "process data watchdog time",
        "How long outputs may stay away, in units of 0x0400; 0: never watched. When it is over: \
         0x001B.",
        &[],
        &["0x0440: running or expired", "0x0442: how often"],
        &["several cycles; 1000 (100 ms) is usual"],
    ),
    register(
        0x0900,
        16,
        "receive times",
        "When the frame that wrote 0x0900 passed each port, in local time, 32 bits each. Delays \
         are computed from them.",
        &[],
        &["0x0110: which ports are open", "0x0918 for the time at the processing unit"],
        &["write 0x0900 by broadcast, then read; average over several, each port has a 10 ns tick"],
    ),
    register(
        0x0910,
        8,
        "system time",
        "Read: the device's system time, ns since 2000, less its delay, as of the frame's \
         beginning. Written: the drift loop compares with it; the clock does not jump.",
        &[
            "0 or running apart: no FRMW or ARMW reaches the device",
            "upper half 0: a clock of 32 bits, it wraps after 4.3 s",
            "differs by seconds: 0x0920 was not written",
        ],
        &["0x092C: what the loop sees", "0x0920, 0x0928: offset and delay", "0x0008 bits 2 and 3"],
        &["distribute the reference clock's time in each cycle (FRMW or ARMW of 0x0910)"],
    ),
    register(
        0x0918,
        8,
        "receive time of the processing unit",
        "When the frame that wrote 0x0900 reached the processing unit, in local time: what the \
         offset is computed from.",
        &[],
        &["0x0920"],
        &["nothing: it is read only"],
    ),
    register(
        0x0920,
        8,
        "system time offset",
        "What is added to the local time to get system time, ns; often negative.",
        &["0 while others are not: the device was switched on later, or forgotten"],
        &["0x0910 against the reference clock's"],
        &["write it before SYNC is activated, never in SAFEOP or OP: pulses would be missed"],
    ),
    register(
        0x0928,
        4,
        "system time delay",
        "Propagation delay from the reference clock to this device, ns: about 5 ns for a metre of cable, \
         some 100 ns for each device on the way.",
        &[
            "0 behind the reference clock: delays were not measured",
            "jumps: a ring was closed or a cable swapped",
        ],
        &["0x0900 to 0x090F, 0x0110"],
        &["measure again: several latches of 0x0900, averaged"],
    ),
    register(
        0x092C,
        4,
        "system time difference",
        "How far the device's clock is from the time it receives, filtered: bits 30:0 the size in \
         ns, bit 31 the sign (1: ahead). Not two's complement.",
        &[
            "0x80000000 and near: agrees; read as a signed number it looks like -2 s",
            "some 10 ns, changing sign: as good as it gets",
            "stays large or grows: no FRMW, or the loop was stopped (0x0930)",
            "large just after start: the loop needs some thousand frames",
            "jumps now and then: the reference clock is steered by a jittery host",
        ],
        &[
            "0x0910 twice: does it run",
            "0x0930 to 0x0935: the loop's settings",
            "0x0932: speed correction",
        ],
        &[
            "wait until it stays below some 100 ns before SYNC is activated",
            "let the host follow the reference clock",
        ],
    ),
    register(
        0x0930,
        2,
        "speed counter start",
        "Bandwidth of the drift loop; writing it resets the loop's filters. 0x1000 at power-on.",
        &["0: the loop stands still"],
        &["0x092C"],
        &["write 0x1000 once, after the offset"],
    ),
    register(
        0x0932,
        2,
        "speed counter difference",
        "The present speed correction, signed: 84 of it make about 1 ppm with 0x0930 = 0x1000.",
        &["at its limit: the clock is more than 700 ppm off, or the loop is fed nonsense"],
        &["0x092C"],
        &["nothing: it is read only"],
    ),
    register(
        0x0934,
        2,
        "filter depths",
        "0x0934 averages the time difference, 0x0935 the speed; each step doubles the samples. \
         0x0C00 as a word is usual.",
        &[],
        &["0x092C"],
        &["greater: calmer and slower; 0x00 and 0x0C before SYNC is started"],
    ),
    register(
        0x0980,
        1,
        "cyclic unit control",
        "Who owns the units: bit 0 the SYNC unit, bits 4 and 5 latch units 0 and 1; 0 the \
         MainDevice (ECAT), 1 the PDI. The low byte of AssignActivate.",
        &["bit 0 set: what the MainDevice writes to 0x0981 and on is ignored"],
        &["0x0981"],
        &["write it with 0x0981 as one word; some drives take offence at a write of the same \
             value alone"],
    ),
    register(
        0x0981,
        1,
        "SYNC activation",
        "Bit 0: unit on, bit 1: SYNC0, bit 2: SYNC1; bits 3 to 7 in newer chips: on by start \
         time, 32-bit start, check of the start time, near future, test pulse. The high byte of \
         AssignActivate.",
        &[
            "0 in OP of a DC device: it was never programmed, or it was cleared",
            "on from the last run: a new start time is not taken before it is 0",
        ],
        &["0x0984, 0x0990", "0x1C32:01: must agree"],
        &["order: 0, then 0x09A0, 0x0990, then this; before SAFEOP is asked for"],
    ),
    register(
        0x0982,
        2,
        "SYNC pulse length",
        "In 10 ns, from SII word 2. 0 is acknowledge mode: the pulse stays until the device reads \
         0x098E.",
        &["too short for the processor's pin, or longer than the cycle: no edges"],
        &["SII word 2", "0: 0x098E; a pulse that is due before the read makes no edge"],
        &["write the SII, then switch off and on"],
    ),
    register(
        0x0984,
        1,
        "SYNC activation status",
        "Bit 0: the first SYNC0 is still to come, bit 1: the first SYNC1, bit 2: the start time \
         was not in the near future. Newer chips only (0x0008 bit 8).",
        &["bit 0 stays set: the start time lies in the past, or far ahead"],
        &["0x0990 less 0x0910: when the pulse comes"],
        &["program the unit again with a start 100 ms ahead"],
    ),
    register(
        0x098E,
        2,
        "SYNC status",
        "0x098E SYNC0, 0x098F SYNC1, in acknowledge mode (0x0982 = 0): the processor reads it to \
         end the pulse.",
        &[
            "stays 1: the processor does not serve the interrupt",
            "1 when the next pulse is due: it is acknowledged too late, and that pulse is lost",
        ],
        &["0x0982"],
        &["nothing from the bus"],
    ),
    register(
        0x0990,
        8,
        "SYNC start time, next SYNC0",
        "Written while the unit is off: the instant of the first SYNC0, in system time. Read: the \
         next SYNC0.",
        &[
            "less than 0x0910: a start in the past; the pulse comes when the clock has wrapped, \
             after 4.3 s or never",
            "more than a cycle ahead: still waiting for the start, or off the grid",
        ],
        &["0x0910 of the same device", "0x0984"],
        &["one start for all devices from one reading of the reference clock: + 100 ms, rounded \
             up to the common cycle, plus the phase"],
    ),
    register(
        0x0998,
        8,
        "next SYNC1",
        "Read: the instant of the next SYNC1. The first one comes 0x09A4 after the start time.",
        &[],
        &["0x09A4", "0x0984 bit 1"],
        &["nothing: it is read only"],
    ),
    register(
        0x09A0,
        4,
        "SYNC0 cycle time",
        "From SYNC0 to SYNC0, ns; steps of 10 ns. 0: a single pulse.",
        &[
            "differs from the bus cycle: oversampling or subordinated cycles, or a slip",
            "below 0x1C32:05: 0x0036",
        ],
        &["0x1C32:05, :02, :0A"],
        &["write it while 0x0981 is 0; four bytes, or eight together with 0x09A4"],
    ),
    register(
        0x09A4,
        4,
        "SYNC1 cycle time",
        "Not a period: the distance from a SYNC0 to SYNC1, ns. SYNC1 repeats every floor(0x09A4 / \
         0x09A0) + 1 cycles of SYNC0; 0: with SYNC0.",
        &["the period was written: SYNC1 comes at half the rate or less"],
        &["0x0998", "0x09A0"],
        &["period of SYNC1 - 0x09A0 + shift"],
    ),
    register(
        0x09A8,
        2,
        "latch control",
        "0x09A8 latch 0, 0x09A9 latch 1: bit 0 positive edge, bit 1 negative edge; 0 continuous, \
         1 single event.",
        &[],
        &["0x09AE, 0x09AF", "0x0980 bits 4, 5: whether EtherCAT or the PDI owns the unit"],
        &["as the application needs it"],
    ),
    register(
        0x09AE,
        2,
        "latch status",
        "0x09AE latch 0, 0x09AF latch 1: bit 0 a positive, bit 1 a negative edge was taken \
         (single event), bit 2 the pin.",
        &[],
        &["0x09B0 to 0x09CF: the times"],
        &["nothing: it is read only"],
    ),
    register(
        0x09B0,
        32,
        "latch times",
        "System time of the edges: 0x09B0 and 0x09B8 latch 0, 0x09C0 and 0x09C8 latch 1, positive \
         and negative.",
        &[],
        &["0x09AE, 0x09AF first"],
        &["nothing: they are read only"],
    ),
];
