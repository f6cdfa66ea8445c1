//! The tables of docs/tests.md are made from the tests: the first words of each test file and
//! script, and the command that runs it. Every test file says in its first sentence what it states.
//!
//! A test file that reads a variable `ISOCAT_…` names it in its head. `UPDATE_GOLDEN=1` writes the
//! tables.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::documents::{root, text};

const PAGE: &str = "docs/tests.md";
const BEGIN: &str = "<!-- made by the test `test_table` -->\n";
const END: &str = "<!-- end of what is made -->\n";
const RS: &[&str] = &["rs"];
/// The folder of makers' files, which the page explains once for all. In two parts, so that this
/// file does not read like one that looks there.
const BESIDE: &str = concat!("ISOCAT_", "SHARED");

/// Files below a folder of the project whose names end so, in order; names are relative to the
/// project.
fn files(folder: &str, endings: &[&str]) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten() {
            let path = entry.expect("a readable folder").path();
            let is_built = path.file_name().is_some_and(|name| name == "target");
            if path.is_dir() && !is_built {
                folders.push(path);
            } else if path.is_file() {
                let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
                let name = path.strip_prefix(root()).expect("in the project").to_string_lossy();
                found.extend(endings.contains(&ending.as_str()).then(|| name.into_owned()));
            }
        }
    }
    found.sort();
    found
}

fn content(file: &str) -> String {
    text(&root().join(file))
}

/// The comment at the head of a file, without its marks: `//!` in Rust, a docstring in Python, `#`
/// or `//` elsewhere.
fn head(file: &str) -> String {
    let content = content(file);
    let rest = match content.strip_prefix("#!") {
        Some(script) => script.split_once('\n').map_or("", |(_, rest)| rest),
        None => &content,
    };
    if let Some(docstring) = rest.strip_prefix("\"\"\"") {
        return docstring.split("\"\"\"").next().unwrap_or_default().to_owned();
    }
    let mark = if file.ends_with(".rs") { "//!" } else { "#" };
    let lines = rest.lines().map_while(|line| line.strip_prefix(mark));
    lines.map(|line| format!("{}\n", line.trim())).collect()
}

/// What the table shows of a head: its first paragraph, and each further one that says what the
/// file needs, or how to get more out of it.
fn shown(file: &str) -> String {
    let head = head(file);
    let paragraphs = head.split("\n\n").map(|paragraph| {
        paragraph.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
    });
    let told = |paragraph: &String| {
        paragraph.starts_with("Needs ")
            || ["ISOCAT_", "UPDATE_", "--nocapture", "cargo run"]
                .iter()
                .any(|w| paragraph.contains(w))
    };
    let (mut first, mut kept) = (true, Vec::new());
    for paragraph in paragraphs {
        if std::mem::take(&mut first) || told(&paragraph) {
            kept.push(paragraph);
        }
    }
    kept.join(" ")
}

/// Variables that a Rust file names in quotation marks, so those that it reads or hands on; but for
/// those by which a test finds itself again in a process that it starts.
fn variables(content: &str) -> BTreeSet<&str> {
    let is_name = |word: &&str| {
        let known = word.starts_with("ISOCAT_") || word.starts_with("UPDATE_");
        let is_own = word.starts_with("ISOCAT_TEST_");
        known
            && !is_own
            && !word.ends_with('_')
            && word.chars().all(|c| c.is_ascii_uppercase() || c == '_')
    };
    content.split('"').filter(is_name).collect()
}

fn has_tests(content: &str) -> bool {
    content.contains("#[test]") || content.contains("proptest! {")
}

/// A program of tests: what `cargo test --test NAME` builds.
struct Program {
    name: String,
    /// Its first file, and the modules that have tests, with their files.
    file: String,
    modules: Vec<(String, String)>,
}

/// The programs of a folder of tests: each file, and each folder with a `main.rs`. Files without a
/// test in them are parts of others.
fn programs(folder: &str) -> Vec<Program> {
    let all = files(folder, RS);
    let below = |file: &String| file[folder.len() + 1..].to_owned();
    let mut programs = BTreeMap::new();
    for file in &all {
        let path = below(file);
        let name = match path.split_once('/') {
            None => path.trim_end_matches(".rs"),
            Some((name, "main.rs")) => name,
            Some(_) => continue,
        };
        let program = Program { name: name.to_owned(), file: file.clone(), modules: Vec::new() };
        programs.insert(name.to_owned(), program);
    }
    for file in &all {
        let path = below(file);
        let Some((name, inside)) = path.split_once('/').filter(|(_, rest)| *rest != "main.rs")
        else {
            continue;
        };
        let module = inside.trim_end_matches(".rs").trim_end_matches("/mod").replace('/', "::");
        let program = programs.get_mut(name).filter(|_| has_tests(&content(file)));
        if let Some(program) = program {
            program.modules.push((module, file.clone()));
        }
    }
    programs.into_values().collect()
}

/// The folders of the packages below `crates/`, in order.
fn packages() -> Vec<String> {
    let entries = fs::read_dir(root().join("crates")).expect("the packages");
    let name = |entry: fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.map(|entry| name(entry.expect("readable"))).collect();
    names.sort();
    names
}

/// The name of a package as cargo knows it.
fn named(package: &str) -> String {
    match package.strip_prefix("isocat") {
        Some(_) => package.to_owned(),
        None => format!("isocat-{package}"),
    }
}

fn row(file: &str, name: &str, run: &str) -> String {
    let content = content(file);
    let names = variables(&content);
    // What a variable `UPDATE_…` writes is what the file is about, so heads need not name it.
    let updates: Vec<&str> = names.iter().copied().filter(|n| n.starts_with("UPDATE_")).collect();
    let updates = match updates.as_slice() {
        [] => String::new(),
        names => format!("; `{}=1` writes what it compares", names.join("=1`, `")),
    };
    let shared =
        if names.contains(BESIDE) { "; reads makers' files, if they are there" } else { "" };
    format!("| `{name}` | {} | {run}{updates}{shared} |\n", shown(file))
}

/// The tests in Rust: programs, tests beside the code, examples that are tests.
fn of_packages() -> String {
    let table = "| file | what it states | run by |\n|---|---|---|\n";
    let mut made = String::new();
    for package in packages() {
        let mut rows = String::new();
        for Program { name, file, modules } in programs(&format!("crates/{package}/tests")) {
            let short = |file: &str| file.split("/tests/").last().unwrap_or(file).to_owned();
            rows += &row(&file, &short(&file), &format!("`cargo test --test {name}`"));
            for (module, file) in modules {
                let run = format!("`cargo test --test {name} {module}::`");
                rows += &row(&file, &short(&file), &run);
            }
        }
        for file in files(&format!("crates/{package}/examples"), RS) {
            if has_tests(&content(&file)) {
                let name = Path::new(&file).file_stem().unwrap_or_default().to_string_lossy();
                rows +=
                    &row(&file, &format!("{name}.rs"), &format!("`cargo test --example {name}`"));
            }
        }
        let sources = files(&format!("crates/{package}/src"), RS);
        if sources.iter().any(|file| has_tests(&content(file))) {
            let run = format!("`cargo test -p {} --lib`", named(&package));
            rows += &format!("| `src/` | Units, beside the code or in a `tests.rs`. | {run} |\n");
            // Those that write or read more than their code have a line of their own.
            for file in sources.iter().filter(|file| !variables(&content(file)).is_empty()) {
                let is_tests = file.ends_with("tests.rs") || file.contains("/tests/");
                if is_tests {
                    let short = file.split_once("/src/").map_or(file.as_str(), |(_, rest)| rest);
                    rows += &row(file, &format!("src/{short}"), &run);
                }
            }
        }
        if !rows.is_empty() {
            made += &format!("### `crates/{package}`\n\n{table}{rows}\n");
        }
    }
    made
}

/// Scripts that are started: they begin with `#!`.
fn scripts(folder: &str, endings: &[&str]) -> Vec<String> {
    let direct = |file: &String| !file[folder.len() + 1..].contains('/');
    let starts = |file: &String| content(file).starts_with("#!");
    files(folder, endings).into_iter().filter(direct).filter(starts).collect()
}

/// A table of files of other kinds, with the command for each.
fn others(title: &str, files: &[String], run: impl Fn(&str) -> String) -> String {
    let mut made = format!("### {title}\n\n| file | what it states | run by |\n|---|---|---|\n");
    for file in files {
        let name = Path::new(file).file_name().unwrap_or_default().to_string_lossy();
        made += &row(file, &name, &run(file));
    }
    made + "\n"
}

fn tables() -> String {
    let stem =
        |file: &str| Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let itself = |file: &str| format!("`{file}`");
    let python: Vec<String> = files("crates/isocat-py/tests", &["py"])
        .into_iter()
        .filter(|file| file.contains("/test_"))
        .collect();
    let mut made = of_packages();
    made += &others("`crates/isocat-py/tests`, by pytest", &python, |file| {
        format!("`.ci/python`, or `pytest tests/{}.py` there", stem(file))
    });
    made += &others("`playground/tests`", &files("playground/tests", RS), |file| {
        format!("`cargo test --test {}` in `playground/`", stem(file))
    });
    let foreign = "tests/interop/ethercrab-virtual/tests";
    made += &others(&format!("`{foreign}`"), &files(foreign, RS), |_| {
        "`tests/interop/ethercrab_virtual.sh`".to_owned()
    });
    made += &others("`fuzz/fuzz_targets`", &files("fuzz/fuzz_targets", RS), |file| {
        format!("`.ci/fuzz 10` for each, `cargo +nightly fuzz run {} -s none`", stem(file))
    });
    let interop = scripts("tests/interop", &["sh", "py"]);
    made += &others("`tests`: scripts", &scripts("tests", &["sh"]), itself);
    made += &others("`tests/interop`: foreign tools", &interop, itself);
    made += &others("`.ci`: the steps of `.ci/run`", &scripts(".ci", &[""]), itself);
    made += &others("`benches`: speed and size", &scripts("benches", &["sh", "py"]), itself);
    let benches: Vec<String> = packages()
        .iter()
        .flat_map(|package| files(&format!("crates/{package}/benches"), RS))
        .filter(|file| content(file).contains("criterion_main!"))
        .collect();
    made + &others("`crates/*/benches`, by criterion", &benches, |file| {
        format!("`cargo bench --bench {}`", stem(file))
    })
}

#[test]
fn the_tables_of_the_page_are_made_from_the_tests() {
    let path: PathBuf = root().join(PAGE);
    let mut page = text(&path);
    let from = page.find(BEGIN).expect("the mark") + BEGIN.len();
    let to = page.find(END).expect("its end");
    let tables = format!("\n{}", tables());
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        page.replace_range(from..to, &tables);
        fs::write(&path, page).expect("docs/ is writable");
        return;
    }
    let old: BTreeSet<&str> = page[from..to].lines().collect();
    let missing: Vec<&str> = tables.lines().filter(|line| !old.contains(line)).collect();
    let missing = missing.join("\n");
    assert!(page[from..to] == tables, "{PAGE} is old, run with UPDATE_GOLDEN=1; new:\n{missing}");
}

/// All files with tests, and the parts of these.
fn test_files() -> Vec<String> {
    let packages = packages();
    let folders = packages.iter().map(|package| format!("crates/{package}/tests"));
    let mut all: Vec<String> = folders.flat_map(|folder| files(&folder, RS)).collect();
    all.extend(files("crates/isocat-py/tests", &["py"]));
    all.extend(scripts("tests", &["sh"]));
    all.extend(files("playground/tests", RS));
    all.extend(files("tests/interop", &["rs", "py", "sh"]));
    all.extend(files("fuzz/fuzz_targets", RS));
    all.extend(scripts(".ci", &[""]));
    all.extend(files("benches", &["sh", "py"]));
    all
}

#[test]
fn files_that_the_page_names_by_hand_are_there() {
    let page = text(&root().join(PAGE));
    let by_hand = page.split(BEGIN).next().expect("the part before the tables");
    let mut all = test_files();
    all.extend(
        ["docs", "crates/isocat/src"].iter().flat_map(|folder| files(folder, &["rs", "md"])),
    );
    let is_file = |name: &&str| {
        [".rs", ".py", ".sh"].iter().any(|ending| name.ends_with(ending)) && !name.contains('*')
    };
    let names: Vec<&str> = by_hand.split('`').skip(1).step_by(2).filter(is_file).collect();
    assert!(names.len() > 10, "{names:?}");
    let gone: Vec<&&str> = names
        .iter()
        .filter(|name| !all.iter().any(|file| file == *name || file.ends_with(&format!("/{name}"))))
        .collect();
    assert!(gone.is_empty(), "{PAGE} names {gone:?}, which are not there");
}

#[test]
fn each_test_file_says_in_its_first_sentence_what_it_states() {
    let all = test_files();
    assert!(all.len() > 200, "{} files were found", all.len());
    let says = |file: &&String| {
        let shown = shown(file);
        shown.split_whitespace().count() >= 3 && shown.contains(['.', ':', '!'])
    };
    let silent: Vec<&String> = all.iter().filter(|file| !says(file)).collect();
    assert!(silent.is_empty(), "these have no first sentence: {silent:#?}");
}

#[test]
fn each_variable_that_a_test_reads_is_named_in_its_head() {
    let mut unnamed = Vec::new();
    for file in test_files().iter().filter(|file| file.ends_with(".rs")) {
        let (content, mut heads) = (content(file), head(file));
        // The head of a program speaks for its modules, too.
        let folder = Path::new(file).parent().expect("a folder");
        let main = folder.join("main.rs");
        if root().join(&main).is_file() {
            heads += &head(&main.to_string_lossy());
        }
        heads += &match root().join(folder.with_extension("rs")).is_file() {
            true => head(&folder.with_extension("rs").to_string_lossy()),
            false => String::new(),
        };
        for name in variables(&content).into_iter().filter(|name| name.starts_with("ISOCAT_")) {
            if name != BESIDE && !heads.contains(name) {
                unnamed.push(format!("{file}: {name}"));
            }
        }
    }
    assert!(unnamed.is_empty(), "heads do not name what these read:\n{}", unnamed.join("\n"));
}
