//! Times that devices measure themselves: object entries 0x1C32:08 and 0x1C33:08, "get cycle time".
//!
//! A device whose sub-index 04 announces dynamic times (bit 14) may state 0 in sub-indices 05, 06
//! and 09, and measures them in OP on command. The bring-up then has two passes:
//!
//! 1. the segment is brought to OP by a plan in which these times are 0 or assumed;
//! 2. [`measure`] starts the measurement, reads the values until they stay the same, stops it and
//!    leaves OP;
//! 3. [`plan_anew`] goes back to PREOP and plans with the measured times, before SYNC is programmed
//!    and SAFEOP is requested again.
//!
//! During step 1 all outputs are 0, as before the first call of the application.

use alloc::boxed::Box;
use alloc::vec::Vec;

use isocat_sync::SyncMode;
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, SyncParameters, sub};
use isocat_wire::ObjectAddress;
use isocat_wire::al::AlState;
use isocat_wire::dc::SyncActivation;
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;

use crate::bring_up::{self, End, Work};
use crate::config::{Config, DeviceConfig, MeasureTimes, MeasuredTimes};
use crate::error::{Cause, SdoError};
use crate::event::Stage;
use crate::link::Link;
use crate::mailbox::Mailbox;
use crate::objects::{number, sdo};
use crate::segment::{Segment, SubDevice, SyncObject};
use crate::{coe, esm, left_out, mode, timing};

/// The result of a device's measurement.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct OwnTimes {
    /// The times; all `None` if the device refused the command.
    pub times: MeasuredTimes,
    /// Whether they stayed the same for [`MeasureTimes::settled`]; otherwise these are the last
    /// ones.
    pub settled: bool,
    /// Time from the command to the last reading.
    pub after: Nanos,
}

impl MeasuredTimes {
    /// Whether no time is known.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// These times, completed by the other ones.
    pub(crate) fn or(self, other: Self) -> Self {
        Self {
            minimum_cycle: self.minimum_cycle.or(other.minimum_cycle),
            outputs_calc_and_copy: self.outputs_calc_and_copy.or(other.outputs_calc_and_copy),
            outputs_delay: self.outputs_delay.or(other.outputs_delay),
            inputs_calc_and_copy: self.inputs_calc_and_copy.or(other.inputs_calc_and_copy),
            inputs_delay: self.inputs_delay.or(other.inputs_delay),
        }
    }

    /// Each time with its entry. The minimum cycle is the longer one of both objects and is given
    /// as 0x1C32:05.
    pub fn entries(&self) -> impl Iterator<Item = (ObjectAddress, Nanos)> {
        let at = ObjectAddress::new;
        [
            (at(OUTPUT_PARAMETER, sub::MINIMUM_CYCLE_TIME), self.minimum_cycle),
            (at(OUTPUT_PARAMETER, sub::CALC_AND_COPY_TIME), self.outputs_calc_and_copy),
            (at(OUTPUT_PARAMETER, sub::DELAY_TIME), self.outputs_delay),
            (at(INPUT_PARAMETER, sub::CALC_AND_COPY_TIME), self.inputs_calc_and_copy),
            (at(INPUT_PARAMETER, sub::DELAY_TIME), self.inputs_delay),
        ]
        .into_iter()
        .filter_map(|(entry, time)| Some((entry, time?)))
    }

    /// The stated times of both objects, completed by these times if they state 0 or nothing.
    pub(crate) fn complete(
        &self,
        outputs: SyncParameters,
        inputs: SyncParameters,
    ) -> (SyncParameters, SyncParameters) {
        let stated = |time: Option<Nanos>| time.filter(|time| *time > Nanos::ZERO);
        let or = |time: Option<Nanos>, own: Option<Nanos>| stated(time).or(own).or(time);
        // The larger one of both objects counts.
        let cycle = stated(outputs.minimum_cycle_time.max(inputs.minimum_cycle_time));
        let own_cycle = self.minimum_cycle.filter(|_| cycle.is_none());
        (
            SyncParameters {
                minimum_cycle_time: own_cycle.or(outputs.minimum_cycle_time),
                calc_and_copy_time: or(outputs.calc_and_copy_time, self.outputs_calc_and_copy),
                delay_time: or(outputs.delay_time, self.outputs_delay),
                ..outputs
            },
            SyncParameters {
                calc_and_copy_time: or(inputs.calc_and_copy_time, self.inputs_calc_and_copy),
                delay_time: or(inputs.delay_time, self.inputs_delay),
                ..inputs
            },
        )
    }
}

/// The measured times of a device: those of this bring-up, otherwise those of the configuration.
pub(crate) fn known(device: &SubDevice, wish: Option<&DeviceConfig>) -> MeasuredTimes {
    let configured = wish.map(|wish| wish.measured).unwrap_or_default();
    device.own_times.map_or(configured, |own| own.times.or(configured))
}

/// Whether any device must still measure its times.
pub(crate) fn is_wanted(segment: &Segment, config: &Config) -> bool {
    config.measure_times.is_some()
        && segment.devices.iter().any(|device| lacks(device, config.devices.get(device.position)))
}

/// Whether the device announces dynamic times, accepts the command to measure them, and states 0
/// for one that neither it nor the configuration has measured.
fn lacks(device: &SubDevice, wish: Option<&DeviceConfig>) -> bool {
    // In Free Run its times do not matter.
    let bound = device.mode != SyncMode::FreeRun || mode::takes_sm_mode(device);
    let configured = wish.map(|wish| wish.measured).unwrap_or_default();
    device.admitted
        && bound
        && device.own_times.is_none()
        && configured.is_empty()
        && dynamic(device).any(|(_, object)| {
            let zero = |sub: &u8| object.entry(*sub).and_then(|entry| entry.number()) == Some(0);
            TIMES.iter().any(zero)
        })
}

/// The objects of the directions with process data that announce dynamic times and have the
/// command.
fn dynamic(device: &SubDevice) -> impl Iterator<Item = (u16, &SyncObject)> {
    let outputs = device.output_sync.as_ref().filter(|_| device.outputs.length > 0);
    let inputs = device.input_sync.as_ref().filter(|_| device.inputs.length > 0);
    [(OUTPUT_PARAMETER, outputs), (INPUT_PARAMETER, inputs)]
        .into_iter()
        .filter_map(|(index, object)| Some((index, object?)))
        .filter(|(_, object)| object.values.supported.is_some_and(|types| types.dynamic_times()))
        .filter(|(_, object)| object.entry(sub::GET_CYCLE_TIME).is_some())
}

/// Lets the devices that lack times measure them in OP, concurrently; then all go to SAFEOP.
pub(crate) async fn measure(mut work: Work) -> End {
    let result = measure_all(&mut work).await;
    if let Err(cause) = result {
        return work.end(Err(cause));
    }
    let (link, patience) = (work.link.clone(), work.config.timeouts.init);
    let left = bring_up::settle(&mut work.segment.devices, |device| {
        Box::pin(bring_up::step_down(&link, device, AlState::SafeOp, patience))
    })
    .await;
    work.end(left.into_iter().collect())
}

async fn measure_all(work: &mut Work) -> Result<(), Cause> {
    let (link, config) = (work.link.clone(), work.config.clone());
    let (link, config) = (&link, &*config);
    let wish = config.measure_times.unwrap_or_default();
    let failures = bring_up::each_with_mailbox(work, |device, mailbox| {
        Box::pin(async move {
            let lacking = lacks(device, config.devices.get(device.position));
            let Some(mailbox) = mailbox.filter(|_| lacking) else { return Ok(()) };
            device.own_times = Some(measure_one(link, wish, device, mailbox).await?);
            Ok(())
        })
    })
    .await?;
    left_out::leave_out(work, failures).await;
    Ok(())
}

async fn measure_one(
    link: &Link,
    wish: MeasureTimes,
    device: &SubDevice,
    mailbox: &mut Mailbox,
) -> Result<OwnTimes, Cause> {
    if !command(device, mailbox, MEASURE).await? {
        return Ok(OwnTimes::default());
    }
    let begin = link.now();
    let (mut times, mut changed) = (MeasuredTimes::default(), begin);
    let settled = loop {
        link.sleep(LOOK).await;
        let found = read(device, mailbox).await?;
        let now = link.now();
        if found != times {
            (times, changed) = (found, now);
        }
        if !times.is_empty() && now - changed >= wish.settled {
            break true;
        }
        if now - begin >= wish.longest {
            break false;
        }
    };
    // The values remain after the measurement ends.
    command(device, mailbox, STOP).await?;
    Ok(OwnTimes { times, settled, after: link.now() - begin })
}

/// Writes sub-index 08 of both objects, since some stacks have a separate command for each; returns
/// `false` if no object accepts it.
async fn command(device: &SubDevice, mailbox: &mut Mailbox, value: u16) -> Result<bool, Cause> {
    let mut taken = false;
    for (index, _) in dynamic(device) {
        let object = ObjectAddress::new(index, sub::GET_CYCLE_TIME);
        match coe::download(mailbox, object, &value.to_le_bytes(), false).await {
            Ok(()) => taken = true,
            Err(SdoError::Abort(_)) => {}
            Err(error) => return Err(sdo(device, object, error)),
        }
    }
    Ok(taken)
}

/// Reads the times that the device shows now; a time of 0 is not measured.
async fn read(device: &SubDevice, mailbox: &mut Mailbox) -> Result<MeasuredTimes, Cause> {
    let mut shown = [SyncParameters::default(); 2];
    for (index, object) in dynamic(device) {
        for sub in TIMES.into_iter().filter(|sub| object.entry(*sub).is_some()) {
            let Some(value) = number(mailbox, device, index, sub).await? else { continue };
            if value > 0 {
                shown[usize::from(index != OUTPUT_PARAMETER)].set(sub, value);
            }
        }
    }
    let [outputs, inputs] = shown;
    Ok(MeasuredTimes {
        minimum_cycle: outputs.minimum_cycle_time.max(inputs.minimum_cycle_time),
        outputs_calc_and_copy: outputs.calc_and_copy_time,
        outputs_delay: outputs.delay_time,
        inputs_calc_and_copy: inputs.calc_and_copy_time,
        inputs_delay: inputs.delay_time,
    })
}

/// Goes back to PREOP with SYNC off, without process data, and plans with the measured times.
pub(crate) async fn plan_anew(mut work: Work) -> End {
    let result = replan(&mut work).await;
    work.end(result)
}

async fn replan(work: &mut Work) -> Result<(), Cause> {
    let (link, config) = (work.link.clone(), work.config.clone());
    work.enter(Stage::PreOp);
    let down = bring_up::settle(&mut work.segment.devices, |device| {
        Box::pin(to_preop(&link, &config, device))
    })
    .await;
    down.into_iter().collect::<Result<Vec<_>, _>>()?;
    let off = SyncActivation(0).to_bytes();
    link.bwr(register::SYNC_ACTIVATION.address, &off).reply().await?;
    // The complete cycles so far belong to the first pass.
    link.board(|board| board.complete_cycles = 0);

    work.enter(Stage::Plan);
    for device in work.segment.devices.iter_mut().filter(|device| device.admitted) {
        device.sync = None;
        mode::choose(device, &config, config.devices.get(device.position))?;
    }
    work.segment.timing = Some(timing::plan(&work.segment, &config)?);
    Ok(())
}

/// Goes to PREOP. A device whose times did not fit the first plan may have left OP with an error.
async fn to_preop(link: &Link, config: &Config, device: &mut SubDevice) -> Result<(), Cause> {
    if !device.admitted {
        return Ok(());
    }
    let patience = config.timeouts.init;
    let (status, code) = esm::read_status(link, device.station).await?;
    (device.al_status, device.al_code) = (status, code);
    if let (true, Ok(state)) = (status.error(), status.state()) {
        esm::acknowledge(link, device, state, patience).await?;
    }
    esm::change(link, device, AlState::PreOp, patience).await
}

/// The sub-indices that are measured.
const TIMES: [u8; 3] = [sub::MINIMUM_CYCLE_TIME, sub::CALC_AND_COPY_TIME, sub::DELAY_TIME];
/// Sub-index 08, bit 0: start a new measurement.
const MEASURE: u16 = 1;
/// Sub-index 08: stop the measurement.
const STOP: u16 = 0;
/// Time between two readings: some ten cycles, and a small load of the mailbox.
const LOOK: Nanos = Nanos::millis(50);
