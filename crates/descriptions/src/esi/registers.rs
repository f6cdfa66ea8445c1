//! Registers that the description orders a MainDevice to write.

use super::numbers::number;
use super::read::cut;
use super::tree::Element;
use super::warning::{WarningKind, Warnings};

/// `Device/ESC`: values for registers of the watchdogs; `None` where the file has none, so that the
/// chip keeps its own.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EsiRegisters {
    /// `Reg0400`: the unit of both times, 40 ns × (this + 2).
    pub divider: Option<u16>,
    /// `Reg0410`: the watchdog of the PDI.
    pub pdi: Option<u16>,
    /// `Reg0420`: the watchdog of the process data.
    pub process_data: Option<u16>,
}

/// Reads the registers. One that nothing here writes, or that no register can have, is a doubt,
/// unless it is to be 0.
pub(super) fn read(device: Element<'_>, warnings: &mut Warnings) -> EsiRegisters {
    let mut registers = EsiRegisters::default();
    let Some(element) = device.child("ESC") else { return registers };
    for child in element.elements() {
        let text = child.text();
        let value = number(&text).map(|found| found.value);
        let written = match child.name() {
            "Reg0400" => Some(&mut registers.divider),
            "Reg0410" => Some(&mut registers.pdi),
            "Reg0420" => Some(&mut registers.process_data),
            _ => None,
        };
        match (written, value.map(u16::try_from)) {
            (Some(register), Some(Ok(value))) => *register = Some(value),
            (None, Some(Ok(0))) => {}
            _ if text.trim().is_empty() => {}
            _ => warnings.add(WarningKind::RegisterUnused, child.at(), || {
                format!("<{}> = {} is not written", child.name(), cut(&text))
            }),
        }
    }
    registers
}
