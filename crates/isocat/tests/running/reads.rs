//! Memory of a SubDevice that is read while the segment runs, when nothing else is to be done.

use isocat::{NoTap, Scenario, SegmentFile};
use isocat_maindevice::Event;
use isocat_sim::World;
use isocat_wire::register::AL_STATUS;
use isocat_wire::time::{Picos, Time};

#[test]
fn a_read_is_answered_though_no_device_has_a_mailbox() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 2\n";
    let scenario = Scenario::from(SegmentFile::parse("test.toml", text).expect("it is right"));
    let mut world = World::new(scenario.run().setup, (), None::<NoTap>);
    let operating = |event: &Event| matches!(event, Event::InOperation { .. });
    let limit = Time::ZERO + Picos(60_000_000_000_000);
    while !std::iter::from_fn(|| world.poll_event()).any(|event| operating(&event)) {
        assert!(world.step(limit), "it comes to OP");
    }
    // Some cycles later everything is quiet.
    let quiet = world.now() + Picos(20_000_000_000);
    while world.step(quiet) {}
    let asked = world.main_mut().read_memory(1, AL_STATUS.address, 2);
    let patience = world.now() + Picos(10_000_000_000);
    let mut answer = None;
    while answer.is_none() && world.step(patience) {
        while let Some(event) = world.poll_event() {
            if let Event::Read { request, result } = event {
                assert_eq!(request, asked);
                answer = Some(result);
            }
        }
    }
    let bytes = answer.expect("within ten cycles").expect("it is there");
    assert_eq!(bytes, [8, 0], "OP");
}
