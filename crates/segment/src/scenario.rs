//! From a segment file to a run: devices with ESC, stack and application, a host, and the
//! configuration of the MainDevice.

use std::sync::Arc;

use isocat_esc::DriftLaw;
use isocat_maindevice::written::Output;
use isocat_maindevice::{
    AssumedTimes, ClockRange, Config, DeviceConfig, DriftFilters, MeasureTimes, StartupDownload,
    StartupParameter,
};
use isocat_sim::plant::PlantSetup;
use isocat_sim::random::Stream;
use isocat_sim::{
    Cable, ClockModel, Closing, Connection, CpuModel, DeviceSetup, Expectation, HostModel, Run,
    Setup,
};
use isocat_subdevice::Application;
use isocat_subdevice::description::ProcessDataArea;
use isocat_subdevice::drive::Drive;
use isocat_subdevice::{IoOf, MAX_PROCESS_DATA};
use isocat_sync::SyncSignal;
use isocat_sync::budget::{Limits, SyncLimits};
use isocat_wire::time::{Nanos, Time};

use crate::profile::{self, ApplicationKind, CLOCK_TOLERANCE, Profile};
use crate::segment_file::{Clock, Faults, Operation, Ring, SegmentFile, SubDevice};
use crate::{chips, offline};

mod laid_out;

use laid_out::LaidOutDrive;

/// The description of a run, from which [`Scenario::run`] makes a simulation.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// File with the description of the segment.
    pub source: String,
    /// Seed of all randomness.
    pub seed: u64,
    /// Bus cycle.
    pub cycle: Nanos,
    /// Duration of the judged time.
    pub duration: Nanos,
    /// Largest SYNC0 error with which a SubDevice counts as synchronized. Default 1 us, the limit
    /// that the field calls synchronous; a healthy segment is far below it.
    pub sync0_limit: Nanos,
    /// Largest spread of the time from the acting pulse to Outputs Valid with which a SubDevice
    /// counts as synchronized. Default 1 us, the distance that ETG.1020 allows between 0x1C32:07
    /// and :09.
    pub outputs_spread: Nanos,
    /// Requested phase of SYNC0; `None`: the plan chooses.
    pub shift: Option<Nanos>,
    /// The machine of the MainDevice.
    pub host: HostModel,
    /// Whether drift compensation synchronizes the clocks.
    pub drift_compensation: bool,
    /// Filter depths of the drift loops.
    pub drift_filters: DriftFilters,
    /// The law of all drift loops; `None`: each chip's own.
    pub drift_law: Option<DriftLaw>,
    /// Largest difference of two clocks in the plan; `None`: the MainDevice's default.
    pub clock_error: Option<Nanos>,
    /// Watchdog of the process data; `None`: the chips' default.
    pub watchdog: Option<Nanos>,
    /// Whether whatever a MainDevice makes of the segment is meant: then there are no
    /// [`claims`](Self::claims).
    pub as_is: bool,
    /// Whether the delay of a hop varies from frame to frame: on the simulated wire, and in the
    /// MainDevice's plan.
    pub hop_jitter: bool,
    /// Activities of the MainDevice besides the exchange while the segment runs.
    pub operation: Operation,
    /// The cable that closes a ring; `None`: the segment hangs on one port.
    pub ring: Option<Ring>,
    /// Faults during the run.
    pub faults: Faults,
    /// Values that the MainDevice's application writes at given times.
    pub outputs: Vec<Output>,
    /// The machines behind devices.
    pub plants: Vec<PlantSetup>,
    /// Expectations of the run.
    pub expectations: Vec<Expectation>,
    /// Whether to run although the plan does not fit.
    pub force: bool,
    /// Whether any SubDevice may fail on the way up, and is then left out.
    pub tolerate: bool,
    /// Whether the simulation takes a shortcut through the regular parts of a cycle. Results do not
    /// depend on it.
    pub lane: bool,
    /// The devices, in the order of the line.
    pub devices: Vec<SubDevice>,
}

impl From<SegmentFile> for Scenario {
    fn from(file: SegmentFile) -> Self {
        let host = HostModel {
            clock_ppb: file.host.clock.0,
            jitter: file.host.jitter,
            ..HostModel::default()
        };
        Self {
            source: file.path,
            seed: file.seed,
            cycle: file.cycle,
            duration: file.duration,
            sync0_limit: file.sync0_limit,
            outputs_spread: file.outputs_spread,
            shift: file.shift,
            host,
            drift_compensation: file.host.drift_compensation,
            drift_filters: file.host.drift_filters,
            drift_law: file.drift_law,
            clock_error: None,
            watchdog: file.watchdog,
            as_is: file.as_is,
            hop_jitter: file.hop_jitter,
            operation: file.operation,
            ring: file.ring,
            faults: file.faults,
            outputs: file.outputs,
            plants: file.plants,
            expectations: file.expectations,
            force: false,
            tolerate: false,
            lane: true,
            devices: file.subdevices,
        }
    }
}

impl Scenario {
    /// The simulation of the scenario.
    pub fn run(&self) -> Run {
        let segment = self.devices.iter().enumerate().map(|(i, d)| self.connection(i, d)).collect();
        let setup = Setup::new(self.seed, self.config(), self.host, segment);
        let ring = self.ring.map(closing);
        let (faults, spares) = (self.faults.planned.clone(), self.spares());
        Run {
            setup: Setup { ring, faults, spares, lane: self.lane, ..setup },
            duration: self.duration,
            sync0_limit: self.sync0_limit,
            outputs: self.outputs.clone(),
            plants: self.plants.clone(),
            expectations: self.expectations.clone(),
            follow_course: false,
        }
    }

    /// The same segment at another bus cycle, with the phase left to the plan. Devices that are
    /// slower than the bus keep their ratio to it. `None`: a device can't run at it.
    pub fn at_cycle(&self, bus: Nanos) -> Option<Self> {
        let at = |device: &SubDevice| {
            let times = device.cycle.map(|own| own.0 / self.cycle.0);
            device.at_cycle(times.map(|times| Nanos(times * bus.0)), bus)
        };
        let devices = self.devices.iter().map(at).collect::<Option<_>>()?;
        Some(Self { cycle: bus, shift: None, devices, ..self.clone() })
    }

    /// The configuration of the MainDevice.
    pub fn config(&self) -> Config {
        let mut config = Config::new(self.cycle);
        config.host_jitter = self.host.jitter;
        config.shift = self.shift;
        config.drift_compensation = self.drift_compensation;
        config.drift_filters = self.drift_filters;
        config.clock_error = self.clock_error;
        config.limits =
            Limits { sync0_error: self.sync0_limit, outputs_spread: self.outputs_spread };
        config.watchdog = self.watchdog;
        config.hop_jitter = self.hop_jitter;
        config.force = self.force;
        config.tolerate = self.tolerate;
        config.quality = self.operation.quality;
        config.delay_watch = self.operation.delay_watch;
        config.ring = self.ring.map(|ring| self.ring_config(ring));
        config.recovery = self.operation.recovery;
        config.direction = self.operation.direction;
        config.measure_times = self.operation.measure_times.then(MeasureTimes::default);
        let own = |device| device_config(device, self.cycle);
        config.devices = self.devices.iter().map(own).collect();
        for (position, _) in self.devices.iter().enumerate().filter(|(_, d)| d.optional) {
            let known = offline::known(&self.devices, position);
            config.devices[position].hot_connect = Some(Box::new(known));
        }
        config
    }

    /// The MainDevice's settings for the ring: it knows the difference in length of the two cables,
    /// as it knows the delays.
    fn ring_config(&self, ring: Ring) -> isocat_maindevice::Ring {
        let [first, last] = offline::ends(&self.devices, ring);
        isocat_maindevice::Ring { longer: Nanos((last - first).0 / 1_000), ..Default::default() }
    }

    /// The replacement devices. They are new, so their counters begin at 0.
    fn spares(&self) -> Vec<DeviceSetup> {
        let spares = self.faults.spares.iter().enumerate();
        let spare = |(number, profile): (usize, &Arc<Profile>)| {
            let within = profile.clock_tolerance.unwrap_or(CLOCK_TOLERANCE);
            let place = self.devices.len() + number;
            let deviation_ppb = Clock::DrawnWithin(within).deviation(self.seed, place).0;
            DeviceSetup { clock: ClockModel::constant(deviation_ppb), ..self.device(profile) }
        };
        spares.map(spare).collect()
    }

    fn device(&self, profile: &Profile) -> DeviceSetup {
        DeviceSetup { chip: chips::with_law(profile.esc(), self.drift_law), ..device(profile) }
    }

    fn connection(&self, position: usize, device: &SubDevice) -> Connection {
        let profile = &device.profile;
        // Counters start at random values, as in devices that were switched on at different times.
        let local_time = Stream::new(self.seed, "power-on", position as u64).up_to(MOST_LOCAL_TIME);
        Connection {
            parent: device.place.upstream,
            port: device.place.port,
            cable: Cable::with_speed(device.cable.0 as u64, device.cable_delay.0)
                .with_asymmetry(device.cable_asymmetry.into()),
            phys: None,
            hop_jitter: self.hop_jitter,
            power_on: Time::ZERO + device.arrives.into(),
            device: DeviceSetup {
                clock: ClockModel {
                    deviation_ppb: device.clock.deviation(self.seed, position).0,
                    ..device.clock_shape
                },
                local_time: Time::new(local_time),
                ..self.device(profile)
            },
        }
    }
}

/// The device of a profile, with a perfect clock that begins at 0.
pub fn device(profile: &Profile) -> DeviceSetup {
    DeviceSetup {
        chip: *profile.esc(),
        sii: profile.sii.clone(),
        description: profile.description.clone(),
        application: application(profile),
        cpu: cpu(profile),
        clock: ClockModel::constant(0),
        local_time: Time::ZERO,
        sampling: profile.sampling.clone(),
    }
}

/// The cable that closes the ring, with the usual signal delay.
fn closing(ring: Ring) -> Closing {
    let cable = Cable::of_length(ring.cable.0 as u64);
    Closing { device: ring.device, port: ring.port, cable }
}

/// Four months in ns.
const MOST_LOCAL_TIME: u64 = 10_000_000_000_000_000;

fn device_config(device: &SubDevice, cycle: Nanos) -> DeviceConfig {
    let profile = &device.profile;
    let list = |pdos: &[u16]| (!pdos.is_empty()).then(|| pdos.to_vec());
    // A device without mailbox states nothing over the wire, so the user's file is used.
    let silent = (!profile.has_mailbox()).then_some(profile);
    // No device can state the punctuality of its CPU.
    let jitter = profile.times.jitter + profile.times.unevenness.timer_jitter;
    // Times that it states as 0 but needs.
    let times = &profile.times;
    let copy_inputs = times.input_copy.max(times.application);
    let assumed = AssumedTimes {
        // Its CPU takes the steps one after the other.
        minimum_cycle: Some(times.calc_and_copy + times.application + times.input_copy + jitter),
        pulse_jitter: Some(jitter),
        outputs_calc_and_copy: Some(times.calc_and_copy),
        // Outputs without a delay act after the application.
        outputs_delay: Some(times.application),
        outputs_spread: Some(outputs_spread(profile)),
        sync_signal: sync_signal(profile),
        sync_limits: sync_limits(profile),
        inputs_calc_and_copy: Some(copy_inputs),
        ..AssumedTimes::default()
    };
    let assumed = silent.map_or(assumed, |profile| AssumedTimes {
        outputs_calc_and_copy: Some(profile.times.calc_and_copy),
        inputs_calc_and_copy: Some(profile.times.application + profile.times.input_copy),
        ..assumed
    });
    // A device that measures its times states nothing before.
    let assumed = match profile.dynamic_times {
        true => AssumedTimes {
            minimum_cycle: None,
            outputs_calc_and_copy: None,
            outputs_delay: None,
            inputs_calc_and_copy: None,
            inputs_delay: None,
            ..assumed
        },
        false => assumed,
    };
    DeviceConfig {
        name: device.name.clone(),
        identity: Some((profile.identity.vendor_id, profile.identity.product_code)),
        mode: device.mode.or_else(|| silent?.preferred_mode()),
        outputs: list(&profile.assignment.outputs),
        inputs: list(&profile.assignment.inputs),
        shift_outputs: device.shift,
        shift_inputs: device.input_shift,
        cycle: device.cycle,
        sync1: device.sync1,
        sync0_cycle: device.sync0_cycle,
        unit: device.unit,
        measured: device.measured,
        assumed,
        clock: Some(clock_range(device)),
        startup: profile
            .startup
            .iter()
            .map(|one| startup(one, &profile.startup, device.cycle.unwrap_or(cycle)))
            .collect(),
        parameters: profile
            .parameters
            .iter()
            .map(|one| parameter(one, device.cycle.unwrap_or(cycle)))
            .collect(),
        watchdog: profile.watchdog,
        hot_connect: None,
    }
}

/// What ends its SYNC pulses: the length in its EEPROM, or its program's acknowledgement.
fn sync_signal(profile: &Profile) -> SyncSignal {
    match profile.pulse() {
        Nanos::ZERO => SyncSignal::Acknowledged(profile.times.acknowledge),
        length => SyncSignal::Pulse(length),
    }
}

/// The cycles that its SYNC unit takes. A simple device without SYNC0 looks at no register of it.
fn sync_limits(profile: &Profile) -> SyncLimits {
    if !profile.has_mailbox() && !profile.supported_types().dc_sync0() {
        return SyncLimits::default();
    }
    let behaviour = &profile.description.behaviour;
    let some = |time: Nanos| Some(time).filter(|time| *time > Nanos::ZERO);
    SyncLimits {
        longest: some(behaviour.maximum_cycle_time),
        step: some(behaviour.cycle_granularity),
    }
}

/// Spread of outputs without a delay after their pulse. They act after the application, which may
/// be faster than its stated time. Outputs that SYNC0 fetches get a fixed time for it.
fn outputs_spread(profile: &Profile) -> Nanos {
    let times = &profile.times;
    let variation = i64::from(times.unevenness.variation);
    let faster = Nanos(times.application.0 * variation / 100);
    if profile.description.behaviour.polls_outputs {
        times.jitter + times.unevenness.timer_jitter
    } else {
        times.jitter + faster
    }
}

/// The range of a clock's deviation according to the file.
fn clock_range(device: &SubDevice) -> ClockRange {
    let shape = &device.clock_shape;
    let moves = [shape.ramp.map(|ramp| ramp.by_ppb), shape.step.map(|step| step.by_ppb)];
    let wanders = shape.walk.map_or(0, |walk| walk.bound_ppb);
    let moved = moves.iter().flatten();
    let (least, most) = match device.clock {
        Clock::Given(deviation) => (deviation.0, deviation.0),
        Clock::DrawnWithin(most) => (-most.0, most.0),
    };
    ClockRange {
        least_ppb: least - wanders + moved.clone().map(|by| *by.min(&0)).sum::<i64>(),
        most_ppb: most + wanders + moved.map(|by| *by.max(&0)).sum::<i64>(),
    }
}

fn startup(download: &profile::Startup, all: &[profile::Startup], cycle: Nanos) -> StartupDownload {
    StartupDownload {
        object: download.object,
        data: download.at_cycle(all, cycle),
        complete: download.complete_access,
    }
}

fn parameter(wanted: &profile::StartupParameter, cycle: Nanos) -> StartupParameter {
    StartupParameter { drive: wanted.drive, idn: wanted.idn, data: wanted.at_cycle(cycle) }
}

/// An application that is just large enough for the process data of the device: a segment may have
/// thousands of small ones.
fn io(profile: &Profile) -> Box<dyn Application + Send> {
    let bytes = |areas: &mut dyn Iterator<Item = ProcessDataArea>| -> usize {
        areas.map(|area| usize::from(area.max_length)).sum()
    };
    let description = &profile.description;
    let outputs = bytes(&mut description.output_areas());
    match outputs.min(bytes(&mut description.input_areas())) {
        ..=32 => Box::new(IoOf::<32>::new()),
        33..=256 => Box::new(IoOf::<256>::new()),
        _ => Box::new(IoOf::<MAX_PROCESS_DATA>::new()),
    }
}

fn application(profile: &Profile) -> Box<dyn Application + Send> {
    match profile.application {
        ApplicationKind::Drive => Box::new(Drive::default()),
        ApplicationKind::DriveAt(layout) => Box::new(LaidOutDrive::new(layout)),
        // Its inputs are samples of a signal, and no copies of outputs.
        ApplicationKind::Io if profile.samples_inputs() => Box::new(()),
        ApplicationKind::Io => io(profile),
    }
}

fn cpu(profile: &Profile) -> CpuModel {
    let times = &profile.times;
    CpuModel {
        reaction: times.reaction,
        copy_outputs: times.calc_and_copy,
        application: times.application,
        copy_inputs: times.input_copy,
        jitter: times.jitter,
        acknowledge: times.acknowledge,
        unevenness: times.unevenness,
    }
}
