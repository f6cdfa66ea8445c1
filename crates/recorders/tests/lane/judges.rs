//! Judges get one record of each regular cycle if nothing else observes the run, and each event
//! otherwise. Both must lead to the same judgement. A run with faults follows the course of each
//! SubDevice, for which it needs all events, so here scenarios with faults run without a course.

use isocat_maindevice::{Event, Motion};
use isocat_segment::{Scenario, SegmentFile};
use isocat_sim::fault::Happened;
use isocat_sim::{Tap, World, run};
use isocat_wire::Nanos;
use isocat_wire::time::{Picos, Time};

use crate::{number, scenarios, try_each};

/// A tap that observes all events, or none.
struct Onlooker {
    observes: bool,
}

impl Tap for Onlooker {
    fn frame(&mut self, _: Time<isocat_wire::time::True>, _: bool, _: &[u8]) {}
    fn fault(&mut self, _: &Happened) {}
    fn observes(&self) -> bool {
        self.observes
    }
}

/// What judges have found at the end of a scenario; `None`: it does not get into operation.
fn judged(scenario: &Scenario, onlooker: Option<Onlooker>) -> Option<String> {
    let run = scenario.run();
    let (limit, duration) = (run.sync0_limit, Picos::from(run.duration));
    let mut world = World::new(run.setup, Motion::default(), onlooker);
    let end = Time::ZERO + Picos::from(Nanos::millis(20_000));
    loop {
        let more = world.step(end);
        while let Some(event) = world.poll_event() {
            if matches!(event, Event::InOperation { .. }) {
                let intent = run::intent(world.main(), limit);
                world.catch_up();
                world.begin_judging(intent);
            }
        }
        let is_judged = world.bench.intent().is_some();
        if is_judged || !more {
            if !is_judged {
                return None;
            }
            break;
        }
    }
    let end = world.now() + duration;
    while world.step(end) {
        while world.poll_event().is_some() {}
    }
    Some(format!("{:?}", world.end_judging()))
}

fn try_one(name: &str, text: &str) -> Result<bool, String> {
    let Ok(file) = SegmentFile::parse("random.toml", text) else { return Ok(false) };
    let mut scenario = Scenario::from(file);
    scenario.duration = scenario.duration.max(Nanos(scenario.cycle.0 * 40));
    scenario.force = true;
    let seen = judged(&scenario, Some(Onlooker { observes: true }));
    let [unseen, alone] =
        [Some(Onlooker { observes: false }), None].map(|it| judged(&scenario, it));
    if seen != unseen || seen != alone {
        let which = (seen != unseen, seen != alone);
        return Err(format!(
            "{name} is judged otherwise where nobody looks on, {which:?}:\n{text}"
        ));
    }
    Ok(seen.is_some())
}

#[test]
fn brief_events_are_judged_as_all_events_are() {
    let (from, count) = (number("ISOCAT_SEGMENTS_FROM", 0), number("ISOCAT_SEGMENTS", 24));
    let all: Vec<_> = (from..from + count)
        .map(|number| (format!("scenario {number}"), scenarios::scenario(number)))
        .collect();
    let (judged, failures) = try_each(&all, try_one);
    println!("{judged} of {} got into operation, {} differ", all.len(), failures.len());
    assert!(failures.is_empty(), "{}", failures.join("\n\n"));
    assert!(judged * 3 >= all.len(), "{judged} of {} got into operation", all.len());
}
