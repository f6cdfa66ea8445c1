//! Applies faults to a segment and its host, and ends them.

use isocat_wire::register;
use isocat_wire::time::{Nanos, Picos, Time, True};

use super::frames::FrameFaults;
use super::timeline::{Action, Active, Happened, Timeline, Undo};
use super::{Fault, FrameFault, Whose};
use crate::disturbance::Disturbances;
use crate::host::HostMachine;
use crate::random::Stream;
use crate::segment::Segment;
use crate::watcher::Watcher;

/// The objects that faults change.
pub(crate) struct Scene<'a> {
    pub segment: &'a mut Segment,
    /// The host, if it is simulated too.
    pub host: Option<&'a mut HostMachine>,
    /// The faults of frames at the MainDevice's port.
    pub port: &'a mut FrameFaults,
}

/// Changes of cables and power are announced this much before their time: longer than a frame is in
/// flight.
const AHEAD: Picos = Picos(2_000_000_000);

impl Timeline {
    /// Applies all faults that are due at `now`.
    pub(crate) fn happen(&mut self, now: Time<True>, scene: &mut Scene<'_>, watch: &mut Watcher) {
        while let Some((at, action)) = self.take(now, now + AHEAD) {
            match action {
                Action::Begin { fault, lasts } => self.begin(at, fault, lasts, scene, watch),
                Action::End(id) => self.end(at, id, scene, watch),
                Action::Again(id) => self.go_on(at, id, scene),
                Action::Swap { device, spare } => self.swap(at, device, spare, scene, watch),
                Action::Lay { cable, millimetres } => scene.segment.relay(cable, millimetres),
            }
        }
    }

    /// Whether a fault is due by `now`; faults on cables are due earlier, to be announced.
    pub(crate) fn is_due(&self, now: Time<True>) -> bool {
        self.next().is_some_and(|at| at <= now + AHEAD)
    }

    fn begin(
        &mut self,
        at: Time<True>,
        fault: Fault,
        lasts: Option<Nanos>,
        scene: &mut Scene<'_>,
        watch: &mut Watcher,
    ) {
        let id = self.next_id();
        let mut undo = Undo::Plain;
        let wired = scene.wired(at);
        let segment = &mut *scene.segment;
        match fault {
            Fault::Frames(frames) => {
                let seed = self.seed;
                let cable = frames.cable.map(|cable| segment.cable_number(cable));
                scene.frames(&frames).begin(id, FrameFault { cable, ..frames }, seed);
            }
            Fault::Pull { cable } => segment.unplug(segment.cable_number(cable), wired),
            Fault::Plug { cable } => {
                self.mend(cable, wired, segment);
                self.note(Happened { at, fault, begins: true, lasts });
                return;
            }
            Fault::BreakWay { cable, way } => {
                segment.break_way(segment.cable_number(cable), way, wired);
            }
            Fault::Flap { cable, off, .. } => {
                segment.unplug(segment.cable_number(cable), wired);
                undo = Undo::Pulled(true);
                self.push(at + Picos::from(off), Action::Again(id));
            }
            Fault::Recable { cable, millimetres, takes } => {
                let takes = Picos::from(takes);
                let number = segment.cable_number(cable);
                if takes >= segment.wiring().cable(number).0.link_loss {
                    segment.unplug(number, wired);
                    let back = Action::Begin { fault: Fault::Plug { cable }, lasts: None };
                    self.push(at + takes, back);
                }
                self.push(at + Picos(takes.0 / 2), Action::Lay { cable: number, millimetres });
            }
            Fault::PowerOff { device } => segment.power_off(device, wired),
            Fault::PowerOn { device } => {
                segment.power_on(device, wired);
                let off = Fault::PowerOff { device };
                self.active.retain(|active| active.fault != off);
            }
            Fault::Replace { device, spare, takes } => {
                segment.power_off(device, wired);
                self.push(at + Picos(takes.0 * 500), Action::Swap { device, spare });
                let back = Action::Begin { fault: Fault::PowerOn { device }, lasts: None };
                self.push(at + Picos::from(takes), back);
            }
            Fault::DeadEeprom { device } => segment.device_mut(device).set_eeprom_dead(true),
            Fault::Clock { whose, change } => {
                let from = segment.behind_frames(at);
                let bends = change.bends(from, &mut Stream::new(self.seed, "clock fault", id));
                scene.bend(whose, &bends);
                undo = Undo::Bends(bends);
            }
            Fault::ClockJump { by } => {
                if let Some(host) = &mut scene.host {
                    host.jump(at, by);
                }
            }
            Fault::Stall => {
                let until = lasts.map_or(Time::NEVER, |lasts| at + Picos::from(lasts));
                if let Some(host) = &mut scene.host {
                    host.stall(at, until);
                }
            }
            Fault::LateWakeUps(late) => {
                if let Some(host) = &mut scene.host {
                    host.set_late_wake_ups(Some(late));
                }
            }
            Fault::SlowSends(late) => {
                if let Some(host) = &mut scene.host {
                    host.set_slow_sends(Some(late));
                }
            }
            Fault::Misbehave { device, how } => segment.misbehave(device, at, how, true),
            Fault::SyncOff { device } => {
                let activation = segment.devices()[device].esc.register(register::SYNC_ACTIVATION);
                // Where nothing runs, nothing happens.
                if activation.0 == 0 {
                    return;
                }
                undo = Undo::Activation(activation.0);
                segment.write_register(device, at, register::SYNC_ACTIVATION.address, &[0], watch);
            }
            Fault::AlError { device, code } => segment.fail_device(device, at, code, watch),
            Fault::SecondMaster { sends, every } => {
                self.foreign.push(sends);
                self.push(at + Picos::from(every), Action::Again(id));
            }
            Fault::Heal => {
                self.note(Happened { at, fault, begins: true, lasts });
                while let Some(active) = self.active.first() {
                    let id = active.id;
                    self.end(at, id, scene, watch);
                }
                // Faults with a fixed number of frames are not in `active`.
                scene.port.heal();
                scene.segment.disturbances.frames.heal();
                return;
            }
        }
        self.note(Happened { at, fault: fault.clone(), begins: true, lasts });
        if !fault.can_end() {
            return;
        }
        self.active.push(Active { id, fault, undo });
        if let Some(lasts) = lasts {
            self.push(at + Picos::from(lasts), Action::End(id));
        }
    }

    fn end(&mut self, at: Time<True>, id: u64, scene: &mut Scene<'_>, watch: &mut Watcher) {
        let Some(number) = self.active.iter().position(|active| active.id == id) else { return };
        let Active { fault, undo, .. } = self.active.remove(number);
        let wired = scene.wired(at);
        let segment = &mut *scene.segment;
        match (&fault, undo) {
            (Fault::Frames(frames), _) => scene.frames(frames).end(id),
            (Fault::Pull { cable }, _) | (Fault::Flap { cable, .. }, Undo::Pulled(true)) => {
                segment.plug(segment.cable_number(*cable), wired);
            }
            (Fault::BreakWay { cable, way }, _) => {
                segment.mend_way(segment.cable_number(*cable), *way, wired);
            }
            (Fault::PowerOff { device }, _) => segment.power_on(*device, wired),
            (Fault::DeadEeprom { device }, _) => {
                segment.device_mut(*device).set_eeprom_dead(false);
            }
            (Fault::Clock { whose, .. }, Undo::Bends(bends)) => {
                let from = segment.behind_frames(at).count();
                let (past, coming): (Vec<_>, Vec<_>) =
                    bends.into_iter().partition(|(at, _)| *at <= from);
                let gained: i64 = past.iter().map(|(_, by)| by).sum();
                let back: Vec<_> = coming.iter().map(|(at, by)| (*at, -by)).collect();
                scene.bend(*whose, &[(from, -gained)]);
                scene.bend(*whose, &back);
            }
            (Fault::Stall, _) => {
                if let Some(host) = &mut scene.host {
                    host.stall(at, at);
                }
            }
            (Fault::LateWakeUps(_), _) => {
                if let Some(host) = &mut scene.host {
                    host.set_late_wake_ups(None);
                }
            }
            (Fault::SlowSends(_), _) => {
                if let Some(host) = &mut scene.host {
                    host.set_slow_sends(None);
                }
            }
            (Fault::Misbehave { device, how }, _) => {
                segment.misbehave(*device, at, *how, false);
            }
            (Fault::SyncOff { device }, Undo::Activation(before)) => {
                let address = register::SYNC_ACTIVATION.address;
                segment.write_register(*device, at, address, &[before], watch);
            }
            _ => {}
        }
        self.note(Happened { at, fault, begins: false, lasts: None });
    }

    /// Continues a fault: a flapping cable changes, or another MainDevice sends.
    fn go_on(&mut self, at: Time<True>, id: u64, scene: &mut Scene<'_>) {
        let wired = scene.wired(at);
        let Some(active) = self.active.iter_mut().find(|active| active.id == id) else { return };
        let next = match (&active.fault, &mut active.undo) {
            (Fault::Flap { cable, off, on }, Undo::Pulled(pulled)) => {
                let cable = scene.segment.cable_number(*cable);
                match *pulled {
                    true => scene.segment.plug(cable, wired),
                    false => scene.segment.unplug(cable, wired),
                }
                *pulled = !*pulled;
                if *pulled { *off } else { *on }
            }
            (Fault::SecondMaster { sends, every }, _) => {
                self.foreign.push(*sends);
                *every
            }
            _ => return,
        };
        self.push(at + Picos::from(next), Action::Again(id));
    }

    fn swap(
        &mut self,
        at: Time<True>,
        device: usize,
        spare: usize,
        scene: &mut Scene<'_>,
        watch: &mut Watcher,
    ) {
        let Some(setup) = self.spares.get_mut(spare).and_then(Option::take) else { return };
        // The notice of the power loss is due by now.
        scene.segment.live(at, watch);
        // If another fault gave it power in between, it is not replaced.
        if scene.segment.devices()[device].is_powered() {
            return;
        }
        let seed = self.seed ^ (spare as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        scene.segment.replace_device(device, setup, seed);
    }

    /// Repairs all faults of a cable.
    fn mend(&mut self, cable: usize, at: Time<True>, segment: &mut Segment) {
        let number = segment.cable_number(cable);
        segment.plug(number, at);
        for way in [crate::Direction::Out, crate::Direction::Back] {
            segment.mend_way(number, way, at);
        }
        self.active.retain(|active| match active.fault {
            Fault::Pull { cable: other }
            | Fault::BreakWay { cable: other, .. }
            | Fault::Flap { cable: other, .. } => other != cable,
            _ => true,
        });
    }
}

impl Scene<'_> {
    /// The earliest instant, from `at` on, for a change of cables and power: not before the last
    /// announced change.
    fn wired(&self, at: Time<True>) -> Time<True> {
        let disturbances: &Disturbances = &self.segment.disturbances;
        at.max(disturbances.latest_change())
    }

    fn frames(&mut self, fault: &FrameFault) -> &mut FrameFaults {
        match fault.cable {
            None => self.port,
            Some(_) => &mut self.segment.disturbances.frames,
        }
    }

    fn bend(&mut self, whose: Whose, bends: &[crate::oscillator::Bend]) {
        match (whose, &mut self.host) {
            (Whose::Device(device), _) => self.segment.bend_clock(device, bends),
            (Whose::Host, Some(host)) => host.bend_clock(bends),
            (Whose::Host, None) => {}
        }
    }
}
