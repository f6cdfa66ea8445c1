//! Outputs that are written on a timeline: values in bits of a device's outputs from given instants
//! on.
//!
//! A value depends on the system time of its cycle ([`Cycle::next_grid`]) and not on the number of
//! calls of the application. So a motion continues in time if the host skips cycles, and
//! [`Written::value`] returns afterwards the intended value of a cycle, even if its frame was lost.

use alloc::vec::Vec;
use core::f64::consts::TAU;

use isocat_wire::time::{Dc, Host, Nanos, Time};

use crate::application::{Cycle, Device};
use crate::event::Event;

/// Bits of the outputs or inputs of a device, little-endian like process data.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Bits {
    /// The lowest bit, counted from the first byte.
    pub at: u32,
    /// Number of bits, 1 to 32.
    pub len: u8,
    /// Whether the highest bit is a sign.
    pub signed: bool,
}

impl Bits {
    /// The least and the largest number that they can hold.
    pub const fn range(self) -> (i64, i64) {
        match self.signed {
            true => (-(1 << (self.len - 1)), (1 << (self.len - 1)) - 1),
            false => (0, (1 << self.len) - 1),
        }
    }

    /// The first bit after them.
    pub const fn end(self) -> u32 {
        self.at + self.len as u32
    }

    /// Reads the number; `None` if the bytes end before it.
    pub fn read(self, bytes: &[u8]) -> Option<i64> {
        let mut number = 0;
        for bit in (self.at..self.end()).rev() {
            let byte = bytes.get(bit as usize / 8)?;
            number = number << 1 | i64::from(byte >> (bit % 8) & 1);
        }
        let is_negative = self.signed && number >> (self.len - 1) != 0;
        Some(if is_negative { number - (1 << self.len) } else { number })
    }

    /// Writes the number. A number out of range becomes the nearest possible one; bits beyond the
    /// end are left out.
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

/// When an output begins: with the first cycle that is due at this instant or later.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Start {
    /// This time after the machine was made, by the host's clock.
    At(Nanos),
    /// This time after all SubDevices that take part are in OP.
    InOperation(Nanos),
    /// This time after this number of cycles is complete.
    Cycle(u64, Nanos),
}

/// The course of an output from its start on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Shape {
    /// A value.
    Value {
        /// The value.
        value: i64,
        /// Time in which it is reached evenly from the value before; zero: at once.
        over: Nanos,
    },
    /// A sine around the value before.
    Sine {
        /// Amplitude.
        amplitude: i64,
        /// Period; above zero.
        period: Nanos,
        /// Time after which it stays at its present value; `None`: never.
        lasts: Option<Nanos>,
    },
}

impl Shape {
    /// The value at time `since` after it began at `base`.
    fn value(self, base: i64, since: Nanos) -> i64 {
        match self {
            Self::Value { value, over } if since >= over => value,
            Self::Value { value, over } => {
                let part = i128::from(value - base) * i128::from(since.0) / i128::from(over.0);
                base + part as i64
            }
            Self::Sine { amplitude, period, lasts } => {
                let since = lasts.map_or(since, |lasts| since.min(lasts));
                // The remainder keeps a long run as exact as its beginning.
                let turn = (since.0 % period.0) as f64 / period.0 as f64;
                base + libm::round(amplitude as f64 * libm::sin(TAU * turn)) as i64
            }
        }
    }
}

/// A value that is written from an instant on, until another output of the same bits begins.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Output {
    /// Position of the device.
    pub device: usize,
    /// The bits in its outputs.
    pub place: Bits,
    /// When it begins.
    pub start: Start,
    /// Its course.
    pub shape: Shape,
}

/// All outputs of a run on their timeline.
#[derive(Clone, Debug, Default)]
pub struct Written {
    outputs: Vec<Output>,
    origin: Time<Host>,
    /// The outputs that have begun, in this order.
    begun: Vec<Begun>,
    /// Whether [`Event::InOperation`] came.
    operates: bool,
    in_operation: Option<Time<Host>>,
    /// The instants at which given numbers of cycles were complete, for the outputs that wait for
    /// them.
    cycles: Vec<(u64, Time<Host>)>,
}

/// An output that has begun.
#[derive(Clone, Copy, Debug)]
struct Begun {
    output: usize,
    at: Time<Dc>,
    /// The value before it.
    base: i64,
}

impl Written {
    /// Written outputs; times count from `origin`.
    pub fn new(outputs: Vec<Output>, origin: Time<Host>) -> Self {
        // The capacity is allocated here, so that the cycle does not allocate.
        let (begun, cycles) =
            (Vec::with_capacity(outputs.len()), Vec::with_capacity(outputs.len()));
        Self { outputs, origin, begun, cycles, ..Self::default() }
    }

    /// Whether an output writes these bits, now or later.
    pub fn takes(&self, device: usize, place: Bits) -> bool {
        self.outputs.iter().any(|output| output.device == device && output.place == place)
    }

    /// The intended value of the cycle that finds the reference clock at `at`; `None` before the
    /// first output of these bits has begun.
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

    /// Starts the outputs that begin with the next cycle, when a cycle is complete. Afterwards
    /// [`write`](Self::write) is called for each device.
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

    /// Writes the values of the cycle at `grid` into the outputs of a device.
    pub(crate) fn write(&self, device: &mut Device<'_>, grid: Time<Dc>) {
        for (number, output) in self.outputs.iter().enumerate() {
            let before = &self.outputs[..number];
            let same =
                |other: &Output| other.device == output.device && other.place == output.place;
            // Each place is written once: its value takes all of its outputs into account.
            if output.device != device.position() || before.iter().any(same) {
                continue;
            }
            if let Some(value) = self.value(output.device, output.place, grid) {
                output.place.write(device.outputs_mut(), value);
            }
        }
    }

    /// Whether there are no outputs.
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
