//! The synchronization mode of each SubDevice, and its demands on the cycle.

use alloc::format;
use alloc::string::String;

use isocat_sync::budget::{self, Check, Line, Origin, Origins, USUAL_DEVIATION_PPB};
use isocat_sync::object::{
    INPUT_PARAMETER, OUTPUT_PARAMETER, ShiftBy, SupportedTypes, SyncParameters, sub,
};
use isocat_sync::start::Grid;
use isocat_sync::{Pulses, SyncMode};
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::config::{AssumedTimes, Config, DeviceConfig, MeasuredTimes};
use crate::error::Cause;
use crate::segment::{SubDevice, SyncObject};
use crate::service::is_silence;
use crate::{sync, times};

/// Chooses the mode of a SubDevice by configuration, announcement (sub-index 04) and clock, and
/// checks the cycle against its minimum.
///
/// By default it is the highest mode that both sync objects announce. A cycle below the minimum is
/// an error in every synchronized mode: a drive must not end up in Free Run because of a wrong
/// cycle.
pub(crate) fn choose(
    device: &mut SubDevice,
    config: &Config,
    wish: Option<&DeviceConfig>,
) -> Result<(), Cause> {
    let announced = announced(device);
    let assumed = wish.map(|wish| wish.assumed).unwrap_or_default();
    let mode = match wish.and_then(|wish| wish.mode) {
        Some(mode) => {
            if let Err(reason) = allowed(device, announced, mode) {
                return Err(Cause::Mode { place: device.place(), wish: mode, reason });
            }
            mode
        }
        None => {
            let mut best = SyncMode::FreeRun;
            for mode in SyncMode::PREFERRED {
                // A device that announces nothing does not get a mode by default.
                let refusal = match announced {
                    None if mode != SyncMode::FreeRun => Err(String::from(UNKNOWN_MODES)),
                    _ => allowed(device, announced, mode),
                };
                match refusal {
                    Ok(()) => {
                        best = mode;
                        break;
                    }
                    Err(reason) => device.mode_reason = format!("not {mode}: {reason}"),
                }
            }
            best
        }
    };
    device.mode = mode;
    let asked = announced.is_some() || wish.is_some_and(|wish| wish.mode.is_some());
    device.mode_not_asked = if asked { None } else { silent_object(device) };
    let refused =
        |device: &SubDevice, reason| Cause::Mode { place: device.place(), wish: mode, reason };
    device.every = every(mode, config, wish).map_err(|reason| refused(device, reason))?;
    device.pulses = pulses(device, config, wish).map_err(|reason| refused(device, reason))?;
    device.unit = wish.and_then(|wish| wish.unit).map(|word| sync::unit(mode, word));
    let demands = demands(device, assumed, wish);
    let own = Nanos(config.cycle.0 * i64::from(device.every));
    let jitter = if !mode.uses_dc() { config.host_jitter } else { Nanos::ZERO };
    let line = Line {
        check: Check::MinimumCycle,
        needed: demands.minimum_cycle + jitter,
        available: if mode.uses_dc() { device.pulses.sync0_cycle } else { own },
    };
    let bound = mode != SyncMode::FreeRun || takes_sm_mode(device);
    if bound && !line.fits() && !config.force {
        return Err(Cause::Plan { place: device.place(), line });
    }
    Ok(())
}

/// The number of bus cycles in the cycle of a SubDevice, or why the configured cycle is not
/// possible.
fn every(mode: SyncMode, config: &Config, wish: Option<&DeviceConfig>) -> Result<u32, String> {
    let bus = config.cycle;
    let cycle = wish.and_then(|wish| wish.cycle).unwrap_or(bus);
    if cycle == bus {
        return Ok(1);
    }
    if mode == SyncMode::DcSubordinated {
        return Err(format!(
            "a cycle of its own ({cycle}) does not go with a SYNC0 that divides the bus cycle"
        ));
    }
    if cycle > Grid::LONGEST {
        return Err(format!(
            "its own cycle of {cycle} is longer than clocks of 32 bits tell, {}",
            Grid::LONGEST
        ));
    }
    if cycle < bus || cycle.0 % bus.0 != 0 {
        return Err(format!(
            "its own cycle of {cycle} is no whole multiple of the bus cycle of {bus}"
        ));
    }
    Ok(u32::try_from(cycle.0 / bus.0).unwrap_or(u32::MAX))
}

/// The SYNC pulses of a SubDevice's mode, or why the configured ones are not possible.
fn pulses(
    device: &SubDevice,
    config: &Config,
    wish: Option<&DeviceConfig>,
) -> Result<Pulses, String> {
    let mode = device.mode;
    let cycle = Nanos(config.cycle.0 * i64::from(device.every));
    let outputs = device.output_sync.as_ref().map(|object| object.values).unwrap_or_default();
    let assumed = wish.and_then(|wish| wish.assumed.outputs_calc_and_copy);
    let known = times::known(device, wish).outputs_calc_and_copy.or(assumed);
    let copy = outputs.calc_and_copy_time.filter(|time| *time > Nanos::ZERO).or(known);
    let distance = wish.and_then(|wish| wish.sync1).unwrap_or(match mode {
        // The time that the device needs has not been measured yet.
        SyncMode::DcSync1 if copy.is_none() && config.measure_times.is_some() => {
            Nanos(cycle.0 / 2 / 10 * 10)
        }
        SyncMode::DcSync1 => {
            // The device's oscillator may be 100 ppm slower than system time, pulses come on ticks,
            // and the clock moves between them.
            let copy = copy.unwrap_or(Nanos::ZERO).0;
            let error = config.clock_error.unwrap_or(Nanos(2 * config.drift_threshold.0)).0;
            let moved = error.saturating_mul(copy) / cycle.0.max(1);
            Nanos((copy + copy / 10_000 + 10 + moved + 2 + 999) / 1_000 * 1_000)
        }
        SyncMode::DcSubordinated => Nanos::ZERO,
        _ => Nanos(cycle.0 / 4 / 10 * 10),
    });
    let stated = outputs.sync0_cycle_time.filter(|time| *time > Nanos::ZERO);
    let sync0 = wish.and_then(|wish| wish.sync0_cycle).or(stated).unwrap_or(Nanos::ZERO);
    if mode == SyncMode::DcSubordinated {
        if sync0 <= Nanos::ZERO {
            return Err(String::from(NO_SYNC0_CYCLE));
        }
        if distance >= sync0 {
            return Err(format!("SYNC1 {distance} behind a SYNC0 that comes every {sync0}"));
        }
        if sync0 >= cycle || cycle.0 % sync0.0 != 0 {
            return Err(format!(
                "a SYNC0 cycle of {sync0} does not go into the bus cycle of {cycle} more than once"
            ));
        }
    }
    let on_sync1 = outputs.supported.is_some_and(|types| types.shift() == ShiftBy::Sync1);
    Ok(Pulses::new(mode, cycle, distance, sync0, on_sync1))
}

/// What the sync objects of the used directions announce together; `None` if they announce nothing.
fn announced(device: &SubDevice) -> Option<SupportedTypes> {
    let types = |object: &Option<SyncObject>| object.as_ref()?.values.supported;
    let outputs = types(&device.output_sync).filter(|_| device.outputs.length > 0);
    let inputs = types(&device.input_sync).filter(|_| device.inputs.length > 0);
    match (outputs, inputs) {
        (Some(outputs), Some(inputs)) => Some(SupportedTypes(outputs.0 & inputs.0)),
        (one, other) => one.or(other),
    }
}

/// The sync object of a direction in use whose reading met a silent mailbox.
fn silent_object(device: &SubDevice) -> Option<ObjectAddress> {
    let used = |index| match index {
        OUTPUT_PARAMETER => device.outputs.length > 0,
        INPUT_PARAMETER => device.inputs.length > 0,
        _ => false,
    };
    device.substitutes.iter().find_map(|substitute| match &substitute.cause {
        Cause::Sdo { object, .. } if used(object.index) && is_silence(&substitute.cause) => {
            Some(*object)
        }
        _ => None,
    })
}

/// Why a mode is not possible. A device that announces nothing is assumed to support the requested
/// mode.
fn allowed(
    device: &SubDevice,
    announced: Option<SupportedTypes>,
    mode: SyncMode,
) -> Result<(), String> {
    if let Some(types) = announced.filter(|types| !mode.is_supported(*types)) {
        // Free Run works for a device without any setting; some devices do not announce it.
        if mode != SyncMode::FreeRun {
            return Err(format!("the device announces {types} (0x1C32:04, 0x1C33:04)"));
        }
    }
    if mode.uses_dc() && !device.dc.has_clock() {
        return Err(String::from("its ESC has no system time (0x0910 does not answer)"));
    }
    Ok(())
}

/// Whether a SubDevice configured for Free Run will be SM-synchronous nevertheless: its mode cannot
/// be written (0x1C32:01 is read-only), and stacks that choose the mode themselves prefer SM.
pub fn takes_sm_mode(device: &SubDevice) -> bool {
    let object = match (&device.output_sync, &device.input_sync) {
        (Some(outputs), _) if device.outputs.length > 0 => outputs,
        (_, Some(inputs)) if device.inputs.length > 0 => inputs,
        _ => return false,
    };
    device.mode == SyncMode::FreeRun
        && object.entry(sub::SYNC_TYPE).is_some()
        && !sync::writable(object, sub::SYNC_TYPE)
        && announced(device).is_some_and(|types| types.sm_synchronous())
}

/// The demands of a SubDevice on the cycle, without the arrival of its data. If it states 0 or
/// nothing, the assumed times count.
pub(crate) fn demands(
    device: &SubDevice,
    assumed: AssumedTimes,
    wish: Option<&DeviceConfig>,
) -> budget::Device {
    let none = SyncParameters::default();
    let of = |object: &Option<SyncObject>| object.as_ref().map_or(none, |object| object.values);
    let stated_times = (of(&device.output_sync), of(&device.input_sync));
    let own = times::known(device, wish);
    let (outputs, inputs) = own.complete(stated_times.0, stated_times.1);
    let mut origins = Origins::default();
    let free = device.mode == SyncMode::FreeRun && !takes_sm_mode(device);
    let local = |object: &SyncParameters| {
        object.supported.is_some_and(|types| types.shift() == ShiftBy::LocalTimer)
    };
    let wished_shift = wish.and_then(|wish| wish.shift_inputs);
    if wished_shift.is_some() {
        origins.input_shift = Origin::Intent;
    }
    if inputs.minimum_cycle_time > outputs.minimum_cycle_time {
        origins.minimum_cycle =
            Origin::Object(ObjectAddress::new(INPUT_PARAMETER, sub::MINIMUM_CYCLE_TIME));
    }
    let wish_has = |given: Option<Nanos>, otherwise| match given {
        Some(_) => Origin::Intent,
        None => otherwise,
    };
    origins.sync1 = wish_has(wish.and_then(|wish| wish.sync1), Origin::Plan);
    if device.mode == SyncMode::DcSubordinated {
        let stated = Origin::Object(ObjectAddress::new(OUTPUT_PARAMETER, sub::SYNC0_CYCLE_TIME));
        origins.sync0_cycle = wish_has(wish.and_then(|wish| wish.sync0_cycle), stated);
    }
    budget::Device {
        mode: device.mode,
        pulses: device.pulses,
        sync_signal: assumed.sync_signal,
        every: device.every,
        frame_spread: Nanos::ZERO,
        ring_spread: Nanos::ZERO,
        delay: Nanos::ZERO,
        outputs_arrival: None,
        inputs_fetched: None,
        inputs_read: None,
        watchdog: None,
        // In Free Run the device's cycle is independent.
        minimum_cycle: if free {
            Nanos::ZERO
        } else {
            minimum_cycle(&outputs, &inputs, assumed, &mut origins.minimum_cycle)
        },
        sync_limits: assumed.sync_limits,
        output_calc_and_copy: stated(
            outputs.calc_and_copy_time,
            assumed.outputs_calc_and_copy,
            &mut origins.output_calc_and_copy,
        ),
        output_delay: stated(outputs.delay_time, assumed.outputs_delay, &mut origins.output_delay),
        // A shift of 0 means no shift for the device too.
        output_shift: wish
            .and_then(|wish| wish.shift_outputs)
            .filter(|shift| *shift > Nanos::ZERO && local(&outputs)),
        input_calc_and_copy: stated(
            inputs.calc_and_copy_time,
            assumed.inputs_calc_and_copy,
            &mut origins.input_calc_and_copy,
        ),
        input_shift: wished_shift
            .or(inputs.shift_time)
            .filter(|_| local(&inputs))
            .unwrap_or(Nanos::ZERO),
        input_delay: stated(inputs.delay_time, assumed.inputs_delay, &mut origins.input_delay),
        pulse_jitter: assumed.pulse_jitter.unwrap_or(Nanos::ZERO),
        // The latest time of outputs does not tell their jitter.
        outputs_spread: outputs_spread(device, &stated_times.0, wish),
        clock_deviation_ppb: USUAL_DEVIATION_PPB,
        origins: with_measured(origins, &stated_times, &own),
    }
}

/// Sets the origins of times that the device measured but its objects do not state.
fn with_measured(
    mut origins: Origins,
    (outputs, inputs): &(SyncParameters, SyncParameters),
    own: &MeasuredTimes,
) -> Origins {
    let cycle = outputs.minimum_cycle_time.max(inputs.minimum_cycle_time);
    for (origin, stated, measured) in [
        (&mut origins.minimum_cycle, cycle, own.minimum_cycle),
        (&mut origins.output_calc_and_copy, outputs.calc_and_copy_time, own.outputs_calc_and_copy),
        (&mut origins.output_delay, outputs.delay_time, own.outputs_delay),
        (&mut origins.input_calc_and_copy, inputs.calc_and_copy_time, own.inputs_calc_and_copy),
        (&mut origins.input_delay, inputs.delay_time, own.inputs_delay),
    ] {
        let is_stated = stated.is_some_and(|time| time > Nanos::ZERO);
        if let (Origin::Object(entry), false, Some(_)) = (*origin, is_stated, measured) {
            *origin = Origin::MeasuredByDevice(entry);
        }
    }
    origins
}

/// The jitter of outputs after their pulse. Outputs that act as soon as the application is done
/// have the application's jitter; outputs delayed by a timer or by SYNC1 have the jitter of the
/// pulse's interrupt.
fn outputs_spread(
    device: &SubDevice,
    outputs: &SyncParameters,
    wish: Option<&DeviceConfig>,
) -> Nanos {
    let assumed = wish.map(|wish| wish.assumed).unwrap_or_default();
    let some = |time: Option<Nanos>| time.is_some_and(|time| time > Nanos::ZERO);
    let shifted =
        some(wish.and_then(|wish| wish.shift_outputs)) && device.mode != SyncMode::DcSync1;
    let by_sync1 = device.mode == SyncMode::DcShiftSync1 && device.pulses.lead > Nanos::ZERO;
    let evenly = some(outputs.delay_time) || shifted || by_sync1;
    let spread = assumed.outputs_spread.filter(|_| !evenly).or(assumed.pulse_jitter);
    spread.unwrap_or(Nanos::ZERO)
}

/// The minimum cycle that the device states. If copying its outputs alone takes longer (0x1C32:06
/// above 0x1C32:05), it is the larger of the assumed minimum and the sum of both copy times.
fn minimum_cycle(
    outputs: &SyncParameters,
    inputs: &SyncParameters,
    assumed: AssumedTimes,
    origin: &mut Origin,
) -> Nanos {
    let stated_cycle = outputs.minimum_cycle_time.max(inputs.minimum_cycle_time);
    let cycle = stated(stated_cycle, assumed.minimum_cycle, origin);
    let copy = outputs.calc_and_copy_time.unwrap_or(Nanos::ZERO);
    if copy <= cycle {
        return cycle;
    }
    *origin = Origin::Assumed;
    let both = copy + inputs.calc_and_copy_time.unwrap_or(Nanos::ZERO);
    both.max(assumed.minimum_cycle.unwrap_or(Nanos::ZERO))
}

/// A time as the device states it; if it states 0 or nothing, the assumed one.
fn stated(time: Option<Nanos>, assumed: Option<Nanos>, origin: &mut Origin) -> Nanos {
    if let Some(time) = time.filter(|time| *time > Nanos::ZERO) {
        return time;
    }
    if assumed.is_some() || time.is_none() {
        *origin = Origin::Assumed;
    }
    assumed.unwrap_or(Nanos::ZERO)
}

const NO_SYNC0_CYCLE: &str =
    "the device states no SYNC0 cycle (0x1C32:0A), and none is given for subordinated cycles";
const UNKNOWN_MODES: &str = "no direction with process data tells its modes (0x1C32:04, 0x1C33:04)";

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::error::{MailboxError, SdoError};
    use crate::segment::DcCapability;
    use crate::service::Service;
    use isocat_wire::{AbortCode, StationAddress};

    /// A drive with both sync objects: announces `types`, minimum cycle 250 us.
    pub(crate) fn drive(outputs: u16, inputs: u16) -> SubDevice {
        let mut device = SubDevice::new(0, StationAddress(0x1001));
        device.dc = DcCapability::Clock64;
        (device.outputs.length, device.inputs.length) = (8, 8);
        let object = |types| {
            let mut object = SyncObject::default();
            object.values.supported = Some(SupportedTypes(types));
            object.values.minimum_cycle_time = Some(Nanos(250_000));
            Some(object)
        };
        (device.output_sync, device.input_sync) = (object(outputs), object(inputs));
        device
    }

    fn wish(mode: SyncMode) -> DeviceConfig {
        DeviceConfig { mode: Some(mode), ..DeviceConfig::default() }
    }

    fn chosen(
        mut device: SubDevice,
        cycle: i64,
        wish: Option<DeviceConfig>,
    ) -> Result<SyncMode, Cause> {
        let config = Config::new(Nanos(cycle));
        choose(&mut device, &config, wish.as_ref())?;
        Ok(device.mode)
    }

    #[test]
    fn the_best_mode_that_both_objects_announce() {
        assert_eq!(chosen(drive(0x0427, 0x0027), 1_000_000, None), Ok(SyncMode::DcSync0));
        assert_eq!(chosen(drive(0x0427, 0x0003), 1_000_000, None), Ok(SyncMode::SmSynchronous));
        assert_eq!(chosen(drive(0x4001, 0x4001), 1_000_000, None), Ok(SyncMode::FreeRun));
        let mut clockless = drive(0x0007, 0x0007);
        clockless.dc = DcCapability::ReceiveTimes;
        assert_eq!(chosen(clockless, 1_000_000, None), Ok(SyncMode::SmSynchronous));
    }

    #[test]
    fn a_wish_that_is_not_announced_is_refused() {
        let refused = chosen(drive(0x4001, 0x4001), 1_000_000, Some(wish(SyncMode::DcSync0)));
        assert!(matches!(refused, Err(Cause::Mode { wish: SyncMode::DcSync0, .. })), "{refused:?}");
    }

    /// Tests a device without sync objects, by what it answered instead, and the same one with a
    /// configured mode.
    #[test]
    fn free_run_of_a_silent_mailbox_is_no_choice() {
        let of = |error: SdoError, index, wish: Option<DeviceConfig>| {
            let mut device = drive(0, 0);
            (device.output_sync, device.input_sync) = (None, None);
            let object = ObjectAddress::new(index, 0);
            let cause = Cause::Sdo { place: device.place(), object, error };
            device.do_without(Service::SyncEntry, cause).unwrap();
            choose(&mut device, &Config::new(Nanos::millis(1)), wish.as_ref()).unwrap();
            assert_eq!(device.mode, SyncMode::FreeRun);
            device.mode_not_asked
        };
        let after = Nanos::millis(2_000);
        let full = || SdoError::Mailbox(MailboxError::Full { after });
        let silent = SdoError::Mailbox(MailboxError::NoAnswer { after });
        let object = Some(ObjectAddress::new(OUTPUT_PARAMETER, 0));
        assert_eq!(of(full(), OUTPUT_PARAMETER, None), object);
        assert_eq!(of(silent, OUTPUT_PARAMETER, None), object);
        assert_eq!(of(SdoError::Abort(AbortCode(0x0602_0000)), OUTPUT_PARAMETER, None), None);
        assert_eq!(of(full(), 0x1C00, None), None);
        assert_eq!(of(full(), OUTPUT_PARAMETER, Some(wish(SyncMode::FreeRun))), None);
    }

    /// Tests 0x1C32:06 equal to :05, and a nanosecond above it.
    #[test]
    fn a_minimum_cycle_below_the_copy_time_is_not_believed() {
        let with = |copy: i64, assumed: Option<i64>| {
            let mut device = drive(0x0427, 0x0027);
            let object = |object: &mut Option<SyncObject>, copy| {
                object.as_mut().unwrap().values.calc_and_copy_time = Some(Nanos(copy));
            };
            object(&mut device.output_sync, copy);
            object(&mut device.input_sync, 40_000);
            device.mode = SyncMode::SmSynchronous;
            let minimum_cycle = assumed.map(Nanos);
            let demands =
                demands(&device, AssumedTimes { minimum_cycle, ..Default::default() }, None);
            (demands.minimum_cycle.0, demands.origins.minimum_cycle == Origin::Assumed)
        };
        assert_eq!(with(250_000, Some(300_000)), (250_000, false));
        assert_eq!(with(250_001, None), (290_001, true));
        assert_eq!(with(250_001, Some(290_001)), (290_001, true));
        assert_eq!(with(250_001, Some(290_002)), (290_002, true));
    }

    /// Tests both sides of 0x1C32:05; SM-synchronous has the host's jitter in addition.
    #[test]
    fn the_cycle_is_not_shorter_than_the_minimum() {
        let dc = || Some(wish(SyncMode::DcSync0));
        assert!(chosen(drive(0x0427, 0x0027), 250_000, dc()).is_ok());
        let error = chosen(drive(0x0427, 0x0027), 249_999, None).unwrap_err();
        let text = alloc::string::ToString::to_string(&error);
        assert!(text.contains("0x1C32:05") && text.contains("needs 250 us"), "{text}");
        let sm = || Some(wish(SyncMode::SmSynchronous));
        assert!(chosen(drive(0x0427, 0x0027), 270_000, sm()).is_ok());
        assert!(chosen(drive(0x0427, 0x0027), 269_999, sm()).is_err());
    }
}
