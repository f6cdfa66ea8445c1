//! Captures of segments whose devices have cycles of several lengths, without their file: healthy
//! ones, and such with one late, lost or left-out frame.

use std::time::Duration;

use isocat::capture::Capture;
use isocat::diagnose::report::VerdictKind;
use isocat::diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat::reading::Reading;
use isocat::{Scenario, SegmentFile};
use isocat_wire::Command;

/// The capture of a run, and whether the run was in sync. `slower`: each drive's cycle in cycles of
/// the bus, which are of 1 ms.
fn ran(slower: &[u32], fault: &str) -> (Vec<u8>, bool) {
    let mut text = "cycle = \"1ms\"\nfor = \"500ms\"\n".to_owned();
    for times in slower {
        text += "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n";
        if *times > 1 {
            text += &format!("cycle = \"{times}ms\"\n");
        }
    }
    if !fault.is_empty() {
        text += &format!("[[fault]]\nat = \"in-operation + 200ms\"\nwhat = \"{fault}\"\n");
    }
    captured(&text)
}

/// The capture of a run of this file, and whether the run was in sync.
fn captured(text: &str) -> (Vec<u8>, bool) {
    let file = SegmentFile::parse("rhythms.toml", text).expect("a segment");
    let mut capture = Vec::new();
    let tap = Capture::new(&mut capture).expect("a Vec takes everything");
    let outcome = Scenario::from(file).run().execute(Some(tap), &mut |_| {});
    let in_sync = outcome.in_sync();
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    (capture, in_sync)
}

fn diagnosed(capture: &[u8]) -> DiagnoseReport {
    let mut diagnosis = Diagnosis::new();
    diagnosis.read("rhythms.pcapng", capture).expect("a capture");
    diagnosis.report(&Names::default()).expect("EtherCAT")
}

/// The capture with other stamps, made of the number of the frame and its stamp, in the order of
/// the frames.
fn stamped(capture: &[u8], stamp: impl Fn(u64, Duration) -> Duration) -> Vec<u8> {
    let mut other = Capture::new(Vec::new()).expect("a Vec takes everything");
    let mut last = Duration::ZERO;
    for frame in Reading::of(capture).expect("a capture").frames {
        last = last.max(stamp(frame.number as u64, frame.at));
        other.write(last, frame.sent == Some(true), &frame.bytes);
    }
    other.finish().expect("a Vec takes everything")
}

/// A drive that nobody gave SYNC0, beside one of its kind that has it: said, and no fault. An I/O
/// is of another kind.
#[test]
fn a_drive_without_sync0_beside_its_like_is_told() {
    let told = |modes: [&str; 2]| {
        let drive =
            |mode| format!("[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmode = \"{mode}\"\n");
        let io = "[[subdevice]]\ndevice = \"simple_io16\"\n";
        let text = format!("cycle = \"1ms\"\nfor = \"200ms\"\n{}{io}", modes.map(drive).concat());
        let capture = captured(&text).0;
        let report = diagnosed(&capture);
        assert_eq!(report.verdict.kind, VerdictKind::InSync, "{}", report.text());
        let left_out = report.findings.iter().filter(|one| one.kind == "sync0-left-out");
        left_out.map(|one| one.device).collect::<Vec<_>>()
    };
    assert_eq!(told(["dc-sync0", "sm"]), [Some(1)]);
    assert_eq!(told(["sm", "dc-sync0"]), [Some(0)]);
    assert_eq!(told(["dc-sync0", "dc-sync0"]), []);
}

/// Drives with a cycle of their own have frames of their own, of which some hold no time of the
/// reference: then the stamps tell it.
#[test]
fn healthy_segments_of_all_ratios_are_in_sync() {
    for slower in [
        &[2][..],
        &[4],
        &[1, 2],
        &[2, 1],
        &[2, 2],
        &[1, 4],
        &[4, 1],
        &[2, 4],
        &[8, 1, 2],
        &[1, 2, 4, 8],
    ] {
        let (capture, in_sync) = ran(slower, "");
        assert!(in_sync, "{slower:?}");
        let report = diagnosed(&capture);
        assert_eq!(report.verdict.kind, VerdictKind::InSync, "{slower:?}\n{}", report.text());
        for (device, times) in report.devices.iter().zip(slower) {
            let distance = device.distance.as_ref().expect("measured");
            let cycle = u64::from(*times) * 1_000_000;
            assert_eq!(distance.cycle_ns, cycle, "{slower:?}");
            // Half a second, and the time from OP of the last one on.
            let frames = 500_000_000 / cycle;
            assert!((frames..frames + 30).contains(&distance.frames), "{slower:?}: {distance:?}");
        }
    }
}

#[test]
fn what_is_wrong_with_a_slower_drive_is_found() {
    for slower in [&[2][..], &[1, 2], &[2, 1], &[4, 1], &[2, 4]] {
        for (fault, found) in [
            ("late-wake-ups 100us for 4ms", false),
            ("late-wake-ups 900us for 4ms", true),
            ("late-wake-ups 2100us for 4ms", true),
            ("drop 4", true),
            ("stall 9ms", true),
            ("stall 50ms", true),
        ] {
            let (capture, in_sync) = ran(slower, fault);
            assert_eq!(in_sync, !found, "{slower:?} {fault}");
            let report = diagnosed(&capture);
            let wanted = if found { VerdictKind::Found } else { VerdictKind::InSync };
            assert_eq!(report.verdict.kind, wanted, "{slower:?} {fault}\n{}", report.text());
        }
    }
}

/// A frame of the slower drive alone that was never sent: its outputs are old at one SYNC0, and all
/// other frames are there.
#[test]
fn a_frame_that_a_slower_drive_did_not_get_is_found() {
    let (capture, _) = ran(&[1, 4], "");
    // Its frames begin with LRW, the others with the reference's time.
    let frames = Reading::of(&capture[..]).expect("a capture").frames;
    let own = frames.iter().filter(|frame| frame.bytes[16] == Command::Lrw as u8);
    let own: Vec<usize> = own.map(|frame| frame.number).collect();
    let left_out = &own[own.len() / 2 / 2 * 2..][..2];
    let cut = cut(&capture, |number, _| !left_out.contains(&number));
    let report = diagnosed(&cut);
    assert_eq!(report.verdict.kind, VerdictKind::Found, "{}", report.text());
    let [found] = &report.findings[..] else { panic!("{}", report.text()) };
    assert_eq!((found.kind, found.device), ("cycles-skipped", Some(1)));
}

/// Stamps that are no better than the cycle tell nothing about frames without the reference's time:
/// neither that they came in time nor that they did not.
#[test]
fn coarse_stamps_leave_slower_drives_unknown() {
    let (capture, _) = ran(&[1, 2], "");
    let coarse = |_, at: Duration| Duration::from_millis(at.as_millis() as u64);
    let uneven = |number, at| at + Duration::from_nanos(number * 7_919 % 300_000);
    let report = diagnosed(&stamped(&capture, coarse));
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound, "{}", report.text());
    let report = diagnosed(&stamped(&capture, uneven));
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound, "{}", report.text());
    let [fast, slow] = [0, 1].map(|at| report.devices[at].distance.is_some());
    assert_eq!((fast, slow), (true, false));
    // As a program on a machine takes them.
    let usual = |number, at| at + Duration::from_nanos(number * 7_919 % 20_000);
    let report = diagnosed(&stamped(&capture, usual));
    assert_eq!(report.verdict.kind, VerdictKind::InSync, "{}", report.text());
    let within = report.devices[1].distance.as_ref().map(|distance| distance.within_ns);
    assert!(within.is_some_and(|ns| (1_000..45_000).contains(&ns)), "{within:?}");
}

/// Devices without SYNC0 have nothing to synchronize. That is known where their way up is in the
/// capture, all of them were in OP, and nothing is missing at the end.
#[test]
fn devices_without_sync0_operate() {
    let text =
        "cycle = \"1ms\"\nfor = \"300ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 3\n";
    let ran = |fault: &str| {
        let file = SegmentFile::parse("io.toml", &format!("{text}{fault}")).expect("a segment");
        let mut capture = Vec::new();
        let tap = Capture::new(&mut capture).expect("a Vec takes everything");
        let outcome = Scenario::from(file).run().execute(Some(tap), &mut |_| {});
        outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
        capture
    };
    let right = ran("");
    let report = diagnosed(&right);
    assert_eq!(report.verdict.kind, VerdictKind::InOperation, "{}", report.text());
    assert!(report.verdict.sentence.contains("all 3 SubDevices were in OP"), "{}", report.text());
    // An FMMU of outputs that also reads: it is not known what comes back as inputs.
    let both = rewritten(&right, |bytes| {
        let mut at = 16;
        // Each datagram: a header of ten bytes, its data, a working counter.
        while at + 12 <= bytes.len() && bytes[at] > 0 {
            let len = usize::from(u16::from_le_bytes([bytes[at + 6], bytes[at + 7]]) & 0x07FF);
            let is_fmmu = bytes[at] == Command::Fpwr as u8 && bytes[at + 5] == 0x06;
            if is_fmmu && bytes[at + 10 + 11] == 2 {
                bytes[at + 10 + 11] = 3;
            }
            at += len + 12;
        }
    });
    let report = diagnosed(&both);
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound, "{}", report.text());
    assert!(report.verdict.sentence.contains("an FMMU reads and writes"), "{}", report.text());
    // From the middle on it is not known whether SYNC0 runs since before.
    let middle = cut(&right, |number, frames| number > frames - 400);
    let report = diagnosed(&middle);
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound, "{}", report.text());
    let [fault, when] = ["pull 2 for 100ms", "in-operation + 100ms"];
    let pulled = ran(&format!("[[fault]]\nat = \"{when}\"\nwhat = \"{fault}\"\n"));
    let report = diagnosed(&pulled);
    assert_eq!(report.verdict.kind, VerdictKind::Found, "{}", report.text());
}

/// The capture with other frames.
fn rewritten(capture: &[u8], change: impl Fn(&mut [u8])) -> Vec<u8> {
    let mut other = Capture::new(Vec::new()).expect("a Vec takes everything");
    for mut frame in Reading::of(capture).expect("a capture").frames {
        change(&mut frame.bytes);
        other.write(frame.at, frame.sent == Some(true), &frame.bytes);
    }
    other.finish().expect("a Vec takes everything")
}

/// The frames of a capture for which `keeps` is true, by number and the number of all.
fn cut(capture: &[u8], keeps: impl Fn(usize, usize) -> bool) -> Vec<u8> {
    let frames = Reading::of(capture).expect("a capture").frames;
    let mut other = Capture::new(Vec::new()).expect("a Vec takes everything");
    let all = frames.len();
    for frame in frames.into_iter().filter(|frame| keeps(frame.number, all)) {
        other.write(frame.at, frame.sent == Some(true), &frame.bytes);
    }
    other.finish().expect("a Vec takes everything")
}
