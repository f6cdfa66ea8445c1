//! How well each clock follows: read in the background while the segment runs, within a share of the bus.
//!
//! The machine asks `Monitor::due` when to read, reads the clocks of `Monitor::batch`, and gives what came back to
//! `Monitor::sample`. Each clock keeps its last readings in a ring that is allocated once; what leaves its limits and
//! what is back within them comes out as [`Alarm`]s, each after some readings in a row, so that a single one
//! raises nothing.

use alloc::vec::Vec;

use isocat_sync::drift::{Convergence, Limits, Verdict};
use isocat_wire::StationAddress;
use isocat_wire::dc::{ActivationStatus, SystemTimeDifference};
use isocat_wire::frame;
use isocat_wire::register::{self, Value, features};
use isocat_wire::time::{Host, Nanos, Time};

use crate::config;
use crate::link::Link;
use crate::segment::{Segment, SubDevice};

/// One reading of one clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Reading {
    /// When the frame was sent that read it.
    pub at: Time<Host>,
    /// Register 0x092C: positive when the local copy is ahead of the reference's time.
    pub difference: Nanos,
    /// Registers 0x0930 and 0x0932: how much faster the drift loop makes the local clock, ppb. The oscillator itself
    /// is slower than the reference's by as much.
    pub correction_ppb: i64,
    /// Register 0x0984; `None` where the ESC has none.
    pub activation: Option<ActivationStatus>,
}

/// What is wrong with a clock, or with their guidance.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Alarm {
    /// 0x092C stays beyond the limit.
    Difference,
    /// The clock slides: the slope of 0x092C over the last readings is beyond what the loop leaves.
    Sliding,
    /// The first SYNC pulse is still pending (0x0984): the clock makes none.
    SyncPending,
    /// The registers can't be read.
    Silent,
}

impl Alarm {
    /// All of them.
    pub const ALL: [Alarm; 4] = [Self::Difference, Self::Sliding, Self::SyncPending, Self::Silent];
}

/// An alarm that comes or goes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Change {
    pub position: usize,
    pub alarm: Alarm,
    pub raised: bool,
    /// 0x092C at that reading, the last one known.
    pub difference: Nanos,
    /// Its slope, ns per second.
    pub slope_ppb: i64,
}

/// One clock and its last readings.
#[derive(Clone, Debug)]
pub struct ClockQuality {
    /// Position of the SubDevice.
    pub position: usize,
    station: StationAddress,
    has_status: bool,
    /// How well its delay is known: see [`isocat_sync::delay::Delay::bar`].
    delay_bar: Nanos,
    ring: Vec<Reading>,
    next: usize,
    convergence: Convergence,
    slope_ppb: i64,
    alarms: [Hysteresis; Alarm::ALL.len()],
}

impl ClockQuality {
    /// The last reading.
    pub fn last(&self) -> Option<Reading> {
        self.readings().last()
    }

    /// The readings kept, oldest first.
    pub fn readings(&self) -> impl Iterator<Item = Reading> + '_ {
        let (new, old) = self.ring.split_at(self.next.min(self.ring.len()));
        old.iter().chain(new).copied()
    }

    /// The largest size of 0x092C among them.
    pub fn worst(&self) -> Nanos {
        self.readings().map(|reading| reading.difference.abs()).max().unwrap_or_default()
    }

    /// Slope of the last sixteen differences, ns per second; 0 while there are fewer.
    pub const fn slope_ppb(&self) -> i64 {
        self.slope_ppb
    }

    /// How far this clock is from the reference's at most, as far as registers tell: the worst difference read, what
    /// it may have moved between two readings, the tick of either clock, and the error of its delay, of which
    /// 0x092C knows nothing. `None` before the first reading.
    pub fn bound(&self) -> Option<Nanos> {
        let mut readings = self.readings();
        let first = readings.next()?.at;
        let (last, count) = readings.fold((first, 1), |(_, n), reading| (reading.at, n + 1));
        let between = (last - first).0 / (count - 1).max(1);
        let moved =
            (i128::from(between) * i128::from(self.slope_ppb.abs()) / NANOS_PER_SECOND) as i64;
        Some(self.worst() + Nanos(moved) + Nanos(2 * TICK) + self.delay_bar)
    }

    /// Whether this alarm is up.
    pub fn has(&self, alarm: Alarm) -> bool {
        self.alarms[alarm as usize].up
    }

    fn new(device: &SubDevice, history: usize, limits: Limits) -> Self {
        Self {
            position: device.position,
            station: device.station,
            has_status: device.esc.has(features::ENHANCED_SYNC_ACTIVATION) && device.mode.uses_dc(),
            delay_bar: device
                .measured_delay
                .and_then(|delay| delay.bar())
                .map_or(Nanos::ZERO, |bar| Nanos((bar.0 + 999) / 1_000)),
            ring: Vec::with_capacity(history),
            next: 0,
            convergence: Convergence::new(limits),
            slope_ppb: 0,
            alarms: [Hysteresis::default(); Alarm::ALL.len()],
        }
    }

    fn take(&mut self, reading: Reading) {
        let history = self.ring.capacity();
        if self.ring.len() < history {
            self.ring.push(reading);
        } else {
            self.ring[self.next] = reading;
        }
        self.next = (self.next + 1) % history;
        self.convergence.sample(reading.at, reading.difference);
        if let Verdict::Converging { slope_ppb, .. } | Verdict::Converged { slope_ppb, .. } =
            self.convergence.verdict()
        {
            self.slope_ppb = slope_ppb;
        }
    }
}

/// Raised by several readings in a row, and let go by more.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Hysteresis {
    up: bool,
    count: u8,
}

impl Hysteresis {
    /// `bad`: beyond the limit, `good`: well within. What it becomes, if it changes.
    fn sample(&mut self, bad: bool, good: bool) -> Option<bool> {
        let (counts, needed) = if self.up { (good, LET_GO) } else { (bad, RAISE) };
        self.count = if counts { self.count + 1 } else { 0 };
        if self.count < needed {
            return None;
        }
        *self = Self { up: !self.up, count: 0 };
        Some(self.up)
    }
}

/// What the registers of one clock said.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registers {
    pub at: Time<Host>,
    /// 0x092C to 0x0933.
    pub bytes: [u8; 8],
    pub activation: Option<ActivationStatus>,
}

/// Who is to be read: index among the clocks, station, and whether 0x0984 exists.
pub(crate) type Wanted = (usize, StationAddress, bool);

/// Reads all clocks in turn.
#[derive(Clone, Debug)]
pub(crate) struct Monitor {
    config: config::QualityWatch,
    clocks: Vec<ClockQuality>,
    turn: usize,
    next: Time<Host>,
    /// Wire time of all reads so far.
    spent: Nanos,
    /// It was told that clocks are not led.
    unled: bool,
}

impl Monitor {
    /// Watches the clocks of a segment but the reference's own; `None` if there are none.
    pub fn new(config: config::QualityWatch, segment: &Segment, now: Time<Host>) -> Option<Self> {
        let reference = segment.reference?;
        let limits = Limits { difference: config.difference_limit, ..Limits::default() };
        let led = |device: &&SubDevice| device.dc.has_clock() && device.position != reference;
        let clock = |device| ClockQuality::new(device, config.history.max(1), limits);
        let clocks: Vec<_> = segment.devices.iter().filter(led).map(clock).collect();
        (!clocks.is_empty()).then_some(Self {
            config,
            clocks,
            turn: 0,
            next: now,
            spent: Nanos::ZERO,
            unled: false,
        })
    }

    /// Whether it is time to read.
    pub fn due(&self, now: Time<Host>) -> bool {
        now >= self.next
    }

    /// Whom to read now. Their frames' time on the wire decides when the next ones are due.
    pub fn batch(&mut self, now: Time<Host>) -> Vec<Wanted> {
        let count = self.clocks.len().min(BATCH);
        let wanted = (0..count).map(|i| {
            let at = (self.turn + i) % self.clocks.len();
            (at, self.clocks[at].station, self.clocks[at].has_status)
        });
        let wanted: Vec<Wanted> = wanted.collect();
        self.turn = (self.turn + count) % self.clocks.len();
        let cost = wire_time(&wanted);
        self.spent += cost;
        self.next = now + Nanos(cost.0 * 1_000 / i64::from(self.config.share_permille.max(1)));
        wanted
    }

    /// Takes what came back from one of them; gives the alarms that come or go.
    pub fn sample(&mut self, index: usize, found: Option<Registers>) -> Vec<Change> {
        let limit = self.config.difference_limit;
        let Some(clock) = self.clocks.get_mut(index) else { return Vec::new() };
        if let Some(registers) = found {
            clock.take(reading(&registers));
        }
        let difference = clock.last().map_or(Nanos::ZERO, |reading| reading.difference);
        let size = difference.abs();
        let slope_ppb = clock.slope_ppb;
        let pending = found.and_then(|found| found.activation).is_some_and(|a| a.sync0_pending());
        let limits = Limits::default();
        let judged = [
            (Alarm::Difference, size > limit, size.0 <= limit.0 / 2),
            (
                Alarm::Sliding,
                slope_ppb.abs() > SLIDING * limits.slope_ppb,
                slope_ppb.abs() <= limits.slope_ppb,
            ),
            (Alarm::SyncPending, pending, !pending),
            (Alarm::Silent, found.is_none(), found.is_some()),
        ];
        let mut changes = Vec::new();
        for (alarm, bad, good) in judged {
            // What was not read says nothing of itself.
            if found.is_none() && alarm != Alarm::Silent {
                continue;
            }
            if let Some(raised) = clock.alarms[alarm as usize].sample(bad, good) {
                let position = clock.position;
                changes.push(Change { position, alarm, raised, difference, slope_ppb });
            }
        }
        changes
    }

    /// Takes for how many cycles no drift frame reached all clocks; gives what is to be told of it: how many, 0 when it
    /// is over.
    pub fn guidance(&mut self, cycles: u64) -> Option<u64> {
        let unled = cycles >= self.config.unled_cycles;
        if unled == self.unled {
            return None;
        }
        self.unled = unled;
        Some(if unled { cycles } else { 0 })
    }

    /// All clocks.
    pub fn clocks(&self) -> &[ClockQuality] {
        &self.clocks
    }

    /// Wire time of all reads so far, preambles and gaps included.
    pub fn spent(&self) -> Nanos {
        self.spent
    }
}

/// Reads the registers of these clocks, all together.
pub(crate) async fn read(link: Link, wanted: Vec<Wanted>) -> Vec<(usize, Option<Registers>)> {
    let difference = register::SYSTEM_TIME_DIFFERENCE.address;
    let status = register::ACTIVATION_STATUS.address;
    let reads: Vec<_> = wanted
        .iter()
        .map(|&(_, station, has_status)| {
            let clock = link.fprd(station, difference, 8);
            (clock, has_status.then(|| link.fprd(station, status, 1)))
        })
        .collect();
    let mut all = Vec::with_capacity(reads.len());
    for ((index, ..), (clock, status)) in wanted.into_iter().zip(reads) {
        let clock = clock.expect(1).await.ok();
        let status = match status {
            Some(status) => status.expect(1).await.ok(),
            None => None,
        };
        let activation = status.and_then(|reply| Some(ActivationStatus(*reply.data.first()?)));
        let registers = clock.and_then(|reply| {
            let bytes = *reply.data.first_chunk()?;
            Some(Registers { at: reply.sent, bytes, activation })
        });
        all.push((index, registers));
    }
    all
}

fn reading(registers: &Registers) -> Reading {
    let b = &registers.bytes;
    let start = i64::from(u16::from_le_bytes([b[4], b[5]]) & 0x7FFF);
    let change = i64::from(i16::from_le_bytes([b[6], b[7]]));
    Reading {
        at: registers.at,
        difference: SystemTimeDifference::from_bytes([b[0], b[1], b[2], b[3]]).nanos(),
        correction_ppb: correction_ppb(start, change),
        activation: registers.activation,
    }
}

/// One nanosecond more every `start - change + 2` ticks of 10 ns, one less every `start + change + 2` (ESC data sheet,
/// registers 0x0930 and 0x0932).
fn correction_ppb(start: i64, change: i64) -> i64 {
    let part = |ticks: i64| if ticks > 0 { 100_000_000 / ticks } else { 0 };
    part(start - change + 2) - part(start + change + 2)
}

/// The time that the frames of a batch take: as if each batch were one frame of its own.
fn wire_time(wanted: &[Wanted]) -> Nanos {
    let of =
        |&(_, _, has_status): &Wanted| DATAGRAM + 8 + if has_status { DATAGRAM + 1 } else { 0 };
    let bytes = frame::ETHERNET_HEADER_LEN
        + frame::ETHERCAT_HEADER_LEN
        + wanted.iter().map(of).sum::<usize>();
    let on_wire = bytes.max(frame::MIN_LEN) + frame::WIRE_OVERHEAD;
    Nanos(on_wire as i64 * frame::BYTE_TIME_NS as i64)
}

/// Header and working counter of a datagram.
const DATAGRAM: usize = isocat_wire::datagram::HEADER_LEN + isocat_wire::datagram::WKC_LEN;
/// Clocks that are read together.
const BATCH: usize = 8;
/// Readings in a row that raise an alarm.
const RAISE: u8 = 3;
/// Readings in a row that let it go.
const LET_GO: u8 = 8;
/// A clock slides when its slope is so many times what a converged one may have.
const SLIDING: i64 = 2;
/// Resolution of an ESC's clock, ns.
const TICK: i64 = 10;
const NANOS_PER_SECOND: i128 = 1_000_000_000;

#[cfg(test)]
mod tests {
    use isocat_sync::delay::Delay;
    use isocat_wire::time::Picos;

    use super::*;
    use crate::segment::DcCapability;

    const LIMIT: Nanos = Nanos(100);

    fn config() -> config::QualityWatch {
        config::QualityWatch {
            share_permille: 10,
            history: 20,
            unled_cycles: 3,
            difference_limit: LIMIT,
        }
    }

    fn monitor(clocks: usize) -> Monitor {
        let device = |position: usize| {
            let mut device = SubDevice::new(position, StationAddress(0x1001 + position as u16));
            device.dc = DcCapability::Clock64;
            let (standard_error, systematic) = (Picos(1_000), Picos(5_000));
            device.measured_delay =
                Some(Delay::Known { delay: Picos(0), standard_error, systematic });
            device
        };
        let devices = (0..=clocks).map(device).collect();
        let segment = Segment { devices, reference: Some(0), ..Segment::default() };
        Monitor::new(config(), &segment, Time::ZERO).expect("there are clocks")
    }

    fn registers(at: u64, difference: i64) -> Option<Registers> {
        let mut bytes = [0; 8];
        bytes[..4].copy_from_slice(&SystemTimeDifference::from_nanos(Nanos(difference)).to_bytes());
        bytes[4..6].copy_from_slice(&0x1000_u16.to_le_bytes());
        Some(Registers { at: Time::new(at), bytes, activation: None })
    }

    /// Both sides of the limit, of the number of readings, and of what lets go.
    #[test]
    fn alarms_come_and_go_late() {
        let mut monitor = monitor(1);
        let mut at = 0;
        let mut read = |monitor: &mut Monitor, difference| {
            at += 1_000_000_000;
            monitor.sample(0, registers(at, difference))
        };
        for _ in 0..10 {
            assert_eq!(read(&mut monitor, 100), [], "at the limit");
        }
        assert_eq!(read(&mut monitor, -101), []);
        assert_eq!(read(&mut monitor, -101), []);
        assert_eq!(read(&mut monitor, 100), [], "the row is broken");
        assert_eq!(read(&mut monitor, -101), []);
        assert_eq!(read(&mut monitor, -101), []);
        let raised = read(&mut monitor, -101);
        assert_eq!((raised.len(), raised[0].alarm, raised[0].raised), (1, Alarm::Difference, true));
        assert_eq!((raised[0].position, raised[0].difference), (1, Nanos(-101)));
        for _ in 0..20 {
            assert_eq!(read(&mut monitor, 51), [], "not well within");
        }
        for _ in 0..7 {
            assert_eq!(read(&mut monitor, 50), []);
        }
        let gone = read(&mut monitor, 50);
        assert_eq!((gone.len(), gone[0].alarm, gone[0].raised), (1, Alarm::Difference, false));
        assert!(!monitor.clocks()[0].has(Alarm::Difference));
    }

    #[test]
    fn clocks_without_guidance() {
        let mut monitor = monitor(1);
        assert_eq!([0, 1, 2].map(|cycles| monitor.guidance(cycles)), [None; 3]);
        assert_eq!([3, 4, 500].map(|cycles| monitor.guidance(cycles)), [Some(3), None, None]);
        assert_eq!([0, 1].map(|cycles| monitor.guidance(cycles)), [Some(0), None]);
    }

    #[test]
    fn a_clock_that_slides_and_one_that_is_silent() {
        let mut monitor = monitor(1);
        let mut changes = Vec::new();
        // 3 ns every millisecond: 3000 ppb.
        for i in 0..20 {
            changes.extend(monitor.sample(0, registers(i * 1_000_000, i as i64 * 3 - 30)));
        }
        assert_eq!((changes.len(), changes[0].alarm), (1, Alarm::Sliding), "{changes:?}");
        assert!((changes[0].slope_ppb - 3_000).abs() < 10, "{changes:?}");
        assert_eq!(monitor.sample(0, None), []);
        assert_eq!(monitor.sample(0, None), []);
        assert_eq!(monitor.sample(0, None)[0].alarm, Alarm::Silent);
    }

    /// A ring: the oldest go. The bound is made of what is in it.
    #[test]
    fn the_last_readings_and_their_bound() {
        let mut monitor = monitor(1);
        assert_eq!(monitor.clocks()[0].bound(), None);
        monitor.sample(0, registers(0, 77));
        // Tick of either clock; 5 ns and 1.96 times 1 ns for the delay.
        assert_eq!(monitor.clocks()[0].bound(), Some(Nanos(77 + 20 + 7)));
        for i in 1..=20 {
            monitor.sample(0, registers(i * 1_000_000, 30));
        }
        let clock = &monitor.clocks()[0];
        let at: Vec<u64> = clock.readings().map(|reading| reading.at.count()).collect();
        assert_eq!((at.len(), at[0], at[19]), (20, 1_000_000, 20_000_000));
        assert_eq!((clock.worst(), clock.slope_ppb()), (Nanos(30), 0));
        assert_eq!(clock.bound(), Some(Nanos(30 + 20 + 7)));
    }

    /// 20 clocks in batches of eight; never more of the wire than the share.
    #[test]
    fn reads_within_its_share() {
        let mut monitor = monitor(20);
        let (mut now, mut seen) = (Time::new(0), [0; 20]);
        let end = 100_000_000;
        while now.count() < end {
            if monitor.due(now) {
                for (at, station, _) in monitor.batch(now) {
                    assert_eq!(station, StationAddress(0x1002 + at as u16));
                    seen[at] += 1;
                }
            }
            now += Nanos(1_000);
        }
        let share = monitor.spent().0 as f64 / end as f64;
        assert!((0.0097..=0.0103).contains(&share), "{share}");
        assert!(seen.iter().max().unwrap() - seen.iter().min().unwrap() <= 1, "{seen:?}");
    }

    /// Start 0x1000 and a difference of 100: 1.19 ppm; the ends of the range some 763 ppm.
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
