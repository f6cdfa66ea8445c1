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
    /// Time from a restart to the expiry, as the registers set it; `None` if switched off.
    span: Option<Nanos>,
    due: Time<Device>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// The watched event has not happened since power-on, so it does not run yet.
    Rest,
    /// Runs since its last restart.
    Running(Time<Device>),
    /// Expired, and not restarted since.
    Expired,
    /// Its time is zero.
    Off,
}

impl Watchdog {
    /// A watchdog at rest, whose time is in the register `time`. It does not watch before
    /// [`Self::configure`].
    pub const fn new(time: Register<u16>) -> Self {
        Self { time, state: State::Rest, span: None, due: Time::NEVER }
    }

    /// Handles the watched event.
    #[inline]
    pub fn restart(&mut self, now: Time<Device>) {
        if let Some(span) = self.span {
            self.state = State::Running(now);
            self.due = now + span;
        }
    }

    /// Handles a change of divider or time. A running watchdog counts the new time from its last
    /// restart, and expires at once if that time is over; one that was off runs from now on. A time
    /// of zero clears an expiry.
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

    /// Handles the expiry.
    pub fn expire(&mut self) {
        (self.state, self.due) = (State::Expired, Time::NEVER);
    }

    /// When it expires.
    #[inline]
    pub const fn due(&self) -> Time<Device> {
        self.due
    }

    /// Whether it was restarted in time or is switched off.
    pub const fn is_fine(&self) -> bool {
        matches!(self.state, State::Running(_) | State::Off)
    }

    /// Whether it is switched off by a time of zero.
    pub const fn is_off(&self) -> bool {
        matches!(self.state, State::Off)
    }
}
