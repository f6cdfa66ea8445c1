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
#[derive(Clone, Debug)]
pub struct Prepared<T> {
    version: u32,
    kept: [Option<Kept<T>>; EVENTS],
    once: Steps,
}

#[derive(Clone, Debug)]
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
    /// Where it is kept: see [`Prepared::made`].
    pub place: Place,
}

/// A place of [`Prepared`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Place(u8);

impl<T> Started<'_, T> {
    /// No steps.
    pub(crate) const NOTHING: Self = Self { steps: &Steps::EMPTY, made: None, place: Place(0) };
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
    ) -> (&Begins, &mut Option<T>, Place) {
        if self.version != version {
            self.version = version;
            self.kept = [const { None }; EVENTS];
        }
        let place = place(occasion);
        let kept = &mut self.kept[usize::from(place.0)];
        if kept.as_ref().is_none_or(|kept| kept.occasion != occasion) {
            *kept = None;
        }
        let kept = kept.get_or_insert_with(|| Kept { occasion, begins: find(), made: None });
        (&kept.begins, &mut kept.made, place)
    }

    /// What the caller has made of the steps that are kept at this place.
    #[inline]
    pub fn made(&self, place: Place) -> Option<&T> {
        self.kept.get(usize::from(place.0))?.as_ref()?.made.as_ref()
    }

    /// Keeps steps for this event only.
    pub(crate) fn keep(&mut self, steps: Steps) -> Started<'_, T> {
        self.once = steps;
        Started { steps: &self.once, made: None, place: Place(0) }
    }
}

impl<T> Default for Prepared<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// The place of an occasion: a mode has steps for at most one event other than SYNC.
const fn place((event, last_sync0, _, _): Occasion) -> Place {
    Place(match event {
        Event::Sm2 | Event::Sm3 | Event::Timer => 0,
        Event::Sync0 if last_sync0 => 3,
        Event::Sync0 => 1,
        Event::Sync1 => 2,
    })
}

const EVENTS: usize = 4;
