//! The mailbox of the SubDevice under test: SDO transfers and SDO information.

use isocat_wire::coe::info::{self, EntryDescription, ObjectDescription, Opcode};
use isocat_wire::coe::sdo::{Command, INITIATE_LEN, Initiate, SegmentCommand, specifier};
use isocat_wire::coe::{self, Service};
use isocat_wire::mailbox::{ErrorDetail, HEADER_LEN, Header, Protocol, next_counter};
use isocat_wire::register;
use isocat_wire::sii::MailboxArea;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

use super::tester::{Tester, Trouble, number};

/// The two mailbox areas, and the counter of the messages that were sent.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mailbox {
    /// Towards the SubDevice, SM0.
    pub receive: MailboxArea,
    /// From the SubDevice, SM1.
    pub send: MailboxArea,
    counter: u8,
}

/// Why an SDO transfer failed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum SdoFault {
    /// The SubDevice aborted it with this code.
    Abort(AbortCode),
    /// There was no proper answer.
    Trouble(Trouble),
}

impl From<Trouble> for SdoFault {
    fn from(trouble: Trouble) -> Self {
        Self::Trouble(trouble)
    }
}

/// The result of an SDO transfer: its data, or the code of an abort.
pub type Answer<T = Vec<u8>> = Result<Result<T, AbortCode>, Trouble>;

impl Tester<'_> {
    /// Reads an entry.
    pub fn upload(&mut self, object: ObjectAddress) -> Answer {
        settle(self.try_upload(object, false))
    }

    /// Reads an object by complete access, from sub-index `first` (0 or 1) on.
    pub fn upload_complete(&mut self, index: u16, first: u8) -> Answer {
        settle(self.try_upload(ObjectAddress::new(index, first), true))
    }

    /// Reads an entry as a number; `None`: the SubDevice refused it.
    pub fn value(&mut self, object: ObjectAddress) -> Result<Option<u64>, Trouble> {
        Ok(self.upload(object)?.ok().map(|data| number(&data)))
    }

    /// The PDOs that 0x1C12 or 0x1C13 assigns.
    pub fn assignment(&mut self, index: u16) -> Result<Vec<u16>, Trouble> {
        let count = self.value(ObjectAddress::new(index, 0))?.unwrap_or(0);
        let mut pdos = Vec::new();
        for sub in 1..=count.min(254) as u8 {
            pdos.push(self.value(ObjectAddress::new(index, sub))?.unwrap_or(0) as u16);
        }
        Ok(pdos)
    }

    /// Writes an entry.
    pub fn download(&mut self, object: ObjectAddress, data: &[u8]) -> Answer<()> {
        settle(self.try_download(object, data))
    }

    /// What SDO information says about an object.
    pub fn describe_object(&mut self, index: u16) -> Answer<ObjectDescription> {
        settle(self.information(Opcode::OBJECT_REQUEST, &index.to_le_bytes()).and_then(|data| {
            let head = data.first_chunk().ok_or_else(|| short("an object description"))?;
            Ok(ObjectDescription::parse(head))
        }))
    }

    /// What SDO information says about an entry.
    pub fn describe_entry(&mut self, object: ObjectAddress) -> Answer<EntryDescription> {
        let [low, high] = object.index.to_le_bytes();
        let request = [low, high, object.sub, 0x07];
        settle(self.information(Opcode::ENTRY_REQUEST, &request).and_then(|data| {
            let head = data.first_chunk().ok_or_else(|| short("an entry description"))?;
            Ok(EntryDescription::parse(head))
        }))
    }

    fn try_upload(&mut self, object: ObjectAddress, complete: bool) -> Result<Vec<u8>, SdoFault> {
        let request = Initiate { command: Command::upload_request(complete), object, data: [0; 4] };
        let body = self.sdo(&request.emit())?;
        let reply = initiate(&body, object, specifier::RESPONSE_UPLOAD)?;
        if reply.command.expedited() {
            return Ok(reply.data[..reply.command.expedited_len()].to_vec());
        }
        let total = reply.value() as usize;
        let mut data = body[INITIATE_LEN..].to_vec();
        let mut toggle = false;
        while data.len() < total {
            let mut request = [0; INITIATE_LEN];
            request[0] = SegmentCommand::upload_request(toggle).0;
            let body = self.sdo(&request)?;
            let command = SegmentCommand(body[0]);
            if command.specifier() != specifier::RESPONSE_UPLOAD_SEGMENT
                || command.toggle() != toggle
            {
                let found = body[0];
                return Err(
                    Trouble::new(format!("{object}: segment answered by 0x{found:02X}")).into()
                );
            }
            let segment = &body[1..];
            data.extend_from_slice(&segment[..command.data_len(segment.len())]);
            toggle = !toggle;
            if command.last() {
                break;
            }
        }
        if data.len() < total {
            let found = data.len();
            return Err(
                Trouble::new(format!("{object}: {found} bytes, {total} were promised")).into()
            );
        }
        data.truncate(total);
        Ok(data)
    }

    fn try_download(&mut self, object: ObjectAddress, data: &[u8]) -> Result<(), SdoFault> {
        let mut message = Vec::with_capacity(INITIATE_LEN + data.len());
        if (1..=4).contains(&data.len()) {
            let mut inline = [0; 4];
            inline[..data.len()].copy_from_slice(data);
            let command = Command::download_expedited(data.len(), false);
            message.extend(Initiate { command, object, data: inline }.emit());
        } else {
            let command = Command::download_normal(false);
            let size = (data.len() as u32).to_le_bytes();
            message.extend(Initiate { command, object, data: size }.emit());
            message.extend_from_slice(data);
        }
        let body = self.sdo(&message)?;
        initiate(&body, object, specifier::RESPONSE_DOWNLOAD).map(|_| ())
    }

    /// Sends an SDO request; returns what follows the CoE header of the answer, at least eight
    /// bytes.
    fn sdo(&mut self, message: &[u8]) -> Result<Vec<u8>, SdoFault> {
        let (service, body) = self.converse(Service::SDO_REQUEST, message)?;
        let Some(head) = body.first_chunk::<INITIATE_LEN>() else { return Err(short("an SDO")) };
        let initiate = Initiate::parse(head);
        if initiate.command.specifier() == specifier::ABORT {
            return Err(SdoFault::Abort(AbortCode(initiate.value())));
        }
        if service != Service::SDO_RESPONSE {
            return Err(Trouble::new(format!("SDO answered by CoE service {}", service.0)).into());
        }
        Ok(body)
    }

    fn information(&mut self, opcode: Opcode, data: &[u8]) -> Result<Vec<u8>, SdoFault> {
        let header = info::Header { opcode, incomplete: false, fragments_left: 0 };
        let message = [&header.emit()[..], data].concat();
        let (_, body) = self.converse(Service::SDO_INFORMATION, &message)?;
        let Some((head, data)) = body.split_first_chunk::<{ info::HEADER_LEN }>() else {
            return Err(short("SDO information"));
        };
        if info::Header::parse(head).opcode == Opcode::ERROR {
            return Err(SdoFault::Abort(AbortCode(number(data.get(..4).unwrap_or(data)) as u32)));
        }
        Ok(data.to_vec())
    }

    /// Sends a CoE message and waits for its answer; ignores emergencies that come first.
    fn converse(&mut self, service: Service, body: &[u8]) -> Result<(Service, Vec<u8>), Trouble> {
        let areas = self.mailbox;
        self.mailbox.counter = next_counter(self.mailbox.counter);
        let length = coe::HEADER_LEN + body.len();
        let header = Header::new(length as u16, 0, Protocol::COE, self.mailbox.counter);
        let mut message = header.emit().to_vec();
        message.extend(coe::Header::new(service).emit());
        message.extend_from_slice(body);
        if message.len() > usize::from(areas.receive.length) {
            return Err(Trouble::new(format!(
                "{} bytes do not fit into a mailbox of {}",
                message.len(),
                areas.receive.length
            )));
        }
        message.resize(usize::from(areas.receive.length), 0);
        let end = self.now() + PATIENCE;
        while !self.offer(areas.receive.start, &message)? {
            if self.now() > end {
                return Err(Trouble::new("SM0: the mailbox stays full"));
            }
            self.pause(POLL)?;
        }
        let mut wait = POLL;
        loop {
            let status = self.register(register::sm_status(1))?;
            if status & SyncManager::STATUS_FULL == 0 {
                if self.now() > end {
                    return Err(Trouble::new(format!("SM1: no answer within {PATIENCE}")));
                }
                self.pause(wait)?;
                // Polls a slow SubDevice less and less often.
                wait = Nanos(wait.0 * 5 / 4).min(SLOW_POLL);
                continue;
            }
            let bytes = self.read(areas.send.start, usize::from(areas.send.length))?;
            let Some((head, rest)) = bytes.split_first_chunk::<HEADER_LEN>() else {
                return Err(Trouble::new("SM1: a mailbox without room for a header"));
            };
            let header = Header::parse(head);
            let rest = rest.get(..usize::from(header.length)).unwrap_or(rest);
            if header.protocol == Protocol::ERROR {
                let detail = rest.first_chunk().map_or(ErrorDetail(0), ErrorDetail::parse);
                return Err(Trouble::new(detail.to_string()));
            }
            let Some((coe, data)) = rest.split_first_chunk::<{ coe::HEADER_LEN }>() else {
                return Err(Trouble::new("SM1: a message without CoE header"));
            };
            let found = coe::Header::parse(*coe).service;
            if header.protocol == Protocol::COE && found != Service::EMERGENCY {
                return Ok((found, data.to_vec()));
            }
        }
    }
}

fn initiate(body: &[u8], object: ObjectAddress, wanted: u8) -> Result<Initiate, SdoFault> {
    let Some(head) = body.first_chunk::<INITIATE_LEN>() else { return Err(short("an SDO")) };
    let reply = Initiate::parse(head);
    if reply.command.specifier() == wanted && reply.object == object {
        return Ok(reply);
    }
    Err(Trouble::new(format!(
        "{object}: answered by command 0x{:02X} for {}",
        reply.command.0, reply.object
    ))
    .into())
}

fn short(what: &str) -> SdoFault {
    Trouble::new(format!("SM1: {what} that is cut off")).into()
}

fn settle<T>(result: Result<T, SdoFault>) -> Answer<T> {
    match result {
        Ok(data) => Ok(Ok(data)),
        Err(SdoFault::Abort(code)) => Ok(Err(code)),
        Err(SdoFault::Trouble(trouble)) => Err(trouble),
    }
}

/// How long to wait for an answer: longer than any rule allows, so that slowness breaks only one
/// rule.
const PATIENCE: Nanos = Nanos::millis(4_000);
/// Time between two looks at the mailbox: at first, and at most.
const POLL: Nanos = Nanos::micros(20);
const SLOW_POLL: Nanos = Nanos::millis(2);
