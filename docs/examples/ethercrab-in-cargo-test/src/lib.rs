//! The application: a gate that moves until its end switch closes. The same code runs in production
//! and in tests.

use std::time::Duration;

use ethercrab::error::Error;
use ethercrab::subdevice_group::DcConfiguration;
use ethercrab::{DcSync, MainDevice, RegisterAddress};

/// Position of the drive, and of the device with end switches and lamp.
const GATE: usize = 1;
const SWITCHES: usize = 0;
const CYCLE: Duration = Duration::from_millis(2);
/// The machine starts when its clocks are this near to the reference, ns, for so many cycles in a
/// row.
const NEAR: u32 = 500;
const SETTLED: u32 = 500;

/// Bits of that device: of its inputs, and of its outputs.
pub const END_SWITCH: u8 = 0b01;
pub const LAMP: u8 = 0b10;
/// Working counter of a whole exchange: each of the two devices counts 1 for its inputs and 2 for
/// its outputs.
const WORKING_COUNTER: u16 = 6;

/// Brings the machine to OP and runs it until the gate is open.
///
/// `now` is the host's time in nanoseconds since 2000-01-01, `sleep` how the application waits
/// where it runs.
pub async fn open_the_gate(
    main_device: MainDevice<'static>,
    now: fn() -> u64,
    sleep: impl AsyncFn(Duration),
) -> Result<(), Error> {
    let mut group = main_device.init_single_group::<8, 256>(now).await?;
    for (position, mut device) in group.iter_mut(&main_device).enumerate() {
        if position == GATE {
            device.set_dc_sync(DcSync::Sync0);
        }
    }
    let group = group.into_pre_op_pdi(&main_device).await?;
    // Drift frames go on until the clocks have converged: those that `init` sends may not be
    // enough, and a difference that goes through zero once is none that stays there.
    let mut near = 0;
    while near < SETTLED {
        group.tx_rx_sync_system_time(&main_device).await?;
        let gate = group.subdevice(&main_device, GATE)?;
        let off = gate.register_read::<u32>(RegisterAddress::DcSystemTimeDifference).await?;
        near = if off & 0x7FFF_FFFF <= NEAR { near + 1 } else { 0 };
        sleep(CYCLE).await;
    }
    let dc = DcConfiguration {
        start_delay: Duration::from_millis(100),
        sync0_period: CYCLE,
        sync0_shift: CYCLE / 2,
    };
    let group = group.configure_dc_sync(&main_device, dc).await?;
    let group = group.into_safe_op(&main_device).await?;
    let group = group.request_into_op(&main_device).await?;
    loop {
        let response = group.tx_rx_dc(&main_device).await?;
        let switches = group.subdevice(&main_device, SWITCHES)?;
        let is_open = switches.inputs_raw()[0] & END_SWITCH != 0;
        // The lamp burns while the gate moves. `all_op` alone does not see a device that no longer
        // answers.
        let is_whole = response.working_counter == WORKING_COUNTER;
        let moves = response.all_op() && is_whole && !is_open;
        switches.outputs_raw_mut()[0] = if moves { LAMP } else { 0 };
        if is_open {
            break;
        }
        sleep(response.extra.next_cycle_wait).await;
    }
    let group = group.into_safe_op(&main_device).await?;
    group.into_pre_op(&main_device).await?;
    Ok(())
}
