//! Pictures are well-formed, contain the figures, and keep labels apart.

use isocat_engine::recording::series::Series;
use isocat_engine::timeline::{Moment, Timeline};
use isocat_wire::time::Picos;

use isocat_descriptions::quantity::time;

use super::*;

fn well_formed(picture: &Picture) {
    for text in
        [picture.file(), picture.svg().replace("<svg", "<svg xmlns=\"http://www.w3.org/2000/svg\"")]
    {
        if let Err(error) = roxmltree::Document::parse(&text) {
            panic!("{error}\n{text}");
        }
        assert!(!text.contains("NaN") && !text.contains("inf\""), "{text}");
    }
}

#[test]
fn times_have_all_their_digits() {
    for (ns, text) in [
        (0.0, "0 ns"),
        (-0.0001, "0 ns"),
        (12.5, "12.5 ns"),
        (438_240.0, "438.24 us"),
        (1e6, "1 ms"),
        (-5_012.0, "-5.012 us"),
        (2.5e9, "2.5 s"),
    ] {
        assert_eq!(time(ns), text);
    }
    assert_eq!(cycle::ns(-5_012.2), "-5.013 us", "a margin is rounded to the bad side");
    assert_eq!(cycle::ns(438_240.9), "438.24 us");
}

#[test]
fn words_of_users_are_no_markup() {
    let nodes = [topology::Node {
        name: "<script>\"&\u{7}".into(),
        parent: None,
        port: None,
        leads: true,
        bad: false,
        delay: Some(0.0),
        delay_error: None,
        tip: "a > b".into(),
    }];
    let picture = topology::draw("a \"tree\"", &nodes);
    well_formed(&picture);
    assert!(!picture.file().contains("<script"));
}

#[test]
fn labels_do_not_lie_on_each_other() {
    let mut frame = Frame::new("a", "a", 0.0, 100.0);
    frame.lane("lane", 40.0);
    assert!(frame.label("", 50.0, 20.0, Align::Start, "first"));
    assert!(!frame.label("", 50.5, 20.0, Align::Start, "second"), "it would be upon the first");
    assert!(frame.label("", 50.5, 34.0, Align::Start, "another row"));
    assert!(frame.label("", 80.0, 20.0, Align::Start, "far"));
    let picture = frame.finish();
    well_formed(&picture);
    assert!(picture.body.contains("first") && !picture.body.contains("second"));
}

#[test]
fn a_series_is_drawn_with_its_limit_if_that_is_near() {
    let mut series = Series::new(16);
    for at in 0..100 {
        series.push(Picos(at * 1_000_000), if at == 50 { 90_000 } else { 1_000 });
    }
    let marks = [(50_000.0, "here".to_owned())];
    let chart = |limit| series::Chart {
        id: "s",
        title: "s",
        series: &series,
        limit: Some(limit),
        marks: &marks,
        span: (0.0, 100_000.0),
    };
    let near = chart(100_000).draw().expect("there are values");
    let far = chart(1_000_000).draw().expect("there are values");
    well_formed(&near);
    assert_eq!((near.body.matches("limit").count(), far.body.matches("limit").count()), (2, 0));
    assert!(
        near.attributes.contains(",90 ") || near.attributes.contains(",90\""),
        "the peak is told"
    );
    let empty = Series::new(4);
    assert!(series::Chart { series: &empty, ..chart(1) }.draw().is_none());
}

#[test]
fn signals_and_events_are_drawn_at_their_times() {
    let signal = waves::Signal {
        name: "SYNC0".into(),
        high: false,
        changes: vec![100.0, 150.0],
        events: vec![(20.0, "activation".into())],
        distances: vec![((100.0, 150.0), "pulse 50 ns".into())],
    };
    let picture = waves::draw("w", "w", (0.0, 200.0), &[signal]);
    well_formed(&picture);
    for words in ["rises at 100 ns", "falls at 150 ns", "50 ns after", "activation at 20 ns"] {
        assert!(picture.body.contains(words), "{words}: {}", picture.body);
    }
    let entries = vec![
        (Picos(-60_000_000), Moment::Sm2),
        (Picos(-50_000_000), Moment::OutputsFetched),
        (Picos(0), Moment::Sync0),
        (Picos(5_000_000), Moment::OutputsReady),
    ];
    let picture = cycle::events("e", "e", &Timeline { entries }).expect("there are events");
    well_formed(&picture);
    assert!(picture.body.contains("took 55 us"), "{}", picture.body);
    assert!(cycle::events("e", "e", &Timeline::default()).is_none());
}
