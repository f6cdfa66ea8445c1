//! Modules in the slots of modular devices: which stand where, what they bring, and what is
//! refused.

use std::path::{Path, PathBuf};

use isocat::esi::{EsiFile, ModuleName, ModuleWish, SlotName, WarningKind};
use isocat::profile::Profile;
use isocat::{Nanos, Scenario, SegmentFile, catalog, run};
use isocat_wire::ObjectAddress;

const RACK: &str = include_str!("../esi/rack.xml");
const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/");

fn parse(keys: &str) -> Result<SegmentFile, String> {
    let text = format!("cycle = \"1ms\"\n[[subdevice]]\nesi = \"rack.xml\"\n{keys}\n");
    SegmentFile::parse(&format!("{FOLDER}x.toml"), &text)
        .map_err(|error| error.to_string().replace(FOLDER, ""))
}

fn rack(modules: &str) -> SegmentFile {
    let keys = format!("modules = {modules}");
    parse(&keys).unwrap_or_else(|error| panic!("{error}"))
}

fn profile(modules: &str) -> std::sync::Arc<Profile> {
    rack(modules).subdevices[0].profile.clone()
}

fn refused(modules: &str) -> String {
    match parse(&format!("modules = {modules}")) {
        Ok(_) => panic!("{modules} was accepted"),
        Err(error) => error,
    }
}

fn value(profile: &Profile, index: u16, sub: u8) -> Option<u64> {
    profile.value(ObjectAddress::new(index, sub))
}

/// Object, sub-index and data of each download at start.
fn downloads(profile: &Profile) -> Vec<(u16, u8, Vec<u8>)> {
    let all = profile.startup.iter();
    all.map(|one| (one.object.index, one.object.sub, one.data.clone())).collect()
}

#[test]
fn a_place_moves_pdos_objects_and_downloads() {
    let rack = profile(r#"["DI8", "", { module = "DI16", count = 2 }, 0x2042]"#);
    assert_eq!(rack.assignment.inputs, [0x1AFF, 0x1A00, 0x1A02, 0x1A03]);
    assert_eq!(rack.assignment.outputs, [0x1604]);
    assert_eq!(value(&rack, 0x1A00, 1), Some(0x6000_0108));
    assert_eq!(value(&rack, 0x1A03, 1), Some(0x6030_0110));
    assert_eq!(value(&rack, 0x1604, 1), Some(0x7040_0110));
    // Settings of each module, with its own preset; none at the empty place.
    let settings = [0x8000, 0x8010, 0x8020, 0x8030, 0x8040].map(|index| value(&rack, index, 1));
    assert_eq!(settings, [Some(4), None, Some(3), Some(3), Some(5)]);
    assert_eq!(
        downloads(&rack),
        [
            (0xF030, 1, vec![0x41, 0x20, 0, 0]),
            (0xF030, 2, vec![0; 4]),
            (0xF030, 3, vec![0x40, 0x20, 0, 0]),
            (0xF030, 4, vec![0x40, 0x20, 0, 0]),
            (0xF030, 5, vec![0x42, 0x20, 0, 0]),
            (0xF030, 0, vec![5]),
            (0xF800, 1, vec![7]),
            (0x8020, 1, vec![5, 0]),
            (0x8030, 1, vec![5, 0]),
        ]
    );
    let detected: Vec<_> = (0..=6).map(|sub| value(&rack, 0xF050, sub).unwrap()).collect();
    assert_eq!(detected, [5, 0x2041, 0, 0x2040, 0x2040, 0x2042, 0]);
}

#[test]
fn a_list_without_holes_by_any_way_to_say_it() {
    let one = profile(r#"["DI8", "DI16", "DI16"]"#);
    for other in [
        r#"[0x2041, { module = "DI16", count = 2 }]"#,
        r#"[{ slot = 1, module = "DI16", count = 2 }, { slot = 0, module = "DI8" }]"#,
        r#"[{ slot = "Digital", module = 0x2041 }, { slot = "Digital", module = "DI16" }, "DI16"]"#,
        r#"["DI8", "DI16", "DI16", ""]"#,
    ] {
        assert!(std::sync::Arc::ptr_eq(&one, &profile(other)), "{other}");
    }
}

#[test]
fn slots_have_increments_of_their_own_and_groups() {
    // Place 6: its slot moves PDOs by 4, and objects by what all slots have.
    let rack = profile(r#"["DI8", { slot = "Analog", module = "AI 4 channels" }]"#);
    assert_eq!(rack.assignment.inputs, [0x1AFF, 0x1A00, 0x1BF0, 0x1A18]);
    assert_eq!(value(&rack, 0x1A18, 4), Some(0x6060_0410));
    // Own byte and DI8 are 16 bits: two bytes up to a multiple of four.
    assert_eq!(value(&rack, 0x1BF0, 1), Some(0x0000_0010));
    // The counter goes by the group of its slot, number 3: twice 3 and 0x20 times 3.
    let rack = profile(r#"["DI8", { slot = 6, module = "Counter" }]"#);
    assert_eq!(rack.assignment.inputs, [0x1AFF, 0x1A00, 0x1BF0, 0x1A86]);
    assert_eq!(value(&rack, 0x1A86, 1), Some(0x6160_0110));
}

#[test]
fn the_room_before_a_group_at_both_sides() {
    // 8 bits of the rack, then 8 or 16 bits each.
    for (before, fill) in [("DI8", 16), ("DI16", 8)] {
        let modules = format!(r#"[{{ module = "{before}" }}, {{ slot = 6, module = "Counter" }}]"#);
        assert_eq!(value(&profile(&modules), 0x1BF0, 1), Some(fill), "{before}");
    }
    let full = profile(r#"["DI16", "DI8", { slot = 6, module = "Counter" }]"#);
    assert_eq!(full.assignment.inputs, [0x1AFF, 0x1A00, 0x1A01, 0x1A86], "nothing to fill");
    assert_eq!(value(&full, 0x1BF0, 1), None);

    let without = RACK.replace(" TxPdo=\"#x1BF0\"", "");
    let file = EsiFile::from_bytes("rack.xml", without.as_bytes()).unwrap();
    let wish = |slot, name| ModuleWish {
        slot: Some(SlotName::Place(slot)),
        module: Some(ModuleName::Type(name)),
        count: 1,
    };
    let modules = file.choose_modules(&file.devices[0], &[wish(0, "DI8"), wish(6, "Counter")]);
    let fitted = file.fitted(&file.devices[0], &modules.unwrap());
    assert_eq!(fitted.pdos.len(), 3);
    let warning = fitted.warnings.iter().find(|w| w.kind == WarningKind::PdoGroupUnaligned);
    assert_eq!(
        warning.unwrap().message,
        "group 2 of PDOs in SyncManager 3 would begin 16 bits later, but no free PDO is named that fills them"
    );
}

#[test]
fn modules_that_are_for_an_opmode_choose_it() {
    let mode = |keys: &str| {
        let segment = parse(keys).unwrap();
        let notes = segment.subdevices[0].notes.iter();
        let note =
            notes.filter(|note| note.kind.name() == "module-opmode").map(|note| note.what.clone());
        (segment.subdevices[0].mode.unwrap().uses_dc(), note.collect::<Vec<_>>())
    };
    const COUNTER: &str = r#"modules = ["DI8", { slot = 6, module = "Counter" }]"#;
    assert_eq!(mode(r#"modules = ["DI8"]"#), (false, vec![]), "the first OpMode");
    assert_eq!(mode(COUNTER), (true, vec![]), "the first that is for all modules");
    let words = "module \"Counter\" at place 6 is for OpMode \"DC\"; the device runs in \"SM\"";
    let other = format!("{COUNTER}\nopmode = \"SM\"");
    assert_eq!(mode(&other), (false, vec![words.to_owned()]));
}

#[test]
fn modules_of_another_file() {
    let keys = |keys: &str| {
        let text = format!("cycle = \"1ms\"\n[[subdevice]]\n{keys}\n");
        SegmentFile::parse(&format!("{FOLDER}x.toml"), &text)
            .map_err(|error| error.to_string().replace(FOLDER, ""))
    };
    const BOTH: &str = r#"esi = ["rack.xml", "rack_modules.xml"]"#;
    let far = keys(&format!("{BOTH}\nmodules = [\"DI8\", {{ slot = 7, module = \"Far DI8\" }}]"));
    let rack = &far.unwrap().subdevices[0].profile;
    assert_eq!(rack.assignment.inputs, [0x1AFF, 0x1A07, 0x1A00], "group 0 goes before 1");
    for (text, expected) in [
        (
            "esi = [\"rack.xml\"]\nmodules = [\"Far DI8\"]",
            "x.toml:4:12: no module \"Far DI8\" in the file\n  the file refers to \"more\\\\rack_modules.xml\"",
        ),
        ("esi = []", "x.toml:3:7: an empty list; expected the path of a device description"),
        ("esi = [\"rack.xml\", \"none.xml\"]", "x.toml:3:20: none.xml: can't be read"),
        ("esi = [\"rack_modules.xml\"]", "the file has no device that can be chosen"),
        ("esi = [\"rack_modules.xml\", \"rack.xml\"]", "the file has no device that can be chosen"),
        ("esi = 3", "x.toml:3:7: esi: expected the path of a device description"),
    ] {
        let error = keys(text).err().unwrap_or_else(|| panic!("{text} was accepted"));
        assert!(error.contains(expected), "{text}\n{error}");
    }
}

#[test]
fn what_does_not_fit_is_refused_with_its_place() {
    for (modules, expected) in [
        (r#"["DI61"]"#, "x.toml:4:12: no module \"DI61\" in the file\n"),
        ("[0x99]", "x.toml:4:12: no module 0x99 in the file"),
        (
            r#"["DI8", "Counter"]"#,
            "x.toml:4:19: slot \"Digital\" (place 1) does not take \"Counter\"\n  place 6 in slot \"Analog\" takes it",
        ),
        (
            r#"[{ slot = 6, module = "DI8" }]"#,
            "x.toml:4:33: slot \"Analog\" (place 6) does not take \"DI8\"\n  place 0 in slot \"Digital\" takes it",
        ),
        (
            r#"["DI8", { slot = 7, module = "DI8" }]"#,
            "slot \"Other maker\" (place 7) does not take \"DI8\"",
        ),
        (
            "[]",
            "x.toml:4:11: slot \"Digital\" must have 1 module, and 0 are given\n  it takes \"DI16\", \"DI8\"",
        ),
        (
            r#"[{ slot = "Digital", module = "DI8", count = 7 }]"#,
            "x.toml:4:56: slot \"Digital\" takes 6 modules at most",
        ),
        (
            r#"[{ slot = 7, module = "", count = 2 }]"#,
            "x.toml:4:45: there is no place 8 for a module; the device takes 8 modules at most",
        ),
        (
            r#"[{ module = "DI8", count = 6 }, { slot = "Digital", module = "DI8" }]"#,
            "x.toml:4:52: slot \"Digital\" is full; it takes 6 modules at most",
        ),
        (
            r#"["DI8", { slot = 0, module = "DI16" }]"#,
            "x.toml:4:28: place 0 is given twice; it was \"DI8\" before",
        ),
        (
            r#"["", "DI8", { slot = 0, module = "DI16" }]"#,
            "place 0 is given twice; it was to stay empty before",
        ),
        (r#"[{ slot = 8, module = "DI8" }]"#, "there is no place 8; expected 0 to 7"),
        (r#"[{ slot = "Digitl", module = "DI8" }]"#, "did you mean \"Digital\"?"),
        (
            r#"["Twin"]"#,
            "2 modules are called \"Twin\"; expected the ident of one of them: 0x2070 or 0x2071",
        ),
        (r#"[{ slot = 0 }]"#, "lacks the key \"module\""),
        (r#"[{ module = "DI8", count = 0 }]"#, "count = 0 is out of range"),
        (r#"[true]"#, "expected a type of module"),
        (r#""DI8""#, "an array of modules"),
    ] {
        let error = refused(modules);
        assert!(error.contains(expected), "{modules}\n{error}");
    }
    assert!(refused(r#"["DI61"]"#).contains("more\\\\rack_modules.xml"));

    let text = |keys: &str| {
        let text = format!("cycle = \"1ms\"\n[[subdevice]]\n{keys}\n");
        SegmentFile::parse(&format!("{FOLDER}x.toml"), &text).unwrap_err().to_string()
    };
    let error = text("esi = \"box.xml\"\ntype = \"Terminal\"\nmodules = [\"DI8\"]");
    assert!(error.contains("has no slots for modules"), "{error}");
    let error = text("device = \"simple_io4\"\nmodules = [\"DI8\"]");
    assert!(error.contains("given without esi"), "{error}");
}

#[test]
fn the_edges_of_a_slot_at_both_sides() {
    let modules = |count| format!(r#"[{{ slot = "Digital", module = "DI8", count = {count} }}]"#);
    assert_eq!(profile(&modules(6)).assignment.inputs.len(), 7);
    assert!(refused(&modules(7)).contains("takes 6 modules at most"));
    // MaxSlotCount counts all places together.
    let few = RACK.replace("<Slots ", "<Slots MaxSlotCount=\"3\" ");
    let file = EsiFile::from_bytes("rack.xml", few.as_bytes()).unwrap();
    let choose = |count| {
        let wish = ModuleWish { slot: None, module: Some(ModuleName::Ident(0x2041)), count };
        file.choose_modules(&file.devices[0], &[wish]).map(|modules| modules.len())
    };
    assert_eq!(choose(3), Ok(3));
    assert_eq!(
        choose(4).unwrap_err().message,
        "there is no place 3 for a module; the device takes 3 modules at most"
    );
    assert!(choose(usize::MAX).is_err());
}

#[test]
fn what_two_modules_both_have_is_told() {
    let segment = rack(r#"["Fixed", "Fixed"]"#);
    assert_eq!(segment.subdevices[0].profile.assignment.inputs, [0x1AFF, 0x1AF0]);
    let notes = &segment.subdevices[0].notes;
    let note = notes.iter().find(|note| note.kind.name() == "module-index-repeated").unwrap();
    assert_eq!(note.what, "PDO 0x1AF0 of \"Fixed\" at place 1 stands before, too");
    // What was doubtful about the default modules is not told of these.
    assert!(notes.iter().all(|note| note.kind.name() != "slot-module-assumed"), "{notes:?}");
}

#[test]
fn the_list_of_modules_as_the_slots_ask_for_it() {
    let profile = |text: &str| {
        let file = EsiFile::from_bytes("rack.xml", text.as_bytes()).unwrap();
        Profile::from_esi(&file, &file.devices[0], None).unwrap()
    };
    let listed = |profile: &Profile| {
        let of_list = profile.startup.iter().filter(|one| one.object.index == 0xF030);
        of_list.map(|one| one.transition.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(listed(&profile(RACK)), ["PS", "PS"], "by default, too");
    // Nothing to write, and nothing that asks for it.
    let (list, rest) = RACK.split_once("<Name>DTF050</Name>").unwrap();
    let read_only =
        format!("{}<Name>DTF050</Name>{rest}", list.replace("<Access>rw", "<Access>ro"));
    assert_eq!(listed(&profile(&read_only)), [""; 0]);
    let asks = |text: &str| text.replace("<Slots ", "<Slots DownloadModuleIdentList=\"1\" ");
    assert_eq!(listed(&profile(&asks(&read_only))), ["PS"], "the count can't be written");
    let at_ip = asks(RACK).replace("<Slots ", "<Slots DownloadModuleListTransition=\"IP\" ");
    assert_eq!(listed(&profile(&at_ip)), ["IP", "IP"]);
    // A device that takes a list has both objects, whatever its file forgets.
    let none = asks(RACK).replace("#xF030", "#xF031").replace("#xF050", "#xF051");
    let made = profile(&none);
    assert_eq!(listed(&made), ["PS", "PS"]);
    assert_eq!(value(&made, 0xF050, 1), Some(0x2040));
    // A file with the download among its InitCmds has it once.
    let own = RACK.replace(
        "<Index>#xF800</Index><SubIndex>1</SubIndex><Data>07",
        "<Index>#xF030</Index><SubIndex>1</SubIndex><Data>40200000",
    );
    assert_eq!(listed(&profile(&own)), ["PS"]);
}

#[test]
fn a_rack_with_modules_is_in_sync() {
    let mut scenario = Scenario::from(rack(
        r#"["DI8", "DO16", "", { module = "DI16", count = 3 }, "AI 4 channels"]"#,
    ));
    scenario.duration = Nanos::millis(100);
    let report = run(&scenario);
    assert!(report.verdict.to_string().starts_with("In sync"), "{}", report.verdict);
}

#[test]
fn devices_lists_slots_and_what_they_take() {
    let isocat = |arguments: &[&str]| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_isocat"))
            .args(arguments)
            .current_dir(FOLDER)
            .output()
            .unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (output.status.code(), text(output.stdout) + &text(output.stderr))
    };
    let (code, list) = isocat(&["devices", "rack.xml", "rack_modules.xml", "--modules"]);
    assert_eq!(code, Some(0), "{list}");
    let slots = list.find("  slot \"Digital\"").expect("slots");
    assert_eq!(
        &list[slots..],
        "  slot \"Digital\"  places 0 to 5, 1 needed
    0x00002040  DI16                      0 bits out, 16 bits in
    0x00002041  DI8                       0 bits out, 8 bits in
    0x00002042  DO16                      16 bits out, 0 bits in
    0x00002070  Twin                      0 bits out, 16 bits in
    0x00002071  Twin                      0 bits out, 8 bits in
    0x00002080  Fixed                     0 bits out, 8 bits in
    0x00003001  Far DI8                   0 bits out, 8 bits in
  slot \"Analog\"  place 6, may be empty
    0x00002050  AI 4 channels             0 bits out, 64 bits in
    0x00002060  Counter                   0 bits out, 16 bits in  for OpMode \"DC\"
  slot \"Other maker\"  place 7, may be empty
    0x00003001  Far DI8                   0 bits out, 8 bits in
"
    );
    assert!(!isocat(&["devices", "rack.xml"]).1.contains("  slot \""));
    let (code, list) = isocat(&["devices", "rack_modules.xml", "--modules"]);
    assert!(code == Some(0) && list.contains("0x00003001  Far DI8"), "{list}");
    for arguments in [&["devices", "--json"][..], &["devices", "simple_io4", "--modules"]] {
        let (code, words) = isocat(arguments);
        assert!(code == Some(2) && words.contains("which ends in .xml"), "{words}");
    }

    let (code, text) = isocat(&["devices", "rack.xml", "rack_modules.xml", "--json"]);
    assert_eq!(code, Some(0));
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let rack = &json["devices"][0];
    assert_eq!(rack["slots"][1]["first_place"], 6);
    assert_eq!(rack["slots"][1]["takes"], serde_json::json!([0x2050, 0x2060]));
    assert_eq!(rack["slots"][0]["preset"], serde_json::Value::Null);
    assert_eq!(json["modules"][8]["file"], "rack_modules.xml");
    assert_eq!(json["modules"][4]["op_modes"], serde_json::json!(["DC"]));
    assert_eq!(rack["op_modes"][1]["assign_activate"], 0x300);
}

#[test]
fn the_schema_of_the_catalogue_is_committed() {
    let now = serde_json::to_string_pretty(&catalog::schema()).unwrap() + "\n";
    let path: PathBuf =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/devices.schema.json");
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &now).unwrap();
    }
    let committed = std::fs::read_to_string(&path).expect("committed");
    assert!(committed == now, "docs/devices.schema.json is old: UPDATE_SCHEMA=1 writes it");
}

/// Each module that a hostile file repeats has a bound.
#[test]
fn many_large_modules_are_cut_short() {
    let data = "00".repeat(200_000);
    let commands = format!(
        "<Mailbox><CoE><InitCmd><Transition>PS</Transition><Index DependOnSlot=\"1\">#x8000</Index>\
         <SubIndex>2</SubIndex><Data>{data}</Data></InitCmd></CoE></Mailbox>"
    );
    let module = format!(
        "<Module><Type ModuleIdent=\"#x4000\" ModuleClass=\"digital\">Huge</Type>{commands}</Module></Modules>"
    );
    let text =
        RACK.replace("</Modules>", &module).replace("MaxInstances=\"6\"", "MaxInstances=\"255\"");
    let file = EsiFile::from_bytes("rack.xml", text.as_bytes()).unwrap();
    let wish = |count| ModuleWish { slot: None, module: Some(ModuleName::Ident(0x4000)), count };
    let fitted = |count| {
        let modules = file.choose_modules(&file.devices[0], &[wish(count)]).unwrap();
        file.fitted(&file.devices[0], &modules)
    };
    let commands = |device: &isocat::esi::EsiDevice| {
        let coe = device.mailbox.as_ref().unwrap().coe.as_ref().unwrap();
        coe.commands.iter().filter(|one| one.data.len() == 200_000).count()
    };
    let cut = |device: &isocat::esi::EsiDevice| {
        device.warnings.iter().any(|warning| warning.kind == WarningKind::ModulesTooLarge)
    };
    // 16 MiB hold 83 of 200 128 bytes.
    let (fits, beyond) = (fitted(83), fitted(84));
    assert_eq!((commands(&fits), cut(&fits)), (83, false));
    assert_eq!((commands(&beyond), cut(&beyond)), (83, true));
}
