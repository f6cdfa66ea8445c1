//! The core of the served segment without sockets: an external MainDevice in virtual time, and
//! devices with applications of the test.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::line::Line;
use isocat_maindevice::Event;
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::Setup;
use isocat_subdevice::Application;
use isocat_wire::time::Nanos;

fn scenario(count: usize) -> Scenario {
    let text =
        format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = {count}\n");
    Scenario::from(SegmentFile::parse("a test", &text).expect("a segment"))
}

#[test]
fn a_foreign_main_device_comes_inbring_up_and_is_judged() {
    let mut line = Line::new(&scenario(3));
    line.bring_up();
    assert!(!line.run(Nanos::millis(500), |_| false));
    assert!(line.server.session().is_some_and(|session| session.is_judged()));
    let judged = line.server.judged().expect("judged");
    assert_eq!(judged.devices_in_op, 3);
    assert!(judged.in_sync(), "{judged:?}");
}

#[test]
fn a_server_may_do_without_process_data() {
    let mut line = Line::new(Setup::from(&scenario(2)).without_process_data());
    line.bring_up();
    line.main.outputs_mut(1).fill(0x11);
    line.server.set_inputs(1, Some(&[0x22]));
    line.run(Nanos::millis(5), |_| false);
    assert_eq!(line.server.outputs(1), None);
    // The profile's application copies its outputs.
    assert_eq!(line.main.inputs(1)[0], 0x11);
}

#[test]
fn process_data_are_seen_and_set() {
    let mut line = Line::new(&scenario(3));
    assert_eq!(line.server.outputs(1), None, "no outputs before OP");
    line.bring_up();
    let len = line.main.outputs_mut(1).len();
    line.main.outputs_mut(1).fill(0xA5);
    line.server.set_inputs(1, Some(&[0x5A]));
    line.run(Nanos::millis(5), |_| false);
    assert_eq!(line.server.outputs(1), Some(vec![0xA5; len]));
    assert_eq!(line.main.inputs(1)[0], 0x5A, "the caller's");
    // The profile's application copies its outputs; bytes that were not set are still its own.
    assert_eq!(line.main.inputs(1)[1..], vec![0xA5; len - 1], "the application's");
    assert_eq!(line.main.inputs(0)[0], 0, "no other device's");
    line.server.set_inputs(1, None);
    line.run(Nanos::millis(5), |_| false);
    assert_eq!(line.main.inputs(1)[0], 0xA5, "given back");
    line.main.stop();
    assert!(line.run(Nanos::millis(5_000), |event| matches!(event, Event::Stopped)));
    assert_eq!(line.server.outputs(1), None, "safe outputs");
    assert_eq!(line.server.outputs(3), None, "no such device");
}

/// An application of the test: it counts its steps, and its input is its last output plus one.
struct PlusOne {
    steps: Arc<AtomicU32>,
    value: u8,
}

impl Application for PlusOne {
    fn map_outputs(&mut self, outputs: &[u8]) {
        self.value = outputs[0];
        self.steps.fetch_add(1, Ordering::Relaxed);
    }

    fn map_inputs(&mut self, inputs: &mut [u8]) {
        inputs[0] = self.value.wrapping_add(1);
    }
}

#[test]
fn a_device_has_the_callers_application() {
    let steps = Arc::new(AtomicU32::new(0));
    let own = PlusOne { steps: steps.clone(), value: 0 };
    let mut line = Line::new(Setup::from(&scenario(2)).with_application(1, own));
    line.bring_up();
    line.main.outputs_mut(1)[0] = 41;
    line.run(Nanos::millis(5), |_| false);
    assert_eq!(line.main.inputs(1)[0], 42);
    assert!(steps.load(Ordering::Relaxed) >= 4, "once a cycle");
    assert_eq!(line.server.outputs(1).map(|outputs| outputs[0]), Some(41));
}
