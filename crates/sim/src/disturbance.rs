//! What happens to cables while the segment runs: they are pulled and plugged, and bits tip over.
//!
//! A cut takes the signal away at once; the ESCs at both ends find out when their link goes, and
//! until then they send into nothing. A cable plugged in again carries frames as soon as both ends have
//! a link.

use isocat_wire::PortNumber;
use isocat_wire::time::{Time, True};

use crate::cable::Direction;
use crate::wiring::{End, Wiring};

/// A bit that tips over on a cable.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BitError {
    /// The cable.
    pub cable: usize,
    /// The way along it.
    pub direction: Direction,
    /// It hits the first frame that sets out over the cable then or later.
    pub at: Time<True>,
    /// Which bit of the frame, counted from the destination address; modulo its length.
    pub bit: usize,
}

/// A change that an ESC notices at a port.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Notice {
    cable: usize,
    /// When the cable was pulled or plugged.
    since: Time<True>,
    /// When the ESC knows.
    pub at: Time<True>,
    pub device: usize,
    pub port: PortNumber,
    pub link: bool,
}

/// All that happens to the cables of a segment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Disturbances {
    /// Every change there was or will be, in the order of time: cable, when, plugged.
    changes: Vec<(usize, Time<True>, bool)>,
    /// What no ESC has noticed yet, in the order of time.
    notices: Vec<Notice>,
    /// Breaks too short for any ESC to notice: from, to.
    unnoticed: Vec<(Time<True>, Time<True>)>,
    errors: Vec<BitError>,
}

impl Disturbances {
    /// Pulls or plugs a cable. Changes of one cable must come in the order of time; panics otherwise.
    pub fn change(&mut self, wiring: &Wiring, cable: usize, at: Time<True>, plugged: bool) {
        let last = self.changes.iter().rfind(|(other, ..)| *other == cable);
        let (since, now) =
            last.map_or((Time::ZERO, true), |(_, since, plugged)| (*since, *plugged));
        assert!(since <= at, "cable {cable} was changed at {since:?}, after {at:?}");
        if now == plugged {
            return;
        }
        let place = self.changes.partition_point(|(_, other, _)| *other <= at);
        self.changes.insert(place, (cable, at, plugged));
        let pending = self.notices.len();
        self.notices.retain(|notice| notice.cable != cable || notice.at <= at);
        if self.notices.len() < pending {
            // It was too short for the ESCs to notice.
            if plugged {
                self.unnoticed.push((since, at));
            }
            return;
        }
        let (properties, ends) = wiring.cable(cable);
        let delay = if plugged { properties.link_gain } else { properties.link_loss };
        for end in ends {
            let End::Port(device, port) = end else { continue };
            let notice = Notice { cable, since: at, at: at + delay, device, port, link: plugged };
            let place = self.notices.partition_point(|other| other.at <= notice.at);
            self.notices.insert(place, notice);
        }
    }

    /// Lets a bit tip over.
    pub fn disturb(&mut self, error: BitError) {
        self.errors.push(error);
    }

    /// Whether a frame that is on its way from `start` to `end` finds everything as the ESCs believe it
    /// is.
    pub fn are_quiet(&self, start: Time<True>, end: Time<True>) -> bool {
        let calm = |notice: &Notice| if notice.link { notice.at > end } else { notice.since > end };
        self.notices.iter().all(calm)
            && self.unnoticed.iter().all(|(from, to)| *from > end || *to <= start)
            && self.errors.iter().all(|error| error.at > end)
    }

    /// Whether a signal comes through from its first bit at `from` to its last at `to`. What ends at the
    /// very instant of a cut has come through.
    pub fn carries(&self, cable: usize, from: Time<True>, to: Time<True>) -> bool {
        let mut carries = true;
        for (_, at, plugged) in self.changes.iter().filter(|(other, ..)| *other == cable) {
            if *at <= from {
                carries = *plugged;
            } else if *at < to {
                carries &= *plugged;
            }
        }
        carries
    }

    /// The next change that an ESC has noticed by `at`; of `device` alone, if one is given.
    pub fn take_notice(&mut self, at: Time<True>, device: Option<usize>) -> Option<Notice> {
        let concerns = |notice: &&Notice| device.is_none_or(|device| device == notice.device);
        let due =
            self.notices.iter().take_while(|notice| notice.at <= at).find(concerns).copied()?;
        self.notices.retain(|notice| *notice != due);
        Some(due)
    }

    /// The error that hits a frame that sets out at `at`.
    pub fn take_error(
        &mut self,
        cable: usize,
        direction: Direction,
        at: Time<True>,
    ) -> Option<BitError> {
        let hits = |e: &BitError| (e.cable, e.direction) == (cable, direction) && e.at <= at;
        let number = self.errors.iter().position(hits)?;
        Some(self.errors.swap_remove(number))
    }
}
