//! The devices of a capture, and which of them a datagram addresses.

use std::collections::BTreeMap;
use std::time::Duration;

use isocat_wire::Command;
use isocat_wire::al::{AlControl, AlState};
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
    /// Its system time as it was read last, and when; `None` also after its clock was set.
    pub own_time: Option<(u64, Duration)>,
    pub errors: Errors,
    pub differences: Differences,
    /// The last frame that addressed it alone.
    pub last: usize,
    /// Changes of its clock's offset or delay while it was in OP.
    pub clock_set: Log<ClockSet>,
    /// Changes of its clock's offset or delay before it was in OP.
    pub clock_set_early: Log<ClockSet>,
    /// Its process data were read or written by its address in operation, without an FMMU.
    pub by_address: bool,
    /// Each time it stopped answering.
    pub silences: Log<Silence>,
    /// It answered once, and no longer does.
    silent: bool,
    /// The last frame that it answered.
    answered: Option<usize>,
}

/// A write to the offset or the delay of a clock that changed it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct ClockSet {
    pub frame: usize,
    pub at: Duration,
    /// 0x0920 or 0x0928.
    pub address: u16,
    /// The change, ns; `None`: the value before is not in the capture.
    pub by_ns: Option<i64>,
    /// Time since the last drift frame; `None`: there was none.
    pub led: Option<Duration>,
}

/// A time in which a device did not answer.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Silence {
    /// The first frame without its answer.
    pub frame: usize,
    pub at: Duration,
    /// The last frame with its answer.
    pub before: usize,
    /// The first frame that it answered again.
    pub until: Option<Known<Duration>>,
}

impl Device {
    /// Forgets the events so far; identity and set-up of the device stay known.
    pub fn forget(&mut self, at: Duration) {
        self.states.forget(at);
        self.errors.forget();
        self.differences.worst = None;
        self.clock_set = Log::new(MOST_EVENTS);
        self.clock_set_early = Log::new(MOST_EVENTS);
        self.mailbox.forget();
        self.silences = Log::new(MOST_EVENTS);
    }

    /// The offset and the delay of its clock, as far as they are known.
    fn clock(&self) -> [Option<i64>; 2] {
        let offset = self.image.latest(register::SYSTEM_TIME_OFFSET);
        let delay = self.image.latest(register::SYSTEM_TIME_DELAY);
        [offset.map(|known| known.value.cast_signed()), delay.map(|known| known.value.into())]
    }

    /// Writes `data` to its registers from `first` on; `led`: time since the last drift frame.
    pub fn write(
        &mut self,
        first: u16,
        data: &[u8],
        frame: usize,
        at: Duration,
        led: Option<Duration>,
    ) {
        let of = [register::SYSTEM_TIME_OFFSET.address, register::SYSTEM_TIME_DELAY.address];
        let end = usize::from(first) + data.len();
        let meets = usize::from(of[0]) < end && first < of[1] + 4;
        let in_op = self.states.now().is_some_and(|now| now.state() == Ok(AlState::Op));
        let before = meets.then(|| self.clock());
        self.image.write(first, data, frame);
        let Some(before) = before else { return };
        for ((address, before), now) in of.into_iter().zip(before).zip(self.clock()) {
            let written = usize::from(address) < end && first <= address;
            let by_ns = before.zip(now).map(|(before, now)| now.wrapping_sub(before));
            if written && by_ns != Some(0) {
                let set = if in_op { &mut self.clock_set } else { &mut self.clock_set_early };
                set.push(ClockSet { frame, at, address, by_ns, led });
            }
        }
    }

    /// Takes a datagram to this device alone that came back. The device is silent only if it does
    /// not answer at a register that every ESC has: other memory may be closed or missing.
    pub fn heard(&mut self, access: &Access<'_>, at: Duration) {
        let always = is_always_there(access.ado());
        match (access.taken(), self.answered) {
            (Some(true), _) => {
                if std::mem::take(&mut self.silent)
                    && let Some(last) = self.silences.kept.last_mut()
                {
                    last.until.get_or_insert(Known { value: at, frame: access.frame });
                }
                self.answered = Some(access.frame);
            }
            (Some(false), Some(before)) if always && !self.silent => {
                self.silent = true;
                self.silences.push(Silence { frame: access.frame, at, before, until: None });
            }
            _ => {}
        }
    }
}

/// Registers that every ESC has, and that answer in every state of the device.
fn is_always_there(address: u16) -> bool {
    matches!(address, 0x0000..0x0140 | 0x0300..0x0314)
}

/// All devices.
#[derive(Debug, Default)]
pub(crate) struct Devices {
    pub list: Vec<Device>,
    by_position: BTreeMap<u16, usize>,
    by_station: BTreeMap<u16, usize>,
    /// Station addresses that no device has answered to, and the first frame to each.
    unanswered: BTreeMap<u16, Known<Duration>>,
    /// Accesses to devices beyond the `MOST_DEVICES` that are kept.
    pub left_out: u64,
    /// The AL control that a broadcast wrote to all devices; it also applies to devices that are
    /// not in the list yet.
    pub asked_all: Option<Known<AlControl>>,
}

/// Which devices a datagram addresses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Whom {
    /// The device at this place of the list.
    One(usize),
    /// All devices.
    All,
    /// The capture does not tell which device.
    Unknown,
}

impl Devices {
    /// The devices that an access addresses. Adds a device that answers to the list; `answers`:
    /// whether this capture shows answers at all.
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
            None if there => {
                let by_position = access.command.increments_position();
                if !by_position {
                    self.unanswered.remove(&key);
                }
                self.add(access.frame, key, by_position).map_or(Whom::Unknown, Whom::One)
            }
            None => Whom::Unknown,
        }
    }

    /// The device that has this station alias (0x0012), if exactly one has it.
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

    /// Takes a datagram that addresses no known device. Stations that never answered are taken for
    /// devices that vanished before the capture showed anything of them, if they complete the
    /// segment: together with the known devices they are as many as frames passed before (`from`),
    /// as many devices as frames pass now (`to`) answer, and these have the lower addresses. All
    /// MainDevices give addresses in the order of positions. `before`: the last frame that passed
    /// `from` SubDevices.
    pub fn find_vanished(
        &mut self,
        access: &Access<'_>,
        at: Duration,
        (from, to): (u16, u16),
        before: usize,
    ) {
        let by_station = matches!(access.command, Command::Fprd | Command::Fpwr | Command::Fprw);
        if !by_station || !is_always_there(access.ado()) || access.taken() != Some(false) {
            return;
        }
        if self.unanswered.len() < MOST_DEVICES {
            let known = Known { value: at, frame: access.frame };
            self.unanswered.entry(access.header.adp()).or_insert(known);
        }
        let (gone, here): (Vec<&Device>, Vec<&Device>) =
            self.list.iter().filter(|device| device.station.is_some()).partition(|d| d.silent);
        let all = here.len() + gone.len() + self.unanswered.len();
        let station = |device: &&Device| device.station.map(|station| station.value);
        let last = here.iter().filter_map(station).max();
        let first = gone.iter().filter_map(station).chain(self.unanswered.keys().copied()).min();
        if all != usize::from(from) || here.len() != usize::from(to) || last >= first {
            return;
        }
        for (station, Known { value: at, frame }) in std::mem::take(&mut self.unanswered) {
            let Some(place) = self.add(frame, station, false) else { return };
            self.list[place].silent = true;
            self.list[place].silences.push(Silence { frame, at, before, until: None });
        }
    }

    /// Adds a device that is addressed by its position or by its station; returns its place.
    fn add(&mut self, frame: usize, key: u16, by_position: bool) -> Option<usize> {
        if self.list.len() >= MOST_DEVICES {
            self.left_out += 1;
            return None;
        }
        let place = self.list.len();
        let mut device = Device {
            position: None,
            station: None,
            image: Image::default(),
            sii: Sii::default(),
            states: States::new(),
            mailbox: Mailbox::new(),
            own_time: None,
            sync: SyncUnit::new(),
            errors: Errors::new(),
            differences: Differences::default(),
            last: frame,
            clock_set: Log::new(MOST_EVENTS),
            clock_set_early: Log::new(MOST_EVENTS),
            by_address: false,
            silences: Log::new(MOST_EVENTS),
            silent: false,
            answered: None,
        };
        device.states.asked = self.asked_all;
        if by_position {
            device.position = Some(key);
            self.by_position.insert(key, place);
        } else {
            device.station = Some(Known { value: key, frame });
            self.by_station.insert(key, place);
        }
        self.list.push(device);
        Some(place)
    }

    /// Notes that a device got this station address.
    pub fn name(&mut self, place: usize, station: u16, frame: usize) {
        if let Some(old) = self.list[place].station
            && self.by_station.get(&old.value) == Some(&place)
        {
            self.by_station.remove(&old.value);
        }
        // The device that had this address before may be the same one or another: it stays apart.
        let other = self.by_station.insert(station, place).filter(|other| *other != place);
        if let Some(other) = other.filter(|other| self.list[*other].position.is_some()) {
            self.list[other].station = None;
        }
        self.list[place].station = Some(Known { value: station, frame });
    }

    /// Notes that all devices lost their station addresses.
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

/// Silences, and changes of the clock, of one device that are kept.
const MOST_EVENTS: usize = 64;
/// Devices that are kept apart. A segment has at most 65 535; one device takes some kilobytes.
const MOST_DEVICES: usize = 4096;

#[cfg(test)]
mod tests {
    use isocat_wire::StationAddress;
    use isocat_wire::datagram::{Address, Header};

    use super::*;

    /// A capture that begins in operation: these stations are asked for their states after frames
    /// passed `to` SubDevices instead of `from`. Returns the stations that are taken for vanished.
    fn vanished(asked: &[(u16, bool)], from: u16, to: u16) -> Vec<u16> {
        let mut devices = Devices::default();
        for (frame, (station, answers)) in asked.iter().enumerate() {
            let address = Address::Station(StationAddress(*station), 0x0130);
            let header = Header::new(Command::Fprd, 0, address, 2);
            let access = Access {
                command: Command::Fprd,
                header,
                sent: Some(&[0, 0]),
                answered_before: false,
                back: Some((&[8, 0], u16::from(*answers))),
                passed: None,
                position: None,
                frame,
            };
            match devices.whom(&access, true) {
                Whom::One(place) => devices.list[place].heard(&access, Duration::ZERO),
                _ => devices.find_vanished(&access, Duration::ZERO, (from, to), 0),
            }
        }
        let silent = devices.list.iter().filter(|device| device.silences.count > 0);
        silent.filter_map(|device| device.station).map(|station| station.value).collect()
    }

    #[test]
    fn stations_that_make_the_segment_whole() {
        let asked = [(0x1001, true), (0x1002, false), (0x1003, false)];
        assert_eq!(vanished(&asked, 3, 1), [0x1002, 0x1003]);
        // One station more than the segment has does not vanish.
        assert_eq!(vanished(&asked, 2, 1), [0x1002]);
        // No vanished station: one too few, another number of answers, another order.
        assert_eq!(vanished(&asked, 4, 1), [0; 0]);
        assert_eq!(vanished(&asked, 3, 2), [0; 0]);
        assert_eq!(vanished(&[(0x1002, true), (0x1001, false), (0x1003, false)], 3, 1), [0; 0]);
        // A station that answers later was present.
        let late = [(0x1002, false), (0x1001, true), (0x1002, true), (0x1003, false)];
        assert_eq!(vanished(&late, 3, 2), [0x1003]);
    }
}
