//! Requests with the answers that belong to them.
//!
//! The first SubDevice sets bit 1 of the source address in what it sends back. A segment that
//! leaves it alone (0x0100 bit 0 = 0), or a MainDevice whose own address has it, is paired by
//! content: an answer has the datagrams of its request, and differs from it.

use std::collections::VecDeque;

use isocat_recorders::reading::Frame;
use isocat_wire::datagram::{Header, datagrams};
use isocat_wire::frame::{self, FrameError, LOCALLY_ADMINISTERED};

/// A frame that went out, and what came back of it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Exchange {
    /// Number of the request in the file.
    pub request_number: usize,
    /// Number of the answer, and the answer; `None`: it is not in the file.
    pub answer: Option<(usize, Vec<u8>)>,
    /// When the request was seen, ns from the first frame of the file.
    pub at: u64,
    /// The request.
    pub request: Vec<u8>,
}

/// All that a capture holds, frame by frame.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Exchanges {
    /// In the order of the requests.
    pub list: Vec<Exchange>,
    /// Frames that are none of EtherCAT, or without datagrams.
    pub foreign: usize,
    /// Frames of EtherCAT whose datagrams are cut off.
    pub broken: usize,
    /// Frames that the file has twice.
    pub duplicates: usize,
    /// Frames of interfaces that are not the MainDevice's port.
    pub elsewhere: usize,
    /// Answers without a request.
    pub answers_alone: usize,
}

impl Exchanges {
    /// Pairs the frames of a capture.
    pub fn of(frames: &[Frame]) -> Self {
        let mut exchanges = Self::default();
        let mut ours = Vec::new();
        for frame in frames {
            match Signature::of(&frame.bytes) {
                Ok(signature) => ours.push((frame, signature)),
                Err(true) => exchanges.broken += 1,
                Err(false) => exchanges.foreign += 1,
            }
        }
        let marked = is_marked(&ours);
        let port = main_port(&ours, marked);
        let first = ours.first().map_or(0, |(frame, _)| nanos(frame));
        let mut open: VecDeque<Open> = VecDeque::new();
        let mut last_answer: Option<(u64, Vec<u8>)> = None;
        for (frame, signature) in ours {
            if port.is_some_and(|port| frame.interface != port) {
                exchanges.elsewhere += 1;
                continue;
            }
            let at = nanos(frame).saturating_sub(first);
            open.retain(|request| at.saturating_sub(request.at) < GIVEN_UP_NS);
            let found = open.iter().position(|request| request.signature == signature);
            match (found, marked) {
                (Some(found), _) if comes_back(frame, marked, &open[found]) => {
                    if let Some(request) = open.remove(found) {
                        exchanges.list[request.place].answer =
                            Some((frame.number, frame.bytes.clone()));
                    }
                    last_answer = Some((at, frame.bytes.clone()));
                }
                (_, true) if is_answer(&frame.bytes) => match &last_answer {
                    Some((then, bytes)) if *bytes == frame.bytes && at - then < TWICE_NS => {
                        exchanges.duplicates += 1;
                    }
                    _ => exchanges.answers_alone += 1,
                },
                (found, _) => {
                    let twice = found.is_some_and(|found| {
                        let request = &open[found];
                        at - request.at < TWICE_NS
                            && exchanges.list[request.place].request == frame.bytes
                    });
                    if twice {
                        exchanges.duplicates += 1;
                        continue;
                    }
                    let place = exchanges.list.len();
                    exchanges.list.push(Exchange {
                        request_number: frame.number,
                        answer: None,
                        at,
                        request: frame.bytes.clone(),
                    });
                    let bytes = frame.bytes.clone();
                    open.push_back(Open { place, at, signature, bytes });
                    if open.len() > MOST_OPEN {
                        open.pop_front();
                    }
                }
            }
        }
        exchanges
    }

    /// Requests whose answer is not in the file.
    pub fn unanswered(&self) -> usize {
        self.list.iter().filter(|exchange| exchange.answer.is_none()).count()
    }
}

/// A request that waits for its answer.
struct Open {
    place: usize,
    at: u64,
    signature: Signature,
    bytes: Vec<u8>,
}

/// What an answer has in common with its request: its datagrams without what ESCs change in them.
#[derive(PartialEq, Eq)]
struct Signature(Vec<(u8, u8, u32, u16)>);

impl Signature {
    /// `Err(true)`: a frame of EtherCAT whose datagrams can't be read; `Err(false)`: none of
    /// EtherCAT.
    fn of(bytes: &[u8]) -> Result<Self, bool> {
        let payload =
            frame::payload(bytes).map_err(|error| matches!(error, FrameError::Length { .. }))?;
        let mut list = Vec::new();
        for datagram in datagrams(payload) {
            let Header { command, index, address, len, .. } = datagram.map_err(|_| true)?.header;
            let known = isocat_wire::Command::try_from(command);
            let counts = known.is_ok_and(isocat_wire::Command::increments_position);
            let address = if counts { address & 0xFFFF_0000 } else { address };
            list.push((command, index, address, len));
        }
        if list.is_empty() { Err(true) } else { Ok(Self(list)) }
    }
}

fn nanos(frame: &Frame) -> u64 {
    u64::try_from(frame.at.as_nanos()).unwrap_or(u64::MAX)
}

fn is_answer(bytes: &[u8]) -> bool {
    bytes.get(SOURCE).is_some_and(|octet| octet & LOCALLY_ADMINISTERED != 0)
}

/// Whether the source addresses tell answers from requests: some pair of them differs in that bit
/// alone, or all frames are of one kind and none differs from another one with the same datagrams.
fn is_marked(frames: &[(&Frame, Signature)]) -> bool {
    let source = |frame: &Frame| frame.bytes[SOURCE..SOURCE + 6].to_vec();
    let mut asking = std::collections::BTreeSet::new();
    let mut answering = std::collections::BTreeSet::new();
    for (frame, _) in frames {
        let mut address = source(frame);
        let answers = address[0] & LOCALLY_ADMINISTERED != 0;
        address[0] |= LOCALLY_ADMINISTERED;
        if answers {
            answering.insert(address)
        } else {
            asking.insert(address)
        };
    }
    if !asking.is_disjoint(&answering) {
        return true;
    }
    // One kind only: pairs by content speak against the mark.
    !frames.windows(2).any(|pair| {
        let [(request, a), (answer, b)] = pair else { return false };
        a == b && request.bytes != answer.bytes && source(request) == source(answer)
    })
}

/// The interface of the MainDevice's port, if one interface sees both directions; else all count.
fn main_port(frames: &[(&Frame, Signature)], marked: bool) -> Option<u32> {
    let (first, _) = frames.first()?;
    let port = first.interface;
    let both = frames.iter().filter(|(frame, _)| frame.interface == port);
    let answers = both.filter(|(frame, _)| is_answer(&frame.bytes)).count();
    (!marked || answers > 0).then_some(port)
}

/// Whether this frame, whose datagrams are those of an open request, is its answer.
fn comes_back(frame: &Frame, marked: bool, request: &Open) -> bool {
    match marked {
        true => is_answer(&frame.bytes),
        false => frame.sent != Some(true) && frame.bytes != request.bytes,
    }
}

/// Offset of the source address.
const SOURCE: usize = 6;
/// The same frame again within this time is one frame, seen twice.
const TWICE_NS: u64 = 100_000;
/// What has not come back by then does not come any more.
const GIVEN_UP_NS: u64 = 1_000_000_000;
/// Requests that wait for their answers at once.
const MOST_OPEN: usize = 256;

#[cfg(test)]
mod tests {
    use super::*;
    use isocat_wire::Command;
    use isocat_wire::datagram::Address;
    use isocat_wire::frame::FrameWriter;
    use std::time::Duration;

    fn bytes(index: u8, source: u8, wkc: u8) -> Vec<u8> {
        let mut buffer = vec![0; 60];
        let mut writer = FrameWriter::new(&mut buffer, [source, 1, 2, 3, 4, 5]);
        let data = writer.push(Command::Brd, index, Address::Broadcast(0x0130), &[0, 0]);
        let data = data.expect("room");
        writer.finish();
        buffer[data + 2] = wkc;
        buffer
    }

    fn paired(list: &[(u64, Vec<u8>)]) -> Exchanges {
        let frames: Vec<_> = list
            .iter()
            .enumerate()
            .map(|(place, (micros, bytes))| Frame {
                number: place + 1,
                at: Duration::from_micros(*micros),
                interface: 0,
                sent: None,
                bytes: bytes.clone(),
            })
            .collect();
        Exchanges::of(&frames)
    }

    fn numbers(exchanges: &Exchanges) -> Vec<(usize, Option<usize>)> {
        let number = |e: &Exchange| (e.request_number, e.answer.as_ref().map(|(n, _)| *n));
        exchanges.list.iter().map(number).collect()
    }

    #[test]
    fn answers_find_their_requests_in_any_order() {
        let exchanges = paired(&[
            (0, bytes(1, 0x10, 0)),
            (1, bytes(2, 0x10, 0)),
            (30, bytes(2, 0x12, 3)),
            (31, bytes(1, 0x12, 3)),
            (40, bytes(3, 0x10, 0)),
            (50, bytes(4, 0x12, 3)),
        ]);
        assert_eq!(numbers(&exchanges), [(1, Some(4)), (2, Some(3)), (5, None)]);
        assert_eq!((exchanges.answers_alone, exchanges.unanswered()), (1, 1));
    }

    #[test]
    fn frames_that_the_file_has_twice_are_one() {
        let (request, answer) = (bytes(1, 0x10, 0), bytes(1, 0x12, 3));
        let list = [(0, &request), (5, &request), (30, &answer), (35, &answer)];
        let exchanges = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
        assert_eq!(numbers(&exchanges), [(1, Some(3))]);
        assert_eq!(exchanges.duplicates, 2);
        // Later it is a repetition.
        let list = [(0, &request), (100, &request), (130, &answer), (235, &answer)];
        let exchanges = paired(&list.map(|(at, bytes)| (at, bytes.clone())));
        assert_eq!(numbers(&exchanges), [(1, Some(3)), (2, Some(4))]);
    }

    #[test]
    fn without_the_mark_the_content_decides() {
        let exchanges = paired(&[(0, bytes(1, 0x12, 0)), (9, bytes(1, 0x12, 3))]);
        assert_eq!(numbers(&exchanges), [(1, Some(2))]);
        // Repeated with a working counter of 0: no device answers.
        let exchanges = paired(&[(0, bytes(1, 0x10, 0)), (900, bytes(1, 0x10, 0))]);
        assert_eq!(numbers(&exchanges), [(1, None), (2, None)]);
    }

    #[test]
    fn one_direction_alone() {
        let exchanges = paired(&[(0, bytes(1, 0x12, 3)), (9, bytes(2, 0x12, 3))]);
        assert_eq!((exchanges.list.len(), exchanges.answers_alone), (0, 2));
    }

    #[test]
    fn what_is_not_ours_is_counted() {
        let mut cut = bytes(1, 0x10, 0);
        cut[22] = 0xFF;
        let mut foreign = bytes(1, 0x10, 0);
        foreign[12..14].copy_from_slice(&[0x08, 0x06]);
        let exchanges = paired(&[(0, cut), (1, foreign), (2, vec![0; 7]), (3, vec![])]);
        assert_eq!((exchanges.broken, exchanges.foreign), (1, 3));
    }
}
