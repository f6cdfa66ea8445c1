//! The start-up list as ENI.

use std::fmt::{self, Write};

use isocat_wire::AutoIncrementAddress;
use isocat_wire::soe::{Elements, Opcode};

use crate::markup::escaped;
use crate::start_up::{
    Address, Area, Check, CyclicDatagram, DeviceStartUp, ObjectStep, Own, ParameterStep,
    RegisterStep, StartUp, Transition, hex,
};

/// The list as the text of an ENI file, in UTF-8. Parts that ENI cannot express are comments: the
/// notes, and a cycle that is no whole number of microseconds.
pub fn write(list: &StartUp) -> String {
    let mut writer = Writer::default();
    // Writing to a String cannot fail.
    let _ = writer.file(list);
    writer.out
}

#[derive(Default)]
struct Writer {
    out: String,
    depth: usize,
}

impl Writer {
    fn file(&mut self, list: &StartUp) -> fmt::Result {
        self.out += "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n";
        self.within("EtherCATConfig", " Version=\"1.3\"", |w| {
            w.notes(&list.notes)?;
            w.within("Config", "", |w| w.config(list))
        })
    }

    fn config(&mut self, list: &StartUp) -> fmt::Result {
        self.within("Master", "", |w| {
            w.within("Info", "", |w| {
                w.text("Name", &list.name)?;
                w.text("Destination", "ffffffffffff")?;
                w.text("Source", "101010101010")?;
                w.text("EtherType", "a488")
            })?;
            w.within("InitCmds", "", |w| {
                for (before, steps) in [(true, &list.before), (false, &list.after)] {
                    for step in steps {
                        w.register_step(step, Some(before))?;
                    }
                }
                Ok(())
            })
        })?;
        for (position, device) in list.devices.iter().enumerate() {
            self.within("Slave", "", |w| w.slave(position, device))?;
        }
        self.within("Cyclic", "", |w| w.cyclic(list, 1))?;
        let mut slower: Vec<u32> = list.frames.iter().map(|frame| frame.every).collect();
        slower.sort_by_cached_key(|every| u64::from(*every));
        slower.dedup();
        for every in slower.into_iter().filter(|every| *every > 1) {
            self.within("Cyclic", "", |w| w.cyclic(list, every))?;
        }
        self.within("ProcessImage", "", |w| {
            w.within("Inputs", "", |w| w.number("ByteSize", list.input_bytes))?;
            w.within("Outputs", "", |w| w.number("ByteSize", list.output_bytes))
        })
    }

    fn slave(&mut self, position: usize, device: &DeviceStartUp) -> fmt::Result {
        self.notes(&device.notes)?;
        self.within("Info", "", |w| {
            w.text("Name", &device.name)?;
            w.number("PhysAddr", device.station)?;
            w.number("AutoIncAddr", AutoIncrementAddress::of_position(position as u16).0)?;
            w.text("Physics", &device.physics)?;
            w.number("VendorId", device.vendor)?;
            w.number("ProductCode", device.product)?;
            w.number("RevisionNo", device.revision)?;
            w.number("SerialNo", device.serial)
        })?;
        self.process_data(device)?;
        self.mailbox(device)?;
        self.within("InitCmds", "", |w| {
            device.registers.iter().try_for_each(|step| w.register_step(step, None))
        })?;
        if let Some(parent) = device.parent {
            self.within("PreviousPort", " Selected=\"1\"", |w| {
                let letters = ["A", "B", "C", "D"];
                w.text("Port", letters[usize::from(parent.port.min(3))])?;
                w.number("PhysAddr", parent.station)
            })?;
        }
        let Some(dc) = device.dc else { return Ok(()) };
        self.within("DC", "", |w| {
            w.text("ReferenceClock", if dc.reference { "true" } else { "false" })?;
            w.number("CycleTime0", dc.sync0_ns)?;
            w.number("CycleTime1", dc.sync1_ns)?;
            w.number("ShiftTime", dc.shift_ns)
        })
    }

    fn process_data(&mut self, device: &DeviceStartUp) -> fmt::Result {
        let none = device.outputs.is_none() && device.inputs.is_none();
        if none && device.sync_managers.is_empty() {
            return Ok(());
        }
        self.within("ProcessData", "", |w| {
            for (name, bits) in [("Send", device.outputs), ("Recv", device.inputs)] {
                if let Some(bits) = bits {
                    w.within(name, "", |w| {
                        w.number("BitStart", bits.start)?;
                        w.number("BitLength", bits.length)
                    })?;
                }
            }
            for manager in &device.sync_managers {
                w.within(&format!("Sm{}", manager.number), "", |w| {
                    w.text("Type", if manager.outputs { "Outputs" } else { "Inputs" })?;
                    w.number("StartAddress", manager.start)?;
                    w.number("ControlByte", manager.control)?;
                    w.number("Enable", u8::from(manager.enabled))?;
                    manager.pdos.iter().try_for_each(|pdo| w.number("Pdo", pdo))
                })?;
            }
            Ok(())
        })
    }

    fn mailbox(&mut self, device: &DeviceStartUp) -> fmt::Result {
        let Some(mailbox) = device.mailbox else { return self.objects_without_mailbox(device) };
        self.within("Mailbox", "", |w| {
            for (name, Area { start, length }) in [("Send", mailbox.out), ("Recv", mailbox.back)] {
                w.within(name, "", |w| {
                    w.number("Start", start)?;
                    w.number("Length", length)?;
                    if name == "Recv" { w.number("PollTime", POLL_TIME_MS) } else { Ok(()) }
                })?;
            }
            for (speaks, name) in [(mailbox.coe, "CoE"), (mailbox.soe, "SoE")] {
                if speaks {
                    w.text("Protocol", name)?;
                }
            }
            w.coe(&device.objects)?;
            w.soe(&device.parameters)
        })
    }

    /// The writes to a device without mailbox areas in the list.
    fn objects_without_mailbox(&mut self, device: &DeviceStartUp) -> fmt::Result {
        if device.objects.is_empty() && device.parameters.is_empty() {
            return Ok(());
        }
        self.within("Mailbox", "", |w| {
            w.coe(&device.objects)?;
            w.soe(&device.parameters)
        })
    }

    fn soe(&mut self, parameters: &[ParameterStep]) -> fmt::Result {
        if parameters.is_empty() {
            return Ok(());
        }
        self.within("SoE", "", |w| {
            w.within("InitCmds", "", |w| {
                for step in parameters {
                    w.within("InitCmd", "", |w| {
                        w.transitions(&step.transitions)?;
                        w.text("Comment", &step.comment)?;
                        w.number("Timeout", step.patience_ms)?;
                        w.number("OpCode", Opcode::WRITE_REQUEST.0)?;
                        w.number("DriveNo", step.drive)?;
                        w.number("IDN", step.idn.0)?;
                        w.number("Elements", Elements::VALUE.0)?;
                        w.text("Data", &hex(&step.data))
                    })?;
                }
                Ok(())
            })
        })
    }

    fn coe(&mut self, objects: &[ObjectStep]) -> fmt::Result {
        if objects.is_empty() {
            return Ok(());
        }
        self.within("CoE", "", |w| {
            w.within("InitCmds", "", |w| {
                for step in objects {
                    let complete = if step.complete { " CompleteAccess=\"true\"" } else { "" };
                    w.within("InitCmd", complete, |w| {
                        w.transitions(&step.transitions)?;
                        w.text("Comment", &step.comment)?;
                        w.number("Timeout", step.patience_ms)?;
                        w.number("Ccs", 1)?;
                        w.number("Index", step.object.index)?;
                        w.number("SubIndex", step.object.sub)?;
                        w.text("Data", &hex(&step.data))
                    })?;
                }
                Ok(())
            })
        })
    }

    fn register_step(&mut self, step: &RegisterStep, before: Option<bool>) -> fmt::Result {
        self.within("InitCmd", "", |w| {
            w.transitions(&step.transitions)?;
            if let Some(before) = before {
                w.text("BeforeSlave", if before { "true" } else { "false" })?;
            }
            w.text("Comment", &step.comment)?;
            match step.own {
                Own::Nothing => {}
                Own::Frame => w.text("Requires", "frame")?,
                Own::Cycle => w.text("Requires", "cycle")?,
            }
            w.number("Cmd", step.command as u8)?;
            w.address(step.address)?;
            w.data(&step.data)?;
            if let Some(counter) = step.working_counter {
                w.number("Cnt", counter)?;
            }
            w.number("Retries", step.retries)?;
            if let Some(patience) = step.patience_ms {
                w.number("Timeout", patience)?;
            }
            let Some(Check { data, mask, patience_ms }) = &step.check else { return Ok(()) };
            w.within("Validate", "", |w| {
                w.text("Data", &hex(data))?;
                if let Some(mask) = mask {
                    w.text("DataMask", &hex(mask))?;
                }
                w.number("Timeout", patience_ms)
            })
        })
    }

    /// The frames of every n-th bus cycle.
    fn cyclic(&mut self, list: &StartUp, every: u32) -> fmt::Result {
        let bus = list.cycle_ns;
        let cycle = i128::from(bus) * i128::from(every);
        match (u32::try_from(cycle / 1_000), bus % 1_000) {
            (Ok(micros), 0) => self.number("CycleTime", micros)?,
            // If the bus cycle has no CycleTime, a slower group has none either: it would be read
            // as the bus cycle.
            _ => self.comment(&format!(
                "The cycle is {cycle} ns: CycleTime counts whole microseconds and is left out."
            ))?,
        }
        for frame in list.frames.iter().filter(|frame| frame.every == every) {
            self.within("Frame", "", |w| {
                frame.datagrams.iter().try_for_each(|datagram| w.datagram(datagram))
            })?;
        }
        Ok(())
    }

    fn datagram(&mut self, datagram: &CyclicDatagram) -> fmt::Result {
        self.within("Cmd", "", |w| {
            datagram.states.iter().try_for_each(|state| w.text("State", state.name()))?;
            w.text("Comment", &datagram.comment)?;
            w.number("Cmd", datagram.command as u8)?;
            w.address(datagram.address)?;
            w.number("DataLength", datagram.length)?;
            if let Some(counter) = datagram.working_counter {
                w.number("Cnt", counter)?;
            }
            w.number("InputOffs", datagram.input_offset)?;
            w.number("OutputOffs", datagram.output_offset)
        })
    }

    fn transitions(&mut self, transitions: &[Transition]) -> fmt::Result {
        transitions
            .iter()
            .try_for_each(|transition| self.text("Transition", &transition.to_string()))
    }

    fn address(&mut self, address: Address) -> fmt::Result {
        match address {
            Address::Physical { device, register } => {
                self.number("Adp", device)?;
                self.number("Ado", register)
            }
            Address::Logical(address) => self.number("Addr", address),
        }
    }

    /// Bytes, or only the length if they are many zeros.
    fn data(&mut self, data: &[u8]) -> fmt::Result {
        match data.len() > 32 && data.iter().all(|byte| *byte == 0) {
            true => self.number("DataLength", data.len()),
            false => self.text("Data", &hex(data)),
        }
    }

    fn notes(&mut self, notes: &[String]) -> fmt::Result {
        notes.iter().try_for_each(|note| self.comment(note))
    }

    fn within(
        &mut self,
        name: &str,
        attributes: &str,
        content: impl FnOnce(&mut Self) -> fmt::Result,
    ) -> fmt::Result {
        self.indent();
        writeln!(self.out, "<{name}{attributes}>")?;
        self.depth += 1;
        content(self)?;
        self.depth -= 1;
        self.indent();
        writeln!(self.out, "</{name}>")
    }

    fn number(&mut self, name: &str, number: impl fmt::Display) -> fmt::Result {
        self.indent();
        writeln!(self.out, "<{name}>{number}</{name}>")
    }

    fn text(&mut self, name: &str, text: &str) -> fmt::Result {
        self.indent();
        writeln!(self.out, "<{name}>{}</{name}>", escaped(text))
    }

    /// A comment. Two dashes would end it.
    fn comment(&mut self, text: &str) -> fmt::Result {
        self.indent();
        let text = text.replace("--", "- -").replace("--", "- -");
        writeln!(self.out, "<!-- {} -->", escaped(&text))
    }

    fn indent(&mut self) {
        self.out.extend(std::iter::repeat_n('\t', self.depth));
    }
}

/// Polling interval of a MainDevice that does not watch the mailbox's state.
const POLL_TIME_MS: u32 = 20;
