//! Errors of the bring-up: the stage, the place, and expected against found.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use isocat_sync::SyncMode;
use isocat_sync::budget::Line;
use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::dc::ActivationStatus;
use isocat_wire::eeprom::EepromStatus;
use isocat_wire::mailbox::{ErrorDetail, Protocol};
use isocat_wire::sii::MailboxArea;
use isocat_wire::soe::{self, Idn};
use isocat_wire::time::{Dc, Nanos, Time};
use isocat_wire::{AbortCode, ObjectAddress, PortNumber};

use crate::dc::DcCapability;
use crate::kind::{Figure, Figured};
use crate::stage::Stage;

/// A failure, with the stage at which it happened.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Error {
    /// The stage that failed.
    pub stage: Stage,
    /// What went wrong.
    pub cause: Cause,
}

/// Which part caused a failure.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fault {
    /// A SubDevice refused, did not answer or contradicted itself.
    SubDevice,
    /// Frames were lost, damaged or not answered.
    Segment,
    /// The configuration does not fit the segment.
    Configuration,
}

/// A SubDevice in a message.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Place {
    /// Position, from 0.
    pub position: usize,
    /// Its name; may be empty.
    pub name: String,
}

/// `SubDevice 1 (AKD2G)`
impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SubDevice {}", self.position)?;
        if self.name.is_empty() { Ok(()) } else { write!(f, " ({})", self.name) }
    }
}

/// What went wrong.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Cause {
    /// A datagram was lost or had a wrong working counter.
    Access(AccessError),
    /// Frames come back, but no SubDevice has processed them.
    Empty,
    /// Not one frame came back.
    Silent {
        /// Frames sent.
        sent: u64,
        /// Time waited.
        after: Nanos,
        /// Another MainDevice on this wire: its address, and the number of its frames received.
        foreign: Option<([u8; 6], u64)>,
    },
    /// The number of SubDevices is not the configured one.
    Count {
        /// As configured.
        expected: usize,
        /// Number that answered.
        found: usize,
    },
    /// The open ports do not make a tree of the SubDevices that answered.
    Topology {
        /// SubDevices counted.
        devices: usize,
        /// Ports at which a SubDevice must follow.
        ports: usize,
    },
    /// The device is not the configured one.
    Identity {
        /// Where.
        place: Place,
        /// Vendor id and product code configured.
        expected: (u32, u32),
        /// Vendor id and product code in its SII.
        found: (u32, u32),
    },
    /// No configured SubDevice may be at a place where one answers.
    NoSeat {
        /// Place in the order of frames, from 0.
        place: usize,
        /// Vendor id and product code in its SII.
        found: (u32, u32),
        /// True if more than one configured SubDevice would fit.
        several: bool,
    },
    /// A required SubDevice does not answer, while others behind it do.
    Missing {
        /// Which SubDevice.
        place: Place,
    },
    /// Its clock is not the planned one.
    Clock {
        /// Where.
        place: Place,
        /// As planned.
        planned: DcCapability,
        /// As found in its ESC.
        found: DcCapability,
    },
    /// Frames take another way to it since its delay was measured: a SubDevice before it was lost
    /// or has come.
    WayChanged {
        /// Where.
        place: Place,
    },
    /// The SII cannot be read or contradicts itself.
    Sii {
        /// Where.
        place: Place,
        /// How.
        problem: SiiProblem,
    },
    /// A state change was refused.
    Refused {
        /// Where.
        place: Place,
        /// State asked for.
        requested: AlState,
        /// Register 0x0130.
        status: AlStatus,
        /// Register 0x0134.
        code: AlStatusCode,
    },
    /// A state was not reached in time.
    StateTimeout {
        /// Where.
        place: Place,
        /// State asked for.
        requested: AlState,
        /// Register 0x0130, last read.
        status: AlStatus,
        /// Register 0x0134, last read.
        code: AlStatusCode,
        /// Time waited.
        after: Nanos,
    },
    /// A mailbox service failed.
    Mailbox {
        /// Where.
        place: Place,
        /// How.
        error: MailboxError,
    },
    /// An object access failed.
    Sdo {
        /// Where.
        place: Place,
        /// The entry.
        object: ObjectAddress,
        /// How.
        error: SdoError,
    },
    /// A parameter of a drive cannot be written.
    Soe {
        /// Where.
        place: Place,
        /// Which drive of the SubDevice.
        drive: u8,
        /// The parameter.
        idn: Idn,
        /// How.
        error: SoeError,
    },
    /// An object does not hold the value written to it.
    ReadBack {
        /// Where.
        place: Place,
        /// The entry.
        object: ObjectAddress,
        /// Value written.
        written: u32,
        /// Value read.
        found: u32,
    },
    /// The configured mode is not possible.
    Mode {
        /// Where.
        place: Place,
        /// The configured mode.
        wish: SyncMode,
        /// The reason.
        reason: String,
    },
    /// The cycle does not fit a device.
    Plan {
        /// Where.
        place: Place,
        /// The line of the budget that fails, with both figures.
        line: Line,
    },
    /// The frames of a cycle take longer than the cycle.
    Frames {
        /// The line of the budget, with both figures.
        line: Line,
    },
    /// A mapping cannot be made.
    Mapping {
        /// Where.
        place: Place,
        /// How.
        problem: MappingProblem,
    },
    /// A clock did not converge to the reference.
    Drift {
        /// Where it was worst.
        place: Place,
        /// Register 0x092C.
        difference: Nanos,
        /// Slope, ns per second.
        slope_ppb: i64,
        /// Time waited.
        after: Nanos,
    },
    /// The host did not lock onto the reference clock.
    Phase {
        /// Last error.
        error: Nanos,
        /// Time waited.
        after: Nanos,
    },
    /// SYNC0 did not start.
    SyncNotStarted {
        /// Where.
        place: Place,
        /// Register 0x0981.
        activation: u8,
        /// Register 0x0984, where it exists.
        status: Option<ActivationStatus>,
        /// Register 0x0990: next pulse.
        next: Time<Dc>,
        /// Register 0x0910: now.
        now: Time<Dc>,
        /// SYNC0 cycle.
        cycle: Nanos,
    },
    /// Process data was not complete before the request of OP.
    ProcessData {
        /// Cycles tried.
        cycles: u64,
        /// Working counter expected in the first incomplete datagram.
        expected: u16,
        /// Working counter found.
        found: u16,
    },
    /// The ring of [`Config::ring`](crate::Config::ring) cannot be used.
    Ring(RingProblem),
    /// A setting is outside its range.
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// What it must be.
        expected: &'static str,
    },
}

/// Why a ring cannot be used.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum RingProblem {
    /// It is cut between SubDevices, but bring-up measures and configures them as one line from the
    /// primary port.
    Cut {
        /// SubDevices that answer to the primary port.
        near: u16,
        /// SubDevices that answer to the secondary port only.
        far: u16,
    },
    /// SubDevices process the frames from the secondary port although the ring is whole: the cables
    /// at the MainDevice or at a SubDevice are swapped, or a branch hangs behind the port towards
    /// the secondary port.
    Reverse,
    /// A branch hangs on a port that frames from the primary port no longer reach once they leave
    /// for the other end.
    Branch {
        /// Where.
        place: Place,
        /// The port of the branch.
        port: PortNumber,
    },
    /// The port towards the secondary port cannot be closed (register 0x0100).
    Open {
        /// Where.
        place: Place,
        /// The port.
        port: PortNumber,
    },
}

/// What is wrong with a SII.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SiiProblem {
    /// The EEPROM interface stayed busy.
    Busy,
    /// No access was acknowledged, up to the timeout: no EEPROM answers; register 0x0502.
    NoAcknowledge(u16),
    /// INIT was not confirmed, and the ESC did not load its EEPROM; register 0x0502.
    NotLoaded(u16),
    /// The EEPROM interface reports an error; register 0x0502.
    Status(u16),
    /// All bytes that were read have this value: nothing was ever written to the EEPROM.
    Blank(u8),
    /// No end mark within the largest size.
    NoEnd,
    /// Not read to its end in this time, although each access was answered.
    Slow {
        /// Time waited.
        after: Nanos,
    },
    /// A mailbox area is longer than a frame can carry.
    MailboxLength(u16),
    /// A mailbox area is not within the memory of an ESC (0x1000 to 0xFFFF).
    MailboxPlace(MailboxArea),
}

/// Why a mapping cannot be made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MappingProblem {
    /// More bytes than one datagram can carry.
    TooLong {
        /// Bytes mapped.
        length: u32,
        /// Most bytes.
        most: usize,
    },
    /// The assignment is fixed, but another one was configured.
    Fixed {
        /// 0x1C12 or 0x1C13.
        index: u16,
    },
    /// There is no SyncManager for this process data.
    NoSyncManager,
    /// The device is back with another mapping than the process image was planned with.
    Changed {
        /// Bytes of outputs and inputs planned.
        planned: (u16, u16),
        /// Bytes of outputs and inputs it now maps.
        found: (u16, u16),
    },
    /// Too few FMMUs.
    NoFmmu {
        /// FMMUs needed.
        needed: u8,
        /// Number of FMMUs available.
        found: u8,
    },
}

/// A datagram was lost, or had a wrong working counter.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct AccessError {
    /// The command.
    pub command: Command,
    /// The SubDevice and the register.
    pub address: Address,
    /// What happened.
    pub problem: AccessProblem,
}

/// What happened to a datagram.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AccessProblem {
    /// It did not come back, even after repetitions.
    Lost,
    /// It came back with this working counter.
    WorkingCounter {
        /// Expected.
        expected: u16,
        /// Found.
        found: u16,
    },
}

impl AccessError {
    /// Whether it did not come back.
    pub fn is_lost(&self) -> bool {
        self.problem == AccessProblem::Lost
    }
}

/// Why a mailbox service failed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MailboxError {
    /// A datagram failed.
    Access(AccessError),
    /// The device does not take the request from SM0.
    Full {
        /// Time waited.
        after: Nanos,
    },
    /// The device does not answer.
    NoAnswer {
        /// Time waited.
        after: Nanos,
    },
    /// The request is longer than the mailbox.
    TooLong {
        /// Bytes of the request.
        length: usize,
        /// Bytes of the mailbox.
        mailbox: u16,
    },
    /// The answer is shorter than its headers state.
    Short {
        /// Bytes available.
        length: usize,
    },
    /// The device answers with a mailbox error.
    Error(ErrorDetail),
    /// The answer has another protocol.
    Protocol(Protocol),
    /// The SubDevice has no such mailbox.
    Absent,
}

/// Why an object access failed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SdoError {
    /// An error below CoE.
    Mailbox(MailboxError),
    /// The device aborts.
    Abort(AbortCode),
    /// The answer is not a valid one.
    Answer {
        /// What was expected.
        expected: &'static str,
        /// Command byte, or service, found.
        found: u8,
    },
    /// The device announces more data than is accepted.
    TooLarge {
        /// Bytes announced.
        size: u32,
        /// Most bytes.
        most: u32,
    },
    /// The length of the data is not that of the object's description or type.
    Length {
        /// Bytes expected.
        expected: usize,
        /// Bytes found.
        found: usize,
    },
}

/// Why a parameter of a drive cannot be written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SoeError {
    /// An error below SoE.
    Mailbox(MailboxError),
    /// The drive refuses.
    Code(soe::ErrorCode),
}

impl From<MailboxError> for SoeError {
    fn from(error: MailboxError) -> Self {
        SoeError::Mailbox(error)
    }
}

impl From<MailboxError> for SdoError {
    fn from(error: MailboxError) -> Self {
        SdoError::Mailbox(error)
    }
}
impl From<AccessError> for MailboxError {
    fn from(error: AccessError) -> Self {
        MailboxError::Access(error)
    }
}
impl From<AccessError> for Cause {
    fn from(error: AccessError) -> Self {
        Cause::Access(error)
    }
}

impl Cause {
    /// Which part caused it.
    pub fn fault(&self) -> Fault {
        match self {
            Cause::Access(_)
            | Cause::Empty
            | Cause::Silent { .. }
            | Cause::Topology { .. }
            | Cause::Ring(_)
            | Cause::WayChanged { .. }
            | Cause::ProcessData { .. } => Fault::Segment,
            Cause::Count { .. }
            | Cause::Identity { .. }
            | Cause::NoSeat { .. }
            | Cause::Missing { .. }
            | Cause::Clock { .. }
            | Cause::Mode { .. }
            | Cause::Plan { .. }
            | Cause::Frames { .. }
            | Cause::Mapping { .. }
            | Cause::Setting { .. } => Fault::Configuration,
            _ => Fault::SubDevice,
        }
    }

    /// The name of the cause, for programs. It stays the same even if the message changes.
    pub const fn name(&self) -> &'static str {
        match self {
            Cause::Access(_) => "access",
            Cause::Empty => "untouched-frames",
            Cause::Silent { .. } => "no-frames",
            Cause::Count { .. } => "count",
            Cause::Topology { .. } => "topology",
            Cause::Identity { .. } => "identity",
            Cause::NoSeat { .. } => "no-seat",
            Cause::Missing { .. } => "missing",
            Cause::Clock { .. } => "clock",
            Cause::WayChanged { .. } => "way-changed",
            Cause::Sii { .. } => "sii",
            Cause::Refused { .. } => "state-refused",
            Cause::StateTimeout { .. } => "state-timeout",
            Cause::Mailbox { .. } => "mailbox",
            Cause::Sdo { .. } => "sdo",
            Cause::Soe { .. } => "soe",
            Cause::ReadBack { .. } => "read-back",
            Cause::Mode { .. } => "mode",
            Cause::Plan { .. } => "plan",
            Cause::Frames { .. } => "frames",
            Cause::Mapping { .. } => "mapping",
            Cause::Drift { .. } => "drift",
            Cause::Phase { .. } => "phase",
            Cause::SyncNotStarted { .. } => "sync-not-started",
            Cause::ProcessData { .. } => "process-data",
            Cause::Ring(_) => "ring",
            Cause::Setting { .. } => "setting",
        }
    }

    /// The AL status code (register 0x0134) of a failed state change; `None` for other causes.
    pub const fn al_status_code(&self) -> Option<AlStatusCode> {
        match self {
            Cause::Refused { code, .. } | Cause::StateTimeout { code, .. } => Some(*code),
            _ => None,
        }
    }

    /// The SubDevice at which it happened, if there is one.
    pub fn place(&self) -> Option<&Place> {
        match self {
            Cause::Identity { place, .. }
            | Cause::Missing { place }
            | Cause::Clock { place, .. }
            | Cause::WayChanged { place }
            | Cause::Sii { place, .. }
            | Cause::Refused { place, .. }
            | Cause::StateTimeout { place, .. }
            | Cause::Mailbox { place, .. }
            | Cause::Sdo { place, .. }
            | Cause::Soe { place, .. }
            | Cause::ReadBack { place, .. }
            | Cause::Mode { place, .. }
            | Cause::Plan { place, .. }
            | Cause::Mapping { place, .. }
            | Cause::Drift { place, .. }
            | Cause::SyncNotStarted { place, .. } => Some(place),
            _ => None,
        }
    }
}

/// The name of the cause.
impl Figured for Cause {
    fn figure(&self) -> Figure {
        Figure::Text(self.name().into())
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.stage, self.cause)
    }
}

impl core::error::Error for Error {}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Cause::Access(error) => write!(f, "{error}"),
            Cause::Empty => f.write_str(
                "frames come back untouched: working counter 0, expected at least 1 (a loop-back instead of \
                 SubDevices?)",
            ),
            Cause::Silent { sent, after, foreign } => {
                write!(
                    f,
                    "no frame came back in {after}: {sent} sent, 0 received, expected all (cable pulled, or \
                     no SubDevice behind it?)"
                )?;
                let Some((source, frames)) = foreign else { return Ok(()) };
                let [a, b, c, d, e, g] = source;
                write!(
                    f,
                    "; another EtherCAT MainDevice ({a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{g:02x}) sends on \
                     this wire, {frames} frames"
                )
            }
            Cause::Count { expected, found } => {
                write!(f, "{found} SubDevices answer, expected {expected}")
            }
            Cause::Topology { devices, ports } => {
                write!(f, "{devices} SubDevices answer, but their open ports lead to {}", ports + 1)
            }
            Cause::Identity { place, expected, found } => write!(
                f,
                "{place}: vendor {:#010x} product {:#010x}, expected vendor {:#010x} product {:#010x}",
                found.0, found.1, expected.0, expected.1
            ),
            Cause::NoSeat { place, found, several } => {
                let (vendor, product) = found;
                write!(f, "place {place} in the order of frames: vendor {vendor:#010x} product {product:#010x} ")?;
                match several {
                    true => write!(f, "may be more than one of those configured that may be absent"),
                    false => write!(f, "is none of those configured that may stand there"),
                }
            }
            Cause::Missing { place } => write!(f, "{place}: does not answer, and must be there"),
            Cause::WayChanged { place } => {
                write!(f, "{place}: frames take another way to it than when its delay was measured")
            }
            Cause::Clock { place, planned, found } => {
                let clock = |dc: &DcCapability| match dc {
                    DcCapability::None => "no DC unit",
                    DcCapability::ReceiveTimes => "receive times only",
                    DcCapability::Clock32 => "a clock of 32 bits",
                    DcCapability::Clock64 => "a clock of 64 bits",
                };
                write!(f, "{place}: has {}, planned with {}", clock(found), clock(planned))
            }
            Cause::Sii { place, problem } => write!(f, "{place}: {problem}"),
            Cause::Refused { place, requested, status, code } => {
                write!(f, "{place}: refuses {requested}, is in {status}, AL status code {code}")
            }
            Cause::StateTimeout { place, requested, status, code, after } => write!(
                f,
                "{place}: not in {requested} after {after}, is in {status}, AL status code {code}"
            ),
            Cause::Mailbox { place, error } => write!(f, "{place}: {error}"),
            Cause::Sdo { place, object, error } => write!(f, "{place}: {object}: {error}"),
            Cause::Soe { place, drive, idn, error } => {
                write!(f, "{place}: drive {drive}, {idn}: {error}")
            }
            Cause::ReadBack { place, object, written, found } => {
                write!(f, "{place}: {object} reads {found:#x} after {written:#x} was written")
            }
            Cause::Mode { place, wish, reason } => write!(f, "{place}: mode {wish}: {reason}"),
            Cause::Plan { place, line } => write!(f, "{place}: {line}"),
            Cause::Frames { line } => write!(f, "{line}"),
            Cause::Mapping { place, problem } => write!(f, "{place}: {problem}"),
            Cause::Drift { place, difference, slope_ppb, after } => write!(
                f,
                "{place}: clock still {difference} from the reference after {after}, moving {slope_ppb} \
                 ns/s"
            ),
            Cause::Phase { error, after } => write!(
                f,
                "host not locked onto the reference clock after {after}, last error {error}"
            ),
            Cause::SyncNotStarted { place, activation, status, next, now, cycle } => {
                let ahead = *next - *now;
                write!(
                    f,
                    "{place}: SYNC0 did not start: 0x0981 = {activation:#04x}, next pulse (0x0990) in \
                     {ahead}, expected within {cycle}"
                )?;
                match status {
                    Some(status) => write!(f, ", 0x0984 = {:#04x}", status.0),
                    None => Ok(()),
                }
            }
            Cause::ProcessData { cycles, expected, found } => write!(
                f,
                "process data incomplete in {cycles} cycles: working counter {found}, expected {expected}"
            ),
            Cause::Ring(problem) => write!(f, "ring: {problem}"),
            Cause::Setting { name, expected } => write!(f, "setting {name} must be {expected}"),
        }
    }
}

impl fmt::Display for RingProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RingProblem::Cut { near, far } => write!(
                f,
                "cut: {near} SubDevices answer to the primary port and {far} to the secondary port only, expected all \
                 to the primary port"
            ),
            RingProblem::Reverse => f.write_str(
                "SubDevices process what comes from the secondary port, expected from the primary port only (cables \
                 swapped, or a branch behind the port towards the secondary port?)",
            ),
            RingProblem::Branch { place, port } => write!(
                f,
                "{place}: a branch at port {port} lies behind the way to the secondary port, expected before it (ports \
                 0, 3, 1, 2)"
            ),
            RingProblem::Open { place, port } => write!(
                f,
                "{place}: port {port} stays open, expected closed (0x0100) while delays are measured"
            ),
        }
    }
}

impl fmt::Display for SiiProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SiiProblem::Busy => f.write_str("SII EEPROM stays busy (0x0502 bit 15)"),
            SiiProblem::NoAcknowledge(status) => write!(
                f,
                "no EEPROM answers (0x0502 = {status:#06x}, bit 13: no acknowledge); it is missing or dead, or its bus is \
                 held low"
            ),
            SiiProblem::NotLoaded(status) => {
                let why = match EepromStatus(*status) {
                    found if found.no_acknowledge() => "bit 13: no EEPROM answers",
                    found if found.0 & EepromStatus::CHECKSUM_ERROR != 0 => {
                        "bit 11: wrong checksum, as of a blank one"
                    }
                    _ => "bit 12: not loaded",
                };
                write!(
                    f,
                    "its ESC did not load the EEPROM (0x0502 = {status:#06x}, {why}), so nothing behind it takes the request \
                     of INIT"
                )
            }
            SiiProblem::Status(status) => write!(f, "SII EEPROM error, 0x0502 = {status:#06x}"),
            SiiProblem::Blank(byte) => write!(
                f,
                "the EEPROM is blank, {byte:#04x} in each byte that was read; expected an SII, nothing was ever written"
            ),
            SiiProblem::NoEnd => f.write_str("SII has no end mark 0xFFFF"),
            SiiProblem::Slow { after } => {
                write!(f, "SII not read within {after}: each access is answered, but late (0x0502)")
            }
            SiiProblem::MailboxLength(length) => {
                write!(f, "SII names a mailbox of {length} bytes, one datagram carries 16 to 1486")
            }
            SiiProblem::MailboxPlace(MailboxArea { start, length }) => write!(
                f,
                "SII names a mailbox of {length} bytes at {start:#06x}, the memory of an ESC goes \
                 from 0x1000 to 0xFFFF"
            ),
        }
    }
}

impl fmt::Display for MappingProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MappingProblem::TooLong { length, most } => {
                write!(f, "{length} bytes of process data, one datagram carries {most}")
            }
            MappingProblem::Fixed { index } => write!(
                f,
                "PDO assignment 0x{index:04X} is fixed and differs from the one asked for"
            ),
            MappingProblem::NoSyncManager => {
                f.write_str("process data are mapped but no SyncManager is there for them")
            }
            MappingProblem::Changed { planned, found } => write!(
                f,
                "mapping changed: {} + {} bytes of outputs and inputs, planned {} + {}",
                found.0, found.1, planned.0, planned.1
            ),
            MappingProblem::NoFmmu { needed, found } => {
                write!(f, "{needed} FMMUs needed, {found} there")
            }
        }
    }
}

impl fmt::Display for AccessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let command = self.command;
        match self.address {
            Address::Station(station, ado) => write!(f, "{command} {station}:{ado:#06x}")?,
            Address::Position(adp, ado) => {
                write!(f, "{command} position {}:{ado:#06x}", 0u16.wrapping_sub(adp.0))?;
            }
            Address::Broadcast(ado) => write!(f, "{command} {ado:#06x}")?,
            Address::Logical(address) => write!(f, "{command} {address:#010x}")?,
        }
        match self.problem {
            AccessProblem::Lost => f.write_str(": lost"),
            AccessProblem::WorkingCounter { expected, found } => {
                write!(f, ": working counter {found}, expected {expected}")
            }
        }
    }
}

impl fmt::Display for MailboxError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MailboxError::Access(error) => write!(f, "mailbox: {error}"),
            MailboxError::Full { after } => {
                write!(f, "mailbox request not taken within {after} (SM0 stays full)")
            }
            MailboxError::NoAnswer { after } => {
                write!(f, "no mailbox answer within {after} (SM1 stays empty)")
            }
            MailboxError::TooLong { length, mailbox } => {
                write!(f, "mailbox request of {length} bytes, the mailbox holds {mailbox}")
            }
            MailboxError::Short { length } => {
                write!(f, "mailbox answer of {length} bytes is shorter than its headers say")
            }
            MailboxError::Error(detail) => write!(f, "{detail}"),
            MailboxError::Protocol(found) => {
                write!(f, "mailbox answer of protocol {}, expected 3 (CoE)", found.0)
            }
            MailboxError::Absent => f.write_str("no CoE mailbox"),
        }
    }
}

impl fmt::Display for SdoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SdoError::Mailbox(error) => write!(f, "{error}"),
            SdoError::Abort(code) => write!(f, "abort {code}"),
            SdoError::Answer { expected, found } => {
                write!(f, "answer {found:#04x}, expected {expected}")
            }
            SdoError::TooLarge { size, most } => {
                write!(f, "{size} bytes announced, at most {most} are taken")
            }
            SdoError::Length { expected, found } => {
                write!(f, "{found} bytes, expected {expected}")
            }
        }
    }
}

impl fmt::Display for SoeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SoeError::Mailbox(error) => write!(f, "{error}"),
            SoeError::Code(code) => write!(f, "{code}"),
        }
    }
}

/// The bytes of an upload, or the reason of its failure.
pub(crate) type SdoResult = Result<Vec<u8>, SdoError>;
