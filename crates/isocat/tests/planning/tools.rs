//! `isocat plan --for TOOL`: one golden text per tool, what its own language says of it, and the
//! numbers in it against the plan's own document.
//!
//! The folder `golden/tools` has the segment, the texts, and our own declarations of the calls that
//! the two texts in C use. `tests/interop/other_tools.py` lets the tools themselves run what is
//! printed.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use isocat::tool::Tool;
use serde_json::Value;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/tools")
}

/// Runs beside the golden files, so that no text depends on where this checkout lies.
fn isocat(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    command.current_dir(folder()).args(arguments).output().expect("isocat starts")
}

fn printed(segment: &str, tool: Tool) -> String {
    let output = isocat(&["plan", segment, "--for", tool.name()]);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{}: {errors}", tool.name());
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn plan(segment: &str) -> Value {
    let output = isocat(&["plan", segment, "--json"]);
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// A segment of this test's own; its path.
fn scratch(name: &str, content: &str) -> String {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, content).expect("the target directory is writable");
    path.to_str().expect("UTF-8").to_owned()
}

/// Names that end comments, strings and lines of one language or another.
const AWKWARD: &str = r#"
cycle = "4ms"
watchdog = "20ms"
[[subdevice]]
device = "model_every_mode"
name = "--> */ \"\"\" # {}%\\"
mode = "dc-shift-sync1"
[[subdevice]]
device = "simple_io16"
name = "</slave>&'\\"
"#;

const WITHOUT_SYNC: &str = r#"
cycle = "4ms"
[[subdevice]]
device = "simple_io16"
name = "io"
[[subdevice]]
device = "beckhoff_ek1100"
[[subdevice]]
device = "beckhoff_el2502-0010"
name = "pwm"
"#;

const NOTHING_TO_SET: &str = r#"
cycle = "4ms"
[[subdevice]]
device = "beckhoff_ek1100"
"#;

#[test]
fn each_tool_has_its_text() {
    let update = std::env::var_os("UPDATE_GOLDEN").is_some();
    for tool in Tool::ALL {
        let name = match tool {
            Tool::TwinCat => "twincat.txt",
            Tool::Igh => "igh.c",
            Tool::Lcec => "lcec.xml",
            Tool::Ros2 => "ros2.yaml",
            Tool::Soem => "soem.c",
            Tool::PySoem => "pysoem.py",
            Tool::Ethercrab => "ethercrab.rs.txt",
            Tool::KickCat => "kickcat.py",
        };
        let (path, text) = (folder().join(name), printed("segment.toml", tool));
        if update {
            std::fs::write(&path, &text).expect("writable");
        }
        let golden = std::fs::read_to_string(&path).expect(name);
        assert!(
            text == golden,
            "{name} is another one: UPDATE_GOLDEN=1, then look at the difference"
        );
    }
}

#[test]
fn a_compiler_takes_the_calls_in_c() {
    let awkward = scratch("awkward.toml", AWKWARD);
    let without = scratch("without_sync.toml", WITHOUT_SYNC);
    let nothing = scratch("nothing_to_set.toml", NOTHING_TO_SET);
    for tool in [Tool::Igh, Tool::Soem] {
        for segment in ["segment.toml", &awkward, &without, &nothing] {
            let file = scratch(&format!("{}.c", tool.name()), &printed(segment, tool));
            let mut cc = Command::new("cc");
            cc.args(["-std=gnu99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I"]);
            let Ok(output) = cc.arg(folder().join("include")).arg(&file).output() else {
                println!("skipped: there is no cc");
                return;
            };
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{} of {segment}: {said}", tool.name());
        }
    }
}

/// Elements of linuxcnc-ethercat, the element around each, and its attributes; by its parser.
const LCEC: [(&str, &str, &[&str]); 9] = [
    ("masters", "", &[]),
    ("master", "masters", &["idx", "appTimePeriod", "refClockSyncCycles", "refClockSlaveIdx"]),
    ("slave", "master", &["idx", "type", "vid", "pid", "name", "configPdos"]),
    (
        "dcConf",
        "slave",
        &["assignActivate", "sync0Cycle", "sync0Shift", "sync1Cycle", "sync1Shift"],
    ),
    ("watchdog", "slave", &["divider", "intervals"]),
    ("sdoConfig", "slave", &["idx", "subIdx"]),
    ("sdoDataRaw", "sdoConfig", &["data"]),
    ("syncManager", "slave", &["idx", "dir"]),
    ("pdo", "syncManager", &["idx"]),
];

#[test]
fn xml_has_known_elements_and_the_numbers_of_the_plan() {
    let awkward = scratch("awkward_xml.toml", AWKWARD);
    for segment in ["segment.toml", &awkward] {
        let (text, plan) = (printed(segment, Tool::Lcec), plan(segment));
        let document = roxmltree::Document::parse(&text).expect("well-formed");
        for node in document.descendants().filter(roxmltree::Node::is_element) {
            let name = node.tag_name().name();
            let around = node.parent_element().map_or("", |parent| parent.tag_name().name());
            let (within, attributes) = match name {
                "pdoEntry" => ("pdo", &["idx", "subIdx", "bitLen", "halPin", "halType"][..]),
                _ => {
                    let known = LCEC.iter().find(|(known, ..)| *known == name);
                    known.map(|(_, within, attributes)| (*within, *attributes)).expect(name)
                }
            };
            assert_eq!(around, within, "{name}");
            for attribute in node.attributes() {
                assert!(attributes.contains(&attribute.name()), "{name} {}", attribute.name());
            }
        }
        let named =
            |name: &'static str| document.descendants().filter(move |n| n.has_tag_name(name));
        let master = named("master").next().expect("master");
        let number = |value: &Value| value.as_i64().expect("a number").to_string();
        assert_eq!(master.attribute("appTimePeriod"), Some(&*number(&plan["segment"]["cycle_ns"])));
        let devices = plan["devices"].as_array().expect("devices");
        assert_eq!(named("slave").count(), devices.len());
        for (slave, device) in named("slave").zip(devices) {
            let dc = slave.children().find(|node| node.has_tag_name("dcConf"));
            let of = |name| dc.and_then(|dc| dc.attribute(name)).map(str::to_owned);
            let wanted = |name: &str| device[name].as_i64().map(|value| value.to_string());
            assert_eq!(of("sync0Cycle"), wanted("sync0_cycle_ns"), "{device}");
            assert_eq!(of("sync0Shift"), wanted("sync0_phase_ns"));
            assert_eq!(of("sync1Cycle"), wanted("sync1_ns"));
            let word =
                device["sync0_cycle_ns"].is_i64().then(|| match device["sync1_ns"].is_i64() {
                    true => "700".to_owned(),
                    false => "300".to_owned(),
                });
            assert_eq!(of("assignActivate"), word);
        }
    }
}

/// 20 ms are 200 steps of 100 us, for the device with outputs that takes them.
#[test]
fn a_watchdog_that_is_asked_for_is_in_each_text_that_can_set_it() {
    let awkward = scratch("awkward_watchdog.toml", AWKWARD);
    for (tool, wanted) in [
        (Tool::TwinCat, "Set SM Watchdog (Reg. 420h): 200, 20 ms"),
        (Tool::Igh, "ecrt_slave_config_watchdog(sc[1], 2498, 200);"),
        (Tool::Lcec, "<watchdog divider=\"2498\" intervals=\"200\"/>"),
        (Tool::Ros2, "LIMIT: the watchdogs (0x0400 to 0x0420) can't be set"),
        (Tool::Soem, "word(2, 0x0420, 200);"),
        (Tool::PySoem, "(1, 0x0420, 200),"),
        (Tool::Ethercrab, "device.register_write(0x0420u16, 200u16)"),
        (Tool::KickCat, "WATCHDOG = 0.02"),
    ] {
        assert!(printed(&awkward, tool).contains(wanted), "{}: {wanted}", tool.name());
        assert!(!printed("segment.toml", tool).contains(wanted), "{}: {wanted}", tool.name());
    }
}

#[test]
fn without_sync_nothing_is_said_of_pulses() {
    let without = scratch("without.toml", WITHOUT_SYNC);
    for (tool, call) in [
        (Tool::TwinCat, "Enable SYNC 0"),
        (Tool::Igh, "ecrt_slave_config_dc("),
        (Tool::Lcec, "<dcConf"),
        (Tool::Ros2, "assign_activate:"),
        (Tool::Soem, "ecx_dcsync0(&ctx"),
        (Tool::Ethercrab, ".configure_dc_sync("),
        (Tool::KickCat, "the binding has no clocks"),
    ] {
        assert!(!printed(&without, tool).contains(call), "{}", tool.name());
        assert!(printed("segment.toml", tool).contains(call), "{}", tool.name());
    }
}

#[test]
fn files_are_written_where_they_are_wanted() {
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("for_tools");
    let _ = std::fs::remove_dir_all(&out);
    std::fs::create_dir_all(&out).expect("writable");
    let (file, yaml) = (out.join("segment.c"), out.join("yaml"));
    let write = |tool: &str, path: &Path| {
        isocat(&["plan", "segment.toml", "--for", tool, "--out", path.to_str().expect("UTF-8")])
    };
    let output = write("igh", &file);
    assert_eq!((output.status.code(), output.stdout.len()), (Some(0), 0));
    assert_eq!(
        std::fs::read_to_string(&file).expect("written"),
        printed("segment.toml", Tool::Igh)
    );
    assert_eq!(write("ros2", &yaml).status.code(), Some(0));
    let mut names: Vec<_> = std::fs::read_dir(&yaml).expect("a folder").collect();
    names.sort_by_key(|entry| entry.as_ref().expect("readable").file_name());
    let texts = names.into_iter().map(|entry| entry.expect("readable").path());
    let texts: Vec<_> = texts.map(|path| std::fs::read_to_string(path).expect("written")).collect();
    // The coupler has nothing that could be set.
    assert_eq!(texts.len(), 4);
    assert_eq!(texts.join("---\n"), printed("segment.toml", Tool::Ros2));
    // A file stands where the folder would be.
    let output = write("ros2", &file);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("segment.c can't be written"), "{said}");
}

#[test]
fn the_exit_code_is_that_of_the_plan() {
    let late = scratch(
        "for_late.toml",
        "cycle = \"100us\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n",
    );
    for tool in Tool::ALL {
        let code = |more: &[&str]| isocat(&[&["plan", &late][..], more].concat()).status.code();
        assert_eq!(
            (code(&["--for", tool.name()]), code(&[])),
            (Some(1), Some(1)),
            "{}",
            tool.name()
        );
    }
    let text = isocat(&["plan", &late, "--for", "igh"]).stdout;
    assert!(String::from_utf8_lossy(&text).contains("Does not fit, because SubDevice 0"));
}

#[test]
fn what_does_not_go_together_is_refused() {
    for (arguments, expected) in [
        (&["--for", "codesys"][..], "the name of a tool: twincat, igh, lcec"),
        (&["--for", "igh", "--prove"], "--for igh is beside --prove"),
        (&["--for", "igh", "--json"], "--for igh is beside --json"),
        (&["--for", "1s"], "without --prove"),
        (&["--for", "1s", "--prove", "--out", "x"], "--out is beside --for DURATION"),
        (&["--out", "x"], "--for"),
    ] {
        let output = isocat(&[&["plan", "segment.toml"], arguments].concat());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
    }
}

/// A description with downloads at edges: all bits of 32, a transition of its own, complete access
/// from this sub-index on.
fn described(name: &str, opmode: usize, from: u8) -> String {
    let (before, after) =
        include_str!("../esi/box.xml").split_once("<Name>DT2000</Name>").expect("there");
    let after = after
        .replacen("<Access>ro</Access>", "<Access>rw</Access>", 1)
        .replace("<Data>07000000</Data>", "<Data>ffffffff</Data>")
        .replace("<Index>#x3000</Index><SubIndex>1</SubIndex><Data>07</Data>", &format!(
            "<Index>#x2000</Index><SubIndex>{from}</SubIndex><Data>0300010000000200000003000000</Data>"
        ))
        .replace("</InitCmd>\n\t\t\t\t\t\t<InitCmd><Transition>PS", "</InitCmd><InitCmd CompleteAccess=\"1\"><Transition>IP");
    let esi = scratch(&format!("{name}.xml"), &format!("{before}<Name>DT2000</Name>{after}"));
    let keys = "type = \"Drive\"\nproduct = 0x101\nrevision = 0x10000";
    let device = format!("[[subdevice]]\nesi = {esi:?}\n{keys}\nopmode = {opmode}\n");
    scratch(&format!("{name}.toml"), &format!("cycle = \"1ms\"\n{device}"))
}

#[test]
fn complete_access_that_can_not_begin_there_is_a_limit() {
    let segment = described("for_complete", 1, 1);
    for tool in [Tool::Igh, Tool::Lcec] {
        let text = printed(&segment, tool);
        assert!(text.contains("complete access begins at sub-index 0 here: 0x2000:01"), "{text}");
        assert!(!text.contains("complete_sdo") && !text.contains("\"complete\""), "{text}");
    }
    assert!(printed(&segment, Tool::Soem).contains("0x2000, 0x01, TRUE, 14,"));
}

#[test]
fn downloads_keep_value_length_and_transition() {
    let segment = described("for_downloads", 1, 0);
    for (tool, wanted) in [
        (
            Tool::TwinCat,
            &[
                "Transition P -> S, Index (hex) 2000, Sub-Index (dec) 1, Complete Access off, Data (hexbin) FF FF FF FF",
                "Transition I -> P, Index (hex) 2000, Sub-Index (dec) 0, Complete Access on, Data (hexbin) 03 00 01",
            ][..],
        ),
        (
            Tool::Igh,
            &[
                "ecrt_slave_config_sdo32(sc[0], 0x2000, 0x01, 4294967295u)",
                "0x03, 0x00, 0x00, 0x00}, 14)",
                "// The plan writes the next one in IP.",
            ],
        ),
        (
            Tool::Lcec,
            &["<sdoDataRaw data=\"FF FF FF FF\"/>", "<sdoConfig idx=\"2000\" subIdx=\"complete\">"],
        ),
        // Its values are signed and have 32 bits.
        (
            Tool::Ros2,
            &[
                "{index: 0x2000, sub_index: 0x01, type: int32, value: -1}",
                "# LIMIT: 0x2000:00 has 14 bytes",
            ],
        ),
        (
            Tool::Soem,
            &[
                "0x2000, 0x01, FALSE, 4, (uint8[]){0xFF, 0xFF, 0xFF, 0xFF}",
                "0x2000, 0x00, TRUE, 14, (uint8[]){0x03, 0x00, 0x01",
            ],
        ),
        (
            Tool::PySoem,
            &[
                "(0, 0x2000, 0x01, bytes.fromhex(\"ffffffff\"), False)",
                "(0, 0x2000, 0x00, bytes.fromhex(\"0300010000000200000003000000\"), True)",
            ],
        ),
        (
            Tool::Ethercrab,
            &["sdo_write(0x2000, 0x01u8, 4294967295u32)", "LIMIT: 0x2000:00 with complete access"],
        ),
        (Tool::KickCat, &["(0, 0x2000, 0x00, True, bytes.fromhex(\"03000100"]),
    ] {
        let text = printed(&segment, tool);
        for wanted in wanted {
            assert!(text.contains(wanted), "{}: {wanted} in\n{text}", tool.name());
        }
    }
}

/// Latch units at the device and a SYNC0 of a quarter of the cycle: more than some tools have words
/// for.
#[test]
fn a_whole_word_of_a_description_reaches_every_tool_that_can_write_it() {
    let segment = described("for_words", 2, 0);
    let device = plan(&segment)["devices"][0].clone();
    assert_eq!(device["sync0_cycle_ns"], 250_000);
    for (tool, wanted) in [
        (Tool::TwinCat, "the one with AssignActivate #x0730"),
        (Tool::Igh, "ecrt_slave_config_dc(sc[0], 0x0730, 250000,"),
        (Tool::Lcec, "assignActivate=\"730\" sync0Cycle=\"250000\""),
        (Tool::Ros2, "assign_activate: 0x0730"),
        (Tool::Soem, "word(1, 0x0980, 0x0730);"),
        (Tool::PySoem, "(0, 0x0980, 0x0730),"),
        (Tool::Ethercrab, "(0, 0x0730, [250000, 750000],"),
        (Tool::KickCat, "Wanted: AssignActivate 0x0730, SYNC0 every 250000 ns"),
    ] {
        let text = printed(&segment, tool);
        assert!(text.contains(wanted), "{}: {wanted} in\n{text}", tool.name());
    }
    assert!(
        printed(&segment, Tool::Ros2).contains("SYNC0 always has the period of control_frequency")
    );
}
