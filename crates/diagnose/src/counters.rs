//! Error counters of a device and its distance from the reference clock, as they were read.

use std::collections::BTreeMap;

use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::register;

use crate::access::{Access, part};
use crate::known::{Known, Log};

/// A counter that was read higher than before.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Grown {
    pub address: u16,
    pub from: u8,
    pub to: u8,
    /// Frames of the previous reading and of this one.
    pub before: usize,
    pub frame: usize,
}

/// The error counters of one device: 0x0300 to 0x0313, 0x0442, 0x0443.
#[derive(Clone, Debug)]
pub(crate) struct Errors {
    /// The last reading of each counter.
    last: BTreeMap<u16, Known<u8>>,
    pub grown: Log<Grown>,
    /// Counters that were not zero when they were first read.
    pub before: Vec<(u16, Known<u8>)>,
    /// Frames that read at least one counter.
    pub readings: u64,
}

impl Errors {
    pub fn new() -> Self {
        Self { last: BTreeMap::new(), grown: Log::new(MOST_GROWN), before: Vec::new(), readings: 0 }
    }

    /// Forgets what was counted so far; the last readings stay known.
    pub fn forget(&mut self) {
        self.grown = Log::new(MOST_GROWN);
        self.before.clear();
    }

    /// Takes an access to the device's registers.
    pub fn access(&mut self, access: &Access<'_>) {
        let first = usize::from(access.ado());
        let span = first..first + usize::from(access.header.len);
        if span.end <= 0x0300 || span.start > 0x0443 {
            return;
        }
        if access.written().is_some() && access.taken() != Some(false) {
            self.clear(&span, access.frame);
        }
        let Some(data) = access.read() else { return };
        let mut any = false;
        for (address, value) in span.zip(data) {
            let Ok(address) = u16::try_from(address) else { return };
            if name(address).is_some() {
                any = true;
                self.see(address, *value, access.frame);
            }
        }
        self.readings += u64::from(any);
    }

    /// A write to one of a group of counters clears all of them, whatever is written.
    fn clear(&mut self, span: &std::ops::Range<usize>, frame: usize) {
        for (first, last) in GROUPS {
            if span.start > last || span.end <= first {
                continue;
            }
            for address in first..=last {
                self.last.insert(address as u16, Known { value: 0, frame });
            }
        }
    }

    fn see(&mut self, address: u16, value: u8, frame: usize) {
        match self.last.insert(address, Known { value, frame }) {
            Some(last) if value > last.value => {
                let (from, before) = (last.value, last.frame);
                self.grown.push(Grown { address, from, to: value, before, frame });
            }
            None if value > 0 => self.before.push((address, Known { value, frame })),
            _ => {}
        }
    }

    /// The counters that are not zero, as they were last read.
    pub fn now(&self) -> impl Iterator<Item = (u16, Known<u8>)> + '_ {
        self.last.iter().map(|(address, known)| (*address, *known)).filter(|(_, k)| k.value > 0)
    }
}

/// What a counter counts; `None`: no counter is at this address.
pub(crate) fn name(address: u16) -> Option<&'static str> {
    Some(match address {
        0x0300..=0x0307 if address.is_multiple_of(2) => "invalid frames",
        0x0300..=0x0307 => "RX errors",
        0x0308..=0x030B => "forwarded RX errors",
        0x030C => "EPU errors",
        0x030D => "PDI errors",
        0x0310..=0x0313 => "lost links",
        0x0442 => "process data watchdog expiries",
        0x0443 => "PDI watchdog expiries",
        _ => return None,
    })
}

/// The port that a counter belongs to; `None`: it belongs to the device.
pub(crate) fn port(address: u16) -> Option<u16> {
    match address {
        0x0300..=0x0307 => Some((address - 0x0300) / 2),
        0x0308..=0x030B => Some(address - 0x0308),
        0x0310..=0x0313 => Some(address - 0x0310),
        _ => None,
    }
}

/// Increases of the counters of one device that are kept.
const MOST_GROWN: usize = 256;
/// Counters that one write clears together: first and last address.
const GROUPS: [(usize, usize); 5] =
    [(0x0300, 0x030B), (0x030C, 0x030C), (0x030D, 0x030D), (0x0310, 0x0313), (0x0442, 0x0443)];

/// Readings of 0x092C of one device.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Differences {
    pub count: u64,
    pub last: Option<Known<SystemTimeDifference>>,
    /// The largest one that was read while the segment was in operation.
    pub worst: Option<Known<SystemTimeDifference>>,
    /// The last one that was read before SYNC was switched on.
    pub before_sync: Option<Known<SystemTimeDifference>>,
}

impl Differences {
    pub fn access(&mut self, access: &Access<'_>, operating: bool, sync_on: bool) {
        let address = register::SYSTEM_TIME_DIFFERENCE.address;
        let Some(data) = access.read() else { return };
        let Some(bytes) = part::<4>(access.ado(), data, address) else { return };
        let value = SystemTimeDifference(u32::from_le_bytes(bytes));
        let known = Known { value, frame: access.frame };
        self.count += 1;
        self.last = Some(known);
        if !sync_on {
            self.before_sync = Some(known);
        }
        let worse =
            |worst: Known<SystemTimeDifference>| value.magnitude() > worst.value.magnitude();
        if operating && self.worst.is_none_or(worse) {
            self.worst = Some(known);
        }
    }
}
