//! Checks that the header in the repository is the one generated from the sources. With
//! `UPDATE_HEADER=1` it is written instead.

use std::path::Path;

#[test]
fn the_header_is_as_the_sources_make_it() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(package.join("cbindgen.toml")).expect("cbindgen.toml");
    let bindings = cbindgen::Builder::new()
        .with_config(config)
        .with_src(package.join("src/lib.rs"))
        .generate()
        .expect("a header");
    let mut made = Vec::new();
    bindings.write(&mut made);
    let made = String::from_utf8(made).expect("a text");
    assert!(made.contains("isocat_bus_send("), "it has the functions:\n{made}");
    let path = package.join("include/isocat.h");
    if std::env::var_os("UPDATE_HEADER").is_some() {
        std::fs::write(&path, &made).expect("include can be written");
    }
    let there = std::fs::read_to_string(&path).expect("include/isocat.h");
    let same = there.lines().zip(made.lines()).take_while(|(there, made)| there == made).count();
    assert!(
        there == made,
        "include/isocat.h differs from its sources from line {} on; UPDATE_HEADER=1 writes it",
        same + 1
    );
}

#[test]
fn the_documentation_names_every_function() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &str| std::fs::read_to_string(package.join(path)).expect("a readable file");
    let (header, page) = (read("include/isocat.h"), read("../../docs/c.md"));
    let words = |text: &str, end: char| -> Vec<String> {
        let is_word = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let ends = text.match_indices(end);
        let before = ends.map(|(at, _)| text[..at].rsplit(|letter| !is_word(letter)).next());
        before.flatten().filter(|word| word.starts_with("isocat_")).map(str::to_owned).collect()
    };
    let declared = words(&header, '(');
    assert!(declared.len() > 40, "{declared:?}");
    let named = words(&page, '`');
    for function in &declared {
        assert!(named.contains(function), "docs/c.md does not name {function}");
    }
    for name in &named {
        assert!(
            header.contains(name.as_str()),
            "docs/c.md names {name}, which is not in the header"
        );
    }
}
