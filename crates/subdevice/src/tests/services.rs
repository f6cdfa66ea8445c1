//! Protocols of the mailbox that the device announces without content, and those that it does not
//! announce.

use std::boxed::Box;
use std::vec::Vec;

use isocat_wire::mailbox::{ErrorDetail, Protocol};
use isocat_wire::{AlState, aoe};

use super::bench::Bench;
use super::device::description;
use crate::Speaks;

/// AoE, EoE, FoE, SoE and VoE in addition to CoE.
const ALL: u16 = 0x3F;

fn bench(protocols: u16) -> Bench {
    let mut device = description(|_| {}).clone();
    let mailbox = device.mailbox.as_mut().expect("it has a mailbox");
    mailbox.speaks = Speaks { protocols, ..Speaks::COE };
    Bench::in_state(Box::leak(Box::new(device)), AlState::PreOp)
}

/// The answer to a request; `None` if there is none.
fn ask(bench: &mut Bench, protocol: Protocol, body: &[u8]) -> Option<(Protocol, Vec<u8>)> {
    bench.send(protocol, body);
    bench.poll();
    let answer = bench.receive().map(|(header, body)| (header.protocol, body));
    bench.poll();
    answer
}

fn error(detail: ErrorDetail) -> Option<(Protocol, Vec<u8>)> {
    Some((Protocol::ERROR, detail.emit().to_vec()))
}

#[test]
fn what_is_not_announced_is_not_supported() {
    let [aoe, eoe, coe, foe, soe, voe] =
        [Protocol::AOE, Protocol::EOE, Protocol::COE, Protocol::FOE, Protocol::SOE, Protocol::VOE];
    let all = [aoe, eoe, coe, foe, soe, voe];
    for (bit, own) in all.into_iter().enumerate() {
        assert_eq!(own.announcement(), 1 << bit);
        let mut bench = bench(ALL & !own.announcement());
        for asked in all {
            let answer = ask(&mut bench, asked, &[0; 40]);
            let refused = error(ErrorDetail::UNSUPPORTED_PROTOCOL);
            assert_eq!(answer == refused, asked == own, "{asked:?} of a device without {own:?}");
        }
        for reserved in [6, 7, 14] {
            let answer = ask(&mut bench, Protocol(reserved), &[0; 4]);
            assert_eq!(answer, error(ErrorDetail::UNSUPPORTED_PROTOCOL));
        }
    }
}

/// ETG.1000.6, FoE: opcode 5, a reserved byte, the code, a text.
#[test]
fn files_are_not_found_and_not_taken() {
    let mut bench = bench(ALL);
    let request = |opcode| [opcode, 0, 0, 0, 0, 0, b'f', b'w'];
    for (opcode, code) in [(1, 0x01), (2, 0x02), (3, 0x04), (4, 0x04), (6, 0x04), (0, 0x04)] {
        let answer = ask(&mut bench, Protocol::FOE, &request(opcode));
        let expected = [&[5, 0, code, 0x80, 0, 0], &b"no files"[..]].concat();
        assert_eq!(answer, Some((Protocol::FOE, expected)), "opcode {opcode}");
    }
    assert_eq!(ask(&mut bench, Protocol::FOE, &request(5)), None, "an error wants no answer");
    let short = ask(&mut bench, Protocol::FOE, &[1, 0, 0, 0, 0]);
    assert_eq!(short, error(ErrorDetail::SIZE_TOO_SHORT));
}

#[test]
fn a_port_has_no_address_and_no_filter() {
    let mut bench = bench(ALL);
    for (asked, answered, outcome) in
        [(2, 3, 0x0201u16), (6, 7, 0x0201), (4, 5, 0x0401), (8, 9, 0x0401)]
    {
        let [low, high] = outcome.to_le_bytes();
        let answer = ask(&mut bench, Protocol::EOE, &[0x10 | asked, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(answer, Some((Protocol::EOE, [0x10 | answered, 1, low, high].to_vec())));
        assert_eq!(ask(&mut bench, Protocol::EOE, &[answered, 1, 0, 0]), None, "an answer");
    }
    for frame in [0, 1, 10] {
        let answer = ask(&mut bench, Protocol::EOE, &[frame, 1, 0, 0]);
        assert_eq!(answer, error(ErrorDetail::SERVICE_NOT_SUPPORTED));
    }
    let short = ask(&mut bench, Protocol::EOE, &[2, 1, 0]);
    assert_eq!(short, error(ErrorDetail::SIZE_TOO_SHORT));
}

#[test]
fn nothing_listens_at_an_ads_port() {
    let mut bench = bench(ALL);
    let request = aoe::Header {
        target: [5, 1, 2, 3, 4, 5, 0x10, 0x27],
        source: [5, 9, 9, 9, 1, 1, 1, 0x80],
        command: 1,
        flags: 4,
        length: 0,
        error: 0,
        invoke: 0x1234_5678,
    };
    let (protocol, body) = ask(&mut bench, Protocol::AOE, &request.emit()).expect("an answer");
    assert_eq!(protocol, Protocol::AOE);
    let answer = aoe::Header::parse(body.first_chunk().expect("a header"));
    assert_eq!((answer.target, answer.source), (request.source, request.target));
    assert_eq!((answer.flags, answer.error, answer.invoke), (5, 6, 0x1234_5678));
    assert_eq!(ask(&mut bench, Protocol::AOE, &answer.emit()), None, "an answer wants none");
    let short = ask(&mut bench, Protocol::AOE, &request.emit()[..31]);
    assert_eq!(short, error(ErrorDetail::SIZE_TOO_SHORT));
}

#[test]
fn what_has_no_error_of_its_own_gets_one_of_the_mailbox() {
    let mut bench = bench(ALL);
    let answer = ask(&mut bench, Protocol::VOE, &[1, 2, 3, 4, 5, 6]);
    assert_eq!(answer, error(ErrorDetail::SERVICE_NOT_SUPPORTED));
}
