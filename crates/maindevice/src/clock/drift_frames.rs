//! Drift frames in addition to those of the cycle, and what 0x092C shows of them.

use alloc::vec::Vec;
use core::future::Future;
use core::pin::Pin;
use core::task::Poll;

use isocat_sync::drift::Limits;
use isocat_wire::StationAddress;
use isocat_wire::command::Command;
use isocat_wire::datagram::Address;
use isocat_wire::dc::SystemTimeDifference;
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Host, Nanos, Time};

use super::pace::Pace;
use super::settings::depths;
use crate::config::Config;
use crate::delay;
use crate::error::AccessError;
use crate::link::{Exchange, Link, Travel};
use crate::segment::Segment;

/// One drift frame. It travels alone since a loop takes one value for each frame, and it is not
/// repeated since a repetition would bring another time.
///
/// The reference clock overwrites the time that is sent. If the reference is absent, the clocks
/// behind it use the time that was sent: the host's estimate is near, zeros would pull them away.
pub(super) fn drift_frame(link: &Link, reference: StationAddress) -> Exchange {
    let address = Address::Station(reference, register::SYSTEM_TIME.address);
    let travel = Travel { alone: true, once: true, ..Travel::default() };
    let guess = link.with(|shared| {
        shared.board.statistics.drift_frames += 1;
        let (host, dc) = shared.board.reference_time;
        if dc == Time::ZERO { dc } else { dc + (shared.port.now - host) }
    });
    link.exchange(Command::Frmw, address, guess.count().to_bytes().to_vec(), travel)
}

/// Sends a drift frame until one comes back. Some may be lost.
pub(super) async fn drift_frame_that_returns(
    link: &Link,
    reference: StationAddress,
) -> Result<(), AccessError> {
    let mut tries = 0;
    while let Err(error) = drift_frame(link, reference).reply().await {
        tries += 1;
        if tries > MOST_TRIES {
            return Err(error);
        }
    }
    Ok(())
}

/// A stream of drift frames.
pub(super) struct Burst<'a> {
    link: &'a Link,
    station: StationAddress,
    /// Working counter that each frame must return: the reference read, all other clocks written.
    count: u16,
    /// Time from one frame to the next.
    pace: Pace,
    /// When intervals began; `None` while they stay the shortest.
    begin: Option<Time<Host>>,
    in_flight: Vec<Exchange>,
}

impl<'a> Burst<'a> {
    /// A burst from the clock at `station`, each frame with the working counter `count`. Intervals
    /// are the shortest of the pace until it begins.
    pub fn new(link: &'a Link, station: StationAddress, count: u16, pace: Pace) -> Self {
        Self { link, station, count, pace, begin: None, in_flight: Vec::new() }
    }

    /// Lets the pace begin, as if it had begun at this instant.
    pub fn begin(&mut self, at: Time<Host>) {
        self.begin = Some(at);
    }

    /// Lets intervals grow further than their pace does, as far as the `cycle`.
    pub fn stretch(&mut self, cycle: Nanos) {
        if let Some(begin) = self.begin {
            self.pace = self.pace.stretched(self.link.now() - begin, cycle);
        }
    }

    /// Lets intervals stay as they are for this time.
    pub fn pause(&mut self, span: Nanos) {
        self.begin = self.begin.map(|begin| begin + span);
    }

    /// Sends one frame each pace until `end`. A lost frame does not delay the others.
    pub async fn until(&mut self, end: Time<Host>) -> Result<(), AccessError> {
        while self.link.now() < end {
            let now = self.link.now();
            let interval =
                self.begin.map_or(self.pace.shortest(), |begin| self.pace.at(now - begin));
            let next = now + interval;
            if self.in_flight.len() < IN_FLIGHT {
                self.in_flight.push(drift_frame(self.link, self.station));
            }
            self.link.until(next).await;
            self.take(false).await?;
        }
        Ok(())
    }

    /// Waits for the frames in flight.
    pub async fn finish(mut self) -> Result<(), AccessError> {
        self.take(true).await
    }

    /// Takes the frames that are back or lost; with `all` it waits for the others. A lost drift
    /// frame is harmless, since the next one brings a newer time. A wrong working counter is an
    /// error: a clock does not get the time.
    async fn take(&mut self, all: bool) -> Result<(), AccessError> {
        core::future::poll_fn(|context| {
            let mut at = 0;
            while let Some(exchange) = self.in_flight.get_mut(at) {
                match Pin::new(exchange).poll(context) {
                    Poll::Pending => at += 1,
                    Poll::Ready(reply) => {
                        let exchange = self.in_flight.remove(at);
                        let counted = reply.map_or(Ok(()), |r| exchange.counts(&r, self.count));
                        if counted.is_err() {
                            return Poll::Ready(counted);
                        }
                    }
                }
            }
            if all && at > 0 { Poll::Pending } else { Poll::Ready(Ok(())) }
        })
        .await
    }
}

/// Sends one additional drift frame when it is due. Of several procedures that call this, the first
/// one sends it.
///
/// The other clocks get the same time more often. So that this disturbs them little, all intervals
/// are alike, with the frame of the cycle as one of them: a loop divides by the time since the last
/// frame. The jitter of a hop repeats as two clocks slip. If it repeats once a cycle, it always
/// falls on the same interval. Were that one shorter than the others, each loop would learn a wrong
/// speed, which would hold its clock 50 ns off.
///
/// The cycle's own datagram detects a wrong working counter.
pub(super) async fn hasten(link: &Link, config: &Config, reference: StationAddress) {
    let now = link.now();
    let cycle = config.cycle;
    // The others get them, too.
    let due = link.board(|board| {
        if !board.leading {
            return Some(now + Nanos(cycle.0 / parts(cycle)));
        }
        let due = next_due(board.led_at, board.lead_due, cycle);
        if now < due {
            return Some(due);
        }
        board.led_at = now;
        None
    });
    if let Some(due) = due {
        return link.until(due).await;
    }
    // One that is lost matters nothing, the next brings a newer time.
    let _lost = drift_frame(link, reference).reply().await.is_err();
}

/// When the next additional drift frame is due if the last one, of the cycle or in addition to it,
/// was sent at `last`, and the cycle's next one is due at `next`. They divide the cycle into equal
/// parts. One that was sent later than by half of a part counts as the one behind it.
fn next_due(last: Time<Host>, next: Time<Host>, cycle: Nanos) -> Time<Host> {
    let parts = parts(cycle);
    let left = (next - last).0.min(cycle.0);
    let ahead = (2 * left * parts + cycle.0).div_euclid(2 * cycle.0) - 1;
    // The cycle's own one comes first.
    let ahead = if ahead > 0 { ahead } else { -1 };
    next + Nanos(-ahead * cycle.0 / parts)
}

/// All clocks but the reference.
pub(super) fn followers(segment: &Segment, reference: usize) -> Vec<(usize, StationAddress)> {
    let clocks = segment.devices.iter().enumerate();
    let clocks = clocks.filter(|(at, device)| device.dc.has_clock() && *at != reference);
    clocks.map(|(at, device)| (at, device.station)).collect()
}

/// Register 0x092C of every clock, with the time stamp of the frame that read it.
pub(super) async fn read_differences(
    link: &Link,
    clocks: &[(usize, StationAddress)],
) -> Result<Vec<(Time<Host>, SystemTimeDifference)>, AccessError> {
    let address = register::SYSTEM_TIME_DIFFERENCE.address;
    let reads: Vec<_> = clocks.iter().map(|(_, station)| link.fprd(*station, address, 4)).collect();
    let mut all = Vec::with_capacity(reads.len());
    for read in reads {
        let reply = read.expect(1).await?;
        let bytes = reply.data.first_chunk().copied().unwrap_or_default();
        all.push((reply.sent, SystemTimeDifference::from_bytes(bytes)));
    }
    Ok(all)
}

/// Time from one reading of 0x092C to the next. It is so long that the noise of the readings (1
/// sigma) causes half of the slope that a converged clock may have.
pub(super) fn reading_interval(noise: Nanos) -> Nanos {
    READING_INTERVAL.max(Nanos(NOISE_INTERVALS * noise.0))
}

/// The limits within which a clock counts as converged.
pub(crate) fn limits(config: &Config, noise: Nanos) -> Limits {
    Limits { noise, ..Limits::of_difference(config.drift_threshold) }
}

/// Standard deviation of 0x092C by position (1 sigma), whole ns. It is the jitter of the way after
/// the filter of 0x0934, a mean of first order.
pub(crate) fn noise(segment: &Segment, config: &Config) -> Vec<Nanos> {
    let (difference, _) = depths(segment, config);
    noise_behind(segment, config, difference)
}

/// The same with a `depth` of 0x0934.
pub(super) fn noise_behind(segment: &Segment, config: &Config, depth: u8) -> Vec<Nanos> {
    let readings = (2u64 << depth.min(15)) - 1;
    let root = (readings * 10_000).isqrt() as i64;
    let filtered = |one: Nanos| Nanos((one.0 * 100 + root - 1) / root);
    delay::noise(segment, config.hop_jitter).into_iter().map(filtered).collect()
}

/// Shortest time from one drift frame to the next while a clock joins. A tick of 10 ns in it is 100
/// ppm, the smallest speed that a loop can recognize. Such frames take 7 % of the wire, and joining
/// takes a tenth of the time that the cycle's own frames would need at 1 ms.
const PACE: Nanos = Nanos(100_000);

/// Number of drift frames in a cycle while a clock joins: at most ten, since the learned speed must
/// hold for a cycle.
fn parts(cycle: Nanos) -> i64 {
    (cycle.0 / PACE.0).clamp(1, 10)
}

/// Most drift frames in flight, if the way is longer than their pace or frames are lost. It
/// suffices for 2000 SubDevices at 50 us, and is below the number of frames that the link has in
/// flight.
const IN_FLIGHT: usize = 40;

/// Drift frames that may be lost where one must come back.
const MOST_TRIES: usize = 3;

/// Time between two readings of 0x092C: 16 of them make a window in which a slope of 1 ppm shows.
const READING_INTERVAL: Nanos = Nanos(2_000_000);

/// The same for 1 ns of noise: four errors of the slope of sixteen readings, 4 x sqrt(12 / 16^3) a
/// reading, are 500 ns/s.
const NOISE_INTERVALS: i64 = 433_000;

#[cfg(test)]
mod tests {
    use super::*;

    /// The cycle's frame was due at 10 ms, the next one is due at 11 ms.
    #[test]
    fn drift_frames_divide_the_cycle_into_equal_parts() {
        let due = |last_us: u64| {
            let (last, next) = (Time::new(last_us * 1_000), Time::new(11_000_000));
            next_due(last, next, Nanos::millis(1)).count() / 1_000
        };
        // Late frames do not delay the others.
        assert_eq!([10_000, 10_049, 10_100, 10_130].map(due), [10_100, 10_100, 10_200, 10_200]);
        assert_eq!([10_051, 10_149, 10_151].map(due), [10_200, 10_200, 10_300]);
        assert_eq!([10_800, 10_849].map(due), [10_900; 2]);
        // The next one is that of the cycle, or that is late.
        assert_eq!([10_900, 10_990, 11_020].map(due), [11_100; 3]);
        // None was sent for long.
        assert_eq!([0, 9_000].map(due), [10_100; 2]);
    }

    #[test]
    fn short_and_long_cycles_have_fewer_and_ten_parts() {
        let parts = |us| parts(Nanos::micros(us));
        assert_eq!([31, 100, 199, 200, 500].map(parts), [1, 1, 1, 2, 5]);
        assert_eq!([1_000, 2_000, 10_000].map(parts), [10; 3]);
        let (last, next) = (Time::new(1_000_000), Time::new(1_100_000));
        assert_eq!(next_due(last, next, Nanos::micros(100)), Time::new(1_200_000));
    }
}
