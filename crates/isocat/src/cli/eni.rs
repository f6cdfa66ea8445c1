//! `isocat eni`: the content of an ENI file.

use std::path::PathBuf;

use clap::Args;
use isocat_descriptions::columns::{WIDTH, wrap};
use isocat_descriptions::eni::Eni;

use super::{NOT_IN_SYNC, fail, print};

/// Arguments of `isocat eni`.
#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// The file
    file: PathBuf,
    /// Print for a program
    #[arg(long)]
    json: bool,
}

/// Reads the file and prints its content.
pub(super) fn run(arguments: &Arguments) -> u8 {
    let eni = match Eni::read(&arguments.file) {
        Ok(eni) => eni,
        Err(error) => return fail(&error.to_string()),
    };
    let reasons = eni.runnable().err().unwrap_or_default();
    let printed = if arguments.json { print(&eni.json()) } else { print(&text(&eni, &reasons)) };
    match (printed, reasons.is_empty()) {
        (0, false) => NOT_IN_SYNC,
        (code, _) => code,
    }
}

fn text(eni: &Eni, reasons: &[String]) -> String {
    let mut text = eni.start_up.text();
    let mut list = |title: &str, items: Vec<String>| {
        if items.is_empty() {
            return;
        }
        text += &format!("\n{title}\n");
        for item in items {
            for (i, line) in wrap(&item, WIDTH - 4).into_iter().enumerate() {
                text += &format!("  {} {line}\n", if i == 0 { "-" } else { " " });
            }
        }
    };
    list("doubts", eni.warnings.iter().map(ToString::to_string).collect());
    list("can't be run", reasons.to_vec());
    text
}
