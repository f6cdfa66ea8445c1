//! `isocat run network.xml --interface`: the output of a configuration tool, on a real wire.

use isocat_engine::live::job::End;
use isocat_engine::plan::Plan;
use isocat_engine::report::interface::{Asked, InterfaceReport};
use isocat_maindevice::QualityWatch;
use isocat_player::Report;
use isocat_player::differences::differences;
use isocat_player::real::Job;
use isocat_player::virtual_segment::Origin;
use isocat_sim::run::Progress;
use isocat_wire::Nanos;

use super::interface::{begin_recording, end_recording, exit_code, stop_on_signals};
use super::run::{Arguments, json, progress_bar, write_report};
use super::{BAD_INPUT, IN_SYNC, fail, print};

/// Plays the ENI on the interface; returns the exit code.
pub fn run(arguments: &Arguments, interface: &str, path: &str) -> u8 {
    let options = &arguments.wire;
    if let Err(message) = options.check(false) {
        return fail(&message);
    }
    let (eni, segment) = match super::eni_run::segment(path, &arguments.eni) {
        Ok(read) => read,
        Err(message) => return fail(&message),
    };
    let scenario = &segment.scenario;
    let list = &eni.start_up;
    let (cycle, jitter) = (Nanos(list.cycle_ns), scenario.host.jitter);
    let duration = arguments.duration.unwrap_or(scenario.duration);
    let asked = Asked {
        interface,
        namespace: options.netns.as_deref(),
        segment_file: Some(path),
        cycle,
        duration,
        jitter,
    };
    if duration < cycle {
        return fail(&format!("--for {duration} is shorter than one cycle of {cycle}"));
    }
    let plan = Plan::of(scenario).map_err(|error| super::plan::place(scenario, &error));
    let socket = match options.open(interface) {
        Ok(socket) => socket,
        Err(error) => return fail(&error.to_string()),
    };
    let stop = match stop_on_signals() {
        Ok(stop) => stop,
        Err(error) => return fail(&format!("signals can't be caught: {error}")),
    };
    let names = list.devices.iter().map(|device| device.name.clone()).collect();
    let (recorder, written) = match begin_recording(arguments, interface, names) {
        Ok(begun) => begun,
        Err(message) => return fail(&message),
    };
    let job = Job {
        list,
        plan: plan.as_ref().ok(),
        assumed: segment.origins.iter().map(|origin| *origin == Origin::Eni).collect(),
        socket,
        namespace: options.netns.clone(),
        duration,
        difference_limit: scenario.sync0_limit,
        jitter,
        quality: scenario.operation.quality.unwrap_or_else(QualityWatch::default),
        wish: options.wish(),
        recorder,
    };
    let bar = progress_bar(duration);
    bar.set_message("way up");
    let played = job.run(&stop, &mut |progress| {
        if let Progress::Judged(time) = progress {
            bar.set_message("in operation");
            bar.set_position(time.0 as u64);
        }
    });
    bar.finish_and_clear();
    let mut played = match played {
        Ok(played) => played,
        Err(error) => return fail(&error.to_string()),
    };
    if let Err(message) = end_recording(arguments, &mut played.outcome, written) {
        return fail(&message);
    }
    let compared = match &plan {
        Ok(plan) => Ok(differences(list, &plan.start_up(scenario), plan)),
        Err(message) => Err(message.clone()),
    };
    let refused = matches!(played.outcome.end, End::List { refused: true, .. });
    let report = InterfaceReport::new(asked, &played.outcome);
    let answer = report.answer;
    let report = Report::planned(&eni, &segment, compared).with_wire(&played, report);
    let text = report.text();
    if let Err(message) = write_report(arguments.report.as_deref(), &report, &text, None) {
        return fail(&message);
    }
    if let (true, false, Some(failure)) = (refused, arguments.json, &played.failure) {
        return fail(&format!("{path}: {failure}"));
    }
    match print(&if arguments.json { json(&report) } else { text }) {
        IN_SYNC if refused => BAD_INPUT,
        IN_SYNC => exit_code(answer),
        unwritten => unwritten,
    }
}
