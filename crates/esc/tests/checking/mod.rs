//! An ESC under arbitrary bytes, and the rules that must hold.
//!
//! The bytes are read as a story: frames (whole, cut or malformed), accesses of the PDI, links that
//! come and go, time that passes. These rules are checked after each step:
//!
//! - nothing panics, and no event is left behind or comes from the future;
//! - working counters grow by no more than a command allows the ESC that it addresses;
//! - in a frame only what an ESC may change does change, and without a count the data stays too;
//! - bytes behind the memory are neither read nor written;
//! - a frame with a bad check sequence leaves registers, SyncManagers and events as they were.

use isocat_esc::{
    Chip, ET1100, ET1100_MII, ET1200, Esc, IP_CORE_32, IP_CORE_32_EMULATED, LAN9252, Pdi,
    PortError, XMC4800,
};
use isocat_wire::command::Command;
use isocat_wire::datagram::{Header, Layout, Layouts};
use isocat_wire::fmmu::Fmmu;
use isocat_wire::frame::{duration_ns, envelope};
use isocat_wire::register::{self, Value};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::time::Device;
use isocat_wire::{PortNumber, Time, sii};

/// A story of frames only.
pub fn frames(bytes: &[u8]) {
    tell(bytes, 0);
}

/// A story in which the PDI acts as often as the wire.
pub fn pdi_sequence(bytes: &[u8]) {
    tell(bytes, 6);
}

/// The rest of a story's bytes; it gives zeros when they are used up.
struct Source<'a>(&'a [u8]);

impl Source<'_> {
    fn byte(&mut self) -> u8 {
        match self.0 {
            [first, rest @ ..] => {
                self.0 = rest;
                *first
            }
            [] => 0,
        }
    }

    fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    fn bytes(&mut self, most: usize) -> Vec<u8> {
        let len = match self.byte() {
            short @ 0..0xE0 => usize::from(short) % 24,
            _ => usize::from(self.word()) % most,
        };
        (0..len).map(|_| self.byte()).collect()
    }

    /// An address, mostly one at which something exists.
    fn address(&mut self) -> u16 {
        const PLACES: [u16; 20] = [
            0x0000, 0x0010, 0x0020, 0x0040, 0x0100, 0x0120, 0x0130, 0x0200, 0x0300, 0x0400, 0x0440,
            0x0500, 0x0510, 0x0600, 0x0800, 0x0900, 0x0980, 0x0F80, 0x1000, 0x13F0,
        ];
        match self.byte() {
            place @ 0..0xF0 => {
                PLACES[usize::from(place) % PLACES.len()] + u16::from(self.byte() % 64)
            }
            _ => self.word(),
        }
    }

    fn datagram(&mut self, last: bool) -> Vec<u8> {
        let command = self.byte() % 18;
        let address = match command {
            10..=12 => u32::from(self.byte() % 48),
            _ => {
                let adp = [0, 0, 0x1001, 0x1234, 0xFFFF, 7][usize::from(self.byte() % 6)];
                adp | u32::from(self.address()) << 16
            }
        };
        let data = self.bytes(1400);
        let mut header = Header::parse(&[command, 0x5A, 0, 0, 0, 0, 0, 0, 0, 0]);
        (header.address, header.len, header.more) = (address, data.len() as u16, !last);
        [&header.emit()[..], &data, &[0, 0]].concat()
    }

    fn frame(&mut self) -> Vec<u8> {
        let mut frame = vec![0xFF; 6];
        frame.extend([0x10; 6]);
        match self.byte() % 16 {
            0 => return self.bytes(1514),
            1 => frame.extend([0x81, 0, 0, 7, 0x88, 0xA4]),
            2 => {
                let mut ip = [0; 28];
                (ip[9], ip[22], ip[23], ip[26]) = (17, 0x88, 0xA4, 0x77);
                frame.extend([0x08, 0x00]);
                frame.extend(ip);
            }
            _ => frame.extend([0x88, 0xA4]),
        }
        frame.extend([0x00, 0x10]);
        let count = 1 + self.byte() % 4;
        for number in 1..=count {
            frame.extend(self.datagram(number == count));
        }
        if self.byte() < 16 {
            let cut = usize::from(self.byte() % 32).min(frame.len());
            frame.truncate(frame.len() - cut);
        }
        frame.truncate(1514);
        frame
    }
}

/// The bytes behind the memory, which must stay unchanged.
const FENCE: [u8; 64] = [0xA7; 64];
/// The chips that stories use.
static CHIPS: [&Chip; 7] =
    [&ET1100, &ET1200, &IP_CORE_32, &LAN9252, &XMC4800, &ET1100_MII, &IP_CORE_32_EMULATED];

fn tell(story: &[u8], pdi: u8) {
    let mut source = Source(story);
    let chip = CHIPS[usize::from(source.byte()) % CHIPS.len()];
    let mut image = [0; 160];
    image[..2].copy_from_slice(&[0x80, source.byte()]);
    image[3] = 0xEE;
    image[4] = source.byte() % 4;
    image[8..10].copy_from_slice(&[0x34, 0x12]);
    image[14] = sii::checksum(image[..14].try_into().expect("14 bytes"));
    let len = usize::from(chip.ram_kib) * 1024;
    let mut ram = vec![0; len];
    ram.extend(FENCE);
    let mut esc = Esc::new(chip, &mut image[..], &mut ram[..]);
    esc.set_port(PortNumber::P0, true);
    let mut time = Clock { now: 1_000, last: 0 };
    // APWR: station address 0x1001.
    let station = [2, 0, 0, 0, 0x10, 0, 2, 0, 0, 0, 0x01, 0x10, 0, 0];
    let mut first = [&[0xFF; 6][..], &[0x10; 6], &[0x88, 0xA4, 14, 0x10], &station].concat();
    pass(&mut esc, &mut first, &mut time, true);
    live(&mut esc, &mut time);
    assert_eq!(esc.register(register::STATION_ADDRESS), 0x1001);
    if source.byte() % 4 != 0 {
        set_up(&mut esc, &mut time);
    }
    while !source.0.is_empty() {
        live(&mut esc, &mut time);
        let now = time.now;
        let act = source.byte() % (10 + pdi);
        match act {
            0..=6 => {
                let good = source.byte() % 4 != 0;
                pass(&mut esc, &mut source.frame(), &mut time, good);
            }
            7 => time.now += u64::from(source.word()) << (source.byte() % 9),
            8 => {
                let port = PortNumber::ALL[usize::from(source.byte() % 4)];
                esc.set_port(port, source.byte() % 2 == 0);
            }
            9 => {
                let port = PortNumber::ALL[usize::from(source.byte() % 4)];
                esc.hear_frame(port);
                esc.count_error(port, PortError::InvalidFrame);
                esc.receive_at_port(port, Time::new(now));
            }
            10..=12 => {
                let address = source.address();
                let mut data = vec![0xEE; usize::from(source.byte())];
                esc.pdi(Time::new(now)).read(address, &mut data);
                for (at, byte) in data.iter().enumerate() {
                    if usize::from(address) + at >= 0x1000 + len {
                        assert_eq!(*byte, 0, "{address:#06x} + {at}: nothing is there");
                    }
                }
            }
            _ => {
                let (address, data) = (source.address(), source.bytes(2000));
                esc.pdi(Time::new(now)).write(address, &data);
            }
        }
    }
    assert_eq!(ram[len..], FENCE, "written behind the memory");
}

/// The present time, and the time of the last event.
struct Clock {
    now: u64,
    last: u64,
}

/// Sets mailboxes at 0x1000 and 0x1008, outputs at 0x1010, inputs at 0x1020, and FMMUs that map
/// them to logical 0 to 15, so that stories reach something.
fn set_up(esc: &mut Esc<&mut [u8]>, time: &mut Clock) {
    let managers = [
        SyncManager::new(0x1000, 8, SyncManager::MAILBOX_OUT, true),
        SyncManager::new(0x1008, 8, SyncManager::MAILBOX_IN, true),
        SyncManager::new(0x1010, 4, SyncManager::OUTPUTS, true),
        SyncManager::new(0x1020, 4, SyncManager::INPUTS, true),
    ];
    let fmmus = [
        Fmmu::bytes(0, 4, 0x1010, Fmmu::WRITE),
        Fmmu::bytes(2, 4, 0x1020, Fmmu::READ),
        Fmmu { logical_start_bit: 3, logical_stop_bit: 1, ..Fmmu::bytes(8, 2, 0x080D, Fmmu::READ) },
    ];
    let managers = managers.map(|manager| manager.to_bytes()).concat();
    let fmmus = fmmus.map(|fmmu| fmmu.to_bytes()).concat();
    for (register, data) in [(0x0800u16, managers), (0x0600, fmmus)] {
        let mut frame = [&[0xFF; 6][..], &[0x10; 6], &[0x88, 0xA4, 0, 0x10]].concat();
        let [low, high] = register.to_le_bytes();
        frame.extend([Command::Bwr as u8, 0, 0, 0, low, high, data.len() as u8, 0, 0, 0]);
        frame.extend(data);
        frame.extend([0, 0]);
        pass(esc, &mut frame, time, true);
    }
    let now = Time::new(time.now);
    esc.pdi(now).write(0x1008, &[1; 8]);
    esc.pdi(now).write(0x1020, &[2; 4]);
}

/// Handles all events that are due.
fn live(esc: &mut Esc<&mut [u8]>, time: &mut Clock) {
    let now = time.now;
    // A SYNC cycle below a tick gives one event per tick. The limit keeps stories short.
    for _ in 0..2_000 {
        match esc.step(Time::new(now)) {
            Some((at, event)) => {
                let at = at.count();
                assert!((time.last..=now).contains(&at), "{event:?} at {at}, now {now}");
                time.last = at;
            }
            None => {
                assert!(esc.next_event() > Time::new(now), "an event was left behind");
                return;
            }
        }
    }
}

/// Passes a frame through and checks the result.
fn pass(esc: &mut Esc<&mut [u8]>, frame: &mut [u8], time: &mut Clock, good: bool) {
    // The frame starts on a tick, so that the frame before is over.
    time.now = time.now.next_multiple_of(10);
    live(esc, time);
    let start = Time::new(time.now);
    esc.pdi(start).events();
    let end = time.now + duration_ns(frame.len());
    let before = frame.to_vec();
    let state = (!good).then(|| State::of(esc, start));
    let station = esc.register(register::STATION_ADDRESS);
    let alias = (esc.registers()[0x0103] & 1 != 0).then(|| esc.register(register::STATION_ALIAS));
    let ram_end = 0x1000 + esc.ram().len();
    let processed = esc.process(frame, start, Time::new(end), good);
    time.now = end;
    if let Some(state) = state {
        state.compare(&State::of(esc, start), writes_ram(&before));
        // The bad frame also leaves nothing to the end of the next one.
        let mut nop = [&[0; 12][..], &[0x88, 0xA4, 12, 0x10], &[0; 12]].concat();
        esc.process(&mut nop, start, Time::new(end), true);
        assert_eq!(esc.next_event(), state.next, "the next frame brought a bad one into force");
    }
    let mut expected = before.clone();
    if let Ok(found) = envelope(&before) {
        if !processed.destroyed {
            // These are the changes that an ESC may make to the headers.
            expected[6] = frame[6];
            assert_eq!(frame[6] | 0x02, before[6] | 0x02);
            if let Some(at) = found.udp_checksum {
                expected[at..at + 2].fill(0);
            }
        }
        let mut layouts = Layouts::new();
        while let Some(Ok(layout)) = layouts.next(&before[found.datagrams..]) {
            let (old, new) = (&before[found.datagrams..], &frame[found.datagrams..]);
            let expected = &mut expected[found.datagrams..];
            expected[layout.start + 7] |= new[layout.start + 7] & 0x40;
            if processed.destroyed {
                continue;
            }
            let adp = layout.header.adp();
            let mine = adp == station || Some(adp) == alias;
            check_datagram(&layout, mine, ram_end, (old, new, expected));
        }
    }
    assert_eq!(frame, expected, "changed where an ESC changes nothing");
}

/// Checks one datagram and notes in `expected` what may have changed in it.
fn check_datagram(
    layout: &Layout,
    mine: bool,
    ram_end: usize,
    (old, new, expected): (&[u8], &[u8], &mut [u8]),
) {
    use Command::*;
    let header = layout.header;
    let word = |bytes: &[u8], at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let (start, data, wkc) = (layout.start, layout.data(), layout.wkc());
    let counted = word(new, wkc).wrapping_sub(word(old, wkc));
    let Ok(command) = header.command() else {
        assert_eq!(counted, 0, "command {:#04x} is none", header.command);
        return;
    };
    let reached = match command {
        Nop => false,
        Aprd | Apwr | Aprw => header.adp() == 0,
        Fprd | Fpwr | Fprw => mine,
        _ => true,
    };
    let most = match command {
        _ if !reached => 0,
        Aprw | Fprw | Brw | Lrw => 3,
        _ => 1,
    };
    assert!(counted <= most, "{command} counted {counted}");
    // An access of zero data bytes never counts.
    assert!(counted == 0 || header.len > 0, "{command} of no bytes counted {counted}");
    if command.increments_position() {
        expected[start + 2..start + 4].copy_from_slice(&header.adp().wrapping_add(1).to_le_bytes());
    }
    if command != Nop {
        assert_eq!(word(new, start + 8) & header.irq, header.irq, "IRQ bits are never taken away");
        expected[start + 8..start + 10].copy_from_slice(&new[start + 8..start + 10]);
    }
    expected[wkc..wkc + 2].copy_from_slice(&new[wkc..wkc + 2]);
    let reads = counted & 1 != 0
        && match command {
            Apwr | Fpwr | Bwr | Lwr => false,
            Armw => header.adp() == 0,
            Frmw => mine,
            _ => true,
        };
    if reads {
        for at in data..wkc {
            let address = usize::from(header.ado()) + (at - data);
            if command.is_logical() || address < ram_end {
                expected[at] = new[at];
            }
        }
    }
}

/// Whether a frame may write RAM, which also keeps writes of a bad frame.
fn writes_ram(frame: &[u8]) -> bool {
    let Ok(found) = envelope(frame) else { return false };
    let mut layouts = Layouts::new();
    while let Some(Ok(layout)) = layouts.next(&frame[found.datagrams..]) {
        let header = layout.header;
        let end = u32::from(header.ado()) + u32::from(header.len);
        let writes = match header.command() {
            Ok(Command::Lwr | Command::Lrw) => true,
            // 0x0108 may send the write anywhere.
            Ok(Command::Aprw | Command::Fprw | Command::Brw) => true,
            Ok(Command::Aprd | Command::Fprd | Command::Brd | Command::Lrd | Command::Nop) => false,
            Ok(_) => end > u32::from(register::SHADOW_END),
            Err(_) => false,
        };
        if writes {
            return true;
        }
    }
    false
}

/// The state that a bad frame must not change.
#[derive(Debug, PartialEq)]
struct State {
    registers: Vec<u8>,
    ram: Vec<u8>,
    events: u32,
    next: Time<Device>,
}

impl State {
    fn of(esc: &Esc<&mut [u8]>, now: Time<Device>) -> Self {
        let mut registers = esc.registers()[..usize::from(register::SHADOW_END)].to_vec();
        // These registers are updated by every read, good or bad: events, watchdog, running times.
        // The write enables end with the arrival of any frame.
        for shown in [0x0020..0x0021, 0x0030..0x0031, 0x0210..0x0224, 0x0440..0x0442] {
            registers[shown].fill(0);
        }
        for shown in [0x0910..0x0920, 0x0984..0x0985, 0x098E..0x09A0, 0x09AE..0x09D0] {
            registers[shown].fill(0);
        }
        let (events, next) = (esc.al_events(now), esc.next_event());
        Self { registers, ram: esc.ram().to_vec(), events, next }
    }

    fn compare(&self, after: &Self, ram_written: bool) {
        // Bad frames are counted in this register only.
        let errors = usize::from(register::EPU_ERRORS.address);
        let (one, other) = (self.registers[errors], after.registers[errors]);
        assert!(other == one || other == one.saturating_add(1), "{one} bad frames, then {other}");
        let differs =
            |(at, (one, other)): (usize, (&u8, &u8))| (at != errors && one != other).then_some(at);
        let first = self.registers.iter().zip(&after.registers).enumerate().find_map(differs);
        assert_eq!(first.map(|at| format!("{at:#06x}")), None, "a bad frame changed a register");
        assert_eq!((self.events, self.next), (after.events, after.next));
        assert!(ram_written || self.ram == after.ram, "a bad frame that writes no RAM changed it");
    }
}
