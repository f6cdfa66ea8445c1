//! The reasons why an SDO transfer failed.

use core::fmt;

/// SDO abort code. The code space is open, so unknown codes are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct AbortCode(pub u32);

macro_rules! codes {
    ($($code:literal $name:ident $text:literal;)*) => {
        impl AbortCode {
            $(#[doc = $text] pub const $name: Self = Self($code);)*

            /// Every code that this crate knows, in ascending order.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// The meaning of the code in words; `None` for a code that this crate does not know.
            pub const fn meaning(self) -> Option<&'static str> {
                match self.0 { $($code => Some($text),)* _ => None }
            }
        }
    };
}

codes! {
    0x0503_0000 TOGGLE "toggle bit not changed";
    0x0504_0000 TIMEOUT "SDO protocol timeout";
    0x0504_0001 COMMAND_SPECIFIER "command specifier not valid or unknown";
    0x0504_0002 BLOCK_SIZE "invalid block size";
    0x0504_0003 SEQUENCE_NUMBER "invalid sequence number";
    0x0504_0004 CRC "CRC error";
    0x0504_0005 OUT_OF_MEMORY "out of memory";
    0x0601_0000 UNSUPPORTED_ACCESS "unsupported access to an object";
    0x0601_0001 WRITE_ONLY "read of a write-only entry";
    0x0601_0002 READ_ONLY "write of a read-only entry";
    0x0601_0003 SUB0_NOT_ZERO "sub-index 0 must be 0 first";
    0x0601_0004 NO_COMPLETE_ACCESS "complete access not supported";
    0x0601_0005 OBJECT_TOO_BIG "object too big for the mailbox";
    0x0601_0006 MAPPED "download blocked, object is mapped";
    0x0602_0000 NO_OBJECT "object does not exist";
    0x0604_0041 NOT_MAPPABLE "object can't be mapped";
    0x0604_0042 PDO_TOO_LONG "PDO too long";
    0x0604_0043 PARAMETER_INCOMPATIBLE "parameter incompatible";
    0x0604_0047 INTERNAL_INCOMPATIBLE "internal incompatibility";
    0x0606_0000 HARDWARE "hardware error";
    0x0607_0010 LENGTH_MISMATCH "length does not match the type";
    0x0607_0012 TOO_LONG "value too long";
    0x0607_0013 TOO_SHORT "value too short";
    0x0609_0011 NO_SUBINDEX "sub-index does not exist";
    0x0609_0030 VALUE_RANGE "value out of range";
    0x0609_0031 TOO_HIGH "value too high";
    0x0609_0032 TOO_LOW "value too low";
    0x0609_0033 MODULE_MISMATCH "module list mismatch";
    0x0609_0036 MAX_BELOW_MIN "maximum below minimum";
    0x060A_0023 RESOURCE "resource not available";
    0x0800_0000 GENERAL "general error";
    0x0800_0020 CANNOT_TRANSFER "data can't be transferred or stored";
    0x0800_0021 LOCAL_CONTROL "data can't be stored because of local control";
    0x0800_0022 WRONG_STATE "not in this device state";
    0x0800_0023 NO_DICTIONARY "no object dictionary";
    0x0800_0024 NO_DATA "no data";
}

/// Prints `0x06010002 (write of a read-only entry)`.
impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let meaning = self.meaning().unwrap_or("a code of the vendor");
        write!(f, "0x{:08X} ({meaning})", self.0)
    }
}
