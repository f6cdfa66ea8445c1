//! The fifteen datagram commands.

use core::fmt;

/// The access that a datagram asks of the SubDevices it passes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
#[repr(u8)]
pub enum Command {
    /// No operation; the datagram passes unchanged.
    Nop = 0,
    /// Auto-increment physical read.
    Aprd = 1,
    /// Auto-increment physical write.
    Apwr = 2,
    /// Auto-increment physical read and write.
    Aprw = 3,
    /// Configured address physical read.
    Fprd = 4,
    /// Configured address physical write.
    Fpwr = 5,
    /// Configured address physical read and write.
    Fprw = 6,
    /// Broadcast read: every SubDevice ORs its data in.
    Brd = 7,
    /// Broadcast write.
    Bwr = 8,
    /// Broadcast read and write.
    Brw = 9,
    /// Logical read.
    Lrd = 10,
    /// Logical write.
    Lwr = 11,
    /// Logical read and write.
    Lrw = 12,
    /// Auto-increment read, all others write.
    Armw = 13,
    /// Configured address read, all others write.
    Frmw = 14,
}

/// A command byte outside 0..=14.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct UnknownCommand(pub u8);

impl fmt::Display for UnknownCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "unknown command {:#04x}, expected 0..=14", self.0)
    }
}

impl Command {
    /// All commands in the order of their codes.
    pub const ALL: [Command; 15] = [
        Command::Nop,
        Command::Aprd,
        Command::Apwr,
        Command::Aprw,
        Command::Fprd,
        Command::Fpwr,
        Command::Fprw,
        Command::Brd,
        Command::Bwr,
        Command::Brw,
        Command::Lrd,
        Command::Lwr,
        Command::Lrw,
        Command::Armw,
        Command::Frmw,
    ];

    /// The four-letter name used by data sheets and analysers.
    pub const fn name(self) -> &'static str {
        match self {
            Command::Nop => "NOP",
            Command::Aprd => "APRD",
            Command::Apwr => "APWR",
            Command::Aprw => "APRW",
            Command::Fprd => "FPRD",
            Command::Fpwr => "FPWR",
            Command::Fprw => "FPRW",
            Command::Brd => "BRD",
            Command::Bwr => "BWR",
            Command::Brw => "BRW",
            Command::Lrd => "LRD",
            Command::Lwr => "LWR",
            Command::Lrw => "LRW",
            Command::Armw => "ARMW",
            Command::Frmw => "FRMW",
        }
    }

    /// Whether the address is logical (32 bits, resolved by FMMUs).
    pub const fn is_logical(self) -> bool {
        matches!(self, Command::Lrd | Command::Lwr | Command::Lrw)
    }

    /// Whether every ESC that processes the datagram increments the position in it.
    pub const fn increments_position(self) -> bool {
        use Command::*;
        matches!(self, Aprd | Apwr | Aprw | Brd | Bwr | Brw | Armw)
    }
}

impl TryFrom<u8> for Command {
    type Error = UnknownCommand;
    fn try_from(code: u8) -> Result<Self, UnknownCommand> {
        Command::ALL.get(usize::from(code)).copied().ok_or(UnknownCommand(code))
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_positions_in_the_table() {
        for (code, command) in Command::ALL.iter().enumerate() {
            assert_eq!(*command as usize, code);
            assert_eq!(Command::try_from(code as u8), Ok(*command));
        }
        assert_eq!(Command::try_from(15), Err(UnknownCommand(15)));
    }
}
