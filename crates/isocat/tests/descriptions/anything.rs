//! Arbitrary bytes at the doors of the command: files that were good once, with pieces of them
//! lost, doubled, exchanged and spoilt. Longer runs are those of `fuzz/`.

use crate::checking;
use isocat::{SegmentFile, profile};

/// A sequence that each run repeats (SplitMix64).
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, most: usize) -> usize {
        (self.next() % most.max(1) as u64) as usize
    }
}

/// One to four changes.
fn spoilt(good: &[u8], draws: &mut Draws) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for _ in 0..=draws.below(4) {
        let at = draws.below(bytes.len() + 1);
        let to = (at + draws.below(64)).min(bytes.len());
        match draws.below(6) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..to)),
            2 => {
                let piece = bytes[at..to].to_vec();
                let place = draws.below(bytes.len() + 1);
                bytes.splice(place..place, piece);
            }
            3 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << draws.below(8);
                }
            }
            4 => {
                // Numbers at the ends of their ranges are where sums overflow.
                let numbers =
                    ["0", "-1", "255", "65535", "4294967295", "9223372036854775807", "1e9"];
                let digits =
                    bytes[at..].iter().position(u8::is_ascii_digit).map(|found| at + found);
                if let Some(from) = digits {
                    let len = bytes[from..].iter().take_while(|b| b.is_ascii_digit()).count();
                    let number = numbers[draws.below(numbers.len())].bytes();
                    bytes.splice(from..from + len, number);
                }
            }
            _ => {
                let random: Vec<_> = (0..draws.below(16)).map(|_| draws.next() as u8).collect();
                bytes.splice(at..at, random);
            }
        }
    }
    bytes
}

fn try_all(seed: u64, goods: &[&[u8]], rounds: usize, check: fn(&[u8])) {
    let mut draws = Draws(seed);
    for good in goods {
        check(good);
        for _ in 0..rounds {
            check(&spoilt(good, &mut draws));
        }
    }
}

#[test]
fn descriptions() {
    try_all(
        1,
        &[include_bytes!("../esi/box.xml"), include_bytes!("../esi/rack.xml")],
        400,
        checking::esi,
    );
}

#[test]
fn eeproms() {
    let drive = isocat::profile::built_in("kollmorgen_akd2g").expect("a built-in profile");
    let simple = isocat::profile::built_in("simple_io4").expect("a built-in profile");
    // What is spoilt in erased bytes is of no interest.
    let used = |image: &[u8]| {
        image[..image.iter().rposition(|byte| *byte != 0xFF).unwrap_or(0) + 3].to_vec()
    };
    try_all(6, &[&used(&drive.sii), &used(&simple.sii)], 400, checking::sii);
}

#[test]
fn networks() {
    let eni = br#"<?xml version="1.0"?><EtherCATConfig><Config><Master><Info><Name>M</Name></Info></Master>
        <Slave><Info><Name>Box</Name><PhysAddr>1001</PhysAddr><VendorId>2</VendorId><ProductCode>3</ProductCode>
        <RevisionNo>1</RevisionNo></Info><InitCmds><InitCmd><Transition>IP</Transition><Cmd>5</Cmd><Adp>1001</Adp>
        <Ado>288</Ado><Data>1000</Data><Cnt>1</Cnt></InitCmd></InitCmds></Slave>
        <Cyclic><CycleTime>1000</CycleTime><Frame><Cmd><State>OP</State><Cmd>12</Cmd><Addr>65536</Addr>
        <DataLength>8</DataLength><Cnt>3</Cnt></Cmd></Frame></Cyclic></Config></EtherCATConfig>"#;
    try_all(2, &[eni], 2_000, checking::eni);
}

#[test]
fn segment_files() {
    let built_in = SegmentFile::built_in_text().as_bytes();
    let small =
        b"cycle = \"1ms\"\n[[subdevice]]\nname = \"a\"\ndevice = \"simple_io16\"\ncount = 3\n\
                  [[subdevice]]\ndevice = \"simple_io4\"\nconnect = \"a 2:1\"\n";
    try_all(3, &[built_in, small], 500, checking::segment);
}

#[test]
fn profiles() {
    let text = |id| profile::built_in_text(id).expect("a profile").as_bytes();
    try_all(4, &[text("simple_io16"), text("beckhoff_el2502-0010")], 150, checking::profile);
}

#[test]
fn captures() {
    let mut file = Vec::new();
    let mut capture = isocat::capture::Capture::new(&mut file).expect("memory takes it");
    for number in 0..8 {
        let frame = [number as u8; 64];
        capture.write(std::time::Duration::from_micros(number), number % 2 == 0, &frame);
    }
    capture.finish().expect("memory takes it");
    try_all(5, &[&file], 4_000, checking::capture);
}

#[test]
fn requests() {
    let goods: [&[u8]; 6] = [
        b"pull 1",
        b"power-cycle axis 1 500ms",
        b"drop 3",
        b"loss 10%",
        b"delay 1ms 3ms",
        b"plug 18446744073709551616",
    ];
    try_all(6, &goods, 3_000, checking::control);
}
