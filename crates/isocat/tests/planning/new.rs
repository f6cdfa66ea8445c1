//! `isocat new`: what it writes is read, planned and run at once, whatever it was made of.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use isocat::SegmentFile;

fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.args(arguments).output().expect("isocat starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A path in a folder of this test's own.
fn scratch(name: &str) -> String {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("new");
    std::fs::create_dir_all(&folder).expect("a folder");
    folder.join(name).display().to_string()
}

/// Makes a file, plans and runs it; gives it.
fn made(arguments: &[&str], name: &str) -> SegmentFile {
    let path = scratch(name);
    let output = isocat(&[&["new"], arguments, &["--out", &path]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("next, try"), "{}", text(&output.stderr));
    let plan = isocat(&["plan", &path]);
    assert_eq!(plan.status.code(), Some(0), "{}{}", text(&plan.stdout), text(&plan.stderr));
    let run = isocat(&["run", &path, "--for", "200ms"]);
    assert_eq!(run.status.code(), Some(0), "{}{}", text(&run.stdout), text(&run.stderr));
    SegmentFile::read(&path).expect("it was read before")
}

fn names(file: &SegmentFile) -> Vec<&str> {
    file.subdevices.iter().map(|device| &*device.name).collect()
}

fn upstream(file: &SegmentFile) -> Vec<Option<(usize, usize)>> {
    let place = |device: &isocat::segment_file::SubDevice| device.place.upstream;
    let all = file.subdevices.iter().map(place);
    all.map(|place| place.map(|(above, port)| (above, port.index()))).collect()
}

const BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/box.xml");

#[test]
fn of_types_and_profiles() {
    let file = made(&["--esi", BOX, "Drive", "Drive", "kollmorgen_akd2g"], "types.toml");
    assert_eq!(names(&file), ["Drive", "Drive 2", "AKD2G"]);
    // The first OpMode with SYNC pulses, not the first of all.
    assert!(file.subdevices[0].mode.is_some_and(|mode| mode.name().starts_with("dc")));
}

/// A copy of a description with other words, in the folder of this test.
fn description(name: &str, of: &str, words: &[(&str, &str)]) -> String {
    let mut description = std::fs::read_to_string(of).expect("readable");
    for (old, new) in words {
        assert!(description.contains(old), "{old}");
        description = description.replacen(old, new, 1);
    }
    let path = scratch(name);
    std::fs::write(&path, description).expect("writable");
    path
}

/// A type that stands for two products: the one taken is said, with the other, in the file and on
/// the screen; the key for it takes either.
#[test]
fn a_type_of_several_products() {
    let second = "<Type ProductCode=\"#x00000101\" RevisionNo=\"#x00000001\">Drive</Type>";
    let other = second.replace("101", "103").replace("#x00000001", "#x00010000");
    let xml = description("products.xml", BOX, &[(second, &other)]);
    let path = scratch("products.toml");
    let output = isocat(&["new", "--esi", &xml, "Drive", "--out", &path]);
    let said = text(&output.stderr);
    let words = "has several products called Drive: 0x00000103 (Drive, old) is taken";
    assert!(said.contains(words) && said.contains("0x00000101 (Drive with everything"), "{said}");
    let file = std::fs::read_to_string(&path).expect("written");
    let key =
        "product = 0x00000103    # or 0x00000101 (Drive with everything, revision 0x00010000)\n";
    assert!(file.contains(key), "{file}");
    for (product, code) in [(0x103, "0x00000103"), (0x101, "0x00000101")] {
        let chosen = file.replace("product = 0x00000103", &format!("product = {code}"));
        let chosen = match product {
            // The description of the second one has nothing but its name.
            0x103 => chosen,
            _ => chosen.replace("opmode", "# opmode"),
        };
        let segment = SegmentFile::parse(&path, &chosen).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(segment.subdevices[0].profile.identity.product_code, product);
    }
}

/// Other revisions of the type stand behind the one that is taken.
#[test]
fn a_type_of_several_revisions() {
    made(&["--esi", BOX, "Drive"], "revisions.toml");
    let file = std::fs::read_to_string(scratch("revisions.toml")).expect("written");
    assert!(file.contains("revision = 0x00010000    # or 0x00000001\n"), "{file}");
    assert!(!file.contains("product ="), "{file}");
}

/// What stands in the slots is a comment that can be used as it is, with what each slot takes.
#[test]
fn a_modular_device_offers_its_modules() {
    let rack = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/esi/rack.xml");
    let before = made(&["--esi", rack], "rack.toml");
    let path = scratch("rack.toml");
    let file = std::fs::read_to_string(&path).expect("written");
    let comments = file.lines().filter_map(|line| line.strip_prefix("# "));
    let line = comments.clone().find(|line| line.starts_with("modules = [")).expect("a line");
    assert!(comments.clone().any(|line| line.starts_with("  slot \"Digital\" (places ")), "{file}");
    let used = file.replace(&format!("# {line}"), line);
    let after = SegmentFile::parse(&path, &used).unwrap_or_else(|error| panic!("{error}"));
    let image = |file: &SegmentFile| file.subdevices[0].profile.assignment.clone();
    if line.contains("as they are taken now") {
        assert_eq!(image(&after), image(&before));
    }
    // Whatever a slot is said to take can be chosen.
    let other = file.replace(&format!("# {line}"), "modules = [\"DI16\", \"DI8\"]");
    let other = SegmentFile::parse(&path, &other).unwrap_or_else(|error| panic!("{error}"));
    assert_ne!(image(&other), image(&before));
}

/// A device whose OpMode takes one cycle only decides the cycle of the file.
#[test]
fn a_fixed_sync0_decides_the_cycle() {
    for (sync0, cycle) in [("2000000", 2_000_000), ("3000000", 3_000_000)] {
        let old = "<CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0>";
        let new = format!("<CycleTimeSync0>{sync0}</CycleTimeSync0>");
        let xml = description(&format!("fixed-{sync0}.xml"), BOX, &[(old, &new)]);
        let file = made(&["--esi", &xml, "Drive"], &format!("fixed-{sync0}.toml"));
        assert_eq!(file.cycle.0, cycle);
    }
}

#[test]
fn terminals_get_a_coupler_where_a_cable_leads_to_them() {
    let el = "beckhoff_el2502-0010";
    let file = made(&[el, el, "kollmorgen_akd2g"], "terminals.toml");
    assert_eq!(names(&file), ["EK1100", "EL2502-0010", "EL2502-0010 2", "AKD2G"]);
    // The terminals at the coupler's EBUS, the drive at its other copper port.
    assert_eq!(upstream(&file), [None, Some((0, 1)), Some((1, 1)), Some((0, 2))]);
    let file = made(&["kollmorgen_akd2g", el], "behind.toml");
    assert_eq!(names(&file), ["AKD2G", "EK1100", "EL2502-0010"]);
    // Terminals alone are those of an embedded PC.
    let file = made(&[el, el], "embedded.toml");
    assert_eq!(names(&file), ["EL2502-0010", "EL2502-0010 2"]);
    let output = isocat(&["new", el, "kollmorgen_akd2g", "hpmicro_ecat_cia402_ssc"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[test]
fn of_a_scan() {
    let path = scratch("found.json");
    let scan = isocat(&["scan", "--json"]);
    std::fs::write(&path, &scan.stdout).expect("writable");
    let (file, built_in) = (made(&[&path], "scan.toml"), SegmentFile::built_in());
    assert_eq!(upstream(&file), upstream(&built_in));
    let identities = |file: &SegmentFile| -> Vec<u32> {
        file.subdevices.iter().map(|device| device.profile.identity.product_code).collect()
    };
    assert_eq!(identities(&file), identities(&built_in));
    // Cables by their delays: the built-in segment's are of 10 m each.
    assert_eq!(file.subdevices[1].cable, built_in.subdevices[1].cable);
    // Clocks against that of the first device, which is off by -35 ppm.
    let isocat::segment_file::Clock::Given(ppb) = file.subdevices[1].clock else {
        panic!("{:?}", file.subdevices[1].clock);
    };
    assert!((54_900..55_100).contains(&ppb.0), "{ppb:?}");
}

#[test]
fn of_an_eni() {
    let (segment, eni) = (scratch("source.toml"), scratch("network.xml"));
    let source = "cycle = \"2ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n[[subdevice]]\n\
                  device = \"kollmorgen_akd2g\"\n";
    std::fs::write(&segment, source).expect("writable");
    assert_eq!(isocat(&["plan", &segment, "--eni", &eni]).status.code(), Some(0));
    let file = made(&[&eni], "eni.toml");
    assert_eq!((file.subdevices.len(), file.cycle.0), (2, 2_000_000));
}

#[test]
fn what_cannot_be_made_is_said() {
    let json = scratch("wrong.json");
    let wrong = |arguments: &[&str], expected: &str| {
        let output = isocat(&[&["new"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        let words = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(expected), "{arguments:?}: {words}");
    };
    wrong(&[], "expected which devices");
    wrong(&["--esi", BOX], "expected which devices");
    wrong(&["--esi", BOX, "Drove"], "did you mean \"Drive\"?");
    wrong(&["--esi", "no-such.xml", "Drive"], "no-such.xml");
    std::fs::write(&json, "{ \"devices\": [").expect("writable");
    wrong(&[&json], "expected what `isocat scan --json` prints");
    std::fs::write(&json, "{ \"devices\": [{ \"vendor_id\": -1 }] }").expect("writable");
    wrong(&[&json], "devices[0].vendor_id: expected a number");
    let unknown = "{ \"devices\": [{ \"vendor_id\": 9, \"product_code\": 9, \"revision\": 9 }] }";
    std::fs::write(&json, unknown).expect("writable");
    wrong(&[&json], "expected its description (--esi)");
}

/// Descriptions of three makers: a coupler with a stepper terminal, and two drives.
#[test]
fn three_makers_in_sync() {
    let folder = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = |name: &str| folder.join(name).display().to_string();
    let files = [
        path("esi-more/14_Beckhoff_EL7xxx.xml"),
        path("esi/sanyodenki_RS2.xml"),
        path("esi/synapticon_somanet_cia402.xml"),
    ];
    if !files.iter().all(|file| Path::new(file).exists()) {
        println!("skipped: no descriptions in {}", folder.display());
        return;
    }
    let [a, b, c] = &files;
    let types = ["EL7041", "SanyoDenki RS2 EtherCAT", "CiA402 Motor Control Device"];
    let arguments = [&["--esi", a, "--esi", b, "--esi", c][..], &types].concat();
    let file = made(&arguments, "makers.toml");
    assert_eq!(file.subdevices.len(), 4);
    assert!(
        file.subdevices[1..]
            .iter()
            .all(|device| { device.mode.is_some_and(|mode| mode.name().starts_with("dc")) })
    );
}
