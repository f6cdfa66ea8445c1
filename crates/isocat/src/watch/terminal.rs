//! The loop with a terminal: it draws, handles keys, and always restores the terminal.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use isocat_engine::status::Status;
use ratatui::crossterm::event::{
    self, Event as Input, KeyCode, KeyEvent, KeyEventKind, KeyModifiers,
};

use super::gate::Outcome;
use super::view::{Key, View};
use super::{Gate, Source, Trend, plain, screen};

/// The end of the loop.
#[derive(Clone, Debug)]
pub struct End {
    /// The result of the gate, if there was one and it opened or closed.
    pub outcome: Option<Outcome>,
    /// The last status.
    pub status: Option<Status>,
    /// Whether the reader of the lines has gone.
    pub unread: bool,
}

/// A further receiver of each status: the metrics.
pub type Reader<'a> = &'a mut dyn FnMut(&Status);

/// Time from one poll of the source to the next.
const LOOK: Duration = Duration::from_millis(20);
/// Time from one drawing to the next, if no key is pressed.
const DRAW: Duration = Duration::from_millis(100);
/// Time of the segment from one set of lines to the next.
const TICK_NS: i64 = 1_000_000_000;

/// The common part of all loops.
struct Taker<'a> {
    source: &'a Source,
    gate: Option<&'a mut Gate>,
    within_ns: Option<i64>,
    reader: Reader<'a>,
    end: End,
    over: bool,
    origin: Option<i64>,
}

impl Taker<'_> {
    /// Takes all waiting statuses, and calls `show` with each.
    fn take(&mut self, mut show: impl FnMut(Status)) {
        // The thread ends after its last status, so its end is checked first.
        let ended = self.source.is_over();
        while let Some(status) = self.source.take() {
            (self.reader)(&status);
            let origin = *self.origin.get_or_insert(match status.kind {
                isocat_engine::status::Kind::Served => status.at_ns,
                _ => 0,
            });
            if let Some(gate) = &mut self.gate {
                self.end.outcome = gate.take(&status);
            } else if self.within_ns.is_some_and(|within| status.at_ns - origin >= within) {
                self.over = true;
            }
            self.over |= self.end.outcome.is_some() || status.has_ended();
            self.end.status = Some(status.clone());
            show(status);
            if self.over {
                return;
            }
        }
        self.over |= ended;
    }

    /// Whether the segment failed and the screen stays, so that the user can read where.
    fn is_to_be_read(&self) -> bool {
        let failed = |status: &Status| status.has_ended() && status.failure.is_some();
        self.gate.is_none()
            && self.within_ns.is_none()
            && self.end.status.as_ref().is_some_and(failed)
    }
}

/// Shows the segment on the terminal until the user ends it.
pub fn run(
    source: &Source,
    view: &mut View,
    gate: Option<&mut Gate>,
    within_ns: Option<i64>,
    stop: &AtomicBool,
    reader: Reader<'_>,
) -> io::Result<End> {
    let mut taker = taker(source, gate, within_ns, reader);
    // The terminal is restored after a panic, too.
    let mut terminal = ratatui::try_init()?;
    let result = (|| {
        let mut drawn: Option<Instant> = None;
        while (!taker.over || taker.is_to_be_read()) && !stop.load(Ordering::Relaxed) {
            taker.take(|status| view.take(status));
            let mut changed = drawn.is_none_or(|drawn| drawn.elapsed() >= DRAW);
            if event::poll(LOOK)? {
                match event::read()? {
                    Input::Key(key) if key.kind != KeyEventKind::Release => {
                        if ends(&key) || key_of(&key).is_some_and(|key| view.press(key)) {
                            break;
                        }
                        source.look_at(view.focus());
                        changed = true;
                    }
                    Input::Resize(..) => changed = true,
                    _ => {}
                }
            }
            if changed {
                terminal.draw(|frame| screen::draw(frame, view))?;
                drawn = Some(Instant::now());
            }
        }
        Ok(())
    })();
    let restored = ratatui::try_restore();
    result.and(restored).map(|()| taker.end)
}

/// Prints lines until the user ends it. If the reader goes away, it ends without an error.
pub fn print(
    source: &Source,
    gate: Option<&mut Gate>,
    within_ns: Option<i64>,
    stop: &AtomicBool,
    reader: Reader<'_>,
) -> io::Result<End> {
    let mut taker = taker(source, gate, within_ns, reader);
    let mut trend = Trend::default();
    let mut next: Option<i64> = None;
    let mut read = true;
    while !taker.over && !stop.load(Ordering::Relaxed) {
        let mut text = String::new();
        taker.take(|status| {
            let (at, ended) = (status.at_ns, status.has_ended());
            let events = trend.take(status);
            let Some(status) = trend.status() else { return };
            text += &plain::events(status, &events);
            if ended || next.is_none_or(|next| at >= next) {
                text += &plain::lines(&trend);
                // Lines are on the grid of whole seconds, however late this one was.
                next = Some((at / TICK_NS + 1) * TICK_NS);
            }
        });
        match if read { write(&text) } else { Ok(()) } {
            // A gate is still waited for.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                read = false;
                taker.end.unread = true;
                taker.over |= taker.gate.is_none();
            }
            result => result?,
        }
        if !taker.over {
            std::thread::sleep(LOOK);
        }
    }
    Ok(taker.end)
}

fn taker<'a>(
    source: &'a Source,
    gate: Option<&'a mut Gate>,
    within_ns: Option<i64>,
    reader: Reader<'a>,
) -> Taker<'a> {
    let end = End { outcome: None, status: None, unread: false };
    Taker { source, gate, within_ns, reader, end, over: false, origin: None }
}

fn write(text: &str) -> io::Result<()> {
    if text.is_empty() {
        return Ok(());
    }
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// Whether standard input and output are a terminal.
pub fn is_there() -> bool {
    io::stdout().is_terminal() && io::stdin().is_terminal()
}

/// Whether the key is Ctrl-C, which is a normal key in raw mode.
fn ends(key: &KeyEvent) -> bool {
    key.modifiers.contains(KeyModifiers::CONTROL) && matches!(key.code, KeyCode::Char('c' | 'C'))
}

fn key_of(key: &KeyEvent) -> Option<Key> {
    Some(match key.code {
        KeyCode::Char(letter) => Key::Char(letter),
        KeyCode::Up => Key::Up,
        KeyCode::Down => Key::Down,
        KeyCode::PageUp => Key::PageUp,
        KeyCode::PageDown => Key::PageDown,
        KeyCode::Home => Key::Home,
        KeyCode::End => Key::End,
        KeyCode::Enter => Key::Enter,
        KeyCode::Esc => Key::Escape,
        _ => return None,
    })
}
