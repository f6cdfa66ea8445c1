//! Production: a network interface, the machine's clock. `gate-controller eth0`
#![cfg(feature = "std")]

use std::time::Duration;

use ethercrab::std::{ethercat_now, tx_rx_task};
use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use gate_controller::open_the_gate;

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

fn main() {
    let interface = std::env::args().nth(1).expect("usage: gate-controller INTERFACE");
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("it is split once");
    let frames = tx_rx_task(&interface, tx, rx).expect("a network interface");
    std::thread::spawn(|| async_io::block_on(frames).expect("frames are sent and received"));
    let main_device = MainDevice::new(pdu_loop, Timeouts::default(), MainDeviceConfig::default());
    let sleep = async |time: Duration| {
        async_io::Timer::after(time).await;
    };
    async_io::block_on(open_the_gate(main_device, ethercat_now, sleep)).expect("the gate opens");
}
