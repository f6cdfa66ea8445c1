//! Listening to an interface, without sending: what `record` and `diagnose --interface` share.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use isocat_host::{LinkError, Listener, clock};
use isocat_wire::Nanos;

/// What a listener hears.
pub enum Heard<'a> {
    /// A frame that left (`sent`) or came in at `at`, wall time since 1970.
    Frame { at: Duration, sent: bool, bytes: &'a [u8] },
    /// It is this time, and no frame waits; about a hundred times a second if none comes.
    Quiet(Duration),
    /// The interface went down.
    Down(Duration),
}

/// Listens for `span`, or without it until `stop` is set. An interface that goes down is waited
/// for; one that is deleted is an error.
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

/// Longer than any frame of EtherCAT.
const BUFFER: usize = 2048;
/// Frames that are taken before it is looked whether to end.
const MOST_AT_ONCE: usize = 256;
/// From one look at the clock to the next, where no frame comes.
const WAIT_MS: u32 = 10;
