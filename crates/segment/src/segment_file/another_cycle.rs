//! A device at another cycle than its file says.

use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

use super::SubDevice;
use super::subdevice::of_op_mode;

/// Keys of a device that its OpMode does not replace.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Asked {
    /// Whether the key `opmode` is given.
    pub op_mode: bool,
    /// Key `mode`.
    pub mode: Option<SyncMode>,
    /// Key `sync1`.
    pub sync1: Option<Nanos>,
    /// Key `sync0_cycle`.
    pub sync0_cycle: Option<Nanos>,
}

impl SubDevice {
    /// The same device at another bus cycle, and with another cycle of its own if it has one. Mode
    /// and pulses follow from its OpMode again. `None`: a segment file with these cycles would be
    /// refused.
    pub fn at_cycle(&self, own: Option<Nanos>, bus: Nanos) -> Option<Self> {
        let Asked { op_mode: named, mode: asked, sync1, sync0_cycle } = self.asked;
        let mut device = Self { cycle: own, ..self.clone() };
        if let Some(op_mode) = &self.op_mode {
            let run_as = op_mode.run_as(&self.profile, own.unwrap_or(bus)).ok()?;
            let mode = asked.unwrap_or(run_as.mode);
            if named && !run_as.modes.contains(&mode) {
                return None;
            }
            let settings = of_op_mode(run_as, mode);
            device.mode = Some(mode);
            device.sync1 = sync1.or(settings.sync1);
            device.sync0_cycle = sync0_cycle.or(settings.sync0_cycle);
            device.unit = settings.unit;
        }
        let is_in = |modes: &[SyncMode]| device.mode.is_some_and(|mode| modes.contains(&mode));
        let subordinated = is_in(&[SyncMode::DcSubordinated]);
        let with_sync1 = is_in(&[SyncMode::DcShiftSync1, SyncMode::DcSync1]);
        let divides = sync0_cycle.is_none_or(|cycle| bus.0 % cycle.0 == 0);
        let possible = (own.is_none() || !subordinated)
            && (sync0_cycle.is_none() || subordinated)
            && (sync1.is_none() || with_sync1)
            && divides;
        possible.then_some(device)
    }
}
