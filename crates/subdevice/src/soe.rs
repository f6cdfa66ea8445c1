//! The SoE server: parameters of drives are read and written, in fragments if the mailbox is too
//! short.

use isocat_wire::mailbox::ErrorDetail;
use isocat_wire::soe::{Elements, ErrorCode, HEADER_LEN, Header, Opcode};

use crate::application::Application;
use crate::coe::Outcome;
use crate::objects::{MAX_TRANSFER, Objects};

/// The server and its present transfer. A new request ends the previous transfer.
pub(crate) struct Server {
    transfer: Transfer,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Transfer {
    Idle,
    /// `buffer[done..total]` must still be sent.
    Upload {
        header: Header,
        done: usize,
        total: usize,
    },
    /// `buffer[..done]` was received of a request with further fragments.
    Download {
        drive: u8,
        elements: Elements,
        done: usize,
        /// Whether more was received than fits.
        too_long: bool,
    },
}

impl Server {
    /// No transfer.
    pub const fn new() -> Self {
        Self { transfer: Transfer::Idle }
    }

    /// Drops the present transfer.
    pub fn reset(&mut self) {
        self.transfer = Transfer::Idle;
    }

    /// Whether the last answer has a continuation that needs no request.
    pub const fn has_more(&self) -> bool {
        matches!(self.transfer, Transfer::Upload { .. })
    }

    /// The next fragment of an answer.
    pub fn more(&mut self, buffer: &[u8; MAX_TRANSFER], reply: &mut [u8]) -> Outcome {
        let Transfer::Upload { header, done, total } = self.transfer else {
            return Outcome::Silent;
        };
        let room = reply.len() - HEADER_LEN;
        let left = total - done;
        let part = left.min(room);
        let following = left.div_ceil(room).saturating_sub(1);
        let mut sent = header;
        self.transfer = if following > 0 {
            sent.incomplete = true;
            sent.idn.0 = following as u16;
            Transfer::Upload { header, done: done + part, total }
        } else {
            Transfer::Idle
        };
        reply[..HEADER_LEN].copy_from_slice(&sent.emit());
        reply[HEADER_LEN..][..part].copy_from_slice(&buffer[done..done + part]);
        Outcome::Reply(HEADER_LEN + part)
    }

    /// Answers a request; `request` and `reply` begin with the SoE header.
    pub fn handle<A: Application>(
        &mut self,
        request: &[u8],
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Outcome {
        let Some((head, data)) = request.split_first_chunk() else {
            self.reset();
            return Outcome::Error(ErrorDetail::SIZE_TOO_SHORT);
        };
        let header = Header::parse(head);
        let (opcode, done) = match header.opcode {
            Opcode::READ_REQUEST => {
                self.reset();
                let done = objects.read_elements(header.drive, header.idn, header.elements, buffer);
                (Opcode::READ_RESPONSE, done)
            }
            Opcode::WRITE_REQUEST => {
                let Some(all) = self.collect(header, data, buffer) else { return Outcome::Silent };
                let write = |len| {
                    let value = &buffer[..len];
                    objects.write_element(header.drive, header.idn, header.elements, value)
                };
                (Opcode::WRITE_RESPONSE, all.and_then(write).map(|()| 0))
            }
            _ => {
                self.reset();
                return Outcome::Error(ErrorDetail::SERVICE_NOT_SUPPORTED);
            }
        };
        let header = Header { opcode, incomplete: false, error: done.is_err(), ..header };
        match done {
            Ok(total) => {
                self.transfer = Transfer::Upload { header, done: 0, total };
                self.more(buffer, reply)
            }
            Err(code) => {
                reply[..HEADER_LEN].copy_from_slice(&header.emit());
                reply[HEADER_LEN..][..ErrorCode::LEN].copy_from_slice(&code.0.to_le_bytes());
                Outcome::Reply(HEADER_LEN + ErrorCode::LEN)
            }
        }
    }

    /// Appends a fragment of a request to the previous ones; returns the whole length after the
    /// last fragment. A fragment with further ones after it is not answered.
    fn collect(
        &mut self,
        header: Header,
        data: &[u8],
        buffer: &mut [u8; MAX_TRANSFER],
    ) -> Option<Result<usize, ErrorCode>> {
        let Header { drive, elements, .. } = header;
        let (before, mut too_long) = match self.transfer {
            // Fragments of another request do not belong to this one.
            Transfer::Download { drive: of, elements: what, done, too_long }
                if (of, what) == (drive, elements) =>
            {
                (done, too_long)
            }
            _ => (0, false),
        };
        let mut done = before;
        match buffer.get_mut(before..before + data.len()) {
            Some(place) => {
                place.copy_from_slice(data);
                done += data.len();
            }
            None => too_long = true,
        }
        if header.incomplete {
            self.transfer = Transfer::Download { drive, elements, done, too_long };
            return None;
        }
        self.transfer = Transfer::Idle;
        Some(if too_long { Err(ErrorCode::VALUE_TOO_LONG) } else { Ok(done) })
    }
}
