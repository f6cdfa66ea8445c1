//! `isocat sii` and the key `sii`: texts, the document and its schema, images of descriptions, real
//! EEPROMs served and compared.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use isocat::esi::{EsiFile, Wish};
use isocat::sii::{DoubtKind, Names, SiiFile, report};
use isocat_wire::sii::{categories, category, word};

fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.args(arguments).output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A path in a folder of this test's own.
fn scratch(name: &str) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sii");
    std::fs::create_dir_all(&folder).expect("a folder");
    folder.join(name).display().to_string()
}

fn shared(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if !path.exists() {
        println!("skipped: no {}", path.display());
        return None;
    }
    Some(path)
}

const BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/box.xml");

#[test]
fn an_image_is_written_and_read() {
    let path = scratch("drive.bin");
    let output = isocat(&["sii", "--from", BOX, "--type", "Drive", "--out", &path]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let read = isocat(&["sii", &path]);
    assert_eq!(read.status.code(), Some(0), "{}", text(&read.stdout));
    // The same without a file between.
    let made = isocat(&["sii", "--from", BOX, "--type", "Drive"]);
    assert_eq!(text(&made.stdout).lines().nth(1), text(&read.stdout).lines().nth(1));
    assert!(text(&read.stdout).contains("product 0x00000101"), "{}", text(&read.stdout));
    let json = isocat(&["sii", &path, "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).expect("JSON");
    let keys = report::schema()["properties"].as_object().expect("keys").clone();
    assert!(json.as_object().expect("a document").keys().eq(keys.keys()));
    assert_eq!((json["product_code"].as_u64(), json["bytes"].as_u64()), (Some(0x101), Some(2_048)));
}

#[test]
fn what_is_doubtful_or_broken_has_its_word() {
    let path = scratch("profile.bin");
    let output = isocat(&["sii", "--from", "simple_io4", "--out", &path]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let mut image = std::fs::read(&path).expect("written");
    image[14] ^= 1;
    std::fs::write(&path, &image).expect("writable");
    let output = isocat(&["sii", &path]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("word 0x0007: checksum: expected"));
    std::fs::write(&path, &image[..100]).expect("writable");
    let output = isocat(&["sii", &path]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("word 0x0032"), "{}", text(&output.stderr));
    for wrong in [
        &["sii", "--from", BOX, "--type", "Drove"][..],
        &["sii", "--from", "simple_io4", "--type", "Drive"],
        &["sii", "--from", "no_such_profile"],
        &["sii", "--from", BOX, "--type", "Drive", "--product", "many"],
        &["sii"],
    ] {
        assert_eq!(isocat(wrong).status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn the_schema_is_committed_and_each_doubt_documented() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let now = serde_json::to_string_pretty(&report::schema()).expect("JSON") + "\n";
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(docs.join("sii.schema.json"), &now).expect("docs/ is writable");
    }
    let committed = std::fs::read_to_string(docs.join("sii.schema.json")).expect("committed");
    assert_eq!(now, committed, "the document changed: run with UPDATE_SCHEMA=1 and raise FORMAT");
    let page = std::fs::read_to_string(docs.join("sii.md")).expect("the page");
    for kind in DoubtKind::ALL {
        let name = kind.name();
        assert!(page.contains(&format!("| `{name}` |")), "docs/sii.md lacks {name}");
    }
}

/// A segment of one device, run and planned; gives the exit codes and what `plan` says.
fn tried(name: &str, device: &str) -> ([Option<i32>; 2], String) {
    let path = scratch(name);
    std::fs::write(&path, format!("cycle = \"1ms\"\nfor = \"100ms\"\n[[subdevice]]\n{device}\n"))
        .expect("writable");
    let (plan, run) = (isocat(&["plan", &path]), isocat(&["run", &path]));
    // Where a line ends depends on how long the project's own path is.
    let words = text(&plan.stdout) + &text(&plan.stderr);
    let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
    ([plan.status.code(), run.status.code()], words)
}

#[test]
fn a_device_serves_the_bytes_of_a_file() {
    let image = scratch("box.bin");
    let output = isocat(&["sii", "--from", BOX, "--type", "Drive", "--out", &image]);
    assert_eq!(output.status.code(), Some(0));
    let (codes, words) = tried("alone.toml", "sii = \"box.bin\"");
    assert_eq!(codes, [Some(0), Some(0)], "{words}");
    let esi = format!("esi = {BOX:?}\ntype = \"Drive\"\n");
    let (codes, words) = tried("beside.toml", &format!("{esi}sii = \"box.bin\""));
    assert_eq!(codes, [Some(0), Some(0)], "{words}");

    // Another serial number is what `scan` finds.
    let mut bytes = std::fs::read(&image).expect("written");
    bytes[2 * usize::from(word::SERIAL)] = 77;
    std::fs::write(scratch("serial.bin"), &bytes).expect("writable");
    let path = scratch("serial.toml");
    let segment = format!("cycle = \"1ms\"\n[[subdevice]]\n{esi}sii = \"serial.bin\"\n");
    std::fs::write(&path, segment).expect("writable");
    let scan = isocat(&["scan", &path, "--json", "--quick"]);
    let scan: serde_json::Value = serde_json::from_slice(&scan.stdout).expect("JSON");
    assert_eq!(scan["devices"][0]["serial"], 77, "{}", scan["devices"][0]);

    // Another product is no EEPROM of this device, another revision is one of another age.
    bytes[2 * usize::from(word::REVISION)] += 1;
    std::fs::write(scratch("serial.bin"), &bytes).expect("writable");
    let (codes, words) = tried("serial.toml", &format!("{esi}sii = \"serial.bin\""));
    assert_eq!(codes, [Some(0), Some(0)], "{words}");
    assert!(words.contains("sii-revision"), "{words}");
    bytes[2 * usize::from(word::PRODUCT_CODE)] += 1;
    std::fs::write(scratch("serial.bin"), &bytes).expect("writable");
    let (codes, words) = tried("serial.toml", &format!("{esi}sii = \"serial.bin\""));
    assert_eq!(codes, [Some(2), Some(2)]);
    assert!(
        words.contains("expected product code 0x00000101") && words.contains("found"),
        "{words}"
    );
    let (codes, words) = tried("missing.toml", "sii = \"no-such.bin\"");
    assert_eq!(codes, [Some(2), Some(2)]);
    assert!(words.contains(":4:7: "), "{words}");
}

/// Real EEPROMs are read without a doubt, but for the two that are broken on purpose.
#[test]
fn real_eeproms_are_read() {
    let Some(folder) = shared("captures/eeprom") else { return };
    let doubts = |name: &str| {
        let file = SiiFile::read(&folder.join(name).display().to_string()).expect("readable");
        file.doubts.iter().map(|doubt| (doubt.kind, doubt.word)).collect::<Vec<_>>()
    };
    for name in ["akd.hex", "ek1100.hex", "el2004.bin", "el2828.hex", "el2889.hex"] {
        assert_eq!(doubts(name), [], "{name}");
    }
    // Twelve bytes are missing in its strings.
    let cut = [
        (DoubtKind::Size, 0x3E),
        (DoubtKind::StringUnprintable, 0x72),
        (DoubtKind::CategoryCut, 0x145),
        (DoubtKind::SyncManagersMissing, 0x145),
        (DoubtKind::GeneralMissing, 0x145),
    ];
    assert_eq!(doubts("akd_null_strings.hex"), cut);
    let empty: Vec<_> = doubts("empty.bin").into_iter().map(|(kind, _)| kind.name()).collect();
    let all = ["checksum", "identity", "size", "version", "many-categories", "general-missing"];
    assert_eq!(empty, all);
    // What an SII alone is enough for.
    for name in ["akd.hex", "ek1100.hex"] {
        let path = folder.join(name).display().to_string();
        let (codes, words) = tried(&format!("{name}.toml"), &format!("sii = {path:?}"));
        assert_eq!(codes, [Some(0), Some(0)], "{name}: {words}");
    }
}

/// Images of makers' descriptions: devices that come to OP in reality, so nothing keeps them from
/// there, but for one file that KickCAT's authors made wrong for their tests.
#[test]
fn no_maker_is_blamed() {
    let mut devices = 0;
    for folder in ["esi", "esi-more"].into_iter().filter_map(shared) {
        for entry in std::fs::read_dir(folder).expect("readable") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
            let name = name.unwrap_or_default();
            // Whole images and the configuration area are not always in the description.
            let Ok(esi) = EsiFile::read(&path.display().to_string()) else { continue };
            for device in &esi.devices {
                let Ok(image) = esi.sii(device).image(0, Names::Fitting) else { continue };
                let file = SiiFile::from_bytes(&name, &image).expect("it has a header");
                devices += 1;
                let kept: Vec<_> = file.doubts.iter().filter(|doubt| doubt.keeps_from_op).collect();
                let expected = usize::from(name == "kickcat_sm_fmmu.xml");
                assert_eq!(kept.len(), expected, "{name} {}: {kept:?}", device.type_name);
                let lesser = [
                    DoubtKind::SyncManagerOff,
                    DoubtKind::SyncManagerUntyped,
                    DoubtKind::SyncManagerDirection,
                ];
                let blamed = file.doubts.iter().filter(|doubt| lesser.contains(&doubt.kind));
                let blamed = blamed.count();
                assert!(blamed <= expected, "{name} {}: {blamed}", device.type_name);
            }
        }
    }
    println!("{devices} devices");
}

/// An EEPROM of which something was forgotten: what `sii`, `run` and `scan` say of it.
#[test]
fn what_is_missing_is_the_cause() {
    let path = scratch("whole.bin");
    let output = isocat(&["sii", "--from", BOX, "--type", "Drive", "--out", &path]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let mut image = std::fs::read(&path).expect("written");
    // The categories were never written.
    image[2 * usize::from(word::CATEGORIES)..].fill(0xFF);
    std::fs::write(scratch("header.bin"), &image).expect("writable");
    let read = isocat(&["sii", &scratch("header.bin")]);
    let words = text(&read.stdout);
    assert_eq!(read.status.code(), Some(1), "{words}");
    assert!(words.contains("this EEPROM can't bring a device to OP\n  - word 0x0040: "), "{words}");
    let json = isocat(&["sii", &scratch("header.bin"), "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).expect("JSON");
    let doubts = json["doubts"].as_array().expect("doubts");
    let kept = doubts.iter().find(|doubt| doubt["keeps_from_op"] == true).expect("one");
    assert_eq!(
        (&kept["kind"], kept["word"].as_u64()),
        (&"sync-managers-missing".into(), Some(0x40))
    );
    assert!(
        kept["remedies"][0].as_str().is_some_and(|remedy| remedy.contains("isocat sii --from"))
    );

    let segment = |name: &str, of: &str, eeprom: &str| {
        let path = scratch(name);
        let device = format!("{of}sii = {eeprom:?}\n");
        let file = format!("cycle = \"1ms\"\nfor = \"100ms\"\n[[subdevice]]\n{device}");
        std::fs::write(&path, file).expect("writable");
        path
    };
    let said = |verb: &str, path: &str| {
        let output = isocat(&[verb, path]);
        let words = text(&output.stdout) + &text(&output.stderr);
        let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
        (output.status.code(), words)
    };
    let lack = "EEPROM can't bring a device to OP: word 0x0040: sync-managers-missing";
    let broken = segment("header.toml", "", "header.bin");
    for verb in ["run", "scan"] {
        let (code, words) = said(verb, &broken);
        assert_eq!(code, Some(1), "{words}");
        assert!(words.contains(lack), "{verb}: {words}");
    }
    // Beside a description the plan sees it before any frame.
    let of = format!("esi = {BOX:?}\ntype = \"Drive\"\n");
    let (code, words) = said("run", &segment("beside-header.toml", &of, "header.bin"));
    assert!(code == Some(2) && words.contains(lack), "{words}");
    let whole = segment("whole.toml", &of, "whole.bin");
    for verb in ["run", "scan"] {
        let (code, words) = said(verb, &whole);
        assert_eq!(code, Some(0), "{words}");
        assert!(!words.contains("EEPROM can't"), "{verb}: {words}");
    }
}

/// An EEPROM that was never written: the ESC has no door to a CPU, or a CPU is there and the
/// content is blank.
#[test]
fn a_blank_eeprom_was_never_written() {
    for (byte, told) in [(0xFF, "did not load the EEPROM"), (0x00, "the EEPROM is blank")] {
        std::fs::write(scratch("blank.bin"), [byte; 2_048]).expect("writable");
        let read = isocat(&["sii", &scratch("blank.bin")]);
        assert_eq!(read.status.code(), Some(1));
        assert!(text(&read.stdout).contains("word 0x0000: blank: "), "{}", text(&read.stdout));
        let path = scratch("blank.toml");
        std::fs::write(&path, "cycle = \"1ms\"\n[[subdevice]]\nsii = \"blank.bin\"\n")
            .expect("writable");
        let run = isocat(&["run", &path]);
        let words = text(&run.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(run.status.code(), Some(1), "{words}");
        assert!(words.contains(told) && words.contains("Write the image of its maker"), "{words}");
    }
}

/// A dead EEPROM is told as one, at each door; it was called busy.
#[test]
fn a_dead_eeprom_is_no_busy_one() {
    let path = scratch("dead.toml");
    let fault = "[[fault]]\nat = \"0ms\"\nwhat = \"dead-eeprom 0\"\n";
    let file = format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n{fault}");
    std::fs::write(&path, file).expect("writable");
    let capture = scratch("dead.pcapng");
    let words = |arguments: &[&str]| {
        let output = isocat(arguments);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        text(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let run = words(&["run", &path, "--capture", &capture]);
    assert!(run.contains("no EEPROM answers") && run.contains("Cause: The ESC asks"), "{run}");
    assert!(!run.contains("stays busy"), "{run}");
    let scan = words(&["scan", &path]);
    assert!(scan.contains("no EEPROM answers"), "{scan}");
    let diagnosed = words(&["diagnose", &capture]);
    assert!(diagnosed.contains("no EEPROM answers"), "{diagnosed}");
}

/// A byte of a real EEPROM that differs from the image of the description: where, and why.
struct Difference {
    place: String,
    why: Option<&'static str>,
}

/// Real EEPROMs beside images of their descriptions, byte by byte: each difference has its reason.
#[test]
fn images_are_those_of_the_makers() {
    let (Some(eeproms), Some(terminals)) =
        (shared("captures/eeprom"), shared("esi-more/01_Beckhoff_EL2xxx.xml"))
    else {
        return;
    };
    let Some(couplers) = shared("esi/beckhoff_EK11xx.xml") else { return };
    for (eeprom, file, type_name, different) in [
        ("ek1100.hex", &couplers, "EK1100", 5),
        ("el2004.bin", &terminals, "EL2004", 1),
        ("el2889.hex", &terminals, "EL2889", 5),
    ] {
        let real = std::fs::read(eeproms.join(eeprom)).expect("readable");
        let of_real = SiiFile::from_bytes(eeprom, &real).expect("readable");
        let esi = EsiFile::read(&file.display().to_string()).expect("readable");
        let revision = of_real.sii.header.revision;
        let wish = Wish { type_name: Some(type_name), product: None, revision: Some(revision) };
        let device = esi.device(wish).expect("it is in the file").device;
        let ours = esi.image_of_sii(device).expect("it fits").bytes;
        assert_eq!(real.len(), ours.len());
        let (equal, differences) = compare(&real, &ours, device.revision == Some(revision));
        for Difference { place, why } in &differences {
            println!("{eeprom} {place}: {}", why.unwrap_or("?"));
        }
        assert!(differences.iter().all(|difference| difference.why.is_some()));
        assert_eq!(differences.len(), different, "{eeprom}: {equal} bytes are equal");
    }
}

fn compare(real: &[u8], ours: &[u8], same_revision: bool) -> (usize, Vec<Difference>) {
    let (mut equal, mut differences) = (0, Vec::new());
    let mut section =
        |name: &str, one: &[u8], other: &[u8], why: &dyn Fn(usize) -> Option<&'static str>| {
            assert_eq!(one.len(), other.len(), "{name}");
            for (at, (found, made)) in one.iter().zip(other).enumerate() {
                match found == made {
                    true => equal += 1,
                    false => differences.push(Difference {
                        place: format!("{name} byte {at:#04x} real {found:#04x} ours {made:#04x}"),
                        why: why(at),
                    }),
                }
            }
        };
    section("header", &real[..0x80], &ours[..0x80], &|at| match at {
        0x18..0x1C if !same_revision => Some("the description has an older revision only"),
        0x40..0x4C => Some("words 0x20 to 0x25: written at manufacture"),
        _ => None,
    });
    let find = |image: &[u8], kind| {
        let mut all = categories(image).map(|category| category.expect("whole"));
        all.find(|category| category.kind == kind).map(|category| category.data.to_vec())
    };
    let kinds = |image: &[u8]| -> Vec<u16> {
        categories(image).map(|category| category.expect("whole").kind).collect()
    };
    // Sync units are the tool's own; no description has them.
    let wanted: Vec<_> = kinds(real).into_iter().filter(|kind| *kind != SYNC_UNITS).collect();
    assert_eq!(wanted, kinds(ours));
    for kind in wanted.into_iter().filter(|kind| *kind != category::STRINGS) {
        let (one, other) = (find(real, kind), find(ours, kind));
        let name = format!("category {kind}");
        section(&name, &one.unwrap_or_default(), &other.unwrap_or_default(), &|at| {
            let physical_layer = kind == category::GENERAL && at == 4;
            physical_layer.then_some("physical layer, reserved today")
        });
    }
    // Texts are numbered alike; those of the group and of the device were written in German.
    let texts = |image: &[u8]| {
        let file = SiiFile::from_bytes("x", image).expect("readable");
        let general = file.sii.general.expect("there is one");
        let pdos = file.sii.outputs.iter().chain(&file.sii.inputs);
        let entries = pdos.clone().flat_map(|pdo| &pdo.entries).map(|entry| entry.name.clone());
        let names: Vec<String> = pdos.map(|pdo| pdo.name.clone()).chain(entries).collect();
        (general.order, general.group, names)
    };
    assert_eq!(texts(real), texts(ours));
    let count = |image: &[u8]| find(image, category::STRINGS).map(|data| data[0]);
    assert_eq!(count(real), count(ours));
    (equal, differences)
}

/// Category of sync units.
const SYNC_UNITS: u16 = 43;
