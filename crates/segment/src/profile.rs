//! Device profiles: the complete definition of a virtual SubDevice in one TOML file.
//!
//! A profile contains what a device's maker would state: identity, ESC, mailbox, PDOs, objects with
//! their access and values, and the times of its CPU. [`Profile::from_toml`] processes it in three
//! steps:
//!
//! 1. `parse` (and `rows` for the objects) reads the file into a `draft`, `dictionary` adds the
//!    objects that follow from short fields (0x1000, 0x1008, 0x1018, PDO mapping and assignment,
//!    the objects of a CiA 402 drive);
//! 2. `check` refuses contradictions, with file, line and expected value;
//! 3. the draft gives the [`Description`] for the SubDevice stack and, by `sii`, the EEPROM image
//!    that a MainDevice reads.
//!
//! Every key, with its values and its default, is declared in [`FILE`]. This is the minimum of a
//! file; everything else has a default or follows from it:
//!
//! ```toml
//! id = "minimal"                # what segment files call it
//! name = "Minimal"              # object 0x1008
//! vendor = "Nobody"
//! application = "io"            # or "drive"
//! identity = { vendor_id = 1, product_code = 2, revision = 3, device_type = 0 }
//! esc = { chip = "ET1100", sync_unit = false }
//! times = { reaction = "50us", calc_and_copy = "10us", application = "20us", input_copy = "10us" }
//!
//! [mailbox]
//! receive = { start = 0x1000, length = 128 }
//! send = { start = 0x1080, length = 128 }
//!
//! [outputs]                     # and [inputs] the same way
//! start = 0x1100
//! length = 16                   # most bytes of one of the three buffers
//! access = "ro"                 # of 0x1C12: fixed, or "rw preop"
//! default = [0x1600]            # assigned at power-on; `recommended`: what should be assigned
//!
//! [[outputs.pdo]]
//! index = 0x1600
//! name = "Outputs"
//! entries = [["7000:01", "UNSIGNED16", "Value"], { pad = 8 }]
//!
//! [[object]]                    # any object; a time may be written with its unit
//! index = 0x1C32
//! name = "SM output parameter"
//! entries = [
//!   # sub   type         access  value    name
//!   [0x00, "UNSIGNED8",  "ro",   32,      "Highest sub-index supported"],
//!   [0x01, "UNSIGNED16", "ro",   0,       "Synchronization type"],
//!   [0x04, "UNSIGNED16", "ro",   0x0001,  "Synchronization types supported"],
//!   [0x05, "UNSIGNED32", "ro",   "100us", "Minimum cycle time"],
//!   { gaps = [6, 31], bits = 8 },
//!   [0x20, "BOOLEAN",    "ro tx", 0,      "Sync error", { offset = 480 }],
//! ]
//!
//! [[assumed]]                   # objects or keys whose values are not published
//! what = ["identity.revision", "1C32:05"]
//! why = "not published; ..."
//! ```
//!
//! Complete access has the entries of 0x1C32 and 0x1C33 at the offsets of ETG.1020, and those of
//! other objects one behind the other, unless `offset` states another place. An object in the file
//! replaces the one that would be generated.
//!
//! Short forms. `pdos = [[0x1A00, 32]]` in `[inputs]` or `[outputs]` defines PDOs by their number
//! of bits only. `opmodes = [["DC", "DC SYNC0", 0x0300, 1, 0]]`, before the tables, lists choices
//! as rows of name, description, AssignActivate and the factors of SYNC0 and SYNC1. An object may
//! be like an earlier one of the file (`like = "1C32"`) or in a built-in profile (`like =
//! "beckhoff_el2212:1C32"`); then `without = [0x0A]` leaves sub-indices out, `entries` replaces or
//! adds rows, and `values = { 05 = "1ms" }` sets values alone.
//!
//! Makers' tables do not always conform: `[[deviation]]` with `rule`, `places` and `why` names a
//! rule of `isocat conform` that the device is known to break, and the objects concerned. They may
//! also contain contradictions. If 0x1C32:01 or 0x1C33:01 presets a type that sub-index 04 does not
//! announce, `contradiction = "..."` in the object states that the maker has published it so.
//!
//! A simple device has no `[mailbox]`. Then it has no objects at all, its areas have exactly the
//! `length` of the PDOs in `default`, and `modes = ["sm"]` states its modes, since it has no
//! 0x1C32:04.
//!
//! Values that the maker does not publish are filled in, but never silently: each is listed in
//! [`Profile::assumptions`] with its reason, and reports print it.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use isocat_descriptions::document::section::Words;
use isocat_descriptions::quantity::Ppb;
use isocat_descriptions::start_up::Transition;
use isocat_esc::chip::{Chip, PortKind};
use isocat_maindevice::WatchdogRegisters;
use isocat_sim::{Sampling, Unevenness};
use isocat_subdevice::{Description, Misbehaviours};
use isocat_sync::{SupportedTypes, SyncMode, SyncParameters, interpolation, object};
use isocat_wire::soe::Idn;
use isocat_wire::time::Nanos;
use isocat_wire::{ObjectAddress, PortNumber};

mod check;
mod dictionary;
mod doubt;
mod draft;
mod drive;
mod esi;
mod found;
mod keys;
mod parse;
mod ports;
mod rows;
mod sii;
#[cfg(test)]
mod tests;
mod unknown;
mod write;

pub use doubt::{Doubt, DoubtKind};
pub use esi::{NotSimulated, Obstacle, RunAs, TakenOpMode};
pub use found::{Found, FoundArea, FoundEntry};
pub use isocat_descriptions::document::{FileError, FilePlace, name_hint};
pub use keys::FILE;
pub(crate) use keys::{MODES, PULSE};
pub use ports::port_letters;
pub use write::ProfileText;

/// A device, ready to be simulated and to be compared with a device on a wire.
///
/// Profiles are shared: ten thousand devices of one kind have one profile. Their objects are static
/// data, so that the stack runs without allocation on a microcontroller: those of each profile
/// text, or of each device of a description, are made once and live as long as the program. The
/// changes of a segment file ([`Overrides`]) are stored in the profile by value.
#[derive(Clone, Debug)]
pub struct Profile {
    /// Name in segment files: the file's `id`.
    pub id: String,
    /// Product name, object 0x1008.
    pub name: String,
    /// Vendor name.
    pub vendor: String,
    /// Object 0x1018.
    pub identity: Identity,
    /// Dictionary, mailbox, process data areas and behaviour for the SubDevice stack.
    pub description: Description,
    /// EEPROM image, as long as the EEPROM; unused bytes are 0xFF.
    pub sii: Arc<[u8]>,
    /// Name of its ESC, as in `[esc] chip`; an imported device has its own ports and memory.
    pub chip: &'static str,
    /// The real times of its CPU.
    pub times: CpuTimes,
    /// Its use of process data.
    pub application: ApplicationKind,
    /// Where its samples lie, if it oversamples: in its OpMode each SYNC0 takes one of the inputs,
    /// or gives one of the outputs. A profile file can't tell.
    pub sampling: Option<Sampling>,
    /// PDOs to be assigned: written if 0x1C12 and 0x1C13 are writable, otherwise expected.
    pub assignment: Assignment,
    /// Largest deviation of its oscillator in either direction, if the maker states it; `None`:
    /// [`CLOCK_TOLERANCE`].
    pub clock_tolerance: Option<Ppb>,
    /// Registers of its watchdogs that a MainDevice is to write.
    pub watchdog: WatchdogRegisters,
    /// Synchronization choices as the ESI lists them; the first is the default.
    pub op_modes: Vec<OpMode>,
    /// Downloads at start that the description requests.
    pub startup: Vec<Startup>,
    /// Parameters of its drives that the description writes at start.
    pub parameters: Vec<StartupParameter>,
    /// Parts of a description that were not used unchanged; plans and start-up lists report them.
    pub doubts: Vec<Doubt>,
    /// The letters of its ports in a description ([`DeviceStartUp::physics`]).
    ///
    /// [`DeviceStartUp::physics`]: isocat_descriptions::start_up::DeviceStartUp::physics
    pub physics: Option<String>,
    /// Values that are not published.
    pub assumptions: Vec<Assumption>,
    /// Places where its maker's tables break a rule of `isocat conform`.
    pub deviations: Vec<Deviation>,
    /// Whether it states its times only after it has measured them, so that the needs of its CPU
    /// are not known beforehand.
    pub dynamic_times: bool,
    /// The source of the profile.
    pub origin: Origin,
    /// Whether the file states the time itself, so that it does not follow 0x1C32:06.
    calc_and_copy_given: bool,
    esc: Chip,
}

/// The source of a profile.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Origin {
    /// A profile file.
    Profile,
    /// An ESI file.
    Description,
}

/// A rule of `isocat conform` that a device is known to break.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct Deviation {
    /// The rule. `isocat-conform` knows the rules, and refuses an unknown name.
    pub rule: String,
    /// Place of the name in the file.
    pub at: FilePlace,
    /// Objects and entries concerned, such as "0x1C32:05". Violations elsewhere are not excused.
    pub places: Vec<String>,
    /// The values that its maker publishes instead.
    pub why: String,
}

/// Object 0x1018, and words 0x08 to 0x0F of the SII.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Identity {
    /// Sub-index 1.
    pub vendor_id: u32,
    /// Sub-index 2.
    pub product_code: u32,
    /// Sub-index 3.
    pub revision: u32,
    /// Sub-index 4; 0 for a device without serial number.
    pub serial: u32,
}

/// Times of the device's CPU for the steps of a cycle. The *stated* times are in the dictionary; a
/// device may need more than it states, and that is a fault worth simulating.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CpuTimes {
    /// Time from a request to the main loop's answer: state changes and mailbox.
    pub reaction: Nanos,
    /// Time from the SM2 event to mapped outputs: interrupt latency and the longest copying and
    /// calculating together. 0x1C32:06 should state this figure; by default it does.
    pub calc_and_copy: Nanos,
    /// The application's own work in a cycle.
    pub application: Nanos,
    /// Time from Input Latch until the inputs are in the SM3 buffer. 0x1C33:06 should state this
    /// figure; by default it does.
    pub input_copy: Nanos,
    /// Peak-to-peak spread of the steps that follow a SYNC0 event. The copy time of the outputs is
    /// already the longest one, so nothing is added to it.
    pub jitter: Nanos,
    /// Time from a SYNC pulse until its program acknowledges it (0x098E, 0x098F). It is used only
    /// in acknowledge mode, where [`Profile::pulse`] is zero.
    pub acknowledge: Nanos,
    /// Variation of these times: `latency`, `variation` in percent, `overrun = { one_in, by }`,
    /// `timer_jitter`.
    pub unevenness: Unevenness,
}

/// A device's use of its process data.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum ApplicationKind {
    /// A CiA 402 drive that follows target positions.
    Drive,
    /// The same drive with another layout of process data.
    DriveAt(DriveLayout),
    /// Its inputs show its outputs.
    Io,
}

/// Layout of a drive's process data: the first byte of each object in its direction.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct DriveLayout {
    /// 0x6040, 16 bits.
    pub control: u8,
    /// 0x607A, 32 bits.
    pub target: u8,
    /// 0x6060, 8 bits; without it the mode is cyclic synchronous position.
    pub mode: Option<u8>,
    /// 0x6041, 16 bits.
    pub status: u8,
    /// 0x6064, 32 bits.
    pub position: u8,
    /// 0x6061, 8 bits.
    pub mode_display: Option<u8>,
}

/// PDOs assigned to SM2 and SM3, in order.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Assignment {
    /// Entries of 0x1C12.
    pub outputs: Vec<u16>,
    /// Entries of 0x1C13.
    pub inputs: Vec<u16>,
}

/// A synchronization choice of the ESI (`Dc/OpMode`) and of SII category 60.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct OpMode {
    /// Short name.
    pub name: String,
    /// Description.
    pub description: String,
    /// Low byte for register 0x0980, high byte for 0x0981.
    pub assign_activate: u16,
    /// SYNC0 cycle as a multiple of the bus cycle; 0 for none.
    pub sync0_factor: i16,
    /// SYNC1 cycle as a multiple of the SYNC0 cycle; 0 for none.
    pub sync1_factor: i16,
    /// SYNC0 cycle as a time, 0 to 2^32 - 1 ns; 0: the factor is used.
    pub sync0_cycle: Nanos,
    /// Shift of SYNC0 against the cycle, an i32 of ns.
    pub sync0_shift: Nanos,
    /// Shift of SYNC1 against SYNC0, an i32 of ns.
    pub sync1_shift: Nanos,
}

/// A download in PREOP, before the synchronization is set.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Startup {
    /// Transition of the download: [`Transition::IP`] once PREOP is reached, [`Transition::PS`]
    /// before SAFEOP is requested.
    pub transition: Transition,
    /// The entry.
    pub object: ObjectAddress,
    /// Bytes in wire order.
    pub data: Vec<u8>,
    /// Whether the whole object is written by complete access.
    pub complete_access: bool,
}

impl Startup {
    /// Which part of the interpolation time it writes, 0x60C2:01 or :02, in a byte; `None`: another
    /// object.
    fn interpolation(&self) -> Option<u8> {
        let is_part = self.object.index == object::INTERPOLATION_TIME && !self.complete_access;
        (is_part && self.data.len() == 1)
            .then_some(self.object.sub)
            .filter(|sub| [1, 2].contains(sub))
    }

    /// The bytes of `all` downloads of a device to write at its cycle: those of the description,
    /// except for an interpolation time of which both parts are written.
    pub fn at_cycle(&self, all: &[Self], cycle: Nanos) -> Vec<u8> {
        let interpolation = self.interpolation().filter(|_| Self::interpolate(all.iter()));
        match (interpolation, interpolation::parts(cycle)) {
            (Some(1), Some((units, _))) => vec![units],
            (Some(_), Some((_, index))) => vec![index.cast_unsigned()],
            _ => self.data.clone(),
        }
    }

    /// Whether downloads write an interpolation time, both of its parts: it becomes the cycle.
    pub fn interpolate<'a>(all: impl Iterator<Item = &'a Self>) -> bool {
        let mut parts = all.filter_map(Self::interpolation).collect::<Vec<u8>>();
        parts.sort_unstable();
        parts.dedup();
        parts == [1, 2]
    }
}

/// A parameter of a drive that SoE writes in PREOP.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct StartupParameter {
    /// Transition of the write, as in [`Startup`].
    pub transition: Transition,
    /// Number of the drive in the device, 0 to 7.
    pub drive: u8,
    /// The parameter.
    pub idn: Idn,
    /// The description's bytes in wire order.
    pub data: Vec<u8>,
    /// The description's comment.
    pub comment: String,
}

impl StartupParameter {
    /// Whether it is a cycle time, which a configuration tool replaces: S-0-0001 or S-0-0002, in
    /// us.
    pub fn is_cycle(&self) -> bool {
        matches!(self.idn, Idn::CONTROL_CYCLE | Idn::COMMUNICATION_CYCLE) && self.data.len() == 2
    }

    /// The bytes to write at a bus cycle: those of the description, except for a cycle time in
    /// whole us.
    pub fn at_cycle(&self, cycle: Nanos) -> Vec<u8> {
        let micros = (cycle.0 % 1_000 == 0).then_some(cycle.0 / 1_000);
        match micros.and_then(|micros| u16::try_from(micros).ok()).filter(|_| self.is_cycle()) {
            Some(micros) => micros.to_le_bytes().to_vec(),
            None => self.data.clone(),
        }
    }
}

/// A value that the maker does not publish.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Assumption {
    /// An object (`0x1C32:06`, `0x1C32:0A-0D`, `0x1C33:03 access`) or a key of the file
    /// (`identity.product_code`).
    pub item: String,
    /// The assumed value, as written in the file.
    pub value: String,
    /// The reason for this value.
    pub why: String,
}

/// Changes that a segment file may make to one of its devices.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Overrides {
    /// The stated value of 0x1C32:06.
    pub stated_calc_and_copy: Option<Nanos>,
    /// The stated value of 0x1C32:09.
    pub stated_delay: Option<Nanos>,
    /// [`CpuTimes::calc_and_copy`].
    pub calc_and_copy: Option<Nanos>,
    /// [`CpuTimes::jitter`].
    pub jitter: Option<Nanos>,
    /// [`Profile::pulse`].
    pub pulse: Option<Nanos>,
    /// [`CpuTimes::acknowledge`].
    pub acknowledge: Option<Nanos>,
    /// [`Chip::eeprom_burn_time`].
    pub eeprom_burn_time: Option<Nanos>,
    /// Misbehaviours of the device.
    pub misbehaviour: Misbehaviours,
}

impl Profile {
    /// Bits that a PDO maps by default; `None` if the device has no such mapping object.
    pub fn mapped_bits(&self, pdo: u16) -> Option<u32> {
        let entries = self.description.object(pdo)?.entries.iter().filter(|entry| entry.sub > 0);
        // The lowest byte of a mapped entry is its length in bits.
        let bits = entries.map(|entry| self.description.power_on(entry).first().copied());
        Some(bits.map(|bits| u32::from(bits.unwrap_or(0))).sum())
    }

    /// Reads a profile; `path` names the file in errors. Equal texts give the same profile.
    pub fn from_toml(path: &str, text: &str) -> Result<Arc<Profile>, FileError> {
        static INTERNED: LazyLock<Mutex<HashMap<String, Arc<Profile>>>> =
            LazyLock::new(Mutex::default);
        // A panic in another thread cannot leave the map half changed.
        let known = INTERNED.lock().unwrap_or_else(PoisonError::into_inner).get(text).cloned();
        if let Some(profile) = known {
            return Ok(profile);
        }
        let source = isocat_descriptions::document::Source { path, text };
        let mut draft = parse::parse(source)?;
        dictionary::complete(&mut draft);
        check::check(&draft)?;
        if draft.application == ApplicationKind::Drive {
            draft.application = drive::of_profile(&draft.outputs, &draft.inputs);
        }
        let profile = draft.finish()?;
        let mut interned = INTERNED.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(interned.entry(text.to_owned()).or_insert_with(|| Arc::new(profile)).clone())
    }

    /// This device with other times. The error is the entry that would state one of them but does
    /// not exist. Without overrides the result is the same profile.
    pub fn with(self: &Arc<Self>, overrides: Overrides) -> Result<Arc<Profile>, ObjectAddress> {
        if overrides == Overrides::default() {
            return Ok(self.clone());
        }
        let mut profile = Self::clone(self);
        for (sub, stated) in [
            (object::sub::CALC_AND_COPY_TIME, overrides.stated_calc_and_copy),
            (object::sub::DELAY_TIME, overrides.stated_delay),
        ] {
            let Some(time) = stated else { continue };
            let entry = ObjectAddress::new(object::OUTPUT_PARAMETER, sub);
            dictionary::preset(&mut profile.description, entry, time).ok_or(entry)?;
            profile.assumptions.retain(|assumption| assumption.item != entry.to_string());
        }
        if let Some(stated) = overrides.stated_calc_and_copy
            && !self.calc_and_copy_given
        {
            profile.times.calc_and_copy = stated;
        }
        if let Some(needed) = overrides.calc_and_copy {
            profile.times.calc_and_copy = needed;
        }
        if let Some(jitter) = overrides.jitter {
            profile.times.jitter = jitter;
        }
        if let Some(pulse) = overrides.pulse {
            profile.sii = sii::with_pulse(&profile.sii, pulse).into();
        }
        if let Some(acknowledge) = overrides.acknowledge {
            profile.times.acknowledge = acknowledge;
            profile.assumptions.retain(|assumption| assumption.item != "times.acknowledge");
        }
        if let Some(eeprom_burn_time) = overrides.eeprom_burn_time {
            profile.esc.eeprom_burn_time = eeprom_burn_time;
        }
        if overrides.misbehaviour != Misbehaviours::NONE {
            profile.description.behaviour.misbehaviour = overrides.misbehaviour;
        }
        Ok(Arc::new(profile))
    }

    /// This device with these bytes in its EEPROM. Any length is allowed; half a word at the end is
    /// filled up with 0xFF. The device's identity in the EEPROM is not checked.
    pub fn with_sii(self: &Arc<Self>, image: &[u8]) -> Arc<Profile> {
        let mut sii = image.to_vec();
        sii.resize(sii.len().next_multiple_of(2), 0xFF);
        Arc::new(Profile { sii: sii.into(), ..Self::clone(self) })
    }

    /// This device with another ESC of the same kind.
    pub(crate) fn with_chip(self: &Arc<Self>, chip: Chip) -> Arc<Profile> {
        match chip == self.esc {
            true => self.clone(),
            false => Arc::new(Profile { esc: chip, ..Self::clone(self) }),
        }
    }

    /// Length of its SYNC pulses, 0 to 655.35 us: word 2 of the EEPROM, and register 0x0982. Zero
    /// is acknowledge mode: the signal stays active until the device's program has read 0x098E or
    /// 0x098F.
    pub fn pulse(&self) -> Nanos {
        sii::pulse(&self.sii)
    }

    /// Whether the EEPROM switches the SYNC unit of its ESC on.
    pub(crate) fn has_sync_unit(&self) -> bool {
        sii::has_sync_unit(&self.sii)
    }

    /// The ESC named by [`Profile::chip`].
    pub fn esc(&self) -> &Chip {
        &self.esc
    }

    /// Whether its port 0, which leads upstream, is EBUS, as in a terminal.
    pub fn is_on_ebus(&self) -> bool {
        self.esc.port(PortNumber::P0) == PortKind::Ebus
    }

    /// The default value of an entry as an unsigned number; `None` if the entry does not exist or
    /// is longer than 64 bits.
    pub fn value(&self, entry: ObjectAddress) -> Option<u64> {
        let object = self.description.objects.iter().find(|object| object.index == entry.index)?;
        let entry = object.entries.iter().find(|candidate| candidate.sub == entry.sub)?;
        if entry.len() > 8 {
            return None;
        }
        let mut bytes = [0; 8];
        let value = self.description.power_on(entry);
        bytes[..value.len()].copy_from_slice(value);
        Some(u64::from_le_bytes(bytes))
    }

    /// The values of 0x1C32 or 0x1C33 at power-on; `None` if the device does not have the object.
    pub fn sync_parameters(&self, index: u16) -> Option<SyncParameters> {
        let object = self.description.objects.iter().find(|object| object.index == index)?;
        let mut parameters = SyncParameters::default();
        for entry in object.entries {
            if entry.data_type != isocat_wire::coe::DataType::GAP
                && let Some(value) = self.value(ObjectAddress::new(index, entry.sub))
            {
                parameters.set(entry.sub, value as u32);
            }
        }
        Some(parameters)
    }

    /// The announcement of 0x1C32:04, or of 0x1C33:04 for a device without outputs; Free Run for a
    /// device that has neither. For a device without mailbox it comes from the file.
    pub fn supported_types(&self) -> SupportedTypes {
        [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER]
            .into_iter()
            .find_map(|index| self.sync_parameters(index)?.supported)
            .unwrap_or(match self.has_mailbox() {
                true => SupportedTypes(1),
                false => self.description.behaviour.undeclared_types,
            })
    }

    /// Whether the device states its synchronization modes.
    pub(crate) fn states_modes(&self) -> bool {
        let of = |index| self.sync_parameters(index).and_then(|object| object.supported);
        let stated = [object::OUTPUT_PARAMETER, object::INPUT_PARAMETER].into_iter().filter_map(of);
        !self.has_mailbox() || stated.into_iter().next().is_some()
    }

    /// Whether SYNC0 takes samples of its inputs.
    pub(crate) fn samples_inputs(&self) -> bool {
        self.sampling.as_ref().is_some_and(|sampling| !sampling.inputs.is_empty())
    }

    /// Whether the device has a mailbox to read objects. Otherwise this profile and its SII are all
    /// that can be known about it.
    pub fn has_mailbox(&self) -> bool {
        self.description.mailbox.is_some()
    }

    /// The synchronization modes that the device announces.
    pub fn modes(&self) -> impl Iterator<Item = SyncMode> {
        let types = self.supported_types();
        SyncMode::ALL.into_iter().filter(move |mode| mode.is_supported(types))
    }

    /// The mode in which it runs by default.
    pub(crate) fn preferred_mode(&self) -> Option<SyncMode> {
        let types = self.supported_types();
        SyncMode::PREFERRED.into_iter().find(|mode| mode.is_supported(types))
    }
}

/// The built-in profile with this id.
pub fn built_in(id: &str) -> Option<Arc<Profile>> {
    let (name, text) = BUILT_IN.iter().find(|(name, _)| *name == id)?;
    let profile = Profile::from_toml(&format!("built-in profile {name}"), text);
    Some(profile.unwrap_or_else(|error| panic!("a test reads every built-in profile: {error}")))
}

/// The ids of all built-in profiles.
pub fn built_in_ids() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// The ids of all built-in profiles, for the declaration of a key.
pub(crate) struct BuiltInIds;

impl Words for BuiltInIds {
    fn words(&self) -> Vec<(&'static str, &'static str)> {
        built_in_ids().map(|id| (id, "")).collect()
    }
}

/// The text of a built-in profile, as a start for a new one.
pub fn built_in_text(id: &str) -> Option<&'static str> {
    BUILT_IN.iter().find(|(name, _)| *name == id).map(|(_, text)| *text)
}

/// Largest deviation of a SubDevice's oscillator in either direction, if neither its maker nor the
/// segment file states it. Terminals and drives commonly have crystals of +-25 ppm. The standard
/// allows 100 ppm.
pub const CLOCK_TOLERANCE: Ppb = Ppb::ppm(25);

/// The best known ones first, then by name; our own devices last.
const BUILT_IN: [(&str, &str); 35] = [
    ("kollmorgen_akd2g", include_str!("../profiles/kollmorgen_akd2g.toml")),
    ("beckhoff_el2502-0010", include_str!("../profiles/beckhoff_el2502-0010.toml")),
    ("hpmicro_ecat_cia402_ssc", include_str!("../profiles/hpmicro_ecat_cia402_ssc.toml")),
    ("beckhoff_ax8640", include_str!("../profiles/beckhoff_ax8640.toml")),
    ("beckhoff_ej3108", include_str!("../profiles/beckhoff_ej3108.toml")),
    ("beckhoff_ej6224", include_str!("../profiles/beckhoff_ej6224.toml")),
    ("beckhoff_ej7047", include_str!("../profiles/beckhoff_ej7047.toml")),
    ("beckhoff_ek1100", include_str!("../profiles/beckhoff_ek1100.toml")),
    ("beckhoff_ek1110", include_str!("../profiles/beckhoff_ek1110.toml")),
    ("beckhoff_el1258", include_str!("../profiles/beckhoff_el1258.toml")),
    ("beckhoff_el2212", include_str!("../profiles/beckhoff_el2212.toml")),
    ("beckhoff_el3632", include_str!("../profiles/beckhoff_el3632.toml")),
    ("beckhoff_el6692", include_str!("../profiles/beckhoff_el6692.toml")),
    ("beckhoff_el6731", include_str!("../profiles/beckhoff_el6731.toml")),
    ("beckhoff_elm3704-0000", include_str!("../profiles/beckhoff_elm3704-0000.toml")),
    ("beckhoff_ep2316-0003", include_str!("../profiles/beckhoff_ep2316-0003.toml")),
    ("beckhoff_ep4374-0002", include_str!("../profiles/beckhoff_ep4374-0002.toml")),
    ("beckhoff_ep6224-2022", include_str!("../profiles/beckhoff_ep6224-2022.toml")),
    ("beckhoff_ep9214-0023", include_str!("../profiles/beckhoff_ep9214-0023.toml")),
    ("beckhoff_epp2316-0003", include_str!("../profiles/beckhoff_epp2316-0003.toml")),
    ("beckhoff_er3174-0002", include_str!("../profiles/beckhoff_er3174-0002.toml")),
    ("festo_cpx-ap-i-ec-m12", include_str!("../profiles/festo_cpx-ap-i-ec-m12.toml")),
    ("infineon_xmc4300_ssc", include_str!("../profiles/infineon_xmc4300_ssc.toml")),
    ("microchip_samd51_lan9252_ssc", include_str!("../profiles/microchip_samd51_lan9252_ssc.toml")),
    ("microepsilon_ims5400", include_str!("../profiles/microepsilon_ims5400.toml")),
    ("mks_392", include_str!("../profiles/mks_392.toml")),
    ("nanotec_np5", include_str!("../profiles/nanotec_np5.toml")),
    ("rtlabs_soes_xmc4_dynpdo", include_str!("../profiles/rtlabs_soes_xmc4_dynpdo.toml")),
    ("synapticon_somanet_cia402", include_str!("../profiles/synapticon_somanet_cia402.toml")),
    ("vipa_im053-1ec01", include_str!("../profiles/vipa_im053-1ec01.toml")),
    ("weidmueller_ur20-fbc-ec", include_str!("../profiles/weidmueller_ur20-fbc-ec.toml")),
    ("yaskawa_sgd7s-a0", include_str!("../profiles/yaskawa_sgd7s-a0.toml")),
    ("simple_io16", include_str!("../profiles/simple_io16.toml")),
    ("simple_io4", include_str!("../profiles/simple_io4.toml")),
    ("model_every_mode", include_str!("../profiles/model_every_mode.toml")),
];
