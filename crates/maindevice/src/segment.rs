//! The segment and its SubDevices, as found and planned.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec::Vec;
use core::ops::Range;

use isocat_sync::budget::{self, Budget, Check, Demand, Moments};
use isocat_sync::delay::Delay;
use isocat_sync::object::{self, SyncParameters};
use isocat_sync::{Pulses, SyncMode, SyncType};
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::coe::info::{EntryDescription, ObjectDescription};
use isocat_wire::datagram::Address;
use isocat_wire::dc::{AssignActivate, DifferencePolarity};
use isocat_wire::dl::DlStatus;
use isocat_wire::sii::{self, PdoEntryRecord, PdoRecord, SmRecord};
use isocat_wire::time::{Dc, Nanos, Time};
use isocat_wire::{AbortCode, Command, ObjectAddress, PortNumber, StationAddress};

pub use crate::dc::DcCapability;
use crate::error::{Error, Place};
use crate::service::Substitute;
use crate::times::OwnTimes;

/// All SubDevices behind the MainDevice's port, in processing order.
#[derive(Clone, Debug, Default)]
pub struct Segment {
    /// The SubDevices by position.
    pub devices: Vec<SubDevice>,
    /// Position of the reference clock; `None` without any DC clock.
    pub reference: Option<usize>,
    /// Layout of the process data.
    pub image: ProcessImage,
    /// The timing of one cycle; `None` before it is planned.
    pub timing: Option<Timing>,
    /// Errors of a survey, in the order of its stages; empty otherwise.
    pub problems: Vec<Error>,
}

/// The planned timing of one cycle.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Timing {
    /// Bus cycle, send phase, jitter and clock error of the plan.
    pub cycle: budget::Cycle,
    /// Phase of SYNC0 in the system-time cycle; `None` if no SubDevice uses it.
    pub sync0: Option<Nanos>,
    /// The frames of the fullest cycle, in the order in which they are sent.
    pub frames: Vec<FramePlan>,
    /// Demands and budget of each SubDevice, by position.
    pub devices: Vec<(budget::Device, Budget)>,
}

impl Timing {
    /// The demand of the frames: all frames of the fullest cycle, with the gap after each.
    pub fn frames_in_cycle(&self) -> Demand {
        budget::frames_in_cycle(&self.cycle, self.frames_on_wire())
    }

    /// Wire time of all frames of the fullest cycle, with the gap after each.
    pub fn frames_on_wire(&self) -> Nanos {
        self.frames.last().map_or(Nanos::ZERO, |frame| frame.end + GAP)
    }

    /// One line of a SubDevice with all its figures; `None` if the SubDevice does not have it.
    pub fn demand(&self, position: usize, check: Check) -> Option<Demand> {
        let (device, _) = self.devices.get(position)?;
        budget::demand(&self.cycle, self.sync0.unwrap_or(Nanos::ZERO), device, check)
    }

    /// The times of the events at a SubDevice.
    pub fn moments(&self, position: usize) -> Option<Moments> {
        let (device, _) = self.devices.get(position)?;
        Some(budget::moments(&self.cycle, self.sync0.unwrap_or(Nanos::ZERO), device))
    }
}

/// Least pause between two frames on the wire: 12 byte times.
pub(crate) const GAP: Nanos = Nanos(12 * isocat_wire::frame::BYTE_TIME_NS as i64);

/// One frame of the cycle. Times count from the first bit of the cycle's first frame, in the
/// fullest cycle.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FramePlan {
    /// The frame leaves in the bus cycles whose number by system time is a multiple of this.
    pub every: u32,
    /// How much earlier it is if fewer frames go before it.
    pub spread: Nanos,
    /// First bit of its preamble.
    pub begin: Nanos,
    /// Last bit of its check sequence.
    pub end: Nanos,
    /// Bytes without check sequence, including padding.
    pub length: usize,
    /// Its datagrams.
    pub datagrams: Vec<DatagramPlan>,
}

/// One datagram of a frame of the cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DatagramPlan {
    /// Command.
    pub command: Command,
    /// Address.
    pub address: Address,
    /// Bytes of data.
    pub length: usize,
    /// Byte of the frame at which its header begins.
    pub offset: usize,
    /// The chunk of the process image that it carries.
    pub chunk: Option<usize>,
}

/// One SubDevice.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SubDevice {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Station address given to it, from 0x1001 on.
    pub station: StationAddress,
    /// Name of the configuration, otherwise of its SII, otherwise empty.
    pub name: String,
    /// Registers 0x0000 to 0x0009.
    pub esc: EscInformation,
    /// Its identity, by its SII.
    pub identity: Identity,
    /// Its SII, as far as it is used.
    pub sii: Sii,
    /// Register 0x0110 at the scan.
    pub dl_status: DlStatus,
    /// The port through which frames enter.
    pub entry: PortNumber,
    /// The SubDevice before it and the port there; `None` for the first.
    pub parent: Option<(usize, PortNumber)>,
    /// What its DC unit can do.
    pub dc: DcCapability,
    /// Object 0x1C00: use of each SyncManager.
    pub sm_types: Vec<u8>,
    /// Outputs (SM2, RxPDOs).
    pub outputs: ProcessData,
    /// Inputs (SM3, TxPDOs).
    pub inputs: ProcessData,
    /// Object 0x1C32; `None` if the device has none.
    pub output_sync: Option<SyncObject>,
    /// Object 0x1C33; `None` if the device has none.
    pub input_sync: Option<SyncObject>,
    /// Times that it measured itself during bring-up; `None` without such a measurement.
    pub own_times: Option<OwnTimes>,
    /// Propagation delay from the reference clock, as written to register 0x0928; `None` if it was
    /// neither measured nor written.
    pub delay: Option<Nanos>,
    /// Its delay by the receive times, with the error, or why they do not determine it; `None`
    /// before the first latch.
    pub measured_delay: Option<Delay>,
    /// Spread of the delay over all latches, largest less smallest.
    pub delay_spread: Option<Nanos>,
    /// Number of latches whose times contradicted each other here, or above in such a way that they
    /// do not determine the delay.
    pub delay_latches_left_out: u32,
    /// Offset written to 0x0920.
    pub offset: u64,
    /// Last 0x092C read: local time less received time.
    pub difference: Option<Nanos>,
    /// What the sign of its 0x092C means: as measured when its clock was set, otherwise as in older
    /// register documentations.
    pub difference_polarity: DifferencePolarity,
    /// The chosen mode.
    pub mode: SyncMode,
    /// Why it is not a higher mode, in words; empty if the mode was configured or is the highest.
    pub mode_reason: String,
    /// The object that should have told its modes, where the device's mailbox took no request for
    /// it or gave no answer: that it is in Free Run is then no choice. `None`: it answered, or the
    /// mode was configured.
    pub mode_not_asked: Option<ObjectAddress>,
    /// SYNC unit as programmed and verified; `None` in modes without SYNC.
    pub sync: Option<SyncSetting>,
    /// The SYNC pulses that its mode asks for.
    pub pulses: Pulses,
    /// The values for registers 0x0980 and 0x0981 by
    /// [`DeviceConfig::unit`](crate::DeviceConfig::unit).
    pub unit: Option<AssignActivate>,
    /// Its process data are exchanged in every n-th bus cycle; 1 or more.
    pub every: u32,
    /// Whether it takes part; a lost SubDevice does not until it is re-admitted.
    pub admitted: bool,
    /// Last AL status seen.
    pub al_status: AlStatus,
    /// Last AL status code read.
    pub al_code: AlStatusCode,
    /// Readings that only a survey makes; empty otherwise.
    pub observed: Observed,
    /// Optional services that it answered badly during bring-up, in the order of the requests.
    pub substitutes: Vec<Substitute>,
    /// Why it was left out of a bring-up that continued without it
    /// ([`Config::tolerate`](crate::Config::tolerate)); it is present, in INIT, and takes no part.
    pub left_out: Option<Box<Error>>,
}

/// Readings of an ESC that only a survey makes. `None`: it does not have the register, or did not
/// answer.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Observed {
    /// AL status and code before anything was written to it.
    pub state_before: Option<(AlStatus, AlStatusCode)>,
    /// Register 0x0012: its alias, as the ESC took it from the SII.
    pub alias: Option<u16>,
    /// Register 0x0140: kind of PDI.
    pub pdi: Option<u8>,
    /// Register 0x0151: use of the SYNC/LATCH pins.
    pub sync_latch: Option<u8>,
    /// Speed of its clock when it runs freely.
    pub speed: Option<Speed>,
    /// Registers 0x0930 and 0x0932 when the clocks had converged: bandwidth, and present
    /// correction.
    pub correction: Option<(u16, i16)>,
}

/// Speed of a free-running clock, from two latches of receive times.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Speed {
    /// How much faster than the reference clock, parts per billion.
    pub ppb: i64,
    /// Bound of the error, parts per billion: a tick at either end of either clock.
    pub error_ppb: i64,
    /// Time from one latch to the other, by the reference clock.
    pub window: Nanos,
}

/// Registers 0x0000 to 0x0009 and 0x0141.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EscInformation {
    /// 0x0000.
    pub kind: u8,
    /// 0x0001.
    pub revision: u8,
    /// 0x0002.
    pub build: u16,
    /// 0x0004.
    pub fmmus: u8,
    /// 0x0005.
    pub sync_managers: u8,
    /// 0x0006, KiB.
    pub ram: u8,
    /// 0x0007.
    pub ports: u8,
    /// 0x0008, see [`isocat_wire::register::features`].
    pub features: u16,
    /// 0x0141; bit 0: device emulation.
    pub configuration: u8,
}

impl EscInformation {
    /// Whether AL status mirrors AL control, without firmware that answers.
    pub const fn device_emulation(&self) -> bool {
        self.configuration & 1 != 0
    }
    /// Whether this feature bit of 0x0008 is set.
    pub const fn has(&self, feature: u16) -> bool {
        self.features & feature != 0
    }
}

/// The identity of a SubDevice: SII words 0x08 to 0x0F.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Identity {
    /// Vendor id.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
}

/// The SII, as far as it is used.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Sii {
    /// The first 64 words.
    pub header: sii::Header,
    /// Device name of category general.
    pub name: String,
    /// Order number of category general.
    pub order: String,
    /// CoE details of category general: bit 0 SDO, 1 SDO information, 2 PDO assignment, 3 PDO
    /// configuration, 5 complete access.
    pub coe_details: u8,
    /// Use of each FMMU: 1 outputs, 2 inputs, 3 mailbox status.
    pub fmmus: Vec<u8>,
    /// SyncManagers.
    pub sync_managers: Vec<SmRecord>,
    /// RxPDOs (outputs).
    pub rx_pdos: Vec<SiiPdo>,
    /// TxPDOs (inputs).
    pub tx_pdos: Vec<SiiPdo>,
    /// DC operation modes.
    pub operation_modes: Vec<OperationMode>,
    /// Whether there is a category General.
    pub has_general: bool,
    /// Word of the first SyncManager; `None` without their category.
    pub sync_managers_at: Option<usize>,
    /// Word at which the categories end; 0 if they were not read to their end.
    pub end: usize,
}

/// One PDO of the SII.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SiiPdo {
    /// Word of its head.
    pub word: usize,
    /// Its head.
    pub record: PdoRecord,
    /// Its entries.
    pub entries: Vec<PdoEntryRecord>,
}

/// One DC operation mode of the SII.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct OperationMode {
    /// SYNC0 cycle, ns; 0: by the factor.
    pub cycle_time_0: u32,
    /// SYNC0 shift, ns.
    pub shift_time_0: i32,
    /// SYNC1 shift, ns.
    pub shift_time_1: i32,
    /// SYNC1 cycle factor.
    pub sync1_factor: i16,
    /// Word for 0x0980.
    pub assign_activate: u16,
    /// SYNC0 cycle factor.
    pub sync0_factor: i16,
}

/// Process data of one direction at one SubDevice.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct ProcessData {
    /// The PDOs assigned, with their mappings.
    pub pdos: Vec<Pdo>,
    /// The SyncManager that guards them, the first of several; `None` without process data in this
    /// direction.
    pub sync_manager: Option<u8>,
    /// The first one is a window: see [`Guarded::window`].
    pub window: bool,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes in the process image, including those of further SyncManagers.
    pub length: u16,
    /// First byte in the process image.
    pub logical: u32,
    /// The SyncManagers after the first one, in the order of the process image.
    pub further: Vec<Guarded>,
}

/// The process data that one SyncManager guards.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Guarded {
    /// Its number.
    pub sync_manager: u8,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes.
    pub length: u16,
    /// Number of PDOs in it, in the order of [`ProcessData::pdos`].
    pub pdos: usize,
    /// It is a window: the SyncManager stays off, and an FMMU alone maps the bytes, as a rule
    /// registers (bit 2, "virtual", of its record in the SII).
    pub window: bool,
}

impl Segment {
    /// The delay of a SubDevice; if it has none, that of the next SubDevice upstream that has one.
    pub(crate) fn delay(&self, position: usize) -> Nanos {
        let mut at = Some(position);
        while let Some(position) = at {
            let device = &self.devices[position];
            if let Some(delay) = device.delay {
                return delay;
            }
            at = device.parent.map(|(parent, _)| parent);
        }
        Nanos::ZERO
    }
}

impl ProcessData {
    /// All SyncManagers of the direction, in the order of the process image; none without process
    /// data.
    pub fn guarded(&self) -> impl Iterator<Item = Guarded> + '_ {
        let further: u16 = self.further.iter().map(|guarded| guarded.length).sum();
        let elsewhere: usize = self.further.iter().map(|guarded| guarded.pdos).sum();
        let first = self.sync_manager.map(|sync_manager| Guarded {
            sync_manager,
            start: self.start,
            length: self.length.saturating_sub(further),
            pdos: self.pdos.len().saturating_sub(elsewhere),
            window: self.window,
        });
        first.into_iter().chain(self.further.iter().copied())
    }

    /// The bytes of the first SyncManager that is no window: first byte in the process image, and
    /// how many; `None` if there are none. Windows are read in any state, these only once the
    /// device has filled them.
    pub(crate) fn exchanged(&self) -> Option<(u32, u16)> {
        let mut logical = self.logical;
        for guarded in self.guarded() {
            if !guarded.window && guarded.length > 0 {
                return Some((logical, guarded.length));
            }
            logical += u32::from(guarded.length);
        }
        None
    }

    /// Each SyncManager with the PDOs in it.
    pub fn assigned(&self) -> impl Iterator<Item = (Guarded, &[Pdo])> {
        let mut at = 0;
        self.guarded().map(move |guarded| {
            let from = at;
            at += guarded.pdos;
            (guarded, self.pdos.get(from..at).unwrap_or_default())
        })
    }

    /// Its bytes in the process image.
    pub(crate) fn range(&self) -> Range<usize> {
        let start = self.logical as usize;
        start..start + usize::from(self.length)
    }
}

/// One PDO with what is mapped into it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Pdo {
    /// Index, 0x1600… or 0x1A00….
    pub index: u16,
    /// The entries in the order of their bits.
    pub entries: Vec<PdoEntry>,
}

impl Pdo {
    /// Bits of all entries.
    pub fn bits(&self) -> u32 {
        self.entries.iter().map(|entry| u32::from(entry.bits)).sum()
    }
}

/// One entry of a PDO.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PdoEntry {
    /// Object index; 0 for padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Bits.
    pub bits: u8,
}

/// The process image: which frame carries which process data.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct ProcessImage {
    /// Logical ranges, one for each datagram; no range divides a SubDevice.
    pub chunks: Vec<Chunk>,
    /// Whether LRW may be used; otherwise LWR and LRD are (a SubDevice has feature bit 9 set).
    pub read_write: bool,
}

impl ProcessImage {
    /// The working counters of a chunk, of LRW or LRD and of LWR, by its numbers of SubDevices.
    pub(crate) fn counters(&self, writers: u16, readers: u16) -> [u16; 2] {
        [if self.read_write { 2 * writers + readers } else { readers }, writers]
    }
}

/// One logical range and the working counter of its datagrams.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Chunk {
    /// Its datagrams travel in every n-th bus cycle; 1 or more.
    pub every: u32,
    /// First logical byte.
    pub logical: u32,
    /// Bytes.
    pub length: u16,
    /// Positions `first..end` have their data here, except those between them with another `every`.
    pub first: usize,
    /// The position after the last one.
    pub end: usize,
    /// Number of SubDevices with outputs in it.
    pub writers: u16,
    /// Number of SubDevices with inputs in it.
    pub readers: u16,
}

impl Chunk {
    /// Whether the process data of this SubDevice are here, if it has any.
    pub fn holds(&self, device: &SubDevice) -> bool {
        self.every == device.every && (self.first..self.end).contains(&device.position)
    }
}

/// 0x1C32 or 0x1C33 of one SubDevice, entry by entry.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct SyncObject {
    /// The object's description and its name; `None` if the device gives no SDO information.
    pub description: Option<(ObjectDescription, String)>,
    /// All entries that its description lists, or the known ones that answered.
    pub entries: Vec<SyncEntry>,
    /// The values by meaning.
    pub values: SyncParameters,
}

/// One entry of a sync object.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SyncEntry {
    /// Sub-index.
    pub sub: u8,
    /// Its description and its name; `None` if the device gives no SDO information.
    pub description: Option<(EntryDescription, String)>,
    /// Its bytes, or why they cannot be read.
    pub value: Result<Vec<u8>, AbortCode>,
}

impl SyncEntry {
    /// The value as a number, if it has 1 to 4 bytes.
    pub fn number(&self) -> Option<u32> {
        let bytes = self.value.as_deref().ok()?;
        if bytes.is_empty() || bytes.len() > 4 {
            return None;
        }
        let mut all = [0; 4];
        all[..bytes.len()].copy_from_slice(bytes);
        Some(u32::from_le_bytes(all))
    }
    /// The device's name of the entry, otherwise that of ETG.1020.
    pub fn name(&self) -> &str {
        match &self.description {
            Some((_, name)) if !name.is_empty() => name,
            _ => object::name(self.sub).unwrap_or(""),
        }
    }
}

impl SyncObject {
    /// The entry with this sub-index.
    pub fn entry(&self, sub: u8) -> Option<&SyncEntry> {
        self.entries.iter().find(|entry| entry.sub == sub)
    }
    /// The synchronization type it shows, sub-index 01.
    pub fn sync_type(&self) -> Option<SyncType> {
        self.values.sync_type
    }
}

/// The SYNC unit of one SubDevice as programmed, and what was read back.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SyncSetting {
    /// Register 0x0990 as written: first pulse.
    pub start: Time<Dc>,
    /// Register 0x09A0.
    pub sync0_cycle: Nanos,
    /// Register 0x09A4.
    pub sync1_cycle: Nanos,
    /// Register 0x0981.
    pub activation: u8,
    /// Register 0x0990 read when the pulses ran: next pulse.
    pub next: Time<Dc>,
    /// Register 0x0998 read when the pulses ran: next SYNC1, if it is used.
    pub next_sync1: Option<Time<Dc>>,
}

impl SubDevice {
    /// A SubDevice of which only position and station address are known.
    pub fn new(position: usize, station: StationAddress) -> Self {
        Self {
            position,
            station,
            name: String::new(),
            esc: EscInformation::default(),
            identity: Identity::default(),
            sii: Sii::default(),
            dl_status: DlStatus::default(),
            entry: PortNumber::P0,
            parent: None,
            dc: DcCapability::None,
            sm_types: Vec::new(),
            outputs: ProcessData::default(),
            inputs: ProcessData::default(),
            output_sync: None,
            input_sync: None,
            own_times: None,
            delay: None,
            measured_delay: None,
            delay_spread: None,
            delay_latches_left_out: 0,
            offset: 0,
            difference: None,
            difference_polarity: DifferencePolarity::default(),
            mode: SyncMode::FreeRun,
            pulses: Pulses::default(),
            unit: None,
            every: 1,
            mode_reason: String::new(),
            mode_not_asked: None,
            sync: None,
            admitted: true,
            al_status: AlStatus(0),
            al_code: AlStatusCode::NO_ERROR,
            observed: Observed::default(),
            substitutes: Vec::new(),
            left_out: None,
        }
    }

    /// Whether it has a CoE mailbox.
    pub fn has_coe(&self) -> bool {
        let header = &self.sii.header;
        header.protocols & sii::Header::COE != 0
            && header.receive.length > 0
            && header.send.length > 0
    }

    /// Whether it has an SoE mailbox.
    pub fn has_soe(&self) -> bool {
        self.sii.header.protocols & sii::Header::SOE != 0 && self.has_mailbox()
    }

    /// Whether it has a mailbox of any kind, by the areas in its SII: some devices name no protocol
    /// but need the SyncManagers of their mailbox.
    pub fn has_mailbox(&self) -> bool {
        let header = &self.sii.header;
        header.receive.length > 0 && header.send.length > 0
    }
}

impl SubDevice {
    /// Its name in messages.
    pub fn place(&self) -> Place {
        Place { position: self.position, name: self.name.clone() }
    }
}

/// Station address of a position.
pub(crate) const fn station_of(position: usize) -> StationAddress {
    StationAddress(FIRST_STATION.wrapping_add(position as u16))
}

/// Station address of the first SubDevice.
const FIRST_STATION: u16 = 0x1001;
