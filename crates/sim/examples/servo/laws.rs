//! The laws: the project's servo, and laws in use elsewhere, written here from their description.
//!
//! The other laws have in common that they know the reference time that came back, but not the
//! stamp of the frame that fetched it (except the second), and correct the next deadline.

use isocat_sync::phase::{Servo, Settings};
use isocat_wire::time::{Dc, Host, Nanos, Time};

/// The data that a law gets of a cycle.
#[derive(Clone, Copy)]
pub struct Heard {
    /// The commanded deadline.
    pub deadline: Time<Host>,
    /// When the program was awake and sent.
    pub stamp: Time<Host>,
    /// When the program had the answer.
    pub back: Time<Host>,
    /// The reference time when the frame reached the clock.
    pub dc: Time<Dc>,
}

/// Computes deadlines from reference times.
pub trait Law {
    /// The deadline of the next frame.
    fn next(&mut self, heard: Heard) -> Time<Host>;

    /// Called when the program woke at `now` for `deadline`: returns another deadline if it must
    /// not send now.
    fn put_off(&mut self, _deadline: Time<Host>, _now: Time<Host>) -> Option<Time<Host>> {
        None
    }
}

/// The cycle, and the phase at which frames should find the reference clock.
#[derive(Clone, Copy)]
pub struct Grid {
    /// Cycle, ns.
    pub cycle: i64,
    /// Phase, ns.
    pub target: i64,
}

impl Grid {
    /// How late a reference time is against the target, within half a cycle.
    pub fn error(self, dc: Time<Dc>) -> i64 {
        self.fold((dc + Nanos(-self.target)).phase(self.cycle as u64) as i64)
    }

    fn fold(self, phase: i64) -> i64 {
        if phase > self.cycle / 2 { phase - self.cycle } else { phase }
    }
}

/// A law by name.
pub struct Entry {
    /// Name in the table.
    pub name: &'static str,
    /// Whether it chooses its own phase.
    pub own_phase: bool,
    /// Makes the law, on a host whose stamps are early by the span.
    pub make: fn(Grid, Nanos) -> Box<dyn Law>,
}

/// All laws, ours first.
pub const LAWS: [Entry; 5] = [
    Entry {
        name: "isocat",
        own_phase: false,
        make: |grid, noise| {
            let settings = Settings::new(Nanos(grid.cycle), noise);
            Box::new(Ours { grid, servo: Servo::new(settings), put_off: false })
        },
    },
    Entry {
        name: "PI 0.01 / 0.00002",
        own_phase: false,
        make: |grid, _| Box::new(Pi { grid, sum: 0 }),
    },
    Entry {
        name: "bang-bang 0.1 %",
        own_phase: false,
        make: |grid, _| Box::new(BangBang { grid }),
    },
    Entry {
        name: "EMA 0.1, PI 0.05 / 0.0005",
        own_phase: true,
        make: |grid, _| Box::new(Smoothed { grid, ..Smoothed::default() }),
    },
    Entry { name: "deadbeat", own_phase: false, make: |grid, _| Box::new(Deadbeat { grid }) },
];

/// The servo as in the MainDevice.
struct Ours {
    grid: Grid,
    servo: Servo,
    put_off: bool,
}

impl Ours {
    fn send_from(&self, earliest: Time<Host>) -> Time<Host> {
        self.servo.next_send(earliest, Nanos(self.grid.cycle), Nanos(self.grid.target))
    }
}

impl Law for Ours {
    fn next(&mut self, heard: Heard) -> Time<Host> {
        self.put_off = false;
        self.servo.sample(heard.stamp, heard.dc);
        self.servo.handle_timeout(heard.back);
        self.send_from(heard.stamp + Nanos(self.grid.cycle / 2))
    }

    fn put_off(&mut self, deadline: Time<Host>, now: Time<Host>) -> Option<Time<Host>> {
        let sends = self.put_off || (now - deadline).0 < self.grid.cycle / 2;
        self.put_off = !sends;
        (!sends).then(|| self.send_from(now))
    }
}

/// Proportional and integral parts of the phase error, equal for any cycle; the integral has no
/// bound.
struct Pi {
    grid: Grid,
    sum: i64,
}

impl Law for Pi {
    fn next(&mut self, heard: Heard) -> Time<Host> {
        let error = self.grid.error(heard.dc);
        self.sum += error;
        let correction = -0.01 * error as f64 - 0.00002 * self.sum as f64;
        heard.deadline + Nanos(self.grid.cycle + correction as i64)
    }
}

/// A step of fixed size against the sign of the error. It subtracts the lateness of its own
/// wake-up.
struct BangBang {
    grid: Grid,
}

impl Law for BangBang {
    fn next(&mut self, heard: Heard) -> Time<Host> {
        let error = self.grid.error(heard.dc + -(heard.stamp - heard.deadline));
        let step = self.grid.cycle / 1_000;
        let step = if error < 0 { step } else { -step };
        heard.deadline + Nanos(self.grid.cycle + step)
    }
}

/// A smoothed error with proportional and integral parts, and limits on everything. Its target is
/// the phase of its first sample.
#[derive(Default)]
struct Smoothed {
    grid: Grid,
    target: Option<i64>,
    smooth: f64,
    sum: f64,
    correction: i64,
    good: u32,
    bad: u32,
    locked: bool,
    was_locked: bool,
    rejected: u32,
}

impl Default for Grid {
    fn default() -> Self {
        Self { cycle: 1, target: 0 }
    }
}

impl Smoothed {
    fn correct(&mut self, heard: Heard) {
        let phase = heard.dc.phase(self.grid.cycle as u64) as i64;
        let target = *self.target.get_or_insert(phase);
        let error = self.grid.fold((phase - target).rem_euclid(self.grid.cycle));
        let overran = (heard.stamp - heard.deadline).0 >= self.grid.cycle;
        if overran || self.was_locked && error.abs() > 150_000 {
            self.rejected += 1;
            if self.rejected >= 200 {
                let grid = self.grid;
                *self = Self { grid, ..Self::default() };
            }
            return;
        }
        self.rejected = 0;
        self.smooth += 0.1 * (error as f64 - self.smooth);
        self.sum = (self.sum + self.smooth).clamp(-200_000.0, 200_000.0);
        let wanted = 0.05 * self.smooth + 0.0005 * self.sum;
        self.correction = wanted.clamp(-20_000.0, 20_000.0) as i64;
        let size = self.smooth.abs();
        self.good = if size < 8_000.0 { self.good + 1 } else { self.good.saturating_sub(1) };
        self.bad = if size > 20_000.0 { self.bad + 1 } else { 0 };
        self.locked = (self.locked && self.bad < 200) || self.good >= 500;
        self.was_locked |= self.locked;
    }
}

impl Law for Smoothed {
    fn next(&mut self, heard: Heard) -> Time<Host> {
        self.correct(heard);
        heard.deadline + Nanos(self.grid.cycle - self.correction)
    }
}

/// The whole error is corrected at once.
struct Deadbeat {
    grid: Grid,
}

impl Law for Deadbeat {
    fn next(&mut self, heard: Heard) -> Time<Host> {
        // It counts from the send instant; from the answer it would be off by the round trip.
        let offset = heard.dc.phase(self.grid.cycle as u64) as i64;
        heard.stamp + Nanos(self.grid.cycle - offset + self.grid.target)
    }
}
