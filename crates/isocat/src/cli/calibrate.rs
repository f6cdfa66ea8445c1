//! `isocat calibrate`.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use isocat_conform::wire::{VirtualWire, Wire};
use isocat_engine::calibrate::{self, Step};
use isocat_engine::report::calibrate::CalibrationReport;
use isocat_esc::DriftLaw;
use isocat_segment::Scenario;

use super::run::progress_bar;
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

const EXAMPLES: &str = "\
Examples:
  isocat calibrate --interface eth0         what the chips of a real segment do, about half a minute (root)
  isocat calibrate --interface eth0 --chips chips.toml
                                            ... and what was told of each chip, for plan, run and serve:
  isocat run my.toml --chips chips.toml     the segment file, on the chips that were measured
  isocat calibrate --interface eth0 --profile chip.toml --device 2
                                            position 2 as keys of a device profile
  isocat calibrate my.toml --drift-law block
                                            the same on the virtual segment: it finds the law that was set

Exit code: 0 law and sign of each clock were told, 1 of one they were not or something could not be put back, 2 bad
input, no answer, or a segment that is in operation.";

/// Arguments of `calibrate`.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Segment file to calibrate in virtual time; without one, the built-in segment
    segment: Option<String>,
    /// Calibrate the segment on this network interface instead (root)
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "IF", conflicts_with_all = ["segment", "seed", "drift_law"])]
    interface: Option<String>,
    /// Network namespace of the interface
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "NAME", requires = "interface")]
    netns: Option<String>,
    /// Also write the result for each chip to this file, which plan, run and serve read with
    /// --chips
    #[arg(long, value_name = "FILE")]
    chips: Option<PathBuf>,
    /// Also write the result for a chip to this file, as keys of a device profile
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// Position of the device for --profile; needed if clocks differ
    #[arg(long, value_name = "N", requires = "profile")]
    device: Option<usize>,
    /// Law of all drift loops of the virtual segment: hold, block or proportional
    #[arg(long, value_name = "NAME")]
    drift_law: Option<DriftLaw>,
    /// Seed of all randomness in virtual time
    #[arg(long)]
    seed: Option<u64>,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
}

/// Calibrates; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    match arguments.run() {
        Ok(code) => code,
        Err(message) => fail(&message),
    }
}

impl Arguments {
    fn run(&self) -> Result<u8, String> {
        let stop = stop_on_signals()?;
        #[cfg(target_os = "linux")]
        if let Some(interface) = &self.interface {
            let socket = isocat_host::RawSocket::open(interface, self.netns.as_deref())
                .map_err(|error| error.to_string())?;
            let mut wire = isocat_conform::wire::RawWire::new(socket);
            return self.calibrate(interface, &mut wire, &stop);
        }
        let file = super::segment_or_built_in(self.segment.as_deref())
            .map_err(|error| error.to_string())?;
        let mut scenario = Scenario::from(file);
        scenario.seed = self.seed.unwrap_or(scenario.seed);
        scenario.drift_law = self.drift_law.or(scenario.drift_law);
        super::note_ring(&scenario, "calibrate");
        let place = scenario.source.clone();
        self.calibrate(&place, &mut VirtualWire::new(scenario), &stop)
    }

    fn calibrate(&self, place: &str, wire: &mut dyn Wire, stop: &AtomicBool) -> Result<u8, String> {
        let bar = progress_bar(isocat_wire::Nanos::ZERO);
        let told = &mut |step: Step| bar.set_message(message(step));
        let found = calibrate::calibrate(wire, stop, told);
        bar.finish_and_clear();
        let found = found.map_err(|trouble| format!("{place}: {trouble}"))?;
        let report = CalibrationReport::new(place, &found);
        let code = print(&match self.json {
            true => super::run::json(&report),
            false => report.text(),
        });
        if let Some(path) = &self.chips {
            std::fs::write(path, report.chips())
                .map_err(|error| format!("--chips {} can't be written: {error}", path.display()))?;
        }
        if let Some(path) = &self.profile {
            let name = path.display();
            let text = report.profile(self.device);
            let text = text.map_err(|why| format!("--profile {name} was not written: {why}"))?;
            super::output::write(path, text)
                .map_err(|error| super::run::unwritable("profile", Some(path), &error))?;
        }
        Ok(match report.complete {
            _ if code == BAD_INPUT => BAD_INPUT,
            true => IN_SYNC,
            false => NOT_IN_SYNC,
        })
    }
}

fn message(step: Step) -> String {
    match step {
        Step::Look => "looking at the segment".to_owned(),
        Step::Response => "EEPROM and state changes".to_owned(),
        Step::Hops => "hops".to_owned(),
        Step::Crystals => "crystals, 10 s".to_owned(),
        Step::Polarity => "sign of 0x092C".to_owned(),
        Step::Course(number, count) => format!("drift frames, course {} of {count}", number + 1),
        Step::Drift => "crystals again, 5 s".to_owned(),
        Step::Judge => "comparing laws".to_owned(),
    }
}

/// Sets up an early end on Ctrl-C, after which everything is restored.
pub(super) fn stop_on_signals() -> Result<Arc<AtomicBool>, String> {
    #[cfg(target_os = "linux")]
    return super::interface::stop_on_signals()
        .map_err(|error| format!("signals can't be caught: {error}"));
    #[cfg(not(target_os = "linux"))]
    Ok(Arc::new(AtomicBool::new(false)))
}
