//! SDO transfers: the bytes behind the CoE header.
//!
//! An initiate message or an abort is eight bytes, [`Initiate`], which data may follow. A segment
//! is one command byte, [`SegmentCommand`], and data. The caller handles data beyond the eight
//! bytes.

use super::abort::AbortCode;
use crate::address::ObjectAddress;

/// Bytes of an initiate or abort message behind the CoE header.
pub const INITIATE_LEN: usize = 8;
/// Least number of data bytes in a segment message: shorter data are padded, and the command counts
/// the padding.
pub const MIN_SEGMENT_DATA: usize = 7;

/// Bits 7:5 of the command byte.
pub mod specifier {
    /// Request: download segment. Response: upload segment.
    pub const REQUEST_DOWNLOAD_SEGMENT: u8 = 0;
    /// Request: initiate download.
    pub const REQUEST_DOWNLOAD: u8 = 1;
    /// Request: initiate upload.
    pub const REQUEST_UPLOAD: u8 = 2;
    /// Request: upload segment.
    pub const REQUEST_UPLOAD_SEGMENT: u8 = 3;
    /// Either side: abort.
    pub const ABORT: u8 = 4;
    /// Response: upload segment.
    pub const RESPONSE_UPLOAD_SEGMENT: u8 = 0;
    /// Response: download segment.
    pub const RESPONSE_DOWNLOAD_SEGMENT: u8 = 1;
    /// Response: initiate upload.
    pub const RESPONSE_UPLOAD: u8 = 2;
    /// Response: initiate download.
    pub const RESPONSE_DOWNLOAD: u8 = 3;
}

/// The command byte of an initiate message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Command(pub u8);

impl Command {
    /// Initiate upload request, optionally with complete access.
    pub const fn upload_request(complete: bool) -> Self {
        Self(0x40 | (complete as u8) << 4)
    }
    /// Initiate download request with `len` (1..=4) bytes in the message itself.
    pub const fn download_expedited(len: usize, complete: bool) -> Self {
        Self(0x23 | ((4 - len) as u8) << 2 | (complete as u8) << 4)
    }
    /// Initiate download request with the size in the message and data behind.
    pub const fn download_normal(complete: bool) -> Self {
        Self(0x21 | (complete as u8) << 4)
    }
    /// Initiate upload response with `len` (1..=4) bytes in the message itself.
    pub const fn upload_expedited(len: usize, complete: bool) -> Self {
        Self(0x43 | ((4 - len) as u8) << 2 | (complete as u8) << 4)
    }
    /// Initiate upload response with the size in the message and data behind.
    pub const fn upload_normal(complete: bool) -> Self {
        Self(0x41 | (complete as u8) << 4)
    }
    /// Initiate download response.
    pub const fn download_response(complete: bool) -> Self {
        Self(0x60 | (complete as u8) << 4)
    }
    /// Abort.
    pub const ABORT: Self = Self(0x80);

    /// Bits 7:5.
    pub const fn specifier(self) -> u8 {
        self.0 >> 5
    }
    /// Bit 4: complete access, to the whole object.
    pub const fn complete(self) -> bool {
        self.0 & 0x10 != 0
    }
    /// Bit 1: the data are in the message itself.
    pub const fn expedited(self) -> bool {
        self.0 & 0x02 != 0
    }
    /// Bit 0: the size is given.
    pub const fn size_indicated(self) -> bool {
        self.0 & 0x01 != 0
    }
    /// Number of bytes of an expedited message: 4 less the unused ones, or 4 if no size is given.
    pub const fn expedited_len(self) -> usize {
        if self.size_indicated() { 4 - (self.0 >> 2 & 3) as usize } else { 4 }
    }
}

/// An initiate message, or an abort.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Initiate {
    /// The command that is requested or answered.
    pub command: Command,
    /// The entry.
    pub object: ObjectAddress,
    /// Expedited data, the total size, or the abort code.
    pub data: [u8; 4],
}

impl Initiate {
    /// Reads the eight bytes.
    pub const fn parse(b: &[u8; INITIATE_LEN]) -> Self {
        Self {
            command: Command(b[0]),
            object: ObjectAddress::new(u16::from_le_bytes([b[1], b[2]]), b[3]),
            data: [b[4], b[5], b[6], b[7]],
        }
    }
    /// Writes the eight bytes.
    pub const fn emit(&self) -> [u8; INITIATE_LEN] {
        let (i, d) = (self.object.index.to_le_bytes(), self.data);
        [self.command.0, i[0], i[1], self.object.sub, d[0], d[1], d[2], d[3]]
    }
    /// An abort of the transfer of `object`.
    pub const fn abort(object: ObjectAddress, code: AbortCode) -> Self {
        Self { command: Command::ABORT, object, data: code.0.to_le_bytes() }
    }
    /// The size or abort code in the data.
    pub const fn value(&self) -> u32 {
        u32::from_le_bytes(self.data)
    }
}

/// The command byte of a segment, request or response.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SegmentCommand(pub u8);

impl SegmentCommand {
    /// A segment that carries `len` data bytes: download request or upload response.
    pub const fn data(toggle: bool, len: usize, last: bool) -> Self {
        let unused = if len < MIN_SEGMENT_DATA { (MIN_SEGMENT_DATA - len) as u8 } else { 0 };
        Self((toggle as u8) << 4 | unused << 1 | last as u8)
    }
    /// Request for the next upload segment.
    pub const fn upload_request(toggle: bool) -> Self {
        Self(0x60 | (toggle as u8) << 4)
    }
    /// Response to a download segment.
    pub const fn download_response(toggle: bool) -> Self {
        Self(0x20 | (toggle as u8) << 4)
    }
    /// Bits 7:5.
    pub const fn specifier(self) -> u8 {
        self.0 >> 5
    }
    /// Bit 4: toggles with each segment, 0 in the first.
    pub const fn toggle(self) -> bool {
        self.0 & 0x10 != 0
    }
    /// Bit 0: no segment follows.
    pub const fn last(self) -> bool {
        self.0 & 0x01 != 0
    }
    /// Number of data bytes among `available` bytes behind the command: all of them, except the
    /// unused ones of the shortest message.
    pub const fn data_len(self, available: usize) -> usize {
        if available <= MIN_SEGMENT_DATA {
            available.saturating_sub((self.0 >> 1 & 7) as usize)
        } else {
            available
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Facts vector 18: upload of 0x100A:00, two characters come back expedited.
    #[test]
    fn captured_upload() {
        let request = Initiate::parse(&[0x40, 0x0A, 0x10, 0, 0, 0, 0, 0]);
        assert_eq!(request.command, Command::upload_request(false));
        assert_eq!(request.object, ObjectAddress::new(0x100A, 0));
        let reply = Initiate::parse(&[0x4B, 0x0A, 0x10, 0x00, 0x30, 0x38, 0, 0]);
        assert!(reply.command.expedited());
        assert_eq!(&reply.data[..reply.command.expedited_len()], b"08");
        assert_eq!(Command::upload_expedited(2, false), reply.command);
        assert_eq!(reply.emit()[..6], [0x4B, 0x0A, 0x10, 0x00, 0x30, 0x38]);
    }

    #[test]
    fn segments_count_their_unused_bytes() {
        assert_eq!(SegmentCommand::data(true, 3, true), SegmentCommand(0x19));
        assert_eq!(SegmentCommand(0x19).data_len(7), 3);
        assert_eq!(SegmentCommand::data(false, 100, false).data_len(100), 100);
    }
}
