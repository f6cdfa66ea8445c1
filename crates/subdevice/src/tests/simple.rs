//! A device without mailbox: it has no objects to read, so its description decides.

use isocat_sync::{SupportedTypes, SyncMode};
use isocat_wire::register::al_event;
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{AlState, AlStatus, AlStatusCode};

use super::bench::Bench;
use std::boxed::Box;

use crate::description::{Behaviour, Description, ProcessDataArea};
use isocat_sync::Event;

use AlState::{Init, Op, PreOp, SafeOp};

const FREE_RUN: SupportedTypes = SupportedTypes(0b001);
const SM: SupportedTypes = SupportedTypes(0b010);
const SM_OR_SYNC0: SupportedTypes = SupportedTypes(0b110);

/// A device in PREOP, with SyncManagers of these lengths; 7 bytes in each direction are right.
fn bench(types: SupportedTypes, outputs: u16, inputs: u16) -> Bench {
    let description = Description {
        objects: &[],
        mailbox: None,
        outputs: ProcessDataArea { sync_manager: 2, start: 0x1100, max_length: 7 },
        inputs: ProcessDataArea { sync_manager: 3, start: 0x1400, max_length: 7 },
        further_outputs: &[],
        further_inputs: &[],
        behaviour: Behaviour { undeclared_types: types, ..Behaviour::default() },
    };
    let mut bench = Bench::new(Box::leak(Box::new(description)));
    assert_eq!(bench.ask(PreOp), ok(PreOp), "mailbox SyncManagers are off, and nobody minds");
    bench.set_process_data(outputs, inputs);
    bench
}

fn ok(state: AlState) -> (AlStatus, AlStatusCode) {
    (AlStatus::new(state), AlStatusCode::NO_ERROR)
}

fn refused(code: AlStatusCode) -> (AlStatus, AlStatusCode) {
    (AlStatus::new(PreOp).with_error(true), code)
}

#[test]
fn it_comes_up_by_the_arrival_of_outputs_and_goes_down_again() {
    let mut bench = bench(SM, 7, 7);
    assert_eq!(bench.ask(SafeOp), ok(SafeOp));
    assert_eq!(bench.device.sync().mode(), SyncMode::SmSynchronous);
    assert_eq!(bench.ask(Op), ok(SafeOp), "no outputs yet");
    bench.write_outputs(&[5; 7]);
    bench.cycle(Event::Sm2);
    assert_eq!(bench.status(), ok(Op));
    for state in [SafeOp, PreOp, Init] {
        assert_eq!(bench.ask(state), ok(state));
    }
}

/// One byte too few and one too many, in either direction, and none at all.
#[test]
fn its_buffers_have_one_length() {
    let outputs = refused(AlStatusCode::INVALID_OUTPUT_CONFIGURATION);
    let inputs = refused(AlStatusCode::INVALID_INPUT_CONFIGURATION);
    for (lengths, answer) in [
        ((7, 7), ok(SafeOp)),
        ((6, 7), outputs),
        ((8, 7), outputs),
        ((0, 7), outputs),
        ((7, 6), inputs),
        ((7, 8), inputs),
        ((7, 0), inputs),
    ] {
        assert_eq!(bench(SM, lengths.0, lengths.1).ask(SafeOp), answer, "{lengths:?}");
    }
}

/// SM0 and SM1 guard none of its memory, with any settings.
#[test]
fn mailbox_sync_managers_do_not_concern_it() {
    let mut bench = bench(SM, 7, 7);
    assert_eq!(bench.ask(SafeOp), ok(SafeOp));
    bench.esc.set_sm(0, SyncManager::new(0x1000, 64, SyncManager::MAILBOX_OUT, true));
    bench.esc.events |= al_event::SM_ACTIVATION;
    bench.poll();
    assert_eq!(bench.status(), ok(SafeOp));
}

#[test]
fn the_description_says_whether_sync0_is_listened_to() {
    let mode = |types, sync0: bool| {
        let mut bench = bench(types, 7, 7);
        if sync0 {
            bench.set_sync0(1_000_000);
        }
        assert_eq!(bench.ask(SafeOp), ok(SafeOp));
        bench.device.sync().mode()
    };
    for (types, without, with) in [
        (FREE_RUN, SyncMode::FreeRun, SyncMode::FreeRun),
        (SM, SyncMode::SmSynchronous, SyncMode::SmSynchronous),
        (SM_OR_SYNC0, SyncMode::SmSynchronous, SyncMode::DcSync0),
    ] {
        assert_eq!((mode(types, false), mode(types, true)), (without, with), "{types}");
    }
}
