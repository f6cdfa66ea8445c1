//! The reasons why an SoE service failed.

use core::fmt;

/// SoE error code. The code space is open, so unknown codes are kept.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ErrorCode(pub u16);

macro_rules! codes {
    ($($code:literal $name:ident $text:literal;)*) => {
        impl ErrorCode {
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
    0x0009 INVALID_ACCESS "element 0 can't be accessed like that";
    0x1001 NO_IDN "the drive does not have this IDN";
    0x1009 INVALID_ELEMENT "element 1 can't be accessed like that";
    0x2001 NO_NAME "the IDN has no name";
    0x2002 NAME_TOO_SHORT "name too short";
    0x2003 NAME_TOO_LONG "name too long";
    0x2004 NAME_READ_ONLY "write of a read-only name";
    0x2005 NAME_PROTECTED "name can't be written at present";
    0x3002 ATTRIBUTE_TOO_SHORT "attribute too short";
    0x3003 ATTRIBUTE_TOO_LONG "attribute too long";
    0x3004 ATTRIBUTE_READ_ONLY "write of a read-only attribute";
    0x3005 ATTRIBUTE_PROTECTED "attribute can't be written at present";
    0x4001 NO_UNIT "the IDN has no unit";
    0x4002 UNIT_TOO_SHORT "unit too short";
    0x4003 UNIT_TOO_LONG "unit too long";
    0x4004 UNIT_READ_ONLY "write of a read-only unit";
    0x4005 UNIT_PROTECTED "unit can't be written at present";
    0x5001 NO_MINIMUM "the IDN has no minimum";
    0x5002 MINIMUM_TOO_SHORT "minimum too short";
    0x5003 MINIMUM_TOO_LONG "minimum too long";
    0x5004 MINIMUM_READ_ONLY "write of a read-only minimum";
    0x5005 MINIMUM_PROTECTED "minimum can't be written at present";
    0x6001 NO_MAXIMUM "the IDN has no maximum";
    0x6002 MAXIMUM_TOO_SHORT "maximum too short";
    0x6003 MAXIMUM_TOO_LONG "maximum too long";
    0x6004 MAXIMUM_READ_ONLY "write of a read-only maximum";
    0x6005 MAXIMUM_PROTECTED "maximum can't be written at present";
    0x7002 VALUE_TOO_SHORT "value too short";
    0x7003 VALUE_TOO_LONG "value too long";
    0x7004 VALUE_READ_ONLY "write of a read-only value";
    0x7005 VALUE_PROTECTED "value can't be written at present";
    0x7006 VALUE_TOO_LOW "value below the minimum";
    0x7007 VALUE_TOO_HIGH "value above the maximum";
    0x7008 VALUE_INVALID "value not valid, or a configured IDN is not supported";
    0x7009 VALUE_PASSWORD "value protected by a password";
    0x700A VALUE_CYCLIC "value is in the process data and can't be written";
    0x700B INDIRECT_ADDRESS "indirect address not valid";
    0x700C VALUE_OTHER_SETTINGS "value can't be written because of other settings";
    0x7010 COMMAND_ACTIVE "the command is active already";
    0x7011 COMMAND_NOT_INTERRUPTIBLE "the command can't be interrupted";
    0x7012 COMMAND_NOT_NOW "the command can't be carried out at present";
    0x7013 COMMAND_PARAMETERS "the command can't be carried out with these parameters";
    0x7014 NO_DATA_STATE "the IDN has no data state";
    0x8001 NO_DEFAULT "the IDN has no default value";
    0x8002 DEFAULT_TOO_LONG "default value too long";
    0x8004 DEFAULT_READ_ONLY "write of a read-only default value";
    0x800A DRIVE_NUMBER "the SubDevice has no drive with this number";
    0x800B GENERAL "general error";
    0x800C NO_ELEMENT "no element addressed";
}

impl ErrorCode {
    /// Length on the wire in bytes.
    pub const LEN: usize = 2;
}

/// Prints `SoE error 0x1001 (the drive does not have this IDN)`.
impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let meaning = self.meaning().unwrap_or("a code of the vendor");
        write!(f, "SoE error 0x{:04X} ({meaning})", self.0)
    }
}
