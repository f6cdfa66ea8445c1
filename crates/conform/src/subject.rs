//! What the SubDevice says about itself, which is read once before the rules.

use isocat_segment::profile::{Deviation, Origin};
use isocat_sync::SupportedTypes;
use isocat_sync::SyncMode;
use isocat_sync::object::{
    ERROR_SETTINGS, INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, sub,
};
use isocat_wire::coe::info::EntryDescription;
use isocat_wire::eeprom::{EepromStatus, read_command};
use isocat_wire::sii::{Header, PdoEntryRecord, PdoRecord, SmRecord, category, sm_type, word};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;
use isocat_wire::{AlState, AlStatusCode, ObjectAddress, register};

use super::mode::{MODES, Mode};
use super::tester::{Al, Tester, Trouble, number};

/// What is known in advance, from a profile or a segment file.
#[derive(Clone, Debug, Default)]
pub struct Hints {
    /// PDOs to be assigned to SM2; empty: those that the SubDevice assigns by default.
    pub outputs: Vec<u16>,
    /// PDOs to be assigned to SM3; empty: those that the SubDevice assigns by default.
    pub inputs: Vec<u16>,
    /// Modes of a SubDevice that does not announce them itself.
    pub modes: Vec<SyncMode>,
    /// The expected vendor id and product code; `None`: any device.
    pub identity: Option<(u32, u32)>,
    /// Rules that it is known to break.
    pub deviations: Vec<Deviation>,
    /// The origin of a simulated device.
    pub stand_in: Option<Origin>,
    /// Rules that a stand-in can only break because of an assumption, each with what is not known.
    pub assumed: Vec<(&'static str, &'static str)>,
}

/// The SubDevice, as it describes itself.
#[derive(Clone, Debug, Default)]
pub struct Subject {
    /// Contents of the SII header.
    pub header: Header,
    /// SM0 and following, from the SII.
    pub sms: Vec<SmRecord>,
    /// Outputs: SM2, RxPDOs, 0x1C12.
    pub outputs: Direction,
    /// Inputs: SM3, TxPDOs, 0x1C13.
    pub inputs: Direction,
    /// Whether it has a clock and a SYNC unit.
    pub has_dc: bool,
    /// Contents of its objects; `None` without CoE.
    pub coe: Option<Coe>,
    /// Modes that it announces.
    pub modes: Vec<Mode>,
}

/// One direction of the process data.
#[derive(Clone, Debug, Default)]
pub struct Direction {
    /// PDOs to be assigned.
    pub pdos: Vec<u16>,
    /// Whether 0x1C12 or 0x1C13 can be written in PREOP.
    pub writable: bool,
    /// Highest sub-index of 0x1C12 or 0x1C13.
    pub slots: u8,
    /// Number of bytes.
    pub len: u16,
    /// Number of its SyncManager: the first of this type in the SII; without one, 2 for outputs and
    /// 3 for inputs.
    pub sm: usize,
}

/// Contents of the objects.
#[derive(Clone, Debug, Default)]
pub struct Coe {
    /// 0x1C32, if it exists.
    pub output: Option<SyncObject>,
    /// 0x1C33, if it exists.
    pub input: Option<SyncObject>,
    /// Value of 0x10F1:02.
    pub error_limit: Option<u64>,
}

/// A sync object, by SDO information and single reads.
#[derive(Clone, Debug, Default)]
pub struct SyncObject {
    /// Index.
    pub index: u16,
    /// Its entries, ascending, including gaps.
    pub entries: Vec<Entry>,
}

/// An entry of a sync object.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Sub-index.
    pub sub: u8,
    /// Its description by SDO information.
    pub description: EntryDescription,
    /// Its value in PREOP, little-endian; `None`: it is a gap, or can't be read.
    pub value: Option<Vec<u8>>,
}

impl SyncObject {
    /// The entry, if it is no gap.
    pub fn entry(&self, sub: u8) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.sub == sub && entry.description.data_type != 0)
    }

    /// The value of an entry in PREOP.
    pub fn value(&self, sub: u8) -> Option<u64> {
        self.entry(sub)?.value.as_deref().map(number)
    }

    /// The types that 04 announces; none if 04 does not exist.
    pub fn types(&self) -> SupportedTypes {
        SupportedTypes(self.value(sub::SUPPORTED_TYPES).unwrap_or(0) as u16)
    }

    /// Whether an entry can be written in PREOP.
    pub fn writable(&self, sub: u8) -> bool {
        use isocat_wire::coe::info::Access;
        self.entry(sub).is_some_and(|e| e.description.access.has_any(Access::WRITE_PREOP))
    }

    /// The address of one of its entries.
    pub fn at(&self, sub: u8) -> ObjectAddress {
        ObjectAddress::new(self.index, sub)
    }
}

impl Subject {
    /// Reads all that the SubDevice says about itself. Returns its state, which is PREOP or the
    /// first refusal.
    pub fn survey(t: &mut Tester<'_>, hints: &Hints) -> Result<(Self, Al), Trouble> {
        let mut subject = Self::default();
        t.restart()?;
        let (rx, tx) = subject.read_sii(t)?;
        subject.has_dc = t.has_sync_unit;
        for (direction, kind, usual) in
            [(&mut subject.outputs, sm_type::OUTPUTS, 2), (&mut subject.inputs, sm_type::INPUTS, 3)]
        {
            let found = subject.sms.iter().position(|record| record.kind == kind);
            direction.sm = found.unwrap_or(usual);
        }
        subject.outputs.pdos = defaults(&rx, &hints.outputs);
        subject.inputs.pdos = defaults(&tx, &hints.inputs);
        let al = subject.preop(t)?;
        let speaks = subject.has_mailbox() && subject.header.protocols & Header::COE != 0;
        if speaks && al.is(AlState::PreOp) {
            subject.read_objects(t, hints, (&rx, &tx))?;
        } else {
            for (direction, pdos) in [(&mut subject.outputs, &rx), (&mut subject.inputs, &tx)] {
                let bits: u32 = pdos
                    .iter()
                    .filter(|(record, _)| direction.pdos.contains(&record.index))
                    .map(|(_, bits)| bits)
                    .sum();
                direction.len = bits.div_ceil(8) as u16;
            }
            subject.modes =
                (MODES.into_iter()).filter(|mode| hints.modes.contains(&mode.mode)).collect();
            if hints.modes.is_empty() {
                // A SubDevice that does not state its modes works on the arrival of frames.
                subject.modes =
                    MODES.into_iter().filter(|mode| mode.mode == SyncMode::SmSynchronous).collect();
            }
        }
        Ok((subject, al))
    }

    /// Whether outputs or inputs are in more SyncManagers than one.
    pub fn shares_a_direction(&self) -> bool {
        [sm_type::OUTPUTS, sm_type::INPUTS].into_iter().any(|kind| {
            self.sms.iter().filter(|record| record.kind == kind && record.length > 0).count() > 1
        })
    }

    /// Goes from INIT to PREOP.
    pub fn preop(&self, t: &mut Tester<'_>) -> Result<Al, Trouble> {
        if self.has_mailbox() {
            let (receive, send) = (self.header.receive, self.header.send);
            t.mailbox.receive = receive;
            t.mailbox.send = send;
            let control = |at: usize, usual| match self.sms.get(at) {
                Some(sm) if sm.control != 0 => sm.control,
                _ => usual,
            };
            let out = control(0, SyncManager::MAILBOX_OUT);
            t.set(
                register::sync_manager(0),
                SyncManager::new(receive.start, receive.length, out, true),
            )?;
            let inp = control(1, SyncManager::MAILBOX_IN);
            t.set(register::sync_manager(1), SyncManager::new(send.start, send.length, inp, true))?;
        }
        t.change(AlState::PreOp, Nanos::millis(3_000))
    }

    /// Whether it has a mailbox.
    pub fn has_mailbox(&self) -> bool {
        self.header.receive.length > 0 && self.header.send.length > 0
    }

    /// 0x1C32 and 0x1C33, if they exist.
    pub fn sync_objects(&self) -> impl Iterator<Item = &SyncObject> {
        let coe = self.coe.iter();
        coe.flat_map(|coe| [&coe.output, &coe.input]).flatten()
    }

    /// Whether there are process data in the direction of a sync object.
    pub fn transmits(&self, object: &SyncObject) -> bool {
        match object.index {
            OUTPUT_PARAMETER => self.outputs.len > 0,
            _ => self.inputs.len > 0,
        }
    }

    /// The sync objects of the directions with process data.
    pub(crate) fn live_objects(&self) -> impl Iterator<Item = &SyncObject> {
        self.sync_objects().filter(|object| self.transmits(object))
    }

    /// The sync object that counts for the SubDevice: that of the outputs if there are any.
    pub fn leading(&self) -> Option<&SyncObject> {
        let coe = self.coe.as_ref()?;
        let first = if self.outputs.len > 0 { &coe.output } else { &coe.input };
        first.as_ref().or(coe.output.as_ref()).or(coe.input.as_ref())
    }

    /// The larger of the values that both sync objects state; 0 if neither states one.
    pub fn stated(&self, sub: u8) -> u64 {
        self.sync_objects().filter_map(|object| object.value(sub)).max().unwrap_or(0)
    }

    /// The types that all directions with process data announce.
    pub fn types(&self) -> u64 {
        let announced = self.live_objects().filter_map(|object| object.value(sub::SUPPORTED_TYPES));
        announced.reduce(|one, other| one & other).unwrap_or(0)
    }

    /// Whether the MainDevice may choose the type in every sync object.
    pub(crate) fn chooses_type(&self) -> bool {
        let mut objects = self.sync_objects().peekable();
        objects.peek().is_some() && objects.all(|object| object.writable(sub::SYNC_TYPE))
    }

    /// The shortest cycle that it states.
    pub fn minimum_cycle(&self) -> Nanos {
        Nanos(self.stated(sub::MINIMUM_CYCLE_TIME) as i64)
    }

    /// The settings of a process data SyncManager, by its number.
    pub fn sync_manager(&self, number: usize) -> SyncManager {
        let is_output = number == self.outputs.sm;
        let direction = if is_output { &self.outputs } else { &self.inputs };
        let usual = if is_output { SyncManager::OUTPUTS } else { SyncManager::INPUTS };
        let record = self.sms.get(number);
        let control = record.map(|sm| sm.control).filter(|c| *c != 0).unwrap_or(usual);
        let start = record.map_or(0, |sm| sm.start);
        SyncManager::new(start, direction.len, control, direction.len > 0)
    }

    fn read_sii(&mut self, t: &mut Tester<'_>) -> Result<(Vec<Pdo>, Vec<Pdo>), Trouble> {
        t.write(register::EEPROM_CONFIGURATION.address, &[0])?;
        let head = words(t, 0, usize::from(word::MAILBOX_PROTOCOLS) + 1)?;
        let mut image = head;
        image.resize(isocat_wire::sii::HEADER_LEN, 0);
        self.header = Header::parse(&image).unwrap_or_default();
        let (mut rx, mut tx) = (Vec::new(), Vec::new());
        let mut at = usize::from(word::CATEGORIES);
        while at < MOST_WORDS {
            let head = words(t, at, 2)?;
            let kind = number(&head[..2]) as u16;
            let length = number(&head[2..]) as usize;
            if kind == category::END {
                t.write(register::EEPROM_CONFIGURATION.address, &[1])?;
                return Ok((rx, tx));
            }
            match kind {
                category::SYNC_MANAGER => {
                    let data = words(t, at + 2, length)?;
                    let records = data.chunks_exact(SmRecord::LEN);
                    self.sms =
                        records.filter_map(|r| r.first_chunk()).map(SmRecord::parse).collect();
                }
                category::RX_PDO => rx.extend(pdos(&words(t, at + 2, length)?)),
                category::TX_PDO => tx.extend(pdos(&words(t, at + 2, length)?)),
                _ => {}
            }
            at += 2 + length;
        }
        Err(Trouble::new("SII: the categories have no end"))
    }

    fn read_objects(
        &mut self,
        t: &mut Tester<'_>,
        hints: &Hints,
        sii: (&[Pdo], &[Pdo]),
    ) -> Result<(), Trouble> {
        for (direction, index, wanted, pdos) in [
            (&mut self.outputs, OUTPUT_ASSIGNMENT, &hints.outputs, sii.0),
            (&mut self.inputs, INPUT_ASSIGNMENT, &hints.inputs, sii.1),
        ] {
            if t.value(ObjectAddress::new(index, 0))?.is_none() {
                continue;
            }
            let assigned = t.assignment(index)?;
            use isocat_wire::coe::info::Access;
            if let Ok(entry) = t.describe_entry(ObjectAddress::new(index, 0))? {
                direction.writable = entry.access.has_any(Access::WRITE_PREOP);
            }
            direction.slots = t.describe_object(index)?.map_or(0, |object| object.max_sub);
            direction.pdos = match (direction.writable, wanted.is_empty(), assigned.is_empty()) {
                (true, false, _) => wanted.clone(),
                // The device's description assigns nothing on purpose.
                (true, true, true) if hints.identity.is_some() => Vec::new(),
                // Nothing is assigned: takes the first PDO.
                (true, true, true) => pdos.iter().map(|(pdo, _)| pdo.index).take(1).collect(),
                _ => assigned.clone(),
            };
            let mut bits = 0;
            for pdo in &direction.pdos {
                let entries = t.value(ObjectAddress::new(*pdo, 0))?.unwrap_or(0);
                for sub in 1..=entries.min(254) as u8 {
                    bits += t.value(ObjectAddress::new(*pdo, sub))?.unwrap_or(0) & 0xFF;
                }
            }
            direction.len = bits.div_ceil(8) as u16;
        }
        let error_limit = t.value(ObjectAddress::new(ERROR_SETTINGS, 2))?;
        let output = sync_object(t, OUTPUT_PARAMETER)?;
        let input = sync_object(t, INPUT_PARAMETER)?;
        self.coe = Some(Coe { output, input, error_limit });
        let types = self.types();
        self.modes = MODES
            .into_iter()
            .filter(|mode| types & u64::from(mode.needs) == u64::from(mode.needs))
            .collect();
        Ok(())
    }
}

/// A PDO of the SII and its bits.
type Pdo = (PdoRecord, u32);

fn sync_object(t: &mut Tester<'_>, index: u16) -> Result<Option<SyncObject>, Trouble> {
    let Ok(head) = t.describe_object(index)? else { return Ok(None) };
    let mut object = SyncObject { index, entries: Vec::new() };
    for sub in 0..=head.max_sub {
        let at = ObjectAddress::new(index, sub);
        let Ok(description) = t.describe_entry(at)? else { continue };
        let value = if description.data_type == 0 { None } else { t.upload(at)?.ok() };
        object.entries.push(Entry { sub, description, value });
    }
    Ok(Some(object))
}

/// The wanted PDOs, or those that are assigned by default.
fn defaults(pdos: &[Pdo], wanted: &[u16]) -> Vec<u16> {
    if !wanted.is_empty() {
        return wanted.to_vec();
    }
    pdos.iter()
        .map(|(record, _)| *record)
        .filter(|pdo| pdo.sm != 0xFF)
        .map(|pdo| pdo.index)
        .collect()
}

fn pdos(data: &[u8]) -> Vec<Pdo> {
    let mut found = Vec::new();
    let mut records = data.chunks_exact(PdoRecord::LEN).filter_map(|r| r.first_chunk());
    while let Some(head) = records.next() {
        let record = PdoRecord::parse(head);
        let entries = records.by_ref().take(usize::from(record.entries));
        let bits = entries.map(|entry| u32::from(PdoEntryRecord::parse(entry).bits)).sum();
        found.push((record, bits));
    }
    found
}

/// Reads words of the SII, as bytes.
fn words(t: &mut Tester<'_>, first: usize, count: usize) -> Result<Vec<u8>, Trouble> {
    let mut bytes = Vec::with_capacity(2 * count + 8);
    let end = t.now() + SII_PATIENCE;
    while bytes.len() < 2 * count {
        let at = first + bytes.len() / 2;
        let command = read_command(at as u32);
        t.write(register::EEPROM_STATUS.address, &command)?;
        loop {
            let reply = t.read(register::EEPROM_STATUS.address, ACCESS_LEN)?;
            let status = EepromStatus(number(&reply[..2]) as u16);
            if !status.busy() && !status.failed() {
                bytes.extend_from_slice(&reply[6..6 + status.read_len()]);
                break;
            }
            if t.now() > end {
                return Err(Trouble::new(format!("SII: word 0x{at:04X} can't be read")));
            }
            if !status.busy() {
                t.write(register::EEPROM_STATUS.address, &[0, 0])?;
                t.write(register::EEPROM_STATUS.address, &command)?;
            }
            t.pause(Nanos::micros(100))?;
        }
    }
    bytes.truncate(2 * count);
    Ok(bytes)
}

/// Whether the state is this one with an error, and the code is one of these.
pub fn refused(al: &Al, state: AlState, codes: &[AlStatusCode]) -> bool {
    al.status.error() && al.status.state() == Ok(state) && codes.contains(&al.code)
}

const ACCESS_LEN: usize = 14;
const MOST_WORDS: usize = 0x8000;
const SII_PATIENCE: Nanos = Nanos::millis(2_000);
