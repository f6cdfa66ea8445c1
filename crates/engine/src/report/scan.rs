//! The result of a scan: a segment before any cycle, according to its registers, its SII and its
//! objects.
//!
//! Everything was read over the wire, or measured by the MainDevice from readings; nothing is taken
//! from a segment file or a profile. A *finding* is something that could not be read or is
//! contradictory; a *doubt* is something that is allowed but leaves a question open, such as a time
//! of 0.

mod build;
mod doubts;
mod esc;
mod objects;
mod text;

pub use build::Place;
pub use esc::{PortKind, protocol};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

pub use super::Note;
use super::typed;

/// Version of the document; it changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-scan/1";

/// JSON schema of the document, draft 2020-12.
#[cfg(feature = "schema")]
pub fn schema() -> serde_json::Value {
    isocat_descriptions::schema::of::<ScanReport>(FORMAT)
}

/// The whole document. All times are nanoseconds unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ScanReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// File with the description of the virtual segment; null on an interface.
    pub segment_file: Option<String>,
    /// Network interface; null for a virtual segment.
    pub interface: Option<String>,
    /// Its network namespace; null for that of the program.
    pub namespace: Option<String>,
    /// Whether everything was read and nothing is contradictory: no findings.
    pub consistent: bool,
    /// One sentence for people.
    pub verdict: String,
    /// Parts that could not be read or are contradictory.
    pub findings: Vec<Note>,
    /// Parts that are allowed but leave a question open.
    pub doubts: Vec<Note>,
    /// Whether objects were read by SDO; otherwise process data are those of the SII alone.
    pub objects_read: bool,
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Whether the tree of the SubDevices is known; otherwise no SubDevice has a parent.
    pub tree_known: bool,
    /// Frames sent until the scan was complete.
    pub frames_sent: u64,
    /// Of these, frames that did not come back.
    pub frames_lost: u64,
    /// The SubDevices, by position.
    pub devices: Vec<Device>,
}

/// One SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Station address that the scan assigned.
    pub station_address: u16,
    /// Name in its SII; may be empty.
    pub name: String,
    /// Order number in its SII; may be empty.
    pub order: String,
    /// Vendor id in its SII.
    pub vendor_id: u32,
    /// Product code in its SII.
    pub product_code: u32,
    /// Revision number in its SII.
    pub revision: u32,
    /// Serial number in its SII.
    pub serial: u32,
    /// Station alias, register 0x0012; null if it did not answer.
    pub alias: Option<u16>,
    /// Station alias in its SII, word 4.
    pub sii_alias: u16,
    /// Properties of its ESC.
    pub esc: Esc,
    /// Its ports, by number.
    pub ports: Vec<Port>,
    /// Position of the parent SubDevice; null for the first, or if the tree is not known.
    pub parent: Option<usize>,
    /// Port of the parent SubDevice.
    pub parent_port: Option<usize>,
    /// Its propagation delay.
    pub delay: Delay,
    /// Its clock.
    pub clock: Clock,
    /// SyncManagers by number: those of the SII, with their use by object 0x1C00.
    pub sync_managers: Vec<SyncManager>,
    /// Its mailbox by the SII; null without.
    pub mailbox: Option<Mailbox>,
    /// Outputs: the assignment of 0x1C12, or of the SII.
    pub outputs: ProcessData,
    /// Inputs: the assignment of 0x1C13, or of the SII.
    pub inputs: ProcessData,
    /// Object 0x1C32; null if it has none or it was not read.
    pub output_sync: Option<SyncObject>,
    /// Object 0x1C33; null if it has none or it was not read.
    pub input_sync: Option<SyncObject>,
    /// DC operation modes of the SII.
    pub op_modes: Vec<OpMode>,
    /// State before anything was written; null if it did not answer.
    pub state_before: Option<State>,
    /// State at the end of the scan, before it goes back to INIT.
    pub state: State,
}

/// An ESC by its registers.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Esc {
    /// Register 0x0000.
    pub kind: u8,
    /// Name of that kind.
    pub kind_name: String,
    /// Register 0x0001.
    pub revision: u8,
    /// Register 0x0002.
    pub build: u16,
    /// FMMUs, register 0x0004.
    pub fmmus: u8,
    /// SyncManagers, register 0x0005.
    pub sync_managers: u8,
    /// Process RAM in KiB, register 0x0006.
    pub ram_kib: u8,
    /// Register 0x0008.
    pub features: u16,
    /// Meaning of its bits.
    pub features_in_words: Vec<String>,
    /// Register 0x0140; null if it did not answer.
    pub pdi: Option<u8>,
    /// Kind of that PDI.
    pub pdi_name: Option<String>,
    /// Device emulation (0x0141 bit 0): no CPU behind the ESC answers requests of states.
    pub device_emulation: bool,
    /// Distributed clocks by the registers that answer: none, receive-times, 32-bit, 64-bit.
    pub dc: String,
    /// Whether the SYNC unit is on (0x0141 bit 2).
    pub sync_unit: bool,
    /// Length of SYNC pulses from word 2 of the SII, which is loaded to register 0x0982; 0 is
    /// acknowledge mode. Null if the SYNC unit is off or the SII was not read.
    pub sync_pulse_ns: Option<i64>,
    /// Whether the latch unit is on (0x0141 bit 3).
    pub latch_unit: bool,
    /// Register 0x0151; null if it did not answer.
    pub sync_latch: Option<u8>,
    /// The SYNC/LATCH pins by that register.
    pub pins: Vec<String>,
}

/// One port of an ESC.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Port {
    /// Number, 0 to 3.
    pub port: usize,
    /// Kind by register 0x0007: none, not configured, EBUS, MII.
    #[serde(serialize_with = "typed::text")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub kind: PortKind,
    /// Whether there is a physical link (0x0110).
    pub link: bool,
    /// Whether the loop is closed, so that frames turn around here (0x0110).
    pub loop_closed: bool,
    /// Whether a signal is received, so that communication is established (0x0110).
    pub signal: bool,
    /// Whether frames come in here.
    pub entry: bool,
    /// Position of the SubDevice behind it.
    pub leads_to: Option<usize>,
}

/// The propagation delay from the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Delay {
    /// The measured delay; null if it was not measured, or cannot be known.
    pub ns: Option<f64>,
    /// Half the width of the interval that holds the true delay with a confidence of 95 %: 1.96
    /// standard errors and the systematic part.
    pub error_ns: Option<f64>,
    /// The quantization and noise that remain, 1 sigma.
    pub standard_error_ns: Option<f64>,
    /// A bound of the errors that averaging does not reduce.
    pub systematic_ns: Option<f64>,
    /// Why it cannot be known; null if it is known or nothing was measured.
    pub unknown: Option<String>,
    /// The least value that the receive times allow, if it cannot be known.
    pub least_ns: Option<f64>,
    /// The largest value that the receive times allow, if it cannot be known.
    pub most_ns: Option<f64>,
    /// Value written to register 0x0928; null without clock.
    pub written_ns: Option<i64>,
    /// Time from processing at the SubDevice above to processing here, including the branches that
    /// frames visit before; null unless both delays are known.
    pub from_parent_ns: Option<f64>,
    /// Largest less smallest value of all latches.
    pub spread_ns: Option<i64>,
    /// Number of latches with contradictory times.
    pub latches_left_out: u32,
}

/// A clock against the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Clock {
    /// How much faster than the reference clock it runs while it is not led, by two latches of
    /// receive times; null without them.
    pub speed_ppm: Option<f64>,
    /// Error of that speed: a tick of 10 ns at either end of either clock.
    pub speed_error_ppm: Option<f64>,
    /// Time from one latch to the other.
    pub speed_window_ns: Option<i64>,
    /// Register 0x0932 when the clocks had converged: the correction of the drift loop, in its own
    /// units.
    pub correction: Option<i16>,
    /// Register 0x0930: the bandwidth of the drift loop.
    pub correction_start: Option<u16>,
    /// Register 0x092C when the clocks had converged: positive if it is ahead.
    pub system_time_difference_ns: Option<i64>,
}

/// A SyncManager of the SII.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SyncManager {
    /// Its number.
    pub number: usize,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes by the SII.
    pub length: u16,
    /// Control byte by the SII.
    pub control: u8,
    /// The control byte in words.
    pub control_in_words: String,
    /// Whether the SII enables it.
    pub enabled: bool,
    /// By the SII a window (bit 2, "virtual"): it stays off, and an FMMU alone maps what is
    /// assigned to it.
    pub window: bool,
    /// Use by the SII: unused, mailbox out, mailbox in, outputs, inputs.
    pub use_in_sii: String,
    /// Use by object 0x1C00; null if that was not read.
    pub use_in_object: Option<String>,
}

/// A mailbox by the SII.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Mailbox {
    /// First byte of the area that the MainDevice writes.
    pub receive_start: u16,
    /// Its bytes.
    pub receive_length: u16,
    /// First byte of the area that the MainDevice reads.
    pub send_start: u16,
    /// Its bytes.
    pub send_length: u16,
    /// Protocols.
    pub protocols: Vec<String>,
    /// CoE services that the SII announces.
    pub coe_details: Vec<String>,
}

/// Process data of one direction.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ProcessData {
    /// Source of the assignment: objects or SII.
    pub source: String,
    /// SyncManager that guards them, the first one if there are several; null without.
    pub sync_manager: Option<u8>,
    /// The first one is a window: the SyncManager is off, and an FMMU alone maps the bytes, as a
    /// rule registers.
    pub window: bool,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes, including those of further SyncManagers.
    pub length: u16,
    /// SyncManagers after the first one, in the order of the process image.
    pub further: Vec<Guarded>,
    /// The assigned PDOs.
    pub pdos: Vec<Pdo>,
}

/// The part of the process data that a further SyncManager guards.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Guarded {
    /// Its number.
    pub sync_manager: u8,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes.
    pub length: u16,
    /// It is a window.
    pub window: bool,
}

/// A PDO with its mapping.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Pdo {
    /// Index.
    pub index: u16,
    /// Bits of all entries.
    pub bits: u32,
    /// Entries in the order of their bits.
    pub entries: Vec<PdoEntry>,
}

/// An entry of a PDO.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct PdoEntry {
    /// Index; 0 for padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Bits.
    pub bits: u8,
}

/// Object 0x1C32 or 0x1C33.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SyncObject {
    /// Index.
    pub index: u16,
    /// Its sub-indices.
    pub entries: Vec<SyncEntry>,
}

/// A sub-index of a sync object.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct SyncEntry {
    /// Sub-index.
    pub sub: u8,
    /// Its name by ETG.1020, or else by the device.
    pub name: String,
    /// Its value; null if it could not be read or is no number.
    pub value: Option<u32>,
    /// The value in words, or why there is none.
    pub in_words: String,
    /// Whether it can be written in PREOP; null without SDO information.
    pub writable: Option<bool>,
    /// Doubt about it; null if there is none.
    pub doubt: Option<String>,
}

/// A DC operation mode of the SII.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct OpMode {
    /// Word for 0x0980 and 0x0981.
    pub assign_activate: u16,
    /// Meaning in words.
    pub in_words: String,
    /// Cycle time of SYNC0; 0 if the factor determines it.
    pub sync0_cycle_ns: u32,
    /// Factor of the SYNC0 cycle.
    pub sync0_factor: i16,
    /// Shift of SYNC0.
    pub sync0_shift_ns: i32,
    /// Factor of SYNC1.
    pub sync1_factor: i16,
    /// Shift of SYNC1.
    pub sync1_shift_ns: i32,
}

/// AL status and its code.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct State {
    /// Register 0x0130.
    pub al_status: String,
    /// Register 0x0134.
    pub al_status_code: u16,
    /// Meaning of that code.
    pub al_status_code_name: String,
}
