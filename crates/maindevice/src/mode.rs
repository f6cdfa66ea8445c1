//! Which mode each SubDevice runs in, and the plan of one cycle.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use isocat_sync::budget::{self, Check, Line, Origin, Origins, budget, common_shift};
use isocat_sync::object::{
    INPUT_PARAMETER, OUTPUT_PARAMETER, ShiftBy, SupportedTypes, SyncParameters, sub,
};
use isocat_sync::phase::Direction;
use isocat_sync::start::Grid;
use isocat_sync::{Pulses, SyncMode};
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

use crate::config::{AssumedTimes, Config, DeviceConfig};
use crate::cycle;
use crate::error::Cause;
use crate::segment::{Segment, SubDevice, SyncObject, Timing};
use crate::{hot_connect, mapping, sync};

/// Decides the mode of a SubDevice by wish, announcement (sub-index 04) and clock, and checks the
/// cycle against its minimum.
///
/// Without a wish it is the highest mode that both sync objects announce. A cycle below the minimum
/// is an error in every synchronized mode: a drive must not end up in Free Run because of a slip in
/// the cycle.
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
                // What is not announced at all is not chosen for it.
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
    let refused =
        |device: &SubDevice, reason| Cause::Mode { place: device.place(), wish: mode, reason };
    device.every = every(mode, config, wish).map_err(|reason| refused(device, reason))?;
    device.pulses = pulses(device, config, wish).map_err(|reason| refused(device, reason))?;
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

/// How many bus cycles the cycle of a SubDevice is; or what is wrong with the one that is wanted.
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

/// The SYNC pulses that a SubDevice's mode asks for; or what is wrong with those that are wanted.
fn pulses(
    device: &SubDevice,
    config: &Config,
    wish: Option<&DeviceConfig>,
) -> Result<Pulses, String> {
    let mode = device.mode;
    let cycle = Nanos(config.cycle.0 * i64::from(device.every));
    let outputs = device.output_sync.as_ref().map(|object| object.values).unwrap_or_default();
    let assumed = wish.and_then(|wish| wish.assumed.outputs_calc_and_copy);
    let copy = outputs.calc_and_copy_time.filter(|time| *time > Nanos::ZERO).or(assumed);
    let distance = wish.and_then(|wish| wish.sync1).unwrap_or(match mode {
        SyncMode::DcSync1 => {
            // The device's oscillator may be 100 ppm slower than system time, and pulses come on ticks.
            let copy = copy.unwrap_or(Nanos::ZERO).0;
            Nanos((copy + copy / 10_000 + 10 + 999) / 1_000 * 1_000)
        }
        _ => Nanos(cycle.0 / 4 / 10 * 10),
    });
    let stated = outputs.sync0_cycle_time.filter(|time| *time > Nanos::ZERO);
    let sync0 = wish.and_then(|wish| wish.sync0_cycle).or(stated).unwrap_or(Nanos::ZERO);
    if mode == SyncMode::DcSubordinated {
        if sync0 <= Nanos::ZERO {
            return Err(String::from(NO_SYNC0_CYCLE));
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

/// What the sync objects of the directions in use announce together; `None` if nothing is said.
fn announced(device: &SubDevice) -> Option<SupportedTypes> {
    let types = |object: &Option<SyncObject>| object.as_ref()?.values.supported;
    let outputs = types(&device.output_sync).filter(|_| device.outputs.length > 0);
    let inputs = types(&device.input_sync).filter(|_| device.inputs.length > 0);
    match (outputs, inputs) {
        (Some(outputs), Some(inputs)) => Some(SupportedTypes(outputs.0 & inputs.0)),
        (one, other) => one.or(other),
    }
}

/// Why a mode can't be; a device that announces nothing is trusted to do what it is asked.
fn allowed(
    device: &SubDevice,
    announced: Option<SupportedTypes>,
    mode: SyncMode,
) -> Result<(), String> {
    if let Some(types) = announced.filter(|types| !mode.is_supported(*types)) {
        // Free Run works for a device that is not told anything; some do not announce it.
        if mode != SyncMode::FreeRun {
            return Err(format!("the device announces {types} (0x1C32:04, 0x1C33:04)"));
        }
    }
    if mode.uses_dc() && !device.dc.has_clock() {
        return Err(String::from("its ESC has no system time (0x0910 does not answer)"));
    }
    Ok(())
}

/// Whether a SubDevice that is wanted in Free Run will be synchronous with SM all the same: it does not let itself be
/// told (0x1C32:01 is read-only), and stacks that choose for themselves prefer SM.
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

/// What a SubDevice demands of the cycle, without the arrival of its data. Where it states 0 or
/// nothing, the assumed times count.
pub(crate) fn demands(
    device: &SubDevice,
    assumed: AssumedTimes,
    wish: Option<&DeviceConfig>,
) -> budget::Device {
    let none = SyncParameters::default();
    let of = |object: &Option<SyncObject>| object.as_ref().map_or(none, |object| object.values);
    let (outputs, inputs) = (of(&device.output_sync), of(&device.input_sync));
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
        every: device.every,
        frame_spread: Nanos::ZERO,
        delay: Nanos::ZERO,
        outputs_arrival: None,
        inputs_fetched: None,
        inputs_read: None,
        watchdog: None,
        // In Free Run the device's cycle is its own.
        minimum_cycle: if free {
            Nanos::ZERO
        } else {
            stated(
                outputs.minimum_cycle_time.max(inputs.minimum_cycle_time),
                assumed.minimum_cycle,
                &mut origins.minimum_cycle,
            )
        },
        output_calc_and_copy: stated(
            outputs.calc_and_copy_time,
            assumed.outputs_calc_and_copy,
            &mut origins.output_calc_and_copy,
        ),
        output_delay: stated(outputs.delay_time, assumed.outputs_delay, &mut origins.output_delay),
        // 0 is no shift, to the device too.
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
        origins,
    }
}

/// A time as the device states it; where it states 0 or nothing, the assumed one.
fn stated(time: Option<Nanos>, assumed: Option<Nanos>, origin: &mut Origin) -> Nanos {
    if let Some(time) = time.filter(|time| *time > Nanos::ZERO) {
        return time;
    }
    if assumed.is_some() || time.is_none() {
        *origin = Origin::Assumed;
    }
    assumed.unwrap_or(Nanos::ZERO)
}

/// Plans one cycle: SYNC0's phase, and every line of the budget of every SubDevice. Frames find the
/// reference clock at phase 0 of system time.
pub(crate) fn plan(segment: &Segment, config: &Config) -> Result<Timing, Cause> {
    // Two clocks within the threshold on either side of the reference.
    let clock_error = config.clock_error.unwrap_or(Nanos(2 * config.drift_threshold.0));
    let cycle = budget::Cycle {
        cycle: config.cycle,
        send: Nanos::ZERO,
        jitter: config.host_jitter,
        clock_error,
    };
    let frames = cycle::frames(
        segment,
        config.drift_compensation,
        config.direction != Direction::FollowReference,
    );
    let times = cycle::chunk_times(&frames, segment.image.chunks.len());
    let mut demands: Vec<budget::Device> =
        segment.devices.iter().map(|device| demands_of(config, device)).collect();
    for (chunk, times) in segment.image.chunks.iter().zip(times) {
        let range = chunk.first..chunk.end;
        for (device, demands) in segment.devices[range.clone()].iter().zip(&mut demands[range]) {
            if !chunk.holds(device) {
                continue;
            }
            let delay = delay(segment, device.position);
            let (detour, early) = ring_detour(segment, config, delay);
            let detour = detour + hot_connect::detour(segment, device.position);
            demands.delay = delay;
            let (outputs, inputs) = (device.outputs.length > 0, device.inputs.length > 0);
            demands.outputs_arrival = outputs.then_some(delay + detour + times.stored);
            // Outputs as late as in the fullest cycle, inputs as early as in the emptiest.
            demands.inputs_fetched = inputs.then_some(delay - early + times.fetched - times.spread);
            demands.frame_spread = times.spread;
            if config.watchdog.is_some() {
                demands.origins.watchdog = Origin::Intent;
            }
            demands.watchdog = mapping::watchdog(device, config.watchdog);
            demands.inputs_read = inputs.then_some(delay + detour + times.read);
        }
    }
    let common = common_shift(&cycle, &demands);
    let sync0 = common.map(|common| config.shift.unwrap_or(common));
    let shift = sync0.unwrap_or(Nanos::ZERO);
    let devices: Vec<_> =
        demands.iter().map(|device| (*device, budget(&cycle, shift, device))).collect();
    let timing = Timing { cycle, sync0, frames, devices };
    if !config.force {
        let line = timing.frames_in_cycle().line();
        if !line.fits() {
            return Err(Cause::Frames { line });
        }
        for (device, (_, budget)) in segment.devices.iter().zip(&timing.devices) {
            if let Some(line) = budget.failure() {
                return Err(Cause::Plan { place: device.place(), line });
            }
        }
    }
    Ok(timing)
}

/// The demands as wishes and assumptions have them, still without arrivals.
fn demands_of(config: &Config, device: &SubDevice) -> budget::Device {
    let wish = config.devices.get(device.position);
    let assumed = wish.map(|wish| wish.assumed).unwrap_or_default();
    demands(device, assumed, wish)
}

/// By how much later and earlier than by its delay frames may come to a SubDevice of a ring that is cut: from the other
/// end against the order of all, and from the first on back again; or from the other end to it alone.
fn ring_detour(segment: &Segment, config: &Config, delay: Nanos) -> (Nanos, Nanos) {
    if config.ring.is_none() {
        return (Nanos::ZERO, Nanos::ZERO);
    }
    let whole = segment.devices.iter().filter_map(|device| device.delay).max();
    let whole = whole.unwrap_or(Nanos::ZERO);
    (whole, (delay - (whole - delay)).max(Nanos::ZERO))
}

/// The delay of a SubDevice; without one of its own, that of the next one upstream that has one.
pub(crate) fn delay(segment: &Segment, position: usize) -> Nanos {
    let mut at = Some(position);
    while let Some(position) = at {
        let device = &segment.devices[position];
        if let Some(delay) = device.delay {
            return delay;
        }
        at = device.parent.map(|(parent, _)| parent);
    }
    Nanos::ZERO
}

const NO_SYNC0_CYCLE: &str =
    "the device states no SYNC0 cycle (0x1C32:0A), and none is given for subordinated cycles";
const UNKNOWN_MODES: &str = "no direction with process data tells its modes (0x1C32:04, 0x1C33:04)";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::{Chunk, DcCapability, ProcessImage};
    use isocat_wire::StationAddress;

    /// A drive with both sync objects: announces `types`, minimum cycle 250 us.
    fn drive(outputs: u16, inputs: u16) -> SubDevice {
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

    /// Three in a ring: behind a cut at the first cable, the last one is reached past all and back; the middle one
    /// hardly earlier than on a line behind a cut before it.
    #[test]
    fn frames_in_a_ring_may_go_the_long_way() {
        let devices =
            [0, 300, 700].map(|delay| SubDevice { delay: Some(Nanos(delay)), ..drive(0, 0) });
        let segment = Segment { devices: devices.into(), ..Segment::default() };
        let mut config = Config::new(Nanos::millis(1));
        let detours = |config: &Config| {
            [0, 300, 360, 700].map(|delay| ring_detour(&segment, config, Nanos(delay)))
        };
        assert_eq!(detours(&config), [(Nanos::ZERO, Nanos::ZERO); 4]);
        config.ring = Some(crate::Ring::default());
        let expected = [(700, 0), (700, 0), (700, 20), (700, 700)];
        assert_eq!(detours(&config), expected.map(|(late, early)| (Nanos(late), Nanos(early))));
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

    /// Both sides of 0x1C32:05; SM-synchronous has the host's jitter on top.
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

    fn planned(device: SubDevice, config: &Config) -> Result<Timing, Cause> {
        let chunk =
            Chunk { every: 1, logical: 0, length: 8, first: 0, end: 1, writers: 1, readers: 1 };
        let image = ProcessImage { chunks: alloc::vec![chunk], read_write: true };
        let segment = Segment {
            devices: alloc::vec![device],
            reference: Some(0),
            image,
            ..Segment::default()
        };
        plan(&segment, config)
    }

    #[test]
    fn assumed_times_count_where_the_device_states_none() {
        let mut config = Config::new(Nanos(1_000_000));
        let assumed =
            AssumedTimes { outputs_calc_and_copy: Some(Nanos(60_000)), ..AssumedTimes::default() };
        config.devices = alloc::vec![DeviceConfig { assumed, ..DeviceConfig::default() }];
        let mut device = drive(0x0027, 0x0027);
        device.mode = SyncMode::DcSync0;
        device.pulses = Pulses { sync0_cycle: config.cycle, ..Pulses::default() };
        device.delay = Some(Nanos(300));
        let timing = planned(device.clone(), &config).unwrap();
        // Drift datagram 20, chunk 20, AL status 14, headers 16 bytes; preamble and FCS 12; at 80
        // ns.
        let arrival = 300 + (20 + 20 + 14 + 16 + 12) * 80;
        assert_eq!(timing.devices[0].0.outputs_arrival, Some(Nanos(arrival)));
        let line = timing.devices[0].1.line(Check::OutputsBeforeSync0).unwrap();
        assert_eq!(line.needed, Nanos(arrival + 20_000 + 200 + 60_000));
        // A phase of the user's, exactly enough and 1 ns too early.
        config.shift = Some(line.needed);
        assert!(planned(device.clone(), &config).is_ok());
        config.shift = Some(line.needed - Nanos(1));
        assert!(matches!(planned(device.clone(), &config), Err(Cause::Plan { .. })));
        config.force = true;
        assert!(planned(device, &config).is_ok());
    }
}
