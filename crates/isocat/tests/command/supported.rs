//! docs/supported.md: what is supported works, and what is not supported is refused with a clear
//! word. Each claim of the page has an entry here: a command that tries it, the test that does, or
//! the reason why nothing can.
//!
//! A claim is a part of a cell between semicolons. A new one without an entry fails the test.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::documents::{root, text};

mod entries;

use entries::Entry::{Held, Tried, Unchecked};
use entries::Side::{self, No, Yes};
use entries::Try;
use entries::{ENTRIES, EVERY, IO};

/// The claims of the page, with their columns, in order.
fn claims() -> Vec<(Side, String)> {
    let page = text(&root().join("docs/supported.md"));
    let rows = page.lines().filter(|line| line.starts_with("| ")).skip(1);
    let mut claims = Vec::new();
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").collect();
        assert_eq!(cells.len(), 3, "a row has three cells: {row}");
        for (side, cell) in [Yes, No].into_iter().zip(&cells[1..]) {
            let (mut depth, mut claim) = (0, String::new());
            for c in cell.chars() {
                depth += i32::from("([".contains(c)) - i32::from(")]".contains(c));
                match c {
                    ';' if depth == 0 => claims.push((side, std::mem::take(&mut claim))),
                    _ => claim.push(c),
                }
            }
            claims.push((side, claim));
        }
    }
    claims.into_iter().map(|(side, claim)| (side, claim.trim().to_owned())).collect()
}

/// A segment file: the keys of a section stand behind its first word.
fn segment(words: &str) -> String {
    let mut head = "seed = 1\n".to_owned();
    if !words.starts_with("cycle") {
        head += "cycle = \"1ms\"\n";
    }
    let mut body = String::new();
    for part in words.split("; ").filter(|part| !part.is_empty()) {
        let (first, rest) = part.split_once(' ').unwrap_or((part, ""));
        let begin = match first {
            "EVERY" => format!("[[subdevice]]\n{EVERY}\n"),
            "IO" => format!("[[subdevice]]\n{IO}\n"),
            "[subdevice]" | "fault" | "plant" => {
                format!("[[{}]]\n", first.trim_matches(['[', ']']))
            }
            // A key of the section that stands before it, or of the head.
            _ if body.is_empty() => {
                head += &format!("{part}\n");
                continue;
            }
            _ => {
                body += &format!("{part}\n");
                continue;
            }
        };
        body += &format!("{begin}{rest}\n");
    }
    head + &body
}

/// What is wrong with one try, if anything is.
fn tried(folder: &Path, number: usize, (words, arguments, code, word): &Try) -> Option<String> {
    let name = format!("{number}.toml");
    let content = segment(words);
    fs::write(folder.join(&name), &content).expect("a file");
    let arguments: Vec<&str> = arguments
        .split(' ')
        .map(|argument| if argument == "my.toml" { name.as_str() } else { argument })
        .collect();
    let mut command = Command::new(env!("CARGO_BIN_EXE_isocat"));
    let output = command.current_dir(folder).args(&arguments).output().expect("isocat starts");
    let printed = [output.stdout, output.stderr].concat();
    // Lines are broken where the width of a terminal ends.
    let printed = String::from_utf8_lossy(&printed);
    let printed = printed.split_whitespace().collect::<Vec<_>>().join(" ");
    let is_right = match word.strip_prefix('!') {
        Some(absent) => !printed.contains(absent),
        None => printed.contains(word),
    };
    let wrong = output.status.code() != Some(*code) || !is_right;
    let shown: String = printed.chars().take(600).collect();
    let found = output.status.code();
    let wanted = format!("expected {code} and {word:?}, found {found:?}");
    wrong.then(|| format!("isocat {}: {wanted}\n{content}{shown}\n", arguments.join(" ")))
}

#[test]
fn what_is_supported_works_and_the_rest_is_refused() {
    let folder = std::env::temp_dir().join(format!("isocat-supported-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a temporary folder");
    let text_of = |id| isocat::profile::built_in_text(id).expect("built in");
    fs::write(folder.join("own.toml"), text_of("simple_io16")).expect("a file");
    let dynamic = text_of("model_every_mode");
    let dynamic = dynamic.replace("[behaviour]\n", "[behaviour]\ndynamic_times = true\n");
    fs::write(folder.join("dynamic.toml"), dynamic).expect("a file");

    let mut wrong = Vec::new();
    let claims = claims();
    assert!(claims.len() >= ENTRIES.len(), "{} claims were found", claims.len());
    let mut entries = ENTRIES.iter();
    for (side, claim) in &claims {
        let Some((of, begin, entry)) = entries.next().filter(|(_, b, _)| claim.starts_with(b))
        else {
            wrong.push(format!("docs/supported.md: no entry for \"{claim}\""));
            break;
        };
        assert_eq!(side, of, "the column of {begin:?}");
        match entry {
            Tried(tries) => {
                for (number, one) in tries.iter().enumerate() {
                    let found = tried(&folder, number, one);
                    wrong.extend(found.map(|found| format!("\"{claim}\": {found}")));
                }
            }
            Held(file) => {
                let content = text(&root().join(file));
                let holds = content.contains("#[test]") || content.starts_with("#!");
                if !holds && !file.ends_with("main.rs") {
                    wrong.push(format!("\"{claim}\": there are no tests in {file}"));
                }
            }
            Unchecked(why) => assert!(!why.is_empty(), "{claim}: why"),
        }
    }
    fs::remove_dir_all(&folder).expect("a temporary folder");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
