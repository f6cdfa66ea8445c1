//! Segments in true time: clocks, delays on trees and rings, cables and power that fail, hops
//! that jitter, judges that look on.

mod audience;
mod clocks;
mod delay_trees;
mod delay_zoo;
mod hop_jitter;
mod instants;
#[path = "../../benches/line/mod.rs"]
mod line;
mod link_loss;
mod next_frame;
mod power;
mod servo;
mod support;
