//! Plays real ENI files, if they are present, on segments made from them.

use std::path::{Path, PathBuf};

use isocat_descriptions::eni::Eni;
use isocat_descriptions::esi::EsiFile;
use isocat_engine::plan::Plan;
use isocat_player::differences::{Kind, differences};
use isocat_player::virtual_segment::{self, Origin};
use isocat_player::{Report, Settings, play};
use isocat_wire::Nanos;

/// A folder beside the project; if it is absent, prints a message and returns `None`.
fn folder(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: no {}", path.display());
    None
}

/// Runs a file; returns its report, the kinds of its differences, and the source of its only
/// device.
fn run(name: &str) -> Option<(Report, Vec<Kind>, Origin)> {
    let descriptions = match folder("esi") {
        Some(folder) => virtual_segment::descriptions(&[folder]).unwrap(),
        None => return None,
    };
    run_with(name, &descriptions)
}

fn run_with(name: &str, descriptions: &[EsiFile]) -> Option<(Report, Vec<Kind>, Origin)> {
    let eni = Eni::read(folder("eni")?.join(name)).unwrap();
    let made = virtual_segment::of_eni(&eni, descriptions).unwrap();
    let settings = Settings { duration: Nanos::millis(500), tolerates_unknown_objects: true };
    let played = play(eni.runnable().unwrap(), &made.scenario, settings);
    let plan = Plan::of(&made.scenario).unwrap();
    let found = differences(&eni.start_up, &plan.start_up(&made.scenario), &plan);
    let kinds = found.iter().map(|one| one.kind).collect();
    let report = Report::planned(&eni, &made, Ok(found)).with_run(&played);
    Some((report, kinds, made.origins[0].clone()))
}

#[test]
fn an_export_without_dc_runs_on_its_description() {
    let Some((report, kinds, origin)) = run("hpmicro_cia402.eni.xml") else { return };
    assert!(matches!(&origin, Origin::Esi { kind, .. } if kind == "ECAT_CIA402"), "{origin}");
    let text = report.text();
    let run = report.run.unwrap();
    assert!(run.in_sync, "{text}");
    // The preset module's dictionary has 0x6060:00.
    assert!(run.unknown_objects.is_empty(), "{text}");
    assert!(kinds.contains(&Kind::MailboxState) && kinds.contains(&Kind::SyncObject), "{text}");
}

/// The built-in profile of that product has another mapping: 7 bytes where the export sets 8 up.
#[test]
fn an_export_for_another_revision_runs_on_a_device_made_of_it() {
    let Some((report, _, origin)) = run_with("hpmicro_cia402.eni.xml", &[]) else { return };
    assert_eq!(origin, Origin::Eni);
    let text = report.text();
    assert!(report.run.unwrap().in_sync, "{text}");
}

/// Terminals, and a drive at the coupler's other port: the list has no topology.
#[test]
fn a_list_of_devices_becomes_a_segment_that_can_be_wired() {
    let (Some(enis), Some(esis), Some(more)) = (folder("eni"), folder("esi"), folder("esi-more"))
    else {
        return;
    };
    let mut eni = Eni::read(enis.join("beremiz_etherlab_config.xml")).unwrap();
    assert!(eni.runnable().is_err(), "it has no commands");
    eni.start_up.cycle_ns = 1_000_000;
    let descriptions = virtual_segment::descriptions(&[esis, more]).unwrap();
    let made = virtual_segment::of_eni(&eni, &descriptions).unwrap();
    assert_eq!(made.scenario.devices.len(), 4);
    assert!(made.text.contains("connect = \"0:2\""), "{}", made.text);
}

#[test]
fn an_export_with_dc_runs_on_a_device_made_of_it() {
    let Some((report, kinds, origin)) = run("intrinsic_1motor_sgdv.eni") else { return };
    assert_eq!(origin, Origin::Eni);
    let text = report.text();
    let run = report.run.unwrap();
    assert!(run.in_sync && run.unknown_objects.is_empty(), "{text}");
    assert!(run.clocks[0].unwrap().start_ns.unwrap() % 4_000_000 == 0, "{text}");
    // The device has what the ENI maps: 10 bytes out, 12 in, as in the plan.
    assert!(!kinds.contains(&Kind::Fmmu) && !kinds.contains(&Kind::PdoAssignment), "{text}");
    for kind in [Kind::Shift, Kind::PdoMapping, Kind::DriftFilter, Kind::Frames] {
        assert!(kinds.contains(&kind), "{kind:?}: {text}");
    }
}
