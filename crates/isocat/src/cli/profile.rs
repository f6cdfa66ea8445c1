//! `isocat profile`: a profile file from an ESI file, an EEPROM, or the result of a scan.

use std::path::{Path, PathBuf};

use clap::Args;
use isocat_descriptions::esi::{EsiDevice, EsiFile, Wish};
use isocat_descriptions::limits;
use isocat_descriptions::sii::{DoubtKind, SiiFile};
use isocat_engine::report::scan;
use isocat_segment::profile::{
    Found, FoundArea, FoundEntry, Identity, OpMode, Profile, ProfileText,
};
use isocat_segment::profile::{name_hint, port_letters};
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;
use serde_json::Value;

use super::sii::number;
use super::{IN_SYNC, fail, output, print};

pub(super) const EXAMPLES: &str = "\
Examples:
  isocat profile vendor.xml --type EL7041 --out el7041.toml
                                       a maker's description, as a start for your own changes
  isocat profile eeprom.bin --out x.toml               the content of an EEPROM
  isocat scan --interface eth0 --json > found.json
  isocat profile found.json --device 2 --out x.toml    what a scan found
  isocat devices kollmorgen_akd2g > x.toml             a built-in profile

A segment file takes it as device = \"./x.toml\". Every key: docs/profile.md.
Exit code: 0 written, 2 can't be read, or is none that a profile can say.";

/// Arguments of `isocat profile`.
#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// An ESI file (.xml), a document of `isocat scan --json` (.json), or the content of an EEPROM
    file: String,
    /// Type of the device in the description
    #[arg(long = "type", value_name = "TYPE")]
    kind: Option<String>,
    /// Its product code, such as 0x1B813052
    #[arg(long, value_name = "CODE", value_parser = number)]
    product: Option<u32>,
    /// Its revision; without it the newest
    #[arg(long, value_name = "REVISION", value_parser = number)]
    revision: Option<u32>,
    /// Name or number of the OpMode whose PDOs are assigned; without it the first with SYNC0
    #[arg(long, value_name = "OPMODE")]
    opmode: Option<String>,
    /// Position or name of the device in the scan; without it the only one
    #[arg(long, value_name = "DEVICE")]
    device: Option<String>,
    /// Write to this file instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Makes the file; returns the exit code.
pub(super) fn run(arguments: &Arguments) -> u8 {
    let written = match made(arguments) {
        Ok(written) => written,
        Err(message) => return fail(&message),
    };
    // What is written is what was read.
    let path = arguments.out.as_deref().unwrap_or(Path::new("profile.toml"));
    let name = path.display().to_string();
    if let Err(error) = Profile::from_toml(&name, &written.text) {
        return fail(&format!("{}: it can't be a profile: {error}", arguments.file));
    }
    for note in &written.notes {
        anstream::eprintln!("isocat profile: {note}");
    }
    match &arguments.out {
        None => print(&written.text),
        Some(path) => match output::write(path, &written.text) {
            Ok(()) => {
                anstream::eprintln!(
                    "isocat profile: a segment file takes it as device = \"{}\"",
                    in_segment_file(&name)
                );
                IN_SYNC
            }
            Err(error) => fail(&super::run::unwritable("profile", Some(path), &error)),
        },
    }
}

/// A path for a segment file in the same folder: with a slash, which no name of a built-in profile
/// has.
fn in_segment_file(path: &str) -> String {
    match path.contains(['/', '\\']) {
        true => path.to_owned(),
        false => format!("./{path}"),
    }
}

fn made(arguments: &Arguments) -> Result<ProfileText, String> {
    let path = &arguments.file[..];
    let ends_in = |end: &str| path.to_ascii_lowercase().ends_with(end);
    let of_description = [
        ("--type", arguments.kind.is_some()),
        ("--product", arguments.product.is_some()),
        ("--revision", arguments.revision.is_some()),
        ("--opmode", arguments.opmode.is_some()),
    ];
    let of_scan = [("--device", arguments.device.is_some())];
    let (wrong, what) = match (ends_in(".xml"), ends_in(".json")) {
        (true, _) => (&of_scan[..], "a document of `isocat scan --json` (.json)"),
        (_, true) => (&of_description[..], "a maker's description (.xml)"),
        (false, false) if arguments.device.is_some() => {
            (&of_scan[..], "a document of a scan (.json)")
        }
        // An EEPROM has one device, with OpModes.
        (false, false) => (&of_description[..3], "a maker's description (.xml)"),
    };
    if ends_in(".toml") {
        return Err(format!(
            "{path}: a profile is made of a maker's description (.xml), a document of `isocat scan --json` (.json) or the \
             content of an EEPROM; expected one of them"
        ));
    }
    if let Some((flag, _)) = wrong.iter().find(|(_, given)| *given) {
        return Err(format!("{flag} is beside {path}; expected {what} beside it"));
    }
    if ends_in(".json") {
        return of_scan_document(path, arguments.device.as_deref());
    }
    if ends_in(".xml") {
        let file = EsiFile::read(path).map_err(|error| error.to_string())?;
        let wish = Wish {
            type_name: arguments.kind.as_deref(),
            product: arguments.product,
            revision: arguments.revision,
        };
        let choice = file.device(wish).map_err(|refused| format!("{path}: {}", refused.message))?;
        if let Some(note) = &choice.note {
            anstream::eprintln!("isocat profile: {path}: {note}");
        }
        return of_description_device(&file, choice.device, arguments);
    }
    let sii = SiiFile::read(path).map_err(|error| error.to_string())?;
    // An ESC does not take it either.
    if let Some(doubt) = sii.doubts.iter().find(|doubt| doubt.kind == DoubtKind::Checksum) {
        return Err(format!("{path}: {doubt}; `isocat sii {path}` shows what is in it"));
    }
    for doubt in &sii.doubts {
        anstream::eprintln!("isocat profile: {path}: {doubt}");
    }
    let file = EsiFile::of_sii(&sii);
    let device = file.devices.first().ok_or_else(|| format!("{path}: it has no device"))?;
    of_description_device(&file, device, arguments)
}

fn of_description_device(
    file: &EsiFile,
    device: &EsiDevice,
    arguments: &Arguments,
) -> Result<ProfileText, String> {
    let modes = device.op_modes();
    let names = || modes.iter().map(|mode| mode.name.as_str());
    let op_mode = match &arguments.opmode {
        None => {
            let with_sync = modes.iter().position(|mode| mode.sync0());
            with_sync.or((!modes.is_empty()).then_some(0))
        }
        Some(wanted) => {
            let by_number = || wanted.parse().ok().filter(|number: &usize| *number < modes.len());
            let found = names().position(|name| name == wanted).or_else(by_number);
            Some(found.ok_or_else(|| {
                let hint = name_hint(wanted, names());
                format!("{}: {} has no OpMode \"{wanted}\"\n{hint}", file.path, device.type_name)
            })?)
        }
    };
    let mode = op_mode.map_or(String::new(), |number| format!(", OpMode {}", modes[number].name));
    let made_of = format!("{} ({}{mode})", device.type_name, file.path);
    ProfileText::from_esi(file, device, op_mode, &made_of).map_err(|error| error.to_string())
}

fn of_scan_document(path: &str, wanted: Option<&str>) -> Result<ProfileText, String> {
    let text =
        limits::read_text(path, limits::CONTROL_ANSWER).map_err(|error| error.to_string())?;
    let document: Value = serde_json::from_str(&text).map_err(|error| {
        format!(
            "{path}:{}:{}: {error}; expected what `isocat scan --json` prints",
            error.line(),
            error.column()
        )
    })?;
    if document["format"] != scan::FORMAT {
        return Err(format!(
            "{path}: its format is {}; expected \"{}\", what `isocat scan --json` prints",
            document["format"],
            scan::FORMAT
        ));
    }
    let Some(devices) = document["devices"].as_array().filter(|devices| !devices.is_empty()) else {
        return Err(format!("{path}: no \"devices\"; expected what `isocat scan --json` prints"));
    };
    let position = match wanted {
        None if devices.len() == 1 => 0,
        None => {
            return Err(format!(
                "{path}: it has {} devices; expected which of them, such as --device 0",
                devices.len()
            ));
        }
        Some(wanted) => {
            let by_number = wanted.parse().ok().filter(|number: &usize| *number < devices.len());
            let by_name = || devices.iter().position(|device| device["name"] == wanted);
            by_number.or_else(by_name).ok_or_else(|| {
                format!(
                    "{path}: no device \"{wanted}\"; expected 0 to {}, or a name",
                    devices.len() - 1
                )
            })?
        }
    };
    let found = found(&devices[position], position)
        .map_err(|place| format!("{path}: devices[{position}]{place}"))?;
    ProfileText::from_found(&found, path)
        .map_err(|error| format!("{path}: devices[{position}]: {}", error.message))
}

/// A device of the document; an error is the place that differs from the output of a scan, and the
/// expected value.
fn found(device: &Value, position: usize) -> Result<Found, String> {
    let esc = &device["esc"];
    let of_esc = |key| integer(esc, key).map_err(|place| format!(".esc{place}"));
    let pulse = match &esc["sync_pulse_ns"] {
        Value::Null => None,
        pulse => {
            let ns = pulse.as_i64().filter(|ns| (0..=LONGEST_PULSE).contains(ns) && ns % TICK == 0);
            let expected = || {
                format!(
                    ".esc.sync_pulse_ns: expected 0 to {LONGEST_PULSE} ns in steps of {TICK}, found {pulse}"
                )
            };
            Some(Nanos(ns.ok_or_else(expected)?))
        }
    };
    let text = |key: &str| device[key].as_str().unwrap_or_default().to_owned();
    let identity = Identity {
        vendor_id: integer(device, "vendor_id")?,
        product_code: integer(device, "product_code")?,
        revision: integer(device, "revision")?,
        serial: integer(device, "serial")?,
    };
    let id = match text("order") {
        empty if empty.is_empty() => format!("device {position}"),
        order => order,
    };
    let name = match text("name") {
        empty if empty.is_empty() => id.clone(),
        name => name,
    };
    let mailbox = &device["mailbox"];
    let details = mailbox["coe_details"].as_array().map_or(&[][..], Vec::as_slice);
    let kinds = device["ports"].as_array().map_or(&[][..], Vec::as_slice);
    let kinds = kinds.iter().map(|port| port["kind"].as_str().unwrap_or_default());
    let sync = ["output_sync", "input_sync"].into_iter();
    let sync =
        sync.filter(|key| device[*key].is_object()).map(|key| sync_object(&device[key], key));
    Ok(Found {
        id,
        name,
        identity: Some(identity),
        esc_kind: of_esc("kind")?,
        narrow_clock: esc["dc"] == "32-bit",
        ram_kib: of_esc("ram_kib")?,
        ports: port_letters(kinds),
        sync_unit: esc["sync_unit"] == true,
        pulse,
        alias: integer(device, "sii_alias").unwrap_or(0),
        device_emulation: esc["device_emulation"] == true,
        mailbox: match mailbox.is_object() {
            false => None,
            true => {
                let number =
                    |key| integer(mailbox, key).map_err(|place| format!(".mailbox{place}"));
                Some([
                    (number("receive_start")?, number("receive_length")?),
                    (number("send_start")?, number("send_length")?),
                ])
            }
        },
        assignable: details.iter().any(|detail| detail == "PDO assignment"),
        protocols: protocols(mailbox)?,
        outputs: area(&device["outputs"]).map_err(|place| format!(".outputs{place}"))?,
        inputs: area(&device["inputs"]).map_err(|place| format!(".inputs{place}"))?,
        sync: sync.collect::<Result<_, _>>()?,
        op_modes: op_modes(&device["op_modes"])?,
    })
}

/// The bits of word 0x1C of the SII.
fn protocols(mailbox: &Value) -> Result<u16, String> {
    let words = mailbox["protocols"].as_array().map_or(&[][..], Vec::as_slice);
    let mut all = 0;
    for (number, word) in words.iter().enumerate() {
        let bit = word.as_str().and_then(scan::protocol);
        all |= bit.ok_or_else(|| {
            format!(
                ".mailbox.protocols[{number}]: expected a protocol such as \"CoE\", found {word}"
            )
        })?;
    }
    Ok(all)
}

/// OpModes of the SII, whose names a scan does not print.
fn op_modes(list: &Value) -> Result<Vec<OpMode>, String> {
    let list = list.as_array().map_or(&[][..], Vec::as_slice);
    let mode = |(number, mode): (usize, &Value)| {
        let time = |key: &str| {
            let ns = mode[key].as_i64().filter(|ns| i32::try_from(*ns).is_ok());
            let message = || format!(".{key}: expected a number of 32 bits, found {}", mode[key]);
            ns.map(Nanos).ok_or_else(message)
        };
        let factor = |key: &str| {
            let factor = mode[key].as_i64().and_then(|factor| i16::try_from(factor).ok());
            factor
                .ok_or_else(|| format!(".{key}: expected a number of 16 bits, found {}", mode[key]))
        };
        let cycle = |key| integer::<u32>(mode, key).map(Nanos::from_u32);
        let read = || {
            Ok(OpMode {
                name: format!("OpMode {number}"),
                description: String::new(),
                assign_activate: integer(mode, "assign_activate")?,
                sync0_factor: factor("sync0_factor")?,
                sync1_factor: factor("sync1_factor")?,
                sync0_cycle: cycle("sync0_cycle_ns")?,
                sync0_shift: time("sync0_shift_ns")?,
                sync1_shift: time("sync1_shift_ns")?,
            })
        };
        read().map_err(|place: String| format!(".op_modes[{number}]{place}"))
    };
    list.iter().enumerate().map(mode).collect()
}

fn area(area: &Value) -> Result<Option<FoundArea>, String> {
    // A coupler has a direction without a SyncManager.
    if !area.is_object() || area["sync_manager"].is_null() {
        return Ok(None);
    }
    if area["further"].as_array().is_some_and(|further| !further.is_empty()) {
        return Err(
            ".further: it is in several SyncManagers; a profile has one for each direction".into(),
        );
    }
    if area["window"] == true {
        return Err(".window: it is a window on registers; a profile has no key for it".into());
    }
    let list = |value: &Value, place: &str| {
        value.as_array().cloned().ok_or_else(|| format!("{place}: expected a list"))
    };
    let mut pdos = Vec::new();
    for (number, pdo) in list(&area["pdos"], ".pdos")?.iter().enumerate() {
        let within = |place| format!(".pdos[{number}]{place}");
        let mut entries = Vec::new();
        for entry in list(&pdo["entries"], ".entries").map_err(within)? {
            let index = integer(&entry, "index").map_err(within)?;
            let sub = integer(&entry, "sub").map_err(within)?;
            let bits = integer(&entry, "bits").map_err(within)?;
            entries.push((ObjectAddress::new(index, sub), bits));
        }
        pdos.push((integer(pdo, "index").map_err(within)?, entries));
    }
    Ok(Some(FoundArea {
        sync_manager: integer(area, "sync_manager")?,
        start: integer(area, "start")?,
        length: integer(area, "length")?,
        pdos,
    }))
}

fn sync_object(object: &Value, key: &str) -> Result<(u16, Vec<FoundEntry>), String> {
    let within = |place| format!(".{key}{place}");
    let entries = object["entries"].as_array().map_or(&[][..], Vec::as_slice);
    let entries = entries.iter().map(|entry| {
        Ok(FoundEntry {
            sub: integer(entry, "sub")?,
            value: match entry["value"].is_null() {
                true => None,
                false => Some(integer(entry, "value")?),
            },
            writable: entry["writable"].as_bool(),
        })
    });
    let entries = entries.collect::<Result<_, String>>().map_err(within)?;
    Ok((integer(object, "index").map_err(within)?, entries))
}

/// A number of the document; the error is its place and the expected value.
fn integer<T: TryFrom<u64>>(of: &Value, key: &str) -> Result<T, String> {
    let number = of[key].as_u64().and_then(|number| T::try_from(number).ok());
    number.ok_or_else(|| {
        let bits = 8 * size_of::<T>();
        format!(".{key}: expected a number of {bits} bits, found {}", of[key])
    })
}

/// Largest pulse length in register 0x0982, ns.
const LONGEST_PULSE: i64 = 655_350;
/// Its unit, ns.
const TICK: i64 = 10;
