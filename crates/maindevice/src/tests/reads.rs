//! Registers of several clocks, read by one batch of datagrams.

use alloc::vec::Vec;
use core::task::Poll;

use isocat_wire::StationAddress;
use isocat_wire::frame::{self, MAX_LEN};

use super::Bench;
use crate::link::Port;
use crate::quality::{Reads, Registers, ask};

const FIRST: u16 = 0x1001;

/// Asks for the registers of these clocks.
fn start(reads: &mut Reads, wanted: &[(u16, bool)], port: &mut Port) {
    let clock = |(at, (station, has_status)): (usize, &(u16, bool))| {
        (at, StationAddress(*station), *has_status)
    };
    let (clocks, datagrams) = reads.clear();
    clocks.extend(wanted.iter().enumerate().map(clock));
    clocks.iter().for_each(|clock| ask(*clock, datagrams));
    reads.start(port);
}

/// Starts the reads, waits for them, and returns the answers.
fn run(bench: &mut Bench, reads: &mut Reads, wanted: &[(u16, bool)]) -> Vec<Option<Registers>> {
    let link = bench.link.clone();
    link.with(|shared| start(reads, wanted, &mut shared.port));
    assert!(reads.are_under_way());
    bench.run(core::future::poll_fn(|_| match link.with(|shared| reads.are_back(&shared.port)) {
        true => Poll::Ready(()),
        false => Poll::Pending,
    }));
    let found = link.with(|shared| take(reads, &mut shared.port));
    assert!(!reads.are_under_way());
    found
}

/// The answers, in the order of the clocks.
fn take(reads: &mut Reads, port: &mut Port) -> Vec<Option<Registers>> {
    let mut found = Vec::new();
    let put = |found: &mut Vec<_>, at, registers| {
        assert_eq!(at, found.len());
        found.push(registers);
    };
    let tell = |found: &mut _, at, registers| put(found, at, Some(registers));
    reads.take(port, &mut found, tell, |found, at| put(found, at, None));
    found
}

/// Each answer belongs to its clock, and only with a working counter of 1. Other datagrams may
/// share the frame, before and behind.
#[test]
fn answers_are_those_of_the_clocks() {
    let mut bench = Bench::new(3);
    for (esc, byte) in bench.segment.escs.iter_mut().zip([10, 20, 30]) {
        esc.memory[0x092C..0x0934].copy_from_slice(&[byte; 8]);
        esc.memory[0x0984] = byte + 1;
    }
    let nobody = 0x1009;
    let wanted = [(FIRST + 2, true), (nobody, true), (FIRST, false), (FIRST + 1, true)];
    let mut reads = Reads::default();
    for round in 0..3 {
        let link = bench.link.clone();
        let before = link.fprd(StationAddress(FIRST), 0x0130, 2);
        link.with(|shared| start(&mut reads, &wanted, &mut shared.port));
        let behind = link.fprd(StationAddress(FIRST), 0x0130, 2);
        bench.run(async {
            before.expect(1).await.unwrap();
            behind.expect(1).await.unwrap();
        });
        assert_eq!(bench.frames[round..], [2 + 7]);
        let found = link.with(|shared| take(&mut reads, &mut shared.port));
        let told = |registers: &Option<Registers>| {
            let registers = registers.as_ref()?;
            Some((registers.bytes[0], registers.activation.map(|activation| activation.0)))
        };
        let told: Vec<_> = found.iter().map(told).collect();
        assert_eq!(told, [Some((30, Some(31))), None, Some((10, None)), Some((20, Some(21)))]);
    }
    assert_eq!(bench.link.board(|board| board.statistics.datagrams), 3 * 9);
}

/// A lost frame is sent again; if all of them are lost, no clock has an answer. Reads that are
/// dropped on their way leave nothing behind.
#[test]
fn reads_that_are_lost() {
    let mut bench = Bench::new(1);
    bench.lose = std::vec![0, 1];
    let (mut reads, wanted) = (Reads::default(), [(FIRST, true), (FIRST, false)]);
    assert!(run(&mut bench, &mut reads, &wanted).iter().all(Option::is_some));
    bench.lose = std::vec![3, 4, 5];
    assert!(run(&mut bench, &mut reads, &wanted).iter().all(Option::is_none));
    assert!(run(&mut bench, &mut reads, &wanted).iter().all(Option::is_some));
    let link = bench.link.clone();
    let mut buffer = [0; MAX_LEN];
    link.with(|shared| {
        start(&mut reads, &wanted, &mut shared.port);
        let len = shared.transmit(bench.now, &mut buffer, MAX_LEN).unwrap();
        reads.end(&mut shared.port);
        assert!(!reads.are_under_way());
        assert!(shared.receive(frame::payload(&buffer[..len]).unwrap()));
        assert_eq!(shared.port.in_flight(), 0);
    });
    assert!(run(&mut bench, &mut reads, &wanted).iter().all(Option::is_some));
}

/// A frame with other datagrams is not taken for the answer.
#[test]
fn frames_of_others() {
    let link = Bench::new(1).link;
    let mut reads = Reads::default();
    let mut buffer = [0; MAX_LEN];
    let len = link.with(|shared| {
        start(&mut reads, &[(FIRST, true), (FIRST, true)], &mut shared.port);
        shared.transmit(isocat_wire::time::Time::new(0), &mut buffer, MAX_LEN).unwrap()
    });
    let payload = frame::payload(&buffer[..len]).unwrap();
    let receive = |bytes: &[u8]| link.with(|shared| shared.receive(bytes));
    let last = payload.len() - 13;
    // Station, register, length, the flag that another one follows; of the first and the last one.
    for (at, bit) in [(2, 1), (4, 1), (6, 1), (7, 0x80), (last + 2, 1), (last + 7, 0x80)] {
        let mut other = payload.to_vec();
        other[at] ^= bit;
        assert!(!receive(&other), "byte {at}");
    }
    for len in [1, 12, 20, payload.len() - 1] {
        assert!(!receive(&payload[..len]), "{len} bytes");
    }
    assert!(receive(payload) && !receive(payload));
}
