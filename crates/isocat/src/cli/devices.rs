//! `isocat devices`: the built-in profiles, and the content of an ESI file.

use std::fmt::Write as _;
use std::path::Path;

use clap::Args;
use isocat_descriptions::document::FileError;
use isocat_descriptions::esi::{EsiDevice, EsiFile, Warning};
use isocat_engine::catalog::{self, Catalog, Module, one_line as plain};
use isocat_segment::profile::{self, Profile};

use super::{fail, print};

/// Arguments of `devices`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Profile to print, or a device description (.xml) to list
    name: Option<String>,
    /// Further descriptions with modules for the slots of the first one's devices
    #[arg(value_name = "FILE")]
    further: Vec<String>,
    /// List slots, and the modules that fit each
    #[arg(long)]
    modules: bool,
    /// Print a description for a program (schema: docs/devices.schema.json)
    #[arg(long)]
    json: bool,
}

/// Runs the verb; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    let name = arguments.name.as_deref();
    if let Some(name) = name.filter(|name| name.to_ascii_lowercase().ends_with(".xml")) {
        return match read(name, &arguments.further) {
            Ok(file) => {
                let code = print(&match arguments.json {
                    true => super::run::json(&Catalog::of(&file)),
                    false => list(&file, arguments.modules),
                });
                // A file of modules has no device, and nothing in it is broken.
                let of_modules = file.devices.is_empty() && file.refused.is_empty();
                match file.usable().next() {
                    None if !of_modules || file.modules.is_empty() => {
                        fail(&format!("{name}: {}", file.none_usable()))
                    }
                    _ => code,
                }
            }
            Err(error) => fail(&error.to_string()),
        };
    }
    if arguments.json || arguments.modules || !arguments.further.is_empty() {
        return fail(
            "--json, --modules and further files are for a device description (ESI), which ends in .xml",
        );
    }
    let Some(name) = name else { return print(&built_in()) };
    match profile::built_in_text(name) {
        Some(text) => print(text),
        None => fail(&unknown(name)),
    }
}

/// A description, with the modules of the further ones.
fn read(name: &str, further: &[String]) -> Result<EsiFile, FileError> {
    let mut file = EsiFile::read(name)?;
    for other in further {
        file.add_modules(EsiFile::read(other)?);
    }
    Ok(file)
}

/// The error for a name without a profile: a path may have been meant.
fn unknown(name: &str) -> String {
    const EXPECTED: &str = "expected the name of a built-in profile, or a device description (ESI), which ends in .xml";
    match Path::new(name).metadata() {
        Ok(found) if found.is_dir() => format!("{name} is a folder; {EXPECTED}"),
        Ok(_) if name.ends_with(".toml") => format!(
            "{name} is no device description; {EXPECTED}. A segment file is for isocat plan, and names profile \
             files of your own"
        ),
        Ok(_) => format!("{name} is no device description; {EXPECTED}"),
        Err(error) if name.contains('/') => format!("{name} can't be read: {error}; {EXPECTED}"),
        Err(_) => {
            let hint = profile::name_hint(name, profile::built_in_ids());
            format!("unknown device \"{name}\"\n{hint}")
        }
    }
}

fn built_in() -> String {
    profile::built_in_ids()
        .filter_map(profile::built_in)
        .map(|p| {
            let modes: Vec<_> = p.modes().map(|mode| mode.name()).collect();
            let modes = if modes.is_empty() { "none announced".into() } else { modes.join(", ") };
            format!("{:<28} {} {}: {modes}\n", p.id, p.vendor, p.name)
        })
        .collect()
}

/// The content of a description: each device with its OpModes, then all doubts.
fn list(file: &EsiFile, modules: bool) -> String {
    let mut out = String::new();
    let number =
        |count: usize, what| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    let _ = writeln!(
        out,
        "{}: {} (vendor {:#010x}), {}, {}, {}",
        file.path,
        plain(&file.vendor),
        file.vendor_id,
        file.encoding.name(),
        number(file.devices.len(), "device"),
        number(file.modules.len(), "module")
    );
    for warning in &file.file_warnings {
        write_warning(&mut out, file, warning);
    }
    for device in &file.devices {
        write_device(&mut out, file, device);
        if modules {
            write_slots(&mut out, file, device);
        }
    }
    if modules && file.devices.is_empty() {
        let _ = writeln!(out);
        for module in &file.modules {
            write_module(&mut out, &catalog::module(module), "");
        }
    }
    for error in &file.refused {
        let _ = writeln!(out, "\nrefused: {error}");
    }
    out
}

fn write_device(out: &mut String, file: &EsiFile, device: &EsiDevice) {
    let hidden = if device.hidden { "  (hidden by a newer one)" } else { "" };
    let revision =
        device.revision.map_or("none".to_owned(), |revision| format!("{revision:#010x}"));
    // The key of a segment file that tells it apart from another of this type and revision.
    let alike = |other: &&EsiDevice| {
        (&other.type_name, other.revision) == (&device.type_name, device.revision)
    };
    let product = device.product_code.filter(|_| file.usable().filter(alike).count() > 1);
    let product = product.map_or(String::new(), |code| format!("  product = {code:#010x}"));
    let _ = writeln!(
        out,
        "\n{}  revision {revision}{product}  {}{hidden}",
        plain(&device.type_name),
        plain(&device.name)
    );
    let modes = device.op_modes();
    for (number, mode) in modes.iter().enumerate() {
        let words = Profile::from_esi(file, device, Some(number)).err().map(|error| error.obstacle);
        let words = words.map_or(String::new(), |o| format!("  not simulated: {}", o.name()));
        let _ = writeln!(
            out,
            "  opmode {number} \"{}\"  {:#06x}  {}{words}",
            plain(&mode.name),
            mode.assign_activate,
            plain(&mode.description)
        );
    }
    if modes.is_empty()
        && let Err(error) = Profile::from_esi(file, device, None)
    {
        let _ = writeln!(out, "  not simulated: {}", error.obstacle.name());
    }
    for warning in &device.warnings {
        write_warning(out, file, warning);
    }
}

/// Writes the slots of a device, each with the modules that fit.
fn write_slots(out: &mut String, file: &EsiFile, device: &EsiDevice) {
    let Some(slots) = &device.slots else { return };
    for slot in catalog::slots(slots, &file.modules) {
        let places = match slot.places {
            1 => format!("place {}", slot.first_place),
            count => {
                format!("places {} to {}", slot.first_place, slot.first_place + count.max(1) - 1)
            }
        };
        let need = match (slot.least, slot.places) {
            (0, _) => "may be empty".to_owned(),
            (1, 1) => "needed".to_owned(),
            (least, _) => format!("{least} needed"),
        };
        let _ = writeln!(out, "  slot \"{}\"  {places}, {need}", slot.name);
        if slot.takes.is_empty() {
            let _ = writeln!(out, "    no module of the file fits");
        }
        for module in file.modules.iter().filter(|module| slot.takes.contains(&module.ident)) {
            let preset = if slot.preset == Some(module.ident) { "  preset" } else { "" };
            write_module(out, &catalog::module(module), preset);
        }
    }
}

fn write_module(out: &mut String, module: &Module, preset: &str) {
    let size = format!("{} bits out, {} bits in", module.output_bits, module.input_bits);
    let (ident, name) = (module.ident, &module.type_name);
    let only = match module.op_modes.is_empty() {
        true => String::new(),
        false => format!("  for OpMode \"{}\"", module.op_modes.join("\" or \"")),
    };
    let _ = writeln!(out, "    {ident:#010x}  {name:<24}  {size}{only}{preset}");
}

fn write_warning(out: &mut String, file: &EsiFile, warning: &Warning) {
    let line = file.place(warning.at).line;
    let more = match warning.count {
        1 => String::new(),
        count => format!(" (and {} more)", count - 1),
    };
    let _ = writeln!(out, "  {} line {line}: {}{more}", warning.kind, plain(&warning.message));
}
