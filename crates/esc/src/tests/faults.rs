//! Whatever the bytes: no panic, and working counters within what the commands allow.

use super::*;
use crate::{ET1100, ET1200, IP_CORE_32};
use isocat_wire::command::Command;
use isocat_wire::datagram::{self, Header};
use proptest::prelude::*;

/// One thing that happens to an ESC.
#[derive(Clone, Debug)]
enum Act {
    Frame { datagrams: Vec<(u8, u32, Vec<u8>)>, good: bool, cut: usize },
    Raw(Vec<u8>),
    PdiRead(u16, usize),
    PdiWrite(u16, Vec<u8>),
    Wait(u64),
    Port(usize, bool),
}

/// Addresses where something is, more often than not.
fn address() -> impl Strategy<Value = u16> {
    prop_oneof![
        0x0000u16..0x0160,
        0x0200u16..0x0230,
        0x0400u16..0x0520,
        0x0600u16..0x0680,
        0x0800u16..0x0840,
        0x0900u16..0x09D0,
        0x0F00u16..0x1100,
        any::<u16>(),
    ]
}

fn data(most: usize) -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..16),
        proptest::collection::vec(
            prop_oneof![Just(0u8), Just(1), Just(0x10), any::<u8>()],
            0..most
        ),
    ]
}

fn act() -> impl Strategy<Value = Act> {
    let target = prop_oneof![
        (prop_oneof![Just(0u16), Just(0x1001)], address())
            .prop_map(|(adp, ado)| u32::from(adp) | u32::from(ado) << 16),
        0u32..64,
        any::<u32>(),
    ];
    let one = (0u8..16, target, data(300));
    prop_oneof![
        6 => (proptest::collection::vec(one, 1..4), any::<bool>(), 0usize..40)
            .prop_map(|(datagrams, good, cut)| Act::Frame { datagrams, good, cut }),
        1 => proptest::collection::vec(any::<u8>(), 0..100).prop_map(Act::Raw),
        2 => (address(), 0usize..300).prop_map(|(at, len)| Act::PdiRead(at, len)),
        2 => (address(), data(300)).prop_map(|(at, data)| Act::PdiWrite(at, data)),
        2 => (0u64..3_000_000).prop_map(Act::Wait),
        1 => (0usize..4, any::<bool>()).prop_map(|(port, link)| Act::Port(port, link)),
    ]
}

fn frame(list: &[(u8, u32, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = vec![0xFF; 6];
    bytes.extend([0x10, 0, 0, 0, 0, 0, 0x88, 0xA4, 0, 0x10]);
    for (number, (command, address, data)) in list.iter().enumerate() {
        let mut header = Header::parse(&[
            *command,
            0,
            0,
            0,
            0,
            0,
            data.len() as u8,
            (data.len() >> 8) as u8,
            0,
            0,
        ]);
        header.address = *address;
        header.more = number + 1 < list.len();
        bytes.extend(header.emit());
        bytes.extend(data);
        bytes.extend([0, 0]);
    }
    let len = (bytes.len() - 16) as u16;
    bytes[14..16].copy_from_slice(&(len & 0x7FF | 0x1000).to_le_bytes());
    bytes
}

/// The most that one ESC may add.
fn most(command: u8) -> u16 {
    match Command::try_from(command) {
        Ok(Command::Nop) | Err(_) => 0,
        Ok(Command::Aprw | Command::Fprw | Command::Brw | Command::Lrw) => 3,
        Ok(_) => 1,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..Default::default() })]

    #[test]
    fn nothing_panics_and_counters_stay_in_bounds(
        chip in prop_oneof![Just(&ET1100), Just(&ET1200), Just(&IP_CORE_32)],
        acts in proptest::collection::vec(act(), 1..40),
    ) {
        let mut esc = Esc::new(chip, image(SII), vec![0; usize::from(chip.ram_kib) * 1024]);
        let mut now = 1_000u64;
        for act in acts {
            // A cycle of a few ns makes an event a tick: bounded, so that the test is quick.
            for _ in 0..2_000 {
                let Some((at, _)) = esc.step(Time::new(now)) else { break };
                prop_assert!(at.count() <= now);
            }
            match act {
                Act::Frame { datagrams: list, good, cut } => {
                    let mut bytes = frame(&list);
                    if cut < 8 {
                        bytes.truncate(bytes.len() - cut);
                    }
                    let end = now + duration_ns(bytes.len());
                    let processed = esc.process(&mut bytes, Time::new(now), Time::new(end), good);
                    now = end;
                    let mut layouts = datagram::Layouts::new();
                    let mut at = 0;
                    while let Some(Ok(layout)) = layouts.next(&bytes[16..]) {
                        let wkc = u16::from_le_bytes([bytes[16 + layout.wkc()], bytes[17 + layout.wkc()]]);
                        prop_assert!(wkc <= most(list[at].0));
                        prop_assert!(!processed.destroyed || wkc == 0);
                        at += 1;
                    }
                }
                Act::Raw(mut bytes) => {
                    esc.process(&mut bytes, Time::new(now), Time::new(now + 5_760), true);
                    now += 5_760;
                }
                Act::PdiRead(at, len) => esc.pdi(Time::new(now)).read(at, &mut vec![0; len]),
                Act::PdiWrite(at, data) => esc.pdi(Time::new(now)).write(at, &data),
                Act::Wait(span) => now += span,
                Act::Port(port, link) => esc.set_port(PortNumber::ALL[port], link),
            }
        }
    }
}
