//! The capture file, read back by a library that did not write the frames: every frame is there twice, sent and
//! answered, with nanosecond stamps, and its datagrams count as those of an EtherCAT segment do.

use isocat::capture::Capture;
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_wire::Command;
use isocat_wire::datagram::{Datagram, datagrams};
use isocat_wire::frame;
use pcap_file::pcapng::PcapNgReader;

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
    assert_eq!(counts(Command::Brd, 0x0000), [4], "the count of SubDevices");
    assert_eq!(counts(Command::Frmw, 0x0910), [4], "one reads, three write");
    assert_eq!(counts(Command::Bwr, 0x0981), [4], "SYNC cleared everywhere");
    assert_eq!(counts(Command::Bwr, 0x0900), [4], "receive times latched everywhere");
    assert_eq!(counts(Command::Apwr, 0x0010), [1], "one station address each");
    let full: Vec<u16> = of(&frames, true)
        .filter(|d| d.header.command() == Ok(Command::Lrw))
        .map(|d| d.wkc)
        .collect();
    // Three for each of four SubDevices with outputs and inputs; before SAFEOP nothing counts.
    assert!(full.iter().filter(|wkc| **wkc == 12).count() >= 20, "{full:?}");
    assert!(full.iter().all(|wkc| *wkc <= 12));
}
