//! Stages of a segment, from its way up to its end.

use std::fmt;

use isocat_maindevice as maindevice;

/// The stage of a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stage {
    /// Nothing was done yet.
    Begin,
    /// Our MainDevice brings it up.
    Up(maindevice::Stage),
    /// A served segment: no frames come.
    NoMainDevice,
    /// A served segment: an external MainDevice brings it up.
    BroughtUp,
    /// All requested SubDevices are in OP.
    InOperation,
    /// It has ended, so that nothing more follows.
    Ended,
}

impl Stage {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Begin => "begin",
            Self::Up(stage) => stage.name(),
            Self::NoMainDevice => "no MainDevice sends",
            Self::BroughtUp => "a MainDevice brings it up",
            Self::InOperation => "in operation",
            Self::Ended => "ended",
        }
    }

    /// The stage of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        let own =
            [Self::Begin, Self::NoMainDevice, Self::BroughtUp, Self::InOperation, Self::Ended];
        let all = own.into_iter().chain(maindevice::Stage::ALL.map(Self::Up));
        let mut named = all.filter(|stage| stage.name() == name);
        named.next()
    }
}

/// Its name.
impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
