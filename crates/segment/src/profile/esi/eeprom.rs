//! The SII of an imported device.

use isocat_descriptions::esi::{EsiOpMode, EsiSyncManager, Purpose};
use isocat_subdevice::description::Mailbox;
use isocat_wire::sii::{MailboxArea, SmRecord, sm_type};
use isocat_wire::sync_manager::SyncManager;

use super::super::draft::{Area, Eeprom, Window};
use super::super::sii::{self, cut};
use super::{Doubt, DoubtKind, Import};

impl Import<'_> {
    pub(super) fn eeprom(
        &mut self,
        areas: [&Option<Area>; 2],
        windows: Vec<Window>,
        mailbox: Option<Mailbox>,
    ) -> Eeprom {
        let device = self.device;
        let coe = device.mailbox.as_ref().and_then(|mailbox| mailbox.coe.as_ref());
        let mut details = 0;
        if let Some(coe) = coe {
            for (has, bit) in [
                (true, sii::COE_SDO),
                (coe.sdo_info, sii::COE_INFORMATION),
                (coe.pdo_assign, sii::COE_ASSIGNMENT),
                (coe.pdo_config, sii::COE_CONFIGURATION),
                (coe.pdo_upload, sii::COE_UPLOAD),
                (coe.complete_access, sii::COE_COMPLETE_ACCESS),
            ] {
                details |= if has { bit } else { 0 };
            }
        }
        let mut sync_managers = Vec::new();
        let has_outputs = areas[0].as_ref().is_some_and(|area| area.bits(&area.default) > 0);
        for (number, sm) in device.sync_managers.iter().enumerate() {
            if let Purpose::Window(_) = sm.purpose {
                let mut mapped = windows.iter();
                let mapped = mapped.find(|window| usize::from(window.sync_manager) == number);
                sync_managers.push(window(sm, mapped));
                continue;
            }
            let length = areas.into_iter().flatten().find_map(|area| length_of(area, number));
            sync_managers.push(self.sync_manager(number, sm, length, mailbox, has_outputs));
        }
        let boot = device.eeprom.as_ref().and_then(|eeprom| eeprom.boot);
        Eeprom {
            configuration: self.configuration(),
            boot: boot.unwrap_or((MailboxArea::default(), MailboxArea::default())),
            coe_details: details,
            ports: ports(device.physics.as_deref().unwrap_or("YY")),
            fmmus: device.fmmus.clone(),
            sync_managers,
            windows,
            op_modes: device.op_modes().iter().map(record).collect(),
            order: cut(&device.type_name).to_owned(),
            size: device.eeprom.as_ref().map_or(0, |eeprom| eeprom.byte_size),
        }
    }

    /// Words 0 to 6.
    fn configuration(&mut self) -> [u8; 14] {
        let given = self.device.eeprom.as_ref().and_then(|eeprom| eeprom.configuration);
        let Some(mut words) = given else {
            let mut words = [0; 14];
            if self.emulated {
                (words[0], words[1]) = (sii::PDI_DIGITAL_IO, sii::DEVICE_EMULATION);
                let why = "the description has no ConfigData; its outputs are registers, as those of digital I/O are";
                self.assume("Eeprom/ConfigData", "0401", why);
                return words;
            }
            (words[0], words[1]) = (sii::PDI_SPI, sii::ESC_SYNC_AND_LATCH);
            words[3] = sii::SYNC_OUTPUTS_MAPPED;
            words[4..6].copy_from_slice(&1_000_u16.to_le_bytes());
            let why = "the description has no ConfigData; SPI, SYNC pins, pulses of 10 us";
            self.assume("Eeprom/ConfigData", "050c00cce803", why);
            return words;
        };
        let stated = words[1] & sii::DEVICE_EMULATION != 0;
        if stated && !self.emulated {
            words[1] &= !sii::DEVICE_EMULATION;
            let why = "a mailbox needs a program, and the ESC of a device with a program does not copy AL control to AL \
                       status";
            self.assume("Eeprom/ConfigData device emulation", "off", why);
        }
        if self.emulated && !stated {
            words[1] |= sii::DEVICE_EMULATION;
            let why = "its outputs are registers, as those of digital I/O without a program are";
            self.assume("Eeprom/ConfigData device emulation", "on", why);
        }
        let acknowledged = words[4..6] == [0; 2] && words[1] & sii::SYNC_UNIT != 0;
        if acknowledged && self.device.dc.is_some() {
            let why = "ConfigData has SYNC pulses that its program acknowledges, and does not say how soon it does";
            self.assume("times.acknowledge", "0 ns", why);
        }
        words
    }

    fn sync_manager(
        &mut self,
        number: usize,
        sm: &EsiSyncManager,
        assigned: Option<u16>,
        mailbox: Option<Mailbox>,
        has_outputs: bool,
    ) -> SmRecord {
        let (kind, usual) = match sm.purpose {
            Purpose::MailboxOut => (sm_type::MAILBOX_OUT, SyncManager::MAILBOX_OUT),
            Purpose::MailboxIn => (sm_type::MAILBOX_IN, SyncManager::MAILBOX_IN),
            Purpose::Outputs => (sm_type::OUTPUTS, SyncManager::OUTPUTS),
            Purpose::Inputs => (sm_type::INPUTS, SyncManager::INPUTS),
            Purpose::Window(_) => (sm_type::UNUSED, 0),
        };
        let mut control = sm.control.unwrap_or(usual);
        let is_mailbox = matches!(sm.purpose, Purpose::MailboxOut | Purpose::MailboxIn);
        let length = match assigned {
            Some(length) => length,
            None if is_mailbox && mailbox.is_some() => sm.default_size,
            None => 0,
        };
        // Beside outputs, whose event begins a cycle, nothing waits for the inputs to be read.
        let silent = self.emulated || has_outputs && sm.purpose == Purpose::Inputs;
        if length > 0 && !silent && control & SyncManager::CONTROL_AL_EVENT == 0 {
            let of_file = control;
            control |= SyncManager::CONTROL_AL_EVENT;
            let why = "the real device needs no event of this SyncManager; the virtual one has no other way \
                       to know that a frame came";
            self.assume(&format!("Sm{number} control"), format!("{control:#04x}"), why);
            let words = format!(
                "SyncManager {number}: control byte {of_file:#04x} becomes {control:#04x}: {why}"
            );
            self.doubts.push(Doubt::new(DoubtKind::AlEventAdded, words));
        }
        let flags = [(length > 0, SmRecord::ENABLED), (sm.op_only, SmRecord::OP_ONLY)];
        let enable = flags.into_iter().filter(|(is, _)| *is).fold(0, |sum, (_, bit)| sum | bit);
        // A SyncManager without process data is unused.
        let kind = if length == 0 && assigned.is_none() { sm_type::UNUSED } else { kind };
        SmRecord { start: sm.start, length, control, status: 0, enable, kind }
    }
}

/// The record of a window: no SyncManager is activated. One that nothing maps is told as unused.
fn window(sm: &EsiSyncManager, mapped: Option<&Window>) -> SmRecord {
    SmRecord {
        start: sm.start,
        length: mapped.map_or(0, |window| window.length),
        control: sm.control.unwrap_or(0),
        status: 0,
        enable: SmRecord::VIRTUAL | if sm.op_only { SmRecord::OP_ONLY } else { 0 },
        kind: if mapped.is_some() { sm_type::INPUTS } else { sm_type::UNUSED },
    }
}

/// Bytes of an area that a SyncManager guards; `None` if the SyncManager does not belong to the
/// area.
fn length_of(area: &Area, number: usize) -> Option<u16> {
    if usize::from(area.sync_manager) == number {
        return Some(area.bits(&area.default).div_ceil(8) as u16);
    }
    let share = area.further.iter().find(|share| usize::from(share.sync_manager) == number)?;
    Some(share.length)
}

/// An OpMode in category 60; the numbers of its texts are filled in later.
fn record(mode: &EsiOpMode) -> (String, String, [u8; 24]) {
    let mut record = [0; 24];
    let time = |time: Option<isocat_wire::time::Nanos>| time.map_or(0, |time| time.0) as i32;
    let factor = |cycle: Option<isocat_descriptions::esi::CycleTime>| {
        let factor = cycle.and_then(|cycle| cycle.factor).unwrap_or(0);
        factor.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    };
    let cycle0 = time(mode.cycle_time_sync0.map(|cycle| cycle.value));
    let shift0 = time(mode.shift_time_sync0.map(|shift| shift.value));
    let shift1 = time(mode.shift_time_sync1.map(|shift| shift.value));
    record[0x00..0x04].copy_from_slice(&cycle0.to_le_bytes());
    record[0x04..0x08].copy_from_slice(&shift0.to_le_bytes());
    record[0x08..0x0C].copy_from_slice(&shift1.to_le_bytes());
    record[0x0C..0x0E].copy_from_slice(&factor(mode.cycle_time_sync1).to_le_bytes());
    record[0x0E..0x10].copy_from_slice(&mode.assign_activate.to_le_bytes());
    record[0x10..0x12].copy_from_slice(&factor(mode.cycle_time_sync0).to_le_bytes());
    (mode.name.clone(), mode.description.clone(), record)
}

/// Kind of each port for the general category.
fn ports(physics: &str) -> u16 {
    let kinds = physics.chars().take(4).map(|letter| match letter {
        ' ' => 0,
        'K' | 'B' => 3,
        'H' => 4,
        _ => 1_u16,
    });
    kinds.enumerate().fold(0, |sum, (port, kind)| sum | kind << (4 * port))
}
