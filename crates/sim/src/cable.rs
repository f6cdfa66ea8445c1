//! Cables and the PHYs at their ends: the delays of signals, and the time until a lost signal is
//! noticed.

use isocat_wire::time::Picos;

/// Signal speed on a cable: 5 ns per metre.
pub(crate) const PICOS_PER_MILLIMETRE: i64 = 5;

/// Direction along a cable, by the order in which its ends were named.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Direction {
    /// Away from the MainDevice's primary port.
    Out,
    /// Back towards it.
    Back,
}

/// A cable. Its two pairs of wires need not be equally long. No measurement from outside shows the
/// difference, so half of it becomes an error of every measured delay.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cable {
    /// Delay from transmitter to receiver, away from the MainDevice.
    pub out: Picos,
    /// Delay from transmitter to receiver, towards the MainDevice.
    pub back: Picos,
    /// Setting: time from the cut until both ESCs notice it. Default 15 us, since enhanced link
    /// detection needs about ten broken symbols or frames; a PHY without it may take milliseconds.
    pub link_loss: Picos,
    /// Setting: time from plugging in until both ESCs have a link. Default 300 ms; negotiation of
    /// 100BASE-TX takes between some 100 ms and 3 s, EBUS some microseconds.
    pub link_gain: Picos,
}

impl Cable {
    /// A cable of this length, mm, with 5 ns per metre in both directions.
    pub const fn of_length(mm: u64) -> Self {
        Self::with_speed(mm, 1_000 * PICOS_PER_MILLIMETRE)
    }

    /// A cable of this length, mm, with a given signal delay, ps per metre.
    pub const fn with_speed(mm: u64, picos_per_metre: i64) -> Self {
        let delay = Picos(mm as i64 * picos_per_metre / 1_000);
        Self {
            out: delay,
            back: delay,
            link_loss: Picos(15_000_000),
            link_gain: Picos(300_000_000_000),
        }
    }

    /// The same cable with a way out that is longer than its way back by `difference`; the mean
    /// stays unchanged. Neither way becomes shorter than zero.
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
    /// Delay from the ESC to the cable.
    pub transmit: Picos,
    /// Delay from the cable to the ESC.
    pub receive: Picos,
}

impl Phy {
    /// A PHY with the same delay in both directions.
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
