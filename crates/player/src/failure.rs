//! Why a list could not be played to the end.

use std::fmt;

use isocat_descriptions::start_up::{Address, Transition};
use isocat_serve::bus::Refused;
use isocat_wire::al::AlStatusCode;
use isocat_wire::mailbox::ErrorDetail;
use isocat_wire::soe::{ErrorCode, Idn};
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, Command, ObjectAddress};

/// A failure, and its place in the list.
#[derive(Clone, PartialEq, Debug)]
pub struct Failure {
    /// The command that failed; `None`: it was between commands.
    pub place: Option<Box<Place>>,
    /// What happened.
    pub kind: Kind,
}

/// A command of the list.
#[derive(Clone, PartialEq, Debug)]
pub struct Place {
    /// Position and name of the device; `None` for the MainDevice's own commands.
    pub device: Option<(usize, String)>,
    /// The transition of the command.
    pub transition: Transition,
    /// What it accesses.
    pub target: Target,
    /// The list's comment on the command.
    pub comment: String,
}

/// What a command accesses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Target {
    /// Memory of devices: command and address.
    Register(Command, Address),
    /// An entry of the object dictionary.
    Object(ObjectAddress),
    /// A parameter of a drive, by SoE.
    Parameter(u8, Idn),
}

/// What failed.
#[derive(Clone, PartialEq, Debug)]
pub enum Kind {
    /// The frame did not come back.
    NoAnswer,
    /// The working counter differs from the one that the list expects.
    WorkingCounter {
        /// The expected working counter.
        expected: u16,
        /// The found working counter.
        found: u16,
    },
    /// A read did not return what the list expects (`Validate`).
    Check {
        /// The expected bytes.
        expected: Vec<u8>,
        /// The bytes that were read last.
        found: Vec<u8>,
        /// The AL status code, if AL status was read.
        code: Option<AlStatusCode>,
    },
    /// The device refused an SDO download.
    Abort(AbortCode),
    /// The device refused a parameter of a drive.
    Drive(ErrorCode),
    /// The mailbox of the device refused the request.
    Refused(ErrorDetail),
    /// A device took no mailbox request, or sent no answer, within the time that the list allows.
    Mailbox {
        /// The time that was waited.
        after: Nanos,
    },
    /// The list has an SDO download for a device without mailbox settings.
    NoMailbox,
    /// The value does not fit into the device's mailbox; segmented downloads are not supported.
    TooLong {
        /// Bytes of the value.
        length: usize,
        /// Bytes that fit.
        most: usize,
    },
    /// The cable of a device is not at port 0, so the way of frames through it is not known.
    SwappedCable {
        /// Position of the device.
        position: usize,
    },
    /// The open ports do not make a tree with this number of devices.
    Topology {
        /// Devices of the list.
        devices: usize,
        /// Open ports that lead away from the MainDevice.
        ports: usize,
    },
    /// The list writes the host's time into the reference clock, cyclically (bus shift).
    HostLeads,
    /// A device starts SYNC, but no cyclic datagram distributes the reference clock's time.
    NoDriftDatagram {
        /// Position of the device.
        position: usize,
    },
    /// The host's cycle did not lock on the reference clock.
    NotLocked {
        /// The last phase error.
        error: Nanos,
    },
    /// SYNC was started, but its next pulse (0x0990) is not in the future.
    NoPulses {
        /// Position of the device.
        position: usize,
    },
    /// Cyclic datagrams never had the working counters that the list expects.
    ProcessData {
        /// The expected working counter of the first wrong one.
        expected: u16,
        /// Its found working counter.
        found: u16,
    },
    /// The cycles of devices have no common period below 2.1 s.
    NoGrid,
    /// The frames of one cycle take longer than the cycle.
    CycleTooShort {
        /// Time from the first bit of the first frame until the last bit of the last one is back at
        /// the port.
        took: Nanos,
        /// The cycle.
        cycle: Nanos,
    },
    /// A frame of the list is longer than Ethernet allows.
    FrameTooLong {
        /// Its number in the list, from 0.
        frame: usize,
    },
    /// The virtual bus refused a frame.
    Bus(Refused),
    /// The number of SubDevices that answer differs from that of the list.
    Count {
        /// The number in the list.
        expected: usize,
        /// The number that answers.
        found: u16,
    },
    /// The SubDevice that answers differs from the one in the list.
    Identity {
        /// Its position.
        position: usize,
        /// Vendor id and product code in the list.
        expected: (u32, u32),
        /// Vendor id and product code in its SII.
        found: (u32, u32),
    },
    /// The SII of a SubDevice can't be read, so its identity is not known.
    NoIdentity {
        /// Its position.
        position: usize,
    },
    /// The interface failed.
    Interface(String),
    /// The user stopped the run.
    Ended,
}

impl Kind {
    /// A fixed name, for programs.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NoAnswer => "no-answer",
            Self::WorkingCounter { .. } => "working-counter",
            Self::Check { .. } => "check",
            Self::Abort(_) => "sdo-abort",
            Self::Drive(_) => "soe-error",
            Self::Refused(_) => "mailbox-error",
            Self::Mailbox { .. } => "mailbox",
            Self::NoMailbox => "no-mailbox",
            Self::TooLong { .. } => "value-too-long",
            Self::SwappedCable { .. } => "swapped-cable",
            Self::Topology { .. } => "topology",
            Self::HostLeads => "host-leads",
            Self::NoDriftDatagram { .. } => "no-drift-datagram",
            Self::NotLocked { .. } => "not-locked",
            Self::NoPulses { .. } => "no-pulses",
            Self::ProcessData { .. } => "process-data",
            Self::NoGrid => "no-grid",
            Self::CycleTooShort { .. } => "cycle-too-short",
            Self::FrameTooLong { .. } => "frame-too-long",
            Self::Bus(_) => "bus",
            Self::Count { .. } => "count",
            Self::Identity { .. } => "identity",
            Self::NoIdentity { .. } => "no-identity",
            Self::Interface(_) => "interface",
            Self::Ended => "ended",
        }
    }

    /// Whether the list requires something that the player does not support, or belongs to another
    /// segment, so that a run says nothing about the segment.
    pub fn is_refused(&self) -> bool {
        matches!(
            self,
            Self::NoMailbox
                | Self::TooLong { .. }
                | Self::SwappedCable { .. }
                | Self::HostLeads
                | Self::NoDriftDatagram { .. }
                | Self::NoGrid
                | Self::FrameTooLong { .. }
                | Self::Bus(_)
                | Self::Count { .. }
                | Self::Identity { .. }
                | Self::NoIdentity { .. }
        )
    }
}

impl Failure {
    /// The failure for a reader who already knows the SubDevice: its position, and the description
    /// without it.
    pub(crate) fn of_device(&self) -> (Option<usize>, String) {
        match self.place.as_ref().and_then(|place| Some((place, place.device.as_ref()?.0))) {
            None => (None, self.to_string()),
            Some((place, position)) => {
                let comment = match place.comment.as_str() {
                    "" => String::new(),
                    comment => format!(" \"{comment}\""),
                };
                let Place { transition, target, .. } = &**place;
                (Some(position), format!("{transition}, {target}{comment}: {}", self.kind))
            }
        }
    }

    /// Position of the SubDevice; `None`: the failure is about none.
    pub fn position(&self) -> Option<usize> {
        match (&self.place, &self.kind) {
            (Some(place), _) => place.device.as_ref().map(|(position, _)| *position),
            (
                None,
                Kind::SwappedCable { position }
                | Kind::NoDriftDatagram { position }
                | Kind::NoPulses { position }
                | Kind::Identity { position, .. }
                | Kind::NoIdentity { position },
            ) => Some(*position),
            (None, _) => None,
        }
    }
}

impl From<Kind> for Failure {
    fn from(kind: Kind) -> Self {
        Self { place: None, kind }
    }
}

impl From<Refused> for Kind {
    fn from(refused: Refused) -> Self {
        Self::Bus(refused)
    }
}

impl From<Refused> for Failure {
    fn from(refused: Refused) -> Self {
        Kind::Bus(refused).into()
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            Some(place) => write!(f, "{place}: {}", self.kind),
            None => write!(f, "{}", self.kind),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.device {
            Some((position, name)) => write!(f, "SubDevice {position} ({name}), ")?,
            None => write!(f, "commands of the MainDevice, ")?,
        }
        write!(f, "{}, {}", self.transition, self.target)?;
        if self.comment.is_empty() { Ok(()) } else { write!(f, " \"{}\"", self.comment) }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Register(command, Address::Physical { register, .. }) => {
                write!(f, "{command} of 0x{register:04X}")
            }
            Self::Register(command, Address::Logical(address)) => {
                write!(f, "{command} of 0x{address:08X}")
            }
            Self::Object(object) => write!(f, "object {object}"),
            Self::Parameter(drive, idn) => write!(f, "{idn} of drive {drive}"),
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoAnswer => f.write_str("the frame did not come back"),
            Self::WorkingCounter { expected, found } => {
                write!(f, "working counter {found}; expected {expected}")
            }
            Self::Check { expected, found, code } => {
                write!(f, "read {}; expected {}", hex(found), hex(expected))?;
                let code = code.filter(|code| *code != AlStatusCode::NO_ERROR);
                code.map_or(Ok(()), |code| write!(f, "; AL status code 0x{:04X}, {code}", code.0))
            }
            Self::Abort(code) => write!(f, "the device refuses the value: {code}"),
            Self::Drive(code) => write!(f, "the drive refuses the value: {code}"),
            Self::Refused(detail) => write!(f, "the device refuses the request: {detail}"),
            Self::Mailbox { after } => write!(f, "no answer from the mailbox within {after}"),
            Self::NoMailbox => {
                f.write_str("a write through the mailbox, but the list tells no mailbox (Mailbox/Send, Recv)")
            }
            Self::TooLong { length, most } => write!(
                f,
                "a value of {length} bytes; expected {most} at most, as segmented downloads are not supported here"
            ),
            Self::SwappedCable { position } => write!(
                f,
                "the cable that leads to SubDevice {position} is not in its port 0; expected port 0"
            ),
            Self::Topology { devices, ports } => write!(
                f,
                "{devices} SubDevices hang on {ports} open ports; expected one port less than SubDevices"
            ),
            Self::HostLeads => f.write_str(
                "a cyclic command writes the host's time into the reference clock (0x0910); expected ARMW or FRMW \
                 alone, as a host that leads is not supported here",
            ),
            Self::NoDriftDatagram { position } => write!(
                f,
                "SubDevice {position} starts SYNC, but no cyclic command distributes the time (ARMW or FRMW of 0x0910)"
            ),
            Self::NotLocked { error } => {
                write!(f, "the cycle did not come into step with the reference clock; it is off by {error}")
            }
            Self::NoPulses { position } => write!(
                f,
                "SYNC of SubDevice {position} was started, and its next pulse (0x0990) is not ahead"
            ),
            Self::ProcessData { expected, found } => write!(
                f,
                "process data are never complete: working counter {found}; expected {expected}"
            ),
            Self::NoGrid => {
                f.write_str("the cycles of the SubDevices have no common multiple below 2.1 s")
            }
            Self::CycleTooShort { took, cycle } => write!(
                f,
                "the frames of a cycle take {took}; expected less than the cycle of {cycle}"
            ),
            Self::FrameTooLong { frame } => {
                write!(f, "cyclic frame {frame} is too long; expected 1514 bytes at most")
            }
            Self::Bus(refused) => write!(f, "the virtual bus refuses: {refused}"),
            Self::Count { expected, found } => {
                write!(f, "{found} SubDevices answer; expected {expected}, as the ENI names them")
            }
            Self::Identity { position, expected, found } => write!(
                f,
                "SubDevice {position} is vendor 0x{:08X}, product 0x{:08X}; expected vendor 0x{:08X}, product 0x{:08X}, \
                 as the ENI names it",
                found.0, found.1, expected.0, expected.1
            ),
            Self::NoIdentity { position } => write!(
                f,
                "the SII of SubDevice {position} can't be read; expected its vendor id and product code there"
            ),
            Self::Interface(error) => f.write_str(error),
            Self::Ended => f.write_str("ended by a signal"),
        }
    }
}

impl std::error::Error for Failure {}

/// Bytes as hexadecimal digits, as in the file.
fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
