//! `cargo virtual`: the application on a virtual machine, in virtual time.
#![cfg(not(feature = "std"))]

use std::time::Duration;

use ethercrab::{MainDevice, MainDeviceConfig, PduStorage, Timeouts};
use gate_controller::{END_SWITCH, LAMP, open_the_gate};
use isocat_testing::{Bus, Segment, ethercat_now, ethercrab_tx_rx_task, run, seeds};

const MS: Duration = Duration::from_millis(1);
const MINUTE: Duration = Duration::from_secs(60);

/// What `main` does in production, at the virtual segment.
async fn application(bus: Bus) {
    // Each run needs storage of its own, and ethercrab wants it for the life of the process.
    let storage: &'static PduStorage<16, { PduStorage::element_size(1100) }> =
        Box::leak(Box::new(PduStorage::new()));
    let (tx, rx, pdu_loop) = storage.try_split().expect("it is split once");
    let frames = ethercrab_tx_rx_task!(bus, tx, rx);
    let _runs_on = bus.spawn(async { frames.await.expect("frames are sent and received") });
    let main_device = MainDevice::new(pdu_loop, Timeouts::default(), MainDeviceConfig::default());
    let sleep = async |time| bus.host_sleep(time).await;
    open_the_gate(main_device, ethercat_now, sleep).await.expect("the gate opens");
}

fn machine() -> Segment {
    Segment::file("machine.toml").unwrap_or_else(|error| panic!("{error}"))
}

fn lamp_burns(bus: &Bus) -> bool {
    bus.device("switches").outputs().is_some_and(|outputs| outputs[0] == LAMP)
}

#[test]
fn the_gate_moves_until_its_switch_closes() {
    let verdict = run(machine(), async |bus| {
        let application = bus.spawn(application(bus.clone()));
        bus.within(2 * MINUTE, lamp_burns).await;
        // The test is the machine: after three seconds the gate is open.
        bus.sleep(Duration::from_secs(3)).await;
        assert!(lamp_burns(&bus), "it moves all the time");
        bus.device("switches").set_inputs(&[END_SWITCH]);
        bus.within(10 * MS, |bus| !lamp_burns(bus)).await;
        application.await;
    });
    assert!(verdict.in_sync(), "{verdict}");
}

#[test]
fn a_late_host_keeps_the_drive_in_sync() {
    seeds(0..10, |seed| {
        let segment = machine().seed(seed).lateness(200 * Duration::from_micros(1));
        let verdict = run(segment, async |bus| {
            let _runs_on = bus.spawn(application(bus.clone()));
            bus.within(2 * MINUTE, lamp_burns).await;
            bus.sleep(Duration::from_secs(1)).await;
            assert!(lamp_burns(&bus), "seed {seed}");
        });
        assert!(verdict.in_sync(), "{verdict}");
    });
}

#[test]
fn the_lamp_goes_out_when_the_drive_has_no_power() {
    let _ = run(machine(), async |bus| {
        let _runs_on = bus.spawn(application(bus.clone()));
        bus.within(2 * MINUTE, lamp_burns).await;
        bus.sleep(Duration::from_secs(1)).await;
        assert!(lamp_burns(&bus));
        bus.fault("power-off gate");
        bus.within(100 * MS, |bus| !lamp_burns(bus)).await;
    });
}
