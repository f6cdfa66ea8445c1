//! A SubDevice behind the software ESC, and frames to it.

use isocat_esc::{Esc, EscEvent, LAN9252};
use isocat_subdevice::{Event, SubDevice};
use isocat_wire::coe::{AbortCode, Service};
use isocat_wire::datagram::Address;
use isocat_wire::frame::FrameWriter;
use isocat_wire::mailbox::{HEADER_LEN, Header, Protocol, next_counter};
use isocat_wire::register::{self, Value, al_event, sync_manager};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::{Device, Time};
use isocat_wire::{AlControl, AlState, AutoIncrementAddress, Command, Nanos, Register, sii};

use super::device::{INPUTS, MAILBOX, OUTPUTS, PROCESS_DATA, RECEIVE, Refusing, SEND, description};

/// Most messages that one request can cause: the fragments of the longest list, and repetitions.
const MOST_MESSAGES: usize = 12;

/// The device, its ESC, and a MainDevice's memory of the messages.
pub struct Wire {
    esc: Esc<Vec<u8>>,
    device: SubDevice<Refusing, Vec<u8>>,
    now: Time<Device>,
    /// The counter of the last complete message in SM0.
    sent: u8,
    /// The last message read; `None` if any message may come next.
    last: Option<Vec<u8>>,
    /// Whether the repeat bit was toggled and the device has not seen it.
    toggled: bool,
    /// Whether the device has seen it: the same message may come again.
    repeating: bool,
}

impl Wire {
    /// A device in PREOP.
    pub fn new() -> Self {
        let mut image = vec![0; 256];
        // SPI; SYNC unit on; SYNC0 pulses of 1 us.
        let header = sii::Header {
            configuration: [0x05, 0x04, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            ..sii::Header::default()
        };
        let image_len = sii::Writer::new(&mut image, &header).and_then(sii::Writer::finish);
        image_len.expect("256 bytes are enough");
        let store = vec![0xAA; description().store_len()];
        let mut wire = Self {
            esc: Esc::new(&LAN9252, image, vec![0; 4096]),
            device: SubDevice::new(description(), store, Refusing),
            now: Time::new(10_000_000),
            sent: 0,
            last: None,
            toggled: false,
            repeating: false,
        };
        wire.recover();
        wire
    }

    /// Sends one datagram in a separate frame, to which the device does not react yet.
    pub fn datagram(&mut self, command: Command, address: u16, data: &[u8]) -> (u16, Vec<u8>) {
        let mut buffer = [0; 400];
        let mut frame = FrameWriter::new(&mut buffer, [2; 6]);
        let place = Address::Position(AutoIncrementAddress(0), address);
        let at = frame.push(command, 0, place, data).expect("a short datagram");
        let len = frame.finish();
        let end = self.now + Nanos(6_720);
        self.events();
        self.esc.process(&mut buffer[..len], self.now, end, true);
        self.now = end;
        self.events();
        if self.esc.register(register::sm_status(0)) & SyncManager::STATUS_FULL != 0 {
            self.sent = self.esc.ram()[5] >> 4 & 7;
        }
        let behind = at + data.len();
        let counter = u16::from_le_bytes([buffer[behind], buffer[behind + 1]]);
        (counter, buffer[at..behind].to_vec())
    }

    /// Writes a register.
    pub fn write<T: Value>(&mut self, register: Register<T>, value: T) {
        let bytes = value.to_bytes();
        self.datagram(Command::Apwr, register.address, bytes.as_ref());
    }

    /// Lets the device react: interrupts, then timers, then the main loop.
    pub fn live(&mut self) {
        self.repeating |= std::mem::take(&mut self.toggled);
        for _ in 0..4 {
            self.events();
            for _ in 0..8 {
                if self.device.next_timeout().is_none_or(|due| due > self.now) {
                    break;
                }
                self.run(Event::Timer);
                self.poll();
            }
            self.poll();
            // Changes that the ESC makes at the end of a frame are complete by then.
            self.now += Nanos::micros(10);
        }
    }

    /// Lets time pass.
    pub fn pass(&mut self, span: Nanos) {
        self.now += span;
    }

    /// Requests a state by a value of the AL control register.
    pub fn control(&mut self, control: AlControl) {
        self.write(register::AL_CONTROL, control);
        self.live();
        // The mailbox may have started again, with new counters.
        self.forget();
    }

    /// Configures the process data SyncManagers correctly.
    pub fn set_process_data(&mut self) {
        let outputs = SyncManager::new(OUTPUTS, PROCESS_DATA, SyncManager::OUTPUTS, true);
        self.write(sync_manager(2), outputs);
        let inputs = SyncManager::new(INPUTS, PROCESS_DATA, SyncManager::INPUTS, true);
        self.write(sync_manager(3), inputs);
    }

    /// Runs one cycle of process data.
    pub fn exchange(&mut self) {
        self.datagram(Command::Apwr, OUTPUTS, &[1; PROCESS_DATA as usize]);
        self.live();
        self.datagram(Command::Aprd, INPUTS, &[0; PROCESS_DATA as usize]);
        self.live();
    }

    /// Recovers from any act: INIT is always possible.
    pub fn recover(&mut self) {
        self.control(AlControl(0x11));
        assert_eq!(self.device.state(), AlState::Init, "INIT is always reached");
        let mailbox = |start, control| SyncManager::new(start, MAILBOX as u16, control, true);
        for (number, start, control) in
            [(0, RECEIVE, SyncManager::MAILBOX_OUT), (1, SEND, SyncManager::MAILBOX_IN)]
        {
            // Switched off and on, it is empty.
            self.write(sync_manager(number), SyncManager::new(start, 0, 0, false));
            self.live();
            self.write(sync_manager(number), mailbox(start, control));
            self.live();
        }
        self.control(AlControl::request_and_acknowledge(AlState::PreOp));
        assert_eq!(self.device.state(), AlState::PreOp, "{:?}", self.device.status_code());
        (self.toggled, self.repeating) = (false, false);
    }

    /// The state that the device is in.
    pub fn state(&self) -> AlState {
        self.device.state()
    }

    /// Writes a complete message into SM0; returns `false` if it is still full.
    pub fn send_raw(&mut self, message: &[u8]) -> bool {
        let mut whole = [0; MAILBOX];
        whole[..message.len()].copy_from_slice(message);
        self.datagram(Command::Apwr, RECEIVE, &whole).0 == 1
    }

    /// Writes a service into SM0 with a new counter.
    pub fn send(&mut self, body: &[u8]) -> bool {
        let counter = next_counter(self.sent);
        let header = Header::new(body.len() as u16, 0, Protocol::COE, counter);
        self.send_raw(&[&header.emit()[..], body].concat())
    }

    /// Reads SM1, if it is full, and checks that the message is valid and in order.
    pub fn receive(&mut self) -> Option<(Protocol, Vec<u8>)> {
        let (counter, bytes) = self.datagram(Command::Aprd, SEND, &[0; MAILBOX]);
        if counter == 0 {
            return None;
        }
        let header = Header::parse(bytes.first_chunk().expect("64 bytes"));
        let len = usize::from(header.length);
        assert!(len <= MAILBOX - HEADER_LEN, "{header:?}");
        assert!((1..=7).contains(&header.counter), "{header:?}");
        assert_eq!((header.address, header.channel, header.reserved), (0, 0, false));
        let message = bytes[..HEADER_LEN + len].to_vec();
        if let Some(last) = self.last.replace(message.clone()) {
            let next = header.counter == next_counter(last[5] >> 4 & 7);
            let again = self.repeating && message == last;
            assert!(next || again, "{message:02X?} after {last:02X?}");
        }
        self.repeating = false;
        let body = message[HEADER_LEN..].to_vec();
        match header.protocol {
            Protocol::ERROR => assert_eq!((len, &body[..2]), (4, &[1, 0][..]), "{body:02X?}"),
            Protocol::COE => check_service(&body),
            other => panic!("a message of protocol {other:?}"),
        }
        Some((header.protocol, body))
    }

    /// Toggles the repeat bit of SM1.
    pub fn ask_repetition(&mut self) {
        let activate = self.esc.register(register::sm_activate(1));
        self.write(register::sm_activate(1), activate ^ SyncManager::REPEAT);
        self.toggled = true;
    }

    /// Forgets the last message, because the mailbox was disturbed.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// Reads all waiting messages.
    pub fn drain(&mut self) -> Vec<(Protocol, Vec<u8>)> {
        let mut all = Vec::new();
        self.live();
        while let Some(message) = self.receive() {
            all.push(message);
            assert!(all.len() <= MOST_MESSAGES, "messages without end: {all:02X?}");
            self.live();
        }
        all
    }

    /// Reads all waiting messages, and requests a known value: 0x100A:00 is `08`.
    pub fn answers(&mut self) {
        self.drain();
        assert!(self.send(&[0, 0x20, 0x40, 0x0A, 0x10, 0, 0, 0, 0, 0]), "SM0 is empty");
        let expected = [0, 0x30, 0x4B, 0x0A, 0x10, 0, b'0', b'8', 0, 0].to_vec();
        assert_eq!(self.drain(), [(Protocol::COE, expected)]);
    }

    /// Checks that a request that comes twice is answered once, and that the answer is repeated on
    /// request.
    pub fn repeats(&mut self) {
        let message = self.last.clone().expect("an answer was read");
        let request = self.esc.ram()[..MAILBOX].to_vec();
        assert!(self.send_raw(&request), "SM0 is empty");
        assert_eq!(self.drain(), [], "the same counter again");
        for _ in 0..2 {
            self.ask_repetition();
            self.live();
            let again = self.receive().expect("the message again");
            assert_eq!(again.1, message[HEADER_LEN..]);
            self.live();
        }
    }

    /// Checks that the device and its ESC wrote nothing outside their areas.
    pub fn memory_is_whole(&self) {
        let areas = [
            (RECEIVE, MAILBOX),
            (SEND, MAILBOX),
            (OUTPUTS, 3 * usize::from(PROCESS_DATA)),
            (INPUTS, 3 * usize::from(PROCESS_DATA)),
        ];
        for (at, byte) in (usize::from(RECEIVE)..).zip(self.esc.ram()) {
            let inside = areas
                .iter()
                .any(|(start, len)| (0..*len).contains(&at.wrapping_sub(usize::from(*start))));
            assert!(inside || *byte == 0, "{at:#06x} was written");
        }
    }

    fn events(&mut self) {
        // SYNC is never started here, so events come from frames only.
        while let Some((_, event)) = self.esc.step(self.now) {
            if let EscEvent::FrameEnd { al_events } = event {
                for (number, event) in [(2, Event::Sm2), (3, Event::Sm3)] {
                    if al_events & al_event::sync_manager(number) != 0 {
                        self.run(event);
                    }
                }
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

    fn poll(&mut self) {
        let now = self.now;
        self.device.poll(now, &mut self.esc.pdi(now));
        let status = self.esc.al_status();
        assert_eq!(status.state(), Ok(self.device.state()));
        assert_eq!(status.error(), self.device.status_code() != Default::default());
    }
}

/// Checks a CoE service that a device may send.
fn check_service(body: &[u8]) {
    let service = Service(body[1] >> 4);
    match service {
        Service::SDO_RESPONSE => assert!(body.len() >= 10, "{body:02X?}"),
        // The only request of a device is an abort, with a valid code.
        Service::SDO_REQUEST => {
            assert_eq!((body.len(), body[2]), (10, 0x80), "{body:02X?}");
            let code = u32::from_le_bytes(body[6..10].try_into().expect("4 bytes"));
            assert!(AbortCode(code).meaning().is_some(), "{body:02X?}");
        }
        Service::SDO_INFORMATION => assert!(body.len() >= 6, "{body:02X?}"),
        other => panic!("service {other:?}: {body:02X?}"),
    }
}
