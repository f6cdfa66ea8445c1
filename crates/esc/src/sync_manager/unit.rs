//! One SyncManager: its buffers, its handshake, its status byte.

use isocat_wire::register;
use isocat_wire::sync_manager::SyncManager;

use super::{Direction, Side};

/// One SyncManager.
#[derive(Clone, Copy)]
pub(super) struct Unit {
    /// Its registers in force.
    pub config: SyncManager,
    /// ECAT has opened its buffer.
    pub ecat_open: bool,
    /// The PDI has opened its buffer.
    pdi_open: bool,
    /// Mailbox: full.
    full: bool,
    /// Indices of the three buffers: the one being written, the one that waits, the one being read.
    producer: u8,
    next: u8,
    consumer: u8,
    /// The waiting buffer is newer than the one that is read.
    fresh: bool,
    /// A buffer was completely written at least once.
    filled: bool,
    /// A buffer was completely written and not opened for reading since.
    pub int_written: bool,
    /// A buffer was completely read and not opened for writing since.
    pub int_read: bool,
}

impl Unit {
    /// Off and empty.
    pub const REST: Self = Self {
        config: SyncManager {
            start: 0,
            length: 0,
            control: 0,
            status: 0,
            activate: 0,
            pdi_control: 0,
        },
        ecat_open: false,
        pdi_open: false,
        full: false,
        producer: 0,
        next: 1,
        consumer: 2,
        fresh: false,
        filled: false,
        int_written: false,
        int_read: false,
    };

    /// Returns to rest; the configuration is kept.
    pub fn reset(&mut self) {
        *self = Self { config: self.config, ..Self::REST };
    }

    /// The address behind the guarded area.
    pub fn end(&self) -> usize {
        self.config.end() as usize
    }

    /// The address behind all buffers.
    pub fn reserved_end(&self) -> usize {
        if self.is_buffered() {
            usize::from(self.config.start) + 3 * usize::from(self.config.length)
        } else {
            self.end()
        }
    }

    /// Whether it has three buffers. An area of one byte has neither buffers nor a handshake, and
    /// registers exist once only.
    pub fn is_buffered(&self) -> bool {
        !self.config.is_mailbox()
            && self.config.length > 1
            && self.config.start >= register::PROCESS_RAM
    }

    /// Index of the buffer being written, if it has three.
    pub fn producer(&self) -> usize {
        usize::from(self.producer)
    }

    /// Index of the buffer being read, if it has three.
    pub fn consumer(&self) -> usize {
        usize::from(self.consumer)
    }

    /// The buffer that `direction` accesses.
    pub fn buffer(&self, direction: Direction) -> usize {
        match direction {
            _ if !self.is_buffered() => 0,
            Direction::Read => usize::from(self.consumer),
            Direction::Write => usize::from(self.producer),
        }
    }

    /// The direction of the data, seen from `side`.
    pub fn direction_of(&self, side: Side) -> Direction {
        if self.config.is_ecat_write() == (side == Side::Ecat) {
            Direction::Write
        } else {
            Direction::Read
        }
    }

    /// Whether it is enabled, has three buffers, and records no times: [`Self::write_whole`],
    /// [`Self::read_whole`] and [`Self::written`] then have the same effect as the general
    /// functions.
    pub fn is_plain(&self) -> bool {
        self.config.is_enabled()
            && self.is_buffered()
            && self.config.pdi_control & PDI_DEACTIVATED == 0
            && self.config.activate & (SyncManager::LATCH_ECAT | SyncManager::LATCH_PDI) == 0
    }

    /// Opens its buffer for a write of all of it; returns its place in memory. It must be
    /// [plain](Self::is_plain), and the side must be the one that writes.
    #[inline]
    pub fn write_whole(&mut self, side: Side) -> usize {
        self.int_read = false;
        self.set_open(side, false);
        usize::from(self.config.start)
            + usize::from(self.producer) * usize::from(self.config.length)
    }

    /// The same for a read of all of it. `None`: nothing was written yet.
    #[inline]
    pub fn read_whole(&mut self, side: Side) -> Option<usize> {
        if !self.filled {
            return None;
        }
        if self.fresh {
            core::mem::swap(&mut self.consumer, &mut self.next);
            self.fresh = false;
        }
        self.int_written = false;
        self.set_open(side, false);
        let place = usize::from(self.consumer) * usize::from(self.config.length);
        Some(usize::from(self.config.start) + place)
    }

    /// The side that writes has written all of it, and the buffer changes hands. Returns whether
    /// this triggers the watchdog.
    #[inline]
    pub fn written(&mut self) -> bool {
        (self.int_written, self.int_read, self.filled) = (true, false, true);
        core::mem::swap(&mut self.producer, &mut self.next);
        self.fresh = true;
        self.config.control & SyncManager::CONTROL_WATCHDOG != 0
    }

    /// Whether an access at `offset` of the area is allowed. Returns its place in memory.
    #[inline]
    pub fn admit(&mut self, side: Side, direction: Direction, offset: usize) -> Option<usize> {
        if self.direction_of(side) != direction || self.config.pdi_control & PDI_DEACTIVATED != 0 {
            return None;
        }
        let start = usize::from(self.config.start);
        if self.config.length == 1 {
            match direction {
                Direction::Read => self.int_written = false,
                Direction::Write => self.int_read = false,
            }
            return Some(start);
        }
        if offset == 0 {
            self.set_open(side, false);
            match direction {
                Direction::Read => {
                    if self.config.is_mailbox() && !self.full || self.is_buffered() && !self.filled
                    {
                        return None;
                    }
                    if self.fresh {
                        core::mem::swap(&mut self.consumer, &mut self.next);
                        self.fresh = false;
                    }
                    self.int_written = false;
                }
                Direction::Write => {
                    if self.config.is_mailbox() && self.full {
                        return None;
                    }
                    self.int_read = false;
                }
            }
            self.set_open(side, true);
        }
        let open = match side {
            Side::Ecat => self.ecat_open,
            Side::Pdi => self.pdi_open,
        };
        if !open {
            return None;
        }
        Some(start + offset + self.buffer(direction) * usize::from(self.config.length))
    }

    /// Whether its bit of the AL event request is set.
    pub fn raises_al_event(&self) -> bool {
        let raised = if self.config.is_ecat_write() { self.int_written } else { self.int_read };
        raised && self.config.control & SyncManager::CONTROL_AL_EVENT != 0
    }

    /// Whether the PDI has opened a buffer to read it.
    pub fn is_open_for_reading(&self) -> bool {
        self.pdi_open && self.direction_of(Side::Pdi) == Direction::Read
    }

    /// The buffer that `side` closed changes hands. Returns whether this triggers the watchdog.
    pub fn complete(&mut self, side: Side) -> bool {
        self.set_open(side, false);
        let written = self.direction_of(side) == Direction::Write;
        if written {
            self.int_written = true;
            self.int_read = false;
            self.filled = true;
        } else {
            self.int_read = true;
            self.int_written = self.int_written && self.is_buffered();
        }
        if self.is_buffered() {
            if written {
                core::mem::swap(&mut self.producer, &mut self.next);
                self.fresh = true;
            }
        } else if self.config.length > 1 {
            self.full = written;
        }
        written && self.config.control & SyncManager::CONTROL_WATCHDOG != 0
    }

    fn set_open(&mut self, side: Side, open: bool) {
        match side {
            Side::Ecat => self.ecat_open = open,
            Side::Pdi => self.pdi_open = open,
        }
    }

    /// The status byte. `in_use`: the bits for buffers in use exist.
    #[inline]
    pub fn status(&self, in_use: bool) -> u8 {
        let last_written = match (self.config.is_mailbox(), self.filled) {
            (true, _) => 0,
            (false, false) => 3,
            // The newest complete buffer is the waiting one, or else the one being read.
            (false, true) => {
                if self.fresh {
                    self.next
                } else {
                    self.consumer
                }
            }
        };
        let bit = |set: bool, bit: u8| u8::from(set) * bit;
        let status = bit(self.int_written, SyncManager::STATUS_WRITTEN)
            | bit(self.int_read, SyncManager::STATUS_READ)
            | bit(self.full, SyncManager::STATUS_FULL)
            | last_written << 4;
        if !in_use || !(self.ecat_open || self.pdi_open) {
            return status;
        }
        let (reading, writing) = match self.direction_of(Side::Ecat) {
            Direction::Write => (self.pdi_open, self.ecat_open),
            Direction::Read => (self.ecat_open, self.pdi_open),
        };
        status
            | bit(reading, SyncManager::STATUS_READING)
            | bit(writing, SyncManager::STATUS_WRITING)
    }
}

/// PDI control bit 0.
pub(super) const PDI_DEACTIVATED: u8 = 0x01;
