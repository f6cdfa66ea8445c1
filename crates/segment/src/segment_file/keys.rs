//! Every key of a segment file, declared: name, values, default, effect and destination.
//!
//! The parser uses these tables, and `isocat explain`, `docs/segment-file.md` and
//! `docs/segment-file.schema.json` are made from them. A new key is added here and read in
//! `segment_file.rs`; a test refuses a key that has only one of both.

mod clock;
mod expect;
mod fault;
mod module;
mod operation;
mod output;
mod plant;

pub(super) use clock::LONGEST_RUN;
pub(super) use module::{MODULE, MODULE_EXPECTED, MOST_PLACES, SLOT_EXPECTED};
pub(super) use operation::{DIRECTIONS, MARGIN, RECOVERY};
pub(super) use output::TYPES;
pub(super) use plant::COMMANDS;

use isocat_descriptions::document::section::{Choice, Key, Kind, Limit, Need, Rule, Section, Word};
use isocat_esc::chip::PortKind;
use isocat_wire::time::Nanos;

use super::misbehave;
use crate::{chips, profile};

/// The whole file.
pub static FILE: Section = Section {
    head: "",
    means: "A segment: which devices stand on the wire, how they are synchronized, for how long.",
    keys: &[
        Key {
            name: "cycle",
            kind: Kind::duration(SHORTEST_CYCLE, LONGEST_CYCLE),
            need: Need::Required("the bus cycle, such as cycle = \"1ms\""),
            means: "Bus cycle: the time from one exchange of process data to the next.",
            goes: "Config::cycle; register 0x09A0 in DC modes, object 0x1C32:02",
            example: r#""1ms""#,
        },
        Key {
            name: "for",
            kind: Kind::Duration { least: CYCLE, most: Limit::At(LONGEST_RUN.0), whole: 1 },
            need: Need::Default(r#""10s""#),
            means: "How long the run is judged once all devices are in OP.",
            goes: "the run; --for of the command goes before it",
            example: r#""2s""#,
        },
        Key {
            name: "seed",
            kind: Kind::Integer { least: 0, most: i64::MAX },
            need: Need::Default("1"),
            means: "Seed of everything random in the simulation. The same seed gives the same run.",
            goes: "the simulation; --seed of the command goes before it",
            example: "42",
        },
        Key {
            name: "drift_law",
            kind: Kind::Choice(Choice(&chips::LAWS)),
            need: Need::Without("what each device's chip has: hold"),
            means: "How the drift loops of all devices turn time differences into a speed. No maker publishes it.",
            goes: "the simulated clocks; --drift-law of the command goes before it",
            example: r#""block""#,
        },
        chips::DRIFT_PHASE,
        chips::DRIFT_GAIN,
        Key {
            name: "shift",
            kind: BELOW_CYCLE,
            need: Need::Without("the plan takes the phase that leaves all devices most slack"),
            means: "Wanted phase of SYNC0: from the start of the bus cycle to the pulse.",
            goes: "Config::shift; register 0x0990",
            example: r#""120us""#,
        },
        Key {
            name: "sync0_limit",
            kind: LIMIT,
            need: Need::Default(r#""1us""#),
            means: "Largest error of a SYNC0 edge, from the grid that was asked for, with which a \
                    device counts as synchronized. The plan compares its clock error with it.",
            goes: "Config::limits, the plan and the judges of the run",
            example: r#""500ns""#,
        },
        Key {
            name: "outputs_spread",
            kind: LIMIT,
            need: Need::Default(r#""1us""#),
            means: "Largest spread of the time from the acting pulse to Outputs Valid with which a \
                    device counts as synchronized. The plan compares the jitter of its CPU with it.",
            goes: "Config::limits, the plan and the judges of the run; 1 us is what objects \
                   0x1C32:07 and 0x1C32:09 may differ by",
            example: r#""10us""#,
        },
        Key {
            name: "watchdog",
            kind: Kind::Duration {
                least: Limit::At(WATCHDOG_STEP),
                most: Limit::At(WATCHDOG_STEP * u16::MAX as i64),
                whole: WATCHDOG_STEP,
            },
            need: Need::Without("as the chips have it, 100 ms"),
            means: "Watchdog of the process data: a device leaves OP if its outputs stay away for \
                    longer.",
            goes: "Config::watchdog; register 0x0420 in steps of 100 us",
            example: r#""500ms""#,
        },
        clock::CLOCKS_KEY,
        Key {
            name: "host",
            kind: Kind::Table(&HOST),
            need: Need::Without("an ordinary, tuned PC"),
            means: "The machine that the MainDevice runs on.",
            goes: "the simulated host; its jitter also into the plan",
            example: r#"{ clock = "-3ppm" }"#,
        },
        Key {
            name: "hop_jitter",
            kind: Kind::Boolean,
            need: Need::Default("true"),
            means: "Whether each hop takes its own time for every frame, as receive FIFOs take frames into \
                    the clock of their device: within 40 ns for MII, 10 ns for EBUS. Without it all \
                    frames take the same time, and neither delays nor the plan allow for more.",
            goes: "Config::hop_jitter; the simulated wire",
            example: "false",
        },
        Key {
            name: "as_is",
            kind: Kind::Boolean,
            need: Need::Default("false"),
            means: "Whether whatever a MainDevice makes of the segment is meant. Otherwise modes, cycles, \
                    phases, states and process data of the file are claims, and a MainDevice that does \
                    otherwise is told so.",
            goes: "the rules of `virtual`, `serve` and the libraries",
            example: "true",
        },
        Key {
            name: "subdevice",
            kind: Kind::Tables(&SUBDEVICE),
            need: Need::Required(
                "at least one device, such as [[subdevice]] device = \"kollmorgen_akd2g\"",
            ),
            means: "The devices. Each stands behind the one above it in the file unless `connect` \
                    says otherwise.",
            goes: "the segment",
            example: r#"[{ device = "kollmorgen_akd2g" }]"#,
        },
        Key {
            name: "ring",
            kind: Kind::Either(&[Kind::Boolean, CABLE_LENGTH]),
            need: Need::Default("false"),
            means: "Whether a cable leads from the last device to a second port of the MainDevice, so that one broken \
                    cable stops no device: `true`, or the length of that cable, 10 m unless it is said. Faults call it \
                    `ring`. docs/ring.md says what does not go with it.",
            goes: "Config::ring; the simulated cable",
            example: "true",
        },
        operation::QUALITY_KEY,
        operation::DELAY_WATCH_KEY,
        operation::RECOVERY_KEY,
        operation::DIRECTION_KEY,
        operation::MEASURE_TIMES_KEY,
        output::OUTPUTS_KEY,
        plant::PLANTS_KEY,
        fault::FAULTS_KEY,
        expect::EXPECT_KEY,
    ],
    rules: &[],
};

/// Path of an ESI file.
const DESCRIPTION: Kind =
    Kind::Name("the path of a device description, such as esi = \"vendor.xml\"");

/// Length of a cable, copper or fibre.
pub(super) const CABLE_LENGTH: Kind = Kind::Length { least: 10, most: 2_000_000 };
pub(super) const RING_EXPECTED: &str = "true, false, or the length of a cable such as \"20m\"";

const FILTER_DEPTH: Kind = Kind::Integer { least: 0, most: 15 };

static HOST: Section = Section {
    head: "[host]",
    means: "The machine that the MainDevice runs on.",
    keys: &[
        Key {
            name: "port",
            kind: Kind::Choice(Choice(&HOST_PORTS)),
            need: Need::Default(r#""mii""#),
            means: "What the first device is plugged into.",
            goes: "which first device fits",
            example: r#""ebus""#,
        },
        Key {
            name: "clock",
            kind: clock::DEVIATION,
            need: Need::Default(r#""+12ppm""#),
            means: "How much faster than true time the host's clock runs. The default is an \
                    ordinary crystal.",
            goes: "the simulated host's oscillator",
            example: r#""-3ppm""#,
        },
        Key {
            name: "jitter",
            kind: Kind::Duration {
                least: Limit::At(0),
                most: Limit::From("10 ms, below half a bus cycle", |cycle| {
                    MOST_JITTER.0.min((cycle - 1) / 2)
                }),
                whole: 1,
            },
            need: Need::Without("20 us, a tuned PC; a tenth of the bus cycle if that is less"),
            means: "How late a frame leaves at worst: peak-to-peak spread of the host's wake-ups. \
                    The plan keeps it free.",
            goes: "Config::host_jitter and the simulated host",
            example: r#""20us""#,
        },
        Key {
            name: "drift_compensation",
            kind: Kind::Boolean,
            need: Need::Default("true"),
            means: "Whether the reference clock's time is distributed. Without it a simulation \
                    shows how clocks run apart.",
            goes: "Config::drift_compensation; writes to register 0x0910",
            example: "false",
        },
        Key {
            name: "difference_filter",
            kind: FILTER_DEPTH,
            need: Need::Without("a mean over 16 ms: 4 at 1 ms"),
            means: "Filter depth of the clocks' time difference: a mean over 2 to the power of it.",
            goes: "Config::drift_filters; register 0x0934",
            example: "0",
        },
        Key {
            name: "speed_filter",
            kind: FILTER_DEPTH,
            need: Need::Without("a mean over 64 ms, 6 to 9: 6 from 1 ms on"),
            means: "Filter depth of the clocks' speed. Small ones follow a change of temperature sooner, large \
                    ones hand on less of the jitter of the way.",
            goes: "Config::drift_filters; register 0x0935",
            example: "12",
        },
    ],
    rules: &[],
};

/// Ports that a MainDevice can have.
pub(super) static HOST_PORTS: [Word<PortKind>; 2] = [
    ("mii", "copper, as any network interface", PortKind::Mii),
    ("ebus", "EBUS: an embedded PC with terminals at its side", PortKind::Ebus),
];

static SUBDEVICE: Section = Section {
    head: "[[subdevice]]",
    means: "One device, or with `count` several equal ones.",
    keys: &[
        Key {
            name: "device",
            kind: Kind::Either(&[
                Kind::Choice(Choice(&profile::BuiltInIds)),
                Kind::Pattern {
                    expected: "the path of a profile file, relative to the segment file: it has a \
                               slash or ends in .toml",
                    pattern: r"(/|\.toml$)",
                },
            ]),
            need: Need::Sometimes(
                "unless `esi` or `sii` is given",
                "a profile's name, such as device = \"kollmorgen_akd2g\"",
            ),
            means: "What it is: a built-in profile or a profile file. This, `esi` or \
                    `sii` is needed; not this and `esi`.",
            goes: "the device's chip, dictionary, EEPROM and CPU times",
            example: r#""kollmorgen_akd2g""#,
        },
        Key {
            name: "esi",
            kind: Kind::Either(&[DESCRIPTION, Kind::List(&DESCRIPTION)]),
            need: Need::Without("`device` says what it is"),
            means: "A maker's description (ESI), relative to the segment file. `type` says which \
                    device of it. In a list the first file has the device; the others have further \
                    modules for its slots.",
            goes: "the device's chip, dictionary, EEPROM and OpModes",
            example: r#""vendor.xml""#,
        },
        Key {
            name: "type",
            kind: Kind::Name("a type of the description"),
            need: Need::Without("the description has one type"),
            means: "The device of the description, by its type, as `isocat devices vendor.xml` \
                    lists it. Needed beside `esi` where the file has several types. Only beside \
                    `esi`.",
            goes: "the choice of the device in the ESI file",
            example: r#""EL2502-0010""#,
        },
        Key {
            name: "product",
            kind: Kind::Hex { least: 0, most: u32::MAX as i64 },
            need: Need::Without("the last one of that type and revision"),
            means: "The product code of the device, where several have one type and revision. \
                    Only beside `esi`.",
            goes: "the choice of the device in the ESI file; object 0x1018:02",
            example: "0x0000_0101",
        },
        Key {
            name: "revision",
            kind: Kind::Hex { least: 0, most: u32::MAX as i64 },
            need: Need::Without("the newest that the description has"),
            means: "The revision of the device. Only beside `esi`.",
            goes: "the choice of the device in the ESI file; object 0x1018:03",
            example: "0x0011_0000",
        },
        module::MODULES_KEY,
        Key {
            name: "opmode",
            kind: Kind::Either(&[
                Kind::Name("the name of an OpMode, or its number in the file from 0"),
                Kind::Integer { least: 0, most: i64::MAX },
            ]),
            need: Need::Without("the first; for drives the first with SYNC0"),
            means: "The OpMode of the description, by its name or by its number in the file from \
                    0. Only beside `esi` or `sii`.",
            goes: "mode, SYNC0 and SYNC1 times of the device: registers 0x0980, 0x09A0, 0x09A4",
            example: r#""DC""#,
        },
        Key {
            name: "sii",
            kind: Kind::Name("the path of an EEPROM's content, such as sii = \"eeprom.bin\""),
            need: Need::Without("the EEPROM follows from `device` or `esi`"),
            means: "The content of its EEPROM, relative to the segment file: an image, or Intel HEX. \
                    The device serves these bytes. Alone it is the whole description; beside \
                    `device` or `esi` its vendor and product have to be theirs.",
            goes: "the device's EEPROM; alone also its identity, ESC, process data and OpModes",
            example: r#""eeprom.bin""#,
        },
        Key {
            name: "count",
            kind: Kind::Integer { least: 1, most: MOST_DEVICES as i64 },
            need: Need::Default("1"),
            means: "Number of equal devices, one behind the other. Their names end in their number \
                    from 0. All devices of the file are at most 65535.",
            goes: "the segment",
            example: "50",
        },
        Key {
            name: "name",
            kind: Kind::Name("a name in quotes"),
            need: Need::Without("the profile's id and the device's place in the file from 0"),
            means: "What reports call it. Each name is given once.",
            goes: "DeviceConfig::name; reports, captures and `connect`",
            example: r#""axis 2""#,
        },
        Key {
            name: "mode",
            kind: Kind::Choice(Choice(&profile::MODES)),
            need: Need::Without("the best that the device and the cycle allow"),
            means: "How it is synchronized. The device must announce the mode in 0x1C32:04.",
            goes: "DeviceConfig::mode; objects 0x1C32:01 and 0x1C33:01, registers 0x0980 and \
                   0x0981",
            example: r#""dc-sync0""#,
        },
        Key {
            name: "cycle",
            kind: Kind::Duration { least: CYCLE, most: Limit::At(LONGEST_CYCLE.0), whole: 1 },
            need: Need::Without("the bus cycle"),
            means: "Cycle of a device slower than the bus: a whole multiple of the bus cycle. \
                    SYNC0 comes and process data travel once in it.",
            goes: "DeviceConfig::cycle; register 0x09A0, object 0x1C32:02",
            example: r#""4ms""#,
        },
        Key {
            name: "connect",
            kind: Kind::Pattern {
                expected: "a device above and its port, such as \"axis 1:3\"",
                pattern: r"^.+:\s*[0-3]\s*$",
            },
            need: Need::Without(
                "the device above, port 1; port 0 if that one's port 1 leads upstream",
            ),
            means: "Where it is plugged in: the name of a device above in the file, or its place \
                    from 0, and the port there. Both ports must be of one kind: MII (copper) or \
                    EBUS.",
            goes: "the topology",
            example: r#""axis 1:2""#,
        },
        Key {
            name: "port",
            kind: Kind::Integer { least: 0, most: 3 },
            need: Need::Default("0"),
            means: "The device's own port that the cable upstream is plugged into. Any other than \
                    0 is a swapped cable.",
            goes: "the topology",
            example: "1",
        },
        Key {
            name: "cable",
            kind: CABLE_LENGTH,
            need: Need::Default(r#""10m""#),
            means: "Length of the cable that leads to the device. A device that is joined by EBUS \
                    has none.",
            goes: "the simulated cable; propagation delay, register 0x0928",
            example: r#""25m""#,
        },
        Key {
            name: "fibre",
            kind: Kind::Boolean,
            need: Need::Default("false"),
            means: "That cable is an optical fibre. Copper reaches 100 m.",
            goes: "the check of `cable`",
            example: "true",
        },
        Key {
            name: "cable_delay",
            kind: Kind::DelayPerMetre { least: LEAST_DELAY, most: 10_000 },
            need: Need::Default(r#""5ns/m""#),
            means: "How long a signal takes on that cable. The least is the speed of light.",
            goes: "the simulated cable; propagation delay, register 0x0928",
            example: r#""5.3ns/m""#,
        },
        Key {
            name: "cable_asymmetry",
            kind: Kind::Duration {
                least: Limit::From("minus twice the cable's delay", |twice| -twice),
                most: Limit::From("twice the cable's delay", |twice| twice),
                whole: 1,
            },
            need: Need::Default(r#""0ns""#),
            means: "How much longer the way out takes on that cable than the way back. The mean \
                    stays.",
            goes: "the simulated cable; an error of the measured delay that no MainDevice can see",
            example: r#""4ns""#,
        },
        Key {
            name: "clock",
            kind: clock::DEVIATION,
            need: Need::Without("drawn by the seed within the tolerance of `clocks`"),
            means: "How much faster than true time its clock runs. `0ppm` is a perfect clock.",
            goes: "the simulated ESC's oscillator",
            example: r#""-35ppm""#,
        },
        clock::RAMP_KEY,
        clock::STEP_KEY,
        clock::WALK_KEY,
        Key {
            name: "shift",
            kind: BELOW_CYCLE,
            need: Need::Without("the device's own"),
            means: "Wanted shift of Outputs Valid, from the pulse to valid outputs. For a device \
                    with shift by local timer.",
            goes: "DeviceConfig::shift_outputs; object 0x1C32:03",
            example: r#""40us""#,
        },
        Key {
            name: "input_shift",
            kind: BELOW_CYCLE,
            need: Need::Without("the device's own"),
            means: "Wanted shift of Input Latch, from the pulse or the SM event to the latch. For \
                    a device with shift by local timer.",
            goes: "DeviceConfig::shift_inputs; object 0x1C33:03",
            example: r#""30us""#,
        },
        Key {
            name: "sync1",
            kind: BELOW_CYCLE,
            need: Need::Without("a quarter of the cycle; for \"dc-sync1\" what the device needs"),
            means: "From SYNC0 to SYNC1. For the modes \"dc-shift-sync1\" and \"dc-sync1\".",
            goes: "DeviceConfig::sync1; register 0x09A4",
            example: r#""250us""#,
        },
        Key {
            name: "sync0_cycle",
            kind: Kind::Duration { least: Limit::At(10), most: BELOW, whole: 1 },
            need: Need::Without("what the device states in 0x1C32:0A"),
            means: "Cycle of SYNC0: a whole part of the bus cycle. For the mode \
                    \"dc-subordinated\".",
            goes: "DeviceConfig::sync0_cycle; register 0x09A0, object 0x1C32:0A",
            example: r#""250us""#,
        },
        Key {
            name: "calc_copy",
            kind: Kind::duration(Nanos(1), LONGEST_CYCLE),
            need: Need::Without("the device's own"),
            means: "Calc and copy time that the device states, and that the plan believes.",
            goes: "object 0x1C32:06 of the simulated device",
            example: r#""70us""#,
        },
        Key {
            name: "copy_time",
            kind: Kind::duration(Nanos(1), LONGEST_CYCLE),
            need: Need::Without("that of its profile, as a rule what 0x1C32:06 states"),
            means: "Time that its CPU really needs from the SM2 event to mapped outputs. Above the \
                    stated time it eats the slack.",
            goes: "the simulated CPU's calc and copy time",
            example: r#""90us""#,
        },
        Key {
            name: "delay",
            kind: Kind::duration(Nanos::ZERO, LONGEST_CYCLE),
            need: Need::Without("the device's own"),
            means: "Delay time that the device states: from the pulse to valid outputs, by its \
                    hardware.",
            goes: "object 0x1C32:09 of the simulated device",
            example: r#""12.5us""#,
        },
        operation::MEASURED_TIMES_KEY,
        Key {
            name: "jitter",
            kind: Kind::duration(Nanos::ZERO, MOST_JITTER),
            need: Need::Without("that of its profile"),
            means: "How late the steps that follow SYNC0 begin at worst: peak-to-peak spread of \
                    its CPU.",
            goes: "the simulated CPU's jitter and the plan",
            example: r#""2us""#,
        },
        Key {
            name: "pulse",
            kind: profile::PULSE,
            need: Need::Without("that of its profile, 10 us as a rule"),
            means: "Length of its SYNC pulses. 0 ns is acknowledge mode: a pulse stays active until \
                    the device's program has read register 0x098E (SYNC1: 0x098F), `acknowledge` \
                    behind it. For a device with a SYNC unit.",
            goes: "register 0x0982, by word 2 of the simulated EEPROM; the plan",
            example: r#""0ns""#,
        },
        Key {
            name: "acknowledge",
            kind: Kind::duration(Nanos::ZERO, LONGEST_CYCLE),
            need: Need::Without("that of its profile; without one at once, with the interrupt"),
            means: "From a SYNC pulse until the device's program acknowledges it. It spreads by \
                    `jitter`; pulses that are due before make no edge. Only in acknowledge mode, \
                    `pulse = \"0ns\"`.",
            goes: "the simulated CPU's read of register 0x098E and the plan",
            example: r#""30us""#,
        },
        Key {
            name: "eeprom_burn",
            kind: Kind::duration(Nanos::ZERO, LONGEST_BURN),
            need: Need::Without("5 ms, the longest time that the usual parts state"),
            means: "How long its EEPROM burns what was written and acknowledges nothing. Parts in \
                    use take 2.1 to 2.7 ms.",
            goes: "Chip::eeprom_burn_time of the simulated ESC; register 0x0502 bit 13",
            example: r#""2.4ms""#,
        },
        Key {
            name: "misbehave",
            kind: Kind::List(&Kind::Command {
                expected: "a fault, such as \"missed-copy 3\"",
                words: Choice(&misbehave::Vocabulary),
            }),
            need: Need::Without("it behaves"),
            means: "What it does wrong, by name. `isocat conform --faults` lists all words.",
            goes: "the simulated device's stack",
            example: r#"["missed-copy 3"]"#,
        },
        Key {
            name: "optional",
            kind: Kind::Boolean,
            need: Need::Default("false"),
            means: "It may be absent, and come while the segment runs (hot connect). All devices \
                    behind it must be optional too, and the first device can't be.",
            goes: "DeviceConfig::hot_connect",
            example: "true",
        },
        Key {
            name: "arrives",
            kind: Kind::duration(Nanos::ZERO, LONGEST_RUN),
            need: Need::Default(r#""0s""#),
            means: "When an optional device gets its power, from the start of the simulation. Only \
                    beside `optional = true`.",
            goes: "the simulated device's power",
            example: r#""3s""#,
        },
    ],
    rules: &[
        Rule::AnyOf(&["device", "esi", "sii"]),
        Rule::NotBoth("device", "esi"),
        Rule::Needs("type", "esi"),
        Rule::Needs("product", "esi"),
        Rule::Needs("revision", "esi"),
        Rule::Needs("modules", "esi"),
        Rule::NeedsAny("opmode", &["esi", "sii"]),
        Rule::Needs("arrives", "optional"),
    ],
};

/// The error for a file without devices.
pub(super) fn no_device() -> String {
    let Some(Need::Required(expected)) = FILE.key("subdevice").map(|key| key.need) else {
        unreachable!("the devices are declared as needed");
    };
    format!("the segment has no [[subdevice]]; expected {expected}")
}

/// The bus cycle is the base of this table's limits.
const CYCLE: Limit = Limit::From("the bus cycle", |cycle| cycle);
const BELOW: Limit = Limit::From("1 ns below the bus cycle", |cycle| cycle - 1);
const BELOW_CYCLE: Kind = Kind::Duration { least: Limit::At(0), most: BELOW, whole: 1 };

/// A frame of minimum length with four devices takes about 10 us.
const SHORTEST_CYCLE: Nanos = Nanos::micros(10);
pub(super) const LONGEST_CYCLE: Nanos = Nanos::millis(1_000);
const LIMIT: Kind = Kind::duration(Nanos(1), LONGEST_CYCLE);
/// Register 0x0420 counts in steps of 100 us.
const WATCHDOG_STEP: i64 = Nanos::micros(100).0;
/// Nothing is faster than light, ps/m.
const LEAST_DELAY: i64 = 3_300;
const MOST_JITTER: Nanos = Nanos::millis(10);
/// Four times the value of usual parts.
const LONGEST_BURN: Nanos = Nanos::millis(20);
/// Station addresses are 16 bits.
pub(super) const MOST_DEVICES: usize = 65_535;
