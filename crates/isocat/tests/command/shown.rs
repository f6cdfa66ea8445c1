//! What pages show is what there is: blocks of code are compiled or run to the letter, and blocks
//! of output are what the command prints.

use std::path::Path;

use crate::documents::blocks;
use crate::facts::{names, page, printed};

/// The lines of the examples in the comments of a file of Rust, without those that rustdoc hides.
fn doctests(file: &str) -> String {
    let content = page(file);
    let lines = content.lines().filter_map(|line| {
        let line = line.trim_start();
        let line = line.strip_prefix("///").or_else(|| line.strip_prefix("//!"))?;
        Some(line.strip_prefix(' ').unwrap_or(line))
    });
    lines.filter(|line| *line != "#" && !line.starts_with("# ")).collect::<Vec<_>>().join("\n")
}

/// Where each block of Rust on a page is compiled, in order.
const COMPILED: &[(&str, &[&str])] = &[
    ("docs/library.md", &["crates/host/src/host.rs"]),
    ("docs/ring.md", &["crates/maindevice/src/machine/ring_port.rs"]),
    // They leave parts out, and need a foreign library: the whole is an example with a lock file of
    // its own, docs/examples/ethercrab-in-cargo-test.
    ("docs/testing-rust.md", &["", ""]),
];

#[test]
fn blocks_of_rust_are_compiled_to_the_letter() {
    let pages = names("docs", |name| name.ends_with(".md"));
    let pages = pages.iter().map(|name| format!("docs/{name}"));
    for name in pages.chain(["README.md".to_owned(), "ARCHITECTURE.md".to_owned()]) {
        let content = page(&name);
        let found = blocks(&content, "```rust\n");
        let known = COMPILED.iter().find(|(page, _)| *page == name).map_or(&[][..], |(_, at)| at);
        assert_eq!(found.len(), known.len(), "{name}: say where its blocks are compiled");
        for (block, file) in found.iter().zip(known).filter(|(_, file)| !file.is_empty()) {
            assert!(doctests(file).contains(block), "{file} has no example\n{block}");
        }
    }
}

#[test]
fn no_example_opens_an_interface_by_a_name_of_its_own() {
    let open = ["open(\"", "Host::open(\"", "unwrap_or(\"eth", "socket(\"eth", "to_owned(\"eth"];
    let mut found = Vec::new();
    let folders = ["docs", "docs/recipes", "crates/host/examples", "crates/isocat/examples"];
    for folder in folders {
        for name in
            names(folder, |name| [".md", ".rs", ".py", ".c"].iter().any(|e| name.ends_with(e)))
        {
            let content = page(&format!("{folder}/{name}"));
            let fixed = content.lines().filter(|line| open.iter().any(|word| line.contains(word)));
            found.extend(fixed.map(|line| format!("{folder}/{name}: {line}")));
        }
    }
    assert!(found.is_empty(), "take the interface from the command line:\n{}", found.join("\n"));
}

#[test]
fn the_lines_of_python_are_the_same_on_both_pages() {
    // `.ci/python` runs those of the package's README.
    let package = page("crates/isocat-py/README.md");
    let begin = blocks(&package, "```python\n")[0];
    assert!(page("docs/python.md").contains(begin), "docs/python.md begins with\n{begin}");
}

/// Words of a text, so that it makes no difference where its lines are broken.
fn words(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The segment file of docs/recipes.md, with a line more at its head, in the folder of this test.
fn recipe(name: &str, line: &str) -> String {
    let page = page("docs/recipes.md");
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, format!("{line}{}", blocks(&page, "```toml\n")[0])).expect("a file");
    path.to_string_lossy().into_owned()
}

/// A page, how a block on it begins, and the commands that print each line of the block; `recipe`
/// stands for the segment file of docs/recipes.md.
const PRINTED: &[(&str, &str, &[&str])] = &[
    ("docs/recipes.md", "Phases behind the frame", &["plan recipe"]),
    ("docs/recipes.md", "PS  FPWR 0x0920", &["plan recipe --start-up"]),
    ("docs/plan.md", "0x1C32:06: outputs stored", &["plan --prove"]),
    (
        "docs/watch.md",
        "isocat watch: 3 SubDevices with SYNC",
        &[
            "watch --speed max --plain --until 100ns --for 5s --within 60s",
            "watch --speed max --plain --until 10ns --for 2s --within 6s",
        ],
    ),
];

#[test]
fn what_pages_show_is_what_is_printed() {
    let path = recipe("recipe.toml", "");
    for (name, begin, commands) in PRINTED {
        let content = page(name);
        let shown = blocks(&content, "```text\n");
        let mut shown = shown.iter().filter(|block| block.starts_with(begin));
        let shown = shown.next().unwrap_or_else(|| panic!("{name} shows no {begin:?}"));
        let outputs = commands.iter().map(|line| {
            let words = line.split(' ').map(|word| if word == "recipe" { &path } else { word });
            printed(&words.collect::<Vec<&str>>())
        });
        // The page breaks lines elsewhere.
        let output = words(&outputs.collect::<String>());
        for line in shown.lines() {
            assert!(output.contains(&words(line)), "{name}: {line:?} is not printed:\n{output}");
        }
    }
    let late = words(&printed(&["plan", &recipe("recipe0.toml", "shift = \"0us\"\n")]));
    let recipes = page("docs/recipes.md");
    let (_, told) = recipes.split_once("`isocat plan` says \"").expect("the sentence");
    let told = words(told.split('"').next().expect("its end"));
    assert!(late.starts_with(&told), "{told}\n{late}");
}
