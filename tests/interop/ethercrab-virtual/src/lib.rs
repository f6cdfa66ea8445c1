//! An application on ethercrab: drives with SYNC0, brought to OP and kept there.
#![no_std]

use core::time::Duration;

use ethercrab::error::Error;
use ethercrab::subdevice_group::{CycleInfo, DcConfiguration, HasDc, Op, PreOpPdi, TxRxResponse};
use ethercrab::{DcSync, DefaultLock, MainDevice, RegisterAddress, SubDeviceGroup};

pub const MAX_SUBDEVICES: usize = 16;
pub const MAX_PDI: usize = 1024;
/// The drives and what hangs on them, in OP.
pub type Group = SubDeviceGroup<MAX_SUBDEVICES, MAX_PDI, DefaultLock, Op, HasDc>;
/// What came back with a cycle's frame.
pub type Response = TxRxResponse<MAX_SUBDEVICES, CycleInfo>;

/// What the machine does each cycle, and how the application waits for the next one.
pub struct Job<S, C> {
    pub cycle: Duration,
    /// Drift frames go on in PREOP until no clock is further from the reference than this, ns.
    /// `None`: those that ethercrab sends by itself have to do.
    pub clocks_within: Option<u32>,
    pub sleep: S,
    /// Called behind each exchange; false ends the job.
    pub each_cycle: C,
    /// Host time, ns since 2000-01-01.
    pub now: fn() -> u64,
}

/// Brings all devices to OP, and exchanges process data until the job is done.
///
/// A cycle whose frame is lost is left out. Devices that leave OP are brought back.
pub async fn operate<S, C>(
    main_device: &MainDevice<'static>,
    mut job: Job<S, C>,
) -> Result<(), Error>
where
    S: AsyncFn(Duration),
    C: FnMut(&Group, &MainDevice<'static>, Option<&Response>) -> bool,
{
    let mut group = main_device.init_single_group::<MAX_SUBDEVICES, MAX_PDI>(job.now).await?;
    for mut device in group.iter_mut(main_device) {
        if is_drive(device.name()) {
            device.set_dc_sync(DcSync::Sync0);
        }
        if device.name() == ASSIGNS_NOTHING {
            for (index, object) in [(0x1C12, 0x1600u16), (0x1C13, 0x1A00)] {
                device.sdo_write(index, 0, 0u8).await?;
                device.sdo_write(index, 1, object).await?;
                device.sdo_write(index, 0, 1u8).await?;
            }
        }
    }
    let group = group.into_pre_op_pdi(main_device).await?;
    for device in group.iter(main_device).filter(|device| device.name() == ASSIGNS_NOTHING) {
        // Its SII says that both SyncManagers are disabled, and ethercrab obeys.
        for activation in [0x0816u16, 0x081E] {
            device.register_write(activation, 1u8).await?;
        }
    }
    if let Some(limit) = job.clocks_within {
        while furthest_clock(main_device, &group).await? > limit {
            for _ in 0..25 {
                group.tx_rx_sync_system_time(main_device).await?;
                (job.sleep)(job.cycle).await;
            }
        }
    }
    let dc = DcConfiguration {
        start_delay: Duration::from_millis(100),
        sync0_period: job.cycle,
        sync0_shift: job.cycle / 2,
    };
    let group = group.configure_dc_sync(main_device, dc).await?;
    let group = group.into_safe_op(main_device).await?;
    let group = group.request_into_op(main_device).await?;
    for number in 0u64.. {
        let response = match group.tx_rx_dc(main_device).await {
            Ok(response) => Some(response),
            Err(Error::Timeout(_)) => None,
            Err(error) => return Err(error),
        };
        let came = (job.now)();
        if !(job.each_cycle)(&group, main_device, response.as_ref()) {
            break;
        }
        let fell = response.as_ref().is_some_and(|response| !response.all_op());
        if fell && number % 10 == 9 {
            recover(main_device, &group).await?;
        }
        // The wait counts from the answer, whatever was done since then.
        let wait = response.map_or(job.cycle, |response| response.extra.next_cycle_wait);
        let spent = Duration::from_nanos((job.now)() - came);
        (job.sleep)(wait.saturating_sub(spent)).await;
    }
    Ok(())
}

/// How far the drives' clocks are from the reference clock at most, ns: register 0x092C, whose
/// highest bit is the sign.
async fn furthest_clock(
    main_device: &MainDevice<'static>,
    group: &SubDeviceGroup<MAX_SUBDEVICES, MAX_PDI, DefaultLock, PreOpPdi>,
) -> Result<u32, Error> {
    let mut furthest = 0;
    for device in group.iter(main_device).filter(|device| is_drive(device.name())) {
        let difference =
            device.register_read::<u32>(RegisterAddress::DcSystemTimeDifference).await?;
        furthest = furthest.max(difference & 0x7FFF_FFFF);
    }
    Ok(furthest)
}

/// Of a device of the built-in segment that maps no PDO by default.
const ASSIGNS_NOTHING: &str = "ECAT_CIA402";

fn is_drive(name: &str) -> bool {
    name.starts_with("AKD") || name == ASSIGNS_NOTHING
}

/// Brings back devices that left OP, a step a call. A device that lost its power stays away.
async fn recover(main_device: &MainDevice<'static>, group: &Group) -> Result<(), Error> {
    for device in group.iter(main_device) {
        let status = match device.register_read::<u16>(RegisterAddress::AlStatus).await {
            Ok(status) => status,
            // It does not answer.
            Err(Error::WorkingCounter { .. } | Error::Timeout(_)) => continue,
            Err(error) => return Err(error),
        };
        let control: u16 = match status & 0x1F {
            0x14 => 0x14,
            0x04 => 0x08,
            _ => continue,
        };
        device.register_write(RegisterAddress::AlControl, control).await?;
    }
    Ok(())
}
