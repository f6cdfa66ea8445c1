//! The capture file, read back by a library that did not write the frames: every frame is there
//! twice, sent and answered, with nanosecond stamps, and its datagrams count as those of an
//! EtherCAT segment do. Probes see it change from SubDevice to SubDevice, comments tell what
//! happened.

use std::time::Duration;

use isocat::capture::{Capture, WINDOW};
use isocat::{Nanos, Report, Scenario, SegmentFile};
use isocat_maindevice::{Event, Motion};
use isocat_sim::{BitError, Direction, Tap, World};
use isocat_wire::Command;
use isocat_wire::datagram::{Datagram, datagrams};
use isocat_wire::frame;
use isocat_wire::time::{Picos, Time};
use pcap_file::pcapng::blocks::enhanced_packet::EnhancedPacketOption;
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionOption;
use pcap_file::pcapng::{Block, PcapNgReader};

/// One frame of the file: its stamp in ns, whether it came back, its bytes.
type Captured = (u64, bool, Vec<u8>);

fn capture() -> Vec<Captured> {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(20);
    let mut file = Vec::new();
    let tap = Capture::new(&mut file).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    assert!(outcome.in_sync());
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    let mut reader = PcapNgReader::new(&file[..]).expect("a pcapng file");
    let mut frames = Vec::new();
    while let Some(block) = reader.next_block() {
        if let Some(packet) = block.expect("a whole block").into_enhanced_packet() {
            // The first ESC marks what it has processed.
            let answered = packet.data[6] & frame::LOCALLY_ADMINISTERED != 0;
            frames.push((packet.timestamp.as_nanos() as u64, answered, packet.data.to_vec()));
        }
    }
    frames
}

fn of<'a>(frames: &'a [Captured], answered: bool) -> impl Iterator<Item = Datagram<'a>> {
    frames
        .iter()
        .filter(move |frame| frame.1 == answered)
        .flat_map(|frame| datagrams(frame::payload(&frame.2).expect("EtherCAT")))
        .map(|datagram| datagram.expect("whole datagrams"))
}

#[test]
fn frames_go_out_once_and_come_back_once() {
    let frames = capture();
    let sent: Vec<u64> = frames.iter().filter(|frame| !frame.1).map(|frame| frame.0).collect();
    assert_eq!(sent.len() * 2, frames.len());
    assert!(sent.windows(2).all(|pair| pair[0] < pair[1]), "frames leave one after the other");
    // At 100 Mbit/s the shortest frame and its gap take 6720 ns.
    let closest = sent.windows(2).map(|pair| pair[1] - pair[0]).min();
    assert!(closest >= Some(6_720), "{closest:?}");
    // Stamps are no multiples of a coarser unit.
    assert!(frames.iter().any(|frame| frame.0 % 10 != 0));
}

#[test]
fn datagrams_count_as_the_segment_has_subdevices() {
    let frames = capture();
    assert!(of(&frames, false).all(|datagram| datagram.wkc == 0));
    let counts = |command: Command, address: u16| {
        let mut counts: Vec<u16> = of(&frames, true)
            .filter(|d| d.header.command() == Ok(command) && d.header.ado() == address)
            .map(|d| d.wkc)
            .collect();
        counts.sort_unstable();
        counts.dedup();
        counts
    };
    assert_eq!(counts(Command::Brd, 0x0000), [5], "the count of SubDevices");
    assert_eq!(counts(Command::Frmw, 0x0910), [5], "one reads, four write");
    assert_eq!(counts(Command::Bwr, 0x0981), [5], "SYNC cleared everywhere");
    assert_eq!(counts(Command::Bwr, 0x0900), [5], "receive times latched everywhere");
    assert_eq!(counts(Command::Apwr, 0x0010), [1], "one station address each");
    let full: Vec<u16> = of(&frames, true)
        .filter(|d| d.header.command() == Ok(Command::Lrw))
        .map(|d| d.wkc)
        .collect();
    // Three for each of four SubDevices with outputs and inputs; before SAFEOP nothing counts.
    assert!(full.iter().filter(|wkc| **wkc == 12).count() >= 20, "{full:?}");
    assert!(full.iter().all(|wkc| *wkc <= 12));
}

/// One packet of a file with several interfaces.
struct Packet {
    interface: u32,
    at: u64,
    inbound: bool,
    data: Vec<u8>,
    comments: Vec<String>,
}

fn packets(file: &[u8]) -> (Vec<String>, Vec<Packet>) {
    let mut reader = PcapNgReader::new(file).expect("a pcapng file");
    let (mut names, mut packets) = (Vec::new(), Vec::new());
    while let Some(block) = reader.next_block() {
        match block.expect("a whole block") {
            Block::InterfaceDescription(interface) => {
                let name = interface.options.iter().find_map(|option| match option {
                    InterfaceDescriptionOption::IfName(name) => Some(name.to_string()),
                    _ => None,
                });
                names.push(name.expect("a name"));
            }
            Block::EnhancedPacket(packet) => {
                let mut comments = Vec::new();
                let mut inbound = None;
                for option in packet.options {
                    match option {
                        EnhancedPacketOption::Comment(words) => comments.push(words.to_string()),
                        EnhancedPacketOption::Flags(flags) => inbound = Some(flags & 3 == 1),
                        _ => {}
                    }
                }
                packets.push(Packet {
                    interface: packet.interface_id,
                    at: packet.timestamp.as_nanos() as u64,
                    inbound: inbound.expect("a direction"),
                    data: packet.data.to_vec(),
                    comments,
                });
            }
            _ => {}
        }
    }
    (names, packets)
}

#[test]
fn probes_see_each_frame_before_and_after_each_subdevice() {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(20);
    let mut file = Vec::new();
    let tap = Capture::new(&mut file).and_then(|tap| tap.with_probes(&[2, 0, 1, 4, 3, 2]));
    let outcome = scenario.run().execute(Some(tap.expect("a Vec takes everything")), &mut |_| {});
    let told = serde_json::to_string(&Report::new(&scenario, &outcome)).expect("JSON");
    let alone = serde_json::to_string(&isocat::run(&scenario)).expect("JSON");
    assert_eq!(told, alone, "nobody notices that he is looked at");
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    let (names, packets) = packets(&file);
    assert_eq!(
        names,
        ["main", "subdevice-0", "subdevice-1", "subdevice-2", "subdevice-3", "subdevice-4"]
    );
    assert!(packets.is_sorted_by_key(|packet| packet.at), "time goes on");
    let at = |interface: u32, inbound: bool| -> Vec<&Packet> {
        let of = |packet: &&Packet| packet.interface == interface && packet.inbound == inbound;
        packets.iter().filter(of).collect()
    };
    let (sent, back) = (at(0, false), at(0, true));
    assert!(sent.len() > 1000 && sent.len() == back.len());
    // What leaves one enters the next; what leaves the last comes back.
    let mut before = sent;
    for interface in 1..=5 {
        let (entered, left) = (at(interface, true), at(interface, false));
        assert_eq!((entered.len(), left.len()), (before.len(), before.len()), "{interface}");
        for ((before, entered), left) in before.iter().zip(&entered).zip(&left) {
            assert_eq!(before.data, entered.data, "before {} at {}", interface - 1, entered.at);
            // A port's clock may take a frame half a period of EBUS before the mean that the chip's
            // delay has.
            assert!(before.at <= entered.at + 5 && entered.at < left.at, "{interface}");
        }
        before = left;
    }
    assert!(before.iter().zip(&back).all(|(left, back)| left.data == back.data));
    assert!(before.iter().zip(&back).all(|(left, back)| left.at < back.at));
}

/// What a tap in a cable has: frames on their way out and back, in true time; and no device
/// notices.
#[test]
fn taps_in_cables_see_both_directions() {
    let mut scenario = Scenario::from(SegmentFile::built_in());
    scenario.duration = Nanos::millis(20);
    let mut file = Vec::new();
    let tap = Capture::new(&mut file).and_then(|tap| tap.with_probes(&[2]));
    let tap = tap.and_then(|tap| tap.with_cables(&[2, 0])).expect("a Vec takes everything");
    let outcome = scenario.run().execute(Some(tap), &mut |_| {});
    let told = serde_json::to_string(&Report::new(&scenario, &outcome)).expect("JSON");
    let alone = serde_json::to_string(&isocat::run(&scenario)).expect("JSON");
    assert_eq!(told, alone, "no device notices the taps");
    outcome.world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    let (names, packets) = packets(&file);
    assert_eq!(names, ["main", "subdevice-2", "cable-0", "cable-2"]);
    assert!(packets.is_sorted_by_key(|packet| packet.at), "time goes on");
    let at = |interface: u32, inbound: bool| -> Vec<&Packet> {
        let of = |packet: &&Packet| packet.interface == interface && packet.inbound == inbound;
        packets.iter().filter(of).collect()
    };
    // The cable at the MainDevice: what was sent, and what comes back, a little later and earlier.
    let [sent, back, out, inbound] = [at(0, false), at(0, true), at(2, false), at(2, true)];
    assert!(sent.len() > 1000 && sent.len() == back.len());
    for (sent, out) in sent.iter().zip(&out) {
        assert!(sent.data == out.data && sent.at < out.at);
    }
    for (inbound, back) in inbound.iter().zip(&back) {
        assert!(inbound.data == back.data && inbound.at < back.at);
    }
    assert_eq!((out.len(), inbound.len()), (sent.len(), back.len()));
    // The cable in front of a device in the line: what enters the device, and it comes back.
    let [enters, out, inbound] = [at(1, true), at(3, false), at(3, true)];
    assert_eq!((out.len(), inbound.len()), (sent.len(), sent.len()));
    for ((enters, out), inbound) in enters.iter().zip(&out).zip(&inbound) {
        // A port's clock may take a frame half a period before the mean.
        assert!(enters.data == out.data && enters.at.abs_diff(out.at) <= 30);
        assert!(out.at < inbound.at);
    }
}

/// Runs `text` until it is in operation, does something to it, and gives the packets with comments.
fn commented(text: &str, deed: impl FnOnce(&mut World<Motion, Capture<Vec<u8>>>)) -> Vec<Packet> {
    let scenario = Scenario::from(SegmentFile::parse("capture.toml", text).expect("it reads"));
    let names = scenario.devices.iter().map(|device| device.name.clone()).collect();
    let tap = Capture::new(Vec::new()).expect("a Vec takes everything").with_names(names);
    let mut world = World::new(scenario.run().setup, Motion::default(), Some(tap));
    let limit = Time::new(30_000_000_000_000);
    loop {
        match world.poll_event() {
            Some(Event::InOperation { .. }) => break,
            Some(Event::Failed(error)) => panic!("{error}"),
            Some(_) => {}
            None => assert!(world.step(limit), "the segment does not come up"),
        }
    }
    deed(&mut world);
    let end = world.now() + Picos(100_000_000_000);
    while world.step(end) {
        while world.poll_event().is_some() {}
    }
    let file = world.into_tap().expect("the tap").finish().expect("a Vec takes everything");
    packets(&file).1
}

/// The comments that have a text in them, with what they are at.
fn with<'a>(packets: &'a [Packet], text: &str) -> Vec<(&'a Packet, &'a str)> {
    let all = packets.iter().flat_map(|packet| packet.comments.iter().map(move |c| (packet, c)));
    all.filter(|(_, words)| words.contains(text)).map(|(p, words)| (p, words.as_str())).collect()
}

#[test]
fn an_alarm_is_told() {
    // The counter is read every few cycles. Were 17 a multiple of that, it would always be found at
    // the same count.
    let quality = "    [quality]\n    share_permille = 200\n    [[subdevice]]";
    let text =
        TWO.replacen("    [[subdevice]]", quality, 1) + "    misbehave = [\"missed-copy 17\"]\n";
    let packets = commented(&text, |_| {});
    let found = with(&packets, "alarm: a counter rises: 0x1C32:0B is ");
    assert!(!found.is_empty());
    assert!(found.iter().all(|(_, words)| words.starts_with("SubDevice 1 (right): ")));
}

/// Whatever the order is in which they are told; what is told too late to have its place comes at
/// once.
#[test]
fn packets_and_comments_find_their_places() {
    let us = Duration::from_micros;
    let mut capture = Capture::new(Vec::new()).expect("a Vec takes everything");
    capture.write(us(100), true, &[1; 60]);
    capture.write(us(300), true, &[3; 60]);
    capture.write(us(200), false, &[2; 60]);
    capture.secondary_frame(Time::new(250_000_999), true, &[9; 60]);
    for (at, words) in [(149, "first"), (151, "second"), (275, "third"), (276, "fourth")] {
        capture.comment(us(at), words.to_owned());
    }
    capture.comment(us(10), "before".to_owned());
    capture.comment(us(900), "behind".to_owned());
    let file = capture.finish().expect("a Vec takes everything");
    let (names, packets) = packets(&file);
    assert_eq!(names, ["main", "main-secondary"]);
    let places: Vec<_> = packets.iter().map(|p| (p.at, p.interface, p.data[0])).collect();
    let expected = [(100_000, 0, 1), (200_000, 0, 2), (250_000, 1, 9), (300_000, 0, 3)];
    assert_eq!(places, expected);
    let comments: Vec<_> = packets.iter().map(|packet| packet.comments.join(", ")).collect();
    assert_eq!(comments, ["before, first", "second", "third", "fourth, behind"]);
}

#[test]
fn more_packets_than_are_held_back_go_on() {
    let mut capture = Capture::new(Vec::new()).expect("a Vec takes everything");
    let packets = WINDOW as u64 + 10;
    for number in 0..packets {
        capture.write(Duration::from_nanos(1000 + number), true, &[0; 60]);
    }
    // Ten are written, so this one cannot stand before them any more and is dropped.
    capture.write(Duration::from_nanos(1), true, &[7; 60]);
    capture.comment(Duration::from_nanos(2), "late".to_owned());
    let file = capture.finish().expect("a Vec takes everything");
    let packets_found = self::packets(&file).1;
    assert_eq!(packets_found.len() as u64, packets + 1);
    let late = packets_found.iter().position(|packet| packet.at == 1);
    assert_eq!(late, Some(10), "behind those that were written");
    let told = packets_found.iter().position(|packet| !packet.comments.is_empty());
    assert!(told.is_some_and(|at| (10..=12).contains(&at)), "{told:?}");
}

const TWO: &str = r#"
    cycle = "1ms"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    name = "left"
    [[subdevice]]
    device = "kollmorgen_akd2g"
    name = "right"
"#;

#[test]
fn states_are_told_at_the_first_frame_behind_them() {
    let packets = commented(TWO, |_| {});
    for (state, who) in [("OP", "SubDevice 0 (left)"), ("SAFEOP", "SubDevice 1 (right)")] {
        let found = with(&packets, &format!("{who}: now in {state}"));
        assert_eq!(found.len(), 1, "{who} {state}");
    }
    assert!(with(&packets, "lost").is_empty() && with(&packets, "missed").is_empty());
}

#[test]
fn a_missed_event_is_told_between_the_frames_around_it() {
    let text = TWO.to_owned() + "    misbehave = [\"missed-copy 20\"]\n";
    let packets = commented(&text, |_| {});
    let found = with(&packets, "SM event missed");
    assert!(found.len() >= 4, "{}", found.len());
    for (packet, words) in &found {
        let counter = words.strip_prefix("SubDevice 1 (right): SM event missed, 0x1C32:0B now ");
        assert!(counter.is_some_and(|counter| counter.parse::<u16>().is_ok()), "{words}");
        // The nearest frame to a pulse lies within half a cycle of it; pulses are a cycle apart.
        let others = found.iter().filter(|(other, _)| other.at.abs_diff(packet.at) < 1_000_000);
        assert_eq!(others.count(), 1, "20 cycles lie between them");
    }
}

#[test]
fn what_is_lost_and_miscounted_is_told() {
    let packets = commented(TWO, |world| {
        let at = world.now() + Picos(10_000_000_000);
        let (cable, direction) = (1, Direction::Back);
        world.segment_mut().disturb(BitError { cable, direction, at, bit: 300 });
        world.segment_mut().unplug(1, at + Picos(20_000_000_000));
        world.segment_mut().unplug(0, at + Picos(80_000_000_000));
    });
    let damaged = with(&packets, "this frame comes back damaged");
    assert_eq!(damaged.len(), 1);
    assert!(!damaged[0].0.inbound, "at the frame that left");
    let lost = with(&packets, "this frame is lost: cable 0 is pulled");
    assert!(lost.len() > 5, "{}", lost.len());
    let back = packets.iter().filter(|packet| packet.inbound).map(|packet| packet.at).max();
    assert!(lost.iter().all(|(packet, _)| !packet.inbound && Some(packet.at) > back));
    let wrong = with(&packets, "working counter of process data");
    assert!(wrong.iter().any(|(_, words)| words.ends_with("is 3, expected 6")), "{:?}", wrong[0].1);
}
