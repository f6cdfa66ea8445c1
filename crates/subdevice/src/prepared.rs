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
pub(crate) type Occasion = (Event, bool, bool, bool);

/// The steps that were last started, by event: see
/// [`SubDevice::handle_event_prepared`](crate::SubDevice::handle_event_prepared). With each the
/// caller may keep something that it has made of them.
#[derive(Clone, Copy, Debug)]
pub struct Prepared<T> {
    version: u32,
    kept: [Option<Kept<T>>; EVENTS],
    once: Steps,
}

#[derive(Clone, Copy, Debug)]
struct Kept<T> {
    occasion: Occasion,
    begins: Begins,
    made: Option<T>,
}

/// The steps that an event starts, in their prepared form.
#[derive(Debug)]
pub struct Started<'p, T> {
    /// The steps.
    pub steps: &'p Steps,
    /// What the caller has made of them and kept here; `None` if the steps are new. The place is
    /// missing where steps are not kept.
    pub made: Option<&'p mut Option<T>>,
}

impl<T> Started<'_, T> {
    /// No steps.
    pub(crate) const NOTHING: Self = Self { steps: &Steps::EMPTY, made: None };
}

impl<T> Prepared<T> {
    /// Nothing is kept yet.
    pub const fn new() -> Self {
        Self { version: 0, kept: [const { None }; EVENTS], once: Steps::EMPTY }
    }

    /// The steps for an occasion. They are computed now if they are not kept or have another
    /// version.
    #[inline(always)]
    pub(crate) fn of(
        &mut self,
        occasion: Occasion,
        version: u32,
        find: impl FnOnce() -> Begins,
    ) -> (&Begins, &mut Option<T>) {
        if self.version != version {
            self.version = version;
            self.kept = [const { None }; EVENTS];
        }
        let kept = &mut self.kept[place(occasion.0)];
        if kept.as_ref().is_none_or(|kept| kept.occasion != occasion) {
            *kept = None;
        }
        let kept = kept.get_or_insert_with(|| Kept { occasion, begins: find(), made: None });
        (&kept.begins, &mut kept.made)
    }

    /// Keeps steps for this event only.
    pub(crate) fn keep(&mut self, steps: Steps) -> Started<'_, T> {
        self.once = steps;
        Started { steps: &self.once, made: None }
    }
}

impl<T> Default for Prepared<T> {
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
