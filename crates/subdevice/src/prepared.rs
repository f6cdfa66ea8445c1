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

impl Begins {
    const NONE: Self = Self { steps: Steps::EMPTY, wants: 0, starts: 0, too_short: false };
}

/// All that the steps of an event depend on, within one version of the settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Occasion {
    pub event: Event,
    /// It is the last SYNC0 before SYNC1.
    pub last_sync0: bool,
    /// Outputs wait for the event.
    pub new_outputs: bool,
    /// The device is in OP.
    pub op: bool,
}

/// The steps that were last started, by event: see
/// [`SubDevice::handle_event_prepared`](crate::SubDevice::handle_event_prepared). With each the
/// caller may keep something that it has made of them.
#[derive(Clone, Debug)]
pub struct Prepared<T> {
    kept: [Kept<T>; EVENTS],
}

#[derive(Clone, Debug)]
struct Kept<T> {
    /// See [`Occasion::number`].
    occasion: u8,
    version: u32,
    begins: Begins,
    made: Option<T>,
}

impl<T> Kept<T> {
    const NONE: Self = Self { occasion: NOTHING, version: 0, begins: Begins::NONE, made: None };
}

/// A place of [`Prepared`].
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Place(u8);

impl<T> Prepared<T> {
    /// Nothing is kept yet.
    pub const fn new() -> Self {
        Self { kept: [const { Kept::NONE }; EVENTS] }
    }

    /// The steps for an occasion, and their place. They are computed now if they are not kept or
    /// have another version.
    #[inline(always)]
    pub(crate) fn of(
        &mut self,
        occasion: Occasion,
        version: u32,
        find: impl FnOnce() -> Begins,
    ) -> (&Begins, Place) {
        let (occasion, place) = (occasion.number(), occasion.place());
        let kept = &mut self.kept[usize::from(place.0)];
        if kept.version != version || kept.occasion != occasion {
            *kept = Kept { occasion, version, begins: find(), made: None };
        }
        (&kept.begins, place)
    }

    /// The steps that are kept at this place.
    pub fn steps(&self, place: Place) -> &Steps {
        &self.kept[usize::from(place.0)].begins.steps
    }

    /// What the caller has made of the steps that are kept at this place; `None` if they are new.
    #[inline]
    pub fn made(&self, place: Place) -> Option<&T> {
        self.kept[usize::from(place.0)].made.as_ref()
    }

    /// Keeps something that was made of these steps.
    pub fn keep_made(&mut self, place: Place, made: T) {
        self.kept[usize::from(place.0)].made = Some(made);
    }
}

impl<T> Default for Prepared<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl Occasion {
    /// A number that no other occasion has; it is not [`NOTHING`].
    #[inline(always)]
    const fn number(self) -> u8 {
        let Self { event, last_sync0, new_outputs, op } = self;
        let flags = (last_sync0 as u8) << 1 | (new_outputs as u8) << 2 | (op as u8) << 3;
        1 | flags | (event as u8) << 4
    }

    /// A mode has steps for at most one event other than SYNC. The timer of Free Run comes with and
    /// without new outputs in turn, if it is faster than the frames.
    #[inline(always)]
    const fn place(self) -> Place {
        Place(match self.event {
            Event::Timer if !self.new_outputs => 4,
            Event::Sm2 | Event::Sm3 | Event::Timer => 0,
            Event::Sync0 if self.last_sync0 => 3,
            Event::Sync0 => 1,
            Event::Sync1 => 2,
        })
    }
}

const EVENTS: usize = 5;
/// The occasion of a place at which no steps are kept.
const NOTHING: u8 = 0;
