//! Listens to an interface without sending: the common part of `record` and `diagnose --interface`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isocat_host::{LinkError, Listener, clock};
use isocat_wire::Nanos;

/// An event of a listener.
pub enum Heard<'a> {
    /// A frame that was sent (`sent`) or received at `at`, wall time since 1970.
    Frame { at: Duration, sent: bool, bytes: &'a [u8] },
    /// No frame waits at this time; about a hundred times per second if none comes.
    Quiet(Duration),
    /// The interface went down.
    Down(Duration),
}

/// Listens for `span`, or without it until `stop` is set. If the interface goes down, it waits; if
/// it is deleted, that is an error.
pub fn listen(
    listener: &mut Listener,
    span: Option<Nanos>,
    stop: &AtomicBool,
    take: &mut dyn FnMut(Heard<'_>),
) -> Result<(), LinkError> {
    let wall = clock::wall_offset();
    let wall = |ns: u64| Duration::from_nanos(ns.saturating_add_signed(wall));
    let now = || wall(clock::now().count());
    let end = span.map(|span| now() + Duration::from_nanos(span.0.max(0) as u64));
    let mut buffer = [0; BUFFER];
    while !stop.load(Ordering::Relaxed) && end.is_none_or(|end| now() < end) {
        // A flood of frames does not hide a signal.
        for _ in 0..MOST_AT_ONCE {
            match listener.receive(&mut buffer) {
                Ok(Some(heard)) => take(Heard::Frame {
                    at: wall(heard.at.count()),
                    sent: heard.sent,
                    bytes: &buffer[..heard.len.min(BUFFER)],
                }),
                Ok(None) => {
                    take(Heard::Quiet(now()));
                    listener.wait(WAIT_MS)?;
                    break;
                }
                Err(LinkError::Down(_)) if listener.is_there() => {
                    take(Heard::Down(now()));
                    break;
                }
                Err(error) => return Err(error),
            }
        }
    }
    Ok(())
}

/// Longer than any EtherCAT frame.
const BUFFER: usize = 2048;
/// Largest number of frames between two checks for the end.
const MOST_AT_ONCE: usize = 256;
/// Time from one check of the clock to the next without frames.
const WAIT_MS: u32 = 10;
