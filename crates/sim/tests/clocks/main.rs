//! Two ESCs on oscillators of their own, the clock of one following the other's: how well and how fast,
//! and what that makes of SYNC0 and SYNC1 in true time.

mod drift_law;
mod drift_loop;
mod generation;
mod pair;
