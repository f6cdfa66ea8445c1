//! The two watchdogs: process data (0x0420) and PDI (0x0410).

use isocat_wire::Time;
use isocat_wire::time::{Device, Nanos};

use crate::memory::Registers;
use isocat_wire::register::{self, Register};

/// One watchdog.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Watchdog {
    time: Register<u16>,
    state: State,
    /// From a restart to the end, as the registers say; `None` is switched off.
    span: Option<Nanos>,
    due: Time<Device>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// What it watches has not happened since power-on: it does not run yet.
    Rest,
    /// Runs since its last restart.
    Running(Time<Device>),
    /// Expired, and not restarted since.
    Expired,
    /// Its time is zero.
    Off,
}

impl Watchdog {
    /// At rest; `time` is the register of its time. It does not watch before [`Self::configure`].
    pub const fn new(time: Register<u16>) -> Self {
        Self { time, state: State::Rest, span: None, due: Time::NEVER }
    }

    /// What it watches has happened.
    pub fn restart(&mut self, now: Time<Device>) {
        if let Some(span) = self.span {
            self.state = State::Running(now);
            self.due = now + span;
        }
    }

    /// Divider or time have changed. A running watchdog counts them from its last restart, and expires
    /// at once if that is over; one that was off runs from now on. Time zero forgets an expiry.
    pub fn configure(&mut self, now: Time<Device>, registers: &Registers) {
        let units = i64::from(registers.load(self.time));
        let unit = (i64::from(registers.load(register::WATCHDOG_DIVIDER)) + 2) * 40;
        self.span = (units > 0).then_some(Nanos(unit * units));
        self.state = match self.state {
            _ if units == 0 => State::Off,
            State::Off => State::Running(now),
            state => state,
        };
        self.due = match (self.state, self.span) {
            (State::Running(since), Some(span)) => (since + span).max(now),
            _ => Time::NEVER,
        };
    }

    /// It expires now.
    pub fn expire(&mut self) {
        (self.state, self.due) = (State::Expired, Time::NEVER);
    }

    /// When it expires.
    pub const fn due(&self) -> Time<Device> {
        self.due
    }

    /// Restarted in time, or switched off.
    pub const fn is_fine(&self) -> bool {
        matches!(self.state, State::Running(_) | State::Off)
    }

    /// Switched off by a time of zero.
    pub const fn is_off(&self) -> bool {
        matches!(self.state, State::Off)
    }
}
