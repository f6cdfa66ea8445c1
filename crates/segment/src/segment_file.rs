//! Segment files: the devices on the wire, their synchronization, and the duration.
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
//! Any device of an ESI file can be part of a segment:
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
//! Connected ports must be of one kind: MII (copper) to MII, EBUS to EBUS, with a coupler between
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
//! A device without `clock` gets a deviation that the seed draws: see [`Clock`].
//!
//! With `count = 50` a table stands for fifty equal devices in a line. Every key is declared in
//! [`FILE`].
//!
//! Every mistake is a [`FileError`] with file, line and column, the expected value and the nearest
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
use crate::profile::{Doubt, Profile, TakenOpMode};

mod another_cycle;
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

pub use another_cycle::Asked;
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

/// A checked segment: every device exists, and every number is in range. Ranges and defaults are
/// declared with the keys in [`FILE`].
#[derive(Clone, Debug)]
pub struct SegmentFile {
    /// The name of the file in errors.
    pub path: String,
    /// Bus cycle. Key `cycle`.
    pub cycle: Nanos,
    /// Time to run once the segment is in operation. Key `for`.
    pub duration: Nanos,
    /// Seed of all randomness in the simulation. Key `seed`.
    pub seed: u64,
    /// The law of all drift loops. Keys `drift_law` and `drift_phase`; `None`: each chip's own.
    pub drift_law: Option<DriftLaw>,
    /// Largest SYNC0 error that counts as synchronized. Key `sync0_limit`.
    pub sync0_limit: Nanos,
    /// Largest spread of outputs after their pulse that counts as synchronized. Key
    /// `outputs_spread`.
    pub outputs_spread: Nanos,
    /// Requested phase of SYNC0 after the start of the cycle. Key `shift`; `None`: the plan
    /// chooses.
    pub shift: Option<Nanos>,
    /// Watchdog of the process data, register 0x0420. Key `watchdog`; `None`: the chips' default,
    /// 100 ms.
    pub watchdog: Option<Nanos>,
    /// Whether whatever a MainDevice makes of the segment is meant, so that the file makes no
    /// claims. Key `as_is`.
    pub as_is: bool,
    /// Whether the delay of a hop varies from frame to frame. Key `hop_jitter`.
    pub hop_jitter: bool,
    /// Activities of the MainDevice besides the exchange while the segment runs.
    pub operation: Operation,
    /// The cable that closes a ring. Key `ring`; `None`: the segment hangs on one port.
    pub ring: Option<Ring>,
    /// Faults. Tables `[[fault]]`.
    pub faults: Faults,
    /// Values that the MainDevice's application writes at given times. Tables `[[output]]`.
    pub outputs: Vec<Output>,
    /// The machines behind devices. Tables `[[plant]]`.
    pub plants: Vec<PlantSetup>,
    /// Expectations of a run. Tables `[[expect]]`.
    pub expectations: Vec<Expectation>,
    /// The machine of the MainDevice.
    pub host: Host,
    /// The devices in the order of their positions, which is that of frame processing.
    pub subdevices: Vec<SubDevice>,
}

/// `[host]`: the machine of the MainDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Host {
    /// The port for the first device. Key `port`.
    pub port: PortKind,
    /// Frequency deviation of its clock. Key `clock`.
    pub clock: Ppb,
    /// Peak-to-peak lateness of its wake-ups. Key `jitter`.
    pub jitter: Nanos,
    /// Whether drift compensation synchronizes the clocks. Key `drift_compensation`. Without it a
    /// simulation shows how clocks drift apart.
    pub drift_compensation: bool,
    /// Filter depths of the drift loops. Keys `difference_filter` and `speed_filter`.
    pub drift_filters: DriftFilters,
}

/// `[[subdevice]]`: one device.
#[derive(Clone, Debug)]
pub struct SubDevice {
    /// Its name in reports. Key `name`; default: the device's id and its place in the file from 0.
    /// `count = N` stands for N equal devices in a line; the name of each then ends in its number
    /// among them, from 0.
    pub name: String,
    /// The device, including the changes of the file. Keys `device`, or `esi`, `type`, `product`,
    /// `revision` and `opmode`; `calc_copy` (stated in 0x1C32:06), `copy_time` (really needed by
    /// its CPU), `delay` (stated in 0x1C32:09), `jitter` (of its CPU), `pulse` and `acknowledge`
    /// (end of its SYNC pulses), `eeprom_burn` (write time of its EEPROM), `misbehave`
    /// (misbehaviours by name).
    pub profile: Arc<Profile>,
    /// Its mode. Key `mode`; `None` for the best that the device and the cycle allow.
    pub mode: Option<SyncMode>,
    /// Its place in the tree. Keys `connect` and `port`.
    pub place: Place,
    /// Cable that leads to it. Key `cable`.
    pub cable: Length,
    /// Whether that is an optical fibre. Key `fibre`.
    pub fibre: bool,
    /// Signal delay of that cable. Key `cable_delay`.
    pub cable_delay: DelayPerMetre,
    /// Difference of the delays out and back on that cable; their mean stays. Key
    /// `cable_asymmetry`.
    pub cable_asymmetry: Nanos,
    /// Constant frequency deviation of its clock. Key `clock`, and `clocks` of the file.
    pub clock: Clock,
    /// Changes of that deviation while the segment runs. Keys `clock_ramp`, `clock_step`,
    /// `clock_walk`. Its constant part is [`SubDevice::clock`].
    pub clock_shape: ClockModel,
    /// Its own cycle, for a device slower than the bus: SYNC0 and the exchange of process data
    /// happen once in it. Key `cycle`; `None`: the bus cycle.
    pub cycle: Option<Nanos>,
    /// Requested shift of its Outputs Valid, 0x1C32:03. Key `shift`; `None` leaves the device's
    /// own.
    pub shift: Option<Nanos>,
    /// Requested shift of its Input Latch, 0x1C33:03. Key `input_shift`; `None` leaves the device's
    /// own.
    pub input_shift: Option<Nanos>,
    /// Time from SYNC0 to SYNC1, for the modes "dc-shift-sync1" and "dc-sync1". Key `sync1`;
    /// `None`: a quarter of the cycle, and for "dc-sync1" the time that the device needs.
    pub sync1: Option<Nanos>,
    /// Cycle of SYNC0, for the mode "dc-subordinated". Key `sync0_cycle`; `None`: the value of
    /// 0x1C32:0A.
    pub sync0_cycle: Option<Nanos>,
    /// The OpMode of its description. Key `opmode`, or the one that suits; `None` for a device
    /// without.
    pub op_mode: Option<TakenOpMode>,
    /// Values for its registers 0x0980 and 0x0981, from its OpMode; `None` without.
    pub unit: Option<AssignActivate>,
    /// Times from an earlier measurement by the device. Table `measured_times`.
    pub measured: MeasuredTimes,
    /// Whether it may be absent, and may come while the segment runs (hot connect). Key `optional`.
    pub optional: bool,
    /// Power-on time of an optional device, from the start of the simulation. Key `arrives`.
    pub arrives: Nanos,
    /// Doubts about a device from an ESI file: `name: words`.
    pub notes: Vec<Doubt>,
    /// Its keys that stand for themselves, whatever its OpMode says.
    pub asked: Asked,
    /// First line of its table in the file, for messages.
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

    /// The same with given profiles: the key `device` finds them by their ids, before built-in ones
    /// and files.
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
        let as_is = root.get("as_is")?;
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
            as_is,
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

    /// The segment of `isocat run` without a file.
    pub fn built_in() -> Self {
        Self::parse(Self::BUILT_IN_NAME, BUILT_IN)
            .unwrap_or_else(|error| panic!("a test reads the built-in segment: {error}"))
    }

    /// Its text, as a start for a new file.
    pub const fn built_in_text() -> &'static str {
        BUILT_IN
    }
}

/// Counts lines incrementally, so that all devices together cost one pass over the file.
struct Lines<'a> {
    text: &'a str,
    /// The offset up to which lines were counted, and the line there, from 1.
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
    /// No devices, on a MainDevice with this port.
    fn on(port: PortKind) -> Self {
        Self { subdevices: Vec::new(), ports: tree::Ports::of(port), names: HashMap::new() }
    }

    /// Adds the devices of a table: one, or `count` equal ones in a line.
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
            // Only the first device uses the key.
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

/// EBUS ports meet by contacts: the delay between two terminals is part of that of their ESCs.
fn without_cable(keys: &Keys<'_>, device: &mut SubDevice) -> Result<(), FileError> {
    for key in ["cable", "fibre", "cable_delay", "cable_asymmetry"] {
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

/// Whether a device may be absent. The first one must be present, since all others are behind it;
/// devices behind an absent one are absent, too.
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
    // A short cycle has no time for the usual jitter.
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
