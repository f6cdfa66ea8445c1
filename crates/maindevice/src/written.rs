//! Outputs that are written on a timeline: what stands in which bits of a device's outputs, from when on.
//!
//! A value depends on the system time for which its cycle is meant ([`Cycle::next_grid`]) and not on how often the application
//! was called. So a motion goes on in time where the host skips cycles, and [`Written::value`] says afterwards what was meant for
//! a cycle, whatever became of its frame.

use alloc::vec::Vec;
use core::f64::consts::TAU;

use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::application::{Cycle, Device};
use crate::event::Event;

/// Bits of the outputs or inputs of a device, little endian as process data are.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Bits {
    /// The lowest one, counted from the first byte.
    pub at: u32,
    /// How many, 1 to 32.
    pub len: u8,
    /// The highest one is a sign.
    pub signed: bool,
}

impl Bits {
    /// The numbers that they can hold.
    pub const fn range(self) -> (i64, i64) {
        match self.signed {
            true => (-(1 << (self.len - 1)), (1 << (self.len - 1)) - 1),
            false => (0, (1 << self.len) - 1),
        }
    }

    /// The first bit behind them.
    pub const fn end(self) -> u32 {
        self.at + self.len as u32
    }

    /// The number that stands there; `None` where the bytes end before.
    pub fn read(self, bytes: &[u8]) -> Option<i64> {
        let mut number = 0;
        for bit in (self.at..self.end()).rev() {
            let byte = bytes.get(bit as usize / 8)?;
            number = number << 1 | i64::from(byte >> (bit % 8) & 1);
        }
        let is_negative = self.signed && number >> (self.len - 1) != 0;
        Some(if is_negative { number - (1 << self.len) } else { number })
    }

    /// Puts a number there. One that does not fit becomes the nearest that does; bits behind the end are left out.
    pub fn write(self, bytes: &mut [u8], number: i64) {
        let (least, most) = self.range();
        let number = number.clamp(least, most);
        for bit in self.at..self.end() {
            let Some(byte) = bytes.get_mut(bit as usize / 8) else { return };
            let mask = 1 << (bit % 8);
            match number >> (bit - self.at) & 1 {
                0 => *byte &= !mask,
                _ => *byte |= mask,
            }
        }
    }
}

/// When an output begins: with the first cycle that is due then or later.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Start {
    /// So long after the machine was made, by the host's clock.
    At(Nanos),
    /// So long after all SubDevices that take part are in OP.
    InOperation(Nanos),
    /// So long after so many cycles are over.
    Cycle(u64, Nanos),
}

/// What is written from then on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Shape {
    /// A value.
    Value {
        /// The value.
        value: i64,
        /// It is reached evenly within this time, from what stood there before; zero: at once.
        over: Nanos,
    },
    /// A sine around what stood there before.
    Sine {
        /// The farthest from it.
        amplitude: i64,
        /// Of one swing; above zero.
        period: Nanos,
        /// It stops where it is after this time; `None`: never.
        lasts: Option<Nanos>,
    },
}

impl Shape {
    /// What it comes to, so long after it began at `base`.
    fn value(self, base: i64, since: Nanos) -> i64 {
        match self {
            Self::Value { value, over } if since >= over => value,
            Self::Value { value, over } => {
                let part = i128::from(value - base) * i128::from(since.0) / i128::from(over.0);
                base + part as i64
            }
            Self::Sine { amplitude, period, lasts } => {
                let since = lasts.map_or(since, |lasts| since.min(lasts));
                // From the remainder, so that a long run is as exact as its beginning.
                let turn = (since.0 % period.0) as f64 / period.0 as f64;
                base + libm::round(amplitude as f64 * libm::sin(TAU * turn)) as i64
            }
        }
    }
}

/// Something that is written from an instant on, until another one of the same bits begins.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Output {
    /// Position of the device.
    pub device: usize,
    /// Where in its outputs.
    pub place: Bits,
    /// When it begins.
    pub start: Start,
    /// What is written.
    pub shape: Shape,
}

/// All outputs of a run on their timeline.
#[derive(Clone, Debug, Default)]
pub struct Written {
    outputs: Vec<Output>,
    origin: Time<Host>,
    /// Those that have begun, in that order.
    begun: Vec<Begun>,
    /// [`Event::InOperation`] came; the first cycle since is not told yet.
    operates: bool,
    in_operation: Option<Time<Host>>,
    /// The instants at which so many cycles were over, for those that wait for it.
    cycles: Vec<(u64, Time<Host>)>,
}

/// An output that has begun.
#[derive(Clone, Copy, Debug)]
struct Begun {
    output: usize,
    at: Time<Dc>,
    /// What stood there.
    base: i64,
}

impl Written {
    /// These outputs; times count from `origin`.
    pub fn new(outputs: Vec<Output>, origin: Time<Host>) -> Self {
        // The cycle allocates nothing when they begin.
        let (begun, cycles) =
            (Vec::with_capacity(outputs.len()), Vec::with_capacity(outputs.len()));
        Self { outputs, origin, begun, cycles, ..Self::default() }
    }

    /// Whether these bits are written, now or later.
    pub fn takes(&self, device: usize, place: Bits) -> bool {
        self.outputs.iter().any(|output| output.device == device && output.place == place)
    }

    /// What is meant for the cycle that finds the reference clock at `at`; `None` before the first output of these bits has
    /// begun.
    pub fn value(&self, device: usize, place: Bits, at: Time<Dc>) -> Option<i64> {
        let of_place = |begun: &&Begun| {
            let output = &self.outputs[begun.output];
            output.device == device && output.place == place && begun.at <= at
        };
        let begun = self.begun.iter().rev().find(of_place)?;
        Some(self.outputs[begun.output].shape.value(begun.base, at - begun.at))
    }

    pub(crate) fn event(&mut self, event: &Event) {
        if matches!(event, Event::InOperation { .. }) {
            self.operates = true;
        }
    }

    /// A cycle is over: what begins with the next one. Afterwards [`write`](Self::write) is called for each device.
    pub(crate) fn begin(&mut self, cycle: &mut Cycle<'_>) {
        if self.begun.len() == self.outputs.len() {
            return;
        }
        let (Some(due), Some(grid)) = (cycle.next(), cycle.next_grid()) else { return };
        if self.operates && self.in_operation.is_none() {
            self.in_operation = Some(due);
        }
        for number in 0..self.outputs.len() {
            let is_known = self.begun.iter().any(|begun| begun.output == number);
            if is_known || !self.is_due(number, cycle.number(), due) {
                continue;
            }
            let Output { device, place, .. } = self.outputs[number];
            let stood =
                self.value(device, place, grid).or_else(|| place.read(cycle.outputs_mut(device)));
            self.begun.push(Begun { output: number, at: grid, base: stood.unwrap_or(0) });
        }
    }

    fn is_due(&mut self, number: usize, cycle: u64, due: Time<Host>) -> bool {
        match self.outputs[number].start {
            Start::At(time) => due >= self.origin + time,
            Start::InOperation(later) => self.in_operation.is_some_and(|at| due >= at + later),
            Start::Cycle(count, later) => {
                let known = self.cycles.iter().find(|(of, _)| *of == count).map(|(_, at)| *at);
                if known.is_none() && cycle >= count {
                    self.cycles.push((count, due));
                }
                let at = known.or((cycle >= count).then_some(due));
                at.is_some_and(|at| due >= at + later)
            }
        }
    }

    /// Writes what is meant for the cycle at `grid` into the outputs of a device.
    pub(crate) fn write(&self, device: &mut Device<'_>, grid: Time<Dc>) {
        for (number, output) in self.outputs.iter().enumerate() {
            let before = &self.outputs[..number];
            let same =
                |other: &Output| other.device == output.device && other.place == output.place;
            // Each place once: its value takes all of its outputs into account.
            if output.device != device.position() || before.iter().any(same) {
                continue;
            }
            if let Some(value) = self.value(output.device, output.place, grid) {
                output.place.write(device.outputs_mut(), value);
            }
        }
    }

    /// Whether there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.outputs.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_lie_anywhere_and_keep_their_neighbours() {
        let place = Bits { at: 5, len: 9, signed: true };
        let mut bytes = [0xFF; 3];
        for number in [0, 1, -1, 255, -256, 77] {
            place.write(&mut bytes, number);
            assert_eq!(place.read(&bytes), Some(number));
            assert_eq!((bytes[0] & 0x1F, bytes[1] & 0xC0, bytes[2]), (0x1F, 0xC0, 0xFF));
        }
        place.write(&mut bytes, 256);
        assert_eq!(place.read(&bytes), Some(255), "the nearest that fits");
        assert_eq!(Bits { signed: false, ..place }.range(), (0, 511));
        assert_eq!(Bits { at: 16, ..place }.read(&bytes), None);
    }

    #[test]
    fn a_ramp_is_even_and_ends_at_its_value() {
        let ramp = Shape::Value { value: -300, over: Nanos(1_000) };
        let at = |ns| ramp.value(100, Nanos(ns));
        assert_eq!(
            [0, 1, 10, 500, 999, 1_000, 5_000].map(at),
            [100, 100, 96, -100, -299, -300, -300]
        );
        let step = Shape::Value { value: 7, over: Nanos::ZERO };
        assert_eq!(step.value(0, Nanos::ZERO), 7);
    }

    #[test]
    fn a_sine_swings_about_what_stood_there() {
        let sine = |lasts| Shape::Sine { amplitude: 1_000, period: Nanos(1_200), lasts };
        let at = |ns| sine(None).value(50, Nanos(ns));
        assert_eq!(
            [0, 100, 300, 600, 900, 1_200, 1_500].map(at),
            [50, 550, 1_050, 50, -950, 50, 1_050]
        );
        assert_eq!(sine(Some(Nanos(300))).value(50, Nanos(301)), 1_050);
    }
}
