//! What was lost in true time, by the judges of the simulation.

use isocat_sim::bench::DeviceBench;
use isocat_sim::{Tap, World};
use isocat_wire::time::{Time, True};

/// A loss of one SubDevice.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Loss {
    LeftOp,
    MissedEvents,
    Sync0OffGrid,
    NoSync0,
    OutputsLate,
    InputsLate,
    OutputsUneven,
}

/// Everything that was lost since `began`, with the position.
pub fn losses<A: isocat_maindevice::Application, T: Tap>(
    world: &World<A, T>,
    began: Time<True>,
) -> Vec<(usize, Loss)> {
    let devices = world.bench.devices().iter().enumerate();
    devices.flat_map(|(at, bench)| of(bench, began).map(move |loss| (at, loss))).collect()
}

fn of(bench: &DeviceBench, began: Time<True>) -> impl Iterator<Item = Loss> {
    let sync0 = bench.sync0.as_ref();
    let found = [
        (Loss::LeftOp, bench.states.iter().any(|change| change.at > began)),
        (Loss::MissedEvents, bench.missed.first().is_some()),
        (Loss::Sync0OffGrid, sync0.is_some_and(|judge| judge.first_beyond().is_some())),
        (Loss::NoSync0, sync0.is_some_and(|judge| judge.statistics().count() == 0)),
        (Loss::OutputsLate, bench.outputs_cycle.late().first().is_some()),
        (Loss::InputsLate, bench.inputs_cycle.late().first().is_some()),
        (Loss::OutputsUneven, bench.outputs_delay.first_beyond().is_some()),
    ];
    found.into_iter().filter(|(_, lost)| *lost).map(|(loss, _)| loss)
}
