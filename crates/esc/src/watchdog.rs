//! The two watchdogs: process data (0x0420) and PDI (0x0410).

use isocat_wire::Time;
use isocat_wire::time::{Device, Nanos};

use crate::memory::Registers;
use isocat_wire::register::{self, Register};

/// One watchdog. It is at rest until its first restart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Watchdog {
    time: Register<u16>,
    restarted: Option<Time<Device>>,
    due: Time<Device>,
}

impl Watchdog {
    /// At rest; `time` is the register of its time.
    pub const fn new(time: Register<u16>) -> Self {
        Self { time, restarted: None, due: Time::NEVER }
    }

    /// What it watches has happened.
    pub fn restart(&mut self, now: Time<Device>, registers: &Registers) {
        self.restarted = Some(now);
        self.configure(registers);
    }

    /// Divider or time have changed: a running watchdog counts them from its last restart.
    pub fn configure(&mut self, registers: &Registers) {
        let units = i64::from(registers.load(self.time));
        let unit = (i64::from(registers.load(register::WATCHDOG_DIVIDER)) + 2) * 40;
        self.due = match self.restarted {
            Some(at) if units > 0 => at + Nanos(unit * units),
            _ => Time::NEVER,
        };
    }

    /// It expires now.
    pub fn expire(&mut self) {
        (self.restarted, self.due) = (None, Time::NEVER);
    }

    /// When it expires.
    pub const fn due(&self) -> Time<Device> {
        self.due
    }

    /// Restarted in time, or switched off.
    pub fn is_fine(&self, registers: &Registers) -> bool {
        self.restarted.is_some() || registers.load(self.time) == 0
    }
}
