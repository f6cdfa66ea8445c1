//! A profile between its file and its finished form: every value is typed and in range, with its
//! place in the file.

use isocat_descriptions::document::Source;
use isocat_descriptions::quantity::Ppb;
use isocat_esc::chip::Chip;
use isocat_maindevice::WatchdogRegisters;
use isocat_sim::Unevenness;
use isocat_subdevice::description::{Behaviour, Mailbox};
use isocat_sync::SupportedTypes;
use isocat_wire::ObjectAddress;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::register;
use isocat_wire::sii::{Header, MailboxArea, SmRecord};
use isocat_wire::time::Nanos;

use super::{ApplicationKind, Deviation, Identity, OpMode, Startup, StartupParameter};

/// A profile as read from its file, with the objects that `dictionary` generates.
#[derive(Clone, Debug)]
pub(super) struct Draft<'a> {
    pub source: Source<'a>,
    pub id: String,
    pub name: String,
    pub vendor: String,
    pub application: ApplicationKind,
    pub identity: Identity,
    pub device_type: u32,
    pub hardware_version: String,
    pub software_version: String,
    pub esc: Esc,
    /// `None`: there is no object dictionary either.
    pub mailbox: Option<Placed<Mailbox>>,
    /// Protocols of the mailbox, word 0x1C of the SII.
    pub protocols: u16,
    /// Modes of a device without mailbox.
    pub modes: Option<Placed<SupportedTypes>>,
    pub outputs: Option<Area>,
    pub inputs: Option<Area>,
    pub objects: Vec<Object>,
    pub op_modes: Vec<OpMode>,
    /// Downloads at start, each with its place in the file.
    pub startup: Vec<Placed<Startup>>,
    /// Parameters of drives that SoE writes at start.
    pub parameters: Vec<StartupParameter>,
    pub times: Times,
    pub behaviour: Placed<Behaviour>,
    /// Whether it states none of its times before it has measured them.
    pub dynamic_times: bool,
    pub assumed: Vec<Assumed>,
    pub deviations: Vec<Deviation>,
    /// The EEPROM of an imported description; that of a profile follows from the rest.
    pub eeprom: Option<Eeprom>,
}

/// The EEPROM of an imported device, as far as it has more than a profile.
#[derive(Clone, Debug)]
pub(super) struct Eeprom {
    /// Words 0 to 6.
    pub configuration: [u8; 14],
    /// Mailboxes in BOOT.
    pub boot: (MailboxArea, MailboxArea),
    /// CoE services, byte 5 of the general category.
    pub coe_details: u8,
    /// Kind of each port, four bits per port.
    pub ports: u16,
    /// Use of each FMMU.
    pub fmmus: Vec<u8>,
    pub sync_managers: Vec<SmRecord>,
    /// Windows of inputs, by SyncManager.
    pub windows: Vec<Window>,
    /// Each OpMode: name, description, record.
    pub op_modes: Vec<(String, String, [u8; 24])>,
    /// Order number: the device type.
    pub order: String,
    /// Least size of the EEPROM in bytes.
    pub size: usize,
}

/// Inputs that an FMMU alone maps, straight from registers. The device's program has no part in
/// them.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// The SyncManager that stands for it and stays off.
    pub sync_manager: u8,
    /// Bytes.
    pub length: u16,
    pub pdos: Vec<Pdo>,
}

/// A value and its byte offset in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed<T> {
    pub at: usize,
    pub value: T,
}

/// `[esc]`.
#[derive(Clone, Debug)]
pub(super) struct Esc {
    pub at: usize,
    pub chip: (&'static str, Chip),
    pub sync_unit: bool,
    pub pulse: Nanos,
    pub alias: u16,
    pub clock_tolerance: Option<Ppb>,
    pub watchdog: WatchdogRegisters,
}

/// `[outputs]` or `[inputs]`: a process data SyncManager and its PDOs.
#[derive(Clone, Debug)]
pub(super) struct Area {
    pub at: usize,
    pub sync_manager: u8,
    pub start: u16,
    pub length: u16,
    pub access: Access,
    pub slots: u8,
    pub default: Vec<Placed<u16>>,
    pub recommended: Vec<Placed<u16>>,
    /// All PDOs that can be assigned, and those of `further`.
    pub pdos: Vec<Pdo>,
    /// SyncManagers after this one, in the order of the process image.
    pub further: Vec<Share>,
}

/// A further process data SyncManager of the same direction. Its PDOs are fixed.
#[derive(Clone, Debug)]
pub(super) struct Share {
    pub at: usize,
    pub sync_manager: u8,
    pub start: u16,
    pub length: u16,
    /// Its PDOs.
    pub pdos: Vec<u16>,
}

impl Share {
    /// Its assignment object: 0x1C10 and the number of its SyncManager.
    pub fn assignment(&self) -> u16 {
        0x1C10 + u16::from(self.sync_manager)
    }
}

impl Area {
    /// Its parts: place in the file, first byte, and bytes of each buffer.
    pub fn places(&self) -> impl Iterator<Item = (usize, u16, u16)> + '_ {
        let further = self.further.iter().map(|share| (share.at, share.start, share.length));
        std::iter::once((self.at, self.start, self.length)).chain(further)
    }

    /// The SyncManager to which a PDO is assigned by default.
    pub fn sync_manager_of(&self, pdo: u16) -> Option<u8> {
        if self.default.iter().any(|assigned| assigned.value == pdo) {
            return Some(self.sync_manager);
        }
        let share = self.further.iter().find(|share| share.pdos.contains(&pdo))?;
        Some(share.sync_manager)
    }
}

/// Number of buffers of a process data SyncManager: three, but one for a single byte, which needs
/// no handshake, and for registers.
pub(super) fn buffers(start: u16, length: u16) -> u32 {
    if length == 1 || start < register::PROCESS_RAM { 1 } else { 3 }
}

/// `[[outputs.pdo]]`.
#[derive(Clone, Debug)]
pub(super) struct Pdo {
    pub at: usize,
    pub index: u16,
    pub name: String,
    pub entries: Vec<PdoEntry>,
}

impl Pdo {
    /// Bits of all entries.
    pub fn bits(&self) -> u32 {
        self.entries.iter().map(|entry| u32::from(entry.bits)).sum()
    }
}

/// A row of a PDO; no object for padding.
#[derive(Clone, Debug)]
pub(super) struct PdoEntry {
    pub at: usize,
    pub object: Option<ObjectAddress>,
    pub data_type: DataType,
    pub bits: u8,
    pub name: String,
}

/// `[[object]]`.
#[derive(Clone, Debug)]
pub(super) struct Object {
    pub at: usize,
    pub index: u16,
    pub name: String,
    pub code: ObjectCode,
    pub data_type: DataType,
    pub entries: Vec<Entry>,
    /// Why the object contradicts itself: its maker has published it that way.
    pub contradiction: Option<String>,
}

/// A row of an object.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub at: usize,
    pub sub: u8,
    pub name: String,
    pub data_type: DataType,
    pub bits: u16,
    pub offset: u32,
    pub access: Access,
    pub default: Vec<u8>,
    /// The value as written in the file.
    pub written: String,
}

/// `[times]`; missing values follow the objects.
#[derive(Clone, Debug)]
pub(super) struct Times {
    pub at: usize,
    pub reaction: Nanos,
    pub calc_and_copy: Option<Nanos>,
    pub application: Nanos,
    pub input_copy: Option<Nanos>,
    pub jitter: Nanos,
    pub acknowledge: Option<Nanos>,
    pub unevenness: Unevenness,
}

impl Draft<'_> {
    /// Whether its objects can be read and written by CoE.
    pub fn speaks_coe(&self) -> bool {
        self.mailbox.is_some() && self.protocols & Header::COE != 0
    }
}

impl Times {
    /// The times of a device without a program.
    pub fn none(at: usize) -> Self {
        Self {
            at,
            reaction: Nanos::ZERO,
            calc_and_copy: Some(Nanos::ZERO),
            application: Nanos::ZERO,
            input_copy: Some(Nanos::ZERO),
            jitter: Nanos::ZERO,
            acknowledge: None,
            unevenness: Unevenness::default(),
        }
    }
}

/// One item of `[[assumed]]`.
#[derive(Clone, Debug)]
pub(super) struct Assumed {
    pub item: Placed<Item>,
    pub why: String,
}

/// The assumed item.
#[derive(Clone, Debug)]
pub(super) enum Item {
    /// Entries of the dictionary, from one sub-index to another, or one property of them.
    Entries { index: u16, first: u8, last: u8, property: Property },
    /// A whole object.
    Object(u16),
    /// A key of the file and its value as written.
    Key(String, String),
}

/// The property of an entry that is assumed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Property {
    /// Its value.
    Value,
    /// Its access rights.
    Access,
    /// Its offset in complete access.
    Offset,
}
