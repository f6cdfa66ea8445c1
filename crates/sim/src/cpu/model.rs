//! How long a CPU takes, and what these times are drawn from.

use std::num::NonZeroU32;

use isocat_wire::time::Nanos;

use crate::random::Stream;

/// How long a SubDevice's CPU takes, in ns of its own oscillator.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CpuModel {
    /// Time from an event to the answer of the main loop (state changes, mailbox).
    pub reaction: Nanos,
    /// Time from the SM2 event until outputs are copied and calculated, including interrupt
    /// latency: the value that 0x1C32:06 should state.
    pub copy_outputs: Nanos,
    /// Time of the application's work.
    pub application: Nanos,
    /// Time from Input Latch until inputs are in the buffer: the value that 0x1C33:06 should state.
    pub copy_inputs: Nanos,
    /// Spread, peak to peak, of the time at which the steps of an event begin: interrupts are
    /// sometimes delayed.
    pub jitter: Nanos,
    /// Time from a SYNC pulse until the program reads 0x098E (SYNC1: 0x098F), if its signal stays
    /// active until then: register 0x0982 is 0. It spreads by [`CpuModel::jitter`] like the steps.
    pub acknowledge: Nanos,
    /// Variation of the times above.
    pub unevenness: Unevenness,
}

/// How a CPU's times vary from cycle to cycle. By default they do not vary.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Unevenness {
    /// Longest interrupt latency: from the SM2 event until the outputs are fetched; it is usually
    /// much shorter. It is part of the copy time, not added to it.
    pub latency: Nanos,
    /// How much faster than their stated, longest time copying and the application may be, in
    /// percent, with a uniform distribution.
    pub variation: u8,
    /// Rare cycles in which the application takes longer than its longest time.
    pub overrun: Option<Overrun>,
    /// Spread, peak to peak, of the local timer that shifts outputs and inputs, and of other
    /// delayed actions.
    pub timer_jitter: Nanos,
}

/// An application that takes too long in random cycles.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Overrun {
    /// It happens once in this number of cycles, on average.
    pub one_in: u32,
    /// The additional time.
    pub by: Nanos,
}

impl Default for CpuModel {
    fn default() -> Self {
        Self {
            reaction: Nanos(50_000),
            copy_outputs: Nanos(20_000),
            application: Nanos(10_000),
            copy_inputs: Nanos(10_000),
            jitter: Nanos(0),
            acknowledge: Nanos(0),
            unevenness: Unevenness::default(),
        }
    }
}

/// What the times of steps are drawn from, ns. No time is longer than [`FAR`], so that sums of them
/// stay within their range.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) copy_outputs: Duration,
    pub(super) application: Duration,
    pub(super) copy_inputs: Duration,
    pub(super) timer_jitter: i64,
    pub(super) latency: i64,
    /// The number of cycles of which one takes longer, and by how much.
    pub(super) overrun: Option<(NonZeroU32, i64)>,
}

impl Bounds {
    pub(super) fn new(model: &CpuModel) -> Self {
        let Unevenness { latency, variation, overrun, timer_jitter } = model.unevenness;
        let bound = |time: Nanos| time.0.clamp(-FAR, FAR);
        let variation = i64::from(variation.min(100));
        let duration = |longest: Nanos| {
            let longest = bound(longest);
            Duration { longest, spread: longest / 100 * variation }
        };
        Self {
            copy_outputs: duration(model.copy_outputs),
            application: duration(model.application),
            copy_inputs: duration(model.copy_inputs),
            timer_jitter: bound(timer_jitter),
            latency: bound(latency),
            overrun: overrun.map(|Overrun { one_in, by }| {
                (NonZeroU32::new(one_in).unwrap_or(NonZeroU32::MIN), bound(by))
            }),
        }
    }
}

/// A uniformly distributed time, ns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Duration {
    longest: i64,
    spread: i64,
}

impl Duration {
    #[inline(always)]
    pub(super) fn draw(self, jitter: &mut Stream) -> i64 {
        self.longest - at_random(jitter, self.spread)
    }
}

/// A random time of at most `most`.
#[inline(always)]
pub(super) fn at_random(jitter: &mut Stream, most: i64) -> i64 {
    // Without variation nothing is drawn, so that other random numbers stay the same.
    match most {
        1.. => jitter.up_to(most as u64) as i64,
        _ => 0,
    }
}

/// 36 years.
pub(super) const FAR: i64 = 1 << 60;
