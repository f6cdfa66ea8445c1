//! What the judges look at besides the SubDevice of an event: the segment at that moment.

use isocat_wire::time::{Device as DeviceClock, Picos, Time, True};

use crate::brief::Brief;
use crate::device::{Device, Tick};
use crate::judge::ClockTime;
use crate::path::{Arrival, Path};
use crate::returns::Returns;
use crate::segment::Segment;
use crate::wiring::MainPort;

/// The segment, as long as nothing happens in it.
pub(super) struct Look<'a> {
    /// The SubDevices.
    pub devices: &'a [Device],
    /// The ways of frames from both ports.
    paths: [&'a Path; 2],
    /// The SubDevice of the reference clock, if it has power: without power it shows a meaningless
    /// time.
    leader: Option<&'a Device>,
    /// Ticks of the reference clock that were read, by the last digits of their number: the pulses
    /// of a cycle come within a few ticks.
    ticks: [Tick; TICKS],
    returns: &'a Returns,
    /// The frame whose return was found last: as a rule that of the next SubDevice, too.
    found: (Time<True>, Time<True>),
}

impl<'a> Look<'a> {
    pub fn new(segment: &'a Segment, leader: Option<&'a Device>) -> Self {
        let paths = [MainPort::Primary, MainPort::Secondary].map(|port| segment.path_from(port));
        let found = (Time::NEVER, Time::NEVER);
        let (devices, returns) = (segment.devices(), &segment.returns);
        Self { devices, paths, leader, ticks: [Tick::NONE; TICKS], returns, found }
    }

    /// True time of an event at a SubDevice, which was noted briefly.
    #[inline(always)]
    pub fn true_time(&self, brief: &Brief, at: Time<DeviceClock>) -> Time<True> {
        match brief.factor.when(at) {
            Some(at) => at,
            None => self.devices[brief.device as usize].oscillator().when(at),
        }
    }

    /// The system time of the reference clock; `None` without one.
    #[inline]
    pub fn system_time(&mut self, at: Time<True>) -> Option<ClockTime> {
        let leader = self.leader?;
        let number = leader.tick_at(at);
        let kept = &mut self.ticks[number as usize % TICKS];
        if kept.number != number {
            *kept = leader.tick(number);
        }
        Some(kept.system_time(at))
    }

    /// When a frame came back that left at `frame` and passed a SubDevice at `device_at` of its own
    /// oscillator; if it was lost, when it would have come back. `None`: there is no way back.
    #[inline]
    pub fn back(
        &mut self,
        frame: Time<True>,
        device: usize,
        device_at: Time<DeviceClock>,
    ) -> Option<Time<True>> {
        let (known, back) = self.found;
        if known == frame && !self.returns.have_copies() {
            return Some(back);
        }
        self.find(frame, device, device_at)
    }

    #[inline(never)]
    fn find(
        &mut self,
        frame: Time<True>,
        device: usize,
        device_at: Time<DeviceClock>,
    ) -> Option<Time<True>> {
        let at = self.devices[device].oscillator().when(device_at);
        match self.returns.find(frame, at) {
            Some(back) => {
                self.found = (frame, back);
                Some(back)
            }
            None => self.way_back(device).map(|way| at + way),
        }
    }

    /// Time from a SubDevice to the MainDevice, for a frame that passed the SubDevice; `None` if it
    /// has no way back.
    fn way_back(&self, device: usize) -> Option<Picos> {
        // Most segments are lines, in which places are positions.
        match self.paths[0].entries.get(device) {
            Some(entry) if entry.device == device => Some(rest(self.paths[0], entry)),
            _ => self.search(device),
        }
    }

    #[cold]
    fn search(&self, device: usize) -> Option<Picos> {
        self.paths.iter().find_map(|path| {
            let entry = path.entries.iter().find(|entry| entry.device == device)?;
            Some(rest(path, entry))
        })
    }
}

/// Time from an arrival to the end of the way.
#[inline]
fn rest(path: &Path, arrival: &Arrival) -> Picos {
    Picos(path.round_trip.0 - arrival.after.0)
}

/// Number of ticks that are kept.
const TICKS: usize = 8;
