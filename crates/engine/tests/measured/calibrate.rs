//! Calibrations of virtual segments: the result is what was set, within the stated error.
//!
//! `ISOCAT_SEEDS=10` tries more segments whose crystals wander.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use isocat_conform::wire::{Seen, VirtualWire, Wire};
use isocat_engine::calibrate::{self, Calibration, Clock, Operating, Trouble, Verdict};
use isocat_engine::report::calibrate::{CalibrationReport, ClockKind, NoFragment};
use isocat_esc::DriftLaw;
use isocat_segment::profile::{self, Profile};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::oscillator::{Ramp, Walk};
use isocat_sim::random::Stream;
use isocat_wire::dc::DifferencePolarity::{self, NegativeAhead, PositiveAhead};
use isocat_wire::time::{Host, Nanos, Time};

/// A follower: its law as the profile has it, its polarity, its crystal in ppm.
type Follower = (DriftLaw, DifferencePolarity, f64);

const HOLD_10: DriftLaw = DriftLaw::Hold { phase: 10 };
const HOLD_11: DriftLaw = DriftLaw::Hold { phase: 11 };
const BLOCK_9: DriftLaw = DriftLaw::Block { phase: 9 };
const BLOCK_10: DriftLaw = DriftLaw::Block { phase: 10 };

/// A separate file for each profile, as segment files name them.
fn profile_file(law: DriftLaw, polarity: DifferencePolarity) -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    let (name, phase) = match law {
        DriftLaw::Hold { phase } => ("hold", format!("drift_phase = {phase}\n")),
        DriftLaw::Block { phase } => ("block", format!("drift_phase = {phase}\n")),
        DriftLaw::Proportional { .. } => ("proportional", String::new()),
    };
    let polarity = match polarity {
        PositiveAhead => "positive-ahead",
        NegativeAhead => "negative-ahead",
    };
    let keys =
        format!("[esc]\ndrift_law = \"{name}\"\n{phase}difference_polarity = \"{polarity}\"\n");
    let text = profile::built_in_text("kollmorgen_akd2g").expect("a built-in device");
    assert!(text.contains("[esc]\n"));
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate");
    std::fs::create_dir_all(&folder).expect("a folder for profiles");
    let path = folder.join(format!("drive-{number}.toml"));
    std::fs::write(&path, text.replacen("[esc]\n", &keys, 1)).expect("a profile is written");
    path
}

/// A reference at 0 ppm, and the followers behind it.
fn segment(followers: &[Follower]) -> Scenario {
    let mut text = "cycle = \"1ms\"\nhop_jitter = false\nseed = 5\n\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
                    name = \"reference\"\nclock = \"0ppm\"\n"
        .to_owned();
    for (law, polarity, ppm) in followers {
        let path = profile_file(*law, *polarity);
        text += &format!(
            "\n[[subdevice]]\ndevice = \"{}\"\nname = \"{law} {ppm}\"\nclock = \"{ppm}ppm\"\ncable = \"3m\"\n",
            path.display()
        );
    }
    Scenario::from(SegmentFile::parse("virtual.toml", &text).expect("a segment file"))
}

/// A wire that loses frames on their way to the segment or back, and sends late as a host does.
struct Rough {
    wire: VirtualWire,
    chance: Stream,
    /// In each direction one frame in this many is lost; 0 means none.
    lost_one_of: u64,
    late: u64,
    /// Stops the calibration after this number of frames.
    stop: Option<(u64, &'static AtomicBool)>,
    sent: u64,
    /// The cable is pulled after this number of frames.
    pulled: u64,
}

impl Rough {
    fn new(scenario: Scenario) -> Self {
        Self {
            wire: VirtualWire::new(scenario),
            chance: Stream::new(3, "rough wire", 0),
            lost_one_of: 0,
            late: 0,
            stop: None,
            sent: 0,
            pulled: u64::MAX,
        }
    }

    fn loses(&mut self) -> bool {
        self.sent > self.pulled
            || self.lost_one_of > 0 && self.chance.up_to(self.lost_one_of - 1) == 0
    }
}

impl Wire for Rough {
    fn now(&self) -> Time<Host> {
        self.wire.now()
    }

    fn wait_until(&mut self, at: Time<Host>) {
        let late = self.chance.exponential(self.late).min(20 * self.late);
        self.wire.wait_until(at + Nanos(late as i64));
    }

    fn exchange(&mut self, frames: &mut [Vec<u8>]) -> Result<Vec<bool>, String> {
        self.sent += 1;
        if let Some((most, stop)) = self.stop.filter(|(most, _)| self.sent >= *most) {
            assert!(most > 0);
            stop.store(true, Ordering::Relaxed);
        }
        if self.loses() {
            self.wire.wait_until(self.wire.now() + Nanos::millis(20));
            return Ok(vec![false; frames.len()]);
        }
        let back = self.wire.exchange(frames)?;
        if self.loses() {
            self.wire.wait_until(self.wire.now() + Nanos::millis(20));
            return Ok(vec![false; frames.len()]);
        }
        Ok(back)
    }

    fn seen(&mut self, position: usize) -> Option<Vec<Seen>> {
        self.wire.seen(position)
    }

    fn lateness(&self) -> Nanos {
        Nanos::ZERO
    }
}

fn calibrated(wire: &mut dyn Wire) -> Calibration {
    calibrate::calibrate(wire, &AtomicBool::new(false), &mut |_| {}).expect("it comes to its end")
}

fn check(clock: &Clock, (law, polarity, ppm): Follower, reference_ppm: f64) {
    assert_eq!(clock.polarity, Some(polarity), "{law} {ppm}");
    let (ppb, error) = clock.crystal_ppb;
    let expected = (1.0 + ppm * 1e-6) / (1.0 + reference_ppm * 1e-6) * 1e9 - 1e9;
    assert!((ppb - expected).abs() < 5.0 * error.max(0.2), "{law} {ppm}: {ppb} {error}");
    assert!(error > 0.05 && error < 2.0, "{error}");
    let Verdict::Told(fit) = &clock.law.verdict else {
        panic!("{law} at {ppm} ppm: {:?}", clock.law);
    };
    assert_eq!(fit.law, law, "at {ppm} ppm: {:?}", clock.law);
    // A fit that is too good is wrong, too.
    assert!((0.1..2.0).contains(&fit.misfit), "{law} at {ppm} ppm: {:?}", clock.law);
    if let DriftLaw::Hold { phase } | DriftLaw::Block { phase } = law {
        let (found, error) = fit.parameter.expect("a phase");
        assert!((found - f64::from(phase)).abs() < 4.0 * error, "{law} at {ppm}: {found} {error}");
        assert!((0.0005..0.1).contains(&error), "{law} at {ppm}: {found} {error}");
    }
}

const ALL: [Follower; 5] = [
    (HOLD_10, PositiveAhead, 7.0),
    (HOLD_11, NegativeAhead, -31.5),
    (BLOCK_9, PositiveAhead, 0.3),
    (BLOCK_10, NegativeAhead, 48.0),
    (DriftLaw::PROPORTIONAL, PositiveAhead, -12.0),
];

#[test]
fn each_law_is_found() {
    let mut wire = VirtualWire::new(segment(&ALL));
    let found = calibrated(&mut wire);
    assert!(found.left_changed.is_empty());
    for (device, follower) in found.devices[1..].iter().zip(ALL) {
        println!("{:?}", device.clock);
        println!("{:?}", device.hop);
        println!("{:?}", device.response);
        check(device.clock.as_ref().expect("a clock"), follower, 0.0);
    }
}

/// Registers of all clocks that a calibration writes, as one text.
fn registers(wire: &mut dyn Wire, count: u16) -> String {
    use isocat_wire::datagram::{Address, datagrams};
    use isocat_wire::frame::{self, FrameWriter};
    use isocat_wire::{AutoIncrementAddress, Command};
    let mut text = String::new();
    for position in 0..count {
        for (address, len) in [
            (0x0010, 2),
            (0x0100, 4),
            (0x0130, 2),
            (0x0500, 1),
            (0x0800, 16),
            (0x0920, 12),
            (0x0930, 2),
            (0x0934, 2),
            (0x0980, 2),
        ] {
            let mut bytes = vec![0; 128];
            let mut writer = FrameWriter::new(&mut bytes, [2, 0, 0, 0, 0, 1]);
            let at = Address::Position(AutoIncrementAddress::of_position(position), address);
            writer.push(Command::Aprd, 0, at, &vec![0; len]).expect("it fits");
            let len = writer.finish();
            bytes.truncate(len);
            let mut frames = [bytes];
            assert_eq!(wire.exchange(&mut frames), Ok(vec![true]));
            let payload = frame::payload(&frames[0]).expect("a frame");
            let back = datagrams(payload).next().and_then(Result::ok).expect("a datagram");
            text += &format!("{position} {address:04X} {} {:02X?}\n", back.wkc, back.data);
        }
    }
    text
}

/// Writes memory of one device.
fn write(wire: &mut dyn Wire, position: u16, address: u16, data: &[u8]) {
    use isocat_wire::datagram::Address;
    use isocat_wire::frame::FrameWriter;
    use isocat_wire::{AutoIncrementAddress, Command};
    let mut bytes = vec![0; 64];
    let mut writer = FrameWriter::new(&mut bytes, [2, 0, 0, 0, 0, 1]);
    let at = Address::Position(AutoIncrementAddress::of_position(position), address);
    writer.push(Command::Apwr, 0, at, data).expect("it fits");
    let len = writer.finish();
    bytes.truncate(len);
    assert_eq!(wire.exchange(&mut [bytes]), Ok(vec![true]));
}

/// Switches the mailboxes on and goes to PREOP.
fn to_preop(wire: &mut dyn Wire, position: u16) {
    write(wire, position, 0x0800, &[0x00, 0x10, 0x00, 0x01, 0x26, 0x00, 0x01, 0x00]);
    write(wire, position, 0x0808, &[0x00, 0x11, 0x00, 0x01, 0x22, 0x00, 0x01, 0x00]);
    write(wire, position, 0x0120, &[0x02, 0x00]);
    wire.wait_until(wire.now() + Nanos::millis(10));
    assert!(registers(wire, position + 1).contains(&format!("{position} 0130 1 [02, 00]")));
}

/// On a wire that loses frames in both directions, with a host that is late by 30 us on average.
#[test]
fn lost_and_late_frames_leave_the_result() {
    let mut wire = Rough::new(segment(&ALL[..3]));
    (wire.lost_one_of, wire.late) = (400, 30_000);
    let found = calibrated(&mut wire);
    assert!(found.frames.1 > 20, "frames are lost: {:?}", found.frames);
    assert!(found.paced.1 > Nanos::millis(20), "and one is missed: {:?}", found.paced);
    assert!(found.left_changed.is_empty());
    for (device, follower) in found.devices[1..].iter().zip(ALL) {
        println!("{:?}", device.clock);
        check(device.clock.as_ref().expect("a clock"), follower, 0.0);
    }
}

/// Offsets, delays, filters, states, SyncManagers and EEPROM are restored, at the end and after an
/// early end.
#[test]
fn everything_is_put_back() {
    static STOP: AtomicBool = AtomicBool::new(false);
    // From the first steps to the last course.
    for most in [12, 60, 400, 1_000, 1_500, 4_000, 7_000, u64::MAX] {
        STOP.store(false, Ordering::Relaxed);
        let mut wire = Rough::new(segment(&ALL[..2]));
        to_preop(&mut wire, 1);
        let before = registers(&mut wire, 3);
        wire.sent = 0;
        wire.stop = Some((most, &STOP));
        let result = calibrate::calibrate(&mut wire, &STOP, &mut |_| {});
        match most {
            u64::MAX => assert_eq!(result.expect("no stop").left_changed, []),
            _ => assert_eq!(result, Err(Trouble::Stopped), "behind {most} frames"),
        }
        wire.stop = None;
        assert_eq!(registers(&mut wire, 3), before, "behind {most} frames");
    }
}

/// What cannot be restored is reported: here the cable is pulled during the calibration.
#[test]
fn a_pulled_cable_is_told() {
    for pulled in [100, 2_000, 5_000] {
        let mut wire = Rough::new(segment(&ALL[..2]));
        wire.pulled = pulled;
        let result = calibrate::calibrate(&mut wire, &AtomicBool::new(false), &mut |_| {});
        let Err(Trouble::NotPutBack { position, why, first }) = result else {
            panic!("{pulled}: {result:?}");
        };
        assert!(position < 3 && matches!(*why, Trouble::Lost { .. }), "{position}: {why}");
        assert!(matches!(*first, Trouble::Lost { .. }), "{first}");
        assert!(wire.sent < pulled + 1_000, "it gives up soon: {}", wire.sent);
    }
}

/// A device without a system clock, with receive times or without, is left out; a single clock is
/// refused.
#[test]
fn devices_without_a_clock_are_left_out() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate");
    std::fs::create_dir_all(&folder).expect("a folder for profiles");
    let path = folder.join("no-clock.toml");
    let text = profile::built_in_text("simple_io4").expect("a built-in device");
    let without = text
        .replacen("chip = \"ET1100\"", "chip = \"ET1200\"", 1)
        .replacen("sync_unit = true", "sync_unit = false", 1)
        .replacen("ports = \"YYY\"", "ports = \"YY\"", 1);
    assert_ne!(text, without);
    std::fs::write(&path, without).expect("a profile is written");
    let path = path.display().to_string();
    let with = |devices: &[&str]| {
        let lines = devices.iter().enumerate().map(|(number, device)| {
            format!("[[subdevice]]\ndevice = \"{device}\"\nname = \"{number}\"\ncable = \"3m\"\n")
        });
        let text = format!("cycle = \"1ms\"\nhop_jitter = false\n{}", lines.collect::<String>());
        VirtualWire::new(Scenario::from(SegmentFile::parse("virtual.toml", &text).expect("a file")))
    };
    let stop = AtomicBool::new(false);
    let drive = "kollmorgen_akd2g";
    for few in [&[drive][..], &[&path, drive]] {
        let mut wire = with(few);
        let count = few.len() as u16;
        let before = registers(&mut wire, count);
        let alone = calibrate::calibrate(&mut wire, &stop, &mut |_| {});
        assert_eq!(alone, Err(Trouble::NoClocks { found: 1 }));
        assert_eq!(registers(&mut wire, count), before);
    }
    let found = calibrated(&mut with(&[drive, &path, drive]));
    let devices = &found.devices;
    assert_eq!(found.reference, 0);
    assert!(devices[1].clock.is_none() && !devices[1].has_clock);
    assert_eq!(devices[2].clock.as_ref().map(|clock| &clock.polarity), Some(&Some(PositiveAhead)));
    assert!(matches!(devices[2].clock.as_ref().expect("a clock").law.verdict, Verdict::Told(_)));
    // The device is reported as left out, with its times of EEPROM and states.
    let report = CalibrationReport::new("virtual.toml", &found);
    assert!(report.complete);
    assert_eq!(report.devices[1].clock, ClockKind::ReceiveTimes);
    assert!(report.devices[1].law.is_none() && report.devices[1].eeprom_read.is_some());
}

/// The fragment is valid in a profile, and the device then has the measured properties. If clocks
/// differ, one must be named.
#[test]
fn a_profile_takes_what_was_measured() {
    let followers = [ALL[1], ALL[2]];
    let found = calibrated(&mut VirtualWire::new(segment(&followers)));
    let report = CalibrationReport::new("virtual.toml", &found);
    assert_eq!(report.profile(None), Err(NoFragment::Differ(vec![1, 2])));
    assert_eq!(report.profile(Some(0)), Err(NoFragment::NotTold(0)));
    let text = profile::built_in_text("kollmorgen_akd2g").expect("a built-in device");
    for (position, (law, polarity, _)) in (1..).zip(followers) {
        let fragment = report.profile(Some(position)).expect("a fragment");
        let whole = text.replacen("[esc]\n", &fragment, 1);
        let profile = Profile::from_toml("measured.toml", &whole).expect("a profile");
        assert_eq!(profile.esc().drift_law, law, "{fragment}");
        assert_eq!(profile.esc().difference_polarity, polarity, "{fragment}");
    }
}

/// A segment in operation is refused before anything is written.
#[test]
fn a_segment_in_operation_is_refused() {
    let mut wire = VirtualWire::new(segment(&ALL[..1]));
    write(&mut wire, 1, 0x09A0, &1_000_000u32.to_le_bytes());
    write(&mut wire, 1, 0x0981, &[3]);
    let before = registers(&mut wire, 2);
    let result = calibrate::calibrate(&mut wire, &AtomicBool::new(false), &mut |_| {});
    assert_eq!(result, Err(Trouble::InOperation { position: 1, what: Operating::Sync }));
    assert_eq!(registers(&mut wire, 2), before);
}

/// An unknown law is not mistaken for one of the known laws.
#[test]
fn an_unknown_law_fits_none() {
    let unknown = [
        DriftLaw::Proportional { gain: 3, limit: 60 },
        DriftLaw::Hold { phase: 4 },
        DriftLaw::Block { phase: 17 },
    ];
    for law in unknown {
        let mut scenario = segment(&ALL[..1]);
        scenario.drift_law = Some(law);
        let found = calibrated(&mut VirtualWire::new(scenario));
        for device in &found.devices[1..] {
            let clock = device.clock.as_ref().expect("a clock");
            assert_eq!(clock.law.verdict, Verdict::NoneFits, "{law}: {:?}", clock.law);
        }
        let report = CalibrationReport::new("virtual.toml", &found);
        assert!(!report.complete);
        assert_eq!(report.profile(None), Err(NoFragment::None));
    }
}

/// Counters of 32 bits wrap every 4.3 s, in the reference and behind it.
#[test]
fn clocks_of_32_bits_are_calibrated_too() {
    let narrow = |number: usize, (law, polarity, ppm): Follower| {
        let path = profile_file(law, polarity);
        let text = std::fs::read_to_string(&path).expect("our own profile");
        let changed = text.replacen("chip = \"ET1100\"", "chip = \"IP_CORE_32\"", 1);
        assert_ne!(text, changed);
        std::fs::write(&path, changed).expect("a profile is written");
        format!(
            "[[subdevice]]\ndevice = \"{}\"\nname = \"{number}\"\nclock = \"{ppm}ppm\"\n",
            path.display()
        )
    };
    let wide = "[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"wide\"\nclock = \"20ppm\"\n";
    let first = (HOLD_10, PositiveAhead, -40.0);
    let text = format!(
        "cycle = \"1ms\"\nhop_jitter = false\n{}{}{wide}",
        narrow(0, first),
        narrow(1, ALL[3])
    );
    let file = SegmentFile::parse("virtual.toml", &text).expect("a segment file");
    let found = calibrated(&mut VirtualWire::new(Scenario::from(file)));
    assert!(found.left_changed.is_empty());
    let clock = |position: usize| found.devices[position].clock.as_ref().expect("a clock");
    check(clock(1), ALL[3], -40.0);
    check(clock(2), (HOLD_10, PositiveAhead, 20.0), -40.0);
}

/// Crystals wander and warm up, the wire loses frames and the host is late: the law is found
/// nevertheless, and its parameter within an error that is not too large either. `ISOCAT_SEEDS=10`
/// tries more.
#[test]
fn wandering_crystals_leave_the_law() {
    let seeds = std::env::var("ISOCAT_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(2);
    let mut off = Vec::new();
    for seed in 1..=seeds {
        let mut scenario = segment(&ALL[..4]);
        scenario.seed = seed;
        for device in &mut scenario.devices {
            device.clock_shape.walk =
                Some(Walk { step_ppb: 1, every: Nanos::millis(100), bound_ppb: 20 });
        }
        let ramp = Ramp { by_ppb: 40, from: Nanos::ZERO, over: Nanos::millis(40_000) };
        scenario.devices[2].clock_shape.ramp = Some(ramp);
        let mut wire = Rough::new(scenario);
        (wire.lost_one_of, wire.late) = (2_000, 10_000);
        let found = calibrated(&mut wire);
        for (device, (law, polarity, ppm)) in found.devices[1..].iter().zip(ALL) {
            let clock = device.clock.as_ref().expect("a clock");
            println!("{ppm} {:?} {:?}", clock.crystal_change_ppb, clock.law);
            assert_eq!(clock.polarity, Some(polarity));
            let Verdict::Told(fit) = &clock.law.verdict else { panic!("{law}: {:?}", clock.law) };
            assert_eq!(fit.law, law, "{:?}", clock.law);
            if let DriftLaw::Hold { phase } | DriftLaw::Block { phase } = law {
                let (found, error) = fit.parameter.expect("a phase");
                off.push((found - f64::from(phase)) / error);
            }
        }
    }
    let rms = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
    println!("{} phases are off by {rms:.1} of their errors", off.len());
    assert!((0.2..2.2).contains(&rms), "{off:?}");
}
