//! Makes a virtual segment to play an ENI on. An ENI tells what is written, but not what the
//! devices are. So each device is made from the best source: a maker's description (ESI), a
//! built-in profile, or else the ENI itself.

mod plain;

use std::fmt;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use isocat_descriptions::document::{FileError, Wrong};
use isocat_descriptions::eni::Eni;
use isocat_descriptions::esi::{CycleTime, EsiDevice, EsiFile, EsiOpMode};
use isocat_descriptions::start_up::{Address, DeviceStartUp, Transition};
use isocat_segment::new_file::{Wiring, quoted};
use isocat_segment::profile::{self, Profile};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sync::SyncMode;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_wire::dc::AssignActivate;
use isocat_wire::register::{self, Value};
use isocat_wire::{Command, PortNumber};

/// A segment, with the source of each device.
#[derive(Clone, Debug)]
pub struct VirtualSegment {
    /// The segment.
    pub scenario: Scenario,
    /// The sources by position.
    pub origins: Vec<Origin>,
    /// The text of its segment file.
    pub text: String,
    /// The lines of the segment file that describe each device, by position, without its name and
    /// place. Empty for a segment file of the user.
    pub keys: Vec<String>,
}

/// The source of a device.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Origin {
    /// The user's segment file.
    SegmentFile,
    /// A maker's description.
    Esi {
        /// The file.
        path: String,
        /// The type in the file.
        kind: String,
        /// The OpMode with the AssignActivate word of the ENI; `None`: the device has none, or none
        /// fits.
        op_mode: Option<String>,
        /// The revision in the file, if it differs from that of the ENI.
        other_revision: Option<u32>,
    },
    /// A built-in profile.
    BuiltIn {
        /// Its id.
        id: String,
    },
    /// The ENI alone: times and dictionary of the device are assumptions.
    Eni,
}

impl Origin {
    /// A fixed name, for programs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::SegmentFile => "segment-file",
            Self::Esi { .. } => "esi",
            Self::BuiltIn { .. } => "built-in",
            Self::Eni => "eni",
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SegmentFile => f.write_str("as the segment file has it"),
            Self::Esi { path, kind, op_mode, other_revision } => {
                write!(f, "{kind} of {path}")?;
                if let Some(op_mode) = op_mode {
                    write!(f, ", OpMode \"{op_mode}\"")?;
                }
                if let Some(revision) = other_revision {
                    write!(f, ", revision 0x{revision:08X} in the place of the ENI's")?;
                }
                Ok(())
            }
            Self::BuiltIn { id } => write!(f, "built-in profile {id}"),
            Self::Eni => f.write_str(
                "made of the ENI alone: memory layout and PDOs are the ENI's, times and dictionary are assumed",
            ),
        }
    }
}

/// Reads the descriptions in these files and folders. A file that is no description is an error if
/// it was named itself, and ignored in a folder.
pub fn descriptions(paths: &[PathBuf]) -> Result<Vec<EsiFile>, FileError> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(EsiFile::read(&absolute(path))?);
            continue;
        }
        let unreadable = |error| FileError::unreadable(&path.display().to_string(), &error);
        let entries = std::fs::read_dir(path).map_err(unreadable)?;
        let mut all: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        all.retain(|one| one.extension().is_some_and(|end| end.eq_ignore_ascii_case("xml")));
        all.sort();
        files.extend(all.iter().filter_map(|one| EsiFile::read(&absolute(one)).ok()));
    }
    Ok(files)
}

/// Makes a segment from an ENI.
pub fn of_eni(eni: &Eni, descriptions: &[EsiFile]) -> Result<VirtualSegment, FileError> {
    let list = &eni.start_up;
    let (mut made, mut origins, mut all_keys) = (Vec::new(), Vec::new(), Vec::new());
    let mut wiring = Wiring::default();
    let mut text = format!("cycle = \"{}ns\"\n", list.cycle_ns);
    if list.devices.first().is_some_and(|device| device.physics.starts_with('K')) {
        text += "\n[host]\nport = \"ebus\"\n";
    }
    for (position, device) in list.devices.iter().enumerate() {
        let (keys, origin, profile) = keys(eni, position, descriptions, &mut made)?;
        origins.push(origin);
        let name = name(eni, position);
        // Writing to a String cannot fail.
        let _ = write!(text, "\n[[subdevice]]\nname = {}\n{keys}", quoted(&name));
        let above = device.parent.and_then(|parent| {
            let at = list.devices[..position].iter().position(|one| one.station == parent.station);
            Some((at?, parent.port))
        });
        // A list that tells no topology has its devices where there is room for them.
        let connect = match above {
            Some((above, port)) => {
                let place = PortNumber::ALL.get(usize::from(port)).map(|port| (above, *port));
                wiring.add(profile, place);
                Some((above, usize::from(port)))
            }
            None => wiring.add(profile, None).map(|(above, port)| (above, port.index())),
        };
        if let Some((above, port)) = connect {
            let _ = writeln!(text, "connect = \"{above}:{port}\"");
        }
        all_keys.push(keys);
    }
    let file = SegmentFile::parse_with(&eni.path, &text, &made).map_err(without_place)?;
    Ok(VirtualSegment { scenario: Scenario::from(file), origins, text, keys: all_keys })
}

/// Takes a segment that the user describes, and checks its identities against the ENI.
pub fn of_file(eni: &Eni, file: SegmentFile) -> Result<VirtualSegment, FileError> {
    let list = &eni.start_up;
    let error = |line: usize, message: String| {
        let path = file.path.clone();
        FileError::new(Wrong { path, line, column: line.min(1), message, hint: None })
    };
    let (found, expected) = (file.subdevices.len(), list.devices.len());
    if found != expected {
        return Err(error(
            0,
            format!("{found} devices; expected {expected}, as {} has them", eni.path),
        ));
    }
    for (position, (device, wanted)) in file.subdevices.iter().zip(&list.devices).enumerate() {
        let identity = &device.profile.identity;
        let found = (identity.vendor_id, identity.product_code);
        if found != (wanted.vendor, wanted.product) {
            return Err(error(
                device.line,
                format!(
                    "device {position} is vendor 0x{:08X}, product 0x{:08X} ({}); expected vendor 0x{:08X}, product \
                     0x{:08X} (\"{}\"), as {} has it",
                    found.0,
                    found.1,
                    device.name,
                    wanted.vendor,
                    wanted.product,
                    wanted.name,
                    eni.path
                ),
            ));
        }
    }
    if file.cycle.0 != list.cycle_ns {
        let message = format!(
            "cycle = {}; expected {} ns, as {} has it",
            file.cycle, list.cycle_ns, eni.path
        );
        return Err(error(0, message));
    }
    let origins = vec![Origin::SegmentFile; found];
    let (text, keys) = (String::new(), Vec::new());
    Ok(VirtualSegment { scenario: Scenario::from(file), origins, text, keys })
}

/// The keys of a device, without its name and place.
fn keys(
    eni: &Eni,
    position: usize,
    descriptions: &[EsiFile],
    made: &mut Vec<Arc<Profile>>,
) -> Result<(String, Origin, Arc<Profile>), FileError> {
    let device = &eni.start_up.devices[position];
    let cycle = eni.start_up.cycle_ns;
    if let Some((file, found)) = described(device, descriptions) {
        let profile = Profile::from_esi(file, found, None).map_err(|error| error.error)?;
        let (keys, origin) = of_description(device, cycle, file, found);
        return Ok((keys, origin, profile));
    }
    let is_meant = |profile: &Arc<Profile>| {
        let identity = &profile.identity;
        (identity.vendor_id, identity.product_code) == (device.vendor, device.product)
    };
    let built_in = profile::built_in_ids()
        .filter_map(profile::built_in)
        .find(|profile| is_meant(profile) && carries(profile, device));
    let (profile, origin) = match built_in {
        Some(profile) => {
            let origin = Origin::BuiltIn { id: profile.id.clone() };
            (profile, origin)
        }
        None => {
            let text = plain::profile(eni, position);
            let path = format!("{} (device {position}, made of the ENI)", eni.path);
            let profile = Profile::from_toml(&path, &text).map_err(without_place)?;
            made.push(profile.clone());
            (profile, Origin::Eni)
        }
    };
    let modes: Vec<SyncMode> = profile.modes().collect();
    let keys = format!("device = {}\n{}", quoted(&profile.id), mode(device, cycle, &modes));
    Ok((keys, origin, profile))
}

/// Whether a device of this profile can exchange the process data that the ENI sets up. Another
/// revision of the product may have other PDOs.
fn carries(profile: &Profile, device: &DeviceStartUp) -> bool {
    let areas = [(true, profile.description.outputs), (false, profile.description.inputs)];
    areas.into_iter().all(|(outputs, own)| {
        let Some((start, length)) = plain::area(device, outputs) else { return true };
        let managers = device.sync_managers.iter().filter(|one| one.outputs == outputs);
        let pdos: Vec<u16> = managers.flat_map(|one| one.pdos.iter().copied()).collect();
        let bits: Option<u32> = pdos.iter().map(|pdo| profile.mapped_bits(*pdo)).sum();
        let has_pdos =
            pdos.is_empty() || bits.is_some_and(|bits| bits.div_ceil(8) == u32::from(length));
        start == own.start && length <= own.max_length && has_pdos
    })
}

/// The description of a device: that of its revision, else the newest.
fn described<'f>(
    device: &DeviceStartUp,
    descriptions: &'f [EsiFile],
) -> Option<(&'f EsiFile, &'f EsiDevice)> {
    let of_vendor = descriptions.iter().filter(|file| file.vendor_id == device.vendor);
    let all = of_vendor.flat_map(|file| file.devices.iter().map(move |one| (file, one)));
    let same: Vec<_> = all.filter(|(_, one)| one.product_code == Some(device.product)).collect();
    let exact = same.iter().find(|(_, one)| one.revision == Some(device.revision));
    exact.or_else(|| same.iter().max_by_key(|(_, one)| one.revision)).copied()
}

fn of_description(
    device: &DeviceStartUp,
    cycle: i64,
    file: &EsiFile,
    found: &EsiDevice,
) -> (String, Origin) {
    let mut keys = format!("esi = {}\ntype = {}\n", quoted(&file.path), quoted(&found.type_name));
    if let Some(revision) = found.revision {
        let _ = writeln!(keys, "revision = {revision}");
    }
    let op_mode = op_mode(device, cycle, found);
    match op_mode {
        Some(number) => {
            let _ = writeln!(keys, "opmode = {number}");
        }
        None => {
            let modes = Profile::from_esi(file, found, None);
            let modes: Vec<SyncMode> = modes.map_or(Vec::new(), |one| one.modes().collect());
            keys += &mode(device, cycle, &modes);
        }
    }
    let origin = Origin::Esi {
        path: file.path.clone(),
        kind: found.type_name.clone(),
        op_mode: op_mode.map(|number| found.op_modes()[number].name.clone()),
        other_revision: found.revision.filter(|revision| *revision != device.revision),
    };
    (keys, origin)
}

/// The OpMode with the word and the cycles that the ENI writes.
fn op_mode(device: &DeviceStartUp, bus: i64, found: &EsiDevice) -> Option<usize> {
    let word = assign_activate(device);
    let modes = found.op_modes();
    let same = |mode: &&EsiOpMode| AssignActivate(mode.assign_activate) == word;
    let number = |mode: &EsiOpMode| modes.iter().position(|one| one == mode);
    let wanted = device.dc.map_or((0, 0), |dc| (i64::from(dc.sync0_ns), i64::from(dc.sync1_ns)));
    let exact = |mode: &&EsiOpMode| {
        let sync0 = resolved(mode.cycle_time_sync0, bus);
        let sync1 = resolved(mode.cycle_time_sync1, sync0);
        word == AssignActivate::OFF || (sync0 == wanted.0 && (wanted.1 == 0 || sync1 == wanted.1))
    };
    let best = modes.iter().filter(same).find(exact).or_else(|| modes.iter().find(same));
    best.and_then(number)
}

/// The ns of an OpMode's cycle.
fn resolved(time: Option<CycleTime>, of: i64) -> i64 {
    match time {
        None => 0,
        Some(time) if time.value.0 > 0 => time.value.0,
        Some(time) => match time.factor.unwrap_or(0) {
            factor if factor < 0 => of / -i64::from(factor),
            factor => of.saturating_mul(factor.into()),
        },
    }
}

/// The keys of the device's mode by the ENI, if the device announces that mode.
fn mode(device: &DeviceStartUp, bus: i64, announced: &[SyncMode]) -> String {
    let dc = device.dc.unwrap_or_default();
    let bits = assign_activate(device).to_bytes()[1];
    let (sync0, sync1) = (bits & SYNC0 != 0, bits & SYNC1 != 0);
    let written = written_type(device);
    let wanted: &[SyncMode] = match (sync0, sync1, written) {
        (false, false, Some(0)) => &[SyncMode::FreeRun],
        (false, false, _) => &[SyncMode::SmSynchronous, SyncMode::FreeRun],
        _ if i64::from(dc.sync0_ns) < bus => &[SyncMode::DcSubordinated],
        (_, true, Some(3)) => &[SyncMode::DcSync1, SyncMode::DcShiftSync1],
        (_, true, _) => &[SyncMode::DcShiftSync1, SyncMode::DcSync1],
        _ => &[SyncMode::DcSync0],
    };
    let Some(mode) = wanted.iter().find(|mode| announced.contains(mode)) else {
        return String::new();
    };
    let mut keys = format!("mode = \"{mode}\"\n");
    let slower = i64::from(dc.sync0_ns) > bus && i64::from(dc.sync0_ns) % bus == 0;
    if slower {
        let _ = writeln!(keys, "cycle = \"{}ns\"", dc.sync0_ns);
    }
    match mode {
        SyncMode::DcSubordinated => {
            let _ = writeln!(keys, "sync0_cycle = \"{}ns\"", dc.sync0_ns);
        }
        SyncMode::DcShiftSync1 | SyncMode::DcSync1 if dc.sync1_ns > 0 => {
            let _ = writeln!(keys, "sync1 = \"{}ns\"", dc.sync1_ns);
        }
        _ => {}
    }
    keys
}

/// The values that the way to SAFEOP writes to 0x0980 and 0x0981, as one word or byte by byte.
pub(crate) fn assign_activate(device: &DeviceStartUp) -> AssignActivate {
    let mut word = [0; 2];
    for step in device.registers.iter().filter(|step| step.transitions.contains(&Transition::PS)) {
        let Address::Physical { register, .. } = step.address else { continue };
        if !matches!(step.command, Command::Fpwr | Command::Apwr) {
            continue;
        }
        for (at, byte) in word.iter_mut().enumerate() {
            let place = usize::from(register::CYCLIC_UNIT_CONTROL.address) + at;
            let written = place.checked_sub(register.into()).and_then(|at| step.data.get(at));
            *byte = written.copied().unwrap_or(*byte);
        }
    }
    AssignActivate::from_bytes(word)
}

/// The value that the ENI writes to 0x1C32:01, else to 0x1C33:01.
fn written_type(device: &DeviceStartUp) -> Option<u8> {
    let of = |index: u16| {
        let mut steps = device.objects.iter().rev();
        let step = steps.find(|one| one.object.index == index && one.object.sub == sub::SYNC_TYPE);
        step.and_then(|step| step.data.first().copied())
    };
    of(OUTPUT_PARAMETER).or_else(|| of(INPUT_PARAMETER))
}

/// The name of a device, with its position if the name is empty or not unique.
fn name(eni: &Eni, position: usize) -> String {
    let devices = &eni.start_up.devices;
    let own = devices[position].name.trim();
    let same = devices.iter().filter(|one| one.name.trim() == own).count();
    match own {
        "" => format!("SubDevice {position}"),
        own if same > 1 => format!("{own} ({position})"),
        own => own.to_owned(),
    }
}

/// Removes the line of an error: lines of a generated text mean nothing to the reader of the ENI.
fn without_place(error: FileError) -> FileError {
    FileError::new(Wrong { line: 0, column: 0, ..Wrong::clone(&error) })
}

fn absolute(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string()
}

/// Bits of 0x0981.
pub(crate) const SYNC0: u8 = 0b010;
pub(crate) const SYNC1: u8 = 0b100;
