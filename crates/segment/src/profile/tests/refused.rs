//! The minimal profile, and every contradiction with its place.

use isocat_wire::ObjectAddress;
use isocat_wire::sii::MailboxArea;

use std::sync::Arc;

use super::{lines, table};
use crate::profile::Profile;

/// The minimal valid profile. Line 1 is `id`.
pub(super) const MINIMAL: &str = r#"id = "minimal"
name = "Minimal"
vendor = "Nobody"
application = "io"

[identity]
vendor_id = 1
product_code = 2
revision = 3
device_type = 0

[esc]
chip = "ET1100"
sync_unit = true

[mailbox]
receive = { start = 0x1000, length = 128 }
send = { start = 0x1080, length = 128 }

[outputs]
start = 0x1100
length = 16
access = "rw preop"
default = [0x1600]

[[outputs.pdo]]
index = 0x1600
name = "Outputs"
entries = [["7000:01", "UNSIGNED16", "Value"], { pad = 8 }]

[[object]]
index = 0x1C32
name = "SM output parameter"
entries = [
  [0x00, "UNSIGNED8", "ro", 32, "Highest sub-index"],
  [0x01, "UNSIGNED16", "rw preop", 1, "Synchronization type"],
  [0x04, "UNSIGNED16", "ro", 0x0006, "Types supported"],
  [0x05, "UNSIGNED32", "ro", "100us", "Minimum cycle time"],
  [0x06, "UNSIGNED32", "ro", "10us", "Calc and copy time"],
]

[times]
reaction = "20us"
calc_and_copy = "10us"
application = "50us"
input_copy = "40us"
"#;

#[test]
fn a_profile_by_hand_is_short() {
    let profile = Profile::from_toml("minimal.toml", MINIMAL).unwrap();
    assert_eq!(profile.description.inputs.max_length, 0);
    assert_eq!(
        profile.description.mailbox.unwrap().send,
        MailboxArea { start: 0x1080, length: 128 }
    );
    assert_eq!(table(&profile, 0x1C00).lines().last(), Some("04 UNSIGNED8 8 40 0007 0"));
    assert_eq!(
        table(&profile, 0x7000),
        lines("00 UNSIGNED8 8 0 0007 1\n01 UNSIGNED16 16 16 007F 0")
    );
    assert_eq!(profile.value(ObjectAddress::new(0x1600, 2)), Some(8));
    assert!(profile.description.objects.iter().all(|object| object.index != 0x1C13));
    assert!(profile.assumptions.is_empty());
}

#[test]
fn the_profile_of_the_documentation_is_one() {
    let documentation = include_str!("../../profile.rs");
    let text: String = documentation
        .lines()
        .skip_while(|line| *line != "//! ```toml")
        .skip(1)
        .take_while(|line| *line != "//! ```")
        .map(|line| format!("{}\n", line.trim_start_matches("//!")))
        .collect();
    let profile = Profile::from_toml("documentation", &text).unwrap();
    assert_eq!(profile.assumptions.len(), 2);
    assert_eq!(table(&profile, 0x1C32).lines().last(), Some("20 BOOLEAN 1 480 0087 0"),);
}

/// The error of the minimal profile with `from` replaced, as `line:column message`.
fn refused(from: &str, to: &str) -> String {
    assert!(MINIMAL.contains(from), "{from}");
    let error = Profile::from_toml("p.toml", &MINIMAL.replacen(from, to, 1)).unwrap_err();
    assert_eq!(error.path, "p.toml");
    assert!(error.to_string().lines().count() <= 2, "{error}");
    format!("{}:{} {}", error.line, error.column, error.message)
}

#[test]
fn contradictions_of_the_sync_objects() {
    assert_eq!(
        refused("\"rw preop\", 1,", "\"rw preop\", 0,"),
        "36:3 0x1C32:01 is 0 (Free Run), but 0x1C32:04 = 0x0006 (SM, DC SYNC0) does not announce it; \
         expected an announced type, or the key contradiction where the maker's table has it so"
    );
    assert!(
        refused("\"rw preop\", 1,", "\"rw preop\", 3,")
            .starts_with("36:3 0x1C32:01 is 3 (DC SYNC1)")
    );
    assert!(
        refused("\"rw preop\", 1,", "\"rw preop\", 0x22,").starts_with("36:3 0x1C32:01 is 0x22")
    );
    assert_eq!(
        refused("0x0006", "0x0026"),
        "37:3 0x1C32:04 announces shift by local timer; expected an entry 0x1C32:03"
    );
    assert_eq!(
        refused("sync_unit = true", "sync_unit = false"),
        "12:1 esc.sync_unit is false, but 0x1C32:04 = 0x0006 (SM, DC SYNC0) announces DC; expected \
         true"
    );
    let free = MINIMAL.replace("sync_unit = true", "sync_unit = false").replace("0x0006", "0x0002");
    Profile::from_toml("p.toml", &free).unwrap();
}

#[test]
fn contradictions_of_objects() {
    assert_eq!(
        refused("\"Minimum cycle time\"]", "\"Minimum cycle time\", { offset = 111 }]"),
        "38:3 0x1C32:05 lies at bit 111 of complete access, but 0x1C32:04 reaches to bit 111; \
         expected 112 or more"
    );
    let exact =
        MINIMAL.replace("\"Minimum cycle time\"]", "\"Minimum cycle time\", { offset = 112 }]");
    Profile::from_toml("p.toml", &exact).unwrap();
    assert_eq!(
        refused("[0x05, \"UNSIGNED32\"", "[0x04, \"UNSIGNED32\""),
        "38:3 0x1C32:04 follows 0x1C32:04; expected ascending"
    );
    assert_eq!(
        refused("[0x00, \"UNSIGNED8\"", "[0x00, \"UNSIGNED16\""),
        "35:3 0x1C32:00 is UNSIGNED16; expected sub-index 0 of type UNSIGNED8 first"
    );
    assert_eq!(
        refused(
            "[times]",
            "[[object]]\nindex = 0x1C32\nname = \"again\"\nentries = [[0, \"BOOLEAN\", \
                            \"ro\", 0, \"x\"]]\n[times]"
        ),
        "42:1 object 0x1C32 is defined twice; expected once"
    );
    assert_eq!(
        refused("[times]", "[[object]]\nindex = 0x2000\nname = \"none\"\nentries = []\n[times]"),
        "42:1 object 0x2000 has no entries; expected at least sub-index 0"
    );
    assert_eq!(
        refused("\"100us\"", "\"100\""),
        "38:30 entries: duration \"100\" has no unit; expected a number with one of the units ns, us, \
         ms, s, min, h, such as \"1ms\""
    );
    assert_eq!(
        refused("0x0006", "0x1_0000"),
        "37:30 entries = 0x1_0000 is out of range; expected an integer from 0 to 65535"
    );
    assert!(refused("UNSIGNED16\", \"rw", "UNSINGED16\", \"rw").starts_with("36:10 unknown type"));
    let long = "x".repeat(256);
    assert!(refused("Minimal", &long).starts_with("2:8 name has 256 bytes; expected at most 255"));
}

#[test]
fn nonsense_of_access() {
    let with = |access: &str| refused("\"rw preop\", 1", &format!("\"{access}\", 1"));
    for (access, why) in [
        ("ro preop", "read-only, yet it names states of writing"),
        ("rw op op", "\"op\" stands twice"),
        ("rw boot", "unknown word \"boot\""),
        ("preop", "it begins with \"preop\""),
        ("", "it is empty"),
    ] {
        let message = with(access);
        let expected =
            format!("36:24 access \"{access}\": {why}; expected \"ro\", \"rw\" or \"wo\"");
        assert!(message.starts_with(&expected), "{message}");
    }
}

#[test]
fn contradictions_of_pdos() {
    assert_eq!(
        refused("default = [0x1600]", "default = [0x1601]"),
        "24:12 outputs.default assigns PDO 0x1601, which is not defined; expected one of: 0x1600"
    );
    assert_eq!(
        refused("default = [0x1600]", "default = []\nrecommended = [0x16FF]"),
        "25:16 outputs.recommended assigns PDO 0x16FF, which is not defined; expected one of: 0x1600"
    );
    assert_eq!(
        refused("default = [0x1600]", "default = [0x1600, 0x1600]"),
        "24:20 outputs.default assigns PDO 0x1600 twice; expected once"
    );
    assert_eq!(
        refused("[0x1600]", "[0x1C00]"),
        "24:12 default = 0x1C00 is out of range; expected an integer from 1 to 7167"
    );
    assert_eq!(
        refused("length = 16", "length = 2"),
        "24:12 outputs.default needs 3 bytes; expected at most 2, the length of the area"
    );
    Profile::from_toml("p.toml", &MINIMAL.replace("length = 16", "length = 3")).unwrap();
    assert_eq!(
        refused(
            "access = \"rw preop\"\ndefault = [0x1600]",
            "access = \"ro\"\ndefault = []\nrecommended \
                 = [0x1600]"
        ),
        "25:16 outputs.recommended differs from outputs.default, but the assignment is read-only; \
         expected the same"
    );
    assert_eq!(
        refused("[\"7000:01\", \"UNSIGNED16\"", "[\"1C32:01\", \"UNSIGNED16\""),
        "29:12 0x1C32:01 is mapped, but its access lacks \"rx\""
    );
    assert_eq!(
        refused("[\"7000:01\", \"UNSIGNED16\"", "[\"1C32:02\", \"UNSIGNED16\""),
        "29:12 0x1C32:02 is mapped, but object 0x1C32 has no such entry"
    );
    let typed = "[0x01, \"UNSIGNED16\", \"rw preop\", 1";
    let mappable = MINIMAL.replace(typed, &typed.replace("preop", "preop rx"));
    let text = mappable.replace("[\"7000:01\", \"UNSIGNED16\"", "[\"1C32:01\", \"UNSIGNED8\"");
    assert_eq!(
        Profile::from_toml("p.toml", &text).unwrap_err().message,
        "0x1C32:01 is mapped as UNSIGNED8; expected UNSIGNED16, its type in the dictionary"
    );
    assert!(refused("\"7000:01\"", "\"7000\"").starts_with("29:13 \"7000\": expected an object"));
    assert!(
        refused("name = \"Outputs\"", "nmae = \"Outputs\"")
            .starts_with("28:1 unknown key \"nmae\"")
    );
}

#[test]
fn contradictions_of_memory() {
    assert_eq!(
        refused("start = 0x1080", "start = 0x107F"),
        "16:1 the send mailbox: start 0x107F overlaps; expected a start above 0x107F, the end of the receive \
         mailbox"
    );
    assert_eq!(
        refused("start = 0x1100\nlength = 16", "start = 0x1100\nlength = 1500"),
        "22:10 length = 1500 is out of range; expected an integer from 0 to 1486"
    );
    assert_eq!(
        refused("start = 0x1100", "start = 0x2FF0"),
        "20:1 the outputs (three buffers) end at 0x301F; expected at most 0x2FFF, the end of the 8 KiB \
         of an ET1100"
    );
    let with_inputs = "[inputs]\nstart = 0x112F\nlength = 8\naccess = \"ro\"\n\n[times]";
    assert!(
        refused("[times]", with_inputs)
            .ends_with("expected a start above 0x112F, the end of the outputs (three buffers)")
    );
    Profile::from_toml("p.toml", &MINIMAL.replace("[times]", &with_inputs.replace("112F", "1130")))
        .unwrap();
}

#[test]
fn contradictions_of_times() {
    assert_eq!(
        refused("application = \"50us\"", "application = \"50001ns\""),
        "42:1 calc and copy, application and input copy take 100.001 us together; expected at most \
         100 us, the minimum cycle time in 0x1C32:05"
    );
    assert_eq!(
        refused("input_copy = \"40us\"\n", ""),
        "42:1 times.input_copy is missing; expected a duration, since 0x1C33:06 states none to follow"
    );
    assert_eq!(
        refused("[times]", "[times]\nacknowledge = \"30us\""),
        "42:1 times.acknowledge is given, but pulses end by themselves with esc.pulse = \"10 us\"; expected esc.pulse = \
         \"0ns\" beside it"
    );
    let times = "[times]\nacknowledge = \"30us\"";
    let acknowledged = MINIMAL.replace("[times]", times);
    let acknowledged =
        acknowledged.replace("sync_unit = true", "sync_unit = true\npulse = \"0ns\"");
    let profile = Profile::from_toml("p.toml", &acknowledged).unwrap();
    assert_eq!((profile.pulse().0, profile.times.acknowledge.0), (0, 30_000));
    assert_eq!(
        refused("application = \"50us\"", "application = \"0us\""),
        "45:15 application = \"0us\" is out of range; expected 1 ns to 1 s"
    );
    assert_eq!(
        refused("[times]", "[behaviour]\nmaximum_cycle_time = \"99us\"\n\n[times]"),
        "42:1 maximum_cycle_time is 99 us, but 0x1C32:05 states 100 us as minimum; expected more"
    );
}

#[test]
fn a_drive_needs_its_objects() {
    let message = refused("application = \"io\"", "application = \"drive\"");
    assert_eq!(
        message,
        "20:1 the recommended outputs of a drive map 7000:00/16, gap/8; expected 6040:00/16, \
         607A:00/32 among them, at whole bytes"
    );
}

#[test]
fn names_that_are_not_there() {
    let refused_with_hint = |from: &str, to: &str| {
        let error = Profile::from_toml("p.toml", &MINIMAL.replacen(from, to, 1)).unwrap_err();
        format!("{error}")
    };
    assert_eq!(
        refused_with_hint("\"ET1100\"", "\"ET110\""),
        "p.toml:13:8: unknown chip \"ET110\"\n  did you mean \"ET1100\"? expected one of: ET1100, \
         ET1100_MII, ET1200, IP_CORE_32, LAN9252, XMC4800"
    );
    assert_eq!(
        refused_with_hint("[times]", "[tiems]"),
        "p.toml:42:2: unknown key \"tiems\" in the top level\n  did you mean \"times\"? expected one \
         of: id, name, vendor, application, identity, esc, mailbox, modes, outputs, inputs, object, opmode, opmodes, \
         startup, times, behaviour, assumed, deviation"
    );
    for (what, expected) in [
        ("1C32:0B", "43:8 0x1C32:0B is assumed, but the device does not have it"),
        ("1C33", "43:8 0x1C33 is assumed, but the device does not have it"),
        ("identity.colour", "43:8 the file has no key \"identity.colour\" to assume"),
    ] {
        let assumed = format!("[[assumed]]\nwhat = \"{what}\"\nwhy = \"since\"\n\n[times]");
        let message = refused("[times]", &assumed);
        assert!(message.starts_with(expected), "{message}");
    }
    assert!(
        refused("vendor_id = 1", "vendor_id = -1").starts_with("7:13 vendor_id = -1 is out of")
    );
    assert!(refused("[identity]", "[identity").starts_with("6:"));
}

/// Damaged files are refused or read without a panic, and every place is inside the file.
#[test]
fn damaged_files_are_no_panic() {
    let mut damaged = 0;
    for (at, _) in MINIMAL.char_indices() {
        for insert in ["", "=", "\"", "[", "-", "9", "µ", "\n", "{"] {
            let broken =
                format!("{}{insert}{}", &MINIMAL[..at], MINIMAL.get(at + 1..).unwrap_or(""));
            if let Err(error) = Profile::from_toml("p.toml", &broken) {
                let line = broken.split('\n').nth(error.line - 1).expect("a line of the file");
                assert!(error.column <= line.chars().count() + 1, "{error}");
                damaged += 1;
            }
        }
    }
    assert!(damaged > 1_000, "{damaged}");
}

/// The minimal profile with another object after its last one.
fn with_object(text: &str) -> Result<Arc<Profile>, String> {
    let text = MINIMAL.replacen("[times]", &format!("[[object]]\n{text}\n\n[times]"), 1);
    Profile::from_toml("p.toml", &text)
        .map_err(|error| format!("{}:{} {}", error.line, error.column, error.message))
}

#[test]
fn an_object_may_be_like_another() {
    let profile = with_object(
        "index = 0x1C33\nlike = \"1C32\"\nwithout = [0x06]\nentries = [[0x09, \"UNSIGNED32\", \"ro\", \
         \"1us\", \"Delay\"]]\nvalues = { 01 = 0x22, 05 = \"200us\" }",
    );
    assert_eq!(
        table(&profile.unwrap(), 0x1C33),
        lines(
            "00 UNSIGNED8 8 0 0007 32
            01 UNSIGNED16 16 16 000F 34
            04 UNSIGNED16 16 96 0007 6
            05 UNSIGNED32 32 112 0007 200000
            09 UNSIGNED32 32 224 0007 1000"
        )
    );
    let of_another =
        with_object("index = 0x10F1\nlike = \"hpmicro_ecat_cia402_ssc:10F1\"").unwrap();
    let drive = crate::profile::built_in("hpmicro_ecat_cia402_ssc").unwrap();
    assert_eq!(table(&of_another, 0x10F1), table(&drive, 0x10F1));
    let refused = |text: &str| with_object(text).unwrap_err();
    assert!(
        refused("index = 0x1C33\nlike = \"1C33\"")
            .starts_with("44:8 like = \"1C33\" is not there;"),
        "not like itself"
    );
    assert!(
        refused("index = 0x1C33\nlike = \"kollmorgen:1C33\"")
            .starts_with("44:8 like = \"kollmorgen:")
    );
    assert_eq!(
        refused("index = 0x1C33\nlike = \"1C32\"\nvalues = { 07 = 1 }"),
        "45:17 values has the key \"07\"; expected a sub-index of the object in two hex digits"
    );
    assert!(
        refused("index = 0x1C33\nlike = \"1C32\"\nwithout = [7]").starts_with("45:12 without"),
        "{}",
        refused("index = 0x1C33\nlike = \"1C32\"\nwithout = [7]")
    );
    // Errors in inherited rows are reported at their source.
    let error = refused("index = 0x1C33\nlike = \"1C32\"\nvalues = { 04 = 4 }");
    assert!(error.starts_with("44:8 0x1C33:01 is 1 (SM-synchronous), but"), "{error}");
}

#[test]
fn a_contradiction_must_be_one() {
    let object = "index = 0x1C33\nlike = \"1C32\"\ncontradiction = \"printed so\"\n";
    let profile = with_object(&format!("{object}values = {{ 01 = 0 }}")).unwrap();
    assert_eq!(profile.value(ObjectAddress::new(0x1C33, 1)), Some(0));
    assert_eq!(
        with_object(object).unwrap_err(),
        "42:1 object 0x1C33 has a contradiction written, but 0x1C33:04 = 0x0006 (SM, DC SYNC0) announces \
         1 (SM-synchronous); expected none"
    );
}

#[test]
fn short_forms_of_pdos_and_choices() {
    let text = MINIMAL
        .replace(
            "default = [0x1600]",
            "default = [0x1600, 0x1601]\npdos = [[0x1601, 100], [0x1602, 0]]",
        )
        .replace("[identity]", "opmodes = [[\"DC\", \"\", 0x0300, 1, -4]]\n\n[identity]");
    let profile = Profile::from_toml("p.toml", &text).unwrap();
    assert_eq!(
        table(&profile, 0x1601),
        lines("00 UNSIGNED8 8 0 0007 2\n01 UNSIGNED32 32 16 0007 64\n02 UNSIGNED32 32 48 0007 36")
    );
    assert_eq!(table(&profile, 0x1602), "00 UNSIGNED8 8 0 0007 0\n");
    let mode = &profile.op_modes[0];
    assert_eq!((mode.name.as_str(), mode.assign_activate), ("DC", 0x0300));
    assert_eq!((mode.sync0_factor, mode.sync1_factor), (1, -4));
    let broken = |from: &str, to: &str| {
        let error = Profile::from_toml("p.toml", &text.replace(from, to)).unwrap_err();
        error.message.clone()
    };
    assert!(broken("[0x1601, 100]", "[0x1601]").contains("expected a row [PDO, bits]"));
    assert!(broken("0x0300, 1, -4", "0x0300, 1").contains("expected [name, description,"));
    assert!(broken("[0x1602, 0]", "[0x1601, 0]").contains("0x1601 is defined twice"));
}
