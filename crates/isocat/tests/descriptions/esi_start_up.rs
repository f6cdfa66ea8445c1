//! What a description says about the way up, found again in the start-up list: InitCmds with their
//! transitions, control bytes, ports, the device that was meant; and what is left out, told.

use std::path::PathBuf;
use std::process::{Command, Output};

use isocat::eni::{self, Eni};
use isocat::esi::EsiFile;
use isocat::plan::Plan;
use isocat::start_up::{DeviceStartUp, Transition};
use isocat::{Scenario, SegmentFile, StartUp, run};

const BOX: &str = include_str!("../esi/box.xml");
const IN_PREOP: &str = "<InitCmd><Transition>PS</Transition><Index>#x2000</Index>";
const NOT_THERE: &str = "<Index>#x3000</Index><SubIndex>1</SubIndex><Data>07</Data></InitCmd>";

/// A file of its own for each test, gone with it.
struct File(PathBuf);

impl File {
    fn new(name: &str, text: &str) -> Self {
        let name = format!("isocat-start-up-{}-{name}.xml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        Self(path)
    }

    /// A segment of one device of the file, chosen by keys.
    fn segment(&self, keys: &str) -> String {
        format!("cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\nesi = {:?}\n{keys}\n", self.0)
    }

    fn scenario(&self, keys: &str) -> Scenario {
        Scenario::from(SegmentFile::parse("s.toml", &self.segment(keys)).unwrap())
    }

    fn error(&self, keys: &str) -> String {
        SegmentFile::parse("s.toml", &self.segment(keys)).unwrap_err().to_string()
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn start_up(scenario: &Scenario) -> StartUp {
    Plan::of(scenario).unwrap().start_up(scenario)
}

/// The one device of a list.
fn device(file: &File, keys: &str) -> DeviceStartUp {
    start_up(&file.scenario(keys)).devices.remove(0)
}

/// Downloads of a description, without those that set the synchronization.
fn downloads(device: &DeviceStartUp) -> Vec<(Vec<Transition>, String, bool)> {
    let steps = device.objects.iter().filter(|step| step.object.index >= 0x2000);
    steps.map(|step| (step.transitions.clone(), step.object.to_string(), step.complete)).collect()
}

#[test]
fn init_commands_keep_their_transition() {
    // The second one belongs to IP: it comes first then, in the list and on the wire.
    let text = BOX.replace(
        &format!("<InitCmd><Transition>PS</Transition>{NOT_THERE}"),
        &format!("<InitCmd><Transition>IP</Transition>{NOT_THERE}"),
    );
    let file = File::new("transition", &text);
    let scenario = file.scenario("type = \"Drive\"\nopmode = 1");
    let list = start_up(&scenario);
    let expected = [
        (vec![Transition::IP], "0x3000:01".to_owned(), false),
        (vec![Transition::PS], "0x2000:01".to_owned(), false),
    ];
    assert_eq!(downloads(&list.devices[0]), expected);
    let line = list.text().lines().find(|line| line.contains("0x3000:01")).unwrap().to_owned();
    assert!(line.starts_with("  IP  SDO"), "{line}");
    let read = Eni::from_bytes("out.xml", eni::write(&list).as_bytes()).unwrap();
    assert_eq!(downloads(&read.start_up.devices[0]), expected);
    let wire = &scenario.run().setup.config.devices[0].startup;
    let wire: Vec<_> = wire.iter().map(|download| download.object.index).collect();
    assert_eq!(wire, [0x3000, 0x2000]);
    let report = run(&scenario);
    assert!(report.in_sync, "{}", report.text());
}

/// An entry that the dictionary of the file lacks, or calls read only, takes its InitCmd.
#[test]
fn objects_of_init_commands_are_added() {
    for (name, text, entry) in [
        ("object", BOX.to_owned(), "0x3000:01"),
        (
            "single",
            BOX.replace(NOT_THERE, &NOT_THERE.replace("<SubIndex>1", "<SubIndex>0")),
            "0x3000:00",
        ),
        ("entry", BOX.replace(NOT_THERE, &NOT_THERE.replace("#x3000", "#x1C32")), ""),
        ("read-only", BOX.replace("PreOP_SafeOP\">rw", "PreOP\">ro"), "0x2000:01"),
    ] {
        let file = File::new(name, &text);
        let scenario = file.scenario("type = \"Drive\"\nopmode = 1");
        let device = start_up(&scenario).devices.remove(0);
        let told = |words: &str| device.notes.iter().any(|note| note.contains(words));
        match entry {
            // Another length than the entry has.
            "" => assert!(told("InitCmd 0x1C32:01 is left out"), "{name}: {:?}", device.notes),
            entry => {
                assert!(
                    downloads(&device).iter().any(|step| step.1 == entry),
                    "{name}: {device:?}"
                );
                let added = |note: &String| note.contains(entry) && note.contains("it is added");
                assert!(device.notes.iter().any(added), "{name}: {:?}", device.notes);
            }
        }
        let report = run(&scenario);
        assert!(report.in_sync, "{name}: {}", report.text());
    }
}

#[test]
fn what_is_left_out_is_told() {
    let late = BOX.replace(IN_PREOP, &IN_PREOP.replace("PS", "SO"));
    let never = BOX.replace(IN_PREOP, &IN_PREOP.replace("<Transition>PS</Transition>", ""));
    let assignment = BOX.replace(NOT_THERE, &NOT_THERE.replace("#x3000", "#x1C12"));
    let soe =
        "<SoE><InitCmd><Transition>SO</Transition><IDN>1</IDN><Data>0700</Data></InitCmd></SoE>";
    let soe =
        BOX.replace("</CoE>\n\t\t\t\t</Mailbox>", &format!("</CoE>{soe}\n\t\t\t\t</Mailbox>"));
    for (name, text, words) in [
        ("late", late, "InitCmd 0x2000:01 (SO) is left out"),
        ("never", never, "InitCmd 0x2000:01 (no transition) is left out"),
        ("assignment", assignment, "InitCmd 0x1C12:01 is left out"),
        ("soe", soe, "SoE InitCmd S-0-0001 of drive 0 (SO) is left out"),
    ] {
        let file = File::new(name, &text);
        let scenario = file.scenario("type = \"Drive\"\nopmode = 1");
        let plan = Plan::of(&scenario).unwrap();
        let list = plan.start_up(&scenario);
        let notes = &list.devices[0].notes;
        assert!(notes.iter().any(|note| note.starts_with(words)), "{name}: {notes:?}");
        let one_line = |text: String| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(one_line(list.text()).contains(words), "{name}: {}", list.text());
        let report = plan.report(&scenario).text();
        assert!(one_line(report.clone()).contains(words), "{name}: {report}");
        let nothing = File::new("nothing", BOX);
        assert!(!device(&nothing, "type = \"Drive\"").notes.iter().any(|n| n.starts_with(words)));
    }
}

/// Inputs beside outputs keep a control byte without AL event; alone they need it, and the list
/// says so.
#[test]
fn control_bytes_are_those_of_the_file() {
    let silent = "ControlByte=\"#x00\" DefaultSize=\"7\"";
    let text = BOX.replace("ControlByte=\"#x20\" DefaultSize=\"7\"", silent);
    let file = File::new("control", &text);
    let found = device(&file, "type = \"Drive\"\nopmode = 1");
    let controls: Vec<_> = found.sync_managers.iter().map(|sm| sm.control).collect();
    assert_eq!((controls, &found.notes[1..]), (vec![0x64, 0x00], &[][..]));
    let report = run(&file.scenario("type = \"Drive\"\nopmode = 1"));
    assert!(report.in_sync, "{}", report.text());

    let alone = BOX.replace(
        "ControlByte=\"#x20\" DefaultSize=\"2\"",
        "ControlByte=\"#x00\" DefaultSize=\"2\"",
    );
    let found = device(&File::new("alone", &alone), "type = \"Sampler\"");
    assert_eq!(found.sync_managers[0].control, 0x20);
    assert!(
        found.notes[0].starts_with("SyncManager 0: control byte 0x00 becomes 0x20"),
        "{found:?}"
    );
    let kept = device(&File::new("kept", BOX), "type = \"Sampler\"");
    assert!(kept.notes.is_empty(), "{:?}", kept.notes);
}

#[test]
fn ports_are_the_letters_of_the_file() {
    for letters in ["YY", "YH", "YB", "Y KY"] {
        let text =
            BOX.replacen("Device Physics=\"YY\"", &format!("Device Physics=\"{letters}\""), 1);
        let found = device(&File::new("ports", &text), "type = \"Drive\"\nopmode = 1");
        assert_eq!(found.physics, letters);
    }
}

/// Two products of one type and revision are told apart by their product codes; one type need not
/// be named.
#[test]
fn a_device_is_chosen_by_its_product_code() {
    let twice =
        BOX.replace("#x105\" RevisionNo=\"#x1\">Sampler", "#x105\" RevisionNo=\"#x1\">Rack");
    let file = File::new("product", &twice);
    let of = |keys: &str| device(&file, keys).product;
    assert_eq!(of("type = \"Rack\"\nproduct = 0x103"), 0x103);
    assert_eq!(of("type = \"Rack\"\nproduct = 0x105"), 0x105);
    assert_eq!(of("product = 0x103"), 0x103);
    assert_eq!(of("type = \"Rack\""), 0x105, "the last one");
    let error = file.error("type = \"Rack\"\nproduct = 0x104");
    assert!(error.contains("s.toml:6:11: no product 0x00000104"), "{error}");
    assert!(error.contains("expected 0x00000103 or 0x00000105"), "{error}");
    assert!(file.error("").contains("expected the type of one of them, such as \"Drive\""));
    let notes = file.scenario("type = \"Rack\"").devices.remove(0).notes;
    let told = notes.iter().any(|note| note.what.contains("0x00000103 or 0x00000105"));
    assert!(told, "{notes:?}");

    let listed = isocat(&["devices", &file.0.display().to_string()]);
    let listed = text(&listed.stdout);
    for line in ["Rack  revision 0x00000001  product = 0x00000103", "product = 0x00000105"] {
        assert!(listed.contains(line), "{listed}");
    }
    assert!(!listed.contains("product = 0x00000101"), "{listed}");

    let (from, to) =
        (BOX.find("<Device Physics=\"K KY\">").unwrap(), BOX.find("</Devices>").unwrap());
    let drives = [&BOX[..from], &BOX[to..]].concat();
    assert_eq!(device(&File::new("one", &drives), "opmode = 1").product, 0x101);
}

/// A file of which no device can be used: each verb says why, and where in the file.
#[test]
fn a_file_without_a_usable_device_is_bad_input() {
    let (from, to) = (BOX.find("<Devices>").unwrap() + 9, BOX.find("</Devices>").unwrap());
    let broken =
        "\n<Device Physics=\"YY\"><Type ProductCode=\"1\" RevisionNo=\"#x0x0x1\">X</Type></Device>";
    let file = File::new("broken", &[&BOX[..from], broken, &BOX[to..]].concat());
    let line = EsiFile::read(&file.0.display().to_string()).unwrap().refused[0].line;
    let place = format!("broken.xml:{line}:");
    let segment = file.0.with_extension("toml");
    std::fs::write(&segment, file.segment("type = \"X\"")).unwrap();
    let segment_path = segment.display().to_string();
    for arguments in [
        ["devices", &file.0.display().to_string()],
        ["run", &segment_path],
        ["plan", &segment_path],
    ] {
        let out = isocat(&arguments);
        let errors = text(&out.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(out.status.code(), Some(2), "{arguments:?} {errors}");
        assert!(errors.contains("no device that can be chosen; refused: "), "{errors}");
        assert!(errors.contains(&place) && errors.contains("#x0x0x1"), "{errors}");
    }
    std::fs::remove_file(segment).unwrap();
    let one_usable = File::new("usable", &BOX.replace("<Devices>", &format!("<Devices>{broken}")));
    assert_eq!(isocat(&["devices", &one_usable.0.display().to_string()]).status.code(), Some(0));
}

/// What is planned comes up: an OpMode without SYNC of a device that announces none without, types
/// of which one can't be written, a mailbox without protocol.
#[test]
fn what_the_plan_takes_comes_up() {
    let announced =
        |types: &str| BOX.replace("<DefaultData>0700<", &format!("<DefaultData>{types}<"));
    let inputs = {
        let from = BOX.find("<Object>\n\t\t\t\t\t\t\t\t<Index>#x1C32").unwrap();
        let length = BOX[from..].find("</Object>").unwrap() + "</Object>".len();
        let object = &BOX[from..from + length];
        let fixed = object.replace("#x1C32", "#x1C33").replace("DT1C32", "DT1C33");
        let kind = BOX.find("<DataType>\n\t\t\t\t\t\t\t\t<Name>DT1C32").unwrap();
        let kind_length = BOX[kind..].find("</DataType>").unwrap() + "</DataType>".len();
        let kind = &BOX[kind..kind + kind_length];
        let read_only = kind.replace("DT1C32", "DT1C33").replace("<Access>rw<", "<Access>ro<");
        let text = BOX
            .replace(object, &format!("{object}{fixed}"))
            .replace(kind, &format!("{kind}{read_only}"));
        text.replace("<CycleTimeSync0>250000</CycleTimeSync0><CycleTimeSync1 Factor=\"-1\">0</CycleTimeSync1>",
            "<CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0><CycleTimeSync1 Factor=\"1\">0</CycleTimeSync1><ShiftTimeSync1>100000</ShiftTimeSync1>")
            .replace("#x0730", "#x0700")
    };
    for (name, text, keys) in [
        ("dynamic", announced("0040"), "type = \"Drive\"\nopmode = 0"),
        ("dc-only", announced("0400"), "type = \"Drive\"\nopmode = 0"),
        ("half", inputs, "type = \"Drive\"\nopmode = 2"),
        ("silent", BOX.replace("<CoE/>", ""), "type = \"Rack\""),
    ] {
        let file = File::new(name, &text);
        let scenario = file.scenario(keys);
        assert!(Plan::of(&scenario).unwrap().fits(), "{name}");
        let report = run(&scenario);
        assert!(report.in_sync, "{name}: {}", report.text());
    }
    let silent = device(&File::new("areas", &BOX.replace("<CoE/>", "")), "type = \"Rack\"");
    let mailbox = silent.mailbox.unwrap();
    assert_eq!((mailbox.out.start, mailbox.back.start, mailbox.coe), (0x1000, 0x1080, false));
}

/// Channels that share a definition have an index each.
#[test]
fn channels_of_one_definition_follow_each_other() {
    let pdo = "<TxPdo Sm=\"1\"><Index>#x1A00</Index><Name>In</Name>";
    let (from, to) = (BOX.find(pdo).unwrap(), BOX.find("<Eeprom><ByteSize>256").unwrap());
    let defined =
        BOX[from..to].replace("TxPdo Sm=\"1\"", "Pdo RefName=\"In\"").replace("/TxPdo", "/Pdo");
    let channels = "<TxPdo Ref=\"In\" Chn=\"0\" Sm=\"1\"/><TxPdo Ref=\"In\" Chn=\"1\" Sm=\"1\"/>";
    let text = [&BOX[..from], channels, &BOX[to..]].concat();
    let text = text.replace("<Modules>", &format!("<Pdos>{defined}</Pdos><Modules>"));
    let file = EsiFile::from_bytes("box.xml", text.as_bytes()).unwrap();
    let terminal = file.devices.iter().find(|device| device.type_name == "Terminal").unwrap();
    let inputs: Vec<_> = terminal.pdos.iter().skip(1).map(|pdo| (pdo.index, pdo.bits())).collect();
    assert_eq!(inputs, [(0x1A00, 8), (0x1A01, 8)]);
}

fn isocat(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_isocat")).args(arguments).output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("isocat prints UTF-8")
}

/// The drive of the box with registers that its maker orders.
fn with_registers(name: &str, registers: &str) -> File {
    let eeprom = "<Eeprom><ByteSize>2048</ByteSize>";
    assert_eq!(BOX.matches(eeprom).count(), 1);
    File::new(name, &BOX.replace(eeprom, &format!("<ESC>{registers}</ESC>{eeprom}")))
}

/// Registers of watchdogs that the maker orders are written and planned with; those that nothing
/// writes are a doubt.
#[test]
fn registers_of_the_description_are_obeyed_or_doubted() {
    let keys = "type = \"Drive\"\nopmode = 1";
    let registers = "<Reg0108>#x0</Reg0108><Reg0400>#x9C2</Reg0400><Reg0410>1000</Reg0410>\
                     <Reg0420>#x2710</Reg0420>";
    let file = with_registers("registers", registers);
    let scenario = file.scenario(keys);
    let list = start_up(&scenario);
    let written = |list: &StartUp| -> Vec<(u16, Vec<u8>)> {
        let steps = list.devices[0].registers.iter();
        let steps = steps.filter_map(|step| match step.address {
            isocat::start_up::Address::Physical { register, .. } => {
                Some((register, step.data.clone()))
            }
            _ => None,
        });
        steps.filter(|(register, _)| (0x0400..0x0440).contains(register)).collect()
    };
    let expected =
        [(0x0400, vec![0xC2, 0x09]), (0x0410, vec![0xE8, 0x03]), (0x0420, vec![0x10, 0x27])];
    assert_eq!(written(&list), expected);
    assert!(!list.text().contains("register-unused"), "{}", list.text());
    // They are on the wire, and the ESC has them.
    let report = run(&scenario);
    assert!(report.in_sync, "{}", report.text());
    // Through the file of an ENI, and a profile of its own.
    let read = Eni::from_bytes("out.xml", eni::write(&list).as_bytes()).unwrap();
    assert_eq!(written(&read.start_up), expected);
    let esi = EsiFile::from_bytes("box.xml", &std::fs::read(&file.0).unwrap()).unwrap();
    let drive = esi.devices.iter().find(|device| device.type_name == "Drive").unwrap();
    let profile =
        isocat::profile::ProfileText::from_esi(&esi, drive, Some(0), "box.xml").unwrap().text;
    assert!(profile.contains("watchdog_process_data = 10000"), "{profile}");
    // The segment file's own watchdog is for all.
    let own = file.segment(keys).replace("for =", "watchdog = \"20ms\"\nfor =");
    let own = Scenario::from(SegmentFile::parse("s.toml", &own).unwrap());
    assert_eq!(written(&start_up(&own)), [(0x0420, vec![200, 0])]);

    let file = with_registers("unused", "<Reg0108>#x0200</Reg0108>");
    let list = start_up(&file.scenario(keys));
    assert_eq!(written(&list), []);
    let told = list.devices[0].notes.iter().any(|note| note.contains("<Reg0108> = #x0200"));
    assert!(told, "{:?}", list.devices[0].notes);
    let file = with_registers("bad", "<Reg0108/><Reg0420>70000</Reg0420>");
    let list = start_up(&file.scenario(keys));
    assert_eq!(written(&list), []);
    let told: Vec<_> = list.devices[0].notes.iter().filter(|note| note.contains("<Reg")).collect();
    assert!(told.len() == 1 && told[0].contains("<Reg0420> = 70000"), "{told:?}");
}

/// A watchdog of 10 steps fits a cycle just below it, less what the host may be late, and none
/// longer; switched off it fits each.
#[test]
fn the_watchdog_of_the_description_is_planned_with() {
    let fits = |registers: &str, cycle_us: i64| {
        let file = with_registers(&format!("edge-{cycle_us}"), registers);
        let text = file.segment("type = \"Drive\"\nopmode = 1");
        let text = text.replace("\"1ms\"", &format!("\"{cycle_us}us\""));
        let scenario = Scenario::from(SegmentFile::parse("s.toml", &text).unwrap());
        let plan = Plan::of(&scenario).unwrap();
        plan.start_up(&scenario);
        run(&scenario).in_sync
    };
    let steps = |divider: u16| format!("<Reg0400>{divider}</Reg0400><Reg0420>10</Reg0420>");
    // 10 x 100 us, and 10 x 200 us.
    assert!(fits(&steps(2498), 900));
    assert!(!fits(&steps(2498), 1_000));
    assert!(fits(&steps(4998), 1_900));
    assert!(!fits(&steps(4998), 2_000));
    assert!(fits("<Reg0420>0</Reg0420>", 2_000));
    // One that the maker switches off is none that a MainDevice forgot.
    let guarded = |registers: &str| {
        let file = with_registers("guarded", registers);
        file.scenario("type = \"Drive\"\nopmode = 1").claims().devices[0].guarded
    };
    assert!(guarded("") && guarded("<Reg0420>10</Reg0420>"));
    assert!(!guarded("<Reg0420>0</Reg0420>"));
}

/// A fixed SYNC0 goes with any multiple of it, but not if SYNC1 comes with each SYNC0: what to
/// write instead is told.
#[test]
fn sync1_of_a_fixed_sync0_comes_with_the_bus() {
    let said = |factor: &str, cycle: &str| {
        let own = "<CycleTimeSync1 Factor=\"-1\">0";
        assert!(BOX.contains(own));
        let text = BOX.replace(own, &own.replace("-1", factor));
        let file = File::new("fixed", &text);
        let text = file.segment("type = \"Drive\"\nopmode = 2").replace("\"1ms\"", cycle);
        SegmentFile::parse("s.toml", &text).map_err(|error| error.to_string())
    };
    assert!(said("-1", "\"2ms\"").is_ok());
    let refused = said("1", "\"2ms\"").expect_err("SYNC1 each 250 us");
    assert!(refused.contains("Factor -1 at CycleTimeSync1"), "{refused}");
    let other = said("1", "\"300us\"").expect_err("no multiple");
    assert!(!other.contains("Factor -1"), "{other}");
}

/// An interpolation time (0x60C2) becomes the device's cycle, as no drive interpolates rightly over
/// another one; a part alone leaves what the maker wrote.
#[test]
fn an_interpolation_time_becomes_the_cycle() {
    let written = |commands: &str, cycle: &str, own: &str| {
        let last = "<SubIndex>1</SubIndex><Data>07</Data></InitCmd>";
        assert_eq!(BOX.matches(last).count(), 1);
        let file = File::new("interpolation", &BOX.replace(last, &format!("{last}{commands}")));
        let text = file.segment("type = \"Drive\"\nopmode = 1").replace("\"1ms\"", cycle) + own;
        let scenario = Scenario::from(SegmentFile::parse("s.toml", &text).unwrap());
        let list = start_up(&scenario);
        let steps = list.devices[0].objects.iter().filter(|step| step.object.index == 0x60C2);
        let written: Vec<_> = steps.map(|step| (step.object.sub, step.data[0])).collect();
        let told = list.devices[0].notes.iter().any(|note| note.contains("0x60C2 gets"));
        let wire = &scenario.run().setup.config.devices[0].startup;
        let wire = wire.iter().filter(|download| download.object.index == 0x60C2);
        assert!(wire.map(|one| (one.object.sub, one.data[0])).eq(written.iter().copied()));
        (written, told)
    };
    let part = |sub: u8, data: &str| {
        format!(
            "<InitCmd><Transition>PS</Transition><Index>#x60C2</Index><SubIndex>{sub}</SubIndex>\
             <Data>{data}</Data></InitCmd>"
        )
    };
    let both = part(1, "0A") + &part(2, "FD");
    for (cycle, own, units, index) in [
        ("\"2ms\"", "", 2, -3),
        ("\"250us\"", "", 250, -6),
        ("\"500us\"", "", 5, -4),
        ("\"1ms\"", "cycle = \"4ms\"\n", 4, -3),
    ] {
        let expected = vec![(1, units), (2, i8::cast_unsigned(index))];
        assert_eq!(written(&both, cycle, own), (expected, true), "{cycle} {own}");
    }
    assert_eq!(written(&part(1, "0A"), "\"2ms\"", ""), (vec![(1, 10)], false));
    // What the drive can't hold is as near as it can be; the doubt says so.
    let odd = written(&both, "\"1001us\"", "");
    assert_eq!(odd, (vec![(1, 1), (2, 0xFD)], true));
}
