//! Lines of many SubDevices come into operation with the settings that nobody touched.

#[path = "../benches/line/mod.rs"]
mod line;

use isocat_wire::time::Nanos;

/// Reading the difference of every clock takes longer here than from one reading to the next in a short line.
#[test]
fn a_thousand_come_into_operation() {
    let world = line::world(1_000).expect("they come into operation");
    let statistics = world.main().statistics();
    let converged = statistics.time_to_converged.expect("there are clocks");
    let operation = statistics.time_to_operation.expect("it is in operation");
    println!("converged after {converged}, in operation after {operation}: {statistics:?}");
    assert!(converged < Nanos::millis(3_000), "{converged}");
    assert_eq!(statistics.frames_lost, 0);
}
