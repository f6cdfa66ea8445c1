//! The files that a simulated run writes while it runs: captures, waveforms, traces, series.

use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use clap::Args;
use isocat_engine::recording::Recording;
use isocat_maindevice::{Event, MainDevice, Port};
use isocat_recorders::capture::Capture;
use isocat_recorders::series::csv::Csv;
use isocat_recorders::series::parquet::Parquet;
use isocat_recorders::series::{Series, Table};
use isocat_recorders::trace::Trace;
use isocat_recorders::waves::Waves;
use isocat_segment::Scenario;
use isocat_sim::bench::{Intent, Measured};
use isocat_sim::observation::Observation;
use isocat_sim::probe::Sight;
use isocat_sim::{Lost, Segment, ServedCycle, Tap};
use isocat_wire::time::{Time, True};

use super::output::Output;
use super::run::unwritable;

/// Arguments of `run` for its files, besides `--capture` and `--waves`.
#[derive(Args, Debug)]
#[group(skip)]
pub struct Options {
    /// With --capture: also frames as they enter and leave the SubDevice at this position, as a
    /// separate interface; may be given several times
    #[arg(long, value_name = "POSITION", requires = "capture")]
    tap: Vec<usize>,
    /// With --capture: also frames on the cable in front of the SubDevice at this position, in both
    /// directions, as a tap in the line sees them, as a separate interface; may be given several
    /// times
    #[arg(long, value_name = "POSITION", requires = "capture")]
    tap_cable: Vec<usize>,
    /// Write the events at the MainDevice and each SubDevice to this file, as a trace for Perfetto
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Write a table with one row for each SubDevice and cycle to this file: CSV if it ends in
    /// .csv, Parquet if in .parquet
    #[arg(long, value_name = "FILE")]
    pub series: Option<PathBuf>,
}

/// The format of a table.
#[derive(Clone, Copy, Default)]
enum TableForm {
    #[default]
    Csv,
    Parquet,
}

impl Options {
    /// Why these files are not possible on a real interface, if they are requested.
    pub fn refused_beside_interface(&self) -> Option<String> {
        let needs = |flag: &str, why: &str| {
            Some(format!("{flag} is beside --interface; expected a simulation: {why}"))
        };
        match self {
            Self { tap, .. } if !tap.is_empty() => {
                needs("--tap", "frames between real devices are not visible")
            }
            Self { tap_cable, .. } if !tap_cable.is_empty() => {
                needs("--tap-cable", "frames between real devices are not visible")
            }
            Self { trace: Some(_), .. } => {
                needs("--trace", "pulses and steps of real devices are not visible")
            }
            Self { series: Some(_), .. } => {
                needs("--series", "its figures are true time, which real devices do not tell")
            }
            _ => None,
        }
    }

    /// The requested files, including these.
    pub fn with<'a>(
        &'a self,
        capture: Option<&'a Path>,
        waves: Option<&'a Path>,
    ) -> Result<Wanted<'a>, String> {
        let (trace, series) = (self.trace.as_deref(), self.series.as_deref());
        let form = self.table_form()?;
        let paths = [capture, waves, trace, series];
        Ok(Wanted { paths, form, probes: &self.tap, cables: &self.tap_cable })
    }

    fn table_form(&self) -> Result<TableForm, String> {
        TableForm::of(self.series.as_deref())
    }
}

impl TableForm {
    /// The format by the ending of the file's name.
    fn of(path: Option<&Path>) -> Result<Self, String> {
        let Some(path) = path else { return Ok(Self::Csv) };
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        match ending.to_ascii_lowercase().as_str() {
            "csv" => Ok(Self::Csv),
            "parquet" => Ok(Self::Parquet),
            _ => Err(format!(
                "--series {}: the ending says what is written; expected .csv or .parquet, found {ending:?}",
                path.display()
            )),
        }
    }
}

/// The requested files.
#[derive(Default)]
pub struct Wanted<'a> {
    /// Paths of capture, waves, trace, series.
    paths: [Option<&'a Path>; 4],
    form: TableForm,
    /// Positions of the SubDevices in front of which frames are also captured.
    probes: &'a [usize],
    /// Positions of the SubDevices in front of which the cable is also tapped.
    cables: &'a [usize],
}

impl<'a> Wanted<'a> {
    /// Capture, waves, trace and series at these paths.
    pub fn of(paths: [Option<&'a Path>; 4]) -> Result<Self, String> {
        Ok(Self { paths, form: TableForm::of(paths[3])?, ..Self::default() })
    }

    fn check(&self, devices: usize) -> Result<(), String> {
        let last = devices.saturating_sub(1);
        for (flag, positions) in [("--tap", self.probes), ("--tap-cable", self.cables)] {
            if let Some(position) = positions.iter().find(|position| **position >= devices) {
                return Err(format!(
                    "{flag} {position}: there is no such SubDevice; expected a position from 0 to {last}"
                ));
            }
        }
        Ok(())
    }
}

/// The open files.
pub struct Files {
    capture: Option<Capture>,
    waves: Option<Waves>,
    trace: Option<Trace>,
    series: Option<Series>,
    /// The four files in this order.
    outputs: [Option<(PathBuf, Output)>; 4],
    /// The data for the page of the report, if one is requested.
    pub recording: Option<Recording>,
}

impl Files {
    /// Creates the requested files; none if there is an error in the request.
    pub fn create(wanted: &Wanted<'_>, scenario: &Scenario) -> Result<Self, String> {
        wanted.check(scenario.devices.len())?;
        let (asked, form) = (wanted.paths, wanted.form);
        let names: Vec<String> = scenario.devices.iter().map(|d| d.name.clone()).collect();
        let mut outputs = [const { None }; 4];
        for ((output, path), what) in outputs.iter_mut().zip(asked).zip(WHAT) {
            let create = |path: &Path| Output::create(path).map(|output| (path.to_owned(), output));
            *output =
                path.map(create).transpose().map_err(|error| unwritable(what, path, &error))?;
        }
        let [capture, waves, trace, series] = &outputs;
        let failed =
            |number: usize| move |error: io::Error| unwritable(WHAT[number], asked[number], &error);
        let capture = capture.as_ref().map(|output| {
            let capture = Capture::new(buffered(output)?)?.with_names(names.clone());
            capture.with_probes(wanted.probes)?.with_cables(wanted.cables)
        });
        let waves = waves.as_ref().map(|output| Ok(Waves::new(buffered(output)?, names.clone())));
        let trace = trace.as_ref().map(|output| Trace::new(buffered(output)?, &names));
        let series =
            series.as_ref().map(|output| Ok(Series::new(table(output, form)?, names.clone())));
        Ok(Self {
            capture: capture.transpose().map_err(failed(0))?,
            waves: waves.transpose().map_err(failed(1))?,
            trace: trace.transpose().map_err(failed(2))?,
            series: series.transpose().map_err(failed(3))?,
            outputs,
            recording: None,
        })
    }

    /// Writes the rest; returns the recording.
    pub fn finish(self) -> Result<Option<Recording>, String> {
        let Self { capture, waves, trace, series, outputs, recording } = self;
        let ended = [
            capture.map(|capture| capture.finish().map(drop)),
            waves.map(Waves::finish),
            trace.map(Trace::finish),
            series.map(Series::finish),
        ];
        // One that can't be written does not take the others with it.
        let mut failed = None;
        for (number, (ended, output)) in ended.into_iter().zip(outputs).enumerate() {
            let (Some(ended), Some((path, output))) = (ended, output) else { continue };
            if let Err(error) = ended.and_then(|()| output.commit()) {
                failed.get_or_insert_with(|| unwritable(WHAT[number], Some(&path), &error));
            }
        }
        match failed {
            Some(message) => Err(message),
            None => Ok(recording),
        }
    }

    /// Whether no file was requested.
    pub fn is_empty(&self) -> bool {
        self.outputs.iter().all(Option::is_none)
    }

    fn taps(&mut self) -> impl Iterator<Item = &mut dyn Tap> {
        fn one<T: Tap>(tap: &mut Option<T>) -> Option<&mut dyn Tap> {
            tap.as_mut().map(|tap| tap as &mut dyn Tap)
        }
        let Self { capture, waves, trace, series, recording, .. } = self;
        let all = [one(capture), one(waves), one(trace), one(series), one(recording)];
        all.into_iter().flatten()
    }
}

/// Names of the files in messages.
const WHAT: [&str; 4] = ["capture", "waves", "trace", "series"];

fn buffered((_, output): &(PathBuf, Output)) -> io::Result<BufWriter<std::fs::File>> {
    Ok(BufWriter::new(output.file()?))
}

fn table(output: &(PathBuf, Output), form: TableForm) -> io::Result<Box<dyn Table>> {
    let output = buffered(output)?;
    Ok(match form {
        TableForm::Csv => Box::new(Csv::new(output)?),
        TableForm::Parquet => Box::new(Parquet::new(output)?),
    })
}

impl Tap for Files {
    fn frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.taps().for_each(|tap| tap.frame(at, sent, bytes));
    }
    fn secondary_frame(&mut self, at: Time<True>, sent: bool, bytes: &[u8]) {
        self.taps().for_each(|tap| tap.secondary_frame(at, sent, bytes));
    }
    fn lost(&mut self, at: Time<True>, port: Port, why: Option<Lost>) {
        self.taps().for_each(|tap| tap.lost(at, port, why));
    }
    fn probes(&self) -> Vec<usize> {
        self.capture.as_ref().map_or(Vec::new(), Tap::probes)
    }
    fn cables(&self) -> Vec<usize> {
        self.capture.as_ref().map_or(Vec::new(), Tap::cables)
    }
    fn probed(&mut self, at: Time<True>, device: usize, sight: Sight, bytes: &[u8]) {
        self.taps().for_each(|tap| tap.probed(at, device, sight, bytes));
    }
    fn observes(&self) -> bool {
        !self.is_empty() || self.recording.is_some()
    }
    fn observed(&mut self, segment: &Segment, at: Time<True>, observation: &Observation) {
        self.taps().for_each(|tap| tap.observed(segment, at, observation));
    }
    fn measured(&mut self, at: Time<True>, device: usize, measured: &Measured) {
        self.taps().for_each(|tap| tap.measured(at, device, measured));
    }
    fn event(&mut self, at: Time<True>, event: &Event) {
        self.taps().for_each(|tap| tap.event(at, event));
    }
    fn judging_begins(&mut self, at: Time<True>, intent: &Intent) {
        self.taps().for_each(|tap| tap.judging_begins(at, intent));
    }
    fn judging_ends(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        self.taps().for_each(|tap| tap.judging_ends(at, main, segment));
    }
    fn cycle(&mut self, at: Time<True>, main: &MainDevice, segment: &Segment) {
        self.taps().for_each(|tap| tap.cycle(at, main, segment));
    }
    fn served_cycle(&mut self, at: Time<True>, cycle: Option<ServedCycle>, segment: &Segment) {
        self.taps().for_each(|tap| tap.served_cycle(at, cycle, segment));
    }
}
