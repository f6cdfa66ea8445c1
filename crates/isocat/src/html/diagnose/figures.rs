//! Data for the drawings of a capture, kept in bounded memory while the capture is read.

use isocat_diagnose::report::Distance;
use isocat_diagnose::{Grid, Measured};
use isocat_engine::recording::series::Series;
use isocat_wire::time::Picos;

/// Series of a capture since operation began.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Time from one cycle to the next by the reference clock, ps.
    by_clock: Series,
    /// The same by the time stamps.
    by_stamps: Series,
    distances: Vec<(Grid, Series)>,
    /// The last instant, ns.
    pub length_ns: u64,
}

impl Default for Figures {
    fn default() -> Self {
        let series = || Series::new(SPANS);
        Self { by_clock: series(), by_stamps: series(), distances: Vec::new(), length_ns: 0 }
    }
}

impl Figures {
    /// Adds a figure of a cycle.
    pub fn push(&mut self, measured: Measured) {
        match measured {
            Measured::Restart => *self = Self::default(),
            Measured::Interval { at_ns, ns } => {
                let at = self.instant(at_ns);
                self.by_stamps.push(at, picos(ns.cast_signed()));
            }
            Measured::IntervalByClock { at_ns, ns } => {
                let at = self.instant(at_ns);
                self.by_clock.push(at, picos(ns.cast_signed()));
            }
            Measured::Distance { at_ns, grid, ns } => {
                let at = self.instant(at_ns);
                let place = self.distances.iter().position(|(known, _)| *known == grid);
                let place = place.unwrap_or_else(|| {
                    self.distances.push((grid, Series::new(SPANS)));
                    self.distances.len() - 1
                });
                self.distances[place].1.push(at, picos(ns));
            }
        }
    }

    /// Time stamps may jump back, but a series must not.
    fn instant(&mut self, at_ns: u64) -> Picos {
        self.length_ns = self.length_ns.max(at_ns);
        Picos(picos(self.length_ns.cast_signed()))
    }

    /// Intervals less their median `median_ns`: by the reference clock if it is known. `None` if
    /// there are none.
    pub fn intervals(&self, by_clock: bool, median_ns: u64) -> Option<Series> {
        let series = if by_clock { &self.by_clock } else { &self.by_stamps };
        (series.count() > 0).then(|| series.shifted(-picos(median_ns.cast_signed())))
    }

    /// Time from cyclic frames at a device to its SYNC0. `None` if it is not known.
    pub fn distance(&self, distance: &Distance) -> Option<Series> {
        let (_, series) = self.distances.iter().find(|(grid, _)| *grid == distance.grid)?;
        Some(series.shifted(-picos(distance.delay_ns)))
    }
}

fn picos(ns: i64) -> i64 {
    ns.saturating_mul(1_000)
}

/// Largest number of spans of a series.
const SPANS: usize = 400;
