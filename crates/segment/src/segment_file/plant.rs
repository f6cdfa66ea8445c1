//! `[[plant]]`: from its keys to the machine behind a device.

use std::f64::consts::TAU;

use isocat_descriptions::document::FileError;
use isocat_descriptions::document::section::Keys;
use isocat_maindevice::written::{Bits, Output};
use isocat_sim::plant::{Control, PlantSetup, TwoMass};
use isocat_sync::SyncMode;
use isocat_wire::time::Nanos;

use super::{SubDevice, expect, keys, output};
use crate::offline;

pub(super) fn plants(
    root: &Keys<'_>,
    devices: &[SubDevice],
    outputs: &[Output],
    cycle: Nanos,
) -> Result<Vec<PlantSetup>, FileError> {
    let mut all: Vec<PlantSetup> = Vec::new();
    for keys in &root.tables("plant")? {
        let value = keys.required("device")?;
        let device = expect::position(&value, devices)?;
        let SubDevice { name, cycle: own, .. } = &devices[device];
        if all.iter().any(|plant| plant.device == device) {
            let message = format!("\"{name}\" moves another plant already; expected one at most");
            return Err(value.error(message));
        }
        let setup = plant(keys, device, &devices[device], own.unwrap_or(cycle))?;
        let is_written = |output: &Output| output.device == device && output.place == setup.command;
        if !outputs.iter().any(is_written) {
            let message = format!(
                "nothing is written to the command of this plant; expected an [[output]] with device = \"{name}\" in that \
                 place"
            );
            return Err(keys.error_at("command", message));
        }
        all.push(setup);
    }
    Ok(all)
}

fn plant(
    keys: &Keys<'_>,
    position: usize,
    device: &SubDevice,
    cycle: Nanos,
) -> Result<PlantSetup, FileError> {
    let [outputs, inputs] = offline::process_data(device);
    let command = command(keys, &outputs)?;
    let actual = match keys.value("actual") {
        Some(value) => Some(output::place(&value, None, &inputs, "inputs")?),
        None => offline::bits_of(&inputs, 0x6064, 0).filter(|bits| bits.len <= 32),
    };
    let increments: i64 = keys.get("increments")?;
    let travel: f64 = keys.get("travel")?;
    Ok(PlantSetup {
        device: position,
        command,
        actual,
        masses: masses(keys)?,
        control: control(keys, device, cycle)?,
        increments: increments as f64,
        travel_um: travel * 1_000.0,
    })
}

fn command(
    keys: &Keys<'_>,
    outputs: &[isocat_maindevice::segment::Pdo],
) -> Result<Bits, FileError> {
    let of_type = keys.find_choice("command_type", &keys::TYPES)?;
    if let Some(value) = keys.value("command") {
        return output::place(&value, of_type, outputs, "outputs");
    }
    let target = offline::bits_of(outputs, 0x607A, 0).filter(|bits| bits.len == 32);
    target.ok_or_else(|| {
        keys.error("the device has no target position 0x607A:00 in its outputs; expected a place, such as command = \"byte 0\"")
    })
}

fn control(keys: &Keys<'_>, device: &SubDevice, cycle: Nanos) -> Result<Control, FileError> {
    let [per_increment, gain, speed_gain] =
        [keys.get("torque")?, keys.get("position_gain")?, keys.get("speed_gain")?];
    let is_torque = keys.choice("commands", &keys::COMMANDS)?;
    let of_the_other: &[_] = if is_torque { &["position_gain", "speed_gain"] } else { &["torque"] };
    if let Some(key) = of_the_other.iter().find(|key| keys.value(key).is_some()) {
        let expected = if is_torque { "position" } else { "torque" };
        let message =
            format!("{key} says nothing here; expected commands = \"{expected}\" beside it");
        return Err(keys.error_at(key, message));
    }
    if is_torque {
        return Ok(Control::Torque { per_increment });
    }
    let mode = device.mode.or_else(|| device.profile.preferred_mode());
    if mode == Some(SyncMode::DcSubordinated) {
        return Err(keys.error_at(
            "commands",
            "the device acts several times a cycle (dc-subordinated), and a position loop runs once; expected \
             commands = \"torque\", or another mode",
        ));
    }
    let most = 1e9 / cycle.0 as f64;
    if speed_gain > most {
        let message = format!(
            "speed_gain = \"{speed_gain}/s\" is more than one to a cycle of {cycle}, and the loop would not be stable; \
             expected at most {most}/s"
        );
        return Err(keys.error_at("speed_gain", message));
    }
    if gain > speed_gain {
        let message = format!(
            "position_gain = \"{gain}/s\" is more than speed_gain; expected at most {speed_gain}/s"
        );
        return Err(keys.error_at("position_gain", message));
    }
    Ok(Control::Position { gain, speed_gain })
}

fn masses(keys: &Keys<'_>) -> Result<TwoMass, FileError> {
    let inertia = |key| keys.get::<f64>(key).map(|kg_cm2| kg_cm2 * 1e-4);
    let masses = TwoMass {
        motor: inertia("motor_inertia")?,
        load: inertia("load_inertia")?,
        stiffness: keys.get("stiffness")?,
        damping: keys.get("damping")?,
        friction: keys.get("friction")?,
    };
    let resonance = masses.resonance() / TAU;
    if resonance > MOST_RESONANCE {
        let message = format!(
            "both masses swing at {resonance:.0} Hz with this stiffness; expected at most {MOST_RESONANCE} Hz"
        );
        return Err(keys.error_at("stiffness", message));
    }
    let both = 1.0 / masses.motor + 1.0 / masses.load;
    let critical = 2.0 * masses.resonance() / both;
    if masses.damping > critical {
        let message = format!(
            "damping = \"{}Nms/rad\" is more than critical; expected at most {critical:.6}Nms/rad",
            masses.damping
        );
        return Err(keys.error_at("damping", message));
    }
    let fastest = TAU * MOST_RESONANCE * masses.load;
    if masses.friction > fastest {
        let message = format!(
            "friction = \"{}Nms/rad\" stops this load at once; expected at most {fastest:.6}Nms/rad",
            masses.friction
        );
        return Err(keys.error_at("friction", message));
    }
    Ok(masses)
}

/// Highest resonance, Hz. A faster oscillation is no axis, and would cost many steps per cycle.
const MOST_RESONANCE: f64 = 10_000.0;
