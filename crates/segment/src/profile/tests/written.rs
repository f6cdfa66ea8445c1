//! Features that profiles from ESI files need: unknown values, bytes, lengths, downloads, devices
//! without a program.

use isocat_sync::SyncMode;
use isocat_wire::ObjectAddress;
use isocat_wire::register::PROCESS_RAM;
use isocat_wire::sii::Header;
use isocat_wire::time::Nanos;

use super::refused::MINIMAL;
use super::table;
use crate::profile::{
    ApplicationKind, Found, FoundArea, FoundEntry, Identity, OpMode, Profile, ProfileText,
};

fn read(changes: &[(&str, &str)]) -> Profile {
    let mut text = MINIMAL.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    match Profile::from_toml("p.toml", &text) {
        Ok(profile) => Profile::clone(&profile),
        Err(error) => panic!("{error}\n{text}"),
    }
}

/// Line and message of an error.
fn refused(changes: &[(&str, &str)]) -> String {
    let mut text = MINIMAL.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    let error = Profile::from_toml("p.toml", &text).unwrap_err();
    format!("{} {}", error.line, error.message)
}

/// An unknown value is zeros on the wire, a line in the reports, and no statement for a plan.
#[test]
fn an_unknown_value_is_no_statement() {
    let unknown = read(&[("\"100us\", \"Minimum", "\"unknown\", \"Minimum")]);
    let stated = unknown.sync_parameters(0x1C32).unwrap();
    assert_eq!(stated.minimum_cycle_time.map(|time| time.0), Some(0));
    let assumed: Vec<_> = unknown.assumptions.iter().map(|a| (&*a.item, &*a.value)).collect();
    assert_eq!(assumed, [("0x1C32:05", "unknown")]);

    // Its modes follow from its OpModes; without any they are those of every device.
    let types = ("0x0006, \"Types", "\"unknown\", \"Types");
    let preset = ("\"rw preop\", 1", "\"rw preop\", \"unknown\"");
    let by_modes = |modes: &str| {
        let modes = format!("opmodes = {modes}\n\n[identity]");
        let profile = read(&[types, preset, ("[identity]", &modes)]);
        profile.modes().collect::<Vec<_>>()
    };
    assert_eq!(by_modes("[]"), [SyncMode::FreeRun, SyncMode::SmSynchronous]);
    assert_eq!(
        by_modes("[[\"SM\", \"\", 0, 0, 0], [\"DC\", \"\", 0x0300, 1, 0]]"),
        [SyncMode::SmSynchronous, SyncMode::DcSync0]
    );
    assert!(by_modes("[[\"DC\", \"\", 0x0700, 1, 1]]").contains(&SyncMode::DcSync1));

    // An unknown preset contradicts nothing.
    assert_eq!(read(&[preset]).value(ObjectAddress::new(0x1C32, 1)), Some(0));
}

#[test]
fn values_as_bytes_and_lengths() {
    let with = |row: &str| {
        let object = format!(
            "[[object]]\nindex = 0x2000\nname = \"x\"\nentries = [[0, \"UNSIGNED8\", \"ro\", 1, \"\"], {row}]\n\n[times]"
        );
        let text = MINIMAL.replacen("[times]", &object, 1);
        Profile::from_toml("p.toml", &text).map(|profile| table(&profile, 0x2000))
    };
    for (row, expected) in [
        (
            "[1, \"UNSIGNED32\", \"ro\", \"hex:01 02 03 04\", \"\"]",
            "UNSIGNED32 32 16 0007 67305985",
        ),
        ("[1, \"REAL32\", \"ro\", \"hex:0000803F\", \"\"]", "REAL32 32 16 0007 1065353216"),
        ("[1, \"OCTET_STRING\", \"ro\", \"hex:0A FF\", \"\"]", "OCTET_STRING 16 16 0007 65290"),
        (
            "[1, \"OCTET_STRING\", \"ro\", \"unknown\", \"\", { bits = 128 }]",
            "OCTET_STRING 128 16 0007 ",
        ),
        (
            "[1, \"VISIBLE_STRING\", \"ro\", \"ab\", \"\", { bits = 16 }]",
            "VISIBLE_STRING 16 16 0007 25185",
        ),
        // A text may have this word as its value.
        (
            "[1, \"VISIBLE_STRING\", \"ro\", \"unknown\", \"\"]",
            "VISIBLE_STRING 56 16 0007 31093567915781749",
        ),
        ("[1, \"INTEGER24\", \"ro\", -1, \"\"]", "INTEGER24 24 16 0007 16777215"),
    ] {
        let table = with(row).unwrap();
        assert!(table.lines().last().unwrap().ends_with(expected), "{row}: {table}");
    }
    for (row, expected) in [
        ("[1, \"UNSIGNED8\", \"ro\", \"hex:0\", \"\"]", "expected pairs of hex digits"),
        ("[1, \"UNSIGNED8\", \"ro\", \"hex:0G\", \"\"]", "expected pairs of hex digits"),
        ("[1, \"UNSIGNED8\", \"ro\", \"hex:01 02\", \"\"]", "has 16 bits; expected at most 8"),
        (
            "[1, \"VISIBLE_STRING\", \"ro\", \"ab\", \"\", { bits = 8 }]",
            "has 16 bits; expected at most 8",
        ),
        (
            "[1, \"OCTET_STRING\", \"ro\", \"unknown\", \"\"]",
            "neither the type nor the value has a length",
        ),
        ("[1, \"REAL32\", \"ro\", 1, \"\"]", "expected \"unknown\", or bytes of the wire"),
    ] {
        let error = with(row).unwrap_err();
        assert!(error.message.contains(expected), "{row}: {error}");
    }
}

#[test]
fn downloads_at_start() {
    let startup = |keys: &str| format!("[[startup]]\n{keys}\n\n[times]");
    let right = startup("object = \"1C32:01\"\ndata = \"02 00\"");
    let profile = read(&[("[times]", &right)]);
    let download = &profile.startup[0];
    assert_eq!(
        (download.transition.to_string(), download.object.to_string(), &download.data[..]),
        ("PS".to_owned(), "0x1C32:01".to_owned(), &[2, 0][..])
    );
    for (keys, expected) in [
        ("object = \"1C32:01\"\ndata = \"02\"", "0x1C32:01 gets 1 bytes at start; expected 2"),
        ("object = \"1C32:01\"\ndata = \"02 00 00\"", "gets 3 bytes at start; expected 2"),
        ("object = \"1C32:05\"\ndata = \"00 00 00 00\"", "can't be written in PREOP"),
        ("object = \"2000:00\"\ndata = \"00\"", "the device has no such entry"),
        ("object = \"1C32:01\"\ndata = \"0\"", "expected pairs of hex digits"),
    ] {
        let words = refused(&[("[times]", &startup(keys))]);
        assert!(words.contains(expected), "{words}");
    }
}

#[test]
fn sync_managers_have_numbers() {
    let numbered =
        |number: u8| ("start = 0x1100", format!("start = 0x1100\nsync_manager = {number}"));
    let (from, to) = numbered(5);
    let profile = read(&[(from, &to)]);
    assert_eq!(profile.description.outputs.sync_manager, 5);
    // 0x1C00 states it.
    assert_eq!(profile.value(ObjectAddress::new(0x1C00, 6)), Some(3));
    assert_eq!(profile.value(ObjectAddress::new(0x1C00, 3)), Some(0));
    let (from, to) = numbered(1);
    assert!(refused(&[(from, &to)]).contains("expected 2 or more beside [mailbox]"));
    let (from, to) = numbered(7);
    assert_eq!(read(&[(from, &to)]).description.outputs.sync_manager, 7);
    let (from, to) = numbered(8);
    assert!(refused(&[(from, &to)]).contains("expected at most 7, the last of the ET1100"));
    let inputs =
        "[inputs]\nstart = 0x1200\nlength = 1\naccess = \"ro\"\nsync_manager = 2\n\n[times]";
    let words = refused(&[("[times]", inputs)]);
    assert!(words.contains("both in SyncManager 2; expected one for each"), "{words}");
}

/// Outputs in registers, and no times: both sides of the registers' end.
#[test]
fn a_device_without_a_program() {
    let text = |start: u16, length: u16, emulation: bool| {
        format!(
            "id = \"x\"\nname = \"x\"\nvendor = \"x\"\napplication = \"io\"\nmodes = [\"sm\"]\n\
             identity = {{ vendor_id = 1, product_code = 2, revision = 3 }}\n\
             esc = {{ chip = \"ET1100\", sync_unit = false }}\nbehaviour = {{ device_emulation = {emulation} }}\n\
             outputs = {{ start = {start:#x}, length = {length}, default = [0x1600], pdos = [[0x1600, {}]] }}\n",
            8 * length
        )
    };
    let read =
        |start, length, emulation| Profile::from_toml("x.toml", &text(start, length, emulation));
    let profile = read(0x0F03, 1, true).unwrap();
    assert!(profile.description.behaviour.device_emulation);
    assert_eq!(profile.sii[..2], [0x04, 0x01], "PDI and configuration of the ESC");
    assert_eq!(profile.times.reaction.0, 0);
    for (start, length) in [(0x0F03, 2), (0x0F04, 1), (PROCESS_RAM - 1, 1)] {
        let error = read(start, length, true).unwrap_err();
        assert!(error.message.contains("expected 0x1000 or more, or digital outputs"), "{error}");
    }
    read(PROCESS_RAM, 1, true).unwrap();
    let error = read(0x0F00, 1, false).unwrap_err();
    assert!(error.message.contains("lacks the key \"times\""), "{error}");
    let words = refused(&[("[times]", "[behaviour]\ndevice_emulation = true\n\n[times]")]);
    assert!(words.contains("beside [mailbox], which needs a program"), "{words}");
}

#[test]
fn a_drive_may_have_its_objects_in_another_order() {
    let entries = "entries = [{ pad = 8 }, [\"607A:00\", \"INTEGER32\", \"Target\"], [\"6040:00\", \"UNSIGNED16\", \"Control\"]]";
    let inputs = "[inputs]\nstart = 0x1200\nlength = 6\naccess = \"ro\"\ndefault = [0x1A00]\n\n[[inputs.pdo]]\n\
                  index = 0x1A00\nname = \"x\"\nentries = [[\"6064:00\", \"INTEGER32\", \"Position\"], \
                  [\"6041:00\", \"UNSIGNED16\", \"Status\"]]\n\n[times]";
    let profile = read(&[
        ("application = \"io\"", "application = \"drive\""),
        ("entries = [[\"7000:01\", \"UNSIGNED16\", \"Value\"], { pad = 8 }]", entries),
        ("[times]", inputs),
    ]);
    let ApplicationKind::DriveAt(layout) = profile.application else { panic!("{profile:?}") };
    assert_eq!((layout.target, layout.control, layout.mode), (1, 5, None));
    assert_eq!((layout.position, layout.status), (0, 4));
}

fn found() -> Found {
    let entry =
        |sub, value, writable| FoundEntry { sub, value: Some(value), writable: Some(writable) };
    let object = |index, bits| (ObjectAddress::new(index, 0), bits);
    Found {
        id: "X1".to_owned(),
        name: "X \"one\"".to_owned(),
        identity: Some(Identity { vendor_id: 1, product_code: 2, revision: 3, serial: 4 }),
        esc_kind: 0x11,
        protocols: Header::COE,
        ram_kib: 8,
        ports: "YY".to_owned(),
        sync_unit: true,
        mailbox: Some([(0x1000, 128), (0x1080, 128)]),
        assignable: true,
        outputs: Some(FoundArea {
            sync_manager: 2,
            start: 0x1100,
            length: 6,
            pdos: vec![(0x1600, vec![object(0x6040, 16), object(0x607A, 32)])],
        }),
        inputs: Some(FoundArea {
            sync_manager: 3,
            start: 0x1200,
            length: 7,
            pdos: vec![(0x1A00, vec![object(0x6041, 16), object(0x6064, 32), object(0, 8)])],
        }),
        sync: vec![(0x1C32, vec![entry(0, 4, false), entry(1, 2, true), entry(4, 0x0006, false)])],
        ..Found::default()
    }
}

#[test]
fn what_a_scan_found_is_a_profile() {
    let text = ProfileText::from_found(&found(), "found.json").unwrap().text;
    let profile =
        Profile::from_toml("x.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    assert_eq!(profile.name, "X \"one\"");
    assert_eq!(profile.identity, found().identity.unwrap());
    assert!(matches!(profile.application, ApplicationKind::DriveAt(_)));
    assert_eq!(profile.modes().collect::<Vec<_>>(), [SyncMode::SmSynchronous, SyncMode::DcSync0]);
    assert_eq!(profile.pulse(), Nanos::micros(10), "not read, so the usual one");
    let assumed: Vec<_> = profile.assumptions.iter().map(|a| &*a.item).collect();
    for item in ["times.calc_and_copy", "times.application", "esc.pulse"] {
        assert!(assumed.contains(&item), "{assumed:?}");
    }

    // Values that the device states are not assumed.
    let mut stating = found();
    stating.pulse = Some(Nanos::ZERO);
    stating.sync[0].1.push(FoundEntry { sub: 6, value: Some(70_000), writable: Some(false) });
    let text = ProfileText::from_found(&stating, "found.json").unwrap().text;
    let profile = Profile::from_toml("x.toml", &text).unwrap();
    assert_eq!(profile.times.calc_and_copy.0, 70_000);
    assert_eq!(profile.pulse(), Nanos::ZERO, "acknowledge mode is no missing value");
    let stated = ["times.calc_and_copy", "esc.pulse"];
    assert!(!profile.assumptions.iter().any(|a| stated.contains(&&*a.item)));

    let nobody = Found { identity: None, ..found() };
    let error = ProfileText::from_found(&nobody, "found.json").unwrap_err();
    assert!(error.message.contains("no vendor and product"), "{error}");
    let mut long = found();
    long.outputs.as_mut().unwrap().start = 0x1FFF;
    long.inputs.as_mut().unwrap().start = 0x3000;
    let error = ProfileText::from_found(&long, "found.json").unwrap_err();
    assert!(error.message.contains("8 KiB"), "{error}");
}

/// A value that could not be read is unknown, not 0, and the object keeps its entry.
#[test]
fn what_a_scan_could_not_read_is_unknown() {
    let mut deaf = found();
    let unread = |sub| FoundEntry { sub, value: None, writable: None };
    deaf.sync = vec![(0x1C32, [0, 1, 4, 5, 14, 15, 20].map(unread).to_vec())];
    let mode = |assign_activate, sync0_factor| OpMode {
        name: format!("{assign_activate:#06x}"),
        description: String::new(),
        assign_activate,
        sync0_factor,
        sync1_factor: 0,
        sync0_cycle: Nanos::ZERO,
        sync0_shift: Nanos(-5),
        sync1_shift: Nanos::ZERO,
    };
    deaf.op_modes = vec![mode(0x0000, 0), mode(0x0300, 1)];
    let text = ProfileText::from_found(&deaf, "found.json").unwrap().text;
    assert!(text.contains("[0x05, \"UNSIGNED32\", \"ro\", \"unknown\""), "{text}");
    // ETG.1020 has no sub-index 14h.
    assert!(!text.contains("[0x14,"), "{text}");
    let profile =
        Profile::from_toml("x.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    assert_eq!(profile.op_modes, deaf.op_modes);
    assert_eq!(profile.value(ObjectAddress::new(0x1C32, 0)), Some(20), "the highest that was seen");
    // Its OpModes determine its synchronization modes.
    assert_eq!(profile.modes().collect::<Vec<_>>(), [SyncMode::SmSynchronous, SyncMode::DcSync0]);
    let assumed: Vec<_> = profile.assumptions.iter().map(|a| (&*a.item, &*a.value)).collect();
    for item in [("0x1C32:05", "unknown"), ("0x1C32:04", "6"), ("0x1C32:01 access", "rw preop")] {
        assert!(assumed.contains(&item), "{assumed:?}");
    }

    // A device without a mailbox does not state them either.
    let mute = Found { mailbox: None, sync: Vec::new(), ..deaf };
    let text = ProfileText::from_found(&mute, "found.json").unwrap().text;
    let profile = Profile::from_toml("x.toml", &text).unwrap();
    let modes = [SyncMode::FreeRun, SyncMode::SmSynchronous, SyncMode::DcSync0];
    assert_eq!(profile.modes().collect::<Vec<_>>(), modes);
    assert!(profile.assumptions.iter().any(|a| a.item == "modes"));
}

/// The ESC is named by its kind and its clock; one without a name is replaced, with a note.
#[test]
fn the_esc_of_a_scan() {
    let of = |esc_kind, narrow_clock, ports: &str| {
        let found = Found { esc_kind, narrow_clock, ports: ports.to_owned(), ..found() };
        let written = ProfileText::from_found(&found, "found.json").unwrap();
        let chip = written.text.lines().find_map(|line| line.strip_prefix("chip = ")).unwrap();
        let noted = written.notes.iter().any(|note| note.contains("none that a profile can name"));
        (chip.trim_matches('"').to_owned(), noted)
    };
    for (kind, narrow, ports, chip, noted) in [
        (0x11, false, "YK", "ET1100", false),
        (0xC0, false, "YY", "LAN9252", false),
        (0x98, false, "YY", "XMC4800", false),
        (0x04, true, "YY", "IP_CORE_32", false),
        (0x04, false, "YY", "ET1100", true),
        (0x77, true, "YY", "IP_CORE_32", true),
        (0xC0, false, "YK", "ET1100", true),
    ] {
        assert_eq!(of(kind, narrow, ports), (chip.to_owned(), noted), "{kind:#04x} {ports}");
    }
}

#[test]
fn a_mailbox_without_objects() {
    let protocols = |words: &str| ("receive = {", format!("protocols = {words}\nreceive = {{"));
    let (from, to) = protocols("[\"FoE\", \"CoE\"]");
    let profile = read(&[(from, &to)]);
    let header = Header::parse(&profile.sii).unwrap();
    assert_eq!(header.protocols, Header::COE | 1 << 3);
    let (from, to) = protocols("[\"SoE\"]");
    assert!(refused(&[(from, &to)]).contains("expected \"CoE\" in mailbox.protocols"));
    let (from, to) = protocols("[\"CAN\"]");
    assert!(refused(&[(from, &to)]).contains("CAN"));

    // If the mapping cannot be read, a PDO is no object.
    let (head, object) = MINIMAL.split_once("[[object]]").unwrap();
    let times = &object[object.find("[times]").unwrap()..];
    let with = |protocols: &str, pdo: &str| {
        let head = head.replace("receive = {", &format!("protocols = {protocols}\nreceive = {{"));
        Profile::from_toml("x.toml", &format!("{}{times}", head.replace("0x1600", pdo)))
    };
    let profile = with("[\"SoE\"]", "0x0018").unwrap();
    assert!(profile.description.objects.is_empty() && profile.has_mailbox());
    assert_eq!(profile.assignment.outputs, [0x0018]);
    for pdo in ["0x0018", "0x15FF"] {
        let error = with("[\"CoE\"]", pdo).unwrap_err();
        assert!(error.message.contains("expected 0x1600 to 0x1BFF beside CoE"), "{error}");
    }
    with("[\"CoE\"]", "0x1600").unwrap();
}
