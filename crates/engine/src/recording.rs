//! The data of a run for its pictures: when the events in the cycle of each SubDevice happen, the
//! SYNC0 error, and the host's phase. All are in true time, against the reference clock.
//!
//! A [`Recording`] observes a run ([`Tap`]). Its memory is bounded, however long the run is: least,
//! mean and largest phase of each event ([`cycle`]), some hundred spans of time of each series
//! ([`series`]), and the first few incidents. It starts with the first cycle, and restarts when all
//! SubDevices are in operation, so that a way up that fails can be seen, too. Phases are taken a
//! few cycles later, when all SubDevices have started all their activities.

pub mod cycle;
pub mod series;

use std::collections::VecDeque;

use cycle::{CycleSeen, Phases};
use isocat_maindevice::MainDevice;
use isocat_maindevice::segment::Timing;
use isocat_segment::Scenario;
use isocat_sim::bench::{Intent, is_cyclic};
use isocat_sim::judge::{HostPhase, Sync0Error};
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::run::intent;
use isocat_sim::{Segment, Tap};
use isocat_sync::{Moment, phase};
use isocat_wire::AlState;
use isocat_wire::time::{Nanos, Picos, Time, True};
use series::{Histogram, Series};

use crate::moment;
use crate::timeline::Timeline;

/// Follows a run.
#[derive(Debug)]
pub struct Recording {
    duration: Picos,
    limit: Nanos,
    spans: usize,
    began: Option<Began>,
    devices: Vec<DeviceRecord>,
    host_phase: Series,
    servo: Vec<(Picos, phase::State)>,
    incidents: Vec<Incident>,
    unsaid: u64,
    lost: u64,
    wrong: u64,
    /// Times of the cyclic frames that have left in this cycle.
    left: Vec<Time<True>>,
    last: Picos,
    timing: Option<Timing>,
    reference: Option<usize>,
}

/// What is known at the beginning of operation.
#[derive(Debug)]
struct Began {
    at: Time<True>,
    reference: Option<usize>,
    host: HostPhase,
    settled: Time<True>,
    operating: bool,
}

/// The record of one SubDevice.
#[derive(Debug, Default)]
struct DeviceRecord {
    judge: Option<Sync0Error>,
    sync0: Series,
    histogram: Histogram,
    difference: Series,
    phases: Option<Phases>,
    missed: Vec<(Picos, u16)>,
    missed_count: u64,
    /// The latest events, to be kept if something goes wrong.
    recent: VecDeque<(Time<True>, Moment)>,
    around_miss: Option<AroundMiss>,
}

/// The events around the first pulse that found no outputs ready.
#[derive(Debug)]
struct AroundMiss {
    at: Time<True>,
    events: Vec<(Time<True>, Moment)>,
}

/// An incident during the recording.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Incident {
    /// Time since the beginning of the recording.
    pub at: Picos,
    /// The SubDevice; `None` concerns the segment.
    pub device: Option<usize>,
    /// Description.
    pub what: String,
}

/// The result of a recording.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// Whether all SubDevices were in operation: the recording is then that of the judged time,
    /// otherwise that of the way up from the first cycle on.
    pub operating: bool,
    /// Length of the recording.
    pub length: Picos,
    /// The SubDevices, by position.
    pub devices: Vec<RecordedDevice>,
    /// Arrival of cyclic frames at the reference clock, less their due time, ps.
    pub host_phase: Series,
    /// States of the host's servo, and the time of each change.
    pub servo: Vec<(Picos, phase::State)>,
    /// Incidents in the order of time; at most [`MOST_INCIDENTS`].
    pub incidents: Vec<Incident>,
    /// Number of incidents beyond these.
    pub unsaid: u64,
}

/// The recording of one SubDevice.
#[derive(Clone, Debug, Default)]
pub struct RecordedDevice {
    /// SYNC0 against the ideal grid of the reference clock: ps.
    pub sync0: Series,
    /// The same values by size.
    pub histogram: Histogram,
    /// Register 0x092C in the ESC in each cycle, ps. Empty without SYNC0, and at the reference
    /// clock.
    pub difference: Series,
    /// Its cycle; `None` if none was observed.
    pub cycle: Option<CycleSeen>,
    /// The first missed SM events, and the counter's value.
    pub missed: Vec<(Picos, u16)>,
    /// Number of all missed SM events.
    pub missed_count: u64,
    /// The events around the first pulse that found no outputs ready. Times count from its instant
    /// and are negative before it. On the way up no event is counted as missed yet, but it is kept
    /// nevertheless.
    pub around_miss: Option<Timeline>,
}

/// Number of incidents that are kept.
pub const MOST_INCIDENTS: usize = 200;
/// Largest number of cyclic frames of one cycle.
const MOST_LEFT: usize = 64;
/// Number of missed events of one SubDevice that are kept.
const MOST_MISSED: usize = 50;
/// Cycles at the beginning and at the end of operation in which no phases are taken.
const SETTLING: i64 = 8;
/// Number of events kept before the first missed one, and after it.
const BEFORE: usize = 28;
const AFTER: usize = 14;

/// Number of time spans in the series of each SubDevice, for a segment of `devices` SubDevices. A
/// page of all of them stays below 2 MB.
pub fn spans(devices: usize) -> usize {
    (4_000 / devices.max(1)).clamp(40, 400)
}

impl Recording {
    /// Follows a run of `scenario`, with as many spans of time as its page has.
    pub fn of(scenario: &Scenario) -> Self {
        Self::new(scenario.duration, scenario.sync0_limit, spans(scenario.devices.len()))
    }
    /// Records a run that is judged for `duration`, with SYNC0 errors up to `limit` taken as
    /// synchronized. Series have up to `spans` spans of time.
    pub fn new(duration: Nanos, limit: Nanos, spans: usize) -> Self {
        Self {
            duration: duration.into(),
            limit,
            spans,
            began: None,
            devices: Vec::new(),
            host_phase: Series::new(spans),
            servo: Vec::new(),
            incidents: Vec::new(),
            unsaid: 0,
            lost: 0,
            wrong: 0,
            left: Vec::new(),
            last: Picos(0),
            timing: None,
            reference: None,
        }
    }

    /// The result of the recording.
    pub fn finish(self) -> Recorded {
        let devices = self.devices.into_iter().map(|device| RecordedDevice {
            sync0: device.sync0,
            histogram: device.histogram,
            difference: device.difference,
            cycle: device.phases.and_then(Phases::finish),
            missed: device.missed,
            missed_count: device.missed_count,
            around_miss: device.around_miss.map(|around| Timeline {
                entries: around.events.iter().map(|(at, what)| (*at - around.at, *what)).collect(),
            }),
        });
        Recorded {
            operating: self.began.is_some_and(|began| began.operating),
            length: self.last,
            devices: devices.collect(),
            host_phase: self.host_phase,
            servo: self.servo,
            incidents: self.incidents,
            unsaid: self.unsaid,
        }
    }

    /// Restarts the recording at `at`.
    fn begin(&mut self, at: Time<True>, intent: &Intent, operating: bool) {
        let settling = Picos(SETTLING * Picos::from(intent.send.cycle).0);
        let judge = |position: usize| {
            let grid = intent.sync0.get(position).copied().flatten()?;
            Some(Sync0Error::new(grid, self.limit.into()))
        };
        let timing = self.timing.as_ref();
        self.devices = (0..timing.map_or(0, |timing| timing.devices.len()))
            .map(|position| DeviceRecord {
                judge: judge(position),
                sync0: Series::new(self.spans),
                difference: Series::new(self.spans),
                phases: timing.map(|timing| Phases::new(timing, position)),
                ..DeviceRecord::default()
            })
            .collect();
        self.began = Some(Began {
            at,
            reference: self.reference,
            host: HostPhase::new(intent.send),
            settled: at + settling,
            operating,
        });
        self.host_phase = Series::new(self.spans);
        self.servo.clear();
        self.incidents.clear();
        self.unsaid = 0;
    }

    fn incident(&mut self, at: Picos, device: Option<usize>, what: String) {
        if self.incidents.len() < MOST_INCIDENTS {
            self.incidents.push(Incident { at, device, what });
        } else {
            self.unsaid += 1;
        }
    }

    /// Time since the beginning, if `at` is in the judged time or on the way up.
    fn since(&self, at: Time<True>) -> Option<Picos> {
        let began = self.began.as_ref()?;
        let since = at - began.at;
        let end = if began.operating { self.duration } else { Picos(i64::MAX) };
        (Picos(0)..end).contains(&since).then_some(since)
    }
}

impl Tap for Recording {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        // Frames are kept up to a limit, in case no cycle takes them.
        if sent && self.left.len() < MOST_LEFT && is_cyclic(bytes) {
            self.left.push(at);
        }
    }

    fn judging_begins(&mut self, at: Time<True>, intent: &Intent) {
        self.begin(at, intent, true);
    }

    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        if self.began.is_none() {
            let found = main.segment();
            (self.timing, self.reference) = (found.timing.clone(), found.reference);
            self.begin(at, &intent(main, self.limit), false);
        }
        let Some(since) = self.since(at) else { return };
        self.last = since;
        let Some(began) = &mut self.began else { return };
        if let Some(reference) = began.reference {
            let entry = segment.path().entries.iter().find(|entry| entry.device == reference);
            for start in self.left.drain(..) {
                let Some(entry) = entry else { continue };
                let clock = &segment.devices()[reference];
                let error = began.host.frame(clock.system_time_ps(start + entry.after));
                self.host_phase.push(since, error.0);
            }
            for (position, device) in self.devices.iter_mut().enumerate() {
                let steered = device.judge.is_some() && position != reference;
                if let Some(chip) = segment.devices().get(position).filter(|_| steered) {
                    let difference = chip.esc.system_time_difference();
                    device.difference.push(since, Picos::from(difference).0);
                }
            }
        }
        if let Some(state) = main.phase()
            && self.servo.last().is_none_or(|(_, last)| *last != state)
            && self.servo.len() < MOST_INCIDENTS
        {
            self.servo.push((since, state));
        }
        let counts = main.statistics();
        let missed = counts.frames_missed();
        if missed > self.lost {
            let what = format!("{} frames did not come back", missed - self.lost);
            self.lost = missed;
            self.incident(since, None, what);
        }
        if counts.working_counter_errors > self.wrong {
            let wrong = counts.working_counter_errors - self.wrong;
            self.wrong = counts.working_counter_errors;
            self.incident(since, None, format!("working counter wrong in {wrong} datagrams"));
        }
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        let Some(since) = self.since(at) else { return };
        let Some(began) = &self.began else { return };
        let Observation { device: position, device_at, event, .. } = *observation;
        let Some(device) = self.devices.get_mut(position) else { return };
        let clock = began.reference.map(|reference| &segment.devices()[reference]);
        let system = clock.map(|clock| clock.system_time_ps(at));
        if let (Observed::Sync0, Some(judge), Some(system)) = (event, &mut device.judge, system) {
            let error = judge.edge(at, system);
            device.sync0.push(since, error.0);
            device.histogram.push(error.0);
        }
        let last = self.duration + -(began.settled - began.at);
        let steady = at >= began.settled && (since < last || !began.operating);
        if let Some(moment) = moment::of(event) {
            device.remember(at, moment);
            if let Some(phases) = device.phases.as_mut().filter(|_| steady)
                && phases.happened(at, device_at, system, moment)
            {
                device.keep_around(at);
            }
        }
        match event {
            Observed::SmEventMissed(counter) => {
                device.missed_count += 1;
                if device.missed.len() < MOST_MISSED {
                    device.missed.push((since, counter));
                }
                device.keep_around(at);
                if device.missed_count <= MOST_MISSED as u64 {
                    let what = format!("SM event missed, 0x1C32:0B now {counter}");
                    self.incident(since, Some(position), what);
                }
            }
            Observed::OutputsSafe => {
                device.keep_around(at);
                let what = "its watchdog expired, outputs are safe".to_owned();
                self.incident(since, Some(position), what);
            }
            Observed::State(state, code) if state != AlState::Op || code.0 != 0 => {
                let what = format!("{}, AL status code {code}", state.name());
                self.incident(since, Some(position), what);
            }
            _ => {}
        }
    }
}

impl DeviceRecord {
    /// Keeps the events before the first pulse without outputs, and those after it.
    fn keep_around(&mut self, at: Time<True>) {
        if self.around_miss.is_none() {
            let events = self.recent.iter().copied().collect();
            self.around_miss = Some(AroundMiss { at, events });
        }
    }

    fn remember(&mut self, at: Time<True>, moment: Moment) {
        match &mut self.around_miss {
            None => {
                if self.recent.len() == BEFORE {
                    self.recent.pop_front();
                }
                self.recent.push_back((at, moment));
            }
            Some(around) if around.events.len() < BEFORE + AFTER => {
                around.events.push((at, moment))
            }
            Some(_) => {}
        }
    }
}
