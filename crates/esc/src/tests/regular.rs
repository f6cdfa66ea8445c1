//! The fast path for cyclic datagrams has the same effects as the slow one, to the last register.

use std::format;

use isocat_wire::datagram::{Address, Layout, Layouts};
use isocat_wire::dc::SyncActivation;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{FrameWriter, LOCALLY_ADMINISTERED, MAX_LEN, duration_ns, payload_offset};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Device;
use isocat_wire::{AutoIncrementAddress, Command, StationAddress, Time, register};

use super::*;
use crate::{
    Chip, CyclicFrame, ET1100, IP_CORE_32, IP_CORE_32_EMULATED, LAN9252, Processed, XMC4800,
};

/// Two ESCs with the same history; one of them takes the slow path only.
struct Twins {
    both: [Esc<Vec<u8>>; 2],
    now: u64,
    chance: u64,
    short: u64,
    whole: u64,
    /// The frames that were passed as a whole: the number of each is its place, from 1 on.
    passed: Vec<Vec<(Command, Layout)>>,
    last: Vec<(Command, Address, Vec<u8>)>,
}

/// Passes a frame as a whole, if it is regular.
fn pass_whole(
    esc: &mut Esc<Vec<u8>>,
    bytes: &mut [u8],
    times: (Time<Device>, Time<Device>),
    passed: &mut Vec<Vec<(Command, Layout)>>,
) -> bool {
    if esc.stops_circulating() {
        return false;
    }
    let offset = payload_offset(bytes).expect("a frame of datagrams");
    let payload = &mut bytes[offset..];
    let mut layouts = Layouts::new();
    let mut all = Vec::new();
    while let Some(layout) = layouts.next(payload) {
        let layout = layout.expect("a whole datagram");
        all.push((layout.header.command().expect("a known command"), layout));
    }
    let Some(mut frame) = CyclicFrame::of(all.iter().copied()) else { return false };
    // Some frames have no number.
    if !times.0.count().is_multiple_of(8) {
        let known = passed.iter().position(|layouts| *layouts == all);
        let number = known.unwrap_or(passed.len());
        if known.is_none() {
            passed.push(all.clone());
        }
        frame = frame.numbered(number as u64 + 1);
    }
    frame.read_time(payload);
    let label = times.0.count();
    if esc.pass_cyclic(times.0, || times.1, label, &mut frame, 0, payload).is_none() {
        return false;
    }
    // The rest is left to the caller.
    for (number, count) in frame.finish(payload) {
        let at = all[number].1.wkc();
        let before = u16::from_le_bytes([payload[at], payload[at + 1]]);
        payload[at..at + 2].copy_from_slice(&before.wrapping_add(count).to_le_bytes());
    }
    for (command, layout) in all {
        if command.increments_position() {
            let adp = layout.header.adp().wrapping_add(1);
            payload[layout.start + 2..layout.start + 4].copy_from_slice(&adp.to_le_bytes());
        }
    }
    if esc.marks_frames() {
        bytes[6] |= LOCALLY_ADMINISTERED;
    }
    true
}

impl Twins {
    fn new(chip: &'static Chip, seed: u64) -> Self {
        let both = [true, false].map(|lane| {
            let ram = vec![0; usize::from(chip.ram_kib) * 1024];
            let mut esc = Esc::new(chip, image(SII), ram);
            esc.set_port(PortNumber::P0, true);
            esc.set_lane(lane);
            esc
        });
        Self {
            both,
            now: 1_000,
            chance: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
            short: 0,
            whole: 0,
            passed: Vec::new(),
            last: Vec::new(),
        }
    }

    fn below(&mut self, end: u64) -> u64 {
        self.chance ^= self.chance << 13;
        self.chance ^= self.chance >> 7;
        self.chance ^= self.chance << 17;
        (self.chance >> 20) % end
    }

    fn same<T: PartialEq + core::fmt::Debug>(
        &mut self,
        what: &str,
        mut of: impl FnMut(&mut Esc<Vec<u8>>) -> T,
    ) {
        let [one, other] = &mut self.both;
        assert_eq!(of(one), of(other), "{what} at {}", self.now);
    }

    fn compare(&mut self) {
        let at = Time::new(self.now);
        self.same("registers", |esc| esc.registers());
        self.same("RAM", |esc| esc.ram()[..0x600].to_vec());
        self.same("due", |esc| (esc.next_event(), esc.last_frame()));
        self.same("labels", |esc| (esc.label(2), esc.label(3), esc.al_events(at)));
        self.same("reach", |esc| (esc.reach(), esc.reach_version(), esc.reach_is_changing()));
        self.same("clock", |esc| (esc.system_time(at), esc.local_time(at), esc.loops_pending()));
        self.same("SYNC", |esc| (esc.sync_signals(at), esc.sync_pulses_without_edge()));
        self.same("units", |esc| format!("{:?} {:?}", esc.dc.sync, esc.watchdog));
    }

    fn live(&mut self, for_ns: u64) {
        self.now += for_ns;
        let limit = Time::new(self.now);
        loop {
            let [one, other] = self.both.each_mut().map(|esc| esc.step(limit));
            assert_eq!(one, other, "events up to {}", self.now);
            if one.is_none() {
                break;
            }
        }
    }

    fn frame(&mut self, good: bool, list: &[(Command, Address, &[u8])]) {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        for (index, (command, address, data)) in list.iter().enumerate() {
            writer.push(*command, index as u8, *address, data).expect("the frame has room");
        }
        let len = writer.finish();
        let (start, end) = (Time::new(self.now), Time::new(self.now + duration_ns(len)));
        let mut whole = 0;
        let passed = &mut self.passed;
        let [one, other] = self.both.each_mut().map(|esc| {
            let mut bytes = buffer;
            if good && esc.lane && pass_whole(esc, &mut bytes[..len], (start, end), passed) {
                whole += 1;
                return (bytes[..len].to_vec(), Processed::default());
            }
            let processed = esc.process(&mut bytes[..len], start, end, good);
            esc.label_frame(start.count());
            (bytes[..len].to_vec(), processed)
        });
        assert_eq!(one, other, "frame at {}: {list:?}", self.now);
        self.whole += whole;
        let [esc, _] = &self.both;
        self.short += u64::from(good && esc.shadow.is_empty() && esc.flight.end != Time::NEVER);
    }

    fn pdi(&mut self, act: impl Fn(&mut dyn Pdi) -> Vec<u8>) {
        let at = Time::new(self.now);
        let [one, other] = self.both.each_mut().map(|esc| act(&mut esc.pdi(at)));
        assert_eq!(one, other, "PDI at {}", self.now);
    }

    fn configure(&mut self) {
        let length = [2, 16, 5, 1][self.below(4) as usize];
        let watchdog = if self.below(2) == 0 { 0 } else { SyncManager::CONTROL_WATCHDOG };
        let outputs = SyncManager::new(0x1000, length, SyncManager::OUTPUTS | watchdog, true);
        let inputs = SyncManager::new(0x1200, length, SyncManager::INPUTS, true);
        let (kinds, further) = ([Fmmu::WRITE, Fmmu::READ], self.below(6));
        let mut fmmus = [0; 48];
        for (at, (kind, start)) in kinds.into_iter().zip([0x1000, 0x1200]).enumerate() {
            let fmmu = Fmmu::bytes(0x100, length, start, kind);
            fmmus[at * 16..][..16].copy_from_slice(&fmmu.to_bytes());
        }
        if further == 0 {
            let status = Fmmu::bytes(0x120, 1, 0x080D, Fmmu::READ);
            fmmus[32..].copy_from_slice(&status.to_bytes());
        }
        let own = |ado| Address::Position(AutoIncrementAddress(0), ado);
        self.frame(
            true,
            &[
                (Command::Apwr, own(register::STATION_ADDRESS.address), &[0x01, 0x10]),
                (Command::Apwr, own(register::sync_manager(2).address), &outputs.to_bytes()),
                (Command::Apwr, own(register::sync_manager(3).address), &inputs.to_bytes()),
                (Command::Apwr, own(register::fmmu(0).address), &fmmus),
            ],
        );
        self.live(200_000);
        let start = self.both[0].system_time(Time::new(self.now)).count() + 500_000;
        let bits = SyncActivation::ACTIVE | SyncActivation::SYNC0;
        self.frame(
            true,
            &[
                (Command::Apwr, own(register::SYNC0_CYCLE.address), &100_000u32.to_le_bytes()),
                (Command::Apwr, own(register::SYNC_START_TIME.address), &start.to_le_bytes()),
                (Command::Apwr, own(register::SYNC_ACTIVATION.address), &[bits]),
            ],
        );
        self.live(50_000);
    }

    /// A cyclic frame, or one that also contains something else.
    fn any_frame(&mut self) {
        let now = self.both[1].system_time(Time::new(self.now)).count();
        let time = now.wrapping_add(self.below(4_000)).wrapping_sub(2_000).to_le_bytes();
        let width = if self.below(8) == 0 { self.below(9) as usize } else { 8 };
        let image: Vec<u8> = (0..64).map(|_| self.below(256) as u8).collect();
        let leader = [0x1002, 0x1001][usize::from(self.below(10) == 0)];
        let station = |station, ado| Address::Station(StationAddress(station), ado);
        let mut list: Vec<(Command, Address, Vec<u8>)> = Vec::new();
        for _ in 0..1 + self.below(4) {
            let irregular = self.below(12) == 0;
            list.push(match (irregular, self.below(8)) {
                (false, 0..2) => {
                    (Command::Frmw, station(leader, 0x0910), time[..width.max(1)].to_vec())
                }
                (false, 2) => {
                    let position = self.below(2) as u16;
                    let address = Address::Position(AutoIncrementAddress(position), 0x0910);
                    (Command::Armw, address, time[..width.max(1)].to_vec())
                }
                (false, 3..6) => {
                    let command = [Command::Lrw, Command::Lrd, Command::Lwr];
                    let command = command[self.below(3) as usize];
                    let first = 0xFC + self.below(6) as u32;
                    let len = if self.below(5) == 0 { self.below(60) as usize } else { 60 };
                    (command, Address::Logical(first), image[..len.max(1)].to_vec())
                }
                (false, _) => (Command::Brd, Address::Broadcast(0x0130), vec![1, 2]),
                (true, 0) => (Command::Fpwr, station(0x1001, 0x0911), vec![7]),
                (true, 1) => (Command::Bwr, Address::Broadcast(0x0910), time[..4].to_vec()),
                (true, 2) => (Command::Fpwr, station(0x1001, 0x0930), vec![0, 0x10]),
                (true, 3) => (Command::Fprw, station(0x1001, 0x0F80), vec![1, 2, 3]),
                (true, 4) => (Command::Bwr, Address::Broadcast(0x0900), vec![0; 4]),
                (true, 5) => {
                    let on = self.below(2) as u8;
                    (Command::Fpwr, station(0x1001, 0x0816 + 8 * self.below(2) as u16), vec![on])
                }
                (true, 6) => (Command::Fpwr, station(0x1001, 0x0120), vec![2, 0]),
                (true, _) => {
                    // A write to write protection, or FMMUs that end.
                    let address = [0x0021, 0x0031, 0x060C, 0x0200][self.below(4) as usize];
                    (Command::Fpwr, station(0x1001, address), vec![self.below(2) as u8])
                }
            });
        }
        // Often the last datagrams come again.
        if self.last.is_empty() || self.below(2) == 0 {
            self.last = list;
        }
        let list = core::mem::take(&mut self.last);
        let datagrams: Vec<_> = list.iter().map(|(c, a, d)| (*c, *a, &d[..])).collect();
        let good = self.below(12) != 0;
        self.frame(good, &datagrams);
        self.last = list;
    }

    fn any_access(&mut self) {
        let first = self.below(256) as u8;
        match self.below(8) {
            0..3 => self.pdi(|pdi| {
                let mut data = [0; 16];
                pdi.read(0x1000, &mut data);
                data.to_vec()
            }),
            3..6 => self.pdi(|pdi| {
                pdi.write(0x1200, &[first; 16]);
                Vec::new()
            }),
            6 => {
                let address = 0x0817 + 8 * self.below(2) as u16;
                let off = u8::from(self.below(4) == 0);
                self.pdi(|pdi| {
                    pdi.write(address, &[off]);
                    Vec::new()
                });
            }
            _ => self.pdi(|pdi| {
                let mut data = [0; 0x20];
                pdi.read(0x0120, &mut data);
                data.to_vec()
            }),
        }
    }
}

#[test]
fn both_ways_of_a_frame_are_one() {
    let chips = [&LAN9252, &ET1100, &IP_CORE_32, &XMC4800, &IP_CORE_32_EMULATED];
    let (mut short, mut whole) = (0, 0);
    for seed in 0..400 {
        let mut twins = Twins::new(chips[seed as usize % chips.len()], seed + 1);
        twins.configure();
        for _ in 0..60 {
            match twins.below(5) {
                0..3 => twins.any_frame(),
                3 => twins.any_access(),
                _ => {}
            }
            twins.compare();
            let pause = [100, 9_000, 60_000, 700_000][twins.below(4) as usize];
            twins.live(pause);
            twins.compare();
        }
        short += twins.short;
        whole += twins.whole;
    }
    assert!(short > 3_000, "the short way was gone {short} times");
    assert!(whole > 1_000, "frames passed as a whole {whole} times");
}
