//! The devices of a capture, and whom a datagram addresses.

use std::collections::BTreeMap;
use std::time::Duration;

use isocat_wire::al::AlControl;
use isocat_wire::register;

use crate::access::{Access, is_broadcast};
use crate::counters::{Differences, Errors};
use crate::known::{Image, Known, Log};
use crate::mailbox::Mailbox;
use crate::sii::Sii;
use crate::state::States;
use crate::sync_unit::SyncUnit;

/// What the capture shows of one device.
#[derive(Debug)]
pub(crate) struct Device {
    /// Its position in the segment; `None`: it was addressed by its station address alone.
    pub position: Option<u16>,
    /// Its station address, and the frame that shows it.
    pub station: Option<Known<u16>>,
    /// Its registers.
    pub image: Image,
    pub sii: Sii,
    pub states: States,
    pub mailbox: Mailbox,
    pub sync: SyncUnit,
    pub errors: Errors,
    pub differences: Differences,
    /// The last frame that addressed it alone.
    pub last: usize,
    /// Each time it ceased to answer.
    pub silences: Log<Known<Duration>>,
    /// It has answered, and does no more.
    silent: bool,
    answered: bool,
}

impl Device {
    /// A datagram to this device alone came back. Registers that each chip has count always; what
    /// lies in other places may be closed or not there.
    pub fn heard(&mut self, access: &Access<'_>, at: Duration) {
        let always = matches!(access.ado(), 0x0000..0x0140 | 0x0300..0x0314);
        match access.taken() {
            Some(true) => (self.silent, self.answered) = (false, true),
            Some(false) if always && self.answered && !self.silent => {
                self.silent = true;
                self.silences.push(Known { value: at, frame: access.frame });
            }
            _ => {}
        }
    }
}

/// All devices.
#[derive(Debug, Default)]
pub(crate) struct Devices {
    pub list: Vec<Device>,
    by_position: BTreeMap<u16, usize>,
    by_station: BTreeMap<u16, usize>,
    /// Devices that there was no room for.
    pub left_out: u64,
    /// What all devices were asked for by a broadcast, which those that are not in the list yet
    /// heard, too.
    pub asked_all: Option<Known<AlControl>>,
}

/// Whom a datagram addresses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Whom {
    /// The device at this place of the list.
    One(usize),
    /// Each of them.
    All,
    /// None that can be told.
    Unknown,
}

impl Devices {
    /// Whom an access addresses. A device that answers is taken into the list; `answers`: whether
    /// this capture shows answers at all.
    pub fn whom(&mut self, access: &Access<'_>, answers: bool) -> Whom {
        if is_broadcast(access.command) {
            return Whom::All;
        }
        if access.command.is_logical() {
            return Whom::Unknown;
        }
        let there = access.taken().unwrap_or(!answers);
        let found = match access.command.increments_position() {
            true => access.position.map(|position| (&self.by_position, position)),
            false => Some((&self.by_station, access.header.adp())),
        };
        let Some((by, key)) = found else { return Whom::Unknown };
        let known = by.get(&key).copied();
        match known.or_else(|| self.by_alias(access, key)) {
            Some(place) => Whom::One(place),
            None if there => self.add(access, key).map_or(Whom::Unknown, Whom::One),
            None => Whom::Unknown,
        }
    }

    /// A device that is addressed by its alias (0x0012) in the place of its station address.
    fn by_alias(&self, access: &Access<'_>, key: u16) -> Option<usize> {
        if access.command.increments_position() || key == 0 {
            return None;
        }
        let is_alias = |device: &Device| {
            let alias = device.image.latest(register::STATION_ALIAS);
            alias.is_some_and(|alias| alias.value == key)
        };
        let mut found = self.list.iter().enumerate().filter(|(_, device)| is_alias(device));
        match (found.next(), found.next()) {
            (Some((place, _)), None) => Some(place),
            _ => None,
        }
    }

    fn add(&mut self, access: &Access<'_>, key: u16) -> Option<usize> {
        if self.list.len() >= MOST_DEVICES {
            self.left_out += 1;
            return None;
        }
        let place = self.list.len();
        let frame = access.frame;
        let mut device = Device {
            position: None,
            station: None,
            image: Image::default(),
            sii: Sii::default(),
            states: States::new(),
            mailbox: Mailbox::new(),
            sync: SyncUnit::new(),
            errors: Errors::new(),
            differences: Differences::default(),
            last: frame,
            silences: Log::new(64),
            silent: false,
            answered: false,
        };
        device.states.asked = self.asked_all;
        if access.command.increments_position() {
            device.position = Some(key);
            self.by_position.insert(key, place);
        } else {
            device.station = Some(Known { value: key, frame });
            self.by_station.insert(key, place);
        }
        self.list.push(device);
        Some(place)
    }

    /// A device got this station address.
    pub fn name(&mut self, place: usize, station: u16, frame: usize) {
        if let Some(old) = self.list[place].station
            && self.by_station.get(&old.value) == Some(&place)
        {
            self.by_station.remove(&old.value);
        }
        // What answered to this address before may have been the same device, or not: it stays
        // apart.
        let other = self.by_station.insert(station, place).filter(|other| *other != place);
        if let Some(other) = other.filter(|other| self.list[*other].position.is_some()) {
            self.list[other].station = None;
        }
        self.list[place].station = Some(Known { value: station, frame });
    }

    /// All devices lost their station addresses.
    pub fn forget_names(&mut self) {
        self.by_station.clear();
        self.list.iter_mut().for_each(|device| device.station = None);
    }

    /// The device at a position.
    pub fn at(&self, position: u16) -> Option<usize> {
        self.by_position.get(&position).copied()
    }

    /// The device with a station address.
    pub fn named(&self, station: u16) -> Option<usize> {
        self.by_station.get(&station).copied()
    }
}

/// Devices that are kept apart. A segment has 65 535 at most; what is kept of one takes some
/// kilobytes.
const MOST_DEVICES: usize = 4096;
