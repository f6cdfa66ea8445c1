//! The writes of a MainDevice to bring a segment up, as a list: for each SubDevice and transition
//! the registers and objects in their order, its DC part, and the datagrams of each cycle.
//!
//! The list is a plain value: made from a plan or read from an ENI, printed as text or JSON,
//! written as ENI. It has the structure of ENI: a SubDevice has one list of register accesses and
//! one of SDO downloads, and [`DeviceStartUp::at`] gives their order in one transition.

mod text;

use std::fmt;
use std::str::FromStr;

use isocat_wire::Command;
use isocat_wire::address::{AutoIncrementAddress, ObjectAddress, StationAddress};
use isocat_wire::al::{AlControl, AlState};
use isocat_wire::dc::AssignActivate;
use isocat_wire::register::{self, Register, Value};
use isocat_wire::soe::Idn;
use isocat_wire::time::Nanos;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Serialize, Serializer};

/// Version of the JSON document.
pub const FORMAT: &str = "isocat-start-up/3";

/// The whole list. All times are nanoseconds unless their name says otherwise.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct StartUp {
    /// Name of the segment.
    pub name: String,
    /// Bus cycle; above 0.
    pub cycle_ns: i64,
    /// Accesses to all SubDevices at once, in a transition before those to each one.
    pub before: Vec<RegisterStep>,
    /// The SubDevices, by position.
    pub devices: Vec<DeviceStartUp>,
    /// Accesses to all SubDevices at once, in a transition after those to each one.
    pub after: Vec<RegisterStep>,
    /// The cyclic frames, in the order in which they are sent.
    pub frames: Vec<CyclicFrame>,
    /// Bytes of the input image.
    pub input_bytes: u32,
    /// Bytes of the output image.
    pub output_bytes: u32,
    /// Facts that the list does not contain and that its user must know.
    pub notes: Vec<String>,
}

/// One SubDevice's part.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct DeviceStartUp {
    /// Its name.
    pub name: String,
    /// Station address that is assigned to it (register 0x0010).
    #[serde(serialize_with = "hex16")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub station: u16,
    /// Vendor id (SII word 0x08).
    #[serde(serialize_with = "hex32")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub vendor: u32,
    /// Product code (SII word 0x0A).
    #[serde(serialize_with = "hex32")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub product: u32,
    /// Revision (SII word 0x0C).
    #[serde(serialize_with = "hex32")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub revision: u32,
    /// Serial number (SII word 0x0E); 0 for any.
    pub serial: u32,
    /// Kind of each port from 0 on: Y for MII, K for EBUS, H for a fast hot connect port, a blank
    /// for an unused one.
    pub physics: String,
    /// Its parent in the tree; null for the first one.
    pub parent: Option<Parent>,
    /// Mailbox areas; null without mailbox.
    pub mailbox: Option<Mailbox>,
    /// SyncManagers of the process data.
    pub sync_managers: Vec<ProcessSyncManager>,
    /// Its outputs in the process image; null without.
    pub outputs: Option<ImageBits>,
    /// Its inputs in the process image; null without.
    pub inputs: Option<ImageBits>,
    /// Accesses to registers, in this order within a transition.
    pub registers: Vec<RegisterStep>,
    /// SDO downloads, in this order within a transition.
    pub objects: Vec<ObjectStep>,
    /// Parameters of its drives that SoE writes, in this order within a transition.
    pub parameters: Vec<ParameterStep>,
    /// Distributed clocks; null for a device without.
    pub dc: Option<Dc>,
    /// Facts about it that the list does not contain and that its user must know.
    pub notes: Vec<String>,
}

/// The parent SubDevice in the tree, and its port.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Parent {
    /// Station address.
    #[serde(serialize_with = "hex16")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub station: u16,
    /// Port, 1..=3; 0 if a cable is swapped.
    pub port: u8,
}

/// The mailbox of a SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Mailbox {
    /// From the MainDevice to the SubDevice, SM0.
    pub out: Area,
    /// From the SubDevice to the MainDevice, SM1.
    pub back: Area,
    /// Whether it speaks CoE.
    pub coe: bool,
    /// Whether it speaks SoE.
    pub soe: bool,
}

/// An area of an ESC's memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Area {
    /// First byte.
    #[serde(serialize_with = "hex16")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: u16,
    /// Bytes.
    pub length: u16,
}

/// A SyncManager of the process data.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ProcessSyncManager {
    /// Its number, 0..=15.
    pub number: u8,
    /// Whether the MainDevice writes it.
    pub outputs: bool,
    /// First byte.
    #[serde(serialize_with = "hex16")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub start: u16,
    /// Control byte (register 0x0804 + 8 n).
    pub control: u8,
    /// Whether it is enabled.
    pub enabled: bool,
    /// The assigned PDOs, in this order.
    pub pdos: Vec<u16>,
}

/// Bits of the process image.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ImageBits {
    /// First bit.
    pub start: u32,
    /// Number of bits.
    pub length: u32,
}

/// The DC part of a SubDevice. The value for 0x0980 is in the register steps:
/// [`DeviceStartUp::assign_activate`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Dc {
    /// Whether it is the reference clock.
    pub reference: bool,
    /// Register 0x09A0; 0 without SYNC0.
    pub sync0_ns: u32,
    /// Register 0x09A4: time from a SYNC0 to SYNC1; 0 without SYNC1.
    pub sync1_ns: u32,
    /// Phase of the first SYNC0 in the cycle. It is part of the start time (0x0990), which is
    /// computed when the segment is brought up: no list can contain it.
    pub shift_ns: i32,
}

/// One access to a register, in some transitions.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct RegisterStep {
    /// Its transitions; at least one.
    pub transitions: Vec<Transition>,
    /// The datagram's command.
    #[serde(serialize_with = "display")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub command: Command,
    /// The datagram's address.
    pub address: Address,
    /// The bytes to write, in wire order. For a read, zeros of the length to read.
    #[serde(serialize_with = "hex_bytes")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub data: Vec<u8>,
    /// Whether it needs a separate frame or cycle.
    pub own: Own,
    /// Expected working counter; null if it does not matter.
    pub working_counter: Option<u16>,
    /// Number of retries after a wrong working counter.
    pub retries: u16,
    /// Time limit of the attempts; null if only `retries` limits them.
    pub patience_ms: Option<u32>,
    /// Expected result of a read.
    pub check: Option<Check>,
    /// Its purpose.
    pub comment: String,
}

/// The expected result of a read.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Check {
    /// The expected bytes.
    #[serde(serialize_with = "hex_bytes")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub data: Vec<u8>,
    /// The bits that are compared, as many bytes as `data`; null for all.
    #[serde(serialize_with = "optional_hex_bytes")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<String>"))]
    pub mask: Option<Vec<u8>>,
    /// Time limit of repeated reads.
    pub patience_ms: u32,
}

/// Whether a datagram may share its frame or its cycle.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Own {
    /// It may share both.
    #[default]
    Nothing,
    /// It needs a separate frame, so that it takes effect before the following ones.
    Frame,
    /// It needs a separate cycle.
    Cycle,
}

/// One SDO download, in some transitions.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ObjectStep {
    /// Its transitions; at least one.
    pub transitions: Vec<Transition>,
    /// The entry; with complete access its sub-index is 0 or 1.
    #[serde(serialize_with = "display")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub object: ObjectAddress,
    /// Whether it uses complete access.
    pub complete: bool,
    /// The value, little-endian.
    #[serde(serialize_with = "hex_bytes")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub data: Vec<u8>,
    /// Time limit of the answer; 0 for the MainDevice's default.
    pub patience_ms: u32,
    /// Its purpose.
    pub comment: String,
}

/// One parameter of a drive that SoE writes, in some transitions.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct ParameterStep {
    /// Its transitions; at least one.
    pub transitions: Vec<Transition>,
    /// Number of the drive in the SubDevice, 0 to 7.
    pub drive: u8,
    /// The parameter, such as S-0-0032.
    #[serde(serialize_with = "display")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub idn: Idn,
    /// The value, little-endian; a list begins with its lengths.
    #[serde(serialize_with = "hex_bytes")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub data: Vec<u8>,
    /// Time limit of the answer; 0 for the MainDevice's default.
    pub patience_ms: u32,
    /// Its purpose.
    pub comment: String,
}

/// One frame of a cycle.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct CyclicFrame {
    /// It is sent in every n-th bus cycle, 1 or more. With DC, in those whose number (system time
    /// divided by the bus cycle) is a multiple of this.
    pub every: u32,
    /// Its datagrams, in order.
    pub datagrams: Vec<CyclicDatagram>,
}

/// One datagram of a cyclic frame.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct CyclicDatagram {
    /// Its command.
    #[serde(serialize_with = "display")]
    #[cfg_attr(feature = "schema", schemars(with = "String"))]
    pub command: Command,
    /// Its address.
    pub address: Address,
    /// Number of its data bytes.
    pub length: u16,
    /// States of the MainDevice in which it is sent.
    #[serde(serialize_with = "states")]
    #[cfg_attr(feature = "schema", schemars(with = "Vec<String>"))]
    pub states: Vec<AlState>,
    /// Expected working counter; null if it does not matter.
    pub working_counter: Option<u16>,
    /// Offset of its data in the input image, bytes.
    pub input_offset: u32,
    /// Offset of its data in the output image, bytes.
    pub output_offset: u32,
    /// Its purpose.
    pub comment: String,
}

/// The address of a datagram.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Address {
    /// Memory of an ESC.
    Physical {
        /// Station address, auto-increment address, or 0 for a broadcast.
        #[serde(serialize_with = "hex16")]
        #[cfg_attr(feature = "schema", schemars(with = "String"))]
        device: u16,
        /// First byte.
        #[serde(serialize_with = "hex16")]
        #[cfg_attr(feature = "schema", schemars(with = "String"))]
        register: u16,
    },
    /// The process image, by FMMUs.
    Logical(
        #[serde(serialize_with = "hex32")]
        #[cfg_attr(feature = "schema", schemars(with = "String"))]
        u32,
    ),
}

/// A change from one state to another; it prints as two letters, `PS` for PREOP to SAFEOP.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Transition {
    /// The state before.
    pub from: AlState,
    /// The state after.
    pub to: AlState,
}

impl Transition {
    /// INIT to PREOP.
    pub const IP: Self = Self { from: AlState::Init, to: AlState::PreOp };
    /// PREOP to SAFEOP.
    pub const PS: Self = Self { from: AlState::PreOp, to: AlState::SafeOp };
    /// SAFEOP to OP.
    pub const SO: Self = Self { from: AlState::SafeOp, to: AlState::Op };
    /// The way up.
    pub const UP: [Self; 3] = [Self::IP, Self::PS, Self::SO];

    /// Whether the mailbox runs only after the transition.
    const fn begins_without_mailbox(self) -> bool {
        matches!(self.from, AlState::Init)
    }

    const fn letter(state: AlState) -> char {
        match state {
            AlState::Init => 'I',
            AlState::PreOp => 'P',
            AlState::Boot => 'B',
            AlState::SafeOp => 'S',
            AlState::Op => 'O',
        }
    }
}

impl fmt::Display for Transition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", Self::letter(self.from), Self::letter(self.to))
    }
}

/// Letters of no transition.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct UnknownTransition(pub String);

impl fmt::Display for UnknownTransition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\" is no transition; expected two letters of I, P, B, S, O", self.0)
    }
}

impl std::error::Error for UnknownTransition {}

impl FromStr for Transition {
    type Err = UnknownTransition;
    fn from_str(text: &str) -> Result<Self, UnknownTransition> {
        let state = |letter| {
            [AlState::Init, AlState::PreOp, AlState::Boot, AlState::SafeOp, AlState::Op]
                .into_iter()
                .find(|state| Self::letter(*state) == letter)
        };
        let mut letters = text.chars();
        match (letters.next().and_then(state), letters.next().and_then(state), letters.next()) {
            (Some(from), Some(to), None) => Ok(Self { from, to }),
            _ => Err(UnknownTransition(text.to_owned())),
        }
    }
}

/// One step of a SubDevice, in the order of [`DeviceStartUp::at`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Step<'a> {
    /// An access to a register.
    Register(&'a RegisterStep),
    /// An SDO download.
    Object(&'a ObjectStep),
    /// A parameter of a drive, by SoE.
    Parameter(&'a ParameterStep),
}

impl DeviceStartUp {
    /// The steps of a transition, in order. SDO downloads and then parameters come before register
    /// accesses, except in a transition from INIT, where there is no mailbox before its end.
    pub fn at(&self, transition: Transition) -> Vec<Step<'_>> {
        let registers = self.registers.iter().filter(|step| step.transitions.contains(&transition));
        let objects = self.objects.iter().filter(|step| step.transitions.contains(&transition));
        let parameters = self.parameters.iter();
        let parameters = parameters.filter(|step| step.transitions.contains(&transition));
        let registers = registers.map(Step::Register);
        let mailbox = objects.map(Step::Object).chain(parameters.map(Step::Parameter));
        match transition.begins_without_mailbox() {
            true => registers.chain(mailbox).collect(),
            false => mailbox.chain(registers).collect(),
        }
    }

    /// The last value for 0x0980 and 0x0981 on the way up; `None` without such a write.
    pub fn assign_activate(&self) -> Option<AssignActivate> {
        let steps = self.registers.iter().rev();
        let of = |step: &RegisterStep| match (step.address, step.data.first_chunk()) {
            (Address::Physical { register, .. }, Some(bytes))
                if register == register::CYCLIC_UNIT_CONTROL.address
                    && matches!(step.command, Command::Fpwr | Command::Apwr) =>
            {
                Some(AssignActivate::from_bytes(*bytes))
            }
            _ => None,
        };
        let up = |step: &&RegisterStep| step.transitions.contains(&Transition::PS);
        steps.filter(up).find_map(of)
    }
}

/// Constructors of steps. Their defaults: they share frame and cycle, expect working counter 1 from
/// one SubDevice and any from all, and have 3 retries.
impl RegisterStep {
    /// A write to one SubDevice by its station address.
    pub fn write<T: Value>(
        transitions: &[Transition],
        station: StationAddress,
        register: Register<T>,
        value: T,
        comment: impl Into<String>,
    ) -> Self {
        let data = value.to_bytes().as_ref().to_vec();
        Self::fpwr(transitions, station, register.address, data, comment)
    }

    /// The same with bytes, for several registers at once.
    pub fn fpwr(
        transitions: &[Transition],
        station: StationAddress,
        register: u16,
        data: Vec<u8>,
        comment: impl Into<String>,
    ) -> Self {
        let address = Address::Physical { device: station.0, register };
        Self::new(transitions, Command::Fpwr, address, data, Some(1), comment)
    }

    /// A write to one SubDevice by its position, before it has a station address.
    pub fn apwr(
        transitions: &[Transition],
        position: u16,
        register: u16,
        data: Vec<u8>,
        comment: impl Into<String>,
    ) -> Self {
        let device = AutoIncrementAddress::of_position(position).0;
        let address = Address::Physical { device, register };
        Self::new(transitions, Command::Apwr, address, data, Some(1), comment)
    }

    /// A write to all SubDevices.
    pub fn bwr(
        transitions: &[Transition],
        register: u16,
        data: Vec<u8>,
        comment: impl Into<String>,
    ) -> Self {
        let address = Address::Physical { device: 0, register };
        Self::new(transitions, Command::Bwr, address, data, None, comment)
    }

    /// A read of one SubDevice until the register has the expected value.
    pub fn expect(
        transitions: &[Transition],
        station: StationAddress,
        register: u16,
        check: Check,
        comment: impl Into<String>,
    ) -> Self {
        let address = Address::Physical { device: station.0, register };
        let data = vec![0; check.data.len()];
        let step = Self::new(transitions, Command::Fprd, address, data, Some(1), comment);
        Self { check: Some(check), ..step }
    }

    /// The request of a state and the wait for it, which end a transition. Errors are acknowledged
    /// on the way to INIT and PREOP.
    pub fn state(
        transitions: &[Transition],
        station: StationAddress,
        state: AlState,
        patience: Nanos,
    ) -> [Self; 2] {
        let request = match state {
            AlState::Init | AlState::PreOp => AlControl::request_and_acknowledge(state),
            _ => AlControl::request(state),
        };
        let patience_ms = u32::try_from(patience.0 / 1_000_000).unwrap_or(u32::MAX);
        let comment = format!("{state} is asked for");
        let ask = Self::write(transitions, station, register::AL_CONTROL, request, comment);
        // State and error bit are compared; the status code at 0x0134 is read with them for the
        // log.
        let check = Check {
            data: vec![state as u8, 0, 0, 0, 0, 0],
            mask: Some(vec![0x1F, 0, 0, 0, 0, 0]),
            patience_ms,
        };
        let at = register::AL_STATUS.address;
        let wait =
            Self::expect(transitions, station, at, check, format!("{state} must be reached"));
        let ask = Self { own: Own::Cycle, patience_ms: Some(patience_ms), ..ask };
        [ask, Self { own: Own::Cycle, ..wait }]
    }

    fn new(
        transitions: &[Transition],
        command: Command,
        address: Address,
        data: Vec<u8>,
        working_counter: Option<u16>,
        comment: impl Into<String>,
    ) -> Self {
        Self {
            transitions: transitions.to_vec(),
            command,
            address,
            data,
            own: Own::Nothing,
            working_counter,
            retries: 3,
            patience_ms: None,
            check: None,
            comment: comment.into(),
        }
    }
}

impl ObjectStep {
    /// A download of one entry.
    pub fn new(
        transitions: &[Transition],
        object: ObjectAddress,
        data: Vec<u8>,
        comment: impl Into<String>,
    ) -> Self {
        Self {
            transitions: transitions.to_vec(),
            object,
            complete: false,
            data,
            patience_ms: 0,
            comment: comment.into(),
        }
    }
}

impl StartUp {
    /// The list as JSON.
    pub fn json(&self) -> String {
        let document = Document { format: FORMAT, start_up: self };
        let json = serde_json::to_string_pretty(&document);
        json.expect("texts and numbers can be written as JSON") + "\n"
    }
}

#[derive(Serialize)]
struct Document<'a> {
    format: &'static str,
    #[serde(flatten)]
    start_up: &'a StartUp,
}

impl Serialize for Transition {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(feature = "schema")]
impl JsonSchema for Transition {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Transition".into()
    }
    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string", "pattern": "^[IPBSO]{2}$" })
    }
}

/// Bytes as hex digits in wire order.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn display<S: Serializer>(value: &impl fmt::Display, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(value)
}

fn hex16<S: Serializer>(value: &u16, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("0x{value:04X}"))
}

fn hex32<S: Serializer>(value: &u32, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("0x{value:08X}"))
}

fn hex_bytes<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&hex(bytes))
}

fn optional_hex_bytes<S: Serializer>(
    bytes: &Option<Vec<u8>>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    bytes.as_deref().map(hex).serialize(serializer)
}

fn states<S: Serializer>(states: &[AlState], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(states.iter().map(|state| state.name()))
}

#[cfg(test)]
mod tests;
