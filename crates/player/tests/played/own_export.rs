//! Plays the ENI export of isocat's own plan: the final registers are those of a run by the plan,
//! and each change of the file changes what happens.

use isocat_descriptions::eni::{self, Eni};
use isocat_engine::NoTap;
use isocat_engine::plan::Plan;
use isocat_player::differences::{Difference, Kind, differences};
use isocat_player::failure;
use isocat_player::virtual_segment::{self, Origin};
use isocat_player::{Played, Report, Settings, play};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sync::SyncMode;
use isocat_wire::Nanos;

const TWO_DRIVES: &str = "cycle = \"1ms\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nclock = \"40ppm\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nclock = \"-35ppm\"\n";
/// Couplers, terminals without mailbox, and two kinds of drives.
const MIXED: &str = "cycle = \"2ms\"\n\
    [[subdevice]]\ndevice = \"beckhoff_ek1100\"\n\
    [[subdevice]]\ndevice = \"beckhoff_el2502-0010\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nconnect = \"0:2\"\n\
    [[subdevice]]\ndevice = \"hpmicro_ecat_cia402_ssc\"\n";
/// No device has a clock.
const SIMPLE: &str = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\n";

fn scenario(text: &str) -> Scenario {
    let mut scenario = Scenario::from(SegmentFile::parse("test.toml", text).unwrap());
    scenario.duration = Nanos::millis(300);
    scenario
}

fn export(scenario: &Scenario) -> String {
    eni::write(&Plan::of(scenario).unwrap().start_up(scenario))
}

fn read(text: &str) -> Eni {
    Eni::from_bytes("own.xml", text.as_bytes()).unwrap()
}

fn played(text: &str, scenario: &Scenario) -> Played {
    let settings = Settings { duration: scenario.duration, tolerates_unknown_objects: false };
    play(read(text).runnable().unwrap(), scenario, settings)
}

/// The bytes that the list determines: no times, no counters, and nothing that a device writes
/// itself.
fn decided() -> impl Iterator<Item = usize> {
    let managers = (0..16).flat_map(|number| {
        let first = 0x0800 + 8 * number;
        (first..first + 5).chain([first + 6])
    });
    let others = [
        0x0010..0x0012,
        0x0120..0x0122,
        0x0130..0x0136,
        0x0400..0x0402,
        0x0420..0x0422,
        0x0600..0x0700,
        0x0930..0x0932,
        0x0934..0x0936,
        0x0980..0x0984,
        0x09A0..0x09AA,
    ];
    managers.chain(others.into_iter().flatten())
}

fn word(registers: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(registers[at..at + 4].try_into().unwrap())
}

fn long(registers: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(registers[at..at + 8].try_into().unwrap())
}

fn the_same_registers(text: &str) {
    let scenario = scenario(text);
    let run = scenario.run().execute::<NoTap>(None, &mut |_| {});
    assert!(run.failure.is_none());
    let played = played(&export(&scenario), &scenario);
    assert!(played.failure.is_none(), "{}", played.failure.unwrap());
    let ours = run.world.segment().devices();
    let theirs = played.bus.server().served().segment().devices();
    assert_eq!(ours.len(), theirs.len());
    for (position, (one, other)) in ours.iter().zip(theirs).enumerate() {
        let (one, other) = (one.esc.registers(), other.esc.registers());
        for at in decided() {
            assert_eq!(other[at], one[at], "SubDevice {position}, register 0x{at:04X}");
        }
        let delays = [&one, &other].map(|registers| i64::from(word(&registers[..], 0x0928)));
        assert!((delays[0] - delays[1]).abs() <= 10, "SubDevice {position}: {delays:?} ns");
        let cycle = u64::from(word(&one, 0x09A0));
        if one[0x0981] & 1 != 0 {
            let phases = [&one, &other].map(|registers| long(&registers[..], 0x0990) % cycle);
            assert_eq!(phases[0], phases[1], "SubDevice {position}: phase of SYNC0");
        }
    }
}

#[test]
fn two_drives_end_with_the_registers_of_the_run() {
    the_same_registers(TWO_DRIVES);
}

#[test]
fn a_mixed_segment_ends_with_the_registers_of_the_run() {
    the_same_registers(MIXED);
}

#[test]
fn a_segment_without_clocks_ends_with_the_registers_of_the_run() {
    the_same_registers(SIMPLE);
}

/// The judges find it in sync, the working counters are right, and isocat's own list does not
/// differ from itself.
#[test]
fn it_is_in_sync_and_the_same_as_the_plan() {
    for text in [TWO_DRIVES, MIXED, SIMPLE] {
        let scenario = scenario(text);
        let eni = read(&export(&scenario));
        let played = played(&export(&scenario), &scenario);
        let plan = Plan::of(&scenario).unwrap();
        let compared = differences(&eni.start_up, &plan.start_up(&scenario), &plan);
        assert_eq!(compared, [], "{text}");
        let made = virtual_segment::of_eni(&eni, &[]).unwrap();
        let report = Report::planned(&eni, &made, Ok(compared)).with_run(&played);
        let run = report.run.as_ref().unwrap();
        assert!(run.in_sync && run.wrong_counters == 0 && run.cycles > 100, "{}", report.text());
    }
}

/// Two runs are the same to the bit.
#[test]
fn a_run_repeats_itself() {
    let scenario = scenario(TWO_DRIVES);
    let text = export(&scenario);
    assert_eq!(played(&text, &scenario).summary, played(&text, &scenario).summary);
}

/// The segment is made again from the file: built-in profiles by identity, in the modes of the
/// file.
#[test]
fn a_segment_is_made_of_the_file() {
    let text = export(&scenario(MIXED));
    let made = virtual_segment::of_eni(&read(&text), &[]).unwrap();
    assert!(made.origins.iter().all(|origin| matches!(origin, Origin::BuiltIn { .. })));
    let modes: Vec<_> = made.scenario.devices.iter().map(|device| device.mode).collect();
    assert_eq!(modes[2..], [Some(SyncMode::DcSync0); 2], "{}", made.text);
    assert_ne!(modes[1], Some(SyncMode::DcSync0), "{}", made.text);
    let played = played(&text, &made.scenario);
    assert!(played.failure.is_none(), "{}", played.failure.unwrap());
}

/// A device without a profile is made from the file alone, and runs.
#[test]
fn a_device_that_nothing_describes_is_made_of_the_file() {
    let text = export(&scenario(TWO_DRIVES)).replace("<ProductCode>", "<ProductCode>9");
    let eni = read(&text);
    let made = virtual_segment::of_eni(&eni, &[]).unwrap();
    assert_eq!(made.origins, [Origin::Eni, Origin::Eni], "{}", made.text);
    let settings = Settings { duration: Nanos::millis(300), tolerates_unknown_objects: true };
    let played = play(eni.runnable().unwrap(), &made.scenario, settings);
    assert!(played.failure.is_none(), "{}\n{}", played.failure.unwrap(), made.text);
}

/// The list is executed to the letter: a wrong working counter in it ends the way up.
#[test]
fn a_wrong_working_counter_is_told() {
    let scenario = scenario(TWO_DRIVES);
    let text = export(&scenario);
    assert!(text.contains("<Cnt>6</Cnt>"), "two devices that are read and written: {text}");
    let failure = played(&text.replace("<Cnt>6</Cnt>", "<Cnt>5</Cnt>"), &scenario).failure.unwrap();
    assert_eq!(failure.kind, failure::Kind::ProcessData { expected: 5, found: 6 });
}

/// A refused command is reported with its place, its comment and the AL status code.
#[test]
fn a_refused_state_is_told_with_its_place() {
    let scenario = scenario(TWO_DRIVES);
    let list = Plan::of(&scenario).unwrap().start_up(&scenario);
    let mut broken = list.clone();
    // SyncManager 2 of the second drive gets a wrong setting.
    let step = broken.devices[1].registers.iter_mut().find(|step| {
        matches!(
            step.address,
            isocat_descriptions::start_up::Address::Physical { register: 0x0810, .. }
        )
    });
    step.unwrap().data[2] ^= 1;
    let failure = played(&eni::write(&broken), &scenario).failure.unwrap();
    let place = failure.place.as_ref().unwrap();
    assert_eq!(place.device.as_ref().unwrap().0, 1);
    assert_eq!(place.transition.to_string(), "PS");
    let failure::Kind::Check { code, .. } = &failure.kind else { panic!("{failure}") };
    assert_eq!(code.unwrap().0, 0x001D, "{failure}");
}

/// The shift of the file is run: the judges find SYNC0 during the copying, and the comparison tells
/// by how much the shift does not fit.
#[test]
fn a_shift_that_does_not_fit_is_run_and_told() {
    let scenario = scenario(TWO_DRIVES);
    let plan = Plan::of(&scenario).unwrap();
    let mut list = plan.start_up(&scenario);
    for device in &mut list.devices {
        device.dc.as_mut().unwrap().shift_ns = 20_000;
    }
    let text = eni::write(&list);
    let played = played(&text, &scenario);
    let eni = read(&text);
    let made = virtual_segment::of_eni(&eni, &[]).unwrap();
    let compared = differences(&eni.start_up, &plan.start_up(&scenario), &plan);
    let kinds: Vec<Kind> = compared.iter().map(|one| one.kind).collect();
    assert_eq!(kinds, [Kind::Shift, Kind::Shift]);
    let fits = "every line of the plan's budget fits with the ENI's phase too";
    assert!(compared.iter().all(|one| one.consequence != fits), "{compared:?}");
    let report = Report::planned(&eni, &made, Ok(compared)).with_run(&played);
    assert!(!report.run.unwrap().in_sync);
}

/// Tests each kind of difference, by a change that causes it.
#[test]
fn differences_have_kinds() {
    // A device that gets its type and cycle by SDO.
    let scenario =
        scenario("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"hpmicro_ecat_cia402_ssc\"\n");
    let plan = Plan::of(&scenario).unwrap();
    let ours = plan.start_up(&scenario);
    assert!(ours.devices[0].objects.len() >= 2, "{}", ours.text());
    let kinds = |change: &dyn Fn(&mut isocat_descriptions::StartUp)| {
        let mut list = ours.clone();
        change(&mut list);
        let found: Vec<Difference> = differences(&list, &ours, &plan);
        found.iter().map(|one| one.kind).collect::<Vec<_>>()
    };
    let set = |list: &mut isocat_descriptions::StartUp, at: u16, byte: usize, value: u8| {
        let step = list.devices[0].registers.iter_mut().find(|step| {
            matches!(step.address, isocat_descriptions::start_up::Address::Physical { register, .. } if register == at)
        });
        step.expect("the plan writes it").data[byte] = value;
    };
    assert_eq!(kinds(&|_| {}), []);
    assert_eq!(kinds(&|list| set(list, 0x09A0, 0, 1)), [Kind::Sync0Cycle]);
    assert_eq!(kinds(&|list| set(list, 0x0810, 2, 1)), [Kind::SyncManager]);
    assert_eq!(kinds(&|list| set(list, 0x0600, 4, 1)), [Kind::Fmmu]);
    assert_eq!(kinds(&|list| set(list, 0x0600, 0, 7)), [Kind::ImagePlace]);
    let objects = kinds(&|list| list.devices[0].objects.clear());
    let (sync, assigned) = (Kind::SyncObject, Kind::PdoAssignment);
    assert_eq!(objects, [assigned, assigned, sync, sync]);
    assert_eq!(
        kinds(&|list| list.frames[0].datagrams.retain(|one| one.working_counter.is_some())),
        [Kind::Frames, Kind::DriftDatagram, Kind::StateWatch, Kind::ReferenceClock][..3]
    );
}

/// A list that starts SYNC but distributes no time is refused before anything is sent.
#[test]
fn sync_without_a_drift_datagram_is_refused() {
    let scenario = scenario(TWO_DRIVES);
    let mut list = Plan::of(&scenario).unwrap().start_up(&scenario);
    list.frames[0].datagrams.retain(|one| one.working_counter.is_some());
    let played = played(&eni::write(&list), &scenario);
    let failure = played.failure.unwrap();
    assert_eq!(failure.kind, failure::Kind::NoDriftDatagram { position: 0 });
    assert!(failure.kind.is_refused() && played.summary.frames == 0);
}

/// A device that differs from the file's is a clear error, with its line.
#[test]
fn a_segment_of_other_devices_is_refused() {
    let eni = read(&export(&scenario(TWO_DRIVES)));
    let file = |text: &str| SegmentFile::parse("mine.toml", text).unwrap();
    let other = file(
        "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n[[subdevice]]\ndevice = \"simple_io4\"\n",
    );
    let error = virtual_segment::of_file(&eni, other).unwrap_err();
    assert_eq!((error.path.as_str(), error.line), ("mine.toml", 4));
    assert!(
        error.message.contains("device 1") && error.message.contains("expected vendor"),
        "{error}"
    );
    let few = file("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n");
    let error = virtual_segment::of_file(&eni, few).unwrap_err();
    assert!(error.message.contains("1 devices; expected 2"), "{error}");
    let slow = file(&TWO_DRIVES.replace("1ms", "2ms"));
    assert!(
        virtual_segment::of_file(&eni, slow).unwrap_err().message.contains("expected 1000000 ns")
    );
    let right = virtual_segment::of_file(&eni, file(TWO_DRIVES)).unwrap();
    assert_eq!(right.origins, [Origin::SegmentFile, Origin::SegmentFile]);
}
