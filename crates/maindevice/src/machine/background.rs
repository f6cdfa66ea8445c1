//! What runs beside the cycle: one list of kinds, and what becomes of each when.
//!
//! A kind that is added here needs an answer to each question below, or it does not compile: when there is work for it
//! ([`MainDevice::is_due`]), what that work is ([`MainDevice::work_on`]), and when it ends ([`Kind::ends`]). Its procedures
//! are in [`Procedures`](super::procedures::Procedures) with all others. So the machine is quiet exactly if there are no
//! procedures and nothing is due.

use isocat_wire::al::{AlState, AlStatus};

use super::way::Activity;
use super::{MainDevice, in_hand};
use crate::readmit::Keeper;

/// Declares the kinds, and a list of all.
macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident,)*) => {
        /// Kinds of procedures, in the order in which they go on.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub(super) enum Kind { $($(#[$doc])* $kind,)* }

        impl Kind {
            /// All of them.
            pub(super) const ALL: [Self; [$(Kind::$kind),*].len()] = [$(Kind::$kind),*];
        }
    };
}

kinds! {
    /// Reads an entry of an object in the background.
    Entry,
    /// Accesses an object that the application asked for.
    Request,
    /// Reads memory that the application asked for.
    Read,
    /// Looks at the states of all SubDevices.
    Look,
    /// Sets delays right when frames take another way.
    Shift,
    /// Takes up SubDevices that are back.
    Readmit,
    /// Brings back a SubDevice that left OP.
    Recover,
    /// Writes a delay that was measured anew.
    Rewrite,
    /// Latches receive times, to measure delays.
    Latch,
    /// Reads the registers of clocks.
    Clocks,
}

/// What ends a procedure before it is through. What comes later ends all that the earlier ones end.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Ends {
    /// A SubDevice is lost: frames take another way.
    Way,
    /// The way down begins.
    Operation,
    /// Nothing more is sent.
    Run,
}

impl Kind {
    /// When it ends at the latest.
    pub(super) const fn ends(self) -> Ends {
        match self {
            Kind::Rewrite | Kind::Latch | Kind::Clocks => Ends::Way,
            Kind::Entry | Kind::Request | Kind::Look => Ends::Operation,
            Kind::Shift | Kind::Readmit | Kind::Recover => Ends::Operation,
            Kind::Read => Ends::Run,
        }
    }
}

/// What runs beside the cycle.
impl MainDevice {
    /// Lets everything go on that can.
    pub(super) fn work(&mut self) {
        in_hand(&mut self.shared).port.forget_waits();
        if self.is_quiet() {
            return;
        }
        self.lend(|machine| {
            machine.work_on_way();
            if machine.is_only_on_the_way() {
                return;
            }
            for kind in Kind::ALL {
                machine.work_on(kind);
            }
        });
    }

    /// Whether the way up or down is all that goes on: nothing of the background begins then, but requests that wait and
    /// clocks that are doubted.
    fn is_only_on_the_way(&self) -> bool {
        !matches!(self.activity, Activity::Operating)
            && self.procedures.is_empty()
            && self.jobs.is_empty()
            && !self.cycle.as_ref().is_some_and(|cycle| cycle.doubts_clocks())
    }

    /// Lets procedures at what they share with the machine while `f` runs.
    pub(super) fn lend<R>(&mut self, f: impl FnOnce(&mut Self) -> R) -> R {
        if let Some(shared) = self.shared.take() {
            self.link.lay_back(shared);
        }
        let result = f(self);
        self.shared = Some(self.link.take());
        result
    }

    /// Whether nothing but the cycle runs.
    fn is_quiet(&self) -> bool {
        matches!(self.activity, Activity::Operating)
            && !self.stopping
            && self.procedures.is_empty()
            && !Kind::ALL.iter().any(|kind| self.is_due(*kind))
    }

    /// Whether there is something to begin, in operation.
    #[inline]
    fn is_due(&self, kind: Kind) -> bool {
        match kind {
            Kind::Request => !self.jobs.is_empty(),
            Kind::Look => {
                self.checked.is_some()
                    || self.cycle.as_ref().is_none_or(|cycle| {
                        cycle.al_status != AlStatus::new(AlState::Op).0
                            || cycle.answering() != cycle.present()
                    })
            }
            Kind::Shift => self.cycle.as_ref().is_none_or(|cycle| cycle.doubts_clocks()),
            Kind::Latch => {
                let now = self.shared().port.now;
                self.delay_watch.as_ref().is_some_and(|watch| watch.due(now))
            }
            // Entries are read with clocks.
            Kind::Clocks => self.has_quality_to_look_at(),
            // Begun at once by who asks for it, or by what another one found.
            Kind::Entry | Kind::Read | Kind::Readmit | Kind::Recover | Kind::Rewrite => false,
        }
    }

    /// Goes on with what is under way, and begins what is due.
    fn work_on(&mut self, kind: Kind) {
        match kind {
            Kind::Entry => self.work_on_entry(),
            Kind::Request => self.work_on_requests(),
            Kind::Read => self.work_on_reads(),
            Kind::Look => self.work_on_looks(),
            Kind::Shift => self.work_on_shift(),
            Kind::Readmit => self.work_on_returns(),
            Kind::Recover => self.work_on_recoveries(),
            Kind::Rewrite => self.work_on_rewriting(),
            Kind::Latch => self.work_on_latches(),
            Kind::Clocks => self.work_on_quality(),
        }
    }

    /// Ends what ends with this. Object accesses are answered.
    pub(super) fn end_background(&mut self, with: Ends) {
        self.delay_watch = None;
        let ended = self.procedures.end(with);
        if with >= Ends::Operation {
            self.keeper = Keeper::default();
            self.refuse_all(&ended);
        }
    }
}
