//! A bring-up that continues without the SubDevices that fail.
//!
//! A SubDevice that may fail ([`Config::tolerate`], [`DeviceConfig::hot_connect`]) and does so is
//! [`left out`](leave_out): it stays in INIT, without SYNC and process data. Its ESC still passes
//! frames and its clock gets the reference's time, because otherwise the working counter of the
//! drift datagram would be wrong.

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::convert::Infallible;

use isocat_wire::al::AlState;
use isocat_wire::register;

use crate::board::Wish;
use crate::bring_up::{Work, settle};
use crate::config::{Config, DeviceConfig};
use crate::error::{AccessProblem, Cause, Error};
use crate::event::Stage;
use crate::link::{Link, Procedure, join};
use crate::segment::{ProcessData, Segment, SubDevice};
use crate::{esm, scan};

/// Failures of SubDevices that may fail, with their positions.
pub(crate) type Failures = Vec<(usize, Cause)>;

/// Runs the same procedure at all SubDevices that take part, concurrently. The first error ends it,
/// unless the SubDevice may fail: then the others continue to their end.
pub(crate) async fn each<'a>(
    config: &Config,
    segment: &'a mut Segment,
    procedure: impl Fn(&'a mut SubDevice) -> Procedure<'a, Result<(), Cause>>,
) -> Result<Failures, Cause> {
    let mut positions = Vec::new();
    let there = segment.devices.iter_mut().filter(|device| device.admitted);
    let all: Vec<_> = there
        .map(|device| {
            positions.push(device.position);
            procedure(device)
        })
        .collect();
    each_of(config, positions, all).await
}

/// The same with given procedures, each for a position.
pub(crate) async fn each_of<'a>(
    config: &Config,
    positions: Vec<usize>,
    procedures: Vec<Procedure<'a, Result<(), Cause>>>,
) -> Result<Failures, Cause> {
    if !positions.iter().any(|position| may_fail(config, *position)) {
        return join(procedures).await.map(|_| Failures::new());
    }
    let to_its_end = |procedure: Procedure<'a, Result<(), Cause>>| -> Procedure<'a, _> {
        Box::pin(async move { Ok::<_, Infallible>(procedure.await) })
    };
    let Ok(results) = join(procedures.into_iter().map(to_its_end).collect()).await;
    sort(config, positions.into_iter().zip(results))
}

/// Separates the failures of SubDevices that may fail; the first other error is returned.
fn sort(
    config: &Config,
    results: impl IntoIterator<Item = (usize, Result<(), Cause>)>,
) -> Result<Failures, Cause> {
    let mut failures = Failures::new();
    for (position, result) in results {
        match result {
            Ok(()) => {}
            Err(cause) if may_fail(config, position) && !is_lost(&cause) => {
                failures.push((position, cause));
            }
            Err(cause) => return Err(cause),
        }
    }
    Ok(failures)
}

/// Whether the bring-up continues without the SubDevice at a position.
fn may_fail(config: &Config, position: usize) -> bool {
    config.tolerate || config.devices.get(position).is_some_and(DeviceConfig::may_be_absent)
}

/// Whether frames were lost, for which no single SubDevice is responsible.
fn is_lost(cause: &Cause) -> bool {
    matches!(cause, Cause::Access(error) if error.problem == AccessProblem::Lost)
}

/// Leaves out the SubDevices that failed: INIT, SYNC off, no process data. Errors of this are
/// ignored.
pub(crate) async fn leave_out(work: &mut Work, failures: Failures) {
    let (stage, link, config) = (work.stage, work.link.clone(), work.config.clone());
    let positions: Vec<usize> = failures.iter().map(|(position, _)| *position).collect();
    for (position, cause) in failures {
        let device = &mut work.segment.devices[position];
        device.admitted = false;
        device.sync = None;
        device.left_out = Some(Box::new(Error { stage, cause }));
        // The process image keeps the place of SubDevices that it was laid out with.
        if stage < Stage::Mapping {
            be_as_known(device, config.devices.get(position));
        }
        if let Some(mailbox) = work.mailboxes.get_mut(position) {
            *mailbox = None;
        }
        link.board(|board| board.wishes.push_back(Wish::LeaveOut(position)));
    }
    let out = |device: &&mut SubDevice| positions.contains(&device.position);
    let devices = work.segment.devices.iter_mut().filter(out);
    let (link, patience) = (&link, config.timeouts.init);
    // It has failed already: another failure changes nothing for the others.
    let _ends = settle(devices, |device| Box::pin(take_down(link, device, patience))).await;
}

/// Sets it as configured, if a configuration describes it; otherwise without process data.
fn be_as_known(device: &mut SubDevice, wish: Option<&DeviceConfig>) {
    (device.outputs, device.inputs) = (ProcessData::default(), ProcessData::default());
    (device.output_sync, device.input_sync) = (None, None);
    if let Some(known) = wish.and_then(|wish| wish.hot_connect.as_ref()) {
        (device.outputs, device.inputs) = (known.outputs.clone(), known.inputs.clone());
        device.output_sync.clone_from(&known.output_sync);
        device.input_sync.clone_from(&known.input_sync);
        device.sii.clone_from(&known.sii);
        device.sm_types.clone_from(&known.sm_types);
    }
}

async fn take_down(
    link: &Link,
    device: &mut SubDevice,
    patience: isocat_wire::time::Nanos,
) -> Result<(), Cause> {
    link.fpwr(device.station, register::SYNC_ACTIVATION.address, &[0]).reply().await?;
    let init = esm::change(link, device, AlState::Init, patience).await;
    // Its SyncManagers and FMMUs then no longer answer to the process data of the others.
    scan::reset_one(link, device.station).await?;
    init
}
