//! When a cycle is complete, and the cycle of its inputs.

use super::*;

fn running(bench: &mut Bench) -> CyclicExchange {
    let segment = cyclic_segment(bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    cycle.exchange_process_data(true);
    cycle
}

/// Takes a returned frame, and closes the cycle if it is complete.
fn back(cycle: &mut CyclicExchange, bench: &mut Bench, frame: &[u8]) -> Option<(u64, bool)> {
    let taken = bench.link.board(|board| cycle.receive(bench.now, frame, HEADERS, board));
    assert!(taken);
    cycle.close(bench.now);
    cycle.take_closed()
}

/// The cycle of the inputs of the first SubDevice.
fn of(cycle: &mut CyclicExchange) -> Option<u64> {
    cycle.exchanged().1.inputs_cycle(0)
}

#[test]
fn a_cycle_is_over_when_it_is_back_or_the_next_one_is_due() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    assert_eq!(cycle.take_closed(), None);
    let frame = exchange(&mut cycle, &mut bench);
    cycle.close(cycle.due() + Nanos(-1));
    assert_eq!(cycle.take_closed(), None, "its frame is under way");
    assert_eq!(back(&mut cycle, &mut bench, &frame), Some((1, true)));
    assert_eq!(cycle.take_closed(), None, "told once");

    exchange(&mut cycle, &mut bench);
    let (due, link) = (cycle.due(), bench.link.clone());
    let mut buffer = [0; MAX_LEN];
    let mut transmit = |cycle: &mut CyclicExchange| {
        link.board(|board| cycle.transmit(due, &mut buffer, board)).is_some()
    };
    cycle.close(due + Nanos(-1));
    assert_eq!(cycle.take_closed(), None);
    assert!(!transmit(&mut cycle), "nothing of the next cycle leaves before that");
    cycle.close(due);
    assert_eq!(cycle.take_closed(), Some((2, true)));
    assert!(transmit(&mut cycle));
    assert_eq!(cycle.number(), 3);
}

#[test]
fn a_late_frame_is_taken_and_says_of_which_cycle_it_is() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    assert_eq!(of(&mut cycle), None);
    let frame = exchange(&mut cycle, &mut bench);
    back(&mut cycle, &mut bench, &frame);
    assert_eq!(of(&mut cycle), Some(1));
    // The frame of cycle 2 comes in cycle 3, before that of cycle 3.
    let late = exchange(&mut cycle, &mut bench);
    bench.segment.escs[0].memory[0x1180] = 0x33;
    let frame = exchange(&mut cycle, &mut bench);
    assert_eq!(of(&mut cycle), Some(1));
    back(&mut cycle, &mut bench, &late);
    assert_eq!((of(&mut cycle), cycle.inputs()[0]), (Some(2), 0xAA));
    back(&mut cycle, &mut bench, &frame);
    assert_eq!((of(&mut cycle), cycle.inputs()[0]), (Some(3), 0x33));
    // The frame of cycle 4 comes after that of cycle 5: the newer inputs stay.
    let late = exchange(&mut cycle, &mut bench);
    bench.segment.escs[0].memory[0x1180] = 0x55;
    let frame = exchange(&mut cycle, &mut bench);
    assert_eq!(back(&mut cycle, &mut bench, &frame), Some((5, true)));
    assert_eq!(back(&mut cycle, &mut bench, &late), None);
    assert_eq!((of(&mut cycle), cycle.inputs()[0]), (Some(5), 0x55));
}

/// A lost SubDevice keeps its last inputs; after it is back, its first new inputs count.
#[test]
fn one_that_comes_back_is_fresh_with_its_own_inputs_only() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    for _ in 0..2 {
        let frame = exchange(&mut cycle, &mut bench);
        back(&mut cycle, &mut bench, &frame);
    }
    cycle.set_present(0, false);
    let frame = exchange(&mut cycle, &mut bench);
    assert_eq!(back(&mut cycle, &mut bench, &frame), Some((3, true)));
    assert_eq!(of(&mut cycle), Some(2));
    cycle.set_present(0, true);
    assert_eq!(of(&mut cycle), Some(2), "those of cycle 3 were taken without it");
    let frame = exchange(&mut cycle, &mut bench);
    back(&mut cycle, &mut bench, &frame);
    assert_eq!(of(&mut cycle), Some(4));
}

#[test]
fn reference_time_is_that_of_its_cycle() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    let frame = exchange(&mut cycle, &mut bench);
    back(&mut cycle, &mut bench, &frame);
    assert_eq!(cycle.reference_time_of(1), Some(Time::new(bench.segment.time)));
    exchange(&mut cycle, &mut bench);
    assert_eq!(cycle.reference_time_of(2), None, "it is not back");
}
