//! What the DC unit of a SubDevice can do.

/// What the DC unit of a SubDevice can do.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum DcCapability {
    /// Nothing.
    #[default]
    None,
    /// Receive times only: 0x0900 answers, 0x0910 does not.
    ReceiveTimes,
    /// A system time of 32 bits.
    Clock32,
    /// A system time of 64 bits.
    Clock64,
}

impl DcCapability {
    /// Whether there is a system time.
    pub const fn has_clock(self) -> bool {
        matches!(self, Self::Clock32 | Self::Clock64)
    }
    /// Whether port receive times are latched.
    pub(crate) const fn has_receive_times(self) -> bool {
        !matches!(self, Self::None)
    }
}
