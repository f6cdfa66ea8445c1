//! Checks the invariants of a SubDevice whose mailbox gets arbitrary bytes.
//!
//! The bytes are read as a story. Stories of [`mailbox`] have messages of any form, divided, with
//! any counter, repeated. Stories of [`sdo`] have SDO requests in any order, right and wrong, while
//! the state changes. These invariants are checked:
//!
//! - nothing panics, and the stack writes only into its areas; its memory is bounded, since it does
//!   not allocate;
//! - each message that it sends is valid and in order; a request causes a bounded number of
//!   messages;
//! - an answer belongs to its request: object, toggle, announced and sent length;
//! - data of a right transfer is read back, and read-only values stay unchanged;
//! - the next right request is answered correctly.

mod device;
mod wire;

use isocat_wire::coe::sdo::{Initiate, SegmentCommand};
use isocat_wire::coe::{AbortCode, info};
use isocat_wire::mailbox::{Header, Protocol};
use isocat_wire::register;
use isocat_wire::{AlControl, AlState, Command, Nanos, ObjectAddress};

use device::{BLOB, BLOB_LEN, FIXED, INDICES, MAILBOX, RECEIVE, SEND, TEXT, TEXT_LEN};
use wire::Wire;

/// A story of mailbox messages.
pub fn mailbox(story: &[u8]) {
    let mut source = Source(story);
    let mut wire = Wire::new();
    let mut sent = vec![0; 16];
    // Whether an act may have stopped the mailbox: then INIT is needed.
    let mut disturbed = false;
    while !source.0.is_empty() {
        let act = source.byte();
        match act % 16 {
            0..=3 => {
                sent = message(&mut source);
                wire.send_raw(&sent);
            }
            4 => {
                wire.send_raw(&sent);
            }
            5 => {
                // A part of a message: it becomes a message as soon as the last byte is written.
                let start = usize::from(source.byte()) % MAILBOX;
                let len = 1 + usize::from(source.byte()) % (MAILBOX - start);
                let data: Vec<u8> = (0..len).map(|_| source.byte()).collect();
                wire.datagram(Command::Apwr, RECEIVE + start as u16, &data);
            }
            6..=8 if disturbed => {
                // A SyncManager that is off guards no memory.
                wire.datagram(Command::Aprd, SEND, &[0; MAILBOX]);
            }
            6..=8 => {
                wire.receive();
            }
            9 => {
                let start = usize::from(source.byte()) % MAILBOX;
                let len = 1 + usize::from(source.byte()) % (MAILBOX - start);
                wire.datagram(Command::Aprd, SEND + start as u16, &vec![0; len]);
                wire.forget();
            }
            10 => wire.ask_repetition(),
            11 => wire.pass(Nanos::micros(i64::from(source.byte()))),
            12 => {
                wire.control(AlControl(u16::from(source.byte() & 0x1F)));
                disturbed |= wire.state() == AlState::Init;
            }
            13 => {
                let number = usize::from(source.byte() % 2);
                wire.write(register::sm_activate(number), source.byte());
                wire.forget();
                disturbed = true;
            }
            _ => {
                disturbed |= wire.state() == AlState::Init;
                if disturbed {
                    wire.recover();
                    disturbed = false;
                }
                wire.answers();
                if source.byte() % 2 == 0 {
                    wire.repeats();
                }
            }
        }
        // The device may be slow to react.
        if act < 0xC0 {
            wire.live();
        }
    }
    if disturbed || wire.state() == AlState::Init {
        wire.recover();
    }
    wire.answers();
    wire.repeats();
    wire.answers();
    wire.memory_is_whole();
}

/// A message for SM0 that is usually valid.
fn message(source: &mut Source<'_>) -> Vec<u8> {
    let body = match source.byte() % 4 {
        0 => source.bytes(MAILBOX - 6),
        1 => vec![0, 0x80, 1, 0, 0, 0, source.byte() % 8, 0],
        _ => {
            let object = source.object();
            let [low, high] = object.index.to_le_bytes();
            vec![0, 0x20, 0x40, low, high, object.sub, 0, 0, 0, 0]
        }
    };
    let length = match source.byte() {
        kind @ 0..0xE0 => body.len() as u16 + u16::from(kind == 0),
        _ => source.word(),
    };
    let protocol = match source.byte() {
        0..0xD0 => Protocol::COE,
        other => Protocol(other & 0x0F),
    };
    let mut header = Header::new(length, 0, protocol, source.byte() % 8);
    if source.byte() >= 0xF0 {
        (header.address, header.channel) = (source.word(), source.byte() & 0x3F);
    }
    [&header.emit()[..], &body].concat()
}

/// A story of SDO requests.
pub fn sdo(story: &[u8]) {
    let mut source = Source(story);
    let mut wire = Wire::new();
    while !source.0.is_empty() {
        match source.byte() % 16 {
            0 => state(&mut wire, &mut source),
            1 => wire.exchange(),
            2 => transfer(&mut wire, &mut source),
            3 => information(&mut wire, &mut source),
            4 => {
                wire.send(&[&[0, 0x20][..], &source.bytes(MAILBOX - 8)].concat());
                wire.drain();
            }
            5 => {
                // The MainDevice does not wait for the answer.
                let body = request(&mut source);
                wire.send(&body);
            }
            6 => {
                let object = source.object();
                let code = AbortCode(u32::from(source.byte()));
                let abort = Initiate::abort(object, code).emit();
                wire.drain();
                wire.send(&[&[0, 0x20][..], &abort].concat());
                assert_eq!(wire.drain(), [], "an abort is not answered");
            }
            _ => {
                wire.drain();
                let body = request(&mut source);
                if wire.state() == AlState::Init {
                    continue;
                }
                assert!(wire.send(&body), "SM0 is empty");
                let answers = wire.drain();
                let abort = body[2] >> 5 == 4;
                assert_eq!(answers.len(), usize::from(!abort), "{body:02X?}: {answers:02X?}");
                for answer in &answers {
                    check_answer(&body, answer);
                }
            }
        }
    }
    if wire.state() == AlState::Init {
        wire.recover();
    }
    wire.answers();
    for (object, value) in FIXED {
        assert_eq!(upload(&mut wire, object, false), Ok(value.to_vec()), "{object}");
    }
    let text = upload(&mut wire, TEXT, false).expect("a text");
    assert_eq!(text.len(), TEXT_LEN);
    let other: Vec<u8> = text.iter().map(|byte| !byte).collect();
    assert_eq!(download(&mut wire, TEXT, false, &other), Ok(()));
    assert_eq!(upload(&mut wire, TEXT, false), Ok(other));
    wire.memory_is_whole();
}

/// Requests a state; often one that can be reached.
fn state(wire: &mut Wire, source: &mut Source<'_>) {
    match source.byte() % 8 {
        0 => wire.control(AlControl(source.word())),
        1 => wire.recover(),
        // A cycle comes in between, since OP waits for outputs.
        ask => {
            if wire.state() == AlState::Init {
                wire.recover();
            }
            wire.set_process_data();
            wire.control(AlControl::request_and_acknowledge(AlState::SafeOp));
            if ask > 4 {
                wire.control(AlControl::request(AlState::Op));
                wire.exchange();
            }
        }
    }
}

/// A right transfer, after any earlier acts: what is written can be read.
fn transfer(wire: &mut Wire, source: &mut Source<'_>) {
    if wire.state() == AlState::Init {
        wire.recover();
    }
    wire.drain();
    let fill = source.byte();
    let data: Vec<u8> = (0..BLOB_LEN).map(|at| fill.wrapping_add(at as u8)).collect();
    match source.byte() % 3 {
        0 => {
            assert_eq!(download(wire, BLOB, false, &data), Ok(()));
            assert_eq!(upload(wire, BLOB, false), Ok(data));
        }
        1 => {
            let array = ObjectAddress::new(0x2003, 0);
            let whole = [&[200, 0][..], &data, &[fill; 200]].concat();
            assert_eq!(download(wire, array, true, &whole), Ok(()));
            assert_eq!(upload(wire, array, true), Ok(whole.clone()));
            let one = ObjectAddress::new(0x2003, 3);
            assert_eq!(upload(wire, one, false), Ok(whole[10..14].to_vec()));
        }
        _ => {
            let refused = ObjectAddress::new(0x2004, 0);
            let result = download(wire, refused, false, &data[..4]);
            assert_eq!(result, Err(AbortCode::LOCAL_CONTROL));
            assert_eq!(upload(wire, refused, false), Ok(vec![0; 4]), "nothing is stored");
        }
    }
}

/// An information request, whose answer may take several messages.
fn information(wire: &mut Wire, source: &mut Source<'_>) {
    wire.drain();
    let object = source.object();
    let [low, high] = object.index.to_le_bytes();
    let opcode = match source.byte() {
        kind @ 0..0xC0 => [1, 3, 5][usize::from(kind) % 3],
        other => other,
    };
    let mut body = vec![0, 0x80, opcode, 0, 0, 0];
    match opcode {
        1 => body.extend([source.byte() % 8, 0]),
        3 => body.extend([low, high]),
        _ => body.extend([low, high, object.sub, source.byte()]),
    }
    // Some requests are truncated.
    if source.byte() >= 0xE0 {
        body.truncate(2 + usize::from(source.byte()) % body.len().saturating_sub(2));
    }
    if wire.state() == AlState::Init {
        return;
    }
    assert!(wire.send(&body), "SM0 is empty");
    let answers = wire.drain();
    let mut left = None;
    for (protocol, answer) in &answers {
        if *protocol == Protocol::ERROR {
            assert_eq!(answers.len(), 1);
            return;
        }
        let header = info::Header::parse(answer[2..6].try_into().expect("4 bytes"));
        let expected = left.map(|left: u16| left - 1);
        assert!(expected.is_none_or(|left| left == header.fragments_left), "{answers:02X?}");
        assert_eq!(header.incomplete, header.fragments_left > 0);
        left = Some(header.fragments_left);
    }
    assert_eq!(left, Some(0), "{body:02X?}: {answers:02X?}");
}

/// An SDO request that is usually valid: the body of a mailbox message, including the CoE header.
fn request(source: &mut Source<'_>) -> Vec<u8> {
    let object = source.object();
    let [low, high] = object.index.to_le_bytes();
    let complete = if source.byte().is_multiple_of(4) { 0x10 } else { 0 };
    let command = match source.byte() % 12 {
        0..=2 => 0x40 | complete,
        3 => 0x60,
        4 => 0x70,
        5 | 6 => 0x21 | complete,
        7 => 0x22 | complete | source.byte() & 0x0C,
        8 => 0x23 | complete | source.byte() & 0x0C,
        9 | 10 => source.byte() & 0x1F,
        _ => source.byte(),
    };
    let size = match source.byte() {
        small @ 0..0xC0 => u32::from(small),
        0xC0..0xE0 => [600, 802, 1024, 1025, 1100][usize::from(source.byte()) % 5],
        _ => u32::from(source.word()) << 16 | u32::from(source.word()),
    };
    let mut body = vec![0, 0x20, command, low, high, object.sub];
    body.extend(size.to_le_bytes());
    body.extend(source.bytes(MAILBOX - 16));
    body
}

/// Checks an answer against its request.
fn check_answer(request: &[u8], (protocol, answer): &(Protocol, Vec<u8>)) {
    let told = format!("{request:02X?} is answered by {answer:02X?}");
    assert_eq!(*protocol, Protocol::COE, "{told}");
    if answer[2] == 0x80 {
        // An abort names the object of the request, or of the transfer that it ends.
        let segment = matches!(request[2] >> 5, 0 | 3);
        assert!(segment || answer[3..6] == request[3..6], "{told}");
        return;
    }
    assert_eq!(answer[1] >> 4, 3, "{told}");
    let toggle = request[2] & 0x10;
    match request[2] >> 5 {
        // Segments have the toggle bit of their request.
        0 => assert_eq!(answer[2], 0x20 | toggle, "{told}"),
        3 => {
            assert_eq!(answer[2] & 0xF0, toggle, "{told}");
            let command = SegmentCommand(answer[2]);
            assert!(command.data_len(answer.len() - 3) <= MAILBOX, "{told}");
        }
        1 => assert_eq!((answer[2], &answer[3..6]), (0x60 | toggle, &request[3..6]), "{told}"),
        2 => {
            let initiate = Initiate::parse(answer[2..10].try_into().expect("8 bytes"));
            assert_eq!(answer[3..6], request[3..6], "{told}");
            assert_eq!(answer[2] & 0xF0, 0x40 | toggle, "{told}");
            assert!(initiate.command.size_indicated(), "{told}");
            if initiate.command.expedited() {
                assert_eq!(answer.len(), 10, "{told}");
            } else {
                assert!(answer.len() - 10 <= initiate.value() as usize, "{told}");
            }
        }
        _ => panic!("{told}; expected an abort"),
    }
}

/// Sends a request and returns its only answer.
fn ask(wire: &mut Wire, body: &[u8]) -> Result<Vec<u8>, AbortCode> {
    assert!(wire.send(&[&[0, 0x20][..], body].concat()), "SM0 is empty");
    let answers = wire.drain();
    let [(Protocol::COE, answer)] = &answers[..] else {
        panic!("{body:02X?} is answered by {answers:02X?}");
    };
    if answer[2] == 0x80 {
        let code = answer[6..10].try_into().expect("4 bytes");
        return Err(AbortCode(u32::from_le_bytes(code)));
    }
    Ok(answer[2..].to_vec())
}

/// Reads an entry or a whole object, in segments if needed.
fn upload(wire: &mut Wire, object: ObjectAddress, complete: bool) -> Result<Vec<u8>, AbortCode> {
    let [low, high] = object.index.to_le_bytes();
    let command = 0x40 | u8::from(complete) << 4;
    let answer = ask(wire, &[command, low, high, object.sub, 0, 0, 0, 0])?;
    let initiate = Initiate::parse(answer.first_chunk().expect("8 bytes"));
    if initiate.command.expedited() {
        return Ok(answer[4..][..initiate.command.expedited_len()].to_vec());
    }
    let total = initiate.value() as usize;
    let mut data = answer[8..].to_vec();
    let mut toggle = 0;
    while data.len() < total {
        let segment = ask(wire, &[0x60 | toggle, 0, 0, 0, 0, 0, 0, 0])?;
        assert_eq!(segment[0] & 0xF0, toggle, "{segment:02X?}");
        let command = SegmentCommand(segment[0]);
        data.extend(&segment[1..][..command.data_len(segment.len() - 1)]);
        assert_eq!(command.last(), data.len() == total);
        toggle ^= 0x10;
    }
    Ok(data)
}

/// Writes an entry or a whole object, in segments if needed.
fn download(
    wire: &mut Wire,
    object: ObjectAddress,
    complete: bool,
    data: &[u8],
) -> Result<(), AbortCode> {
    let [low, high] = object.index.to_le_bytes();
    let flag = u8::from(complete) << 4;
    let mut body = vec![0x21 | flag, low, high, object.sub];
    body.extend((data.len() as u32).to_le_bytes());
    let (now, later) = data.split_at(data.len().min(MAILBOX - 16));
    body.extend(now);
    ask(wire, &body)?;
    let mut toggle = 0;
    let mut segments = later.chunks(MAILBOX - 9).peekable();
    while let Some(segment) = segments.next() {
        let unused = 7usize.saturating_sub(segment.len());
        let last = u8::from(segments.peek().is_none());
        let mut body = vec![toggle | (unused as u8) << 1 | last];
        body.extend(segment);
        body.resize(body.len() + unused, 0);
        assert_eq!(ask(wire, &body)?[0], 0x20 | toggle);
        toggle ^= 0x10;
    }
    Ok(())
}

/// The remaining bytes of a story; zeros at its end.
struct Source<'a>(&'a [u8]);

impl Source<'_> {
    fn byte(&mut self) -> u8 {
        match self.0 {
            [first, rest @ ..] => {
                self.0 = rest;
                *first
            }
            [] => 0,
        }
    }

    fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// Up to `most` bytes.
    fn bytes(&mut self, most: usize) -> Vec<u8> {
        let len = usize::from(self.byte()) % (most + 1);
        (0..len).map(|_| self.byte()).collect()
    }

    /// An object that usually exists.
    fn object(&mut self) -> ObjectAddress {
        let index = match self.byte() {
            kind @ 0..0xF0 => INDICES[usize::from(kind) % INDICES.len()],
            _ => self.word(),
        };
        let sub = match self.byte() {
            kind @ 0..0xC0 => kind % 6,
            _ => self.byte(),
        };
        ObjectAddress::new(index, sub)
    }
}
