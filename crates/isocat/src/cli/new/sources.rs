//! The sources of a new segment file.

use std::path::PathBuf;
use std::sync::Arc;

use isocat_descriptions::eni::Eni;
use isocat_descriptions::esi::{EsiDevice, EsiFile, Wish};
use isocat_descriptions::limits;
use isocat_player::virtual_segment::{self, Origin};
use isocat_segment::new_file::{NewDevice, NewFile, quoted};
use isocat_segment::profile::{self, Profile, RunAs, TakenOpMode, name_hint};
use isocat_sync::opmode::BusCycles;
use isocat_wire::PortNumber;
use isocat_wire::time::Nanos;
use serde_json::Value;

use super::super::eni_run::is_eni;
use super::offers::{self, Others};

/// A file under construction, and messages about it.
pub(super) struct Made {
    pub file: NewFile,
    pub cycle_is_given: bool,
    /// Bus cycles that the OpModes of single devices ask for, beside the usual ones.
    pub cycles: Vec<Nanos>,
    pub notes: Vec<String>,
}

/// A device of a source.
struct Found {
    profile: Arc<Profile>,
    device: NewDevice,
    /// The bus cycle nearest to 1 ms that its OpMode takes.
    cycle: Nanos,
}

/// Makes the file from the named sources; an error is a sentence.
pub(super) fn collect(what: &[String], esi: &[PathBuf]) -> Result<Made, String> {
    let descriptions = virtual_segment::descriptions(esi).map_err(|error| error.to_string())?;
    match what {
        [one] if is_eni(one) => of_eni(one, &descriptions),
        [one] if one.to_ascii_lowercase().ends_with(".json") => of_scan(one, &descriptions),
        [] => {
            let only = |file: &EsiFile| {
                let mut types: Vec<_> =
                    file.usable().map(|device| device.type_name.clone()).collect();
                types.dedup();
                types
            };
            let all: Vec<_> = descriptions.iter().map(only).collect();
            match !all.is_empty() && all.iter().all(|types| types.len() == 1) {
                true => of_types(&all.concat(), &descriptions),
                false => {
                    let list = types(&descriptions);
                    Err(format!(
                        "no types; expected which devices, in the order of the wire\n{list}"
                    ))
                }
            }
        }
        types => of_types(types, &descriptions),
    }
}

/// The types of the descriptions, as a hint.
fn types(descriptions: &[EsiFile]) -> String {
    match descriptions {
        [] => {
            "expected --esi vendor.xml beside them, or names of built-in profiles (isocat devices)"
                .to_owned()
        }
        files => {
            let all = files.iter().flat_map(EsiFile::usable);
            name_hint("", all.map(|device| device.type_name.as_str()))
        }
    }
}

fn of_types(types: &[String], descriptions: &[EsiFile]) -> Result<Made, String> {
    let mut file = NewFile::new(Nanos::millis(1));
    let mut notes = Vec::new();
    file.made_of.push("A segment of the devices that were named, made by `isocat new`.".to_owned());
    let all = types.iter().map(|name| named(name, descriptions, &mut notes));
    let all = all.collect::<Result<Vec<_>, String>>()?;
    // Terminals alone stand beside an embedded PC; with others, at the end of a cable.
    let is_on_ebus = |found: &Found| found.profile.is_on_ebus();
    if all.first().is_some_and(is_on_ebus) && !all.iter().all(is_on_ebus) {
        file.add_coupler()?;
    }
    let cycles = all.iter().map(|found| found.cycle).collect();
    for Found { profile, device, .. } in all {
        file.add(device, profile)?;
    }
    Ok(Made { file, cycle_is_given: false, cycles, notes })
}

/// A device by its type in the descriptions, or else a built-in profile by its id or name.
fn named(name: &str, descriptions: &[EsiFile], notes: &mut Vec<String>) -> Result<Found, String> {
    let wish = Wish { type_name: Some(name), ..Wish::default() };
    let mut found =
        descriptions.iter().filter_map(|file| Some((file, file.device(wish).ok()?.device)));
    if let Some((file, device)) = found.next() {
        let others: Vec<_> = found.map(|(file, _)| file.path.as_str()).collect();
        if !others.is_empty() {
            notes.push(format!(
                "{name} is taken from {}; {} have it, too",
                file.path,
                others.join(", ")
            ));
        }
        let others = Others::of(file, device);
        notes.extend(others.message(file, device));
        return of_description(file, device, Some(&others));
    }
    let is_meant = |profile: &Arc<Profile>| profile.id == name || profile.name == name;
    let profile = profile::built_in_ids().filter_map(profile::built_in).find(is_meant);
    let Some(profile) = profile else {
        let of_files = descriptions.iter().flat_map(EsiFile::usable);
        let mut known: Vec<&str> = of_files.map(|device| device.type_name.as_str()).collect();
        known.dedup();
        for id in profile::built_in_ids() {
            known.push(id);
        }
        return Err(format!("no type and no profile \"{name}\"\n{}", name_hint(name, known)));
    };
    Ok(of_profile(&profile))
}

fn of_profile(profile: &Arc<Profile>) -> Found {
    let mut keys = vec![format!("device = {}", quoted(&profile.id))];
    let modes: Vec<_> = profile.modes().map(|mode| format!("\"{mode}\"")).collect();
    if !modes.is_empty() {
        keys.push(format!("# mode = {}", modes.join(" or ")));
    }
    let device = device(&profile.name, keys);
    Found { profile: profile.clone(), device, cycle: Nanos::millis(1) }
}

fn device(name: &str, keys: Vec<String>) -> NewDevice {
    NewDevice {
        name: name.split_whitespace().collect::<Vec<_>>().join(" "),
        keys,
        notes: Vec::new(),
        place: None,
        cable_m: None,
        clock_ppm: None,
    }
}

/// A device of a description, in the first OpMode with SYNC pulses that can be simulated, or else
/// in the first that can. `others` are those that the user may have meant as well.
fn of_description(
    file: &EsiFile,
    found: &EsiDevice,
    others: Option<&Others<'_>>,
) -> Result<Found, String> {
    let modes = found.op_modes();
    let with_sync = (0..modes.len()).filter(|number| modes[*number].sync0());
    let without = (0..modes.len()).filter(|number| !modes[*number].sync0());
    let mut order: Vec<_> = with_sync.chain(without).map(Some).collect();
    if order.is_empty() {
        order.push(None);
    }
    let mut refused = None;
    for mode in order {
        let cycle = usual_cycle(found, mode);
        let made = Profile::from_esi(file, found, mode)
            .and_then(|profile| RunAs::new(file, found, mode, &profile, cycle).map(|_| profile));
        match made {
            Ok(profile) => {
                let keys = description_keys(file, found, mode, others);
                let notes = offers::modules(file, found);
                let device = NewDevice { notes, ..device(&found.type_name, keys) };
                return Ok(Found { profile, device, cycle });
            }
            Err(error) => refused = refused.or(Some(error)),
        }
    }
    let error = refused.map_or_else(String::new, |error| error.to_string());
    Err(format!("{error}\n\"isocat devices {}\" lists what can be simulated", file.path))
}

/// The bus cycle nearest to 1 ms that an OpMode takes.
fn usual_cycle(found: &EsiDevice, mode: Option<usize>) -> Nanos {
    let taken = mode.and_then(|number| TakenOpMode::new(found, number));
    let cycles = taken.and_then(|taken| taken.bus_cycles());
    cycles.unwrap_or(BusCycles::ANY).nearest(Nanos::millis(1))
}

fn description_keys(
    file: &EsiFile,
    found: &EsiDevice,
    mode: Option<usize>,
    others: Option<&Others<'_>>,
) -> Vec<String> {
    let mut keys = vec![
        format!("esi = {}", quoted(&file.path)),
        format!("type = {}", quoted(&found.type_name)),
    ];
    let or = |list: String| match list.as_str() {
        "" => String::new(),
        list => format!("    # or {list}"),
    };
    // Where a type has several products, the key tells them apart.
    if let Some(product) = found.product_code
        && Others::of(file, found).has_products()
    {
        let or = others.map_or(String::new(), |others| or(others.products()));
        keys.push(format!("product = 0x{product:08X}{or}"));
    }
    if let Some(revision) = found.revision {
        let or = others.map_or(String::new(), |others| or(others.revisions()));
        keys.push(format!("revision = 0x{revision:08X}{or}"));
    }
    let modes = found.op_modes();
    let Some(number) = mode else { return keys };
    let name = &modes[number].name;
    let is_only = modes.iter().filter(|mode| mode.name == *name).count() == 1 && !name.is_empty();
    let value = if is_only { quoted(name) } else { number.to_string() };
    let others = modes.iter().enumerate().filter(|(other, _)| *other != number);
    let others: Vec<_> =
        others.map(|(number, mode)| format!("{number} {}", quoted(&mode.name))).collect();
    keys.push(match others.is_empty() {
        true => format!("opmode = {value}"),
        false => format!("opmode = {value}    # or {}", others.join(", ")),
    });
    keys
}

fn of_eni(path: &str, descriptions: &[EsiFile]) -> Result<Made, String> {
    // What makes an ENI impossible to run does not matter here: a list of devices is enough.
    let mut eni = Eni::read(path).map_err(|error| error.to_string())?;
    let cycle_is_given = eni.start_up.cycle_ns > 0;
    if !cycle_is_given {
        eni.start_up.cycle_ns = Nanos::millis(1).0;
    }
    let made = virtual_segment::of_eni(&eni, descriptions).map_err(|error| error.to_string())?;
    let unknown: Vec<_> = (made.origins.iter().zip(&eni.start_up.devices))
        .filter(|(origin, _)| **origin == Origin::Eni)
        .map(|(_, device)| {
            format!(
                "{} (vendor 0x{:08X}, product 0x{:08X})",
                device.name, device.vendor, device.product
            )
        })
        .collect();
    if !unknown.is_empty() {
        let runs = match eni.runnable() {
            Ok(_) => format!(". `isocat run {path}` runs the ENI without them"),
            Err(_) => String::new(),
        };
        return Err(format!(
            "{path}: nothing describes {} with its process data; expected descriptions (--esi){runs}",
            unknown.join(", ")
        ));
    }
    let mut file = NewFile::new(Nanos(eni.start_up.cycle_ns));
    file.made_of.push(format!("The segment of {path}, made by `isocat new`."));
    for (keys, found) in made.keys.iter().zip(&made.scenario.devices) {
        let keys = keys.lines().map(str::to_owned).collect();
        let mut what = device(&found.name, keys);
        what.place = found.place.upstream;
        file.add(what, found.profile.clone())?;
    }
    Ok(Made { file, cycle_is_given, cycles: Vec::new(), notes: Vec::new() })
}

fn of_scan(path: &str, descriptions: &[EsiFile]) -> Result<Made, String> {
    let text =
        limits::read_text(path, limits::CONTROL_ANSWER).map_err(|error| error.to_string())?;
    let document: Value = serde_json::from_str(&text).map_err(|error| {
        format!(
            "{path}:{}:{}: {error}; expected what `isocat scan --json` prints",
            error.line(),
            error.column()
        )
    })?;
    let Some(devices) = document["devices"].as_array().filter(|devices| !devices.is_empty()) else {
        return Err(format!("{path}: no \"devices\"; expected what `isocat scan --json` prints"));
    };
    let mut file = NewFile::new(Nanos::millis(1));
    file.made_of.push(format!("What a scan found ({path}), made by `isocat new`."));
    let (mut notes, mut cycles) = (Vec::new(), Vec::new());
    for (position, found) in devices.iter().enumerate() {
        let number = |key: &str| {
            let value = found[key].as_u64().and_then(|value| u32::try_from(value).ok());
            value.ok_or_else(|| {
                format!("{path}: devices[{position}].{key}: expected a number of 32 bits")
            })
        };
        let identity = (number("vendor_id")?, number("product_code")?, number("revision")?);
        let name = found["name"].as_str().unwrap_or_default();
        let found_here = identified(identity, name, descriptions, &mut notes)
            .map_err(|message| format!("{path}: device {position}: {message}"))?;
        let Found { profile, device: mut what, cycle } = found_here;
        cycles.push(cycle);
        what.place = place(found, position);
        // Behind a branch the frame was on its way through that branch, too.
        let is_beside = |other: &Value| other["parent"] == found["parent"];
        if !devices[..position].iter().any(is_beside) {
            what.cable_m = found["delay"]["from_parent_ns"].as_f64().map(metres);
        }
        let follows = found["clock"]["speed_ppm"].as_f64();
        what.clock_ppm = follows.filter(|ppm| position > 0 && ppm.abs() <= MOST_PPM);
        file.add(what, profile)?;
    }
    Ok(Made { file, cycle_is_given: false, cycles, notes })
}

/// The place of a device by the scan: position and port of the one upstream, which must come before
/// it.
fn place(found: &Value, position: usize) -> Option<(usize, PortNumber)> {
    let above =
        usize::try_from(found["parent"].as_u64()?).ok().filter(|above| *above < position)?;
    let port = usize::try_from(found["parent_port"].as_u64()?).ok()?;
    Some((above, PortNumber::ALL.get(port).copied()?))
}

/// The device of an identity: of its revision, or else of the newest.
fn identified(
    (vendor, product, revision): (u32, u32, u32),
    name: &str,
    descriptions: &[EsiFile],
    notes: &mut Vec<String>,
) -> Result<Found, String> {
    let of_vendor = descriptions.iter().filter(|file| file.vendor_id == vendor);
    let all = of_vendor.flat_map(|file| file.usable().map(move |device| (file, device)));
    let same: Vec<_> = all.filter(|(_, one)| one.product_code == Some(product)).collect();
    let exact = same.iter().find(|(_, one)| one.revision == Some(revision));
    if let Some((file, device)) = exact.or_else(|| same.iter().max_by_key(|(_, one)| one.revision))
    {
        if device.revision != Some(revision) {
            let revision = format!("revision 0x{revision:08X} was found, {} has", file.path);
            let other = device.revision.unwrap_or(0);
            notes.push(format!("{}: {revision} 0x{other:08X}", device.type_name));
        }
        return of_description(file, device, None);
    }
    let is_meant = |profile: &Arc<Profile>| {
        (profile.identity.vendor_id, profile.identity.product_code) == (vendor, product)
    };
    let built_in = profile::built_in_ids().filter_map(profile::built_in).find(is_meant);
    built_in.map(|profile| of_profile(&profile)).ok_or_else(|| {
        format!(
            "nothing describes \"{name}\" (vendor 0x{vendor:08X}, product 0x{product:08X}); expected its description (--esi)"
        )
    })
}

/// The cable of a copper hop from the measured delay, less the delay of ESC and PHYs.
fn metres(delay_ns: f64) -> u32 {
    ((delay_ns - HOP_NS) / NS_PER_METRE).round().clamp(0.0, MOST_METRES) as u32
}

/// Delay of ESC and two PHYs of a copper hop, as in docs/segment-file.md.
const HOP_NS: f64 = 155.0 + 2.0 * 280.0;
const NS_PER_METRE: f64 = 5.0;
const MOST_METRES: f64 = 100.0;
/// A larger deviation is not that of a crystal.
const MOST_PPM: f64 = 1_000.0;
