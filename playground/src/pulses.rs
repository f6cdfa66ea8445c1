//! The SYNC unit of a single ESC: a MainDevice writes registers 0x0980 to 0x09A7, and the two
//! signals are recorded.
//!
//! The drawing only shows what the ESC does: frames write registers, time passes, the local CPU
//! acknowledges or not, and the level of both signals is read at each event.

use isocat::picture::{Picture, waves};
use isocat::quantity::time;
use isocat_esc::{Esc, EscEvent, LAN9252, PdiExt};
use isocat_sim::storage::Storage;
use isocat_wire::datagram::Address;
use isocat_wire::frame::{FrameWriter, MAX_LEN, duration_ns};
use isocat_wire::register::{self, Value};
use isocat_wire::time::{Device, Nanos, Time};
use isocat_wire::{AutoIncrementAddress, Command, PortNumber, Register, sii};
use serde::Serialize;

use crate::state::State;

/// What the SYNC unit did.
#[derive(Clone, Debug, Default)]
pub struct Generated {
    /// When each signal changed, device time in ns: SYNC0, SYNC1.
    pub changes: [Vec<u64>; 2],
    /// Edges that the ESC reported: SYNC0, SYNC1.
    pub edges: [Vec<u64>; 2],
    /// When the activation took effect.
    pub activated: u64,
    /// The start time, 0x0990.
    pub start: u64,
    /// When the local CPU read 0x098E and 0x098F.
    pub acknowledged: [Vec<u64>; 2],
    /// The end of the recording.
    pub end: u64,
    /// Whether SYNC1 is generated.
    pub sync1: bool,
    /// The mode of the signals, in words.
    pub kind: &'static str,
    /// SYNC0 cycle, ns; 0: single shot.
    pub cycle: u64,
    /// Pulse length, ns; 0: until it is acknowledged.
    pub pulse: u64,
    /// Time from SYNC0 to SYNC1, ns.
    pub distance: u64,
    /// Values of the registers at the end.
    pub registers: Vec<RegisterRow>,
}

/// A register and its value.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct RegisterRow {
    /// Its address, for example `0x0981`.
    pub address: String,
    /// Its name.
    pub name: &'static str,
    /// Its value at the end, as a number with its unit.
    pub value: String,
}

/// Time from the write of the activation to the start time, ns; it only belongs to this page, not
/// to a segment.
const LEAD: u64 = 500_000;
/// Number of cycles that are shown.
const CYCLES: u64 = 5;

/// Runs the SYNC unit with the settings of the state.
pub fn generate(state: &State) -> Generated {
    let time = |key| state.time(key).map_or(0, |time| time.0 as u64);
    let bus = time("cycle");
    let cycle = state.time("sync0-cycle").map_or(bus, |cycle| cycle.0 as u64);
    let pulse = time("pulse") / 10 * 10;
    let distance = state.time("sync1").map(|distance| distance.0 as u64);
    let acknowledge = state.time("acknowledge").map(|after| after.0 as u64);
    let mut bench = Bench::new((pulse / 10) as u16);
    bench.write(register::SYNC0_CYCLE, cycle as u32);
    bench.write(register::SYNC1_CYCLE, distance.unwrap_or(0) as u32);
    // The start time is round, so that the axis is easy to read.
    let start = (bench.now + LEAD).next_multiple_of(100_000);
    bench.write(register::SYNC_START_TIME, start);
    let outputs = if distance.is_some() { 0x07 } else { 0x03 };
    bench.write(register::SYNC_ACTIVATION, isocat_wire::dc::SyncActivation(outputs));
    let activated = bench.now;
    let length = if cycle > 0 { cycle } else { bus };
    let periods = distance.map_or(0, |distance| distance / length.max(1));
    let end = start + (CYCLES + periods) * length + length / 2;
    let mut generated = Generated {
        activated,
        start,
        end,
        sync1: distance.is_some(),
        cycle,
        pulse,
        distance: distance.unwrap_or(0),
        kind: match (pulse > 0, cycle > 0) {
            (true, true) => "cyclic",
            (true, false) => "single shot",
            (false, true) => "cyclic acknowledge",
            (false, false) => "single shot acknowledge",
        },
        ..Generated::default()
    };
    bench.live(&mut generated, acknowledge);
    generated.registers = bench.registers();
    generated
}

impl Generated {
    /// The result in words.
    pub fn verdict(&self) -> String {
        let [sync0, sync1] = [self.edges[0].len(), self.edges[1].len()];
        let ends = match (self.pulse, self.acknowledged[0].len()) {
            (0, 0) => "SYNC0 stays active: nobody reads 0x098E".to_owned(),
            (0, _) => "SYNC0 is active until the local CPU reads 0x098E".to_owned(),
            (pulse, _) => format!("a pulse takes {}", time(pulse as f64)),
        };
        let also = if self.sync1 { format!(" and {sync1} of SYNC1") } else { String::new() };
        format!("Mode: {}. {sync0} edges of SYNC0{also} in what is shown; {ends}.", self.kind)
    }

    /// Draws both signals, with activation, start time, pulse length, cycle and distance.
    pub fn draw(&self) -> Picture {
        // The axis counts from the start time.
        let ns = |at: u64| at as f64 - self.start as f64;
        let signal = |which: usize, name: &str, register: &str| {
            let changes: Vec<f64> = self.changes[which].iter().map(|at| ns(*at)).collect();
            let read = |at: &u64| (ns(*at), format!("{register} read"));
            let mut events: Vec<(f64, String)> =
                self.acknowledged[which].iter().map(read).collect();
            if which == 0 {
                events.push((ns(self.start), "start 0x0990".into()));
                events.sort_by(|a, b| a.0.total_cmp(&b.0));
            }
            let mut distances = Vec::new();
            if which == 0 {
                if let [first, second, ..] = self.edges[0][..] {
                    let words = format!("cycle 0x09A0 {}", time(self.cycle as f64));
                    // If edges are missing for lack of an acknowledgement, the distance is not the
                    // cycle.
                    if second - first == self.cycle {
                        distances.push(((ns(first), ns(second)), words));
                    }
                }
                let last = self.edges[0].last().copied().unwrap_or(0);
                let falls = self.changes[0].iter().find(|at| **at > last);
                if let (Some(falls), true) = (falls, self.pulse > 0) {
                    let words = format!("pulse 0x0982 {}", time(self.pulse as f64));
                    distances.push(((ns(last), ns(*falls)), words));
                }
            } else if let (Some(sync0), Some(sync1)) =
                (self.edges[0].first(), self.edges[1].first())
            {
                let words = format!("0x09A4 {}", time(self.distance as f64));
                distances.push(((ns(*sync0), ns(*sync1)), words));
            }
            waves::Signal { name: name.to_owned(), high: false, changes, events, distances }
        };
        let activation = waves::Signal {
            name: "0x0981 active".to_owned(),
            high: false,
            changes: vec![ns(self.activated)],
            events: vec![(ns(self.activated), "activation 0x0981".into())],
            distances: Vec::new(),
        };
        let mut signals = vec![activation, signal(0, "SYNC0", "0x098E")];
        if self.sync1 {
            signals.push(signal(1, "SYNC1", "0x098F"));
        }
        let from = ns(self.activated) - (self.end - self.activated) as f64 * 0.03;
        let title = format!("SYNC signals, {}", self.kind);
        waves::draw("pulses", &title, (from, ns(self.end)), &signals)
    }
}

/// An ESC, with functions to write its registers like a MainDevice.
struct Bench {
    esc: Esc<Storage>,
    now: u64,
}

impl Bench {
    /// An ESC whose EEPROM has this pulse length, in 10 ns; both signals are enabled and mapped to
    /// AL events.
    fn new(pulse: u16) -> Self {
        let [low, high] = pulse.to_le_bytes();
        let configuration = [0x80, 0x0E, 0x00, 0xEE, low, high, 0, 0, 0, 0, 0, 0, 0, 0];
        let mut image = vec![0; 256];
        image[..14].copy_from_slice(&configuration);
        image[14] = sii::checksum(&configuration);
        let mut esc = Esc::new(&LAN9252, Storage::shared(image.into()), Storage::empty());
        esc.set_port(PortNumber::P0, true);
        Self { esc, now: 1_000 }
    }

    /// Writes a register by a frame, and waits for its end.
    fn write<T: Value>(&mut self, register: Register<T>, value: T) {
        let mut buffer = [0; MAX_LEN];
        let mut writer = FrameWriter::new(&mut buffer, [0x10; 6]);
        let to = Address::Position(AutoIncrementAddress(0), register.address);
        if writer.push(Command::Apwr, 0, to, value.to_bytes().as_ref()).is_err() {
            unreachable!("a register has room in a frame");
        }
        let length = writer.finish();
        let end = self.now + duration_ns(length);
        self.esc.process(&mut buffer[..length], Time::new(self.now), Time::new(end), true);
        while self.esc.step(Time::new(end)).is_some() {}
        self.now = end;
    }

    /// Lets time pass until the end; the local CPU acknowledges each edge `acknowledge` ns after
    /// it.
    fn live(&mut self, generated: &mut Generated, acknowledge: Option<u64>) {
        let mut reads: Vec<(u64, usize)> = Vec::new();
        let mut levels = [false; 2];
        loop {
            let due = self.esc.next_event();
            let falls = self.falls(generated, levels);
            let next = [Some(due.count()), reads.first().map(|read| read.0), falls];
            let Some(now) = next.into_iter().flatten().min().filter(|now| *now <= generated.end)
            else {
                break;
            };
            self.now = now;
            let at: Time<Device> = Time::new(now);
            while let Some((at, event)) = self.esc.step(at) {
                let which = match event {
                    EscEvent::Sync0 => 0,
                    EscEvent::Sync1 => 1,
                    _ => continue,
                };
                generated.edges[which].push(at.count());
                if let Some(after) = acknowledge.filter(|_| generated.pulse == 0) {
                    reads.push((at.count() + after, which));
                    reads.sort_unstable();
                }
                self.look(generated, &mut levels);
            }
            while let Some((_, which)) = reads.first().copied().filter(|read| read.0 <= now) {
                reads.remove(0);
                let status = [register::SYNC0_STATUS, register::SYNC1_STATUS][which];
                self.esc.pdi(at).load(status);
                generated.acknowledged[which].push(now);
            }
            self.look(generated, &mut levels);
        }
    }

    /// When a pulse with a length ends.
    fn falls(&self, generated: &Generated, levels: [bool; 2]) -> Option<u64> {
        let ends =
            (0..2).filter(|which| levels[*which] && generated.pulse > 0).filter_map(|which| {
                let edge = generated.edges[which].last()? + generated.pulse;
                // Another pulse came meanwhile and extended it: its end is searched tick by tick.
                Some(if edge > self.now { edge } else { self.now + 10 })
            });
        ends.min()
    }

    fn look(&self, generated: &mut Generated, levels: &mut [bool; 2]) {
        let signals = self.esc.sync_signals(Time::new(self.now));
        for which in 0..2 {
            if signals[which] != levels[which] {
                generated.changes[which].push(self.now);
            }
        }
        *levels = signals;
    }

    fn registers(&mut self) -> Vec<RegisterRow> {
        // Reading 0x098E by the CPU would acknowledge, so the value is shown without a read.
        let now = Time::new(self.now);
        let row = |address: &str, name, value: String| RegisterRow {
            address: address.into(),
            name,
            value,
        };
        let ns = |ns: u64| Nanos(ns as i64).to_string();
        let mut pdi = self.esc.pdi(now);
        let (next0, next1) = (pdi.load(register::SYNC_START_TIME), pdi.load(register::SYNC1_NEXT));
        let activation = pdi.load(register::SYNC_ACTIVATION).0;
        let status = pdi.load(register::ACTIVATION_STATUS).0;
        let length = u64::from(pdi.load(register::SYNC_PULSE_LENGTH)) * 10;
        let cycle0 = u64::from(pdi.load(register::SYNC0_CYCLE));
        let cycle1 = u64::from(pdi.load(register::SYNC1_CYCLE));
        let signals = pdi.load(register::SYNC0_STATUS);
        vec![
            row("0x0981", "activation", format!("0x{activation:02X}")),
            row("0x0982", "pulse length", format!("{} (in 10 ns: {})", ns(length), length / 10)),
            row("0x0984", "activation status", format!("0x{status:02X}")),
            row("0x098E", "SYNC0 status", signals.to_string()),
            row("0x0990", "next SYNC0 pulse", ns(next0)),
            row("0x0998", "next SYNC1 pulse", ns(next1)),
            row("0x09A0", "SYNC0 cycle", ns(cycle0)),
            row("0x09A4", "from SYNC0 to SYNC1", ns(cycle1)),
        ]
    }
}
