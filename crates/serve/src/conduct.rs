//! The conduct of a MainDevice as its frames alone show it: the order of its steps, the rhythm of
//! its cycle, and the phase of its frames in the cycle.

use isocat_rules::evidence::Slide;
use isocat_rules::trail::Trail;
use isocat_sim::Statistics;
use isocat_wire::datagram::{Header, Layout, Layouts, datagrams};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, Command, frame, register};

use super::deed::Deed;

/// The times at which a step was taken, and how often.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Done {
    /// The instant of the first time.
    pub first: Time<True>,
    /// The instant of the last time.
    pub last: Time<True>,
    /// Number of datagrams.
    pub count: u64,
}

/// A sender of frames.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Source {
    /// Source address of the frames.
    pub address: [u8; 6],
    /// Number of frames.
    pub frames: u64,
}

/// Everything that is known of the MainDevice of one session.
#[derive(Clone, Debug)]
pub struct Conduct {
    /// Instant of the first frame.
    pub began: Time<True>,
    /// Instant of the last frame.
    pub last: Time<True>,
    /// Number of frames.
    pub frames: u64,
    /// Number of frames at the secondary port of a ring, which carry no further information.
    pub second_port_frames: u64,
    /// The senders of the frames; normally one. Senders beyond the size of the array are not
    /// distinguished.
    sources: [Source; 4],
    deeds: [Option<Done>; Deed::ALL.len()],
    sync_activated: bool,
    /// Whether the MainDevice checked SYNC after activating it.
    sync_seen: bool,
    /// The cyclic exchange.
    pub cycle: CycleConduct,
}

/// A logical datagram: its command as in the frame, its address, and its length.
type Logical = (u8, u32, u16);

/// The rhythm of the cyclic exchange.
#[derive(Clone, Debug, Default)]
pub struct CycleConduct {
    /// Logical datagram that marks the start of a cycle, by command and address: the first one that
    /// was exchanged, unless another one is far more frequent, as beside that of devices slower
    /// than the bus.
    marker: Option<(u8, u32)>,
    /// The first logical datagrams, each with its number.
    logical: [(Logical, u64); 16],
    /// Whether there were others.
    left_out: bool,
    last: Option<Time<True>>,
    /// Time from one cycle to the next, ps.
    pub intervals: Statistics,
    /// Phase at which cycles reach the reference clock, less that of the first, ps.
    pub phase: Statistics,
    first_phase: Option<i128>,
    /// Mean of the last few phases, relative to the first.
    recent_phase: i128,
    /// The phases of all cycles, to see whether they slide.
    trail: Trail,
    /// Instant of the last drift datagram.
    last_drift: Option<Time<True>>,
    /// Longest time without a drift datagram, counted from the first one in this exchange.
    pub drift_gap: Picos,
    /// Number of drift datagrams in this exchange.
    pub drift: u64,
    /// Number of frames that left before the program took the answer to the last one of their kind,
    /// though it had come; and number of all such frames. `None`: the program's sockets can't be
    /// seen.
    pub untaken: Option<[u64; 2]>,
}

/// The kind of a frame, for the segment's own records.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Seen {
    /// The frame carried process data.
    pub process_data: bool,
    /// The frame began a cycle.
    pub cycle: bool,
    /// The frame asked a SubDevice for this state (the lowest, if several).
    pub request: Option<AlState>,
    /// The frame wrote station addresses.
    pub addresses: bool,
    /// The SubDevice whose time the frame distributed.
    pub reference: Option<Reference>,
}

/// The clock that a drift datagram reads.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reference {
    /// By station address (FRMW).
    Station(u16),
    /// By position (ARMW).
    Position(u16),
}

impl Conduct {
    /// A session whose first frame is at `at`.
    pub fn new(at: Time<True>) -> Self {
        Self {
            began: at,
            last: at,
            frames: 0,
            second_port_frames: 0,
            sources: [Source { address: [0; 6], frames: 0 }; 4],
            deeds: [None; Deed::ALL.len()],
            sync_activated: false,
            sync_seen: false,
            cycle: CycleConduct::default(),
        }
    }

    /// Adds a frame that left the MainDevice at `at`, in the form in which it came back. `source`
    /// is its source address when it was sent.
    pub fn frame(&mut self, at: Time<True>, source: [u8; 6], bytes: &[u8]) -> Seen {
        self.last = at;
        self.frames += 1;
        self.take_source(source);
        let mut seen = Seen::default();
        let Ok(payload) = frame::payload(bytes) else { return seen };
        let mut layouts = Layouts::new();
        while let Some(Ok(layout)) = layouts.next(payload) {
            self.datagram(at, payload, &layout, &mut seen);
        }
        if seen.cycle {
            self.cycle.interval(at);
        }
        if seen.reference.is_some() {
            self.cycle.drift(at);
        }
        seen
    }

    /// Adds a frame at the secondary port, as it came back. The primary port carries the same
    /// information. Returns whether the frame carried process data.
    pub fn second_port(&mut self, bytes: &[u8]) -> bool {
        self.second_port_frames += 1;
        let Ok(payload) = frame::payload(bytes) else { return false };
        let is_logical = |header: &Header| header.command().is_ok_and(Command::is_logical);
        datagrams(payload).map_while(Result::ok).any(|datagram| is_logical(&datagram.header))
    }

    fn datagram(&mut self, at: Time<True>, payload: &[u8], layout: &Layout, seen: &mut Seen) {
        let header = &layout.header;
        let data = &payload[layout.data()..layout.wkc()];
        match header.command() {
            Ok(Command::Lrw | Command::Lrd | Command::Lwr) => {
                seen.process_data = true;
                seen.cycle |=
                    self.cycle.begins((header.command, header.address, data.len() as u16));
                self.did(Deed::ProcessData, at);
            }
            Ok(Command::Frmw) if header.ado() == register::SYSTEM_TIME.address => {
                seen.reference = Some(Reference::Station(header.adp()));
                self.did(Deed::DistributeTime, at);
            }
            Ok(Command::Armw) if header.ado() == register::SYSTEM_TIME.address => {
                // Every SubDevice has incremented the position on the way, so only the usual
                // position 0 can be taken.
                seen.reference = Some(Reference::Position(0));
                self.did(Deed::DistributeTime, at);
            }
            _ => Deed::read(header, data, |deed| {
                self.did(deed, at);
                seen.addresses |= deed == Deed::StationAddresses;
                if let Some(state) = requested(deed) {
                    seen.request = Some(seen.request.map_or(state, |other| lower(other, state)));
                }
            }),
        }
    }

    fn did(&mut self, deed: Deed, at: Time<True>) {
        match deed {
            Deed::SyncActivate => self.sync_activated = true,
            Deed::SeeSync if !self.sync_activated => return,
            Deed::SeeSync => self.sync_seen = true,
            _ => {}
        }
        let done = self.deeds[deed as usize].get_or_insert(Done { first: at, last: at, count: 0 });
        done.last = at;
        done.count += 1;
    }

    fn take_source(&mut self, address: [u8; 6]) {
        for source in &mut self.sources {
            if source.frames == 0 || source.address == address {
                *source = Source { address, frames: source.frames + 1 };
                return;
            }
        }
        self.sources[3].frames += 1;
    }

    /// The senders of the frames, those with most frames first.
    pub fn sources(&self) -> Vec<Source> {
        let mut sources: Vec<_> = self.sources.into_iter().filter(|s| s.frames > 0).collect();
        sources.sort_by_cached_key(|source| u64::MAX - source.frames);
        sources
    }

    /// The times of a deed; `None` if it was never done.
    pub fn done(&self, deed: Deed) -> Option<Done> {
        self.deeds[deed as usize]
    }

    /// All deeds, in the order in which they were first done.
    pub fn order(&self) -> Vec<(Deed, Done)> {
        let all = Deed::ALL.iter().filter_map(|deed| Some((*deed, self.done(*deed)?)));
        let mut all: Vec<_> = all.collect();
        all.sort_by_cached_key(|(_, done)| done.first.count());
        all
    }

    /// Whether the MainDevice checked SYNC after activating it; `None` if it never did so.
    pub fn sync_verified(&self) -> Option<bool> {
        self.done(Deed::SyncActivate).map(|_| self.sync_seen)
    }
}

impl CycleConduct {
    /// Notes that a cycle that left at `at` reached the reference clock at this system time, ps;
    /// `cycle` is its length.
    pub fn reached(&mut self, at: Time<True>, system_ps: i128, cycle: Nanos) {
        let cycle = i128::from(cycle.0) * 1000;
        if cycle <= 0 {
            return;
        }
        let phase = system_ps.rem_euclid(cycle);
        let first = *self.first_phase.get_or_insert(phase);
        // The offset is kept near the last few. Frames that drift through the cycle then continue
        // to grow, and a single late frame does not count as one of the next cycle.
        let offset = phase - first;
        let turns = (self.recent_phase - offset + cycle / 2).div_euclid(cycle);
        let unwrapped = offset + turns * cycle;
        self.recent_phase += (unwrapped - self.recent_phase) / 4;
        self.phase.push(unwrapped as i64);
        self.trail.take(at.count(), Picos(unwrapped as i64));
    }

    /// How frames move through the cycle of the reference clock; `None` if there are too few.
    pub fn slide(&self) -> Option<Slide> {
        self.trail.slide()
    }

    /// The longest time without a drift datagram between these instants.
    pub fn longest_drift_gap(&self, began: Time<True>, ended: Time<True>) -> Picos {
        self.drift_gap.max(ended - self.last_drift.map_or(began, |last| last.max(began)))
    }

    /// Counts a logical datagram; returns whether it marks the start of a cycle.
    fn begins(&mut self, datagram: Logical) -> bool {
        // One that is longer in some cycles is the same.
        let (command, address, _) = datagram;
        let marker = *self.marker.get_or_insert((command, address));
        let is_its = |(other, count): &(Logical, u64)| *count == 0 || *other == datagram;
        let Some(at) = self.logical.iter().position(is_its) else {
            self.left_out = true;
            return false;
        };
        self.logical[at] = (datagram, self.logical[at].1 + 1);
        if marker == (command, address) {
            return true;
        }
        let of_marker = self.number_of(marker);
        let is_far_more_frequent =
            self.number_of((command, address)) > of_marker + of_marker / 2 + 8;
        if is_far_more_frequent {
            let (logical, left_out) = (self.logical, self.left_out);
            let marker = Some((command, address));
            *self = Self { marker, logical, left_out, ..Self::default() };
        }
        is_far_more_frequent
    }

    /// The number of datagrams with this command and address, of any length.
    fn number_of(&self, (command, address): (u8, u32)) -> u64 {
        let its = |((one, other, _), _): &&(Logical, u64)| (*one, *other) == (command, address);
        self.logical.iter().filter(its).map(|(_, count)| count).sum()
    }

    /// The number of cycles, and of datagrams with this logical bit whose command is one of these;
    /// `None` if there were too many datagrams to tell.
    pub fn carried(&self, bit: u64, commands: [Command; 2]) -> Option<[u64; 2]> {
        let has = |&&((command, address, length), count): &&(Logical, u64)| {
            let first = u64::from(address) * 8;
            let works = commands.iter().any(|one| *one as u8 == command);
            count > 0 && works && (first..first + u64::from(length) * 8).contains(&bit)
        };
        let carried = self.logical.iter().filter(has).map(|(_, count)| count).sum();
        let cycles = self.number_of(self.marker?);
        (!self.left_out).then_some([cycles, carried])
    }

    /// Restarts at the start of operation; only the marker of a cycle is kept.
    pub fn restart(&mut self) {
        *self = Self { marker: self.marker, last_drift: None, ..Self::default() };
    }

    fn interval(&mut self, at: Time<True>) {
        if let Some(last) = self.last.replace(at) {
            self.intervals.push((at - last).0);
        }
    }

    fn drift(&mut self, at: Time<True>) {
        self.drift += 1;
        if let Some(last) = self.last_drift.replace(at) {
            self.drift_gap = self.drift_gap.max(at - last);
        }
    }

    /// Mean phase at which cycles leave, by the reference clock, ps.
    pub fn mean_phase(&self) -> Option<i128> {
        Some(self.first_phase? + self.phase.mean() as i128)
    }

    /// Instant of the last cycle.
    pub fn last(&self) -> Option<Time<True>> {
        self.last
    }

    /// Number of cycles since [`restart`](Self::restart), less the first.
    pub fn count(&self) -> u64 {
        self.intervals.count()
    }
}

/// The state that a deed asks for.
fn requested(deed: Deed) -> Option<AlState> {
    [AlState::Init, AlState::PreOp, AlState::Boot, AlState::SafeOp, AlState::Op]
        .into_iter()
        .find(|state| Deed::request(*state) == deed)
}

fn lower(one: AlState, other: AlState) -> AlState {
    if (one as u8) < other as u8 { one } else { other }
}

#[cfg(test)]
mod tests {
    use isocat_wire::datagram::Address;
    use isocat_wire::frame::FrameWriter;

    use super::*;

    /// Two groups in one datagram, which leaves the slower one out in every other cycle: its frames
    /// come in each cycle, and it is carried in every other one.
    #[test]
    fn a_datagram_of_another_length_begins_a_cycle_too() {
        let mut conduct = Conduct::new(Time::ZERO);
        for cycle in 0..100_u64 {
            let mut buffer = [0; 128];
            let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
            let length = if cycle.is_multiple_of(2) { 20 } else { 10 };
            let data = vec![0; length];
            writer.push(Command::Lrw, 0, Address::Logical(0x100), &data).expect("room");
            let length = writer.finish();
            conduct.frame(Time::new(cycle * 1_000_000_000), [0x10; 6], &buffer[..length]);
        }
        assert_eq!((conduct.cycle.count(), conduct.cycle.intervals.mean()), (99, 1e9));
        let carried =
            |byte: u64| conduct.cycle.carried((0x100 + byte) * 8, [Command::Lrw, Command::Lwr]);
        assert_eq!(carried(9), Some([100, 100]));
        assert_eq!((carried(10), carried(19)), (Some([100, 50]), Some([100, 50])));
        assert_eq!(carried(20), Some([100, 0]));
        let inputs = conduct.cycle.carried(0x100 * 8, [Command::Lrd, Command::Lrd]);
        assert_eq!(inputs, Some([100, 0]), "another command");
    }
}
