//! Observations of real chips, from captures of TwinCAT, SOEM and ethercrab on segments of ET1100,
//! ET1200, LAN9252 and IP cores. Each test is one observation, named by its number in the project's
//! list.
//!
//! Segments are assembled by hand: a frame is passed from one ESC to the next, and its arrival
//! times are computed here from the delays of the chips.

use isocat_esc::chip::PortKind;
use isocat_esc::{
    Chip, ET1100, ET1100_MII, ET1200, Esc, IP_CORE_32, IP_CORE_32_EMULATED, LAN9252, Pdi, PdiExt,
    XMC4800,
};
use isocat_wire::coe::{self, Service, sdo};
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::dl::DlStatus;
use isocat_wire::frame::{FrameWriter, MAX_LEN, duration_ns, payload};
use isocat_wire::mailbox::{self, Protocol};
use isocat_wire::register::{self, Register, Value};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{
    AlControl, AlStatus, AutoIncrementAddress, Command, ObjectAddress, PortNumber, StationAddress,
    Time, sii,
};

/// SII word 0: a CPU behind the PDI, SYNC and latch units on.
const WITH_DC: u16 = 0x0E80;
/// SII word 0: digital I/O, the ESC emulates the device, DC units off.
const SIMPLE: u16 = 0x0104;
/// SII word 0: a CPU behind the PDI, DC units off.
const WITHOUT_DC: u16 = 0x0280;

/// One ESC of a segment.
struct Station {
    esc: Esc<Vec<u8>>,
    /// Time from the arrival of a frame at the first ESC to its arrival at port 0 of this one, ns.
    lag: u64,
    /// Time from the arrival at the first ESC to the return at port 1, ns.
    back: Option<u64>,
}

impl Station {
    /// An ESC whose SII begins with `word_0`, with links at its first `links` ports.
    fn new(chip: &'static Chip, word_0: u16, links: usize) -> Self {
        let mut image = vec![0; 128];
        image[..2].copy_from_slice(&word_0.to_le_bytes());
        image[14] = sii::checksum(image[..14].try_into().expect("14 bytes"));
        image[0x10..0x18].copy_from_slice(&[0x02, 0, 0, 0, 0x52, 0x2C, 0x4C, 0x04]);
        let mut esc = Esc::new(chip, image, vec![0; usize::from(chip.ram_kib) * 1024]);
        for port in &PortNumber::ALL[..links] {
            esc.set_port(*port, true);
        }
        Self { esc, lag: 0, back: None }
    }

    /// The same ESC, whose local time is `local` when the frame that the segment gets at `START`
    /// arrives.
    fn with_times(mut self, lag: u64, back: Option<u64>, local: u64) -> Self {
        // The clock counts ticks of 10 ns.
        let local = local.wrapping_sub((START + lag) / 10 * 10);
        self.esc = self.esc.with_local_time(Time::new(local));
        (self.lag, self.back) = (lag, back);
        self
    }

    fn pdi(&mut self, now: u64) -> impl Pdi + '_ {
        self.esc.pdi(Time::new(now))
    }
}

/// The instant at which the segment gets its first frame.
const START: u64 = 100_000;

/// The answer to one datagram.
#[derive(Debug, PartialEq)]
struct Answer {
    adp: u16,
    irq: u16,
    data: Vec<u8>,
    wkc: u16,
}

struct Segment {
    stations: Vec<Station>,
    now: u64,
}

impl Segment {
    fn new(stations: Vec<Station>) -> Self {
        Self { stations, now: START }
    }

    fn one(chip: &'static Chip, word_0: u16) -> Self {
        Self::new(vec![Station::new(chip, word_0, 1)])
    }

    /// Sends a frame through all ESCs and handles its end everywhere.
    fn frame(&mut self, list: &[(Command, Address, &[u8])]) -> Vec<Answer> {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        for (command, address, data) in list {
            writer.push(*command, 0, *address, data).expect("the frame has room");
        }
        let len = writer.finish();
        let duration = duration_ns(len);
        let mut end = self.now + duration;
        for station in &mut self.stations {
            let arrival = self.now + station.lag;
            while station.esc.step(Time::new(arrival)).is_some() {}
            let (begin, over) = (Time::new(arrival), Time::new(arrival + duration));
            let processed = station.esc.process(&mut buffer[..len], begin, over, true);
            assert!(!processed.destroyed);
            if processed.latch_ports {
                station.esc.receive_at_port(PortNumber::P0, begin);
                if let Some(back) = station.back {
                    station.esc.receive_at_port(PortNumber::P1, Time::new(self.now + back));
                }
            }
            end = end.max(arrival + duration);
        }
        self.wait(end - self.now);
        datagrams(payload(&buffer[..len]).expect("a frame"))
            .map(|datagram| {
                let datagram = datagram.expect("a whole datagram");
                let header = datagram.header;
                let (adp, irq) = (header.adp(), header.irq);
                Answer { adp, irq, data: datagram.data.to_vec(), wkc: datagram.wkc }
            })
            .collect()
    }

    fn send(&mut self, command: Command, address: Address, data: &[u8]) -> Answer {
        self.frame(&[(command, address, data)]).remove(0)
    }

    fn brd(&mut self, ado: u16, len: usize) -> Answer {
        self.send(Command::Brd, Address::Broadcast(ado), &vec![0; len])
    }

    fn bwr(&mut self, ado: u16, data: &[u8]) -> u16 {
        self.send(Command::Bwr, Address::Broadcast(ado), data).wkc
    }

    /// Reads from the ESC at `position`.
    fn aprd(&mut self, position: u16, ado: u16, len: usize) -> Answer {
        let address = Address::Position(AutoIncrementAddress(0u16.wrapping_sub(position)), ado);
        self.send(Command::Aprd, address, &vec![0; len])
    }

    fn apwr(&mut self, position: u16, ado: u16, data: &[u8]) -> u16 {
        let address = Address::Position(AutoIncrementAddress(0u16.wrapping_sub(position)), ado);
        self.send(Command::Apwr, address, data).wkc
    }

    fn read<T: Value>(&mut self, position: u16, register: Register<T>) -> T {
        let answer = self.aprd(position, register.address, T::LEN);
        assert_eq!(answer.wkc, 1, "register {:#06x} of {position}", register.address);
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&answer.data);
        T::from_bytes(bytes)
    }

    fn wait(&mut self, time: u64) {
        self.now += time;
        for station in &mut self.stations {
            while station.esc.step(Time::new(self.now)).is_some() {}
        }
    }
}

/// An EK1100 with an ET1100, a terminal with an ET1200 whose DC units are off, and one with an
/// ET1100. Arrivals follow from the delays of the chips over EBUS, which has no PHYs; there are no
/// cables here. On the way down each chip adds a processing pass; on the way back the last one
/// processes and the others forward.
fn bus_coupler() -> Segment {
    let process = ET1100.processing_delay.0 as u64 / 1000;
    let forward = ET1100.forwarding_delay.0 as u64 / 1000;
    let first = Station::new(&ET1100, WITH_DC, 2);
    let second = Station::new(&ET1200, WITHOUT_DC, 2);
    let third = Station::new(&ET1100, WITH_DC, 1);
    Segment::new(vec![
        first.with_times(0, Some(3 * process + forward), 0x3C62_0F52),
        second.with_times(process, Some(3 * process), 0x3D0B_D6AE),
        third.with_times(2 * process, None, 0x0102_0304),
    ])
}

/// Two LAN9252 with a cable of one metre between them, 5 ns each way.
fn two_lan9252() -> Segment {
    let process = LAN9252.processing_delay.0 as u64 / 1000;
    let phys = 2 * LAN9252.port_delay(PortNumber::P1).0 as u64 / 1000;
    let hop = process + phys + 5;
    Segment::new(vec![
        Station::new(&LAN9252, WITH_DC, 2).with_times(0, Some(2 * hop), 0x1553_D022),
        Station::new(&LAN9252, WITH_DC, 1).with_times(hop, None, 0x7000_0000),
    ])
}

#[test]
fn vector_01_a_broadcast_read_is_ored() {
    let answer = bus_coupler().brd(0x0000, 1);
    assert_eq!(answer, Answer { adp: 3, irq: 0, data: vec![0x13], wkc: 3 });
}

#[test]
fn vector_02_two_lan9252() {
    let answer = two_lan9252().brd(0x0000, 2);
    assert_eq!(answer, Answer { adp: 2, irq: 0, data: vec![0xC0, 0x02], wkc: 2 });
}

#[test]
fn vector_03_receive_times_over_ebus() {
    let mut segment = bus_coupler();
    assert_eq!(segment.bwr(0x0900, &[0xEE; 8]), 3);
    let times = |segment: &mut Segment, position| {
        [register::RECEIVE_TIME_0, register::RECEIVE_TIME_1]
            .map(|register| segment.read(position, register))
    };
    let (first, second) = (times(&mut segment, 0), times(&mut segment, 1));
    assert_eq!(first, [0x3C62_0F52, 0x3C62_11AA]);
    assert_eq!(second, [0x3D0B_D6AE, 0x3D0B_D7E4]);
    let [first, second] = [first, second].map(|[t0, t1]| t1 - t0);
    assert_eq!([first, second], [600, 310]);
    // These are the delays that TwinCAT wrote: half of the loop without the next device's part.
    assert_eq!([(first - second) / 2, (first - second) / 2 + second / 2], [145, 300]);
}

#[test]
fn vector_04_receive_times_over_mii() {
    let mut segment = two_lan9252();
    assert_eq!(segment.bwr(0x0900, &[0]), 2);
    let (t0, t1) =
        (segment.read(0, register::RECEIVE_TIME_0), segment.read(0, register::RECEIVE_TIME_1));
    assert_eq!((t0, t1), (0x1553_D022, 0x1553_D5C2));
    assert_eq!((t1 - t0) / 2, 720);
}

#[test]
fn vector_05_the_epu_receives_what_port_0_receives() {
    for mut segment in [bus_coupler(), two_lan9252()] {
        segment.bwr(0x0900, &[0]);
        for position in 0..segment.stations.len() as u16 {
            let port = segment.read(position, register::RECEIVE_TIME_0);
            assert_ne!(port, 0);
            let epu = segment.aprd(position, 0x0918, 8);
            // The ET1200 in the middle does not have this register.
            if epu.wkc == 1 {
                assert_eq!(epu.data[..4], port.to_le_bytes(), "{position}");
            } else {
                assert_eq!(position, 1);
            }
        }
        // A later frame gives other receive times.
        segment.wait(1_000_000);
        let before = segment.read(0, register::RECEIVE_TIME_EPU) as u32;
        assert_eq!(segment.bwr(0x0900, &[0]), segment.stations.len() as u16);
        let port = segment.read(0, register::RECEIVE_TIME_0);
        assert_ne!(port, before);
        assert_eq!(segment.read(0, register::RECEIVE_TIME_EPU) as u32, port);
    }
}

#[test]
fn vector_06_an_et1200_with_its_dc_units_off() {
    let mut segment = Segment::one(&ET1200, WITHOUT_DC);
    assert_eq!(segment.brd(0x0900, 16).wkc, 1);
    assert_eq!(segment.bwr(0x0900, &[0; 4]), 1);
    for ado in [0x0910, 0x0918, 0x0920, 0x0928, 0x092C, 0x0981, 0x0990, 0x09A0] {
        assert_eq!((segment.brd(ado, 1).wkc, segment.bwr(ado, &[0])), (0, 0), "{ado:#06x}");
    }
    // The same chip with the units on has all of them, but 0x0918 and 0x092C are read-only.
    let mut segment = Segment::one(&ET1200, WITH_DC);
    for ado in [0x0910, 0x0918, 0x0920, 0x0928, 0x092C, 0x0981, 0x0990, 0x09A0] {
        assert_eq!(segment.brd(ado, 1).wkc, 1, "{ado:#06x}");
        let writable = !matches!(ado, 0x0918 | 0x092C);
        assert_eq!(segment.bwr(ado, &[0]), u16::from(writable), "{ado:#06x}");
    }
}

#[test]
fn vector_07_fmmus_and_sync_managers_beyond_the_chips_own() {
    for chip in [&ET1100, &ET1100_MII, &XMC4800] {
        let mut segment = Segment::one(chip, WITH_DC);
        for number in 8..16 {
            assert_eq!(segment.bwr(0x0600 + 16 * number, &[0; 16]), 0, "{}", chip.name);
            assert_eq!(segment.bwr(0x0800 + 8 * number, &[0; 8]), 0, "{}", chip.name);
        }
        assert_eq!(segment.bwr(0x0670, &[0; 16]), 1);
        assert_eq!(segment.bwr(0x0838, &[0; 8]), 1);
    }
    let mut segment = bus_coupler();
    assert_eq!(segment.bwr(0x0600, &[0; 256]), 3);
    assert_eq!(segment.bwr(0x0800, &[0; 256]), 3);
    // Three FMMUs and four SyncManagers at the one in the middle.
    assert_eq!((segment.bwr(0x0630, &[0; 16]), segment.bwr(0x0820, &[0; 8])), (2, 2));
}

#[test]
fn vector_08_nobody_writes_the_difference() {
    for chip in
        [&ET1100, &ET1100_MII, &ET1200, &IP_CORE_32, &IP_CORE_32_EMULATED, &LAN9252, &XMC4800]
    {
        let mut segment = Segment::one(chip, WITH_DC);
        assert_eq!(segment.bwr(0x092C, &[0; 4]), 0, "{}", chip.name);
        assert_eq!(segment.brd(0x092C, 4).wkc, 1, "{}", chip.name);
    }
}

#[test]
fn vector_09_the_reference_time_passes_a_device_without_clock() {
    let mut segment = bus_coupler();
    segment.apwr(0, 0x0010, &0x1001u16.to_le_bytes());
    let offset = 0x0123_4567_89AB_CDE0u64;
    assert_eq!(segment.apwr(0, 0x0920, &offset.to_le_bytes()), 1);
    let expected = segment.stations[0].esc.system_time(Time::new(segment.now)).count();
    let address = Address::Station(StationAddress(0x1001), 0x0910);
    let answer = segment.send(Command::Frmw, address, &[0; 8]);
    assert_eq!((answer.wkc, answer.adp), (2, 0x1001));
    assert_eq!(answer.data, expected.to_le_bytes());
    // The last one follows the reference and shows its difference, which was large.
    let difference = segment.read(2, register::SYSTEM_TIME_DIFFERENCE);
    assert_ne!(difference.0 & 0x7FFF_FFFF, 0);
    assert_eq!(segment.read(0, register::SYSTEM_TIME_DIFFERENCE).0, 0);
}

#[test]
fn vector_10_one_state_request_at_a_time() {
    let mut segment = Segment::new(vec![
        Station::new(&LAN9252, WITH_DC, 2),
        Station::new(&IP_CORE_32, WITH_DC, 1),
    ]);
    assert_eq!(segment.bwr(0x0120, &[0x11, 0]), 2);
    segment.wait(600_000 - 2 * duration_ns(60));
    assert_eq!(segment.bwr(0x0120, &[0x12, 0]), 0);
    let now = segment.now;
    for station in 0..2 {
        // The firmware of each device in turn reads the register; then the device takes part again.
        let asked = segment.stations[station].pdi(now).load(register::AL_CONTROL);
        assert_eq!(asked, AlControl(0x11));
        assert_eq!(segment.bwr(0x0120, &[0x11, 0]), 1);
    }
    for station in &mut segment.stations {
        station.pdi(segment.now).load(register::AL_CONTROL);
    }
    assert_eq!(segment.bwr(0x0120, &[0x11, 0]), 2);
}

#[test]
fn vector_11_an_emulated_device_mirrors_the_request() {
    let mut segment = Segment::one(&ET1100, SIMPLE);
    for asked in [0x0011, 0x0012, 0x0004] {
        assert_eq!(segment.bwr(0x0120, &u16::to_le_bytes(asked)), 1);
        assert_eq!(segment.read(0, register::AL_STATUS), AlStatus(asked));
    }
    // A device with a CPU does not mirror AL control.
    let mut segment = Segment::one(&ET1100, WITH_DC);
    segment.bwr(0x0120, &[0x12, 0]);
    assert_eq!(segment.read(0, register::AL_STATUS), AlStatus(1));
}

#[test]
fn vector_12_an_eeprom_read() {
    let mut segment = Segment::one(&ET1100, WITH_DC);
    assert_eq!(segment.apwr(0, 0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]), 1);
    segment.wait(1_000_000);
    let answer = segment.aprd(0, 0x0502, 14);
    let expected =
        [0x40, 0x00, 0x08, 0, 0, 0, 0x02, 0x00, 0x00, 0x00, 0x52, 0x2C, 0x4C, 0x04].to_vec();
    assert_eq!((answer.data, answer.wkc), (expected, 1));
}

#[test]
fn vector_13_the_eeprom_status() {
    for (chip, reading, idle) in [(&ET1100, 0x8140, 0x0040), (&ET1200, 0x8150, 0x0050)] {
        let mut segment = Segment::one(chip, WITH_DC);
        assert_eq!(segment.read(0, register::EEPROM_STATUS).0, idle);
        segment.apwr(0, 0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
        assert_eq!(segment.read(0, register::EEPROM_STATUS).0, reading);
        segment.wait(1_000_000);
        assert_eq!(segment.read(0, register::EEPROM_STATUS).0, idle);
    }
    // A second write comes before the memory has burnt the first.
    let mut segment = Segment::one(&ET1100, WITH_DC);
    segment.apwr(0, 0x0508, &[0x34, 0x12]);
    segment.apwr(0, 0x0502, &[0x01, 0x02, 0x04, 0, 0, 0]);
    assert_eq!(segment.read(0, register::EEPROM_STATUS).0, 0x8240);
    segment.wait(1_000_000);
    segment.apwr(0, 0x0502, &[0x01, 0x02, 0x05, 0, 0, 0]);
    segment.wait(1_000_000);
    assert_eq!(segment.read(0, register::EEPROM_STATUS).0, 0x2040);
    // TwinCAT repeats the command until it works.
    segment.wait(10_000_000);
    segment.apwr(0, 0x0502, &[0x01, 0x02, 0x05, 0, 0, 0]);
    segment.wait(1_000_000);
    assert_eq!(segment.read(0, register::EEPROM_STATUS).0, 0x0040);
    assert_eq!(segment.stations[0].esc.eeprom()[8..12], [0x34, 0x12, 0x34, 0x12]);
    // An IP core with an emulated EEPROM.
    let mut segment = Segment::one(&IP_CORE_32_EMULATED, WITH_DC);
    assert_eq!(segment.read(0, register::EEPROM_STATUS).0, 0x0020);
}

#[test]
fn vector_14_dl_status() {
    for (chip, word_0, served, links, expected) in [
        (&ET1100, 0x0100, false, 2, 0x5A31),
        (&ET1200, SIMPLE, false, 1, 0x5613),
        (&ET1100, 0x0C80, true, 2, 0x5A33),
        (&LAN9252, WITH_DC, true, 2, 0x5A37),
        (&ET1200, 0x0C80, true, 1, 0x5613),
        (&LAN9252, WITH_DC, true, 1, 0x5617),
    ] {
        let mut station = Station::new(chip, word_0, links);
        if served {
            station.pdi(START).events();
        }
        let mut segment = Segment::new(vec![station]);
        assert_eq!(segment.read(0, register::DL_STATUS), DlStatus(expected), "{}", chip.name);
    }
}

#[test]
fn vector_15_the_irq_field() {
    let mut segment = two_lan9252();
    assert_eq!(segment.brd(0x0130, 2).irq, 0);
    assert_eq!(segment.bwr(0x0200, &[0x04, 0x00]), 2);
    assert_eq!(segment.brd(0x0130, 2).irq, 0x0004);
    // Reading the high byte of DL status is enough, but both statuses must be read.
    segment.aprd(0, 0x0111, 1);
    assert_eq!(segment.brd(0x0130, 2).irq, 0x0004);
    segment.aprd(1, 0x0111, 1);
    assert_eq!(segment.brd(0x0130, 2).irq, 0);
}

/// A device with mailboxes of 128 bytes at 0x1000 and 0x1080.
fn mailboxes() -> Segment {
    let mut segment = Segment::one(&LAN9252, WITH_DC);
    segment.apwr(0, 0x0010, &0x1001u16.to_le_bytes());
    let out = SyncManager::new(0x1000, 128, SyncManager::MAILBOX_OUT, true).to_bytes();
    let back = SyncManager::new(0x1080, 128, SyncManager::MAILBOX_IN, true).to_bytes();
    assert_eq!(segment.apwr(0, 0x0800, &[out, back].concat()), 1);
    segment
}

fn station(ado: u16) -> Address {
    Address::Station(StationAddress(0x1001), ado)
}

#[test]
fn vector_16_mailbox_status() {
    let mut segment = mailboxes();
    let [sm0, sm1] = [0, 1].map(register::sm_status);
    assert_eq!((segment.read(0, sm0), segment.read(0, sm1)), (0x00, 0x00));
    segment.send(Command::Fpwr, station(0x1000), &[1; 128]);
    let now = segment.now;
    segment.stations[0].pdi(now).read(0x1000, &mut [0; 128]);
    assert_eq!(segment.read(0, sm0), 0x02);
    let now = segment.now;
    segment.stations[0].pdi(now).write(0x1080, &[2; 128]);
    assert_eq!(segment.read(0, sm1), 0x09);
    segment.send(Command::Fprd, station(0x1080), &[0; 128]);
    // The CPU opens the buffer for the next message, which acknowledges that the mailbox was read.
    let now = segment.now;
    segment.stations[0].pdi(now).write(0x1080, &[0]);
    assert_eq!(segment.read(0, sm1), 0x80);
}

#[test]
fn vector_17_an_empty_mailbox() {
    let mut segment = mailboxes();
    let answer = segment.send(Command::Fprd, station(0x1080), &[0x5A; 2]);
    assert_eq!((answer.wkc, answer.data), (0, vec![0x5A; 2]));
    let now = segment.now;
    segment.stations[0].pdi(now).write(0x1080, &[7; 128]);
    let answer = segment.send(Command::Fprd, station(0x1080), &[0x5A; 2]);
    assert_eq!((answer.wkc, answer.data), (1, vec![7; 2]));
}

/// TwinCAT uses the mailboxes in this way: the message, and the last byte, in one frame.
#[test]
fn vector_18_an_sdo_upload() {
    let mut segment = mailboxes();
    for counter in 1..=3 {
        let request = {
            let mut bytes = [0; 16];
            bytes[..12].copy_from_slice(&[0x0A, 0, 0, 0, 0, 0x03, 0, 0x20, 0x40, 0x0A, 0x10, 0]);
            bytes[5] |= counter << 4;
            bytes
        };
        let answers = segment.frame(&[
            (Command::Fpwr, station(0x1000), &request),
            (Command::Fpwr, station(0x107F), &[0]),
        ]);
        assert!(answers.iter().all(|answer| answer.wkc == 1));
        let now = segment.now;
        let mut pdi = segment.stations[0].esc.pdi(Time::new(now));
        let mut received = [0xEE; 128];
        pdi.read(0x1000, &mut received);
        assert_eq!(received[..16], request);
        let header = mailbox::Header::parse(received.first_chunk().expect("six bytes"));
        assert_eq!(header, mailbox::Header::new(10, 0, Protocol::COE, counter));
        assert_eq!(coe::Header::parse([received[6], received[7]]).service, Service::SDO_REQUEST);
        let asked = sdo::Initiate::parse(received[8..16].try_into().expect("eight bytes"));
        let object = ObjectAddress::new(0x100A, 0);
        assert_eq!((asked.command, asked.object), (sdo::Command::upload_request(false), object));
        let command = sdo::Command::upload_expedited(2, false);
        let answer = sdo::Initiate { command, object, data: *b"08\0\0" };
        let mut reply = [0; 128];
        reply[..6].copy_from_slice(&header.emit());
        reply[6..8].copy_from_slice(&coe::Header::new(Service::SDO_RESPONSE).emit());
        reply[8..16].copy_from_slice(&answer.emit());
        pdi.write(0x1080, &reply);
        let answers = segment.frame(&[
            (Command::Fprd, station(0x1080), &[0; 16]),
            (Command::Fprd, station(0x10FF), &[0]),
        ]);
        assert!(answers.iter().all(|answer| answer.wkc == 1));
        let mut captured =
            [0x0A, 0, 0, 0, 0, 0x03, 0, 0x30, 0x4B, 0x0A, 0x10, 0, 0x30, 0x38].to_vec();
        captured[5] |= counter << 4;
        assert_eq!(answers[0].data[..14], captured);
        assert_eq!(segment.read(0, register::sm_status(1)) & 0x08, 0, "read, so empty");
    }
}

#[test]
fn vector_19_a_clock_of_32_bits() {
    assert_eq!(IP_CORE_32.port(PortNumber::P1), PortKind::Mii);
    let station = Station::new(&IP_CORE_32, WITH_DC, 1);
    let mut segment = Segment::new(vec![station.with_times(0, None, 0xFFFF_FF00)]);
    assert_eq!(segment.bwr(0x0920, &[0xFF; 8]), 1);
    segment.bwr(0x0900, &[0]);
    let data = segment.aprd(0, 0x0900, 32).data;
    assert_ne!(data[..4], [0; 4]);
    assert_ne!(data[0x10..0x14], [0; 4]);
    assert_eq!((&data[0x14..0x18], &data[0x1C..0x20]), (&[0; 4][..], &[0; 4][..]));
    assert_eq!(segment.aprd(0, 0x0920, 8).data, [0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0]);
    // Ports without a link keep what they had, also while a frame latches the others.
    let (before, stale) = (data[..4].to_vec(), data[4..16].to_vec());
    segment.wait(1_000);
    segment.bwr(0x0900, &[0]);
    let data = segment.aprd(0, 0x0900, 32).data;
    assert_ne!(data[..4], before);
    assert_eq!(data[4..16], stale);
    // A 64-bit chip shows its upper half.
    let station = Station::new(&ET1100, WITH_DC, 1);
    let mut segment = Segment::new(vec![station.with_times(0, None, 0x5_0000_0000)]);
    segment.bwr(0x0900, &[0]);
    let data = segment.aprd(0, 0x0900, 32).data;
    assert_eq!((data[0x14], data[0x1C]), (5, 5));
}
