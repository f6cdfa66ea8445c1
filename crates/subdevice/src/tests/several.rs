//! Several SyncManagers in one direction: one image for the application, and one buffer for each in
//! the ESC.

use std::boxed::Box;
use std::vec::Vec;

use isocat_esc::Pdi;
use isocat_sync::{Event, SupportedTypes};
use isocat_wire::register::{self, al_event};
use isocat_wire::sync_manager::SyncManager;
use isocat_wire::{AlState, AlStatus, AlStatusCode};

use super::bench::{Bench, Call};
use crate::description::{Behaviour, Description, ProcessDataArea};
use crate::process_data::{Buffer, Buffers, Images, ProcessData};

use AlState::{Op, PreOp, SafeOp};

const fn area(sync_manager: u8, start: u16, max_length: u16) -> ProcessDataArea {
    ProcessDataArea { sync_manager, start, max_length }
}

/// A device in PREOP. Outputs are 3 bytes in SM2 and 2 in SM4, inputs 2 bytes in SM3 and 4 in SM5.
fn bench() -> Bench {
    let description = Description {
        objects: &[],
        mailbox: None,
        outputs: area(2, 0x1100, 3),
        inputs: area(3, 0x1400, 2),
        further_outputs: const { &[area(4, 0x1200, 2)] },
        further_inputs: const { &[area(5, 0x1500, 4)] },
        behaviour: Behaviour { undeclared_types: SupportedTypes(0b010), ..Behaviour::default() },
    };
    let mut bench = Bench::new(Box::leak(Box::new(description)));
    assert_eq!(bench.ask(PreOp), ok(PreOp));
    bench.set_process_data(3, 2);
    set(&mut bench, 4, 0x1200, 2, SyncManager::OUTPUTS);
    set(&mut bench, 5, 0x1500, 4, SyncManager::INPUTS);
    bench
}

fn set(bench: &mut Bench, number: usize, start: u16, length: u16, control: u8) {
    bench.esc.set_sm(number, SyncManager::new(start, length, control, length > 0));
}

fn ok(state: AlState) -> (AlStatus, AlStatusCode) {
    (AlStatus::new(state), AlStatusCode::NO_ERROR)
}

fn in_op() -> Bench {
    let mut bench = bench();
    assert_eq!(bench.ask(SafeOp), ok(SafeOp));
    bench.ask(Op);
    bench.write_outputs(&[0; 3]);
    bench.cycle(Event::Sm2);
    assert_eq!(bench.status(), ok(Op));
    bench
}

#[test]
fn the_application_has_one_image_of_each_direction() {
    let mut bench = in_op();
    bench.calls();
    bench.esc.memory[0x1200..0x1203].copy_from_slice(&[4, 5, 6]);
    bench.write_outputs(&[1, 2, 3]);
    bench.cycle(Event::Sm2);
    let mapped: std::vec::Vec<_> = bench.calls();
    assert!(mapped.contains(&Call::Map([1, 2, 3, 4, 5].to_vec())), "{mapped:?}");
    let count = bench.esc.memory[0x1400];
    assert!(count > 1);
    assert_eq!(bench.esc.memory[0x1400..0x1403], [count, count, 0]);
    assert_eq!(bench.esc.memory[0x1500..0x1505], [count, count, count, count, 0]);
}

/// One byte too few and one too many in the second SyncManager, and the possible start of its three
/// buffers.
#[test]
fn each_sync_manager_is_checked() {
    let outputs = AlStatusCode::INVALID_OUTPUT_CONFIGURATION;
    let inputs = AlStatusCode::INVALID_INPUT_CONFIGURATION;
    let refused = |code| (AlStatus::new(PreOp).with_error(true), code);
    for (number, start, length, control, answer) in [
        (4, 0x1200, 2, SyncManager::OUTPUTS, ok(SafeOp)),
        (4, 0x1200, 1, SyncManager::OUTPUTS, refused(outputs)),
        (4, 0x1200, 3, SyncManager::OUTPUTS, refused(outputs)),
        (4, 0x1200, 0, SyncManager::OUTPUTS, refused(outputs)),
        (4, 0x1201, 2, SyncManager::OUTPUTS, refused(outputs)),
        (4, 0x1200, 2, SyncManager::INPUTS, refused(outputs)),
        (5, 0x1500, 3, SyncManager::INPUTS, refused(inputs)),
        (5, 0x1500, 4, SyncManager::OUTPUTS, refused(inputs)),
    ] {
        let mut bench = bench();
        set(&mut bench, number, start, length, control);
        assert_eq!(bench.ask(SafeOp), answer, "SM{number} {length} bytes at {start:#06x}");
    }
}

/// In the device's description the second area follows the three buffers of the first, or overlaps
/// them by one byte.
#[test]
fn buffers_of_one_direction_do_not_overlap() {
    for (start, right) in [(0x1109, true), (0x1108, false)] {
        let description = Description {
            objects: &[],
            mailbox: None,
            outputs: area(2, 0x1100, 3),
            inputs: area(3, 0x1400, 0),
            further_outputs: Box::leak(Box::new([area(4, start, 2)])),
            further_inputs: &[],
            behaviour: Behaviour {
                undeclared_types: SupportedTypes(0b010),
                ..Behaviour::default()
            },
        };
        let mut bench = Bench::new(Box::leak(Box::new(description)));
        bench.ask(PreOp);
        bench.set_process_data(3, 0);
        set(&mut bench, 4, start, 2, SyncManager::OUTPUTS);
        assert_eq!(bench.ask(SafeOp) == ok(SafeOp), right, "{start:#06x}");
    }
}

/// If one of them stayed open, frames would still have a complete working counter.
#[test]
fn an_error_closes_all_outputs_until_it_is_acknowledged() {
    let mut bench = in_op();
    let closed = |bench: &Bench| {
        [2, 3, 4, 5].map(|number| bench.get(register::sm_pdi_control(number)) & 1 != 0)
    };
    assert_eq!(closed(&bench), [false; 4]);
    bench.esc.events |= al_event::WATCHDOG;
    bench.poll();
    assert_eq!(bench.status().1, AlStatusCode::WATCHDOG);
    assert_eq!(closed(&bench), [true, false, true, false]);
    assert_eq!(bench.acknowledge(SafeOp), ok(SafeOp));
    assert_eq!(closed(&bench), [false; 4]);
    assert_eq!(bench.ask(PreOp), ok(PreOp));
    assert_eq!(closed(&bench), [true; 4]);
}

/// The image of a direction has 1486 bytes for all of its buffers, as a datagram has; one more is
/// refused.
#[test]
fn all_buffers_fit_in_one_image() {
    for (second, right) in [(486, true), (487, false)] {
        let description = Description {
            objects: &[],
            mailbox: None,
            outputs: area(2, 0x1100, 1000),
            inputs: area(3, 0x1400, 0),
            further_outputs: Box::leak(Box::new([area(4, 0x1CB8, second)])),
            further_inputs: &[],
            behaviour: Behaviour {
                undeclared_types: SupportedTypes(0b010),
                ..Behaviour::default()
            },
        };
        let mut bench = Bench::new(Box::leak(Box::new(description)));
        bench.ask(PreOp);
        bench.set(register::RAM_SIZE, 8);
        bench.set_process_data(1000, 0);
        set(&mut bench, 4, 0x1CB8, second, SyncManager::OUTPUTS);
        assert_eq!(bench.ask(SafeOp) == ok(SafeOp), right, "1000 and {second} bytes");
    }
}

/// Outputs that will not be used are acknowledged by their first and last byte; outputs fetched
/// before are kept.
#[test]
fn dropped_outputs_leave_the_image_as_it_is() {
    let mut bench = in_op();
    let buffers =
        Buffers::of(&[Buffer { start: 0x1100, length: 3 }, Buffer { start: 0x1200, length: 1 }]);
    let mut image = [7; 4];
    let mut data = ProcessData::new();
    data.start(buffers, Buffers::NONE, Images { outputs: &mut image, inputs: &mut [] });
    assert_eq!(data.outputs(&image), [0; 4], "nothing is left of what ran before");
    bench.esc.memory[0x1100..0x1103].copy_from_slice(&[1, 2, 3]);
    bench.esc.memory[0x1200] = 4;
    data.fetch_outputs(&mut image, &mut bench.esc);
    assert_eq!(data.outputs(&image), [1, 2, 3, 4]);
    let mut reads = Reads(Vec::new());
    data.drop_outputs(&mut reads);
    assert_eq!(reads.0, [(0x1100, 1), (0x1102, 1), (0x1200, 1)]);
    assert_eq!(data.outputs(&image), [1, 2, 3, 4]);
    // An image that is shorter than the buffers is filled up to its end.
    bench.esc.memory[0x1100..0x1103].fill(9);
    let mut short = [0; 2];
    data.fetch_outputs(&mut short, &mut bench.esc);
    assert_eq!(data.outputs(&short), [9, 9]);
}

/// An ESC that records reads.
struct Reads(Vec<(u16, usize)>);

impl Pdi for Reads {
    fn read(&mut self, address: u16, data: &mut [u8]) {
        self.0.push((address, data.len()));
    }

    fn write(&mut self, _: u16, _: &[u8]) {}
}
