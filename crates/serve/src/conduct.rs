//! How a MainDevice conducts itself, seen from its frames alone: the order of its steps, the rhythm
//! of its cycle, where in the cycle its frames come.

use isocat_sim::Statistics;
use isocat_wire::datagram::{Header, Layout, Layouts, datagrams};
use isocat_wire::time::{Nanos, Picos, Time, True};
use isocat_wire::{AlState, Command, frame, register};

use super::deed::Deed;

/// When a step was first taken, and how often.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Done {
    /// The first time.
    pub first: Time<True>,
    /// The last time.
    pub last: Time<True>,
    /// Datagrams.
    pub count: u64,
}

/// Who sends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Source {
    /// Source address of its frames.
    pub address: [u8; 6],
    /// Frames.
    pub frames: u64,
}

/// All that is known of one session's MainDevice.
#[derive(Clone, Debug)]
pub struct Conduct {
    /// First frame.
    pub began: Time<True>,
    /// Last frame.
    pub last: Time<True>,
    /// Frames.
    pub frames: u64,
    /// Frames at the secondary port of a ring, which tell nothing new.
    pub second_port_frames: u64,
    /// Who sent them; one, if all is well. More than there is room for are not told apart.
    sources: [Source; 4],
    deeds: [Option<Done>; Deed::ALL.len()],
    sync_activated: bool,
    /// Somebody looked at SYNC afterwards.
    sync_seen: bool,
    /// Cyclic exchange.
    pub cycle: CycleConduct,
}

/// The rhythm of the cyclic exchange.
#[derive(Clone, Debug, Default)]
pub struct CycleConduct {
    /// Logical address that begins a cycle: the first one that was exchanged.
    marker: Option<u32>,
    last: Option<Time<True>>,
    /// From one cycle to the next, ps.
    pub intervals: Statistics,
    /// When cycles reach the reference clock, less the phase of the first: ps.
    pub phase: Statistics,
    first_phase: Option<i128>,
    /// A mean of the last few phases, relative to the first.
    recent_phase: i128,
    /// Since the last drift datagram.
    last_drift: Option<Time<True>>,
    /// Longest time without a drift datagram between the first in this exchange and now.
    pub drift_gap: Picos,
    /// Drift datagrams in this exchange.
    pub drift: u64,
}

/// What a frame was, for the segment's own bookkeeping.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Seen {
    /// It carried process data.
    pub process_data: bool,
    /// It began a cycle.
    pub cycle: bool,
    /// It asked a SubDevice for this state (the lowest, if several).
    pub request: Option<AlState>,
    /// It gave station addresses.
    pub addresses: bool,
    /// Station (or, by position, the number) whose time it distributed.
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
    /// A session that begins with a frame at `at`.
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

    /// A frame that left the MainDevice at `at`, as it came back: `source` is its source address as
    /// it was sent.
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

    /// A frame at the secondary port, as it came back: what it has in it the primary port says too.
    /// Tells whether it carried process data.
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
                seen.cycle |= *self.cycle.marker.get_or_insert(header.address) == header.address;
                self.did(Deed::ProcessData, at);
            }
            Ok(Command::Frmw) if header.ado() == register::SYSTEM_TIME.address => {
                seen.reference = Some(Reference::Station(header.adp()));
                self.did(Deed::DistributeTime, at);
            }
            Ok(Command::Armw) if header.ado() == register::SYSTEM_TIME.address => {
                // Every SubDevice counted it up on the way; only position 0 is common, and certain.
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

    /// Who sent the frames, most first.
    pub fn sources(&self) -> Vec<Source> {
        let mut sources: Vec<_> = self.sources.into_iter().filter(|s| s.frames > 0).collect();
        sources.sort_by_key(|source| std::cmp::Reverse(source.frames));
        sources
    }

    /// What was done of a deed.
    pub fn done(&self, deed: Deed) -> Option<Done> {
        self.deeds[deed as usize]
    }

    /// All that was done, in the order in which it was first done.
    pub fn order(&self) -> Vec<(Deed, Done)> {
        let all = Deed::ALL.iter().filter_map(|deed| Some((*deed, self.done(*deed)?)));
        let mut all: Vec<_> = all.collect();
        all.sort_unstable_by_key(|(deed, done)| (done.first, *deed as usize));
        all
    }

    /// Whether anybody looked at SYNC after it was activated; `None` if it never was.
    pub fn sync_verified(&self) -> Option<bool> {
        self.done(Deed::SyncActivate).map(|_| self.sync_seen)
    }
}

impl CycleConduct {
    /// When a cycle reached the reference clock: its system time, ps, and the cycle.
    pub fn reached(&mut self, system_ps: i128, cycle: Nanos) {
        let cycle = i128::from(cycle.0) * 1000;
        if cycle <= 0 {
            return;
        }
        let phase = system_ps.rem_euclid(cycle);
        let first = *self.first_phase.get_or_insert(phase);
        // In the neighbourhood of the last few, so that frames that wander through the cycle go on
        // growing, and a single late one does not seem to be of the next cycle.
        let offset = phase - first;
        let turns = (self.recent_phase - offset + cycle / 2).div_euclid(cycle);
        let unwrapped = offset + turns * cycle;
        self.recent_phase += (unwrapped - self.recent_phase) / 4;
        self.phase.push(unwrapped as i64);
    }

    /// Forgets what was, at the beginning of operation; what begins a cycle is kept.
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

    /// Cycles since [`restart`](Self::restart), less the first.
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
