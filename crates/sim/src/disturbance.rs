//! What happens to the wires of a segment while it runs: cables are pulled and plugged, SubDevices are switched
//! off and on, bits tip over, frames get lost.
//!
//! A cable is two lines, one each way. A cut takes the signal of a line away at once; the ESC that listens at
//! its end finds out when its link goes, and until then the other one sends into nothing. A line that is
//! whole again carries frames as soon as its listener has a link. A pulled cable cuts both of its lines, and a
//! SubDevice without power those of all its cables; each is whole again when nothing cuts it any more.

use std::collections::BTreeMap;

use isocat_wire::PortNumber;
use isocat_wire::time::{Time, True};

use crate::cable::Direction;
use crate::fault::frames::FrameFaults;
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

/// One way along a cable.
pub(crate) type Line = (usize, Direction);

/// Both lines of a cable.
pub(crate) const fn lines(cable: usize) -> [Line; 2] {
    [(cable, Direction::Out), (cable, Direction::Back)]
}

/// Why a line carries nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Cause {
    /// The cable is pulled.
    Pulled,
    /// A wire of this line is broken.
    Broken,
    /// The port of the MainDevice at its end is down.
    NoPort,
    /// The SubDevice at one of its ends has no power.
    NoPower(usize),
}

/// Something that happens to a SubDevice at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Notice {
    /// When it does, or when its ESC knows.
    pub at: Time<True>,
    pub device: usize,
    pub change: Change,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Change {
    /// Its ESC notices that a link has come or gone.
    Link {
        line: Line,
        /// When the line was cut or restored.
        since: Time<True>,
        port: PortNumber,
        link: bool,
    },
    /// It gets power, or loses it.
    Power(bool),
    /// What it sends to the MainDevice gets there again, or no longer.
    Way,
}

/// All that happens to the cables and SubDevices of a segment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Disturbances {
    /// Every change of a line there was or will be, in the order of time: which, when, whole.
    changes: Vec<(Line, Time<True>, bool)>,
    /// What cuts each line after everything that has been told of it.
    cuts: BTreeMap<Line, Cut>,
    /// By SubDevice: when it was switched last, and whether on.
    power: BTreeMap<usize, (Time<True>, bool)>,
    /// What has not happened yet, in the order of time.
    notices: Vec<Notice>,
    /// Breaks too short for any ESC to notice: from, to.
    unnoticed: Vec<(Time<True>, Time<True>)>,
    errors: Vec<BitError>,
    /// What happens to frames on cables.
    pub frames: FrameFaults,
}

/// What cuts a line.
#[derive(Clone, Debug, Default)]
struct Cut {
    causes: Vec<Cause>,
    /// When the last cause came or went.
    changed: Time<True>,
    /// When it became a cut.
    since: Time<True>,
    /// A PHY at its end lost its power, so that the link is lost however short the cut is.
    unpowered: bool,
}

impl Disturbances {
    /// A line gets a reason to carry nothing. Changes of one line must come in the order of time; panics otherwise.
    pub fn cut(&mut self, wiring: &Wiring, line: Line, at: Time<True>, cause: Cause) {
        let cut = self.changed(line, at);
        if cut.causes.contains(&cause) {
            return;
        }
        let first = cut.causes.is_empty();
        cut.causes.push(cause);
        cut.unpowered |= matches!(cause, Cause::NoPower(_));
        if first {
            cut.since = at;
            self.change(wiring, line, at, false);
        }
    }

    /// A reason goes away; with the last one, the line is whole again. Panics as [`Self::cut`] does.
    pub fn restore(&mut self, wiring: &Wiring, line: Line, at: Time<True>, cause: Cause) {
        let cut = self.changed(line, at);
        let before = cut.causes.len();
        cut.causes.retain(|other| *other != cause);
        if before > 0 && cut.causes.is_empty() {
            self.change(wiring, line, at, true);
            self.changed(line, at).unpowered = false;
        }
    }

    /// The last instant for which a change of a line or of a SubDevice's power was told.
    pub fn latest_change(&self) -> Time<True> {
        let of_lines = self.cuts.values().map(|cut| cut.changed);
        let of_power = self.power.values().map(|(at, _)| *at);
        of_lines.chain(of_power).max().unwrap_or(Time::ZERO)
    }

    /// Switches a SubDevice on or off, and with it all its cables. Panics if it was switched later.
    pub fn power(&mut self, wiring: &Wiring, device: usize, at: Time<True>, on: bool) {
        assert!(device < wiring.devices(), "there is no SubDevice {device} to switch");
        let (last, is_on) = self.power.get(&device).copied().unwrap_or((Time::ZERO, true));
        assert!(last <= at, "SubDevice {device} was switched at {last:?}, after {at:?}");
        if is_on == on {
            return;
        }
        self.power.insert(device, (at, on));
        // It stands before the notices of the links that follow from it.
        self.tell(Notice { at, device, change: Change::Power(on) });
        let ports = PortNumber::ALL.into_iter();
        let cables = ports.filter_map(|port| wiring.hop(End::Port(device, port)));
        for line in cables.flat_map(|hop| lines(hop.cable)) {
            match on {
                true => self.restore(wiring, line, at, Cause::NoPower(device)),
                false => self.cut(wiring, line, at, Cause::NoPower(device)),
            }
        }
    }

    fn changed(&mut self, line: Line, at: Time<True>) -> &mut Cut {
        let cut = self.cuts.entry(line).or_default();
        let last = cut.changed;
        assert!(last <= at, "cable {} was changed at {last:?}, after {at:?}", line.0);
        cut.changed = at;
        cut
    }

    /// A line is cut, or whole again.
    fn change(&mut self, wiring: &Wiring, line: Line, at: Time<True>, whole: bool) {
        let place = self.changes.partition_point(|(_, other, _)| *other <= at);
        self.changes.insert(place, (line, at, whole));
        let (since, unpowered) =
            self.cuts.get(&line).map_or((at, false), |cut| (cut.since, cut.unpowered));
        // What was not noticed yet will not be, unless it is a loss that nothing can hide.
        let hidden = |notice: &Notice| match notice.change {
            Change::Link { line: other, link, .. } => {
                other == line && notice.at > at && link != whole && !(whole && unpowered)
            }
            Change::Power(_) | Change::Way => false,
        };
        let pending = self.notices.len();
        self.notices.retain(|notice| !hidden(notice));
        if self.notices.len() < pending {
            // It was too short for the ESC to notice.
            if whole {
                self.unnoticed.push((since, at));
            }
            return;
        }
        let (cable, direction) = line;
        let (properties, [near, far]) = wiring.cable(cable);
        let (talker, listener) =
            if direction == Direction::Out { (near, far) } else { (far, near) };
        let delay = if whole { properties.link_gain } else { properties.link_loss };
        let of_line = |notice: &&Notice| matches!(notice.change, Change::Link { line: other, .. } if other == line);
        // Where links are gained sooner than lost, still behind the loss.
        let earliest = self.notices.iter().rfind(of_line).map_or(at, |notice| notice.at);
        match (listener, talker) {
            (End::Port(device, port), _) => {
                let change = Change::Link { line, since: at, port, link: whole };
                self.tell(Notice { at: (at + delay).max(earliest), device, change });
            }
            // No ESC listens, but the way of frames is another.
            (End::Main(_), End::Port(device, _)) => {
                self.tell(Notice { at, device, change: Change::Way });
            }
            (End::Main(_), End::Main(_)) => {}
        }
    }

    fn tell(&mut self, notice: Notice) {
        let place = self.notices.partition_point(|other| other.at <= notice.at);
        self.notices.insert(place, notice);
    }

    /// Lets a bit tip over.
    pub fn disturb(&mut self, error: BitError) {
        self.errors.push(error);
    }

    /// Whether a frame that is on its way from `start` to `end` finds everything as the ESCs believe it
    /// is.
    pub fn are_quiet(&self, start: Time<True>, end: Time<True>) -> bool {
        let calm = |notice: &Notice| match notice.change {
            Change::Link { link: false, since, .. } => since > end,
            _ => notice.at > end,
        };
        self.notices.iter().all(calm)
            && self.unnoticed.iter().all(|(from, to)| *from > end || *to <= start)
            && self.errors.iter().all(|error| error.at > end)
            && !self.frames.are_any()
    }

    /// Whether a signal comes through from its first bit at `from` to its last at `to`. What ends at the
    /// very instant of a cut has come through.
    pub fn carries(&self, line: Line, from: Time<True>, to: Time<True>) -> bool {
        let mut carries = true;
        for (_, at, plugged) in self.changes.iter().filter(|(other, ..)| *other == line) {
            if *at <= from {
                carries = *plugged;
            } else if *at < to {
                carries &= *plugged;
            }
        }
        carries
    }

    /// The next thing that has happened by `at`; to `device` alone, if one is given.
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
