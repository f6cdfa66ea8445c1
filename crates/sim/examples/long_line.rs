//! Time of a line of N SubDevices from cold start to OP, with default settings: `long_line N...`.
//!
//! All figures repeat exactly. Exit code 1 if a line does not come up.

use std::process::ExitCode;

use isocat_maindevice::Config;

#[path = "../benches/line/mod.rs"]
mod line;

fn main() -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for count in std::env::args().skip(1).filter_map(|text| text.parse().ok()) {
        // The settings that the line relaxes for ten thousand SubDevices are reset to their
        // defaults.
        let untouched = |config: &mut Config| {
            let Config { timeouts, drift_threshold, .. } = Config::new(config.cycle);
            (config.timeouts, config.drift_threshold) = (timeouts, drift_threshold);
        };
        match line::world_of(line::connections(count), untouched) {
            Ok(world) => {
                let statistics = world.main().statistics();
                let ms = |time: Option<isocat_wire::Nanos>| time.map_or(0, |t| t.0 / 1_000_000);
                println!(
                    "{count} SubDevices: clocks converged after {} ms, all in OP after {} ms of virtual time; {} frames, \
                     {} for the clocks, {} lost",
                    ms(statistics.time_to_converged),
                    ms(statistics.time_to_operation),
                    statistics.bring_up_frames,
                    statistics.drift_burst,
                    statistics.frames_lost
                );
            }
            Err(error) => {
                println!("{count} SubDevices: {error}");
                code = ExitCode::FAILURE;
            }
        }
    }
    code
}
