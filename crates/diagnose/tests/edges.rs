//! Tests each finding at its edge: on one side nothing is found; one step further, the finding is
//! there. The captures are made by hand, with the frames of one device and its MainDevice.

use std::ops::Range;

use isocat_diagnose::{DiagnoseReport, Diagnosis, Names};
use isocat_wire::coe::{self, Service, sdo};
use isocat_wire::datagram::Address;
use isocat_wire::frame::{FrameWriter, duration_ns};
use isocat_wire::mailbox::{self, Protocol};
use isocat_wire::{AutoIncrementAddress, Command, ObjectAddress, StationAddress};

const CYCLE: u64 = 1_000_000;
const STATION: u16 = 0x1001;
/// System time of the reference when SYNC is switched on.
const NOW: u64 = 5_000_000_000;

/// What the segment with one device does.
#[derive(Clone)]
struct Setup {
    /// SYNC0 start time.
    start: u64,
    /// From the start of a frame at the device to the next SYNC0.
    ahead: u64,
    /// 0x1C32:01, :05 and :06.
    mode: u16,
    minimum: u32,
    copy: u32,
    /// 0x0400 and 0x0420.
    divider: u16,
    watchdog: u16,
    /// 0x092C in operation.
    difference: u32,
    /// How much cycle 50 is late, in the time of the reference.
    late: u64,
    /// How much each cycle is longer than its nominal length.
    drift: i64,
    /// Cyclic frames carry the reference's time.
    led: bool,
    /// Length of a pause of cyclic frames by the stamps, after cycle 60.
    pause_us: u64,
    /// Length of a jump of the stamps alone, after cycle 60.
    jump_us: u64,
    /// SYNC0 cycle; by default that of the frames.
    cycle: u64,
    /// 0x0920 is written, and SYNC is switched on before SAFEOP.
    offset: bool,
    in_preop: bool,
    /// AssignActivate.
    sync: [u8; 2],
    /// AL status and code that are read after cycle 70.
    status: [u8; 6],
    /// AL control that is written before that.
    control: Option<u8>,
    /// Frames from another source, one after each of the last cycles.
    strangers: usize,
    /// A frame from another source that asks all for a state, after cycle 30.
    meddles: Option<u8>,
    /// The cycle after which SYNC0 is switched off.
    sync_off: u64,
    /// 0x0110; 0: not read.
    links: u8,
    /// Cycles in operation.
    cycles: u64,
    /// States are read after OP was requested.
    looks: bool,
    /// The cycles whose frames do not come back.
    lost: Range<u64>,
    /// Number of cycles at the end in which the device counts nothing and leaves frames unchanged.
    gone: u64,
    /// How much later the frame of cycle 50 comes a second time, ns; 0: it does not.
    again: u64,
    /// All frames have the same index.
    one_index: bool,
    /// The device's own clock when SYNC is switched on, if it is read.
    own_time: Option<u64>,
    /// An SDO request in INIT, and when its answer is fetched, us.
    early_us: Option<u64>,
    /// How often the answer to an SDO request in operation is looked for, each 125 cycles.
    looked_for: u64,
    /// OP is refused, so long after the request, us, with this code; no process data come.
    refused: Option<(u64, u8)>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            start: NOW + 100 * CYCLE,
            ahead: CYCLE / 2,
            mode: 2,
            minimum: 100_000,
            copy: 50_000,
            divider: 2498,
            watchdog: 1000,
            difference: 0,
            late: 0,
            drift: 0,
            led: true,
            pause_us: 0,
            jump_us: 0,
            cycle: CYCLE,
            offset: true,
            in_preop: true,
            sync: [0, 3],
            status: [8, 0, 0, 0, 0, 0],
            control: None,
            strangers: 0,
            meddles: None,
            sync_off: u64::MAX,
            links: 0,
            cycles: 100,
            looks: true,
            lost: 0..0,
            gone: 0,
            again: 0,
            one_index: false,
            own_time: None,
            early_us: None,
            looked_for: 0,
            refused: None,
        }
    }
}

/// A datagram: command, address, data on the way out, data on the way back, working counter.
type Sent<'a> = (Command, Address, &'a [u8], &'a [u8], u16);

/// A pcap file that is being written.
struct Wire {
    file: Vec<u8>,
    micros: u64,
    index: u8,
}

impl Wire {
    fn new() -> Self {
        let mut file = 0xA1B2_C3D4_u32.to_le_bytes().to_vec();
        file.extend([2, 0, 4, 0]);
        file.extend([0; 8]);
        file.extend(0xFFFF_u32.to_le_bytes());
        file.extend(1_u32.to_le_bytes());
        Self { file, micros: 0, index: 0 }
    }

    /// Writes a frame that goes out and comes back 20 us later.
    fn exchange(&mut self, list: &[Sent<'_>]) -> usize {
        self.exchange_of(0x10, list)
    }

    fn exchange_of(&mut self, source: u8, list: &[Sent<'_>]) -> usize {
        self.index = self.index.wrapping_add(1);
        let mut len = 0;
        for back in [false, true] {
            let mut buffer = [0; 1514];
            let mark = if back { 2 } else { 0 };
            let mut writer = FrameWriter::new(&mut buffer, [source | mark, 1, 2, 3, 4, 5]);
            let mut ends = Vec::new();
            for (command, address, out, answer, wkc) in list {
                let data = if back { answer } else { out };
                let at = writer.push(*command, self.index, *address, data).expect("room");
                ends.push((at, data.len(), command.increments_position(), *wkc));
            }
            len = writer.finish();
            for (at, data, counts, wkc) in ends.into_iter().filter(|_| back) {
                buffer[at + data..at + data + 2].copy_from_slice(&wkc.to_le_bytes());
                if counts {
                    // The frame passes one device.
                    let position = u16::from_le_bytes([buffer[at - 8], buffer[at - 7]]);
                    let position = position.wrapping_add(1).to_le_bytes();
                    buffer[at - 8..at - 6].copy_from_slice(&position);
                }
            }
            self.packet(&buffer[..len]);
            self.micros += 20;
        }
        len
    }

    fn packet(&mut self, bytes: &[u8]) {
        for number in [self.micros / 1_000_000, self.micros % 1_000_000] {
            self.file.extend((number as u32).to_le_bytes());
        }
        for _ in 0..2 {
            self.file.extend((bytes.len() as u32).to_le_bytes());
        }
        self.file.extend(bytes);
    }

    fn write(&mut self, address: u16, data: &[u8]) {
        let to = Address::Station(StationAddress(STATION), address);
        self.exchange(&[(Command::Fpwr, to, data, data, 1)]);
    }

    fn read(&mut self, address: u16, data: &[u8]) {
        let to = Address::Station(StationAddress(STATION), address);
        self.exchange(&[(Command::Fprd, to, &vec![0; data.len()], data, 1)]);
    }

    /// An SDO message for a mailbox.
    fn mail(&mut self, service: Service, initiate: sdo::Initiate) -> Vec<u8> {
        let mut data = mailbox::Header::new(10, 0, Protocol::COE, 1).emit().to_vec();
        data.extend(coe::Header::new(service).emit());
        data.extend(initiate.emit());
        data.resize(64, 0);
        data
    }

    /// A request for 0x1C32:01 without its answer.
    fn ask(&mut self) {
        let (object, data) = (ObjectAddress::new(0x1C32, 1), [0; 4]);
        let request = sdo::Initiate { command: sdo::Command::upload_request(false), object, data };
        let request = self.mail(Service::SDO_REQUEST, request);
        self.write(0x1000, &request);
    }

    /// The MainDevice reads or writes an entry.
    fn sdo(&mut self, index: u16, sub: u8, value: &[u8], written: bool) {
        let object = ObjectAddress::new(index, sub);
        let mut data = [0; 4];
        data[..value.len()].copy_from_slice(value);
        let (request, answer) = match written {
            true => (
                sdo::Command::download_expedited(value.len(), false),
                sdo::Command::download_response(false),
            ),
            false => (
                sdo::Command::upload_request(false),
                sdo::Command::upload_expedited(value.len(), false),
            ),
        };
        let out =
            sdo::Initiate { command: request, object, data: if written { data } else { [0; 4] } };
        let back =
            sdo::Initiate { command: answer, object, data: if written { [0; 4] } else { data } };
        let out = self.mail(Service::SDO_REQUEST, out);
        let back = self.mail(Service::SDO_RESPONSE, back);
        self.write(0x1000, &out);
        self.read(0x1080, &back);
    }

    /// A cyclic frame that reaches the device at system time `at`.
    fn cycle(&mut self, at: u64, led: bool) -> usize {
        let time = Address::Station(StationAddress(STATION), 0x0910);
        let exchanged = (Command::Lrw, Address::Logical(0), &[1_u8, 2][..], &[1_u8, 2][..], 3);
        match led {
            true => {
                let time = (Command::Frmw, time, &[0_u8; 8][..], &at.to_le_bytes()[..], 1);
                self.exchange(&[time, exchanged])
            }
            false => self.exchange(&[exchanged]),
        }
    }

    /// A cyclic frame that no device answers.
    fn cycle_alone(&mut self) -> usize {
        let time = Address::Station(StationAddress(STATION), 0x0910);
        let exchanged = (Command::Lrw, Address::Logical(0), &[1_u8, 2][..], &[1_u8, 2][..], 0);
        self.exchange(&[(Command::Frmw, time, &[0; 8], &[0; 8], 0), exchanged])
    }
}

impl Setup {
    fn report(&self) -> DiagnoseReport {
        let mut wire = Wire::new();
        let first = Address::Position(AutoIncrementAddress(0), 0x0010);
        let station = STATION.to_le_bytes();
        wire.exchange(&[(Command::Apwr, first, &station, &station, 1)]);
        wire.read(0x0130, &[1, 0, 0, 0, 0, 0]);
        if self.links != 0 {
            wire.read(0x0110, &[self.links, 0]);
        }
        wire.write(0x0800, &[0x00, 0x10, 64, 0, 0x26, 0, 1, 0, 0x80, 0x10, 64, 0, 0x22, 0, 1, 0]);
        if let Some(after) = self.early_us {
            let object = ObjectAddress::new(0x1C32, 1);
            let command = sdo::Command::upload_expedited(2, false);
            let answer = sdo::Initiate { command, object, data: [2, 0, 0, 0] };
            let answer = wire.mail(Service::SDO_RESPONSE, answer);
            let asked = wire.micros;
            wire.ask();
            wire.micros = asked + after;
            wire.read(0x1080, &answer);
        }
        wire.write(0x0120, &[2, 0]);
        wire.read(0x0130, &[2, 0, 0, 0, 0, 0]);
        wire.sdo(0x1C32, 1, &self.mode.to_le_bytes(), true);
        wire.sdo(0x1C32, 5, &self.minimum.to_le_bytes(), false);
        wire.sdo(0x1C32, 6, &self.copy.to_le_bytes(), false);
        wire.write(0x0810, &[0x00, 0x11, 2, 0, 0x64, 0, 1, 0]);
        wire.write(0x0600, &[0, 0, 0, 0, 2, 0, 0, 7, 0x00, 0x11, 0, 2, 1, 0, 0, 0]);
        wire.write(0x0400, &self.divider.to_le_bytes());
        wire.write(0x0420, &self.watchdog.to_le_bytes());
        let time = Address::Station(StationAddress(STATION), 0x0910);
        if self.led {
            wire.exchange(&[(Command::Frmw, time, &[0; 8], &NOW.to_le_bytes(), 1)]);
        }
        if self.offset {
            wire.write(0x0920, &[0; 8]);
        }
        if !self.in_preop {
            wire.write(0x0120, &[4, 0]);
            wire.read(0x0130, &[4, 0, 0, 0, 0, 0]);
        }
        wire.write(0x09A0, &(self.cycle as u32).to_le_bytes());
        wire.write(0x0990, &self.start.to_le_bytes());
        if let Some(own) = self.own_time {
            let first = Address::Position(AutoIncrementAddress(0), 0x0910);
            wire.exchange(&[(Command::Aprd, first, &[0; 8], &own.to_le_bytes(), 1)]);
        }
        wire.write(0x0980, &self.sync);
        wire.read(0x0984, &[0]);
        wire.write(0x0120, &[4, 0]);
        wire.read(0x0130, &[4, 0, 0, 0, 0, 0]);
        if self.refused.is_some() {
            wire.cycle(self.start, self.led);
        }
        let asked = wire.micros;
        wire.write(0x0120, &[8, 0]);
        if let Some((after, code)) = self.refused {
            wire.micros = asked + after;
            wire.read(0x0130, &[0x14, 0, 0, 0, code, 0]);
        } else {
            if self.looks {
                wire.read(0x0130, &[8, 0, 0, 0, 0, 0]);
            }
            self.operate(&mut wire);
        }
        let mut diagnosis = Diagnosis::new();
        diagnosis.read("made", &wire.file[..]).expect("a capture");
        diagnosis.report(&Names::default()).expect("EtherCAT")
    }

    fn operate(&self, wire: &mut Wire) {
        let first = self.start + 100 * CYCLE - self.ahead;
        let begin = wire.micros + 1000;
        for cycle in 0..self.cycles {
            let pause = if cycle > 60 { self.pause_us } else { 0 };
            let jump = if cycle > 60 { self.jump_us } else { 0 };
            wire.micros = begin + cycle * 1000 + pause + jump;
            let late = if cycle == 50 { self.late } else { 0 };
            let slid = self.drift * cycle as i64;
            let at = (first + cycle * CYCLE + late + pause * 1000).wrapping_add_signed(slid);
            let before = wire.file.len();
            match cycle + self.gone < self.cycles {
                true => wire.cycle(at, self.led),
                false => wire.cycle_alone(),
            };
            if cycle == 50 && self.again > 0 {
                wire.index = wire.index.wrapping_sub(1);
                wire.micros = begin + cycle * 1000 + self.again / 1000;
                wire.cycle(at + self.again, self.led);
            }
            if self.one_index {
                wire.index = 0;
            }
            if self.looked_for > 0 && cycle == 0 {
                wire.ask();
            } else if cycle % 125 == 0 && (1..=self.looked_for).contains(&(cycle / 125)) {
                wire.read(0x080D, &[0]);
            }
            if self.lost.contains(&cycle) {
                // Both packets have the same length.
                wire.file.truncate((before + wire.file.len()) / 2);
            }
            if cycle == 40 {
                wire.read(0x092C, &self.difference.to_le_bytes());
            }
            if cycle == 70 && self.looks {
                if let Some(control) = self.control {
                    wire.write(0x0120, &[control, 0]);
                }
                wire.read(0x0130, &self.status);
            }
            if cycle == 30
                && let Some(control) = self.meddles
            {
                let all = Address::Broadcast(0x0120);
                wire.exchange_of(0x20, &[(Command::Bwr, all, &[control, 0], &[control, 0], 1)]);
            }
            if cycle == self.sync_off {
                wire.write(0x0980, &[0, 0]);
            }
            if cycle + self.strangers as u64 >= self.cycles {
                let all = Address::Broadcast(0x0130);
                wire.exchange_of(0x20, &[(Command::Brd, all, &[0, 0], &[8, 0], 1)]);
            }
        }
    }

    fn found(&self) -> Vec<&'static str> {
        self.report().findings.iter().map(|finding| finding.kind).collect()
    }
}

/// Asserts that nothing is found in `good`, and that `kind` is the first finding in `bad`.
fn edge(good: Setup, bad: Setup, kind: &str) {
    assert_eq!(good.found(), [""; 0], "the good side of {kind}: {}", good.report().text());
    let report = bad.report();
    assert_eq!(bad.found().first(), Some(&kind), "{}", report.text());
    let finding = &report.findings[0];
    assert!(finding.frame.frame > 0 && !finding.what.is_empty() && !finding.remedies.is_empty());
}

/// The duration of the cyclic frame, from its first to its last bit.
fn duration() -> u64 {
    duration_ns(Wire::new().cycle(0, true))
}

#[test]
fn the_good_segment() {
    let report = Setup::default().report();
    assert_eq!(Setup::default().found(), [""; 0], "{}", report.text());
    let device = &report.devices[0];
    let distance = device.distance.as_ref().expect("measured");
    let expected = (CYCLE / 2 - duration()) as i64;
    assert_eq!((distance.shortest_ns.value, distance.longest_ns.value), (expected, expected));
    assert_eq!(distance.frames, 100);
    assert_eq!((device.position, device.state.as_deref()), (Some(0), Some("OP")));
    assert_eq!(device.watchdog_ns, Some(100_000_000));
    let mailbox = device.mailbox.as_ref().expect("messages");
    let values: Vec<_> = mailbox.sync_objects.iter().map(|one| (one.sub, one.value)).collect();
    assert_eq!(values, [(1, 2), (5, 100_000), (6, 50_000)]);
    assert_eq!((mailbox.transfers, mailbox.by_content), (3, false));
}

#[test]
fn copy_time() {
    let left = (CYCLE / 2 - duration()) as u32;
    let good = Setup { copy: left, ..Setup::default() };
    edge(good, Setup { copy: left + 1, ..Setup::default() }, "copy-time-not-kept");
    // Outputs that act at SYNC1 or with the frame need no copy time before SYNC0.
    let at_sync1 = Setup { copy: left + 1, mode: 3, sync: [0, 7], ..Setup::default() };
    assert_eq!(at_sync1.found(), [""; 0]);
}

#[test]
fn minimum_cycle() {
    let of = |minimum: u64| Setup { minimum: minimum as u32, ..Setup::default() };
    edge(of(CYCLE), of(CYCLE + 1), "cycle-below-minimum");
}

#[test]
fn what_was_forgotten() {
    let good = Setup::default();
    edge(good.clone(), Setup { offset: false, ..good.clone() }, "offset-not-written");
    edge(good.clone(), Setup { in_preop: false, ..good }, "sync-after-safeop");
}

/// Half and twice the frames' cycle are in order; 5 % off is the edge.
#[test]
fn cycles_that_do_not_fit() {
    let of = |cycle| Setup { cycle, led: true, copy: 0, minimum: 0, ..Setup::default() };
    for cycle in [CYCLE / 2, 2 * CYCLE] {
        assert!(!of(cycle).found().contains(&"cycle-mismatch"), "{cycle}");
    }
    // Twice 475 000 ns is 5 % below the frames' cycle.
    for (cycle, found) in [(CYCLE / 40 * 19, false), (CYCLE / 40 * 19 - 1, true)] {
        assert_eq!(of(cycle).found().contains(&"cycle-mismatch"), found, "{cycle}");
    }
}

#[test]
fn start_time() {
    let of = |start| Setup { start, ..Setup::default() };
    edge(of(NOW), of(NOW - 1), "start-in-past");
    // By its own clock it has passed as well, or it is to come.
    // Four frames of 40 us lie between the reading of the reference's clock and that of its own.
    let own = |own| Setup { own_time: Some(own + 160_000), ..of(NOW - 1) };
    assert_eq!(own(NOW - 1).found(), ["start-in-past"]);
    assert_eq!(own(NOW - 2).found(), ["clock-far"]);
}

#[test]
fn clocks_apart() {
    let of = |difference| Setup { difference, ..Setup::default() };
    edge(of(1000), of(1001), "clocks-apart");
    // The sign does not matter.
    edge(of(0x8000_0000 | 1000), of(0x8000_0000 | 1001), "clocks-apart");
}

#[test]
fn watchdog() {
    // The watchdog counts in steps of 80 ns.
    let of = |watchdog| Setup { divider: 0, watchdog, ..Setup::default() };
    edge(of(12_501), of(12_500), "watchdog-below-cycle");
    assert_eq!(of(0).found(), [""; 0], "a watchdog that is off is none");
}

#[test]
fn skipped_cycles() {
    // SYNC0 follows shortly after the frame: a frame half a cycle later is still before the next
    // one.
    let of = |late| Setup { late, ahead: CYCLE - 1000, copy: 1000, ..Setup::default() };
    edge(of(CYCLE / 2), of(CYCLE / 2 + 1), "cycles-skipped");
}

/// The frame of a cycle comes twice, with a different time in it: a device, or something before it,
/// sent it twice. It counts only within a quarter of a cycle, and only if each cycle has its own
/// index.
#[test]
fn frames_that_come_twice() {
    let of = |again| Setup { again, ahead: CYCLE - 1000, copy: 1000, ..Setup::default() };
    edge(of(CYCLE / 4), of(CYCLE / 4 - 1), "frames-doubled");
    let same = Setup { one_index: true, ..of(CYCLE / 4 - 1) };
    assert_eq!(same.found(), [""; 0], "{}", same.report().text());
}

#[test]
fn frames_behind_sync0() {
    let left = CYCLE / 2 - duration();
    let of = |late| Setup { late, copy: 0, ..Setup::default() };
    edge(of(left), of(left + 1), "sync0-passed");
}

/// A part per million; and half a cycle in 99 cycles, towards earlier frames, which stay before the
/// same SYNC0.
#[test]
fn a_host_that_slides() {
    let of = |drift| Setup { drift, ..Setup::default() };
    edge(of(-1), of(-2), "frames-slide");
    for (drift, kind) in [(-5050, "frames-slide"), (-5051, "host-slides")] {
        assert_eq!(of(drift).found(), [kind]);
    }
}

#[test]
fn pauses_of_drift_frames() {
    // The last drift frame comes one cycle before the pause.
    for (pause_us, found) in [(99_000, false), (99_001, true)] {
        let setup = Setup { pause_us, ..Setup::default() };
        assert_eq!(setup.found().contains(&"drift-frames-stopped"), found, "{pause_us}");
    }
    // A jump of the stamps is no pause by the reference's clock.
    let setup = Setup { jump_us: 7_200_000_000, ..Setup::default() };
    assert_eq!(setup.found(), [""; 0]);
}

#[test]
fn nothing_leads() {
    let report = Setup { led: false, pause_us: 200_000, ..Setup::default() };
    assert!(report.found().contains(&"no-drift-frames"), "{}", report.report().text());
    let report = report.report();
    assert!(report.clock.is_none() && report.devices[0].distance.is_none());
}

#[test]
fn modes_and_sync() {
    let of = |mode, sync| Setup { mode, sync: [0, sync], ..Setup::default() };
    edge(of(2, 3), of(2, 0), "mode-without-sync");
    edge(of(3, 7), of(3, 3), "mode-without-sync");
    edge(of(2, 3), of(1, 3), "sync-without-mode");
    assert_eq!(of(1, 0).found(), [""; 0], "neither");
}

/// A frame of somebody else that asks for a state is one too many, while one that looks is none.
#[test]
fn a_stranger_that_asks_for_a_state() {
    let of = |meddles| Setup { meddles, ..Setup::default() };
    edge(Setup { strangers: 1, ..of(None) }, of(Some(8)), "another-talker");
}

/// SYNC0 goes off before the end, by half a second and less.
#[test]
fn sync0_that_is_switched_off_in_operation() {
    let of = |sync_off| Setup { cycles: 700, sync_off, ..Setup::default() };
    edge(of(250), of(150), "sync0-switched-off");
}

/// After cycle 70 all are asked for INIT, and frames go on for a second and less.
#[test]
fn process_data_that_go_on_without_anybody() {
    let of =
        |cycles| Setup { control: Some(1), status: [1, 0, 0, 0, 0, 0], cycles, ..Setup::default() };
    edge(of(1_050), of(1_100), "asked-down");
}

#[test]
fn devices_that_leave_op() {
    let of = |status, control| Setup { status, control, ..Setup::default() };
    let good = of([8, 0, 0, 0, 0, 0], None);
    edge(good, of([0x14, 0, 0, 0, 0x1A, 0], None), "left-op");
    // A state that was requested is in order; a refused one is an error.
    assert_eq!(of([4, 0, 0, 0, 0, 0], Some(4)).found(), [""; 0]);
    edge(of([4, 0, 0, 0, 0, 0], Some(4)), of([0x14, 0, 0, 0, 0x1B, 0], Some(2)), "al-error");
    // A device without a CPU copies the acknowledge bit.
    assert_eq!(of([0x14, 0, 0, 0, 0, 0], Some(0x14)).found(), [""; 0]);
}

#[test]
fn op_is_refused_for_want_of_process_data() {
    let of = |after, code| Setup { refused: Some((after, code)), ..Setup::default() };
    assert_eq!(
        of(500_000, 0x1B).found(),
        ["op-without-data"],
        "{}",
        of(500_000, 0x1B).report().text()
    );
    assert_eq!(of(499_999, 0x1B).found(), ["al-error"]);
    assert_eq!(of(500_000, 0x1D).found(), ["al-error"], "an invalid output configuration");
}

#[test]
fn mailboxes() {
    let early = |after| Setup { early_us: Some(after), ..Setup::default() };
    edge(early(99_999), early(100_000), "mailbox-early");
    let of = |looked_for| Setup { looked_for, cycles: 1_600, ..Setup::default() };
    edge(of(7), of(8), "mailbox-stalled");
    let goes_on = Setup { cycles: 1_400, ..of(8) };
    assert_eq!(goes_on.found(), [""; 0], "more looks may follow");
    let took = |setup: &Setup| {
        let device = setup.report().devices.swap_remove(0);
        device.mailbox.and_then(|mailbox| mailbox.slowest).map(|slowest| slowest.took_ns)
    };
    assert_eq!(took(&early(99_999)), Some(99_999_000));
    assert_eq!(took(&Setup::default()), Some(40_000));
}

/// Frames that did not come back, one by one or in a row.
#[test]
fn outages() {
    let of = |lost| Setup { lost, ..Setup::default() };
    assert_eq!(of(60..67).found(), ["frames-lost"]);
    let report = of(60..68).report();
    assert_eq!(of(60..68).found(), ["nothing-came-back"], "{}", report.text());
    let said = &report.findings[0].what;
    assert!(said.contains("for 8 ms: 8 cyclic frames in a row"), "{said}");
    // To the end it is another thing, and a frame that comes back ends it, whatever it has.
    assert_eq!(of(71..100).found(), ["silent-to-the-end"]);
    assert_eq!(of(67..75).found(), ["frames-lost"], "states are read after cycle 70");
}

#[test]
fn another_talker() {
    let of = |strangers| Setup { strangers, ..Setup::default() };
    edge(of(7), of(8), "another-talker");
}

/// Some MainDevices request OP and read no state afterwards: OP counts as reached 100 cycles later.
#[test]
fn operation_that_nothing_looks_at() {
    let of = |lost| Setup { lost: lost..lost + 1, cycles: 110, looks: false, ..Setup::default() };
    edge(of(99), of(100), "frames-lost");
    let looks = Setup { looks: true, ..of(0) };
    assert_eq!(looks.found().first(), Some(&"frames-lost"), "a state was read");
}

/// The usual working counter is the highest one that came at least 8 times, however long a lower
/// one followed. A reference that is gone gives no time.
#[test]
fn working_counters_that_do_not_come_back() {
    let of = |gone| Setup { gone, ..Setup::default() };
    let report = of(60).report();
    let finding = &report.findings[0];
    assert_eq!(finding.kind, "working-counter", "{}", report.text());
    assert!(finding.what.contains("down to 0 in 60 frames, 3 is usual"), "{}", finding.what);
    assert!(!of(60).found().contains(&"cycles-skipped"), "{}", report.text());
    let found = |gone| of(gone).found().contains(&"working-counter");
    assert!(found(92) && !found(93), "eight frames, and seven");
}

/// Bits 4 to 7 are the links of ports 0 to 3.
#[test]
fn in_and_out_swapped() {
    let of = |links| Setup { links, ..Setup::default() };
    edge(of(0x30), of(0x20), "ports-swapped");
    assert_eq!(of(0x03).found(), [""; 0], "no link at all, though it answers: nothing is said");
}
