//! Merging of two copies, and the wait for the second one.

use std::vec::Vec;

use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, Layout, Layouts};
use isocat_wire::frame::{FrameWriter, payload_offset};
use isocat_wire::{AutoIncrementAddress, register};

use super::*;
use crate::Config;

const SOURCE: [u8; 6] = [0x10; 6];
const CYCLE: Nanos = Nanos::millis(1);

fn station(ado: u16) -> Address {
    Address::Station(StationAddress(0x1001), ado)
}

fn position(ado: u16) -> Address {
    Address::Position(AutoIncrementAddress::of_position(1), ado)
}

/// A frame of these datagrams.
fn frame(index: u8, datagrams: &[(Command, Address, &[u8])]) -> Vec<u8> {
    let mut bytes = std::vec![0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut bytes, SOURCE);
    for (command, address, data) in datagrams {
        writer.push(*command, index, *address, data).expect("it fits");
    }
    let len = writer.finish();
    bytes.truncate(len);
    bytes
}

fn layouts(frame: &[u8]) -> (usize, Vec<Layout>) {
    let start = payload_offset(frame).expect("our own frame");
    let (mut layouts, payload) = (Layouts::new(), &frame[start..]);
    (start, core::iter::from_fn(|| layouts.next(payload)?.ok()).collect())
}

/// The answer of a part to each datagram: data, and the increase of the working counter.
fn answer(mut frame: Vec<u8>, answers: &[(&[u8], u16)]) -> Vec<u8> {
    frame[6] |= LOCALLY_ADMINISTERED;
    let (start, layouts) = layouts(&frame);
    for (layout, (data, wkc)) in layouts.iter().zip(answers) {
        frame[start + layout.data()..start + layout.wkc()].copy_from_slice(data);
        frame[start + layout.wkc()..start + layout.end()].copy_from_slice(&wkc.to_le_bytes());
    }
    frame
}

/// Command, data and working counter of the first datagram.
fn first(frame: &[u8]) -> (u8, Vec<u8>, u16) {
    let (start, layouts) = layouts(frame);
    let payload = &frame[start..];
    let layout = layouts[0];
    let wkc = [payload[layout.wkc()], payload[layout.wkc() + 1]];
    (payload[layout.start], payload[layout.data()..layout.wkc()].to_vec(), u16::from_le_bytes(wkc))
}

/// One datagram that both parts answer.
fn merged(
    what: (Command, Address, &[u8]),
    a: (&[u8], u16),
    b: (&[u8], u16),
    leader: Option<StationAddress>,
) -> (u8, Vec<u8>, u16) {
    let sent = frame(1, &[what]);
    let mut copy = sent.clone();
    merge::change(&mut copy, leader);
    let (near, far) = (answer(sent.clone(), &[a]), answer(copy, &[b]));
    let mut out = Vec::new();
    merge::merge(&near, &far, &sent, leader, &mut out).expect("they go together");
    assert_eq!(out[6..12], near[6..12]);
    first(&out)
}

/// The datagram in copy B for a given one.
fn changed(what: (Command, Address, &[u8]), leader: Option<StationAddress>) -> Layout {
    let mut bytes = frame(1, &[what]);
    let before = bytes.len();
    merge::change(&mut bytes, leader);
    assert_eq!(bytes.len(), before);
    layouts(&bytes).1[0]
}

#[test]
fn what_copy_b_carries() {
    use Command::*;
    let far = Some(StationAddress(0x1003));
    let status = register::AL_STATUS.address;
    let logical = Address::Logical(0x0100_0000);
    let same = [
        (Fprd, station(status)),
        (Fpwr, station(status)),
        (Fprw, station(status)),
        (Brd, Address::Broadcast(status)),
        (Brd, Address::Broadcast(0x0900)),
        (Bwr, Address::Broadcast(status)),
        (Brw, Address::Broadcast(status)),
        (Lrd, logical),
        (Lwr, logical),
        (Lrw, logical),
    ];
    for (command, address) in same {
        let header = changed((command, address, &[1, 2]), far).header;
        assert_eq!((header.command(), header.address), (Ok(command), address.raw()));
    }
    let nothing = [
        (Nop, station(status)),
        (Aprd, position(status)),
        (Apwr, position(status)),
        (Aprw, position(status)),
        (Armw, position(0x0910)),
        (Bwr, Address::Broadcast(0x0900)),
        (Brw, Address::Broadcast(0x0900)),
        (Frmw, station(0x0920)),
    ];
    for (command, address) in nothing {
        assert_eq!(
            changed((command, address, &[1, 2]), far).header.command(),
            Ok(Nop),
            "{command}"
        );
    }
    // The drift datagram gets another reference, or none.
    let drift = (Frmw, station(0x0910), &[0; 8][..]);
    assert_eq!(changed(drift, None).header.command(), Ok(Nop));
    let led = changed(drift, far).header;
    assert_eq!((led.command(), led.adp(), led.ado()), (Ok(Frmw), 0x1003, 0x0910));
}

#[test]
fn each_command_where_either_part_answers_or_both() {
    use Command::*;
    let logical = Address::Logical(0x0100_0000);
    let broadcast = Address::Broadcast(0x0130);
    let read = |command, a, b| merged((command, station(0x0130), &[0, 0]), a, b, None);
    for command in [Fprd, Fprw] {
        let code = command as u8;
        assert_eq!(read(command, (&[8, 1], 1), (&[0, 0], 0)), (code, [8, 1].into(), 1));
        assert_eq!(read(command, (&[0, 0], 0), (&[8, 2], 1)), (code, [8, 2].into(), 1));
        assert_eq!(read(command, (&[0, 0], 0), (&[0, 0], 0)), (code, [0, 0].into(), 0));
        // As on a line, the data is that of the last SubDevice, and the working counter shows that
        // several answered.
        assert_eq!(read(command, (&[8, 1], 1), (&[4, 2], 1)), (code, [4, 2].into(), 2));
    }
    for command in [Fpwr, Bwr, Lwr] {
        let address = if command == Fpwr { station(0x0120) } else { logical };
        let both = merged((command, address, &[7, 9]), (&[7, 9], 1), (&[7, 9], 2), None);
        assert_eq!(both, (command as u8, [7, 9].into(), 3));
    }
    for command in [Brd, Brw] {
        let both = merged((command, broadcast, &[0, 0]), (&[8, 0], 2), (&[0x14, 1], 3), None);
        assert_eq!(both, (command as u8, [0x1C, 1].into(), 5));
    }
    for command in [Lrd, Lrw] {
        // Bits of one byte come from either part, and other bits stay as sent.
        let sent = [0b1010_1010, 0xFF, 0x55];
        let (a, b) = ([0b1010_1001, 0xFF, 0x55], [0b0110_1010, 0x00, 0x55]);
        let both = merged((command, logical, &sent), (&a, 3), (&b, 6), None);
        assert_eq!(both, (command as u8, [0b0110_1001, 0x00, 0x55].into(), 9));
    }
    // Commands that are NOP in B have A's data, regardless of B's.
    for command in [Aprd, Apwr, Aprw, Armw] {
        let both = merged((command, position(0x0130), &[0, 0]), (&[8, 1], 1), (&[9, 9], 7), None);
        assert_eq!(both, (command as u8, [8, 1].into(), 1));
    }
    let times = Address::Broadcast(0x0900);
    let both = merged((Bwr, times, &[0; 4]), (&[0; 4], 2), (&[0; 4], 7), None);
    assert_eq!(both, (Bwr as u8, [0; 4].into(), 2));
}

/// The time is that of the reference; clocks behind the cut count too, with another reference.
#[test]
fn the_drift_datagram() {
    let drift = (Command::Frmw, station(0x0910), &[0; 8][..]);
    let (near, far) = ([1, 2, 3, 4, 5, 6, 7, 8], [9; 8]);
    let code = Command::Frmw as u8;
    let other = Some(StationAddress(0x1003));
    assert_eq!(merged(drift, (&near, 2), (&far, 2), other), (code, near.into(), 4));
    assert_eq!(merged(drift, (&near, 2), (&[0; 8], 0), None), (code, near.into(), 2));
    // No copy has the reference's time, and another clock's time is not used.
    assert_eq!(merged(drift, (&[0; 8], 0), (&far, 2), other), (code, [0; 8].into(), 2));
    // The reference is behind the cut, and controls the clocks there.
    let itself = Some(StationAddress(0x1001));
    assert_eq!(merged(drift, (&[0; 8], 0), (&far, 3), itself), (code, far.into(), 3));
}

#[test]
fn event_bits_are_of_both() {
    let sent = frame(1, &[(Command::Brd, Address::Broadcast(0x0130), &[0, 0])]);
    let (start, _) = layouts(&sent);
    let (mut a, mut b) = (sent.clone(), sent.clone());
    (a[start + 8], b[start + 8], b[start + 9]) = (0b01, 0b10, 0x80);
    let mut out = Vec::new();
    let counts = merge::merge(&a, &b, &sent, None, &mut out);
    assert_eq!(counts, Some(merge::Counts { broadcast: Some((0, 0)) }));
    assert_eq!(out[start + 8..start + 10], [0b11, 0x80]);
}

#[test]
fn a_copy_alone_is_the_frame_that_was_sent() {
    let datagrams = [
        (Command::Frmw, station(0x0910), &[0; 8][..]),
        (Command::Aprd, position(0x0130), &[0; 2][..]),
        (Command::Brd, Address::Broadcast(0x0130), &[0; 2][..]),
    ];
    let sent = frame(1, &datagrams);
    let leader = Some(StationAddress(0x1003));
    let mut copy = sent.clone();
    copy[11] ^= 1;
    merge::change(&mut copy, leader);
    let copy = answer(copy, &[(&[9; 8], 2), (&[0; 2], 0), (&[8, 0], 3)]);
    let mut out = Vec::new();
    let counts = merge::alone_b(&copy, &sent, leader, &mut out).expect("they go together");
    assert_eq!(counts.broadcast, Some((0, 3)));
    assert_eq!(out[6..12], passed(SOURCE));
    // The other clock's time is dropped but its working counter stays; positions are as sent.
    let expected = answer(sent.clone(), &[(&[0; 8], 2), (&[0; 2], 0), (&[8, 0], 3)]);
    assert_eq!(out, expected);
    let near = answer(sent.clone(), &[(&[9; 8], 2), (&[5; 2], 1), (&[8, 0], 3)]);
    let counts = merge::alone_a(&near, &sent, &mut out).expect("they go together");
    assert_eq!((counts.broadcast, &out), (Some((3, 0)), &near));
}

#[test]
fn what_is_too_short_goes_on_nowhere() {
    let sent = frame(1, &[(Command::Fprd, station(0x1000), &[0; 64])]);
    let mut out = Vec::new();
    for len in 0..sent.len() {
        let cut = &sent[..len];
        assert_eq!(merge::merge(cut, &sent, &sent, None, &mut out), None);
        assert_eq!(merge::merge(&sent, cut, &sent, None, &mut out), None);
        assert_eq!(merge::alone_b(cut, &sent, None, &mut out), None);
        assert_eq!(merge::alone_a(cut, &sent, &mut out), None);
    }
}

/// Copies in flight, and a clock.
struct Bench {
    copies: Copies,
    shared: RingState,
    now: Time<Host>,
    index: u8,
}

impl Bench {
    fn new() -> Self {
        let mut config = Config::new(CYCLE);
        config.source = SOURCE;
        let now = Time::new(1_000_000_000);
        let copies = Copies::new(&config, config::Ring::default(), now);
        Self { copies, shared: RingState::default(), now, index: 0 }
    }

    /// Sends a broadcast read; returns both copies.
    fn send(&mut self, cyclic: bool) -> [Vec<u8>; 2] {
        self.now += CYCLE;
        self.index = (self.index + 1) % 0x40;
        let index = self.index | if cyclic { CYCLIC_INDEX } else { 0 };
        let sent = frame(index, &[(Command::Brd, Address::Broadcast(0x0130), &[0; 2])]);
        self.copies.sent(self.now, &sent);
        let mut buffer = [0; MAX_LEN];
        let len = self.copies.transmit(&mut buffer).expect("there is a copy");
        assert_eq!(self.copies.transmit(&mut buffer), None, "one of each frame");
        [sent, buffer[..len].to_vec()]
    }

    fn take(&mut self, port: Port, frame: &[u8]) -> Taken {
        self.copies.take(port, self.now, frame, &mut self.shared)
    }

    /// A copy comes back to its port with this working counter.
    fn turn(&mut self, port: Port, frame: &[u8], count: u16) -> Taken {
        let frame = answer(frame.to_vec(), &[(&[8, 0], count)]);
        self.take(port, &frame)
    }

    fn count(&self) -> u16 {
        first(self.copies.merged()).2
    }

    fn expire(&mut self) -> Option<Taken> {
        self.copies.expire(self.now, &mut self.shared)
    }
}

use Port::{Primary, Secondary};

#[test]
fn in_a_whole_ring_copy_a_is_the_answer() {
    let mut bench = Bench::new();
    for _ in 0..10 {
        let [a, b] = bench.send(true);
        let back = answer(a.clone(), &[(&[8, 0], 4)]);
        assert_eq!(bench.take(Primary, &b), Taken::Kept);
        assert_eq!(bench.take(Secondary, &back), Taken::AsItIs);
        assert_eq!(bench.take(Secondary, &back), Taken::AsItIs, "the machine counts it as late");
        assert_eq!(bench.take(Primary, &b), Taken::Kept);
        assert_eq!(bench.shared.view, View::Whole);
        assert_eq!(bench.copies.next_timeout(), Time::NEVER);
    }
    assert_eq!((bench.copies.slots.len(), bench.copies.lost), (1, 0));
    // The same without copy B, which is counted.
    for _ in 0..10 {
        let [a, _] = bench.send(true);
        assert_eq!(bench.turn(Secondary, &a, 4), Taken::AsItIs);
    }
    assert!(bench.copies.slots.len() <= 4, "places are used again");
    bench.now += Nanos(2 * CYCLE.0);
    bench.send(true);
    assert_eq!(bench.copies.lost, 10);
}

#[test]
fn in_a_cut_ring_either_may_be_first() {
    let mut bench = Bench::new();
    let [a, b] = bench.send(true);
    assert_eq!(bench.turn(Primary, &a, 1), Taken::Kept);
    assert_eq!(bench.copies.next_timeout(), bench.now + Nanos(CYCLE.0 / 4));
    assert_eq!(bench.turn(Secondary, &b, 3), Taken::Merged);
    assert_eq!((bench.count(), bench.shared.view), (4, View::Cut { near: 1, far: 3 }));
    let [a, b] = bench.send(false);
    assert_eq!(bench.turn(Secondary, &b, 2), Taken::Kept);
    assert_eq!(bench.turn(Primary, &a, 2), Taken::Merged);
    assert_eq!((bench.count(), bench.shared.view), (4, View::Cut { near: 2, far: 2 }));
    assert_eq!(bench.copies.next_timeout(), Time::NEVER);
    // Copy B finds the ring whole in this cycle: only A has answers.
    let [a, b] = bench.send(true);
    assert_eq!(bench.turn(Primary, &a, 2), Taken::Kept);
    assert_eq!(bench.take(Primary, &b), Taken::Merged);
    assert_eq!(bench.count(), 2);
}

#[test]
fn a_missing_copy_is_waited_for_and_no_longer() {
    let mut bench = Bench::new();
    for number in 0..12 {
        let [a, _] = bench.send(true);
        let taken = bench.turn(Primary, &a, 4);
        if number >= SILENT {
            assert_eq!(taken, Taken::Merged, "the second port is silent");
            assert_eq!(bench.shared.view, View::Cut { near: 4, far: 0 });
            continue;
        }
        assert_eq!(taken, Taken::Kept);
        bench.now += Nanos(CYCLE.0 / 4 - 1);
        assert_eq!(bench.expire(), None);
        bench.now += Nanos(1);
        assert_eq!(bench.expire(), Some(Taken::Merged));
        assert_eq!(bench.count(), 4);
    }
    // Once the copy comes again it is waited for again.
    let [a, b] = bench.send(true);
    assert_eq!(bench.turn(Secondary, &b, 1), Taken::Kept);
    assert_eq!(bench.turn(Primary, &a, 3), Taken::Merged);
    let [a, _] = bench.send(true);
    assert_eq!(bench.turn(Primary, &a, 3), Taken::Kept);
}

/// A frame that is not of the cycle tells which SubDevices are present, so it is lost rather than
/// incomplete.
#[test]
fn other_frames_wait_until_a_part_is_surely_gone() {
    let mut bench = Bench::new();
    for number in 0..12 {
        let [a, _] = bench.send(false);
        let taken = bench.turn(Primary, &a, 3);
        if number >= 10 {
            assert_eq!(taken, Taken::Merged);
            continue;
        }
        assert_eq!(taken, Taken::Kept);
        bench.now += CYCLE;
        let gone = number == 9;
        assert_eq!(bench.expire(), Some(if gone { Taken::Merged } else { Taken::Kept }));
        assert_eq!(bench.expire(), None);
    }
}

#[test]
fn cables_that_are_swapped_are_seen() {
    let mut bench = Bench::new();
    let [a, b] = bench.send(false);
    assert_eq!(bench.take(Secondary, &a), Taken::AsItIs, "nobody has touched it");
    assert_eq!(bench.turn(Primary, &b, 4), Taken::Kept);
    assert_eq!(bench.shared.view, View::Reverse);
}

#[test]
fn frames_of_others_are_not_ours() {
    let mut bench = Bench::new();
    let [a, _] = bench.send(true);
    let mut foreign = a.clone();
    foreign[8] = 0x77;
    assert_eq!(bench.take(Secondary, &foreign), Taken::AsItIs, "the machine counts it");
    // Bytes behind the end of its datagram are padding.
    for len in 0..30 {
        bench.take(Primary, &a[..len]);
    }
    assert_eq!(bench.turn(Secondary, &a, 4), Taken::AsItIs);
}

/// For any wrong bit in a returned copy, the used frame has the length of the sent one, or no frame
/// is used.
#[test]
fn wrong_bits_hurt_nobody() {
    for (port, other) in [(Primary, Secondary), (Secondary, Primary)] {
        let mut bench = Bench::new();
        bench.copies.leader = Some(StationAddress(0x1003));
        let bits = 8 * bench.send(true)[0].len();
        for bit in 0..bits {
            let [a, b] = bench.send(true);
            let (mut first, second) = if port == Primary { (a, b) } else { (b, a) };
            first[bit / 8] ^= 1 << (bit % 8);
            for (port, frame) in [(port, &first), (other, &second)] {
                if bench.take(port, frame) == Taken::Merged {
                    assert_eq!(bench.copies.merged().len(), frame.len());
                }
            }
            bench.now += CYCLE;
            while bench.expire().is_some() {}
        }
        assert!(bench.copies.slots.len() <= 4, "{} places", bench.copies.slots.len());
    }
}
