//! Screens as golden texts, keys, the limits of the gate, lines.

use isocat_engine::status::{Counter, Device, Error, Event, Kind, Margin, Moment, Stage, Status};
use isocat_sync::phase;
use isocat_wire::{AlState, Nanos};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::style::{Color, Modifier};

use super::gate::Outcome;
use super::source::Speed;
use super::view::{Key, Page, Sort};
use super::{Gate, Trend, View, plain, screen};

/// A segment of six in operation, one of which has left OP, with distinct figures.
fn segment(at_ns: i64) -> Status {
    let mut status = Status::new("line.toml".into(), Kind::Simulated, 1_000_000, 1_000);
    status.stage = Stage::InOperation;
    (status.at_ns, status.since_ns) = (at_ns, at_ns - 100_000_000);
    status.operation_ns = Some(at_ns - 500_000_000);
    let host = &mut status.host;
    (host.phase_error_ns, host.phase_error_worst_ns) = (Some(4_012.4), Some(17_217.0));
    (host.servo, host.rate_ppm) = (Some(phase::State::Locked), Some(-47.0));
    (host.cycles, host.frames_sent, host.frames_lost) = (11_500, 29_486, 2);
    for position in 0..6 {
        let mut device = Device::new(position, format!("axis {position}"));
        device.al_state = Some(AlState::Op);
        device.mode = "dc-sync0".into();
        device.has_sync = true;
        let size = [8.0, -34.4, 2.0, 1_234.0, -11.0, 0.2][position];
        device.error = Some(Error {
            now_ns: size,
            recent_ns: Some(f64::abs(size)),
            worst_ns: f64::abs(size) + 5.0,
            count: 11_000,
        });
        let margin = 438_200.0 - 1_000.0 * position as f64;
        device.margin = Some(Margin { now_ns: margin, least_ns: margin - 500.0 });
        device.clock_ppm = (position > 0).then_some(50.03 - 20.0 * position as f64);
        device.outputs = [Counter { value: Some(0), risen: 0 }; 4];
        status.devices.push(device);
    }
    status.devices[0].is_reference = true;
    let fallen = &mut status.devices[3];
    (fallen.al_state, fallen.al_error, fallen.al_code) = (Some(AlState::SafeOp), true, 0x1A);
    fallen.outputs[0] = Counter { value: Some(4), risen: 7 };
    fallen.alarms.push("counter rises".into());
    let io = &mut status.devices[5];
    (io.mode, io.has_sync, io.error, io.margin) = ("free-run".into(), false, None, None);
    (io.outputs, io.name) = (Default::default(), "an I/O of a name too long for it".into());
    for (event, earliest_ns, latest_ns, seen_ns) in [
        ("outputs stored (SM2)", 8_000, 28_000, Some((8_120.0, 25_300.4))),
        ("outputs ready", 8_000, 88_000, Some((68_100.0, 85_300.0))),
        ("SYNC0", 523_800, 524_200, Some((523_992.0, 524_013.0))),
        ("Outputs Valid", 523_800, 554_200, Some((550_000.0, 560_000.0))),
        ("inputs fetched", 1_000_000, 1_020_200, None),
    ] {
        let event = isocat_sync::Moment::of_name(event).expect("a moment");
        let moment = Moment { event, earliest_ns, latest_ns, seen_ns };
        status.devices[1].moments.push(moment);
    }
    status
}

fn event(at_ns: i64, position: Option<usize>, bad: bool, what: &str) -> Event {
    Event { at_ns, position, bad, alarm: false, what: what.to_owned() }
}

fn view() -> View {
    let mut view = View::new("simulated x1".to_owned(), false);
    for step in 0..40 {
        let mut status = segment(8_000_000_000 + step * 100_000_000);
        status.host.phase_error_ns = Some(4_000.0 + 400.0 * (step % 10) as f64);
        if step == 30 {
            status.events.push(event(status.at_ns, Some(3), true, "SAFEOP+ERR, 0x001A"));
            status.events.push(event(
                status.at_ns,
                None,
                true,
                "process data 0: working counter 5, not 6",
            ));
        }
        view.take(status);
    }
    view
}

/// The text of a screen.
fn drawn(view: &View, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
    terminal.draw(|frame| screen::draw(frame, view)).expect("it draws");
    let buffer = terminal.backend().buffer();
    let mut text = String::new();
    for row in buffer.content().chunks(width.into()) {
        let line: String = row.iter().map(|cell| cell.symbol()).collect();
        text += line.trim_end();
        text.push('\n');
    }
    text
}

/// Compares with the file of this name; with `UPDATE_GOLDEN` set it writes it.
fn is_golden(name: &str, text: &str) {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/watch/golden");
    let path = format!("{folder}/{name}.txt");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(folder).expect("a folder");
        std::fs::write(&path, text).expect("it can be written");
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    assert!(golden == text, "{path} has\n{golden}\nand now it is\n{text}");
}

#[test]
fn the_table_at_both_sizes() {
    let mut view = view();
    is_golden("table_80x24", &drawn(&view, 80, 24));
    is_golden("table_200x50", &drawn(&view, 200, 50));
    view.press(Key::Char('s'));
    view.press(Key::Down);
    is_golden("by_error_80x24", &drawn(&view, 80, 24));
}

#[test]
fn the_cycle_at_both_sizes() {
    let mut view = view();
    view.press(Key::Down);
    view.press(Key::Enter);
    is_golden("cycle_80x24", &drawn(&view, 80, 24));
    is_golden("cycle_200x50", &drawn(&view, 200, 50));
    view.press(Key::Char('?'));
    is_golden("help_80x24", &drawn(&view, 80, 24));
}

/// Any terminal size is drawn, with any amount of data.
#[test]
fn any_size_is_drawn() {
    let mut full = view();
    for page in [Key::Char('x'), Key::Enter, Key::Char('?')] {
        full.press(page);
        for width in (1..60).chain([80, 139, 140, 300]) {
            for height in (1..20).chain([24, 31, 100]) {
                drawn(&full, width, height);
            }
        }
    }
    let empty = View::new(String::new(), true);
    assert!(drawn(&empty, 80, 24).contains("nothing is known yet"));
    let mut begun = View::new(String::new(), true);
    begun.take(Status::new("x.toml".into(), Kind::Wire, 0, 200));
    for key in [Key::Down, Key::Enter, Key::End, Key::Char('s'), Key::PageUp] {
        assert!(!begun.press(key));
        assert!(drawn(&begun, 80, 24).contains("On the way up: begin"));
    }
}

#[test]
fn colours_only_where_they_are_wanted() {
    for colour in [false, true] {
        let mut view = view();
        view.colour = colour;
        let mut terminal = Terminal::new(TestBackend::new(80, 24)).expect("a terminal");
        terminal.draw(|frame| screen::draw(frame, &view)).expect("it draws");
        let cells = terminal.backend().buffer().content();
        let coloured = cells.iter().any(|cell| cell.fg != Color::Reset || cell.bg != Color::Reset);
        assert_eq!(coloured, colour);
        // Without colours, bad news are bold at least.
        assert!(cells.iter().any(|cell| cell.modifier.contains(Modifier::BOLD)));
    }
}

#[test]
fn keys_select_sort_and_go_there_and_back() {
    let mut view = view();
    let order = |view: &View| view.rows().iter().map(|device| device.position).collect::<Vec<_>>();
    assert_eq!(order(&view), [0, 1, 2, 3, 4, 5]);
    for (sort, expected) in [
        (Sort::Error, [3, 1, 4, 0, 2, 5]),
        (Sort::Margin, [4, 3, 2, 1, 0, 5]),
        (Sort::Ppm, [5, 1, 4, 2, 3, 0]),
        (Sort::Counters, [3, 0, 1, 2, 4, 5]),
        (Sort::Position, [0, 1, 2, 3, 4, 5]),
    ] {
        view.press(Key::Char('s'));
        assert_eq!((view.sort(), order(&view)), ((sort, false), expected.to_vec()));
    }
    view.press(Key::Char('r'));
    assert_eq!(order(&view), [5, 4, 3, 2, 1, 0]);
    // The selected device stays selected wherever it moves.
    assert_eq!(view.current().map(|device| device.position), Some(0));
    view.press(Key::Up);
    assert_eq!(view.current().map(|device| device.position), Some(1));
    for (key, expected) in
        [(Key::Home, 5), (Key::Up, 5), (Key::PageDown, 0), (Key::Down, 0), (Key::End, 0)]
    {
        view.press(key);
        assert_eq!(view.current().map(|device| device.position), Some(expected), "{key:?}");
    }
    assert_eq!((view.page(), view.focus()), (Page::Table, None));
    view.press(Key::Enter);
    assert_eq!((view.page(), view.focus()), (Page::Cycle, Some(0)));
    view.press(Key::Up);
    assert_eq!(view.focus(), Some(1), "another device's cycle");
    view.press(Key::Char('?'));
    assert_eq!(view.page(), Page::Help { over_cycle: true });
    view.press(Key::Escape);
    assert_eq!(view.page(), Page::Cycle);
    view.press(Key::Escape);
    assert_eq!(view.page(), Page::Table);
    assert!(!view.press(Key::Escape) && view.press(Key::Char('q')));
}

#[test]
fn a_pause_holds_what_is_shown() {
    let mut view = view();
    let at = |view: &View| view.trend().status().map(|status| status.at_ns);
    let before = at(&view);
    view.press(Key::Char('p'));
    view.take(segment(99_000_000_000));
    assert_eq!((at(&view), view.is_paused()), (before, true));
    assert!(drawn(&view, 80, 24).contains("PAUSED"));
    view.press(Key::Char('p'));
    assert_eq!((at(&view), view.is_paused()), (Some(99_000_000_000), false));
}

#[test]
fn rates_are_those_of_the_last_ten_seconds() {
    let mut trend = Trend::default();
    let mut take = |at: i64, risen: u64| {
        let mut status = segment(at * 1_000_000_000);
        status.devices[3].outputs[0].risen = risen;
        trend.take(status);
        trend.rate(3)
    };
    assert_eq!(take(0, 100), 0.0);
    assert_eq!(take(4, 100), 0.0);
    assert_eq!(take(8, 104), 0.5);
    // The rate covers 4 s to 14 s.
    assert_eq!(take(14, 120), 2.0);
    assert_eq!(take(40, 120), 0.0);
}

/// A service repeats its last events.
#[test]
fn events_of_a_service_are_taken_once() {
    let mut trend = Trend::default();
    let mut take = |events: &[(i64, &str)]| {
        let mut status = segment(1);
        status.kind = Kind::Served;
        status.events = events.iter().map(|(at, what)| event(*at, None, false, what)).collect();
        trend.take(status).len()
    };
    assert_eq!(take(&[]), 0);
    assert_eq!(take(&[(1, "a"), (2, "b")]), 2);
    assert_eq!(take(&[(1, "a"), (2, "b")]), 0);
    assert_eq!(take(&[(2, "b"), (2, "c"), (3, "d")]), 2);
    assert_eq!(take(&[(9, "e")]), 1, "the ones between are lost");
}

/// Two devices that work by SYNC, in sync.
fn good(at_ns: i64) -> Status {
    let mut status = segment(at_ns);
    status.devices.truncate(2);
    status.host.frames_lost = 0;
    status
}

/// Feeds a gate of 100 ns for 5 s with a status every 100 ms, until it has a result or 100 are
/// taken.
fn fed(gate: &mut Gate, change: impl Fn(i64, &mut Status)) -> (i64, Option<Outcome>) {
    for step in 1..=100 {
        let mut status = good(step * 100_000_000);
        status.operation_ns = Some(status.at_ns);
        change(step, &mut status);
        if let Some(outcome) = gate.take(&status) {
            return (step, Some(outcome));
        }
    }
    (100, None)
}

fn gate() -> Gate {
    Gate::new(Nanos(100), Nanos::millis(5_000), None)
}

#[test]
fn the_gate_opens_when_the_stretch_is_long_enough() {
    let (step, outcome) = fed(&mut gate(), |_, _| {});
    let words = "2 SubDevices with SYNC within 100 ns for 5 s, at 5.000 s [t]";
    assert_eq!((step, outcome), (50, Some(Outcome::Opened(words.to_owned()))));
}

/// Tests both sides of each limit, by a nanosecond.
#[test]
fn the_edges_of_the_gate() {
    let error = |recent: f64| {
        move |_: i64, status: &mut Status| {
            if let Some(error) = &mut status.devices[1].error {
                error.recent_ns = Some(recent);
            }
        }
    };
    assert!(matches!(fed(&mut gate(), error(100.0)), (50, Some(Outcome::Opened(_)))));
    assert_eq!(fed(&mut gate(), error(101.0)), (100, None));
    assert_eq!(fed(&mut gate(), error(100.001)), (100, None), "by a picosecond");
    // A stretch begins with the time in operation, not before.
    let late = |since: i64| {
        move |step: i64, status: &mut Status| {
            status.operation_ns = Some(status.at_ns - since);
            status.since_ns = if step == 1 { 0 } else { status.since_ns };
        }
    };
    assert_eq!(fed(&mut gate(), late(0)).0, 50);
    assert_eq!(fed(&mut gate(), late(1)).0, 51);
    let mut one_short = Gate::new(Nanos(100), Nanos(5_000_000_001), None);
    assert_eq!(fed(&mut one_short, |_, _| {}).0, 51);
    let mut just = Gate::new(Nanos(100), Nanos(4_900_000_001), None);
    assert_eq!(fed(&mut just, |_, _| {}).0, 50);
}

#[test]
fn one_edge_beyond_the_limit_begins_the_stretch_anew() {
    let mut gate = gate();
    let (step, outcome) = fed(&mut gate, |step, status| {
        if step == 40
            && let Some(error) = &mut status.devices[0].error
        {
            // It is small again when the status is taken.
            error.recent_ns = Some(213.4);
        }
    });
    assert!(matches!(outcome, Some(Outcome::Opened(_))));
    assert_eq!(step, 90);
    let account = gate.account();
    let worst = "worst: SubDevice 0 (axis 0) with 213.4 ns at 4.000 s";
    let broken = "the last stretch, of 3.900 s, was broken at 4.000 s: SubDevice 0 (axis 0): SYNC error 213.4 ns";
    assert!(account.contains(worst) && account.contains(broken), "{account}");
}

#[test]
fn everything_else_breaks_a_stretch_too() {
    type Change = fn(&mut Status);
    let all: [(&str, Change); 9] = [
        ("SubDevice 0 (axis 0) is in SAFEOP", |s| s.devices[0].al_state = Some(AlState::SafeOp)),
        ("SubDevice 1 (axis 1) is in OP+ERR", |s| s.devices[1].al_error = true),
        ("counter rises", |s| s.devices[1].alarms.push("counter rises".into())),
        ("counters grew by 1", |s| s.devices[1].inputs[3].risen = 1),
        ("1 frames lost", |s| s.host.frames_lost += 1),
        ("2 cycles skipped", |s| s.host.cycles_skipped += 2),
        ("1 wrong working counters", |s| s.host.working_counter_errors += 1),
        ("clocks are not led for 100 cycles", |s| s.host.unled_cycles = Some(100)),
        ("not in operation: OP", |s| s.stage = Stage::Up(isocat_maindevice::Stage::Op)),
    ];
    for (words, change) in all {
        let mut gate = gate();
        let (step, outcome) = fed(&mut gate, |step, status| {
            if step == 20 {
                change(status);
            } else if step > 20 {
                // An increased counter stays increased.
                let grown = words.contains("grew") as u64;
                status.devices[1].inputs[3].risen = grown;
                status.host.frames_lost = words.contains("frames lost") as u64;
                status.host.cycles_skipped = 2 * words.contains("skipped") as u64;
                status.host.working_counter_errors = words.contains("working") as u64;
            }
        });
        assert_eq!((step, outcome.is_some()), (70, true), "{words}");
        assert!(gate.account().contains(words), "{words}: {}", gate.account());
    }
}

/// Unobserved times do not count: a gap between statuses, or an error that is no longer measured.
#[test]
fn what_was_not_seen_does_not_count() {
    let (step, _) = fed(&mut gate(), |step, status| {
        if step == 20 {
            status.since_ns += 1;
        }
    });
    assert_eq!(step, 70, "a hole of a nanosecond");
    let unseen = |from: i64, to: i64| {
        move |step: i64, status: &mut Status| {
            if (from..to).contains(&step)
                && let Some(error) = &mut status.devices[1].error
            {
                error.recent_ns = None;
            }
        }
    };
    assert_eq!(fed(&mut gate(), unseen(20, 30)).0, 50, "ten statuses long");
    assert_eq!(fed(&mut gate(), unseen(20, 31)).0, 80, "more than a second");
    assert_eq!(fed(&mut gate(), unseen(1, 101)), (100, None), "never measured");
}

#[test]
fn the_gate_closes_when_its_time_is_over() {
    let within = |within| Gate::new(Nanos(100), Nanos::millis(5_000), Some(within));
    let (step, outcome) = fed(&mut within(Nanos::millis(5_000)), |_, _| {});
    assert!(matches!((step, outcome), (50, Some(Outcome::Opened(_)))), "just in time");
    let (step, outcome) = fed(&mut within(Nanos(4_999_999_999)), |_, _| {});
    let Some(Outcome::Closed(words)) = outcome else { panic!("it closes") };
    assert!(step == 50 && words.ends_with(" in 4.999999999 s"), "{words}");
}

#[test]
fn without_sync_or_at_the_end_there_is_nothing_to_wait_for() {
    let mut gate = gate();
    let (_, outcome) = fed(&mut gate, |_, status| {
        status.devices.iter_mut().for_each(|device| device.has_sync = false);
    });
    assert_eq!(outcome, None);
    assert!(gate.account().contains("no SubDevice works by SYNC"), "{}", gate.account());
    let mut status = good(1);
    status.stage = Stage::Ended;
    status.failure = Some("the cable is out".into());
    let Some(Outcome::Closed(words)) = gate.take(&status) else { panic!("it closes") };
    assert!(words.ends_with("the cable is out"), "{words}");
}

/// On a wire the reference clock has no error: its 0x092C is relative to itself.
#[test]
fn the_reference_of_a_wire_is_not_waited_for() {
    let unmeasured = |kind| {
        move |_: i64, status: &mut Status| {
            status.kind = kind;
            status.devices[0].error = None;
        }
    };
    assert_eq!(fed(&mut gate(), unmeasured(Kind::Wire)).0, 50);
    assert_eq!(fed(&mut gate(), unmeasured(Kind::Simulated)), (100, None));
}

fn trend_of(statuses: impl IntoIterator<Item = Status>) -> Trend {
    let mut trend = Trend::default();
    statuses.into_iter().for_each(|status| drop(trend.take(status)));
    trend
}

/// On the way up two SubDevices stay in SAFEOP while the others are in OP: each counts from the
/// instant of its last change, and only from a second on.
#[test]
fn subdevices_behind_the_others_are_marked() {
    let status = |at_ns: i64| {
        let mut status = segment(at_ns);
        status.stage = Stage::Up(isocat_maindevice::Stage::Op);
        status.devices[3].alarms.clear();
        if at_ns >= 10_000_000_001 {
            status.devices[1].al_state = Some(AlState::SafeOp);
        }
        status
    };
    let until = |last: i64| trend_of([9_000_000_000, 10_000_000_001, last].map(status));
    let positions = |trend: Trend| -> Vec<_> {
        trend.all_behind().into_iter().map(|behind| (behind.position, behind.for_ns)).collect()
    };
    assert_eq!(positions(until(11_000_000_000)), [(3, 2_000_000_000)]);
    assert_eq!(positions(until(11_000_000_001)), [(3, 2_000_000_001), (1, 1_000_000_000)]);
    // What may be absent is not waited for, and where all are in one state none is behind.
    let absent = |at: i64| {
        let mut status = status(at);
        status.devices[3].asked = false;
        status
    };
    assert_eq!(positions(trend_of([9_000_000_000, 11_000_000_000].map(absent))), []);
    let equal = |at: i64| {
        let mut status = status(at);
        status.devices.iter_mut().for_each(|device| device.al_state = Some(AlState::SafeOp));
        status
    };
    assert_eq!(positions(trend_of([9_000_000_000, 11_000_000_001].map(equal))), []);

    let text = plain::lines(&until(18_700_000_000));
    let expected = "\
isocat[18.700]: ! SubDevice 3 (axis 3) in SAFEOP+ERR (0x001A) for 9 s, others in OP
isocat[18.700]: ! SubDevice 1 (axis 1) in SAFEOP for 8 s, others in OP
isocat[18.700]: On the way up: OP
";
    assert_eq!(text, expected);
    let mut view = View::new("simulated x1".to_owned(), false);
    for at in [9_000_000_000, 10_000_000_001, 18_700_000_000] {
        view.take(status(at));
    }
    is_golden("way_up_80x24", &drawn(&view, 80, 24));
    is_golden("way_up_200x50", &drawn(&view, 200, 50));
    for (ns, words) in [
        (1_000_000_000, "1 s"),
        (99_999_999_999, "99 s"),
        (100_000_000_000, "1 m"),
        (5_999_999_999_999, "99 m"),
        (6_000_000_000_000, "1 h"),
    ] {
        assert_eq!(super::words::span(ns), words);
    }
}

#[test]
fn lines_name_the_worst_first() {
    let status = segment(12_000_000_000);
    let text = plain::lines(&trend_of([status.clone()]));
    let expected = "\
isocat[12.000]: 3 axis 3  error 1234 ns worst 1239 ns  margin 435.2 us  freq -9.97 ppm  SAFEOP+ERR 0x001A  counters +7  ! counter rises
isocat[12.000]: 1 axis 1  error  -34 ns worst 39 ns  margin 437.2 us  freq +30.03 ppm  OP
isocat[12.000]: 4 axis 4  error  -11 ns worst 16 ns  margin 434.2 us  freq -29.97 ppm  OP
isocat[12.000]: 0 axis 0  error    8 ns worst 13 ns  margin 438.2 us  OP
isocat[12.000]: Not in sync: SubDevice 3 (axis 3) is in SAFEOP+ERR, AL status code 0x001A  5 of 6 in OP  error at most 1234 ns [t]  phase 4012 ns  servo locked -47.00 ppm  lost 2  skipped 0  alarms 1
";
    assert_eq!(text, expected);
    let mut begun = Status::new("x.toml".into(), Kind::Wire, 0, 200);
    begun.stage = Stage::Up(isocat_maindevice::Stage::Sii);
    assert_eq!(plain::lines(&trend_of([begun])), "isocat[0.000]: On the way up: SII\n");
    let events: Vec<Event> = (0..22).map(|at| event(at, Some(9), true, "gone")).collect();
    let text = plain::events(&status, &events);
    assert_eq!(text.lines().count(), plain::MOST_EVENTS + 1);
    assert!(text.starts_with("isocat[0.000]: ! SubDevice 9: gone\n"));
    assert!(text.ends_with("isocat[12.000]: and 2 more events\n"));
}

#[test]
fn figures_keep_to_their_columns() {
    for (ns, words) in [
        (-0.4, "0 ns"),
        (-9_999.4, "-9999 ns"),
        (9_999.5, "10.0 us"),
        (-99_949.0, "-99.9 us"),
        (-99_950.0, "-100 us"),
        (438_200.0, "438.2 us"),
        (999_949.0, "999.9 us"),
        (999_951.0, "1.00 ms"),
        (-9_994_000.0, "-9.99 ms"),
        (-999_400_000.0, "-999 ms"),
        (3.6e12, "3600 s"),
    ] {
        assert_eq!(super::words::time(ns), words);
        assert!(words.len() <= 8);
    }
    // A screen too narrow for all figures omits some, and cuts none.
    let narrow = drawn(&view(), 60, 20);
    assert!(
        narrow.contains(" 438.2 us ") && narrow.contains(" 1234 ns ") && !narrow.contains("ppm[r]")
    );
}

#[test]
fn speeds() {
    assert_eq!(Speed::parse("max"), Ok(Speed::Max));
    assert_eq!(Speed::parse("0.5"), Ok(Speed::Times(0.5)));
    assert_eq!(Speed::parse("1000"), Ok(Speed::Times(1000.0)));
    for wrong in ["0", "-1", "nan", "inf", "1001", "0.0009", "fast", ""] {
        assert!(Speed::parse(wrong).is_err_and(|why| why.contains("expected")), "{wrong}");
    }
}
