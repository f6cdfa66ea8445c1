//! Two ESCs on separate oscillators, the clock of one following the other's: how well and how fast,
//! and the effect on SYNC0 and SYNC1 in true time.

mod drift_law;
mod drift_loop;
mod generation;
mod pair;
