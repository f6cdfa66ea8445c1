//! A scan on an interface: the MainDevice's survey in host time.

use std::sync::atomic::{AtomicBool, Ordering};

use isocat_host::{Exchange, RawSocket, Waiting, clock};
use isocat_maindevice::{Config, Event, Stage};
use isocat_wire::time::Nanos;

use crate::scan::{Failure, NO_END, Scan, WAY_DOWN};

/// Scans the segment behind an interface, and returns it to INIT. It ends early once `stop` is set.
pub fn scan(
    config: Config,
    socket: RawSocket,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(Stage),
) -> Scan {
    let objects = config.survey.is_none_or(|wish| wish.objects);
    // There is no cycle, so nothing is due at an instant.
    let mut exchange =
        Exchange::new(config, socket, Waiting::Sleep { lead: Nanos::ZERO }, None, ());
    let limit = clock::now() + LIMIT;
    let failure = loop {
        if let Some(event) = exchange.poll_event() {
            match event {
                Event::Progress(stage) => progress(stage),
                Event::Surveyed => break None,
                Event::Failed(error) => break Some(Failure::Gave(error)),
                _ => {}
            }
            continue;
        }
        if stop.load(Ordering::Relaxed) {
            break Some(Failure::Ended("ended by a signal".to_owned()));
        }
        match exchange.step(limit) {
            Ok(true) if clock::now() < limit => {}
            Ok(_) => break Some(Failure::TooLong(exchange.main().stage())),
            Err(error) => break Some(Failure::Ended(error.to_string().replace('\n', "; "))),
        }
    };
    let mut scan = Scan {
        segment: exchange.main().segment().clone(),
        objects,
        statistics: exchange.main().statistics(),
        failure,
        way_down: None,
    };
    if !matches!(scan.failure, Some(Failure::Gave(_))) {
        scan.way_down = go_down(&mut exchange).err();
    }
    scan
}

/// Goes back to INIT; the error says why that failed.
fn go_down(exchange: &mut Exchange<()>) -> Result<(), String> {
    let limit = clock::now() + WAY_DOWN;
    exchange.main_mut().stop();
    loop {
        while let Some(event) = exchange.poll_event() {
            match event {
                Event::Stopped => return Ok(()),
                Event::Failed(error) => return Err(error.to_string()),
                _ => {}
            }
        }
        match exchange.step(limit) {
            Ok(true) if clock::now() < limit => {}
            Ok(_) => return Err(NO_END.to_owned()),
            Err(error) => return Err(error.to_string().replace('\n', "; ")),
        }
    }
}

/// Time limit of a scan; every step of it has a much shorter deadline.
const LIMIT: Nanos = Nanos::millis(600_000);
