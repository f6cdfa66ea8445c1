//! Words for what is in devices: dead-eeprom, misbehave, stuck-mailbox, sync-off, al-error.

use isocat::fault::Order;
use isocat::{Scenario, SegmentFile};
use isocat_maindevice::Event;
use isocat_sim::{Fault, World};
use isocat_subdevice::Misbehaviour;
use isocat_wire::time::{Nanos, Picos};
use isocat_wire::{AlState, ObjectAddress};

use crate::onlooker::{SEGMENT, run, with};

/// A dead EEPROM is noticed when somebody reads it: at a power cycle the MainDevice finds nobody
/// that it knows.
#[test]
fn an_eeprom_does_not_answer() {
    let text = |dead: &str| {
        format!(
            "{SEGMENT}{dead}[[fault]]\nat = \"in-operation + 100ms\"\nwhat = \"power-cycle last 50ms\"\n"
        )
    };
    let (seen, _) = run(&text(""));
    assert_eq!(seen.moves(2).last().map(|last| last.1), Some(AlState::Op));
    let dead = "[[fault]]\nat = \"in-operation\"\nwhat = \"dead-eeprom last\"\n";
    let (seen, report) = run(&text(dead));
    assert_eq!(seen.moves(2).last().map(|last| last.1), Some(AlState::Init));
    assert!(report.findings.iter().any(|finding| finding.position == Some(2)));
}

#[test]
fn a_device_misbehaves_for_a_time() {
    let (seen, report) = with(100, "misbehave axis dead-sync0 for 5ms");
    let fell = seen.moves(1);
    assert!(matches!(fell[0], (100..=110, AlState::SafeOp, _)), "{fell:?}");
    // It behaves again, so that it can be brought back.
    assert_eq!(fell.last().map(|last| last.1), Some(AlState::Op), "{}", report.verdict);
    let (seen, _) = with(100, "misbehave axis dead-sync0");
    assert_eq!(seen.moves(1).last().map(|last| last.1), Some(AlState::SafeOp));
    assert_eq!((seen.moves(0), seen.moves(2)), (vec![], vec![]), "nobody else");
}

/// An upload of the axis, asked for in operation: whether it is answered in time.
#[test]
fn a_mailbox_is_stuck() {
    let answered = |what: Option<&str>| {
        let file = SegmentFile::parse("mailbox.toml", SEGMENT).unwrap();
        let mut world = World::new(
            Scenario::from(file).run().setup,
            isocat_maindevice::Motion::default(),
            None::<isocat::NoTap>,
        );
        let limit = isocat_wire::time::Time::new(60_000_000_000_000);
        while !matches!(world.poll_event(), Some(Event::InOperation { .. })) {
            world.step(limit);
        }
        if let Some(what) = what {
            let names = ["first", "axis", "last"].map(str::to_owned);
            let order = Order::parse(what, &names).unwrap();
            world.inject(order.fault, order.lasts);
        }
        world.main_mut().upload(1, ObjectAddress::new(0x1C32, 1));
        let until = world.now() + Picos::from(Nanos::millis(200));
        loop {
            match world.poll_event() {
                Some(Event::Uploaded { result, .. }) => break result.is_ok(),
                Some(_) => {}
                None if world.step(until) => {}
                None => break false,
            }
        }
    };
    assert!(answered(None) && !answered(Some("stuck-mailbox axis")));
    assert!(answered(Some("stuck-mailbox axis for 50ms")));
    // The word stands for one of the vocabulary of misbehaviour.
    let order = Order::parse("stuck-mailbox 0", &["x".to_owned()]).unwrap();
    assert!(matches!(
        order.fault,
        Fault::Misbehave { device: 0, how: Misbehaviour::SlowMailbox(_) }
    ));
}

/// A device that can't be asked for its mode is in Free Run by nobody's choice; one whose mode the
/// file gives is asked for nothing.
#[test]
fn free_run_behind_a_silent_mailbox_is_no_choice() {
    let run = |keys: &str, fault: &str| {
        let text = format!(
            "cycle = \"2ms\"\nfor = \"100ms\"\n[[subdevice]]\ndevice = \"kollmorgen_akd2g\"\n\
             [[subdevice]]\ndevice = \"kollmorgen_akd2g\"\nname = \"mute\"\n{keys}{fault}"
        );
        let file = isocat::SegmentFile::parse("mute.toml", &text).unwrap();
        isocat::run(&isocat::Scenario::from(file))
    };
    let fault = "[[fault]]\nat = \"10ms\"\nwhat = \"stuck-mailbox mute\"\n";
    let silent = run("", fault);
    let kinds: Vec<_> = silent.findings.iter().map(|f| (f.position, f.kind.name())).collect();
    assert_eq!(kinds, [(Some(1), "mode-not-asked")]);
    let verdict = &silent.verdict;
    assert!(verdict.starts_with("Not in sync: SubDevice 1 (mute): its mailbox"), "{verdict}");
    let asked_for = run("mode = \"free-run\"\n", fault);
    assert!(asked_for.in_sync, "{}", asked_for.verdict);
    assert!(asked_for.verdict.contains("1 in Free Run as announced or asked for"));
    assert!(run("", "").in_sync);
}

/// SYNC0 stops at once; the device says so when its time is over (0x002C).
#[test]
fn a_sync_unit_is_switched_off() {
    let (seen, _) = with(100, "sync-off axis");
    assert_eq!((seen.edges(1, 90, 100), seen.edges(1, 101, 120)), (10, 0));
    assert_eq!((seen.edges(0, 0, 900), seen.edges(2, 0, 900)), (0, 900));
    assert!(
        matches!(seen.moves(1)[0], (101..=110, AlState::SafeOp, 0x002C)),
        "{:?}",
        seen.moves(1)
    );
}

#[test]
fn an_application_gives_up() {
    let (seen, report) = with(100, "al-error axis 0x8123");
    let moves = seen.moves(1);
    assert_eq!(moves[0], (100, AlState::SafeOp, 0x8123));
    assert_eq!(moves.last().map(|last| last.1), Some(AlState::Op), "it is brought back: {moves:?}");
    assert_eq!(report.findings[0].position, Some(1));
}
