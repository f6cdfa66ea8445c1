//! A MainDevice that builds its own frames, as the application of the test: isocat's own, at a
//! socket of the bus.
#![allow(dead_code, reason = "each test uses its part")]

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
use isocat_testing::{Bus, Nanos, Segment};
use isocat_wire::time::{Host, Time};

/// The stack, which the test may read while it runs.
pub type Shared = Rc<RefCell<MainDevice>>;

/// Runs the stack as an application, concurrently with the test.
pub fn start(bus: &Bus, config: Config) -> Shared {
    let main = Rc::new(RefCell::new(MainDevice::new(config, time(bus))));
    let _runs_on = bus.spawn(exchange(bus.clone(), Rc::clone(&main)));
    main
}

/// Runs the stack with a cycle of 1 ms, and waits until all devices are in OP.
pub async fn bring_up(bus: &Bus) -> Shared {
    let main = start(bus, Config::new(Nanos::millis(1)));
    bus.within(Duration::from_secs(20), |bus| bus.all_op()).await;
    main
}

async fn exchange(bus: Bus, main: Shared) {
    let socket = bus.socket();
    let mut buffer = [0; FRAME_LEN];
    loop {
        let next = {
            let mut main = main.borrow_mut();
            while let Some(len) = main.poll_transmit(time(&bus), &mut buffer) {
                socket.send(&buffer[..len]);
            }
            while let Some(event) = main.poll_event() {
                assert!(!matches!(event, Event::Failed(_)), "{event:?}");
            }
            main.next_timeout()
        };
        let left = next.map_or(Duration::MAX, |next| {
            Duration::from_nanos((next - time(&bus)).0.max(0) as u64)
        });
        match socket.receive_for(left).await {
            Some(frame) => main.borrow_mut().handle_frame(time(&bus), &frame),
            None => main.borrow_mut().handle_timeout(time(&bus)),
        }
    }
}

fn time(bus: &Bus) -> Time<Host> {
    Time::new(bus.now().as_nanos() as u64)
}

/// A segment of I/O devices.
pub fn ios(count: usize) -> Segment {
    let text =
        format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = {count}\n");
    Segment::parse(&text).expect("a segment")
}
