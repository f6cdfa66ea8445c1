//! The EEPROM interface (0x0500-0x050F), and what the ESC itself loads from the EEPROM.

use isocat_wire::eeprom::EepromStatus;
use isocat_wire::register::{self, al_event};
use isocat_wire::sii::{self, word};
use isocat_wire::time::Device;
use isocat_wire::{AlStatus, Time};

use crate::chip::Chip;
use crate::memory::Registers;
use crate::sync_manager::Side;

/// The state of the interface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Eeprom {
    /// The command under way and when it is done.
    job: Option<(u16, Time<Device>)>,
    /// Status bits 14:11.
    errors: u16,
    /// Status bits that never change.
    fixed: u16,
    /// Reserved status bits that read 1 until SAFEOP is first reached.
    until_safeop: u16,
    /// The instant until which the memory burns and acknowledges nothing.
    burns: Time<Device>,
    /// The PDI emulates the EEPROM.
    emulated: bool,
}

impl Eeprom {
    /// An idle interface to an image of `len` bytes.
    pub const fn new(chip: &Chip, len: usize) -> Self {
        let mut fixed = 0;
        if chip.eeprom_emulated {
            fixed |= EepromStatus::EMULATED;
        } else if chip.eeprom_read_len == 8 {
            fixed |= EepromStatus::READS_8_BYTES;
        }
        if len > 2048 && !chip.eeprom_emulated {
            fixed |= EepromStatus::TWO_ADDRESS_BYTES;
        }
        let emulated = chip.eeprom_emulated;
        let until_safeop = chip.eeprom_status_reserved;
        Self { job: None, errors: 0, fixed, until_safeop, burns: Time::ZERO, emulated }
    }

    /// Handles a change of AL status; see [`Chip::eeprom_status_reserved`].
    pub fn note_state(&mut self, registers: &mut Registers) {
        let AlStatus(status) = registers.load(register::AL_STATUS);
        if self.until_safeop != 0 && status & SAFEOP_OR_OP != 0 {
            self.until_safeop = 0;
            self.show(registers);
        }
    }

    /// Whether `side` may write 0x0502-0x050F now. A PDI that emulates the memory answers its
    /// commands, whichever side gave them.
    pub fn may_write(&self, side: Side, registers: &Registers) -> bool {
        if self.is_waiting() {
            return side == Side::Pdi;
        }
        let configuration = registers.load(register::EEPROM_CONFIGURATION);
        let taken = registers.load(register::EEPROM_PDI_ACCESS) & 1 != 0;
        let owner = match side {
            Side::Ecat => configuration & 1 == 0 && !taken,
            Side::Pdi => taken,
        };
        owner && self.job.is_none()
    }

    /// Whether the PDI may take the interface; giving it back is always allowed.
    pub fn may_take(registers: &Registers) -> bool {
        registers.load(register::EEPROM_CONFIGURATION) & 0b11 == 0b01
    }

    /// Handles a control word written to 0x0502. ECAT must enable each write; the PDI need not.
    pub fn command(&mut self, side: Side, control: u16, now: Time<Device>, chip: &Chip) {
        self.errors &= !(EepromStatus::COMMAND_ERROR | EepromStatus::WRITE_ENABLE_ERROR);
        let command = control & EepromStatus::COMMAND;
        let time = match command {
            0 => return,
            EepromStatus::READ | EepromStatus::RELOAD => chip.eeprom_read_time,
            EepromStatus::WRITE
                if side == Side::Ecat && control & EepromStatus::WRITE_ENABLE == 0 =>
            {
                self.errors |= EepromStatus::WRITE_ENABLE_ERROR;
                return;
            }
            EepromStatus::WRITE => chip.eeprom_write_time,
            _ => {
                self.errors |= EepromStatus::COMMAND_ERROR;
                return;
            }
        };
        self.job = Some((command, if self.emulated { Time::NEVER } else { now + time }));
    }

    /// Handles the PDI's answer to the command under way, where the PDI emulates the memory. The
    /// control word repeats the command and adds the error bits. A different command is not an
    /// answer.
    pub fn answer(&mut self, control: u16) {
        if self.job.is_some_and(|(command, _)| command == control & EepromStatus::COMMAND) {
            self.job = None;
            self.errors |= control & (EepromStatus::CHECKSUM_ERROR | EepromStatus::COMMAND_ERROR);
        }
    }

    /// Whether a command waits for the PDI, which emulates the memory.
    pub const fn is_waiting(&self) -> bool {
        self.emulated && self.job.is_some()
    }

    /// The bit of the AL event request (0x0220) that comes from here.
    pub const fn al_events(&self) -> u32 {
        if self.is_waiting() { al_event::EEPROM } else { 0 }
    }

    /// When the command under way is done.
    pub fn due(&self) -> Time<Device> {
        self.job.map_or(Time::NEVER, |(_, due)| due)
    }

    /// Completes the command under way. Returns whether the configuration area was loaded. The
    /// image is borrowed for writing only if it is written, because it may be shared.
    pub fn finish<I: AsRef<[u8]> + AsMut<[u8]>>(
        &mut self,
        image: &mut I,
        chip: &Chip,
        registers: &mut Registers,
    ) -> bool {
        let Some((command, now)) = self.job.take() else { return false };
        if now < self.burns {
            self.errors |= EepromStatus::COMMAND_ERROR;
            return false;
        }
        let address = u64::from(registers.load(register::EEPROM_ADDRESS)) * 2;
        let from = usize::try_from(address).unwrap_or(usize::MAX);
        match command {
            EepromStatus::READ => {
                let mut data = registers.load(register::EEPROM_DATA).to_le_bytes();
                let len = usize::from(chip.eeprom_read_len).min(data.len());
                for (at, byte) in data[..len].iter_mut().enumerate() {
                    // Cells beyond the end read as erased cells do.
                    let image = image.as_ref();
                    *byte = image.get(from.saturating_add(at)).copied().unwrap_or(0xFF);
                }
                registers.store(register::EEPROM_DATA, u64::from_le_bytes(data));
            }
            EepromStatus::WRITE => {
                let data = registers.load(register::EEPROM_DATA).to_le_bytes();
                if let Some(cells) = image.as_mut().get_mut(from..from.saturating_add(2)) {
                    cells.copy_from_slice(&data[..2]);
                }
                self.burns = now + chip.eeprom_burn_time;
            }
            _ => return self.load(image.as_ref(), registers),
        }
        false
    }

    /// Ends the command under way without an acknowledge from the memory.
    pub fn get_no_acknowledge(&mut self) {
        if self.job.take().is_some() {
            self.errors |= EepromStatus::COMMAND_ERROR;
        }
    }

    /// Finds no memory at a load: nothing acknowledges, so there is no checksum to be wrong.
    /// Nothing is loaded.
    pub fn miss(&mut self) -> bool {
        self.errors |= EepromStatus::COMMAND_ERROR | EepromStatus::NOT_LOADED;
        false
    }

    /// Loads the configuration area into 0x0140-0x0152 and 0x0982 if its checksum is right. The
    /// caller loads the alias and the link detection bits, since that happens at power-on only.
    pub fn load(&mut self, image: &[u8], registers: &mut Registers) -> bool {
        self.errors |= EepromStatus::CHECKSUM_ERROR | EepromStatus::NOT_LOADED;
        let Some(area) = configuration(image) else { return false };
        self.errors &= !(EepromStatus::CHECKSUM_ERROR | EepromStatus::NOT_LOADED);
        registers.store(register::PDI_CONTROL, area[0]);
        registers.store(register::ESC_CONFIGURATION, area[1]);
        registers.store(register::PDI_CONFIGURATION, area[2]);
        registers.store(register::SYNC_LATCH_CONFIGURATION, area[3]);
        registers.store(register::SYNC_PULSE_LENGTH, u16::from_le_bytes([area[4], area[5]]));
        registers
            .store(register::EXTENDED_PDI_CONFIGURATION, u16::from_le_bytes([area[6], area[7]]));
        true
    }

    /// Writes register 0x0502.
    pub fn show(&self, registers: &mut Registers) {
        let job = self.job.map_or(0, |(command, _)| command | EepromStatus::BUSY);
        // The PDI may always write.
        let enabled = match registers.load(register::EEPROM_PDI_ACCESS) & 1 {
            0 => 0,
            _ => EepromStatus::WRITE_ENABLE,
        };
        let status = self.fixed | self.until_safeop | self.errors | job | enabled;
        registers.store(register::EEPROM_STATUS, EepromStatus(status));
    }
}

/// Words 0 to 6, if their checksum is right or switched off.
pub(crate) fn configuration(image: &[u8]) -> Option<&[u8; 14]> {
    let area: &[u8; 14] = image.first_chunk()?;
    let at = 2 * usize::from(word::CHECKSUM);
    let stored: [u8; 2] = image.get(at..at + 2)?.try_into().ok()?;
    (stored[0] == sii::checksum(area) || u16::from_le_bytes(stored) == CHECKSUM_OFF).then_some(area)
}

/// A checksum word that is always accepted, for development.
const CHECKSUM_OFF: u16 = 0x88A4;
/// Bits of the states SAFEOP and OP in AL status.
const SAFEOP_OR_OP: u16 = 0x000C;
