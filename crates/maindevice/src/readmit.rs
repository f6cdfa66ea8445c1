//! Re-admits SubDevices that lost power or link into a running segment, and recovers those that
//! left OP.
//!
//! The SubDevices that `health` found are compared with the tree of the scan: [`places`] assigns
//! them. [`readmit`] re-admits all that are back together, with separate steps where possible:
//! address, identity, PREOP, objects and mapping as planned, delay and offset from the running
//! reference clock, drift by the cyclic datagram, SYNC on the common grid, SAFEOP, OP. [`recover`]
//! is for a SubDevice that kept its place and only left its state, and [`restart`] for one of these
//! whose error only INIT clears.
//!
//! None of this disturbs the running SubDevices. All writes go to the SubDevice in question; the
//! only broadcast is the latch of receive times (0x0900), which neither SYNC nor the drift loop
//! uses.

use alloc::boxed::Box;
use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;
use core::convert::Infallible;

use isocat_wire::StationAddress;
use isocat_wire::al::AlState;
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::register::{self, Value};
use isocat_wire::time::Nanos;
use spin::Mutex;

use crate::bring_up;
use crate::clock::{self, Joining};
use crate::config::{Config, DeviceConfig, Recovery};
use crate::error::{Cause, MappingProblem};
use crate::health::Found;
use crate::link::{Link, Procedure, Travel, drive_beside, join};
use crate::mailbox::Mailbox;
use crate::segment::{DcCapability, Segment, SubDevice};
use crate::{esm, mapping, mode, scan, sii, sync, timing};

mod keeper;
mod places;

pub(crate) use keeper::Keeper;
pub(crate) use places::places;

/// The result for one SubDevice.
pub(crate) type Outcome = Result<Box<(SubDevice, Option<Mailbox>)>, Cause>;

/// How a recovery ended: the SubDevice, in OP again, and its new mailbox if it was led through INIT
/// and came to PREOP at least.
pub(crate) type Recovered = (Result<SubDevice, Cause>, Option<Mailbox>);

/// Results by position, as they come.
pub(crate) type Outcomes = Arc<Mutex<Vec<(usize, Outcome)>>>;

/// The SubDevices that are back, and the data needed to re-admit them.
pub(crate) struct Return {
    pub link: Link,
    pub config: Arc<Config>,
    /// The segment as planned, with the SubDevices that take part at present.
    pub segment: Segment,
    pub everybody: Vec<Found>,
    pub places: Vec<Option<usize>>,
    /// Positions that are back.
    pub back: Vec<usize>,
    /// Where each result is put.
    pub outcomes: Outcomes,
}

/// One SubDevice during its re-admission, until it fails.
struct Traveller {
    place: usize,
    device: SubDevice,
    mailbox: Option<Mailbox>,
    failed: Option<Cause>,
}

/// Re-admits SubDevices that are back. An error at one of them ends only its own re-admission.
pub(crate) async fn readmit(work: Return) {
    let Return { link, config, mut segment, everybody, places, back, outcomes } = work;
    let (link, config) = (&link, &*config);
    let mut all: Vec<Traveller> = Vec::with_capacity(back.len());
    for position in back {
        let Some(place) = places[position] else { continue };
        let device = segment.devices[position].clone();
        all.push(Traveller { place, device, mailbox: None, failed: None });
    }
    each(&mut all, |one| Box::pin(identify(link, config, one, everybody[one.place].station))).await;
    let planned = &segment;
    each(&mut all, |one| Box::pin(prepare(link, config, planned, one))).await;
    // The delays are those of the present way of frames. If another clock becomes the reference,
    // the way changes anyhow.
    let (reference, way) = (segment.reference, link.board(|board| board.way_changes));
    if let Err(cause) = set_clocks(link, config, &mut segment, &everybody, &places, &mut all).await
    {
        for one in all.iter_mut().filter(|one| one.failed.is_none() && one.device.dc.has_clock()) {
            one.failed = Some(cause.clone());
        }
    }
    let way = (segment.reference == reference).then_some(way);
    let segment = &segment;
    let outcomes = &outcomes;
    let ends = all.into_iter().map(|mut one| -> Procedure<'_, Result<(), Infallible>> {
        Box::pin(async move {
            if one.failed.is_none() {
                one.failed = finish(link, config, segment, way, &mut one).await.err();
            }
            let position = one.device.position;
            let outcome = match one.failed {
                Some(cause) => Err(cause),
                None => Ok(Box::new((one.device, one.mailbox))),
            };
            outcomes.lock().push((position, outcome));
            Ok(())
        })
    });
    let Ok(_) = join(ends.collect()).await;
}

/// Runs the same procedure at all SubDevices that have not failed, concurrently, each to its own
/// end.
async fn each<'a>(
    all: &'a mut [Traveller],
    procedure: impl Fn(&'a mut Traveller) -> Procedure<'a, Result<(), Cause>>,
) {
    let going = all.iter_mut().filter(|one| one.failed.is_none());
    let procedures: Vec<Procedure<'a, Result<Option<Cause>, Infallible>>> = going
        .map(|one| {
            let procedure = procedure(one);
            Box::pin(async move { Ok(procedure.await.err()) }) as Procedure<'a, _>
        })
        .collect();
    let Ok(_) = join(procedures).await;
}

/// Gives the SubDevice its address and checks its identity. A different device gets its former
/// address back.
async fn identify(
    link: &Link,
    config: &Config,
    one: &mut Traveller,
    before: StationAddress,
) -> Result<(), Cause> {
    let result = async {
        let planned = &one.device;
        let address = register::STATION_ADDRESS.address;
        link.apwr(one.place, address, &planned.station.0.to_bytes()).expect(1).await?;
        let mut found = SubDevice::new(planned.position, planned.station);
        if let Some(wish) = config.devices.get(planned.position) {
            found.name.clone_from(&wish.name);
        }
        scan::take_eeprom(link, found.station).await?;
        let read = sii::read(link, config, &mut found).await;
        let identity = |device: &SubDevice| (device.identity.vendor, device.identity.product);
        let (expected, now) = (identity(planned), identity(&found));
        if now != (0, 0) && now != expected {
            let place = crate::Place { position: found.position, name: found.sii.name.clone() };
            link.fpwr(found.station, address, &before.0.to_bytes()).expect(1).await?;
            return Err(Cause::Identity { place, expected, found: now });
        }
        read?;
        scan::reset_one(link, found.station).await?;
        scan::describe(link, &mut found).await?;
        esm::to_init(link, &mut found, config.timeouts.init).await?;
        if found.dc != planned.dc {
            let (place, planned, found) = (planned.place(), planned.dc, found.dc);
            return Err(Cause::Clock { place, planned, found });
        }
        // All other data is as planned.
        one.device = SubDevice {
            esc: found.esc,
            identity: found.identity,
            sii: found.sii,
            dl_status: found.dl_status,
            al_status: found.al_status,
            al_code: found.al_code,
            sync: None,
            ..one.device.clone()
        };
        Ok(())
    }
    .await;
    keep(one, result)
}

/// Stores a failure, which ends the re-admission of this SubDevice.
fn keep(one: &mut Traveller, result: Result<(), Cause>) -> Result<(), Cause> {
    one.failed = result.clone().err();
    result
}

/// Goes to PREOP and checks objects and mapping, which must be those of the process image.
async fn prepare(
    link: &Link,
    config: &Config,
    segment: &Segment,
    one: &mut Traveller,
) -> Result<(), Cause> {
    let result = async {
        let device = &mut one.device;
        bring_up::to_preop(link, config, device).await?;
        one.mailbox = bring_up::mailbox(link, config, device);
        let lengths = |device: &SubDevice| (device.outputs.length, device.inputs.length);
        let planned = (device.outputs.clone(), device.inputs.clone());
        let planned_lengths = lengths(device);
        let mailbox = one.mailbox.as_mut();
        bring_up::read_objects(mailbox, device, wish(config, device), None).await?;
        mapping::place_process_data(device)?;
        if (&device.outputs, &device.inputs) != (&planned.0, &planned.1) {
            let (planned, found) = (planned_lengths, lengths(device));
            let problem = MappingProblem::Changed { planned, found };
            return Err(Cause::Mapping { place: device.place(), problem });
        }
        still_fits(config, segment, device)?;
        mapping::write(link, device, config.watchdog_of(device.position)).await
    }
    .await;
    keep(one, result)
}

/// Checks that its stated times fit the common plan: a device with other firmware, or one that was
/// only known by a description, may need longer.
fn still_fits(config: &Config, segment: &Segment, device: &SubDevice) -> Result<(), Cause> {
    let Some(timing) = &segment.timing else { return Ok(()) };
    let mut chosen = device.clone();
    mode::choose(&mut chosen, config, wish(config, device))?;
    if chosen.mode != device.mode {
        let (wish, reason) = (device.mode, "it does not offer what was planned".into());
        return Err(Cause::Mode { place: device.place(), wish, reason });
    }
    let mut segment = segment.clone();
    segment.devices[device.position] = device.clone();
    let again = Config { force: true, shift: timing.sync0, ..config.clone() };
    let planned = timing::plan(&segment, &again)?;
    let line = planned.devices.get(device.position).and_then(|(_, budget)| budget.failure());
    match line.filter(|_| !config.force) {
        Some(line) => Err(Cause::Plan { place: device.place(), line }),
        None => Ok(()),
    }
}

fn wish<'a>(config: &'a Config, device: &SubDevice) -> Option<&'a DeviceConfig> {
    config.devices.get(device.position)
}

/// Sets delay and offset of the SubDevices with a clock.
async fn set_clocks(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    everybody: &[Found],
    places: &[Option<usize>],
    all: &mut [Traveller],
) -> Result<(), Cause> {
    let mut going: Vec<_> = all.iter_mut().filter(|one| one.failed.is_none()).collect();
    for one in &going {
        segment.devices[one.device.position] = one.device.clone();
    }
    for (position, place) in places.iter().enumerate() {
        if let Some(found) = place.and_then(|at| everybody.get(at)) {
            segment.devices[position].dl_status = found.dl_status;
        }
    }
    let joining: Vec<usize> = going.iter().map(|one| one.device.position).collect();
    // Frames pass all SubDevices that answer, including those that could not be re-admitted.
    let there: Vec<usize> = (0..places.len())
        .filter(|at| segment.devices[*at].admitted || places[*at].is_some())
        .collect();
    let mut strangers = everybody.len().saturating_sub(there.len()) as u16;
    for &at in there.iter().filter(|at| !joining.contains(at)) {
        let device = &mut segment.devices[at];
        let found = places[at].and_then(|place| everybody.get(place));
        // A SubDevice that kept its former address, or lost its new one, cannot be asked for its
        // times.
        if !device.admitted && found.is_none_or(|found| found.station != device.station) {
            device.dc = DcCapability::None;
            strangers += 1;
        }
    }
    clock::join(link, config, segment, Joining { joining, there, strangers }).await?;
    for one in &mut going {
        let set = &segment.devices[one.device.position];
        one.device.delay = set.delay;
        one.device.measured_delay = set.measured_delay;
        one.device.offset = set.offset;
    }
    Ok(())
}

/// From set clocks to OP. `way` is the number of way changes when the delays were measured; `None`:
/// the reference has changed since.
async fn finish(
    link: &Link,
    config: &Config,
    segment: &Segment,
    way: Option<u64>,
    one: &mut Traveller,
) -> Result<(), Cause> {
    let device = &mut one.device;
    // A new reference takes over within this time.
    link.sleep(Nanos(3 * config.cycle.0)).await;
    let way = way.unwrap_or_else(|| link.board(|board| board.way_changes));
    let led = segment.reference.filter(|reference| *reference != device.position);
    if let (true, true, Some(reference)) = (device.dc.has_clock(), config.drift_compensation, led) {
        let noise = clock::noise(segment, config)[device.position];
        let (filter, _) = clock::depths(segment, config);
        clock::follow(link, config, segment.devices[reference].station, noise, filter, device)
            .await?;
    }
    stays_on(way, link, segment, device)?;
    if let Some(mailbox) = one.mailbox.as_mut().filter(|_| device.has_coe()) {
        sync::write_types(mailbox, device, config, wish(config, device)).await?;
    }
    program_sync(link, config, segment, device).await?;
    esm::change(link, device, AlState::SafeOp, config.timeouts.safeop).await?;
    if let Some(mailbox) = one.mailbox.as_mut().filter(|_| device.has_coe()) {
        sync::verify_types(mailbox, device, wish(config, device)).await?;
    }
    wait_for_inputs(link, config, device).await?;
    wait_for_sync(link, config, segment, device).await?;
    to_op(link, config, segment, device).await?;
    stays_on(way, link, segment, device)
}

/// Checks that frames have not changed their way to a controlled clock: before it is admitted, no
/// code corrects its delay.
fn stays_on(way: u64, link: &Link, segment: &Segment, device: &SubDevice) -> Result<(), Cause> {
    let is_led = device.dc.has_clock() && segment.reference != Some(device.position);
    match is_led && link.board(|board| board.way_changes) != way {
        true => Err(Cause::WayChanged { place: device.place() }),
        false => Ok(()),
    }
}

/// Programs SYNC on the common grid.
async fn program_sync(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    sync::program_unit(link, device).await?;
    let phase = segment.timing.as_ref().and_then(|timing| timing.sync0);
    let (true, Some(phase), Some(reference)) = (device.mode.uses_dc(), phase, segment.reference)
    else {
        return Ok(());
    };
    let now = sync::reference_now(link, &segment.devices[reference]).await?;
    let grid = sync::grid(segment, config.cycle).unwrap_or(sync::own_grid(device, config.cycle));
    let acting = grid.start(now, config.timeouts.sync_lead, phase);
    sync::program(link, device, acting).await
}

/// Waits until one cycle after the first pulse, and verifies that pulses come.
async fn wait_for_sync(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let (Some(setting), Some(reference)) = (device.sync, segment.reference) else { return Ok(()) };
    let now = sync::reference_now(link, &segment.devices[reference]).await?;
    link.sleep(Nanos((setting.start - now + config.cycle).0.max(0))).await;
    sync::verify(link, device).await
}

/// Waits until inputs come, or without inputs for some cycles in which outputs were sent.
///
/// Inputs are read by a separate datagram, since their logical bytes belong to this SubDevice
/// alone; the working counter of the cycle cannot tell which SubDevice is still missing.
async fn wait_for_inputs(link: &Link, config: &Config, device: &SubDevice) -> Result<(), Cause> {
    let own = Nanos(config.cycle.0 * i64::from(device.every));
    let longer = Nanos((own - config.cycle).0 * bring_up::COMPLETE_CYCLES as i64);
    let end = link.now() + config.timeouts.safeop + longer;
    let exchanged = device.inputs.exchanged();
    let mut right = 0;
    while right < bring_up::COMPLETE_CYCLES {
        if let Some((logical, length)) = exchanged {
            let (address, data) = (Address::Logical(logical), vec![0; usize::from(length)]);
            let read = link.exchange(Command::Lrd, address, data, Travel::default()).reply();
            let found = read.await?.wkc;
            right = if found == 1 { right + 1 } else { 0 };
            if link.now() >= end {
                let cycles = ((config.timeouts.safeop.0) / config.cycle.0.max(1)) as u64;
                return Err(Cause::ProcessData { cycles, expected: 1, found });
            }
        } else {
            right += 1;
        }
        link.sleep(own).await;
    }
    Ok(())
}

/// Recovers a SubDevice that left OP but is in SAFEOP and synchronized: it acknowledges the error,
/// verifies SYNC, and goes to OP.
pub(crate) async fn recover(
    link: Link,
    config: Arc<Config>,
    segment: Segment,
    position: usize,
) -> Result<SubDevice, Cause> {
    let mut device = segment.devices[position].clone();
    let (status, code) = esm::read_status(&link, device.station).await?;
    (device.al_status, device.al_code) = (status, code);
    if status.error() {
        let patience = match config.recovery {
            // Another attempt follows, so that one that is in vain need not last.
            Recovery::BackOff { .. } => config.timeouts.safeop.min(ACKNOWLEDGEMENT),
            Recovery::Never | Recovery::Once => config.timeouts.safeop,
        };
        esm::acknowledge(&link, &mut device, AlState::SafeOp, patience).await?;
    }
    let_sync_run(&link, &config, &segment, &mut device).await?;
    wait_for_inputs(&link, &config, &device).await?;
    // SYNC is verified again, because a SubDevice whose pulses stopped meanwhile would wait for
    // them for seconds on its way to OP.
    let_sync_run(&link, &config, &segment, &mut device).await?;
    to_op(&link, &config, &segment, &mut device).await?;
    Ok(device)
}

/// Leads a SubDevice through INIT, which clears an error that it keeps otherwise, and up again as
/// one that comes back. Its clock went on, and so did all others.
pub(crate) async fn restart(
    link: Link,
    config: Arc<Config>,
    segment: Segment,
    position: usize,
) -> Recovered {
    let device = segment.devices[position].clone();
    let mut one = Traveller { place: position, device, mailbox: None, failed: None };
    let result = match through_init(&link, &config, &segment, &mut one).await {
        // It was never out of the segment, so its delay is corrected as that of all others.
        Err(Cause::WayChanged { .. }) if one.device.al_status.state() == Ok(AlState::Op) => Ok(()),
        result => result,
    };
    (result.map(|()| one.device), one.mailbox)
}

async fn through_init(
    link: &Link,
    config: &Config,
    segment: &Segment,
    one: &mut Traveller,
) -> Result<(), Cause> {
    esm::to_init(link, &mut one.device, config.timeouts.init).await?;
    prepare(link, config, segment, one).await?;
    finish(link, config, segment, None, one).await
}

/// Goes to OP. A SubDevice whose pulses stop on its way there waits for them, for nine seconds as a
/// rule, before it reports that; so they are verified meanwhile.
async fn to_op(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let mut pulses = device.clone();
    let change = esm::change(link, device, AlState::Op, config.timeouts.op);
    let result = match pulses.sync {
        None => change.await,
        Some(_) => {
            let mut keeping = Box::pin(keep_sync(link, config, segment, &mut pulses));
            drive_beside(change, keeping.as_mut(), &mut None).await
        }
    };
    device.sync = pulses.sync;
    result
}

/// Verifies SYNC now and then, and programs it again if there are no pulses.
async fn keep_sync(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Infallible {
    loop {
        link.sleep(SYNC_LOOK).await;
        // Whether the SubDevice gets to OP shows whether it helped.
        let _no_pulses = let_sync_run(link, config, segment, device).await.is_err();
    }
}

/// Verifies SYNC, and programs it again if there are no pulses.
async fn let_sync_run(
    link: &Link,
    config: &Config,
    segment: &Segment,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    if sync::verify(link, device).await.is_ok() {
        return Ok(());
    }
    program_sync(link, config, segment, device).await?;
    wait_for_sync(link, config, segment, device).await
}

/// Time from one look at SYNC to the next while a SubDevice is on its way to OP. Most are there
/// before the first one.
const SYNC_LOOK: Nanos = Nanos::millis(500);

/// How long an error may stay after it was acknowledged, before another attempt: five times the
/// time that descriptions usually give for the way back to SAFEOP (BackToSafeopTimeout, 200 ms).
const ACKNOWLEDGEMENT: Nanos = Nanos::millis(1_000);
