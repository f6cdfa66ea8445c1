//! The files that a simulated run writes as it goes: captures, waveforms, traces, series.

use std::fs::File;
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
use isocat_sim::{Lost, Segment, Tap};
use isocat_wire::time::{Time, True};

use super::run::{Arguments, unwritable};

/// Arguments of `run` for its files, beside `--capture` and `--waves`.
#[derive(Args, Debug)]
#[group(skip)]
pub struct Options {
    /// With --capture: also frames as they enter and leave the SubDevice at this position, as an interface of their own; may
    /// be given several times
    #[arg(long, value_name = "POSITION", requires = "capture")]
    tap: Vec<usize>,
    /// Write what happens at the MainDevice and each SubDevice to this file, as a trace for Perfetto
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Write a table with one row for each SubDevice and cycle to this file: CSV if it ends in .csv, Parquet if in .parquet
    #[arg(long, value_name = "FILE")]
    pub series: Option<PathBuf>,
}

/// What a table is written as.
#[derive(Clone, Copy)]
enum TableForm {
    Csv,
    Parquet,
}

impl Options {
    /// Why these files can't be had of a real interface, if they are wanted.
    pub fn refused_beside_interface(&self) -> Option<String> {
        let needs = |flag: &str, why: &str| {
            Some(format!("{flag} is beside --interface; expected a simulation: {why}"))
        };
        match self {
            Self { tap, .. } if !tap.is_empty() => {
                needs("--tap", "nobody sees the frames between real devices")
            }
            Self { trace: Some(_), .. } => {
                needs("--trace", "nobody sees the pulses and steps of real devices")
            }
            Self { series: Some(_), .. } => {
                needs("--series", "its figures are true time, which real devices do not tell")
            }
            _ => None,
        }
    }

    fn check(&self, devices: usize) -> Result<(), String> {
        if let Some(position) = self.tap.iter().find(|position| **position >= devices) {
            let last = devices.saturating_sub(1);
            return Err(format!(
                "--tap {position}: there is no such SubDevice; expected a position from 0 to {last}"
            ));
        }
        self.table_form().map(|_| ())
    }

    fn table_form(&self) -> Result<TableForm, String> {
        let Some(path) = &self.series else { return Ok(TableForm::Csv) };
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
        match ending.to_ascii_lowercase().as_str() {
            "csv" => Ok(TableForm::Csv),
            "parquet" => Ok(TableForm::Parquet),
            _ => Err(format!(
                "--series {}: the ending says what is written; expected .csv or .parquet, found {ending:?}",
                path.display()
            )),
        }
    }
}

/// The files that were asked for.
pub struct Files {
    capture: Option<Capture>,
    waves: Option<Waves>,
    trace: Option<Trace>,
    series: Option<Series>,
    /// What the page of the report is made of, if one is wanted.
    pub recording: Option<Recording>,
}

impl Files {
    /// Creates those that `arguments` ask for; none if something is wrong with what they ask.
    pub fn create(arguments: &Arguments, scenario: &Scenario) -> Result<Self, String> {
        let options = &arguments.files;
        options.check(scenario.devices.len())?;
        let form = options.table_form()?;
        let names: Vec<String> = scenario.devices.iter().map(|d| d.name.clone()).collect();
        let capture = |path: &Path| {
            Capture::create(path)?.with_names(names.clone()).with_probes(&options.tap)
        };
        let series = |path: &Path| Ok(Series::new(table(path, form)?, names.clone()));
        let waves = |path: &Path| Waves::create(path, names.clone());
        let trace = |path: &Path| Trace::create(path, &names);
        Ok(Self {
            capture: open("capture", arguments.capture.as_ref(), capture)?,
            waves: open("waves", arguments.waves.as_ref(), waves)?,
            trace: open("trace", options.trace.as_ref(), trace)?,
            series: open("series", options.series.as_ref(), series)?,
            recording: None,
        })
    }

    /// Writes what is left; gives the recording back.
    pub fn finish(self, arguments: &Arguments) -> Result<Option<Recording>, String> {
        let Self { capture, waves, trace, series, recording } = self;
        let options = &arguments.files;
        for (what, path, ended) in [
            ("capture", &arguments.capture, capture.map(|capture| capture.finish().map(drop))),
            ("waves", &arguments.waves, waves.map(Waves::finish)),
            ("trace", &options.trace, trace.map(Trace::finish)),
            ("series", &options.series, series.map(Series::finish)),
        ] {
            if let Some(Err(error)) = ended {
                return Err(unwritable(what, path.as_deref(), &error));
            }
        }
        Ok(recording)
    }

    fn taps(&mut self) -> impl Iterator<Item = &mut dyn Tap> {
        fn one<T: Tap>(tap: &mut Option<T>) -> Option<&mut dyn Tap> {
            tap.as_mut().map(|tap| tap as &mut dyn Tap)
        }
        let Self { capture, waves, trace, series, recording } = self;
        let all = [one(capture), one(waves), one(trace), one(series), one(recording)];
        all.into_iter().flatten()
    }
}

fn open<T>(
    what: &str,
    path: Option<&PathBuf>,
    create: impl FnOnce(&Path) -> io::Result<T>,
) -> Result<Option<T>, String> {
    let made = path.map(|path| create(path)).transpose();
    made.map_err(|error| unwritable(what, path.map(PathBuf::as_path), &error))
}

fn table(path: &Path, form: TableForm) -> io::Result<Box<dyn Table>> {
    let output = BufWriter::new(File::create(path)?);
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
    fn probed(&mut self, at: Time<True>, device: usize, entered: bool, bytes: &[u8]) {
        self.taps().for_each(|tap| tap.probed(at, device, entered, bytes));
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
}
