//! Facts that pages state about the product are compared with it: counts, versions, limits, sizes
//! that a script bounds, names of verbs, functions, examples and files.
//!
//! A sentence of a page stands here with `{}` in the place of its number. If the sentence changes,
//! it changes here, too; if the product changes, the test says what the page must say.

use std::collections::BTreeSet;
use std::process::Command;

use isocat::serve::bus;
use isocat::tool::Tool;
use isocat::{Scenario, SegmentFile, conform, profile};

use crate::documents::{root, text};

pub fn page(name: &str) -> String {
    text(&root().join(name))
}

fn in_words(count: usize) -> String {
    const WORDS: [&str; 13] = [
        "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten",
        "eleven", "twelve",
    ];
    WORDS.get(count).map_or(count.to_string(), |word| (*word).to_owned())
}

/// A number with its thousands apart, as pages have it.
fn in_thousands(count: usize) -> String {
    match (count / 1_000, count % 1_000) {
        (0, rest) => rest.to_string(),
        (more, rest) => format!("{} {rest:03}", in_thousands(more)),
    }
}

/// The number behind a text in a file, up to the first character that is no digit.
fn number_behind(file: &str, mark: &str) -> usize {
    let content = page(file);
    let (_, rest) = content.split_once(mark).unwrap_or_else(|| panic!("{file} has no {mark:?}"));
    let digits: String = rest.trim_start().chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap_or_else(|_| panic!("{file}: {mark:?} is followed by no number"))
}

pub fn names(folder: &str, is_one: impl Fn(&str) -> bool) -> BTreeSet<String> {
    let entries =
        std::fs::read_dir(root().join(folder)).unwrap_or_else(|e| panic!("{folder}: {e}"));
    let names = entries.map(|entry| entry.expect("readable").file_name());
    names.map(|name| name.to_string_lossy().into_owned()).filter(|name| is_one(name)).collect()
}

fn rules() -> String {
    conform::rules::all().count().to_string()
}

/// The numbered examples of all packages.
fn examples() -> BTreeSet<String> {
    let packages = names("crates", |_| true);
    let folders = packages.iter().map(|package| format!("crates/{package}/examples"));
    let folders = folders.filter(|folder| root().join(folder).is_dir());
    let numbered = |name: &str| name.as_bytes()[..2].iter().all(u8::is_ascii_digit);
    folders.flat_map(|folder| names(&folder, numbered)).collect()
}

fn profiles(kind: &str) -> usize {
    let models = ["simple_io16", "simple_io4", "model_every_mode"];
    let couplers = ["beckhoff_ek1100", "beckhoff_ek1110"];
    let is_of = |id: &&str| match kind {
        "made up" => models.contains(id),
        "couplers" => couplers.contains(id),
        "devices" => !models.contains(id) && !couplers.contains(id),
        _ => true,
    };
    profile::built_in_ids().filter(is_of).count()
}

/// The packages that a package takes into a program on Linux, itself left out.
fn needs(package: &str) -> BTreeSet<String> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.current_dir(root()).args(["tree", "--offline", "--locked", "-p", package]);
    cargo.args(["-e", "normal", "--prefix", "none", "--format", "{p}"]);
    let output = cargo.args(["--target", "x86_64-unknown-linux-gnu"]).output().expect("cargo");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = String::from_utf8(output.stdout).expect("UTF-8");
    let name = |line: &str| line.split_whitespace().next().map(str::to_owned);
    printed.lines().filter_map(name).filter(|name| name != package).collect()
}

fn devices() -> String {
    in_words(Scenario::from(SegmentFile::built_in()).devices.len())
}

fn version(file: &str, key: &str) -> String {
    let content = page(file);
    let line = content.lines().find(|line| line.starts_with(key)).expect("the key");
    line.split('"').nth(1).expect("a text").trim_start_matches(">=").to_owned()
}

/// What the stack takes by the table of firmware/README.md, in round figures.
fn footprint() -> String {
    let content = page("firmware/README.md");
    let row = content.lines().find(|line| line.starts_with("| `footprint`: ")).expect("its row");
    let bytes = row.split('|').filter_map(|cell| cell.trim().replace(' ', "").parse::<u32>().ok());
    let bytes: Vec<u32> = bytes.collect();
    let (flash, ram) = (bytes[0].next_multiple_of(10_000) / 1_000, bytes[1] / 1_000);
    format!("{flash} kB of flash and {ram} kB")
}

/// A page, a sentence with a number, and the number.
type Counted = (&'static str, &'static str, fn() -> String);

const COUNTED: &[Counted] = &[
    ("README.md", "# {} rules for 0x1C32", rules),
    ("docs/conform.md", "# {} rules, each with its source", rules),
    ("docs/supported.md", "| {} rules on objects", rules),
    ("crates/conform/README.md", "{} rules that the synchronization of a SubDevice keeps", rules),
    ("README.md", "(docs/library.md) has {} examples", || in_words(examples().len())),
    ("docs/supported.md", "; {} built in:", || profiles("all").to_string()),
    ("docs/supported.md", "{} devices as their makers' tables", || profiles("devices").to_string()),
    ("docs/supported.md", "a coupler and an extension, two (`simple_io16`, `simple_io4`)", || {
        assert_eq!((profiles("couplers"), profiles("made up")), (2, 3));
        String::new()
    }),
    ("docs/library.md", "`isocat-host` needs {} other crates", || {
        in_words(needs("isocat-host").len())
    }),
    ("docs/library.md", "other crates, {} of them ours", || {
        let all = needs("isocat-host");
        in_words(all.iter().filter(|name| name.starts_with("isocat-")).count())
    }),
    ("docs/SUMMARY.md", "[Synchronization in {} pictures](pictures.md)", || {
        let content = page("docs/pictures.md");
        in_words(content.lines().filter(|line| line.starts_with("## ")).count())
    }),
    ("benches/instructions.txt", "the built-in segment: {} SubDevices", devices),
    ("crates/isocat/benches/run.rs", "wire, {} ESCs with stacks", devices),
    ("docs/benchmarks.md", "22 670, {}. Hundred seconds", || {
        in_thousands(number_behind("benches/instructions.txt", "run.one_cycle"))
    }),
    ("docs/benchmarks.md", "The command's tests are {} programs by subject", || {
        let folder = "crates/isocat/tests";
        let is_program = |name: &str| root().join(folder).join(name).join("main.rs").is_file();
        in_words(names(folder, is_program).len())
    }),
    ("README.md", "build with Rust {} or later", || version("Cargo.toml", "rust-version")),
    ("docs/c.md", "the Rust toolchain ({} or newer)", || version("Cargo.toml", "rust-version")),
    ("docs/python.md", "one file for CPython {} and\nnewer", || {
        version("crates/isocat-py/pyproject.toml", "requires-python")
    }),
    ("playground/README.md", "`build` prints its size, and fails above {} bytes", || {
        in_thousands(number_behind("playground/build", "\nmost="))
    }),
    ("docs/python.md", "The wheel is to stay below {} MB", || {
        (number_behind(".ci/python", "[ \"$size\" -lt") / 1_000_000).to_string()
    }),
    ("docs/c.md", "`libisocat.so` ({} MB stripped on x86-64)", || {
        let bytes = number_behind("tests/interop/c_door.sh", "[ \"$size\" -lt");
        format!("{:.2}", (bytes / 10_000) as f64 / 100.0)
    }),
    ("firmware/README.md", "holds both programs to {} of RAM", || {
        let of = |part| number_behind("firmware/memory.x", part);
        let flash = of("FLASH : ORIGIN = 0x00000000, LENGTH =");
        format!("{flash} KiB of flash and {} KiB", of("RAM   : ORIGIN = 0x20000000, LENGTH ="))
    }),
    ("docs/supported.md", "the stack on a microcontroller, about {} of RAM", footprint),
    ("crates/subdevice/README.md", "about {} of RAM on a Cortex-M", footprint),
    ("docs/c.md", "without check sequence, {} bytes", || {
        format!("{} to {}", bus::LENGTHS.start(), bus::LENGTHS.end())
    }),
    ("docs/c.md", "until they are received, {} at most", || bus::MOST_WAITING.to_string()),
    ("docs/c.md", "and a bus lives for {} days", || {
        (bus::LONGEST.0 / 86_400_000_000_000).to_string()
    }),
    ("docs/c.md", "moves time by an hour at most", || {
        assert_eq!(bus::LONGEST_STEP.0, 3_600_000_000_000);
        String::new()
    }),
];

#[test]
fn each_number_of_a_page_is_that_of_the_product() {
    let mut wrong = Vec::new();
    for (name, sentence, count) in COUNTED {
        let said = sentence.replace("{}", &count());
        if !page(name).contains(&said) {
            wrong.push(format!("{name} should say: {said}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn numbers_have_their_thousands_apart() {
    let all = [0, 7, 21, 999, 1_000, 21_672, 100_000, 1_000_000].map(in_thousands);
    assert_eq!(all, ["0", "7", "21", "999", "1 000", "21 672", "100 000", "1 000 000"]);
}

/// The words in backquotes of the first column of a page's tables.
fn first_column(name: &str, from: &str) -> BTreeSet<String> {
    let content = page(name);
    let (_, rest) = content.split_once(from).unwrap_or_else(|| panic!("{name} has no {from:?}"));
    let rows = rest.lines().skip_while(|line| !line.starts_with('|'));
    let rows = rows.take_while(|line| line.starts_with('|')).skip(2);
    rows.filter_map(|row| row.split('`').nth(1)).map(str::to_owned).collect()
}

pub fn printed(arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    let output = command.args(arguments).output().expect("isocat starts");
    // What a gate says stands on standard error.
    String::from_utf8([output.stdout, output.stderr].concat()).expect("UTF-8")
}

#[test]
fn the_table_of_commands_has_each_verb() {
    let rows = first_column("docs/commands.md", "# All commands");
    let told: BTreeSet<&str> =
        rows.iter().filter_map(|row| row.strip_prefix("isocat ")?.split(' ').next()).collect();
    let help = printed(&["--help"]);
    let (_, verbs) = help.split_once("Commands:\n").expect("the verbs");
    let verbs = verbs.lines().take_while(|line| !line.is_empty());
    let verbs = verbs.filter(|line| !line.starts_with("    "));
    let verbs: BTreeSet<&str> =
        verbs.filter_map(|line| line.split_whitespace().next()).filter(|v| *v != "help").collect();
    assert_eq!(told, verbs);
    // Codes that a verb gives are among those of the help.
    let (_, codes) = help.split_once("Exit codes:\n").expect("the codes");
    let of_help: BTreeSet<char> = codes
        .lines()
        .filter_map(|line| line.strip_prefix("  ")?.chars().next())
        .filter(char::is_ascii_digit)
        .collect();
    let content = page("docs/commands.md");
    let last = content.lines().filter_map(|line| line.strip_suffix(" |")?.rsplit(" | ").next());
    let of_page: BTreeSet<char> = last
        .flat_map(|cell| cell.split([',', '(', ')']))
        .filter_map(|part| part.trim().split_once(' ').unwrap_or((part.trim(), "")).0.parse().ok())
        .filter(char::is_ascii_digit)
        .collect();
    assert_eq!(of_page, of_help);
}

#[test]
fn lists_of_names_on_pages_are_whole() {
    let tools: BTreeSet<String> = Tool::ALL.iter().map(|tool| tool.name().to_owned()).collect();
    assert_eq!(first_column("docs/other-tools.md", "`--for` is a duration."), tools);

    let rows = first_column("docs/library.md", "Each job has an example");
    let files: BTreeSet<String> =
        examples().iter().map(|name| name.trim_end_matches(".rs").to_owned()).collect();
    assert_eq!(rows, files);

    // The names of functions in the table of docs/c.md are those of the header.
    let header = page("crates/isocat-c/include/isocat.h");
    let declared = header.lines().filter(|line| line.contains('(') && !line.starts_with(' '));
    let name = |line: &str| {
        let before = line.split('(').next()?;
        before
            .rsplit([' ', '*'])
            .next()
            .filter(|name| name.starts_with("isocat_"))
            .map(str::to_owned)
    };
    let declared: BTreeSet<String> = declared
        .filter(|line| !line.starts_with("typedef") && !line.trim_start().starts_with('*'))
        .filter_map(name)
        .collect();
    let content = page("docs/c.md");
    let (_, table) = content.split_once("| group | functions |\n").expect("the table");
    let told: BTreeSet<String> = table
        .lines()
        .take_while(|line| line.starts_with('|'))
        .flat_map(|line| line.split('`').skip(1).step_by(2))
        .filter(|word| word.starts_with("isocat_"))
        .map(str::to_owned)
        .collect();
    assert_eq!(told, declared);

    let door = page("playground/src/door.rs");
    let functions = door.split("extern \"C\" fn ").skip(1);
    let functions: Vec<&str> = functions.filter_map(|rest| rest.split('(').next()).collect();
    let row = format!("the C interface: `{}`", functions.join("`, `"));
    assert!(page("playground/README.md").contains(&row), "{row}");
}

#[test]
fn the_map_of_the_packages_names_what_is_there() {
    let content = page("ARCHITECTURE.md");
    let rows = content.lines().filter_map(|line| line.strip_prefix("| `crates/"));
    let mut told = BTreeSet::new();
    for row in rows {
        let (package, rest) = row.split_once('`').expect("a name");
        told.insert(package.to_owned());
        let looked = rest.trim_end_matches(" |").rsplit(" | ").next().expect("a column");
        for file in looked.split('`').skip(1).step_by(2).filter(|file| !file.contains(' ')) {
            let folder = root().join("crates").join(package);
            // A stub for Python lies beside its package.
            let beside = folder.join("python/isocat").join(file);
            let there = folder.join("src").join(file).exists() || folder.join(file).exists();
            assert!(there || beside.exists(), "crates/{package} has no {file}");
        }
    }
    assert_eq!(told, names("crates", |_| true));

    let serialized = |package: &String| {
        let manifest = page(&format!("crates/{package}/Cargo.toml"));
        let (_, dependencies) = manifest.split_once("\n[dependencies]\n").unwrap_or_default();
        let dependencies = dependencies.split("\n[").next().unwrap_or_default();
        dependencies.lines().any(|line| line.starts_with("serde.") || line.starts_with("serde ="))
    };
    // The library for Python is a workspace of its own, and outside of all.
    let packages = names("crates", |name| name != "isocat-py");
    let names: Vec<String> = packages.into_iter().filter(serialized).collect();
    let (last, others) = names.split_last().expect("some are");
    let sentence = format!("exist only in `{}` and `{last}`: never below", others.join("`, `"));
    assert!(content.contains(&sentence), "ARCHITECTURE.md should say: {sentence}");
}

#[test]
fn each_path_that_a_page_names_is_there() {
    let begins = ["crates/", "tests/", "docs/", "benches/", ".ci/", "fuzz/", "packaging/"];
    let is_path = |word: &&str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "/._-".contains(c);
        begins.iter().any(|begin| word.starts_with(begin)) && word.chars().all(plain)
    };
    // The heads of tests, which docs/tests.md shows, name files from where they are.
    let docs = names("docs", |name| name.ends_with(".md") && name != "tests.md");
    let pages = docs.iter().map(|name| format!("docs/{name}"));
    let mut gone = Vec::new();
    let mut found = 0;
    for name in pages.chain(["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(str::to_owned))
    {
        let content = page(&name);
        let words = content.split('`').skip(1).step_by(2);
        // What stands behind a script are its arguments.
        let words = words.filter_map(|word| word.split_whitespace().next());
        for path in words.filter(is_path).inspect(|_| found += 1) {
            if !root().join(path).exists() {
                gone.push(format!("{name}: {path}"));
            }
        }
    }
    assert!(found > 50, "{found} paths were found");
    assert!(gone.is_empty(), "these are not there:\n{}", gone.join("\n"));
}

/// docs/ci.md has each step of `.ci/run`, by its name, and no other one.
#[test]
fn the_steps_of_ci_are_those_of_its_page() {
    let script = page(".ci/run");
    let named = script.lines().filter(|line| !line.trim_start().starts_with('#'));
    let named = named.filter_map(|line| line.split_once("step \"")?.1.split_once('"'));
    let steps: BTreeSet<&str> = named.map(|(name, _)| name).collect();
    let table = page("docs/ci.md");
    let (_, table) = table.split_once("<!-- steps -->").expect("the table");
    let rows = table.lines().skip(3).filter_map(|line| line.strip_prefix("| ")?.split_once(" | "));
    let rows: Vec<&str> = rows
        .map(|(name, _)| name.trim_end_matches(" (second row)").trim_end_matches(" (`--all` only)"))
        .map(|name| name.trim_end_matches(" (`--all`, or without root)"))
        .map(|name| name.trim_end_matches(", in a fresh clone"))
        .collect();
    assert!(steps.len() > 40, "{steps:?}");
    assert_eq!(rows.iter().copied().collect::<BTreeSet<_>>(), steps);
    assert_eq!(rows.len(), steps.len(), "a row more than once");
}
