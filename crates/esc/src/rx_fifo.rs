//! The receive FIFO of a port: how it changes the timing of a frame.
//!
//! A port receives with the clock of the transmitter at the other end of its cable, and the ESC
//! works with its own clock. The FIFO between them forwards a frame when it is half full, at the
//! next edge of the ESC's own clock: 40 ns for the nibbles of MII (25 MHz), 10 ns for EBUS. A frame
//! therefore waits for a part of a period. That part depends on the phase between the two clocks
//! and changes as they drift: this is the jitter of a hop. Receive times (0x0900) are taken behind
//! the FIFO: loops that captures show through couplers and terminals vary by a tick of EBUS at
//! most, although the coupler receives by MII.
//!
//! The published facts are 0x0100 bits 18:16 and their delays, bit 19, feature bit 4 (ESC data
//! sheet section II, DL control), and the nibble clock of MII. The effect of bit 19 on the jitter
//! is not published: half of it is this project's setting.

use isocat_wire::register::features;
use isocat_wire::{Picos, PortNumber};

use crate::chip::{Chip, PortKind};

/// The receive FIFOs of a kind of ESC.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct RxFifo {
    /// Period of the clock that takes frames from an MII port: 40 ns, a nibble at 100 Mbit/s.
    pub mii_period: Picos,
    /// Period of the clock that takes frames from an EBUS port: 10 ns.
    pub ebus_period: Picos,
    /// Period at an EBUS port while 0x0100 bit 19 asks for low jitter, on chips with feature bit 4.
    /// This project sets 5 ns, as if both edges of the clock were used.
    pub ebus_period_low_jitter: Picos,
    /// How much earlier a frame leaves an MII port's FIFO, by 0x0100 bits 18:16; 7 is the reset
    /// value and the longest.
    pub mii_reduction: &'static [Picos; 8],
    /// How much earlier a frame leaves an EBUS port's FIFO, by 0x0100 bits 18:16.
    pub ebus_reduction: &'static [Picos; 8],
}

impl RxFifo {
    /// ET1100, ET1200 and IP cores before 3.0: 40 ns less at sizes 0 to 3 of MII, 10 ns a step
    /// below 5 of EBUS.
    pub const COMMON: Self = Self {
        mii_period: Picos(40_000),
        ebus_period: Picos(10_000),
        ebus_period_low_jitter: Picos(5_000),
        mii_reduction: &nanos([40, 40, 40, 40, 0, 0, 0, 0]),
        ebus_reduction: &nanos([50, 40, 30, 20, 10, 0, 0, 0]),
    };
    /// ET1150 and IP core from 3.0 on: 80 ns less at sizes 0 and 1 of MII.
    pub const DEEPER: Self =
        Self { mii_reduction: &nanos([80, 80, 40, 40, 0, 0, 0, 0]), ..Self::COMMON };
}

/// How a port changes the timing of the frames that it receives.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Receiver {
    /// Period of the clock that takes frames: they come early or late by half of it at most. 0
    /// means no jitter.
    pub period: Picos,
    /// How much earlier frames come than at the reset value of the FIFO size.
    pub reduction: Picos,
}

impl Chip {
    /// The receiver of this port for the given value of register 0x0100.
    pub fn receiver(&self, port: PortNumber, dl_control: u32) -> Receiver {
        let fifo = &self.rx_fifo;
        let size = (dl_control >> 16 & 0b111) as usize;
        let low_jitter = dl_control & LOW_JITTER != 0 && self.has(features::LOW_JITTER_EBUS);
        match self.port(port) {
            PortKind::Mii => {
                Receiver { period: fifo.mii_period, reduction: fifo.mii_reduction[size] }
            }
            PortKind::Ebus => Receiver {
                period: if low_jitter { fifo.ebus_period_low_jitter } else { fifo.ebus_period },
                reduction: fifo.ebus_reduction[size],
            },
            PortKind::None | PortKind::NotConfigured => Receiver::default(),
        }
    }
}

/// DL control bit 19: EBUS low jitter.
const LOW_JITTER: u32 = 1 << 19;

const fn nanos(steps: [i64; 8]) -> [Picos; 8] {
    let mut picos = [Picos(0); 8];
    let mut size = 0;
    while size < 8 {
        picos[size] = Picos(1_000 * steps[size]);
        size += 1;
    }
    picos
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ET1100, IP_CORE_32};
    use PortNumber::{P0, P1, P3};

    fn receiver(chip: &Chip, port: PortNumber, dl_control: u32) -> (i64, i64) {
        let receiver = chip.receiver(port, dl_control);
        (receiver.period.0, receiver.reduction.0)
    }

    #[test]
    fn reset_values_take_nothing_off() {
        assert_eq!(receiver(&ET1100, P0, ET1100.dl_control), (40_000, 0));
        assert_eq!(receiver(&ET1100, P1, ET1100.dl_control), (10_000, 0));
        assert_eq!(receiver(&IP_CORE_32, P0, IP_CORE_32.dl_control), (40_000, 0));
        assert_eq!(receiver(&ET1100, P3, ET1100.dl_control), (0, 0), "no such port");
    }

    #[test]
    fn sizes_by_port_kind_and_chip() {
        let all =
            |chip: &Chip, port| [0u32, 1, 3, 4, 5].map(|size| receiver(chip, port, size << 16).1);
        assert_eq!(all(&ET1100, P0), [40_000, 40_000, 40_000, 0, 0]);
        assert_eq!(all(&ET1100, P1), [50_000, 40_000, 20_000, 10_000, 0]);
        let deeper = Chip { rx_fifo: RxFifo::DEEPER, ..IP_CORE_32 };
        assert_eq!(all(&deeper, P0), [80_000, 80_000, 40_000, 0, 0]);
    }

    #[test]
    fn low_jitter_is_for_ebus_and_for_chips_that_have_it() {
        let control = ET1100.dl_control | LOW_JITTER;
        assert_eq!(receiver(&ET1100, P1, control), (5_000, 0));
        assert_eq!(receiver(&ET1100, P0, control), (40_000, 0));
        let without = Chip { features: ET1100.features & !features::LOW_JITTER_EBUS, ..ET1100 };
        assert_eq!(receiver(&without, P1, control), (10_000, 0));
    }
}
