//! `isocat sii`: the content of an EEPROM, and the image that a vendor's tool would write.

use std::path::{Path, PathBuf};

use clap::Args;
use isocat_descriptions::esi::{EsiFile, Wish};
use isocat_descriptions::limits;
use isocat_descriptions::sii::SiiFile;
use isocat_segment::profile::{self, Profile, name_hint};

use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, output, print};

pub(super) const EXAMPLES: &str = "\
Examples:
  isocat sii eeprom.bin                         what is in it, in words
  isocat sii eeprom.bin --json                  ... for a program (schema: docs/sii.schema.json)
  isocat sii --from vendor.xml --type EL7041    what the maker's tool would write, in words
  isocat sii --from vendor.xml --type EL7041 --out el7041.bin
                                                ... as an image
  isocat sii --from ./mine.toml --out mine.bin  the image of a profile

Exit code: 0 nothing is doubtful, 1 something is, 2 can't be read or written.";

/// Arguments of `isocat sii`.
#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// The file: an image, or Intel HEX
    #[arg(required_unless_present = "from", conflicts_with = "from")]
    file: Option<String>,
    /// Make the image of a device instead: an ESI file (.xml), or a profile by its name or path
    #[arg(long, value_name = "DEVICE")]
    from: Option<String>,
    /// Type of the device in the description
    #[arg(long = "type", value_name = "TYPE", requires = "from")]
    kind: Option<String>,
    /// Its product code, such as 0x1B813052
    #[arg(long, value_name = "CODE", requires = "from", value_parser = number)]
    product: Option<u32>,
    /// Its revision; without it the newest
    #[arg(long, value_name = "REVISION", requires = "from", value_parser = number)]
    revision: Option<u32>,
    /// Write the image to this file
    #[arg(long, value_name = "FILE", requires = "from")]
    out: Option<PathBuf>,
    /// Print the content as one JSON document
    #[arg(long)]
    json: bool,
}

/// Reads or writes; returns the exit code.
pub(super) fn run(arguments: &Arguments) -> u8 {
    let file = match (&arguments.file, &arguments.from) {
        (Some(path), _) => SiiFile::read(path).map_err(|error| error.to_string()),
        (None, Some(from)) => made(arguments, from),
        (None, None) => return fail("no file; expected one, or --from"),
    };
    let file = match file {
        Ok(file) => file,
        Err(message) => return fail(&message),
    };
    let printed = match &arguments.out {
        Some(path) => match output::write(path, &file.image) {
            Ok(()) if !arguments.json => {
                let name = path.display();
                anstream::eprintln!("isocat sii: {name}: {} bytes", file.image.len());
                IN_SYNC
            }
            Ok(()) => IN_SYNC,
            Err(error) => return fail(&super::run::unwritable("image", Some(path), &error)),
        },
        None => IN_SYNC,
    };
    let printed = match (arguments.json, &arguments.out) {
        (true, _) => print(&super::run::json(&file.report())),
        (false, None) => print(&file.text()),
        (false, Some(_)) => printed,
    };
    match file.doubts.is_empty() {
        _ if printed == BAD_INPUT => BAD_INPUT,
        true => IN_SYNC,
        // Beside an image that is written there is no text that says so.
        false if arguments.out.is_some() && !arguments.json => {
            for doubt in &file.doubts {
                anstream::eprintln!("isocat sii: {doubt}");
            }
            NOT_IN_SYNC
        }
        false => NOT_IN_SYNC,
    }
}

/// The image of a description or a profile, read as a file.
fn made(arguments: &Arguments, from: &str) -> Result<SiiFile, String> {
    let image = if Path::new(from).extension().is_some_and(|e| e.eq_ignore_ascii_case("xml")) {
        of_description(arguments, from)?
    } else if arguments.kind.is_some()
        || arguments.product.is_some()
        || arguments.revision.is_some()
    {
        return Err(format!(
            "--type, --product and --revision are beside --from {from}, which is no description (.xml); expected one"
        ));
    } else {
        profile_of(from)?.sii.to_vec()
    };
    let name = arguments.out.as_ref().map_or(from.to_owned(), |path| path.display().to_string());
    SiiFile::from_bytes(&name, &image).map_err(|error| error.to_string())
}

fn of_description(arguments: &Arguments, from: &str) -> Result<Vec<u8>, String> {
    let file = EsiFile::read(from).map_err(|error| error.to_string())?;
    let wish = Wish {
        type_name: arguments.kind.as_deref(),
        product: arguments.product,
        revision: arguments.revision,
    };
    let choice = file.device(wish).map_err(|refused| format!("{from}: {}", refused.message))?;
    let image = file.image_of_sii(choice.device).map_err(|error| format!("{from}: {error}"))?;
    for note in choice.note.into_iter().chain(image.notes.iter().map(ToString::to_string)) {
        anstream::eprintln!("isocat sii: {from}: {note}");
    }
    Ok(image.bytes)
}

/// A profile by its name, or by its path.
pub(super) fn profile_of(name: &str) -> Result<std::sync::Arc<Profile>, String> {
    if name.contains(['/', '\\']) || Path::new(name).extension().is_some_and(|e| e == "toml") {
        let text = limits::read_text(name, limits::TOML).map_err(|error| error.to_string())?;
        return Profile::from_toml(name, &text).map_err(|error| error.to_string());
    }
    profile::built_in(name).ok_or_else(|| {
        let hint = name_hint(name, profile::built_in_ids());
        format!("unknown device \"{name}\"; expected a description (.xml), a profile's path or its name\n{hint}")
    })
}

/// A number in hex (0x…) or decimal.
pub(super) fn number(text: &str) -> Result<u32, String> {
    let digits = text.replace('_', "");
    let value = match digits.strip_prefix("0x").or(digits.strip_prefix("#x")) {
        Some(hex) => u32::from_str_radix(hex, 16),
        None => digits.parse(),
    };
    value.map_err(|_| "expected a number of 32 bits, such as 0x1B813052".to_owned())
}
