//! Finds the chip of each SubDevice: the one that contradicts the capture least.
//!
//! Candidates answer the accesses of the capture themselves, as models, so no table of units and
//! addresses is needed.

use std::collections::HashMap;

use isocat_esc::chip::PortKind;
use isocat_esc::{
    Chip, ET1100, ET1100_MII, ET1200, Esc, IP_CORE_32, IP_CORE_32_EMULATED, LAN9252, XMC4800,
};
use isocat_wire::datagram::Address;
use isocat_wire::eeprom::EepromStatus;
use isocat_wire::frame::{FrameWriter, MAX_LEN};
use isocat_wire::{Command, Nanos, PortNumber, Time, sii};

use super::evidence::{Access, Device, Evidence};
use super::parts::list;

/// The hardware of a SubDevice, as far as the capture shows it.
#[derive(Clone, Debug)]
pub(crate) struct Build {
    /// Its ESC.
    pub chip: Chip,
    /// Words 0 to 6 of its EEPROM, which the ESC loads.
    pub configuration: [u8; 14],
    /// Whether the configuration is loaded; otherwise its checksum is wrong.
    pub loads: bool,
    /// Whether the capture does not determine the chip, so that the usual one is assumed.
    pub guessed: bool,
}

/// What a segment file states of a SubDevice.
#[derive(Clone, Debug)]
pub struct Told {
    /// Its name in the file.
    pub name: String,
    /// Its ESC.
    pub chip: Chip,
    /// Its EEPROM.
    pub sii: Vec<u8>,
}

/// Builds each SubDevice from the capture, completed by `told`.
pub(crate) fn builds(evidence: &Evidence, told: Option<&[Told]>) -> Vec<Build> {
    let mut answers = Answers::default();
    let options: Vec<Vec<Candidate>> = evidence
        .devices
        .iter()
        .enumerate()
        .map(|(position, device)| {
            options(position, device, told.map(|told| &told[position]), &mut answers)
        })
        .collect();
    let chosen = choose(evidence, &options, &mut answers);
    let devices = evidence.devices.iter().zip(options).zip(chosen).enumerate();
    devices
        .map(|(position, ((device, options), chosen))| {
            let option = &options[chosen];
            let told = told.map(|told| &told[position]);
            Build {
                chip: chip(device, &option.chip),
                configuration: configuration(device, option.esc_configuration, told),
                loads: device.eeprom_bits & EepromStatus::NOT_LOADED == 0,
                guessed: told.is_none()
                    && !device.first.contains_key(&0x0000)
                    && !device.first.contains_key(&0x0008),
            }
        })
        .collect()
}

/// One chip with one choice of units, and its contradictions to the device's own evidence.
#[derive(Clone, Copy)]
struct Candidate {
    chip: Chip,
    esc_configuration: u8,
    cost: u32,
}

fn options(
    position: usize,
    device: &Device,
    told: Option<&Told>,
    answers: &mut Answers,
) -> Vec<Candidate> {
    let chips: Vec<&Chip> = match told {
        Some(told) => vec![&told.chip],
        None => CANDIDATES.to_vec(),
    };
    let known = known_configuration(device, told).map(|[_, high]| high);
    let units: Vec<u8> = match known {
        Some(known) => vec![known],
        None => {
            let seen = u8::from(is_emulated(device)) | u8::from(enhanced_link(device)) << 1;
            UNITS.iter().map(|units| units | seen).collect()
        }
    };
    let mut options = Vec::new();
    for (rank, chip) in chips.into_iter().enumerate() {
        for (number, esc_configuration) in units.iter().copied().enumerate() {
            let mut cost = contradictions(device, chip) + rank as u32 + number as u32;
            if position == 0 && chip.port(PortNumber::P0) != PortKind::Mii {
                cost += WEAK;
            }
            for (access, counted) in &device.accesses {
                let answered = answers.to(chip, esc_configuration, *access).count > 0;
                cost += if answered == *counted { 0 } else { STRONG };
            }
            options.push(Candidate { chip: *chip, esc_configuration, cost });
        }
    }
    options
}

/// Amount by which the identity that was read differs from this chip's.
fn contradictions(device: &Device, chip: &Chip) -> u32 {
    let mut identity = [0; 10];
    identity[0] = chip.kind;
    identity[1] = chip.revision;
    identity[2..4].copy_from_slice(&chip.build.to_le_bytes());
    identity[4..8].copy_from_slice(&[
        chip.fmmu_count,
        chip.sm_count,
        chip.ram_kib,
        chip.port_descriptor,
    ]);
    identity[8..10].copy_from_slice(&chip.features.to_le_bytes());
    let weights = [4 * STRONG, WEAK, 1, 1, STRONG, STRONG, STRONG, WEAK, STRONG, STRONG];
    let mut cost = 0;
    for (address, (own, weight)) in identity.into_iter().zip(weights).enumerate() {
        let found = device.first.get(&(address as u16));
        cost += if found.is_some_and(|found| *found != own) { weight } else { 0 };
    }
    if device.eeprom_seen {
        let bit = |bit: u16| device.eeprom_bits & bit != 0;
        let differs = [
            bit(EepromStatus::EMULATED) != chip.eeprom_emulated,
            !chip.eeprom_emulated
                && bit(EepromStatus::READS_8_BYTES) != (chip.eeprom_read_len == 8),
            bit(0x001E) && device.eeprom_bits & 0x001E & !chip.eeprom_status_reserved != 0,
        ];
        cost += STRONG * differs.into_iter().filter(|differs| *differs).count() as u32;
    }
    cost
}

/// Chooses for each SubDevice so that the number of answers to broadcasts agrees with the capture.
/// Starts with the option that fits each best, and changes one at a time while that helps.
fn choose(evidence: &Evidence, options: &[Vec<Candidate>], answers: &mut Answers) -> Vec<usize> {
    let best = |options: &Vec<Candidate>| (0..options.len()).min_by_key(|at| options[*at].cost);
    let mut chosen: Vec<usize> = options.iter().map(|o| best(o).unwrap_or(0)).collect();
    let mut cost = total(evidence, options, &chosen, answers);
    for _ in 0..MOST_ROUNDS {
        let before = cost;
        // From the end, since most evidence of the first ones was read from them alone.
        for position in (0..options.len()).rev() {
            for option in 0..options[position].len() {
                let kept = chosen[position];
                chosen[position] = option;
                let now = total(evidence, options, &chosen, answers);
                if now < cost {
                    cost = now;
                } else {
                    chosen[position] = kept;
                }
            }
        }
        if cost == before {
            break;
        }
    }
    chosen
}

fn total(
    evidence: &Evidence,
    options: &[Vec<Candidate>],
    chosen: &[usize],
    answers: &mut Answers,
) -> u32 {
    let mut cost = 0;
    for (options, chosen) in options.iter().zip(chosen) {
        cost += options[*chosen].cost;
    }
    for (access, found) in &evidence.broadcasts {
        let mut count = 0;
        let mut type_or = 0;
        for (options, chosen) in options.iter().zip(chosen) {
            let Candidate { chip, esc_configuration, .. } = &options[*chosen];
            let answer = answers.to(chip, *esc_configuration, *access);
            count += answer.count;
            type_or |= if access.address == 0 { chip.kind } else { 0 };
        }
        cost += BROADCAST * u32::from(count.abs_diff(found.count));
        let differs = access.address == 0
            && !access.writes
            && found.data.first().is_some_and(|data| *data != type_or);
        cost += if differs { STRONG } else { 0 };
    }
    cost
}

/// The answers of candidates.
#[derive(Default)]
struct Answers(HashMap<(&'static str, u8, Access), Answer>);

#[derive(Clone, Copy)]
struct Answer {
    count: u16,
}

impl Answers {
    fn to(&mut self, chip: &Chip, esc_configuration: u8, access: Access) -> Answer {
        let key = (chip.name, esc_configuration, access);
        *self.0.entry(key).or_insert_with(|| ask(chip, esc_configuration, access))
    }
}

/// The working counter of a new ESC for a broadcast with zeros.
fn ask(chip: &Chip, esc_configuration: u8, access: Access) -> Answer {
    let mut configuration = [0; 14];
    configuration[1] = esc_configuration;
    let mut esc = Esc::new(chip, image(&configuration, true, 128), Vec::new());
    esc.set_port(PortNumber::P0, true);
    let mut buffer = [0; MAX_LEN];
    let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
    let command = if access.writes { Command::Bwr } else { Command::Brd };
    let data = vec![0; usize::from(access.len)];
    let fits = writer.push(command, 0, Address::Broadcast(access.address), &data).is_ok();
    let len = writer.finish();
    esc.process(&mut buffer[..len], Time::new(1_000), Time::new(200_000), true);
    let count = list(&buffer[..len]).first().map_or(0, |datagram| datagram.wkc);
    Answer { count: if fits { count } else { 0 } }
}

/// An EEPROM image with this configuration area, otherwise erased.
pub(crate) fn image(configuration: &[u8; 14], loads: bool, len: usize) -> Vec<u8> {
    let mut image = vec![0xFF; len.max(16)];
    image[..14].copy_from_slice(configuration);
    let checksum = sii::checksum(configuration);
    image[14] = if loads { checksum } else { checksum ^ 0x55 };
    image[15] = 0;
    image
}

/// The chip with the parts of its identity that were read.
fn chip(device: &Device, candidate: &Chip) -> Chip {
    let byte = |address: u16, own: u8| device.first.get(&address).copied().unwrap_or(own);
    let word = |address: u16, own: u16| {
        let [low, high] = own.to_le_bytes();
        u16::from_le_bytes([byte(address, low), byte(address + 1, high)])
    };
    let control = candidate.dl_control.to_le_bytes();
    // The loops and the alias bit are settings of an earlier session if they differ from those
    // after power-on.
    let control = [control[0], control[1], byte(0x0102, control[2]), control[3]];
    Chip {
        kind: byte(0x0000, candidate.kind),
        revision: byte(0x0001, candidate.revision),
        build: word(0x0002, candidate.build),
        fmmu_count: byte(0x0004, candidate.fmmu_count).min(16),
        sm_count: byte(0x0005, candidate.sm_count).min(16),
        ram_kib: byte(0x0006, candidate.ram_kib).min(60),
        port_descriptor: byte(0x0007, candidate.port_descriptor),
        features: word(0x0008, candidate.features),
        dl_control: u32::from_le_bytes(control),
        // Silicon's own times are in its answers: while it is busy, the EEPROM's registers are not
        // compared.
        eeprom_read_time: Nanos(100),
        eeprom_write_time: Nanos(100),
        eeprom_burn_time: burn_time(device),
        ..*candidate
    }
}

/// The middle between the last command that was not acknowledged and the first that was; 1 us after
/// the former if the latter is missing, and 0 without the former.
fn burn_time(device: &Device) -> Nanos {
    let nanos = match device.burn {
        (Some(refused), Some(taken)) if taken > refused => refused + (taken - refused) / 2,
        (Some(refused), _) => refused + 1_000,
        (None, _) => 0,
    };
    Nanos(i64::try_from(nanos).unwrap_or(i64::MAX))
}

/// Words 0 to 6: from the EEPROM if it was read, from registers, from the segment file, or from the
/// SubDevice's behaviour.
fn configuration(device: &Device, esc_configuration: u8, told: Option<&Told>) -> [u8; 14] {
    let mut area = [0; 14];
    if let Some(told) = told.and_then(|told| told.sii.first_chunk::<14>()) {
        area = *told;
    }
    let emulated = esc_configuration & 1 != 0;
    area[0] = match known_configuration(device, told) {
        Some([low, _]) => low,
        None if !emulated => ON_CHIP_BUS,
        None if dl_watchdog(device) => DIGITAL_IO,
        None => 0,
    };
    area[1] = esc_configuration;
    for (register, place) in REGISTERS_OF_AREA {
        if let Some(value) = device.first.get(&register) {
            area[place] = *value;
        }
    }
    for word in 0..7 {
        if let Some(value) = device.words.get(&word) {
            area[2 * word as usize..][..2].copy_from_slice(&value.to_le_bytes());
        }
    }
    area
}

/// Word 0, if it is known.
fn known_configuration(device: &Device, told: Option<&Told>) -> Option<[u8; 2]> {
    if let Some(word) = device.words.get(&0) {
        return Some(word.to_le_bytes());
    }
    if let (Some(low), Some(high)) = (device.first.get(&0x0140), device.first.get(&0x0141)) {
        return Some([*low, *high]);
    }
    told.and_then(|told| told.sii.first_chunk().copied())
}

/// Whether the ESC copies AL control to AL status by itself, as it does for SubDevices without a
/// CPU.
fn is_emulated(device: &Device) -> bool {
    let speaks = device.mailbox || device.words.get(&MAILBOX_PROTOCOLS).is_some_and(|p| *p != 0);
    device.al_copied || !device.al_differs && !speaks
}

/// Enhanced link detection (register 0x0141 bit 1), from the first read of DL status bit 2.
fn enhanced_link(device: &Device) -> bool {
    device.first.get(&0x0110).is_some_and(|status| status & 0x04 != 0)
}

/// The first read of DL status bit 1.
fn dl_watchdog(device: &Device) -> bool {
    device.first.get(&0x0110).is_some_and(|status| status & 0x02 != 0)
}

/// The candidates, the more frequent first.
static CANDIDATES: [&Chip; 7] =
    [&ET1100, &ET1200, &LAN9252, &ET1100_MII, &XMC4800, &IP_CORE_32, &IP_CORE_32_EMULATED];
/// Bits 3:2 of register 0x0141: SYNC and latch units. Without evidence of them there are none.
const UNITS: [u8; 4] = [0x00, 0x0C, 0x04, 0x08];
/// Registers that are loaded from the configuration area, and their bytes there.
const REGISTERS_OF_AREA: [(u16, usize); 9] = [
    (0x0140, 0),
    (0x0150, 2),
    (0x0151, 3),
    (0x0982, 4),
    (0x0983, 5),
    (0x0152, 6),
    (0x0153, 7),
    (0x0012, 8),
    (0x0013, 9),
];
/// SII word 0x1C.
const MAILBOX_PROTOCOLS: u32 = sii::word::MAILBOX_PROTOCOLS as u32;
/// PDI control of a CPU behind the PDI, of any kind.
const ON_CHIP_BUS: u8 = 0x80;
/// PDI control of digital I/O.
const DIGITAL_IO: u8 = 0x04;
/// Cost of a contradiction: by a register or an access of its own; by a broadcast, for each
/// SubDevice too many or too few.
const STRONG: u32 = 1000;
const BROADCAST: u32 = 400;
const WEAK: u32 = 100;
/// Limit of the rounds of changes; each round improves the whole or is the last.
const MOST_ROUNDS: usize = 16;
