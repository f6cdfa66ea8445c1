//! Segment files: which devices stand on the wire, how they are synchronized, for how long.
//!
//! ```toml
//! cycle = "1ms"
//!
//! [[subdevice]]
//! device = "kollmorgen_akd2g"   # a built-in profile, or the path of a profile file
//! mode = "dc-sync0"             # default: the best that the device and the cycle allow
//! cable = "10m"
//! clock = "-35ppm"
//!
//! [[subdevice]]                 # behind the one above, unless it says otherwise
//! device = "kollmorgen_akd2g"
//! connect = "1:1"               # a device above, by name or place, and its port
//! clock_ramp = { by = "+5ppm", from = "2s", over = "60s" }
//! ```
//!
//! Any device of a maker's description (ESI) can stand in a segment:
//!
//! ```toml
//! [[subdevice]]
//! esi = "vendor.xml"            # relative to the segment file
//! type = "EL2502-0010"
//! revision = 0x0011_0000        # default: the newest
//! opmode = "DC"                 # by name, or by number from 0; default: the first, for drives the first with SYNC0
//! ```
//!
//! With `count = 50` a table stands for fifty equal devices in a line.
//!
//! Every mistake is a [`FileError`] with file, line and column, what was expected and the nearest
//! known name.

use std::collections::HashMap;
use std::path::Path;

use isocat_descriptions::document::{Source, Table, Value};
use isocat_descriptions::quantity::{DelayPerMetre, Length, Ppb};
use isocat_sim::ClockModel;
use isocat_sim::cable::PICOS_PER_MILLIMETRE;
use isocat_sync::{SyncMode, object};
use isocat_wire::time::Nanos;
use isocat_wire::{ObjectAddress, PortNumber};

use crate::profile::{self, Overrides, Profile};

mod clock;
mod esi;
mod misbehave;
mod operation;
#[cfg(test)]
mod tests;
mod tree;

pub use isocat_descriptions::document::{FileError, name_hint};
pub use misbehave::vocabulary;
pub use operation::Operation;
pub use tree::Place;

/// A segment, checked: every device exists, every number is in range.
#[derive(Clone, Debug)]
pub struct SegmentFile {
    /// The file, as errors name it.
    pub path: String,
    /// Bus cycle. Key `cycle`, needed; 10 us to 1 s.
    pub cycle: Nanos,
    /// How long to run once the segment is in operation. Key `for`, one cycle to 24 h; default 10 s.
    pub duration: Nanos,
    /// Seed of everything random in the simulation. Key `seed`; default 1.
    pub seed: u64,
    /// Wanted position of SYNC0 after the start of the cycle. Key `shift`, below one cycle; default:
    /// the plan chooses.
    pub shift: Option<Nanos>,
    /// Watchdog of the process data, register 0x0420. Key `watchdog`, whole 100 us up to 6.5535 s; `None`: as the chips
    /// have it, 100 ms.
    pub watchdog: Option<Nanos>,
    /// What the MainDevice does beside the exchange while the segment runs.
    pub operation: Operation,
    /// The MainDevice's machine.
    pub host: Host,
    /// The devices in the order of their positions: the one in which frames are processed.
    pub subdevices: Vec<SubDevice>,
}

/// `[host]`: the machine that the MainDevice runs on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Host {
    /// How fast its clock runs. Key `clock`, within 1000 ppm; default +12 ppm, an ordinary crystal.
    pub clock: Ppb,
    /// Peak-to-peak lateness of its wake-ups. Key `jitter`, up to 10 ms and below half a cycle; default
    /// 20 us, a tuned PC.
    pub jitter: Nanos,
    /// Whether the clocks are kept together by drift compensation. Key `drift_compensation`; default
    /// true. Without it a simulation shows how clocks run apart.
    pub drift_compensation: bool,
}

/// `[[subdevice]]`: one device.
#[derive(Clone, Debug)]
pub struct SubDevice {
    /// What reports call it. Key `name`; default: the device's id and its
    /// place in the file from 0. With `count = N`, N equal devices stand one behind the other in the place of
    /// one; the name of each then ends in its number among them, from 0.
    pub name: String,
    /// The device, with what the file says differently already in it. Keys `device`, needed;
    /// `calc_copy` (what it states in 0x1C32:06), `copy_time` (what its CPU really needs), `delay`
    /// (what it states in 0x1C32:09), `jitter` (of its CPU), `misbehave` (what it does wrong, by name).
    pub profile: &'static Profile,
    /// How to synchronize it. Key `mode`; `None` for the best that the device and the cycle allow.
    pub mode: Option<SyncMode>,
    /// Where it hangs. Keys `connect` and `port`; default: behind the device above it.
    pub place: Place,
    /// Cable that leads to it. Key `cable`, 10 mm to 2 km; default 10 m.
    pub cable: Length,
    /// How long signals take on that cable. Key `cable_delay`, 3.3 to 10 ns/m; default 5 ns/m.
    pub cable_delay: DelayPerMetre,
    /// How much longer the way out takes on that cable than the way back; the mean stays. Key
    /// `cable_asymmetry`, up to twice the cable's delay; default 0 ns.
    pub cable_asymmetry: Nanos,
    /// How fast its clock runs. Key `clock`, within 1000 ppm; default 0 ppm.
    pub clock: Ppb,
    /// How that changes while the segment runs. Keys `clock_ramp`, `clock_step`, `clock_walk`; default:
    /// not at all. Its constant part is [`SubDevice::clock`].
    pub clock_shape: ClockModel,
    /// Its own cycle, for a device slower than the bus: SYNC0 comes and process data travel so often. Key `cycle`, a
    /// whole multiple of the bus cycle; `None`: the bus cycle.
    pub cycle: Option<Nanos>,
    /// Wanted shift of its Outputs Valid, 0x1C32:03. Key `shift`, below one cycle; `None` leaves the
    /// device's own.
    pub shift: Option<Nanos>,
    /// Wanted shift of its Input Latch, 0x1C33:03. Key `input_shift`, below one cycle; `None` leaves the
    /// device's own.
    pub input_shift: Option<Nanos>,
    /// From SYNC0 to SYNC1. Key `sync1`, below one cycle; for the modes "dc-shift-sync1" and "dc-sync1". `None`:
    /// a quarter of the cycle, and for "dc-sync1" what the device needs.
    pub sync1: Option<Nanos>,
    /// Cycle of SYNC0. Key `sync0_cycle`, a part of the cycle; for the mode "dc-subordinated". `None`: what the
    /// device states in 0x1C32:0A.
    pub sync0_cycle: Option<Nanos>,
    /// It may be absent, and come while the segment runs (hot connect). Key `optional`; default: it must be there.
    pub optional: bool,
    /// When an optional one gets its power, from the start of the simulation. Key `arrives`, up to 24 h; default:
    /// it is there from the start.
    pub arrives: Nanos,
    /// What is doubtful about a device from a maker's description: `name: words`.
    pub notes: Vec<String>,
    /// Line of the file at which it begins, for messages.
    pub line: usize,
}

impl SegmentFile {
    /// Reads a segment file; `path` names it in errors, and paths of profile files are relative to
    /// its folder.
    pub fn parse(path: &str, text: &str) -> Result<Self, FileError> {
        let source = Source { path, text };
        let document = source.parse()?;
        let root = Table::root(source, &document);
        let keys = ["cycle", "for", "seed", "shift", "watchdog", "host", "subdevice"];
        root.allow(&[&keys[..], &operation::KEYS].concat())?;
        let expected = "the bus cycle, such as cycle = \"1ms\"";
        let cycle = root.required("cycle", expected)?.duration(SHORTEST_CYCLE..=LONGEST_CYCLE)?;
        let below_cycle = Nanos::ZERO..=cycle - Nanos(1);
        let duration = match root.value("for") {
            Some(value) => value.duration(cycle..=LONGEST_RUN)?,
            None => Nanos::millis(10_000),
        };
        let seed = root.value("seed").map_or(Ok(1), |value| value.integer(0..=i64::MAX))? as u64;
        let shift = root.value("shift").map(|value| value.duration(below_cycle)).transpose()?;
        let watchdog = root.value("watchdog").map(watchdog).transpose()?;
        let operation = operation::operation(&root, cycle)?;
        let host = host(root.table("host")?, cycle)?;
        let expected = "at least one device, such as [[subdevice]] device = \"kollmorgen_akd2g\"";
        let tables = match root.tables("subdevice")? {
            tables if tables.is_empty() => {
                return Err(
                    root.error(format!("the segment has no [[subdevice]]; expected {expected}"))
                );
            }
            tables => tables,
        };
        let mut devices = Devices::default();
        let mut files = esi::Files::default();
        for table in tables {
            devices.add(table, subdevice(source, table, cycle, &mut files)?)?;
        }
        let Devices { subdevices, .. } = devices;
        let subdevices = tree::sort(subdevices);
        let path = path.to_owned();
        Ok(Self { path, cycle, duration, seed, shift, watchdog, operation, host, subdevices })
    }

    /// Reads a segment file from disk.
    pub fn read(path: &str) -> Result<Self, FileError> {
        Self::parse(path, &read(path)?)
    }

    /// The segment that `isocat run` shows without a file.
    pub fn built_in() -> Self {
        Self::parse("built-in segment", BUILT_IN)
            .unwrap_or_else(|error| panic!("a test reads the built-in segment: {error}"))
    }

    /// Its text, as a start for one's own.
    pub const fn built_in_text() -> &'static str {
        BUILT_IN
    }
}

/// The devices of the file so far.
#[derive(Default)]
struct Devices {
    subdevices: Vec<SubDevice>,
    ports: tree::Ports,
    /// The line in which each name was given.
    names: HashMap<String, usize>,
}

impl Devices {
    /// Adds what a table describes: one device, or `count` equal ones, one behind the other.
    fn add(&mut self, table: Table<'_>, device: SubDevice) -> Result<(), FileError> {
        let places = MOST_DEVICES - self.subdevices.len();
        let value = table.value("count");
        let count = value.map_or(Ok(1), |value| value.integer(1..=MOST_DEVICES as i64))? as usize;
        if count > places {
            let all = self.subdevices.len() + count;
            let message = format!("{all} devices; expected at most {MOST_DEVICES}");
            return Err(value.map_or_else(|| table.error(&message), |value| value.error(&message)));
        }
        for number in 0..count {
            let name = match table.value("name") {
                Some(_) if count > 1 => format!("{} {number}", device.name),
                Some(_) => device.name.clone(),
                None => format!("{} {}", device.profile.id, self.subdevices.len()),
            };
            if let Some(line) = self.names.insert(name.clone(), device.line) {
                let message = format!(
                    "the name \"{name}\" is already taken in line {line}; expected another"
                );
                return Err(table
                    .value("name")
                    .map_or_else(|| table.error(&message), |v| v.error(&message)));
            }
            // Only the first can hang elsewhere.
            let connect = table.value("connect").filter(|_| number == 0);
            let place = self.ports.place(table, connect, &self.subdevices, device.profile)?;
            may_be_absent(table, &device, place, &self.subdevices)?;
            self.subdevices.push(SubDevice { name, place, ..device.clone() });
        }
        Ok(())
    }
}

/// All others are behind the first; and who is behind one that is absent, is absent with it.
fn may_be_absent(
    table: Table<'_>,
    device: &SubDevice,
    place: Place,
    earlier: &[SubDevice],
) -> Result<(), FileError> {
    let error = |message: String| {
        let value = table.value("optional");
        Err(value.map_or_else(|| table.error(&message), |value| value.error(&message)))
    };
    match place.upstream.map(|(above, _)| &earlier[above]) {
        None if device.optional => error(
            "the first device is optional, and all others are behind it; expected it to be there"
                .into(),
        ),
        Some(above) if above.optional && !device.optional => error(format!(
            "it is behind \"{}\", which is optional; expected optional = true here too",
            above.name
        )),
        _ => Ok(()),
    }
}

/// Register 0x0420 counts in steps of 100 us.
fn watchdog(value: Value<'_>) -> Result<Nanos, FileError> {
    let (step, steps) = (Nanos::micros(100), i64::from(u16::MAX));
    let time = value.duration(step..=Nanos(step.0 * steps))?;
    if time.0 % step.0 != 0 {
        return Err(value.error(format!("watchdog = {time}; expected whole 100 us")));
    }
    Ok(time)
}

fn host(table: Option<Table<'_>>, cycle: Nanos) -> Result<Host, FileError> {
    let mut host =
        Host { clock: Ppb::ppm(12), jitter: Nanos::micros(20), drift_compensation: true };
    // A short cycle would not leave the default its place.
    host.jitter = host.jitter.min(Nanos(cycle.0 / 10));
    let Some(table) = table else { return Ok(host) };
    table.allow(&["clock", "jitter", "drift_compensation"])?;
    if let Some(value) = table.value("clock") {
        host.clock = value.rate(-MOST_DRIFT..=MOST_DRIFT)?;
    }
    if let Some(value) = table.value("jitter") {
        host.jitter = value.duration(Nanos::ZERO..=MOST_JITTER.min(Nanos((cycle.0 - 1) / 2)))?;
    }
    if let Some(value) = table.value("drift_compensation") {
        host.drift_compensation = value.boolean()?;
    }
    Ok(host)
}

fn subdevice(
    source: Source<'_>,
    table: Table<'_>,
    cycle: Nanos,
    files: &mut esi::Files,
) -> Result<SubDevice, FileError> {
    table.allow(&[
        "device",
        "esi",
        "type",
        "revision",
        "opmode",
        "count",
        "name",
        "mode",
        "cycle",
        "connect",
        "port",
        "cable",
        "cable_delay",
        "cable_asymmetry",
        "clock",
        "clock_ramp",
        "clock_step",
        "clock_walk",
        "shift",
        "input_shift",
        "sync1",
        "sync0_cycle",
        "calc_copy",
        "copy_time",
        "delay",
        "jitter",
        "misbehave",
        "optional",
        "arrives",
    ])?;
    let own = table.value("cycle").map(|value| own_cycle(&value, cycle)).transpose()?;
    let expected = "a profile's name, such as device = \"kollmorgen_akd2g\"";
    let (device, imported) = match table.value("esi") {
        None => (table.required("device", expected)?, None),
        Some(esi) => {
            if let Some(device) = table.value("device") {
                return Err(device.error("device is given beside esi; expected one of them"));
            }
            (esi, Some(esi::device(source, table, &esi, own.unwrap_or(cycle), files)?))
        }
    };
    let (profile, run_as) = match imported {
        Some(esi::Imported { profile, run_as }) => (profile, Some(run_as)),
        None => {
            let only = ["type", "revision", "opmode"].into_iter().find_map(|key| table.value(key));
            if let Some(value) = only {
                return Err(
                    value.error("given without esi; expected esi = \"vendor.xml\" beside it")
                );
            }
            (device_profile(source, &device)?, None)
        }
    };
    let time =
        |key, range| table.value(key).map(|value: Value<'_>| value.duration(range)).transpose();
    let calc_copy = time("calc_copy", Nanos(1)..=LONGEST_CYCLE)?;
    let delay = time("delay", Nanos::ZERO..=LONGEST_CYCLE)?;
    let overrides = Overrides {
        stated_calc_and_copy: calc_copy,
        stated_delay: delay,
        calc_and_copy: time("copy_time", Nanos(1)..=LONGEST_CYCLE)?,
        jitter: time("jitter", Nanos::ZERO..=MOST_JITTER)?,
        misbehaviour: misbehave::misbehave(table, profile)?,
    };
    let profile = profile.with(overrides).map_err(|entry| {
        let key = if entry.sub == object::sub::DELAY_TIME { "delay" } else { "calc_copy" };
        let value = table.value(key).unwrap_or(device);
        value.error(format!(
            "{key} is given, but {} has no object {entry} to state it",
            profile.name
        ))
    })?;
    let mode = match table.value("mode") {
        Some(value) => Some(mode(&value, profile, own.unwrap_or(cycle))?),
        None => run_as.as_ref().map(|run_as| run_as.mode),
    };
    let mut run_as = run_as;
    if let (Some(run_as), Some(value), Some(mode)) = (&mut run_as, table.value("mode"), mode) {
        esi::agree(&table, &value, mode, run_as)?;
    }
    // A mode of one's own has pulses of one's own.
    let (own_sync1, own_sync0, notes) = match run_as {
        Some(run_as) if mode == Some(run_as.mode) => {
            (run_as.sync1, run_as.sync0_cycle, run_as.notes)
        }
        Some(run_as) => (None, None, run_as.notes),
        None => (None, None, Vec::new()),
    };
    if let (Some(_), Some(value)) = (own, table.value("cycle"))
        && mode == Some(SyncMode::DcSubordinated)
    {
        return Err(value.error(
            "a cycle slower than the bus is given in the mode that is faster; expected any other mode \
             than \"dc-subordinated\"",
        ));
    }
    let shift = time("shift", Nanos::ZERO..=cycle - Nanos(1))?;
    let input_shift = time("input_shift", Nanos::ZERO..=cycle - Nanos(1))?;
    let behaviour = &profile.description.behaviour;
    for (key, index, able) in [
        ("shift", object::OUTPUT_PARAMETER, behaviour.shift_outputs),
        ("input_shift", object::INPUT_PARAMETER, behaviour.shift_inputs),
    ] {
        if let Some(value) = table.value(key).filter(|_| !able) {
            return Err(value.error(format!(
                "{key} is given, but {} states {} = {}; expected a device with shift by local timer",
                profile.name,
                ObjectAddress::new(index, object::sub::SUPPORTED_TYPES),
                profile.supported_types()
            )));
        }
    }
    let sync1 = time("sync1", Nanos::ZERO..=cycle - Nanos(1))?;
    only_in(&table, "sync1", mode, &[SyncMode::DcShiftSync1, SyncMode::DcSync1])?;
    let sync0_cycle = time("sync0_cycle", Nanos(10)..=cycle - Nanos(1))?;
    only_in(&table, "sync0_cycle", mode, &[SyncMode::DcSubordinated])?;
    if let (Some(own), Some(value)) = (sync0_cycle, table.value("sync0_cycle"))
        && cycle.0 % own.0 != 0
    {
        return Err(value.error(format!(
            "sync0_cycle = {own} does not divide the cycle of {cycle}; expected a whole part of it"
        )));
    }
    let cable = match table.value("cable") {
        Some(value) => value.length(Length(10)..=Length::metres(2_000))?,
        None => Length::metres(10),
    };
    let cable_delay = match table.value("cable_delay") {
        Some(value) => value.delay_per_metre(LEAST_DELAY..=DelayPerMetre(10_000))?,
        None => DelayPerMetre(1_000 * PICOS_PER_MILLIMETRE),
    };
    let optional = table.value("optional").map_or(Ok(false), |value| value.boolean())?;
    let arrives = time("arrives", Nanos::ZERO..=LONGEST_RUN)?;
    if let (Some(value), false) = (table.value("arrives"), optional) {
        return Err(value.error("arrives is given without optional = true beside it"));
    }
    Ok(SubDevice {
        name: match table.value("name") {
            Some(value) => value.name("a name in quotes")?.to_owned(),
            // Only its position can tell.
            None => String::new(),
        },
        profile,
        mode,
        // Only the devices above can tell.
        place: Place { upstream: None, port: PortNumber::P0 },
        cable,
        cable_delay,
        cable_asymmetry: match table.value("cable_asymmetry") {
            Some(value) => {
                let most = Nanos(2 * cable.0 * cable_delay.0 / 1_000_000);
                value.duration(-most..=most)?
            }
            None => Nanos::ZERO,
        },
        clock: match table.value("clock") {
            Some(value) => value.rate(-MOST_DRIFT..=MOST_DRIFT)?,
            None => Ppb(0),
        },
        clock_shape: clock::shape(table)?,
        cycle: own,
        shift,
        input_shift,
        sync1: sync1.or(own_sync1),
        sync0_cycle: sync0_cycle.or(own_sync0),
        optional,
        arrives: arrives.unwrap_or(Nanos::ZERO),
        notes,
        line: table.error("").line,
    })
}

/// A built-in profile by its id, or a profile file by its path: a name that ends in `.toml` or has a
/// slash in it.
fn device_profile(source: Source<'_>, device: &Value<'_>) -> Result<&'static Profile, FileError> {
    let name = device.name("a profile's name, or the path of a profile file")?;
    if !name.ends_with(".toml") && !name.contains('/') {
        return profile::built_in(name).ok_or_else(|| {
            device
                .error(format!("unknown device \"{name}\""))
                .with_hint(name_hint(name, profile::built_in_ids()))
        });
    }
    let folder = Path::new(source.path).parent().unwrap_or(Path::new(""));
    let path = folder.join(name).display().to_string();
    let text = std::fs::read_to_string(&path).map_err(|error| {
        device.error(format!("device \"{name}\": the profile file {path} can't be read: {error}"))
    })?;
    Profile::from_toml(&path, &text)
}

/// A cycle slower than that of the bus.
fn own_cycle(value: &Value<'_>, bus: Nanos) -> Result<Nanos, FileError> {
    let own = value.duration(bus..=LONGEST_CYCLE.max(bus))?;
    if own.0 % bus.0 != 0 {
        return Err(value.error(format!(
            "cycle = {own} is no whole multiple of the bus cycle of {bus}; expected one, or for a device faster \
             than the bus mode = \"dc-subordinated\" with a sync0_cycle"
        )));
    }
    Ok(own)
}

/// A key that has a meaning in some modes only.
fn only_in(
    table: &Table<'_>,
    key: &str,
    mode: Option<SyncMode>,
    modes: &[SyncMode],
) -> Result<(), FileError> {
    match table.value(key) {
        Some(value) if !mode.is_some_and(|mode| modes.contains(&mode)) => {
            let names: Vec<_> = modes.iter().map(|mode| format!("mode = \"{mode}\"")).collect();
            Err(value.error(format!(
                "{key} is given without a mode that has it; expected {}",
                names.join(" or ")
            )))
        }
        _ => Ok(()),
    }
}

/// A mode that the device announces, in a cycle that it can do.
fn mode(value: &Value<'_>, profile: &Profile, cycle: Nanos) -> Result<SyncMode, FileError> {
    let mode = value.one_of(&SyncMode::ALL.map(|mode| (mode.name(), mode)))?;
    let entry = |sub| ObjectAddress::new(object::OUTPUT_PARAMETER, sub);
    let types = profile.supported_types();
    if !mode.is_supported(types) {
        let announced: Vec<_> = profile.modes().map(SyncMode::name).collect();
        let what = if profile.has_mailbox() {
            format!("{} = {types}", entry(object::sub::SUPPORTED_TYPES))
        } else {
            "it has no mailbox, and its profile does not list it".to_owned()
        };
        return Err(value
            .error(format!("mode \"{mode}\" is not possible with {}: {what}", profile.name))
            .with_hint(format!("it announces: {}", announced.join(", "))));
    }
    let stated = profile.sync_parameters(object::OUTPUT_PARAMETER);
    let minimum = stated.and_then(|stated| stated.minimum_cycle_time).unwrap_or(Nanos::ZERO);
    if mode != SyncMode::FreeRun && cycle < minimum {
        return Err(value.error(format!(
            "a cycle of {cycle} is too short for {} in mode \"{mode}\": {} = {minimum}; expected a \
             cycle of {minimum} or more",
            profile.name,
            entry(object::sub::MINIMUM_CYCLE_TIME)
        )));
    }
    Ok(mode)
}

fn read(path: &str) -> Result<String, FileError> {
    std::fs::read_to_string(path).map_err(|error| FileError::unreadable(path, &error))
}

/// A frame of minimum length with four devices takes about 10 us.
const SHORTEST_CYCLE: Nanos = Nanos::micros(10);
const LONGEST_CYCLE: Nanos = Nanos::millis(1_000);
const LONGEST_RUN: Nanos = Nanos::millis(24 * 3_600 * 1_000);
/// Ten times what the worst crystal of a SubDevice may have.
const MOST_DRIFT: Ppb = Ppb::ppm(1_000);
/// Nothing is faster than light.
const LEAST_DELAY: DelayPerMetre = DelayPerMetre(3_300);
const MOST_JITTER: Nanos = Nanos::millis(10);
/// Station addresses are 16 bits.
const MOST_DEVICES: usize = 65_535;
const BUILT_IN: &str = include_str!("../segments/built_in.toml");
