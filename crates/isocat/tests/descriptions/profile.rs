//! `isocat profile`: what it writes is a profile, and runs as what it was made of.

use std::path::Path;
use std::process::{Command, Output};

use isocat::Nanos;
use isocat::profile::{Profile, built_in_text};
use serde_json::Value;

fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.args(arguments).output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A path in a folder of this test's own.
fn scratch(name: &str) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("profile");
    std::fs::create_dir_all(&folder).expect("a folder");
    folder.join(name).display().to_string()
}

fn write(name: &str, content: &str) -> String {
    let path = scratch(name);
    std::fs::write(&path, content).expect("writable");
    path
}

/// Writes a profile; gives its path and what was said about it.
fn made(arguments: &[&str], name: &str) -> (String, String) {
    let path = scratch(name);
    let output = isocat(&[&["profile"], arguments, &["--out", &path]].concat());
    let notes = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {notes}");
    assert!(notes.contains("a segment file takes it as device = "), "{notes}");
    (path, notes)
}

/// A segment file of one device, named by the keys of its table.
fn segment(name: &str, keys: &str) -> String {
    write(name, &format!("cycle = \"2ms\"\n[[subdevice]]\n{keys}\n"))
}

/// The first line of a run, and its exit code.
fn run(segment: &str) -> (String, Option<i32>) {
    let output = isocat(&["run", segment, "--for", "100ms"]);
    let said = text(&output.stdout) + &text(&output.stderr);
    (said.lines().next().unwrap_or_default().to_owned(), output.status.code())
}

fn scan(segment: &str) -> Value {
    let output = isocat(&["scan", segment, "--json"]);
    serde_json::from_slice(&output.stdout).expect("a document")
}

const IN_SYNC: &str = "In sync: 1 of 1 SubDevices.";
const BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/box.xml");

#[test]
fn of_a_description() {
    let (path, _) = made(&[BOX, "--type", "Drive"], "drive.toml");
    let profile = std::fs::read_to_string(&path).expect("a file");
    assert!(profile.starts_with("# Made by `isocat profile` of Drive ("), "{profile}");
    // Without --out the same goes to standard output, and the notes beside it.
    let printed = isocat(&["profile", BOX, "--type", "Drive"]);
    assert_eq!((printed.status.code(), text(&printed.stdout)), (Some(0), profile.clone()));
    assert!(text(&printed.stderr).contains("isocat profile: "), "{}", text(&printed.stderr));

    let described = segment("described.toml", &format!("esi = \"{BOX}\"\ntype = \"Drive\""));
    let written = segment("written.toml", &format!("device = \"{path}\""));
    assert_eq!(run(&described), (IN_SYNC.to_owned(), Some(0)));
    assert_eq!(run(&written), (IN_SYNC.to_owned(), Some(0)));
}

/// What a description does not state is unknown in the profile, or named as assumed where something
/// must be there, and is read back as that.
#[test]
fn what_a_description_does_not_state() {
    let mut description = std::fs::read_to_string(BOX).expect("readable");
    for (old, new) in [
        ("<Info><DefaultData>90d00300</DefaultData></Info>", "<Info/>"),
        ("<Info><DefaultData>0700</DefaultData></Info>", "<Info/>"),
        ("<Info><DefaultValue>30000</DefaultValue></Info>", "<Info/>"),
    ] {
        assert!(description.contains(old), "{old}");
        description = description.replacen(old, new, 1);
    }
    let xml = write("not-stated.xml", &description);
    let (path, notes) = made(&[&xml, "--type", "Drive", "--opmode", "DC"], "not-stated.toml");
    let profile = std::fs::read_to_string(&path).expect("a file");
    for row in [
        "[0x05, \"UNSIGNED32\", \"ro\", \"unknown\", ",
        "[0x06, \"UNSIGNED32\", \"ro\", \"unknown\", ",
        "what = \"identity.hardware_version\"",
        "what = \"identity.software_version\"",
    ] {
        assert!(profile.contains(row), "{row}: {profile}");
    }
    // 0x1000 is stated, and 0x2000:03 is unknown.
    assert!(!profile.contains("identity.device_type"), "{profile}");
    assert!(
        profile.contains("[0x03, ") && profile.contains("what = \"1C32:04\""),
        "{profile}\n{notes}"
    );

    let read = isocat::profile::Profile::from_toml(&path, &profile).expect("it was written");
    let assumed: Vec<_> = read.assumptions.iter().map(|a| (&*a.item, &*a.value)).collect();
    for item in [("0x1C32:05", "unknown"), ("0x1C32:06", "unknown"), ("0x1C32:09", "unknown")] {
        let is_there = item.0 != "0x1C32:09";
        assert_eq!(assumed.contains(&item), is_there, "{item:?}: {assumed:?}");
    }
    let stated = read.sync_parameters(0x1C32).expect("the object");
    let zero = Some(isocat::Nanos::ZERO);
    assert_eq!((stated.minimum_cycle_time, stated.calc_and_copy_time), (zero, zero), "as read");
    assert_eq!(
        run(&segment("not-stated-segment.toml", &format!("device = \"{path}\""))),
        (IN_SYNC.to_owned(), Some(0))
    );
}

#[test]
fn an_op_mode_by_its_name_or_its_number() {
    let list = text(&isocat(&["devices", BOX]).stdout);
    let of = |op_mode: &str| {
        let output = isocat(&["profile", BOX, "--type", "Drive", "--opmode", op_mode]);
        assert_eq!(output.status.code(), Some(0), "{list}{}", text(&output.stderr));
        text(&output.stdout)
    };
    let head = |profile: &str| profile.lines().next().unwrap_or_default().to_owned();
    let by_number = of("0");
    let first = head(&by_number).split("OpMode ").nth(1).expect("its name").to_owned();
    assert_eq!(of(first.trim_end_matches(").")), by_number);
    assert_ne!(head(&of("1")), head(&by_number));
}

#[test]
fn of_an_eeprom() {
    let image = scratch("akd.bin");
    let output = isocat(&["sii", "--from", "kollmorgen_akd2g", "--out", &image]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let (path, _) = made(&[&image], "akd.toml");
    let (alone, written) = (
        segment("sii.toml", &format!("sii = \"{image}\"")),
        segment("of_sii.toml", &format!("device = \"{path}\"")),
    );
    assert_eq!(run(&alone).1, Some(0));
    assert_eq!(run(&written).1, Some(0));

    // One bit of the configuration: an ESC does not load it, and nothing is made of it.
    let mut bytes = std::fs::read(&image).expect("a file");
    bytes[4] ^= 1;
    std::fs::write(&image, bytes).expect("writable");
    refused(&[&image], "word 0x0007: checksum: expected");
}

/// What a scan of the profile reads is what the scan that it was made of has read.
#[test]
fn of_a_scan() {
    for id in [
        "kollmorgen_akd2g",
        "hpmicro_ecat_cia402_ssc",
        "infineon_xmc4300_ssc",
        "microchip_samd51_lan9252_ssc",
        "yaskawa_sgd7s-a0",
        "model_every_mode",
        "simple_io16",
    ] {
        let there = segment(&format!("{id}.toml"), &format!("device = \"{id}\""));
        let found = scan(&there);
        let document = write(&format!("{id}.json"), &found.to_string());
        let (path, _) = made(&[&document], &format!("{id}_found.toml"));
        let here = segment(&format!("{id}_again.toml"), &format!("device = \"{path}\""));
        let again = scan(&here);
        let part = |document: &Value| {
            let device = &document["devices"][0];
            let sync = |key: &str| {
                let entries = device[key]["entries"].as_array().cloned().unwrap_or_default();
                let entry = |entry: &Value| {
                    format!("{} {} {}", entry["sub"], entry["value"], entry["writable"])
                };
                entries.iter().map(entry).collect::<Vec<_>>()
            };
            let kept = [
                "name",
                "vendor_id",
                "product_code",
                "revision",
                "serial",
                "sii_alias",
                "ports",
                "mailbox",
                "outputs",
                "inputs",
                "op_modes",
            ];
            let esc = [
                "kind",
                "sync_managers",
                "ram_kib",
                "dc",
                "sync_unit",
                "sync_pulse_ns",
                "device_emulation",
            ];
            let mut all: Vec<_> =
                kept.iter().map(|key| format!("{key}: {}", device[*key])).collect();
            all.extend(esc.iter().map(|key| format!("esc.{key}: {}", device["esc"][*key])));
            all.extend(["output_sync", "input_sync"].map(|key| format!("{key}: {:?}", sync(key))));
            all
        };
        for (before, after) in part(&found).into_iter().zip(part(&again)) {
            // A mailbox of a profile can do all that CoE has.
            let before = before.replace("\"SDO\",", "").replace("\"PDO configuration\",", "");
            let after = after.replace("\"SDO\",", "").replace("\"PDO configuration\",", "");
            assert_eq!(before, after, "{id}");
        }
        assert_eq!(run(&there).1, Some(0), "{id}");
        assert_eq!(run(&here).1, Some(0), "{id}");
    }
}

/// What was not read is unknown, and a device of several is named.
#[test]
fn a_scan_that_could_not_read_everything() {
    let there = segment("one.toml", "device = \"kollmorgen_akd2g\"");
    let mut document = scan(&there);
    let minimum = document["devices"][0]["output_sync"]["entries"]
        .as_array_mut()
        .expect("entries")
        .iter_mut()
        .find(|entry| entry["sub"] == 5)
        .expect("a minimum cycle time");
    (minimum["value"], minimum["in_words"]) = (Value::Null, "can't be read".into());
    document["devices"][0]["esc"]["sync_pulse_ns"] = Value::Null;
    let twice = document["devices"][0].clone();
    document["devices"].as_array_mut().expect("devices").push(twice);
    document["devices"][1]["name"] = "the other".into();
    let path = write("unread.json", &document.to_string());
    refused(&[&path], "it has 2 devices; expected which of them, such as --device 0");
    refused(&[&path, "--device", "2"], "no device \"2\"; expected 0 to 1, or a name");
    let (by_name, _) = made(&[&path, "--device", "the other"], "unread.toml");
    let profile = std::fs::read_to_string(&by_name).expect("a file");
    assert!(profile.contains("name = \"the other\""), "{profile}");
    assert!(profile.contains("[0x05, \"UNSIGNED32\", \"ro\", \"unknown\""), "{profile}");
    assert!(profile.contains("pulse = \"10us\"") && profile.contains("what = \"esc.pulse\""));
    assert_eq!(run(&segment("unread_run.toml", &format!("device = \"{by_name}\""))).1, Some(0));
}

/// Every example of the page is a profile, and runs.
#[test]
fn examples_of_the_page() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/profile.md");
    let page = std::fs::read_to_string(page).expect("the page");
    let blocks: Vec<_> = page
        .split("```toml\n")
        .skip(1)
        .map(|rest| rest.split("```").next().unwrap_or_default())
        .filter(|block| block.starts_with("id = "))
        .collect();
    assert_eq!(blocks.len(), 3, "the least, one with SYNC0, one without mailbox");
    for (number, block) in blocks.iter().enumerate() {
        let path = write(&format!("page{number}.toml"), block);
        let (words, code) = run(&segment("page.toml", &format!("device = \"{path}\"")));
        assert_eq!(code, Some(0), "{words}\n{block}");
    }
    let with_sync0 = format!("device = \"{}\"\nmode = \"dc-sync0\"", scratch("page1.toml"));
    assert_eq!(run(&segment("page.toml", &with_sync0)), (IN_SYNC.to_owned(), Some(0)));
}

fn refused(arguments: &[&str], expected: &str) {
    let output = isocat(&[&["profile"], arguments].concat());
    let words = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {words}");
    assert!(words.contains(expected), "{arguments:?}: {words}");
    assert!(output.stdout.is_empty(), "{arguments:?}");
}

#[test]
fn flags_that_do_not_go_with_the_file() {
    let json = write("flags.json", "{}");
    let image = write("flags.bin", "");
    refused(&[], "required arguments were not provided");
    refused(&[BOX, "--device", "0"], "--device is beside");
    refused(&[&image, "--device", "0"], "--device is beside");
    for flag in ["--type", "--product", "--revision", "--opmode"] {
        refused(&[&json, flag, "1"], &format!("{flag} is beside"));
    }
    for flag in ["--type", "--product", "--revision"] {
        refused(&[&image, flag, "1"], &format!("{flag} is beside"));
    }
    for (flag, value) in [("--product", "x"), ("--revision", "-1"), ("--product", "0x100000000")] {
        refused(&[BOX, &format!("{flag}={value}")], "expected a number of 32 bits");
    }
    refused(&[BOX], "the file has several devices; expected the type of one of them");
    refused(&[BOX, "--type", "Drove"], "did you mean \"Drive\"?");
    refused(&[BOX, "--type", "Drive", "--product", "9"], "no");
    refused(
        &[BOX, "--type", "Drive", "--opmode", "nix"],
        "has no OpMode \"nix\" expected one of: ",
    );
    refused(&[BOX, "--type", "Drive", "--opmode", "99"], "has no OpMode \"99\"");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).display().to_string();
    refused(&[BOX, "--type", "Drive", "--out", &folder], "can't be written");
}

#[test]
fn files_that_are_none() {
    for (name, content, expected) in [
        ("x.toml", "id = \"x\"", "a profile is made of a maker's description (.xml)"),
        ("x.json", "", "x.json:1:0: EOF while parsing"),
        ("x.json", "{ \"devices\": [", "expected what `isocat scan --json` prints"),
        ("x.json", "[]", "its format is null; expected \"isocat-scan/1\""),
        ("x.json", "{ \"format\": \"isocat-run/1\" }", "expected \"isocat-scan/1\""),
        ("x.json", "{ \"format\": \"isocat-scan/1\", \"devices\": [] }", "no \"devices\""),
        (
            "x.json",
            "{ \"format\": \"isocat-scan/1\", \"devices\": [{ \"vendor_id\": -1 }] }",
            "devices[0].vendor_id: expected a number of 32 bits, found -1",
        ),
        ("x.bin", "short", "expected a header of 64 words, found 5 bytes"),
        ("x.xml", "", "not well-formed XML"),
        ("x.xml", "<EtherCATInfo/>", ""),
    ] {
        refused(&[&write(name, content)], expected);
    }
    refused(&[&write("deep.json", &"[".repeat(100_000))], "recursion limit exceeded");
    refused(&[&write("text.bin", &"no EEPROM ".repeat(100))], "checksum: expected");
    for name in ["missing.xml", "missing.json", "missing.bin"] {
        refused(&[&scratch(name)], "can't be read");
    }
    // One byte more than is read.
    for (name, most) in [("long.json", 64 << 20), ("long.bin", 512 << 10)] {
        let path = scratch(name);
        let file = std::fs::File::create(&path).expect("writable");
        file.set_len(most + 1).expect("a long file");
        refused(&[&path], "too long: expected at most");
        std::fs::remove_file(&path).expect("it is there");
    }
}

/// A document in which any one place is something else is a profile or an error with its place.
#[test]
fn spoilt_documents() {
    let good = scan(&segment("spoilt.toml", "device = \"kollmorgen_akd2g\""));
    let mut places = Vec::new();
    leaves(&good["devices"][0], "/devices/0", &mut places);
    let wrong = [
        Value::Null,
        Value::from(-1),
        Value::from(1_u64 << 40),
        Value::from("x"),
        Value::Array(Vec::new()),
        Value::from(0xFFFF),
    ];
    let of_interest = |place: &String| {
        ["esc", "ports", "mailbox", "puts", "sync", "op_modes", "_id", "_code", "name", "alias"]
            .iter()
            .any(|part| place.contains(part))
    };
    places.retain(of_interest);
    assert!(places.len() > 100, "{}", places.len());
    for (number, place) in places.iter().enumerate().step_by(2) {
        let mut spoilt = good.clone();
        *spoilt.pointer_mut(place).expect("a place") = wrong[(number / 2) % wrong.len()].clone();
        let output = isocat(&["profile", &write("spoilt.json", &spoilt.to_string())]);
        let words = text(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 2)), "{place}: {words}");
        assert!(output.status.code() == Some(0) || words.contains("expected"), "{place}: {words}");
    }
}

fn leaves(value: &Value, at: &str, all: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            members.iter().for_each(|(key, value)| leaves(value, &format!("{at}/{key}"), all));
        }
        Value::Array(items) => {
            let each = items.iter().enumerate();
            each.for_each(|(number, value)| leaves(value, &format!("{at}/{number}"), all));
        }
        _ => all.push(at.to_owned()),
    }
}

/// A drive whose file has the interpolation time gets its cycle at start; one whose file is silent
/// has the object and is left alone, since a real one may be without.
#[test]
fn an_interpolation_time_that_the_file_has_is_written_at_start() {
    let text = built_in_text("kollmorgen_akd2g").expect("a profile");
    let object = "\n[[object]]\nindex = 0x60C2\nname = \"Interpolation time\"\ncode = \"record\"\nentries = [\n\
                  [0, \"UNSIGNED8\", \"ro\", 2, \"Count\"],\n[1, \"UNSIGNED8\", \"ACCESS\", 1, \"Units\"],\n\
                  [2, \"INTEGER8\", \"ACCESS\", -3, \"Index\"],\n]\n";
    let profile = |more: &str| Profile::from_toml("drive.toml", &(text.to_owned() + more)).unwrap();
    let parts = |more: &str| {
        let profile = profile(more);
        assert!(profile.description.object(0x60C2).is_some());
        let at = |cycle| {
            let all = &profile.startup;
            all.iter().map(|one| one.at_cycle(all, Nanos::micros(cycle))[0]).collect::<Vec<_>>()
        };
        [at(4_000), at(250)]
    };
    assert_eq!(parts(&object.replace("ACCESS", "rw")), [[4, 0xFD], [250, 0xFA]]);
    assert_eq!(parts(&object.replace("ACCESS", "ro")), [[0; 0]; 2]);
    assert_eq!(parts(""), [[0; 0]; 2]);
}
