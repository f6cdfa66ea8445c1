//! Writes the events of a run as a Perfetto trace in its own format, with ns stamps of true time.
//!
//! The MainDevice and each SubDevice are processes with tracks below them. Events are written as
//! they are reported, which is in the order of time only for each SubDevice; readers sort them.

pub mod schema;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use isocat_maindevice::{MainDevice, Port};
use isocat_sim::bench::Measured;
use isocat_sim::observation::{Observation, Observed};
use isocat_sim::{Lost, Segment, Tap};
use isocat_subdevice::{Event, Step};
use isocat_sync::object::{INPUT_PARAMETER, OUTPUT_PARAMETER, sub};
use isocat_sync::phase::State as Servo;
use isocat_wire::time::{Time, True};
use isocat_wire::{AlState, ObjectAddress, datagram, frame};
use prost::Message;
use schema::{
    CounterDescriptor, ProcessDescriptor, TracePacket, TrackDescriptor, TrackEvent, Type,
};

/// Tracks of a SubDevice. Each step has its own track, because steps of two cycles may overlap.
const TRACKS: [&str; 13] = [
    "AL state",
    "SYNC0",
    "SYNC1",
    "SM2",
    "SM3",
    "SM event missed",
    "copy outputs",
    "application",
    "outputs valid",
    "latch inputs",
    "copy inputs",
    "SYNC0 error",
    "0x092C",
];
const AL_STATE: usize = 0;
const SYNC0: usize = 1;
const SYNC1: usize = 2;
const SM2: usize = 3;
const SM3: usize = 4;
const MISSED: usize = 5;
const STEPS: std::ops::Range<usize> = 6..11;
const SYNC0_ERROR: usize = 11;
const DIFFERENCE: usize = 12;

/// Tracks of the MainDevice. Frames have further ones, as many as are in flight at the same time.
const MAIN_TRACKS: [&str; 3] = ["host phase error", "servo", "lost frames"];
const HOST_PHASE: usize = 0;
const SERVO: usize = 1;
const LOST: usize = 2;
const FRAMES: usize = 3;
/// Frames in flight at the same time that are drawn.
const LANES: usize = 64;
/// The text at a pulse that was due and made no edge.
const LOST_PULSE: &str = "no edge: still active";

/// Writes a trace.
pub struct Trace<W: Write = BufWriter<File>> {
    output: W,
    /// The first error; later events are dropped.
    failed: Option<io::Error>,
    bytes: Vec<u8>,
    devices: Vec<DeviceTracks>,
    /// Frames in flight.
    flying: VecDeque<Flying>,
    lanes: usize,
    phase_errors: u64,
    servo: Option<Servo>,
    /// The latest stamp, which ends all open slices.
    latest: Time<True>,
}

#[derive(Default)]
struct DeviceTracks {
    /// Open slices of each step.
    open: [u32; STEPS.end - STEPS.start],
    difference: Option<i64>,
}

struct Flying {
    since: Time<True>,
    index: u8,
    lane: usize,
    name: String,
}

impl Trace {
    /// Creates the file. `names`: those of the SubDevices, by position; SubDevices without a name
    /// are not drawn.
    pub fn create(path: &Path, names: &[String]) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?), names)
    }
}

/// Number of a track: the MainDevice is process 0.
fn uuid(process: usize, track: Option<usize>) -> u64 {
    ((process as u64 + 1) << 8) + track.map_or(0, |track| track as u64 + 1)
}

impl<W: Write> Trace<W> {
    /// Begins a trace, written to `output`.
    pub fn new(output: W, names: &[String]) -> io::Result<Self> {
        let devices = names.iter().map(|_| DeviceTracks::default()).collect();
        let mut trace = Self {
            output,
            failed: None,
            bytes: Vec::new(),
            devices,
            flying: VecDeque::new(),
            lanes: 0,
            phase_errors: 0,
            servo: None,
            latest: Time::ZERO,
        };
        trace.process(0, "MainDevice");
        for (track, name) in MAIN_TRACKS.iter().enumerate() {
            trace.track(0, track, name, (track == HOST_PHASE).then_some("ns"));
        }
        for (position, name) in names.iter().enumerate() {
            trace.process(position + 1, &format!("SubDevice {position} ({name})"));
            for (track, name) in TRACKS.iter().enumerate() {
                let unit = [SYNC0_ERROR, DIFFERENCE].contains(&track).then_some("ns");
                trace.track(position + 1, track, name, unit);
            }
            trace.begin(Time::ZERO, position + 1, AL_STATE, AlState::Init.name());
        }
        match trace.failed.take() {
            Some(error) => Err(error),
            None => Ok(trace),
        }
    }

    /// Ends all open slices and the file; returns the first error.
    pub fn finish(mut self) -> io::Result<()> {
        let at = self.latest;
        for position in 0..self.devices.len() {
            self.close_steps(at, position);
            self.end(at, position + 1, AL_STATE);
        }
        if self.servo.is_some() {
            self.end(at, 0, SERVO);
        }
        match self.failed {
            Some(error) => Err(error),
            None => self.output.flush(),
        }
    }

    fn process(&mut self, process: usize, name: &str) {
        self.describe(TrackDescriptor {
            uuid: Some(uuid(process, None)),
            process: Some(ProcessDescriptor {
                pid: Some(process as i32 + 1),
                process_name: Some(name.to_owned()),
            }),
            child_ordering: Some(schema::EXPLICIT),
            ..TrackDescriptor::default()
        });
    }

    /// Describes a track. A track with a unit is a counter.
    fn track(&mut self, process: usize, track: usize, name: &str, unit: Option<&str>) {
        self.describe(TrackDescriptor {
            uuid: Some(uuid(process, Some(track))),
            parent_uuid: Some(uuid(process, None)),
            name: Some(name.to_owned()),
            counter: unit.map(|unit| CounterDescriptor { unit_name: Some(unit.to_owned()) }),
            sibling_order_rank: Some(track as i32),
            ..TrackDescriptor::default()
        });
    }

    fn describe(&mut self, descriptor: TrackDescriptor) {
        self.packet(TracePacket {
            trusted_packet_sequence_id: Some(1),
            track_descriptor: Some(descriptor),
            ..TracePacket::default()
        });
    }

    fn begin(&mut self, at: Time<True>, process: usize, track: usize, name: &str) {
        let name = Some(name.to_owned());
        self.event(at, process, track, Type::SliceBegin, TrackEvent { name, ..Default::default() });
    }

    fn end(&mut self, at: Time<True>, process: usize, track: usize) {
        self.event(at, process, track, Type::SliceEnd, TrackEvent::default());
    }

    fn instant(&mut self, at: Time<True>, process: usize, track: usize, name: &str) {
        let name = Some(name.to_owned());
        self.event(at, process, track, Type::Instant, TrackEvent { name, ..Default::default() });
    }

    fn count(&mut self, at: Time<True>, process: usize, track: usize, value: i64) {
        let event = TrackEvent { counter_value: Some(value), ..Default::default() };
        self.event(at, process, track, Type::Counter, event);
    }

    fn event(
        &mut self,
        at: Time<True>,
        process: usize,
        track: usize,
        kind: Type,
        rest: TrackEvent,
    ) {
        self.latest = self.latest.max(at);
        self.packet(TracePacket {
            timestamp: Some(at.as_nanos()),
            trusted_packet_sequence_id: Some(process as u32 + 1),
            track_event: Some(TrackEvent {
                r#type: Some(kind.into()),
                track_uuid: Some(uuid(process, Some(track))),
                ..rest
            }),
            track_descriptor: None,
        });
    }

    /// Writes a packet. A trace is a sequence of messages with one packet each, which readers merge
    /// into one.
    fn packet(&mut self, packet: TracePacket) {
        if self.failed.is_some() {
            return;
        }
        self.bytes.clear();
        let message = schema::Trace { packet: vec![packet] };
        message.encode(&mut self.bytes).expect("a Vec takes everything");
        self.failed = self.output.write_all(&self.bytes).err();
    }

    /// Ends the flight of a frame. The slice is written now, with both its ends.
    fn land(&mut self, at: Time<True>, index: u8) {
        let found = self.flying.iter().position(|frame| frame.index == index);
        if let Some(frame) = found.and_then(|found| self.flying.remove(found)) {
            self.begin(frame.since, 0, FRAMES + frame.lane, &frame.name);
            self.end(at, 0, FRAMES + frame.lane);
        }
    }

    fn close_steps(&mut self, at: Time<True>, position: usize) {
        for step in STEPS {
            let open = std::mem::take(&mut self.devices[position].open[step - STEPS.start]);
            for _ in 0..open {
                self.end(at, position + 1, step);
            }
        }
    }
}

/// The index of a step among the tracks of steps.
fn number(step: Step) -> usize {
    match step {
        Step::MapOutputs => 0,
        Step::Application => 1,
        Step::OutputsValid => 2,
        Step::LatchInputs => 3,
        Step::MapInputs => 4,
    }
}

impl<W: Write> Tap for Trace<W> {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        let Some((index, name)) = look_into(bytes) else { return };
        if sent {
            if self.flying.len() == LANES {
                self.flying.pop_front();
            }
            let is_free = |lane: &usize| self.flying.iter().all(|frame| frame.lane != *lane);
            let lane = (0..LANES).find(is_free).expect("fewer frames than lanes");
            while self.lanes <= lane {
                let track = FRAMES + self.lanes;
                self.lanes += 1;
                let name = match self.lanes {
                    1 => "frames".to_owned(),
                    number => format!("frames {number}"),
                };
                self.track(0, track, &name, None);
            }
            self.flying.push_back(Flying { since: at, index, lane, name });
        } else {
            self.land(at, index);
        }
    }

    fn secondary_frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        // In an unbroken ring, frames from the primary port come back at the secondary one.
        if let Some((index, _)) = look_into(bytes).filter(|_| !sent) {
            self.land(at, index);
        }
    }

    fn lost(&mut self, at: Time<True>, port: Port, why: Option<Lost>) {
        if port == Port::Primary {
            self.flying.retain(|frame| frame.since != at);
            let why = why.map_or("comes back damaged".to_owned(), |lost| lost.to_string());
            self.instant(at, 0, LOST, &why);
        }
    }

    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        let (position, process) = (observation.device, observation.device + 1);
        if position >= self.devices.len() {
            return;
        }
        match observation.event {
            Observed::Sync0 => self.instant(at, process, SYNC0, "SYNC0"),
            Observed::Sync1 => self.instant(at, process, SYNC1, "SYNC1"),
            Observed::Sm2 => self.instant(at, process, SM2, "SM2"),
            Observed::Sm3 => self.instant(at, process, SM3, "SM3"),
            Observed::SmEventMissed(counter) => {
                let has_outputs = segment.devices()[position].stack.sync().has_outputs();
                let index = if has_outputs { OUTPUT_PARAMETER } else { INPUT_PARAMETER };
                let object = ObjectAddress::new(index, sub::SM_EVENT_MISSED);
                self.instant(at, process, MISSED, &format!("{object} now {counter}"));
            }
            Observed::StillActive(Event::Sync1) => self.instant(at, process, SYNC1, LOST_PULSE),
            Observed::StillActive(_) => self.instant(at, process, SYNC0, LOST_PULSE),
            Observed::OutputsSafe => self.instant(at, process, SM2, "outputs safe: watchdog"),
            // They are at SYNC0; their values are for waveforms.
            Observed::Acknowledged(_) | Observed::Sampled(_) => {}
            Observed::Began(step) => {
                self.devices[position].open[number(step)] += 1;
                let track = STEPS.start + number(step);
                self.begin(at, process, track, TRACKS[track]);
            }
            Observed::Finished(step) => {
                let open = &mut self.devices[position].open[number(step)];
                if *open > 0 {
                    *open -= 1;
                    self.end(at, process, STEPS.start + number(step));
                }
            }
            Observed::State(state, code) => {
                if !segment.devices()[position].is_powered() {
                    self.close_steps(at, position);
                }
                self.end(at, process, AL_STATE);
                let name = match code.0 {
                    0 => state.name().to_owned(),
                    _ => format!("{state}, {code}"),
                };
                self.begin(at, process, AL_STATE, &name);
            }
        }
    }

    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        let error = measured.sync0_error.filter(|_| device < self.devices.len());
        let Some(error) = error else { return };
        let event = TrackEvent {
            double_counter_value: Some(error.0 as f64 / 1000.0),
            ..TrackEvent::default()
        };
        self.event(at, device + 1, SYNC0_ERROR, Type::Counter, event);
    }

    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        let errors = main.statistics().phase_error;
        if errors.count != self.phase_errors {
            self.phase_errors = errors.count;
            self.count(at, 0, HOST_PHASE, errors.last.0);
        }
        if main.phase() != self.servo {
            if self.servo.is_some() {
                self.end(at, 0, SERVO);
            }
            self.servo = main.phase();
            if let Some(servo) = self.servo {
                self.begin(at, 0, SERVO, name_of(servo));
            }
        }
        for (position, found) in main.segment().devices.iter().enumerate() {
            let Some(device) = segment.devices().get(position) else { return };
            if !found.dc.has_clock() || position >= self.devices.len() {
                continue;
            }
            let difference = device.esc.system_time_difference().0;
            let known = self.devices[position].difference.replace(difference);
            if known != Some(difference) {
                self.count(at, position + 1, DIFFERENCE, difference);
            }
        }
    }
}

fn name_of(servo: Servo) -> &'static str {
    match servo {
        Servo::Free => "free",
        Servo::Acquiring => "acquiring",
        Servo::Locked => "locked",
        Servo::Holdover => "holdover",
    }
}

/// The index of a frame's first datagram, which distinguishes it from others in flight, and its
/// commands in words: `FRMW 0x0910, LRW`. `None`: it is no EtherCAT frame.
fn look_into(bytes: &[u8]) -> Option<(u8, String)> {
    let mut datagrams = datagram::datagrams(frame::payload(bytes).ok()?).map_while(Result::ok);
    let first = datagrams.next()?;
    let words = |datagram: &datagram::Datagram<'_>| match datagram.header.command() {
        Ok(command) if command.is_logical() => command.name().to_owned(),
        Ok(command) => format!("{} 0x{:04X}", command.name(), datagram.header.ado()),
        Err(_) => "?".to_owned(),
    };
    let mut name = words(&first);
    for datagram in datagrams.by_ref().take(MOST_COMMANDS - 1) {
        name += ", ";
        name += &words(&datagram);
    }
    if datagrams.next().is_some() {
        name += " ...";
    }
    Some((first.header.index, name))
}

/// Commands that the name of a frame lists.
const MOST_COMMANDS: usize = 3;
