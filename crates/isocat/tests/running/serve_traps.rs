//! What foreign MainDevices stumble over on other people's virtual segments, tried on ours without
//! a network: frames and host time go into the [`Server`] directly.
#![cfg(target_os = "linux")]

use isocat::serve::{Answer, Event, Server};
use isocat::{Scenario, SegmentFile};
use isocat_maindevice::{Config, FRAME_LEN, MainDevice};
use isocat_wire::datagram::{Address, datagrams};
use isocat_wire::frame::{self, FrameWriter, MAX_LEN};
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlState, AlStatusCode, AutoIncrementAddress, Command};

const SOURCE: [u8; 6] = [0x10, 0x20, 0x30, 0x40, 0x50, 0x60];
/// From a frame to its answer, and on to the next frame.
const TRIP: Nanos = Nanos::micros(40);

/// A served segment and a hand that sends frames.
struct Wire {
    server: Server,
    /// Of a MainDevice that does what the segment file says.
    config: Config,
    now: Time<Host>,
}

/// A datagram that came back.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Back {
    data: Vec<u8>,
    wkc: u16,
}

impl Wire {
    fn new(segment: &str) -> Self {
        let file = SegmentFile::parse("test", segment).expect("a segment file");
        Self::of(file)
    }

    fn of(file: SegmentFile) -> Self {
        let now = Time::new(5_000_000_000);
        let scenario = Scenario::from(file);
        // One sender, whether it is the MainDevice's program or this hand.
        let config = Config { source: SOURCE, ..scenario.config() };
        Self { server: Server::new(&scenario, now), config, now }
    }

    /// Sends a frame and gives it as it came back.
    fn frame(&mut self, mut bytes: Vec<u8>) -> Option<Vec<u8>> {
        let answer = self.server.frame(self.now, &mut bytes);
        self.server.after(&bytes);
        self.now += TRIP;
        (answer != Answer::Lost).then_some(bytes)
    }

    fn datagram(&mut self, command: Command, address: Address, data: &[u8]) -> Back {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, SOURCE);
        writer.push(command, 0, address, data).expect("it fits");
        let len = writer.finish();
        let back = self.frame(buffer[..len].to_vec()).expect("an answer");
        first(&back)
    }

    fn read(&mut self, position: u16, ado: u16, len: usize) -> Back {
        let address = Address::Position(AutoIncrementAddress::of_position(position), ado);
        self.datagram(Command::Aprd, address, &vec![0; len])
    }

    fn write(&mut self, position: u16, ado: u16, data: &[u8]) -> u16 {
        let address = Address::Position(AutoIncrementAddress::of_position(position), ado);
        self.datagram(Command::Apwr, address, data).wkc
    }

    fn pause(&mut self, span: Nanos) {
        let until = self.now + span;
        while self.now < until {
            self.now += Nanos::millis(10).min(until - self.now);
            self.server.idle(self.now);
        }
    }

    /// Our own MainDevice brings it to OP and exchanges process data for some cycles; then it is
    /// gone, as if killed, or stops as it ought to.
    fn session(&mut self, cycles: u64, stop: bool) -> MainDevice {
        let mut main = MainDevice::new(self.config.clone(), self.now);
        let mut buffer = [0; FRAME_LEN];
        let end = self.now + Nanos::millis(20_000);
        let mut began = None;
        loop {
            let mut backs = Vec::new();
            while let Some(len) = main.poll_transmit(self.now, &mut buffer) {
                backs.extend(self.frame(buffer[..len].to_vec()));
            }
            for back in backs {
                main.handle_frame(self.now, &back);
            }
            while let Some(event) = main.poll_event() {
                match event {
                    isocat_maindevice::Event::InOperation { cycle, .. } => began = Some(cycle),
                    isocat_maindevice::Event::Failed(error) => panic!("{error}"),
                    isocat_maindevice::Event::Stopped => return main,
                    _ => {}
                }
            }
            if began.is_some_and(|began| main.statistics().cycles >= began + cycles) {
                if !stop {
                    return main;
                }
                main.stop();
                began = None;
            }
            assert!(self.now < end, "no operation within 20 s: {}", main.stage());
            if let Some(due) = main.next_timeout() {
                self.now = self.now.max(due);
            }
            main.handle_timeout(self.now);
        }
    }

    fn states(&self) -> Vec<AlState> {
        self.server.served().segment().devices().iter().map(|d| d.stack.state()).collect()
    }
}

fn first(bytes: &[u8]) -> Back {
    let payload = frame::payload(bytes).expect("EtherCAT");
    let datagram = datagrams(payload).next().expect("a datagram").expect("whole");
    Back { data: datagram.data.to_vec(), wkc: datagram.wkc }
}

const SIMPLE: &str = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io16\"\ncount = 4\n";

/// Who hears only frames whose source differs from its own hears ours: the first ESC sets the bit,
/// and nothing else of the address changes.
#[test]
fn the_first_esc_marks_the_source_address() {
    let mut wire = Wire::new(SIMPLE);
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, SOURCE);
    writer.push(Command::Brd, 0, Address::Broadcast(0), &[0]).expect("it fits");
    let len = writer.finish();
    let back = wire.frame(buffer[..len].to_vec()).expect("an answer");
    assert_eq!(back[6..12], [0x12, 0x20, 0x30, 0x40, 0x50, 0x60]);
    assert_eq!(first(&back).wkc, 4);
}

/// Complete access gives sub-index 0 sixteen bits, or whoever maps by it reads types one too far.
#[test]
fn complete_access_pads_sub_index_0() {
    let mut wire = Wire::of(SegmentFile::built_in());
    let sm = |start: u16, length: u16, control: u8| {
        let ([a, b], [c, d]) = (start.to_le_bytes(), length.to_le_bytes());
        [a, b, c, d, control, 0, 1, 0]
    };
    // The EL2502-0010's mailbox.
    let device = 3;
    assert_eq!(wire.write(device, 0x0800, &sm(0x1000, 128, 0x26)), 1);
    assert_eq!(wire.write(device, 0x0808, &sm(0x1080, 128, 0x22)), 1);
    assert_eq!(wire.write(device, 0x0120, &[2, 0]), 1);
    wire.pause(Nanos::millis(50));
    assert_eq!(wire.read(device, 0x0130, 2).data, [2, 0]);
    let mut request = [0; 128];
    request[..16].copy_from_slice(&[
        10, 0, 0, 0, 0, 0x13, // mailbox header: 10 bytes, CoE, counter 1
        0, 0x20, // SDO request
        0x50, 0x00, 0x1C, 0x00, 0, 0, 0, 0, // upload, complete access, 0x1C00:00
    ]);
    assert_eq!(wire.write(device, 0x1000, &request), 1);
    wire.pause(Nanos::millis(10));
    let back = wire.read(device, 0x1080, 128);
    assert_eq!(back.wkc, 1);
    // Size 6, then the count in two bytes and four types in one each.
    assert_eq!(back.data[12..22], [6, 0, 0, 0, 4, 0, 1, 2, 3, 4]);
}

/// A session that ended by silence leaves an expired watchdog; the next one switches it off and
/// still comes to OP.
#[test]
fn watchdog_time_0_after_an_expired_watchdog() {
    let mut wire = Wire::new(SIMPLE);
    wire.session(50, false);
    wire.pause(Nanos::millis(1_000));
    let fallen = wire.server.served().segment().devices();
    assert!(fallen.iter().all(|d| d.stack.status_code() == AlStatusCode(0x001B)), "watchdogs");
    for position in 0..4 {
        assert_eq!(wire.read(position, 0x0440, 1).data, [0], "expired");
        assert_eq!(wire.write(position, 0x0420, &[0, 0]), 1);
    }
    for position in 0..4 {
        assert_eq!(
            wire.read(position, 0x0440, 1).data,
            [1],
            "a watchdog that is off has not expired"
        );
        assert_eq!(wire.write(position, 0x0120, &[0x11, 0]), 1);
    }
    wire.pause(Nanos::millis(50));
    assert_eq!(wire.states(), [AlState::Init; 4]);
    wire.session(50, true);
    assert_eq!(wire.states(), [AlState::Init; 4]);
}

/// Frames that follow each other at once are answered each for itself, in order, as fast as they
/// came.
#[test]
fn several_frames_in_flight() {
    let mut wire = Wire::new(SIMPLE);
    let now = wire.now;
    for number in 0..8u8 {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, SOURCE);
        writer.push(Command::Brd, number, Address::Broadcast(0), &[0]).expect("it fits");
        let len = writer.finish();
        let mut bytes = buffer[..len].to_vec();
        let answer = wire.server.frame(now, &mut bytes);
        assert!(matches!(answer, Answer::Back { hold: None, .. }), "{answer:?}");
        wire.server.after(&bytes);
        assert_eq!((bytes[17], first(&bytes).wkc), (number, 4));
    }
}

/// The longest frame: one datagram of 1486 bytes.
#[test]
fn a_full_frame_comes_back_whole() {
    let mut wire = Wire::new(SIMPLE);
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, SOURCE);
    writer.push(Command::Brd, 0, Address::Broadcast(0x1000), &[0; 1486]).expect("it fits");
    assert_eq!(writer.finish(), 1514);
    let back = wire.frame(buffer.to_vec()).expect("an answer");
    assert_eq!((back.len(), first(&back).wkc), (1514, 4));
}

/// AL control is locked until the SubDevice has read what was written: a second request within its
/// reaction time counts nothing, and the first one holds.
#[test]
fn al_control_is_locked_while_unread() {
    let mut wire = Wire::new(SIMPLE);
    assert_eq!(wire.write(0, 0x0120, &[2, 0]), 1);
    assert_eq!(wire.write(0, 0x0120, &[1, 0]), 0, "not yet read");
    wire.pause(Nanos::millis(20));
    assert_eq!(wire.read(0, 0x0130, 2).data, [2, 0]);
    assert_eq!(wire.write(0, 0x0120, &[1, 0]), 1);
}

/// One broadcast starts the EEPROMs of all SubDevices; each has its own word then.
#[test]
fn eeproms_are_read_by_broadcast() {
    let mut wire = Wire::of(SegmentFile::built_in());
    // Word 8: vendor id.
    let back = wire.datagram(Command::Bwr, Address::Broadcast(0x0502), &[0, 1, 8, 0, 0, 0]);
    assert_eq!(back.wkc, 5);
    wire.pause(Nanos::millis(10));
    for (position, vendor) in [0x6A, 0x6A, 0x02, 0x02, 0x0048_504D_u32].into_iter().enumerate() {
        let status = wire.read(position as u16, 0x0502, 2).data;
        assert_eq!(status[1] & 0x80, 0, "SubDevice {position} is busy");
        let word = wire.read(position as u16, 0x0508, 4);
        assert_eq!(
            (word.wkc, word.data),
            (1, vendor.to_le_bytes().to_vec()),
            "SubDevice {position}"
        );
    }
}

/// 15 000 drift frames as fast as a wire carries them: every one is answered, and in time.
#[test]
fn fifteen_thousand_drift_frames_in_a_burst() {
    let mut wire = Wire::new(SIMPLE);
    // Preamble to gap: 84 bytes of 80 ns.
    let pace = Nanos(84 * 80);
    let mut late = 0;
    for _ in 0..15_000 {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, SOURCE);
        let address = Address::Position(AutoIncrementAddress::of_position(0), 0x0910);
        writer.push(Command::Armw, 0, address, &[0; 8]).expect("it fits");
        let len = writer.finish();
        let mut bytes = buffer[..len].to_vec();
        let answer = wire.server.frame(wire.now, &mut bytes);
        late += u32::from(!matches!(answer, Answer::Back { hold: None, .. }));
        wire.server.after(&bytes);
        assert_eq!(first(&bytes).wkc, 4);
        wire.now += pace;
    }
    assert_eq!((late, wire.server.counts().answered), (0, 15_000));
}

/// What comes faster than any wire is slowed down to it, and nothing is lost.
#[test]
fn frames_faster_than_the_wire_wait_for_it() {
    let mut wire = Wire::new(SIMPLE);
    let mut last = wire.now;
    for number in 0..200 {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, SOURCE);
        writer.push(Command::Brd, 0, Address::Broadcast(0x1000), &[0; 1486]).expect("it fits");
        writer.finish();
        let mut bytes = buffer.to_vec();
        match wire.server.frame(wire.now, &mut bytes) {
            Answer::Back { hold: None, .. } => {
                assert!(number < 12, "frame {number}: 1 ms of lead is about 8 full frames")
            }
            Answer::Back { hold: Some(due), last_bit, .. } => {
                assert_eq!(due, last_bit, "no earlier than its last bit");
                assert!(number > 5 && due >= last, "frame {number}");
                last = due;
            }
            Answer::Lost => panic!("frame {number} is lost"),
        }
        wire.server.after(&bytes);
    }
    // 200 frames of 1538 bytes on the wire.
    let expected = Nanos(200 * 1538 * 80);
    let took = last - wire.now;
    assert!((took - expected).abs() < Nanos::micros(200), "{took} for {expected}");
}

/// A MainDevice that is killed in operation, silence, and another one: two sessions, told apart,
/// both to OP.
#[test]
fn a_second_session_after_an_abrupt_end() {
    let mut wire = Wire::of(SegmentFile::built_in());
    wire.session(100, false);
    assert!(wire.server.session().is_some_and(isocat::serve::server::Session::is_judged));
    wire.pause(Nanos::millis(2_000));
    wire.session(100, true);
    wire.pause(Nanos::millis(100));
    wire.server.finish(wire.now);
    let sessions = wire.server.sessions();
    assert_eq!(sessions.len(), 2);
    let ends: Vec<_> = sessions.iter().map(|session| session.end).collect();
    assert_eq!(ends, [isocat::serve::server::End::Abrupt, isocat::serve::server::End::Down]);
    for session in sessions {
        let judged = session.judged.as_ref().expect("it was in operation");
        assert!(
            judged.in_sync(),
            "{:?}",
            judged.devices.iter().map(|d| &d.findings).collect::<Vec<_>>()
        );
        assert_eq!(judged.devices_in_op, 5);
        let edges = judged.devices[1].sync0_error.expect("SYNC0");
        assert!((95..=220).contains(&edges.count()), "{}", edges.count());
        assert!((1..100_000).contains(&edges.worst()), "{} ps", edges.worst());
        assert_eq!(session.conduct.sync_verified(), Some(true));
    }
    let states: Vec<_> = std::iter::from_fn(|| wire.server.poll_event())
        .filter(|event| matches!(event, Event::InOperation { devices: 5 }))
        .collect();
    assert_eq!(states.len(), 2);
}

/// A MainDevice that is killed and started again at once: told apart by its giving addresses anew.
#[test]
fn a_session_that_follows_without_a_pause_is_one_of_its_own() {
    let mut wire = Wire::new(SIMPLE);
    wire.session(100, false);
    wire.session(60, true);
    wire.server.finish(wire.now);
    let cycles: Vec<_> = wire.server.sessions().iter().map(|s| s.conduct.cycle.count()).collect();
    assert_eq!(cycles.len(), 2, "{cycles:?}");
    assert!((95..=115).contains(&cycles[0]) && (55..=75).contains(&cycles[1]), "{cycles:?}");
}

/// SubDevices that go down one after another end the judging with the first, and those that are
/// still up do not begin another.
#[test]
fn going_down_one_by_one_is_not_a_new_operation() {
    let mut wire = Wire::new(SIMPLE);
    wire.session(50, false);
    for position in 0..4 {
        assert_eq!(wire.write(position, 0x0120, &[4, 0]), 1);
        wire.pause(Nanos::millis(5));
        wire.read(position, 0x0130, 2);
    }
    wire.server.finish(wire.now);
    let judged = wire.server.sessions()[0].judged.as_ref().expect("it was in operation");
    assert_eq!(judged.devices_in_op, 4);
    let findings: Vec<_> = judged.all_findings().collect();
    assert!(findings.is_empty(), "{findings:?}");
    assert!(judged.in_sync() && judged.ended - judged.began > Nanos::millis(40).into());
}

/// A SubDevice that fell and is brought back does not make the session one in sync.
#[test]
fn a_fall_that_was_mended_is_not_forgotten() {
    let mut wire = Wire::new(SIMPLE);
    let mut main = wire.session(50, false);
    // Its watchdog, as a cable that is out for a while does it; the MainDevice's own frames go on.
    wire.pause(Nanos::millis(150));
    for position in 0..4 {
        assert_eq!(wire.read(position, 0x0130, 1).data, [0x14]);
        assert_eq!(wire.write(position, 0x0120, &[0x14, 0]), 1);
    }
    wire.pause(Nanos::millis(2));
    let mut buffer = [0; FRAME_LEN];
    for cycle in 0..60 {
        main.handle_timeout(wire.now);
        while let Some(len) = main.poll_transmit(wire.now, &mut buffer) {
            if let Some(back) = wire.frame(buffer[..len].to_vec()) {
                main.handle_frame(wire.now, &back);
            }
        }
        if cycle == 5 {
            for position in 0..4 {
                assert_eq!(wire.write(position, 0x0120, &[8, 0]), 1);
            }
        }
        wire.now = wire.now.max(main.next_timeout().expect("it goes on"));
    }
    assert_eq!(wire.states(), [AlState::Op; 4]);
    wire.server.finish(wire.now);
    let summary = isocat::serve::Summary::new(&wire.server, "test", "none", Nanos(0));
    let judged = summary.sessions[0].judged.as_ref().expect("it was in operation");
    assert_eq!((judged.in_op, judged.earlier.len(), judged.in_sync), (4, 1, false));
    let fell = &judged.earlier[0].findings;
    assert!(fell.iter().all(|what| what.contains("0x001B")), "{fell:?}");
    assert!(!judged.earlier[0].findings.is_empty());
    assert!(summary.text().contains("Not in sync throughout"), "{}", summary.text());
}

/// What a MainDevice leaves out is said, and what it does is not: the same segment, once with our
/// own and once with one that only sets SYNC registers.
#[test]
fn the_summary_says_what_was_left_out() {
    let mut wire = Wire::of(SegmentFile::built_in());
    wire.session(200, true);
    wire.server.finish(wire.now);
    let remarks = remarks(&wire);
    assert!(!remarks.iter().any(|r| r.contains("SYNC was activated")), "{remarks:?}");
    assert!(!remarks.iter().any(|r| r.contains("delays")), "{remarks:?}");

    let mut wire = Wire::of(SegmentFile::built_in());
    assert_eq!(wire.write(0, 0x09A0, &1_000_000u32.to_le_bytes()), 1);
    assert_eq!(wire.write(0, 0x0980, &[0, 3]), 1);
    wire.server.finish(wire.now);
    let remarks = self::remarks(&wire);
    for expected in
        ["never seen to run", "delays were not measured", "0x1C32:05", "never distributed"]
    {
        assert!(remarks.iter().any(|r| r.contains(expected)), "{expected}: {remarks:?}");
    }
}

fn remarks(wire: &Wire) -> Vec<String> {
    let summary = isocat::serve::Summary::new(&wire.server, "test", "none", Nanos(0));
    summary.sessions.into_iter().flat_map(|session| session.remarks).collect()
}
