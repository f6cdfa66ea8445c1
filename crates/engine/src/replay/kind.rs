//! Kinds of differences between silicon and model.

use isocat_maindevice::kinds;

kinds! {
    /// The kind of a difference.
    #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
    pub enum Kind {
        /// An earlier session left a register, a state or a mask that this capture has not written
        /// yet. The model adopts it.
        EarlierSession = "earlier-session",
        /// The EEPROM was still writing or already done: the time depends on the part.
        BurnTime = "burn-time",
        /// Errors on a cable or expired watchdogs were counted, which no capture at the MainDevice
        /// shows. The model adopts them.
        ErrorCounter = "error-counter",
        /// Another number of SubDevices than before was reached, or a cable was plugged or pulled.
        SegmentChange = "segment-change",
        /// A request before this frame has no answer in the capture, so it is not known whether it
        /// reached the SubDevices.
        LostFrame = "lost-frame",
        /// Other SubDevices than in the model incremented the working counter.
        WorkingCounter = "working-counter",
        /// The position differs.
        Position = "position",
        /// The IRQ field differs.
        EventField = "event-field",
        /// The mark in the source address differs.
        SourceAddress = "source-address",
        /// Identity and limits of the chip, registers 0x0000 to 0x0009 and 0x0140 to 0x0153.
        Identity = "identity",
        /// DL control or DL status.
        DataLink = "data-link",
        /// AL control, AL status or its code.
        ApplicationLayer = "application-layer",
        /// The EEPROM interface.
        Eeprom = "eeprom",
        /// A FMMU's registers.
        Fmmu = "fmmu",
        /// A SyncManager's registers.
        SyncManager = "sync-manager",
        /// A register of the clock that does not change by itself.
        Clock = "clock",
        /// Process data or other RAM.
        Memory = "memory",
        /// Another register.
        Register = "register",
    }
}

impl Kind {
    /// Whether it is a known variance of parts or sessions, and not a fault of the model.
    pub const fn is_explained(self) -> bool {
        use Kind::*;
        matches!(self, EarlierSession | BurnTime | ErrorCounter | SegmentChange | LostFrame)
    }

    /// The kind that belongs to this address.
    pub(crate) const fn of(address: u16) -> Self {
        match address {
            0x0000..0x0010 | 0x0140..0x0200 => Self::Identity,
            0x0100..0x0120 => Self::DataLink,
            0x0120..0x0140 => Self::ApplicationLayer,
            0x0500..0x0510 => Self::Eeprom,
            0x0600..0x0700 => Self::Fmmu,
            0x0800..0x0880 => Self::SyncManager,
            0x0900..0x0A00 => Self::Clock,
            0x0F80.. => Self::Memory,
            _ => Self::Register,
        }
    }
}
