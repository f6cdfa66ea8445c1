//! One SubDevice in words.

use std::fmt::{self, Write};

use isocat_descriptions::columns::{WIDTH, cut, wrap};
use isocat_sync::object::sub;
use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;

use super::super::objects::NOT_STATED_AS_0;
use super::super::{Delay, Device, Port, PortKind, ProcessData, ScanReport, State, SyncObject};

/// Columns of a heading.
const HEAD: usize = 15;

impl ScanReport {
    /// Writes the block of a SubDevice, or all its details.
    pub(super) fn write_device(
        &self,
        out: &mut String,
        device: &Device,
        full: bool,
    ) -> fmt::Result {
        let order = match device.order.as_str() {
            "" => String::new(),
            order => format!(", order number {order}"),
        };
        let name = if device.name.is_empty() { "without name" } else { &device.name };
        let head = format!("SubDevice {}: {name}{order}", device.position);
        writeln!(out, "{}", cut(&head, WIDTH))?;
        let mut line = |head: &str, text: String| -> fmt::Result {
            for (i, line) in wrap(&text, WIDTH - HEAD - 2).iter().enumerate() {
                writeln!(out, "  {:<HEAD$}{line}", if i == 0 { head } else { "" })?;
            }
            Ok(())
        };
        line("identity", identity(device))?;
        line("ESC", esc(device))?;
        if full {
            let features = device.esc.features_in_words.join(", ");
            line("features", format!("{:#06x}: {features}", device.esc.features))?;
        }
        for port in
            device.ports.iter().filter(|port| full || port.link || port.kind != PortKind::None)
        {
            line(if port.port == 0 { "ports" } else { "" }, self.port(port))?;
        }
        line("DC", self.dc(device, full))?;
        let reference = self.reference == Some(device.position);
        line(
            "delay",
            if reference {
                "0 ns: the reference clock".to_owned()
            } else {
                self::delay(&device.delay)
            },
        )?;
        line("clock", self.clock(device))?;
        for (i, manager) in device.sync_managers.iter().enumerate() {
            let window = if manager.window { "window of " } else { "" };
            let mut text = format!(
                "{}: {window}{}, {} bytes at {:#06x}",
                manager.number, manager.use_in_sii, manager.length, manager.start
            );
            if let Some(object) =
                manager.use_in_object.as_ref().filter(|u| **u != manager.use_in_sii)
            {
                text += &format!(", {object} by 0x1C00");
            }
            if full {
                let off = if manager.enabled { "" } else { ", off" };
                text += &format!("; {:#04x}: {}{off}", manager.control, manager.control_in_words);
            }
            line(if i == 0 { "SyncManagers" } else { "" }, text)?;
        }
        line("mailbox", mailbox(device))?;
        line("outputs", process_data(&device.outputs))?;
        line("inputs", process_data(&device.inputs))?;
        for (i, mode) in device.op_modes.iter().enumerate() {
            let word = AssignActivate(mode.assign_activate);
            let mut text = format!("{:#06x}: ", word.0);
            match word.activates() {
                false => text += "SYNC off",
                true => {
                    let shift = |ns: i32| Nanos(ns.into());
                    text += &format!(
                        "SYNC0 cycle {}, shift {}; SYNC1 factor {}, shift {}",
                        cycle(mode.sync0_cycle_ns, mode.sync0_factor),
                        shift(mode.sync0_shift_ns),
                        mode.sync1_factor,
                        shift(mode.sync1_shift_ns),
                    );
                }
            }
            line(if i == 0 { "OpModes" } else { "" }, text)?;
            if full {
                line("", format!("  {}", mode.in_words))?;
            }
        }
        let before = device.state_before.as_ref().map_or("not known".to_owned(), state);
        line("state", format!("{}; before the scan {before}", state(&device.state)))?;
        if full {
            write_pdos(out, device)?;
        }
        for object in [&device.output_sync, &device.input_sync].into_iter().flatten() {
            write_sync_object(out, object, full)?;
        }
        Ok(())
    }

    fn port(&self, port: &Port) -> String {
        let word = |set: bool, yes, no| if set { yes } else { no };
        let mut text = format!(
            "{}: {}, {}, {}, loop {}",
            port.port,
            port.kind,
            word(port.link, "link", "no link"),
            word(port.signal, "signal", "no signal"),
            word(port.loop_closed, "closed", "open")
        );
        if port.entry {
            text += "; frames come in here";
        }
        if let Some(below) = port.leads_to {
            text += &format!("; leads to SubDevice {below}");
        }
        text
    }

    fn dc(&self, device: &Device, full: bool) -> String {
        let esc = &device.esc;
        let mut text = match esc.dc.as_str() {
            "none" => "none".to_owned(),
            "receive-times" => "receive times, no system time".to_owned(),
            bits => format!("system time of {}", bits.replace('-', " ")),
        };
        let on = |on: bool| if on { "on" } else { "off" };
        text += &format!(
            "; SYNC unit {}, latch unit {} (0x0141)",
            on(esc.sync_unit),
            on(esc.latch_unit)
        );
        match esc.sync_pulse_ns.filter(|_| full) {
            Some(0) => text += "; SYNC pulses last until they are acknowledged (SII word 2)",
            Some(pulse) => text += &format!("; SYNC pulses of {} (SII word 2)", Nanos(pulse)),
            None => {}
        }
        if let (true, Some(word)) = (full, esc.sync_latch) {
            text += &format!("; 0x0151 = {word:#04x}: {}", esc.pins.join("; "));
        }
        text
    }

    fn clock(&self, device: &Device) -> String {
        let clock = &device.clock;
        let mut parts = Vec::new();
        match (clock.speed_ppm, clock.speed_error_ppm, clock.speed_window_ns, self.reference) {
            (Some(_), _, _, Some(reference)) if reference == device.position => {
                parts.push("the reference clock".to_owned());
            }
            (Some(ppm), Some(error), Some(window), Some(reference)) => {
                // To the ms: the window is as long as the host slept.
                let window = Nanos((window + 500_000) / 1_000_000 * 1_000_000);
                parts.push(format!(
                    "{ppm:+.2} ppm \u{b1}{error:.2} against SubDevice {reference} when \
                        nobody leads it (two latches, \
                     {window} apart)"
                ));
            }
            _ => parts.push("speed not known".to_owned()),
        }
        if let (Some(correction), Some(start)) = (clock.correction, clock.correction_start) {
            parts.push(format!("0x0932 = {correction} at 0x0930 = {start:#06x}"));
        }
        if let Some(difference) = clock.system_time_difference_ns {
            parts.push(format!("0x092C = {difference} ns"));
        }
        parts.join("; ")
    }
}

fn identity(device: &Device) -> String {
    let alias = match device.alias {
        Some(alias) if alias == device.sii_alias => format!("alias {alias}"),
        Some(alias) => format!("alias {alias} (SII: {})", device.sii_alias),
        None => format!("alias in the SII {}", device.sii_alias),
    };
    format!(
        "vendor {:#010x}, product {:#010x}, revision {:#010x}, serial {:#010x}, \
            {alias}; station address {:#06x}",
        device.vendor_id,
        device.product_code,
        device.revision,
        device.serial,
        device.station_address
    )
}

fn esc(device: &Device) -> String {
    let esc = &device.esc;
    let mut text = format!(
        "{} ({:#04x}), revision {:#04x}, build {:#06x}; {} FMMUs, {} SyncManagers, {} KiB",
        esc.kind_name, esc.kind, esc.revision, esc.build, esc.fmmus, esc.sync_managers, esc.ram_kib
    );
    if let (Some(kind), Some(name)) = (esc.pdi, &esc.pdi_name) {
        text += &format!("; PDI {name} ({kind:#04x})");
    }
    if esc.device_emulation {
        text += "; device emulation: no firmware answers requests of states";
    }
    text
}

fn delay(delay: &Delay) -> String {
    let written = delay.written_ns.map_or(String::new(), |ns| format!("; 0x0928 = {ns} ns"));
    let mut text = match (delay.ns, delay.error_ns, delay.standard_error_ns, delay.systematic_ns) {
        (Some(ns), Some(error), Some(standard), Some(systematic)) => format!(
            "{ns:.1} ns \u{b1}{error:.1} (standard error {standard:.1}, systematic \
                {systematic:.1}){written}"
        ),
        _ => match &delay.unknown {
            Some(why) => format!("can't be known: {why}"),
            None => "not measured".to_owned(),
        },
    };
    if let (Some(least), Some(most)) = (delay.least_ns, delay.most_ns) {
        text += &format!("; {least:.0} to {most:.0} ns are possible{written}");
    }
    if delay.ns.is_some() && delay.latches_left_out > 0 {
        text += &format!("; {} latches left out", delay.latches_left_out);
    }
    text
}

fn mailbox(device: &Device) -> String {
    let Some(mailbox) = &device.mailbox else { return "none".to_owned() };
    let mut text = format!(
        "{}; {} bytes at {:#06x} out, {} at {:#06x} in",
        mailbox.protocols.join(", "),
        mailbox.receive_length,
        mailbox.receive_start,
        mailbox.send_length,
        mailbox.send_start
    );
    if !mailbox.coe_details.is_empty() {
        text += &format!("; CoE: {}", mailbox.coe_details.join(", "));
    }
    text
}

fn process_data(data: &ProcessData) -> String {
    if data.pdos.is_empty() {
        return "none".to_owned();
    }
    let pdos = data.pdos.iter().map(|pdo| {
        let bits = match (pdo.bits / 8, pdo.bits % 8) {
            (1, 0) => "1 byte".to_owned(),
            (bytes, 0) => format!("{bytes} bytes"),
            _ => format!("{} bits", pdo.bits),
        };
        format!("0x{:04X} ({bits})", pdo.index)
    });
    let pdos: Vec<String> = pdos.collect();
    let at = |number: u8, start: u16, window: bool| {
        let off = if window { " (a window)" } else { "" };
        format!(", SyncManager {number}{off} at {start:#06x}")
    };
    let mut place = match data.sync_manager {
        Some(number) => at(number, data.start, data.window),
        None => ", no SyncManager".to_owned(),
    };
    for further in &data.further {
        place += &at(further.sync_manager, further.start, further.window);
    }
    format!("{}: {} bytes{place}, by {}", pdos.join(" "), data.length, data.source)
}

fn write_pdos(out: &mut String, device: &Device) -> fmt::Result {
    for (what, data) in [("outputs", &device.outputs), ("inputs", &device.inputs)] {
        for pdo in &data.pdos {
            let entries = pdo.entries.iter().map(|entry| match entry.index {
                0 => format!("{} bits of nothing", entry.bits),
                index => format!("0x{index:04X}:{:02X} ({})", entry.sub, entry.bits),
            });
            let entries: Vec<String> = entries.collect();
            let text = format!("0x{:04X}: {}", pdo.index, entries.join(", "));
            for (i, line) in wrap(&text, WIDTH - HEAD - 2).iter().enumerate() {
                writeln!(out, "  {:<HEAD$}{line}", if i == 0 { what } else { "" })?;
            }
        }
    }
    Ok(())
}

/// Writes one line for each sub-index; a 0 without a meaning is written only if all details are
/// requested.
fn write_sync_object(out: &mut String, object: &SyncObject, full: bool) -> fmt::Result {
    writeln!(out, "  0x{:04X}", object.index)?;
    for entry in &object.entries {
        let telling = entry.sub == sub::SYNC_TYPE || NOT_STATED_AS_0.contains(&entry.sub);
        let dull = entry.sub == 0 || entry.value == Some(0) && !telling;
        if dull && entry.doubt.is_none() && !full {
            continue;
        }
        let mut text = entry.in_words.clone();
        if full && entry.writable == Some(true) {
            text += ", writable";
        }
        let doubt = entry.doubt.as_ref().map(|doubt| format!("  ? {doubt}"));
        let text = text + &doubt.unwrap_or_default();
        for (i, line) in wrap_keeping(&text, WIDTH - 39).iter().enumerate() {
            match i {
                0 => writeln!(out, "    {:02X} {:<31} {line}", entry.sub, cut(&entry.name, 31))?,
                _ => writeln!(out, "    {:34} {line}", "")?,
            }
        }
    }
    Ok(())
}

/// Like [`wrap`], but keeps the two spaces before a doubt if they fit.
fn wrap_keeping(text: &str, width: usize) -> Vec<String> {
    if text.chars().count() <= width { vec![text.to_owned()] } else { wrap(text, width) }
}

fn state(state: &State) -> String {
    match state.al_status_code {
        0 => state.al_status.clone(),
        code => format!(
            "{}, AL status code 0x{code:04X} ({})",
            state.al_status, state.al_status_code_name
        ),
    }
}

fn cycle(ns: u32, factor: i16) -> String {
    match ns {
        0 => format!("by factor {factor}"),
        ns => Nanos(ns.into()).to_string(),
    }
}
