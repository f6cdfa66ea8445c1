//! The SII, read through the EEPROM registers.

use alloc::string::String;
use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::eeprom::{EepromStatus, read_command};
use isocat_wire::register;
use isocat_wire::sii::{
    self, HEADER_LEN, Header, MailboxArea, PdoEntryRecord, PdoRecord, SmRecord, category, word,
};
use isocat_wire::time::{Host, Nanos, Time};

use crate::config::Config;
use crate::error::{Cause, SiiProblem};
use crate::link::Link;
use crate::segment::{Identity, OperationMode, Sii, SiiPdo, SubDevice};

/// Reads the SII of one SubDevice and hands the EEPROM over to its firmware afterwards.
pub(crate) async fn read(
    link: &Link,
    config: &Config,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let mut reader = Reader {
        link,
        station: device.station,
        patience: config.timeouts.eeprom,
        begin: link.now(),
        image: Vec::new(),
    };
    let result = reader.sii().await;
    device.sii = result.map_err(|failure| match failure {
        Failure::Problem(problem) => Cause::Sii { place: device.place(), problem },
        Failure::Cause(cause) => cause,
    })?;
    let header = &device.sii.header;
    device.identity = Identity::of(header);
    if device.name.is_empty() {
        device.name.clone_from(&device.sii.name);
    }
    let wanted = config.devices.get(device.position).and_then(|config| config.identity);
    let found = (header.vendor_id, header.product_code);
    if let Some(expected) = wanted.filter(|wanted| *wanted != found) {
        return Err(Cause::Identity { place: device.place(), expected, found });
    }
    if device.has_mailbox() {
        let header = &device.sii.header;
        for area in [header.receive, header.send] {
            if !MAILBOX_LENGTHS.contains(&area.length) {
                let problem = SiiProblem::MailboxLength(area.length);
                return Err(Cause::Sii { place: device.place(), problem });
            }
        }
    }
    link.write(device.station, register::EEPROM_CONFIGURATION, 1).await?;
    Ok(())
}

/// Reads who a SubDevice is, and nothing else.
pub(crate) async fn identity(
    link: &Link,
    config: &Config,
    device: &SubDevice,
) -> Result<Identity, Cause> {
    let (station, patience) = (device.station, config.timeouts.eeprom);
    let begin = link.now();
    let mut reader = Reader { link, station, patience, begin, image: Vec::new() };
    let read = reader.words(0, usize::from(word::MAILBOX_PROTOCOLS) + 1).await;
    read.map_err(|failure| match failure {
        Failure::Problem(problem) => Cause::Sii { place: device.place(), problem },
        Failure::Cause(cause) => cause,
    })?;
    reader.image.resize(HEADER_LEN.max(reader.image.len()), 0);
    Ok(Identity::of(&Header::parse(&reader.image).unwrap_or_default()))
}

impl Identity {
    fn of(header: &Header) -> Self {
        Self {
            vendor: header.vendor_id,
            product: header.product_code,
            revision: header.revision,
            serial: header.serial,
        }
    }
}

impl Sii {
    /// Takes the data of a category; those without use here, and those that name strings, are left out.
    pub fn take(&mut self, kind: u16, data: &[u8]) {
        match kind {
            category::FMMU => self.fmmus = data.to_vec(),
            category::SYNC_MANAGER => {
                let records = data.chunks_exact(SmRecord::LEN);
                self.sync_managers =
                    records.filter_map(|r| r.first_chunk()).map(SmRecord::parse).collect();
            }
            category::RX_PDO => self.rx_pdos.extend(pdos(data)),
            category::TX_PDO => self.tx_pdos.extend(pdos(data)),
            category::DC => {
                let modes = data.chunks_exact(OPERATION_MODE_LEN);
                self.operation_modes = modes.filter_map(operation_mode).collect();
            }
            _ => {}
        }
    }
}

enum Failure {
    Problem(SiiProblem),
    Cause(Cause),
}

impl<E: Into<Cause>> From<E> for Failure {
    fn from(error: E) -> Self {
        Failure::Cause(error.into())
    }
}

struct Reader<'a> {
    link: &'a Link,
    station: StationAddress,
    patience: Nanos,
    /// When reading began.
    begin: Time<Host>,
    /// Bytes read so far, from word 0; gaps are zeros.
    image: Vec<u8>,
}

impl Reader<'_> {
    async fn sii(&mut self) -> Result<Sii, Failure> {
        // Words 0x1D to 0x3D are reserved and need not be read.
        self.words(0, usize::from(word::MAILBOX_PROTOCOLS) + 1).await?;
        self.words(usize::from(word::CATEGORIES) - 2, 2).await?;
        self.image.resize(HEADER_LEN.max(self.image.len()), 0);
        let mut sii =
            Sii { header: Header::parse(&self.image).unwrap_or_default(), ..Sii::default() };
        let mut strings: Vec<u8> = Vec::new();
        let (mut name, mut order) = (0, 0);
        let mut at = usize::from(word::CATEGORIES);
        for _ in 0..MOST_CATEGORIES {
            if at >= MOST_WORDS {
                break;
            }
            let head = self.words(at, 2).await?;
            let kind = u16::from_le_bytes([head[0], head[1]]);
            if kind == category::END {
                sii.name = text(&strings, name);
                sii.order = text(&strings, order);
                return Ok(sii);
            }
            let length = usize::from(u16::from_le_bytes([head[2], head[3]]));
            let start = at + 2;
            at = start + length;
            if at >= MOST_WORDS {
                break;
            }
            if !USED.contains(&kind) {
                continue;
            }
            let data = self.words(start, length).await?;
            match kind {
                category::STRINGS => strings = data,
                category::GENERAL => {
                    order = data.get(2).copied().unwrap_or(0);
                    name = data.get(3).copied().unwrap_or(0);
                    sii.coe_details = data.get(5).copied().unwrap_or(0);
                }
                _ => sii.take(kind, &data),
            }
        }
        Err(Failure::Problem(SiiProblem::NoEnd))
    }

    /// `count` words from word `first` on. What one access gives beyond them is kept for the next.
    async fn words(&mut self, first: usize, count: usize) -> Result<Vec<u8>, Failure> {
        let mut bytes = Vec::with_capacity(2 * count + 8);
        while bytes.len() < 2 * count {
            let data = self.access(first + bytes.len() / 2).await?;
            bytes.extend_from_slice(&data);
        }
        bytes.truncate(2 * count);
        if 2 * first + bytes.len() <= HEADER_LEN {
            self.image.resize(self.image.len().max(2 * first + bytes.len()), 0);
            self.image[2 * first..2 * first + bytes.len()].copy_from_slice(&bytes);
        }
        Ok(bytes)
    }

    /// One access: the 4 or 8 bytes at a word.
    async fn access(&mut self, word: usize) -> Result<Vec<u8>, Failure> {
        let after = self.link.now() - self.begin;
        if after.0 > self.patience.0.saturating_mul(MOST_PATIENCES) {
            return Err(Failure::Problem(SiiProblem::Slow { after }));
        }
        let end = self.link.now() + self.patience;
        let address = register::EEPROM_STATUS.address;
        loop {
            self.link.fpwr(self.station, address, &read_command(word as u32)).expect(1).await?;
            let mut status;
            // Status, address and data in one read, so that nothing can change in between.
            loop {
                let reply = self.link.fprd(self.station, address, ACCESS_LEN).expect(1).await?;
                status = EepromStatus(u16::from_le_bytes([reply.data[0], reply.data[1]]));
                if !status.busy() && !status.failed() {
                    return Ok(reply.data[6..6 + status.read_len()].to_vec());
                }
                if !status.busy() || self.link.now() >= end {
                    break;
                }
                self.link.sleep(POLL).await;
            }
            if self.link.now() >= end {
                return Err(Failure::Problem(if status.busy() {
                    SiiProblem::Busy
                } else {
                    SiiProblem::Status(status.0)
                }));
            }
            // Missing acknowledge: an EEPROM still busy with a write. Clear and try again.
            self.link.fpwr(self.station, address, &[0, 0]).expect(1).await?;
            self.link.sleep(RETRY).await;
        }
    }
}

/// PDOs of a category, each head with its entries; what is cut off at the end is dropped.
fn pdos(data: &[u8]) -> Vec<SiiPdo> {
    let mut pdos = Vec::new();
    let mut records = data.chunks_exact(PdoRecord::LEN).filter_map(|r| r.first_chunk());
    while let Some(head) = records.next() {
        let record = PdoRecord::parse(head);
        let entries: Vec<_> =
            records.by_ref().take(usize::from(record.entries)).map(PdoEntryRecord::parse).collect();
        if entries.len() == usize::from(record.entries) {
            pdos.push(SiiPdo { record, entries });
        }
    }
    pdos
}

fn operation_mode(b: &[u8]) -> Option<OperationMode> {
    let b: &[u8; 18] = b.first_chunk()?;
    Some(OperationMode {
        cycle_time_0: u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        shift_time_0: i32::from_le_bytes([b[4], b[5], b[6], b[7]]),
        shift_time_1: i32::from_le_bytes([b[8], b[9], b[10], b[11]]),
        sync1_factor: i16::from_le_bytes([b[12], b[13]]),
        assign_activate: u16::from_le_bytes([b[14], b[15]]),
        sync0_factor: i16::from_le_bytes([b[16], b[17]]),
    })
}

fn text(strings: &[u8], number: u8) -> String {
    let bytes = sii::string(strings, number).unwrap_or(&[]);
    String::from_utf8_lossy(bytes).into_owned()
}

/// The two areas of the standard mailbox.
pub(crate) fn mailbox_areas(header: &Header) -> (MailboxArea, MailboxArea) {
    (header.receive, header.send)
}

/// Categories that are read; the others are only stepped over.
const USED: [u16; 7] = [
    category::STRINGS,
    category::GENERAL,
    category::FMMU,
    category::SYNC_MANAGER,
    category::TX_PDO,
    category::RX_PDO,
    category::DC,
];
/// Lengths of a mailbox that a datagram can carry and that holds an SDO.
const MAILBOX_LENGTHS: core::ops::RangeInclusive<u16> = 16..=1486;
/// Bytes of one DC operation mode.
const OPERATION_MODE_LEN: usize = 24;
/// Status, address, eight bytes of data.
const ACCESS_LEN: usize = 14;
/// Words of the largest EEPROM that two address bytes reach; an image without an end mark is read
/// no further.
const MOST_WORDS: usize = 0x1_0000;
/// Categories of an image at most: it is years' worth of standards to have a dozen, and empty ones could be had by the thousand.
const MOST_CATEGORIES: usize = 256;
/// The time for a whole image, in times of what a single access may take. A large image of an honest EEPROM takes 10 s, and some times as
/// long where a thousand SubDevices are read side by side.
const MOST_PATIENCES: i64 = 600;
/// An EEPROM needs some hundred microseconds for a read.
const POLL: Nanos = Nanos(100_000);
/// Before another try after a missing acknowledge.
const RETRY: Nanos = Nanos(1_000_000);
