//! One device in the document.

use schemars::JsonSchema;
use serde::Serialize;

use crate::measured::Grid;
use crate::report::{FrameRef, Shown};

/// What the capture shows of one device. What is null or empty it does not show.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct DeviceReport {
    /// Its position in the segment, from 0.
    pub position: Option<u16>,
    /// Its station address.
    pub station: Option<Shown<u16>>,
    /// Its name: of the segment file, of a description with this identity, or of its EEPROM.
    pub name: Option<String>,
    /// Out of its EEPROM.
    pub identity: Identity,
    /// Out of registers 0x0000 to 0x0008.
    pub esc: Esc,
    /// DL status (0x0110): links and loops of its ports.
    pub dl_status: Option<Shown<u16>>,
    /// The last status that was read.
    pub state: Option<String>,
    /// Each status that was read and differs from the one before; up to 256.
    pub states: Vec<StateReport>,
    /// Each time it ceased to answer; up to 64.
    pub silences: Vec<SilenceReport>,
    /// SyncManagers that were written or read and are not all zero.
    pub sync_managers: Vec<SyncManagerReport>,
    /// FMMUs that map anything.
    pub fmmus: Vec<FmmuReport>,
    /// The process data watchdog, ns; 0x0400 and 0x0420.
    pub watchdog_ns: Option<u64>,
    /// What went through its mailbox; null: nothing.
    pub mailbox: Option<MailboxReport>,
    /// System time offset (0x0920), ns, modulo 2^64.
    pub offset_ns: Option<Shown<u64>>,
    /// Propagation delay (0x0928), ns.
    pub delay_ns: Option<Shown<u32>>,
    /// Speed counter start (0x0930) of its drift loop.
    pub speed_counter_start: Option<Shown<u16>>,
    /// Filter depths (0x0934, 0x0935) of its drift loop.
    pub filter_depths: Option<Shown<[u8; 2]>>,
    /// Readings of 0x092C.
    pub differences: u64,
    /// The last of them, ns, without its sign: what the sign means depends on the chip.
    pub difference_ns: Option<Shown<u32>>,
    /// The largest of them in operation.
    pub worst_difference_ns: Option<Shown<u32>>,
    /// Each time its SYNC unit was switched; up to 64.
    pub sync: Vec<SyncSwitch>,
    /// How often 0x0984 or 0x0990 was read after SYNC was last switched on.
    pub sync_looked_at: u64,
    /// From cyclic frames to SYNC0; null: not known.
    pub distance: Option<Distance>,
    /// Frames that read error counters.
    pub error_readings: u64,
    /// Error counters that are not zero.
    pub errors: Vec<ErrorCounter>,
    /// The last frame that addressed it alone.
    pub last: FrameRef,
}

/// Which device it is.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
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

/// The chip.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Esc {
    /// 0x0000.
    pub kind: Option<Shown<u8>>,
    /// The chip's name, where its type has one.
    pub name: Option<&'static str>,
    /// 0x0001.
    pub revision: Option<Shown<u8>>,
    /// 0x0004.
    pub fmmus: Option<Shown<u8>>,
    /// 0x0005.
    pub sync_managers: Option<Shown<u8>>,
    /// 0x0006, KiB.
    pub ram: Option<Shown<u8>>,
    /// 0x0008 bit 2: it has a DC unit.
    pub dc: Option<bool>,
    /// 0x0008 bit 3: its system time has 64 bits.
    pub dc_64_bit: Option<bool>,
}

/// A time in which a device that had answered did not.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SilenceReport {
    /// The first frame without its answer.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
    /// When it answered again, ns from the first frame of EtherCAT; null: it did not.
    pub until_ns: Option<u64>,
}

/// A status.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct StateReport {
    /// AL status, as `SAFEOP+ERR`. A device without a CPU copies the acknowledge bit of the request
    /// to the place of the error bit: that is no error.
    pub status: String,
    /// It shows an error.
    pub error: bool,
    /// AL status as it was read.
    pub raw: u16,
    /// AL status code, if it was read while this status held.
    pub code: Option<u16>,
    /// The state that was asked for last; null: none in this capture.
    pub asked: Option<String>,
    /// The first frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
}

/// A SyncManager.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncManagerReport {
    /// From 0.
    pub number: usize,
    /// First address.
    pub start: u16,
    /// Bytes.
    pub length: u16,
    /// Control byte.
    pub control: u8,
    /// Whether it is on.
    pub enabled: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// A FMMU.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct FmmuReport {
    /// From 0.
    pub number: usize,
    /// First logical address.
    pub logical: u32,
    /// Bits.
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

/// What went through a mailbox.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct MailboxReport {
    /// Messages to the device and from it.
    pub messages: [u64; 2],
    /// SDO transfers that the device answered without an abort.
    pub transfers: u64,
    /// SDO transfers that it aborted.
    pub aborts: Vec<Aborts>,
    /// Entries of 0x1C32 and 0x1C33, as they were last written or read.
    pub sync_objects: Vec<ObjectValue>,
    /// No frame shows where the mailboxes are: messages are known by their content.
    pub by_content: bool,
}

/// SDO transfers of one object that the device aborted with one code.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Aborts {
    /// The object, as `0x1C32:01`.
    pub object: String,
    /// Abort code.
    pub code: u32,
    /// How often.
    pub count: usize,
    /// The first of them.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// An entry of 0x1C32 or 0x1C33.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
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
    /// The MainDevice wrote it; if not, the device told it.
    pub written: bool,
    /// The frame that shows it.
    #[serde(flatten)]
    pub frame: FrameRef,
}

/// A SYNC unit was switched.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncSwitch {
    /// 0x0980 and 0x0981 as a word (AssignActivate).
    pub assign_activate: u16,
    /// What its bits mean.
    pub words: Vec<&'static str>,
    /// SYNC0 cycle (0x09A0), ns.
    pub sync0_cycle_ns: Option<Shown<u32>>,
    /// SYNC1 cycle (0x09A4), ns.
    pub sync1_cycle_ns: Option<Shown<u32>>,
    /// Start time (0x0990), ns of system time; of a 32-bit one as many bits as were written.
    pub start_ns: Option<Shown<u64>>,
    /// Bytes of the start time that were written, 4 or 8.
    pub start_bytes: Option<u8>,
    /// The start time less the reference's time, as that was last seen before, ns; below 0 it had
    /// passed.
    pub ahead_ns: Option<i64>,
    /// The frame that switched it.
    #[serde(flatten)]
    pub frame: FrameRef,
    /// When that was, ns from the first frame of EtherCAT.
    pub at_ns: u64,
}

/// From the end of cyclic frames at a device to its SYNC0, in the time of the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Distance {
    /// Frames that were measured.
    pub frames: u64,
    /// From one SYNC0 to the next, ns.
    pub cycle_ns: u64,
    /// The shortest distance, ns; below 0: behind the SYNC0 that usually follows.
    pub shortest_ns: Shown<i64>,
    /// The mean, ns.
    pub mean_ns: i64,
    /// The longest, ns.
    pub longest_ns: Shown<i64>,
    /// The instants of its SYNC0, by which its figures are among those of an onlooker.
    #[serde(skip)]
    pub grid: Grid,
    /// How much later a frame comes here than at the reference (0x0928), ns.
    pub delay_ns: i64,
    /// Frames slide through the cycle: the MainDevice does not follow the reference clock.
    pub slides: bool,
}

/// An error counter.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ErrorCounter {
    /// Its register.
    pub address: u16,
    /// What it counts.
    pub name: Option<&'static str>,
    /// Its port; null: it is the device's.
    pub port: Option<u16>,
    /// As it was last read or cleared.
    pub value: u8,
    /// That frame.
    #[serde(flatten)]
    pub frame: FrameRef,
}
