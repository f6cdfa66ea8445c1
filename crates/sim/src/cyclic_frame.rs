//! Frames that consist of the datagrams of regular operation. Most ESCs take such a frame at once
//! ([`isocat_esc::Esc::pass_cyclic`]).

use isocat_esc::CyclicFrame;

use crate::audience::Item;
use crate::segment::Segment;

impl Segment {
    /// Finds out whether the present frame is one. Where probes look it counts as none: they show
    /// what was counted up to their place.
    pub(crate) fn find_cyclic(&mut self, items: &[Item]) {
        let datagrams = items.iter().map(|item| (item.command, item.layout));
        let frame = if self.probes.are_none() { CyclicFrame::of(datagrams) } else { None };
        self.cyclic = frame;
    }

    /// Adds the working counter increments of the ESCs that took it at once.
    pub(crate) fn count_cyclic(&mut self, items: &mut [Item]) {
        let Some(frame) = &mut self.cyclic else { return };
        for (number, count) in frame.take_counts() {
            if let Some(item) = items.get_mut(number) {
                item.wkc = item.wkc.wrapping_add(count);
            }
        }
    }
}
