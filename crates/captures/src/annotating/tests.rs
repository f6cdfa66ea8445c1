//! A copy has all packets of the original, and the library that reads the original also reads its
//! comments.

use pcap_file::Endianness;
use pcap_file::pcapng::blocks::enhanced_packet::{EnhancedPacketBlock, EnhancedPacketOption};
use pcap_file::pcapng::blocks::interface_description::InterfaceDescriptionBlock;
use pcap_file::pcapng::blocks::section_header::SectionHeaderBlock;
use pcap_file::pcapng::blocks::simple_packet::SimplePacketBlock;
use pcap_file::pcapng::{Block as Parsed, PcapNgReader, PcapNgWriter};
use pcap_file::{DataLink, TsResolution};

use super::*;
use crate::reading::Reading;

/// Three packets; the second has an option, the third can't have options.
fn pcapng(endianness: Endianness) -> Vec<u8> {
    let section = SectionHeaderBlock { endianness, section_length: 512, ..Default::default() };
    let mut writer = PcapNgWriter::with_section_header(Vec::new(), section).expect("in memory");
    let interface = InterfaceDescriptionBlock {
        linktype: DataLink::ETHERNET,
        snaplen: 0xFFFF,
        options: Vec::new(),
    };
    writer.write_pcapng_block(interface).expect("in memory");
    for at in 0..2_u8 {
        let options = vec![EnhancedPacketOption::Flags(2); usize::from(at)];
        let packet = EnhancedPacketBlock {
            interface_id: 0,
            timestamp: std::time::Duration::from_nanos(at.into()),
            original_len: 61,
            data: vec![at; 61].into(),
            options,
        };
        writer.write_pcapng_block(packet).expect("in memory");
    }
    let simple = SimplePacketBlock { original_len: 60, data: vec![2; 60].into() };
    writer.write_pcapng_block(simple).expect("in memory");
    writer.into_inner()
}

fn pcap(ts_resolution: TsResolution) -> Vec<u8> {
    use pcap_file::pcap::{PcapHeader, PcapPacket, PcapWriter};
    let header = PcapHeader { ts_resolution, endianness: Endianness::Big, ..Default::default() };
    let mut writer = PcapWriter::with_header(Vec::new(), header).expect("in memory");
    for at in 0..3_u8 {
        let stamp = std::time::Duration::new(1_700_000_000, 5_000 * u32::from(at));
        writer.write_packet(&PcapPacket::new(stamp, 99, &[at; 61])).expect("in memory");
    }
    writer.into_writer()
}

fn comments() -> Comments {
    [(1, vec!["one".to_owned(), "more".to_owned()]), (2, vec!["zwölf".into()]), (3, vec![])].into()
}

/// The comments of each packet with options.
fn read(file: &[u8]) -> Vec<Vec<String>> {
    let mut reader = PcapNgReader::new(file).expect("pcapng");
    let mut all = Vec::new();
    while let Some(block) = reader.next_block() {
        let Parsed::EnhancedPacket(packet) = block.expect("whole") else { continue };
        let comments = packet.options.iter().filter_map(|option| match option {
            EnhancedPacketOption::Comment(comment) => Some(comment.to_string()),
            _ => None,
        });
        all.push(comments.collect());
    }
    all
}

#[test]
fn packets_stay_and_comments_come() {
    let (little, big) = (pcapng(Endianness::Little), pcapng(Endianness::Big));
    let (micro, nano) = (pcap(TsResolution::MicroSecond), pcap(TsResolution::NanoSecond));
    for (file, options) in [(little, 2), (big, 2), (micro, 3), (nano, 3)] {
        let mut copy = Annotated::new(Vec::new());
        let copied = copy.add(&file[..], &comments()).expect("a capture");
        let copy = copy.finish().expect("in memory");
        let (before, after) = (Reading::of(&file), Reading::of(&copy));
        let (before, after) = (before.expect("a capture"), after.expect("a capture"));
        assert_eq!((after.frames, after.tally), (before.frames, before.tally));
        let expected: Vec<Vec<String>> = comments().into_values().take(options).collect();
        assert_eq!(read(&copy), expected);
        let commented = Copied { packets: 3, commented: options, ..Copied::default() };
        assert_eq!(copied, Copied { without_place: 3 - options, ..commented });
    }
}

#[test]
fn without_comments_blocks_are_the_same() {
    let file = pcapng(Endianness::Big);
    let mut copy = Annotated::new(Vec::new());
    copy.add(&file[..], &Comments::new()).expect("a capture");
    let mut expected = file;
    // In a copy the length of the section is unknown.
    expected[16..24].fill(0xFF);
    assert_eq!(copy.finish().expect("in memory"), expected);
}

#[test]
fn several_captures_are_sections_of_one() {
    let mut copy = Annotated::new(Vec::new());
    for file in [pcap(TsResolution::NanoSecond), pcapng(Endianness::Big)] {
        copy.add(&file[..], &Comments::new()).expect("a capture");
    }
    let reading = Reading::of(&copy.finish().expect("in memory")).expect("a capture");
    let numbers: Vec<usize> = reading.frames.iter().map(|frame| frame.number).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 5, 6]);
}

/// Wherever a file ends or is damaged, its copy can be read to the end.
#[test]
fn a_damaged_capture_is_copied_up_to_there() {
    for file in [pcapng(Endianness::Little), pcap(TsResolution::MicroSecond)] {
        let whole = Reading::of(&file).expect("a capture").frames;
        for at in 24..file.len() {
            let mut damaged = file.clone();
            damaged[at] ^= 0x80;
            for file in [&file[..at], &damaged] {
                let mut copy = Annotated::new(Vec::new());
                let Ok(copied) = copy.add(file, &comments()) else { continue };
                let copy = copy.finish().expect("in memory");
                let Ok(reading) = Reading::of(&copy) else { continue };
                assert!(reading.frames.len() <= copied.packets && copied.packets <= 3);
                if file.len() == at {
                    assert_eq!(reading.frames, whole[..copied.packets], "cut at {at}");
                    assert_eq!(reading.tally.ended, None, "cut at {at}");
                }
            }
        }
    }
}

#[test]
fn long_comments_are_cut_between_characters() {
    let file = pcap(TsResolution::MicroSecond);
    let long: Comments = [(1, vec!["ä".repeat(70_000), format!("x{}", "ä".repeat(3000))])].into();
    let mut copy = Annotated::new(Vec::new());
    copy.add(&file[..], &long).expect("a capture");
    let read = read(&copy.finish().expect("in memory"));
    let lengths: Vec<usize> = read[0].iter().map(String::len).collect();
    assert_eq!(lengths, [4096, 4095]);
}
