//! SoE: parameters of drives, element by element, in fragments, and all its errors.

use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use isocat_wire::AlState;
use isocat_wire::mailbox::{ErrorDetail, Protocol};
use isocat_wire::soe::{Attribute, Elements, ErrorCode, Header, Idn, Opcode};

use super::bench::Bench;
use super::device::description;
use crate::{Parameter, Speaks};

/// A list of IDNs, longer than a mailbox of 64 bytes.
const LIST: u16 = 17;
/// Most bytes of the list.
const ROOM: u16 = 200;
/// Bytes of a value in one message to the device.
const PART: usize = 64 - 6 - 4;

fn attribute(bytes: usize) -> Attribute {
    Attribute::of_length(bytes).expect("a length of SoE")
}

fn bench() -> Bench {
    bench_in(AlState::PreOp)
}

fn bench_in(state: AlState) -> Bench {
    let writable = Attribute::PROTECTED_SAFEOP.with(Attribute::PROTECTED_OP);
    let parameter = |drive, idn, bytes: usize, store, default| Parameter {
        drive,
        idn: Idn(idn),
        name: "",
        attribute: attribute(bytes).with(writable),
        fixed: false,
        store,
        len: bytes as u16,
        default,
    };
    let mut list = vec![4, 0, ROOM as u8, 0, 1, 0, 17, 0];
    list.resize(usize::from(ROOM) + 4, 0);
    let list = Parameter {
        attribute: attribute(2).with(Attribute::LIST).with(Attribute::IDN),
        len: ROOM + 4,
        ..parameter(0, LIST, 2, 2, Vec::leak(list))
    };
    let parameters = vec![
        Parameter { name: "Cycle", ..parameter(0, 1, 2, 0, &[0xD0, 0x07]) },
        list,
        Parameter { fixed: true, ..parameter(0, 24, 2, 300, &[7, 0]) },
        Parameter {
            attribute: attribute(4).with(Attribute::READ_ONLY),
            ..parameter(0, 51, 4, 302, &[1, 2, 3, 4])
        },
        parameter(1, 1, 8, 306, &[]),
    ];
    let mut device = description(|_| {}).clone();
    let mailbox = device.mailbox.as_mut().expect("it has a mailbox");
    mailbox.speaks = Speaks { protocols: 0x14, drives: 2, parameters: Vec::leak(parameters) };
    Bench::in_state(Box::leak(Box::new(device)), state)
}

/// Reads elements; returns all fragments of the answer together.
fn read(bench: &mut Bench, drive: u8, idn: u16, elements: Elements) -> Result<Vec<u8>, ErrorCode> {
    let request = Header::new(Opcode::READ_REQUEST, drive, elements, Idn(idn));
    bench.send(Protocol::SOE, &request.emit());
    bench.poll();
    let mut all = Vec::new();
    let mut left = None;
    loop {
        let (mailbox, body) = bench.receive().expect("an answer");
        assert_eq!(mailbox.protocol, Protocol::SOE);
        bench.poll();
        let (head, data) = body.split_first_chunk().expect("a header");
        let header = Header::parse(head);
        assert_eq!((header.opcode, header.drive), (Opcode::READ_RESPONSE, drive));
        assert_eq!(header.elements, elements);
        if header.error {
            assert_eq!((header.incomplete, header.idn), (false, Idn(idn)));
            return Err(ErrorCode(u16::from_le_bytes(data.try_into().expect("a code"))));
        }
        all.extend(data);
        if !header.incomplete {
            assert_eq!((left.unwrap_or(1), header.idn), (1, Idn(idn)));
            assert!(bench.receive().is_none(), "nothing behind the last one");
            return Ok(all);
        }
        assert_eq!(data.len(), PART);
        assert!(left.is_none_or(|left| left == header.idn.0 + 1), "they count down");
        left = Some(header.idn.0);
    }
}

fn value(bench: &mut Bench, drive: u8, idn: u16) -> Result<Vec<u8>, ErrorCode> {
    read(bench, drive, idn, Elements::VALUE)
}

/// Writes a value, in as many messages as needed.
fn write(
    bench: &mut Bench,
    drive: u8,
    idn: u16,
    elements: Elements,
    data: &[u8],
) -> Result<(), ErrorCode> {
    let mut parts: Vec<_> = data.chunks(PART).collect();
    if parts.is_empty() {
        parts.push(&[]);
    }
    for (number, part) in parts.iter().enumerate() {
        let left = parts.len() - 1 - number;
        let request = Header::new(Opcode::WRITE_REQUEST, drive, elements, Idn(idn));
        let request = match left {
            0 => request,
            _ => Header { incomplete: true, idn: Idn(left as u16), ..request },
        };
        bench.send(Protocol::SOE, &[&request.emit()[..], part].concat());
        bench.poll();
        if left > 0 {
            assert_eq!(bench.receive(), None, "only the last one is answered");
        }
    }
    let (mailbox, body) = bench.receive().expect("an answer");
    bench.poll();
    assert_eq!(mailbox.protocol, Protocol::SOE);
    let (head, code) = body.split_first_chunk().expect("a header");
    let header = Header::parse(head);
    assert_eq!((header.opcode, header.idn), (Opcode::WRITE_RESPONSE, Idn(idn)));
    assert_eq!(header.error, !code.is_empty());
    match header.error {
        true => Err(ErrorCode(u16::from_le_bytes(code.try_into().expect("a code")))),
        false => Ok(()),
    }
}

fn write_value(bench: &mut Bench, drive: u8, idn: u16, data: &[u8]) -> Result<(), ErrorCode> {
    write(bench, drive, idn, Elements::VALUE, data)
}

#[test]
fn elements_come_in_the_order_of_their_bits() {
    let mut bench = bench();
    let elements = Elements(
        Elements::DATA_STATE.0 | Elements::NAME.0 | Elements::ATTRIBUTE.0 | Elements::VALUE.0,
    );
    let expected = [
        &[0, 0][..],
        &[5, 0, 5, 0],
        b"Cycle",
        // Factor 1, two bytes, writable in PREOP only.
        &[1, 0, 0x01, 0x60],
        &[0xD0, 0x07],
    ]
    .concat();
    assert_eq!(read(&mut bench, 0, 1, elements), Ok(expected));
}

#[test]
fn what_is_written_is_kept_until_power_off() {
    let mut bench = bench();
    assert_eq!(write_value(&mut bench, 0, 1, &[0xE8, 0x03]), Ok(()));
    assert_eq!(value(&mut bench, 0, 1), Ok(vec![0xE8, 0x03]));
    assert_eq!(value(&mut bench, 1, 1), Ok(vec![0; 8]), "the other drive has its own");
    bench.device.power_off();
    assert_eq!(value_after_power_on(bench), vec![0xD0, 0x07]);
}

fn value_after_power_on(mut bench: Bench) -> Vec<u8> {
    bench.ask(AlState::Init);
    bench.ask(AlState::PreOp);
    value(&mut bench, 0, 1).expect("it is there")
}

#[test]
fn lists_go_in_fragments_both_ways() {
    let mut bench = bench();
    assert_eq!(value(&mut bench, 0, LIST), Ok(vec![4, 0, ROOM as u8, 0, 1, 0, 17, 0]));
    // One byte less than two messages, two messages, and more; and the largest list.
    for items in [2 * PART - 6, 2 * PART - 4, 2 * PART - 2, usize::from(ROOM)] {
        let mut data = vec![items as u8, 0, 0xFF, 0xFF];
        data.extend((0..items).map(|n| n as u8));
        assert_eq!(write_value(&mut bench, 0, LIST, &data), Ok(()));
        // The device determines the largest length, whatever was written.
        data[2..4].copy_from_slice(&ROOM.to_le_bytes());
        assert_eq!(value(&mut bench, 0, LIST), Ok(data));
    }
    // Shorter again: no byte of the longer list remains.
    assert_eq!(write_value(&mut bench, 0, LIST, &[2, 0, 0, 0, 9, 0]), Ok(()));
    assert_eq!(value(&mut bench, 0, LIST), Ok(vec![2, 0, ROOM as u8, 0, 9, 0]));
}

#[test]
fn lengths_at_both_sides() {
    let mut bench = bench();
    let (short, long) = (Err(ErrorCode::VALUE_TOO_SHORT), Err(ErrorCode::VALUE_TOO_LONG));
    assert_eq!(write_value(&mut bench, 0, 1, &[1]), short);
    assert_eq!(write_value(&mut bench, 0, 1, &[1, 2, 3]), long);
    assert_eq!(write_value(&mut bench, 0, 1, &[]), short);
    for (list, expected) in [
        (&[2, 0, 0][..], short),
        (&[3, 0, 0, 0, 1, 2, 3], short),
        (&[4, 0, 0, 0, 1, 2], short),
        (&[2, 0, 0, 0, 1, 2, 3], long),
    ] {
        assert_eq!(write_value(&mut bench, 0, LIST, list), expected, "{list:?}");
    }
    let mut list = vec![0; usize::from(ROOM) + 6];
    list[..2].copy_from_slice(&(ROOM + 2).to_le_bytes());
    assert_eq!(write_value(&mut bench, 0, LIST, &list), long);
    // More than fits into memory, which is reported after the last fragment.
    assert_eq!(write_value(&mut bench, 0, LIST, &[0; 1025]), long);
    assert_eq!(value(&mut bench, 0, 1), Ok(vec![0xD0, 0x07]), "nothing was written");
}

#[test]
fn what_is_not_there_is_named() {
    let mut bench = bench();
    assert_eq!(value(&mut bench, 0, 2), Err(ErrorCode::NO_IDN));
    assert_eq!(write_value(&mut bench, 0, 2, &[0, 0]), Err(ErrorCode::NO_IDN));
    assert_eq!(value(&mut bench, 1, 1), Ok(vec![0; 8]));
    assert_eq!(value(&mut bench, 2, 1), Err(ErrorCode::DRIVE_NUMBER));
    for (element, code) in [
        (Elements::default(), ErrorCode::NO_ELEMENT),
        (Elements::NAME, ErrorCode::NO_NAME),
        (Elements::UNIT, ErrorCode::NO_UNIT),
        (Elements::MINIMUM, ErrorCode::NO_MINIMUM),
        (Elements::MAXIMUM, ErrorCode::NO_MAXIMUM),
        (Elements::DEFAULT, ErrorCode::NO_DEFAULT),
    ] {
        assert_eq!(read(&mut bench, 1, 1, element), Err(code));
    }
}

#[test]
fn only_values_are_written_and_only_when_they_may() {
    let mut bench = bench();
    for (element, code) in [
        (Elements::default(), ErrorCode::NO_ELEMENT),
        (Elements::DATA_STATE, ErrorCode::INVALID_ELEMENT),
        (Elements::NAME, ErrorCode::NAME_READ_ONLY),
        (Elements::ATTRIBUTE, ErrorCode::ATTRIBUTE_READ_ONLY),
        (Elements::UNIT, ErrorCode::UNIT_READ_ONLY),
        (Elements::MINIMUM, ErrorCode::MINIMUM_READ_ONLY),
        (Elements::MAXIMUM, ErrorCode::MAXIMUM_READ_ONLY),
        (Elements::DEFAULT, ErrorCode::DEFAULT_READ_ONLY),
        (Elements(0x44), ErrorCode::ATTRIBUTE_READ_ONLY),
    ] {
        assert_eq!(write(&mut bench, 0, 1, element, &[1, 0]), Err(code));
    }
    assert_eq!(write_value(&mut bench, 0, 51, &[0; 4]), Err(ErrorCode::VALUE_READ_ONLY));
    // A fixed parameter can be written with its present value.
    assert_eq!(write_value(&mut bench, 0, 24, &[7, 0]), Ok(()));
    assert_eq!(write_value(&mut bench, 0, 24, &[8, 0]), Err(ErrorCode::VALUE_INVALID));
    assert_eq!(value(&mut bench, 0, 24), Ok(vec![7, 0]));
    let mut bench = bench_in(AlState::SafeOp);
    assert_eq!(write_value(&mut bench, 0, 1, &[1, 0]), Err(ErrorCode::VALUE_PROTECTED));
    assert_eq!(value(&mut bench, 0, 1), Ok(vec![0xD0, 0x07]));
}

#[test]
fn a_new_request_ends_a_transfer() {
    let mut bench = bench();
    let data: Vec<u8> = [100, 0, 0, 0].into_iter().chain(1..=100).collect();
    assert_eq!(write_value(&mut bench, 0, LIST, &data), Ok(()));
    // The first fragment of an upload, then an SDO: the rest of the upload is dropped.
    let request = Header::new(Opcode::READ_REQUEST, 0, Elements::VALUE, Idn(LIST));
    bench.send(Protocol::SOE, &request.emit());
    bench.poll();
    bench.send(Protocol::COE, &[0, 0x20, 0x40, 0x0A, 0x10, 0, 0, 0, 0, 0]);
    assert!(bench.receive().is_some());
    bench.poll();
    let rest = bench.receive().expect("the fragment that was next");
    assert_eq!(rest.0.protocol, Protocol::SOE);
    bench.poll();
    let (header, _) = bench.receive().expect("the answer to the SDO request");
    assert_eq!(header.protocol, Protocol::COE);
    bench.poll();
    // The first fragment of a download, then a whole one for the other drive, which is independent.
    let piece = Header {
        incomplete: true,
        idn: Idn(1),
        ..Header::new(Opcode::WRITE_REQUEST, 0, Elements::VALUE, Idn(0))
    };
    bench.send(Protocol::SOE, &[&piece.emit()[..], &[1; 8]].concat());
    bench.poll();
    assert_eq!(write_value(&mut bench, 1, 1, &[2; 8]), Ok(()));
    assert_eq!(value(&mut bench, 1, 1), Ok(vec![2; 8]));
}

#[test]
fn what_is_no_request_is_refused() {
    let mut bench = bench();
    for (body, detail) in [
        (&[1, 0x40, 1][..], ErrorDetail::SIZE_TOO_SHORT),
        (&[0, 0x40, 1, 0], ErrorDetail::SERVICE_NOT_SUPPORTED),
        (&[2, 0x40, 1, 0], ErrorDetail::SERVICE_NOT_SUPPORTED),
        (&[7, 0x40, 1, 0], ErrorDetail::SERVICE_NOT_SUPPORTED),
    ] {
        bench.send(Protocol::SOE, body);
        bench.poll();
        let (header, answer) = bench.receive().expect("an answer");
        bench.poll();
        assert_eq!(header.protocol, Protocol::ERROR);
        assert_eq!(answer, detail.emit());
    }
}
