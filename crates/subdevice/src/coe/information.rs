//! SDO information: the list of objects, and the descriptions of objects and entries.

use isocat_wire::coe::info::{
    Access, EntryDescription, HEADER_LEN, Header, ObjectDescription, Opcode, list_type,
};
use isocat_wire::mailbox::ErrorDetail;
use isocat_wire::{AbortCode, ObjectAddress};

use crate::description::{Description, Object};
use crate::misbehaviour::{self, Misbehaviour};

/// A list of objects that is sent in fragments.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct List {
    kind: u16,
    /// Number of objects of the list that were sent.
    sent: usize,
    /// Number of objects of the list.
    total: usize,
}

/// Answers an information request; `request` and `reply` begin with the information header. Returns
/// the length of the answer, and the rest of a list that did not fit.
pub(crate) fn answer(
    description: &Description,
    request: &[u8],
    reply: &mut [u8],
) -> Result<(usize, Option<List>), ErrorDetail> {
    let (header, data) =
        request.split_first_chunk::<HEADER_LEN>().ok_or(ErrorDetail::SIZE_TOO_SHORT)?;
    let (len, rest) = match Header::parse(header).opcode {
        Opcode::LIST_REQUEST => {
            let kind = u16::from_le_bytes(*data.first_chunk().ok_or(ErrorDetail::SIZE_TOO_SHORT)?);
            match kind {
                list_type::LENGTHS => (lengths(description, reply), None),
                list_type::ALL..=list_type::SETTINGS => {
                    let total = members(description, kind).count();
                    List { kind, sent: 0, total }.fragment(description, reply)
                }
                _ => (error(AbortCode::UNSUPPORTED_ACCESS, reply), None),
            }
        }
        Opcode::OBJECT_REQUEST => {
            let index = data.first_chunk().ok_or(ErrorDetail::SIZE_TOO_SHORT)?;
            (object(description, u16::from_le_bytes(*index), reply), None)
        }
        Opcode::ENTRY_REQUEST => {
            let [low, high, sub, wanted] =
                *data.first_chunk().ok_or(ErrorDetail::SIZE_TOO_SHORT)?;
            let index = u16::from_le_bytes([low, high]);
            (entry(description, index, sub, wanted, reply), None)
        }
        _ => (error(AbortCode::COMMAND_SPECIFIER, reply), None),
    };
    Ok((len, rest))
}

impl List {
    /// Writes the next fragment into `reply`; returns its length and the remaining list.
    pub fn fragment(self, description: &Description, reply: &mut [u8]) -> (usize, Option<List>) {
        let room = (reply.len() - HEADER_LEN) / 2;
        // The list type comes before the first index, only in the first fragment.
        let slots = if self.sent == 0 { room - 1 } else { room };
        let (head, mut rest) = reply.split_at_mut(HEADER_LEN);
        let mut len = HEADER_LEN;
        let mut put = |value: u16| {
            let (slot, behind) = core::mem::take(&mut rest).split_at_mut(2);
            slot.copy_from_slice(&value.to_le_bytes());
            rest = behind;
            len += 2;
        };
        if self.sent == 0 {
            put(self.kind);
        }
        let mut sent = self.sent;
        for object in members(description, self.kind).skip(self.sent).take(slots) {
            put(object.index);
            sent += 1;
        }
        let left = self.total - sent;
        let fragments_left = left.div_ceil(room).min(usize::from(u16::MAX)) as u16;
        let header = Header { opcode: Opcode::LIST_RESPONSE, incomplete: left > 0, fragments_left };
        head.copy_from_slice(&header.emit());
        (len, (left > 0).then_some(List { sent, ..self }))
    }
}

/// The objects of a list.
fn members(description: &Description, kind: u16) -> impl Iterator<Item = &'static Object> + use<> {
    let right = match kind {
        list_type::RX_MAPPABLE => Access::RX_MAPPABLE,
        list_type::TX_MAPPABLE => Access::TX_MAPPABLE,
        list_type::BACKUP => Access::BACKUP,
        list_type::SETTINGS => Access::SETTINGS,
        _ => Access::default(),
    };
    let is_member =
        move |object: &&Object| object.entries.iter().any(|entry| entry.access.has(right));
    description.objects.iter().filter(is_member)
}

fn lengths(description: &Description, reply: &mut [u8]) -> usize {
    let header =
        Header { opcode: Opcode::LIST_RESPONSE, incomplete: false, fragments_left: 0 }.emit();
    let kinds = list_type::ALL..=list_type::SETTINGS;
    let counts = kinds.map(|kind| members(description, kind).count() as u16);
    let mut at = 0;
    let words = core::iter::once(list_type::LENGTHS).chain(counts);
    for bytes in [&header[..2], &header[2..]]
        .into_iter()
        .map(|half| [half[0], half[1]])
        .chain(words.map(u16::to_le_bytes))
    {
        reply[at..at + 2].copy_from_slice(&bytes);
        at += 2;
    }
    at
}

fn object(description: &Description, index: u16, reply: &mut [u8]) -> usize {
    let Some(object) = description.object(index) else {
        return error(AbortCode::NO_OBJECT, reply);
    };
    let head = ObjectDescription {
        index,
        data_type: object.data_type.0,
        max_sub: object.max_sub(),
        code: object.code,
    };
    write(Opcode::OBJECT_RESPONSE, &head.emit(), &[], object.name, reply)
}

fn entry(description: &Description, index: u16, sub: u8, wanted: u8, reply: &mut [u8]) -> usize {
    let Some(object) = description.object(index) else {
        return error(AbortCode::NO_OBJECT, reply);
    };
    let faults = description.behaviour.faults();
    let address = ObjectAddress::new(index, sub);
    let missing = faults.contains(&Misbehaviour::MissingEntry(address));
    let Some(entry) = object.entry(sub).filter(|_| !missing) else {
        return error(AbortCode::NO_SUBINDEX, reply);
    };
    let mut default = [0; MAX_DEFAULT];
    let with_default = wanted & DEFAULT_VALUE != 0 && !entry.is_gap() && entry.len() <= MAX_DEFAULT;
    let default_len = if with_default { entry.len() } else { 0 };
    let power_on = description.power_on(entry);
    let given = power_on.len().min(default_len);
    default[..given].copy_from_slice(&power_on[..given]);
    let head = EntryDescription {
        index,
        sub,
        value_info: wanted & BASIC_INFO | if with_default { DEFAULT_VALUE } else { 0 },
        data_type: misbehaviour::number(faults, |fault| match *fault {
            Misbehaviour::WrongType(at, code) if at == address => Some(code),
            _ => None,
        })
        .unwrap_or(entry.data_type.0),
        bits: entry.bits,
        access: if faults.contains(&Misbehaviour::ReadOnly(address)) {
            Access(entry.access.0 & !Access::WRITE.0)
        } else {
            entry.access
        },
    };
    write(Opcode::ENTRY_RESPONSE, &head.emit(), &default[..default_len], entry.name, reply)
}

pub(super) fn error(code: AbortCode, reply: &mut [u8]) -> usize {
    write(Opcode::ERROR, &code.0.to_le_bytes(), &[], "", reply)
}

/// Composes an answer; a name that does not fit is truncated.
fn write(opcode: Opcode, head: &[u8], value: &[u8], name: &str, reply: &mut [u8]) -> usize {
    let header = Header { opcode, incomplete: false, fragments_left: 0 }.emit();
    let mut at = 0;
    for part in [&header[..], head, value, name.as_bytes()] {
        let len = part.len().min(reply.len() - at);
        reply[at..at + len].copy_from_slice(&part[..len]);
        at += len;
    }
    at
}

/// Value info of an entry request: rights, category and mapping, which every answer has.
const BASIC_INFO: u8 = 0x07;
/// Value info of an entry request: the value after power-on.
const DEFAULT_VALUE: u8 = 0x10;
/// Longest value after power-on that is sent.
const MAX_DEFAULT: usize = 8;
