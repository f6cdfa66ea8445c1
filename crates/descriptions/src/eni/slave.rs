//! One `Slave` of an ENI.

use isocat_wire::register;
use isocat_wire::soe::{Elements, Idn, Opcode};
use isocat_wire::{AutoIncrementAddress, ObjectAddress};
use roxmltree::Node;

use super::tree::{Reader, Result, child, children, commands, named, text, text_of};
use super::warning::WarningKind;
use super::{EniEntry, EniPdo, EniSlave};
use crate::start_up::{
    Address, Area, Dc, DeviceStartUp, ImageBits, Mailbox, ObjectStep, ParameterStep, Parent,
    ProcessSyncManager, RegisterStep,
};

impl Reader<'_> {
    pub(super) fn slave(
        &mut self,
        node: Node,
        position: usize,
    ) -> Result<(DeviceStartUp, EniSlave)> {
        let mut device = DeviceStartUp::default();
        let mut slave = EniSlave::default();
        if let Some(info) = child(node, "Info") {
            device.name = text_of(info, "Name");
            device.station = self.number(info, "PhysAddr")?.unwrap_or(0);
            device.vendor = self.number(info, "VendorId")?.unwrap_or(0);
            device.product = self.number(info, "ProductCode")?.unwrap_or(0);
            device.revision = self.number(info, "RevisionNo")?.unwrap_or(0);
            device.serial = self.number(info, "SerialNo")?.unwrap_or(0);
            // Blanks in between are unused ports; trailing ones have no meaning.
            device.physics = text_of(info, "Physics");
            self.auto_increment(info, position, &mut slave)?;
        }
        if let Some(data) = child(node, "ProcessData") {
            self.process_data(data, &mut device, &mut slave)?;
        }
        if let Some(mailbox) = child(node, "Mailbox") {
            self.mailbox(mailbox, &mut device, &mut slave)?;
        }
        for command in commands(node) {
            if let Some(step) = self.register_step(command)? {
                self.check_step(command, &step, &device);
                device.registers.push(step);
            }
        }
        let previous = named(node, "PreviousPort");
        let selected = |node: &Node| matches!(node.attribute("Selected"), Some("1" | "true"));
        let ports: Vec<Node> = previous.collect();
        if let Some(port) = ports.iter().find(|node| selected(node)).or(ports.first()) {
            device.parent = Some(self.parent(*port)?);
        }
        slave.hot_connect = child(node, "HotConnect").is_some();
        if let Some(dc) = child(node, "DC") {
            device.dc = self.dc(dc)?;
        }
        if let Some(dc) = device.dc {
            self.check_cycles(node, &device, dc);
        }
        Ok((device, slave))
    }

    fn auto_increment(&mut self, info: Node, position: usize, slave: &mut EniSlave) -> Result<()> {
        slave.auto_increment = self.number(info, "AutoIncAddr")?;
        let expected = AutoIncrementAddress::of_position(position as u16).0;
        if let Some(found) = slave.auto_increment.filter(|found| *found != expected) {
            let message = format!(
                "AutoIncAddr {found} of the SubDevice at place {position}; expected {expected}: its place in \
                 the file counts"
            );
            self.warn(WarningKind::AutoIncrement, info, message);
        }
        Ok(())
    }

    fn process_data(
        &mut self,
        node: Node,
        device: &mut DeviceStartUp,
        slave: &mut EniSlave,
    ) -> Result<()> {
        for part in children(node) {
            match part.tag_name().name() {
                "Send" => device.outputs = Some(self.image_bits(part)?),
                "Recv" => device.inputs = Some(self.image_bits(part)?),
                "TxPdo" => slave.pdos.push(self.pdo(part, false)?),
                "RxPdo" => slave.pdos.push(self.pdo(part, true)?),
                name => {
                    let number =
                        name.strip_prefix("Sm").and_then(|digits| digits.parse::<u8>().ok());
                    match number.filter(|number| *number < 16) {
                        Some(number) => {
                            let manager = self.sync_manager(part, number)?;
                            device.sync_managers.push(manager);
                        }
                        None => {
                            let message = format!("{name} in ProcessData is not known: skipped");
                            self.warn(WarningKind::ElementUnknown, part, message);
                        }
                    }
                }
            }
        }
        Ok(())
    }

    fn image_bits(&mut self, node: Node) -> Result<ImageBits> {
        Ok(ImageBits {
            start: self.number(node, "BitStart")?.unwrap_or(0),
            length: self.number(node, "BitLength")?.unwrap_or(0),
        })
    }

    fn sync_manager(&mut self, node: Node, number: u8) -> Result<ProcessSyncManager> {
        let control: u8 = self.number(node, "ControlByte")?.unwrap_or(0);
        let mut pdos = Vec::new();
        for pdo in named(node, "Pdo") {
            pdos.push(self.number_of(pdo)?);
        }
        // Bits 3:2 of the control byte define the direction; its text is only a name.
        let outputs = match child(node, "ControlByte") {
            Some(_) => control >> 2 & 3 == 1,
            None => text_of(node, "Type") == "Outputs",
        };
        let start = self.number(node, "StartAddress")?.unwrap_or(0);
        let enabled = self.number::<u8>(node, "Enable")?.unwrap_or(0) & 1 != 0;
        Ok(ProcessSyncManager { number, outputs, start, control, enabled, pdos })
    }

    fn pdo(&mut self, node: Node, outputs: bool) -> Result<EniPdo> {
        let Some(index) = self.number(node, "Index")? else {
            return Err(self.error(node, "a PDO without Index"));
        };
        let mut entries = Vec::new();
        for entry in named(node, "Entry") {
            entries.push(EniEntry {
                index: self.number(entry, "Index")?.unwrap_or(0),
                sub: self.number(entry, "SubIndex")?.unwrap_or(0),
                bits: self.number(entry, "BitLen")?.unwrap_or(0),
            });
        }
        Ok(EniPdo { index, outputs, name: text_of(node, "Name"), entries })
    }

    fn mailbox(
        &mut self,
        node: Node,
        device: &mut DeviceStartUp,
        slave: &mut EniSlave,
    ) -> Result<()> {
        slave.protocols = named(node, "Protocol").map(text).collect();
        let back = match (child(node, "Recv"), child(node, "Receive")) {
            (None, Some(receive)) => {
                let message = "the mailbox's Recv is called Receive: taken as such";
                self.warn(WarningKind::MailboxReceive, receive, message);
                Some(receive)
            }
            (recv, _) => recv,
        };
        if let (Some(out), Some(back)) = (child(node, "Send"), back) {
            let (out, back) = (self.area(out)?, self.area(back)?);
            let speaks = |protocol: &str| {
                slave.protocols.iter().any(|name| name == protocol)
                    || child(node, protocol).is_some()
            };
            let (coe, soe) = (speaks("CoE"), speaks("SoE"));
            // Tools write a mailbox of 0 bytes if there is none.
            if out.length > 0 || back.length > 0 {
                device.mailbox = Some(Mailbox { out, back, coe, soe });
            }
        }
        if let Some(coe) = child(node, "CoE") {
            for command in commands(coe) {
                if let Some(step) = self.object_step(command)? {
                    device.objects.push(step);
                }
            }
        }
        if let Some(soe) = child(node, "SoE") {
            for command in commands(soe) {
                if let Some(step) = self.parameter_step(command)? {
                    device.parameters.push(step);
                }
            }
        }
        for protocol in ["AoE", "EoE", "FoE"] {
            let left_out = child(node, protocol).map_or(0, |part| commands(part).count());
            if left_out > 0 {
                let message = format!("{left_out} start-up commands of {protocol}: left out");
                self.warn(WarningKind::ProtocolLeftOut, node, message);
            }
        }
        Ok(())
    }

    fn area(&mut self, node: Node) -> Result<Area> {
        Ok(Area {
            start: self.number(node, "Start")?.unwrap_or(0),
            length: self.number(node, "Length")?.unwrap_or(0),
        })
    }

    fn object_step(&mut self, node: Node) -> Result<Option<ObjectStep>> {
        let Some(transitions) = self.transitions(node)? else { return Ok(None) };
        let data = child(node, "Data").map(|data| self.bytes(data)).transpose()?;
        let index = self.number(node, "Index")?;
        let index = index.ok_or_else(|| self.error(node, "an SDO command without Index"))?;
        let object = ObjectAddress::new(index, self.number(node, "SubIndex")?.unwrap_or(0));
        // 1 is a download and 2 an upload, as in CoE; some files have them swapped. The presence of
        // data decides.
        let ccs: Option<u8> = self.number(node, "Ccs")?;
        let data = data.filter(|data| !data.is_empty());
        let Some(data) = data else {
            self.warn(WarningKind::UploadLeftOut, node, format!("an upload of {object}: left out"));
            return Ok(None);
        };
        if ccs.is_some_and(|ccs| ccs != 1) {
            let message =
                format!("Ccs of {object} is no download and there are data: taken as one");
            self.warn(WarningKind::CcsOfDownload, node, message);
        }
        Ok(Some(ObjectStep {
            transitions,
            object,
            complete: self.attribute(node, "CompleteAccess")?,
            data,
            patience_ms: self.number(node, "Timeout")?.unwrap_or(0),
            comment: text_of(node, "Comment"),
        }))
    }

    fn parameter_step(&mut self, node: Node) -> Result<Option<ParameterStep>> {
        let Some(transitions) = self.transitions(node)? else { return Ok(None) };
        let idn = self.number(node, "IDN")?.map(Idn);
        let idn = idn.ok_or_else(|| self.error(node, "an SoE command without IDN"))?;
        let drive: u8 = self.number(node, "DriveNo")?.unwrap_or(0);
        if drive > MOST_DRIVE {
            return Err(self.error(node, format!("drive {drive}; expected 0 to {MOST_DRIVE}")));
        }
        let writes: Opcode = self.number(node, "OpCode")?.map_or(Opcode::WRITE_REQUEST, Opcode);
        let elements: Elements = self.number(node, "Elements")?.map_or(Elements::VALUE, Elements);
        if (writes, elements) != (Opcode::WRITE_REQUEST, Elements::VALUE) {
            let message = format!(
                "{idn} of drive {drive}: OpCode {}, Elements {}: left out; expected OpCode 3 and Elements 64, \
                 the write of a value",
                writes.0, elements.0
            );
            self.warn(WarningKind::ProtocolLeftOut, node, message);
            return Ok(None);
        }
        let data = child(node, "Data").map(|data| self.bytes(data)).transpose()?;
        Ok(Some(ParameterStep {
            transitions,
            drive,
            idn,
            data: data.unwrap_or_default(),
            patience_ms: self.number(node, "Timeout")?.unwrap_or(0),
            comment: text_of(node, "Comment"),
        }))
    }

    fn parent(&mut self, node: Node) -> Result<Parent> {
        let port = match text_of(node, "Port").as_str() {
            "A" => 0,
            "B" => 1,
            "C" => 2,
            "D" => 3,
            other => {
                return Err(self.error(node, format!("port \"{other}\"; expected A, B, C or D")));
            }
        };
        Ok(Parent { station: self.number(node, "PhysAddr")?.unwrap_or(0), port })
    }

    fn dc(&mut self, node: Node) -> Result<Option<Dc>> {
        let dc = Dc {
            reference: self.flag(node, "ReferenceClock")?,
            sync0_ns: self.number(node, "CycleTime0")?.unwrap_or(0),
            sync1_ns: self.number(node, "CycleTime1")?.unwrap_or(0),
            shift_ns: self.number(node, "ShiftTime")?.unwrap_or(0),
        };
        // For devices without DC, tools state only that they are no reference clock.
        let says = ["ReferenceClock", "CycleTime0", "CycleTime1", "ShiftTime"];
        Ok(says.iter().any(|name| child(node, name).is_some()).then_some(dc))
    }

    /// Warns of commands that contradict other parts of the SubDevice.
    fn check_step(&mut self, node: Node, step: &RegisterStep, device: &DeviceStartUp) {
        let Address::Physical { register, .. } = step.address else { return };
        let word = step.data.first_chunk().map(|bytes| u16::from_le_bytes(*bytes));
        if register == register::STATION_ADDRESS.address
            && word.is_some_and(|word| word != device.station)
        {
            let (written, said) = (word.unwrap_or(0), device.station);
            let message = format!("{written} is written to 0x0010, and PhysAddr is {said}");
            self.warn(WarningKind::StationDiffers, node, message);
        }
        let start = register == register::SYNC_START_TIME.address;
        if start && step.data.iter().any(|byte| *byte != 0) {
            let message =
                "a start time is written to 0x0990: it has passed; the MainDevice makes its own";
            self.warn(WarningKind::StartTime, node, message);
        }
    }

    /// Compares the cycles that are written with those in DC.
    fn check_cycles(&mut self, node: Node, device: &DeviceStartUp, dc: Dc) {
        let at = |step: &&RegisterStep, address: u16| matches!(step.address, Address::Physical { register, .. } if register == address);
        let step = device.registers.iter().find(|step| at(step, register::SYNC0_CYCLE.address));
        let Some(data) = step.map(|step| &step.data) else { return };
        let long = |from: usize| {
            data.get(from..from + 4)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes))
        };
        let differs = long(0).is_some_and(|sync0| sync0 != dc.sync0_ns)
            || long(4).is_some_and(|sync1| sync1 != dc.sync1_ns);
        if differs {
            let message = format!(
                "0x09A0 is written as {} and 0x09A4 as {}, and DC says {} and {}: what is written counts",
                long(0).unwrap_or(0),
                long(4).unwrap_or(0),
                dc.sync0_ns,
                dc.sync1_ns
            );
            self.warn(WarningKind::CyclesDiffer, node, message);
        }
    }
}

/// SoE has three bits for the number of a drive.
const MOST_DRIVE: u8 = 7;
