//! Changes of the segment while it runs: SubDevices lost and re-admitted, changes of the reference
//! clock, cuts of a ring.

use alloc::format;
use core::fmt;

use isocat_wire::time::Nanos;

use crate::error::Cause;
use crate::event::Event;

crate::kinds! {
    /// A change of a SubDevice or of the segment. A run with such a change did not have the same
    /// conditions throughout.
    #[derive(Clone, PartialEq, Eq, Debug)]
    pub enum SegmentChange {
        /// The SubDevice no longer answers at its station address.
        Lost = "lost" {
            /// Cycle in which the loss was noticed.
            cycle: u64,
        },
        /// The SubDevice failed during bring-up, and the others run without it.
        LeftOut = "left-out" {
            /// What went wrong.
            cause: Cause,
        },
        /// The SubDevice was lost or absent, and is in OP again.
        Admitted = "admitted" {
            /// Cycle.
            cycle: u64,
            /// Host time since it was found.
            after: Nanos,
        },
        /// The SubDevice was found but cannot be admitted.
        NotAdmitted = "not-admitted" {
            /// The reason.
            cause: Cause,
        },
        /// The SubDevice had left OP and was brought back.
        Recovered = "recovered" {
            /// Host time that the recovery took.
            after: Nanos,
            /// Whether it was led through INIT, since acknowledging its error did not help.
            through_init: bool,
        },
        /// The SubDevice had left OP and could not be brought back.
        NotRecovered = "not-recovered" {
            /// The reason.
            cause: Cause,
        },
        /// The clock of the SubDevice is the reference clock from this cycle on.
        ReferenceElected = "reference-elected" {
            /// Cycle.
            cycle: u64,
        },
        /// The ring is cut.
        RingCut = "ring-cut" {
            /// The last position that the primary port reaches; null: the port itself.
            primary: Option<usize>,
            /// The first position that the secondary port reaches; null: the port itself.
            secondary: Option<usize>,
            /// Cycle in which the cut was noticed.
            cycle: u64,
        },
        /// The clock of the SubDevice is the reference for the clocks behind the cut of a ring.
        ClocksSplit = "clocks-split" {
            /// Cycle.
            cycle: u64,
        },
        /// The ring is whole again.
        RingHealed = "ring-healed" {
            /// Cycle.
            cycle: u64,
        },
        /// The SubDevices that answer are not those of the scan.
        Unplanned = "unplanned" {
            /// SubDevices that answer.
            found: u16,
        },
    }
}

impl SegmentChange {
    /// The change that an event reports, with the position of the SubDevice; `None` for other
    /// events.
    pub fn of(event: &Event) -> Option<(Option<usize>, Self)> {
        Some(match event {
            Event::Lost { position, cycle } => (Some(*position), Self::Lost { cycle: *cycle }),
            Event::LeftOut { position, cause, .. } => {
                (Some(*position), Self::LeftOut { cause: cause.clone() })
            }
            Event::Readmitted { position, cycle, after } => {
                (Some(*position), Self::Admitted { cycle: *cycle, after: *after })
            }
            Event::NotReadmitted { position, cause, .. } => {
                (Some(*position), Self::NotAdmitted { cause: cause.clone() })
            }
            Event::Recovered { position, after, through_init } => {
                let (after, through_init) = (*after, *through_init);
                (Some(*position), Self::Recovered { after, through_init })
            }
            Event::NotRecovered { position, cause, .. } => {
                (Some(*position), Self::NotRecovered { cause: cause.clone() })
            }
            Event::ReferenceElected { position, cycle } => {
                (Some(*position), Self::ReferenceElected { cycle: *cycle })
            }
            Event::RingCut { cycle, between: (primary, secondary) } => {
                (None, Self::RingCut { primary: *primary, secondary: *secondary, cycle: *cycle })
            }
            Event::ClocksSplit { position, cycle } => {
                (Some(*position), Self::ClocksSplit { cycle: *cycle })
            }
            Event::RingHealed { cycle } => (None, Self::RingHealed { cycle: *cycle }),
            Event::Unplanned { found, .. } => (None, Self::Unplanned { found: *found }),
            _ => return None,
        })
    }

    /// Whether the change ends a fault.
    pub fn is_good(&self) -> bool {
        matches!(self, Self::Admitted { .. } | Self::Recovered { .. } | Self::RingHealed { .. })
    }

    /// Whether a SubDevice was lost or admitted, or left out from the start.
    pub fn is_move(&self) -> bool {
        matches!(self, Self::Lost { .. } | Self::Admitted { .. } | Self::LeftOut { .. })
    }
}

/// `admitted in cycle 1200, 48 ms after it was found`
impl fmt::Display for SegmentChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let milliseconds = |time: &Nanos| time.0 / 1_000_000;
        match self {
            Self::Lost { cycle } => write!(f, "lost in cycle {cycle}"),
            Self::LeftOut { cause } => write!(f, "left out: {cause}"),
            Self::Admitted { cycle, after } => {
                let after = milliseconds(after);
                write!(f, "admitted in cycle {cycle}, {after} ms after it was found")
            }
            Self::NotAdmitted { cause } => write!(f, "not admitted: {cause}"),
            Self::Recovered { after, through_init } => {
                write!(f, "brought back to OP in {} ms", milliseconds(after))?;
                match through_init {
                    true => {
                        write!(f, ", through INIT: it kept its error when that was acknowledged")
                    }
                    false => Ok(()),
                }
            }
            Self::NotRecovered { cause } => write!(f, "not brought back to OP: {cause}"),
            Self::ReferenceElected { cycle } => {
                write!(f, "leads the clocks from cycle {cycle} on")
            }
            Self::RingCut { primary, secondary, cycle } => {
                let end = |position: &Option<usize>, port: &str| {
                    position.map_or(format!("the {port} port"), |at| format!("SubDevice {at}"))
                };
                let (from, to) = (end(primary, "primary"), end(secondary, "secondary"));
                write!(f, "ring cut between {from} and {to}, seen in cycle {cycle}")
            }
            Self::ClocksSplit { cycle } => {
                write!(f, "leads the clocks behind the cut from cycle {cycle} on")
            }
            Self::RingHealed { cycle } => write!(f, "ring whole from cycle {cycle} on"),
            Self::Unplanned { found } => {
                write!(f, "{found} SubDevices answer, which is not the tree of the scan")
            }
        }
    }
}
