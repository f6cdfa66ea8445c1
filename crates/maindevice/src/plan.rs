//! The plan without a wire: the decisions of a bring-up for a segment that is known beforehand.
//!
//! A [`Segment`] holds what the scan, the SII and the objects would tell: identities and clocks,
//! PDOs (for devices without CoE in the SII), sync objects, delays. [`plan`] then makes the same
//! decisions as the bring-up, without any access: mode and pulses of each SubDevice, process image,
//! timing.

use alloc::vec::Vec;

use isocat_sync::object::{INPUT_ASSIGNMENT, OUTPUT_ASSIGNMENT};
use isocat_wire::soe::Idn;
use isocat_wire::{ObjectAddress, register};

use crate::config::Config;
use crate::error::{Cause, Error};
use crate::event::Stage;
use crate::segment::Segment;
use crate::{bring_up, hot_connect, mapping, mode, objects, sync, timing};

/// Chooses modes and pulses, lays out the process image and plans the cycle, and stores them in the
/// segment. As in bring-up, a line that does not fit is an error unless [`Config::force`] is set.
pub fn plan(segment: &mut Segment, config: &Config) -> Result<(), Error> {
    let at = |stage| move |cause: Cause| Error { stage, cause };
    bring_up::check(config).map_err(at(Stage::Scan))?;
    hot_connect::check_reference(config, segment).map_err(at(Stage::Scan))?;
    for device in &mut segment.devices {
        mapping::place_as_known(device).map_err(at(Stage::Objects))?;
        mapping::enough_fmmus(device).map_err(at(Stage::Objects))?;
    }
    for device in &mut segment.devices {
        let wish = config.devices.get(device.position);
        mode::choose(device, config, wish).map_err(at(Stage::Mode))?;
    }
    segment.image = mapping::lay_out(&mut segment.devices).map_err(at(Stage::Mapping))?;
    segment.timing = Some(timing::plan(segment, config).map_err(at(Stage::Plan))?);
    Ok(())
}

/// One write of the bring-up to one SubDevice.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Write {
    /// The target.
    pub target: Target,
    /// The bytes, in wire order; `None` if only the run can know them: a clock's offset, the start
    /// time.
    pub data: Option<Vec<u8>>,
    /// The purpose.
    pub comment: &'static str,
}

/// The target of a write.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Target {
    /// Registers from this address on.
    Register(u16),
    /// An entry of the object dictionary.
    Object(ObjectAddress),
    /// A parameter of this drive, by SoE.
    Parameter(u8, Idn),
}

/// All writes of the bring-up to one SubDevice except addresses and state requests, in order: on
/// the way to PREOP, and from there to SAFEOP.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Writes {
    /// INIT to PREOP.
    pub to_preop: Vec<Write>,
    /// PREOP to SAFEOP.
    pub to_safeop: Vec<Write>,
}

/// The writes of the bring-up to a SubDevice of a planned segment. `assigned` are the PDOs in its
/// 0x1C12 and 0x1C13 at power-on; an assignment that is already right is not written.
pub fn writes(
    segment: &Segment,
    config: &Config,
    position: usize,
    assigned: [&[u16]; 2],
) -> Writes {
    let device = &segment.devices[position];
    let wish = config.devices.get(position);
    let mut writes = Writes::default();
    let register = |address, data, comment| Write {
        target: Target::Register(address),
        data: Some(data),
        comment,
    };
    let object =
        |object, data, comment| Write { target: Target::Object(object), data: Some(data), comment };
    for (address, data) in bring_up::mailbox_writes(device) {
        writes.to_preop.push(register(address, data, "SyncManager of the mailbox"));
    }
    let all = &mut writes.to_safeop;
    if device.has_coe() {
        for startup in wish.map(|wish| &wish.startup[..]).unwrap_or_default() {
            all.push(object(startup.object, startup.data.clone(), "as the configuration has it"));
        }
        let wanted =
            [wish.and_then(|w| w.outputs.as_deref()), wish.and_then(|w| w.inputs.as_deref())];
        for ((index, wanted), assigned) in
            [OUTPUT_ASSIGNMENT, INPUT_ASSIGNMENT].into_iter().zip(wanted).zip(assigned)
        {
            let Some(wanted) = wanted.filter(|wanted| *wanted != assigned) else { continue };
            for (entry, data) in objects::assignment_writes(index, wanted) {
                all.push(object(entry, data, "PDO assignment"));
            }
        }
    }
    for parameter in wish.map(|wish| &wish.parameters[..]).unwrap_or_default() {
        all.push(Write {
            target: Target::Parameter(parameter.drive, parameter.idn),
            data: Some(parameter.data.clone()),
            comment: "as the configuration has it",
        });
    }
    for (address, data) in mapping::writes(device, config.watchdog_of(device.position)) {
        all.push(register(address, data, "process data"));
    }
    if segment.reference.is_some() && device.dc.has_clock() {
        let unknown = |register: u16, comment| Write {
            target: Target::Register(register),
            data: None,
            comment,
        };
        all.push(unknown(register::SYSTEM_TIME_OFFSET.address, "offset of the clock"));
        all.push(unknown(register::SYSTEM_TIME_DELAY.address, "propagation delay"));
    }
    if device.has_coe() {
        for write in sync::type_writes(device, config, wish) {
            all.push(object(write.object, write.data, "synchronization"));
        }
    }
    if device.mode.uses_dc() && segment.timing.as_ref().is_some_and(|t| t.sync0.is_some()) {
        let activation = register::SYNC_ACTIVATION.address;
        all.push(register(activation, alloc::vec![0], "SYNC off while it is set up"));
        let cycles = sync::cycles(device).to_vec();
        all.push(register(register::SYNC0_CYCLE.address, cycles, "cycles of SYNC0 and SYNC1"));
        all.push(Write {
            target: Target::Register(register::SYNC_START_TIME.address),
            data: None,
            comment: "first pulse, made by the run",
        });
        let (address, data) = sync::activation(device);
        all.push(register(address, data, "SYNC on"));
    } else if let Some((address, data)) = sync::unit_without_pulses(device) {
        all.push(register(address, data, "owners of the SYNC and latch units, and the unit"));
    }
    writes
}
