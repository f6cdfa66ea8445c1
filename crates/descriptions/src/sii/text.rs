//! The content of an SII file, as text for a terminal.

use std::fmt::{self, Write};

use isocat_wire::coe::DataType;
use isocat_wire::time::Nanos;

use super::report::{DoubtReport, Mailbox, OpMode, Pdo, Report, SyncManager};
use super::{DoubtKind, SiiFile};
use crate::columns::{WIDTH, wrap};

impl SiiFile {
    /// The content of the file in plain words.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.report().write(&mut text);
        text
    }
}

impl Report {
    fn write(&self, out: &mut String) -> fmt::Result {
        if self.doubts.iter().any(|doubt| doubt.kind == DoubtKind::Blank.name()) {
            writeln!(out, "{}: nothing was ever written to it", self.file)?;
            writeln!(out, "  EEPROM        {} bytes", self.bytes)?;
            return self.write_doubts(out);
        }
        let name = if self.name.is_empty() { "a device without a name" } else { &self.name };
        writeln!(out, "{}: {}", self.file, printable(name))?;
        writeln!(
            out,
            "  identity      vendor {:#010x}, product {:#010x}, revision {:#010x}, serial {:#x}",
            self.vendor_id, self.product_code, self.revision, self.serial
        )?;
        if !self.order.is_empty() || !self.group.is_empty() {
            let (order, group) = (printable(&self.order), printable(&self.group));
            writeln!(out, "  type          {order}, group \"{group}\"")?;
        }
        writeln!(out, "  EEPROM        {} bytes, {} used", self.bytes, self.bytes_used)?;
        self.write_esc(out)?;
        self.write_mailbox(out)?;
        if let Some(ports) = &self.ports {
            let ports = if ports.is_empty() { "none" } else { ports };
            writeln!(out, "  ports         {ports} (Y MII, K EBUS, H fast hot connect)")?;
        }
        match self.ebus_ma {
            Some(ma @ 1..) => writeln!(out, "  EBUS          takes {ma} mA")?,
            Some(ma @ ..=-1) => writeln!(out, "  EBUS          feeds {} mA", -i32::from(ma))?,
            _ => {}
        }
        if !self.fmmus.is_empty() {
            writeln!(out, "  FMMUs         {}", self.fmmus.join(", "))?;
        }
        for (number, sm) in self.sync_managers.iter().enumerate() {
            let flags =
                [(sm.enabled, "on"), (sm.is_virtual, "virtual"), (sm.op_only, "in OP only")];
            let flags = flags.iter().filter(|(is, _)| *is).map(|(_, word)| format!(", {word}"));
            writeln!(
                out,
                "  SyncManager {number} {}: {} bytes at {:#06x}, control {:#04x}{}",
                sm.purpose,
                sm.length,
                sm.start,
                sm.control,
                flags.collect::<String>()
            )?;
            self.write_empty(out, number, sm)?;
        }
        for (direction, pdos) in [("TxPDO", &self.tx_pdos), ("RxPDO", &self.rx_pdos)] {
            for pdo in pdos {
                write_pdo(out, direction, pdo)?;
            }
        }
        for (number, mode) in self.op_modes.iter().enumerate() {
            write_op_mode(out, number, mode)?;
        }
        for category in &self.other_categories {
            let (kind, bytes) = (category.kind, category.data.len() / 2);
            let words = match kind {
                20 => " (data types)",
                42 => " (FMMU extensions)",
                43 => " (sync units)",
                0x0800.. => " (of the maker)",
                _ => "",
            };
            let data = crate::columns::cut(&category.data, 40);
            writeln!(out, "  category {kind}{words}, kept as it is: {bytes} bytes {data}")?;
        }
        self.write_doubts(out)
    }

    /// What keeps from OP, then lesser doubts, then what to do, each remedy once.
    fn write_doubts(&self, out: &mut String) -> fmt::Result {
        let heads = [(true, "this EEPROM can't bring a device to OP"), (false, "doubts")];
        for (keeps, head) in heads {
            let of_head = || self.doubts.iter().filter(|doubt| doubt.keeps_from_op == keeps);
            if of_head().next().is_none() {
                continue;
            }
            writeln!(out, "\n{head}")?;
            for doubt in of_head() {
                let DoubtReport { kind, word, expected, found, .. } = doubt;
                item(
                    out,
                    &format!("word {word:#06x}: {kind}: expected {expected}, found {found}"),
                )?;
            }
        }
        let mut told: Vec<&str> = Vec::new();
        let (first, then): (Vec<_>, Vec<_>) =
            self.doubts.iter().partition(|doubt| doubt.keeps_from_op);
        for remedy in first.into_iter().chain(then).flat_map(|doubt| doubt.remedies) {
            if told.is_empty() {
                writeln!(out, "\nwhat to do")?;
            }
            if !told.contains(remedy) {
                told.push(remedy);
                item(out, remedy)?;
            }
        }
        Ok(())
    }

    fn write_esc(&self, out: &mut String) -> fmt::Result {
        let mut words = vec![match (self.sync_unit, self.pulse_ns) {
            (false, _) => "SYNC unit not switched on".to_owned(),
            (true, 0) => "SYNC unit on, pulses that the device's program ends".to_owned(),
            (true, ns) => format!("SYNC unit on, pulses of {}", Nanos(ns.into())),
        }];
        if self.device_emulation {
            words.push("device emulation".to_owned());
        }
        if self.alias != 0 {
            words.push(format!("alias {}", self.alias));
        }
        writeln!(out, "  ESC           {} ({})", words.join(", "), self.configuration)
    }

    /// A SyncManager for process data that the EEPROM gives no byte, or no PDO for its bytes: what
    /// becomes of it.
    fn write_empty(&self, out: &mut String, number: usize, sm: &SyncManager) -> fmt::Result {
        let mut pdos = self.tx_pdos.iter().chain(&self.rx_pdos);
        let is_assigned = pdos.any(|pdo| pdo.sync_manager.map(usize::from) == Some(number));
        let is_process_data = matches!(&*sm.purpose, "outputs" | "inputs") && !sm.is_virtual;
        let has_coe = self.protocols.iter().any(|protocol| protocol == "CoE");
        let has_pdos = !self.tx_pdos.is_empty() || !self.rx_pdos.is_empty();
        if is_process_data && sm.enabled && sm.length > 0 && !has_pdos {
            let (direction, category) = match &*sm.purpose {
                "outputs" => ("RxPDO", 51),
                _ => ("TxPDO", 50),
            };
            writeln!(out, "    no {direction} for its bytes in the EEPROM (category {category})")?;
            let object = 0x1C10 + number;
            return match has_coe {
                true => writeln!(
                    out,
                    "    its PDOs must come from object 0x{object:04X} or the description (ESI)"
                ),
                false => writeln!(out, "    its PDOs must come from the description (ESI)"),
            };
        }
        if !is_process_data || sm.length > 0 || is_assigned {
            return Ok(());
        }
        let unless = match has_coe {
            true => format!(" unless 0x{:04X} assigns PDOs", 0x1C10 + number),
            false => String::new(),
        };
        writeln!(out, "    no PDO of the EEPROM is assigned to it: it stays off{unless}")
    }

    fn write_mailbox(&self, out: &mut String) -> fmt::Result {
        let Some(mailbox) = &self.mailbox else { return writeln!(out, "  mailbox       none") };
        let (protocols, coe) = (self.protocols.join(", "), self.coe.join(", "));
        writeln!(out, "  mailbox       {}: {protocols}", areas(mailbox))?;
        if let Some(boot) = &self.boot_mailbox {
            writeln!(out, "  in BOOT       {}", areas(boot))?;
        }
        match coe.is_empty() {
            true => Ok(()),
            false => writeln!(out, "  CoE           {coe}"),
        }
    }
}

/// An item of a list, wrapped.
fn item(out: &mut String, words: &str) -> fmt::Result {
    for (i, line) in wrap(words, WIDTH - 4).into_iter().enumerate() {
        writeln!(out, "  {} {line}", if i == 0 { "-" } else { " " })?;
    }
    Ok(())
}

fn areas(mailbox: &Mailbox) -> String {
    let Mailbox { receive_start, receive_length, send_start, send_length } = mailbox;
    format!(
        "receives {receive_length} bytes at {receive_start:#06x}, sends {send_length} at {send_start:#06x}"
    )
}

fn write_pdo(out: &mut String, direction: &str, pdo: &Pdo) -> fmt::Result {
    let place = match pdo.sync_manager {
        Some(number) => format!("SyncManager {number}"),
        None => "not assigned".to_owned(),
    };
    let bits: u32 = pdo.entries.iter().map(|entry| u32::from(entry.bits)).sum();
    let flags = [(pdo.mandatory, ", mandatory"), (pdo.fixed, ", fixed")];
    let flags: String = flags.iter().filter(|(is, _)| *is).map(|(_, word)| *word).collect();
    let name = printable(&pdo.name);
    writeln!(out, "  {direction} 0x{:04X} {name}: {bits} bits, {place}{flags}", pdo.index)?;
    for entry in &pdo.entries {
        let name = printable(&entry.name);
        match entry.index {
            0 => writeln!(out, "    {} bits of padding", entry.bits)?,
            index => {
                let kind = DataType(entry.data_type.into()).name().unwrap_or("unknown type");
                writeln!(
                    out,
                    "    0x{index:04X}:{:02X} {name}: {kind}, {} bits",
                    entry.sub, entry.bits
                )?;
            }
        }
    }
    Ok(())
}

fn write_op_mode(out: &mut String, number: usize, mode: &OpMode) -> fmt::Result {
    let (name, description) = (printable(&mode.name), printable(&mode.description));
    write!(out, "  OpMode {number} \"{name}\" {description}: {:#06x}", mode.assign_activate)?;
    match (mode.cycle_time_0_ns, mode.sync0_factor) {
        (0, 0) => {}
        (0, factor) => write!(out, ", SYNC0 factor {factor}")?,
        (ns, _) => write!(out, ", SYNC0 cycle {}", Nanos(ns.into()))?,
    }
    if mode.sync1_factor != 0 {
        write!(out, ", SYNC1 factor {}", mode.sync1_factor)?;
    }
    for (name, shift) in [("SYNC0", mode.shift_time_0_ns), ("SYNC1", mode.shift_time_1_ns)] {
        if shift != 0 {
            write!(out, ", {name} shift {}", Nanos(shift.into()))?;
        }
    }
    writeln!(out)
}

/// A text in one line, without characters that move a terminal's cursor.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '·' } else { c }).collect()
}
