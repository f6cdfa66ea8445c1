//! The command `isocat`.

use std::process::ExitCode;

fn main() -> ExitCode {
    isocat::cli::main()
}
