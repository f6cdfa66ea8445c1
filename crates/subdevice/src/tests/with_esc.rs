//! The stack behind the software ESC, as a MainDevice sees it on the wire.

use std::vec;
use std::vec::Vec;

use isocat_esc::{Esc, EscEvent, LAN9252, Pdi};
use isocat_sync::Event;
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::register::{self, Value, al_event, sync_manager};
use isocat_wire::sii::{Header, Writer};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{
    AlState, AlStatus, AlStatusCode, AutoIncrementAddress, Command, Nanos, Register,
};

use super::bench::{Call, Probe};
use super::device::{Builder, description};
use crate::stack::SubDevice;

/// A SubDevice with its ESC, and frames to it.
struct Wire {
    esc: Esc<Vec<u8>>,
    device: SubDevice<Probe, Vec<u8>>,
    now: Time<Device>,
    /// When the main loop runs next: it needs 50 us to react.
    polling: Option<Time<Device>>,
}

/// Wire time of a short frame.
const FRAME: Nanos = Nanos(6_720);
const CYCLE: Nanos = Nanos(1_000_000);

impl Wire {
    fn new(change: impl FnOnce(&mut Builder)) -> Self {
        let mut sii = vec![0; 256];
        // SPI; SYNC unit on; SYNC0 pulses of 1 us.
        let header = Header {
            configuration: [0x05, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            ..Header::default()
        };
        Writer::new(&mut sii, &header).unwrap().finish().unwrap();
        let description = description(change);
        let store = vec![0; description.store_len()];
        Self {
            esc: Esc::new(&LAN9252, sii, vec![0; 4096]),
            device: SubDevice::new(description, store, Probe::default()),
            now: Time::new(10_000_000),
            polling: None,
        }
    }

    /// Processes all events until `end`.
    fn until(&mut self, end: Time<Device>) {
        loop {
            let never = Time::NEVER;
            let due = [self.polling, self.device.next_timeout()].map(|due| due.unwrap_or(never));
            let at = due[0].min(due[1]).min(self.esc.next_event());
            if at > end {
                break;
            }
            self.now = at;
            if let Some((at, event)) = self.esc.step(at) {
                self.esc_event(at, event);
            } else {
                self.polling = self.polling.filter(|due| *due > at);
                self.run(Event::Timer);
                self.device.poll(at, &mut self.esc.pdi(at));
            }
        }
        self.now = end;
    }

    fn esc_event(&mut self, at: Time<Device>, event: EscEvent) {
        match event {
            EscEvent::FrameEnd { al_events } => {
                if al_events & al_event::sync_manager(2) != 0 {
                    self.run(Event::Sm2);
                }
                if al_events & al_event::sync_manager(3) != 0 {
                    self.run(Event::Sm3);
                }
                let cyclic = al_event::sync_manager(2) | al_event::sync_manager(3);
                if al_events & !cyclic != 0 {
                    self.polling.get_or_insert(at + Nanos(50_000));
                }
            }
            EscEvent::Sync0 => self.run(Event::Sync0),
            _ => {
                self.polling.get_or_insert(at + Nanos(50_000));
            }
        }
    }

    fn run(&mut self, event: Event) {
        let now = self.now;
        let steps = self.device.handle_event(now, event, &mut self.esc.pdi(now));
        for (step, _) in steps {
            self.device.begin(now, step, &mut self.esc.pdi(now));
            self.device.finish(now, step, &mut self.esc.pdi(now));
        }
    }

    /// Sends one datagram; returns its working counter and data.
    fn datagram(&mut self, command: Command, address: u16, data: &[u8]) -> (u16, Vec<u8>) {
        let mut buffer = [0; 600];
        let mut frame = FrameWriter::new(&mut buffer, [2; 6]);
        let place = Address::Position(AutoIncrementAddress(0), address);
        let at = frame.push(command, 0, place, data).unwrap();
        let len = frame.finish();
        let end = self.now + FRAME;
        self.until(self.now);
        self.esc.process(&mut buffer[..len], self.now, end, true);
        self.until(end);
        let behind = at + data.len();
        let counter = u16::from_le_bytes([buffer[behind], buffer[behind + 1]]);
        (counter, buffer[at..behind].to_vec())
    }

    fn write<T: Value>(&mut self, register: Register<T>, value: T) {
        let bytes = value.to_bytes();
        let (counter, _) = self.datagram(Command::Apwr, register.address, bytes.as_ref());
        assert_eq!(counter, 1, "write of 0x{:04X}", register.address);
    }

    fn read<T: Value>(&mut self, register: Register<T>) -> T {
        let (counter, data) = self.datagram(Command::Aprd, register.address, &vec![0; T::LEN]);
        assert_eq!(counter, 1, "read of 0x{:04X}", register.address);
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&data);
        T::from_bytes(bytes)
    }

    fn status(&mut self) -> (AlStatus, AlStatusCode) {
        (self.read(register::AL_STATUS), self.read(register::AL_STATUS_CODE))
    }

    /// Requests a state, and waits a millisecond.
    fn ask(&mut self, state: AlState) -> (AlStatus, AlStatusCode) {
        self.write(register::AL_CONTROL, isocat_wire::AlControl::request_and_acknowledge(state));
        self.until(self.now + Nanos(1_000_000));
        self.status()
    }

    fn set_mailbox(&mut self) {
        self.write(sync_manager(0), SyncManager::new(0x1000, 64, SyncManager::MAILBOX_OUT, true));
        self.write(sync_manager(1), SyncManager::new(0x1080, 64, SyncManager::MAILBOX_IN, true));
    }

    fn set_process_data(&mut self) {
        self.write(sync_manager(2), SyncManager::new(0x1100, 7, SyncManager::OUTPUTS, true));
        self.write(sync_manager(3), SyncManager::new(0x1400, 7, SyncManager::INPUTS, true));
    }

    /// Sends a mailbox service and returns its answer.
    fn mailbox(&mut self, request: &[u8]) -> Vec<u8> {
        let mut message = vec![0; 64];
        message[..request.len()].copy_from_slice(request);
        assert_eq!(self.datagram(Command::Apwr, 0x1000, &message).0, 1);
        assert_eq!(self.datagram(Command::Apwr, 0x1000, &message).0, 0, "full");
        while self.read(register::sm_status(1)) & SyncManager::STATUS_FULL == 0 {}
        let (counter, answer) = self.datagram(Command::Aprd, 0x1080, &[0; 64]);
        assert_eq!(counter, 1);
        assert_eq!(self.datagram(Command::Aprd, 0x1080, &[0; 64]).0, 0, "read once");
        answer
    }

    /// From power-on to SAFEOP, with SYNC0 every millisecond or without.
    fn safe_op(&mut self, dc: bool) {
        assert_eq!(self.ask(AlState::Init), (AlStatus(1), AlStatusCode(0)));
        self.set_mailbox();
        assert_eq!(self.ask(AlState::PreOp), (AlStatus(2), AlStatusCode(0)));
        self.set_process_data();
        if dc {
            self.write(register::SYNC0_CYCLE, 1_000_000);
            let start = self.read(register::SYSTEM_TIME) + 2_000_000;
            self.write(register::SYNC_START_TIME, start);
            self.write(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(3));
        }
        assert_eq!(self.ask(AlState::SafeOp), (AlStatus(4), AlStatusCode(0)));
        let (counter, inputs) = self.datagram(Command::Aprd, 0x1400, &[0; 7]);
        assert_eq!((counter, inputs), (1, vec![1; 7]), "inputs stand there from the start");
    }

    /// Runs some cycles with frames: inputs out, outputs in. The cycle is that of the device's
    /// oscillator.
    fn cycles(&mut self, count: usize, outputs: Option<&[u8; 7]>) {
        for _ in 0..count {
            let end = self.now + CYCLE;
            if let Some(outputs) = outputs {
                assert_eq!(self.datagram(Command::Apwr, 0x1100, outputs).0, 1);
            }
            assert_eq!(self.datagram(Command::Aprd, 0x1400, &[0; 7]).0, 1);
            self.until(end);
        }
    }
}

#[test]
fn sdo_over_the_wire() {
    let mut wire = Wire::new(|_| {});
    wire.ask(AlState::Init);
    wire.set_mailbox();
    wire.ask(AlState::PreOp);
    // The two messages of a captured upload, and the states of SM1 around them.
    let request = [0x0A, 0, 0, 0, 0, 0x13, 0x00, 0x20, 0x40, 0x0A, 0x10, 0x00];
    assert_eq!(wire.read(register::sm_status(1)), 0x00);
    let answer = wire.mailbox(&request);
    let expected = [0x0A, 0, 0, 0, 0, 0x13, 0x00, 0x30, 0x4B, 0x0A, 0x10, 0x00, 0x30, 0x38];
    assert_eq!(answer[..14], expected);
    wire.until(wire.now + Nanos(100_000));
    assert_eq!(wire.read(register::sm_status(1)) & 0x0B, 0, "released");
    let again = wire.mailbox(&[0x0A, 0, 0, 0, 0, 0x23, 0x00, 0x20, 0x40, 0x32, 0x1C, 0x04]);
    assert_eq!(again[5..14], [0x23, 0x00, 0x30, 0x4B, 0x32, 0x1C, 0x04, 0x27, 0x00]);
}

#[test]
fn a_lost_answer_is_repeated_by_the_esc() {
    let mut wire = Wire::new(|_| {});
    wire.ask(AlState::Init);
    wire.set_mailbox();
    wire.ask(AlState::PreOp);
    let answer = wire.mailbox(&[0x0A, 0, 0, 0, 0, 0x13, 0, 0x20, 0x40, 0x0A, 0x10, 0]);
    wire.write(register::sm_activate(1), 0x03);
    wire.until(wire.now + Nanos(200_000));
    assert_eq!(wire.read(register::sm_pdi_control(1)) & 0x02, 0x02);
    let (counter, again) = wire.datagram(Command::Aprd, 0x1080, &[0; 64]);
    assert_eq!((counter, &again[..14]), (1, &answer[..14]));
}

#[test]
fn sm_synchronous_to_op_and_out_by_the_watchdog() {
    let mut wire = Wire::new(|_| {});
    wire.safe_op(false);
    wire.write(register::AL_CONTROL, isocat_wire::AlControl::request(AlState::Op));
    wire.until(wire.now + Nanos(500_000));
    assert_eq!(wire.status(), (AlStatus(4), AlStatusCode(0)), "no outputs yet");
    wire.cycles(3, Some(&[1; 7]));
    assert_eq!(wire.status(), (AlStatus(8), AlStatusCode(0)));
    wire.device.application_mut().calls.clear();
    wire.cycles(2, Some(&[2; 7]));
    let mapped = wire.device.application().calls.iter().filter(|call| matches!(call, Call::Map(_)));
    assert_eq!(mapped.collect::<Vec<_>>(), [&Call::Map(vec![2; 7]), &Call::Map(vec![2; 7])]);
    assert_eq!(wire.device.sync().cycle_time_too_small(), 0);
    wire.until(wire.now + Nanos::millis(98));
    assert_eq!(wire.status(), (AlStatus(8), AlStatusCode(0)));
    wire.until(wire.now + Nanos::millis(3));
    assert_eq!(wire.status(), (AlStatus(0x14), AlStatusCode::WATCHDOG));
    assert_eq!(wire.datagram(Command::Apwr, 0x1100, &[1; 7]).0, 0, "outputs are refused");
    assert_eq!(wire.ask(AlState::SafeOp), (AlStatus(4), AlStatusCode(0)));
    assert_eq!(wire.datagram(Command::Apwr, 0x1100, &[1; 7]).0, 1);
}

#[test]
fn dc_sync0_to_op_and_out_by_missing_outputs() {
    let mut wire = Wire::new(|_| {});
    wire.safe_op(true);
    wire.cycles(5, Some(&[1; 7]));
    assert_eq!(wire.ask(AlState::Op), (AlStatus(4), AlStatusCode(0)));
    wire.cycles(205, Some(&[1; 7]));
    assert_eq!(wire.status(), (AlStatus(8), AlStatusCode(0)));
    wire.cycles(1000, Some(&[1; 7]));
    let sync = wire.device.sync();
    assert_eq!((sync.sm_event_missed(), sync.missed_events_total()), (0, 0));
    assert_eq!(sync.cycle(), CYCLE);
    wire.cycles(1, None);
    assert_eq!(wire.device.sync().sm_event_missed(), 3);
    assert_eq!(wire.device.state(), AlState::Op);
    wire.cycles(1, None);
    assert_eq!(wire.status(), (AlStatus(0x14), AlStatusCode::SYNCHRONIZATION_ERROR));
}

#[test]
fn sync_that_is_switched_off_ends_op() {
    let mut wire = Wire::new(|_| {});
    wire.safe_op(true);
    wire.cycles(1, Some(&[1; 7]));
    wire.ask(AlState::Op);
    wire.cycles(210, Some(&[1; 7]));
    assert_eq!(wire.device.state(), AlState::Op);
    wire.write(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(0));
    wire.cycles(2, Some(&[1; 7]));
    assert_eq!(wire.device.state(), AlState::Op, "one that is missing may be late");
    wire.until(wire.now + Nanos::millis(2));
    assert_eq!(wire.status(), (AlStatus(0x14), AlStatusCode::FATAL_SYNC_ERROR));
}

#[test]
fn sync_that_is_switched_off_and_on_again() {
    let switch_on = |wire: &mut Wire| {
        let start = wire.read(register::SYSTEM_TIME) + 1_500_000;
        wire.write(register::SYNC_START_TIME, start);
        wire.write(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(3));
    };
    let mut wire = Wire::new(|_| {});
    wire.safe_op(true);
    wire.cycles(1, Some(&[1; 7]));
    wire.ask(AlState::Op);
    wire.cycles(210, Some(&[1; 7]));
    assert_eq!(wire.device.state(), AlState::Op);

    // Two pulses may be late: a new start time within this time is no error, and no event is lost.
    wire.write(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(0));
    switch_on(&mut wire);
    wire.cycles(50, Some(&[1; 7]));
    assert_eq!(wire.status(), (AlStatus(8), AlStatusCode(0)));
    assert_eq!(wire.device.sync().sm_event_missed(), 0);

    // Off for good, and on after the error: OP is entered again once SYNC0 and outputs come.
    wire.write(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(0));
    wire.cycles(10, None);
    assert_eq!(wire.status(), (AlStatus(0x14), AlStatusCode::FATAL_SYNC_ERROR));
    switch_on(&mut wire);
    wire.cycles(10, None);
    assert_eq!(wire.status().0, AlStatus(0x14), "the error stays until it is acknowledged");
    assert_eq!(wire.ask(AlState::SafeOp), (AlStatus(4), AlStatusCode(0)));
    wire.cycles(1, Some(&[1; 7]));
    wire.ask(AlState::Op);
    wire.cycles(210, Some(&[1; 7]));
    assert_eq!(wire.status(), (AlStatus(8), AlStatusCode(0)));
}

#[test]
fn free_run_to_op() {
    let mut wire = Wire::new(|d| {
        d.preset(0x1C32, 4, &[1, 0x40]);
        d.preset(0x1C33, 4, &[1, 0x40]);
    });
    wire.safe_op(false);
    wire.cycles(2, Some(&[1; 7]));
    assert_eq!(wire.ask(AlState::Op), (AlStatus(8), AlStatusCode(0)));
    wire.cycles(20, Some(&[1; 7]));
    assert_eq!(wire.device.sync().mode(), isocat_sync::SyncMode::FreeRun);
    let applied = |call: &&Call| matches!(call, Call::Application(_));
    let before = wire.device.application().calls.iter().filter(applied).count();
    wire.cycles(10, Some(&[1; 7]));
    let after = wire.device.application().calls.iter().filter(applied).count();
    assert_eq!(after - before, 10, "once a period of its own");
}

#[test]
fn safeop_is_entered_again_while_frames_pass() {
    let mut wire = Wire::new(|_| {});
    wire.safe_op(false);
    assert_eq!(wire.ask(AlState::PreOp), (AlStatus(2), AlStatusCode(0)));
    assert_eq!(wire.datagram(Command::Aprd, 0x1400, &[0; 7]).0, 0, "closed in PREOP");
    wire.write(register::AL_CONTROL, isocat_wire::AlControl::request(AlState::SafeOp));
    // Frames follow each other: the main loop reads the ESC while one of them passes.
    for _ in 0..20 {
        wire.read(register::DL_STATUS);
    }
    assert_eq!(wire.status(), (AlStatus(4), AlStatusCode(0)));
    assert_eq!(wire.datagram(Command::Aprd, 0x1400, &[0; 7]).0, 1);
    let events = wire.esc.pdi(wire.now).events();
    assert_eq!(events & al_event::AL_CONTROL, 0);
}
