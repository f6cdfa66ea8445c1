//! The view of a segment, and the effect of keys.

use isocat_engine::status::{Device, Status};

use super::Trend;

/// Selection and sort order.
#[derive(Clone, Debug)]
pub struct View {
    trend: Trend,
    /// The history at the time when the display was paused.
    held: Option<Box<Trend>>,
    sort: Sort,
    reverse: bool,
    /// Position of the selected SubDevice.
    selected: usize,
    page: Page,
    /// Text at the right of the first line: a speed, an interface.
    pub title: String,
    /// Whether colours are used.
    pub colour: bool,
}

/// The page on the screen.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Page {
    /// All SubDevices.
    Table,
    /// The cycle of the selected SubDevice.
    Cycle,
    /// The help, over another page.
    Help {
        /// Whether the other page is the cycle.
        over_cycle: bool,
    },
}

/// Sort order of the table.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sort {
    /// Place in processing order.
    Position,
    /// Size of the SYNC error, largest first.
    Error,
    /// Margin, least first.
    Margin,
    /// Deviation of the clock, largest first.
    Ppm,
    /// Increase of counters, largest first.
    Counters,
}

impl Sort {
    /// All, in the order of the key.
    pub const ALL: [Sort; 5] =
        [Sort::Position, Sort::Error, Sort::Margin, Sort::Ppm, Sort::Counters];

    /// The name.
    pub const fn name(self) -> &'static str {
        match self {
            Sort::Position => "position",
            Sort::Error => "error",
            Sort::Margin => "margin",
            Sort::Ppm => "ppm",
            Sort::Counters => "counters",
        }
    }
}

/// A key that the view uses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Key {
    /// A letter.
    Char(char),
    /// Arrow up.
    Up,
    /// Arrow down.
    Down,
    /// A page up.
    PageUp,
    /// A page down.
    PageDown,
    /// To the first row.
    Home,
    /// To the last row.
    End,
    /// Enter.
    Enter,
    /// Escape.
    Escape,
}

/// Number of SubDevices that a page key moves by.
const PAGE: isize = 10;

impl View {
    /// A view before anything is known.
    pub fn new(title: String, colour: bool) -> Self {
        Self {
            trend: Trend::default(),
            held: None,
            sort: Sort::Position,
            reverse: false,
            selected: 0,
            page: Page::Table,
            title,
            colour,
        }
    }

    /// Takes the next status.
    pub fn take(&mut self, status: Status) {
        self.trend.take(status);
    }

    /// Handles a key; returns true if the user wants to end.
    pub fn press(&mut self, key: Key) -> bool {
        match (key, self.page) {
            (Key::Char('q' | 'Q'), _) => return true,
            (Key::Char('p' | ' '), _) => {
                self.held = match self.held.take() {
                    Some(_) => None,
                    None => Some(Box::new(self.trend.clone())),
                };
            }
            (Key::Char('?' | 'h'), Page::Table) => self.page = Page::Help { over_cycle: false },
            (Key::Char('?' | 'h'), Page::Cycle) => self.page = Page::Help { over_cycle: true },
            (_, Page::Help { over_cycle }) => {
                self.page = if over_cycle { Page::Cycle } else { Page::Table };
            }
            (Key::Escape, Page::Cycle) => self.page = Page::Table,
            (Key::Enter, Page::Table) if self.current().is_some() => self.page = Page::Cycle,
            (Key::Char('s'), Page::Table) => {
                let at = Sort::ALL.iter().position(|sort| *sort == self.sort).unwrap_or(0);
                self.sort = Sort::ALL[(at + 1) % Sort::ALL.len()];
            }
            (Key::Char('r'), Page::Table) => self.reverse = !self.reverse,
            (Key::Up | Key::Char('k'), _) => self.go(-1),
            (Key::Down | Key::Char('j'), _) => self.go(1),
            (Key::PageUp, _) => self.go(-PAGE),
            (Key::PageDown, _) => self.go(PAGE),
            (Key::Home, _) => self.go(isize::MIN),
            (Key::End, _) => self.go(isize::MAX),
            _ => {}
        }
        false
    }

    /// The shown history: the present one, or that at the time of the pause.
    pub fn trend(&self) -> &Trend {
        self.held.as_deref().unwrap_or(&self.trend)
    }

    /// Whether the display is paused.
    pub fn is_paused(&self) -> bool {
        self.held.is_some()
    }

    /// The page on the screen.
    pub fn page(&self) -> Page {
        self.page
    }

    /// The sort order of the table, and whether it is reversed.
    pub fn sort(&self) -> (Sort, bool) {
        (self.sort, self.reverse)
    }

    /// The SubDevice whose cycle is shown.
    pub fn focus(&self) -> Option<usize> {
        (self.page == Page::Cycle).then_some(self.selected)
    }

    /// The selected SubDevice; `None` if there is none.
    pub fn current(&self) -> Option<&Device> {
        let devices = &self.trend().status()?.devices;
        devices.iter().find(|device| device.position == self.selected)
    }

    /// The SubDevices in the order of the table.
    pub fn rows(&self) -> Vec<&Device> {
        let Some(status) = self.trend().status() else { return Vec::new() };
        let mut rows: Vec<&Device> = status.devices.iter().collect();
        let size = |figure: Option<f64>| figure.map_or(-1.0, f64::abs);
        // The sort is stable, so equal ones stay in the order of the line.
        match self.sort {
            Sort::Position => {}
            Sort::Error => rows.sort_by(|one, other| {
                let error = |device: &Device| size(device.error.map(|error| error.now_ns));
                error(other).total_cmp(&error(one))
            }),
            Sort::Margin => rows.sort_by(|one, other| {
                let margin = |d: &Device| d.margin.map_or(f64::INFINITY, |margin| margin.now_ns);
                margin(one).total_cmp(&margin(other))
            }),
            Sort::Ppm => {
                rows.sort_by(|one, other| size(other.clock_ppm).total_cmp(&size(one.clock_ppm)))
            }
            Sort::Counters => rows.sort_by_key(|device| std::cmp::Reverse(device.risen())),
        }
        if self.reverse {
            rows.reverse();
        }
        rows
    }

    /// Index of the selected SubDevice among the rows.
    pub fn selected_row(&self) -> usize {
        self.rows().iter().position(|device| device.position == self.selected).unwrap_or(0)
    }

    fn go(&mut self, by: isize) {
        let rows = self.rows();
        let Some(last) = rows.len().checked_sub(1) else { return };
        let row = self.selected_row().saturating_add_signed(by).min(last);
        self.selected = rows[row].position;
    }
}
