//! Compares the SubDevices that answer with the list, by their SIIs.
//!
//! Reads by position, and only writes the registers of the EEPROM interface, which every MainDevice
//! uses.

use isocat_descriptions::start_up::{Address, StartUp};
use isocat_wire::Command;
use isocat_wire::eeprom::{EepromStatus, read_command};
use isocat_wire::register::{self, Value};
use isocat_wire::sii::{HEADER_LEN, Header};
use isocat_wire::time::Nanos;

use crate::failure::Kind;
use crate::line::{Line, Reply};

/// Reads the first 64 words of each SII. `Err`: the number of SubDevices that answer is not
/// `expected`.
pub(super) fn read(line: &mut Line, expected: usize) -> Result<Vec<Header>, Kind> {
    let found = count(line)?;
    if usize::from(found) != expected {
        return Err(Kind::Count { expected, found });
    }
    (0..expected).map(|position| header(line, position)).collect()
}

/// `Err`: another SubDevice than that of the list answers at some position.
pub(super) fn compare(list: &StartUp, found: &[Header]) -> Result<(), Kind> {
    for (position, (device, header)) in list.devices.iter().zip(found).enumerate() {
        let expected = (device.vendor, device.product);
        let found = (header.vendor_id, header.product_code);
        if expected != found {
            return Err(Kind::Identity { position, expected, found });
        }
    }
    Ok(())
}

/// Differing revisions and serial numbers. The list has its own checks of them on the way up.
pub(super) fn notes(list: &StartUp, found: &[Header]) -> Vec<String> {
    let mut notes = Vec::new();
    for (position, (device, header)) in list.devices.iter().zip(found).enumerate() {
        let name = format!("SubDevice {position} ({})", device.name);
        if device.revision != header.revision {
            notes.push(format!(
                "{name} has revision 0x{:08X}, the ENI is for 0x{:08X}",
                header.revision, device.revision
            ));
        }
        if device.serial != 0 && device.serial != header.serial {
            notes.push(format!(
                "{name} has serial number {}, the ENI names {}",
                header.serial, device.serial
            ));
        }
    }
    notes
}

/// The number of SubDevices that answer.
fn count(line: &mut Line) -> Result<u16, Kind> {
    let address = Address::Physical { device: 0, register: register::TYPE.address };
    for _ in 0..TRIES {
        if let Some(reply) = line.datagram(Command::Brd, address, &[0])? {
            return Ok(reply.counter);
        }
    }
    Err(Kind::NoAnswer)
}

fn header(line: &mut Line, position: usize) -> Result<Header, Kind> {
    // The PDI may own the EEPROM; it is taken from the PDI while it is read.
    let owner =
        access(line, Command::Aprd, position, register::EEPROM_CONFIGURATION.address, &[0])?;
    access(line, Command::Apwr, position, register::EEPROM_CONFIGURATION.address, &[TAKE_BACK])?;
    access(line, Command::Apwr, position, register::EEPROM_CONFIGURATION.address, &[OF_ECAT])?;
    let mut image = Vec::with_capacity(HEADER_LEN);
    while image.len() < HEADER_LEN {
        let bytes = words(line, position, image.len() as u32 / 2)?;
        image.extend(bytes);
    }
    access(line, Command::Apwr, position, register::EEPROM_CONFIGURATION.address, &owner[..1])?;
    Header::parse(&image).ok_or(Kind::NoIdentity { position })
}

/// The 4 or 8 bytes from a word address on.
fn words(line: &mut Line, position: usize, word: u32) -> Result<Vec<u8>, Kind> {
    let status = register::EEPROM_STATUS.address;
    idle(line, position)?;
    access(line, Command::Apwr, position, status, &read_command(word))?;
    let status = idle(line, position)?;
    if status.failed() {
        return Err(Kind::NoIdentity { position });
    }
    let length = status.read_len();
    access(line, Command::Aprd, position, register::EEPROM_DATA.address, &vec![0; length])
}

/// Waits until the EEPROM interface is free.
fn idle(line: &mut Line, position: usize) -> Result<EepromStatus, Kind> {
    let limit = line.now() + PATIENCE;
    loop {
        let bytes =
            access(line, Command::Aprd, position, register::EEPROM_STATUS.address, &[0; 2])?;
        let status = EepromStatus::from_bytes([bytes[0], bytes[1]]);
        if !status.busy() {
            return Ok(status);
        }
        if line.now() > limit {
            return Err(Kind::NoIdentity { position });
        }
        line.sleep(BETWEEN_LOOKS)?;
    }
}

/// Makes an access by position, which the SubDevice must take; returns the data that come back.
fn access(
    line: &mut Line,
    command: Command,
    position: usize,
    register: u16,
    data: &[u8],
) -> Result<Vec<u8>, Kind> {
    let address = Address::Physical { device: (position as u16).wrapping_neg(), register };
    for _ in 0..TRIES {
        let reply = line.datagram(command, address, data)?;
        if let Some(Reply { data, .. }) = reply.filter(|reply| reply.counter == 1) {
            return Ok(data);
        }
    }
    Err(Kind::NoIdentity { position })
}

/// Values of register 0x0500: the EEPROM belongs to ECAT; ECAT takes it from the PDI by force.
const OF_ECAT: u8 = 0;
const TAKE_BACK: u8 = 2;
/// Number of attempts of an access.
const TRIES: usize = 4;
/// Longest time for a read of the EEPROM.
const PATIENCE: Nanos = Nanos::millis(500);
/// Time between two looks at its status.
const BETWEEN_LOOKS: Nanos = Nanos::micros(100);
