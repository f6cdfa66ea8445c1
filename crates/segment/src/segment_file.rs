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
//! product = 0x09C6_3052         # where several devices have this type and revision
//! opmode = "DC"                 # by name, or by number from 0; default: the first, for drives the first with SYNC0
//! ```
//!
//! What is plugged together must fit: MII (copper) to MII, EBUS to EBUS, with a coupler between
//! both:
//!
//! ```toml
//! [[subdevice]]
//! device = "beckhoff_ek1100"       # port 0 MII, port 1 EBUS, port 2 MII
//!
//! [[subdevice]]
//! device = "beckhoff_el2502-0010"  # EBUS on both sides: it has no cable
//! ```
//!
//! A device without `clock` has one drawn by the seed: see [`Clock`].
//!
//! With `count = 50` a table stands for fifty equal devices in a line. Every key is declared in
//! [`FILE`].
//!
//! Every mistake is a [`FileError`] with file, line and column, what was expected and the nearest
//! known name.

use std::collections::HashMap;
use std::sync::Arc;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{Source, Table};
use isocat_descriptions::limits;
use isocat_descriptions::quantity::{DelayPerMetre, Length, Ppb};
use isocat_esc::DriftLaw;
use isocat_esc::chip::PortKind;
use isocat_maindevice::written::Output;
use isocat_maindevice::{DriftFilters, MeasuredTimes};
use isocat_sim::plant::PlantSetup;
use isocat_sim::{ClockModel, Expectation};
use isocat_sync::SyncMode;
use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;

use crate::chips;
use crate::profile::Doubt;
use crate::profile::Profile;

mod clock;
mod esi;
mod expect;
mod fault;
mod keys;
mod misbehave;
mod modules;
mod operation;
mod output;
mod plant;
mod ring;
mod sii;
mod subdevice;
#[cfg(test)]
mod tests;
mod tree;

pub use clock::Clock;
pub use fault::Faults;
pub use isocat_descriptions::document::{FileError, name_hint};
pub use keys::FILE;
pub(crate) use misbehave::misbehaviour;
pub use misbehave::vocabulary;
pub use operation::Operation;
pub(crate) use ring::NAME as RING_NAME;
pub use ring::Ring;
pub use tree::Place;

use keys::MOST_DEVICES;

/// A segment, checked: every device exists, every number is in range. Ranges and defaults stand
/// with the keys in [`FILE`].
#[derive(Clone, Debug)]
pub struct SegmentFile {
    /// The file, as errors name it.
    pub path: String,
    /// Bus cycle. Key `cycle`.
    pub cycle: Nanos,
    /// How long to run once the segment is in operation. Key `for`.
    pub duration: Nanos,
    /// Seed of everything random in the simulation. Key `seed`.
    pub seed: u64,
    /// The law of all drift loops. Keys `drift_law` and `drift_phase`; `None`: each chip's own.
    pub drift_law: Option<DriftLaw>,
    /// Largest SYNC0 error that counts as synchronized. Key `sync0_limit`.
    pub sync0_limit: Nanos,
    /// Largest spread of outputs behind their pulse that counts as synchronized. Key
    /// `outputs_spread`.
    pub outputs_spread: Nanos,
    /// Wanted position of SYNC0 after the start of the cycle. Key `shift`; `None`: the plan
    /// chooses.
    pub shift: Option<Nanos>,
    /// Watchdog of the process data, register 0x0420. Key `watchdog`; `None`: as the chips have it,
    /// 100 ms.
    pub watchdog: Option<Nanos>,
    /// Whether the delay of a hop varies from frame to frame. Key `hop_jitter`.
    pub hop_jitter: bool,
    /// What the MainDevice does beside the exchange while the segment runs.
    pub operation: Operation,
    /// What makes a ring of the segment. Key `ring`; `None`: nothing, it hangs on one port.
    pub ring: Option<Ring>,
    /// What goes wrong. Tables `[[fault]]`.
    pub faults: Faults,
    /// What the MainDevice's application writes on a timeline. Tables `[[output]]`.
    pub outputs: Vec<Output>,
    /// The machines behind devices. Tables `[[plant]]`.
    pub plants: Vec<PlantSetup>,
    /// What is expected of a run. Tables `[[expect]]`.
    pub expectations: Vec<Expectation>,
    /// The MainDevice's machine.
    pub host: Host,
    /// The devices in the order of their positions: the one in which frames are processed.
    pub subdevices: Vec<SubDevice>,
}

/// `[host]`: the machine that the MainDevice runs on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Host {
    /// What the first device is plugged into. Key `port`.
    pub port: PortKind,
    /// How fast its clock runs. Key `clock`.
    pub clock: Ppb,
    /// Peak-to-peak lateness of its wake-ups. Key `jitter`.
    pub jitter: Nanos,
    /// Whether the clocks are kept together by drift compensation. Key `drift_compensation`.
    /// Without it a simulation shows how clocks run apart.
    pub drift_compensation: bool,
    /// Filter depths of the drift loops. Keys `difference_filter` and `speed_filter`.
    pub drift_filters: DriftFilters,
}

/// `[[subdevice]]`: one device.
#[derive(Clone, Debug)]
pub struct SubDevice {
    /// What reports call it. Key `name`; default: the device's id and its place in the file from 0.
    /// With `count = N`, N equal devices stand one behind the other in the place of one; the name
    /// of each then ends in its number among them, from 0.
    pub name: String,
    /// The device, with what the file says differently already in it. Keys `device`, or `esi`,
    /// `type`, `product`, `revision` and `opmode`; `calc_copy` (what it states in 0x1C32:06), `copy_time`
    /// (what its CPU really needs), `delay` (what it states in 0x1C32:09), `jitter` (of its CPU), `pulse` and
    /// `acknowledge` (how its SYNC signals fall again), `eeprom_burn` (how long its EEPROM burns), `misbehave` (what it
    /// does wrong, by name).
    pub profile: Arc<Profile>,
    /// How to synchronize it. Key `mode`; `None` for the best that the device and the cycle allow.
    pub mode: Option<SyncMode>,
    /// Where it hangs. Keys `connect` and `port`.
    pub place: Place,
    /// Cable that leads to it. Key `cable`.
    pub cable: Length,
    /// How long signals take on that cable. Key `cable_delay`.
    pub cable_delay: DelayPerMetre,
    /// How much longer the way out takes on that cable than the way back; the mean stays. Key
    /// `cable_asymmetry`.
    pub cable_asymmetry: Nanos,
    /// How fast its clock runs. Key `clock`, and `clocks` of the file.
    pub clock: Clock,
    /// How that changes while the segment runs. Keys `clock_ramp`, `clock_step`, `clock_walk`. Its
    /// constant part is [`SubDevice::clock`].
    pub clock_shape: ClockModel,
    /// Its own cycle, for a device slower than the bus: SYNC0 comes and process data travel once in
    /// it. Key `cycle`; `None`: the bus cycle.
    pub cycle: Option<Nanos>,
    /// Wanted shift of its Outputs Valid, 0x1C32:03. Key `shift`; `None` leaves the device's own.
    pub shift: Option<Nanos>,
    /// Wanted shift of its Input Latch, 0x1C33:03. Key `input_shift`; `None` leaves the device's
    /// own.
    pub input_shift: Option<Nanos>,
    /// From SYNC0 to SYNC1, for the modes "dc-shift-sync1" and "dc-sync1". Key `sync1`; `None`: a
    /// quarter of the cycle, and for "dc-sync1" what the device needs.
    pub sync1: Option<Nanos>,
    /// Cycle of SYNC0, for the mode "dc-subordinated". Key `sync0_cycle`; `None`: what the device
    /// states in 0x1C32:0A.
    pub sync0_cycle: Option<Nanos>,
    /// What its registers 0x0980 and 0x0981 get, by the OpMode of its `esi` file; `None` without.
    pub unit: Option<AssignActivate>,
    /// Times that it measured once. Table `measured_times`.
    pub measured: MeasuredTimes,
    /// It may be absent, and come while the segment runs (hot connect). Key `optional`.
    pub optional: bool,
    /// When an optional one gets its power, from the start of the simulation. Key `arrives`.
    pub arrives: Nanos,
    /// What is doubtful about a device from a maker's description: `name: words`.
    pub notes: Vec<Doubt>,
    /// Line of the file at which it begins, for messages.
    pub line: usize,
}

impl SegmentFile {
    /// What the built-in segment is called where others have the path of their file.
    pub const BUILT_IN_NAME: &str = "built-in segment";

    /// Reads a segment file; `path` names it in errors, and paths of profile files are relative to
    /// its folder.
    pub fn parse(path: &str, text: &str) -> Result<Self, FileError> {
        Self::parse_with(path, text, &[])
    }

    /// The same with profiles in hand: the key `device` finds them by their ids, before it looks for built-in ones and
    /// for files.
    pub fn parse_with(
        path: &str,
        text: &str,
        profiles: &[Arc<Profile>],
    ) -> Result<Self, FileError> {
        let source = Source { path, text };
        let document = source.parse()?;
        let root = Keys::open(Table::root(source, &document), &keys::FILE)?;
        let cycle = root.get("cycle")?;
        let root = root.by(cycle);
        let duration = root.get("for")?;
        let seed = root.get("seed")?;
        let drift_law = chips::asked_law(&root, DriftLaw::HOLD)?;
        let sync0_limit = root.get("sync0_limit")?;
        let outputs_spread = root.get("outputs_spread")?;
        let shift = root.find("shift")?;
        let watchdog = root.find("watchdog")?;
        let hop_jitter = root.get("hop_jitter")?;
        let operation = operation::operation(&root)?;
        let host = host(&root.table_or_empty("host")?, cycle)?;
        let tolerance = root.find("clocks")?;
        let tables = root.tables("subdevice")?;
        if tables.is_empty() {
            return Err(root.error(keys::no_device()));
        }
        let mut devices = Devices::on(host.port);
        let mut files = esi::Files::with(profiles);
        let bus = subdevice::Bus { cycle, tolerance };
        let mut lines = Lines { text, at: 0, line: 1 };
        for table in &tables {
            let mut device = subdevice::subdevice(source, table, bus, &mut files)?;
            device.line = lines.line_of(table.at());
            devices.add(table, device)?;
        }
        let subdevices = tree::sort(devices.subdevices);
        let ring = ring::ring(&root, &subdevices, &operation)?;
        let faults = fault::faults(&root, &subdevices, ring)?;
        let outputs = output::outputs(&root, &subdevices)?;
        let plants = plant::plants(&root, &subdevices, &outputs, cycle)?;
        let expectations = expect::expectations(&root, &subdevices, &plants)?;
        let path = path.to_owned();
        Ok(Self {
            path,
            cycle,
            duration,
            seed,
            drift_law,
            sync0_limit,
            outputs_spread,
            shift,
            watchdog,
            hop_jitter,
            operation,
            ring,
            faults,
            outputs,
            plants,
            expectations,
            host,
            subdevices,
        })
    }

    /// Reads a segment file from disk.
    pub fn read(path: &str) -> Result<Self, FileError> {
        Self::parse(path, &read(path)?)
    }

    /// The segment that `isocat run` shows without a file.
    pub fn built_in() -> Self {
        Self::parse(Self::BUILT_IN_NAME, BUILT_IN)
            .unwrap_or_else(|error| panic!("a test reads the built-in segment: {error}"))
    }

    /// Its text, as a start for one's own.
    pub const fn built_in_text() -> &'static str {
        BUILT_IN
    }
}

/// Counts lines as the file goes on, so that all devices together cost one pass over it.
struct Lines<'a> {
    text: &'a str,
    /// The place up to which lines were counted, and the line there, from 1.
    at: usize,
    line: usize,
}

impl Lines<'_> {
    /// The line of the byte `at`.
    fn line_of(&mut self, at: usize) -> usize {
        if at < self.at {
            (self.at, self.line) = (0, 1);
        }
        let between = self.text.get(self.at..at).unwrap_or_default();
        self.line += between.bytes().filter(|byte| *byte == b'\n').count();
        self.at = at;
        self.line
    }
}

/// The devices of the file so far.
struct Devices {
    subdevices: Vec<SubDevice>,
    ports: tree::Ports,
    /// The place of each name in `subdevices`.
    names: HashMap<String, usize>,
}

impl Devices {
    /// None yet, on a MainDevice with this port.
    fn on(port: PortKind) -> Self {
        Self { subdevices: Vec::new(), ports: tree::Ports::of(port), names: HashMap::new() }
    }

    /// Adds what a table describes: one device, or `count` equal ones, one behind the other.
    fn add(&mut self, keys: &Keys<'_>, device: SubDevice) -> Result<(), FileError> {
        let count: usize = keys.get("count")?;
        let all = self.subdevices.len() + count;
        if all > MOST_DEVICES {
            return Err(
                keys.error_at("count", format!("{all} devices; expected at most {MOST_DEVICES}"))
            );
        }
        let port = tree::own_port(keys, &device.profile)?;
        for number in 0..count {
            let name = match keys.value("name") {
                Some(_) if count > 1 => format!("{} {number}", device.name),
                Some(_) => device.name.clone(),
                None => format!("{} {}", device.profile.id, self.subdevices.len()),
            };
            if let Some(other) = self.names.insert(name.clone(), self.subdevices.len()) {
                let line = self.subdevices[other].line;
                let message = format!(
                    "the name \"{name}\" is already taken in line {line}; expected another"
                );
                return Err(keys.error_at("name", message));
            }
            // Only the first can hang elsewhere.
            let connect = keys.value("connect").filter(|_| number == 0);
            let plug = tree::Plug { name: &name, profile: &device.profile, port };
            let earlier = tree::Earlier { devices: &self.subdevices, names: &self.names };
            let place = self.ports.place(keys, plug, connect, earlier)?;
            may_be_absent(keys, &device, place, &self.subdevices)?;
            let mut device = SubDevice { name, place, ..device.clone() };
            if device.profile.esc().port(port) == PortKind::Ebus {
                without_cable(keys, &mut device)?;
            }
            self.subdevices.push(device);
        }
        Ok(())
    }
}

/// EBUS ports meet by contacts: the way between two terminals is part of what their ESCs take.
fn without_cable(keys: &Keys<'_>, device: &mut SubDevice) -> Result<(), FileError> {
    for key in ["cable", "cable_delay", "cable_asymmetry"] {
        if keys.value(key).is_some() {
            let message = format!(
                "{key} is given, but \"{}\" is joined by EBUS, whose contacts are no cable; expected no {key} here",
                device.name
            );
            return Err(keys.error_at(key, message));
        }
    }
    (device.cable, device.cable_asymmetry) = (Length(0), Nanos::ZERO);
    Ok(())
}

/// All others are behind the first; and who is behind one that is absent, is absent with it.
fn may_be_absent(
    keys: &Keys<'_>,
    device: &SubDevice,
    place: Place,
    earlier: &[SubDevice],
) -> Result<(), FileError> {
    let error = |message: String| Err(keys.error_at("optional", message));
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

fn host(keys: &Keys<'_>, cycle: Nanos) -> Result<Host, FileError> {
    // A short cycle would not leave the usual jitter its place.
    let usual = Nanos::micros(20).min(Nanos(cycle.0 / 10));
    Ok(Host {
        port: keys.choice("port", &keys::HOST_PORTS)?,
        clock: keys.get("clock")?,
        jitter: keys.find("jitter")?.unwrap_or(usual),
        drift_compensation: keys.get("drift_compensation")?,
        drift_filters: DriftFilters {
            difference: keys.find("difference_filter")?,
            speed: keys.find("speed_filter")?,
        },
    })
}

fn read(path: &str) -> Result<String, FileError> {
    limits::read_text(path, limits::TOML)
}

const BUILT_IN: &str = include_str!("../segments/built_in.toml");
