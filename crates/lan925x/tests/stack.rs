//! Tests the whole SubDevice stack with the driver: a MainDevice's frames on one side of the chip,
//! SPI on the other.

mod chip;
/// The device of the firmware: an I/O device with four bytes in each direction.
#[path = "../../../firmware/src/device.rs"]
mod device;

use chip::Board;
use isocat_esc::EscEvent;
use isocat_lan925x::Lan925x;
use isocat_subdevice::{Event, Io, SubDevice};
use isocat_wire::datagram::Address;
use isocat_wire::dc::SyncActivation;
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::FrameWriter;
use isocat_wire::register::{self, Value, al_event, fmmu, sync_manager};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{
    AlControl, AlState, AlStatus, AlStatusCode, AutoIncrementAddress, Command, Nanos, Register,
    frame,
};

/// CPU, chip and cable.
struct Rig {
    board: Board,
    driver: Lan925x<Board>,
    stack: SubDevice<Io, [u8; device::STORE]>,
    /// When the main loop runs next.
    polling: Option<Time<Device>>,
}

impl Rig {
    fn new() -> Self {
        let board = Board::new();
        let mut driver = Lan925x::new(board.clone());
        driver.reset(&mut board.clone()).unwrap();
        let stack = SubDevice::new(&device::DESCRIPTION, [0; device::STORE], Io::new());
        Self { board, driver, stack, polling: None }
    }

    fn now(&self) -> Time<Device> {
        self.board.0.borrow().now
    }

    /// Runs the CPU until `end`: interrupts in the order of the chip's events, each as soon as the
    /// CPU is free, and the main loop.
    fn until(&mut self, end: Time<Device>) {
        loop {
            let event = self.board.0.borrow_mut().events.pop_front();
            if let Some((at, event)) = event {
                self.interrupt(at, event);
                continue;
            }
            let own = [self.polling, self.stack.next_timeout()];
            let own = own.into_iter().flatten().fold(Time::NEVER, Time::min);
            let (now, next) = (self.now(), self.board.0.borrow().next());
            if own.max(now) <= next.min(end) {
                self.board.0.borrow_mut().advance(own.max(now));
                self.polling = self.polling.filter(|due| *due > self.now());
                self.run(Event::Timer);
                let now = self.now();
                self.stack.poll(now, &mut self.driver);
            } else if next <= end {
                self.board.0.borrow_mut().advance(next);
            } else {
                self.board.0.borrow_mut().advance(end);
                break;
            }
        }
    }

    fn interrupt(&mut self, at: Time<Device>, event: EscEvent) {
        let mut look = true;
        match event {
            EscEvent::FrameEnd { al_events } => {
                let cyclic = [(2, Event::Sm2), (3, Event::Sm3)];
                for (number, event) in cyclic {
                    if al_events & al_event::sync_manager(number) != 0 {
                        self.run(event);
                    }
                    // The line is a level: if the buffer could not be read, the interrupt comes
                    // again.
                    let now = self.now();
                    let standing = self.board.0.borrow().esc.al_events(now);
                    if number == 2 && standing & al_event::sync_manager(2) != 0 {
                        self.run(event);
                    }
                }
                let own = al_event::sync_manager(2) | al_event::sync_manager(3);
                look = al_events & !own != 0;
            }
            EscEvent::Sync0 => self.run(Event::Sync0),
            _ => {}
        }
        if look {
            self.polling.get_or_insert(at + Nanos::micros(20));
        }
    }

    fn run(&mut self, event: Event) {
        let now = self.now();
        let steps = self.stack.handle_event(now, event, &mut self.driver);
        for (step, delay) in steps {
            let due = (now + delay).max(self.now());
            self.board.0.borrow_mut().advance(due);
            self.stack.begin(due, step, &mut self.driver);
            let now = self.now();
            self.stack.finish(now, step, &mut self.driver);
        }
    }

    /// Sends a frame with one datagram, which arrives at `at`; returns its working counter and data
    /// afterwards.
    fn datagram_at(
        &mut self,
        at: Time<Device>,
        command: Command,
        address: Address,
        data: &[u8],
    ) -> (u16, Vec<u8>) {
        let mut buffer = [0; 200];
        let mut writer = FrameWriter::new(&mut buffer, [2; 6]);
        let place = writer.push(command, 0, address, data).unwrap();
        let len = writer.finish();
        self.board.0.borrow_mut().arriving.push_back((at, buffer[..len].to_vec()));
        self.until(at + Nanos(frame::duration_ns(len) as i64));
        let passed = self.board.0.borrow_mut().passed.remove(0);
        let behind = place + data.len();
        let counter = u16::from_le_bytes([passed[behind], passed[behind + 1]]);
        (counter, passed[place..behind].to_vec())
    }

    fn datagram(&mut self, command: Command, address: u16, data: &[u8]) -> Vec<u8> {
        let (now, address) = (self.now(), Address::Position(AutoIncrementAddress(0), address));
        let (counter, data) = self.datagram_at(now, command, address, data);
        assert_eq!(counter, 1, "{command:?} {address:?}");
        data
    }

    fn write<T: Value>(&mut self, register: Register<T>, value: T) {
        self.datagram(Command::Apwr, register.address, value.to_bytes().as_ref());
    }

    fn read<T: Value>(&mut self, register: Register<T>) -> T {
        let data = self.datagram(Command::Aprd, register.address, &vec![0; T::LEN]);
        let mut bytes = T::Bytes::default();
        bytes.as_mut().copy_from_slice(&data);
        T::from_bytes(bytes)
    }

    fn status(&mut self) -> (AlStatus, AlStatusCode) {
        (self.read(register::AL_STATUS), self.read(register::AL_STATUS_CODE))
    }

    /// Requests a state, and waits two milliseconds.
    fn ask(&mut self, state: AlState) -> (AlStatus, AlStatusCode) {
        self.write(register::AL_CONTROL, AlControl::request_and_acknowledge(state));
        self.until(self.now() + Nanos::millis(2));
        self.status()
    }

    /// Goes from INIT to PREOP.
    fn pre_op(&mut self) {
        assert_eq!(self.ask(AlState::Init), (AlStatus(1), AlStatusCode(0)));
        self.write(sync_manager(0), SyncManager::new(0x1000, 64, SyncManager::MAILBOX_OUT, true));
        self.write(sync_manager(1), SyncManager::new(0x1080, 64, SyncManager::MAILBOX_IN, true));
        assert_eq!(self.ask(AlState::PreOp), (AlStatus(2), AlStatusCode(0)));
    }

    /// Goes from PREOP to SAFEOP with SYNC0 every millisecond; returns the instant of the first
    /// SYNC0.
    fn safe_op(&mut self) -> Time<Device> {
        self.write(sync_manager(2), SyncManager::new(0x1100, 4, SyncManager::OUTPUTS, true));
        self.write(sync_manager(3), SyncManager::new(0x1400, 4, SyncManager::INPUTS, true));
        self.write(fmmu(0), Fmmu::bytes(0, 4, 0x1100, Fmmu::WRITE));
        self.write(fmmu(1), Fmmu::bytes(0, 4, 0x1400, Fmmu::READ));
        self.write(register::SYNC0_CYCLE, 1_000_000);
        let system = self.read(register::SYSTEM_TIME) + 10_000_000;
        self.write(register::SYNC_START_TIME, system);
        self.write(register::SYNC_ACTIVATION, SyncActivation(3));
        assert_eq!(self.ask(AlState::SafeOp), (AlStatus(4), AlStatusCode(0)));
        let now = self.now();
        self.board.0.borrow().esc.first_reaching(Time::new(system), now)
    }

    /// Runs a cycle with its frame half a millisecond before `sync0`, and the main loop afterwards;
    /// returns the inputs.
    fn cycle(&mut self, sync0: Time<Device>, outputs: u32) -> u32 {
        let data = outputs.to_le_bytes();
        let at = sync0 + Nanos::micros(-500);
        let (counter, inputs) = self.datagram_at(at, Command::Lrw, Address::Logical(0), &data);
        assert_eq!(counter, 3, "outputs written and inputs read");
        self.until(sync0 + Nanos::micros(300));
        u32::from_le_bytes(inputs.try_into().unwrap())
    }

    fn assert_clean(&self) {
        assert_eq!(self.driver.fault(), None);
        assert_eq!(self.board.0.borrow().breaches, [""; 0]);
    }
}

#[test]
fn mailbox_over_spi() {
    let mut rig = Rig::new();
    rig.pre_op();
    let mut request = vec![0; 64];
    request[..12].copy_from_slice(&[0x0A, 0, 0, 0, 0, 0x13, 0, 0x20, 0x40, 0x32, 0x1C, 0x05]);
    rig.datagram(Command::Apwr, 0x1000, &request);
    while rig.read(register::sm_status(1)) & SyncManager::STATUS_FULL == 0 {}
    let answer = rig.datagram(Command::Aprd, 0x1080, &[0; 64]);
    let [a, b, c, d] = 250_000u32.to_le_bytes();
    assert_eq!(answer[..16], [0x0A, 0, 0, 0, 0, 0x13, 0, 0x30, 0x43, 0x32, 0x1C, 5, a, b, c, d]);
    rig.assert_clean();
}

#[test]
fn the_pin_is_a_level_as_long_as_an_event_stands() {
    for active_high in [false, true] {
        let mut rig = Rig::new();
        let pin = |rig: &Rig| rig.board.0.borrow().pin();
        // Waits until all events of the start were processed.
        rig.until(rig.now() + Nanos::micros(100));
        assert_eq!(pin(&rig), None);
        rig.driver.enable_interrupt(active_high).unwrap();
        assert_eq!(pin(&rig), Some(!active_high));
        // The ESC takes the frame at its next tick, and the main loop runs 20 us later.
        rig.write(register::AL_CONTROL, AlControl::request(AlState::Init));
        rig.until(rig.now() + Nanos(10));
        assert_eq!(pin(&rig), Some(active_high));
        rig.until(rig.now() + Nanos::micros(100));
        assert_eq!(pin(&rig), Some(!active_high));
        rig.assert_clean();
    }
}

#[test]
fn from_init_to_op_with_sync0_over_spi() {
    let mut rig = Rig::new();
    rig.pre_op();
    let first = rig.safe_op();
    let sync0 = |number: u32| first + Nanos::millis(i64::from(number));
    rig.cycle(sync0(0), 0);
    assert_eq!(rig.ask(AlState::Op).0, AlStatus(4), "not before SYNC0 has settled");
    // The request took two cycles without a frame; after that, the first good cycle restarted the
    // count.
    let mut number = 3;
    while rig.stack.state() != AlState::Op && number < 300 {
        rig.cycle(sync0(number), number);
        number += 1;
    }
    assert_eq!(rig.status(), (AlStatus(8), AlStatusCode(0)), "in cycle {number}");
    for _ in 0..3 {
        rig.cycle(sync0(number), number);
        number += 1;
    }
    let (bytes, transactions) = (rig.board.0.borrow().bytes, rig.board.0.borrow().transactions);
    for _ in 0..100 {
        assert_eq!(rig.cycle(sync0(number), number), number - 2, "what was put out comes back");
        number += 1;
    }
    let cycle = |before: u64, after: u64| (after - before) / 100;
    let bytes = cycle(bytes, rig.board.0.borrow().bytes);
    let transactions = cycle(transactions, rig.board.0.borrow().transactions);
    println!("a cycle of 4 bytes each way: {transactions} SPI transactions, {bytes} bytes");
    assert!((10..=14).contains(&transactions), "12 as the crate's page says: {transactions}");
    assert!((75..=95).contains(&bytes), "84 as the crate's page says: {bytes}");
    assert_eq!(rig.stack.sync().missed_events_total(), 0);
    assert_eq!(rig.stack.sync().cycle_time_too_small(), 0);
    rig.assert_clean();

    // A missing frame counts three, and each following frame reduces the counter by one.
    rig.until(sync0(number) + Nanos::micros(300));
    assert_eq!(rig.stack.sync().sm_event_missed(), 3);
    rig.cycle(sync0(number + 1), 1);
    assert_eq!(rig.stack.sync().sm_event_missed(), 2);
    assert_eq!(rig.ask(AlState::Init), (AlStatus(1), AlStatusCode(0)));
    rig.assert_clean();
}

/// The bus fails in one transaction at a time, anywhere in the cycle: the device stays in OP or
/// tells why not, and never passes on outputs that were not sent.
#[test]
fn a_disturbed_bus_in_op() {
    let mut rig = Rig::new();
    rig.pre_op();
    let first = rig.safe_op();
    let sync0 = |number: u32| first + Nanos::millis(i64::from(number));
    rig.cycle(sync0(0), 0);
    rig.ask(AlState::Op);
    for number in 3..230 {
        rig.cycle(sync0(number), number);
    }
    assert_eq!(rig.status(), (AlStatus(8), AlStatusCode(0)));
    let mut number = 230;
    for place in 1..40 {
        let before = rig.board.0.borrow().transactions;
        rig.board.0.borrow_mut().failing = vec![before + place];
        for _ in 0..6 {
            let inputs = rig.cycle(sync0(number), number);
            let known = inputs == 0 || (number - 4..number).contains(&inputs);
            assert!(known, "transaction {place}: {inputs} in cycle {number}");
            number += 1;
        }
        assert_eq!(rig.status(), (AlStatus(8), AlStatusCode(0)), "transaction {place}");
    }
    assert!(rig.driver.faults() > 10, "the bus did fail: {}", rig.driver.faults());
    assert_eq!(rig.board.0.borrow().breaches, [""; 0]);
}
