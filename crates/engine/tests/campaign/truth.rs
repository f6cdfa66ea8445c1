//! The events in true time: from the judges of the simulation, and from an observer at the
//! MainDevice's port. None of it comes from the MainDevice.

use isocat_maindevice::Port;
use isocat_sim::bench::DeviceBench;
use isocat_sim::course::Stretch;
use isocat_sim::fault::{Happened, Whose};
use isocat_sim::{Fault, Lost, Tap, World};
use isocat_wire::time::{Nanos, Picos, Time, True};

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

/// The observer of frames.
#[derive(Default)]
pub struct Witness {
    began: Option<Time<True>>,
    last_sent: Option<Time<True>>,
    /// Frames that did not come back.
    pub lost: u64,
    /// The longest time from frame to frame since operation began.
    pub longest_gap: Picos,
}

impl Tap for Witness {
    fn frame(&mut self, at: Time<True>, sent: bool, _bytes: &[u8]) {
        if !sent {
            return;
        }
        if let (Some(last), Some(_)) = (self.last_sent, self.began) {
            self.longest_gap = self.longest_gap.max(at - last);
        }
        self.last_sent = Some(at);
    }

    fn lost(&mut self, _at: Time<True>, _port: Port, _why: Option<Lost>) {
        self.lost += u64::from(self.began.is_some());
    }

    fn judging_begins(&mut self, at: Time<True>, _intent: &isocat_sim::bench::Intent) {
        self.began = Some(at);
    }
}

/// All facts of a run in true time.
pub struct Truth {
    /// Each loss with the position of the SubDevice.
    pub losses: Vec<(usize, Loss)>,
    pub witness: Witness,
    pub happened: Vec<Happened>,
    /// The largest SYNC0 error of each SubDevice.
    pub worst_sync0: Vec<Picos>,
    /// The times when each was not in sync.
    pub stretches: Vec<Stretch>,
    pub ended: Time<True>,
}

impl Truth {
    pub fn of<A: isocat_maindevice::Application>(
        world: World<A, Witness>,
        began: Time<True>,
    ) -> Self {
        let devices = world.bench.devices().iter().enumerate();
        let losses = devices.flat_map(|(at, bench)| of(bench, began).map(move |loss| (at, loss)));
        let course = world.course();
        let errors =
            course.map(|course| (0..course.devices()).map(|d| course.worst_sync0(d)).collect());
        Self {
            losses: losses.collect(),
            worst_sync0: errors.unwrap_or_default(),
            stretches: course.map_or(Vec::new(), |course| course.stretches().to_vec()),
            happened: world.timeline().happened().cloned().collect(),
            ended: world.now(),
            witness: world.into_tap().unwrap_or_default(),
        }
    }

    /// Whether a SubDevice had a loss.
    pub fn lost(&self, device: usize) -> bool {
        self.losses.iter().any(|(lost, _)| *lost == device)
    }

    /// Whether a fault satisfies this condition.
    pub fn any(&self, is: impl Fn(&Fault) -> bool) -> bool {
        self.happened.iter().any(|happened| is(&happened.fault))
    }

    /// Time when the last fault ended, or began if it has no end.
    pub fn last_fault(&self) -> Option<Time<True>> {
        self.happened.iter().map(|happened| happened.at).max()
    }

    /// Whether all losses are of a kind that no wire shows: outputs at the pins, or misses that
    /// SubDevices cause themselves, whose counters go down again between two readings.
    pub fn is_out_of_sight(&self) -> bool {
        self.losses.iter().all(|(device, loss)| {
            *loss == Loss::OutputsUneven || self.misbehaves(*device) && *loss != Loss::LeftOp
        })
    }

    /// Whether a SubDevice was made to misbehave.
    pub fn misbehaves(&self, device: usize) -> bool {
        self.any(|fault| matches!(fault, Fault::Misbehave { device: at, .. } if *at == device))
    }

    /// Whether faults concerned cables or the power of SubDevices.
    pub fn wires_were_touched(&self) -> bool {
        use Fault::*;
        self.any(|fault| {
            let pulled = matches!(fault, Pull { .. } | BreakWay { .. } | Flap { .. });
            pulled || matches!(fault, Recable { .. } | PowerOff { .. } | Replace { .. })
        })
    }

    /// Whether faults concerned the times of frames: the host, its clock, or that of a SubDevice.
    pub fn time_was_touched(&self) -> bool {
        use Fault::*;
        let touches = |fault: &Fault| {
            let clock = matches!(fault, Clock { whose: Whose::Host | Whose::Device(_), .. });
            clock || matches!(fault, ClockJump { .. } | Stall | LateWakeUps(_) | SlowSends(_))
        };
        self.any(touches)
    }
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

/// Half of a limit, ps.
pub fn half(limit: Nanos) -> Picos {
    Picos(limit.0 * 500)
}
