//! Differences between the list of an ENI and the list of isocat's plan, with their consequences.
//!
//! The state of a device when it goes to OP is compared: each register and object by its last write
//! on the way up, including the MainDevice's own commands, and the transition of that write. Values
//! that only a run can determine (offsets, delays, the start time) and requests of states are not
//! compared.

mod frames;
mod registers;

use std::fmt;

use isocat_descriptions::start_up::{DeviceStartUp, StartUp, Transition};
use isocat_engine::plan::Plan;
use isocat_sync::object::{
    INPUT_ASSIGNMENT, INPUT_PARAMETER, OUTPUT_ASSIGNMENT, OUTPUT_PARAMETER, sub,
};
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Serialize;

/// One difference.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(deny_unknown_fields))]
pub struct Difference {
    /// Position of the device; null: the difference is about the segment.
    pub position: Option<usize>,
    /// The kind of difference, by a fixed name.
    pub kind: Kind,
    /// The transition in which the ENI writes it, or else the plan; null: no transition writes it.
    pub transition: Option<String>,
    /// Register, object, or part of the list.
    pub place: String,
    /// The value in the ENI; null: it has none.
    pub eni: Option<String>,
    /// The value in isocat's plan; null: it has none.
    pub plan: Option<String>,
    /// The consequence, as a sentence.
    pub consequence: String,
}

/// The kind of a difference.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The reference clock.
    ReferenceClock,
    /// The word for 0x0980 and 0x0981.
    AssignActivate,
    /// The cycle of SYNC0.
    Sync0Cycle,
    /// The time from SYNC0 to SYNC1.
    Sync1Cycle,
    /// The phase of SYNC0 in the cycle.
    Shift,
    /// The station address.
    StationAddress,
    /// Start, length, control or activation of a SyncManager.
    SyncManager,
    /// The mapping of an FMMU.
    Fmmu,
    /// The place of the device in the process image.
    ImagePlace,
    /// An FMMU that maps the mailbox's state into the process image.
    MailboxState,
    /// A watchdog time.
    Watchdog,
    /// Filter depths of the drift loop.
    DriftFilter,
    /// Another register.
    Register,
    /// The assigned PDOs.
    PdoAssignment,
    /// The contents of a PDO.
    PdoMapping,
    /// The synchronization type or another sync object.
    SyncObject,
    /// Another object.
    Object,
    /// The same value is written in another transition.
    Transition,
    /// The frames of process data.
    Frames,
    /// The drift datagram.
    DriftDatagram,
    /// The broadcast of AL status.
    StateWatch,
}

/// All differences, first those of the segment, then those of devices by position.
pub fn differences(eni: &StartUp, ours: &StartUp, plan: &Plan) -> Vec<Difference> {
    let mut all = frames::compare(eni, ours);
    all.extend(reference(eni, ours));
    for (position, (one, other)) in eni.devices.iter().zip(&ours.devices).enumerate() {
        all.extend(shift(position, one, other, plan));
        all.extend(registers::compare(position, (eni, one), (ours, other)));
        all.extend(objects(position, one, other, plan));
    }
    all
}

fn reference(eni: &StartUp, ours: &StartUp) -> Option<Difference> {
    let of = |list: &StartUp| crate::clock::reference(list);
    let (one, other) = (of(eni), of(ours));
    if one == other || one.is_none() {
        return None;
    }
    let name = |at: usize| format!("SubDevice {at} ({})", eni.devices[at].name);
    Some(Difference {
        position: None,
        kind: Kind::ReferenceClock,
        transition: None,
        place: "reference clock".into(),
        eni: one.map(name),
        plan: other.map(name),
        consequence: "FRMW and ARMW reach only the devices behind the clock that leads; clocks before it are not led"
            .into(),
    })
}

/// Compares the phase of SYNC0. The consequence is the plan's own budget with the ENI's phase.
fn shift(
    position: usize,
    eni: &DeviceStartUp,
    ours: &DeviceStartUp,
    plan: &Plan,
) -> Option<Difference> {
    let runs = |device: &DeviceStartUp| device.dc.filter(|dc| dc.sync0_ns > 0);
    let (one, other) = (runs(eni)?, runs(ours)?);
    if one.shift_ns == other.shift_ns {
        return None;
    }
    let cycle = plan.config.cycle.0;
    let common = plan.timing().sync0.unwrap_or(Nanos::ZERO);
    // The plan has one phase for all acting pulses; this device's SYNC0 may precede it.
    let wanted = i64::from(one.shift_ns) + common.0 - i64::from(other.shift_ns);
    let config = isocat_maindevice::Config {
        shift: Some(Nanos(wanted.rem_euclid(cycle))),
        ..plan.config.clone()
    };
    let consequence = match plan.with(config) {
        Err(error) => format!("the plan refuses this phase: {error}"),
        Ok(shifted) => {
            let mut own =
                shifted.demands().filter(|(at, _)| *at == Some(position)).map(|(_, one)| one);
            match own.find(|demand| !demand.line().fits()) {
                Some(demand) => format!(
                    "with the ENI's phase, {} does not fit, by {}",
                    demand.check.name(),
                    Nanos(-demand.slack().0)
                ),
                None => "every line of the plan's budget fits with the ENI's phase too".into(),
            }
        }
    };
    Some(Difference {
        position: Some(position),
        kind: Kind::Shift,
        transition: Some(Transition::PS.to_string()),
        place: "phase of SYNC0 (DC/ShiftTime)".into(),
        eni: Some(Nanos(one.shift_ns.into()).to_string()),
        plan: Some(Nanos(other.shift_ns.into()).to_string()),
        consequence,
    })
}

/// Compares objects by their last download on the way up.
fn objects(
    position: usize,
    eni: &DeviceStartUp,
    ours: &DeviceStartUp,
    plan: &Plan,
) -> Vec<Difference> {
    let mut all = Vec::new();
    let device = &plan.segment.devices[position];
    for (index, data) in [(OUTPUT_ASSIGNMENT, &device.outputs), (INPUT_ASSIGNMENT, &device.inputs)]
    {
        let planned: Vec<u16> = data.pdos.iter().map(|pdo| pdo.index).collect();
        let Some(written) = assignment(eni, index) else {
            if let Some(transition) = written_at(ours, index) {
                all.push(Difference {
                    position: Some(position),
                    kind: Kind::PdoAssignment,
                    transition: Some(transition),
                    place: format!("object 0x{index:04X}"),
                    eni: None,
                    plan: Some(list(&planned)),
                    consequence: "the ENI leaves the PDOs assigned that the device has at power-on"
                        .into(),
                });
            }
            continue;
        };
        if written != planned {
            all.push(Difference {
                position: Some(position),
                kind: Kind::PdoAssignment,
                transition: written_at(eni, index),
                place: format!("object 0x{index:04X}"),
                eni: Some(list(&written)),
                plan: Some(list(&planned)),
                consequence:
                    "the device exchanges other process data; what the image holds is another value"
                        .into(),
            });
        }
    }
    let values = |device: &DeviceStartUp| {
        let mut values: Vec<Value> = Vec::new();
        for transition in Transition::UP {
            for step in device.objects.iter().filter(|step| step.transitions.contains(&transition))
            {
                values.retain(|(object, ..)| *object != step.object);
                values.push((step.object, step.data.clone(), transition));
            }
        }
        values.retain(|(object, ..)| !matches!(object.index, OUTPUT_ASSIGNMENT | INPUT_ASSIGNMENT));
        values
    };
    let (one, other) = (values(eni), values(ours));
    let is_lone = |(object, ..): &Value| {
        is_mapping(object.index) && !other.iter().any(|(same, ..)| same == object)
    };
    let (lone, one): (Vec<Value>, Vec<Value>) = one.into_iter().partition(is_lone);
    all.extend(mappings(position, &lone));
    for (object, data, transition) in &one {
        match other.iter().find(|(same, ..)| same == object) {
            Some((_, planned, _)) if planned != data => {
                all.push(object_difference(position, *object, Some((data, *transition)), Some((planned, *transition))));
            }
            Some((_, _, planned)) if planned != transition => all.push(Difference {
                position: Some(position),
                kind: Kind::Transition,
                transition: Some(transition.to_string()),
                place: format!("object {object}"),
                eni: Some(transition.to_string()),
                plan: Some(planned.to_string()),
                consequence: "the value is the same; a device that takes it in one of both states only refuses it".into(),
            }),
            Some(_) => {}
            None => all.push(object_difference(position, *object, Some((data, *transition)), None)),
        }
    }
    for (object, data, transition) in &other {
        if !one.iter().any(|(same, ..)| same == object) {
            all.push(object_difference(position, *object, None, Some((data, *transition))));
        }
    }
    all
}

/// PDOs whose contents the ENI writes, with one difference for each; isocat's plan leaves PDOs as
/// they are.
fn mappings(position: usize, values: &[Value]) -> Vec<Difference> {
    let mut indices: Vec<u16> = values.iter().map(|(object, ..)| object.index).collect();
    indices.sort_unstable();
    indices.dedup();
    let of = |index: u16| {
        let mut entries: Vec<_> = values.iter().filter(|(one, ..)| one.index == index).collect();
        entries.sort_by_key(|(object, ..)| object.sub);
        let transition = entries.first().map(|(_, _, transition)| transition.to_string());
        let mapped = entries.iter().filter_map(|(object, data, _)| match (object.sub, &data[..]) {
            (1.., [bits, sub, low, high]) => {
                let object = ObjectAddress::new(u16::from_le_bytes([*low, *high]), *sub);
                Some(format!("{object} ({bits} bits)"))
            }
            _ => None,
        });
        let mapped: Vec<_> = mapped.collect();
        Difference {
            position: Some(position),
            kind: Kind::PdoMapping,
            transition,
            place: format!("object 0x{index:04X}"),
            eni: Some(if mapped.is_empty() { "written".into() } else { mapped.join(", ") }),
            plan: None,
            consequence: "the ENI lays out the PDO itself; our plan takes it as the device has it"
                .into(),
        }
    };
    indices.into_iter().map(of).collect()
}

fn is_mapping(index: u16) -> bool {
    matches!(index, 0x1600..=0x17FF | 0x1A00..=0x1BFF)
}

/// Object, value and transition of its last download.
type Value = (ObjectAddress, Vec<u8>, Transition);
type Written<'a> = Option<(&'a Vec<u8>, Transition)>;

fn object_difference(
    position: usize,
    object: ObjectAddress,
    eni: Written<'_>,
    ours: Written<'_>,
) -> Difference {
    let kind = match object.index {
        OUTPUT_PARAMETER | INPUT_PARAMETER => Kind::SyncObject,
        _ => Kind::Object,
    };
    let consequence = match (kind, object.sub, eni.is_some()) {
        (Kind::SyncObject, sub::SYNC_TYPE, false) => {
            "the ENI does not write the type of synchronization: the device takes it from its SYNC unit, or keeps what it had"
        }
        (Kind::SyncObject, sub::CYCLE_TIME, false) => {
            "the ENI does not tell the device its cycle: one that works by it keeps what it had"
        }
        (Kind::SyncObject, ..) => "the device synchronizes by other values",
        (_, _, true) => "the ENI sets the device up so; our plan leaves its value as it is",
        (_, _, false) => "the device keeps its own value",
    };
    Difference {
        position: Some(position),
        kind,
        transition: eni.or(ours).map(|(_, transition)| transition.to_string()),
        place: format!("object {object}"),
        eni: eni.map(|(data, _)| value(data)),
        plan: ours.map(|(data, _)| value(data)),
        consequence: consequence.into(),
    }
}

/// The PDOs that the list assigns; `None`: it does not write the object.
fn assignment(device: &DeviceStartUp, index: u16) -> Option<Vec<u16>> {
    let steps = device.objects.iter().filter(|step| step.object.index == index);
    let (mut pdos, mut count) = (Vec::new(), None);
    for step in steps {
        let word = |at: usize| Some(u16::from_le_bytes(*step.data.get(at..)?.first_chunk()?));
        match (step.complete, step.object.sub) {
            // Sub-index 0 takes 16 bits in complete access.
            (true, 0) => {
                pdos = (1..step.data.len() / 2).filter_map(|at| word(2 * at)).collect();
                count = step.data.first().copied();
            }
            (_, 0) => count = step.data.first().copied(),
            (_, slot) => {
                let slot = usize::from(slot);
                if pdos.len() < slot {
                    pdos.resize(slot, 0);
                }
                pdos[slot - 1] = word(0).unwrap_or(0);
            }
        }
    }
    pdos.truncate(usize::from(count?));
    Some(pdos)
}

fn written_at(device: &DeviceStartUp, index: u16) -> Option<String> {
    let step = device.objects.iter().rev().find(|step| step.object.index == index)?;
    step.transitions.first().map(ToString::to_string)
}

fn list(pdos: &[u16]) -> String {
    match pdos {
        [] => "none".into(),
        pdos => pdos.iter().map(|pdo| format!("0x{pdo:04X}")).collect::<Vec<_>>().join(", "),
    }
}

/// The value of a register or an object: a number if it is short, else its bytes in wire order.
fn value(bytes: &[u8]) -> String {
    let number = bytes.iter().rev().fold(0, |all: u64, byte| all << 8 | u64::from(*byte));
    match bytes.len() {
        length @ (1 | 2 | 4) => format!("0x{number:0width$X}", width = 2 * length),
        _ => bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(transition) = &self.transition {
            write!(f, "{transition} ")?;
        }
        let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".into());
        let (eni, plan) = (value(&self.eni), value(&self.plan));
        write!(f, "{}: ENI {eni}, plan {plan}; {}", self.place, self.consequence)
    }
}
