//! Frames of a cycle that follow each other pass the segment together.
//!
//! A frame meets a SubDevice as the frames before it have left it, and no frame meets another one.
//! So it makes no difference whether one frame after the other passes all SubDevices, or all frames
//! pass one SubDevice after the other; but the second way comes to each of them once in a cycle,
//! which is what a long segment costs.

use isocat_esc::CyclicFrame;
use isocat_wire::frame;
use isocat_wire::time::{Nanos, Picos, Time, True};

use crate::audience::Audience;
use crate::buffer::Buffer;
use crate::datagrams::{Datagrams, Item};
use crate::device::Device;
use crate::flight::duration;
use crate::oscillator::Oscillator;
use crate::path::{Fellow, Stations};
use crate::segment::{Lost, Returned, Segment, answer};
use crate::watcher::Watcher;
use crate::wiring::MainPort;

/// A frame that leaves the MainDevice together with others.
#[derive(Debug)]
pub struct Leaving {
    /// The frame.
    pub frame: Buffer,
    /// When its first bit leaves.
    pub start: Time<True>,
    /// What becomes of it.
    pub fate: Result<Returned, Lost>,
    /// When it arrived at the SubDevice that is followed.
    pub(crate) arrived: Time<True>,
    /// Where its datagrams are kept, and where they lie in the frame.
    list: usize,
    offset: usize,
    /// The frame of these datagrams, while it crosses the segment.
    cyclic: CyclicFrame,
}

impl Leaving {
    /// A frame whose first bit leaves at `start`.
    pub fn new(frame: Buffer, start: Time<True>) -> Self {
        Self {
            frame,
            start,
            fate: Err(Lost::Circulates),
            arrived: Time::NEVER,
            list: 0,
            offset: 0,
            cyclic: CyclicFrame::default(),
        }
    }

    /// Takes the frame from its list, or gives it back.
    fn swap_cyclic(&mut self, datagrams: &mut Datagrams) {
        if let Some(frame) = &mut datagrams.at(self.list).cyclic {
            std::mem::swap(&mut self.cyclic, frame);
        }
    }
}

/// What is kept from burst to burst.
#[derive(Default, Debug)]
pub(crate) struct Burst {
    /// The numbers of the frames.
    numbers: Vec<u64>,
    /// The visits that are known, how many of them hold, and where those of the present frames
    /// are.
    known: Vec<Visits>,
    held: usize,
    present: usize,
    /// The changes of the audience when they were found.
    changes: u64,
    fellows: Vec<Fellow>,
    /// Number of frames that passed together.
    passed: u64,
}

/// The visits of the frames with these numbers, by place and then in the order of the frames.
#[derive(Default, Debug)]
struct Visits {
    numbers: Vec<u64>,
    all: Vec<Visit>,
}

/// As many as there are cycles with other frames, where groups have cycles of their own.
const MOST_KNOWN: usize = 16;

/// One frame at one place.
#[derive(Clone, Copy, Debug)]
struct Visit {
    place: u32,
    frame: u16,
    /// The frame only collects AL status there.
    looks: bool,
}

impl Burst {
    /// Called when other places may be visited.
    pub fn forget(&mut self) {
        self.held = 0;
    }

    /// Finds the visits of the frames, if they are not known.
    fn find_visits(
        &mut self,
        frames: &[Leaving],
        datagrams: &mut Datagrams,
        audience: &mut Audience,
        places: usize,
    ) {
        if self.changes != audience.changes() {
            (self.changes, self.held) = (audience.changes(), 0);
        }
        let mut held = self.known[..self.held].iter();
        if let Some(place) = held.position(|visits| visits.numbers == self.numbers) {
            self.present = place;
            return;
        }
        self.present =
            if self.held < MOST_KNOWN { self.held } else { (self.present + 1) % MOST_KNOWN };
        self.held = self.held.max(self.present + 1);
        if self.known.len() < self.held {
            self.known.push(Visits::default());
        }
        let Visits { numbers, all } = &mut self.known[self.present];
        numbers.clone_from(&self.numbers);
        all.clear();
        for (frame, leaving) in (0..).zip(frames) {
            let list = datagrams.at(leaving.list);
            let some = audience.gather_some(&list.items);
            let brings_time = list.cyclic.as_ref().is_some_and(CyclicFrame::brings_time);
            if brings_time || list.items.iter().any(Item::concerns_all) {
                let mut some = some.iter().copied().peekable();
                all.extend((0..places as u32).map(|place| {
                    let looks = some.next_if_eq(&place).is_none() && !brings_time;
                    Visit { place, frame, looks }
                }));
            } else {
                let visit = |place: &u32| Visit { place: *place, frame, looks: false };
                all.extend(some.iter().map(visit));
            }
        }
        all.sort_unstable_by_key(|visit| (visit.place, visit.frame));
    }
}

impl Segment {
    /// Passes frames that leave a port one behind the other, as
    /// [`pass_from`](Segment::pass_from) does with one after the other; [`fate`](Leaving::fate)
    /// says what became of each.
    pub fn pass_all(&mut self, from: MainPort, frames: &mut [Leaving], watch: &mut Watcher) {
        if self.pass_together(from, frames, None, watch) {
            return;
        }
        for leaving in frames {
            let (bytes, start) = (leaving.frame.frame_mut(), leaving.start);
            leaving.fate = self.pass_from(from, bytes, start, watch);
        }
    }

    /// The same, if all frames are cyclic and nothing comes in their way; SubDevice after SubDevice
    /// takes all of them. `followed`: the SubDevice whose arrivals are noted; it must be the one
    /// that sends the system time. `false`: nothing was done.
    pub(crate) fn pass_together(
        &mut self,
        from: MainPort,
        frames: &mut [Leaving],
        followed: Option<usize>,
        watch: &mut Watcher,
    ) -> bool {
        let [first, .., last] = &*frames else { return false };
        let (start, end) = (first.start, last.start);
        self.settle(start, watch);
        if !self.is_free(from, start, end) || !self.read_all(from, frames) {
            return false;
        }
        if followed.is_some_and(|followed| !self.is_sender(from, frames, followed)) {
            return false;
        }
        self.cross(from, frames, followed, watch);
        self.finish_all(from, frames);
        self.last_frame = Some((from, end));
        self.burst.passed += frames.len() as u64;
        true
    }

    /// Lets the frames that were read cross the segment.
    fn cross(
        &mut self,
        from: MainPort,
        frames: &mut [Leaving],
        followed: Option<usize>,
        watch: &mut Watcher,
    ) {
        let Self { devices, paths, audiences, datagrams, ports, burst, stale, .. } = self;
        let (path, audience) = (&mut paths[from as usize], &mut audiences[from as usize]);
        burst.find_visits(frames, datagrams, audience, path.entries.len());
        let Burst { known, present, fellows, .. } = burst;
        fellows.clear();
        for leaving in &mut *frames {
            leaving.swap_cyclic(datagrams);
            let bytes = leaving.frame.frame();
            fellows.push(Fellow::new(leaving.start, duration(bytes.len())));
            leaving.cyclic.read_time(&bytes[leaving.offset..]);
        }
        let looks_ahead = !watch.keeps_everything();
        let mut crossing = Crossing {
            devices,
            audience,
            datagrams,
            stale,
            visits: &known[*present].all,
            frames,
            followed,
            looks_ahead,
            watch,
        };
        path.time_all(fellows, ports, &mut crossing);
    }

    /// Writes into the frames what was counted separately, and notes when they are back.
    fn finish_all(&mut self, from: MainPort, frames: &mut [Leaving]) {
        let Self { paths, audiences, datagrams, burst, returns, .. } = self;
        let places = paths[from as usize].entries.len();
        let marks = audiences[from as usize].marks_frames(places);
        let Some(port) = paths[from as usize].end else { return };
        for (leaving, fellow) in frames.iter_mut().zip(&burst.fellows) {
            leaving.swap_cyclic(datagrams);
            let list = datagrams.at(leaving.list);
            let bytes = leaving.frame.frame_mut();
            if marks {
                bytes[6] |= frame::LOCALLY_ADMINISTERED;
            }
            let payload = &mut bytes[leaving.offset..];
            list.add_counts(payload);
            list.write_counts(payload, places);
            let (first_bit, last_bit) = (fellow.at, fellow.at + fellow.duration);
            returns.note(leaving.start, leaving.start, last_bit);
            leaving.fate = Ok(Returned { port, first_bit, last_bit, good: true });
        }
    }

    /// Whether this SubDevice sends the system time in those of the frames that bring it.
    fn is_sender(&mut self, from: MainPort, frames: &[Leaving], device: usize) -> bool {
        let entries = &self.paths[from as usize].entries;
        let Some(place) = entries.iter().position(|entry| entry.device == device) else {
            return false;
        };
        let Self { devices, datagrams, .. } = self;
        frames.iter().all(|leaving| {
            let frame = &datagrams.at(leaving.list).cyclic;
            let frame = frame.as_ref().filter(|frame| frame.brings_time());
            frame.is_none_or(|frame| devices[device].esc.sends_time_of(frame, place))
        })
    }

    /// Whether frames that leave a port from `start` until `end` find the segment as it is, and
    /// nothing looks at them on their way.
    fn is_free(&self, from: MainPort, start: Time<True>, end: Time<True>) -> bool {
        let (path, audience) = (&self.paths[from as usize], &self.audiences[from as usize]);
        // By far later than the last one is back.
        let back = end + (path.round_trip + path.round_trip) + Picos::from(Nanos::millis(1));
        let is_whole = path.end.is_some() && path.processed_first && !path.entries.is_empty();
        let is_calm = !self.unsettled && audience.restless() == 0 && !audience.stops_circulating();
        let is_unseen = self.probes.are_none() && !self.probes.are_in_cables();
        self.lane
            && is_whole
            && is_calm
            && is_unseen
            && !self.next_frame.exists()
            && self.copy_of.is_none()
            && self.disturbances.are_quiet(start, back)
    }

    /// Reads the datagrams of all frames. `false`: a frame is not cyclic, or like another one.
    fn read_all(&mut self, from: MainPort, frames: &mut [Leaving]) -> bool {
        let numbers = &mut self.burst.numbers;
        numbers.clear();
        for leaving in frames {
            self.datagrams.read(from, leaving.frame.frame());
            let Some(list) = self.datagrams.place() else { return false };
            let datagrams = self.datagrams.present();
            let (Some(offset), Some(frame)) = (datagrams.offset, &datagrams.cyclic) else {
                return false;
            };
            if numbers.contains(&frame.number()) {
                return false;
            }
            numbers.push(frame.number());
            (leaving.list, leaving.offset) = (list, offset);
        }
        true
    }

    /// Number of frames that passed together with others.
    pub fn passed_together(&self) -> u64 {
        self.burst.passed
    }
}

/// Frames on their way through the segment.
struct Crossing<'a> {
    devices: &'a mut [Device],
    audience: &'a mut Audience,
    datagrams: &'a mut Datagrams,
    stale: &'a mut bool,
    /// The visits that are to come.
    visits: &'a [Visit],
    frames: &'a mut [Leaving],
    followed: Option<usize>,
    /// Whether a frame that only collects AL status may leave a SubDevice alone. Its events are
    /// reported later then, so it may not where all events are observed.
    looks_ahead: bool,
    watch: &'a mut Watcher,
}

impl Stations for Crossing<'_> {
    fn oscillator(&self, device: usize) -> &Oscillator {
        self.devices[device].oscillator()
    }

    #[inline(always)]
    fn entered(&mut self, place: usize, device: usize, fellows: &[Fellow]) {
        if self.followed == Some(device) {
            for (leaving, fellow) in self.frames.iter_mut().zip(fellows) {
                leaving.arrived = fellow.at;
            }
        }
        while let Some((visit, more)) = self.visits.split_first()
            && visit.place as usize == place
        {
            self.visits = more;
            self.visit(*visit, device, &fellows[usize::from(visit.frame)]);
        }
    }
}

impl Crossing<'_> {
    #[inline(always)]
    fn visit(&mut self, visit: Visit, device: usize, fellow: &Fellow) {
        let Self { devices, audience, datagrams, stale, watch, .. } = self;
        let place = visit.place as usize;
        let device = &mut devices[device];
        let leaving = &mut self.frames[usize::from(visit.frame)];
        let begin = device.oscillator().read(fellow.at);
        if visit.looks
            && self.looks_ahead
            && let Some(status) = device.look_ahead(begin)
        {
            return leaving.cyclic.collect(status);
        }
        device.advance(begin, watch);
        **stale |= device.ports_changed();
        audience.update(place, device.esc.reach_version(), || device.esc.reach());
        let payload = &mut leaving.frame.frame_mut()[leaving.offset..];
        let (frame, end) = (&mut leaving.cyclic, fellow.at + fellow.duration);
        if !device.pass_cyclic(begin, end, fellow.start, frame, place, payload) {
            let list = datagrams.at(leaving.list);
            let latches =
                answer((device, audience, place), begin, (list, payload), (fellow.start, end));
            debug_assert!(!latches, "a cyclic frame writes no receive times");
            frame.read_time(payload);
        }
    }
}
