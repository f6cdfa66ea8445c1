//! Translates events of the simulation into terms of synchronization: the one place that knows
//! both.

use isocat_sim::observation::Observed;
use isocat_sync::{Moment, Step};

/// The moment of the cycle that was observed; `None` if the event is none of a cycle.
pub fn of(event: Observed) -> Option<Moment> {
    Some(match event {
        Observed::Sm2 => Moment::Sm2,
        Observed::Sm3 => Moment::Sm3,
        Observed::Sync0 => Moment::Sync0,
        Observed::Sync1 => Moment::Sync1,
        Observed::Began(Step::MapOutputs) => Moment::OutputsFetched,
        Observed::Finished(Step::MapOutputs) => Moment::OutputsReady,
        Observed::Began(Step::Application) => Moment::ApplicationBegins,
        Observed::Finished(Step::Application) => Moment::ApplicationEnds,
        Observed::Began(Step::OutputsValid) => Moment::OutputsValid,
        Observed::Began(Step::LatchInputs) => Moment::InputLatch,
        Observed::Began(Step::MapInputs) => Moment::InputsBegin,
        Observed::Finished(Step::MapInputs) => Moment::InputsAvailable,
        Observed::Finished(Step::OutputsValid | Step::LatchInputs)
        | Observed::StillActive(_)
        | Observed::Acknowledged(_)
        | Observed::Sampled(_)
        | Observed::SmEventMissed(_)
        | Observed::OutputsSafe
        | Observed::State(..) => return None,
    })
}
