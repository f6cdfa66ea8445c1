//! Each [`Event`] as an event of `tracing`, with the feature of that name, for programs that log by
//! it.
//!
//! The target is `isocat::maindevice`, the level says how bad the event is, and the field `event`
//! has its figures. A MainDevice has no clock of its own, so the subscriber's clock stamps it.

use tracing::{Level, debug, error, info, warn};

use crate::event::Event;

/// Target of all events.
const TARGET: &str = "isocat::maindevice";

/// Passes an event on.
pub(crate) fn event(event: &Event) {
    match level(event) {
        Level::ERROR => error!(target: TARGET, ?event),
        Level::WARN => warn!(target: TARGET, ?event),
        Level::INFO => info!(target: TARGET, ?event),
        _ => debug!(target: TARGET, ?event),
    }
}

/// An error ends the work, a warning is a fault of the segment or of the host, and answers to
/// requests are for debugging.
fn level(event: &Event) -> Level {
    use Event::*;
    match event {
        Failed(_) => Level::ERROR,
        StateChanged { status, .. } if status.error() => Level::WARN,
        ClocksUnled { cycles: 0 } => Level::INFO,
        Drift { expected, found, .. } if expected == found => Level::INFO,
        WorkingCounter { .. }
        | Drift { .. }
        | DelayUnknown { .. }
        | DelayChanged { .. }
        | Alarm(_)
        | ClocksUnled { .. }
        | LeftOut { .. }
        | Lost { .. }
        | NotReadmitted { .. }
        | Unplanned { .. }
        | ReferenceLost { .. }
        | RingCut { .. }
        | ClocksSplit { .. }
        | NotRecovered { .. }
        | CountChanged { .. }
        | FrameLost { .. }
        | CyclesSkipped { .. }
        | Emergency { .. }
        | Dropped { .. } => Level::WARN,
        Progress(_)
        | WorkingCounterRestored { .. }
        | DelayRestored { .. }
        | Found { .. }
        | Readmitted { .. }
        | ReferenceElected { .. }
        | RingHealed { .. }
        | Recovering { .. }
        | Recovered { .. }
        | Phase { .. }
        | InOperation { .. }
        | Surveyed
        | Stopped => Level::INFO,
        StateChanged { .. } | Uploaded { .. } | Downloaded { .. } | Read { .. } => Level::DEBUG,
    }
}

#[cfg(test)]
mod tests {
    use alloc::sync::Arc;
    use std::string::String;
    use std::sync::Mutex;
    use std::vec::Vec;
    use std::{fmt, format};

    use tracing::field::{Field, Visit};
    use tracing::span::{Attributes, Id, Record};
    use tracing::subscriber::with_default;
    use tracing::{Metadata, Subscriber};

    use super::*;
    use crate::board::Board;

    /// Keeps level, target and figures of each event.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<(Level, String, String)>>>);

    struct Figures(String);

    impl Visit for Figures {
        fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
            self.0 += &format!("{}={value:?}", field.name());
        }
    }

    impl Subscriber for Log {
        fn enabled(&self, _: &Metadata<'_>) -> bool {
            true
        }
        fn new_span(&self, _: &Attributes<'_>) -> Id {
            Id::from_u64(1)
        }
        fn record(&self, _: &Id, _: &Record<'_>) {}
        fn record_follows_from(&self, _: &Id, _: &Id) {}
        fn event(&self, event: &tracing::Event<'_>) {
            let mut figures = Figures(String::new());
            event.record(&mut figures);
            let meta = event.metadata();
            let entry = (*meta.level(), meta.target().into(), figures.0);
            self.0.lock().expect("no thread panicked").push(entry);
        }
        fn enter(&self, _: &Id) {}
        fn exit(&self, _: &Id) {}
    }

    #[test]
    fn what_is_reported_is_traced_with_its_figures() {
        let log = Log::default();
        with_default(log.clone(), || {
            let mut board = Board::new();
            board.report(Event::Lost { position: 2, cycle: 40 });
            board.report(Event::Drift { cycle: 41, expected: 3, found: 2 });
            board.report(Event::Drift { cycle: 42, expected: 3, found: 3 });
            assert_eq!(board.poll_event(), Some(Event::Lost { position: 2, cycle: 40 }));
        });
        let log = log.0.lock().expect("no thread panicked");
        let told: Vec<_> = log.iter().map(|(level, _, figures)| (*level, &**figures)).collect();
        assert_eq!(
            told,
            [
                (Level::WARN, "event=Lost { position: 2, cycle: 40 }"),
                (Level::WARN, "event=Drift { cycle: 41, expected: 3, found: 2 }"),
                (Level::INFO, "event=Drift { cycle: 42, expected: 3, found: 3 }"),
            ]
        );
        assert!(log.iter().all(|(_, target, _)| target == TARGET));
    }
}
