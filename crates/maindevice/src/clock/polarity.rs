//! The polarity of register 0x092C at each clock: what its sign means.
//!
//! Register documentations contradict each other, so it is measured. Each clock gets a delay that
//! is too long by a known amount, which makes its copy of the system time lag by that amount, and
//! then one drift frame. The sign that 0x092C then shows means "behind". This is done while the
//! clocks are still being set: the true delays are written afterwards, and the filters are reset.

use alloc::vec::Vec;

use isocat_wire::StationAddress;
use isocat_wire::dc::DifferencePolarity;
use isocat_wire::time::Nanos;

use super::{drift_frames, settings};
use crate::config::Config;
use crate::error::AccessError;
use crate::link::Link;
use crate::segment::Segment;

/// By how much the delays are too long. It is more than clocks 100 ppm apart drift in the time that
/// a slow host needs from the latch to here, and so little that it hardly moves a loop.
const LAG: Nanos = Nanos(20_000);

/// Measures the polarity of every clock but the reference. A clock that does not show the lag keeps
/// its polarity.
pub(super) async fn learn(
    link: &Link,
    config: &Config,
    segment: &mut Segment,
    reference: usize,
) -> Result<Nanos, AccessError> {
    let begin = link.now();
    // No filter: it would show a part of the lag only.
    settings::write(link, config, segment, LAG, 0).await?;
    let writing = link.now() - begin;
    let clocks: Vec<(usize, StationAddress)> = drift_frames::followers(segment, reference);
    let leader = segment.devices[reference].station;
    drift_frames::drift_frame_that_returns(link, leader).await?;
    for ((at, _), (_, shown)) in
        clocks.iter().zip(drift_frames::read_differences(link, &clocks).await?)
    {
        let off = i64::from(shown.magnitude()) - LAG.0;
        if off.abs() > LAG.0 / 2 {
            continue;
        }
        segment.devices[*at].difference_polarity = match shown.is_negative() {
            true => DifferencePolarity::PositiveAhead,
            false => DifferencePolarity::NegativeAhead,
        };
    }
    Ok(writing)
}
