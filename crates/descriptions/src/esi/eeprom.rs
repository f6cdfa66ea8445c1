//! The file's description of the EEPROM.

use isocat_wire::sii::{HEADER_LEN, MailboxArea};

use super::read::{self, U16};
use super::tree::{Element, Problem};
use super::warning::{WarningKind, Warnings};

/// `Device/Eeprom`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct EsiEeprom {
    /// Size in bytes.
    pub byte_size: usize,
    /// Words 0 to 6 of the SII: PDI, SYNC pins, pulse length (word 2, in 10 ns), alias. `None` if
    /// the file has none.
    pub configuration: Option<[u8; 14]>,
    /// Mailboxes of BOOT, receive and send.
    pub boot: Option<(MailboxArea, MailboxArea)>,
    /// The whole image (`Data`), if the file has it.
    pub image: Option<Vec<u8>>,
    /// Further categories of the SII: type and bytes.
    pub categories: Vec<(u16, Vec<u8>)>,
}

/// Reads the description of the EEPROM.
pub(super) fn read(
    device: Element<'_>,
    warnings: &mut Warnings,
) -> Result<Option<EsiEeprom>, Problem> {
    let Some(element) = device.child("Eeprom") else {
        warnings.add(WarningKind::EepromMissing, device.at(), || {
            "no Eeprom; SPI, SYNC pins and pulses of 10 us are assumed".to_owned()
        });
        return Ok(None);
    };
    let most = 4 << 20;
    let byte_size = read::child(element, "ByteSize", 0..=most, warnings)?.unwrap_or(0) as usize;
    let image = read::bytes(element, "Data")?;
    // A complete image begins with the same words.
    let data = match read::bytes(element, "ConfigData")? {
        Some(data) => Some((data, element.child("ConfigData"))),
        None => {
            image.as_ref().map(|data| (data[..data.len().min(14)].to_vec(), element.child("Data")))
        }
    };
    let configuration = data.map(|(data, place)| {
        let mut words = [0; 14];
        let used = data.len().min(words.len());
        words[..used].copy_from_slice(&data[..used]);
        // The words after the pulse length are often omitted and become zeros.
        if data.len() < WITH_PULSE_LENGTH || data.len() > words.len() || data.len() % 2 != 0 {
            let at = place.map_or(element.at(), Element::at);
            warnings.add(WarningKind::ConfigDataLength, at, || {
                let rest = if data.len() > 14 { "dropped" } else { "taken as 0" };
                format!("{} bytes; expected whole words, 6 to 14; the rest is {rest}", data.len())
            });
        }
        words
    });
    let boot = match (element.child("BootStrap"), read::bytes(element, "BootStrap")?) {
        (Some(_), Some(data)) if data.len() == 8 => {
            let word = |at: usize| u16::from_le_bytes([data[at], data[at + 1]]);
            let area = |at| MailboxArea { start: word(at), length: word(at + 2) };
            Some((area(0), area(4)))
        }
        (Some(place), Some(data)) if !data.is_empty() => {
            let message = format!("BootStrap has {} bytes; expected 8", data.len());
            return Err(Problem::new(place.at(), message));
        }
        _ => None,
    };
    let mut categories = Vec::new();
    for category in element.children("Category") {
        // Only an image needs these categories, so an unreadable one is left out.
        let kind = read::child(category, "CatNo", U16, warnings).unwrap_or(None);
        let data = read::bytes(category, "Data").unwrap_or(None);
        categories.extend(kind.map(|kind| (kind as u16, data.unwrap_or_default())));
    }
    // A shorter one is no image, but its first words are used.
    let image = image.filter(|image| image.len() >= HEADER_LEN);
    Ok(Some(EsiEeprom { byte_size, configuration, boot, image, categories }))
}

/// `Info/StateMachine/Timeout` and `Info/Mailbox/Timeout`, in ms; `None` if not stated.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct EsiTimeouts {
    /// INIT to PREOP.
    pub preop: Option<u32>,
    /// PREOP to SAFEOP, and SAFEOP to OP.
    pub safeop_op: Option<u32>,
    /// Back to INIT.
    pub back_to_init: Option<u32>,
    /// Back to SAFEOP.
    pub back_to_safeop: Option<u32>,
    /// Mailbox, until the request is accepted.
    pub request: Option<u32>,
    /// Mailbox, until the answer arrives.
    pub response: Option<u32>,
    /// Whether SAFEOP is entered before SYNC pulses come.
    pub safeop_without_sync: bool,
}

/// Reads `Info`.
pub(super) fn timeouts(
    device: Element<'_>,
    warnings: &mut Warnings,
) -> Result<EsiTimeouts, Problem> {
    let Some(info) = device.child("Info") else { return Ok(EsiTimeouts::default()) };
    let machine = info.child("StateMachine");
    let mut of = |parent: Option<Element<'_>>, name: &'static str| match parent {
        Some(parent) => child_ms(parent, name, warnings),
        None => Ok(None),
    };
    let state = machine.and_then(|machine| machine.child("Timeout"));
    let mailbox = info.child("Mailbox").and_then(|mailbox| mailbox.child("Timeout"));
    let without_sync = match machine.and_then(|machine| machine.child("Behavior")) {
        Some(behaviour) => read::flag(behaviour, "StartToSafeopNoSync")?,
        None => false,
    };
    Ok(EsiTimeouts {
        preop: of(state, "PreopTimeout")?,
        safeop_op: of(state, "SafeopOpTimeout")?,
        back_to_init: of(state, "BackToInitTimeout")?,
        back_to_safeop: of(state, "BackToSafeopTimeout")?,
        request: of(mailbox, "RequestTimeout")?,
        response: of(mailbox, "ResponseTimeout")?,
        safeop_without_sync: without_sync,
    })
}

fn child_ms(
    parent: Element<'_>,
    name: &'static str,
    warnings: &mut Warnings,
) -> Result<Option<u32>, Problem> {
    Ok(read::child(parent, name, 0..=LONGEST_MS, warnings)?.map(|ms| ms as u32))
}

/// Words 0 to 2.
const WITH_PULSE_LENGTH: usize = 6;
/// A day, longer than any practical timeout.
const LONGEST_MS: i64 = 86_400_000;
