//! The survey: reads a segment up to PREOP, and continues past SubDevices that contradict
//! themselves.
//!
//! It uses the parts of the bring-up as far as PREOP and the clocks. An error at one SubDevice is
//! noted ([`Segment::problems`]) and ends the survey of that SubDevice only; the whole survey ends
//! only if the SubDevices cannot be counted. Nothing is written to objects, EEPROM or process data
//! registers.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use core::sync::atomic::AtomicBool;

use isocat_wire::register::{self, Register, Value};

use crate::bring_up::{self, End, Work};
use crate::config::Config;
use crate::error::{Cause, Error};
use crate::event::Stage;
use crate::hot_connect::Present;
use crate::link::{Link, Procedure};
use crate::segment::{Segment, SubDevice};
use crate::{clock, esm, hot_connect, mapping, objects, scan, sii};

/// The survey from the scan to converged clocks.
pub(crate) async fn survey(mut work: Work) -> End {
    let result = look(&mut work).await;
    work.end(result)
}

async fn look(work: &mut Work) -> Result<(), Cause> {
    bring_up::check(&work.config)?;
    let (link, config) = (work.link.clone(), work.config.clone());
    let (link, config) = (&link, &*config);
    let wish = config.survey.unwrap_or_default();
    work.enter(Stage::Scan);
    scan::find(link, config, &mut work.segment).await?;
    read_states(link, &mut work.segment).await;
    scan::address(link, &work.segment).await?;
    let mut good = vec![true; work.segment.devices.len()];
    each(work, &mut good, |device| Box::pin(describe(link, config, device))).await;
    let tree = scan::tree(&mut work.segment);
    note(work, tree);
    if hot_connect::is_short(config, &work.segment) {
        hot_connect::seat(link, config, &mut work.segment).await?;
        let there = work.segment.devices.iter().zip(&good).filter(|(_, good)| **good);
        let positions: Vec<usize> = there.map(|(device, _)| device.position).collect();
        hot_connect::fill(config, &mut work.segment);
        good = (0..work.segment.devices.len()).map(|at| positions.contains(&at)).collect();
    }

    work.enter(Stage::Sii);
    each(work, &mut good, |device| Box::pin(sii::read(link, config, device))).await;

    work.enter(Stage::PreOp);
    each(work, &mut good, |device| Box::pin(bring_up::to_preop(link, config, device))).await;

    work.enter(Stage::Objects);
    let with_mailbox =
        |device: &SubDevice| good[device.position] && wish.objects && device.has_coe();
    work.mailboxes = work
        .segment
        .devices
        .iter()
        .map(|device| bring_up::mailbox(link, config, device).filter(|_| with_mailbox(device)))
        .collect();
    read_objects(work).await;

    work.enter(Stage::Clock);
    let mut present = Present::of(&work.segment);
    let speeds = clock::measure_speeds(link, config, &mut present.0).await.map_err(Cause::from);
    let clocks = clock::synchronize(link, config, &mut present.0, &AtomicBool::new(false)).await;
    present.give_back(&mut work.segment);
    note(work, speeds);
    note(work, clocks);
    for device in work.segment.devices.iter_mut().filter(|device| device.admitted) {
        if device.dc.has_clock() {
            device.observed.correction = correction(link, device).await;
        }
        if let Ok((status, code)) = esm::read_status(link, device.station).await {
            (device.al_status, device.al_code) = (status, code);
        }
    }
    Ok(())
}

/// Reads AL status before anything is written. A lost frame leaves it unknown.
async fn read_states(link: &Link, segment: &mut Segment) {
    let address = register::AL_STATUS.address;
    let reads: Vec<_> = segment
        .devices
        .iter()
        .map(|device| link.aprd(device.position, address, esm::STATUS_LEN))
        .collect();
    for (device, read) in segment.devices.iter_mut().zip(reads) {
        let reply = read.expect(1).await.ok();
        device.observed.state_before = reply.map(|reply| esm::status_of(&reply.data));
    }
}

/// Reads the ESC information, then goes to INIT.
async fn describe(link: &Link, config: &Config, device: &mut SubDevice) -> Result<(), Cause> {
    scan::describe(link, device).await?;
    let station = device.station;
    device.observed.alias = link.try_read(station, register::STATION_ALIAS).await?;
    device.observed.pdi = link.try_read(station, register::PDI_CONTROL).await?;
    device.observed.sync_latch = link.try_read(station, register::SYNC_LATCH_CONFIGURATION).await?;
    esm::to_init(link, device, config.timeouts.init).await
}

/// Reads process data and sync objects from the device if it is asked, otherwise from its SII.
async fn read_objects(work: &mut Work) {
    let devices = work.segment.devices.iter_mut().zip(&mut work.mailboxes);
    let there = devices.filter(|(device, _)| device.admitted);
    let all = there.map(|(device, mailbox)| -> Procedure<'_, Result<Vec<Cause>, Never>> {
        Box::pin(async move {
            let mut problems = match mailbox {
                Some(mailbox) => objects::look(mailbox, device).await,
                None => {
                    objects::from_sii(device);
                    Vec::new()
                }
            };
            problems.extend(mapping::place_process_data(device).err());
            Ok(problems)
        })
    });
    let Ok(problems) = crate::link::join(all.collect()).await;
    for cause in problems.into_iter().flatten() {
        note(work, Err(cause));
    }
}

type Never = core::convert::Infallible;

/// Reads registers 0x0930 and 0x0932.
async fn correction(link: &Link, device: &SubDevice) -> Option<(u16, i16)> {
    let bytes = link.fprd(device.station, register::SPEED_COUNTER_START.address, 4);
    let bytes: [u8; 4] = *bytes.expect(1).await.ok()?.data.first_chunk()?;
    let [a, b, c, d] = bytes;
    let start: Register<u16> = register::SPEED_COUNTER_START;
    Some((start.decode(&[a, b]), i16::from_bytes([c, d])))
}

/// Runs the same procedure at all SubDevices that have not failed, concurrently, and notes new
/// failures.
async fn each<'a>(
    work: &'a mut Work,
    good: &mut [bool],
    procedure: impl Fn(&'a mut SubDevice) -> Procedure<'a, Result<(), Cause>>,
) {
    let stage = work.stage;
    let Segment { devices, problems, .. } = &mut work.segment;
    let asked: Vec<&mut SubDevice> =
        devices.iter_mut().filter(|device| good[device.position]).collect();
    let positions: Vec<usize> = asked.iter().map(|device| device.position).collect();
    let results = bring_up::settle(asked, procedure).await;
    for (position, result) in positions.into_iter().zip(results) {
        if let Err(cause) = result {
            good[position] = false;
            problems.push(Error { stage, cause });
        }
    }
}

/// Keeps what went wrong, once: open ports that make no tree are met again by the receive times.
fn note(work: &mut Work, result: Result<(), Cause>) {
    let (stage, problems) = (work.stage, &mut work.segment.problems);
    if let Some(cause) = result.err().filter(|c| problems.iter().all(|known| known.cause != *c)) {
        problems.push(Error { stage, cause });
    }
}
