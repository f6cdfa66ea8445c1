//! The way back of SubDevices while something else goes wrong: one before them answers and can't be
//! taken up, the way of frames changes meanwhile, something was under way in their mailbox. Judged
//! in true time.

use crate::field::*;
use isocat_maindevice::{Cause, Event};
use isocat_wire::ObjectAddress;
use isocat_wire::time::Picos;

/// A segment, where these lines happen at these milliseconds of operation.
fn with(segment: &str, faults: &[(u32, &str)]) -> String {
    let mut text = segment.to_owned();
    for (at, what) in faults {
        text += &format!("[[fault]]\nat = \"in-operation + {at}ms\"\nwhat = \"{what}\"\n");
    }
    text
}

/// The third one answers again and never comes to PREOP. Frames pass it all the same, and so does
/// the delay of the fourth.
#[test]
fn a_delay_counts_those_that_answer_and_are_not_taken_up() {
    let faults = [(60, "misbehave third refused-state PREOP"), (80, "power-cycle third 100ms")];
    let mut field = Field::up(&with(LINE, &faults), |_| {});
    let before = field.world.main().segment().devices[3].delay;
    let back = field.until(60_000, readmitted(3));
    field.run(500);
    let refused = |event: &Event| matches!(event, Event::NotReadmitted { position: 2, .. });
    assert!(field.count(refused) > 0 && field.count(readmitted(2)) == 0);
    let (worst, edges) = field.worst_edge(3, back);
    let delay = field.world.main().segment().devices[3].delay;
    println!("delay {before:?}, {delay:?}; {worst} ps in {edges} edges");
    assert!(worst < FRESH && edges > 400, "{worst} ps in {edges} edges");
}

/// The fourth one is asked for an object when its power is gone and the MainDevice has not noticed:
/// the request, which is written again and again, ends with the loss. It is not written into the
/// mailbox of the SubDevice that is back, whose answers are for its way back.
#[test]
fn what_is_under_way_in_a_mailbox_ends_with_its_subdevice() {
    let mut field = Field::up(LINE, |_| {});
    let off = field.soon();
    field.world.segment_mut().power_off(3, off);
    field.world.segment_mut().power_on(3, off + Picos(100 * MS.0));
    while field.world.step(off) {
        field.take_events();
    }
    let object = ObjectAddress::new(0x1C32, 0x0B);
    let request = field.world.main_mut().upload(3, object);
    let is_answer =
        |event: &Event| matches!(event, Event::Uploaded { request: of, .. } if *of == request);
    field.until(5, |event| matches!(event, Event::Lost { position: 3, .. }));
    field.run(2);
    assert_eq!(field.count(is_answer), 1, "{:#?}", field.told());
    let refused = |event: &Event| matches!(event, Event::Uploaded { result: Err(_), .. });
    assert_eq!(field.count(refused), 1);
    let lost = field.world.now();
    let back = field.until(60_000, readmitted(3));
    println!("{} ms", (back - lost).0 / MS.0);
    // As without any request: see the first test of `changes.rs`.
    assert!((back - lost).0 / MS.0 < 3_000, "{} ms", (back - lost).0 / MS.0);
}

/// While the last of one branch comes back, the other branch is cut off, which makes its way
/// shorter by 3 us: right when its delay is measured, within the cycles behind that, while its
/// clock is led, or just before it is in OP. Its delay is measured anew, or set right with those of
/// the others.
#[test]
fn a_way_that_changes_meanwhile_is_measured_anew() {
    let mut anew = 0;
    for cut in (590..606).chain((700..1_000).step_by(100)).chain(1_074..1_086) {
        let faults = [(60, "power-cycle 4 100ms"), (cut, "pull left for 2s")];
        let mut field = Field::up(&with(TREE, &faults), |_| {});
        let back = field.until(60_000, readmitted(4));
        field.run(300);
        let (worst, edges) = field.worst_edge(4, back);
        assert!(worst < FRESH && edges > 250, "cut at {cut} ms: {worst} ps in {edges} edges");
        anew += field.count(|event| {
            matches!(event, Event::NotReadmitted { cause: Cause::WayChanged { .. }, .. })
        });
    }
    assert!(anew >= 10, "{anew}: the way changed while it came back");
}
