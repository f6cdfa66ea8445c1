use isocat_wire::mailbox::{ErrorDetail, Header, Protocol};
use isocat_wire::register::al_event;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{AbortCode, AlState};

use super::bench::Bench;
use super::device::description;

fn bench() -> Bench {
    Bench::in_state(description(|_| {}), AlState::PreOp)
}

/// A request for 0x100A:00 with this counter.
fn request(counter: u8) -> [u8; 16] {
    let [a, b, c, d, e, f] = Header::new(10, 0, Protocol::COE, counter).emit();
    [a, b, c, d, e, f, 0, 0x20, 0x40, 0x0A, 0x10, 0, 0, 0, 0, 0]
}

fn toggle_repeat(bench: &mut Bench) {
    let mut sm = bench.esc.sm(1);
    sm.activate ^= SyncManager::REPEAT;
    bench.esc.set_sm(1, sm);
    bench.esc.events |= al_event::SM_ACTIVATION;
    bench.poll();
    let sm = bench.esc.sm(1);
    let (asked, done) = (sm.activate & SyncManager::REPEAT, sm.pdi_control & SyncManager::REPEAT);
    assert_eq!(asked, done, "the repetition is acknowledged");
}

/// The upload of 0x100A:00 that was captured at a real device, byte by byte.
#[test]
fn captured_upload() {
    let mut bench = bench();
    bench.send_raw(&[0x0A, 0, 0, 0, 0, 0x13, 0x00, 0x20, 0x40, 0x0A, 0x10, 0x00]);
    bench.poll();
    let answer = [0x0A, 0, 0, 0, 0, 0x13, 0x00, 0x30, 0x4B, 0x0A, 0x10, 0x00, 0x30, 0x38];
    assert_eq!(bench.esc.memory[0x1080..0x108E], answer);
    assert_eq!(bench.esc.sm(0).status & SyncManager::STATUS_FULL, 0);
}

#[test]
fn counters_run_from_one_to_seven() {
    let mut bench = bench();
    for expected in [1, 2, 3, 4, 5, 6, 7, 1] {
        bench.send_raw(&request(expected));
        bench.poll();
        assert_eq!(bench.receive().unwrap().0.counter, expected);
        bench.poll();
    }
}

#[test]
fn a_message_is_taken_once() {
    let mut bench = bench();
    bench.send_raw(&request(3));
    bench.poll();
    assert!(bench.receive().is_some());
    bench.send_raw(&request(3));
    bench.poll();
    assert_eq!(bench.receive(), None, "the same counter again is the same message");
    for _ in 0..2 {
        bench.send_raw(&request(0));
        bench.poll();
        assert!(bench.receive().is_some(), "counter 0 switches the check off");
    }
}

#[test]
fn a_request_waits_until_the_last_answer_was_read() {
    let mut bench = bench();
    bench.send_raw(&request(1));
    bench.poll();
    bench.send_raw(&request(2));
    bench.poll();
    assert_ne!(bench.esc.events & al_event::sync_manager(0), 0, "not fetched yet");
    assert_eq!(bench.receive().unwrap().0.counter, 1);
    bench.poll();
    assert_eq!(bench.receive().unwrap().0.counter, 2);
    bench.poll();
    assert_eq!(bench.esc.events, 0, "a mailbox that was read is released");
}

#[test]
fn an_answer_that_was_lost_comes_again() {
    let mut bench = bench();
    toggle_repeat(&mut bench);
    assert_eq!(bench.receive(), None, "there was none yet");
    bench.send_raw(&request(1));
    bench.poll();
    let first = bench.receive();
    for _ in 0..2 {
        toggle_repeat(&mut bench);
        assert_eq!(bench.receive(), first);
    }
    bench.poll();
    bench.send_raw(&request(2));
    bench.poll();
    toggle_repeat(&mut bench);
    assert_eq!(bench.receive(), first, "the lost one first");
    bench.poll();
    let second = bench.receive().unwrap();
    assert_eq!(second.0.counter, 2, "then the newer one");
    bench.poll();
    assert_eq!(bench.receive(), None);
}

#[test]
fn a_repetition_that_was_lost_too_comes_again() {
    let mut bench = bench();
    bench.send_raw(&request(1));
    bench.poll();
    let first = bench.receive();
    bench.poll();
    bench.send_raw(&request(2));
    bench.poll();
    toggle_repeat(&mut bench);
    assert_eq!(bench.receive(), first);
    // It is requested again before the newer one is in SM1, and then twice without reading.
    toggle_repeat(&mut bench);
    assert_eq!(bench.receive(), first, "not the newer one, which was not lost");
    bench.poll();
    toggle_repeat(&mut bench);
    toggle_repeat(&mut bench);
    assert_eq!(bench.receive(), first);
    bench.poll();
    assert_eq!(bench.receive().unwrap().0.counter, 2);
    bench.poll();
    assert_eq!(bench.receive(), None, "each once");
}

#[test]
fn a_repetition_waits_until_the_esc_has_emptied_the_mailbox() {
    let mut bench = bench();
    bench.send_raw(&request(1));
    bench.poll();
    let first = bench.receive();
    bench.poll();
    bench.send_raw(&request(2));
    bench.poll();
    let mut sm = bench.esc.sm(1);
    sm.activate ^= SyncManager::REPEAT;
    bench.esc.set_sm(1, sm);
    bench.esc.events |= al_event::SM_ACTIVATION;
    for _ in 0..2 {
        // Two frames: one until it is off, one until it is on again.
        bench.esc.passing = Some(std::vec![]);
        bench.poll();
        assert_ne!(bench.esc.sm(1).pdi_control & SyncManager::REPEAT, SyncManager::REPEAT);
        bench.esc.end_frame();
    }
    bench.pass(isocat_wire::Nanos(10_000));
    assert_eq!(bench.esc.sm(1).pdi_control, SyncManager::REPEAT);
    assert_eq!(bench.receive(), first);
    bench.poll();
    assert_eq!(bench.receive().unwrap().0.counter, 2);
}

#[test]
fn what_is_no_coe_is_answered_with_an_error() {
    let mut bench = bench();
    let mut error = |bytes: &[u8]| {
        bench.send_raw(bytes);
        bench.poll();
        let (header, body) = bench.receive()?;
        bench.poll();
        assert_eq!(header.protocol, Protocol::ERROR);
        assert_eq!(body[..2], [1, 0]);
        Some(ErrorDetail::parse(body.first_chunk().unwrap()))
    };
    assert_eq!(error(&[2, 0, 0, 0, 0, 0x15, 1, 2]), Some(ErrorDetail::UNSUPPORTED_PROTOCOL));
    assert_eq!(error(&[2, 0, 0, 0, 1, 0x23, 1, 2]), Some(ErrorDetail::INVALID_CHANNEL));
    assert_eq!(error(&[59, 0, 0, 0, 0, 0x33]), Some(ErrorDetail::INVALID_SIZE));
    assert_eq!(error(&[0, 0, 0, 0, 0, 0x43]), Some(ErrorDetail::SIZE_TOO_SHORT));
    assert_eq!(error(&[1, 0, 0, 0, 0, 0x53, 0]), Some(ErrorDetail::SIZE_TOO_SHORT));
    assert_eq!(error(&[2, 0, 0, 0, 0, 0x63, 0, 0x50]), Some(ErrorDetail::SERVICE_NOT_SUPPORTED));
    assert_eq!(error(&[9, 0, 0, 0, 0, 0x73, 0, 0x20]), Some(ErrorDetail::SIZE_TOO_SHORT));
    assert_eq!(error(&[4, 0, 0, 0, 0, 0x10, 1, 0, 2, 0]), None, "an error is never answered");
}

#[test]
fn init_forgets_what_was_under_way() {
    let mut bench = bench();
    assert_eq!(bench.coe(2, &[0x40, 0x08, 0x10, 0, 0, 0, 0, 0]).1[0], 0x41);
    bench.ask(AlState::Init);
    bench.ask(AlState::PreOp);
    toggle_repeat(&mut bench);
    assert_eq!(bench.receive(), None);
    let segment = [0x60, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(bench.sdo(&segment), Err(AbortCode::COMMAND_SPECIFIER));
}

#[test]
fn an_answer_of_before_init_is_not_one_of_after() {
    let mut bench = bench();
    bench.send_raw(&request(1));
    bench.poll();
    bench.ask(AlState::Init);
    bench.ask(AlState::PreOp);
    bench.poll();
    assert_eq!(bench.receive(), None, "the MainDevice would take it for its next answer");
    bench.send_raw(&request(1));
    bench.poll();
    assert_eq!(bench.receive().unwrap().0.counter, 1);
    // A frame in progress keeps the ESC from emptying it at once.
    bench.poll();
    bench.send_raw(&request(2));
    bench.poll();
    bench.ask(AlState::Init);
    bench.esc.passing = Some(std::vec![]);
    bench.ask(AlState::PreOp);
    bench.send_raw(&request(1));
    for _ in 0..2 {
        bench.esc.passing = Some(std::vec![]);
        bench.poll();
        assert_ne!(bench.esc.events & al_event::sync_manager(0), 0, "requests wait for it");
        bench.esc.end_frame();
    }
    bench.pass(isocat_wire::Nanos(10_000));
    assert_eq!(bench.receive().unwrap().0.counter, 1);
    bench.poll();
    assert_eq!(bench.receive(), None);
}

#[test]
fn a_mailbox_below_preop_is_deaf() {
    let mut bench = Bench::new(description(|_| {}));
    bench.set_mailbox();
    bench.send_raw(&request(1));
    bench.poll();
    assert_eq!(bench.receive(), None);
}
