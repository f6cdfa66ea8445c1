//! The services that answer requests of the mailbox, by protocol.
//!
//! CoE and SoE have servers. A device may announce protocols without having files, ports or ADS
//! targets for them. It then answers with the error of the protocol, or with a mailbox error if the
//! protocol has none. A protocol that is not announced is answered with a mailbox error. Only
//! messages that are errors or answers themselves get no answer.

use isocat_wire::mailbox::{ErrorDetail, Protocol};
use isocat_wire::{aoe, eoe, foe};

use crate::application::Application;
use crate::coe::{self, Outcome};
use crate::objects::{MAX_TRANSFER, Objects};
use crate::soe;

/// The servers behind the mailbox.
pub(crate) struct Services {
    coe: coe::Server,
    soe: soe::Server,
}

impl Services {
    /// Services without a transfer.
    pub const fn new() -> Self {
        Self { coe: coe::Server::new(), soe: soe::Server::new() }
    }

    /// Drops the present transfer.
    pub fn reset(&mut self) {
        self.coe.reset();
        self.soe.reset();
    }

    /// The protocol whose last answer continues without a request.
    pub fn has_more(&self) -> Option<Protocol> {
        if self.coe.has_more() {
            Some(Protocol::COE)
        } else {
            self.soe.has_more().then_some(Protocol::SOE)
        }
    }

    /// Continues the last answer.
    pub fn more<A: Application>(
        &mut self,
        protocol: Protocol,
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Outcome {
        match protocol {
            Protocol::SOE => self.soe.more(buffer, reply),
            _ => self.coe.more(objects, reply),
        }
    }

    /// Answers a request; `request` and `reply` begin after the mailbox header.
    pub fn handle<A: Application>(
        &mut self,
        protocol: Protocol,
        request: &[u8],
        objects: &mut Objects<'_, A>,
        buffer: &mut [u8; MAX_TRANSFER],
        reply: &mut [u8],
    ) -> Outcome {
        let speaks = objects.dictionary.description().mailbox.map(|mailbox| mailbox.speaks);
        let announced = speaks.map_or(0, |speaks| speaks.protocols);
        if announced & protocol.announcement() == 0 {
            return Outcome::Error(ErrorDetail::UNSUPPORTED_PROTOCOL);
        }
        // Both servers keep long data in one buffer, so a request ends the transfer of the other
        // server.
        match protocol {
            Protocol::COE => {
                self.soe.reset();
                self.coe.handle(request, objects, buffer, reply)
            }
            Protocol::SOE => {
                self.coe.reset();
                self.soe.handle(request, objects, buffer, reply)
            }
            Protocol::FOE => no_files(request, reply),
            Protocol::EOE => no_port(request, reply),
            Protocol::AOE => no_target(request, reply),
            _ => Outcome::Error(ErrorDetail::SERVICE_NOT_SUPPORTED),
        }
    }
}

/// FoE of a device without files: no file is found, and none can be written.
fn no_files(request: &[u8], reply: &mut [u8]) -> Outcome {
    let Some((head, _)) = request.split_first_chunk() else {
        return Outcome::Error(ErrorDetail::SIZE_TOO_SHORT);
    };
    let code = match foe::Header::parse(head).opcode {
        foe::Opcode::READ => foe::ErrorCode::NOT_FOUND,
        foe::Opcode::WRITE => foe::ErrorCode::ACCESS_DENIED,
        // An error needs no answer, in particular no error.
        foe::Opcode::ERROR => return Outcome::Silent,
        _ => foe::ErrorCode::ILLEGAL,
    };
    let header = foe::Header { opcode: foe::Opcode::ERROR, number: code.0 };
    answer(&[&header.emit(), NO_FILES], reply)
}

/// EoE of a device without a port: settings are answered, frames are dropped.
fn no_port(request: &[u8], reply: &mut [u8]) -> Outcome {
    let Some((head, _)) = request.split_first_chunk() else {
        return Outcome::Error(ErrorDetail::SIZE_TOO_SHORT);
    };
    let header = eoe::Header::parse(head);
    let (kind, outcome) = match header.kind {
        eoe::Kind::SET_ADDRESS => (eoe::Kind::ADDRESS_SET, eoe::Outcome::NO_IP),
        eoe::Kind::READ_ADDRESS => (eoe::Kind::ADDRESS, eoe::Outcome::NO_IP),
        eoe::Kind::SET_FILTER => (eoe::Kind::FILTER_SET, eoe::Outcome::NO_FILTER),
        eoe::Kind::READ_FILTER => (eoe::Kind::FILTER, eoe::Outcome::NO_FILTER),
        eoe::Kind::ADDRESS_SET | eoe::Kind::ADDRESS | eoe::Kind::FILTER_SET | eoe::Kind::FILTER => {
            return Outcome::Silent;
        }
        _ => return Outcome::Error(ErrorDetail::SERVICE_NOT_SUPPORTED),
    };
    let header = eoe::Header { kind, port: header.port, flags: LAST_FRAGMENT, word: outcome.0 };
    answer(&[&header.emit()], reply)
}

/// AoE of a device without a target at any port.
fn no_target(request: &[u8], reply: &mut [u8]) -> Outcome {
    let Some((head, _)) = request.split_first_chunk() else {
        return Outcome::Error(ErrorDetail::SIZE_TOO_SHORT);
    };
    let header = aoe::Header::parse(head);
    if header.flags & aoe::Header::ANSWER != 0 {
        return Outcome::Silent;
    }
    answer(&[&header.failed(aoe::Header::NO_TARGET_PORT).emit()], reply)
}

/// Writes the parts of an answer one after the other; the last part is truncated if it does not fit
/// and is a text.
fn answer(parts: &[&[u8]], reply: &mut [u8]) -> Outcome {
    let mut len = 0;
    for (number, part) in parts.iter().enumerate() {
        let rest = &mut reply[len..];
        if number == 0 && rest.len() < part.len() {
            return Outcome::Error(ErrorDetail::NO_MEMORY);
        }
        let fits = part.len().min(rest.len());
        rest[..fits].copy_from_slice(&part[..fits]);
        len += fits;
    }
    Outcome::Reply(len)
}

/// The text of an FoE error.
const NO_FILES: &[u8] = b"no files";
/// EoE flags of an answer: it is its only fragment.
const LAST_FRAGMENT: u8 = 1;
