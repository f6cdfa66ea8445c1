//! Virtual SubDevices from ESI files.
//!
//! A device of an [`EsiFile`] in one of its OpModes becomes the same draft as a profile file, so
//! that stack and simulator do not depend on the source of a device. Values that the description
//! does not state are filled in and listed in [`Profile::assumptions`]; a property that the virtual
//! device does not support is an [`Obstacle`].

use std::collections::HashMap;
use std::fmt;
use std::ops::RangeInclusive;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use isocat_descriptions::document::{FileError, Source};
use isocat_descriptions::esi::{
    Direction, EsiDevice, EsiFile, EsiOpMode, EsiPdo, FittedModule, Purpose, Warning, WarningKind,
    data_type,
};
use isocat_esc::chip::{Chip, DcUnits, ET1100};
use isocat_maindevice::WatchdogRegisters;
use isocat_sim::Sampling;
use isocat_subdevice::description::{Behaviour, Mailbox};
use isocat_subdevice::{MAX_AREAS, MAX_MAILBOX, MAX_PROCESS_DATA, MIN_MAILBOX, Speaks};
use isocat_sync::{SupportedTypes, object};
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::Access;
use isocat_wire::dc::AssignActivate;
use isocat_wire::register::features;
use isocat_wire::sii::MailboxArea;
use isocat_wire::time::Nanos;

use super::draft::{Area, Assumed, Draft, Esc, Item, Pdo, PdoEntry, Placed, Share, Times};
use super::write::ProfileText;
use super::{
    ApplicationKind, Doubt, DoubtKind, Identity, OpMode, Origin, Profile, check, dictionary, drive,
    ports,
};

mod eeprom;
mod objects;
mod op_mode;
mod sampling;
mod soe;
mod startup;
mod windows;

pub use op_mode::{RunAs, TakenOpMode};

/// Why a device of a description cannot be a virtual SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Obstacle {
    /// It has no product code.
    Placeholder,
    /// Process data of one direction are in more SyncManagers than the stack supports, or in others
    /// beside a mailbox than the sync objects are about.
    SeveralSyncManagers,
    /// A direction has more process data than the stack's buffers.
    ProcessDataTooLong,
    /// Process data are neither in the process RAM nor in the registers of digital outputs.
    ProcessDataInRegisters,
    /// A PDO has more entries than a mapping object.
    TooManyEntries,
    /// The mailbox is too short or too long for the stack, or not in SyncManagers 0 and 1.
    MailboxArea,
    /// Areas in the memory of the ESC overlap.
    MemoryOverlap,
    /// The device does not fit into the dictionary or the EEPROM.
    TooLarge,
    /// The pulses of an OpMode do not fit the bus cycle, or the ESC's step of 10 ns.
    Sync0Cycle,
    /// The device itself sets up the SYNC unit in this OpMode.
    SyncUnitAtPdi,
}

impl Obstacle {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Placeholder,
        Self::SeveralSyncManagers,
        Self::ProcessDataTooLong,
        Self::ProcessDataInRegisters,
        Self::TooManyEntries,
        Self::MailboxArea,
        Self::MemoryOverlap,
        Self::TooLarge,
        Self::Sync0Cycle,
        Self::SyncUnitAtPdi,
    ];

    /// The name, as words joined by dashes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Placeholder => "placeholder",
            Self::SeveralSyncManagers => "several-sync-managers",
            Self::ProcessDataTooLong => "process-data-too-long",
            Self::ProcessDataInRegisters => "process-data-in-registers",
            Self::TooManyEntries => "too-many-entries",
            Self::MailboxArea => "mailbox-area",
            Self::MemoryOverlap => "memory-overlap",
            Self::TooLarge => "too-large",
            Self::Sync0Cycle => "sync0-cycle",
            Self::SyncUnitAtPdi => "sync-unit-at-pdi",
        }
    }

    /// What it means, in a sentence.
    pub const fn means(self) -> &'static str {
        match self {
            Self::Placeholder => "It has no product code.",
            Self::SeveralSyncManagers => {
                "Process data of one direction are in more SyncManagers than the stack supports, or in \
                 others beside a mailbox than the sync objects are about."
            }
            Self::ProcessDataTooLong => {
                "A direction has more process data than the stack's buffers."
            }
            Self::ProcessDataInRegisters => {
                "Process data are neither in the process RAM nor in the registers of digital outputs."
            }
            Self::TooManyEntries => "A PDO has more entries than a mapping object.",
            Self::MailboxArea => {
                "The mailbox is too short or too long for the stack, or not in SyncManagers 0 and 1."
            }
            Self::MemoryOverlap => "Areas in the memory of the ESC overlap.",
            Self::TooLarge => "The device does not fit into the dictionary or the EEPROM.",
            Self::Sync0Cycle => {
                "The pulses of an OpMode do not fit the bus cycle, or the ESC's step of 10 ns."
            }
            Self::SyncUnitAtPdi => "The device itself sets up the SYNC unit in this OpMode.",
        }
    }
}

/// An obstacle and its place in the description.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct NotSimulated {
    /// The obstacle.
    pub obstacle: Obstacle,
    /// Place and message.
    pub error: FileError,
}

impl fmt::Display for NotSimulated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)
    }
}

impl std::error::Error for NotSimulated {}

impl Profile {
    /// The virtual SubDevice of a device in one of its OpModes, by number; `None` for a device
    /// without OpModes. A device with slots has its default modules, unless it comes from
    /// [`EsiFile::fitted`]. Equal devices of equal texts give the same profile.
    pub fn from_esi(
        file: &EsiFile,
        device: &EsiDevice,
        op_mode: Option<usize>,
    ) -> Result<Arc<Profile>, NotSimulated> {
        type Key = (String, u64, usize, Option<usize>, Vec<FittedModule>);
        static INTERNED: LazyLock<Mutex<HashMap<Key, Arc<Profile>>>> =
            LazyLock::new(Mutex::default);
        let device = &*file.with_default_modules(device);
        let modules = device.modules.clone();
        let key = (file.path.clone(), file.fingerprint(), device.at, op_mode, modules);
        let known = INTERNED.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(profile) = known {
            return Ok(profile);
        }
        let profile = Import::new(file, device, op_mode).profile()?;
        let mut interned = INTERNED.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(interned.entry(key).or_insert_with(|| Arc::new(profile)).clone())
    }
}

impl ProfileText {
    /// The profile file of a device in one of its OpModes, by number; `None` for a device without
    /// OpModes. The file has all OpModes; the chosen one determines the assigned PDOs and the
    /// announced mode. A device with slots has its default modules. `made_of` names the source.
    pub fn from_esi(
        file: &EsiFile,
        device: &EsiDevice,
        op_mode: Option<usize>,
        made_of: &str,
    ) -> Result<Self, FileError> {
        let device = &*file.with_default_modules(device);
        let mut import = Import::new(file, device, op_mode);
        let draft = import.draft().map_err(|not_simulated| not_simulated.error)?;
        if import.sampling.is_some() {
            let words = "a profile file has no samples: all values of a cycle are taken at once";
            import.doubts.push(Doubt::new(DoubtKind::Oversampling, words.to_owned()));
        }
        let doubts = import.doubts.iter().map(|doubt| format!("{}: {}", doubt.kind, doubt.what));
        super::write::text(draft, made_of, doubts.collect())
    }
}

struct Import<'f> {
    file: &'f EsiFile,
    device: &'f EsiDevice,
    mode: Option<&'f EsiOpMode>,
    /// Whether the ESC answers AL control by itself, so that there is no program.
    emulated: bool,
    assumed: Vec<Assumed>,
    doubts: Vec<Doubt>,
    sampling: Option<Sampling>,
}

impl<'f> Import<'f> {
    fn new(file: &'f EsiFile, device: &'f EsiDevice, op_mode: Option<usize>) -> Self {
        Self {
            file,
            device,
            mode: op_mode.and_then(|number| device.op_modes().get(number)),
            emulated: false,
            assumed: Vec::new(),
            doubts: Vec::new(),
            sampling: None,
        }
    }

    fn profile(mut self) -> Result<Profile, NotSimulated> {
        let draft = self.draft()?;
        let of = |error| NotSimulated { obstacle: Obstacle::TooLarge, error };
        let mut profile = draft.finish().map_err(of)?;
        profile.doubts = self.doubts;
        profile.sampling = self.sampling;
        profile.physics = self.device.physics.clone();
        profile.origin = Origin::Description;
        Ok(profile)
    }

    fn draft(&mut self) -> Result<Draft<'f>, NotSimulated> {
        let device = self.device;
        let Some(product_code) = device.product_code else {
            return Err(self.stopped(Obstacle::Placeholder, device.at, "it has no product code"));
        };
        let unused = |warning: &&Warning| warning.kind == WarningKind::RegisterUnused;
        let unused = device.warnings.iter().filter(unused);
        self.doubts.extend(unused.map(|one| Doubt::new(one.kind, one.message.clone())));
        let identity = Identity {
            vendor_id: self.file.vendor_id,
            product_code,
            revision: device.revision.unwrap_or(0),
            serial: device.serial,
        };
        let mut mailbox = self.mailbox()?;
        let mut image = device.image(self.mode);
        let (guarded, windows) = self.part(std::mem::take(&mut image.inputs));
        image.inputs = guarded;
        let both =
            [(Direction::Outputs, &image.outputs[..]), (Direction::Inputs, &image.inputs[..])];
        let speaks = mailbox.is_some().then(|| self.speaks(both));
        if let (Some(mailbox), Some(speaks)) = (&mut mailbox, speaks) {
            mailbox.value.speaks = speaks;
        }
        let mut outputs = self.area(Direction::Outputs, &image.outputs, mailbox.is_some())?;
        let mut inputs = self.area(Direction::Inputs, &image.inputs, mailbox.is_some())?;
        let windows = self.windows(&windows, inputs.as_ref(), mailbox.is_some())?;
        self.sampling = self.sampling(&image);
        self.emulated = mailbox.is_none() && self.has_emulation([&outputs, &inputs]);
        shorten(&mut outputs, &inputs, mailbox.map(|mailbox| mailbox.value));
        shorten(&mut inputs, &outputs, mailbox.map(|mailbox| mailbox.value));
        let coe = device.mailbox.as_ref().is_some_and(|mailbox| mailbox.coe.is_some());
        let objects = match mailbox.filter(|_| coe) {
            Some(_) => self.objects([&outputs, &inputs]),
            None => Vec::new(),
        };
        if mailbox.is_some() && coe {
            self.assume_identity(&objects);
        }
        let chip = self.chip(mailbox.map(|mailbox| mailbox.value), [&outputs, &inputs]);
        let times = self.times(&objects);
        let eeprom =
            self.eeprom([&outputs, &inputs], windows, mailbox.map(|mailbox| mailbox.value));
        let name = |text: &str, other: &str| {
            let text = if text.is_empty() { other } else { text };
            super::sii::cut(text).to_owned()
        };
        let mut draft = Draft {
            source: Source { path: &self.file.path, text: self.file.text() },
            id: name(&device.type_name, "device"),
            name: name(&device.name, &device.type_name),
            vendor: name(&self.file.vendor, "unknown"),
            application: drive::layout(&outputs, &inputs)
                .map_or(ApplicationKind::Io, ApplicationKind::DriveAt),
            identity,
            device_type: device.profile.number.unwrap_or(0).into(),
            hardware_version: VERSION.to_owned(),
            software_version: VERSION.to_owned(),
            esc: Esc {
                at: device.at,
                chip: ("ET1100", chip),
                sync_unit: device.dc.is_some(),
                pulse: Nanos::micros(10),
                alias: 0,
                clock_tolerance: None,
                watchdog: WatchdogRegisters {
                    divider: device.registers.divider,
                    pdi: device.registers.pdi,
                    process_data: device.registers.process_data,
                },
            },
            mailbox,
            protocols: device.mailbox.as_ref().map_or(0, |mailbox| mailbox.protocols),
            modes: mailbox.is_none().then(|| Placed { at: device.at, value: self.modes() }),
            outputs,
            inputs,
            objects,
            op_modes: device.op_modes().iter().map(op_mode).collect(),
            startup: Vec::new(),
            parameters: Vec::new(),
            times,
            behaviour: Placed { at: device.at, value: self.behaviour() },
            assumed: std::mem::take(&mut self.assumed),
            deviations: Vec::new(),
            dynamic_times: false,
            eeprom: Some(eeprom),
        };
        dictionary::complete(&mut draft);
        self.open_mapping(&mut draft);
        let of = |obstacle| move |error| NotSimulated { obstacle, error };
        check::memory(&draft).map_err(of(Obstacle::MemoryOverlap))?;
        check::stored(&draft).map_err(of(Obstacle::TooLarge))?;
        draft.startup = self.startup(&draft);
        match speaks {
            Some(speaks) => draft.parameters = self.parameters_at_start(&speaks),
            None => self.parameters_without_mailbox(),
        }
        draft.assumed.append(&mut self.assumed);
        Ok(draft)
    }

    fn stopped(&self, obstacle: Obstacle, at: usize, message: impl Into<String>) -> NotSimulated {
        let name = &self.device.type_name;
        let message =
            format!("{name} can't be simulated ({}): {}", obstacle.name(), message.into());
        NotSimulated { obstacle, error: self.file.error(at, message) }
    }

    fn assume(&mut self, item: &str, value: impl Into<String>, why: &str) {
        let item = Placed { at: self.device.at, value: Item::Key(item.to_owned(), value.into()) };
        self.assumed.push(Assumed { item, why: why.to_owned() });
    }

    /// Names what 0x1000, 0x1009 and 0x100A hold without a statement of the description.
    fn assume_identity(&mut self, objects: &[super::draft::Object]) {
        let stated = |index| objects.iter().any(|object| object.index == index);
        let why = "the description does not state it";
        if !stated(0x1000) && self.device.profile.number.is_none() {
            self.assume("identity.device_type", "0", why);
        }
        for (index, key) in
            [(0x1009, "identity.hardware_version"), (0x100A, "identity.software_version")]
        {
            if !stated(index) {
                self.assume(key, VERSION, why);
            }
        }
    }

    fn mailbox(&mut self) -> Result<Option<Placed<Mailbox>>, NotSimulated> {
        let find = |purpose| self.device.sync_managers.iter().position(|sm| sm.purpose == purpose);
        let (Some(out), Some(back)) = (find(Purpose::MailboxOut), find(Purpose::MailboxIn)) else {
            return Ok(None);
        };
        if self.device.mailbox.is_none() {
            return Ok(None);
        }
        let at = self.device.sync_managers[out].at;
        if (out, back) != (0, 1) {
            let message =
                format!("its mailbox is in SyncManagers {out} and {back}; expected 0 and 1");
            return Err(self.stopped(Obstacle::MailboxArea, at, message));
        }
        let area = |number: usize| {
            let sm = &self.device.sync_managers[number];
            MailboxArea { start: sm.start, length: sm.default_size }
        };
        let (receive, send) = (area(out), area(back));
        for MailboxArea { start, length } in [receive, send] {
            if !(MIN_MAILBOX..=MAX_MAILBOX).contains(&usize::from(length)) || start < 0x1000 {
                let message = format!(
                    "a mailbox of {length} bytes at 0x{start:04X}; expected {MIN_MAILBOX} to \
                     {MAX_MAILBOX} in the process RAM"
                );
                return Err(self.stopped(Obstacle::MailboxArea, at, message));
            }
        }
        Ok(Some(Placed { at, value: Mailbox { receive, send, speaks: Speaks::COE } }))
    }

    /// The area of a direction: the SyncManager that has PDOs, and all PDOs that could be assigned
    /// to it.
    fn area(
        &mut self,
        direction: Direction,
        assigned: &[(u8, Vec<EsiPdo>)],
        has_mailbox: bool,
    ) -> Result<Option<Area>, NotSimulated> {
        let (purpose, usual) = match direction {
            Direction::Outputs => (Purpose::Outputs, 2),
            Direction::Inputs => (Purpose::Inputs, 3),
        };
        let device = self.device;
        let coe = device.mailbox.as_ref().is_some_and(|mailbox| mailbox.coe.is_some());
        let coe = coe && has_mailbox;
        let with_data: Vec<_> = assigned
            .iter()
            .filter(|(_, pdos)| pdos.iter().any(|pdo| pdo.bits() > 0))
            .map(|(number, pdos)| (usize::from(*number), &pdos[..]))
            .collect();
        // PDOs without entries are assigned all the same, where there is an object that says so.
        let without_data = assigned.first().map(|(number, pdos)| (usize::from(*number), &pdos[..]));
        let unassigned = || {
            let number = device.sync_managers.iter().position(|sm| sm.purpose == purpose);
            number.map(|number| (number, &[][..]))
        };
        let (number, pdos) = match with_data[..] {
            [one] => one,
            [] => match without_data.or_else(unassigned) {
                Some(found) if has_mailbox => found,
                _ => return Ok(None),
            },
            [_, (second, _), ..] if with_data.len() > MAX_AREAS => {
                let at = device.sync_managers[second].at;
                let message = format!(
                    "its {} are in {} SyncManagers; expected at most {MAX_AREAS}",
                    word(direction),
                    with_data.len(),
                );
                return Err(self.stopped(Obstacle::SeveralSyncManagers, at, message));
            }
            // 0x1C12 and 0x1C32 belong to SM2, 0x1C13 and 0x1C33 to SM3, and each further one has
            // an assignment by its number.
            [(first, _), (second, _), ..] if coe && (first != usual || second < 4) => {
                let at = device.sync_managers[second].at;
                let message = format!(
                    "its {} are in SM{first} and SM{second}; expected SM{usual} and, beside a \
                     mailbox with CoE, further ones from SM4 on",
                    word(direction),
                );
                return Err(self.stopped(Obstacle::SeveralSyncManagers, at, message));
            }
            [first, ..] => first,
        };
        let sm = &device.sync_managers[number];
        let bytes = bytes_of(pdos);
        let further = with_data.get(1..).unwrap_or_default();
        let total = bytes + further.iter().map(|(_, pdos)| bytes_of(pdos)).sum::<usize>();
        if total > MAX_PROCESS_DATA {
            let message = format!(
                "{total} bytes of {}; expected at most {MAX_PROCESS_DATA}",
                word(direction)
            );
            return Err(self.stopped(Obstacle::ProcessDataTooLong, sm.at, message));
        }
        let numbers = std::iter::once((number, pdos)).chain(further.iter().copied());
        for (number, pdos) in numbers {
            self.check_place(direction, number, bytes_of(pdos), has_mailbox)?;
        }
        let share = |&(number, pdos): &(usize, &[EsiPdo])| Share {
            at: device.sync_managers[number].at,
            sync_manager: number as u8,
            start: device.sync_managers[number].start,
            length: bytes_of(pdos) as u16,
            pdos: pdos.iter().map(|pdo| pdo.index).collect(),
        };
        let further_pdos = further.iter().flat_map(|(_, pdos)| *pdos);
        let mut all: Vec<Pdo> = Vec::new();
        // A device without mailbox has no other assignment.
        let others = device.pdos.iter().filter(|pdo| has_mailbox && pdo.direction == direction);
        for pdo in pdos.iter().chain(further_pdos).chain(others) {
            if all.iter().all(|known| known.index != pdo.index) {
                all.push(self.pdo(pdo)?);
            }
        }
        let default: Vec<_> =
            pdos.iter().map(|pdo| Placed { at: pdo.at, value: pdo.index }).collect();
        let assignable = device
            .mailbox
            .as_ref()
            .and_then(|mailbox| mailbox.coe.as_ref())
            .is_some_and(|coe| coe.pdo_assign);
        let most = sm.max_size.unwrap_or(0).max(sm.default_size);
        // Three buffers of the most bytes could reach into a further SyncManager.
        let alone = has_mailbox && further.is_empty();
        let longest = if alone { bytes.max(most.into()) } else { bytes };
        Ok(Some(Area {
            at: sm.at,
            sync_manager: number as u8,
            start: sm.start,
            length: longest.min(MAX_PROCESS_DATA) as u16,
            access: match assignable {
                true => Access::READ.with(Access::WRITE_PREOP),
                false => Access::READ,
            },
            slots: all.len().max(default.len()).clamp(1, 254) as u8,
            recommended: default.clone(),
            default,
            pdos: all,
            further: further.iter().map(share).collect(),
        }))
    }

    /// Checks that process data are in the process RAM, or in the registers that drive digital
    /// outputs.
    fn check_place(
        &self,
        direction: Direction,
        number: usize,
        bytes: usize,
        has_mailbox: bool,
    ) -> Result<(), NotSimulated> {
        let sm = &self.device.sync_managers[number];
        let start = usize::from(sm.start);
        let digital = direction == Direction::Outputs
            && !has_mailbox
            && check::DIGITAL_OUTPUTS.contains(&start)
            && start + bytes <= check::DIGITAL_OUTPUTS.end;
        if start >= 0x1000 || digital {
            return Ok(());
        }
        let message = format!(
            "its {} lie in registers, {bytes} bytes at 0x{start:04X}; expected 0x1000 or more, or digital \
             outputs of a device without mailbox at 0x{:04X} to 0x{:04X}",
            word(direction),
            check::DIGITAL_OUTPUTS.start,
            check::DIGITAL_OUTPUTS.end - 1
        );
        Err(self.stopped(Obstacle::ProcessDataInRegisters, sm.at, message))
    }

    /// Whether there is no program behind the ESC: ConfigData states it, or the outputs are
    /// registers.
    fn has_emulation(&self, areas: [&Option<Area>; 2]) -> bool {
        let words = self.device.eeprom.as_ref().and_then(|eeprom| eeprom.configuration);
        let mut places = areas.into_iter().flatten().flat_map(Area::places);
        words.is_some_and(|words| words[1] & super::sii::DEVICE_EMULATION != 0)
            || places.any(|(_, start, _)| start < 0x1000)
    }

    fn pdo(&self, pdo: &EsiPdo) -> Result<Pdo, NotSimulated> {
        let mut entries = Vec::new();
        for entry in &pdo.entries {
            let mut left = entry.bits;
            // A mapping entry has 8 bits for the length; what is longer maps nothing but its room.
            let object = entry.object.filter(|_| left <= 255);
            while left > 0 {
                let bits = left.min(255) as u8;
                left -= u16::from(bits);
                let data_type = match object {
                    Some(_) => data_type(&entry.data_type, bits.into()),
                    None => DataType::GAP,
                };
                let name = super::sii::cut(&entry.name).to_owned();
                entries.push(PdoEntry { at: entry.at, object, data_type, bits, name });
            }
        }
        if entries.len() > MOST_ENTRIES {
            let message = format!(
                "PDO 0x{:04X} has {} entries; expected at most {MOST_ENTRIES}",
                pdo.index,
                entries.len()
            );
            return Err(self.stopped(Obstacle::TooManyEntries, pdo.at, message));
        }
        let name = match pdo.name.as_str() {
            "" => format!("PDO 0x{:04X}", pdo.index),
            name => super::sii::cut(name).to_owned(),
        };
        Ok(Pdo { at: pdo.at, index: pdo.index, name, entries })
    }

    /// Modes of a device without mailbox: they follow from its OpModes.
    fn modes(&self) -> SupportedTypes {
        let mut types = FREE_RUN_AND_SM;
        for mode in self.device.op_modes() {
            if mode.sync0() || mode.sync1() {
                types |= DC_SYNC0;
            }
            if mode.sync1() {
                types |= DC_SYNC1 | DC_SUBORDINATED;
            }
        }
        SupportedTypes(types)
    }

    /// The behaviour that descriptions do not state. It includes the device's own deadline on the
    /// way to OP; `SafeopOpTimeout` is the wait of a MainDevice, which is different.
    fn behaviour(&mut self) -> Behaviour {
        let why = "no description states the device's own deadline; the usual one";
        self.assume("safeop_to_op_timeout", "9s", why);
        let words =
            || self.device.op_modes().iter().map(|mode| AssignActivate(mode.assign_activate));
        Behaviour {
            device_emulation: self.emulated,
            unit_without_pulses: words()
                .any(|word| word.activates() && !word.makes_sync0() && !word.makes_sync1()),
            ignores_sync1: words().any(AssignActivate::makes_sync1),
            watchdog_must_agree: false,
            // Several SYNC0 in a cycle take and give samples; the rest is done once.
            application_on_sync1: true,
            ..Behaviour::default()
        }
    }

    /// The CPU's times. If the dictionary states a time, it is used.
    fn times(&mut self, objects: &[super::draft::Object]) -> Times {
        let stated = |index, sub| {
            let object = objects.iter().find(|object| object.index == index)?;
            let entry = object.entries.iter().find(|entry| entry.sub == sub)?;
            let bytes = entry.default.iter().take(4).rev();
            Some(bytes.fold(0_i64, |sum, byte| sum << 8 | i64::from(*byte))).filter(|ns| *ns > 0)
        };
        if self.emulated {
            let why = "digital I/O without a program acts with the end of the frame, or with SYNC0";
            self.assume("times", "0 ns", why);
            return Times::none(self.device.at);
        }
        let minimum = stated(object::OUTPUT_PARAMETER, object::sub::MINIMUM_CYCLE_TIME);
        // Small against any cycle that the device can do.
        let cycle = self.mode.and_then(|mode| mode.cycle_time_sync0).map(|cycle| cycle.value.0);
        let shortest = minimum.into_iter().chain(cycle.filter(|ns| *ns > 0)).min();
        let small = shortest.map_or(10_000, |cycle| (cycle / 8).clamp(1, 10_000));
        let mut time = |index, what: &str| {
            let sub = object::sub::CALC_AND_COPY_TIME;
            stated(index, sub).map(Nanos).unwrap_or_else(|| {
                let value = Nanos(small);
                let why = "the description states none; short against the cycle";
                let item = Item::Key(format!("0x{index:04X}:{sub:02X}"), format!("{value} {what}"));
                let item = Placed { at: self.device.at, value: item };
                self.assumed.push(Assumed { item, why: why.to_owned() });
                value
            })
        };
        let calc_and_copy = time(object::OUTPUT_PARAMETER, "for the CPU");
        let input_copy = time(object::INPUT_PARAMETER, "for the CPU");
        for (sub, what) in [
            (object::sub::MINIMUM_CYCLE_TIME, "nothing stated: any cycle fits"),
            (object::sub::DELAY_TIME, "nothing stated: 0 is planned with"),
        ] {
            if stated(object::OUTPUT_PARAMETER, sub).is_none() {
                let item = format!("0x{:04X}:{sub:02X}", object::OUTPUT_PARAMETER);
                self.assume(&item, what, "the description states none");
            }
        }
        Times {
            at: self.device.at,
            reaction: Nanos::micros(50),
            calc_and_copy: Some(calc_and_copy),
            application: Nanos(small),
            input_copy: Some(input_copy),
            jitter: Nanos::ZERO,
            acknowledge: None,
            unevenness: Default::default(),
        }
    }

    /// An ESC with the ports of `Physics` and memory for all areas.
    fn chip(&mut self, mailbox: Option<Mailbox>, areas: [&Option<Area>; 2]) -> Chip {
        let ports = match ports::descriptor(self.device.physics.as_deref().unwrap_or_default()) {
            0 => ports::descriptor("YY"),
            ports => ports,
        };
        let places = areas.into_iter().flatten().flat_map(Area::places);
        let ends = places.map(|(_, start, length)| u32::from(start) + 3 * u32::from(length));
        let mailboxes = mailbox.iter().flat_map(|mailbox| [mailbox.receive, mailbox.send]);
        let ends = ends.chain(mailboxes.map(|area| u32::from(area.start) + u32::from(area.length)));
        let needed = ends.max().unwrap_or(0).saturating_sub(0x1000).div_ceil(1024) as u8;
        let narrow = self.device.dc.as_ref().is_some_and(|dc| dc.unknown_64_bit);
        let chip = Chip {
            ram_kib: needed.clamp(ET1100.ram_kib, 60),
            sm_count: 16,
            features: match narrow {
                true => ET1100.features & !features::DC_64_BIT,
                false => ET1100.features,
            },
            // With a Dc part it has the units, whatever the words for the EEPROM say.
            dc_units: match self.device.dc {
                Some(_) => DcUnits::Always,
                None => DcUnits::ByEeprom,
            },
            ..ET1100.with_ports(ports)
        };
        let why = "the description names no chip; its ports and its memory are the description's";
        self.assume("ESC", "ET1100", why);
        chip
    }
}

/// Shortens an area whose three buffers of maximum length would reach into the next area, but not
/// below its default length.
fn shorten(area: &mut Option<Area>, other: &Option<Area>, mailbox: Option<Mailbox>) {
    let Some(area) = area else { return };
    let mailboxes = mailbox.iter().flat_map(|mailbox| [mailbox.receive.start, mailbox.send.start]);
    let others = other.iter().flat_map(Area::places).map(|(_, start, _)| start);
    let starts = mailboxes.chain(others);
    let Some(next) = starts.filter(|start| *start > area.start).min() else { return };
    let least = area.bits(&area.default).div_ceil(8) as u16;
    area.length = area.length.min((next - area.start) / 3).max(least);
}

fn op_mode(mode: &EsiOpMode) -> OpMode {
    let factor = |cycle: Option<isocat_descriptions::esi::CycleTime>| {
        let factor = cycle.and_then(|cycle| cycle.factor).unwrap_or(0);
        factor.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    };
    let signed = || i32::MIN.into()..=i32::MAX.into();
    let time = |time: Option<Nanos>, range: RangeInclusive<i64>| {
        Nanos(time.map_or(0, |time| time.0).clamp(*range.start(), *range.end()))
    };
    OpMode {
        name: super::sii::cut(&mode.name).to_owned(),
        description: super::sii::cut(&mode.description).to_owned(),
        assign_activate: mode.assign_activate,
        sync0_factor: factor(mode.cycle_time_sync0),
        sync1_factor: factor(mode.cycle_time_sync1),
        sync0_cycle: time(mode.cycle_time_sync0.map(|cycle| cycle.value), 0..=u32::MAX.into()),
        sync0_shift: time(mode.shift_time_sync0.map(|shift| shift.value), signed()),
        sync1_shift: time(mode.shift_time_sync1.map(|shift| shift.value), signed()),
    }
}

const fn word(direction: Direction) -> &'static str {
    match direction {
        Direction::Outputs => "outputs",
        Direction::Inputs => "inputs",
    }
}

fn bytes_of(pdos: &[EsiPdo]) -> usize {
    pdos.iter().map(EsiPdo::bits).sum::<u32>().div_ceil(8) as usize
}

/// Version of hardware and software that no description states.
const VERSION: &str = "1.0";
/// Largest number of sub-indices of a mapping object.
const MOST_ENTRIES: usize = 254;
/// Bits of 0x1C32:04.
const FREE_RUN_AND_SM: u16 = 0x0003;
const SM_SYNCHRONOUS: u16 = 0x0002;
const DC_SYNC0: u16 = 0x0004;
const DC_SYNC1: u16 = 0x0008;
const DC_SUBORDINATED: u16 = 0x0010;
