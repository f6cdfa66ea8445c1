//! A frame that only visits the SubDevices that it concerns leaves the same bytes and registers as
//! one that every ESC processes in turn.

use isocat_esc::{Chip, ET1100, ET1200, Esc, EscEvent, IP_CORE_32, LAN9252};
use isocat_sim::random::Stream;
use isocat_sim::segment::Segment;
use isocat_sim::{Cable, ClockModel, Connection, CpuModel, DeviceSetup};
use isocat_subdevice::description::{Behaviour, Description, ProcessDataArea};
use isocat_wire::datagram::Address;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{self, FrameWriter};
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};
use isocat_wire::{AutoIncrementAddress, Command, PortNumber, StationAddress};

static DESCRIPTION: Description = Description {
    objects: &[],
    mailbox: None,
    outputs: ProcessDataArea { sync_manager: 2, start: 0x1000, max_length: 64 },
    inputs: ProcessDataArea { sync_manager: 3, start: 0x1100, max_length: 64 },
    further_outputs: &[],
    further_inputs: &[],
    behaviour: Behaviour::DEFAULT,
};

/// AL events that are interrupts of the cycle: SM2, SM3.
const PROCESS_DATA: u32 = 1 << 10 | 1 << 11;
const COUNT: usize = 6;
const CHIPS: [&Chip; 4] = [&ET1100, &LAN9252, &IP_CORE_32, &ET1200];

fn sii() -> Vec<u8> {
    let mut image = vec![0; 256];
    let configuration = [0x05, 0x0C, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let header = isocat_wire::sii::Header { configuration, ..Default::default() };
    isocat_wire::sii::Writer::new(&mut image, &header).unwrap().finish().unwrap();
    image
}

fn segment() -> Segment {
    let connection = |position: usize| {
        let parent = position.checked_sub(1).map(|parent| (parent, PortNumber::P1));
        let device = DeviceSetup {
            chip: *CHIPS[position % CHIPS.len()],
            sii: sii().into(),
            description: DESCRIPTION.clone(),
            application: Box::new(()),
            // So slow that no CPU acts during the test, since the other side has none.
            cpu: CpuModel { reaction: isocat_wire::Nanos(1 << 50), ..CpuModel::default() },
            clock: ClockModel::constant(0),
            local_time: Time::ZERO,
            sampling: None,
        };
        Connection::new(parent, Cable::of_length(1_000), device)
    };
    Segment::new((0..COUNT).map(connection).collect(), 1)
}

/// The same ESCs, each of which processes the whole frame.
fn by_the_book() -> Vec<Esc<Vec<u8>>> {
    let esc = |position: usize| {
        let chip = CHIPS[position % CHIPS.len()];
        let mut esc = Esc::new(chip, sii(), vec![0; usize::from(chip.ram_kib) * 1024]);
        esc.set_port(PortNumber::P0, true);
        if position + 1 < COUNT {
            esc.set_port(PortNumber::P1, true);
        }
        esc
    };
    (0..COUNT).map(esc).collect()
}

struct Chance(Stream);

impl Chance {
    fn below(&mut self, end: u64) -> u64 {
        self.0.up_to(end - 1)
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len() as u64) as usize]
    }

    /// A frame with a few datagrams, most of which concern a SubDevice.
    fn frame(&mut self) -> Vec<u8> {
        let mut buffer = vec![0; frame::MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        for _ in 0..=self.below(5) {
            let command = self.of(&Command::ALL);
            let mut data = vec![0; 1 + self.below(24) as usize];
            data.iter_mut().for_each(|byte| *byte = self.below(4) as u8);
            let mut ado = self.of(&[
                0x0000, 0x0010, 0x0012, 0x0103, 0x0120, 0x0130, 0x0200, 0x0210, 0x0300, 0x0600,
                0x0610, 0x0800, 0x0810, 0x0900, 0x0910, 0x0920, 0x0928, 0x0981, 0x0990, 0x09A0,
                0x0F80, 0x1000, 0x1020, 0x1100,
            ]);
            if ado == 0x0103 {
                // The next register is 0x0108; further bytes could change loops, which must not
                // change here.
                data.truncate(1);
            }
            if self.below(4) == 0 {
                // A valid FMMU or SyncManager.
                let logical = self.below(0x60) as u32;
                let kind = 1 + self.below(3) as u8;
                let fmmu = Fmmu::bytes(logical, 1 + self.below(16) as u16, 0x1000, kind);
                let fmmu = Fmmu { logical_stop_bit: self.of(&[7, 7, 3]), ..fmmu };
                (ado, data) = (0x0600 + 16 * self.below(3) as u16, fmmu.to_bytes().to_vec());
            } else if self.below(6) == 0 {
                let control = self.of(&[0x20, 0x64, 0x22, 0x26, 0x74]);
                let start = self.of(&[0x1000, 0x1010, 0x1100]);
                let sync_manager = isocat_wire::sync_manager::SyncManager::new(
                    start,
                    1 + self.below(16) as u16,
                    control,
                    self.below(4) > 0,
                );
                ado = 0x0800 + 8 * self.below(4) as u16;
                data = sync_manager.to_bytes().to_vec();
            } else if ado == 0x0100 {
                // Loops stay automatic: their changes are not tested here.
                data = vec![self.below(2) as u8, 0];
            }
            let position = AutoIncrementAddress(0u16.wrapping_sub(self.below(8) as u16));
            let station = StationAddress(self.of(&[0, 1, 2, 3, 0x0101, 0x0202]));
            let address = match command {
                Command::Lrd | Command::Lwr | Command::Lrw => {
                    Address::Logical(self.below(0x70) as u32)
                }
                Command::Aprd | Command::Apwr | Command::Aprw | Command::Armw => {
                    Address::Position(position, ado)
                }
                Command::Brd | Command::Bwr | Command::Brw => Address::Broadcast(ado),
                _ => Address::Station(station, ado),
            };
            writer.push(command, 0, address, &data).unwrap();
        }
        let len = writer.finish();
        buffer.truncate(len);
        if self.below(20) == 0 {
            // An unknown command passes unchanged.
            buffer[16] = 0x55;
        }
        buffer
    }
}

#[test]
fn every_frame_comes_back_the_same() {
    let mut answered = 0u64;
    for seed in 1..=12 {
        let mut chance = Chance(Stream::new(seed, "frames", 0));
        let mut segment = segment();
        let mut book = by_the_book();
        let mut now = Time::<True>::new(1_000_000_000);
        let oscillator = segment.devices()[0].oscillator().clone();
        let read = |at: Time<True>| oscillator.read::<DeviceClock>(at);
        for number in 0..400 {
            let mut ours = chance.frame();
            let mut theirs = ours.clone();
            let duration = Picos(frame::duration_ns(ours.len()) as i64 * 1000);
            segment
                .pass(&mut ours, now, &mut isocat_sim::Watcher::blind())
                .expect("all loops stay as they are");
            // The path is that of this frame.
            let entries = segment.path().entries.clone();
            let returns = segment.path().returns.clone();
            let mut latching = vec![];
            for entry in &entries {
                let at = now + entry.after;
                let esc = &mut book[entry.device];
                while let Some((at, event)) = esc.step(read(at)) {
                    // The interrupt of a SubDevice reads its ESC, which restarts the PDI watchdog.
                    let interrupt = match event {
                        EscEvent::FrameEnd { al_events } => al_events & PROCESS_DATA != 0,
                        EscEvent::Sync0 | EscEvent::Sync1 => true,
                        _ => false,
                    };
                    if interrupt {
                        let _door = esc.pdi(at);
                    }
                }
                let processed = esc.process(&mut theirs, read(at), read(at + duration), true);
                if processed.latch_ports {
                    esc.receive_at_port(PortNumber::P0, read(at));
                    latching.push(entry.device);
                }
            }
            for back in returns.iter().filter(|back| latching.contains(&back.device)) {
                book[back.device].receive_at_port(back.port, read(now + back.after));
            }
            assert_eq!(ours, theirs, "seed {seed}, frame {number}");
            let payload = frame::payload(&ours).unwrap();
            answered += isocat_wire::datagram::datagrams(payload)
                .filter_map(|datagram| datagram.ok().map(|datagram| u64::from(datagram.wkc)))
                .sum::<u64>();
            now += duration + Picos(20_000_000);
        }
        segment.catch_up(&mut isocat_sim::Watcher::blind());
        for (position, (device, book)) in segment.devices().iter().zip(&book).enumerate() {
            let place = format!("seed {seed}, SubDevice {position}");
            let (a, b) = (&device.esc, book);
            assert_eq!(a.register(register::DL_STATUS), b.register(register::DL_STATUS), "{place}");
            assert_eq!(a.reach(), b.reach(), "{place}");
            for number in 0..3 {
                let fmmu = register::fmmu(number);
                assert_eq!(a.register(fmmu), b.register(fmmu), "{place}");
                let sm = register::sync_manager(number);
                assert_eq!(a.register(sm), b.register(sm), "{place}");
            }
            let difference = register::SYSTEM_TIME_DIFFERENCE;
            assert_eq!(a.register(difference), b.register(difference), "{place}");
            let epu = register::RECEIVE_TIME_EPU;
            assert_eq!(a.register(epu), b.register(epu), "{place}");
            let port = register::RECEIVE_TIME_1;
            assert_eq!(a.register(port), b.register(port), "{place}");
        }
    }
    // Two-sided: frames without any answer would all be equal.
    assert!((20_000..400_000).contains(&answered), "{answered} accesses");
}

/// Positions and the working counter have 16 bits: 65 535 SubDevices are the most that one BRD can
/// count. The auto-increment address is then -1, and with one more the count would be 0.
#[test]
fn a_line_of_65535_answers_a_broadcast_read() {
    for (count, counted) in [(65_535usize, 0xFFFFu16), (65_536, 0)] {
        let mut segment = Segment::new(crate::line::connections(count), 1);
        let mut buffer = [0; frame::MIN_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        let address = Address::Broadcast(register::TYPE.address);
        let at = writer.push(Command::Brd, 0, address, &[0]).unwrap();
        writer.finish();
        let start = Time::new(1_000_000_000);
        let back = segment
            .pass(&mut buffer, start, &mut isocat_sim::Watcher::blind())
            .expect("a whole line")
            .last_bit;
        assert_eq!(u16::from_le_bytes([buffer[at + 1], buffer[at + 2]]), counted, "{count}");
        assert_eq!(buffer[at], LAN9252.kind);
        let adp = u16::from_le_bytes([buffer[at - 8], buffer[at - 7]]);
        assert_eq!(adp, counted);
        assert!(back > start + Picos(count as i64 * 500_000), "{count}: the way takes its time");
    }
}

#[test]
fn a_short_line_exchanges_data_of_one_age() {
    let mut line = crate::line::Line::new(7);
    for _ in 0..50 {
        line.cycle();
    }
    line.assert_applications_ran();
}

#[test]
fn a_main_device_runs_the_line() {
    let mut world = crate::line::world(100).expect("the line comes up");
    assert_eq!(crate::line::run_cycles(&mut world, 50), 0, "wrong working counters");
}
