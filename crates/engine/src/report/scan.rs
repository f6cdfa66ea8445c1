//! What a scan found: a segment before any cycle, as its registers, its SII and its objects tell it.
//!
//! Everything was read over the wire or measured by the MainDevice from what was read; nothing is taken from a segment
//! file or a profile. A *finding* is what could not be read or contradicts itself; a *doubt* is what is allowed and
//! leaves a question open, such as a time of 0.

mod build;
mod doubts;
mod esc;
mod objects;
mod text;

pub use build::Place;
pub use esc::{PortKind, protocol};
use schemars::JsonSchema;
use serde::Serialize;

pub use super::Note;
use super::typed;

/// Version of the document; changes whenever a reader could be misled by an older schema.
pub const FORMAT: &str = "isocat-scan/1";

/// JSON schema of the document, draft 2020-12.
pub fn schema() -> serde_json::Value {
    super::schema_of::<ScanReport>()
}

/// The whole document. All times are nanoseconds unless their name says otherwise.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ScanReport {
    /// [`FORMAT`].
    pub format: &'static str,
    /// Version of the program.
    pub version: &'static str,
    /// Where the virtual segment was described; null on an interface.
    pub segment_file: Option<String>,
    /// Network interface; null for a virtual segment.
    pub interface: Option<String>,
    /// Its network namespace; null: that of the program.
    pub namespace: Option<String>,
    /// Whether everything was read and nothing contradicts itself: no findings.
    pub consistent: bool,
    /// One sentence for people.
    pub verdict: String,
    /// What could not be read or contradicts itself.
    pub findings: Vec<Note>,
    /// What is allowed and leaves a question open.
    pub doubts: Vec<Note>,
    /// Whether objects were read by SDO; else the SII alone speaks for the process data.
    pub objects_read: bool,
    /// Position of the SubDevice whose clock leads; null without clocks.
    pub reference: Option<usize>,
    /// Whether it is known who hangs on whom; else no SubDevice has a parent.
    pub tree_known: bool,
    /// Frames sent until everything was known.
    pub frames_sent: u64,
    /// Of these, frames that did not come back.
    pub frames_lost: u64,
    /// The SubDevices, by position.
    pub devices: Vec<Device>,
}

/// One SubDevice.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Device {
    /// Place in processing order, from 0.
    pub position: usize,
    /// Station address that the scan gave to it.
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
    /// What its ESC is and has.
    pub esc: Esc,
    /// Its ports, by number.
    pub ports: Vec<Port>,
    /// Position of the SubDevice that it hangs on; null for the first, or if the tree is not known.
    pub parent: Option<usize>,
    /// Port of the SubDevice above.
    pub parent_port: Option<usize>,
    /// Its propagation delay.
    pub delay: Delay,
    /// Its clock.
    pub clock: Clock,
    /// SyncManagers, by number: the SII's, and the use that object 0x1C00 tells.
    pub sync_managers: Vec<SyncManager>,
    /// Its mailbox by the SII; null without.
    pub mailbox: Option<Mailbox>,
    /// Outputs: what is assigned to 0x1C12, or what the SII assigns.
    pub outputs: ProcessData,
    /// Inputs: what is assigned to 0x1C13, or what the SII assigns.
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
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Esc {
    /// Register 0x0000.
    pub kind: u8,
    /// What kind that is.
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
    /// What its bits mean.
    pub features_in_words: Vec<String>,
    /// Register 0x0140; null if it did not answer.
    pub pdi: Option<u8>,
    /// What kind of PDI that is.
    pub pdi_name: Option<String>,
    /// Device emulation (0x0141 bit 0): nobody behind it answers requests of states.
    pub device_emulation: bool,
    /// Distributed clocks by what answers: none, receive-times, 32-bit, 64-bit.
    pub dc: String,
    /// The SYNC unit is on (0x0141 bit 2).
    pub sync_unit: bool,
    /// How long SYNC pulses are, by word 2 of the SII, which becomes register 0x0982; 0 is acknowledge mode. Null where the SYNC
    /// unit is off or the SII was not read.
    pub sync_pulse_ns: Option<i64>,
    /// The latch unit is on (0x0141 bit 3).
    pub latch_unit: bool,
    /// Register 0x0151; null if it did not answer.
    pub sync_latch: Option<u8>,
    /// The SYNC/LATCH pins by it.
    pub pins: Vec<String>,
}

/// One port of an ESC.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Port {
    /// Number, 0 to 3.
    pub port: usize,
    /// By register 0x0007: none, not configured, EBUS, MII.
    #[serde(serialize_with = "typed::text")]
    #[schemars(with = "String")]
    pub kind: PortKind,
    /// A physical link (0x0110).
    pub link: bool,
    /// The loop is closed: frames turn round here (0x0110).
    pub loop_closed: bool,
    /// A signal is received: communication is established (0x0110).
    pub signal: bool,
    /// Frames come in here.
    pub entry: bool,
    /// Position of the SubDevice that hangs on it.
    pub leads_to: Option<usize>,
}

/// The propagation delay from the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Delay {
    /// Measured; null if it was not, or can't be known.
    pub ns: Option<f64>,
    /// Half the width of the interval that holds the true delay with a confidence of 95 %: 1.96 standard errors and
    /// the systematic part.
    pub error_ns: Option<f64>,
    /// What is left of quantization and noise, 1 sigma.
    pub standard_error_ns: Option<f64>,
    /// What no averaging takes away, as a bound.
    pub systematic_ns: Option<f64>,
    /// Why it can't be known; null if it is known or nothing was measured.
    pub unknown: Option<String>,
    /// The least that the receive times allow, where it can't be known.
    pub least_ns: Option<f64>,
    /// The most that the receive times allow, where it can't be known.
    pub most_ns: Option<f64>,
    /// What was written to register 0x0928; null without clock.
    pub written_ns: Option<i64>,
    /// How much later than at the SubDevice above frames are processed, with the branches that they visit before;
    /// null unless both delays are known.
    pub from_parent_ns: Option<f64>,
    /// Largest less smallest of all latches.
    pub spread_ns: Option<i64>,
    /// Latches whose times contradicted each other.
    pub latches_left_out: u32,
}

/// A clock against the reference clock.
#[derive(Clone, PartialEq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Clock {
    /// How much faster it runs when nobody leads it, by two latches of receive times; null without them.
    pub speed_ppm: Option<f64>,
    /// How far off that may be: a tick of 10 ns at either end of either clock.
    pub speed_error_ppm: Option<f64>,
    /// From one latch to the other.
    pub speed_window_ns: Option<i64>,
    /// Register 0x0932 when the clocks had converged: what the drift loop corrects, in units of its own.
    pub correction: Option<i16>,
    /// Register 0x0930: the bandwidth of the drift loop.
    pub correction_start: Option<u16>,
    /// Register 0x092C when the clocks had converged: positive if it is ahead.
    pub system_time_difference_ns: Option<i64>,
}

/// A SyncManager of the SII.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncManager {
    /// Number.
    pub number: usize,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes by the SII.
    pub length: u16,
    /// Control byte by the SII.
    pub control: u8,
    /// The control byte in words.
    pub control_in_words: String,
    /// Enabled by the SII.
    pub enabled: bool,
    /// By the SII a window (bit 2, "virtual"): it stays off, and an FMMU alone maps what is assigned to it.
    pub window: bool,
    /// Use by the SII: unused, mailbox out, mailbox in, outputs, inputs.
    pub use_in_sii: String,
    /// Use by object 0x1C00; null if that was not read.
    pub use_in_object: Option<String>,
}

/// A mailbox by the SII.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
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
    /// What CoE can do.
    pub coe_details: Vec<String>,
}

/// Process data of one direction.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct ProcessData {
    /// Where the assignment was read: objects or SII.
    pub source: String,
    /// SyncManager that guards them, the first of several; null without.
    pub sync_manager: Option<u8>,
    /// The first one is a window: the SyncManager is off, and an FMMU alone maps the bytes, as a rule registers.
    pub window: bool,
    /// First byte in the ESC's memory.
    pub start: u16,
    /// Bytes, those of further SyncManagers included.
    pub length: u16,
    /// SyncManagers behind the first one, in the order of the process image.
    pub further: Vec<Guarded>,
    /// The PDOs assigned.
    pub pdos: Vec<Pdo>,
}

/// What a further SyncManager guards of the process data.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
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

/// A PDO with what is mapped into it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct Pdo {
    /// Index.
    pub index: u16,
    /// Bits of all entries.
    pub bits: u32,
    /// Entries in the order of their bits.
    pub entries: Vec<PdoEntry>,
}

/// An entry of a PDO.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct PdoEntry {
    /// Index; 0 for padding.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Bits.
    pub bits: u8,
}

/// Object 0x1C32 or 0x1C33.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncObject {
    /// Index.
    pub index: u16,
    /// Its sub-indices.
    pub entries: Vec<SyncEntry>,
}

/// A sub-index of a sync object.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SyncEntry {
    /// Sub-index.
    pub sub: u8,
    /// Its name by ETG.1020, else by the device.
    pub name: String,
    /// Its value; null if it could not be read or is no number.
    pub value: Option<u32>,
    /// The value in words, or why there is none.
    pub in_words: String,
    /// Whether it can be written in PREOP; null without SDO information.
    pub writable: Option<bool>,
    /// What is doubtful in it; null if nothing.
    pub doubt: Option<String>,
}

/// A DC operation mode of the SII.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct OpMode {
    /// Word for 0x0980 and 0x0981.
    pub assign_activate: u16,
    /// What it is for.
    pub in_words: String,
    /// Cycle time of SYNC0; 0: by the factor.
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
#[derive(Clone, PartialEq, Eq, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct State {
    /// Register 0x0130.
    pub al_status: String,
    /// Register 0x0134.
    pub al_status_code: u16,
    /// What that code means.
    pub al_status_code_name: String,
}
