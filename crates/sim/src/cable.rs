//! Cables and the PHYs at their ends: how long signals take, and how long it takes to notice that
//! they have gone.

use isocat_wire::time::Picos;

/// Signal speed on a cable: 5 ns per metre.
pub(crate) const PICOS_PER_MILLIMETRE: i64 = 5;

/// Which way along a cable, as its ends were named: from the MainDevice outwards, or back.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Direction {
    /// Away from the MainDevice's primary port.
    Out,
    /// Back towards it.
    Back,
}

/// A cable. Its two pairs of wires need not be equally long: no measurement from outside can tell,
/// so that half of the difference becomes an error of every measured delay.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cable {
    /// From transmitter to receiver, away from the MainDevice.
    pub out: Picos,
    /// From transmitter to receiver, towards the MainDevice.
    pub back: Picos,
    /// From the cut until both ESCs know: setting. Default 15 us, as enhanced link detection needs about
    /// ten broken symbols or frames; a PHY without it may take milliseconds.
    pub link_loss: Picos,
    /// From plugging in until both ESCs have a link: setting. Default 300 ms; negotiation of 100BASE-TX
    /// takes between some 100 ms and 3 s, EBUS some microseconds.
    pub link_gain: Picos,
}

impl Cable {
    /// A cable of this length, mm, 5 ns per metre, both ways alike.
    pub const fn of_length(mm: u64) -> Self {
        Self::with_speed(mm, 1_000 * PICOS_PER_MILLIMETRE)
    }

    /// A cable of this length, mm, with a speed of its own, ps per metre.
    pub const fn with_speed(mm: u64, picos_per_metre: i64) -> Self {
        let delay = Picos(mm as i64 * picos_per_metre / 1_000);
        Self {
            out: delay,
            back: delay,
            link_loss: Picos(15_000_000),
            link_gain: Picos(300_000_000_000),
        }
    }

    /// The same cable whose way out is longer than its way back by `difference`; the mean stays. Neither
    /// way gets shorter than zero.
    pub fn with_asymmetry(self, difference: Picos) -> Self {
        let half = difference.0 / 2;
        let out = Picos((self.out.0 + half).max(0));
        Self { out, back: Picos((self.back.0 + half - difference.0).max(0)), ..self }
    }

    /// The delay in one direction.
    pub const fn delay(&self, direction: Direction) -> Picos {
        match direction {
            Direction::Out => self.out,
            Direction::Back => self.back,
        }
    }
}

impl Default for Cable {
    /// Ten metres.
    fn default() -> Self {
        Self::of_length(10_000)
    }
}

/// The PHY of a port. An EBUS port has none: both delays are zero.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Phy {
    /// From the ESC to the cable.
    pub transmit: Picos,
    /// From the cable to the ESC.
    pub receive: Picos,
}

impl Phy {
    /// A PHY that takes the same time both ways.
    pub(crate) const fn symmetric(delay: Picos) -> Self {
        Self { transmit: delay, receive: delay }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn length_speed_and_asymmetry() {
        let cable = Cable::of_length(10_000);
        assert_eq!((cable.out, cable.back), (Picos(50_000), Picos(50_000)));
        assert_eq!(Cable::with_speed(10_000, 5_300).out, Picos(53_000));
        let uneven = cable.with_asymmetry(Picos(3_001));
        assert_eq!(uneven.out.0 - uneven.back.0, 3_001);
        assert_eq!((uneven.out.0 + uneven.back.0) / 2, 49_999, "the mean to 1 ps");
        let shorter = cable.with_asymmetry(Picos(-4_000));
        assert_eq!((shorter.out, shorter.back), (Picos(48_000), Picos(52_000)));
    }
}
