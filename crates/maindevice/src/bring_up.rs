//! The bring-up, in three pieces. Between them the machine starts the cyclic exchange and the
//! process data.
//!
//! [`prepare`] needs no cycle: it goes from the scan to the plan. Then the machine sends the drift
//! datagram in every cycle and locks the host onto the reference clock. [`synchronize`] programs
//! SYNC and goes to SAFEOP. Then process data run, and [`operate`] goes to OP once the types of
//! synchronization are verified, the data are complete and SYNC is verified. [`stop`] leads back to
//! INIT.

use alloc::boxed::Box;
use alloc::sync::Arc;
use alloc::vec::Vec;
use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering};

use isocat_sync::phase::Direction;
use isocat_sync::phase::drive::Limits;
use isocat_wire::al::{AlControl, AlState};
use isocat_wire::dc::SyncActivation;
use isocat_wire::register::{self, Value};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;

use crate::board::Board;
use crate::config::{Config, DeviceConfig, MeasureTimes, QualityWatch, WATCHDOG_TICK};
use crate::error::{Cause, Error};
use crate::event::{Event, Stage};
use crate::hot_connect::Present;
use crate::left_out::{self, Failures, each, leave_out};
use crate::link::{Link, Procedure, drive_beside, join};
use crate::mailbox::{Mailbox, Mailboxes};
use crate::objects::Template;
use crate::segment::{Segment, SubDevice};
use crate::{clock, delay, esm, mapping, mode, objects, ring, scan, sii, soe, sync, timing};

/// What a piece of the bring-up works on. It is returned on success and on failure.
pub(crate) struct Work {
    pub link: Link,
    pub config: Arc<Config>,
    pub segment: Segment,
    pub mailboxes: Mailboxes,
    pub stage: Stage,
}

/// The result of a piece.
pub(crate) type End = (Work, Result<(), Error>);

impl Work {
    pub(crate) fn enter(&mut self, stage: Stage) {
        self.stage = stage;
        self.link.report(Event::Progress(stage));
    }

    pub(crate) fn end(self, result: Result<(), Cause>) -> End {
        let result = result.map_err(|cause| Error { stage: self.stage, cause });
        (self, result)
    }
}

/// From the scan to the plan.
pub(crate) async fn prepare(mut work: Work) -> End {
    let result = preparation(&mut work).await;
    work.end(result)
}

/// Programs SYNC and goes to SAFEOP.
pub(crate) async fn synchronize(mut work: Work) -> End {
    let result = synchronization(&mut work).await;
    work.end(result)
}

/// Verifies the types of synchronization, waits for complete process data, verifies SYNC, and goes
/// to OP.
pub(crate) async fn operate(mut work: Work) -> End {
    let result = operation(&mut work).await;
    if matches!(result, Err(Cause::Refused { .. } | Cause::StateTimeout { .. })) {
        let all = work.segment.devices.iter_mut().zip(&mut work.mailboxes);
        for (device, mailbox) in all {
            if let Some(mailbox) = mailbox {
                objects::refresh_counters(mailbox, device).await;
            }
        }
    }
    work.end(result)
}

async fn preparation(work: &mut Work) -> Result<(), Cause> {
    check(&work.config)?;
    let (link, config) = (work.link.clone(), work.config.clone());
    let (link, config) = (&link, &*config);
    work.enter(Stage::Scan);
    scan::scan(link, config, &mut work.segment).await?;

    work.enter(Stage::Sii);
    let failures = read_sii(link, config, &mut work.segment).await?;
    leave_out(work, failures).await;

    work.enter(Stage::PreOp);
    let failures =
        each(config, &mut work.segment, |device| Box::pin(to_preop(link, config, device))).await?;
    leave_out(work, failures).await;
    let mailbox = |device: &SubDevice| mailbox(link, config, device).filter(|_| device.admitted);
    work.mailboxes = work.segment.devices.iter().map(mailbox).collect();

    work.enter(Stage::Objects);
    // Those that were left out pass frames on, and their clocks count with the others.
    let is_there = |device: &SubDevice| device.admitted || device.left_out.is_some();
    let mut present = Present::among(&work.segment, is_there);
    // Delays and drift need frames at intervals, and mailboxes need the wire in between. Only a
    // latch that waits until nothing else is in flight can't be made meanwhile.
    let is_quiet = delay::stations(&present.0).are_quiet();
    let beside = AtomicBool::new(true);
    let clocks = clock::synchronize(link, config, &mut present.0, &beside);
    let mut clocks = Box::pin(clocks);
    let mut in_sync = None;
    let objects = objects::read_all(work);
    let failures = match is_quiet {
        true => objects.await?,
        false => drive_beside(objects, clocks.as_mut(), &mut in_sync).await?,
    };
    leave_out(work, failures).await;

    let is_known = |device: &SubDevice| {
        let wish = config.devices.get(device.position);
        device.left_out.is_none() || wish.is_some_and(DeviceConfig::may_be_absent)
    };
    let absent = |device: &&mut SubDevice| !device.admitted && is_known(device);
    work.segment.devices.iter_mut().filter(absent).try_for_each(mapping::place_as_known)?;

    work.enter(Stage::Mode);
    for device in work.segment.devices.iter_mut().filter(|device| is_known(device)) {
        let wish = config.devices.get(device.position);
        mode::choose(device, config, wish)?;
    }

    work.enter(Stage::Mapping);
    work.segment.image = mapping::lay_out(&mut work.segment.devices)?;
    let failures = each(config, &mut work.segment, |device| {
        Box::pin(mapping::write(link, device, config.watchdog_of(device.position)))
    })
    .await?;
    leave_out(work, failures).await;

    work.enter(Stage::Clock);
    beside.store(false, Ordering::Relaxed);
    match in_sync {
        Some(result) => result?,
        None => clocks.as_mut().await?,
    }
    drop(clocks);
    present.give_clocks(&mut work.segment);

    work.enter(Stage::Plan);
    work.segment.timing = Some(timing::plan(&work.segment, config)?);
    Ok(())
}

/// Longest cycle in which a reference clock is controlled. Clocks 200 ppm apart stay within 0.3 us
/// at 2 ms, but differ by 1 us at 4 ms.
const LONGEST_LED_CYCLE: Nanos = Nanos(2_000_000);

/// Settings that make no sense are refused before anything is sent.
pub(crate) fn check(config: &Config) -> Result<(), Cause> {
    let cycle = config.cycle;
    // SYNC0's cycle register has 32 bits, and a 32-bit clock must tell past from future.
    if cycle.0 <= 0 || cycle.0 > i64::from(i32::MAX) {
        return Err(Cause::Setting { name: "cycle", expected: "above 0 and below 2.147 s" });
    }
    // Beyond half a cycle nobody can tell a late frame from an early one of the next cycle.
    if config.host_jitter.0 < 0 || config.host_jitter.0 >= cycle.0 / 2 {
        return Err(Cause::Setting {
            name: "host_jitter",
            expected: "0 or more, below half a cycle",
        });
    }
    // What the servo takes for a lock must be small against the cycle.
    if config.stamp_noise.0 < 0 || config.stamp_noise.0 > cycle.0 / 20 {
        return Err(Cause::Setting {
            name: "stamp_noise",
            expected: "0 or more, at most a twentieth of the cycle",
        });
    }
    let (limits, source) = match config.direction {
        Direction::FollowReference => (None, None),
        Direction::DriveReference { limits } => (Some(limits), None),
        Direction::External { limits, source } => (Some(limits), Some(source)),
    };
    let is_bad = |limits: Limits| {
        limits.slew_ppb <= 0 || limits.acceleration_ppb <= 0 || limits.most <= Nanos::ZERO
    };
    if limits.is_some_and(is_bad) || source.is_some_and(|source| source.interval <= Nanos::ZERO) {
        return Err(Cause::Setting { name: "direction", expected: "limits and interval above 0" });
    }
    // With a reference that is steered, drift loops follow what they are told less and less often.
    if limits.is_some() && cycle > LONGEST_LED_CYCLE {
        return Err(Cause::Setting {
            name: "cycle",
            expected: "2 ms at most if the reference clock is to be led (direction)",
        });
    }
    if limits.is_some() && !config.drift_compensation {
        return Err(Cause::Setting {
            name: "direction",
            expected: "drift compensation, if the reference clock is to be led",
        });
    }
    if config.shift.is_some_and(|shift| shift.0 < 0 || shift >= cycle) {
        return Err(Cause::Setting { name: "shift", expected: "at least 0 and below the cycle" });
    }
    let ticks = |time: Nanos| (time.0 % WATCHDOG_TICK.0 == 0).then_some(time.0 / WATCHDOG_TICK.0);
    let range = 1..=i64::from(u16::MAX);
    if config.watchdog.is_some_and(|time| !ticks(time).is_some_and(|n| range.contains(&n))) {
        return Err(Cause::Setting {
            name: "watchdog",
            expected: "whole 100 us, from 100 us to 6.5535 s",
        });
    }
    if config.delay_watch.is_some_and(|watch| watch.every < cycle || watch.latches < 2) {
        return Err(Cause::Setting {
            name: "delay_watch",
            expected: "at least a cycle from latch to latch, at least 2 latches",
        });
    }
    let share = 1..=200;
    let sound = |watch: QualityWatch| {
        share.contains(&watch.share_permille)
            && watch.history >= 16
            && watch.unled_cycles > 0
            && watch.difference_limit.0 > 0
    };
    if config.quality.is_some_and(|watch| !sound(watch)) {
        return Err(Cause::Setting {
            name: "quality",
            expected: "a share of 1 to 200 permille, 16 readings or more, limits above 0",
        });
    }
    if config.devices.first().is_some_and(DeviceConfig::may_be_absent) {
        return Err(Cause::Setting {
            name: "hot_connect",
            expected: "not at the first SubDevice, behind which all others are",
        });
    }
    let alone = config.survey.is_none()
        && config.delay_watch.is_none()
        && !config.devices.iter().any(DeviceConfig::may_be_absent)
        && config.direction == Direction::FollowReference;
    if config.ring.is_some_and(|ring| !alone || ring.patience.is_some_and(|time| time.0 <= 0)) {
        return Err(Cause::Setting {
            name: "ring",
            expected: "a patience above 0, without survey, delay_watch, hot_connect and a direction",
        });
    }
    let sound = |wish: MeasureTimes| wish.settled > Nanos::ZERO && wish.longest >= wish.settled;
    if config.measure_times.is_some_and(|wish| !sound(wish)) {
        return Err(Cause::Setting {
            name: "measure_times",
            expected: "a time to settle above 0, and no shorter longest time",
        });
    }
    if !(1..=90).contains(&config.acyclic_share) {
        return Err(Cause::Setting { name: "acyclic_share", expected: "1 to 90 percent" });
    }
    Ok(())
}

/// Writes the configured objects in PREOP, and reads the mapping and the synchronization objects.
pub(crate) async fn read_objects(
    mut mailbox: Option<&mut Mailbox>,
    device: &mut SubDevice,
    wish: Option<&DeviceConfig>,
    template: Option<&Template>,
) -> Result<(), Cause> {
    match &mut mailbox {
        Some(mailbox) if device.has_coe() => objects::read(mailbox, device, wish, template).await?,
        _ => objects::from_sii(device),
    }
    soe::start_up(mailbox, device, wish).await
}

/// Sets up the mailbox SyncManagers and goes to PREOP.
pub(crate) async fn to_preop(
    link: &Link,
    config: &Config,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    for (address, data) in mailbox_writes(device) {
        link.fpwr(device.station, address, &data).expect(1).await?;
    }
    esm::change(link, device, AlState::PreOp, config.timeouts.preop).await
}

/// The SyncManagers of the mailbox: address and bytes, in order.
pub(crate) fn mailbox_writes(device: &SubDevice) -> Vec<(u16, Vec<u8>)> {
    if !device.has_mailbox() {
        return Vec::new();
    }
    let (receive, send) = sii::mailbox_areas(&device.sii.header);
    let managers = [
        SyncManager::new(receive.start, receive.length, SyncManager::MAILBOX_OUT, true),
        SyncManager::new(send.start, send.length, SyncManager::MAILBOX_IN, true),
    ];
    let write = |(number, manager): (usize, SyncManager)| {
        (register::sync_manager(number).address, manager.to_bytes().to_vec())
    };
    managers.into_iter().enumerate().map(write).collect()
}

pub(crate) fn mailbox(link: &Link, config: &Config, device: &SubDevice) -> Option<Mailbox> {
    let areas = sii::mailbox_areas(&device.sii.header);
    let patience = config.timeouts.mailbox;
    let speaks = device.has_coe() || device.has_soe();
    speaks.then(|| Mailbox::new(link, device.position, device.station, areas, patience))
}

async fn synchronization(work: &mut Work) -> Result<(), Cause> {
    let (link, config) = (work.link.clone(), work.config.clone());
    let (link, config) = (&link, &*config);
    work.enter(Stage::Sync);
    let failures = each_with_mailbox(work, |device, mailbox| {
        Box::pin(async move {
            let Some(mailbox) = mailbox.filter(|_| device.has_coe()) else { return Ok(()) };
            let wish = config.devices.get(device.position);
            sync::write_types(mailbox, device, config, wish).await
        })
    })
    .await?;
    leave_out(work, failures).await;
    let phase = work.segment.timing.as_ref().and_then(|timing| timing.sync0);
    let failures =
        each(config, &mut work.segment, |device| Box::pin(sync::program_unit(link, device)))
            .await?;
    leave_out(work, failures).await;
    if let (Some(phase), Some(reference)) = (phase, work.segment.reference) {
        let whole = config.timeouts.sync_lead;
        let short = sync::short_lead(&work.segment).min(whole);
        start_sync(work, reference, phase, short).await?;
        // A host that stalled meanwhile gets a second try.
        if short < whole && !sync_is_ahead(link, &work.segment, reference).await? {
            start_sync(work, reference, phase, whole).await?;
        }
    }

    work.enter(Stage::SafeOp);
    let patience = config.timeouts.safeop;
    let failures = each(config, &mut work.segment, |device| {
        Box::pin(esm::change(link, device, AlState::SafeOp, patience))
    })
    .await?;
    leave_out(work, failures).await;
    Ok(())
}

/// Programs all SYNC units: their pulses begin when `lead` has passed.
async fn start_sync(
    work: &mut Work,
    reference: usize,
    phase: Nanos,
    lead: Nanos,
) -> Result<(), Cause> {
    let (link, config) = (work.link.clone(), work.config.clone());
    let (link, config) = (&link, &*config);
    let now = sync::reference_now(link, &work.segment.devices[reference]).await?;
    // The acting pulses of all devices lie on one grid, so on the same points of it at all of them.
    let common = sync::grid(&work.segment, config.cycle);
    let failures = each(config, &mut work.segment, |device| {
        Box::pin(async move {
            if !device.mode.uses_dc() {
                return Ok(());
            }
            let grid = common.unwrap_or(sync::own_grid(device, config.cycle));
            sync::program(link, device, grid.start(now, lead, phase)).await
        })
    })
    .await?;
    leave_out(work, failures).await;
    Ok(())
}

/// Whether all first pulses are still to come.
async fn sync_is_ahead(link: &Link, segment: &Segment, reference: usize) -> Result<bool, Cause> {
    let now = sync::reference_now(link, &segment.devices[reference]).await?;
    Ok(segment.devices.iter().filter_map(|device| device.sync).all(|setting| setting.start > now))
}

async fn operation(work: &mut Work) -> Result<(), Cause> {
    let (link, config) = (work.link.clone(), work.config.clone());
    let (link, config) = (&link, &*config);
    // Meanwhile process data become complete, and the first SYNC0 comes.
    let failures = each_with_mailbox(work, |device, mailbox| {
        Box::pin(async move {
            let Some(mailbox) = mailbox.filter(|_| device.has_coe()) else { return Ok(()) };
            let wish = config.devices.get(device.position);
            sync::verify_types(mailbox, device, wish).await
        })
    })
    .await?;
    leave_out(work, failures).await;

    work.enter(Stage::Op);
    let begin = link.board(|board| board.cycle);
    // So many exchanges of the slowest too.
    let slowest = work.segment.image.chunks.iter().map(|chunk| chunk.every).max().unwrap_or(1);
    let needed = COMPLETE_CYCLES * u64::from(slowest);
    let longer = Nanos(config.cycle.0 * (needed - COMPLETE_CYCLES) as i64);
    let due = link.now() + config.timeouts.safeop + longer;
    let complete = |board: &Board| board.complete_cycles >= needed;
    let has_data = !work.segment.image.chunks.is_empty();
    if has_data && !link.wait_for(due, complete).await {
        let ((expected, found), cycles) =
            link.board(|board| (board.incomplete, board.cycle - begin));
        return Err(Cause::ProcessData { cycles, expected, found });
    }
    let synced = work.segment.devices.iter().any(|device| device.sync.is_some());
    if synced {
        // One cycle behind the first pulse it can be seen whether more come.
        wait_for_sync(link, config, &work.segment).await?;
        let failures =
            each(config, &mut work.segment, |device| Box::pin(sync::verify(link, device))).await?;
        leave_out(work, failures).await;
    }
    let patience = config.timeouts.op;
    let failures = each(config, &mut work.segment, |device| {
        Box::pin(esm::change(link, device, AlState::Op, patience))
    })
    .await?;
    leave_out(work, failures).await;
    ring::open(link).await
}

/// Waits until the first pulse must have happened.
async fn wait_for_sync(link: &Link, config: &Config, segment: &Segment) -> Result<(), Cause> {
    let Some(reference) = segment.reference else { return Ok(()) };
    let starts = segment.devices.iter().filter_map(|device| device.sync);
    let Some(start) = starts.map(|setting| setting.start).max() else { return Ok(()) };
    let reference = &segment.devices[reference];
    let now = sync::system_time(link, reference.station).await?;
    let now = match reference.dc {
        crate::segment::DcCapability::Clock64 => now,
        _ => start.nearest(now.count() as u32),
    };
    // However far off the clock now says that it is: what pulses there are is seen behind this.
    let most = config.timeouts.sync_lead + LONGEST_GRID + LONGEST_GRID;
    let left = start - now + config.cycle;
    link.sleep(left.clamp(Nanos::ZERO, most)).await;
    Ok(())
}

/// Longest period of a pulse grid. The first pulse may come one period after its lead time.
const LONGEST_GRID: Nanos = Nanos(i32::MAX as i64);

/// Takes all SubDevices to SAFEOP, which ends the outputs. SubDevices that refuse or do not answer
/// do not delay the others.
pub(crate) async fn leave_operation(mut work: Work) -> End {
    work.enter(Stage::Stop);
    let (link, config) = (work.link.clone(), work.config.clone());
    let patience = config.timeouts.init;
    let results = settle(&mut work.segment.devices, |device| {
        Box::pin(step_down(&link, device, AlState::SafeOp, patience))
    })
    .await;
    work.end(results.into_iter().collect())
}

/// Goes to PREOP, switches SYNC off, and goes to INIT.
pub(crate) async fn stop(mut work: Work) -> End {
    work.stage = Stage::Stop;
    let (link, config) = (work.link.clone(), work.config.clone());
    let patience = config.timeouts.init;
    let preop = settle(&mut work.segment.devices, |device| {
        Box::pin(step_down(&link, device, AlState::PreOp, patience))
    })
    .await;
    if work.segment.devices.is_empty() {
        // Stopped before the scan was through: whoever is there.
        let init = AlControl::request_and_acknowledge(AlState::Init).to_bytes();
        if let Err(error) = link.bwr(register::AL_CONTROL.address, &init).reply().await {
            return work.end(Err(error.into()));
        }
    }
    let off = SyncActivation(0).to_bytes();
    let sync = link.bwr(register::SYNC_ACTIVATION.address, &off).reply().await;
    let silent: Vec<_> =
        preop.iter().map(|result| matches!(result, Err(Cause::Access(_)))).collect();
    let init = settle(&mut work.segment.devices, |device| {
        let wish = config.devices.get(device.position);
        if !device.admitted && wish.is_some_and(DeviceConfig::may_be_absent) {
            return Box::pin(async { Ok(()) });
        }
        // One that did not answer a moment ago is asked once, and not waited for.
        let answers = device.admitted && !silent[device.position];
        let patience = if answers { patience } else { Nanos::ZERO };
        Box::pin(esm::change(&link, device, AlState::Init, patience))
    })
    .await;
    let sync = sync.map(|_| ()).map_err(Cause::from);
    let opened = ring::open(&link).await;
    work.end(preop.into_iter().chain([sync]).chain(init).chain([opened]).collect())
}

/// Restores the ring as it was found, after a failed bring-up.
pub(crate) async fn open_ring(work: Work) -> End {
    let result = ring::open(&work.link).await;
    work.end(result)
}

/// Takes a SubDevice one state down, if it is in a higher state.
pub(crate) async fn step_down(
    link: &Link,
    device: &mut SubDevice,
    state: AlState,
    patience: Nanos,
) -> Result<(), Cause> {
    if !device.admitted {
        return Ok(());
    }
    let (status, code) = esm::read_status(link, device.station).await?;
    (device.al_status, device.al_code) = (status, code);
    let above = status.state().is_ok_and(|now| now as u8 > state as u8);
    // With an error pending only INIT is left, which acknowledges it.
    if !above || status.error() {
        return Ok(());
    }
    esm::change(link, device, state, patience).await
}

/// Runs the same procedure at all SubDevices concurrently, and waits for all of them.
pub(crate) async fn settle<'a>(
    devices: impl IntoIterator<Item = &'a mut SubDevice>,
    procedure: impl Fn(&'a mut SubDevice) -> Procedure<'a, Result<(), Cause>>,
) -> Vec<Result<(), Cause>> {
    let all: Vec<Procedure<'a, Result<Result<(), Cause>, Infallible>>> = devices
        .into_iter()
        .map(|device| {
            let one = procedure(device);
            Box::pin(async move { Ok(one.await) }) as Procedure<'a, _>
        })
        .collect();
    let Ok(results) = join(all).await;
    results
}

/// As [`each`], with the mailbox of the SubDevice.
pub(crate) async fn each_with_mailbox<'a>(
    work: &'a mut Work,
    procedure: impl Fn(&'a mut SubDevice, Option<&'a mut Mailbox>) -> Procedure<'a, Result<(), Cause>>,
) -> Result<Failures, Cause> {
    let Work { segment, mailboxes, config, .. } = work;
    let there = segment.devices.iter_mut().zip(mailboxes).filter(|(device, _)| device.admitted);
    let mut positions = Vec::new();
    let all: Vec<_> = there
        .map(|(device, mailbox)| {
            positions.push(device.position);
            procedure(device, mailbox.as_mut())
        })
        .collect();
    left_out::each_of(config, positions, all).await
}

/// Reads the SII of all SubDevices. Equal ones are read only once, if that is allowed.
async fn read_sii(link: &Link, config: &Config, segment: &mut Segment) -> Result<Failures, Cause> {
    if !config.share_sii {
        return each(config, segment, |device| Box::pin(sii::read(link, config, device))).await;
    }
    sii::read_all(link, config, segment).await
}

/// Cycles in a row in which all process data must count right before OP is asked for: inputs are
/// put into their buffers by the application of the device, which may be some cycles late.
pub(crate) const COMPLETE_CYCLES: u64 = 10;
