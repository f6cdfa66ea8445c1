//! The start-up list for people.

use std::fmt::{self, Write};

use isocat_wire::time::Nanos;

use super::{
    Address, CyclicFrame, DeviceStartUp, ObjectStep, Own, ParameterStep, RegisterStep, StartUp,
    Step, Transition, hex,
};
use crate::columns::wrap;

impl StartUp {
    /// The list as text with lines of at most a hundred columns: the steps of each transition, in
    /// order, and the cycle.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        let count = self.devices.len();
        let devices = if count == 1 { "SubDevice" } else { "SubDevices" };
        let name = if self.name.is_empty() { "a segment without a name" } else { &self.name };
        let cycle = match self.cycle_ns {
            0 => "no cycle told".to_owned(),
            ns => format!("cycle {}", Nanos(ns)),
        };
        writeln!(out, "Start-up of {name}: {cycle}, {count} {devices}")?;
        write_common(out, "all SubDevices, before each one", &self.before)?;
        for (position, device) in self.devices.iter().enumerate() {
            device.write(out, position)?;
        }
        write_common(out, "all SubDevices, after each one", &self.after)?;
        if !self.frames.is_empty() {
            let (inputs, outputs) = (self.input_bytes, self.output_bytes);
            let image = format!("{inputs} bytes of inputs, {outputs} of outputs");
            writeln!(out, "\neach cycle, with a process image of {image}")?;
        }
        let mut before = 1;
        for (number, frame) in self.frames.iter().enumerate() {
            if frame.every != before {
                before = frame.every;
                writeln!(out, "  in every {} of them only", ordinal(frame.every))?;
            }
            write_frame(out, number, frame)?;
        }
        write_notes(out, &self.notes)?;
        let mark = "\nc, f: in a cycle or frame of its own; SDO*: complete access; = what a read must find";
        writeln!(out, "{mark}")?;
        match self.devices.iter().any(|device| !device.parameters.is_empty()) {
            true => writeln!(out, "SoE: number of the drive, and the parameter that is written"),
            false => Ok(()),
        }
    }
}

impl DeviceStartUp {
    fn write(&self, out: &mut String, position: usize) -> fmt::Result {
        let (station, name) = (self.station, &self.name);
        writeln!(out, "\n{position} {name}, station 0x{station:04X}")?;
        let (vendor, product, revision) = (self.vendor, self.product, self.revision);
        writeln!(
            out,
            "  vendor 0x{vendor:08X}, product 0x{product:08X}, revision 0x{revision:08X}"
        )?;
        for transition in Transition::UP {
            for step in self.at(transition) {
                write_step(out, transition, step)?;
            }
        }
        if let Some(dc) = self.dc {
            let lead = if dc.reference { ", its clock leads" } else { "" };
            let [sync0, sync1] = [dc.sync0_ns, dc.sync1_ns].map(|ns| Nanos(ns.into()));
            let shift = Nanos(dc.shift_ns.into());
            let word = self.assign_activate();
            let word = word.map_or_else(String::new, |word| format!(", AssignActivate {word}"));
            match (dc.sync0_ns, dc.sync1_ns) {
                (0, 0) => writeln!(out, "  DC: no SYNC{word}{lead}")?,
                _ => writeln!(
                    out,
                    "  DC: SYNC0 {sync0}, SYNC1 {sync1} after it, shift {shift}{word}{lead}"
                )?,
            }
        }
        write_notes(out, &self.notes)
    }
}

fn write_common(out: &mut String, whom: &str, steps: &[RegisterStep]) -> fmt::Result {
    for (number, transition) in Transition::UP.into_iter().enumerate() {
        if number == 0 && !steps.is_empty() {
            writeln!(out, "\n{whom}")?;
        }
        for step in steps.iter().filter(|step| step.transitions.contains(&transition)) {
            write_step(out, transition, Step::Register(step))?;
        }
    }
    Ok(())
}

fn write_step(out: &mut String, transition: Transition, step: Step<'_>) -> fmt::Result {
    let (what, place, data, comment) = match step {
        Step::Object(ObjectStep { object, complete, data, comment, .. }) => {
            (if *complete { "SDO*" } else { "SDO" }, object.to_string(), bytes(data), comment)
        }
        Step::Parameter(ParameterStep { drive, idn, data, comment, .. }) => {
            ("SoE", format!("{drive} {idn}"), bytes(data), comment)
        }
        Step::Register(step) => {
            let data = match &step.check {
                None => bytes(&step.data),
                Some(check) => {
                    let mask = check.mask.as_deref().map(|mask| format!(" & {}", bytes(mask)));
                    format!("= {}{}", bytes(&check.data), mask.unwrap_or_default())
                }
            };
            (step.command.name(), place(step.address), data, &step.comment)
        }
    };
    let own = match step {
        Step::Register(RegisterStep { own: Own::Frame, .. }) => "f",
        Step::Register(RegisterStep { own: Own::Cycle, .. }) => "c",
        _ => " ",
    };
    let line = format!("  {transition}{own} {what:<4} {place:<10} {data:<35} {comment}");
    writeln!(out, "{}", line.trim_end())
}

fn write_frame(out: &mut String, number: usize, frame: &CyclicFrame) -> fmt::Result {
    for (i, datagram) in frame.datagrams.iter().enumerate() {
        let name = if i == 0 { format!("frame {number}") } else { String::new() };
        let (command, place, length) = (datagram.command, place(datagram.address), datagram.length);
        let states: Vec<_> = datagram.states.iter().map(|state| state.name()).collect();
        let states = states.join(", ");
        let line = format!(
            "  {name:<9}{command:<4} {place:<10} {length:>5} bytes  in {states}  {}",
            datagram.comment
        );
        writeln!(out, "{}", line.trim_end())?;
    }
    Ok(())
}

fn write_notes(out: &mut String, notes: &[String]) -> fmt::Result {
    for note in notes {
        for (i, line) in wrap(note, WIDTH).into_iter().enumerate() {
            writeln!(out, "  {} {line}", if i == 0 { "-" } else { " " })?;
        }
    }
    Ok(())
}

/// An ordinal number: `2nd`, `5th`.
fn ordinal(number: u32) -> String {
    let ending = match (number % 10, number % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("{number}{ending}")
}

fn place(address: Address) -> String {
    match address {
        Address::Physical { register, .. } => format!("0x{register:04X}"),
        Address::Logical(address) => format!("0x{address:08X}"),
    }
}

/// Hex digits in groups of four bytes; long data are shown by their beginning and length.
fn bytes(bytes: &[u8]) -> String {
    if bytes.len() >= 16 && bytes.iter().all(|byte| *byte == 0) {
        return format!("{} zeros", bytes.len());
    }
    let shown = &bytes[..bytes.len().min(12)];
    let text = shown.chunks(4).map(hex).collect::<Vec<_>>().join(" ");
    match bytes.len() {
        0..=12 => text,
        13..=16 => bytes.chunks(4).map(hex).collect::<Vec<_>>().join(" "),
        length => format!("{text} … {length} bytes"),
    }
}

/// Width of a note in columns.
const WIDTH: usize = 96;
