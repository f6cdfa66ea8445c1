//! Typed values as their names, in both directions: a status is written by one program and read by
//! another.

use isocat_sync::phase;

/// A moment of the cycle.
pub mod moment {
    use isocat_sync::Moment;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(moment: &Moment, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_str(moment.name())
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Moment, D::Error> {
        let name = String::deserialize(from)?;
        Moment::of_name(&name).ok_or_else(|| super::unknown("a moment of the cycle", &name))
    }
}

/// The stage of the segment.
pub mod stage {
    use serde::{Deserialize, Deserializer, Serializer};

    use crate::status::Stage;

    pub fn serialize<S: Serializer>(stage: &Stage, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_str(stage.name())
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Stage, D::Error> {
        let name = String::deserialize(from)?;
        Stage::of_name(&name).ok_or_else(|| super::unknown("a stage", &name))
    }
}

/// AL state; an invalid one is unknown.
pub mod al_state {
    use isocat_wire::AlState;
    use serde::{Deserialize, Deserializer, Serializer};

    use crate::status::UNKNOWN;

    pub fn serialize<S: Serializer>(state: &Option<AlState>, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_str(state.map_or(UNKNOWN, AlState::name))
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Option<AlState>, D::Error> {
        let name = String::deserialize(from)?;
        if name == UNKNOWN {
            return Ok(None);
        }
        let all = [AlState::Init, AlState::PreOp, AlState::Boot, AlState::SafeOp, AlState::Op];
        let state = all.into_iter().find(|state| state.name() == name);
        state.map(Some).ok_or_else(|| super::unknown("an AL state", &name))
    }
}

/// State of the servo; empty without clocks.
pub mod servo {
    use isocat_sync::phase::State;
    use serde::{Deserialize, Deserializer, Serializer};

    use super::{SERVO, servo_name};

    pub fn serialize<S: Serializer>(state: &Option<State>, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_str(state.map_or("", servo_name))
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Option<State>, D::Error> {
        let name = String::deserialize(from)?;
        if name.is_empty() {
            return Ok(None);
        }
        let state = SERVO.into_iter().find(|state| servo_name(*state) == name);
        state.map(Some).ok_or_else(|| super::unknown("a state of the servo", &name))
    }
}

/// States of the servo.
pub const SERVO: [phase::State; 4] =
    [phase::State::Free, phase::State::Acquiring, phase::State::Locked, phase::State::Holdover];

/// The name of a state of the servo.
pub const fn servo_name(state: phase::State) -> &'static str {
    match state {
        phase::State::Free => "free",
        phase::State::Acquiring => "acquiring",
        phase::State::Locked => "locked",
        phase::State::Holdover => "holdover",
    }
}

fn unknown<E: serde::de::Error>(what: &str, name: &str) -> E {
    E::custom(format!("expected {what}, found \"{name}\""))
}

#[cfg(test)]
mod tests {
    use crate::status::{Device, Kind, Stage, Status};

    #[test]
    fn names_are_read_as_they_are_written() {
        let mut status = Status::new("test".into(), Kind::Wire, 0, 0);
        status.devices.push(Device::new(0, "one".into()));
        let stages = [Stage::Begin, Stage::Up(isocat_maindevice::Stage::SafeOp), Stage::Ended];
        let states = [None, Some(isocat_wire::AlState::Boot), Some(isocat_wire::AlState::Op)];
        let servo = [None, Some(super::SERVO[0]), Some(super::SERVO[3])];
        for ((stage, state), servo) in stages.into_iter().zip(states).zip(servo) {
            (status.stage, status.devices[0].al_state, status.host.servo) = (stage, state, servo);
            let text = serde_json::to_string(&status).expect("JSON");
            let read: Status = serde_json::from_str(&text).expect("it is a status");
            assert_eq!(read, status);
            let other = text.replace(stage.name(), "elsewhere");
            assert!(serde_json::from_str::<Status>(&other).is_err(), "{other}");
        }
    }
}
