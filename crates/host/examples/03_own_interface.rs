//! A MainDevice on a network interface, with `isocat-host` alone: it starts up, runs an application
//! in the cycle, reads an object meanwhile, and shuts down.
//!
//! `sudo target/release/examples/03_own_interface eth0 [CPU]`, with SubDevices behind `eth0`; ends
//! after 2 s or by Ctrl-C. Without hardware, `isocat serve --setup-veth lab` gives a segment: see
//! `tests/interop/examples.sh`.

use std::time::{Duration, Instant};

use isocat_host::{Application, Config, Cycle, Host, Nanos, ObjectAddress};

/// Each SubDevice gets its inputs back as outputs.
#[derive(Default)]
struct Copy {
    calls: u64,
    stale: u64,
}

impl Application for Copy {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        self.calls += 1;
        for mut device in cycle.devices() {
            match device.is_fresh() {
                true => device.copy_inputs_to_outputs(),
                // The frame was lost or late: the outputs stay as they are.
                false => self.stale += u64::from(!device.inputs().is_empty()),
            }
        }
    }
}

fn main() -> isocat_host::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let interface = arguments.next().expect("usage: 03_own_interface INTERFACE [CPU]");
    let mut host = Host::open(&interface)?;
    if let Some(cpu) = arguments.next().and_then(|cpu| cpu.parse().ok()) {
        host = host.pinned(cpu);
    }
    let mut host = host.start(Config::new(Nanos::millis(2)), Copy::default());

    let segment = host.until_operation()?;
    for device in &segment.devices {
        println!("{} {} {}: {}", device.position, device.station, device.name, device.mode);
    }
    for device in segment.devices.iter().filter(|device| device.output_sync.is_some()) {
        let missed = host.upload(device.position, ObjectAddress::new(0x1C32, 0x0B))?;
        println!("SubDevice {}: SM events missed: {missed:?}", device.position);
    }
    let end = Instant::now() + Duration::from_secs(2);
    while let Some(left) = end.checked_duration_since(Instant::now()) {
        if let Some(event) = host.event(left)? {
            println!("{event:?}");
        }
    }
    let ended = host.stop()?;
    println!("{} cycles, stale inputs {}", ended.application.calls, ended.application.stale);
    println!("{} frames sent, {} lost", ended.statistics.frames_sent, ended.statistics.frames_lost);
    Ok(())
}
