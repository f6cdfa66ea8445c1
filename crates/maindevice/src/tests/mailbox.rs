//! A device with a mailbox and a few objects, and the mailbox and CoE services on it.

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use std::string::ToString;
use std::vec;

use isocat_wire::mailbox::{Header, Protocol, next_counter};
use isocat_wire::sii::MailboxArea;
use isocat_wire::time::Nanos;
use isocat_wire::{AbortCode, ObjectAddress};

use super::{Bench, STATION};
use crate::coe;
use crate::error::{MailboxError, SdoError};
use crate::event::Event;
use crate::mailbox::Mailbox;

const RECEIVE: MailboxArea = MailboxArea { start: 0x1000, length: 48 };
const SEND: MailboxArea = MailboxArea { start: 0x1080, length: 48 };
/// An object of 100 bytes; all others are aborted.
const LONG: ObjectAddress = ObjectAddress::new(0x2000, 0);
/// An object of 4 bytes.
const SHORT: ObjectAddress = ObjectAddress::new(0x2001, 1);
/// An object of 20 bytes: normal transfer.
const NORMAL: ObjectAddress = ObjectAddress::new(0x2002, 0);

/// SM0 and SM1 with a small CoE server behind them.
#[derive(Default)]
pub(crate) struct FakeMailbox {
    /// Messages before the next answer, with their protocol.
    pub before: VecDeque<(Protocol, Vec<u8>)>,
    /// Whether services get no answer.
    pub silent: bool,
    /// Whether a write that ends before the area opens no buffer, so that the last byte is refused.
    pub whole_only: bool,
    /// Requests that reached the server.
    pub requests: Vec<Vec<u8>>,
    pub written: Vec<u8>,
    /// The data that opened SM0, until its last byte is written.
    open: Option<Vec<u8>>,
    /// Bytes written to SM0.
    pub bytes: usize,
    full: Option<Vec<u8>>,
    waiting: VecDeque<Vec<u8>>,
    last: Vec<u8>,
    repeat: u8,
    counter: u8,
    last_request: u8,
    rest: Vec<u8>,
    toggle: u8,
}

impl FakeMailbox {
    pub fn read(&mut self, at: usize, data: &mut [u8]) -> Option<bool> {
        match at {
            0x080D => data[0] = if self.full.is_some() { 0x08 } else { 0 },
            0x080F => data[0] = self.repeat,
            0x1080 => match self.full.take() {
                Some(message) => {
                    data.fill(0);
                    data[..message.len()].copy_from_slice(&message);
                    self.last = message;
                    self.full = self.waiting.pop_front();
                }
                None => return Some(false),
            },
            _ => return None,
        }
        Some(true)
    }

    pub fn write(&mut self, at: usize, data: &[u8]) -> Option<bool> {
        match at {
            0x080E => {
                self.repeat = data[0] & 2;
                if let Some(newer) = self.full.replace(self.last.clone()) {
                    self.waiting.push_front(newer);
                }
            }
            0x1000 if data.len() < 48 => {
                self.open = Some(data.to_vec()).filter(|_| !self.whole_only);
                self.bytes += data.len();
            }
            0x1000 => {
                self.bytes += data.len();
                self.take(data);
            }
            0x102F => {
                let Some(head) = self.open.take() else { return Some(false) };
                self.bytes += 1;
                self.take(&head);
            }
            _ => return None,
        }
        Some(true)
    }

    fn take(&mut self, message: &[u8]) {
        let header = Header::parse(message.first_chunk().unwrap());
        if header.counter != self.last_request {
            self.last_request = header.counter;
            self.serve(&message[6..6 + usize::from(header.length)]);
        }
    }

    fn put(&mut self, protocol: Protocol, service: &[u8]) {
        self.counter = next_counter(self.counter);
        let mut message = Vec::new();
        let header = Header::new(service.len() as u16, 0, protocol, self.counter);
        message.extend_from_slice(&header.emit());
        message.extend_from_slice(service);
        if self.full.is_none() {
            self.full = Some(message);
        } else {
            self.waiting.push_back(message);
        }
    }

    fn serve(&mut self, service: &[u8]) {
        self.requests.push(service.to_vec());
        while let Some((protocol, message)) = self.before.pop_front() {
            self.put(protocol, &message);
        }
        if self.silent {
            return;
        }
        if service[1] == 0x80 {
            // SDO information in two fragments that divide the name.
            let object = [0x84, 0, 1, 0, service[6], service[7], 0x29, 0, 32, 9, b'S', b'M'];
            self.put(Protocol::COE, &[&[0, 0x80][..], &object].concat());
            self.put(Protocol::COE, &[0, 0x80, 4, 0, 0, 0, b' ', b'o', b'u', b't']);
            return;
        }
        let answer = self.sdo(&service[2..]);
        let kind = if answer[0] == 0x80 { 0x20 } else { 0x30 };
        self.put(Protocol::COE, &[&[0, kind][..], &answer].concat());
    }

    fn sdo(&mut self, request: &[u8]) -> Vec<u8> {
        let command = request[0];
        let place = || request[1..4].to_vec();
        let object = ObjectAddress::new(
            u16::from_le_bytes([request[1], *request.get(2).unwrap_or(&0)]),
            *request.get(3).unwrap_or(&0),
        );
        match command >> 5 {
            2 => {
                let size = match object {
                    LONG => 100u32,
                    NORMAL => 20,
                    SHORT => return [&[0x43][..], &place(), &[1, 2, 3, 4]].concat(),
                    _ => return [&[0x80][..], &place(), &0x0602_0000u32.to_le_bytes()].concat(),
                };
                let all: Vec<u8> = (0..size as u8).collect();
                // 48 bytes less mailbox, CoE and initiate headers.
                let part = all.len().min(48 - 6 - 2 - 8);
                self.rest = all[part..].to_vec();
                self.toggle = 0;
                [&[0x41][..], &place(), &size.to_le_bytes(), &all[..part]].concat()
            }
            3 => {
                let part = self.rest.len().min(48 - 6 - 2 - 1);
                let data: Vec<u8> = self.rest.drain(..part).collect();
                let unused = 7usize.saturating_sub(part);
                let last = u8::from(self.rest.is_empty());
                let mut answer = vec![self.toggle << 4 | (unused as u8) << 1 | last];
                answer.extend_from_slice(&data);
                answer.resize(answer.len().max(8), 0);
                self.toggle ^= 1;
                answer
            }
            1 => {
                self.written = if command & 2 != 0 {
                    request[4..4 + usize::from(4 - (command >> 2 & 3))].to_vec()
                } else {
                    request[8..].to_vec()
                };
                [&[0x60][..], &place(), &[0; 4]].concat()
            }
            0 => {
                let unused = if request.len() == 8 { usize::from(command >> 1 & 7) } else { 0 };
                self.written.extend_from_slice(&request[1..request.len() - unused]);
                vec![0x20 | command & 0x10, 0, 0, 0, 0, 0, 0, 0]
            }
            _ => vec![0x80, 0, 0, 0, 1, 0, 4, 5],
        }
    }
}

fn bench() -> (Bench, Mailbox) {
    let mut bench = Bench::new(1);
    bench.segment.escs[0].mailbox = Some(FakeMailbox::default());
    let mailbox = Mailbox::new(&bench.link, 0, STATION, (RECEIVE, SEND), Nanos::millis(50));
    (bench, mailbox)
}

fn server(bench: &mut Bench) -> &mut FakeMailbox {
    bench.segment.escs[0].mailbox.as_mut().unwrap()
}

#[test]
fn uploads_of_every_length() {
    let (mut bench, mut mailbox) = bench();
    for (object, len) in [(SHORT, 4), (NORMAL, 20), (LONG, 100)] {
        let data = bench.run(coe::upload(&mut mailbox, object, false)).unwrap();
        assert_eq!(data.len(), len, "{object}");
        assert!(data.iter().zip(0..).all(|(byte, i)| *byte == i || object == SHORT));
    }
    // 32 bytes come with the first answer, 39 with each segment.
    assert_eq!(server(&mut bench).requests.len(), 1 + 1 + 3);
}

#[test]
fn downloads_of_every_length() {
    let (mut bench, mut mailbox) = bench();
    for len in [1usize, 4, 5, 32, 33, 39, 100] {
        let data: Vec<u8> = (0..len as u8).collect();
        bench.run(coe::download(&mut mailbox, LONG, &data, false)).unwrap();
        assert_eq!(server(&mut bench).written, data);
    }
}

#[test]
fn an_abort_is_an_error_with_its_code() {
    let (mut bench, mut mailbox) = bench();
    let nothing = ObjectAddress::new(0x3000, 0);
    let error = bench.run(coe::upload(&mut mailbox, nothing, false)).unwrap_err();
    assert_eq!(error, SdoError::Abort(AbortCode::NO_OBJECT));
    assert_eq!(error.to_string(), "abort 0x06020000 (object does not exist)");
}

#[test]
fn emergencies_and_other_protocols_do_not_disturb() {
    let (mut bench, mut mailbox) = bench();
    let emergency = vec![0, 0x10, 0x34, 0x12, 0x81, 1, 2, 3, 4, 5];
    server(&mut bench).before.push_back((Protocol::COE, emergency));
    server(&mut bench).before.push_back((Protocol::EOE, vec![0; 20]));
    assert_eq!(bench.run(coe::upload(&mut mailbox, SHORT, false)), Ok(vec![1, 2, 3, 4]));
    let event =
        Event::Emergency { position: 0, code: 0x1234, register: 0x81, data: [1, 2, 3, 4, 5] };
    assert_eq!(bench.events(), [event]);
}

#[test]
fn a_mailbox_error_ends_the_service() {
    let (mut bench, mut mailbox) = bench();
    server(&mut bench).before.push_back((Protocol::ERROR, vec![1, 0, 2, 0]));
    let error = bench.run(coe::upload(&mut mailbox, SHORT, false)).unwrap_err();
    assert_eq!(error.to_string(), "mailbox error 2 (protocol not supported)");
    // The answer that came after it is not taken for that of the next request.
    assert_eq!(bench.run(coe::upload(&mut mailbox, NORMAL, false)).unwrap().len(), 20);
}

#[test]
fn a_silent_device_is_given_up() {
    let (mut bench, mut mailbox) = bench();
    server(&mut bench).silent = true;
    let error = bench.run(coe::upload(&mut mailbox, SHORT, false)).unwrap_err();
    let after = Nanos::millis(50);
    assert_eq!(error, SdoError::Mailbox(MailboxError::NoAnswer { after }));
}

/// Each frame of an upload is lost once, on its way there or back: the request reaches the server
/// once, and the answer is right.
#[test]
fn any_lost_frame_is_healed() {
    let (mut whole, mut mailbox) = bench();
    whole.run(coe::upload(&mut mailbox, SHORT, false)).unwrap();
    let frames = whole.frames.len() as u64;
    assert!(frames >= 4, "drain, request, poll, answer");
    for back in [false, true] {
        for lost in 0..frames {
            let (mut bench, mut mailbox) = bench();
            if back {
                bench.lose_back = vec![lost];
            } else {
                bench.lose = vec![lost];
            }
            let data = bench.run(coe::upload(&mut mailbox, SHORT, false));
            assert_eq!(data, Ok(vec![1, 2, 3, 4]), "frame {lost} back {back}");
            assert_eq!(server(&mut bench).requests.len(), 1, "frame {lost} back {back}");
        }
    }
}

#[test]
fn descriptions_in_fragments_are_put_together() {
    let (mut bench, mut mailbox) = bench();
    let (description, name) = bench.run(coe::object_description(&mut mailbox, 0x1C32)).unwrap();
    assert_eq!((description.index, description.max_sub), (0x1C32, 32));
    assert_eq!(name, "SM out");
}

/// A message that leaves 26 bytes or more of the mailbox unused is written without them. A message
/// that is one byte longer is written as long as the mailbox.
#[test]
fn unused_room_is_left_out_where_it_pays() {
    for (len, bytes) in [(6, 22 + 1), (7, 48)] {
        let (mut bench, mut mailbox) = bench();
        bench.run(mailbox.coe(&vec![0; len + 10], |_| true)).unwrap();
        assert_eq!(server(&mut bench).bytes, bytes, "{len}");
    }
}

/// A SyncManager that does not take a message in two parts gets this message and all others whole.
#[test]
fn a_mailbox_that_takes_no_parts_is_written_as_a_whole() {
    let (mut bench, mut mailbox) = bench();
    server(&mut bench).whole_only = true;
    for _ in 0..2 {
        assert_eq!(bench.run(coe::upload(&mut mailbox, SHORT, false)), Ok(vec![1, 2, 3, 4]));
    }
    assert_eq!(server(&mut bench).requests.len(), 2);
    assert_eq!(server(&mut bench).bytes, 16 + 48 + 48, "one in vain, then whole ones");
}
