//! Frames that consist of the datagrams of regular operation. Most ESCs take such a frame at once
//! ([`isocat_esc::Esc::pass_cyclic`]).

use isocat_wire::time::{Device as DeviceClock, Time, True};

use crate::segment::Segment;
use crate::watcher::Watcher;
use crate::wiring::MainPort;

impl Segment {
    /// Passes the present frame as [`pass_to_audience`](Self::pass_to_audience) does, to that many
    /// `visits` or to all places, if it is cyclic. `false`: it is not, and nothing was done. Where
    /// probes look it counts as none: they show what was counted up to their place.
    pub(crate) fn pass_cyclic(
        &mut self,
        (from, visits): (MainPort, Option<usize>),
        payload: &mut [u8],
        times: (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) -> bool {
        if self.datagrams.present().cyclic.is_none() || !self.probes.are_none() {
            return false;
        }
        let mut number = 0;
        while let Some((place, begin)) =
            self.take_cyclic((from, visits), &mut number, payload, times, watch)
        {
            self.answer((from, place), begin, payload, times);
        }
        self.datagrams.present_mut().add_counts(payload);
        true
    }

    /// Passes the present frame on from this number of the visits, or of all places. Returns the
    /// place of the first SubDevice that cannot take it at once, and when it arrives there.
    fn take_cyclic(
        &mut self,
        (from, visits): (MainPort, Option<usize>),
        number: &mut usize,
        payload: &mut [u8],
        (start, end): (Time<True>, Time<True>),
        watch: &mut Watcher,
    ) -> Option<(usize, Time<DeviceClock>)> {
        let Self { devices, paths, audiences, datagrams, stale, .. } = self;
        let (path, audience) = (&paths[from as usize], &mut audiences[from as usize]);
        let frame = datagrams.present_mut().cyclic.as_mut()?;
        frame.read_time(payload);
        let sent = self.copy_of.unwrap_or(start);
        let count = visits.unwrap_or(path.entries.len());
        for visit in *number..count {
            let place = visits.map_or(visit, |_| audience.visit(visit));
            let entry = path.entries[place];
            let device = &mut devices[entry.device];
            let begin = device.oscillator().read(start + entry.after);
            device.advance(begin, watch);
            *stale |= device.ports_changed();
            audience.update(place, device.esc.reach_version(), || device.esc.reach());
            if !device.pass_cyclic(begin, end + entry.after, sent, frame, place, payload) {
                *number = visit + 1;
                return Some((place, begin));
            }
        }
        None
    }
}
