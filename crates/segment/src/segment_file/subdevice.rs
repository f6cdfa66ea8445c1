//! One `[[subdevice]]`: from its keys to a device, with each value checked against the device's
//! abilities.

use std::path::Path;
use std::sync::Arc;

use isocat_descriptions::document::section::Keys;
use isocat_descriptions::document::{FileError, Source, Value, name_hint};
use isocat_descriptions::limits;
use isocat_descriptions::quantity::{DelayPerMetre, Length, Ppb};
use isocat_maindevice::MeasuredTimes;
use isocat_sync::{SyncMode, object};
use isocat_wire::dc::AssignActivate;
use isocat_wire::time::Nanos;
use isocat_wire::{ObjectAddress, PortNumber};

use super::{Asked, Place, SubDevice, clock, esi, misbehave, sii};
use crate::profile::{self, Doubt, Overrides, Profile, RunAs, TakenOpMode};

/// Settings of the file's head for all devices.
#[derive(Clone, Copy)]
pub(super) struct Bus {
    pub cycle: Nanos,
    /// Key `clocks`.
    pub tolerance: Option<Ppb>,
}

/// Reads a table. Name and place are only those of the table.
pub(super) fn subdevice(
    source: Source<'_>,
    keys: &Keys<'_>,
    bus: Bus,
    files: &mut esi::Files<'_>,
) -> Result<SubDevice, FileError> {
    let Bus { cycle: bus, tolerance } = bus;
    let cycle = own_cycle(keys, bus)?;
    let Made { profile, run_as, notes } = device(source, keys, cycle.unwrap_or(bus), files)?;
    let profile = with_times(keys, &profile)?;
    let (mode, mut run_as) = mode(keys, &profile, run_as, cycle, bus)?;
    run_as.notes.extend(notes);
    let (shift, input_shift) = shifts(keys, &profile)?;
    let pulses = pulses(keys, mode, bus)?;
    let (cable, cable_delay) = (keys.get("cable")?, keys.get("cable_delay")?);
    let fibre = keys.find("fibre")?.unwrap_or(false);
    if cable > COPPER && !fibre {
        return Err(keys.error_at("cable", format!(
            "cable = {cable}, and copper reaches {COPPER}; expected {COPPER} at most, or fibre = true beside it"
        )));
    }
    let optional = keys.get("optional")?;
    if let (Some(value), false) = (keys.value("arrives"), optional) {
        return Err(value.error("arrives is given without optional = true beside it"));
    }
    let clock = clock::clock(keys, &profile, tolerance)?;
    Ok(SubDevice {
        // Without the key, the name follows from the device's position.
        name: keys.find("name")?.unwrap_or_default(),
        profile,
        mode,
        // The place follows from the devices above.
        place: Place { upstream: None, port: PortNumber::P0 },
        cable,
        fibre,
        cable_delay,
        cable_asymmetry: keys.by(twice(cable, cable_delay)).get("cable_asymmetry")?,
        clock,
        clock_shape: clock::shape(keys)?,
        cycle,
        shift,
        input_shift,
        measured: keys
            .table("measured_times")?
            .map_or(Ok(MeasuredTimes::default()), |keys| measured(&keys))?,
        sync1: pulses.sync1.or(run_as.sync1),
        sync0_cycle: pulses.sync0_cycle.or(run_as.sync0_cycle),
        op_mode: run_as.op_mode,
        unit: run_as.unit,
        optional,
        arrives: keys.get("arrives")?,
        notes: run_as.notes,
        asked: Asked {
            op_mode: keys.value("opmode").is_some(),
            mode: keys.find_choice("mode", &profile::MODES)?,
            sync1: pulses.sync1,
            sync0_cycle: pulses.sync0_cycle,
        },
        // Lines are counted later.
        line: 0,
    })
}

/// The longest cable of 100BASE-TX.
const COPPER: Length = Length::metres(100);

/// `cycle`: a multiple of the bus cycle.
fn own_cycle(keys: &Keys<'_>, bus: Nanos) -> Result<Option<Nanos>, FileError> {
    match keys.find::<Nanos>("cycle")? {
        Some(own) if own.0 % bus.0 != 0 => Err(keys.error_at("cycle", format!(
            "cycle = {own} is no whole multiple of the bus cycle of {bus}; expected one, or for a device faster \
             than the bus mode = \"dc-subordinated\" with a sync0_cycle"
        ))),
        own => Ok(own),
    }
}

/// The device of a table.
struct Made {
    profile: Arc<Profile>,
    /// The settings of its OpMode, if it has one.
    run_as: Option<RunAs>,
    /// Doubts about its EEPROM.
    notes: Vec<Doubt>,
}

/// `device`, or `esi` and its keys, or `sii` alone; in addition to one of the others, `sii` is
/// their EEPROM.
fn device(
    source: Source<'_>,
    keys: &Keys<'_>,
    cycle: Nanos,
    files: &mut esi::Files<'_>,
) -> Result<Made, FileError> {
    let file = sii::file(source, keys)?;
    if let (None, None, Some((value, file))) = (keys.value("device"), keys.value("esi"), &file) {
        let of_esi = ["type", "product", "revision", "modules"];
        if let Some(value) = of_esi.into_iter().find_map(|key| keys.value(key)) {
            return Err(value.error("given without esi; expected esi = \"vendor.xml\" beside it"));
        }
        let imported = sii::device(keys, value, file, cycle)?;
        let (profile, run_as) = (imported.profile, Some(imported.run_as));
        return Ok(Made { profile, run_as, notes: Vec::new() });
    }
    let (profile, run_as) = described(source, keys, cycle, files)?;
    let Some((value, file)) = file else {
        return Ok(Made { profile, run_as, notes: Vec::new() });
    };
    let (profile, notes) = sii::served(&value, &profile, &file)?;
    Ok(Made { profile, run_as, notes })
}

/// `device`, or `esi` and its keys.
fn described(
    source: Source<'_>,
    keys: &Keys<'_>,
    cycle: Nanos,
    files: &mut esi::Files<'_>,
) -> Result<(Arc<Profile>, Option<RunAs>), FileError> {
    if let Some(esi) = keys.value("esi") {
        if let Some(device) = keys.value("device") {
            return Err(device.error("device is given beside esi; expected one of them"));
        }
        let imported = esi::device(source, keys, &esi, cycle, files)?;
        return Ok((imported.profile, Some(imported.run_as)));
    }
    let device = keys.required("device")?;
    let of_esi = ["type", "product", "revision", "modules", "opmode"];
    if let Some(value) = of_esi.into_iter().find_map(|key| keys.value(key)) {
        return Err(value.error("given without esi; expected esi = \"vendor.xml\" beside it"));
    }
    Ok((device_profile(source, &device, files.profiles)?, None))
}

/// A built-in profile by its id, or a profile file by its path: a name with a slash, or one that
/// ends in `.toml`.
fn device_profile(
    source: Source<'_>,
    device: &Value<'_>,
    profiles: &[Arc<Profile>],
) -> Result<Arc<Profile>, FileError> {
    let name = device.name("a profile's name, or the path of a profile file")?;
    if let Some(profile) = profiles.iter().find(|profile| profile.id == name) {
        return Ok(profile.clone());
    }
    if !name.ends_with(".toml") && !name.contains('/') {
        return profile::built_in(name).ok_or_else(|| {
            device
                .error(format!("unknown device \"{name}\""))
                .with_hint(name_hint(name, profile::built_in_ids()))
        });
    }
    let folder = Path::new(source.path).parent().unwrap_or(Path::new(""));
    let path = folder.join(name).display().to_string();
    let text = limits::read_text(&path, limits::TOML).map_err(|error| match error.line {
        // The file could not be read at all, so the error is at the key of the segment file.
        0 => device.error(format!("device \"{name}\": the profile file {error}")),
        _ => error,
    })?;
    Profile::from_toml(&path, &text)
}

/// `calc_copy`, `delay`, `copy_time`, `jitter`, `pulse`, `acknowledge`, `eeprom_burn`, `misbehave`:
/// the device with these changes.
fn with_times(keys: &Keys<'_>, profile: &Arc<Profile>) -> Result<Arc<Profile>, FileError> {
    let overrides = Overrides {
        stated_calc_and_copy: keys.find("calc_copy")?,
        stated_delay: keys.find("delay")?,
        calc_and_copy: keys.find("copy_time")?,
        jitter: keys.find("jitter")?,
        pulse: pulse(keys, profile)?,
        acknowledge: acknowledge(keys, profile)?,
        eeprom_burn_time: keys.find("eeprom_burn")?,
        misbehaviour: misbehave::misbehave(keys, profile)?,
    };
    profile.with(overrides).map_err(|entry| {
        let key = if entry.sub == object::sub::DELAY_TIME { "delay" } else { "calc_copy" };
        let name = &profile.name;
        keys.error_at(key, format!("{key} is given, but {name} has no object {entry} to state it"))
    })
}

/// `pulse`, for a device with SYNC pulses.
fn pulse(keys: &Keys<'_>, profile: &Profile) -> Result<Option<Nanos>, FileError> {
    if let Some(value) = keys.value("pulse")
        && !profile.has_sync_unit()
    {
        let name = &profile.name;
        return Err(value.error(format!(
            "pulse is given, but {name} makes no SYNC pulses: its EEPROM leaves the SYNC unit off; expected a device \
             with DC"
        )));
    }
    keys.find("pulse")
}

/// `acknowledge`, for a device whose pulses do not end by themselves.
fn acknowledge(keys: &Keys<'_>, profile: &Profile) -> Result<Option<Nanos>, FileError> {
    let pulse = keys.find("pulse")?.unwrap_or(profile.pulse());
    match keys.value("acknowledge") {
        Some(value) if pulse > Nanos::ZERO => Err(value.error(format!(
            "acknowledge is given, but pulses of {pulse} end by themselves; expected pulse = \"0ns\" beside it"
        ))),
        _ => keys.find("acknowledge"),
    }
}

/// `measured_times`.
fn measured(keys: &Keys<'_>) -> Result<MeasuredTimes, FileError> {
    Ok(MeasuredTimes {
        minimum_cycle: keys.find("minimum_cycle")?,
        outputs_calc_and_copy: keys.find("outputs_calc_and_copy")?,
        outputs_delay: keys.find("outputs_delay")?,
        inputs_calc_and_copy: keys.find("inputs_calc_and_copy")?,
        inputs_delay: keys.find("inputs_delay")?,
    })
}

/// The OpMode's settings of the pulses, and doubts about it.
#[derive(Default)]
pub(super) struct OpMode {
    op_mode: Option<TakenOpMode>,
    pub sync1: Option<Nanos>,
    pub sync0_cycle: Option<Nanos>,
    pub unit: Option<AssignActivate>,
    notes: Vec<Doubt>,
}

/// `mode`, compared with the device and its OpMode. A mode that differs from that of the OpMode
/// does not use the pulses of the OpMode.
fn mode(
    keys: &Keys<'_>,
    profile: &Profile,
    run_as: Option<RunAs>,
    own: Option<Nanos>,
    bus: Nanos,
) -> Result<(Option<SyncMode>, OpMode), FileError> {
    let asked = keys.find_choice("mode", &profile::MODES)?;
    if let (Some(mode), Some(value)) = (asked, keys.value("mode")) {
        possible(mode, &value, profile, own.unwrap_or(bus))?;
    }
    let (mode, op_mode) = match (run_as, asked, keys.value("mode")) {
        (None, asked, _) => (asked, OpMode::default()),
        (Some(mut run_as), Some(mode), Some(value)) => {
            esi::agree(keys, &value, mode, &mut run_as)?;
            (Some(mode), of_op_mode(run_as, mode))
        }
        (Some(run_as), ..) => {
            let mode = run_as.mode;
            (Some(mode), of_op_mode(run_as, mode))
        }
    };
    if own.is_some() && mode == Some(SyncMode::DcSubordinated) {
        return Err(keys.error_at(
            "cycle",
            "a cycle slower than the bus is given in the mode that is faster; expected any other mode \
             than \"dc-subordinated\"",
        ));
    }
    Ok((mode, op_mode))
}

/// The settings of an OpMode for a device in this mode.
pub(super) fn of_op_mode(run_as: RunAs, mode: SyncMode) -> OpMode {
    let RunAs { op_mode, sync1, sync0_cycle, unit, notes, .. } = run_as;
    match run_as.mode == mode {
        true => OpMode { op_mode, sync1, sync0_cycle, unit, notes },
        false => OpMode { op_mode, notes, ..OpMode::default() },
    }
}

/// Checks that the device announces the mode and can run it in this cycle.
fn possible(
    mode: SyncMode,
    value: &Value<'_>,
    profile: &Profile,
    cycle: Nanos,
) -> Result<(), FileError> {
    let entry = |sub| ObjectAddress::new(object::OUTPUT_PARAMETER, sub);
    let types = profile.supported_types();
    if !mode.is_supported(types) {
        let announced: Vec<_> = profile.modes().map(SyncMode::name).collect();
        let what = if profile.has_mailbox() {
            format!("{} = {types}", entry(object::sub::SUPPORTED_TYPES))
        } else {
            "it has no mailbox, and its profile does not list it".to_owned()
        };
        return Err(value
            .error(format!("mode \"{mode}\" is not possible with {}: {what}", profile.name))
            .with_hint(format!("it announces: {}", announced.join(", "))));
    }
    let stated = profile.sync_parameters(object::OUTPUT_PARAMETER);
    let minimum = stated.and_then(|stated| stated.minimum_cycle_time).unwrap_or(Nanos::ZERO);
    if mode != SyncMode::FreeRun && cycle < minimum {
        return Err(value.error(format!(
            "a cycle of {cycle} is too short for {} in mode \"{mode}\": {} = {minimum}; expected a \
             cycle of {minimum} or more",
            profile.name,
            entry(object::sub::MINIMUM_CYCLE_TIME)
        )));
    }
    Ok(())
}

/// `shift` and `input_shift`, for a device that supports them.
fn shifts(keys: &Keys<'_>, profile: &Profile) -> Result<(Option<Nanos>, Option<Nanos>), FileError> {
    let behaviour = &profile.description.behaviour;
    let shift = |key, index, able: bool| {
        let shift = keys.find(key)?;
        if shift.is_some() && !able {
            return Err(keys.error_at(key, format!(
                "{key} is given, but {} states {} = {}; expected a device with shift by local timer",
                profile.name,
                ObjectAddress::new(index, object::sub::SUPPORTED_TYPES),
                profile.supported_types()
            )));
        }
        Ok(shift)
    };
    Ok((
        shift("shift", object::OUTPUT_PARAMETER, behaviour.shift_outputs)?,
        shift("input_shift", object::INPUT_PARAMETER, behaviour.shift_inputs)?,
    ))
}

/// Settings of the pulses in the file.
struct Pulses {
    sync1: Option<Nanos>,
    sync0_cycle: Option<Nanos>,
}

/// `sync1` and `sync0_cycle`, for modes that have them.
fn pulses(keys: &Keys<'_>, mode: Option<SyncMode>, bus: Nanos) -> Result<Pulses, FileError> {
    let sync1 = keys.find("sync1")?;
    only_in(keys, "sync1", mode, &[SyncMode::DcShiftSync1, SyncMode::DcSync1])?;
    let sync0_cycle = keys.find::<Nanos>("sync0_cycle")?;
    only_in(keys, "sync0_cycle", mode, &[SyncMode::DcSubordinated])?;
    match sync0_cycle {
        Some(own) if bus.0 % own.0 != 0 => Err(keys.error_at("sync0_cycle", format!(
            "sync0_cycle = {own} does not divide the cycle of {bus}; expected a whole part of it"
        ))),
        sync0_cycle => Ok(Pulses { sync1, sync0_cycle }),
    }
}

/// Refuses a key that has a meaning only in other modes.
fn only_in(
    keys: &Keys<'_>,
    key: &'static str,
    mode: Option<SyncMode>,
    modes: &[SyncMode],
) -> Result<(), FileError> {
    match keys.value(key) {
        Some(value) if !mode.is_some_and(|mode| modes.contains(&mode)) => {
            let names: Vec<_> = modes.iter().map(|mode| format!("mode = \"{mode}\"")).collect();
            Err(value.error(format!(
                "{key} is given without a mode that has it; expected {}",
                names.join(" or ")
            )))
        }
        _ => Ok(()),
    }
}

/// Twice the cable's delay: the sum of the delays out and back.
fn twice(cable: Length, delay: DelayPerMetre) -> Nanos {
    Nanos(2 * cable.0 * delay.0 / 1_000_000)
}
