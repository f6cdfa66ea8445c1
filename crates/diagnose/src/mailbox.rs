//! The mailbox traffic of a device: SDO transfers with their values, aborts, mailbox errors,
//! emergencies.
//!
//! Where the capture shows SM0 and SM1, a mailbox message is known by its address. Where it does
//! not, as in captures that begin in operation, a message is taken for one if its header fits its
//! content, and [`Mailbox::by_content`] says so.

use std::collections::BTreeMap;
use std::time::Duration;

use isocat_wire::coe::{self, AbortCode, Service, sdo};
use isocat_wire::mailbox::{self, ErrorDetail, Protocol};
use isocat_wire::register::{self, PROCESS_RAM};
use isocat_wire::{Command, ObjectAddress};

use crate::access::Access;
use crate::known::{Image, Known, Log};

/// Which way a value went.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Way {
    /// SDO download: the MainDevice wrote it.
    Written,
    /// SDO upload: the device sent it.
    Read,
}

/// The value of an object's entry, and its direction.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Entry {
    pub way: Way,
    pub bytes: Vec<u8>,
}

impl Entry {
    /// As an unsigned number; `None`: it is longer than eight bytes, or empty.
    pub fn number(&self) -> Option<u64> {
        let mut all = [0; 8];
        all.get_mut(..self.bytes.len())?.copy_from_slice(&self.bytes);
        (!self.bytes.is_empty()).then_some(u64::from_le_bytes(all))
    }
}

/// A transfer that the device refused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Aborted {
    pub object: ObjectAddress,
    pub way: Way,
    pub code: AbortCode,
    /// Frame of the request, if it is in the capture; `frame` is that of the abort.
    pub request: Option<usize>,
    pub frame: usize,
}

/// An emergency message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Emergency {
    pub code: u16,
    pub register: u8,
    pub frame: usize,
}

/// A request that waits for its answer.
#[derive(Clone, Debug)]
struct Pending {
    object: ObjectAddress,
    complete: bool,
    way: Way,
    bytes: Vec<u8>,
    frame: usize,
    at: Duration,
    /// INIT was the state that had been read last when it was sent.
    in_init: bool,
    /// How often the MainDevice looked for the answer, and when it did so last.
    looks: u64,
    looked_at: Duration,
}

/// An SDO request and how long its answer took.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Taken {
    pub object: ObjectAddress,
    /// The frame of the request.
    pub frame: usize,
    pub took: Duration,
}

/// The mailbox of one device.
#[derive(Clone, Debug)]
pub(crate) struct Mailbox {
    /// Messages by protocol: to the device, and from it.
    pub messages: BTreeMap<u8, [u64; 2]>,
    /// SDO transfers that were answered with a value or a confirmation.
    pub transfers: u64,
    /// The last value seen of each entry.
    pub values: BTreeMap<ObjectAddress, Known<Entry>>,
    pub aborts: Log<Aborted>,
    pub errors: Log<Known<ErrorDetail>>,
    pub emergencies: Log<Emergency>,
    /// SDO requests that were followed by another one before an answer was seen.
    pub unanswered: Log<Known<ObjectAddress>>,
    /// SDO requests that were sent after INIT had been read, and had no answer or a late one.
    pub early: Log<Known<ObjectAddress>>,
    /// The answer that took longest.
    pub slowest: Option<Taken>,
    /// Messages were recognized by their content, because no frame shows where the mailboxes are.
    pub by_content: bool,
    pending: Option<Pending>,
}

impl Mailbox {
    pub fn new() -> Self {
        Self {
            messages: BTreeMap::new(),
            transfers: 0,
            values: BTreeMap::new(),
            aborts: Log::new(256),
            errors: Log::new(64),
            emergencies: Log::new(64),
            unanswered: Log::new(64),
            early: Log::new(64),
            slowest: None,
            by_content: false,
            pending: None,
        }
    }

    /// Takes a datagram to this device; `in_init`: that is the state in which it was seen last.
    pub fn access(&mut self, access: &Access<'_>, image: &Image, at: Duration, in_init: bool) {
        use Command::*;
        if access.command.is_logical() {
            return;
        }
        if access.ado() < PROCESS_RAM {
            // The status of SM1 says whether an answer is there.
            let status = register::sync_manager(1).address + STATUS;
            let reads = matches!(access.command, Aprd | Fprd) && access.taken() == Some(true);
            let looks = reads && access.covers(status, 1);
            if let Some(pending) = self.pending.as_mut().filter(|_| looks) {
                pending.looks += 1;
                pending.looked_at = at;
            }
            return;
        }
        match access.command {
            Apwr | Fpwr if access.taken() != Some(false) => {
                let Some(data) = access.written() else { return };
                if self.is_message(access, data, image, 0) {
                    self.went(data, access.frame, at, in_init);
                }
            }
            Aprd | Fprd => {
                let Some(data) = access.read() else { return };
                if self.is_message(access, data, image, 1) {
                    self.came(data, access.frame, at);
                }
            }
            _ => {}
        }
    }

    /// Whether an access to the process RAM is a message in the mailbox of SyncManager `number`.
    fn is_message(
        &mut self,
        access: &Access<'_>,
        data: &[u8],
        image: &Image,
        number: usize,
    ) -> bool {
        match image.latest(register::sync_manager(number)) {
            Some(manager) if manager.value.is_enabled() => {
                manager.value.is_mailbox() && manager.value.start == access.ado()
            }
            _ => {
                let fits = fits(data);
                self.by_content |= fits;
                fits
            }
        }
    }

    fn went(&mut self, data: &[u8], frame: usize, at: Duration, in_init: bool) {
        let Some(header) = data.first_chunk().map(mailbox::Header::parse) else { return };
        self.messages.entry(header.protocol.0).or_default()[0] += 1;
        if header.protocol != Protocol::COE {
            return;
        }
        let Some((service, body)) = coe_message(data, header) else { return };
        if service != Service::SDO_REQUEST {
            return;
        }
        let Some(initiate) = body.first_chunk().map(sdo::Initiate::parse) else { return };
        let way = match initiate.command.specifier() {
            sdo::specifier::REQUEST_DOWNLOAD => Way::Written,
            sdo::specifier::REQUEST_UPLOAD => Way::Read,
            // Segments and aborts belong to the pending request.
            _ => return,
        };
        if let Some(old) = self.pending.take() {
            let log = if old.in_init { &mut self.early } else { &mut self.unanswered };
            log.push(Known { value: old.object, frame: old.frame });
        }
        let bytes = match way {
            Way::Written => initiate_data(&initiate, body),
            Way::Read => Vec::new(),
        };
        let (object, complete) = (initiate.object, initiate.command.complete());
        let (looks, looked_at) = (0, at);
        let pending =
            Pending { object, complete, way, bytes, frame, at, in_init, looks, looked_at };
        self.pending = Some(pending);
    }

    fn came(&mut self, data: &[u8], frame: usize, at: Duration) {
        let Some(header) = data.first_chunk().map(mailbox::Header::parse) else { return };
        self.messages.entry(header.protocol.0).or_default()[1] += 1;
        let behind = &data[mailbox::HEADER_LEN..];
        if header.protocol == Protocol::ERROR {
            self.pending = None;
            if let Some(detail) = behind.first_chunk().map(ErrorDetail::parse) {
                self.errors.push(Known { value: detail, frame });
            }
            return;
        }
        if header.protocol != Protocol::COE {
            return;
        }
        let Some((service, body)) = coe_message(data, header) else { return };
        match service {
            Service::EMERGENCY => {
                if let Some(&[low, high, register]) = body.first_chunk() {
                    let code = u16::from_le_bytes([low, high]);
                    self.emergencies.push(Emergency { code, register, frame });
                }
            }
            Service::SDO_REQUEST | Service::SDO_RESPONSE => {
                self.took(at);
                self.answer(body, frame);
            }
            _ => {}
        }
    }

    /// The answer to the pending request has come.
    fn took(&mut self, at: Duration) {
        let Some(Pending { object, frame, at: sent, in_init, .. }) = self.pending else { return };
        let took = at.saturating_sub(sent);
        if self.slowest.is_none_or(|slowest| slowest.took < took) {
            self.slowest = Some(Taken { object, frame, took });
        }
        if in_init && took >= LATE {
            self.early.push(Known { value: object, frame });
        }
    }

    /// The device was asked for INIT, where no mailbox answers.
    pub fn close(&mut self) {
        self.pending = None;
    }

    /// Forgets the events so far.
    pub fn forget(&mut self) {
        self.early = Log::new(64);
        self.slowest = None;
    }

    /// The request that nothing answers, though the MainDevice looked for the answer again and
    /// again, until it gave up; how long it did so. `last`: the end of the capture.
    pub fn stalled(&self, last: Duration) -> Option<Taken> {
        let pending = self.pending.as_ref().filter(|one| one.looks >= LOOKS && !one.in_init)?;
        let took = pending.looked_at.saturating_sub(pending.at);
        let gave_up = last.saturating_sub(pending.looked_at) >= GIVEN_UP || took >= PATIENT;
        let stalled = Taken { object: pending.object, frame: pending.frame, took };
        Some(stalled).filter(|_| took >= STALLED && gave_up)
    }

    fn answer(&mut self, body: &[u8], frame: usize) {
        let Some(initiate) = body.first_chunk().map(sdo::Initiate::parse) else { return };
        let specifier = initiate.command.specifier();
        if specifier == sdo::specifier::ABORT {
            let pending = self.pending.take();
            let pending = pending.filter(|pending| pending.object.index == initiate.object.index);
            self.aborts.push(Aborted {
                object: initiate.object,
                way: pending.as_ref().map_or(Way::Read, |pending| pending.way),
                code: AbortCode(initiate.value()),
                request: pending.map(|pending| pending.frame),
                frame,
            });
            return;
        }
        let (way, bytes) = match specifier {
            sdo::specifier::RESPONSE_UPLOAD => (Way::Read, initiate_data(&initiate, body)),
            sdo::specifier::RESPONSE_DOWNLOAD => (Way::Written, Vec::new()),
            _ => return,
        };
        let same = |pending: &Pending| pending.way == way && pending.object == initiate.object;
        let pending = self.pending.take().filter(same);
        self.transfers += 1;
        let complete = initiate.command.complete() || pending.as_ref().is_some_and(|p| p.complete);
        let bytes = match way {
            Way::Read => bytes,
            Way::Written => pending.map_or(Vec::new(), |pending| pending.bytes),
        };
        self.keep(initiate.object, complete, Entry { way, bytes }, frame);
    }

    fn keep(&mut self, object: ObjectAddress, complete: bool, entry: Entry, frame: usize) {
        if complete {
            for (sub, place) in parts_of_sync_object(object, &entry.bytes) {
                let part = Entry { way: entry.way, bytes: entry.bytes[place].to_vec() };
                self.keep(ObjectAddress::new(object.index, sub), false, part, frame);
            }
            return;
        }
        if entry.bytes.is_empty() || entry.bytes.len() > MOST_BYTES {
            return;
        }
        if self.values.len() < MOST_VALUES || self.values.contains_key(&object) {
            self.values.insert(object, Known { value: entry, frame });
        }
    }

    /// The last known value of an entry, as a number.
    pub fn number(&self, object: ObjectAddress) -> Option<Known<u64>> {
        let known = self.values.get(&object)?;
        Some(Known { value: known.value.number()?, frame: known.frame })
    }
}

/// The entries of a whole 0x1C32 or 0x1C33, as sub-index and bytes. Only entries whose places are
/// the same in all layouts in the field are taken; the oldest layout differs, is shorter and is
/// left alone.
fn parts_of_sync_object(object: ObjectAddress, bytes: &[u8]) -> Vec<(u8, std::ops::Range<usize>)> {
    let is_sync = matches!(
        object.index,
        isocat_sync::object::OUTPUT_PARAMETER | isocat_sync::object::INPUT_PARAMETER
    );
    if !is_sync || object.sub != 0 || bytes.len() < SHORTEST_COMPLETE {
        return Vec::new();
    }
    let places = [(1, 2, 2), (2, 4, 4), (3, 8, 4), (4, 12, 2), (5, 14, 4), (6, 18, 4), (9, 28, 4)];
    let more = [(0x0A, 32, 4), (0x0B, 36, 2), (0x0C, 38, 2), (0x0D, 40, 2)];
    let all = places.into_iter().chain(more);
    all.map(|(sub, at, len)| (sub, at..at + len)).collect()
}

/// The data of an initiate message: in its eight bytes, or after them.
fn initiate_data(initiate: &sdo::Initiate, body: &[u8]) -> Vec<u8> {
    if initiate.command.expedited() {
        let len = match initiate.command.size_indicated() {
            true => initiate.command.expedited_len().min(4),
            false => 4,
        };
        return initiate.data[..len].to_vec();
    }
    let len = usize::try_from(initiate.value()).unwrap_or(usize::MAX);
    // Segmented transfers are not put together.
    body.get(sdo::INITIATE_LEN..)
        .and_then(|data| data.get(..len))
        .map_or(Vec::new(), |data| data[..len.min(MOST_BYTES + 1)].to_vec())
}

/// The service and the bytes after the CoE header, within the length in the mailbox header.
fn coe_message(data: &[u8], header: mailbox::Header) -> Option<(Service, &[u8])> {
    let end = (mailbox::HEADER_LEN + usize::from(header.length)).min(data.len());
    let message = data.get(mailbox::HEADER_LEN..end)?;
    let service = coe::Header::parse(*message.first_chunk()?).service;
    Some((service, message.get(coe::HEADER_LEN..)?))
}

/// Whether bytes look like a CoE message: lengths agree, and the service and its command are known.
fn fits(data: &[u8]) -> bool {
    let Some(header) = data.first_chunk().map(mailbox::Header::parse) else { return false };
    let length = usize::from(header.length);
    if header.protocol != Protocol::COE || length < 10 || mailbox::HEADER_LEN + length > data.len()
    {
        return false;
    }
    let Some((service, body)) = coe_message(data, header) else { return false };
    let specifier = body.first().map(|byte| byte >> 5);
    matches!(service, Service::SDO_REQUEST | Service::SDO_RESPONSE)
        && specifier.is_some_and(|specifier| specifier <= sdo::specifier::ABORT)
}

/// How long an answer takes that a device gives as soon as it is in PREOP.
const LATE: Duration = Duration::from_millis(100);
/// How long, and how often at least, a MainDevice looks for an answer that does not come.
const STALLED: Duration = Duration::from_secs(1);
const LOOKS: u64 = 8;
/// Time without a look at the end, or with looks in all, after which none is to come: storing
/// parameters takes some seconds.
const GIVEN_UP: Duration = Duration::from_millis(500);
const PATIENT: Duration = Duration::from_secs(10);
/// From the first register of a SyncManager to its status.
const STATUS: u16 = 5;
/// Bytes of an entry that are kept.
const MOST_BYTES: usize = 64;
/// Entries of one device that are kept.
const MOST_VALUES: usize = 4096;
/// Bytes of a whole 0x1C32 with all entries up to 0D in their usual places.
const SHORTEST_COMPLETE: usize = 43;
