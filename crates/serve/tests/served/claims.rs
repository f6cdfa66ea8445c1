//! What a segment file says is the reference for the MainDevice that operates its segment: each
//! mistake of our own MainDevice is told by its kind and place, and a right one is in sync.

use crate::line::Line;
use isocat_maindevice::{Config, StartupDownload};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sync::{SyncMode, object};
use isocat_wire::ObjectAddress;
use isocat_wire::time::Nanos;

/// Two drives with SYNC0 and an I/O, and what else the file says.
fn scenario(keys: &str) -> Scenario {
    let drive = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmode = \"dc-sync0\"\n";
    let text = format!(
        "cycle = \"1ms\"\nshift = \"600us\"\n{keys}\n{drive}{drive}[[subdevice]]\ndevice = \"simple_io16\"\n"
    );
    Scenario::from(SegmentFile::parse("a test", &text).expect("a segment"))
}

/// A MainDevice that works by `works_by` operates the segment of `meant` for 300 cycles; the kinds
/// of what was found, each with its SubDevice.
fn found(meant: &Scenario, works_by: &Scenario) -> Vec<(Option<usize>, &'static str)> {
    found_of(meant, works_by.config())
}

fn found_of(meant: &Scenario, works_by: Config) -> Vec<(Option<usize>, &'static str)> {
    let duration = Nanos(300 * works_by.cycle.0);
    let mut line = Line::with(meant, works_by);
    line.bring_up();
    line.run(duration, |_| false);
    let judged = line.server.judged().expect("judged");
    let found = judged.all_findings();
    found.map(|finding| (finding.place.device, finding.kind.name())).collect()
}

#[test]
fn a_main_device_that_does_what_was_meant_is_in_sync() {
    let meant = scenario("");
    assert_eq!(found(&meant, &meant), []);
}

/// Frames come several times in a cycle of a slower drive, and slide in none.
#[test]
fn a_slower_drive_is_no_mistake() {
    let drive = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nmode = \"dc-sync0\"\n";
    for (first, second) in [(1, 4), (4, 1), (1, 2), (2, 1), (2, 4)] {
        let text = format!(
            "cycle = \"1ms\"\n{drive}cycle = \"{first}ms\"\n{drive}cycle = \"{second}ms\"\n"
        );
        let meant = Scenario::from(SegmentFile::parse("a test", &text).expect("a segment"));
        assert_eq!(found(&meant, &meant), [], "{text}");
    }
}

#[test]
fn another_mode_is_told_though_it_runs_well() {
    let mut works_by = scenario("");
    works_by.devices[1].mode = Some(SyncMode::SmSynchronous);
    assert_eq!(found(&scenario(""), &works_by), [(Some(1), "other-mode")]);
}

#[test]
fn another_phase_is_told() {
    let at = |us: i64| {
        let mut works_by = scenario("");
        works_by.shift = Some(Nanos::micros(us));
        found(&scenario(""), &works_by)
    };
    assert_eq!((at(400), at(800)), (vec![], vec![]));
    let both = [(Some(0), "other-shift"), (Some(1), "other-shift")];
    assert_eq!((at(300), at(900)), (both.to_vec(), both.to_vec()));
}

#[test]
fn another_cycle_is_told() {
    let mut works_by = scenario("");
    (works_by.cycle, works_by.shift) = (Nanos::millis(2), Some(Nanos::micros(600)));
    let kinds = found(&scenario(""), &works_by);
    let cycles = [(Some(0), "other-sync0-cycle"), (Some(1), "other-sync0-cycle")];
    assert_eq!(kinds[0], (None, "other-cycle"), "{kinds:?}");
    assert!(cycles.iter().all(|one| kinds.contains(one)), "{kinds:?}");
}

#[test]
fn process_data_in_every_other_cycle_are_told() {
    let mut works_by = scenario("");
    works_by.devices[2].cycle = Some(Nanos::millis(2));
    let [outputs, inputs] = [(Some(2), "carried-seldom"); 2];
    assert_eq!(found(&scenario(""), &works_by), [outputs, inputs]);
    assert_eq!(found(&works_by, &works_by), []);
}

/// Only what was written is held against the file: a MainDevice that writes nothing moves drives
/// otherwise.
#[test]
fn an_interpolation_time_other_than_the_cycle_is_told() {
    let by = |units: u8| {
        let mut config = scenario("").config();
        let write = |sub, data| StartupDownload {
            object: ObjectAddress::new(object::INTERPOLATION_TIME, sub),
            data: vec![data],
            complete: false,
        };
        let power = (-4_i8).cast_unsigned();
        config.devices[1].startup = vec![write(1, units), write(2, power)];
        found_of(&scenario(""), config)
    };
    assert_eq!(by(10), []);
    for units in [5, 20] {
        assert_eq!(by(units), [(Some(1), "other-interpolation")]);
    }
}

#[test]
fn clocks_that_nothing_leads_are_told() {
    let mut works_by = scenario("");
    works_by.drift_compensation = false;
    let kinds = found(&scenario("clocks = \"0ppm\""), &works_by);
    assert!(kinds.contains(&(None, "time-not-distributed")), "{kinds:?}");
}

#[test]
fn a_segment_as_it_is_makes_no_claims() {
    let mut works_by = scenario("");
    works_by.devices[1].mode = Some(SyncMode::SmSynchronous);
    works_by.shift = Some(Nanos::micros(900));
    assert_eq!(found(&scenario("as_is = true"), &works_by), []);
}

/// A mode that the file leaves open may be any, and its SYNC0 is still the one of the bus.
#[test]
fn what_the_file_leaves_open_is_no_claim() {
    let mut meant = scenario("");
    meant.devices.iter_mut().for_each(|device| device.asked.mode = None);
    let mut works_by = scenario("");
    works_by.devices[1].mode = Some(SyncMode::SmSynchronous);
    assert_eq!(found(&meant, &works_by), []);
    works_by.shift = Some(Nanos::micros(900));
    assert_eq!(found(&meant, &works_by), [(Some(0), "other-shift")]);
}
