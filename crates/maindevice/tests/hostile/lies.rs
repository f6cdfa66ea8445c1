//! Wrong answers of a SubDevice, and faults of the wire.

use isocat_wire::command::Command;
use isocat_wire::mailbox::Protocol;

use super::device::{Device, RECEIVE, SEND};

/// A small generator of random numbers (splitmix64): a seed determines the run.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// A number in `0..count`; 0 if that is empty.
    pub fn below(&mut self, count: u64) -> u64 {
        self.next() % count.max(1)
    }

    /// True once in `count` draws on average.
    pub fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }

    /// A number at the edge of some type, or any number.
    pub fn extreme(&mut self) -> u64 {
        let bits = self.below(65) as u32;
        let edge = 1u64.checked_shl(bits).unwrap_or(0);
        match self.below(4) {
            0 => edge,
            1 => edge.wrapping_sub(1),
            2 => edge.wrapping_neg(),
            _ => self.next(),
        }
    }
}

/// What one SubDevice answers wrongly.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Lie {
    /// Bytes of the EEPROM differ in each reading.
    SiiNoise,
    /// Empty categories without an end mark.
    SiiEndless,
    /// Each category has the largest possible length.
    SiiHuge,
    /// The EEPROM interface stays busy.
    EepromBusy,
    /// The EEPROM interface is busy for a long time in each access.
    EepromSlow,
    /// The AL status never changes.
    AlStays,
    /// The AL status differs in each reading.
    AlFlaps,
    /// The mailbox never empties: emergencies.
    Emergencies,
    /// The same with another protocol.
    OtherProtocol,
    /// The same with answers to requests that were not made.
    OtherAnswers,
    /// The same with the last message repeated.
    Repeats,
    /// The mailbox is never full.
    NoAnswer,
    /// The mailbox takes no request.
    TakesNothing,
    /// Objects of 4 GB.
    HugeObjects,
    /// Objects in segments without data.
    EmptySegments,
    /// Bytes of a mailbox answer are changed.
    MailboxNoise,
    /// No datagram addressed to it is answered.
    Silent,
    /// Times of the DC unit are wrong.
    Times,
    /// The clock is never where it should be (0x092C).
    Difference,
    /// Any byte that is read may be changed.
    Noise,
    /// Its accesses count more than once.
    CountsTwice,
    /// It answers datagrams addressed to others.
    AnswersForOthers,
    /// Broadcast reads return working counters of thousands.
    CountsThousands,
}

impl Lie {
    pub const ALL: [Self; 23] = [
        Lie::SiiNoise,
        Lie::SiiEndless,
        Lie::SiiHuge,
        Lie::EepromBusy,
        Lie::EepromSlow,
        Lie::AlStays,
        Lie::AlFlaps,
        Lie::Emergencies,
        Lie::OtherProtocol,
        Lie::OtherAnswers,
        Lie::Repeats,
        Lie::NoAnswer,
        Lie::TakesNothing,
        Lie::HugeObjects,
        Lie::EmptySegments,
        Lie::MailboxNoise,
        Lie::Silent,
        Lie::Times,
        Lie::Difference,
        Lie::Noise,
        Lie::CountsTwice,
        Lie::AnswersForOthers,
        Lie::CountsThousands,
    ];

    /// Whether the lie is told through the mailbox.
    pub fn is_of_the_mailbox(self) -> bool {
        (Lie::Emergencies as usize..=Lie::MailboxNoise as usize).contains(&(self as usize))
    }

    /// Whether only datagrams addressed to the liar are falsified, so that the liar can be
    /// identified.
    pub fn has_an_author(self) -> bool {
        (self as usize) < Lie::Times as usize
    }
}

/// A lie and when it is told.
#[derive(Clone, Debug)]
pub struct Liar {
    pub lie: Lie,
    /// Number of datagrams before the lie begins, and before it ends.
    pub from: u64,
    pub until: u64,
    seen: u64,
    /// Number of times that it was told.
    pub told: u64,
    last: Vec<u8>,
}

impl Liar {
    pub fn new(lie: Lie, from: u64, until: u64) -> Self {
        Self { lie, from, until, seen: 0, told: 0, last: Vec::new() }
    }

    /// Answers a datagram, whose true answer is `honest`; returns the increase of the working
    /// counter.
    #[allow(clippy::too_many_arguments, reason = "a datagram has so many parts")]
    pub fn answer(
        &mut self,
        device: &mut Device,
        command: Command,
        ado: u16,
        mine: bool,
        data: &mut [u8],
        random: &mut Random,
        honest: impl FnOnce(&mut Device, &mut [u8]) -> u16,
    ) -> u16 {
        self.seen += 1;
        if !(self.from..self.until).contains(&self.seen) {
            return honest(device, data);
        }
        let reads = matches!(command, Command::Fprd | Command::Aprd | Command::Frmw) && mine;
        let writes = matches!(command, Command::Fpwr | Command::Apwr) && mine;
        match self.lie {
            Lie::Silent if reads || writes => return self.tell(0),
            Lie::TakesNothing if writes && ado == RECEIVE.start => return self.tell(0),
            Lie::NoAnswer => {
                self.told += device.answers.len() as u64;
                device.answers.clear();
            }
            Lie::Emergencies | Lie::OtherProtocol | Lie::OtherAnswers | Lie::Repeats
                if reads && ado == 0x080D && device.answers.is_empty() =>
            {
                self.speak(device, random);
            }
            _ => {}
        }
        let mut count = honest(device, data);
        match self.lie {
            Lie::CountsTwice if reads || writes => {
                count = count.wrapping_add(1 + random.below(3) as u16);
            }
            Lie::AnswersForOthers
                if matches!(command, Command::Fprd | Command::Fpwr)
                    && !mine
                    && random.one_in(4) =>
            {
                count += 1;
            }
            Lie::CountsThousands if command == Command::Brd => {
                count = [300, 5_000, 65_535, 32_768][random.below(4) as usize];
            }
            _ if !reads => return count,
            Lie::SiiNoise if ado == 0x0502 && random.one_in(4) => {
                let at = 6 + random.below(8) as usize;
                if let Some(byte) = data.get_mut(at) {
                    *byte = random.next() as u8;
                }
            }
            Lie::SiiEndless | Lie::SiiHuge if ado == 0x0502 && self.is_category(device) => {
                let head =
                    if self.lie == Lie::SiiHuge { [10, 0, 0xFE, 0xFF] } else { [1, 0, 0, 0] };
                for (byte, lie) in data.iter_mut().skip(6).zip(head.into_iter().cycle()) {
                    *byte = lie;
                }
            }
            Lie::EepromBusy if ado == 0x0502 => data[1] |= 0x80,
            Lie::EepromSlow if ado == 0x0502 && !self.seen.is_multiple_of(100) => data[1] |= 0x80,
            Lie::AlStays if ado == 0x0130 => data[0] = 1,
            Lie::AlFlaps if ado == 0x0130 => {
                data[0] = [1, 2, 4, 8, 0x12, 0x14, 0x18, 0][random.below(8) as usize];
                if let Some(code) = data.get_mut(4) {
                    *code = random.below(64) as u8;
                }
            }
            Lie::HugeObjects | Lie::EmptySegments if ado == SEND.start && count > 0 => {
                self.stretch(data, random);
            }
            Lie::MailboxNoise if ado == SEND.start && count > 0 => {
                let at = random.below(24) as usize;
                data[at] = random.extreme() as u8;
            }
            Lie::Times if (0x0900..0x0A00).contains(&ado) && random.one_in(3) => {
                let lie = random.extreme().to_le_bytes();
                let width = data.len().min(8);
                data[..width].copy_from_slice(&lie[..width]);
            }
            Lie::Difference if ado == 0x092C => {
                data.iter_mut().zip([0, 0, 0, 0x40]).for_each(|(byte, lie)| *byte = lie);
            }
            Lie::Noise if random.one_in(50) => {
                let at = random.below(data.len() as u64) as usize;
                data[at] = random.extreme() as u8;
            }
            _ => return count,
        }
        self.tell(count)
    }

    fn tell(&mut self, count: u16) -> u16 {
        self.told += 1;
        count
    }

    fn is_category(&self, device: &Device) -> bool {
        u16::from_le_bytes([device.memory[0x0504], device.memory[0x0505]]) >= 0x40
    }

    /// Puts a further message into SM1.
    fn speak(&mut self, device: &mut Device, random: &mut Random) {
        self.told += 1;
        match self.lie {
            Lie::Emergencies => {
                let code = random.next().to_le_bytes();
                device.put(Protocol::COE, &[&[0, 0x10][..], &code].concat());
            }
            Lie::OtherProtocol => device.put(Protocol(2), &[1; 20]),
            Lie::OtherAnswers => {
                device.put(Protocol::COE, &[0, 0x30, 0x43, 1, 2, 3, 4, 5, 6, 7]);
            }
            _ => {
                if self.last.is_empty() {
                    device.put(Protocol(2), &[1; 20]);
                    self.last = device.answers.back().cloned().unwrap_or_default();
                } else {
                    device.answers.push_back(self.last.clone());
                }
            }
        }
    }

    /// Turns an upload's answer into that of a long object, and each further answer into a segment
    /// of it.
    fn stretch(&mut self, data: &mut [u8], random: &mut Random) {
        let command = data[8];
        if command >> 5 == 2 {
            let size = match self.lie {
                Lie::HugeObjects => [u32::MAX, 1 << 31, 1 << 20, (1 << 20) + 1],
                _ => [100, 1000, 5, 1 << 16],
            };
            let size = size[random.below(4) as usize];
            data[8] = 0x41;
            data[12..16].copy_from_slice(&size.to_le_bytes());
        } else if command == 0x80 && data[7] == 0x20 {
            // The device would abort a request for a segment.
            let toggle = if self.seen.is_multiple_of(2) { 0x10 } else { 0 };
            let unused = [0x0E, 0x00][random.below(2) as usize];
            (data[7], data[8]) = (0x30, toggle | unused);
        }
    }
}

/// Faults of frames between MainDevice and SubDevices, each once in this many frames; 0: never.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Wire {
    pub lost: u64,
    pub twice: u64,
    pub late: u64,
    pub cut: u64,
    pub flipped: u64,
    /// An earlier frame comes again.
    pub replayed: u64,
    /// A frame of random bytes with our header comes.
    pub random: u64,
    /// The frame comes back without the mark of the first ESC.
    pub unmarked: u64,
    /// Working counters are changed.
    pub counts: u64,
}

impl Wire {
    pub fn draw(random: &mut Random) -> Self {
        let mut chance = || match random.below(3) {
            0 => [3, 10, 50, 500][random.below(4) as usize],
            _ => 0,
        };
        Self {
            lost: chance(),
            twice: chance(),
            late: chance(),
            cut: chance(),
            flipped: chance(),
            replayed: chance(),
            random: chance(),
            unmarked: chance(),
            counts: chance(),
        }
    }

    pub fn is_honest(&self) -> bool {
        *self == Self::default()
    }
}
