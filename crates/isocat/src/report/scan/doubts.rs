//! What contradicts itself in a SubDevice, and what it leaves open.

use isocat_maindevice::segment::{DcCapability, SubDevice, SyncObject};
use isocat_sync::delay::Delay;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, ShiftBy, SupportedTypes, sub};
use isocat_sync::table;
use isocat_wire::dc::AssignActivate;
use isocat_wire::register::{PROCESS_RAM, features};
use isocat_wire::sii::sm_type;
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, ObjectAddress, PortNumber};

use super::esc::{has_port, port_kind, sync_manager_use};
use super::objects::{
    COUNTERS, MODES, columns, copies_too_long, is_mandatory, is_unstated, not_stated, shown_type,
    writable, wrong_length,
};

/// What is to say about one SubDevice.
#[derive(Default)]
pub(super) struct Doubts {
    /// Two things that it says and that can't both be so: kind and words.
    pub contradictions: Vec<(&'static str, String)>,
    /// What is allowed and leaves a question open.
    pub open: Vec<(&'static str, String)>,
}

/// All doubts about a SubDevice. `identified`: its SII was read. `asked`: its objects were, too.
pub(super) fn of(device: &SubDevice, identified: bool, asked: bool) -> Doubts {
    let mut doubts = Doubts::default();
    doubts.state(device);
    doubts.ports(device);
    doubts.clock(device);
    if identified {
        doubts.sii(device);
        doubts.sync_managers(device);
        doubts.op_modes(device);
    }
    if asked && device.has_coe() {
        doubts.sync_objects(device);
    }
    doubts
}

impl Doubts {
    fn contradicts(&mut self, kind: &'static str, what: String) {
        self.contradictions.push((kind, what));
    }

    fn asks(&mut self, kind: &'static str, what: String) {
        self.open.push((kind, what));
    }

    /// What it did before the scan came.
    fn state(&mut self, device: &SubDevice) {
        let Some((status, code)) = device.observed.state_before else { return };
        if status.error() {
            self.asks(
                "error-before",
                format!("it stood in an error before the scan: {status}, AL status code {code}"),
            );
        } else if status.state() != Ok(AlState::Init) {
            self.asks(
                "in-use",
                format!("it was in {status}: whoever brought it there may run on; the scan took it to INIT"),
            );
        }
    }

    fn ports(&mut self, device: &SubDevice) {
        let (status, kinds) = (device.dl_status, device.esc.ports);
        for port in PortNumber::ALL {
            if status.open(port) && !has_port(kinds, port) {
                let kind = port_kind(kinds, port);
                self.contradicts(
                    "port-not-there",
                    format!("frames leave through port {port} (0x0110), whose kind is \"{kind}\" (0x0007)"),
                );
            } else if status.link(port) && !status.communication(port) {
                self.asks(
                    "link-without-signal",
                    format!("port {port} has a link and no signal (0x0110): what is behind it does not answer"),
                );
            }
        }
    }

    fn clock(&mut self, device: &SubDevice) {
        let promised = device.esc.has(features::DC);
        match (promised, device.dc) {
            (true, DcCapability::None) => self.contradicts(
                "no-receive-times",
                "0x0008 bit 2 promises distributed clocks, but 0x0900 does not answer".to_owned(),
            ),
            (true, DcCapability::ReceiveTimes) => self.asks(
                "receive-times-only",
                "it has receive times and no system time (0x0910 does not answer)".to_owned(),
            ),
            _ => {}
        }
        if let Some(Delay::Indeterminate { why, between }) = device.measured_delay {
            let range = between.map_or(String::new(), |(least, most)| {
                format!("; {} to {} ns are possible", least.0 / 1_000, most.0 / 1_000)
            });
            self.asks("delay-unknown", format!("its delay can't be known: {why}{range}"));
        }
    }

    fn sii(&mut self, device: &SubDevice) {
        let alias = alias(device);
        if let Some(found) = device.observed.alias.filter(|found| *found != alias) {
            self.contradicts(
                "alias",
                format!("its alias is {found} in register 0x0012 and {alias} in the SII"),
            );
        }
        if device.identity.vendor == 0 || device.identity.product == 0 {
            self.asks("no-identity", "its SII names no vendor or no product".to_owned());
        }
    }

    fn sync_managers(&mut self, device: &SubDevice) {
        let (records, esc) = (&device.sii.sync_managers, &device.esc);
        if records.len() > usize::from(esc.sync_managers) {
            self.contradicts(
                "too-few-sync-managers",
                format!(
                    "its SII has {} SyncManagers, its ESC {} (0x0005)",
                    records.len(),
                    esc.sync_managers
                ),
            );
        }
        let used = [&device.outputs, &device.inputs].iter().filter(|data| data.length > 0).count();
        if used > usize::from(esc.fmmus) {
            self.contradicts(
                "too-few-fmmus",
                format!(
                    "{used} FMMUs are needed for its process data, its ESC has {} (0x0004)",
                    esc.fmmus
                ),
            );
        }
        for (number, (record, kind)) in records.iter().zip(&device.sm_types).enumerate() {
            if record.kind != *kind && *kind != sm_type::UNUSED {
                let (sii, object) = (sync_manager_use(record.kind), sync_manager_use(*kind));
                self.contradicts(
                    "sync-manager-use",
                    format!("SyncManager {number} is for {sii} in its SII, for {object} in 0x1C00"),
                );
            }
        }
        let areas = areas(device);
        let end = u32::from(PROCESS_RAM) + 1024 * u32::from(esc.ram);
        for (at, (name, from, to)) in areas.iter().enumerate() {
            if *from < u32::from(PROCESS_RAM) || *to > end {
                self.contradicts(
                    "beyond-the-memory",
                    format!("{name} is at {from:#06x}..{to:#06x}, its process RAM at 0x1000..{end:#06x} (0x0006)"),
                );
            }
            for (other, begin, until) in &areas[at + 1..] {
                if from < until && begin < to {
                    self.contradicts(
                        "overlap",
                        format!("{name} at {from:#06x}..{to:#06x} and {other} at {begin:#06x}..{until:#06x} overlap"),
                    );
                }
            }
        }
        if device.has_mailbox() {
            let header = &device.sii.header;
            let named =
                [(sm_type::MAILBOX_OUT, header.receive), (sm_type::MAILBOX_IN, header.send)];
            for (kind, area) in named {
                let Some(record) = records.iter().find(|record| record.kind == kind) else {
                    continue;
                };
                if (record.start, record.length) != (area.start, area.length) {
                    self.contradicts(
                        "mailbox-area",
                        format!(
                            "{} is {} bytes at {:#06x} in the head of its SII, {} bytes at {:#06x} among its SyncManagers",
                            sync_manager_use(kind), area.length, area.start, record.length, record.start
                        ),
                    );
                }
            }
        }
    }

    fn op_modes(&mut self, device: &SubDevice) {
        let wanting =
            device.sii.operation_modes.iter().map(|mode| AssignActivate(mode.assign_activate));
        let synced = wanting.filter(|word| word.activates()).count();
        if synced > 0 && !device.dc.has_clock() {
            self.contradicts(
                "op-mode-without-clock",
                format!("{synced} OpModes of its SII switch SYNC on, but it has no system time"),
            );
        }
    }

    fn sync_objects(&mut self, device: &SubDevice) {
        let both = [
            (OUTPUT_PARAMETER, device.output_sync.as_ref(), device.outputs.length > 0),
            (INPUT_PARAMETER, device.input_sync.as_ref(), device.inputs.length > 0),
        ];
        for (index, object, used) in both {
            match object {
                Some(object) => self.sync_object(device, index, object, used),
                None if used => self.asks(
                    "no-sync-object",
                    format!(
                        "it has no object 0x{index:04X}: nothing says how it can be synchronized"
                    ),
                ),
                None => {}
            }
        }
        if !both[0].2 && !both[1].2 && !device.sii.sync_managers.is_empty() {
            self.asks(
                "nothing-assigned",
                "nothing is assigned in 0x1C12 and 0x1C13: whoever brings it up must assign PDOs"
                    .to_owned(),
            );
        }
        let types = |object: Option<&SyncObject>, used| object.filter(|_| used)?.values.supported;
        let (outputs, inputs) = (types(both[0].1, both[0].2), types(both[1].1, both[1].2));
        if let (Some(outputs), Some(inputs)) = (outputs, inputs) {
            let (own, other) = (outputs.0 & MODES, inputs.0 & MODES);
            let text = format!("0x1C32:04 announces {outputs}, 0x1C33:04 {inputs}");
            match own & other {
                0 if own != 0 && other != 0 => {
                    self.contradicts("types-exclude-each-other", text + ": no mode is in both");
                }
                _ if own != other => self.asks("types-disagree", text),
                _ => {}
            }
        }
        let cycle = |object: Option<&SyncObject>| {
            object?.values.minimum_cycle_time.filter(|time| *time > Nanos::ZERO)
        };
        if let (Some(outputs), Some(inputs)) = (cycle(both[0].1), cycle(both[1].1)) {
            if outputs != inputs {
                self.asks(
                    "minimum-cycles-differ",
                    format!("its minimum cycle is {outputs} in 0x1C32:05, {inputs} in 0x1C33:05"),
                );
            }
        }
    }

    fn sync_object(&mut self, device: &SubDevice, index: u16, object: &SyncObject, used: bool) {
        let at = |sub| ObjectAddress::new(index, sub);
        for entry in &object.entries {
            if let Err(code) = &entry.value {
                self.contradicts(
                    "not-readable",
                    format!("{} is described, but can't be read: abort {code}", at(entry.sub)),
                );
            }
            if let (Some(bits), Ok(bytes)) = (wrong_length(entry), &entry.value) {
                self.contradicts(
                    "length",
                    format!(
                        "{} has {} bytes, but is described as {bits} bits",
                        at(entry.sub),
                        bytes.len()
                    ),
                );
            }
        }
        let values = &object.values;
        let types = match values.supported.filter(|types| types.0 & MODES != 0) {
            Some(types) => types,
            None if used => {
                return self
                    .asks("no-types", format!("{} announces no mode", at(sub::SUPPORTED_TYPES)));
            }
            None => return,
        };
        if let Some(shown) = values.sync_type {
            if let Some(why) = shown_type(shown, types) {
                self.contradicts(
                    "type-not-announced",
                    format!("{} shows {shown}, {why}: {types}", at(sub::SYNC_TYPE)),
                );
            }
        }
        self.announcement(device, index, object, types);
        let ran: Vec<String> = COUNTERS
            .into_iter()
            .filter_map(|sub| Some((sub, object.entry(sub)?.number()?)))
            .filter(|(_, count)| *count > 0)
            .map(|(sub, count)| format!("{sub:02X} {count}"))
            .collect();
        if !ran.is_empty() {
            self.asks(
                "counted",
                format!("0x{index:04X} has counted before the scan: {}", ran.join(", ")),
            );
        }
        let unstated: Vec<String> = object
            .entries
            .iter()
            .filter(|entry| {
                entry.number() == Some(0) && is_unstated(device, index, object, entry.sub)
            })
            .map(|entry| format!("{:02X}", entry.sub))
            .collect();
        if !unstated.is_empty() {
            let why = not_stated(object);
            self.asks(
                "not-stated",
                format!(
                    "modes that are announced ask for times in 0x{index:04X} that read {why}: {}",
                    unstated.join(", ")
                ),
            );
        }
    }

    /// What sub-index 04 announces, against what else there is.
    fn announcement(
        &mut self,
        device: &SubDevice,
        index: u16,
        object: &SyncObject,
        types: SupportedTypes,
    ) {
        let at = |sub| ObjectAddress::new(index, sub);
        let values = &object.values;
        let dc = types.dc_sync0() || types.dc_sync1() || types.dc_subordinated();
        if dc && !device.dc.has_clock() {
            self.contradicts(
                "dc-without-clock",
                format!(
                    "{} announces {types}, but it has no system time",
                    at(sub::SUPPORTED_TYPES)
                ),
            );
        }
        if types.shift() == ShiftBy::Reserved {
            self.contradicts(
                "shift-reserved",
                format!("{} has 11 in bits 6:5, which means nothing", at(sub::SUPPORTED_TYPES)),
            );
        }
        let shift = object.entry(sub::SHIFT_TIME);
        if types.shift() == ShiftBy::LocalTimer && index == OUTPUT_PARAMETER {
            match shift.map(writable) {
                None => self.contradicts(
                    "no-shift",
                    format!(
                        "a shift by local timer is announced, but {} is missing",
                        at(sub::SHIFT_TIME)
                    ),
                ),
                Some(Some(false)) => self.contradicts(
                    "shift-read-only",
                    format!(
                        "a shift by local timer is announced, but {} can't be written",
                        at(sub::SHIFT_TIME)
                    ),
                ),
                _ => {}
            }
        }
        if types.delay_should_be_measured() && types.delay_fixed() {
            self.contradicts("delay-both", format!("{} says that delays are fixed (bit 11) and that they should be measured (bit 10)", at(sub::SUPPORTED_TYPES)));
        }
        if types.dc_subordinated() && values.sync0_cycle_time.is_none_or(|time| time == Nanos::ZERO)
        {
            self.contradicts(
                "no-sync0-cycle",
                format!(
                    "subordinated cycles are announced, but {} does not say which",
                    at(sub::SYNC0_CYCLE_TIME)
                ),
            );
        }
        if copies_too_long(object) {
            let time = |time: Option<Nanos>| time.unwrap_or_default();
            self.contradicts(
                "copy-longer-than-cycle",
                format!(
                    "{} is {}, the minimum cycle in {} {}",
                    at(sub::CALC_AND_COPY_TIME),
                    time(values.calc_and_copy_time),
                    at(sub::MINIMUM_CYCLE_TIME),
                    time(values.minimum_cycle_time)
                ),
            );
        }
        let missing: Vec<String> = table::SUBS
            .into_iter()
            .filter(|sub| object.entry(*sub).is_none())
            .filter(|sub| *sub != sub::SHIFT_TIME || types.shift() != ShiftBy::LocalTimer)
            .filter(|sub| columns(types).any(|column| is_mandatory(index, *sub, column)))
            .map(|sub| format!("{sub:02X}"))
            .collect();
        if !missing.is_empty() {
            self.asks("missing", format!("modes that it announces ask for sub-indices of 0x{index:04X} that it does not have: {}", missing.join(", ")));
        }
    }
}

/// What lies where in the process RAM: name, first byte, behind the last. Three buffers lie one behind the other.
fn areas(device: &SubDevice) -> Vec<(String, u32, u32)> {
    let header = &device.sii.header;
    let mut areas = Vec::new();
    if device.has_mailbox() {
        for (name, area) in [("mailbox out", header.receive), ("mailbox in", header.send)] {
            areas.push((name.to_owned(), area.start.into(), u32::from(area.length)));
        }
    }
    for (name, data) in [("outputs", &device.outputs), ("inputs", &device.inputs)] {
        let Some(number) = data.sync_manager else { continue };
        let record = device.sii.sync_managers.get(usize::from(number));
        let buffers = if record.is_some_and(|record| record.control & 3 == 0) { 3 } else { 1 };
        areas.push((name.to_owned(), data.start.into(), buffers * u32::from(data.length)));
    }
    areas.retain(|(_, _, length)| *length > 0);
    areas.into_iter().map(|(name, start, length)| (name, start, start + length)).collect()
}

/// Word 4 of the SII.
pub(super) fn alias(device: &SubDevice) -> u16 {
    let words = &device.sii.header.configuration;
    u16::from_le_bytes([words[8], words[9]])
}
