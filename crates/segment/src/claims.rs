//! What a segment file claims: the reference for every MainDevice that operates its segment.
//!
//! Only what the file states is a claim. Where it leaves the choice, as with a device without the
//! key `mode`, a MainDevice may choose.

use isocat_descriptions::sii::SiiFile;
use isocat_rules::{Claims, DeviceClaims};
use isocat_sync::{SyncMode, object};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use crate::profile::Profile;
use crate::scenario::Scenario;
use crate::segment_file::SubDevice;

impl Scenario {
    /// The claims of the segment file; none about its SubDevices if it is taken
    /// [as it is](Self::as_is).
    pub fn claims(&self) -> Claims {
        let device = |device| match self.as_is {
            true => DeviceClaims::default(),
            false => self.claims_of(device),
        };
        // Process data come as often as the fastest device takes some.
        let own = self.devices.iter().map(|device| device.cycle.unwrap_or(self.cycle));
        let cycle = own.min().unwrap_or(self.cycle);
        Claims {
            cycle: (!self.as_is).then_some(cycle),
            sync0_limit: self.sync0_limit,
            devices: self.devices.iter().map(device).collect(),
        }
    }

    /// Whether a watchdog is to guard the outputs: neither the file nor the description turns it
    /// off.
    fn is_guarded(&self, profile: &Profile) -> bool {
        let off = match self.watchdog {
            Some(time) => time == Nanos::ZERO,
            None => profile.watchdog.time().is_none(),
        };
        !off && asks_for_watchdog(profile)
    }

    fn claims_of(&self, device: &SubDevice) -> DeviceClaims {
        let asked = device.asked.mode.is_some() || device.asked.op_mode;
        let mode = device.mode.filter(|_| asked);
        let may_use_dc =
            mode.is_none_or(SyncMode::uses_dc) && device.profile.modes().any(SyncMode::uses_dc);
        // The pulses of an OpMode are its own.
        let free = device.op_mode.is_none() && device.unit.is_none();
        let own = device.cycle.unwrap_or(self.cycle);
        let sync0_cycle = match mode {
            Some(SyncMode::DcSubordinated) => device.sync0_cycle,
            _ => Some(own),
        };
        // `shift` is that of the pulse at which outputs act. Where that is SYNC1, SYNC0 comes
        // before.
        let sync0_acts = |mode| matches!(mode, SyncMode::DcSync0 | SyncMode::DcShiftSync1);
        let acts_on_sync0 = may_use_dc && free && mode.is_none_or(sync0_acts);
        DeviceClaims {
            operates: !device.optional,
            mode,
            sync0_cycle: sync0_cycle.filter(|_| may_use_dc && free),
            shift: self.shift.filter(|_| acts_on_sync0),
            in_phase: acts_on_sync0,
            has_data: has_data(&device.profile),
            cycle: Some(own),
            interpolation: device
                .profile
                .description
                .object(object::INTERPOLATION_TIME)
                .map(|_| own),
            guarded: self.is_guarded(&device.profile),
            watchdog: self
                .watchdog
                .filter(|time| *time > Nanos::ZERO && asks_for_watchdog(&device.profile)),
        }
    }
}

/// Whether the device has process data as it is described.
fn has_data(profile: &Profile) -> bool {
    let description = &profile.description;
    description.output_areas().chain(description.input_areas()).any(|area| area.max_length > 0)
}

/// Whether the EEPROM of the device asks for the process data watchdog at its outputs.
fn asks_for_watchdog(profile: &Profile) -> bool {
    let outputs = profile.description.outputs.sync_manager;
    let Ok(file) = SiiFile::from_bytes(&profile.id, &profile.sii) else { return false };
    let managers = file.sii.sync_managers;
    managers
        .get(usize::from(outputs))
        .is_some_and(|manager| manager.control & SyncManager::CONTROL_WATCHDOG != 0)
}
