use isocat_sim::Direction;
use isocat_sim::fault::{ClockChange, FrameFault, Harm, MILLION, RING_CABLE, Which, Whose};
use isocat_subdevice::Misbehaviour;

use super::*;

fn parse(text: &str) -> Result<Order, String> {
    Order::parse(text, &["axis 1".to_owned(), "axis 2".to_owned(), "for".to_owned()])
}

fn fault(text: &str) -> (Fault, Option<Nanos>) {
    let order = parse(text).unwrap_or_else(|wrong| panic!("{text}: {wrong}"));
    (order.fault, order.lasts)
}

#[test]
fn every_example_is_read_and_told_in_words() {
    for word in &WORDS {
        let order = parse(word.example).unwrap_or_else(|wrong| panic!("{wrong}"));
        assert!(!order.to_string().is_empty(), "{}", word.name);
        assert!(word.example.starts_with(word.name) && word.means.ends_with('.'), "{}", word.name);
    }
    let mut names: Vec<_> = WORDS.iter().map(|word| word.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), WORDS.len());
}

#[test]
fn lines_are_read() {
    let chance = |ppm, burst| Which::Chance { ppm, burst };
    let lost = |which| FrameFault { harm: Harm::Lost, which, way: None, cable: None };
    let ms = |ms| Some(Nanos::millis(ms));
    assert_eq!(fault("pull axis 2"), (Fault::Pull { cable: 1 }, None));
    assert_eq!(fault("pull axis 2 for 20ms"), (Fault::Pull { cable: 1 }, ms(20)));
    assert_eq!(fault("pull for for 20ms"), (Fault::Pull { cable: 2 }, ms(20)));
    assert_eq!(fault("pull ring for 20ms"), (Fault::Pull { cable: RING_CABLE }, ms(20)));
    assert_eq!(fault("plug 0"), (Fault::Plug { cable: 0 }, None));
    let off = Fault::PowerOff { device: 0 };
    assert_eq!(fault("power-cycle axis 1 20ms"), (off.clone(), ms(20)));
    assert_eq!(fault("power-cycle axis 1"), (off, ms(500)));
    assert_eq!(fault("drop 3"), (Fault::Frames(lost(Which::Next(3))), None));
    assert_eq!(fault("loss 0.5%"), (Fault::Frames(lost(chance(5_000, 1))), None));
    let here = FrameFault { way: Some(Direction::Out), cable: Some(1), ..lost(chance(10_000, 4)) };
    assert_eq!(fault("loss 1% burst 4 out at axis 2 for 1s"), (Fault::Frames(here), ms(1_000)));
    assert_eq!(fault("loss 1% burst 4 at axis 2 out").0, Fault::Frames(here));
    let at_ring = FrameFault { cable: Some(RING_CABLE), ..here };
    assert_eq!(fault("loss 1% burst 4 out at ring").0, Fault::Frames(at_ring));
    let late = |least, most, which| {
        let harm = Harm::Late { least: Nanos::micros(least), most: Nanos::micros(most) };
        Fault::Frames(FrameFault { harm, which, way: Some(Direction::Back), cable: None })
    };
    assert_eq!(fault("delay 100us 300us").0, late(100, 300, chance(MILLION, 1)));
    assert_eq!(fault("delay 100us 5").0, late(100, 100, Which::Next(5)));
    assert_eq!(fault("delay 0").0, late(0, 0, chance(0, 1)));
    let ramp = ClockChange::Ramp { by_ppb: -20_000, over: Nanos::millis(2_000) };
    let clock = |whose, change| Fault::Clock { whose, change };
    assert_eq!(fault("clock axis 1 -20ppm over 2s").0, clock(Whose::Device(0), ramp));
    let step = ClockChange::Step { by_ppb: 1_500 };
    assert_eq!(fault("clock host 1.5ppm for 1s"), (clock(Whose::Host, step), ms(1_000)));
    let how = Misbehaviour::MissedCopy(7);
    assert_eq!(
        fault("misbehave axis 2 missed-copy 7 for 1s").0,
        Fault::Misbehave { device: 1, how }
    );
    assert_eq!(fault("stall 20ms"), (Fault::Stall, ms(20)));
    let replaced = parse("replace 1 simple_io16").expect("it reads");
    assert_eq!(replaced.spare.map(|profile| profile.id.clone()).as_deref(), Some("simple_io16"));
}

#[test]
fn mistakes_say_what_is_expected() {
    for (text, expected) in [
        ("pull axis 3", "no SubDevice \"axis 3\""),
        ("pull 3", "from 0 to 2"),
        ("pull", "expected \"pull CABLE\""),
        ("power-off ring", "no SubDevice \"ring\""),
        ("pull ring 1", "\"1\" is too much"),
        ("pull 1 2", "\"2\" is too much"),
        ("plug 1 for 1s", "does not last"),
        ("drop many", "no number of frames"),
        ("drop -1", "no number of frames"),
        ("loss 101%", "0% to 100%"),
        ("loss NaN%", "0% to 100%"),
        ("double 1 at 1", "at the MainDevice's port only"),
        ("delay 2us 1us", "the shorter time stands first"),
        ("delay 2 weeks", "has no unit"),
        ("flap 1 0 1ms", "too short"),
        ("flap 1 1ms", "a time is missing"),
        ("stall", "needs its time"),
        ("clock 1 fast", "no clock rate"),
        ("clock 1 9000ppm", "beyond 5000 ppm"),
        ("misbehave 1 explode", "unknown fault \"explode\""),
        ("al-error 1 0", "no AL status code"),
        ("replace 1 nobody", "no built-in device"),
        ("second-master", "neither count nor init"),
        ("pul 1", "did you mean \"pull\"?"),
        ("", "unknown fault"),
    ] {
        let message = parse(text).expect_err(text);
        assert!(message.contains(expected), "{text}: {message}");
    }
}
