//! The verdict of a status, in one line.

use isocat_sync::phase;
use isocat_wire::AlState;

use super::names::servo_name;
use super::{Device, Stage, Status};

/// Whether the segment is as requested at present.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Verdict {
    /// Whether it is as requested.
    pub good: bool,
    /// The verdict in words.
    pub words: String,
}

impl Status {
    /// The faults of the segment at present, the worst first; without faults, that it is in sync.
    pub fn verdict(&self) -> Verdict {
        if self.has_ended() {
            let why = self.failure.as_deref().unwrap_or(Stage::Ended.name());
            return Verdict { good: self.failure.is_none(), words: capital(why) };
        }
        if !self.in_operation() {
            return Verdict { good: false, words: format!("On the way up: {}", self.stage) };
        }
        match self.doubts().next() {
            Some(words) => Verdict { good: false, words: format!("Not in sync: {words}") },
            None => Verdict { good: true, words: self.praise() },
        }
    }

    /// The faults of the segment at present.
    pub fn doubts(&self) -> impl Iterator<Item = String> + '_ {
        let states = self.devices.iter().filter(|device| !device.is_in_op());
        let states = states.map(|device| {
            let code = match device.al_code {
                0 => String::new(),
                code => format!(", AL status code 0x{code:04X}"),
            };
            format!("{} is in {}{code}", place(device), device.state())
        });
        let servo = self.host.servo.filter(|state| *state != phase::State::Locked);
        let servo = servo.map(|state| format!("the servo is in {}", servo_name(state)));
        let unled = self.host.unled_cycles;
        let unled = unled.map(|cycles| format!("clocks are not led for {cycles} cycles"));
        let beyond = |device: &&Device| {
            device.error.is_some_and(|error| error.now_ns.abs() > self.limit_ns as f64)
        };
        let errors = self.devices.iter().filter(beyond).map(|device| {
            let now = device.error.map_or(0.0, |error| error.now_ns);
            format!("{}: SYNC error {now:.0} ns, limit {} ns", place(device), self.limit_ns)
        });
        let alarms = self.devices.iter().flat_map(|device| {
            device.alarms.iter().map(move |alarm| format!("{}: {alarm}", place(device)))
        });
        states.chain(servo).chain(unled).chain(errors).chain(alarms)
    }

    fn praise(&self) -> String {
        let asked = self.devices.iter().filter(|device| device.asked).count();
        let synchronized = self.devices.iter().filter(|d| d.asked && d.has_sync).count();
        match synchronized {
            0 => format!("In operation: {asked} SubDevices, none with SYNC"),
            _ => format!("In sync: {synchronized} of {asked} SubDevices with SYNC, all in OP"),
        }
    }
}

impl Device {
    /// Whether it is in OP, or need not be.
    pub fn is_in_op(&self) -> bool {
        !self.asked || self.al_state == Some(AlState::Op) && !self.al_error
    }
}

/// The place as text, such as `SubDevice 2 (axis 3)`.
pub fn place(device: &Device) -> String {
    match device.name.is_empty() {
        true => format!("SubDevice {}", device.position),
        false => format!("SubDevice {} ({})", device.position, device.name),
    }
}

fn capital(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters.next().map(|first| first.to_uppercase().to_string());
    first.unwrap_or_default() + letters.as_str()
}
