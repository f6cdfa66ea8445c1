//! What events start, kept from one cycle to the next.
//!
//! Which steps an event starts, and when each is due, follows from the mode and its settings, and these stay as they are while
//! the device is in the cycle. A caller that has the memory keeps the answer here.

use isocat_sync::Event;

use crate::steps::Steps;

/// The steps that an event starts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Begins {
    pub steps: Steps,
    /// One bit a step of the event: if one of them is still under way, none starts.
    pub wants: u8,
    /// One bit a step that starts.
    pub starts: u8,
    /// A shift is too short for the device.
    pub too_short: bool,
}

/// What an event starts also depends on this: it is the last SYNC0 before SYNC1, outputs wait for it, the device is in OP.
type Occasion = (Event, bool, bool, bool);

/// What was started last, by event: see
/// [`SubDevice::handle_event_prepared`](crate::SubDevice::handle_event_prepared).
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    version: u32,
    kept: [Option<(Occasion, Begins)>; EVENTS],
    once: Steps,
}

impl Prepared {
    /// Nothing yet.
    pub const fn new() -> Self {
        Self { version: 0, kept: [None; EVENTS], once: Steps::EMPTY }
    }

    /// What is kept for an occasion, found out now if it is not there or of another version.
    #[inline]
    pub(crate) fn of(
        &mut self,
        occasion: Occasion,
        version: u32,
        find: impl FnOnce() -> Begins,
    ) -> &Begins {
        if self.version != version {
            self.version = version;
            self.kept = [None; EVENTS];
        }
        let kept = &mut self.kept[place(occasion.0)];
        if kept.as_ref().is_none_or(|(of, _)| *of != occasion) {
            *kept = None;
        }
        &kept.get_or_insert_with(|| (occasion, find())).1
    }

    /// Steps that hold for this one event.
    pub(crate) fn keep(&mut self, steps: Steps) -> &Steps {
        self.once = steps;
        &self.once
    }
}

impl Default for Prepared {
    fn default() -> Self {
        Self::new()
    }
}

/// A mode has steps for one event beside SYNC at most.
const fn place(event: Event) -> usize {
    match event {
        Event::Sm2 | Event::Sm3 | Event::Timer => 0,
        Event::Sync0 => 1,
        Event::Sync1 => 2,
    }
}

const EVENTS: usize = 3;
