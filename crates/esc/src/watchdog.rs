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
    /// From a restart to the end, as the registers say; `None` is switched off.
    span: Option<Nanos>,
    due: Time<Device>,
}

impl Watchdog {
    /// At rest; `time` is the register of its time. It does not watch before [`Self::configure`].
    pub const fn new(time: Register<u16>) -> Self {
        Self { time, restarted: None, span: None, due: Time::NEVER }
    }

    /// What it watches has happened.
    pub fn restart(&mut self, now: Time<Device>) {
        self.restarted = Some(now);
        self.due = self.span.map_or(Time::NEVER, |span| now + span);
    }

    /// Divider or time have changed: a running watchdog counts them from its last restart.
    pub fn configure(&mut self, registers: &Registers) {
        let units = i64::from(registers.load(self.time));
        let unit = (i64::from(registers.load(register::WATCHDOG_DIVIDER)) + 2) * 40;
        self.span = (units > 0).then_some(Nanos(unit * units));
        self.due = match (self.restarted, self.span) {
            (Some(at), Some(span)) => at + span,
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
