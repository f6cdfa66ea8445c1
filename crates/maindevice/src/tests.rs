//! A small segment that answers like ESCs as far as the tests need it, and tests of the machine's
//! parts with it.

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::future::Future;
use core::task::{Context, Poll, Waker};
use std::string::ToString;

use isocat_wire::al::{AlState, AlStatus, AlStatusCode};
use isocat_wire::command::Command;
use isocat_wire::datagram::{Address, Layouts};
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{MAX_LEN, payload_offset};
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{StationAddress, frame};

use crate::cycle::CyclicExchange;
use crate::error::{AccessProblem, Cause};
use crate::event::Event;
use crate::health::{Answer, Others};
use crate::link::{Exchange, Link, Travel};
use crate::segment::{Chunk, DcCapability, ProcessImage, Segment, SubDevice};
use crate::{Config, esm};

mod complete;
mod groups;
mod mailbox;
mod reads;
mod times;

/// Memory of one ESC, and its few actions.
pub(crate) struct FakeEsc {
    pub memory: Vec<u8>,
    /// Number of reads of AL status before AL control is copied to it; `None`: never.
    pub follows_after: Option<u32>,
    /// Refuses states above this one with a code.
    pub refuses: Option<(AlState, AlStatusCode)>,
    /// Number of the next writes of AL control that count 0.
    pub locked: u32,
    asked: Option<u8>,
    pub mailbox: Option<mailbox::FakeMailbox>,
}

impl FakeEsc {
    pub fn new(station: u16) -> Self {
        let mut memory = std::vec![0; 0x2000];
        memory[0x0010..0x0012].copy_from_slice(&station.to_le_bytes());
        memory[0x0130] = 1;
        Self {
            memory,
            follows_after: Some(0),
            refuses: None,
            locked: 0,
            asked: None,
            mailbox: None,
        }
    }

    /// Reads, except from an empty mailbox.
    fn read(&mut self, at: usize, data: &mut [u8]) -> bool {
        if let Some(mailbox) = &mut self.mailbox
            && let Some(done) = mailbox.read(at, data)
        {
            return done;
        }
        if at == 0x0130 && self.follows_after == Some(0) {
            if let Some(asked) = self.asked.take() {
                self.memory[0x0130] = asked;
            }
        } else if at == 0x0130 {
            self.follows_after = self.follows_after.map(|n| n - 1);
        }
        data.copy_from_slice(&self.memory[at..at + data.len()]);
        true
    }

    fn write(&mut self, at: usize, data: &[u8]) -> bool {
        if let Some(mailbox) = &mut self.mailbox
            && let Some(done) = mailbox.write(at, data)
        {
            return done;
        }
        if at == 0x0120 {
            if self.locked > 0 {
                self.locked -= 1;
                return false;
            }
            let state = data[0] & 0x0F;
            match self.refuses {
                Some((highest, code)) if state > highest as u8 => {
                    self.memory[0x0134..0x0136].copy_from_slice(&code.0.to_le_bytes());
                    self.asked = Some(highest as u8 | 0x10);
                }
                _ => self.asked = Some(state),
            }
        }
        self.memory[at..at + data.len()].copy_from_slice(data);
        true
    }
}

/// ESCs in a line, without time: a frame comes back at once.
pub(crate) struct FakeSegment {
    pub escs: Vec<FakeEsc>,
    /// System time at the reference, ns.
    pub time: u64,
}

impl FakeSegment {
    pub fn new(count: u16) -> Self {
        Self { escs: (0..count).map(|i| FakeEsc::new(0x1001 + i)).collect(), time: 0 }
    }

    /// Passes a frame through all ESCs.
    pub fn pass(&mut self, frame: &mut [u8]) {
        frame[6] |= frame::LOCALLY_ADMINISTERED;
        let start = payload_offset(frame).unwrap();
        let payload = &mut frame[start..];
        let time = self.time.to_le_bytes();
        for esc in &mut self.escs {
            esc.memory[0x0910..0x0918].copy_from_slice(&time);
            let mut layouts = Layouts::new();
            while let Some(Ok(layout)) = layouts.next(payload) {
                let header = layout.header;
                let command = header.command().unwrap();
                let adp = header.adp();
                if command.increments_position() {
                    payload[layout.start + 2..layout.start + 4]
                        .copy_from_slice(&adp.wrapping_add(1).to_le_bytes());
                }
                let station = u16::from_le_bytes([esc.memory[0x10], esc.memory[0x11]]);
                let at = usize::from(header.ado());
                let data = layout.data()..layout.wkc();
                let count = match command {
                    Command::Fprd | Command::Frmw if adp == station => {
                        u16::from(esc.read(at, &mut payload[data]))
                    }
                    Command::Frmw => 1,
                    Command::Aprd if adp == 0 => u16::from(esc.read(at, &mut payload[data])),
                    Command::Fpwr if adp == station => u16::from(esc.write(at, &payload[data])),
                    Command::Apwr if adp == 0 => u16::from(esc.write(at, &payload[data])),
                    Command::Bwr => u16::from(esc.write(at, &payload[data])),
                    Command::Brd => {
                        let mut read = std::vec![0; data.len()];
                        esc.read(at, &mut read);
                        payload[data].iter_mut().zip(read).for_each(|(byte, own)| *byte |= own);
                        1
                    }
                    Command::Lrw => logical(esc, header.address, &mut payload[data]),
                    _ => 0,
                };
                let wkc = layout.wkc()..layout.end();
                let sum = u16::from_le_bytes([payload[wkc.start], payload[wkc.start + 1]]) + count;
                payload[wkc].copy_from_slice(&sum.to_le_bytes());
            }
        }
    }
}

/// LRW through FMMU 0 (outputs) and FMMU 1 (inputs), byte-wise.
fn logical(esc: &mut FakeEsc, address: u32, data: &mut [u8]) -> u16 {
    let mut count = 0;
    let received = data.to_vec();
    for number in 0..2 {
        let fmmu = register::fmmu(number).load(&esc.memory);
        let start = fmmu.logical_start.wrapping_sub(address) as usize;
        if !fmmu.is_active() || start >= data.len() {
            continue;
        }
        let range = start..start + usize::from(fmmu.length);
        let physical = usize::from(fmmu.physical_start);
        let memory = &mut esc.memory[physical..physical + usize::from(fmmu.length)];
        if fmmu.kind & Fmmu::WRITE != 0 {
            memory.copy_from_slice(&received[range]);
            count += 2;
        } else {
            data[range].copy_from_slice(memory);
            count += 1;
        }
    }
    count
}

/// A link, its segment, and a separate host clock.
pub(crate) struct Bench {
    pub link: Link,
    pub segment: FakeSegment,
    pub now: Time<Host>,
    /// Numbers of the sent frames to lose.
    pub lose: Vec<u64>,
    /// Frames to lose on their way back.
    pub lose_back: Vec<u64>,
    /// Number of datagrams in each frame that was sent.
    pub frames: Vec<usize>,
}

impl Bench {
    pub fn new(count: u16) -> Self {
        let now = Time::new(1_000_000);
        Self {
            link: Link::new(now, [0x10; 6], Nanos(5_000_000), 2),
            segment: FakeSegment::new(count),
            now,
            lose: Vec::new(),
            lose_back: Vec::new(),
            frames: Vec::new(),
        }
    }

    /// Runs a procedure to its end; frames come back 10 us after they were sent.
    pub fn run<T>(&mut self, procedure: impl Future<Output = T>) -> T {
        let mut procedure = Box::pin(procedure);
        for _ in 0..100_000 {
            self.link.with(|shared| {
                shared.port.now = self.now;
                shared.port.forget_waits();
            });
            if let Poll::Ready(result) =
                procedure.as_mut().poll(&mut Context::from_waker(Waker::noop()))
            {
                return result;
            }
            let mut returning = Vec::new();
            let mut buffer = [0; MAX_LEN];
            while let Some(len) =
                self.link.with(|shared| shared.transmit(self.now, &mut buffer, MAX_LEN))
            {
                let mut frame = buffer[..len].to_vec();
                let datagrams =
                    isocat_wire::datagram::datagrams(frame::payload(&frame).unwrap()).count();
                self.frames.push(datagrams);
                let number = self.frames.len() as u64 - 1;
                if !self.lose.contains(&number) {
                    self.segment.pass(&mut frame);
                    if !self.lose_back.contains(&number) {
                        returning.push(frame);
                    }
                }
            }
            if returning.is_empty() {
                self.now = self.link.with(|shared| shared.port.next_timeout());
                assert_ne!(self.now, Time::NEVER, "the procedure waits for nothing");
                self.link.with(|shared| shared.handle_timeout(self.now));
                continue;
            }
            self.now += Nanos(10_000);
            for frame in returning {
                let payload = frame::payload(&frame).unwrap();
                assert!(self.link.with(|shared| shared.receive(payload)));
            }
        }
        panic!("the procedure does not end");
    }

    pub fn events(&self) -> Vec<Event> {
        core::iter::from_fn(|| self.link.board(|board| board.poll_event())).collect()
    }
}

/// Bytes before the first datagram.
const HEADERS: usize = 16;
const STATION: StationAddress = StationAddress(0x1001);

#[test]
fn datagrams_share_a_frame_until_it_is_full() {
    let mut bench = Bench::new(1);
    let link = bench.link.clone();
    // 14 bytes each: 107 of them fit into 1498.
    let reads: Vec<Exchange> = (0..110).map(|_| link.fprd(STATION, 0x0130, 2)).collect();
    bench.run(async {
        for read in reads {
            read.expect(1).await.unwrap();
        }
    });
    assert_eq!(bench.frames, [107, 3]);
}

#[test]
fn a_datagram_that_travels_alone_does() {
    let mut bench = Bench::new(1);
    let link = bench.link.clone();
    let alone = Travel { alone: true, ..Travel::default() };
    let address = Address::Station(STATION, 0x0910);
    bench.run(async {
        let first = link.fprd(STATION, 0x0130, 2);
        let second = link.exchange(Command::Frmw, address, std::vec![0; 8], alone);
        let third = link.fprd(STATION, 0x0130, 2);
        for exchange in [first, second, third] {
            exchange.expect(1).await.unwrap();
        }
    });
    assert_eq!(bench.frames, [1, 1, 1]);
}

/// A frame holds 107 datagrams of 14 bytes. Behind 105 others there is room for two, behind 106
/// both go into the next frame.
#[test]
fn datagrams_that_travel_together_are_in_one_frame() {
    for (others, frames) in [(105, &[107][..]), (106, &[106, 2])] {
        let mut bench = Bench::new(1);
        let link = bench.link.clone();
        let bound = Travel { with_next: true, ..Travel::default() };
        let mut all: Vec<_> = (0..others).map(|_| link.fprd(STATION, 0x0130, 2)).collect();
        let address = Address::Station(STATION, 0x0130);
        all.push(link.exchange(Command::Fprd, address, std::vec![0; 2], bound));
        all.push(link.fprd(STATION, 0x0130, 2));
        bench.run(async {
            for exchange in all {
                exchange.expect(1).await.unwrap();
            }
        });
        assert_eq!(bench.frames, frames, "{others}");
    }
}

/// Sends what may leave now; the offsets (ADO) of the datagrams of each frame.
fn send(bench: &Bench) -> Vec<Vec<u16>> {
    let mut buffer = [0; MAX_LEN];
    let mut frames = Vec::new();
    while let Some(len) = bench.link.with(|shared| shared.transmit(bench.now, &mut buffer, MAX_LEN))
    {
        let payload = frame::payload(&buffer[..len]).unwrap();
        let datagrams = isocat_wire::datagram::datagrams(payload);
        frames.push(datagrams.map(|datagram| datagram.unwrap().header.ado()).collect());
    }
    frames
}

/// Datagrams that go ahead leave before all that were queued earlier, in their own order.
#[test]
fn datagrams_go_ahead_of_those_queued_before() {
    let bench = Bench::new(1);
    let (link, ahead) = (bench.link.clone(), bench.link.ahead());
    let _first = [link.fprd(STATION, 0x0001, 2), ahead.fprd(STATION, 0x0101, 2)];
    let _then = [link.fprd(STATION, 0x0002, 2), ahead.fprd(STATION, 0x0102, 2)];
    assert_eq!(send(&bench), [[0x0101, 0x0102, 0x0001, 0x0002]]);
    let _last = [link.fprd(STATION, 0x0003, 2), ahead.fprd(STATION, 0x0103, 2)];
    assert_eq!(send(&bench), [[0x0103, 0x0003]]);
}

/// Beyond what fills the way, which takes no time here, 3 000 octets are in flight: three frames of
/// 1 000 octets and not a fourth, four of 999. What goes ahead leaves all the same.
#[test]
fn no_more_is_in_flight_than_fills_the_way() {
    for (octets, fits) in [(1_000, 3), (999, 4)] {
        let mut bench = Bench::new(1);
        let link = bench.link.clone();
        bench.run(link.fprd(STATION, 0x0130, 2).expect(1)).unwrap();
        let alone = Travel { alone: true, ..Travel::default() };
        let read = |number| {
            // Without the headers of the frame and the datagram, and what is around a frame.
            let data = std::vec![0; octets - HEADERS - 24 - 12];
            link.exchange(Command::Fprd, Address::Station(STATION, number), data, alone)
        };
        let _all: Vec<_> = (0..9).map(read).collect();
        assert_eq!(send(&bench).len(), fits, "{octets} octets each");
        assert!(send(&bench).is_empty());
        let _ahead = link.ahead().fprd(STATION, 0x0130, 2);
        assert_eq!(send(&bench), [[0x0130]]);
    }
}

/// A quiet datagram begins a frame, and leaves when the frames before it are back. Frames of the
/// cycle count too. Without such an instant it is lost, to the nanosecond.
#[test]
fn a_quiet_datagram_waits_until_all_frames_are_back() {
    let mut bench = Bench::new(1);
    let link = bench.link.clone();
    let quiet = || {
        let travel = Travel { once: true, quiet: true, ..Travel::default() };
        link.exchange(Command::Fpwr, Address::Station(STATION, 0x1000), std::vec![1], travel)
    };
    let start = bench.now;
    bench.run(async {
        let first = link.fprd(STATION, 0x0130, 2);
        let (second, third) = (quiet(), link.fprd(STATION, 0x0130, 2));
        let sent = first.expect(1).await.unwrap().sent;
        assert_eq!(sent, start);
        for exchange in [second, third] {
            assert_eq!(exchange.expect(1).await.unwrap().sent, start + Nanos(10_000));
        }
    });
    assert_eq!(bench.frames, [1, 2]);

    let waits = |now, cyclic| link.with(|shared| shared.port.waits_for_quiet(now, cyclic));
    let mut exchange = core::pin::pin!(quiet());
    let mut is_lost = || {
        let answer = exchange.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        matches!(answer, Poll::Ready(None))
    };
    let begin = bench.now;
    assert!(waits(begin, 1));
    assert!(!waits(begin + Nanos(50_000_000), 0), "now it may leave");
    assert!(waits(begin + Nanos(60_000_000), 2));
    assert!(waits(begin + Nanos(159_999_999), 1));
    assert!(!is_lost());
    assert!(waits(begin + Nanos(160_000_000), 1));
    assert!(is_lost());
    assert!(!waits(begin + Nanos(160_000_000), 1), "nothing is queued");
}

#[test]
fn lost_frames_are_sent_again_as_often_as_allowed() {
    let mut bench = Bench::new(1);
    bench.lose = std::vec![0, 1];
    let link = bench.link.clone();
    bench.run(link.read(STATION, register::AL_STATUS)).unwrap();
    assert_eq!(link.board(|board| board.statistics.frames_lost), 2);
    assert_eq!(bench.now, Time::new(1_000_000 + 5_000_000 + 10_000_000 + 10_000));

    bench.lose = std::vec![3, 4, 5];
    let error = bench.run(link.read(STATION, register::AL_STATUS)).unwrap_err();
    assert_eq!(error.problem, AccessProblem::Lost);
    assert_eq!(error.to_string(), "FPRD 0x1001:0x0130: lost");
}

#[test]
fn what_must_not_be_repeated_is_not() {
    let mut bench = Bench::new(1);
    bench.lose = std::vec![0];
    let link = bench.link.clone();
    let once = Travel { once: true, ..Travel::default() };
    let address = Address::Station(STATION, 0x1000);
    let lost = bench.run(link.exchange(Command::Fpwr, address, std::vec![1], once).reply());
    assert!(lost.unwrap_err().is_lost());
    assert_eq!(bench.frames.len(), 1);
}

#[test]
fn a_wrong_working_counter_names_its_place() {
    let mut bench = Bench::new(1);
    let link = bench.link.clone();
    let nobody = StationAddress(0x1002);
    let error = bench.run(link.read(nobody, register::AL_STATUS)).unwrap_err();
    assert_eq!(error.to_string(), "FPRD 0x1002:0x0130: working counter 0, expected 1");
    assert_eq!(bench.run(link.try_read(nobody, register::AL_STATUS)), Ok(None));
}

#[test]
fn foreign_and_late_frames_are_not_taken() {
    let link = Bench::new(1).link;
    let exchange = link.fprd(STATION, 0x0130, 2);
    let mut buffer = [0; MAX_LEN];
    let len = link.with(|shared| shared.transmit(Time::new(0), &mut buffer, MAX_LEN)).unwrap();
    let receive = |bytes: &[u8]| link.with(|shared| shared.receive(bytes));
    let payload = frame::payload(&buffer[..len]).unwrap();
    assert!(!receive(&[]) && !receive(&payload[..5]));
    let mut other = payload.to_vec();
    other[4] ^= 1;
    assert!(!receive(&other), "another register");
    other[4] ^= 1;
    other[7] |= 0x80;
    assert!(!receive(&other), "a further datagram is announced");
    assert!(receive(payload));
    assert!(!receive(payload), "the same frame again");
    drop(exchange);
}

/// Dropped exchanges free their slots for the next ones.
#[test]
fn dropped_exchanges_are_forgotten() {
    let mut bench = Bench::new(1);
    let link = bench.link.clone();
    drop(link.fprd(STATION, 0x0130, 2));
    let mut buffer = [0; MAX_LEN];
    assert_eq!(link.with(|shared| shared.transmit(Time::new(0), &mut buffer, MAX_LEN)), None);
    let in_flight = link.fprd(STATION, 0x0130, 2);
    let len = link.with(|shared| shared.transmit(Time::new(0), &mut buffer, MAX_LEN)).unwrap();
    drop(in_flight);
    let payload = frame::payload(&buffer[..len]).unwrap();
    assert!(link.with(|shared| shared.receive(payload)));
    assert!(bench.run(link.read(STATION, register::AL_STATUS)).is_ok());
}

#[test]
fn sleeps_end_on_the_grain() {
    let mut bench = Bench::new(0);
    let link = bench.link.clone();
    bench.now = Time::new(1_000_001);
    link.with(|shared| shared.port.now = Time::new(1_000_001));
    bench.run(link.sleep(Nanos(10)));
    assert_eq!(bench.now, Time::new(1_050_000));
}

fn device() -> SubDevice {
    let mut device = SubDevice::new(0, STATION);
    device.al_status = AlStatus(1);
    device
}

#[test]
fn a_state_is_reached_though_al_control_is_locked_at_first() {
    let mut bench = Bench::new(1);
    bench.segment.escs[0].locked = 3;
    bench.segment.escs[0].follows_after = Some(2);
    let (link, mut device) = (bench.link.clone(), device());
    bench.run(esm::change(&link, &mut device, AlState::PreOp, Nanos::millis(100))).unwrap();
    assert_eq!(device.al_status, AlStatus(2));
    assert!(matches!(bench.events()[..], [Event::StateChanged { position: 0, .. }]));
}

#[test]
fn a_refused_state_says_why() {
    let mut bench = Bench::new(1);
    let code = AlStatusCode::INVALID_OUTPUT_CONFIGURATION;
    bench.segment.escs[0].refuses = Some((AlState::PreOp, code));
    let (link, mut device) = (bench.link.clone(), device());
    let change = esm::change(&link, &mut device, AlState::SafeOp, Nanos::millis(100));
    let error = bench.run(change).unwrap_err();
    assert_eq!(
        error.to_string(),
        "SubDevice 0: refuses SAFEOP, is in PREOP+ERR, AL status code 0x001D (invalid output \
         configuration)"
    );
}

#[test]
fn a_silent_device_runs_into_its_deadline() {
    let mut bench = Bench::new(1);
    bench.segment.escs[0].follows_after = None;
    let (link, mut device) = (bench.link.clone(), device());
    let change = esm::change(&link, &mut device, AlState::PreOp, Nanos::millis(30));
    let error = bench.run(change).unwrap_err();
    assert!(matches!(error, Cause::StateTimeout { requested: AlState::PreOp, .. }), "{error}");
    assert!(bench.now >= Time::new(31_000_000) && bench.now < Time::new(42_000_000));
}

/// Two devices: two bytes of outputs and two of inputs at the first, two of outputs at the second.
fn cyclic_segment(bench: &mut Bench) -> Segment {
    let mut segment = Segment { reference: Some(0), ..Segment::default() };
    for position in 0..2u16 {
        let mut device = SubDevice::new(position.into(), StationAddress(0x1001 + position));
        device.dc = DcCapability::Clock64;
        let logical = 2 * u32::from(position);
        device.outputs.length = 2;
        (device.outputs.logical, device.inputs.logical) = (logical, logical);
        let memory = &mut bench.segment.escs[usize::from(position)].memory;
        memory[0x0130] = 8;
        register::fmmu(0).store(memory, Fmmu::bytes(logical, 2, 0x1100, Fmmu::WRITE));
        if position == 0 {
            device.inputs.length = 2;
            register::fmmu(1).store(memory, Fmmu::bytes(logical, 2, 0x1180, Fmmu::READ));
            memory[0x1180..0x1182].copy_from_slice(&[0xAA, 0xBB]);
        }
        segment.devices.push(device);
    }
    let chunk = Chunk { every: 1, logical: 0, length: 4, first: 0, end: 2, writers: 2, readers: 1 };
    segment.image = ProcessImage { chunks: std::vec![chunk], read_write: true };
    segment
}

/// Runs one cycle at its due time; returns the frame as it came back.
fn exchange(cycle: &mut CyclicExchange, bench: &mut Bench) -> Vec<u8> {
    bench.now = cycle.due();
    bench.segment.time = 5_000_000_777 + bench.now.count();
    let link = bench.link.clone();
    let mut buffer = [0; MAX_LEN];
    cycle.close(bench.now);
    let len = link.board(|board| cycle.transmit(bench.now, &mut buffer, board)).unwrap();
    assert_eq!(link.board(|board| cycle.transmit(bench.now, &mut buffer, board)), None);
    let mut frame = buffer[..len].to_vec();
    bench.segment.pass(&mut frame);
    frame
}

#[test]
fn outputs_go_out_and_inputs_come_back() {
    let mut bench = Bench::new(2);
    let segment = cyclic_segment(&mut bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    cycle.exchange_process_data(true);
    cycle.outputs_mut().copy_from_slice(&[1, 2, 3, 4]);
    let frame = exchange(&mut cycle, &mut bench);
    let link = bench.link.clone();
    assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    assert_eq!(bench.segment.escs[0].memory[0x1100..0x1102], [1, 2]);
    assert_eq!(bench.segment.escs[1].memory[0x1100..0x1102], [3, 4]);
    assert_eq!(cycle.inputs()[..2], [0xAA, 0xBB]);
    assert!(!link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)), "taken once");
    assert_eq!(bench.events(), []);
}

#[test]
fn inputs_are_taken_only_with_the_right_working_counter() {
    let mut bench = Bench::new(2);
    let segment = cyclic_segment(&mut bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    cycle.exchange_process_data(true);
    let link = bench.link.clone();
    let fmmu = register::fmmu(0).load(&bench.segment.escs[1].memory);
    register::fmmu(0).store(&mut bench.segment.escs[1].memory, Fmmu::default());
    for _ in 0..3 {
        let frame = exchange(&mut cycle, &mut bench);
        assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    }
    assert_eq!(cycle.inputs()[..2], [0, 0]);
    register::fmmu(0).store(&mut bench.segment.escs[1].memory, fmmu);
    let frame = exchange(&mut cycle, &mut bench);
    assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    assert_eq!(cycle.inputs()[..2], [0xAA, 0xBB]);
    let events = bench.events();
    let wrong = Event::WorkingCounter { cycle: 1, chunk: 0, expected: 5, found: 3 };
    let right = Event::WorkingCounterRestored { cycle: 4, chunk: 0, cycles: 3 };
    assert!(events.contains(&wrong) && events.contains(&right), "{events:?}");
    assert_eq!(link.board(|board| board.statistics.working_counter_errors), 3);
}

#[test]
fn a_lost_frame_is_counted_two_cycles_later_and_stops_nothing() {
    let mut bench = Bench::new(2);
    let segment = cyclic_segment(&mut bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    let link = bench.link.clone();
    let lost = exchange(&mut cycle, &mut bench);
    for _ in 0..2 {
        let frame = exchange(&mut cycle, &mut bench);
        assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    }
    assert!(bench.events().contains(&Event::FrameLost { cycle: 1, frame: 0 }));
    assert!(!link.board(|board| cycle.receive(bench.now, &lost, HEADERS, board)), "far too late");
}

#[test]
fn frames_leave_at_phase_zero_of_system_time() {
    let mut bench = Bench::new(2);
    let segment = cyclic_segment(&mut bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    let link = bench.link.clone();
    for _ in 0..50 {
        let frame = exchange(&mut cycle, &mut bench);
        assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    }
    assert!(cycle.is_locked());
    let mut at = Vec::new();
    for _ in 0..3 {
        let frame = exchange(&mut cycle, &mut bench);
        at.push(bench.segment.time % 1_000_000);
        assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    }
    assert!(at.iter().all(|phase| *phase <= 1 || *phase >= 999_999), "{at:?}");
}

#[test]
fn a_sleeper_skips_cycles_and_is_told() {
    let mut bench = Bench::new(2);
    let segment = cyclic_segment(&mut bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    let link = bench.link.clone();
    let frame = exchange(&mut cycle, &mut bench);
    assert!(link.board(|board| cycle.receive(bench.now, &frame, HEADERS, board)));
    let due = cycle.due();
    let mut buffer = [0; MAX_LEN];
    let mut transmit = |cycle: &mut CyclicExchange, now| {
        cycle.close(now);
        link.board(|board| cycle.transmit(now, &mut buffer, board)).is_some()
    };
    assert!(!transmit(&mut cycle, due + Nanos(-1)));
    // 40 cycles and a bit: no frame leaves off the grid, and none after the event.
    let late = Nanos(40_200_000);
    assert!(!transmit(&mut cycle, due + late));
    let skipped = Event::CyclesSkipped { cycle: 2, late, skipped: 41 };
    assert_eq!(bench.events(), [skipped]);
    assert_eq!(cycle.due(), due + Nanos(41_000_000), "on the grid again");
    assert!(transmit(&mut cycle, due + Nanos(41_000_000)));
    assert!(!transmit(&mut cycle, due + Nanos(41_000_000)), "one frame, no burst");
    assert_eq!(cycle.due(), due + Nanos(42_000_000));
    assert_eq!(cycle.number(), 2);
    assert_eq!(link.board(|board| board.statistics.cycles_skipped), 41);

    // Late by less than half a cycle, a frame leaves at once; by half a cycle, on the grid. If the
    // host is late again, the frame leaves nevertheless.
    let due = cycle.due();
    assert!(transmit(&mut cycle, due + Nanos(499_999)));
    assert_eq!(cycle.due(), due + Nanos(1_000_000));
    let due = cycle.due();
    assert!(!transmit(&mut cycle, due + Nanos(500_000)));
    assert_eq!(cycle.due(), due + Nanos(1_000_000));
    assert!(transmit(&mut cycle, due + Nanos(1_900_000)));
    assert_eq!(cycle.due(), due + Nanos(3_000_000));
}

#[test]
fn status_words_are_read_together() {
    let (status, code) = esm::status_of(&[0x14, 0, 9, 9, 0x1B, 0]);
    assert_eq!((status, code), (AlStatus(0x14), AlStatusCode::WATCHDOG));
    assert_eq!(AlStatus(0x14).to_bytes(), [0x14, 0]);
}

/// One SubDevice left OP for SAFEOP and one is lost: the first is reported, and the second delays
/// nothing.
#[test]
fn health_finds_who_left_op() {
    let mut bench = Bench::new(2);
    bench.segment.escs[0].memory[0x0130] = 8;
    bench.segment.escs[1].memory[0x0130..0x0136].copy_from_slice(&[0x14, 0, 0, 0, 0x1B, 0]);
    let stations: Vec<_> = (0..3).map(|at| (at, StationAddress(0x1001 + at as u16))).collect();
    let found = bench.run(crate::health::look(bench.link.clone(), stations, 3));
    let op = Answer::Status(AlStatus(8), AlStatusCode::NO_ERROR);
    let fallen = Answer::Status(AlStatus(0x14), AlStatusCode::WATCHDOG);
    assert_eq!(found.answers, [(0, op), (1, fallen), (2, Answer::Nobody)]);
    assert_eq!(found.others, Others::None, "no more answer than are known");
    // One of them has lost its address: all are read by position.
    bench.segment.escs[1].memory[0x0010] = 0;
    let stations = std::vec![(0, StationAddress(0x1001)), (1, StationAddress(0x1002))];
    let found = bench.run(crate::health::look(bench.link.clone(), stations, 2));
    assert_eq!(found.answers[1], (1, Answer::Nobody));
    let Others::Everybody(everybody) = found.others else { panic!("two answer, one is known") };
    let addresses: Vec<_> = everybody.iter().map(|found| found.station.0).collect();
    assert_eq!(addresses, [0x1001, 0x1000]);
    // If one more answers than have a place, only the number is known.
    let frames = bench.frames.len();
    let stations = std::vec![(0, StationAddress(0x1001))];
    let found = bench.run(crate::health::look(bench.link.clone(), stations, 1));
    assert_eq!(found.others, Others::TooMany(2));
    assert_eq!(bench.frames[frames..], [2], "the count and one state");
}

/// A dropped datagram in the queue is not sent, and its neighbours are.
#[test]
fn datagrams_that_are_given_up_leave_the_queue() {
    let mut bench = Bench::new(1);
    let link = bench.link.clone();
    let mut reads: Vec<_> =
        (0..1000).map(|_| Some(link.fprd(StationAddress(0x1001), 0x0130, 2))).collect();
    for (at, read) in reads.iter_mut().enumerate() {
        if at % 100 != 50 {
            *read = None;
        }
    }
    let left: Vec<_> = reads.into_iter().flatten().collect();
    bench.run(async {
        for read in left {
            assert_eq!(read.expect(1).await.unwrap().data.len(), 2);
        }
    });
    assert_eq!(bench.frames.iter().sum::<usize>(), 10);
    let (queued, flights) = link.with(|shared| (shared.port.first_len(), shared.port.in_flight()));
    assert_eq!((queued, flights), (None, 0));
}

/// Process data of three frames: each frame begins when the earlier ones and their gaps are over.
#[test]
fn frames_of_a_cycle_follow_each_other() {
    let chunk = |logical| Chunk {
        every: 1,
        logical,
        length: 1000,
        first: 0,
        end: 1,
        writers: 1,
        readers: 1,
    };
    let image = ProcessImage { chunks: [0, 1000, 2000].map(chunk).to_vec(), read_write: true };
    let device = crate::SubDevice::new(0, StationAddress(0x1001));
    let segment = crate::Segment {
        devices: alloc::vec![device],
        reference: Some(0),
        image,
        ..Segment::default()
    };
    let frames = crate::cycle::frames(&segment, true, false);
    let times = crate::cycle::chunk_times(&frames, 3);
    // Headers 16, drift 20, chunk 1012, preamble and FCS 12; AL status 14 in the last one; gap 12.
    let first = (16 + 20 + 1012 + 12) * 80;
    let second = first + (12 + 16 + 1012 + 12) * 80;
    let third = second + (12 + 16 + 1012 + 14 + 12) * 80;
    for (times, begin, end) in
        [(times[0], 0, first), (times[1], first + 960, second), (times[2], second + 960, third)]
    {
        let (fetched, end) = (Nanos(begin), Nanos(end));
        assert_eq!((times.fetched, times.read, times.stored), (fetched, end, end));
    }
}
