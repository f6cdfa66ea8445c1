//! The cost of one cycle for the MainDevice alone: `maindevice N CYCLES`, a line of N SubDevices
//! with 16 bytes in each direction.
//!
//! The line is brought up by a MainDevice as in `scale`. Then the segment is left out: each frame
//! is answered by a copy with the working counters, states and times of the SubDevices, at places
//! found before. `benches/maindevice.sh` counts instructions with it.

use std::process::ExitCode;

use isocat_maindevice::{FRAME_LEN, MainDevice};
use isocat_wire::datagram::Layouts;
use isocat_wire::time::{Host, Nanos, Time};
use isocat_wire::{AlState, Command, frame};

#[path = "../benches/line/mod.rs"]
mod line;

/// The values that the segment writes into one frame of the cycle.
struct Answer {
    /// Place of the reference time.
    time: Option<usize>,
    /// Place of AL status.
    status: Option<usize>,
    /// Places of working counters and their values.
    counters: Vec<(usize, [u8; 2])>,
}

/// A frame on its way, and the segment's answer to the frame at its place in the cycle.
struct Flight {
    buffer: [u8; FRAME_LEN],
    len: usize,
    answer: Option<Answer>,
}

impl Answer {
    fn of(bytes: &[u8], devices: u16) -> Self {
        let offset = frame::payload_offset(bytes).expect("a frame of datagrams");
        let mut answer = Self { time: None, status: None, counters: Vec::new() };
        let mut layouts = Layouts::new();
        while let Some(Ok(layout)) = layouts.next(&bytes[offset..]) {
            let mut counter = devices;
            match layout.header.command() {
                Ok(Command::Frmw) => answer.time = Some(offset + layout.data()),
                Ok(Command::Brd) => answer.status = Some(offset + layout.data()),
                Ok(Command::Lrw) => counter = 3 * (layout.header.len / line::BYTES),
                other => panic!("{other:?} in the cycle"),
            }
            answer.counters.push((offset + layout.wkc(), counter.to_le_bytes()));
        }
        answer
    }

    fn write(&self, bytes: &mut [u8], sent: Time<Host>) {
        // The locally administered bit distinguishes an answer from an echo.
        bytes[6] |= frame::LOCALLY_ADMINISTERED;
        if let Some(at) = self.time {
            put(bytes, at, system_time(sent).to_le_bytes());
        }
        if let Some(at) = self.status {
            bytes[at] = AlState::Op as u8;
        }
        for (at, counter) in &self.counters {
            put(bytes, *at, *counter);
        }
    }
}

fn put<const LEN: usize>(bytes: &mut [u8], at: usize, value: [u8; LEN]) {
    *bytes[at..].first_chunk_mut().expect("a place in the frame") = value;
}

/// The reference clock: 10 ppm faster than the host.
fn system_time(host: Time<Host>) -> u64 {
    5_000_000_000 + host.count() + host.count() / 100_000
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize| arguments.get(at).and_then(|text| text.parse::<u64>().ok());
    let (Some(count), Some(cycles)) = (number(0), number(1)) else {
        eprintln!("usage: maindevice N CYCLES");
        return ExitCode::FAILURE;
    };
    let mut world = match line::world(count as usize) {
        Ok(world) => world,
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    };
    let main = world.main_mut();
    let flight = || Flight { buffer: [0; FRAME_LEN], len: 0, answer: None };
    let mut flights: Vec<Flight> = core::iter::repeat_with(flight).take(MOST_FRAMES).collect();
    // The clock answers differently now: until the servo has adapted, cycles do not count.
    for _ in 0..100 {
        cycle(main, &mut flights, count as u16);
    }
    let (begin, wrong) = (main.statistics().cycles, main.statistics().working_counter_errors);
    for _ in 0..cycles {
        cycle(main, &mut flights, count as u16);
    }
    let statistics = main.statistics();
    assert_eq!(statistics.cycles - begin, cycles);
    assert_eq!(statistics.working_counter_errors, wrong);
    let frames = flights.iter().filter(|flight| flight.answer.is_some()).count();
    println!("{count} SubDevices, {frames} frames a cycle");
    ExitCode::SUCCESS
}

/// Everything that a program does in one cycle: every frame leaves before the first comes back.
fn cycle(main: &mut MainDevice, flights: &mut [Flight], devices: u16) {
    let Some(due) = main.next_timeout() else { return };
    main.handle_timeout(due);
    main.poll_cycle(&mut ());
    let mut number = 0;
    for flight in &mut *flights {
        let Some(len) = main.poll_transmit(due, &mut flight.buffer) else { break };
        flight.len = len;
        number += 1;
    }
    let back = due + Nanos(60_000);
    for flight in &mut flights[..number] {
        let frame = &mut flight.buffer[..flight.len];
        let answer = flight.answer.get_or_insert_with(|| Answer::of(frame, devices));
        answer.write(frame, due);
        main.handle_frame(back, frame);
        main.poll_cycle(&mut ());
    }
    while main.poll_event().is_some() {}
    let _next = main.next_timeout();
}

/// Enough for 1000 SubDevices.
const MOST_FRAMES: usize = 16;
