//! Import of device descriptions: what is read, what is doubted, what is refused, and what memory
//! that takes.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use isocat::esi::{Direction, Encoding, EsiFile, Purpose, WarningKind};
use isocat::plan::Plan;
use isocat::profile::{Obstacle, Profile, RunAs};
use isocat::report::OpMode;
use isocat::segment_file::FileError;
use isocat::{Nanos, Scenario, SegmentFile, run};
use isocat_sync::SyncMode;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::dc::AssignActivate;
use isocat_wire::sii::{self, SmRecord, category};
use isocat_wire::{ObjectAddress, PortNumber};

const BOX: &str = include_str!("../esi/box.xml");

fn import(text: &str) -> EsiFile {
    EsiFile::from_bytes("box.xml", text.as_bytes()).unwrap()
}

/// One device with these children, in a file.
fn device(children: &str) -> String {
    format!(
        "<EtherCATInfo><Vendor><Id>1</Id><Name>Nobody</Name></Vendor><Descriptions><Groups><Group>\
         <Type>G</Type></Group></Groups><Devices>\n<Device Physics=\"YY\"><Type ProductCode=\"2\" \
         RevisionNo=\"3\">Box</Type><GroupType>G</GroupType>{children}<Eeprom/></Device>\n</Devices>\
         </Descriptions></EtherCATInfo>"
    )
}

/// Names of the warnings of a file.
fn names(text: &str) -> Vec<&'static str> {
    let file = import(text);
    assert!(file.refused.is_empty(), "{:?}", file.refused);
    file.warnings().map(|(_, warning)| warning.kind.name()).collect()
}

/// Place and words of the one device that is refused.
fn refused(children: &str) -> String {
    let file = import(&device(children));
    assert_eq!((file.devices.len(), file.refused.len()), (0, 1), "{:?}", file.refused);
    file.refused[0].to_string()
}

#[test]
fn a_device_with_everything() {
    let file = import(BOX);
    assert_eq!((file.vendor_id, file.vendor.as_str()), (0x0B0C, "Nobody"));
    assert_eq!((file.devices.len(), file.modules.len()), (6, 2));
    assert_eq!(file.refused, []);
    let drive = &file.devices[0];
    assert_eq!((drive.product_code, drive.revision), (Some(0x101), Some(0x0001_0000)));
    assert_eq!((drive.name.as_str(), drive.hidden), ("Drive with everything", false));
    assert!(file.devices[1].hidden, "the newer one hides it");
    assert_eq!(drive.timeouts.safeop_op, Some(9_000));
    assert_eq!(drive.fmmus, [1, 2, 3]);
    let purposes = [Purpose::MailboxOut, Purpose::MailboxIn, Purpose::Outputs, Purpose::Inputs];
    assert!(drive.sync_managers.iter().map(|sm| sm.purpose).eq(purposes));
    let pdo = &drive.pdos[0];
    assert_eq!((pdo.direction, pdo.index, pdo.bits()), (Direction::Outputs, 0x1600, 56));
    assert_eq!((pdo.sync_manager, pdo.fixed, &pdo.exclude[..]), (Some(2), true, &[0x1601][..]));
    assert_eq!(pdo.entries[1].object, Some(ObjectAddress::new(0x607A, 0)));
    let coe = drive.mailbox.as_ref().unwrap().coe.as_ref().unwrap();
    assert!(coe.sdo_info && coe.pdo_assign && coe.complete_access && !coe.pdo_config);
    assert_eq!(coe.commands[0].data, [7, 0, 0, 0]);
    let modes = drive.op_modes();
    assert_eq!(modes[1].cycle_time_sync0.unwrap().factor, Some(1));
    assert_eq!(modes[2].cycle_time_sync0.unwrap().value, Nanos(250_000));
    let eeprom = drive.eeprom.as_ref().unwrap();
    assert_eq!(eeprom.configuration.unwrap()[..8], [5, 0x0E, 3, 0xEE, 0x10, 0x27, 0, 0]);
    assert_eq!(eeprom.boot.unwrap().1.start, 0x1280);
    let found: Vec<_> = drive.warnings.iter().map(|warning| warning.kind.name()).collect();
    assert_eq!(found, ["sync0-cycle-fixed", "first-opmode-without-dc"]);
    let place = file.place(drive.warnings[0].at);
    let line = BOX.lines().nth(place.line - 1).unwrap();
    assert_eq!(line.trim(), "<OpMode>");
    assert_eq!(place.column, line.find('<').unwrap() + 1);
}

#[test]
fn the_dictionary_is_put_together() {
    let file = import(BOX);
    let objects = &file.devices[0].profile.objects;
    let object = |index| objects.iter().find(|object| object.index == index).unwrap();
    assert_eq!(object(0x1000).entries[0].default, [0x92, 1, 2, 0]);
    let limits = object(0x2000);
    assert_eq!((limits.code, limits.data_type), (ObjectCode::ARRAY, DataType::UNSIGNED32));
    let entries: Vec<_> =
        limits.entries.iter().map(|e| (e.sub, e.bits, e.offset, e.default.clone())).collect();
    assert_eq!(
        entries,
        [
            (0, 8, 0, vec![3]),
            (1, 32, 16, vec![1, 0, 0, 0]),
            (2, 32, 48, vec![2, 0, 0, 0]),
            (3, 32, 80, vec![])
        ]
    );
    let rights = limits.entries[1].access;
    assert!(
        rights.has(Access::WRITE_PREOP.with(Access::WRITE_SAFEOP)) && !rights.has(Access::WRITE_OP)
    );
    let minimum = &object(0x1C32).entries[4];
    assert_eq!((minimum.sub, minimum.data_type), (5, DataType::UNSIGNED32));
    assert_eq!(minimum.default, 250_000_u32.to_le_bytes());
}

#[test]
fn the_virtual_device_is_what_the_file_says() {
    let file = import(BOX);
    let drive = Profile::from_esi(&file, &file.devices[0], Some(1)).unwrap();
    assert!(Arc::ptr_eq(&drive, &Profile::from_esi(&file, &file.devices[0], Some(1)).unwrap()));
    let header = sii::Header::parse(&drive.sii).unwrap();
    assert_eq!((header.vendor_id, header.product_code, header.revision), (0x0B0C, 0x101, 0x10000));
    assert_eq!((header.receive.start, header.send.length, header.protocols), (0x1000, 128, 4));
    assert_eq!(header.boot_send.start, 0x1280);
    assert_eq!(drive.sii[14], sii::checksum(&header.configuration));
    assert_eq!(drive.sii.len(), 2_048);
    let of = |kind| {
        sii::categories(&drive.sii).map(Result::unwrap).find(|c| c.kind == kind).unwrap().data
    };
    let managers = of(category::SYNC_MANAGER).chunks_exact(8);
    let managers: Vec<_> = managers.map(|b| SmRecord::parse(b.try_into().unwrap())).collect();
    assert_eq!(managers.iter().map(|sm| sm.length).collect::<Vec<_>>(), [128, 128, 7, 7]);
    let modes = of(category::DC);
    assert_eq!(modes.len(), 72);
    assert_eq!(modes[24 + 0x0E..24 + 0x12], [0, 3, 1, 0]);
    assert_eq!(modes[48..52], 250_000_u32.to_le_bytes());
    let value = |index, sub| drive.value(ObjectAddress::new(index, sub));
    assert_eq!((value(0x1C32, 5), value(0x1C12, 1)), (Some(250_000), Some(0x1600)));
    assert_eq!((value(0x1018, 2), value(0x1600, 2)), (Some(0x101), Some(0x607A_0020)));
    assert_eq!(drive.times.calc_and_copy, Nanos(30_000));
    assert_eq!(drive.startup[0].data, [7, 0, 0, 0]);
    assert_eq!((drive.startup.len(), value(0x3000, 1)), (2, Some(0)), "a command makes its object");
    let item = |item: &str| drive.assumptions.iter().any(|assumption| assumption.item == item);
    assert!(item("InitCmd objects") && item("0x1C33:06") && item("ESC") && !item("0x1C32:06"));

    let terminal = Profile::from_esi(&file, &file.devices[2], None).unwrap();
    let description = &terminal.description;
    assert_eq!((description.outputs.sync_manager, description.inputs.sync_manager), (0, 1));
    assert_eq!(description.outputs.max_length, 1);
    // Ports 0 and 2 are EBUS, port 3 is MII, port 1 is not there.
    assert_eq!(terminal.esc().port_descriptor, 0b11_10_00_10);
    // Digital I/O sees its exchanges without an event; a program behind the ESC does not.
    let event = |profile: &Profile| {
        let assumed = &profile.assumptions;
        assumed.iter().find(|a| a.item == "Sm0 control").map(|a| a.value.clone())
    };
    assert_eq!(event(&terminal), None);
    let with_program = import(&BOX.replace("0405000000000000", "0504000000000000"));
    let terminal = Profile::from_esi(&with_program, &with_program.devices[2], None).unwrap();
    assert_eq!(event(&terminal).as_deref(), Some("0x64"));

    let rack = Profile::from_esi(&file, &file.devices[3], None).unwrap();
    assert_eq!(rack.assignment.outputs, [0x1600]);
    // The second slot is the third place: the first could hold two.
    assert_eq!(rack.assignment.inputs, [0x1A02]);
    assert_eq!(rack.value(ObjectAddress::new(0x1A02, 1)), Some(0x6020_0110));

    let stopped = Profile::from_esi(&file, &file.devices[4], None).unwrap_err();
    assert_eq!(stopped.obstacle, Obstacle::Placeholder);
    let line = BOX.lines().nth(stopped.error.line).unwrap();
    assert!(line.contains("Cover"), "{stopped}");
}

/// The EEPROM of a description says how SYNC pulses end; how soon its program acknowledges them, a
/// segment file does.
#[test]
fn a_described_device_acknowledges_its_pulses() {
    let acknowledged = BOX.replace("050E03ee1027", "050E03ee0000");
    let of = |text: &str, keys: &str| {
        let file = drive_segment(text, &format!("opmode = 1\n{keys}"))?;
        let profile = file.subdevices[0].profile.clone();
        let is_assumed = profile.assumptions.iter().any(|a| a.item == "times.acknowledge");
        let found = (profile.pulse().0, profile.times.acknowledge.0, is_assumed);
        let report = run(&Scenario::from(file));
        assert!(report.in_sync, "{}", report.text());
        Ok::<_, FileError>(found)
    };
    assert_eq!(of(BOX, "").unwrap(), (100_000, 0, false));
    assert_eq!(of(&acknowledged, "").unwrap(), (0, 0, true));
    assert_eq!(of(&acknowledged, "acknowledge = \"30us\"").unwrap(), (0, 30_000, false));
    assert_eq!(of(&acknowledged, "pulse = \"20us\"").unwrap(), (20_000, 0, true));
    let error = of(BOX, "acknowledge = \"30us\"").unwrap_err();
    assert!(error.message.contains("pulses of 100 us end by themselves"), "{error}");
}

#[test]
fn op_modes_become_modes() {
    let file = import(BOX);
    let of = |device: usize, number, bus| {
        let device = &file.devices[device];
        let profile = Profile::from_esi(&file, device, Some(number)).unwrap();
        RunAs::new(&file, device, Some(number), &profile, Nanos(bus))
    };
    let mode = |device, number| of(device, number, 1_000_000).unwrap();
    assert_eq!(mode(0, 0).mode, SyncMode::SmSynchronous);
    assert_eq!(mode(0, 1).mode, SyncMode::DcSync0);
    let fixed = mode(0, 2);
    assert_eq!((fixed.mode, fixed.sync0_cycle), (SyncMode::DcSubordinated, Some(Nanos(250_000))));
    assert_eq!(fixed.unit, Some(AssignActivate(0x0730)), "latch units and all");
    assert_eq!(mode(5, 0).sync0_cycle, Some(Nanos(250_000)));
    // Not a multiple of the fixed time; and one.
    let error = of(0, 2, 900_000).unwrap_err();
    assert_eq!(error.obstacle, Obstacle::Sync0Cycle);
    assert!(error.error.message.contains("OpMode \"Fixed\" can't be run (sync0-cycle)"), "{error}");
    assert!(of(0, 2, 750_000).is_ok());
    let samples = Profile::from_esi(&file, &file.devices[5], Some(0)).unwrap();
    assert_eq!(samples.description.inputs.max_length, 8, "four samples of two bytes");
}

/// The factor of an OpMode takes the place of the PDO's own; without one the PDO's holds.
#[test]
fn an_oversampling_factor_is_applied_once() {
    for (of_pdo, of_mode, bytes) in [
        ("OSFac=\"1\"", "OSFac=\"4\"", 8),
        ("OSFac=\"3\"", "OSFac=\"4\"", 8),
        ("OSFac=\"3\"", "OSFac=\"1\"", 2),
        ("OSFac=\"3\"", "", 6),
        ("", "OSFac=\"4\"", 8),
        ("", "", 2),
    ] {
        let text = BOX.replace("OSFac=\"1\"", of_pdo).replace("OSFac=\"4\"", of_mode);
        let file = import(&text);
        let samples = Profile::from_esi(&file, &file.devices[5], Some(0)).unwrap();
        assert_eq!(samples.description.inputs.max_length, bytes, "{of_pdo} {of_mode}");
    }
}

/// How long a MainDevice waits is no deadline of the device: it would fall before its SYNC settles.
#[test]
fn a_short_patience_of_the_main_device_ends_no_way_to_op() {
    let file = import(&BOX.replace("<SafeopOpTimeout> 9000", "<SafeopOpTimeout>100"));
    assert_eq!(file.devices[0].timeouts.safeop_op, Some(100));
    let profile = Profile::from_esi(&file, &file.devices[0], Some(1)).unwrap();
    let behaviour = &profile.description.behaviour;
    assert_eq!(behaviour.safeop_to_op_timeout, Nanos::millis(9_000));
    assert!(behaviour.sync_settling < behaviour.safeop_to_op_timeout);
}

/// All of them, in one segment, by a segment file.
#[test]
fn a_segment_of_described_devices_comes_up() {
    let folder = std::env::temp_dir().join(format!("isocat-esi-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("box.xml"), BOX).unwrap();
    let parse = |rest: &str| {
        let text =
            format!("cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\nesi = \"box.xml\"\n{rest}");
        SegmentFile::parse(&folder.join("s.toml").display().to_string(), &text)
    };
    let next = |keys: &str| format!("[[subdevice]]\nesi = \"box.xml\"\n{keys}\n");
    let all = "type = \"Drive\"\n".to_owned()
        + &next("type = \"Drive\"\nopmode = \"Synchron\"\nrevision = 0x10000")
        + &next("type = \"Drive\"\nopmode = 2")
        + &next("type = \"Rack\"")
        + &next("type = \"Sampler\"")
        + "[[subdevice]]\ndevice = \"beckhoff_ek1100\"\n"
        + &next("type = \"Terminal\"");
    let file = parse(&all).unwrap();
    let modes: Vec<_> = file.subdevices.iter().filter_map(|device| device.mode).collect();
    use SyncMode::{DcSubordinated, DcSync0, SmSynchronous};
    assert_eq!(
        modes,
        [DcSync0, SmSynchronous, DcSubordinated, SmSynchronous, DcSubordinated, SmSynchronous],
        "a drive's default is the first with SYNC0"
    );
    let notes = &file.subdevices[0].notes;
    for (kind, what) in [
        ("opmode", "\"DC\" is taken"),
        ("revision", "the newest of 2"),
        ("first-opmode-without-dc", ""),
    ] {
        let told = notes.iter().any(|note| note.kind.name() == kind && note.what.starts_with(what));
        assert!(told, "{kind}: {notes:#?}");
    }
    let report = run(&Scenario::from(file));
    assert!(report.in_sync, "{} {:#?}", report.verdict, report.findings);
    assert!(report.devices.iter().all(|device| device.registers.al_status.is_op()), "{report:?}");

    let error = |rest: &str| {
        let error = parse(rest).unwrap_err();
        (
            error.line,
            error.column,
            error.message.clone() + error.hint.as_deref().unwrap_or_default(),
        )
    };
    let (line, column, words) = error("type = \"Driv\"");
    assert_eq!((line, column), (5, 8));
    assert!(
        words.contains("no type \"Driv\"") && words.contains("did you mean \"Drive\"?"),
        "{words}"
    );
    assert_eq!(error("type = \"Drive\"\nopmode = \"Dc\"").0, 6);
    assert_eq!(error("type = \"Drive\"\nopmode = 3").0, 6);
    let (line, _, words) = error("type = \"Drive\"\nrevision = 0");
    assert_eq!((line, words.contains("it has: 0x00000001, 0x00010000")), (6, true), "{words}");
    assert!(error("type = \"Cover\"").2.contains("placeholder"));
    assert!(error("opmode = 1").2.contains("expected the type of one of them, such as \"Drive\""));
    assert!(error("type = \"Drive\"\ndevice = \"simple_io4\"").2.contains("expected one of them"));
    let alone = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\ntype = \"x\"";
    assert!(SegmentFile::parse("s.toml", alone).unwrap_err().message.contains("without esi"));
    let missing = SegmentFile::parse(
        "s.toml",
        "cycle = \"1ms\"\n[[subdevice]]\nesi = \"none.xml\"\ntype = \"x\"",
    );
    let missing = missing.unwrap_err();
    assert_eq!((missing.line, missing.message.contains("can't be read")), (3, true), "{missing}");
    // A mistake in the description is told with its own place.
    std::fs::write(folder.join("box.xml"), BOX.replace("Inputs & outputs]]>", "x]]>&")).unwrap();
    let broken = parse("type = \"Drive\"").unwrap_err();
    assert!(broken.path.ends_with("box.xml") && broken.line > 100, "{broken}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn encodings() {
    let text = device("<Name>Gerät 5 µs</Name>");
    let declared = |name: &str| format!("<?xml version='1.0' encoding='{name}'?>{text}");
    let latin =
        |text: &str| text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect::<Vec<_>>();
    let wide = |text: &str, mark: bool, low_first: bool| {
        let units = mark.then_some(0xFEFF).into_iter().chain(text.encode_utf16());
        units
            .flat_map(|u| if low_first { u.to_le_bytes() } else { u.to_be_bytes() })
            .collect::<Vec<_>>()
    };
    let with_mark = ["\u{FEFF}", &declared("utf-8")].concat().into_bytes();
    for (bytes, encoding, warning) in [
        (text.clone().into_bytes(), Encoding::Utf8, None),
        (with_mark, Encoding::Utf8, None),
        (latin(&declared("ISO-8859-1")), Encoding::Latin1, None),
        (latin(&declared("iso8859-1")), Encoding::Latin1, Some("encoding-name")),
        (latin(&declared("windows-1252")), Encoding::Windows1252, None),
        (wide(&text, true, true), Encoding::Utf16Le, None),
        (wide(&declared("UTF-16"), true, false), Encoding::Utf16Be, None),
        (wide(&declared("UTF-16"), false, true), Encoding::Utf16Le, None),
        (wide(&text, false, false), Encoding::Utf16Be, None),
        (declared("utf-16").into_bytes(), Encoding::Utf8, Some("encoding-mismatch")),
        (
            ["\u{FEFF}", &declared("latin1")].concat().into_bytes(),
            Encoding::Utf8,
            Some("encoding-mismatch"),
        ),
    ] {
        let file = EsiFile::from_bytes("x.xml", &bytes).unwrap();
        assert_eq!(file.devices[0].name, "Gerät 5 µs", "{encoding:?}");
        assert_eq!(file.encoding, encoding);
        let found = file.file_warnings.first().map(|warning| warning.kind.name());
        assert_eq!(found, warning, "{encoding:?}");
    }
    // The Euro sign is where code page 1252 has it, and nowhere in ISO 8859-1.
    let mut bytes = latin(&declared("windows-1252"));
    let place = bytes.iter().position(|byte| *byte == 0xE4).unwrap();
    bytes[place] = 0x80;
    assert_eq!(EsiFile::from_bytes("x.xml", &bytes).unwrap().devices[0].name, "Ger€t 5 µs");
    bytes[place] = 0x81;
    let error = |bytes: &[u8]| EsiFile::from_bytes("x.xml", bytes).unwrap_err().to_string();
    assert!(error(&bytes).contains("byte 0x81 at offset"), "{}", error(&bytes));
    assert!(
        error(&declared("Shift_JIS").into_bytes())
            .starts_with("x.xml:1:1: the encoding \"Shift_JIS\"")
    );
    let broken = latin(&text);
    let line = text.lines().nth(1).unwrap();
    let column = line[..line.find('ä').unwrap()].chars().count() + 1;
    let expected = format!("x.xml:2:{column}: byte 0xE4 at offset");
    assert!(error(&broken).starts_with(&expected), "{} {expected}", error(&broken));
    let mut odd = wide(&text, true, true);
    odd.push(b'!');
    assert!(error(&odd).contains("single byte 0x21"));
    let mut alone = wide(&text, true, true);
    alone[60..62].copy_from_slice(&[0x00, 0xD8]);
    assert!(error(&alone).contains("unit 0xD800"));
    assert!(EsiFile::from_bytes("x.xml", b"").is_err());
}

/// A segment of one "Drive" of this description at 1 ms, with these keys.
fn drive_segment(text: &str, keys: &str) -> Result<SegmentFile, FileError> {
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    let name = format!("isocat-esi-{}-{number}.xml", std::process::id());
    let path = std::env::temp_dir().join(&name);
    std::fs::write(&path, text).unwrap();
    let segment = std::env::temp_dir().join("s.toml").display().to_string();
    let toml = format!(
        "cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\nesi = \"{name}\"\ntype = \"Drive\"\n{keys}\n"
    );
    let file = SegmentFile::parse(&segment, &toml);
    std::fs::remove_file(&path).unwrap();
    file
}

/// Names of the notes on the one device.
fn noted(file: &SegmentFile) -> Vec<&'static str> {
    file.subdevices[0].notes.iter().map(|note| note.kind.name()).collect()
}

#[test]
fn a_profile_of_a_channel_makes_a_drive() {
    let whole = "<ProfileNo>402</ProfileNo>";
    let of_channels = |numbers: &[u32]| {
        let channel = |no: &u32| {
            format!("<ChannelInfo><ProfileNo>{no}</ProfileNo><AddInfo>0</AddInfo></ChannelInfo>")
        };
        let channels: String = numbers.iter().map(channel).collect();
        BOX.replacen(whole, &channels, 1)
    };
    for (text, number, mode) in [
        (BOX.to_owned(), Some(402), SyncMode::DcSync0),
        (of_channels(&[402]), Some(402), SyncMode::DcSync0),
        // The high half is the type of drive; the other channel is something else.
        (of_channels(&[401, 0x2_0192]), Some(401), SyncMode::DcSync0),
        (of_channels(&[401]), Some(401), SyncMode::SmSynchronous),
        (of_channels(&[]), None, SyncMode::SmSynchronous),
    ] {
        let drive = &import(&text).devices[0];
        assert_eq!(drive.profile.number, number);
        assert_eq!(drive.profile.is_drive(), mode == SyncMode::DcSync0);
        let file = drive_segment(&text, "").unwrap();
        assert_eq!(file.subdevices[0].mode, Some(mode), "{number:?}");
        assert!(!noted(&file).contains(&"drive-not-enabled"), "it follows positions");
    }
    // A drive that follows velocities: said, not enabled.
    let text = BOX.replace("#x607A", "#x60FF");
    let file = drive_segment(&text, "").unwrap();
    let note = file.subdevices[0].notes.last().unwrap();
    assert!(
        note.kind.name() == "drive-not-enabled" && note.what.contains("lack 0x607A of 32"),
        "{note:?}"
    );
}

#[test]
fn a_mode_that_the_op_mode_is_not_for_is_refused() {
    for (op_mode, mode, stands_for) in [
        ("\"DC\"", "free-run", "\"dc-sync0\""),
        ("1", "sm", "\"dc-sync0\""),
        ("\"Synchron\"", "dc-sync0", "\"sm\" or \"free-run\""),
    ] {
        let keys = format!("opmode = {op_mode}\nmode = \"{mode}\"");
        let error = drive_segment(BOX, &keys).unwrap_err();
        assert_eq!((error.line, error.column), (7, 8), "{error}");
        let words = format!(
            "mode = \"{mode}\" contradicts opmode = {op_mode}, which stands for {stands_for};"
        );
        assert!(error.message.contains(&words), "{error}");
    }
    for (op_mode, mode) in
        [("\"DC\"", SyncMode::DcSync0), ("\"Synchron\"", SyncMode::SmSynchronous)]
    {
        let keys = format!("opmode = {op_mode}\nmode = \"{mode}\"");
        let file = drive_segment(BOX, &keys).unwrap();
        assert_eq!(file.subdevices[0].mode, Some(mode));
        assert!(!noted(&file).contains(&"mode"), "they agree");
    }
    // Nobody asked for the OpMode: the mode counts, and that is said.
    let file = drive_segment(BOX, "mode = \"sm\"").unwrap();
    assert_eq!(file.subdevices[0].mode, Some(SyncMode::SmSynchronous));
    let note = &file.subdevices[0].notes[0];
    assert!(note.kind.name() == "mode" && note.what.starts_with("\"sm\" as asked for"), "{note:?}");
}

#[test]
fn sync1_without_sync0_runs_with_both() {
    let text = BOX.replacen("#x300<", "#x500<", 1);
    assert_ne!(text, BOX);
    let kinds: Vec<_> = import(&text).devices[0].warnings.iter().map(|w| w.kind).collect();
    assert!(kinds.contains(&WarningKind::Sync1Alone), "{kinds:?}");
    assert!(kinds.contains(&WarningKind::FirstOpModeWithoutDc), "{kinds:?}");
    let file = drive_segment(&text, "opmode = \"DC\"").unwrap();
    let device = &file.subdevices[0];
    assert_eq!((device.mode, device.sync1), (Some(SyncMode::DcSync1), None));
    let notes = noted(&file);
    assert!(notes.contains(&"sync0-added"), "{notes:?}");
    assert_eq!(notes.iter().filter(|note| **note == "sync1-alone").count(), 1, "{notes:?}");
}

/// The plan says how it read a description, in both of its forms.
#[test]
fn a_plan_says_how_it_read_the_description() {
    let file = drive_segment(BOX, "revision = 0x20000").unwrap();
    let scenario = Scenario::from(file);
    let report = Plan::of(&scenario).unwrap().report(&scenario);
    let noted: Vec<_> = report.devices[0].description.iter().map(|d| d.kind.as_str()).collect();
    for kind in ["revision", "opmode", "first-opmode-without-dc"] {
        assert!(noted.contains(&kind), "{kind}: {noted:?}");
    }
    let text = report.text();
    assert!(text.contains("\nDescription of SubDevice 0 (Drive 0), as it was read\n"), "{text}");
    assert!(
        text.contains("  - revision: no revision 0x00020000 in the file; 0x00010000,"),
        "{text}"
    );
    let built_in = Scenario::from(SegmentFile::built_in());
    let report = Plan::of(&built_in).unwrap().report(&built_in);
    assert!(report.devices.iter().all(|device| device.description.is_empty()));
    assert!(!report.text().contains("as it was read"));
}

/// Plan and run name the OpMode that each device runs in, as text and for programs.
#[test]
fn reports_name_the_op_mode() {
    let file = drive_segment(BOX, "opmode = 1").unwrap();
    let mut scenario = Scenario::from(file);
    let op_mode = |number, name: &str| Some(OpMode { number, name: name.to_owned() });
    let plan = Plan::of(&scenario).unwrap().report(&scenario);
    assert_eq!(plan.devices[0].op_mode, op_mode(1, "DC"));
    let text = plan.text();
    assert!(text.contains("\nSubDevice 0 (Drive 0), dc-sync0 by OpMode \"DC\": SYNC0"), "{text}");
    let report = run(&scenario);
    assert_eq!(report.devices[0].op_mode, op_mode(1, "DC"));
    assert!(report.text().contains("\n  OpMode \"DC\": 0\n"), "{}", report.text());
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["devices"][0]["op_mode"], serde_json::json!({ "name": "DC", "number": 1 }));

    // A table names each OpMode once; devices without stand in no list.
    let mut all = drive_segment(BOX, "opmode = 0\ncount = 3").unwrap().subdevices;
    all.extend(drive_segment(BOX, "opmode = 1\ncount = 3").unwrap().subdevices);
    all.extend(SegmentFile::built_in().subdevices);
    for (position, device) in all.iter_mut().enumerate() {
        device.place.upstream = position.checked_sub(1).map(|above| (above, PortNumber::P1));
    }
    scenario.devices = all;
    let plan = Plan::of(&scenario).unwrap().report(&scenario);
    assert_eq!(plan.devices.last().unwrap().op_mode, None);
    let text = plan.text();
    assert!(text.contains("\n  OpMode \"Synchron\": 0 to 2; OpMode \"DC\": 3 to 5\n"), "{text}");
}

#[test]
fn doubts_have_names() {
    let sm = "<Sm ControlByte='#x20' StartAddress='#x1000' DefaultSize='2' Enable='1'>Inputs</Sm>";
    let pdo = "<TxPdo Sm='0'><Index>#x1A00</Index><Entry><Index>0</Index><BitLen>16</BitLen></Entry></TxPdo>";
    let dc = |mode: &str| device(&format!("<Dc><OpMode><Name>A</Name>{mode}</OpMode></Dc>"));
    for (text, expected) in [
        (device(&format!("{sm}{pdo}")), &[][..]),
        (
            device(&format!("{}{pdo}", sm.replace("Inputs", "Outputs"))),
            &["sync-manager-name-contradicts"],
        ),
        (device(&format!("{}{pdo}", sm.replace("Inputs", "Whatever"))), &["sync-manager-name"]),
        (
            device(&format!("{}{pdo}", sm.replace("Enable='1'", "Enable='9'"))),
            &["sync-manager-enable"],
        ),
        (
            device(&format!("{}{pdo}", sm.replace("ControlByte='#x20'", ""))),
            &["sync-manager-without-control"],
        ),
        (device(&format!("{}{pdo}", sm.replace("#x20", "#x22"))), &["sync-manager-one-buffer"]),
        (device(&format!("{}{pdo}", sm.replace("Size='2'", "Size='3'"))), &["sync-manager-size"]),
        (device(&format!("{sm}{}", pdo.replace("#x1A00", "#x0x1A00"))), &["number-doubled-prefix"]),
        (device(&format!("{sm}{pdo}{pdo}")), &["pdo-repeated"]),
        (
            device(&format!("{sm}{}", pdo.replace("Sm='0'", "Sm='4'"))),
            &["pdo-sync-manager", "process-data-missing"],
        ),
        (
            device(&format!("{sm}{}", pdo.replace("TxPdo", "RxPdo"))),
            &["pdo-sync-manager", "process-data-missing"],
        ),
        (device("<Frobnicate/>"), &["element-unknown"]),
        (
            device("<Mailbox><FoE/></Mailbox>"),
            &["mailbox-without-sync-managers", "mailbox-protocol"],
        ),
        (
            device("<Mailbox><CoE/></Mailbox>"),
            &["mailbox-without-sync-managers", "dictionary-missing"],
        ),
        (device("<Profile><DictionaryFile>d.xml</DictionaryFile></Profile>"), &["dictionary-file"]),
        (dc("<AssignActivate>#x0</AssignActivate>"), &[]),
        (dc(""), &["assign-activate-missing"]),
        (
            dc("<AssignActivate>#x301</AssignActivate><CycleTimeSync0 Factor='1'/>"),
            &["assign-activate-unusual"],
        ),
        (dc("<AssignActivate>#x300</AssignActivate>"), &["sync0-cycle-missing"]),
        (
            dc("<AssignActivate>768</AssignActivate><CycleTimeSync0 Factor='0'>0</CycleTimeSync0>"),
            &["sync0-cycle-missing"],
        ),
        (
            dc(
                "<AssignActivate>#x300</AssignActivate><CycleTimeSync0 Factor='1'>1000</CycleTimeSync0>",
            ),
            &["sync0-cycle-fixed", "sync0-cycle-twice", "sync0-cycle-short"],
        ),
        (
            dc(
                "<AssignActivate>#x500</AssignActivate><CycleTimeSync0 Factor='1'/><CycleTimeSync1 Factor='1'/>",
            ),
            &["sync1-alone"],
        ),
        (
            dc("<AssignActivate>#x0</AssignActivate></OpMode><OpMode><Name>B</Name>\
                 <AssignActivate>#x500</AssignActivate><CycleTimeSync0 Factor='1'/>"),
            &["sync1-alone", "first-opmode-without-dc"],
        ),
        (
            dc(
                "<AssignActivate>#x300</AssignActivate><CycleTimeSync0 Factor='1'/><CycleTimeSync1 Factor='1'/>",
            ),
            &["sync1-unused"],
        ),
        (
            dc(
                "<AssignActivate>#x300</AssignActivate><CycleTimeSync0 Factor='1'/><ShiftTimeSync0>2000200000</ShiftTimeSync0>",
            ),
            &["shift-time-huge"],
        ),
        (
            dc("<AssignActivate>0</AssignActivate><Sm No='2'><SyncType>1</SyncType></Sm>"),
            &["opmode-obsolete"],
        ),
        (
            dc(
                "<AssignActivate>0</AssignActivate></OpMode><OpMode><Name>A</Name><AssignActivate>0</AssignActivate>",
            ),
            &["opmode-name-repeated"],
        ),
        (device("").replace(" RevisionNo=\"3\"", ""), &["revision-missing"]),
        (device("").replace("ProductCode=\"2\"", ""), &["product-code-missing"]),
        (device("").replace("Physics=\"YY\"", ""), &["physics-missing"]),
        (device("").replace("\"YY\"", "\"YQ\""), &["physics-unknown"]),
        (device("").replace("\"YY\"", "\"y\""), &["physics-unknown"]),
        (device("").replace("\"YY\"", "\"\""), &["physics-unknown"]),
        (device("").replace("\"YY\"", "\"YYYYY\""), &["physics-unknown"]),
        (device("").replace("\"YY\"", "\"YKHB\""), &[]),
        (device("").replace("\"YY\"", "\"Y K \""), &[]),
        (device("").replace("<Eeprom/>", ""), &["eeprom-missing"]),
        (
            device("").replace("<Eeprom/>", "<Eeprom><ConfigData>0102</ConfigData></Eeprom>"),
            &["config-data-length"],
        ),
        (device("").replace("<Name>Nobody</Name>", ""), &["vendor-name-missing"]),
        (device("").replace("<GroupType>G<", "<GroupType>H<"), &["group-unknown"]),
        (
            device("")
                .replace("<Descriptions>", "<InfoReference>a\\b.xml</InfoReference><Descriptions>"),
            &["referenced-file-not-read"],
        ),
    ] {
        assert_eq!(names(&text), expected, "{text}");
    }
    let twice = device("");
    let one = twice.lines().nth(1).unwrap().to_owned();
    assert_eq!(names(&twice.replace(&one, &format!("{one}{one}"))), ["identity-repeated"]);
    // Each name once, in words and dashes.
    let mut all: Vec<_> = WarningKind::ALL.iter().map(|kind| kind.name()).collect();
    assert!(all.iter().all(|name| {
        name.bytes().all(|b| b.is_ascii_lowercase() || b == b'-' || b.is_ascii_digit())
    }));
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), WarningKind::ALL.len());
}

#[test]
fn what_can_not_be_read_is_refused_at_its_place() {
    for (children, expected) in [
        (
            "\n <Sm ControlByte='x20'>Inputs</Sm>",
            "box.xml:3:2: ControlByte: \"x20\" is no number; expected e.g. #x1A00 or 26",
        ),
        (
            "\n<Sm ControlByte='#x120'>Inputs</Sm>",
            "box.xml:3:1: ControlByte = #x120 is out of range; expected 0 to 255",
        ),
        (
            "\n<Sm>Something</Sm>",
            "box.xml:3:1: SyncManager \"Something\" has no ControlByte; expected one, or a text such as Outputs",
        ),
        (
            "\n<TxPdo><Index>#x1A00</Index><Entry><Index>1</Index></Entry></TxPdo>",
            "box.xml:3:29: Entry lacks BitLen; expected a number",
        ),
        (
            "\n<TxPdo Fixed='yes'><Index>1</Index></TxPdo>",
            "box.xml:3:1: Fixed = \"yes\": expected 1, 0, true or false",
        ),
        (
            "\n<Dc><OpMode><CycleTimeSync0>-1000</CycleTimeSync0></OpMode></Dc>",
            "box.xml:3:13: CycleTimeSync0 = -1000 is out of range; expected 0 to 2147483647",
        ),
        (
            "\n<Mailbox><CoE><InitCmd><Index>1</Index><SubIndex>0</SubIndex><Data>1</Data></InitCmd></CoE></Mailbox>",
            "box.xml:3:62: Data: \"1\" is no row of hex bytes",
        ),
        (
            "\n<Slots><Slot MinInstances='2' MaxInstances='1'/></Slots>",
            "box.xml:3:8: MinInstances = 2, but MaxInstances = 1; expected no more",
        ),
        (
            "\n<Info><Mailbox><Timeout><RequestTimeout>soon</RequestTimeout></Timeout></Mailbox></Info>",
            "box.xml:3:25: RequestTimeout: \"soon\" is no number; expected e.g. #x1A00 or 26",
        ),
    ] {
        assert_eq!(refused(children), expected);
    }
    // A broken device does not lose its neighbours.
    let file = import(&BOX.replace("ProductCode=\"258\"", "ProductCode=\"4294967296\""));
    assert_eq!((file.devices.len(), file.refused.len()), (5, 1));
    assert!(
        file.refused[0].message.starts_with("ProductCode = 4294967296 is out of range"),
        "{:?}",
        file.refused
    );
    // A broken value does not lose its object, and a broken object not its device.
    let told = |text: &str, kind: WarningKind| {
        let file = import(text);
        let drive = &file.devices[0];
        let object = drive.profile.objects.iter().find(|object| object.index == 0x1000).cloned();
        let warning = drive.warnings.iter().find(|warning| warning.kind == kind);
        (object, warning.expect("it is told").message.clone())
    };
    let broken = BOX.replace("<DefaultData>92010200", "<DefaultData>9201020");
    let (object, warning) = told(&broken, WarningKind::DefaultLeftOut);
    assert!(object.expect("the object stays").entries[0].default.is_empty());
    let expected = "0x1000:00 has DefaultData \"9201020\"; expected two hex digits for each byte";
    assert!(warning.contains(expected), "{warning}");
    let broken = BOX.replace(
        "<Type>UDINT</Type><BitSize>32</BitSize>\n\t\t\t\t\t\t\t\t<Info><DefaultData>92010200",
        "<Type>UDINT</Type><BitSize>x</BitSize>\n\t\t\t\t\t\t\t\t<Info><DefaultData>92010200",
    );
    let (object, warning) = told(&broken, WarningKind::ObjectLeftOut);
    assert!(object.is_none() && warning.contains("object #x1000: "), "{warning}");
    for (text, expected) in [
        ("<a><b></a>", "x.xml:1:7: not well-formed XML: "),
        ("<EtherCATConfig/>", "x.xml:1:1: the root is <EtherCATConfig>; expected <EtherCATInfo>"),
        ("<EtherCATInfo/>", "x.xml:1:1: the file lacks <Vendor>; expected its Id"),
        (
            "<EtherCATInfo><Vendor><Id>x</Id></Vendor></EtherCATInfo>",
            "x.xml:1:23: Id: \"x\" is no number",
        ),
        (
            "<EtherCATInfo><Vendor><Id>1</Id></Vendor></EtherCATInfo>",
            "x.xml:1:1: the file lacks <Descriptions>",
        ),
        ("<a>&nothing;</a>", "x.xml:1:4: not well-formed XML: "),
        ("<a>R & D</a>", "x.xml:1:6: not well-formed XML: "),
    ] {
        let error = EsiFile::from_bytes("x.xml", text.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

/// What would cost time or memory is refused before it does.
#[test]
fn files_that_ask_for_too_much() {
    let quickly = |text: &str, expected: &str| {
        let mut error = String::new();
        let cost = allocation_counter::measure(|| {
            error = EsiFile::from_bytes("x.xml", text.as_bytes()).unwrap_err().to_string();
        });
        assert!(error.contains(expected), "{error}");
        assert_cheap(cost, text.len(), expected);
    };
    let laughs = "<!DOCTYPE a [<!ENTITY a 'ha'><!ENTITY b '&a;&a;&a;&a;'>]><a>&b;</a>";
    quickly(laughs, "x.xml:1:1: a document type with entities");
    quickly("<!DOCTYPE a SYSTEM 'file:///etc/passwd'><a/>", "a document type");
    quickly(&"<a>".repeat(1_000_000), "nested 65 deep; expected at most 64");
    let attributes: String = (0..100_000).map(|number| format!(" a{number}='1'")).collect();
    quickly(&format!("<a{attributes}/>"), "100000 attributes; expected at most 64");
    let spaces: String = (0..60).map(|number| format!(" xmlns:n{number}='u'")).collect();
    quickly(&format!("<a{spaces}><b{spaces}/></a>"), "declarations of namespaces");
    quickly(&format!("<a>{}</a>", "<b/>".repeat(10_000_001)), "more than 10000000 elements");
    quickly(&" ".repeat((64 << 20) + 1), "expected at most 67108864 bytes, found more");
    // Beyond it by its length alone; nothing is read.
    let path = std::env::temp_dir().join(format!("isocat-long-{}.xml", std::process::id()));
    std::fs::File::create(&path).unwrap().set_len(100 << 20).unwrap();
    let error = EsiFile::read(&path.display().to_string()).unwrap_err();
    std::fs::remove_file(&path).unwrap();
    assert!(error.message.contains("found more than 67108864"), "{error}");

    // Much of what is allowed.
    let imported = |text: &str| {
        let mut file = None;
        let cost = allocation_counter::measure(|| file = Some(import(text)));
        assert_cheap(cost, text.len(), "what is allowed");
        file.expect("it is imported")
    };
    let sections = "<![CDATA[x]]>".repeat(100_000);
    imported(&device(&format!("<Name>{sections}</Name>")));
    imported(&device(&format!("<Comment>{}</Comment>", "&amp;".repeat(1_000_000))));
    let doubts = "<TxPdo><Index>#x0x1</Index></TxPdo>".repeat(20_000);
    let file = imported(&device(&doubts));
    assert_eq!(file.devices[0].warnings.iter().map(|w| w.count).max(), Some(20_000));
    assert!(file.devices[0].warnings.len() < 5, "one for each kind");
    let factor = BOX.replace("OSFac=\"4\"", "OSFac=\"65535\"");
    let file = import(&factor);
    let error = Profile::from_esi(&file, &file.devices[5], Some(0)).unwrap_err();
    assert_eq!(error.obstacle, Obstacle::ProcessDataTooLong);
    let slots = BOX.replace("MaxInstances=\"2\"", "MaxInstances=\"65535\"");
    assert_eq!(imported(&slots).devices.len(), 6);
}

/// A description of this length cost memory in proportion to it. A reader that copies what it has
/// read again and again, or follows what multiplies, costs a multiple, in time as well.
fn assert_cheap(cost: allocation_counter::AllocationInfo, length: usize, what: &str) {
    println!(
        "{what}: {} bytes at once, {} in total, of {length}",
        cost.bytes_max, cost.bytes_total
    );
    let (most, length) = (MOST_BYTES_A_BYTE, length as u64 + 4096);
    assert!(cost.bytes_max < most * length, "{what}: {cost:?} for {length} bytes");
    assert!(cost.bytes_total < 2 * most * length, "{what}: {cost:?} for {length} bytes");
}

/// Bytes that a byte of a description may take: `<b/>` is a node of the tree.
const MOST_BYTES_A_BYTE: u64 = 32;

/// Damaged descriptions are refused or read, whole devices or without some, but nothing panics: not
/// the import, and not the virtual devices of it.
#[test]
fn damaged_files_are_no_panic() {
    let (mut broken, mut read, mut built) = (0, 0, 0);
    let step = 11;
    for (at, _) in BOX.char_indices().step_by(step) {
        for insert in ["", "0", "-", "<", "\"", "#x", "99999", "&"] {
            let text = format!("{}{insert}{}", &BOX[..at], BOX.get(at + 1..).unwrap_or(""));
            match EsiFile::from_bytes("x.xml", text.as_bytes()) {
                Ok(file) => {
                    read += 1;
                    for error in &file.refused {
                        assert!(error.line <= text.lines().count() && error.line > 0, "{error}");
                    }
                    // Profiles stay as long as the program: some are enough.
                    if at % 60 < step && matches!(insert, "99999" | "-" | "") {
                        for device in &file.devices {
                            built += usize::from(Profile::from_esi(&file, device, Some(0)).is_ok());
                        }
                    }
                }
                Err(error) => {
                    broken += 1;
                    assert!(error.line <= text.lines().count() + 1 && error.line > 0, "{error}");
                }
            }
        }
    }
    assert!(broken > 1_000 && read > 1_000 && built > 100, "{broken} {read} {built}");
}
