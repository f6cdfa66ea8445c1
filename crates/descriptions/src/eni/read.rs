//! The elements of an ENI, one function each.

use isocat_wire::al::AlState;
use isocat_wire::{Command, Nanos};
use roxmltree::Node;

use super::Eni;
use super::tree::{Reader, Result, child, children, commands, decode, named, parse, text, text_of};
use super::warning::WarningKind;
use crate::document::{FileError, Source};
use crate::start_up::{
    Address, Check, CyclicDatagram, CyclicFrame, DeviceStartUp, Own, RegisterStep, StartUp,
    Transition,
};

pub(super) fn read(path: &str, bytes: &[u8]) -> std::result::Result<Eni, FileError> {
    let (decoded, before) = decode(path, bytes)?;
    let (document, start) = parse(path, &decoded)?;
    let source = Source { path, text: &decoded };
    let mut reader = Reader { source, start, warnings: Vec::new() };
    let root = document.root_element();
    if before {
        let message = "text stands before the XML declaration: skipped";
        reader.warn(WarningKind::TextBeforeDeclaration, root, message);
    }
    if !root.has_tag_name("EtherCATConfig") {
        let found = root.tag_name().name();
        let hint = match found {
            "EtherCATInfo" => {
                "a device description (ESI) describes a kind of device, not a segment: \"isocat devices FILE\" lists it"
            }
            _ => "an ENI is what a configuration tool exports for a MainDevice",
        };
        let message = format!("the root element is {found}; expected EtherCATConfig");
        return Err(reader.error(root, message).with_hint(hint));
    }
    let Some(config) = child(root, "Config") else {
        return Err(reader.error(root, "EtherCATConfig has no Config"));
    };
    reader.config(path, root, config)
}

impl Reader<'_> {
    fn config(&mut self, path: &str, root: Node, config: Node) -> Result<Eni> {
        let mut list = StartUp::default();
        let (mut slaves, mut cycles_ns, mut groups) = (Vec::new(), Vec::new(), Vec::new());
        for node in children(config) {
            match node.tag_name().name() {
                "Master" => self.master(node, &mut list)?,
                "Slave" => {
                    let (device, slave) = self.slave(node, list.devices.len())?;
                    list.devices.push(device);
                    slaves.push(slave);
                }
                "Cyclic" => {
                    cycles_ns.push(self.cyclic(node, &mut list.frames)?);
                    groups.push(list.frames.len());
                }
                "ProcessImage" => {
                    for (name, bytes) in
                        [("Inputs", &mut list.input_bytes), ("Outputs", &mut list.output_bytes)]
                    {
                        if let Some(part) = child(node, name) {
                            *bytes = self.number(part, "ByteSize")?.unwrap_or(0);
                        }
                    }
                }
                name => {
                    let message = format!("{name} in Config is not known: skipped");
                    self.warn(WarningKind::ElementUnknown, node, message);
                }
            }
        }
        self.cycle(config, &cycles_ns, &mut list);
        // The period of the frames of each Cyclic, relative to the fastest one.
        let mut first = 0;
        for (end, cycle) in groups.into_iter().zip(&cycles_ns) {
            let times = cycle.and_then(|cycle| cycle.checked_div(list.cycle_ns));
            let every = times.and_then(|times| u32::try_from(times).ok()).unwrap_or(1).max(1);
            list.frames[first..end].iter_mut().for_each(|frame| frame.every = every);
            first = end;
        }
        self.reference(config, &list);
        let version = root.attribute("Version").unwrap_or_default().to_owned();
        let warnings = std::mem::take(&mut self.warnings);
        let path = path.to_owned();
        Ok(Eni { path, version, start_up: list, slaves, cycles_ns, warnings })
    }

    fn master(&mut self, node: Node, list: &mut StartUp) -> Result<()> {
        if let Some(info) = child(node, "Info") {
            list.name = text_of(info, "Name");
        }
        for command in commands(node) {
            let before = self.flag(command, "BeforeSlave")?;
            if let Some(step) = self.register_step(command)? {
                if before { list.before.push(step) } else { list.after.push(step) }
            }
        }
        Ok(())
    }

    fn cyclic(&mut self, node: Node, frames: &mut Vec<CyclicFrame>) -> Result<Option<i64>> {
        for frame in named(node, "Frame") {
            let mut datagrams = Vec::new();
            for command in named(frame, "Cmd") {
                datagrams.push(self.datagram(command)?);
            }
            frames.push(CyclicFrame { every: 1, datagrams });
        }
        // Commands outside of a frame, as some tools write them, get a separate frame.
        let mut loose = Vec::new();
        for command in named(node, "Cmd") {
            loose.push(self.datagram(command)?);
        }
        if !loose.is_empty() {
            frames.push(CyclicFrame { every: 1, datagrams: loose });
        }
        let micros: Option<u32> = self.number(node, "CycleTime")?;
        Ok(micros.filter(|micros| *micros > 0).map(|micros| i64::from(micros) * 1_000))
    }

    fn datagram(&mut self, node: Node) -> Result<CyclicDatagram> {
        let mut states = Vec::new();
        for state in named(node, "State") {
            let name = text(state);
            let all = [AlState::Init, AlState::PreOp, AlState::Boot, AlState::SafeOp, AlState::Op];
            let Some(state) = all.into_iter().find(|state| state.name() == name) else {
                let message = format!("State \"{name}\"; expected INIT, PREOP, BOOT, SAFEOP or OP");
                return Err(self.error(state, message));
            };
            states.push(state);
        }
        let (command, address) = self.command(node)?;
        let data = self.data(node)?;
        let length = u16::try_from(data.len())
            .ok()
            .filter(|length| usize::from(*length) <= MOST_BYTES)
            .ok_or_else(|| self.error(node, "more data than a datagram holds"))?;
        Ok(CyclicDatagram {
            command,
            address,
            length,
            states,
            working_counter: self.number(node, "Cnt")?,
            input_offset: self.number(node, "InputOffs")?.unwrap_or(0),
            output_offset: self.number(node, "OutputOffs")?.unwrap_or(0),
            comment: text_of(node, "Comment"),
        })
    }

    /// A register command; `None` if it is omitted.
    pub(super) fn register_step(&mut self, node: Node) -> Result<Option<RegisterStep>> {
        let Some(transitions) = self.transitions(node)? else { return Ok(None) };
        let (command, address) = self.command(node)?;
        let data = self.data(node)?;
        let own = match text_of(node, "Requires").as_str() {
            "" => Own::Nothing,
            "frame" => Own::Frame,
            "cycle" => Own::Cycle,
            other => {
                let message = format!("Requires \"{other}\"; expected frame or cycle");
                return Err(self.error(node, message));
            }
        };
        let check = match child(node, "Validate") {
            None => None,
            Some(validate) => {
                let bytes = |name| child(validate, name).map(|node| self.bytes(node)).transpose();
                let expected = bytes("Data")?.unwrap_or_default();
                let mask = bytes("DataMask")?;
                let wrong_mask = mask.as_ref().is_some_and(|mask| mask.len() != expected.len());
                if wrong_mask || expected.len() != data.len() {
                    let (read, compared) = (data.len(), expected.len());
                    let message =
                        format!("{read} bytes are read, {compared} compared, or the mask differs");
                    self.warn(WarningKind::CheckLength, validate, message);
                }
                let patience_ms = self.number(validate, "Timeout")?.unwrap_or(0);
                Some(Check { data: expected, mask, patience_ms })
            }
        };
        Ok(Some(RegisterStep {
            transitions,
            command,
            address,
            data,
            own,
            working_counter: self.number(node, "Cnt")?,
            retries: self.number(node, "Retries")?.unwrap_or(0),
            patience_ms: self.number(node, "Timeout")?,
            check,
            comment: text_of(node, "Comment"),
        }))
    }

    /// The transitions of a command; `None` if it is never done.
    pub(super) fn transitions(&mut self, node: Node) -> Result<Option<Vec<Transition>>> {
        let mut transitions = Vec::new();
        for transition in named(node, "Transition") {
            let found = text(transition).parse();
            transitions.push(found.map_err(|error: crate::start_up::UnknownTransition| {
                self.error(transition, error.to_string())
            })?);
        }
        let disabled = self.flag(node, "Disabled")?;
        if disabled || transitions.is_empty() {
            let why = if disabled { "disabled" } else { "without a transition" };
            let message = format!("a command that is {why}: left out");
            self.warn(WarningKind::CommandLeftOut, node, message);
            return Ok(None);
        }
        Ok(Some(transitions))
    }

    fn command(&mut self, node: Node) -> Result<(Command, Address)> {
        let Some(code) = child(node, "Cmd") else {
            return Err(self.error(node, "a command without Cmd; expected the datagram's command"));
        };
        let command = Command::try_from(self.number_of::<u8>(code)?)
            .map_err(|error| self.error(code, error.to_string()))?;
        let logical: Option<u32> = self.number(node, "Addr")?;
        let address = match (logical, command.is_logical()) {
            (Some(address), _) => Address::Logical(address),
            (None, true) => {
                let message = format!("{command} without Addr; expected a logical address");
                return Err(self.error(node, message));
            }
            (None, false) => Address::Physical {
                device: self.number(node, "Adp")?.unwrap_or(0),
                register: self.number(node, "Ado")?.unwrap_or(0),
            },
        };
        Ok((command, address))
    }

    /// Data, or zeros with the length DataLength.
    fn data(&mut self, node: Node) -> Result<Vec<u8>> {
        if let Some(data) = child(node, "Data") {
            return self.bytes(data);
        }
        let Some(length) = child(node, "DataLength") else {
            self.warn(WarningKind::NoData, node, "a command without Data or DataLength: empty");
            return Ok(Vec::new());
        };
        let bytes: usize = self.number_of::<u16>(length)?.into();
        match bytes {
            0..=MOST_BYTES => Ok(vec![0; bytes]),
            _ => Err(self.error(length, format!("{bytes} bytes; a datagram holds {MOST_BYTES}"))),
        }
    }

    /// The bus cycle: that of Cyclic, or else the longest cycle of SYNC0.
    fn cycle(&mut self, config: Node, cycles: &[Option<i64>], list: &mut StartUp) {
        let sync0 = |device: &DeviceStartUp| device.dc.map_or(0, |dc| i64::from(dc.sync0_ns));
        let longest = list.devices.iter().map(sync0).max().unwrap_or(0);
        list.cycle_ns = match cycles.iter().flatten().min() {
            Some(cycle) => *cycle,
            None => {
                if longest > 0 {
                    let cycle = Nanos(longest);
                    let message =
                        format!("no Cyclic/CycleTime: the cycle of SYNC0, {cycle}, is taken");
                    self.warn(WarningKind::CycleTimeMissing, config, message);
                }
                longest
            }
        };
        for (position, device) in list.devices.iter().enumerate() {
            let (sync0, bus) = (sync0(device), list.cycle_ns);
            if sync0 > 0 && bus > 0 && sync0 % bus != 0 && bus % sync0 != 0 {
                let message = format!(
                    "SYNC0 of SubDevice {position} has a cycle of {}, in no step with the bus cycle of {}",
                    Nanos(sync0),
                    Nanos(bus)
                );
                self.warn(WarningKind::CycleTimeDiffers, config, message);
            }
        }
    }

    fn reference(&mut self, config: Node, list: &StartUp) {
        let leads = |device: &&DeviceStartUp| device.dc.is_some_and(|dc| dc.reference);
        let in_use = list.devices.iter().any(|device| device.dc.is_some());
        match list.devices.iter().filter(leads).count() {
            0 if in_use => {
                let message = "DC is in use and no SubDevice is the reference clock";
                self.warn(WarningKind::ReferenceClockMissing, config, message);
            }
            0 | 1 => {}
            count => {
                let message = format!("{count} SubDevices are said to be the reference clock");
                self.warn(WarningKind::ReferenceClocks, config, message);
            }
        }
    }
}

/// Largest number of bytes in one frame.
pub(super) const MOST_BYTES: usize = 1_486;
