//! Brings a MainDevice up by these functions alone, and has it judged.

use std::ptr;

use ::isocat_segment::{Scenario, SegmentFile};
use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
use isocat_wire::time::{Nanos, Time};

use super::*;
use crate::device::*;
use crate::verdict::*;

/// Drives a MainDevice for `span` ns.
pub fn run(bus: *mut isocat_bus, main: &mut MainDevice, span: u64) {
    let end = now(bus) + span;
    while now(bus) < end {
        let mut buffer = [0; FRAME_LEN];
        while let Some(len) = main.poll_transmit(Time::new(now(bus)), &mut buffer) {
            done(|error| unsafe {
                isocat_bus_send(bus, 0, now(bus), buffer.as_ptr(), len, ptr::null_mut(), error)
            });
        }
        while let Some(event) = main.poll_event() {
            assert!(!matches!(event, Event::Failed(_)), "{event:?}");
        }
        let wanted = main.next_timeout().map_or(end, |at| at.count()).min(end);
        let mut next = u64::MAX;
        unsafe { isocat_bus_next_arrival(bus, &raw mut next, NOWHERE) };
        let due = next.min(wanted).max(now(bus));
        done(|error| unsafe { isocat_bus_advance(bus, due, error) });
        match receive(bus, ISOCAT_ANY_PORT) {
            Some((arrival, frame)) => main.handle_frame(Time::new(arrival.at_ns), &frame),
            None => main.handle_timeout(Time::new(due)),
        }
    }
}

pub fn main_device() -> MainDevice {
    MainDevice::new(Config::new(Nanos::millis(1)), Time::new(BEGIN))
}

pub fn summary(verdict: *const isocat_verdict) -> isocat_verdict_summary {
    let mut summary: isocat_verdict_summary = unsafe { std::mem::zeroed() };
    summary.size = size_of::<isocat_verdict_summary>();
    done(|error| unsafe { isocat_verdict_get_summary(verdict, &raw mut summary, error) });
    summary
}

pub fn verdict_of(bus: *mut isocat_bus) -> *mut isocat_verdict {
    let mut verdict = ptr::null_mut();
    done(|error| unsafe { isocat_bus_verdict(bus, &raw mut verdict, error) });
    verdict
}

fn device(verdict: *const isocat_verdict, position: usize) -> isocat_device_verdict {
    let mut device: isocat_device_verdict = unsafe { std::mem::zeroed() };
    device.size = size_of::<isocat_device_verdict>();
    done(|error| unsafe { isocat_verdict_get_device(verdict, position, &raw mut device, error) });
    device
}

/// Runs a session on the built-in segment with this seed; returns the verdict in JSON.
fn session(seed: u64) -> String {
    let mut segment = ptr::null_mut();
    done(|error| unsafe { isocat_segment_built_in(&raw mut segment, error) });
    assert_eq!(unsafe { isocat_segment_devices(segment) }, 5);
    assert_eq!(text(unsafe { isocat_segment_device_name(segment, 1) }), "AKD2G axis 2");
    assert_eq!(unsafe { isocat_segment_cycle_ns(segment) }, 1_000_000);
    done(|error| unsafe { isocat_segment_set_seed(segment, seed, error) });
    let bus = bus_of(segment);
    // It assigns the PDOs that its third drive needs.
    let config = Scenario::from(SegmentFile::built_in()).config();
    let mut main = MainDevice::new(config, Time::new(BEGIN));
    run(bus, &mut main, 2_000_000_000);
    let verdict = verdict_of(bus);
    let whole = summary(verdict);
    assert_eq!((whole.answer, whole.expected), (ISOCAT_IN_SYNC, ISOCAT_AS_EXPECTED));
    assert_eq!((whole.sessions, whole.in_op, whole.lost), (1, 5, 0));
    assert!(whole.judged_ns > 500_000_000 && whole.frames > 2_000, "{}", whole.judged_ns);
    let axis = device(verdict, 0);
    assert_eq!((text(axis.mode), text(axis.state)), ("dc-sync0".into(), "OP".into()));
    assert!(axis.sync0_edges > 500 && axis.sync0_worst_ns < 100.0, "{}", axis.sync0_worst_ns);
    assert!(axis.margins > 500 && axis.least_margin_ns > 1_000.0);
    assert_eq!((axis.findings, axis.sm_event_missed), (0, 0));
    assert!(unsafe { isocat_verdict_finding(verdict, 0, 0) }.is_null());
    let words = owned(|text, error| unsafe { isocat_verdict_text(verdict, text, error) });
    assert!(words.contains("AKD2G axis 1") && !words.contains('\u{1b}'), "{words}");
    let json = owned(|text, error| unsafe { isocat_verdict_json(verdict, text, error) });
    unsafe { isocat_verdict_free(verdict) };
    unsafe { isocat_bus_free(bus) };
    json
}

#[test]
fn a_main_device_comes_up_and_is_judged_twice_the_same() {
    let json = session(7);
    let document: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(document["format"], isocat_serve::summary::FORMAT);
    assert_eq!(session(7), json);
    assert_ne!(session(8), json, "another seed is another segment");
}

#[test]
fn before_anything_came_up_there_is_nothing_to_judge() {
    let bus = bus_of(three(""));
    assert_eq!(counted(bus, 0, BEGIN), Some((3, 0, 1)));
    let verdict = verdict_of(bus);
    let whole = summary(verdict);
    assert_eq!((whole.answer, whole.sessions, whole.in_op), (ISOCAT_NOT_KNOWN, 1, 0));
    let mut device: isocat_device_verdict = unsafe { std::mem::zeroed() };
    device.size = size_of::<isocat_device_verdict>();
    let (code, words) =
        call(|error| unsafe { isocat_verdict_get_device(verdict, 0, &raw mut device, error) });
    assert_eq!(code, isocat_code::ISOCAT_OUT_OF_RANGE, "{words}");
    unsafe { isocat_verdict_free(verdict) };
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn what_is_wrong_is_found_and_told_in_words() {
    let bus = bus_of(three("[[expect]]\nin_sync = true"));
    let mut main = main_device();
    run(bus, &mut main, 500_000_000);
    let before = verdict_of(bus);
    done(|error| unsafe { isocat_bus_fault(bus, c"al-error 1 0x8001".as_ptr(), error) });
    run(bus, &mut main, 5_000_000);
    done(|error| unsafe { isocat_bus_finish(bus, error) });
    let verdict = verdict_of(bus);
    let whole = summary(verdict);
    assert_eq!((whole.answer, whole.expected), (ISOCAT_NOT_IN_SYNC, ISOCAT_NOT_AS_EXPECTED));
    let (well, fell) = (device(verdict, 0), device(verdict, 1));
    assert_eq!((well.findings, fell.findings), (0, 1));
    let words = text(unsafe { isocat_verdict_finding(verdict, 1, 0) });
    assert!(words.contains("SAFEOP") && words.contains("0x8001"), "{words}");
    assert!(unsafe { isocat_verdict_finding(verdict, 1, 1) }.is_null());
    // A verdict belongs to its instant: later events do not change it.
    assert_eq!(summary(before).answer, ISOCAT_IN_SYNC);
    assert_eq!(device(before, 1).findings, 0);
    unsafe { isocat_bus_free(bus) };
    unsafe { isocat_verdict_free(before) };
    unsafe { isocat_verdict_free(verdict) };
}

#[test]
fn process_data_are_seen_and_set() {
    let bus = bus_of(three(""));
    let (mut buffer, mut length) = ([0; 4], 7);
    let mut outputs = |room: usize| unsafe {
        let code =
            isocat_device_outputs(bus, 1, buffer.as_mut_ptr(), room, &raw mut length, NOWHERE);
        (code, length, buffer)
    };
    assert_eq!(outputs(4), (isocat_code::ISOCAT_NOTHING, 0, [0; 4]), "no outputs before OP");
    let mut main = main_device();
    run(bus, &mut main, 500_000_000);
    main.outputs_mut(1).fill(0xA5);
    done(|error| unsafe { isocat_device_set_inputs(bus, 1, [0x5A].as_ptr(), 1, error) });
    run(bus, &mut main, 5_000_000);
    assert_eq!(outputs(3), (isocat_code::ISOCAT_TOO_SMALL, 4, [0; 4]), "how much room it takes");
    assert_eq!(outputs(4), (isocat_code::ISOCAT_OK, 4, [0xA5; 4]));
    assert_eq!(main.inputs(1)[0], 0x5A);
    done(|error| unsafe { isocat_device_release_inputs(bus, 1, error) });
    run(bus, &mut main, 5_000_000);
    assert_eq!(main.inputs(1)[0], 0xA5, "its application's: it copies its outputs");
    let size = size_of::<isocat_device_state>();
    let mut state = isocat_device_state { size, state: 0, status_code: 7 };
    done(|error| unsafe { isocat_device_get_state(bus, 1, &raw mut state, error) });
    assert_eq!((state.state, state.status_code), (8, 0));
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn faults_happen_now_and_at_their_instants() {
    let bus = bus_of(three(""));
    let fault =
        |words: &str| done(|error| unsafe { isocat_bus_fault(bus, c(words).as_ptr(), error) });
    let fault_at = |at: u64, words: &str| {
        done(|error| unsafe { isocat_bus_fault_at(bus, at, c(words).as_ptr(), error) });
    };
    fault_at(BEGIN + 1_000_000, "double 1 back");
    fault_at(BEGIN + 2_000_000, "drop 1");
    assert_eq!(counted(bus, 0, BEGIN + 800_000), Some((3, 0, 1)));
    assert_eq!(counted(bus, 0, BEGIN + 1_000_000), Some((3, 0, 2)), "at its very instant");
    assert_eq!(counted(bus, 0, BEGIN + 1_899_999), Some((3, 0, 1)));
    assert_eq!(counted(bus, 0, BEGIN + 2_000_000), None);
    fault("pull 2");
    done(|error| unsafe { isocat_bus_advance(bus, BEGIN + 500_000_000, error) });
    assert_eq!(counted(bus, 0, BEGIN + 500_000_000), Some((2, 0, 1)), "it turns at the cut");
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn a_ring_has_two_ports() {
    let segment = three("ring = true");
    assert_eq!(unsafe { isocat_segment_ports(segment) }, 2);
    let bus = bus_of(segment);
    assert_eq!(counted(bus, 0, BEGIN), Some((3, 1, 1)), "it comes out at the other end");
    assert_eq!(counted(bus, 1, BEGIN + 1_000_000), Some((0, 0, 1)), "against the order");
    done(|error| unsafe { isocat_bus_link(bus, 1, 0, error) });
    done(|error| unsafe { isocat_bus_advance(bus, BEGIN + 500_000_000, error) });
    assert_eq!(counted(bus, 0, BEGIN + 500_000_000), Some((3, 0, 1)), "it turns");
    unsafe { isocat_bus_free(bus) };
}
