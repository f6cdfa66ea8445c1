//! The SII, read through the EEPROM registers.

use alloc::boxed::Box;
use alloc::string::String;
use alloc::vec;
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
use crate::left_out::{self, Failures};
use crate::link::{Link, Procedure};
use crate::segment::{Identity, OperationMode, Segment, Sii, SiiPdo, SubDevice};
use crate::service::Service;

/// Reads the SII of one SubDevice and hands the EEPROM over to its firmware afterwards.
pub(crate) async fn read(
    link: &Link,
    config: &Config,
    device: &mut SubDevice,
) -> Result<(), Cause> {
    let start = read_start(link, config, device).await?;
    read_rest(link, config, device, start).await?;
    take_over(link, config, device).await
}

/// Reads the SII of all SubDevices that take part. Of SIIs that begin alike, the first two are read
/// to their end; if these agree, the others take the rest from the first. A SII with a wrong
/// content then does not agree with the second, so it is not copied.
pub(crate) async fn read_all(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
) -> Result<Failures, Cause> {
    // Filled by position: a procedure has its own place.
    let mut starts: Vec<Option<Start>> = Vec::new();
    starts.resize_with(segment.devices.len(), || None);
    let (positions, all) = segment
        .devices
        .iter()
        .zip(&mut starts)
        .filter(|(device, _)| device.admitted)
        .map(|(device, start)| -> (usize, Procedure<'_, Result<(), Cause>>) {
            let read = async move {
                *start = Some(read_start(link, config, device).await?);
                Ok(())
            };
            (device.position, Box::pin(read))
        })
        .unzip();
    let mut failures = left_out::each_of(config, positions, all).await?;

    let kinds = kinds(&starts);
    let witnesses: Vec<usize> =
        kinds.iter().flat_map(|kind| kind.iter().take(2).copied()).collect();
    failures.extend(read_rests(link, config, segment, &starts, &witnesses).await?);

    let mut own = Vec::new();
    for kind in &kinds {
        let [first, second, others @ ..] = &kind[..] else { continue };
        let failed = |at: &usize| failures.iter().any(|(position, _)| position == at);
        let can_share = !failed(first)
            && !failed(second)
            && agree(&segment.devices[*first], &segment.devices[*second]);
        if !can_share {
            own.extend(others);
            continue;
        }
        let source = segment.devices[*first].clone();
        for position in others {
            let Some(start) = &starts[*position] else { continue };
            share_rest(&mut segment.devices[*position], start, &source);
        }
    }
    failures.extend(read_rests(link, config, segment, &starts, &own).await?);

    let failed = |position: usize| failures.iter().any(|(at, _)| *at == position);
    let (positions, all) = segment
        .devices
        .iter_mut()
        .filter(|device| device.admitted && !failed(device.position))
        .map(|device| -> (usize, Procedure<'_, Result<(), Cause>>) {
            (device.position, Box::pin(take_over(link, config, device)))
        })
        .unzip();
    let at_the_end = left_out::each_of(config, positions, all).await?;
    failures.extend(at_the_end);
    Ok(failures)
}

/// Positions of SIIs that begin alike, ascending in each group.
fn kinds(starts: &[Option<Start>]) -> Vec<Vec<usize>> {
    let mut kinds: Vec<Vec<usize>> = Vec::new();
    for (position, start) in starts.iter().enumerate() {
        let Some(start) = start else { continue };
        let alike = |kind: &&mut Vec<usize>| {
            starts[kind[0]].as_ref().is_some_and(|first| start.is_like(first))
        };
        match kinds.iter_mut().find(alike) {
            Some(kind) => kind.push(position),
            None => kinds.push(Vec::from([position])),
        }
    }
    kinds
}

/// Reads the rest of the SIIs at some positions, concurrently.
async fn read_rests(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    starts: &[Option<Start>],
    wanted: &[usize],
) -> Result<Failures, Cause> {
    let mut is_wanted = vec![false; segment.devices.len()];
    wanted.iter().for_each(|position| is_wanted[*position] = true);
    let (positions, all) = segment
        .devices
        .iter_mut()
        .zip(starts)
        .filter(|(device, _)| is_wanted[device.position])
        .map(|(device, start)| -> (usize, Procedure<'_, Result<(), Cause>>) {
            let start = start.clone().unwrap_or_default();
            (device.position, Box::pin(read_rest(link, config, device, start)))
        })
        .unzip();
    left_out::each_of(config, positions, all).await
}

/// Whether two completely read SIIs agree, except for alias and serial number.
fn agree(one: &SubDevice, other: &SubDevice) -> bool {
    let mut sii = one.sii.clone();
    let own = &other.sii.header;
    (sii.header.configuration, sii.header.serial) = (own.configuration, own.serial);
    sii == other.sii && one.substitutes.len() == other.substitutes.len()
}

/// Reads the words that differ between SubDevices, and those that tell whether the rest is equal.
pub(crate) async fn read_start(
    link: &Link,
    config: &Config,
    device: &SubDevice,
) -> Result<Start, Cause> {
    let mut reader = Reader::new(link, config, device);
    let result = async {
        reader.words(0, START_WORDS).await?;
        // Size and version, and what kind of category comes first and how long it is.
        reader.words(usize::from(word::CATEGORIES) - 2, 4).await
    };
    let end = result.await.map_err(|failure| failure.of(device))?;
    let start = Start { image: reader.image, end };
    match start.blank() {
        Some(byte) => Err(Failure::Problem(SiiProblem::Blank(byte)).of(device)),
        None => Ok(start),
    }
}

/// Reads the rest: the other words of the header, and the categories.
pub(crate) async fn read_rest(
    link: &Link,
    config: &Config,
    device: &mut SubDevice,
    start: Start,
) -> Result<(), Cause> {
    let mut reader = Reader { image: start.image, ..Reader::new(link, config, device) };
    let mut sii = reader.header().await.map_err(|failure| failure.of(device))?;
    let categories = reader.categories(&mut sii).await;
    device.sii = sii;
    let Err(failure) = categories else { return Ok(()) };
    let cause = failure.of(device);
    // Without objects there is nothing else that tells of its process data.
    if device.has_coe() { device.do_without(Service::Categories, cause) } else { Err(cause) }
}

/// Takes the rest from the SII of another SubDevice, which [`Start::is_like`] this one.
pub(crate) fn share_rest(device: &mut SubDevice, start: &Start, of: &SubDevice) {
    let own = Header::parse(&start.padded()).unwrap_or_default();
    device.sii = of.sii.clone();
    let header = &mut device.sii.header;
    (header.configuration, header.serial) = (own.configuration, own.serial);
    // What was done without at the one is done without at all.
    let place = device.place();
    for substitute in &of.substitutes {
        let mut substitute = substitute.clone();
        if let Cause::Sii { place: at, .. } = &mut substitute.cause {
            *at = place.clone();
        }
        device.substitutes.push(substitute);
    }
}

/// Takes over the identity that was read, and gives the EEPROM to its firmware.
pub(crate) async fn take_over(
    link: &Link,
    config: &Config,
    device: &mut SubDevice,
) -> Result<(), Cause> {
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
            check_area(area).map_err(|problem| Cause::Sii { place: device.place(), problem })?;
        }
    }
    link.write(device.station, register::EEPROM_CONFIGURATION, 1).await?;
    Ok(())
}

/// Whether a mailbox can be used: a datagram carries it, and it is where an ESC has memory.
fn check_area(area: MailboxArea) -> Result<(), SiiProblem> {
    if !MAILBOX_LENGTHS.contains(&area.length) {
        return Err(SiiProblem::MailboxLength(area.length));
    }
    let last = area.start.checked_add(area.length - 1);
    if area.start < register::PROCESS_RAM || last.is_none() {
        return Err(SiiProblem::MailboxPlace(area));
    }
    Ok(())
}

/// Reads only the identity of a SubDevice.
pub(crate) async fn identity(
    link: &Link,
    config: &Config,
    device: &SubDevice,
) -> Result<Identity, Cause> {
    let mut reader = Reader::new(link, config, device);
    let read = reader.words(0, START_WORDS).await;
    read.map_err(|failure| failure.of(device))?;
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
    /// Takes the data of a category, which begin at word `at`. Unused categories, and those with
    /// names of strings, are left out.
    pub fn take(&mut self, kind: u16, at: usize, data: &[u8]) {
        match kind {
            category::FMMU => self.fmmus = data.to_vec(),
            category::SYNC_MANAGER => {
                self.sync_managers_at = Some(at);
                let records = data.chunks_exact(SmRecord::LEN);
                self.sync_managers =
                    records.filter_map(|r| r.first_chunk()).map(SmRecord::parse).collect();
            }
            category::RX_PDO => self.rx_pdos.extend(pdos(at, data)),
            category::TX_PDO => self.tx_pdos.extend(pdos(at, data)),
            category::DC => {
                let modes = data.chunks_exact(OPERATION_MODE_LEN);
                self.operation_modes = modes.filter_map(operation_mode).collect();
            }
            _ => {}
        }
    }
}

/// The start of a SII, read before it is known whether the rest equals that of another.
#[derive(Clone, Default)]
pub(crate) struct Start {
    /// Words 0 to 0x0F.
    image: Vec<u8>,
    /// Size, version, and the head of the first category.
    end: Vec<u8>,
}

impl Start {
    /// Whether two SIIs count as equal except for alias and serial number: configuration, identity,
    /// size and the head of the first category agree, and also the checksum if the aliases are
    /// equal, since it covers the alias.
    pub fn is_like(&self, other: &Self) -> bool {
        let word =
            |image: &Self, at: usize| image.image.get(2 * at..2 * at + 2).map(<[u8]>::to_vec);
        let same = |at: usize| word(self, at) == word(other, at);
        let identified =
            self.image.get(IDENTITY).is_some_and(|bytes| bytes.iter().any(|b| *b != 0));
        let checked = !same(ALIAS_WORD) || same(CHECKSUM_WORD);
        let own = [ALIAS_WORD, CHECKSUM_WORD, SERIAL_WORD, SERIAL_WORD + 1];
        let mut shared = (0..START_WORDS).filter(|at| !own.contains(at));
        identified && checked && self.end == other.end && shared.all(same)
    }

    /// The value of all bytes, if nothing was ever written to this EEPROM.
    fn blank(&self) -> Option<u8> {
        let end = sii::blank(&self.end)?;
        sii::blank(&self.image).filter(|byte| *byte == end)
    }

    fn padded(&self) -> Vec<u8> {
        let mut image = self.image.clone();
        image.resize(HEADER_LEN, 0);
        image
    }
}

enum Failure {
    Problem(SiiProblem),
    Cause(Cause),
}

impl Failure {
    fn of(self, device: &SubDevice) -> Cause {
        match self {
            Failure::Problem(problem) => Cause::Sii { place: device.place(), problem },
            Failure::Cause(cause) => cause,
        }
    }
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

impl<'a> Reader<'a> {
    fn new(link: &'a Link, config: &Config, device: &SubDevice) -> Self {
        let (station, patience) = (device.station, config.timeouts.eeprom);
        Self { link, station, patience, begin: link.now(), image: Vec::new() }
    }

    /// Reads the header, whose start is already read.
    async fn header(&mut self) -> Result<Sii, Failure> {
        // Words 0x1D to 0x3D are reserved and need not be read.
        let mailbox = usize::from(word::MAILBOX_PROTOCOLS) + 1;
        self.words(START_WORDS, mailbox - START_WORDS).await?;
        self.image.resize(HEADER_LEN.max(self.image.len()), 0);
        Ok(Sii { header: Header::parse(&self.image).unwrap_or_default(), ..Sii::default() })
    }

    /// Reads the categories into `sii`, as far as they can be read.
    async fn categories(&mut self, sii: &mut Sii) -> Result<(), Failure> {
        let (mut strings, mut names) = (Vec::new(), (0, 0));
        let result = self.each_category(sii, &mut strings, &mut names).await;
        sii.name = text(&strings, names.0);
        sii.order = text(&strings, names.1);
        result
    }

    async fn each_category(
        &mut self,
        sii: &mut Sii,
        strings: &mut Vec<u8>,
        (name, order): &mut (u8, u8),
    ) -> Result<(), Failure> {
        let mut at = usize::from(word::CATEGORIES);
        for _ in 0..MOST_CATEGORIES {
            if at >= MOST_WORDS {
                break;
            }
            let head = self.words(at, 2).await?;
            let kind = u16::from_le_bytes([head[0], head[1]]);
            if kind == category::END {
                sii.end = at;
                return Ok(());
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
                category::STRINGS => *strings = data,
                category::GENERAL => {
                    sii.has_general = true;
                    *order = data.get(2).copied().unwrap_or(0);
                    *name = data.get(3).copied().unwrap_or(0);
                    sii.coe_details = data.get(5).copied().unwrap_or(0);
                }
                _ => sii.take(kind, start, &data),
            }
        }
        Err(Failure::Problem(SiiProblem::NoEnd))
    }

    /// Reads `count` words from word `first` on. Further words of an access are kept for the next
    /// call.
    async fn words(&mut self, first: usize, count: usize) -> Result<Vec<u8>, Failure> {
        let mut bytes = Vec::with_capacity(2 * count + 8);
        while bytes.len() < 2 * count {
            let data = self.access(first + bytes.len() / 2).await?;
            bytes.extend_from_slice(&data);
        }
        bytes.truncate(2 * count);
        let kept = HEADER_LEN.saturating_sub(2 * first).min(bytes.len());
        if kept > 0 {
            self.image.resize(self.image.len().max(2 * first + kept), 0);
            self.image[2 * first..2 * first + kept].copy_from_slice(&bytes[..kept]);
        }
        Ok(bytes)
    }

    /// Makes one access: the 4 or 8 bytes at a word.
    async fn access(&mut self, word: usize) -> Result<Vec<u8>, Failure> {
        let after = self.link.now() - self.begin;
        if after.0 > self.patience.0.saturating_mul(MOST_PATIENCES) {
            return Err(Failure::Problem(SiiProblem::Slow { after }));
        }
        let end = self.link.now() + self.patience;
        let address = register::EEPROM_STATUS.address;
        // The last status with an error: an EEPROM that does not acknowledge is not busy.
        let mut refused = None;
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
                if !status.busy() {
                    refused = Some(status);
                }
                if !status.busy() || self.link.now() >= end {
                    break;
                }
                self.link.sleep(POLL).await;
            }
            if self.link.now() >= end {
                return Err(Failure::Problem(match refused {
                    Some(status) if status.no_acknowledge() => SiiProblem::NoAcknowledge(status.0),
                    Some(status) => SiiProblem::Status(status.0),
                    None => SiiProblem::Busy,
                }));
            }
            // Missing acknowledge: an EEPROM still busy with a write. Clear and try again.
            self.link.fpwr(self.station, address, &[0, 0]).expect(1).await?;
            self.link.sleep(RETRY).await;
        }
    }
}

/// PDOs of a category whose data begin at word `at`, each head with its entries; an incomplete PDO
/// at the end is dropped.
fn pdos(at: usize, data: &[u8]) -> Vec<SiiPdo> {
    let mut pdos = Vec::new();
    let mut records = data.chunks_exact(PdoRecord::LEN).filter_map(|r| r.first_chunk());
    let mut word = at;
    while let Some(head) = records.next() {
        let record = PdoRecord::parse(head);
        let entries: Vec<_> =
            records.by_ref().take(usize::from(record.entries)).map(PdoEntryRecord::parse).collect();
        let words = (1 + entries.len()) * PdoRecord::LEN / 2;
        if entries.len() == usize::from(record.entries) {
            pdos.push(SiiPdo { word, record, entries });
        }
        word += words;
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

/// Categories that are read; the others are skipped.
const USED: [u16; 7] = [
    category::STRINGS,
    category::GENERAL,
    category::FMMU,
    category::SYNC_MANAGER,
    category::TX_PDO,
    category::RX_PDO,
    category::DC,
];
/// Possible lengths of a mailbox: at least an SDO, at most a datagram.
const MAILBOX_LENGTHS: core::ops::RangeInclusive<u16> = 16..=1486;
/// Words that are read of each SII: configuration, alias, checksum, identity.
const START_WORDS: usize = 0x10;
const ALIAS_WORD: usize = 0x04;
const CHECKSUM_WORD: usize = 0x07;
const SERIAL_WORD: usize = 0x0E;
/// Vendor id and product code, in bytes.
const IDENTITY: core::ops::Range<usize> = 0x10..0x18;
/// Bytes of one DC operation mode.
const OPERATION_MODE_LEN: usize = 24;
/// Status, address, eight bytes of data.
const ACCESS_LEN: usize = 14;
/// Words of the largest EEPROM that two address bytes reach; an image without an end mark is read
/// up to here.
const MOST_WORDS: usize = 0x1_0000;
/// Most categories of an image. A standard image has about a dozen, but an image could hold
/// thousands of empty ones.
const MOST_CATEGORIES: usize = 256;
/// Most time for a whole image, as a multiple of the timeout of a single access. A large image
/// takes 10 s, and some times as long if a thousand SubDevices are read concurrently.
const MOST_PATIENCES: i64 = 600;
/// An EEPROM needs some hundred microseconds for a read.
const POLL: Nanos = Nanos(100_000);
/// Pause before another attempt after a missing acknowledge.
const RETRY: Nanos = Nanos(1_000_000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mailbox_lies_in_memory_and_fits_a_datagram() {
        let check = |start, length| check_area(MailboxArea { start, length });
        for (start, length) in [(0x1000, 16), (0x1000, 1486), (0xFFF0, 16), (0xFA32, 1486)] {
            assert_eq!(check(start, length), Ok(()), "{start:#06x} {length}");
        }
        for length in [0, 15, 1487, u16::MAX] {
            assert_eq!(check(0x1000, length), Err(SiiProblem::MailboxLength(length)));
        }
        for (start, length) in [(0x0FFF, 16), (0, 16), (0xFFF1, 16), (0xFA33, 1486)] {
            let problem = SiiProblem::MailboxPlace(MailboxArea { start, length });
            assert_eq!(check(start, length), Err(problem));
        }
    }
}
