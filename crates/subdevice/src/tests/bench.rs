//! A SubDevice on the bench: a stand-in for its ESC, and the acts of a MainDevice.
//!
//! The stand-in has the parts that the stack can notice: AL control, SyncManager handshakes and
//! events. It is written independently of the software ESC, so that both cannot have the same
//! error.

use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use isocat_esc::Pdi;
use isocat_sync::{Event, Step};
use isocat_wire::coe::sdo::Initiate;
use isocat_wire::mailbox::{Header, Protocol};
use isocat_wire::register::{self, al_event, sync_manager};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{AbortCode, AlControl, AlState, AlStatus, AlStatusCode, Nanos, ObjectAddress};

use crate::application::Application;
use crate::description::Description;
use crate::stack::SubDevice;

/// The ESC's memory and events.
pub struct FakeEsc {
    pub memory: Box<[u8; 0x3000]>,
    pub events: u32,
    /// PDI control that was written while a frame passes, and takes effect at its end.
    pub passing: Option<Vec<(usize, u8)>>,
}

impl FakeEsc {
    fn new() -> Self {
        let mut memory = Box::new([0; 0x3000]);
        register::RAM_SIZE.store(&mut memory[..], 4);
        register::AL_STATUS.store(&mut memory[..], AlStatus::new(AlState::Init));
        register::WATCHDOG_TIME_PROCESS_DATA.store(&mut memory[..], 1000);
        register::SYNC_PULSE_LENGTH.store(&mut memory[..], 100);
        Self { memory, events: 0, passing: None }
    }

    pub fn sm(&self, number: usize) -> SyncManager {
        sync_manager(number).load(&self.memory[..])
    }

    pub fn set_sm(&mut self, number: usize, sm: SyncManager) {
        sync_manager(number).store(&mut self.memory[..], sm);
    }

    /// Ends the present frame.
    pub fn end_frame(&mut self) {
        for (address, value) in self.passing.take().into_iter().flatten() {
            self.write(address as u16, &[value]);
        }
    }

    /// Handles an access of the PDI to `address..end`: events of the SyncManagers that it opens or
    /// closes.
    fn touch(&mut self, address: usize, end: usize) {
        for number in 0..6 {
            let mut sm = self.sm(number);
            let (first, last) = (usize::from(sm.start), sm.end() as usize);
            if !sm.is_enabled() || sm.length == 0 {
                continue;
            }
            if (address..end).contains(&first) {
                self.events &= !al_event::sync_manager(number);
            }
            if (address..end).contains(&(last - 1)) && sm.is_mailbox() {
                sm.status &= !SyncManager::STATUS_FULL;
                sm.status |= if sm.is_ecat_write() { 0 } else { SyncManager::STATUS_FULL };
                self.set_sm(number, sm);
            }
        }
    }
}

impl Pdi for FakeEsc {
    fn read(&mut self, address: u16, data: &mut [u8]) {
        let (start, end) = (usize::from(address), usize::from(address) + data.len());
        data.copy_from_slice(&self.memory[start..end]);
        if (start..end).contains(&0x0120) {
            self.events &= !al_event::AL_CONTROL;
        }
        if (start..end).contains(&0x0806) {
            self.events &= !al_event::SM_ACTIVATION;
        }
        if (start..end).contains(&0x0440) {
            self.events &= !al_event::WATCHDOG;
        }
        self.touch(start, end);
    }

    fn write(&mut self, address: u16, data: &[u8]) {
        let (start, end) = (usize::from(address), usize::from(address) + data.len());
        if start & !0x38 == 0x0807
            && let Some(passing) = &mut self.passing
        {
            return passing.push((start, data[0]));
        }
        // A closed SyncManager shields process memory, never a register that it is set to.
        let closed = |n| self.sm(n).pdi_control & 1 != 0 && self.sm(n).start == address;
        if address >= 0x1000 && (0..6).any(closed) {
            return;
        }
        self.memory[start..end].copy_from_slice(data);
        for number in 0..6 {
            let mut sm = self.sm(number);
            if start == usize::from(register::sm_pdi_control(number).address)
                && sm.pdi_control & 1 != 0
            {
                sm.status = 0;
                self.set_sm(number, sm);
                self.events &= !al_event::sync_manager(number);
            }
        }
        self.touch(start, end);
    }

    fn events(&mut self) -> u32 {
        self.events
    }
}

/// The calls of the application, in order.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Call {
    Map(Vec<u8>),
    Application(Nanos),
    Valid,
    Latch,
    Inputs,
    Safe,
}

/// An application that records its calls. Its inputs count up.
#[derive(Default)]
pub struct Probe {
    pub calls: Vec<Call>,
    pub refuse_writes: bool,
    count: u8,
}

impl Application for Probe {
    fn map_outputs(&mut self, outputs: &[u8]) {
        self.calls.push(Call::Map(outputs.to_vec()));
    }
    fn application(&mut self, cycle: Nanos) {
        self.calls.push(Call::Application(cycle));
    }
    fn outputs_valid(&mut self) {
        self.calls.push(Call::Valid);
    }
    fn latch_inputs(&mut self) {
        self.calls.push(Call::Latch);
    }
    fn map_inputs(&mut self, inputs: &mut [u8]) {
        self.count = self.count.wrapping_add(1);
        inputs.fill(self.count);
        self.calls.push(Call::Inputs);
    }
    fn safe_outputs(&mut self) {
        self.calls.push(Call::Safe);
    }
    fn write_object(&mut self, _: ObjectAddress, _: &[u8]) -> Result<(), AbortCode> {
        if self.refuse_writes { Err(AbortCode::LOCAL_CONTROL) } else { Ok(()) }
    }
}

/// The bench.
pub struct Bench {
    pub esc: FakeEsc,
    pub device: SubDevice<Probe, Vec<u8>>,
    pub now: Time<Device>,
    counter: u8,
}

impl Bench {
    pub fn new(description: &'static Description) -> Self {
        let store = vec![0xAA; description.store_len()];
        let device = SubDevice::new(description, store, Probe::default());
        Self { esc: FakeEsc::new(), device, now: Time::new(1_000_000), counter: 0 }
    }

    /// A bench whose device was taken to `state` by a correct MainDevice without DC.
    pub fn in_state(description: &'static Description, state: AlState) -> Self {
        let mut bench = Self::new(description);
        bench.set_mailbox();
        assert_eq!(bench.ask(AlState::PreOp), (AlStatus(2), AlStatusCode(0)));
        if state == AlState::PreOp {
            return bench;
        }
        bench.set_process_data(7, 7);
        assert_eq!(bench.ask(AlState::SafeOp), (AlStatus(4), AlStatusCode(0)));
        if state == AlState::SafeOp {
            return bench;
        }
        bench.write_outputs(&[0; 7]);
        bench.cycle(Event::Sm2);
        assert_eq!(bench.ask(AlState::Op), (AlStatus(8), AlStatusCode(0)));
        bench
    }

    pub fn set_mailbox(&mut self) {
        self.esc.set_sm(0, SyncManager::new(0x1000, 64, SyncManager::MAILBOX_OUT, true));
        self.esc.set_sm(1, SyncManager::new(0x1080, 64, SyncManager::MAILBOX_IN, true));
    }

    pub fn set_process_data(&mut self, outputs: u16, inputs: u16) {
        let sm = |start, length, control| SyncManager::new(start, length, control, length > 0);
        self.esc.set_sm(2, sm(0x1100, outputs, SyncManager::OUTPUTS));
        self.esc.set_sm(3, sm(0x1400, inputs, SyncManager::INPUTS | SyncManager::CONTROL_AL_EVENT));
    }

    /// Sets SYNC0 to every `cycle` ns.
    pub fn set_sync0(&mut self, cycle: u32) {
        register::SYNC0_CYCLE.store(&mut self.esc.memory[..], cycle);
        self.set(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(3));
    }

    pub fn set<T: register::Value>(&mut self, register: isocat_wire::Register<T>, value: T) {
        register.store(&mut self.esc.memory[..], value);
    }

    pub fn get<T: register::Value>(&self, register: isocat_wire::Register<T>) -> T {
        register.load(&self.esc.memory[..])
    }

    pub fn poll(&mut self) {
        self.device.poll(self.now, &mut self.esc);
    }

    /// Writes AL control and returns the answer.
    pub fn control(&mut self, control: AlControl) -> (AlStatus, AlStatusCode) {
        self.set(register::AL_CONTROL, control);
        self.esc.events |= al_event::AL_CONTROL;
        self.poll();
        self.status()
    }

    pub fn ask(&mut self, state: AlState) -> (AlStatus, AlStatusCode) {
        self.control(AlControl::request(state))
    }

    pub fn acknowledge(&mut self, state: AlState) -> (AlStatus, AlStatusCode) {
        self.control(AlControl::request_and_acknowledge(state))
    }

    pub fn status(&self) -> (AlStatus, AlStatusCode) {
        (self.get(register::AL_STATUS), self.get(register::AL_STATUS_CODE))
    }

    /// Lets time pass, with all timeouts of the stack.
    pub fn pass(&mut self, span: Nanos) {
        let end = self.now + span;
        while let Some(due) = self.device.next_timeout().filter(|due| *due <= end) {
            self.now = self.now.max(due);
            self.run(Event::Timer);
            self.poll();
        }
        self.now = end;
    }

    /// Writes the outputs into the SM2 buffer.
    pub fn write_outputs(&mut self, outputs: &[u8]) {
        let start = usize::from(self.esc.sm(2).start);
        self.esc.memory[start..start + outputs.len()].copy_from_slice(outputs);
        self.esc.events |= al_event::sync_manager(2);
    }

    /// Handles an event and runs all its steps at once, regardless of their delays.
    pub fn run(&mut self, event: Event) -> Vec<(Step, i64)> {
        let steps = self.device.handle_event(self.now, event, &mut self.esc);
        for (step, _) in steps {
            self.device.begin(self.now, step, &mut self.esc);
            self.device.finish(self.now, step, &mut self.esc);
        }
        steps.iter().map(|(step, delay)| (step, delay.0)).collect()
    }

    /// Handles an event, and runs the main loop after it.
    pub fn cycle(&mut self, event: Event) -> Vec<(Step, i64)> {
        let steps = self.run(event);
        self.poll();
        steps
    }

    pub fn calls(&mut self) -> Vec<Call> {
        std::mem::take(&mut self.device.application_mut().calls)
    }

    pub fn inputs(&self) -> &[u8] {
        &self.esc.memory[0x1400..0x1407]
    }

    /// Writes a service into SM0 with the next counter.
    pub fn send(&mut self, protocol: Protocol, body: &[u8]) {
        self.counter = isocat_wire::mailbox::next_counter(self.counter);
        let header = Header::new(body.len() as u16, 0, protocol, self.counter);
        self.send_raw(&[&header.emit()[..], body].concat());
    }

    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.esc.memory[0x1000..0x1040].fill(0);
        self.esc.memory[0x1000..0x1000 + bytes.len()].copy_from_slice(bytes);
        self.esc.events |= al_event::sync_manager(0);
    }

    /// Reads SM1, if it is full.
    pub fn receive(&mut self) -> Option<(Header, Vec<u8>)> {
        let mut sm = self.esc.sm(1);
        if sm.status & SyncManager::STATUS_FULL == 0 {
            return None;
        }
        sm.status &= !SyncManager::STATUS_FULL;
        self.esc.set_sm(1, sm);
        self.esc.events |= al_event::sync_manager(1);
        let bytes = &self.esc.memory[0x1080..0x10C0];
        let header = Header::parse(bytes.first_chunk().unwrap());
        Some((header, bytes[6..][..usize::from(header.length)].to_vec()))
    }

    /// Sends a CoE request and returns its answer after the CoE header. `service` is checked.
    pub fn coe(&mut self, service: u8, body: &[u8]) -> (u8, Vec<u8>) {
        self.send(Protocol::COE, &[&[0, service << 4][..], body].concat());
        self.poll();
        let (header, answer) = self.receive().expect("an answer");
        self.poll();
        assert_eq!(header.protocol, Protocol::COE);
        (answer[1] >> 4, answer[2..].to_vec())
    }

    pub fn sdo(&mut self, body: &[u8]) -> Result<Vec<u8>, AbortCode> {
        let (service, answer) = self.coe(2, body);
        if answer[0] == 0x80 {
            assert_eq!(service, 2, "aborts travel as requests");
            assert_eq!(answer[1..4], body[1..4], "the abort names the object");
            return Err(AbortCode(u32::from_le_bytes(answer[4..8].try_into().unwrap())));
        }
        assert_eq!(service, 3);
        Ok(answer)
    }

    fn initiate(&self, command: u8, index: u16, sub: u8, data: [u8; 4]) -> [u8; 8] {
        let command = isocat_wire::coe::sdo::Command(command);
        Initiate { command, object: ObjectAddress::new(index, sub), data }.emit()
    }

    /// Reads an entry or a whole object, in segments if needed.
    pub fn upload_as(&mut self, complete: bool, index: u16, sub: u8) -> Result<Vec<u8>, AbortCode> {
        let command = 0x40 | u8::from(complete) << 4;
        let answer = self.sdo(&self.initiate(command, index, sub, [0; 4]))?;
        assert_eq!(answer[0] & 0x10, u8::from(complete) << 4);
        let initiate = Initiate::parse(answer.first_chunk().unwrap());
        assert_eq!((initiate.object.index, initiate.object.sub), (index, sub));
        if initiate.command.expedited() {
            return Ok(answer[4..][..initiate.command.expedited_len()].to_vec());
        }
        let total = initiate.value() as usize;
        let mut data = answer[8..].to_vec();
        let mut toggle = 0;
        while data.len() < total {
            let (_, segment) = self.coe(2, &[0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
            assert_eq!(segment[0] & 0xF0, toggle, "{segment:?}");
            let command = isocat_wire::coe::sdo::SegmentCommand(segment[0]);
            data.extend(&segment[1..][..command.data_len(segment.len() - 1)]);
            assert_eq!(command.last(), data.len() == total);
            toggle ^= 0x10;
        }
        Ok(data)
    }

    pub fn upload(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, AbortCode> {
        self.upload_as(false, index, sub)
    }

    pub fn number(&mut self, index: u16, sub: u8) -> u32 {
        let mut bytes = self.upload(index, sub).unwrap();
        bytes.resize(4, 0);
        u32::from_le_bytes(bytes.try_into().unwrap())
    }

    /// Writes an entry or a whole object: up to four bytes in the message itself, otherwise with
    /// the data after it, in segments if needed.
    pub fn download_as(
        &mut self,
        complete: bool,
        index: u16,
        sub: u8,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        let flag = u8::from(complete) << 4;
        if (1..=4).contains(&data.len()) {
            let mut four = [0; 4];
            four[..data.len()].copy_from_slice(data);
            let command = 0x23 | ((4 - data.len()) as u8) << 2 | flag;
            let answer = self.sdo(&self.initiate(command, index, sub, four))?;
            assert_eq!(answer[0], 0x60 | flag);
            return Ok(());
        }
        let size = (data.len() as u32).to_le_bytes();
        let (now, later) = data.split_at(data.len().min(64 - 16));
        let body = [&self.initiate(0x21 | flag, index, sub, size), now].concat();
        assert_eq!(self.sdo(&body)?[0], 0x60 | flag);
        let mut toggle = 0;
        let mut segments = later.chunks(64 - 9).peekable();
        while let Some(segment) = segments.next() {
            let last = segments.peek().is_none();
            let unused = 7usize.saturating_sub(segment.len());
            let mut body = vec![toggle | (unused as u8) << 1 | u8::from(last)];
            body.extend(segment);
            body.resize(body.len() + unused, 0);
            let (_, answer) = self.coe(2, &body);
            if answer[0] == 0x80 {
                let code = u32::from_le_bytes(answer[4..8].try_into().unwrap());
                return Err(AbortCode(code));
            }
            assert_eq!(answer[0], 0x20 | toggle);
            toggle ^= 0x10;
        }
        Ok(())
    }

    pub fn download(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), AbortCode> {
        self.download_as(false, index, sub, data)
    }
}
