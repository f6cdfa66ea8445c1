//! CoE services of a mailbox: upload, download, SDO information.

use alloc::string::String;
use alloc::vec::Vec;

use isocat_wire::coe::info::{self, EntryDescription, ObjectDescription, Opcode};
use isocat_wire::coe::sdo::{
    self, Command, INITIATE_LEN, Initiate, MIN_SEGMENT_DATA, SegmentCommand, specifier,
};
use isocat_wire::coe::{HEADER_LEN, Header, Service};
use isocat_wire::mailbox;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

use crate::error::{MailboxError, SdoError, SdoResult};
use crate::mailbox::Mailbox;

/// Reads an entry, or with `complete` the whole object from sub-index 0 or 1 on. Expedited, normal
/// and segmented answers are taken as the device gives them.
pub(crate) async fn upload(
    mailbox: &mut Mailbox,
    object: ObjectAddress,
    complete: bool,
) -> SdoResult {
    let request = Initiate { command: Command::upload_request(complete), object, data: [0; 4] };
    let answer = initiate(mailbox, &request.emit(), object).await?;
    let (head, rest) = split(&answer)?;
    if head.command.specifier() != specifier::RESPONSE_UPLOAD {
        return Err(unexpected("an upload response", head.command.0));
    }
    if head.command.expedited() {
        return Ok(head.data[..head.command.expedited_len()].to_vec());
    }
    let size = head.value() as usize;
    if size > MOST_BYTES {
        return Err(SdoError::TooLarge { size: head.value(), most: MOST_BYTES as u32 });
    }
    // Each segment has the patience of a service; all of them together must not take as long as
    // there are bytes times that.
    let end = mailbox.deadline() + Nanos(SLOWEST_BYTE.0 * size as i64);
    let mut data = Vec::new();
    data.extend_from_slice(&rest[..rest.len().min(size)]);
    let mut toggle = false;
    while data.len() < size {
        // Padded: no SDO message is shorter than eight bytes.
        let mut request = [0; INITIATE_LEN];
        request[0] = SegmentCommand::upload_request(toggle).0;
        let answer = segment(mailbox, &request).await?;
        let (&command, rest) = answer.split_first().ok_or(SHORT)?;
        let command = SegmentCommand(command);
        if command.specifier() != specifier::RESPONSE_UPLOAD_SEGMENT {
            return Err(unexpected("an upload segment response", command.0));
        }
        if command.toggle() != toggle {
            return Err(unexpected("an upload segment with its toggle bit changed", command.0));
        }
        let part = &rest[..command.data_len(rest.len())];
        data.extend_from_slice(part);
        toggle = !toggle;
        if command.last() {
            break;
        }
        if part.is_empty() {
            return Err(unexpected("an upload segment with data, or the last one", command.0));
        }
        mailbox.in_time(end)?;
    }
    if data.len() != size {
        return Err(SdoError::Length { expected: size, found: data.len() });
    }
    Ok(data)
}

/// Writes an entry, or with `complete` the whole object: expedited up to 4 bytes, normal as far as
/// the mailbox reaches, the rest in segments.
pub(crate) async fn download(
    mailbox: &mut Mailbox,
    object: ObjectAddress,
    data: &[u8],
    complete: bool,
) -> Result<(), SdoError> {
    let room = mailbox.request_len().saturating_sub(HEADER_LEN + INITIATE_LEN);
    let mut sent = data.len();
    let mut request = Vec::new();
    if (1..=4).contains(&data.len()) {
        let mut bytes = [0; 4];
        bytes[..data.len()].copy_from_slice(data);
        let command = Command::download_expedited(data.len(), complete);
        request.extend_from_slice(&Initiate { command, object, data: bytes }.emit());
    } else {
        sent = data.len().min(room);
        let command = Command::download_normal(complete);
        let size = (data.len() as u32).to_le_bytes();
        request.extend_from_slice(&Initiate { command, object, data: size }.emit());
        request.extend_from_slice(&data[..sent]);
    }
    let answer = initiate(mailbox, &request, object).await?;
    let (head, _) = split(&answer)?;
    if head.command.specifier() != specifier::RESPONSE_DOWNLOAD {
        return Err(unexpected("a download response", head.command.0));
    }
    let most = mailbox.request_len().saturating_sub(HEADER_LEN + 1).max(MIN_SEGMENT_DATA);
    let mut toggle = false;
    while sent < data.len() {
        let end = data.len().min(sent + most);
        let part = &data[sent..end];
        let command = SegmentCommand::data(toggle, part.len(), end == data.len());
        let mut request = Vec::with_capacity(1 + part.len());
        request.push(command.0);
        request.extend_from_slice(part);
        // The shortest segment is padded; its command counts the unused bytes.
        request.resize(request.len().max(1 + MIN_SEGMENT_DATA), 0);
        let answer = segment(mailbox, &request).await?;
        let command = SegmentCommand(*answer.first().ok_or(SHORT)?);
        if command.specifier() != specifier::RESPONSE_DOWNLOAD_SEGMENT || command.toggle() != toggle
        {
            return Err(unexpected("a download segment response", command.0));
        }
        sent = end;
        toggle = !toggle;
    }
    Ok(())
}

/// Reads the description and name of an object.
pub(crate) async fn object_description(
    mailbox: &mut Mailbox,
    index: u16,
) -> Result<(ObjectDescription, String), SdoError> {
    let request = index.to_le_bytes();
    let data =
        information(mailbox, Opcode::OBJECT_REQUEST, &request, Opcode::OBJECT_RESPONSE).await?;
    let (head, name) = data.split_first_chunk().ok_or(SHORT)?;
    let description = ObjectDescription::parse(head);
    if description.index != index {
        return Err(unexpected("the description of the object asked for", head[0]));
    }
    Ok((description, text(name)))
}

/// Reads the description and name of an entry.
pub(crate) async fn entry_description(
    mailbox: &mut Mailbox,
    object: ObjectAddress,
) -> Result<(EntryDescription, String), SdoError> {
    let [i0, i1] = object.index.to_le_bytes();
    // Value information 0: no unit, default, minimum or maximum, so the name follows at once.
    let request = [i0, i1, object.sub, 0];
    let data =
        information(mailbox, Opcode::ENTRY_REQUEST, &request, Opcode::ENTRY_RESPONSE).await?;
    let (head, rest) = data.split_first_chunk().ok_or(SHORT)?;
    let description = EntryDescription::parse(head);
    if (description.index, description.sub) != (object.index, object.sub) {
        return Err(unexpected("the description of the entry asked for", head[2]));
    }
    // A device may send the optional parts all the same: unit 2 or 4 bytes can't be told, so skip
    // only what it announces with the widths of the value.
    let value = usize::from(description.bits).div_ceil(8);
    let skip = [(1 << 3, 2), (1 << 4, value), (1 << 5, value), (1 << 6, value)]
        .iter()
        .filter(|(bit, _)| description.value_info & bit != 0)
        .map(|(_, len)| *len)
        .sum::<usize>();
    Ok((description, text(rest.get(skip..).unwrap_or(&[]))))
}

/// Runs one SDO information service; returns the data of all fragments.
async fn information(
    mailbox: &mut Mailbox,
    opcode: Opcode,
    data: &[u8],
    expected: Opcode,
) -> SdoResult {
    let mut request = Vec::new();
    request.extend_from_slice(&Header::new(Service::SDO_INFORMATION).emit());
    let header = info::Header { opcode, incomplete: false, fragments_left: 0 };
    request.extend_from_slice(&header.emit());
    request.extend_from_slice(data);
    let is_answer = |answer: &[u8]| service(answer) == Some(Service::SDO_INFORMATION);
    let mut answer = mailbox.coe(&request, is_answer).await?;
    // Of all fragments together: how many there are is the device's word alone.
    let end = mailbox.deadline();
    let mut all = Vec::new();
    loop {
        let body = answer.get(HEADER_LEN..).ok_or(SHORT)?;
        let (head, rest) = body.split_first_chunk().ok_or(SHORT)?;
        let header = info::Header::parse(head);
        if header.opcode == Opcode::ERROR {
            let code = rest.first_chunk().ok_or(SHORT)?;
            return Err(SdoError::Abort(AbortCode(u32::from_le_bytes(*code))));
        }
        if header.opcode != expected {
            return Err(unexpected("an SDO information response", header.opcode.0));
        }
        all.extend_from_slice(rest);
        if !header.incomplete {
            return Ok(all);
        }
        if rest.is_empty() || all.len() > MOST_DESCRIPTION {
            return Err(unexpected("an SDO information response that ends", header.opcode.0));
        }
        mailbox.in_time(end)?;
        answer = mailbox.coe_more(end).await?;
    }
}

/// Sends an initiate message. Returns the answer after the CoE header; an abort becomes an error.
async fn initiate(mailbox: &mut Mailbox, message: &[u8], object: ObjectAddress) -> SdoResult {
    // A late answer to another entry, given up earlier, is not the answer to this one.
    let is_answer = |answer: &[u8]| {
        is_sdo(answer)
            && answer
                .get(HEADER_LEN..)
                .and_then(|body| body.first_chunk())
                .is_some_and(|head| Initiate::parse(head).object == object)
    };
    exchange(mailbox, message, is_answer).await
}

/// Sends a segment. Returns the answer after the CoE header; an abort becomes an error.
async fn segment(mailbox: &mut Mailbox, message: &[u8]) -> SdoResult {
    exchange(mailbox, message, is_sdo).await
}

async fn exchange(
    mailbox: &mut Mailbox,
    message: &[u8],
    is_answer: impl Fn(&[u8]) -> bool,
) -> SdoResult {
    let mut request = Vec::with_capacity(HEADER_LEN + message.len());
    request.extend_from_slice(&Header::new(Service::SDO_REQUEST).emit());
    request.extend_from_slice(message);
    let answer = mailbox.coe(&request, is_answer).await?;
    let body = answer.get(HEADER_LEN..).ok_or(SHORT)?;
    let &command = body.first().ok_or(SHORT)?;
    if Command(command).specifier() == specifier::ABORT {
        let (head, _) = split(body)?;
        return Err(SdoError::Abort(AbortCode(head.value())));
    }
    Ok(body.to_vec())
}

/// Aborts travel as requests in both directions.
fn is_sdo(answer: &[u8]) -> bool {
    matches!(service(answer), Some(Service::SDO_RESPONSE | Service::SDO_REQUEST))
}

fn service(answer: &[u8]) -> Option<Service> {
    Some(Header::parse(*answer.first_chunk()?).service)
}

fn split(body: &[u8]) -> Result<(Initiate, &[u8]), SdoError> {
    let (head, rest) = body.split_first_chunk().ok_or(SHORT)?;
    Ok((sdo::Initiate::parse(head), rest))
}

fn unexpected(expected: &'static str, found: u8) -> SdoError {
    SdoError::Answer { expected, found }
}

/// A name as text. Names are ASCII or UTF-8 without an end mark; invalid bytes are replaced.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// Longest object that is uploaded. Synchronization objects have a few bytes and the longest common
/// objects some 100 KB, but a device may announce 4 GB.
const MOST_BYTES: usize = 1 << 20;
/// Time for each byte of an upload in segments.
const SLOWEST_BYTE: Nanos = Nanos(1_000_000);
/// Most bytes of a description and its name, of all fragments together.
const MOST_DESCRIPTION: usize = 0x1_0000;

const SHORT: SdoError = SdoError::Mailbox(MailboxError::Short { length: mailbox::HEADER_LEN });
