//! A capture held against what was meant: of one right run, with one claim otherwise each.

use isocat::capture::Capture;
use isocat::diagnose::report::{FindingReport, VerdictKind, WeightKind};
use isocat::diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat::reading::Reading;
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_rules::Claims;
use isocat_sync::SyncMode;

const SEGMENT: &str = r#"
cycle = "2ms"
shift = "1ms"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 1"
mode = "dc-sync0"
clock = "-35ppm"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 2"
mode = "dc-sync0"
clock = "20ppm"
[[subdevice]]
device = "beckhoff_epp2316-0003"
name = "I/O"
"#;

/// The capture of a run of our own MainDevice, and what its file claims.
fn ran() -> (Vec<u8>, Claims) {
    let mut scenario = Scenario::from(SegmentFile::parse("line.toml", SEGMENT).expect("a segment"));
    scenario.duration = Nanos::millis(1_500);
    let mut file = Vec::new();
    let tap = Capture::new(&mut file).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    (file, scenario.claims())
}

fn held_against(file: &[u8], claims: &Claims) -> DiagnoseReport {
    let mut diagnosis = Diagnosis::new().against(Some(claims.clone()));
    diagnosis.read("line.pcapng", file).expect("a capture");
    let names = ["axis 1", "axis 2", "I/O"].map(str::to_owned).to_vec();
    diagnosis.report(&Names { positions: names, ..Names::default() }).expect("EtherCAT")
}

fn faults(report: &DiagnoseReport) -> Vec<&FindingReport> {
    report.findings.iter().filter(|one| one.weight == WeightKind::Fault).collect()
}

#[test]
fn what_is_otherwise_than_meant_is_a_fault_with_its_place() {
    let (file, claims) = ran();
    let right = held_against(&file, &claims);
    assert_eq!(right.verdict.kind, VerdictKind::InSync, "{}", right.text());
    let counted = right.claims.as_ref().expect("a segment was given");
    assert!(counted.checked > 15, "{counted:?}");
    assert_eq!(counted.not_checked, [], "{}", right.text());

    type Change = fn(&mut Claims);
    let cases: [(&str, Option<usize>, Change); 9] = [
        ("other-mode", Some(1), |claims| claims.devices[1].mode = Some(SyncMode::SmSynchronous)),
        ("other-mode", Some(0), |claims| claims.devices[0].mode = Some(SyncMode::DcSync1)),
        ("other-sync0-cycle", Some(1), |claims| {
            claims.devices[1].sync0_cycle = Some(Nanos::millis(4));
        }),
        ("other-sync0-cycle", Some(0), |claims| {
            claims.devices[0].sync0_cycle = Some(Nanos(2_000_001));
        }),
        ("other-shift", Some(1), |claims| claims.devices[1].shift = Some(Nanos(0))),
        ("other-cycle", None, |claims| claims.cycle = Some(Nanos(2_050_000))),
        ("other-cycle", None, |claims| claims.cycle = Some(Nanos::millis(1))),
        ("sync0-apart", Some(1), |claims| claims.sync0_limit = Nanos(-1)),
        ("other-mode", Some(2), |claims| claims.devices[2].mode = Some(SyncMode::DcSync0)),
    ];
    for (kind, device, change) in cases {
        let mut claims = claims.clone();
        change(&mut claims);
        let report = held_against(&file, &claims);
        let faults = faults(&report);
        let found: Vec<_> = faults.iter().map(|fault| (fault.kind, fault.device)).collect();
        assert_eq!(found, [(kind, device)], "{}", report.text());
        assert_eq!(report.verdict.kind, VerdictKind::Found);
        assert!(!faults[0].remedies.is_empty() && faults[0].frame.frame > 1, "{:?}", faults[0]);
    }
}

#[test]
fn what_a_capture_does_not_show_is_not_checked() {
    let (file, claims) = ran();
    // Without the way up nothing of the set-up is known.
    let frames = Reading::of(&file).expect("a capture").frames;
    let mut rest = Capture::new(Vec::new()).expect("a Vec takes everything");
    for frame in &frames[frames.len() / 2..] {
        rest.write(frame.at, frame.sent == Some(true), &frame.bytes);
    }
    let report = held_against(&rest.finish().expect("a Vec"), &claims);
    assert_eq!(faults(&report), [] as [&FindingReport; 0], "{}", report.text());
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound, "{}", report.text());
    let counted = report.claims.expect("a segment was given");
    let rules: Vec<_> = counted.not_checked.iter().map(|one| one.rule).collect();
    assert!(rules.contains(&"operates"), "{rules:?}");

    // A SubDevice of the file that no frame reached is not known, and no fault.
    let mut more = claims.clone();
    more.devices.push(more.devices[1].clone());
    let report = held_against(&file, &more);
    assert_eq!(faults(&report), [] as [&FindingReport; 0], "{}", report.text());
    assert_eq!(report.verdict.kind, VerdictKind::NothingFound, "{}", report.text());
}
