//! Random scenarios: random segments with random faults. The same number always gives the same
//! scenario.

use std::fmt::Write;

use crate::generator::{Chance, draw};

/// The scenario with this number, as a segment file.
pub fn scenario(number: u64) -> String {
    let mut chance = Chance::new(number.wrapping_mul(0x9E6C_63D0_876A_68DD) ^ 0x1A7E);
    let drawn = draw(number).text;
    // Each device has a name, so that faults can name it.
    let mut text = String::new();
    let mut devices = 0;
    for line in drawn.lines() {
        let _ = writeln!(text, "{line}");
        if line == "[[subdevice]]" {
            let _ = writeln!(text, "name = \"d{devices}\"");
            devices += 1;
            clock(&mut chance, &mut text);
        }
    }
    let millis = chance.between(60, 160);
    if devices > 1 && chance.one_in(4) {
        let arrives = chance.between(0, 900);
        let _ = writeln!(text, "optional = true\narrives = \"{arrives}ms\"");
    }
    if chance.one_in(3) {
        let _ = writeln!(text, "[quality]\nobjects = {}", chance.one_in(2));
    }
    if chance.one_in(3) {
        let _ = writeln!(text, "[delay_watch]\nevery = \"20ms\"");
    }
    let faults = if chance.one_in(3) { 0 } else { chance.between(1, 4) };
    for _ in 0..faults {
        let at = chance.between(0, millis);
        let what = fault(&mut chance, devices);
        let _ = writeln!(text, "[[fault]]\nat = \"in-operation + {at}ms\"\nwhat = \"{what}\"");
    }
    // Keys of the whole file must precede its tables.
    let recovery = "recovery = { first = \"5ms\", longest = \"20ms\" }\n";
    format!("for = \"{millis}ms\"\n{recovery}{text}")
}

fn clock(chance: &mut Chance, text: &mut String) {
    let _ = match chance.between(0, 7) {
        0 => writeln!(text, "clock_ramp = {{ by = \"8ppm\", over = \"900ms\" }}"),
        1 => writeln!(text, "clock_step = {{ by = \"5ppm\", at = \"950ms\" }}"),
        2 => {
            let walk = "{ step = \"1ppm\", every = \"1ms\", within = \"9ppm\" }";
            writeln!(text, "clock_walk = {walk}")
        }
        _ => Ok(()),
    };
}

fn fault(chance: &mut Chance, devices: u64) -> String {
    let device = format!("d{}", chance.between(0, devices - 1));
    let lasts = format!("for {}ms", chance.between(1, 60));
    let micros = chance.between(1, 900);
    match chance.between(0, 23) {
        0 => format!("drop {}", chance.between(1, 9)),
        1 => format!("loss {}% {lasts}", chance.between(1, 40)),
        2 => format!("damage {}", chance.between(1, 9)),
        3 => format!("delay {micros}us {lasts}"),
        4 => format!("double {}", chance.between(1, 9)),
        5 => format!("pull {device} {lasts}"),
        6 => format!("break {device} out {lasts}"),
        7 => format!("power-cycle {device} {}ms", chance.between(1, 60)),
        8 => format!("clock {device} {}ppm", chance.between(1, 90)),
        9 => format!("clock host -{}ppm over 20ms", chance.between(1, 90)),
        10 => format!("clock-walk {device} 2ppm every 1ms within 20ppm"),
        11 => format!("clock-jump {micros}us"),
        12 => format!("stall {micros}us"),
        13 => format!("late-wake-ups {micros}us 30% {lasts}"),
        14 => format!("slow-send {micros}us 30% {lasts}"),
        15 => format!("misbehave {device} missed-copy 3 {lasts}"),
        16 => format!("misbehave {device} late-copy {micros}us {lasts}"),
        17 => format!("stuck-mailbox {device} {lasts}"),
        18 => format!("sync-off {device} {lasts}"),
        19 => format!("al-error {device} 0x8000"),
        20 => format!("second-master count 3ms {lasts}"),
        21 => format!("recable {device} 200m 1us"),
        22 => format!("damage 20% at {device} {lasts}"),
        _ => "heal".into(),
    }
}
