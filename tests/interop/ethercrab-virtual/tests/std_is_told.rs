//! An ethercrab with its feature `std` waits for the machine's clock: that is told, and is no hang.
//! `cargo test --features std`.
#![cfg(feature = "std")]

use std::time::Duration;

use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use isocat_testing::{Segment, ethercat_now, ethercrab_tx_rx_task, run};

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

#[test]
#[should_panic(expected = "it was built with its feature `std`")]
fn ethercrab_with_std_is_told() {
    let _ = run(Segment::built_in(), async |bus| {
        let (tx, rx, pdu_loop) = STORAGE.try_split().expect("it is split once");
        let _runs_on = bus.spawn(ethercrab_tx_rx_task!(bus, tx, rx));
        let main_device =
            MainDevice::new(pdu_loop, Timeouts::default(), MainDeviceConfig::default());
        let found = main_device.init_single_group::<16, 16>(ethercat_now).await;
        bus.sleep(Duration::from_secs(1)).await;
        panic!("it found {} devices", found.expect("a group").len());
    });
}
