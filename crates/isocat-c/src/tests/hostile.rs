//! Tests invalid arguments: each returns its code, and nothing else happens.

use std::ptr::{null, null_mut};

use super::*;
use crate::application::isocat_application;
use crate::device::*;
use crate::plan::*;
use crate::verdict::*;
use isocat_code::*;

/// Larger than any object.
const HUGE: usize = 1 << 63;

#[test]
fn null_is_refused_everywhere() {
    let (segment, name) = (three(""), c("drop 1"));
    let bus = bus_of(three(""));
    let mut bytes = [0; 64];
    let (to, frame) = (bytes.as_mut_ptr(), count());
    let mut got = arrival();
    type Call<'a> = Box<dyn Fn(*mut *mut isocat_error) -> isocat_code + 'a>;
    let calls: Vec<Call<'_>> = unsafe {
        vec![
            Box::new(|e| isocat_segment_built_in(null_mut(), e)),
            Box::new(|e| isocat_segment_read(null(), &raw mut *Box::new(null_mut()), e)),
            Box::new(|e| isocat_segment_read(name.as_ptr(), null_mut(), e)),
            Box::new(|e| {
                isocat_segment_parse(null(), 1, null(), &raw mut *Box::new(null_mut()), e)
            }),
            Box::new(|e| isocat_segment_set_seed(null_mut(), 1, e)),
            Box::new(|e| isocat_segment_plug_in(null_mut(), 0, null(), e)),
            Box::new(|e| isocat_segment_plug_in(segment, 0, null(), e)),
            Box::new(|e| isocat_bus_new(null(), 0, &raw mut *Box::new(null_mut()), e)),
            Box::new(|e| isocat_bus_new(segment, 0, null_mut(), e)),
            Box::new(|e| isocat_bus_now(null(), &raw mut *Box::new(0), e)),
            Box::new(|e| isocat_bus_now(bus, null_mut(), e)),
            Box::new(|e| isocat_bus_send(null_mut(), 0, BEGIN, frame.as_ptr(), 60, null_mut(), e)),
            Box::new(|e| isocat_bus_send(bus, 0, BEGIN, null(), 60, null_mut(), e)),
            Box::new(|e| isocat_bus_next_arrival(null(), &raw mut *Box::new(0), e)),
            Box::new(|e| isocat_bus_next_timeout(null(), &raw mut *Box::new(0), e)),
            Box::new(|e| {
                isocat_bus_receive(null_mut(), 0, to, 64, &raw mut *Box::new(arrival()), e)
            }),
            Box::new(|e| isocat_bus_advance(null_mut(), BEGIN, e)),
            Box::new(|e| isocat_bus_link(null_mut(), 0, 1, e)),
            Box::new(|e| isocat_bus_fault(null_mut(), name.as_ptr(), e)),
            Box::new(|e| isocat_bus_fault(bus, null(), e)),
            Box::new(|e| isocat_bus_fault_at(null_mut(), BEGIN, name.as_ptr(), e)),
            Box::new(|e| isocat_bus_fault_at(bus, BEGIN, null(), e)),
            Box::new(|e| isocat_bus_finish(null_mut(), e)),
            Box::new(|e| isocat_bus_verdict(null_mut(), &raw mut *Box::new(null_mut()), e)),
            Box::new(|e| isocat_bus_verdict(bus, null_mut(), e)),
            Box::new(|e| isocat_device_get_state(null_mut(), 0, null_mut(), e)),
            Box::new(|e| isocat_device_get_state(bus, 0, null_mut(), e)),
            Box::new(|e| isocat_device_outputs(null_mut(), 0, to, 64, &raw mut *Box::new(0), e)),
            Box::new(|e| isocat_device_outputs(bus, 0, to, 64, null_mut(), e)),
            Box::new(|e| isocat_device_set_inputs(null_mut(), 0, to, 1, e)),
            Box::new(|e| isocat_device_set_inputs(bus, 0, null(), 1, e)),
            Box::new(|e| isocat_device_release_inputs(null_mut(), 0, e)),
            Box::new(|e| isocat_plan_new(null(), &raw mut *Box::new(null_mut()), e)),
            Box::new(|e| isocat_plan_get_summary(null(), null_mut(), e)),
            Box::new(|e| isocat_plan_get_line(null(), 0, null_mut(), e)),
            Box::new(|e| isocat_plan_get_device(null(), 0, null_mut(), e)),
            Box::new(|e| isocat_plan_json(null(), null_mut(), e)),
            Box::new(|e| isocat_verdict_get_summary(null(), null_mut(), e)),
            Box::new(|e| isocat_verdict_get_device(null(), 0, null_mut(), e)),
            Box::new(|e| isocat_verdict_text(null(), null_mut(), e)),
            Box::new(|e| isocat_verdict_json(null(), null_mut(), e)),
        ]
    };
    for (number, work) in calls.iter().enumerate() {
        let (code, words) = call(work);
        assert_eq!(code, ISOCAT_NULL_ARGUMENT, "call {number}: {words}");
        assert!(words.contains("is NULL; expected"), "call {number}: {words}");
        // The call is refused without a place for the error, too.
        assert_eq!(work(null_mut()), ISOCAT_NULL_ARGUMENT, "call {number}");
    }
    drop(calls);
    // An answer remains if its caller passes no place for it.
    assert_eq!(unsafe { isocat_bus_next_arrival(bus, null_mut(), NOWHERE) }, ISOCAT_NOTHING);
    done(|e| unsafe { isocat_bus_send(bus, 0, BEGIN, frame.as_ptr(), 60, null_mut(), e) });
    done(|e| unsafe { isocat_bus_advance(bus, BEGIN + 100_000, e) });
    let (code, _) = call(|e| unsafe { isocat_bus_next_arrival(bus, null_mut(), e) });
    assert_eq!(code, ISOCAT_NULL_ARGUMENT);
    for (buffer, place) in [(null_mut(), &raw mut got), (to, null_mut())] {
        let (code, _) = call(|e| unsafe { isocat_bus_receive(bus, 0, buffer, 64, place, e) });
        assert_eq!(code, ISOCAT_NULL_ARGUMENT);
    }
    assert!(receive(bus, 0).is_some());
    unsafe { isocat_bus_free(bus) };
    unsafe { isocat_segment_free(segment) };
}

#[test]
fn null_is_nothing_to_free_or_to_ask() {
    unsafe {
        isocat_segment_free(null_mut());
        isocat_bus_free(null_mut());
        isocat_plan_free(null_mut());
        isocat_verdict_free(null_mut());
        isocat_error_free(null_mut());
        isocat_text_free(null_mut());
        assert_eq!(isocat_segment_devices(null()), 0);
        assert!(isocat_segment_device_name(null(), 0).is_null());
        assert_eq!((isocat_segment_cycle_ns(null()), isocat_segment_ports(null())), (0, 0));
        assert_eq!(isocat_error_code(null()), ISOCAT_OK);
        assert!(isocat_error_text(null()).is_null() && isocat_error_file(null()).is_null());
        assert_eq!((isocat_error_line(null()), isocat_error_column(null())), (0, 0));
        assert!(isocat_verdict_finding(null(), 0, 0).is_null());
    }
    assert_eq!(text(isocat_version()), env!("CARGO_PKG_VERSION"));
    assert_eq!(isocat_abi_version(), ISOCAT_ABI_VERSION);
}

fn parsed(text: &[u8], length: usize) -> (isocat_code, String) {
    let mut segment = null_mut();
    let parsed = call(|error| unsafe {
        isocat_segment_parse(text.as_ptr(), length, c"a test".as_ptr(), &raw mut segment, error)
    });
    assert!(segment.is_null());
    parsed
}

#[test]
fn texts_that_are_none_are_refused_with_their_place() {
    let (code, words) = parsed(b"cycle = \xFF", 9);
    assert_eq!(code, ISOCAT_NOT_UTF8);
    assert!(words.contains("byte 8 is 0xFF") && words.contains("expected"), "{words}");
    // The length is checked before the text is read: no text is that long.
    for length in [HUGE, usize::MAX, (16 << 20) + 1] {
        let (code, words) = parsed(b"", length);
        assert_eq!(code, ISOCAT_OUT_OF_RANGE);
        assert!(words.contains(&length.to_string()) && words.contains("16777216"), "{words}");
    }
    assert_eq!(parsed(b"", 0).0, ISOCAT_BAD_INPUT, "no device");
    let mut segment = null_mut();
    let not_utf8 = c"\xFF.toml";
    let (code, _) =
        call(|error| unsafe { isocat_segment_read(not_utf8.as_ptr(), &raw mut segment, error) });
    assert_eq!(code, ISOCAT_NOT_UTF8);
    let (code, words) = call(|error| unsafe {
        isocat_segment_read(c"/nowhere/a.toml".as_ptr(), &raw mut segment, error)
    });
    assert_eq!(code, ISOCAT_BAD_INPUT);
    assert!(words.contains("/nowhere/a.toml"), "{words}");
    assert!(segment.is_null());
}

#[test]
fn an_error_of_a_file_has_its_place() {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io5\"\n";
    let (mut segment, mut error) = (null_mut(), null_mut());
    let code = unsafe {
        let (from, length) = (text.as_ptr(), text.len());
        isocat_segment_parse(from, length, null(), &raw mut segment, &raw mut error)
    };
    assert_eq!(code, ISOCAT_BAD_INPUT);
    assert_eq!(super::text(unsafe { isocat_error_file(error) }), "segment");
    assert_eq!(unsafe { (isocat_error_line(error), isocat_error_column(error)) }, (3, 10));
    let words = super::text(unsafe { isocat_error_text(error) });
    assert!(words.starts_with("segment:3:10: ") && words.contains("simple_io"), "{words}");
    unsafe { isocat_error_free(error) };
}

fn send(bus: *mut isocat_bus, port: u32, at: u64, length: usize) -> (isocat_code, String) {
    let frame = vec![0; length.min(4096)];
    call(|e| unsafe { isocat_bus_send(bus, port, at, frame.as_ptr(), length, null_mut(), e) })
}

#[test]
fn lengths_ports_and_positions_have_bounds() {
    let bus = bus_of(three(""));
    for length in [0, 13, ISOCAT_LONGEST_FRAME + 1, HUGE, usize::MAX] {
        let (code, words) = send(bus, 0, BEGIN, length);
        assert_eq!(code, ISOCAT_OUT_OF_RANGE, "{length}: {words}");
        assert!(words.contains(&length.to_string()) && words.contains("1514"), "{words}");
    }
    for length in [14, ISOCAT_LONGEST_FRAME] {
        assert_eq!(send(bus, 0, BEGIN, length).0, ISOCAT_OK);
    }
    for port in [1, 2, u32::MAX] {
        assert_eq!(send(bus, port, BEGIN, 60).0, ISOCAT_OUT_OF_RANGE, "this is no ring");
        let (code, _) = call(|e| unsafe { isocat_bus_link(bus, port, 1, e) });
        assert_eq!(code, ISOCAT_OUT_OF_RANGE);
    }
    let (mut bytes, mut length, mut got) = ([0; 4], 0, arrival());
    let (to, place) = (bytes.as_mut_ptr(), &raw mut got);
    assert_eq!(
        call(|e| unsafe { isocat_bus_receive(bus, 2, to, 4, place, e) }).0,
        ISOCAT_OUT_OF_RANGE
    );
    for position in [3, HUGE, usize::MAX] {
        let codes = unsafe {
            [
                call(|e| isocat_device_outputs(bus, position, to, 4, &raw mut length, e)),
                call(|e| isocat_device_set_inputs(bus, position, to, 1, e)),
                call(|e| isocat_device_release_inputs(bus, position, e)),
                call(|e| isocat_device_get_state(bus, position, null_mut(), e)),
            ]
        };
        for (code, words) in codes {
            assert_eq!(code, ISOCAT_OUT_OF_RANGE);
            assert!(words.contains("expected 0 to 2"), "{words}");
        }
    }
    for length in [5, HUGE, usize::MAX] {
        let (code, _) = call(|e| unsafe { isocat_device_set_inputs(bus, 0, to, length, e) });
        assert_eq!(code, ISOCAT_OUT_OF_RANGE, "it has 4 bytes");
    }
    done(|e| unsafe { isocat_device_set_inputs(bus, 0, to, 4, e) });
    done(|e| unsafe { isocat_device_set_inputs(bus, 0, null(), 0, e) });
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn an_answer_stays_where_the_room_is_too_small() {
    let bus = bus_of(three(""));
    let frame = count();
    done(|e| unsafe { isocat_bus_send(bus, 0, BEGIN, frame.as_ptr(), 60, null_mut(), e) });
    done(|e| unsafe { isocat_bus_advance(bus, BEGIN + 100_000, e) });
    let (mut buffer, mut got) = ([7; 60], arrival());
    for room in [0, 59] {
        let to = if room == 0 { null_mut() } else { buffer.as_mut_ptr() };
        let (code, words) =
            call(|e| unsafe { isocat_bus_receive(bus, 0, to, room, &raw mut got, e) });
        assert_eq!((code, got.length), (ISOCAT_TOO_SMALL, 60), "{words}");
        assert_eq!(buffer, [7; 60]);
    }
    let to = buffer.as_mut_ptr();
    done(|e| unsafe { isocat_bus_receive(bus, 0, to, usize::MAX, &raw mut got, e) });
    assert_eq!((buffer[28], receive(bus, 0).is_none()), (3, true));
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn time_goes_on_and_not_too_far() {
    let bus = bus_of(three(""));
    let advance = |to: u64| call(|e| unsafe { isocat_bus_advance(bus, to, e) });
    let hour = 3_600_000_000_000;
    assert_eq!(advance(BEGIN).0, ISOCAT_OK, "to the present");
    for to in [BEGIN - 1, 0, BEGIN + hour + 1, 1 << 63, u64::MAX] {
        let (code, words) = advance(to);
        assert_eq!(code, ISOCAT_TIME, "{to}");
        assert!(words.contains(&to.to_string()) && words.contains("expected"), "{words}");
    }
    assert_eq!(send(bus, 0, BEGIN - 1, 60).0, ISOCAT_TIME);
    assert_eq!(now(bus), BEGIN, "nothing happened");
    assert_eq!(advance(BEGIN + hour).0, ISOCAT_OK);
    assert_eq!(now(bus), BEGIN + hour);
    let fault =
        |at: u64| call(|e| unsafe { isocat_bus_fault_at(bus, at, c"drop 1".as_ptr(), e) }).0;
    let month = 30 * 24 * hour;
    assert_eq!((fault(BEGIN + hour - 1), fault(BEGIN + hour)), (ISOCAT_TIME, ISOCAT_OK));
    assert_eq!((fault(BEGIN + month), fault(BEGIN + month + 1)), (ISOCAT_OK, ISOCAT_TIME));
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn a_bus_begins_where_its_clock_has_room() {
    let segment = three("");
    let month = 30 * 24 * 3_600_000_000_000;
    let latest = (1 << 63) - 1 - month;
    let begin = |at: u64| {
        let mut bus = null_mut();
        let (code, _) = call(|e| unsafe { isocat_bus_new(segment, at, &raw mut bus, e) });
        if code == ISOCAT_OK {
            assert_eq!(counted(bus, 0, at), Some((3, 0, 1)), "it lives");
        }
        unsafe { isocat_bus_free(bus) };
        code
    };
    assert_eq!([begin(0), begin(latest)], [ISOCAT_OK; 2]);
    assert_eq!([begin(latest + 1), begin(u64::MAX)], [ISOCAT_TIME; 2]);
    unsafe { isocat_segment_free(segment) };
}

#[test]
fn faults_that_are_none_are_refused() {
    let bus = bus_of(three(""));
    for (words, hint) in [
        ("", "unknown fault"),
        ("drip 3", "drop"),
        ("drop", "expected"),
        ("drop -1", "expected"),
        ("pull 3", "3"),
        ("pull ring", "ring"),
        ("stall 20ms", "not simulated"),
        ("drop 1\nheal", "expected"),
    ] {
        let (code, said) = call(|e| unsafe { isocat_bus_fault(bus, c(words).as_ptr(), e) });
        assert_eq!(code, ISOCAT_BAD_INPUT, "{words}");
        assert!(said.contains(hint), "{words}: {said}");
        let at = |e| unsafe { isocat_bus_fault_at(bus, BEGIN, c(words).as_ptr(), e) };
        assert_eq!(call(at), (code, said));
    }
    let (code, _) = call(|e| unsafe { isocat_bus_fault(bus, c"drop \xC3".as_ptr(), e) });
    assert_eq!(code, ISOCAT_NOT_UTF8);
    unsafe { isocat_bus_free(bus) };
}

#[test]
fn structs_have_the_size_that_their_caller_knows() {
    /// The struct of a program that is newer than the library.
    #[repr(C)]
    struct Newer {
        known: isocat_device_state,
        unknown: [u64; 2],
        behind: u64,
    }
    let bus = bus_of(three(""));
    let own = size_of::<isocat_device_state>();
    let known = isocat_device_state { size: own + 16, state: 7, status_code: 7 };
    let mut newer = Newer { known, unknown: [7; 2], behind: 7 };
    let place = (&raw mut newer).cast();
    done(|e| unsafe { isocat_device_get_state(bus, 0, place, e) });
    assert_eq!((newer.known.size, newer.known.state, newer.known.status_code), (own + 16, 1, 0));
    assert_eq!((newer.unknown, newer.behind), ([0; 2], 7), "zeros, and nothing behind them");
    for size in [0, 8, own - 1, 4097, HUGE, usize::MAX] {
        newer.known.size = size;
        let place = (&raw mut newer).cast();
        let (code, words) = call(|e| unsafe { isocat_device_get_state(bus, 0, place, e) });
        assert_eq!(code, ISOCAT_STRUCT_SIZE, "{size}");
        assert!(words.contains("isocat_device_state.size") && words.contains("sizeof"), "{words}");
    }
    // A frame is not sent if its result can't be returned.
    let mut sent = isocat_sent { size: 0, back_ns: 0, comes_back: 0, port: 0 };
    let frame = count();
    let (code, _) = call(|e| unsafe {
        isocat_bus_send(bus, 0, BEGIN + 5, frame.as_ptr(), 60, &raw mut sent, e)
    });
    assert_eq!((code, now(bus)), (ISOCAT_STRUCT_SIZE, BEGIN));
    unsafe { isocat_bus_free(bus) };

    let segment = three("");
    let mut application: isocat_application = unsafe { std::mem::zeroed() };
    let plug = |application: &isocat_application, position| {
        let application = &raw const *application;
        call(|e| unsafe { isocat_segment_plug_in(segment, position, application, e) }).0
    };
    assert_eq!(plug(&application, 0), ISOCAT_STRUCT_SIZE);
    application.size = size_of::<isocat_application>();
    assert_eq!(plug(&application, 3), ISOCAT_OUT_OF_RANGE);
    assert_eq!(plug(&application, 2), ISOCAT_OK, "one that does nothing");
    unsafe { isocat_bus_free(bus_of(segment)) };
}

#[test]
fn a_panic_is_a_code_and_breaks_its_handle_alone() {
    let (broken, other) = (bus_of(three("")), bus_of(three("")));
    let (code, words) = call(|error| {
        guard(error, || isocat_bus::with(broken, |_| -> Result<(), _> { panic!("a fault") }))
    });
    assert_eq!(code, ISOCAT_PANIC);
    assert!(words.contains("a fault"), "{words}");
    let (code, words) = call(|e| unsafe { isocat_bus_advance(broken, BEGIN, e) });
    assert_eq!(code, ISOCAT_PANIC, "{words}");
    unsafe { isocat_bus_free(broken) };
    done(|e| unsafe { isocat_bus_advance(other, BEGIN + 1, e) });
    unsafe { isocat_bus_free(other) };
}

#[test]
fn a_handle_in_use_is_busy() {
    let bus = bus_of(three(""));
    let inside = |e| {
        guard(e, || {
            isocat_bus::with(bus, |_| {
                let (code, words) = call(|e| unsafe { isocat_bus_advance(bus, BEGIN, e) });
                assert_eq!(code, ISOCAT_BUSY, "{words}");
                unsafe { isocat_bus_free(bus) };
                Ok(())
            })
        })
    };
    done(inside);
    done(|e| unsafe { isocat_bus_advance(bus, BEGIN, e) });
    unsafe { isocat_bus_free(bus) };
}
