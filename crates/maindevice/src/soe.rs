//! SoE: writes the configured parameters to the drives of a SubDevice in PREOP.

use alloc::vec::Vec;

use isocat_wire::mailbox::{self, Protocol};
use isocat_wire::soe::{Elements, ErrorCode, HEADER_LEN, Header, Idn, Opcode};

use crate::config::DeviceConfig;
use crate::error::{Cause, MailboxError, SoeError};
use crate::mailbox::Mailbox;
use crate::segment::SubDevice;

/// Writes the configured parameters in PREOP, in order.
pub(crate) async fn start_up(
    mailbox: Option<&mut Mailbox>,
    device: &SubDevice,
    config: Option<&DeviceConfig>,
) -> Result<(), Cause> {
    let all = config.map(|config| &config.parameters[..]).unwrap_or_default();
    let Some(first) = all.first() else { return Ok(()) };
    let failed = |drive, idn, error| Cause::Soe { place: device.place(), drive, idn, error };
    let Some(mailbox) = mailbox.filter(|_| device.has_soe()) else {
        return Err(failed(first.drive, first.idn, MailboxError::Absent.into()));
    };
    for one in all {
        let written = write(mailbox, one.drive, one.idn, &one.data).await;
        written.map_err(|error| failed(one.drive, one.idn, error))?;
    }
    Ok(())
}

/// Writes the value of an IDN, in fragments if it is longer than the mailbox. The device answers
/// the last one.
pub(crate) async fn write(
    mailbox: &mut Mailbox,
    drive: u8,
    idn: Idn,
    data: &[u8],
) -> Result<(), SoeError> {
    let header = Header::new(Opcode::WRITE_REQUEST, drive, Elements::VALUE, idn);
    let room = mailbox.request_len().saturating_sub(HEADER_LEN).max(1);
    let count = data.len().div_ceil(room).max(1);
    let fragment = |number: usize| {
        let left = count - 1 - number;
        let from = number * room;
        let part = &data[from..data.len().min(from + room)];
        let header = match left {
            0 => header,
            _ => Header { incomplete: true, idn: Idn(left as u16), ..header },
        };
        [&header.emit()[..], part].concat()
    };
    let fragments: Vec<Vec<u8>> = (0..count).map(fragment).collect();
    let fragments: Vec<&[u8]> = fragments.iter().map(Vec::as_slice).collect();
    // A late answer about another IDN, whose service was given up, must not count as the answer to
    // this one.
    let is_answer = |answer: &[u8]| {
        let head = answer.first_chunk().map(Header::parse);
        head.is_some_and(|head| {
            let expected = Header { opcode: Opcode::WRITE_RESPONSE, ..header };
            (head.opcode, head.drive, head.idn) == (expected.opcode, expected.drive, expected.idn)
        })
    };
    let answer = mailbox.ask(Protocol::SOE, &fragments, is_answer).await?;
    let (head, rest) = answer.split_first_chunk().ok_or(SHORT)?;
    if !Header::parse(head).error {
        return Ok(());
    }
    let code = rest.first_chunk().ok_or(SHORT)?;
    Err(SoeError::Code(ErrorCode(u16::from_le_bytes(*code))))
}

const SHORT: SoeError =
    SoeError::Mailbox(MailboxError::Short { length: mailbox::HEADER_LEN + HEADER_LEN });
