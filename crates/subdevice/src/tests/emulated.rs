//! A device without a program: it follows AL status and refuses nothing.

use std::boxed::Box;

use isocat_sync::{Event, SupportedTypes, SyncMode};
use isocat_wire::register::{self, al_event};
use isocat_wire::{AlState, AlStatus, AlStatusCode};

use super::bench::{Bench, Call};
use crate::description::{Behaviour, Description, ProcessDataArea};

use AlState::{Init, Op, PreOp, SafeOp};

/// Two bytes of digital outputs, each a register with a separate SyncManager, and one byte of
/// inputs.
fn bench(types: u16) -> Bench {
    let area = |sync_manager, start| ProcessDataArea { sync_manager, start, max_length: 1 };
    let further = Box::leak(Box::new([area(1, 0x0F01)]));
    let description = Description {
        objects: &[],
        mailbox: None,
        outputs: area(0, 0x0F00),
        inputs: area(2, 0x1000),
        further_outputs: further,
        further_inputs: &[],
        behaviour: Behaviour {
            device_emulation: true,
            undeclared_types: SupportedTypes(types),
            ..Behaviour::default()
        },
    };
    Bench::new(Box::leak(Box::new(description)))
}

/// The ESC copied AL control to AL status.
fn mirror(bench: &mut Bench, status: u16) {
    bench.set(register::AL_STATUS, AlStatus(status));
    bench.poll();
}

#[test]
fn it_is_where_al_status_says() {
    let mut bench = bench(0b11);
    // The acknowledge bit is copied too, and skipping states is no error.
    for (status, state) in [
        (0x11, Init),
        (0x12, PreOp),
        (0x04, SafeOp),
        (0x08, Op),
        (0x02, PreOp),
        (0x08, Op),
        (1, Init),
    ] {
        mirror(&mut bench, status);
        assert_eq!(bench.device.state(), state);
        assert_eq!(
            bench.status(),
            (AlStatus(status), AlStatusCode(0)),
            "the ESC's, not the stack's"
        );
        assert_eq!(bench.device.next_timeout(), None);
    }
}

/// No SyncManager is configured: the circuit's wires have fixed addresses.
#[test]
fn outputs_act_in_op_alone_and_inputs_are_there_from_safeop_on() {
    let mut bench = bench(0b11);
    bench.esc.memory[0x0F00..0x0F03].copy_from_slice(&[0xA5, 0x5A, 0xFF]);
    mirror(&mut bench, 4);
    assert_eq!(bench.esc.memory[0x1000..0x1002], [1, 0]);
    bench.calls();
    bench.cycle(Event::Sm2);
    assert!(!bench.calls().contains(&Call::Valid));
    mirror(&mut bench, 8);
    bench.cycle(Event::Sm2);
    let calls = bench.calls();
    assert!(calls.contains(&Call::Map([0xA5, 0x5A].to_vec())), "{calls:?}");
    assert!(calls.contains(&Call::Valid));
    mirror(&mut bench, 4);
    assert_eq!(bench.calls(), [Call::Safe]);
}

/// The circuit switches its outputs off; the ESC has the state.
#[test]
fn the_watchdog_switches_outputs_off_and_changes_no_state() {
    let mut bench = bench(0b11);
    for (status, calls) in [(4, &[][..]), (8, &[Call::Safe])] {
        mirror(&mut bench, status);
        bench.calls();
        bench.esc.events |= al_event::WATCHDOG;
        bench.poll();
        assert_eq!((bench.calls(), bench.esc.events), (calls.to_vec(), 0));
        assert_eq!(bench.status(), (AlStatus(status), AlStatusCode(0)));
    }
}

#[test]
fn sync0_moves_outputs_where_the_circuit_is_made_so() {
    for (types, pulses, mode) in [
        (0b111, true, SyncMode::DcSync0),
        (0b111, false, SyncMode::SmSynchronous),
        (0b011, true, SyncMode::SmSynchronous),
    ] {
        let mut bench = bench(types);
        if pulses {
            bench.set_sync0(1_000_000);
        }
        mirror(&mut bench, 8);
        assert_eq!(bench.device.sync().mode(), mode, "{types:#b} {pulses}");
    }
}

/// There is no program that could fail.
#[test]
fn it_does_not_fail() {
    let mut bench = bench(0b11);
    mirror(&mut bench, 8);
    bench.device.fail(AlStatusCode::UNSPECIFIED, &mut bench.esc);
    assert_eq!((bench.device.state(), bench.status().0), (Op, AlStatus(8)));
}
