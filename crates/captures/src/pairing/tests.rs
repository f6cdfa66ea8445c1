//! Pairing of requests and answers, for different taps.

use std::time::Duration;

use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;

use super::*;

/// A broadcast read of AL status: index, first octet of the source, working counter.
fn bytes(index: u8, source: u8, wkc: u8) -> Vec<u8> {
    passed(index, source, wkc, 0)
}

/// The same frame with this position in its datagram.
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

/// Pairs frames; returns the numbers of requests and answers, and the pairing at its end.
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
    let tap = pairing.tap().map(|tap| (tap.seen, tap.marked, tap.behind, tap.interface, tap.ring));
    assert_eq!(tap, Some((Seen::Both, true, 0, Some(0), None)));
}

#[test]
fn frames_that_the_file_has_twice_are_one() {
    let (request, answer) = (bytes(1, 0x10, 0), bytes(1, 0x12, 3));
    let list = [(0, &request), (5, &request), (30, &answer), (35, &answer)];
    let (numbers, pairing) = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
    assert_eq!(numbers, [(Some(1), Some(3))]);
    assert_eq!(pairing.tally().duplicates, 2);
    // Later, the same frame is a repetition.
    let list = [(0, &request), (100, &request), (130, &answer), (235, &answer)];
    let (numbers, _) = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
    assert_eq!(numbers, [(Some(1), Some(3)), (Some(2), Some(4))]);
}

/// A MainDevice whose own address has the bit of answers: an answer that comes twice is not one of
/// its requests, which leave with working counters of 0.
#[test]
fn an_answer_that_comes_twice_is_no_request() {
    let (request, answer) = (bytes(1, 0x12, 0), bytes(1, 0x12, 3));
    let list = [(0, &request), (30, &answer), (200, &answer), (1000, &request), (1030, &answer)];
    let (numbers, pairing) = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
    assert_eq!(numbers, [(Some(1), Some(2)), (None, Some(3)), (Some(4), Some(5))]);
    assert_eq!(pairing.tally().unanswered, 0);
    // If no SubDevice counts, an answer looks like its request, unless the file has directions.
    let counted = [(0, &request), (30, &answer), (1000, &request), (1030, &request)];
    for (told, pairs) in [(false, [None, None]), (true, [Some(4), None])] {
        let mut pairing = Pairing::new();
        for (place, (micros, bytes)) in counted.iter().enumerate() {
            let sent = told.then_some(place % 2 == 0);
            pairing.push(Frame { sent, ..frame(place, *micros, (*bytes).clone()) });
        }
        pairing.end();
        assert_eq!(pairing.exchange().and_then(|first| first.answer).map(|f| f.number), Some(2));
        let later = [pairing.exchange(), pairing.exchange()];
        let answers = later.map(|one| one.and_then(|one| one.answer).map(|f| f.number));
        assert_eq!(answers, pairs, "directions told: {told}");
    }
}

/// A mirror of two ports captures each frame where it comes in and where it goes out, with a VLAN
/// tag.
#[test]
fn copies_of_a_mirror_port_lie_between_other_frames() {
    let tagged = |bytes: Vec<u8>| {
        let tag = [&bytes[..12], &[0x81, 0, 0, 1], &bytes[12..]];
        tag.concat()
    };
    let mut list = Vec::new();
    for index in 0..4_u8 {
        let at = u64::from(index) * 1000;
        let (one, other) = (2 * index, 2 * index + 1);
        for (micros, bytes) in [
            (0, bytes(one, 0x10, 0)),
            (2, bytes(other, 0x10, 0)),
            (5, tagged(bytes(one, 0x10, 0))),
            (7, tagged(bytes(other, 0x10, 0))),
            (30, bytes(one, 0x12, 3)),
            (32, bytes(other, 0x12, 3)),
            (35, tagged(bytes(one, 0x12, 3))),
            (37, tagged(bytes(other, 0x12, 3))),
        ] {
            list.push((at + micros, bytes));
        }
    }
    let (_, pairing) = paired(&list);
    let Tally { pairs, duplicates, unanswered, answers_alone, .. } = pairing.tally();
    assert_eq!((pairs, duplicates, unanswered, answers_alone), (8, 16, 0, 0));
}

/// A capture of two interfaces may have an answer before its request; the stamps show their order.
#[test]
fn answers_before_their_requests() {
    let list = [
        (0, bytes(1, 0x10, 0)),
        (30, bytes(1, 0x12, 3)),
        (1030, bytes(2, 0x12, 3)),
        (1000, bytes(2, 0x10, 0)),
        (2000, bytes(3, 0x10, 0)),
        (2030, bytes(3, 0x12, 3)),
    ];
    let (numbers, pairing) = paired(&list);
    assert_eq!(numbers, [(Some(1), Some(2)), (Some(4), Some(3)), (Some(5), Some(6))]);
    assert_eq!((pairing.tally().pairs, pairing.tally().answers_alone), (3, 0));
    // The same datagrams with a later stamp are another request, whose answer is lost.
    let mut later = list.clone();
    later[3].0 = 1030;
    let (numbers, _) = paired(&later);
    assert_eq!(numbers[1..3], [(None, Some(3)), (Some(4), None)]);
    // So are those with a stamp one millisecond earlier.
    let mut before = list;
    before[3].0 = 30;
    let (numbers, _) = paired(&before);
    assert_eq!(numbers[1..3], [(None, Some(3)), (Some(4), None)]);
}

/// The clock of the capturing machine is set while a frame is on its way.
#[test]
fn stamps_that_jump_part_no_pair() {
    for jump in [-7_200_000_000_i64, 7_200_000_000] {
        let shifted = |micros: u64| (10_000_000_000_i64 + micros as i64 + jump) as u64;
        let (numbers, _) = paired(&[
            (10_000_000_000, bytes(1, 0x10, 0)),
            (shifted(30), bytes(1, 0x12, 3)),
            (shifted(1000), bytes(2, 0x10, 0)),
            (shifted(1030), bytes(2, 0x12, 3)),
        ]);
        assert_eq!(numbers, [(Some(1), Some(2)), (Some(3), Some(4))], "{jump}");
    }
}

#[test]
fn without_the_mark_the_content_decides() {
    let (numbers, pairing) = paired(&[(0, bytes(1, 0x12, 0)), (9, passed(1, 0x12, 3, 3))]);
    assert_eq!(numbers, [(Some(1), Some(2))]);
    assert_eq!(pairing.tap().map(|tap| (tap.marked, tap.behind)), Some((false, 0)));
    // Repetitions with a working counter of 0: no device answers.
    let (numbers, _) = paired(&[(0, bytes(1, 0x10, 0)), (900, bytes(1, 0x10, 0))]);
    assert_eq!(numbers, [(Some(1), None), (Some(2), None)]);
    // The same with a MainDevice whose own address has the mark.
    let (numbers, pairing) = paired(&[(0, bytes(1, 0x12, 0)), (900, bytes(1, 0x12, 0))]);
    assert_eq!(numbers, [(Some(1), None), (Some(2), None)]);
    assert_eq!(pairing.tap().map(|tap| tap.seen), Some(Seen::Out));
}

/// In the middle of the line all frames have the mark: the positions tell the number of devices
/// before the tap.
#[test]
fn a_tap_in_the_middle_of_the_line() {
    let mut list = Vec::new();
    for cycle in 0..4 {
        list.push((cycle * 1000, passed(7, 0x12, 2, 2)));
        list.push((cycle * 1000 + 9, passed(7, 0x12, 5, 5)));
    }
    let (numbers, pairing) = paired(&list);
    assert_eq!(numbers[3], (Some(7), Some(8)));
    let tap = pairing.tap().map(|tap| (tap.seen, tap.marked, tap.behind, tap.directed));
    assert_eq!(tap, Some((Seen::Both, false, 2, false)));
}

/// The tap is in the middle of the line, and all frames have the same index. If a frame is lost
/// behind the tap, the next request is not taken for its answer. A frame that no device behind the
/// tap has touched is not taken either, if it comes later than twice the usual time plus 20 us.
#[test]
fn a_frame_that_is_lost_behind_a_tap_in_the_line() {
    let line = |lost: u64, untouched_after: u64| {
        let mut list = Vec::new();
        for cycle in 0..9 {
            list.push((cycle * 1000, passed(7, 0x12, 2, 2)));
            match cycle == lost {
                false => list.push((cycle * 1000 + 9, passed(7, 0x12, 5, 5))),
                true if untouched_after == 0 => {}
                true => list.push((cycle * 1000 + untouched_after, passed(7, 0x12, 2, 2))),
            }
        }
        paired(&list)
    };
    let (numbers, pairing) = line(4, 0);
    assert_eq!(numbers[3..6], [(Some(7), Some(8)), (Some(9), None), (Some(10), Some(11))]);
    assert_eq!((pairing.tally().pairs, pairing.tally().unanswered), (8, 1));
    // The tap is at the end of the segment.
    let (numbers, _) = line(4, 38);
    assert_eq!(numbers[4..6], [(Some(9), Some(10)), (Some(11), Some(12))]);
    // Then the frame is the request, which the file has twice.
    let (numbers, pairing) = line(4, 39);
    assert_eq!(numbers[4..6], [(Some(9), None), (Some(11), Some(12))]);
    assert_eq!(pairing.tally().duplicates, 1);
}

/// A file with directions tells which frame is no answer, whatever the stamps are.
#[test]
fn directions_tell_requests_behind_a_tap_in_the_line() {
    let mut pairing = Pairing::new();
    let mut list = Vec::new();
    for cycle in 0..9_u64 {
        let at = |out: bool, bytes: Vec<u8>| Frame { sent: Some(out), ..frame(0, cycle, bytes) };
        list.push(at(true, passed(7, 0x12, 2, 2)));
        match cycle {
            4 => {}
            // No device behind the tap has touched it.
            5 => list.push(at(false, passed(7, 0x12, 2, 2))),
            _ => list.push(at(false, passed(7, 0x12, 5, 5))),
        }
    }
    for (place, one) in list.into_iter().enumerate() {
        pairing.push(Frame { number: place + 1, ..one });
    }
    pairing.end();
    let mut numbers = Vec::new();
    while let Some(Exchange { request, answer }) = pairing.exchange() {
        numbers.push((request.map(|frame| frame.number), answer.map(|frame| frame.number)));
    }
    assert_eq!(numbers[3..6], [(Some(7), Some(8)), (Some(9), Some(11)), (Some(12), Some(13))]);
    assert!(pairing.tap().is_some_and(|tap| tap.directed));
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

/// A cyclic frame is lost, and all frames have the same index: the following answers keep their
/// requests.
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

/// At both ends of a ring each frame leaves from both ports; the frames of the first port come back
/// at the other one.
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

/// Memory does not grow with the capture, and no frame is left out.
#[test]
fn memory_is_bounded() {
    let mut pairing = Pairing::new();
    let mut exchanges = 0;
    for place in 0..40_000 {
        // No frame comes back, and no time passes.
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
