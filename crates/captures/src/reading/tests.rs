//! Files of all formats, cut and damaged.

use super::*;
use pcap_file::Endianness;
use pcap_file::pcap::{PcapHeader, PcapPacket, PcapWriter};
use pcap_file::pcapng::PcapNgWriter;
use pcap_file::pcapng::blocks::section_header::SectionHeaderBlock;

#[test]
fn time_stamps_in_their_units() {
    let time = |resolution, units| Link { resolution, ..Link::ETHERNET }.time(units);
    assert_eq!(time(6, 1_500_000), Duration::from_millis(1500));
    assert_eq!(time(9, 1_500_000_000), Duration::from_millis(1500));
    assert_eq!(time(0x80 | 10, 1536), Duration::from_millis(1500));
    assert_eq!(time(0, 3), Duration::from_secs(3));
    assert_eq!(time(127, u128::from(u64::MAX)), Duration::ZERO);
}

/// Three packets of 60 bytes, 1 us apart: sent, received, sent.
fn pcapng(endianness: Endianness) -> Vec<u8> {
    let section = SectionHeaderBlock { endianness, ..Default::default() };
    let mut writer = PcapNgWriter::with_section_header(Vec::new(), section).expect("in memory");
    let interface = InterfaceDescriptionBlock {
        linktype: DataLink::ETHERNET,
        snaplen: 0xFFFF,
        options: vec![InterfaceDescriptionOption::IfTsResol(9)],
    };
    writer.write_pcapng_block(interface).expect("in memory");
    for at in 0..3_u8 {
        let packet = EnhancedPacketBlock {
            interface_id: 0,
            timestamp: Duration::from_micros(at.into()),
            original_len: 60,
            data: vec![at; 60].into(),
            options: vec![EnhancedPacketOption::Flags(2 - u32::from(at % 2))],
        };
        writer.write_pcapng_block(packet).expect("in memory");
    }
    writer.into_inner()
}

fn pcap(endianness: Endianness, ts_resolution: TsResolution) -> Vec<u8> {
    let header = PcapHeader { endianness, ts_resolution, ..Default::default() };
    let mut writer = PcapWriter::with_header(Vec::new(), header).expect("in memory");
    for at in 0..3_u8 {
        let stamp = Duration::from_micros(at.into());
        writer.write_packet(&PcapPacket::new(stamp, 60, &[at; 60])).expect("in memory");
    }
    writer.into_writer()
}

#[test]
fn every_form_of_a_capture_says_the_same() {
    let (big, little) = (Endianness::Big, Endianness::Little);
    let (micro, nano) = (TsResolution::MicroSecond, TsResolution::NanoSecond);
    let classic = [(big, micro), (big, nano), (little, micro), (little, nano)];
    let classic = classic.map(|(endianness, resolution)| pcap(endianness, resolution));
    let files = [pcapng(big), pcapng(little)].into_iter().chain(classic);
    for (number, file) in files.enumerate() {
        let reading = Reading::of(&file).expect("a capture");
        let at: Vec<_> = reading.frames.iter().map(|frame| frame.at.as_nanos()).collect();
        let numbers: Vec<_> = reading.frames.iter().map(|frame| frame.number).collect();
        assert_eq!((at, numbers), (vec![0, 1000, 2000], vec![1, 2, 3]), "file {number}");
        let sent = reading.frames.iter().map(|frame| frame.sent);
        let sent: Vec<_> = sent.collect();
        match number {
            0 | 1 => assert_eq!(sent, [Some(true), Some(false), Some(true)]),
            _ => assert_eq!(sent, [None; 3]),
        }
        assert_eq!(reading.tally, Tally { packets: 3, ..Tally::default() });
    }
}

/// A capture cut off at any byte returns the frames before it, and says that it is not complete.
#[test]
fn a_file_that_ends_anywhere() {
    let resolution = TsResolution::NanoSecond;
    for file in [pcapng(Endianness::Little), pcap(Endianness::Big, resolution)] {
        let whole = Reading::of(&file).expect("a capture");
        let mut ended = 0;
        for len in 0..file.len() {
            match Reading::of(&file[..len]) {
                Ok(reading) => {
                    assert!(reading.frames.len() < 3);
                    assert_eq!(reading.frames, whole.frames[..reading.frames.len()]);
                    ended += usize::from(reading.tally.ended.is_some());
                }
                Err(none) => {
                    assert_eq!(none, NoCapture::Unknown { found: file[..len.min(4)].to_vec() })
                }
            }
        }
        assert!(ended > 60, "most ends are in the middle of a block");
        // A wrong byte leads to an error value or another frame.
        for at in 0..file.len() {
            for value in [0, 1, 0x7F, 0xFF] {
                let mut file = file.clone();
                file[at] = value;
                let _ = Reading::of(&file);
            }
        }
    }
}

/// A packet whose data is cut off is left out; a packet whose padding is cut off is not.
#[test]
fn packets_that_were_cut() {
    let mut frame = [0; 60];
    frame[12..14].copy_from_slice(&[0x88, 0xA4]);
    // Twelve bytes of datagrams follow the two of the EtherCAT header.
    frame[14..16].copy_from_slice(&[12, 0x10]);
    let mut writer = PcapWriter::new(Vec::new()).expect("in memory");
    for len in [60, 28, 27, 13] {
        let packet = PcapPacket::new(Duration::ZERO, 60, &frame[..len]);
        writer.write_packet(&packet).expect("in memory");
    }
    let reading = Reading::of(&writer.into_writer()).expect("a capture");
    let lengths: Vec<_> = reading.frames.iter().map(|frame| frame.bytes.len()).collect();
    assert_eq!((lengths, reading.tally.cut), (vec![60, 28], 2));
}

#[test]
fn what_is_no_capture_is_named() {
    for (bytes, word) in [
        (&b"PK\x03\x04 rest"[..], "zip"),
        (&[0x1F, 0x8B, 8, 0], "gzip"),
        (b"", "empty"),
        (b"<?xml version", "a text that begins with \"<?xm\""),
        (&[0x28, 0xB5, 0x2F, 0xFD, 0], "zstd"),
        (&[0xD4, 0xC3, 0xB2, 0xA1, 2, 0], "header of the pcap file"),
        (b"snoop\0\0\0", "editcap"),
        (&[0x7F, b'E', b'L', b'F'], "[7f, 45, 4c, 46]"),
        (&[0x0A, 0x0D, 0x0D, 0x0A, 0, 0], "cut off"),
    ] {
        let error = Reading::of(bytes).expect_err("no capture").to_string();
        assert!(error.contains(word), "{error}");
    }
}

/// No frame of a link without Ethernet is read, and the link type is reported.
#[test]
fn a_link_without_ethernet() {
    let header = PcapHeader { datalink: DataLink::IEEE802_11, ..Default::default() };
    let mut writer = PcapWriter::with_header(Vec::new(), header).expect("in memory");
    writer.write_packet(&PcapPacket::new(Duration::ZERO, 60, &[0; 60])).expect("in memory");
    let reading = Reading::of(&writer.into_writer()).expect("a capture");
    let tally = Tally { packets: 1, other_links: 1, other_link: Some(105), ..Tally::default() };
    assert_eq!((reading.frames.len(), reading.tally), (0, tally));
}
