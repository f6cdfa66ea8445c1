//! One device in the document.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

use crate::measured::Grid;
use crate::report::{FrameRef, Shown};

/// What the capture shows of one device. Null or empty: the capture does not show it.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceReport {
    /// Its position in the segment, from 0.
    pub position: Option<u16>,
    /// Its station address.
    pub station: Option<Shown<u16>>,
    /// Its name: from the segment file, from a description with this identity, or from its EEPROM.
    pub name: Option<String>,
    /// Its identity, from its EEPROM.
    pub identity: Identity,
    /// Its ESC, from registers 0x0000 to 0x0008.
    pub esc: Esc,
    /// DL status (0x0110): links and loops of its ports.
    pub dl_status: Option<Shown<u16>>,
    /// The last status that was read.
    pub state: Option<String>,
    /// The status at each change that was read; up to 256.
    pub states: Vec<StateReport>,
    /// Each time it stopped answering; up to 64.
    pub silences: Vec<SilenceReport>,
    /// SyncManagers that were written or read and are not all zero.
    pub sync_managers: Vec<SyncManagerReport>,
    /// FMMUs that are active.
    pub fmmus: Vec<FmmuReport>,
    /// The process data watchdog, ns; 0x0400 and 0x0420.
    pub watchdog_ns: Option<u64>,
    /// Its mailbox traffic; null: none.
    pub mailbox: Option<MailboxReport>,
    /// System time offset (0x0920), ns, modulo 2^64.
    pub offset_ns: Option<Shown<u64>>,
    /// Propagation delay (0x0928), ns.
    pub delay_ns: Option<Shown<u32>>,
    /// Speed counter start (0x0930) of its drift loop.
    pub speed_counter_start: Option<Shown<u16>>,
    /// Filter depths (0x0934, 0x0935) of its drift loop.
    pub filter_depths: Option<Shown<[u8; 2]>>,
    /// Number of readings of the system time difference (0x092C).
    pub differences: u64,
    /// The last difference, ns, without its sign: what the sign means depends on the chip.
    pub difference_ns: Option<Shown<u32>>,
    /// The largest difference in operation.
    pub worst_difference_ns: Option<Shown<u32>>,
    /// Each time its SYNC unit was switched; up to 64.
    pub sync: Vec<SyncSwitch>,
    /// How often 0x0984 or 0x0990 was read after SYNC was last switched on.
    pub sync_looked_at: u64,
    /// From cyclic frames to its SYNC0; null: not known.
    pub distance: Option<Distance>,
    /// Frames that read error counters.
    pub error_readings: u64,
    /// Error counters that are not zero.
    pub errors: Vec<ErrorCounter>,
    /// The last frame that addressed it alone.
    pub last: FrameRef,
}

/// The identity of a device.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Identity {
    /// Vendor id.
    pub vendor: Option<Shown<u32>>,
    /// Product code.
    pub product: Option<Shown<u32>>,
    /// Revision.
    pub revision: Option<Shown<u32>>,
    /// Serial number.
    pub serial: Option<Shown<u32>>,
    /// Words of the EEPROM that the capture shows.
    pub words: usize,
}

/// The EtherCAT SubDevice Controller.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Esc {
    /// Type (0x0000).
    pub kind: Option<Shown<u8>>,
    /// Name of the type, if it is known.
    pub name: Option<&'static str>,
    /// Revision (0x0001).
    pub revision: Option<Shown<u8>>,
    /// Number of FMMUs (0x0004).
    pub fmmus: Option<Shown<u8>>,
    /// Number of SyncManagers (0x0005).
    pub sync_managers: Option<Shown<u8>>,
    /// RAM size (0x0006), KiB.
    pub ram: Option<Shown<u8>>,
    /// It has a DC unit (0x0008 bit 2).
    pub dc: Option<bool>,
    /// Its system time has 64 bits (0x0008 bit 3).
    pub dc_64_bit: Option<bool>,
}

/// A time in which a device no longer answered.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SilenceReport {
    /// The first frame without its answer.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
    /// When it answered again, ns from the first frame of EtherCAT; null: it did not.
    pub until_ns: Option<u64>,
}

/// A status of a device.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct StateReport {
    /// AL status, as in `SAFEOP+ERR`. A device without a CPU copies the acknowledge bit of the
    /// request to the place of the error bit: that is no error.
    pub status: String,
    /// Whether it shows an error.
    pub error: bool,
    /// AL status as it was read.
    pub raw: u16,
    /// AL status code, if it was read while this status held.
    pub code: Option<u16>,
    /// The last state that was requested; null: none in this capture.
    pub asked: Option<String>,
    /// The first frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
}

/// A SyncManager.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SyncManagerReport {
    /// Number, from 0.
    pub number: usize,
    /// First address.
    pub start: u16,
    /// Number of bytes.
    pub length: u16,
    /// Control byte.
    pub control: u8,
    /// Whether it is enabled.
    pub enabled: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// A FMMU.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct FmmuReport {
    /// Number, from 0.
    pub number: usize,
    /// First logical address.
    pub logical: u32,
    /// Number of bits.
    pub bits: u32,
    /// First address of the device's memory.
    pub physical: u16,
    /// The MainDevice reads through it.
    pub reads: bool,
    /// The MainDevice writes through it.
    pub writes: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// The traffic of a mailbox.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct MailboxReport {
    /// Number of messages to the device and from it.
    pub messages: [u64; 2],
    /// SDO transfers that the device answered without an abort.
    pub transfers: u64,
    /// The SDO answer that took longest, from the request to the frame that fetched it.
    pub slowest: Option<SlowestAnswer>,
    /// SDO transfers that it aborted.
    pub aborts: Vec<Aborts>,
    /// Entries of 0x1C32 and 0x1C33 as they were last written or read.
    pub sync_objects: Vec<ObjectValue>,
    /// No frame shows where the mailboxes are: messages were recognized by their content.
    pub by_content: bool,
}

/// An SDO transfer and how long its answer took.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SlowestAnswer {
    /// The object, as `0x1C32:01`.
    pub object: String,
    /// From the request to the frame that fetched the answer, ns.
    pub took_ns: u64,
    /// The request.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// SDO transfers of one object that the device aborted with one code.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Aborts {
    /// The object, as `0x1C32:01`.
    pub object: String,
    /// Abort code.
    pub code: u32,
    /// Number of transfers.
    pub count: usize,
    /// The first of them.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// An entry of 0x1C32 or 0x1C33.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ObjectValue {
    /// As `0x1C32:01`.
    pub object: String,
    /// Its index.
    pub index: u16,
    /// Its sub-index.
    pub sub: u8,
    /// Its name.
    pub name: Option<&'static str>,
    /// Its value; times are in ns.
    pub value: u64,
    /// The MainDevice wrote it; false: the device sent it.
    pub written: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// One time that a SYNC unit was switched.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SyncSwitch {
    /// 0x0980 and 0x0981 as a word (AssignActivate).
    pub assign_activate: u16,
    /// Meaning of its bits.
    pub words: Vec<&'static str>,
    /// SYNC0 cycle (0x09A0), ns.
    pub sync0_cycle_ns: Option<Shown<u32>>,
    /// SYNC1 cycle (0x09A4), ns.
    pub sync1_cycle_ns: Option<Shown<u32>>,
    /// Start time (0x0990), ns of system time; of a 32-bit one, only the bits that were written.
    pub start_ns: Option<Shown<u64>>,
    /// Bytes of the start time that were written, 4 or 8.
    pub start_bytes: Option<u8>,
    /// The start time minus the reference's time as it was last seen before, ns; negative: the
    /// start time was in the past.
    pub ahead_ns: Option<i64>,
    /// The frame that switched it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
}

/// From the end of cyclic frames at a device to its SYNC0, in the time of the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Distance {
    /// Frames that were measured.
    pub frames: u64,
    /// From one SYNC0 to the next, ns.
    pub cycle_ns: u64,
    /// The shortest distance, ns; negative: after the SYNC0 that usually follows.
    pub shortest_ns: Shown<i64>,
    /// The mean, ns.
    pub mean_ns: i64,
    /// The longest, ns.
    pub longest_ns: Shown<i64>,
    /// The instants of its SYNC0, which identify its values among those that an onlooker receives.
    #[serde(skip)]
    pub grid: Grid,
    /// How much later a frame arrives here than at the reference (0x0928), ns.
    pub delay_ns: i64,
    /// How inaccurate these figures are, ns, where frames have no drift datagram, so that stamps
    /// of the capture have a share in them; else 0.
    pub within_ns: i64,
    /// Frames drift through the cycle: the MainDevice does not follow the reference clock.
    pub slides: bool,
}

/// An error counter.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ErrorCounter {
    /// Its register.
    pub address: u16,
    /// What it counts.
    pub name: Option<&'static str>,
    /// Its port; null: the counter belongs to the device.
    pub port: Option<u16>,
    /// The value that was last read, or 0 if it was cleared since.
    pub value: u8,
    /// The frame that read or cleared it.
    #[serde(flatten)]
    pub frame: FrameRef,
}
