//! README and documentation: every link leads somewhere, and the lines do what stands beside them.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Programs can't be supervised on this machine; `isocat virtual` then starts none.
const NOT_SUPERVISED: &str = "can't be supervised here";

pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the workspace")
}

pub fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// All Markdown files of the project, but for those of dependencies and build folders.
fn documents() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a readable folder") {
            let path = entry.expect("a readable folder").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            // The texts of tests become part of documents elsewhere, with other links.
            let others = ["target", "node_modules", "tests"];
            let is_ours = !name.starts_with('.') && !others.contains(&name.as_str());
            if path.is_dir() && is_ours {
                folders.push(path);
            } else if name.ends_with(".md") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The lines of a document that are prose, each with its number.
fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut in_block = false;
    text.lines().enumerate().filter_map(move |(number, line)| {
        let is_fence = line.trim_start().starts_with("```");
        in_block ^= is_fence;
        (!in_block && !is_fence).then_some((number + 1, line))
    })
}

/// The targets of the links in a line; what stands in backquotes is no link.
fn links(line: &str) -> impl Iterator<Item = &str> {
    let outside = |at: usize| line[..at].matches('`').count().is_multiple_of(2);
    line.match_indices("](").filter_map(move |(at, open)| {
        let target = &line[at + open.len()..];
        let end = target.find(')')?;
        outside(at).then_some(&target[..end])
    })
}

/// The anchors of a document, as the usual viewers make them of its headings.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = prose(text).filter(|(_, line)| line.starts_with('#'));
    let anchor = |(_, line): (usize, &str)| {
        let words = line.trim_start_matches('#').trim().to_lowercase();
        let kept = words.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect::<String>()
    };
    headings.map(anchor).collect()
}

#[test]
fn every_link_leads_to_a_file_of_the_project_and_to_a_heading_in_it() {
    let mut dead = Vec::new();
    let mut checked = 0;
    for document in documents() {
        let content = text(&document);
        for (number, line) in prose(&content) {
            for link in links(line).filter(|link| !link.contains("://")) {
                let (path, anchor) =
                    link.split_once('#').map_or((link, None), |(p, a)| (p, Some(a)));
                let file = match path {
                    "" => document.clone(),
                    path => document.parent().expect("a folder").join(path),
                };
                let is_document = file.extension().is_some_and(|extension| extension == "md");
                let leads = match anchor {
                    Some(anchor) if is_document => {
                        file.is_file() && anchors(&text(&file)).contains(anchor)
                    }
                    // What stands behind the # of a page is for its script.
                    _ => file.exists(),
                };
                checked += 1;
                if !leads {
                    dead.push(format!("{}:{number}: {link}", document.display()));
                }
            }
        }
    }
    assert!(checked > 100, "{checked} links were found");
    assert!(dead.is_empty(), "these links lead nowhere:\n{}", dead.join("\n"));
}

#[test]
fn the_readme_is_read_in_four_minutes() {
    let readme = text(&root().join("README.md"));
    let words = prose(&readme).flat_map(|(_, line)| line.split_whitespace()).count();
    assert!(readme.lines().count() <= 150, "{} lines", readme.lines().count());
    // Two hundred words a minute, which is slow.
    assert!(words <= 800, "{words} words");
}

/// What stands in the blocks of the README that begin with this fence.
pub fn blocks<'t>(readme: &'t str, fence: &str) -> Vec<&'t str> {
    let begins = readme.match_indices(fence).map(|(at, _)| &readme[at + fence.len()..]);
    begins.map(|rest| rest[..rest.find("\n```").expect("a block ends")].trim_start()).collect()
}

/// Runs a line as a shell does in which `isocat` has been installed.
pub fn shell(line: &str, folder: &Path) -> Output {
    let binary = Path::new(env!("CARGO_BIN_EXE_isocat"));
    let found = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{found}", binary.parent().expect("a folder").display());
    let mut shell = Command::new("sh");
    shell.args(["-c", line]).current_dir(folder).env("PATH", path).output().expect("a shell")
}

#[test]
fn the_readme_shows_what_the_first_command_prints() {
    let path = root().join("README.md");
    let readme = text(&path);
    let printed = String::from_utf8(shell("isocat", &root()).stdout).expect("UTF-8");
    let shown = blocks(&readme, "```text\n")[0];
    // The first table alone: the rest is for readers who run the command.
    let table = printed.split("\n\n").take(2).collect::<Vec<_>>().join("\n\n") + "\n\n …";
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        fs::write(&path, readme.replacen(shown, &table, 1)).expect("a writable file");
    } else {
        assert!(shown == table, "the README shows\n{shown}\nand isocat prints\n{table}");
    }
}

#[test]
fn each_line_of_the_readme_does_what_stands_beside_it() {
    let folder = std::env::temp_dir().join(format!("isocat-readme-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a temporary folder");
    let readme = text(&root().join("README.md"));
    let lines = blocks(&readme, "```sh\n").into_iter().flat_map(str::lines);
    let mut ran = 0;
    // Those with `sudo` need an interface, and the others are for the shell of a developer.
    for line in lines.filter(|line| line.starts_with("isocat ")) {
        let output = shell(line, &folder);
        let errors = String::from_utf8_lossy(&output.stderr);
        if errors.contains(NOT_SUPERVISED) {
            println!("skipped: {line}: {errors}");
            continue;
        }
        ran += 1;
        // Where bad luck is drawn a run may fail, and the line says so.
        let wanted = if line.contains("--faults swarm") { 0..=1 } else { 0..=0 };
        let code = output.status.code().unwrap_or(-1);
        let printed = String::from_utf8_lossy(&output.stdout);
        assert!(wanted.contains(&code), "{line}: exit code {code}\n{printed}\n{errors}");
    }
    assert!(ran >= 8, "{ran} lines ran");
    for file in ["my.toml", "report.html", "field.pcapng"] {
        assert!(folder.join(file).is_file(), "{file} was written");
    }
    fs::remove_dir_all(&folder).expect("a temporary folder");
}

/// What the lines of the documentation read: a segment, a ring, descriptions, an EEPROM, an ENI, a
/// capture, and what a scan found.
fn furnish(folder: &Path) {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/esi");
    let drive = text(&tests.join("box.xml")).replace(">Drive<", ">EL7041<");
    fs::create_dir_all(folder.join("esi")).expect("a folder");
    for name in ["vendor.xml", "beckhoff.xml", "esi/vendor.xml"] {
        fs::write(folder.join(name), &drive).expect("a file");
    }
    fs::copy(tests.join("rack_modules.xml"), folder.join("modules.xml")).expect("a file");
    fs::copy(tests.join("rack.xml"), folder.join("coupler.xml")).expect("a file");
    let drives = text(&tests.join("drives.xml")).replace(">Two axes<", ">Drive X<");
    fs::write(folder.join("drives.xml"), drives).expect("a file");
    for line in [
        "isocat example > my.toml && sed -i 's/\"AKD2G axis 2\"/\"axis\"/' my.toml && cp my.toml machine.toml",
        "isocat devices simple_io16 > mine.toml",
        "isocat sii --from ./mine.toml --out eeprom.bin",
        "isocat plan my.toml --eni network.xml",
        "isocat run my.toml --for 100ms --capture field.pcapng",
        "isocat scan my.toml --json > found.json",
        "isocat calibrate my.toml --chips chips.toml",
    ] {
        let output = shell(line, folder);
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

/// What a line needs that is not here: an interface, a program of the reader's, a person who looks
/// on.
const NEEDS_MORE: [&str; 8] = [
    "sudo ",
    "--interface",
    "--serve ",
    "--setup-veth",
    "./my_master",
    "bring_up.py vt0",
    "ring_0",
    "watch my.toml",
];

/// A line as it is tried: a campaign with few seeds, in the order of the document.
fn shortened(line: &str) -> String {
    let Some((before, rest)) = line.split_once("--seeds ") else { return line.to_owned() };
    let rest = rest.trim_start_matches(|c: char| c.is_ascii_digit());
    format!("{before}--seeds 2{rest}")
}

#[test]
fn each_line_of_the_documents_that_needs_no_wire_does_what_stands_beside_it() {
    let folder = std::env::temp_dir().join(format!("isocat-documents-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a temporary folder");
    furnish(&folder);
    std::os::unix::fs::symlink(root().join("docs"), folder.join("docs")).expect("a link");
    let pages: Vec<_> =
        documents().into_iter().filter(|path| path.starts_with(root().join("docs"))).collect();
    // Each page has a copy of the folder, so that the processors share the pages.
    let (next, ran, wrong) = (AtomicUsize::new(0), AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    // Pages in different folders may have one name, so that a number tells them
                    // apart.
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(page) = pages.get(number) else { break };
                    let own = folder.with_extension(number.to_string());
                    let copied = Command::new("cp").arg("-r").args([&folder, &own]).status();
                    assert!(copied.expect("cp starts").success());
                    ran.fetch_add(lines_of(page, &own, &wrong), Ordering::Relaxed);
                    fs::remove_dir_all(&own).expect("a temporary folder");
                }
            });
        }
    });
    let (ran, wrong) = (ran.into_inner(), wrong.into_inner().expect("no panic"));
    fs::remove_dir_all(&folder).expect("a temporary folder");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(ran >= 40, "{ran} lines ran");
}

/// Runs the lines of a page in a folder; their number.
fn lines_of(page: &Path, folder: &Path, wrong: &Mutex<Vec<String>>) -> usize {
    let mut ran = 0;
    for block in blocks(&text(page), "```sh\n") {
        // A table of rows is not written over another one, and `new` writes a segment of its own.
        let _ = fs::remove_file(folder.join("out.csv"));
        fs::copy(folder.join("machine.toml"), folder.join("my.toml")).expect("a file");
        for line in block.lines().filter(|line| line.starts_with("isocat ")) {
            if NEEDS_MORE.iter().any(|needed| line.contains(needed)) {
                continue;
            }
            let line = shortened(line);
            let output = shell(&line, folder);
            let errors = String::from_utf8_lossy(&output.stderr);
            let code = output.status.code().unwrap_or(-1);
            // A search may find runs that fail, and says so by its exit code.
            let searches = ["sweep", "--faults swarm"].iter().any(|verb| line.contains(verb));
            ran += 1;
            if !(code == 0 || code == 1 && searches) {
                let shown = page.strip_prefix(root()).expect("in the project").display();
                let told = format!("{shown}: {line}: exit code {code}\n{errors}");
                wrong.lock().expect("no panic").push(told);
            }
        }
    }
    ran
}
