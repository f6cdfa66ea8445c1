//! `isocat scan`.

use clap::Args;
use isocat_conform::wire::{VirtualWire, Wire};
#[cfg(target_os = "linux")]
use isocat_descriptions::StartUp;
use isocat_engine::report::scan::{Place, ScanReport};
use isocat_engine::rescue::Rescue;
use isocat_engine::scan::{Failure, Scan};
use isocat_maindevice::Cause;
#[cfg(target_os = "linux")]
use isocat_player::found::FoundReport;
use isocat_segment::Scenario;

use super::run::{json, progress_bar};
use super::{BAD_INPUT, IN_SYNC, NOT_IN_SYNC, fail, print};

/// Arguments of `scan`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Segment file to scan in virtual time, or an ENI (.xml, .eni); without one, the built-in
    /// segment. With --interface: an ENI to compare with the devices that answer
    segment: Option<String>,
    /// Scan the segment on this network interface instead
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "IF", conflicts_with = "seed")]
    interface: Option<String>,
    /// Network namespace of the interface
    #[cfg(target_os = "linux")]
    #[arg(long, value_name = "NAME", requires = "interface")]
    netns: Option<String>,
    /// Print all details of the SubDevice at this position, and nothing else
    #[arg(long, value_name = "N", conflicts_with = "json")]
    device: Option<usize>,
    /// Read no objects by SDO: process data are those of the SII alone
    #[arg(long)]
    quick: bool,
    /// Seed of all randomness in virtual time
    #[arg(long)]
    seed: Option<u64>,
    /// No frame comes back: close port after port until frames do, and say which line is dead. The
    /// port before it stays closed; nothing else is written
    #[arg(long, conflicts_with_all = ["json", "device", "quick", "esi"])]
    rescue: bool,
    /// Print as one JSON document
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    eni: super::eni_run::Options,
}

/// Scans; returns the exit code.
pub fn run(arguments: &Arguments) -> u8 {
    #[cfg(target_os = "linux")]
    if let Some(interface) = &arguments.interface {
        return on_interface(arguments, interface);
    }
    let path = arguments.segment.as_deref();
    let scenario = match path.filter(|path| super::eni_run::is_eni(path)) {
        Some(eni) => super::eni_run::segment(eni, &arguments.eni).map(|(_, made)| made.scenario),
        None => match arguments.eni.refused_without_eni() {
            Some(message) => Err(message),
            None => super::segment_or_built_in(path)
                .map(Scenario::from)
                .map_err(|error| error.to_string()),
        },
    };
    let mut scenario = match scenario {
        Ok(scenario) => scenario,
        Err(message) => return fail(&message),
    };
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    if arguments.rescue {
        let place = scenario.source.clone();
        return rescue(&place, &mut VirtualWire::with_faults(scenario));
    }
    super::note_ring(&scenario, "scan");
    let bar = progress_bar(scenario.duration);
    let scan = Scan::of(&scenario, !arguments.quick, &mut |stage| bar.set_message(stage.name()));
    bar.finish_and_clear();
    finish(arguments, Place::Virtual(&scenario.source), &scan)
}

#[cfg(target_os = "linux")]
fn on_interface(arguments: &Arguments, interface: &str) -> u8 {
    let namespace = arguments.netns.as_deref();
    let eni = match arguments.segment.as_deref() {
        None => None,
        Some(path) if super::eni_run::is_eni(path) => match super::eni_run::read(path) {
            Ok(eni) => Some((path, eni)),
            Err(message) => return fail(&message),
        },
        Some(path) => {
            return fail(&format!(
                "{path} is beside --interface; expected an ENI (.xml, .eni) to compare with what answers"
            ));
        }
    };
    let socket = match isocat_host::RawSocket::open(interface, namespace) {
        Ok(socket) => socket,
        Err(error) => return fail(&error.to_string()),
    };
    if arguments.rescue {
        return rescue(interface, &mut isocat_conform::wire::RawWire::new(socket));
    }
    let stop = match super::interface::stop_on_signals() {
        Ok(stop) => stop,
        Err(error) => return fail(&format!("signals can't be caught: {error}")),
    };
    let mut config = isocat_engine::scan::config(!arguments.quick);
    config.timeouts.frame = isocat_host::FRAME_TIMEOUT;
    let bar = progress_bar(isocat_wire::Nanos::ZERO);
    let told = &mut |stage: isocat_maindevice::Stage| bar.set_message(stage.name());
    let scan = isocat_engine::live::scan::scan(config, socket, &stop, told);
    bar.finish_and_clear();
    let place = Place::Interface(interface, namespace);
    match eni {
        None => finish(arguments, place, &scan),
        Some((path, eni)) => compare(arguments, place, &scan, path, &eni.start_up),
    }
}

/// Looks for the line that makes a segment silent.
fn rescue(place: &str, wire: &mut dyn Wire) -> u8 {
    let stop = match super::calibrate::stop_on_signals() {
        Ok(stop) => stop,
        Err(message) => return fail(&message),
    };
    let bar = progress_bar(isocat_wire::Nanos::ZERO);
    bar.set_message("ports");
    let found = isocat_engine::rescue::rescue(wire, &stop);
    bar.finish_and_clear();
    match found {
        Err(trouble) => fail(&format!("{place}: {trouble}")),
        Ok(found) => match print(&found.text()) {
            BAD_INPUT => BAD_INPUT,
            _ if matches!(found, Rescue::Alive(_)) => IN_SYNC,
            _ => NOT_IN_SYNC,
        },
    }
}

/// Compares the devices that answer with an ENI.
#[cfg(target_os = "linux")]
fn compare(arguments: &Arguments, place: Place<'_>, scan: &Scan, path: &str, list: &StartUp) -> u8 {
    if let Some(message) = no_answer(place, scan) {
        return fail(&message);
    }
    let report = FoundReport::new(path, list, &scan.segment, ScanReport::new(place, scan));
    if let Some(message) = no_such_device(arguments, &report.scan) {
        return fail(&message);
    }
    let code = print(&match arguments.json {
        true => json(&report),
        false => format!("{}\n{}", report.text(), report.scan.text(arguments.device)),
    });
    match report.same && report.scan.consistent {
        _ if code == BAD_INPUT => BAD_INPUT,
        true => IN_SYNC,
        false => NOT_IN_SYNC,
    }
}

fn finish(arguments: &Arguments, place: Place<'_>, scan: &Scan) -> u8 {
    if let Some(message) = no_answer(place, scan) {
        return fail(&message);
    }
    let report = ScanReport::new(place, scan);
    if let Some(message) = no_such_device(arguments, &report) {
        return fail(&message);
    }
    let code = print(&match arguments.json {
        true => json(&report),
        false => report.text(arguments.device),
    });
    match report.consistent {
        _ if code == BAD_INPUT => BAD_INPUT,
        true => IN_SYNC,
        false => NOT_IN_SYNC,
    }
}

/// The message if details of a missing SubDevice are requested.
fn no_such_device(arguments: &Arguments, report: &ScanReport) -> Option<String> {
    let wanted = arguments.device.filter(|wanted| *wanted >= report.devices.len())?;
    let last = report.devices.len().saturating_sub(1);
    Some(format!("--device {wanted}: there is no such SubDevice, expected 0 to {last}"))
}

/// The message if no device answered, so that there is nothing to report.
fn no_answer(place: Place<'_>, scan: &Scan) -> Option<String> {
    if !scan.segment.devices.is_empty() {
        return None;
    }
    let place = match place {
        Place::Virtual(file) => file,
        Place::Interface(name, _) => name,
    };
    match scan.failure.as_ref()? {
        Failure::Gave(error) => match &error.cause {
            Cause::Silent { foreign: None, .. } => {
                let silent = &error.cause;
                Some(format!(
                    "{place}: {silent}; --rescue looks for a line that gives nothing back"
                ))
            }
            Cause::Silent { .. } | Cause::Empty | Cause::Access(_) => {
                Some(format!("{place}: {}", error.cause))
            }
            _ => Some(format!("{place}: {error}")),
        },
        Failure::TooLong(stage) => {
            Some(format!("{place}: the scan did not end, its last stage was {stage}"))
        }
        Failure::Ended(why) => Some(format!("{place}: {why}")),
    }
}
