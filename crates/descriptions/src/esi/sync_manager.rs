//! SyncManagers, with their purpose by control byte.

use isocat_wire::sync_manager::SyncManager;

use super::pdo::Direction;
use super::read::{self, U8, U16, cut};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// `Device/Sm`; its place in the list is its number.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct EsiSyncManager {
    /// Byte offset in the text.
    pub at: usize,
    /// Its purpose.
    pub purpose: Purpose,
    /// First byte of its memory.
    pub start: u16,
    /// Configured length in bytes: that of a mailbox; for process data only a hint, since the PDOs
    /// define it.
    pub default_size: u16,
    /// Largest length in bytes; `None` if it is fixed or not stated.
    pub max_size: Option<u16>,
    /// Control byte, register 0x0804 + 8n; `None` if the file has none.
    pub control: Option<u8>,
    /// Activation as written; it is no flag, despite its name.
    pub enable: Option<u8>,
    /// Whether it is enabled only in OP.
    pub op_only: bool,
}

/// Purpose of a SyncManager.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Purpose {
    /// Mailbox, MainDevice to SubDevice.
    MailboxOut,
    /// Mailbox, SubDevice to MainDevice.
    MailboxIn,
    /// Process data, MainDevice to SubDevice.
    Outputs,
    /// Process data, SubDevice to MainDevice.
    Inputs,
    /// No SyncManager at all: a window that an FMMU alone maps, as a rule to registers. The
    /// direction is that of its text; a text of a mailbox gives none, and nothing can be assigned
    /// to it.
    Window(Option<Direction>),
}

impl EsiSyncManager {
    /// Whether process data use a single buffer, like a mailbox.
    pub fn one_buffer(&self) -> bool {
        self.control.is_some_and(|control| control & BUFFER_MODE == ONE_BUFFER)
    }
}

/// Reads all SyncManagers of a device.
pub(super) fn read(
    device: Element<'_>,
    warnings: &mut Warnings,
) -> Result<Vec<EsiSyncManager>, Problem> {
    let mut all = Vec::new();
    let has_mailbox = device.child("Mailbox").is_some();
    for element in device.children("Sm") {
        if all.len() == MOST {
            let message = format!("more than {MOST} SyncManagers; an ESC has no more");
            return Err(Problem::new(element.at(), message));
        }
        all.push(one(element, has_mailbox, warnings)?);
    }
    Ok(all)
}

fn one(
    element: Element<'_>,
    has_mailbox: bool,
    warnings: &mut Warnings,
) -> Result<EsiSyncManager, Problem> {
    let at = element.at();
    let text = element.text();
    let control = read::attribute(element, "ControlByte", U8, warnings)?.map(|byte| byte as u8);
    let named = match &*text {
        "MBoxOut" => Some(Purpose::MailboxOut),
        "MBoxIn" => Some(Purpose::MailboxIn),
        "Outputs" | "DynamicOutputs" => Some(Purpose::Outputs),
        "Inputs" | "DynamicInputs" => Some(Purpose::Inputs),
        _ => None,
    };
    let purpose = if read::flag(element, "Virtual")? {
        let direction = match named {
            Some(Purpose::Inputs) => Some(Direction::Inputs),
            Some(Purpose::Outputs) => Some(Direction::Outputs),
            _ => None,
        };
        if direction != Some(Direction::Inputs) {
            warnings.add(WarningKind::SyncManagerVirtual, at, || {
                format!(
                    "\"{}\" is a window without SyncManager; one of inputs is mapped, and no other",
                    cut(&text)
                )
            });
        }
        Purpose::Window(direction)
    } else if let Some(control) = control {
        let purpose = by_control(control, named, has_mailbox);
        match named {
            None => warnings.add(WarningKind::SyncManagerName, at, || {
                format!(
                    "\"{}\" says nothing; control byte {control:#04x} is {purpose:?}",
                    cut(&text)
                )
            }),
            Some(named) if named != purpose => {
                warnings.add(WarningKind::SyncManagerNameContradicts, at, || {
                    format!(
                        "\"{}\" by name, but control byte {control:#04x} is {purpose:?}",
                        cut(&text)
                    )
                });
            }
            _ => {}
        }
        purpose
    } else {
        let Some(named) = named else {
            let message = format!(
                "SyncManager \"{}\" has no ControlByte; expected one, or a text such as Outputs",
                cut(&text)
            );
            return Err(Problem::new(at, message));
        };
        warnings.add(WarningKind::SyncManagerWithoutControl, at, || {
            format!("\"{}\" without ControlByte; the usual one is taken", cut(&text))
        });
        named
    };
    let enable = read::attribute(element, "Enable", U8, warnings)?.map(|enable| enable as u8);
    if let Some(odd) = enable.filter(|enable| *enable > 1) {
        warnings.add(WarningKind::SyncManagerEnable, at, || {
            format!("Enable = {odd} is neither 0 nor 1; it is taken as {}", odd & 1)
        });
    }
    let process_data = matches!(purpose, Purpose::Outputs | Purpose::Inputs);
    let found = EsiSyncManager {
        at,
        purpose,
        start: read::attribute(element, "StartAddress", U16, warnings)?.unwrap_or(0) as u16,
        default_size: read::attribute(element, "DefaultSize", U16, warnings)?.unwrap_or(0) as u16,
        max_size: read::attribute(element, "MaxSize", U16, warnings)?.map(|size| size as u16),
        control,
        enable,
        op_only: read::flag(element, "OpOnly")?,
    };
    if process_data && found.one_buffer() {
        warnings.add(WarningKind::SyncManagerOneBuffer, at, || {
            format!(
                "{purpose:?} go through one buffer (control byte {:#04x}): {}",
                found.control.unwrap_or(0),
                match purpose {
                    Purpose::Outputs => {
                        "it takes no outputs before the device fetched those before, so that a second \
                         frame in its cycle lacks their working counter; one frame for each cycle of \
                         the device, in phase with it (DC SYNC0)"
                    }
                    _ => {
                        "it gives each set of inputs once, so that a frame before the next set lacks \
                         their working counter; one frame for each cycle of the device, in phase with \
                         it (DC SYNC0)"
                    }
                }
            )
        });
    }
    Ok(found)
}

/// The purpose by control byte: bits 3:2 are the direction, bits 1:0 the buffers. One buffer means
/// a mailbox only if the device has one and does not name the SyncManager process data.
pub(super) fn by_control(control: u8, named: Option<Purpose>, has_mailbox: bool) -> Purpose {
    let writes = control & SyncManager::CONTROL_ECAT_WRITES != 0;
    let called_process_data = matches!(named, Some(Purpose::Outputs | Purpose::Inputs));
    let one_buffer = control & BUFFER_MODE == ONE_BUFFER;
    match (one_buffer && (has_mailbox || named.is_some()) && !called_process_data, writes) {
        (true, true) => Purpose::MailboxOut,
        (true, false) => Purpose::MailboxIn,
        (false, true) => Purpose::Outputs,
        (false, false) => Purpose::Inputs,
    }
}

const BUFFER_MODE: u8 = 0x03;
const ONE_BUFFER: u8 = 0x02;
/// Registers 0x0800 to 0x087F.
pub(super) const MOST: usize = 16;
