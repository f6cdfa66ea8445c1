//! Procedures in addition to the cycle: one list of kinds, with the start and the end of each.
//!
//! A new kind needs an answer to each question below, or it does not compile: when there is work
//! for it ([`MainDevice::is_due`]), what that work is ([`MainDevice::work_on`]), and when it ends
//! ([`Kind::ends`]). Its procedures are in [`Procedures`](super::procedures::Procedures) with all
//! others. So the machine is quiet exactly if there are no procedures and nothing is due.

use isocat_wire::al::{AlState, AlStatus};

use super::way::Activity;
use super::{MainDevice, in_hand};
use crate::readmit::Keeper;

/// Declares the kinds and a list of all kinds.
macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident,)*) => {
        /// Kinds of procedures, in the order in which they are polled.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub(super) enum Kind { $($(#[$doc])* $kind,)* }

        impl Kind {
            /// All kinds.
            pub(super) const ALL: [Self; [$(Kind::$kind),*].len()] = [$(Kind::$kind),*];

            /// Whether something holds for any kind. Each is a constant for the compiler, so that
            /// no kind costs more than its own question.
            #[inline(always)]
            fn any(holds: impl Fn(Self) -> bool) -> bool {
                false $(|| holds(Self::$kind))*
            }
        }
    };
}

kinds! {
    /// Reads an entry of an object in the background.
    Entry,
    /// Accesses an object on request of the application.
    Request,
    /// Reads memory on request of the application.
    Read,
    /// Reads the states of all SubDevices.
    Look,
    /// Corrects delays when frames take another way.
    Shift,
    /// Re-admits SubDevices that are back.
    Readmit,
    /// Brings back a SubDevice that left OP.
    Recover,
    /// Writes a delay that was measured again.
    Rewrite,
    /// Latches receive times, to measure delays.
    Latch,
}

/// What ends a procedure early. A later level also ends all that the earlier levels end.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Ends {
    /// A SubDevice is lost, so frames take another way.
    Way,
    /// The shutdown begins.
    Operation,
    /// Nothing more is sent.
    Run,
}

impl Kind {
    /// The first level that ends it.
    pub(super) const fn ends(self) -> Ends {
        match self {
            Kind::Rewrite | Kind::Latch => Ends::Way,
            Kind::Entry | Kind::Request | Kind::Look => Ends::Operation,
            Kind::Shift | Kind::Readmit | Kind::Recover => Ends::Operation,
            Kind::Read => Ends::Run,
        }
    }

    /// Whether its procedures are started at once by the code that needs them, so that there is
    /// nothing to do without one.
    const fn starts_elsewhere(self) -> bool {
        matches!(self, Self::Entry | Self::Read | Self::Readmit | Self::Recover | Self::Rewrite)
    }
}

/// The procedures in addition to the cycle.
impl MainDevice {
    /// Polls all procedures and starts those that are due.
    #[inline]
    pub(super) fn work(&mut self) {
        in_hand(&mut self.shared).port.forget_waits();
        if !self.is_quiet() {
            self.work_on_all();
        } else if self.quality.is_some() {
            self.watch();
        }
    }

    #[inline(never)]
    fn work_on_all(&mut self) {
        self.lend(|machine| {
            machine.work_on_way();
            if machine.is_only_on_the_way() {
                return;
            }
            for kind in Kind::ALL {
                if machine.procedures.has(kind) || !kind.starts_elsewhere() {
                    machine.work_on(kind);
                }
            }
        });
        // States may have changed.
        self.work_on_quality();
    }

    /// Whether only the bring-up or the shutdown runs. Then no procedure of the background starts,
    /// except for waiting requests and clocks whose delays are in doubt.
    fn is_only_on_the_way(&self) -> bool {
        !matches!(self.activity, Activity::Operating)
            && self.procedures.is_empty()
            && self.jobs.is_empty()
            && !self.cycle.as_ref().is_some_and(|cycle| cycle.doubts_clocks())
    }

    /// Makes the shared data available to procedures while `f` runs.
    pub(super) fn lend<R>(&mut self, f: impl FnOnce(&mut Self) -> R) -> R {
        if let Some(shared) = self.shared.take() {
            self.link.lay_back(shared);
        }
        let result = f(self);
        self.shared = Some(self.link.take());
        result
    }

    /// Whether only the cycle runs.
    #[inline]
    fn is_quiet(&self) -> bool {
        matches!(self.activity, Activity::Operating)
            && !self.stopping
            && self.procedures.is_empty()
            && !Kind::any(|kind| self.is_due(kind))
    }

    /// Whether a procedure of this kind is to start, in operation.
    #[inline(always)]
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
            // These start elsewhere.
            Kind::Entry | Kind::Read | Kind::Readmit | Kind::Recover | Kind::Rewrite => false,
        }
    }

    /// Continues procedures of this kind, and starts those that are due.
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
        }
    }

    /// Ends all procedures of this level. Object accesses get their answer.
    pub(super) fn end_background(&mut self, with: Ends) {
        self.delay_watch = None;
        let Self { shared, link, reads, .. } = self;
        match shared {
            Some(shared) => reads.end(&mut shared.port),
            None => link.with(|shared| reads.end(&mut shared.port)),
        }
        let ended = self.procedures.end(with);
        if with >= Ends::Operation {
            self.keeper = Keeper::default();
            self.refuse_all(&ended);
        }
    }
}
