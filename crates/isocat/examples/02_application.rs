//! An application of one's own on the cycle, in virtual time or on a network interface: the same
//! code.
//!
//! `cargo run --release -p isocat --example 02_application`: two I/O devices in virtual time. `sudo
//! target/release/examples/02_application eth0`: whatever is behind the interface (`isocat serve
//! --setup-veth lab` makes one).

use isocat::host::Host;
use isocat::{Nanos, NoTap, Scenario, SegmentFile};
use isocat_maindevice::{Application, Config, Cycle, Event};
use isocat_sim::World;
use isocat_wire::time::{Picos, Time};

/// Each device that has outputs gets a counter, and its inputs are compared with what they were to
/// become.
#[derive(Default)]
struct Counter {
    value: u8,
    calls: u64,
    fresh: u64,
}

impl Application for Counter {
    /// Called once a cycle, when all of its frames are back or given up. What is written here
    /// leaves with the next one.
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        self.calls += 1;
        self.value = self.value.wrapping_add(1);
        for mut device in cycle.devices() {
            self.fresh += u64::from(device.is_fresh());
            device.outputs_mut().fill(self.value);
        }
    }
}

fn main() -> isocat::host::Result<()> {
    let application = match std::env::args().nth(1) {
        None => in_virtual_time(),
        Some(interface) => on_interface(&interface)?,
    };
    let Counter { calls, fresh, .. } = application;
    println!("called in {calls} cycles, {fresh} times with fresh inputs of a device");
    assert!(calls >= 100 && fresh >= calls, "each cycle has brought inputs");
    Ok(())
}

fn in_virtual_time() -> Counter {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 2\n";
    let scenario = Scenario::from(SegmentFile::parse("two of them", text).expect("a segment"));
    let mut world = World::new(scenario.run().setup, Counter::default(), None::<NoTap>);
    let mut end = Time::ZERO + Picos::from(Nanos::millis(20_000));
    while world.step(end) {
        while let Some(event) = world.poll_event() {
            match event {
                Event::InOperation { .. } => end = world.now() + Nanos::millis(100).into(),
                Event::Failed(error) => panic!("{error}"),
                _ => {}
            }
        }
    }
    world.into_parts().0
}

fn on_interface(interface: &str) -> isocat::host::Result<Counter> {
    let config = Config::new(Nanos::millis(2));
    let mut host = Host::open(interface)?.start(config, Counter::default());
    host.until_operation()?;
    std::thread::sleep(std::time::Duration::from_millis(500));
    Ok(host.stop()?.application)
}
