//! Readings of the registers of clocks.

use alloc::vec::Vec;

use isocat_sync::drift::{Convergence, Limits, SETTLED_PPB};
use isocat_sync::settling::Settling;
use isocat_wire::StationAddress;
use isocat_wire::dc::{ActivationStatus, DifferencePolarity, SystemTimeDifference};
use isocat_wire::frame;
use isocat_wire::register::{Value, features};
use isocat_wire::time::{Host, Nanos, Picos, Time};

use super::pace::Pace;
use super::ring::Ring;
use super::round::Round;
use crate::alarm::{Alarm, Change, Found, Hysteresis, LET_GO, RAISE};
use crate::config::QualityWatch;
use crate::segment::{Segment, SubDevice};

/// One reading of one clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Reading {
    /// Send time of the frame that read it.
    pub at: Time<Host>,
    /// Register 0x092C: positive when the local copy is ahead of the reference's time.
    pub difference: Nanos,
    /// How much faster the drift loop makes the local clock, ppb, from registers 0x0930 and 0x0932.
    /// The oscillator itself is slower than the reference clock's by this much.
    pub correction_ppb: i64,
    /// Register 0x0984; `None` if the ESC has none.
    pub activation: Option<ActivationStatus>,
}

/// A reading as it is kept: the register of the speed is taken apart when that is asked for.
#[derive(Clone, Copy, Debug)]
struct Kept {
    at: Time<Host>,
    difference: Nanos,
    /// Registers 0x0930 to 0x0933.
    speed: [u8; 4],
    activation: Option<ActivationStatus>,
}

/// One clock and its last readings.
#[derive(Clone, Debug)]
pub struct ClockQuality {
    /// Position of the SubDevice.
    pub position: usize,
    station: StationAddress,
    has_status: bool,
    /// Whether it has not been present yet.
    awaited: bool,
    /// How well its delay is known: see [`isocat_sync::delay::Delay::bar`].
    delay_bar: Nanos,
    /// What the sign of its 0x092C means.
    polarity: DifferencePolarity,
    readings: Ring<Kept>,
    /// The largest absolute difference among them, and how many of them have it.
    worst: Nanos,
    worst_count: usize,
    limits: Limits,
    /// The difference beyond which an alarm is raised.
    limit: Nanos,
    convergence: Convergence,
    settling: Settling<Time<Host>>,
    /// Whether no drift frame reaches it.
    unled: bool,
    alarms: [Hysteresis; Alarm::OF_CLOCKS.len()],
    /// Whether none of them is raised, nor has a bad reading behind it.
    calm: bool,
}

impl ClockQuality {
    /// The last reading.
    pub fn last(&self) -> Option<Reading> {
        self.readings.last().map(Kept::reading)
    }

    /// Send time of the frame that brought the last reading.
    #[inline]
    pub fn last_read(&self) -> Option<Time<Host>> {
        self.readings.last().map(|reading| reading.at)
    }

    /// The readings kept, oldest first.
    pub fn readings(&self) -> impl DoubleEndedIterator<Item = Reading> + '_ {
        self.readings.iter().map(Kept::reading)
    }

    /// The difference farthest from zero among the readings after this time, and among all of them
    /// without one; the earliest of several. `None`: there are no such readings.
    pub fn worst_since(&self, time: Option<Time<Host>>) -> Option<Nanos> {
        let new = |reading: &Kept| time.is_none_or(|time| reading.at > time);
        let new = self.readings.newest().take_while(|reading| new(reading));
        new.map(|reading| reading.difference)
            .reduce(|worst, earlier| if earlier.abs() >= worst.abs() { earlier } else { worst })
    }

    /// The largest absolute value of 0x092C among them.
    #[inline]
    pub fn worst(&self) -> Nanos {
        self.worst
    }

    /// Slope of the last sixteen differences, ns per second; 0 with fewer.
    pub fn slope_ppb(&self) -> i64 {
        self.convergence.slope_ppb().unwrap_or(0)
    }

    /// How the differences go from the first reading on, as long as drift frames reach the clock
    /// and its registers answer.
    pub fn settling(&self) -> &Settling<Time<Host>> {
        &self.settling
    }

    /// Largest distance of this clock from the reference clock, as far as registers show it. It is
    /// the sum of the worst difference read, the possible movement between two readings, the tick
    /// of either clock, and the error of its delay, which 0x092C does not show. `None` before the
    /// first reading, and while no drift frame reaches the clock, since 0x092C is then out of date.
    pub fn bound(&self) -> Option<Nanos> {
        if self.unled {
            return None;
        }
        let (time, parts) = self.between()?;
        let between = time.0 / parts;
        // A slope costs a division of long numbers. Most are so small that the clock moves by less
        // than a nanosecond.
        let unseen = u32::try_from((NANOS_PER_SECOND - 1) / between.max(1)).unwrap_or(u32::MAX);
        let moved = match self.convergence.is_flat(unseen, self.worst) {
            true => 0,
            false => {
                let moved = i128::from(between) * i128::from(self.slope_ppb().abs());
                (moved / i128::from(NANOS_PER_SECOND)) as i64
            }
        };
        Some(self.bound_with(Nanos(moved)))
    }

    /// The bound if it is larger than `known`. Nearly always it is not if `known` is not small, and
    /// that costs less to find.
    pub fn larger_bound(&self, known: Nanos) -> Option<Nanos> {
        let (time, parts) = self.between()?;
        let room = known - self.bound_with(Nanos::ZERO);
        if room.0 >= 0 && self.convergence.stays_within(room, time, parts as u64, self.worst) {
            return None;
        }
        self.bound().filter(|bound| *bound > known)
    }

    /// The time from the first to the last reading, and the number of pauses in it, at least one.
    #[inline]
    fn between(&self) -> Option<(Nanos, i64)> {
        let (first, last) = (self.readings.first()?.at, self.readings.last()?.at);
        Some((last - first, (self.readings.len() as i64 - 1).max(1)))
    }

    /// The bound of a clock that moves this far between two readings.
    #[inline]
    fn bound_with(&self, moved: Nanos) -> Nanos {
        self.worst() + moved + Nanos(2 * TICK) + self.delay_bar
    }

    /// Whether this alarm is raised; always false for alarms that are not of clocks.
    pub fn has(&self, alarm: Alarm) -> bool {
        let at = Alarm::OF_CLOCKS.iter().position(|of| *of == alarm);
        at.is_some_and(|at| self.alarms[at].is_up())
    }

    fn new(device: &SubDevice, history: usize, limits: Limits) -> Self {
        let mut clock = Self {
            position: device.position,
            station: device.station,
            has_status: false,
            awaited: true,
            delay_bar: Nanos::ZERO,
            polarity: device.difference_polarity,
            readings: Ring::new(history),
            worst: Nanos::ZERO,
            worst_count: 0,
            limits,
            limit: limits.difference + limits.noise_allowed(),
            convergence: Convergence::new(limits),
            settling: Settling::default(),
            unled: false,
            alarms: [CALM; Alarm::OF_CLOCKS.len()],
            calm: true,
        };
        clock.meet(device);
        clock
    }

    /// Takes over the data of a SubDevice that has come.
    fn meet(&mut self, device: &SubDevice) {
        self.awaited &= !device.admitted;
        self.station = device.station;
        self.has_status =
            device.esc.has(features::ENHANCED_SYNC_ACTIVATION) && device.mode.uses_dc();
        self.polarity = device.difference_polarity;
        let bar = device.measured_delay.and_then(|delay| delay.bar());
        self.delay_bar = bar.map_or(Nanos::ZERO, |bar| Nanos((bar.0 + 999) / 1_000));
    }

    /// Sets whether drift frames fail to reach it.
    pub(super) fn set_unled(&mut self, unled: bool) {
        self.unled = unled;
        if unled {
            self.settling.close();
        }
    }

    /// Called when its delay has changed: earlier readings make no slope with later ones.
    fn forget_slope(&mut self) {
        self.convergence = Convergence::new(self.limits);
    }

    /// Takes a reading; returns whether it is as good as all before, so that no alarm changes.
    #[inline(always)]
    fn take(&mut self, registers: &Registers) -> bool {
        let [a, b, c, d, speed @ ..] = registers.bytes;
        let found = SystemTimeDifference::from_bytes([a, b, c, d]);
        let difference = found.nanos(self.polarity);
        let Registers { at, activation, .. } = *registers;
        let reading = Kept { at, difference, speed, activation };
        let size = Nanos(i64::from(found.magnitude()));
        let gone = self.readings.push(reading);
        // Most readings are not the worst one, neither those that come nor those that go.
        let was_worst = gone.is_some_and(|gone| gone.is_as_large_as(self.worst));
        if size >= self.worst || was_worst {
            self.follow_worst(size, was_worst);
        }
        self.convergence.sample(at, difference);
        // It has 31 bits.
        self.settling.sample(at, Picos(difference.0 * 1_000));
        self.calm
            && size <= self.limit
            && !activation.is_some_and(|activation| activation.sync0_pending())
            && self.convergence.is_settled(self.worst)
    }

    /// Finds the worst reading when one of this size has come. `was_worst`: the one that went was
    /// one of the worst.
    #[inline(never)]
    fn follow_worst(&mut self, size: Nanos, was_worst: bool) {
        self.worst_count -= usize::from(was_worst);
        if size > self.worst {
            (self.worst, self.worst_count) = (size, 0);
        }
        self.worst_count += usize::from(size == self.worst);
        if self.worst_count > 0 {
            return;
        }
        let (mut worst, mut count) = (Nanos::ZERO, 0);
        for reading in self.readings.values() {
            // It has 31 bits.
            let size = Nanos(reading.difference.0.wrapping_abs());
            if size > worst {
                (worst, count) = (size, 0);
            }
            count += usize::from(size == worst);
        }
        (self.worst, self.worst_count) = (worst, count);
    }

    /// Updates the alarms with the reading that was taken last and returns the changes; `None`: the
    /// registers did not answer.
    #[cold]
    fn judge(&mut self, found: Option<Registers>) -> Vec<Change> {
        let limit = self.limit;
        let difference = self.readings.last().map_or(Nanos::ZERO, |reading| reading.difference);
        let size = difference.abs();
        let pending = found.and_then(|found| found.activation).is_some_and(|a| a.sync0_pending());
        let (beyond, within) = (size > limit, size.0 <= limit.0 / 2);
        let mut settled = i64::from(SETTLED_PPB);
        let slope = self.slope_ppb();
        // Above zero it leads away.
        let away = self.convergence.slope_ppb();
        let away = away.map(|slope| slope.saturating_mul(difference.0.signum()));
        // The noise of slopes is dear to compute, and changes nothing with a clock that is settled
        // without it.
        if !within || slope.abs() > settled {
            settled += self.convergence.slope_noise_ppb();
        }
        let judged = [
            (Alarm::Difference, beyond, within),
            (
                Alarm::NotConverging,
                beyond && away.is_some_and(|away| away >= -settled),
                within || away.is_some_and(|away| away < -SLIDING * settled),
            ),
            (Alarm::Sliding, slope.abs() > SLIDING * settled, slope.abs() <= settled),
            (Alarm::SyncPending, pending, !pending),
            (Alarm::Silent, found.is_none(), found.is_some()),
        ];
        let mut changes = Vec::new();
        for ((alarm, bad, good), hysteresis) in judged.into_iter().zip(&mut self.alarms) {
            // What was not read says nothing of itself.
            if found.is_none() && alarm != Alarm::Silent {
                continue;
            }
            if let Some(raised) = hysteresis.sample(bad, good) {
                // It may come back from a way up of its own.
                if alarm == Alarm::Silent {
                    self.settling.close();
                }
                let (position, found) =
                    (self.position, Found::Clock { difference, slope_ppb: slope });
                changes.push(Change { position, alarm, raised, found });
            }
        }
        self.calm = self.alarms == [CALM; Alarm::OF_CLOCKS.len()];
        changes
    }
}

/// Readings of the registers of one clock.
#[derive(Clone, Copy, Debug)]
pub struct Registers {
    /// Send time of the frame that read them.
    pub at: Time<Host>,
    /// Registers 0x092C to 0x0933.
    pub bytes: [u8; 8],
    /// Register 0x0984; `None` if the ESC has none.
    pub activation: Option<ActivationStatus>,
}

/// A clock to read: index among the clocks, station, and whether 0x0984 exists.
pub type Wanted = (usize, StationAddress, bool);

/// Reads all clocks in turn.
#[derive(Clone, Debug)]
pub(super) struct Clocks {
    pub all: Vec<ClockQuality>,
    turn: usize,
    round: Round,
    pub pace: Pace,
}

impl Clocks {
    /// All clocks of a segment but the reference clock. `noise`: standard deviation of 0x092C by
    /// position (1 sigma).
    pub fn new(config: &QualityWatch, segment: &Segment, pace: Pace, noise: &[Nanos]) -> Self {
        let limits = |device: &SubDevice| Limits {
            difference: config.difference_limit,
            mean: config.difference_limit,
            noise: noise.get(device.position).copied().unwrap_or_default(),
            ..Limits::default()
        };
        let led = |device: &&SubDevice| {
            segment.reference.is_some_and(|reference| device.position != reference)
                && device.dc.has_clock()
        };
        let clock = |device| ClockQuality::new(device, config.history, limits(device));
        let all: Vec<_> = segment.devices.iter().filter(led).map(clock).collect();
        let round = Round::new(all.len());
        let mut clocks = Self { all, turn: 0, round, pace };
        clocks.set_round();
        clocks
    }

    /// Takes all that are present into the round.
    fn set_round(&mut self) {
        let present = self.all.iter().enumerate().filter(|(_, clock)| !clock.awaited);
        let wanted =
            |(index, clock): (usize, &ClockQuality)| (index, clock.station, clock.has_status);
        self.round.set(present.map(wanted));
    }

    /// Called when the delay of this SubDevice's clock has changed.
    pub fn forget_slope(&mut self, position: usize) {
        for clock in self.all.iter_mut().filter(|clock| clock.position == position) {
            clock.forget_slope();
        }
    }

    pub fn is_due(&self, now: Time<Host>) -> bool {
        self.pace.is_due(now) && self.are_there()
    }

    /// Whether any clock is present.
    pub fn are_there(&self) -> bool {
        !self.round.is_empty()
    }

    /// Puts the clocks to read now into the empty `wanted`, and the datagrams that read them into
    /// the empty `datagrams`. `most`: the largest number of clocks, and the bytes of the frame into
    /// which their reads must fit; one is read at least. The wire time of their frame decides when
    /// the next ones are due.
    pub fn batch(
        &mut self,
        now: Time<Host>,
        most: (usize, usize),
        wanted: &mut Vec<Wanted>,
        datagrams: &mut Vec<u8>,
    ) {
        self.round.next(self.turn, most, wanted, datagrams);
        self.turn = wanted.last().map_or(0, |(at, ..)| at + 1);
        // As if each batch were one frame of its own.
        let on_wire = frame_len(datagrams.len()).max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
        self.pace.charge(now, Nanos(on_wire as i64 * frame::BYTE_TIME_NS as i64));
    }

    /// Called when the state of a SubDevice has changed.
    pub fn meet(&mut self, device: &SubDevice) {
        let clock = self.all.iter_mut().find(|clock| clock.position == device.position);
        if let Some(clock) = clock.filter(|_| device.admitted) {
            let asked = |clock: &ClockQuality| (clock.awaited, clock.station, clock.has_status);
            let before = asked(clock);
            clock.meet(device);
            if asked(clock) != before {
                self.set_round();
            }
        }
    }

    /// Takes the answer of one of them; returns the alarms that come or end.
    #[inline]
    pub fn sample(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        match found {
            Some(registers) if self.take(index, registers) => Vec::new(),
            _ => self.judge(index, found),
        }
    }

    /// Takes an answer without judging it; returns whether no alarm changes by it, as with nearly
    /// every one. If not, call [`Self::judge`].
    #[inline(always)]
    pub fn take(&mut self, index: usize, found: Registers) -> bool {
        self.all.get_mut(index).is_none_or(|clock| clock.take(&found))
    }

    /// Judges an answer that was taken; returns the alarms that come or end.
    #[cold]
    pub fn judge(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        self.all.get_mut(index).map_or(Vec::new(), |clock| clock.judge(found))
    }
}

/// Bytes of a frame whose datagrams have `datagrams` bytes.
fn frame_len(datagrams: usize) -> usize {
    frame::ETHERNET_HEADER_LEN + frame::ETHERCAT_HEADER_LEN + datagrams
}

impl Kept {
    fn is_as_large_as(&self, size: Nanos) -> bool {
        self.difference == size || self.difference.0.wrapping_add(size.0) == 0
    }

    fn reading(self) -> Reading {
        let Self { at, difference, speed: [a, b, c, d], activation } = self;
        let start = i64::from(u16::from_le_bytes([a, b]) & 0x7FFF);
        let change = i64::from(i16::from_le_bytes([c, d]));
        Reading { at, difference, correction_ppb: correction_ppb(start, change), activation }
    }
}

/// Correction from registers 0x0930 and 0x0932, ppb. The clock counts one nanosecond more every
/// `start - change + 2` ticks of 10 ns, and one less every `start + change + 2` (ESC data sheet).
fn correction_ppb(start: i64, change: i64) -> i64 {
    let part = |ticks: i64| if ticks > 0 { 100_000_000 / ticks } else { 0 };
    part(start - change + 2) - part(start + change + 2)
}

/// An alarm that is not raised.
const CALM: Hysteresis = Hysteresis::new(RAISE, LET_GO);
/// A clock drifts if its slope exceeds that of a converged one by this factor.
const SLIDING: i64 = 2;
/// Resolution of an ESC's clock, ns.
const TICK: i64 = 10;
const NANOS_PER_SECOND: i64 = 1_000_000_000;

#[cfg(test)]
mod tests {
    use super::*;

    /// A start value of 0x1000 and a difference of 100 give 1.19 ppm; the ends of the range are
    /// about 763 ppm.
    #[test]
    fn the_speed_counter_in_ppb() {
        assert!(
            (correction_ppb(0x1000, 100) - 1_190).abs() < 10,
            "{}",
            correction_ppb(0x1000, 100)
        );
        assert_eq!(correction_ppb(0x1000, 0), 0);
        assert!((correction_ppb(0x1000, 3_969) / 1_000 - 763).abs() < 5);
        assert!((correction_ppb(0x1000, -3_969) / 1_000 + 763).abs() < 5);
    }
}
