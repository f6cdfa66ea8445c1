//! Outputs on a timeline, and what late ones do to a machine: against closed forms that share
//! nothing with the integrator.

use isocat::{NoTap, Report, Scenario, SegmentFile};
use isocat_engine::report::plant::Plant;
use isocat_sim::Outcome;

fn run(text: &str) -> (Report, Outcome<NoTap>) {
    let file = SegmentFile::parse("plant.toml", text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    let scenario = Scenario::from(file);
    let outcome = scenario.run().execute(None::<NoTap>, &mut |_| {});
    (Report::new(&scenario, &outcome), outcome)
}

fn plant(report: &Report) -> &Plant {
    &report.plants.as_ref().unwrap_or_else(|| panic!("{}", report.text())).each[0]
}

/// A torque of 0.1 Nm that begins with the frame behind cycle 900, on a machine with friction, in a
/// mode.
fn torque_step(mode: &str, fault: &str) -> String {
    let fault = match fault {
        "" => String::new(),
        what => format!("[[fault]]\nat = \"cycle 900\"\nwhat = \"{what}\"\n"),
    };
    format!(
        "cycle = \"1ms\"\nfor = \"2s\"\nhost = {{ jitter = \"0us\" }}\n\
         [[subdevice]]\ndevice = \"model_every_mode\"\nname = \"axis\"\nmode = \"{mode}\"\n\
         [[output]]\nat = \"cycle 0\"\ndevice = \"axis\"\nplace = \"0x7000:01\"\nvalue = 0\n\
         [[output]]\nat = \"cycle 900\"\ndevice = \"axis\"\nplace = \"0x7000:01\"\nvalue = 100\n\
         [[plant]]\ndevice = \"axis\"\ncommand = \"0x7000:01\"\ncommands = \"torque\"\n\
         motor_inertia = \"3kgcm2\"\nload_inertia = \"7kgcm2\"\ndamping = \"0.05Nms/rad\"\nfriction = \"0.02Nms/rad\"\n{fault}"
    )
}

/// What acts later by this time lacks an impulse of torque: the load stays behind by the impulse to
/// its friction, whatever the inertias and the coupling are. um, with 10 mm to a turn.
fn lag_of(late_s: f64) -> f64 {
    0.1 * late_s / 0.02 / std::f64::consts::TAU * 10_000.0
}

fn deviation(mode: &str, fault: &str) -> f64 {
    let (report, _) = run(&torque_step(mode, fault));
    let size = plant(&report).deviation_um.unwrap_or_else(|| panic!("{}", report.text()));
    println!("{mode:>9} {fault:<25} {} um, rms {} um", size.largest, size.rms);
    size.largest
}

fn is_near(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() <= within, "{found} um, expected {expected} um");
}

/// The figures of a run in which nothing is late are what clocks make of it, and not zero by
/// construction: both machines are integrated over instants of their own.
#[test]
fn punctual_outputs_leave_the_machine_where_it_ought_to_be() {
    for mode in ["sm", "dc-sync0"] {
        let (report, outcome) = run(&torque_step(mode, ""));
        let figures = *outcome.plants.as_ref().unwrap().judges()[0].figures();
        assert!(figures.deviation.largest < 2.0, "{mode}: {}", report.text());
        assert!(figures.deviation.largest > 0.0, "{mode}: {}", figures.deviation.largest);
        // The load itself turned by far more.
        assert!(plant(&report).coupling_nm.unwrap().largest > 0.05);
        assert!(figures.looks > 8_000);
    }
}

/// SM-synchronous outputs act when their frame comes: each microsecond of the host is one of the
/// machine.
#[test]
fn a_late_frame_is_a_late_torque() {
    let punctual = deviation("sm", "");
    let [short, long] =
        [50, 200].map(|us| deviation("sm", &format!("slow-send {us}us for 1500us")));
    is_near(short, lag_of(50e-6), 0.02 * lag_of(50e-6) + punctual);
    is_near(long, lag_of(200e-6), 0.02 * lag_of(200e-6) + punctual);
}

/// With SYNC0 the same lateness is none, up to where the outputs miss their pulse: then it is a
/// whole cycle.
#[test]
fn with_sync0_lateness_is_nothing_or_a_cycle() {
    let punctual = deviation("dc-sync0", "");
    is_near(deviation("dc-sync0", "slow-send 200us for 1500us"), punctual, 0.01);
    let cycle = lag_of(1e-3);
    is_near(deviation("dc-sync0", "drop 1"), cycle, 0.01 * cycle + punctual);
    // Two in a row are more than 0x1C32:0B allows: the device leaves OP, lets go, and the load
    // stays where friction stops it.
    assert!(deviation("dc-sync0", "drop 2") > 100.0 * cycle);
}

/// What the device puts out comes back as its input, so the MainDevice reads what it wrote some
/// cycles before.
#[test]
fn a_ramp_goes_from_what_stood_there_to_its_value() {
    let text = |later: u32| {
        format!(
            "cycle = \"1ms\"\nfor = \"{later}ms\"\nhost = {{ jitter = \"0us\" }}\n\
             [[subdevice]]\ndevice = \"model_every_mode\"\nmode = \"dc-sync0\"\n\
             [[output]]\nat = \"in-operation\"\ndevice = \"0\"\nplace = \"0x7000:01\"\nvalue = -100\n\
             [[output]]\nat = \"in-operation + 50ms\"\ndevice = \"0\"\nplace = \"0x7000:01\"\nvalue = 900\nover = \"100ms\"\n"
        )
    };
    let shown = |later: u32| {
        let (report, outcome) = run(&text(later));
        assert!(report.in_sync, "{}", report.text());
        let inputs = outcome.world.main().inputs(0);
        i32::from_le_bytes(inputs.try_into().unwrap())
    };
    assert_eq!(shown(40), -100);
    let half = shown(100);
    assert!((350..=450).contains(&half), "{half}, some cycles behind 400");
    assert_eq!(shown(170), 900);
}

/// The MainDevice sees the encoder: behind a ramp the motor stands at its target, and the drive's
/// own figures follow it.
#[test]
fn the_motor_is_seen_by_its_encoder() {
    let text = "cycle = \"1ms\"\nfor = \"1s\"\n\
         [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
         [[output]]\nat = \"in-operation + 100ms\"\ndevice = \"0\"\nplace = \"0x607A:00\"\nvalue = 524288\nover = \"200ms\"\n\
         [[plant]]\ndevice = \"0\"\nmotor_inertia = \"3kgcm2\"\nload_inertia = \"7kgcm2\"\n";
    let (report, outcome) = run(text);
    assert!(report.in_sync, "{}", report.text());
    let inputs = outcome.world.main().inputs(0);
    let position = i32::from_le_bytes(inputs[2..6].try_into().unwrap());
    assert!((524_280..=524_290).contains(&position), "{position}");
    // Half a turn in 200 ms: a proportional loop lags by speed over gain.
    let following = plant(&report).following_um.unwrap().largest;
    let expected = 5_000.0 / 0.2 / 50.0;
    assert!((following / expected - 1.0).abs() < 0.1, "{following} um, about {expected} um");
}

#[test]
fn a_run_with_machines_repeats_to_the_bit() {
    let text = torque_step("sm", "late-wake-ups 0us 300us for 500ms");
    let [one, other] = [run(&text).0, run(&text).0];
    assert_eq!(one, other);
}

fn documented() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/plant.toml");
    std::fs::read_to_string(path).unwrap()
}

#[test]
fn the_documented_file_holds() {
    let (report, _) = run(&documented());
    assert!(report.as_expected(), "{}", report.text());
    assert!(report.text().contains("deviations of axes"), "{}", report.text());
    // The other side: SM-synchronous it does not.
    let (report, _) = run(&documented().replace("dc-sync0", "sm"));
    assert!(!report.as_expected(), "{}", report.text());
}

/// The table of docs/plant.md is made of runs of docs/plant.toml.
#[test]
fn the_table_is_measured() {
    let mut table = String::from(
        "| mode | host's jitter | deviation, largest | rms | ripple in the coupling | axes apart |\n|---|---|---|---|---|---|\n",
    );
    for mode in ["sm", "dc-sync0"] {
        for jitter in ["0us", "50us", "200us", "400us"] {
            let text = documented().replace("dc-sync0", mode).replace("50us", jitter);
            let (report, _) = run(&text);
            assert!(report.in_sync, "{}", report.text());
            let plants = report.plants.as_ref().unwrap();
            let (deviation, ripple) = (plants.each[0].deviation_um, plants.each[0].ripple_nm);
            let (deviation, apart) = (deviation.unwrap(), plants.apart_um.unwrap());
            table += &format!(
                "| {mode} | {} us | {:.2} um | {:.2} um | {:.4} Nm | {:.2} um |\n",
                jitter.trim_end_matches("us"),
                deviation.largest,
                deviation.rms,
                ripple.unwrap().largest,
                apart.largest,
            );
        }
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/plant.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (begin, end) = ("<!-- figures: made by a test -->\n", "<!-- end of figures -->");
    let at = text.find(begin).unwrap() + begin.len();
    let until = text.find(end).unwrap();
    let fresh = format!("{}{table}{}", &text[..at], &text[until..]);
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(path, &fresh).unwrap();
    }
    assert!(text == fresh, "{path}: UPDATE_GOLDEN=1 rewrites it");
}
