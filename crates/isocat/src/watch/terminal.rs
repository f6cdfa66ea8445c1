//! The loop with a terminal: draws, takes keys, and gives the terminal back as it was, whatever happens.

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

/// How it ended.
#[derive(Clone, Debug)]
pub struct End {
    /// The gate, if there was one and it opened or closed.
    pub outcome: Option<Outcome>,
    /// The last status.
    pub status: Option<Status>,
    /// Who read the lines went away.
    pub unread: bool,
}

/// Who else is shown each status: the metrics.
pub type Reader<'a> = &'a mut dyn FnMut(&Status);

/// From one look at the source to the next.
const LOOK: Duration = Duration::from_millis(20);
/// From one drawing to the next, if no key is pressed.
const DRAW: Duration = Duration::from_millis(100);
/// Time of the segment from one set of lines to the next.
const TICK_NS: i64 = 1_000_000_000;

/// What every loop does with statuses.
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
    /// Takes all that is there; `show` is told each.
    fn take(&mut self, mut show: impl FnMut(Status)) {
        // The thread ends behind its last status, so whether it has ended is asked first.
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
}

/// Shows it on the terminal until somebody ends it.
pub fn run(
    source: &Source,
    view: &mut View,
    gate: Option<&mut Gate>,
    within_ns: Option<i64>,
    stop: &AtomicBool,
    reader: Reader<'_>,
) -> io::Result<End> {
    let mut taker = taker(source, gate, within_ns, reader);
    // It restores the terminal if something panics, too.
    let mut terminal = ratatui::try_init()?;
    let result = (|| {
        let mut drawn: Option<Instant> = None;
        while !taker.over && !stop.load(Ordering::Relaxed) {
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

/// Prints lines until somebody ends it. A reader that went away is no error: it ends.
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
                text += &plain::lines(status);
                // On the grid of whole seconds, however late this one came.
                next = Some((at / TICK_NS + 1) * TICK_NS);
            }
        });
        match if read { write(&text) } else { Ok(()) } {
            // A gate is waited for all the same.
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

/// Whether both ends of the terminal are there.
pub fn is_there() -> bool {
    io::stdout().is_terminal() && io::stdin().is_terminal()
}

/// In raw mode Ctrl-C is a key.
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
