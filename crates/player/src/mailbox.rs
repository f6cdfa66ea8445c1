//! Writes of the list through the mailbox: SDO downloads and parameters of drives, with one request
//! and one answer each.

use isocat_descriptions::start_up::{Area, Mailbox, ObjectStep, ParameterStep};
use isocat_maindevice::SdoError;
use isocat_maindevice::error::MailboxError;
use isocat_wire::coe::sdo::{self, INITIATE_LEN, Initiate, specifier};
use isocat_wire::coe::{self, Service};
use isocat_wire::mailbox::{ErrorDetail, HEADER_LEN, Header, Protocol, next_counter};
use isocat_wire::register;
use isocat_wire::soe::{self, Elements, ErrorCode, Idn, Opcode};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AbortCode, ObjectAddress};

use crate::failure::Kind;
use crate::line::Line;
use crate::step::LONGEST;

/// The mailbox of a device by the list, and the counter of its messages.
pub(crate) struct Way<'a> {
    pub station: u16,
    pub areas: Option<Mailbox>,
    pub counter: &'a mut u8,
}

/// Writes the value of a step: expedited up to 4 bytes, else in one normal message.
pub(crate) fn download(line: &mut Line, to: Way<'_>, step: &ObjectStep) -> Result<(), Kind> {
    let Some(areas) = to.areas else { return Err(Kind::NoMailbox) };
    let request = download_request(areas.out, step)?;
    exchange(line, to, areas, Protocol::COE, &[request], step.patience_ms, download_result)
}

/// Writes a parameter; in fragments if it is longer than the mailbox.
pub(crate) fn write(line: &mut Line, to: Way<'_>, step: &ParameterStep) -> Result<(), Kind> {
    let Some(areas) = to.areas else { return Err(Kind::NoMailbox) };
    let room = usize::from(areas.out.length).saturating_sub(HEADER_LEN + soe::HEADER_LEN).max(1);
    let header = soe::Header::new(Opcode::WRITE_REQUEST, step.drive, Elements::VALUE, step.idn);
    let count = step.data.len().div_ceil(room).max(1);
    let fragment = |number: usize| {
        let left = count - 1 - number;
        let part = &step.data[number * room..step.data.len().min((number + 1) * room)];
        let header = match left {
            0 => header,
            _ => soe::Header { incomplete: true, idn: Idn(left as u16), ..header },
        };
        [&header.emit()[..], part].concat()
    };
    let fragments: Vec<_> = (0..count).map(fragment).collect();
    let result = |body: &[u8]| write_result(body, header);
    exchange(line, to, areas, Protocol::SOE, &fragments, step.patience_ms, result)
}

/// Writes the messages of a request, and waits for a message that `result` accepts as the answer.
fn exchange(
    line: &mut Line,
    to: Way<'_>,
    areas: Mailbox,
    protocol: Protocol,
    messages: &[Vec<u8>],
    patience_ms: u32,
    result: impl Fn(&[u8]) -> Option<Result<(), Kind>>,
) -> Result<(), Kind> {
    let patience = match patience_ms {
        0 => PATIENCE,
        given => Nanos::millis(given.into()).min(LONGEST),
    };
    let end = line.now() + patience;
    for body in messages {
        *to.counter = next_counter(*to.counter);
        let message = message(areas.out, protocol, body, *to.counter);
        while !line.write(to.station, areas.out.start, &message)? {
            wait(line, end, patience)?;
        }
    }
    loop {
        let answer = receive(line, to.station, areas.back, end, patience)?;
        let Some((head, body)) = answer.split_first_chunk() else { continue };
        // Other messages, for example emergencies, are ignored.
        let found = match Header::parse(head).protocol {
            Protocol::ERROR => {
                body.first_chunk().map(|detail| Err(Kind::Refused(ErrorDetail::parse(detail))))
            }
            other if other == protocol => result(body),
            _ => None,
        };
        if let Some(found) = found {
            return found;
        }
    }
}

/// Reads an entry of up to 4 bytes.
pub(crate) fn upload(
    line: &mut Line,
    station: u16,
    mailbox: Mailbox,
    counter: &mut u8,
    object: ObjectAddress,
) -> Result<Result<Vec<u8>, SdoError>, Kind> {
    let mut request = coe::Header::new(Service::SDO_REQUEST).emit().to_vec();
    let command = sdo::Command::upload_request(false);
    request.extend(Initiate { command, object, data: [0; 4] }.emit());
    *counter = next_counter(*counter);
    let message = message(mailbox.out, Protocol::COE, &request, *counter);
    let end = line.now() + UPLOAD_PATIENCE;
    let silent = Ok(Err(SdoError::Mailbox(MailboxError::NoAnswer { after: UPLOAD_PATIENCE })));
    while !line.write(station, mailbox.out.start, &message)? {
        if line.now() >= end {
            return silent;
        }
        line.sleep(POLL)?;
    }
    loop {
        let answer = match receive(line, station, mailbox.back, end, UPLOAD_PATIENCE) {
            Ok(answer) => answer,
            Err(Kind::Mailbox { .. }) => return silent,
            Err(kind) => return Err(kind),
        };
        if let Some(read) = read(&answer, object) {
            return Ok(read);
        }
    }
}

/// The answer for the entry; `None`: the message is about something else, for example an emergency.
fn read(answer: &[u8], object: ObjectAddress) -> Option<Result<Vec<u8>, SdoError>> {
    let header = Header::parse(answer.first_chunk()?);
    let body = answer.get(HEADER_LEN..)?;
    if header.protocol != Protocol::COE {
        return None;
    }
    let head = Initiate::parse(body.get(coe::HEADER_LEN..)?.first_chunk()?);
    if head.object != object {
        return None;
    }
    match head.command.specifier() {
        specifier::ABORT => Some(Err(SdoError::Abort(AbortCode(head.value())))),
        specifier::RESPONSE_UPLOAD if head.command.expedited() => {
            Some(Ok(head.data[..head.command.expedited_len()].to_vec()))
        }
        specifier::RESPONSE_UPLOAD => Some(Err(SdoError::TooLarge { size: head.value(), most: 4 })),
        _ => None,
    }
}

/// The SDO request after the mailbox header.
fn download_request(area: Area, step: &ObjectStep) -> Result<Vec<u8>, Kind> {
    let ObjectStep { object, complete, data, .. } = step;
    let mut request = coe::Header::new(Service::SDO_REQUEST).emit().to_vec();
    if (1..=4).contains(&data.len()) {
        let mut value = [0; 4];
        value[..data.len()].copy_from_slice(data);
        let command = sdo::Command::download_expedited(data.len(), *complete);
        request.extend(Initiate { command, object: *object, data: value }.emit());
        return Ok(request);
    }
    let most = usize::from(area.length).saturating_sub(HEADER_LEN + coe::HEADER_LEN + INITIATE_LEN);
    if data.len() > most {
        return Err(Kind::TooLong { length: data.len(), most });
    }
    let command = sdo::Command::download_normal(*complete);
    let size = (data.len() as u32).to_le_bytes();
    request.extend(Initiate { command, object: *object, data: size }.emit());
    request.extend(data);
    Ok(request)
}

/// A message that fills the whole area, because writing the last byte passes it to the device.
fn message(area: Area, protocol: Protocol, body: &[u8], counter: u8) -> Vec<u8> {
    let header = Header::new(body.len() as u16, 0, protocol, counter);
    let mut message = header.emit().to_vec();
    message.extend(body);
    message.resize(usize::from(area.length).max(message.len()), 0);
    message
}

/// Waits until the device has put a message into its mailbox, and reads it.
fn receive(
    line: &mut Line,
    station: u16,
    area: Area,
    end: Time<Host>,
    patience: Nanos,
) -> Result<Vec<u8>, Kind> {
    loop {
        let status = line.read(station, register::sm_status(1).address, 1)?;
        let full = status.is_some_and(|bytes| bytes[0] & SyncManager::STATUS_FULL != 0);
        if full && let Some(bytes) = line.read(station, area.start, usize::from(area.length))? {
            return Ok(bytes);
        }
        wait(line, end, patience)?;
    }
}

fn wait(line: &mut Line, end: Time<Host>, patience: Nanos) -> Result<(), Kind> {
    if line.now() >= end {
        return Err(Kind::Mailbox { after: patience });
    }
    line.sleep(POLL)
}

/// The result of the download by a CoE message; `None`: it is about something else, for example an
/// emergency.
fn download_result(body: &[u8]) -> Option<Result<(), Kind>> {
    let service = coe::Header::parse(*body.first_chunk()?).service;
    let head = Initiate::parse(body.get(coe::HEADER_LEN..)?.first_chunk()?);
    match head.command.specifier() {
        specifier::ABORT => Some(Err(Kind::Abort(AbortCode(head.value())))),
        specifier::RESPONSE_DOWNLOAD if service == Service::SDO_RESPONSE => Some(Ok(())),
        _ => None,
    }
}

/// The result of the write by an SoE message; `None`: it is about something else.
fn write_result(body: &[u8], request: soe::Header) -> Option<Result<(), Kind>> {
    let (head, rest) = body.split_first_chunk()?;
    let head = soe::Header::parse(head);
    let about = (Opcode::WRITE_RESPONSE, request.drive, request.idn);
    if (head.opcode, head.drive, head.idn) != about {
        return None;
    }
    match head.error {
        true => Some(Err(Kind::Drive(ErrorCode(u16::from_le_bytes(*rest.first_chunk()?))))),
        false => Some(Ok(())),
    }
}

/// How long to wait for an answer if the list does not say: like configuration tools with 0.
const PATIENCE: Nanos = Nanos::millis(10_000);
/// How long to wait for the answer to the player's own reads.
const UPLOAD_PATIENCE: Nanos = Nanos::millis(2_000);
/// Time between two looks at the mailbox.
const POLL: Nanos = Nanos::micros(500);
