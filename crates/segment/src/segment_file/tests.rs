//! The built-in segment, defaults, and every kind of mistake with its place.

use isocat_wire::PortNumber::{P1, P2};

use super::*;
use crate::profile;

mod clock;
mod count;
mod operation;
mod optional;
mod physics;
mod plant;
mod ports;
mod ring;

/// The error of a text, as `line:column message` and hint.
fn refused(text: &str) -> (String, Option<String>) {
    let error = SegmentFile::parse("s.toml", text).unwrap_err();
    assert_eq!(error.path, "s.toml");
    assert!(error.to_string().lines().count() <= 2, "{error}");
    (format!("{}:{} {}", error.line, error.column, error.message), error.hint.clone())
}

/// A segment of one AKD2G with more lines for the device.
fn one(lines: &str) -> String {
    format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n{lines}")
}

fn subdevice(lines: &str) -> SubDevice {
    SegmentFile::parse("s.toml", &one(lines)).unwrap().subdevices.remove(0)
}

#[test]
fn the_built_in_segment() {
    let segment = SegmentFile::built_in();
    assert_eq!(segment.cycle, Nanos::millis(1));
    assert_eq!(segment.duration, Nanos::millis(10_000));
    assert_eq!((segment.seed, segment.shift), (1, None));
    assert_eq!(
        segment.host,
        Host {
            port: PortKind::Mii,
            clock: Ppb::ppm(12),
            jitter: Nanos::micros(20),
            drift_compensation: true,
            drift_filters: DriftFilters::default()
        }
    );
    let found: Vec<_> = segment
        .subdevices
        .iter()
        .map(|d| (d.profile.id.as_str(), d.mode, d.cable, d.clock, d.line))
        .collect();
    let (dc, free) = (Some(SyncMode::DcSync0), Some(SyncMode::FreeRun));
    let cable = Length::metres(10);
    let given = |ppm| Clock::Given(Ppb::ppm(ppm));
    let drawn = Clock::DrawnWithin(Ppb::ppm(25));
    assert_eq!(
        found,
        [
            ("kollmorgen_akd2g", dc, cable, given(-35), 11),
            ("kollmorgen_akd2g", dc, cable, given(20), 18),
            ("beckhoff_ek1100", None, cable, drawn, 26),
            ("beckhoff_el2502-0010", free, Length(0), drawn, 31),
            ("hpmicro_ecat_cia402_ssc", dc, cable, given(48), 36),
        ]
    );
    let places = segment.subdevices.iter().map(|device| device.place.upstream);
    let (line, behind) = ([None, Some((0, P1)), Some((1, P1))], [Some((2, P1)), Some((2, P2))]);
    assert!(places.eq(line.into_iter().chain(behind)));
    assert!(Arc::ptr_eq(&segment.subdevices[0].profile, &segment.subdevices[1].profile));
}

#[test]
fn defaults() {
    let text = "cycle = \"250us\"\n[[subdevice]]\ndevice = \"beckhoff_ep9214-0023\"";
    let segment = SegmentFile::parse("s.toml", text).unwrap();
    assert_eq!(segment.duration, Nanos::millis(10_000));
    assert_eq!((segment.seed, segment.shift), (1, None));
    assert_eq!(
        segment.host,
        Host {
            port: PortKind::Mii,
            clock: Ppb::ppm(12),
            jitter: Nanos::micros(20),
            drift_compensation: true,
            drift_filters: DriftFilters::default()
        }
    );
    let device = &segment.subdevices[0];
    assert_eq!((device.mode, device.shift), (None, None));
    assert_eq!(
        (device.cable, device.clock),
        (Length::metres(10), Clock::DrawnWithin(Ppb::ppm(25)))
    );
    assert_eq!(device.name, "beckhoff_ep9214-0023 0");
    let short = SegmentFile::parse("s.toml", &text.replace("250us", "100us")).unwrap();
    assert_eq!(short.host.jitter, Nanos::micros(10));
}

#[test]
fn everything_written_out() {
    let text = r#"
        cycle = "500us"
        for = "2s"
        seed = 42
        shift = "120us"
        host = { clock = "-3ppm", jitter = "0ns", drift_compensation = false }
        [[subdevice]]
        device = "kollmorgen_akd2g"
        name = "left"
        mode = "dc-sync0"
        cable = "25cm"
        clock = "-500ppb"
        shift = "40us"
        calc_copy = "70us"
        copy_time = "70001ns"
        delay = "12.5us"
        jitter = "0ns"
    "#;
    let segment = SegmentFile::parse("s.toml", text).unwrap();
    assert_eq!((segment.cycle, segment.duration), (Nanos(500_000), Nanos(2_000_000_000)));
    assert_eq!((segment.seed, segment.shift), (42, Some(Nanos(120_000))));
    assert_eq!(
        segment.host,
        Host {
            port: PortKind::Mii,
            clock: Ppb::ppm(-3),
            jitter: Nanos::ZERO,
            drift_compensation: false,
            drift_filters: DriftFilters::default()
        }
    );
    let device = &segment.subdevices[0];
    assert_eq!((device.cable, device.clock), (Length(250), Clock::Given(Ppb(-500))));
    assert_eq!((device.name.as_str(), device.shift), ("left", Some(Nanos(40_000))));
    let stated = device.profile.sync_parameters(0x1C32).unwrap();
    assert_eq!(stated.calc_and_copy_time, Some(Nanos(70_000)));
    assert_eq!(stated.delay_time, Some(Nanos(12_500)));
    assert_eq!(device.profile.times.calc_and_copy, Nanos(70_001));
    assert_eq!(device.profile.times.jitter, Nanos::ZERO);
    let plain = profile::built_in("kollmorgen_akd2g").unwrap();
    assert_eq!(plain.sync_parameters(0x1C32).unwrap().delay_time, Some(Nanos(30_000)));
}

#[test]
fn the_time_needed_follows_the_time_stated() {
    let times = |lines| subdevice(lines).profile.times.calc_and_copy;
    assert_eq!(times(""), Nanos(60_000));
    assert_eq!(times("calc_copy = \"80us\""), Nanos(80_000));
    assert_eq!(times("calc_copy = \"80us\"\ncopy_time = \"90us\""), Nanos(90_000));
    assert_eq!(times("copy_time = \"90us\""), Nanos(90_000));
    // The key needs a stated value, and the terminal states none.
    let text = "cycle = \"1ms\"\nhost = { port = \"ebus\" }\n[[subdevice]]\ndevice = \"beckhoff_el2502-0010\"\n\
                calc_copy = \"9us\"";
    let terminal = SegmentFile::parse("s.toml", text).unwrap().subdevices.remove(0);
    assert_eq!(terminal.profile.times.calc_and_copy, Nanos(30_000));
}

#[test]
fn devices_with_other_times_share_the_objects_of_their_kind() {
    let usual = profile::built_in("kollmorgen_akd2g").unwrap();
    assert!(Arc::ptr_eq(&subdevice("").profile, &usual));
    let own = subdevice("delay = \"1001ns\"\ncalc_copy = \"7us\"").profile;
    assert!(std::ptr::eq(own.description.objects, usual.description.objects));
    let stated = |profile: &profile::Profile, sub| {
        profile.value(isocat_wire::ObjectAddress::new(0x1C32, sub))
    };
    assert_eq!((stated(&own, 9), stated(&own, 6)), (Some(1_001), Some(7_000)));
    assert_ne!((stated(&usual, 9), stated(&usual, 6)), (Some(1_001), Some(7_000)));
}

#[test]
fn malformed_toml_names_line_and_column() {
    for (text, place) in [
        ("cycle = \"1ms\nfor = \"1s\"", "1:"),
        ("cycle = \"1ms\"\nseed = = 3", "2:8 "),
        ("cycle = \"1ms\"\n[[subdevice]\n", "2:"),
        ("cycle = \"1ms\"\ncycle = \"2ms\"", "2:1 "),
    ] {
        let (message, _) = refused(text);
        assert!(message.starts_with(place), "{text:?} gave {message}");
        assert!(message.contains("not valid TOML"), "{message}");
    }
}

#[test]
fn columns_count_characters() {
    let (message, _) = refused("# µ\ncycle = \"1ms\"\nhost = { \"ö\" = 1 }");
    assert_eq!(message, "3:10 unknown key \"ö\" in host");
}

#[test]
fn unknown_names_come_with_the_nearest_known() {
    let (message, hint) = refused("cylce = \"1ms\"");
    assert_eq!(message, "1:1 unknown key \"cylce\" in the top level");
    assert_eq!(
        hint.unwrap(),
        "did you mean \"cycle\"? expected one of: cycle, for, seed, drift_law, drift_phase, drift_gain, shift, sync0_limit, outputs_spread, watchdog, clocks, host, hop_jitter, as_is, subdevice, ring, quality, delay_watch, recovery, direction, measure_times, output, plant, fault, expect"
    );

    let (message, hint) = refused(&one("cabel = \"1m\""));
    assert_eq!(message, "4:1 unknown key \"cabel\" in subdevice");
    assert!(hint.unwrap().starts_with("did you mean \"cable\"?"));

    let (message, hint) = refused("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"AKD2G\"");
    assert_eq!(message, "3:10 unknown device \"AKD2G\"");
    assert_eq!(
        hint.unwrap(),
        "did you mean \"kollmorgen_akd2g\"? expected one of 35, such as: kollmorgen_akd2g, \
         beckhoff_el2502-0010, hpmicro_ecat_cia402_ssc, beckhoff_ax8640, beckhoff_ej3108"
    );
    let (_, hint) = refused("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"omron\"");
    assert!(hint.unwrap().starts_with("expected one of 35, such as: kollmorgen_akd2g"));

    let (message, hint) = refused(&one("mode = \"dc_sync0\""));
    assert_eq!(message, "4:8 unknown mode \"dc_sync0\"");
    let all = "free-run, sm, dc-sync0, dc-shift-sync1, dc-sync1, dc-subordinated";
    assert_eq!(hint.unwrap(), format!("did you mean \"dc-sync0\"? expected one of: {all}"));

    let (message, _) = refused("cycle = \"1ms\"\n[host]\njiter = \"1us\"");
    assert_eq!(message, "3:1 unknown key \"jiter\" in host");
}

#[test]
fn what_is_missing() {
    let (message, _) = refused("for = \"1s\"");
    assert_eq!(
        message,
        "1:1 the top level lacks the key \"cycle\"; expected the bus cycle, such as cycle = \"1ms\""
    );
    let (message, _) = refused("cycle = \"1ms\"");
    assert!(message.starts_with("1:1 the segment has no [[subdevice]]; expected"), "{message}");
    let (message, _) = refused("cycle = \"1ms\"\n\n[[subdevice]]\nmode = \"sm\"");
    assert!(message.starts_with("3:1 subdevice lacks the key \"device\"; expected"), "{message}");
}

#[test]
fn quantities_need_units_and_sense() {
    let with_cycle = |cycle: &str| refused(&one("").replace("\"1ms\"", cycle)).0;
    assert_eq!(
        with_cycle("1"),
        "1:9 cycle: expected a duration with its unit, such as \"1ms\", found the number 1"
    );
    assert_eq!(
        with_cycle("\"1\""),
        "1:9 cycle: duration \"1\" has no unit; expected a number with one of the units ns, us, ms, \
         s, min, h, such as \"1ms\""
    );
    assert_eq!(with_cycle("\"0ms\""), "1:9 cycle = \"0ms\" is out of range; expected 10 us to 1 s");
    for (lines, expected) in [
        ("cable = \"0m\"", "4:9 cable = \"0m\" is out of range; expected 0.01 m to 2000 m"),
        (
            "cable = \"3km\"",
            "4:9 cable: length \"3km\" has an unknown unit; expected a number with \
                             one of the units mm, cm, m, such as \"10m\"",
        ),
        (
            "cable = 10",
            "4:9 cable: expected a length with its unit, such as \"10m\", found the \
                        number 10",
        ),
        (
            "clock = \"1001ppm\"",
            "4:9 clock = \"1001ppm\" is out of range; expected -1000 ppm to \
                                 +1000 ppm",
        ),
        ("shift = \"1ms\"", "4:9 shift = \"1ms\" is out of range; expected 0 ns to 999.999 us"),
        ("copy_time = \"0us\"", "4:13 copy_time = \"0us\" is out of range; expected 1 ns to 1 s"),
        ("calc_copy = \"2s\"", "4:13 calc_copy = \"2s\" is out of range; expected 1 ns to 1 s"),
        ("delay = \"-1ns\"", "4:9 delay = \"-1ns\" is out of range; expected 0 ns to 1 s"),
        ("name = \"\"", "4:8 name is empty; expected a name in quotes"),
    ] {
        assert_eq!(refused(&one(lines)).0, expected);
    }
    for (top, expected) in [
        ("for = \"0s\"", "1:7 for = \"0s\" is out of range; expected 1 ms to 86400 s"),
        ("for = \"999999ns\"", "1:7 for = \"999999ns\" is out of range; expected 1 ms to 86400 s"),
        (
            "for = \"25000000s\"",
            "1:7 for = \"25000000s\" is out of range; expected 1 ms to 86400 s",
        ),
        (
            "seed = -1",
            "1:8 seed = -1 is out of range; expected an integer from 0 to \
                       9223372036854775807",
        ),
        (
            "seed = \"x\"",
            "1:8 seed: expected an integer from 0 to 9223372036854775807, found the \
                          text \"x\"",
        ),
        ("shift = \"1ms\"", "1:9 shift = \"1ms\" is out of range; expected 0 ns to 999.999 us"),
        ("host = 3", "1:8 host: expected a table, found the number 3"),
        (
            "host.jitter = \"1ms\"",
            "1:15 jitter = \"1ms\" is out of range; expected 0 ns to 499.999 \
                                   us",
        ),
        (
            "host.clock = \"12\"",
            "1:14 clock: clock rate \"12\" has no unit; expected a number with \
                                 one of the units ppb, ppm, such as \"-35ppm\"",
        ),
        (
            "host.drift_compensation = 0",
            "1:27 drift_compensation: expected true or false, found the \
                                         number 0",
        ),
    ] {
        assert_eq!(refused(&format!("{top}\n{}", one(""))).0, expected);
    }
}

#[test]
fn ranges_end_where_they_say() {
    let cycle = |cycle: &str| {
        SegmentFile::parse("s.toml", &one("").replace("1ms", cycle)).map(|segment| segment.cycle.0)
    };
    assert_eq!(cycle("10us"), Ok(10_000));
    assert!(cycle("9999ns").is_err());
    assert_eq!(cycle("1s"), Ok(1_000_000_000));
    assert!(cycle("1000000001ns").is_err());
    assert_eq!(subdevice("shift = \"999999ns\"").shift, Some(Nanos(999_999)));
    assert_eq!(subdevice("cable = \"10mm\"").cable, Length(10));
    assert!(SegmentFile::parse("s.toml", &one("cable = \"9mm\"")).is_err());
}

#[test]
fn a_mode_must_be_announced() {
    let (message, hint) = refused(
        "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"beckhoff_el2502-0010\"\nmode = \"dc-sync0\"",
    );
    assert_eq!(
        message,
        "4:8 mode \"dc-sync0\" is not possible with EL2502-0010: 0x1C32:04 = 0x4001 (Free Run, \
         dynamic times)"
    );
    assert_eq!(hint.unwrap(), "it announces: free-run");
}

#[test]
fn a_cycle_must_be_possible_in_the_mode() {
    let with = |cycle: &str, mode: &str| one(&format!("mode = \"{mode}\"")).replace("1ms", cycle);
    assert_eq!(
        refused(&with("125us", "dc-sync0")).0,
        "4:8 a cycle of 125 us is too short for AKD2G in mode \"dc-sync0\": 0x1C32:05 = 250 us; \
         expected a cycle of 250 us or more"
    );
    assert!(refused(&with("249999ns", "sm")).0.contains("0x1C32:05 = 250 us"));
    SegmentFile::parse("s.toml", &with("250us", "dc-sync0")).unwrap();
    // Free Run does not depend on the bus cycle.
    SegmentFile::parse("s.toml", &with("125us", "free-run")).unwrap();
}

#[test]
fn what_a_device_cannot_state() {
    let ssc = |line: &str| {
        format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"hpmicro_ecat_cia402_ssc\"\n{line}")
    };
    assert_eq!(
        refused(&ssc("shift = \"1us\"")).0,
        "4:9 shift is given, but ECAT_CIA402 states 0x1C32:04 = 0x8007 (Free Run, SM, DC SYNC0); \
         expected a device with shift by local timer"
    );
}

#[test]
fn a_profile_may_be_a_file_beside_the_segment() {
    let folder = std::env::temp_dir().join(format!("isocat-segment-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("own.toml");
    let text = profile::built_in_text("kollmorgen_akd2g").unwrap();
    std::fs::write(&path, text.replace("id = \"kollmorgen_akd2g\"", "id = \"mine\"")).unwrap();
    let segment = folder.join("segment.toml").display().to_string();
    let of = |device: &str| {
        let text = format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"{device}\"");
        std::fs::write(&segment, text).unwrap();
        SegmentFile::read(&segment)
    };
    for device in ["own.toml", "./own.toml"] {
        assert_eq!(of(device).unwrap().subdevices[0].profile.id, "mine");
    }
    let missing = of("none.toml").unwrap_err();
    assert_eq!((missing.line, missing.column), (3, 10));
    assert!(missing.message.contains("none.toml: can't be read"), "{missing}");

    // A mistake in the profile is reported with its place in the profile.
    std::fs::write(&path, text.replacen("[esc]\n", "[esc]\nchp = 1\n", 1)).unwrap();
    let broken = of("own.toml").unwrap_err();
    assert!(broken.path.ends_with("own.toml"), "{broken}");
    assert_eq!(broken.message, "unknown key \"chp\" in esc");

    let error = SegmentFile::read(&folder.join("none").display().to_string()).unwrap_err();
    assert_eq!(error.line, 0);
    assert!(error.to_string().contains("can't be read"), "{error}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn names_are_not_given_twice() {
    let two = |first: &str, second: &str| {
        format!("{}\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n{second}", one(first))
    };
    assert_eq!(
        refused(&two("name = \"x\"", "name = \"x\"")).0,
        "7:8 the name \"x\" is already taken in line 2; expected another"
    );
    assert_eq!(
        refused(&two("name = \"kollmorgen_akd2g 1\"", "")).0,
        "5:1 the name \"kollmorgen_akd2g 1\" is already taken in line 2; expected another"
    );
    SegmentFile::parse("s.toml", &two("", "")).unwrap();
}

/// Damaged files are refused or read without a panic, and every place is inside the file.
#[test]
fn damaged_files_are_no_panic() {
    let text = SegmentFile::built_in_text();
    let mut damaged = 0;
    for (at, _) in text.char_indices() {
        for insert in ["", "=", "\"", "[", "-", "9", "µ", "\n", "'''"] {
            let broken = format!("{}{insert}{}", &text[..at], text.get(at + 1..).unwrap_or(""));
            if let Err(error) = SegmentFile::parse("s.toml", &broken) {
                let line = broken.split('\n').nth(error.line - 1).expect("a line of the file");
                assert!(error.column <= line.chars().count() + 1, "{error}");
                damaged += 1;
            }
        }
    }
    assert!(damaged > 1_000, "{damaged}");
}

#[test]
fn an_eeprom_burns_as_long_as_the_file_says() {
    let burn = |line: &str| {
        let text =
            format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n{line}\n");
        let file = SegmentFile::parse("burn.toml", &text).map_err(|error| error.to_string())?;
        let chip = file.subdevices[0].profile.esc();
        Ok::<_, String>((chip.eeprom_burn_time, chip.name))
    };
    let (usual, name) = burn("").expect("a segment");
    assert_eq!(usual, Nanos::millis(5));
    assert_eq!(burn("eeprom_burn = \"2.4ms\""), Ok((Nanos::micros(2_400), name)));
    assert_eq!(burn("eeprom_burn = \"0ns\""), Ok((Nanos::ZERO, name)));
    assert!(burn("eeprom_burn = \"20.001ms\"").is_err_and(|error| error.contains("eeprom_burn")));
}

#[test]
fn pulses_end_by_themselves_or_are_acknowledged() {
    let of = |lines: &str| {
        let device = subdevice(lines);
        (device.profile.pulse().0, device.profile.times.acknowledge.0)
    };
    assert_eq!(of(""), (10_000, 0));
    assert_eq!(of("pulse = \"0ns\""), (0, 0));
    assert_eq!(of("pulse = \"655.35us\""), (655_350, 0));
    assert_eq!(of("pulse = \"0ns\"\nacknowledge = \"30us\""), (0, 30_000));
    // The EEPROM and its checksum are changed, too.
    let sii = subdevice("pulse = \"1.23us\"").profile.sii.clone();
    assert_eq!(sii[4..6], [123, 0]);
    let configuration = sii[..14].try_into().expect("words 0 to 6");
    assert_eq!(sii[14], isocat_wire::sii::checksum(&configuration));
}

#[test]
fn what_is_wrong_with_pulses_is_told() {
    for (lines, expected) in [
        (
            "acknowledge = \"30us\"",
            "4:15 acknowledge is given, but pulses of 10 us end by themselves; expected pulse = \"0ns\" beside it",
        ),
        (
            "pulse = \"10ns\"\nacknowledge = \"30us\"",
            "5:15 acknowledge is given, but pulses of 10 ns end by themselves; expected pulse = \"0ns\" beside it",
        ),
        ("pulse = \"15ns\"", "4:9 pulse = 15 ns; expected whole 10 ns"),
        (
            "pulse = \"655.36us\"",
            "4:9 pulse = \"655.36us\" is out of range; expected 0 ns to 655.35 us",
        ),
    ] {
        assert_eq!(refused(&one(lines)).0, expected);
    }
    let coupler = crate::profile::built_in_text("beckhoff_ek1100").unwrap();
    let path = std::env::temp_dir().join(format!("isocat-no-sync-{}.toml", std::process::id()));
    std::fs::write(&path, coupler.replacen("sync_unit = true", "sync_unit = false", 1)).unwrap();
    let device = path.display();
    let bare = format!("cycle = \"1ms\"\n[[subdevice]]\ndevice = \"{device}\"\npulse = \"0ns\"\n");
    let (error, _) = refused(&bare);
    std::fs::remove_file(&path).unwrap();
    assert!(
        error.contains("makes no SYNC pulses") && error.contains("expected a device with DC"),
        "{error}"
    );
}
