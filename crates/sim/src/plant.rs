//! The machine behind a drive: two masses on a shaft, moved by the outputs of a SubDevice in true
//! time.
//!
//! The motor's inertia is joined to the load's by a stiffness and a damping, and the load may have
//! viscous friction:
//!
//! ```text
//! Jm θm'' = T - k (θm - θl) - d (θm' - θl')
//! Jl θl'' =     k (θm - θl) + d (θm' - θl') - f θl'
//! ```
//!
//! The torque T changes at the instants at which outputs act and is constant in between, like the
//! current of a drive with one command in each cycle. Between two instants the motion is the Taylor
//! series of the exact solution, truncated where the remainder is below the rounding of an f64.
//! Only additions, multiplications, divisions and roots are used, so that a run gives the same bits
//! on every platform.
//!
//! A [`Plant`] is the machine at its SubDevice: outputs act on it, and the encoder reads it at the
//! instant of Input Latch. It keeps its actions for the judge
//! ([`judge::plant`](crate::judge::plant)), which compares it with a plant that gets its commands
//! on the grid.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use isocat_maindevice::written::Bits;
use isocat_wire::time::{Picos, Time, True};

/// A plant of a run: its place and its properties.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct PlantSetup {
    /// Position of the SubDevice.
    pub device: usize,
    /// The bits of the command in its outputs.
    pub command: Bits,
    /// The bits of the motor's position in its inputs, in increments; `None`: not shown.
    pub actual: Option<Bits>,
    /// The masses.
    pub masses: TwoMass,
    /// The meaning of the command.
    pub control: Control,
    /// Increments of the encoder in a turn of the motor.
    pub increments: f64,
    /// Travel of the load in a turn of the motor, um.
    pub travel_um: f64,
}

/// Two masses; all values above zero, except damping and friction, which may be zero.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct TwoMass {
    /// Inertia of the motor, kg m².
    pub motor: f64,
    /// Inertia of the load, kg m².
    pub load: f64,
    /// Stiffness between both, Nm/rad.
    pub stiffness: f64,
    /// Damping between both, Nm s/rad.
    pub damping: f64,
    /// Viscous friction of the load, Nm s/rad.
    pub friction: f64,
}

/// The meaning of a command.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Control {
    /// The command is the torque.
    Torque {
        /// Torque of an increment of the command, Nm.
        per_increment: f64,
    },
    /// The command is the position of the motor, in increments of the encoder. Whenever outputs
    /// act, a proportional position loop gives a speed, and a proportional speed loop the torque;
    /// there is neither an integral part nor feed-forward.
    Position {
        /// Gain of the position loop: speed for a distance, 1/s.
        gain: f64,
        /// Gain of the speed loop: acceleration of the whole machine for a difference of speed,
        /// 1/s.
        speed_gain: f64,
    },
}

/// The angles of both masses, rad, and their speeds, rad/s.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct State {
    /// Motor: angle.
    pub motor: f64,
    /// Motor: speed.
    pub motor_speed: f64,
    /// Load: angle.
    pub load: f64,
    /// Load: speed.
    pub load_speed: f64,
}

impl TwoMass {
    /// Torque in the coupling, Nm.
    pub fn coupling(&self, state: &State) -> f64 {
        let (twist, speed) = (state.motor - state.load, state.motor_speed - state.load_speed);
        self.stiffness * twist + self.damping * speed
    }

    /// The undamped resonance of the two masses, rad/s.
    pub fn resonance(&self) -> f64 {
        (self.stiffness * (1.0 / self.motor + 1.0 / self.load)).sqrt()
    }

    /// The state after `time` with a constant torque.
    pub fn after(&self, state: State, torque: f64, time: Picos) -> State {
        let seconds = time.0 as f64 * 1e-12;
        let rate = self.resonance()
            + self.damping * (1.0 / self.motor + 1.0 / self.load)
            + self.friction / self.load;
        let steps = (seconds * rate * STEPS_PER_RADIAN).ceil().max(1.0);
        let step = seconds / steps;
        (0..steps as u64).fold(state, |state, _| self.series(state, torque, step))
    }

    /// The Taylor series of the motion. Each term is the derivative of the previous one.
    fn series(&self, state: State, torque: f64, step: f64) -> State {
        let mut sum = state;
        let mut term = state;
        // The torque is constant, so it is only in the first derivative.
        let mut drive = torque / self.motor;
        for order in 1..=ORDER {
            let coupling = self.coupling(&term);
            let h = step / f64::from(order);
            term = State {
                motor: term.motor_speed * h,
                motor_speed: (drive - coupling / self.motor) * h,
                load: term.load_speed * h,
                load_speed: (coupling - self.friction * term.load_speed) / self.load * h,
            };
            drive = 0.0;
            sum.motor += term.motor;
            sum.motor_speed += term.motor_speed;
            sum.load += term.load;
            sum.load_speed += term.load_speed;
        }
        sum
    }
}

/// Steps in which the fastest motion turns by half a radian: 0.5^17/17! is below the rounding of an
/// f64.
const STEPS_PER_RADIAN: f64 = 2.0;
const ORDER: u32 = 17;

impl PlantSetup {
    /// The torque that a command gives to a machine in this state, Nm.
    pub fn torque(&self, state: &State, command: i64) -> f64 {
        match self.control {
            Control::Torque { per_increment } => command as f64 * per_increment,
            Control::Position { gain, speed_gain } => {
                let speed = gain * (self.angle(command) - state.motor);
                let inertia = self.masses.motor + self.masses.load;
                inertia * speed_gain * (speed - state.motor_speed)
            }
        }
    }

    /// Converts increments to an angle, rad.
    pub fn angle(&self, increments: i64) -> f64 {
        increments as f64 / self.increments * TAU
    }

    /// Converts an angle of the motor to travel of the load, um.
    pub fn travel(&self, angle: f64) -> f64 {
        angle / TAU * self.travel_um
    }
}

/// A machine in motion under a constant torque.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Motion {
    /// Start of the motion.
    pub at: Time<True>,
    /// The state at that time.
    pub state: State,
    /// The torque since then, Nm.
    pub torque: f64,
}

impl Motion {
    /// The motion at rest at zero, since power-on.
    pub const REST: Self = Self {
        at: Time::ZERO,
        state: State { motor: 0.0, motor_speed: 0.0, load: 0.0, load_speed: 0.0 },
        torque: 0.0,
    };

    /// The same motion from another instant on; an earlier instant changes nothing.
    pub fn until(self, masses: &TwoMass, at: Time<True>) -> Self {
        if at <= self.at {
            return self;
        }
        Self { at, state: masses.after(self.state, self.torque, at - self.at), ..self }
    }

    /// The motion after a command acted.
    pub fn act(self, setup: &PlantSetup, at: Time<True>, command: i64) -> Self {
        let moved = self.until(&setup.masses, at);
        Self { torque: setup.torque(&moved.state, command), ..moved }
    }
}

/// A motion that an action of outputs started.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Acted {
    /// The motion.
    pub motion: Motion,
    /// Send time of the frame that brought the outputs; zero if they became safe.
    pub frame: Time<True>,
}

/// The machine at its SubDevice.
#[derive(Clone, Debug)]
pub struct Plant {
    setup: PlantSetup,
    motion: Motion,
    /// The last command, which has not acted yet.
    command: Option<i64>,
    /// The encoder's reading at the last Input Latch.
    latched: i64,
    /// Actions that were not taken yet.
    acted: VecDeque<Acted>,
    now: Time<True>,
}

impl Plant {
    /// A plant at rest at zero.
    pub fn new(setup: PlantSetup) -> Self {
        let (motion, now) = (Motion::REST, Time::ZERO);
        Self { setup, motion, command: None, latched: 0, acted: VecDeque::new(), now }
    }

    /// Takes the actions since the last call, in order.
    pub fn take_acted(&mut self) -> impl Iterator<Item = Acted> + '_ {
        self.acted.drain(..)
    }

    /// Sets the time of the next action of the SubDevice.
    pub(crate) fn tell_time(&mut self, now: Time<True>) {
        self.now = now;
    }

    /// Takes the command from outputs that were mapped.
    pub(crate) fn map(&mut self, outputs: &[u8]) {
        self.command = self.setup.command.read(outputs);
    }

    /// Lets the last outputs act, new or not.
    pub(crate) fn act(&mut self) {
        let Some(command) = self.command else { return };
        self.motion = self.motion.act(&self.setup, self.now, command);
        self.acted.push_back(Acted { motion: self.motion, frame: Time::ZERO });
    }

    /// Sets the frame of the outputs that acted just now.
    pub(crate) fn brought_by(&mut self, frame: Time<True>) {
        if let Some(last) = self.acted.back_mut().filter(|last| last.motion.at == self.now) {
            last.frame = frame;
        }
    }

    /// Removes the torque.
    pub(crate) fn release(&mut self) {
        self.command = None;
        let motion = self.motion.until(&self.setup.masses, self.now);
        self.motion = Motion { torque: 0.0, ..motion };
        self.acted.push_back(Acted { motion: self.motion, frame: Time::ZERO });
    }

    /// Latches the encoder.
    pub(crate) fn latch(&mut self) {
        let angle = self.motion.until(&self.setup.masses, self.now).state.motor;
        self.latched = (angle / TAU * self.setup.increments).floor() as i64;
    }

    /// Writes the latched position into the inputs; a position out of range wraps, as in a counter.
    pub(crate) fn show(&self, inputs: &mut [u8]) {
        let Some(place) = self.setup.actual else { return };
        let (least, most) = place.range();
        place.write(inputs, (self.latched - least).rem_euclid(most - least + 1) + least);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MASSES: TwoMass =
        TwoMass { motor: 3e-4, load: 7e-4, stiffness: 400.0, damping: 0.0, friction: 0.0 };
    const MS: Picos = Picos(1_000_000_000);

    fn close(found: f64, expected: f64, within: f64) {
        assert!((found - expected).abs() <= within, "{found} is not {expected} within {within}");
    }

    /// A step of torque at rest is compared with the closed form: the common motion is a parabola,
    /// the twist a shifted cosine.
    #[test]
    fn an_undamped_machine_is_its_closed_form() {
        let (torque, whole) = (0.5, MASSES.motor + MASSES.load);
        let omega = (MASSES.stiffness * whole / (MASSES.motor * MASSES.load)).sqrt();
        for time in [Picos(1), Picos(999_999), MS, Picos(7 * MS.0 + 13), Picos(500 * MS.0)] {
            let t = time.0 as f64 * 1e-12;
            let found = MASSES.after(State::default(), torque, time);
            let common = torque * t * t / 2.0 / whole;
            let twist = torque / MASSES.motor / (omega * omega) * (1.0 - (omega * t).cos());
            let (motor, load) =
                (common + MASSES.load / whole * twist, common - MASSES.motor / whole * twist);
            close(found.motor, motor, 1e-12 + motor * 1e-11);
            close(found.load, load, 1e-12 + motor * 1e-11);
            let turns = omega * torque / MASSES.motor / (omega * omega) * (omega * t).sin();
            close(found.motor_speed - found.load_speed, turns, 1e-9);
        }
    }

    /// A machine with damping and friction is compared with the classic Runge-Kutta method of
    /// fourth order with steps of 0.1 us.
    #[test]
    fn a_damped_machine_is_what_small_steps_make_of_it() {
        let masses = TwoMass { damping: 0.03, friction: 0.002, ..MASSES };
        let slope = |s: [f64; 4]| {
            let coupling = masses.stiffness * (s[0] - s[2]) + masses.damping * (s[1] - s[3]);
            let load = (coupling - masses.friction * s[3]) / masses.load;
            [s[1], (0.7 - coupling) / masses.motor, s[3], load]
        };
        let add = |s: [f64; 4], d: [f64; 4], h: f64| std::array::from_fn(|i| s[i] + d[i] * h);
        let (h, mut s) = (1e-7, [0.1, -2.0, 0.09, 5.0]);
        for _ in 0..50_000 {
            let a = slope(s);
            let b = slope(add(s, a, h / 2.0));
            let c = slope(add(s, b, h / 2.0));
            let d = slope(add(s, c, h));
            s = std::array::from_fn(|i| s[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
        }
        let begin = State { motor: 0.1, motor_speed: -2.0, load: 0.09, load_speed: 5.0 };
        let found = masses.after(begin, 0.7, Picos(5 * MS.0));
        let pairs = [found.motor, found.motor_speed, found.load, found.load_speed];
        for (found, expected) in pairs.into_iter().zip(s) {
            close(found, expected, 1e-8);
        }
    }

    /// The motion is the same for every division of an interval.
    #[test]
    fn many_small_steps_are_one_large_one() {
        let masses = TwoMass { damping: 0.03, friction: 0.002, ..MASSES };
        let whole = masses.after(State::default(), 1.0, MS);
        let parts =
            (0..1_000).fold(State::default(), |s, _| masses.after(s, 1.0, Picos(1_000_000)));
        close(parts.motor, whole.motor, 1e-13);
        close(parts.load_speed, whole.load_speed, 1e-11);
    }

    fn setup() -> PlantSetup {
        PlantSetup {
            device: 0,
            command: Bits { at: 0, len: 16, signed: true },
            actual: Some(Bits { at: 8, len: 16, signed: true }),
            masses: MASSES,
            control: Control::Torque { per_increment: 1e-3 },
            increments: 4096.0,
            travel_um: 10_000.0,
        }
    }

    #[test]
    fn a_command_acts_at_its_instant_and_not_when_it_comes() {
        let mut plant = Plant::new(setup());
        plant.tell_time(Time::new(1_000));
        plant.map(&[0xF4, 0x01]);
        assert_eq!(plant.take_acted().count(), 0);
        plant.tell_time(Time::new(5_000));
        plant.act();
        plant.brought_by(Time::new(900));
        let acted: Vec<_> = plant.take_acted().collect();
        let at = Time::new(5_000);
        let motion = Motion { at, torque: 0.5, ..Motion::REST };
        assert_eq!(acted, [Acted { motion, frame: Time::new(900) }]);
        // Released 1 ms later, it continues without torque.
        plant.tell_time(at + MS);
        plant.release();
        let speed = 0.5 * 1e-3 / (MASSES.motor + MASSES.load);
        let State { motor_speed, load_speed, .. } = plant.motion.state;
        let momentum = MASSES.motor * motor_speed + MASSES.load * load_speed;
        close(momentum / (MASSES.motor + MASSES.load), speed, 1e-12);
        assert_eq!(plant.motion.torque, 0.0);
    }

    #[test]
    fn the_encoder_counts_whole_increments_and_wraps() {
        let mut plant = Plant::new(setup());
        let mut seen = |turns: f64| {
            plant.motion.state.motor = turns * TAU;
            plant.latch();
            let mut inputs = [0xEE; 3];
            plant.show(&mut inputs);
            assert_eq!(inputs[0], 0xEE);
            i16::from_le_bytes([inputs[1], inputs[2]])
        };
        assert_eq!(
            [0.0, 0.25, -0.000_1, 7.999_9, 8.0].map(&mut seen),
            [0, 1_024, -1, 32_767, -32_768]
        );
    }
}
