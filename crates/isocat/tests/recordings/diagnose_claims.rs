//! A capture held against what was meant: of one right run, with one claim otherwise each.

use std::time::Duration;

use isocat::capture::Capture;
use isocat::diagnose::report::{FindingReport, VerdictKind, WeightKind};
use isocat::diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat::reading::Reading;
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_rules::Claims;
use isocat_sync::SyncMode;
use isocat_wire::datagram::{Address, Layouts};
use isocat_wire::frame::FrameWriter;
use isocat_wire::{Command, StationAddress};

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

/// One datagram of a frame: its command, ADP and ADO, and its data.
struct Datagram<'a> {
    head: &'a mut [u8],
    data: &'a mut [u8],
}

impl Datagram<'_> {
    fn word(&self, at: usize) -> u16 {
        u16::from_le_bytes([self.head[at], self.head[at + 1]])
    }

    fn is(&self, command: Command, adp: u16, ado: u16) -> bool {
        self.head[0] == command as u8 && (self.word(2), self.word(4)) == (adp, ado)
    }

    fn is_left_out(&mut self) {
        self.head[0] = Command::Nop as u8;
    }

    fn goes_to(&mut self, station: u16) {
        self.head[2..4].copy_from_slice(&station.to_le_bytes());
    }

    /// Its first FMMU of this kind.
    fn fmmu(&mut self, kind: u8) -> Option<&mut [u8]> {
        let of_fmmus =
            self.head[0] == Command::Fpwr as u8 && (0x0600..0x0700).contains(&self.word(4));
        let mut all = self.data.chunks_exact_mut(16);
        all.find(|fmmu| of_fmmus && fmmu[11] == kind && fmmu[9] >= 0x10)
    }
}

/// The capture with each datagram changed as `change` does it, on both ways.
fn changed(file: &[u8], change: impl Fn(&mut Datagram<'_>)) -> Vec<u8> {
    rewritten(file, |_, bytes| {
        let mut layouts = Layouts::new();
        let payload = bytes[16..].to_vec();
        while let Some(Ok(layout)) = layouts.next(&payload) {
            let (head, data) = bytes[16 + layout.start..16 + layout.wkc()].split_at_mut(10);
            change(&mut Datagram { head, data });
        }
    })
}

fn rewritten(file: &[u8], change: impl Fn(bool, &mut Vec<u8>)) -> Vec<u8> {
    let mut written = Capture::new(Vec::new()).expect("a Vec takes everything");
    for frame in &Reading::of(file).expect("a capture").frames {
        let (sent, mut bytes) = (frame.sent == Some(true), frame.bytes.to_vec());
        change(sent, &mut bytes);
        written.write(frame.at, sent, &bytes);
    }
    written.finish().expect("a Vec")
}

/// The verdict on a changed capture, and its first fault.
fn said(
    file: &[u8],
    claims: &Claims,
) -> (VerdictKind, Option<(&'static str, Option<usize>)>, String) {
    let report = held_against(file, claims);
    let first = faults(&report).first().map(|fault| (fault.kind, fault.device));
    (report.verdict.kind, first, report.text())
}

const AXIS_2: u16 = 0x1002;
const OUTPUTS: u8 = 2;
const INPUTS: u8 = 1;

#[test]
fn process_data_are_carried_if_first_and_last_byte_are() {
    let (file, claims) = ran();
    let of_axis_2 = |datagram: &mut Datagram<'_>, kind: u8, at: usize, by: u8| {
        if datagram.word(2) == AXIS_2
            && let Some(fmmu) = datagram.fmmu(kind)
        {
            fmmu[at] = fmmu[at].wrapping_add(by);
        }
    };
    // Physical start (8) and length (4).
    for (kind, at, by) in [(OUTPUTS, 8, 1), (OUTPUTS, 8, 255), (INPUTS, 8, 1), (INPUTS, 4, 255)] {
        let wrong = changed(&file, |datagram| of_axis_2(datagram, kind, at, by));
        let (verdict, first, text) = said(&wrong, &claims);
        let found = (verdict, first);
        assert_eq!(
            found,
            (VerdictKind::Found, Some(("not-carried", Some(1)))),
            "{kind} {at} {by}: {text}"
        );
    }
    // More than the SyncManager, beyond all frames, does no harm.
    let longer = changed(&file, |datagram| {
        if datagram.word(2) == 0x1003
            && let Some(fmmu) = datagram.fmmu(INPUTS)
        {
            fmmu[4] += 100;
        }
    });
    let (verdict, _, text) = said(&longer, &claims);
    assert_eq!(verdict, VerdictKind::InSync, "{text}");
}

#[test]
fn clocks_that_nothing_latched_are_not_known_to_have_come_together() {
    let (file, claims) = ran();
    for (latched, verdict) in [(true, VerdictKind::InSync), (false, VerdictKind::NothingFound)] {
        let file = changed(&file, |datagram| {
            // Differences are not read: they would show that the clocks are together.
            let (is_look, is_latch) = (datagram.word(4) == 0x092C, datagram.word(4) == 0x0900);
            let writes = datagram.head[0] == Command::Bwr as u8;
            if is_look || !latched && is_latch && writes {
                datagram.is_left_out();
            }
        });
        let (found, _, text) = said(&file, &claims);
        assert_eq!(found, verdict, "latched: {latched}: {text}");
    }
}

#[test]
fn a_delay_at_the_wrong_device_counts_at_both() {
    let (file, claims) = ran();
    let elsewhere = changed(&file, |datagram| {
        if datagram.is(Command::Fpwr, AXIS_2, 0x0928) {
            datagram.goes_to(0x1001);
        }
    });
    let (verdict, first, text) = said(&elsewhere, &claims);
    let found = (verdict, first);
    assert_eq!(found, (VerdictKind::Found, Some(("sync0-apart", Some(1)))), "{text}");
}

#[test]
fn what_is_only_unusual_stays_in_sync() {
    let (file, claims) = ran();
    // A first SubDevice that does not mark frames on their way back.
    let count = std::cell::Cell::new(0);
    let unmarked = rewritten(&file, |sent, bytes| {
        count.set(count.get() + 1);
        if !sent && count.get() > 2_000 {
            bytes[6] &= !2;
        }
    });
    // Station address 0.
    let nameless = changed(&file, |datagram| {
        if datagram.is(Command::Apwr, 0xFFFF, 0x0010) {
            datagram.data.fill(0);
        }
        let by_station = [Command::Fprd, Command::Fpwr].map(|one| one as u8);
        if by_station.contains(&datagram.head[0]) && datagram.word(2) == AXIS_2 {
            datagram.goes_to(0);
        }
    });
    // SYNC is switched off on the way down.
    let mut down = Capture::new(Vec::new()).expect("a Vec takes everything");
    let frames = Reading::of(&file).expect("a capture").frames;
    for frame in &frames {
        down.write(frame.at, frame.sent == Some(true), &frame.bytes);
    }
    let mut at = frames.last().expect("some").at;
    let station = |station, ado| Address::Station(StationAddress(station), ado);
    let mut last = vec![(Command::Bwr, Address::Broadcast(0x0120), 4, 3)];
    last.extend([0x1001, AXIS_2].map(|one| (Command::Fpwr, station(one, 0x0981), 0, 1)));
    for (command, address, value, wkc) in last {
        let mut bytes = [0; 60];
        let mut writer = FrameWriter::new(&mut bytes, [1; 6]);
        let data = writer.push(command, 9, address, &[value, 0]).expect("it is short");
        writer.finish();
        down.write(at, true, &bytes);
        bytes[6] |= 2;
        bytes[data + 2] = wkc;
        if command == Command::Bwr {
            // Each SubDevice counts itself.
            bytes[data - 8] = wkc;
        }
        down.write(at + Duration::from_micros(5), false, &bytes);
        at += Duration::from_millis(1);
    }
    for file in [unmarked, nameless, down.finish().expect("a Vec")] {
        let (verdict, _, text) = said(&file, &claims);
        assert_eq!(verdict, VerdictKind::InSync, "{text}");
    }
}
