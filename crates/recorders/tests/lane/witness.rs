//! A tap that receives all that a run reports, and keeps digests of it.

use std::fmt::Debug;
use std::hash::{DefaultHasher, Hasher};
use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use isocat_maindevice::{Event, MainDevice, Port};
use isocat_recorders::capture::Capture;
use isocat_recorders::series::Series;
use isocat_recorders::series::csv::Csv;
use isocat_recorders::trace::Trace;
use isocat_recorders::waves::Waves;
use isocat_segment::Scenario;
use isocat_sim::bench::{Intent, Measured};
use isocat_sim::fault::Happened;
use isocat_sim::observation::Observation;
use isocat_sim::probe::Sight;
use isocat_sim::{Lost, Segment, Tap};
use isocat_wire::time::{Time, True};

/// A digest of all bytes that were written.
#[derive(Clone, Default)]
pub struct Digest(Arc<Mutex<DefaultHasher>>);

impl Digest {
    /// The digest of these bytes alone.
    pub fn of(bytes: &[u8]) -> u64 {
        let mut hasher = DefaultHasher::new();
        hasher.write(bytes);
        hasher.finish()
    }

    /// Adds the state of all SubDevices.
    pub fn look(&mut self, segment: &Segment) {
        for device in segment.devices() {
            let esc = &device.esc;
            self.add(&esc.registers());
            self.add(esc.ram());
            let at = (esc.next_event(), esc.reach());
            self.debug(&(at, esc.label(2), esc.label(3), esc.sync_pulses_without_edge()));
            self.debug(&(device.stack.state(), device.stack.status_code()));
            self.debug(&(device.stack.next_timeout(), device.stack.sync()));
        }
    }

    /// The digest of all that was added.
    pub fn value(&self) -> u64 {
        self.0.lock().expect("no thread panicked").finish()
    }

    fn add(&mut self, bytes: &[u8]) {
        self.0.lock().expect("no thread panicked").write(bytes);
    }

    fn debug(&mut self, value: &impl Debug) {
        self.add(format!("{value:?}").as_bytes());
    }
}

impl Write for Digest {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.add(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// All recorders, and digests of the calls to the tap.
pub struct Witness {
    capture: Capture<Digest>,
    waves: Waves<Digest>,
    trace: Trace<Digest>,
    series: Series,
    files: [Digest; 4],
    calls: Digest,
    devices: Digest,
    cycles: u64,
    judged: u64,
}

impl Witness {
    /// A witness for a run of this scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let names: Vec<String> = scenario.devices.iter().map(|d| d.name.clone()).collect();
        let files: [Digest; 4] = std::array::from_fn(|_| Digest::default());
        let [capture, waves, trace, series] = files.clone();
        // A tap on a cable changes the simulation: it follows all frames from port to port.
        // Scenarios with a seed divisible by 4 have one.
        let last = [names.len() - 1];
        let cables = if scenario.seed.is_multiple_of(4) { &last[..] } else { &[] };
        let probes = if scenario.seed.is_multiple_of(2) { &last[..] } else { &[] };
        let capture = Capture::new(capture).expect("it takes everything").with_names(names.clone());
        let capture = capture.with_probes(probes).and_then(|capture| capture.with_cables(cables));
        let table = Box::new(Csv::new(series).expect("it takes everything"));
        Self {
            capture: capture.expect("it takes everything"),
            waves: Waves::new(waves, names.clone()),
            trace: Trace::new(trace, &names).expect("it takes everything"),
            series: Series::new(table, names),
            files,
            calls: Digest::default(),
            devices: Digest::default(),
            cycles: 0,
            judged: 0,
        }
    }

    /// The digests by name; the value of "judged" is the number of judged cycles.
    pub fn finish(self) -> Vec<(&'static str, u64)> {
        let Self { capture, waves, trace, series, files, calls, devices, judged, .. } = self;
        let ended = [capture.finish().map(drop), waves.finish(), trace.finish(), series.finish()];
        assert!(ended.iter().all(Result::is_ok), "it takes everything: {ended:?}");
        let names = ["capture", "waves", "trace", "series"];
        let mut all: Vec<_> =
            names.into_iter().zip(&files).map(|(name, file)| (name, file.value())).collect();
        all.extend([("calls", calls.value()), ("devices", devices.value()), ("judged", judged)]);
        all
    }

    /// Adds the state of all SubDevices to the digest.
    fn look(&mut self, segment: &Segment) {
        for device in segment.devices() {
            self.devices.debug(&(device.esc.last_frame(), device.is_quiet()));
        }
        self.devices.look(segment);
    }

    fn taps(&mut self) -> [&mut dyn Tap; 4] {
        [&mut self.capture, &mut self.waves, &mut self.trace, &mut self.series]
    }
}

impl Tap for Witness {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.taps().into_iter().for_each(|tap| tap.frame(at, sent, bytes));
        self.calls.debug(&(at, sent));
        self.calls.add(bytes);
    }
    fn secondary_frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.taps().into_iter().for_each(|tap| tap.secondary_frame(at, sent, bytes));
        self.calls.debug(&("secondary", at, sent));
        self.calls.add(bytes);
    }
    fn lost(&mut self, at: Time<True>, port: Port, why: Option<Lost>) {
        self.taps().into_iter().for_each(|tap| tap.lost(at, port, why));
        self.calls.debug(&(at, port, why));
    }
    fn probes(&self) -> Vec<usize> {
        self.capture.probes()
    }
    fn cables(&self) -> Vec<usize> {
        self.capture.cables()
    }
    fn probed(&mut self, at: Time<True>, device: usize, sight: Sight, bytes: &[u8]) {
        self.taps().into_iter().for_each(|tap| tap.probed(at, device, sight, bytes));
        self.calls.debug(&(at, device, sight));
        self.calls.add(bytes);
    }
    fn passed(&mut self, at: Time<True>, segment: &Segment) {
        self.taps().into_iter().for_each(|tap| tap.passed(at, segment));
        // Checks the state after each frame of some cycles, most of them at the beginning.
        if self.judged < 8 && self.cycles.is_multiple_of(8) || self.judged % 16 == 3 {
            self.look(segment);
        }
    }
    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        self.taps().into_iter().for_each(|tap| tap.observed(segment, at, observation));
        self.calls.debug(&(at, observation));
    }
    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        self.taps().into_iter().for_each(|tap| tap.measured(at, device, measured));
        self.calls.debug(&(at, device, measured));
    }
    fn fault(&mut self, happened: &Happened) {
        self.taps().into_iter().for_each(|tap| tap.fault(happened));
        self.calls.debug(happened);
    }
    fn event(&mut self, at: Time<True>, event: &Event) {
        self.taps().into_iter().for_each(|tap| tap.event(at, event));
        self.calls.debug(&(at, event));
    }
    fn judging_begins(&mut self, at: Time<True>, intent: &Intent) {
        self.taps().into_iter().for_each(|tap| tap.judging_begins(at, intent));
        self.judged = 1;
    }
    fn judging_ends(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        self.taps().into_iter().for_each(|tap| tap.judging_ends(at, main, segment));
        self.look(segment);
    }
    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        self.taps().into_iter().for_each(|tap| tap.cycle(at, main, segment));
        self.cycles += 1;
        self.judged += u64::from(self.judged > 0);
        if self.judged % 8 == 1 {
            self.look(segment);
        }
    }
}
