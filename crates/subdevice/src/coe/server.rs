//! SDO transfers: expedited, normal and segmented, of entries and of whole objects.

use isocat_wire::coe::sdo::{
    Command, INITIATE_LEN, Initiate, MIN_SEGMENT_DATA, SegmentCommand, specifier,
};
use isocat_wire::coe::{HEADER_LEN, Header, Service};
use isocat_wire::mailbox::ErrorDetail;
use isocat_wire::{AbortCode, ObjectAddress};

use super::information::{self, List};
use crate::application::Application;
use crate::misbehaviour::{self, BadAnswer};
use crate::objects::{MAX_TRANSFER, Objects};

/// The result of a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Outcome {
    /// An answer with this number of bytes after the mailbox header.
    Reply(usize),
    /// No answer.
    Silent,
    /// A mailbox error message.
    Error(ErrorDetail),
}

/// The server and its present transfer, whose data are in a buffer of the caller. A new request
/// ends the previous transfer.
pub(crate) struct Server {
    transfer: Transfer,
    list: Option<List>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Transfer {
    Idle,
    /// `buffer[done..total]` must still be sent.
    Upload {
        object: ObjectAddress,
        done: usize,
        total: usize,
        toggle: bool,
    },
    /// `buffer[..done]` of `total` bytes was received.
    Download {
        object: ObjectAddress,
        complete: bool,
        done: usize,
        total: usize,
        toggle: bool,
    },
}

impl Server {
    /// No transfer.
    pub const fn new() -> Self {
        Self { transfer: Transfer::Idle, list: None }
    }

    /// Drops the present transfer.
    pub fn reset(&mut self) {
        self.transfer = Transfer::Idle;
        self.list = None;
    }

    /// Whether the last answer has a continuation that needs no request.
    pub fn has_more(&self) -> bool {
        self.list.is_some()
    }

    /// Continues the last answer.
    pub fn more<A: Application>(
        &mut self,
        objects: &mut Objects<'_, A>,
        reply: &mut [u8],
    ) -> Outcome {
        let Some(list) = self.list else { return Outcome::Silent };
        let (len, rest) = list.fragment(objects.dictionary.description(), &mut reply[HEADER_LEN..]);
        self.list = rest;
        finish(Service::SDO_INFORMATION, len, reply)
    }

    /// Answers a request; `request` and `reply` begin with the CoE header.
    pub fn handle<A: Application>(
        &mut self,
        request: &[u8],
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Outcome {
        let Some((header, body)) = request.split_first_chunk::<HEADER_LEN>() else {
            return Outcome::Error(ErrorDetail::SIZE_TOO_SHORT);
        };
        // A new request drops the remaining fragments of the previous answer.
        self.list = None;
        match Header::parse(*header).service {
            Service::SDO_REQUEST => {
                let Some(message) = body.first_chunk::<INITIATE_LEN>() else {
                    return Outcome::Error(ErrorDetail::SIZE_TOO_SHORT);
                };
                let initiate = Initiate::parse(message);
                if initiate.command.specifier() == specifier::ABORT {
                    self.transfer = Transfer::Idle;
                    return Outcome::Silent;
                }
                let object = initiate.object;
                if let Some(answer) = misbehaviour::bad_transfer(objects.faults(), object.index) {
                    let abort = Initiate::abort(object, AbortCode::GENERAL).emit();
                    return spoiled(answer, Service::SDO_RESPONSE, &abort, reply);
                }
                match self.sdo(initiate, body, objects, buffer, &mut reply[HEADER_LEN..]) {
                    Ok(len) => finish(Service::SDO_RESPONSE, len, reply),
                    Err((object, code)) => {
                        self.transfer = Transfer::Idle;
                        let code = misbehaviour::abort(objects.faults(), object, code);
                        let abort = Initiate::abort(object, code).emit();
                        reply[HEADER_LEN..][..INITIATE_LEN].copy_from_slice(&abort);
                        // An abort travels as a request in both directions.
                        finish(Service::SDO_REQUEST, INITIATE_LEN, reply)
                    }
                }
            }
            Service::SDO_INFORMATION => {
                let description = objects.dictionary.description();
                if let Some(answer) = misbehaviour::bad_information(objects.faults()) {
                    let mut abort = [0; 8];
                    let len = information::error(AbortCode::GENERAL, &mut abort);
                    return spoiled(answer, Service::SDO_INFORMATION, &abort[..len], reply);
                }
                match information::answer(description, body, &mut reply[HEADER_LEN..]) {
                    Ok((len, rest)) => {
                        self.list = rest;
                        finish(Service::SDO_INFORMATION, len, reply)
                    }
                    Err(detail) => Outcome::Error(detail),
                }
            }
            _ => Outcome::Error(ErrorDetail::SERVICE_NOT_SUPPORTED),
        }
    }

    fn sdo<A: Application>(
        &mut self,
        initiate: Initiate,
        body: &[u8],
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Result<usize, (ObjectAddress, AbortCode)> {
        let object = initiate.object;
        match initiate.command.specifier() {
            specifier::REQUEST_DOWNLOAD => self.download(initiate, body, objects, buffer, reply),
            specifier::REQUEST_UPLOAD => self.upload(initiate, objects, buffer, reply),
            specifier::REQUEST_DOWNLOAD_SEGMENT => {
                return self.download_segment(body, objects, buffer, reply);
            }
            specifier::REQUEST_UPLOAD_SEGMENT => return self.upload_segment(body, buffer, reply),
            _ => Err(AbortCode::COMMAND_SPECIFIER),
        }
        .map_err(|code| (object, code))
    }

    fn upload<A: Application>(
        &mut self,
        Initiate { command, object, .. }: Initiate,
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Result<usize, AbortCode> {
        self.transfer = Transfer::Idle;
        let complete = command.complete();
        let total = if complete {
            objects.read_complete(object.index, object.sub, buffer)?
        } else {
            objects.read(object, buffer)?
        };
        let value = &buffer[..total];
        let mut data = [0; 4];
        let (command, inline) = if (1..=data.len()).contains(&total) {
            data[..total].copy_from_slice(value);
            (Command::upload_expedited(total, complete), 0)
        } else {
            data = (total as u32).to_le_bytes();
            (Command::upload_normal(complete), total.min(reply.len() - INITIATE_LEN))
        };
        let (head, rest) = reply.split_at_mut(INITIATE_LEN);
        head.copy_from_slice(&Initiate { command, object, data }.emit());
        rest[..inline].copy_from_slice(&value[..inline]);
        if !command.expedited() && inline < total {
            self.transfer = Transfer::Upload { object, done: inline, total, toggle: false };
        }
        Ok(INITIATE_LEN + inline)
    }

    fn upload_segment(
        &mut self,
        body: &[u8],
        buffer: &[u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Result<usize, (ObjectAddress, AbortCode)> {
        let Transfer::Upload { object, done, total, toggle } = self.transfer else {
            return Err((NO_OBJECT, AbortCode::COMMAND_SPECIFIER));
        };
        if SegmentCommand(body[0]).toggle() != toggle {
            return Err((object, AbortCode::TOGGLE));
        }
        let len = (total - done).min(reply.len() - 1);
        let last = done + len == total;
        reply[0] = SegmentCommand::data(toggle, len, last).0;
        reply[1..=len].copy_from_slice(&buffer[done..done + len]);
        let padded = len.max(MIN_SEGMENT_DATA);
        reply[1 + len..=padded].fill(0);
        self.transfer = if last {
            Transfer::Idle
        } else {
            Transfer::Upload { object, done: done + len, total, toggle: !toggle }
        };
        Ok(1 + padded)
    }

    fn download<A: Application>(
        &mut self,
        Initiate { command, object, data }: Initiate,
        body: &[u8],
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Result<usize, AbortCode> {
        self.transfer = Transfer::Idle;
        let complete = command.complete();
        if command.expedited() {
            let mut len = command.expedited_len();
            if !command.size_indicated() && !complete {
                len = len.min(objects.entry_len(object)?);
            }
            write(objects, object, complete, &data[..len])?;
        } else {
            if !command.size_indicated() {
                return Err(AbortCode::COMMAND_SPECIFIER);
            }
            let total = u32::from_le_bytes(data) as usize;
            objects.check_download(object, complete, total)?;
            let inline = &body[INITIATE_LEN..];
            if inline.len() > total {
                return Err(AbortCode::LENGTH_MISMATCH);
            }
            if inline.len() == total {
                write(objects, object, complete, inline)?;
            } else {
                buffer[..inline.len()].copy_from_slice(inline);
                let done = inline.len();
                self.transfer = Transfer::Download { object, complete, done, total, toggle: false };
            }
        }
        let answer =
            Initiate { command: Command::download_response(complete), object, data: [0; 4] };
        reply[..INITIATE_LEN].copy_from_slice(&answer.emit());
        Ok(INITIATE_LEN)
    }

    fn download_segment<A: Application>(
        &mut self,
        body: &[u8],
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Result<usize, (ObjectAddress, AbortCode)> {
        let Transfer::Download { object, complete, done, total, toggle } = self.transfer else {
            return Err((NO_OBJECT, AbortCode::COMMAND_SPECIFIER));
        };
        let command = SegmentCommand(body[0]);
        if command.toggle() != toggle {
            return Err((object, AbortCode::TOGGLE));
        }
        let data = &body[1..][..command.data_len(body.len() - 1)];
        let now_done = done + data.len();
        if now_done > total {
            return Err((object, AbortCode::TOO_LONG));
        }
        buffer[done..now_done].copy_from_slice(data);
        if command.last() {
            if now_done < total {
                return Err((object, AbortCode::TOO_SHORT));
            }
            write(objects, object, complete, &buffer[..total]).map_err(|code| (object, code))?;
            self.transfer = Transfer::Idle;
        } else {
            let (done, toggle) = (now_done, !toggle);
            self.transfer = Transfer::Download { object, complete, done, total, toggle };
        }
        reply[..INITIATE_LEN].fill(0);
        reply[0] = SegmentCommand::download_response(toggle).0;
        Ok(INITIATE_LEN)
    }
}

fn write<A: Application>(
    objects: &mut Objects<'_, A>,
    object: ObjectAddress,
    complete: bool,
    data: &[u8],
) -> Result<(), AbortCode> {
    if complete {
        objects.write_complete(object.index, object.sub, data)
    } else {
        objects.write(object, data)
    }
}

/// Writes the CoE header before the `len` bytes of an answer.
fn finish(service: Service, len: usize, reply: &mut [u8]) -> Outcome {
    reply[..HEADER_LEN].copy_from_slice(&Header::new(service).emit());
    Outcome::Reply(HEADER_LEN + len)
}

/// A wrong answer for a misbehaving device; `abort` are the bytes of an abort.
fn spoiled(answer: BadAnswer, service: Service, abort: &[u8], reply: &mut [u8]) -> Outcome {
    match answer {
        BadAnswer::Silent => Outcome::Silent,
        BadAnswer::Error => Outcome::Error(ErrorDetail::SERVICE_NOT_SUPPORTED),
        BadAnswer::Abort => {
            reply[HEADER_LEN..][..abort.len()].copy_from_slice(abort);
            let aborts = service == Service::SDO_RESPONSE;
            finish(if aborts { Service::SDO_REQUEST } else { service }, abort.len(), reply)
        }
        BadAnswer::Short => {
            reply[HEADER_LEN..][..SHORT_LEN].copy_from_slice(&abort[..SHORT_LEN]);
            finish(service, SHORT_LEN, reply)
        }
        BadAnswer::Garbage => {
            // It names the object, so that it is taken for the answer; its command is not in use.
            reply[HEADER_LEN..][..abort.len()].copy_from_slice(abort);
            reply[HEADER_LEN] = GARBAGE;
            finish(service, abort.len(), reply)
        }
    }
}

/// Bytes after the CoE header of an answer that is too short.
const SHORT_LEN: usize = 4;
/// A command specifier, and an opcode of SDO information, that are not in use.
const GARBAGE: u8 = 0x7F;

/// The object in an abort without a transfer.
const NO_OBJECT: ObjectAddress = ObjectAddress::new(0, 0);
