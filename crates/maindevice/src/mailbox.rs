//! The mailbox of one SubDevice, MainDevice's side.
//!
//! A request is written to SM0 and the answer polled at SM1. Two losses that are not the device's
//! fault are repaired here. A request whose frame is lost is written again with the same counter,
//! so a device that already had it drops the repetition. An answer whose frame is lost has left SM1
//! all the same, so it is requested again by the repeat bit of SM1.

use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::coe;
use isocat_wire::mailbox::{self, ErrorDetail, Header, Protocol, next_counter};
use isocat_wire::register;
use isocat_wire::sii::MailboxArea;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Host, Nanos, Time};

use crate::error::{AccessError, MailboxError};
use crate::event::Event;
use crate::link::{Link, Travel};
use crate::quality;

/// One mailbox: its areas and counters.
pub(crate) struct Mailbox {
    link: Link,
    position: usize,
    station: StationAddress,
    receive: MailboxArea,
    send: MailboxArea,
    patience: Nanos,
    counter: u8,
    last_answer: u8,
    repeat: bool,
    /// Whether lists (0x1C00, assignments, mappings) are uploaded as whole objects.
    pub whole_lists: bool,
    /// Whether an earlier service was given up, so that its answer may still come.
    stale: bool,
    /// Whether requests are written as long as the mailbox, since the device did not take one in
    /// two parts.
    whole: bool,
    spent: Nanos,
}

impl Mailbox {
    /// A mailbox directly after INIT to PREOP: counters start again.
    pub fn new(
        link: &Link,
        position: usize,
        station: StationAddress,
        (receive, send): (MailboxArea, MailboxArea),
        patience: Nanos,
    ) -> Self {
        Self {
            link: link.clone(),
            position,
            station,
            receive,
            send,
            patience,
            counter: 0,
            last_answer: 0,
            repeat: false,
            whole_lists: false,
            stale: true,
            whole: false,
            spent: Nanos::ZERO,
        }
    }

    /// Wire time of all datagrams so far, as if each were in a separate frame.
    pub fn spent(&self) -> Nanos {
        self.spent
    }

    /// Most bytes of a service in a request, after the mailbox header.
    pub fn request_len(&self) -> usize {
        usize::from(self.receive.length).saturating_sub(mailbox::HEADER_LEN)
    }

    /// Sends a CoE service and waits for its CoE answer; `is_answer` recognizes it.
    pub async fn coe(
        &mut self,
        service: &[u8],
        is_answer: impl Fn(&[u8]) -> bool,
    ) -> Result<Vec<u8>, MailboxError> {
        self.ask(Protocol::COE, &[service], is_answer).await
    }

    /// Sends a request of a protocol in one or several messages, and waits for the answer in that
    /// protocol; `is_answer` recognizes it. Emergencies of CoE in between are reported as events.
    pub async fn ask(
        &mut self,
        protocol: Protocol,
        messages: &[&[u8]],
        is_answer: impl Fn(&[u8]) -> bool,
    ) -> Result<Vec<u8>, MailboxError> {
        if self.stale {
            self.drain().await?;
            self.stale = false;
        }
        // Until the answer is there, this future may be dropped and leave an answer behind.
        self.stale = true;
        for message in messages {
            self.write(protocol, message).await?;
        }
        let mut wait = Wait { end: self.deadline(), interval: POLL_FIRST };
        loop {
            let answer = self.answer(protocol, &mut wait).await?;
            if is_answer(&answer) {
                self.stale = false;
                return Ok(answer);
            }
            self.pass_over(&mut wait).await?;
        }
    }

    /// When a service that begins now must be answered.
    pub fn deadline(&self) -> Time<Host> {
        self.link.now() + self.patience
    }

    /// Waits for a further CoE message of a service that answers in several.
    pub async fn coe_more(&mut self, end: Time<Host>) -> Result<Vec<u8>, MailboxError> {
        self.answer(Protocol::COE, &mut Wait { end, interval: POLL_FIRST }).await
    }

    /// An error after `end`.
    pub fn in_time(&self, end: Time<Host>) -> Result<(), MailboxError> {
        match self.link.now() < end {
            true => Ok(()),
            false => Err(MailboxError::NoAnswer { after: self.patience }),
        }
    }

    async fn answer(
        &mut self,
        expected: Protocol,
        wait: &mut Wait,
    ) -> Result<Vec<u8>, MailboxError> {
        loop {
            let (protocol, service) = self.read(wait.end).await?;
            let emergency = protocol == Protocol::COE && self.take_emergency(&service);
            match protocol {
                _ if protocol == expected && !emergency => return Ok(service),
                Protocol::ERROR => {
                    let detail = service
                        .first_chunk()
                        .ok_or(MailboxError::Short { length: service.len() })?;
                    return Err(MailboxError::Error(ErrorDetail::parse(detail)));
                }
                // An emergency, or another protocol that speaks unasked, EoE above all.
                _ => self.pass_over(wait).await?,
            }
        }
    }

    /// Waits after a message that is not the answer, longer each time. A device that sends without
    /// end then takes no more of the wire than a silent one, and its service ends at the timeout.
    async fn pass_over(&mut self, wait: &mut Wait) -> Result<(), MailboxError> {
        self.in_time(wait.end)?;
        self.link.sleep(wait.interval).await;
        wait.interval = longer(wait.interval);
        Ok(())
    }

    /// Reports an emergency; `false` if the service is none.
    fn take_emergency(&self, service: &[u8]) -> bool {
        let Some((head, rest)) = service.split_first_chunk::<2>() else { return false };
        if coe::Header::parse(*head).service != coe::Service::EMERGENCY {
            return false;
        }
        if let Some(&[c0, c1, register, d0, d1, d2, d3, d4]) = rest.first_chunk() {
            self.link.report(Event::Emergency {
                position: self.position,
                code: u16::from_le_bytes([c0, c1]),
                register,
                data: [d0, d1, d2, d3, d4],
            });
        }
        true
    }

    /// Discards messages of an earlier service in SM1.
    async fn drain(&mut self) -> Result<(), MailboxError> {
        for _ in 0..MOST_STALE {
            if !self.is_full().await? {
                break;
            }
            let len = usize::from(self.send.length);
            self.pay(&[len]);
            let reply = self.link.fprd(self.station, self.send.start, len).reply().await?;
            if reply.wkc == 1
                && let Some(head) = reply.data.first_chunk()
            {
                self.last_answer = Header::parse(head).counter;
            }
        }
        Ok(())
    }

    async fn is_full(&mut self) -> Result<bool, AccessError> {
        self.pay(&[1]);
        let status = self.link.read(self.station, register::sm_status(1)).await?;
        Ok(status & SyncManager::STATUS_FULL != 0)
    }

    /// Writes a request into SM0, waiting until the device has taken the one before.
    async fn write(&mut self, protocol: Protocol, service: &[u8]) -> Result<(), MailboxError> {
        let length = service.len() + mailbox::HEADER_LEN;
        if service.len() > self.request_len() {
            return Err(MailboxError::TooLong { length, mailbox: self.receive.length });
        }
        self.counter = next_counter(self.counter);
        let header = Header::new(service.len() as u16, 0, protocol, self.counter);
        let mut bytes = Vec::with_capacity(usize::from(self.receive.length));
        bytes.extend_from_slice(&header.emit());
        bytes.extend_from_slice(service);
        let end = self.link.now() + self.patience;
        let mut interval = POLL_FIRST;
        // After a loss the area may be full with this very request: then it is done, see below.
        let mut lost = false;
        loop {
            match self.put(&bytes).await {
                Ok(true) => return Ok(()),
                Ok(false) if lost => return Ok(()),
                Ok(false) => {}
                Err(error) if link_is_dead(&self.link, end) => return Err(error.into()),
                // Tried again at growing intervals, so that losses with a rhythm do not meet each
                // try.
                Err(_) => lost = true,
            }
            if self.link.now() >= end {
                return Err(MailboxError::Full { after: self.patience });
            }
            self.link.sleep(interval).await;
            interval = longer(interval);
        }
    }

    /// Writes a message into SM0, once; whether it was taken.
    ///
    /// The first byte of the area opens it, and the SyncManager passes it on when the last byte is
    /// written. The bytes between them need not be written, so the room that the message leaves
    /// unused is left out where that pays. Both parts are in one frame, so that a lost frame leaves
    /// nothing half written.
    async fn put(&mut self, message: &[u8]) -> Result<bool, AccessError> {
        let length = usize::from(self.receive.length);
        let write = |address, data, with_next| {
            let travel = Travel { once: true, with_next, ..Travel::default() };
            let address = isocat_wire::datagram::Address::Station(self.station, address);
            self.link.exchange(isocat_wire::Command::Fpwr, address, data, travel)
        };
        if self.whole || length - message.len() < WORTH_LEAVING_OUT {
            let mut bytes = message.to_vec();
            bytes.resize(length, 0);
            let whole = write(self.receive.start, bytes, false);
            self.pay(&[length]);
            return Ok(whole.reply().await?.wkc == 1);
        }
        let head = write(self.receive.start, message.to_vec(), true);
        let last = write(self.receive.start + (self.receive.length - 1), alloc::vec![0], false);
        self.pay(&[message.len(), 1]);
        let (head, last) = (head.reply().await?.wkc == 1, last.reply().await?.wkc == 1);
        // A full area refuses both. An area that takes a single part does not track its bytes.
        self.whole = head != last;
        Ok(head && last)
    }

    /// Waits for one message in SM1 and takes it: protocol and service.
    async fn read(&mut self, end: Time<Host>) -> Result<(Protocol, Vec<u8>), MailboxError> {
        let mut interval = POLL_FIRST;
        loop {
            let is_full = match self.is_full().await {
                // Looked at again later: losses with a rhythm may have met each repetition.
                Err(error) if error.is_lost() && !link_is_dead(&self.link, end) => false,
                other => other?,
            };
            if is_full {
                let bytes = self.fetch(end).await?;
                if let Some(message) = self.open(&bytes)? {
                    return Ok(message);
                }
            }
            if self.link.now() >= end {
                return Err(MailboxError::NoAnswer { after: self.patience });
            }
            self.link.sleep(interval).await;
            interval = longer(interval);
        }
    }

    /// Reads the whole of SM1; after a lost frame by the repeat bit.
    async fn fetch(&mut self, end: Time<Host>) -> Result<Vec<u8>, MailboxError> {
        let mut interval = POLL_FIRST;
        loop {
            let travel = Travel { once: true, ..Travel::default() };
            let address = isocat_wire::datagram::Address::Station(self.station, self.send.start);
            let data = alloc::vec![0; usize::from(self.send.length)];
            self.pay(&[data.len()]);
            let exchange = self.link.exchange(isocat_wire::Command::Fprd, address, data, travel);
            let lost = match exchange.reply().await {
                Ok(reply) if reply.wkc == 1 => return Ok(reply.data),
                Ok(_) => false,
                Err(error) if link_is_dead(&self.link, end) => return Err(error.into()),
                Err(_) => true,
            };
            if lost && !self.is_full().await? {
                self.ask_again(end).await?;
            }
            if self.link.now() >= end {
                return Err(MailboxError::NoAnswer { after: self.patience });
            }
            self.link.sleep(interval).await;
            interval = longer(interval);
        }
    }

    /// Toggles the repeat bit of SM1 and waits for the device to follow.
    async fn ask_again(&mut self, end: Time<Host>) -> Result<(), MailboxError> {
        self.repeat = !self.repeat;
        let bit = if self.repeat { SyncManager::REPEAT } else { 0 };
        let activate = SyncManager::ENABLE | bit;
        self.pay(&[1]);
        self.link.write(self.station, register::sm_activate(1), activate).await?;
        loop {
            self.pay(&[1]);
            let control = self.link.read(self.station, register::sm_pdi_control(1)).await?;
            if control & SyncManager::REPEAT == bit {
                return Ok(());
            }
            if self.link.now() >= end {
                return Err(MailboxError::NoAnswer { after: self.patience });
            }
            self.link.sleep(POLL_FIRST).await;
        }
    }

    /// Counts a frame of datagrams with these lengths of data, bytes.
    fn pay(&mut self, lengths: &[usize]) {
        self.spent += quality::wire_time(lengths.iter().copied());
    }

    /// Takes a message apart; `None` if it repeats the last one.
    fn open(&mut self, bytes: &[u8]) -> Result<Option<(Protocol, Vec<u8>)>, MailboxError> {
        let short = MailboxError::Short { length: bytes.len() };
        let (head, rest) = bytes.split_first_chunk().ok_or(short)?;
        let header = Header::parse(head);
        let service = rest.get(..usize::from(header.length)).ok_or(short)?;
        if header.counter != 0 && header.counter == self.last_answer {
            return Ok(None);
        }
        self.last_answer = header.counter;
        Ok(Some((header.protocol, service.to_vec())))
    }
}

/// How long a service waits for its answer.
struct Wait {
    end: Time<Host>,
    /// The pause after the next message that is not the answer.
    interval: Nanos,
}

/// Whether losses have lasted so long that repeating is useless.
fn link_is_dead(link: &Link, end: Time<Host>) -> bool {
    link.now() >= end
}

fn longer(interval: Nanos) -> Nanos {
    Nanos((interval.0 * 2).min(POLL_LAST.0))
}

/// Mailboxes by position. A service takes its mailbox and puts it back.
pub(crate) type Mailboxes = Vec<Option<Mailbox>>;

/// Most messages of an earlier service that are discarded; a device that sends more never stops.
const MOST_STALE: usize = 8;
/// The least room behind a message that is left out, bytes: twice the length of the datagram of the
/// last byte.
const WORTH_LEAVING_OUT: usize = 26;
/// First interval of polling: firmware usually answers within a fraction of a millisecond.
const POLL_FIRST: Nanos = Nanos(100_000);
/// Longest interval of polling.
const POLL_LAST: Nanos = Nanos(5_000_000);
