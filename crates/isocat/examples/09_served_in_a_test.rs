//! The served segment inside a test: somebody's MainDevice against simulated SubDevices, without an
//! interface, in a time that the test moves. Here it is isocat's own MainDevice; any other takes
//! its place between `poll_transmit` and `handle_frame`.
//!
//! `cargo test -p isocat --example 09_served_in_a_test`, or `cargo run` for the summary.

use std::collections::VecDeque;

use isocat::serve::{Answer, Server, Summary};
use isocat::{Nanos, Scenario, SegmentFile};
use isocat_maindevice::{Config, Event, FRAME_LEN, MainDevice};
use isocat_wire::time::{Host, Time};

/// Brings the segment up and runs it for `span`, pressing the button of device 1 on the way; gives
/// the segment as it stands then.
fn session(span: Nanos) -> (Server, MainDevice) {
    let text = "cycle = \"1ms\"\n[[subdevice]]\ndevice = \"simple_io4\"\ncount = 3\n";
    let file = SegmentFile::parse("three of them", text).expect("a segment");
    let mut now: Time<Host> = Time::new(1_000_000_000);
    let mut server = Server::new(&Scenario::from(file), now);
    let mut main = MainDevice::new(Config::new(Nanos::millis(1)), now);
    let mut back: VecDeque<(Time<Host>, Vec<u8>)> = VecDeque::new();
    let mut end = None;
    while end.is_none_or(|end| now < end) {
        let mut buffer = [0; FRAME_LEN];
        while let Some(len) = main.poll_transmit(now, &mut buffer) {
            let mut bytes = buffer[..len].to_vec();
            if let Answer::Back { last_bit, .. } = server.frame(now, &mut bytes) {
                back.push_back((last_bit, bytes.clone()));
            }
            server.after(&bytes);
        }
        while let Some(event) = main.poll_event() {
            match event {
                Event::InOperation { .. } => {
                    end = Some(now + span);
                    main.outputs_mut(0).fill(0x3C);
                    server.set_inputs(1, Some(&[0x01]));
                }
                Event::Failed(error) => panic!("{error}"),
                _ => {}
            }
        }
        let due = main.next_timeout().expect("it goes on");
        match back.front() {
            Some((at, _)) if *at <= due => {
                let (at, bytes) = back.pop_front().expect("it is there");
                now = now.max(at);
                main.handle_frame(now, &bytes);
            }
            _ => {
                now = now.max(due);
                main.handle_timeout(now);
            }
        }
    }
    server.finish(now);
    (server, main)
}

fn main() {
    let (server, _) = session(Nanos::millis(200));
    println!("{}", Summary::new(&server, "three of them", "no interface", Nanos::ZERO).text());
}

#[test]
fn the_button_is_seen_and_the_lamp_is_lit() {
    let (server, main) = session(Nanos::millis(200));
    assert_eq!(main.inputs(1)[0], 0x01, "the button");
    assert_eq!(server.outputs(0), Some(vec![0x3C; 4]), "the lamp");
    let session = &server.sessions()[0];
    assert!(session.judged.as_ref().is_some_and(|judged| judged.in_sync()), "in true time");
}
