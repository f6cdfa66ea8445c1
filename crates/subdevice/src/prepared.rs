//! The steps that events start, kept from one cycle to the next.
//!
//! The steps of an event and their delays follow from the mode and its settings, which do not
//! change while the device is in the cycle. A caller with enough memory keeps them here.

use isocat_sync::Event;

use crate::steps::Steps;

/// The steps that an event starts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Begins {
    pub steps: Steps,
    /// One bit for each step of the event: if one of them has not ended, none starts.
    pub wants: u8,
    /// One bit for each step that starts.
    pub starts: u8,
    /// Whether a shift is too short for the device.
    pub too_short: bool,
}

/// The event, and whether it is the last SYNC0 before SYNC1, whether outputs wait for it, and
/// whether the device is in OP. The steps depend on all of them.
type Occasion = (Event, bool, bool, bool);

/// The steps that were last started, by event: see
/// [`SubDevice::handle_event_prepared`](crate::SubDevice::handle_event_prepared).
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    version: u32,
    kept: [Option<(Occasion, Begins)>; EVENTS],
    once: Steps,
}

impl Prepared {
    /// Nothing is kept yet.
    pub const fn new() -> Self {
        Self { version: 0, kept: [None; EVENTS], once: Steps::EMPTY }
    }

    /// The steps for an occasion. They are computed now if they are not kept or have another
    /// version.
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

    /// Keeps steps for this event only.
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

/// The place of an event: a mode has steps for at most one event other than SYNC.
const fn place(event: Event) -> usize {
    match event {
        Event::Sm2 | Event::Sm3 | Event::Timer => 0,
        Event::Sync0 => 1,
        Event::Sync1 => 2,
    }
}

const EVENTS: usize = 3;
