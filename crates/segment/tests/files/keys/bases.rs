//! A valid file around every table, with a place for the key under test.

use isocat_segment::keys::Place;

/// A file with this line (`None`: an empty one) for the key of a place, and with the other keys
/// that it needs.
pub fn file(place: &Place, line: Option<&str>) -> String {
    let (name, head) = (place.key.name, place.section.head);
    let Base { mut before, lines, after, inline } = base(place.file.name, head, name);
    if line.is_some_and(|line| line.contains("\"ebus\"")) {
        // A MainDevice with EBUS needs a terminal.
        before = before.replace("simple_io4", "beckhoff_el2502-0010");
    }
    if (head, name) == ("[times]", "acknowledge") {
        before = before.replace("sync_unit = true", "sync_unit = true, pulse = \"0ns\"");
    }
    let (without, with) = beside(head, name);
    let own = lines.iter().filter(|(key, _)| *key != name && !without.contains(key));
    let mut lines: Vec<String> = own.map(|(key, value)| format!("{key} = {value}")).collect();
    lines.extend(with.iter().map(|line| (*line).to_owned()));
    if !inline || line.is_some() {
        lines.push(line.unwrap_or_default().to_owned());
    }
    format!("{before}{}{after}", lines.join(if inline { ", " } else { "\n" }))
}

struct Base {
    before: String,
    lines: &'static [(&'static str, &'static str)],
    after: &'static str,
    inline: bool,
}

/// Keys that must be removed and added for a key.
fn beside(head: &str, name: &str) -> (&'static [&'static str], &'static [&'static str]) {
    match (head, name) {
        ("[[subdevice]]", "esi") => (&["device"], &["type = \"EL2502-0010\""]),
        ("[[subdevice]]", "sii") => (&["device"], &[]),
        ("[[subdevice]]", "type") => (&["device"], &["esi = \"vendor.xml\""]),
        ("[[subdevice]]", "product" | "revision" | "opmode") => {
            (&["device"], &["esi = \"vendor.xml\"", "type = \"EL2502-0010\""])
        }
        ("[[subdevice]]", "modules") => (&["device"], &["esi = \"rack.xml\""]),
        ("[[subdevice]]", "sync1") => (&[], &["mode = \"dc-sync1\""]),
        ("[[subdevice]]", "sync0_cycle") => (&[], &["mode = \"dc-subordinated\""]),
        ("[[subdevice]]", "acknowledge") => (&[], &["pulse = \"0ns\""]),
        ("[[subdevice]]", "arrives") => (&[], &["optional = true"]),
        ("[[expect]]", "device") => (&[], &["worst_sync0 = \"1us\""]),
        ("[[output]]", "amplitude") => (&["value"], &["period = \"100ms\""]),
        ("[[output]]", "period") => (&["value"], &["amplitude = 5"]),
        ("[[output]]", "lasts") => (&["value"], &["amplitude = 5", "period = \"100ms\""]),
        ("[[plant]]", "torque") => (&[], &["commands = \"torque\""]),
        ("", "plant") => (&[], &[TARGET]),
        ("[[fault]]", "times") => (&[], &["every = \"200ms\""]),
        ("", "modes") => (&["mailbox"], &[]),
        ("", "startup") => (&[], &[WRITABLE]),
        ("[outputs]" | "[inputs]", "pdo") => (&["pdos"], &[]),
        ("[[object]]", "like") => (&["entries"], &[]),
        ("[[object]]", "without") => (&["entries"], &["like = \"kollmorgen_akd2g:1C32\""]),
        _ => (&[], &[]),
    }
}

const WRITABLE: &str =
    "object = [{ index = 0x2000, name = \"x\", entries = [[0, \"UNSIGNED8\", \"rw\", 1, \"x\"]] }]";

fn base(file: &str, head: &str, name: &str) -> Base {
    match file {
        "segment-file" => segment(head),
        _ => profile(head, name),
    }
}

const DEVICES: &str = "cycle = \"1ms\"\n[[subdevice]]\nname = \"axis 1\"\ndevice = \"model_every_mode\"\n\
                       [[subdevice]]\nname = \"x\"\n";
const DEVICE: (&str, &str) = ("device", "\"model_every_mode\"");

/// A drive, an output of its target, and a machine that it moves.
const AXIS: &str =
    "cycle = \"1ms\"\nsubdevice = [{ device = \"kollmorgen_akd2g\", name = \"x\" }]\n";
const OUTPUT: &str =
    "{ at = \"1s\", device = \"0\", place = \"0x607A:00\", type = \"i32\", value = 1 }";
const TARGET: &str =
    "output = [{ at = \"1s\", device = \"0\", place = \"0x607A:00\", type = \"i32\", value = 1 }]";
const PLANT: &str =
    "plant = [{ device = \"0\", motor_inertia = \"3kgcm2\", load_inertia = \"7kgcm2\" }]";

fn segment(head: &str) -> Base {
    let of_root = |head: &str| {
        format!("cycle = \"1ms\"\nsubdevice = [{{ device = \"simple_io4\" }}]\n{head}\n")
    };
    let of_device = |head: &str| format!("{DEVICES}device = \"simple_io4\"\n{head}\n");
    let mut after = "\n";
    let (before, lines): (_, &[(&str, &str)]) = match head {
        "" => (
            String::new(),
            &[("cycle", "\"1ms\""), ("subdevice", "[{ device = \"kollmorgen_akd2g\" }]")],
        ),
        "[host]" | "[quality]" | "[delay_watch]" => (of_root(head), &[]),
        "[[fault]]" => (
            of_root("[[fault]]").replace("}]", "}, { device = \"simple_io4\" }]"),
            &[("at", "\"2s\""), ("what", "\"pull 1\"")],
        ),
        "[[expect]]" => {
            (format!("{AXIS}output = [{OUTPUT}]\n{PLANT}\n[[expect]]\n"), &[("in_sync", "true")])
        }
        "[[output]]" => (
            format!("{AXIS}[[output]]\n"),
            &[("at", "\"1s\""), ("device", "\"x\""), ("place", "\"0x6060\""), ("value", "0")],
        ),
        "[[plant]]" => (
            format!("{AXIS}output = [{OUTPUT}]\n[[plant]]\n"),
            &[("device", "\"x\""), ("motor_inertia", "\"3kgcm2\""), ("load_inertia", "\"7kgcm2\"")],
        ),
        "recovery" => (of_root("[recovery]"), &[("first", "\"1s\""), ("longest", "\"30s\"")]),
        "[[subdevice]]" => (DEVICES.replace("name = \"x\"\n", ""), &[DEVICE]),
        "a table of modules" => {
            after = "}]\n";
            let text = of_device("").replace("device = \"simple_io4\"\n", "esi = \"rack.xml\"\n");
            (
                format!("{}modules = [{{ ", text.trim_end_matches('\n').to_owned() + "\n"),
                &[("module", "\"DI16\"")],
            )
        }
        "measured_times" => (of_device("[subdevice.measured_times]"), &[]),
        "clock_ramp" => {
            (of_device("[subdevice.clock_ramp]"), &[("by", "\"1ppm\""), ("over", "\"1s\"")])
        }
        "clock_step" => {
            (of_device("[subdevice.clock_step]"), &[("by", "\"1ppm\""), ("at", "\"1s\"")])
        }
        "clock_walk" => (
            of_device("[subdevice.clock_walk]"),
            &[("step", "\"1ppm\""), ("every", "\"1s\""), ("within", "\"2ppm\"")],
        ),
        other => panic!("no segment file around {other}"),
    };
    Base { before, lines, after, inline: after != "\n" }
}

/// The top level of a profile.
const ROOT: [(&str, &str); 8] = [
    ("id", "\"minimal\""),
    ("name", "\"Minimal\""),
    ("vendor", "\"Nobody\""),
    ("application", "\"io\""),
    ("identity", "{ vendor_id = 1, product_code = 2, revision = 3, device_type = 0 }"),
    ("esc", "{ chip = \"ET1100\", sync_unit = true }"),
    (
        "mailbox",
        "{ receive = { start = 0x1000, length = 128 }, send = { start = 0x1080, length = 128 } }",
    ),
    (
        "times",
        "{ reaction = \"50us\", application = \"20us\", calc_and_copy = \"10us\", input_copy = \"10us\" }",
    ),
];

fn profile(head: &str, name: &str) -> Base {
    let root = |without: &str, more: &str| {
        let lines = ROOT.iter().filter(|(key, _)| *key != without);
        let lines: String = lines.map(|(key, value)| format!("{key} = {value}\n")).collect();
        format!("{lines}{more}\n")
    };
    const AREA: &str = "[outputs]\nstart = 0x1100\nlength = 16\naccess = \"ro\"\n";
    const OBJECT: &str = "[[object]]\nindex = 0x2000\nname = \"x\"\n";
    let mut after = "\n";
    let (before, lines): (_, &[(&str, &str)]) = match head {
        "" => (String::new(), &ROOT),
        "[identity]" => (
            root("identity", head),
            &[("vendor_id", "1"), ("product_code", "2"), ("revision", "3"), ("device_type", "0")],
        ),
        "[esc]" => (root("esc", head), &[("chip", "\"ET1100\""), ("sync_unit", "true")]),
        "[mailbox]" => (
            root("mailbox", head),
            &[
                ("receive", "{ start = 0x1000, length = 128 }"),
                ("send", "{ start = 0x1080, length = 128 }"),
            ],
        ),
        "mailbox.receive" => (
            root(
                "mailbox",
                "[mailbox]\nsend = { start = 0x1F00, length = 128 }\n[mailbox.receive]",
            ),
            &[("start", "0x1000"), ("length", "128")],
        ),
        "[[startup]]" => {
            let entries = "entries = [[0, \"UNSIGNED8\", \"rw\", 1, \"x\"]]";
            (
                root("", &format!("{OBJECT}{entries}\n{head}")),
                &[("object", "\"2000:00\""), ("data", "\"07\"")],
            )
        }
        "[[opmode]]" => (root("", head), &[("name", "\"DC\""), ("assign_activate", "0x0300")]),
        "[[assumed]]" => {
            (root("", head), &[("what", "\"identity.revision\""), ("why", "\"since\"")])
        }
        "[[deviation]]" => (
            root("", head),
            &[("rule", "\"OBJ-04\""), ("places", "[\"1C32:05\"]"), ("why", "\"since\"")],
        ),
        "[times]" => (
            root("times", head),
            &[
                ("reaction", "\"50us\""),
                ("application", "\"20us\""),
                ("calc_and_copy", "\"10us\""),
                ("input_copy", "\"10us\""),
            ],
        ),
        "times.overrun" => (
            root(
                "times",
                "[times]\nreaction = \"50us\"\napplication = \"20us\"\ncalc_and_copy = \"10us\"\n\
                 input_copy = \"10us\"\n[times.overrun]",
            ),
            &[("one_in", "10"), ("by", "\"1ms\"")],
        ),
        // A device without a program has no mailbox.
        "[behaviour]" if name == "device_emulation" => {
            (root("mailbox", &format!("modes = [\"sm\"]\n{head}")), &[])
        }
        "[behaviour]" => (root("", head), &[]),
        "[outputs]" => (
            root("", head),
            &[
                ("start", "0x1100"),
                ("length", "16"),
                ("access", "\"rw preop\""),
                ("pdos", "[[0x1600, 16]]"),
            ],
        ),
        "[inputs]" => (
            root("", head),
            &[
                ("start", "0x1100"),
                ("length", "16"),
                ("access", "\"rw preop\""),
                ("pdos", "[[0x1A00, 16]]"),
            ],
        ),
        "[[outputs.pdo]]" => (
            root("", &format!("{AREA}{head}")),
            &[("index", "0x1600"), ("name", "\"x\""), ("entries", "[{ pad = 8 }]")],
        ),
        "[[inputs.pdo]]" => (
            root("", &format!("{}{head}", AREA.replace("outputs", "inputs"))),
            &[("index", "0x1A00"), ("name", "\"x\""), ("entries", "[{ pad = 8 }]")],
        ),
        "behind a row of a PDO" => {
            after = "}]]\n";
            let row = "entries = [[\"7000:01\", \"OCTET_STRING\", \"x\", { ";
            let pdo = format!("[[outputs.pdo]]\nindex = 0x1600\nname = \"x\"\n{row}");
            let area = AREA.replace("16", "32");
            (
                root("", &format!("{area}{pdo}")).trim_end_matches('\n').to_owned(),
                &[("bits", "128")],
            )
        }
        "padding of a PDO" => {
            after = "}]\n";
            let pdo = "[[outputs.pdo]]\nindex = 0x1600\nname = \"x\"\nentries = [{ ";
            (root("", &format!("{AREA}{pdo}")).trim_end_matches('\n').to_owned(), &[("pad", "8")])
        }
        "[[object]]" => (
            root("", head),
            &[
                ("index", "0x2000"),
                ("name", "\"x\""),
                ("entries", "[[0, \"UNSIGNED8\", \"ro\", 1, \"x\"]]"),
            ],
        ),
        "behind a row of an object" => {
            after = "}]]\n";
            let entries = "entries = [[0, \"UNSIGNED8\", \"ro\", 1, \"x\"], [1, \"UNSIGNED8\", \"ro\", 1, \"y\", { ";
            let text = root("", &format!("{OBJECT}{entries}"));
            (text.trim_end_matches('\n').to_owned(), &[("offset", "16")])
        }
        "gaps of an object" => {
            after = "}]\n";
            let entries = "entries = [[0, \"UNSIGNED8\", \"ro\", 1, \"x\"], { ";
            let text = root("", &format!("{OBJECT}{entries}"));
            (text.trim_end_matches('\n').to_owned(), &[("gaps", "[14, 31]"), ("bits", "8")])
        }
        other => panic!("no profile around {other} for {name}"),
    };
    Base { before, lines, after, inline: after != "\n" }
}
