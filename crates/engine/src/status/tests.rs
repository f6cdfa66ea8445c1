use super::board::MOST_NOTES;
use super::main_device::Note;
use super::*;

fn status() -> Status {
    let mut status = Status::new("x.toml".into(), Kind::Simulated, 1_000_000, 1_000);
    for position in 0..2 {
        let mut device = Device::new(position, format!("axis {position}"));
        (device.al_state, device.has_sync) = (Some(AlState::Op), true);
        status.devices.push(device);
    }
    status.stage = Stage::InOperation;
    status
}

#[test]
fn verdicts_name_what_speaks_against_it() {
    let mut status = status();
    let says = |status: &Status, words: &str, good| {
        let verdict = status.verdict();
        assert_eq!((&*verdict.words, verdict.good), (words, good));
    };
    says(&status, "In sync: 2 of 2 SubDevices with SYNC, all in OP", true);
    let error = |now_ns| Some(Error { now_ns, recent_ns: None, worst_ns: 0.0, count: 1 });
    status.devices[1].error = error(-1_000.0);
    assert!(status.verdict().good, "at the limit");
    status.devices[1].error = error(-1_001.0);
    says(&status, "Not in sync: SubDevice 1 (axis 1): SYNC error -1001 ns, limit 1000 ns", false);
    status.host.servo = Some(phase::State::Holdover);
    says(&status, "Not in sync: the servo is in holdover", false);
    (status.devices[0].al_state, status.devices[0].al_error) = (Some(AlState::SafeOp), true);
    status.devices[0].al_code = 0x1A;
    let words = "Not in sync: SubDevice 0 (axis 0) is in SAFEOP+ERR, AL status code 0x001A";
    says(&status, words, false);
    status.devices[0].asked = false;
    says(&status, "Not in sync: the servo is in holdover", false);
    status.stage = Stage::Up(isocat_maindevice::Stage::Sii);
    says(&status, "On the way up: SII", false);
    (status.stage, status.failure) = (Stage::Ended, Some("the cable is out".into()));
    says(&status, "The cable is out", false);
}

#[test]
fn a_board_gives_each_status_once_and_never_makes_the_loop_wait() {
    let board = Board::new(status());
    assert!(board.take().is_some() && board.take().is_none());
    assert!(board.fill(|sheet| {
        assert!(sheet.taken);
        sheet.note(5, Note::InOperation);
    }));
    // The next filling knows that the last status was not taken, so that nothing is lost.
    assert!(board.fill(|sheet| assert!(!sheet.taken)));
    let taken = board.take().expect("it is new");
    assert_eq!(taken.events.len(), 1);
    assert_eq!((taken.events[0].at_ns, taken.events[0].bad), (5, false));
    // While a reader holds the board the loop goes on, and fills it later.
    let filled = std::cell::Cell::new(None);
    board.fill(|_| filled.set(Some(board.fill(|_| {}))));
    assert_eq!(filled.get(), Some(false));
    assert!(board.take().is_some_and(|status| status.events.is_empty()));
}

#[test]
fn notes_that_nobody_takes_give_way_and_are_counted() {
    let board = Board::new(status());
    board.fill(|sheet| {
        (0..MOST_NOTES as i64 + 3).for_each(|at| sheet.note(at, Note::InOperation));
    });
    let events = board.take().expect("it is new").events;
    assert_eq!(events.len(), MOST_NOTES + 1);
    assert_eq!(events[0].what, "3 events are not shown");
    assert_eq!((events[1].at_ns, events[MOST_NOTES].at_ns), (3, MOST_NOTES as i64 + 2));
}

#[test]
fn a_status_is_the_same_after_its_way_as_json() {
    let mut status = status();
    status.devices[0].margin = Some(Margin { now_ns: 1.5, least_ns: -2.0 });
    status.devices[0].moments.push(Moment {
        event: isocat_sync::Moment::Sync0,
        earliest_ns: 1,
        latest_ns: 2,
        seen_ns: Some((1.0, 1.5)),
    });
    let text = serde_json::to_string(&status).expect("JSON");
    assert!(!text.contains('\n'), "one line");
    assert_eq!(serde_json::from_str::<Status>(&text).expect("a status"), status);
}
