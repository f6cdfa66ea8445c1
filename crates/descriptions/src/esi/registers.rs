//! Registers that the description orders a MainDevice to write.

use super::read::{self, U16};
use super::tree::{Element, Problem};
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

/// Reads the registers. One that nothing here writes is a doubt, unless it is to be 0.
pub(super) fn read(device: Element<'_>, warnings: &mut Warnings) -> Result<EsiRegisters, Problem> {
    let Some(element) = device.child("ESC") else { return Ok(EsiRegisters::default()) };
    let mut of = |name| {
        let value = read::child(element, name, U16, warnings)?;
        Ok(value.map(|value| value as u16))
    };
    let registers =
        EsiRegisters { divider: of("Reg0400")?, pdi: of("Reg0410")?, process_data: of("Reg0420")? };
    for child in element.elements() {
        let name = child.name();
        let is_zero = super::numbers::number(&child.text()).is_some_and(|found| found.value == 0);
        if !["Reg0400", "Reg0410", "Reg0420"].contains(&name) && !is_zero {
            warnings.add(WarningKind::RegisterUnused, child.at(), || {
                format!("<{name}> = {} is not written", read::cut(&child.text()))
            });
        }
    }
    Ok(registers)
}
