//! The expectations of a segment file for a served segment, judged in true time at the end of the
//! service. The foreign MainDevice shuts down in order, falls silent, or restarts.

use crate::line::Line;
use isocat_maindevice::{Event, MainDevice};
use isocat_segment::{Scenario, SegmentFile};
use isocat_serve::Setup;
use isocat_sim::Expectation::{self, *};
use isocat_sim::expect::{Found, Judgement};
use isocat_sim::fault::{Moment, When};
use isocat_wire::time::{Nanos, Picos, Time};

const SEGMENT: &str = "cycle = \"1ms\"\nrecovery = { first = \"20ms\", longest = \"100ms\" }\n\
    [[subdevice]]\ndevice = \"simple_io16\"\nname = \"io\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis 1\"\n\
    [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"axis 2\"\n";

fn scenario(fault: &str) -> Scenario {
    let fault = match fault {
        "" => String::new(),
        what => format!("[[fault]]\nat = \"in-operation + 300ms\"\nwhat = \"{what}\"\n"),
    };
    let file = SegmentFile::parse("a test", &format!("{SEGMENT}{fault}"));
    Scenario::from(file.expect("a segment"))
}

/// A segment with a fault, in operation for this time.
fn in_operation(fault: &str, expectations: &[Expectation], span: Nanos) -> Line {
    let scenario = scenario(fault);
    let setup = Setup { expectations: expectations.to_vec(), ..Setup::from(&scenario) };
    let mut line = Line::with(setup, scenario.config());
    line.bring_up();
    line.run(span, |_| false);
    line
}

/// The MainDevice shuts down in order, and the service ends a second later.
fn stop(line: &mut Line) {
    line.main.stop();
    assert!(line.run(Nanos::millis(5_000), |event| matches!(event, Event::Stopped)));
    silence(line);
}

/// No frame comes for a second.
fn silence(line: &mut Line) {
    for _ in 0..10 {
        line.now += Nanos::millis(100);
        line.server.idle(line.now);
    }
}

fn judgements(line: &mut Line) -> Vec<Judgement> {
    line.server.finish(line.now);
    line.server.judgements()
}

/// The judgements if axis 2 is cut off for 200 ms.
fn with_a_cut(expectations: &[Expectation]) -> Vec<Judgement> {
    let mut line = in_operation("pull axis 2 for 200ms", expectations, Nanos::millis(4_000));
    stop(&mut line);
    judgements(&mut line)
}

/// The smallest limit in whole nanoseconds that the figure meets.
fn at_least(figure: Picos) -> Nanos {
    Nanos((figure.0 + 999) / 1_000)
}

#[test]
fn each_expectation_has_two_sides() {
    let generous = Nanos::millis(3_000);
    let during = InSyncAt(When::After(Moment::InOperation, Nanos::millis(400)));
    let measured = with_a_cut(&[
        RecoversWithin(generous),
        WorstSync0 { device: None, limit: generous },
        SafeWithin(generous),
        during,
    ]);
    let [recovered, sync0, stale, during] = &measured[..] else { panic!("{measured:?}") };
    let Found::Recovered(took) = recovered.found else { panic!("{recovered:?}") };
    let Found::Sync0 { error, .. } = sync0.found else { panic!("{sync0:?}") };
    let Found::Stale { device, age } = stale.found else { panic!("{stale:?}") };
    let Found::OutOfSync(stretch) = during.found else { panic!("{during:?}") };
    assert!(took > Picos::ZERO && error > Picos::ZERO, "{measured:?}");
    assert_eq!((device, stretch.device), (2, 2), "the one that was cut off");
    // The first whole nanosecond at which it is out of sync.
    let out = Nanos(stretch.from.count().div_ceil(1_000) as i64);
    let one = Nanos(1);
    let sides = [
        (RecoversWithin(at_least(took)), RecoversWithin(at_least(took) + -one)),
        (
            WorstSync0 { device: None, limit: at_least(error) },
            WorstSync0 { device: None, limit: at_least(error) + -one },
        ),
        (SafeWithin(at_least(age)), SafeWithin(at_least(age) + -one)),
        (InSyncAt(When::At(out + -one)), InSyncAt(When::At(out))),
        (Blames(2), Blames(1)),
        (InSync(false), InSync(true)),
    ];
    let both: Vec<_> = sides.iter().flat_map(|(met, unmet)| [*met, *unmet]).collect();
    for pair in with_a_cut(&both).chunks(2) {
        assert!(pair[0].met && !pair[1].met, "{pair:?}");
        assert!(pair.iter().all(Judgement::is_judged));
    }
}

#[test]
fn a_segment_that_is_taken_down_in_order_was_in_sync() {
    let after = |ms| InSyncAt(When::After(Moment::InOperation, Nanos::millis(ms)));
    let expectations = [InSync(true), RecoversWithin(Nanos::millis(400)), after(400), after(600)];
    let mut line = in_operation("", &expectations, Nanos::millis(500));
    stop(&mut line);
    let judged = judgements(&mut line);
    let met: Vec<_> = judged.iter().map(|judgement| judgement.met).collect();
    // Nothing had to recover.
    assert_eq!(met, [true, false, true, false], "{judged:?}");
    assert_eq!((judged[1].found, judged[3].found), (Found::NoFault, Found::RunEnded));
}

/// A run that ends with silence ends with its last frame: an expectation that needs a longer run is
/// not met.
#[test]
fn what_the_run_is_too_short_to_show_is_not_met() {
    let run = |expectations: &[Expectation]| {
        let mut line = in_operation("drop 1", expectations, Nanos::millis(400));
        silence(&mut line);
        let judged = judgements(&mut line);
        let end = line.server.sessions()[0].conduct.last;
        let fault = line.server.faults().last().expect("it happened").at;
        (judged, end - fault)
    };
    let (_, span) = run(&[]);
    let whole = Nanos(span.0 / 1_000);
    let (judged, _) = run(&[RecoversWithin(whole), RecoversWithin(whole + Nanos(1))]);
    assert!(judged[0].met && !judged[1].met, "{judged:?}");
    assert_eq!(judged[1].found, Found::RunEnded);
}

/// If frames stop in the middle, outputs must go safe; nothing else counts from then on, unless a
/// MainDevice starts again.
#[test]
fn a_main_device_that_falls_silent_leaves_outputs_to_the_watchdog() {
    let limit = Nanos::millis(100);
    let expectations = [
        RecoversWithin(limit),
        InSync(true),
        SafeWithin(Nanos::millis(100)),
        SafeWithin(Nanos::millis(110)),
        RecoversWithin(Nanos::millis(20_000)),
    ];
    let mut line = in_operation("", &expectations, Nanos::millis(300));
    silence(&mut line);
    let judged = line.server.judgements();
    let met: Vec<_> = judged.iter().map(|judgement| judgement.met).collect();
    assert_eq!(met, [false, true, false, true, false], "{judged:?}");
    assert_eq!((judged[0].found, judged[4].found), (Found::NoFault, Found::NoFault));
    // The program on the same machine is restarted.
    line.main = MainDevice::new(scenario("").config(), line.now);
    line.bring_up();
    line.run(Nanos::millis(20_000), |_| false);
    stop(&mut line);
    let judged = judgements(&mut line);
    let met: Vec<_> = judged.iter().map(|judgement| judgement.met).collect();
    assert_eq!(met, [false, true, false, true, true], "{judged:?}");
    assert!(matches!(judged[0].found, Found::OutOfSync(_)), "{judged:?}");
}

#[test]
fn what_can_not_be_judged_is_not_met() {
    let limit = Nanos::millis(100);
    let expectations = [WorstSync0 { device: Some(0), limit }, RecoversWithin(limit)];
    let judged = |fault: &str| {
        let mut line = in_operation(fault, &expectations, Nanos::millis(200));
        stop(&mut line);
        judgements(&mut line).into_iter().map(|one| (one.met, one.found)).collect::<Vec<_>>()
    };
    // The MainDevice's machine is not simulated.
    assert_eq!(judged("stall 5ms"), [(false, Found::NoEdge), (false, Found::NoFault)]);
    // The service ends 100 ms too early for this expectation.
    assert_eq!(judged("drop 1"), [(false, Found::NoEdge), (false, Found::RunEnded)]);
    // Nothing happened from which it could have recovered.
    assert_eq!(judged(""), [(false, Found::NoEdge), (false, Found::NoFault)]);
}

#[test]
fn nothing_is_met_where_no_main_device_comes() {
    let now = Time::new(1_000_000_000);
    let expectations = vec![InSync(false), InSync(true), SafeWithin(Nanos::millis(1)), Blames(0)];
    let setup = Setup { expectations, ..Setup::from(&scenario("")) };
    let mut server = isocat_serve::Server::new(setup, now);
    server.finish(now + Nanos::millis(1_000));
    for judgement in server.judgements() {
        assert_eq!((judgement.met, judgement.found), (false, Found::NeverInOperation));
    }
}
