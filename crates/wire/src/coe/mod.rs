//! CoE: the object protocol in the mailbox.
//!
//! The mailbox header is followed by a [`Header`] of two bytes that names a [`Service`]. [`sdo`]
//! has the transfers of single objects, [`info`] the services that describe the dictionary, and
//! [`abort`] the reasons for failures.

pub mod abort;
pub mod info;
pub mod sdo;

pub use abort::AbortCode;

/// Bytes of the CoE header.
pub const HEADER_LEN: usize = 2;

/// The kind of a CoE message. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Service(pub u8);

impl Service {
    /// Emergency, unsolicited.
    pub const EMERGENCY: Self = Self(1);
    /// SDO request; aborts travel as requests in both directions.
    pub const SDO_REQUEST: Self = Self(2);
    /// SDO response.
    pub const SDO_RESPONSE: Self = Self(3);
    /// SDO information.
    pub const SDO_INFORMATION: Self = Self(8);
}

/// The two bytes before a CoE service.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Header {
    /// Bits 8:0, 0 for SDO services.
    pub number: u16,
    /// Bits 15:12.
    pub service: Service,
}

impl Header {
    /// A header for an SDO service.
    pub const fn new(service: Service) -> Self {
        Self { number: 0, service }
    }
    /// Reads the two bytes; bits 11:9 are reserved and dropped.
    pub const fn parse(b: [u8; 2]) -> Self {
        let word = u16::from_le_bytes(b);
        Self { number: word & 0x01FF, service: Service((word >> 12) as u8) }
    }
    /// Writes the two bytes.
    pub const fn emit(self) -> [u8; 2] {
        (self.number & 0x01FF | (self.service.0 as u16 & 0xF) << 12).to_le_bytes()
    }
}

/// The data type of an entry, by its index in the dictionary. The code space is open.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct DataType(pub u16);

macro_rules! data_types {
    ($($code:literal $name:ident $bits:literal $text:literal;)*) => {
        impl DataType {
            $(#[doc = $text] pub const $name: Self = Self($code);)*

            /// Length of a value in bits, if the type has a fixed length.
            pub const fn bits(self) -> Option<u16> {
                match self.0 {
                    $($code if $bits > 0 => Some($bits),)*
                    _ => None,
                }
            }
            /// The name in documents; `None` for an unknown type.
            pub const fn name(self) -> Option<&'static str> {
                match self.0 { $($code => Some($text),)* _ => None }
            }
            /// The type with this name.
            pub fn from_name(name: &str) -> Option<Self> {
                match name { $($text => Some(Self($code)),)* _ => None }
            }
        }
    };
}

data_types! {
    0x0000 GAP 0 "GAP";
    0x0001 BOOLEAN 1 "BOOLEAN";
    0x0002 INTEGER8 8 "INTEGER8";
    0x0003 INTEGER16 16 "INTEGER16";
    0x0004 INTEGER32 32 "INTEGER32";
    0x0005 UNSIGNED8 8 "UNSIGNED8";
    0x0006 UNSIGNED16 16 "UNSIGNED16";
    0x0007 UNSIGNED32 32 "UNSIGNED32";
    0x0008 REAL32 32 "REAL32";
    0x0009 VISIBLE_STRING 0 "VISIBLE_STRING";
    0x000A OCTET_STRING 0 "OCTET_STRING";
    0x000B UNICODE_STRING 0 "UNICODE_STRING";
    0x0010 INTEGER24 24 "INTEGER24";
    0x0011 REAL64 64 "REAL64";
    0x0015 INTEGER64 64 "INTEGER64";
    0x0016 UNSIGNED24 24 "UNSIGNED24";
    0x001B UNSIGNED64 64 "UNSIGNED64";
    0x0021 PDO_MAPPING 0 "PDO_MAPPING";
    0x0023 IDENTITY 0 "IDENTITY";
    0x0029 SYNC_PAR 0 "SYNC_PAR";
    0x0030 BIT1 1 "BIT1";
    0x0031 BIT2 2 "BIT2";
    0x0032 BIT3 3 "BIT3";
    0x0033 BIT4 4 "BIT4";
    0x0034 BIT5 5 "BIT5";
    0x0035 BIT6 6 "BIT6";
    0x0036 BIT7 7 "BIT7";
    0x0037 BIT8 8 "BIT8";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captured_header() {
        assert_eq!(Header::parse([0x00, 0x20]), Header::new(Service::SDO_REQUEST));
        assert_eq!(Header::new(Service::SDO_RESPONSE).emit(), [0x00, 0x30]);
        assert_eq!(DataType::from_name("UNSIGNED32"), Some(DataType::UNSIGNED32));
    }
}
