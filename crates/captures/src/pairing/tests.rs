//! Requests and answers as taps see them.

use std::time::Duration;

use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;

use super::*;

/// A broadcast read of the states: index, first octet of the source, working counter.
fn bytes(index: u8, source: u8, wkc: u8) -> Vec<u8> {
    passed(index, source, wkc, 0)
}

/// The same, counted up to a position.
fn passed(index: u8, source: u8, wkc: u8, position: u8) -> Vec<u8> {
    let mut buffer = vec![0; 60];
    let mut writer = FrameWriter::new(&mut buffer, [source, 1, 2, 3, 4, 5]);
    let data = writer.push(Command::Brd, index, Address::Broadcast(0x0130), &[0, 0]);
    let data = data.expect("room");
    writer.finish();
    buffer[data + 2] = wkc;
    buffer[data - 8] = position;
    buffer
}

fn frame(place: usize, micros: u64, bytes: Vec<u8>) -> Frame {
    let at = Duration::from_micros(micros);
    Frame { number: place + 1, at, interface: 0, sent: None, bytes }
}

/// A request and its answer, by their numbers.
type Numbers = (Option<usize>, Option<usize>);

/// Numbers of the requests and answers, and the pairing at its end.
fn paired(list: &[(u64, Vec<u8>)]) -> (Vec<Numbers>, Pairing) {
    let mut pairing = Pairing::new();
    for (place, (micros, bytes)) in list.iter().enumerate() {
        pairing.push(frame(place, *micros, bytes.clone()));
    }
    pairing.end();
    let mut numbers = Vec::new();
    while let Some(Exchange { request, answer }) = pairing.exchange() {
        numbers.push((request.map(|frame| frame.number), answer.map(|frame| frame.number)));
    }
    (numbers, pairing)
}

#[test]
fn answers_find_their_requests_in_any_order() {
    let (numbers, pairing) = paired(&[
        (0, bytes(1, 0x10, 0)),
        (1, bytes(2, 0x10, 0)),
        (30, bytes(2, 0x12, 3)),
        (31, bytes(1, 0x12, 3)),
        (40, bytes(3, 0x10, 0)),
        (50, bytes(4, 0x12, 3)),
    ]);
    let expected = [(Some(1), Some(4)), (Some(2), Some(3)), (Some(5), None), (None, Some(6))];
    assert_eq!(numbers, expected);
    let tally = pairing.tally();
    assert_eq!((tally.pairs, tally.unanswered, tally.answers_alone), (2, 1, 1));
    let tap = Tap { seen: Seen::Both, marked: true, behind: 0, interface: Some(0), ring: None };
    assert_eq!(pairing.tap(), Some(tap));
}

#[test]
fn frames_that_the_file_has_twice_are_one() {
    let (request, answer) = (bytes(1, 0x10, 0), bytes(1, 0x12, 3));
    let list = [(0, &request), (5, &request), (30, &answer), (35, &answer)];
    let (numbers, pairing) = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
    assert_eq!(numbers, [(Some(1), Some(3))]);
    assert_eq!(pairing.tally().duplicates, 2);
    // Later it is a repetition.
    let list = [(0, &request), (100, &request), (130, &answer), (235, &answer)];
    let (numbers, _) = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
    assert_eq!(numbers, [(Some(1), Some(3)), (Some(2), Some(4))]);
}

#[test]
fn without_the_mark_the_content_decides() {
    let (numbers, pairing) = paired(&[(0, bytes(1, 0x12, 0)), (9, passed(1, 0x12, 3, 3))]);
    assert_eq!(numbers, [(Some(1), Some(2))]);
    assert_eq!(pairing.tap().map(|tap| (tap.marked, tap.behind)), Some((false, 0)));
    // Repeated with a working counter of 0: no device answers.
    let (numbers, _) = paired(&[(0, bytes(1, 0x10, 0)), (900, bytes(1, 0x10, 0))]);
    assert_eq!(numbers, [(Some(1), None), (Some(2), None)]);
    // The same of a MainDevice whose own address has the mark.
    let (numbers, pairing) = paired(&[(0, bytes(1, 0x12, 0)), (900, bytes(1, 0x12, 0))]);
    assert_eq!(numbers, [(Some(1), None), (Some(2), None)]);
    assert_eq!(pairing.tap().map(|tap| tap.seen), Some(Seen::Out));
}

/// In the middle of the line all frames have the mark: the positions tell how many devices lie
/// before.
#[test]
fn a_tap_in_the_middle_of_the_line() {
    let mut list = Vec::new();
    for cycle in 0..4 {
        list.push((cycle * 1000, passed(7, 0x12, 2, 2)));
        list.push((cycle * 1000 + 9, passed(7, 0x12, 5, 5)));
    }
    let (numbers, pairing) = paired(&list);
    assert_eq!(numbers[3], (Some(7), Some(8)));
    let tap = Tap { seen: Seen::Both, marked: false, behind: 2, interface: Some(0), ring: None };
    assert_eq!(pairing.tap(), Some(tap));
}

#[test]
fn one_direction_alone() {
    let back: Vec<_> = (0..4).map(|at| (at * 1000, passed(7, 0x12, 3, 3))).collect();
    let (numbers, pairing) = paired(&back);
    assert_eq!(numbers, [(None, Some(1)), (None, Some(2)), (None, Some(3)), (None, Some(4))]);
    assert_eq!(pairing.tap().map(|tap| tap.seen), Some(Seen::Back));
    let out: Vec<_> = (0..4).map(|at| (at * 1000, bytes(7, 0x10, 0))).collect();
    let (numbers, pairing) = paired(&out);
    assert_eq!(numbers[3], (Some(4), None));
    assert_eq!(pairing.tap().map(|tap| tap.seen), Some(Seen::Out));
}

/// A cyclic frame that is lost, where all have the same index: the answers that follow stay where
/// they belong.
#[test]
fn a_lost_frame_among_others_that_look_alike() {
    let mut list = Vec::new();
    for cycle in 0..9 {
        list.push((cycle * 1000, bytes(7, 0x10, 0)));
        if cycle != 4 {
            list.push((cycle * 1000 + 30, bytes(7, 0x12, 3)));
        }
    }
    let (numbers, pairing) = paired(&list);
    assert_eq!(numbers[3..6], [(Some(7), Some(8)), (Some(9), None), (Some(10), Some(11))]);
    assert_eq!((pairing.tally().pairs, pairing.tally().unanswered), (8, 1));
}

/// At both ends of a ring each frame leaves from both ports; those of the first port come back at
/// the other one.
#[test]
fn both_ends_of_a_ring() {
    let mut pairing = Pairing::new();
    for cycle in 0..3_u64 {
        let at = |place: usize, micros, interface, bytes: Vec<u8>| Frame {
            interface,
            ..frame(place, cycle * 1000 + micros, bytes)
        };
        let mut second = bytes(7, 0x10, 0);
        second[11] = 9;
        let mut back = bytes(7, 0x12, 3);
        back[11] = 9;
        pairing.push(at(0, 0, 0, bytes(7, 0x10, 0)));
        pairing.push(at(1, 1, 1, second));
        pairing.push(at(2, 30, 1, bytes(7, 0x12, 3)));
        pairing.push(at(3, 31, 0, back));
    }
    pairing.end();
    while pairing.exchange().is_some() {}
    let tally = pairing.tally();
    assert_eq!((tally.pairs, tally.elsewhere, tally.unanswered), (3, 6, 0));
    assert!(pairing.tap().is_some_and(|tap| tap.ring == Some([0x10, 1, 2, 3, 4, 5])));
}

#[test]
fn what_is_not_ours_is_counted() {
    let mut cut = bytes(1, 0x10, 0);
    cut[22] = 0xFF;
    let mut foreign = bytes(1, 0x10, 0);
    foreign[12..14].copy_from_slice(&[0x08, 0x06]);
    let (_, pairing) = paired(&[(0, cut), (1, foreign), (2, vec![0; 7]), (3, vec![])]);
    assert_eq!((pairing.tally().broken, pairing.tally().foreign), (1, 3));
}

/// What is held does not grow with the capture, and nothing is lost on the way.
#[test]
fn memory_is_bounded() {
    let mut pairing = Pairing::new();
    let mut exchanges = 0;
    for place in 0..40_000 {
        // Nothing comes back, and no time passes.
        pairing.push(frame(place, 0, bytes(place as u8, 0x10, place as u8)));
        while pairing.exchange().is_some() {
            exchanges += 1;
        }
        assert!(pairing.waiting.len() <= MOST_WAITING && pairing.open.len() <= MOST_OPEN);
        assert!(pairing.ahead.len() <= LOOK_AHEAD);
    }
    pairing.end();
    while pairing.exchange().is_some() {
        exchanges += 1;
    }
    assert_eq!(exchanges + pairing.tally().duplicates, 40_000);
}
