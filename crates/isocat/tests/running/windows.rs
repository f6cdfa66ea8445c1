//! Windows of described devices: registers of distributed clocks that an FMMU alone maps into the
//! process image. What a run reads there is held against true time, against the drift frames of the
//! same cycles, and against pins that are driven.

use isocat::esi::{EsiFile, Purpose, WarningKind};
use isocat::plan::Plan;
use isocat::profile::Profile;
use isocat::start_up::DeviceStartUp;
use isocat::{Nanos, Scenario, SegmentFile, run};
use isocat_descriptions::esi::Direction;
use isocat_descriptions::sii::SiiFile;
use isocat_esc::LatchInput;
use isocat_maindevice::{Cycle, Event};
use isocat_sim::{Tap, World};
use isocat_wire::dc::SyncActivation;
use isocat_wire::register;
use isocat_wire::sii::{SmRecord, categories, category, sm_type};
use isocat_wire::time::{Picos, Time, True};

const FILE: &str = include_str!("../esi/windows.xml");

/// A segment of devices of a file, each with its keys.
fn segment(name: &str, text: &str, devices: &[&str]) -> SegmentFile {
    let path =
        std::env::temp_dir().join(format!("isocat-windows-{}-{name}.xml", std::process::id()));
    std::fs::write(&path, text).unwrap();
    let mut toml = "cycle = \"1ms\"\nfor = \"20ms\"\n".to_owned();
    for keys in devices {
        toml += &format!("[[subdevice]]\nesi = {path:?}\n{keys}\n");
    }
    let file = SegmentFile::parse("s.toml", &toml);
    std::fs::remove_file(&path).unwrap();
    file.unwrap()
}

fn start_up(segment: SegmentFile) -> DeviceStartUp {
    let scenario = Scenario::from(segment);
    Plan::of(&scenario).unwrap().start_up(&scenario).devices.remove(0)
}

/// Logical address, length, physical address and kind of an FMMU.
type Mapped = (u32, u16, u16, u8);

/// SyncManagers that are written, and FMMUs with their place in the process image: (logical, bytes,
/// address, kind).
fn written(device: &DeviceStartUp) -> (Vec<u16>, Vec<Mapped>) {
    let (mut managers, mut fmmus) = (Vec::new(), Vec::new());
    for step in &device.registers {
        let isocat::start_up::Address::Physical { register, .. } = step.address else { continue };
        let d = &step.data;
        let word = |at: usize| u16::from_le_bytes([d[at], d[at + 1]]);
        match register {
            0x0800..0x0880 => managers.push((register - 0x0800) / 8),
            0x0600..0x0700 => {
                fmmus.push((u32::from(word(0)) | u32::from(word(2)) << 16, word(4), word(8), d[11]))
            }
            _ => {}
        }
    }
    (managers, fmmus)
}

struct NoTap;

impl Tap for NoTap {
    fn frame(&mut self, _: Time<True>, _: bool, _: &[u8]) {}
}

/// What came back in one cycle: system time at which its first frame passed the reference, and the
/// inputs of each device.
type Seen = Vec<(u64, Vec<Vec<u8>>)>;

/// Collects what comes back.
struct Collect {
    devices: usize,
    seen: Seen,
}

impl isocat_maindevice::Application for Collect {
    fn cycle(&mut self, cycle: &mut Cycle<'_>) {
        let Some(time) = cycle.reference_time() else { return };
        let inputs = (0..self.devices).map(|device| cycle.inputs(device).to_vec());
        self.seen.push((time.count(), inputs.collect()));
    }
}

type Run = World<Collect, NoTap>;

fn in_operation(segment: SegmentFile) -> Run {
    let devices = segment.subdevices.len();
    let setup = Scenario::from(segment).run().setup;
    let mut world = World::new(setup, Collect { devices, seen: Vec::new() }, None::<NoTap>);
    loop {
        assert!(world.step(Time::new(60_000_000_000_000)), "not in operation after a minute");
        while let Some(event) = world.poll_event() {
            match event {
                Event::InOperation { .. } => return world,
                Event::Failed(error) => panic!("{error}"),
                _ => {}
            }
        }
    }
}

/// What comes back in the next cycles.
fn cycles(world: &mut Run, count: i64) -> Seen {
    world.application_mut().seen.clear();
    let end = world.now() + Picos::from(Nanos::millis(count));
    while world.step(end) {
        while world.poll_event().is_some() {}
    }
    std::mem::take(&mut world.application_mut().seen)
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

const STAMPS: &str = "type = \"Stamps\"\nopmode = 0";
const NEXT: &str = "type = \"Next\"";

/// The image has the SyncManagers in the order of their numbers, whatever the order of the PDOs in
/// the file: 1 byte of the channel, 10 bytes of the latch unit, 8 bytes of system time.
#[test]
fn system_time_moves_on_in_the_process_image() {
    let mut world = in_operation(segment("time", FILE, &[STAMPS, STAMPS]));
    let seen = cycles(&mut world, 50);
    assert!(seen.len() >= 49, "{}", seen.len());
    for (reference, inputs) in &seen {
        let lengths: Vec<_> = inputs.iter().map(Vec::len).collect();
        assert_eq!(lengths, [19, 19]);
        // The ESC latches it at the start of the frame, so that the drift frame of the same cycle
        // has the same.
        assert_eq!(u64_at(&inputs[0], 11), *reference);
        let difference = u64_at(&inputs[1], 11) as i64 - *reference as i64;
        assert!(difference.abs() < 200, "{difference} ns from the reference clock");
    }
    for pair in seen.windows(2) {
        let step = u64_at(&pair[1].1[0], 11) - u64_at(&pair[0].1[0], 11);
        assert!((960_000..1_040_000).contains(&step), "a cycle of {step} ns");
    }
    // And it is the true time of the clock: read between the last frame and now.
    let now = world.segment().devices()[0].system_time_ps(world.now()) / 1_000;
    let age = now - i128::from(u64_at(&seen.last().unwrap().1[0], 11));
    assert!((0..1_000_000).contains(&age), "{age} ns old");
}

/// A pin of the latch unit rises in the middle of a run: its status and the time of the edge are
/// the inputs.
#[test]
fn an_edge_of_a_latch_pin_has_its_time_in_the_process_image() {
    let mut world = in_operation(segment("latch", FILE, &[STAMPS]));
    let before = cycles(&mut world, 5);
    assert!(before.iter().all(|(_, inputs)| inputs[0][1..11] == [0; 10]), "no edge yet");
    let at = world.now();
    let device = world.segment_mut().device_mut(0);
    let edge = device.system_time_ps(at);
    let local = device.oscillator().read(at);
    device.esc.set_latch_input(LatchInput::Latch0, true, local);
    device.disturbed();
    let after = cycles(&mut world, 5);
    let inputs = &after.last().unwrap().1[0];
    // Bit 2 of 0x09AE is the level of the pin; edges are not kept for their reader unless 0x09A8
    // says so.
    assert_eq!((inputs[1], inputs[2]), (0x04, 0x00));
    let late = i128::from(u64_at(inputs, 3)) * 1_000 - edge;
    assert!((-1_000..12_000).contains(&late), "stamped {late} ps behind the edge");
}

/// The window lies in front of nothing else of its direction, and the windows of outputs are told
/// and left alone.
#[test]
fn the_next_sync0_is_read_and_the_sync_unit_stays_the_plans() {
    let file = segment("next", FILE, &[NEXT]);
    let notes: Vec<_> =
        file.subdevices[0].profile.doubts.iter().map(|doubt| doubt.kind.name()).collect();
    assert_eq!(notes, ["window-not-mapped"]);
    let told = &file.subdevices[0].profile.doubts[0].what;
    assert!(told.starts_with("SyncManager 1, a window of outputs on 0x0981,"), "{told}");
    let listed = start_up(file.clone());
    let (managers, fmmus) = written(&listed);
    assert_eq!(managers, [2]);
    assert_eq!(fmmus, [(0, 2, 0x1000, 2), (0, 8, 0x0990, 1)]);
    assert!(listed.notes.iter().any(|note| note.contains("0x0981")), "{:?}", listed.notes);
    let window = listed.sync_managers.iter().find(|manager| manager.number == 0).unwrap();
    assert_eq!((window.enabled, &window.pdos[..]), (false, &[0x1A02][..]));

    let report = run(&Scenario::from(file.clone()));
    assert!(report.in_sync, "{}", report.text());
    assert_eq!(report.devices[0].mode.name(), "dc-sync0");

    let mut world = in_operation(file);
    let seen = cycles(&mut world, 20);
    for (reference, inputs) in &seen {
        let ahead = u64_at(&inputs[0], 0) as i64 - *reference as i64;
        assert!((0..=1_000_000).contains(&ahead), "the next pulse in {ahead} ns");
    }
    for pair in seen.windows(2) {
        assert_eq!(u64_at(&pair[1].1[0], 0) - u64_at(&pair[0].1[0], 0), 1_000_000);
    }
    let esc = &world.segment().devices()[0].esc;
    assert_eq!(esc.register(register::SYNC_ACTIVATION), SyncActivation(0x03));
}

#[test]
fn an_op_mode_changes_what_a_window_has() {
    let of = |mode: usize| {
        let keys = format!("type = \"Stamps\"\nopmode = {mode}");
        start_up(segment(&format!("mode{mode}"), FILE, &[&keys]))
    };
    let (managers, fmmus) = written(&of(0));
    assert_eq!(managers, [0], "windows are no SyncManagers");
    assert_eq!(fmmus, [(0, 1, 0x1000, 1), (1, 10, 0x09AE, 1), (11, 8, 0x0910, 1)]);
    assert_eq!(written(&of(1)).1, [(0, 1, 0x1000, 1), (1, 10, 0x09AE, 1), (11, 4, 0x0910, 1)]);
    let report = run(&Scenario::from(segment("short", FILE, &["type = \"Stamps\"\nopmode = 1"])));
    assert!(report.in_sync, "{}", report.text());
}

/// The records of a profile's SII, and the device of an image that the maker's tool would write.
#[test]
fn the_sii_has_the_window_and_reads_back() {
    let file = EsiFile::from_bytes("windows.xml", FILE.as_bytes()).unwrap();
    let device = &file.devices[0];
    let purposes: Vec<_> = device.sync_managers.iter().map(|sm| sm.purpose).collect();
    let window = Purpose::Window(Some(Direction::Inputs));
    assert_eq!(purposes, [Purpose::Inputs, window, window]);
    let profile = Profile::from_esi(&file, device, Some(0)).unwrap();
    let found = categories(&profile.sii).flatten().find(|c| c.kind == category::SYNC_MANAGER);
    let records: Vec<_> = found.unwrap().data.chunks_exact(8).collect();
    let records: Vec<_> =
        records.iter().map(|bytes| SmRecord::parse(bytes.first_chunk().unwrap())).collect();
    let seen: Vec<_> = records.iter().map(|sm| (sm.start, sm.length, sm.enable, sm.kind)).collect();
    let inputs = sm_type::INPUTS;
    let expected = [
        (0x1000, 1, SmRecord::ENABLED, inputs),
        (0x09AE, 10, SmRecord::VIRTUAL, inputs),
        (0x0910, 8, SmRecord::VIRTUAL, inputs),
    ];
    assert_eq!(seen, expected);

    // Windows of outputs are in the maker's image, and stay unmapped by it.
    for (position, windows) in [(0, &[1, 2][..]), (1, &[0][..])] {
        let device = &file.devices[position];
        let image = file.image_of_sii(device).unwrap();
        let read = EsiFile::of_sii(&SiiFile::from_bytes("windows.bin", &image.bytes).unwrap());
        let again = &read.devices[0];
        let purposes = |device: &isocat::esi::EsiDevice| -> Vec<_> {
            device.sync_managers.iter().map(|sm| sm.purpose).collect()
        };
        assert_eq!(purposes(again), purposes(device));
        let lists = |device: &isocat::esi::EsiDevice| -> Vec<(u8, Vec<u16>)> {
            let image = device.image(None);
            let all = image.outputs.iter().chain(&image.inputs);
            all.map(|(number, pdos)| (*number, pdos.iter().map(|pdo| pdo.index).collect()))
                .collect()
        };
        assert_eq!(lists(again), lists(device));
        assert!(
            windows.iter().all(|number| lists(device).iter().any(|(known, _)| known == number))
        );
        assert_eq!(again.output_windows(None), device.output_windows(None));
    }
}

/// A device with this many windows that don't lie behind each other, and one byte of its own.
fn with_windows(count: usize) -> String {
    let starts = [0x0910, 0x0918, 0x0920, 0x0928, 0x0990, 0x0998, 0x09B0, 0x09B8];
    let mut text =
        "<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions><Devices><Device Physics=\"YY\">\
                    <Type ProductCode=\"2\" RevisionNo=\"3\">Many</Type>\
                    <Sm StartAddress=\"#x1000\" ControlByte=\"#x20\" Enable=\"1\">Inputs</Sm>"
            .to_owned();
    for start in &starts[..count] {
        text += &format!("<Sm StartAddress=\"#x{start:04X}\" Virtual=\"1\">Inputs</Sm>");
    }
    for number in 0..=count {
        let bits = if number == 0 { 8 } else { 16 };
        text += &format!(
            "<TxPdo Sm=\"{number}\"><Index>{}</Index><Entry><Index>#x6000</Index><SubIndex>{}</SubIndex>\
             <BitLen>{bits}</BitLen></Entry></TxPdo>",
            0x1A00 + number,
            1 + number
        );
    }
    text + "<Dc/><Eeprom><ConfigData>050C00000000</ConfigData></Eeprom></Device></Devices></Descriptions></EtherCATInfo>"
}

/// An ET1100 has 8 FMMUs: one for the SyncManager and seven windows, and one window more.
#[test]
fn each_window_needs_an_fmmu() {
    let of = |count: usize| segment(&format!("many{count}"), &with_windows(count), &[""]);
    assert_eq!(written(&start_up(of(7))).1.len(), 8);
    let report = run(&Scenario::from(of(7)));
    assert!(report.in_sync, "{}", report.text());

    let too_many = "SubDevice 0 (0x1001, Many): 9 FMMUs needed, 8 there";
    let scenario = Scenario::from(of(8));
    let error = Plan::of(&scenario).expect_err("too few").to_string();
    assert!(error.contains("9 FMMUs needed, 8 there"), "{error}; expected {too_many}");
    let report = run(&scenario);
    assert!(
        !report.in_sync && report.text().contains("9 FMMUs needed, 8 there"),
        "{}",
        report.text()
    );
}

/// What can't be read stays out, by name, and the device runs as it did.
#[test]
fn windows_that_are_left_out() {
    let left_out = |text: &str| {
        let file = segment("left-out", text, &["type = \"Stamps\"\nopmode = 0"]);
        let doubts = file.subdevices[0].profile.doubts.clone();
        let report = run(&Scenario::from(file.clone()));
        assert!(report.in_sync, "{}", report.text());
        let told: Vec<_> = doubts.iter().filter(|d| d.kind.name() == "window-not-mapped").collect();
        (
            told.iter().map(|doubt| doubt.what.clone()).collect::<Vec<_>>(),
            written(&start_up(file)).1,
        )
    };
    // The last byte of the latch times, and one more.
    for (start, mapped) in
        [("#x09C6", true), ("#x09C7", false), ("#x0990", true), ("#x098F", false)]
    {
        let (told, fmmus) = left_out(&FILE.replace("#x09AE", start));
        assert_eq!(
            (told.is_empty(), fmmus.len()),
            (mapped, if mapped { 3 } else { 2 }),
            "{start}: {told:?}"
        );
    }
    // A mailbox with a window for its answers is no mailbox, and nothing is assigned there.
    let text = FILE.replace("Virtual=\"1\">Inputs", "Virtual=\"1\">MBoxIn");
    let file = EsiFile::from_bytes("windows.xml", text.as_bytes()).unwrap();
    assert_eq!(file.devices[0].sync_managers[2].purpose, Purpose::Window(None));
    let warned: Vec<_> = file.devices[0].warnings.iter().map(|warning| warning.kind).collect();
    assert_eq!(warned, [WarningKind::SyncManagerVirtual, WarningKind::PdoSyncManager]);
}
