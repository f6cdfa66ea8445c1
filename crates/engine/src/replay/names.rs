//! Names of registers and areas in a comparison.

/// The name of this address of an ESC's memory: a register, a unit, or RAM.
pub(crate) fn name(address: u16) -> String {
    let numbered = |what: &str, first: u16, size: u16, fields: &[&str]| {
        let (number, field) = ((address - first) / size, (address - first) % size);
        format!("{what} {number} {}", fields[usize::from(field)])
    };
    match address {
        0x0600..0x0700 => numbered("FMMU", 0x0600, 16, &FMMU),
        0x0800..0x0880 => numbered("SyncManager", 0x0800, 8, &SYNC_MANAGER),
        0x1000.. => "process RAM".to_owned(),
        _ => match REGISTERS.iter().rev().find(|(first, _)| *first <= address) {
            Some((_, name)) => (*name).to_owned(),
            None => "reserved".to_owned(),
        },
    }
}

/// The fields of a FMMU, byte by byte.
const FMMU: [&str; 16] = {
    let mut fields = ["logical start"; 16];
    let later = [
        "length",
        "length",
        "start bit",
        "stop bit",
        "physical start",
        "physical start",
        "physical start bit",
        "type",
        "activate",
        "reserved",
        "reserved",
        "reserved",
    ];
    let mut at = 0;
    while at < later.len() {
        fields[4 + at] = later[at];
        at += 1;
    }
    fields
};

/// The fields of a SyncManager, byte by byte.
const SYNC_MANAGER: [&str; 8] =
    ["start", "start", "length", "length", "control", "status", "activate", "PDI control"];

/// The first address of each register or gap, ascending (ESC data sheet, section II).
const REGISTERS: [(u16, &str); 80] = [
    (0x0000, "type"),
    (0x0001, "revision"),
    (0x0002, "build"),
    (0x0004, "FMMU count"),
    (0x0005, "SyncManager count"),
    (0x0006, "RAM size"),
    (0x0007, "port descriptor"),
    (0x0008, "features"),
    (0x000A, "reserved"),
    (0x0010, "station address"),
    (0x0012, "station alias"),
    (0x0014, "reserved"),
    (0x0020, "register write enable"),
    (0x0021, "register write protection"),
    (0x0022, "reserved"),
    (0x0030, "ESC write enable"),
    (0x0031, "ESC write protection"),
    (0x0032, "reserved"),
    (0x0040, "ESC reset"),
    (0x0042, "reserved"),
    (0x0100, "DL control"),
    (0x0104, "reserved"),
    (0x0108, "physical read/write offset"),
    (0x010A, "reserved"),
    (0x0110, "DL status"),
    (0x0112, "reserved"),
    (0x0120, "AL control"),
    (0x0122, "reserved"),
    (0x0130, "AL status"),
    (0x0132, "reserved"),
    (0x0134, "AL status code"),
    (0x0136, "reserved"),
    (0x0138, "RUN LED"),
    (0x0139, "ERR LED"),
    (0x013A, "reserved"),
    (0x0140, "PDI control"),
    (0x0141, "ESC configuration"),
    (0x0142, "reserved"),
    (0x014E, "PDI information"),
    (0x0150, "PDI configuration"),
    (0x0154, "reserved"),
    (0x0200, "ECAT event mask"),
    (0x0202, "reserved"),
    (0x0204, "AL event mask"),
    (0x0208, "reserved"),
    (0x0210, "ECAT event request"),
    (0x0212, "reserved"),
    (0x0220, "AL event request"),
    (0x0224, "reserved"),
    (0x0300, "port error counters"),
    (0x030C, "EPU and PDI error counters"),
    (0x0310, "lost link counters"),
    (0x0314, "reserved"),
    (0x0400, "watchdog divider"),
    (0x0402, "reserved"),
    (0x0410, "PDI watchdog time"),
    (0x0412, "reserved"),
    (0x0420, "process data watchdog time"),
    (0x0422, "reserved"),
    (0x0440, "process data watchdog status"),
    (0x0442, "watchdog counters"),
    (0x0444, "reserved"),
    (0x0500, "EEPROM configuration"),
    (0x0501, "EEPROM PDI access"),
    (0x0502, "EEPROM control and status"),
    (0x0504, "EEPROM address"),
    (0x0508, "EEPROM data"),
    (0x0510, "MII management"),
    (0x051C, "reserved"),
    (0x0900, "receive times"),
    (0x0910, "system time"),
    (0x0918, "receive time of the EPU"),
    (0x0920, "system time offset"),
    (0x0928, "system time delay"),
    (0x092C, "system time difference"),
    (0x0930, "speed counters and filters"),
    (0x0980, "SYNC and latch units"),
    (0x0E00, "chip specific"),
    (0x0F00, "digital outputs, general purpose I/O"),
    (0x0F80, "user RAM"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_at_the_edges() {
        for (address, expected) in [
            (0x0000, "type"),
            (0x000A, "reserved"),
            (0x0111, "DL status"),
            (0x0112, "reserved"),
            (0x0600, "FMMU 0 logical start"),
            (0x061C, "FMMU 1 activate"),
            (0x06FF, "FMMU 15 reserved"),
            (0x0805, "SyncManager 0 status"),
            (0x087F, "SyncManager 15 PDI control"),
            (0x0FFF, "user RAM"),
            (0x1000, "process RAM"),
            (0xFFFF, "process RAM"),
        ] {
            assert_eq!(name(address), expected, "{address:#06x}");
        }
        assert!(REGISTERS.is_sorted_by(|(a, _), (b, _)| a < b));
    }
}
