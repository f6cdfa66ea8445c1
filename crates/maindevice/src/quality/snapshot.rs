//! All present readings of the segment, and their history.

use alloc::vec::Vec;

use isocat_sync::budget::Check;
use isocat_wire::al::{AlStatus, AlStatusCode};
use isocat_wire::time::{Dc, Host, Nanos, Time};

use super::clocks::ClockQuality;
use super::objects::ObjectQuality;
use super::ring::Ring;
use crate::alarm::{Alarm, Change, Found, Hysteresis, LET_GO, RAISE};
use crate::cycle::CyclicExchange;
use crate::segment::{Segment, SubDevice, Timing};
use crate::statistics::Statistics;

/// The present state of the segment. All points of time in it are host times;
/// [`MainDevice::system_time`](crate::MainDevice::system_time) converts them to system time.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// The present host time.
    pub at: Time<Host>,
    /// The present system time, by the servo.
    pub system: Time<Dc>,
    /// Number of cycles begun.
    pub cycle: u64,
    /// Number of cycles since all clocks last took the reference's time; `None` without clocks.
    pub unled: Option<u64>,
    /// By chunk of the process image: cycles in a row whose working counter was wrong, of LRW or
    /// LRD and of LWR.
    pub working_counters: &'a [[u64; 2]],
    /// All clocks but the reference clock.
    pub clocks: &'a [ClockQuality],
    /// By position: error counters and distances.
    pub objects: &'a [ObjectQuality],
    /// By position: AL status, and the time left before SYNC0.
    pub devices: &'a [DeviceQuality],
    pub(super) moments: &'a Ring<Moment>,
}

impl<'a> Snapshot<'a> {
    /// The last moments, oldest first, each of a hundred cycles or a few more. Their number is
    /// limited like the readings of a clock.
    pub fn moments(&self) -> impl DoubleEndedIterator<Item = Moment> + 'a {
        self.moments.iter()
    }
}

/// Summary of about a hundred cycles.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Moment {
    /// Host time of its end.
    pub at: Time<Host>,
    /// System time of its end.
    pub system: Time<Dc>,
    /// The last cycle in it.
    pub cycle: u64,
    /// Number of cycles in it.
    pub cycles: u64,
    /// OR of all AL status at its end.
    pub al_status: AlStatus,
    /// Number of SubDevices that answered at its end.
    pub answering: u16,
    /// Number of datagrams with a wrong working counter in it.
    pub working_counter_errors: u64,
    /// Number of frames lost in it.
    pub frames_lost: u64,
    /// Largest lateness of a frame at the reference clock against the plan; `None`: no frame
    /// brought a time back.
    pub latest: Option<Nanos>,
    /// The largest of the last readings of 0x092C.
    pub difference: Nanos,
}

/// State and margin of one SubDevice.
#[derive(Clone, Copy, Debug)]
pub struct DeviceQuality {
    /// Last AL status seen (0x0130).
    pub status: AlStatus,
    /// Its code (0x0134).
    pub code: AlStatusCode,
    /// When this state was first read; at the earliest the start of operation.
    pub since: Time<Host>,
    /// Time left before SYNC0; `None` without SYNC0 or without clocks.
    pub margin: Option<Margin>,
}

/// Time from outputs ready, by the times that the device states, to the SYNC0 that uses them. It is
/// computed from the time that the reference clock writes into the cycle's first frame, so it does
/// not include errors of the host's stamps. The clock error is subtracted, as in the plan.
#[derive(Clone, Copy, Debug)]
pub struct Margin {
    /// For a frame in time.
    pub planned: Nanos,
    /// For the latest frame of the last hundred cycles.
    pub last: Nanos,
    /// The smallest so far.
    pub least: Nanos,
    alarm: Hysteresis,
}

impl Margin {
    /// Whether its alarm ([`Alarm::Margin`]) is raised.
    pub const fn has_alarm(&self) -> bool {
        self.alarm.is_up()
    }

    fn new(timing: &Timing, position: usize) -> Option<Self> {
        let (_, budget) = timing.devices.get(position)?;
        let slack = budget.lines().filter(|line| BEFORE_SYNC0.contains(&line.check));
        // The plan reserves the jitter for late frames.
        let planned = slack.map(|line| line.slack()).min()? + timing.cycle.jitter;
        let alarm = Hysteresis::new(RAISE, LET_GO);
        Some(Self { planned, last: planned, least: planned, alarm })
    }

    /// Takes the latest frame. The alarm ends at a quarter of the way from the limit to the planned
    /// margin.
    fn take(&mut self, latest: Nanos, limit: Option<Nanos>) -> Option<(bool, Found)> {
        self.last = self.planned - latest;
        self.least = self.least.min(self.last);
        let (left, limit) = (self.last, limit?);
        let well = limit + Nanos((self.planned - limit).0 / 4);
        let raised = self.alarm.sample(left < limit, left >= well)?;
        Some((raised, Found::Margin { left, limit }))
    }
}

/// Keeps the parts of a snapshot other than clocks and objects.
#[derive(Clone, Debug)]
pub(super) struct Record {
    pub devices: Vec<DeviceQuality>,
    pub moments: Ring<Moment>,
    /// Whether a state in the segment may have changed since it was last taken.
    pub stale: bool,
    limit: Option<Nanos>,
    /// Cycle and counts at the end of the last moment.
    before: (u64, u64, u64),
}

impl Record {
    pub fn new(
        limit: Option<Nanos>,
        history: usize,
        segment: &Segment,
        now: Time<Host>,
        cycle: u64,
        counts: &Statistics,
    ) -> Self {
        // Without a clock no frame brings back its arrival time.
        let timing = segment.timing.as_ref().filter(|_| segment.reference.is_some());
        let device = |device: &SubDevice| DeviceQuality {
            status: device.al_status,
            code: device.al_code,
            since: now,
            margin: timing.and_then(|timing| Margin::new(timing, device.position)),
        };
        Self {
            devices: segment.devices.iter().map(device).collect(),
            moments: Ring::new(history),
            stale: false,
            limit,
            before: (cycle, counts.working_counter_errors, counts.frames_missed()),
        }
    }

    /// Whether a moment has ended.
    pub fn is_due(&self, cycle: u64) -> bool {
        cycle.wrapping_sub(self.before.0) >= MOMENT
    }

    /// Takes the present states, and tells which ones changed.
    pub fn take_states(
        &mut self,
        now: Time<Host>,
        segment: &Segment,
        mut tell: impl FnMut(&SubDevice),
    ) {
        if !core::mem::take(&mut self.stale) {
            debug_assert!(
                self.devices.iter().zip(&segment.devices).all(|(known, device)| {
                    (known.status, known.code) == (device.al_status, device.al_code)
                }),
                "a state has changed"
            );
            return;
        }
        for (known, device) in self.devices.iter_mut().zip(&segment.devices) {
            let seen = (device.al_status, device.al_code);
            if (known.status, known.code) != seen {
                (known.status, known.code) = seen;
                known.since = now;
                tell(device);
            }
        }
    }

    /// Ends a moment; returns the alarms that come or end.
    pub fn end_moment(
        &mut self,
        now: Time<Host>,
        cycle: &mut CyclicExchange,
        counts: &Statistics,
        difference: Nanos,
    ) -> Vec<Change> {
        let latest = cycle.take_latest();
        let (number, errors, lost) = self.before;
        let missed = counts.frames_missed();
        self.before = (cycle.number(), counts.working_counter_errors, missed);
        self.moments.push(Moment {
            at: now,
            system: cycle.servo().dc_at(now),
            cycle: cycle.number(),
            cycles: cycle.number() - number,
            al_status: AlStatus(cycle.al_status),
            answering: cycle.answering(),
            working_counter_errors: counts.working_counter_errors - errors,
            frames_lost: missed - lost,
            latest,
            difference,
        });
        latest.map_or(Vec::new(), |latest| self.take_latest(latest))
    }

    fn take_latest(&mut self, latest: Nanos) -> Vec<Change> {
        let mut changes = Vec::new();
        for (position, device) in self.devices.iter_mut().enumerate() {
            let Some(margin) = &mut device.margin else { continue };
            if let Some((raised, found)) = margin.take(latest, self.limit) {
                changes.push(Change { position, alarm: Alarm::Margin, raised, found });
            }
        }
        changes
    }
}

/// Number of cycles of a moment.
const MOMENT: u64 = 100;
/// The lines of the plan whose slack a late frame reduces.
const BEFORE_SYNC0: [Check; 3] =
    [Check::OutputsStoredBeforeSync0, Check::OutputsBeforeSync0, Check::InputsReadBeforeSync0];

#[cfg(test)]
mod tests {
    use super::*;

    /// 60 us are planned and the limit is 20 us: the alarm is raised below 20 us three times in a
    /// row, and ends from 30 us on.
    #[test]
    fn margins_by_one_nanosecond() {
        let planned = Nanos(60_000);
        let alarm = Hysteresis::new(RAISE, LET_GO);
        let mut margin = Margin { planned, last: planned, least: planned, alarm };
        let mut take = |late: i64, times: usize| {
            let limit = Some(Nanos(20_000));
            let takes = (0..times).map(|_| Some(margin.take(Nanos(late), limit)?.0));
            takes.collect::<Vec<_>>()
        };
        assert_eq!(take(40_000, 10), [None; 10], "at the limit");
        assert_eq!(take(40_001, 3), [None, None, Some(true)]);
        assert_eq!(take(30_001, 20), [None; 20], "not well yet");
        let mut gone = [None; 8];
        gone[7] = Some(false);
        assert_eq!(take(30_000, 8), gone);
        assert_eq!((margin.last, margin.least), (Nanos(30_000), Nanos(19_999)));
        assert_eq!(margin.take(Nanos(90_000), None), None, "without a limit");
        assert_eq!(margin.least, Nanos(-30_000));
    }
}
