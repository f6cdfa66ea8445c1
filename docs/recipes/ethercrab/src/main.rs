//! ethercrab on the segment of docs/recipes.md: SYNC0 by the plan's figures, a look whether it
//! runs, OP.
//!
//! `recipe-ethercrab INTERFACE [CYCLES]`

use std::time::{Duration, Instant};

use ethercrab::error::Error;
use ethercrab::std::{ethercat_now, tx_rx_task};
use ethercrab::subdevice_group::DcConfiguration;
use ethercrab::{Command, DcSync, MainDevice, MainDeviceConfig, PduStorage, Timeouts};

const CYCLE: Duration = Duration::from_millis(4);
/// The acting pulse of `isocat plan`: how long after the frame SYNC0 comes.
const PHASE: Duration = Duration::from_micros(2024);
/// Whose mode in the plan is dc-sync0.
const WITH_SYNC0: [usize; 2] = [0, 1];
static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

fn main() {
    let interface = std::env::args().nth(1).expect("usage: recipe-ethercrab INTERFACE [CYCLES]");
    let cycles = std::env::args().nth(2).map_or(3000, |count| count.parse().expect("a number"));
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let wire = tx_rx_task(&interface, tx, rx).expect("a raw socket on the interface");
    std::thread::spawn(move || async_io::block_on(wire));
    let timeouts = Timeouts { pdu: Duration::from_millis(50), ..Timeouts::default() };
    let main_device = MainDevice::new(pdu_loop, timeouts, MainDeviceConfig::default());
    if let Err(error) = async_io::block_on(run(&main_device, cycles)) {
        eprintln!("{error}");
        std::process::exit(1);
    }
}

async fn run(main_device: &MainDevice<'static>, cycles: u32) -> Result<(), Error> {
    // PREOP, with delays, offsets and 10 000 drift frames.
    let mut group = main_device.init_single_group::<16, 256>(ethercat_now).await?;
    let mut reference = None;
    for (at, mut device) in group.iter_mut(main_device).enumerate() {
        reference.get_or_insert(device.configured_address());
        if WITH_SYNC0.contains(&at) {
            device.set_dc_sync(DcSync::Sync0);
            // The drift loops' filters: with those of reset, 0 and 12, a loop learns its speed too
            // slowly.
            device.register_write(0x0934u16, [4u8, 6]).await?;
        }
    }
    // So the clocks converge once more.
    for _ in 0..15_000 {
        let system_time = Command::frmw(reference.unwrap_or_default(), 0x0910).ignore_wkc();
        system_time.receive::<u64>(main_device).await?;
    }
    let group = group.into_pre_op_pdi(main_device).await?;
    let plan = DcConfiguration {
        start_delay: Duration::from_millis(100),
        sync0_period: CYCLE,
        // Of the frame behind SYNC0: SYNC0 itself lies at 0 of the cycle.
        sync0_shift: CYCLE - PHASE,
    };
    let group = group.configure_dc_sync(main_device, plan).await?;
    async_io::Timer::after(Duration::from_millis(200)).await; // until after the first pulse
    for at in WITH_SYNC0 {
        let device = group.subdevice(main_device, at)?;
        let difference = device.register_read::<u32>(0x092Cu16).await? & 0x7FFF_FFFF;
        let pulse = device.register_read::<u64>(0x0990u16).await?;
        async_io::Timer::after(Duration::from_millis(10)).await;
        let runs = device.register_read::<u64>(0x0990u16).await? != pulse;
        println!("{at}: 0x092C {difference} ns, SYNC0 {}", if runs { "runs" } else { "stands" });
    }
    let group = group.into_safe_op(main_device).await?.request_into_op(main_device).await?;
    let (mut in_op, mut unanswered) = (0, 0);
    for _ in 0..cycles {
        let wait = match group.tx_rx_dc(main_device).await {
            Ok(response) => {
                in_op += u32::from(response.all_op());
                response.extra.next_cycle_wait
            }
            Err(Error::Timeout(_)) => {
                unanswered += 1;
                Duration::ZERO
            }
            Err(error) => return Err(error),
        };
        // The wait was computed when the answer came, so it counts from there.
        async_io::Timer::at(Instant::now() + wait).await;
    }
    println!("all in OP in {in_op} of {cycles} cycles, {unanswered} without an answer");
    Ok(())
}
