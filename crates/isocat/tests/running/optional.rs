//! What is optional stays optional: each optional service of a SubDevice in the middle of a segment
//! answered badly in turn, and a SubDevice that does not come up at all.

use std::cell::Cell;
use std::rc::Rc;

use isocat::{Report, Scenario, SegmentFile};
use isocat_maindevice::{SegmentChange, Service};
use isocat_sim::{Judged, Kind, Tap};
use isocat_wire::time::{Time, True};
use isocat_wire::{AlState, Command, datagram, frame, register};

/// Three devices, of which the second misbehaves.
fn segment(misbehave: &str) -> Scenario {
    let text = format!(
        r#"
        cycle = "1ms"
        for = "200ms"
        [[subdevice]]
        device = "kollmorgen_akd2g"
        [[subdevice]]
        device = "model_every_mode"
        name = "middle"
        mode = "dc-sync0"
        misbehave = [{misbehave}]
        [[subdevice]]
        device = "simple_io16"
    "#
    );
    Scenario::from(SegmentFile::parse("optional.toml", &text).expect("it reads"))
}

/// It runs, and these services are named, all of them the second SubDevice's.
fn runs_without(misbehave: &str, services: &[Service]) -> Report {
    let report = isocat::run(&segment(misbehave));
    assert!(report.in_sync, "{misbehave}: {}", report.verdict);
    assert!(report.devices.iter().all(|device| device.registers.al_status.is_op()), "{misbehave}");
    let named: Vec<Service> = report.services.iter().map(|note| note.service).collect();
    assert_eq!(named, services, "{misbehave}: {:#?}", report.services);
    // Lines of the text are broken anywhere.
    let text = report.text().split_whitespace().collect::<Vec<_>>().join(" ");
    for note in &report.services {
        assert_eq!((note.position, &*note.device), (1, "middle"), "{misbehave}");
        assert!(text.contains(&note.what), "{misbehave}: {text}");
    }
    report
}

#[test]
fn nothing_is_named_where_all_is_answered_well() {
    runs_without("", &[]);
}

/// An answer of headers alone is what stacks of the field send for "object does not exist".
#[test]
fn sdo_information_may_be_answered_in_any_way() {
    for answer in ["short", "silent", "garbage"] {
        let fault = format!("\"bad-information {answer}\"");
        runs_without(&fault, &[Service::SdoInformation]);
    }
    // A refusal is an answer: the service is not there.
    for answer in ["error", "abort"] {
        runs_without(&format!("\"bad-information {answer}\""), &[]);
    }
}

#[test]
fn the_use_of_sync_managers_may_be_answered_in_any_way() {
    for answer in ["short", "silent", "garbage", "error"] {
        let fault = format!("\"bad-transfer 1C00 {answer}\"");
        let report = runs_without(&fault, &[Service::SyncManagerTypes]);
        assert!(report.services[0].what.contains("1C00"), "{}", report.services[0].what);
    }
    runs_without("\"bad-transfer 1C00 abort\"", &[]);
}

#[test]
fn sync_objects_may_be_answered_in_any_way() {
    for index in ["1C32", "1C33"] {
        for answer in ["short", "silent", "garbage", "error"] {
            let fault = format!("\"bad-transfer {index} {answer}\"");
            let report = runs_without(&fault, &[Service::SyncEntry]);
            assert!(report.services[0].what.contains(index), "{}", report.services[0].what);
        }
        runs_without(&format!("\"bad-transfer {index} abort\""), &[]);
    }
}

/// Which PDOs there are, and what is in them: the SII says it where the objects do not.
#[test]
fn process_data_may_be_described_in_any_way() {
    for (index, service) in [
        ("1C12", Service::Assignment),
        ("1C13", Service::Assignment),
        ("1600", Service::Mapping),
        ("1A00", Service::Mapping),
    ] {
        for answer in ["short", "silent", "garbage", "error"] {
            let report = runs_without(&format!("\"bad-transfer {index} {answer}\""), &[service]);
            assert!(report.services[0].what.contains(index), "{}", report.services[0].what);
        }
    }
}

/// The SII of the second has no end: its categories are read as far as they go.
#[test]
fn a_sii_without_end_is_read_as_far_as_it_goes() {
    let scenario = segment("");
    let mut run = scenario.run();
    // One that is like another's from the start is not read to its end.
    run.setup.config.share_sii = false;
    let device = &mut run.setup.segment[1].device;
    let mut image = device.sii.to_vec();
    let mut at = 0x80;
    while image[at..at + 2] != [0xFF, 0xFF] {
        at += 4 + 2 * usize::from(u16::from_le_bytes([image[at + 2], image[at + 3]]));
    }
    // A category that goes on for longer than any EEPROM is.
    image[at..at + 4].copy_from_slice(&[0x00, 0x08, 0xFF, 0xFF]);
    device.sii = image.into();
    let outcome = run.execute(None::<isocat::NoTap>, &mut |_| {});
    let report = Report::new(&scenario, &outcome);
    assert!(report.in_sync, "{}", report.verdict);
    let named: Vec<Service> = report.services.iter().map(|note| note.service).collect();
    assert_eq!(named, [Service::Categories], "{:#?}", report.services);
}

/// Refuses SAFEOP, or OP, or PREOP: alone it ends the way up and the others go back to INIT;
/// tolerated, it is left out.
#[test]
fn a_device_that_does_not_come_up_is_left_out_if_that_is_wanted() {
    for (state, rest) in [("PREOP", "pre-op"), ("SAFEOP", "safe-op"), ("OP", "op")] {
        let mut scenario = segment(&format!("\"refused-state {state}\""));
        let outcome = scenario.run().execute(None::<isocat::NoTap>, &mut |_| {});
        let error = outcome.failure.as_ref().unwrap_or_else(|| panic!("{rest}: it came up"));
        assert_eq!(error.cause.place().map(|place| place.position), Some(1), "{error}");
        for (at, device) in outcome.world.segment().devices().iter().enumerate() {
            assert_eq!(device.stack.state(), AlState::Init, "{state}: SubDevice {at}");
        }
        // The evidence stays.
        let found = &outcome.world.main().segment().devices[1];
        assert!(found.al_status.error(), "{state}: {}", found.al_status);

        scenario.tolerate = true;
        let outcome = scenario.run().execute(None::<isocat::NoTap>, &mut |_| {});
        let report = Report::new(&scenario, &outcome);
        let kinds: Vec<&Kind> = report.findings.iter().map(|finding| &finding.kind).collect();
        let left_out = |kind: &Kind| {
            matches!(kind, Kind::Change(SegmentChange::LeftOut { cause })
            if cause.name() == "state-refused")
        };
        assert!(kinds.len() == 1 && left_out(kinds[0]), "{state}: {:#?}", report.findings);
        assert_eq!(report.findings[0].position, Some(1));
        assert!(
            !report.in_sync && report.verdict.starts_with("In sync except"),
            "{}",
            report.verdict
        );
        let states = outcome.world.segment().devices().iter().map(|device| device.stack.state());
        assert_eq!(
            states.collect::<Vec<_>>(),
            [AlState::Op, AlState::Init, AlState::Op],
            "{state}"
        );
        assert!(
            !kinds.iter().any(|kind| matches!(kind, Kind::Judged(Judged::WorkingCounter { .. })))
        );
    }
}

/// Counts reads that are asked of EEPROMs: writes of a command to 0x0502.
#[derive(Clone, Default)]
struct Accesses(Rc<Cell<usize>>);

impl Tap for Accesses {
    fn frame(&mut self, _: Time<True>, sent: bool, bytes: &[u8]) {
        let datagrams = datagram::datagrams(frame::payload(bytes).expect("our own frame"));
        for datagram in datagrams.filter(|_| sent) {
            let datagram = datagram.expect("our own datagram");
            let asked = datagram.header.command() == Ok(Command::Fpwr)
                && datagram.header.ado() == register::EEPROM_STATUS.address
                && datagram.data.len() > 2;
            self.0.set(self.0.get() + usize::from(asked));
        }
    }
}

/// The first of equal devices has an EEPROM that says something else behind the start, or has no
/// end: that is its own affair, and the others are read.
#[test]
fn a_damaged_sii_is_nobody_elses() {
    let text =
        "cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 5\n";
    let mut scenario = Scenario::from(SegmentFile::parse("damaged.toml", text).expect("it reads"));
    scenario.tolerate = true;
    let run = |damage: &dyn Fn(&mut Vec<u8>)| {
        let mut run = scenario.run();
        let mut image = run.setup.segment[0].device.sii.to_vec();
        damage(&mut image);
        run.setup.segment[0].device.sii = image.into();
        let outcome = run.execute(None::<isocat::NoTap>, &mut |_| {});
        let report = Report::new(&scenario, &outcome);
        assert!(outcome.world.main().segment().devices[1..].iter().all(|device| device.admitted));
        (report, outcome.world.main().segment().devices.clone())
    };
    // A mailbox that no device has.
    let (report, devices) = run(&|image| image[0x30] = 7);
    assert!(report.in_sync, "{}", report.verdict);
    let receive: Vec<u16> = devices.iter().map(|device| device.sii.header.receive.start).collect();
    assert_eq!(receive, [7, 0, 0, 0, 0]);
    // Its categories go on for ever: without objects there is nothing to run it by.
    let (report, devices) = run(&|image| {
        image.truncate(0x84);
        image[0x82..0x84].copy_from_slice(&[0xFF, 0x7F]);
    });
    assert!(!devices[0].admitted, "{}", report.verdict);
    let named: Vec<_> = report.findings.iter().map(|finding| finding.position).collect();
    assert_eq!(named, [Some(0)], "{:#?}", report.findings);
}

/// Equal devices share what two of them have; one of them of another revision has its own, and
/// serial numbers stay each one's.
#[test]
fn siis_that_are_alike_are_shared() {
    let text =
        "cycle = \"1ms\"\nfor = \"20ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 100\n";
    let scenario = Scenario::from(SegmentFile::parse("alike.toml", text).expect("it reads"));
    let run = |share: bool| {
        let mut run = scenario.run();
        run.setup.config.share_sii = share;
        for (at, connection) in run.setup.segment.iter_mut().enumerate() {
            let mut image = connection.device.sii.to_vec();
            image[0x1C] = at as u8;
            // Another revision, and another mailbox that nobody uses: what only its own SII can
            // tell.
            if at == 50 {
                image[0x18] ^= 1;
                image[0x30] = 7;
            }
            connection.device.sii = image.into();
        }
        let accesses = Accesses::default();
        let outcome = run.execute(Some(accesses.clone()), &mut |_| {});
        let report = Report::new(&scenario, &outcome);
        assert!(report.in_sync, "{}", report.verdict);
        let devices = &outcome.world.main().segment().devices;
        for (at, device) in devices.iter().enumerate() {
            assert_eq!(device.identity.serial, at as u32);
            assert_eq!(device.sii.header.receive.start, if at == 50 { 7 } else { 0 }, "{at}");
            assert_eq!(device.sii.sync_managers, devices[0].sii.sync_managers);
        }
        (accesses.0.get(), devices.iter().map(|device| device.sii.clone()).collect::<Vec<_>>())
    };
    let ((each, own), (once, shared)) = (run(false), run(true));
    println!("100 equal devices: {each} accesses to EEPROMs if each is read, {once} if they share");
    assert_eq!(own, shared, "the same is known either way");
    assert!(once * 2 < each, "{once} of {each}");
}
