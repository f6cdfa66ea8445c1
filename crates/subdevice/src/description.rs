//! The fixed properties of a device: its dictionary, its mailbox, its process data areas, its
//! times.

use isocat_sync::SupportedTypes;
use isocat_wire::coe::DataType;
use isocat_wire::coe::info::{Access, ObjectCode};
use isocat_wire::sii::MailboxArea;
use isocat_wire::soe::{Attribute, Idn};
use isocat_wire::time::Nanos;
use isocat_wire::{AlStatusCode, ObjectAddress};

use crate::misbehaviour::{Misbehaviour, Misbehaviours};
use crate::objects::MAX_TRANSFER;
use crate::process_data::{MAX_AREAS, MAX_PROCESS_DATA};

/// Everything that the stack must know about its device.
#[derive(Clone, Debug)]
pub struct Description {
    /// Object dictionary, ascending by index. It contains 0x1C00, 0x1C12, 0x1C13, 0x1C32, 0x1C33
    /// and 0x10F1 if the device has them, with the device's layout, access and start values.
    pub objects: &'static [Object],
    /// Mailbox areas; `None` without a mailbox.
    pub mailbox: Option<Mailbox>,
    /// Process data from the MainDevice, usually SM2.
    pub outputs: ProcessDataArea,
    /// Process data to the MainDevice, usually SM3.
    pub inputs: ProcessDataArea,
    /// Outputs in further SyncManagers, in the order of the process image after
    /// [`outputs`](Self::outputs); at most [`MAX_AREAS`] together with it. The SM2 event is that of
    /// the first one.
    pub further_outputs: &'static [ProcessDataArea],
    /// The same for inputs: the SM3 event is that of the first one.
    pub further_inputs: &'static [ProcessDataArea],
    /// Behaviour in which devices differ.
    pub behaviour: Behaviour,
}

impl Description {
    /// All areas of outputs, in the order of the process image.
    pub fn output_areas(&self) -> impl Iterator<Item = ProcessDataArea> + use<> {
        core::iter::once(self.outputs).chain(self.further_outputs.iter().copied())
    }

    /// All areas of inputs, in the order of the process image.
    pub fn input_areas(&self) -> impl Iterator<Item = ProcessDataArea> + use<> {
        core::iter::once(self.inputs).chain(self.further_inputs.iter().copied())
    }

    /// The object with this index.
    pub fn object(&self, index: u16) -> Option<&'static Object> {
        let objects = self.objects;
        let found = objects.binary_search_by_key(&index, |object| object.index).ok()?;
        objects.get(found)
    }

    /// The entry at this address, including gaps.
    pub fn entry(&self, address: ObjectAddress) -> Option<&'static Entry> {
        self.object(address.index)?.entry(address.sub)
    }

    /// The value of an entry after power-on; empty means zeros.
    pub fn power_on(&self, entry: &Entry) -> &[u8] {
        let preset =
            self.behaviour.presets.iter().flatten().find(|preset| preset.store == entry.store);
        preset.filter(|_| entry.bits == 32).map_or(entry.default, |preset| &preset.value)
    }

    /// Parameters of drives; empty without SoE.
    pub fn parameters(&self) -> &'static [Parameter] {
        self.mailbox.map_or(&[], |mailbox| mailbox.speaks.parameters)
    }

    /// Bytes of the store: values of objects and parameters, images of outputs and inputs, and the
    /// [room](Mailbox::store_len) of the mailbox.
    pub fn store_len(&self) -> usize {
        let mailbox = self.mailbox.map_or(0, |mailbox| mailbox.store_len());
        self.values_len() + self.output_bytes() + self.input_bytes() + mailbox
    }

    /// Most bytes of outputs, of all areas together; at most
    /// [`MAX_PROCESS_DATA`](crate::MAX_PROCESS_DATA).
    pub(crate) fn output_bytes(&self) -> usize {
        image_len(self.output_areas())
    }

    /// Most bytes of inputs.
    pub(crate) fn input_bytes(&self) -> usize {
        image_len(self.input_areas())
    }

    /// Bytes of the value store for the values of objects and parameters.
    pub(crate) fn values_len(&self) -> usize {
        let parameters = self.parameters().iter();
        let behind = parameters.map(|one| usize::from(one.store) + usize::from(one.len)).max();
        self.objects_len() + behind.unwrap_or(0)
    }

    /// Bytes of the value store for objects.
    pub(crate) fn objects_len(&self) -> usize {
        let entries = self.objects.iter().flat_map(|object| object.entries);
        entries.map(|entry| usize::from(entry.store) + entry.len()).max().unwrap_or(0)
    }
}

fn image_len(areas: impl Iterator<Item = ProcessDataArea>) -> usize {
    let all = areas.take(MAX_AREAS).map(|area| usize::from(area.max_length));
    all.sum::<usize>().min(MAX_PROCESS_DATA)
}

/// The two mailbox areas.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Mailbox {
    /// MainDevice to SubDevice, SM0.
    pub receive: MailboxArea,
    /// SubDevice to MainDevice, SM1.
    pub send: MailboxArea,
    /// Its protocols.
    pub speaks: Speaks,
}

impl Mailbox {
    /// Bytes of the store for the last two messages sent, and for a transfer of
    /// [`MAX_TRANSFER`] bytes.
    pub const fn store_len(&self) -> usize {
        2 * self.send.length as usize + MAX_TRANSFER
    }
}

/// The protocols of a mailbox. [`Description::objects`] answers CoE,
/// [`parameters`](Self::parameters) answers SoE.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Speaks {
    /// Protocols in the bits of SII word 0x1C: 0 AoE, 1 EoE, 2 CoE, 3 FoE, 4 SoE, 5 VoE. A request
    /// that needs something the device does not have (files, ports, ADS targets) gets the error
    /// that the protocol has for it. A protocol that is not announced gets mailbox error 2.
    pub protocols: u16,
    /// Number of drives that SoE addresses, 0 to 8.
    pub drives: u8,
    /// Parameters of the drives, ascending by drive and IDN.
    pub parameters: &'static [Parameter],
}

impl Speaks {
    /// Only CoE.
    pub const COE: Self = Self { protocols: 1 << 2, drives: 0, parameters: &[] };
}

/// A parameter of a drive, as SoE reads and writes it. It has no unit, and no minimum, maximum and
/// default elements.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Parameter {
    /// Number of the drive, from 0.
    pub drive: u8,
    /// Its number.
    pub idn: Idn,
    /// Its name; empty: none.
    pub name: &'static str,
    /// The meaning of the value, and the states in which it cannot be written.
    pub attribute: Attribute,
    /// Whether only the present value can be written: the device offers no choice.
    pub fixed: bool,
    /// Byte in the value store, counted from the end of the objects' values.
    pub store: u16,
    /// Bytes of the value. The value of a list begins with its present and its largest length in
    /// bytes, 2 bytes each.
    pub len: u16,
    /// Value after power-on, in the SoE coding. The rest of a list that is shorter than its largest
    /// length is zeros.
    pub default: &'static [u8],
}

impl Parameter {
    /// Most bytes of a list.
    pub const fn list_room(&self) -> u16 {
        self.len.saturating_sub(LIST_HEAD as u16)
    }
}

/// Bytes before the elements of a list of SoE.
pub(crate) const LIST_HEAD: usize = 4;

/// The place of process data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ProcessDataArea {
    /// Its SyncManager, 0 to 15: SM2 for outputs and SM3 for inputs if the mailbox has SM0 and SM1,
    /// lower ones for many devices without mailbox. A direction that the device does not have needs
    /// a separate one too, which must stay off.
    pub sync_manager: u8,
    /// First byte, which the SyncManager must be set to.
    pub start: u16,
    /// Most bytes of one buffer. A device without mailbox has no other assignment: its buffers have
    /// exactly this length, and 0 means that it does not have this direction.
    pub max_length: u16,
}

/// One object of the dictionary.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Object {
    /// Index.
    pub index: u16,
    /// Name in SDO information.
    pub name: &'static str,
    /// VAR, ARRAY or RECORD.
    pub code: ObjectCode,
    /// Type of the object (for a RECORD the code of its structure, 0x29 for the sync objects).
    pub data_type: DataType,
    /// Entries, ascending by sub-index, including gaps.
    pub entries: &'static [Entry],
}

impl Object {
    /// The entry with this sub-index.
    pub fn entry(&self, sub: u8) -> Option<&'static Entry> {
        let entries = self.entries;
        let found = entries.binary_search_by_key(&sub, |entry| entry.sub).ok()?;
        entries.get(found)
    }

    /// Highest sub-index that has a description.
    pub fn max_sub(&self) -> u8 {
        self.entries.last().map_or(0, |entry| entry.sub)
    }
}

/// One entry of an object.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Entry {
    /// Sub-index.
    pub sub: u8,
    /// Name in SDO information.
    pub name: &'static str,
    /// Type; [`DataType::GAP`] for a gap, which cannot be read or written alone.
    pub data_type: DataType,
    /// Bits of the value.
    pub bits: u16,
    /// Bit of the value in complete access; sub-index 0 at 0, sub-index 1 usually at 16.
    pub complete_access_offset: u32,
    /// Rights per state, and mappability.
    pub access: Access,
    /// Byte of the value in the stack's value store; its length is `bits` rounded up to bytes.
    pub store: u16,
    /// Value after power-on, `bits` rounded up to bytes; empty means zeros.
    /// [`Description::power_on`] includes the device's presets.
    pub default: &'static [u8],
}

impl Entry {
    /// Bytes of the value.
    pub const fn len(&self) -> usize {
        (self.bits as usize).div_ceil(8)
    }
    /// Whether it only reserves bits in complete access.
    pub const fn is_gap(&self) -> bool {
        self.data_type.0 == DataType::GAP.0
    }
    /// Whether it has no bits.
    pub const fn is_empty(&self) -> bool {
        self.bits == 0
    }
}

/// Behaviour in which devices differ. The times of 0x1C32 and 0x1C33 are entries of the dictionary.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Behaviour {
    /// Synchronization types of a device without 0x1C32:04 and 0x1C33:04, in their bits; by default
    /// all types of the stack. The values of these objects have priority. A device without mailbox
    /// and without the type of SYNC0 ignores its pulses: the SYNC unit may be on although the pin
    /// is not used.
    pub undeclared_types: SupportedTypes,
    /// How missed SM events are counted.
    pub missed_events: MissedEvents,
    /// Limit of the counter when there is no object 0x10F1.
    pub sync_error_limit: u16,
    /// Time after the request of OP at which it is given up (0x001A, 0x001B, 0x002D).
    pub safeop_to_op_timeout: Nanos,
    /// How long SYNC must run and the order of SM2 and SYNC0 must be right, without interruption,
    /// before OP is entered with DC. The Slave Stack Code requires 200 ticks of 1 ms.
    pub sync_settling: Nanos,
    /// Period of the local timer in Free Run while 0x1C32:02 is 0.
    pub free_run_period: Nanos,
    /// Longest SYNC0 cycle accepted; zero for no limit.
    pub maximum_cycle_time: Nanos,
    /// The SYNC0 cycle must be a multiple of it (otherwise 0x0035); zero: any cycle.
    pub cycle_granularity: Nanos,
    /// Whether the watchdog trigger bit of SM2 and the process data watchdog's time (0x0420) must
    /// both be set or both be zero (otherwise 0x001F), as in the Slave Stack Code. Small stacks do
    /// not check this.
    pub watchdog_must_agree: bool,
    /// Whether 0x1C32:00 reads 0 and its sub-indices do not exist in SAFEOP and OP while no outputs
    /// are transmitted; the same for 0x1C33 and inputs. Slave Stack Code devices keep the object.
    pub hide_unused_sync_objects: bool,
    /// Whether the program uses no interrupt of SM2, but checks at SYNC0 whether outputs have come.
    pub polls_outputs: bool,
    /// Whether outputs act at SYNC1 if inputs are latched at SYNC1 (types 2 and 3).
    pub outputs_on_sync1: bool,
    /// Whether the application runs at SYNC1 and not at each SYNC0, with subordinated cycles.
    pub application_on_sync1: bool,
    /// Whether the SYNC unit may be on without a pulse, as for time stamps of the latch units
    /// (otherwise 0x0030).
    pub unit_without_pulses: bool,
    /// Whether there is no program: the ESC answers AL control itself (device emulation, register
    /// 0x0141 bit 0), and the stack represents the digital I/O at the ESC. It checks and refuses
    /// nothing, and it has no mailbox.
    pub device_emulation: bool,
    /// Whether SYNC1 may be generated although 0x1C32:04 and 0x1C33:04 do not announce it
    /// (otherwise 0x0030): the device ignores it.
    pub ignores_sync1: bool,
    /// The SYNC0 cycle that subordinated cycles need (otherwise 0x0036); zero: any.
    pub subordinated_sync0_cycle: Nanos,
    /// Whether the caller acknowledges SYNC pulses later in acknowledge mode (0x0982 is 0), with
    /// [`acknowledge_sync`](crate::SubDevice::acknowledge_sync). By default the event acknowledges
    /// them at once.
    pub late_acknowledge: bool,
    /// AL status codes for lost synchronization.
    pub loss_codes: LossCodes,
    /// The times that are measured on command.
    pub measured: Measured,
    /// The bit of the outputs that changes each time: 0x1C32:0E counts outputs in which it did not.
    pub output_toggle: Option<u16>,
    /// Whether a local timer shifts Outputs Valid: 0x1C32:03.
    pub shift_outputs: bool,
    /// Whether a local timer shifts Input Latch: 0x1C33:03.
    pub shift_inputs: bool,
    /// The device's identification value (AL control bit 5).
    pub identification: u16,
    /// Values at power-on that differ from those of the objects. Devices of one kind with other
    /// times share its objects, which are static.
    pub presets: [Option<Preset>; 2],
    /// Its misbehaviours; empty for a correct device. Without the feature `misbehaviour` every
    /// device is correct.
    pub misbehaviour: Misbehaviours,
}

/// The value of an entry of 32 bits at power-on, in place of [`Entry::default`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Preset {
    /// The entry, by its place in the store ([`Entry::store`]), which is unique.
    pub store: u16,
    /// The value, in the byte order of the wire.
    pub value: [u8; 4],
}

/// How missed SM events are counted in 0x1C32:0B.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum MissedEvents {
    /// At SYNC0: minus 1 if outputs were updated since the last SYNC0, otherwise plus 3. Error
    /// above the limit.
    #[default]
    Counted,
    /// Slave Stack Code: as above, but the first missing event is ignored, and the error comes when
    /// the counter reaches the limit.
    SlaveStackCode,
    /// Events minus pulses in OP, as in SOES: error when they differ by more than the limit.
    Balance,
}

/// AL status codes with which devices report lost synchronization.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct LossCodes {
    /// OP is given up because a SYNC signal never came.
    pub no_sync: AlStatusCode,
    /// A SYNC signal is missing in OP.
    pub sync_lost: AlStatusCode,
    /// Too many outputs came too late or never.
    pub sequence: AlStatusCode,
}

impl LossCodes {
    /// The codes of the Slave Stack Code: 0x002D, 0x002C, 0x001A.
    pub const SLAVE_STACK_CODE: Self = Self {
        no_sync: AlStatusCode::NO_SYNC,
        sync_lost: AlStatusCode::FATAL_SYNC_ERROR,
        sequence: AlStatusCode::SYNCHRONIZATION_ERROR,
    };
    /// The codes of drives: 0x0032 (PLL) on the way to OP, 0x0034 (time-out) in OP.
    pub const DRIVE: Self = Self {
        no_sync: AlStatusCode::PLL_ERROR,
        sync_lost: AlStatusCode::DC_SYNC_TIMEOUT,
        sequence: AlStatusCode::DC_SYNC_TIMEOUT,
    };
}

/// Times of 0x1C32 and 0x1C33 that a device measures in OP on command (sub-index 08), if it states
/// 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Measured {
    /// Sub-index 02, shortest cycle; only without DC.
    pub cycle: bool,
    /// Sub-index 03, time from the event to Outputs Valid or Input Latch.
    pub shift: bool,
    /// Sub-index 05, longest work of a cycle.
    pub minimum_cycle: bool,
    /// Sub-index 06, longest mapping.
    pub calc_and_copy: bool,
    /// Sub-index 09, time from the pulse to Outputs Valid or Input Latch.
    pub delay: bool,
}

impl Measured {
    /// Nothing.
    pub const NOTHING: Self = Self {
        cycle: false,
        shift: false,
        minimum_cycle: false,
        calc_and_copy: false,
        delay: false,
    };
    /// The times that the Slave Stack Code measures.
    pub const SLAVE_STACK_CODE: Self =
        Self { cycle: true, shift: false, minimum_cycle: true, calc_and_copy: true, delay: false };
}

impl Behaviour {
    /// The behaviour of most devices.
    pub const DEFAULT: Self = Self {
        undeclared_types: SupportedTypes(u16::MAX),
        missed_events: MissedEvents::Counted,
        sync_error_limit: 4,
        safeop_to_op_timeout: Nanos::millis(9_000),
        sync_settling: Nanos::millis(200),
        free_run_period: Nanos::millis(1),
        maximum_cycle_time: Nanos::ZERO,
        cycle_granularity: Nanos::ZERO,
        watchdog_must_agree: true,
        hide_unused_sync_objects: false,
        polls_outputs: false,
        outputs_on_sync1: false,
        application_on_sync1: false,
        unit_without_pulses: false,
        device_emulation: false,
        ignores_sync1: false,
        subordinated_sync0_cycle: Nanos::ZERO,
        late_acknowledge: false,
        loss_codes: LossCodes::SLAVE_STACK_CODE,
        measured: Measured::SLAVE_STACK_CODE,
        output_toggle: None,
        shift_outputs: false,
        shift_inputs: false,
        identification: 0,
        presets: [None; 2],
        misbehaviour: Misbehaviours::NONE,
    };

    /// The misbehaviours.
    pub(crate) const fn faults(&self) -> &[Misbehaviour] {
        if cfg!(feature = "misbehaviour") { self.misbehaviour.all() } else { &[] }
    }
}

impl Default for Behaviour {
    fn default() -> Self {
        Self::DEFAULT
    }
}
