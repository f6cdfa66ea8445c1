//! Which datagrams an ESC can answer, for a caller that passes frames by many ESCs.
//!
//! A datagram that [`Reach::concerns`] excludes changes nothing in the ESC, and the ESC changes
//! only its auto-increment address. The set may be too large, but never too small.

use core::ops::Range;

use isocat_wire::{Command, register};

use crate::esc::Esc;

/// The addresses in force that an ESC answers, and what it does to every frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Reach {
    /// Its station address, register 0x0010.
    pub station: u16,
    /// Its alias, register 0x0012, if DL control switches it on.
    pub alias: Option<u16>,
    /// Logical addresses from the first to the last that any active FMMU maps; empty if no FMMU is
    /// active. A range up to the end of the address space is cut there.
    pub logical: (u32, u32),
    /// The ESC adds events to the IRQ field of every datagram: register 0x0200 is not 0.
    pub adds_events: bool,
    /// The ESC marks the source address of frames: DL control bit 0.
    pub marks_frames: bool,
    /// Port 0 of the ESC is closed by itself: the ESC marks or destroys every frame.
    pub stops_circulating: bool,
}

impl Reach {
    /// The logical addresses, as a range of 64 bits.
    pub fn logical(&self) -> Range<u64> {
        u64::from(self.logical.0)..u64::from(self.logical.1) + u64::from(self.logical.1 == u32::MAX)
    }

    /// Whether a datagram of `len` data bytes may concern the ESC; `address` is as it arrives.
    pub fn concerns(&self, command: Command, address: u32, len: usize) -> bool {
        use Command::*;
        let adp = address as u16;
        if self.adds_events || self.stops_circulating {
            return true;
        }
        match command {
            Nop => false,
            Aprd | Apwr | Aprw => adp == 0,
            Fprd | Fpwr | Fprw => adp == self.station || Some(adp) == self.alias,
            Lrd | Lwr | Lrw => {
                let logical = self.logical();
                let first = u64::from(address);
                first < logical.end && first + len as u64 > logical.start
            }
            Brd | Bwr | Brw | Armw | Frmw => true,
        }
    }
}

impl<M: AsRef<[u8]> + AsMut<[u8]>> Esc<M> {
    /// The present reach. It is valid until [`reach_version`](Self::reach_version) changes.
    #[inline(never)]
    pub fn reach(&self) -> Reach {
        let control = self.register(register::DL_CONTROL);
        let (first, end) = self.fmmus.hull();
        Reach {
            station: self.register(register::STATION_ADDRESS),
            alias: (control >> 24 & 1 != 0).then(|| self.register(register::STATION_ALIAS)),
            logical: (first, u32::try_from(end).unwrap_or(u32::MAX)),
            adds_events: self.register(register::ECAT_EVENT_MASK) != 0,
            marks_frames: self.marks_frames(),
            stops_circulating: self.stops_circulating(),
        }
    }

    /// A counter of all changes that may affect the reach; it wraps.
    pub fn reach_version(&self) -> u32 {
        self.reach_version
    }

    /// Whether the reach may change without a further call: by the frame in flight, by a temporary
    /// setting of the loops, or because a write enable (0x0020, 0x0030) is set, which ends when any
    /// frame comes.
    pub fn reach_is_changing(&self) -> bool {
        use isocat_wire::Time;
        let enabled = self.registers.byte(register::REGISTER_WRITE_ENABLE.address)
            | self.registers.byte(register::ESC_WRITE_ENABLE.address);
        enabled != 0
            || self.ports.due() != Time::NEVER
            || self.flight.end != Time::NEVER
                && PAGES.iter().any(|page| self.shadow.touches_page(*page))
    }

    /// DL control bit 0: frames of other protocols are destroyed, and EtherCAT frames are marked.
    pub(crate) fn marks_frames(&self) -> bool {
        self.registers.byte(register::DL_CONTROL.address) & 1 != 0
    }
}

/// Pages of 256 registers that contain registers of the reach.
pub(crate) const PAGES: [u16; 4] = [0x0000, 0x0100, 0x0200, 0x0600];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_of_the_logical_range() {
        let reach = Reach { logical: (0x100, 0x104), ..Reach::default() };
        for (address, len, expected) in
            [(0xFF, 1, false), (0xFF, 2, true), (0x103, 1, true), (0x104, 1, false)]
        {
            assert_eq!(reach.concerns(Command::Lrw, address, len), expected, "{address:#x} {len}");
        }
        let last = Reach { logical: (u32::MAX, u32::MAX), ..Reach::default() };
        assert!(last.concerns(Command::Lrd, u32::MAX, 1));
        assert!(!last.concerns(Command::Lrd, u32::MAX - 1, 1));
        assert!(!Reach::default().concerns(Command::Lrd, 0, 1), "no FMMU, no answer");
    }

    #[test]
    fn an_alias_that_the_pdi_writes_is_another_reach() {
        use crate::{Esc, LAN9252, Pdi};
        use isocat_wire::Time;
        let mut esc = Esc::new(&LAN9252, std::vec![0; 256], std::vec![0; 4096]);
        let before = esc.reach_version();
        esc.pdi(Time::new(1_000)).write(register::STATION_ALIAS.address, &[7, 0]);
        assert_eq!(esc.register(register::STATION_ALIAS), 7);
        assert_ne!(esc.reach_version(), before);
    }

    #[test]
    fn addresses() {
        let reach = Reach { station: 0x1001, alias: Some(7), ..Reach::default() };
        assert!(reach.concerns(Command::Fprd, 0x1001, 1) && reach.concerns(Command::Fpwr, 7, 1));
        assert!(!reach.concerns(Command::Fprd, 0x1000, 1));
        assert!(reach.concerns(Command::Aprd, 0x0130_0000, 1));
        assert!(!reach.concerns(Command::Aprd, 0x0130_FFFF, 1));
        assert!(reach.concerns(Command::Armw, 0x0130_FFFF, 1), "all others write");
        assert!(!reach.concerns(Command::Nop, 0, 1));
        let attentive = Reach { adds_events: true, ..reach };
        assert!(attentive.concerns(Command::Fprd, 0x1000, 1));
    }
}
