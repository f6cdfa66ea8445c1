//! SubDevices whose process data are exchanged only in every fifth cycle, next to one of every
//! cycle.

use super::*;

/// The first SubDevice in every cycle, the second one in every fifth.
fn grouped(bench: &mut Bench) -> Segment {
    let mut segment = cyclic_segment(bench);
    segment.devices[1].every = 5;
    let chunk = |every, first: usize, writers, readers| Chunk {
        every,
        logical: 2 * first as u32,
        length: 2,
        first,
        end: first + 1,
        writers,
        readers,
    };
    let chunks = std::vec![chunk(1, 0, 1, 1), chunk(5, 1, 1, 0)];
    segment.image = ProcessImage { chunks, read_write: true };
    segment
}

fn running(bench: &mut Bench) -> CyclicExchange {
    let segment = grouped(bench);
    let config = Config::new(Nanos(1_000_000));
    let mut cycle = CyclicExchange::new(&config, &segment, bench.now, config.source);
    cycle.exchange_process_data(true);
    for _ in 0..50 {
        all(&mut cycle, bench, |_| true);
    }
    assert!(cycle.is_locked());
    bench.events();
    cycle
}

/// Runs one cycle at its due time. Returns its number by system time, and its frames; `back` tells
/// which come back.
fn all(
    cycle: &mut CyclicExchange,
    bench: &mut Bench,
    back: impl Fn(usize) -> bool,
) -> (u64, usize) {
    bench.now = cycle.due();
    bench.segment.time = 5_000_000_777 + bench.now.count();
    let number = (bench.segment.time + 500_000) / 1_000_000;
    let link = bench.link.clone();
    let mut buffer = [0; MAX_LEN];
    let mut frames = Vec::new();
    cycle.close(bench.now);
    while let Some(len) = link.board(|board| cycle.transmit(bench.now, &mut buffer, board)) {
        frames.push(buffer[..len].to_vec());
    }
    for (at, frame) in frames.iter_mut().enumerate().filter(|(at, _)| back(*at)) {
        bench.segment.pass(frame);
        let taken = link.board(|board| cycle.receive(bench.now, frame, HEADERS, board));
        assert!(taken, "frame {at}");
    }
    (number, frames.len())
}

#[test]
fn the_frame_of_a_slow_group_leaves_in_its_cycles() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    for _ in 0..40 {
        let (number, frames) = all(&mut cycle, &mut bench, |_| true);
        assert_eq!(frames, if number % 5 == 0 { 2 } else { 1 }, "{number}");
    }
    assert_eq!(bench.events(), []);
}

/// Groups follow the number of the cycle by system time, not the count of cycles.
#[test]
fn skipped_cycles_leave_groups_in_their_cycles() {
    for slept in [3, 4, 5, 6, 7, 40] {
        let mut bench = Bench::new(2);
        let mut cycle = running(&mut bench);
        let due = cycle.due();
        let link = bench.link.clone();
        let mut buffer = [0; MAX_LEN];
        bench.now = due + Nanos(slept * 1_000_000 - 300_000);
        cycle.close(bench.now);
        assert_eq!(link.board(|board| cycle.transmit(bench.now, &mut buffer, board)), None);
        for _ in 0..20 {
            let (number, frames) = all(&mut cycle, &mut bench, |_| true);
            assert_eq!(frames, if number % 5 == 0 { 2 } else { 1 }, "{slept}: {number}");
        }
        assert_eq!(link.board(|board| board.statistics.cycles_skipped), slept as u64);
    }
}

#[test]
fn a_group_that_counts_wrongly_is_told_alone() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    let fmmu = register::fmmu(0).load(&bench.segment.escs[1].memory);
    register::fmmu(0).store(&mut bench.segment.escs[1].memory, Fmmu::default());
    for _ in 0..10 {
        all(&mut cycle, &mut bench, |_| true);
    }
    register::fmmu(0).store(&mut bench.segment.escs[1].memory, fmmu);
    for _ in 0..10 {
        all(&mut cycle, &mut bench, |_| true);
    }
    let events = bench.events();
    let wrong = |event: &Event| match event {
        Event::WorkingCounter { chunk, expected, found, .. } => Some((*chunk, *expected, *found)),
        Event::WorkingCounterRestored { chunk, cycles, .. } => Some((*chunk, *cycles as u16, 0)),
        _ => None,
    };
    let seen: Vec<_> = events.iter().filter_map(wrong).collect();
    assert_eq!((seen.as_slice(), events.len()), (&[(1, 2, 0), (1, 2, 0)][..], 2), "{events:?}");
    let link = bench.link.clone();
    assert_eq!(link.board(|board| board.statistics.working_counter_errors), 2);
}

#[test]
fn a_lost_slow_frame_is_counted_and_stops_nothing() {
    let mut bench = Bench::new(2);
    let mut cycle = running(&mut bench);
    while all(&mut cycle, &mut bench, |at| at == 0).1 != 2 {}
    let (lost, link) = (cycle.number(), bench.link.clone());
    let complete = link.board(|board| board.complete_cycles);
    for _ in 0..20 {
        let (number, frames) = all(&mut cycle, &mut bench, |_| true);
        assert_eq!(frames, if number % 5 == 0 { 2 } else { 1 }, "{number}");
    }
    assert_eq!(bench.events(), [Event::FrameLost { cycle: lost, frame: 1 }]);
    assert_eq!(link.board(|board| board.statistics.frames_lost), 1);
    assert_eq!(link.board(|board| board.complete_cycles), complete + 19);
}
