//! Faults of the wires of a segment while it runs: cables are pulled and plugged, SubDevices are
//! switched off and on, bits are flipped, frames are lost.
//!
//! A cable is two lines, one for each direction. A cut removes the signal of a line at once. The
//! ESC at the receiving end notices it when its link is lost; until then the other ESC sends
//! without effect. A line that is restored carries frames as soon as its receiver has a link. A
//! pulled cable cuts both of its lines, and a SubDevice without power cuts those of all its cables.
//! A line is whole again when it has no cause of a cut any more.

use std::collections::BTreeMap;

use isocat_wire::PortNumber;
use isocat_wire::time::{Time, True};

use crate::cable::Direction;
use crate::fault::frames::FrameFaults;
use crate::wiring::{End, Wiring};

/// A bit that is flipped on a cable.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BitError {
    /// The cable.
    pub cable: usize,
    /// The direction along it.
    pub direction: Direction,
    /// It hits the first frame that enters the cable at this time or later.
    pub at: Time<True>,
    /// Index of the bit in the frame, from the destination address on; modulo the frame's length.
    pub bit: usize,
}

/// One direction of a cable.
pub(crate) type Line = (usize, Direction);

/// Both lines of a cable.
pub(crate) const fn lines(cable: usize) -> [Line; 2] {
    [(cable, Direction::Out), (cable, Direction::Back)]
}

/// Why a line carries no signal.
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

/// A change of a SubDevice at an instant.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Notice {
    /// When it happens, or when its ESC notices it.
    pub at: Time<True>,
    pub device: usize,
    pub change: Change,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Change {
    /// Its ESC notices that a link was gained or lost.
    Link {
        line: Line,
        /// When the line was cut or restored.
        since: Time<True>,
        port: PortNumber,
        link: bool,
    },
    /// It gets or loses its power.
    Power(bool),
    /// Its frames to the MainDevice arrive again, or no longer.
    Way,
}

/// All faults of the cables and SubDevices of a segment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Disturbances {
    /// Every past or future change of a line, in the order of time: the line, when, and whether it
    /// is whole.
    changes: Vec<(Line, Time<True>, bool)>,
    /// The cut of each line after all announced changes.
    cuts: BTreeMap<Line, Cut>,
    /// By SubDevice: when it was last switched, and whether on.
    power: BTreeMap<usize, (Time<True>, bool)>,
    /// Changes that have not happened yet, in the order of time.
    notices: Vec<Notice>,
    /// Cuts too short for any ESC to notice: start and end.
    unnoticed: Vec<(Time<True>, Time<True>)>,
    errors: Vec<BitError>,
    /// Faults of frames on cables.
    pub frames: FrameFaults,
}

/// The cut of a line.
#[derive(Clone, Debug, Default)]
struct Cut {
    causes: Vec<Cause>,
    /// When the last cause was added or removed.
    changed: Time<True>,
    /// When the cut began.
    since: Time<True>,
    /// Whether a PHY at its end lost its power, so that even a short cut loses the link.
    unpowered: bool,
}

impl Disturbances {
    /// Adds a cause to the cut of a line. Changes of one line must come in the order of time;
    /// panics otherwise.
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

    /// Removes a cause; without any cause, the line is whole again. Panics as [`Self::cut`] does.
    pub fn restore(&mut self, wiring: &Wiring, line: Line, at: Time<True>, cause: Cause) {
        let cut = self.changed(line, at);
        let before = cut.causes.len();
        cut.causes.retain(|other| *other != cause);
        if before > 0 && cut.causes.is_empty() {
            self.change(wiring, line, at, true);
            self.changed(line, at).unpowered = false;
        }
    }

    /// The latest announced change of a line or of a SubDevice's power.
    pub fn latest_change(&self) -> Time<True> {
        let of_lines = self.cuts.values().map(|cut| cut.changed);
        let of_power = self.power.values().map(|(at, _)| *at);
        of_lines.chain(of_power).max().unwrap_or(Time::ZERO)
    }

    /// Switches a SubDevice on or off, and all its cables with it. Panics if it was switched later.
    pub fn power(&mut self, wiring: &Wiring, device: usize, at: Time<True>, on: bool) {
        assert!(device < wiring.devices(), "there is no SubDevice {device} to switch");
        let (last, is_on) = self.power.get(&device).copied().unwrap_or((Time::ZERO, true));
        assert!(last <= at, "SubDevice {device} was switched at {last:?}, after {at:?}");
        if is_on == on {
            return;
        }
        self.power.insert(device, (at, on));
        // It comes before the notices of the links that follow from it.
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

    /// Cuts or restores a line.
    fn change(&mut self, wiring: &Wiring, line: Line, at: Time<True>, whole: bool) {
        let place = self.changes.partition_point(|(_, other, _)| *other <= at);
        self.changes.insert(place, (line, at, whole));
        let (since, unpowered) =
            self.cuts.get(&line).map_or((at, false), |cut| (cut.since, cut.unpowered));
        // A change that was not noticed yet never will be, unless it is a loss that cannot be
        // hidden.
        let hidden = |notice: &Notice| match notice.change {
            Change::Link { line: other, link, .. } => {
                other == line && notice.at > at && link != whole && !(whole && unpowered)
            }
            Change::Power(_) | Change::Way => false,
        };
        let pending = self.notices.len();
        self.notices.retain(|notice| !hidden(notice));
        if self.notices.len() < pending {
            // The cut was too short for the ESC to notice.
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
        // If links are gained faster than lost, the gain still comes after the loss.
        let earliest = self.notices.iter().rfind(of_line).map_or(at, |notice| notice.at);
        match (listener, talker) {
            (End::Port(device, port), _) => {
                let change = Change::Link { line, since: at, port, link: whole };
                self.tell(Notice { at: (at + delay).max(earliest), device, change });
            }
            // No ESC receives here, but the way of frames changes.
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

    /// Flips a bit.
    pub fn disturb(&mut self, error: BitError) {
        self.errors.push(error);
    }

    /// Whether a frame that travels from `start` to `end` finds all links as the ESCs see them.
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

    /// Whether a signal passes from its first bit at `from` to its last at `to`. A signal that ends
    /// at the instant of a cut passes.
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

    /// Takes the next change that has happened by `at`; only of `device`, if one is given.
    pub fn take_notice(&mut self, at: Time<True>, device: Option<usize>) -> Option<Notice> {
        let concerns = |notice: &&Notice| device.is_none_or(|device| device == notice.device);
        let due =
            self.notices.iter().take_while(|notice| notice.at <= at).find(concerns).copied()?;
        self.notices.retain(|notice| *notice != due);
        Some(due)
    }

    /// Takes the error that hits a frame entering the cable at `at`.
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
